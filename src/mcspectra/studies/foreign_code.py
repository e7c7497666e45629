"""Run a study's own Python functions while the study is planned.

A function named by a study may raise anything, end the program or never return.
The function runs in its own thread, within a time limit, and its failures become sentences.
Executors protect themselves against failing tasks; this module protects the planning.
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
_LONGEST = 500  # Maximum number of characters quoted from an exception
_PATIENCE = 30.0  # Seconds for a function's first values, including compilation


class TookTooLong(Exception):
    """A job exceeded its time limit. Its thread continues, because threads cannot be stopped."""


class FunctionFailed(Exception):
    """A study's Python function fails at its first points; the message gives the reason.

    This error is not a `McspectraError`, because a study continues with other estimators.
    """


def within(seconds: float, job: Callable[[], Result]) -> Result:
    """Run a job in its own thread and return its result.

    Raises
    ------
    TookTooLong
        If the job does not finish within `seconds`.
    BaseException
        Any exception that the job raises is raised again.
    """
    result: concurrent.futures.Future[Result] = concurrent.futures.Future()

    def run() -> None:
        try:
            result.set_result(job())
        except BaseException as error:  # noqa: BLE001 - raised again in the waiting thread
            result.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    done, _ = concurrent.futures.wait([result], seconds)
    if not done:
        raise TookTooLong
    return result.result()


def probed(function: Callable[[Any], Any], *, dims: int, limit: float | None = None) -> Integrand:
    """Make an integrand from a study's function (`Integrand.from_function`), in limited time.

    Parameters
    ----------
    function, dims
        Same as in `Integrand.from_function`. The function is called at a few points.
    limit
        Time limit in seconds for the calls of the function at a few points, at most 30.

    Raises
    ------
    FunctionFailed
        If the function raises, returns anything but finite real numbers, or takes too long.
    """

    def make() -> Integrand:
        try:
            return Integrand.from_function(function, dims=dims)
        # Catch here, in the thread, because an interrupt in the main thread comes from the user
        except BaseException as error:  # noqa: BLE001 - user code may raise anything
            raise FunctionFailed(explain(error)) from None

    seconds = _PATIENCE if limit is None else min(limit, _PATIENCE)
    try:
        return within(seconds, make)
    except TookTooLong:
        raise FunctionFailed(
            f"The function gave no values at its first few points within {seconds:g} s."
        ) from None


def explain(error: BaseException) -> str:
    """Return why a task failed, as one sentence; foreign exceptions are named by their class."""
    name, reason = type(error).__name__, reason_of(error, _LONGEST)
    if reason == name:  # The exception has no text
        return f"It raised {name}."
    return f"{reason}." if isinstance(error, McspectraError) else f"It raised {name}: {reason}."
