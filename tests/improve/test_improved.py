"""Estimators that are changed after a pilot: unbiased, as good as expected, and recommended."""

import itertools
import math
from functools import cache

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.estimators import Mirrored
from mcspectra.improve.candidates import Budget, candidates_of
from mcspectra.improve.improved import (
    CHANGES,
    ChangeSettings,
    Cubic,
    Evaluations,
    Periodized,
    evaluated,
    improvements,
)
from mcspectra.improve.learned import LearnSettings
from mcspectra.measure.setup import Setup

SIGMAS = 4.0
SLOPES = np.arange(1.0, 6.0) / 5.0


def normal(x):
    return ndtri(np.clip(x, 1e-300, 1.0 - 2.0**-53))


# ∫ exp(−100 s²) 2 (1 − s) ds, where 2 (1 − s) is the density of s = |x − y|
RIDGE = math.sqrt(math.pi) / 10.0 * math.erf(10.0) - (1.0 - math.exp(-100.0)) / 100.0
PROBLEMS = {
    "peak": (3, lambda x: np.exp(-((x - 0.4) ** 2).sum(-1) / 8e-4), (8e-4 * math.pi) ** 1.5),
    "digital option": (16, lambda x: (normal(x).sum(-1) > 1.0) * 1.0, float(ndtr(-0.25))),
    "lognormal": (4, lambda x: np.exp(0.5 * normal(x).sum(-1)), math.exp(0.5)),
    "smooth": (5, lambda x: np.exp(x * SLOPES).prod(-1), (np.expm1(SLOPES) / SLOPES).prod()),
    "product": (10, lambda x: (3.0 * x - 0.5).prod(-1), 1.0),
    "half-plane": (2, lambda x: (x @ (0.6, 0.8) < 0.7) * 1.0, 0.5),
    "ridge": (2, lambda x: np.exp(-100.0 * (x[..., 0] - x[..., 1]) ** 2), RIDGE),
    "step": (3, lambda x: (x[..., 1] < 0.377) * 1.0, 0.377),
    "channels": (
        2,
        lambda x: np.stack([x[..., 0] ** 2, np.exp(3.0 * x.sum(-1))], axis=-1),
        np.array([1 / 3, (math.expm1(3.0) / 3.0) ** 2]),
    ),
}


def estimator(name):
    dims, function, integral = PROBLEMS[name]
    return mcs.Estimator(mcs.Integrand.from_function(function, dims=dims, integral=integral))


def plain(e):
    """Return a set-up of an estimator with random points."""
    return Setup(e, mcs.sampler("random", dims=e.dims))


# An eighth of the usual steps of a fit; the expected gain comes from evaluations outside the fit
SHORT = ChangeSettings(splines=LearnSettings(steps=15))


@cache
def changes(name, kind, count=2048):
    """Return evaluations of a problem and the changes of one kind that follow from them."""
    e = estimator(name)
    seen = evaluated(e, count, Stream.from_rng(1), adapt=kind == "fitted", settings=SHORT)
    return seen, list(improvements(plain(e), seen, [kind], settings=SHORT))


@pytest.mark.parametrize("name", PROBLEMS)
def test_all_changes_keep_the_integral(name):
    """Means of 2^14 random points are within 4 standard errors of the integral."""
    dims, _, integral = PROBLEMS[name]
    u = np.random.default_rng(2).random((2**14, dims))
    found = [change for kind in CHANGES for change in changes(name, kind)[1]]
    assert found
    for change in found:
        values = change.setup.estimator.primary_values(0, u)
        error = values.std(axis=0) / math.sqrt(len(u)) + 1e-12
        assert (np.abs(values.mean(axis=0) - integral) < SIGMAS * error).all(), change.name
        assert change.setup.estimator.integral == pytest.approx(integral)


@pytest.mark.parametrize("kind", ["fitted", "regression"])
@pytest.mark.parametrize("name", ["peak", "smooth", "product", "half-plane", "ridge"])
def test_changes_are_as_good_as_expected(name, kind):
    """The gain is at least the expected gain within 4 standard errors of both variances.

    The expected gain is lower, because it comes from fits to halves of the evaluations.
    """
    e = estimator(name)
    seen, found = changes(name, kind)
    u = np.random.default_rng(3).random((2**16, e.dims))
    before = e.primary_values(0, u).var()
    squares = (seen.values[:, 0] - PROBLEMS[name][2]) ** 2 / seen.pdf
    for change in found:
        values = change.setup.estimator.primary_values(0, u)
        own = (values - values.mean()) ** 2
        spread = math.hypot(squares.std() / squares.mean(), own.std() / own.mean())
        most = change.ratio * math.exp(SIGMAS * spread / math.sqrt(len(seen.points)))
        assert values.var() / before < most, change.name


