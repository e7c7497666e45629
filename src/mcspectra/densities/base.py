"""The interface of importance densities, on one screen: pdf, sample, invert.

A `Density` is a warp T from the unit cube (primary space, u) to itself (domain, x) together with
its density: ``x = sample(u)``, ``u = invert(x)``, ``pdf(x) = |det dT/du|^-1``. Implementations
write `_pdf`, `_sample` and `_invert` on plain arrays; the checks are here.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real_array
from mcspectra.core.errors import (
    DensityError,
    DomainError,
    UndefinedRatioWarning,
    point_in_words,
)
from mcspectra.core.spec import Component

__all__ = [
    "Density",
    "as_points",
    "bounded_product",
    "divide_by_density",
    "exponential",
    "plain",
    "store_integer",
]

LARGEST_BELOW_ONE = float(np.nextafter(1.0, 0.0))
LARGEST_LOGARITHM = float(np.log(np.finfo(float).max))


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
        """Number of dims of u: those of x, or more where further coordinates choose something."""
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
        from mcspectra.densities.numeric import reciprocal_integral

        return reciprocal_integral(self)

    def check(self) -> None:
        """Test that pdf, sample and invert belong together, on a deterministic set of points.

        Raises
        ------
        DensityError
            pdf is negative, not finite or does not integrate to 1; sample leaves [0,1);
            invert(sample(u)) is not u; or samples do not follow the pdf.
        """
        from mcspectra.densities.numeric import check_density

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
        """Make a density of vectorised callables: pdf (..., d) -> (...), the others keep the shape.

        Without `sample`, in 1-D and 2-D, the warp is computed from the pdf, which `normalize` may
        divide by its integral (see `mcspectra.densities.NumericalDensity`).

        Raises
        ------
        DensityError
            The functions do not belong together (see `check`), or the pdf alone is not enough.
        """
        from mcspectra.densities.functions import function_density

        if sample is None:
            from mcspectra.densities.numerical import numerical_density

            return numerical_density(pdf=pdf, invert=invert, dims=dims, normalize=normalize)
        if normalize:
            raise DensityError(
                "normalize is for a pdf alone; with sample= the pdf integrates to 1."
            )
        return function_density(pdf=pdf, sample=sample, invert=invert, dims=dims)


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
        What messages call the estimator.
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
        what = "so that its weight is infinite" if constant else "where f is not"
        raise DensityError(
            f"The density of {spec} is 0 at the sample {point_in_words(x[bad][0])}, {what}; "
            "randomise the sampler (such as '| shift') if that is so on a line or a face only, else "
            "choose a density that is positive wherever f is not 0."
        )
    warnings.warn(
        f"f and the density of {spec} are both 0 at the sample {point_in_words(x[zero][0])}: f/p "
        "counts as 0 there, whatever its limit; randomise the sampler (such as '| shift').",
        UndefinedRatioWarning,
        stacklevel=3,
    )
    return np.asarray(values / np.where(scaled > 0, scaled, 1.0))
