"""Estimators are unbiased, weighted as defined, and reject densities that miss f."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.core.streams import Stream

SQUARE = mcs.integrand("polynomial(coefficients=[0, 0, 1])", dims=1)


def _mean_and_se(estimator, sampler="random", n=16, realizations=4000):
    d = mcs.convergence(estimator, sampler, [n], realizations=realizations, rng=5)
    return float(d["mean"][0]), float(d["mean_se"][0])


@pytest.mark.parametrize(
    "estimator",
    [
        mcs.Estimator(SQUARE),
        mcs.Estimator(SQUARE, "linear(slope=1.5)"),
        mcs.Estimator(SQUARE, "truncated-normal(mean=0.8, sigma=0.3)"),
        mcs.Estimator(SQUARE, "piecewise-constant(values=[1, 3, 2])"),
        mcs.MultipleImportance(SQUARE, ["uniform", "linear(slope=2)"]),
        mcs.MultipleImportance(
            SQUARE, ["uniform", "linear(slope=2)"], heuristic="power", counts=(3, 1)
        ),
        mcs.estimators.TechniqueSum([SQUARE, "constant(value=0)"]),
    ],
    ids=lambda e: e.spec,
)
def test_estimates_are_unbiased(estimator):
    mean, se = _mean_and_se(estimator)
    assert abs(mean - 1 / 3) < 4.5 * se


def test_perfect_importance_sampling_has_no_variance():
    d = mcs.convergence(
        mcs.Estimator(mcs.integrand("linear(gradient=[1], offset=0.5)", dims=1), "linear(slope=1)"),
        "random",
        [8],
        realizations=50,
    )
    assert float(d["variance"][0]) < 1e-30


def test_weights_are_those_of_the_definition():
    """Weights are w_t/(p_t n_t) with w_t = (n_t p_t)^β / Σ (n_s p_s)^β."""
    densities = [mcs.density("uniform", dims=1), mcs.density("linear(slope=1)", dims=1)]
    for heuristic, beta in (("balance", 1), ("power", 2)):
        e = mcs.MultipleImportance(SQUARE, densities, heuristic=heuristic, counts=(2, 1))
        points = e.draw(mcs.sampler("random", dims=1), 5, Stream.from_rng(1), 0, 3)
        assert [u.shape for u in points] == [(3, 10, 1), (3, 5, 1)]
        x, weights = e.weighted_points(points)
        n = (10, 5)
        p = [d.pdf(x) for d in densities]
        own = np.repeat([0, 1], n)
        scaled = [(n[t] * p[t]) ** beta for t in (0, 1)]
        for t in (0, 1):
            expected = scaled[t] / (scaled[0] + scaled[1]) / (p[t] * n[t])
            assert np.allclose(weights[:, own == t], expected[:, own == t])
        assert np.allclose((weights * SQUARE(x)).sum(axis=1), e.estimate(points))


def test_first_technique_uses_the_samplers_own_points():
    sampler = mcs.sampler("jittered | shift", dims=1)
    e = mcs.MultipleImportance(SQUARE, ["uniform", "uniform"])
    points = e.draw(sampler, 9, Stream.from_rng(4), 2, 3)
    assert np.array_equal(points[0], sampler.draw(9, realizations=3, rng=4, first=2))
    assert not np.array_equal(points[0], points[1])


def test_density_zero_where_f_is_not():
    with pytest.raises(DensityError, match="would miss"):
        mcs.Estimator(SQUARE, "piecewise-constant(values=[0, 1, 1])")
    with pytest.raises(DensityError, match="would miss"):
        mcs.MultipleImportance(SQUARE, ["piecewise-constant(values=[0, 1])"] * 2)
    # Together the densities cover f
    mcs.MultipleImportance(
        SQUARE, ["piecewise-constant(values=[0, 1])", "piecewise-constant(values=[1, 0])"]
    )
    # f vanishes where p does
    mcs.Estimator("step(at=0.5)", "piecewise-constant(values=[1, 0])", dims=1)


def test_a_single_empty_cell_is_found():
    table = np.ones((200, 200))
    table[100, 100] = 0
    density = mcs.densities.PiecewiseConstant(values=table)
    with pytest.raises(DensityError, match="would miss"):
        mcs.Estimator("constant", density)


def test_functions_cannot_change_their_points():
    """f gets a read-only view, because the points are weighted after f has used them."""

    def in_place(x):
        x **= 2
        return x[..., 0]

    with pytest.raises(ParameterError, match="in place"):
        mcs.Integrand.from_function(in_place, dims=1)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: mcs.estimators.TechniqueSum(["linear(dims=1)", "linear(dims=2)"]), "dims"),
        (lambda: mcs.estimators.TechniqueSum(5), "one or more"),
        (lambda: mcs.Estimator(SQUARE, 3), "density"),
        (lambda: mcs.Estimator(SQUARE, mcs.density("uniform", dims=2)), "dims"),
        (lambda: mcs.MultipleImportance(SQUARE, []), "one or more"),
        (lambda: mcs.MultipleImportance(SQUARE, "uniform"), "list"),
        (lambda: mcs.MultipleImportance(SQUARE, [None]), "None"),
        (lambda: mcs.MultipleImportance(SQUARE, ["uniform"], counts=(1, 1)), "each technique .1."),
        (lambda: mcs.MultipleImportance(SQUARE, ["uniform"], counts=(0,)), "at least 1"),
        (lambda: mcs.estimators.TechniqueSum([]), "one or more"),
    ],
)
def test_bad_input(make, words):
    with pytest.raises(ParameterError, match=words):
        make()


def test_nan_estimates_are_refused():
    f = mcs.Integrand.from_function(
        lambda x: np.where(x[..., 0] < 1e-3, np.nan, 1.0), dims=1, integral=1.0
    )
    with pytest.raises(ParameterError, match="NaN"):
        mcs.convergence(mcs.Estimator(f), "random", [4096], realizations=20)
