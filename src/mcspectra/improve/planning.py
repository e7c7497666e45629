"""Planning: the least number n of points whose estimate reaches a target error.

For known integrands, the variance is predicted at powers of two.
A bisection between two powers of two predicts the variance at further n, and finds the least n.
For a user's function the variance is measured.
Scrambled nets give the variance of several samplers at once (`mcspectra.explain.samples`).
The variance of other samplers is measured with sets that they draw.
A measurement has stages. Each stage doubles the number of evaluations and keeps earlier ones.
The measurement ends at the first stage whose interval of n is narrow enough.
A smaller target error never gives fewer points.
Evaluations do not depend on the target error, which is only compared with measured errors.
No stage returns an n that an earlier stage excluded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import Counted, Need, Reduction, Subject, compute, whole
from mcspectra.core.checks import Array
from mcspectra.core.confidence import student_t
from mcspectra.core.display import between
from mcspectra.core.errors import CountError, NoClosedForm, Parameter, ParameterError
from mcspectra.core.memory import memory_of
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator
from mcspectra.estimators.importance import as_subject
from mcspectra.estimators.moments import mean_interval
from mcspectra.estimators.tails import doubt
from mcspectra.explain.samples import CURVE_SETTINGS, NETS, Curve, Sets, curve_of
from mcspectra.measure.blindness import NO_VARIANCE, VANISHES
from mcspectra.prediction.known import Cells
from mcspectra.prediction.prediction import LIMITS, Prediction, Predictor
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.samplers.law import Fixed, Law, leaf_of

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["MeasuredPlanSettings", "Plan", "PlanSettings", "plan"]

_TINY = float(np.finfo(float).tiny)
"""Number that replaces a variance of 0 in logarithms."""


@final
@dataclass(frozen=True)
class PlanSettings:
    """Settings of plans for known integrands, whose variance is predicted."""

    # Largest power of two at which variances are predicted.
    # For larger n, the curve of the variance is extrapolated by its rate.
    # `predict` also searches for the asymptotic rate up to 2^16 points.
    octaves: int = 16
    # The variance is predicted at larger and larger n, until it is this factor below the target.
    # If the variance is a quarter of the target, the upper end of its interval is below the target.
    margin: float = 4.0
    # Largest planned number of points. Larger numbers do not fit into a 64-bit integer.
    most: int = 2**62
    # The bisection for n ends when its interval is at most 1/256 of the power of two above n.
    # Up to n = 256, the search finds the least count.
    # For larger n, a bisection with eight predictions of the variance finds n to 0.4 %.
    steps: int = 256
    # The answer shows the interval of n if the ratio of its ends is larger than this number.
    wide: float = 1.25
    # Number of consecutive counts that are tried to find a count that the sampler allows.
    # If an estimator has several techniques, the sampler must have sets for all techniques.
    tries: int = 256


@final
@dataclass(frozen=True)
class MeasuredPlanSettings:
    """Settings of plans that measure the variance of a user's function."""

    # Limit on evaluations, even if the user allows more.
    # In 1-D the points of the last stage take 128 MB.
    most: int = 2**24
    # Number of evaluations of the first stage. The default of `profile` is the same number.
    first: int = 2**12
    # Number of sets of points that the first stage evaluates.
    # A variance from 32 sets has a relative standard error of 25 %.
    nets: int = 32
    # Every third stage doubles the number of sets.
    # All other stages double the number of points in each set.
    # A measurement of 2^18 evaluations then has 128 sets.
    # The standard error of the variance from 128 sets is 12 %.
    # If the number of sets were doubled in every second stage, sets would be half as large,
    # and rates of functions with jumps would become uncertain.
    doubling: int = 3
    # Least number of points in each set of the first stage.
    # Parts of a set of 8 points give variances at smaller counts, from which a rate is fitted.
    least: int = 8
    # Least number of sets from which a variance is estimated, as in `profile`.
    # The least number of sets is small because some samplers have only a few stored sets.
    least_sets: int = 3
    # The measurement stops if the ratio of the ends of the interval of n is below this value.
    narrow: float = 1.5
    # With this number of sets of n points, the variance at n counts as precise enough.
    # A variance from 256 sets has a relative standard error of √(2/256) = 9 %.
    enough: int = 256
    # The target error is compared with a piecewise linear curve of the variance.
    # The curve of the variance has this number of nodes per octave of n.
    parts: int = 16


