"""Rank-1 lattices: the dual lattice exactly, the construction against exhaustive search."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from mcspectra.core.errors import ParameterError
from mcspectra.samplers import Rank1Lattice


def worst_case_error(vector, n):
    """P_2 with weights 1/j², as in the class's notes, summed as it stands."""
    x = np.arange(n)[:, None] * np.asarray(vector) % n / n
    weights = 1.0 / np.arange(1, len(vector) + 1) ** 2
    kernel = 2 * np.pi**2 * (x * x - x + 1 / 6)
    return np.prod(1 + weights * kernel, axis=1).mean() - 1


@pytest.mark.parametrize(
    ("source", "n"),
    [
        (Rank1Lattice(dims=2), 32),
        (Rank1Lattice(dims=3), 31),
        (Rank1Lattice(dims=2, vector=[1, 21]), 34),
        (Rank1Lattice(dims=3, vector=(40, 7, 3)), 12),
    ],
)
def test_exponential_sums_are_one_on_the_dual_lattice_and_zero_off_it(source, n):
    z = source.generating_vector(n)
    points = source.draw(n)[0]
    m = np.array(list(itertools.product(range(-6, 7), repeat=source.dims)))
    sums = np.exp(2j * np.pi * m @ points.T).mean(axis=1)
    # Phases up to 18 cycles have 18·2π·eps of rounding each
    np.testing.assert_allclose(sums, m @ z % n == 0, atol=18 * 2 * np.pi * np.finfo(float).eps)


def test_points_are_the_multiples():
    points = Rank1Lattice(dims=2, vector=[1, 5]).draw(8)[0]
    np.testing.assert_array_equal(points * 8, [[k, 5 * k % 8] for k in range(8)])


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
    """n = 2^14: 1,024 of 4,096 candidates; the best of them is in the best 1 % of 300 drawn."""
    n = 2**14
    found = worst_case_error(Rank1Lattice(dims=2).generating_vector(n), n)
    others = np.random.default_rng(1).integers(0, n // 2, 300) * 2 + 1
    assert found <= np.quantile([worst_case_error([1, z], n) for z in others], 0.01)


def test_axes_hold_one_point_in_each_nth():
    points = np.sort(Rank1Lattice(dims=10).draw(60)[0] * 60, axis=0)
    expected = np.broadcast_to(np.arange(60)[:, None], points.shape)
    np.testing.assert_allclose(points, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("vector", "words"),
    [
        ([1], "1 components, dims is 2"),
        ([1, 2, 3], "3 components"),
        ([], "0 components"),
        ([1, 2.5], r"vector\[1\]"),
        ([1, -3], r"vector\[1\]"),
        ([1, float("nan")], r"vector\[1\]"),
        ([1, "x"], r"vector\[1\]"),
        ("15", "list of whole numbers"),
        (5, "list of whole numbers"),
    ],
)
def test_bad_vectors(vector, words):
    with pytest.raises(ParameterError, match=words):
        Rank1Lattice(dims=2, vector=vector)
