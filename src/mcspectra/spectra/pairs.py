"""Isotropic pair correlation g(r) of point sets: the density of pairs at distance r."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import Analysis, Need, Reduction, Subject, compute
from mcspectra.core.checks import Array, as_integer, as_real_array
from mcspectra.core.confidence import log_mean_interval
from mcspectra.core.errors import Function, NoClosedForm, Parameter, ParameterError
from mcspectra.core.memory import memory_of
from mcspectra.core.options import COUNT, SETS
from mcspectra.core.records import MeanSums
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.samplers.law import Independent, Strata, independent_sets
from mcspectra.spectra._pair_kernels import count_distances, count_ordered_pairs

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "PairCorrelation",
    "closed_form_pair_correlation",
    "count_pairs",
    "pair_correlation",
]

_MOST_PAIRS = 2**36  # largest number of pairs, which takes about a minute per realization


def pair_correlation(
    sampler: Sampler | str,
    n: int,
    *,
    bins: int = 100,
    realizations: int = 16,
    rng: RngLike = 0,
    boundary: str = "toroidal",
    max_distance: float | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Estimate the pair correlation g(r), the density of pairs at distance r; 1 for random points.

    Parameters
    ----------
    sampler, n
        Sampler (or spec string) and number of points, at least 2.
    bins
        Number of equal bins of r in [0, max_distance].
    realizations
        Number of realizations for the average. Standard errors need at least 2.
    rng
        Seed (SPEC 7).
    boundary
        ``"toroidal"``: distances wrap around the torus.
        ``"border"`` is for sets that end at the border, so that distances do not wrap around.
        A pair at distance r counts only if its first point is at least r away from the border.
    max_distance
        Largest r, at most 1/2. The default is 1/2, or 1/4 with the border correction.
    workers
        Number of threads. The default is all processors. Results do not depend on it.

    Returns
    -------
    xarray.Dataset
        ``pair_correlation`` and its standard error ``pair_correlation_se``, on dim r (bin centers).
        ``pair_correlation_ci`` is a 95 % interval from Student's t of the logarithm of g.
        The interval is 0 to 0 if a bin has no pairs.
        If the sampler has fewer different sets than realizations, some realizations reuse a set.
        If sets are reused, errors and Student's t are computed with the number of independent sets.

    Notes
    -----
    On the torus, g = pairs in a shell / (n(n−1)/2 · volume of the shell).
    With the border correction, g = ordered pairs / (n(n−1) · volume of the shell · (1−2r)^d).
    In this formula, (1−2r)^d is the volume of the region in which the first point may lie.
    The estimate with the border correction is unbiased if the set is stationary.
    Only points whose first coordinates differ by less than max_distance are compared.
    The cost is O(n log n + n² max_distance) per realization.
    """
    analysis = PairCorrelation.of(locals())
    return compute(analysis, Subject(None, as_sampler(sampler)), rng, workers)


@final
class PairCorrelation(Analysis, frozen=True, kw_only=True):
    """Pair correlation of the sampler's points in the unit cube."""

    function = "pair_correlation"
    verb = "pcf"
    about = "sampler"
    variables = ("pair_correlation", "pair_correlation_se", "pair_correlation_ci")
    provenance = ("sampler", "n", "boundary", "realizations", "stream_key")

    n: Annotated[int, COUNT, Meta(description="Points in a set, at least 2.")]
    bins: Annotated[
        int,
        Meta(ge=1, le=10**6, description="Number of bins of the distance, all of the same width."),
    ] = 100
    realizations: Annotated[int, SETS] = 16
    boundary: Annotated[
        str,
        Meta(
            description="toroidal: distances wrap around; border: corrected near the faces.",
            extra={"choices": ("toroidal", "border")},
        ),
    ] = "toroidal"
    max_distance: Annotated[
        Annotated[float, Meta(gt=0.0, le=0.5)] | None,
        Meta(description="Largest distance; by default 1/2, with border 1/4."),
    ] = None

    def need(self, subject: Subject) -> Need:
        """Check the number of dims and of pairs."""
        source = subject.sampler
        as_integer("dims of a pair correlation", source.dims, least=1, most=8)
        _check_pairs(source, self.n)
        if self.max_distance == 0.5 and self.boundary == "border":
            raise ParameterError(
                Parameter("max_distance"),
                " is 0.5; with the border correction give less: no point is that far inside.",
            )
        # For each bin, memory holds four partial counts, sums, the bin's edge and expected count
        return Need(cost=self._cost, memory=memory_of(self.n, source.dims) + 128 * self.bins)

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[MeanSums]:
        """Return the computation as a sum over blocks. Each block is one set."""
        source, n, wrap = subject.sampler, self.n, self.boundary == "toroidal"
        edges = np.linspace(0.0, self._most, self.bins + 1)
        # Volume of the unit ball
        volume = math.pi ** (source.dims / 2) / math.gamma(source.dims / 2 + 1)
        expected = 0.5 * n * (n - 1) * np.diff(volume * edges**source.dims)
        if not wrap:
            expected *= 2.0 * (1.0 - 2.0 * edges[1:]) ** source.dims

        def block(realization: int) -> MeanSums:
            points = source.draw_stream(n, stream, realization, 1)[0]
            return MeanSums.of(count_pairs(points, edges, wrap=wrap) / expected)

        def result(total: MeanSums) -> xr.Dataset:
            # Translations preserve distances. Realizations that reuse a set give the same counts,
            # so only different sets are independent
            sets = independent_sets(source.law(n))
            count = self.realizations if sets is None else min(self.realizations, sets)
            mean, se = total.mean_and_error(sets)
            center = 0.5 * (edges[1:] + edges[:-1])
            return dataset(
                {
                    "pair_correlation": (("r",), mean),
                    "pair_correlation_se": (("r",), se),
                    "pair_correlation_ci": (
                        ("r", "bound"),
                        log_mean_interval(mean, se, count),
                    ),
                },
                {
                    "r": ("r", center, {"long_name": f"{self.boundary} distance", "units": "1"}),
                    "bound": ["low", "high"],
                },
                dims=source.dims,
            )

        return Reduction(
            kind=MeanSums, block=block, blocks=self.realizations, cost=self._cost, result=result
        )

    @property
    def _most(self) -> float:
        if self.max_distance is None:
            return 0.5 if self.boundary == "toroidal" else 0.25
        return self.max_distance

    @property
    def _cost(self) -> float:
        return self.realizations * (self.n + 0.2 * self._most * self.n**2)


