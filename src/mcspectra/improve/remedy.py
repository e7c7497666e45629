"""Remedies: what would lower the noise of an estimator at a budget, measured, ranked and explained.

Every counterfactual (`mcspectra.improve.candidates`) is run at the same budgets of integrand
evaluations on the same random numbers as the set-up that is given, and compared with it realisation
by realisation, by influences (docs/theory.md, "Intervals of variances, and stopping"). Intervals of
all comparisons hold together: a remedy is recommended only where its interval leaves the set-up that
is given out. Estimates that are all alike have no variance, or none of them has met what makes it: a
rare event. Where they miss the integral their error is unknown (NaN), not 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import Counted, Need, Reduction, Subject
from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import BudgetError, McspectraError, ParameterError
from mcspectra.core.fits import RateFit, fit_rate, is_resolved, widening
from mcspectra.core.memory import memory_of
from mcspectra.core.ordered import weighted_sum
from mcspectra.core.parallel import Block, realization_blocks
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.core.tally import counting
from mcspectra.estimators import AbstractEstimator
from mcspectra.estimators.moments import rounding_floor, variance_interval
from mcspectra.explain.diagnosis import Diagnosis, diagnose, jumps_inside
from mcspectra.improve.candidates import (
    KINDS,
    Budget,
    Counterfactual,
    Kind,
    Setup,
    affordable_count,
    other_setups,
)
from mcspectra.measure.doors import answer
from mcspectra.samplers import Sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "Comparison",
    "Errors",
    "Remedies",
    "Trial",
    "compare",
    "estimates_of",
    "ranked",
    "remedies",
    "simultaneous_z",
]

_STEPS = 5  # budgets B/256, B/64, B/16, B/4, B
_RATIO = 4
_SEARCH = _STEPS  # stream label of searches; those below are of the steps
_TRIES = 3  # changes of a kind, about
_EXACT, _BY_QUADRATURE = 1e-9, 1e-3  # how well integrals are known, relative to them
_SIGMAS = 4.0  # or so many of the errors that they say of themselves
_PRIOR = 20  # realisations' worth of the belief that estimates are normal: Var(ψ) = 2

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
_TEXTS = ("kind", "change", "verdict", "rate_verdict", "reason")


@final
class Remedies(Counted, frozen=True, kw_only=True):
    """Changes that would lower the noise at equal cost: measured, ranked, explained."""

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
            description="Realizations of each change at each of five budgets; about 20 × budget × realizations evaluations in all.",
            extra={"flag": "-m", "metavar": "R"},
        ),
    ] = 1000

    def need(self, subject: Subject) -> Need:
        """The budget is enough for two counts of the set-up as given."""
        given = Setup(subject.estimator, subject.sampler)
        as_integer("budget", self.budget, least=_RATIO * given.cost)
        counts = _affordable(given, self.budget).values()
        if len(counts) < 2:
            raise ParameterError(
                f"{given.sampler.spec} has no two counts within {self.budget} evaluations for "
                f"{given.estimator.spec}, which a rate takes; give a larger budget, or a sampler of "
                "more counts."
            )
        tries = 1 + _TRIES * len(self._kinds)
        evaluations = self.realizations * given.cost * sum(counts)
        if given.is_black_box:  # and those of its diagnosis, at most
            evaluations += self.budget * self.realizations
        return Need(
            cost=float(self.budget * self.realizations * tries) * _RATIO / (_RATIO - 1),
            memory=memory_of(self.budget, subject.estimator.dims) + 16 * tries * self.realizations,
            evaluations=evaluations,
        )

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[_Trials]:
        """The set-up as given, then the changes of a kind after the other."""
        given = Setup(subject.estimator, subject.sampler)
        start = Counterfactual("given", "as given", "leave everything as it is", given)
        unknown = np.isnan(given.estimator.known_integral()[0]).any()
        search = Budget(self.budget, self.realizations, stream.child(_SEARCH))
        # What the set-up as given leaves of the evaluations is shared by the kinds, whatever runs first
        limit = self.max_evaluations
        first = self.need(subject).evaluations
        share = None if limit is None else max(1, (limit - first) // len(self._kinds))

        def of_kind(index: int) -> _Trials:
            kinds = self._kinds[index - 1 : index] if index else ()
            tried, not_tried = [], list[str]()
            changes = other_setups(given, kinds, search) if index else iter([start])
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
                            reason = "Its error is about the integral, which is unknown; give integral=…."
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
                        name = change.name if isinstance(change, Counterfactual) else kinds[0]
                        not_tried.append(f"{name}: {error}")
            if index:
                return _Trials(tried, not_tried, None)
            own, most = stream.child(_SEARCH + 1), self.budget * self.realizations
            found = diagnose(given.estimator, given.sampler, own, most)
            return _Trials(tried, [], found)

        def result(found: _Trials) -> xr.Dataset:
            """All set-ups, in the order of their variances; what two kinds make alike counts once."""
            assert found.diagnosis is not None
            first: dict[str, Trial] = {}
            for trial in found.tried:
                first.setdefault(trial.setup, trial)
            return ranked(list(first.values()), found.not_tried, self.budget, found.diagnosis)

        return Reduction(
            kind=_Trials,
            block=of_kind,
            blocks=1 + len(self._kinds),
            cost=self.need(subject).cost,
            result=result,
        )

    def _measured(self, change: Counterfactual, given: Setup, stream: Stream) -> Trial | None:
        """Errors at the counts that fit into each step's budget; None where two do not."""
        setup = change.setup
        cost: list[int] = []
        estimates: list[Array] = []
        for step, n in _affordable(setup, self.budget).items():
            try:
                estimator = setup.at(n)
            except McspectraError:  # strata too few for the edges
                continue
            cost.append(n * setup.cost + setup.overhead)
            own = stream.child(step)
            estimates.append(estimates_of(estimator, setup.sampler, n, self.realizations, own))
        if len(cost) < 2:
            return None

        # How well the integral is known, relative to it
        value, error, source = given.estimator.known_integral()
        integral, tolerance = np.atleast_1d(np.asarray(value, float)), _EXACT
        if source != "exact":
            size = float(np.abs(integral).max())
            tolerance = max(_BY_QUADRATURE, _SIGMAS * error / size if size else 0.0)
        biased = not np.isnan(integral).any() and (change.biased or not setup.unbiased)
        errors = Errors.of(
            cost,
            estimates,
            integral,
            biased=biased,
            tolerance=tolerance,
            overhead=setup.overhead,
        )
        warp = change.kind == "warp"
        return Trial(
            kind=change.kind,
            name=change.name,
            change=change.change,
            setup=change.key,
            biased=change.biased,
            errors=errors,
            unbounded=warp and setup.estimator.infinite_weights,
            jumps=(
                jumps_inside(setup.estimator, setup.sampler)
                if warp and not setup.is_black_box
                else None
            ),
        )

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
    """Try changes to an estimator and its sampler at equal cost, rank them and say why they help.

    All changes together take 10 to 25 times budget · realizations evaluations of a user's function: some
    20 million at a budget of 1,000 with the default realizations.

    Parameters
    ----------
    estimator, sampler
        The set-up as given.
    budget
        Evaluations of the integrand an estimate may take: what n costs is Σ counts · n.
    dims
        Number of dims of a function, and of a spec that leaves it open; by default those of a sampler
        that is not a spec.
    realizations
        Realisations of each set-up at each of five budgets, from 100 to 100 000.
    rng
        Seed (SPEC 7), common to all set-ups.
    kinds
        Which changes to try; all by default: see `mcspectra.improve.candidates.KINDS`.
    workers
        Threads; all processors by default. Results do not depend on it.
    max_evaluations
        Most evaluations of the integrand: less than the set-up as given and its diagnosis take is refused before
        any is made; the rest is shared by the kinds, and what does not fit into a share is not tried.

    Returns
    -------
    xarray.Dataset
        On the dim ``remedy``, whose labels are names of changes in the order of their variances at the
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
    ``fitted``, ``regression``, ``order`` and ``preintegrated`` change the estimator by what a pilot shows,
    an eighth of the budget (4096 evaluations at most), and keep its integral.
    Where no count of points costs exactly the budget, the largest below is measured and the error is
    carried to the budget along the fitted rate; the interval knows of the slope's uncertainty. Beside a
    pilot no error is carried.
    A user's function is evaluated at most 4/3 · budget · realizations times for each set-up, and 7/3 times
    budget · realizations more for what costs precision as given; offsets of strata and widths of smooth
    edges, whose search takes more, are not tried then, nor is what is biased where ∫f is unknown.
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
    return answer(Remedies, locals())


@dataclass(frozen=True)
class Trial:
    """A set-up that was measured, at five costs at most, and what was seen of it."""

    kind: str
    name: str
    change: str
    setup: str  # texts of estimator and sampler, and the name of a change that depends on n
    biased: bool
    errors: Errors
    # Of other warps: whether ∫1/p diverges, and whether g jumps inside, if that was looked for
    unbounded: bool = False
    jumps: bool | None = None
    # Evaluations of a pilot beyond the budget, which the set-up as given is allowed, too
    pilot: int = 0
    note: str = ""  # said after the reason

    def column(self, reference: Errors, budget: int, z: float) -> dict[str, Any]:
        """All that is said of it, beside the set-up as given."""
        errors, found = self.errors, compare(self.errors, reference, budget, self.pilot)
        log_error, influence = errors.at(budget)
        spread = max(math.sqrt(float(np.mean(influence**2)) / len(influence)), 1e-9)
        fit = RateFit() if self.biased else errors.fit()
        is_given = self.kind == "given"
        ratio = _interval(found.log_ratio, z * found.log_ratio_se)
        difference = math.nan if self.biased else found.rate_difference
        slope = _interval(difference, z * found.rate_difference_se)
        return {
            **vars(self),
            "blind": bool(errors.blind[-1]),
            "error": math.exp(log_error),
            "error_ci": variance_interval(
                np.asarray(math.exp(log_error)), np.asarray(spread)
            ).tolist(),
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


def ranked(
    tried: Sequence[Trial], not_tried: Sequence[str], budget: int, diagnosis: Diagnosis
) -> xr.Dataset:
    """Compare all trials with the first, the set-up as given, and order them as `remedies` does."""
    start = tried[0]
    z = simultaneous_z(2 * (len(tried) - 1))  # of the errors and of the rates
    columns = [t.column(start.errors, budget, z) for t in tried]
    columns.sort(key=lambda c: float(np.nan_to_num(c["error_ratio"], nan=np.inf)))
    for column in columns:
        column["reason"] = " ".join(filter(None, [diagnosis.reason(column), column["note"]]))
    by_rate = np.argsort(np.argsort([np.nan_to_num(c["rate"], nan=np.inf) for c in columns]))
    return dataset(
        {
            **{n: (dims, np.array([c[n] for c in columns])) for n, dims in _DIMS.items()},
            "rank_by_rate": (("remedy",), by_rate + 1),
        },
        {
            "remedy": [c["name"] for c in columns],
            **{name: ("remedy", [c[name] for c in columns]) for name in _TEXTS},
            "bound": ["low", "high"],
            "step": np.arange(_STEPS),
        },
        simultaneous_z=z,
        diagnosis=diagnosis.text,
        recommendation=_recommendation(columns, budget, not_tried),
        not_tried=list(not_tried),
        given_error=float(start.errors.error[-1]),
    )


@dataclass(frozen=True)
class _Trials:
    """Set-ups that were measured, and why others could not; the diagnosis of that given."""

    tried: list[Trial]
    not_tried: list[str]
    diagnosis: Diagnosis | None

    def merge(self, other: _Trials) -> _Trials:
        """Those of both, in their order."""
        diagnosis = self.diagnosis or other.diagnosis
        return _Trials(self.tried + other.tried, self.not_tried + other.not_tried, diagnosis)


def _affordable(setup: Setup, budget: int) -> dict[int, int]:
    """The counts that fit into the budgets of the steps, each larger than the last."""
    found: dict[int, int] = {}
    for step in range(_STEPS):
        n = affordable_count(setup, budget // _RATIO ** (_STEPS - 1 - step))
        if n and n > max(found.values(), default=0):
            found[step] = n
    return found


def _interval(centre: float, half: float) -> list[float]:
    return [centre - half, centre + half]


def _verdict(interval: list[float]) -> str:
    """What an interval of a logarithm or a difference supports; lower is better."""
    low, high = interval
    return "better" if high < 0 else "worse" if low > 0 else "undecided"


def _padded(values: Array) -> list[float]:
    """Values of the last steps, NaN for those whose budget was too small."""
    return [math.nan] * (_STEPS - len(values)) + [float(v) for v in values]


def _recommendation(columns: list[dict[str, Any]], budget: int, reasons: Sequence[str]) -> str:
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
    what = "mean squared error" if best["biased"] else "variance"
    rmse = f"RMSE × {math.sqrt(best['error_ratio']):.2g}"
    text += f"{what} × {best['error_ratio']:.3g} ({rmse}; 95 %: {low:.3g} to {high:.3g})"
    rates = best["rate_ci"], _given(columns)["rate_ci"]
    if best["rate_verdict"] == "better" and all(is_resolved(*ends) for ends in rates):
        text += f", and its rate {_rate(best['rate'])} instead of {_rate(_given(columns)['rate'])}"
    reason = "" if best["reason"].startswith("Its rate") else f" {best['reason']}"
    return f"{text}.{reason}{_later(columns, best)}"


def _later(columns: list[dict[str, Any]], best: dict[str, Any] | None) -> str:
    """What pays at larger budgets: the best rate, where it is better and not that of the best."""
    found = [
        c
        for c in columns
        if c["rate_verdict"] == "better" and c is not best and is_resolved(*c["rate_ci"])
    ]
    if not found:
        return ""
    steepest = min(found, key=lambda c: float(c["rate_difference_ci"][1]))
    if best is not None and steepest["rate_ci"][1] >= best["rate_ci"][0]:
        return ""
    return (
        f" At larger budgets: {steepest['change']}, whose rate is {_rate(steepest['rate'])} "
        f"({_rate(steepest['rate_ci'][0])} to {_rate(steepest['rate_ci'][1])})."
    )


def _rate(value: float) -> str:
    """A rate as tables write it, with a proper minus."""
    return f"{value:.2f}".replace("-", "−")


def _given(columns: list[dict[str, Any]]) -> dict[str, Any]:
    return next(c for c in columns if c["kind"] == "given")


@dataclass(frozen=True)
class Errors:
    """Errors of one set-up at several costs."""

    cost: Array  # evaluations of the integrand in an estimate, (N,)
    error: Array  # mean squared error v, summed over channels, (N,)
    bias: Array  # mean estimate minus the integral, (N, C)
    influence: Array  # ψ, (N, R)
    noise: Array  # v below which the estimates differ by rounding only, (N,)
    blind: Array  # whether the estimates are all alike, but not the integral, (N,)
    # Of the cost, before the first point: it does not grow, and is no part of the rate
    overhead: int = 0

    @staticmethod
    def of(
        cost: Sequence[int],
        estimates: Sequence[Array],
        integral: Array,
        *,
        biased: bool = False,
        tolerance: float = 1e-9,
        overhead: int = 0,
    ) -> Errors:
        """Errors of estimates (R, C), one array for each cost, of the integral (C,).

        What is `biased` has its error about the integral, else about the mean of the estimates;
        `tolerance` is how well the integral is known, relative to it.
        """
        # Mean squared errors and influences (R,), about the integral or the mean
        parts = []
        for values in estimates:
            count = len(values)
            centre = integral if biased else values.mean(axis=0)
            squares = ((values - centre) ** 2).sum(axis=1)
            mean = squares.mean()
            influence = squares / mean - 1.0 if mean > 0 else np.zeros(count)
            parts.append((float(squares.sum() / (count if biased else count - 1)), influence))
        error = np.array([error for error, _ in parts])
        bias = np.stack([values.mean(axis=0) - integral for values in estimates])
        noise = np.array([rounding_floor(np.abs(v).mean(axis=0)).sum() for v in estimates])
        miss = ~(np.abs(bias).max(axis=1) <= tolerance * np.abs(integral).max())  # or not known
        alike = np.array(
            [
                np.ptp(v, axis=0).max() <= 4 * math.sqrt(f)
                for v, f in zip(estimates, noise, strict=True)
            ]
        )
        return Errors(
            cost=np.asarray(cost, np.float64),
            error=error,
            bias=bias,
            influence=np.stack([influence for _, influence in parts]),
            noise=noise,
            blind=alike & miss & (not biased),
            overhead=overhead,
        )

    @property
    def used(self) -> Array:
        """Which errors are more than rounding noise, (N,)."""
        return np.asarray(self.error > self.noise)

    @property
    def relative_se(self) -> Array:
        """Standard error of v relative to it, (N,)."""
        return np.array([_standard_error(psi) for psi in self.influence])

    def rate(self) -> tuple[float, Array]:
        """Slope of log v against log cost without overhead, and the influence of each realisation on it, (R,).

        Weighted least squares as in `mcspectra.core.fits`; NaN where fewer than two can be fitted.
        """
        used = self.used
        if used.sum() < 2:
            return math.nan, np.full(self.influence.shape[1], np.nan)
        x, y = np.log(self.cost[used] - self.overhead), np.log(self.error[used])
        weight = self.relative_se[used] ** -2.0
        centred = weight * (x - np.average(x, weights=weight))
        slope = centred / (centred * x).sum()
        return float((slope * y).sum()), weighted_sum(slope, self.influence[used])

    def fit(self) -> RateFit:
        """The rate with its interval and lack of fit, as `mcspectra.convergence` gives it."""
        return fit_rate(self.cost - self.overhead, self.error, self.relative_se, self.noise)

    def at(self, budget: float, *, carry: bool = True) -> tuple[float, Array]:
        """log v at a cost of `budget`, and its influences (R,): the last error, carried by the rate.

        Beside a pilot it is not: what that takes is lost, and counts of nets are half of what else fits.
        """
        last = len(self.cost) - 1
        if not self.used[last]:
            unknown = math.nan if self.blind[last] else -math.inf
            return unknown, np.zeros(self.influence.shape[1])
        gap = math.log(budget / self.cost[last]) if carry and not self.overhead else 0.0
        log_error, influence = math.log(self.error[last]), self.influence[last]
        if gap == 0.0:
            return log_error, influence
        rate, slope = self.rate()
        if math.isnan(rate):
            return log_error, influence
        return log_error + gap * rate, influence + gap * slope


@dataclass(frozen=True)
class Comparison:
    """One set-up against another: the ratio of variances at a budget, and the difference of rates."""

    # log(v/v_reference) and its standard error
    log_ratio: float
    log_ratio_se: float
    # Rate minus the reference's, and its standard error; NaN where a rate is
    rate_difference: float
    rate_difference_se: float


def compare(errors: Errors, reference: Errors, budget: float, pilot: int = 0) -> Comparison:
    """Compare two set-ups of as many realisations on the same random numbers.

    The reference has the budget and what a pilot of the other took beyond it.
    """
    carry = not errors.overhead and not reference.overhead
    own, own_influence = errors.at(budget, carry=carry)
    other, other_influence = reference.at(budget + pilot, carry=carry)
    rate, slope = errors.rate()
    other_rate, other_slope = reference.rate()
    # Curves that bend or wobble know their slope less well than their scatter says
    points = ((e, int(e.used.sum()) - 2) for e in (errors, reference))
    bend = max(widening(free, e.fit().chi2) if free > 0 else 1.0 for e, free in points)
    return Comparison(
        own - other,
        _standard_error(own_influence - other_influence, prior=0),
        rate - other_rate,
        bend * _standard_error(slope - other_slope, prior=0),
    )


def estimates_of(
    estimator: AbstractEstimator,
    sampler: Sampler,
    n: int,
    realizations: int,
    stream: Stream,
) -> Array:
    """Estimates of realisations 0 … realizations − 1, (R, channels or 1)."""

    def block(part: Block) -> Array:
        return estimator.estimate(estimator.draw(sampler, n, stream, *part)).reshape(part[1], -1)

    numbers = n * estimator.dims * sum(estimator.counts)
    return np.concatenate([block(part) for part in realization_blocks(realizations, numbers)])


def simultaneous_z(comparisons: int) -> float:
    """Half width, in standard errors, of 95 % intervals that all hold together [Šidák 1967]."""
    from scipy.special import ndtri

    single = 0.95 ** (1.0 / max(1, comparisons))
    return float(ndtri(0.5 * (1.0 + single)))


def _standard_error(influence: Array, prior: int = _PRIOR) -> float:
    """Root of the mean square over √R; few values are drawn towards those of normal estimates."""
    count = len(influence)
    square = (np.square(influence).sum() + 2.0 * prior) / (count + prior)
    return math.sqrt(square / count)
