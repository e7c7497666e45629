"""The interface of importance densities, pdf, sample, invert; densities given by functions.

A `Density` is a warp T from the unit cube (primary space, u) to itself (domain, x) together with
its density: ``x = sample(u)``, ``u = invert(x)``, ``pdf(x) = |det dT/du|^-1``. The public methods
check their points, once; implementations write `_pdf`, `_sample` and `_invert`, which trust plain
arrays. A `Wrapper` forwards to a density that it makes.
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
_PROBE = 5  # points of the first try; odd and small, so that no shape fits by accident
_SAME = 1e-9


def per_dim(default: float, **limits: float) -> Any:
    """Declare a field of one real number for all dims or one a dim, which stays as it was given."""

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
        Names of the warps T that the parameter ``warp`` chooses from, of the same pdf; often none.
    """

    dims: int
    warps: ClassVar[tuple[str, ...]] = ()

    @property
    def primary_dims(self) -> int:
        """Number of dims of u: as many as x, or more if extra coordinates choose a part."""
        return self.dims

    def pdf(self, x: object) -> Array:
        """Density at points x of shape (..., d): float64 (...), integral 1 over [0,1)^d."""
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
        """Points x of `sample` (..., d) and the density there, (...), in one pass where that is cheaper."""
        x, pdf = self._sample_pdf(as_points(u, self.primary_dims, "u"))
        return np.clip(x, 0.0, BELOW_ONE), pdf

    def invert(self, x: object) -> Array:
        """Undo `sample`: primary points u of shape (..., d), in [0,1)."""
        u = self._invert(as_points(x, self.dims, "x"))
        return np.clip(u, 0.0, BELOW_ONE)

    @property
    def has_inverse(self) -> bool:
        """Whether `invert` is available."""
        return True

    @property
    def one_to_one(self) -> bool:
        """Whether at most one u leads to any x, but for a set of measure zero."""
        return True

    def preimages(self, x: object) -> Array:
        """All primary points (k', primary_dims) that lead to points x of shape (k, d), if known."""
        return self.invert(x) if self.has_inverse else np.empty((0, self.primary_dims))

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """For each axis of *primary* space, where the warp is not smooth (for quadrature)."""
        return ((),) * self.primary_dims

    def zero_points(self) -> Array:
        """Points (k, d) where p is known to be 0 on a set of positive measure; often none."""
        return np.empty((0, self.dims))

    def reciprocal_integral(self) -> float:
        """Return ∫ 1/p over [0,1)^d, infinite where it diverges: 1 + n Var(S_0) of random points.

        Cost: exact where an implementation knows it, a quadrature otherwise.
        """
        return reciprocal_integral(self)

    def check(self) -> None:
        """Test that pdf, sample and invert belong together (see `check_density`)."""
        check_density(self)

    @abstractmethod
    def _pdf(self, x: Array) -> Array:
        """Density at float64 points (..., d)."""

    @abstractmethod
    def _sample(self, u: Array) -> Array:
        """Warp float64 points (..., d)."""

    def _sample_pdf(self, u: Array) -> tuple[Array, Array]:
        """Warp float64 points (..., d), and give the density there."""
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
        """Make a density of vectorized callables, and check it.

        The functions are called with read-only float64 arrays, with any number of axes in front.

        Parameters
        ----------
        pdf
            Density: points (..., d) to (...); integral 1. It may be 0 on a set of measure zero.
        sample
            The warp T: primary points (..., d) in [0,1) to points (..., d) in [0,1). Without it, in
            1-D and 2-D, the warp is computed from the pdf (see `mcspectra.densities.NumericalDensity`).
        invert
            The inverse of `sample`, if known.
        dims
            Number of dims d.
        normalize
            Divide a pdf that is given alone by its integral.

        Raises
        ------
        DensityError
            Not callable, failing on a try, of the wrong shape, or not belonging together (see
            `check`); or the pdf alone is not enough.

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
                    f"sample is None in {dims} dims; a pdf alone is enough in 1-D and 2-D only: give "
                    "sample=, or a product of densities."
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
        # Call all functions on few points, with one and with two axes in front
        for shape in [(_PROBE, made.dims), (_PROBE, 2, made.dims)]:
            u = np.linspace(0.2, 0.8, int(np.prod(shape))).reshape(shape)
            made._pdf(u)
            x = made._sample(u)
            if made.has_inverse:
                made._invert(np.clip(x, 0.0, BELOW_ONE))
        made.check()
        return made


class Wrapper(Density):
    """A density whose warp and pdf are those of another one, `_inside`, that it makes."""

    @property
    @abstractmethod
    def _inside(self) -> Density:
        """The density that does the work."""

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
    """What densities given by functions share: a name, and how they are called."""

    name: ClassVar[str] = "function"
    pdf_function: Callable[[Any], Any]

    @property
    def spec(self) -> str:
        """``function``, with the name of the pdf; not a spec that can be read back."""
        called = getattr(self.pdf_function, "__name__", "")
        return f"function({called})" if called.isidentifier() else "function"

    def _call(self, name: str, points: Array) -> Array:
        """Values of a function at points, after checking that they are numbers of its shape."""
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
    """Given by functions pdf, sample and (optionally) invert.

    Make it by `Density.from_functions`, which checks it. The functions are called with read-only
    float64 arrays of shape (..., d), with any number of axes in front.
    """

    dims: int = whole(least=1, most=MAX_DIMS)
    pdf_function: Callable[[Any], Any]
    sample_function: Callable[[Any], Any]
    invert_function: Callable[[Any], Any] | None = None

    @property
    def has_inverse(self) -> bool:
        """Whether invert was given."""
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
    """Given by its pdf alone, in 1-D or 2-D; the warp is computed.

    Make it by `Density.from_functions`. The pdf is called with read-only float64 arrays (..., d) of
    points within the domain. In 2-D every sampled point costs a few hundred evaluations.

    Details of the pdf, such as a peak, a gap or a box, are seen if they are wider than 2^-18 in 1-D,
    in 2-D than 1/500 along both axes. Narrower details may be missed, with their mass: then
    `normalize` divides by an integral that is too small. Tell it by ``normalize=False``, if the
    integral is known, or give sample=.

    Attributes
    ----------
    dims
        1 or 2.
    pdf_function
        Density: points (..., d) to (...).
    normalize
        Divide the pdf by its integral.

    Raises
    ------
    DensityError
        The pdf does not integrate to 1 (to 1e-9) and is not to be normalized; is negative, not
        finite within (0,1)^d, or too rough or steep: in 2-D with jumps or kinks along lines that
        are not axis-parallel, in 1-D with poles anywhere but at 0, next to which floats are dense.
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
                f"The pdf of {self.spec} integrates to {total:.12g} over the unit domain, not to 1; "
                "divide it by this number, or give normalize=True."
            )

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """The cdf at jumps and kinks; in 2-D on axis 1 only, those of axis 0 depend on the row."""
        return self._warp.breaks

    def zero_points(self) -> Array:
        """Centers of cells in which the pdf is 0; in 2-D of those of the marginal."""
        return self._warp.zero_points()

    @cached_property
    def _warp(self) -> NumericalWarp:
        return NumericalWarp(self._raw, self.dims, self.spec)

    def _raw(self, x: Array) -> Array:
        """What the pdf gives: poles and all."""
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
    """Return x as float64 (..., d) in [0,1] (a grid may end at 1); anything else is an error."""
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
    """Return a list or array as a tuple of Python numbers, so that components hash and print."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(map(plain, value)) if isinstance(value, list | tuple) else value


def bounded_product(factors: Array, spec: str) -> Array:
    """Return the product over the last axis of finite factors >= 0, which a float may not hold.

    Raises
    ------
    DensityError
        It exceeds the largest float, as in hundreds of dims.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        product = np.asarray(factors.prod(axis=-1))
    overflown = ~np.isfinite(product)
    if overflown.any():  # maybe on the way only
        with np.errstate(divide="ignore"):
            product[overflown] = exponential(np.log(factors[overflown]).sum(axis=-1), spec)
    return product


