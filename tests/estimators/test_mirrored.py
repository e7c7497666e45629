"""Mirrored estimators: equal bits with the mirroring sampler, exact variances, rates of the
slides."""

import itertools

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import CountError, NoClosedForm, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.estimators.mirrored import FoldedIntegrand, SymmetrizedIntegrand

MODES = ("integrand", "random", "uniform")
SMOOTH = mcs.integrand("gaussian(center=[0.2, 1.4], width=0.3)", dims=2)
SMOOTH_1D = mcs.integrand("gaussian(center=0.1, width=0.4)", dims=1)
# Allowed standard errors; of the 50 or so comparisons here, one in 300 seeds would fail
WITHIN = 4.0


def _estimators():
    densities = ["uniform", "linear(slope=[1.5, -0.5])"]
    return [
        mcs.Estimator(SMOOTH),
        mcs.Estimator(SMOOTH, densities[1]),
        mcs.MultipleImportance(SMOOTH, densities, heuristic="power", counts=(1, 4)),
        mcs.MultipleImportance(SMOOTH, densities, sets="shared"),
        mcs.estimators.TechniqueSum([SMOOTH, "step"]),
    ]


def _as_sampler_mode(mode):
    return "fold" if mode == "integrand" else mode


@pytest.mark.parametrize("estimator", _estimators(), ids=lambda e: e.spec)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("spec", ["jittered | shift", "sobol | owen"])
def test_mirrored_is_the_mirrored_sampler_bit_for_bit(estimator, mode, spec):
    mirrored = mcs.Mirrored(estimator, mode)
    inner = mcs.sampler(spec, dims=2)
    chain = mcs.sampler(f"{spec} | mirror(mode={_as_sampler_mode(mode)!r})", dims=2)
    own = mirrored.draw(inner, 16, Stream.from_rng(3), 2, 5)
    theirs = estimator.draw(chain, 16, Stream.from_rng(3), 2, 5)
    np.testing.assert_array_equal(mirrored.estimate(own), estimator.estimate(theirs))
    if estimator.domain_integrand is not None:
        for a, b in zip(
            mirrored.weighted_points(own), estimator.weighted_points(theirs), strict=True
        ):
            np.testing.assert_array_equal(a, b)


def test_shared_points_have_no_exact_variance_of_techniques_added_up():
    shared = mcs.MultipleImportance(SMOOTH_1D, ["uniform", "linear"], sets="shared")
    for estimator in (shared, mcs.Mirrored(shared)):
        with pytest.raises(NoClosedForm):
            mcs.exact_variance(estimator, "jittered", 16)


def test_estimators_that_are_measured_together_keep_their_own_points():
    several = [mcs.Estimator(SMOOTH), *(mcs.Mirrored(SMOOTH, mode) for mode in MODES)]
    together = mcs.convergence(several, "jittered", [16, 64], realizations=20, rng=1)
    for i, estimator in enumerate(several):
        alone = mcs.convergence(estimator, "jittered", [16, 64], realizations=20, rng=1)
        np.testing.assert_allclose(together["mean"][i], alone["mean"], rtol=1e-13)


@pytest.mark.parametrize("mode", MODES)
def test_n_counts_evaluations(mode):
    seen = []

    def counted(x):
        seen.append(x.shape[:-1])
        return x[..., 0]

    mirrored = mcs.Mirrored(mcs.Integrand.from_function(counted, dims=3, integral=0.5), mode)
    seen.clear()
    mirrored.estimate(mirrored.draw(mcs.sampler("random", dims=3), 40, Stream(1), 0, 7))
    assert seen == [(7, 40)]
    assert mirrored.samples_per_point == (8 if mode == "uniform" else 1)


def test_uniform_needs_whole_sets_of_images():
    mirrored = mcs.Mirrored(SMOOTH, "uniform")
    with pytest.raises(CountError, match="36 and 64"):
        mirrored.check_sampler(mcs.sampler("jittered", dims=2), 49)
    with pytest.raises(CountError, match="Technique 1 draws 2"):
        mcs.Mirrored(
            mcs.MultipleImportance(SMOOTH, ["uniform", "linear"], counts=(1, 2)), "uniform"
        ).check_sampler(mcs.sampler("jittered", dims=2), 16)


@pytest.mark.parametrize(
    ("given", "mode", "words"),
    [
        (SMOOTH, "mirror", "mode is 'mirror'"),
        (None, "random", "is not an estimator"),
    ],
)
def test_bad_input(given, mode, words):
    with pytest.raises(ParameterError, match=words):
        mcs.Mirrored(given, mode)


