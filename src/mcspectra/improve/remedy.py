"""Remedies: changes that lower an estimator's noise at a budget, measured, ranked and explained.

Every candidate (`mcspectra.improve.candidates`) is compared with the given set-up.
Candidates and given set-up have the same budgets of evaluations and the same random numbers
(`mcspectra.improve.assess`).
Intervals of all comparisons are simultaneous.
A remedy is recommended only if its interval excludes the given set-up.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import Counted, Need, Reduction, Subject, compute
from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import BudgetError, McspectraError, ParameterError
from mcspectra.core.fits import UNRESOLVED, is_resolved
from mcspectra.core.memory import memory_of
from mcspectra.core.results import dataset, strict_json
from mcspectra.core.streams import RngLike, Stream
from mcspectra.core.tally import counting
from mcspectra.estimators.importance import as_subject
from mcspectra.explain.diagnosis import Diagnosis, diagnose
from mcspectra.improve.answers import Answer, Candidate, simultaneous_z
from mcspectra.improve.assess import Assessed, Errors, MeasuredCandidate, assessed, estimates_of
from mcspectra.improve.candidates import KINDS, Budget, Kind, candidates_of
from mcspectra.measure.setup import Setup, affordable_count
from mcspectra.samplers import Sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Remedies", "RemedySettings", "ranked", "remedies"]


@final
@dataclass(frozen=True)
class RemedySettings:
    """Settings of the comparison of remedies with the given set-up."""

    # Number of budgets at which each set-up is measured: B/256, B/64, B/16, B/4 and B.
    # A rate is the slope of a line through the errors at five budgets.
    # The deviations of five errors from a line have three degrees of freedom.
    steps: int = 5
    # Ratio of successive budgets. With a smaller ratio, the sum of all budgets is larger:
    # the sum is 1/(1 − 1/ratio) = 4/3 times the largest budget.
    # With a larger ratio, the smallest budgets would not be enough for two points.
    ratio: int = 4
    # Expected number of changes of each kind, for estimates of cost and memory before a run.
    # For functions in 2-D, all 16 kinds together make 18 to 25 changes; ``sampler`` makes eight.
    tries: int = 3
    # If all estimates of a set-up are equal, they must agree with the integral.
    # The value is the largest allowed relative difference from an exact integral.
    # Means are rounded to about 1e-15 of the size of their terms.
    # The limit is far above rounding, because a sum can cancel to 1e-6 of the size of its terms.
    exact_tolerance: float = 1e-9
    # Largest allowed difference from an integral that was computed by quadrature or by many points.
    # The limit for computed integrals is larger, because their estimated error can be too small.
    # Equal estimates that miss a rare event differ from the integral by far more than 1e-3.
    quadrature_tolerance: float = 1e-3
    # If the integral is an estimate, a difference of this many standard errors is also allowed.
    # A normal error exceeds 4 standard errors with probability 6e-5.
    sigmas: float = 4.0


_SETTINGS = RemedySettings()
# Number of the random stream that searches for changes use.
# Measurements at the budgets use the streams with smaller numbers
_SEARCH = _SETTINGS.steps

_DIMS: dict[str, tuple[str, ...]] = {
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


@final
class Remedies(Counted, frozen=True, kw_only=True):
    """Changes that lower the noise at equal cost, with measurements, ranks and reasons."""

    function = "remedies"
    verb = "remedies"
    variables = (*_DIMS, "rank_by_rate")
    provenance = ("estimator", "sampler", "budget", "realizations", "stream_key")

    budget: Annotated[
        int,
        Meta(
            ge=1,
            le=2**24,
            description="Evaluations of the integrand per estimate.",
            extra={"metavar": "B"},
        ),
    ]
    kinds: Annotated[
        Annotated[tuple[Kind, ...], Meta(min_length=1)] | None,
        Meta(
            description="Changes to try; all by default.",
            extra={"flag": "--kind", "metavar": "KIND"},
        ),
    ] = None
    realizations: Annotated[
        int,
        Meta(
            ge=100,
            le=100_000,
            description="Realizations of each change at each of five budgets; in total about "
            "20 × budget × realizations evaluations.",
            extra={"flag": "-m", "metavar": "R"},
        ),
    ] = 1000

    def need(self, subject: Subject) -> Need:
        """Check that the budget is enough for two counts of the given set-up."""
        given, ratio = Setup(subject.estimator, subject.sampler), _SETTINGS.ratio
        as_integer("budget", self.budget, least=ratio * given.cost)
        counts = _affordable(given, self.budget).values()
        if len(counts) < 2:
            raise ParameterError(
                f"{given.sampler.spec} has no two counts within {self.budget} evaluations for "
                f"{given.estimator.spec}, which a rate takes; give a larger budget, or a sampler "
                "of more counts."
            )
        tries = 1 + _SETTINGS.tries * len(self._kinds)
        return Need(
            cost=float(self.budget * self.realizations * tries) * ratio / (ratio - 1),
            memory=memory_of(self.budget, subject.estimator.dims) + 16 * tries * self.realizations,
            evaluations=self._evaluations(given) + self._of_changes(given),
        )

    def _evaluations(self, given: Setup) -> int:
        """Return the evaluations for the given set-up, and for its diagnosis if f is a user's."""
        measured = given.cost * sum(_affordable(given, self.budget).values())
        diagnosed = self.budget if given.is_black_box else 0
        return self.realizations * (measured + diagnosed)

    def _of_changes(self, given: Setup) -> int:
        """Return the evaluations for one change of each kind, if f is a user's.

        Kinds have equal shares of `max_evaluations`. With smaller shares, no change could be tried.
        """
        if not given.is_black_box:
            return 0
        points = sum(_affordable(given, self.budget).values())
        return self.realizations * given.cost * points * len(self._kinds)

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[_Trials]:
        """Measure the given set-up, then the changes, one kind after another."""
        given = Setup(subject.estimator, subject.sampler)
        start = Candidate("given", "as given", "leave everything as it is", given)
        unknown = np.isnan(given.estimator.known_integral()[0]).any()
        search = Budget(self.budget, self.realizations, stream.child(_SEARCH))
        # The evaluations that remain after the given set-up are shared equally by kinds of changes
        limit = self.max_evaluations
        first = self._evaluations(given)
        share = None if limit is None else max(1, (limit - first) // len(self._kinds))

        def of_kind(index: int) -> _Trials:
            kinds = self._kinds[index - 1 : index] if index else ()
            tried, not_tried = [], list[str]()
            changes = candidates_of(given, kinds, search) if index else iter([start])
            with counting("This change", share if index else limit) as tally:
                while True:
                    try:
                        change = next(changes, None)
                        if change is None:
                            break
                        if isinstance(change, str):
                            not_tried.append(change)
                            continue
                        setup, reason = change.setup, change.setup.too_dear(self.budget)
                        if index and unknown and (change.biased or not setup.unbiased):
                            reason = (
                                "Its error is relative to the integral, which is unknown; give "
                                "integral=…."
                            )
                        else:
                            if setup.is_black_box:
                                points = sum(_affordable(setup, self.budget).values())
                                tally.foresee(self.realizations * setup.cost * points)
                            trial = self._measured(change, given, stream)
                            if trial is not None:
                                tried.append(trial)
                                continue
                        not_tried.append(f"{change.name}: {reason}")
                    except BudgetError as error:
                        name = change.name if isinstance(change, Candidate) else kinds[0]
                        said: object = error
                        if index and tally.refused:
                            said = (
                                f"with it, changes of this kind take at least {tally.refused} "
                                f"evaluations, and their share of max_evaluations = {limit} is "
                                f"{share}; allow more, or give fewer kinds."
                            )
                        not_tried.append(f"{name}: {said}")
            if index:
                return _Trials(tried, not_tried, None)
            own, most = stream.child(_SEARCH + 1), self.budget * self.realizations
            found = diagnose(given.estimator, given.sampler, own, most)
            return _Trials(tried, [], found)

        def result(found: _Trials) -> xr.Dataset:
            """Rank all set-ups by variance. A set-up that two kinds of change make counts once."""
            assert found.diagnosis is not None
            first: dict[str, MeasuredCandidate] = {}
            for each in found.tried:
                first.setdefault(each.key, each)
            return ranked(list(first.values()), found.not_tried, self.budget, found.diagnosis)

        return Reduction(
            kind=_Trials,
            block=of_kind,
            blocks=1 + len(self._kinds),
            result=result,
        )

    def _measured(
        self, change: Candidate, given: Setup, stream: Stream
    ) -> MeasuredCandidate | None:
        """Measure errors at counts within the budgets; None if there are fewer than two counts."""
        setup = change.setup
        cost: list[int] = []
        estimates: list[Array] = []
        for step, n in _affordable(setup, self.budget).items():
            try:
                estimator = setup.at(n)
            except McspectraError:  # n is too small for strata with borders at all edges of g
                continue
            cost.append(n * setup.cost + setup.overhead)
            own = stream.child(step)
            estimates.append(estimates_of(estimator, setup.sampler, n, self.realizations, own))
        if len(cost) < 2:
            return None

        # Choose the relative tolerance for the comparison of equal estimates with the integral
        value, error, source = given.estimator.known_integral()
        integral, tolerance = np.atleast_1d(np.asarray(value, float)), _SETTINGS.exact_tolerance
        if source != "exact":
            size = float(np.abs(integral).max())
            errors_allowed = _SETTINGS.sigmas * error / size if size else 0.0
            tolerance = max(_SETTINGS.quadrature_tolerance, errors_allowed)
        biased = not np.isnan(integral).any() and (change.biased or not setup.unbiased)
        errors = Errors.of(
            cost,
            estimates,
            integral,
            biased=biased,
            tolerance=tolerance,
            overhead=setup.overhead,
        )
        return MeasuredCandidate.of(change, errors)

    @property
    def _kinds(self) -> tuple[Kind, ...]:
        return tuple(dict.fromkeys(self.kinds or tuple(KINDS)))


def remedies(
    estimator: Any,
    sampler: Sampler | str,
    budget: int,
    *,
    dims: int | None = None,
    realizations: int = 1000,
    rng: RngLike = 0,
    kinds: Sequence[str] | None = None,
    max_evaluations: int | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Try changes of an estimator and its sampler at equal cost, and rank and explain the results.

    All changes together take 10 to 25 · budget · realizations evaluations of a user's function.
    With a budget of 1,000 and the default realizations, this is about 20 million evaluations.

    Parameters
    ----------
    estimator, sampler
        The given set-up.
    budget
        Number of evaluations of the integrand in one estimate.
        With several techniques, an estimate with n points takes Σ counts · n evaluations.
    dims
        Number of dims; needed if the estimator is a function or a spec without ``dims``.
        The default is the sampler's number of dims, unless the sampler is given as a spec.
    realizations
        Number of realizations of each set-up at each budget, from 100 to 100 000.
    rng
        Seed (SPEC 7), the same for all set-ups.
    kinds
        Kinds of changes to try; by default all kinds. See `mcspectra.improve.candidates.KINDS`.
    workers
        Number of threads; all processors by default. It has no effect on results.
    max_evaluations
        Maximum number of evaluations of the integrand.
        The given set-up, its diagnosis and one change of each kind take the least number.
        If the maximum is below this number, an error is raised before any evaluation.
        All kinds of changes have equal shares of the remaining evaluations.
        If a change needs more evaluations than its kind may use, the change is not tried.

    Returns
    -------
    xarray.Dataset
        A dataset. The dim ``remedy`` lists changes by name, with the least variance first.
        The name of the given set-up is ``"as given"``.
        For an unbiased change, ``error`` is the variance at the budget, summed over channels.
        For a biased change, ``error`` is the mean squared error. The interval is ``error_ci``.
        ``error_ratio`` with ``error_ratio_ci`` is the error relative to the given set-up.
        ``rate`` with ``rate_ci`` is the rate of the variance.
        ``rate_difference`` with ``rate_difference_ci`` is the change of the rate by the remedy.
        Intervals of ratios and of differences are simultaneous, at 95 %.
        ``rank_by_rate`` is the rank of the rate.
        The coordinates of a remedy are its ``kind``, ``change`` (an imperative) and ``reason``.
        Two further coordinates are ``verdict`` for the error, and ``rate_verdict`` for the rate.
        A verdict is one of the words better, worse, undecided and given.
        ``cost`` and ``error_at_cost`` have the dims remedy and step (one of five budgets).
        Four attributes describe the result. ``diagnosis`` and ``answer`` are sentences.
        ``best`` contains the numbers of the answer as JSON.
        ``not_tried`` lists changes that could not be tried, with reasons.

    Raises
    ------
    ParameterError, CountError
        If a value is out of range, a kind is unknown, or the budget is too small.

    Notes
    -----
    The kinds ``fitted``, ``regression``, ``order`` and ``preintegrated`` use a pilot.
    Kinds that use a pilot change the estimator after the pilot, and keep its integral.
    The pilot takes an eighth of the budget, but at most 4096 evaluations.

    If no count of points costs exactly the budget, the largest count below it is measured.
    The error is then extrapolated to the budget along the fitted rate.
    The interval of an extrapolated error includes the uncertainty of the rate.
    Errors are not extrapolated for changes with a pilot.

    A user's function is evaluated at most 4/3 · budget · realizations times for each set-up.
    The given set-up and its diagnosis take at most 7/3 · budget · realizations evaluations.
    Searches for offsets of strata and for widths of smooth edges would take more evaluations.
    Therefore a user's function is not evaluated in searches for offsets and widths.

    A change is biased if it smooths edges, or if its sampler is not randomized.
    The error of a biased change is taken about the integral of the given estimator.
    If ∫f is unknown, biased changes are not tried.
    A biased change has no rate, because its error converges to the squared bias instead of 0.
    All evaluations count, including those in pilots of heuristics and in means over boxes.

    If all estimates are equal but differ from the integral, they have missed a rare event.
    If a rare event was missed, error and ratio are NaN, and the verdict is undecided.
    In the ranking by rate, set-ups without a rate are last.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> found = mcs.remedies(
    ...     mcs.Estimator("linear", dims=1), "jittered | shift", 1024, kinds=["unshifted"]
    ... )
    >>> str(found["remedy"].values[0])
    'unshifted'
    """
    subject = as_subject(estimator, sampler, dims=dims)
    return compute(Remedies.of(locals()), subject, rng, workers)


def ranked(
    measured: Sequence[MeasuredCandidate],
    not_tried: Sequence[str],
    budget: int,
    diagnosis: Diagnosis,
) -> xr.Dataset:
    """Compare all candidates with the given set-up, which is first, and sort them by variance."""
    found = assessed(measured, budget)
    given = found[0]
    found.sort(key=lambda each: float(np.nan_to_num(each.ratio, nan=np.inf)))
    rates = [each.result.rate for each in found]
    by_rate = np.argsort(np.argsort(np.nan_to_num(rates, nan=np.inf)))
    reasons = {each.result.name: _reason(each, diagnosis) for each in found}
    said = _answer(found, given, budget, reasons, diagnosis, not_tried)
    numbers = {
        "error": [each.error for each in found],
        "error_ci": [each.error_ci for each in found],
        "error_ratio": [each.ratio for each in found],
        "error_ratio_ci": [each.ratio_ci for each in found],
        "rate": rates,
        "rate_ci": [each.result.rate_ci for each in found],
        "rate_difference": [each.rate_difference for each in found],
        "rate_difference_ci": [each.rate_difference_ci for each in found],
        "cost": [_padded(each.measured.errors.cost) for each in found],
        "error_at_cost": [_padded(each.measured.errors.error) for each in found],
    }
    texts = {
        "kind": [each.measured.kind for each in found],
        "change": [each.measured.change for each in found],
        "verdict": [each.result.verdict for each in found],
        "rate_verdict": [each.rate_verdict for each in found],
        "reason": list(reasons.values()),
    }
    return dataset(
        {
            **{name: (dims, np.array(numbers[name])) for name, dims in _DIMS.items()},
            "rank_by_rate": (("remedy",), by_rate + 1),
        },
        {
            "remedy": [each.result.name for each in found],
            **{name: ("remedy", values) for name, values in texts.items()},
            "bound": ["low", "high"],
            "step": np.arange(_SETTINGS.steps),
        },
        simultaneous_z=simultaneous_z(2 * (len(measured) - 1)),
        diagnosis=diagnosis.text,
        answer=str(said),
        best=json.dumps(strict_json(said.best.to_dict())),
        not_tried=list(not_tried),
        given_error=float(given.measured.errors.error[-1]),
    )


def _reason(each: Assessed, diagnosis: Diagnosis) -> str:
    """Explain why a candidate is better; if it is not, report what the measurement showed."""
    candidate = each.measured
    if each.result.verdict == "given":
        found = ""
    elif each.blind:
        found = (
            "Its estimates are all equal and differ from the integral: they missed a rare region."
        )
    elif each.result.verdict == "undecided":
        found = "Its interval includes the given set-up."
    elif each.result.verdict == "worse":
        found = f"Its {'mean squared error' if candidate.biased else 'variance'} is larger."
    else:
        found = diagnosis.removes(
            candidate.kind,
            candidate.name,
            biased=candidate.biased,
            unbounded=candidate.infinite_weights,
            jumps=candidate.jumps,
        )
        if not found and not math.isnan(each.result.rate):
            if not is_resolved(*each.result.rate_ci):
                found = f"Its rate is {UNRESOLVED}."
            elif each.rate_verdict == "better":
                found = f"Its rate is better, {each.result.rate:.2f}.".replace("-", "−")
            else:
                found = "The intervals of the rates overlap."
    return " ".join(filter(None, [found, candidate.note]))


def _answer(
    found: Sequence[Assessed],
    given: Assessed,
    budget: int,
    reasons: Mapping[str, str],
    diagnosis: Diagnosis,
    not_tried: Sequence[str],
) -> Answer:
    """Make the answer. It recommends a change only if the interval of its gain supports it."""
    results = [given.result, *(each.result for each in found if each is not given)]
    said: dict[str, Any] = {"causes": tuple(diagnosis.causes), "not_tried": tuple(not_tried)}
    if given.blind:
        alike = (
            "All estimates of the given set-up are equal and differ from the integral: they missed "
            "a rare region. No comparison is possible; give more realizations or a larger budget."
        )
        return Answer.of(budget, results[:1], instead=alike, **said)
    if len(results) == 1:
        nothing = " ".join(["No change could be tested.", *not_tried[:3]])
        return Answer.of(budget, results, instead=nothing, **said)
    answer = Answer.of(budget, results, **said)
    best = next(each for each in found if each.result is answer.best)
    why = [] if best is given else [reasons[best.result.name]]
    # If larger budgets favor another change, name the change with the best rate
    resolved = [each for each in found if is_resolved(*each.result.rate_ci) and each is not best]
    steep = [each for each in resolved if each.rate_verdict == "better"]
    if steep:
        first = min(steep, key=lambda each: each.rate_difference_ci[1])
        low, high = first.result.rate_ci
        if best is given or high < best.result.rate_ci[0]:
            rates = [f"{rate:.2f}".replace("-", "−") for rate in (first.result.rate, low, high)]
            why.append(
                f"At larger budgets: {first.result.change}, whose rate is {rates[0]} "
                f"({rates[1]} to {rates[2]})."
            )
    return replace(answer, why=" ".join(filter(None, why)))


@dataclass(frozen=True)
class _Trials:
    """Measured set-ups, the set-ups that were not tried, and the diagnosis of the given set-up."""

    tried: list[MeasuredCandidate]
    not_tried: list[str]
    diagnosis: Diagnosis | None

    def merge(self, other: _Trials) -> _Trials:
        """Return the union of two results, in order."""
        diagnosis = self.diagnosis or other.diagnosis
        return _Trials(self.tried + other.tried, self.not_tried + other.not_tried, diagnosis)


def _affordable(setup: Setup, budget: int) -> dict[int, int]:
    """Return the largest number of points that each budget allows, by the index of the budget."""
    found: dict[int, int] = {}
    for step in range(_SETTINGS.steps):
        n = affordable_count(setup, budget // _SETTINGS.ratio ** (_SETTINGS.steps - 1 - step))
        if n and n > max(found.values(), default=0):
            found[step] = n
    return found


def _padded(values: Array) -> list[float]:
    """Put NaN in front of the values, one for each budget that is too small to be measured."""
    return [math.nan] * (_SETTINGS.steps - len(values)) + [float(v) for v in values]
