"""The interface of integrands (values, integral, coefficients), and integrands of callables.

The coefficients are f_m = ∫ f(x) exp(−2πi m·x) dx over [0,1)^d, for integer m.
Classes define the method `_evaluate`, and `_integral` or `_fourier` if exact values are known.
Otherwise composite Gauss-Legendre quadrature is used. For the coefficients it uses an FFT.
The attributes `integral_source` and `fourier_source` report the method.
Each integrand stores results of quadrature in its `IntegrandCache`.
Therefore an integrand must always give the same values.
"""

from __future__ import annotations

import contextlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import (
    MAX_DIMS,
    Array,
    as_frequencies,
    as_integer,
    as_real_array,
    as_reals,
    in_unit_cube,
)
from mcspectra.core.display import counted
from mcspectra.core.errors import (
    DomainError,
    McspectraError,
    Parameter,
    ParameterError,
    point_in_words,
    reason_of,
)
from mcspectra.core.fields import checked
from mcspectra.core.images import REC709
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.spec import Component
from mcspectra.core.tally import spend
from mcspectra.integrands._quadrature import (
    Estimate,
    adaptive_integral,
    lattice_integral,
    refined_coefficients,
    search_breaks,
)

__all__ = [
    "Breaks",
    "Channel",
    "Derived",
    "Estimate",
    "FunctionIntegrand",
    "Integrand",
    "IntegrandCache",
    "NamedFunction",
    "any_dims",
    "axis_number",
    "found_breaks",
    "fourier_accuracy",
    "fourier_grid",
    "integral_accuracy",
    "integral_estimate",
    "numeric_integral",
    "per_axis",
]

Breaks = tuple[tuple[float, ...], ...]
"""Positions of breaks along each axis."""

_MOST_COEFFICIENTS = 2**26  # Largest number of coefficients: 1 GiB of complex numbers
_EXACT_BLOCK = 2**20
_KEPT = 4
_ADAPTIVE_DIMS = 5
_PROBE = (4, 7)  # points with two leading axes detect functions that accept only lists of points


def any_dims() -> Any:
    """Declare the field `dims` of an integrand that takes any number of dims."""

    def check(name: str, given: object, integrand: str) -> int:
        try:
            return as_integer(name, given, least=1, most=MAX_DIMS)
        except ParameterError as error:
            raise ParameterError(f"{integrand}: {error}") from None

    return checked(check, DEFAULT_DIMS, using="name")


def axis_number() -> Any:
    """Declare a field that holds the number of an axis."""
    return checked(
        lambda name, given, dims: as_integer(name, given, least=0, most=dims - 1), 0, using="dims"
    )


def per_axis(default: float | None, **limits: float) -> Any:
    """Declare a field of one finite number, or one per axis. A single number is not repeated."""

    def check(name: str, given: object, dims: int) -> float | tuple[float, ...]:
        found = as_reals(name, given, dims, **limits)
        return found if isinstance(given, Sequence | np.ndarray) else found[0]

    return checked(check, default, using="dims")


@final
@dataclass(slots=True, eq=False, repr=False)
class IntegrandCache:
    """Results about one integrand. Each is computed when it is first used, and is None before.

    Attributes
    ----------
    integral
        ∫ f by quadrature, or by the integrand's own rule (`numeric_integral`).
    coefficients
        Fourier coefficients, by the frequencies along all axes. Only the last four sets are stored.
    breaks
        Positions along each axis where f jumps, whether declared or detected (`found_breaks`).
    probed
        Values at the points of `mcspectra.integrands._quadrature.probe`.
        The search for jumps stores these values at the probe points.
        The computation of ∫ f uses the stored values and then deletes them.
    cut
        The integrand with all found jumps declared. If f declares all of them, this is f.
        See `mcspectra.estimators.quadrature.looked_at`.
    moments
        A number a close to ∫ f, then ∫ (f − a) and ∫ (f − a)², and the errors of both integrals
        (`mcspectra.estimators.quadrature.moments`).
    unseen_square
        Error of ∫ (f − a)² from regions with points of `probe` but without quadrature nodes
        (`mcspectra.estimators.quadrature.unseen`).
    square
        ∫ f² and its absolute error (`mcspectra.estimators.quadrature.square_integral`).
    growth
        Largest exponents of growth toward planes normal to an axis, and whether f is unbounded
        (`mcspectra.estimators.quadrature.growth`).
    largest
        Largest values at the points of the probe, in descending order
        (`mcspectra.estimators.quadrature.beyond_points`).
    separable
        f as sums or products of functions of single axes, for each channel.
        If f is no sum or product, the tuple is empty (`mcspectra.prediction.separable.separated`).
    """

    integral: Estimate | None = None
    coefficients: dict[tuple[bytes, ...], Estimate] = field(default_factory=dict)
    breaks: tuple[Array, ...] | None = None
    probed: Array | None = None
    cut: Integrand | None = None
    moments: tuple[Array, Array, Array, Array] | None = None
    unseen_square: Array | None = None
    square: tuple[Array, Array] | None = None
    growth: tuple[Array, bool] | None = None
    largest: Array | None = None
    separable: tuple[Any, ...] | None = None


