"""Errors and warnings. Each message says what was given, what is allowed and what to do.

Every error that a user can cause derives from `McspectraError`.
The command line prints the error as one sentence and exits with code 2.
Errors about values also derive from `ValueError` or another built-in class that fits.
Code outside this package can therefore catch its errors by built-in classes.

A message consists of parts: text, options (`Parameter`) and public functions (`Function`).
For example: ``ParameterError(Parameter("bins"), " is 0; give more.")``.
Python shows ``bins is 0; give more.``; the command line shows ``--bins is 0; give more.``
"""

from __future__ import annotations

import difflib
import errno
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias, final

from mcspectra.core.display import printable

__all__ = [
    "MEASURE_IT",
    "AnalysisError",
    "BudgetError",
    "CacheWarning",
    "ConfigError",
    "CorrelatedFrequenciesWarning",
    "CountError",
    "DamagedResultsWarning",
    "DensityError",
    "DependentRealizationsWarning",
    "DomainError",
    "FileFormatError",
    "Function",
    "IncompleteImageWarning",
    "InfiniteVarianceWarning",
    "InfiniteWeightVarianceWarning",
    "LargeStudyWarning",
    "McspectraError",
    "MissingDependency",
    "MissingPackageWarning",
    "NoClosedForm",
    "NoGainWarning",
    "NotPowerOfTwoWarning",
    "OtherVersionsWarning",
    "Parameter",
    "ParameterError",
    "Part",
    "PreasymptoticWarning",
    "SlowSamplerWarning",
    "SpecError",
    "StorageError",
    "StoreError",
    "UndefinedRatioWarning",
    "UnknownName",
    "close_match_hint",
    "point_in_words",
    "reason_of",
    "warn",
    "writing",
]

_PACKAGE = str(Path(__file__).parents[1]) + os.sep
_FAILING = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)
_COORDINATES = 6  # largest number of coordinates of a point that a message shows
# Largest number of characters of a message. The package's own messages have at most 350
_LONGEST = 1000


@final
@dataclass(frozen=True, slots=True)
class Parameter:
    """An option in a message. The text is its name ``bins``, or with a value ``bins=100``."""

    name: str
    value: Any = None

    def __str__(self) -> str:
        """Return the name as in Python code."""
        return self.name if self.value is None else f"{self.name}={self.value!r}"


@final
@dataclass(frozen=True, slots=True)
class Function:
    """A public function in a message. The text is the name that `mcspectra` exports."""

    name: str

    def __str__(self) -> str:
        """Return the name as in Python code."""
        return self.name


class McspectraError(Exception):
    """Base class of all errors that this package raises on purpose.

    `args` are the parts of the message: texts, options, functions and other errors.
    The parts can contain untrusted text, such as names and paths.
    The message is one printable line.
    """

    def __str__(self) -> str:
        """Return the message for Python."""
        return self.sentence(str)

    def sentence(self, write: Callable[[Parameter | Function], str]) -> str:
        """Return the message. The function `write` formats options and functions."""
        parts = []
        for part in self.args:
            if isinstance(part, McspectraError):
                parts.append(part.sentence(write))
            else:
                parts.append(write(part) if isinstance(part, Parameter | Function) else str(part))
        return printable("".join(parts), _LONGEST)


Part: TypeAlias = str | Parameter | Function | McspectraError
"""A part of the message of an error: a text, an option, a function or another error."""


class ParameterError(McspectraError, ValueError):
    """A parameter has the wrong type, shape or range."""


class DomainError(ParameterError):
    """Points are outside [0,1)^d, not finite, or of the wrong shape."""


class CountError(ParameterError):
    """A sampler cannot make this number of points. `nearest` holds the nearest possible numbers."""

    def __init__(self, message: Part, nearest: tuple[int, ...] = ()) -> None:
        super().__init__(message)
        self.nearest = nearest


class BudgetError(ParameterError):
    """A request needs more function calls than allowed. The function was not called."""


class DensityError(ParameterError):
    """A density is invalid: not positive where it must be, or pdf, sample and invert disagree."""


class SpecError(ParameterError):
    """A spec string such as ``jittered(...) | shift`` cannot be read."""


