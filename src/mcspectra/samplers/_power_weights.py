"""Numba kernels that give the cells of a power diagram prescribed areas: nothing checked.

Weights with which every cell has the area wanted are where a concave function is largest, the dual
of the transport of the uniform density to the sites. Damped Newton steps find them from any weights
that leave no cell empty [Kitagawa2019]_; the derivative of the areas by the weights is the Laplacian
of the graph of neighbours, each face counting length / (2 distance), which conjugate gradients solve.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.samplers._power_diagram import Diagram, power_diagram

__all__ = ["balance"]

_SOLVED = 1e-3  # residual of the linear equations, relative: Newton's steps need no better
_LONGER = 4.0  # than the step before, at most: far from the goal, short steps come in series
_HALVINGS = 40


@kernel
def _diagonal(diagram: Diagram, out: Array) -> None:
    for i in range(out.size):
        out[i] = 0.0
        for k in range(diagram.rows[i, 0], diagram.rows[i, 1]):
            out[i] += diagram.couplings[k]


@kernel
def _multiply(diagram: Diagram, x: Array, out: Array) -> float:
    # out = L x; return x · L x.
    product = 0.0
    for i in range(x.size):
        total = 0.0
        for k in range(diagram.rows[i, 0], diagram.rows[i, 1]):
            total += diagram.couplings[k] * (x[i] - x[diagram.neighbors[k]])
        out[i] = total
        product += x[i] * total
    return product


@kernel
def _divide(x: Array, diagonal: Array, out: Array) -> float:
    # out = x / diagonal; return x · out.
    product = 0.0
    for i in range(x.size):
        out[i] = x[i] / diagonal[i]
        product += x[i] * out[i]
    return product


@kernel
def _solve(diagram: Diagram, rest: Array) -> Array:
    # Return the change of the weights that changes areas by `rest`, which is overwritten.
    n = rest.size
    change, direction, work, diagonal = np.zeros(n), np.empty(n), np.empty(n), np.empty(n)
    _diagonal(diagram, diagonal)
    rho = _divide(rest, diagonal, direction)
    goal = _SOLVED**2 * rho
    for _ in range(4 * n):
        if rho <= goal:
            break
        length = rho / _multiply(diagram, direction, work)
        for i in range(n):
            change[i] += length * direction[i]
            rest[i] -= length * work[i]
        before, rho = rho, _divide(rest, diagonal, work)
        for i in range(n):
            direction[i] = work[i] + rho / before * direction[i]
    return change


@kernel
def _compare(areas: Array, masses: Array, rest: Array) -> Any:
    # Put masses − areas into `rest`; return the largest of them relative to a mass, and |rest|².
    worst, square = 0.0, 0.0
    for i in range(areas.size):
        rest[i] = masses[i] - areas[i]
        worst = max(worst, abs(rest[i]) / masses[i])
        square += rest[i] ** 2
    return worst, square


@kernel
def balance(points: Array, weights: Array, masses: Array, tolerance: float, steps: int) -> Any:
    """Return weights whose cells have areas `masses`, and their power diagram.

    At most so many Newton steps, from `weights` or, if those leave a cell empty, from 0, until all
    areas are right within `tolerance` times their mass or get no better.
    """
    weights, diagram = weights.copy(), power_diagram(points, weights)
    if diagram.areas.min() <= 0.0:
        weights[:] = 0.0
        diagram = power_diagram(points, weights)
    least = 0.5 * min(diagram.areas.min(), masses.min())
    rest, length = np.empty(weights.size), 1.0
    worst, square = _compare(diagram.areas, masses, rest)
    for _ in range(steps):
        if worst <= tolerance:
            break
        change, length = _solve(diagram, rest), min(1.0, _LONGER * length)
        for _ in range(_HALVINGS):
            trial = power_diagram(points, weights + length * change)
            trial_worst, trial_square = _compare(trial.areas, masses, rest)
            if trial.areas.min() > least and trial_square <= (1.0 - length / 2) ** 2 * square:
                break
            length /= 2
        else:
            break  # nothing is gained any more: rounding
        weights += length * change
        diagram, worst, square = trial, trial_worst, trial_square
    return weights, diagram
