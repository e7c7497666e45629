"""MIS compensation: the density of least second moment, coverage, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.densities import PiecewiseConstant, compensated

TABLE = [1.0, 1.0, 4.0, 2.0, 0.5, 8.0]


def _second_moment(own, f, other, share):
    """∫ f²/(β p' + (1 − β) p_s), cells of equal size."""
    mix = share * own + (1 - share) * other
    return np.mean(np.where(f > 0, f**2 / np.where(mix > 0, mix, 1e-300), 0))


@pytest.mark.parametrize("counts", [(1, 1), (1, 3), (5, 1)])
@pytest.mark.parametrize("other", [[1.0] * 6, [6, 5, 4, 3, 2, 1], [0, 0, 1, 5, 5, 5]])
def test_it_is_the_density_of_least_second_moment(counts, other):
    """Against a constrained minimiser that knows nothing of λ."""
    f = np.array(TABLE) / np.mean(TABLE)
    second = np.array(other) / np.mean(other)
    share = counts[0] / sum(counts)
    density = compensated(
        PiecewiseConstant(values=TABLE), [PiecewiseConstant(values=other)], counts
    )
    own = np.array(density.values)
    assert own.mean() == pytest.approx(1, abs=1e-12)
    found = optimize.minimize(
        lambda p: _second_moment(p, f, second, share),
        np.ones(6),
        bounds=[(1e-9, None)] * 6,
        constraints={"type": "eq", "fun": lambda p: p.mean() - 1},
        options={"ftol": 1e-14, "maxiter": 500},
    )
    least = _second_moment(own, f, second, share)
    assert least <= found.fun * (1 + 1e-7)
    assert least == pytest.approx(found.fun, rel=1e-4)
    np.testing.assert_allclose(own, found.x, atol=2e-2)


def test_nothing_cut_off_leaves_no_variance():
    """The mixture is p itself, so that f/mixture is constant."""
    table = PiecewiseConstant(values=[2, 3, 4, 5])
    own = compensated(table, ["uniform"], (3, 1))
    p = np.array([2, 3, 4, 5]) / 3.5
    np.testing.assert_allclose(own.values, (p - 0.25) / 0.75, rtol=1e-14)
    x = (np.arange(40)[:, None] + 0.5) / 40
    np.testing.assert_allclose(0.75 * own.pdf(x) + 0.25, table.pdf(x), rtol=1e-14)


def _balance_variance(own, f):
    """One random point each of `own` and of the uniform density, from sums over cells."""
    mix = own + 1
    parts = (own, np.ones_like(own))
    return sum(np.mean(p * (f / mix) ** 2) - np.mean(p * f / mix) ** 2 for p in parts)


def test_variance_goes_down_and_the_support_stays_covered():
    table = PiecewiseConstant(values=TABLE)
    f = mcs.Integrand.from_function(table.pdf, dims=1, integral=1.0)
    p, own = np.array(TABLE) / np.mean(TABLE), compensated(table, ["uniform"])
    before = _balance_variance(p, p)
    after = _balance_variance(np.array(own.values), p)
    assert after < 0.3 * before
    for density, expected in ((table, before), (own, after)):
        e = mcs.MultipleImportance(f, [density, "uniform"])  # checks the support
        assert mcs.exact_variance(e, "random", 1) == pytest.approx(expected, rel=1e-6)
    partly = PiecewiseConstant(values=[1, 0, 1, 0, 1, 0, 1, 0, 1, 0])
    kept = compensated(table, [partly])
    assert (np.array(kept.values) > 0).all()  # every cell of the table holds a gap of the other


def test_two_dims_have_rows_along_axis_1():
    values = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 9.0]])
    own = compensated(PiecewiseConstant(values=values), ["linear(slope=1)"], (2, 1))
    x = np.stack(np.meshgrid((np.arange(3) + 0.5) / 3, [0.25, 0.75]), axis=-1)
    other = mcs.density("linear(slope=1)", dims=2).pdf(x)  # linear: its mean is that at the centre
    left = values / values.mean() - other / 3
    assert (left > 0).all()
    np.testing.assert_allclose(own.values, left * 1.5, rtol=1e-12)


def test_alone_it_is_the_table_and_its_warp_is_kept():
    table = PiecewiseConstant(values=[[1, 2], [3, 4]], warp="hierarchical")
    own = compensated(table, [])
    np.testing.assert_allclose(own.values, np.array([[1, 2], [3, 4]]) / 2.5)
    assert own.warp == "hierarchical"


def test_large_tables_are_quick():
    values = np.random.default_rng(1).random((300, 500)) ** 4
    own = compensated(PiecewiseConstant(values=values), ["uniform", "linear(slope=1)"])
    assert np.mean(own.values) == pytest.approx(1, abs=1e-9)
    assert np.mean(np.asarray(own.values) == 0) > 0.3


@pytest.mark.parametrize(
    ("density", "others", "counts", "words"),
    [
        ("linear(slope=1)", ["uniform"], None, "not a table"),
        (3, ["uniform"], None, "not a density"),
        (None, ["uniform"], None, "not a table"),
        ("piecewise-constant(values=[1, 2])", [None], None, "None"),
        ("piecewise-constant(values=[1, 2])", ["unifrom"], None, "uniform"),
        ("piecewise-constant(values=[1, 2])", [mcs.density("uniform", dims=2)], None, "dims"),
        ("piecewise-constant(values=[1, 2])", ["uniform"], (1,), "2 numbers"),
        ("piecewise-constant(values=[1, 2])", ["uniform"], (1, 0), "at least 1"),
        ("piecewise-constant(values=[1, 2])", ["uniform"], (1, float("nan")), "whole"),
        ("piecewise-constant(values=[1, 2])", ["uniform"], 2, "2 numbers"),
        ("piecewise-constant(values=[1, 2])", "uniform", None, "list"),
        ("piecewise-constant(values=[1, 2])", 5, None, "list"),
    ],
)
def test_bad_input(density, others, counts, words):
    with pytest.raises(ParameterError, match=words):
        compensated(density, others, counts)
