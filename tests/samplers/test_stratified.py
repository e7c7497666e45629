"""Grids: points in their cells, exactly; random parts by χ² and moments; lattices."""

import math

import numpy as np
import pytest
from scipy import stats
from scipy.spatial import cKDTree

import mcspectra as mcs
from mcspectra.core.errors import CountError
from mcspectra.core.streams import mix_bits
from mcspectra.samplers import (
    AntitheticJittered,
    BoxJitter,
    CorrelatedMultiJittered,
    GaussianJitter,
    Hexagonal,
    Jittered,
    LatinHypercube,
    MultiJittered,
    Random,
    Regular,
    UniformJitter,
    sampler,
)
from mcspectra.samplers._kernels import _mix_below
from mcspectra.samplers.stratified import cell_side, corners

LEVEL = 1 - (1 - 1e-6) ** (1 / 28)  # Šidák: at most 28 statistical tests in this file share 1e-6
SIGMAS = stats.norm.isf(LEVEL / 2)


def assert_variance(estimates, expected):
    """Compare a sample variance with theory, within SIGMAS of its standard error."""
    r = len(estimates)
    centred = estimates - estimates.mean()
    error = np.sqrt((np.mean(centred**4) - estimates.var() ** 2) / r)
    assert abs(estimates.var(ddof=1) - expected) < SIGMAS * error


def cell_indices(points, sides):
    """Return the number of the cell of every point, row-major: (R, n)."""
    cells = np.floor(points * sides).astype(int)
    return np.ravel_multi_index(np.moveaxis(cells, -1, 0), sides)


@pytest.mark.parametrize("cls", [Jittered, UniformJitter, Regular])
@pytest.mark.parametrize(("dims", "s"), [(1, 7), (2, 5), (3, 4), (6, 2), (30, 1)])
def test_one_point_in_each_cell_in_row_major_order(cls, dims, s):
    n = s**dims
    points = cls(dims=dims).draw(n, realizations=50, rng=3)
    cells = cell_indices(points, (s,) * dims)
    np.testing.assert_array_equal(cells, np.tile(np.arange(n), (50, 1)))


@pytest.mark.parametrize("cls", [Jittered, UniformJitter, Regular])
@pytest.mark.parametrize("sides", [(5,), (3, 7), (2, 1, 4), (1, 1)])
def test_one_point_in_each_cell_of_given_sides(cls, sides):
    source = cls(dims=len(sides), sides_=sides)
    n = int(np.prod(sides))
    cells = cell_indices(source.draw(n, realizations=50, rng=3), sides)
    np.testing.assert_array_equal(cells, np.tile(np.arange(n), (50, 1)))
    assert source.sides(n) == sides


def test_given_sides_of_equal_length_make_the_same_points():
    given = sampler("jittered(sides=[4, 4])").draw(16, realizations=3, rng=1)
    np.testing.assert_array_equal(given, Jittered().draw(16, realizations=3, rng=1))


@pytest.mark.parametrize("name", ["jittered", "uniform-jitter", "regular"])
def test_given_sides_allow_their_product_only(name):
    source = sampler(f"{name}(sides=[3, 5])")
    assert source.spec == f"{name}(sides=[3, 5])"
    assert [source.nearest_count(n) for n in (1, 15, 999)] == [15, 15, 15]
    for n in (1, 14, 16):
        with pytest.raises(CountError, match=r"nearest count is 15\.$") as caught:
            source.draw(n)
        assert caught.value.nearest == (15,)


def test_positions_of_a_grid_of_given_sides():
    corner = sampler("regular(position='corner', sides=[1, 2])").draw(2)[0]
    np.testing.assert_array_equal(corner, [[0, 0], [0, 0.5]])
    np.testing.assert_array_equal(
        sampler("regular(sides=[1, 2])").draw(2)[0], [[0.5, 0.25], [0.5, 0.75]]
    )


def test_regular_positions():
    centers = Regular(dims=2).draw(4)[0]
    np.testing.assert_array_equal(centers, [[0.25, 0.25], [0.25, 0.75], [0.75, 0.25], [0.75, 0.75]])
    np.testing.assert_array_equal(
        Regular(dims=1, position="corner").draw(4)[0, :, 0], [0, 0.25, 0.5, 0.75]
    )


