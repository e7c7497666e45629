"""Test functions of sensitivity analysis, whose Sobol' indices are exact.

Of the ANOVA variances σ²_u of all subsets u of the axes [Sobol2001]_ the first-order index of axis i is
σ²_{i}/σ² and its total index Σ_{u∋i} σ²_u/σ², as `anova_variances` estimates them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.fields import real
from mcspectra.integrands.base import Breaks, Integrand, any_dims, per_axis

__all__ = ["Ishigami", "SobolG"]


@final
@dataclass(frozen=True, kw_only=True)
class Ishigami(Integrand):
    """Ishigami's function, f = sin y_0 + a sin² y_1 + b y_2⁴ sin y_0 with y_i = π(2x_i − 1).

    Its third input acts only together with the first [IshigamiHomma1990]_.

    Parameters
    ----------
    a, b
        Weights of the second and third input.
    """

    dims = 3
    a: float = real(7.0)
    b: float = real(0.1)

    def sobol_indices(self) -> tuple[Array, Array]:
        """First-order and total indices of the axes, (3,) each."""
        first = 0.5 * (1.0 + self.b * math.pi**4 / 5.0) ** 2
        second = self.a**2 / 8.0
        pair = self.b**2 * math.pi**8 * (8.0 / 225.0)
        alone, total = np.array([first, second, 0.0]), np.array([first + pair, second, pair])
        return alone / (first + second + pair), total / (first + second + pair)

    def _evaluate(self, x: Array) -> Array:
        y = np.pi * (2.0 * x - 1.0)
        wave = np.sin(y[..., 0]) * (1.0 + self.b * y[..., 2] ** 4)
        return np.asarray(wave + self.a * np.sin(y[..., 1]) ** 2)

    def _integral(self) -> float:
        return 0.5 * self.a


@final
@dataclass(frozen=True, kw_only=True)
class SobolG(Integrand):
    """Sobol's g-function, f(x) = Π_i (|4 x_i − 2| + a_i)/(1 + a_i).

    Of [SaltelliSobol1995]_.

    Parameters
    ----------
    a
        Unimportance of the axes, ≥ 0: one number for all or one for each; by default 0, 1, 2, ….
    dims
        Number of dims.
    """

    a: float | Sequence[float] | None = per_axis(None, least=0.0)
    dims: int = any_dims()

    @property
    def _a(self) -> Array:
        given = np.arange(float(self.dims)) if self.a is None else np.asarray(self.a)
        return np.broadcast_to(given, (self.dims,))

    @property
    def breaks(self) -> Breaks:
        """The kink in the middle of each axis."""
        return ((0.5,),) * self.dims

    def sobol_indices(self) -> tuple[Array, Array]:
        """First-order and total indices of the axes, (d,) each; σ²_u is Π_{i∈u} 1/(3 (1 + a_i)²)."""
        alone = 1.0 / (3.0 * (1.0 + self._a) ** 2)
        product = (1.0 + alone).prod()
        return alone / (product - 1.0), alone / (1.0 + alone) * product / (product - 1.0)

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(((np.abs(4.0 * x - 2.0) + self._a) / (1.0 + self._a)).prod(axis=-1))

    def _integral(self) -> float:
        return 1.0

    def _fourier(self, m: Array) -> Array:
        odd = m % 2 == 1
        falling = 4.0 / (np.pi * np.where(odd, m, 1.0)) ** 2 / (1.0 + self._a)
        return np.asarray(np.where(m == 0, 1.0, odd * falling).prod(axis=-1), np.complex128)
