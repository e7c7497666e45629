"""Latin hypercubes and orthogonal arrays: every projection is stratified exactly as declared."""

import itertools

import numpy as np
import pytest
from scipy import stats

import mcspectra as mcs
from mcspectra.core.errors import CountError
from mcspectra.samplers import LatinHypercube, NRooks, OrthogonalArray, sampler
from mcspectra.samplers.orthogonal import _slots

LEVEL = 1 - (1 - 1e-6) ** (1 / 5)  # Šidák: the χ² tests of this file share a level of 1e-6
JITTERS = ("jittered", "multi-jittered", "correlated-multi-jittered")


def assert_each_once(numbers, many):
    """Assert that every row of `numbers` is a permutation of 0 … many − 1."""
    expected = np.tile(np.arange(many), (len(numbers), 1))
    np.testing.assert_array_equal(np.sort(numbers, axis=1), expected)


def assert_latin(points):
    """Assert one point in each n-th of every axis."""
    n = points.shape[1]
    for j in range(points.shape[2]):
        assert_each_once(np.floor(points[..., j] * n), n)


def assert_stratified(points, s, strength):
    """Assert that each of the s^t cells of every projection onto t axes holds one point."""
    powers = s ** np.arange(strength)
    for axes in itertools.combinations(range(points.shape[2]), strength):
        assert_each_once(np.floor(points[..., axes] * s) @ powers, s**strength)


def pattern_counts(points):
    """Count how often each assignment of the points to strata of each axis was drawn."""
    strata = np.floor(points * points.shape[1]).reshape(len(points), -1)
    return np.unique(strata, axis=0, return_counts=True)[1]


@pytest.mark.parametrize(("n", "dims"), [(1, 3), (7, 1), (50, 2), (33, 5)])
def test_latin_hypercube_projections(n, dims):
    assert_latin(LatinHypercube(dims=dims).draw(n, realizations=50, rng=2))


def test_n_rooks_is_the_latin_hypercube_in_two_dims():
    rooks = NRooks().draw(17, realizations=3, rng=2)
    np.testing.assert_array_equal(rooks, LatinHypercube(dims=2).draw(17, realizations=3, rng=2))
    frequencies = [[1, 0], [3, 2]]
    np.testing.assert_array_equal(
        mcs.closed_form_power("n-rooks", 17, frequencies),
        mcs.closed_form_power("latin-hypercube", 17, frequencies),
    )


def test_latin_hypercube_permutations_are_uniform_and_independent():
    counts = pattern_counts(LatinHypercube(dims=2).draw(3, realizations=18_000, rng=4))
    assert len(counts) == 36
    assert stats.chisquare(counts).pvalue > LEVEL


@pytest.mark.parametrize(("p", "dims"), [(2, 1), (2, 3), (3, 4), (5, 2), (7, 8), (31, 3)])
def test_strength_2_is_latin_and_stratified_in_all_pairs(p, dims):
    points = LatinHypercube(dims=dims, strength=2).draw(p * p, realizations=20, rng=5)
    assert_latin(points)
    if dims > 1:
        assert_stratified(points, p, 2)


@pytest.mark.parametrize("jitter", JITTERS)
@pytest.mark.parametrize(
    ("s", "strength", "dims"), [(2, 2, 3), (3, 2, 2), (5, 2, 6), (2, 3, 3), (3, 3, 4), (5, 4, 6)]
)
def test_orthogonal_array_projections(jitter, s, strength, dims):
    source = OrthogonalArray(dims=dims, strength=strength, jitter=jitter)
    points = source.draw(s**strength, realizations=20, rng=6)
    for fewer in range(2, strength):  # each cell of fewer axes holds as many points as any other
        for axes in itertools.combinations(range(dims), fewer):
            cells = (np.floor(points[..., axes] * s) @ s ** np.arange(fewer)).astype(int)
            assert all(len(set(np.bincount(row))) == 1 for row in cells)
    assert_stratified(points, s, strength)
    if jitter != "jittered":
        assert_latin(points)


