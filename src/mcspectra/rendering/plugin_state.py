"""State of the sampler plugin: the sets of one pixel, or tables for a wavefront.

In vectorised variants all sets are tables in Dr.Jit's memory: lane i is sample i mod n of pixel
⌊i / n⌋, and requests are gathered from the sets that `Rounds` lays out. In scalar ones Mitsuba
seeds the sampler for each pixel, whose sets are then drawn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.rendering.sample_tables import PaddedSets, Rounds

__all__ = ["LaneState", "PixelState", "seed_lanes", "seed_pixel"]

_REQUESTS = 4  # sets of each pixel that no other has: film, light, BSDF and one more
_MOST_REQUESTS = 2**16  # of a pixel, in scalar variants


def seed_pixel(_: Any, sets: PaddedSets, stream: Stream, *__: int) -> PixelState:
    """State of a pixel that a scalar variant has seeded."""
    return PixelState(sets, stream)


class PixelState:
    """State of one pixel of a scalar variant."""

    def __init__(self, sets: PaddedSets, stream: Stream) -> None:
        self._sets, self._stream = sets, stream
        self._drawn: dict[tuple[int, int], Array] = {}
        self._joint: Array | None = None
        self._index = 0
        self._restart()

    def copy(self) -> PixelState:
        """Return a state that goes on by itself; sets are drawn anew when it asks for them."""
        twin = PixelState(self._sets, self._stream)
        twin._index, twin._coordinate = self._index, self._coordinate
        twin._requests = dict(self._requests)
        return twin

    def advance(self) -> None:
        """Go on to the next sample, after the last one to the first."""
        self._index = (self._index + 1) % self._sets.count
        self._restart()

    def schedule(self) -> None:
        """Do nothing: there is nothing to evaluate."""

    def single(self, _: object) -> float:
        """Return one number."""
        return float(self._numbers(1)[0])

    def pair(self, _: object) -> tuple[float, float]:
        """Return two numbers."""
        x, y = self._numbers(2)
        return float(x), float(y)

    def _restart(self) -> None:
        self._requests = {1: 0, 2: 0}
        self._coordinate = 0

    def _numbers(self, dims: int) -> Array:
        start, self._coordinate = self._coordinate, self._coordinate + dims
        if start + dims <= self._sets.joint:
            if self._joint is None:
                self._joint = self._sets.joints(self._stream, 0, 1)[0]
            return self._joint[self._index, start : start + dims]
        request = self._requests[dims] % _MOST_REQUESTS
        self._requests[dims] += 1
        block, place = divmod(request, _REQUESTS)
        if (dims, block) not in self._drawn:
            pads = self._sets.pads(dims, self._stream, block * _REQUESTS, _REQUESTS)
            self._drawn[dims, block] = pads
        numbers: Array = self._drawn[dims, block][place, self._index]
        return numbers


def seed_lanes(
    module: Any, sets: PaddedSets, stream: Stream, wavefront_size: int, per_pass: int
) -> LaneState | None:
    """State of a wavefront, None if it is none: renderers let go of memory by a wavefront of 1."""
    pixels, rest = divmod(wavefront_size, per_pass)
    if rest:
        return None
    import drjit

    lane = drjit.arange(module.UInt32, wavefront_size)
    width = drjit.opaque(module.UInt32, per_pass)
    tables = _Tables(module, sets, stream, pixels)
    zeros = (drjit.opaque(module.UInt32, 0) for _ in range(3))
    return LaneState(tables, per_pass, 0, lane // width, lane % width, *zeros)


class _Tables:
    """Sets in Dr.Jit's memory. No dataclass: Dr.Jit would make tables part of a loop's state."""

    def __init__(self, module: Any, sets: PaddedSets, stream: Stream, pixels: int) -> None:
        import drjit

        self.module, self.sets = module, sets
        self.rounds = Rounds.of(pixels, _REQUESTS, 2 * sets.count)
        self._count = drjit.opaque(module.UInt32, sets.count)
        self._size = drjit.opaque(module.UInt32, self.rounds.size)
        self._stride = drjit.opaque(module.UInt32, self.rounds.stride)
        self._pads = {
            dims: module.Float(sets.pads(dims, stream, 0, self.rounds.size).ravel())
            for dims in (1, 2)
        }
        if sets.joint:
            own = min(pixels, self.rounds.size)
            self._joint = module.Float(sets.joints(stream, 0, own).ravel())
            self._joint_size = drjit.opaque(module.UInt32, own)

    def next_offset(self, offset: Any) -> Any:
        """Offset of the next request."""
        return self._wrapped(offset + self._stride)

    def pad(self, dims: int, pixel: Any, offset: Any, index: Any, active: Any) -> list[Any]:
        """Numbers of requests with this offset."""
        row = self._wrapped(pixel % self._size + offset) * self._count + index
        return self._row(self._pads[dims], dims, row * dims, active)

    def joint(self, dims: int, pixel: Any, start: Any, index: Any, active: Any) -> list[Any]:
        """Coordinates from `start` on of the pixel's joint set."""
        row = (pixel % self._joint_size) * self._count + index
        return self._row(self._joint, dims, row * self.sets.joint + start, active)

    def _wrapped(self, number: Any) -> Any:
        import drjit

        return drjit.select(number >= self._size, number - self._size, number)

    def _row(self, table: Any, dims: int, first: Any, active: Any) -> list[Any]:
        import drjit

        return [drjit.gather(self.module.Float, table, first + k, active) for k in range(dims)]


