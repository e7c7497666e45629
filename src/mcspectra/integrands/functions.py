"""Integrands made of Python callables, probed before they are believed."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError, point_in_words
from mcspectra.integrands.base import Integrand

__all__ = ["FunctionIntegrand"]

_PROBE = (4, 7)  # two axes, so that functions of one list of points are found out


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class FunctionIntegrand(Integrand):
    """A vectorised callable; make it with `Integrand.from_function`, which probes it.

    The callable must always give the same values: integrals and coefficients are remembered.
    """

    name: ClassVar[str] = "function"
    function: Callable[[Any], Any]
    dims: int
    channels: int = 0
    known_integral: Any = None
    known_fourier: Callable[[Any], Any] | None = None

    @staticmethod
    def from_function(
        function: Callable[[Any], Any],
        *,
        dims: int,
        integral: Any = None,
        fourier: Callable[[Any], Any] | None = None,
    ) -> FunctionIntegrand:
        """Probe a callable and wrap it; see `Integrand.from_function`."""
        if not callable(function):
            raise ParameterError(
                f"The function is {function!r}, not a callable; give f(points) -> values."
            )
        dims = as_integer("dims", dims, least=1)
        channels = _probe(function, dims)
        if fourier is not None:
            _probe_fourier(fourier, dims, channels)
        return FunctionIntegrand(
            function=function,
            dims=dims,
            channels=channels,
            known_integral=None if integral is None else _check_integral(integral, channels),
            known_fourier=fourier,
        )

    @property
    def spec(self) -> str:
        """``function(name)``: text for messages, not a spec to read again."""
        return f"function({getattr(self.function, '__name__', type(self.function).__name__)})"

    def _evaluate(self, x: Array) -> Array:
        shape = (*x.shape[:-1], self.channels) if self.channels else x.shape[:-1]
        values = _real(_called(self.function, x))
        if values.shape != shape:
            raise ParameterError(
                f"{self.spec} gave values of shape {values.shape} at points of shape {x.shape}; "
                f"it must give {shape}."
            )
        return _finite(values, x, self.spec)

    def _integral(self) -> Any:
        return self.known_integral

    def _fourier(self, m: Array) -> Array | None:
        if self.known_fourier is None:
            return None
        return _coefficients(self.known_fourier, m, self.channels)


def _probe(function: Callable[[Any], Any], dims: int) -> int:
    """Return the number of channels, 0 for a scalar function, after a try on 28 points."""
    x = _probe_points(dims)
    try:
        given = _called(function, x)
    except ParameterError:
        raise
    except (TypeError, ValueError, IndexError) as error:
        if _works_on_one_point(function, x[0, 0]):
            raise ParameterError(
                "The function takes one point at a time; write it for arrays of shape "
                "(..., d), with x[..., 0] for the first coordinate and numpy's functions."
            ) from error
        raise
    values = _real(given)
    if values.shape[:2] != _PROBE or values.ndim > 3 or 0 in values.shape:
        raise ParameterError(
            f"The function gave shape {values.shape} at points of shape {x.shape}; it must give "
            f"{_PROBE}, or {(*_PROBE, 'channels')}, one value for each point "
            "(use x[..., 0] for the first coordinate)."
        )
    _finite(values, x, "The function")
    return values.shape[2] if values.ndim == 3 else 0


def _probe_points(dims: int) -> Array:
    """Points of an additive recurrence, on no grid line."""
    steps = np.sqrt(np.arange(2, 2 + dims) + 0.5)
    return np.asarray((0.5 + np.arange(1, 29)[:, None] * steps) % 1.0).reshape(*_PROBE, dims)


def _works_on_one_point(function: Callable[[Any], Any], point: Array) -> bool:
    """Whether a function that failed on arrays takes a point, or a number in 1-D."""
    for x in (point, float(point[0])):
        with contextlib.suppress(Exception):  # the first failure is the one to report
            if np.ndim(function(x)) <= 1:
                return True
    return False


def _called(function: Callable[[Any], Any], x: Array) -> Any:
    """Call `function` with a read-only view: the same points are weighted afterwards."""
    view = x.view()
    view.flags.writeable = False
    try:
        return function(view)
    except ValueError as error:
        if "read-only" not in str(error):
            raise
        raise ParameterError(
            "The function changes its argument in place; work on a copy, x = x.copy()."
        ) from error


def _real(given: object) -> Array:
    if np.ma.is_masked(given):
        raise ParameterError("The function gave masked values; it must give a plain array.")
    try:
        values = np.asarray(given)
    except ValueError:
        raise ParameterError("The function gave a ragged list; it must give an array.") from None
    if values.dtype.kind not in "biuf":
        what = "complex numbers" if values.dtype.kind == "c" else f"values of type {values.dtype}"
        raise ParameterError(f"The function gave {what}; it must give real numbers.")
    return values.astype(np.float64, copy=False)


def _finite(values: Array, x: Array, who: str) -> Array:
    finite = np.isfinite(values)
    if finite.all():
        return values
    bad = ~finite if values.ndim < x.ndim else ~finite.all(axis=-1)
    where = point_in_words(x[bad][0])
    raise ParameterError(
        f"{who} is NaN or infinite at {np.count_nonzero(bad)} of {bad.size} points, the first "
        f"{where}; it must be finite."
    )


def _check_integral(integral: object, channels: int) -> Any:
    shape = (channels,) if channels else ()
    try:
        value = np.asarray(integral, dtype=np.float64)
    except (TypeError, ValueError):
        raise ParameterError(f"integral is {integral!r}; give a real number.") from None
    if value.shape != shape or not np.isfinite(value).all():
        wanted = f"{channels} finite numbers, one a channel" if channels else "one finite number"
        raise ParameterError(f"integral is {integral!r}; give {wanted}.")
    return value if channels else float(value)


def _probe_fourier(fourier: Callable[[Any], Any], dims: int, channels: int) -> None:
    if not callable(fourier):
        raise ParameterError(f"fourier is {fourier!r}, not a callable; give m -> coefficients.")
    _coefficients(fourier, np.zeros((2, 3, dims)), channels)


def _coefficients(fourier: Callable[[Any], Any], m: Array, channels: int) -> Array:
    """Coefficients of a user's callable, complex128, checked in shape and finite."""
    shape = (*m.shape[:-1], channels) if channels else m.shape[:-1]
    found = np.asarray(fourier(m))
    if found.shape != shape or found.dtype.kind not in "biufc":
        raise ParameterError(
            f"fourier gave shape {found.shape} and type {found.dtype} at frequencies of shape "
            f"{m.shape}; it must give numbers of shape {shape}."
        )
    if not np.isfinite(found).all():
        raise ParameterError("fourier gave NaN or infinity; it must give finite numbers.")
    return found.astype(np.complex128, copy=False)
