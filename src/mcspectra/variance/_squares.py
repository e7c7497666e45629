"""∫g² of primary-space integrands with an estimate of its error, infinite where it diverges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.densities.adaptive import positive_integral
from mcspectra.integrands import Integrand
from mcspectra.integrands.base import integral_accuracy, numeric_integral

__all__ = ["SquaredIntegrand", "mean_square", "square_integral"]

_FEW_CELLS = 2**13  # of a level: enough for curves of jumps, and an eighth of the time
_SUSPECT = 0.01  # relative error, beyond which there may be a pole, and all levels are worth it


@final
@dataclass(frozen=True)
class SquaredIntegrand(Integrand):
    """g², cut where g is."""

    name: ClassVar[str] = "squared"
    integrand: Integrand

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims of g."""
        return self.integrand.dims

    @property
    def channels(self) -> int:  # type: ignore[override]
        """Channels of g."""
        return self.integrand.channels

    @property
    def spec(self) -> str:
        """Text for messages."""
        return f"square of {self.integrand.spec}"

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Those of g."""
        return self.integrand.breaks

    def _evaluate(self, x: Array) -> Array:
        with np.errstate(over="ignore"):  # next to a pole
            return np.asarray(self.integrand(x) ** 2)


def mean_square(g: Integrand) -> Array:
    """∫g², (channels or 1,); infinite where it diverges."""
    return square_integral(g)[0]


def square_integral(g: Integrand) -> tuple[Array, Array]:
    """∫g² and an estimate of its absolute error, both (channels or 1,).

    Notes
    -----
    Boxes cut at the breaks of g; in 1-D and 2-D also quadrature that records how much each level
    leaves unresolved (`mcspectra.densities.adaptive`): the integral is infinite where that does not
    shrink, else the smaller error counts. Boxes alone do not see a divergence: rounding of T(u)
    stops it somewhere. In more dims it shows as a large error at best.
    """
    found = g.box_moments(np.zeros((1, g.dims)), np.ones((1, g.dims)))
    if found is not None:
        exact = np.asarray(found[1], float).reshape(-1)
        return exact, np.zeros(exact.shape)
    squared = SquaredIntegrand(g)
    if g.dims > 2:
        return _by_boxes(squared)
    levels = [_by_levels(_channel(squared, c), g.dims) for c in range(max(1, g.channels))]
    by_levels, level_errors = np.array(levels).T
    if np.isinf(by_levels).all():
        return by_levels, level_errors
    value, error = _by_boxes(squared)
    better = (level_errors < error) | np.isinf(by_levels)
    return np.where(better, by_levels, value), np.where(better, level_errors, error)


def _by_boxes(squared: Integrand) -> tuple[Array, Array]:
    value = np.atleast_1d(np.asarray(numeric_integral(squared), float))
    return value, np.full(value.shape, integral_accuracy(squared)[1])


def _by_levels(function: Callable[[Array], Array], dims: int) -> tuple[float, float]:
    value, error = positive_integral(function, dims, most_cells=_FEW_CELLS)
    return (value, error) if error <= _SUSPECT * value else positive_integral(function, dims)


def _channel(f: Integrand, channel: int) -> Callable[[Array], Array]:
    """One channel of values: points (..., d) to (...)."""
    return lambda x: np.asarray(f(x).reshape(*x.shape[:-1], -1)[..., channel])
