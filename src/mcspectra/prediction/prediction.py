"""Predictions: the variance at every n by the most trusted method, by one method, or by all of them.

The first seven of `METHODS` work in primary space: each technique has its own integrand on the unit cube, and
independent techniques add up. The method ``auto`` tries them in their order of trust; the last one measures
small sets of the sampler and extrapolates, and its name says so. The others check a prediction.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, final

import msgspec
import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import Counted, Need, Reduction, Steps, Subject
from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z, student_t
from mcspectra.core.errors import CountError, NoClosedForm, ParameterError
from mcspectra.core.memory import memory_of
from mcspectra.core.options import COUNTS, HALF_WIDTH, Counts
from mcspectra.core.parallel import MAX_REALIZATIONS
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, Estimator
from mcspectra.estimators.mirrored import FoldedIntegrand, SymmetrizedIntegrand
from mcspectra.estimators.moments import Moments, rounding_floor
from mcspectra.estimators.quadrature import Pointwise, in_closed_form, looked_at, mesh
from mcspectra.integrands import Integrand
from mcspectra.measure.converge import count_moments, count_stream
from mcspectra.measure.doors import NO_VARIANCE, VANISHES, answer, counted
from mcspectra.measure.terms import Terms
from mcspectra.prediction.cross_checks import (
    draws_power,
    of_covariance,
    of_homogenized,
    of_pairs,
    of_terms,
    terms_for,
)
from mcspectra.prediction.exact import EXACT_TOLERANCE, estimated_variance, of_integrand
from mcspectra.prediction.known import Cells, Known, Predicted
from mcspectra.prediction.levels import of_levels
from mcspectra.prediction.rates import Slowest, rates_of, slowest_of_jumps
from mcspectra.prediction.separable import separated
from mcspectra.prediction.subsets import of_subsets
from mcspectra.prediction.torus import of_few_moves, of_moves, of_torus
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

__all__ = ["METHODS", "Prediction", "Predictor", "predict"]

_TOLERANCE = 0.01  # relative error of a quadrature that `auto` takes before all other methods
_MOST_BREAKS = 8  # of an integrand, with each of which offsets of strata are cut
_EVALUATIONS = 2.0**22  # of a quadrature, about a second; beyond, other methods come first
_MEMORY = 2**29  # bytes: coefficients and transforms of all regions

# Counts beyond the last one, that show the limit of rates
_AHEAD = 4  # times as many
_MOST_AHEAD = 16  # log2 of the largest
_LOOSE = 0.25  # half intervals, relative to the variance, that say nothing of rates
# Where c(1 − c), the part of jumps at faces, has its mean over all shifts
_OFFSET = 0.5 - 0.5 / 3**0.5

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


def of_quadrature(law: Law, known: Known, stream: Stream) -> Predicted:  # noqa: ARG001
    """The exact variance, to the error of its quadrature; shifted strata are cheaper on the torus."""
    g = known.g
    if known.unresolved.any() and separated(g):  # one line for each axis
        return Predicted(*of_integrand(law, g, _TOLERANCE, _EVALUATIONS), "quadrature", poles=True)
    dear = not in_closed_form(g) or sum(map(len, g.breaks)) > _MOST_BREAKS
    if g.dims > 1 and isinstance(law, Shifted) and dear:
        raise NoClosedForm("A quadrature for every offset of the strata would take long.")
    return Predicted(*of_integrand(law, g, _TOLERANCE, _EVALUATIONS), "quadrature", poles=True)


def of_limits(law: Law, known: Known, stream: Stream) -> Predicted:
    """Many points at little cost: no sets are drawn, and shifted strata have one offset, not all."""
    if np.isinf(known.square[0]).any():
        raise NoClosedForm("∫g² diverges.")
    if known.unresolved.any() and separated(known.g):
        with contextlib.suppress(NoClosedForm):
            return of_quadrature(law, known, stream)
    alone = isinstance(law, Independent) or (isinstance(law, Shifted) and law.inner.fixed)
    if alone or not isinstance(law, Shifted):
        with contextlib.suppress(NoClosedForm):
            return of_few_moves(law, known, stream)
    if alone:
        return of_torus(law, known, stream)
    if isinstance(law, Shifted) and isinstance(law.inner, Strata):
        law = moved(law.inner, [_OFFSET * law.n ** (-1.0 / law.dims)] * law.dims)
    if isinstance(law, PairedAxes) and law.latin and law.dims > 1:
        return of_subsets(law, known, stream)
    return of_levels(law, known, stream)


def of_table(law: Law, known: Known, stream: Stream) -> Predicted:
    """Measure a table of g with sets of the sampler, and add what the table leaves out.

    It holds g at the middles of fine cells, once for all samplers and counts, and is linear between them.
    What it leaves out is as fine as its cells, and counts as white: ∫(g − table)²/n.
    """
    if known.g.dims not in _TABLE:
        raise NoClosedForm("A table takes 1 to 3 dims.")
    if np.isinf(known.square[0]).any():
        raise NoClosedForm("∫g² diverges.")
    if law.source is None:
        raise NoClosedForm("These points have no sampler.")
    g, n = known.g, law.n

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
    moments = count_moments(Estimator(table), law.source, n, sets, stream)
    if not (moments.resolved & (moments.variance > rounding_floor(moments.mean))).all():
        raise NoClosedForm(f"{sets} sets do not resolve the variance of {law.name}.")
    tail = missed / n
    # Points may be as good within cells as they are beyond, or as bad as at random
    error = CONFIDENCE_Z * moments.relative_se * moments.variance + tail + miss / n
    share = 1.0 - np.minimum(missed / known.square[0], 1.0)
    return Predicted(moments.variance + tail, error, f"{sets} sets", share, tail)


def of_measurements(law: Law, known: Known, stream: Stream) -> Predicted:
    """Extrapolate the variances of the sampler's small sets."""
    if law.source is None:
        raise NoClosedForm("These points have no sampler.")
    return extrapolated(Estimator(known.g), law.source, law.n, known, stream)


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
            f"No method predicts {sampler.spec}, and its small sets show no variance or are too few."
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
    return Predicted(variance, error, f"from measurements at {listed}", 0.0, variance)


