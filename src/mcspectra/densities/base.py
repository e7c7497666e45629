"""The interface of importance densities, pdf, sample, invert; densities given by functions.

A `Density` is a warp T from the unit cube (primary space, u) to itself (domain, x) together with
its density: ``x = sample(u)``, ``u = invert(x)``, ``pdf(x) = |det dT/du|^-1``. Implementations
write `_pdf`, `_sample` and `_invert` on plain arrays. What every density has is here: checks of
arguments, `Density.check`, ∫1/p by quadrature, and `Density.from_functions`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real_array
from mcspectra.core.errors import (
    DensityError,
    DomainError,
    UndefinedRatioWarning,
    point_in_words,
    warn,
)
from mcspectra.core.spec import Component
from mcspectra.densities.adaptive import (
    CELLS,
    SET_SIZE,
    SETS,
    integrate,
    mean_or_infinity,
    recurrences,
)
from mcspectra.densities.numerical import NumericalWarp

__all__ = [
    "Density",
    "FunctionDensity",
    "NumericalDensity",
    "as_points",
    "bounded_product",
    "check_density",
    "divide_by_density",
    "exponential",
    "plain",
    "reciprocal_integral",
    "store_integer",
]

LARGEST_BELOW_ONE = float(np.nextafter(1.0, 0.0))
LARGEST_LOGARITHM = float(np.log(np.finfo(float).max))

_MAX_DIMS = 1024  # of functions
_PROBE = 5  # points of the first try; odd and small, so that no shape fits by accident
_SAME = 1e-9
_SPREADS = 7.0  # Student's t with 31 degrees: 7e-8 a cell, 2e-5 for 256 cells
# Counts of a cell may be k in all sets where their mean is k + q, with the probability (1 − q)^32:
# less than 7e-8 for q > 0.4. Where they are not alike the spread covers the rest.
_ALIKE = 0.4
_ROUND_TRIP = 1e-6
_INTEGRAL = 1e-4
_LARGEST_BOUND = 0.01
_SLABS = 8
_STEP = 1e-6
_JACOBIAN = 1e-3
_OUTLIERS = 0.02  # of the points may lie next to a jump of the warp


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
        return np.clip(x, 0.0, LARGEST_BELOW_ONE)

    def invert(self, x: object) -> Array:
        """Undo `sample`: primary points u of shape (..., d), in [0,1)."""
        u = self._invert(as_points(x, self.dims, "x"))
        return np.clip(u, 0.0, LARGEST_BELOW_ONE)

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
        """Test that pdf, sample and invert belong together, on a deterministic set of points.

        Raises
        ------
        DensityError
            pdf is negative, not finite or does not integrate to 1; sample leaves [0,1);
            invert(sample(u)) is not u; or samples do not follow the pdf.
        """
        check_density(self)

    @abstractmethod
    def _pdf(self, x: Array) -> Array:
        """Density at float64 points (..., d)."""

    @abstractmethod
    def _sample(self, u: Array) -> Array:
        """Warp float64 points (..., d)."""

    def _invert(self, x: Array) -> Array:  # noqa: ARG002
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
        """Make a density of vectorised callables, and check it.

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
            return _numerical_density(pdf, invert, dims, normalize)
        if normalize:
            raise DensityError(
                "normalize works without sample= only; leave it out and give a pdf with integral 1."
            )
        for name, function in (("pdf", pdf), ("sample", sample), ("invert", invert)):
            if not callable(function) and not (name == "invert" and function is None):
                raise DensityError(f"{name} is {function!r}; give a function of points (..., d).")
        made = FunctionDensity(
            dims=as_integer("dims", dims, least=1, most=_MAX_DIMS),
            pdf_function=pdf,
            sample_function=sample,
            invert_function=invert,
        )
        made._try()
        made.check()
        return made


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class FunctionDensity(Density):
    """Given by functions pdf, sample and (optionally) invert.

    Make it by `Density.from_functions`, which checks it. The functions are called with read-only
    float64 arrays of shape (..., d), with any number of axes in front.
    """

    name: ClassVar[str] = "function"
    dims: int
    pdf_function: Callable[[Any], Any]
    sample_function: Callable[[Any], Any]
    invert_function: Callable[[Any], Any] | None = None

    @property
    def spec(self) -> str:
        """``function``, with the name of the pdf; not a spec that can be read back."""
        return _function_spec(self.pdf_function)

    @property
    def has_inverse(self) -> bool:
        """Whether invert was given."""
        return self.invert_function is not None

    def _try(self) -> None:
        """Call all functions on few points, with one and with two axes in front."""
        for shape in [(_PROBE, self.dims), (_PROBE, 2, self.dims)]:
            u = np.linspace(0.2, 0.8, int(np.prod(shape))).reshape(shape)
            self._pdf(u)
            x = self._sample(u)
            if self.has_inverse:
                self._invert(np.clip(x, 0.0, np.nextafter(1.0, 0.0)))

    def _pdf(self, x: Array) -> Array:
        return _called("pdf", self.spec, self.pdf_function, x, x.shape[:-1])

    def _sample(self, u: Array) -> Array:
        return _called("sample", self.spec, self.sample_function, u, u.shape)

    def _invert(self, x: Array) -> Array:
        if self.invert_function is None:
            raise DensityError(
                f"The density {self.spec} was given without an inverse; give invert=."
            )
        return _called("invert", self.spec, self.invert_function, x, x.shape)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class NumericalDensity(Density):
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
        The pdf does not integrate to 1 (to 1e-9) and is not to be normalised; is negative, not
        finite within (0,1)^d, or too rough or steep: in 2-D with jumps or kinks along lines that
        are not axis-parallel, in 1-D with poles anywhere but at 0, next to which floats are dense.
    """

    name: ClassVar[str] = "function"
    dims: int = 1
    pdf_function: Callable[[Any], Any]
    normalize: bool = False

    def __post_init__(self) -> None:
        store_integer(self, "dims", least=1, most=2)
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
    def spec(self) -> str:
        """``function``, with the name of the pdf; not a spec that can be read back."""
        return _function_spec(self.pdf_function)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """The cdf at jumps and kinks; in 2-D on axis 1 only, those of axis 0 depend on the row."""
        return self._warp.breaks

    def zero_points(self) -> Array:
        """Centres of cells in which the pdf is 0; in 2-D of those of the marginal."""
        return self._warp.zero_points()

    @cached_property
    def _warp(self) -> NumericalWarp:
        return NumericalWarp(self._raw, self.dims, self.spec)

    def _raw(self, x: Array) -> Array:
        """What the pdf gives: poles and all."""
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            return _called("pdf", self.spec, self.pdf_function, x, x.shape[:-1])

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
    if points.size and not (points.min() >= 0.0 and points.max() <= 1.0):
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


def store_integer(component: object, name: str, *, least: int, most: int | None = None) -> None:
    """Check a field of a frozen dataclass, and store it as an int: 2.0 is read as 2."""
    value = as_integer(name, getattr(component, name), least=least, most=most)
    object.__setattr__(component, name, value)


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
    if (logarithm >= LARGEST_LOGARITHM).any():
        raise DensityError(
            f"The pdf of {spec} reaches exp({logarithm.max():.6g}), more than a float can hold "
            f"(exp({LARGEST_LOGARITHM:.0f})); use fewer dims or a wider density."
        )
    return np.asarray(np.exp(logarithm))


def divide_by_density(
    values: Array, pdf: Array, x: Array, spec: str, *, constant: bool = False
) -> Array:
    """Return values/pdf, 0 where both vanish; values (...) or (..., channels).

    Samples lie where pdf is 0 when that is a face or a line and the points are not randomised: the
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
            "if the density is 0 on a line or a face only, randomise the sampler (for instance with "
            "'| shift'); else choose a density that is positive wherever f is not 0."
        )
    warn(
        f"f and the density of {spec} are both 0 at the sample {point_in_words(x[zero][0])}: f/p "
        "counts as 0 there, whatever its limit; randomise the sampler (for instance with "
        "'| shift').",
        UndefinedRatioWarning,
    )
    return np.asarray(values / np.where(scaled > 0, scaled, 1.0))


