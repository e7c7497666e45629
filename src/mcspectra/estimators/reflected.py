"""Folded and symmetrised integrands: mirroring turns a primary-space integrand into one of them.

With f reflected at its upper faces, g(k + x) = f(x reflected in the coordinates with k_j = 1) for
k ∈ {0,1}^d is continuous and of period 2. The two ways of having period 1 again are to stretch,
f(1 − |2u − 1|) = g(2u), and to average over the images, 2^-d Σ_k g(k + u).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.integrands.base import Breaks, Derived, Integrand
from mcspectra.samplers.randomizations import folded

__all__ = ["FoldedIntegrand", "SymmetrizedIntegrand"]

_MOST_DIMS = 12  # 2^d values of the integrand for one of its average over reflections


@final
@dataclass(frozen=True)
class FoldedIntegrand(Derived):
    """f(1 − |2u − 1|), every coordinate folded: continuous on the torus where f is on the cube."""

    name: ClassVar[str] = "folded"
    text = "folded {0.integrand.spec}"
    integrand: Integrand

    @property
    def breaks(self) -> Breaks:
        """Both images of each break of f, and the fold."""
        return tuple(
            tuple(sorted({0.5, *(0.5 * b for b in axis), *(1.0 - 0.5 * b for b in axis)}))
            for axis in self.integrand.breaks
        )

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array] | None:
        """Means over the parts of each box on either side of the folds, by those of f."""
        mean: Any = 0.0
        square: Any = 0.0
        for sides in itertools.product((False, True), repeat=self.dims):
            # The image under folding of the part above (or below) ½, and its share of each box
            above = np.array(sides)
            low = np.where(above, 1.0 - np.clip(hi, 0.5, 1.0), np.clip(lo, 0.0, 0.5))
            high = np.where(above, 1.0 - np.clip(lo, 0.5, 1.0), np.clip(hi, 0.0, 0.5))
            share = ((high - low) / (hi - lo)).prod(axis=-1)
            share = share[..., None] if self.channels else share
            empty = ~(high > low)  # has no mean: any box will do, its share is 0
            found = self.integrand.box_moments(
                np.where(empty, 0.0, 2.0 * low), np.where(empty, 1.0, 2.0 * high)
            )
            if found is None:
                return None
            mean, square = mean + share * found[0], square + share * found[1]
        return mean, square

    def _evaluate(self, x: Array) -> Array:
        return self.integrand(np.maximum(folded(x), 0.0))  # at 1, which no sample is, −2^-53


@final
@dataclass(frozen=True)
class SymmetrizedIntegrand(Derived):
    """2^-d Σ f(u reflected), the average over all reflections: of period 1 and continuous."""

    name: ClassVar[str] = "symmetrized"
    text = "symmetrised {0.integrand.spec}"
    integrand: Integrand

    def _check(self) -> None:
        if self.dims > _MOST_DIMS:
            raise ParameterError(
                f"The average of {self.integrand.spec} over reflections takes 2^{self.dims} of its "
                f"values; use at most {_MOST_DIMS} dims."
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
