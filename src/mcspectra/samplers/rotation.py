"""Random rotations: the symmetries of the torus, or any angle through a window."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.core.jit import kernel
from mcspectra.core.streams import Stream, mix_bits, mix_uniform
from mcspectra.samplers.base import Randomization, Sampler, Structure

__all__ = ["RandomRotation"]

_BELOW_ONE = 1.0 - 2.0**-53
_TURNED: dict[Structure, Structure] = {s: s for s in Structure} | {
    Structure.DIGITS: Structure.TORUS
}
"""Digits stay too, but coordinates of different bases change places."""

_CLIPPED: dict[Structure, Structure] = _TURNED | {Structure.STRATA: Structure.TORUS}

_FIRST_REACH = 0.6  # half-side of a window that nearly always holds n + 1 points: area 1.44
_REACH = 1.12  # one that always does: a disk of radius √5/2 holds two domains side by side


@final
@dataclass(frozen=True, kw_only=True)
class RandomRotation(Randomization):
    """Random rotation: by right angles with reflections, or by any angle through a window (2-D).

    Attributes
    ----------
    boundary
        ``"toroidal"``: one of the d!·2^d symmetries of the cube, which are all that the torus has:
        axes permuted and reflected at random. Distances on the torus, strata of equal sides and
        elementary intervals (their shapes turned along) are kept.
        ``"clipped"`` (2-D): the periodically repeated points, rotated by a uniform angle, seen
        through a square window at a random place that is just so large that one more than n points
        would touch it, scaled to the unit square and translated at random on the torus.

    Notes
    -----
    A unit square that is rotated by any other angle and wrapped around covers a part of the torus
    twice and leaves another empty: hence the window. Distances are kept inside the window up to its
    scale, 1 + O(n^-1/2) for random points, but not across its seam, which the translation takes to
    a random place; for it every point is exactly uniform. Reflections are u → 1 − 2^-53 − u, which
    stays in [0,1).
    """

    name: ClassVar[str] = "random-rotation"
    fits: ClassVar[Mapping[Structure, Structure]] = _TURNED
    boundary: str = "toroidal"

    def __post_init__(self) -> None:
        as_choice("boundary", self.boundary, ("toroidal", "clipped"))
        if self.boundary == "clipped":
            object.__setattr__(self, "fits", _CLIPPED)
            object.__setattr__(self, "debiases", True)
            object.__setattr__(self, "stationary", True)
        object.__setattr__(self, "pointwise", self.boundary == "toroidal")

    def fit(self, sampler: Sampler) -> Randomization:
        """Refuse rotations by any angle unless `sampler` has 2 dims."""
        if self.boundary == "clipped" and sampler.dims != 2:
            raise ParameterError(
                f"random-rotation(boundary='clipped') needs 2 dims, but {sampler.spec} has "
                f"{sampler.dims}; use boundary='toroidal'."
            )
        return Randomization.fit(self, sampler)

    def left(self, sampler: Sampler) -> Structure:
        """Elementary intervals stay where all coordinates have digits in one base."""
        same = self.boundary == "toroidal" and len(set(sampler.digit_bases)) == 1
        if sampler.structure is Structure.DIGITS and same:
            return Structure.DIGITS
        return Randomization.left(self, sampler)

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Rotate each realisation by its own symmetry or angle."""
        out = np.empty(points.shape)
        keys = stream.keys(first, len(points))
        if self.boundary == "toroidal":
            _turn(keys, points, out)
        else:
            _clip_all(keys, points, out)
        return out


@kernel
def _turn(keys: Array, points: Array, out: Array) -> None:
    # A random symmetry of the cube: coordinate j from axis order[j], reflected if its bit is set
    count, n, dims = points.shape
    order, flip = np.arange(dims), np.zeros(dims, np.bool_)
    for r in range(count):
        for j in range(dims):
            order[j] = j
        for j in range(dims):
            bits = mix_bits(keys[r, 0], keys[r, 1], j)
            flip[j] = bits & np.uint64(1)
            chosen = np.int64((bits >> np.uint64(1)) % np.uint64(j + 1))
            order[j], order[chosen] = order[chosen], order[j]
        for i in range(n):
            for j in range(dims):
                x = points[r, i, order[j]]
                out[r, i, j] = _BELOW_ONE - x if flip[j] else x


@kernel
def _seen(points: Array, center: Array, turn: Array, reach: float, found: Array) -> int:
    # Turned copies within max(|x|, |y|) ≤ reach of the centre into found (25n, 3): x, y, that norm
    size = 0
    for i in range(points.shape[0]):
        x0, y0 = points[i, 0] - center[0], points[i, 1] - center[1]
        x0, y0 = x0 - np.floor(x0 + 0.5), y0 - np.floor(y0 + 0.5)
        for copy in range(25):
            x, y = x0 + copy // 5 - 2, y0 + copy % 5 - 2
            u, v = turn[0] * x - turn[1] * y, turn[1] * x + turn[0] * y
            norm = max(abs(u), abs(v))
            if norm <= reach:
                found[size, 0], found[size, 1], found[size, 2] = u, v, norm
                size += 1
    return size


@kernel
def _clip_all(keys: Array, points: Array, out: Array) -> None:
    # Points within the window whose edge the (n + 1)-th nearest to its centre lies on; out (R, n, 2)
    count, n, _ = points.shape
    found = np.empty((25 * n, 3))
    numbers = np.empty(5)
    for r in range(count):
        for k in range(5):
            numbers[k] = mix_uniform(keys[r, 0], keys[r, 1], k)
        angle = 2.0 * math.pi * numbers[2]
        turn = np.array([math.cos(angle), math.sin(angle)])
        size = _seen(points[r], numbers[:2], turn, _FIRST_REACH, found)
        if size <= n:
            size = _seen(points[r], numbers[:2], turn, _REACH, found)
        edge = np.partition(found[:size, 2].copy(), n)[n]
        inside = np.count_nonzero(found[:size, 2] < edge)
        taken, ties = 0, n - inside  # of several points on the edge the first ones count
        for i in range(size):
            on_edge = found[i, 2] == edge
            if found[i, 2] > edge or (on_edge and ties == 0):
                continue
            ties -= on_edge
            for j in range(2):
                x = found[i, j] / (2.0 * edge) + 0.5 + numbers[3 + j]
                out[r, taken, j] = min(x - np.floor(x), _BELOW_ONE)
            taken += 1
