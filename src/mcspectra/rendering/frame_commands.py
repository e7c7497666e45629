"""Filter frames with a program, such as a denoiser, and measure the error that remains.

A nonlinear filter has no transfer function, so its error cannot be predicted from a spectrum.
Every frame is filtered instead. The error has two parts: variance and squared bias.
The variance is measured over the filtered frames.
The bias is the mean of the filtered frames minus a reference.
Without a reference, the mean of the unfiltered frames is used, because this mean is unbiased.
"""

from __future__ import annotations

import math
import os
import re
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
from mcspectra.core.confidence import student_t
from mcspectra.core.display import shown
from mcspectra.core.errors import Parameter, ParameterError, reason_of
from mcspectra.core.progress import report
from mcspectra.core.trust import words_of
from mcspectra.rendering.frame_files import FrameReader

__all__ = ["Denoised", "command_words", "denoised"]

_PLACEHOLDER = re.compile(r"\{(\w*)\}")
_FEWEST = 3  # smallest number of frames for which an interval is computed


@final
@dataclass(frozen=True, kw_only=True)
class Denoised:
    """Error after a program, as means over the pixels, with 95 % intervals.

    Attributes
    ----------
    variance, variance_ci
        Variance of a filtered frame.
    bias, bias_ci
        Mean over the pixels of the squared bias; the estimate is unbiased and may be negative.
    """

    variance: float
    variance_ci: Array
    bias: float
    bias_ci: Array


def command_words(command: object) -> list[str]:
    """Return the words of a command, and check that it names its input and its output.

    Raises
    ------
    ParameterError
        If the command is not text, or lacks ``{input}`` or ``{output}``.
    """
    words = words_of(command) if isinstance(command, str) else None
    named = {name for word in words or () for name in _PLACEHOLDER.findall(word)}
    if not words or named != {"input", "output"}:
        raise ParameterError(
            Parameter("filter_command"),
            f" is {shown(command)}; give a program with {{input}} and {{output}}, "
            "such as 'denoise --hdr {input} -o {output}', with quotes closed.",
        )
    return list(words)


def denoised(
    words: Sequence[str], files: Sequence[Path], read: FrameReader, truth: Array | None, wait: float
) -> Denoised:
    """Filter every frame with a program, without a shell, and measure the error that remains.

    Parameters
    ----------
    words
        Words of the command, from `command_words`.
    files
        Frames of one view.
    read
        Reader of image files, for the frames and for the output of the program.
    truth
        Reference (y, x), or None for the mean of the frames.
    wait
        Longest time of one run in seconds.

    Raises
    ------
    ParameterError
        If the program fails, takes longer, or writes no frame of the size of its input.
    """
    count = len(files)
    with tempfile.TemporaryDirectory(prefix="mcspectra-") as folder:
        outputs = [Path(folder) / f"{k}{file.suffix}" for k, file in enumerate(files)]
        total: Any = 0.0
        apart: Any = 0.0
        for k, (file, output) in enumerate(zip(files, outputs, strict=True)):
            _run(words, file, output, wait)
            raw, color = read.plane(file, None)
            plane = read.plane(output, color.shape)[0]
            total = total + plane / count
            apart = apart + (plane - (raw if truth is None else truth)) / count
            report("filter", (k + 1) / (2 * count))
        # Sum squared deviations for the variance.
        # Also sum products, from which the jackknife computes the error of the squared bias
        squares, own, cross = np.empty((3, count))
        for k, (file, output) in enumerate(zip(files, outputs, strict=True)):
            plane = read.plane(output, None)[0]
            difference = plane - (read.plane(file, None)[0] if truth is None else truth)
            squares[k] = np.nanmean((plane - total) ** 2) * count / (count - 1)
            own[k] = np.nanmean(difference**2)
            cross[k] = np.nanmean(difference * apart)
            report("filter", (count + k + 1) / (2 * count))
    mean_square = float(np.nanmean(apart**2))
    bias = (count**2 * mean_square - own.sum()) / (count * (count - 1))
    variance = float(squares.mean())
    if count < _FEWEST:
        return Denoised(
            variance=variance,
            variance_ci=np.array([0.0, np.inf]),
            bias=float(bias),
            bias_ci=np.array([0.0, np.inf]),
        )
    # Jackknife: estimates that leave out one frame each
    left = (count**2 * mean_square - 2 * count * cross + own) - (own.sum() - own)
    left /= (count - 1) * (count - 2)
    error = math.sqrt((count - 1) / count * float(((left - left.mean()) ** 2).sum()))
    half = student_t(count) * squares.std(ddof=1) / math.sqrt(count) / (variance or 1.0)
    return Denoised(
        variance=variance,
        variance_ci=variance * np.exp([-half, half]),
        bias=float(bias),
        bias_ci=bias + student_t(count) * error * np.array([-1.0, 1.0]),
    )


def _run(words: Sequence[str], file: Path, output: Path, wait: float) -> None:
    """Run the program on one frame, and end all of its processes if it takes too long."""
    values = {"input": str(file.resolve()), "output": str(output)}
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
    if not output.exists():
        raise ParameterError(
            f"{shown(words[0])} wrote no file for {file}; it must write {{output}}, which has the "
            "extension of the frame."
        )
