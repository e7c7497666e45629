"""Grids: who sits in which cell, exactly; what is random in it, by χ² and moments."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.streams import mix_bits
from mcspectra.samplers import (
    Jittered,
    LatinHypercube,
    MultiJittered,
    Random,
    Regular,
    UniformJitter,
    sampler,
)
from mcspectra.samplers._grid import cell_side
from mcspectra.samplers._kernels import _mix_below

LEVEL = 1 - (1 - 1e-6) ** (1 / 16)  # Šidák: at most 16 statistical tests in this file share 1e-6
SIGMAS = stats.norm.isf(LEVEL / 2)


def assert_variance(estimates, expected):
    """Compare a sample variance with theory, within SIGMAS of its standard error."""
    r = len(estimates)
    centred = estimates - estimates.mean()
    error = np.sqrt((np.mean(centred**4) - estimates.var() ** 2) / r)
    assert abs(estimates.var(ddof=1) - expected) < SIGMAS * error


def cell_indices(points, sides):
    """Number of the cell of every point, row-major: (R, n)."""
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


@pytest.mark.parametrize(
    ("sides", "sentence"),
    [
        ("[3]", "give one for each of the 2 dims"),
        ("[3, 0]", r"sides\[1\] is 0; give a whole number of at least 1"),
        ("[3, 2.5]", r"sides\[1\] is 2.5"),
        ("[3, True]", r"sides\[1\] is True"),
        ("'33'", "give a list of 2 whole numbers"),
        ("4", "give a list of 2 whole numbers"),
        ("[65536, 65536]", "4.29e[+]09 cells; at most 2.15e[+]09"),
    ],
)
@pytest.mark.parametrize("name", ["jittered", "uniform-jitter", "regular"])
def test_impossible_sides(name, sides, sentence):
    with pytest.raises(ParameterError, match=sentence):
        sampler(f"{name}(sides={sides})")


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
    # Pairs of coordinates of one point, then of neighbours in the order of generation
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
    """Exact: strata of width w contribute w²/12 each, independent of one another."""
    means = source.draw(n, realizations=20_000, rng=8)[..., 0].mean(axis=1)
    assert_variance(means, expected)
    assert abs(means.mean() - 0.5) < SIGMAS * np.sqrt(expected / len(means))


@pytest.mark.parametrize("sides", [(2, 5), (3, 1, 4)])
def test_closed_form_power_of_given_sides(sides):
    """From the characteristic functions of the points: |mean|² and, jittered, their own spread."""
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
    """Against one Gauss rule a cell and an offset, written differently."""
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
    elif name == "jittered":  # the seam of the torus cuts cells
        points = sampler(f"jittered(sides=[3, 5]) {rest}").draw(n, realizations=20_000, rng=4)
        assert_variance(estimator.integrand(points).mean(axis=1), found)
    else:
        means = values.mean(axis=0)
        np.testing.assert_allclose(found, weights @ means**2 - (weights @ means) ** 2, rtol=1e-6)