class UnknownName(SpecError):
    """A name is not registered. `close` holds similar registered names."""

    def __init__(self, message: str, close: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.close = close


class ConfigError(ParameterError):
    """A study file is not valid."""


class FileFormatError(McspectraError, ValueError):
    """A file is missing, empty, truncated, or its content does not match its name."""


class StoreError(McspectraError, RuntimeError):
    """A result store exists already, is incomplete or belongs to another study."""


class StorageError(StoreError):
    """Results cannot be written: the disk is full, a quota is reached, or the device fails."""


class AnalysisError(McspectraError, TypeError):
    """An analysis breaks its contract. The author of the analysis has to fix it."""


class NoClosedForm(McspectraError, NotImplementedError):
    """No closed form is known for this combination. Simulate instead."""


class MissingDependency(McspectraError, ImportError):
    """An optional package is needed. The message names the extra that installs it."""


MEASURE_IT: tuple[Part, ...] = (Function("convergence"), " or ", Function("variance_terms"))
"""Names of functions that simulate a variance. Messages name them if no closed form is known."""


class CorrelatedFrequenciesWarning(UserWarning):
    """The variance is not a sum over powers alone: the frequencies of this set are correlated."""


class CacheWarning(UserWarning):
    """A cache entry is damaged, or the cache cannot be written. Results are the same."""


class DependentRealizationsWarning(UserWarning):
    """Realizations of a seed are not independent, so variances and standard errors are wrong."""


class MissingPackageWarning(UserWarning):
    """A file is not written because an optional package is missing. The results are complete."""


class NotPowerOfTwoWarning(UserWarning):
    """A digital net loses its balance at counts that are not powers of its base."""


class InfiniteWeightVarianceWarning(UserWarning):
    """∫1/p diverges: Var(S_0) is infinite, although the variance of the estimate may be finite."""


class InfiniteVarianceWarning(UserWarning):
    """f grows so fast that its variance is infinite: no interval of its integral is valid."""


class PreasymptoticWarning(UserWarning):
    """A fitted exponent still changes over the range of the fit and has not reached its limit."""


class UndefinedRatioWarning(UserWarning):
    """f and p are both 0 at a sample. The ratio f/p counts as 0, although its limit may differ."""


class DamagedResultsWarning(UserWarning):
    """Stored results of an earlier run are damaged. Damaged results are named and recomputed."""


class OtherVersionsWarning(UserWarning):
    """A run continues earlier results with other versions of packages that affect the numbers."""


class LargeStudyWarning(UserWarning):
    """Planning a study takes long, before its first analysis begins."""


class IncompleteImageWarning(UserWarning):
    """A rendered image omits an effect of the scene: lens blur, a light, or a specular surface."""


class SlowSamplerWarning(UserWarning):
    """The user's program takes long to print points. The message gives the estimated time."""


class NoGainWarning(UserWarning):
    """A search found nothing better than the usual choice, and returns that choice."""


def close_match_hint(
    given: str, allowed: Iterable[str], command: str = ""
) -> tuple[str, tuple[str, ...]]:
    """Return a hint such as `` Did you mean 'x'?``, and the names that are close to `given`.

    If no name is close, the hint lists all names.
    If the list would be long, the hint gives the number of names, and `command`, which prints them.
    """
    names = sorted(allowed)
    close = tuple(difflib.get_close_matches(given, names, n=3, cutoff=0.5))
    if close:
        return f" Did you mean {' or '.join(map(repr, close))}?", close
    if len(names) <= 12:
        return f" Allowed: {', '.join(names)}.", close
    shown = f"; {command!r} shows them" if command else ""
    return f" There are {len(names)} names{shown}.", close


def point_in_words(point: Iterable[float]) -> str:
    """Return a point as ``(0.1, 0.25)``. A long point is cut, and its number of dims is added."""
    coordinates = [f"{float(c):.6g}" for c in point]
    more = len(coordinates) - _COORDINATES
    shown = ", ".join(coordinates[:_COORDINATES])
    return f"({shown}, … {more} more)" if more > 0 else f"({shown})"


def reason_of(error: BaseException, most: int = 1000) -> str:
    """Return the message of an error in one line without a full stop, or the name of its class.

    The message is cut to `most` characters.
    """
    try:
        words = str(error)[: 2 * most]
    except BaseException:  # noqa: BLE001 - code outside the package may raise anything
        words = ""
    shown = printable(" ".join(words.split()))
    return shown[:most].rstrip(".") or type(error).__name__


@contextmanager
def writing(
    path: str | PathLike[str], kind: type[McspectraError] = FileFormatError
) -> Iterator[None]:
    """Convert an OSError from writing a file to an error of the class `kind`.

    If the disk is full or fails, the error is a StorageError: the input is not the cause.
    """
    try:
        yield
    except OSError as error:
        found = StorageError if error.errno in _FAILING else kind
        raise found(f"{str(path)!r} cannot be written: {error.strerror or error}.") from None


def warn(message: str, category: type[Warning]) -> None:
    """Warn at the line that called the package: the first frame outside of the package's files.

    Since Python 3.12, `warnings.warn` can also find the first frame outside of the package:
    its argument `skip_file_prefixes` gives the folders of the skipped files.
    A fixed number of skipped stack frames would be wrong after changes of this package.
    """
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        frame = frame.f_back
    warnings.warn_explicit(
        printable(message, _LONGEST),
        category,
        frame.f_code.co_filename,
        frame.f_lineno,
        module=frame.f_globals.get("__name__", "<unknown>"),
        registry=frame.f_globals.setdefault("__warningregistry__", {}),
    )
