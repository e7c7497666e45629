"""All methods agree: deterministic ones exactly, sampled ones within their errors."""

import functools
import itertools
import math

import numpy as np
import pytest
from scipy.special import ndtri
from tests.prediction.unlimited import predict

import mcspectra as mcs
from mcspectra.core.analysis import Subject
from mcspectra.core.errors import NoClosedForm, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.prediction.known import Known
from mcspectra.prediction.prediction import (
    METHODS,
    NAMES,
    ExtrapolationSettings,
    Prediction,
    TableSettings,
    predicted,
)

PREDICTIONS = list(NAMES)[1:7]


@pytest.fixture(autouse=True)
def small(use_settings, few_products, few_offsets, few_probes):
    """Draw fewer sets and use coarser tables, so that sampled methods have wider intervals.

    Sums of products are small as well: tests of the fit are in test_subsets.
    """
    use_settings(
        table=TableSettings(cells={1: 2**12, 2: 2**7, 3: 2**5}, points=2**18),
        extrapolated=ExtrapolationSettings(sets=500, near_sets=250, near_points=2**14),
    )


CHECKS = {"exact", *list(NAMES)[7:]}

REALIZATIONS = 1500
WAVE, WAVES = "cosine(frequency=3)", "cosine(frequency=[1, 2])"
BELL = "gaussian(center=0.3)"
LINE, PLANE = "linear(slope=1)", "linear(slope=[1, -0.5])"

# Integrands of few frequencies, so that nothing is truncated; the list of methods is part of the
# test
CASES = [
    (WAVE, None, "random", 1, 5, CHECKS),
    (WAVE, LINE, "random", 1, 5, CHECKS - {"homogenized"}),
    (WAVE, None, "jittered", 1, 8, CHECKS - {"homogenized"}),
    pytest.param(WAVE, LINE, "jittered", 1, 7, CHECKS - {"homogenized"}, marks=pytest.mark.slow),
    (WAVE, None, "jittered | shift", 1, 8, CHECKS),
    (WAVE, LINE, "jittered | shift", 1, 8, CHECKS - {"homogenized"}),
    (WAVE, LINE, "uniform-jitter", 1, 2, {"exact", "covariance", "terms", "measured"}),
    (WAVES, None, "jittered", 2, 16, CHECKS - {"homogenized"}),
    pytest.param(WAVES, PLANE, "jittered", 2, 9, CHECKS - {"homogenized"}, marks=pytest.mark.slow),
    pytest.param(WAVES, None, "jittered | shift", 2, 16, CHECKS, marks=pytest.mark.slow),
    pytest.param(
        *(WAVES, PLANE, "latin-hypercube | shift", 2, 3),
        CHECKS - {"homogenized"},
        marks=pytest.mark.slow,
    ),
    pytest.param(
        *(WAVES, PLANE, "latin-hypercube", 2, 4),
        {"exact", "covariance", "terms", "measured"},
        marks=pytest.mark.slow,
    ),
    (WAVES, None, "latin-hypercube", 2, 7, {"exact", "covariance", "terms", "measured"}),
    pytest.param(*(WAVES, None, "latin-hypercube | shift", 2, 4, CHECKS), marks=pytest.mark.slow),
    (WAVE, None, "latin-hypercube | shift", 1, 4, CHECKS),
    pytest.param(
        WAVES, None, "multi-jittered | shift", 2, 16, CHECKS - {"exact"}, marks=pytest.mark.slow
    ),
    (WAVE, None, "perturbed-lattice", 1, 5, CHECKS - {"exact"}),
    pytest.param(
        WAVES, None, "perturbed-lattice", 2, 9, CHECKS - {"exact"}, marks=pytest.mark.slow
    ),
    pytest.param(
        *(WAVES, None, "poisson-disk", 2, 12),
        {"pair-correlation", "homogenized", "terms", "measured"},
        marks=pytest.mark.slow,
    ),
    (WAVES, None, "sobol | owen", 2, 8, {"exact", "covariance", "terms", "measured"}),
    pytest.param(
        *(WAVES, PLANE, "sobol | digital-shift", 2, 8),
        {"exact", "terms", "measured"},
        marks=pytest.mark.slow,
    ),
    (WAVES, PLANE, "sobol | digital-shift", 2, 4, {"exact", "terms", "measured"}),
]


def _table(estimator, sampler, n, **options):
    return predict(estimator, sampler, [n], method="all", **options).isel(n=0)


def _values(table):
    return dict(zip(NAMES, table["predicted_variance"].values.tolist(), strict=True))


def _of(table, name, method):
    return float(table[name].sel({"method": method}))


