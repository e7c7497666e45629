"""Lattices and Kronecker points: dual lattices, multiples, searches, gaps, discrepancy."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import qmc

import mcspectra as mcs
from mcspectra.core.errors import CountError
from mcspectra.samplers import Fibonacci, Korobov, Kronecker, Rank1Lattice
from mcspectra.samplers.lattice import golden_steps, nested_lattices


def worst_case_error(vector, n, power=2):
    """Return P_2 with weights 1/j^power, as in the classes' notes, summed directly."""
    x = np.arange(n)[:, None] * np.asarray(vector) % n / n
    weights = 1.0 / np.arange(1, len(vector) + 1) ** power
    kernel = 2 * np.pi**2 * (x * x - x + 1 / 6)
    return np.prod(1 + weights * kernel, axis=1).mean() - 1


@pytest.mark.parametrize(
    ("source", "n"),
    [
        (Rank1Lattice(dims=2), 32),
        (Rank1Lattice(dims=3), 31),
        (Rank1Lattice(dims=2, vector=[1, 21]), 34),
        (Rank1Lattice(dims=3, vector=(40, 7, 3)), 12),
        (Korobov(dims=3), 32),
        (Korobov(dims=3, a=50), 31),
        (Fibonacci(), 1),
        (Fibonacci(), 2),
        (Fibonacci(), 34),
    ],
)
def test_exponential_sums_are_one_on_the_dual_lattice_and_zero_off_it(source, n):
    z = source.generating_vector(n)
    points = source.draw(n)[0]
    m = np.array(list(itertools.product(range(-6, 7), repeat=source.dims)))
    sums = np.exp(2j * np.pi * m @ points.T).mean(axis=1)
    # Each phase of up to 18 cycles has a rounding error of 18·2π·eps
    np.testing.assert_allclose(sums, m @ z % n == 0, atol=18 * 2 * np.pi * np.finfo(float).eps)


def test_points_are_the_multiples():
    points = Rank1Lattice(dims=2, vector=[1, 5]).draw(8)[0]
    np.testing.assert_array_equal(points * 8, [[k, 5 * k % 8] for k in range(8)])


def test_korobov_vectors_are_the_powers():
    np.testing.assert_array_equal(Korobov(dims=5, a=7).generating_vector(100), [1, 7, 49, 43, 1])
    big = Korobov(dims=3, a=2**40 + 3).generating_vector(2**31 - 1)
    assert big.tolist() == [1, (2**40 + 3) % (2**31 - 1), (2**40 + 3) ** 2 % (2**31 - 1)]
    assert Korobov(dims=3).generating_vector(1).tolist() == [0, 0, 0]


@pytest.mark.parametrize("n", [1, 2, 3, 16, 30, 31, 101])
@pytest.mark.parametrize("dims", [1, 2, 4])
def test_korobov_generator_is_the_best_of_all(n, dims):
    units = [a for a in range(1, n) if math.gcd(a, n) == 1] or [1]
    best = min(worst_case_error([a**j % n for j in range(dims)], n, power=0) for a in units)
    found = worst_case_error(Korobov(dims=dims).generating_vector(n), n, power=0)
    assert found <= best * (1 + 1e-9)


def test_fibonacci_points_and_counts():
    points = Fibonacci().draw(13)[0]
    np.testing.assert_array_equal(points * 13, [[k, 8 * k % 13] for k in range(13)])
    assert Fibonacci().nearest_count(100) == 89
    with pytest.raises(CountError, match="89 and 144") as caught:
        Fibonacci().draw(100)
    assert caught.value.nearest == (89, 144)
    with pytest.raises(CountError, match="nearest count is 1836311903"):
        Fibonacci().check_count(2**31 - 1)


@pytest.mark.parametrize("n", [89, 233, 610])
def test_fibonacci_lattices_are_well_spread(n):
    """Shortest toroidal distance at least sqrt(2/(sqrt(5) n)), that of the limit lattice, minus 5
    %.

    Hexagonal lattices, the best, have sqrt(2/(sqrt(3) n)).
    """
    points = Fibonacci().draw(n)[0, 1:]
    shortest = np.linalg.norm(points - np.rint(points), axis=1).min()
    assert 0.95 * np.sqrt(2 / (np.sqrt(5) * n)) < shortest <= np.sqrt(2 / (np.sqrt(3) * n))


def test_shifted_lattices_have_the_variance_of_their_dual_lattice():
    """Var = Σ |f_m|² over the dual lattice: cos(2π(8x − y)) has 1/2 at n = 13, others have 0."""
    points = mcs.sampler("fibonacci | shift").draw(13, realizations=100, rng=1)
    on = np.cos(2 * np.pi * points @ [8, -1]).mean(axis=1)
    off = np.cos(2 * np.pi * points @ [7, -1]).mean(axis=1)
    np.testing.assert_allclose(off, 0.0, atol=1e-13)
    np.testing.assert_allclose(on, np.cos(2 * np.pi * points[:, 0] @ [8, -1]), atol=1e-13)


@pytest.mark.parametrize("n", [1, 2, 3, 16, 30, 31, 101])
def test_each_component_is_the_best_of_all(n):
    units = [z for z in range(1, n) if math.gcd(z, n) == 1] or [1]
    found = Rank1Lattice(dims=4).generating_vector(n)
    for j in range(1, 5):
        best = min(worst_case_error([*found[: j - 1], z], n) for z in units)
        assert worst_case_error(found[:j], n) <= best * (1 + 1e-9)


