"""Sequences of frames: their files, and the statistics of their errors over time.

An animation is rendered several times, with different seeds for each sequence of frames.
The error of a frame is its deviation from the mean over the sequences at the same time.
Motion in the scene therefore does not count as noise, and errors at all lags are unbiased.
"""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np
from scipy.ndimage import uniform_filter

from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z, deviations_t
from mcspectra.core.display import counted, shown
from mcspectra.core.errors import FileFormatError, Parameter, ParameterError
from mcspectra.core.images import Rings
from mcspectra.rendering.frame_files import FrameFiles
from mcspectra.rendering.frame_filters import SpatialPower

__all__ = ["Temporal", "TimeStatistics", "sequence_files", "stored_array", "temporal_of"]

# Names of files that are recognized as sequences without a pattern, such as shot_s3_t012.exr
_FOUND = re.compile(
    r"(?<![a-z0-9])s(?:eed)?[_-]?(?P<seed>\d+)[_.-](?:t|frame)[_-]?(?P<frame>\d+)(?![a-z0-9])",
    re.IGNORECASE,
)
_NAMES = {"seed": r"(?P<seed>[A-Za-z0-9]+)", "frame": r"(?P<frame>\d+)"}
_IN_MEMORY = 2**29  # limit in bytes for arrays in memory; larger arrays are kept in a file
_SLOW = 0.125  # temporal frequencies below this limit in cycles per frame count as low
# The effective number of frames of a pixel is averaged over a square of pixels.
# The square is so large that the average has an error of 20 %, but at most 15 × 15 pixels
_WIDEST, _PIXEL_ERROR = 15, 0.2
_BLOCK = 2**22  # number of complex values that are transformed over time together


def sequence_files(groups: list[FrameFiles], pattern: str | None) -> list[FrameFiles]:
    """Arrange files by seed and frame, if their names show that they belong to sequences.

    Parameters
    ----------
    groups
        Files, grouped by number of samples per pixel.
    pattern
        Text such as ``"shot_s{seed}_t{frame}.exr"`` that matches the end of every path.
        A ``*`` matches any text inside a name.
        If it is None, names such as ``shot_s3_t012.exr`` are recognized.

    Returns
    -------
    list of FrameFiles
        The given groups of files, with `times` set to the number of frames per sequence.
        Groups whose names are not recognized are returned unchanged.

    Raises
    ------
    ParameterError
        If the pattern is invalid, a sequence lacks frames, or there is only one sequence.
    FileFormatError
        If no name matches the pattern.
    """
    search = _FOUND if pattern is None else _compiled(pattern)
    return [_arranged(group, search, pattern) for group in groups]


def _compiled(pattern: object) -> re.Pattern[str]:
    parts = re.split(r"\{(\w*)\}", pattern) if isinstance(pattern, str) else []
    if sorted(parts[1::2]) != ["frame", "seed"]:
        raise ParameterError(
            Parameter("sequence"),
            f" is {shown(pattern)}; give names with {{seed}} and {{frame}} once each, such "
            "as 'shot_s{seed}_t{frame}.exr'.",
        )
    text = "".join(
        _NAMES[part] if k % 2 else re.escape(part).replace(r"\*", "[^/]*")
        for k, part in enumerate(parts)
    )
    return re.compile(rf"(?:^|/){text}$")


def _arranged(group: FrameFiles, search: re.Pattern[str], pattern: str | None) -> FrameFiles:
    # Find the seed and the number of each frame in its name
    found: dict[str, dict[int, Path]] = {}
    for file in group.files:
        match = search.search(file.stem if pattern is None else file.as_posix())
        if match is None:
            if pattern is None:
                return group
            raise FileFormatError(
                f"{file} does not match the sequence {shown(pattern)}; change the pattern, or give "
                "only files that match it."
            )
        own = found.setdefault(match["seed"], {})
        number = int(match["frame"])
        if number in own:
            raise ParameterError(
                f"{file} and {own[number]} are the same frame of one sequence; give it once."
            )
        own[number] = file
    frames = sorted({number for own in found.values() for number in own})
    if len(frames) < 2 and pattern is None:
        return group
    if len(found) < 2 or len(frames) < 2:
        raise ParameterError(
            f"There {'is' if len(found) == 1 else 'are'} {counted(len(found), 'sequence')} of "
            f"{counted(len(frames), 'frame')}, such as {group.files[0]}; give two or more "
            "sequences of two or more frames, each with seeds of its own."
        )
    for seed, own in found.items():
        if missing := [number for number in frames if number not in own]:
            raise ParameterError(
                f"The sequence of seed {seed} has no frame {missing[0]}, but another sequence has; "
                "give the same frames of every sequence."
            )
    return replace(
        group,
        files=[own[number] for _, own in sorted(found.items()) for number in frames],
        times=len(frames),
        numbers=tuple(frames),
    )


