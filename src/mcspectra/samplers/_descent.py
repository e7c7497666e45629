"""Minimisation for samplers that optimise: limited-memory BFGS with bits that never vary.

Libraries of linear algebra may sum in another order with another number of threads; here every sum
is NumPy's own, so that a set depends on its random numbers only.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_uniform

__all__ = ["Function", "minimize", "random_points", "wrap"]

Function: TypeAlias = Callable[[Array], tuple[float, Array]]
"""What to minimise: points (n, d) to the value and its gradient (n, d)."""

_MEMORY = 10  # pairs of steps and changes of the gradient; 5 to 20 are usual
_DECREASE = 1e-4  # of what the slope promises, for a step to be taken
_HALVINGS = 20
_REPORTS = 50


def minimize(
    function: Function,
    start: Array,
    *,
    iterations: int,
    longest: float,
    report: Callable[[float], None],
    goal: float = -np.inf,
) -> Array:
    """Return points near `start` where `function` is small.

    Parameters
    ----------
    function
        Value and gradient; points are not wrapped into [0,1).
    start
        Points to begin with, (n, d).
    iterations
        Most steps taken.
    longest
        How far a coordinate may move in one step.
    report
        Called now and then with the fraction of the iterations done.
    goal
        A value that is small enough.

    References
    ----------
    Nocedal (1980), "Updating quasi-Newton matrices with limited storage",
    doi 10.1090/S0025-5718-1980-0572855-7.
    """
    x, (value, gradient) = start, function(start)
    memory: deque[tuple[Array, Array, float]] = deque(maxlen=_MEMORY)
    for i in range(iterations):
        if i % max(1, iterations // _REPORTS) == 0:
            report(i / iterations)
        if value <= goal or not gradient.any():
            break
        taken = _step(function, x, value, gradient, memory, longest)
        if taken is None and not memory:
            break  # even along the gradient nothing is gained: rounding
        if taken is None:
            memory.clear()
            continue
        moved, value, changed = taken
        _remember(memory, moved - x, changed - gradient)
        x, gradient = moved, changed
    return x


def _step(
    function: Function,
    x: Array,
    value: float,
    gradient: Array,
    memory: deque[tuple[Array, Array, float]],
    longest: float,
) -> tuple[Array, float, Array] | None:
    """Return points, value and gradient after one step that gains enough; None if none does."""
    direction = _direction(gradient, memory)
    slope = _dot(direction, gradient)
    length = longest / float(np.abs(direction).max())
    length = min(1.0, length) if memory else length
    for _ in range(_HALVINGS):
        moved = x + length * direction
        trial, changed = function(moved)
        if trial <= value + _DECREASE * length * slope:
            return moved, trial, changed
        length /= 2
    return None


def _direction(gradient: Array, memory: deque[tuple[Array, Array, float]]) -> Array:
    """Return minus the approximate inverse Hessian times the gradient: Nocedal's two loops."""
    direction, factors = -gradient, []
    for step, change, product in reversed(memory):
        factor = _dot(step, direction) / product
        direction = direction - factor * change
        factors.append(factor)
    if memory:
        _, change, product = memory[-1]
        direction = direction * (product / _dot(change, change))
    for (step, change, product), factor in zip(memory, reversed(factors), strict=True):
        direction = direction + (factor - _dot(change, direction) / product) * step
    return direction


def _remember(memory: deque[tuple[Array, Array, float]], step: Array, change: Array) -> None:
    product = _dot(step, change)
    if product > 1e-10 * _dot(change, change) ** 0.5 * _dot(step, step) ** 0.5:
        memory.append((step, change, product))  # positive curvature only


def _dot(a: Array, b: Array) -> float:
    return float(np.sum(a * b))


def wrap(points: Array) -> Array:
    """Return points modulo 1, all below 1."""
    inside = points - np.floor(points)
    inside[inside >= 1.0] = 0.0  # −1e-20 is 1 after rounding
    return inside


def random_points(keys: Array, n: int, dims: int) -> Array:
    """Return the first n·d numbers of a realisation as independent uniform points (n, d)."""
    out = np.empty((n, dims))
    _fill(keys[0], keys[1], out)
    return out


@kernel
def _fill(k0: np.uint64, k1: np.uint64, out: Array) -> None:
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = mix_uniform(k0, k1, i * out.shape[1] + j)
