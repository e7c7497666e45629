"""Progress of long work. Workers report their progress, and listeners receive the reports.

Long work calls `report` from time to time. Without a listener, these calls cost nothing.
In a notebook or at Python's prompt, a progress bar appears automatically.
The command line always shows a bar. Scripts can use `progress_bars`.
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
"""Function that gets the name of the work and its finished fraction, 0 to 1, from any thread."""

_listeners: list[Listener] = []

_AFTER = 0.5  # in seconds; work that is shorter shows no bar
_BETWEEN = 0.1  # seconds between two updates of the bar
_BETWEEN_LINES = 10.0  # seconds between two lines of progress, if there is no terminal
_LONGEST = 80  # largest number of characters of a line of progress
# Work that has not reported for this number of seconds counts as abandoned, such as after an error
_FORGOTTEN = 30.0


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Call `listener` with the progress of all work inside the block, from all threads.

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
    """Show a bar on standard error while work inside the block takes more than half a second.

    Notebooks and Python's prompt always show a bar.
    Without a terminal, the progress is written every ten seconds as a line.

    Parameters
    ----------
    shown
        Whether to show bars. False hides them.

    Raises
    ------
    ParameterError
        If `shown` is neither True nor False.

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
    """Tell the innermost listener which `fraction` of the work `what` is done; 1 ends it."""
    listeners = _listeners[-1:]
    if not listeners and _somebody_waits():
        listeners = [_automatic]
    for listener in listeners:
        listener(what, fraction)


def _somebody_waits() -> bool:
    """Whether this process is a notebook, IPython, or Python's prompt."""
    if hasattr(sys, "ps1"):
        return True
    # A process of IPython has already imported IPython, so it need not be imported here
    ipython = sys.modules.get("IPython")
    get = getattr(ipython, "get_ipython", None)
    return get is not None and get() is not None


@final
class ProgressBars:
    """A listener that draws a bar for one running work, and lists all other work next to it.

    Parameters
    ----------
    closes
        Whether `close` is called at the end of the work.
        If `close` is not called, a bar remains for 30 s or more after an exception.
    """

    def __init__(self, *, closes: bool = False) -> None:
        self._closes = closes
        # Time of the start, time of the last report, and finished fraction of each running work
        self._under_way: dict[str, tuple[float, float, float]] = {}
        self._told_at = time.monotonic()
        self._bar: Any = None  # progress bar of the package rich, or None if no bar is shown
        self._lock = threading.Lock()

    def __call__(self, what: str, fraction: float) -> None:
        """Record the finished fraction of the work `what`, and show it if the work takes long."""
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
        """Erase the bar."""
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], visible=False, refresh=True)
            # Notebooks do not support the escape codes that erase a line
            self._bar.console.file.write(f"\r{' ' * self._bar.console.width}\r")
            self._bar.stop()
            self._bar = None

    def _draw(self, shown: dict[str, float]) -> None:
        """Draw a bar for the work that began first. Only this function imports rich."""
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
                redirect_stdout=self._closes,  # prints other output above the bar
                redirect_stderr=self._closes,
            )
            self._bar.add_task(escape(first), total=1.0, **state)
            self._bar.start()
            # Show the cursor now, because the bar may never be closed
            self._bar.console.show_cursor()
        self._bar.update(self._bar.task_ids[0], refresh=True, **state)


def _listed(works: Iterable[tuple[str, float]]) -> str:
    return ", ".join(f"{what} {fraction:.0%}" for what, fraction in works)


_automatic = ProgressBars()
