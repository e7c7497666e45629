"""Sliced optimal transport: points whose projections on all lines are as even as they can be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.samplers.base import check_dims
from mcspectra.samplers.hyperuniform import fill_normals
from mcspectra.samplers.optimised import OptimisedSampler, check_sets, random_points

__all__ = ["SlicedOptimalTransport", "projected_quantiles"]

_BELOW_ONE = 1.0 - 2.0**-53
_TABLE = 2049  # places where the distribution of a projected cube is tabulated
_NARROW = 1e-3  # a component of a direction that changes no quantile by more than 1e-7


@final
@dataclass(frozen=True, kw_only=True)
class SlicedOptimalTransport(OptimisedSampler):
    """Points in the cube moved to even out their projections on random directions; 2 and more dims.

    Attributes
    ----------
    iterations
        Moves of all points, each by the mean over its directions.
    directions
        Random directions in each iteration.
    sets
        Reuse of sets, see `OptimisedSampler`.

    Notes
    -----
    On every direction θ the k-th point in the order of θ·x is drawn to the quantile (k − ½)/n of
    the projected cube. The paper does so in the ball and maps that to the cube; here the target is
    the cube itself, the sum of d uniform numbers of widths |θ_j|. The cube has sides and corners:
    points near them are not quite uniform by themselves, so that means are not exact. A `shift`
    makes them so, and so do given `sets`, which are translated.

    References
    ----------
    Paulin, Bonneel, Coeurjolly, Iehl, Webanck, Desbrun, Ostromoukhov (2020), "Sliced optimal
    transport sampling", doi 10.1145/3386569.3392395.
    """

    name: ClassVar[str] = "sliced-optimal-transport"
    dims: int = 2
    iterations: int = 150
    directions: int = 32

    def __post_init__(self) -> None:
        check_dims(self)
        check_sets(self)
        if self.dims < 2:
            raise ParameterError(
                f"{self.name}: dims is {self.dims}; it must be at least 2, in 1-D use jittered."
            )
        for field in ("iterations", "directions"):
            value = as_integer(field, getattr(self, field), least=1, most=10**6)
            object.__setattr__(self, field, value)

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether every point is uniform: only where sets are translated."""
        return self.sets is not None

    def _optimize(self, n: int, keys: Array, report: Callable[[float], None]) -> Array:
        points, used = random_points(keys, n, self.dims), n * self.dims
        normals = np.empty((1, self.directions * self.dims))
        for i in range(self.iterations):
            fill_normals(keys[None], used, normals)
            used += normals.size + 1  # an odd number of normals uses one uniform more
            directions = normals.reshape(self.directions, self.dims)
            directions = directions / np.sqrt(np.sum(directions**2, axis=1))[:, None]
            points = np.clip(points + _mean_move(points, directions), 0.0, _BELOW_ONE)
            if i % max(1, self.iterations // 20) == 0:
                report(i / self.iterations)
        return points


def projected_quantiles(direction: Array, n: int) -> Array:
    """Return the quantiles (k − ½)/n, k = 1 … n, of θ·(x − ½), x uniform in the cube.

    The distribution starts as that of the widest component; each further one is the mean of it
    over an interval of that component's width.
    """
    widths = np.sort(np.abs(direction))[::-1]
    end = widths.sum() / 2
    t = np.linspace(-end, end, _TABLE)
    below = np.clip(t / widths[0] + 0.5, 0.0, 1.0)
    for width in widths[1:]:
        if width > _NARROW:
            below = _mean_over(t, below, width)
    quantiles: Array = np.interp((np.arange(n) + 0.5) / n, below, t)
    return quantiles


def _mean_over(t: Array, below: Array, width: float) -> Array:
    """Return the mean of a distribution function, tabulated at t, over intervals around each t."""
    step = t[1] - t[0]
    primitive = np.concatenate([[0.0], np.cumsum((below[1:] + below[:-1]) * (step / 2))])
    upper, lower = t + width / 2, t - width / 2
    beyond = np.maximum(upper - t[-1], 0.0)  # where the function is 1
    mean: Array = (np.interp(upper, t, primitive) + beyond - np.interp(lower, t, primitive)) / width
    return mean


def _mean_move(points: Array, directions: Array) -> Array:
    """Return the mean over directions of the moves to the quantiles along each."""
    n, move = len(points), np.zeros(points.shape)
    for direction in directions:
        place = np.sum((points - 0.5) * direction, axis=1)  # no library: bits are the same always
        order = np.argsort(place, kind="stable")
        delta = np.empty(n)
        delta[order] = projected_quantiles(direction, n) - place[order]
        move += delta[:, None] * direction
    return move / len(directions)