def test_too_many_dims_are_refused_at_once():
    many = mcs.integrand("gaussian", dims=40)
    with pytest.raises(ParameterError, match="at most 30"):
        mcs.convergence(mcs.Mirrored(many, "uniform"), "random", [8], realizations=2)
    with pytest.raises(ParameterError, match="at most 12"):
        mcs.exact_variance(mcs.Mirrored(many, "random"), "random", 8)


def test_a_sampler_of_other_dims_is_refused():
    with pytest.raises(ParameterError, match="needs a sampler in 2 dims"):
        mcs.Mirrored(SMOOTH).check_sampler(mcs.sampler("random", dims=3), 8)


@pytest.mark.parametrize("dims", [1, 2, 3])
def test_folded_and_symmetrised_integrands_by_their_definitions(dims):
    f = mcs.Integrand.from_function(
        lambda x: np.exp(x @ np.arange(1.0, dims + 1)), dims=dims, integral=1.0
    )
    u = np.random.default_rng(1).random((50, dims))
    np.testing.assert_allclose(FoldedIntegrand(f)(u), f(1 - np.abs(2 * u - 1)), rtol=1e-13)
    images = [np.abs(np.array(k) - u) for k in itertools.product((0, 1), repeat=dims)]
    mean = np.mean([f(x) for x in images], axis=0)
    np.testing.assert_allclose(SymmetrizedIntegrand(f)(u), mean, rtol=1e-13)


def test_breaks_are_reflected_and_the_fold_is_one():
    step = mcs.integrand("step(at=0.25)", dims=1)
    assert FoldedIntegrand(step).breaks == ((0.125, 0.5, 0.875),)
    assert SymmetrizedIntegrand(step).breaks == ((0.25, 0.75),)


@pytest.mark.parametrize("make", [FoldedIntegrand, SymmetrizedIntegrand])
def test_reflected_integrands_are_continuous_across_the_faces(make):
    g = make(mcs.integrand("linear(gradient=[1, -2], offset=0.3)", dims=2))
    edge = np.linspace(0, 1, 9)
    for axis in (0, 1):
        low, high = np.empty((9, 2)), np.empty((9, 2))
        low[:, axis], high[:, axis] = 0.0, 1.0
        low[:, 1 - axis] = high[:, 1 - axis] = edge
        np.testing.assert_allclose(g(low), g(high), atol=1e-15)


def test_reflected_integrands_keep_the_integral_and_channels():
    rgb = mcs.Integrand.from_function(
        lambda x: np.stack([x[..., 0], x[..., 1] ** 2, x[..., 0] * x[..., 1]], axis=-1), dims=2
    )
    for make in (FoldedIntegrand, SymmetrizedIntegrand):
        assert make(rgb).channels == 3
        np.testing.assert_allclose(make(rgb).integral, [1 / 2, 1 / 3, 1 / 4], rtol=1e-10)
        assert make(SMOOTH).integral == SMOOTH.integral


@pytest.mark.parametrize(
    "spec", ["disk(center=[0.4, 0.3], radius=0.35)", "gaussian", "step(at=0.3)"]
)
def test_box_moments_of_folded_integrands(spec):
    """Compare with the mean over a fine grid, for boxes on both sides of the folds and across."""
    f = mcs.integrand(spec, dims=2)
    g = FoldedIntegrand(f)
    lo = np.array([[0.1, 0.2], [0.3, 0.55], [0.45, 0.4], [0.0, 0.0], [0.5, 0.5]])
    hi = np.array([[0.3, 0.45], [0.7, 0.8], [0.55, 0.9], [1.0, 1.0], [1.0, 0.75]])
    mean, square = g.box_moments(lo, hi)
    steps = (np.arange(400) + 0.5) / 400
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    for i in range(len(lo)):
        values = g(lo[i] + grid * (hi[i] - lo[i]))
        # A border crosses fewer than 4 · 400 of the 400² cells of the grid
        np.testing.assert_allclose(
            [mean[i], square[i]], [values.mean(), (values**2).mean()], atol=0.01
        )
    whole = g.box_moments(np.zeros((1, 2)), np.ones((1, 2)))
    np.testing.assert_allclose(whole[0], f.integral, rtol=1e-9)


def test_fourier_of_symmetrised_integrands_is_the_real_part_in_one_dim():
    g = SymmetrizedIntegrand(SMOOTH_1D)
    m = np.arange(-5, 6)[:, None]
    np.testing.assert_allclose(g.fourier(m), SMOOTH_1D.fourier(m).real, atol=1e-15)


