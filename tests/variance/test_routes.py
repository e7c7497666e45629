"""All routes to a variance agree: deterministic ones exactly, sampled ones within their errors."""

import itertools
import math

import numpy as np
import pytest
from scipy import stats

import mcspectra as mcs
from mcspectra.variance.routes import ROUTES

REALIZATIONS = 1500
WAVE, WAVES = "cosine(frequency=3)", "cosine(frequency=[1, 2])"
BELL = "gaussian(center=0.3)"
LINE, PLANE = "linear(slope=1)", "linear(slope=[1, -0.5])"

# Integrands of few frequencies, so that nothing is cut off; which routes there are is part of the test.
CASES = [
    (WAVE, None, "random", 1, 5, set(ROUTES)),
    (WAVE, LINE, "random", 1, 5, set(ROUTES) - {"homogenized"}),
    (WAVE, None, "jittered", 1, 8, set(ROUTES) - {"homogenized"}),
    (WAVE, LINE, "jittered", 1, 7, set(ROUTES) - {"homogenized"}),
    (WAVE, None, "jittered | shift", 1, 8, set(ROUTES)),
    (WAVE, LINE, "jittered | shift", 1, 8, set(ROUTES) - {"homogenized"}),
    (WAVE, LINE, "uniform-jitter", 1, 2, {"exact", "covariance", "spectral", "measured"}),
    (WAVES, None, "jittered", 2, 16, set(ROUTES) - {"homogenized"}),
    (WAVES, PLANE, "jittered", 2, 9, set(ROUTES) - {"homogenized"}),
    (WAVES, None, "jittered | shift", 2, 16, set(ROUTES)),
    (WAVES, PLANE, "latin-hypercube | shift", 2, 3, set(ROUTES) - {"homogenized"}),
    (WAVES, PLANE, "latin-hypercube", 2, 4, {"exact", "covariance", "spectral", "measured"}),
    (WAVES, None, "latin-hypercube", 2, 7, {"exact", "covariance", "spectral", "measured"}),
    (WAVES, None, "latin-hypercube | shift", 2, 4, set(ROUTES)),
    (WAVES, None, "multi-jittered | shift", 2, 16, set(ROUTES) - {"exact"}),
    (WAVES, None, "perturbed-lattice", 2, 9, set(ROUTES) - {"exact"}),
    (WAVES, None, "poisson-disk", 2, 12, {"pairs", "homogenized", "spectral", "measured"}),
    (WAVES, None, "sobol | owen", 2, 8, {"exact", "spectral", "measured"}),
    (WAVES, PLANE, "sobol | digital-shift", 2, 8, {"exact", "spectral", "measured"}),
]


def _standard_errors(table):
    """Of the logarithm for routes whose interval is that of a variance, else of the value."""
    low, high = np.moveaxis(table["route_variance_ci"].values, -1, 0)
    return (high - low) / (2 * stats.norm.ppf(0.975))


@pytest.mark.parametrize(("f", "p", "spec", "dims", "n", "routes"), CASES)
def test_all_routes_agree(f, p, spec, dims, n, routes):
    """Pairs of routes differ by no more than their errors together; Šidák over all comparisons.

    Measured and spectral are of the same realisations, and the same number: no frequency is cut off.
    """
    estimator = mcs.Estimator(mcs.integrand(f, dims=dims), p)
    table = mcs.variance_routes(
        estimator, mcs.sampler(spec, dims=dims), n, half_width=4, realizations=REALIZATIONS, rng=8
    )
    value = dict(zip(ROUTES, table["route_variance"].values.tolist(), strict=True))
    se = dict(zip(ROUTES, _standard_errors(table).tolist(), strict=True))
    found = {route for route in ROUTES if not math.isnan(value[route])}
    assert found == routes
    np.testing.assert_allclose(table["energy_share"].sel(route=sorted(found)), 1.0, rtol=1e-9)
    assert value["spectral"] == pytest.approx(value["measured"], rel=1e-9)
    limit = stats.norm.isf(0.5 * (1 - (1 - 1e-3) ** (1 / (5 * len(CASES)))))
    for a, b in itertools.combinations(sorted(found - {"spectral"}), 2):
        both = math.hypot(se[a], se[b])
        # Exact routes: quadrature to 1e-6, the table of an autocorrelation to 1e-4 of its curvature
        assert abs(value[a] - value[b]) <= limit * both + 2e-6 * value[a], (a, b)


