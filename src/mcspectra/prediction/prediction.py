"""Predictions of the variance at every n, by the most trusted method, a given method, or all.

`METHODS` lists the methods in their order of trust.
The methods from the first to ``extrapolated`` work in primary space.
In primary space each technique has its own integrand on the unit cube.
The variances of independent techniques add up.

``auto`` tries the methods that apply.
``auto`` returns the first prediction with a narrow enough interval.
If no interval is narrow enough, ``auto`` returns the prediction with the narrowest interval.
The last method of ``auto``, ``extrapolated``, measures small sets of the sampler.
Methods that `METHODS` lists after ``extrapolated`` serve to check predictions.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any, final

import msgspec
import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import Counted, Need, Reduction, Steps, Subject, compute
from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z, rounding_floor, student_t
from mcspectra.core.errors import (
    CountError,
    NoClosedForm,
    ParameterError,
)
from mcspectra.core.memory import memory_of
from mcspectra.core.options import COUNTS, HALF_WIDTH, Counts
from mcspectra.core.parallel import MAX_REALIZATIONS
from mcspectra.core.results import coordinate, dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, Estimator
from mcspectra.estimators.importance import as_subject
from mcspectra.estimators.mirrored import FoldedIntegrand, SymmetrizedIntegrand
from mcspectra.estimators.moments import Moments
from mcspectra.estimators.quadrature import Pointwise, in_closed_form, looked_at, mesh, orders_of
from mcspectra.estimators.tails import doubt
from mcspectra.integrands import Integrand
from mcspectra.measure.blindness import NO_VARIANCE, VANISHES
from mcspectra.measure.converge import count_moments, count_stream
from mcspectra.measure.terms import Terms
from mcspectra.prediction.cross_checks import (
    draws_power,
    of_covariance,
    of_homogenized,
    of_pairs,
    of_terms,
    terms_for,
)
from mcspectra.prediction.exact import (
    EXACT_TOLERANCE,
    estimated_variance,
    of_curves,
    of_integrand,
)
from mcspectra.prediction.known import Cells, Known, Predicted
from mcspectra.prediction.levels import of_levels
from mcspectra.prediction.paired import evaluations, is_array, of_arrays
from mcspectra.prediction.rates import Slowest, rates_of, slowest_of_jumps
from mcspectra.prediction.separable import (
    PiecewiseSettings,
    Separable,
    separated,
    separated_within,
)
from mcspectra.prediction.subsets import of_subsets
from mcspectra.prediction.torus import (
    cost_of_moves,
    moves_at_once,
    moves_resolve,
    of_moves,
    of_torus,
)
from mcspectra.samplers import Sampler
from mcspectra.samplers.law import (
    Choice,
    Fixed,
    Folded,
    Independent,
    Law,
    Mirrored,
    PairedAxes,
    Shifted,
    Strata,
    as_scrambled,
    leaf_of,
    moved,
)

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "LIMITS",
    "METHODS",
    "NAMES",
    "AutoSettings",
    "EvaluationLimits",
    "ExtrapolationSettings",
    "Method",
    "Prediction",
    "Predictor",
    "QuadratureSettings",
    "TableSettings",
    "predict",
    "predicted",
    "tried",
]

_OFFSET = 0.5 - 0.5 / 3**0.5
"""An offset c of strata, as a fraction of their width. c(1 − c) is 1/6, its mean over all c.

The variance from jumps at the faces of the cube is proportional to c(1 − c).
"""
_MEMORY = 2**29
"""Largest memory, in bytes, of coefficients and transforms of all regions."""
_OVERHEAD = 1e6
"""Work of a prediction besides evaluations of g, as an equivalent number of evaluations."""


@final
@dataclass(frozen=True, kw_only=True)
class QuadratureSettings:
    """Conditions under which `auto` uses a quadrature.

    Attributes
    ----------
    tolerance
        Largest relative error with which a quadrature takes precedence over all other methods.
        If g jumps, the relative errors of all other methods are at least about as large as 0.01.
        Tolerances were tested on a jump along a line with 5 samplers at n = 64.
        With the tolerance 0.003 instead of 0.01, quadrature predicts one sampler fewer.
        With the tolerance 0.03 instead of 0.01, quadrature predicts one more sampler.
    evaluations
        Number of evaluations of g above which other methods come first.
        The default is a sixteenth of the most evaluations that `exact_variance` makes.
        For a jump along a line and 5 samplers, any limit from 2^20 to 2^24 gives the same results.
    most_breaks
        Largest number of breaks of g for the quadrature of shifted strata in several dims.
        The breaks divide the range of offsets along each axis. Each interval needs its own nodes.
    """

    tolerance: float = 0.01
    evaluations: float = 2.0**22
    most_breaks: int = 8


@final
@dataclass(frozen=True, kw_only=True)
class AutoSettings:
    """Largest widths of accepted intervals, and additional counts for the limits of rates.

    Attributes
    ----------
    moved, measured
        Largest accepted errors of predictions by sums of products.
        The error of a prediction is half of the 95 % interval, divided by the variance.
        If the error exceeds `moved`, random offsets of the set are evaluated.
        If the error exceeds `measured`, realizations are measured.
        8,192 offsets have a standard error of √(2/8192) = 1.6 % and intervals of 3 %.
        Extrapolated variances have intervals of about ± 20 %.
    ahead, most_ahead
        Largest additional count, as a multiple of the last requested count.
        The additional counts show the limit to which the rate tends.
        `most_ahead` is log2 of the largest additional count.
        With strata, all counts up to the largest are used: one table of g serves all counts.
    loose
        Largest half width of a 95 % interval, relative to the variance, at additional counts.
        Additional counts with larger intervals are not used for rates.
        An error as large as the half width changes the slope over two octaves by 0.16.
    square, coefficients, tables
        Numbers of evaluations of g, from which the costs of methods are estimated.
        Computing ∫g² takes at most `square` evaluations.
        In 2-D, coefficients of g take about `coefficients` evaluations, and tables about `tables`.
    """

    moved: float = 0.03
    measured: float = 0.2
    ahead: int = 4
    most_ahead: int = 16
    loose: float = 0.25
    square: float = 2.0**21
    coefficients: float = 2.0**20
    tables: float = 2.0**20


@final
@dataclass(frozen=True, kw_only=True)
class TableSettings:
    """Settings for a table of g at the centers of cells, measured with sets of the sampler.

    The changes stated below were measured at n = 64 for three integrands.
    A jump along a line and a smooth g were measured in 2-D with pmj02.
    A Gaussian of width 0.1 was measured in 3-D with latin-hypercube.
    The predicted variances of the three integrands have 95 % intervals of about ± 3 %.

    Attributes
    ----------
    cells
        Number of cells along each axis, by number of dims: about a million cells in 2-D and 3-D.
        Halving or doubling the number of cells changes the variance by less than 1 %.
        If g jumps, half or twice as many cells change the width of intervals by 0.6 %.
    probe
        Number of random points at which the table is compared with g.
        The mean square difference usually has a relative standard error of about 1/256.
        Heavy-tailed differences have larger errors.
        Predicted variances are the same for 2^15 to 2^17 points.
    block
        Number of points per call, 1 MB in 2-D. It has no effect on the result.
    points
        Total number of points of all sets, which limits the work at large n.
        If n exceeds 420, the total number of points allows fewer than 10,000 sets.
    least_sets, most_sets
        Least and largest number of sets that are drawn for one variance.
        The variance of R sets has the relative standard error √(2/R), here 10 % and 1.4 %.
    """

    cells: Mapping[int, int] = field(default_factory=lambda: {1: 2**16, 2: 2**10, 3: 100})
    probe: int = 2**16
    block: int = 2**16
    points: int = 2**22
    least_sets: int = 200
    most_sets: int = 10_000


@final
@dataclass(frozen=True, kw_only=True)
class ExtrapolationSettings:
    """Settings for the measured counts, and for the line through their variances.

    The changes stated below were measured for three integrands.
    A jump along a plane in 4-D and a smooth g in 2-D were measured with sobol | owen.
    The numbers of points of sobol | owen were 256 and 1024.
    A smooth g in 4-D was measured with latin-hypercube at n = 100.

    Attributes
    ----------
    small
        Small counts, whose measurements cost little.
        Small counts are measured if the sampler allows only few counts close to n.
        If one of the small counts is left out or another is added, the variances stay the same.
    largest
        Largest number of points at which the variance of a cheap f is measured.
        With 2^11 or 2^13 instead of 2^12 points, variances change by less than 1.5 %.
    near
        Counts close to n are one or two steps from n. A step is at most n divided by this number.
        The measured counts differ from n by at most n/8, so the line hardly extrapolates.
        Any divisor from 8 to 32 gives the same variances.
    fitted
        Number of counts closest to n that the line is fitted to.
        Three counts leave one degree of freedom, for which Student's t is 12.7.
        Four counts leave two degrees of freedom, for which t is 4.3.
        With eight instead of four counts, intervals are half as wide, but evaluations are doubled.
    sets
        Realizations of each small count. The relative error of a variance is √(2/2000) = 3 %.
    near_sets, near_points
        Least number of realizations of a count close to n, and least total number of points.
        There are at least `near_sets` realizations, and at least `near_points` points in total.
        Half or twice as many realizations and points change variances by less than 4 %.
        A change of 4 % is far smaller than the intervals of the variances, which are 14 to 60 %.
    most_factor
        The upper end of an interval is at most this number times the extrapolated variance.
        Without this upper limit, the exponential of the error could overflow.
        Any upper limit from 15 to 60 gives the same intervals.
    """

    small: tuple[int, ...] = tuple(2**k for k in range(3, 9))
    largest: int = 2**12
    near: int = 16
    fitted: int = 4
    sets: int = 2000
    near_sets: int = 1000
    near_points: int = 2**20
    most_factor: float = 30.0


@final
@dataclass(frozen=True, kw_only=True)
class EvaluationLimits:
    """Limits on evaluations of users' functions, and counts that are measured within the limits.

    Attributes
    ----------
    evaluations
        Default for the largest number of evaluations of a user's function.
        A function that takes 4 µs per point needs one second for 2^18 evaluations.
        With 2^18 evaluations at measured counts, intervals end at 1/1.5 and 1.5 times the variance.
        With 2^18 evaluations at n = 4,096, intervals end at half and at twice the variance.
    predictions
        If fewer evaluations per technique are allowed, variances are only measured, not predicted.
        Predictions need 1.2 to 13 million evaluations.
        Four samplers were tested with smooth functions and jumps in 1-D to 4-D.
    sets, least_sets
        If every count has more than this number of realizations, larger counts are also measured.
        `least_sets` is the least number of realizations of any count.
        Variances of 100 and of 16 realizations have standard errors of 14 % and 35 %.
    first, least_counts
        Smallest measured count, and least number of measured counts.
        Two counts determine a line, and one or two further counts determine its error.
        The count whose variance is predicted is not measured.
    beyond
        Ratio of the largest measured count to the largest requested count.
    probe
        Fraction of the evaluations that are spent on random points: 16,384 of 2^18.
        Random points detect integrands that grow toward the border, or have a few dominant values.
        If random points find growth or dominant values, variances are not predicted.
    lines
        Fraction of the evaluations that compare g with a sum or product of functions of one axis.
        If g is such a sum or product, variances are computed from the functions, not measured.
        With 2^18 evaluations, 2^17 points are compared, as many as `exact_variance` compares.
        They find a region of volume v where g differs with probability 1 − exp(−2^17 v).
    fitted
        Number of measured counts to whose variances a line is fitted.
        Five counts leave three degrees of freedom, for which Student's t is 3.2.
        With four instead of five counts, the intervals of the line are 1.4 times as wide.
        With six counts, the line does not follow curves that bend.
    """

    evaluations: int = 2**18
    predictions: int = 2**24
    sets: int = 100
    least_sets: int = 16
    first: int = 4
    least_counts: int = 6
    beyond: int = 4
    probe: float = 1 / 16
    lines: float = 1 / 2
    fitted: int = 5


LIMITS = EvaluationLimits()
"""Limits for users' functions."""

