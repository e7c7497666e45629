"""Screen-space samplers: the points of every pixel and frame, from this package or other code.

A screen-space sampler gives n points of [0,1)^d for each pixel (x, y), frame t and seed.
Points are made for blocks: rectangles of pixels over some frames. Sources of points are:

* any sampler of this package; with ``decorrelate(mask=…)``, pixels depend on each other;
* ``command(run='./mine {x} {y} {frame} {n} {seed}')``: a program, see `CommandScreen`;
* ``python(function='module:function')``: a function of arrays x, y and frame, see `PythonScreen`;
* ``tiles(path='…')``: files of masks, repeated over the screen, see `Tiles`;
* ``tables(path='….cpp')``: tables of blue-noise samples, published by Heitz and others (`Tables`).

This module is in the package `rendering`, because point samplers have no pixels and frames.
"""

from __future__ import annotations

import inspect
import math
import re
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, final

import numpy as np

from mcspectra.core.checks import Array, as_unit_points
from mcspectra.core.decoding import check_decoded_size, opened, read_npy
from mcspectra.core.display import counted, needed, shown
from mcspectra.core.errors import (
    CountError,
    FileFormatError,
    McspectraError,
    Parameter,
    ParameterError,
    SlowSamplerWarning,
    reason_of,
    warn,
)
from mcspectra.core.fields import checked, choice, real, settle
from mcspectra.core.images import read_image
from mcspectra.core.parallel import available_workers, map_in_order
from mcspectra.core.pointfiles import matching_files
from mcspectra.core.progress import report
from mcspectra.core.registry import DEFAULT_DIMS, Registry
from mcspectra.core.spec import Component, parse_chain
from mcspectra.core.streams import Stream
from mcspectra.core.trust import loaded_function, words_of
from mcspectra.measure.bench import shared_sets
from mcspectra.samplers import Decorrelate, Sampler, as_sampler
from mcspectra.samplers.external import (
    PLACEHOLDER,
    SEED_BITS,
    CommandSampler,
    allow_own_code,
    as_label,
    check_code,
    printed_points,
    qualified_name,
)
from mcspectra.samplers.lattice import golden_steps
from mcspectra.samplers.registry import RUN_CODE

__all__ = [
    "SCREEN_SAMPLERS",
    "CommandScreen",
    "FunctionScreen",
    "PixelSampler",
    "PythonScreen",
    "ScreenBlock",
    "ScreenSampler",
    "Tables",
    "Tiles",
    "as_screen_sampler",
]


class ScreenBlock(NamedTuple):
    """A rectangle of pixels over some frames."""

    width: int
    height: int
    frames: int

    def __str__(self) -> str:
        return f"{self.width} × {self.height} pixels × {counted(self.frames, 'frame')}"

    @property
    def size(self) -> int:
        """Number of pixels, summed over all frames."""
        return self.width * self.height * self.frames


@final
@dataclass(frozen=True, kw_only=True)
class ScreenSettings:
    """Limits of the cost of screen-space samplers.

    Attributes
    ----------
    most_numbers
        Largest number of coordinates in a frame (512 MiB as float64).
    most_processes
        Largest number of processes for all blocks of a sampler.
        A process that prints one pixel takes 2 ms if compiled, and 50 ms in Python.
    most_seconds
        Largest total time of all processes of a sampler, in seconds; estimated from the first.
    warned_seconds
        A warning shows the estimated time if it is longer than this, in seconds.
    """

    most_numbers: int = 2**26
    most_processes: int = 2**14
    most_seconds: float = 900.0
    warned_seconds: float = 10.0


_SETTINGS = ScreenSettings()