def _numerical_density(
    pdf: Callable[[Any], Any], invert: object, dims: int, normalize: bool
) -> NumericalDensity:
    """Check what `Density.from_functions` was given without sample, and make the density."""
    if not callable(pdf):
        raise DensityError(f"pdf is {pdf!r}; give a function of points (..., d).")
    if invert is not None:
        raise DensityError("invert was given without sample; give both, or neither.")
    if not isinstance(normalize, bool):
        raise DensityError(f"normalize is {normalize!r}; give True or False.")
    if as_integer("dims", dims, least=1) > 2:
        raise DensityError(
            f"sample is None in {dims} dims; a pdf alone is enough in 1-D and 2-D only: give sample=, "
            "or a product of densities."
        )
    return NumericalDensity(dims=int(dims), pdf_function=pdf, normalize=normalize)


def _function_spec(pdf: Callable[[Any], Any]) -> str:
    """``function``, with the name of the pdf where it has one."""
    called = getattr(pdf, "__name__", "")
    return f"function({called})" if called.isidentifier() else "function"


def _called(
    name: str, spec: str, function: Callable[[Any], Any], points: Array, shape: tuple[int, ...]
) -> Array:
    """Call `function` of the density `spec` and check that it gave numbers of `shape`."""
    shown = points.view()
    shown.setflags(write=False)
    try:
        given = np.asarray(function(shown))
    except Exception as error:
        raise DensityError(
            f"The {name} of {spec} failed on points of shape {points.shape}: "
            f"{type(error).__name__}: {error}"
        ) from error
    if given.dtype.kind not in "fiub":
        raise DensityError(f"The {name} of {spec} gave {given.dtype}, not real numbers.")
    if given.shape != shape:
        raise DensityError(
            f"The {name} of {spec} gave shape {given.shape} for points of shape "
            f"{points.shape}; it must give {shape}.{_shape_advice(name, given.shape, shape)}"
        )
    return np.asarray(given, np.float64)


