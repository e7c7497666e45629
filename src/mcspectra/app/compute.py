"""From a set-up to datasets, in rounds of more and more realisations that can be cancelled.

Round r computes everything anew with four times the realisations of round r − 1: a third more work
in all, and the last round is, to the bit, what the calls of "copy as Python" return.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, final

import numpy as np

from mcspectra.app.parts import analyses_of, make_parts
from mcspectra.app.state import Setup
from mcspectra.core import analysis
from mcspectra.core.analysis import Subject
from mcspectra.core.checks import Array
from mcspectra.core.errors import McspectraError
from mcspectra.core.progress import listening

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "KINDS",
    "Job",
    "PointSet",
    "Update",
    "compute",
    "rounds",
]

_FIRST_ROUND, _GROWTH = 16, 4
_LONGEST_ROUND = 30.0  # seconds that a round may be expected to take; longer ones are not begun
_KEPT = 64  # datasets of about 1 MB each


@final
@dataclass(frozen=True)
class PointSet:
    """One set (n, d) after the warp, and its 1/p, shape (n,)."""

    points: Array
    weights: Array


@final
@dataclass(frozen=True)
class Update:
    """A part of what is shown: its kind, of `KINDS`, its value, and how far the job is.

    Attributes
    ----------
    value
        A `PointSet`, or the dataset of `power_spectrum`, `convergence` or `variance_terms`.
    realizations
        Of this value.
    fraction
        Share of the job's work that is done, 0 to 1.
    """

    kind: str
    value: Any
    realizations: int
    fraction: float


def rounds(setup: Setup) -> Iterator[int]:
    """Yield the realisations of each round; the last are those of the set-up."""
    count = _FIRST_ROUND
    while count < setup.realizations:
        yield count
        count *= _GROWTH
    yield setup.realizations


def compute(kind: str, setup: Setup, realizations: int) -> Any:
    """Compute one of `KINDS`; what does not depend on the integrand is shared by all integrands.

    Raises
    ------
    McspectraError
        The parts do not fit, or an analysis refuses them.
    """
    if kind in ("points", "spectrum"):
        setup = replace(setup, integrand="constant", mirror="none", smoothing=0.0, basis="fourier")
    if kind == "points":
        return _points(replace(setup, realizations=2))
    return _measured(kind, replace(setup, realizations=realizations))


@lru_cache(_KEPT)
def _points(setup: Setup) -> PointSet:
    parts = make_parts(setup)
    u = parts.sampler.draw(setup.n, realizations=1, rng=setup.seed)[0]
    if parts.density is None:
        return PointSet(u, np.ones(setup.n))
    x = parts.density.sample(u)
    with np.errstate(divide="ignore"):
        return PointSet(x, 1.0 / parts.density.pdf(x))


@lru_cache(_KEPT)
def _measured(kind: str, setup: Setup) -> xr.Dataset:
    parts = make_parts(setup)
    subject = Subject(parts.estimator, parts.sampler, parts.density)
    return analysis.compute(analyses_of(setup)[kind], subject, setup.seed)


KINDS = ("points", "spectrum", "convergence", "terms")
"""What is computed in each round, in this order."""


class _Cancelled(Exception):
    """Ends the analysis of a job that was cancelled."""


_own = threading.local()  # the job of this thread


def _stop_if_cancelled(what: str, fraction: float) -> None:
    """A listener to progress, which is told in the job's own thread between blocks."""
    del what, fraction
    job: Job | None = getattr(_own, "job", None)
    if job is not None and job.cancelled:
        raise _Cancelled


@final
class Job:
    """One set-up under way in a thread of its own, round by round.

    Parameters
    ----------
    setup
        What is computed.
    on_update
        Called with each part as it is done, from the job's thread.
    on_end
        Called once, with a sentence when something was refused or refinement stopped early, else
        with an empty text; not called after `cancel`.

    Notes
    -----
    `cancel` returns at once. The analysis that is running ends where it next reports progress, after
    a block of realisations, and no other begins.
    """

    def __init__(
        self,
        setup: Setup,
        on_update: Callable[[Update], object],
        on_end: Callable[[str], object],
    ) -> None:
        self.setup = setup
        self._on_update, self._on_end = on_update, on_end
        self._cancelled = threading.Event()
        self._thread = threading.Thread(target=self._run, name="explorer", daemon=True)

    def start(self) -> Job:
        """Begin; returns itself."""
        self._thread.start()
        return self

    def cancel(self) -> None:
        """Drop what is running and begin nothing more."""
        self._cancelled.set()

    def join(self, timeout: float | None = None) -> None:
        """Wait for the thread."""
        self._thread.join(timeout)

    def _run(self) -> None:
        sentence = ""
        _own.job = self
        try:
            with listening(_stop_if_cancelled):
                sentence = self._refine()
        except _Cancelled:
            return
        except McspectraError as error:
            sentence = str(error)
        except MemoryError:
            sentence = "Not enough memory; ask for fewer points or frequencies."
        except Exception as error:  # noqa: BLE001 - a page must outlive what components raise
            text = " ".join(str(error).split()) or "no message"
            sentence = f"Unexpected {type(error).__name__}: {text}."
        if not self._cancelled.is_set():
            self._on_end(sentence)

    @property
    def cancelled(self) -> bool:
        """Whether `cancel` was called."""
        return self._cancelled.is_set()

    def _refine(self) -> str:
        make_parts(self.setup)  # refuse what cannot be made before anything is shown
        planned = list(rounds(self.setup))
        spent, last = 0.0, 0
        for number, count in enumerate(planned):
            # The first round also loads and compiles what the later ones only use
            expected = spent * count / last if number > 1 else 0.0
            if expected > _LONGEST_ROUND:
                return (
                    f"Stopped at {last} realisations: {count} would take about {expected:.0f} s; "
                    "ask for fewer points or frequencies."
                )
            start = time.perf_counter()
            if not self._round(count, planned[-1]):
                return ""
            spent, last = time.perf_counter() - start, count
        return ""

    def _round(self, count: int, last: int) -> bool:
        """Compute all kinds and hand them on; False if cancelled."""
        for done, kind in enumerate(KINDS, start=1):
            value = compute(kind, self.setup, count)
            if self._cancelled.is_set():
                return False
            self._on_update(Update(kind, value, count, count / last * done / len(KINDS)))
        return True
