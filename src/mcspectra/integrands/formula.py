"""Integrands that are written as a formula."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError, point_in_words
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.integrands._axes import settle
from mcspectra.integrands._expression import compiled
from mcspectra.integrands.base import Integrand, check_dims

__all__ = ["Formula"]

_PROBES = 4


@final
@dataclass(frozen=True, kw_only=True)
class Formula(Integrand):
    """A formula of the coordinates, read as data.

    Such as ``exp(-x**2 - y**2)``: numbers, the coordinates x, y, z (or x0, x1, …), pi, e, the
    operators + - * / ** %, comparisons, which are 1 where they hold and 0 elsewhere, and sin, cos,
    tan, arcsin, arccos, arctan, arctan2, sinh, cosh, tanh, exp, log, log2, log10, sqrt, hypot, abs,
    sign, sinc, floor, ceil, min, max and where. No other name is known, and nothing is run as Python.

    Parameters
    ----------
    expression
        The formula, 1000 characters and 300 parts at most.
    dims
        Number of dims.

    Raises
    ------
    ParameterError
        It is not a formula of this kind, names a coordinate beyond `dims`, or is not finite at all of four
        points inside the cube.

    Examples
    --------
    >>> f = Formula(expression="where(x < 0.25, 4 * x, y)", dims=2)
    >>> f([[0.125, 0.0], [0.5, 0.75]])
    array([0.5 , 0.75])
    """

    name: ClassVar[str] = "formula"
    expression: str
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        settle(self, dims=check_dims(self))
        given: object = self.expression
        if not isinstance(given, str) or not given.strip():
            raise ParameterError(
                f"The formula is {given!r}; give text such as 'exp(-x**2 - y**2)'."
            )
        steps = np.sqrt(np.arange(self.dims) + 2.5)  # an additive recurrence, on no symmetry
        self._evaluate(np.arange(1, _PROBES + 1)[:, None] * steps % 1.0)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Places where a coordinate is compared to a number."""
        return compiled(self.expression, self.dims).breaks

    def _evaluate(self, x: Array) -> Array:
        with np.errstate(all="ignore"):
            found = compiled(self.expression, self.dims).evaluate(x)
        values = np.array(np.broadcast_to(found, x.shape[:-1]), np.float64)
        finite = np.isfinite(values)
        if not finite.all():
            where = point_in_words(x[~finite][0])
            raise ParameterError(
                f"{self.spec} is NaN or infinite, for example {where}; it must be finite "
                "wherever it is evaluated."
            )
        return values
