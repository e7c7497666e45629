"""Remedies: changes that lower an estimator's noise at a budget, measured, ranked and explained.

Every candidate (`mcspectra.improve.candidates`) is run at the same budgets of integrand evaluations
and on the same random numbers as the given set-up. It is compared with the given set-up realization
by realization, by influences (docs/theory.md, "Intervals of variances, and stopping"). Intervals of
all comparisons hold together: a remedy is recommended only if its interval excludes the given
set-up. If all estimates are equal, either the estimator has no variance, or no estimate has hit a
rare event. If equal estimates differ from the integral, their error is unknown (NaN), not 0.
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
from mcspectra.improve.candidates import KINDS, Budget, Candidate, Kind, other_setups
from mcspectra.measure.doors import answer
from mcspectra.measure.setup import Setup, affordable_count
from mcspectra.samplers import Sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "Comparison",
    "Errors",
    "Remedies",
    "RemedySettings",
    "Trial",
    "compare",
    "estimates_of",
    "ranked",
    "remedies",
    "simultaneous_z",
]


@final
@dataclass(frozen=True)
class RemedySettings:
    """Settings of the comparison of remedies."""

    # Number of budgets at which each set-up is measured. Five budgets B/256, B/64, B/16, B/4 and B
    # give a rate, and three degrees of freedom for the lack of fit.
    steps: int = 5
    # Ratio of successive budgets. A smaller ratio costs more, in all 1/(1 − 1/ratio) times the
    # largest budget (4/3 here); a larger ratio leaves two or three budgets that are enough for two
    # counts.
    ratio: int = 4
    # Expected number of changes of each kind, for the estimate of cost and memory before a run. All
    # 15 kinds together make 16 to 18 changes of functions in 2-D, and ``sampler`` alone makes
    # seven.
    tries: int = 3
    # Largest relative difference between equal estimates and an exact integral that counts as
    # rounding. Means round to about 1e-15; the rest allows for values that cancel to 1e-6 of their
    # size.
    exact_tolerance: float = 1e-9
    # The same for an integral by quadrature or by many points, whose error estimates can be too
    # small. Equal estimates that miss a rare event differ from the integral by all of it, far more
    # than this.
    quadrature_tolerance: float = 1e-3
    # Number of standard errors of such an integral that are allowed if they exceed
    # `quadrature_tolerance`. A normal error is beyond 4 standard errors with probability 6e-5.
    sigmas: float = 4.0
    # Weight, in realizations, of the prior belief that estimates are normal, so that Var(ψ) = 2. It
    # is used in the fit of rates; comparisons do not use it. At 100 realizations it reduces the
    # scatter of standard errors of normal estimates from 12 to 10 %; intervals cover 93 to 95 % for
    # any prior from 0 to 40.
    prior: int = 20


_SETTINGS = RemedySettings()
# Stream label of searches; the labels below are of the steps
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
        """Check that the budget is enough for two counts of the given set-up."""
        given, ratio = Setup(subject.estimator, subject.sampler), _SETTINGS.ratio
        as_integer("budget", self.budget, least=ratio * given.cost)
        counts = _affordable(given, self.budget).values()
        if len(counts) < 2:
            raise ParameterError(
                f"{given.sampler.spec} has no two counts within {self.budget} evaluations for "
                f"{given.estimator.spec}, which a rate takes; give a larger budget, or a sampler of "
                "more counts."
            )
        tries = 1 + _SETTINGS.tries * len(self._kinds)
        evaluations = self.realizations * given.cost * sum(counts)
        if given.is_black_box:  # the diagnosis may take as many again
            evaluations += self.budget * self.realizations
        return Need(
            cost=float(self.budget * self.realizations * tries) * ratio / (ratio - 1),
            memory=memory_of(self.budget, subject.estimator.dims) + 16 * tries * self.realizations,
            evaluations=evaluations,
        )

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[_Trials]:
        """Measure the given set-up, then the changes of one kind after another."""
        given = Setup(subject.estimator, subject.sampler)
        start = Candidate("given", "as given", "leave everything as it is", given)
        unknown = np.isnan(given.estimator.known_integral()[0]).any()
        search = Budget(self.budget, self.realizations, stream.child(_SEARCH))
        # Divide the evaluations that the given set-up leaves equally among the kinds
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
                        name = change.name if isinstance(change, Candidate) else kinds[0]
                        not_tried.append(f"{name}: {error}")
            if index:
                return _Trials(tried, not_tried, None)
            own, most = stream.child(_SEARCH + 1), self.budget * self.realizations
            found = diagnose(given.estimator, given.sampler, own, most)
            return _Trials(tried, [], found)

        def result(found: _Trials) -> xr.Dataset:
            """Rank all set-ups by their variances; a set-up that two kinds make counts once."""
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

    def _measured(self, change: Candidate, given: Setup, stream: Stream) -> Trial | None:
        """Measure errors at counts that fit into the budgets; None for fewer than two counts."""
        setup = change.setup
        cost: list[int] = []
        estimates: list[Array] = []
        for step, n in _affordable(setup, self.budget).items():
            try:
                estimator = setup.at(n)
            except McspectraError:  # there are fewer strata than edges
                continue
            cost.append(n * setup.cost + setup.overhead)
            own = stream.child(step)
            estimates.append(estimates_of(estimator, setup.sampler, n, self.realizations, own))
        if len(cost) < 2:
            return None

        # Compute the relative tolerance of the integral
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
    """Try changes to an estimator and its sampler at equal cost, rank them, and explain the gains.

    All changes together take 10 to 25 times budget · realizations evaluations of a user's function:
    about 20 million at a budget of 1,000 with the default realizations.

    Parameters
    ----------
    estimator, sampler
        The given set-up.
    budget
        Evaluations of the integrand in one estimate. An estimate with n points takes Σ counts · n.
    dims
        Number of dims of a function, or of a spec that leaves it open. The default is the number of
        dims of the sampler, if the sampler is not a spec.
    realizations
        Realizations of each set-up at each of five budgets, from 100 to 100 000.
    rng
        Seed (SPEC 7), common to all set-ups.
    kinds
        Kinds of change to try; all by default. See `mcspectra.improve.candidates.KINDS`.
    workers
        Threads; all processors by default. Results do not depend on it.
    max_evaluations
        Most evaluations of the integrand. A limit below the evaluations of the given set-up and its
        diagnosis is refused before any evaluation. The kinds share the rest equally; a change that
        does not fit into a share is not tried.

    Returns
    -------
    xarray.Dataset
        The labels of the dim ``remedy`` are names of changes in the order of their variances at the
        budget, with ``"as given"`` among them. Variables on ``remedy``: ``error`` (the variance, or
        the mean squared error of a biased change, summed over channels) with ``error_ci``;
        ``error_ratio`` to the given set-up with ``error_ratio_ci``, which hold together at 95 %;
        ``rate`` and ``rate_ci``; ``rate_difference`` with ``rate_difference_ci``, likewise;
        ``rank_by_rate``. Coordinates: ``kind``, ``change`` (an imperative), ``verdict`` and
        ``rate_verdict`` (better, worse, undecided, given) and ``reason``. Variables on (remedy,
        step): ``cost`` and ``error_at_cost``. The attributes ``diagnosis`` and ``recommendation``
        are sentences, and ``not_tried`` lists changes that could not be tried, with reasons.

    Raises
    ------
    ParameterError, CountError
        A value is out of range, a kind is unknown, or the budget is too small for the set-up.

    Notes
    -----
    ``fitted``, ``regression``, ``order`` and ``preintegrated`` change the estimator after a pilot
    of an eighth of the budget (at most 4096 evaluations), and keep its integral. If no count of
    points costs exactly the budget, the largest count below is measured, and the error is
    extrapolated to the budget along the fitted rate. The interval includes the uncertainty of the
    slope. Errors are not extrapolated for changes with a pilot. A user's function is evaluated at
    most 4/3 · budget · realizations times for each set-up, and 7/3 · budget · realizations times
    for the given set-up's diagnosis. Searches for offsets of strata and for widths of smooth edges
    take more evaluations, so that these changes are not tried for a user's function. Biased changes
    are not tried if ∫f is unknown. The error of a change that is biased, by smoothing or by a
    sampler that is not randomized, is taken about the integral of the given estimator. A change to
    another integral has no rate, since its error converges to the square of the bias. Pilots of
    heuristics and the values of a mean over a box count as evaluations. If all estimates are equal
    but differ from the integral, they have missed a rare event: error and ratio are NaN, and the
    verdict is undecided. Set-ups without a rate are last by rate.

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
    """A set-up that was measured at up to five costs, and its errors."""

    kind: str
    name: str
    change: str
    setup: str  # specs of estimator and sampler, and the name of a change that depends on n
    biased: bool
    errors: Errors
    # For other warps: whether ∫1/p diverges, and whether g jumps inside; None if it was not tested
    unbounded: bool = False
    jumps: bool | None = None
    # Evaluations of a pilot beyond the budget, which are added to the budget of the given set-up
    pilot: int = 0
    note: str = ""  # a sentence after the reason

    def column(self, reference: Errors, budget: int, z: float) -> dict[str, Any]:
        """Return all results of the set-up, compared with the given set-up."""
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
    """Compare all trials with the first, the given set-up, and sort them; see `remedies`."""
    start = tried[0]
    z = simultaneous_z(2 * (len(tried) - 1))  # one comparison of errors and one of rates each
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
            "step": np.arange(_SETTINGS.steps),
        },
        simultaneous_z=z,
        diagnosis=diagnosis.text,
        recommendation=_recommendation(columns, budget, not_tried),
        not_tried=list(not_tried),
        given_error=float(start.errors.error[-1]),
    )


