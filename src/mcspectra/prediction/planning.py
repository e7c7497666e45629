"""Planning: the least number of points that reaches an error, from predicted variances."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import Counted, Need, Reduction, Subject, whole
from mcspectra.core.checks import Array
from mcspectra.core.errors import CountError, Parameter, ParameterError
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator
from mcspectra.measure.doors import VANISHES, answer
from mcspectra.prediction.known import Cells
from mcspectra.prediction.prediction import Prediction, Predictor
from mcspectra.samplers import Sampler
from mcspectra.samplers.law import Fixed, Law, leaf_of

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Plan", "PlanSettings", "plan"]

_TINY = 1e-300
"""Replaces a variance of 0 in logarithms."""


@final
@dataclass(frozen=True, kw_only=True)
class PlanSettings:
    """How the least count is searched.

    Attributes
    ----------
    octaves
        Variances are predicted at powers of two up to this one. Beyond the last one the curve goes on
        with its rate. It is the largest count at which `predict` looks for the limit of rates.
    margin
        Factor by which the curve goes below the wanted variance, so that the upper ends of intervals
        reach it as well.
    most
        Points that a plan still names: more do not fit a 64-bit integer.
    near
        Octaves about the place where a line between two counts reaches the target, at which variances
        are predicted as well: steps of 4 %, since curves go up and down between powers of two.
    steps
        Predictions of the search between the last two of them, about halving the interval each: four
        leave 1/16 of it, or 4 % of n where the counts are a factor of two apart.
    wide
        Ratio of the ends of an interval of n above which the recommendation names it.
    """

    octaves: int = 16
    margin: float = 4.0
    most: int = 2**62
    near: tuple[float, ...] = (-2 / 16, -1 / 16, 0.0, 1 / 16, 2 / 16)
    steps: int = 4
    wide: float = 1.25


_SETTINGS = PlanSettings()
_CURVE = tuple(2**k for k in range(_SETTINGS.octaves + 1))


@final
class Plan(Counted, frozen=True, kw_only=True):
    """Smallest number of points that reaches an error, from predicted variances."""

    function = "plan"
    verb = "plan"
    several = ("sampler",)
    variables = (
        *("planned_n", "planned_n_ci", "planned_error", "target_variance"),
        *("predicted_variance", "predicted_variance_ci"),
    )

    target_error: Annotated[
        float,
        Meta(gt=0.0, description="Wanted root mean square error of the estimate."),
    ]
    relative: Annotated[bool, Meta(description="The error is relative to the integral.")] = False

    def need(self, subject: Subject) -> Need:
        """What the predictions of one count need; an integral that errors can be relative to."""
        estimator, samplers = subject.estimator, subject.samplers
        for sampler in samplers:
            least = sampler.nearest_count(_CURVE[0])
            need = Prediction(counts=(least,)).need(Subject(estimator, sampler))
        if self.relative and not np.all(np.abs(estimator.integral) > 0):
            raise ParameterError(
                f"The integral of {estimator.spec} is {estimator.integral}, so that no error is a "
                "share of it; give ",
                Parameter("target_error"),
                " without relative.",
            )
        return Need(cost=need.cost * len(_CURVE) * len(samplers), memory=need.memory)

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[xr.Dataset]:
        """One sampler after the other; where the search goes depends on what it finds."""
        return whole(lambda: self._planned(subject, stream), self.need(subject).cost)

    def _planned(self, subject: Subject, stream: Stream) -> xr.Dataset:
        estimator, samplers = subject.estimator, subject.samplers
        scale = np.ones(max(1, estimator.channels))
        if self.relative:
            scale = np.atleast_1d(np.abs(np.asarray(estimator.integral, float)))
        target = np.asarray(self.target_error * scale) ** 2
        predictor = Predictor(estimator, stream)
        planned, ranges, errors, methods, notes = [], [], [], [], []
        curves = np.full((len(samplers), len(_CURVE), max(1, estimator.channels)), np.nan)
        bounds = np.full((*curves.shape, 2), np.nan)
        for place, sampler in enumerate(samplers):
            counts, found = [], []
            for step, n in enumerate(_CURVE):
                nearest = sampler.nearest_count(n)
                if nearest in counts or not _can(estimator, sampler, nearest):
                    continue
                each = _cells(predictor, sampler, nearest)
                counts.append(nearest)
                found.append(each)
                if nearest == n:
                    curves[place, step] = each.variance[0]
                    bounds[place, step] = np.stack([each.low, each.high], axis=-1)[0]
                if (each.variance[0] <= target / _SETTINGS.margin).all():
                    break
            n, variance, method = self._least(predictor, sampler, counts, found, target)
            planned.append(n)
            ranges.append(_range(sampler, n, counts, found, target))
            errors.append(np.sqrt(variance))
            methods.append(method)
            said = dict.fromkeys(str(each.notes[0]) for each in found)
            notes += [f"{sampler.spec}: {note}" for note in said if note not in ("", VANISHES)]

        # In words: the sampler that takes the fewest points, and the others beside it
        evaluations = sum(estimator.counts)
        reached = sorted(zip(planned, (s.spec for s in samplers), ranges, strict=True))
        sizes = [
            f"{n:.0f}{f' ({low:.0f} to {high:.0f})' if high > _SETTINGS.wide * low else ''} with {name}"
            for n, name, (low, high) in reached
            if np.isfinite(n)
        ]
        none = "; ".join(dict.fromkeys(notes)) or "no sampler is predicted to reach the error"
        told = f"n = {' or '.join(sizes)}" if sizes else none
        if evaluations > 1 and sizes:
            told += f"; each is {evaluations} evaluations"
        alone = subject.sampler is samplers[0]
        names, hows = map(list, zip(*methods, strict=True))
        return dataset(
            {
                "planned_n": (("sampler",), np.array(planned, float)),
                "planned_n_ci": (("sampler", "bound"), np.array(ranges, float)),
                "planned_error": (("sampler", "channel"), np.array(errors)),
                "target_variance": (("channel",), np.broadcast_to(target, scale.shape)),
                "predicted_variance": (("sampler", "n", "channel"), curves),
                "predicted_variance_ci": (("sampler", "n", "channel", "bound"), bounds),
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
            recommendation=told,
            note="; ".join(notes) or None,
        )

    def _least(
        self,
        predictor: Predictor,
        sampler: Sampler,
        counts: list[int],
        found: list[Cells],
        target: Array,
    ) -> tuple[float, Array, tuple[str, str]]:
        """The least count at which all channels reach the target, its variance, method and details."""
        variances = [each.variance[0] for each in found]
        known = [k for k, v in enumerate(variances) if np.isfinite(v).all()]
        unknown = np.full(len(target), math.nan)
        if not known:
            return math.nan, unknown, found[-1].named() if found else ("none", "")
        first = next((k for k in known if (variances[k] <= target).all()), None)
        if first is None:
            # By the slope of the last predictions, rounded to a count that the sampler can do
            last, earlier = known[-1], known[max(0, len(known) - 4)]
            ends, ratio = variances[last], counts[last] / counts[earlier]
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                rate = np.log(ends / variances[earlier]) / np.log(ratio)
                wanted = counts[last] * float(np.exp(np.max(np.log(target / ends) / rate)))
            if not ((rate < 0.0).all() and wanted < min(_SETTINGS.most, sampler.max_count)):
                return math.nan, unknown, ("none", "out of reach")
            n = sampler.nearest_count(math.ceil(wanted))
            if (ends * (n / counts[last]) ** rate > target * (1.0 + 1e-9)).any():
                n = sampler.nearest_count(2 * n)  # the nearest is below
            variance = ends * (n / counts[last]) ** rate
            how = f"extrapolated from n = {counts[last]}"
            return float(n), variance, (found[last].named()[0], how)
        best = float(counts[first]), variances[first], found[first].named()
        before = [k for k in known if k < first]

        # Between the last count that misses the target and the first that reaches it: about where a
        # line through both does, for curves go up and down; nets in base 2 are balanced at powers of two
        if not before or _doubles(sampler.law(counts[first])):
            return best
        low, high = ((counts[k], np.maximum(variances[k], _TINY)) for k in (before[-1], first))

        def crossing() -> float:
            slope = np.log(high[1] / low[1]) / math.log(high[0] / low[0])
            line = np.log(target / low[1]) / np.where(slope < 0.0, slope, -math.inf)
            return low[0] * math.exp(float(line.max()))

        tried = list(crossing() * 2.0 ** np.array(_SETTINGS.near))
        for step in range(len(tried) + _SETTINGS.steps):
            wanted = tried[step] if step < len(tried) else crossing()
            between = sampler.nearest_count(math.ceil(wanted))
            if not low[0] < between < high[0] or not _can(predictor.estimator, sampler, between):
                continue
            each = _cells(predictor, sampler, between)
            if not np.isfinite(each.variance[0]).all():
                break
            counts.append(between)
            found.append(each)
            place = between, np.maximum(each.variance[0], _TINY)
            if (each.variance[0] <= target).all():
                high, best = place, (float(between), each.variance[0], each.named())
            else:
                low = place
        return best


def _range(
    sampler: Sampler, n: float, counts: list[int], found: list[Cells], target: Array
) -> tuple[float, float]:
    """Least counts from which on either end of the intervals reaches the target; beyond them along slopes.

    Infinite where slopes never do.
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
        missed = np.flatnonzero(off > 0.0)
        if not len(missed):
            ends.append(x[0])
        elif (k := missed[-1] + 1) == len(x):
            ends.append(x[-1] + (off[-1] / -slope if slope < 0.0 else math.inf))
        else:
            ends.append(np.interp(0.0, -off[k - 1 : k + 1], x[k - 1 : k + 1]))
    with np.errstate(over="ignore"):
        low, high = np.exp(ends)
        if _doubles(sampler.law(sampler.nearest_count(int(n)))):
            low, high = np.exp2(np.ceil(np.log2([low, high]) - 1e-6))
    return min(math.ceil(low - 1e-6), n), max(float(np.ceil(high - 1e-6)), n)


