"""Alignment: the variance as a function of the offset of strata, and the best offset."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import NoClosedForm
from mcspectra.densities import AlignedStrata

JITTERED = {d: mcs.sampler("jittered", dims=d) for d in (1, 2, 3)}
STEP = mcs.integrand("step(at=0.3)", dims=1)
# Number of standard errors that are allowed
WITHIN = 4.5


def test_the_scan_of_a_step_equals_the_closed_form():
    """The step and the seam each cut one stratum, which adds s(1 − s)/n²."""
    d = mcs.improve.strata_shift_scan(STEP, JITTERED[1], [8, 16], offsets=10)
    assert d.attrs["method"] == "exact"
    for n in (8, 16):
        for o in d["offset0"].values:
            cut = [(0.3 * n - o) % 1.0, -o % 1.0]
            # The periodic step also has an edge at the seam, where 1 meets 0
            expected = sum(s * (1 - s) for s in cut) / n**2
            got = float(d["variance"].sel(offset0=o, n=n))
            assert got == pytest.approx(expected, abs=1e-15)


def test_the_scan_in_two_dims_equals_the_closed_form_and_has_its_rates():
    """For the step in x_0, the variance is n^-1.5 Σ s(1 − s) over both edges, for any offset1."""
    step = mcs.integrand("step(at=0.3)", dims=2)
    d = mcs.improve.strata_shift_scan(step, JITTERED[2], [100, 400, 1600], offsets=4)
    assert d["variance"].dims == ("offset0", "offset1", "n")
    assert d["rate_ci"].dims == ("offset0", "offset1", "bound")
    for o in d["offset0"].values:
        expected = 2 * o * (1 - o) * d["n"].values ** -1.5  # 0.3 √n is an integer
        row = d["variance"].sel(offset0=o)
        for column in row.values:
            np.testing.assert_allclose(column, expected, rtol=1e-9, atol=1e-17)
    assert np.isnan(d["rate"].sel(offset0=0)).all()  # without variance, no rate exists
    np.testing.assert_allclose(d["rate"].sel(offset0=[0.25, 0.5, 0.75]), -1.5, atol=1e-9)


def test_a_measured_scan_agrees_with_the_exact_one_and_shares_random_numbers():
    exact = mcs.improve.strata_shift_scan(STEP, JITTERED[1], 8, offsets=[0.1, 0.4, 0.75])
    measured = mcs.improve.strata_shift_scan(
        STEP, JITTERED[1], 8, offsets=[0.1, 0.4, 0.75], method="measured", realizations=3000, rng=7
    )
    assert measured.attrs["method"] == "measured"
    # The kurtosis of a sum of Bernoulli values is at most 8.1 (p = 0.1), so Var(s²)/σ⁴ ≤ 7.1/R
    spread = WITHIN * np.sqrt(7.1 / 3000) * exact["variance"] + 1e-15
    assert (abs(measured["variance"] - exact["variance"]) < spread).all()
    direct = mcs.convergence(
        STEP, "jittered | strata-shift(offset=[0.75])", [8], realizations=3000, rng=7
    )
    np.testing.assert_array_equal(measured["variance"][-1], direct["variance"])


def test_auto_measures_if_no_closed_form_exists():
    d = mcs.improve.strata_shift_scan(
        STEP, mcs.sampler("gaussian-jitter", dims=1), 8, offsets=2, realizations=20
    )
    assert d.attrs["method"] == "measured"
    with pytest.raises(NoClosedForm):
        mcs.improve.strata_shift_scan(
            STEP, mcs.sampler("gaussian-jitter", dims=1), 8, offsets=2, method="exact"
        )


def test_scans_have_dims_of_offsets_and_channels():
    both = mcs.Integrand.from_function(
        lambda x: np.stack([x[..., 0] < 0.3, x[..., 1] < 0.7], axis=-1).astype(float),
        dims=3,
        integral=[0.3, 0.7],
    )
    d = mcs.improve.strata_shift_scan(
        both, JITTERED[3], [8, 27], offsets=2, method="measured", realizations=20
    )
    assert d["variance"].dims == ("offset0", "offset1", "offset2", "n", "channel")
    assert d["rate"].dims == ("offset0", "offset1", "offset2", "channel")


def test_aligned_strata_of_a_step_have_no_variance():
    """This holds for any n, for a step in 1-D and a rectangle in 2-D."""
    for n in (7, 16):
        assert mcs.exact_variance(mcs.aligned(STEP, [0.3], n), "jittered", n) < 1e-30
    corner = mcs.Integrand.from_function(
        lambda x: ((x[..., 0] < 0.3) & (x[..., 1] < 0.63)).astype(float), dims=2, integral=0.189
    )
    found = mcs.aligned(corner, [[0.3], [0.63]], 49)
    d = mcs.convergence(found, "jittered", [49], realizations=200)
    assert float(d["variance"][0]) < 1e-30
    assert float(d["mean"][0]) == pytest.approx(0.189, abs=1e-14)


def test_aligned_strata_hardly_change_the_variance_of_smooth_integrands():
    """For f = x and pieces of length L with k strata each, the variance is Σ L⁴/(12 k³)."""
    x = mcs.integrand("linear", dims=1)
    pieces, counts = np.array([0.3, 0.7]), np.array([5, 11])
    exact = mcs.exact_variance(mcs.aligned(x, [0.3], 16), "jittered", 16)
    assert exact == pytest.approx((pieces**4 / (12 * counts**3)).sum(), rel=1e-9)
    assert exact < 1.02 / (12 * 16**3)


def test_each_piece_gets_strata_in_proportion_to_its_length():
    density = AlignedStrata(edges=[0.3, 0.301, 0.8], strata=10)
    np.testing.assert_allclose(density.breaks[0], [0.3, 0.4, 0.8])
    assert AlignedStrata(edges=[], strata=3).breaks == ((),)
    crowded = AlignedStrata(edges=[0.001, 0.002, 0.003], strata=4)
    np.testing.assert_allclose(crowded.breaks[0], [0.25, 0.5, 0.75])


def test_points_never_cross_an_edge_by_rounding():
    rng = np.random.default_rng(1)
    for s in (3, 7, 10):
        edges = np.sort(rng.random(2))
        density = AlignedStrata(edges=edges, strata=s)
        borders = np.array(density.breaks[0])
        below = density.sample(np.nextafter(borders, 0)[:, None])[:, 0]
        assert (below < edges).all()
        np.testing.assert_array_equal(density.sample(borders[:, None])[:, 0], edges)


def test_the_best_offset_is_found_between_scanned_offsets():
    """Edges at 1.9 and 5.9 strata: the variance is 2 · 0.09/n² at offset 0, and 0 at offset 0.9."""
    wave = mcs.Integrand.from_function(
        lambda x: ((x[..., 0] >= 0.2375) & (x[..., 0] < 0.7375)).astype(float),
        dims=1,
        integral=0.5,
    )
    found = mcs.improve.best_alignment(
        wave, JITTERED[1], 8, method="measured", offsets=4, realizations=600, rng=2
    )
    best = found.sel(candidate="offset")
    assert float(best["strata_offset"][0]) == pytest.approx(0.9, abs=2**-8)
    assert found.attrs["improved"] == "yes"
    assert int(best["improvement"]) == 1
    assert float(best["variance_ratio_ci"][1]) < 0.2
    first = found.sel(candidate="unshifted")
    # The sum of two Bernoulli values with p = 0.9 has the kurtosis 5.6, so Var(s²)/σ⁴ = 4.6/R
    assert float(first["measured_variance"]) == pytest.approx(
        2 * 0.09 / 64, rel=WITHIN * np.sqrt(4.6 / 600)
    )


def test_aligned_strata_are_better_than_every_offset_of_incompatible_edges():
    """The edges are at 2.4 strata and at the seam, so any offset cuts a stratum."""
    found = mcs.improve.best_alignment(STEP, JITTERED[1], 8, edges=[0.3], realizations=300)
    assert list(found["candidate"].values) == ["unshifted", "offset", "aligned"]
    assert found.attrs["method"] == "exact"
    np.testing.assert_allclose(found["predicted_variance"][[0, 2]], [0.24 / 64, 0], atol=1e-15)
    assert found.attrs["best"] == "aligned"
    assert found.attrs["improved"] == "yes"


def test_smooth_integrands_keep_offset_zero():
    """The seam cuts a shifted stratum, so offset 0 is the best and the verdict is undecided."""
    x = mcs.integrand("linear", dims=1)
    found = mcs.improve.best_alignment(x, JITTERED[1], 16, offsets=4, realizations=300, rng=4)
    assert float(found["strata_offset"].sel(candidate="offset")[0]) == 0.0
    assert found.attrs["improved"] == "undecided"


def test_a_constant_gives_no_verdict():
    found = mcs.improve.best_alignment(
        mcs.integrand("constant", dims=1), JITTERED[1], 4, offsets=2, realizations=20
    )
    assert np.isnan(found["variance_ratio"][1])
    assert found.attrs["improved"] == "undecided"


def test_the_predicted_variances_in_two_dims_are_exact():
    corner = mcs.integrand("step(at=0.45, axis=1)", dims=2)
    found = mcs.improve.best_alignment(
        corner, JITTERED[2], 64, edges=[[], [0.45]], offsets=2, realizations=200
    )
    predicted = found["predicted_variance"].values
    assert predicted[0] == pytest.approx(0.24 * 64**-1.5, rel=1e-9)  # the edge is at 3.6 strata
    assert predicted[2] < 1e-25
    assert found["strata_offset"].dims == ("candidate", "axis")