@dataclass
class LaneState:
    """State of a wavefront: a dataclass, so that Dr.Jit carries its arrays through loops.

    Attributes
    ----------
    tables, per_pass, done
        Points, samples of a pixel in a pass, and samples of a pixel in passes before.
    pixel, index
        Of each lane.
    coordinate, single_offset, pair_offset
        What a sample has taken so far: numbers, and where its next sets are.
    """

    tables: _Tables
    per_pass: int
    done: int
    pixel: Any
    index: Any
    coordinate: Any
    single_offset: Any
    pair_offset: Any

    def copy(self) -> LaneState:
        """Return a state that goes on by itself."""
        kind = self.tables.module.UInt32
        names = ("pixel", "index", "coordinate", "single_offset", "pair_offset")
        return replace(self, **{name: kind(getattr(self, name)) for name in names})

    def advance(self) -> None:
        """Go on to the samples of the next pass."""
        zero = self.tables.module.UInt32(0)
        self.done += self.per_pass
        self.index = self.index + self.per_pass
        self.coordinate, self.single_offset, self.pair_offset = zero, zero, zero

    def schedule(self) -> None:
        """Have the arrays evaluated with the next kernel."""
        import drjit

        drjit.schedule(self.index, self.coordinate, self.single_offset, self.pair_offset)

    def single(self, active: Any) -> Any:
        """Return one number for each lane."""
        (value,), self.single_offset = self._numbers(1, self.single_offset, active)
        return value

    def pair(self, active: Any) -> list[Any]:
        """Return two numbers for each lane."""
        values, self.pair_offset = self._numbers(2, self.pair_offset, active)
        return values

    def _numbers(self, dims: int, offset: Any, active: Any) -> tuple[list[Any], Any]:
        import drjit

        self._check()
        start, self.coordinate = self.coordinate, self.coordinate + dims
        following = self.tables.next_offset(offset)
        if not self.tables.sets.joint:
            return self.tables.pad(dims, self.pixel, offset, self.index, active), following
        inside = start + dims <= self.tables.sets.joint
        joint = self.tables.joint(dims, self.pixel, start, self.index, inside & active)
        pads = self.tables.pad(dims, self.pixel, offset, self.index, ~inside & active)
        values = [drjit.select(inside, a, b) for a, b in zip(joint, pads, strict=True)]
        return values, drjit.select(inside, offset, following)

    def _check(self) -> None:
        if self.done + self.per_pass > self.tables.sets.count:
            raise ParameterError(
                f"All {self.tables.sets.count} samples of each pixel are used; an integrator that "
                "renders in passes needs the sampler's integer samples_per_pass."
            )
