"""Rates of techniques along n, and which of them becomes the rate of the whole estimate.

A sum of parts that converge at different rates ends up with the slowest. Which one that is can be
said if the 95 % interval of its rate lies above those of all others; where intervals overlap, the
measurement leaves it undecided.
"""

from __future__ import annotations

import math

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.parallel import Block, map_in_order, realization_blocks
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator, Moments
from mcspectra.estimators.moments import rounding_floor
from mcspectra.samplers import Sampler
from mcspectra.variance.batches import Variables
from mcspectra.variance.fit import RateFit, fit_rate

__all__ = ["UNDECIDED", "in_words", "technique_moments", "technique_rates"]

UNDECIDED = -1
"""What ``bottleneck`` says where the intervals of the slowest rates overlap."""


def technique_rates(
    ns: list[int], moments: list[Moments], window: int | str
) -> tuple[Variables, list[int]]:
    """Rates of all techniques and of the whole estimate, and the bottleneck of each channel.

    Parameters
    ----------
    ns, moments, window
        Counts, for each the moments (C, T + 1) of the techniques' parts and of the whole estimate, and
        what to fit (`mcspectra.variance.fit.check_window`).
    """
    variance = np.stack([m.variance for m in moments])  # (N, C, T + 1)
    relative = np.stack([m.relative_se for m in moments])
    # What is noise is measured against the whole estimate: a part of it may be 0.
    size = np.stack([np.abs(m.mean).max(axis=1, keepdims=True) for m in moments])
    floor = np.broadcast_to(rounding_floor(size), variance.shape)
    counts = np.array(ns)
    channels, columns = variance.shape[1:]
    fits = [
        [
            fit_rate(counts, variance[:, c, t], relative[:, c, t], floor[:, c, t], window)
            for t in range(columns)
        ]
        for c in range(channels)
    ]
    rate = np.array([[fit.rate for fit in row] for row in fits])
    interval = np.array([[fit.interval for fit in row] for row in fits])
    still = np.asarray((variance <= floor)[:, :, :-1].all(axis=0))
    choice = [_bottleneck(fits[c][:-1], still[c]) for c in range(channels)]
    variables: Variables = {
        "technique_rate": (("channel", "technique"), rate[:, :-1]),
        "technique_rate_ci": (("channel", "technique", "bound"), interval[:, :-1]),
        "rate": (("channel",), rate[:, -1]),
        "rate_ci": (("channel", "bound"), interval[:, -1]),
        "bottleneck": (("channel",), np.array(choice)),
    }
    return variables, choice


def technique_moments(
    estimator: AbstractEstimator,
    sampler: Sampler,
    n: int,
    realizations: int,
    stream: Stream,
    workers: int = 1,
) -> Moments:
    """Moments (C, T + 1) of the parts of the estimate that techniques make, and of their sum."""

    def of_block(block: Block) -> Moments:
        points = estimator.draw(sampler, n, stream, *block)
        parts = [
            estimator.primary_values(t, u).mean(axis=1).reshape(block[1], -1)
            for t, u in enumerate(points)
        ]
        return Moments.of(np.stack([*parts, sum(parts[1:], parts[0])], axis=2))

    numbers = n * estimator.dims * sum(estimator.counts)
    found = map_in_order(of_block, realization_blocks(realizations, numbers), workers)
    total = next(found)
    for moments in found:
        total = total.merge(moments)
    return total


def _bottleneck(fits: list[RateFit], still: Array) -> int:
    """The technique whose interval lies above those of all others that vary, or `UNDECIDED`."""
    moving = np.flatnonzero(~still)
    if not moving.size:
        return UNDECIDED
    slowest = max(moving.tolist(), key=lambda t: np.nan_to_num(fits[t].rate, nan=-math.inf))
    low = fits[slowest].interval[0]
    others = [fits[t].interval[1] for t in moving.tolist() if t != slowest]
    # A rate that could not be fitted compares false: undecided.
    return slowest if math.isfinite(low) and all(high < low for high in others) else UNDECIDED


def in_words(choice: list[int], *, scalar: bool) -> str:
    """The bottleneck of each channel as text: ``"technique 1"`` or ``"undecided"``."""
    words = ["undecided" if t == UNDECIDED else f"technique {t}" for t in choice]
    return words[0] if scalar else "; ".join(words)
