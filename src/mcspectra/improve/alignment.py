"""Alignment of strata with edges: variance for each offset of strata, and the best offset.

If a jump of f cuts a stratum into shares s and 1 − s, the stratum has variance s(1 − s) · jump².
If the jump lies on the border of strata, it causes no variance.
A fixed offset moves all strata on the torus (``strata-shift``).
If the positions of the edges are known, `aligned-strata` bends the strata to the edges.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array, as_choice, as_integer, as_reals
from mcspectra.core.confidence import rounding_floor
from mcspectra.core.errors import NoClosedForm, ParameterError
from mcspectra.core.fits import fit_rates
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers
from mcspectra.core.results import coordinate, dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.densities import AlignedStrata
from mcspectra.estimators import AbstractEstimator, Estimator, as_estimator, as_subject
from mcspectra.estimators.moments import variance_interval
from mcspectra.integrands import Integrand
from mcspectra.measure.converge import count_moments, count_stream
from mcspectra.prediction.exact import exact_variance
from mcspectra.samplers import Sampler, StrataShift
from mcspectra.samplers.law import Shifted

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["aligned", "best_alignment", "strata_shift_scan"]

METHODS = ("auto", "exact", "measured")


@final
@dataclass(frozen=True)
class AlignmentSettings:
    """Settings of the search for the offset of strata with the least variance."""

    # Maximum number of offsets of the strata that are tried in one scan, over all axes.
    # With 64 points and the default 1000 realizations, 4096 offsets take 2.6e8 evaluations.
    most_offsets: int = 4096
    # Default number of offsets along each axis in 1, 2 and more dims.
    # A scan has 16 offsets in 1-D, 64 in 2-D and 4^d in d dims.
    # Half and twice as many offsets were tested for disks and steps in 1-D and 2-D.
    # With half or twice as many offsets, the least variance that is found differs by at most 0.1 %.
    # The difference is larger only if strata can be aligned with edges almost exactly.
    usual_offsets: tuple[int, int, int] = (16, 8, 4)
    # Rounding error of an exact variance, as a fraction of I²/n.
    # An exact variance is a difference of two sums: means of g², and squared means of g.
    # Each term has a relative rounding error of 1.1e-16; sums are allowed 100 times as much.
    exact_rounding: float = 1e-14
    # The fit of a rate expects a standard error for each variance, also for exact variances.
    # The same relative error for all exact variances gives them equal weights in the fit.
    # Rates and their intervals agree to 9 digits for relative errors from 1e-9 to 1e-3.
    exact_se: float = 1e-6
    # Number of times that the search for the best offset halves its step.
    # The last step of the search is 1/256 of the distance between the offsets of the scan.
    # For 11 points and disks in 1-D, 16 halvings of the step find a variance 0.02 % lower.
    # With only 4 halvings of the step, the variance is 0.3 % higher.
    halvings: int = 8


_SETTINGS = AlignmentSettings()


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
    """Compute the variance and the rate of an estimator for fixed offsets of the strata.

    Parameters
    ----------
    estimator, sampler
        The estimator, and the sampler whose strata are moved.
        The sampler must not have a shift, which would average the variance over all offsets.
    counts
        One number of points n, or several in ascending order. A rate needs at least two.
    dims
        Number of dims; needed if the estimator is a function or a spec without dims.
        The default is the sampler's number of dims, unless the sampler is given as a spec.
    offsets
        Offsets along each axis, as fractions of the side n^(-1/d) of a stratum.
        Either a list of ascending numbers in [0, 1), or the number of equally spaced offsets.
        The default is 16 in 1-D, 8 in 2-D and 4 in more dims. A scan has at most 4096 offsets.
        Strata are smaller for larger n, so the same fraction moves them by a smaller distance.
    method
        ``"exact"`` computes exact variances (`mcspectra.exact_variance`);
        ``"measured"`` measures variances with the same random numbers for all offsets.
        ``"auto"`` computes exact variances if they are known and f is not a user's function.
        Exact variances need many calls of f. The attribute ``method`` states which were computed.
    realizations, rng, workers
        Options of measured variances; see `mcspectra.convergence`.

    Returns
    -------
    xarray.Dataset
        A dataset. ``variance`` and ``variance_ci`` have the dims offset0, offset1, … and n.
        ``rate`` and ``rate_ci`` have the dims offset0, offset1, … only.
        If f has several channels, there is a dim channel.
        Intervals of exact variances have width 0.
        With exact variances, the interval of a rate shows how well log variance follows a line.

    Raises
    ------
    CountError, ParameterError
        If the sampler cannot draw one of the counts, or if there are too many offsets.
        If counts or offsets are not ascending.
    NoClosedForm
        If ``method="exact"`` and no exact variance is known.

    Notes
    -----
    Fixed offsets of strata are described in [Ramamoorthi2012]_.

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
            "n": coordinate("n", ns, "number of points"),
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
    """Find the offset of strata with the least variance, and measure the effect.

    Parameters
    ----------
    estimator, sampler, n
        An estimator, a sampler without a shift, and the number of points.
        A shifted sampler would average the variance over all offsets.
    dims
        Number of dims; needed if the estimator is a function or a spec without dims.
        The default is the sampler's number of dims, unless the sampler is given as a spec.
    edges
        Positions of known edges; see `aligned`.
        If edges are given, strata whose borders lie at the edges are also tested.
        Edges require an estimator without a density, and n = s^d points.
    offsets, method
        Same as in `mcspectra.improve.strata_shift_scan`.
        A pattern search, which halves its step 8 times, refines the best offset of the scan.
    realizations, rng, workers
        Same as in `mcspectra.convergence`. Each candidate is measured with its own random numbers.

    Returns
    -------
    xarray.Dataset
        A dataset. The dim candidate lists set-ups: ``"unshifted"``, ``"offset"``, ``"aligned"``.
        The candidate ``"aligned"`` exists only if `edges` are given.
        ``strata_offset(candidate, axis)`` is the offset of each candidate.
        ``predicted_variance`` and ``measured_variance`` are sums over channels.
        ``variance_ratio`` is the measured variance divided by the variance of ``"unshifted"``.
        ``improvement`` compares the interval ``variance_ratio_ci`` with 1.
        The value is 1 for an interval below 1, −1 for one above 1, and 0 for an interval around 1.
        The attribute ``best`` names the candidate with the least predicted variance.
        If a candidate has no prediction, ``best`` is chosen by the measured variance.
        The attribute ``improved`` is yes, no or undecided for the best candidate.

    Raises
    ------
    CountError, ParameterError, NoClosedForm
        The same errors as in `mcspectra.improve.strata_shift_scan` and `aligned`.

    Notes
    -----
    Intervals of ratios assume independent measurements.
    The intervals hold at 95 % for all candidates together.

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

    # Scan a grid for the offset with the least predicted variance.
    # Refine the best offset by a pattern search
    values = {o: found.total(o, n) for o in itertools.product(places, repeat=source.dims)}
    offset = min(values, key=lambda o: values[o])
    value, step = values[offset], 0.5 / len(places)
    for _ in range(_SETTINGS.halvings):
        for axis, sign in itertools.product(range(source.dims), (1.0, -1.0)):
            moved = tuple((o + sign * step * (i == axis)) % 1.0 for i, o in enumerate(offset))
            if (there := found.total(moved, n)) < value:
                offset, value = moved, there
        step *= 0.5

    # List the set-ups with their offsets and predicted variances (NaN without a prediction)
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

    # Measure variances summed over channels, with upper bounds of the relative standard errors
    moments = [
        count_moments(e, s, n, count, stream.child(1 + i), threads)
        for i, (e, s) in enumerate(zip(estimators, samplers, strict=True))
    ]
    measured = np.array([float(m.variance.sum()) for m in moments])
    error = np.array([float((m.variance * m.relative_se).sum()) for m in moments])
    least = np.array([float(m.relative_se.max()) for m in moments])
    relative = np.divide(error, measured, out=least, where=measured > 0)

    # Compute ratios of independent variances; if both variances are rounding noise, return NaN
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
    """Return an estimator without a density, whose n = s^d strata have borders at edges.

    Parameters
    ----------
    estimator
        An estimator without a density, or an integrand.
    edges
        Positions of the edges, as one list in 1-D, else one list for each dim.
        The density ``aligned-strata`` has the same argument.
    n
        Number of points that the estimator will use; a power s^d of an integer s.

    Raises
    ------
    ParameterError
        If the estimator has a density, the edges are not in (0, 1), or n is not a power s^d.
    """
    given = as_estimator(estimator, dims)
    if not isinstance(given, Estimator) or given.density is not None:
        raise ParameterError(
            f"{given.spec} has its own density; give an estimator without a density to align "
            "strata with edges."
        )
    count = as_integer("n", n, least=1)
    side = round(count ** (1.0 / given.dims))
    if side**given.dims != count:
        raise ParameterError(
            f"n is {n}; strata of equal numbers along {given.dims} axes need a power "
            f"s^{given.dims}."
        )
    return Estimator(given.integrand, AlignedStrata(edges=edges, strata=side))


@dataclass(frozen=True)
class _Offsets:
    """Variance of an estimator as a function of the offset of the sampler's strata."""

    # The estimator, and the sampler whose strata are moved
    estimator: AbstractEstimator
    sampler: Sampler
    # Whether variances are exact; otherwise, all offsets are measured with the same realizations
    exact: bool
    # For measured variances: number of realizations, random numbers, and number of threads
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
        """Measure or compute variances at offsets; see `strata_shift_scan` for the methods."""
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
                # Raise an error if no closed form is known.
                # If an edge cuts strata, a closed form of the variance may be missing.
                # Therefore test two offsets: 0, and about half of the side of a stratum.
                # Edges cut strata for at least one of the two offsets
                for probe, n in itertools.product((0.0, 0.4375), counts):
                    found.at([probe] * estimator.dims, n)
        except NoClosedForm:
            if method == "exact":
                raise
            return replace(found, exact=False)
        return found

    def displaced(self, offset: Sequence[float]) -> Sampler:
        """Return the sampler with its strata moved by the given fractions of a stratum's side."""
        return self.sampler.then(StrataShift(offset=tuple(offset)))

    def at(self, offset: Sequence[float], n: int) -> tuple[Array, Array, Array, Array]:
        """Return variances of C channels, relative errors, rounding errors and intervals (C, 2)."""
        source = self.displaced(offset)
        if self.exact:
            size = np.abs(np.atleast_1d(self.estimator.integral))
            value = np.atleast_1d(exact_variance(self.estimator, source, n))
            both = np.stack([value, value], axis=-1)
            error = np.full(value.shape, _SETTINGS.exact_se)
            return value, error, _SETTINGS.exact_rounding * size**2 / n, both
        own = count_stream(self.stream, n)
        m = count_moments(self.estimator, source, n, self.realizations, own, self.workers)
        return m.variance, m.relative_se, rounding_floor(m.mean), m.variance_ci

    def total(self, offset: Sequence[float], n: int) -> float:
        """Return the variance at one offset, summed over channels."""
        return float(self.at(offset, n)[0].sum())


def _checked_offsets(offsets: Any, dims: int) -> list[float]:
    """Return the offsets along an axis, in [0, 1)."""
    listed = isinstance(offsets, Sequence | np.ndarray) and not isinstance(offsets, str)
    given = _SETTINGS.usual_offsets[min(dims, 3) - 1] if offsets is None else offsets
    number = len(offsets) if listed else as_integer("offsets", given, least=1)
    most = _SETTINGS.most_offsets
    if number**dims > most:
        raise ParameterError(
            f"{number} offsets along each of {dims} axes are more than {most}; give fewer."
        )
    if not listed:
        return [float(o) for o in np.arange(number) / number]
    places = [*as_reals("offsets", offsets, number, least=0.0, most=BELOW_ONE)]
    if not places or sorted(set(places)) != places:
        raise ParameterError(f"offsets is {offsets!r:.80}; give one or more, ascending.")
    return places
