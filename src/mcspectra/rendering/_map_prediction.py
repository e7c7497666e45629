"""Variance predicted from values of the integrand alone, for many pixels by one table of samples.

*Jittered* points: Var = n⁻² Σ_j Var_j(g) over the strata j, each Var_j = ∫g² − (∫g)² from pairs of
independent samples in the cells of a grid in the stratum. The square of ∫g is the product of the two means, so
that the prediction is unbiased; its standard error comes from two such predictions a stratum.

*Random* points: Var = (∫g² − (∫g)²)/n on a midpoint grid.

Other samplers of two dims: Var = Σ_{m≠0} |g_m|² ⟨|S_m|²⟩, the power term, with g_m from the FFT of
a midpoint grid, onto whose frequencies those beyond are folded. It is exact up to the grid where
the last step of the sampler is a shift; otherwise it lacks the cross term. Grids of half the
resolution give the standard error of both, a power without a closed form adds its own.

None of these sees a light that is so rare that no sample hits it. Where one technique saw more
light than another (`surely`), the other's prediction takes what it missed as a part of its error
(`unmet`).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any, Protocol, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import NoClosedForm
from mcspectra.core.streams import Stream
from mcspectra.estimators.moments import CONFIDENCE_Z
from mcspectra.samplers import Jittered, Random, Sampler

__all__ = ["Prediction", "prediction_for", "surely", "unmet"]

_REPEATS = 2  # predictions a stratum, for their standard error
_CELLS = 4096  # of all strata, about, to meet small lights; each has 2 or more along each axis
_GRIDS = {2: 64, 3: 16}  # dims to midpoints along each axis, an even number
_POWER_REALIZATIONS = 1024
_SURE = 3.0  # standard errors


class Prediction(Protocol):
    """How the variance of `n` points of a sampler is predicted."""

    @property
    def method(self) -> str:
        """Name: strata, random or spectrum."""

    @property
    def count(self) -> int:
        """Number n of points of the sampler."""

    @property
    def samples(self) -> Array:
        """Points at which the integrand is needed, (N, dims)."""

    def variance(self, values: Array) -> tuple[Array, Array]:
        """Variance and its standard error (P,) from values (N, P) at the samples."""

    def mean(self, values: Array) -> tuple[Array, Array]:
        """Integral and its standard error (P,) from values (N, P) at the samples."""


def surely(prediction: Prediction, values: Array) -> Array:
    """Lower bound (P,) of the integral of values (N, P): three standard errors below its estimate."""
    mean, se = prediction.mean(values)
    return mean - _SURE * se


def unmet(prediction: Prediction, values: Array, there: Array) -> Array:
    """Error (P,) of a variance predicted from values (N, P) whose integral is `there` at least.

    A part M of the integral on a share q of the cube has the variance M²/(q n), however the n points
    are stratified, as they meet it rarely; if none of N samples met it, q is about 1/N at most. Where
    M is beyond what the values' own error explains, q may be anything: the error is infinite.
    """
    mean, se = prediction.mean(values)
    missed = np.maximum(there - mean, 0.0)
    error = len(prediction.samples) * missed**2 / prediction.count
    return np.where(missed > _SURE * se, np.inf, error)


def prediction_for(sampler: Sampler, n: int, stream: Stream) -> Prediction | None:
    """Return how to predict the variance of `n` points; None where it is not known."""
    if isinstance(sampler, Jittered):
        return _Strata.of(sampler.sides(n), stream)
    if isinstance(sampler, Random):
        return _Grid(method="random", count=n, samples=_midpoints(sampler.dims))
    if sampler.dims != 2:
        return None
    power, se = _grid_power(sampler, n, stream)
    return _Grid(method="spectrum", count=n, samples=_midpoints(2), power=power, power_se=se)


@final
@dataclass(frozen=True, kw_only=True)
class _Strata:
    """Strata in the order of samples: (repeat, pair, stratum, cell)."""

    count: int
    samples: Array = field(repr=False)
    method: str = "strata"

    @staticmethod
    def of(sides: tuple[int, ...], stream: Stream) -> _Strata:
        dims, strata = len(sides), int(np.prod(sides))
        cells = max(2, round((_CELLS / strata) ** (1.0 / dims)))
        fine = tuple(cells * side for side in sides)
        count = strata * cells**dims
        sampler = Jittered(dims=dims, sides_=fine)
        u = sampler.draw_stream(count, stream, 0, 2 * _REPEATS)
        cell = np.floor(u[0] * fine).astype(np.int64) // cells
        order = np.argsort(np.ravel_multi_index(tuple(cell.T), sides), kind="stable")
        return _Strata(count=strata, samples=u[:, order].reshape(-1, dims))

    def variance(self, values: Array) -> tuple[Array, Array]:
        g = values.reshape(_REPEATS, 2, self.count, -1, values.shape[-1])
        means = g.mean(axis=3)
        own = (g**2).mean(axis=(1, 3)) - means[:, 0] * means[:, 1]
        difference = own[0] - own[1]
        predicted = own.mean(axis=0).sum(axis=0) / self.count**2
        squares = difference**2
        se = np.sqrt(squares.sum(axis=0)) / (2.0 * self.count**2)
        return predicted, se * _student(squares)

    def mean(self, values: Array) -> tuple[Array, Array]:
        """Integral, and its error from the samples of each cell."""
        cells = values.reshape(2 * _REPEATS, -1, values.shape[-1])
        variance = cells.var(axis=0, ddof=1).sum(axis=0) / len(cells)
        return values.mean(axis=0), np.sqrt(variance) / cells.shape[1]


@final
@dataclass(frozen=True, kw_only=True)
class _Grid:
    """Values on a midpoint grid, and the power of the points there; None is random points."""

    method: str
    count: int
    samples: Array = field(repr=False)
    power: Array | None = field(repr=False, default=None)  # entry m is frequency m, also < 0
    power_se: Array = field(repr=False, default_factory=lambda: np.zeros(()))

    def variance(self, values: Array) -> tuple[Array, Array]:
        """Variance, its error from the grids of half the resolution and from that of the power."""
        dims = self.samples.shape[-1]
        grid = values.reshape(*[_GRIDS[dims]] * dims, -1)
        if self.power is None:
            plain = [
                part.reshape(-1, part.shape[-1]).var(axis=0) / self.count
                for part in _coarse(grid, dims)
            ]
            whole: Array = values.var(axis=0) / self.count
            return whole, _error_of_mean(plain)
        energy = _energy(grid)
        parts = [_sum(self.power, _energy(part)) for part in _coarse(grid, dims)]
        # The powers of m and −m are one number: their errors add up, those of other pairs do not.
        doubled = np.sqrt(2.0 * _sum(self.power_se**2, energy**2))
        return _sum(self.power, energy), np.hypot(_error_of_mean(parts), doubled)

    def mean(self, values: Array) -> tuple[Array, Array]:
        """Integral, and its error from the grids of half the resolution."""
        dims = self.samples.shape[-1]
        grid = values.reshape(*[_GRIDS[dims]] * dims, -1)
        parts = [part.reshape(-1, part.shape[-1]).mean(axis=0) for part in _coarse(grid, dims)]
        return values.mean(axis=0), _error_of_mean(parts)


def _coarse(grid: Array, dims: int) -> list[Array]:
    """The grids of half the resolution, every other node along each axis."""
    offsets = itertools.product((0, 1), repeat=dims)
    return [grid[tuple(slice(k, None, 2) for k in each)] for each in offsets]


def _student(squares: Array) -> Array:
    """Quantile of Student's t over that of the normal, for the sum of squares (J, P) over strata.

    Where one stratum has nearly all of the sum, its standard error has one degree of freedom.
    """
    from scipy.special import stdtrit

    total, fourth = squares.sum(axis=0), (squares**2).sum(axis=0)
    effective = np.divide(total**2, fourth, out=np.ones_like(total), where=fourth > 0.0)
    return np.asarray(stdtrit(effective, 0.975) / CONFIDENCE_Z)


def _error_of_mean(parts: list[Array]) -> Array:
    error: Array = np.std(parts, axis=0, ddof=1) / np.sqrt(len(parts))
    return error


def _energy(grid: Array) -> Array:
    """|g_m|² of values (side, side, P), 0 at m = 0."""
    energy: Array = np.abs(np.fft.fft2(grid, axes=(0, 1)) / len(grid) ** 2) ** 2
    energy[0, 0] = 0.0
    return energy


def _sum(power: Array, energy: Array) -> Array:
    """Sum of energy times power over the frequencies of the energy, of its own or a finer grid."""
    side = len(energy)
    m = np.fft.fftfreq(side, 1.0 / side).astype(int)
    return np.tensordot(power[np.ix_(m, m)], energy, axes=2)


def _midpoints(dims: int) -> Array:
    axis = (np.arange(_GRIDS[dims]) + 0.5) / _GRIDS[dims]
    return np.stack(np.meshgrid(*[axis] * dims, indexing="ij"), axis=-1).reshape(-1, dims)


def _grid_power(sampler: Sampler, n: int, stream: Stream) -> tuple[Array, Array]:
    """Expected power at the frequencies of the grid's FFT, in its order, and its standard error."""
    from mcspectra.spectra.closed_forms import closed_form_power
    from mcspectra.spectra.power import power_spectrum

    side = _GRIDS[2]
    m = np.fft.fftfreq(side, 1.0 / side)
    frequencies = np.stack(np.meshgrid(m, m, indexing="ij"), axis=-1)
    try:
        known = closed_form_power(sampler, n, frequencies)
    except NoClosedForm:
        seed, half = np.random.SeedSequence(stream.key), side // 2
        options: dict[str, Any] = {"half_width": half, "realizations": _POWER_REALIZATIONS}
        spectrum = power_spectrum(sampler, n, rng=seed, **options)
        both = (spectrum[name].values[:-1, :-1] for name in ("power", "power_se"))
        power, se = (np.fft.ifftshift(each) for each in both)
        return power, se
    return known, np.zeros_like(known)
