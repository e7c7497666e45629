"""dc + power + cross equals the sample variance of the truncated estimate, also as a matrix."""

from functools import cache

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import InfiniteWeightVarianceWarning
from mcspectra.core.streams import Stream
from mcspectra.spectra.transforms import FrequencyGrid, direct_sum

REALIZATIONS = 48
GAUSSIAN = mcs.Estimator("gaussian", dims=2)


def _one_sided(dims):
    """Return a biased, skew sampler: its points crowd toward 0, but it claims to be uniform."""

    def draw(n, generator):
        return generator.random((n, dims)) ** 2

    return mcs.Sampler.from_function(draw, dims=dims, unbiased=False)


def _sampler(name, dims):
    return _one_sided(dims) if name == "one-sided" else mcs.sampler(name, dims=dims)


@cache
def _skew(dims):
    """Return an integrand that is not periodic and has no symmetry about any point."""
    return mcs.Integrand.from_function(
        lambda x: np.exp(x[..., 0]) * (1 + 0.3 * x.sum(axis=-1) ** 2), dims=dims
    )


def _estimates(estimator, sampler, n, space, half_width, seed):
    """Return Σ_m conj(f_m) S_m for every realization, summed directly over the whole grid."""
    grid = FrequencyGrid(estimator.dims, half_width)
    m = np.concatenate([grid.indices(), -grid.indices()[-2::-1]])
    points = estimator.draw(sampler, n, Stream.from_rng(seed), 0, REALIZATIONS)
    if space == "domain":
        x, weights = estimator.weighted_points(points)
        f = estimator.domain_integrand.fourier(m)
        return direct_sum(x, m, weights) @ f.conj()
    return sum(
        direct_sum(u, m) @ estimator.primary_integrand(t).fourier(m).conj()
        for t, u in enumerate(points)
    )


# In 3-D, the samplers with independent points in strata or in the cube are slow
CASES = [
    pytest.param(
        *(dims, name, density, space),
        marks=[pytest.mark.slow] * (dims == 3 and name in ("random", "jittered")),
    )
    for dims in (1, 2, 3)
    for name in ("random", "jittered", "jittered | shift", "one-sided")
    for density in (None, "linear(slope=1.2)")
    for space in ("domain", "primary")
    if density or space == "domain"  # without a density, both spaces are the same
]


@cache
def _estimator(dims, density):
    """Return one estimator for all samplers, so that its coefficients are computed once."""
    return mcs.Estimator(_skew(dims), density)


@pytest.mark.parametrize(("dims", "name", "density", "space"), CASES)
def test_terms_sum_to_the_sample_variance(dims, name, density, space):
    estimator = _estimator(dims, density)
    sampler = _sampler(name, dims)
    n, half_width = {1: (8, 12), 2: (16, 5), 3: (8, 3)}[dims]
    d = mcs.variance_terms(
        estimator,
        sampler,
        n,
        half_width=half_width,
        realizations=REALIZATIONS,
        rng=4,
        space=space,
        engine="direct",
    )
    total = float(d["dc_term"] + d["power_term"] + d["cross_term"])
    estimates = _estimates(estimator, sampler, n, space, half_width, 4)
    assert np.abs(estimates.imag).max() < 1e-12 * np.abs(estimates.real).max()
    expected = np.var(estimates.real, ddof=1)
    assert total == pytest.approx(expected, rel=1e-10)
    assert float(d["predicted_variance"]) == pytest.approx(expected, rel=1e-10)
    assert float(d["contribution"].sum()) == pytest.approx(expected, rel=1e-10)
    assert float(d["band_covariance"].sum()) == pytest.approx(expected, rel=1e-10)
    assert float(d["truncated_variance"][-1]) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("dims", [1, 2])
def test_nufft_engine_keeps_the_identity_of_its_own_spectra(dims):
    estimator = mcs.Estimator(_skew(dims), "linear(slope=1.2)")
    d = mcs.variance_terms(
        estimator,
        "jittered",
        64,
        half_width=40 if dims == 1 else 20,
        realizations=101,
        rng=1,
        engine="nufft",
    )
    total = float(d["dc_term"] + d["power_term"] + d["cross_term"])
    assert total == pytest.approx(float(d["truncated_variance"][-1]), rel=1e-10)
    assert float(d["band_covariance"].sum()) == pytest.approx(total, rel=1e-10)


