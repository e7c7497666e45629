"""What is rough about a black-box function: along lines, zoomed in on where it bends most, and at its poles.

A line is looked at in equal steps, and close to its ends. Where the second difference is largest the steps
are halved, two evaluations each time: it shrinks with the square of the step where the function is smooth,
with the step at a kink, not at all at a jump, and grows at a pole. Towards the ends of lines along the axes steps
shrink faster: the slope of log |g| there is how fast g grows at the border.

Poles are climbed to: from the largest or the smallest value that was seen, steps in random directions are
taken where they climb, and halved where they do not; the ellipsoid of directions learns from the moves
([Hansen2001]_). A function that is bounded ends its climb; one that grows as r^−a towards a set of
codimension k leads to it. Along rays from the top the differences
g(r) − g(4r) ∝ r^−a tell a, whatever constant is added. |g|^(−2/a) is a quadratic form of the distance: its
rank is k, with one for each face that the top lies on. The volume where |g| > λ is ∝ λ^(−k/a): ∫g² is
infinite where a/k ≥ ½, and there is no integral where a/k ≥ 1. Where faces meet, a product of powers of
distances to some of them has a tail of the largest power towards one, or of the mean of all.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array

__all__ = ["COARSE", "Lines", "Pole", "grain", "lines_of", "mean_dimension", "pole_of"]

STEPS = 16  # of a line, before it is zoomed
HALVINGS = 12
_LATE = 6  # halvings that an exponent is fitted to
_POLE, _JUMP, _KINK = -0.15, 0.4, 1.6  # exponents below which there is one
_NEGLIGIBLE = 1e-9  # of the spread of g: rounding
_GRAINS = 32.0  # of the numbers that values are: rounding, too
_GOES_ON = 0.65  # of the last gain towards an end: what is bounded gains 2^-10 of it
_BESIDE = 0.005  # of the cube, away from a line
_ENDS = 2.0 ** -np.array([4.0, 12.0, 20.0, 30.0, 40.0])

# Poles
_CLIMBS = 16  # halvings of the step of a climb, at most
_SLACK = 6  # climbs of one length of step, but the first
_LOOK = 3  # halvings, by whose gain a climb is judged
_BOUNDED = 0.3  # of the gain before: the value is bounded
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

LINE = STEPS + 2 * HALVINGS + 2 * len(_ENDS) + 2
"""Evaluations of a line along an axis."""

CHORD = STEPS + 2 * HALVINGS
"""Evaluations of any other line."""

COARSE = 1e-2
"""Of a spread: a distance between numbers that matters."""

Function = Callable[[Array], Array]


@final
@dataclass(frozen=True)
class Lines:
    """What was seen on K lines.

    Attributes
    ----------
    axis
        Which axis each runs along, −1 for chords: (K,).
    exponent
        Of the step, in the second difference about the roughest place: (K,).
    place
        Where that is, (K,), from 0 to 1 along the line.
    height
        Change of g there: (K,).
    straight
        Whether the change of g stays at that place on a parallel line close by: (K,); true of chords.
    growth
        Exponents a of g ~ t^−a at both ends of lines along axes, 0 where it does not grow: (K, 2); NaN of
        chords.
    ends
        Difference of g between both ends: (K,); NaN of chords.
    waves, turns
        Of a cosine of the same spread as steep in its bend, how many there are along the line: (K,); and
        the share of places that are higher or lower than those beside: (K,).
    spread
        Variance along the line: (K,).
    """

    axis: Array
    exponent: Array
    place: Array
    height: Array
    straight: Array
    growth: Array
    ends: Array
    waves: Array
    turns: Array
    spread: Array

    def jumps(self, scale: float) -> Array:
        """Which lines meet a jump that matters beside this spread of g, and nothing worse."""
        between = (self.exponent >= _POLE) & (self.exponent < _JUMP)
        return np.asarray(between & (self.height > 1e-4 * scale))

    def poles(self) -> Array:
        """Which lines meet a pole."""
        return np.asarray(self.exponent < _POLE)

    def kinks(self) -> Array:
        """Which lines have nothing rougher than a kink, and have one."""
        return np.asarray((self.exponent >= _JUMP) & (self.exponent < _KINK))


def grain(values: Array) -> float:
    """Distance between numbers of the largest size among values: of float32 where all of them are such."""
    size = np.abs(values).max(initial=0.0)
    with np.errstate(over="ignore"):
        single = (values.astype(np.float32) == values).all()
    return float(np.spacing(np.float32(size) if single else size))


def lines_of(g: Function, dims: int, evaluations: int, rng: np.random.Generator) -> Lines:
    """Look at lines along axes in turn and, in several dims, as many chords.

    Parameters
    ----------
    g
        Points (k, d) to values (k,).
    dims
        d.
    evaluations
        At most.
    """
    pairs = evaluations // (LINE + (CHORD if dims > 1 else 0))
    if not pairs:
        none = np.empty(0)
        return Lines(
            none.astype(int), none, none, none, none, np.empty((0, 2)), none, none, none, none
        )
    order = np.concatenate([rng.permutation(dims) for _ in range(pairs // dims + 1)])[:pairs]
    axis = np.concatenate([order, np.full(pairs if dims > 1 else 0, -1)]).astype(int)
    start, way = rng.random((len(axis), dims)), np.zeros((len(axis), dims))
    for k, i in enumerate(axis):
        if i >= 0:
            start[k, i], way[k, i] = 0.0, 1.0
        else:  # through a point, in any direction, from face to face
            direction = rng.standard_normal(dims)
            with np.errstate(divide="ignore"):
                near, far = np.sort([-start[k] / direction, (1 - start[k]) / direction], axis=0)
            start[k], way[k] = (
                start[k] + near.max() * direction,
                (far.min() - near.max()) * direction,
            )

    def at(t: Array, which: Any = slice(None)) -> Array:
        """Values at places (K, m) along the lines, or some of them."""
        x = start[which, None] + t[..., None] * way[which, None]
        return g(np.clip(x, 0.0, BELOW_ONE).reshape(-1, dims)).reshape(t.shape)

    # Equal steps, of a size and at an offset of the line's own, so that none is in step with all waves
    part = rng.uniform(0.75, 1.0, (len(axis), 1))
    t = part * (np.arange(STEPS) + rng.uniform(0.2, 0.8, (len(axis), 1))) / STEPS
    t += rng.random((len(axis), 1)) * (1.0 - part)
    y = at(t)
    spread = y.var(axis=1)
    turns = (np.diff(np.sign(np.diff(y, axis=1)), axis=1) != 0).mean(axis=1)
    rows = np.arange(len(axis))

    # The ends of lines along the axes; what grows there grows all the way, and beyond what is usual
    usual, straight = np.abs(y).max(), axis >= 0
    growth, ends = np.full((len(axis), 2), np.nan), np.full(len(axis), np.nan)
    near = np.broadcast_to(_ENDS, (straight.sum(), len(_ENDS)))
    outer = np.stack([at(t, straight) for t in (near, 1.0 - near)])
    size = np.maximum(np.abs(outer), 1e-300)
    slope = np.log(size[..., -1] / size[..., -2]) / math.log(_ENDS[-2] / _ENDS[-1])
    gains = np.diff(size, axis=-1)
    grows = (gains > 0).all(axis=-1) & (size[..., -1] > usual)
    grows &= gains[..., -1] > _GOES_ON * gains[..., -2]
    growth[straight] = np.where(grows, slope, 0.0).T
    ends[straight] = outer[1, :, 1] - outer[0, :, 1]

    # Halve the steps about the largest second difference, places near an end that does not grow included; for
    # every other line of an axis where it stands out from those beside it, as at a kink of a function that is
    # steep elsewhere
    wide = np.full((2, len(axis)), np.nan)
    wide[:, straight] = np.where(grows, np.nan, outer[..., 1])
    t = np.column_stack([np.full(len(axis), _ENDS[1]), t, np.full(len(axis), 1.0 - _ENDS[1])])
    y = np.column_stack([wide[0], y, wide[1]])
    middle = 1 + np.argmax(np.nan_to_num(_bends(t, y), nan=-1.0), axis=1)
    middle[1::2] = 3 + np.argmax(np.abs(np.diff(y[1::2, 1:-1], 4, axis=1)), axis=1)
    window, values = (a[rows[:, None], middle[:, None] + (-1, 0, 1)] for a in (t, y))
    sizes = [_bends(window, values)[:, 0]]
    for _ in range(HALVINGS):
        between = 0.5 * (window[:, 1:] + window[:, :-1])
        new = at(between)
        five = np.stack([window[:, 0], between[:, 0], window[:, 1], between[:, 1], window[:, 2]], 1)
        y5 = np.stack([values[:, 0], new[:, 0], values[:, 1], new[:, 1], values[:, 2]], 1)
        second = _bends(five, y5)
        chosen = np.argmax(second, axis=1)
        sizes.append(second[rows, chosen])
        pick = chosen[:, None] + np.arange(3)
        window, values = five[rows[:, None], pick], y5[rows[:, None], pick]
    size = np.array(sizes)[-_LATE - 1 :]
    scale = max(float(np.sqrt(spread.mean())), 1e-300)
    rough = size[-1] > max(_NEGLIGIBLE * scale, _GRAINS * grain(y[:, 1:-1]))
    slope = -np.polyfit(np.arange(_LATE + 1), np.log2(np.maximum(size, 1e-300)), 1)[0]
    exponent = np.where(rough, slope, 2.0)
    # What is steep at an end, as bounded functions of normal quantiles, is neither a jump nor a kink
    edge = np.abs(window[:, 1] - 0.5) > 0.5 - 4.0 * _ENDS[1]
    exponent[edge & (exponent >= _POLE)] = 2.0

    # Beside lines along axes, inwards, where an edge that is not normal to the axis lies elsewhere
    height = np.abs(np.diff(values, axis=1)).max(axis=1)
    stays = np.ones(len(axis), bool)
    if dims > 1:
        steps = _BESIDE * rng.uniform(0.5, 1.0, (straight.sum(), dims))  # of which none cancel
        aside = start[straight] + np.where(start[straight] < 0.5, steps, -steps)
        pair = np.stack([aside, aside], axis=1)
        pair[np.arange(len(aside))[:, None], (0, 1), axis[straight, None]] = window[straight][
            :, ::2
        ]
        change = np.diff(g(pair.reshape(-1, dims)).reshape(-1, 2), axis=1)[:, 0]
        stays[straight] = np.abs(change) > 0.5 * height[straight]

    bend = 4.0 * _bends(window, values)[:, 0] / (window[:, 2] - window[:, 0]) ** 2
    varies = np.where(spread > 0.0, np.sqrt(2.0 * spread), np.inf)
    waves = np.sqrt(bend / varies) / (2.0 * math.pi)

    return Lines(
        axis=axis,
        exponent=exponent,
        place=window[:, 1],
        height=height,
        straight=stays,
        growth=growth,
        ends=ends,
        waves=waves,
        turns=turns,
        spread=spread,
    )


def _bends(t: Array, y: Array) -> Array:
    """Second differences of values at places (K, m), as if these were in equal steps: (K, m − 2)."""
    span = t[:, 2:] - t[:, :-2]
    return np.asarray(0.5 * span * np.abs(np.diff(np.diff(y) / np.diff(t))))


def mean_dimension(g: Function, points: Array, values: Array, rng: np.random.Generator) -> float:
    """Mean dimension Σ_i T_i/Var g: half the mean squared change where one coordinate is drawn again.

    Evaluates g at d places beside each of the points (k, d), at which it has these values (k,).
    """
    k, d = points.shape
    total = 0.0
    for i in range(d):
        moved = points.copy()
        moved[:, i] = rng.random(k)
        total += 0.5 * float(((g(moved) - values) ** 2).mean())
    variance = float(values.var(ddof=1))
    return total / variance if variance > 0.0 else math.nan


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
    while len(heights) < _CLIMBS:
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
            if not third - second > _BOUNDED * (second - first):
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
