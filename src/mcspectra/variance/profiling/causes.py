"""What can be wrong with an estimator: each cause has a detector, evidence in numbers and a sentence.

Detectors look at what was evaluated (`Evidence`), evaluate nothing, and yield causes. They follow each other
in the order of what hurts most; what is found is listed in that order.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import DensityError
from mcspectra.estimators import AbstractEstimator, Moments
from mcspectra.samplers import GivenPoints, Random, Sampler, Shift, as_sampler
from mcspectra.spectra.bases import parts_of
from mcspectra.variance.profiling.lines import COARSE, Lines, grain
from mcspectra.variance.profiling.poles import Pole
from mcspectra.variance.profiling.samples import NETS, Curve, Sets

__all__ = ["Cause", "Evidence", "Name", "Replicates", "causes_of", "sets_of"]

Name: TypeAlias = Literal[
    "wrong-pdf",
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

_HALF = 0.5  # exponent of a pole, and tail index, from which on the variance is infinite
_ALL = 0.95  # from which on there is no integral
_GROWS = 0.08  # exponent at the border
_HEAVY = 30.0  # kurtosis
_LARGE = 0.2  # of all squares, by one value
_FEW, _VERY_FEW = 0.05, 0.01  # of the values, that make nine tenths of the variance
_ALIKE = 0.05  # of all evaluations, as different values: a function in steps
_SAME = 2e-3  # along lines, of places that are the same
_TURNS = 0.33  # of the places along a line, as extremes: of noise two thirds
_WAVES = 6.0  # along a line
_RESOLVED = 4.0  # gain of nets over random points, from which on they see what g does
_COARSE_CUBE = 16.0  # times 2 for each axis: points that resolve what is smooth
_MOST_DIMENSION = 1.8
_LITTLE_GAIN = 8.0  # by nets, over random points
_OPPOSITE = 1e-3  # of the variance, by what g differs between faces
_SEEN_OF_PDF = 4096  # points
_FEW_SETS = 8
_SERIAL = 0.75  # correlation of sets that follow each other; of twenty independent ones ± 0.22
_GRAINS = 32.0  # of the numbers that estimates are: less is rounding
_AWAY = 6.0  # standard errors; by Student's t of nineteen degrees a chance of 1e-5


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
        Kinds of remedies that answer it (`mcspectra.variance.counterfactuals.KINDS`).
    """

    name: Name
    sentence: str
    evidence: Mapping[str, float] = field(default_factory=dict)
    kinds: tuple[str, ...] = ()