def test_jitter_is_uniform_and_independent_in_the_cells():
    points = Jittered(dims=2).draw(16, realizations=4000, rng=11)
    inside = points * 4 % 1.0
    # Pairs of coordinates of one point, then of consecutively generated neighbors
    for a, b in [(inside[..., 0], inside[..., 1]), (inside[:, :-1, 0], inside[:, 1:, 0])]:
        pairs = (8 * np.floor(8 * a) + np.floor(8 * b)).astype(int)
        assert stats.chisquare(np.bincount(pairs.ravel(), minlength=64)).pvalue > LEVEL


def test_uniform_jitter_has_one_offset_for_all_points():
    points = UniformJitter(dims=3).draw(27, realizations=2000, rng=5)
    offsets = points[:, :1]
    grid = Regular(dims=3, position="corner").draw(27)
    np.testing.assert_allclose(points - offsets, np.broadcast_to(grid, points.shape), atol=2e-16)
    bins = (np.floor(offsets[:, 0] * 3 * 4) @ [16, 4, 1]).astype(int)
    assert stats.chisquare(np.bincount(bins, minlength=64)).pvalue > LEVEL


@pytest.mark.parametrize("s", [1, 2, 3, 5, 7, 1000, 4099, 99_991, 2**20 + 1])
def test_sums_that_would_round_up_stay_in_their_cell(s):
    """The largest uniform number, 1 − 2^-53, in every cell."""
    largest = np.arange(s) / s + cell_side(s) * (1.0 - 2.0**-53)
    assert np.all(largest < np.arange(1, s + 1) / s)
    assert cell_side(s) > 0.999_999 / s


def test_bounded_numbers_are_the_upper_word_of_the_product():
    k0, k1 = np.uint64(0x0123456789ABCDEF), np.uint64(0xFEDCBA9876543210)
    for i, bound in enumerate([1, 2, 3, 10, 1000, 2**31 - 1, 2**31]):
        bits = int(mix_bits(k0, k1, i))
        assert _mix_below(k0, k1, i, bound) == (bits * bound) >> 64


@pytest.mark.parametrize("dims", [2, 3, 5, 13, 31])
def test_sides_are_exact_roots(dims):
    source = Jittered(dims=dims)
    largest = int(2 ** (31 / dims) + 1e-9)
    for s in {1, 2, 3, largest - 1, largest} - {0}:
        if s <= largest:
            assert source.sides(s**dims) == (s,) * dims
    with pytest.raises(CountError, match="nearest") as caught:
        source.sides(largest**dims - 1)
    assert caught.value.nearest == ((largest - 1) ** dims, largest**dims)


def test_nearest_counts():
    assert Jittered(dims=2).nearest_count(250) == 256
    assert Jittered(dims=2).nearest_count(240) == 225
    assert Jittered(dims=10).nearest_count(500) == 1
    with pytest.raises(CountError, match="nearest count is 1"):
        Jittered(dims=64).draw(1000)


@pytest.mark.parametrize(
    ("source", "n", "expected"),
    [
        (Random(dims=1), 16, 1 / (12 * 16)),
        (Jittered(dims=1), 16, 1 / (12 * 16**3)),
        (UniformJitter(dims=1), 16, 1 / (12 * 16**2)),
        (Jittered(dims=2), 16, 1 / (12 * 16**2)),
        (LatinHypercube(dims=2), 16, 1 / (12 * 16**3)),
        (MultiJittered(), 16, 1 / (12 * 16**3)),
    ],
    ids=lambda value: getattr(value, "name", str(value)),
)
def test_variance_of_the_mean_coordinate(source, n, expected):
    """Exact: strata of width w contribute w²/12 each, independently."""
    means = source.draw(n, realizations=20_000, rng=8)[..., 0].mean(axis=1)
    assert_variance(means, expected)
    assert abs(means.mean() - 0.5) < SIGMAS * np.sqrt(expected / len(means))