def _standard_errors(table):
    """Return half widths of 95 % intervals, the longer side, as standard errors."""
    ends = table["predicted_variance_ci"].values
    half = np.abs(ends - table["predicted_variance"].values[:, None]).max(axis=1)
    return dict(zip(NAMES, half / ndtri(0.975), strict=True))


@pytest.mark.parametrize(("f", "p", "spec", "dims", "n", "methods"), CASES)
def test_all_methods_agree(f, p, spec, dims, n, methods):
    """Pairs of methods differ by at most their combined errors, Šidák over all comparisons.

    `measured` and `terms` use the same realizations, and give the same number, as no frequency is
    truncated.
    """
    estimator = mcs.Estimator(mcs.integrand(f, dims=dims), p)
    # With a tolerance of 1e-6, a quadrature for each offset of a Latin hypercube takes minutes
    options = {"tolerance": 1e-5, "half_width": 4, "realizations": REALIZATIONS, "rng": 8}
    table = _table(estimator, mcs.sampler(spec, dims=dims), n, **options)
    value, se = _values(table), _standard_errors(table)
    found = {method for method in CHECKS if not math.isnan(value[method])}
    assert found == methods
    names = {"method": sorted(found)}
    np.testing.assert_allclose(table["energy_share"].sel(names), 1.0, rtol=1e-9)
    assert value["terms"] == pytest.approx(value["measured"], rel=1e-9)
    assert any(not math.isnan(value[method]) for method in PREDICTIONS)
    limit = -ndtri(0.5 * (1 - (1 - 1e-3) ** (1 / (5 * len(CASES)))))
    for a, b in itertools.combinations(sorted(found - {"terms"}), 2):
        both = math.hypot(se[a], se[b])
        # Exact methods: quadrature to 1e-6, the table of an autocorrelation to 1e-4 of its
        # curvature
        assert abs(value[a] - value[b]) <= limit * both + 2e-6 * value[a], (a, b)
    for method in set(PREDICTIONS) - {"extrapolated"}:
        if "exact" in found and not math.isnan(value[method]):
            assert abs(value[method] - value["exact"]) <= 2.5 * se[method] + 2e-6 * value["exact"]


def test_deterministic_methods_are_certain_and_sampled_ones_are_not():
    table = _table(mcs.integrand(WAVE, dims=1), "jittered | shift", 4, half_width=16, rng=1)
    width = table["predicted_variance_ci"].diff("bound").squeeze("bound")
    assert (width.sel({"method": ["covariance", "homogenized"]}) == 0).all()
    assert 0 < _of(width.to_dataset(name="w"), "w", "exact") < 2e-6 * _values(table)["exact"]
    assert (width.sel({"method": ["pair-correlation", "terms", "measured"]}) > 0).all()
    # The mean of f does not change the variance
    raised = mcs.Integrand.from_function(lambda x: 2 + np.cos(6 * np.pi * x[..., 0]), dims=1)
    again = predict(raised, "jittered | shift", [4], method="homogenized", half_width=16)
    expected = _of(table, "predicted_variance", "homogenized")
    np.testing.assert_allclose(again["predicted_variance"][0], expected, rtol=1e-9)


def test_a_cut_spectrum_says_so_and_misses_no_more_than_the_rest_allows():
    """Jittered: |√V − √V_K| ≤ √(‖f − f_K‖²/n), the standard deviation of the truncated part."""
    f, n = mcs.integrand(BELL, dims=1), 8
    table = predict(f, "jittered", [n], method="covariance", half_width=8).isel(n=0)
    share = float(table["energy_share"])
    square = mcs.integrand(f"{BELL}", dims=1)
    whole = mcs.Integrand.from_function(lambda x: square(x) ** 2, dims=1).integral
    assert 0.99 < share < 1.0
    exact, cut = mcs.exact_variance(f, "jittered", n), float(table["predicted_variance"])
    assert abs(math.sqrt(exact) - math.sqrt(cut)) <= math.sqrt((1 - share) * whole / n)
    assert abs(exact - cut) > 0.1 * exact  # The border of the torus is a jump
    wide = predict(f, "jittered", [n], method="covariance", half_width=256)
    assert abs(exact - float(wide["predicted_variance"][0])) < 0.05 * abs(exact - cut)


