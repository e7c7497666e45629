"""Filter frames with a program, such as a denoiser, and measure the error that remains.

A nonlinear filter has no transfer function, so its error cannot be predicted from a spectrum.
Every frame is filtered instead. The error has two parts: variance and squared bias.
The variance is measured over the filtered frames.
The bias is the mean of the filtered frames minus a reference.
Without a reference, the mean of the unfiltered frames is used instead, because it is unbiased.

Filters that use earlier frames, such as temporal denoisers, get all frames of a sequence.
Each sequence is then filtered alone. Errors are deviations from the mean over the sequences.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import deviations_t, student_t
from mcspectra.core.display import shown
from mcspectra.core.errors import Parameter, ParameterError, reason_of
from mcspectra.core.images import Rings
from mcspectra.core.progress import report
from mcspectra.core.trust import words_of
from mcspectra.rendering.frame_files import FrameFiles, FrameReader
from mcspectra.rendering.frame_filters import Chain, SpatialPower
from mcspectra.rendering.frame_references import References
from mcspectra.rendering.frame_sequences import (
    Temporal,
    TimeStatistics,
    stored_array,
    temporal_of,
)

__all__ = ["Denoised", "command_words", "denoised", "takes_sequences"]

_PLACEHOLDER = re.compile(r"\{(\w*)\}")
_ONE, _ALL = ("input", "output"), ("inputs", "outputs")
_FEWEST = 3  # smallest number of frames for which an interval is computed


@final
@dataclass(frozen=True, kw_only=True)
class Denoised:
    """Error of frames that a program has filtered, as means over pixels and frames, with intervals.

    Attributes
    ----------
    variance, variance_ci
        Variance of a filtered frame.
    bias, bias_ci
        Mean over the pixels of the squared bias; the estimate is unbiased and may be negative.
    temporal
        Correlations over time of the errors of filtered frames; None without sequences.
    """

    variance: float
    variance_ci: Array
    bias: float
    bias_ci: Array
    temporal: Temporal | None


def command_words(command: object) -> list[str]:
    """Return the words of a command, and check that it names its input and its output.

    Raises
    ------
    ParameterError
        If the command is not text, or lacks ``{input}`` or ``{output}``.
    """
    words = words_of(command) if isinstance(command, str) else None
    named = {name for word in words or () for name in _PLACEHOLDER.findall(word)}
    if not words or named not in (set(_ONE), set(_ALL)):
        raise ParameterError(
            Parameter("filter_command"),
            f" is {shown(command)}; give a program with {{input}} and {{output}}, "
            "such as 'denoise --hdr {input} -o {output}', with quotes closed, or with the folders "
            "{inputs} and {outputs} of a sequence.",
        )
    return list(words)


def takes_sequences(words: Sequence[str]) -> bool:
    """Whether a command filters all frames of a sequence at once."""
    return any(f"{{{_ALL[0]}}}" in word for word in words)


def denoised(
    words: Sequence[str],
    group: FrameFiles,
    read: FrameReader,
    truth: References | None,
    wait: float,
) -> Denoised:
    """Filter all frames with a program, without a shell, and measure the error that remains.

    Parameters
    ----------
    words
        Words of the command, from `command_words`.
    group
        Frames of one view, or sequences.
    read
        Reader of image files, for the frames and for the output of the program.
    truth
        References, or None for the mean of the frames.
    wait
        Longest time of one run in seconds.

    Raises
    ------
    ParameterError
        If the program fails, takes longer, or writes no frame of the size of its input.
        If the program needs sequences and there are none.
    """
    files, times = group.files, group.times
    count = len(files) // times
    if takes_sequences(words) and times == 1:
        raise ParameterError(
            Parameter("filter_command"),
            f" has {{inputs}}, the folder of a sequence, but {files[0]} and the others are not "
            "sequences; give {input} and {output}, or ",
            Parameter("sequence"),
            ".",
        )
    with tempfile.TemporaryDirectory(prefix="mcspectra-") as folder:
        outputs = _filtered(words, group, Path(folder), wait)
        # Squared deviations, and products for the jackknife of the squared bias
        squares, own, cross = np.empty((3, count, times))
        mean_square = 0.0
        centers: Any = None
        for t in range(times):
            true = None if truth is None else truth.plane(t)
            total: Any = 0.0
            apart: Any = 0.0
            for k in range(count):
                raw, color = read.plane(files[k * times + t], None)
                plane = read.plane(outputs[k * times + t], color.shape)[0]
                total = total + plane / count
                apart = apart + (plane - (raw if true is None else true)) / count
            if centers is None:
                centers = stored_array((times, *total.shape), np.float64)
            centers[t] = total
            mean_square += float(np.nanmean(apart**2)) / times
            for k in range(count):
                plane = read.plane(outputs[k * times + t], None)[0]
                known = read.plane(files[k * times + t], None)[0] if true is None else true
                squares[k, t] = np.nanmean((plane - total) ** 2) * count / (count - 1)
                own[k, t] = np.nanmean((plane - known) ** 2)
                cross[k, t] = np.nanmean((plane - known) * apart)
            report("filter", 0.5 + 0.5 * (t + 1) / times)
        temporal = None if times == 1 else _over_time(outputs, read, centers, count)
    squares, own, cross = (each.mean(axis=1) for each in (squares, own, cross))
    return _measured(squares, own, cross, mean_square, temporal)


def _measured(
    squares: Array, own: Array, cross: Array, mean_square: float, temporal: Temporal | None
) -> Denoised:
    """Return variance and bias with intervals, from means over the pixels for each sequence.

    Parameters
    ----------
    squares
        Squared deviations of filtered frames from their mean, with divisor count − 1.
    own, cross
        Let D be the difference of a sequence from the truth, and let M be the mean of D.
        `own` is D², and `cross` is the product D M, for each sequence.
    mean_square
        M², where M is the mean difference of all sequences from the truth.
    temporal
        Correlations over time of the errors of filtered frames.
    """
    count = len(squares)
    bias = (count**2 * mean_square - own.sum()) / (count * (count - 1))
    variance = float(squares.mean())
    if count < _FEWEST:
        unknown = np.array([0.0, np.inf])
        return Denoised(
            variance=variance,
            variance_ci=unknown,
            bias=float(bias),
            bias_ci=unknown,
            temporal=temporal,
        )
    # Jackknife: estimates that leave out one sequence each
    left = (count**2 * mean_square - 2 * count * cross + own) - (own.sum() - own)
    left /= (count - 1) * (count - 2)
    error = math.sqrt((count - 1) / count * float(((left - left.mean()) ** 2).sum()))
    half = deviations_t(count) * squares.std(ddof=1) / math.sqrt(count) / (variance or 1.0)
    return Denoised(
        variance=variance,
        variance_ci=variance * np.exp([-half, half]),
        bias=float(bias),
        bias_ci=bias + student_t(count) * error * np.array([-1.0, 1.0]),
        temporal=temporal,
    )


def _over_time(
    outputs: Sequence[Path], read: FrameReader, centers: Array, count: int
) -> Temporal | None:
    """Return correlations over time of the errors of filtered frames; None if no error is left."""
    times, height, width = centers.shape

    def error(k: int, t: int) -> Array:
        return np.asarray(np.nan_to_num(read.plane(outputs[k * times + t], None)[0] - centers[t]))

    m2 = np.zeros((height, width))
    for k, t in np.ndindex(count, times):
        m2 += error(k, t) ** 2
    if not m2.any():
        return None
    space = SpatialPower([Chain(())], height, width)
    rings = Rings(height, width)
    found = TimeStatistics(times, space, rings, m2 / (times * (count - 1)))
    for k, t in np.ndindex(count, times):
        each = error(k, t)
        found.add(t, space.transform(each), each)
        if t == times - 1:
            found.finish()
    return temporal_of(found, m2, count)


def _filtered(words: Sequence[str], group: FrameFiles, folder: Path, wait: float) -> list[Path]:
    """Run the program on each frame or each sequence; return its output for every frame."""
    files, times = group.files, group.times
    outputs = []
    if not takes_sequences(words):
        for k, file in enumerate(files):
            output = folder / f"{k}{file.suffix}"
            _run(
                words, dict(zip(_ONE, (str(file.resolve()), str(output)), strict=True)), file, wait
            )
            outputs.append(_written(words, file, output, "{output}"))
            report("filter", (k + 1) / (2 * len(files)))
        return outputs
    for first in range(0, len(files), times):
        own = files[first : first + times]
        inner, outer = folder / f"{first}-in", folder / f"{first}-out"
        inner.mkdir()
        outer.mkdir()
        names = [f"{t:04d}{file.suffix}" for t, file in enumerate(own)]
        for file, name in zip(own, names, strict=True):
            try:
                (inner / name).symlink_to(file.resolve())
            except OSError:  # some file systems and Windows have no links
                shutil.copyfile(file, inner / name)
        _run(words, dict(zip(_ALL, (str(inner), str(outer)), strict=True)), own[0], wait)
        outputs += [
            _written(words, file, outer / name, f"{{outputs}}/{name}")
            for file, name in zip(own, names, strict=True)
        ]
        report("filter", (first + times) / (2 * len(files)))
    return outputs


def _written(words: Sequence[str], file: Path, output: Path, name: str) -> Path:
    """Check that the program has written a file."""
    if not output.exists():
        raise ParameterError(
            f"{shown(words[0])} wrote no file for {file}; it must write {name}, which has the "
            "extension of the frame."
        )
    return output


def _run(words: Sequence[str], values: dict[str, str], file: Path, wait: float) -> None:
    """Run the program once, and end all of its processes if it takes too long.

    The values replace the names in braces in the command. Error messages name the file.
    """
    filled = [_PLACEHOLDER.sub(lambda found: values[found[1]], word) for word in words]
    try:
        process = subprocess.Popen(
            filled,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or reason_of(error, 200)
        raise ParameterError(
            f"The program {shown(words[0])} cannot be run: {reason}; install it, or give its path."
        ) from None
    try:
        _, told = process.communicate(timeout=wait)
    except subprocess.TimeoutExpired:
        raise ParameterError(
            f"{shown(words[0])} took more than {wait:g} s for {file}; give a longer ",
            Parameter("filter_timeout"),
            ", or smaller frames.",
        ) from None
    finally:
        with suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        assert process.stderr is not None
        process.stderr.close()
    if process.returncode:
        lines = told.decode(errors="replace").strip().splitlines()
        said = reason_of(ValueError(lines[-1]), 200) if lines else "it printed no reason"
        raise ParameterError(
            f"{shown(words[0])} ended with exit code {process.returncode} for {file}: {said}."
        )