@pytest.mark.parametrize("space", ["domain", "primary"])
@pytest.mark.parametrize("mode", MODES)
def test_terms_of_both_spaces_sum_to_the_truncated_variance_and_capture_it(mode, space):
    mirrored = mcs.Mirrored(mcs.Estimator(SMOOTH_1D, "linear(slope=0.5)"), mode)
    d = mcs.variance_terms(
        mirrored, "jittered | shift", 16, half_width=256, realizations=400, space=space
    )
    terms = float(d["dc_term"] + d["power_term"] + d["cross_term"])
    assert terms == pytest.approx(float(d["truncated_variance"][-1]), rel=1e-9)
    # The truncated part is a boundary term of order 1/half_width in the domain, else 1/half_width³
    assert float(d["captured"]) == pytest.approx(1.0, abs=0.12 if space == "domain" else 0.06)


def test_a_shift_leaves_no_cross_term_of_the_folded_integrand():
    """Its relative size is that of the noise, 1/√realizations, and decreases with it."""
    d = mcs.variance_terms(
        mcs.Mirrored(SMOOTH_1D), "jittered | shift", 16, space="primary", realizations=2000
    )
    assert abs(float(d["cross_term"])) < WITHIN * float(d["cross_term_se"])
    assert float(d["cross_term_se"]) < 0.1 * float(d["power_term"])


@pytest.mark.parametrize(
    ("spec", "dims"),
    [
        ("random", 1),
        ("jittered", 1),
        ("jittered | shift", 1),
        ("uniform-jitter", 1),
        ("jittered", 2),
    ],
)
@pytest.mark.parametrize("mode", MODES)
def test_exact_variances_against_measured(spec, mode, dims):
    f = SMOOTH_1D if dims == 1 else SMOOTH
    mirrored = mcs.Mirrored(mcs.Estimator(f, "linear(slope=0.8)"), mode)
    exact = mcs.exact_variance(mirrored, spec, 16)
    d = mcs.measure.realizations_needed(mirrored, spec, 16, relative_error=0.03, rng=11)
    assert abs(float(d["variance"]) / exact - 1) < WITHIN * float(d["variance_relative_se"])


