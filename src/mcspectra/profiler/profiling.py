"""One call that measures the noise of an estimator, finds its causes and gives advice.

The number of evaluations of the function is at most the given budget.

Most of the budget goes to scrambled nets (`samples`).
Evaluations at scrambled nets give the variances of several samplers at once.
A fifth of the budget goes to lines that detect discontinuities and kinks (`probing`).
If nets do not give the variance of the given sampler, a quarter of the budget is spent on it.
`causes` finds the causes of the noise in the evaluations at nets and along lines.
With the rest of the budget, changes that remove the causes are measured.
One more sampler is also measured: a lattice, or antithetic pairs for smooth functions of one dim.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import Analysis, Need, Reduction, Subject, whole
from mcspectra.core.checks import Array, as_integer, in_unit_cube
from mcspectra.core.confidence import CONFIDENCE_Z, rounding_floor
from mcspectra.core.display import between, escape_html, shown
from mcspectra.core.errors import (
    CountError,
    DomainError,
    McspectraError,
    NoClosedForm,
    ParameterError,
)
from mcspectra.core.memory import memory_of
from mcspectra.core.results import coordinate, dataset, strict_json
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
    CAUSE_SETTINGS,
    Cause,
    Evidence,
    Replicates,
    as_slow_as_a_jump,
    causes_of,
    is_apart,
    shares_of,
)
from mcspectra.explain.probing import grain
from mcspectra.explain.samples import CURVE_SETTINGS, NETS, Curve, Sets, curve_of, scalar
from mcspectra.improve.answers import Answer, Candidate, CandidateResult, simultaneous_z
from mcspectra.improve.candidates import CANDIDATE_SETTINGS, LATTICE, Budget, candidates_of
from mcspectra.improve.improved import CHANGES, Evaluations, Periodized
from mcspectra.integrands import Calls, FunctionIntegrand, Integrand
from mcspectra.measure.chains import chain_error
from mcspectra.measure.setup import Setup, affordable_count
from mcspectra.samplers import Sampler, as_sampler

if TYPE_CHECKING:
    import xarray as xr

    from mcspectra.profiler.scene_profile import SceneProfile

__all__ = ["Profile", "ProfileSettings", "Profiling", "profile"]


@final
@dataclass(frozen=True)
class ProfileSettings:
    """Settings that divide the budget of a profile, and thresholds of its advice."""

    # Least budget, in evaluations. Twenty nets of four points take 80 evaluations.
    # The nets get only 40 % of the budget if the given sampler is also measured.
    least_budget: int = 256
    # Width in columns to which the text of a cause is wrapped, as in a usual terminal or page.
    width: int = 100
    # Number of points of each net to which a change of the estimator is fitted, such as a density.
    # The 20 nets together have 1280 points for fits.
    # The comments below refer to 12 profiles of 8192 evaluations: six functions, with two seeds.
    # With half or twice as many points for fits, the advice of 12 test profiles was the same.
    # However, the number of points changed the RMSE of one fitted estimator by a factor of 2.4.
    fitted_points: int = 64
    # Dependence between draws is reported as a cause if few of the draws are effective.
    # The number of effective draws, divided by all draws, must be below this limit at 95 %.
    # With 70 % effective draws, standard errors are 20 % larger than for independent draws.
    dependent: float = 0.7
    # Least number of points of each net with which a change of the estimator is measured.
    # Preintegration computes means of g along an axis, which removes a jump.
    # If 8 points were required, two of 12 test profiles could not afford to measure preintegration.
    least_checked: int = 4
    # Maximum number of counts n of points at which the variance of a sampler is measured.
    # Of B evaluations, about B/2, B/4, …, B/32 are spent on sets of five counts.
    # With three or eight counts, the results of 12 profiles were the same.
    counts: int = 5
    # Least number of sets from which a variance is estimated.
    # With three sets, the jackknife has two degrees of freedom.
    least_sets: int = 3
    # Standard error of a theoretical rate, which holds only for large numbers of points.
    # With 0.04 or 0.16 instead of 0.08, the RMSEs in 12 test profiles change by at most 14 %.
    # The median change of the RMSEs in 12 test profiles is 1 %.
    theory_error: float = 0.08
    # Standard error of a rate that is measured over few octaves if g jumps along an axis.
    # The variance is a sawtooth function of n, because the jump's place in its stratum varies.
    # With 0.25 or 1 instead of 0.5, the RMSEs in 12 test profiles change by at most 6 %.
    teeth_error: float = 0.5
    # The level of the sawtooth is its mean over this number of the largest counts n.
    # The standard deviation of the log variance about its level is `teeth_scatter`.
    # If a share p of the stratum is on one side of the jump, the variance is ∝ p(1 − p).
    # If p is uniform, the logarithm of p(1 − p) has the standard deviation √(4 − π²/3) = 0.84.
    teeth: int = 4
    teeth_scatter: float = 0.84
    # A changed estimator is first assumed to have the same rate as the given estimator.
    # This setting is the standard error of the rate that is assumed for the changed estimator.
    # With 0.2 or 0.8 instead of 0.4, the RMSEs in 12 test profiles change by at most 8 %.
    alike_error: float = 0.4
    # If all estimates of a changed estimator are equal, its points may have missed a peak of g.
    # The change is dropped if the equal estimates are far from the mean of the given estimator:
    # the distance must exceed this number of standard errors of the given estimator's mean.
    # A normal error exceeds 4 standard errors with probability 6e-5.
    off_sigmas: float = 4.0
    # Lattices are measured only if their largest count is at least `few_points`.
    # If nets have fewer points than `few_points`, the rate of a changed estimator is limited:
    # rates that are steeper than `steepest_rate` are replaced by `steepest_rate`.
    # Few points do not show whether a steep rate continues at larger numbers of points.
    # Without the limit, an extrapolation to the whole budget would exaggerate the gain of a change.
    # With `few_points` 8 or 32, or a steepest rate of −1.5 or −3, 12 profiles gave equal advice.
    # In 12 profiles, other values of the two settings changed one RMSE by a factor of up to 1.9.
    few_points: int = 16
    steepest_rate: float = -2.0
    # A change must lower the log variance by at least this number of standard errors.
    # The log variance is extrapolated to as many points as the whole budget allows.
    # A decrease of the variance is required only if g grows at the border or has a heavy tail.
    # The required decrease of the variance was tested in 112 profiles with 4096 evaluations each:
    # seven functions with growth or heavy tails, two samplers and eight seeds.
    # With a required decrease of 1 standard error, none of 88 advised changes raised the variance.
    # With a required decrease of 0.5 standard errors, one of 99 advised changes raised variances.
    # If no decrease of the variance was required, five of 109 advised changes raised the variance.
    tail_errors: float = 1.0
    # Number of sets of a lattice at each count.
    # Few sets are drawn, because few evaluations are left and rates require several counts.
    lattice_sets: int = 10
    # Standard deviation of the log variance of lattices about a line through all counts.
    # Lattices deviate much from the line, because each count has another generating vector.
    # For smooth functions, the standard deviation is 1.3 in 4 to 6 dims, and 0.6 in 2 and 3 dims.
    lattice_scatter: float = 1.3
    # Largest number of dims in which antithetic pairs in strata are measured.
    # In more dims, folded lattices are measured instead, because their rate is −4.
    # Antithetic pairs in strata have the rate −5 in 1-D and −3 in 2-D.
    paired_dims: int = 1
    # Number of sets, and of counts, with which lattices are measured if g is smooth and periodic.
    # Few sets and counts are used, because only large sets show the steep rate of lattices.
    steep_sets: int = 4
    steep_counts: int = 2
    # If g is smooth and periodic, the evaluations for lattices are multiplied by this factor.
    steep_weight: int = 2
    # A substitution that makes g periodic is tried if n^(1/d) is at least `resolving_points`.
    # With fewer points, folded lattices have less variance (`benchmarks periodized`).
    resolving_points: int = 10
    # Largest logarithm of a ratio. The exponential of a number above 709 overflows.
    most_log: float = 700.0
    # Number of points that are drawn from a density to test whether they lie in the unit cube.
    tested_points: int = 64


_SETTINGS = ProfileSettings()
_PAIRS, _FOLDED = "antithetic-jittered", f"{LATTICE} | mirror(mode='fold')"
# Causes that concern the sets of a sampler and not g
_OF_SETS = {"deterministic-set", "few-realizations", "correlated-replicates"}
# Causes of noise for which the profile tries lattices. Lattices are also tried if g is smooth
_GAINED = {
    "kink",
    "cusp",
    "high-frequency",
    "high-dimension",
    "interior-jump",
    "axis-parallel-jump",
}
_JUMPS = {"interior-jump", "axis-parallel-jump"}
# Exponents e of theoretical rates for some causes of noise.
# In theory, variances fall as n^(−1 − e/d) with strata, and as n^(−1 − e) with nets
_EXPONENTS = {"interior-jump": 1.0, "axis-parallel-jump": 1.0, "none": 2.0}


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
            ge=_SETTINGS.least_budget,
            le=2**30,
            description="Most evaluations of the integrand in total.",
            extra={"metavar": "B"},
        ),
    ] = 4096

    def need(self, subject: Subject) -> Need:
        """Check that the budget allows several nets, and that each technique has its own sets."""
        estimator = subject.estimator
        if not isinstance(estimator, AbstractEstimator):
            raise ParameterError("profile takes one estimator at a time.")
        try:
            estimator.check_independent()
        except NoClosedForm as error:
            raise ParameterError(f"profile needs techniques with their own sets: {error}") from None
        shares_of(estimator, subject.sampler, self.budget)
        memory = memory_of(self.budget, estimator.dims, sum(estimator.counts))
        return Need(cost=float(self.budget), memory=memory)

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[xr.Dataset]:
        """Run in one block, because later steps depend on earlier results."""
        return whole(lambda: _profiled(subject, self.budget, stream).dataset)


@final
@dataclass(frozen=True)
class Profile:
    """The results of a profile. Print `text` to show them.

    Attributes
    ----------
    integral, interval
        The mean of all nets (NaN if g has no integral), and its 95 % interval.
        The interval is infinite if the variance is infinite or depends on a few evaluations.
    calls, budget
        Number of evaluations of f, and the number that the user allowed.
    variance, rate, rate_ci
        Variance of an estimate of `budget` evaluations with the given sampler.
        `rate` is the exponent of n in the variance, and `rate_ci` is the 95 % interval of `rate`.
        If the given sampler could not be measured, nets give the variance and the rate.
    points
        Number of points of an estimate that takes `budget` evaluations.
    reference
        The sampler with which `best` is compared. Usually this is the given sampler.
        If the given sampler was not measured or has one fixed set, random points are the reference.
    answer
        The recommended set-up, its comparison with `reference`, and the causes of the noise.
    samplers
        For each sampler by name: its variance as a function of the number of points.
    function
        The function or estimator that the user gave.
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
    answer: Answer
    samplers: Mapping[str, Curve]
    points: int = 0
    function: Any = field(default=None, repr=False, compare=False)

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Causes of the noise, beginning with the most important."""
        return self.answer.causes

    @property
    def tried(self) -> tuple[str, ...]:
        """Names of the set-ups that were compared."""
        return self.answer.tried

    @property
    def not_tried(self) -> tuple[str, ...]:
        """Names of set-ups that were not compared, with reasons."""
        return self.answer.not_tried

    @property
    def text(self) -> str:
        """All results as text of several lines."""
        low, high = self.interval
        found = [
            # The answer includes the first cause. Remove the cause, because all causes follow below
            str(self.answer).replace(f" {self.causes[0].sentence}", "", 1),
            "",
            f"integral   {_shown(self.integral, low, high)}",
        ]
        found.append("causes")
        for cause in self.causes:
            line = f"{cause.name}: {cause.sentence}"
            found += textwrap.wrap(
                line, _SETTINGS.width, initial_indent="  ", subsequent_indent="    "
            )
        if not self.samplers:
            return "\n".join(found)
        found.append(f"calls      {self.calls} of {self.budget}")
        found.append(f"samplers   RMSE at {self.budget} evaluations, rate of the variance")
        rows = self._rows()
        width = max([20, *(len(name) for name, *_ in rows)])
        for name, rmse, rate in rows:
            found.append(f"  {name:<{width}} {rmse:>10}   {rate}")
        shown = {name for name, *_ in rows}
        found += [
            f"not known  {name}: the evaluations are too few for its rate"
            for name in self.samplers
            if name not in shown
        ]
        found += [f"not tried  {reason}" for reason in self.not_tried]
        return "\n".join(found)

    def _rows(self) -> list[tuple[str, str, str]]:
        # If the interval of an extrapolated RMSE begins at 0, only its upper end is reliable
        results = {result.name: result for result in self.answer.results}
        ends = {name: results[name].rmse_ci for name in self.samplers if name in results}
        limits = {name: high for name, (low, high) in ends.items() if low == 0.0 < high < math.inf}
        order = {
            name: limits.get(name, math.sqrt(curve.at(self.points)[0]))
            for name, curve in self.samplers.items()
        }
        random = self.samplers.get("random")
        largest = math.inf if random is None else self._rmse("random")
        rows = []
        for name in sorted(order, key=order.__getitem__):
            curve = self.samplers[name]
            low, high = curve.rate_ci
            known = curve.rate_se == 0.0
            rate = f"{curve.rate:.2f}" + (
                "" if known else f" ({between(f'{low:.2f}', f'{high:.2f}')})"
            )
            if math.isnan(curve.rate):
                rate = "no error seen" if curve.vanishes <= self.points else "none"
            if limits.get(name, 0.0) >= largest or self._is_open(name):
                continue  # random points have a smaller RMSE than this limit
            rmse = self._rmse(name)
            shown = "not known" if math.isnan(rmse) else f"{rmse:.3g}"
            shown = f"< {limits[name]:.2g}" if name in limits else shown
            rows.append((name, shown, rate.replace("-", "−")))
        return rows

    def _is_open(self, name: str) -> bool:
        """Return whether a sampler's result has no RMSE, and its curve does not give one either.

        The 95 % interval of the extrapolated curve reaches the RMSE of random points.
        """
        result = next((each for each in self.answer.results if each.name == name), None)
        random, curve = self.samplers.get("random"), self.samplers[name]
        if result is None or random is None or result.verdict == "given":
            return False
        value, error = curve.at(self.points)
        if not (math.isnan(result.rmse) and value > 0.0 and math.isfinite(curve.rate)):
            return False
        away = min(CONFIDENCE_Z * error, _SETTINGS.most_log)
        return value * math.exp(away) >= random.at(self.points)[0]

    def _rmse(self, name: str) -> float:
        """Return the RMSE at the budget, from a curve of variance. An unknown RMSE is NaN."""
        curve = self.samplers[name]
        if math.isinf(self.variance):
            return math.inf
        if self._is_open(name):
            return math.nan
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
            f"<p><b>{escape_html(str(self.answer))}</b></p><ul>{causes}</ul>"
            "<table><tr><th>sampler</th><th>RMSE at "
            f"{self.budget}</th><th>rate</th></tr>{rows}</table>"
        )

    @property
    def dataset(self) -> xr.Dataset:
        """Curves of variance on (sampler, n), NaN at unused counts. The answer is in attributes."""
        ns = sorted({int(n) for curve in self.samplers.values() for n in curve.counts})
        place = {n: k for k, n in enumerate(ns)}
        shape = (len(self.samplers), len(ns))
        variance, ends = np.full(shape, np.nan), np.full((*shape, 2), np.nan)
        for row, curve in enumerate(self.samplers.values()):
            at = [place[int(n)] for n in curve.counts]
            variance[row, at] = curve.variance
            ends[row, at] = variance_interval(curve.variance, np.maximum(curve.relative_se, 1e-9))
        curves = self.samplers.values()
        plain = self.answer.to_dict()
        return dataset(
            {
                "variance": (("sampler", "n"), variance),
                "variance_ci": (("sampler", "n", "bound"), ends),
                "rmse": (("sampler",), np.array([self._rmse(name) for name in self.samplers])),
                "rate": (("sampler",), np.array([curve.rate for curve in curves])),
                "rate_ci": (("sampler", "bound"), np.array([curve.rate_ci for curve in curves])),
                "integral": ((), np.float64(self.integral)),
                "integral_ci": (("bound",), np.array(self.interval)),
                "calls": ((), np.int64(self.calls)),
            },
            {
                "n": coordinate("n", ns, "number of points"),
                "sampler": list(self.samplers),
                "bound": ["low", "high"],
            },
            budget=self.budget,
            given=self.given,
            answer=str(self.answer),
            text=self.text,
            **{name: json.dumps(strict_json(plain[name])) for name in ("causes", "best")},
            not_tried="; ".join(self.not_tried) or None,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, texts and lists."""
        found = {
            name: getattr(self, name)
            for name in ("subject", "given", "integral", "calls", "budget", "variance", "rate")
        }
        found["interval"], found["rate_ci"] = list(self.interval), list(self.rate_ci)
        found["answer"] = self.answer.to_dict()
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
    target: float | None = None,
    rng: RngLike = 0,
    vectorized: bool = True,
    workers: int = 1,
    cache: str | os.PathLike[str] | None = None,
    on_error: str = "raise",
) -> Profile | SceneProfile:
    """Measure an estimator's noise, find its causes, and recommend a change.

    Parameters
    ----------
    f
        A vectorized function of points (…, d) to values (…), an integrand, an estimator, or a spec.
        Three functions (f, pdf, sample) on the unit cube are also allowed.
        Points are then drawn by sample(u) and weighted by 1/pdf.
        Draws of Markov chains or independent estimates are only analyzed, as in `chain_error`.
        A scene is a Mitsuba XML file or a scene's dictionary; see `profile_scene`.
        For scenes, `target` and `rng` are used; `profile_scene` has further parameters.
    sampler
        The sampler in use.
    dims
        Number of dims of a function or a spec.
        The default is the sampler's number of dims, unless the sampler is given as a spec.
    budget
        Maximum number of evaluations of f in total, at least 256.
        With 262,144 evaluations, errors of rates are about 0.05 instead of 0.1.
        If f is fast, 262,144 evaluations take less than a second.
    target
        For scenes only: relative error σ / mean that pixels should reach, by default 0.05.
    rng
        Seed (SPEC 7).
    vectorized, workers, cache
        Options for slow functions; see `mcspectra.integrands.Calls`.
        An interrupted profile continues from the cache.
    on_error
        For functions: ``"raise"`` raises an error if f fails or is not finite.
        ``"skip"`` counts points where f fails, and replaces their values by the mean of all others.
        Skipped points make the interval of the result wider, as in `mcspectra.integrate`.
        With ``"raise"``, f may still fail at the probes that are closest to the border.

    Returns
    -------
    Profile
        The results; ``print`` shows them.
        `Profile.to_dict` returns the results as plain numbers and texts.
        `Profile.dataset` contains the curves of variance.

    Raises
    ------
    ParameterError
        If f is not a function, or if the budget is too small for f.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> found = mcs.profile(lambda x: abs(x.sum(axis=-1) - 0.8), dims=2)
    >>> found.causes[0].name, found.answer.best.name
    ('kink', "rank1-lattice | shift | mirror(mode='fold')")
    """
    if _is_scene(f):
        from mcspectra.profiler.scene_profile import profile_scene

        return profile_scene(f, target=target, rng=rng)
    if target is not None:
        raise ParameterError(
            "target is for scenes; use mcspectra.plan for the points that reach an error."
        )
    weighted = isinstance(f, tuple) and len(f) == 3 and all(map(callable, f))
    if not (isinstance(f, AbstractEstimator | Integrand | str) or callable(f) or weighted):
        return _of_draws(f)
    limit = as_integer("budget", budget, least=_SETTINGS.least_budget, most=2**30)
    given, *density = f if weighted else (f,)
    calls = given.function if isinstance(given, FunctionIntegrand) else None
    if is_function(given):
        # Wrap a function in an object that counts its calls
        known = sampler.dims if dims is None and isinstance(sampler, Sampler) else dims
        calls = Calls(
            given,
            dims=function_dims(given, known),
            budget=limit,
            vectorized=vectorized,
            workers=workers,
            cache=cache,
            on_error=on_error,
        )
        given = FunctionIntegrand(function=_Filled.of(calls), dims=calls.dims)
    with calls if isinstance(calls, Calls) else contextlib.nullcontext():
        estimator = as_estimator(given, dims)
        if density:  # Faults of the density are later listed among the causes of noise
            pdf, sample = density
            own = FunctionDensity(dims=estimator.dims, pdf_function=pdf, sample_function=sample)
            u = as_sampler("random", own.primary_dims).draw(_SETTINGS.tested_points)[0]
            x = np.zeros(1)
            with contextlib.suppress(Exception):  # Exceptions are later listed among the causes
                x = np.asarray(sample(u), float)
            if np.isfinite(x).all() and not in_unit_cube(x):
                raise DomainError(
                    f"sample(u) leaves the unit cube, from {x.min():.4g} to {x.max():.4g}; map f "
                    "and pdf into it, or give the function f(sample(u)) / pdf(sample(u)) of u "
                    "alone."
                )
            estimator = Estimator(given, dims=dims)
            estimator.density = own
        subject = Subject(estimator, as_sampler(sampler, estimator.dims))
        Profiling(budget=limit).need(subject)
        found = _profiled(subject, limit, Stream.from_rng(rng))
        if isinstance(calls, Calls) and calls.skipped:
            found = _with_skipped(found, calls, given.function)
        found = replace(found, function=f)
    if isinstance(calls, Calls):
        calls.budget = sys.maxsize  # After the profile, f may be called without a limit
    return found