@pytest.mark.parametrize("space", ["domain", "primary"])
@pytest.mark.parametrize(("dims", "half_width"), [(1, 10), (2, 3)])
def test_matrix_is_the_brute_force_covariance(space, dims, half_width):
    estimator = mcs.Estimator(_skew(dims), "linear(slope=1)")
    sampler = _one_sided(dims)
    d = mcs.variance_terms(
        estimator,
        sampler,
        9,
        half_width=half_width,
        realizations=REALIZATIONS,
        rng=2,
        space=space,
        cross_matrix=True,
    )
    m = np.indices((2 * half_width + 1,) * dims).reshape(dims, -1).T - half_width
    (u,) = estimator.draw(sampler, 9, Stream.from_rng(2), 0, REALIZATIONS)
    if space == "domain":
        x, weights = estimator.weighted_points([u])
        s, f = direct_sum(x, m, weights), estimator.domain_integrand.fourier(m)
    else:
        s, f = direct_sum(u, m), estimator.primary_integrand(0).fourier(m)
    s = s - s.mean(axis=0)
    covariance = s.T @ s.conj() / (REALIZATIONS - 1)  # ⟨S_m conj S_l⟩
    assert np.allclose(d["coefficient_covariance"], covariance, atol=1e-12)
    cross = f.conj()[:, None] * f[None, :] * covariance
    assert np.allclose(d["cross_matrix"], cross, atol=1e-12)
    off = cross.sum() - np.trace(cross)
    assert float(d["cross_term"]) == pytest.approx(off.real, rel=1e-9)
    total = float(d["predicted_variance"])
    assert complex(d["cross_matrix"].sum()) == pytest.approx(total, rel=1e-9, abs=1e-12)


def test_the_slides_literal_pairing_predicts_the_reflected_integrand():
    """⟨S_m* S_l⟩ with f_m* f_l gives the variance of f(1−x), which differs for one-sided points.

    If `variance_terms` used the slides' pairing, its prediction would follow the reflected
    estimator, and the first assertion would fail.
    """
    sampler = _one_sided(1)
    # f is periodic and smooth, so |m| ≤ 40 holds its whole energy up to rounding
    f = mcs.Integrand.from_function(
        lambda x: np.exp(3 * np.cos(2 * np.pi * (x[..., 0] - 0.15))), dims=1
    )
    mirror = mcs.Integrand.from_function(
        lambda x: np.exp(3 * np.cos(2 * np.pi * (0.85 - x[..., 0]))), dims=1
    )
    d = mcs.variance_terms(
        mcs.Estimator(f), sampler, 8, half_width=40, realizations=400, rng=3, cross_matrix=True
    )
    measured = float(d["measured_variance"])
    x = sampler.draw(8, realizations=400, rng=3)
    reflected = float(np.var(mirror(x).mean(axis=1), ddof=1))
    assert (
        abs(reflected / measured - 1) > 0.3
    )  # the variances differ, so the test separates the pairings
    assert float(d["predicted_variance"]) == pytest.approx(measured, rel=1e-8)
    c = d["coefficient_covariance"].values
    fm = f.fourier(d["m"].values[:, None])
    literal = float((fm.conj()[:, None] * fm[None, :] * c.conj()).sum().real)
    assert literal == pytest.approx(reflected, rel=1e-8)
    assert abs(literal / measured - 1) > 0.3


def test_decomposition_of_x_in_1d_matches_the_oracle():
    """For f = x and jittered points, all terms have closed forms.

    dc = 0, power = 1/(6n²) − 1/(12n³), cross = 1/(6n³) − 1/(6n²), and the sum is 1/(12n³).
    """
    n, realizations = 4, 6000
    d = mcs.variance_terms(
        mcs.Estimator("linear", dims=1), "jittered", n, half_width=400, realizations=realizations
    )
    power, total = 1 / (6 * n**2) - 1 / (12 * n**3), 1 / (12 * n**3)
    cross = 1 / (6 * n**3) - 1 / (6 * n**2)
    # The tail beyond K of Σ|f_m|²C_mm is about (1/n) Σ_{|m|>K} 1/(4π²m²) = 1/(2π² n K).
    tail = 1 / (2 * np.pi**2 * n * 400)
    # The sums have hundreds of frequencies and 6000 realizations: 2 % exceeds 4 σ of each term.
    assert float(d["dc_term"]) == pytest.approx(0, abs=1e-20)
    assert float(d["power_term"]) == pytest.approx(power, rel=0.02, abs=tail)
    assert float(d["cross_term"]) == pytest.approx(cross, rel=0.02, abs=tail)
    low, high = d["measured_variance_ci"].values
    assert low - (high - low) < total < high + (high - low)


def test_shift_has_no_cross_term():
    """A Cranley-Patterson shift makes C_ml diagonal, so the cross term is 0 within its error."""
    d = mcs.variance_terms(
        mcs.Estimator(_skew(1)), "jittered | shift", 16, half_width=12, realizations=6000, rng=1
    )
    # For independent coefficients, the cross term has the variance predicted² · 2/R
    sigma = float(d["predicted_variance"]) * np.sqrt(2 / 6000)
    assert abs(float(d["cross_term"])) < 5 * sigma


