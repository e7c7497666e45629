"""Alignment of strata with edges: variance against their offset, and the offset that is best.

A stratum that an edge cuts into shares s and 1 − s has the variance s(1 − s) of the jump, one whose
border is the edge has none. Where strata lie is free: a fixed offset moves them on the torus
(``strata-shift``), and for edges whose places are known `aligned-strata` bends them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer, as_reals
from mcspectra.core.errors import NoClosedForm, ParameterError
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.densities.aligned import AlignedStrata
from mcspectra.estimators import AbstractEstimator, Estimator, as_estimator
from mcspectra.estimators.moments import rounding_floor
from mcspectra.integrands import Integrand
from mcspectra.samplers import Randomized, Sampler, Shift, StrataShift, as_sampler
from mcspectra.variance.convergence import count_moments, count_stream
from mcspectra.variance.exact import exact_variance
from mcspectra.variance.fit import fit_rate

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Offsets", "aligned", "checked_offsets", "predictor", "strata_shift_scan"]

METHODS = ("auto", "exact", "measured")
_MOST_OFFSETS = 4096
_DEFAULT_OFFSETS = {1: 16, 2: 8}
_EXACT_ROUNDING = 1e-14  # of I²/n: exact variances are differences of means of g² and squared means
_EXACT_SE = 1e-6  # of exact variances, which weigh alike in the fit of a rate


@dataclass(frozen=True)
class Variances:
    """Variance of one set-up, its interval (…, 2) and relative standard error, its rounding floor."""

    value: Array
    interval: Array
    relative_se: Array
    floor: Array


@dataclass(frozen=True)
class Offsets:
    """Variance of an estimator as a function of the offset of the sampler's strata.

    Attributes
    ----------
    estimator, sampler
        What is displaced.
    exact
        Whether variances are exact, else measured on realisations that all offsets share.
    realizations, stream, workers
        How they are measured.
    """

    estimator: AbstractEstimator
    sampler: Sampler
    exact: bool
    realizations: int
    stream: Stream
    workers: int

    def displaced(self, offset: Sequence[float]) -> Sampler:
        """The sampler with its strata moved by parts of their side."""
        return self.sampler.then(StrataShift(offset=tuple(offset)))

    def at(self, offset: Sequence[float], n: int) -> Variances:
        """Variances of all channels (C,) at one offset."""
        source = self.displaced(offset)
        size = np.abs(np.atleast_1d(self.estimator.integral))
        if self.exact:
            value = np.atleast_1d(exact_variance(self.estimator, source, n))
            both = np.stack([value, value], axis=-1)
            rounding = _EXACT_ROUNDING * size**2 / n
            return Variances(value, both, np.full(value.shape, _EXACT_SE), rounding)
        own = count_stream(self.stream, n)
        m = count_moments(self.estimator, source, n, self.realizations, own, self.workers)
        return Variances(m.variance, m.variance_ci, m.relative_se, rounding_floor(size))


def predictor(
    estimator: AbstractEstimator,
    sampler: Sampler,
    counts: Sequence[int],
    method: str,
    realizations: int,
    stream: Stream,
    workers: int,
) -> Offsets:
    """Return what gives variances at offsets; ``"auto"`` is exact where that is known for all counts.

    Raises
    ------
    NoClosedForm
        `method` is ``"exact"`` and no exact variance is known.
    ParameterError
        The sampler is shifted at random already.
    """
    _check_not_shifted(sampler)
    exact = as_choice("method", method, METHODS) != "measured"
    found = Offsets(estimator, sampler, exact, realizations, stream, workers)
    # Half a stratum is where edges at multiples of the side cut strata.
    probes = ([0.0] * estimator.dims, [0.4375] * estimator.dims) if exact else ()
    try:
        for probe, n in itertools.product(probes, counts):
            found.at(probe, n)
    except NoClosedForm:
        if method == "exact":
            raise
        return Offsets(estimator, sampler, False, realizations, stream, workers)
    return found


def _check_not_shifted(sampler: Sampler) -> None:
    steps = sampler.steps if isinstance(sampler, Randomized) else ()
    if any(isinstance(step, Shift) for step in steps):
        raise ParameterError(
            f"{sampler.spec} is shifted at random, which averages over all offsets; leave the shift out."
        )


def strata_shift_scan(
    estimator: AbstractEstimator | Integrand | str,
    sampler: Sampler | str,
    counts: int | Sequence[int],
    *,
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
    offsets
        Parts of the side n^(-1/d) of a stratum: ascending in [0, 1), the same along each axis, or how
        many equally spaced ones from 0; by default 16 in 1-D, 8 in 2-D and 4 in more dims, and 4096
        in all at most. The same part of a side is another place in the domain for each n.
    method
        ``"exact"`` (`mcspectra.exact_variance`), ``"measured"``, with the same random numbers for all
        offsets, or ``"auto"``: exact where that is known. What was taken is the attribute ``method``.
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
    >>> d = mcs.strata_shift_scan(light, "jittered", 8, offsets=[0, 0.1, 0.6])
    >>> [round(float(v) * 64, 2) for v in d["variance"].squeeze()]
    [0.18, 0.0, 0.5]
    """
    estimator = as_estimator(estimator, getattr(sampler, "dims", None))
    source = as_sampler(sampler, estimator.dims)
    ns = _checked_counts(counts, estimator, source)
    places = checked_offsets(offsets, estimator.dims)
    realizations = as_integer("realizations", realizations, least=2, most=MAX_REALIZATIONS)
    stream = Stream.from_rng(rng)
    found = predictor(
        estimator, source, ns, method, realizations, stream, available_workers(workers)
    )
    grid = [_curve(found, o, ns) for o in itertools.product(places, repeat=estimator.dims)]
    axes = tuple(f"offset{i}" for i in range(estimator.dims))
    shape = (len(places),) * len(axes)
    attributes = {"long_name": "offset of strata", "units": "sides of a stratum"}
    return dataset(
        {
            name: _labelled([cell[name] for cell in grid], axes, shape, own, estimator.channels)
            for name, own in _DIMS.items()
        },
        {
            **{axis: (axis, places, attributes) for axis in axes},
            "n": ("n", ns, {"long_name": "number of points", "units": "1"}),
            "bound": ["low", "high"],
        },
        estimator=estimator.spec,
        sampler=source.spec,
        method="exact" if found.exact else "measured",
        realizations=None if found.exact else realizations,
        stream_key=f"{stream.key:#x}",
        seed=rng if isinstance(rng, int) else None,
    )


