"""Randomisations: what they keep exactly, what they make uniform, and exact variances after them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import Random, Shift, StrataShift, sampler

LEVEL = 1 - (1 - 1e-6) ** (1 / 4)  # Šidák: 4 statistical tests in this file share 1e-6
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


@pytest.mark.parametrize("step", [Shift(), StrataShift(), StrataShift(offset=-1e-20)], ids=str)
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


@pytest.mark.parametrize(
    ("spec", "dims", "n", "expected"),
    [
        ("regular | shift", 1, 16, 1 / (12 * 16**2)),
        ("jittered | shift", 1, 16, 1 / (6 * 16**2) - 1 / (12 * 16**3)),
        ("jittered | shift", 2, 16, 16**-1.5 / 6 - 16**-2 / 12),
    ],
)
def test_variance_of_the_mean_coordinate(spec, dims, n, expected):
    """Exact: a shared offset of one n-th gives 1/(12 n²); independent strata 1/(12 n³)."""
    means = sampler(spec, dims).draw(n, realizations=20_000, rng=8)[..., -1].mean(axis=1)
    centred = means - means.mean()
    error = np.sqrt((np.mean(centred**4) - means.var() ** 2) / len(means))
    assert abs(means.var(ddof=1) - expected) < SIGMAS * error
    assert abs(means.mean() - 0.5) < SIGMAS * np.sqrt(expected / len(means))


@pytest.mark.parametrize(
    "offset", ["x", None, True, float("nan"), float("inf"), [], [0.5, None], [0.1, 0.2, 0.3], {}]
)
def test_bad_offsets(offset):
    with pytest.raises(ParameterError, match="offset"):
        Random(dims=2).then(StrataShift(offset=offset))


def test_declared_properties():
    declared = {step.name: (step.stationary, step.debiases) for step in (Shift, StrataShift)}
    assert declared == {
        "shift": (True, True),
        "strata-shift": (False, False),
    }
