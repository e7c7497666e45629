"""Power spectra as a staged analysis: sums over point sets by frequency, ring and wedge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.packing import pack_record, unpack_record
from mcspectra.core.parallel import Block, RealizationBlocks, realization_blocks
from mcspectra.core.staged import Run, Stages
from mcspectra.core.streams import Stream
from mcspectra.densities import Density
from mcspectra.densities.base import divide_by_density
from mcspectra.samplers import Sampler
from mcspectra.spectra._kernels import power_sums
from mcspectra.spectra._polar import PolarSums
from mcspectra.spectra.transforms import Transform

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["PowerSums", "SpectrumSums", "StagedSpectrum", "weighted_points"]

_BLOCKS = 8  # at least, for threads and machines to share


@dataclass
class PowerSums:
    """Sums of |S|², |S|⁴ and, if wanted, S over `count` realisations, by frequency: (F,)."""

    total: Array
    squares: Array
    mean: Array | None
    count: int = 0

    @staticmethod
    def zeros(size: int, mean: bool) -> PowerSums:
        """Sums of no realisations."""
        return PowerSums(
            np.zeros(size), np.zeros(size), np.zeros(size, np.complex128) if mean else None
        )

    def take(self, s: Array) -> None:
        """Add one set's S (F,)."""
        power_sums(s, False, self.total, self.squares)
        if self.mean is not None:
            self.mean += s

    def add(self, other: PowerSums) -> None:
        """Take in the sums of others."""
        self.total += other.total
        self.squares += other.squares
        if self.mean is not None and other.mean is not None:
            self.mean += other.mean
        self.count += other.count

    def power(self, count: int) -> tuple[Array, Array]:
        """Expected power and its standard error (NaN for one realisation)."""
        power = self.total / count
        return power, _standard_error(self.squares / count - power * power, count)

    def coefficient(self, count: int) -> tuple[Array, Array]:
        """Mean S and its standard error, the root of the mean |error|²."""
        assert self.mean is not None
        mean = self.mean / count
        return mean, _standard_error(self.total / count - np.abs(mean) ** 2, count)


def _standard_error(spread: Array, count: int) -> Array:
    if count < 2:
        return np.full_like(spread, np.nan)
    return np.asarray(np.sqrt(np.maximum(spread, 0.0) / (count - 1)))


@dataclass(frozen=True)
class SpectrumSums:
    """Sums by frequency, and by ring and wedge."""

    power: PowerSums
    polar: PolarSums


@final
@dataclass(frozen=True)
class StagedSpectrum:
    """One run of point sets.

    Attributes
    ----------
    mean
        Whether ⟨S_m⟩ is wanted.
    polar
        Rings and wedges, of no realisations.
    result
        Makes the dataset of the sums over all blocks.
    """

    sampler: Sampler
    density: Density | None
    n: int
    stream: Stream
    realizations: int
    transform: Transform
    mean: bool
    polar: PolarSums
    result: Callable[[SpectrumSums], xr.Dataset]

    @property
    def _blocks(self) -> RealizationBlocks:
        # A block holds its points and two half spectra; pairs share a transform.
        numbers = max(self.n * self.sampler.dims, self.transform.grid.size // 8)
        return realization_blocks(self.realizations, numbers, multiple=2, least=_BLOCKS)

    def stages(self) -> Stages:
        """One run of all realisations."""
        cost = self.realizations * (self.n + 0.5 * self.transform.grid.size)
        realizations, blocks = self.realizations, len(self._blocks)
        (total,) = yield [Run(part=0, first=0, realizations=realizations, blocks=blocks, cost=cost)]
        return self.result(total)

    def block(self, run: Run, index: int) -> SpectrumSums:  # noqa: ARG002
        """Sums of one block."""
        block = self._blocks[index]
        sums, polar = PowerSums.zeros(self.transform.grid.half_size, self.mean), self.polar.empty()
        points, weights = weighted_points(self.sampler, self.density, self.n, self.stream, block)
        self.transform.add_power(points, weights, sums.total, sums.squares, sums.mean, polar)
        sums.count = len(points)
        return SpectrumSums(sums, polar)

    def merge(self, left: SpectrumSums, right: SpectrumSums) -> SpectrumSums:
        """Sums of both, in the memory of the left ones."""
        left.power.add(right.power)
        left.polar.add(right.polar)
        return left

    def pack(self, state: SpectrumSums) -> dict[str, Array]:
        """Sums by frequency, and those of rings and wedges without their labels."""
        polar = {"polar.total": state.polar.total, "polar.squares": state.polar.squares}
        return {**pack_record(state.power, "power."), **polar}

    def unpack(self, arrays: dict[str, Array]) -> SpectrumSums:
        """Inverse of `pack`."""
        total, squares = arrays["polar.total"], arrays["polar.squares"]
        polar = replace(self.polar, total=total, squares=squares)
        return SpectrumSums(unpack_record(PowerSums, arrays, "power."), polar)


def weighted_points(
    sampler: Sampler, density: Density | None, n: int, stream: Stream, block: Block
) -> tuple[Array, Array | None]:
    """Draw a block: points (R, n, d), warped by the density, and weights 1/(n p), None for 1/n."""
    points = sampler.draw_stream(n, stream, *block)
    if density is None:
        return points, None
    x = density.sample(points)
    equal = np.full((len(x), n), 1.0 / n)
    return x, divide_by_density(equal, density.pdf(x), x, density.spec, constant=True)