def test_splines_fit_a_diagonal_ridge():
    """The marginals are almost flat, so a product does not fit, but coupled splines do."""
    found = {c.name: c.ratio for c in changes("ridge", "fitted")[1]}
    assert found["fitted splines"] < 0.05


def test_regression_removes_polynomials():
    dims = 3
    e = mcs.Estimator(mcs.Integrand.from_function(lambda x: x[..., 0] * x[..., 2], dims=dims))
    (change,) = improvements(plain(e), evaluated(e, 512, Stream.from_rng(0)), ["regression"])
    u = np.random.default_rng(0).random((1000, dims))
    assert change.setup.estimator.primary_values(0, u).var() < 1e-12
    assert change.ratio < 1e-12


def test_a_fitted_normal_density_has_the_shift_of_a_lognormal_integrand():
    """|g| φ is a shifted φ, so the fitted shift differs from it by a statistical error only."""
    found = {c.name: c for c in changes("lognormal", "fitted")[1]}
    made = found["fitted normal density"].setup.estimator.integrand.density
    spread = math.sqrt(math.exp(1.0) / 2048)
    assert np.abs(made.shift - 0.5).max() < SIGMAS * spread


def test_the_active_direction_comes_first():
    """The first direction differs from (1, …, 1) by the statistical error of the regression."""
    _, (change,) = changes("digital option", "order", 4096)
    first = change.setup.estimator.integrand.density.matrix[:, 0]
    # Squared error of all linear coefficients, whose squares sum to φ(¼)² = 0.15
    residual = 0.25 / 4096 * 16
    assert 1.0 - (first.sum() / 4.0) ** 2 < SIGMAS * residual / 0.15


def test_preintegration_leaves_only_the_bracket_of_the_jump():
    """The remaining bracket has the width 2^−7, so its variance is at most 2^−14/4."""
    found = {c.name: c for c in changes("step", "preintegrated")[1]}
    made = found["preintegrated along axis 1"].setup.estimator
    u = np.random.default_rng(0).random((4096, 3))
    assert made.primary_values(0, u).var() < 0.25 * 2.0**-14
    assert made.evaluations_per_point == 14


def test_evaluations_are_weighted_by_their_density():
    """The variance from points of density p agrees with the variance from uniform points."""
    e = estimator("smooth")
    uniform = evaluated(e, 2**12, Stream.from_rng(4))
    adapted = evaluated(e, 2**12, Stream.from_rng(5), adapt=True, settings=SHORT)
    assert adapted.pdf.std() > 0.1
    assert adapted.variance() == pytest.approx(uniform.variance(), rel=SIGMAS * 3.0 / 2**6)


def test_changes_cost_the_evaluations_of_the_pilot_only():
    calls = 0

    def function(x):
        nonlocal calls
        calls += x[..., 0].size
        return np.exp(-100.0 * ((x - 0.3) ** 2).sum(-1))

    e = mcs.Estimator(mcs.Integrand.from_function(function, dims=2, integral=math.pi / 100))
    for kind in CHANGES:
        calls = 0
        seen = evaluated(e, 500, Stream.from_rng(0), adapt=kind == "fitted", settings=SHORT)
        made = list(improvements(plain(e), seen, [kind], charged=500, settings=SHORT))
        assert calls == 500
        assert all(m.setup.overhead == 500 for m in made)
        assert all(Mirrored(m.setup.estimator).pilot_evaluations == 500 for m in made)


@pytest.mark.parametrize(
    ("name", "kind"),
    [pytest.param("peak", "fitted", marks=pytest.mark.slow), ("smooth", "regression")],
)
def test_remedies_recommend_changes_of_the_estimator(name, kind):
    found = mcs.remedies(
        estimator(name), "random", 2048, realizations=100, rng=1, kinds=["mirrored", kind]
    )
    best = found.isel(remedy=0)
    assert (best["kind"], best["verdict"]) == (kind, "better")
    assert best["error_ratio_ci"].values[1] < 0.02
    # The rate does not include the pilot, so it is the rate of random points
    name = str(best["remedy"].values).removesuffix(", with sobol | owen")
    assert found["rate_verdict"].sel(remedy=name) == "undecided"


def test_impossible_changes_give_a_reason():
    mis = mcs.MultipleImportance("gaussian", ["uniform", "linear"], dims=2)
    with pytest.raises(ParameterError, match="one technique"):
        evaluated(mis, 100, Stream.from_rng(0))
    e = estimator("step")
    with pytest.raises(ParameterError, match="too few"):
        list(improvements(plain(e), evaluated(e, 4, Stream.from_rng(0))))
    with pytest.raises(ParameterError, match="0 at all"):
        list(
            improvements(plain(e), Evaluations.of(np.full((99, 3), 0.9), np.zeros(99)), ["fitted"])
        )
    found = mcs.remedies(e, "random", 256, realizations=100, kinds=["regression"])
    assert "budget of at least 512" in found.attrs["answer"]


