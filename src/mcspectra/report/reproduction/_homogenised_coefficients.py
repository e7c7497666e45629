"""Coefficients S_m of several samplers before and after a shift, at pairs of frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.reproduction._limits import normal_limit
from mcspectra.report.reproduction.base import Interval, normal_interval

__all__ = [
    "PAIRS",
    "SAMPLERS",
    "Coefficients",
    "before_and_after",
    "farthest_correlation",
    "mean_at",
]

SAMPLERS = ("jittered", "latin-hypercube", "poisson-disk", "sobol | owen")
# Differences m − l are multiples of the strata's frequency, 8 for 64 points, where jitter correlates.
PAIRS = (
    ((3, 0), (-5, 0)),
    ((0, 3), (0, -5)),
    ((3, 1), (-5, 1)),
    ((1, 1), (1, -7)),
    ((2, 5), (-6, -3)),
    ((1, 0), (0, 1)),
)


@final
@dataclass(frozen=True)
class Coefficients:
    """S_m and S_l of all pairs, (R, pairs, 2)."""

    values: Array

    def power(self) -> Array:
        """|S|² of all realisations."""
        return np.asarray(np.abs(self.values) ** 2)

    def of_pair(self, k: int) -> tuple[Array, Array]:
        """S_m and S_l of one pair, (R,) each."""
        return self.values[:, k, 0], self.values[:, k, 1]

    def products(self) -> Array:
        """(S_m − mean) conj(S_l − mean), (R, pairs): their mean is the covariance."""
        away = self.values - self.values.mean(axis=0)
        return np.asarray(away[..., 0] * away[..., 1].conj())

    def covariance(self) -> Array:
        """Cov(S_m, S_l), (pairs,)."""
        count = len(self.values)
        return np.asarray(self.products().sum(axis=0) / (count - 1))

    def real_part(self, k: int) -> tuple[float, Interval]:
        """Re Cov(S_m, S_l) of a pair with its 95 % interval."""
        value = float(self.covariance()[k].real)
        return value, normal_interval(value, float(_errors(self.products().real)[k]))


def _errors(products: Array) -> Array:
    return np.asarray(products.std(axis=0, ddof=1) / len(products) ** 0.5)


def before_and_after(
    name: str, n: int, realizations: int, seed: int
) -> tuple[Coefficients, Coefficients]:
    """Return the coefficients of a sampler's points, and of the same points shifted."""
    from mcspectra.samplers.registry import sampler

    m = np.array(PAIRS)
    plain, shifted = (
        np.moveaxis(_sums(sampler(spec, 2).draw(n, realizations=realizations, rng=seed), m), -1, 0)
        for spec in (name, f"{name} | shift")
    )
    return Coefficients(plain), Coefficients(shifted)


def _sums(x: Array, m: Array) -> Array:
    """S_m of points (R, n, 2) at frequencies (..., 2): (..., R)."""
    flat = m.reshape(-1, 2)
    found = np.stack([np.exp(-2j * np.pi * (x @ each)).mean(axis=1) for each in flat])
    return found.reshape(*m.shape[:-1], len(x))


def farthest_correlation(c: Coefficients) -> tuple[float, float]:
    """Return the largest covariance in standard errors, and the limit of as many normal errors."""
    products, value = c.products(), c.covariance()
    parts = [
        np.abs(value.real) / _errors(products.real),
        np.abs(value.imag) / _errors(products.imag),
    ]
    return float(np.max(parts)), normal_limit(2 * value.size)


def mean_at(
    name: str, n: int, m: tuple[int, int], realizations: int, seed: int
) -> tuple[float, Interval]:
    """Return the mean of Re S_m with its 95 % interval."""
    from mcspectra.samplers.registry import sampler

    x = sampler(name, 2).draw(n, realizations=realizations, rng=seed)
    values = _sums(x, np.array(m)).real
    return float(values.mean()), normal_interval(float(values.mean()), float(_errors(values)))
