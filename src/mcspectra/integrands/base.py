"""The interface of integrands, on one screen: values, integral, Fourier coefficients.

Conventions: f_m = ∫ f(x) exp(−2πi m·x) dx over [0,1)^d, integer m. Implementations write
`_evaluate`, and `_integral` and `_fourier` where they are known exactly; otherwise composite
Gauss-Legendre quadrature (with an FFT for the coefficients) stands in and `integral_source` and
`fourier_source` say so.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from mcspectra.core.checks import MAX_DIMS, Array, as_frequencies, as_integer, as_real_array
from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.core.spec import Component

if TYPE_CHECKING:
    from mcspectra.integrands._quadrature import Estimate

__all__ = ["Integrand", "check_dims"]


class Integrand(Component, ABC):
    """A real function on [0,1]^d, with one or more channels.

    Attributes
    ----------
    dims
        Number of dimensions d.
    channels
        0 for a scalar function, else the number of channels (last axis of values).
    """

    dims: int
    channels: int = 0
    max_dims: ClassVar[int | None] = None

    def __call__(self, x: object) -> Array:
        """Values at points x of shape (..., d): float64 (...) or (..., channels).

        Raises
        ------
        DomainError
            x has another number of dims, or is not finite.
        ParameterError
            The function gave something else than real numbers of that shape.
        """
        points = as_real_array("x", x)
        if points.ndim == 0 or points.shape[-1] != self.dims:
            raise DomainError(
                f"{self.spec} takes points of shape (..., {self.dims}), not {points.shape}."
            )
        if points.size and not (points.min() >= 0.0 and points.max() <= 1.0):
            raise DomainError(
                f"{self.spec} was given points that are not finite or outside [0,1]; its domain "
                "is the unit cube."
            )
        return self._evaluate(points)

    @property
    def integral(self) -> Any:
        """∫ f over [0,1]^d: a float, or an array (channels,). Exact or not: `integral_source`."""
        exact = self._integral()
        if exact is not None:
            return exact
        from mcspectra.integrands.numeric import numeric_integral

        return numeric_integral(self)

    @property
    def integral_source(self) -> str:
        """``"exact"`` or how `integral` was computed; `integral_accuracy` says how well."""
        return "exact" if self._integral() is not None else "quadrature"

    def fourier(self, m: object) -> Array:
        """Fourier coefficients f_m at integer frequencies m of shape (..., d).

        Returns
        -------
        ndarray
            complex128, shape (...) or (..., channels). Exact or not: `fourier_source`.

        Raises
        ------
        ParameterError
            m is not integer, or needs a larger FFT grid than memory allows.
        """
        frequencies = as_frequencies(m, self.dims)
        if not np.array_equal(frequencies, np.rint(frequencies)):
            raise ParameterError("Fourier coefficients exist at integer frequencies m only.")
        exact = self._fourier(frequencies)
        if exact is not None:
            return exact
        from mcspectra.integrands.numeric import fourier_at

        return fourier_at(self, frequencies)

    def fourier_grid(self, half_width: int) -> Array:
        """Coefficients at all m in {−half_width … half_width}^d.

        Returns
        -------
        ndarray
            complex128 of shape (2 half_width + 1,) * d, or with (channels,) after that.
        """
        width = as_integer("half_width", half_width, least=0)
        from mcspectra.integrands.numeric import fourier_grid

        return fourier_grid(self, width)

    @property
    def fourier_source(self) -> str:
        """``"exact"`` or how `fourier` is computed."""
        probe = self._fourier(np.zeros((1, self.dims)))
        return "exact" if probe is not None else "FFT of composite Gauss-Legendre quadrature"

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """For each axis, where f is discontinuous or not smooth across a whole axis-normal plane."""
        return ((),) * self.dims

    def landmarks(self) -> Array:
        """Points (k, d) at which f may differ from 0 on a small region, for probing; often none."""
        return np.empty((0, self.dims))

    @property
    def evaluations_per_point(self) -> int:
        """Evaluations of the function underneath for one value; more than 1 where values are means."""
        return 1

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array] | None:  # noqa: ARG002
        """Means of f and of f² over axis-aligned boxes, where they are known in closed form.

        Parameters
        ----------
        lo, hi
            Corners of the boxes: float64 (..., d) in [0,1], lo < hi.

        Returns
        -------
        tuple of ndarray, or None
            Mean of f and mean of f², each (...) or (..., channels); None where they are not known.
            The variance within a stratum is their difference, mean f² − (mean f)².
        """
        return None

    @abstractmethod
    def _evaluate(self, x: Array) -> Array:
        """Values at float64 points (..., d)."""

    def _integral(self) -> Any:
        """The exact integral, or None where it is not known."""
        return None

    def _estimated_integral(self) -> Estimate | None:
        """The integral by a rule of the integrand's own, or None for quadrature."""
        return None

    def _fourier(self, m: Array) -> Array | None:  # noqa: ARG002
        """Exact coefficients at integer m (float64, shape (..., d)), or None where not known."""
        return None

    @staticmethod
    def from_function(
        function: Callable[[Any], Any],
        *,
        dims: int,
        integral: Any = None,
        fourier: Callable[[Any], Any] | None = None,
    ) -> Integrand:
        """Make an integrand of a vectorised callable: points (..., d) to (...) or (..., channels).

        Parameters
        ----------
        function
            The function; it is called with float64 arrays of points.
        dims
            Number of dimensions.
        integral
            Its exact integral, if known (otherwise a quadrature).
        fourier
            Its exact coefficients as a callable of integer m (..., d), if known.

        Raises
        ------
        ParameterError
            The function is not callable, or a try on a few points gives another shape, complex
            numbers, NaN or infinity.
        """
        from mcspectra.integrands.functions import FunctionIntegrand

        return FunctionIntegrand.from_function(
            function, dims=dims, integral=integral, fourier=fourier
        )


def check_dims(integrand: Integrand) -> int:
    """Return an integrand's `dims` as an int, at most its class's `max_dims`; for `__post_init__`."""
    try:
        return as_integer("dims", integrand.dims, least=1, most=integrand.max_dims or MAX_DIMS)
    except ParameterError as error:
        raise ParameterError(f"{integrand.name}: {error}") from None