_QUADRATURE_SETTINGS, _AUTO = QuadratureSettings(), AutoSettings()
_TABLE, _EXTRAPOLATION = TableSettings(), ExtrapolationSettings()
_PIECEWISE = PiecewiseSettings()


def of_quadrature(
    law: Law,
    known: Known,
    stream: Stream,  # noqa: ARG001
    settings: QuadratureSettings = _QUADRATURE_SETTINGS,
) -> Predicted:
    """Return the variance by quadrature, except for shifted strata that would take long."""
    g = known.g
    costs_much = not in_closed_form(g) or sum(map(len, g.breaks)) > settings.most_breaks
    if g.dims > 1 and isinstance(law, Shifted) and costs_much and not lines_suffice(known):
        raise NoClosedForm("A quadrature for every offset of the strata would take long.")
    found = of_integrand(law, g, settings.tolerance, settings.evaluations)
    return Predicted(*found, "quadrature", poles=True)


def lines_suffice(known: Known) -> bool:
    """Return whether g has poles and is a sum or product of functions of single axes.

    Values of g on one line along each axis then determine g in the whole cube.
    """
    return bool(known.unresolved.any()) and separated(known.g) is not None


def of_divergence(law: Law, known: Known, stream: Stream) -> Predicted:  # noqa: ARG001
    """Return an infinite variance if ∫g² diverges and each point is uniform."""
    diverges = np.isinf(known.square[0])
    if not diverges.any():
        raise NoClosedForm("∫g² is finite.")
    infinite = np.where(diverges, math.inf, math.nan)
    return Predicted(infinite, infinite, "∫g² = ∞", 0.0, infinite)


