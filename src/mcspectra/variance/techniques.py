"""The terms of each technique and between techniques: which strategy makes the variance.

An estimate with several techniques is a sum of parts E_t, one a technique, and its variance is
the sum over all pairs of Cov(E_t, E_s): off the diagonal 0 for independent sets, but not for those
that share points (`mcspectra.estimators.sets`). Each covariance has a dc, a power and a cross term
(`mcspectra.variance.technique_sums`). Along n every technique has a rate of its own, and the slowest one
becomes the rate of the sum: the *bottleneck*.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.errors import InfiniteWeightVarianceWarning, ParameterError, warn
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers
from mcspectra.core.results import dataset
from mcspectra.core.staged import compute
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, as_estimator
from mcspectra.estimators.moments import rounding_floor
from mcspectra.integrands import Integrand
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.spectra.bases import make_basis
from mcspectra.variance.batches import Variables
from mcspectra.variance.bottleneck import in_words, technique_rates
from mcspectra.variance.convergence import count_stream
from mcspectra.variance.fit import check_window
from mcspectra.variance.staged_techniques import (
    StagedTechniques,
    TechniqueCell,
    TechniqueTotal,
)
from mcspectra.variance.technique_sums import TechniqueSums, TechniqueView
from mcspectra.variance.views import SPACES, check_terms, chosen_basis, view_dims

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["staged_techniques", "technique_terms"]


def technique_terms(
    estimator: AbstractEstimator | Integrand | str,
    sampler: Sampler | str,
    n: int | Sequence[int],
    *,
    half_width: int = 64,
    realizations: int = 1000,
    rng: RngLike = 0,
    basis: str = "fourier",
    space: str | None = None,
    fit_last: int | str | None = None,
    engine: str = "auto",
    eps: float = 1e-9,
    workers: int | None = None,
) -> xr.Dataset:
    """Split the variance of an estimator among its techniques and pairs of them, term by term.

    Parameters
    ----------
    estimator, sampler
        What is analysed: `MultipleImportance`, `TechniqueSum`, or any other estimator.
    n
        Points of each technique in units of its ``counts``; a list of ascending numbers adds the dim
        n, rates and the bottleneck.
    half_width, basis, engine, eps, workers
        As for `variance_terms`.
    realizations
        Independent realisations for each n, at least 2.
    rng
        Seed (SPEC 7). With a single n realisations are those of `variance_terms`; with a list, each n has
        the stream that it has in `convergence`.
    space
        ``"domain"`` or ``"primary"`` as for `variance_terms`; by default the domain where there is one.
        In primary space the dc terms are 0, as every technique's points have equal weights.
    fit_last
        Fit rates to the last so many counts: as for `convergence`.

    Returns
    -------
    xarray.Dataset
        On technique and technique_other: ``technique_covariance`` of the techniques' parts of the
        estimate, which sums to ``measured_variance``; ``technique_dc_term``, ``technique_power_term``
        and ``technique_cross_term``, which sum to ``predicted_variance``; ``_se`` of these four (batch
        means: from 4 realisations on). ``dc_term``, ``power_term``, ``cross_term`` of `variance_terms`:
        in the domain the sums over pairs; in primary space, where each technique has frequencies
        of its own, dc and power are those of the diagonal and cross is the rest. On technique: ``technique_variance`` with
        ``_ci``, the diagonal. ``captured``. With a list of n: ``technique_rate`` and
        ``rate`` with ``_ci``, and ``bottleneck``: the technique whose rate is slower than
        all others' by intervals that do not overlap, −1 for undecided; the attribute ``bottleneck`` has
        it in words. Techniques without variance take no part. Several channels add a dim channel.

    Raises
    ------
    CountError, ParameterError
        A value is out of range, dims disagree, or the sampler cannot do a count.

    Warns
    -----
    InfiniteWeightVarianceWarning
        ∫1/p diverges: the spectral terms of the domain view are NaN.

    Notes
    -----
    O(R (n + T² M)) time and O(T² M) memory for T techniques and M frequencies. The bottleneck looks
    at the techniques' own variances: correlations between techniques may undo it.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> parts = mcs.TechniqueSum(["linear", "step(at=0.3)"], dims=1)
    >>> d = mcs.technique_terms(parts, "jittered", [16, 64, 256], half_width=8, realizations=200)
    >>> d.attrs["bottleneck"]
    'technique 1'
    """
    threads = available_workers(workers)
    return compute(
        staged_techniques(
            estimator,
            sampler,
            n,
            half_width=half_width,
            realizations=realizations,
            rng=rng,
            basis=basis,
            space=space,
            fit_last=fit_last,
            engine=engine,
            eps=eps,
        ),
        threads,
        "technique_terms",
    )


def staged_techniques(
    estimator: AbstractEstimator | Integrand | str,
    sampler: Sampler | str,
    n: int | Sequence[int],
    *,
    half_width: int = 64,
    realizations: int = 1000,
    rng: RngLike = 0,
    basis: str = "fourier",
    space: str | None = None,
    fit_last: int | str | None = None,
    engine: str = "auto",
    eps: float = 1e-9,
) -> StagedTechniques:
    """Return `technique_terms` as a staged analysis, its arguments checked: a run is a count."""
    job = _Job.of(estimator, sampler, half_width, realizations, rng, basis, space, engine, eps)
    several = isinstance(n, Sequence | np.ndarray) and not isinstance(n, str)
    ns = _check_counts(n, job) if several else [job.sampler.check_count(n)]
    for count in ns:
        job.estimator.check_sampler(job.sampler, count)
    window = check_window(fit_last, len(ns))
    streams = [count_stream(job.stream, count) if several else job.stream for count in ns]
    cells = tuple(job.cell(count, own) for count, own in zip(ns, streams, strict=True))

    def result(totals: list[TechniqueTotal]) -> xr.Dataset:
        if job.infinite:
            warn(
                f"∫1/p diverges for {job.estimator.spec}: the spectral terms are infinite although the "
                "estimate's variance need not be; use space='primary'.",
                InfiniteWeightVarianceWarning,
            )
        variables = _stacked(cells, totals)
        if job.infinite:
            variables = _without_spectra(variables)
        notes: dict[str, Any] = {}
        if several:
            rates, choice = technique_rates(ns, [t.sums.moments for t in totals], window)
            variables |= rates
            notes["bottleneck"] = in_words(choice, scalar=job.estimator.channels == 0)
        return _labelled(variables, ns, job, cells[0].view, several=several, **notes)

    return StagedTechniques(cells, result)


def _stacked(cells: Sequence[TechniqueCell], totals: Sequence[TechniqueTotal]) -> Variables:
    """Result variables of all counts, along a first axis n."""
    parts = [
        _variables(total.sums, cell.view, total.batches.errors)
        for cell, total in zip(cells, totals, strict=True)
    ]
    return {
        name: (("n", *dims), np.stack([part[name][1] for part in parts]))
        for name, (dims, _) in parts[0].items()
    }


@dataclass(frozen=True)
class _Job:
    """What is the same for all counts."""

    estimator: AbstractEstimator
    sampler: Sampler
    half_width: int
    realizations: int
    stream: Stream
    seed: int | None
    basis: str
    space: str
    engine: str
    eps: float
    infinite: bool

    @staticmethod
    def of(
        given: AbstractEstimator | Integrand | str,
        sampler: Sampler | str,
        half_width: int,
        realizations: int,
        rng: RngLike,
        basis: str,
        space: str | None,
        engine: str,
        eps: float,
    ) -> _Job:
        estimator = as_estimator(given, getattr(sampler, "dims", None))
        source = as_sampler(sampler, estimator.dims)
        has_domain = estimator.domain_integrand is not None
        chosen = ("domain" if has_domain else "primary") if space is None else space
        as_choice("space", chosen, SPACES)
        basis = chosen_basis(basis, estimator, source, chosen, half_width)
        check_terms(estimator, half_width, chosen, cross_matrix=False, basis=basis)
        infinite = chosen == "domain" and estimator.infinite_weights
        return _Job(
            estimator,
            source,
            half_width,
            as_integer("realizations", realizations, least=2, most=MAX_REALIZATIONS),
            Stream.from_rng(rng),
            rng if isinstance(rng, int) else None,
            basis,
            chosen,
            engine,
            eps,
            infinite,
        )

    def cell(self, n: int, stream: Stream) -> TechniqueCell:
        """Realisations of one count."""
        functions = make_basis(self.basis, view_dims(self.estimator, self.space), self.half_width)
        view = TechniqueView.of(self.estimator, n, self.space, functions, self.engine, self.eps)
        return TechniqueCell(view, self.sampler, n, stream, self.realizations)


def _check_counts(counts: Any, job: _Job) -> list[int]:
    ns = [job.sampler.check_count(n) for n in counts]
    if not ns or any(b <= a for a, b in itertools.pairwise(ns)):
        raise ParameterError(f"n is {list(counts)}; give a number or ascending numbers of points.")
    return ns


_PAIRS = ("channel", "technique", "technique_other")
_NAMES = ("technique_dc_term", "technique_power_term", "technique_cross_term")


def _variables(sums: TechniqueSums, view: TechniqueView, errors: Array) -> Variables:
    """Result variables of one count, with a leading channel axis."""
    found = sums.covariances(view)
    stacked = dict(zip((*_NAMES, "technique_covariance"), found.stacked, strict=True))
    spreads = dict(zip((*_NAMES, "technique_covariance"), errors, strict=True))
    moments = sums.moments
    predicted = found.stacked[:3].sum(axis=(0, 2, 3))
    # As `variance_terms` has it: in primary space each technique has frequencies of its own.
    dc, power = (np.einsum("cts->c" if view.domain else "ctt->c", c) for c in found.stacked[:2])
    measured, mean = moments.variance[:, -1], moments.mean[:, -1]
    real = np.where(measured > rounding_floor(mean), measured, np.nan)
    totals = {
        "dc_term": dc,
        "power_term": power,
        "cross_term": predicted - dc - power,
        "predicted_variance": predicted,
        "measured_variance": measured,
        "captured": predicted / real,
        "mean": mean,
    }
    return {
        **{name: (_PAIRS, values) for name, values in stacked.items()},
        **{f"{name}_se": (_PAIRS, values) for name, values in spreads.items()},
        **{name: (("channel",), values) for name, values in totals.items()},
        "technique_variance": (("channel", "technique"), moments.variance[:, :-1]),
        "technique_variance_ci": (
            ("channel", "technique", "bound"),
            moments.variance_ci[:, :-1],
        ),
        "measured_variance_ci": (("channel", "bound"), moments.variance_ci[:, -1]),
    }


_FINITE = ("technique_covariance", "technique_variance", "measured_variance", "mean")


def _without_spectra(variables: Variables) -> Variables:
    """NaN for what ∫1/p makes infinite."""
    return {
        name: (dims, values if name.startswith(_FINITE) else np.full_like(values, math.nan))
        for name, (dims, values) in variables.items()
    }


def _labelled(
    variables: Variables,
    ns: list[int],
    job: _Job,
    view: TechniqueView,
    *,
    several: bool,
    **notes: Any,
) -> xr.Dataset:
    """Make the dataset, without the axes of one channel or one given n."""
    scalar = job.estimator.channels == 0
    dropped = {name for name, gone in (("channel", scalar), ("n", not several)) if gone}
    kept: Variables = {}
    for name, (dims, values) in variables.items():
        index = tuple(0 if dim in dropped else slice(None) for dim in dims)
        kept[name] = (tuple(dim for dim in dims if dim not in dropped), values[index])
    numbers = np.arange(len(job.estimator.counts))
    coords: dict[str, Any] = {
        "technique": numbers,
        "technique_other": numbers,
        "bound": ["low", "high"],
    }
    if several:
        coords["n"] = ("n", ns, {"long_name": "number of points", "units": "1"})
    else:
        notes["n"] = ns[0]
    return dataset(
        kept,
        coords,
        estimator=job.estimator.spec,
        sampler=job.sampler.spec,
        realizations=job.realizations,
        half_width=job.half_width,
        basis=job.basis,
        space=job.space,
        coefficients=view.source,
        stream_key=f"{job.stream.key:#x}",
        seed=job.seed,
        engine=view.engine,
        eps=job.eps,
        note="spectral terms are infinite: ∫1/p diverges" if job.infinite else None,
        **notes,
    )