@pytest.mark.parametrize("s", [2, 3, 5, 7])
@pytest.mark.parametrize("strength", [2, 3])
def test_the_array_is_that_of_bush(s, strength):
    """Polynomials written out: the digits of the row are coefficients, values are modulo s."""
    dims = s + 1
    slots = _slots(s, dims, strength, "jittered")
    for row, levels in enumerate(slots):
        digits = [row // s**k % s for k in range(strength)]
        values = [sum(c * x**k for k, c in enumerate(digits)) % s for x in range(s)]
        assert levels.tolist() == [digits[-1], *values]


def test_latin_hypercube_of_strength_2_is_the_default_orthogonal_array():
    latin = LatinHypercube(dims=4, strength=2).draw(25, realizations=3, rng=1)
    np.testing.assert_array_equal(latin, OrthogonalArray(dims=4).draw(25, realizations=3, rng=1))


@pytest.mark.parametrize(
    ("jitter", "patterns"),
    [
        # 2! names of the levels on each axis, and the assignment of their halves: 2!² or 2! ways
        ("multi-jittered", (2 * 2**2) ** 2),
        ("correlated-multi-jittered", (2 * 2) ** 2),
    ],
)
def test_shuffles_are_uniform_and_independent(jitter, patterns):
    counts = pattern_counts(OrthogonalArray(jitter=jitter).draw(4, realizations=16_000, rng=6))
    assert len(counts) == patterns
    assert stats.chisquare(counts).pvalue > LEVEL


@pytest.mark.parametrize(("jitter", "strata"), [(JITTERS[0], 3), (JITTERS[1], 9)])
def test_jitter_within_the_strata_is_uniform(jitter, strata):
    points = OrthogonalArray(jitter=jitter).draw(9, realizations=4000, rng=12)
    inside = points * strata % 1.0
    pairs = (8 * np.floor(8 * inside[..., 0]) + np.floor(8 * inside[..., 1])).astype(int)
    assert stats.chisquare(np.bincount(pairs.ravel(), minlength=64)).pvalue > LEVEL


@pytest.mark.parametrize(
    ("strength", "dims", "smallest"), [(2, 2, 2), (2, 4, 3), (2, 5, 5), (3, 3, 2), (3, 10, 11)]
)
def test_counts_are_powers_of_the_primes_that_fit(strength, dims, smallest):
    primes = [q for q in (2, 3, 5, 7, 11, 13, 17) if q >= smallest]
    possible = [q**strength for q in primes]
    source = OrthogonalArray(dims=dims, strength=strength)
    for n in range(1, possible[-1]):
        below, above = source._counts_near(n)
        assert below == max((m for m in possible if m <= n), default=None)
        assert above == min(m for m in possible if m >= n)


def test_impossible_counts_name_the_nearest():
    with pytest.raises(CountError, match="9 and 25"):
        OrthogonalArray(dims=2).draw(16)
    with pytest.raises(CountError, match="nearest count is 121"):
        sampler("latin-hypercube(strength=2)", 10).draw(49)
    assert OrthogonalArray(dims=2).nearest_count(2**31) == 46_337**2


def test_strength_2_has_its_own_variance():
    exact = mcs.exact_variance(mcs.Estimator("linear", dims=1), "latin-hypercube(strength=2)", 9)
    np.testing.assert_allclose(exact, 1 / (12 * 9**3), rtol=1e-9)


def test_strength_2_integrates_functions_of_two_axes():
    """A product of two coordinates out of four: strength 2 leaves O(n^-2), Latin sets 1/(144 n)."""
    n = 11**2
    variances = {}
    for strength in (1, 2):
        x = LatinHypercube(dims=4, strength=strength).draw(n, realizations=2000, rng=7)
        variances[strength] = np.mean((x[..., 0] - 0.5) * (x[..., 2] - 0.5), axis=1).var()
    # Relative error of a variance from 2000 values: √(2/2000) = 0.03 for Gaussians
    np.testing.assert_allclose(variances[1], 1 / (144 * n), rtol=6 * 0.04)
    assert variances[2] < variances[1] / 10
