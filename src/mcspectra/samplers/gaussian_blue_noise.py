"""Gaussian blue noise: points that repel one another as Gaussians do, on the torus."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.samplers import _gaussian_kernels
from mcspectra.samplers._descent import minimize, random_points, wrap
from mcspectra.samplers.base import check_dims
from mcspectra.samplers.optimised import OptimisedSampler, check_sets

__all__ = ["GaussianBlueNoise"]

_CUTOFF = 6.0  # σ: exp(−18) = 1.5e-8, as small as the kernel's own spectrum at the spacing
_SERIES_END = 6.0  # e^(−½ 6²), of the terms of the Fourier series in many dims
_CELLS = 4  # along a cut-off


@final
@dataclass(frozen=True, kw_only=True)
class GaussianBlueNoise(OptimisedSampler):
    """Points of least energy Σ exp(−|x_i − x_k|²/(2σ²)) on the torus; any dims, any count.

    Attributes
    ----------
    sigma
        σ as a multiple of the mean distance n^(−1/d): larger ones empty more of the low
        frequencies and take more iterations.
    iterations
        Most steps of the descent.
    sets
        Reuse of sets, see `OptimisedSampler`.

    Notes
    -----
    The paper descends along the gradient; here the same gradient drives limited-memory BFGS, which
    needs fewer steps. Up to 3 dims pairs are cut off at 6 σ, beyond them all images count through
    the Fourier series of the Gaussian on the torus: work grows like n, or
    like n². The start is random, and the energy does not
    change under translations: hence every point is uniform.

    References
    ----------
    Ahmed, Ren, Wonka (2022), "Gaussian blue noise", doi 10.1145/3550454.3555519.
    """

    name: ClassVar[str] = "gaussian-blue-noise"
    dims: int = DEFAULT_DIMS
    sigma: float = 1.0
    iterations: int = 400

    def __post_init__(self) -> None:
        check_dims(self)
        check_sets(self)
        object.__setattr__(self, "sigma", as_real("sigma", self.sigma, least=0.2, most=2.0))
        count = as_integer("iterations", self.iterations, least=1, most=10**6)
        object.__setattr__(self, "iterations", count)

    def _optimize(self, n: int, keys: Array, report: Callable[[float], None]) -> Array:
        spacing = n ** (-1.0 / self.dims)
        evaluate = _near if self.dims <= 3 else _series
        points = minimize(
            partial(evaluate, self.sigma * spacing),
            random_points(keys, n, self.dims),
            iterations=self.iterations,
            longest=spacing / 4,
            report=report,
        )
        return wrap(points)


def _near(sigma: float, points: Array) -> tuple[float, Array]:
    """Return energy and gradient up to 3 dims, by cells."""
    n, dims = points.shape
    cells, offsets = _neighbours(sigma, dims)
    padded, force = np.zeros((n, 3)), np.empty((n, 3))
    padded[:, :dims] = wrap(points)
    energy = _gaussian_kernels.near_energy(padded, cells, offsets, sigma, force)
    return energy, force[:, :dims].copy()


@lru_cache(maxsize=4)
def _neighbours(sigma: float, dims: int) -> tuple[Array, Array]:
    """Return the cells along each of 3 axes and the steps to neighbours: half of them, 0 first."""
    reach = _CUTOFF * sigma
    side = max(1, min(int(_CELLS / reach), 1024))
    steps = math.ceil(reach * side)
    axes = [range(-steps, steps + 1) if j < dims else range(1) for j in range(3)]
    half = [
        offset
        for offset in itertools.product(*axes)
        if offset >= (0, 0, 0) and _gap(offset) < reach * side
    ]
    return np.array([side] * dims + [1] * (3 - dims)), np.array(half)


def _gap(offset: tuple[int, ...]) -> float:
    """Return the least distance, in cells, between points of two cells so many steps apart."""
    return math.hypot(*(max(abs(step) - 1, 0) for step in offset))


def _series(sigma: float, points: Array) -> tuple[float, Array]:
    """Return energy (divided by its mean) and gradient in any number of dims, by Fourier series."""
    orders = np.arange(1, max(2, math.ceil(_SERIES_END / (2 * math.pi * sigma))) + 1)
    weights = 2.0 * np.exp(-2.0 * (math.pi * sigma * orders) ** 2)
    force = np.empty(points.shape)
    return _gaussian_kernels.series_energy(points, weights, force), force