def of_table(law: Law, known: Known, stream: Stream, settings: TableSettings = _TABLE) -> Predicted:
    """Measure a table of g with sets of the sampler, and add the part that the table misses.

    The table holds g at the centers of fine cells. It serves all samplers and counts.
    Between the centers, the table is interpolated linearly.
    The missing part varies within cells and is treated as white noise: ∫(g − table)²/n.
    """
    if known.g.dims not in settings.cells:
        raise NoClosedForm("A table takes 1 to 3 dims.")
    if np.isinf(known.square[0]).any():
        raise NoClosedForm("∫g² diverges.")
    sampler = law.source
    if not isinstance(sampler, Sampler):
        raise NoClosedForm("These points have no sampler.")
    g, n = known.g, law.n
    side, block = settings.cells[g.dims], settings.block

    def tabulated() -> tuple[Integrand, Array, Array]:
        """Make a table of g, with ∫(g − table)² and half its 95 % interval, by channel."""
        from scipy.interpolate import RegularGridInterpolator

        axes = [(np.arange(side) + 0.5) / side] * g.dims
        nodes = mesh(*axes)
        flat = nodes.reshape(-1, g.dims)
        blocks = [g(flat[i : i + block]) for i in range(0, len(flat), block)]
        values = np.concatenate(blocks).reshape(*nodes.shape[:-1], *[g.channels] * (g.channels > 0))
        linear = RegularGridInterpolator(axes, values, bounds_error=False, fill_value=None)
        table = Pointwise(g, linear, ((),) * g.dims, f"a table of {g.spec}")
        probe = np.random.default_rng(0).random((settings.probe, g.dims))
        missed = ((g(probe) - table(probe)) ** 2).reshape(settings.probe, -1)
        error = CONFIDENCE_Z * missed.std(axis=0, ddof=1) / math.sqrt(settings.probe)
        return table, missed.mean(axis=0), error

    table, missed, miss = known.once("table", tabulated)
    sets = min(max(settings.points // n, settings.least_sets), settings.most_sets)
    moments = count_moments(Estimator(table), sampler, n, sets, stream)
    if not (moments.resolved & (moments.variance > rounding_floor(moments.mean))).all():
        raise NoClosedForm(f"{sets} sets do not resolve the variance of {law.name}.")
    tail = missed / n
    # The variance within cells, `tail`, is computed as for random points.
    # Points within cells may be spread more evenly, so `tail` is also added to the error
    error = CONFIDENCE_Z * moments.relative_se * moments.variance + tail + miss / n
    share = 1.0 - np.minimum(missed / known.square[0], 1.0)
    return Predicted(moments.variance + tail, error, f"{sets} sets", share, tail)


def of_measurements(
    law: Law, known: Known, stream: Stream, settings: ExtrapolationSettings = _EXTRAPOLATION
) -> Predicted:
    """Extrapolate the variance from the variances of small sets of the sampler."""
    if not isinstance(law.source, Sampler):
        raise NoClosedForm("These points have no sampler.")
    return extrapolated(Estimator(known.g), law.source, law.n, known, stream, settings)


def extrapolated(
    estimator: AbstractEstimator,
    sampler: Sampler,
    n: int,
    known: Known,
    stream: Stream,
    settings: ExtrapolationSettings = _EXTRAPOLATION,
) -> Predicted:
    """Fit a line to log variances measured at the small counts closest to n, but not at n."""
    # Use counts near n for which point sets are as regular as sets of n points.
    # If n is a power of two, the counts near n are also powers of two.
    # For any other n, the counts differ from n by multiples of a power of two that divides n
    step = min(n & -n, 1 << max(0, (n // settings.near).bit_length() - 1))
    near = [n + k * step for k in (-2, -1, 1, 2)]
    if n & (n - 1) == 0:
        near = [n // 4, n // 2, 2 * n, 4 * n]
    near = [c for c in near if 1 < c <= settings.largest and not known.g.costly]
    counts = {sampler.nearest_count(c): c in near for c in (*settings.small, *near)}
    by_distance = sorted(counts, key=lambda count: (abs(math.log(count / n)), count))
    found: list[tuple[int, Moments]] = []
    for count in by_distance:
        if count == n or len(found) == settings.fitted:
            continue
        with contextlib.suppress(CountError):
            # For a single technique, `nearest_count` already gives a count that the sampler allows.
            # Checking an allowed count a second time would only repeat warnings
            if sum(estimator.counts) > 1:
                estimator.check_sampler(sampler, count)
            close = counts[count]
            sets = (
                max(settings.near_sets, settings.near_points // count) if close else settings.sets
            )
            moments = known.once(
                ("measured", sampler.spec, count, sets),
                functools.partial(
                    count_moments, estimator, sampler, count, sets, count_stream(stream, count)
                ),
            )
            if (moments.resolved & (moments.variance > rounding_floor(moments.mean))).all():
                found.append((count, moments))
    if len(found) < settings.fitted - 1:
        raise NoClosedForm(
            f"No method predicts {sampler.spec}, and its small sets are too few or have no "
            "variance."
        )

    # Assume that the scatter about the fitted line is at least the error of the measurements
    from scipy.special import stdtrit

    x = np.log([float(count) for count, _ in found])
    y = np.log([moments.variance for _, moments in found])
    noise = np.array([moments.relative_se for _, moments in found])
    middle, spread = x.mean(), ((x - x.mean()) ** 2).sum()
    slope = ((x - middle)[:, None] * y).sum(axis=0) / spread
    left = y - y.mean(axis=0) - slope * (x - middle)[:, None]
    degrees = len(x) - 2
    scatter = np.sqrt((left**2).sum(axis=0) / degrees)
    size = np.maximum(scatter, np.sqrt((noise**2).mean(axis=0)))
    away = math.log(n) - middle
    half = stdtrit(degrees, 0.975) * size * math.sqrt(1.0 + 1.0 / len(x) + away**2 / spread)
    variance = np.exp(y.mean(axis=0) + slope * away)
    error = variance * np.expm1(np.minimum(half, math.log(settings.most_factor)))
    listed = ", ".join(str(count) for count in sorted(count for count, _ in found))
    return Predicted(variance, error, f"from measurements at {listed}", 0.0, variance)


@final
@dataclass(frozen=True, kw_only=True)
class Method:
    """A method to compute or measure the variance.

    Attributes
    ----------
    name, summary
        Name of the method, and short description of its computation.
    predict
        Function that predicts the variance of the mean of g over points with a given law.
        The function predicts one technique; if it does not apply, it raises `NoClosedForm`.
        Methods that only predict whole estimators have None here.
    applies
        Whether ``auto`` tries the method for given points and a given g; g is not evaluated.
        A method requested by name is always tried.
    ahead
        Whether ``auto`` tries the method at larger counts than requested, to find the limit rate.
        The method must be cheap at large n and draw no sets, but it may compute facts about g.
    enough
        Largest half width of a 95 % interval, relative to the variance, that ``auto`` accepts.
        If ``auto`` accepts a prediction, it does not try the next method.
    cost
        Approximate or largest number of evaluations of g. Several counts may share evaluations.
    of_estimator
        Function that predicts the variance of a whole estimator.
        If the user requests a method that cannot predict single techniques, this function is used.
    realized
        Whether the method uses realizations of the estimates. Methods share realizations.
    """

    name: str
    summary: str
    predict: Callable[[Law, Known, Stream], Predicted] | None = None
    applies: Callable[[Law, Known], bool] = lambda *_: False
    ahead: Callable[[Law, Known], bool] = lambda *_: False
    enough: Callable[[Law, Known], float] = lambda *_: math.inf
    cost: Callable[[Law, Known], float] = lambda *_: 0.0
    of_estimator: Callable[[AbstractEstimator, Sampler, int, Prediction, Stream], Cells] | None = (
        None
    )
    realized: bool = False


def _mirrored(law: Law) -> bool:
    """Return whether points are folded or mirrored. Methods then use the set before this step."""
    return isinstance(law, Folded | Mirrored) and not law.inner.fixed


def _one_offset(law: Law) -> bool:
    """Return whether `of_torus` is cheap at large n because no sets are drawn."""
    return isinstance(law, Independent) or (isinstance(law, Shifted) and law.inner.fixed)


def _latin(law: Law) -> bool:
    """Return whether points are a Latin hypercube in several dims.

    For a Latin hypercube, the variance of a sum of functions of single axes is known exactly.
    """
    return isinstance(law, PairedAxes) and law.latin and law.dims > 1


def _moves_apply(law: Law, known: Known) -> bool:
    """Return whether it is worthwhile to evaluate g at random offsets of a set."""
    return moves_resolve(law, known) or (not known.costly and moves_at_once(law))


def _enough_of_sums(law: Law, known: Known) -> float:
    """Return the largest relative error with which sums of products are accepted as a prediction.

    A sum of products may miss jumps and kinks of the integrand.
    """
    if _moves_apply(law, known):
        return _AUTO.moved
    # The variance of a lattice at one count does not predict its variance at nearby counts
    leaf = leaf_of(law)
    return math.inf if isinstance(leaf, Fixed) and leaf.even else _AUTO.measured


def _cost_of_quadrature(law: Law, known: Known) -> float:  # noqa: ARG001
    orders = orders_of(law.n, law.dims)
    return min(
        _QUADRATURE_SETTINGS.evaluations, law.n * float(sum(order**law.dims for order in orders))
    )


def _exactly(
    estimator: AbstractEstimator, sampler: Sampler, n: int, asked: Prediction, _: Stream
) -> Cells:
    """Return `exact_variance`, with the error of its quadrature."""
    value, error = estimated_variance(estimator, sampler, n, asked.tolerance)
    low, high = np.maximum(value - error, 0.0), value + error
    width = max(1, estimator.channels)
    return Cells.row("exact", "quadrature", value, low, high, channels=width)


def _checked(
    check: Callable[[AbstractEstimator, Sampler, int, Terms, Stream], Cells],
) -> Callable[[AbstractEstimator, Sampler, int, Prediction, Stream], Cells]:
    """Adapt a cross-check, so that it takes the same arguments as a method of prediction.

    The cross-check is called with a `variance_terms` analysis instead of the prediction.
    The analysis has the half width and the number of realizations of the prediction.
    """

    def of_estimator(
        estimator: AbstractEstimator, sampler: Sampler, n: int, asked: Prediction, stream: Stream
    ) -> Cells:
        terms = terms_for(estimator, n, asked.half_width, asked.realizations)
        return check(estimator, sampler, n, terms, stream)

    return of_estimator


_QUADRATURE = Method(
    name="exact",
    summary="closed form, or quadrature over strata or levels, as in `exact_variance`",
    predict=of_quadrature,
    applies=lambda _, known: not known.costly,
    ahead=lambda _, known: lines_suffice(known),
    cost=_cost_of_quadrature,
    of_estimator=_exactly,
)

METHODS: tuple[Method, ...] = (
    _QUADRATURE,
    Method(
        name="exact",
        summary="infinite where ∫g² diverges",
        predict=of_divergence,
        applies=lambda law, _: law.uniform,
        ahead=lambda law, _: law.uniform,
        cost=lambda *_: _AUTO.square,
    ),
    Method(
        name="torus",
        summary="sum of |g_m|² times the power, for points that are the same after any translation",
        predict=of_torus,
        applies=lambda law, known: law.stationary and not moves_resolve(law, known),
        ahead=lambda law, known: _one_offset(law) and not moves_resolve(law, known),
        cost=lambda _, known: (
            _AUTO.square + _AUTO.coefficients * (known.given.fourier_source != "exact")
        ),
    ),
    Method(
        name="levels",
        summary="means of g over cells, for strata and scrambled nets",
        predict=of_levels,
        applies=lambda law, known: not moves_resolve(law, known),
        ahead=lambda law, known: not (_one_offset(law) or _latin(law) or moves_resolve(law, known)),
        cost=lambda *_: _AUTO.tables,
    ),
    # A quadrature evaluates g again at every count. Tables are as precise and serve all counts
    replace(
        _QUADRATURE,
        applies=lambda law, known: (
            known.costly and not (_mirrored(law) or moves_resolve(law, known))
        ),
        ahead=lambda *_: False,
    ),
    Method(
        name="subsets",
        summary="energies between strata of one, two and three axes, for orthogonal arrays",
        predict=of_arrays,
        applies=lambda law, known: is_array(law) and not known.costly,
        enough=lambda *_: _AUTO.measured,
        cost=lambda *_: _AUTO.tables + evaluations(),
    ),
    Method(
        name="subsets",
        summary="single axes and sums of products of functions of one axis",
        predict=of_subsets,
        applies=lambda law, known: not (_mirrored(law) or moves_resolve(law, known)),
        ahead=lambda law, _: _latin(law),
        enough=_enough_of_sums,
        cost=lambda *_: _AUTO.tables,
    ),
    Method(
        name="moves",
        summary="shifts or scrambles of one set, drawn by predict itself",
        predict=of_moves,
        applies=_moves_apply,
        ahead=moves_resolve,
        cost=cost_of_moves,
    ),
    Method(
        name="table",
        summary="sets of the sampler on a table of g",
        predict=of_table,
        applies=lambda law, known: not (known.costly or _mirrored(law)),
        cost=lambda law, _: float(_TABLE.cells.get(law.dims, 0) ** law.dims + _TABLE.probe),
    ),
    Method(
        name="extrapolated",
        summary="a line through variances measured at other counts",
        predict=of_measurements,
        applies=lambda law, _: not _mirrored(law),
        cost=lambda *_: float(
            _EXTRAPOLATION.fitted
            * max(_EXTRAPOLATION.near_points, _EXTRAPOLATION.sets * _EXTRAPOLATION.small[-1])
        ),
    ),
    Method(
        name="pair-correlation",
        summary="pairs of points, known or counted, without frequencies",
        of_estimator=_checked(of_pairs),
    ),
    Method(
        name="covariance",
        summary="sum over pairs of frequencies, the covariance of coefficients in closed form",
        of_estimator=_checked(of_covariance),
    ),
    Method(
        name="homogenized",
        summary="sum of |f_m|² times the power, in closed form or from realizations",
        of_estimator=_checked(of_homogenized),
        realized=True,
    ),
    Method(name="terms", summary="dc, power and cross term of `variance_terms`", realized=True),
    Method(name="measured", summary="sample variance of the estimates at n", realized=True),
)
"""All methods. The most trusted prediction comes first. A name may occur several times."""

NAMES = tuple(dict.fromkeys(method.name for method in METHODS))
"""Names of methods in the order of `METHODS`."""

_LIMIT = "limit"
"""Internal name of the method ``auto`` at counts beyond the requested counts."""


def tried(name: str, law: Law, known: Known) -> list[Method]:
    """Return the methods of this name for one technique, with the most trusted method first."""
    usable = [method for method in METHODS if method.predict is not None]
    if name == "auto":
        return [method for method in usable if method.applies(law, known)]
    if name == _LIMIT:
        return [method for method in usable if method.ahead(law, known)]
    return [method for method in usable if method.name == name]


_METHOD = Meta(
    description="auto: the most trusted method that applies; all: every method side by side; or "
    "the name of a method.",
    extra={"choices": ("auto", "all", *NAMES)},
)


@final
class Prediction(Counted, frozen=True, kw_only=True):
    """Variance and rate at every n, predicted from the integrand and the sampler."""

    function = "predict"
    verb = "predict"
    pictured = True
    several = ("sampler",)
    variables = (
        *("predicted_variance", "predicted_variance_ci", "energy_share", "tail_variance"),
        *("local_rate", "predicted_rate", "limit_rate", "bend_n"),
    )
    provenance = ("method",)

    counts: Annotated[Counts, COUNTS]
    method: Annotated[str, _METHOD] = "auto"
    tolerance: Annotated[
        float,
        Meta(
            ge=1e-12,
            le=1.0,
            description="Largest relative error of a variance by the method exact.",
        ),
    ] = EXACT_TOLERANCE
    half_width: Annotated[
        Annotated[int, HALF_WIDTH] | None,
        Meta(
            description="Largest frequency along each axis in the methods covariance, homogenized "
            "and terms. The default depends on n and the integrand.",
        ),
    ] = None
    realizations: Annotated[
        int,
        Meta(
            ge=4,
            le=MAX_REALIZATIONS,
            description="Realizations in the methods pair-correlation, homogenized, terms and "
            "measured.",
            extra={"flag": "-m", "metavar": "R"},
        ),
    ] = 1000

    @property
    def _names(self) -> tuple[str, ...]:
        return NAMES if self.method == "all" else (self.method,)

    @property
    def _realized(self) -> bool:
        return any(method.realized for method in METHODS if method.name in self._names)

    def limit(self, subject: Subject) -> int | None:
        """Return the maximum number of evaluations of functions.

        By default, only the methods auto and extrapolated limit evaluations of users' functions.
        Evaluations of integrands of this package are not limited by default.
        """
        chosen = self.method in ("auto", "extrapolated")
        if self.max_evaluations is None and chosen and subject.estimator.is_black_box:
            return LIMITS.evaluations
        return self.max_evaluations

    def _measures(self, subject: Subject) -> bool:
        """Return whether evaluations suffice only for measurements at small counts."""
        limit = self.limit(subject)
        enough = LIMITS.predictions * len(subject.estimator.counts)
        if limit is None or limit >= enough or not subject.estimator.is_black_box:
            return False
        return self.method in ("auto", "extrapolated")

    def need(self, subject: Subject) -> Need:
        """Check that every sampler allows every count, and that the spectra fit in memory."""
        estimator, samplers, names = subject.estimator, subject.samplers, self._names
        if self._measures(subject):
            for sampler in samplers:
                for n in self.counts:
                    estimator.check_sampler(sampler, n)
            limit, least = self.limit(subject) or 0, 0
            for sampler in samplers:
                counts = _small_counts(estimator, sampler, self.counts[-1])
                sets = len(samplers) * LIMITS.least_sets / (1.0 - LIMITS.probe)
                needed = sets * estimator.cost * sum(counts[: LIMITS.least_counts])
                least = max(least, math.ceil(needed))
            memory = memory_of(self.counts[-1], estimator.dims, sum(estimator.counts))
            return Need(cost=float(limit), memory=memory, evaluations=least)
        each, sampled = sum(estimator.counts), 0
        cost, memory, known = 0.0, 0, knowledge(estimator)
        for sampler in samplers:
            for n in self.counts:
                estimator.check_sampler(sampler, n)
                cost += self._cost(estimator, sampler, n, known)
                if "pair-correlation" in names:
                    cost += 0.1 * self.realizations * each * n**2
                if self._realized:
                    _, need, _ = self._terms(Subject(estimator, sampler), n)
                    cost, memory = cost + need.cost, max(memory, need.memory)
                    sampled += 0 if self.method == "homogenized" else need.evaluations
        memory += _MEMORY + memory_of(self.counts[-1], estimator.dims, each)
        return Need(cost=cost, memory=memory, evaluations=sampled)

    def _cost(
        self, estimator: AbstractEstimator, sampler: Sampler, n: int, known: Sequence[Known]
    ) -> float:
        """Return the number of evaluations of the requested methods.

        If the method is ``auto``, only the method that would be tried first is counted.
        """
        source, cost = estimator.randomized(sampler), 0.0
        for count, each in zip(estimator.counts, known, strict=True):
            law = source.law(n * count)
            for name in self._names:
                first = tried(name, law, each)[:1]
                cost += max([_OVERHEAD, *(method.cost(law, each) for method in first)])
        return cost

    def _terms(self, subject: Subject, n: int) -> tuple[Terms, Need, str]:
        """Return the analysis that samples spectra, its time and memory, and a text.

        If the analysis cannot include frequencies, the text says why. Otherwise the text is empty.
        """
        asked = terms_for(subject.estimator, n, self.half_width, self.realizations)
        without, refusal = msgspec.structs.replace(asked, half_width=0), ""
        if self.method != "measured":
            try:
                return asked, asked.need(subject), ""
            except ParameterError as error:  # The frequencies are too many or need too much memory
                if self.method != "all":
                    raise
                refusal = str(error)
        return without, without.need(subject), refusal

    def reduction(self, subject: Subject, stream: Stream) -> Steps:
        """Yield a block for each sampler, method and count. Sampled methods share realizations."""
        estimator, samplers, names = subject.estimator, subject.samplers, self._names
        auto, channels = self.method == "auto", max(1, estimator.channels)
        of_estimator = {method.name: method.of_estimator for method in reversed(METHODS)}
        predictor = Predictor(estimator, stream)
        if self._measures(subject):
            limit = self.limit(subject) or 0
            predictor = _measuring(estimator, samplers, self.counts[-1], limit, stream, auto)
        own, other = (Stream.from_rng(np.random.SeedSequence([stream.key, k])) for k in (0, 1))

        # Find the counts of each sampler. Method auto adds counts that show the limit of the rate.
        # A count of 0 marks an unused place in the list
        counts = [_places(s, self.counts) if auto else [0, *self.counts, 0, 0] for s in samplers]
        wanted = [(s, name, n) for s, each in enumerate(counts) for name in names for n in each]
        alone = {method.name for method in METHODS if method.predict or method.of_estimator}
        places = [place for place in wanted if auto or (place[2] and place[1] in alone)]

        def of_place(index: int) -> Cells:
            place, name, n = places[index]
            sampler, answer = samplers[place], of_estimator.get(name)
            if auto:
                return predictor.at(sampler, n, name if n <= self.counts[-1] else _LIMIT)
            if answer is None or predictor.measured is not None:
                return predictor.at(sampler, n, name)
            try:
                return answer(estimator, sampler, n, self, other)
            except (NoClosedForm, ParameterError) as refusal:  # Arguments were checked earlier
                return Cells.unknown(str(refusal), channels)

        # Sample spectra and estimates for each sampler and count
        sampled = {}
        for s, sampler in enumerate(samplers):
            for n in self.counts if self._realized else ():
                terms, _, refusal = self._terms(Subject(estimator, sampler), n)
                if self.method != "homogenized" or draws_power(estimator, sampler, n):
                    reduction = terms.reduction(Subject(estimator, sampler), own)
                    sampled[s, n] = replace(reduction, key=f"{s} {n}"), refusal
        step: list[Reduction[Any]] = [reduction for reduction, _ in sampled.values()]
        if places:
            cost = _OVERHEAD * len(places) * sum(estimator.counts)
            step.append(
                Reduction(kind=Cells, block=of_place, blocks=len(places), cost=cost, key="places")
            )
        states = yield step

        rows: dict[tuple[int, str, int], Cells] = {}
        if places:
            rows = {place: states[-1].at(k) for k, place in enumerate(places)}
        notes = []
        for ((s, n), (reduction, refusal)), state in zip(sampled.items(), states, strict=False):
            assert reduction.result is not None
            found = reduction.result(state)
            notes.append(str(found.attrs.get("note", "")))
            made = of_terms(found, estimator, self.realizations, rows.get((s, "homogenized", n)))
            for method, row in made.items():
                there = method == "measured" or not refusal
                rows[s, method, n] = row if there else Cells.unknown(refusal, channels)
        none = Cells.unknown("there is no such count", channels)
        cells = Cells.joined([rows.get(place, none) for place in wanted])
        return self._result(subject, predictor, counts, cells, notes)

    def _result(
        self,
        subject: Subject,
        predictor: Predictor,
        counts: list[list[int]],
        cells: Cells,
        notes: list[str],
    ) -> xr.Dataset:
        """Return a dataset of results by sampler, method and count, with rates along the counts."""
        estimator, samplers, methods = subject.estimator, subject.samplers, self._names
        auto, alone = self.method == "auto", subject.sampler is samplers[0]
        channels = max(1, estimator.channels)
        shape = (len(samplers) * len(methods), -1, channels)
        full = (len(samplers), len(methods), -1, channels)
        n = np.array([each for each in counts for _ in methods], float)

        # The rate at a count is the slope from the previous count to this count.
        # At the first count, the rate is the slope to the next count.
        # If the interval of the variance contains 0, no rate is computed at this count
        known = np.where(cells.low > 0.0, cells.variance, np.nan).reshape(shape)
        with np.errstate(invalid="ignore"):  # Variances and ends of intervals may be infinite
            half = cells.high - cells.variance
        loose = (half > _AUTO.loose * cells.variance).reshape(shape)
        known[:, 1 + len(self.counts) :][loose[:, 1 + len(self.counts) :]] = np.nan
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = np.diff(np.log(known), axis=1) / np.diff(np.log(n), axis=1)[..., None]
        slope[:, 0] = np.where(n[:, :1] > 0.0, slope[:, 0], slope[:, 1])
        asked = slice(1, 1 + len(self.counts))
        slowest = [predictor.slowest(s, self.counts) if auto else Slowest() for s in samplers]
        rates = [
            rates_of(n[k], known[k, :, c], asked.stop, estimator.dims, slowest[k // len(methods)])
            for k, c in np.ndindex(shape[0], shape[2])
        ]
        rate, limit, bend = np.reshape([r[:3] for r in rates], (*full[:2], channels, 3)).transpose(
            3, 0, 1, 2
        )
        seen = auto and predictor.measured is None
        if not seen:  # A limit of the rate is estimated only from counts beyond the requested ones
            limit, bend = np.full_like(limit, np.nan), np.full_like(bend, np.nan)

        # Keep only the results at requested counts
        variance, low, high, share, tail = (
            values.reshape(full)[:, :, asked]
            for values in (cells.variance, cells.low, cells.high, cells.share, cells.tail)
        )
        names, hows, why = (
            texts.reshape(full[:3])[:, :, asked]
            for texts in (cells.methods, cells.hows, cells.notes)
        )

        # Collect the notes. If all methods are requested, only `how` explains missing values
        said = list(dict.fromkeys(filter(None, notes)))
        if predictor.measured is not None and predictor.curves is None:
            said.append(
                f"measured at small counts with at most {self.limit(subject)} evaluations; a "
                f"prediction may need {LIMITS.predictions * len(estimator.counts)}; raise "
                "max_evaluations to allow it"
            )
        if self.method not in ("auto", "all", "exact") and np.isnan(variance).all():
            reasons = list(dict.fromkeys(map(str, why.ravel())))
            if VANISHES not in reasons:
                raise NoClosedForm(
                    f"The method {self.method} does not apply to {estimator.spec} with "
                    f"{samplers[0].spec}: {reasons[0]}; use another, or method='auto'."
                )
        if self.method != "all":
            limits = [
                [r[3] for r in rates[k : k + channels] if seen]
                for k in range(0, len(rates), channels)
            ]
            said += [
                note if alone else f"{s.spec}: {note}"
                for s, each, more in zip(samplers, why, limits, strict=True)
                for note in dict.fromkeys(filter(None, [*map(str, each.ravel()), *more]))
            ]
        each = ("sampler", "method", "n", "channel")
        by = tuple(dim for dim in each[:3] if dim != "sampler" or not alone)
        drop = ["sampler"] * alone + ["channel"] * (not estimator.channels)
        names, hows = (texts[0] if alone else texts for texts in (names, hows))
        coords = {
            "n": coordinate("n", list(self.counts), "number of points"),
            "bound": ["low", "high"],
            "sampler": [s.spec for s in samplers],
            "method": list(methods),
        }
        if self.method != "all":
            place = by.index("method")
            by = tuple(dim for dim in by if dim != "method")
            names, hows = (np.take(texts, 0, place) for texts in (names, hows))
            coords["method"] = by, names, {"long_name": "method of the prediction"}
            drop.append("method")
        about = {"long_name": "details of the method, or why it gave no value"}
        coords["how"] = by, hows, about
        rated = ("sampler", "method", "channel")
        return dataset(
            {
                "predicted_variance": (each, variance),
                "predicted_variance_ci": ((*each, "bound"), np.stack([low, high], axis=-1)),
                "energy_share": (each, share),
                "tail_variance": (each, tail),
                "local_rate": (each, slope.reshape(full)[:, :, : len(self.counts)]),
                "predicted_rate": (rated, rate),
                "limit_rate": (rated, limit),
                "bend_n": (rated, bend),
            },
            {name: values for name, values in coords.items() if name != "sampler" or not alone},
            drop=drop,
            estimator=estimator.spec,
            sampler=samplers[0].spec if alone else None,
            note="; ".join(said) or None,
        )


def predict(
    estimator: Any,
    samplers: Any,
    counts: Sequence[int],
    *,
    dims: int | None = None,
    method: str = "auto",
    tolerance: float = EXACT_TOLERANCE,
    half_width: int | None = None,
    realizations: int = 1000,
    rng: RngLike = 0,
    max_evaluations: int | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Predict the variance and its rate from properties of f and of the samplers.

    Parameters
    ----------
    estimator
        An estimator. For plain sampling, an integrand or its spec string is enough.
        A vectorized function of points (…, d) is also accepted.
    samplers
        One sampler or a list without duplicates.
    counts
        Ascending numbers of points n that every sampler allows.
    dims
        Number of dims of a function, and of a spec without ``dims``.
        The default is the number of dims of the sampler, unless the sampler is a spec.
    method
        ``"auto"`` is the most trusted method that applies.
        ``"all"`` predicts the variance by every method, and adds the dim ``method``.
        Every other value is the name of one method of `METHODS`:

        * ``"exact"``: a closed form, or quadrature over strata or levels, as in `exact_variance`
        * ``"torus"``: Σ|g_m|² times the power, for points that are the same after any translation
        * ``"levels"``: means of g over cells, for strata and scrambled nets
        * ``"subsets"``: sums of functions of one axis and of products of such functions
        * ``"moves"``: random shifts or scrambles of a single set
        * ``"table"``: sets of the sampler on a table of g
        * ``"extrapolated"``: a line through variances measured at other counts
        * ``"pair-correlation"``: pairs of points, known or counted, without frequencies
        * ``"covariance"``: Σ conj(f_m) f_l C_ml with closed-form C_ml, for at most 625 frequencies
        * ``"homogenized"``: Σ|f_m|² times the power, in closed form or from realizations
        * ``"terms"``: the sum of the terms of `variance_terms`
        * ``"measured"``: the sample variance of the estimates at n
    tolerance
        For the method exact, the largest relative error of the variance.
    half_width
        Half width for the methods covariance, homogenized and terms.
        These methods sum over the frequencies m in {−half_width … half_width}^d.
        The default is the half width of `variance_terms`.
    realizations
        Realizations for the methods pair-correlation, homogenized, terms and measured.
        Standard errors need at least 4 realizations.
    rng
        Seed (SPEC 7) of methods that draw sets.
        The methods ``pair-correlation`` and ``measured`` draw different sets.
    workers
        Number of threads. The default is all processors. It has no effect on results.
    max_evaluations
        Maximum number of evaluations of the integrand.
        By default ``auto`` and ``extrapolated`` evaluate users' functions at most 2^18 times.
        With 2^18 evaluations, variances are computed if f/p is a sum or product of functions of
        one axis. Otherwise variances are only measured at small n and extrapolated.
        Extrapolated variances have wider intervals than other predictions.
        With 2^24 or more evaluations for each technique, ``auto`` also tries methods that predict.
        A method raises before it starts if it is known to need more than the limit.

    Returns
    -------
    xarray.Dataset
        ``predicted_variance(n)`` has the 95 % interval ``predicted_variance_ci(n, bound)``.

        ``energy_share(n)`` is the part of ∫g² that a method sums term by term.
        For methods that sum over frequencies, the share is the part of ∫f² at these frequencies.
        For methods without a sum over frequencies, the share is 1.
        ``tail_variance(n)`` is the part of the variance that comes from the rest of ∫g².

        ``local_rate(n)`` is the slope from the count before.
        At the first count, ``local_rate`` is the slope to the next count.
        If the interval of the variance reaches 0, ``local_rate`` is NaN at this count.
        ``predicted_rate`` is the slope over all counts, fitted as in `convergence`.
        ``limit_rate`` is the exponent that rates tend to.
        ``bend_n`` is the n at which the rate changes from the rate at small n to ``limit_rate``.
        ``bend_n`` is given if the rate at small n and ``limit_rate`` differ by more than 0.3.
        ``limit_rate`` and ``bend_n`` are NaN if unknown or if `method` is not ``"auto"``.

        The coordinate ``method`` is the name of the method at each n. ``"none"`` means no value.
        With ``"all"``, ``method`` is a dim.
        The coordinate ``how`` has details of each value, such as the number of sets.
        If a value is missing, ``how`` has the reason.
        A list of samplers adds the dim ``sampler``, and several channels add the dim ``channel``.
        A variance at rounding level is NaN, and the attribute ``note`` reports it.
        For a variance at rounding level, the method exact returns 0.


    Raises
    ------
    CountError, ParameterError
        If a sampler does not allow a count, dims disagree, or counts are not ascending.
    NoClosedForm
        If one method other than exact is requested, and it applies to no sampler at any n.

    Notes
    -----
    All methods cut f at jumps across an axis, which line searches detect.
    The quadrature nodes are compared with 2^17 probe points, and the difference widens intervals.
    If f is equal at all probe points, it has no prediction, unless its integral is known.

    f is evaluated at quadrature nodes and on grids that `predict` chooses.
    The method ``moves`` applies up to 8,192 random shifts or scrambles to a fixed set.
    Lattices with shift and nets with digital-shift use ``moves`` in 1 to 3 dims.
    Other shifted or scrambled sets are predicted from a fit of g by sums of products.
    If the fit gives an interval wider than ± 3 %, ``moves`` is used instead of the fit.
    For ``moves``, nested scrambles are replaced by linear scrambles.
    Pairs of points have the same distribution in linear and nested scrambles.

    For samplers without known structure, in 1 to 3 dims, the method ``table`` is used.
    The method ``table`` measures variances on a table of f.
    In more dims, or for expensive f, ``auto`` uses the method ``extrapolated``.
    The method ``extrapolated`` evaluates f at 2,000 realizations of each small count.
    If f is cheap, counts close to n are used instead, but never n itself.
    Jumps and kinks across many axes can make the interval of a prediction wide.
    An interval is wide if it exceeds a fifth of the predicted variance.
    If the interval is wide, the variance is also measured from realizations of the estimate.
    The prediction or the measurement is then used, whichever has the narrower interval.

    The limit of the rate is known in theory for random points, and for jumps in up to 5 dims.
    Random points have the limit −1.
    Strata of the cube and jumps along curves have the limit −1 − 1/d.
    For other sets the limit is −2 if g jumps across an axis, except for jumps at cell borders.
    A theoretical limit is used if the last slopes are at least as steep.

    If theory gives no limit, the slopes over the last octaves must agree.
    The last octave ends at 4 times the largest requested count; for strata, it ends at n = 2^16.
    Counts above the requested ones are used only in 1 to 3 dims, if no sets have to be drawn.
    If the slopes agree, the limit is the theoretical exponent near the slopes.
    The theoretical exponents are −2, −3, and −1 − k/d for integers k.
    If a constant slope is near no theoretical exponent, the slope itself is the limit.
    If the slopes do not agree, ``limit_rate`` is NaN and the attribute ``note`` has the last rates.
    Jumps of less than 1e-4 of g are not detected.


    Examples
    --------
    >>> import mcspectra as mcs
    >>> found = mcs.predict("disk", ["random", "jittered | shift"], [64, 256])
    >>> [round(float(rate), 1) for rate in found["predicted_rate"]]
    [-1.0, -1.5]
    >>> by_method = mcs.predict("gaussian", "jittered", [64], method="all", realizations=100)
    >>> two = by_method["predicted_variance"].loc[{"method": ["exact", "levels"], "n": 64}]
    >>> two.values.round(7)
    array([5.98e-05, 5.98e-05])
    """
    subject = as_subject(estimator, samplers, dims=dims, lists=True)
    return compute(Prediction.of(locals()), subject, rng, workers)


def knowledge(estimator: AbstractEstimator) -> list[Known]:
    """Return an empty `Known` for the integrand of each technique. Nothing is evaluated yet."""
    return [Known(estimator.primary_integrand(t)) for t in range(len(estimator.counts))]


@final
class Predictor:
    """Predicts the variance of one estimator at many counts, with integrand facts in a cache."""

    def __init__(
        self,
        estimator: AbstractEstimator,
        stream: Stream,
        measured: Mapping[str, ExtrapolationSettings] | None = None,
        probed: int = 0,
        curves: Sequence[Sequence[Separable]] | None = None,
    ) -> None:
        """Set up the predictions of an estimator.

        If `measured` is given, variances are measured. It maps each sampler to its settings.
        Before the measurements, the integrands are evaluated `probed` times at random points.
        If `curves` are given for each technique, variances are computed from them instead.
        """
        self.estimator, self.measured, self.curves = estimator, measured, curves
        self._probed, self._known = probed, knowledge(estimator)
        self._stream = stream

    def at(self, sampler: Sampler, n: int, name: str = "auto") -> Cells:
        """Predict the variance at n points, summed over the techniques. NaN if no method applies.

        The argument `name` selects the methods that are tried; see `tried`.
        """
        estimator = self.estimator
        source, width = estimator.randomized(sampler), max(1, estimator.channels)
        total = np.full((4, width), math.nan)
        note, used, how = "", "none", ""
        try:
            if not n:
                raise NoClosedForm("there is no such count")
            if source.law(n).fixed:
                raise NoClosedForm(f"a deterministic sampler {NO_VARIANCE}")
            known, stream = self._known, self._stream
            if self.measured is not None:
                if self.curves is not None and name != _LIMIT:
                    with contextlib.suppress(NoClosedForm):
                        return self._of_curves(source, n)
                if name == _LIMIT:  # Larger counts than requested are not measured
                    raise NoClosedForm("a measurement does not extend beyond the requested counts")
                reason, lost = known[0].once("doubt", self._doubted) or ("", False)
                if lost:
                    raise NoClosedForm(reason)
                found = extrapolated(
                    estimator, sampler, n, known[0], stream, self.measured[sampler.spec]
                )
                high = found.variance + found.error
                # On a logarithmic scale, both interval ends are equally far from the variance
                low = found.variance**2 / high
                if reason:
                    high = np.full_like(high, math.inf)
                return Cells.row(
                    *("extrapolated", found.how, found.variance, low, high),
                    share=0.0,
                    tail=found.variance,
                    note=reason,
                    channels=width,
                )
            said = [each.constant for each in known]
            if all(said):
                raise NoClosedForm(said[0])
            # Predict each technique. If the techniques depend on each other, predict all together
            try:
                estimator.check_independent()
            except NoClosedForm:
                if name not in ("auto", "extrapolated"):
                    raise
                found = extrapolated(estimator, source, n, known[0], stream)
                parts = [replace(found, method="extrapolated")]
            else:
                places = enumerate(zip(estimator.counts, known, strict=True))
                parts = [
                    predicted(source.law(n * c), each, stream.child(t), name)
                    for t, (c, each) in places
                ]
            # The energy share of the sum is the mean over techniques, weighted by their ∫g²
            squares = [np.ones(len(parts[0].variance))]
            if len(parts) > 1:
                squares = [each.square[0] for each in known]
            used, how = (
                "; ".join(dict.fromkeys(texts))
                for texts in ([part.method for part in parts], [part.how for part in parts])
            )
            weights = [square / len(parts) + np.where(square > 0.0, 0.0, 1.0) for square in squares]
            with np.errstate(invalid="ignore"):
                variance, error, share, tail, weight = np.sum([
                    np.broadcast_arrays(p.variance, p.error**2, w * p.share, p.tail, w)
                    for w, p in zip(weights, parts, strict=True)
                ], axis=0)  # fmt: skip
                total = np.stack([variance, np.sqrt(error), share / weight, tail])
            if np.isinf(variance).any():
                note = "∫g² diverges: the variance is infinite"
        except (NoClosedForm, CountError) as reason:
            how = note = str(reason).rstrip(".")

        # A variance at rounding level has no correct digits
        if np.isfinite(total[0]).any():
            size = np.atleast_1d(np.asarray(estimator.integral, float))
            vanishes = total[0] <= rounding_floor(size)
            if vanishes.any():
                note = VANISHES
                total[np.ix_([0, 1, 3], vanishes)] = math.nan
        variance, error, share, tail = total
        with np.errstate(invalid="ignore"):  # Variance and error may both be infinite
            low = np.where(np.isinf(variance), np.inf, np.maximum(variance - error, 0.0))
        high = variance + error
        return Cells.row(
            used, how, variance, low, high, share=share, tail=tail, note=note, channels=width
        )

    def _of_curves(self, source: Any, n: int) -> Cells:
        """Compute the variance at n points from functions of one axis, summed over techniques."""
        assert self.curves is not None
        width = max(1, self.estimator.channels)
        value, error, rounding = np.zeros((3, width))
        for count, parts in zip(self.estimator.counts, self.curves, strict=True):
            law = as_scrambled(source.law(n * count))
            law = Independent(n=1, dims=law.dims) if law.n == 1 and law.uniform else law
            found, off = of_curves(law, parts)
            value, error = value + found, error + off
            rounding = rounding + rounding_floor(np.array([each.mean for each in parts]))
        loose = np.isfinite(value) & (error > _QUADRATURE_SETTINGS.tolerance * value)
        if (loose & (value + error > rounding)).any():
            raise NoClosedForm("The functions of one axis are not precise enough.")
        kinds = {"product" if each.product else "sum" for parts in self.curves for each in parts}
        note = "∫g² diverges: the variance is infinite" if np.isinf(value).any() else ""
        if (vanishes := value <= rounding).any():
            value, note = np.where(vanishes, np.nan, value), VANISHES
        return Cells.row(
            *("exact", f"{' or '.join(sorted(kinds))} of functions of one axis", value),
            *(np.maximum(value - error, 0.0), value + error),
            note=note,
            channels=width,
        )

    def _doubted(self) -> tuple[str, bool] | None:
        """Return why values at random points do not bound the variance; see `tails.doubt`."""
        estimator, channels = self.estimator, max(1, self.estimator.channels)
        count = max(1, self._probed // estimator.cost)
        rng, dims = self._stream.child(len(estimator.counts)).generator(0), estimator.dims
        points = [rng.random((count * c, dims)) for c in estimator.counts]
        values = [estimator.primary_values(t, u[None]) for t, u in enumerate(points)]
        flat = [v.reshape(-1, channels) for v in values]
        most = max(range(len(flat)), key=lambda t: float(flat[t].var(axis=0).max()))
        return doubt(points[0] if len(points) == 1 else None, flat[most])

    def slowest(self, sampler: Sampler, counts: Sequence[int]) -> Slowest:
        """Return the theoretical rate at large n, which is the rate of the slowest technique."""
        source, found = self.estimator.randomized(sampler), []
        if self.measured is not None:
            return Slowest()
        for count, known in zip(self.estimator.counts, self._known, strict=True):
            laws, g = [source.law(n * count) for n in counts], known.g
            if isinstance(laws[0], Folded | Mirrored):
                seen = FoldedIntegrand if isinstance(laws[0], Folded) else SymmetrizedIntegrand
                laws, g = [law.inner for law in laws], looked_at(seen(g))  # type: ignore[attr-defined]
            if not known.constant and np.isfinite(known.square[0]).all():
                found.append(slowest_of_jumps(g, laws))
        return max(found, key=lambda each: each.exponent, default=Slowest())


def predicted(law: Law, known: Known, stream: Stream, name: str) -> Predicted:
    """Predict the variance of one technique by the methods that `tried` lists for `name`.

    Return the first prediction whose interval is narrow enough, or else the narrowest prediction.
    """
    if law.n == 1 and law.uniform:  # A set of a single uniform point is a random point
        law = Independent(n=1, dims=law.dims)
    law = as_scrambled(law)
    if name == _LIMIT and isinstance(law, Shifted) and isinstance(law.inner, Strata):
        law = moved(law.inner, [_OFFSET * law.n ** (-1.0 / law.dims)] * law.dims)
    if isinstance(law, Choice):
        parts = [predicted(one, known, stream, name) for one in law.laws]
        values = np.array([part.variance for part in parts])
        spread = student_t(len(parts)) * values.std(axis=0, ddof=1) / math.sqrt(len(parts))
        error = np.hypot(np.mean([part.error for part in parts], axis=0), spread)
        return replace(parts[0], variance=values.mean(axis=0), error=error)
    if known.constant:  # g is constant for one of several techniques
        none = 0.0 * known.square[0]
        used = name if name in NAMES else NAMES[0]
        return Predicted(none, none, "the same at all points", method=used)
    # A method requested by name might return a finite number although the variance is infinite
    if name in NAMES and law.uniform and known.diverges.any():
        infinite = np.where(known.diverges, math.inf, math.nan)
        return Predicted(infinite, infinite, "∫g² = ∞", 0.0, infinite, name)

    best: Predicted | None = None
    reason = NoClosedForm(f"No method predicts {law.name}.")
    for method in tried(name, law, known):
        assert method.predict is not None
        try:
            found = replace(method.predict(law, known, stream), method=method.name)
        except NoClosedForm as refusal:
            reason = refusal
            continue
        # The error is at least the error from regions that contain probe points but no nodes
        if np.isfinite(found.variance).all():
            error = np.maximum(found.error, known.unseen / law.n)
            if not found.poles:
                error = error + known.unresolved / law.n
            found = replace(found, error=error)
        if best is None or found.error.sum() < best.error.sum():
            best = found
        enough = method.enough(law, known)
        if math.isinf(enough) or (best.error <= enough * best.variance).all():
            break
    if best is not None:
        return best
    if not _mirrored(law):
        raise reason
    return _of_the_set_inside(law, known, stream, name)


def _of_the_set_inside(law: Law, known: Known, stream: Stream, name: str) -> Predicted:
    """Predict the variance from the set before folding or mirroring, for a changed integrand.

    `mcspectra.prediction.exact` describes the integrand of the set before folding or mirroring.
    """
    assert isinstance(law, Folded | Mirrored)
    if isinstance(law, Folded):
        folded = known.once("folded", lambda: Known(FoldedIntegrand(known.g)))
        return predicted(law.inner, folded, stream, name)
    average = known.once("symmetrized", lambda: Known(SymmetrizedIntegrand(known.g)))
    found = predicted(law.inner, average, stream, name)
    if law.mode == "uniform":
        return found
    coins = np.maximum(known.square[0] - average.square[0], 0.0) / law.n
    rounding = np.hypot(found.error, (known.square[1] + average.square[1]) / law.n)
    return replace(found, variance=found.variance + coins, error=rounding)


def _measuring(
    estimator: AbstractEstimator,
    samplers: Sequence[Sampler],
    largest: int,
    limit: int,
    stream: Stream,
    auto: bool,
) -> Predictor:
    """Return a predictor that makes at most `limit` evaluations of users' functions.

    If `auto`, it first tests if the integrands are sums or products of functions of one axis.
    If the test fails at once, its evaluations are part of the evaluations at random points.
    """
    curves, used = _curves_within(estimator, limit) if auto else (None, 0)
    probed = int(LIMITS.probe * limit) - used
    if probed < used:
        limit -= used
        probed = int(LIMITS.probe * limit)
    share = int((1.0 - LIMITS.probe) * limit) // estimator.cost // len(samplers)
    measured = {s.spec: _within(_small_counts(estimator, s, largest), share) for s in samplers}
    return Predictor(estimator, stream, measured, probed, curves)


def _curves_within(
    estimator: AbstractEstimator, limit: int
) -> tuple[list[tuple[Separable, ...]] | None, int]:
    """Return functions of one axis for each technique, and the number of evaluations made.

    The search makes at most three quarters of `limit` evaluations.
    """
    counts, each = estimator.counts, 3 * limit // (4 * len(estimator.counts))
    first = _PIECEWISE.candidates + 4 * _PIECEWISE.lines * estimator.dims
    found, used = list[tuple[Separable, ...]](), 0
    if first * estimator.evaluations_per_point > LIMITS.probe * each:
        return None, 0
    with contextlib.suppress(NoClosedForm):
        estimator.check_independent()
        for technique in range(len(counts)):
            g = estimator.primary_integrand(technique)
            parts, made = separated_within(g, each, int(LIMITS.lines * limit / len(counts)))
            used += made
            if parts is None:
                return None, used
            found.append(parts)
        return found, used
    return None, used


def _small_counts(estimator: AbstractEstimator, sampler: Sampler, largest: int) -> list[int]:
    """Return allowed counts near powers of two, up to somewhat more than the largest request."""
    top = max(LIMITS.beyond * largest, LIMITS.first << LIMITS.least_counts - 1)
    counts = list[int]()
    for k in range(LIMITS.first.bit_length() - 1, top.bit_length()):
        count = sampler.nearest_count(2**k)
        with contextlib.suppress(CountError):
            estimator.check_sampler(sampler, count)
            counts += [count] * (count > 1 and count not in counts)
    return counts


def _within(counts: Sequence[int], points: int) -> ExtrapolationSettings:
    """Return settings whose measurements take `points` points in total."""
    used = list(counts)
    while len(used) > LIMITS.least_counts and points // sum(used) < LIMITS.sets:
        used.pop()
    sets = points // max(1, sum(used))
    return replace(_EXTRAPOLATION, small=tuple(used), largest=0, sets=sets, fitted=LIMITS.fitted)


def _places(sampler: Sampler, counts: Sequence[int]) -> list[int]:
    """Return a smaller count, the given counts, and two larger counts.

    A count smaller than the given one is added only if a single count is given.
    A zero in the returned list stands for a smaller or larger count that is left out.
    """
    last = counts[-1]
    half = sampler.nearest_count(max(1, last // 2)) if len(counts) == 1 else last
    ahead, leaf = [_AUTO.ahead * last], leaf_of(sampler.law(last))
    if (
        isinstance(leaf, Strata) and leaf.jittered
    ):  # For strata, large n cost little more, because one table of g serves all n
        top = sampler.dims * (_AUTO.most_ahead // sampler.dims)
        ahead = [2 ** (top - max(sampler.dims, 2)), 2**top]
    beyond = [sampler.nearest_count(n) for n in ahead if n <= 2**_AUTO.most_ahead]
    beyond = [n if n > last else 0 for n in beyond]
    return [half if half < last else 0, *counts, *beyond, *[0] * (2 - len(beyond))]
