"""Poles of a function: climbed to from its extremes, and measured along rays from there.

From the largest or the smallest value that was seen, steps in random directions are taken where they climb,
and halved where they do not; the ellipsoid of directions learns from the moves ([Hansen2001]_). A function that is bounded ends its climb; one that grows as
r^−a towards a set of codimension k leads to it. Along rays from the top the differences
g(r) − g(4r) ∝ r^−a tell a, whatever constant is added. |g|^(−2/a) is a quadratic form of the distance: its
rank is k, with one for each face that the top lies on. The volume where |g| > λ is ∝ λ^(−k/a): ∫g² is
infinite where a/k ≥ ½, and there is no integral where a/k ≥ 1. Where faces meet, a product of powers of
distances to some of them has a tail of the largest power towards one, or of the mean of all.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["Pole", "pole_of"]

_HALVINGS = 16
_SLACK = 6  # climbs of one length of step, but the first
_LOOK = 3  # halvings, by whose gain a climb is judged
_ENDS = 0.3  # of the gain before: the value is bounded
_RAYS = 6
_LEARNS = 0.4  # of the shape of a climb, from each move
_RADII = 2.0 ** np.arange(4.0, 14.0, 2.0)  # of the last step
_NEAR = _RADII[:3]  # of a face
_FORM = 2.0**10  # of the last step: where the form is looked at
_ASIDE = 2.0**15  # of the last step, from all faces but one
_ALONE = 0.05  # exponent, towards one face
_RANK = 0.004  # of its largest eigenvalue
_BETTER = 1.005  # height, after a move
_FAR = 16, 0.1  # the largest of so many heights stands out from them by so much of itself
_LEAST = -0.02  # exponent
_EDGE = 2.0**-53

Function = Callable[[Array], Array]


@final
@dataclass(frozen=True)
class Pole:
    """Where a function grows without bound.

    Attributes
    ----------
    place
        A point of it, (d,).
    exponent
        a of r^−a, with r the distance.
    codimension
        k of the set that it grows towards: 1 of a surface, d of a point.
    border
        Whether that set lies in faces of the cube.
    """

    place: Array
    exponent: float
    codimension: int
    border: bool

    @property
    def tail(self) -> float:
        """Tail index a/k."""
        return self.exponent / self.codimension


def pole_of(
    g: Function, points: Array, values: Array, evaluations: int, rng: np.random.Generator
) -> Pole | None:
    """The pole that the value furthest from the median leads to, or else that on the other side.

    Parameters
    ----------
    g
        Points (k, d) to values (k,).
    points, values
        Where it is known, (k, d) and (k,).
    evaluations
        At most.
    """
    d = points.shape[1]
    centre, left = float(np.median(values)), evaluations

    def height(x: Array) -> Array:
        return np.abs(g(x) - centre)

    # Of what is bounded the largest values are alike
    measure = _RAYS * len(_RADII) + d * len(_NEAR) + d * (d + 1) // 2
    order = np.argsort(values)
    for largest in sorted((order[::-1], order), key=lambda k: -abs(values[k[0]] - centre)):
        top, least = np.abs(values[largest[[0, min(_FAR[0], len(values)) - 1]]] - centre)
        if not top - least > _FAR[1] * top:
            continue
        step = len(points) ** (-1.0 / d)
        place, step, made = _climbed(height, points[largest[0]], step, left - measure, rng)
        left -= made
        pole = _measured(height, place, step, rng) if step > 0.0 else None
        if pole is not None:
            return pole
        left -= measure if step > 0.0 else 0
    return None


def _climbed(
    g: Function, x: Array, step: float, evaluations: int, rng: np.random.Generator
) -> tuple[Array, float, int]:
    """The top, the last step to it, 0 where g is bounded, and the number of evaluations."""
    d, made, moves, value = len(x), 0, 0, 0.0
    heights, shape = list[float](), np.eye(d)
    while len(heights) < _HALVINGS:
        if made + 2 * d > evaluations:
            return x, 0.0, made
        ways = np.linalg.qr(rng.standard_normal((d, d)))[0] @ np.linalg.cholesky(shape).T
        size = step * rng.uniform(0.8, 1.25)  # no place twice
        around = np.clip(x + size * np.concatenate([ways, -ways]), 0.5 * step, 1.0 - 0.5 * step)
        new = g(around)
        made += 2 * d
        if new.max() > _BETTER * value:
            # Learn the shape of the climb by its moves
            best = around[np.argmax(new)]
            shape = (1.0 - _LEARNS) * shape + _LEARNS * np.outer(best - x, best - x) / size**2
            shape /= np.linalg.det(shape) ** (1.0 / d)
            x, value, moves = best, float(new.max()), moves + 1
            if moves <= _SLACK:
                continue
        heights.append(float(np.median(new)))
        step, moves = 0.5 * step, 0
        if len(heights) >= 3 * _LOOK:
            first, second, third = np.median(np.reshape(heights[-3 * _LOOK :], (3, -1)), axis=1)
            if not third - second > _ENDS * (second - first):
                return x, 0.0, made
    return x, step, made


def _measured(g: Function, top: Array, step: float, rng: np.random.Generator) -> Pole | None:
    """What rays from the top and the quadratic form about it tell."""
    d = len(top)
    top = np.where(top < 2.0 * step, _EDGE, np.where(top > 1.0 - 2.0 * step, 1.0 - _EDGE, top))
    inward = np.where(top < 0.5, 1.0, -1.0)
    side = np.minimum(top, 1.0 - top) < _RADII[-1] * step
    ways = rng.standard_normal((_RAYS, d))
    ways = np.where(side, np.abs(ways) * inward, ways)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    rays = top + step * _RADII[:, None, None] * ways
    values = g(rays.reshape(-1, d)).reshape(len(_RADII), _RAYS)
    if (np.diff(values, axis=0) >= 0.0).any(axis=0).mean() > 0.25:
        return None
    exponent = float(np.median(_slopes(values)[1:]))
    if exponent < _LEAST:
        return None
    if exponent < -_LEAST:
        return Pole(top, 0.0, 1, bool(side.any()))
    if side.sum() > 1:  # towards each face, away from the others
        faces = np.flatnonzero(side)
        aside = np.where(side, top + _ASIDE * step * inward, top)
        near = np.tile(aside, (len(_NEAR), len(faces), 1))
        near[:, np.arange(len(faces)), faces] = (top + step * _NEAR[:, None] * inward)[:, faces]
        values = g(near.reshape(-1, d)).reshape(len(_NEAR), -1)
        alone = float(_slopes(values).mean(axis=0).max())
        if alone > _ALONE:
            together = Pole(top, exponent, len(faces), True)
            return together if together.tail > alone else Pole(top, alone, 1, True)
    # Take away the constant that is added; a quadratic form by its values at sums of two axes
    factor = 4.0**exponent
    rest = float(np.median((factor * values[-1] - values[-2]) / (factor - 1.0)))
    first, second = np.triu_indices(d)
    axes = np.eye(d) * inward
    ways = np.where((first == second)[:, None], axes[first], axes[first] + axes[second])
    least = 1e-3 * max(float(np.median(values[-2])) - rest, 1e-300)
    size = np.maximum((g(top + _FORM * step * ways) - rest) / least, 1.0) ** (-2.0 / exponent)
    table = np.zeros((d, d))
    table[first, second] = table[second, first] = size
    own = np.diag(table)
    form = 0.5 * (table - own[:, None] - own) + 1.5 * np.diag(own)
    # A face counts unless the set goes on from it inwards
    side &= own > _RANK * own.max()
    free = np.linalg.eigvalsh(form[np.ix_(~side, ~side)])
    rank = int(side.sum() + (free > _RANK * own.max()).sum())
    return Pole(top, exponent, max(rank, 1), bool(side.any()))


def _slopes(values: Array) -> Array:
    """Exponents a of values ∝ r^−a, but for a constant, at radii r, 4r, …, (m, k): (m − 2, k)."""
    falls = np.maximum(values[:-1] - values[1:], 1e-300)
    return np.asarray(np.log(falls[:-1] / falls[1:]) / math.log(4.0))