def test_channels_and_techniques():
    two = mcs.Integrand.from_function(
        lambda x: np.stack(
            [np.cos(2 * np.pi * x[..., 0]), 1 + np.sin(4 * np.pi * x[..., 0])], axis=-1
        ),
        dims=1,
    )
    table = _table(two, "jittered", 6, half_width=4, realizations=200, rng=4)
    value = table["predicted_variance"]
    assert value.dims == ("method", "channel")
    exact = value.sel({"method": "exact"})
    np.testing.assert_allclose(value.sel({"method": "covariance"}), exact, rtol=1e-6)
    mis = mcs.MultipleImportance(mcs.integrand(WAVE, dims=1), ["uniform", LINE])
    of_mis = _table(mis, "jittered", 6, half_width=4, realizations=200, rng=4)
    assert "one technique" in str(of_mis["how"].sel({"method": "covariance"}).item())
    assert _values(of_mis)["pair-correlation"] == pytest.approx(_values(of_mis)["exact"], rel=1e-5)
    parts = mcs.estimators.TechniqueSum([mcs.integrand(WAVE, dims=1), mcs.integrand(BELL, dims=1)])
    of_parts = _table(parts, "jittered", 6, half_width=4, realizations=200, rng=4)
    assert np.isnan(_of(of_parts, "energy_share", "terms"))


def test_infinite_weights_go_by_primary_space():
    """f = x², p = 2x: Var(S_0) is infinite, but the variance is 1/(72 n)."""
    f = mcs.Integrand.from_function(lambda x: x[..., 0] ** 2, dims=1, integral=1 / 3)
    estimator = mcs.Estimator(f, "linear(slope=2)")
    table = _table(estimator, "random", 5, half_width=64, realizations=400, rng=4)
    assert _values(table)["exact"] == pytest.approx(1 / 360, rel=1e-6)
    assert "primary" in str(table["how"].sel({"method": "terms"}).item())
    assert "diverges" in str(table["how"].sel({"method": "covariance"}).item())


def test_a_method_fails_alone():
    """∫f²/p diverges: methods without spectra report it, the others give values or reasons."""
    estimator = mcs.Estimator(
        mcs.integrand("cosine(frequency=1)", dims=1), mcs.density("power(exponent=1)", dims=1)
    )
    sampler = mcs.sampler("random", dims=1)
    table = _table(estimator, sampler, 16, half_width=16, realizations=50, rng=3)
    value = _values(table)
    assert value["exact"] == value["pair-correlation"] == np.inf
    assert np.isnan([value["covariance"], value["homogenized"], value["torus"]]).all()
    assert np.isfinite([value["terms"], value["measured"]]).all()
    assert "∫1/p diverges" in table["how"].sel({"method": "covariance"}).item()


def test_several_samplers_and_counts_by_all_methods():
    """Each sampler has a block; rows equal single calls, and rates follow along n."""
    options = {"half_width": 4, "realizations": 100, "rng": 5}
    wave = mcs.integrand(WAVES, dims=2)
    found = predict(wave, ["random", "jittered"], [4, 16], method="all", **options)
    assert found["predicted_variance"].dims == ("sampler", "method", "n")
    assert found["how"].dims == ("sampler", "method", "n")
    assert found["predicted_rate"].dims == ("sampler", "method")
    one = predict(wave, "jittered", [16], method="all", **options)
    both = found.sel(sampler="jittered", n=[16])
    for name in ("predicted_variance", "predicted_variance_ci", "energy_share", "tail_variance"):
        np.testing.assert_array_equal(both[name], one[name])
    rate = found["predicted_rate"].sel({"sampler": "random", "method": "exact"})
    assert float(rate) == pytest.approx(-1.0, abs=1e-6)
    threads = predict(wave, ["random", "jittered"], [4, 16], method="all", workers=2, **options)
    assert found.equals(threads)


@functools.cache
def _of_three(method):
    samplers = ["jittered", "jittered | shift", "sobol | digital-shift"]
    return predict("gaussian", samplers, [16], method=method, half_width=4, realizations=50, rng=5)


@pytest.mark.parametrize("method", NAMES)
def test_one_method_is_its_row_of_all(method):
    """Equal up to rounding: `measured` alone draws no spectra, so its blocks may differ."""
    table, found = _of_three("all"), _of_three(method)
    assert "method" not in found.dims
    row = table.sel({"method": method})
    there = ~np.isnan(row["predicted_variance"].values)
    assert there.any()
    for name in ("predicted_variance", "predicted_variance_ci", "energy_share"):
        np.testing.assert_allclose(found[name], row[name], rtol=1e-12)
    assert (found["method"].values == np.where(there, method, "none")).all()
    assert (found["how"].values == row["how"].values).all()


def test_exact_is_exact_variance_with_the_error_of_its_quadrature():
    f = mcs.integrand("gaussian(width=0.3)", dims=2)
    found = predict(f, ["jittered", "poisson-disk"], [16, 64], method="exact")
    for k, n in enumerate((16, 64)):
        value = mcs.exact_variance(f, "jittered", n)
        assert float(found["predicted_variance"][0, k]) == pytest.approx(value, rel=1e-12)
        low, high = found["predicted_variance_ci"].values[0, k]
        assert low <= value <= high < low + 2e-6 * value
    assert np.isnan(found["predicted_variance"].values[1]).all()
    assert found.attrs["note"].startswith("poisson-disk: No exact variance is known")
    assert found["method"].values.tolist() == [["exact"] * 2, ["none"] * 2]
    # A tolerance that a disk cut by strata does not reach, and one that it reaches
    disk = "disk(center=0.4, radius=0.2)"
    tilted = mcs.Estimator(disk, "linear(slope=1.5)", dims=2)
    assert np.isnan(predict(tilted, "random", [4], method="exact")["predicted_variance"]).all()
    loose = predict(tilted, "random", [4], method="exact", tolerance=0.1)
    assert float(loose["predicted_variance"][0]) > 0.0


