"""One call: what an estimator's noise is, why, and what to do, within a budget of evaluations.

Most of the budget goes to scrambled nets, which tell the variance of several samplers at once (`samples`), a
fifth to lines that show what is rough (`probing`), some to the sampler that is given, where the nets do
not tell of it. From these the causes are read (`causes`); what is left measures a change that answers
them, or antithetic pairs in strata where there is none.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import Analysis, Need, Reduction, Subject, whole
from mcspectra.core.checks import Array, as_integer, in_unit_cube
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.core.display import escape_html
from mcspectra.core.errors import (
    CountError,
    DomainError,
    McspectraError,
    NoClosedForm,
    ParameterError,
)
from mcspectra.core.memory import memory_of
from mcspectra.core.results import dataset, strict_json
from mcspectra.core.streams import RngLike, Stream
from mcspectra.densities.base import FunctionDensity
from mcspectra.estimators import (
    AbstractEstimator,
    Estimator,
    as_estimator,
    function_dims,
    is_function,
)
from mcspectra.estimators.moments import Moments, variance_interval
from mcspectra.explain.causes import (
    FEW_NETS,
    GIVEN,
    Cause,
    Evidence,
    Replicates,
    causes_of,
    is_apart,
    sets_of,
    shares_of,
)
from mcspectra.explain.probing import COARSE, grain
from mcspectra.explain.samples import NETS, Curve, Sets, curve_of, scalar
from mcspectra.improve.improved import CHANGES, Evaluations, Improvement, improvements
from mcspectra.integrands import Calls, FunctionIntegrand, Integrand
from mcspectra.measure.chains import chain_error
from mcspectra.measure.doors import counted
from mcspectra.measure.setup import Setup, affordable_count
from mcspectra.samplers import Sampler, as_sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Change", "Profile", "Profiling", "profile"]

_LEAST = 256  # evaluations
_WIDTH = 100  # columns of the text of a cause
_FITTED = 64  # points of each net, that changes are fitted to
_DEPENDENT = 0.7  # of all draws: fewer effective ones are a cause
_LEAST_CHECKED = 4  # points that a change is measured at
_GIVEN_COUNTS = 5
_LEAST_SETS = 3
_PAIRS = "antithetic-jittered"
_THEORY = 0.08  # of a rate, at counts of points that are not large
# Causes that are of a sampler's sets alone
_OF_SETS = {"deterministic-set", "few-realizations", "correlated-replicates"}
_EXPONENTS = {"interior-jump": 1.0, "axis-parallel-jump": 1.0, "none": 2.0}  # beyond random points
_TEETH = 0.5  # of a slope over few octaves, as ends of strata fall anywhere beside a jump
_ALIKE = 0.4  # rates of estimators before and after a change, unless they are seen to differ
_OFF = 4.0  # standard errors
_FEW_POINTS, _STEEPEST = 16, -2.0
_WEIGHTED = 3  # functions: f, pdf and sample
_FIGURES = ("rmse", "rmse_given", "gain", "samples_saved")
_SEEN = 64  # points of a density that are looked at


@final
class Profiling(Analysis, frozen=True, kw_only=True):
    """The noise of an estimator: its size, its causes, and the best remedy."""

    function = "profile"
    verb = "profile"
    variables = (
        "variance",
        "variance_ci",
        "rmse",
        "rate",
        "rate_ci",
        "integral",
        "integral_ci",
        "calls",
    )
    provenance = ("estimator", "stream_key")

    budget: Annotated[
        int,
        Meta(
            ge=_LEAST,
            le=2**30,
            description="Most evaluations of the integrand in all.",
            extra={"metavar": "B"},
        ),
    ] = 4096

    def need(self, subject: Subject) -> Need:
        """The budget is enough for a few points of several nets; techniques have sets of their own."""
        estimator = subject.estimator
        if not isinstance(estimator, AbstractEstimator):
            raise ParameterError("profile takes one estimator at a time.")
        try:
            estimator.check_independent()
        except NoClosedForm as error:
            raise ParameterError(
                f"profile needs techniques with sets of their own: {error}"
            ) from None
        shares_of(estimator, subject.sampler, self.budget)
        memory = memory_of(self.budget, estimator.dims, sum(estimator.counts))
        return Need(cost=float(self.budget), memory=memory)

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[xr.Dataset]:
        """In one block: what is tried depends on what is found."""
        return whole(lambda: _profiled(subject, self.budget, stream).dataset, self.budget)


@final
@dataclass(frozen=True)
class Change:
    """What to do, and what it is expected to bring.

    Attributes
    ----------
    name, change
        A short label, and an imperative.
    rmse, rmse_given
        Root mean square error at the budget after the change, and as given.
    gain, gain_ci
        Variance as given over that after the change, and its 95 % interval.
    samples_saved
        Evaluations that the set-up as given takes for the same error, less the budget.
    estimator, sampler
        The set-up after the change, for `mcspectra.convergence` and its like.
    """

    name: str
    change: str
    rmse: float
    rmse_given: float
    gain: float
    gain_ci: tuple[float, float]
    samples_saved: float
    estimator: AbstractEstimator
    sampler: str


@final
@dataclass(frozen=True)
class Profile:
    """What was found; `text` says it.

    Attributes
    ----------
    integral, interval
        The mean of all nets, and its 95 % interval; infinite where the variance is, or where a few
        evaluations make it.
    calls, budget
        Evaluations of f that were made, and that were allowed.
    variance, rate, rate_ci
        Of an estimate of `budget` evaluations with the sampler that is given, with nets where that could
        not be measured; and the slope of its variance.
    points
        n of such an estimate: the budget over what each point takes.
    reference
        What `best` is held against: the sampler that is given, or random points where that is the same
        set every time or could not be measured.
    causes
        Most important first.
    best
        What to do; None where nothing is better than what is given.
    samplers
        Curves of variance by sampler.
    tried, not_tried
        What was compared, and what could not be and why.
    """

    subject: str
    given: str
    integral: float
    interval: tuple[float, float]
    calls: int
    budget: int
    variance: float
    rate: float
    rate_ci: tuple[float, float]
    causes: list[Cause]
    best: Change | None
    samplers: Mapping[str, Curve]
    tried: list[str]
    not_tried: list[str]
    points: int = 0
    reference: str = ""

    @property
    def answer(self) -> str:
        """What to do and why, in two or three sentences."""
        cause = self.causes[0]
        why = "" if cause.name == "none" else f" Cause: {cause.name}. {cause.sentence}"
        if not self.samplers:
            low, high = self.interval
            return f"The mean of the draws is {_shown(self.integral, low, high)}.{why}"
        if cause.name == "wrong-pdf":
            return f"Mend the density first.{why}"
        if self.best is None and math.isinf(self.variance):
            return f"Nothing that was tried helps.{why}"
        if self.best is None:
            untried = ""
            if cause.evidence.get("resolved_by", math.inf) <= self.points:
                untried = " One set of as many points as resolve the waves was not tried."
            if self.reference not in {self.given, ""}:
                return f"Nothing that was tried is better than {self.reference}.{why}{untried}"
            return f"Keep {self.given}: nothing that was tried is better.{why}{untried}"
        best = self.best
        given = f"{best.rmse_given:.2g}" if math.isfinite(best.rmse_given) else "an infinite one"
        if math.isnan(best.gain):
            return (
                f"{best.change[0].upper()}{best.change[1:]}: it was better where both were measured, by how much "
                f"at {self.budget} evaluations these cannot tell.{why}"
            )
        text = (
            f"{best.change[0].upper()}{best.change[1:]}: RMSE {best.rmse:.2g} instead of {given} at "
            f"{self.budget} evaluations"
        )
        if math.isfinite(best.samples_saved) and best.samples_saved > 0:
            needed = float(f"{best.samples_saved + self.budget:.2g}")
            text += f", which would take about {needed:.0f} with {self.reference}"
        return f"{text}.{why}"

    @property
    def text(self) -> str:
        """All of it, as lines of text."""
        low, high = self.interval
        found = [
            # The causes follow with their sentences
            self.answer.replace(f" {self.causes[0].sentence}", "", 1),
            "",
            f"integral   {_shown(self.integral, low, high)}",
        ]
        found.append("causes")
        for cause in self.causes:
            line = f"{cause.name}: {cause.sentence}"
            found += textwrap.wrap(line, _WIDTH, initial_indent="  ", subsequent_indent="    ")
        if not self.samplers:
            return "\n".join(found)
        found.append(f"calls      {self.calls} of {self.budget}")
        found.append(f"samplers   RMSE at {self.budget} evaluations, rate of the variance")
        for name, rmse, rate in self._rows():
            found.append(f"  {name:<20} {rmse:>10}   {rate}")
        found += [f"not tried  {reason}" for reason in self.not_tried]
        return "\n".join(found)

    def _rows(self) -> list[tuple[str, str, str]]:
        rows = []
        for name, curve in sorted(self.samplers.items(), key=lambda c: c[1].at(self.points)[0]):
            low, high = curve.rate_ci
            known = curve.rate_se == 0.0
            rate = f"{curve.rate:.2f}" + ("" if known else f" ({low:.2f} to {high:.2f})")
            if math.isnan(curve.rate):
                rate = "no error seen" if curve.vanishes <= self.points else "none"
            rmse = self._rmse(curve)
            shown = "not known" if math.isnan(rmse) else f"{rmse:.3g}"
            rows.append((name, shown, rate.replace("-", "−")))
        return rows

    def _rmse(self, curve: Curve) -> float:
        """At the budget; NaN where nothing is known beyond the counts, or nothing was met that varies."""
        if math.isinf(self.variance):
            return math.inf
        if math.isnan(curve.rate) and max(curve.counts, default=math.inf) < self.points:
            return 0.0 if self.points >= curve.vanishes else math.nan
        rmse = math.sqrt(curve.at(self.points)[0])
        return rmse if rmse or math.isfinite(self.interval[1]) else math.nan

    def __str__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        rows = "".join(
            "<tr>" + "".join(f"<td>{escape_html(cell)}</td>" for cell in row) + "</tr>"
            for row in self._rows()
        )
        causes = "".join(
            f"<li><b>{cause.name}</b>: {escape_html(cause.sentence)}</li>" for cause in self.causes
        )
        return (
            f"<p><b>{escape_html(self.answer)}</b></p><ul>{causes}</ul>"
            f"<table><tr><th>sampler</th><th>RMSE at {self.budget}</th><th>rate</th></tr>{rows}</table>"
        )

    @property
    def dataset(self) -> xr.Dataset:
        """The curves on (sampler, n), NaN where a sampler was not looked at, and the answer as attributes."""
        ns = sorted({int(n) for curve in self.samplers.values() for n in curve.counts})
        place = {n: k for k, n in enumerate(ns)}
        shape = (len(self.samplers), len(ns))
        variance, ends = np.full(shape, np.nan), np.full((*shape, 2), np.nan)
        for row, curve in enumerate(self.samplers.values()):
            at = [place[int(n)] for n in curve.counts]
            variance[row, at] = curve.variance
            ends[row, at] = variance_interval(curve.variance, np.maximum(curve.relative_se, 1e-9))
        curves = self.samplers.values()
        plain = self.to_dict()
        return dataset(
            {
                "variance": (("sampler", "n"), variance),
                "variance_ci": (("sampler", "n", "bound"), ends),
                "rmse": (("sampler",), np.array([self._rmse(curve) for curve in curves])),
                "rate": (("sampler",), np.array([curve.rate for curve in curves])),
                "rate_ci": (("sampler", "bound"), np.array([curve.rate_ci for curve in curves])),
                "integral": ((), np.float64(self.integral)),
                "integral_ci": (("bound",), np.array(self.interval)),
                "calls": ((), np.int64(self.calls)),
            },
            {
                "n": counted("n", ns, "number of points"),
                "sampler": list(self.samplers),
                "bound": ["low", "high"],
            },
            budget=self.budget,
            given=self.given,
            answer=self.answer,
            text=self.text,
            **{name: json.dumps(strict_json(plain[name])) for name in ("causes", "best")},
            not_tried="; ".join(self.not_tried) or None,
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, texts and lists."""
        found = {
            name: getattr(self, name)
            for name in (
                *("subject", "given", "integral", "calls", "budget", "variance", "rate"),
                *("tried", "not_tried", "answer"),
            )
        }
        found["interval"], found["rate_ci"] = list(self.interval), list(self.rate_ci)
        found["causes"] = [{**asdict(cause), "kinds": list(cause.kinds)} for cause in self.causes]
        found["best"] = (
            None
            if self.best is None
            else {**vars(self.best), "estimator": self.best.estimator.spec}
        )
        shown = ("counts", "variance", "relative_se", "rate", "rate_ci")
        found["samplers"] = {
            sampler: {name: np.asarray(getattr(curve, name)).tolist() for name in shown}
            for sampler, curve in self.samplers.items()
        }
        return found


