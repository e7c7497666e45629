"""Predictions: the variance at every n, without measuring it, by the route that is trusted most.

Everything happens in primary space: each technique has its own integrand on the unit cube, and
independent techniques add up. `ROUTES` are tried in their order; what comes last measures small sets of
the sampler and goes on from there, and is named so.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeAlias, final

import numpy as np

from mcspectra.core.analysis import Counted, Need, Reduction, Subject
from mcspectra.core.checks import Array
from mcspectra.core.errors import CountError, NoClosedForm
from mcspectra.core.memory import memory_of
from mcspectra.core.options import COUNTS, Counts
from mcspectra.core.records import JOIN
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, Estimator
from mcspectra.estimators.mirrored import FoldedIntegrand, SymmetrizedIntegrand
from mcspectra.estimators.moments import CONFIDENCE_Z, Moments, rounding_floor
from mcspectra.integrands import Integrand
from mcspectra.samplers import (
    Jittered,
    Mirror,
    Owen,
    Random,
    Sampler,
    Shift,
    StrataShift,
)
from mcspectra.samplers.base import FixedSet, Structure
from mcspectra.samplers.stratified import root
from mcspectra.spectra.bases import parts_of, without_last
from mcspectra.variance.convergence import count_moments, count_stream
from mcspectra.variance.doors import NO_VARIANCE, VANISHES, answer, counted
from mcspectra.variance.exact import of_integrand
from mcspectra.variance.prediction.known import Known, Predicted
from mcspectra.variance.prediction.levels import of_levels
from mcspectra.variance.prediction.rates import Slowest, rates_of, slowest_of_jumps
from mcspectra.variance.prediction.subsets import of_subsets
from mcspectra.variance.prediction.torus import of_moves, of_torus
from mcspectra.variance.quadrature import Pointwise, in_closed_form, looked_at, mesh

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ROUTES", "Cells", "Prediction", "Predictor", "predict"]

_TOLERANCE = 0.01  # relative error of a quadrature that is taken before all other routes
_MOST_BREAKS = 8  # of an integrand, with each of which offsets of strata are cut
_EVALUATIONS = 2.0**22  # of a quadrature, about a second; beyond, other routes come first
_MEMORY = 2**29  # bytes: coefficients and transforms of all regions

# Counts beyond the last one, that show the limit of rates
_AHEAD = 4  # times as many
_MOST_AHEAD = 16  # log2 of the largest
_LOOSE = 0.25  # half intervals, relative to the variance, that say nothing of rates
# Where c(1 − c), the part of jumps at faces, has its mean over all shifts
_OFFSET = 0.5 - 0.5 / 3**0.5

_SETS, _T_SETS = 16, 2.13  # of pmj, that are scrambled; Student's t of their mean

# Tables, at the middles of cells
_TABLE = {1: 2**16, 2: 2**10, 3: 100}  # cells along each axis
_PROBE = 2**16  # points, random, at which a table is held against g
_BLOCK = 2**16  # points at a time
_POINTS = 2**22  # of all sets together, about a second
_LEAST_SETS, _MOST_SETS = 200, 10_000

# Measured extrapolation
_SMALL = tuple(2**k for k in range(3, 9))
_LARGEST = 2**12  # count, of f that is cheap
_NEAR = 16  # parts of n, by which counts next to it are apart at most
_FITTED = 4
_REALIZATIONS = 2000  # sets of a count
_NEAR_SETS, _NEAR_POINTS = 1000, 2**20  # of those next to n, and their points: what is more
_MOST_FACTOR = 30.0  # by which an extrapolation may be off at most


def of_quadrature(sampler: Sampler, n: int, known: Known, stream: Stream) -> Predicted:  # noqa: ARG001
    """The exact variance, to the error of its quadrature; shifted strata are cheaper on the torus."""
    g, (_, steps) = known.g, parts_of(sampler)
    dear = not in_closed_form(g) or sum(map(len, g.breaks)) > _MOST_BREAKS
    if g.dims > 1 and any(isinstance(s, Shift) for s in steps) and dear:
        raise NoClosedForm("A quadrature for every offset of the strata would take long.")
    return Predicted(*of_integrand(sampler, n, known.g, _TOLERANCE, _EVALUATIONS), "exact")


def of_limits(sampler: Sampler, n: int, known: Known, stream: Stream) -> Predicted:
    """Many points at little cost: no sets are drawn, and shifted strata have one offset, not all."""
    if np.isinf(known.square[0]).any():
        raise NoClosedForm("∫g² diverges.")
    base, steps = parts_of(sampler)
    if base.name == "random" or (base.fixed and len(steps) == 1 and steps[0].stationary):
        return of_torus(sampler, n, known, stream)
    if isinstance(base, Jittered) and any(isinstance(step, Shift) for step in steps):
        sampler = base.then(StrataShift(offset=_OFFSET))
    if base.name == "latin-hypercube" and sampler.dims > 1:
        return of_subsets(sampler, n, known, stream)
    return of_levels(sampler, n, known, stream)


def of_table(sampler: Sampler, n: int, known: Known, stream: Stream) -> Predicted:
    """Measure a table of g with sets of the sampler, and add what the table leaves out.

    It holds g at the middles of fine cells, once for all samplers and counts, and is linear between them.
    What it leaves out is as fine as its cells, and counts as white: ∫(g − table)²/n.
    """
    if known.g.dims not in _TABLE:
        raise NoClosedForm("A table takes 1 to 3 dims.")
    if np.isinf(known.square[0]).any():
        raise NoClosedForm("∫g² diverges.")
    g = known.g

    def tabulated() -> tuple[Integrand, Array, Array]:
        """A table of g, and ∫(g − table)² with half its 95 % interval, by channel."""
        from scipy.interpolate import RegularGridInterpolator

        axes = [(np.arange(_TABLE[g.dims]) + 0.5) / _TABLE[g.dims]] * g.dims
        nodes = mesh(*axes)
        flat = nodes.reshape(-1, g.dims)
        blocks = [g(flat[i : i + _BLOCK]) for i in range(0, len(flat), _BLOCK)]
        values = np.concatenate(blocks).reshape(*nodes.shape[:-1], *[g.channels] * (g.channels > 0))
        linear = RegularGridInterpolator(axes, values, bounds_error=False, fill_value=None)
        table = Pointwise(g, linear, ((),) * g.dims, f"a table of {g.spec}")
        probe = np.random.default_rng(0).random((_PROBE, g.dims))
        missed = ((g(probe) - table(probe)) ** 2).reshape(_PROBE, -1)
        error = CONFIDENCE_Z * missed.std(axis=0, ddof=1) / math.sqrt(_PROBE)
        return table, missed.mean(axis=0), error

    table, missed, miss = known.once("table", tabulated)
    sets = min(max(_POINTS // n, _LEAST_SETS), _MOST_SETS)
    moments = count_moments(Estimator(table), sampler, n, sets, stream)
    if not (moments.resolved & (moments.variance > rounding_floor(moments.mean))).all():
        raise NoClosedForm(f"{sets} sets do not tell the variance of {sampler.spec}.")
    tail = missed / n
    # Points may be as good within cells as they are beyond, or as bad as at random
    error = CONFIDENCE_Z * moments.relative_se * moments.variance + tail + miss / n
    share = 1.0 - np.minimum(missed / known.square[0], 1.0)
    return Predicted(moments.variance + tail, error, f"{sets} sets on a table of g", share, tail)


def of_measurements(sampler: Sampler, n: int, known: Known, stream: Stream) -> Predicted:
    """Extrapolate the variances of the sampler's small sets."""
    return extrapolated(Estimator(known.g), sampler, n, known, stream)


