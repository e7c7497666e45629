"""Progress of long work: whoever works reports, whoever wants to know listens.

Work that takes seconds calls `report` now and then; without a listener that costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

__all__ = ["Listener", "listening", "report"]

Listener: TypeAlias = Callable[[str, float], object]
"""Called with what is being done and the fraction of it, 0 to 1, that is; from any thread."""

_listeners: list[Listener] = []


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


def report(what: str, fraction: float) -> None:
    """Tell the innermost listener that `fraction` of `what` is done; 1 at its end."""
    for listener in _listeners[-1:]:
        listener(what, fraction)