def test_deterministic_routes_are_certain_and_sampled_ones_are_not():
    table = mcs.variance_routes(mcs.integrand(WAVE, dims=1), "jittered | shift", 4, rng=1)
    width = table["route_variance_ci"].diff("bound").squeeze("bound")
    certain = ["exact", "covariance", "homogenized"]
    assert (width.sel(route=certain) == 0).all()
    assert (width.sel(route=["pairs", "spectral", "measured"]) > 0).all()
    # The mean of f has no part in the variance
    raised = mcs.Integrand.from_function(lambda x: 2 + np.cos(6 * np.pi * x[..., 0]), dims=1)
    again = mcs.variance_routes(raised, "jittered | shift", 4, rng=1)["route_variance"]
    expected = table["route_variance"].sel(route="homogenized")
    np.testing.assert_allclose(again.sel(route="homogenized"), expected, rtol=1e-9)


def test_a_cut_spectrum_says_so_and_misses_no_more_than_the_rest_allows():
    """Jittered: |√V − √V_K| ≤ √(‖f − f_K‖²/n), the deviation of what is cut off, at most random's."""
    f, n = mcs.integrand(BELL, dims=1), 8
    table = mcs.variance_routes(f, "jittered", n, half_width=8, realizations=400, rng=2)
    share = float(table["energy_share"].sel(route="covariance"))
    square = mcs.integrand(f"{BELL}", dims=1)
    whole = mcs.Integrand.from_function(lambda x: square(x) ** 2, dims=1).integral
    assert 0.99 < share < 1.0
    exact, cut = (float(table["route_variance"].sel(route=r)) for r in ("exact", "covariance"))
    assert abs(math.sqrt(exact) - math.sqrt(cut)) <= math.sqrt((1 - share) * whole / n)
    assert abs(exact - cut) > 0.1 * exact  # the border of the torus is a jump
    wide = mcs.variance_routes(f, "jittered", n, half_width=256, realizations=400, rng=2)
    far = float(wide["route_variance"].sel(route="covariance"))
    assert abs(exact - far) < 0.05 * abs(exact - cut)


def test_channels_and_techniques():
    two = mcs.Integrand.from_function(
        lambda x: np.stack(
            [np.cos(2 * np.pi * x[..., 0]), 1 + np.sin(4 * np.pi * x[..., 0])], axis=-1
        ),
        dims=1,
    )
    table = mcs.variance_routes(two, "jittered", 6, half_width=4, realizations=200, rng=4)
    assert table["route_variance"].dims == ("route", "channel")
    value = table["route_variance"]
    np.testing.assert_allclose(value.sel(route="covariance"), value.sel(route="exact"), rtol=1e-6)
    mis = mcs.MultipleImportance(mcs.integrand(WAVE, dims=1), ["uniform", LINE])
    of_mis = mcs.variance_routes(mis, "jittered", 6, half_width=4, realizations=200, rng=4)
    assert "one technique" in str(of_mis["source"].sel(route="covariance").item())
    assert float(of_mis["route_variance"].sel(route="pairs")) == pytest.approx(
        float(of_mis["route_variance"].sel(route="exact")), rel=1e-5
    )
    parts = mcs.estimators.TechniqueSum([mcs.integrand(WAVE, dims=1), mcs.integrand(BELL, dims=1)])
    of_parts = mcs.variance_routes(parts, "jittered", 6, half_width=4, realizations=200, rng=4)
    assert np.isnan(of_parts["energy_share"].sel(route="spectral"))


def test_infinite_weights_go_by_primary_space():
    """f = x², p = 2x: Var(S_0) is infinite, the variance 1/(72 n) is not."""
    f = mcs.Integrand.from_function(lambda x: x[..., 0] ** 2, dims=1, integral=1 / 3)
    table = mcs.variance_routes(
        mcs.Estimator(f, "linear(slope=2)"), "random", 5, half_width=64, realizations=400, rng=4
    )
    assert float(table["route_variance"].sel(route="exact")) == pytest.approx(1 / 360, rel=1e-6)
    assert "primary" in str(table["source"].sel(route="spectral").item())
    assert "diverges" in str(table["source"].sel(route="covariance").item())


def test_a_route_fails_alone():
    """∫f²/p diverges: the routes without spectra say so, and the others are there or say why."""
    estimator = mcs.Estimator(
        mcs.integrand("cosine(frequency=1)", dims=1), mcs.density("power(exponent=1)", dims=1)
    )
    sampler = mcs.sampler("random", dims=1)
    table = mcs.variance_routes(estimator, sampler, 16, realizations=50, rng=3)
    value = dict(zip(ROUTES, table["route_variance"].values.tolist(), strict=True))
    assert value["exact"] == value["pairs"] == np.inf
    assert np.isnan([value["covariance"], value["homogenized"]]).all()
    assert np.isfinite([value["spectral"], value["measured"]]).all()
    assert "∫1/p diverges" in table["source"].sel(route="covariance").item()