def _doubles(law: Law) -> bool:
    """Whether it is that of a net in base 2, balanced at powers of two alone."""
    leaf = leaf_of(law)
    return isinstance(leaf, Fixed) and set(leaf.bases or ()) == {2}


def _cells(predictor: Predictor, sampler: Sampler, n: int) -> Cells:
    """The prediction of one count; 0 where the variance is known to be that of rounding."""
    found = predictor.at(sampler, n)
    vanishes = found.notes[0] == VANISHES
    return replace(found, variance=np.nan_to_num(found.variance)) if vanishes else found


def _can(estimator: AbstractEstimator, sampler: Sampler, n: int) -> bool:
    """Whether the sampler can do so many points for each technique."""
    try:
        estimator.check_sampler(sampler, n)
    except CountError:
        return False
    return True


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
    """Plan the least number of points for which an error is reached, for each sampler.

    Parameters
    ----------
    estimator, samplers
        As in `predict`: an estimator, one sampler or a list.
    dims
        Number of dims of a function, and of a spec that leaves it open; by default those of a sampler
        that is not a spec.
    target_error
        Wanted root mean square error; of several channels of each.
    relative
        Whether it is a share of the integral.
    rng, workers
        As in `predict`.
    max_evaluations
        Most evaluations of the integrand: what takes more is refused, where that is known before it starts.

    Returns
    -------
    xarray.Dataset
        ``planned_n``, the least count that was tried with a predicted RMSE of at most the target: powers
        of two, and counts 4 % apart about the place where the line between two of them reaches it, for nets
        in base 2 (sobol, pmj02 and the like, which other counts leave unbalanced) powers of two alone; NaN
        where none is known. ``planned_n_ci(bound)``, this count if the variances were at the ends of their
        95 % intervals, or fell as fast and as slowly as they did last; ``planned_error``, the RMSE there; ``target_variance``, the
        square of the target; the curve ``predicted_variance(n)`` with ``predicted_variance_ci(n, bound)`` at powers of two that the
        sampler can do, to a quarter of the wanted variance or 2^16. Beyond them n follows from the last slope, and ``how`` says so. Coordinates ``method`` and ``how``,
        attributes where there is one sampler, are those of `predict`. A list adds the dim sampler. The attribute ``recommendation`` says it in words.

    Raises
    ------
    ParameterError
        The target is not positive, or relative to an integral of 0.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> found = mcs.plan("gaussian", ["sobol | owen", "random"], target_error=1e-3)
    >>> found.attrs["recommendation"]
    'n = 256 with sobol | owen or 66514 with random'
    """
    return answer(Plan, locals())