def extrapolated(
    estimator: AbstractEstimator, sampler: Sampler, n: int, known: Known, stream: Stream
) -> Predicted:
    """A line through the logarithms of variances measured at the small counts nearest to n, without n."""
    # Counts about n that sets fill as n: of a power of two others, else in steps of one that divides n
    step = min(n & -n, 1 << max(0, (n // _NEAR).bit_length() - 1))
    near = [n + k * step for k in (-2, -1, 1, 2)]
    if n & (n - 1) == 0:
        near = [n // 4, n // 2, 2 * n, 4 * n]
    near = [c for c in near if 1 < c <= _LARGEST and not known.g.costly]
    counts = {sampler.nearest_count(c): c in near for c in (*_SMALL, *near)}
    by_distance = sorted(counts, key=lambda count: (abs(math.log(count / n)), count))
    found: list[tuple[int, Moments]] = []
    for count in by_distance:
        if count == n or len(found) == _FITTED:
            continue
        with contextlib.suppress(CountError):
            if sum(estimator.counts) > 1:  # one has its nearest counts, without more warnings
                estimator.check_sampler(sampler, count)
            close = counts[count]
            sets = max(_NEAR_SETS, _NEAR_POINTS // count) if close else _REALIZATIONS
            moments = known.once(
                ("measured", sampler.spec, count, sets),
                functools.partial(
                    count_moments, estimator, sampler, count, sets, count_stream(stream, count)
                ),
            )
            if (moments.resolved & (moments.variance > rounding_floor(moments.mean))).all():
                found.append((count, moments))
    if len(found) < _FITTED - 1:
        raise NoClosedForm(
            f"No route predicts {sampler.spec}, and its small sets show no variance or are too few."
        )

    # The scatter about the line is at least that of the measurements
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
    error = variance * np.expm1(np.minimum(half, math.log(_MOST_FACTOR)))
    listed = ", ".join(str(count) for count in sorted(count for count, _ in found))
    route = f"extrapolated from measurements at {listed}"
    return Predicted(variance, error, route, 0.0, variance)


Route: TypeAlias = Callable[[Sampler, int, Known, Stream], Predicted]

ROUTES: tuple[Route, ...] = (
    of_quadrature,
    of_torus,
    of_levels,
    of_subsets,
    of_moves,
    of_table,
    of_measurements,
)
"""In the order of trust."""

_OF_COSTLY = (of_torus, of_levels, of_quadrature, of_subsets, of_measurements)
"""A quadrature asks an integrand anew at every count; tables, as precise, serve all of them."""

_WORTH: dict[Route, float] = {of_moves: 0.03, of_table: 0.2, of_measurements: 0.2}
"""Half intervals of sums of products, relative to the variance, that a route may narrow."""


@final
class Prediction(Counted, frozen=True, kw_only=True):
    """Variance and rate at every n, predicted from what is known of f and of the sampler."""

    function = "predict"
    verb = "predict"
    several = ("sampler",)
    variables = (
        *("predicted_variance", "predicted_variance_ci", "energy_share", "tail_variance"),
        *("local_rate", "predicted_rate", "limit_rate", "bend_n"),
    )

    counts: Annotated[Counts, COUNTS]

    def need(self, subject: Subject) -> Need:
        """Every sampler can do every count."""
        estimator, samplers = subject.estimator, subject.samplers
        for sampler in samplers:
            for n in self.counts:
                estimator.check_sampler(sampler, n)
        evaluations = sum(estimator.counts)
        memory = _MEMORY + memory_of(self.counts[-1], estimator.dims, evaluations)
        return Need(cost=1e6 * len(samplers) * len(self.counts) * evaluations, memory=memory)

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[Cells]:
        """One sampler after the other, one count after the other."""
        estimator, samplers = subject.estimator, subject.samplers
        predictor = Predictor(estimator, stream)
        places = [(s, n) for s in samplers for n in _places(s, self.counts)]

        def of_place(index: int) -> Cells:
            sampler, n = places[index]
            return predictor.at(sampler, n, ROUTES if n <= self.counts[-1] else (of_limits,))

        def result(found: Cells) -> xr.Dataset:
            shape = (len(samplers), -1, found.variance.shape[1])
            n = np.array([_places(s, self.counts) for s in samplers], float)

            # Rates from the count before, of the first one to the next; not of intervals that reach 0
            known = np.where(found.ends()[0] > 0.0, found.variance, np.nan).reshape(shape)
            loose = (found.error > _LOOSE * found.variance).reshape(shape)
            known[:, 1 + len(self.counts) :][loose[:, 1 + len(self.counts) :]] = np.nan
            with np.errstate(divide="ignore", invalid="ignore"):
                slope = np.diff(np.log(known), axis=1) / np.diff(np.log(n), axis=1)[..., None]
            slope[:, 0] = np.where(n[:, :1] > 0.0, slope[:, 0], slope[:, 1])
            asked = slice(1, 1 + len(self.counts))
            slowest = [predictor.slowest(each, self.counts) for each in samplers]
            rates = [
                rates_of(n[s], known[s, :, c], asked.stop, estimator.dims, slowest[s])
                for s, c in np.ndindex(shape[0], shape[2])
            ]
            rate, limit, bend = np.reshape([r[:3] for r in rates], (shape[0], -1, 3)).transpose(
                2, 0, 1
            )

            # Leave out the counts that were not asked for
            variance, share, tail, low, high = (
                values.reshape(shape)[:, asked]
                for values in (found.variance, found.share, found.tail, *found.ends())
            )
            routes, notes = (
                texts.reshape(shape[:2])[:, asked] for texts in (found.routes, found.notes)
            )
            alone = subject.sampler is samplers[0]
            whys = [[r[3] for r in rates[k : k + shape[2]]] for k in range(0, len(rates), shape[2])]
            said = [
                note if alone else f"{s.spec}: {note}"
                for s, each, why in zip(samplers, notes, whys, strict=True)
                for note in dict.fromkeys(filter(None, [*map(str, each), *why]))
            ]
            each = ("sampler", "n", "channel")
            values = {
                "predicted_variance": (each, variance),
                "predicted_variance_ci": ((*each, "bound"), np.stack([low, high], axis=-1)),
                "energy_share": (each, share),
                "tail_variance": (each, tail),
                "local_rate": (each, slope[:, : len(self.counts)]),
                "predicted_rate": (("sampler", "channel"), rate),
                "limit_rate": (("sampler", "channel"), limit),
                "bend_n": (("sampler", "channel"), bend),
            }
            about = {"long_name": "how the variance was predicted"}
            by = ("n",) if alone else ("sampler", "n")
            return dataset(
                values,
                {
                    "n": counted("n", list(self.counts), "number of points"),
                    "bound": ["low", "high"],
                    "route": (by, routes[0] if alone else routes, about),
                    **({} if alone else {"sampler": [s.spec for s in samplers]}),
                },
                drop=["sampler"] * alone + ["channel"] * (not estimator.channels),
                estimator=estimator.spec,
                sampler=samplers[0].spec if alone else None,
                note="; ".join(said) or None,
            )

        return Reduction(
            kind=Cells,
            block=of_place,
            blocks=len(places),
            cost=self.need(subject).cost,
            result=result,
        )


@final
@dataclass(frozen=True)
class Cells:
    """Of samplers and counts, (N, channels or 1), with the route and what is to be said, (N,)."""

    variance: JOIN
    error: JOIN
    share: JOIN
    tail: JOIN
    routes: JOIN
    notes: JOIN

    def ends(self) -> tuple[Array, Array]:
        """Ends of the 95 % intervals."""
        with np.errstate(invalid="ignore"):  # both infinite
            low = np.maximum(self.variance - self.error, 0.0)
        return np.where(np.isinf(self.variance), np.inf, low), self.variance + self.error


def predict(
    estimator: Any,
    samplers: Any,
    counts: Sequence[int],
    *,
    rng: RngLike = 0,
    max_evaluations: int | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Predict the variance and its rate from what is known of f and of the samplers.

    Parameters
    ----------
    estimator
        An estimator, or an integrand or its spec string, for plain sampling.
    samplers
        One or a list, no sampler twice.
    counts
        Numbers of points n, ascending; each must be one that every sampler can do.
    rng
        Seed (SPEC 7), of routes that draw sets.
    workers
        Threads; all processors by default. Results do not depend on it.
    max_evaluations
        Most evaluations of the integrand: what takes more is refused, where that is known before it starts.

    Returns
    -------
    xarray.Dataset
        ``predicted_variance(n)`` with its 95 % interval ``predicted_variance_ci(n, bound)``;
        ``energy_share(n)``, the part of ∫g² that was counted term by term; ``tail_variance(n)``, the part
        of the variance that stands for the rest; ``local_rate(n)``, the slope from the count before (at
        the first, to the next); ``predicted_rate``, the slope over all counts, as `convergence` fits
        it; ``limit_rate``, the exponent that rates tend to, and ``bend_n``, where a line of this slope
        meets that of smaller n, if the two differ by more than 0.3: both NaN where they are not known.
        Counts whose interval reaches 0 have no rates. The
        coordinate ``route`` names how each n was predicted: `ROUTES` in their order, quadratures of costly
        integrands after tables. A list adds the dim sampler, several channels the dim channel. Where there is no variance, or no more than rounding,
        it is NaN, and the attribute ``note`` says so.

    Raises
    ------
    CountError, ParameterError
        A sampler cannot do a count, dims disagree, counts are not ascending.

    Notes
    -----
    All routes cut f at jumps across an axis that lines see, and no interval is narrower than what a
    probe of 2^17 points saw and the nodes did not; f that is the same at all of them has no prediction,
    unless its integral is known.

    f is evaluated at nodes and on grids of our own. Lattices with shift and nets with digital-shift, which one
    offset moves as a whole, are moved by up to 8,192 offsets of our own (`offsets of a lattice`, `digital
    shifts of the net`): in 1 to 3 dims, and in more where sums of products leave a half interval over 3 %. Of samplers of which nothing is known but their sets,
    these measure a table of f in 1 to 3 dims (`n sets on a table of g`); in more, or where f is dear, the last
    route evaluates f at their points, *extrapolated from measurements*: 2,000 realisations each of small
    counts, or of those next to n where f is not dear, never of n. So it is, too, where jumps and kinks
    across many axes leave sums of products an interval wider than a fifth, if it gives the narrower one.

    Limits are known in theory for random points, −1, and at jumps of g in up to 5 dims: −1 − 1/d for strata
    of the cube and for jumps along curves, −2 for other sets at jumps across an axis that are not at
    borders of their cells at all counts. They stand where the last slopes are no slower. Else slopes over
    the last octaves must agree, up to 4 times the last count, of strata up to n = 2^16, where that needs no
    drawn sets (1 to 3 dims); they stand for the exponent of theory that is near them, −1 − k/d, −2 or −3,
    and for themselves where there is none and they do not change. Where they do not agree ``limit_rate``
    is NaN and the attribute ``note`` has the last rates. Jumps of less than 1e-4 of g are not seen.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> found = mcs.predict("disk", ["random", "jittered | shift"], [64, 256])
    >>> [round(float(rate), 1) for rate in found["predicted_rate"]]
    [-1.0, -1.5]
    """
    return answer(Prediction, locals())


@final
class Predictor:
    """Predicts one estimator at many counts; what is known of its integrands is found once."""

    def __init__(self, estimator: AbstractEstimator, stream: Stream) -> None:
        self.estimator = estimator
        self._known = [Known(estimator.primary_integrand(t)) for t in range(len(estimator.counts))]
        self._stream = stream

    def at(self, sampler: Sampler, n: int, routes: tuple[Route, ...] = ROUTES) -> Cells:
        """The prediction of one count: the sum over the techniques; NaN where no route leads there."""
        estimator = self.estimator
        source, width = estimator.randomized(sampler), max(1, estimator.channels)
        total = np.full((4, width), math.nan)
        note, route = "", "none"
        try:
            if not n:
                raise NoClosedForm("there is no such count")
            if source.as_chain(n).fixed:
                raise NoClosedForm(f"a deterministic sampler {NO_VARIANCE}")
            known, stream = self._known, self._stream
            said = [each.constant for each in known]
            if all(said):
                raise NoClosedForm(said[0])
            # The predictions of all techniques, together where they depend on each other
            try:
                estimator.check_independent()
            except NoClosedForm:
                if routes is not ROUTES:
                    raise
                parts = [extrapolated(estimator, source, n, known[0], stream)]
            else:
                places = enumerate(zip(estimator.counts, known, strict=True))
                parts = [
                    _by_routes(source.as_chain(n * c), n * c, each, stream.child(t), routes)
                    for t, (c, each) in places
                ]
            # What their shares weigh
            squares = [np.ones(len(parts[0].variance))]
            if len(parts) > 1:
                squares = [each.square[0] for each in known]
            route = "; ".join(dict.fromkeys(part.route for part in parts))
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
            note = str(reason).rstrip(".")

        # A variance of rounding size is none
        if np.isfinite(total[0]).any():
            size = np.atleast_1d(np.asarray(estimator.integral, float))
            vanishes = total[0] <= rounding_floor(size)
            if vanishes.any():
                note = VANISHES
                total[np.ix_([0, 1, 3], vanishes)] = math.nan
        variance, error, share, tail = total[:, None]
        return Cells(variance, error, share, tail, np.array([route]), np.array([note]))

    def slowest(self, sampler: Sampler, counts: Sequence[int]) -> Slowest:
        """What theory knows of the rate at large n: of several techniques the slowest."""
        source, found = self.estimator.randomized(sampler), []
        for count, known in zip(self.estimator.counts, self._known, strict=True):
            chain = source.as_chain(counts[-1] * count)
            steps = parts_of(chain)[1]
            g = known.g
            if steps and isinstance(steps[-1], Mirror):
                chain = without_last(chain)
                seen = FoldedIntegrand if steps[-1].mode == "fold" else SymmetrizedIntegrand
                g = looked_at(seen(g))
            if not known.constant and np.isfinite(known.square[0]).all():
                found.append(slowest_of_jumps(g, chain, [n * count for n in counts]))
        return max(found, key=lambda each: each.exponent, default=Slowest())


def _by_routes(
    sampler: Sampler, n: int, known: Known, stream: Stream, routes: tuple[Route, ...]
) -> Predicted:
    """The first route that leads somewhere; points that are mirrored last see another integrand."""
    if n == 1 and sampler.unbiased:  # one point, which is as at random
        sampler = Random(dims=sampler.dims)
    if sets := _scrambled_sets(sampler, n):
        parts = [_by_routes(one.then(Owen()), n, known, stream, routes) for one in sets]
        values = np.array([part.variance for part in parts])
        spread = _T_SETS * values.std(axis=0, ddof=len(sets) > 1) / math.sqrt(len(sets))
        error = np.hypot(np.mean([part.error for part in parts], axis=0), spread)
        return replace(parts[0], variance=values.mean(axis=0), error=error)
    base, steps = parts_of(sampler)
    if routes is ROUTES and known.g.costly:
        routes = _OF_COSTLY
    if known.constant:  # a technique of several
        none = 0.0 * known.square[0]
        return Predicted(none, none, "the same at all points")
    best = None
    lattice = base.fixed and base.structure is Structure.TORUS
    for route in routes:
        # Where products miss jumps and kinks across many axes the narrower interval counts; but of
        # lattices, a count tells nothing of those next to it
        if best is not None:
            good = (best.error <= _WORTH.get(route, math.inf) * best.variance).all()
            if good or (lattice and route is of_measurements):
                continue
        try:
            found = route(sampler, n, known, stream)
            # One route may see what others do not: none knows more than the probe
            if np.isfinite(found.variance).all():
                found = replace(found, error=np.maximum(found.error, known.unseen / n))
            if best is None or found.error.sum() < best.error.sum():
                best = found
            if route is not of_subsets:
                return best
        except NoClosedForm as error:
            reason = error
        if route is routes[0]:
            if sampler.unbiased and np.isinf(known.square[0]).any():
                infinite = np.where(np.isinf(known.square[0]), math.inf, math.nan)
                return Predicted(infinite, infinite, "∫g² = ∞", 0.0, infinite)
            if steps and isinstance(steps[-1], Mirror) and (steps[:-1] or not base.fixed):
                # The prediction of the sampler inside with another integrand (`mcspectra.variance.exact`)
                inner, mode = without_last(sampler), steps[-1].mode
                if mode == "fold":
                    folded = known.once("folded", lambda: Known(FoldedIntegrand(known.g)))
                    return _by_routes(inner, n, folded, stream, routes)
                average = known.once("symmetrized", lambda: Known(SymmetrizedIntegrand(known.g)))
                if mode == "uniform":
                    return _by_routes(inner, n >> known.g.dims, average, stream, routes)
                found = _by_routes(inner, n, average, stream, routes)
                coins = np.maximum(known.square[0] - average.square[0], 0.0) / n
                rounding = np.hypot(found.error, (known.square[1] + average.square[1]) / n)
                return replace(found, variance=found.variance + coins, error=rounding)
    if best is not None:
        return best
    raise reason


@final
@dataclass(frozen=True, kw_only=True)
class _OneSet(FixedSet):
    """One set of a sampler, all sets of which are scrambles of it in a base."""

    name: ClassVar[str] = "one-set"
    structure: ClassVar[Structure] = Structure.DIGITS
    sampler: Sampler
    base: int
    dims: int
    seed: int

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """The base, along each axis."""
        return (self.base,) * self.dims

    def _set(self, n: int) -> Array:
        return np.asarray(self.sampler.draw_stream(n, Stream.from_rng(self.seed), 0, 1)[0])


def _scrambled_sets(sampler: Sampler, n: int) -> list[Sampler]:
    """Sets that have the law of the sampler's once they are scrambled with owen, as many as it takes.

    Arrays of strength 2 whose s-ths are shared out at random [Tang1993]_, as multi-jittered is for
    n = s², are nets in base s: the second digits are permuted within each first one. pmj and pmj02 are
    scrambled by their making [Helmer2021]_; of pmj which digits agree is random.
    """
    inner, steps = parts_of(sampler)
    name, jitter = inner.name, getattr(inner, "jitter", "multi-jittered")
    strong = getattr(inner, "strength", 1) == 2 and jitter == "multi-jittered"
    side = root(n, 2)
    if any(step.name != "shuffle" for step in steps):
        return []
    if (strong or name == "multi-jittered") and side**2 == n > 1:
        count, base = 1, side
    elif name == "pmj" or (name == "pmj02" and n & (n - 1) == 0):
        count, base = _SETS if name == "pmj" else 1, 2
    else:
        return []
    return [_OneSet(sampler=sampler, base=base, dims=sampler.dims, seed=k) for k in range(count)]


def _places(sampler: Sampler, counts: Sequence[int]) -> list[int]:
    """A count before a single one, the counts, and two beyond them; 0 where there is none."""
    last = counts[-1]
    half = sampler.nearest_count(max(1, last // 2)) if len(counts) == 1 else last
    base, _ = parts_of(sampler)
    ahead = [_AHEAD * last]
    if isinstance(base, Jittered):  # which are cheap where one table has the cells of all
        top = sampler.dims * (_MOST_AHEAD // sampler.dims)
        ahead = [2 ** (top - max(sampler.dims, 2)), 2**top]
    beyond = [sampler.nearest_count(n) for n in ahead if n <= 2**_MOST_AHEAD]
    beyond = [n if n > last else 0 for n in beyond]
    return [half if half < last else 0, *counts, *beyond, *[0] * (2 - len(beyond))]
