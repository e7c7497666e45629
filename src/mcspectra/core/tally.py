"""Evaluations of users' functions, counted and limited: every call of one is spent here first.

`counting` opens a tally, which sees all that is spent inside of it, in this thread and in those of
`mcspectra.core.parallel`; tallies may stand within each other. A limit holds before the function is
called. Work that goes on without what was refused, as another method of a prediction, is made in vain:
`EvaluationTally.check` says at the end that a limit was met.
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
    """Evaluations that something made, and the most that it may, None for any number."""

    what: str | Function
    most: int | None = None
    outer: EvaluationTally | None = None
    made: int = 0
    refused: int = 0  # how many would have been made, where the limit was met

    def foresee(self, evaluations: int) -> None:
        """Raise BudgetError where so many more are beyond the most."""
        if self.most is not None and self.made + evaluations > self.most:
            self.refused = max(self.refused, self.made + evaluations)
            self.check()

    def check(self) -> None:
        """Raise BudgetError where evaluations were refused."""
        if self.refused:
            raise BudgetError(
                self.what,
                f" takes at least {self.refused} evaluations of the integrand, and ",
                Parameter("max_evaluations"),
                f" is {self.most}; allow more, or ask for less.",
            )


_innermost: ContextVar[EvaluationTally | None] = ContextVar("tally", default=None)


@contextmanager
def counting(what: str | Function, most: int | None = None) -> Iterator[EvaluationTally]:
    """Count the evaluations that `what` makes inside, `most` of them at most, an integer from 1 or None."""
    most = None if most is None else as_integer("max_evaluations", most, least=1)
    tally = EvaluationTally(what, most, _innermost.get())
    token = _innermost.set(tally)
    try:
        yield tally
    finally:
        _innermost.reset(token)


def spend(evaluations: int) -> None:
    """Say that a function is about to be called at so many points.

    Raises
    ------
    BudgetError
        A tally does not allow them; none counts them.
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