@pytest.mark.parametrize(
    ("order", "dims"),
    [
        *itertools.product([1, 2, 3], [1, 2]),
        (4, 1),
        (5, 1),
        (2, 3),
        pytest.param(4, 2, marks=pytest.mark.slow),
        pytest.param(5, 2, marks=pytest.mark.slow),
        pytest.param(3, 3, marks=pytest.mark.slow),
    ],
)
def test_cubic_stratification_has_the_rate_of_its_order(order, dims):
    """The variance is proportional to n^(−1 − 2r/d) for order r.

    The last slope may differ from theory by its error plus its difference from the slope before.
    The integrand is a bump without derivatives at the border, so only even powers of the side are
    corrections.
    """
    counts = [s**dims for s in {1: (32, 64, 128), 2: (12, 18, 27), 3: (8, 10, 12)}[dims]]
    f = mcs.Integrand.from_function(
        lambda x: np.exp(-40.0 * ((x - 0.5) ** 2)).prod(-1),
        dims=dims,
        integral=(math.sqrt(math.pi / 40.0) * math.erf(math.sqrt(10.0))) ** dims,
    )
    cubic = Cubic.of(mcs.Estimator(f), order)
    assert cubic.evaluations_per_point == [1, 2, 2, 3, 2][order - 1]
    variance, error = [], []
    for n in counts:
        e = mcs.Estimator(cubic.in_cells(round(n ** (1 / dims))))
        found = mcs.convergence(e, "jittered", [n], realizations=200, rng=order)
        assert abs(float(found["bias"][0])) < SIGMAS * float(found["mean_se"][0]) + 1e-15
        low, high = found["variance_ci"].values[0]
        variance.append(float(found["variance"][0]))
        error.append(math.log(high / low) / (2 * 1.96))
    steps = np.diff(np.log(counts))
    slopes = np.diff(np.log(variance)) / steps
    noise = np.hypot(error[1:], error[:-1]) / steps
    bias = abs(slopes[1] - slopes[0])
    assert abs(slopes[1] + 1.0 + 2.0 * order / dims) < SIGMAS * noise[1] + bias


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_cubic_stratification_is_exact_for_its_polynomials(order):
    """The polynomials have the degree order − 1 along each axis, or in total for order 2.

    The result is exact at the border, for several channels, and for points in any order.
    """
    f = mcs.Integrand.from_function(
        lambda x: np.stack([(x ** (order - 1)).prod(-1), 1.0 + x[..., 0]], -1), dims=2
    )
    cubic = Cubic.of(mcs.Estimator(f), order).in_cells(order + 2)
    u = np.random.default_rng(0).random((3, 500, 2))
    assert cubic(u).shape == (3, 500, 2)
    cell = np.floor(u * (order + 2))
    # Values in a cell are constant: the mean of the polynomial, from its antiderivative
    ends = np.arange(order + 3) / (order + 2)
    means = np.diff(ends**order) / order * (order + 2)
    expected = np.outer(means, means)[tuple(cell.astype(int).reshape(-1, 2).T)]
    if order > 2:
        assert cubic(u)[..., 0].ravel() == pytest.approx(expected, abs=1e-13)
    assert cubic(u)[..., 1] == pytest.approx(1.0 + (cell[..., 0] + 0.5) / (order + 2), abs=1e-13)
    with pytest.raises(ParameterError, match="too few for order"):
        Cubic.of(mcs.Estimator(f), order).in_cells(order - 1)


def test_cubic_stratification_of_even_order_has_one_cell_more_above_than_below():
    """At order 4, the cubic passes through the centers of the cell, one below and two above."""
    f = mcs.Integrand.from_function(lambda x: x[..., 0] ** 4 * x[..., 1], dims=2)
    cell, u = np.array([3, 2]), np.array([[0.53, 0.36], [0.61, 0.48]])
    centers = (np.arange(2, 6) + 0.5) / 6
    cubic = np.polynomial.Polynomial.fit(centers, centers**4, 3)
    x, y = np.stack([u, (2 * cell + 1) / 6 - u]).T
    mean = np.diff(cubic.integ()(np.array([3, 4]) / 6)) * 6 * 2.5 / 6
    expected = ((x**4 - cubic(x)) * y).mean(axis=1) + mean
    found = Cubic.of(mcs.Estimator(f), 4).in_cells(6)(u)
    assert np.asarray(found) == pytest.approx(expected, abs=1e-13)


