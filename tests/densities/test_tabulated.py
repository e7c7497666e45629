"""Piecewise constant tables: cells, borders, breaks, and four warps of one table.

The warps have the same pdf, masses and cells, but different jumps and thus variances.
"""

import math

import numpy as np
import pytest
from scipy.stats import chi2
from tests.densities.conftest import midpoints, pixel_centers

import mcspectra as mcs
from mcspectra.core.errors import DensityError
from mcspectra.densities import PiecewiseConstant
from mcspectra.densities.tabulated import WARPS, _Hilbert

INVERTIBLE = tuple(w for w in WARPS if w != "alias")
SHAPES = [(1, 1), (1, 7), (7, 1), (8, 8), (5, 12), (16, 3)]
FALSE_ALARM = 1e-6  # false-alarm probability of the whole module


def table(*shape):
    """Return values over two decades; a quarter of the cells is empty, but not the first."""
    rng = np.random.default_rng(shape)
    values = 10 ** rng.uniform(-2, 0, shape) * (rng.random(shape) > 0.25)
    values.flat[0] = 1.0
    return values


def gentle(height, width):
    """Return values from 1 to 3, so that no warp stretches by more than 3 w or 3 h."""
    return np.random.default_rng(4).uniform(1, 3, (height, width))


def cells_of(x, shape):
    height, width = shape
    column = np.minimum((x[:, 0] * width).astype(int), width - 1)
    return np.minimum((x[:, 1] * height).astype(int), height - 1) * width + column


def test_one_dimension_by_hand():
    p = mcs.density("piecewise-constant(values=[1, 3])")
    assert p.dims == 1
    np.testing.assert_array_equal(p.pdf([[0.2], [0.5], [0.9]]), [0.5, 1.5, 1.5])
    np.testing.assert_allclose(p.sample([[0.125], [0.25], [0.625]])[:, 0], [0.25, 0.5, 0.75])
    assert p.breaks == ((0.25,),)
    assert p.reciprocal_integral() == pytest.approx((1 / 0.5 + 1 / 1.5) / 2)


def test_two_dimensions_by_hand():
    """Rows hold 1/4 and 3/4; x_1 picks the row, x_0 the column in it."""
    p = mcs.density("piecewise-constant(values=[[1, 1], [0, 6]])", dims=2)
    np.testing.assert_array_equal(p.pdf(pixel_centers(2, 2)), [[0.5, 0.5], [0, 3]])
    np.testing.assert_allclose(p.sample([0.5, 0.125]), [0.5, 0.25])
    np.testing.assert_allclose(p.sample([0.5, 0.625]), [0.75, 0.75])
    assert p.breaks == ((), (0.25,))
    assert p.reciprocal_integral() == math.inf


def test_separable_tables_have_breaks_along_both_axes():
    p = PiecewiseConstant(values=np.outer([1, 3], [2, 2, 4]))
    assert p.breaks == ((0.5,), (0.25,))
    assert PiecewiseConstant(values=np.ones((4, 4))).breaks == ((), ())
    assert PiecewiseConstant(values=[1, 0, 0, 1]).breaks == ((0.5,),)


@pytest.mark.parametrize("cells", [3, 7, 10, 49, 613, 1000])
def test_every_border_belongs_to_one_cell(cells):
    """Samples at the ends of every cell are looked up in that cell, however i/k rounds."""
    rng = np.random.default_rng(cells)
    weights = rng.random(cells) * (rng.random(cells) > 0.5) + 0.0
    weights[0] = 1.0
    p = PiecewiseConstant(values=weights)
    borders = np.concatenate([[0.0], np.cumsum(weights) / weights.sum()])
    near = np.concatenate([borders, np.nextafter(borders, 0), np.nextafter(borders, 1)])
    x = p.sample(near[(near >= 0) & (near < 1), None])
    assert (p.pdf(x) > 0).all()
    at = np.arange(cells)[:, None] / cells
    np.testing.assert_array_equal(p.pdf(at), weights / weights.mean())
    np.testing.assert_array_equal(p.pdf(np.nextafter(at[1:], 0)), (weights / weights.mean())[:-1])


def test_invert_gives_the_border_where_there_is_no_mass():
    p = PiecewiseConstant(values=[1, 0, 1])
    np.testing.assert_allclose(p.invert([[0.34], [0.5], [0.66]])[:, 0], 0.5)


def test_scale_does_not_matter():
    u = np.random.default_rng(1).random((100, 1))
    small, large = (
        PiecewiseConstant(values=np.array([1, 2, 0, 5]) * s) for s in (2.0**-1000, 2.0**1020)
    )
    np.testing.assert_array_equal(small.sample(u), large.sample(u))
    np.testing.assert_array_equal(small.pdf(u), large.pdf(u))


