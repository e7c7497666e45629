"""Compute the datasets of a set-up in rounds with more and more realizations, until canceled.

Each round repeats all work with four times as many realizations as the round before.
All earlier rounds together therefore add only a third to the work of the last round.
The last round gives the same bits as the program that "Copy as Python" exports.
Estimators are cached, so that their integrands keep coefficients that were computed.
"""

from __future__ import annotations

import dataclasses
import threading
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal, final

import numpy as np
import xarray as xr

from mcspectra.app.specs import UPLOAD, changed, techniques
from mcspectra.app.state import ANALYSES, MOST_POINTS, ExplorerSetup
from mcspectra.app.uploads import upload_path
from mcspectra.core import analysis
from mcspectra.core.analysis import Analysis, Subject
from mcspectra.core.errors import McspectraError, ParameterError
from mcspectra.core.options import options_of
from mcspectra.core.progress import listening
from mcspectra.core.spec import parse
from mcspectra.densities import Density, density
from mcspectra.estimators import AbstractEstimator, Estimator, Mirrored, TechniqueSum
from mcspectra.integrands import Integrand, integrand
from mcspectra.integrands.smoothing import smoothed
from mcspectra.prediction.prediction import Prediction
from mcspectra.samplers import Sampler, sampler

__all__ = [
    "MOST_AT_ONCE",
    "UPDATE_KINDS",
    "EstimatorParts",
    "Job",
    "Update",
    "analyses_of",
    "compute",
    "first_round",
    "integrand_specs",
    "ladder",
    "make_parts",
    "rounds",
]

UPDATE_KINDS = ("points", "integrand", "spectrum", "convergence", "terms", "predict")
"""Parts of a result, in the order in which each round computes them.

The parts "points", "integrand" and "predict" are computed only in the first round.
"""

MOST_AT_ONCE = 2
"""Maximum number of parts that all pages together compute at the same time.

If two parts are computed at once, one can use the time in which the other is idle.
"""

_PATIENCE = 0.2  # seconds between checks whether a waiting job was canceled
_INTEGRAND = ("integrand", "density", "dims", "mirror", "channel", "smoothing")
_OWN = {  # for each part of a result, the fields of the set-up that affect this part
    "integrand": _INTEGRAND,
    "predict": (*_INTEGRAND, "sampler", "n", "strata_shift", "seed", "counts"),
}

_FIRST_ROUND, _GROWTH = 16, 4
_LONGEST_ROUND = 30.0  # in seconds; the job stops before a round that should take longer
# Largest half width of the frequencies for which the matrix of all cross terms is computed
_MATRIX_HALF_WIDTH = 64
_KEPT = 64  # maximum number of cached datasets, of about 1 MB each
_GRID = {1: 1024, 2: 128}  # number of grid points per axis in plots of the integrand
# The latest results by kind and set-up; the cache of `functools` cannot be read without computing
_RESULTS: OrderedDict[tuple[str, ExplorerSetup], xr.Dataset] = OrderedDict()
_RESULTS_LOCK = threading.Lock()
_FILTERS = threading.Lock()  # warning filters belong to the process, not to a thread


@final
@dataclass(frozen=True)
class Update:
    """A part of the results that was just computed.

    Attributes
    ----------
    kind
        Name of the part, one of `UPDATE_KINDS`.
    value
        Dataset of the analysis. For ``integrand``, it has f, p and f/p on a grid.
    realizations
        Number of realizations of this result.
    fraction
        Fraction of the job's work that is done, 0 to 1.
    """

    kind: str
    value: Any
    realizations: int
    fraction: float


def rounds(setup: ExplorerSetup) -> Iterator[int]:
    """Yield the number of realizations of each round; the last round has the set-up's number."""
    count = _FIRST_ROUND
    while count < setup.realizations:
        yield count
        count *= _GROWTH
    yield setup.realizations


