"""Causes of noise in an estimator. Each cause has a detector, evidence as numbers, and a sentence.

`Evidence.of` evaluates the integrand. Detectors do not evaluate it again.
Each detector takes the evidence, and returns a `Cause` or None.
`CAUSES` lists the detectors, beginning with the most harmful cause.
`causes_of` returns the detected causes, the most harmful cause first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.core.errors import BudgetError, DensityError, ParameterError, point_in_words
from mcspectra.core.streams import Stream
from mcspectra.densities.base import FunctionDensity
from mcspectra.estimators import AbstractEstimator, Estimator, Mirrored
from mcspectra.estimators.moments import Moments
from mcspectra.estimators.support import uncovered
from mcspectra.explain.probing import (
    LINE_SETTINGS,
    POLE_SETTINGS,
    Lines,
    LineSettings,
    Pole,
    PoleSettings,
    grain,
    lines_of,
    mean_dimension,
    pole_of,
)
from mcspectra.explain.samples import CURVE_SETTINGS, NETS, Curve, CurveSettings, Sets, scalar
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.samplers import law as laws

__all__ = [
    "CAUSES",
    "CAUSE_SETTINGS",
    "Cause",
    "CauseSettings",
    "Evidence",
    "Name",
    "Replicates",
    "as_slow_as_a_jump",
    "causes_of",
    "is_apart",
    "shares_of",
    "technique_name",
]

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
    "cusp",
    "kink",
    "float-drift",
    "correlated-replicates",
    "stuck-chain",
    "burn-in",
    "none",
]


@final
@dataclass(frozen=True)
class CauseSettings:
    """Fractions of a budget of evaluations, and thresholds above which causes are reported.

    Comments on settings refer to the 152 test cases of ``python -m benchmarks settings``.
    With the settings below, profiles find the right first cause in all 152 cases.
    If a comment gives results for other values of a setting, only this setting was changed.
    A test case gets a wrong cause if the first cause of its profile is not the right one.
    """

    # Least number of scrambled nets at which the integrand is evaluated.
    # A variance estimated from 20 normal values has a relative standard error of a third.
    # With 40 nets of half the size, one of 152 test cases gets a wrong cause.
    # All test cases get the right cause with 10 nets instead of 20.
    nets: int = 20
    # With a larger budget of evaluations, the number of nets grows as the budget's square root.
    # Nets then have 512 points or more, so a curve of variance covers ten or more counts of points.
    # Beyond ten counts, more nets improve the measured rate more than larger nets do.
    more_from: int = 16384
    # Fraction of the budget that is spent on lines through g and on the search for poles.
    # All test cases get the right cause with a fraction from 0.1 to 0.4.
    lines_share: float = 0.2
    # Fraction of the budget that is left to check a change of the estimator.
    # All test cases get the right cause with a fraction from 0.075 to 0.15.
    # With 0.3, too few evaluations are left for nets, and one test case gets a wrong cause.
    check_share: float = 0.15
    # Fraction of the budget for the given sampler, if nets cannot estimate its variance.
    # If the given sampler gets this fraction, scrambled nets get 40 % of the budget.
    # All test cases get the right cause with a fraction from 0.125 to 0.5.
    given_share: float = 0.25
    # Largest fraction of `lines_share` that the search for a pole may spend. Lines get the rest.
    # All test cases get the right cause with a fraction from 0.4 to 0.8.
    # If the pole search leaves no evaluations for lines, four test cases get a wrong cause.
    pole_share: float = 0.8
    # Fraction of `lines_share` that is spent on an estimate of the mean dimension of g.
    # All test cases get the right cause with a fraction from 0.125 to 0.25.
    # With 0.5, fewer evaluations are left for lines, and four test cases get a wrong cause.
    dimension_share: float = 0.25
    # Number of points at which g is evaluated a second time, to detect random values.
    # A function that is random at half of all points is detected with probability 1 − 2^−8 = 0.996.
    again: int = 8
    # Two values at a point are equal if their relative difference is below this number.
    # Sums of 1e6 terms in float64 have smaller rounding errors than 1e-6, in any order.
    # Sums of a few terms in float32 also have smaller rounding errors than 1e-6.
    same_value: float = 1e-6
    # In many dims, a pole is searched for only if one value of g is an outlier.
    # The largest squared deviation of g from its mean must exceed the variance by this factor.
    # All test cases get the right cause with a factor from 150 to 600.
    climbed: float = 300.0
    # Smallest and largest allowed size of g.
    # Sums of squares of numbers within these limits stay in the range of float64.
    smallest: float = 1e-120
    largest: float = 1e120
    # Least number of dims in which the mean dimension is estimated.
    # In 1 to 3 dims, nets resolve the interactions of all axes well enough.
    # All test cases get the right cause with 4 to 8 dims. With 2 dims, one gets a wrong cause.
    many_dims: int = 4
    # Number of points for which the joint distribution of a sampler's points is examined.
    # With 32 and 128 points, the examination gives the same result as with 64 points.
    law_at: int = 64
    # Error of a measured exponent of growth. The variance is infinite for exponents above ½.
    # Exponents above 0.48, which is ½ minus the error, are also reported as infinite variance.
    # In all 18 test cases with a pole, the measured exponent has an error of at most 0.02.
    # All test cases get the right cause with an error from 0.01 to 0.04.
    exponent_error: float = 0.02
    # Error of the exponent of a pole inside the cube if only lines through the cube found the pole.
    # All test cases get the right cause with an error from 0.04 to 0.16.
    bend_error: float = 0.08
    # Tail index of g above which the integral of g does not exist. In theory the limit is 1.
    # For a pole of order 1, the measured tail index is 0.95 or more.
    # The limit of the tail index affects only the sentence on the cause and the remedies.
    no_integral: float = 0.95
    # If g grows at the border with an exponent above this value, the growth is a main cause.
    # Growth of g with an exponent below this value is listed after all other causes.
    # With an exponent of 0.04 as the limit, two test cases get a wrong cause.
    # All test cases get the right cause with a limit from 0.08 to 0.16.
    grows: float = 0.08
    # Kurtosis of g above which a tail is heavy, if few values hold most of the variance.
    # The kurtosis is 3 for normal, 9 for exponential, and 114 for lognormal values with σ = 1.
    # All test cases get the right cause with a kurtosis from 15 to 60 as the limit.
    heavy_kurtosis: float = 30.0
    # A tail is also heavy if a single value has more than this fraction of the sum of squares.
    # All test cases get the right cause with a fraction from 0.1 to 0.4.
    # Warnings about unresolved tails use the same fraction (`measure/blindness.py`).
    large_share: float = 0.2
    # The tail is judged by the fraction of the values that hold nine tenths of the variance.
    # A tail is heavy if this fraction is below `few_values`,
    # and the tail is the main cause of noise if the fraction is below `very_few_values`.
    # All test cases get the right cause with `few_values` from 0.025 to 0.1.
    # All test cases get the right cause with `very_few_values` from 0.005 to 0.01.
    # With `very_few_values` = 0.02, two test cases get a wrong cause.
    few_values: float = 0.05
    very_few_values: float = 0.01
    # Largest number of different values of a step function, as a fraction of all evaluations.
    # All test cases get the right cause with a fraction from 0.025 to 0.1.
    few_different: float = 0.05
    # Least number of lines from which a profile concludes that g has no problem.
    # If half of all lines cross a feature of g, 4 lines miss the feature with probability 1/16.
    # All test cases get the right cause with 2 to 8 lines.
    least_lines: int = 4
    # Largest number of dims in which the rate of nets shows a jump that all lines missed.
    # In more dims, nets of few points have the rate of a jump although g is smooth.
    smooth_dims: int = 3
    # Standard error of the theoretical rates of nets, which hold for large n.
    smooth_error: float = 0.08
    # Of the jumps that lines cross, the fraction that seems to lie on planes normal to an axis.
    # Above this limit, the discontinuity of g is reported as parallel to axes.
    # All test cases get the right cause with a limit from 0.35 to 0.7.
    # With a limit above 1, no discontinuity is reported as parallel to an axis.
    straight: float = 0.7
    # Least ratio of the number of lines with a jump to the number of lines with a cusp.
    # If jumps are much rarer than cusps, each apparent jump may in fact be a cusp.
    # One line in 100 through a cusp of order ½ appears to be a jump by chance.
    jumps_of_cusps: float = 0.05
    # The function oscillates if more than this fraction of places along a line are local extremes.
    # For noise, ⅔ of all places are local extremes.
    # All test cases get the right cause with a fraction from 0.165 to 0.33.
    # Four test cases get a wrong cause with a fraction of ⅔.
    turns: float = 0.33
    # Least number of waves along a line at which g is called oscillating.
    # The 16 steps along a line resolve functions with fewer than 6 waves.
    # All test cases get the right cause with 3 to 12 waves as the limit.
    waves: float = 6.0
    # Nets resolve g if their variance is lower than that of random points by this factor.
    # All test cases get the right cause with a factor from 2 to 8.
    resolved: float = 4.0
    # Number of points that resolve a smooth function that does not oscillate.
    # The number of points is doubled for each axis along which g oscillates.
    # All test cases get the right cause with 8 to 32 points.
    coarse_cube: float = 16.0
    # Mean dimension above which g varies with many axes at once.
    # The mean dimension is 1 for additive functions, and 2 for functions of pairs of axes.
    # All test cases get the right cause with a mean dimension from 0.9 to 3.6.
    low_dimension: float = 1.8
    # Many dims are not a problem if nets have less variance than random points by this factor.
    # All test cases get the right cause with a factor from 4 to 16.
    little_gain: float = 8.0
    # A random shift of the points adds variance if g differs between opposite faces of the cube.
    # The limit applies to the mean squared difference of g, divided by the variance of g.
    # All test cases get the right cause with a limit from 5e-4 to 2e-3.
    opposite: float = 1e-3
    # Number of points at which 1/p is averaged if the pdf p does not match its samples.
    # If 1/p is smooth, a net of 4096 points gives four correct digits, as many as are printed.
    # The number of points has no effect on which causes are reported.
    pdf_points: int = 4096
    # Least number of sets from which a variance is estimated.
    # With 95 % confidence, 8 sets determine the variance within the factors 0.44 and 4.1.
    few_sets: int = 8
    # Limits of two tests. A deviation of more standard errors than the limit is not due to chance.
    # The correlation between consecutive sets exceeds 4.5 standard errors with probability 3e-6.
    # The mean over sets deviates by more than 6 standard errors with probability 1e-5,
    # according to Student's t distribution with 19 degrees of freedom.
    serial: float = 4.5
    away: float = 6.0
    # Means over sets count as equal if their standard deviation is below this value.
    # Rounding of means is about 1e-16.
    # Means of x along an axis over scrambled nets have the standard deviation 0.29 n^−1.5.
    # The standard deviation 0.29 n^−1.5 is above 1e-9 for up to 400,000 points.
    rounding: float = 1e-9
    # Rounding of g is a cause of noise if its steps exceed this fraction of the spread of g.
    # Rounding g to steps of 1 % of its spread changes the variance by 1e-5.
    # The fraction `coarse` also selects the lines on which g may oscillate:
    # the variance along a line must exceed this fraction of the largest variance along any line.
    # All test cases get the right cause with a fraction from 0.005 to 0.02.
    coarse: float = 1e-2
    # A technique of MIS can be a cause if its part of the variance is large.
    # Any technique with more than the fraction `dominant` of the variance is reported.
    # The technique with the slowest rate is reported if its fraction exceeds `largest_part`.
    # All test cases get the right cause with `dominant` from 0.4 to 1.6.
    # All test cases get the right cause with `largest_part` from 0.25 to 1.
    dominant: float = 0.8
    largest_part: float = 0.5
    # Rates of two techniques are different if they are this many standard errors apart.
    # Two standard errors give a confidence of 95 %.
    slower: float = 2.0
    # Settings of three measurements: g on lines, the search for poles, and curves of variance
    lines: LineSettings = LINE_SETTINGS
    poles: PoleSettings = POLE_SETTINGS
    curves: CurveSettings = CURVE_SETTINGS


CAUSE_SETTINGS = CauseSettings()
"""Default settings of the search for causes."""

# Causes that are also reported for noisy functions.
# All other causes are found on lines, which are meaningless if values are noisy
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
    """A detected cause of noise.

    Attributes
    ----------
    name
        The name of the cause, one of `Name`.
    sentence
        The cause and its effect in words, with numbers.
    evidence
        Numbers that show the cause, each with a name.
    kinds
        Kinds of remedies for this cause (`mcspectra.improve.candidates.KINDS`).
    """

    name: Name
    sentence: str
    evidence: Mapping[str, float] = field(default_factory=dict)
    kinds: tuple[str, ...] = ()


@final
@dataclass(frozen=True)
class Replicates:
    """Sets of equal numbers of points that a sampler drew.

    Attributes
    ----------
    estimates
        Estimates of the first R sets, (R,); R may be 0.
    waves
        For each set, the means of x − ½, cos 2πx and sin 2πx along every axis, (R, 3d).
        The integrals of x − ½, cos 2πx and sin 2πx are 0.
    different
        Number of different sets.
    """

    estimates: Array
    waves: Array
    different: int


@final
@dataclass(frozen=True)
class Evidence:
    """Values of an estimator from which detectors infer the causes of its noise.

    Attributes
    ----------
    estimator, sampler
        The estimator, and the sampler that draws its points.
    sets
        Values of g at scrambled nets.
    curves
        For each sampler by name: its variance as a function of the number of points.
    lines
        For each technique: measurements of its integrand g on lines.
    pole
        The pole of g, or None. A pole is searched for only if there is a single technique.
    mean_dimension
        Mean dimension of g, or NaN if it was not estimated.
    replicates
        Sets that the sampler drew, or None.
    noise
        Variance of g at a fixed point, if repeated evaluations differ; otherwise 0.
    calls
        Number of evaluations of the integrand.
    missed
        Position, as a text, where the user's density is 0 but f is not 0; empty if there is none.
    failed
        Error message if g cannot be evaluated next to the border of the cube; otherwise empty.
    settings
        Thresholds of the detectors.
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
    failed: str = ""
    settings: CauseSettings = CAUSE_SETTINGS

    @staticmethod
    def of(
        estimator: AbstractEstimator,
        sampler: Sampler,
        budget: int,
        stream: Stream,
        settings: CauseSettings = CAUSE_SETTINGS,
    ) -> Evidence:
        """Evaluate scrambled nets and lines within a budget; do not draw from `sampler`.

        Raises
        ------
        ParameterError
            If the budget is too small, or if squares of values exceed the range of float64.
        """
        each, n, nets = shares_of(estimator, sampler, budget, settings)
        sets = Sets.of(estimator, n, nets, stream.child(0))
        calls = nets * n * each
        size = max(float(np.abs(v).max()) for v in sets.values)
        # An f that is not finite raises an error earlier, so the pdf causes infinite values
        if not math.isfinite(size):
            raise ParameterError("The pdf is not finite at some samples; give a finite pdf.")
        if size and not settings.smallest <= size <= settings.largest:
            raise ParameterError(
                f"The values of f are of the size {size:.1g}, and float64 does not hold their "
                "powers; divide f by that size."
            )

        # Find a position at which the user's density is 0 although f is not 0
        missed = ""
        if isinstance(estimator, Estimator) and isinstance(estimator.density, FunctionDensity):
            places = uncovered(estimator.integrand, [estimator.density])
            places = places[:: max(1, len(places) // settings.again)][: settings.again]
            calls += len(places) * each
            if len(places) and (met := scalar(estimator, estimator.integrand(places)) != 0.0).any():
                missed = point_in_words(places[met][0])

        # If there is a single technique, estimate the mean dimension and search for a pole.
        # Afterwards, evaluate lines through the integrand of each technique
        lines: list[Lines] = []
        mean, pole, noise, failed = math.nan, None, 0.0, ""
        allowed = (
            int(settings.lines_share * budget)
            // len(estimator.counts)
            // estimator.evaluations_per_point
        )
        for t in range(len(estimator.counts)):
            made = 0

            def g(u: Array, t: int = t) -> Array:
                nonlocal made
                made += len(u)
                return np.asarray(scalar(estimator, estimator.primary_values(t, u[None]))[0])

            # Evaluate g again at some points, to detect whether its values are random
            points, values = sets.points[t].reshape(-1, estimator.dims), sets.values[t].ravel()
            again = max(1, min(settings.again, allowed // settings.again))
            off, before = np.abs(g(points[:again]) - values[:again]), values[:again]
            size = max(np.ptp(sets.pooled), np.abs(before).max())
            if off.max(initial=0.0) > settings.same_value * size:
                noise = max(noise, 0.5 * float((off**2).mean()))

            own = stream.child(1 + t).generator(0)
            some = int(settings.dimension_share * allowed) // estimator.dims
            if len(estimator.counts) == 1:
                if estimator.dims >= settings.many_dims and some > 1:
                    step = max(1, nets * n // some)
                    mean = mean_dimension(g, points[::step][:some], values[::step][:some], own)
                # In many dims, search for a pole only if few evaluations dominate the variance
                squares = (values - values.mean()) ** 2
                peaked = squares.max() > settings.climbed * squares.mean()
                if estimator.dims < settings.many_dims or peaked:
                    most = int(settings.pole_share * allowed)
                    try:
                        pole = pole_of(g, points, values, most, own, settings.poles)
                    except BudgetError:
                        raise
                    except ParameterError as error:  # The search for a pole left the cube
                        failed = str(error)
            lines.append(lines_of(g, estimator.dims, allowed - made, own, settings.lines))
            calls += made * estimator.evaluations_per_point
        curves = sets.curves(settings.curves)
        seen = Evidence(estimator, sampler, sets, curves, tuple(lines), pole, mean)
        failed = next((each.failed for each in lines if each.failed), failed)
        return replace(
            seen, noise=noise, calls=calls, missed=missed, failed=failed, settings=settings
        )

    @property
    def scale(self) -> float:
        """Standard deviation of g."""
        return math.sqrt(float(self.sets.pooled.var()))

    @property
    def growth(self) -> float:
        """Largest exponent with which g grows at the ends of lines."""
        return float(np.nanmax(self.each("growth"), initial=0.0))

    @property
    def wraps(self) -> bool:
        """Whether the sampler shifts points around the torus, which joins opposite faces."""
        law = self.sampler.law(self.sampler.nearest_count(self.settings.law_at))
        while isinstance(law, laws.Folded | laws.Mirrored):
            law = law.inner
        shifted = isinstance(law, laws.Shifted)
        # After folding by a mirrored estimator, a point shifted across a face is still near it
        return shifted and not isinstance(self.estimator, Mirrored)

    @property
    def opposite(self) -> float:
        """Mean squared difference of g between opposite faces, divided by the variance of g."""
        ends = self.each("ends")
        ends = ends[np.isfinite(ends)]
        return float(np.mean(ends**2)) / max(self.scale**2, 1e-300) if ends.size else 0.0

    @property
    def is_periodic(self) -> bool:
        """Whether lines along the axes find equal values of g on opposite faces of the cube."""
        return self.opposite <= self.settings.opposite

    def each(self, name: str) -> Array:
        """Return one quantity, measured along all lines and concatenated over techniques."""
        return np.concatenate([getattr(lines, name) for lines in self.lines])


def is_apart(estimator: AbstractEstimator, sampler: Sampler) -> bool:
    """Return whether the sampler must be drawn because nets cannot estimate its variance."""
    told = sampler.spec in {NETS, "random", "jittered", "latin-hypercube"}
    return not told and not estimator.randomized(sampler).fixed


def shares_of(
    estimator: AbstractEstimator,
    sampler: Sampler,
    budget: int,
    settings: CauseSettings = CAUSE_SETTINGS,
) -> tuple[int, int, int]:
    """Return the evaluations per point, the points of a net, and the number of nets in a budget.

    Raises
    ------
    ParameterError
        If the budget does not allow nets of four points.
    """
    each = estimator.cost
    share = 1.0 - settings.lines_share - settings.check_share
    share -= settings.given_share if is_apart(estimator, sampler) else 0.0
    # More nets reduce the error of the variance's rate; larger nets do not.
    # The error of the integral falls with the number of nets and with their size
    nets = int(settings.nets * max(1.0, math.sqrt(budget / (each * settings.more_from))))
    n = int(share * budget) // (nets * each)
    if n < 4:
        raise ParameterError(
            f"A budget of {budget} evaluations is too small, because each point takes {each}; give "
            f"at least {math.ceil(4 * settings.nets * each / share)}."
        )
    n = 1 << (n.bit_length() - 1)
    return each, n, min(int(share * budget) // (n * each), 2 * nets)


def technique_name(estimator: AbstractEstimator, technique: int) -> str:
    """Return the name of a technique, or its number if it has no name."""
    return str(getattr(estimator, "technique_name", lambda t: f"technique {t}")(technique))


def _wrong_pdf(seen: Evidence) -> Cause | None:
    for density in getattr(seen.estimator, "densities", None) or [
        getattr(seen.estimator, "density", None)
    ]:
        try:
            if density is not None:
                density.check()
        except DensityError as error:
            u = as_sampler(NETS, density.primary_dims).draw(seen.settings.pdf_points)[0]
            with np.errstate(all="ignore"):
                found = float((1.0 / density.pdf(density.sample(u))).mean())
            return Cause(
                "wrong-pdf",
                f"{error} Every estimate is biased: the estimate of the constant 1 is {found:.4g}.",
                {"of_one": found},
            )
    if not seen.missed:
        return None
    return Cause(
        "wrong-pdf",
        f"The pdf is 0 at {seen.missed}, where f is not 0: every estimate misses that part.",
    )


def _noisy_function(seen: Evidence) -> Cause | None:
    if not seen.noise:
        return None
    share = min(seen.noise / max(seen.scale**2, 1e-300), 1.0)
    return Cause(
        "noisy-function",
        f"The integrand returns different values at the same point. Its own random numbers cause "
        f"about {share:.2g} of its variance, which falls as 1/n with any points. Take them from "
        "further dims of the points.",
        {"share": share},
    )


def _infinite_variance(seen: Evidence) -> Cause | None:
    # If no uphill search found a pole, take the less precise order of the pole from lines
    poles = np.concatenate([lines.poles() for lines in seen.lines])
    order = -float(np.median(seen.each("exponent")[poles])) if poles.any() else 0.0
    known = seen.settings
    found = [
        (seen.growth, known.exponent_error, f"grows as t^−{seen.growth:.2f} at the border", True)
    ]
    if seen.pole is None:
        what = f"has a pole of order {order:.2f} inside"
        found.append((order, known.bend_error, what, False))
    else:
        found.append((seen.pole.tail, known.exponent_error, _said(seen.pole), seen.pole.border))
    for index, near, what, border in found:
        if index >= 0.5 - near:
            said = (
                "∫g² is infinite (exponent ≥ ½), so errors fall more slowly than n^−½ and no "
                "interval holds"
            )
            said = "it has no integral (exponent ≥ 1)" if index >= known.no_integral else said
            return Cause(
                "infinite-variance",
                f"The integrand g {what}: {said}.",
                {"exponent": index},
                ("periodized", "fitted", "warp") if border and index < known.no_integral else (),
            )
    if seen.estimator.infinite_weights and _tail(seen)[1] > 0.5:
        return Cause(
            "infinite-variance",
            f"1/p is unbounded, and the tail index of the estimates is {_tail(seen)[1]:.2f}: the "
            "variance is infinite (index ≥ ½).",
            {"tail_index": _tail(seen)[1]},
            ("warp", "fitted"),
        )
    return None


def _said(pole: Pole) -> str:
    """Describe in words how g grows at a pole, and give the tail index of g there."""
    k, d = pole.codimension, len(pole.place)
    where = "a point" if k == d else f"a set of {d - k} dims"
    side = "of the border" if pole.border else "inside"
    if pole.exponent == 0.0:
        return f"grows without bound, as a logarithm, toward points {side}"
    index = f", with tail index {pole.exponent:.2f}/{k}" if k > 1 else ""
    return f"grows as r^−{pole.exponent:.2f} with the distance r to {where} {side}{index}"


def _tail(seen: Evidence) -> tuple[float, float, float]:
    """Return the largest fraction of the variance in one value, the tail index and the kurtosis."""
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
    known = seen.settings
    heavy = kurtosis > known.heavy_kurtosis and few < known.few_values
    if not (share > known.large_share or heavy or inside):
        return None
    found = (
        ""
        if not inside
        else "The integrand has a pole inside. "
        if pole is None
        else f"The integrand {_said(pole)}. "
    )
    said = (
        f"A few evaluations cause the variance: {100 * few:.2g} % of them hold nine tenths of it "
        f"(kurtosis {kurtosis:.3g}, tail index {index:.2f}), so most sets miss the important "
        "region."
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
    """Return the fraction of the values that hold nine tenths of the variance."""
    squares = np.sort((values - values.mean()) ** 2)[::-1].cumsum()
    return float(np.searchsorted(squares, 0.9 * squares[-1]) + 1) / len(values)


def _deterministic(seen: Evidence) -> Cause | None:
    fixed = seen.estimator.randomized(seen.sampler).fixed
    if not fixed and (seen.replicates is None or seen.replicates.different > 1):
        return None
    return Cause(
        "deterministic-set",
        f"{seen.sampler.spec} is deterministic: its error is a bias, which no spread between sets "
        "reveals. Add owen or shift.",
        {"different": 1.0},
        ("sampler",),
    )


def _few_realizations(seen: Evidence) -> Cause | None:
    count = seen.sampler.most_realizations
    if count >= seen.settings.few_sets:
        return None
    from scipy.stats import chi2

    low, high = 0.0, math.inf
    if count > 1:
        low, high = ((count - 1) / float(chi2.ppf(q, count - 1)) for q in (0.975, 0.025))
    return Cause(
        "few-realizations",
        f"{seen.sampler.spec} has {count} sets. Their spread gives the variance only to a factor "
        f"between {low:.2g} and {high:.2g}.",
        {"realizations": float(count), "low": low, "high": high},
    )


def _correlated(seen: Evidence) -> Cause | None:
    made = seen.replicates
    known = seen.settings
    if made is None or not made.different > 1 or len(made.waves) < known.few_sets:
        return None
    count, sampler = len(made.waves), seen.sampler.spec
    if made.different < count:
        return Cause(
            "correlated-replicates",
            f"Only {made.different} of {count} sets of {sampler} are different, so their spread "
            "underestimates the error.",
            {"different": float(made.different), "realizations": float(count)},
        )
    mean, spread = made.waves.mean(axis=0), made.waves.std(axis=0, ddof=1)
    varies = spread > known.rounding
    rest = (made.waves[:, varies] - mean[varies]) / spread[varies]
    serial = float((rest[1:] * rest[:-1]).sum()) / max(rest.size, 1)
    if serial > known.serial / math.sqrt(count * seen.sets.dims):
        return Cause(
            "correlated-replicates",
            f"Each set of {sampler} resembles the previous one: the correlation of their means is "
            f"{serial:.2f}.",
            {"correlation": serial, "realizations": float(count)},
        )
    away = mean[varies] / spread[varies] * math.sqrt(count)
    found, nets = made.estimates, seen.sets.estimates
    if len(found) >= known.few_sets and found.std() > known.lines.grains * grain(found):
        error = math.sqrt(found.var(ddof=1) / len(found) + nets.var(ddof=1) / len(nets))
        away = np.append(away, (found.mean() - nets.mean()) / error)
    most = float(np.abs(away).max(initial=0.0))
    if most < known.away:
        return None
    return Cause(
        "correlated-replicates",
        f"Means of sets of {sampler} are {most:.2g} standard errors from those of uniform points: "
        "the sets share an error, or their points are not uniform.",
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
    rounded = step > seen.settings.coarse * seen.scale
    if not rounded and (error == 0.0 or drift <= error):
        return None
    return Cause(
        "float-drift",
        f"Values of the integrand are rounded to steps of {step:.2g}, which is "
        f"{step / seen.scale:.2g} of their spread. Compute differences before sums, in float64."
        if rounded
        else f"Values of the integrand are float32: a running sum of {len(values)} of them in "
        f"float32 has an error of {drift:.2g} in the mean; the RMSE is {error:.2g}. Sum in "
        "float64.",
        {"step": step, "drift": drift, "rmse": error},
    )


def _slow_technique(seen: Evidence) -> Cause | None:
    known = seen.settings
    curves = seen.sets.technique_curves(known.curves)
    if len(curves) < 2:
        return None
    n = seen.sets.n
    parts = np.array([curve.at(n)[0] for curve in curves])
    worst = int(np.argmax(parts))
    share = float(parts[worst] / parts.sum()) if parts.sum() > 0 else 0.0
    others = [curve for t, curve in enumerate(curves) if t != worst]
    slower = all(
        curves[worst].rate - c.rate > known.slower * math.hypot(curves[worst].rate_se, c.rate_se)
        for c in others
    )
    if share < known.dominant and not (slower and share > known.largest_part):
        return None
    name = technique_name(seen.estimator, worst)
    rate = f"{curves[worst].rate:.2f}".replace("-", "−")
    return Cause(
        "slow-technique",
        f"Technique {name} causes {100 * share:.0f} % of the variance at n = {n} with {NETS}, and "
        f"its rate is {rate}.",
        {"share": share, "technique": float(worst), "rate": curves[worst].rate},
        ("heuristic", "techniques", "warp"),
    )


def _jumps(seen: Evidence) -> Cause | None:
    meets = np.concatenate([lines.jumps(seen.scale) for lines in seen.lines])
    # Lines through a pole of codimension 1 inside the cube seem to cross a jump
    if seen.pole is not None and not seen.pole.border:
        meets &= seen.pole.codimension > 1
    cusps = sum(int(lines.cusps().sum()) for lines in seen.lines)
    meets &= meets.sum() > seen.settings.jumps_of_cusps * cusps
    height = seen.each("height")
    alike = len(np.unique(seen.sets.pooled))
    if not meets.any():
        if not 1 < alike <= seen.settings.few_different * seen.sets.pooled.size:
            return None
        return Cause(
            "interior-jump",
            f"The integrand takes only {alike} different values, so it is discontinuous, although "
            "no tested line crosses a jump.",
            {"values": float(alike)},
            ("preintegrated", "smoothed"),
        )
    size = float(np.median(height[meets])) / max(seen.scale, 1e-300)
    share = float(meets.mean())
    straight = seen.each("straight")[meets].mean() > seen.settings.straight
    evidence = {"met_by": share, "height": size}
    met = (
        f"{100 * share:.0f} % of all lines through the cube cross a discontinuity of the "
        f"integrand, {size:.2g} times its spread high"
    )
    if straight or seen.sets.dims == 1:
        return Cause(
            "axis-parallel-jump",
            f"{met}. It lies on planes normal to an axis: a border of strata there removes its "
            "effect.",
            evidence,
            ("aligned", "smoothed", "preintegrated"),
        )
    limit = -1.0 - 1.0 / seen.sets.dims
    return Cause(
        "interior-jump",
        f"{met}. Strata on the discontinuity keep their noise: {_limited(seen, limit)}.",
        evidence | {"rate_limit": limit},
        ("preintegrated", "smoothed", "aligned"),
    )


def _border_jump(seen: Evidence) -> Cause | None:
    size = seen.opposite
    if not seen.wraps or seen.is_periodic:
        return None
    return Cause(
        "border-jump",
        f"The integrand differs between opposite faces by {math.sqrt(size):.2g} of its spread. "
        f"{seen.sampler.spec} wraps around, so the integrand is discontinuous there.",
        {"difference": math.sqrt(size)},
        ("unshifted", "mirrored", "sampler"),
    )


def _border_growth(seen: Evidence, *, slow: bool) -> Cause | None:
    pole = seen.pole if seen.pole is not None and seen.pole.border else None
    index, grows = max(pole.tail if pole else 0.0, seen.growth), seen.settings.grows
    if (index <= grows) != slow or (pole is None and not index):
        return None
    said = f"grows without bound at the border, about as t^−{index:.2f}"
    if pole is not None and (slow or seen.growth <= grows):
        said = _said(pole)
    what = "bounded functions do not have" if slow else "finer strata inside do not remove"
    return Cause(
        "border-growth",
        f"The integrand {said}: the outermost strata keep noise that {what}.",
        {"slow_exponent" if slow else "exponent": index},
        ("periodized", "fitted", "warp"),
    )


def _high_frequency(seen: Evidence) -> Cause | None:
    known, share = seen.settings, seen.each("spread")
    # At a jump, turns and the curvature that gives the number of waves do not show waves
    smooth = share * ~np.concatenate([lines.jumps(seen.scale) for lines in seen.lines])
    turns = seen.each("turns") @ smooth / max(share.sum(), 1e-300)
    waves = seen.each("waves") @ smooth / max(smooth.sum(), 1e-300)
    varies = (seen.each("turns") > known.turns) & (share > known.coarse * share.max(initial=0.0))
    axes = len(np.unique(seen.each("axis")[varies & (seen.each("axis") >= 0)]))
    nets, random = seen.curves[NETS], seen.curves["random"]
    gains = np.array([random.at(n)[0] / nets.at(n)[0] for n in nets.counts])
    seeing = nets.counts[gains > known.resolved]
    needed = float(seeing[0]) if len(seeing) else math.inf
    many = turns > known.turns and waves > known.waves
    if not (many and needed > known.coarse_cube * 2.0**axes):
        return None
    if math.isinf(needed):
        needed = max((4.0 * waves) ** max(axes, 1), 2.0 * seen.sets.n)
    # A part of g that does not oscillate may make nets better than random points
    said, below = "are no better than random points", nets.counts[nets.counts < needed]
    if len(below):
        n, gain = float(below[-1]), gains[len(below) - 1]
        if gain > math.exp(CONFIDENCE_Z * math.hypot(nets.at(n)[1], random.at(n)[1])):
            said = f"gain little: {n:.0f} points have {_less_variance(gain)}"
    return Cause(
        "high-frequency",
        f"The integrand oscillates about {waves:.2g} times along a line: sets of fewer than about "
        f"{needed:,.2g} points do not resolve that and {said}.",
        {"waves": float(waves), "resolved_by": float(needed)},
        ("sampler",),
    )


def _high_dimension(seen: Evidence) -> Cause | None:
    d = seen.sets.dims
    if d < seen.settings.many_dims:
        return None
    n = seen.sets.n
    nets, random = seen.curves[NETS], seen.curves["random"]
    mean = min(seen.mean_dimension, float(d))
    gain = random.at(n)[0] / max(nets.at(n)[0], 1e-300)
    if gain > seen.settings.little_gain or not mean > seen.settings.low_dimension:
        return None
    return Cause(
        "high-dimension",
        f"Interactions of about {mean:.1f} of its {d} dims dominate the integrand, and {n} points "
        f"are too few for them: the best sets have {_less_variance(gain)}.",
        {"mean_dimension": mean, "gain": gain},
        ("order", "regression", "preintegrated"),
    )


def _less_variance(gain: float) -> str:
    """Return how many times less variance than random points sets have, in words."""
    times = "no" if gain < 1.05 else f"{gain:.2g} times"
    return f"{times} less variance than random points"


def _limited(seen: Evidence, limit: float) -> str:
    """Compare the theoretical rate of stratified points with measured rates, in a sentence.

    The theoretical rate holds for large n, and the measured rate at the measured counts.
    If the measured rate is significantly steeper, the sentence gives both rates.
    """
    curves = [seen.curves[name] for name in (NETS, "jittered") if name in seen.curves]
    steepest = min((c for c in curves if c.rate_ci[1] < limit), key=lambda c: c.rate, default=None)
    if steepest is None:
        return f"the variance of stratified points falls at best as n^{limit:.3g}".replace("-", "−")
    said = (
        f"n^{limit:.3g} is the limit for large n, although up to n = {steepest.counts[-1]:.0f} the "
        f"variance falls as n^{steepest.rate:.2f}"
    )
    return said.replace("-", "−")


def _cusps_and_kinks(seen: Evidence) -> tuple[Array, Array]:
    """Return which lines cross a cusp, and which lines cross a kink.

    Of cusps and kinks, only the more frequent kind is reported as a cause of noise.

    The exponent of a cusp or a kink has an error of about 0.1 on a single line.
    A jump next to a steep part may look like a cusp or a kink.
    """
    each = [(lines.cusps(), lines.kinks()) for lines in seen.lines]
    return tuple(map(np.concatenate, zip(*each, strict=True)))  # type: ignore[return-value]


def _cusp(seen: Evidence) -> Cause | None:
    cusps, kinks = _cusps_and_kinks(seen)
    if not cusps.sum() > kinks.sum():
        return None
    order, d = float(np.median(seen.each("exponent")[cusps])), seen.sets.dims
    # Cells of side h next to a cusp |t|^a have a variance ∝ h^(2a).
    # Of n cells, about n^(1 − 1/d) are next to the cusp
    limit = -1.0 - min(1.0 + 2.0 * order, 2.0) / d
    return Cause(
        "cusp",
        f"{100 * cusps.mean():.0f} % of all lines through the cube cross a cusp of the integrand: "
        f"it is continuous there with an infinite slope, about as |t|^{order:.2f}. "
        f"In theory, {_limited(seen, limit)}.",
        {"met_by": float(cusps.mean()), "exponent": order, "rate_limit": limit},
        ("smoothed", "preintegrated"),
    )


def _kink(seen: Evidence) -> Cause | None:
    cusps, kinks = _cusps_and_kinks(seen)
    if not 0 < kinks.sum() >= cusps.sum():
        return None
    return Cause(
        "kink",
        f"{100 * kinks.mean():.0f} % of all lines through the cube cross a kink of the integrand: "
        "it is continuous, but samplers gain less than for a smooth function.",
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
    _cusp,
    _kink,
    partial(_border_growth, slow=True),
)
"""All detectors, in the order in which causes are listed."""


def causes_of(seen: Evidence) -> list[Cause]:
    """Return all detected causes, or only the cause `none` if there are no others."""
    found = [cause for detect in CAUSES if (cause := detect(seen)) is not None]
    names = {cause.name for cause in found}
    # Rounding steps are not jumps, and noise has no features on lines
    if "float-drift" in names:
        found = [c for c in found if c.name not in {"interior-jump", "axis-parallel-jump"}]
    if "noisy-function" in names:
        found = [c for c in found if c.name in _SHAPELESS]
    # A heavy tail follows from unbounded growth, which is already reported
    if names & {"infinite-variance", "border-growth"}:
        found = [c for c in found if c.name != "heavy-tail"]
    # Many dims, or a region in which g is 0, can explain a heavy tail, which is then listed last.
    # If very few values hold most of the variance, the order of the causes is not changed
    heavy = next((c for c in found if c.name == "heavy-tail"), None)
    if (
        heavy is not None
        and names & {"high-dimension", "axis-parallel-jump"}
        and heavy.evidence["nine_tenths"] > seen.settings.very_few_values
    ):
        found = sorted(found, key=lambda c: c.name == "heavy-tail")
    if found:
        return found
    # Half of all causes can be detected only if g is evaluated on lines through the cube
    looked, least = len(seen.each("axis")), seen.settings.least_lines
    if looked < least:
        return [
            Cause(
                "few-realizations",
                f"No problem was found, but {looked or 'no'} line{'s' * (looked != 1)} through the "
                f"cube {'were' if looked != 1 else 'was'} tested: give "
                f"{math.ceil(least / max(looked, 1))} times the evaluations.",
                {"lines": float(looked)},
            )
        ]
    nets = seen.curves[NETS]
    if as_slow_as_a_jump(nets, seen.estimator.dims):
        return [
            Cause(
                "few-realizations",
                f"No problem was found, but the variance of nets falls only as n^{nets.rate:.2f}, "
                f"as if the integrand jumped: {looked} tested lines through the cube may have "
                "missed a jump. Give more evaluations.".replace("^-", "^−"),
                {"lines": float(looked), "rate": nets.rate},
            )
        ]
    return [
        Cause(
            "none",
            "No problem was found: the integrand is smooth, and the variance falls as fast as it "
            "should.",
        )
    ]


def as_slow_as_a_jump(nets: Curve, dims: int, settings: CauseSettings = CAUSE_SETTINGS) -> bool:
    """Return whether the variance of nets falls in n as slowly as theory says for a jump of g."""
    if dims > settings.smooth_dims or not math.isfinite(nets.rate):
        return False
    jump, error = -1.0 - 1.0 / dims, settings.smooth_error
    # For smooth g, the variance is n^−3 (log n)^(d − 1) in theory.
    # Assume two thirds of these logarithms, with an error of one third
    third = (dims - 1) / (3.0 * math.log(nets.counts[-1]))
    smooth = nets.towards(-3.0 + 2.0 * third, math.hypot(error, third)) is not nets
    return not smooth and (nets.rate > jump or nets.towards(jump, error) is not nets)