def test_infinite_variance_of_weights_is_reported_without_numbers():
    """For f = x² and p = 2x, the variance is 1/(72n) although Var(S_0) is infinite."""
    estimator = mcs.Estimator(
        mcs.Integrand.from_function(lambda x: x[..., 0] ** 2, dims=1, integral=1 / 3),
        "linear(slope=2)",
    )
    with pytest.warns(InfiniteWeightVarianceWarning, match="space='primary'"):
        d = mcs.variance_terms(estimator, "random", 10, half_width=8, realizations=500, rng=1)
    assert np.isinf(float(d["dc_term"]))
    assert np.isinf(float(d["power_term"]))
    for name in ("cross_term", "predicted_variance", "captured"):
        assert np.isnan(float(d[name])), name
    assert np.isnan(d["contribution"].values).all()
    assert "infinite" in d.attrs["note"]
    variance, (low, high) = float(d["measured_variance"]), d["measured_variance_ci"].values
    assert low < variance < high
    assert variance == pytest.approx(1 / 720, rel=4 * np.sqrt(2 / 500))
    primary = mcs.variance_terms(
        estimator, "random", 10, half_width=200, realizations=500, rng=1, space="primary"
    )
    assert float(primary["captured"]) == pytest.approx(1, abs=0.02)


def test_channels_and_techniques_are_dims_of_the_result():
    f = mcs.Integrand.from_function(
        lambda x: np.stack([x[..., 0], x[..., 0] ** 2, 1 + 0 * x[..., 0]], axis=-1), dims=1
    )
    estimator = mcs.MultipleImportance(f, ["uniform", "linear(slope=1)"])
    d = mcs.variance_terms(
        estimator, "jittered", 8, half_width=16, realizations=64, space="primary"
    )
    assert d["contribution"].dims == ("channel", "technique", "m0")
    total = d["dc_term"] + d["power_term"] + d["cross_term"]
    assert np.allclose(d["contribution"].sum(["technique", "m0"]), total, rtol=1e-9)
    assert np.allclose(d["truncated_variance"][:, -1], total, rtol=1e-9)
    domain = mcs.variance_terms(estimator, "jittered", 8, half_width=16, realizations=64)
    assert domain["contribution"].dims == ("channel", "m0")
    assert np.array_equal(domain["measured_variance"], d["measured_variance"])


def test_technique_sums_are_analysed_in_primary_space():
    estimator = mcs.estimators.TechniqueSum(["linear", "step(at=0.3)"], dims=1)
    found = mcs.variance_terms(estimator, "jittered", 16, half_width=2, realizations=4)
    assert found.attrs["space"] == "primary"


def test_given_bands_partition_the_variance():
    labels = np.zeros((9, 9), int)
    labels[:, 4] = 1  # frequencies with m1 = 0 form the part of f that varies along x0 only
    labels[4, :] = 2
    d = mcs.variance_terms(GAUSSIAN, "jittered", 16, half_width=4, realizations=64, bands=labels)
    assert d["band_covariance"].shape == (3, 3)
    assert float(d["band_covariance"].sum()) == pytest.approx(float(d["predicted_variance"]))


def test_variables_carry_units_and_meaning():
    d = mcs.variance_terms(GAUSSIAN, "jittered", 16, half_width=4, realizations=8, rng=9)
    for name, variable in d.data_vars.items():
        assert variable.attrs["long_name"], name
        assert variable.attrs["units"], name
    assert d.attrs["seed"] == 9
    assert d.attrs["estimator"].startswith("gaussian")
    assert d.attrs["coefficients"] == "exact"


@pytest.mark.parametrize(
    ("f", "sampler", "words", "upper"),
    [
        ("gaussian", "sobol", "sobol has no variance: add owen or shift, or compare |bias|", 0.0),
        ("constant", "jittered", "constant with jittered: the variance vanishes to rounding", 0.0),
        (
            "disk(center=0.4, radius=0.0006)",
            "random",
            "all estimates are equal at n = 16",
            np.inf,
        ),
    ],
)
def test_a_measured_variance_of_zero_has_a_reason(f, sampler, words, upper):
    """The variance has no upper bound if no point hit the disk."""
    d = mcs.variance_terms(mcs.Estimator(f, dims=2), sampler, 16, half_width=4, realizations=50)
    assert words in d.attrs["note"]
    assert float(d["measured_variance"]) == 0.0
    np.testing.assert_array_equal(d["measured_variance_ci"], [0.0, upper])
    assert np.isnan(d["captured"])
    if sampler == "sobol":
        terms = ("dc_term", "power_term", "cross_term", "predicted_variance", "contribution")
        assert not any(d[name].any() for name in terms)