@final
@dataclass(frozen=True)
class Replicates:
    """Sets of a sampler at one count: the estimate of each, and how many sets are different."""

    estimates: Array
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
    """

    estimator: AbstractEstimator
    sampler: Sampler
    sets: Sets
    curves: Mapping[str, Curve]
    lines: tuple[Lines, ...]
    pole: Pole | None = None
    mean_dimension: float = math.nan
    replicates: Replicates | None = None

    @property
    def scale(self) -> float:
        """Spread of g."""
        return math.sqrt(float(self.sets.pooled.var()))

    @property
    def growth(self) -> float:
        """The largest exponent of g at the ends of lines."""
        return float(np.nanmax(self.each("growth"), initial=0.0))

    def each(self, name: str) -> Array:
        """An attribute of all lines."""
        return np.concatenate([getattr(lines, name) for lines in self.lines])


def _of_the_estimator(seen: Evidence) -> Iterator[Cause]:
    """A density that is wrong, and a variance that is infinite."""
    for density in getattr(seen.estimator, "densities", None) or [
        getattr(seen.estimator, "density", None)
    ]:
        try:
            if density is not None:
                density.check()
        except DensityError as error:
            u = as_sampler(NETS, density.primary_dims).draw(_SEEN_OF_PDF)[0]
            with np.errstate(all="ignore"):
                mean = float((1.0 / density.pdf(density.sample(u))).mean())
            yield Cause(
                "wrong-pdf",
                f"{error} Every estimate is biased by it: that of a constant, 1, is {mean:.4g}.",
                {"of_one": mean},
            )
            break

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
            yield Cause(
                "infinite-variance",
                f"g {what}, and {said}.",
                {"exponent": index},
                ("fitted", "warp") if border and index < _ALL else (),
            )
            return
    if seen.estimator.infinite_weights and _tail(seen)[1] > _HALF:
        yield Cause(
            "infinite-variance",
            f"1/p has no bound, and the tail index of the estimates is {_tail(seen)[1]:.2f}: from ½ on "
            "the variance is infinite.",
            {"tail_index": _tail(seen)[1]},
            ("warp", "fitted"),
        )


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


def sets_of(sampler: Sampler) -> float:
    """How many sets of an n a sampler has: no end of them, but of points that are given."""
    if isinstance(sampler, GivenPoints) and not sampler.cycle:
        return min(map(len, sampler.sets.values()))
    return math.inf


def _of_sets(seen: Evidence) -> Iterator[Cause]:
    """Sets of the sampler that are the same, few, or depend on each other."""
    made, spec = seen.replicates, seen.sampler.spec
    fixed = seen.estimator.randomized(seen.sampler).fixed
    if fixed or (made is not None and made.different <= 1):
        yield Cause(
            "deterministic-set",
            f"{spec} is the same set every time: its error is a bias that no spread shows. Add owen or "
            "shift.",
            {"different": 1.0},
            ("sampler",),
        )
    if (given := sets_of(seen.sampler)) < _FEW_SETS:
        from scipy.stats import chi2

        low, high = 0.0, math.inf
        if given > 1:
            low, high = ((given - 1) / float(chi2.ppf(q, given - 1)) for q in (0.975, 0.025))
        yield Cause(
            "few-realizations",
            f"{spec} has {given} sets, whose spread tells the variance to a factor of {low:.2g} to "
            f"{high:.2g} only.",
            {"realizations": float(given), "low": low, "high": high},
        )
    if made is None or not made.different > 1 or len(made.estimates) < _FEW_SETS:
        return

    found, nets, count = made.estimates, seen.sets.estimates, len(made.estimates)
    if made.different < count:
        yield Cause(
            "correlated-replicates",
            f"Only {made.different} of {count} sets of {spec} are different: their spread says less than "
            "it seems.",
            {"different": float(made.different), "realizations": float(count)},
        )
        return
    spread, mean = float(found.std(ddof=1)), float(found.mean())
    if spread <= _GRAINS * grain(found):
        return
    rest = (found - mean) / spread
    serial = float(rest[1:] @ rest[:-1]) / count
    error = math.sqrt(spread**2 / count + float(nets.var(ddof=1)) / len(nets))
    away = (mean - float(nets.mean())) / error
    if serial > _SERIAL:
        yield Cause(
            "correlated-replicates",
            f"Each set of {spec} is like the one before: the correlation of their estimates is {serial:.2f}.",
            {"correlation": serial, "realizations": float(count)},
        )
    elif not abs(away) < _AWAY:
        yield Cause(
            "correlated-replicates",
            f"The mean of {count} sets of {spec} is {abs(away):.2g} standard errors away from that of "
            f"{NETS}: they share an error, or their points are not uniform.",
            {"away": away, "realizations": float(count)},
        )


def _of_values(seen: Evidence) -> Iterator[Cause]:
    """Values that are rounded, a technique that makes them vary, few of them that matter."""
    values, scale = seen.sets.pooled, seen.scale
    step, single = grain(values), values.astype(np.float32)
    drift = 0.0
    if (single == values).all():
        drift = abs(float(single.cumsum(dtype=np.float32)[-1]) / len(single) - float(values.mean()))
    curve = seen.curves.get(seen.sampler.spec, seen.curves["random"])
    error = math.sqrt(curve.at(len(values))[0])
    rounded = step > COARSE * scale
    if scale > 0.0 and (rounded or (error > 0.0 and drift > error)):
        yield Cause(
            "float-drift",
            f"Values of g are rounded to steps of {step:.2g}, {step / scale:.2g} of their spread: compute "
            "differences before sums, in float64."
            if rounded
            else f"Values of g are of float32: a running sum of {len(values):,} of them in float32 is off by "
            f"{drift:.2g} in the mean, beside an RMSE of {error:.2g}. Sum in float64.",
            {"step": step, "drift": drift, "rmse": error},
        )

    curves, n = seen.sets.technique_curves(), seen.sets.n
    if len(curves) > 1:
        parts = np.array([curve.at(n)[0] for curve in curves])
        worst = int(np.argmax(parts))
        share = float(parts[worst] / parts.sum()) if parts.sum() > 0 else 0.0
        slow, others = curves[worst], [curve for t, curve in enumerate(curves) if t != worst]
        slower = all(slow.rate - c.rate > 2 * math.hypot(slow.rate_se, c.rate_se) for c in others)
        if share >= 0.8 or (slower and share > 0.5):
            name = getattr(seen.estimator, "technique_name", lambda t: f"technique {t}")(worst)
            yield Cause(
                "slow-technique",
                f"{name} makes {100 * share:.0f} % of the variance at n = {n} with {NETS}, and its rate is "
                f"{slow.rate:.2f}.",
                {"share": share, "technique": float(worst), "rate": slow.rate},
                ("heuristic", "techniques", "warp"),
            )

    largest, index, kurtosis = _tail(seen)
    pole = seen.pole
    inside = bool(np.concatenate([lines.poles() for lines in seen.lines]).any())
    if pole is not None:
        inside = not pole.border
    # Share of the values that make nine tenths of the variance
    squares = np.sort((values - values.mean()) ** 2)[::-1].cumsum()
    few = float(np.searchsorted(squares, 0.9 * squares[-1]) + 1) / len(values)
    if largest > _LARGE or (kurtosis > _HEAVY and few < _FEW) or inside:
        said = (
            "" if not inside else "g has a pole inside. " if pole is None else f"g {_said(pole)}. "
        )
        evidence = {
            "largest_share": largest,
            "tail_index": index,
            "kurtosis": kurtosis,
            "nine_tenths": few,
        }
        if inside and pole is not None:
            evidence["exponent"] = pole.tail
        yield Cause(
            "heavy-tail",
            f"{said}Few evaluations make the variance: {100 * few:.2g} % of them hold nine tenths of it "
            f"(kurtosis {kurtosis:.3g}, tail index {index:.2f}), so that most sets miss what matters.",
            evidence,
            ("fitted", "warp"),
        )


def _of_jumps(seen: Evidence) -> Iterator[Cause]:
    """Jumps inside, and between opposite faces."""
    meets = np.concatenate([lines.jumps(seen.scale) for lines in seen.lines])
    if seen.pole is not None and not seen.pole.border:  # about which lines bend as at a jump
        meets &= seen.pole.codimension > 1
    axis, place, height = (seen.each(name) for name in ("axis", "place", "height"))
    alike, dims = len(np.unique(seen.sets.pooled)), seen.sets.dims
    if meets.any():
        size = float(np.median(height[meets])) / max(seen.scale, 1e-300)
        share = float(meets.mean())
        straight = []  # whether most places along lines of an axis are shared by several lines
        for i in range(dims):
            own = place[meets & (axis == i)]
            if len(own) > 1:  # a single one says nothing
                near = np.abs(own[:, None] - own) < _SAME
                straight.append(bool((near.sum(axis=1) > 1).mean() > 0.7))
        evidence = {"met_by": share, "height": size}
        met = f"{100 * share:.0f} % of all lines through the cube meet a jump of g, by {size:.2g} of its spread"
        if (straight and all(straight)) or dims == 1:
            yield Cause(
                "axis-parallel-jump",
                f"{met}, always across planes normal to an axis: a border of strata there takes it away.",
                evidence,
                ("aligned", "smoothed", "preintegrated"),
            )
        else:
            yield Cause(
                "interior-jump",
                f"{met}: strata that it crosses keep their noise, and the variance of stratified points tends "
                f"to n^−{1.0 + 1.0 / dims:.3g} at best.",
                evidence,
                ("preintegrated", "smoothed", "aligned"),
            )
    elif 1 < alike <= _ALIKE * seen.sets.pooled.size:
        yield Cause(
            "interior-jump",
            f"g takes {alike} values only, so that it jumps, though no line that was looked at met it.",
            {"values": float(alike)},
            ("preintegrated", "smoothed"),
        )

    # A sampler that shifts points around the torus sees them, if their order matters
    base, steps = parts_of(seen.sampler)
    if isinstance(base, Random) or not any(isinstance(step, Shift) for step in steps):
        return
    ends = seen.each("ends")
    ends = ends[np.isfinite(ends)]
    size = float(np.mean(ends**2)) / max(seen.scale**2, 1e-300) if ends.size else 0.0
    if size > _OPPOSITE:
        yield Cause(
            "border-jump",
            f"g differs between opposite faces by {math.sqrt(size):.2g} of its spread, and "
            f"{seen.sampler.spec} wraps around: to it g jumps there.",
            {"difference": math.sqrt(size)},
            ("unshifted", "mirrored", "sampler"),
        )


def _of_roughness(seen: Evidence) -> Iterator[Cause]:
    """Growth at the border, waves, many dims, kinks; growth that is slow comes last."""
    pole = seen.pole if seen.pole is not None and seen.pole.border else None
    index = max(pole.tail if pole else 0.0, seen.growth)
    slow, said = index <= _GROWS, f"grows without bound at the border, about as t^−{index:.2f}"
    if pole is not None and (slow or seen.growth <= _GROWS):
        said = _said(pole)
    what = "those of bounded functions have not" if slow else "no refinement inside removes"
    grows = Cause(
        "border-growth",
        f"g {said}: the outermost strata keep noise that {what}.",
        {"slow_exponent" if slow else "exponent": index},
        ("fitted", "warp"),
    )
    if not slow:
        yield grows

    share = seen.each("spread")
    turns, waves = (
        seen.each(name) @ share / max(share.sum(), 1e-300) for name in ("turns", "waves")
    )
    varies = (seen.each("turns") > _TURNS) & (share > COARSE * share.max(initial=0.0))
    axes = len(np.unique(seen.each("axis")[varies & (seen.each("axis") >= 0)]))
    nets, random, n, d = seen.curves[NETS], seen.curves["random"], seen.sets.n, seen.sets.dims
    gains = np.array([random.at(n)[0] / nets.at(n)[0] for n in nets.counts])
    seeing = nets.counts[gains > _RESOLVED]
    needed = float(seeing[0]) if len(seeing) else math.inf
    if turns > _TURNS and waves > _WAVES and needed > _COARSE_CUBE * 2.0**axes:
        if math.isinf(needed):
            needed = max((4.0 * waves) ** max(axes, 1), 2.0 * n)
        yield Cause(
            "high-frequency",
            f"g goes up and down about {waves:.2g} times along a line: sets of fewer than about {needed:,.2g} "
            "points do not see this order, and are no better than random points.",
            {"waves": float(waves), "resolved_by": float(needed)},
            ("sampler",),
        )

    if d >= 4:
        mean = min(seen.mean_dimension, float(d))
        gain = random.at(n)[0] / max(nets.at(n)[0], 1e-300)
        if mean > _MOST_DIMENSION and not gain > _LITTLE_GAIN:
            yield Cause(
                "high-dimension",
                f"g varies with about {mean:.1f} of its {d} dims at once, which {n} points cannot fill: the "
                f"best sets have {gain:.2g} times less variance than random points.",
                {"mean_dimension": mean, "gain": gain},
                ("order", "regression", "preintegrated"),
            )
    kinks = np.concatenate([lines.kinks() for lines in seen.lines])
    if kinks.any():
        yield Cause(
            "kink",
            f"{100 * kinks.mean():.0f} % of all lines through the cube meet a kink of g: it is continuous, but "
            "sets gain less from smoothness than they could.",
            {"met_by": float(kinks.mean())},
            ("smoothed", "preintegrated"),
        )
    if slow and (pole is not None or index):
        yield grows


def causes_of(seen: Evidence) -> list[Cause]:
    """All causes that are found, at least one: `none` where nothing is."""
    detectors = (_of_the_estimator, _of_sets, _of_values, _of_jumps, _of_roughness)
    found = [cause for detect in detectors for cause in detect(seen)]
    names = {cause.name for cause in found}
    # Steps between numbers are no jumps
    if "float-drift" in names:
        found = [c for c in found if c.name not in {"interior-jump", "axis-parallel-jump"}]
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
    return found or [
        Cause("none", "Nothing was found that costs precision: g is smooth, and its sets show it.")
    ]
