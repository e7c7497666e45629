"""Progress of long work: whoever works reports, whoever wants to know listens.

Work that takes seconds calls `report` now and then; without a listener that costs nothing. In a
notebook or at Python's prompt, where somebody waits, a bar appears by itself; the command line shows
one, and in scripts it takes `progress_bars`.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from typing import Any, TypeAlias, final

from mcspectra.core.display import printable
from mcspectra.core.errors import ParameterError

__all__ = ["Listener", "ProgressBars", "listening", "progress_bars", "report"]

Listener: TypeAlias = Callable[[str, float], object]
"""Called with what is being done and the fraction of it, 0 to 1, that is; from any thread."""

_listeners: list[Listener] = []

_AFTER = 0.5  # seconds: what is done sooner needs no bar
_BETWEEN = 0.1  # seconds from one drawing to the next
_BETWEEN_LINES = 10.0  # seconds, where there is no terminal to draw in
_LONGEST = 80  # Characters of a line of progress
_FORGOTTEN = 30.0  # seconds of silence after which work counts as given up: an exception, say


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Have `listener` called with the progress of everything done inside, in all threads.

    Examples
    --------
    >>> with listening(lambda what, done: print(f"{what}: {done:.0%}")):
    ...     report("bnot", 0.5)
    bnot: 50%
    """
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


def progress_bars(shown: bool = True) -> AbstractContextManager[None]:
    """Show a bar on standard error while something inside takes longer than half a second.

    Notebooks and Python's prompt show it anyway. Where there is no terminal to draw in, a line tells
    of it every ten seconds.

    Parameters
    ----------
    shown
        False hides bars instead.

    Raises
    ------
    ParameterError
        `shown` is neither True nor False.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> with mcs.progress_bars():
    ...     curve = mcs.convergence("disk", "jittered", [16, 64], realizations=50)
    """
    if not isinstance(shown, bool):
        raise ParameterError(f"shown is {shown!r}; give True, or False to hide bars.")
    return _showing() if shown else listening(lambda what, fraction: None)  # noqa: ARG005


@contextmanager
def _showing() -> Iterator[None]:
    with closing(ProgressBars(closes=True)) as bars, listening(bars):
        yield


def report(what: str, fraction: float) -> None:
    """Tell the innermost listener that `fraction` of `what` is done; 1 at its end."""
    listeners = _listeners[-1:]
    if not listeners and _somebody_waits():
        listeners = [_automatic]
    for listener in listeners:
        listener(what, fraction)


def _somebody_waits() -> bool:
    """Whether this is a notebook, IPython, or Python's prompt."""
    if hasattr(sys, "ps1"):
        return True
    # Asked only where something has imported it: IPython's own process always has.
    ipython = sys.modules.get("IPython")
    get = getattr(ipython, "get_ipython", None)
    return get is not None and get() is not None


@final
class ProgressBars:
    """A listener that draws a bar of what is under way, and names its parts that are beside it.

    Parameters
    ----------
    closes
        Whether `close` is called at the end. Else nothing has to be closed: after an exception the
        bar stays as it was, and is forgotten.
    """

    def __init__(self, *, closes: bool = False) -> None:
        self._closes = closes
        self._under_way: dict[str, tuple[float, float, float]] = {}  # begun, heard of, fraction
        self._told_at = time.monotonic()
        self._bar: Any = None  # rich's, while one is shown
        self._lock = threading.Lock()

    def __call__(self, what: str, fraction: float) -> None:
        """Take in that `fraction` of `what` is done; show it where that is worth the while."""
        now = time.monotonic()
        oldest = -math.inf if self._closes else now - _FORGOTTEN
        with self._lock:
            begun, *_ = self._under_way.get(what, (now,))
            self._under_way[what] = begun, now, min(max(fraction, 0.0), 1.0)
            self._under_way = {
                name: work
                for name, work in self._under_way.items()
                if work[1] >= oldest and work[2] < 1.0
            }
            shown = {
                printable(what, _LONGEST): done
                for what, (begun, _, done) in self._under_way.items()
                if now - begun >= _AFTER
            }
            terminal = sys.stderr is not None and (sys.stderr.isatty() or _somebody_waits())
            if not shown:
                self.close()
            elif now - self._told_at > (_BETWEEN if terminal else _BETWEEN_LINES):
                self._told_at = now
                if terminal:
                    self._draw(shown)
                elif sys.stderr is not None:
                    print(f"mcspectra: {_listed(shown.items())}", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Wipe the bar."""
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], visible=False, refresh=True)
            # Notebooks know no codes that erase.
            self._bar.console.file.write(f"\r{' ' * self._bar.console.width}\r")
            self._bar.stop()
            self._bar = None

    def _draw(self, shown: dict[str, float]) -> None:
        """Draw a bar of the first, which was begun before the others; rich is imported here alone."""
        from rich.console import Console
        from rich.markup import escape
        from rich.progress import Progress, TextColumn

        (first, done), *parts = shown.items()
        state: Any = {"completed": done, "parts": _listed(parts)}
        if self._bar is not None and self._bar.tasks[0].description != escape(first):
            self.close()
        if self._bar is None:
            self._bar = Progress(
                *Progress.get_default_columns(),
                TextColumn("{task.fields[parts]}", markup=False),
                console=Console(stderr=True, force_terminal=True, force_jupyter=False),
                auto_refresh=False,
                transient=True,
                redirect_stdout=self._closes,  # what else is printed stands above the bar
                redirect_stderr=self._closes,
            )
            self._bar.add_task(escape(first), total=1.0, **state)
            self._bar.start()
            self._bar.console.show_cursor()  # it may never be closed
        self._bar.update(self._bar.task_ids[0], refresh=True, **state)


def _listed(works: Iterable[tuple[str, float]]) -> str:
    return ", ".join(f"{what} {fraction:.0%}" for what, fraction in works)


_automatic = ProgressBars()