def _is_scene(subject: object) -> bool:
    """Return whether the subject of a profile is a scene: an XML file or a Mitsuba dictionary."""
    if isinstance(subject, Mapping):
        return subject.get("type") == "scene"
    return isinstance(subject, str | os.PathLike) and os.fspath(subject).lower().endswith(".xml")


@final
class _Filled:
    """A user's function. If the function fails, the mean of earlier values replaces its value."""

    def __init__(self, calls: Calls) -> None:
        self.calls, self.__name__ = calls, calls.name
        self.count, self.mean, self.least, self.most = 0, 0.0, math.inf, -math.inf

    @staticmethod
    def of(calls: Calls) -> Any:
        """Return a function that replaces NaN, or `calls` itself if failures of f raise errors."""
        return _Filled(calls) if calls.skips else calls

    def __call__(self, x: Array) -> Array:
        values = self.calls(x)
        failed = np.isnan(values)
        good = values[~failed]
        if good.size:
            self.mean = (self.count * self.mean + float(good.sum())) / (self.count + good.size)
            self.count += good.size
            self.least = min(self.least, float(good.min()))
            self.most = max(self.most, float(good.max()))
        return np.where(failed, self.mean, values)


def _with_skipped(found: Profile, calls: Calls, filled: _Filled) -> Profile:
    """Widen the interval of a profile, because values are missing at points where f failed.

    The missing values may lie anywhere between the least and the largest value of f.
    """
    share = calls.skipped / (calls.skipped + filled.count)
    low, high = found.interval
    if not filled.count:
        raise ParameterError("f failed at all points; give a function that has values.")
    ends = low - share * (filled.mean - filled.least), high + share * (filled.most - filled.mean)
    said = calls.skipped_in_words(filled.least, filled.most)
    told = replace(found.answer, not_tried=(*found.not_tried, said))
    return replace(found, interval=ends, answer=told)


