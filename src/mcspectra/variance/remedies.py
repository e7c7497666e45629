"""Remedies: what would lower the noise of an estimator at a budget, measured, ranked and explained.

Every counterfactual (`mcspectra.variance.counterfactuals`) is run at the same budgets of integrand
evaluations on the same random numbers as the set-up that is given, and compared with it realisation by
realisation (`mcspectra.variance.paired`). Intervals of all comparisons hold together, so that the best
of many is not one that was lucky: a remedy is recommended only where its interval leaves the
set-up that is given out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.errors import McspectraError, ParameterError
from mcspectra.core.parallel import available_workers
from mcspectra.core.progress import report
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, as_estimator
from mcspectra.estimators.moments import variance_interval
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.variance.counterfactuals import (
    KINDS,
    Budget,
    Counterfactual,
    NotTried,
    Setup,
    affordable_count,
    other_setups,
)
from mcspectra.variance.diagnosis import diagnose
from mcspectra.variance.fit import RateFit
from mcspectra.variance.paired import Comparison, Errors, compare, estimates_of, simultaneous_z

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["remedies"]

_STEPS = 5  # budgets B/256, B/64, B/16, B/4, B
_RATIO = 4
_SEARCH = _STEPS  # stream label of searches; those below are of the steps
_MOST_REALIZATIONS = 100_000
_MOST_BUDGET = 2**24
GIVEN = "as given"
_EXACT, _BY_QUADRATURE = 1e-9, 1e-3  # how well integrals are known, relative to them
_SIGMAS = 4.0  # or so many of the errors that they say of themselves
_NO_RATE = RateFit(math.nan, (math.nan, math.nan), math.nan, math.nan)


def remedies(
    estimator: Any,
    sampler: Sampler | str,
    budget: int,
    *,
    realizations: int = 1000,
    rng: RngLike = 0,
    kinds: Sequence[str] | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Try changes to an estimator and its sampler at equal cost, rank them and say why they help.

    Parameters
    ----------
    estimator, sampler
        The set-up as given.
    budget
        Evaluations of the integrand an estimate may take: what n costs is Σ counts · n.
    realizations
        Realisations of each set-up at each of five budgets, from 100 to 100 000.
    rng
        Seed (SPEC 7), common to all set-ups.
    kinds
        Which changes to try; all by default: see `mcspectra.variance.counterfactuals.KINDS`.
    workers
        Threads; all processors by default. Results do not depend on it.

    Returns
    -------
    xarray.Dataset
        On the dim ``remedy``, whose labels are names of changes in the order of their errors at the
        budget, with ``"as given"`` among them: ``error`` (variance, mean squared error for what
        is biased, summed over channels) with ``error_ci``; ``error_ratio`` to the set-up as given with
        ``error_ratio_ci``, all of which hold together at 95 %; ``rate``, ``rate_ci``;
        ``rate_difference`` with ``rate_difference_ci``, likewise; ``rank_by_rate``; the coordinates
        ``kind``, ``change`` (an imperative), ``verdict`` and ``rate_verdict`` (better, worse,
        undecided, given) and ``reason``; on (remedy, step): ``cost`` and ``error_at_cost``. The attributes
        ``diagnosis`` and ``recommendation`` are sentences, ``not_tried`` lists what could not be and why.

    Raises
    ------
    ParameterError, CountError
        A value is out of range, a kind is unknown, or the budget is below what the set-up needs.

    Notes
    -----
    Where no count of points costs exactly the budget, the largest below is measured and the error is
    carried to the budget along the fitted rate; the interval knows of the slope's uncertainty.
    What is biased, by smoothing or by a sampler that is not randomised, has its error taken about the
    integral of the given estimator; what is smoothed to another integral has no rate, as its error
    ends at the square of the bias. Pilots of heuristics and the values that a mean over a box takes count
    as evaluations. Where all estimates are alike but not the integral, they have missed what is rare:
    error and ratio are NaN, and the verdict is undecided. Set-ups without a rate are last by rate.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> found = mcs.remedies(
    ...     mcs.Estimator("linear", dims=1), "jittered | shift", 1024, kinds=["unshifted"]
    ... )
    >>> str(found["remedy"].values[0])
    'unshifted'
    """
    e = as_estimator(estimator, getattr(sampler, "dims", None))
    given = Setup(e, as_sampler(sampler, e.dims))
    total = as_integer("budget", budget, least=_RATIO * given.cost, most=_MOST_BUDGET)
    count = as_integer("realizations", realizations, least=100, most=_MOST_REALIZATIONS)
    run = _Run(total, count, Stream.from_rng(rng), available_workers(workers))
    tried, not_tried = _measured(given, _check_kinds(kinds), run)
    return _ranked(given, tried, not_tried, run, seed=rng if isinstance(rng, int) else None)