def profile(
    f: Any,
    *,
    sampler: Any = "random",
    dims: int | None = None,
    budget: int = 4096,
    rng: RngLike = 0,
    vectorized: bool = True,
    workers: int = 1,
    cache: str | os.PathLike[str] | None = None,
) -> Profile:
    """Find what an estimator's noise is, why, and what to do.

    Parameters
    ----------
    f
        A vectorised function of points (…, d) to values (…), an integrand, an estimator, or a spec; three
        functions (f, pdf, sample) on the unit cube, where points are drawn by sample(u) and weighted with
        1/pdf; or draws of Markov chains, or independent estimates, as `chain_error` takes them, which are
        not sampled further.
    sampler
        What is used today.
    dims
        Number of dims, of functions and specs; by default those of a sampler that is not a spec.
    budget
        Evaluations of f, at most and in all, from 256. Where f is quick, 262,144 tell rates to about 0.05 instead
        of 0.1, in less than a second.
    rng
        Seed (SPEC 7).
    vectorized, workers, cache
        Of functions that are slow: as of `mcspectra.integrands.Calls`. What was interrupted goes on from the
        cache.

    Returns
    -------
    Profile
        ``print`` it; `Profile.to_dict` has all numbers, `Profile.dataset` the curves.

    Raises
    ------
    ParameterError
        No function, or the budget is too small for it.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> found = mcs.profile(lambda x: abs(x.sum(axis=-1) - 0.8), dims=2)
    >>> found.causes[0].name, found.best.name
    ('kink', 'sobol | owen')
    """
    weighted = isinstance(f, tuple) and len(f) == _WEIGHTED and all(map(callable, f))
    if not (isinstance(f, AbstractEstimator | Integrand | str) or callable(f) or weighted):
        return _of_draws(f)
    limit = as_integer("budget", budget, least=_LEAST, most=2**30)
    given, *density = f if weighted else (f,)
    calls = given.function if isinstance(given, FunctionIntegrand) else None
    if is_function(given):
        # A function goes behind the door that counts its calls
        known = sampler.dims if dims is None and isinstance(sampler, Sampler) else dims
        calls = Calls(
            given,
            dims=function_dims(given, known),
            budget=limit,
            vectorized=vectorized,
            workers=workers,
            cache=cache,
        )
        given = FunctionIntegrand(function=calls, dims=calls.dims)
    with calls if isinstance(calls, Calls) else contextlib.nullcontext():
        estimator = as_estimator(given, dims)
        if density:  # not checked here, as what it does wrong is a cause
            pdf, sample = density
            own = FunctionDensity(dims=estimator.dims, pdf_function=pdf, sample_function=sample)
            u = as_sampler("random", own.primary_dims).draw(_SEEN)[0]
            x = np.zeros(1)
            with contextlib.suppress(Exception):  # which is a cause, as all that is wrong with it
                x = np.asarray(sample(u), float)
            if np.isfinite(x).all() and not in_unit_cube(x):
                raise DomainError(
                    f"sample(u) leaves the unit cube, from {x.min():.4g} to {x.max():.4g}; map f and pdf into it, "
                    "or give the function f(sample(u)) / pdf(sample(u)) of u alone."
                )
            estimator = Estimator(given, dims=dims)
            estimator.density = own
        subject = Subject(estimator, as_sampler(sampler, estimator.dims))
        Profiling(budget=limit).need(subject)
        found = _profiled(subject, limit, Stream.from_rng(rng))
    if isinstance(calls, Calls):
        calls.budget = sys.maxsize  # what is advised can be used
    return found