def _of_draws(draws: Any) -> Profile:
    """Profile draws of Markov chains. Dependence between draws is reported as a cause."""
    try:
        found = chain_error(draws)
    except DomainError as error:  # The draws are numbers of a right shape, but cannot be used
        raise DomainError(f"The {error}") from None
    except McspectraError as error:
        raise ParameterError(
            f"{shown(draws)} cannot be profiled; give a function, an integrand, an estimator, a "
            f"spec, or draws as measure.chain_error takes them: {error}"
        ) from None
    if found["mean"].ndim:
        raise ParameterError("The draws are of several quantities; profile one at a time.")
    names = found["cause"].item().split(", ")
    said = found["evidence"].item() or "the draws show no problem with their error"
    said = [each.removeprefix(f"{k}: ") for k, each in zip(names, said.split("; "), strict=True)]
    name, (sentence, *others) = names[0], [f"{each[0].upper()}{each[1:]}." for each in said]
    count, effective = found.attrs["chains"] * found.attrs["draws"], float(found["ess"])
    evidence = {"draws": float(count), "effective": effective}
    if name == "burn-in":
        evidence["burn_in"] = float(found["burn_in"])
    if name == "none" and float(found["ess_ci"][1]) < _SETTINGS.dependent * count:
        name = "correlated-replicates"
        sentence = f"The {count} draws depend on each other and count as {effective:.0f}."
    step = grain(draws) if isinstance(draws, np.ndarray) else 0.0
    spread = float(found["mcse"]) * math.sqrt(effective)
    if name == "none" and step > CAUSE_SETTINGS.coarse * spread:
        name, evidence = "float-drift", {"step": step, "spread": spread}
        sentence = f"Draws are rounded to steps of {step:.2g}; their spread is {spread:.2g}."
    low, high = found["mean_ci"].values.tolist()
    mean, mcse = float(found["mean"]), float(found["mcse"])
    causes = (Cause(name, sentence, evidence), *map(Cause, names[1:], others))
    draw = CandidateResult(
        "draws", "take the draws", ("draws", "draws"), count, mcse, (math.nan, math.nan)
    )
    told = f"The mean of the draws is {_shown(mean, low, high)}."
    return Profile(
        subject="draws",
        given="draws",
        integral=mean,
        interval=(low, high),
        calls=0,
        budget=0,
        variance=mcse**2,
        rate=-1.0,
        rate_ci=(-1.0, -1.0),
        answer=Answer.of(0, [draw], causes=causes, instead=told, why=_why(causes)),
        samplers={},
    )