def compute(kind: str, setup: ExplorerSetup, realizations: int) -> xr.Dataset:
    """Compute the part `kind` of a result. It is cached by the fields that affect it.

    Raises
    ------
    McspectraError
        If integrand, density and sampler do not fit together, or an analysis refuses them.
    """
    key = _key(kind, setup, realizations)
    found = _cached(key)
    if found is None:
        found = _computed(*key)
        with _RESULTS_LOCK:
            _RESULTS[key] = found
            while len(_RESULTS) > _KEPT:
                _RESULTS.popitem(last=False)
    return found


def first_round(kind: str, setup: ExplorerSetup) -> xr.Dataset | None:
    """Return the part `kind` of the first round's results if it is cached, otherwise None."""
    return _cached(_key(kind, setup, next(rounds(setup))))


def _key(kind: str, setup: ExplorerSetup, realizations: int) -> tuple[str, ExplorerSetup]:
    """Return the key of a cached part. Fields that do not affect the part have fixed values."""
    if kind in ("points", "spectrum"):
        setup = replace(setup, integrand="constant", mirror="none", smoothing=0.0, basis="fourier")
    if kind in _OWN:
        setup = ExplorerSetup(**{name: getattr(setup, name) for name in _OWN[kind]})
    once = kind in ("points", "integrand", "predict")
    return kind, replace(setup, realizations=2 if once else realizations)


def _cached(key: tuple[str, ExplorerSetup]) -> xr.Dataset | None:
    with _RESULTS_LOCK:
        if key in _RESULTS:
            _RESULTS.move_to_end(key)
        return _RESULTS.get(key)


def _computed(kind: str, setup: ExplorerSetup) -> xr.Dataset:
    parts = make_parts(setup)
    if kind == "integrand":
        # Tabulate f, p and f/p on the unit square.
        # A sum of techniques has no single f and p.
        # For a sum of techniques, tabulate g = f/p of each technique in primary space instead
        dims, f = parts.sampler.dims, parts.estimator.domain_integrand
        size = _GRID[dims]
        middles = (np.arange(size) + 0.5) / size
        x = np.stack(np.meshgrid(*[middles] * dims, indexing="ij"), axis=-1).reshape(-1, dims)
        with np.errstate(divide="ignore", invalid="ignore"):
            if f is None:
                counts = range(len(parts.estimator.counts))
                values = {f"technique {t}": parts.estimator.primary_values(t, x) for t in counts}
            else:
                p = np.ones(len(x)) if parts.density is None else parts.density.pdf(x)
                values = {"f": f(x), "p": p, "f/p": f(x) / p}
        axes = [f"x{k}" for k in range(dims)]
        return xr.Dataset(
            {name: (axes, np.reshape(each, [size] * dims)) for name, each in values.items()},
            dict.fromkeys(axes, middles),
        )
    subject = Subject(parts.estimator, parts.sampler, parts.density)
    found: xr.Dataset = analysis.compute(analyses_of(setup)[kind], subject, setup.seed)
    if kind == "points" and parts.density is not None:
        with np.errstate(divide="ignore"):
            weights = 1.0 / parts.density.pdf(found["points"].to_numpy())
        found = found.assign(weights=("point", weights))
    return found


class _Cancelled(Exception):
    """Raised to stop the analysis of a canceled job."""


_TURNS = threading.BoundedSemaphore(MOST_AT_ONCE)
_own = threading.local()  # the job that runs in this thread


def _stop_if_cancelled(what: str, fraction: float) -> None:
    """Progress listener that stops a canceled job; called in the job's thread between blocks."""
    del what, fraction
    job: Job | None = getattr(_own, "job", None)
    if job is not None and job.cancelled:
        raise _Cancelled