class ScreenSampler(Component, ABC):
    """Source of the points for all pixels and frames of a block.

    Attributes
    ----------
    dims
        Number of coordinates of a point.
    """

    dims: int

    @property
    def label(self) -> str:
        """Name in tables and figures: the value of ``name=``, or else the spec."""
        return getattr(self, "name_", "") or self.spec

    @abstractmethod
    def frames_of(self, n: int, block: ScreenBlock, seed: int, stream: Stream) -> Iterator[Array]:
        """Yield the points of each frame, float64 (height, width, n, dims) in [0,1).

        Parameters
        ----------
        n
            Number of points per pixel and frame.
        block
            Block of pixels and frames.
        seed
            Number of the block: 0, 1, 2, …
        stream
            Random stream of this block; it is independent of the streams of other blocks.
        """

    def blocks(self, block: ScreenBlock, seeds: int) -> tuple[int, bool]:
        """Return the number of different blocks, and whether a block contains the whole pattern.

        If a pattern repeats within the block, one block gives its exact statistics.
        """
        del block
        return seeds, False

    def repeats(self, n: int, block: ScreenBlock) -> tuple[bool, bool]:
        """Return whether the block holds whole periods in space, and whole periods in time.

        Filters can then wrap around the borders of the block without an error.
        """
        del n, block
        return False, False

    def check(self, n: int, block: ScreenBlock, seeds: int) -> None:
        """Raise an error if this sampler cannot make the block, before anything is drawn."""
        del seeds
        numbers = block.width * block.height * n * self.dims
        if numbers > _SETTINGS.most_numbers:
            raise ParameterError(
                f"A frame of {block.width} × {block.height} pixels with {counted(n, 'point')} in "
                f"{counted(self.dims, 'dim')} has {numbers:,} numbers, more than "
                f"{_SETTINGS.most_numbers:,}; use a smaller ",
                Parameter("block"),
                " or fewer points.",
            )


@final
@dataclass(frozen=True, kw_only=True)
class PixelSampler(ScreenSampler):
    """A sampler of this package: each pixel of each frame is one realization.

    If ``decorrelate`` comes last, realizations are pixels of images with the width of the mask.
    """

    sampler: Sampler
    dims: int = 0  # replaced by the number of dims of the sampler

    def _check(self) -> None:
        settle(self, sampler=shared_sets(self.sampler), dims=self.sampler.dims)

    @property
    def spec(self) -> str:
        """Spec of the sampler."""
        return self.sampler.spec

    @property
    def label(self) -> str:
        """Label of the sampler, or else its spec."""
        return getattr(self.sampler.plain, "name_", "") or self.spec

    def check(self, n: int, block: ScreenBlock, seeds: int) -> None:
        """Also reject blocks larger than the image of ``decorrelate``, and too many processes."""
        ScreenSampler.check(self, n, block, seeds)
        self.sampler.check_count(n)
        mask = self._mask
        if mask is not None and max(block[:2]) > mask.width:
            raise ParameterError(
                f"{self.spec} makes images of {mask.width} × {mask.width} pixels, but the block "
                f"has {block.width} × {block.height}; use a smaller ",
                Parameter("block"),
                ", or a larger width in decorrelate.",
            )
        if isinstance(self.sampler.plain, CommandSampler) and mask is None:
            _check_processes(self.spec, seeds * block.size)

    def repeats(self, n: int, block: ScreenBlock) -> tuple[bool, bool]:
        """Return whether the mask covers the block exactly: in space, and repeated in time."""
        del n
        mask = self._mask
        if mask is None or mask.mask not in ("blue-noise", "spatiotemporal"):
            return False, False
        period = mask.frames if mask.mask == "spatiotemporal" else 1
        steady = mask.time == "repeat" and not mask.advance
        whole = block.width == block.height == mask.width
        return whole, steady and block.frames % period == 0

    @property
    def _mask(self) -> Decorrelate | None:
        last = (self.sampler.randomizations or (None,))[-1]
        return last if isinstance(last, Decorrelate) else None

    def frames_of(self, n: int, block: ScreenBlock, seed: int, stream: Stream) -> Iterator[Array]:
        """Draw one realization for each pixel of each frame.

        Blocks with different seeds use different realizations.
        """
        width, height, frames = block
        stride, lines = width, height
        if self._mask is not None:
            stride = lines = self._mask.width
        for t in range(frames):
            first = (seed * frames + t) * stride * lines
            points = self.sampler.draw_stream(n, stream, first, height * stride)
            yield points.reshape(height, stride, n, self.dims)[:, :width]


def _check_processes(spec: str, processes: int) -> None:
    if processes > _SETTINGS.most_processes:
        raise ParameterError(
            f"{spec} would run {processes:,} processes, more than {_SETTINGS.most_processes:,}; "
            "let the program print whole blocks, with {width} {height} {frames} in its command, "
            "or use a smaller ",
            Parameter("block"),
            ".",
        )


_AXES = (("frame", "frames"), ("y", "height"), ("x", "width"))
"""Names of the placeholders in commands: for each axis, the position and the number of positions.

The axis that varies slowest comes first.
"""

_PLACEHOLDERS = (*(name for axis in _AXES for name in axis), "n", "seed", "dims")


