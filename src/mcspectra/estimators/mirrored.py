"""Mirrored estimators: the primary-space integrand is reflected, then folded or averaged.

The integrand f is reflected at the upper faces of the cube. This gives a function g of period 2:
for k ∈ {0,1}^d, g(k + x) = f(x with the coordinates reflected where k_j = 1).
The function g is continuous if f is.
There are two ways to make a function of period 1 from g.
Stretching the argument gives g(2u) = f(1 − |2u − 1|).
Averaging over the mirror images gives 2^-d Σ_k g(k + u).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.estimators.base import AbstractEstimator
from mcspectra.estimators.importance import as_estimator
from mcspectra.integrands import Integrand
from mcspectra.integrands.base import Breaks, Derived
from mcspectra.samplers import Mirror, Sampler
from mcspectra.samplers.randomizations import folded

__all__ = ["MIRRORINGS", "FoldedIntegrand", "Mirrored", "SymmetrizedIntegrand"]

MIRRORINGS = ("integrand", "random", "uniform")
_MOST_DIMS = 12  # An average over all reflections takes 2^d values of f


@final
class Mirrored(AbstractEstimator):
    """Estimator that mirrors another estimator's primary-space integrand, with the same integral.

    Parameters
    ----------
    estimator
        The estimator to mirror, with any number of techniques. An integrand or its spec also works.
    mode
        ``"integrand"`` spreads the sampler's points u over the 2^d mirror images, at 2u.
        The point 2u is then folded back into the cube, to 1 − |2u − 1|.
        ``"random"`` reflects each coordinate of each point with probability ½.
        ``"uniform"`` puts n/2^d points into each of the 2^d images.
    dims
        Number of dims; needed for spec strings without ``dims``.

    Raises
    ------
    ParameterError
        If the mode is unknown, if `estimator` is not an estimator, or if it has other dims.

    Notes
    -----
    In all modes, n is the number of evaluations, so variances at equal n have equal cost.
    `samples_per_point` is the number of evaluations for each point of the sampler.
    In d dims, a mirrored estimator spreads its n evaluations over a larger domain.
    In the mode ``"integrand"``, the points of the sampler cover 2^d mirror images of the cube.
    In the domain of f, each stratum is therefore twice as long as without mirroring.
    In the mode ``"uniform"`` there are only n/2^d points.

    The mirrored integrand has period 2. If f is continuous on the closed cube,
    the mirrored integrand is continuous across all faces.

    A shift in the sampler is applied before mirroring, in the doubled domain:
    in the mode ``"integrand"``, a point u + δ becomes 2u + 2δ.
    In the other modes, ``"random"`` and ``"uniform"``, a point u has mirror images k + u.
    The shift moves each image k + u to k + u + δ modulo 2.
    Shifted images have the same distribution as the images of u + δ modulo 1.
    Therefore shifted points do not meet a jump of the integrand at the border of the cube.

    A mirrored estimator with the sampler ``S`` has the same values as the inner estimator
    with the sampler ``S | mirror(mode=...)``. Use ``'fold'`` for the mode ``"integrand"``.
    In contrast, ``S | mirror(...) | shift`` shifts the points after folding.
    A shift after folding moves points across the jump between f(1) and f(0).

    In ``"random"`` mode the reflections are independent, and cause a part of the variance.
    The reflections add the variance of f over the images of a point, divided by n.
    The variance due to reflections falls as 1/n for every sampler.

    References
    ----------
    The modes are our interpretation of the talk [Singh2019]_, which names and illustrates them.
    Folding is the baker's transform of [Hickernell2002]_.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> plain = mcs.Estimator("linear", dims=1)
    >>> mirrored = mcs.Mirrored(plain)
    >>> print(f"{mcs.exact_variance(plain, 'jittered | shift', 64):.2e}")
    4.04e-05
    >>> print(f"{mcs.exact_variance(mirrored, 'jittered | shift', 64):.2e}")
    1.26e-06
    """

    def __init__(
        self,
        estimator: AbstractEstimator | Integrand | str,
        mode: str = "integrand",
        *,
        dims: int | None = None,
    ) -> None:
        self.estimator = as_estimator(estimator, dims)
        self.mode = as_choice("mode", mode, MIRRORINGS)
        self.counts, self.sets = self.estimator.counts, self.estimator.sets

    @property
    def spec(self) -> str:
        """Text of the form ``estimator, mirrored: mode``."""
        return f"{self.estimator.spec}, mirrored: {self.mode}"

    @property
    def samples_per_point(self) -> int:
        """Number of evaluations for each point of the sampler: 2^d for ``"uniform"``, else 1."""
        return 1 << self.dims if self.mode == "uniform" else 1

    @property
    def integral(self) -> Any:
        return self.estimator.integral

    @property
    def integral_source(self) -> str:
        return self.estimator.integral_source

    @property
    def integral_error(self) -> float:
        return self.estimator.integral_error

    @property
    def domain_integrand(self) -> Integrand | None:
        """The integrand f. It is evaluated at points that are folded and then warped."""
        return self.estimator.domain_integrand

    @property
    def pilot_evaluations(self) -> int:
        return self.estimator.pilot_evaluations

    @property
    def infinite_weights(self) -> bool:
        return self.estimator.infinite_weights

    def randomized(self, sampler: Sampler) -> Sampler:
        """Return the sampler, followed by random reflections if the mode reflects points."""
        source = self.estimator.randomized(sampler)
        return source if self.mode == "integrand" else source.then(Mirror(mode=self.mode))

    def check_sampler(self, sampler: Sampler, n: int) -> None:
        """Raise an error unless the inner estimator accepts the sampler with its reflections."""
        self.estimator.check_sampler(self.randomized(sampler), n)

    def draw(self, sampler: Sampler, n: int, stream: Stream, first: int, count: int) -> list[Array]:
        """Draw n_t points of each technique from the inner estimator, and reflect them."""
        return self.estimator.draw(self.randomized(sampler), n, stream, first, count)

    def _primary(self, technique: int) -> Integrand:
        """Return g_t of the inner estimator, folded in the mode ``"integrand"``."""
        g = self.estimator.primary_integrand(technique)
        return FoldedIntegrand(g) if self.mode == "integrand" else g

    def primary_values(self, technique: int, u: Array) -> Array:
        """Return g_t at the folded points, or at points that the sampler has reflected."""
        return self.estimator.primary_values(technique, self._inside(u))

    def warp(self, technique: int, u: Array) -> Array:
        """Return domain points T_t(u) of folded u, or of points that the sampler has reflected."""
        return self.estimator.warp(technique, self._inside(u))

    def weight(self, technique: int, x: Array) -> Array:
        return self.estimator.weight(technique, x)

    def _inside(self, u: Array) -> Array:
        return folded(u) if self.mode == "integrand" else u


@final
@dataclass(frozen=True)
class FoldedIntegrand(Derived):
    """f(1 − |2u − 1|), folded in every coordinate: periodic, and continuous if f is continuous."""

    name: ClassVar[str] = "folded"
    text = "folded {0.integrand.spec}"
    integrand: Integrand

    @property
    def breaks(self) -> Breaks:
        """Breaks of the folded function by axis: b/2 and 1 − b/2 for each break b of f, and ½."""
        return tuple(
            tuple(sorted({0.5, *(0.5 * b for b in axis), *(1.0 - 0.5 * b for b in axis)}))
            for axis in self.integrand.breaks
        )

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array] | None:
        """Return box moments: on each axis, the fold at ½ divides a box into two parts."""
        mean: Any = 0.0
        square: Any = 0.0
        for sides in itertools.product((False, True), repeat=self.dims):
            # Fold the part of each box above or below ½, and compute its share of the volume
            above = np.array(sides)
            low = np.where(above, 1.0 - np.clip(hi, 0.5, 1.0), np.clip(lo, 0.0, 0.5))
            high = np.where(above, 1.0 - np.clip(lo, 0.5, 1.0), np.clip(hi, 0.0, 0.5))
            share = ((high - low) / (hi - lo)).prod(axis=-1)
            share = share[..., None] if self.channels else share
            empty = ~(high > low)  # The part has no volume, so its share is 0
            found = self.integrand.box_moments(
                np.where(empty, 0.0, 2.0 * low), np.where(empty, 1.0, 2.0 * high)
            )
            if found is None:
                return None
            mean, square = mean + share * found[0], square + share * found[1]
        return mean, square

    def _evaluate(self, x: Array) -> Array:
        # At x = 1, which no sample reaches, rounding gives −2^-53 instead of 0 after folding
        return self.integrand(np.maximum(folded(x), 0.0))


@final
@dataclass(frozen=True)
class SymmetrizedIntegrand(Derived):
    """2^-d Σ f(u reflected), the average of f over all reflections: periodic and continuous."""

    name: ClassVar[str] = "symmetrized"
    text = "symmetrized {0.integrand.spec}"
    integrand: Integrand

    def _check(self) -> None:
        if self.dims > _MOST_DIMS:
            raise ParameterError(
                f"The average of {self.integrand.spec} over reflections takes 2^{self.dims} of "
                f"its values; use at most {_MOST_DIMS} dims."
            )

    @property
    def breaks(self) -> Breaks:
        return tuple(
            tuple(sorted({*axis, *(1.0 - b for b in axis)})) for axis in self.integrand.breaks
        )

    def _evaluate(self, x: Array) -> Array:
        total: Any = 0.0
        for reflected in itertools.product((False, True), repeat=self.dims):
            total = total + self.integrand(np.where(reflected, 1.0 - x, x))
        return np.asarray(total / 2.0**self.dims)

    def _fourier(self, m: Array) -> Array | None:
        total: Any = 0.0
        for signs in itertools.product((1.0, -1.0), repeat=self.dims):
            found = self.integrand._fourier(m * np.array(signs))
            if found is None:
                return None
            total = total + found
        return np.asarray(total / 2.0**self.dims)