@final
class Job:
    """Computes a set-up round by round in a separate thread.

    Parameters
    ----------
    setup
        Set-up to compute.
    on_update
        Called in the job's thread with each finished part.
    on_end
        Called once with a text when the job ends, but not after `cancel`.
        The text is empty if nothing was refused or stopped early; otherwise it gives the reason.

    Notes
    -----
    The jobs of all pages take turns: at most `MOST_AT_ONCE` parts are computed at once.
    `cancel` returns immediately, and no further analysis begins afterwards.
    The analysis that is running stops at its next progress report, after a block of realizations.
    """

    def __init__(
        self,
        setup: ExplorerSetup,
        on_update: Callable[[Update], object],
        on_end: Callable[[str], object],
    ) -> None:
        self.setup = setup
        self._on_update, self._on_end = on_update, on_end
        self._cancelled = threading.Event()
        self._thread = threading.Thread(target=self._run, name="explorer", daemon=True)

    def start(self) -> Job:
        """Start the job and return it."""
        self._thread.start()
        return self

    def cancel(self) -> None:
        """Stop the running analysis. No further analysis begins."""
        self._cancelled.set()

    def join(self, timeout: float | None = None) -> None:
        """Wait for the job's thread to end."""
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
            sentence = "Not enough memory; use fewer points or frequencies."
        except Exception as error:  # noqa: BLE001 - the page must survive errors of components
            text = " ".join(str(error).split()) or "no message"
            sentence = f"Unexpected {type(error).__name__}: {text}."
        if not self._cancelled.is_set():
            self._on_end(sentence)

    @contextmanager
    def _turn(self) -> Iterator[None]:
        """Wait until fewer than `MOST_AT_ONCE` parts are being computed."""
        while not _TURNS.acquire(timeout=_PATIENCE):
            if self._cancelled.is_set():
                raise _Cancelled
        try:
            yield
        finally:
            _TURNS.release()

    @property
    def cancelled(self) -> bool:
        """Whether `cancel` was called."""
        return self._cancelled.is_set()

    def _refine(self) -> str:
        with self._turn():
            make_parts(self.setup)  # refuse an invalid set-up before anything is shown
        planned = list(rounds(self.setup))
        spent, last = 0.0, 0
        for number, count in enumerate(planned):
            # The first round includes loading and compiling: it does not predict later times
            expected = spent * count / last if number > 1 else 0.0
            if expected > _LONGEST_ROUND:
                return (
                    f"Stopped at {last} realizations: {count} would take about {expected:.0f} s; "
                    "use fewer points or frequencies."
                )
            spent = 0.0
            for done, kind in enumerate(UPDATE_KINDS, start=1):
                with self._turn():
                    start = time.perf_counter()
                    value = compute(kind, self.setup, count)
                    spent += time.perf_counter() - start
                if self._cancelled.is_set():
                    return ""
                fraction = count / planned[-1] * done / len(UPDATE_KINDS)
                self._on_update(Update(kind, value, count, fraction))
            last = count
        return ""


@final
@dataclass(frozen=True)
class EstimatorParts:
    """Density, estimator, sampler and space of a set-up. `notes` contains warnings about it."""

    density: Density | None
    estimator: AbstractEstimator
    sampler: Sampler
    space: Literal["domain", "primary"]
    notes: tuple[str, ...]


def integrand_specs(setup: ExplorerSetup) -> tuple[str, ...]:
    """Return specs of the integrands for `mcspectra.integrand`, one spec per technique.

    The digest of an upload is replaced by the path of its file.
    If an integrand has several channels, its spec also names the chosen channel.

    Raises
    ------
    McspectraError
        If a component cannot be made from its spec, or an upload is not on this machine.
    """
    channel = setup.channel if setup.channel == "luminance" else int(setup.channel)
    found = []
    for text in techniques(setup.integrand):
        call = parse(text)
        if call.name == UPLOAD:
            file = str(upload_path(call.arguments["digest"]))
            found.append(f"image(path={file!r}, channel={channel!r})")
        else:
            several = _integrand(text, setup.dims).channels
            found.append(changed(text, "channel", channel) if several else text)
    return tuple(found)


