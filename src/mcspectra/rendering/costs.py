"""Size, time and storage of work on a scene, estimated from short measured runs.

All commands and functions that render scenes estimate their costs by the same method.
The work is run at growing sizes until a run takes long enough.
The size of a run is its number of pixels, or of samples per pixel.
The first run also compiles kernels and stores them on disk, so it is repeated.
Later commands load these kernels, so an estimated time does not include compilation.
The time is a fixed part plus a part in proportion to the size; the last two runs give both parts.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, final

from mcspectra.core.display import counted
from mcspectra.rendering.backend import compilations

__all__ = ["SceneCost", "TimedWork", "timed_part", "timed_work"]

_GROWTH = 4  # ratio of the sizes of successive runs
_PARTS = (16, 4)  # a short part of an analysis is run with these fractions of its size
_FEWEST = 4  # smallest number of realizations for a variance with an error
_FIRST = 64  # largest size of the first run of such a part, so that no dry run is long
_ENOUGH = 0.25  # sizes stop growing when a run takes this share of the time for all runs


@final
@dataclass(frozen=True)
class SceneCost:
    """Estimated size, time and storage of work on a scene; print it for a sentence.

    Attributes
    ----------
    what
        Description of the work, such as ``"6 renders of each with 3 samplers"``.
        The printed sentence gives the number of pixels first, and then the description of the work.
    size
        Width and height of the image or crop, in pixels.
    pixels
        Number of pixels that are measured or rendered.
    samples
        Number of samples of all pixels.
    samples_per_second
        Measured number of samples per second.
    seconds
        Estimated time, with the time for loading and writing, if kernels are compiled already.
    most
        Estimated time if a search, whose length depends on the result, takes as long as it may.
        None for work without such a search.
    storage
        Estimated bytes of all written files; 0 if nothing is stored.
    """

    scene: str
    what: str
    size: tuple[int, int]
    pixels: int
    samples: int
    samples_per_second: float
    seconds: float
    storage: int = 0
    most: float | None = None

    @property
    def text(self) -> str:
        """The estimate as a sentence."""
        most = "" if self.most is None else f", at most {_duration(self.most)}"
        stored = f"about {_bytes(self.storage)} are stored" if self.storage else "nothing is stored"
        return (
            f"{self.scene}, {self.size[0]} × {self.size[1]} pixels: "
            f"{counted(self.pixels, 'pixel')}, {self.what}, {_rounded(self.samples / 1e6)} "
            f"million samples at {_rounded(self.samples_per_second / 1e6)} million per second: "
            f"about {_duration(self.seconds)}{most}; {stored}."
        )

    def __str__(self) -> str:
        return self.text

    def later(self, seconds: float) -> SceneCost:
        """Return the estimate of this work after other work that takes `seconds`."""
        most = None if self.most is None else self.most + seconds
        return replace(self, seconds=self.seconds + seconds, most=most)

    def then(self, other: SceneCost) -> SceneCost:
        """Return the estimate of this work and of other work on the same scene after it."""
        both = (self, other)
        samples = sum(each.samples for each in both)
        longest = (each.seconds if each.most is None else each.most for each in both)
        return replace(
            self,
            what=f"{self.what}; then {counted(other.pixels, 'pixel')}, {other.what}",
            samples=samples,
            samples_per_second=samples / sum(c.samples / c.samples_per_second for c in both),
            seconds=self.seconds + other.seconds,
            most=None if self.most is other.most is None else sum(longest),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers and texts."""
        return dict(vars(self))


def _duration(seconds: float) -> str:
    if seconds < 300.0:
        return f"{seconds:.0f} s"
    hours = seconds / 3600.0
    if hours < 3.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{hours:.1f} h" if hours < 72.0 else f"{hours / 24.0:.0f} days"


def _bytes(number: float) -> str:
    power = min(max(int(math.log(max(number, 1.0), 1000.0)), 1), 4)
    return f"{_rounded(number / 1000.0**power)} {('kB', 'MB', 'GB', 'TB')[power - 1]}"


def _rounded(number: float) -> str:
    """Write a number with two digits, or as a whole number if it is larger."""
    return f"{number:.2g}" if number < 99.5 else f"{number:.0f}"


@final
@dataclass(frozen=True)
class TimedWork:
    """Seconds of the whole work, and of one unit of its size."""

    seconds: float
    each: float


def timed_work(
    work: Callable[[int], object],
    total: int,
    *,
    first: int,
    most: int | None = None,
    seconds: float = 4.0,
) -> TimedWork:
    """Estimate the seconds of ``work(total)`` from runs of growing sizes.

    Parameters
    ----------
    work
        Function that does the work for a given size. Its time is nearly proportional to the size.
    total
        Size of the work whose time is estimated.
    first, most
        Sizes of the first and of the largest run.
    seconds
        Approximate time for all runs, without the first, which compiles.

    Returns
    -------
    TimedWork
        Estimates for a later command, which loads the compiled kernels from disk.
    """
    largest = min(total, most or total)
    size, runs = min(first, largest), []
    start = time.perf_counter()
    with compilations() as compiled:
        work(size)
    loaded = time.perf_counter() - start - sum(compiled)
    while True:
        start = time.perf_counter()
        work(size)
        spent = time.perf_counter() - start
        runs.append((size, spent))
        if size >= largest or spent > _ENOUGH * seconds:
            break
        size = min(_GROWTH * size, largest)
    size, spent = runs[-1]
    each = spent / size
    if len(runs) > 1:
        before, shorter = runs[-2]
        # The last two runs give the time per unit of size, but a busy machine may distort it.
        # Far from the last run, the time per unit is limited to 50 to 100 % of its mean per unit.
        # Otherwise it is at least 5 %, so that a speed is never infinite
        slope = (spent - shorter) / (size - before)
        least = 0.5 if total > _GROWTH * size else 0.05
        each = min(max(slope, least * each), each)
    fixed = max(spent - each * size, 0.0) + max(loaded - runs[0][1], 0.0)
    return TimedWork(fixed + each * total, each)


def timed_part(work: Callable[[int], object], total: int, *, seconds: float = 60.0) -> TimedWork:
    """Estimate the seconds of ``work(total)``, a part of an analysis with a large fixed time.

    The part is run with a sixteenth and with a quarter of its size, which tell its fixed time from
    the rest. A large part starts with the size `_FIRST`, and its sizes grow at most to a quarter.
    If a run takes a quarter of `seconds`, longer ones are left out.
    """
    first, most = (max(math.ceil(total / part), min(total, _FEWEST)) for part in _PARTS)
    return timed_work(work, total, first=min(first, _FIRST), most=most, seconds=seconds)