@pytest.mark.parametrize("sides", [(2, 5), (3, 1, 4)])
def test_closed_form_power_of_given_sides(sides):
    """From the characteristic functions of the points: |mean|², plus the spread if jittered."""
    n, dims = int(np.prod(sides)), len(sides)
    nu = np.array(
        [np.arange(1, dims + 1), np.full(dims, 0.7), np.array(sides) * 2.0, -np.ones(dims)]
    )
    spec = f"(sides={list(sides)})"
    grid = sampler("regular" + spec, dims).draw(n)[0]
    waves = np.exp(-2j * np.pi * grid @ nu.T)
    for name in ("regular", "uniform-jitter"):
        power = mcs.closed_form_power(name + spec, n, nu)
        np.testing.assert_allclose(power, np.abs(waves.mean(axis=0)) ** 2, atol=1e-14)
    waves *= np.prod(np.sinc(nu / sides), axis=1)
    spread = np.sum(1 - np.abs(waves) ** 2, axis=0) / n**2
    power = mcs.closed_form_power("jittered" + spec, n, nu)
    np.testing.assert_allclose(power, np.abs(waves.mean(axis=0)) ** 2 + spread, atol=1e-14)


@pytest.mark.parametrize(
    "spec", ["jittered", "uniform-jitter", "jittered | shift", "regular | shift", "regular"]
)
def test_exact_variance_of_given_sides(spec):
    """Compare with one Gauss rule per cell and offset, written independently."""
    name, _, rest = spec.partition(" ")
    sides = np.array([3, 5])
    n = 15
    estimator = mcs.Estimator("christensen-gaussian", dims=2)
    found = mcs.exact_variance(estimator, f"{name}(sides=[3, 5]) {rest}", n)
    node, weight = np.polynomial.legendre.leggauss(12)
    u = (node + 1) / 2
    inside = np.stack(np.meshgrid(u, u, indexing="ij"), axis=-1).reshape(-1, 2)
    weights = np.outer(weight, weight).ravel() / 4
    corner = np.stack(np.meshgrid(*map(np.arange, sides), indexing="ij"), axis=-1).reshape(-1, 1, 2)

    values = estimator.integrand((corner + inside) / sides)
    if spec == "jittered":
        variance = np.sum(values**2 @ weights - (values @ weights) ** 2) / n**2
        np.testing.assert_allclose(found, variance, rtol=1e-6)
    elif spec == "regular":
        assert found == 0.0
    elif name == "jittered":  # the border of the torus cuts cells
        points = sampler(f"jittered(sides=[3, 5]) {rest}").draw(n, realizations=20_000, rng=4)
        assert_variance(estimator.integrand(points).mean(axis=1), found)
    else:
        means = values.mean(axis=0)
        np.testing.assert_allclose(found, weights @ means**2 - (weights @ means) ** 2, rtol=1e-6)


def moves_in_cells(points, s):
    """Return toroidal displacements from cell centers, in units of a cell side."""
    centers = corners((s,) * points.shape[-1]) + 0.5 / s
    return ((points - centers + 0.5) % 1.0 - 0.5) * s


@pytest.mark.parametrize("cls", [BoxJitter, GaussianJitter])
@pytest.mark.parametrize(("dims", "s"), [(1, 7), (2, 4), (3, 3)])
def test_width_zero_is_the_regular_grid(cls, dims, s):
    points = cls(dims=dims, width=0.0).draw(s**dims, realizations=2, rng=1)
    np.testing.assert_allclose(moves_in_cells(points, s), 0.0, atol=1e-14)


@pytest.mark.parametrize("width", [0.1, 0.5, 1.0, 1.7, 2.0])
def test_box_jitter_is_uniform_in_its_box(width):
    """Any width, up to a box as wide as the torus."""
    s = 4
    moves = moves_in_cells(BoxJitter(width=width).draw(s * s, realizations=2000, rng=3), s)
    assert np.abs(moves).max() <= width / 2 + 1e-12
    share = moves.ravel() / width + 0.5
    assert stats.kstest(share, "uniform").pvalue > LEVEL
    first, second = (np.floor(8 * np.clip(share[i::2], 0, 1 - 1e-9)) for i in (0, 1))
    assert stats.chisquare(np.bincount((8 * first + second).astype(int))).pvalue > LEVEL


@pytest.mark.parametrize(
    ("width", "unbiased"), [(0.5, False), (0.0, False), (1, True), (1.5, False), (3.0, True)]
)
def test_box_jitter_is_unbiased_where_the_boxes_tile_the_torus(width, unbiased):
    """The mean of cos(2π s x), which is −1 at the centers of the cells, detects bias."""
    source = BoxJitter(dims=1, width=width)
    assert source.unbiased == unbiased
    waves = np.cos(2 * np.pi * 8 * source.draw(8, realizations=4000, rng=4)).mean()
    expected = -np.sinc(width)
    assert abs(waves - expected) < stats.norm.isf(LEVEL / 2) / np.sqrt(2 * 8 * 4000)
    assert (abs(expected) < 1e-12) == unbiased


