"""Alignment of strata with edges: variance against their offset, and the offset that is best.

A stratum that an edge cuts into shares s and 1 − s has the variance s(1 − s) of the jump, one whose
border is the edge has none. A fixed offset moves strata on the torus (``strata-shift``), and for edges
whose places are known `aligned-strata` bends them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array, as_choice, as_integer, as_reals
from mcspectra.core.errors import NoClosedForm, ParameterError
from mcspectra.core.fits import fit_rates
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.densities import AlignedStrata
from mcspectra.estimators import AbstractEstimator, Estimator, as_estimator, as_subject
from mcspectra.estimators.moments import rounding_floor, variance_interval
from mcspectra.integrands import Integrand
from mcspectra.measure.converge import count_moments, count_stream
from mcspectra.measure.doors import counted
from mcspectra.prediction.exact import exact_variance
from mcspectra.samplers import Sampler, StrataShift
from mcspectra.samplers.law import Shifted

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["aligned", "best_alignment", "strata_shift_scan"]

METHODS = ("auto", "exact", "measured")
_MOST_OFFSETS = 4096
_DEFAULT_OFFSETS = {1: 16, 2: 8}
_EXACT_ROUNDING = 1e-14  # of I²/n: exact variances are differences of means of g² and squared means
_EXACT_SE = 1e-6  # of exact variances, which weigh alike in the fit of a rate
_HALVINGS = 8  # of the step of the scan: a part of 256


def strata_shift_scan(
    estimator: Any,
    sampler: Sampler | str,
    counts: int | Sequence[int],
    *,
    dims: int | None = None,
    offsets: int | Sequence[float] | None = None,
    method: str = "auto",
    realizations: int = 1000,
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Scan variance and rate against a fixed offset of the strata.

    Parameters
    ----------
    estimator, sampler
        An estimator, and a sampler without a shift, which would average over all offsets.
    counts
        One number of points n, or ascending ones, in whose number a rate needs two.
    dims
        Number of dims of a function, and of a spec that leaves it open; by default those of a sampler
        that is not a spec.
    offsets
        Parts of the side n^(-1/d) of a stratum: ascending in [0, 1), the same along each axis, or how
        many equally spaced ones from 0; by default 16 in 1-D, 8 in 2-D and 4 in more dims, and 4096
        in all at most. The same part of a side is another place in the domain for each n.
    method
        ``"exact"`` (`mcspectra.exact_variance`), ``"measured"``, with the same random numbers for all
        offsets, or ``"auto"``: exact where that is known, but for a user's function, as it takes many
        calls. What was taken is the attribute ``method``.
    realizations, rng, workers
        For measured variances, as for `mcspectra.convergence`.

    Returns
    -------
    xarray.Dataset
        ``variance`` and ``variance_ci`` on offset0, offset1, … and n, ``rate`` and ``rate_ci`` on the
        offsets; a dim channel where f has several. Intervals of exact variances have no width, those
        of their rates tell how far from a line they are.

    Raises
    ------
    CountError, ParameterError
        The sampler cannot do a count, counts or offsets are not ascending, too many offsets.
    NoClosedForm
        ``method="exact"`` and no exact variance is known.

    Notes
    -----
    Fixed offsets of strata: [Ramamoorthi2012]_.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> light = mcs.integrand("disk(center=0.5125, radius=0.25)", dims=1)  # 2.1 to 6.1 strata
    >>> d = mcs.improve.strata_shift_scan(light, "jittered", 8, offsets=[0, 0.1, 0.6])
    >>> [round(float(v) * 64, 2) for v in d["variance"].squeeze()]
    [0.18, 0.0, 0.5]
    """
    subject = as_subject(estimator, sampler, dims=dims)
    given, source = subject.estimator, subject.sampler
    several = isinstance(counts, Sequence | np.ndarray) and not isinstance(counts, str)
    ns = [as_integer("counts", n, least=1) for n in (counts if several else [counts])]  # type: ignore[union-attr]
    if not ns or any(b <= a for a, b in itertools.pairwise(ns)):
        raise ParameterError(f"counts is {counts!r:.80}; give ascending numbers of points.")
    for n in ns:
        given.check_sampler(source, n)
    places = _checked_offsets(offsets, given.dims)
    realizations = as_integer("realizations", realizations, least=2, most=MAX_REALIZATIONS)
    stream, threads = Stream.from_rng(rng), available_workers(workers)
    found = _Offsets.of(given, source, ns, method, realizations, stream, threads)

    # Variances (…, n, channel) and rates (…, channel) at all offsets
    cells = [[found.at(o, n) for n in ns] for o in itertools.product(places, repeat=given.dims)]
    value, relative_se, floor, interval = (
        np.array([[cell[i] for cell in row] for row in cells]) for i in range(4)
    )
    v, r, f = (np.moveaxis(a, 1, 0) for a in (value, relative_se, floor))
    fits = fit_rates(np.array(ns), v, r, f)
    axes = tuple(f"offset{i}" for i in range(given.dims))
    shape = (len(places),) * len(axes)
    variables = {
        "variance": (("n", "channel"), value),
        "variance_ci": (("n", "channel", "bound"), interval),
        "rate": (("channel",), fits["rate"]),
        "rate_ci": (("channel", "bound"), fits["interval"]),
    }
    attributes = {"long_name": "offset of strata", "units": "sides of a stratum"}
    return dataset(
        {n: ((*axes, *own), v.reshape(*shape, *v.shape[1:])) for n, (own, v) in variables.items()},
        {
            **{axis: (axis, places, attributes) for axis in axes},
            "n": counted("n", ns, "number of points"),
            "bound": ["low", "high"],
        },
        drop=() if given.channels else ("channel",),
        estimator=given.spec,
        sampler=source.spec,
        method="exact" if found.exact else "measured",
        realizations=None if found.exact else realizations,
        stream_key=f"{stream.key:#x}",
        seed=rng if isinstance(rng, int) else None,
    )


