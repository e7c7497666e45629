"""Sliced optimal transport: points whose projections on all lines are as even as possible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.fields import whole
from mcspectra.samplers.hyperuniform import fill_normals
from mcspectra.samplers.optimised import OptimisedSampler, random_points

__all__ = ["SlicedOptimalTransport", "projected_quantiles"]

_TABLE = 2049  # number of points at which a projected cube's distribution is tabulated
_NARROW = 1e-3  # smaller components of a direction are ignored; quantiles move by at most 1e-7


@final
@dataclass(frozen=True, kw_only=True)
class SlicedOptimalTransport(OptimisedSampler):
    """Points in the cube moved to even out their projections on random directions; 2 and more dims.

    Attributes
    ----------
    iterations
        Number of iterations. In each iteration, every point moves once.
        A point moves by the mean of its displacements along all random directions.
    directions
        Number of random directions per iteration.
    sets
        Largest number of different sets, see `OptimisedSampler`.

    Notes
    -----
    For every direction θ, the points are sorted by θ·x.
    The k-th of the sorted points then moves in the direction θ:
    θ·x moves toward the quantile (k − ½)/n of the cube projected on θ.
    The paper instead projects a ball, and maps the points from the ball to the cube.
    The projection of the cube is the distribution of a sum of d uniform numbers of widths |θ_j|.
    Points near the faces and corners of the cube are not quite uniform, so means are not exact.
    Means are exact after a random shift. They are also exact if `sets` is a number,
    because the reused sets are translated at random.

    References
    ----------
    [Paulin2020]_
    """

    min_dims: ClassVar[int] = 2
    other_dims: ClassVar[str] = "in 1-D use jittered"
    dims: int = 2
    iterations: int = whole(150, least=1, most=10**6)
    directions: int = whole(32, least=1, most=10**6)

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether every point is uniform, which a random translation of reused sets ensures."""
        return self.sets is not None

    def _optimize(self, n: int, keys: Array, report: Callable[[float], None]) -> Array:
        points, used = random_points(keys, n, self.dims), n * self.dims
        normals = np.empty((1, self.directions * self.dims))
        for i in range(self.iterations):
            fill_normals(keys[None], used, normals)
            used += normals.size + 1  # an odd number of normals takes one more random number
            directions = normals.reshape(self.directions, self.dims)
            directions = directions / np.sqrt(np.sum(directions**2, axis=1))[:, None]

            # For each direction, find the vector that moves each point to its quantile.
            # Then move each point by the mean of these vectors over all directions
            move = np.zeros(points.shape)
            for direction in directions:
                # np.sum gives the same bits on every machine, unlike a product of BLAS
                place = np.sum((points - 0.5) * direction, axis=1)
                order, delta = np.argsort(place, kind="stable"), np.empty(n)
                delta[order] = projected_quantiles(direction, n) - place[order]
                move += delta[:, None] * direction
            points = np.clip(points + move / len(directions), 0.0, BELOW_ONE)
            if i % max(1, self.iterations // 20) == 0:
                report(i / self.iterations)
        return points


def projected_quantiles(direction: Array, n: int) -> Array:
    """Return the quantiles (k − ½)/n, k = 1 … n, of θ·(x − ½) for x uniform in the cube.

    θ·(x − ½) is a sum of independent uniform numbers, one of width |θ_j| for each component θ_j.
    First, the distribution function of the component with the largest width is computed.
    Each smaller component is added by averaging this function over the width of the component.
    """
    widths = np.sort(np.abs(direction))[::-1]
    end = widths.sum() / 2
    t = np.linspace(-end, end, _TABLE)
    below = np.clip(t / widths[0] + 0.5, 0.0, 1.0)
    for width in widths[1:]:
        if width > _NARROW:
            # Average the distribution function over t ± width/2.
            # For arguments above the tabulated range, the distribution function equals 1
            strips = np.cumsum((below[1:] + below[:-1]) * ((t[1] - t[0]) / 2))
            primitive = np.concatenate([[0.0], strips])
            upper, lower = t + width / 2, t - width / 2
            added = np.interp(upper, t, primitive) + np.maximum(upper - t[-1], 0.0)
            below = (added - np.interp(lower, t, primitive)) / width
    quantiles: Array = np.interp((np.arange(n) + 0.5) / n, below, t)
    return quantiles
