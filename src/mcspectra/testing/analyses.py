"""The contract of analyses: declared options and variables, cheap needs, the same bits in any chunks."""

from __future__ import annotations

import math
import time
from typing import Any

from mcspectra.core.analysis import (
    Analysis,
    MergeTree,
    Need,
    Reduction,
    Subject,
    check_names,
    chunks,
    compute_chunk,
    finished,
    steps_of,
)
from mcspectra.core.errors import AnalysisError, ParameterError
from mcspectra.core.options import checked, options_of
from mcspectra.core.records import pack, unpack
from mcspectra.core.streams import Stream
from mcspectra.testing.contract import BrokenContract, called, demand

__all__ = ["check_analysis"]

_SEED = 7
_NEED_SECONDS = 0.1  # studies ask it of every pair of estimator and sampler
_SIZE = 2  # blocks of a chunk


def check_analysis(analysis: Analysis, estimator: Any = None, sampler: Any = "jittered") -> None:
    """Check an analysis against the contract of all analyses.

    Parameters
    ----------
    analysis
        The analysis with options that are quick to compute; of more than one block, so that
        merging is tried too.
    estimator, sampler
        Subject of the check, or specs of it: an estimator or integrand, `gaussian` in two dims by
        default, and a sampler; lists for analyses that take them.

    Raises
    ------
    BrokenContract
        An option has no meaning, a name that is taken or a default that its own limits refuse; `need` raises, is slow or not
        finite; keys repeat or `part` does not find them; states do not survive as bytes; the result
        depends on chunks, differs for the same seed, or has variables that are not declared.

    Examples
    --------
    >>> from mcspectra.variance.convergence import Convergence
    >>> check_analysis(Convergence(counts=(4, 16), realizations=50))
    """
    if not isinstance(analysis, Analysis):
        raise ParameterError(f"{analysis!r:.80} is no analysis; give one with its options.")
    who = type(analysis).__name__
    subject = _subject(analysis, estimator, sampler)
    clean = _check_options(analysis, who)
    _check_need(clean, subject, who)
    first = _computed(clean, subject, who, size=0)
    again = _computed(clean, subject, who, size=_SIZE)
    demand(
        pack(first) == pack(again),
        who,
        "gives different results in chunks, or for the same seed",
    )


def _subject(analysis: Analysis, estimator: Any, sampler: Any) -> Subject:
    from mcspectra.estimators import as_subject

    subject = as_subject("gaussian" if estimator is None else estimator, sampler, lists=True)
    return subject if analysis.about == "estimator" else Subject(None, subject.sampler)


def _check_options(analysis: Analysis, who: str) -> Analysis:
    demand(bool(type(analysis).summary()), who, "has no docstring; its first line is the summary")
    try:
        check_names(type(analysis))
    except AnalysisError as error:
        raise BrokenContract(str(error)) from error
    for option in options_of(type(analysis)):
        demand(bool(option.meaning), who, f"has the option {option.name} without a meaning")
        if not option.required:
            called(who, f"the default of {option.name}", option.check, option.default)
    clean: Analysis = called(who, "its options", checked, analysis)
    return clean


def _check_need(analysis: Analysis, subject: Subject, who: str) -> None:
    start = time.process_time()
    need = called(who, "need", analysis.need, subject)
    demand(isinstance(need, Need), who, f"returns {need!r} from need, not a Need")
    finite = math.isfinite(need.cost) and need.cost >= 0 and need.memory >= 0
    demand(finite, who, f"returns {need!r} from need, which is not finite")
    spent = time.process_time() - start
    demand(spent < _NEED_SECONDS, who, f"takes {spent:.2g} s in need")


def _computed(analysis: Analysis, subject: Subject, who: str, size: int) -> Any:
    """The result, with states of single blocks, or of chunks of `size` made by `part` and as bytes."""
    stream = Stream.from_rng(_SEED)
    steps = steps_of(analysis, subject, stream)
    states: list[Any] | None = None
    try:
        while True:
            found = next(steps) if states is None else steps.send(states)
            states = []
            for each in found:
                part = called(who, "part", analysis.part, subject, stream, each.key)
                states.append(_merged(part if size else each, who, size))
    except AnalysisError as error:
        raise BrokenContract(str(error)) from error
    except StopIteration as end:
        return called(who, "its variables", finished, analysis, end.value, _SEED)


def _merged(reduction: Reduction[Any], who: str, size: int) -> Any:
    tree: MergeTree[Any] = MergeTree()
    for chunk in chunks(reduction.blocks, size or 1):
        state = called(who, "block", compute_chunk, reduction, chunk)
        if size:
            payload = called(who, "a state as bytes", pack, state)
            state = called(who, "a state from bytes", unpack, reduction.kind, payload)
            demand(
                pack(state) == payload, who, "has a state that changes when it is stored as bytes"
            )
        called(who, "merging states", tree.add, state, chunk[1])
    return called(who, "merging states", tree.total)