class Integrand(Component, ABC):
    """A real function on [0,1]^d, with one or more channels.

    Attributes
    ----------
    dims
        Number of dimensions d.
    channels
        Number of channels, which is the length of the last axis of values. It is 0 for a scalar f.
    stock_samplers
        Samplers of the renderer that evaluates f, as specs. The tuple is empty for other functions.
    """

    stock_samplers: ClassVar[tuple[str, ...]] = ()
    costly: ClassVar[bool] = False
    """Whether evaluations are slow. Predictions then use no method with many evaluations."""
    dims: int
    channels: int = 0

    @cached_property
    def _cache(self) -> IntegrandCache:
        """Results about this integrand. They are deleted together with it."""
        return IntegrandCache()

    def __call__(self, x: object) -> Array:
        """Return values at points x of shape (..., d): float64 (...) or (..., channels).

        Raises
        ------
        DomainError
            If x has another number of dims, or is not finite.
        ParameterError
            If the function does not return real numbers of shape (...) or (..., channels).
        """
        points = as_real_array("x", x)
        if points.ndim == 0 or points.shape[-1] != self.dims:
            raise DomainError(
                f"{self.spec} takes points of shape (..., {self.dims}), not {points.shape}."
            )
        if not in_unit_cube(points):
            raise DomainError(
                f"{self.spec} was given points that are not finite or lie outside [0,1]; give "
                "points of the unit cube."
            )
        if type(self).is_black_box is Integrand.is_black_box and self.is_black_box:
            # Count calls here only for classes of other packages: functions count their own calls
            spend(points.size // self.dims)
        return self._evaluate(points)

    @property
    def integral(self) -> Any:
        """∫ f over [0,1]^d, as a float or an array (channels,). See `integral_source`."""
        exact = self._integral()
        return numeric_integral(self) if exact is None else exact

    @property
    def integral_source(self) -> str:
        """``"exact"``, or the method that computed the integral (see `integral_accuracy`)."""
        return "exact" if self._integral() is not None else "quadrature"

    def fourier(self, m: object) -> Array:
        """Return Fourier coefficients f_m at integer frequencies m of shape (..., d).

        Returns
        -------
        ndarray
            complex128 (...) or (..., channels). `fourier_source` tells whether they are exact.

        Raises
        ------
        ParameterError
            If m is not integer, or would need an FFT grid that is too large.
        """
        frequencies = as_frequencies(m, self.dims)
        if not np.array_equal(frequencies, np.rint(frequencies)):
            raise ParameterError(
                "Fourier coefficients exist at integer frequencies m only; give whole numbers."
            )
        exact = self._fourier(frequencies)
        if exact is not None:
            return exact

        # One tensor grid serves all frequencies. The highest |m_i| on each axis determines its size
        axes, places = [], []
        for i in range(self.dims):
            distinct, where = np.unique(frequencies[..., i], return_inverse=True)
            axes.append(distinct)
            places.append(where.reshape(frequencies.shape[:-1]))
        _check_size(self, [axis.size for axis in axes])
        return np.asarray(_quadrature(self, axes).value[tuple(places)])

    def fourier_grid(self, half_width: int) -> Array:
        """Return the coefficients at all m in {−half_width … half_width}^d.

        Returns
        -------
        ndarray
            complex128 of shape (2 half_width + 1,) * d, followed by (channels,) if f has channels.

        Raises
        ------
        ParameterError
            If there are more than 2^26 coefficients or 2^24 evaluations.
        """
        m = _all_frequencies(self, half_width)
        if self._fourier(np.zeros((1, self.dims))) is None:
            return _quadrature(self, m).value.copy()
        points = np.stack(np.meshgrid(*m, indexing="ij"), axis=-1).reshape(-1, self.dims)
        blocks = []
        for start in range(0, len(points), _EXACT_BLOCK):
            exact = self._fourier(points[start : start + _EXACT_BLOCK])
            if exact is None:
                raise ParameterError(
                    f"{self.spec} has exact coefficients at some frequencies only."
                )
            blocks.append(exact)
        found = np.concatenate(blocks)
        return found.reshape(*(axis.size for axis in m), *found.shape[1:])

    @property
    def fourier_source(self) -> str:
        """``"exact"``, or the method that computes the Fourier coefficients."""
        probe = self._fourier(np.zeros((1, self.dims)))
        return "exact" if probe is not None else "FFT of composite Gauss-Legendre quadrature"

    @property
    def breaks(self) -> Breaks:
        """Positions of planes normal to each axis, across which f or a derivative jumps."""
        return ((),) * self.dims

    @property
    def is_black_box(self) -> bool:
        """Whether a call may be expensive: the function is the user's or another package's."""
        return not type(self).__module__.startswith("mcspectra.")

    def landmarks(self) -> Array:
        """Return points (k, d) in small regions where f may differ from 0. The default is none."""
        return np.empty((0, self.dims))

    @property
    def evaluations_per_point(self) -> int:
        """Evaluations of the underlying function per value. More than 1 if values are means."""
        return 1

    pilot_evaluations: int = 0
    """Evaluations of the underlying function before the first value, for example for a pilot."""

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array] | None:  # noqa: ARG002
        """Return the means of f and f² over axis-aligned boxes, if they have a closed form.

        Parameters
        ----------
        lo, hi
            Corners of the boxes, float64 (..., d) in [0,1], with lo < hi.

        Returns
        -------
        tuple of ndarray, or None
            Mean of f and mean of f², each (...) or (..., channels). None if they are not known.
            The variance within a stratum is the mean of f² minus the squared mean of f.
        """
        return None

    @abstractmethod
    def _evaluate(self, x: Array) -> Array:
        """Return values at float64 points (..., d)."""

    def _integral(self) -> Any:
        """Return the exact integral, or None if it is not known."""
        return None

    def _estimated_integral(self) -> Estimate | None:
        """Return the integral by the integrand's own rule, or None if there is no own rule."""
        return None

    def _fourier(self, m: Array) -> Array | None:  # noqa: ARG002
        """Return exact coefficients at integer m (float64, shape (..., d)), or None if unknown."""
        return None

    @staticmethod
    def from_function(
        function: Callable[[Any], Any],
        *,
        dims: int,
        integral: Any = None,
        fourier: Callable[[Any], Any] | None = None,
    ) -> Integrand:
        """Make an integrand of a vectorized callable: points (..., d) to (...) or (..., channels).

        Parameters
        ----------
        function
            The function. It is called with float64 arrays of points.
        dims
            Number of dimensions.
        integral
            Exact integral of the function, if known. Without it, measurements do not report a bias.
            If it is not given, a quadrature of up to 2^21 calls computes the attribute `integral`.
        fourier
            Exact coefficients of the function, if known: a callable that takes integer m (..., d).

        Raises
        ------
        ParameterError
            If the function is not callable.
            If the function gives a wrong shape, complex numbers, NaN or infinity at 28 test points.
            The function is called at the test points only.
        """
        if not callable(function):
            raise ParameterError(
                f"The function is {function!r}, not a callable; give f(points) -> values."
            )
        dims = as_integer("dims", dims, least=1)
        channels = _probe(function, dims)
        if fourier is not None and not callable(fourier):
            raise ParameterError(f"fourier is {fourier!r}, not a callable; give m -> coefficients.")
        if fourier is not None:
            _coefficients(fourier, np.zeros((2, 3, dims)), channels)
        return FunctionIntegrand(
            function=function,
            dims=dims,
            channels=channels,
            known_integral=None if integral is None else _check_integral(integral, channels),
            known_fourier=fourier,
        )


