"""Variances from pairs of points: strata quadrature, formulas and simulation."""

import tracemalloc

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.ndimage import map_coordinates
from tests.prediction.unlimited import predict

import mcspectra as mcs
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.core.errors import NoClosedForm
from mcspectra.measure._kernels import pair_sum_1d, pair_sum_2d


@pytest.fixture(autouse=True)
def small(few_probes):
    """Search functions for details at few points; none of them has small details."""


MIS = mcs.MultipleImportance(
    mcs.integrand("gaussian(width=0.25)", dims=1),
    [mcs.density("linear(slope=1)", dims=1), mcs.density("linear(slope=-1)", dims=1)],
    counts=(1, 2),
)


def by_pairs(estimator, sampler, n, **options):
    return predict(estimator, sampler, [n], method="pair-correlation", **options).isel(n=0)


def se_of(found):
    low, high = np.moveaxis(found["predicted_variance_ci"].values, -1, 0)
    with np.errstate(invalid="ignore"):  # Both infinite
        return np.where(low == high, 0.0, high - low) / (2 * CONFIDENCE_Z)


def within(found, expected, expected_se=0.0, sigmas=4.0):
    error = abs(float(found["predicted_variance"]) - expected)
    return error <= sigmas * np.hypot(float(se_of(found)), expected_se)


def simulated(estimator, sampler, n, realizations=4000):
    d = mcs.convergence(estimator, sampler, [n], realizations=realizations, rng=77)
    low, high = d["variance_ci"].values[0]
    variance = float(d["variance"][0])
    return variance, variance * np.log(high / low) / (2 * 1.959963984540054)


@pytest.mark.parametrize(("add", "dims"), [(pair_sum_1d, 1), (pair_sum_2d, 2)])
def test_pair_sums_are_linear_between_entries(add, dims):
    generator = np.random.default_rng(1)
    points, table = generator.random((30, dims)), generator.random((5,) * dims)
    points[:5] = np.round(points[:5] * 5) / 5 % 1  # Differences at the entries, and 0
    differences = np.array([points[a] - points[b] for a in range(30) for b in range(a)])
    expected = map_coordinates(table, (differences % 1 * 5).T, order=1, mode="grid-wrap").sum()
    assert add(points, table) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("estimator", "spec", "dims", "n"),
    [
        ("linear", "random", 1, 5),
        ("linear", "jittered", 2, 16),
        ("gaussian(width=0.25)", "jittered", 3, 27),
        ("gaussian(width=0.25)", "jittered(sides=[2, 6])", 2, 12),
        (mcs.Estimator("gaussian", density="linear(slope=1)", dims=1), "jittered", 1, 7),
        (MIS, "jittered", 1, 4),
        (MIS, "random", 1, 4),
        ("disk", "random | shift", 2, 32),
    ],
)
def test_known_pairs_give_the_variance_of_strata_quadrature(estimator, spec, dims, n):
    if isinstance(estimator, str):
        estimator = mcs.Estimator(estimator, dims=dims)
    sampler = mcs.sampler(spec, dims=dims)
    found = by_pairs(estimator, sampler, n)
    exact = mcs.exact_variance(estimator, sampler, n)
    np.testing.assert_allclose(found["predicted_variance"], exact, rtol=1e-6)
    assert float(se_of(found)) == 0.0
    assert found["how"].item() == "pairs known"


@pytest.mark.parametrize(
    ("estimator", "spec", "dims", "n"),
    [
        ("linear", "jittered | shift", 1, 8),
        ("gaussian(width=0.25)", "jittered | shift", 2, 16),
        pytest.param("linear", "jittered | shift", 2, 64, marks=pytest.mark.slow),
        (MIS, "jittered | shift", 1, 4),
    ],
)
def test_counted_pairs_agree_with_the_exact_variance(estimator, spec, dims, n):
    if isinstance(estimator, str):
        estimator = mcs.Estimator(estimator, dims=dims)
    sampler = mcs.sampler(spec, dims=dims)
    found = by_pairs(estimator, sampler, n, realizations=2000, rng=3)
    assert found["how"].item() == "pairs of 2000 sets counted"
    if spec.startswith("random"):
        exact = mcs.integrand("disk").integral * (1 - mcs.integrand("disk").integral) / n
    else:
        exact = mcs.exact_variance(estimator, sampler, n)
    assert within(found, exact)
    assert float(se_of(found)) < 0.1 * exact


@pytest.mark.parametrize(
    ("spec", "n", "integrand"),
    [("poisson-disk", 64, "disk"), ("sobol | owen | shift", 16, "gaussian(width=0.25)")],
)
def test_counted_pairs_agree_with_simulation(spec, n, integrand):
    estimator = mcs.Estimator(integrand, dims=2)
    found = by_pairs(estimator, spec, n, rng=3)
    assert within(found, *simulated(estimator, spec, n, realizations=2000))


def _weighted(integrand, density, dims=1):
    return mcs.Estimator(mcs.integrand(integrand, dims=dims), mcs.density(density, dims=dims))