def _why(causes: Sequence[Cause]) -> str:
    """Return sentences about the first cause of noise, or "" if there is no cause."""
    first = causes[0]
    return "" if first.name == "none" else f"Cause: {first.name}. {first.sentence}"


def _shape(causes: Sequence[Cause]) -> str:
    """Return the first cause that concerns g and not the sets of the given sampler."""
    return next((cause.name for cause in causes if cause.name not in _OF_SETS), "none")


def _profiled(subject: Subject, budget: int, stream: Stream) -> Profile:
    estimator, given = subject.estimator, subject.sampler
    evidence = Evidence.of(estimator, given, budget, stream)
    sets, calls = evidence.sets, evidence.calls
    each = estimator.cost
    points = budget // each

    # Measure the given sampler if nets do not give its variance
    curves, not_tried = dict(evidence.curves), list[str]()
    if evidence.failed:
        not_tried.append(
            f"probes closest to the border, where hardly any sample falls: {evidence.failed}"
        )
    evidence = replace(evidence, curves=curves)
    if is_apart(estimator, given):
        given_stream = stream.child(99)
        try:
            curve, replicates, cost = _measured(
                estimator, given, int(CAUSE_SETTINGS.given_share * budget), given_stream
            )
            curves[given.spec] = curve
            evidence = replace(evidence, replicates=replicates)
            calls += cost
        except McspectraError as error:
            not_tried.append(f"{given.spec}: {error}")
            source, count = (
                estimator.randomized(given),
                int(min(CAUSE_SETTINGS.nets, given.most_realizations)),
            )
            if count > 1:
                n = given.nearest_count(sets.points[0].shape[1] // sets.counts[0])
                drawn = estimator.draw(source, n, given_stream, 0, count)
                evidence = replace(evidence, replicates=_replicates(drawn, np.empty(0)))

    causes = causes_of(evidence)
    offers = _offers(evidence, causes, budget, stream.child(98))
    # Measure other set-ups that may have less variance than nets. They are called rivals.
    # Each of the other set-ups gets as many of the remaining evaluations as a changed estimator.
    # If g jumps, evaluations for an estimator without the jump are reserved first,
    # and the other set-ups share all remaining evaluations
    rivals, left = _rivals(evidence, causes, points), budget - calls
    rivals.pop(given.spec, None)
    jumps, nets = _shape(causes) in _JUMPS, CAUSE_SETTINGS.nets
    if jumps:
        paid = ((offer, *_paid(offer, left, last=offer is offers[-1])) for offer in offers)
        left -= next((n * sets * offer.setup.cost for offer, n, sets in paid if n), 0)
    elif any(_SETTINGS.least_checked * o.setup.cost * nets <= left // 2 for o in offers):
        left -= left // (1 + max(len(rivals), 1))
    measured, reasons, cost = _measured_rivals(rivals, left, causes, stream)
    calls += cost
    not_tried += reasons
    curves |= measured
    smooth = _is_smooth(causes) and not as_slow_as_a_jump(curves[NETS], estimator.dims)
    curves |= {
        name: _by_theory(name, curve, causes, estimator.dims, points, smooth, curves["random"])
        for name, curve in curves.items()
        if name not in rivals or rivals[name].kind == "sampler"
    }
    # Compare with random points if the given sampler is fixed or was not measured
    fixed = any(cause.name in {"deterministic-set", "correlated-replicates"} for cause in causes)
    if any(cause.name == "deterministic-set" for cause in causes):
        # All estimates with a fixed set are equal, so they do not show a variance
        curves.pop(given.spec, None)
    reference = "random" if fixed or given.spec not in curves else given.spec
    usable = {name: c for name, c in curves.items() if name == reference or name != given.spec}
    found, changed = list[_FoundSampler](), list[str]()
    # Recommend changes only if the integral of g exists
    if all(c.name != "infinite-variance" or c.kinds for c in causes):
        # Find the sampler with least variance, and a change of the estimator that removes a cause
        if len(usable[reference].counts) > 0:  # A curve without points means a variance of zero
            found = _samplers(Setup(estimator, given), usable, reference, points, rivals)
        trusted = [
            each for name, each in usable.items() if name not in rivals or _is_known(each, points)
        ]
        base = min(trusted, key=lambda each: _bound(each, points))
        made, changed, cost = _improved(
            evidence, causes, offers, base, budget, budget - calls, stream.child(98)
        )
        calls += cost
        sure = [each for each in made if each.sure]
        found = sure + found + [each for each in made if not each.sure]
    curve = curves.get(given.spec, curves[NETS])
    # The interval of the integral can be estimated unless a few large values dominate the mean.
    # If g grows at the border, the interval of the integral can also be estimated
    names = {cause.name for cause in causes}
    infinite = "infinite-variance" in names
    no_integral = any(
        cause.name == "infinite-variance"
        and cause.evidence.get("exponent", 0.0) >= CAUSE_SETTINGS.no_integral
        for cause in causes
    )
    resolved = bool(Moments.of(sets.pooled, tails=True).resolved)
    known = not infinite and "wrong-pdf" not in names
    known &= resolved or "border-growth" in names
    # Explain why all values are equal
    if len(sets.values) == 1 and not np.ptp(sets.pooled) > 0.0:
        value, count = float(sets.pooled[0]), sets.pooled.size
        exact = estimator.primary_integrand(0)._integral()
        mean = math.nan if exact is None else float(np.mean(exact))
        if exact is None:
            cause = Cause(
                "few-realizations",
                f"The integrand is {value:.6g} at all {count} points: either it is constant, or it "
                f"differs only in a region smaller than about {3 / count:.1g} of the volume, which "
                "no point hit.",
                {"points": float(count)},
            )
        elif np.isclose(mean, value, rtol=1e-12, atol=0.0):
            cause = Cause("none", f"The integrand is {value:.6g} everywhere: there is no noise.")
        else:
            cause = Cause(
                "heavy-tail",
                f"The integrand is {value:.6g} at all {count} points, but its integral is "
                f"{mean:.6g}: no point hit the region that causes the difference. Give a density "
                "that concentrates there, or far more points.",
                {"integral": mean},
            )
        causes, found, known = [cause], [], known and cause.name == "none"
    if infinite:  # No sampler makes the variance finite
        found = [each for each in found if each.candidate.setup.estimator is not estimator]
    results = _results(
        Setup(
            estimator, as_sampler(reference, estimator.dims) if reference != given.spec else given
        ),
        usable[reference], points, found, len(usable) - 1 + len(changed),
        infinite=infinite, known=known, noise=min(curve.noise for curve in usable.values()),
    )  # fmt: skip
    variance = curve.at(points)[0]
    # Write the sentences that replace the advice or follow it
    changes = any(result.verdict == "better" for result in results)
    instead, why = "", _why(causes)
    if causes[0].name == "wrong-pdf":
        instead = "Fix the density first."
    elif infinite and not changes:
        instead = "No tested change helps."
    elif not changes and reference != given.spec:
        instead = f"No tested sampler or change is better than {reference}."
    if not changes and causes[0].evidence.get("resolved_by", math.inf) <= points:
        why += " A single set with enough points to resolve the oscillation was not tested."
    names_tried = [name for name in usable if name != reference] + changed
    answer = Answer.of(
        budget, results, causes=tuple(causes), tried=tuple(names_tried), not_tried=tuple(not_tried),
        instead=instead, why=why,
    )  # fmt: skip
    return Profile(
        subject=estimator.spec,
        given=given.spec,
        integral=math.nan if no_integral else float(sets.estimates.mean()),
        interval=sets.interval if known else (-math.inf, math.inf),
        calls=calls,
        budget=budget,
        variance=math.inf if infinite else variance if variance or known else math.nan,
        rate=curve.rate,
        rate_ci=curve.rate_ci,
        answer=answer,
        samplers=curves,
        points=points,
    )


def _shown(value: float, low: float, high: float) -> str:
    """Return a number and its interval as text, with enough digits to distinguish the ends."""
    if math.isnan(value):
        return "does not exist"
    digits = 6
    if math.isfinite(high - low) and high > low:
        digits = max(digits, math.ceil(math.log10(max(abs(low), abs(high)) / (high - low))) + 2)
    return f"{value:.{min(digits + 2, 17)}g} (95 %: {low:.{digits}g} to {high:.{digits}g})"


def _by_theory(
    name: str,
    curve: Curve,
    causes: Sequence[Cause],
    dims: int,
    points: int,
    smooth: bool,
    random: Curve,
) -> Curve:
    """Return the curve with a weighted mean of its measured and its theoretical rate.

    `random` is the curve of random points, which shows whether the measured sets resolve g.
    The curve is extrapolated to at most `points` points.
    Folded lattices get the rate for smooth g only if `smooth` is true.
    """
    names = {cause.name: cause for cause in causes}
    if "infinite-variance" in names:
        return replace(curve, rate=math.nan, rate_se=math.nan)
    # If g grows without bound, limit the rate by theory, because few sets reach the pole
    for cause in causes:
        if cause.name in {"border-growth", "heavy-tail"} and "exponent" in cause.evidence:
            return replace(curve, rate=max(curve.rate, -2.0 * (1.0 - cause.evidence["exponent"])))
        # If g grows more slowly than any power, its variance in the stratum at the border
        # hardly falls with n. This stratum alone then gives the rate −2
        if cause.name == "border-growth":
            curve = replace(curve, rate=max(curve.rate, -2.0))
    # Small sets do not resolve high frequencies of g, so their rate does not hold for larger sets
    waves = names.get("high-frequency")
    resolved_by = math.inf if waves is None else waves.evidence["resolved_by"]
    if name != "random" and max(curve.counts, default=math.inf) < resolved_by <= points:
        vanishes = math.inf if name in {LATTICE, _FOLDED, _PAIRS} else curve.vanishes
        return replace(curve, rate=math.nan, rate_se=math.nan, vanishes=vanishes)
    first = _shape(causes)
    if name in {LATTICE, _FOLDED} and math.isfinite(curve.rate):
        # In theory, the variance for smooth functions is n^−4 (log n)^(2d − 2).
        # Compute the rate of n^−4 (log n)^p, where p is two thirds of 2d − 2.
        # Limit the rate, because in many dims few points may show a rate that is too steep
        third = (dims - 1) / (3.0 * math.log(max(curve.counts[-1], 2.0)))
        limit = min(-4.0 + 4.0 * third, -1.0)
        curve = replace(curve, rate=max(curve.rate, limit))
        error = math.hypot(_SETTINGS.theory_error, 2.0 * third)
        return curve.towards(limit, error) if name == _FOLDED and smooth else curve
    if name not in {NETS, "jittered"} or first not in _EXPONENTS or not math.isfinite(curve.rate):
        return curve
    # A jump cuts n^(1 − 1/d) of n strata.
    # If the jump is along an axis or g is smooth, the rate of nets is the same as in 1-D,
    # but the variance has up to d − 1 additional factors log n.
    # Assume that there are 2 (d − 1)/3 factors log n, with the standard error (d − 1)/3
    strata = name == "jittered" or first == "interior-jump"
    third = 0.0 if strata else (dims - 1) / (3.0 * math.log(curve.counts[-1]))
    rate = -1.0 - _EXPONENTS[first] / (dims if strata else 1) + 2.0 * third
    if first == "axis-parallel-jump":
        n = float(curve.counts[-1])
        if random.at(n)[0] < CAUSE_SETTINGS.resolved * curve.at(n)[0]:
            # The sets do not resolve g, for example the squares of a checkerboard.
            # It is not known at which count the rate of random points ends: the 95 % interval of
            # the rate reaches from this rate to the theoretical one
            return replace(
                curve, rate=0.5 * (rate - 1.0), rate_se=-0.5 * (rate + 1.0) / CONFIDENCE_Z
            )
        # The log variance is a sawtooth about a line. Its level is the mean over the last counts
        error = math.hypot(curve.rate_se, _SETTINGS.teeth_error)
        teeth = np.log(curve.variance) - curve.rate * np.log(curve.counts / curve.counts[-1])
        level = float(np.mean(teeth[-_SETTINGS.teeth :]) - teeth[-1])
        curve = replace(curve, rate_se=error, level=level, scatter=_SETTINGS.teeth_scatter)
    known = curve.towards(rate, math.hypot(_SETTINGS.theory_error, third))
    if known is curve and first == "interior-jump" and curve.rate < rate:
        # Few points do not resolve the jump. Let the rate tend to its limit at larger counts
        return replace(curve, bend=0.5 * (rate - curve.rate))
    return known


def _is_smooth(causes: Sequence[Cause]) -> bool:
    """Return whether g has no discontinuity or kink inside the cube, according to the causes."""
    return _shape(causes) in {"none", "border-jump"}


def _growth(causes: Sequence[Cause]) -> float:
    """Return the exponent a if g grows as t^−a toward the border, else 0."""
    grows = (c for c in causes if c.name in {"border-growth", "infinite-variance"})
    return max((cause.evidence.get("exponent", 0.0) for cause in grows), default=0.0)


def _rivals(evidence: Evidence, causes: Sequence[Cause], points: int) -> dict[str, Candidate]:
    """Return set-ups that may have less variance than nets for this g, by name.

    If g agrees on opposite faces of the cube, or if points are folded [Hickernell2002]_,
    the rate of lattices follows from the decay of the Fourier coefficients of g.
    Lattices may also have less variance than nets if g has kinks, cusps or waves.
    For smooth g, antithetic pairs about the centers of strata have the rate −1 − 4/d.
    For smooth g, cubic stratification of second order also has the rate −1 − 4/d.
    If g is smooth inside the cube, a substitution makes it periodic [Sidi2006]_.
    """
    estimator, smooth = evidence.estimator, _is_smooth(causes)
    dims, found = estimator.dims, dict[str, Candidate]()
    # Make g periodic by a substitution if g is smooth inside, and if there are enough points
    grows = any(cause.name in {"border-growth", "infinite-variance"} for cause in causes)
    inside = smooth or _shape(causes) in {"border-growth", "infinite-variance"}
    one = len(estimator.counts) == 1 and not estimator.channels
    if inside and one and points >= _SETTINGS.resolving_points**dims:
        nets, sets = Setup(estimator, as_sampler(NETS, dims)), evidence.sets
        seen = Evaluations.of(sets.points[0].reshape(-1, dims), sets.values[0].ravel())
        search = Budget(points, CAUSE_SETTINGS.nets, Stream.from_rng(0), seen=seen, grows=grows)
        for made in candidates_of(nets, ["periodized"], search):
            if isinstance(made, Candidate) and made.finite_below > _growth(causes):
                found[made.name] = made
    # Choose samplers that may have less variance than nets for this g
    names = list[str]()
    if not grows and (smooth or _shape(causes) in _GAINED):
        if evidence.is_periodic:
            names = [LATTICE]
        elif dims > _SETTINGS.paired_dims:
            names = [_FOLDED]
        elif smooth and not found:
            names = [_PAIRS]
    samplers = {
        name: Candidate("sampler", name, f"use {name}", Setup(estimator, as_sampler(name, dims)))
        for name in names
    }
    return samplers | found


def _measured(
    estimator: AbstractEstimator,
    sampler: Sampler,
    evaluations: int,
    stream: Stream,
    *,
    lattice: bool = False,
    few: bool = False,
) -> tuple[Curve, Replicates, int]:
    """Measure the variance of a sampler at several n with at most `evaluations` evaluations.

    Also return the drawn sets as replicates, and the number of evaluations that were used.

    If `few` is true, fewer sets are drawn at fewer counts n, so that each set has more points.
    """
    most_sets, steps = _sets_and_steps(lattice=lattice, few=few)
    each, least = estimator.cost, _SETTINGS.least_sets
    sets = drawn = int(min(most_sets, sampler.most_realizations))
    if sets < least:
        raise CountError(f"{sampler.spec} has {sets} sets; give at least {least}.")
    setup, counts = Setup(estimator, sampler), list[int]()
    while sets > least and affordable_count(setup, evaluations // (2 * sets)) is None:
        sets -= 1
    first = evaluations / _in_all(steps) / sets
    for k in range(steps):
        n = affordable_count(setup, int(first / 2**k))
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
    if lattice and estimator.dims > 1:
        scatter = _SETTINGS.lattice_scatter
        curve = curve_of(counts, found, replace(CURVE_SETTINGS, floor=scatter))
        curve = replace(curve, scatter=scatter)
    else:
        curve = curve_of(counts, found)
    return curve, _replicates(points, found[-1]), cost


def _sets_and_steps(*, lattice: bool, few: bool) -> tuple[int, int]:
    """Return how many sets of a sampler are drawn at each count, and how many counts there are."""
    if few:
        return _SETTINGS.steep_sets, _SETTINGS.steep_counts
    return _SETTINGS.lattice_sets if lattice else CAUSE_SETTINGS.nets, _SETTINGS.counts


def _in_all(steps: int) -> float:
    """Return the sum of `steps` counts of points, each half as large as the one before it."""
    return float(2.0 - 2.0 ** (1 - steps))


def _least(*, few: bool) -> float:
    """Return the points of all sets of a lattice if the largest count is `few_points`."""
    sets, steps = _sets_and_steps(lattice=True, few=few)
    return sets * _SETTINGS.few_points * _in_all(steps)


def _replicates(points: Sequence[Array], estimates: Array) -> Replicates:
    """Compute means over each of R point sets (R, n, d), and return them with the estimates."""
    x = np.concatenate([np.asarray(p) for p in points], axis=1)
    angle = 2.0 * math.pi * x
    waves = [each.mean(axis=1) for each in (x - 0.5, np.cos(angle), np.sin(angle))]
    different = len(np.unique(x.reshape(len(x), -1), axis=0))
    return Replicates(estimates, np.concatenate(waves, axis=1), different)


@final
@dataclass(frozen=True)
class _FoundSampler:
    """A candidate with the number n of points that the budget allows, and its variance at n.

    `variance` contains the variance and the standard error of its logarithm.
    """

    candidate: Candidate
    n: int
    variance: tuple[float, float]
    rate: float
    rate_ci: tuple[float, float]
    steepens: bool = False  # Whether the rate may be steeper at larger counts, without limit
    sure: bool = False  # Whether the sampler was significantly better in the measurement


def _is_known(curve: Curve, count: int) -> bool:
    """Return whether a measured curve of variances gives the variance at `count` points."""
    return math.isfinite(curve.rate) or count >= curve.vanishes


def _is_below(curve: Curve, other: Curve) -> bool:
    """Return whether a variance is significantly less than another at the last measured count."""
    if not (len(curve.counts) and len(other.counts)):
        return False
    n = float(curve.counts[-1])
    (ours, ours_se), (theirs, theirs_se) = curve.at(n), other.at(n)
    error = math.hypot(ours_se, curve.scatter, theirs_se)
    return ours < theirs * math.exp(-CONFIDENCE_Z * error)


def _bound(curve: Curve, points: int) -> float:
    """Return the variance at `points` points, increased by one standard error of its logarithm."""
    value, error = curve.at(points)
    return value * math.exp(error)


def _measured_rivals(
    rivals: Mapping[str, Candidate], left: int, causes: Sequence[Cause], stream: Stream
) -> tuple[dict[str, Curve], list[str], int]:
    """Measure rival set-ups with at most `left` evaluations.

    A set-up is an estimator with a sampler. The first returned value is a curve for each set-up.
    The second value lists reasons why set-ups were not measured.
    The third value is the number of evaluations that were used.
    """
    curves, not_tried, calls = dict[str, Curve](), list[str](), 0
    jumps = _shape(causes) in _JUMPS
    # If g is periodic without kinks, lattices have steep rates, also after a substitution
    steep = {name for name, each in rivals.items() if each.kind == "periodized"}
    steep |= {LATTICE} if _is_smooth(causes) else set()
    weights = {name: _SETTINGS.steep_weight if name in steep else 1 for name in rivals}
    for place, (name, rival) in enumerate(rivals.items()):
        setup, lattice = rival.setup, name != _PAIRS
        share = (left - calls) * weights[name] // sum(list(weights.values())[place:])
        # If the evaluations are few, fewer sets have enough points
        few = name in steep or (lattice and share < _least(few=False) * setup.cost)
        if lattice and share < _least(few=few) * setup.cost:
            not_tried.append(f"{name}: only {share} evaluations remain for it")
            continue
        own = stream.child(97 - place)
        # Skip samplers that do not support this number of dims or points
        with contextlib.suppress(McspectraError):
            curve, _, cost = _measured(
                setup.estimator, setup.sampler, share, own, lattice=lattice, few=few
            )
            calls += cost
            if name in steep:
                # Few counts hardly show the rate. Assume a 95 % interval of the rate that reaches
                # from a quarter of the theoretical rate to the whole theoretical rate
                f = getattr(setup.estimator, "integrand", None)
                order = f.order if isinstance(f, Periodized) else CANDIDATE_SETTINGS.order
                limit = -2.0 * order * (1.0 - _growth(causes))
                error = -0.1875 * limit
                curve = curve.towards(0.625 * limit, error)
                rate, rate_se = max(curve.rate, limit), min(curve.rate_se, error)
                curve = replace(curve, rate=rate, rate_se=rate_se)
            # If g jumps, all estimates of small sets may be equal, although larger sets differ
            if not (jumps and math.isfinite(curve.vanishes)):
                curves[name] = curve
    return curves, not_tried, calls


def _samplers(
    given: Setup,
    curves: Mapping[str, Curve],
    reference: str,
    points: int,
    rivals: Mapping[str, Candidate],
) -> list[_FoundSampler]:
    """Return the set-ups that may have less variance than the reference, the best first.

    The set-ups in `rivals` are always included, because their rate may be steeper at larger n.
    """
    each = given.cost
    bounds = {name: _bound(curve, points) for name, curve in curves.items()}
    found = []
    for name in sorted(bounds, key=bounds.__getitem__):
        worse = bounds[name] >= bounds[reference]
        if name == reference or (worse and name not in rivals):
            continue
        if name in rivals:
            candidate = rivals[name]
        else:
            source = as_sampler(name, given.estimator.dims)
            candidate = Candidate("sampler", name, f"use {name}", replace(given, sampler=source))
        count, curve = points, curves[name]
        if candidate.setup.sampler.nearest_count(points) != points:
            count = affordable_count(candidate.setup, points * each) or points
            candidate = replace(candidate, change=f"{candidate.change} with n = {count}")
        variance, beyond = curve.at(count), count > curve.counts[-1:].sum()
        # Variances for smooth functions reach their rate only with large sets.
        # For analytic functions the variance falls faster than any power of n
        steepens = name in rivals and bool(beyond)
        known = _is_known(curve, count)
        sure = steepens and known and _is_below(curve, curves[NETS])
        if steepens and not known:
            variance = math.nan, math.nan
        found.append(
            _FoundSampler(candidate, count, variance, curve.rate, curve.rate_ci, steepens, sure)
        )
    return found


def _results(
    given: Setup,
    curve: Curve,
    points: int,
    found: Sequence[_FoundSampler],
    comparisons: int,
    *,
    infinite: bool,
    known: bool,
    noise: float,
) -> list[CandidateResult]:
    """Return the given set-up, followed by candidates with simultaneous 95 % intervals of gains.

    If variances are not known, gains are NaN: only which variance is lower was measured.
    Rounding of an estimate causes a variance of about `noise`. Smaller variances are not stated.
    """
    count = affordable_count(given, points * given.cost) or points
    at_budget, z = curve.at(count), simultaneous_z(comparisons)
    cost, slope = given.cost, curve.rate if math.isfinite(curve.rate) else -1.0

    def needed(gain: float) -> float:
        """Return how many evaluations the given set-up needs to divide its variance by `gain`."""
        if not (slope < 0.0 and math.isfinite(gain)):
            return math.inf
        if gain <= 0.0:
            return 0.0
        return cost * points * math.exp(min(-math.log(gain) / slope, _SETTINGS.most_log))

    def with_ends(variance: tuple[float, float]) -> tuple[float, tuple[float, float]]:
        """Return the RMSE and its 95 % interval, from a variance and its relative error."""
        rmse = math.sqrt(variance[0])
        away = math.exp(min(0.5 * CONFIDENCE_Z * variance[1], _SETTINGS.most_log))
        return rmse, (rmse / away, rmse * away)

    rmse, ends = (math.inf, (math.inf, math.inf)) if infinite else with_ends(at_budget)
    if not known and rmse == 0.0:  # No point hit a place where g varies, if there is one
        rmse, ends = math.nan, (0.0, math.inf)
    name = given.sampler.spec
    results = [
        CandidateResult(
            name,
            f"keep {name}",
            (given.estimator.spec, name),
            count,
            rmse,
            ends,
            rate=curve.rate,
            rate_ci=curve.rate_ci,
            setup=given,
        )
    ]
    for each in found:
        (value, error), candidate = each.variance, each.candidate
        if rounded := 0.0 < value < noise:
            value, error = noise, max(error, math.log(noise / value))
        rmse, ends = with_ends((value, error))
        if rounded or value == 0.0:
            # Estimates are rounded: `noise` is the square of one ulp, and errors reach some ulps
            size = math.sqrt(noise) / np.finfo(float).eps
            ends = (0.0, max(ends[1], math.sqrt(float(rounding_floor(np.array(size))))))
        gain = math.inf if infinite or not value > 0.0 else at_budget[0] / value
        half = math.exp(min(z * math.hypot(error, at_budget[1]), _SETTINGS.most_log))
        gain_ci = (gain / half, gain * half)
        if each.steepens:
            ends, gain_ci = (0.0, ends[1]), (gain_ci[0], math.inf)
        better = gain_ci[0] > 1.0 and not math.isnan(value)
        needs, needs_ci = needed(gain), (needed(gain_ci[0]), needed(gain_ci[1]))
        if (not infinite and not known) or (each.sure and not better) or math.isnan(value):
            nowhere = (math.nan, math.nan)
            better |= each.sure
            rmse, ends, gain, gain_ci, needs, needs_ci = (
                math.nan,
                nowhere,
                math.nan,
                nowhere,
                math.nan,
                nowhere,
            )
        results.append(
            CandidateResult(
                candidate.name,
                candidate.change,
                (candidate.setup.estimator.spec, candidate.setup.sampler.spec),
                n=each.n,
                rmse=rmse,
                rmse_ci=ends,
                gain=gain,
                gain_ci=gain_ci,
                rate=each.rate,
                rate_ci=each.rate_ci,
                needed=needs,
                needed_ci=needs_ci,
                verdict="better" if better else "undecided",
                setup=candidate.setup,
            )
        )
    return results


def _offers(
    evidence: Evidence, causes: Sequence[Cause], budget: int, stream: Stream
) -> list[Candidate]:
    """Return changes of the estimator that remove causes of noise.

    The changes are fitted to values of g at the points of nets.
    """
    estimator = evidence.estimator
    kinds: list[Any] = list(
        dict.fromkeys(k for cause in causes for k in cause.kinds if k in CHANGES)
    )
    if _shape(causes) == "none" and not evidence.is_periodic:
        kinds.append("regression")
    if not kinds or len(estimator.counts) > 1 or estimator.channels:
        return []
    points, values = (
        np.concatenate(list(each[0][:, : _SETTINGS.fitted_points]))
        for each in (evidence.sets.points, evidence.sets.values)
    )
    sampler = as_sampler(NETS, estimator.dims)
    nets, seen = Setup(estimator, sampler), Evaluations.of(points, values)
    search = Budget(budget, CAUSE_SETTINGS.nets, stream, seen=seen)
    offers = [each for each in candidates_of(nets, kinds, search) if isinstance(each, Candidate)]
    # If the variance is infinite, keep only densities that make it finite
    for cause in causes:
        if cause.name == "infinite-variance":
            index = cause.evidence.get("exponent", cause.evidence.get("tail_index", 0.0))
            offers = [offer for offer in offers if offer.finite_below > index]
    # Try the removal of a jump first, because it gains more with nets than with random points.
    # If g jumps on planes normal to an axis, means of g along this axis remove the jump
    shape = _shape(causes)
    first = {"interior-jump": "preintegrated", "axis-parallel-jump": "preintegrated along axis"}
    removes = first.get(shape, "-")
    offers.sort(key=lambda offer: (not offer.name.startswith(removes), offer.ratio))
    return offers


def _paid(offer: Candidate, left: int, *, last: bool) -> tuple[int, int]:
    """Return how many points and nets can be used if `left` evaluations are left.

    The changed estimator, from which a jump was removed, is measured with these points and nets.
    The number of nets is halved if all nets would need too many evaluations.
    The number of nets is also halved if too few evaluations would be left for another change.
    The number of points is 0 if `left` evaluations do not suffice to measure the changed estimator.
    """
    nets, least = CAUSE_SETTINGS.nets, _SETTINGS.least_checked
    changes = 1 if last else 2
    nets = nets if left >= changes * least * offer.setup.cost * nets else nets // 2
    n = affordable_count(offer.setup, left // nets) or 0
    return (n, nets) if n >= least else (0, nets)


def _improved(
    evidence: Evidence,
    causes: Sequence[Cause],
    offers: Sequence[Candidate],
    base: Curve,
    budget: int,
    left: int,
    stream: Stream,
) -> tuple[list[_FoundSampler], list[str], int]:
    """Measure changes of the estimator. Return results, names of changes, and evaluations.

    A change is measured with nets, whose size depends on the rest of the budget.
    The search ends with the first change that is significantly better.
    A change is compared with `base`, the curve of the best sampler, at equal evaluations.
    The variance of the changed estimator is extrapolated from small nets to the whole budget.
    """
    estimator, jumps = evidence.estimator, _shape(causes) in _JUMPS
    found, tried, calls, least = list[_FoundSampler](), list[str](), 0, _SETTINGS.least_checked
    grows = any(cause.name in {"border-growth", "heavy-tail"} for cause in causes)
    for offer in offers:
        each, wanted = offer.setup.cost, CAUSE_SETTINGS.nets
        if jumps and not tried:
            n, wanted = _paid(offer, left, last=offer is offers[-1])
        else:
            n = affordable_count(offer.setup, (left - calls) // wanted) or 0
        if n < least:
            continue
        tried.append(offer.name)
        calls += n * wanted * each
        cost = n * each / estimator.evaluations_per_point
        at_budget = affordable_count(offer.setup, budget) or n
        made = Sets.of(offer.setup.estimator, n, wanted, stream.child(len(tried)))
        # If all estimates of the changed estimator are equal but wrong, drop the change:
        # the points of all its nets have missed a peak of g
        seen_sets = evidence.sets.estimates
        off = abs(float(made.estimates.mean() - seen_sets.mean())) * math.sqrt(len(seen_sets))
        if not np.ptp(made.estimates) > 0.0 and off > _SETTINGS.off_sigmas * float(seen_sets.std()):
            continue
        curve = made.curves()[NETS].towards(base.rate, _SETTINGS.alike_error)
        # Without its jump, g may be smooth and have a steep rate that a few points do not show
        smooths = jumps and offer.kind == "preintegrated" and n < at_budget
        if n < _SETTINGS.few_points:
            smooths |= curve.rate < _SETTINGS.steepest_rate
            curve = replace(curve, rate=max(curve.rate, _SETTINGS.steepest_rate))
        # Only edges along an axis can coincide with borders of strata
        if _shape(causes) == "axis-parallel-jump":
            curve = curve.leveled()
        (ours, ours_se), (other, other_se) = curve.at(n), base.at(cost)
        # Extrapolate the variance with the measured rate of the changed estimator.
        # Also extrapolate the variance as if the gain over the best sampler did not depend on n.
        # Use the geometric mean of both extrapolated variances.
        # Half of the difference of the two extrapolated log variances is an additional error
        points_at_budget = budget // estimator.evaluations_per_point
        (value, error), at_best = curve.at(at_budget), base.at(points_at_budget)[0]
        kept = math.exp(curve.level) * ours / other * at_best if other > 0.0 else 0.0
        error = math.hypot(error, 0.5 * math.log(value / kept)) if value > 0.0 < kept else error
        after = math.sqrt(value * kept)
        sure = math.exp(-CONFIDENCE_Z * math.hypot(ours_se, other_se))
        # If tails are not resolved, small sets underestimate the variance
        doubt = math.exp(_SETTINGS.tail_errors * error) if grows else 1.0
        better = ours < other * sure and after * doubt < at_best
        own = replace(offer, change=f"{offer.change}, and sample with {NETS}")
        measured = (after, error)
        found.append(
            _FoundSampler(own, at_budget, measured, curve.rate, curve.rate_ci, smooths, sure=better)
        )
        if better:
            break
    return found, tried, calls
