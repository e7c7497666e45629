"""Progress of long work: whoever works reports, whoever wants to know listens.

Work that takes seconds calls `report` now and then; without a listener that costs nothing. In a
notebook or at Python's prompt, where somebody waits, a bar appears by itself; in scripts it takes
`progress_bars`.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import TypeAlias, final

from mcspectra.core.errors import ParameterError

__all__ = ["LineBars", "Listener", "listening", "progress_bars", "report"]

Listener: TypeAlias = Callable[[str, float], object]
"""Called with what is being done and the fraction of it, 0 to 1, that is; from any thread."""

_listeners: list[Listener] = []

_AFTER = 0.5  # seconds: what is done sooner needs no bar
_BETWEEN = 0.1  # seconds from one drawing to the next
_FORGOTTEN = 30.0  # seconds of silence after which work counts as given up: an exception, say
_WIDTH = 24  # characters of a bar


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

    Notebooks and Python's prompt show it anyway.

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
    return listening(LineBars() if shown else _silence)


def report(what: str, fraction: float) -> None:
    """Tell the innermost listener that `fraction` of `what` is done; 1 at its end."""
    listeners = _listeners[-1:]
    if not listeners and _somebody_waits():
        listeners = [_automatic]
    for listener in listeners:
        listener(what, fraction)


def _silence(what: str, fraction: float) -> None:
    del what, fraction


def _somebody_waits() -> bool:
    """Whether this is a notebook, IPython, or Python's prompt."""
    if hasattr(sys, "ps1"):
        return True
    # Asked only where something has imported it: IPython's own process always has.
    ipython = sys.modules.get("IPython")
    get = getattr(ipython, "get_ipython", None)
    return get is not None and get() is not None


@final
@dataclass
class _Work:
    """What is under way: when it began, when it was last heard of, how much is done."""

    start: float
    heard: float
    fraction: float


@final
class LineBars:
    """A listener that draws what is under way on one line of standard error, over and over.

    Nothing has to be closed: after an exception the line stays as it was.
    """

    def __init__(self) -> None:
        self._under_way: dict[str, _Work] = {}
        self._drawn_at = float("-inf")
        self._length = 0  # of the line that is shown
        self._lock = threading.Lock()

    def __call__(self, what: str, fraction: float) -> None:
        """Take in that `fraction` of `what` is done; draw it where that is worth the while."""
        now = time.monotonic()
        with self._lock:
            work = self._under_way.setdefault(what, _Work(now, now, fraction))
            work.heard, work.fraction = now, fraction
            if fraction >= 1.0:
                del self._under_way[what]
            shown = self._shown(now)
            if (not shown and self._length) or (shown and now - self._drawn_at > _BETWEEN):
                self._draw(shown, now)

    def _shown(self, now: float) -> dict[str, _Work]:
        """Work that has taken long, and that was heard of lately."""
        self._under_way = {
            what: work for what, work in self._under_way.items() if now - work.heard < _FORGOTTEN
        }
        return {what: w for what, w in self._under_way.items() if now - w.start >= _AFTER}

    def _draw(self, shown: dict[str, _Work], now: float) -> None:
        """Write the line over the last one; an empty one where nothing is under way any more."""
        line = "   ".join(f"{what} {_bar(work.fraction)}" for what, work in shown.items())
        if sys.stderr is not None:
            blank = "" if line else "\r"
            sys.stderr.write(f"\r{line.ljust(self._length)}{blank}")
            sys.stderr.flush()
        self._drawn_at, self._length = now, len(line)


def _bar(fraction: float) -> str:
    share = min(max(fraction, 0.0), 1.0)
    full = int(share * _WIDTH)
    return f"{'━' * full}{'╌' * (_WIDTH - full)} {share:4.0%}"


_automatic = LineBars()