@pytest.mark.parametrize("width", [0.1, 0.25, 0.6])
def test_gaussian_jitter_is_gaussian(width):
    """On a torus of 16 cells, widths of 0.6 cells wrap at 13 standard deviations."""
    moves = moves_in_cells(
        GaussianJitter(dims=1, width=width).draw(16, realizations=3000, rng=5), 16
    )
    assert stats.kstest(moves.ravel() / width, "norm").pvalue > LEVEL


def test_gaussian_jitter_of_any_width_is_in_range():
    points = GaussianJitter(width=1000.0).draw(4, realizations=5000, rng=5)
    assert points.min() >= 0.0
    assert points.max() < 1.0


@pytest.mark.parametrize(("dims", "s"), [(1, 7), (2, 5), (3, 4), (6, 2), (4, 1)])
def test_antithetic_pairs(dims, s):
    """Both points are in the cell, and its center is their midpoint."""
    n = 2 * s**dims
    pairs = AntitheticJittered(dims=dims).draw(n, realizations=50, rng=6).reshape(50, -1, 2, dims)
    np.testing.assert_array_equal(
        np.floor(pairs * s) / s, np.broadcast_to(corners((s,) * dims)[:, None], pairs.shape)
    )
    centers = corners((s,) * dims) + 0.5 / s
    np.testing.assert_allclose(
        pairs.mean(axis=2), np.broadcast_to(centers, (50, n // 2, dims)), rtol=0, atol=1e-15
    )


def test_antithetic_points_are_uniform_in_their_cells():
    inside = AntitheticJittered().draw(32, realizations=3000, rng=7) * 4 % 1.0
    for half in (inside[:, ::2], inside[:, 1::2]):
        pairs = (8 * np.floor(8 * half[..., 0]) + np.floor(8 * half[..., 1])).astype(int)
        assert stats.chisquare(np.bincount(pairs.ravel(), minlength=64)).pvalue > LEVEL


def test_antithetic_counts_are_twice_the_counts_of_grids():
    possible = [2 * s * s for s in range(1, 20)]
    source = AntitheticJittered()
    for n in range(1, 600):
        below, above = source._counts_near(n)
        assert below == max((m for m in possible if m <= n), default=None)
        assert above == min(m for m in possible if m >= n)
    with pytest.raises(CountError, match="18 and 32"):
        source.draw(25)


def neighbour_distances(points):
    """Return toroidal distances to the six nearest neighbors: (n, 6), sorted."""
    return cKDTree(points, boxsize=1.0).query(points, k=7)[0][:, 1:]


@pytest.mark.parametrize("n", [12, 30, 56, 168, 1400, 3828])
def test_every_point_of_the_hexagonal_lattice_has_the_same_six_neighbours(n):
    """Two neighbors along its row and four in adjacent rows, at nearly equal distances."""
    distances = neighbour_distances(Hexagonal().draw(n)[0])
    np.testing.assert_allclose(distances, np.broadcast_to(distances[0], distances.shape), rtol=1e-9)
    ideal = np.sqrt(2 / (np.sqrt(3) * n))
    ratio = distances[0, -1] / distances[0, 0]
    assert ratio < (1.12 if n < 56 else 1.061 if n < 780 else 1.02)
    assert distances[0, 0] <= ideal * (1 + 1e-12) <= distances[0, -1] * (1 + 1e-9)


def test_hexagonal_counts_are_the_nearest_regular_arrays():
    """Try all numbers of rows; the count is nearest to the ratio of the ideal lattice."""
    wanted = [2 * a * min(range(1, a + 2), key=lambda b: abs(b - a / 3**0.5)) for a in range(1, 30)]
    source = Hexagonal()
    for n in range(1, wanted[-1]):
        below, above = source._counts_near(n)
        assert below == max((m for m in wanted if m <= n), default=None)
        assert above == min(m for m in wanted if m >= n)
    assert wanted[:8] == [2, 4, 12, 16, 30, 36, 56, 80]


def test_hexagonal_rows():
    points = Hexagonal().draw(12)[0].reshape(4, 3, 2)
    np.testing.assert_allclose(points[..., 1], np.repeat([[1, 3, 5, 7]], 3, axis=0).T / 8)
    np.testing.assert_allclose(points[0, :, 0], [1 / 12, 5 / 12, 9 / 12])
    np.testing.assert_allclose(points[1, :, 0], [3 / 12, 7 / 12, 11 / 12])


both = pytest.mark.parametrize("cls", [MultiJittered, CorrelatedMultiJittered])


def pattern_counts(points):
    """Count how often each assignment of the points to n × n strata was drawn."""
    strata = np.floor(points * points.shape[1]).reshape(len(points), -1)
    return np.unique(strata, axis=0, return_counts=True)[1]


@both
@pytest.mark.parametrize(
    ("n", "columns", "rows"), [(1, 1, 1), (2, 1, 2), (16, 4, 4), (24, 4, 6), (1020, 30, 34)]
)
def test_jittered_and_latin(cls, n, columns, rows):
    points = cls().draw(n, realizations=50, rng=9)
    cells = np.floor(points * [columns, rows]) @ [rows, 1]
    np.testing.assert_array_equal(np.sort(cells, axis=1), np.tile(np.arange(n), (50, 1)))
    latin = np.sort(np.floor(points * n), axis=1)
    np.testing.assert_array_equal(latin, np.broadcast_to(np.arange(n)[:, None], latin.shape))


@pytest.mark.parametrize(
    ("cls", "n", "patterns"),
    [
        (MultiJittered, 4, 16),  # 2 × 2 cells with four shuffles of two
        (CorrelatedMultiJittered, 6, 12),  # 2 × 3 cells: 2! · 3!
    ],
)
def test_shuffles_are_uniform_and_independent(cls, n, patterns):
    counts = pattern_counts(cls().draw(n, realizations=16_000, rng=6))
    assert len(counts) == patterns
    assert stats.chisquare(counts).pvalue > LEVEL


@both
def test_jitter_within_the_strata_is_uniform(cls):
    inside = cls().draw(16, realizations=4000, rng=12) * 16 % 1.0
    pairs = (8 * np.floor(8 * inside[..., 0]) + np.floor(8 * inside[..., 1])).astype(int)
    assert stats.chisquare(np.bincount(pairs.ravel(), minlength=64)).pvalue > LEVEL


def rectangle(n):
    """Return columns and rows of the correlated set: nearly square, or by the memo's rule."""
    exact = [a for a in range(1, math.isqrt(n) + 1) if n % a == 0 and n <= 2 * a * a]
    columns = exact[-1] if exact else math.isqrt(n)
    return columns, math.ceil(n / columns)


@pytest.mark.parametrize("n", [3, 5, 7, 10, 13, 14, 32, 61, 997])
def test_correlated_of_any_count_leaves_the_last_row_incomplete(n):
    """The second axis is Latin; cells and strata of the first axis have at most one point."""
    points = CorrelatedMultiJittered().draw(n, realizations=40, rng=3)
    columns, rows = rectangle(n)
    np.testing.assert_array_equal(np.floor(points[..., 1] * n), np.tile(np.arange(n), (40, 1)))
    cells = np.floor(points[..., 0] * columns) * rows + np.arange(n) // columns
    strata = np.floor(points[..., 0] * columns * rows)
    for taken in (cells, strata):
        assert all(len(np.unique(row)) == n for row in taken)


@pytest.mark.parametrize("n", [24, 14])
def test_correlated_is_one_shuffle_of_columns_and_one_of_rows(n):
    """The memo's formula for point s, with the shuffles read off the first row and column."""
    columns, rows = rectangle(n)
    s = np.arange(n)
    for points in CorrelatedMultiJittered().draw(n, realizations=20, rng=8):
        fine = np.floor(points[:, 0] * columns * rows).astype(int)
        across, down = fine[:columns] // rows, fine[::columns] % rows
        np.testing.assert_array_equal(fine, across[s % columns] * rows + down[s // columns])
        assert sorted(across) == list(range(columns))
        assert sorted(down) == list(range(rows))


def test_multi_jittered_counts_are_the_nearly_square_products():
    possible = [a * b for a in range(1, 40) for b in range(a, 2 * a + 1)]
    source = MultiJittered()
    for n in range(1, 800):
        if n in possible:
            assert source.check_count(n) == n
            continue
        below = max(m for m in possible if m < n)
        above = min(m for m in possible if m > n)
        with pytest.raises(CountError, match=f"{below} and {above}") as caught:
            source.check_count(n)
        assert caught.value.nearest == (below, above)