@dataclass(frozen=True)
class _Trials:
    """Measured set-ups, reasons why others were not measured, and the diagnosis of the given one."""

    tried: list[Trial]
    not_tried: list[str]
    diagnosis: Diagnosis | None

    def merge(self, other: _Trials) -> _Trials:
        """Return the trials of both, in their order."""
        diagnosis = self.diagnosis or other.diagnosis
        return _Trials(self.tried + other.tried, self.not_tried + other.not_tried, diagnosis)


def _affordable(setup: Setup, budget: int) -> dict[int, int]:
    """Return the ascending counts that fit into the budgets of the steps, by step."""
    found: dict[int, int] = {}
    for step in range(_SETTINGS.steps):
        n = affordable_count(setup, budget // _SETTINGS.ratio ** (_SETTINGS.steps - 1 - step))
        if n and n > max(found.values(), default=0):
            found[step] = n
    return found


def _interval(centre: float, half: float) -> list[float]:
    return [centre - half, centre + half]


def _verdict(interval: list[float]) -> str:
    """Return the verdict of an interval of a logarithm or a difference; lower is better."""
    low, high = interval
    return "better" if high < 0 else "worse" if low > 0 else "undecided"


def _padded(values: Array) -> list[float]:
    """Return the values of all steps, NaN for the first steps, whose budget was too small."""
    return [math.nan] * (_SETTINGS.steps - len(values)) + [float(v) for v in values]


def _recommendation(columns: list[dict[str, Any]], budget: int, reasons: Sequence[str]) -> str:
    """Return the recommendation that the intervals support."""
    if _given(columns)["blind"]:
        return (
            "All estimates of the set-up as given are alike and miss the integral: none has met what "
            "makes it. Nothing can be said; give more realizations or a larger budget."
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
    """Return a sentence about the change with the best rate, if larger budgets favor it."""
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
    """Return a rate with two digits and a proper minus, as in tables."""
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
    blind: Array  # whether the estimates are all equal, but differ from the integral, (N,)
    # Evaluations before the first point; the rate leaves them out, since they do not grow
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
        """Compute errors of estimates (R, C), one array for each cost, of the integral (C,).

        Errors are about the integral if `biased`, else about the mean of the estimates. `tolerance`
        is the relative tolerance of the integral.
        """
        # Compute mean squared errors and influences (R,), about the integral or the mean
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
        """Fit the slope of log v against log cost without overhead, and its influences (R,).

        The fit is by weighted least squares as in `mcspectra.core.fits`; NaN for fewer than two
        errors.
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
        """Fit the rate with its interval and lack of fit; see `mcspectra.convergence`."""
        return fit_rate(self.cost - self.overhead, self.error, self.relative_se, self.noise)

    def at(self, budget: float, *, carry: bool = True) -> tuple[float, Array]:
        """Return log v at a cost of `budget` and its influences (R,), extrapolated along the rate.

        The last error is not extrapolated after a pilot: its evaluations are lost, and nets then
        often have half the points that would fit into the budget.
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
    """Ratio of the variances of two set-ups at a budget, and the difference of their rates."""

    # log(v/v_reference) and its standard error
    log_ratio: float
    log_ratio_se: float
    # Difference of the rate and the reference's rate, and its standard error; NaN if a rate is NaN
    rate_difference: float
    rate_difference_se: float


def compare(errors: Errors, reference: Errors, budget: float, pilot: int = 0) -> Comparison:
    """Compare two set-ups with the same number of realizations on the same random numbers.

    The budget of the reference includes `pilot` evaluations that the other set-up took beyond it.
    """
    carry = not errors.overhead and not reference.overhead
    own, own_influence = errors.at(budget, carry=carry)
    other, other_influence = reference.at(budget + pilot, carry=carry)
    rate, slope = errors.rate()
    other_rate, other_slope = reference.rate()
    # Widen the error of the slope if the curves do not follow a line within their scatter
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
    """Return the estimates of realizations 0 … realizations − 1, (R, channels or 1)."""

    def block(part: Block) -> Array:
        return estimator.estimate(estimator.draw(sampler, n, stream, *part)).reshape(part[1], -1)

    numbers = n * estimator.dims * sum(estimator.counts)
    return np.concatenate([block(part) for part in realization_blocks(realizations, numbers)])


def simultaneous_z(comparisons: int) -> float:
    """Return the half width in standard errors of 95 % intervals that hold together [Šidák 1967]."""
    from scipy.special import ndtri

    single = 0.95 ** (1.0 / max(1, comparisons))
    return float(ndtri(0.5 * (1.0 + single)))


def _standard_error(influence: Array, prior: int = _SETTINGS.prior) -> float:
    """Return the root mean square over √R, with a prior of normal estimates for few values."""
    count = len(influence)
    square = (np.square(influence).sum() + 2.0 * prior) / (count + prior)
    return math.sqrt(square / count)
