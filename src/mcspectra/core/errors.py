"""Errors and warnings: each message says what was given, what is allowed and what to do.

Every error a user can cause derives from `McspectraError`; the command line turns those into one
sentence and exit code 2. Errors about values are also `ValueError` (or the built-in that fits), so
that code which knows nothing of this package can catch them.

A sentence that names an option or a public function has it as a part, a `Parameter` or a `Function`:
``ParameterError(Parameter("bins"), " is 0; give more.")``. Python writes ``bins is 0; give more.``,
the command line ``--bins is 0; give more.``
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
_COORDINATES = 6  # of a point in a message
_LONGEST = 1000  # characters of a message; the longest of our own have 350


@final
@dataclass(frozen=True, slots=True)
class Parameter:
    """An option in a sentence: ``bins``, or with a value ``bins=100``."""

    name: str
    value: Any = None

    def __str__(self) -> str:
        """Return the name as Python code has it."""
        return self.name if self.value is None else f"{self.name}={self.value!r}"


@final
@dataclass(frozen=True, slots=True)
class Function:
    """A public function in a sentence, by its name in `mcspectra`."""

    name: str

    def __str__(self) -> str:
        """Return the name as Python code has it."""
        return self.name


class McspectraError(Exception):
    """Root of all errors raised on purpose by this package.

    `args` are the parts of its sentence: texts, options, functions, and sentences of other errors.
    They hold text of others, such as names and paths: the sentence is one printable line.
    """

    def __str__(self) -> str:
        """Return the sentence for Python."""
        return self.sentence(str)

    def sentence(self, write: Callable[[Parameter | Function], str]) -> str:
        """Return the sentence with options and functions as `write` writes them."""
        parts = []
        for part in self.args:
            if isinstance(part, McspectraError):
                parts.append(part.sentence(write))
            else:
                parts.append(write(part) if isinstance(part, Parameter | Function) else str(part))
        return printable("".join(parts), _LONGEST)


Part: TypeAlias = str | Parameter | Function | McspectraError
"""A part of the sentence of an error."""


class ParameterError(McspectraError, ValueError):
    """A parameter has the wrong type, shape or range."""


class DomainError(ParameterError):
    """Points are outside [0,1)^d, not finite, or of the wrong shape."""


class CountError(ParameterError):
    """A sampler cannot make this many points; `nearest` holds the counts it can make next to it."""

    def __init__(self, message: Part, nearest: tuple[int, ...] = ()) -> None:
        super().__init__(message)
        self.nearest = nearest


class BudgetError(ParameterError):
    """What was asked for takes more calls of a function than were allowed: it was not called."""


class DensityError(ParameterError):
    """A density is not one: not positive where it must be, or pdf, sample and invert disagree."""


class SpecError(ParameterError):
    """A spec string such as ``jittered(...) | shift`` cannot be read."""


class UnknownName(SpecError):
    """A name is not registered; `close` holds names that are."""

    def __init__(self, message: str, close: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.close = close


class ConfigError(ParameterError):
    """A study file is not valid."""


class FileFormatError(McspectraError, ValueError):
    """A file is missing, empty, truncated or not what its name says."""


class StoreError(McspectraError, RuntimeError):
    """A result store exists already, is incomplete or belongs to another study."""


class StorageError(StoreError):
    """Results cannot be written: the disk is full, a quota is reached, the device fails."""


class AnalysisError(McspectraError, TypeError):
    """An analysis, such as another package's, breaks its contract: whoever wrote it has to mend it."""


class NoClosedForm(McspectraError, NotImplementedError):
    """No closed form is known for this combination; simulate instead."""


class MissingDependency(McspectraError, ImportError):
    """An optional package is needed; the message names the extra to install."""


MEASURE_IT: tuple[Part, ...] = (Function("convergence"), " or ", Function("variance_terms"))
"""Functions that measure a variance without a closed form, as parts of a sentence."""


class CorrelatedFrequenciesWarning(UserWarning):
    """A sum over powers alone is not the variance: the frequencies of this set are correlated."""


class CacheWarning(UserWarning):
    """An entry of the cache is damaged, or the cache cannot be written; results are the same."""


class DependentRealizationsWarning(UserWarning):
    """The realizations of a seed are not independent: variances and errors over them mislead."""


class MissingPackageWarning(UserWarning):
    """A file is left out because an optional package is not installed; the results are complete."""


class NotPowerOfTwoWarning(UserWarning):
    """A digital net loses its balance at counts that are not powers of its base."""


class InfiniteWeightVarianceWarning(UserWarning):
    """∫1/p diverges: the variance of S_0 is infinite, although that of the estimate may not be."""


class InfiniteVarianceWarning(UserWarning):
    """f grows so fast that its variance is infinite: no interval of its integral holds."""


class PreasymptoticWarning(UserWarning):
    """A fitted exponent still changes over the range that it is fitted to: it is no limit yet."""


class UndefinedRatioWarning(UserWarning):
    """f and p are both 0 at a sample: f/p counts as 0 there, whatever its limit."""


class DamagedResultsWarning(UserWarning):
    """Stored results of an earlier run are damaged: they are named, and computed again."""


class OtherVersionsWarning(UserWarning):
    """Results of an earlier run go on with other versions of packages that numbers depend on."""


class LargeStudyWarning(UserWarning):
    """A study takes long to plan, before its first analysis begins."""


class IncompleteImageWarning(UserWarning):
    """An image lacks a part of what the scene would show: a lens, a light, a specular surface."""


class NoGainWarning(UserWarning):
    """A search found nothing better than the usual choice, which is its result."""


def close_match_hint(
    given: str, allowed: Iterable[str], command: str = ""
) -> tuple[str, tuple[str, ...]]:
    """Return `` Did you mean 'x'?`` (or all names, when few) and the close matches themselves.

    `command` is what shows all names, for messages where they are many.
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
    """Return ``(0.1, 0.25)``; of many coordinates the first few and their number."""
    coordinates = [f"{float(c):.6g}" for c in point]
    more = len(coordinates) - _COORDINATES
    shown = ", ".join(coordinates[:_COORDINATES])
    return f"({shown}, … {more} more)" if more > 0 else f"({shown})"


def reason_of(error: BaseException, most: int = 1000) -> str:
    """Return what an error says, of `most` characters, on one line without a full stop; or its class."""
    try:
        words = str(error)[: 2 * most]
    except BaseException:  # noqa: BLE001 - whatever the code of others does
        words = ""
    shown = printable(" ".join(words.split()))
    return shown[:most].rstrip(".") or type(error).__name__


@contextmanager
def writing(
    path: str | PathLike[str], kind: type[McspectraError] = FileFormatError
) -> Iterator[None]:
    """Make an error of this kind, one sentence, of what the system says of a file that it cannot write.

    Of a disk that is full or fails, which is not what the user has given, it is a StorageError.
    """
    try:
        yield
    except OSError as error:
        found = StorageError if error.errno in _FAILING else kind
        raise found(f"{str(path)!r} cannot be written: {error.strerror or error}.") from None


def warn(message: str, category: type[Warning]) -> None:
    """Warn at the line that called the package: the first frame whose file is not in it.

    Python 3.12 can do it by `skip_file_prefixes`; a number of frames would change with the code.
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
