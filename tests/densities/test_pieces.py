"""Lines between nodes and bins of equal shares: exact cdfs, empty cells, exact ∫1/p."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from scipy.integrate import quad

import mcspectra as mcs
from mcspectra.densities import GridDensity, PiecewiseConstant, PiecewiseLinear

U = np.linspace(0, np.nextafter(1.0, 0.0), 2001)[:, None]


def exact_cdf(nodes, x):
    """Return the cdf by trapezoids in rational arithmetic."""
    nodes, x = [Fraction(v) for v in nodes], Fraction(x)
    h = Fraction(1, len(nodes) - 1)
    total = below = Fraction(0)
    for k, (a, b) in enumerate(itertools.pairwise(nodes)):
        t = min(max((x - k * h) / h, Fraction(0)), Fraction(1))
        total += (a + b) / 2
        below += a * t + (b - a) * t * t / 2
    return float(below / total)


@pytest.mark.parametrize(
    "nodes", [[1, 1], [0, 1], [3, 0], [0, 2, 0], [1, 1e-9, 0, 0, 5, 2], [0, 0, 1e-300, 0]]
)
def test_the_cdf_agrees_with_rational_arithmetic(nodes):
    p = PiecewiseLinear(values=nodes)
    for x in np.linspace(0, 1, 38)[:-1]:
        assert p.invert([x])[0] == pytest.approx(exact_cdf(nodes, x), abs=4e-16)
        mass = exact_cdf(nodes, x)
        if 0 < mass < 1 and p.pdf([x]) > 0.1:
            assert p.sample([mass])[0] == pytest.approx(x, abs=4e-15)


def test_two_nodes_are_the_linear_density():
    line = mcs.density("linear(slope=1.7)", dims=1)
    p = PiecewiseLinear(values=[0.15, 1.85])
    np.testing.assert_allclose(p.pdf(U), line.pdf(U), rtol=1e-14)
    np.testing.assert_allclose(p.sample(U), line.sample(U), rtol=1e-13)
    assert p.reciprocal_integral() == pytest.approx(line.reciprocal_integral(), rel=1e-13)


def test_three_nodes_are_the_tent():
    tent, p = mcs.density("tent", dims=1), PiecewiseLinear(values=[0, 1, 0])
    np.testing.assert_allclose(p.sample(U), tent.sample(U), atol=4e-16)
    assert p.breaks == ((0.5,),)


def test_empty_cells_get_no_samples():
    p = PiecewiseLinear(values=[1, 0, 0, 0, 3, 0, 0])
    x = p.sample(np.random.default_rng(1).random((100_000, 1)))[:, 0]
    cell = (x * 6).astype(int)
    assert set(cell.tolist()) == {0, 3, 4}
    np.testing.assert_allclose(p.zero_points()[:, 0], [1.5 / 6, 2.5 / 6, 5.5 / 6])
    assert (p.pdf(p.zero_points()) == 0).all()


def test_small_cells_are_not_lost_where_they_come_first():
    p = PiecewiseLinear(values=[1e-200, 1e-200, 0, 0, 1])
    u = np.logspace(-290, -202, 20)[:, None]
    np.testing.assert_allclose(p.invert(p.sample(u)), u, rtol=1e-13)


def test_reciprocal_integral_agrees_with_quadrature():
    nodes = [0.5, 2, 2, 1e-3, 1]
    p = PiecewiseLinear(values=nodes)
    found, error = quad(lambda x: 1 / float(p.pdf([x])), 0, 1, points=[0.25, 0.5, 0.75], limit=200)
    assert p.reciprocal_integral() == pytest.approx(found, abs=2 * error)
    assert PiecewiseLinear(values=[0, 1]).reciprocal_integral() == math.inf


def test_long_tables_are_abbreviated():
    p = PiecewiseLinear(values=np.ones(1000))
    assert p.spec == "piecewise-linear(values=<array 1000>)"
    assert p.breaks == ((),)


def test_a_grid_by_hand():
    p = GridDensity(nodes=[[0, 0.1, 1]])
    np.testing.assert_allclose(p.pdf([[0.05], [0.1], [1.0]]), [5, 1 / 1.8, 1 / 1.8])
    np.testing.assert_allclose(p.sample([[0.25], [0.5], [0.75]])[:, 0], [0.05, 0.1, 0.55])
    assert p.breaks == ((0.5,),)
    assert p.reciprocal_integral() == pytest.approx(2 * (0.01 + 0.81))
    assert GridDensity(nodes=[[0, 0.5, 1]]).breaks == ((),)


def test_a_grid_is_a_table_where_its_borders_are_cells():
    u = np.random.default_rng(1).random((500, 2))
    p = GridDensity(nodes=[[0, 0.125, 0.75, 1], [0, 0.5, 0.625, 1]])
    cells = (np.arange(8) + 0.5) / 8
    centers = np.stack(np.meshgrid(cells, cells), axis=-1)
    table = PiecewiseConstant(values=p.pdf(centers))
    np.testing.assert_allclose(p.pdf(u), table.pdf(u), rtol=1e-14)
    np.testing.assert_allclose(p.sample(u), table.sample(u), atol=1e-15)


def test_a_plain_list_of_borders_is_one_dim():
    plain, nested = GridDensity(nodes=[0, 0.25, 1]), GridDensity(nodes=[[0, 0.25, 1]])
    assert plain == nested == GridDensity(nodes=np.array([0, 0.25, 1]))
    assert plain.dims == 1
    assert mcs.density("grid(nodes=[0, 0.25, 1])", dims=1) == nested