class Derived(Integrand):
    """An integrand made from another integrand, whose properties it has by default.

    Subclasses are dataclasses with the field `integrand`.
    A subclass sets the format string `text`, in which ``{0}`` is replaced by the instance.
    The formatted `text` is the `spec` of the integrand, which messages show.
    """

    text: ClassVar[str]
    integrand: Integrand

    @property
    def dims(self) -> int:  # type: ignore[override]
        return self.integrand.dims

    @property
    def channels(self) -> int:  # type: ignore[override]
        return self.integrand.channels

    @property
    def spec(self) -> str:
        """Text for messages. It cannot be parsed as a spec."""
        return self.text.format(self)

    @property
    def breaks(self) -> Breaks:
        return self.integrand.breaks

    @property
    def is_black_box(self) -> bool:
        return self.integrand.is_black_box

    @property
    def evaluations_per_point(self) -> int:
        return self.integrand.evaluations_per_point

    def _integral(self) -> Any:
        return self.integrand._integral()


@dataclass(frozen=True, kw_only=True)
class NamedFunction(Derived):
    """A test function with a class of its own. Its values come from the field `integrand`."""

    integrand: Integrand = field(init=False, repr=False)
    spec = Component.spec

    @property
    def fourier_source(self) -> str:
        return self.integrand.fourier_source

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array] | None:
        return self.integrand.box_moments(lo, hi)

    def _evaluate(self, x: Array) -> Array:
        return self.integrand._evaluate(x)

    def _fourier(self, m: Array) -> Array | None:
        return self.integrand._fourier(m)