@dataclass(frozen=True)
class _Run:
    """What all set-ups share."""

    budget: int
    realizations: int
    stream: Stream
    workers: int

    def errors(self, setup: Setup, integral: Any, biased: bool, tolerance: float) -> Errors | None:
        """Errors at the counts that fit into each step's budget; None where two do not."""
        cost: list[int] = []
        estimates: list[Array] = []
        for step in range(_STEPS):
            n = affordable_count(setup, self.budget // _RATIO ** (_STEPS - 1 - step))
            spent = n and n * setup.cost + setup.overhead
            if not spent or (cost and spent <= cost[-1]):
                continue
            assert n is not None
            try:
                estimator = setup.at(n)
            except McspectraError:  # strata too few for the edges
                continue
            cost.append(spent)
            estimates.append(self._estimates(estimator, setup.sampler, n, step))
        if len(cost) < 2:
            return None
        truth = np.atleast_1d(np.asarray(integral, np.float64))
        return Errors.of(cost, estimates, truth, biased=biased, tolerance=tolerance)

    def _estimates(
        self, estimator: AbstractEstimator, sampler: Sampler, n: int, step: int
    ) -> Array:
        stream = self.stream.child(step)
        return estimates_of(estimator, sampler, n, self.realizations, stream, self.workers)


@dataclass(frozen=True)
class _Tried:
    """A set-up that was measured."""

    change: Counterfactual
    errors: Errors
    comparison: Comparison


def _tolerance(estimator: AbstractEstimator) -> float:
    """How well the integral of an estimator is known, relative to it."""
    if estimator.integral_source == "exact":
        return _EXACT
    size = float(np.abs(estimator.integral).max())
    own = _SIGMAS * estimator.integral_error / size if size else 0.0
    return max(_BY_QUADRATURE, own)


def _measured(
    given: Setup, kinds: tuple[str, ...], run: _Run
) -> tuple[list[_Tried], list[NotTried]]:
    """All set-ups that can be measured, the given one first, and why the others cannot."""
    integral = given.estimator.integral
    tolerance = _tolerance(given.estimator)
    reference = run.errors(given, integral, not given.unbiased, tolerance)
    if reference is None:
        raise ParameterError(
            f"{given.sampler.spec} has no two counts within {run.budget} evaluations for "
            f"{given.estimator.spec}, which a rate takes; give a larger budget, or a sampler of "
            "more counts."
        )
    start = Counterfactual("given", GIVEN, "leave everything as it is", given)
    tried = [_Tried(start, reference, compare(reference, reference, run.budget))]
    not_tried = []
    own = Budget(run.budget, run.realizations, run.stream.child(_SEARCH), run.workers)
    others = list(other_setups(given, kinds, own))
    for k, other in enumerate(others):
        report("remedies", k / len(others))
        if isinstance(other, NotTried):
            not_tried.append(other)
            continue
        biased = other.biased or not other.setup.unbiased
        errors = run.errors(other.setup, integral, biased, tolerance)
        if errors is None:
            reason = _too_dear(other.setup, run.budget)
            not_tried.append(NotTried(other.kind, other.name, reason))
        else:
            tried.append(_Tried(other, errors, compare(errors, reference, run.budget)))
    report("remedies", 1.0)
    return tried, not_tried


def _ranked(
    given: Setup, tried: list[_Tried], not_tried: list[NotTried], run: _Run, **provenance: Any
) -> xr.Dataset:
    """The dataset of all set-ups, in the order of their errors at the budget."""
    z = simultaneous_z(2 * (len(tried) - 1))  # of the errors and of the rates
    start = tried[0]
    ordered = sorted(tried, key=lambda t: np.nan_to_num(t.errors.at(run.budget)[0], nan=np.inf))
    columns = [_columns(t, run.budget, z) for t in ordered]
    counts = [int(cost - given.overhead) // given.cost for cost in start.errors.cost]
    own = run.stream.child(_SEARCH + 1)
    diagnosis = diagnose(given.estimator, given.sampler, counts, own)
    for column in columns:
        column["reason"] = diagnosis.reason(column)
    reasons = [f"{n.name}: {n.reason}" for n in not_tried]
    by_rate = np.argsort(np.argsort([np.nan_to_num(c["rate"], nan=np.inf) for c in columns]))
    variables = {
        name: (dims, np.array([c[name] for c in columns])) for name, dims in _VARIABLES.items()
    }
    variables["rank_by_rate"] = (("remedy",), by_rate + 1)
    return dataset(
        variables,
        _coordinates(columns),
        estimator=given.estimator.spec,
        sampler=given.sampler.spec,
        budget=run.budget,
        realizations=run.realizations,
        simultaneous_z=z,
        diagnosis=diagnosis.text,
        recommendation=_recommendation(columns, run.budget, reasons),
        not_tried=reasons,
        stream_key=f"{run.stream.key:#x}",
        given_error=float(start.errors.error[-1]),
        **provenance,
    )


_VARIABLES: dict[str, tuple[str, ...]] = {
    "error": ("remedy",),
    "error_ci": ("remedy", "bound"),
    "error_ratio": ("remedy",),
    "error_ratio_ci": ("remedy", "bound"),
    "rate": ("remedy",),
    "rate_ci": ("remedy", "bound"),
    "rate_difference": ("remedy",),
    "rate_difference_ci": ("remedy", "bound"),
    "cost": ("remedy", "step"),
    "error_at_cost": ("remedy", "step"),
}
_TEXTS = ("kind", "change", "verdict", "rate_verdict", "reason")


def _coordinates(columns: list[dict[str, Any]]) -> dict[str, Any]:
    texts = {name: ("remedy", [c[name] for c in columns]) for name in _TEXTS}
    names = {"remedy": [c["name"] for c in columns]}
    return {**names, **texts, "bound": ["low", "high"], "step": np.arange(_STEPS)}


def _columns(tried: _Tried, budget: int, z: float) -> dict[str, Any]:
    """All that is said of one set-up."""
    errors, found = tried.errors, tried.comparison
    log_error, influence = errors.at(budget)
    spread = max(math.sqrt(float(np.mean(influence**2)) / len(influence)), 1e-9)
    fit = _NO_RATE if tried.change.biased else errors.fit()
    is_given = tried.change.kind == "given"
    ratio = _interval(found.log_ratio, z * found.log_ratio_se)
    difference = math.nan if tried.change.biased else found.rate_difference
    slope = _interval(difference, z * found.rate_difference_se)
    return {
        "name": tried.change.name,
        "kind": tried.change.kind,
        "change": tried.change.change,
        "estimator": tried.change.setup.estimator,
        "biased": tried.change.biased,
        "blind": bool(errors.blind[-1]),
        "error": math.exp(log_error),
        "error_ci": variance_interval(np.asarray(math.exp(log_error)), np.asarray(spread)).tolist(),
        "error_ratio": math.exp(found.log_ratio),
        "error_ratio_ci": [math.exp(b) for b in ratio],
        "rate": fit.rate,
        "rate_ci": list(fit.interval),
        "rate_difference": difference,
        "rate_difference_ci": slope,
        "verdict": "given" if is_given else _verdict(ratio),
        "rate_verdict": "given" if is_given else _verdict(slope),
        "cost": _padded(errors.cost),
        "error_at_cost": _padded(errors.error),
    }


def _interval(centre: float, half: float) -> list[float]:
    return [centre - half, centre + half]


def _verdict(interval: list[float]) -> str:
    """What an interval of a logarithm or a difference supports; lower is better."""
    low, high = interval
    return "better" if high < 0 else "worse" if low > 0 else "undecided"


def _padded(values: Array) -> list[float]:
    """Values of the last steps, NaN for those whose budget was too small."""
    return [math.nan] * (_STEPS - len(values)) + [float(v) for v in values]


def _too_dear(setup: Setup, budget: int) -> str:
    if setup.overhead >= budget:
        return f"Its pilot alone takes {setup.overhead} evaluations, {budget} are the budget."
    if setup.cost > sum(setup.estimator.counts):
        points = setup.cost // sum(setup.estimator.counts)
        return f"Each of its samples takes {points} evaluations: too few fit into {budget}."
    return f"{setup.sampler.spec} has no two counts within {budget} evaluations."


def _recommendation(columns: list[dict[str, Any]], budget: int, reasons: list[str]) -> str:
    """What to do, as far as the intervals support it."""
    if _given(columns)["blind"]:
        return (
            "All estimates of the set-up as given are alike and miss the integral: none has met what "
            "makes it. Nothing can be said; give more realisations or a larger budget."
        )
    changes = len(columns) - 1
    if not changes:
        return " ".join(["No change could be tried.", *reasons[:3]])
    better = [c for c in columns if c["verdict"] == "better"]
    if not better:
        tried = (
            f"None of the {changes} changes that were" if changes > 1 else "The one change that was"
        )
        no = "is" if changes > 1 else "is not"
        return (
            f"{tried} tried {no} better at {budget} evaluations with 95 % confidence: keep the set-up "
            "as given." + _later(columns, None)
        )
    best = better[0]
    text = f"{best['change'][0].upper()}{best['change'][1:]}: at {budget} evaluations "
    if best["error_ratio"] == 0.0:
        return f"{text}no variance is left. {best['reason']}"
    low, high = best["error_ratio_ci"]
    text += f"the error is {best['error_ratio']:.3g} of that given ({low:.3g} to {high:.3g})"
    if best["rate_verdict"] == "better":
        text += f", and its rate {best['rate']:.2f} instead of {_given(columns)['rate']:.2f}"
    reason = "" if best["reason"].startswith("Its rate") else f" {best['reason']}"
    return f"{text}.{reason}{_later(columns, best)}"


def _later(columns: list[dict[str, Any]], best: dict[str, Any] | None) -> str:
    """What pays at larger budgets: the best rate, where it is better and not that of the best."""
    found = [c for c in columns if c["rate_verdict"] == "better" and c is not best]
    if not found:
        return ""
    steepest = min(found, key=lambda c: float(c["rate_difference_ci"][1]))
    if best is not None and steepest["rate_ci"][1] >= best["rate_ci"][0]:
        return ""
    return (
        f" At larger budgets: {steepest['change']}, whose rate is {steepest['rate']:.2f} "
        f"({steepest['rate_ci'][0]:.2f} to {steepest['rate_ci'][1]:.2f})."
    )


def _given(columns: list[dict[str, Any]]) -> dict[str, Any]:
    return next(c for c in columns if c["kind"] == "given")


def _check_kinds(kinds: object) -> tuple[str, ...]:
    if kinds is None:
        return tuple(KINDS)
    if isinstance(kinds, str) or not isinstance(kinds, Sequence) or not kinds:
        raise ParameterError(f"kinds is {kinds!r}; give a list of {', '.join(KINDS)}.")
    return tuple(dict.fromkeys(as_choice("kinds", kind, tuple(KINDS)) for kind in kinds))