def stored_array(shape: Sequence[int], kind: Any) -> Array:
    """Return an array of zeros in memory, or in a temporary file if it is large."""
    size = int(np.prod(shape)) * np.dtype(kind).itemsize
    if size <= _IN_MEMORY:
        return np.zeros(tuple(shape), kind)
    file = tempfile.TemporaryFile()  # noqa: SIM115 - the array keeps the file open
    return np.memmap(file, dtype=kind, mode="w+", shape=tuple(shape))


@final
@dataclass(frozen=True, kw_only=True)
class Temporal:
    """Correlations of the errors of an image over time, with intervals from the sequences.

    Attributes
    ----------
    frequency
        Temporal frequencies, in cycles per frame.
    joint
        Power by radial and temporal frequency (radius, frequency); 1 for white noise.
    correlation, correlation_ci
        Correlation of errors by lag in frames (lag,), and its interval (lag, bound).
    boiling, boiling_ci
        Mean power below 1/8 cycle per frame; 1 for white noise.
    effective, effective_ci
        Number of independent frames whose mean has the same variance as the mean of a sequence.
    pixels
        Effective number of frames of each pixel, averaged over a square of `window` pixels.
    frames_for_squares
        A sequence gives the mean squared error as accurately as this number of independent frames.
    """

    frequency: Array
    joint: Array
    correlation: Array
    correlation_ci: Array
    boiling: float
    boiling_ci: Array
    effective: float
    effective_ci: Array
    pixels: Array
    window: int
    frames_for_squares: float


