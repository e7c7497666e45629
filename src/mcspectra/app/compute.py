"""From a set-up to datasets, in rounds of more and more realisations that can be cancelled.

Round r computes everything anew with four times the realisations of round r − 1: a third more work
in all, and the last round is, to the bit, what the calls of "copy as Python" return.
"""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, final

import numpy as np

from mcspectra.app.specs import UPLOAD
from mcspectra.app.state import MOST_POINTS, Setup
from mcspectra.app.uploads import upload_path
from mcspectra.core.checks import Array
from mcspectra.core.errors import McspectraError, ParameterError
from mcspectra.core.progress import listening
from mcspectra.core.spec import parse
from mcspectra.densities import Density, density
from mcspectra.estimators import AbstractEstimator, Estimator, Mirrored
from mcspectra.integrands import Integrand, integrand
from mcspectra.integrands.smoothing import smoothed
from mcspectra.samplers import Sampler, sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "KINDS",
    "Job",
    "Parts",
    "PointSet",
    "Update",
    "compute",
    "integrand_spec",
    "ladder",
    "make_parts",
    "rounds",
]

_FIRST_ROUND, _GROWTH = 16, 4
_LONGEST_ROUND = 30.0  # seconds that a round may be expected to take; longer ones are not begun
_SHORTEST_LADDER = 4
_KEPT = 64  # datasets of about 1 MB each
_FILTERS = threading.Lock()  # warning filters are the process's, not a thread's


@final
@dataclass(frozen=True)
class Parts:
    """What a set-up describes, made; `notes` are what it was warned of."""

    integrand: Integrand
    density: Density | None
    estimator: AbstractEstimator
    sampler: Sampler
    space: str
    notes: tuple[str, ...]


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


def integrand_spec(setup: Setup) -> str:
    """The integrand's spec with the file of an upload in the place of its digest."""
    call = parse(setup.integrand)
    if call.name != UPLOAD:
        return setup.integrand
    return f"image(path={str(upload_path(call.arguments['digest']))!r}, channel='luminance')"


@lru_cache(_KEPT)
def make_parts(setup: Setup) -> Parts:
    """Make integrand, density, estimator and sampler.

    Raises
    ------
    McspectraError
        A spec cannot be made, or the parts do not fit one another.
    """
    f = _shown_integrand(integrand_spec(setup), setup.dims, setup.smoothing)
    p = None if setup.density == "uniform" else density(setup.density, setup.dims)
    estimator: AbstractEstimator = Estimator(f, p)
    if setup.mirror != "none":
        estimator = Mirrored(estimator, setup.mirror)
    source = sampler(setup.displaced_sampler, setup.dims)
    with _FILTERS, warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        estimator.check_sampler(source, source.check_count(setup.n))
    notes = tuple(dict.fromkeys(str(each.message) for each in heard))
    infinite = estimator.domain_integrand is None or estimator.infinite_weights
    return Parts(f, p, estimator, source, "primary" if infinite else "domain", notes)


@lru_cache(_KEPT)
def _shown_integrand(spec: str, dims: int, smoothing: float) -> Integrand:
    """An integrand, kept because it remembers its coefficients."""
    f = integrand(spec, dims)
    if f.channels:
        raise ParameterError(
            f"{f.spec} has {f.channels} channels; the explorer shows one: choose it with channel=."
        )
    return smoothed(f, smoothing) if smoothing else f


def ladder(setup: Setup) -> list[int]:
    """Numbers of points of the convergence plot: ones that the sampler can do, about 4n at most."""
    source = make_parts(setup).sampler
    top = min(4 * setup.n, MOST_POINTS, source.max_count)
    asked = [round(top / 4**k) for k in range(6) if top >= 4 ** (k + 1)]
    with _FILTERS, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        possible = {source.nearest_count(count) for count in asked}
    return sorted(count for count in possible if count <= MOST_POINTS) or [setup.n]


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
    return _MAKERS[kind](replace(setup, realizations=2), realizations)


@lru_cache(_KEPT)
def _points(setup: Setup, realizations: int) -> PointSet:
    del realizations
    parts = make_parts(setup)
    u = parts.sampler.draw(setup.n, realizations=1, rng=setup.seed)[0]
    if parts.density is None:
        return PointSet(u, np.ones(setup.n))
    x = parts.density.sample(u)
    with np.errstate(divide="ignore"):
        return PointSet(x, 1.0 / parts.density.pdf(x))


@lru_cache(_KEPT)
def _spectrum(setup: Setup, realizations: int) -> xr.Dataset:
    from mcspectra.spectra.power import power_spectrum

    parts = make_parts(setup)
    return power_spectrum(
        parts.sampler,
        setup.n,
        density=parts.density,
        half_width=setup.half_width,
        frequency_step=setup.frequency_step,
        realizations=realizations,
        rng=setup.seed,
    )


@lru_cache(_KEPT)
def _curve(setup: Setup, realizations: int) -> xr.Dataset:
    from mcspectra.variance.convergence import convergence

    parts = make_parts(setup)
    return convergence(
        parts.estimator, parts.sampler, ladder(setup), realizations=realizations, rng=setup.seed
    )


@lru_cache(_KEPT)
def _terms(setup: Setup, realizations: int) -> xr.Dataset:
    from mcspectra.variance.terms import variance_terms

    parts = make_parts(setup)
    return variance_terms(
        parts.estimator,
        parts.sampler,
        setup.n,
        half_width=setup.half_width,
        realizations=realizations,
        rng=setup.seed,
        basis=setup.basis,
        space=parts.space,
    )


_MAKERS = {"points": _points, "spectrum": _spectrum, "curve": _curve, "terms": _terms}

KINDS = tuple(_MAKERS)
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
