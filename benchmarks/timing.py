"""Timing of two functions in turn, so that a busy machine slows both."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

__all__ = ["compare", "timed_pairs"]


def compare(
    subject: Callable[[], Any], reference: Callable[[], Any], rounds: int = 15
) -> tuple[float, float, float]:
    """Return the shortest time of each function in seconds, and the median ratio of their times.

    Each ratio compares two calls that follow each other: `subject` and then `reference`.
    """
    pairs = timed_pairs(subject, reference, rounds)
    best = (min(a for a, _ in pairs), min(b for _, b in pairs))
    return (*best, statistics.median(a / b for a, b in pairs))


def timed_pairs(
    subject: Callable[[], Any], reference: Callable[[], Any], rounds: int
) -> list[tuple[float, float]]:
    """Return the seconds of both functions in each round, after a round that is not timed."""
    subject(), reference()  # a first call compiles, plans and fills caches
    pairs = []
    for _ in range(rounds):
        start = time.perf_counter()
        subject()
        middle = time.perf_counter()
        reference()
        pairs.append((middle - start, time.perf_counter() - middle))
    return pairs