def _as_integrand(given: Integrand) -> Integrand:
    """Return the given integrand. Only `mcspectra.integrand` reads spec strings."""
    if not isinstance(given, Integrand):
        raise ParameterError(
            f"{given!r:.80} is not an integrand; give the result of mcs.integrand."
        )
    return given


def _as_channel(name: str, channel: object, f: Integrand) -> int | str:
    if not _as_integrand(f).channels:
        raise ParameterError(f"{f.spec} is scalar; give an integrand with channels.")
    if channel != "luminance":
        return as_integer(name, channel, least=0, most=f.channels - 1)
    if f.channels != len(REC709):
        raise ParameterError(
            f"{f.spec} has {f.channels} channels, luminance needs {len(REC709)}; give the number "
            "of a channel."
        )
    return "luminance"


@final
@dataclass(frozen=True, kw_only=True)
class Channel(Derived):
    """A scalar view of an integrand with channels.

    Attributes
    ----------
    integrand
        The integrand f, with at least one channel.
    channel
        Number of the channel, or ``"luminance"`` (Rec. 709, three channels).

    Raises
    ------
    ParameterError
        If f is scalar, lacks the channel, or does not have three channels for the luminance.
    """

    text = "{0.integrand.spec}[{0.channel}]"
    channels = 0
    integrand: Integrand
    channel: int | str = checked(_as_channel, "luminance", using="integrand")

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array] | None:
        """Return means of f and f² for one channel.

        The result is None for the luminance, whose square needs products of channels.
        """
        found = self.integrand.box_moments(lo, hi)
        if found is None or self.channel == "luminance":
            return None
        return self._of(found[0]), self._of(found[1])

    def _of(self, values: Any) -> Array:
        values = np.asarray(values)
        found = values @ REC709 if isinstance(self.channel, str) else values[..., self.channel]
        return np.asarray(found)

    def _evaluate(self, x: Array) -> Array:
        return self._of(self.integrand._evaluate(x))

    def _integral(self) -> Any:
        exact = self.integrand._integral()
        return None if exact is None else float(self._of(exact))

    def _fourier(self, m: Array) -> Array | None:
        exact = self.integrand._fourier(m)
        return None if exact is None else self._of(exact)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class FunctionIntegrand(Integrand):
    """A vectorized callable. `Integrand.from_function` makes it and tests it.

    The callable must always give the same values, because integrals and coefficients are stored.
    """

    name: ClassVar[str] = "function"
    function: Callable[[Any], Any]
    dims: int
    channels: int = 0
    known_integral: Any = None
    known_fourier: Callable[[Any], Any] | None = None
    is_black_box = True

    @property
    def spec(self) -> str:
        """The text ``function(name)`` for messages. It cannot be parsed as a spec."""
        return f"function({getattr(self.function, '__name__', type(self.function).__name__)})"

    def _evaluate(self, x: Array) -> Array:
        spend(x.size // self.dims)
        return self.checked_values(x)

    def checked_values(self, x: Array, *, finite: bool = True) -> Array:
        """Return values at points of the unit cube. Their shape is checked; calls are not counted.

        If `finite` is true, values must not be NaN or infinite.
        """
        shape = (*x.shape[:-1], self.channels) if self.channels else x.shape[:-1]
        try:
            values = _real_values(self.function, x)
        except McspectraError:
            raise
        except Exception as error:
            raise ParameterError(
                f"{self.spec} failed on points of shape {x.shape}: {type(error).__name__}: "
                f"{reason_of(error, 500)}."
            ) from error
        if values.ndim == x.ndim and values.shape[:-1] == shape and not self.channels:
            raise ParameterError(
                f"{self.spec} gave {counted(values.shape[-1], 'value')} at each point; "
                "give one component at a time, such as lambda x: f(x)[..., 0]."
            )
        if values.shape != shape:
            raise ParameterError(
                f"{self.spec} gave values of shape {values.shape} at points of shape {x.shape}; "
                f"it must give {shape}."
            )
        return _finite(values, x, self.spec) if finite else values

    def _integral(self) -> Any:
        return self.known_integral

    def _fourier(self, m: Array) -> Array | None:
        if self.known_fourier is None:
            return None
        return _coefficients(self.known_fourier, m, self.channels)


def fourier_grid(integrand: Integrand, half_width: int) -> Array:
    """Return all coefficients up to a half width, as described in `Integrand.fourier_grid`."""
    return _as_integrand(integrand).fourier_grid(half_width)


def fourier_accuracy(integrand: Integrand, half_width: int) -> tuple[str, float]:
    """Return the method of `fourier_grid`, and its error.

    Returns
    -------
    tuple
        Description of the method, and an estimate of its largest absolute error.
        The error is 0 if the coefficients are exact.
        Otherwise the error is the largest difference from a grid with half the nodes.
        For smooth f, the difference between two grids is far above the true error.
    """
    if _as_integrand(integrand)._fourier(np.zeros((1, integrand.dims))) is not None:
        return integrand.fourier_source, 0.0
    found = _quadrature(integrand, _all_frequencies(integrand, half_width))
    return f"{integrand.fourier_source}, {found.method}", found.error


def numeric_integral(integrand: Integrand) -> Any:
    """Return ∫ f by quadrature: a float, or an array (channels,).

    In up to 5 dims, Gauss-Legendre quadrature on boxes is used.
    The boxes are cut at the breaks, and at jumps normal to an axis that line searches detect.
    Boxes are divided until the accuracy is 1e-12 of ∫|f|, or after 2^21 evaluations.
    In more dims, the result is the mean over 2^20 points of a Kronecker sequence.
    The mean over a Kronecker sequence has three to six accurate digits.
    An integrand with its own rule, such as a pixel, uses that rule instead.
    `integral_accuracy` returns an estimate of the error.
    """
    value = integral_estimate(integrand).value
    return value.copy() if integrand.channels else float(value[0])


def integral_accuracy(integrand: Integrand) -> tuple[str, float]:
    """Return the method of `integral`, and an estimate of its absolute error (0 if exact)."""
    if _as_integrand(integrand)._integral() is not None:
        return "exact", 0.0
    found = integral_estimate(integrand)
    return found.method, found.error


def _all_frequencies(integrand: Integrand, half_width: int) -> list[Array]:
    width = as_integer("half_width", half_width, least=0)
    _check_size(integrand, [2 * width + 1] * integrand.dims)
    return [np.arange(-width, width + 1, dtype=np.float64)] * integrand.dims


def _check_size(integrand: Integrand, sizes: list[int]) -> None:
    count = math.prod(sizes) * max(1, integrand.channels)
    if count > _MOST_COEFFICIENTS:
        raise ParameterError(
            f"{count:.3g} Fourier coefficients of {integrand.spec} are more than "
            f"{_MOST_COEFFICIENTS:.3g}, 1 GiB; choose a smaller ",
            Parameter("half_width"),
            " or fewer frequencies.",
        )


def _quadrature(integrand: Integrand, m: Sequence[Array]) -> Estimate:
    """Return coefficients at all products of frequencies along the axes. They are stored."""
    kept = integrand._cache.coefficients
    key = tuple(axis.tobytes() for axis in m)
    if key in kept:
        return kept[key]
    found = refined_coefficients(integrand, m)
    if all((axis == 0).any() for axis in m):
        # Replace the coefficient at frequency 0 by the integral, which is exact or more accurate.
        # Two grids may agree by chance, for instance if a border runs along their diagonals.
        # If two grids agree by chance, the integral shows the error of their coefficient at 0
        zero = tuple(int(np.flatnonzero(axis == 0)[0]) for axis in m)
        value, integral = found.value.copy(), integrand.integral
        error = max(found.error, float(np.abs(value[zero] - integral).max()))
        value[zero] = integral
        found = replace(found, value=value, error=error)
    while len(kept) >= _KEPT:
        kept.pop(next(iter(kept)), None)
    kept[key] = found
    return found


def integral_estimate(integrand: Integrand) -> Estimate:
    """Return ∫ f by quadrature and its error, as in `numeric_integral`. Both numbers are stored."""
    cache = integrand._cache
    if cache.integral is None:
        found = integrand._estimated_integral()
        if found is None and integrand.dims <= _ADAPTIVE_DIMS:
            breaks = found_breaks(integrand)
            probed, cache.probed = cache.probed, None
            found = adaptive_integral(integrand, breaks, probed)
        cache.integral = found or lattice_integral(integrand)
    return cache.integral


def found_breaks(integrand: Integrand) -> tuple[Array, ...]:
    """Return the breaks along each axis: breaks that f declares, and breaks that searches detect.

    See `mcspectra.integrands._quadrature.search_breaks`.
    """
    cache = integrand._cache
    if cache.breaks is None:
        cache.breaks, cache.probed = search_breaks(integrand)
    return cache.breaks


def _probe(function: Callable[[Any], Any], dims: int) -> int:
    """Return the number of channels, after a test of the function on 28 points. Scalars have 0."""
    # Use points of an additive recurrence, which do not lie on any grid line
    steps = np.sqrt(np.arange(2, 2 + dims) + 0.5)
    x = ((0.5 + np.arange(1, 29)[:, None] * steps) % 1.0).reshape(*_PROBE, dims)
    try:
        values = _real_values(function, x)
    except ParameterError:
        raise
    except (TypeError, ValueError, IndexError) as error:
        if _works_on_one_point(function, x[0, 0]):
            raise ParameterError(
                "The function takes one point at a time; write it for arrays of shape "
                "(..., d), with x[..., 0] for the first coordinate and numpy's functions."
            ) from error
        raise
    if values.shape[:2] != _PROBE or values.ndim > 3 or 0 in values.shape:
        raise ParameterError(
            f"The function gave shape {values.shape} at points of shape {x.shape}; it must give "
            f"{_PROBE}, or {(*_PROBE, 'channels')}, one value for each point "
            "(use x[..., 0] for the first coordinate)."
        )
    _finite(values, x, "The function")
    return values.shape[2] if values.ndim == 3 else 0


def _works_on_one_point(function: Callable[[Any], Any], point: Array) -> bool:
    """Return whether a function that fails on arrays accepts a single point, or a number in 1-D."""
    for x in (point, float(point[0])):
        with contextlib.suppress(Exception):  # only the first failure is reported
            if np.ndim(function(x)) <= 1:
                return True
    return False


def _real_values(function: Callable[[Any], Any], x: Array) -> Array:
    """Call `function` with a read-only view of the points, because they are used again later."""
    view = x.view()
    view.flags.writeable = False
    try:
        given = function(view)
    except ValueError as error:
        if "read-only" not in str(error):
            raise
        raise ParameterError(
            "The function changes its argument in place; work on a copy, x = x.copy()."
        ) from error
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
        wanted = f"{channels} finite numbers, one per channel" if channels else "one finite number"
        raise ParameterError(f"integral is {integral!r}; give {wanted}.")
    return value if channels else float(value)


def _coefficients(fourier: Callable[[Any], Any], m: Array, channels: int) -> Array:
    """Return complex128 coefficients from a user's callable, after checks of shape and values."""
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
