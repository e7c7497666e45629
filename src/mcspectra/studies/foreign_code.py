"""Code of others, called while a study is planned: in a thread, within a time, its failures in words.

A Python function that a study names may raise anything, end the program or never come back. Tasks are
guarded by their engines; here is what guards the rest.
"""

from __future__ import annotations

import concurrent.futures
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from mcspectra.core.errors import McspectraError, reason_of
from mcspectra.integrands import Integrand

__all__ = ["FunctionFailed", "TookTooLong", "explain", "probed", "within"]

Result = TypeVar("Result")
_LONGEST = 500  # characters of an exception's own text in a message
_PATIENCE = 30.0  # seconds for a function's first values: one that compiles itself takes several


class TookTooLong(Exception):
    """A job was not done in its time; its thread goes on, as threads cannot be stopped."""


class FunctionFailed(Exception):
    """A Python function of a study fails at its first points: a sentence of why.

    Not one of this package's errors for bad input: it costs the cells of its estimator only.
    """


def within(seconds: float, job: Callable[[], Result]) -> Result:
    """Result of a job in a thread of its own.

    Raises
    ------
    TookTooLong
        It is not done in so many seconds.
    BaseException
        Whatever the job raises.
    """
    result: concurrent.futures.Future[Result] = concurrent.futures.Future()

    def run() -> None:
        try:
            result.set_result(job())
        except BaseException as error:  # noqa: BLE001 - raised again where it is waited for
            result.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    done, _ = concurrent.futures.wait([result], seconds)
    if not done:
        raise TookTooLong
    return result.result()


def probed(function: Callable[[Any], Any], *, dims: int, limit: float | None = None) -> Integrand:
    """Make an integrand of a study's function: `Integrand.from_function`, whatever the function does.

    Parameters
    ----------
    function, dims
        As of `Integrand.from_function`, which calls the function at a few points.
    limit
        Seconds for these; 30 at most.

    Raises
    ------
    FunctionFailed
        It raises, gives something else than finite real numbers, or takes too long.
    """

    def make() -> Integrand:
        try:
            return Integrand.from_function(function, dims=dims)
        # Here, in the thread: an interrupt that reaches the main thread is the user's.
        except BaseException as error:  # noqa: BLE001 - whatever the code of others does
            raise FunctionFailed(explain(error)) from None

    seconds = _PATIENCE if limit is None else min(limit, _PATIENCE)
    try:
        return within(seconds, make)
    except TookTooLong:
        raise FunctionFailed(
            f"The function gave no values at its first few points within {seconds:g} s."
        ) from None


def explain(error: BaseException) -> str:
    """One sentence about why a task failed, which names exceptions that are not this package's."""
    name, reason = type(error).__name__, reason_of(error, _LONGEST)
    if reason == name:  # it says nothing
        return f"It raised {name}."
    return f"{reason}." if isinstance(error, McspectraError) else f"It raised {name}: {reason}."