def make_parts(setup: ExplorerSetup) -> EstimatorParts:
    """Create density, estimator and sampler, which all rounds share.

    Raises
    ------
    McspectraError
        If a component cannot be made from its spec, or the components do not fit together.
    """
    return _parts(replace(setup, realizations=2))


@lru_cache(_KEPT)
def _parts(setup: ExplorerSetup) -> EstimatorParts:
    specs = integrand_specs(setup)
    p = _density(setup.density, setup.dims)
    estimator = _estimator(specs, setup.density, setup.mirror, setup.smoothing, setup.dims)
    source = sampler(setup.displaced_sampler, setup.dims)
    with _FILTERS, warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        estimator.check_sampler(source, source.check_count(setup.n))
    notes = tuple(dict.fromkeys(str(each.message) for each in heard))
    infinite = estimator.domain_integrand is None or estimator.infinite_weights
    return EstimatorParts(p, estimator, source, "primary" if infinite else "domain", notes)


@lru_cache(_KEPT)
def _estimator(
    specs: tuple[str, ...], density_spec: str, mirror: str, smoothing: float, dims: int
) -> AbstractEstimator:
    """Create an estimator. The cache keeps coefficients that its integrands have computed."""
    p = _density(density_spec, dims)
    integrands = [_integrand(spec, dims) for spec in specs]
    several = next((f for f in integrands if f.channels), None)
    if several is not None:
        raise ParameterError(
            f"{several.spec} has {several.channels} channels, and the explorer shows one; choose "
            "it with channel=."
        )
    if len(integrands) > 1:
        if p is not None or smoothing:
            raise ParameterError(
                "Summed techniques contain their own densities and edges; choose the uniform "
                "density and no smoothing."
            )
        estimator: AbstractEstimator = TechniqueSum(integrands)
    else:
        f = _integrand(specs[0], dims, smoothing) if smoothing else integrands[0]
        estimator = Estimator(f, p)
    return estimator if mirror == "none" else Mirrored(estimator, mirror)


@lru_cache(_KEPT)
def _density(spec: str, dims: int) -> Density | None:
    return None if spec == "uniform" else density(spec, dims)


@lru_cache(_KEPT)
def _integrand(spec: str, dims: int, width: float = 0.0) -> Integrand:
    return smoothed(_integrand(spec, dims), width) if width else integrand(spec, dims)


def analyses_of(setup: ExplorerSetup) -> dict[str, Analysis]:
    """Return the analyses of a set-up that the page shows, with their options.

    Raises
    ------
    McspectraError
        If the set-up cannot be made.
    """
    given = {each.name: getattr(setup, each.name) for each in dataclasses.fields(setup)}
    given["counts"] = setup.counts or tuple(ladder(setup))
    given["space"] = setup.space or make_parts(setup).space
    # In 1-D, also compute the matrix for all pairs of frequencies, if there is one technique
    small = setup.dims == 1 and setup.half_width <= _MATRIX_HALF_WIDTH
    given["cross_matrix"] = small and len(techniques(setup.integrand)) == 1
    made = {
        name: kind(**{o.name: given[o.name] for o in options_of(kind) if o.name in given})
        for name, kind in ANALYSES.items()
    }
    # Also predict the variance for the n at which the terms are computed
    made["predict"] = Prediction(counts=tuple(sorted({*given["counts"], setup.n})))
    return made


def ladder(setup: ExplorerSetup) -> list[int]:
    """Return the numbers of points for the convergence plot that are possible, up to about 4n."""
    source = make_parts(setup).sampler
    top = min(4 * setup.n, MOST_POINTS, source.max_count)
    asked = [round(top / 4**k) for k in range(6) if top >= 4 ** (k + 1)]
    with _FILTERS, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        possible = {source.nearest_count(count) for count in asked}
    return sorted(count for count in possible if count <= MOST_POINTS) or [setup.n]
