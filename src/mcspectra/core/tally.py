"""Counts and limits of evaluations of users' functions. Calls are counted before they are made.

`counting` opens a tally: a counter of all evaluations inside its block.
The counter includes evaluations in this thread and in threads of `mcspectra.core.parallel`.
Tallies can be nested.
The limit is checked before the function is called.
After a call is rejected, the computation may continue: a prediction may try another method.
The result of the computation is discarded: in the end, `EvaluationTally.check` raises an error.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import final

from mcspectra.core.checks import as_integer
from mcspectra.core.errors import BudgetError, Function, Parameter

__all__ = ["EvaluationTally", "counting", "spend"]

_lock = threading.Lock()


@final
@dataclass
class EvaluationTally:
    """Number of evaluations of a computation, and its limit `most`. None means no limit."""

    what: str | Function
    most: int | None = None
    outer: EvaluationTally | None = None
    made: int = 0
    # Largest number of evaluations that a rejected call would have reached; 0 without such a call
    refused: int = 0

    def foresee(self, evaluations: int) -> None:
        """Raise BudgetError if `evaluations` more would exceed the limit."""
        if self.most is not None and self.made + evaluations > self.most:
            self.refused = max(self.refused, self.made + evaluations)
            self.check()

    def check(self) -> None:
        """Raise BudgetError if evaluations were rejected."""
        if self.refused:
            raise BudgetError(
                self.what,
                f" takes at least {self.refused} evaluations of the integrand, and ",
                Parameter("max_evaluations"),
                f" is {self.most}; allow more, or reduce the task.",
            )


_innermost: ContextVar[EvaluationTally | None] = ContextVar("tally", default=None)


@contextmanager
def counting(what: str | Function, most: int | None = None) -> Iterator[EvaluationTally]:
    """Count the evaluations inside the block. `most` is their limit, at least 1, or None."""
    most = None if most is None else as_integer("max_evaluations", most, least=1)
    tally = EvaluationTally(what, most, _innermost.get())
    token = _innermost.set(tally)
    try:
        yield tally
    finally:
        _innermost.reset(token)


def spend(evaluations: int) -> None:
    """Count a number of evaluations of a function, before the evaluations are made.

    Raises
    ------
    BudgetError
        If the evaluations would exceed the limit of a block of `counting`.
        Rejected evaluations are not counted in any block of `counting`.
    """
    with _lock:
        tally = _innermost.get()
        while tally is not None:
            tally.foresee(evaluations)
            tally = tally.outer
        tally = _innermost.get()
        while tally is not None:
            tally.made += evaluations
            tally = tally.outer