def _of_draws(draws: Any) -> Profile:
    """What chains say of themselves; draws that depend on each other are a cause, too."""
    try:
        found = chain_error(draws)
    except McspectraError as error:
        raise ParameterError(
            f"{draws!r:.80} cannot be profiled; give a function, an integrand, an estimator, a spec, or "
            f"draws as measure.chain_error takes them: {error}"
        ) from None
    if found["mean"].ndim:
        raise ParameterError("The draws are of several quantities; profile one at a time.")
    names = found["cause"].item().split(", ")
    said = found["evidence"].item() or "the draws say nothing against their error"
    said = [each.removeprefix(f"{k}: ") for k, each in zip(names, said.split("; "), strict=True)]
    name, (sentence, *others) = names[0], [f"{each[0].upper()}{each[1:]}." for each in said]
    count, effective = found.attrs["chains"] * found.attrs["draws"], float(found["ess"])
    evidence = {"draws": float(count), "effective": effective}
    if name == "none" and float(found["ess_ci"][1]) < _DEPENDENT * count:
        name = "correlated-replicates"
        sentence = f"The {count} draws depend on each other and count as {effective:.0f}."
    step = grain(draws) if isinstance(draws, np.ndarray) else 0.0
    spread = float(found["mcse"]) * math.sqrt(effective)
    if name == "none" and step > COARSE * spread:
        name, evidence = "float-drift", {"step": step, "spread": spread}
        sentence = f"Draws are rounded to steps of {step:.2g}, beside a spread of {spread:.2g}."
    low, high = found["mean_ci"].values.tolist()
    return Profile(
        subject="draws",
        given="draws",
        integral=float(found["mean"]),
        interval=(low, high),
        calls=0,
        budget=0,
        variance=float(found["mcse"]) ** 2,
        rate=-1.0,
        rate_ci=(-1.0, -1.0),
        causes=[Cause(name, sentence, evidence), *map(Cause, names[1:], others)],
        best=None,
        samplers={},
        tried=[],
        not_tried=[],
    )


