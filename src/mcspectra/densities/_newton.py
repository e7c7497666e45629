"""Inverse of increasing functions on [0,1] that come with their slope."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["solve_increasing"]

_MOST = 120  # bisections alone need 53; with Newton's steps between them at most twice as many
_EPS = float(np.finfo(float).eps)


def solve_increasing(function: Callable[[Array], tuple[Array, Array]], target: Array) -> Array:
    """Solve F(s) = target element by element, by Newton's steps safeguarded by bisection.

    Parameters
    ----------
    function
        s to F(s) and F'(s) > 0, for an F from F(0) = 0 to F(1) = 1; all of the shape of `target`.
    target
        Values in [0,1].

    Notes
    -----
    An element that has converged stays as it is, so that results do not depend on its neighbours.
    """
    low, high = np.zeros_like(target), np.ones_like(target)
    s, last = target.copy(), np.ones_like(target)
    done = np.zeros(target.shape, bool)
    for _ in range(_MOST):
        value, slope = function(s)
        gap = value - target
        low, high = np.where(gap <= 0, s, low), np.where(gap >= 0, s, high)
        step = gap / slope
        done |= np.abs(gap) <= 4.0 * _EPS * target
        small = np.abs(step) <= 8.0 * _EPS * s
        newton = (s - step >= low) & (s - step <= high) & (small | (np.abs(step) <= 0.5 * last))
        new = np.where(done, s, np.where(newton, s - step, 0.5 * (low + high)))
        last = np.abs(new - s)
        done |= small | (last <= _EPS * new)
        s = new
        if done.all():
            break
    return s