def count_pairs(points: Array, edges: Array, *, wrap: bool) -> Array:
    """Count pairs of points (n, d) by distance, in equal bins from 0: float64 (bins,).

    With `wrap`, distances are on the torus and each pair counts once.
    Without `wrap`, ordered pairs are counted.
    The first point of a pair must be at least as far from the border as the upper end of the bin.
    """
    n, bins = len(points), len(edges) - 1
    limit = min(float(edges[-1]), 0.5) if wrap else float(edges[-1])
    per_unit = bins / float(edges[-1])
    coordinates = np.ascontiguousarray(points[np.argsort(points[:, 0], kind="stable")].T)
    if not wrap:
        room = np.minimum(coordinates, 1.0 - coordinates).min(axis=0)
        ordered = np.zeros(bins, np.int64)
        last = np.searchsorted(edges[1:], room, side="right")
        count_ordered_pairs(coordinates, per_unit, limit, last, ordered)
        return ordered.astype(float)
    copies = coordinates[:, coordinates[0] <= limit]
    copies = copies + np.eye(len(coordinates), 1)  # move the copies by 1 along the first axis
    counts = np.zeros((4, bins + 1), np.int64)
    count_distances(np.concatenate([coordinates, copies], axis=1), n, per_unit, limit, counts)
    return np.asarray(counts[:, :bins].sum(axis=0), float)


def closed_form_pair_correlation(sampler: Sampler | str, n: int, r: Any) -> Array:
    """Return the exact pair correlation at toroidal distances r, averaged over directions.

    Parameters
    ----------
    sampler
        ``random`` in any dims, ``jittered`` in 1-D and 2-D.
    n
        Number of points, at least 2.
    r
        Distances r on the torus, from 0 to 1/2.

    Raises
    ------
    NoClosedForm
        If no closed form is known for the sampler.

    Notes
    -----
    Two points of a jittered set are independent, except that they cannot lie in the same cell.
    Let two positions differ by h, and let a cell have the sides 1/s_i.
    The two positions lie in the same cell with probability P = Π max(0, 1 − s_i |h_i|).
    If an axis has only one cell, all positions share this cell, even across the torus border.
    The product P then has the factor 1 for this axis.
    The correlation is g = n/(n−1) · (1 − mean of P over all directions of h).

    Examples
    --------
    >>> closed_form_pair_correlation("jittered(dims=1)", 4, [0.0, 0.125, 0.25]).round(3)
    array([0.   , 0.667, 1.333])
    """
    source = as_sampler(sampler)
    n = _check_pairs(source, n)
    distance = as_real_array("r", r)
    if distance.size and not (distance.min() >= 0.0 and distance.max() <= 0.5):
        raise ParameterError("r must hold distances from 0 to 1/2; those given do not.")
    law = source.law(n)
    if isinstance(law, Independent):
        return np.ones(distance.shape)
    if isinstance(law, Strata) and law.jittered and law.dims <= 2:
        sides = law.sides
        # On an axis with one cell, any two positions lie in the same cell
        a, *rest = ((0.0 if s == 1 else s) * distance for s in sides)
        shared = np.maximum(0.0, 1.0 - a)
        if rest:
            # Compute the mean over directions θ of max(0, 1 − a |cos θ|) max(0, 1 − b |sin θ|)
            (b,) = rest
            low = np.arccos(1.0 / np.maximum(a, 1.0))
            high = np.arcsin(1.0 / np.maximum(b, 1.0))

            def primitive(angle: Array) -> Array:
                sine, cosine = np.sin(angle), np.cos(angle)
                return np.asarray(angle - a * sine + b * cosine + 0.5 * a * b * sine**2)

            shared = np.where(low < high, primitive(high) - primitive(low), 0.0) * (2.0 / np.pi)
        return np.asarray(n / (n - 1) * (1.0 - shared))
    raise NoClosedForm(
        f"No closed-form pair correlation is known for {source.spec} in {source.dims} dims; use ",
        Function("pair_correlation"),
        ".",
    )


def _check_pairs(sampler: Sampler, n: int) -> int:
    count = sampler.check_count(n)
    if count < 2:
        raise ParameterError(Function("pair_correlation"), " needs n of at least 2, not 1.")
    if 0.5 * float(count) ** 2 > _MOST_PAIRS:
        raise ParameterError(
            f"{count} points are {0.5 * float(count) ** 2:.2g} pairs, more than "
            f"{_MOST_PAIRS:.2g}; give fewer points."
        )
    return count
