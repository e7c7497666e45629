"""What can be wrong with an estimator: each cause has a detector, evidence in numbers and a sentence.

`Evidence.of` evaluates; detectors look at what it found, evaluate nothing, and return a `Cause` or None.
`CAUSES` has them in the order of what hurts most; what is found is listed in that order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import DensityError, ParameterError, point_in_words
from mcspectra.core.streams import Stream
from mcspectra.densities.base import FunctionDensity
from mcspectra.estimators import AbstractEstimator, Estimator, Mirrored
from mcspectra.estimators.moments import Moments
from mcspectra.estimators.support import uncovered
from mcspectra.explain.probing import (
    COARSE,
    Lines,
    Pole,
    grain,
    lines_of,
    mean_dimension,
    pole_of,
)
from mcspectra.explain.samples import NETS, Curve, Sets, scalar
from mcspectra.samplers import GivenPoints, Sampler, as_sampler
from mcspectra.samplers import law as laws

__all__ = [
    "CAUSES",
    "FEW_NETS",
    "GIVEN",
    "Cause",
    "Evidence",
    "Name",
    "Replicates",
    "causes_of",
    "is_apart",
    "sets_of",
    "shares_of",
    "technique_name",
]

FEW_NETS = 20
"""At least: fewer tell little of errors."""

GIVEN = 0.25
"""Of the budget, for a sampler that nets do not tell of."""

Name: TypeAlias = Literal[
    "wrong-pdf",
    "noisy-function",
    "infinite-variance",
    "heavy-tail",
    "deterministic-set",
    "few-realizations",
    "slow-technique",
    "interior-jump",
    "axis-parallel-jump",
    "border-jump",
    "border-growth",
    "high-frequency",
    "high-dimension",
    "kink",
    "float-drift",
    "correlated-replicates",
    "stuck-chain",
    "none",
]

_MORE_FROM = 16384  # points, from which on there are more nets
_LINES, _CHECK = 0.2, 0.15  # of the budget
_LAW_AT = 64  # points at which a shift is looked up; it is the same at all n
_AGAIN = 8  # points whose values are asked for twice
_SAME_VALUE = 1e-6  # of the size of values: rounding of sums whose order changes
_POLES = 0.8  # of what lines may take
_CLIMBED = 300.0  # variances, of the largest square
_SIZES = 1e-120, 1e120  # of g, whose fourth powers float64 holds
_MANY = 4  # dims, from which on it matters how many g varies with at once

_HALF = 0.5  # exponent of a pole, and tail index, from which on the variance is infinite
_ALL = 0.95  # from which on there is no integral
_GROWS = 0.08  # exponent at the border
_HEAVY = 30.0  # kurtosis
_LARGE = 0.2  # of all squares, by one value
_FEW, _VERY_FEW = 0.05, 0.01  # of the values, that make nine tenths of the variance
_ALIKE = 0.05  # of all evaluations, as different values: a function in steps
_LOOKED = 4  # lines that show what is rough
_STRAIGHT = 0.7  # of the lines that meet a jump
_TURNS = 0.33  # of the places along a line, as extremes: of noise two thirds
_WAVES = 6.0  # along a line
_RESOLVED = 4.0  # gain of nets over random points, from which on they see what g does
_COARSE_CUBE = 16.0  # times 2 for each axis: points that resolve what is smooth
_MOST_DIMENSION = 1.8
_LITTLE_GAIN = 8.0  # by nets, over random points
_OPPOSITE = 1e-3  # of the variance, by what g differs between faces
_SEEN_OF_PDF = 4096  # points
_FEW_SETS = 8
_SERIAL = 4.5  # standard errors of the correlation of sets that follow each other
_ROUNDING = 1e-9  # of means that are the same for all sets
_GRAINS = 32.0  # of the numbers that estimates are: less is rounding
_AWAY = 6.0  # standard errors; by Student's t of nineteen degrees a chance of 1e-5
# What else is said of a function that is noise itself, whose lines show no shape
_SHAPELESS = frozenset(
    {
        "wrong-pdf",
        "noisy-function",
        "deterministic-set",
        "few-realizations",
        "correlated-replicates",
    }
)


@final
@dataclass(frozen=True)
class Cause:
    """What was found.

    Attributes
    ----------
    name
        One of `Name`.
    sentence
        What it is and what it does, with its numbers.
    evidence
        The numbers, by name.
    kinds
        Kinds of remedies that answer it (`mcspectra.improve.candidates.KINDS`).
    """

    name: Name
    sentence: str
    evidence: Mapping[str, float] = field(default_factory=dict)
    kinds: tuple[str, ...] = ()


@final
@dataclass(frozen=True)
class Replicates:
    """Sets of a sampler at one count.

    Attributes
    ----------
    estimates
        Of some of them, from none on: (R,).
    waves
        Means over each set of x − ½, cos 2πx and sin 2πx of every axis, whose means over uniform points are
        0: (R, 3d).
    different
        How many sets are different.
    """

    estimates: Array
    waves: Array
    different: int


@final
@dataclass(frozen=True)
class Evidence:
    """What was looked at.

    Attributes
    ----------
    estimator, sampler
        What was given.
    sets
        Evaluations at scrambled nets.
    curves
        Variances of samplers.
    lines
        Of each technique.
    pole
        Of a single technique, if g has one.
    mean_dimension
        Of g, NaN where it was not looked for.
    replicates
        Sets of the sampler, where these were drawn.
    noise
        Variance of g at one and the same point, where values at a point differ; else 0.
    calls
        Evaluations of the integrand that it took.
    missed
        A place where a density of the user's own is 0 and f is not, in words; else empty.
    """

    estimator: AbstractEstimator
    sampler: Sampler
    sets: Sets
    curves: Mapping[str, Curve]
    lines: tuple[Lines, ...]
    pole: Pole | None = None
    mean_dimension: float = math.nan
    replicates: Replicates | None = None
    noise: float = 0.0
    calls: int = 0
    missed: str = ""

    @staticmethod
    def of(estimator: AbstractEstimator, sampler: Sampler, budget: int, stream: Stream) -> Evidence:
        """What nets and lines tell within a budget of evaluations; `sampler` is not drawn.

        Raises
        ------
        ParameterError
            The budget is too small, or values are too large or too small for their powers.
        """
        each, n, nets = shares_of(estimator, sampler, budget)
        sets = Sets.of(estimator, n, nets, stream.child(0))
        calls = nets * n * each
        size = max(float(np.abs(v).max()) for v in sets.values)
        if not math.isfinite(size):  # f gives finite numbers
            raise ParameterError("The pdf is no number at some samples; give one that is finite.")
        if size and not _SIZES[0] <= size <= _SIZES[1]:
            raise ParameterError(
                f"The values of f are of the size {size:.1g}, whose powers float64 does not hold; divide f by it."
            )

        # Whether a density of the user's own is 0 where f is not
        missed = ""
        if isinstance(estimator, Estimator) and isinstance(estimator.density, FunctionDensity):
            places = uncovered(estimator.integrand, [estimator.density])
            places = places[:: max(1, len(places) // _AGAIN)][:_AGAIN]
            calls += len(places) * each
            if len(places) and (met := scalar(estimator, estimator.integrand(places)) != 0.0).any():
                missed = point_in_words(places[met][0])

        # The mean dimension and a pole of a single technique, then lines of each
        lines: list[Lines] = []
        mean, pole, noise = math.nan, None, 0.0
        allowed = int(_LINES * budget) // len(estimator.counts) // estimator.evaluations_per_point
        for t in range(len(estimator.counts)):
            made = 0

            def g(u: Array, t: int = t) -> Array:
                nonlocal made
                made += len(u)
                return np.asarray(scalar(estimator, estimator.primary_values(t, u[None]))[0])

            # Values at some of the points again
            points, values = sets.points[t].reshape(-1, estimator.dims), sets.values[t].ravel()
            again = max(1, min(_AGAIN, allowed // _AGAIN))
            off, before = np.abs(g(points[:again]) - values[:again]), values[:again]
            if off.max(initial=0.0) > _SAME_VALUE * max(np.ptp(sets.pooled), np.abs(before).max()):
                noise = max(noise, 0.5 * float((off**2).mean()))

            own, beside = stream.child(1 + t).generator(0), allowed // 4 // estimator.dims
            if len(estimator.counts) == 1:
                if estimator.dims >= _MANY and beside > 1:
                    step = max(1, nets * n // beside)
                    mean = mean_dimension(g, points[::step][:beside], values[::step][:beside], own)
                # In many dims a pole that matters makes few evaluations matter
                squares = (values - values.mean()) ** 2
                if estimator.dims < _MANY or squares.max() > _CLIMBED * squares.mean():
                    pole = pole_of(g, points, values, int(_POLES * allowed), own)
            lines.append(lines_of(g, estimator.dims, allowed - made, own))
            calls += made * estimator.evaluations_per_point
        seen = Evidence(estimator, sampler, sets, sets.curves(), tuple(lines), pole, mean)
        return replace(seen, noise=noise, calls=calls, missed=missed)

    @property
    def scale(self) -> float:
        """Spread of g."""
        return math.sqrt(float(self.sets.pooled.var()))

    @property
    def growth(self) -> float:
        """The largest exponent of g at the ends of lines."""
        return float(np.nanmax(self.each("growth"), initial=0.0))

    @property
    def wraps(self) -> bool:
        """Whether the sampler shifts points around the torus, to whose order that matters."""
        law = self.sampler.law(self.sampler.nearest_count(_LAW_AT))
        while isinstance(law, laws.Folded | laws.Mirrored):
            law = law.inner
        shifted = isinstance(law, laws.Shifted)
        # What is mirrored is shifted before it is folded
        return shifted and not isinstance(self.estimator, Mirrored)

    def each(self, name: str) -> Array:
        """An attribute of all lines."""
        return np.concatenate([getattr(lines, name) for lines in self.lines])


def is_apart(estimator: AbstractEstimator, sampler: Sampler) -> bool:
    """Whether a sampler has a variance of which nets do not tell."""
    told = sampler.spec in {NETS, "random", "jittered", "latin-hypercube"}
    return not told and not estimator.randomized(sampler).fixed


def shares_of(estimator: AbstractEstimator, sampler: Sampler, budget: int) -> tuple[int, int, int]:
    """Evaluations of a point, points of a net, and number of nets.

    Raises
    ------
    ParameterError
        The budget is too small for nets of four points.
    """
    each = sum(estimator.counts) * estimator.evaluations_per_point
    share = 1.0 - _LINES - _CHECK - (GIVEN if is_apart(estimator, sampler) else 0.0)
    # The error of a rate falls with the number of nets alone, that of the integral with their size, too
    nets = int(FEW_NETS * max(1.0, math.sqrt(budget / (each * _MORE_FROM))))
    n = int(share * budget) // (nets * each)
    if n < 4:
        raise ParameterError(
            f"A budget of {budget} evaluations is too small where each point takes {each}; give at least "
            f"{math.ceil(4 * FEW_NETS * each / share)}."
        )
    n = 1 << (n.bit_length() - 1)
    return each, n, min(int(share * budget) // (n * each), 2 * nets)


def technique_name(estimator: AbstractEstimator, technique: int) -> str:
    """Its own name where techniques have some, else its number."""
    return str(getattr(estimator, "technique_name", lambda t: f"technique {t}")(technique))


def _wrong_pdf(seen: Evidence) -> Cause | None:
    for density in getattr(seen.estimator, "densities", None) or [
        getattr(seen.estimator, "density", None)
    ]:
        try:
            if density is not None:
                density.check()
        except DensityError as error:
            u = as_sampler(NETS, density.primary_dims).draw(_SEEN_OF_PDF)[0]
            with np.errstate(all="ignore"):
                found = float((1.0 / density.pdf(density.sample(u))).mean())
            return Cause(
                "wrong-pdf",
                f"{error} Every estimate is biased by it: that of a constant, 1, is {found:.4g}.",
                {"of_one": found},
            )
    if not seen.missed:
        return None
    return Cause(
        "wrong-pdf",
        f"The pdf is 0 at {seen.missed}, where f is not: every estimate misses that part.",
    )


def _noisy_function(seen: Evidence) -> Cause | None:
    if not seen.noise:
        return None
    share = min(seen.noise / max(seen.scale**2, 1e-300), 1.0)
    return Cause(
        "noisy-function",
        f"g has other values at the same point: random numbers of its own make about {share:.2g} of its variance, "
        "which falls as 1/n with any points. Take them from further dims of the points.",
        {"share": share},
    )


def _infinite_variance(seen: Evidence) -> Cause | None:
    # Where no pole was climbed to, the bends of lines tell of one, less well
    poles = np.concatenate([lines.poles() for lines in seen.lines])
    order = -float(np.median(seen.each("exponent")[poles])) if poles.any() else 0.0
    found = [(seen.growth, 0.02, f"grows as t^−{seen.growth:.2f} at the border", True)]
    if seen.pole is None:
        found.append((order, 0.08, f"has a pole of order {order:.2f} inside", False))
    else:
        found.append((seen.pole.tail, 0.02, _said(seen.pole), seen.pole.border))
    for index, near, what, border in found:
        if index >= _HALF - near:
            said = (
                "from ½ on ∫g² is infinite: errors fall more slowly than n^−½ and no interval holds"
            )
            said = "from 1 on it has no integral" if index >= _ALL else said
            return Cause(
                "infinite-variance",
                f"g {what}, and {said}.",
                {"exponent": index},
                ("fitted", "warp") if border and index < _ALL else (),
            )
    if seen.estimator.infinite_weights and _tail(seen)[1] > _HALF:
        return Cause(
            "infinite-variance",
            f"1/p has no bound, and the tail index of the estimates is {_tail(seen)[1]:.2f}: from ½ on "
            "the variance is infinite.",
            {"tail_index": _tail(seen)[1]},
            ("warp", "fitted"),
        )
    return None


def _said(pole: Pole) -> str:
    """What g does at a pole, with its tail index."""
    k, d = pole.codimension, len(pole.place)
    where = "a point" if k == d else f"a set of {d - k} dims"
    side = "of the border" if pole.border else "inside"
    if pole.exponent == 0.0:
        return f"grows without bound, as a logarithm, towards places {side}"
    index = f", a tail index of {pole.exponent:.2f}/{k}" if k > 1 else ""
    return f"grows as r^−{pole.exponent:.2f} with the distance r to {where} {side}{index}"


def _tail(seen: Evidence) -> tuple[float, float, float]:
    """Share of the largest square, tail index and kurtosis of the values of g."""
    values = seen.sets.pooled
    squares = (values - values.mean()) ** 2
    total = float(squares.sum())
    if total == 0.0:
        return 0.0, 0.0, 3.0
    index = float(Moments.of(values, tails=True).tail_index)
    return float(squares.max()) / total, index, float((squares**2).mean() / squares.mean() ** 2)


def _heavy_tail(seen: Evidence) -> Cause | None:
    share, index, kurtosis = _tail(seen)
    pole = seen.pole
    inside = bool(np.concatenate([lines.poles() for lines in seen.lines]).any())
    if pole is not None:
        inside = not pole.border
    few = _sorted_share(seen.sets.pooled)
    if not (share > _LARGE or (kurtosis > _HEAVY and few < _FEW) or inside):
        return None
    found = "" if not inside else "g has a pole inside. " if pole is None else f"g {_said(pole)}. "
    said = (
        f"Few evaluations make the variance: {100 * few:.2g} % of them hold nine tenths of it (kurtosis "
        f"{kurtosis:.3g}, tail index {index:.2f}), so that most sets miss what matters."
    )
    evidence = {
        "largest_share": share,
        "tail_index": index,
        "kurtosis": kurtosis,
        "nine_tenths": few,
    }
    if inside and pole is not None:
        evidence["exponent"] = pole.tail
    return Cause("heavy-tail", f"{found}{said}", evidence, ("fitted", "warp"))


def _sorted_share(values: Array) -> float:
    """Share of the values that make nine tenths of the variance."""
    squares = np.sort((values - values.mean()) ** 2)[::-1].cumsum()
    return float(np.searchsorted(squares, 0.9 * squares[-1]) + 1) / len(values)


def _deterministic(seen: Evidence) -> Cause | None:
    fixed = seen.estimator.randomized(seen.sampler).fixed
    if not fixed and (seen.replicates is None or seen.replicates.different > 1):
        return None
    return Cause(
        "deterministic-set",
        f"{seen.sampler.spec} is the same set every time: its error is a bias that no spread shows. Add owen "
        "or shift.",
        {"different": 1.0},
        ("sampler",),
    )


def sets_of(sampler: Sampler) -> float:
    """How many sets of an n a sampler has: no end of them, but of points that are given."""
    if isinstance(sampler, GivenPoints) and not sampler.cycle:
        return min(map(len, sampler.sets.values()))
    return math.inf


def _few_realizations(seen: Evidence) -> Cause | None:
    count = sets_of(seen.sampler)
    if count >= _FEW_SETS:
        return None
    from scipy.stats import chi2

    low, high = 0.0, math.inf
    if count > 1:
        low, high = ((count - 1) / float(chi2.ppf(q, count - 1)) for q in (0.975, 0.025))
    return Cause(
        "few-realizations",
        f"{seen.sampler.spec} has {count} sets, whose spread tells the variance to a factor of {low:.2g} to "
        f"{high:.2g} only.",
        {"realizations": float(count), "low": low, "high": high},
    )


def _correlated(seen: Evidence) -> Cause | None:
    made = seen.replicates
    if made is None or not made.different > 1 or len(made.waves) < _FEW_SETS:
        return None
    count, sampler = len(made.waves), seen.sampler.spec
    if made.different < count:
        return Cause(
            "correlated-replicates",
            f"Only {made.different} of {count} sets of {sampler} are different: their spread says less than "
            "it seems.",
            {"different": float(made.different), "realizations": float(count)},
        )
    mean, spread = made.waves.mean(axis=0), made.waves.std(axis=0, ddof=1)
    varies = spread > _ROUNDING
    rest = (made.waves[:, varies] - mean[varies]) / spread[varies]
    serial = float((rest[1:] * rest[:-1]).sum()) / max(rest.size, 1)
    if serial > _SERIAL / math.sqrt(count * seen.sets.dims):
        return Cause(
            "correlated-replicates",
            f"Each set of {sampler} is like the one before: the correlation of their means is {serial:.2f}.",
            {"correlation": serial, "realizations": float(count)},
        )
    away = mean[varies] / spread[varies] * math.sqrt(count)
    found, nets = made.estimates, seen.sets.estimates
    if len(found) >= _FEW_SETS and found.std() > _GRAINS * grain(found):
        error = math.sqrt(found.var(ddof=1) / len(found) + nets.var(ddof=1) / len(nets))
        away = np.append(away, (found.mean() - nets.mean()) / error)
    most = float(np.abs(away).max(initial=0.0))
    if most < _AWAY:
        return None
    return Cause(
        "correlated-replicates",
        f"Means of sets of {sampler} are {most:.2g} standard errors away from those of uniform points: the sets "
        "share an error, or their points are not uniform.",
        {"away": most, "realizations": float(count)},
    )


def _float_drift(seen: Evidence) -> Cause | None:
    values = seen.sets.pooled
    step, single = grain(values), values.astype(np.float32)
    drift = 0.0
    if (single == values).all():
        drift = abs(float(single.cumsum(dtype=np.float32)[-1]) / len(single) - float(values.mean()))
    curve = seen.curves.get(seen.sampler.spec, seen.curves["random"])
    error = math.sqrt(curve.at(len(values))[0])
    if seen.scale == 0.0:
        return None
    rounded = step > COARSE * seen.scale
    if not rounded and (error == 0.0 or drift <= error):
        return None
    return Cause(
        "float-drift",
        f"Values of g are rounded to steps of {step:.2g}, {step / seen.scale:.2g} of their spread: compute "
        "differences before sums, in float64."
        if rounded
        else f"Values of g are of float32: a running sum of {len(values)} of them in float32 is off by "
        f"{drift:.2g} in the mean, beside an RMSE of {error:.2g}. Sum in float64.",
        {"step": step, "drift": drift, "rmse": error},
    )


def _slow_technique(seen: Evidence) -> Cause | None:
    curves = seen.sets.technique_curves()
    if len(curves) < 2:
        return None
    n = seen.sets.n
    parts = np.array([curve.at(n)[0] for curve in curves])
    worst = int(np.argmax(parts))
    share = float(parts[worst] / parts.sum()) if parts.sum() > 0 else 0.0
    others = [curve for t, curve in enumerate(curves) if t != worst]
    slower = all(
        curves[worst].rate - c.rate > 2 * math.hypot(curves[worst].rate_se, c.rate_se)
        for c in others
    )
    if share < 0.8 and not (slower and share > 0.5):
        return None
    name = technique_name(seen.estimator, worst)
    return Cause(
        "slow-technique",
        f"{name} makes {100 * share:.0f} % of the variance at n = {n} with {NETS}, and its rate is "
        f"{curves[worst].rate:.2f}.",
        {"share": share, "technique": float(worst), "rate": curves[worst].rate},
        ("heuristic", "techniques", "warp"),
    )


def _jumps(seen: Evidence) -> Cause | None:
    meets = np.concatenate([lines.jumps(seen.scale) for lines in seen.lines])
    if seen.pole is not None and not seen.pole.border:  # about which lines bend as at a jump
        meets &= seen.pole.codimension > 1
    height = seen.each("height")
    alike = len(np.unique(seen.sets.pooled))
    if not meets.any():
        if not 1 < alike <= _ALIKE * seen.sets.pooled.size:
            return None
        return Cause(
            "interior-jump",
            f"g takes {alike} values only, so that it jumps, though no line that was looked at met it.",
            {"values": float(alike)},
            ("preintegrated", "smoothed"),
        )
    size = float(np.median(height[meets])) / max(seen.scale, 1e-300)
    share = float(meets.mean())
    along = seen.each("axis") >= 0
    rough = meets & along
    if not rough.any():  # told only by chords from what is steep beside it
        rough = along & np.concatenate([lines.kinks() for lines in seen.lines])
    straight = rough.any() and seen.each("straight")[rough].mean() > _STRAIGHT
    evidence = {"met_by": share, "height": size}
    met = f"{100 * share:.0f} % of all lines through the cube meet a jump of g, by {size:.2g} of its spread"
    if straight or seen.sets.dims == 1:
        return Cause(
            "axis-parallel-jump",
            f"{met}, always across planes normal to an axis: a border of strata there takes it away.",
            evidence,
            ("aligned", "smoothed", "preintegrated"),
        )
    return Cause(
        "interior-jump",
        f"{met}: strata that it crosses keep their noise, and the variance of stratified points tends to "
        f"n^−{1.0 + 1.0 / seen.sets.dims:.3g} at best.",
        evidence,
        ("preintegrated", "smoothed", "aligned"),
    )


def _border_jump(seen: Evidence) -> Cause | None:
    if not seen.wraps:
        return None
    ends = seen.each("ends")
    ends = ends[np.isfinite(ends)]
    size = float(np.mean(ends**2)) / max(seen.scale**2, 1e-300) if ends.size else 0.0
    if not size > _OPPOSITE:
        return None
    return Cause(
        "border-jump",
        f"g differs between opposite faces by {math.sqrt(size):.2g} of its spread, and "
        f"{seen.sampler.spec} wraps around: to it g jumps there.",
        {"difference": math.sqrt(size)},
        ("unshifted", "mirrored", "sampler"),
    )


def _border_growth(seen: Evidence, *, slow: bool) -> Cause | None:
    pole = seen.pole if seen.pole is not None and seen.pole.border else None
    index = max(pole.tail if pole else 0.0, seen.growth)
    if (index <= _GROWS) != slow or (pole is None and not index):
        return None
    said = f"grows without bound at the border, about as t^−{index:.2f}"
    if pole is not None and (slow or seen.growth <= _GROWS):
        said = _said(pole)
    what = "those of bounded functions have not" if slow else "no refinement inside removes"
    return Cause(
        "border-growth",
        f"g {said}: the outermost strata keep noise that {what}.",
        {"slow_exponent" if slow else "exponent": index},
        ("fitted", "warp"),
    )


def _high_frequency(seen: Evidence) -> Cause | None:
    share = seen.each("spread")
    turns, waves = (
        seen.each(name) @ share / max(share.sum(), 1e-300) for name in ("turns", "waves")
    )
    varies = (seen.each("turns") > _TURNS) & (share > COARSE * share.max(initial=0.0))
    axes = len(np.unique(seen.each("axis")[varies & (seen.each("axis") >= 0)]))
    nets, random = seen.curves[NETS], seen.curves["random"]
    gains = np.array([random.at(n)[0] / nets.at(n)[0] for n in nets.counts])
    seeing = nets.counts[gains > _RESOLVED]
    needed = float(seeing[0]) if len(seeing) else math.inf
    if not (turns > _TURNS and waves > _WAVES and needed > _COARSE_CUBE * 2.0**axes):
        return None
    if math.isinf(needed):
        needed = max((4.0 * waves) ** max(axes, 1), 2.0 * seen.sets.n)
    return Cause(
        "high-frequency",
        f"g goes up and down about {waves:.2g} times along a line: sets of fewer than about {needed:,.2g} points "
        "do not see this order, and are no better than random points.",
        {"waves": float(waves), "resolved_by": float(needed)},
        ("sampler",),
    )


def _high_dimension(seen: Evidence) -> Cause | None:
    d = seen.sets.dims
    if d < 4:
        return None
    n = seen.sets.n
    nets, random = seen.curves[NETS], seen.curves["random"]
    mean = min(seen.mean_dimension, float(d))
    gain = random.at(n)[0] / max(nets.at(n)[0], 1e-300)
    if gain > _LITTLE_GAIN or not mean > _MOST_DIMENSION:
        return None
    return Cause(
        "high-dimension",
        f"g varies with about {mean:.1f} of its {d} dims at once, which {n} points cannot fill: the best "
        f"sets have {gain:.2g} times less variance than random points.",
        {"mean_dimension": mean, "gain": gain},
        ("order", "regression", "preintegrated"),
    )


def _kink(seen: Evidence) -> Cause | None:
    kinks = np.concatenate([lines.kinks() for lines in seen.lines])
    if not kinks.any():
        return None
    return Cause(
        "kink",
        f"{100 * kinks.mean():.0f} % of all lines through the cube meet a kink of g: it is continuous, but "
        "sets gain less from smoothness than they could.",
        {"met_by": float(kinks.mean())},
        ("smoothed", "preintegrated"),
    )


CAUSES: tuple[Callable[[Evidence], Cause | None], ...] = (
    _wrong_pdf,
    _noisy_function,
    _infinite_variance,
    _deterministic,
    _few_realizations,
    _correlated,
    _float_drift,
    _slow_technique,
    _heavy_tail,
    _jumps,
    _border_jump,
    partial(_border_growth, slow=False),
    _high_frequency,
    _high_dimension,
    _kink,
    partial(_border_growth, slow=True),
)
"""All detectors."""


def causes_of(seen: Evidence) -> list[Cause]:
    """All causes that are found, at least one: `none` where nothing is."""
    found = [cause for detect in CAUSES if (cause := detect(seen)) is not None]
    names = {cause.name for cause in found}
    # Steps between numbers are no jumps, and noise has no shape
    if "float-drift" in names:
        found = [c for c in found if c.name not in {"interior-jump", "axis-parallel-jump"}]
    if "noisy-function" in names:
        found = [c for c in found if c.name in _SHAPELESS]
    # What is left of a tail is said by its cause
    if names & {"infinite-variance", "border-growth"}:
        found = [c for c in found if c.name != "heavy-tail"]
    # Few values matter because many dims must agree or g is 0 beyond a plane, unless very few do
    heavy = next((c for c in found if c.name == "heavy-tail"), None)
    if (
        heavy is not None
        and names & {"high-dimension", "axis-parallel-jump"}
        and heavy.evidence["nine_tenths"] > _VERY_FEW
    ):
        found = sorted(found, key=lambda c: c.name == "heavy-tail")
    if found:
        return found
    # Half of what is wrong shows on lines alone
    looked = len(seen.each("axis"))
    if looked < _LOOKED:
        return [
            Cause(
                "few-realizations",
                f"Nothing was found that costs precision, but {looked or 'no'} line{'s' * (looked != 1)} through the "
                f"cube {'were' if looked != 1 else 'was'} looked at: give {math.ceil(_LOOKED / max(looked, 1))} times the evaluations.",
                {"lines": float(looked)},
            )
        ]
    return [
        Cause("none", "Nothing was found that costs precision: g is smooth, and its sets show it.")
    ]