@final
@dataclass(frozen=True, kw_only=True)
class CommandScreen(ScreenSampler):
    """A program that prints the points of pixels, one point per line.

    Attributes
    ----------
    run
        Program and arguments; no shell is used.
        Each axis of the block has two placeholders. The command contains only one of the two.
        With ``{x}``, ``{y}`` or ``{frame}``, the program runs once per position on this axis.
        With ``{width}``, ``{height}`` or ``{frames}``, one run prints all positions on this axis.
        Points are printed frame by frame, row by row, pixel by pixel.
        For example, ``./mine {width} {height} {frames} {n} {seed}`` prints a whole block.
        With neither ``{frame}`` nor ``{frames}``, all frames have the same points.
        ``{n}`` is the number of points of a pixel, and ``{dims}`` the number of dims.
        ``{seed}`` is a whole number from 0 to 2^31 − 1, one for each block.
    dims
        Number of coordinates that the program prints per point, separated by blanks or commas.
    timeout
        Seconds after which a process is stopped.
    name_
        Label in figures and tables: ``name=`` in a spec.

    Raises
    ------
    ParameterError
        If the program does not exist, takes too long, fails, or prints other points than requested.
        If there are too many processes (see `ScreenSettings`).
    FileFormatError, DomainError
        If the program prints something other than finite numbers, or points outside [0,1).
    ConfigError
        If a spec names the program and it is not allowed (`mcspectra.samplers.allow_code`).
    """

    name: ClassVar[str] = "command"
    run: str
    dims: int = DEFAULT_DIMS
    timeout: float = real(60.0, above=0.0)
    name_: str = checked(as_label, "")

    def _check(self) -> None:
        found = PLACEHOLDER.findall(self.run)
        unknown = [name for name in found if name not in _PLACEHOLDERS]
        both = [axis for axis in _AXES if set(axis) <= set(found)]
        lacking = [axis for axis in _AXES[1:] if not set(axis) & set(found)]
        start = f"command(run={self.run!r:.80})"
        if not words_of(self.run):
            raise ParameterError(
                f"{start}: write a program and its arguments, as in './mine {{width}} {{height}} "
                "{frames} {n} {seed}', with quotes closed."
            )
        if unknown:
            raise ParameterError(
                f"{start}: {{{unknown[0]}}} stands for nothing; use {{x}}, {{y}}, {{frame}}, "
                "{width}, {height}, {frames}, {n}, {seed} or {dims}."
            )
        if both:
            raise ParameterError(
                f"{start} has both {{{both[0][0]}}} and {{{both[0][1]}}}; give the first to run "
                "the program once per place, or the second to print all places."
            )
        if lacking:
            raise ParameterError(
                f"{start} does not get the pixel; add {{{lacking[0][0]}}}, or "
                f"{{{lacking[0][1]}}} if it prints all places along this axis."
            )
        allow_own_code(self.run)

    @property
    def _looped(self) -> tuple[bool, ...]:
        """Whether the program runs once for each frame, for each row, and for each column."""
        return tuple(f"{{{one}}}" in self.run for one, _ in _AXES)

    def _parts(self, block: ScreenBlock) -> tuple[list[int], list[int]]:
        """Return how often the program runs, and how many places each run prints, by axis.

        The axes are time, rows and columns.
        """
        sizes = (block.frames, block.height, block.width)
        if not set(_AXES[0]) & set(PLACEHOLDER.findall(self.run)):
            sizes = (1, *sizes[1:])
        runs = [size if one else 1 for size, one in zip(sizes, self._looped, strict=True)]
        return runs, [size // part for size, part in zip(sizes, runs, strict=True)]

    def blocks(self, block: ScreenBlock, seeds: int) -> tuple[int, bool]:
        """Return how many blocks differ. If the command has no ``{seed}``, all blocks are equal."""
        del block
        return (seeds if "{seed}" in self.run else 1), False

    def repeats(self, n: int, block: ScreenBlock) -> tuple[bool, bool]:
        """Return whether the program ignores the frame."""
        del n, block
        return False, not set(_AXES[0]) & set(PLACEHOLDER.findall(self.run))

    def check(self, n: int, block: ScreenBlock, seeds: int) -> None:
        """Check the block, and reject it if the program would run in too many processes."""
        ScreenSampler.check(self, n, block, seeds)
        _check_processes(self.spec, self.blocks(block, seeds)[0] * math.prod(self._parts(block)[0]))

    def frames_of(self, n: int, block: ScreenBlock, seed: int, stream: Stream) -> Iterator[Array]:
        """Run the program for all parts of the block, in parallel."""
        runs, printed = self._parts(block)
        number = int(stream.keys(0, 1)[0, 0]) >> (64 - SEED_BITS)
        values = {**block._asdict(), "n": n, "seed": number, "dims": self.dims}

        def part(index: int) -> Array:
            at = [int(place) for place in np.unravel_index(index, runs)]
            own = values | dict(zip((one for one, _ in _AXES), at, strict=True))
            places = ", ".join(
                f"{one} = {own[one]}"
                for (one, _), looped in zip(_AXES, self._looped, strict=True)
                if looped
            )
            count = math.prod(printed) * n
            where = ", ".join(filter(None, (places, f"n = {n}, seed {number}")))
            points = as_unit_points(
                printed_points(self, own, count, where), name=f"The points of {self.spec}"
            )
            if points.shape != (count, self.dims):
                raise ParameterError(
                    f"{self.spec} printed {counted(points.shape[0], 'point')} in "
                    f"{counted(points.shape[1], 'dim')} at {where}; {counted(count, 'point')} in "
                    f"{needed(self.dims, 'dim')}."
                )
            return points.reshape(*printed, n, self.dims)

        # Estimate the time of all processes from the first one
        total, start = math.prod(runs), time.perf_counter()
        first = part(0)
        workers = available_workers()
        seconds = (time.perf_counter() - start) * (total - 1) / workers
        if seconds > _SETTINGS.most_seconds:
            raise ParameterError(
                f"{self.spec} would take about {seconds:,.0f} s for {total:,} processes of a "
                f"block, more than {_SETTINGS.most_seconds:,.0f} s; let the program print whole "
                "blocks, with {width} {height} {frames} in its command, or use a smaller ",
                Parameter("block"),
                ".",
            )
        if seconds > _SETTINGS.warned_seconds and seed == 0:
            warn(
                f"{self.spec} takes about {seconds:,.0f} s for {total:,} processes per block.",
                SlowSamplerWarning,
            )
        made = np.empty((*runs, *printed, n, self.dims))
        flat = made.reshape(total, *printed, n, self.dims)
        flat[0] = first
        for index, points in enumerate(map_in_order(part, range(1, total), workers), 1):
            flat[index] = points
            report(self.label, (index + 1) / total)
        # Join the results of all runs along each axis
        whole = made.transpose(0, 3, 1, 4, 2, 5, 6, 7)
        whole = whole.reshape(-1, block.height, block.width, n, self.dims)
        for t in range(block.frames):
            yield whole[t % len(whole)]


ScreenFunction = Callable[[Array, Array, Array, int, int], Any]
"""Function of x, y, frame, n and seed. x, y and frame are int64 (k,); the result is (k, n, d)."""


class _OfFunction(ScreenSampler):
    """Base class of sources that call a Python function."""

    @abstractmethod
    def _function(self) -> ScreenFunction:
        """Return the function."""

    def frames_of(self, n: int, block: ScreenBlock, seed: int, stream: Stream) -> Iterator[Array]:
        """Call the function once per frame."""
        del seed
        function, number = self._function(), int(stream.keys(0, 1)[0, 0]) >> (64 - SEED_BITS)
        y, x = (each.ravel() for each in np.indices((block.height, block.width)))
        shape = (x.size, n, self.dims)
        for t in range(block.frames):
            try:
                made = function(x.copy(), y.copy(), np.full(x.size, t), n, number)
            except McspectraError:
                raise
            except (Exception, SystemExit) as error:
                raise CountError(
                    f"{self.spec} cannot make the points of frame {t}: {reason_of(error, 200)}."
                ) from error
            points = as_unit_points(made, name=f"The points of {self.spec}")
            if points.shape != shape and not (n == 1 and points.shape == (x.size, self.dims)):
                raise ParameterError(
                    f"{self.spec} returned shape {points.shape}; {shape} is needed: pixels, points "
                    "of a pixel, dims."
                )
            yield points.reshape(block.height, block.width, n, self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class FunctionScreen(_OfFunction):
    """A Python function that returns the points of pixels and frames.

    Attributes
    ----------
    function
        The function ``points(x, y, frame, n, seed)``, called once per frame.
        The arrays x, y and frame are int64 (k,), one entry per pixel.
        The function returns points (k, n, dims) in [0,1), or (k, dims) if n is 1.
    dims
        Number of coordinates of the returned points.
    """

    name: ClassVar[str] = "function"
    function: ScreenFunction
    dims: int = DEFAULT_DIMS

    def _check(self) -> None:
        if not callable(self.function):
            raise ParameterError(
                f"{shown(self.function)} is not callable; give a function points(x, y, frame, n, "
                "seed)."
            )

    @property
    def spec(self) -> str:
        """Name of the function. No spec string can describe a function object."""
        return f"function({qualified_name(self.function)})"

    def _function(self) -> ScreenFunction:
        return self.function


@final
@dataclass(frozen=True, kw_only=True)
class PythonScreen(_OfFunction):
    """A Python function of pixels and frames, given by name.

    Attributes
    ----------
    function
        Name of the function, ``module:function``. Modules are found on Python's path (PYTHONPATH).
        `FunctionScreen` describes the arguments and the result of the function.
    dims
        Number of coordinates of the returned points.
    name_
        Label in figures and tables: ``name=`` in a spec.

    Raises
    ------
    ParameterError
        If the name has another form or cannot be imported.
        If the function returns an array of another shape.
    CountError
        If the function raises an exception.
    ConfigError
        If a spec names a function that `mcspectra.samplers.allow_code` has not allowed.
    """

    name: ClassVar[str] = "python"
    function: str
    dims: int = DEFAULT_DIMS
    name_: str = checked(as_label, "")

    def _check(self) -> None:
        loaded_function(self.function)
        allow_own_code(self.function)

    def _function(self) -> ScreenFunction:
        return loaded_function(self.function)


def _as_paths(name: str, given: object) -> object:
    listed = [given] if isinstance(given, str) else given
    if isinstance(listed, list | tuple) and listed and all(isinstance(p, str) for p in listed):
        return given if isinstance(given, str) else tuple(listed)
    raise ParameterError(f"{name} is {shown(given)}; give the name of a file, or a list of names.")


def _as_shape(name: str, given: object) -> object:
    whole = isinstance(given, list | tuple) and len(given) == 4
    if whole and all(isinstance(k, int) and k >= 1 for k in given):  # type: ignore[attr-defined]
        return tuple(given)  # type: ignore[arg-type]
    raise ParameterError(
        f"{name} is {shown(given)}; give [frames, height, width, channels], whole numbers."
    )


@final
@dataclass(frozen=True, kw_only=True)
class Tiles(ScreenSampler):
    """Masks from files that repeat over the screen and in time.

    Attributes
    ----------
    path
        A file, or a pattern with ``*`` that matches one picture per frame.
        For a list of files, the mask has the channels of all files, in the order of the list.

        * PNG: one picture per frame, sorted by the numbers in the names.
          Spatio-temporal masks are often published as PNG, as in ``stbn_vec2_2Dx1D_128x128x64_*``.
          Level k of L becomes (k + ½)/L, for 256 or 65,536 levels. Alpha is not used.
        * ``.npy``: shape (frames, height, width, channels), or (height, width, channels), or
          (height, width) for one channel. Floats lie in [0,1).
          Level k of unsigned integers of 8 or 16 bits becomes (k + ½)/L, for L levels.
          Integers of other types are ranks k from 0 to L − 1, which become (k + ½)/L.
        * ``.bin``, ``.raw``: bytes in the order of a shape that must be given.
    shape
        Frames, height, width and channels of a file of bytes.
    points
        Sampler of one point set that all pixels share, such as ``'sobol'``.
        At each pixel, the value of the mask is added to the shared points, modulo 1.
        By default, the mask's values are the points: frame t uses the slices t·n … t·n + n − 1.
    time
        ``"golden"`` shifts the values of frame t by t times the step of Roberts's R-sequence.
        With this shift, a mask that has only one frame also changes from frame to frame.
    dims
        Number of channels to use, starting with the first.
    name_
        Label in figures and tables: ``name=`` in a spec.

    Notes
    -----
    Different seeds use different parts of a tile that is larger than the block.

    Raises
    ------
    FileFormatError
        If a file is missing, broken, of another type or shape, or has values outside [0,1).
    ParameterError
        If there are fewer channels than dims, two channels are equal, or there are too few slices.

    References
    ----------
    [Wolfe2022]_, [GeorgievFajardo2016]_
    """

    name: ClassVar[str] = "tiles"
    path: str | Sequence[str] = checked(_as_paths)
    shape: Sequence[int] | None = checked(_as_shape, None)
    points: str = checked(as_label, "")
    time: str = choice("repeat", "golden")
    dims: int = DEFAULT_DIMS
    name_: str = checked(as_label, "")
    values: Array = field(default=None, init=False, repr=False, compare=False)  # type: ignore[arg-type]

    def _check(self) -> None:
        paths = [self.path] if isinstance(self.path, str) else self.path
        parts = [_read_tile(path, self.shape) for path in paths]
        shapes = {each.shape[:3] for each in parts}
        if len(shapes) > 1:
            listed = " and ".join(" × ".join(map(str, each)) for each in sorted(shapes))
            raise ParameterError(
                f"The masks have {listed} frames, rows and columns; give masks of one size."
            )
        values = np.concatenate(parts, axis=3)
        if values.shape[3] < self.dims:
            raise ParameterError(
                f"{self._files} has {counted(values.shape[3], 'channel')} (shape "
                f"{values.shape}: frames, rows, columns, channels), but "
                f"{needed(self.dims, 'dim')}; give a mask with more channels, or a list of masks."
            )
        values = values[..., : self.dims]
        for j in range(1, self.dims):
            if any(np.array_equal(values[..., j], values[..., i]) for i in range(j)):
                raise ParameterError(
                    f"{self._files} has equal channels, as in a gray picture; give masks that "
                    "differ from dim to dim."
                )
        settle(self, values=np.ascontiguousarray(values))
        if self.points:
            as_sampler(self.points, self.dims)

    @property
    def _files(self) -> str:
        return self.path if isinstance(self.path, str) else " and ".join(self.path)

    def blocks(self, block: ScreenBlock, seeds: int) -> tuple[int, bool]:
        """Return how many blocks of pixels with different points a tiled mask gives.

        If a block contains whole masks, all blocks are equal: the number of different blocks is 1.
        """
        if self.points and not as_sampler(self.points, self.dims).fixed:
            return seeds, False
        if all(self.repeats(1, block)):
            return 1, True
        return min(seeds, math.prod(self._places(block))), False

    def repeats(self, n: int, block: ScreenBlock) -> tuple[bool, bool]:
        """Return whether the block is a whole number of tiles, in space and in time."""
        del n
        frames, height, width, _ = self.values.shape
        whole = not (block.width % width or block.height % height)
        return whole, self.time == "repeat" and block.frames % frames == 0

    def _places(self, block: ScreenBlock) -> list[int]:
        """Return how many disjoint blocks the mask holds along time, rows and columns."""
        sides = zip(self.values.shape, reversed(block), strict=False)
        return [max(1, whole // part) for whole, part in sides]

    def check(self, n: int, block: ScreenBlock, seeds: int) -> None:
        """Check the block, and reject more points per pixel than the mask has frames."""
        ScreenSampler.check(self, n, block, seeds)
        if self.points:
            as_sampler(self.points, self.dims).check_count(n)
        elif n > len(self.values):
            raise ParameterError(
                f"{self._files} has {counted(len(self.values), 'frame')}, but n is {n}; give "
                "points='sobol', or another set that the mask moves."
            )

    def frames_of(self, n: int, block: ScreenBlock, seed: int, stream: Stream) -> Iterator[Array]:
        """Return the points of each frame, from the mask's values at the pixels of the block."""
        frames, height, width, _ = self.values.shape
        places = self._places(block)
        start = np.unravel_index(seed % math.prod(places), places)
        first, top, left = (int(k) * side for k, side in zip(start, reversed(block), strict=True))
        rows = (top + np.arange(block.height))[:, None] % height
        columns = (left + np.arange(block.width)) % width
        shared = None
        if self.points:
            shared = as_sampler(self.points, self.dims).draw_stream(n, stream, 0, 1)[0]
        for t in range(block.frames):
            if shared is None:
                slices = (first + t * n + np.arange(n)) % frames
                found = np.moveaxis(self.values[slices][:, rows, columns], 0, 2)
            else:
                found = self.values[(first + t) % frames, rows, columns][:, :, None] + shared
            if self.time == "golden":
                found = found + t * (golden_steps(self.dims) * 2.0**-64)
            found = found - np.floor(found)
            found[found >= 1.0] = 0.0  # the remainder of −1e-20 modulo 1 rounds to 1
            yield found


def _read_tile(path: str, shape: Sequence[int] | None) -> Array:
    """Return the values in [0,1) of a mask, (frames, height, width, channels)."""
    suffix = Path(path).suffix.lower()
    if suffix in (".png", ".npy"):
        files = [file for file, _ in matching_files(path)]
    else:
        files = [Path(path)]
    if suffix == ".png":
        pictures = [read_image(file, linear=True) for file in files]
        for file, each in zip(files, pictures, strict=True):
            if each.shape != pictures[0].shape:
                raise FileFormatError(
                    f"{file} has shape {each.shape}, but {files[0]} has {pictures[0].shape}; give "
                    "the frames of one mask."
                )
        values = np.stack(pictures)
        eight = np.abs(values * 255 - np.rint(values * 255)).max() < 1e-6
        levels = 256 if eight else 65536
        return np.asarray((np.rint(values * (levels - 1)) + 0.5) / levels)
    if len(files) > 1:
        raise FileFormatError(f"{path} matches {len(files)} files; give one array for a mask.")
    if suffix == ".npy":
        with opened(files[0], "a mask", (".npy",)) as (stream, size, name, _):
            found = read_npy(stream, size, name)
        if found.dtype.kind not in "fiu" or found.ndim not in (2, 3, 4) or found.size == 0:
            raise FileFormatError(
                f"{path} holds {found.dtype} values of shape {found.shape}; give (frames, height, "
                "width, channels), (height, width, channels) or (height, width)."
            )
        found = found[..., None] if found.ndim == 2 else found
        found = found[None] if found.ndim == 3 else found
        if found.dtype.kind == "f":
            return as_unit_points(found, name=f"The values of {path}")
        if found.dtype.kind == "i" and found.min() < 0:
            raise FileFormatError(f"{path} holds negative ranks; give ranks 0, 1, 2, …")
        small = found.dtype in (np.uint8, np.uint16)
        levels = 1 << 8 * found.dtype.itemsize if small else int(found.max()) + 1
        return np.asarray((found + 0.5) / levels)
    if suffix in (".bin", ".raw"):
        with opened(path, "a mask", (".bin", ".raw")) as (stream, size, name, _):
            if shape is None or math.prod(shape) != size:
                given = "no shape" if shape is None else f"shape={list(shape)}"
                raise FileFormatError(
                    f"{name} has {size} bytes and {given}; give shape=[frames, height, width, "
                    f"channels] with the product {size}."
                )
            check_decoded_size(name, size, 16 * size)
            found = np.frombuffer(stream.read(), np.uint8).reshape(shape)
        return np.asarray((found + 0.5) / 256)
    raise FileFormatError(
        f"{path} does not end in .png, .npy, .bin or .raw; give a mask in one of these formats."
    )


_TABLES = {"sobol_256spp_256d": 256 * 256, "scramblingTile": 128**2 * 8, "rankingTile": 128**2 * 8}
"""Names of the arrays in the published files, and their numbers of entries."""

_TABLE = r"\b{}\s*\[[^\]]*\]\s*=\s*\{{([^}}]*)\}}"


@final
@dataclass(frozen=True, kw_only=True)
class Tables(ScreenSampler):
    """Tables of Heitz and others: one Sobol' set, and ranking and scrambling values per pixel.

    Attributes
    ----------
    path
        A published C++ file such as ``samplerBlueNoiseErrorDistribution_…_16spp.cpp``.
        The file holds the arrays ``sobol_256spp_256d``, ``scramblingTile`` and ``rankingTile``.
        A file for one sample per pixel needs no ``rankingTile``.
    dims
        Number of coordinates, at most 8: only these dims are optimized.
    name_
        Label in figures and tables: ``name=`` in a spec.

    Notes
    -----
    With bytes s, c and r from the three arrays, sample i of dim j at pixel (x, y) is
    (s[j + 256 (i xor r[j + 8 q])] xor c[j + 8 q] + ½) / 256, with q = x + 128 y.
    Pixel coordinates are taken modulo 128, and sample numbers modulo 256.
    The tables have no time axis: frame t uses the samples t·n … t·n + n − 1.

    Raises
    ------
    FileFormatError
        If the file is missing, or an array is missing or has another size.

    References
    ----------
    [Heitz2019]_
    """

    name: ClassVar[str] = "tables"
    path: str
    dims: int = DEFAULT_DIMS
    name_: str = checked(as_label, "")
    arrays: tuple[Array, ...] = field(default=(), init=False, repr=False, compare=False)

    def _check(self) -> None:
        if self.dims > 8:
            raise ParameterError(
                f"{self.path} is optimized for 8 dims, but {needed(self.dims, 'dim')}; use fewer."
            )
        with opened(self.path, "tables", (".cpp", ".h", ".hpp", ".c", ".txt")) as opening:
            stream, size, name, _ = opening
            check_decoded_size(name, size, 12 * size)
            text = stream.read().decode("ascii")
        found = []
        for array, count in _TABLES.items():
            match = re.search(_TABLE.format(array), text)
            if match is None and array == "rankingTile":
                found.append(np.zeros(count, np.int64))
                continue
            words = [w for w in re.split(r"[,\s]+", match[1]) if w] if match else []
            if len(words) != count or not all(w.isdecimal() and int(w) < 256 for w in words):
                raise FileFormatError(
                    f"{name} has {len(words)} numbers in {array}; {count} numbers below 256 are "
                    "needed: give a file of the authors' samplers."
                )
            found.append(np.array(words, np.int64))
        settle(self, arrays=tuple(found))

    def blocks(self, block: ScreenBlock, seeds: int) -> tuple[int, bool]:
        """Return how many different blocks the tile of 128 × 128 pixels holds."""
        whole = self.repeats(1, block)[0]
        places = max(1, 128 // block.width) * max(1, 128 // block.height)
        return (1 if whole else min(seeds, places)), whole

    def repeats(self, n: int, block: ScreenBlock) -> tuple[bool, bool]:
        """Return whether the block is a whole number of tiles, and uses all 256 samples."""
        whole = not (block.width % 128 or block.height % 128)
        return whole, block.frames * n % 256 == 0

    def check(self, n: int, block: ScreenBlock, seeds: int) -> None:
        """Also reject more than 256 samples per pixel, because the tables have 256 samples."""
        ScreenSampler.check(self, n, block, seeds)
        if n > 256:
            raise CountError(f"{self.spec} has 256 samples per pixel, not {n}; ask for fewer.")

    def frames_of(self, n: int, block: ScreenBlock, seed: int, stream: Stream) -> Iterator[Array]:
        """Look up the samples of the pixels in the tables."""
        del stream
        sobol, scrambling, ranking = self.arrays
        across = max(1, 128 // block.width)
        left, top = seed % across * block.width, seed // across * block.height
        y, x = np.indices((block.height, block.width))
        pixel = (x + left) % 128 + (y + top) % 128 * 128
        j = np.arange(self.dims)
        place = j + pixel[:, :, None, None] * 8
        for t in range(block.frames):
            index = (t * n + np.arange(n))[:, None] % 256 ^ ranking[place]
            yield ((sobol[j + index * 256] ^ scrambling[place]) + 0.5) / 256


SCREEN_SAMPLERS = Registry(
    "screen-space sampler",
    "mcspectra.screen_samplers",
    {
        "command": "mcspectra.rendering.screen_samplers:CommandScreen",
        "python": "mcspectra.rendering.screen_samplers:PythonScreen",
        "tables": "mcspectra.rendering.screen_samplers:Tables",
        "tiles": "mcspectra.rendering.screen_samplers:Tiles",
    },
    base=ScreenSampler,
)
"""Names of screen-space samplers. All other names belong to point samplers."""


def as_screen_sampler(source: Any, dims: int | None = None) -> ScreenSampler:
    """Convert an object, a spec or a function to a screen-space sampler.

    Parameters
    ----------
    source
        A `ScreenSampler`, a spec string, or a function ``points(x, y, frame, n, seed)``.
        Anything that `mcspectra.samplers.as_sampler` accepts is also allowed.
        A command with ``{x}``, ``{y}``, ``{width}`` or ``{height}`` is a `CommandScreen`.
        A single ``python('module:function')`` is a `PythonScreen`.
    dims
        Required number of dims.

    Raises
    ------
    ParameterError
        If `source` has another type, or another number of dims.
    ConfigError
        If a spec names code that is not allowed.
    """
    if isinstance(source, str):
        calls = parse_chain(source)
        call = calls[0]
        pixels = call.name != "command" or set(
            PLACEHOLDER.findall(str(call.arguments.get("run", "")))
        ) & {name for axis in _AXES for name in axis}
        if len(calls) == 1 and call.name in SCREEN_SAMPLERS and pixels:
            if call.name in RUN_CODE:
                check_code(call)
            return SCREEN_SAMPLERS.build(call, dims)  # type: ignore[no-any-return]
    if isinstance(source, ScreenSampler):
        if dims is not None and source.dims != dims:
            raise ParameterError(
                f"{source.spec} is for {counted(source.dims, 'dim')}, but {needed(dims, 'dim')}."
            )
        return source
    if inspect.isroutine(source):
        return FunctionScreen(function=source, **({} if dims is None else {"dims": dims}))
    return PixelSampler(sampler=as_sampler(source, dims))