def test_arrays_are_copied_and_small_ones_shown():
    given = np.ones((20, 20))
    p = PiecewiseConstant(values=given)
    given[0, 0] = 1e9
    assert p.pdf([0.01, 0.01]) == 1
    assert p.spec == "piecewise-constant(values=<array 20x20>)"
    assert (
        PiecewiseConstant(values=np.array([1, 2])).spec == "piecewise-constant(values=[1.0, 2.0])"
    )


@pytest.mark.parametrize("shape", SHAPES)
def test_all_warps_have_the_same_pdf(shape):
    values = table(*shape)
    x = np.random.default_rng(1).random((2000, 2))
    expected = (values / values.mean()).ravel()[cells_of(x, shape)]
    for warp in WARPS:
        found = PiecewiseConstant(values=values, warp=warp).pdf(x)
        np.testing.assert_allclose(found, expected, rtol=1e-14)


@pytest.mark.parametrize("warp", WARPS)
@pytest.mark.parametrize("shape", SHAPES)
def test_counts_in_cells_follow_the_masses(shape, warp):
    values = table(*shape)
    n = 20_000
    x = PiecewiseConstant(values=values, warp=warp).sample(np.random.default_rng(2).random((n, 2)))
    counts = np.bincount(cells_of(x, shape), minlength=values.size)
    expected = n * (values / values.sum()).ravel()
    assert counts[expected == 0].sum() == 0
    full = expected > 5
    statistic = ((counts - expected)[full] ** 2 / expected[full]).sum()
    each = 1 - (1 - FALSE_ALARM) ** (1 / (len(SHAPES) * len(WARPS)))
    assert statistic <= chi2.isf(each, full.sum())


@pytest.mark.parametrize("warp", WARPS)
def test_positions_within_cells_are_even(warp):
    """χ² over quarters of cells: positions are uniform in x_0, x_1 and jointly."""
    shape = (5, 6)
    x = PiecewiseConstant(values=gentle(*shape), warp=warp).sample(
        np.random.default_rng(3).random((40_000, 2))
    )
    inside = (x * [shape[1], shape[0]]) % 1.0
    counts = np.bincount(cells_of(inside, (4, 4)), minlength=16)
    statistic = ((counts - 2500) ** 2 / 2500).sum()
    assert statistic <= chi2.isf(FALSE_ALARM / len(WARPS), 15)


@pytest.mark.parametrize("warp", INVERTIBLE)
@pytest.mark.parametrize("shape", SHAPES)
def test_round_trips_both_ways(shape, warp):
    p = PiecewiseConstant(values=table(*shape), warp=warp)
    u = np.random.default_rng(4).random((3000, 2))
    x = p.sample(u)
    steep = float(p.pdf(x).max()) * max(shape)
    np.testing.assert_allclose(p.invert(x), u, rtol=0, atol=1e-15 * 50 * steep)
    again = p.sample(p.invert(x))
    close = np.abs(again - x).max(axis=1) < 1e-9
    assert close.mean() > 0.999  # rounding may cross an adjacent border


@pytest.mark.parametrize("warp", INVERTIBLE)
def test_the_jacobian_is_the_pdf(warp):
    """|∂T/∂u| p = 1, by differences that stay within a cell."""
    p = PiecewiseConstant(values=table(5, 12), warp=warp)
    u = np.random.default_rng(5).random((500, 2)) * 0.99
    h = 1e-7
    x = p.sample(u)
    columns = [(p.sample(u + step) - x) / h for step in ([h, 0], [0, h])]
    area = np.abs(np.linalg.det(np.stack(columns, axis=-1)))
    good = np.abs(area * p.pdf(x) - 1) < 1e-4
    assert good.mean() > 0.98


@pytest.mark.parametrize("warp", WARPS)
def test_one_cell_has_all_the_mass(warp):
    values = np.zeros((6, 5))
    values[4, 2] = 7
    x = PiecewiseConstant(values=values, warp=warp).sample(midpoints(64))
    assert (cells_of(x, (6, 5)) == 4 * 5 + 2).all()
    inside = (x * [5, 6]) % 1.0
    np.testing.assert_allclose(inside.mean(axis=0), 0.5, atol=1e-12)


