"""Randomisations: what they keep exactly, what they make uniform, and exact variances after them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import DigitalShift, Owen, Random, Shift, StrataShift, sampler

LEVEL = 1 - (1 - 1e-6) ** (1 / 24)  # Šidák: 24 statistical tests in this file share 1e-6
SIGMAS = stats.norm.isf(LEVEL / 2)
BELOW_ONE = np.nextafter(1.0, 0.0)
STREAM = Stream.from_rng(42)


def test_shift_keeps_differences_on_the_torus():
    points = Random(dims=3).draw(20, realizations=10, rng=1)
    moved = Shift().apply(points, STREAM, 0)
    difference = (moved - points) - (moved - points)[:, :1]
    np.testing.assert_allclose(difference, np.rint(difference), atol=4 * 2.0**-53)
    assert len(np.unique((moved - points)[:, 0, 0])) == 10


def test_shift_is_uniform_and_its_coordinates_are_independent():
    moved = Shift().apply(np.full((6400, 1, 2), 0.3), STREAM, 0)[:, 0]
    pairs = (np.floor(moved * 8) @ [8, 1]).astype(int)
    assert stats.chisquare(np.bincount(pairs, minlength=64)).pvalue > LEVEL


@pytest.mark.parametrize(
    "step", [Shift(), DigitalShift(), Owen(), StrataShift(), StrataShift(offset=-1e-20)], ids=str
)
def test_results_stay_below_one_at_the_edges(step):
    edges = np.array([0.0, 5e-324, 2.0**-60, 2.0**-33, 0.5 - 2.0**-54, 0.5, BELOW_ONE])
    moved = step.apply(np.tile(edges[:, None], (20_000, 1, 1)), STREAM, 0)
    assert moved.min() >= 0.0
    assert moved.max() < 1.0


@pytest.mark.parametrize(
    ("x", "offset", "expected"),
    [
        (BELOW_ONE, 2.0**-53, 0.0),  # the sum is 1
        (BELOW_ONE, 2.0**-54, 0.0),  # the sum rounds to 1
        (BELOW_ONE, BELOW_ONE, 1 - 2.0**-52),
        (0.25, 0.5, 0.75),
        (0.75, 0.5, 0.25),
        (0.0, -0.25, 0.75),
        (0.5, 3.25, 0.75),
        (0.5, -1e-20, 0.5),  # the remainder of −1e-20 is 1
    ],
)
def test_translation_to_the_last_bit(x, offset, expected):
    moved = StrataShift(offset=offset).apply(np.array([[[x]]]), STREAM, 0)
    assert moved.item() == expected


def test_strata_shift_is_a_part_of_the_side():
    points = sampler("regular(position='corner')", 2).draw(16)
    moved = StrataShift(offset=[0.5, 0.25]).apply(points, STREAM, 0)
    np.testing.assert_array_equal(moved, (points + np.array([0.125, 0.0625])) % 1.0)
    chained = sampler("regular(position='corner') | strata-shift(offset=[0.5, 0.25])", 2)
    np.testing.assert_array_equal(chained.draw(16), moved)


def test_digital_shift_keeps_the_xor_of_points():
    points = Random(dims=2).draw(16, realizations=5, rng=2)
    before = (points * 2.0**53).astype(np.uint64)
    after = (DigitalShift().apply(points, STREAM, 0) * 2.0**53).astype(np.uint64)
    word = before ^ after
    np.testing.assert_array_equal(word, np.broadcast_to(word[:, :1], word.shape))
    assert len(np.unique(word[:, 0])) == 10


@pytest.mark.parametrize("step", [DigitalShift(), Owen()], ids=str)
@pytest.mark.parametrize("x", [0.0, 0.3, BELOW_ONE])
def test_digital_randomizations_make_points_uniform(step, x):
    """χ² of the leading 6 bits, the bits 31 to 36 across the seam of scrambling, and the last 6."""
    moved = step.apply(np.full((6400, 1, 1), x), STREAM, 0).ravel()
    for scale in (0, 30, 47):
        bits = np.floor(moved * 2.0 ** (scale + 6)).astype(np.int64) % 64
        assert stats.chisquare(np.bincount(bits, minlength=64)).pvalue > LEVEL / 3


def common_bits(a, b):
    """Number of leading bits, of 32, that two coordinates share."""
    words = np.floor(np.stack([a, b]) * 2.0**32).astype(np.int64)
    return 32 - np.array([int(w).bit_length() for w in words[0] ^ words[1]])


def test_owen_keeps_the_number_of_common_leading_bits():
    rng = np.random.default_rng(3)
    near = rng.random(2000)
    far = np.abs(near - 2.0 ** -rng.integers(1, 34, 2000).astype(float)) % 1.0
    moved = Owen().apply(np.stack([near, far]).reshape(1, -1, 1), STREAM, 0).reshape(2, -1)
    shared = common_bits(near, far)
    assert shared.min() == 0
    assert shared.max() >= 31
    np.testing.assert_array_equal(common_bits(*moved), shared)


@pytest.mark.parametrize("level", [1, 5, 6, 7, 11, 12, 30, 31])
def test_owen_flips_hang_on_every_bit_above(level):
    """Two prefixes that differ in their last bit have independent flips of the next bit."""
    x = np.array([0.0, 2.0**-level])
    moved = Owen().apply(np.tile(x[:, None], (4000, 1, 1)), STREAM, 0)[..., 0]
    flips = np.floor(moved * 2.0 ** (level + 1)).astype(np.int64) % 2
    pairs = np.bincount(flips @ [2, 1], minlength=4)
    assert stats.chisquare(pairs).pvalue > LEVEL


def test_owen_tails_are_independent():
    """Two points of equal 32 leading bits stay together down to 2^-32 and part below."""
    moved = Owen().apply(np.full((4000, 2, 1), 0.3), STREAM, 0)[..., 0]
    np.testing.assert_array_equal(*np.floor(moved * 2.0**32).T)
    tails = np.floor(moved * 2.0**32 % 1.0 * 4).astype(int) @ [4, 1]
    assert stats.chisquare(np.bincount(tails, minlength=16)).pvalue > LEVEL


@pytest.mark.parametrize(
    ("spec", "dims", "n", "expected"),
    [
        ("regular | shift", 1, 16, 1 / (12 * 16**2)),
        ("jittered | shift", 1, 16, 1 / (6 * 16**2) - 1 / (12 * 16**3)),
        ("jittered | shift", 2, 16, 16**-1.5 / 6 - 16**-2 / 12),
        ("random | owen", 1, 16, 1 / (12 * 16)),
        ("sobol | digital-shift", 1, 16, 1 / (12 * 16**2)),
        ("sobol | owen", 1, 16, 1 / (12 * 16**3)),
        ("sobol | owen", 3, 16, 1 / (12 * 16**3)),
    ],
)
def test_variance_of_the_mean_coordinate(spec, dims, n, expected):
    """Exact: a shared offset of one n-th gives 1/(12 n²), independent strata 1/(12 n³)."""
    means = sampler(spec, dims).draw(n, realizations=20_000, rng=8)[..., -1].mean(axis=1)
    centred = means - means.mean()
    error = np.sqrt((np.mean(centred**4) - means.var() ** 2) / len(means))
    assert abs(means.var(ddof=1) - expected) < SIGMAS * error
    assert abs(means.mean() - 0.5) < SIGMAS * np.sqrt(expected / len(means))


def test_owen_beats_jitter_on_a_smooth_function():
    """exp(−x²−y²), n = 256: below the jittered variance ∫|∇f|²/(12 n²), itself 1/34 of random's.

    Owen's variance is of order n^-3 log n; SIGMAS standard errors, sqrt(2/R), are added.
    """
    n, realizations = 256, 500
    points = sampler("sobol | owen", 2).draw(n, realizations=realizations, rng=9)
    square = np.square(points).sum(axis=-1)
    values = np.exp(-square)
    jittered = np.mean(4 * square * values**2) / (12 * n**2)
    measured = values.mean(axis=1).var(ddof=1)
    assert measured * (1 + SIGMAS * np.sqrt(2 / realizations)) < jittered
    assert jittered < 0.1 * values.var() / n


@pytest.mark.parametrize(
    "offset", ["x", None, True, float("nan"), float("inf"), [], [0.5, None], [0.1, 0.2, 0.3], {}]
)
def test_bad_offsets(offset):
    with pytest.raises(ParameterError, match="offset"):
        Random(dims=2).then(StrataShift(offset=offset))


def test_declared_properties():
    declared = {
        step.name: (step.stationary, step.debiases)
        for step in (Shift, DigitalShift, Owen, StrataShift)
    }
    assert declared == {
        "shift": (True, True),
        "digital-shift": (False, True),
        "owen": (False, True),
        "strata-shift": (False, False),
    }