@pytest.mark.parametrize(
    ("sampler", "method", "words"),
    [
        ("sobol | owen", "torus", "torus does not apply to gaussian with sobol . owen"),
        ("poisson-disk", "levels", "levels does not apply"),
        ("jittered", "homogenized", "add shift"),
        ("poisson-disk", "covariance", "closed-form power"),
        ("sobol", "measured", ""),
    ],
)
def test_a_method_that_does_not_apply_is_refused(sampler, method, words):
    def asked():
        return predict("gaussian", sampler, [16], method=method, realizations=8, half_width=2)

    if words:
        with pytest.raises(NoClosedForm, match=words):
            asked()
    else:  # The method applies, but has no value
        assert float(asked()["predicted_variance"][0]) == 0.0


def test_the_docstring_lists_all_names():
    assert all(f'``"{name}"``: ' in mcs.predict.__doc__ for name in NAMES)


def test_names_and_frequencies_are_refused_in_a_sentence():
    with pytest.raises(ParameterError, match=r"method is 'toru'.*Did you mean 'torus'"):
        predict("gaussian", "random", [4], method="toru")
    six = mcs.integrand("gaussian", dims=6), mcs.sampler("random", dims=6), [4]
    with pytest.raises(ParameterError, match="frequencies"):
        predict(*six, method="terms", half_width=32)
    table = predict(*six, method="all", half_width=32, realizations=8)
    assert "frequencies" in table["how"].sel({"method": "terms"}).item()
    assert float(table["predicted_variance"].sel({"method": "measured", "n": 4})) > 0.0


def _silent(dims):
    """Return a function that raises if it is evaluated."""

    def values(x):
        if made:
            raise AssertionError("the function was called")
        return x[..., 0]

    made = []
    f = mcs.Integrand.from_function(values, dims=dims)
    made.append(f)
    return f


SAMPLERS = ["random", "jittered | shift", "latin-hypercube", "sobol | owen",
            "sobol | digital-shift", "rank1-lattice | shift", "jittered | mirror",
            "poisson-disk"]  # fmt: skip


@pytest.mark.parametrize("dims", [2, 4])
def test_what_methods_apply_to_and_cost_is_known_without_evaluations(dims):
    f = _silent(dims)
    samplers = SAMPLERS[: -1 if dims > 2 else None]
    for spec in samplers:
        law, known = mcs.sampler(spec, dims).law(256), Known(f)
        usable = [method for method in METHODS if method.applies(law, known)]
        assert usable, spec
        assert all(method.predict is not None for method in usable)
        assert all(method.cost(law, known) >= 0.0 for method in METHODS)
        subject = Subject(mcs.Estimator(f), mcs.sampler(spec, dims))
        for name in ("auto", *NAMES[:7]):
            found = Prediction(counts=(256,), method=name, max_evaluations=2**40)
            assert found.need(subject).cost >= 1e6


def test_auto_takes_the_first_that_is_narrow_enough_else_the_narrowest():
    """In four dims products miss a ball, so offsets of the lattice are also tried."""
    ball = mcs.Integrand.from_function(
        lambda x: 1.0 * (((x - 0.5) ** 2).sum(axis=-1) < 0.2),
        dims=4,
        integral=math.pi**2 / 2 * 0.2**2,
    )
    law, known = mcs.sampler("rank1-lattice | shift", 4).law(64), Known(ball)
    by_name = {
        name: predicted(law, known, Stream.from_rng(0), name) for name in ("subsets", "moves")
    }
    assert (by_name["subsets"].error > 0.03 * by_name["subsets"].variance).all()
    best = predicted(law, known, Stream.from_rng(0), "auto")
    narrowest = min(by_name.values(), key=lambda each: each.error.sum())
    assert best.method == narrowest.method
    np.testing.assert_array_equal(best.variance, narrowest.variance)
    integral = (math.e - 1) ** 4  # Declared, because its quadrature takes long
    smooth = Known(
        mcs.Integrand.from_function(lambda x: np.exp(x.sum(axis=-1)), dims=4, integral=integral)
    )
    assert predicted(law, smooth, Stream.from_rng(0), "auto").method == "subsets"
