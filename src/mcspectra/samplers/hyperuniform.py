"""Hyperuniform sets: lattices with correlated noise, and points without any low frequencies.

In a hyperuniform set, the power n⟨|S_m|²⟩ goes to 0 as the frequency |m| does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real
from mcspectra.core.errors import ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers import _hyperuniform_kernels, _kernels
from mcspectra.samplers._descent import minimize, random_points, wrap
from mcspectra.samplers._shells import half_shells
from mcspectra.samplers.base import Sampler, Structure, check_dims
from mcspectra.samplers.optimised import OptimisedSampler, check_sets
from mcspectra.samplers.stratified import Regular

__all__ = ["PerturbedLattice", "StealthyHyperuniform"]

_GOAL = 1e-22  # sum of all powers that count as zero: rounding leaves 1e-28 each, random points 1
_STARTS = 20


@final
@dataclass(frozen=True, kw_only=True)
class PerturbedLattice(Sampler):
    """Grid of s^d points, moved by a Gaussian random field and a uniform translation; any dims.

    Attributes
    ----------
    width
        Standard deviation of each coordinate's displacement, as a multiple of the spacing 1/s.
    correlation
        β: the power spectrum of the displacements is proportional to |k|^(−β), −2 ≤ β ≤ 2, so
        that the power of the points grows like |m|^(2−β). 0: independent displacements.

    Notes
    -----
    The field is periodic, and made by a fast Fourier transform of white noise. Independent
    displacements have n⟨|S_m|²⟩ = 1 − exp(−4π²|m|²(width/s)²) away from the frequencies of the
    grid, m ≡ 0 modulo s.

    References
    ----------
    Gabrielli, Joyce, Sylos Labini (2002), "Glass-like universe: real-space correlation properties
    of standard cosmological models", doi 10.1103/PhysRevD.65.083523. Gabrielli (2004), "Point
    processes and stochastic displacement fields", doi 10.1103/PhysRevE.70.066131.
    """

    name: ClassVar[str] = "perturbed-lattice"
    structure: ClassVar[Structure] = Structure.TORUS
    dims: int = DEFAULT_DIMS
    width: float = 0.25
    correlation: float = 0.0

    def __post_init__(self) -> None:
        check_dims(self)
        object.__setattr__(self, "width", as_real("width", self.width, least=0.0, most=1e3))
        beta = as_real("correlation", self.correlation, least=-2.0, most=2.0)
        object.__setattr__(self, "correlation", beta)

    @property
    def _grid(self) -> Regular:
        return Regular(dims=self.dims, position="corner")

    def displacement_correlation(self, n: int) -> Array:
        """Correlation of the displacements of two points by their distance on the grid: s^d."""
        sides = self._grid.sides(n)[0]
        if sides == 1 or self.correlation == 0.0:
            return np.asarray(np.arange(n) == 0, float).reshape((sides,) * self.dims)
        return np.asarray(np.fft.ifftn(_gains(sides, self.dims, self.correlation) ** 2).real)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        keys, sides = stream.keys(first, count), self._grid.sides(n)[0]
        offsets = np.empty((count, self.dims))
        _kernels.random_offsets(keys, offsets)
        moves = np.empty((count, n * self.dims))
        _hyperuniform_kernels.fill_normals(keys, self.dims, moves)
        field = moves.reshape(count, n, self.dims)
        if self.correlation != 0.0:
            field = self._correlated(field, sides)
        points = self._grid.draw_stream(n, stream, 0, 1) + field * (self.width / sides)
        return wrap(points + offsets[:, None])

    def _correlated(self, white: Array, sides: int) -> Array:
        """Filter white noise (R, s^d, d): same variance, power proportional to |k|^(−β)."""
        if sides == 1:
            return np.zeros_like(white)  # a field without any frequency but 0
        grid = (sides,) * self.dims
        gains, axes = _gains(sides, self.dims, self.correlation), tuple(range(1, self.dims + 1))
        waves = np.fft.fftn(white.reshape(-1, *grid, self.dims), axes=axes)
        return np.fft.ifftn(waves * gains[..., None], axes=axes).real.reshape(white.shape)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return self._grid._counts_near(n)


@lru_cache(maxsize=2)
def _gains(sides: int, dims: int, beta: float) -> Array:
    """Return |k|^(−β/2) on the grid of frequencies, 0 at k = 0, mean square 1."""
    squares = np.zeros((sides,) * dims)
    for j in range(dims):
        shape = [1] * dims
        shape[j] = sides
        squares += (np.fft.fftfreq(sides, 1.0 / sides) ** 2).reshape(shape)
    squares.flat[0] = np.inf if beta > 0 else 0.0
    gains: Array = squares ** (-beta / 4)
    gains /= np.sqrt(np.mean(gains**2))
    gains.setflags(write=False)
    return gains


@final
@dataclass(frozen=True, kw_only=True)
class StealthyHyperuniform(OptimisedSampler):
    """Disordered points with zero power at the frequencies 0 < |m| ≤ K; any dims.

    Attributes
    ----------
    stealthiness
        χ, the frequencies constrained per degree of freedom, below ½: K is the largest radius
        with at most χ d (n − 1) pairs ±m within. From ½ on (1-D: ⅓) the points crystallise.
    iterations
        Most steps of the descent, before it starts again from other points.
    sets
        Reuse of sets, see `OptimisedSampler`.

    Notes
    -----
    From independent uniform points, limited-memory BFGS takes Σ n|S_m|² over these frequencies
    below 1e-22. Neither start nor sum prefer any place: every point is uniform.

    References
    ----------
    Uche, Stillinger, Torquato (2004), "Constraints on collective density variables: two
    dimensions", doi 10.1103/PhysRevE.70.046122. Torquato, Zhang, Stillinger (2015), "Ensemble
    theory for stealthy hyperuniform disordered ground states", doi 10.1103/PhysRevX.5.021020.
    Morse, Kim, Steinhardt, Torquato (2023), "Generating large disordered stealthy hyperuniform
    systems with ultrahigh accuracy", doi 10.1103/PhysRevResearch.5.033190.
    """

    name: ClassVar[str] = "stealthy-hyperuniform"
    max_dims: ClassVar[int | None] = 64
    max_count: ClassVar[int] = 2**14  # work grows like n²
    dims: int = DEFAULT_DIMS
    stealthiness: float = 0.4
    iterations: int = 10_000

    def __post_init__(self) -> None:
        check_dims(self)
        check_sets(self)
        chi = as_real("stealthiness", self.stealthiness, above=0.0)
        if chi >= 0.5:
            raise ParameterError(
                f"stealthiness is {chi:g}; give less than 0.5: from 0.5 on, all sets are crystals."
            )
        object.__setattr__(self, "stealthiness", chi)
        steps = as_integer("iterations", self.iterations, least=1, most=10**6)
        object.__setattr__(self, "iterations", steps)

    def constrained(self, n: int) -> Array:
        """Return the frequencies without power in sets of `n` points, int64 (K, dims), one of ±m."""
        most = int(self.stealthiness * self.dims * (self.check_count(n) - 1))
        return half_shells(most, self.dims)

    def _optimize(self, n: int, keys: Array, report: Callable[[float], None]) -> Array:
        frequencies = self.constrained(n)
        if not frequencies.size:
            return random_points(keys, n, self.dims)
        starts = random_points(keys, n * _STARTS, self.dims).reshape(_STARTS, n, self.dims)
        power = partial(_power, frequencies)
        for start in starts:
            points = self._descend(power, start, report)
            if power(points)[0] <= 2 * _GOAL:
                return points
        raise ParameterError(
            f"stealthy-hyperuniform found no set of {n} points without low frequencies in "
            f"{_STARTS} starts; lower stealthiness (now {self.stealthiness:g}) or raise iterations "
            f"(now {self.iterations})."
        )

    def _descend(
        self,
        power: Callable[[Array], tuple[float, Array]],
        start: Array,
        report: Callable[[float], None],
    ) -> Array:
        return wrap(
            minimize(
                power,
                start,
                iterations=self.iterations,
                longest=len(start) ** (-1.0 / self.dims) / 4,
                report=report,
                goal=_GOAL,
            )
        )


def _power(frequencies: Array, points: Array) -> tuple[float, Array]:
    """Return the power summed over `frequencies`, and its gradient."""
    gradient, orders = np.empty(points.shape), int(np.abs(frequencies).max()) + 1
    return _hyperuniform_kernels.power_sum(points, frequencies, orders, gradient), gradient
