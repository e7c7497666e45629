"""Progress on standard error: bars in a terminal, now and then a line elsewhere."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from mcspectra.core.progress import listening

__all__ = ["Bars", "progress_bars"]

_BETWEEN_LINES = 10.0  # seconds, where there is no terminal to draw bars in
_AFTER = 0.5  # seconds: what is done sooner needs no bar


@contextmanager
def progress_bars(silent: bool) -> Iterator[Bars | None]:
    """Show the progress of what is done inside: `core.progress.report` is heard, see `Bars`."""
    if silent or sys.stderr is None:
        yield None
        return
    with ExitStack() as stack:
        bars = Bars(stack)
        stack.enter_context(listening(bars.show))
        yield bars


class Bars:
    """One bar for each thing that is under way; drawn from the first half second on."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self._start = self._last = time.monotonic()
        self._tasks: dict[str, Any] = {}
        self._drawn: Any = None
        self._lock = threading.Lock()

    def show(self, what: str, fraction: float, note: str = "") -> None:
        """Show that `fraction` of `what` is done, in words `note`; safe from any thread."""
        with self._lock:
            if not sys.stderr.isatty():
                self._line(what, fraction, note)
            elif self._drawn or time.monotonic() - self._start > _AFTER:
                self._bar(what, fraction, note)

    def _line(self, what: str, fraction: float, note: str) -> None:
        if fraction < 1.0 and time.monotonic() - self._last > _BETWEEN_LINES:
            self._last = time.monotonic()
            print(f"mcspectra: {what}: {note or f'{fraction:.0%}'}", file=sys.stderr, flush=True)

    def _bar(self, what: str, fraction: float, note: str) -> None:
        if self._drawn is None:
            self._drawn = self._stack.enter_context(_rich_progress())
        if what not in self._tasks:
            self._tasks[what] = self._drawn.add_task(what, total=1.0, note=note)
        self._drawn.update(self._tasks[what], completed=fraction, note=note)
        if fraction >= 1.0:
            self._drawn.remove_task(self._tasks.pop(what))


def _rich_progress() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    note = TextColumn("{task.fields[note]}")
    description = TextColumn("{task.description}")
    return Progress(
        description, BarColumn(), note, TimeRemainingColumn(), console=Console(stderr=True)
    )