def _shape(causes: Sequence[Cause]) -> str:
    """The first cause that is of g itself: what is wrong with the sets of a sampler leaves the rates of others."""
    return next((cause.name for cause in causes if cause.name not in _OF_SETS), "none")


def _profiled(subject: Subject, budget: int, stream: Stream) -> Profile:
    estimator, given = subject.estimator, subject.sampler
    evidence = Evidence.of(estimator, given, budget, stream)
    sets, calls = evidence.sets, evidence.calls
    each = sum(estimator.counts) * estimator.evaluations_per_point
    points = budget // each

    # The sampler as given
    curves, not_tried = dict(evidence.curves), []
    evidence = replace(evidence, curves=curves)
    if is_apart(estimator, given):
        given_stream = stream.child(99)
        try:
            curve, replicates, cost = _measured(estimator, given, int(GIVEN * budget), given_stream)
            curves[given.spec] = curve
            evidence = replace(evidence, replicates=replicates)
            calls += cost
        except McspectraError as error:
            not_tried.append(f"{given.spec}: {error}")
            source, count = estimator.randomized(given), int(min(FEW_NETS, sets_of(given)))
            if count > 1:
                n = given.nearest_count(sets.points[0].shape[1] // sets.counts[0])
                drawn = estimator.draw(source, n, given_stream, 0, count)
                evidence = replace(evidence, replicates=_replicates(drawn, np.empty(0)))

    causes = causes_of(evidence)
    # Pairs about the centres of strata, which nets do not tell of, have the exponent −1 − 4/d where g is
    # smooth: cubic stratification of second order
    if _shape(causes) == "none" and estimator.counts == (1,) and given.spec != _PAIRS:
        with contextlib.suppress(McspectraError):  # too many dims, or too few evaluations
            pairs = as_sampler(_PAIRS, estimator.dims)
            curve, _, cost = _measured(estimator, pairs, budget - calls, stream.child(97))
            calls += cost
            curves |= {_PAIRS: curve} if math.isfinite(curve.rate) else {}
    curves |= {
        name: _by_theory(name, curve, causes, estimator.dims, points)
        for name, curve in curves.items()
    }
    # What is the same every time, or was not measured, is no reference
    fixed = any(cause.name in {"deterministic-set", "correlated-replicates"} for cause in causes)
    if any(cause.name == "deterministic-set" for cause in causes):
        curves.pop(given.spec, None)  # by which it has no error
    reference = "random" if fixed or given.spec not in curves else given.spec
    best, changed = None, list[str]()
    if all(c.name != "infinite-variance" or c.kinds for c in causes):  # there is an integral
        usable = {name: c for name, c in curves.items() if name == reference or name != given.spec}
        # The sampler of least variance, if its interval leaves the one that is given out
        sizes = {name: curve.at(points) for name, curve in usable.items()}
        name = min(sizes, key=lambda c: sizes[c][0] * math.exp(sizes[c][1]))
        varies = len(usable[reference].counts) > 0  # else there is no variance to lower
        if name != reference and varies:
            source, count, change = as_sampler(name, estimator.dims), points, f"use {name}"
            if source.nearest_count(points) != points:
                count = affordable_count(Setup(estimator, source), points * each) or points
                change += f" with n = {count}"
            after, setup = usable[name].at(count), (estimator, name)
            best = _change(usable, reference, points, name, change, after, setup)
            best = best if best.gain_ci[0] > 1.0 else None
        best, changed, cost = _improved(
            evidence, causes, best, reference, budget, budget - calls, stream.child(98)
        )
        calls += cost
    curve = curves.get(given.spec, curves[NETS])
    # Values that rest on few of them say nothing of what they missed, unless lines have seen how g grows
    names = {cause.name for cause in causes}
    infinite = "infinite-variance" in names
    if infinite and best is not None:
        endless = dict.fromkeys(("rmse_given", "gain", "samples_saved"), math.inf)
        endless_best = replace(best, **endless, gain_ci=(math.inf, math.inf))  # type: ignore[arg-type]
        best = None if best.estimator is estimator else endless_best  # no sampler makes it finite
    resolved = bool(Moments.of(sets.pooled, tails=True).resolved)
    known = not infinite and "wrong-pdf" not in names
    known &= resolved or "border-growth" in names
    # What is to be said where all values are the same
    if len(sets.values) == 1 and not np.ptp(sets.pooled) > 0.0:
        value, count = float(sets.pooled[0]), sets.pooled.size
        exact = estimator.primary_integrand(0)._integral()
        mean = math.nan if exact is None else float(np.mean(exact))
        if exact is None:
            cause = Cause(
                "few-realizations",
                f"g is {value:.6g} at all {count} points: either it is constant, or what varies, in less "
                f"than about {3 / count:.1g} of the volume, was not met.",
                {"points": float(count)},
            )
        elif np.isclose(mean, value, rtol=1e-12, atol=0.0):
            cause = Cause("none", f"g is {value:.6g} everywhere: there is no noise.")
        else:
            cause = Cause(
                "heavy-tail",
                f"g is {value:.6g} at all {count} points, and its integral is {mean:.6g}: what makes the "
                "difference was not met. Give a density that finds it, or far more points.",
                {"integral": mean},
            )
        causes, best, known = [cause], None, known and cause.name == "none"
    # What was not resolved may be anything: that a change is better was measured, not by how much
    if best is not None and not infinite and (not known or best.gain_ci[0] <= 1.0):
        best = replace(best, **dict.fromkeys(_FIGURES, math.nan), gain_ci=(math.nan, math.nan))  # type: ignore[arg-type]
    return Profile(
        subject=estimator.spec,
        given=given.spec,
        integral=float(sets.estimates.mean()),
        interval=sets.interval if known else (-math.inf, math.inf),
        calls=calls,
        budget=budget,
        variance=math.inf if infinite else curve.at(points)[0],
        rate=curve.rate,
        rate_ci=curve.rate_ci,
        causes=causes,
        best=best,
        samplers=curves,
        tried=[*curves, *changed],
        not_tried=not_tried,
        points=points,
        reference=reference,
    )


def _shown(value: float, low: float, high: float) -> str:
    """A number and its interval, with the digits that tell the ends apart."""
    digits = 6
    if math.isfinite(high - low) and high > low:
        digits = max(digits, math.ceil(math.log10(max(abs(low), abs(high)) / (high - low))) + 2)
    return f"{value:.{min(digits + 2, 17)}g} (95 %: {low:.{digits}g} to {high:.{digits}g})"


def _by_theory(name: str, curve: Curve, causes: Sequence[Cause], dims: int, points: int) -> Curve:
    """A curve with what its causes say of its rate, up to so many points."""
    names = {cause.name: cause for cause in causes}
    if "infinite-variance" in names:
        return replace(curve, rate=math.nan, rate_se=math.nan)
    # Sets seldom reach what grows without bound
    for cause in causes:
        if cause.name in {"border-growth", "heavy-tail"} and "exponent" in cause.evidence:
            return replace(curve, rate=max(curve.rate, -2.0 * (1.0 - cause.evidence["exponent"])))
    # Small sets do not tell of larger ones that resolve the waves
    waves = names.get("high-frequency")
    resolved_by = math.inf if waves is None else waves.evidence["resolved_by"]
    if name != "random" and max(curve.counts, default=math.inf) < resolved_by <= points:
        return replace(curve, rate=math.nan, rate_se=math.nan)
    first = _shape(causes)
    if name not in {NETS, "jittered"} or first not in _EXPONENTS or not math.isfinite(curve.rate):
        return curve
    # Of n strata n^(1 − 1/d) meet a jump; nets see one along axes as in 1-D, and so what is smooth, but for at
    # most d − 1 logarithms: two thirds of them, give or take one
    strata = name == "jittered" or first == "interior-jump"
    third = 0.0 if strata else (dims - 1) / (3.0 * math.log(curve.counts[-1]))
    rate = -1.0 - _EXPONENTS[first] / (dims if strata else 1) + 2.0 * third
    if first == "axis-parallel-jump":  # the curve is a saw
        curve = replace(curve, rate_se=math.hypot(curve.rate_se, _TEETH))
    return curve.towards(rate, math.hypot(_THEORY, third))


def _measured(
    estimator: AbstractEstimator, sampler: Sampler, evaluations: int, stream: Stream
) -> tuple[Curve, Replicates, int]:
    """The curve of a sampler by sets of its own, within so many evaluations, and how many it took."""
    each = sum(estimator.counts) * estimator.evaluations_per_point
    sets = drawn = int(min(FEW_NETS, sets_of(sampler)))
    if sets < _LEAST_SETS:
        raise CountError(f"{sampler.spec} has {sets} sets; give {_LEAST_SETS} or more.")
    setup, counts = Setup(estimator, sampler), list[int]()
    while sets > _LEAST_SETS and affordable_count(setup, evaluations // (2 * sets)) is None:
        sets -= 1
    for k in range(_GIVEN_COUNTS):
        n = affordable_count(setup, evaluations // (sets << k + 1))
        if n is not None and n not in counts:
            counts.append(n)
    if not counts:
        raise CountError(
            f"{sampler.spec} has no count of points that fits into {evaluations} evaluations."
        )
    counts.sort()
    found, source = list[Array](), estimator.randomized(sampler)
    for n in counts:
        points = estimator.draw(source, n, stream.child(n), 0, drawn)
        values = [
            scalar(estimator, estimator.primary_values(t, u[:sets])) for t, u in enumerate(points)
        ]
        found.append(np.asarray(sum(v.mean(axis=1) for v in values)))
    cost = sum(counts) * sets * each
    return curve_of(counts, found), _replicates(points, found[-1]), cost


def _replicates(points: Sequence[Array], estimates: Array) -> Replicates:
    """Sets of each technique's points (R, n, d), which cost no evaluations, and what is known of some of them."""
    x = np.concatenate([np.asarray(p) for p in points], axis=1)
    angle = 2.0 * math.pi * x
    waves = [each.mean(axis=1) for each in (x - 0.5, np.cos(angle), np.sin(angle))]
    different = len(np.unique(x.reshape(len(x), -1), axis=0))
    return Replicates(estimates, np.concatenate(waves, axis=1), different)


def _change(
    curves: Mapping[str, Curve],
    given: str,
    n: int,
    name: str,
    change: str,
    after: tuple[float, float],
    setup: tuple[AbstractEstimator, str],
) -> Change:
    """What a change brings: the variance after it and the error of its logarithm, beside what is given."""
    (value, error), (other, other_error) = after, curves[given].at(n)
    gain = other / value if value > 0.0 else math.inf
    half = CONFIDENCE_Z * math.hypot(error, other_error)
    rate = curves[given].rate if math.isfinite(curves[given].rate) else -1.0
    needed = n * gain ** (-1.0 / rate) if rate < 0.0 and math.isfinite(gain) else math.inf
    return Change(
        name=name,
        change=change,
        rmse=math.sqrt(value),
        rmse_given=math.sqrt(other),
        gain=gain,
        gain_ci=(gain * math.exp(-half), gain * math.exp(half)),
        samples_saved=(needed - n) * sum(setup[0].counts),
        estimator=setup[0],
        sampler=setup[1],
    )


def _improved(
    evidence: Evidence,
    causes: Sequence[Cause],
    best: Change | None,
    given: str,
    budget: int,
    left: int,
    stream: Stream,
) -> tuple[Change | None, list[str], int]:
    """The change of the estimator that answers its causes, measured with nets; names and calls of what was tried.

    It is fitted to the evaluations at nets, and measured at as many points as what is left allows; where it is
    better than the best sampler at as many evaluations, its own curve tells of the budget.
    """
    estimator = evidence.estimator
    kinds = list(dict.fromkeys(k for cause in causes for k in cause.kinds if k in CHANGES))
    if not kinds or len(estimator.counts) > 1 or estimator.channels:
        return best, [], 0
    points, values = (
        np.concatenate(list(each[0][:, :_FITTED]))
        for each in (evidence.sets.points, evidence.sets.values)
    )
    offers, seen = list[Improvement](), Evaluations.of(points, values)
    for kind in kinds:
        with contextlib.suppress(McspectraError):  # it has nothing to offer here
            offers += improvements(estimator, seen, [kind])
    # Few densities make an infinite variance finite
    for cause in causes:
        if cause.name == "infinite-variance":
            index = cause.evidence.get("exponent", cause.evidence.get("tail_index", 0.0))
            offers = [offer for offer in offers if offer.finite_below > index]
    # What takes a jump away gains with nets, which its variance at random points does not tell: it is first
    jumps = _shape(causes) == "interior-jump"
    offers.sort(key=lambda offer: (not (jumps and offer.kind == "preintegrated"), offer.ratio))
    sampler, tried, calls = as_sampler(NETS, estimator.dims), list[str](), 0
    base = evidence.curves[given if best is None else best.name]
    for offer in offers:
        each, wanted = offer.estimator.evaluations_per_point, FEW_NETS
        if jumps and not tried and offer is not offers[-1]:  # leave as much for another one
            wanted = FEW_NETS if left >= 2 * _LEAST_CHECKED * each * FEW_NETS else FEW_NETS // 2
        n = affordable_count(Setup(offer.estimator, sampler), (left - calls) // wanted)
        if n is None or n < _LEAST_CHECKED:
            continue
        tried.append(offer.name)
        calls += n * wanted * each
        cost, at_budget = n * each / estimator.evaluations_per_point, budget // each
        made = Sets.of(offer.estimator, n, wanted, stream.child(len(tried)))
        # What never met where g is does not vary, and has another mean
        seen_sets = evidence.sets.estimates
        off = abs(float(made.estimates.mean() - seen_sets.mean())) * math.sqrt(len(seen_sets))
        if not np.ptp(made.estimates) > 0.0 and off > _OFF * float(seen_sets.std()):
            continue
        curve = made.curves()[NETS].towards(base.rate, _ALIKE)
        if n < _FEW_POINTS:  # which show no steep rate yet
            curve = replace(curve, rate=max(curve.rate, _STEEPEST))
        (ours, ours_se), (other, other_se) = curve.at(n), base.at(cost)
        # Few points carry neither its rate nor its gain far: the mean of both, half their difference unsure
        points_at_budget = budget // estimator.evaluations_per_point
        (value, error), at_best = curve.at(at_budget), base.at(points_at_budget)[0]
        kept = ours / other * at_best if other > 0.0 else 0.0
        error = math.hypot(error, 0.5 * math.log(value / kept)) if value > 0.0 < kept else error
        after = math.sqrt(value * kept)
        sure = math.exp(-CONFIDENCE_Z * math.hypot(ours_se, other_se))
        if ours < other * sure and after < at_best:
            change = f"{offer.change}, and sample with {NETS}"
            setup = (offer.estimator, NETS)
            found = _change(
                evidence.curves, given, points_at_budget, offer.name, change, (after, error), setup
            )
            return found, tried, calls
    return best, tried, calls