def _shape_advice(name: str, given: tuple[int, ...], wanted: tuple[int, ...]) -> str:
    if name == "pdf" and given == (*wanted, 1):
        return " Write x[..., 0] in place of x."
    return ""


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

    def reciprocal(x: Array) -> Array:
        with np.errstate(divide="ignore", over="ignore"):
            return np.asarray(1.0 / density._pdf(x))

    return mean_or_infinity(reciprocal, density.dims)


def check_density(density: Density) -> None:
    """Test that pdf, sample and invert belong together.

    Parameters
    ----------
    density
        Any density.

    Raises
    ------
    DensityError
        The message names the error and, where possible, the function at fault.

    Notes
    -----
    * pdf is finite and not negative on 4096 points, and its integral is 1 to 1e-4.
    * sample stays in [0,1]; invert(sample(u)) = u to 1e-6, plus what rounding of x can do to u.
    * Samples follow the pdf. In 1-D and 2-D: the share of 32 shifted sets of 4096 points that fall
      into each of 64 (16 × 16) cells, and of the cells of 2, 4, … times the edge, is compared with
      the integral of the pdf over the cell; the bound is 7 standard errors, 0.4/4096 for counts
      that are alike in all sets, and the quadrature's error. So in 1-D a mass of 1/2 that is
      0.1 % wrong is found, one of 1/64 that is 2 % wrong; errors within a cell are not.
      In 3-D and more, where cells say little: |det ∂T/∂u| · p(T(u)) = 1, by central differences,
      at 98 % of 512 points (the others may lie next to a jump). Where the warp is not one-to-one
      (`Density.one_to_one`): the share of the sets in each of 8 slabs of every axis against the
      mean of the pdf over that slab, from the same points; that sees marginals only.

    A density with errors smaller than those bounds passes. Peaks narrower than 2^-20 (2^-12 in 2-D)
    of the domain are not resolved.
    """
    with np.errstate(all="ignore"):  # what is not finite is reported below, or allowed at one point
        _check(density)