Method: TypeAlias = Callable[[Law, Known, Stream], Predicted]
Methods: TypeAlias = Sequence[tuple[str, Method]]

_AUTO: Methods = (
    ("exact", of_quadrature),
    ("moves", of_few_moves),
    ("torus", of_torus),
    ("levels", of_levels),
    ("subsets", of_subsets),
    ("moves", of_moves),
    ("table", of_table),
    ("extrapolated", of_measurements),
)
"""What `auto` tries, in the order of trust: `moves` first where it resolves a set better than the others."""

_OF_COSTLY: Methods = (*_AUTO[1:4], _AUTO[0], _AUTO[4], _AUTO[-1])
"""A quadrature evaluates an integrand anew at every count; tables, as precise, serve all counts."""

_LIMITS: Methods = (("limits", of_limits),)

_CHECKS = {
    "pair-correlation": of_pairs,
    "covariance": of_covariance,
    "homogenized": of_homogenized,
}
_SAMPLED = ("homogenized", "terms", "measured")  # from the realizations of `variance_terms`

METHODS: Mapping[str, str] = {
    "exact": "closed form, or quadrature over strata or levels, as in `exact_variance`",
    "torus": "sum of |g_m|² times the power, for points that are the same after any translation",
    "levels": "means of g over cells, for strata and scrambled nets",
    "subsets": "single axes and sums of products of functions of one axis",
    "moves": "offsets or digital shifts of one set, by a quadrature of our own",
    "table": "sets of the sampler on a table of g",
    "extrapolated": "a line through variances measured at other counts",
    "pair-correlation": "pairs of points, known or counted, without frequencies",
    "covariance": "sum over pairs of frequencies, the covariance of coefficients in closed form",
    "homogenized": "sum of |f_m|² times the power, in closed form or from realizations",
    "terms": "dc, power and cross term of `variance_terms`",
    "measured": "sample variance of the estimates at n",
}
"""Names of methods, the most trusted prediction first, and how each finds the variance."""