def test_exact_variances_of_a_square():
    """f = x² in 1-D: f(2u) twice, random reflections, and ḡ = u² − u + ½, from moments in
    strata."""
    n = 12
    edges = np.arange(n + 1) / n

    def within(g, ends):  # Σ_j (width · standard deviation in stratum j)², of polynomials
        widths = np.diff(ends)
        mean, square = (np.diff(p.integ()(ends)) / widths for p in (g, g * g))
        return (widths**2 * (square - mean**2)).sum()

    u = np.polynomial.Polynomial([0, 1])
    average = u**2 - u + 0.5
    spread = [(p.integ()(1) - p.integ()(0)) for p in (u**4, average**2)]
    folded = 2 * within((2 * u) ** 2, edges[: n // 2 + 1])  # The same on both sides of ½
    random = within(average, edges) + (spread[0] - spread[1]) / n
    uniform = within(average, edges[::2])
    square = mcs.integrand("polynomial(coefficients=[0, 0, 1])", dims=1)
    exact = [mcs.exact_variance(mcs.Mirrored(square, mode), "jittered", n) for mode in MODES]
    np.testing.assert_allclose(exact, [folded, random, uniform], rtol=1e-9)


@pytest.mark.parametrize("mode", MODES)
def test_exact_variance_of_a_mirrored_sampler_is_that_of_the_mirrored_estimator(mode):
    chain = f"jittered | shift | mirror(mode={_as_sampler_mode(mode)!r})"
    mirrored = mcs.exact_variance(mcs.Mirrored(SMOOTH_1D, mode), "jittered | shift", 8)
    assert mcs.exact_variance(SMOOTH_1D, chain, 8) == mirrored


def test_exact_variance_of_a_folded_disk_is_exact_too():
    """In 2-D this needs closed-form boxes; the domain does not cut the disk."""
    disk = mcs.integrand("disk(center=[0.463, 0.517], radius=0.27)", dims=2)
    exact = mcs.exact_variance(mcs.Mirrored(disk), "jittered", 1024)
    # Four half-size disks: 4 · 1.0428109 · (R/2) n^-1.5 on average over generic positions
    assert exact == pytest.approx(4 * 1.0428109 * 0.135 * 1024**-1.5, rel=0.15)


def test_random_reflections_of_a_grid_have_no_closed_form_here():
    with pytest.raises(NoClosedForm, match="not uniform"):
        mcs.exact_variance(mcs.Mirrored(SMOOTH, "random"), "regular", 16)
    with pytest.raises(NoClosedForm):
        mcs.predict(mcs.Mirrored(SMOOTH, "random"), "jittered", [16], method="pair-correlation")


def _exact_rate(estimator, spec, low, high):
    a, b = (mcs.exact_variance(estimator, spec, n) for n in (low, high))
    return np.log(b / a) / np.log(high / low)


def test_homogenisation_takes_minus_two_to_minus_one_and_a_half_and_folding_restores_it():
    """Exact rates in 2-D; strata of the folded integrand are twice as long, so its curve bends
    later."""
    assert _exact_rate(SMOOTH, "jittered", 1024, 4096) == pytest.approx(-2.0, abs=0.05)
    assert _exact_rate(SMOOTH, "jittered | shift", 1024, 4096) == pytest.approx(-1.5, abs=0.05)
    for spec in ("jittered", "jittered | shift"):
        assert _exact_rate(mcs.Mirrored(SMOOTH), spec, 1024, 4096) == pytest.approx(-2.0, abs=0.05)


@pytest.mark.parametrize(("mode", "rate"), [("integrand", -3), ("random", -1), ("uniform", -3)])
@pytest.mark.parametrize("spec", ["jittered", "jittered | shift"])
def test_exact_rates_in_one_dim(mode, rate, spec):
    """Rates: jittered −3, shifted −2; folded and symmetrized both −3; random reflections −1."""
    mirrored = mcs.Mirrored(SMOOTH_1D, mode)
    assert _exact_rate(mirrored, spec, 32, 64) == pytest.approx(rate, abs=0.12)
    assert _exact_rate(SMOOTH_1D, "jittered | shift", 32, 64) == pytest.approx(-2.0, abs=0.1)


def test_exact_rates_of_interior_edges_stay():
    """A homogenized step in 2-D has n^-1.5/6 for each edge of the border; the folded one has
    two."""
    step = mcs.integrand("step(at=0.35)", dims=2)
    for n in (64, 256):
        exact = mcs.exact_variance(mcs.Mirrored(step), "jittered | shift", n)
        assert exact == pytest.approx(2 * n**-1.5 / 6, rel=1e-6)


def test_the_study_of_the_slides():
    study = mcs.improve.mirror_study(SMOOTH, "jittered", [64, 256, 1024], realizations=200, rng=5)
    assert study["variance"].dims == ("mirroring", "homogenized", "n")
    assert study["rate"].dims == ("mirroring", "homogenized")
    assert study.attrs["sampler"] == "jittered"
    assert "exact_variance" not in study
    expected = {"original": (-2, -1.5), "integrand": (-2, -2), "random": (-1, -1)}
    expected["uniform"] = expected["integrand"]
    for name, rates in expected.items():
        for homogenized, rate in zip((False, True), rates, strict=True):
            cell = study.sel(mirroring=name, homogenized=homogenized)
            half = float(cell["rate_ci"][1] - cell["rate_ci"][0]) / 2
            # Curves bend at small n: the exact curves by at most 0.12 over these counts
            assert abs(float(cell["rate"]) - rate) < WITHIN / 1.96 * half + 0.12


def test_exact_variances_of_the_study():
    kept = ["original", "uniform"]
    study = mcs.improve.mirror_study(
        SMOOTH_1D, "jittered", [2, 4], mirrorings=kept, realizations=20, exact=True
    )
    assert study["exact_variance"].dims == ("mirroring", "homogenized", "n")
    cell = study["exact_variance"].sel(mirroring="uniform", homogenized=True, n=4)
    uniform = mcs.Mirrored(SMOOTH_1D, "uniform")
    assert float(cell) == mcs.exact_variance(uniform, "jittered | shift", 4)
    blank = mcs.improve.mirror_study(SMOOTH_1D, "poisson-disk", [4], realizations=2, exact=True)
    assert np.isnan(blank["exact_variance"]).all()


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"mirrorings": []}, "each once"),
        ({"mirrorings": ["random", "random"]}, "each once"),
        ({"mirrorings": "random"}, "give a list"),
        ({"mirrorings": ["fold"]}, "original, integrand, random, uniform"),
        ({"sampler": "jittered | shift"}, "already homogenized"),
        ({"counts": [9]}, "cannot make"),
        ({"counts": []}, "one or more"),
        ({"realizations": 1}, "realizations is 1"),
    ],
)
def test_bad_input_of_the_study(keywords, words):
    given = {"sampler": "jittered", "counts": [16], **keywords}
    with pytest.raises(ParameterError, match=words):
        mcs.improve.mirror_study(SMOOTH, **given)


def test_dims_are_those_of_the_estimator():
    """Earlier versions ignored these dims."""
    plain = mcs.Estimator("linear", dims=2)
    assert mcs.Mirrored(plain, dims=2).dims == 2
    with pytest.raises(ParameterError, match=r"dims is 3, but linear.* has 2 dims"):
        mcs.Mirrored(plain, dims=3)
