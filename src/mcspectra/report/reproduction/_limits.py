"""Judging many normal errors at once by the largest of them."""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.reproduction.base import GALLERY_FINDINGS, Finding

__all__ = ["largest_distance", "mean_and_error", "normal_limit"]


def normal_limit(count: int) -> float:
    """Return what the largest of `count` normal errors exceeds with the gallery's level for one finding."""
    from scipy.special import ndtri

    level = 0.95 ** (1 / (GALLERY_FINDINGS * count))
    return float(ndtri((1 + level) / 2))


def largest_distance(statement: str, difference: Array, se: Array) -> Finding:
    """Judge that differences vanish, all of them at once.

    Parameters
    ----------
    statement
        Without a full stop; what was measured is added.
    difference, se
        Measured minus expected and standard errors above 0, of one shape.
    """
    distance, limit = float(np.max(np.abs(difference) / se)), normal_limit(difference.size)
    return Finding(
        statement=f"{statement}: largest distance in standard errors.",
        expected=f"≤ {limit:.1f}",
        measured=distance,
        interval=None,
        agrees=distance <= limit,
        note=f"The limit is that of {difference.size} normal errors at the gallery's level.",
    )


def mean_and_error(values: Array) -> tuple[Array, Array]:
    """Return mean and standard error over the first axis."""
    return values.mean(axis=0), values.std(axis=0, ddof=1) / len(values) ** 0.5