@pytest.mark.parametrize(
    ("estimator", "power", "spec", "n"),
    [
        # g = x²/2x at x = √u: Var g = 1/72; strata of √u/2 are computed by hand below
        ("square", None, "random", 16),
        ("square", None, "jittered", 16),
        pytest.param("gaussian(center=0.3)", 0.5, "random", 16, marks=pytest.mark.slow),
        ("gaussian(center=0.3)", 0.8, "random", 4),
    ],
)
def test_poles_and_roots_of_g_are_integrated_to_1e_6(estimator, power, spec, n):
    """Compare with one-dimensional quadrature with the substitution that removes the root."""
    if power is None:
        f = mcs.Integrand.from_function(lambda x: x[..., 0] ** 2, dims=1)
        estimator = mcs.Estimator(f, mcs.density("power(exponent=1)", dims=1))
        edges = np.arange(n + 1) / n if spec == "jittered" else np.array([0.0, 1.0])
        strata = np.diff(edges**1.5) / 3  # ∫√u/2
        truth = (1 / 8 - (strata**2).sum() * (n if spec == "jittered" else 1)) / n
    else:

        def g2(x):
            return float(mcs.integrand("gaussian(center=0.3)", dims=1)(np.array([x]))) ** 2

        # ∫f²/p with p = (1 + a) x^a, and x = t^(1/(1−a)): dx x^-a = dt/(1 − a)
        square = quad(lambda t: g2(t ** (1 / (1 - power))), 0, 1, epsabs=0, epsrel=1e-12)[0]
        square /= (1 - power) * (1 + power)
        mean = float(mcs.integrand("gaussian(center=0.3)", dims=1).integral)
        truth = (square - mean**2) / n
        estimator = _weighted(estimator, f"power(exponent={power})")
    found = by_pairs(estimator, mcs.sampler(spec, dims=1), n)
    assert float(found["predicted_variance"]) == pytest.approx(truth, rel=1e-6)
    assert float(se_of(found)) == 0.0


@pytest.mark.parametrize(
    ("estimator", "dims", "spec"),
    [
        (_weighted("gaussian(center=0.3)", "tent"), 1, "jittered"),  # g² ~ 1/u at both ends
        (_weighted("cosine", "power(exponent=1)"), 1, "jittered"),
        (_weighted("cosine", "power(exponent=1.5)"), 1, "random"),
        (_weighted("gaussian(center=0.3)", "power(exponent=1)", 2), 2, "random"),
    ],
)
def test_variances_are_infinite_where_the_square_diverges(estimator, dims, spec):
    sampler = mcs.sampler(spec, dims=dims)
    found = by_pairs(estimator, sampler, 16)
    assert float(found["predicted_variance"]) == np.inf
    assert float(se_of(found)) == 0.0
    assert mcs.exact_variance(estimator, sampler, 16) == np.inf


def test_infinite_variances_of_shifted_sets():
    estimator = _weighted("cosine", "power(exponent=1)")
    sampler = mcs.sampler("jittered | shift", dims=1)
    assert mcs.exact_variance(estimator, sampler, 4) == np.inf


def test_one_infinite_channel_leaves_the_other():
    f = mcs.Integrand.from_function(lambda x: np.stack([1 + 0 * x[..., 0], x[..., 0]], -1), dims=1)
    estimator = mcs.Estimator(f, mcs.density("power(exponent=1)", dims=1))
    found = by_pairs(estimator, mcs.sampler("random", dims=1), 4)
    assert found["predicted_variance"].values[0] == np.inf
    assert found["predicted_variance"].values[1] == pytest.approx(0.0, abs=1e-15)  # g = 1/2


def test_pairs_that_do_not_converge_are_refused():
    """A disk's border crosses cells, where fixed rules have an error of 3 %."""
    estimator = mcs.Estimator("disk(center=0.4, radius=0.2)", "linear(slope=1.5)", dims=2)
    with pytest.raises(NoClosedForm, match=r"has an error of .* in a variance"):
        by_pairs(estimator, "jittered", 64)


def test_many_strata_take_little_memory():
    """Earlier matrices of nodes × cells took 8 GiB here."""
    estimator = _weighted("linear", "exponential(rate=3)")
    sampler = mcs.sampler("jittered", dims=1)
    tracemalloc.start()
    found = by_pairs(estimator, sampler, 4096)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**28
    assert float(found["predicted_variance"]) == pytest.approx(
        mcs.exact_variance(estimator, sampler, 4096), rel=1e-6
    )


def test_channels_are_kept():
    f = mcs.Integrand.from_function(
        lambda x: np.stack([x[..., 0], 2 * x[..., 0], x[..., 0] ** 2], axis=-1), dims=1
    )
    for spec in ("jittered", "jittered | shift"):
        sampler = mcs.sampler(spec, dims=1)
        found = by_pairs(mcs.Estimator(f), sampler, 4, realizations=50)
        assert found["predicted_variance"].dims == ("channel",)
        first, second, _ = found["predicted_variance"].values
        assert second == pytest.approx(4 * first, rel=1e-9)
        assert se_of(found).shape == (3,)


def test_workers_do_not_matter():
    arguments = ("gaussian", "jittered | shift", 16)
    one = by_pairs(*arguments, realizations=20, workers=1)
    many = by_pairs(*arguments, realizations=20, workers=3)
    assert one.equals(many)