def temporal_of(found: TimeStatistics, m2: Array, count: int) -> Temporal:
    """Return correlations over time.

    Parameters
    ----------
    found
        Statistics that were collected from all sequences.
    m2
        Sum over frames and sequences of the squared errors of each pixel, (y, x).
    count
        Number of sequences.

    Notes
    -----
    With correlations ρ_k, the mean of T frames has the variance σ² / T · (1 + 2 Σ (1 − k/T) ρ_k).
    """
    times, lags, rings = found.times, np.arange(found.times), found.rings
    each = np.stack(found.joint)
    each *= m2.size / float(each[:, :, 0].sum(axis=1).mean())  # scale the powers to the mean 1
    pooled = each.mean(axis=0)
    whole = each.sum(axis=1) / float(pooled[:, 0].sum())  # correlations over time in each sequence
    fade = 1.0 - lags / times
    frequency = np.arange(times // 2 + 1) / times
    waves = 2.0 * fade * np.cos(2 * np.pi * np.multiply.outer(frequency, lags))
    waves[:, 0] = 1.0
    power = np.maximum(pooled[:-1] @ waves.T, 0.0) / rings.sizes[:, None]

    # The error is at least that of normal noise, because few sequences may agree by chance
    ring_power = np.nan_to_num(pooled[:-1, 0] / rings.sizes)
    alike = max(1.0, float(np.nansum(rings.sizes * ring_power**2) / np.nansum(rings.sizes)))
    one = math.sqrt(alike / ((m2 > 0).sum() * (count - 1)))
    rho = whole.mean(axis=0)
    squares = float((waves[0] * rho**2).sum())
    frames_for_squares = float(np.clip(times / squares, 1.0, times))

    def ends(values: Array, floor: Array | float) -> tuple[Array, Array]:
        """Return ratios to the total power, and half widths of their intervals."""
        mean = values.mean(axis=0)
        apart = values - np.multiply.outer(whole[:, 0], mean)
        half = deviations_t(count) * apart.std(axis=0, ddof=1) / math.sqrt(count)
        return mean, np.maximum(half, CONFIDENCE_Z * floor)

    rho, half = ends(whole, one * np.sqrt(times / frames_for_squares / (times - lags)))
    half[0] = 0.0
    low = frequency < _SLOW
    both = np.where((frequency > 0) & (frequency < 0.5), 2.0, 1.0)[low]
    # For normal noise, power has the same relative error at every frequency
    slow, slow_half = ends((whole @ waves[low].T) @ both / both.sum(), 0.0)
    zero, zero_half = ends(whole @ waves[0], 0.0)
    relative = CONFIDENCE_Z * math.sqrt(2.0) * one
    boiling, boiling_ci = _factor(float(slow), max(float(slow_half), relative * float(slow)))
    inverse, inverse_ci = _factor(float(zero), max(float(zero_half), relative * float(zero)))

    # Average the effective numbers of frames over squares until their error is about 20 %
    variance = m2 / (times * (count - 1))
    varied = variance > 0
    share = np.divide(found.sums / (count - 1), variance, out=np.zeros_like(variance), where=varied)
    window = math.ceil(math.sqrt(2.0 * alike / (count - 1)) / _PIXEL_ERROR)
    window = min(window | 1, _WIDEST)
    near = uniform_filter(np.stack([share, varied.astype(float)]), (0, window, window))
    with np.errstate(invalid="ignore", divide="ignore"):
        pixels = np.where(varied & (near[0] > 0), near[1] / near[0], np.nan)
    return Temporal(
        frequency=frequency,
        joint=power,
        correlation=rho,
        correlation_ci=np.stack([rho - half, rho + half], axis=-1),
        boiling=boiling,
        boiling_ci=boiling_ci,
        effective=times / inverse,
        effective_ci=times / inverse_ci[::-1],
        pixels=pixels,
        window=window,
        frames_for_squares=frames_for_squares,
    )


def _factor(value: float, half: float) -> tuple[float, Array]:
    """Return a positive value and its interval, which is symmetric on a logarithmic axis.

    If the error `half` exceeds the value, the upper end is limited to `value` + 2 `half`.
    """
    value = max(value, 1e-12)
    factor = math.exp(min(half / value, 50.0))
    return value, np.array([value / factor, min(value * factor, value + 2.0 * half)])


@final
class TimeStatistics:
    """Statistics over time of the errors of sequences, one sequence at a time.

    Attributes
    ----------
    left
        Covariance of the errors at each lag in frames, after each filter in space.
        The dims are (sequence, filter, lag). The first filter leaves pixels unchanged.
    joint
        Covariance of transformed errors at each lag in frames, summed over rings of frequencies.
        The dims are (sequence, radius, lag).
        Errors are divided by the standard deviation in a square of pixels around each pixel.
        Division by a pixel's own standard deviation, which depends on its errors, would be biased.
        The last row holds the frequencies outside all rings, so the rows contain all frequencies.
    sums
        For each pixel (y, x): the squared time average of its error, summed over sequences.
    """

    def __init__(self, times: int, space: SpatialPower, rings: Rings, variance: Array) -> None:
        self.times, self._space, self.rings = times, space, rings
        known = variance > 0
        near = uniform_filter(
            np.stack([np.where(known, variance, 0.0), known]), (0, *2 * [_WIDEST])
        )
        self._weight = np.zeros(space.size)
        np.divide(np.sqrt(near[1]), np.sqrt(near[0]), out=self._weight, where=known)
        height, width = space.size
        self._raw = stored_array((times, space.shape[0], space.shape[1] // 2 + 1), np.complex64)
        self._unit = stored_array((times, height, width // 2 + 1), np.complex64)
        self._total = np.zeros(space.size)
        self.left: list[Array] = []
        self.joint: list[Array] = []
        self.sums = np.zeros(space.size)

    def add(self, time: int, transform: Array, error: Array) -> None:
        """Add a frame: its errors, and their transform with a margin of zeros."""
        from scipy.fft import rfft2

        self._raw[time] = transform
        self._unit[time] = rfft2(error * self._weight)
        self._total += error

    def finish(self) -> None:
        """Complete a sequence, after all of its frames are added."""
        from scipy.fft import next_fast_len

        self.sums += (self._total / self.times) ** 2
        self._total[...] = 0.0
        length = next_fast_len(2 * self.times)
        pairs = self.times - np.arange(self.times)
        left: Any = 0.0
        for rows, power in _powers(self._raw, length):
            left = left + self._space.left(power, rows)
        self.left.append(_lags(left, self.times) / pairs)

        joint = np.zeros((length, self.rings.sizes.size + 1))
        for rows, power in _powers(self._unit, length):
            joint += self.rings.sums(power, rows)
        self.joint.append(_lags(joint, self.times) / pairs)


def _powers(transforms: Array, length: int) -> Any:
    """Yield rows of frequencies, and the power of their values over time, padded with zeros."""
    from scipy.fft import fft

    _, height, width = transforms.shape
    step = max(1, _BLOCK // (length * width))
    for first in range(0, height, step):
        rows = slice(first, min(first + step, height))
        block = np.asarray(transforms[:, rows])
        yield rows, np.abs(fft(block, n=length, axis=0)).astype(float) ** 2


def _lags(power: Array, count: int) -> Array:
    """Return sums over pairs of frames at each lag (…, lag), from the power over time (ω, …)."""
    # An image stores only half of its frequencies: the other half has the opposite ω
    both = 0.5 * (power + np.roll(power[::-1], 1, axis=0))
    return np.asarray(np.fft.ifft(both, axis=0).real[:count].T)