@pytest.mark.parametrize("warp", WARPS)
def test_ends_stay_inside_cells_with_mass(warp):
    """Coordinates 0, the smallest and the largest float; cells at the corners are empty."""
    values = np.ones((4, 4))
    values[0, 0] = values[0, 3] = values[3, 0] = values[3, 3] = 0
    ends = np.array([0.0, 5e-324, 1e-17, np.nextafter(1, 0), 1.0])
    u = np.stack(np.meshgrid(ends, ends), axis=-1).reshape(-1, 2)
    p = PiecewiseConstant(values=values, warp=warp)
    assert (p.pdf(p.sample(u)) > 0).all()


def test_one_dimension_has_one_monotone_warp():
    u = np.random.default_rng(6).random((500, 1))
    values = table(13)
    expected = PiecewiseConstant(values=values).sample(u)
    for warp in ("hierarchical", "hilbert"):
        p = PiecewiseConstant(values=values, warp=warp)
        np.testing.assert_array_equal(p.sample(u), expected)
        assert p.breaks == PiecewiseConstant(values=values).breaks


def test_alias_by_hand():
    """Masses ½, 3/2 of two bins: bin 0 keeps ½ for cell 0; its rest and bin 1 are cell 1."""
    p = mcs.density("piecewise-constant(values=[1, 3], warp='alias')")
    u = np.array([[0.0], [0.125], [0.25], [0.375], [0.5], [0.75]])
    np.testing.assert_allclose(p.sample(u)[:, 0], [0, 0.25, 0.5, 0.75, 0.5, 0.75])
    assert p.breaks == ((0.25, 0.5),)
    assert not p.has_inverse
    with pytest.raises(DensityError, match=r"no inverse; choose another warp"):
        p.invert([[0.5]])


def test_hierarchical_by_hand():
    """Rows have 1/4 and 3/4; then columns have 1/2 in the upper and 1/3 in the lower row."""
    p = PiecewiseConstant(values=[[1, 1], [2, 4]], warp="hierarchical")
    np.testing.assert_allclose(p.sample([0.25, 0.125]), [0.25, 0.5 * 0.5])
    np.testing.assert_allclose(p.sample([1 / 6, 0.625]), [0.25, 0.75])
    np.testing.assert_allclose(p.sample([2 / 3, 0.625]), [0.75, 0.75])
    assert p.breaks == ((), (0.25,))


def recursive(values, u):
    """Hierarchical warp for powers of two, of one point, on tables instead of heaps."""
    (x0, x1), (w0, w1), u = [0.0, 0.0], [1.0, 1.0], list(u)
    while values.size > 1:
        axis = 1 if values.shape[0] >= values.shape[1] else 0
        a, b = np.array_split(values, 2, axis=0 if axis else 1)
        share = a.sum() / values.sum()
        second = u[axis] >= share
        u[axis] = (u[axis] - share) / (1 - share) if second else u[axis] / share
        values = b if second else a
        if axis:
            w1 /= 2
            x1 += w1 * second
        else:
            w0 /= 2
            x0 += w0 * second
    return x0 + w0 * u[0], x1 + w1 * u[1]


@pytest.mark.parametrize("shape", [(8, 8), (4, 16), (16, 2)])
def test_hierarchical_against_a_slow_reference(shape):
    values = table(*shape)
    u = np.random.default_rng(7).random((200, 2))
    expected = [recursive(values, point) for point in u]
    found = PiecewiseConstant(values=values, warp="hierarchical").sample(u)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("side", [2, 4, 16, 32])
def test_the_curve_visits_neighbors(side):
    """Each cell once; each step goes to one of four neighbors, in the direction of the heading."""
    curve = _Hilbert(np.ones((side, side)))
    assert sorted(curve.order) == list(range(side * side))
    row, column = np.divmod(curve.order, side)
    steps = np.stack([np.diff(column), np.diff(row)], axis=-1)
    assert (np.abs(steps).sum(axis=1) == 1).all()
    headings = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])[curve.headings]
    np.testing.assert_array_equal(headings[:-1], steps)
    np.testing.assert_array_equal(headings[-1], steps[-1])


def test_steps_along_the_curve_stay_within_two_cells():
    """On a square of 2^k, T along u_0 moves within two neighboring cells at any border."""
    p = PiecewiseConstant(values=gentle(8, 8), warp="hilbert")
    line = np.stack([(np.arange(2**14) + 0.5) / 2**14, np.full(2**14, 0.3)], axis=-1)
    assert np.abs(np.diff(p.sample(line), axis=0)).sum(axis=1).max() < 2 / 8
    ramp = p.sample(np.stack([line[:, 0], 0 * line[:, 0]], axis=-1))
    assert (np.abs(np.diff(ramp, axis=0)).max(axis=1) < 3 * 64 / 8 / 2**14).mean() > 0.99