def exponential(logarithm: Array, spec: str) -> Array:
    """Return the exponential of logarithms of a pdf that is finite in theory.

    Raises
    ------
    DensityError
        It exceeds the largest float.
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
    """Return values/pdf, 0 where both vanish; values (...) or (..., channels).

    Samples lie where pdf is 0 when that is a face or a line and the points are not randomized: the
    first point of many sequences is the origin.

    Parameters
    ----------
    values, pdf, x
        Of f or of a constant, of p, and the samples (..., d).
    spec
        Name of the estimator in messages.
    constant
        Whether the values are those of a constant, so that the ratio is a weight.

    Raises
    ------
    DensityError
        pdf is 0 at a sample where the value is not.

    Warns
    -----
    UndefinedRatioWarning
        Both are 0 at a sample; the text is the same for every block of an estimator, so that
        Python's default filter shows it once.
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
            "if the density is 0 on a line or a face only, randomize the sampler (for instance with "
            "'| shift'); else choose a density that is positive wherever f is not 0."
        )
    warn(
        f"f and the density of {spec} are both 0 at the sample {point_in_words(x[zero][0])}: f/p "
        "counts as 0 there, whatever its limit; randomize the sampler (for instance with "
        "'| shift').",
        UndefinedRatioWarning,
    )
    return np.asarray(values / np.where(scaled > 0, scaled, 1.0))


def reciprocal_integral(density: Density) -> float:
    """Return ∫1/p over [0,1)^d, infinite where it diverges.

    Parameters
    ----------
    density
        Any density; only its pdf is used.

    Notes
    -----
    In 1-D and 2-D adaptive quadrature (`mcspectra.densities.adaptive`) splits the cells around zeros
    of p. Where p ~ r^a next to a zero at distance r, what is left unresolved shrinks by 2^{a−1}
    a level next to a point in 1-D or a line in 2-D, and 2^{a-2} next to a point in 2-D: the integral
    diverges where that ratio reaches 1. Ratios above 0.98 are counted as divergent, so a > 0.97 cannot
    be distinguished from 1. The rest of the geometric series is added (Aitken). Cells where p = 0 make it
    infinite. Relative errors are about 1e-7 in 1-D; 1e-4 in 2-D where p jumps along curves.

    In 3-D and more, and in 2-D where p jumps all over the domain, this is a heuristic: the mean of
    1/p over 131 072 low-discrepancy points, and Hill's estimate of the tail index from the largest
    256 values of 1/p. The mean of a variable whose tail falls like v^(-1/a) is infinite for a ≥ 1;
    a > 0.81 (three standard errors below) is counted as that. A zero of p that occupies less than
    about 1e-5 of the domain is not seen.
    """
    if not isinstance(density, Density):
        raise DensityError(f"{shown(density)} is not a density; give what mcs.density makes.")

    def reciprocal(x: Array) -> Array:
        with np.errstate(divide="ignore", over="ignore"):
            return np.asarray(1.0 / density._pdf(x))

    return mean_or_infinity(reciprocal, density.dims)
