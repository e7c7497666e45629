"""What exact moments of S_ν are made of: transforms of the unit interval and of grids."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["Moments", "comb", "interval", "product"]


@dataclass(frozen=True)
class Moments:
    """Exact moments of S_ν.

    Attributes
    ----------
    mean
        ⟨S_ν⟩ of frequencies (..., d): complex (...).
    covariance
        C_ml of two arrays of frequencies of the same shape (..., d): complex (...).
    integer
        Whether they hold at integer frequencies only: points wrapped around the torus.
    """

    mean: Callable[[Array], Array]
    covariance: Callable[[Array, Array], Array]
    integer: bool = False


def interval(nu: Array) -> Array:
    """Transform of the unit interval, χ(ν), of each coordinate."""
    return np.asarray(np.sinc(nu) * np.exp(-1j * np.pi * np.remainder(nu, 2.0)))


def comb(nu: Array, sides: Any) -> Array:
    """Transform of the grid {j/s}, A_s(ν), of each coordinate; period s."""
    s = np.asarray(sides, float)
    rest = nu - s * np.rint(nu / s)  # within half a period the quotient is safe
    return np.asarray(interval(rest) / interval(rest / s))


def product(values: Array) -> Array:
    """Π over the axes."""
    return np.asarray(np.prod(values, axis=-1))