def test_remedies_recommend_cubic_stratification_and_count_its_centers():
    made = 0

    def smooth(x):
        nonlocal made
        made += x.size // 2
        return np.exp(x.sum(-1))

    f = mcs.Integrand.from_function(smooth, dims=2, integral=math.expm1(1.0) ** 2)
    found = mcs.remedies(f, "sobol | owen", 1024, realizations=100, kinds=["cubic"])
    best = found.isel(remedy=0)
    assert str(best["remedy"].values) == "cubic: order 4"
    assert float(best["rate_difference_ci"][1]) < 0.0
    cost = best["cost"].values[np.isfinite(best["cost"].values)]
    assert set(cost % 3) == {0.0}
    assert cost.max() <= 1024
    assert made <= 5 * 4 / 3 * 1024 * 100 + 1024 * 100
    seven = mcs.remedies(
        mcs.Integrand.from_function(smooth, dims=7, integral=math.expm1(1.0) ** 7),
        "random",
        64,
        realizations=100,
        kinds=["cubic"],
    )
    assert "In 7 dims there are too many cubes" in seven.attrs["not_tried"]


@pytest.mark.parametrize("order", [2, 3, 4])
def test_periodized_integrands_keep_the_integral_and_have_their_rate(order):
    integral = math.expm1(1.0) ** 2
    f = mcs.Integrand.from_function(lambda x: np.exp(x.sum(-1)), dims=2, integral=integral)
    g = Periodized.of(mcs.Estimator(f), order)
    # Product of Gauss rules of 40 nodes, exact to rounding for polynomials times exponentials
    x, w = np.polynomial.legendre.leggauss(40)
    grid = np.stack(np.meshgrid(*[0.5 * (x + 1.0)] * 2), axis=-1)
    assert np.einsum("i,j,ij", w, w, g(grid)) / 4.0 == pytest.approx(integral, rel=1e-13)
    # Values agree at all faces, also where u rounds to the border: they are f at the center
    faces = np.array([[0.0, 0.3], [1.0 - 2.0**-53, 0.3], [0.3, 0.0]])
    assert g(faces) == pytest.approx(math.e, rel=1e-14)
    assert g.pilot_evaluations == 1
    found = mcs.convergence(
        mcs.Estimator(g), "rank1-lattice | shift", [144, 610, 987], realizations=100
    )
    assert float(found["rate"]) == pytest.approx(-2.0 * order, abs=0.3 * order)


def test_periodized_integrands_are_finite_where_g_grows():
    f = mcs.Integrand.from_function(lambda x: x[..., 0] ** -0.6, dims=1, integral=2.5)
    made = candidates_of(
        Setup(mcs.Estimator(f), mcs.sampler("random", dims=1)),
        ["periodized"],
        Budget(1024, 100, Stream.from_rng(0)),
    )
    for each, order, error in zip(made, (3, 6), (1e-4, 1e-8), strict=True):
        assert each.name == f"periodized to order {order}"
        assert each.finite_below == 1.0 - 0.5 / order
        assert each.setup.sampler.spec == "rank1-lattice | shift"
        # g − c ∝ t^(k (1 − 0.6) − 1) toward 0, and the integral of g is that of f
        u, changed = np.array([[1e-6], [1e-4]]), each.setup.estimator.integrand
        low, high = changed(u) - changed.about
        assert high / low == pytest.approx(100.0 ** (0.4 * order - 1.0), rel=1e-3)
        points = each.setup.sampler.draw(4096, realizations=8, rng=0)
        found = each.setup.estimator.primary_values(0, points).mean(axis=1)
        assert found == pytest.approx(2.5, rel=error)


@pytest.mark.parametrize(("grows", "order"), [(False, 3), (True, 6)])
def test_the_order_of_the_substitution_depends_on_growth(grows, order):
    for dims, wanted in ((3, order), (4, 3)):  # with high orders, 4-D needs too many points
        given = Setup(
            mcs.Estimator(mcs.integrand("gaussian", dims=dims)),
            mcs.sampler("sobol | owen", dims=dims),
        )
        budget = Budget(1024, 100, Stream.from_rng(0), grows=grows)
        (made,) = candidates_of(given, ["periodized"], budget)
        assert (made.name, made.setup.estimator.integrand.order) == ("periodized", wanted)


def test_periodic_functions_stay_periodic():
    f = mcs.Integrand.from_function(lambda x: np.cos(2.0 * np.pi * x[..., 0]), dims=1, integral=0.0)
    variances = [
        Periodized.of(mcs.Estimator(f), order)(
            mcs.sampler("rank1-lattice | shift", dims=1).draw(64, realizations=8, rng=0)
        ).mean(axis=-1).var()
        for order in (3, 4)
    ]  # fmt: skip
    # The Fourier coefficients fall faster than any power of n for odd orders only
    assert variances[0] < 1e-30
    assert variances[1] > 1e-20


def test_five_dims_are_not_made_periodic():
    given = plain(estimator("smooth"))
    (why,) = candidates_of(given, ["periodized"], Budget(1024, 100, Stream.from_rng(0)))
    assert "In 5 dims the substitution adds too much variance" in why