_DIMS = {
    "variance": ("n", "channel"),
    "variance_ci": ("n", "channel", "bound"),
    "rate": ("channel",),
    "rate_ci": ("channel", "bound"),
}


def _curve(found: Offsets, offset: Sequence[float], ns: list[int]) -> dict[str, Array]:
    """Variances and rate at one offset."""
    cells = [found.at(offset, n) for n in ns]
    value = np.stack([cell.value for cell in cells])
    relative = np.stack([cell.relative_se for cell in cells])
    floor = np.stack([cell.floor for cell in cells])
    fits = [
        fit_rate(np.array(ns), value[:, c], relative[:, c], floor[:, c])
        for c in range(value.shape[1])
    ]
    return {
        "variance": value,
        "variance_ci": np.stack([cell.interval for cell in cells]),
        "rate": np.array([fit.rate for fit in fits]),
        "rate_ci": np.array([fit.interval for fit in fits]),
    }


def _labelled(
    cells: list[Array],
    axes: tuple[str, ...],
    shape: tuple[int, ...],
    own: tuple[str, ...],
    channels: int,
) -> tuple[tuple[str, ...], Array]:
    values = np.stack(cells).reshape(*shape, *cells[0].shape)
    if channels:
        return (*axes, *own), values
    where = len(axes) + own.index("channel")
    return (*axes, *(dim for dim in own if dim != "channel")), values.squeeze(axis=where)


def _checked_counts(counts: Any, estimator: AbstractEstimator, sampler: Sampler) -> list[int]:
    several = isinstance(counts, Sequence | np.ndarray) and not isinstance(counts, str)
    ns = [as_integer("counts", n, least=1) for n in (counts if several else [counts])]
    if not ns or any(b <= a for a, b in itertools.pairwise(ns)):
        raise ParameterError(f"counts is {counts!r:.80}; give ascending numbers of points.")
    for n in ns:
        estimator.check_sampler(sampler, n)
    return ns


def checked_offsets(offsets: Any, dims: int) -> list[float]:
    """Return the offsets along an axis, from 0 to below 1."""
    if isinstance(offsets, Sequence | np.ndarray) and not isinstance(offsets, str):
        _check_number(len(offsets), dims)
        limits = {"least": 0.0, "most": float(np.nextafter(1.0, 0.0))}
        places = [*as_reals("offsets", offsets, len(offsets), **limits)]
        if not places or sorted(set(places)) != places:
            raise ParameterError(f"offsets is {offsets!r:.80}; give one or more, ascending.")
        return places
    given = _DEFAULT_OFFSETS.get(dims, 4) if offsets is None else offsets
    number = as_integer("offsets", given, least=1)
    _check_number(number, dims)
    return [float(o) for o in np.arange(number) / number]


def _check_number(number: int, dims: int) -> None:
    if number**dims > _MOST_OFFSETS:
        raise ParameterError(
            f"{number} offsets along each of {dims} axes are more than {_MOST_OFFSETS}; give fewer."
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