def best_alignment(
    estimator: Any,
    sampler: Sampler | str,
    n: int,
    *,
    dims: int | None = None,
    edges: Any = None,
    offsets: Any = None,
    method: str = "auto",
    realizations: int = 1000,
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Find the offset of strata with the least variance, and measure what it is worth.

    Parameters
    ----------
    estimator, sampler, n
        What is to be improved; the sampler without a shift, which would average over all offsets.
    dims
        Number of dims of a function, and of a spec that leaves it open; by default those of a sampler
        that is not a spec.
    edges
        Places of known edges, as for `aligned`: strata with borders there are tried
        as well. Needs an estimator without a density and n = s^d.
    offsets, method
        As for `mcspectra.improve.strata_shift_scan`; the best of the scan is refined by a pattern search,
        whose step is halved 8 times.
    realizations, rng, workers
        As for `mcspectra.convergence`; the measurement of each candidate has a stream of its own.

    Returns
    -------
    xarray.Dataset
        On the dim candidate, ``"unshifted"``, ``"offset"`` and, with `edges`, ``"aligned"``:
        ``strata_offset(candidate, axis)``, ``predicted_variance``, ``measured_variance`` with
        ``measured_variance_ci``, ``variance_ratio`` to that of the first with ``variance_ratio_ci``,
        and ``improvement``: 1 where that interval is below 1, −1 where it is above, else 0. The
        attribute ``best`` names the candidate with the least predicted variance (measured, where one
        has no prediction), ``improved`` is yes, no or undecided for it. Variances of several
        channels are added up.

    Raises
    ------
    CountError, ParameterError, NoClosedForm
        As for `mcspectra.improve.strata_shift_scan` and `aligned`.

    Notes
    -----
    Intervals of ratios are those of independent measurements, for both candidates at once 95 %.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> light = mcs.integrand("disk(center=0.5125, radius=0.25)", dims=1)  # 2.1 to 6.1 strata
    >>> found = mcs.improve.best_alignment(light, "jittered", 8)
    >>> found.attrs["improved"], round(float(found["strata_offset"].sel(candidate="offset")[0]), 2)
    ('yes', 0.1)
    """
    from scipy.special import ndtri

    subject = as_subject(estimator, sampler, dims=dims)
    plain, source = subject.estimator, subject.sampler
    plain.check_sampler(source, as_integer("n", n, least=1))
    count = as_integer("realizations", realizations, least=2, most=MAX_REALIZATIONS)
    bent = None if edges is None else aligned(plain, edges, n)
    places = _checked_offsets(offsets, plain.dims)
    stream, threads = Stream.from_rng(rng), available_workers(workers)
    found = _Offsets.of(plain, source, [n], method, count, stream.child(0), threads)

    # Offset of the least predicted variance: the best of a grid, then a pattern search about it
    values = {o: found.total(o, n) for o in itertools.product(places, repeat=source.dims)}
    offset = min(values, key=lambda o: values[o])
    value, step = values[offset], 0.5 / len(places)
    for _ in range(_HALVINGS):
        for axis, sign in itertools.product(range(source.dims), (1.0, -1.0)):
            moved = tuple((o + sign * step * (i == axis)) % 1.0 for i, o in enumerate(offset))
            if (there := found.total(moved, n)) < value:
                offset, value = moved, there
        step *= 0.5

    # Set-ups, their offsets, and the variances predicted for them (NaN where none is)
    zero = (0.0,) * source.dims
    candidates = [
        ("unshifted", plain, source, zero, found.total(zero, n)),
        ("offset", plain, found.displaced(offset), offset, value),
    ]
    if bent is not None:
        try:
            expected = float(np.sum(exact_variance(bent, source, n)))
        except NoClosedForm:
            expected = math.nan
        candidates.append(("aligned", bent, source, zero, expected))
    names, estimators, samplers, shifts, predicted = zip(*candidates, strict=True)

    # Measured: variances summed over channels, relative standard errors at most, rounding floors
    moments = [
        count_moments(e, s, n, count, stream.child(1 + i), threads)
        for i, (e, s) in enumerate(zip(estimators, samplers, strict=True))
    ]
    measured = np.array([float(m.variance.sum()) for m in moments])
    error = np.array([float((m.variance * m.relative_se).sum()) for m in moments])
    least = np.array([float(m.relative_se.max()) for m in moments])
    relative = np.divide(error, measured, out=least, where=measured > 0)

    # Ratios of independent measurements; NaN where both are rounding noise
    z = float(ndtri(1.0 - 0.025 / (len(candidates) - 1)))
    half = z * np.hypot(relative, relative[0])
    floor = float(rounding_floor(moments[0].mean).sum())
    ratio = measured / (measured[0] if measured[0] > floor else math.nan)
    interval = ratio[:, None] * np.exp(np.stack([-half, half], axis=1))
    ratio[0], interval[0] = 1.0, 1.0
    verdict = (interval[:, 1] < 1.0).astype(np.int64) - (interval[:, 0] > 1.0)
    best = int(np.argmin(measured if np.isnan(predicted).any() else predicted))
    over = ("candidate",)
    return dataset(
        {
            "strata_offset": ((*over, "axis"), np.array(shifts)),
            "predicted_variance": (over, np.array(predicted)),
            "measured_variance": (over, measured),
            "measured_variance_ci": ((*over, "bound"), variance_interval(measured, relative)),
            "variance_ratio": (over, ratio),
            "variance_ratio_ci": ((*over, "bound"), interval),
            "improvement": (over, verdict),
        },
        {"candidate": list(names), "bound": ["low", "high"], "axis": np.arange(source.dims)},
        best=names[best],
        improved=("undecided", "yes", "no")[verdict[best]],
        estimator=plain.spec,
        sampler=source.spec,
        n=n,
        method="exact" if found.exact else "measured",
        realizations=count,
        stream_key=f"{stream.key:#x}",
        seed=rng if isinstance(rng, int) else None,
    )


def aligned(
    estimator: AbstractEstimator | Integrand | str, edges: Any, n: int, *, dims: int | None = None
) -> Estimator:
    """Return an estimator of plain sampling with strata of n = s^d points that have borders at edges.

    Parameters
    ----------
    estimator
        One without a density, or its integrand.
    edges
        Places of the edges, as for the density ``aligned-strata``: one list in 1-D, else one a dim.
    n
        Number of points it is to be used with, s^d.

    Raises
    ------
    ParameterError
        The estimator has a density, the edges are not in (0, 1), or n is no power s^d.
    """
    given = as_estimator(estimator, dims)
    if not isinstance(given, Estimator) or given.density is not None:
        raise ParameterError(
            f"{given.spec} has a density of its own; strata can be aligned with edges for an "
            "estimator without one."
        )
    count = as_integer("n", n, least=1)
    side = round(count ** (1.0 / given.dims))
    if side**given.dims != count:
        raise ParameterError(
            f"n is {n}; strata of equal numbers along {given.dims} axes need a power s^{given.dims}."
        )
    return Estimator(given.integrand, AlignedStrata(edges=edges, strata=side))


@dataclass(frozen=True)
class _Offsets:
    """Variance of an estimator as a function of the offset of the sampler's strata."""

    # What is displaced
    estimator: AbstractEstimator
    sampler: Sampler
    exact: bool  # whether variances are exact, else measured on realisations that all offsets share
    # How they are measured
    realizations: int
    stream: Stream
    workers: int

    @staticmethod
    def of(
        estimator: AbstractEstimator,
        sampler: Sampler,
        counts: Sequence[int],
        method: str,
        realizations: int,
        stream: Stream,
        workers: int,
    ) -> _Offsets:
        """Variances at offsets; ``"auto"`` is exact where that is known for all counts, of no black box."""
        law = sampler.law(counts[0])
        if isinstance(law, Shifted):
            raise ParameterError(
                f"{sampler.spec} is shifted at random, which averages over all offsets; leave the "
                "shift out."
            )
        chosen = as_choice("method", method, METHODS)
        exact = chosen == "exact" or (chosen == "auto" and not estimator.is_black_box)
        found = _Offsets(estimator, sampler, exact, realizations, stream, workers)
        try:
            if exact:
                # Half a stratum is where edges at multiples of the side cut strata.
                for probe, n in itertools.product((0.0, 0.4375), counts):
                    found.at([probe] * estimator.dims, n)
        except NoClosedForm:
            if method == "exact":
                raise
            return replace(found, exact=False)
        return found

    def displaced(self, offset: Sequence[float]) -> Sampler:
        """The sampler with its strata moved by parts of their side."""
        return self.sampler.then(StrataShift(offset=tuple(offset)))

    def at(self, offset: Sequence[float], n: int) -> tuple[Array, Array, Array, Array]:
        """Variances (C,) at an offset, relative errors, rounding floors, intervals (C, 2)."""
        source = self.displaced(offset)
        if self.exact:
            size = np.abs(np.atleast_1d(self.estimator.integral))
            value = np.atleast_1d(exact_variance(self.estimator, source, n))
            both = np.stack([value, value], axis=-1)
            return value, np.full(value.shape, _EXACT_SE), _EXACT_ROUNDING * size**2 / n, both
        own = count_stream(self.stream, n)
        m = count_moments(self.estimator, source, n, self.realizations, own, self.workers)
        return m.variance, m.relative_se, rounding_floor(m.mean), m.variance_ci

    def total(self, offset: Sequence[float], n: int) -> float:
        """Variance at one offset, summed over channels."""
        return float(self.at(offset, n)[0].sum())


def _checked_offsets(offsets: Any, dims: int) -> list[float]:
    """Return the offsets along an axis, from 0 to below 1."""
    listed = isinstance(offsets, Sequence | np.ndarray) and not isinstance(offsets, str)
    given = _DEFAULT_OFFSETS.get(dims, 4) if offsets is None else offsets
    number = len(offsets) if listed else as_integer("offsets", given, least=1)
    if number**dims > _MOST_OFFSETS:
        raise ParameterError(
            f"{number} offsets along each of {dims} axes are more than {_MOST_OFFSETS}; give fewer."
        )
    if not listed:
        return [float(o) for o in np.arange(number) / number]
    places = [*as_reals("offsets", offsets, number, least=0.0, most=BELOW_ONE)]
    if not places or sorted(set(places)) != places:
        raise ParameterError(f"offsets is {offsets!r:.80}; give one or more, ascending.")
    return places