def jumps(p, axis, other):
    """Return where T jumps on the line u = (·, other) or (other, ·).

    Intervals of 2^-15 in which T moves by more than 0.002 are halved, toward the larger step, down
    to 2^-45, where slopes are negligible.
    """

    def at(shares):
        line = np.full((len(shares), 2), other)
        line[:, axis] = shares
        return p.sample(line)

    def size(a, b):
        return np.abs(at(b) - at(a)).max(axis=1)

    ends = np.arange(2**15 + 1) / 2**15
    a, b = ends[:-1], np.minimum(ends[1:], np.nextafter(1, 0))
    a, b = (end[size(a, b) > 0.002] for end in (a, b))
    for _ in range(30):
        middle = (a + b) / 2
        left = size(a, middle) > size(middle, b)
        a, b = np.where(left, a, middle), np.where(left, middle, b)
    return a[size(a, b) > 1e-6]


def test_jumps_on_lines():
    """Marginal 0 and h−1; hierarchical w/2−1 and h−1; Hilbert at turns; alias in every bin."""
    side = 8
    values = gentle(side, side)
    tables = {w: PiecewiseConstant(values=values, warp=w) for w in WARPS}
    counts = {w: [len(jumps(p, axis, 0.3717)) for axis in (0, 1)] for w, p in tables.items()}
    assert counts["marginal"] == [0, side - 1]
    assert counts["hierarchical"] == [side // 2 - 1, side - 1]
    assert counts["hilbert"][1] == counts["alias"][1] == 0
    assert side * side / 2 < counts["hilbert"][0] <= side * side - 1
    assert 1.5 * side * side < counts["alias"][0] <= 2 * side * side - 1


def test_whole_lines_of_jumps_are_breaks():
    """If T jumps on *every* line, a break is given; otherwise there is none."""
    for warp in WARPS:
        p = PiecewiseConstant(values=gentle(4, 16), warp=warp)
        for axis in (0, 1):
            lines = [jumps(p, axis, other) for other in (0.11, 0.37, 0.52, 0.83, 0.97)]
            shared = [
                at for at in lines[0] if all(np.abs(line - at).min() < 1e-9 for line in lines[1:])
            ]
            for at in shared:
                assert np.abs(np.array(p.breaks[axis]) - at).min() < 1e-9


def test_hierarchical_breaks_of_a_wide_table():
    """Four times as wide as high: the first two levels split columns on all lines."""
    values = gentle(2, 8)
    p = PiecewiseConstant(values=values, warp="hierarchical")
    sums = np.cumsum(values.sum(axis=0)) / values.sum()
    np.testing.assert_allclose(p.breaks[0], sums[[1, 3, 5]])
    assert p.breaks[1] == ()
    assert len(PiecewiseConstant(values=gentle(1, 8), warp="hierarchical").breaks[0]) == 7


def test_breaks_of_large_tables_are_omitted():
    values = gentle(80, 80)
    for warp in ("alias", "hilbert"):
        assert PiecewiseConstant(values=values, warp=warp).breaks == ((), ())


def test_jumps_increase_the_variance():
    """Jittered, f/p smooth: marginal and hierarchical < Hilbert < alias < random, by intervals.

    32 × 32 strata divide 64 cells; strata of the alias table contain pieces from the whole domain.
    """
    values = gentle(8, 8)
    p = PiecewiseConstant(values=values)
    f = mcs.Integrand.from_function(
        lambda x: p.pdf(x) * np.exp(-2 * ((x - 0.4) ** 2).sum(axis=-1)), dims=2
    )
    estimators = [mcs.Estimator(f, PiecewiseConstant(values=values, warp=warp)) for warp in WARPS]
    options = {"counts": [1024], "realizations": 300, "rng": 8}
    found = mcs.convergence(estimators, "jittered", **options)["variance_ci"].values
    low, high = np.moveaxis(found.reshape(len(WARPS), 2), -1, 0)
    marginal, hierarchical, alias, hilbert = range(4)
    for better, worse in ((marginal, hilbert), (hierarchical, hilbert), (hilbert, alias)):
        assert high[better] < low[worse]
    random = mcs.convergence(estimators[:1], "random", **options)["variance_ci"].values
    assert high[alias] < random.ravel()[0]


@pytest.mark.parametrize("warp", WARPS)
def test_tiny_masses_and_long_tables(warp):
    values = np.full((1, 3000), 1e-300)
    values[0, [0, 1234, 2999]] = 1e300
    x = PiecewiseConstant(values=values, warp=warp).sample(
        np.random.default_rng(1).random((999, 2))
    )
    assert set(cells_of(x, values.shape)) == {0, 1234, 2999}