def _check(density: Density) -> None:
    _check_values(density)
    u = recurrences(density.primary_dims)
    u[0, 0] = 0.0
    u[0, 1] = LARGEST_BELOW_ONE
    x = _samples(density, u)
    loop = _round_trip(density, u[0], x[0])
    problem = _sampling_problem(density, u, x)
    if problem:
        blame = (
            ""
            if loop is None or not density.has_inverse
            else " (invert does not undo sample either)"
        )
        if loop is None and density.has_inverse:
            blame = "; sample and invert agree, so the pdf is wrong"
        raise DensityError(f"{problem}{blame}.")
    if loop:
        raise DensityError(f"{loop}; sample and pdf agree, so invert is wrong.")


def _sampling_problem(density: Density, u: Array, x: Array) -> str | None:
    """A sentence where samples x of u do not follow the pdf, by the check that fits, else None."""
    if density.dims <= 2:
        return _mass_problem(density, x)
    return _jacobian_problem(density, u[0]) if density.one_to_one else _slab_problem(density, x)


def _check_values(density: Density) -> None:
    x = recurrences(density.dims)[0]
    p = density._pdf(x)
    for bad, what in ((~np.isfinite(p), "not finite"), (p < 0, "negative")):
        if bad.any():
            raise DensityError(
                f"The pdf of {density.spec} is {what} ({p[bad][0]:.6g}) at {point_in_words(x[bad][0])}; "
                "a density is finite and at least 0 almost everywhere."
            )


def _samples(density: Density, u: Array) -> Array:
    x = density._sample(u)
    outside = ~((x >= 0.0) & (x <= 1.0)).all(axis=-1)
    if outside.any():
        raise DensityError(
            f"The samples of {density.spec} leave [0,1): {point_in_words(x[outside][0])} from u = "
            f"{point_in_words(u[outside][0])}."
        )
    return np.minimum(x, LARGEST_BELOW_ONE)


def _round_trip(density: Density, u: Array, x: Array) -> str | None:
    """A sentence where invert(sample(u)) is not u, else None."""
    if not density.has_inverse:
        return None
    back = density._invert(x)
    # du = p dx in 1-D: x is known to 1e-16, near a peak u is not
    allowed = _ROUND_TRIP + 1e-15 * density._pdf(x)
    off = ~(np.abs(back - u).max(axis=-1) <= allowed)
    if np.count_nonzero(off) <= _OUTLIERS * len(u):
        return None
    k = int(np.flatnonzero(off)[0])
    return (
        f"invert does not undo sample in {density.spec}: invert(sample(u)) is {point_in_words(back[k])} "
        f"at u = {point_in_words(u[k])}"
    )


def _mass_problem(density: Density, x: Array) -> str | None:
    """A sentence where masses of cells by pdf and by samples differ, else None."""
    dims = density.dims
    side = CELLS[dims]
    pdf = integrate(density._pdf, dims, cells=side, points=x[0, :: 4 ** (dims - 1)])
    total = pdf.limit if pdf.isolated else pdf.totals[-1]
    if not abs(total - 1.0) <= _INTEGRAL + float(pdf.bounds.sum()) and not _integrates(density):
        return f"The pdf of {density.spec} integrates to {total:.6g} over the unit domain, not to 1"
    shares = np.stack([_shares(points, side) for points in x])
    masses, errors = pdf.cells, pdf.bounds
    while side > 1:
        mean, spread = shares.mean(axis=0), shares.std(axis=0, ddof=1) / math.sqrt(SETS)
        allowed = _SPREADS * spread + _ALIKE / SET_SIZE + errors
        gap = np.abs(mean - masses)
        worst = int(np.argmax(gap / allowed))
        if gap[worst] > allowed[worst]:
            low = np.array(np.unravel_index(worst, (side,) * dims)) / side
            return (
                f"The samples of {density.spec} do not follow its pdf: {mean[worst]:.6g} of them "
                f"fall between {point_in_words(low)} and {point_in_words(low + 1 / side)}, where the pdf has the mass "
                f"{masses[worst]:.6g}"
            )
        shares, masses, errors = (_doubled(a, side, dims) for a in (shares, masses, errors))
        side //= 2
    return None


