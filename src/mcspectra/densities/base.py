"""The interface of importance densities (pdf, sample, invert), and densities given by functions.

A `Density` is a warp T with its pdf. T maps u in the unit cube (primary space) to x in the domain.
The methods are ``x = sample(u)``, ``u = invert(x)`` and ``pdf(x) = |det dT/du|^-1``.
The public methods check their points once. They then call `_pdf`, `_sample` or `_invert`.
Subclasses define `_pdf`, `_sample` and `_invert`, which get plain arrays without checks.
A `Wrapper` is a density that creates another density and forwards all calls to it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import (
    BELOW_ONE,
    MAX_DIMS,
    Array,
    as_integer,
    as_real_array,
    as_reals,
    in_unit_cube,
)
from mcspectra.core.display import shown
from mcspectra.core.errors import (
    DensityError,
    DomainError,
    UndefinedRatioWarning,
    point_in_words,
    warn,
)
from mcspectra.core.fields import checked, whole
from mcspectra.core.spec import Component
from mcspectra.densities.adaptive import mean_or_infinity
from mcspectra.densities.consistency import check_density
from mcspectra.densities.numerical import NumericalWarp

__all__ = [
    "Density",
    "FunctionDensity",
    "NumericalDensity",
    "Wrapper",
    "as_points",
    "bounded_product",
    "check_density",
    "divide_by_density",
    "exponential",
    "per_dim",
    "plain",
    "reciprocal_integral",
]

_LARGEST_LOGARITHM = float(np.log(np.finfo(float).max))
_PROBE = 5  # points in the first call of a function; a small odd number reveals wrong shapes
_SAME = 1e-9


def per_dim(default: float, **limits: float) -> Any:
    """Declare a field: one real number, for all dims or per dim, stored in the given form."""

    def check(name: str, given: Any, dims: int) -> Any:
        as_reals(name, given, dims, **limits)
        return plain(given)

    return checked(check, default, using="dims")


class Density(Component, ABC):
    """A probability density on [0,1)^d with its warp.

    Attributes
    ----------
    dims
        Number of dimensions d.
    warps
        Names that the parameter ``warp`` allows. All these warps T have the same pdf.
        The tuple is empty if the density has a single warp.
    """

    dims: int
    warps: ClassVar[tuple[str, ...]] = ()

    @property
    def primary_dims(self) -> int:
        """Number of dims of u: `dims`, or more if extra coordinates select a part of a mixture."""
        return self.dims

    def pdf(self, x: object) -> Array:
        """Return the density at points x (..., d) as float64 (...). Its integral is 1."""
        return self._pdf(as_points(x, self.dims, "x"))

    def sample(self, u: object) -> Array:
        """Warp primary points u to the domain.

        Parameters
        ----------
        u
            Points (..., primary_dims) in [0,1).

        Returns
        -------
        Points x of shape (..., d) in [0,1), float64.
        """
        x = self._sample(as_points(u, self.primary_dims, "u"))
        return np.clip(x, 0.0, BELOW_ONE)

    def sample_pdf(self, u: object) -> tuple[Array, Array]:
        """Return the points x (..., d) of `sample` and the density at x (...), in one pass."""
        x, pdf = self._sample_pdf(as_points(u, self.primary_dims, "u"))
        return np.clip(x, 0.0, BELOW_ONE), pdf

    def invert(self, x: object) -> Array:
        """Return primary points u (..., d) in [0,1) with ``sample(u) = x``."""
        u = self._invert(as_points(x, self.dims, "x"))
        return np.clip(u, 0.0, BELOW_ONE)

    @property
    def has_inverse(self) -> bool:
        """Whether `invert` is available."""
        return True

    @property
    def one_to_one(self) -> bool:
        """Whether each x comes from at most one u, except on a set of measure zero."""
        return True

    def preimages(self, x: object) -> Array:
        """Return all known primary points (k', primary_dims) that T maps to points x (k, d)."""
        return self.invert(x) if self.has_inverse else np.empty((0, self.primary_dims))

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Positions on each axis of *primary* space where the warp is not smooth."""
        return ((),) * self.primary_dims

    def zero_points(self) -> Array:
        """Return points (k, d) inside regions where p is known to be 0; often empty."""
        return np.empty((0, self.dims))

    def reciprocal_integral(self) -> float:
        """Return ∫ 1/p over [0,1)^d, which is infinite if the integral diverges.

        For n random points, ∫ 1/p equals 1 + n Var(S_0), where S_0 is the mean of their 1/p.

        The value is exact if the class has a closed form; otherwise it comes from a quadrature.
        """
        return reciprocal_integral(self)

    def check(self) -> None:
        """Test whether pdf, sample and invert are consistent (see `check_density`)."""
        check_density(self)

    @abstractmethod
    def _pdf(self, x: Array) -> Array:
        """Return the density at float64 points (..., d)."""

    @abstractmethod
    def _sample(self, u: Array) -> Array:
        """Warp float64 points (..., d)."""

    def _sample_pdf(self, u: Array) -> tuple[Array, Array]:
        """Warp float64 points (..., d), and return the density there as well."""
        x = np.clip(self._sample(u), 0.0, BELOW_ONE)
        return x, self._pdf(x)

    def _invert(self, x: Array) -> Array:  # noqa: ARG002
        """Undo `_sample` at float64 points (..., d)."""
        raise DensityError(f"The density {self.spec} was given without an inverse; give invert=.")

    @staticmethod
    def from_functions(
        *,
        pdf: Callable[[Any], Any],
        sample: Callable[[Any], Any] | None = None,
        invert: Callable[[Any], Any] | None = None,
        dims: int = 1,
        normalize: bool = False,
    ) -> Density:
        """Make a density from vectorized callables, and check it.

        The functions are called with read-only float64 arrays (..., d) with any leading axes.

        Parameters
        ----------
        pdf
            Density at points (..., d), with integral 1. It may be 0 on a set of measure zero.
        sample
            The warp T from primary points (..., d) in [0,1) to points (..., d) in [0,1).
            If it is missing, the warp is computed from the pdf in 1-D and 2-D.
            See `mcspectra.densities.NumericalDensity`.
        invert
            The inverse of `sample`, if known.
        dims
            Number of dims d.
        normalize
            Whether to divide the pdf by its integral, if `sample` is not given.

        Raises
        ------
        DensityError
            If a function is not callable, fails, or returns a wrong shape.
            If functions are not consistent (see `check`), or if a necessary function is missing.

        Examples
        --------
        >>> import numpy as np
        >>> p = Density.from_functions(
        ...     pdf=lambda x: 2 * x[..., 0], sample=np.sqrt, invert=np.square
        ... )
        >>> p.sample([[0.25]])
        array([[0.5]])
        """
        if sample is None:
            if not callable(pdf):
                raise DensityError(f"pdf is {shown(pdf)}; give a function of points (..., d).")
            if invert is not None:
                raise DensityError("invert was given without sample; give both, or neither.")
            if not isinstance(normalize, bool):
                raise DensityError(f"normalize is {shown(normalize)}; give True or False.")
            if as_integer("dims", dims, least=1) > 2:
                raise DensityError(
                    f"sample is None in {dims} dims; a pdf alone is enough in 1-D and 2-D only: "
                    "give sample=, or a product of densities."
                )
            return NumericalDensity(dims=dims, pdf_function=pdf, normalize=normalize)
        if normalize:
            raise DensityError(
                "normalize works without sample= only; leave it out and give a pdf with integral 1."
            )
        for name, function in (("pdf", pdf), ("sample", sample), ("invert", invert)):
            if not callable(function) and not (name == "invert" and function is None):
                raise DensityError(
                    f"{name} is {shown(function)}; give a function of points (..., d)."
                )
        made = FunctionDensity(
            dims=dims, pdf_function=pdf, sample_function=sample, invert_function=invert
        )
        # Call all functions on a few points, first with one and then with two leading axes
        for shape in [(_PROBE, made.dims), (_PROBE, 2, made.dims)]:
            u = np.linspace(0.2, 0.8, int(np.prod(shape))).reshape(shape)
            made._pdf(u)
            x = made._sample(u)
            if made.has_inverse:
                made._invert(np.clip(x, 0.0, BELOW_ONE))
        made.check()
        return made


class Wrapper(Density):
    """A density that takes its warp and pdf from another density, `_inside`."""

    @property
    @abstractmethod
    def _inside(self) -> Density:
        """The density that is wrapped."""

    @property
    def primary_dims(self) -> int:
        return self._inside.primary_dims

    @property
    def has_inverse(self) -> bool:
        return self._inside.has_inverse

    @property
    def one_to_one(self) -> bool:
        return self._inside.one_to_one

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        return self._inside.breaks

    def preimages(self, x: object) -> Array:
        return self._inside.preimages(x)

    def zero_points(self) -> Array:
        return self._inside.zero_points()

    def reciprocal_integral(self) -> float:
        return self._inside.reciprocal_integral()

    def _pdf(self, x: Array) -> Array:
        return self._inside._pdf(x)

    def _sample(self, u: Array) -> Array:
        return self._inside._sample(u)

    def _invert(self, x: Array) -> Array:
        return self._inside._invert(x)


class _ByFunctions(Density):
    """Base class of densities that are given by functions: the name, and checked calls."""

    name: ClassVar[str] = "function"
    pdf_function: Callable[[Any], Any]

    @property
    def spec(self) -> str:
        """Text ``function(name)`` with the name of the pdf. It cannot be parsed as a spec."""
        called = getattr(self.pdf_function, "__name__", "")
        return f"function({called})" if called.isidentifier() else "function"

    def _call(self, name: str, points: Array) -> Array:
        """Evaluate a function at points, and check the type and shape of its values."""
        shape = points.shape[:-1] if name == "pdf" else points.shape
        shown = points.view()
        shown.setflags(write=False)
        try:
            given = np.asarray(getattr(self, f"{name}_function")(shown))
        except Exception as error:
            raise DensityError(
                f"The {name} of {self.spec} failed on points of shape {points.shape}: "
                f"{type(error).__name__}: {error}"
            ) from error
        if given.dtype.kind not in "fiub":
            raise DensityError(f"The {name} of {self.spec} gave {given.dtype}, not real numbers.")
        if given.shape != shape:
            column = name == "pdf" and given.shape == (*shape, 1)
            raise DensityError(
                f"The {name} of {self.spec} gave shape {given.shape} for points of shape "
                f"{points.shape}; it must give {shape}."
                + (" Write x[..., 0] in place of x." if column else "")
            )
        return np.asarray(given, np.float64)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class FunctionDensity(_ByFunctions):
    """A density given by functions pdf, sample and (optionally) invert.

    Create this density with `Density.from_functions`, which checks it.
    The functions are called with read-only float64 arrays (..., d) with any leading axes.
    """

    dims: int = whole(least=1, most=MAX_DIMS)
    pdf_function: Callable[[Any], Any]
    sample_function: Callable[[Any], Any]
    invert_function: Callable[[Any], Any] | None = None

    @property
    def has_inverse(self) -> bool:
        """Whether the function invert was given."""
        return self.invert_function is not None

    def _pdf(self, x: Array) -> Array:
        return self._call("pdf", x)

    def _sample(self, u: Array) -> Array:
        return self._call("sample", u)

    def _invert(self, x: Array) -> Array:
        return self._call("invert", x) if self.has_inverse else Density._invert(self, x)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class NumericalDensity(_ByFunctions):
    """A density given by its pdf alone, in 1-D or 2-D; the warp is computed.

    Instances are made by `Density.from_functions`.
    The pdf is called with read-only float64 arrays (..., d) of points within the domain.
    In 2-D, each sampled point costs a few hundred evaluations of the pdf.

    Details of the pdf, such as a peak, a gap or a box, are resolved if they are wide enough.
    The least width is 2^-18 in 1-D, and 1/500 along both axes in 2-D.
    Narrower details may be missed, together with their probability mass.
    If mass is missed, `normalize` divides by an integral that is too small.
    If the integral is known, ``normalize=False`` detects missing mass.
    If a function ``sample=`` is given, the warp is not computed from the pdf: no mass is missed.

    Attributes
    ----------
    dims
        1 or 2.
    pdf_function
        Density: function of points (..., d) that returns values (...).
    normalize
        Whether to divide the pdf by its integral.

    Raises
    ------
    DensityError
        If the integral of the pdf is not 1 (to 1e-9) and `normalize` is False.
        If the pdf is negative, not finite within (0,1)^d, or too rough or steep.
        In 2-D, a pdf with jumps or kinks along oblique or curved lines is too rough for the warp.
        In 1-D, a density with a pole is too steep, unless the pole is at 0, where floats are dense.
    """

    dims: int = whole(1, least=1, most=2)
    pdf_function: Callable[[Any], Any]
    normalize: bool = False

    def _check(self) -> None:
        self._raw(np.linspace(0.2, 0.8, _PROBE * self.dims).reshape(_PROBE, self.dims))
        if self.dims == 2:
            self._warp.check_rows()
        total = self._warp.total
        if not self.normalize and not abs(total - 1.0) <= _SAME:
            raise DensityError(
                f"The pdf of {self.spec} integrates to {total:.12g} over the unit domain, not to "
                "1; divide it by this number, or give normalize=True."
            )

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Cdf at jumps and kinks. In 2-D, only for axis 1, since breaks of axis 0 vary by row."""
        return self._warp.breaks

    def zero_points(self) -> Array:
        """Return the centers of cells in which the pdf is 0. In 2-D, use the marginal pdf."""
        return self._warp.zero_points()

    @cached_property
    def _warp(self) -> NumericalWarp:
        return NumericalWarp(self._raw, self.dims, self.spec)

    def _raw(self, x: Array) -> Array:
        """Return the values of the pdf. At poles they are infinite."""
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            return self._call("pdf", x)

    def _pdf(self, x: Array) -> Array:
        p = self._raw(x)
        return np.asarray(p / self._warp.total) if self.normalize else p

    def _sample(self, u: Array) -> Array:
        return self._warp.sample(u)

    def _invert(self, x: Array) -> Array:
        return self._warp.invert(x)


def as_points(x: object, dims: int, name: str) -> Array:
    """Convert x to float64 (..., d) in [0,1] (a grid may end at 1), or raise an error."""
    points = as_real_array(name, x)
    if points.ndim == 0 or points.shape[-1] != dims:
        raise DomainError(f"{name} has shape {points.shape}; give points of shape (..., {dims}).")
    if not in_unit_cube(points):
        if not np.isfinite(points).all():
            raise DomainError(f"{name} holds NaN or infinity; give finite points in [0,1).")
        raise DomainError(
            f"{name} runs from {points.min():.6g} to {points.max():.6g}; give points in [0,1)."
        )
    return points


def plain(value: Any) -> Any:
    """Convert a list or array to a tuple of Python numbers, so that components hash and print."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(map(plain, value)) if isinstance(value, list | tuple) else value


def bounded_product(factors: Array, spec: str) -> Array:
    """Return the product of finite factors ≥ 0 over the last axis. No partial product overflows.

    Raises
    ------
    DensityError
        If the product exceeds the largest float, as in hundreds of dims.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        product = np.asarray(factors.prod(axis=-1))
    overflown = ~np.isfinite(product)
    if overflown.any():  # a partial product may overflow although the result does not
        with np.errstate(divide="ignore"):
            product[overflown] = exponential(np.log(factors[overflown]).sum(axis=-1), spec)
    return product


def exponential(logarithm: Array, spec: str) -> Array:
    """Return the exponential of logarithms of a pdf that is finite in theory.

    Raises
    ------
    DensityError
        If the exponential exceeds the largest float.
    """
    if (logarithm >= _LARGEST_LOGARITHM).any():
        raise DensityError(
            f"The pdf of {spec} reaches exp({logarithm.max():.6g}), more than a float can hold "
            f"(exp({_LARGEST_LOGARITHM:.0f})); use fewer dims or a wider density."
        )
    return np.asarray(np.exp(logarithm))


def divide_by_density(
    values: Array, pdf: Array, x: Array, spec: str, *, constant: bool = False
) -> Array:
    """Return values/pdf, or 0 if both are 0. Values are (...) or (..., channels).

    If samples are not randomized, a pdf that is 0 on a face or a line can be 0 at a sample.
    For example, many sequences start at the origin.

    Parameters
    ----------
    values
        Values of f at the samples, or a constant.
    pdf
        Values of the density p at the samples.
    x
        The samples, (..., d).
    spec
        Name of the estimator in messages.
    constant
        Whether `values` is a constant, so that values/pdf is a weight and not an estimate.

    Raises
    ------
    DensityError
        If the pdf is 0 at a sample where the value is not 0.

    Warns
    -----
    UndefinedRatioWarning
        If the values and the pdf are both 0 at a sample.
        By default Python shows the warning once, since its text is the same for all blocks.
    """
    scaled = pdf if values.ndim == pdf.ndim else pdf[..., None]
    zero = pdf <= 0
    if not zero.any():
        return np.asarray(values / scaled)
    bad = zero & (values != 0 if values.ndim == pdf.ndim else (values != 0).any(axis=-1))
    if bad.any():
        what = "so that its weight is infinite" if constant else "where f is not 0"
        raise DensityError(
            f"The density of {spec} is 0 at the sample {point_in_words(x[bad][0])}, {what}; "
            "if the density is 0 on a line or a face only, randomize the sampler (for instance "
            "with '| shift'); else choose a density that is positive wherever f is not 0."
        )
    warn(
        f"f and the density of {spec} are both 0 at the sample {point_in_words(x[zero][0])}: f/p "
        "counts as 0 there, whatever its limit; randomize the sampler (for instance with "
        "'| shift').",
        UndefinedRatioWarning,
    )
    return np.asarray(values / np.where(scaled > 0, scaled, 1.0))


def reciprocal_integral(density: Density) -> float:
    """Return ∫1/p over [0,1)^d, which is infinite if the integral diverges.

    Parameters
    ----------
    density
        Any density; only its pdf is used.

    Notes
    -----
    In 1-D and 2-D, adaptive quadrature splits the cells around zeros of p.
    The module `mcspectra.densities.adaptive` describes this quadrature.
    Let p ~ r^a at the distance r from a zero of p.
    From one level of cells to the next, the unresolved part of ∫1/p shrinks by a constant ratio.
    If p is 0 at a point in 1-D or on a line in 2-D, the unresolved part shrinks by 2^{a−1}.
    If p is 0 at a point in 2-D, the unresolved part shrinks by 2^{a−2} from level to level.
    If the unresolved part does not shrink from level to level, ∫1/p diverges.
    Ratios above 0.98 count as divergent, so a > 0.97 cannot be distinguished from 1.
    The remainder of the geometric series is added (Aitken). If p = 0 in a cell, ∫1/p is infinite.
    Relative errors are about 1e-7 in 1-D, and 1e-4 in 2-D if p jumps along curves.

    In three or more dims, and in 2-D if p jumps in many places, the method is a heuristic.
    The heuristic takes the mean of 1/p over 131 072 low-discrepancy points.
    Hill's method estimates the tail index a of 1/p from its largest 256 values.
    A variable whose tail falls like v^(-1/a) has an infinite mean for a ≥ 1.
    ∫1/p counts as infinite if the estimated tail index exceeds 0.81: 1 minus 3 standard errors.
    The method misses a zero of p that fills less than about 1e-5 of the domain.
    """
    if not isinstance(density, Density):
        raise DensityError(f"{shown(density)} is not a density; give what mcs.density makes.")

    def reciprocal(x: Array) -> Array:
        with np.errstate(divide="ignore", over="ignore"):
            return np.asarray(1.0 / density._pdf(x))

    return mean_or_infinity(reciprocal, density.dims)
