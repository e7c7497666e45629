"""Points whose radial mean power follows a target: the loss, its gradient, Hankel transforms.

Units of the mean distance: frequencies ν = |m|/√n and distances r√n, so that targets hold for any n.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.samplers._descent import wrap

__all__ = ["Profile", "RingLoss", "hankel", "piecewise_linear"]

Profile: TypeAlias = Callable[[Array], Array]
"""A function of the distance from 0, 1 far away: power over ν, or pair correlation over r."""

_EPS = 1e-9  # of the non-uniform transforms
_NODES = 48  # of Gauss and Legendre, on each piece: products with J0 up to 2π·4·4 are smooth there


def piecewise_linear(places: Array, values: Array) -> Profile:
    """Return the profile through (places, values), constant before the first and 1 after the last."""

    def profile(x: Array) -> Array:
        return np.asarray(np.interp(x, places, values, right=1.0))

    return profile


def hankel(profile: Profile, places: Array, at: Array) -> Array:
    """Return 1 + 2π ∫ (profile(t) − 1) J0(2π t s) t dt at every s of `at`.

    It turns power into pair correlation and back: both are 1 plus the transform of the other's
    difference from 1. `places` are where the pieces of the profile meet, its end included.
    """
    from scipy.special import j0

    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    ends = np.unique(np.concatenate([[0.0], places]))
    half = np.diff(ends) / 2
    t = (ends[:-1] + half)[:, None] + half[:, None] * nodes
    w = half[:, None] * weights * (profile(t) - 1.0) * t
    waves: Array = j0(2 * np.pi * np.multiply.outer(at, t.ravel()))
    transform: Array = 1.0 + 2 * np.pi * np.sum(waves * w.ravel(), axis=-1)
    return transform


@final
class RingLoss:
    """Squared difference between the mean power of rings of frequencies and a target, in 2-D.

    Ring r holds the frequencies with |m| within ½ of r; the loss is Σ (mean power − target)² over
    rings, the target averaged over the same frequencies. Weighing rings by their frequencies
    instead leaves the lowest ones, which matter most, ten times further from their target.

    Parameters
    ----------
    n
        Number of points.
    target
        n⟨|S_m|²⟩ against |m|/√n.
    reach
        The largest |m|/√n that counts.
    """

    def __init__(self, n: int, target: Profile, reach: float) -> None:
        import finufft

        self.n = n
        most = max(2, round(reach * n**0.5))
        axis = np.arange(-most, most + 1)
        norm = np.hypot(axis[:, None], axis)
        self.axis = axis
        self.ring = np.where(norm < most + 0.5, np.round(norm), 0).astype(np.int64)  # 0: outside
        self.sizes = np.maximum(np.bincount(self.ring.ravel()), 1)
        self.target = self._ring_means(target(norm / n**0.5))
        plans = [(1, -1, 1), (2, 1, 2)]  # type, sign, transforms at once
        self.plans: list[Any] = [
            finufft.Plan(
                kind, (len(axis),) * 2, n_trans=many, eps=_EPS, isign=sign, nthreads=1, showwarn=0
            )
            for kind, sign, many in plans
        ]

    def __call__(self, points: Array) -> tuple[float, Array]:
        """Return the loss and its gradient (n, 2)."""
        angles = 2 * np.pi * wrap(points)
        for plan in self.plans:
            plan.setpts(angles[:, 0].copy(), angles[:, 1].copy())
        sums = self.plans[0].execute(np.ones(self.n, np.complex128))
        excess = self._ring_means(sums.real**2 + sums.imag**2) / self.n - self.target
        excess[0] = 0.0
        pull = (excess / self.sizes)[self.ring] * sums
        waves = np.stack([pull * self.axis[:, None], pull * self.axis])
        slopes = self.plans[1].execute(waves)
        gradient = (-8 * np.pi / self.n) * np.ascontiguousarray(slopes.imag.T)
        return float(np.sum(excess**2)), gradient

    def rings(self, points: Array) -> tuple[Array, Array, Array]:
        """Return mean power, target and number of frequencies of the rings |m| = 1, 2, …"""
        angles = 2 * np.pi * points
        self.plans[0].setpts(angles[:, 0].copy(), angles[:, 1].copy())
        sums = self.plans[0].execute(np.ones(self.n, np.complex128))
        power = self._ring_means(np.abs(sums) ** 2) / self.n
        return power[1:], self.target[1:], self.sizes[1:]

    def _ring_means(self, values: Array) -> Array:
        total: Array = np.bincount(self.ring.ravel(), values.ravel())
        return total / self.sizes