def test_vectors_of_fewer_dims_are_the_beginning_of_longer_ones():
    long = Rank1Lattice(dims=10).generating_vector(256)
    for dims in (1, 2, 5):
        np.testing.assert_array_equal(Rank1Lattice(dims=dims).generating_vector(256), long[:dims])


def test_thinned_search_is_still_better_than_most_vectors():
    """n = 2^14: 1,024 of 4,096 candidates; the best is among the best 1 % of 300 random ones."""
    n = 2**14
    found = worst_case_error(Rank1Lattice(dims=2).generating_vector(n), n)
    others = np.random.default_rng(1).integers(0, n // 2, 300) * 2 + 1
    assert found <= np.quantile([worst_case_error([1, z], n) for z in others], 0.01)


def test_axes_hold_one_point_in_each_nth():
    points = np.sort(Rank1Lattice(dims=10).draw(60)[0] * 60, axis=0)
    expected = np.broadcast_to(np.arange(60)[:, None], points.shape)
    np.testing.assert_allclose(points, expected, atol=1e-12)


@pytest.mark.parametrize("dims", [1, 2, 10])
def test_searches_of_large_lattices_take_little_time(dims):
    """The thinned search tests 16 candidates with 2^18 points."""
    vector = Korobov(dims=dims).generating_vector(2**18)
    assert vector[0] == 1
    assert len(vector) == dims


@pytest.mark.parametrize("dims", [1, 2, 3, 10, 100])
def test_steps_are_the_powers_of_the_golden_ratio_of_their_dims(dims):
    """x = 1/phi solves x^(d+1) + x^d = 1 between x ± 2^-64, in exact integers."""
    steps = [Fraction(int(s), 2**64) for s in golden_steps(dims)]
    below, above = steps[0], steps[0] + Fraction(1, 2**64)
    assert below ** (dims + 1) + below**dims <= 1 < above ** (dims + 1) + above**dims
    for j, step in enumerate(steps, start=1):
        assert below**j - Fraction(1, 2**64) < step < above**j


def test_golden_steps_of_one_dim_are_those_of_fibonacci_hashing():
    assert int(golden_steps(1)[0]) == 0x9E3779B97F4A7C15  # floor(2^64/phi)


def test_points_are_the_multiples_to_the_last_bit():
    alpha = [2**0.5, -(3**0.5), 1e-3]
    points = Kronecker(dims=3, alpha=alpha).draw(1000)[0]
    for j, a in enumerate(alpha):
        step = round(Fraction(a) % 1 * 2**64)
        expected = [(k * step % 2**64 >> 11) / 2**53 for k in range(1000)]
        np.testing.assert_array_equal(points[:, j], expected)


def test_differences_depend_on_differences_of_indices_only():
    points = Kronecker(dims=3).draw(2000)[0]
    for lag in (1, 7, 500):
        difference = (points[lag:] - points[:-lag]) % 1.0
        np.testing.assert_allclose(difference, difference[:1] + 0 * difference, atol=2.0**-52)


@pytest.mark.parametrize("alpha", [None, [0.41421356237309503], [0.1234567]])
@pytest.mark.parametrize("n", [2, 10, 100, 1000])
def test_three_gaps(alpha, n):
    """Steinhaus: n multiples divide the circle into gaps of at most three lengths."""
    x = np.sort(Kronecker(dims=1, alpha=alpha).draw(n)[0, :, 0] * 2.0**53).astype(np.int64)
    gaps = np.sort(np.diff(x, append=x[0] + 2**53))
    assert 1 + np.count_nonzero(np.diff(gaps) > 2) <= 3


@pytest.mark.parametrize("n", [13, 100, 1000])
def test_golden_points_are_evenly_spaced(n):
    """The gaps of the golden ratio differ by a factor of at most phi²: all exceed 1/(phi² n)."""
    x = np.sort(Kronecker(dims=1).draw(n)[0, :, 0])
    phi = (1 + 5**0.5) / 2
    assert np.diff(x, append=x[0] + 1).min() > 1 / (phi**2 * n)


@pytest.mark.parametrize("dims", [2, 3, 5])
def test_discrepancy_is_far_below_that_of_random_points(dims):
    """Random points: expected squared centered L2 discrepancy ((5/4)^d − (13/12)^d)/n."""
    n = 512
    squared = qmc.discrepancy(Kronecker(dims=dims).draw(n)[0], method="CD")
    assert squared < 0.2 * (1.25**dims - (13 / 12) ** dims) / n


def test_a_plain_number_is_allowed_in_one_dim():
    np.testing.assert_array_equal(
        Kronecker(dims=1, alpha=0.3).draw(9), Kronecker(dims=1, alpha=[0.3]).draw(9)
    )


@pytest.mark.parametrize("at_once", [True, False])
def test_nested_lattices_contain_the_default_lattice(at_once):
    nested = nested_lattices(mcs.sampler("rank1-lattice | shift", dims=3), 512, 8, at_once=at_once)
    small = mcs.sampler("rank1-lattice", dims=3).draw(64)[0]
    np.testing.assert_allclose(nested.plain.draw(512)[0][::8], small, atol=1e-15)
    assert [type(step).__name__ for step in nested.randomizations] == ["Shift"]
    given = mcs.sampler("rank1-lattice(vector=[1, 3, 5])", dims=3)
    assert nested_lattices(given, 512, 8) is given