_WORTH = {"moves": 0.03, "table": 0.2, "extrapolated": 0.2}
"""Half intervals of sums of products, relative to the variance, that a method may narrow."""

_METHOD = Meta(
    description="auto: the most trusted method that applies; all: every method, side by side; else one "
    "by its name.",
    extra={"choices": ("auto", "all", *METHODS)},
)


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
    provenance = ("method",)

    counts: Annotated[Counts, COUNTS]
    method: Annotated[str, _METHOD] = "auto"
    tolerance: Annotated[
        float,
        Meta(
            ge=1e-12,
            le=1.0,
            description="Largest relative error of a variance of the method exact.",
        ),
    ] = EXACT_TOLERANCE
    half_width: Annotated[
        Annotated[int, HALF_WIDTH] | None,
        Meta(
            description="Half width of the methods covariance, homogenized and terms; by default that of "
            "variance.",
        ),
    ] = None
    realizations: Annotated[
        int,
        Meta(
            ge=4,
            le=MAX_REALIZATIONS,
            description="Realizations of the methods pair-correlation, homogenized, terms and measured.",
            extra={"flag": "-m", "metavar": "R"},
        ),
    ] = 1000

    @property
    def _methods(self) -> tuple[str, ...]:
        return tuple(METHODS) if self.method == "all" else (self.method,)

    def need(self, subject: Subject) -> Need:
        """Every sampler can do every count, and the spectra fit."""
        estimator, samplers, methods = subject.estimator, subject.samplers, self._methods
        each, sampled = sum(estimator.counts), 0
        cost, memory = 1e6 * len(samplers) * len(self.counts) * each, 0
        for sampler in samplers:
            for n in self.counts:
                estimator.check_sampler(sampler, n)
                if "pair-correlation" in methods:
                    cost += 0.1 * self.realizations * each * n**2
                if not set(_SAMPLED).isdisjoint(methods):
                    _, need, _ = self._terms(Subject(estimator, sampler), n)
                    cost, memory = cost + need.cost, max(memory, need.memory)
                    sampled += 0 if self.method == "homogenized" else need.evaluations
        memory += _MEMORY + memory_of(self.counts[-1], estimator.dims, each)
        return Need(cost=cost, memory=memory, evaluations=sampled)

    def _terms(self, subject: Subject, n: int) -> tuple[Terms, Need, str]:
        """The analysis behind the sampled methods, its need, and why it has no frequencies, or empty."""
        asked = terms_for(subject.estimator, n, self.half_width, self.realizations)
        without, refusal = msgspec.structs.replace(asked, half_width=0), ""
        if self.method != "measured":
            try:
                return asked, asked.need(subject), ""
            except ParameterError as error:  # too many frequencies, or too many for some memory
                if self.method != "all":
                    raise
                refusal = str(error)
        return without, without.need(subject), refusal

    def reduction(self, subject: Subject, stream: Stream) -> Steps:
        """A block for each sampler, method and count; the sampled methods share realizations."""
        estimator, samplers, methods = subject.estimator, subject.samplers, self._methods
        auto, channels = self.method == "auto", max(1, estimator.channels)
        predictor = Predictor(estimator, stream)
        own, other = (Stream.from_rng(np.random.SeedSequence([stream.key, k])) for k in (0, 1))

        # Counts of a sampler: with auto others, too, which show rates and their limit; 0 is none
        counts = [_places(s, self.counts) if auto else [0, *self.counts, 0, 0] for s in samplers]
        wanted = [(s, m, n) for s, each in enumerate(counts) for m in methods for n in each]
        places = [place for place in wanted if auto or (place[2] and place[1] not in _SAMPLED[1:])]

        def of_place(index: int) -> Cells:
            place, method, n = places[index]
            sampler = samplers[place]
            if auto:
                return predictor.at(sampler, n, _AUTO if n <= self.counts[-1] else _LIMITS)
            try:
                if method == "exact":
                    value, error = estimated_variance(estimator, sampler, n, self.tolerance)
                    low, high = np.maximum(value - error, 0.0), value + error
                    return Cells.row(method, "quadrature", value, low, high, channels=channels)
                if method in _CHECKS:
                    asked = terms_for(estimator, n, self.half_width, self.realizations)
                    return _CHECKS[method](estimator, sampler, n, asked, other)
            except (NoClosedForm, ParameterError) as refusal:  # arguments were checked before
                return Cells.unknown(str(refusal), channels)
            return predictor.at(sampler, n, [each for each in _AUTO if each[0] == method][-1:])

        # Spectra and estimates of realizations, for each sampler and count
        sampled = {}
        for s, sampler in enumerate(samplers):
            for n in self.counts if not set(_SAMPLED).isdisjoint(methods) else ():
                terms, _, refusal = self._terms(Subject(estimator, sampler), n)
                if self.method != "homogenized" or draws_power(estimator, sampler, n):
                    reduction = terms.reduction(Subject(estimator, sampler), own)
                    sampled[s, n] = replace(reduction, key=f"{s} {n}"), refusal
        step: list[Reduction[Any]] = [reduction for reduction, _ in sampled.values()]
        if places:
            cost = 1e6 * len(places) * sum(estimator.counts)
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
        """The dataset of cells by sampler, method and count, with rates along the counts."""
        estimator, samplers, methods = subject.estimator, subject.samplers, self._methods
        auto, alone = self.method == "auto", subject.sampler is samplers[0]
        channels = max(1, estimator.channels)
        shape = (len(samplers) * len(methods), -1, channels)
        full = (len(samplers), len(methods), -1, channels)
        n = np.array([each for each in counts for _ in methods], float)

        # Rates from the count before, of the first one to the next; not of intervals that reach 0
        known = np.where(cells.low > 0.0, cells.variance, np.nan).reshape(shape)
        with np.errstate(invalid="ignore"):  # both infinite
            half = cells.high - cells.variance
        loose = (half > _LOOSE * cells.variance).reshape(shape)
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
        if not auto:  # no count beyond those asked for shows where rates tend to
            limit, bend = np.full_like(limit, np.nan), np.full_like(bend, np.nan)

        # Leave out the counts that were not asked for
        variance, low, high, share, tail = (
            values.reshape(full)[:, :, asked]
            for values in (cells.variance, cells.low, cells.high, cells.share, cells.tail)
        )
        names, hows, why = (
            texts.reshape(full[:3])[:, :, asked]
            for texts in (cells.methods, cells.hows, cells.notes)
        )

        # What is to be said: with all methods their reasons stand in `how` alone
        said = list(dict.fromkeys(filter(None, notes)))
        if self.method not in ("auto", "all", "exact") and np.isnan(variance).all():
            reasons = list(dict.fromkeys(map(str, why.ravel())))
            if VANISHES not in reasons:
                raise NoClosedForm(
                    f"The method {self.method} does not apply to {estimator.spec} with "
                    f"{samplers[0].spec}: {reasons[0]}; use another, or method='auto'."
                )
        if self.method != "all":
            limits = [
                [r[3] for r in rates[k : k + channels] if auto]
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
            "n": counted("n", list(self.counts), "number of points"),
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
        about = {"long_name": "how the method found the variance, or why it did not"}
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
    """Predict the variance and its rate from what is known of f and of the samplers.

    Parameters
    ----------
    estimator
        An estimator or, for plain sampling, an integrand, its spec string, or a vectorised function of
        points (…, d).
    samplers
        One or a list, no sampler twice.
    counts
        Numbers of points n, ascending; each must be one that every sampler can do.
    dims
        Number of dims of a function, and of a spec that leaves it open; by default those of a sampler
        that is not a spec.
    method
        ``"auto"``: the most trusted method that applies; ``"all"``: every method, side by side, on a dim
        ``method``; or one of these names, from `METHODS`.

        * ``"exact"``: a closed form, or quadrature over strata or levels, as in `exact_variance`
        * ``"torus"``: Σ|g_m|² times the power, for points that are the same after any translation
        * ``"levels"``: means of g over cells, for strata and scrambled nets
        * ``"subsets"``: single axes and sums of products of functions of one axis
        * ``"moves"``: offsets or digital shifts of one set, by a quadrature of our own
        * ``"table"``: sets of the sampler on a table of g
        * ``"extrapolated"``: a line through variances measured at other counts
        * ``"pair-correlation"``: pairs of points, known or counted, without frequencies
        * ``"covariance"``: Σ conj(f_m) f_l C_ml, with C_ml in closed form, of 625 frequencies at most
        * ``"homogenized"``: Σ|f_m|² times the power, in closed form or from realizations
        * ``"terms"``: the sum of the terms of `variance_terms`
        * ``"measured"``: the sample variance of the estimates at n
    tolerance
        Largest relative error of a variance by the method exact.
    half_width
        Of the methods covariance, homogenized and terms, which sum over the frequencies m in
        {−half_width … half_width}^d; by default as in `variance_terms`.
    realizations
        Of the methods pair-correlation, homogenized, terms and measured; at least 4, which standard
        errors take.
    rng
        Seed (SPEC 7), of methods that draw sets. Pairs are counted in other sets than those that are
        measured.
    workers
        Threads; all processors by default. Results do not depend on it.
    max_evaluations
        Most evaluations of the integrand: what takes more is refused, where that is known before it starts.

    Returns
    -------
    xarray.Dataset
        ``predicted_variance(n)`` with its 95 % interval ``predicted_variance_ci(n, bound)``;
        ``energy_share(n)``, the part of ∫g² (of ∫f² for sums over frequencies) that was counted term by
        term, 1 for methods without one; ``tail_variance(n)``, the part
        of the variance that stands for the rest; ``local_rate(n)``, the slope from the count before (at
        the first, to the next); ``predicted_rate``, the slope over all counts, as `convergence` fits
        it; ``limit_rate``, the exponent that rates tend to, and ``bend_n``, where a line of this slope
        meets that of smaller n, if the two differ by more than 0.3: both NaN where they are not known,
        and where `method` is not ``"auto"``. Counts whose interval reaches 0 have no rates.

        The coordinate ``method`` is the name of the method at each n, ``"none"`` where there is no value;
        with ``"all"`` it is a dim. The coordinate ``how`` has details, such as the number of sets, or the
        reason why there is no value. A list adds the dim sampler, several channels the dim channel.
        Where there is no variance, or no more than rounding, it is NaN, and the attribute ``note`` says so;
        the method exact gives 0 there.

    Raises
    ------
    CountError, ParameterError
        A sampler cannot do a count, dims disagree, counts are not ascending.
    NoClosedForm
        A single method, other than exact, applies to no sampler at any n.

    Notes
    -----
    Methods of predictions cut f at jumps across an axis that lines see, and no interval is narrower than what a
    probe of 2^17 points saw and the nodes did not; f that is the same at all of them has no prediction,
    unless its integral is known.

    f is evaluated at nodes and on grids of our own. Lattices with shift and nets with digital-shift, which one
    offset moves as a whole, are moved by up to 8,192 offsets of our own (`moves`): in 1 to 3 dims, and in more
    where sums of products leave a half interval over 3 %. Of samplers of which nothing is known but their sets,
    these measure a `table` of f in 1 to 3 dims; in more, or where f is expensive, `auto` evaluates f at their
    points (`extrapolated`): 2,000 realizations each of small
    counts, or of those next to n where f is not expensive, never of n. So it is, too, where jumps and kinks
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
    >>> by_method = mcs.predict("gaussian", "jittered", [64], method="all", realizations=100)
    >>> two = by_method["predicted_variance"].loc[{"method": ["exact", "levels"], "n": 64}]
    >>> two.values.round(7)
    array([5.98e-05, 5.98e-05])
    """
    return answer(Prediction, locals())


@final
class Predictor:
    """Predicts one estimator at many counts; what is known of its integrands is found once."""

    def __init__(self, estimator: AbstractEstimator, stream: Stream) -> None:
        self.estimator = estimator
        self._known = [Known(estimator.primary_integrand(t)) for t in range(len(estimator.counts))]
        self._stream = stream

    def at(self, sampler: Sampler, n: int, methods: Methods = _AUTO) -> Cells:
        """The prediction of one count: the sum over the techniques; NaN where no method applies."""
        estimator = self.estimator
        source, width = estimator.randomized(sampler), max(1, estimator.channels)
        total = np.full((4, width), math.nan)
        note, name, how = "", "none", ""
        try:
            if not n:
                raise NoClosedForm("there is no such count")
            if source.law(n).fixed:
                raise NoClosedForm(f"a deterministic sampler {NO_VARIANCE}")
            known, stream = self._known, self._stream
            said = [each.constant for each in known]
            if all(said):
                raise NoClosedForm(said[0])
            # The predictions of all techniques, together where they depend on each other
            try:
                estimator.check_independent()
            except NoClosedForm:
                if methods[-1][0] != "extrapolated":
                    raise
                found = extrapolated(estimator, source, n, known[0], stream)
                parts = [replace(found, method="extrapolated")]
            else:
                places = enumerate(zip(estimator.counts, known, strict=True))
                parts = [
                    _by_methods(source.law(n * c), each, stream.child(t), methods)
                    for t, (c, each) in places
                ]
            # What their shares weigh
            squares = [np.ones(len(parts[0].variance))]
            if len(parts) > 1:
                squares = [each.square[0] for each in known]
            name, how = (
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

        # A variance at rounding level has no digits
        if np.isfinite(total[0]).any():
            size = np.atleast_1d(np.asarray(estimator.integral, float))
            vanishes = total[0] <= rounding_floor(size)
            if vanishes.any():
                note = VANISHES
                total[np.ix_([0, 1, 3], vanishes)] = math.nan
        variance, error, share, tail = total
        with np.errstate(invalid="ignore"):  # both infinite
            low = np.where(np.isinf(variance), np.inf, np.maximum(variance - error, 0.0))
        high = variance + error
        return Cells.row(
            name, how, variance, low, high, share=share, tail=tail, note=note, channels=width
        )

    def slowest(self, sampler: Sampler, counts: Sequence[int]) -> Slowest:
        """What theory knows of the rate at large n: of several techniques the slowest."""
        source, found = self.estimator.randomized(sampler), []
        for count, known in zip(self.estimator.counts, self._known, strict=True):
            laws, g = [source.law(n * count) for n in counts], known.g
            if isinstance(laws[0], Folded | Mirrored):
                seen = FoldedIntegrand if isinstance(laws[0], Folded) else SymmetrizedIntegrand
                laws, g = [law.inner for law in laws], looked_at(seen(g))  # type: ignore[attr-defined]
            if not known.constant and np.isfinite(known.square[0]).all():
                found.append(slowest_of_jumps(g, laws))
        return max(found, key=lambda each: each.exponent, default=Slowest())


def _by_methods(law: Law, known: Known, stream: Stream, methods: Methods) -> Predicted:
    """The first method that applies to a law; mirrored points see another integrand."""
    n = law.n
    if n == 1 and law.uniform:  # one point, which is as at random
        law = Independent(n=1, dims=law.dims)
    law = as_scrambled(law)
    if isinstance(law, Choice):
        parts = [_by_methods(one, known, stream, methods) for one in law.laws]
        values = np.array([part.variance for part in parts])
        spread = student_t(len(parts)) * values.std(axis=0, ddof=1) / math.sqrt(len(parts))
        error = np.hypot(np.mean([part.error for part in parts], axis=0), spread)
        return replace(parts[0], variance=values.mean(axis=0), error=error)
    if methods is _AUTO and known.g.costly:
        methods = _OF_COSTLY
    if known.constant:  # a technique of several
        none = 0.0 * known.square[0]
        return Predicted(none, none, "the same at all points", method=methods[0][0])
    # A method that is asked for by its name might give a number
    if len(methods) == 1 and methods is not _LIMITS and law.uniform and known.diverges.any():
        infinite = np.where(known.diverges, math.inf, math.nan)
        return Predicted(infinite, infinite, "∫g² = ∞", 0.0, infinite, methods[0][0])
    best, leaf = None, leaf_of(law)
    lattice = isinstance(leaf, Fixed) and leaf.even
    for place, (name, method) in enumerate(methods):
        # Where products miss jumps and kinks across many axes the narrower interval counts; but of
        # lattices, a count tells nothing of those next to it
        if best is not None:
            good = (best.error <= _WORTH.get(name, math.inf) * best.variance).all()
            if good or (lattice and name == "extrapolated"):
                continue
        try:
            found = replace(method(law, known, stream), method=name)
            # One method may see what others do not: none knows more than the probe
            if np.isfinite(found.variance).all():
                error = np.maximum(found.error, known.unseen / n)
                if not found.poles:
                    error = error + known.unresolved / n
                found = replace(found, error=error)
            if best is None or found.error.sum() < best.error.sum():
                best = found
            if name != "subsets":
                return best
        except NoClosedForm as error:
            reason = error
        if place == 0 and best is None:
            if law.uniform and np.isinf(known.square[0]).any():
                infinite = np.where(np.isinf(known.square[0]), math.inf, math.nan)
                return Predicted(infinite, infinite, "∫g² = ∞", 0.0, infinite, "exact")
            if isinstance(law, Folded | Mirrored) and not law.inner.fixed:
                # The prediction of the set inside with another integrand (`mcspectra.prediction.exact`)
                if isinstance(law, Folded):
                    folded = known.once("folded", lambda: Known(FoldedIntegrand(known.g)))
                    return _by_methods(law.inner, folded, stream, methods)
                average = known.once("symmetrized", lambda: Known(SymmetrizedIntegrand(known.g)))
                found = _by_methods(law.inner, average, stream, methods)
                if law.mode == "uniform":
                    return found
                coins = np.maximum(known.square[0] - average.square[0], 0.0) / n
                rounding = np.hypot(found.error, (known.square[1] + average.square[1]) / n)
                return replace(found, variance=found.variance + coins, error=rounding)
    if best is not None:
        return best
    raise reason


def _places(sampler: Sampler, counts: Sequence[int]) -> list[int]:
    """A count before a single one, the counts, and two beyond them; 0 where there is none."""
    last = counts[-1]
    half = sampler.nearest_count(max(1, last // 2)) if len(counts) == 1 else last
    ahead, leaf = [_AHEAD * last], leaf_of(sampler.law(last))
    if (
        isinstance(leaf, Strata) and leaf.jittered
    ):  # which are cheap where one table has the cells of all
        top = sampler.dims * (_MOST_AHEAD // sampler.dims)
        ahead = [2 ** (top - max(sampler.dims, 2)), 2**top]
    beyond = [sampler.nearest_count(n) for n in ahead if n <= 2**_MOST_AHEAD]
    beyond = [n if n > last else 0 for n in beyond]
    return [half if half < last else 0, *counts, *beyond, *[0] * (2 - len(beyond))]