def _doubled(cells: Array, side: int, dims: int) -> Array:
    """Sums over cells of twice the edge: (..., side^d) to (..., (side/2)^d)."""
    grid = cells.reshape(*cells.shape[:-1], *(side // 2, 2) * dims)
    sums = grid.sum(axis=tuple(range(-1, -2 * dims, -2)))
    return np.asarray(sums.reshape(*cells.shape[:-1], -1))


def _slab_problem(density: Density, x: Array) -> str | None:
    """A sentence where shares of samples and of the pdf in slabs of an axis differ, else None."""
    y = recurrences(density.dims)
    p = density._pdf(y)
    for axis in range(density.dims):
        edge = np.arange(_SLABS)[:, None, None]
        by_samples = (np.floor(x[..., axis] * _SLABS) == edge).mean(axis=-1)
        by_pdf = (p * (np.floor(y[..., axis] * _SLABS) == edge)).mean(axis=-1)
        gap = by_samples - by_pdf
        spread = gap.std(axis=1, ddof=1) / math.sqrt(SETS)
        off = np.abs(gap.mean(axis=1)) > _SPREADS * spread + _ALIKE / SET_SIZE
        if off.any():
            k = int(np.flatnonzero(off)[0])
            return (
                f"The samples of {density.spec} do not follow its pdf: "
                f"{by_samples[k].mean():.6g} of them have x_{axis} from {k / _SLABS:g} to "
                f"{(k + 1) / _SLABS:g}, where the pdf has the mass {by_pdf[k].mean():.6g}"
            )
    return None


def _integrates(density: Density) -> bool:
    """Whether the mean of p over low-discrepancy points is 1: for p with jumps at a thousand places."""
    means = density._pdf(recurrences(density.dims)).mean(axis=1)
    bound = _SPREADS * float(means.std(ddof=1)) / math.sqrt(SETS)
    return abs(float(means.mean()) - 1.0) <= min(bound, _LARGEST_BOUND)


def _shares(points: Array, side: int) -> Array:
    """Share of points (n, d) in each of side^d cells, row-major."""
    cell = np.minimum((points * side).astype(np.int64), side - 1)
    index = cell @ side ** np.arange(points.shape[-1])[::-1]
    return np.bincount(index, minlength=side ** points.shape[-1]) / len(points)


def _jacobian_problem(density: Density, u: Array) -> str | None:
    """A sentence where |det ∂T/∂u| p(T(u)) is not 1, or the pdf holds more than 1, else None."""
    u = np.clip(u[2:514], 2 * _STEP, 1.0 - 2 * _STEP)
    steps = _STEP * np.eye(density.dims)
    ahead, behind = (density._sample(u[:, None, :] + s * steps) for s in (1.0, -1.0))
    volume = np.abs(np.linalg.det((ahead - behind) / (2 * _STEP)))
    product = volume * density._pdf(density._sample(u))
    off = ~(np.abs(product - 1.0) <= _JACOBIAN)
    if np.count_nonzero(off) > _OUTLIERS * len(u):
        return (
            f"The samples of {density.spec} do not follow its pdf: pdf × |det ∂sample/∂u| is "
            f"{np.median(product[off]):.6g} at u = {point_in_words(u[off][0])}, not 1"
        )
    means = density._pdf(recurrences(density.dims)).mean(axis=1)
    bound = 1.0 + _JACOBIAN + _SPREADS * float(means.std(ddof=1)) / math.sqrt(SETS)
    if means.mean() > bound:
        return f"The pdf of {density.spec} integrates to {means.mean():.6g}, where samples cover 1"
    return None