_SETTINGS, _MEASURED = PlanSettings(), MeasuredPlanSettings()
_CURVE = tuple(2**k for k in range(_SETTINGS.octaves + 1))
_OF_NETS = {NETS, "random", "jittered"}


@final
@dataclass(frozen=True)
class _Found:
    """Answer for one sampler: n, the interval of n, and the variance at n for each channel.

    `curve` contains the variance and its interval at the counts `_CURVE`, (N, channels, 3).
    """

    n: float
    ends: tuple[float, float]
    variance: Array
    method: tuple[str, str]
    curve: Array
    notes: tuple[str, ...] = ()

    @staticmethod
    def none(channels: int, note: str) -> _Found:
        """Return an answer without n, together with the reason."""
        nan = math.nan
        curve = np.full((len(_CURVE), channels, 3), nan)
        return _Found(nan, (nan, nan), np.full(channels, nan), ("none", note), curve, (note,))


@final
class Plan(Counted, frozen=True, kw_only=True):
    """Smallest number of points that reaches an error, predicted, or measured for functions."""

    function = "plan"
    verb = "plan"
    several = ("sampler",)
    variables = (
        *("planned_n", "planned_n_ci", "planned_error", "target_variance"),
        *("predicted_variance", "predicted_variance_ci"),
    )

    target_error: Annotated[
        float,
        Meta(gt=0.0, description="Target root mean square error of the estimate."),
    ]
    relative: Annotated[bool, Meta(description="The error is relative to the integral.")] = False

    def need(self, subject: Subject) -> Need:
        """Return the memory and work that a plan needs; check that a relative error exists."""
        estimator, samplers = subject.estimator, subject.samplers
        for sampler in samplers:
            least = sampler.nearest_count(1)
            if _is_measured(estimator):
                estimator.check_sampler(sampler, least)
            else:
                need = Prediction(counts=(least,)).need(Subject(estimator, sampler))
        integral = self._integral(estimator) if self.relative else 1.0
        if integral is not None and not np.all(np.abs(integral) > 0):
            raise ParameterError(
                f"The integral of {estimator.spec} is {integral}, so no error is relative to it; "
                "give ",
                Parameter("target_error"),
                " without relative.",
            )
        if not _is_measured(estimator):
            return Need(cost=need.cost * len(_CURVE) * len(samplers), memory=need.memory)
        limit = min(self.limit(subject) or _MEASURED.most, _MEASURED.most)
        least = _MEASURED.nets * _MEASURED.least * estimator.cost * len(self._parts(subject))
        return Need(
            cost=float(limit),
            memory=memory_of(limit // sum(estimator.counts), estimator.dims, sum(estimator.counts)),
            evaluations=least,
        )

    def limit(self, subject: Subject) -> int | None:
        """Return the maximum number of evaluations; known integrands have no limit."""
        if self.max_evaluations is None and _is_measured(subject.estimator):
            return LIMITS.evaluations
        return self.max_evaluations

    def _integral(self, estimator: AbstractEstimator) -> Any:
        """Return the integral, or None if it must be estimated from evaluations."""
        if _is_measured(estimator) and estimator.integral_source != "exact":
            return None
        return estimator.integral

    def _parts(self, subject: Subject) -> list[str]:
        """Return the samplers that a measurement draws, and among which evaluations are divided."""
        estimator = subject.estimator
        apart = [s.spec for s in subject.samplers if not _of_nets(estimator, s)]
        nets = len(apart) < len(subject.samplers)
        nets |= self.relative and self._integral(estimator) is None
        fixed = {s.spec for s in subject.samplers if estimator.randomized(s).fixed}
        return [NETS] * nets + [spec for spec in apart if spec not in fixed]

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[xr.Dataset]:
        """Compute the plan as one task, because each step of the search needs the previous step."""
        return whole(lambda: self._planned(subject, stream))

    def _planned(self, subject: Subject, stream: Stream) -> xr.Dataset:
        estimator, samplers = subject.estimator, subject.samplers
        if _is_measured(estimator):
            target, found = self._by_measurement(subject, stream)
        else:
            scale = np.ones(max(1, estimator.channels))
            if self.relative:
                scale = np.atleast_1d(np.abs(np.asarray(estimator.integral, float)))
            target = (self.target_error * scale) ** 2
            predictor = Predictor(estimator, stream)
            found = [_by_prediction(predictor, sampler, target) for sampler in samplers]
        notes = [
            f"{sampler.spec}: {note}"
            for sampler, each in zip(samplers, found, strict=True)
            for note in each.notes
        ]

        # The sampler with the fewest points comes first in the answer
        evaluations = sum(estimator.counts)
        reached = sorted(
            (each.n, sampler.spec, *each.ends)
            for sampler, each in zip(samplers, found, strict=True)
            if np.isfinite(each.n)
        )
        sizes = [f"{n:.0f}{_between(low, high)} with {name}" for n, name, low, high in reached]
        none = "; ".join(dict.fromkeys(notes)) or "no sampler is predicted to reach the error"
        told = f"n = {' or '.join(sizes)}" if sizes else none
        if evaluations > 1 and sizes:
            told += f"; each is {evaluations} evaluations"
        alone = subject.sampler is samplers[0]
        names, hows = map(list, zip(*(each.method for each in found), strict=True))
        curves = np.array([each.curve for each in found])
        return dataset(
            {
                "planned_n": (("sampler",), np.array([each.n for each in found])),
                "planned_n_ci": (("sampler", "bound"), np.array([each.ends for each in found])),
                "planned_error": (
                    ("sampler", "channel"),
                    np.sqrt([each.variance for each in found]),
                ),
                "target_variance": (("channel",), target),
                "predicted_variance": (("sampler", "n", "channel"), curves[..., 0]),
                "predicted_variance_ci": (("sampler", "n", "channel", "bound"), curves[..., 1:]),
            },
            {
                "n": ("n", list(_CURVE), {"long_name": "number of points", "units": "1"}),
                "bound": ["low", "high"],
                **(
                    {}
                    if alone
                    else {
                        "sampler": [s.spec for s in samplers],
                        "method": ("sampler", names, {"long_name": "method of the prediction"}),
                        "how": (
                            "sampler",
                            hows,
                            {"long_name": "how the method found the variance"},
                        ),
                    }
                ),
            },
            drop=["sampler"] * alone + ["channel"] * (not estimator.channels),
            estimator=estimator.spec,
            sampler=samplers[0].spec if alone else None,
            method=names[0] if alone else None,
            how=hows[0] if alone else None,
            target_error=self.target_error,
            relative=self.relative,
            answer=told,
            note="; ".join(notes) or None,
        )

    def _by_measurement(self, subject: Subject, stream: Stream) -> tuple[Array, list[_Found]]:
        """Return the target variance, (channels,), and the answer for each sampler."""
        estimator, channels = subject.estimator, max(1, subject.estimator.channels)
        parts = self._parts(subject)
        limit = min(self.limit(subject) or _MEASURED.most, _MEASURED.most)
        share = limit // max(1, len(parts)) // estimator.cost
        nets = _Nets(estimator, share, stream.child(0)) if NETS in parts[:1] else None
        target, integral = np.full(channels, self.target_error), self._integral(estimator)
        if self.relative and integral is not None:
            target = target * np.abs(integral)
        elif self.relative:
            assert nets is not None
            for stage in nets.stages():
                means = stage.means
                low, high = np.array([mean_interval(means[:, c]) for c in range(channels)]).T
                zero = bool(((low <= 0.0) & (high >= 0.0)).any())
                if not zero:
                    break
            target = target * np.abs(means.mean(axis=0))
            if zero:
                reason = "the integral may be 0, so no error is relative to it"
                return target**2, [_Found.none(channels, reason)] * len(subject.samplers)
        found = []
        for place, sampler in enumerate(subject.samplers):
            if estimator.randomized(sampler).fixed:
                found.append(_Found.none(channels, f"a deterministic sampler {NO_VARIANCE}"))
                continue
            source: _Nets | _Own | None = nets
            if not _of_nets(estimator, sampler):
                source = _Own(estimator, sampler, share, stream.child(1 + place))
            assert source is not None
            found.append(_in_stages(source, sampler, target**2))
        return target**2, found


def _between(low: float, high: float) -> str:
    """Format an interval in parentheses if it is wide, otherwise return an empty text."""
    if math.isinf(high):
        return f" ({low:.0f} or more)"
    return f" ({between(f'{low:.0f}', f'{high:.0f}')})" if high > _SETTINGS.wide * low else ""


# ------------------------------------------------------------------------------------- predictions


def _by_prediction(predictor: Predictor, sampler: Sampler, target: Array) -> _Found:
    """Return the least count whose predicted variances of all channels reach the target."""
    estimator = predictor.estimator
    counts, found = list[int](), list[Cells]()
    curve = np.full((len(_CURVE), len(target), 3), np.nan)

    def at(n: int) -> Array:
        """Predict the variance at a count of points, and store the prediction."""
        cells = predictor.at(sampler, n)
        if cells.notes[0] == VANISHES:  # Rounding noise counts as 0
            cells = replace(cells, variance=np.nan_to_num(cells.variance))
        counts.append(n)
        found.append(cells)
        return np.asarray(cells.variance[0])

    for step, n in enumerate(_CURVE):
        nearest = sampler.nearest_count(n)
        if nearest in counts or not _can(estimator, sampler, nearest):
            continue
        variance = at(nearest)
        if nearest == n:
            curve[step] = np.stack([variance, found[-1].low[0], found[-1].high[0]], axis=-1)
        if (variance <= target / _SETTINGS.margin).all():
            break
    n, variance, method = _least(estimator, sampler, counts, found, target, at)
    ends = _ends(estimator, sampler, n, counts, found, target)
    said = dict.fromkeys(str(each.notes[0]) for each in found)
    notes = tuple(note for note in said if note not in ("", VANISHES))
    return _Found(n, ends, variance, method, curve, notes)


def _least(
    estimator: AbstractEstimator,
    sampler: Sampler,
    counts: list[int],
    found: list[Cells],
    target: Array,
    at: Callable[[int], Array],
) -> tuple[float, Array, tuple[str, str]]:
    """Return the least count that reaches the target, with its variance, method and details."""
    variances = [each.variance[0] for each in found]
    known = [k for k, v in enumerate(variances) if np.isfinite(v).all()]
    unknown = np.full(len(target), math.nan)
    if not known:
        return math.nan, unknown, found[-1].named() if found else ("none", "")
    first = next((k for k in known if (variances[k] <= target).all()), None)
    if first is None:
        # Extrapolate by the slope of the last predictions, and round up to an allowed count
        last, earlier = known[-1], known[max(0, len(known) - 4)]
        ends, ratio = variances[last], counts[last] / counts[earlier]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            rate = np.log(ends / variances[earlier]) / np.log(ratio)
            wanted = counts[last] * float(np.exp(np.max(np.log(target / ends) / rate)))
        if not (rate < 0.0).all():
            return math.nan, unknown, ("none", "out of reach")
        n = _count_from(estimator, sampler, wanted)
        if not math.isfinite(n):
            return math.nan, unknown, ("none", "out of reach")
        variance = ends * (n / counts[last]) ** rate
        how = f"extrapolated from n = {counts[last]}"
        return n, variance, (found[last].named()[0], how)
    best = float(counts[first]), variances[first], found[first].named()
    before = [k for k in known if k < first]

    # Bisect between the last count that misses the target and the first count that reaches it.
    # The interval of the bisection may be several octaves, because the curve need not be monotone.
    # A smaller target variance never gives a smaller n, because bisections test the same counts.
    # If the variance at a count is between two targets, only the smaller target needs a larger n.
    # For nets there is no bisection, because nets are balanced only at powers of their base
    if not before or _base(estimator.law(sampler, counts[first])):
        return best
    low, high = counts[before[-1]], counts[first]
    step = max(1, high // _SETTINGS.steps)
    while high - low > step:
        between = sampler.nearest_count((low + high) // 2)
        if not low < between < high:
            between = sampler._counts_near(low + 1)[1]
        if not low < between < high or not _can(estimator, sampler, between):
            break
        variance = at(between)
        if not np.isfinite(variance).all():
            break
        if (variance <= target).all():
            high, best = between, (float(between), variance, found[-1].named())
        else:
            low = between
    return best


def _ends(
    estimator: AbstractEstimator,
    sampler: Sampler,
    n: float,
    counts: list[int],
    found: list[Cells],
    target: Array,
) -> tuple[float, float]:
    """Return the least counts at which the two ends of the predicted interval reach the target.

    Beyond the last predicted count, the last slopes of the variance extrapolate the interval.
    If an end of the interval never reaches the target, its count is infinite.
    """
    order = [k for k in np.argsort(counts) if np.isfinite(found[k].variance[0]).all()]
    if not np.isfinite(n) or not order:
        return math.nan, math.nan
    x = np.log([counts[k] for k in order])
    over = np.log(np.maximum([found[k].variance[0] for k in order], _TINY) / target).max(axis=1)
    slopes = np.diff(over[-4:]) / np.diff(x[-4:])
    ends = []
    for side, slope in ((0, slopes.min(initial=0.0)), (1, slopes.max(initial=-math.inf))):
        limits = np.nan_to_num([(found[k].low, found[k].high)[side][0] for k in order])
        off = np.log(np.maximum(limits, _TINY) / target).max(axis=1)
        end = _crossing(x, off)
        if math.isinf(end) and slope < 0.0:
            end = x[-1] + off[-1] / -slope
        ends.append(end)
    with np.errstate(over="ignore"):
        low, high = (_count_from(estimator, sampler, each) for each in np.exp(ends))
    return min(low, n), max(high, n)


# ------------------------------------------------------------------------------------ measurements


@final
@dataclass(frozen=True)
class _Stage:
    """Curves of variance after one stage of a measurement, and the evaluations of the stage.

    Attributes
    ----------
    curves
        For each sampler by its spec: a list of curves of variance, one for each channel.
    means
        Estimates from the largest sets, (R, channels).
    points, values
        Points (N, d) of a single technique, or None if there are several techniques.
        The values (N, channels) belong to the technique with the largest variance.
    largest
        Number R · n of points in all R sets of the largest size n.
    evaluations
        Number of evaluations of this stage and all earlier stages together.
    """

    curves: dict[str, list[Curve]]
    means: Array
    points: Array | None
    values: Array
    largest: int
    evaluations: int


def _sizes(stage: int, share: int, each: int) -> tuple[int, int] | None:
    """Return the number of sets and of points of a stage; None if they exceed the evaluations."""
    first = max(_MEASURED.first // each, _MEASURED.nets * _MEASURED.least)
    points = first << stage
    if points > share:
        if stage:
            return None
        points = share
    return _MEASURED.nets << stage // _MEASURED.doubling, points


def _pooled(
    points: Sequence[Array], values: Sequence[Array], channels: int
) -> tuple[Array | None, Array]:
    """Pool points (R, n, d) and values (R, n, channels) of all sets for `_Stage`."""
    most = max(values, key=lambda v: float(v.var(axis=(0, 1)).max()))
    x = points[0].reshape(-1, points[0].shape[2]) if len(points) == 1 else None
    return x, most.reshape(-1, channels)


@dataclass
class _Nets:
    """Stages of a measurement with scrambled nets, which contain the nets of earlier stages."""

    estimator: AbstractEstimator
    share: int
    stream: Stream
    made: list[_Stage] = field(default_factory=list)
    values: list[Array] = field(default_factory=list)
    evaluations: int = 0

    def stage(self, place: int) -> _Stage:
        """Return a stage. Each stage is computed once, after all earlier stages."""
        while len(self.made) <= place:
            self.made.append(self._next())
        return self.made[place]

    def stages(self) -> Iterator[_Stage]:
        """Yield the stages that fit into the allowed evaluations, and compute each on demand."""
        place = 0
        while _sizes(place, self.share, self.estimator.cost):
            yield self.stage(place)
            place += 1

    def _next(self) -> _Stage:
        estimator, channels = self.estimator, max(1, self.estimator.channels)
        sizes = _sizes(len(self.made), self.share, estimator.cost)
        assert sizes is not None
        nets, n = sizes[0], 1 << (sizes[1] // sizes[0]).bit_length() - 1
        points = estimator.draw(as_sampler(NETS, estimator.dims), n, self.stream, 0, nets)
        # The previous stage has evaluated the first points of the first nets
        values = []
        for t, u in enumerate(points):
            all_values = np.empty((*u.shape[:2], channels))
            rows, columns = 0, 0
            if self.values:
                rows, columns = self.values[t].shape[:2]
                all_values[:rows, :columns] = self.values[t]
            for new in ((slice(rows), slice(columns, None)), (slice(rows, None), slice(None))):
                if u[new].size:
                    made = estimator.primary_values(t, u[new])
                    all_values[new] = made.reshape(*made.shape[:2], channels)
                    self.evaluations += (
                        made.shape[0] * made.shape[1] * estimator.evaluations_per_point
                    )
            values.append(all_values)
        self.values = values
        curves: dict[str, list[Curve]] = {}
        for c in range(channels):
            sets = Sets(points, [v[..., c] for v in values], estimator.counts)
            for name, curve in sets.curves(names=_OF_NETS).items():
                curves.setdefault(name, []).append(curve)
        return _Stage(
            {name: each for name, each in curves.items() if len(each) == channels},
            np.asarray(sum(v.mean(axis=1) for v in values)),
            *_pooled(points, values, channels),
            nets * n,
            self.evaluations,
        )


@dataclass
class _Own:
    """A measurement in stages. The sampler draws sets whose numbers of points are powers of a base.

    Each stage adds larger counts of points, or further sets of the same counts.
    """

    estimator: AbstractEstimator
    sampler: Sampler
    share: int
    stream: Stream
    made: dict[int, tuple[list[Array], list[Array]]] = field(default_factory=dict)
    evaluations: int = 0

    def stages(self) -> Iterator[_Stage]:
        """Yield the stages that fit into the allowed evaluations, and compute each on demand."""
        estimator, sampler = self.estimator, self.sampler
        base = max(sampler.digit_bases, default=2)
        counts = sorted({
            count
            for k in range(int(math.log(self.share, base)) + 1)
            if _can(estimator, sampler, count := sampler.nearest_count(base**k))
        })  # fmt: skip
        stage, channels = 0, max(1, estimator.channels)
        while sizes := _sizes(stage, self.share, estimator.cost):
            sets = int(min(sizes[0], sampler.most_realizations))
            fit = int(np.searchsorted(np.cumsum(counts) * sets, sizes[1], side="right"))
            if sets < _MEASURED.least_sets or not fit:
                return
            for n in counts[:fit]:
                self._add(n, sets)
            estimates = [
                np.asarray(sum(v.mean(axis=1) for v in self.made[n][1])) for n in counts[:fit]
            ]
            curves = [curve_of(counts[:fit], [e[:, c] for e in estimates]) for c in range(channels)]
            yield _Stage(
                {sampler.spec: curves},
                estimates[-1],
                *_pooled(*self.made[counts[fit - 1]], channels),
                sets * counts[fit - 1],
                self.evaluations,
            )
            stage += 1

    def _add(self, n: int, sets: int) -> None:
        """Evaluate more sets of n points, until there are `sets` sets."""
        estimator, channels = self.estimator, max(1, self.estimator.channels)
        points, values = self.made.get(n, ([], []))
        have = len(points[0]) if points else 0
        if have >= sets:
            return
        new = estimator.draw(self.sampler, n, self.stream.child(n), have, sets - have)
        made = [
            estimator.primary_values(t, u).reshape(*u.shape[:2], channels)
            for t, u in enumerate(new)
        ]
        self.evaluations += (sets - have) * n * estimator.cost
        if have:
            new = [np.concatenate(both) for both in zip(points, new, strict=True)]
            made = [np.concatenate(both) for both in zip(values, made, strict=True)]
        self.made[n] = new, made


def _in_stages(source: _Nets | _Own, sampler: Sampler, target: Array) -> _Found:
    """Return the answer of the first stage that determines n well enough, or of the last stage."""
    estimator, least, best = source.estimator, 0.0, None
    for stage in source.stages():
        curves = stage.curves.get(sampler.spec)
        # A stage lists no curve for a sampler if the error of its variance is too large
        if curves is None:
            continue
        curve = _Ladder.of(curves)
        note, _ = doubt(stage.points, stage.values) or ("", False)
        n = max(math.exp(curve.reaches(target, 0)), least)
        trusted = stage.largest / _MEASURED.enough
        if not note:
            trusted = max(trusted, curve.trusted)
        best = stage, curves, curve, n, note
        if n <= trusted:
            break
        least = max(least, trusted)
    if best is None:
        return _Found.none(
            len(target),
            f"{source.share * estimator.cost} evaluations do not determine its variance; give a "
            "larger max_evaluations",
        )
    stage, curves, curve, n, note = best
    last = min(float(c.counts[-1]) if len(c.counts) else c.vanishes for c in curves)
    vanishing = min(c.vanishes for c in curves)
    planned = _measured_count_from(estimator, sampler, n)
    if not math.isfinite(planned):
        return _Found.none(len(target), "no allowed count reaches the error")
    beyond = last < planned < vanishing
    if not note and beyond and any(math.isnan(c.rate) for c in curves):
        note = f"{stage.evaluations} evaluations give no rate beyond n = {last:.0f}"
    low, high = (
        _measured_count_from(estimator, sampler, math.exp(curve.reaches(target, side)))
        for side in (-1, 1)
    )
    if not note and math.isinf(high):
        note = (
            f"{stage.evaluations} evaluations do not determine the rate beyond n = {last:.0f} well "
            "enough for an upper end; give a larger max_evaluations"
        )
    ends = min(low, planned), math.inf if note else max(high, planned)
    how = f"{stage.evaluations} evaluations"
    if beyond:
        how += f", extrapolated from n = {last:.0f}"
    table = np.full((len(_CURVE), len(target), 3), np.nan)
    for step, count in enumerate(_CURVE):
        if sampler.nearest_count(count) == count and _can(estimator, sampler, count):
            table[step] = curve.at(count)
            if (table[step, :, 0] <= target / _SETTINGS.margin).all():
                break
    variance = curve.at(planned)[:, 0]
    return _Found(planned, ends, variance, ("measured", how), table, (note,) if note else ())


@final
@dataclass(frozen=True)
class _Ladder:
    """Curves of the variance of all channels, at counts that do not depend on the target error.

    Attributes
    ----------
    curves
        One curve of the variance for each channel.
    n
        Numbers of points at which the curves are evaluated, equally spaced in log n, (N,).
    logs, half
        Logarithms of variances, and half widths of their 95 % intervals, (N, channels).
    """

    curves: Sequence[Curve]
    n: Array
    logs: Array
    half: Array

    @staticmethod
    def of(curves: Sequence[Curve]) -> _Ladder:
        """Evaluate curves up to the largest number of points of a plan."""
        octaves = math.log2(_SETTINGS.most)
        n = np.exp2(np.arange(octaves * _MEASURED.parts + 1) / _MEASURED.parts)
        found = np.array([[curve.at(each) for curve in curves] for each in n])
        t = student_t(1 + min(curve.degrees for curve in curves))
        return _Ladder(curves, n, np.log(np.maximum(found[..., 0], _TINY)), t * found[..., 1])

    def reaches(self, target: Array, side: int) -> float:
        """Return the logarithm of the least n at which a curve reaches the target.

        With `side` = 0, the curve is the curve of the variance.
        With `side` = −1 or 1, the curve is the lower or upper end of the interval of the variance.
        """
        off = (self.logs + side * self.half - np.log(target)).max(axis=1)
        return _crossing(np.log(self.n), off)

    def at(self, n: float) -> Array:
        """Return the variance at n, and the ends of its interval, (channels, 3)."""
        found = np.array([curve.at(n) for curve in self.curves])
        t = student_t(1 + min(curve.degrees for curve in self.curves))
        variance, half = found[:, 0], t * found[:, 1]
        with np.errstate(over="ignore"):
            return np.stack([variance, variance * np.exp(-half), variance * np.exp(half)], axis=1)

    @property
    def trusted(self) -> float:
        """Largest n up to which the intervals of n are narrow enough for all channels."""
        rates = [c.rate if math.isfinite(c.rate) else -1.0 for c in self.curves]
        width = (2.0 * self.half / np.maximum(-np.array(rates), 0.5)).max(axis=1)
        wide = np.flatnonzero(width > math.log(_MEASURED.narrow))
        if not len(wide):
            return math.inf
        return float(self.n[wide[0] - 1]) if wide[0] else 0.0


# ------------------------------------------------------------------------------------------ counts


def _crossing(x: Array, off: Array) -> float:
    """Return the first x at which the piecewise linear curve `off` reaches 0, or infinity."""
    reached = np.flatnonzero(off <= 0.0)
    if not len(reached):
        return math.inf
    k = int(reached[0])
    # If the variance falls to zero, do not interpolate: the count with zero variance is the answer
    if not k or off[k] < off[k - 1] + 0.5 * math.log(_TINY):
        return float(x[k])
    return float(np.interp(0.0, -off[k - 1 : k + 1], x[k - 1 : k + 1]))


def _count_from(estimator: AbstractEstimator, sampler: Sampler, n: float) -> float:
    """Return the least count ≥ n that the sampler allows; for nets, a power of their base.

    The result is infinite if the sampler allows no count ≥ n.
    Rounding is ignored: the count may be smaller than n by up to a millionth of n.
    """
    if not n * (1.0 - 1e-6) <= min(_SETTINGS.most, sampler.max_count):
        return math.inf
    count = max(1, math.ceil(n * (1.0 - 1e-6)))
    if base := _base(estimator.law(sampler, sampler.nearest_count(count))):
        count = base ** math.ceil(math.log(count, base) - 1e-9)
    for _ in range(_SETTINGS.tries):
        count = sampler._counts_near(count)[1]
        if count > sampler.max_count:
            return math.inf
        if _can(estimator, sampler, count):
            return float(count)
        count = count * base if base else count + 1
    return math.inf


def _measured_count_from(estimator: AbstractEstimator, sampler: Sampler, n: float) -> float:
    """Same as `_count_from`, but only powers of two for lattices: other counts vary in quality."""
    leaf = leaf_of(estimator.law(sampler, sampler.nearest_count(1)))
    if not (isinstance(leaf, Fixed) and leaf.even):
        return _count_from(estimator, sampler, n)
    for k in range(round(math.log2(min(_SETTINGS.most, sampler.max_count))) + 1):
        count = sampler.nearest_count(2**k)
        if count >= n * (1.0 - 1e-6) and _can(estimator, sampler, count):
            return float(count)
    return math.inf


def _base(law: Law) -> int:
    """Return the base of a net, or 0 for other points. Nets are balanced at powers of the base."""
    leaf = leaf_of(law)
    bases = set(leaf.bases or ()) if isinstance(leaf, Fixed) else set()
    return bases.pop() if len(bases) == 1 else 0


def _can(estimator: AbstractEstimator, sampler: Sampler, n: int) -> bool:
    """Return whether the sampler has sets of n points for each technique."""
    try:
        estimator.check_sampler(sampler, n)
    except CountError:
        return False
    return True


def _is_measured(estimator: AbstractEstimator) -> bool:
    """Return whether the integrand is too slow for predictions, which need millions of values."""
    techniques = range(len(estimator.counts))
    return estimator.is_black_box or any(estimator.primary_integrand(t).costly for t in techniques)


def _of_nets(estimator: AbstractEstimator, sampler: Sampler) -> bool:
    """Return whether evaluations at scrambled nets give the variance of a sampler."""
    try:
        estimator.check_independent()
    except NoClosedForm:
        return False
    if sampler.spec == "jittered":
        few = 1 < estimator.dims <= CURVE_SETTINGS.jittered_dims
        return few and set(estimator.counts) == {1}
    return sampler.spec in _OF_NETS


def plan(
    estimator: Any,
    samplers: Any,
    *,
    dims: int | None = None,
    target_error: float,
    relative: bool = False,
    rng: RngLike = 0,
    max_evaluations: int | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Plan the least number of points that reaches an error, for each sampler.

    Parameters
    ----------
    estimator, samplers
        An estimator, and a sampler or a list of samplers.
    dims
        Number of dims; needed if the estimator is a function or a spec without ``dims``.
        The default is the sampler's number of dims, unless the sampler is given as a spec.
    target_error
        Target root mean square error, for each channel.
    relative
        Whether the target is relative to the integral.
    rng
        Seed (SPEC 7).
    workers
        Number of threads; all processors by default. It has no effect on results.
    max_evaluations
        Maximum number of evaluations of a function or of a costly integrand.
        All samplers share these evaluations; the default is 2^18.
        A plan starts with 4,096 evaluations, and doubles this number in each stage.
        The plan ends when the ends of the interval of n differ by a factor below 1.5.

    Returns
    -------
    xarray.Dataset
        A dataset. ``planned_n`` is the least count whose RMSE is at most the target.
        If this count is not known, ``planned_n`` is NaN.
        For nets (such as sobol and pmj02) ``planned_n`` is a power of the net's base.
        Nets are unbalanced if their number of points is not a power of the base.
        For other samplers and known integrands, ``planned_n`` is accurate to 0.4 %.
        With the same seed, a smaller target never has a smaller ``planned_n``.
        ``planned_n_ci(bound)`` is the count for the ends of the 95 % interval of the variance.
        If the values do not bound the variance, the upper end is infinite.
        The attribute ``note`` gives the reason.
        ``planned_error`` is the RMSE at ``planned_n``.
        ``target_variance`` is the square of the target.
        ``predicted_variance(n)`` with ``predicted_variance_ci(n, bound)`` is the curve of variance.
        The predicted curve has values at the powers of two that the sampler allows.
        The curve ends at a quarter of the target variance or at 2^16 points.
        For larger n the curve is extrapolated by its last slope, which ``how`` reports.
        The coordinates ``method`` and ``how`` are the same as in `predict`.
        For measurements, ``method`` is ``"measured"`` and ``how`` is the number of evaluations.
        If there is a single sampler, ``method`` and ``how`` are attributes of the dataset.
        A list of samplers adds the dim sampler.
        The attribute ``answer`` is a sentence with n for each sampler.

    Raises
    ------
    ParameterError
        If the target is not positive, or if it is relative and the integral is 0.
    BudgetError
        If `max_evaluations` does not allow any measurement.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> found = mcs.plan("gaussian", ["sobol | owen", "random"], target_error=1e-3)
    >>> found.attrs["answer"]
    'n = 256 with sobol | owen or 66513 with random'
    """
    subject = as_subject(estimator, samplers, dims=dims, lists=True)
    return compute(Plan.of(locals()), subject, rng, workers)
