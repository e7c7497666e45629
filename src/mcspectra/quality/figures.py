"""Measures of the quality of point sets, for samplers or given points, and their summaries."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import Any, final

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array, as_instance, as_integer
from mcspectra.core.display import shown
from mcspectra.core.errors import McspectraError, Parameter, ParameterError, close_match_hint
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers, map_in_order
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.quality.sets import (
    diaphony,
    generalized_l2_discrepancy,
    l2_discrepancy,
    nearest_distances,
    relative_minimum_distance,
    star_discrepancy,
)
from mcspectra.samplers import GivenPoints, Sampler, as_sampler
from mcspectra.samplers.law import independent_sets

__all__ = [
    "FIGURES",
    "MOST_PROJECTED_AXES",
    "FigureSummary",
    "different_realizations",
    "quality_figures",
    "summarize",
]

MOST_PROJECTED_AXES = 10
"""Number of leading axes that projections use. They form 45 pairs."""

_MOST_TRANSPORTED = 2**13  # Largest number of points for the transport cost; it then takes seconds


def quality_figures(
    source: Sampler | str | Any,
    n: int | None = None,
    *,
    figures: Sequence[str] | None = None,
    realizations: int | None = None,
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Measure the quality of point sets.

    Parameters
    ----------
    source
        A sampler, its spec string, or points of shape (n, d) or (R, n, d).
    n
        Number of points per realization. It is optional for given points.
    figures
        Names from `FIGURES`. The default is all names. Figures on projections need at least 3 dims.
    realizations
        Number of realizations. The default is 16.
        The default is 1 for a deterministic sampler, and the number of sets for given points.
    rng
        Seed of the random numbers (SPEC 7).
    workers
        Number of threads. The default is all processors.

    Returns
    -------
    xarray.Dataset
        Each figure of quality, such as the discrepancy, is a variable on the dim ``realization``.
        A figure is NaN if it cannot be computed. Its attribute ``missing`` gives the reason:
        the set has too many points or dims, or n is not a power of the base.
        The attribute ``sets`` is the number of different sets, if the sampler has a limited number.
        The attribute ``projections`` lists the pairs of axes that were used.

    Raises
    ------
    ParameterError, CountError
        If a figure is unknown, or if `n` is missing or not possible for the sampler.

    Notes
    -----
    The t-value and elementary intervals use the base of the sampler's digits.
    The t-value and the intervals are missing if the coordinates have different bases.
    """
    sampler = as_sampler(source)
    if n is None:
        if not isinstance(sampler, GivenPoints):
            raise ParameterError(
                Parameter("n"),
                f" is missing; give the number of points to draw from {sampler.spec}.",
            )
        n = int(sampler.points.shape[1])
    n = sampler.check_count(n)
    given: Any = figures
    if given is None:
        given = [name for name in FIGURES if sampler.dims > 2 or "projected" not in name]
    if isinstance(given, str) or not isinstance(given, Sequence) or not given:
        raise ParameterError(f"figures is {shown(given)}; give a list of names.")
    for name in given:
        if not isinstance(name, str) or name not in FIGURES:
            hint, close = close_match_hint(name if isinstance(name, str) else shown(name), FIGURES)
            known = hint if close else " The names are in mcspectra.quality.FIGURES."
            raise ParameterError(f"There is no quality figure {shown(name)}.{known}")
    names = list(dict.fromkeys(given))
    bases = set(sampler.digit_bases)
    base = bases.pop() if len(bases) == 1 else 0  # Common base of the digits, or 0 without one
    stream = Stream.from_rng(rng)
    count = different_realizations(sampler, n, stream) if realizations is None else realizations
    count = as_integer("realizations", count, least=1, most=MAX_REALIZATIONS)

    def one(realization: int) -> list[tuple[float, str]]:
        """Return the value of each figure, and the reason if the value is NaN."""
        points, found = sampler.draw_stream(n, stream, realization, 1)[0], []
        for name in names:
            try:
                value = FIGURES[name](*((points, base) if name in _OF_DIGITS else (points,)))
                reason = f"{n} is not a power of {base}." if value is None else ""
            except McspectraError as error:
                value, reason = None, str(error)
            found.append((math.nan if value is None else float(value), reason))
        return found

    rows = list(map_in_order(one, range(count), available_workers(workers)))
    columns = dict(zip(names, zip(*rows, strict=True), strict=True))
    pairs, all_pairs = len(_pairs(sampler.dims)), sampler.dims * (sampler.dims - 1) // 2
    looked_at = f"{pairs} of {all_pairs} pairs of axes, the lowest axes first"
    result = dataset(
        {k: (("realization",), [value for value, _ in v]) for k, v in columns.items()},
        {"realization": range(len(rows))},
        sampler=sampler.spec,
        n=n,
        dims=sampler.dims,
        base=base,
        sets=independent_sets(sampler.law(n)),
        projections=looked_at if sampler.dims > 2 else None,
    )
    for name, values in columns.items():
        if reason := next((why for _, why in values if why), ""):
            result[name].attrs["missing"] = reason
    return result


@final
@dataclass(frozen=True, kw_only=True)
class FigureSummary:
    """Summary over realizations of one quality figure.

    Attributes
    ----------
    name, long_name
        Name of the variable, and its long name.
    mean, standard_error
        Mean over realizations and its standard error, which is NaN for a single realization.
    missing
        Reason why the mean is missing. Empty if there is a mean.
    """

    name: str
    long_name: str
    mean: float
    standard_error: float
    missing: str


def summarize(figures: xr.Dataset) -> list[FigureSummary]:
    """Return mean and standard error of each figure in a result of `quality_figures`."""
    as_instance("figures", figures, xr.Dataset, "what mcs.quality_figures returns")
    found = []
    for name, figure in figures.data_vars.items():
        values = figure.values
        # Average over realizations that are translations of the same stored set
        sets = int(figures.attrs.get("sets", len(values)))
        if sets < len(values):
            values = np.array([np.mean(values[k::sets]) for k in range(sets)])
        count = len(values)
        error = float(np.std(values, ddof=1)) / math.sqrt(count) if count > 1 else math.nan
        found.append(
            FigureSummary(
                name=str(name),
                long_name=figure.attrs["long_name"],
                mean=float(np.mean(values)),
                standard_error=error,
                missing=figure.attrs.get("missing", ""),
            )
        )
    return found


def different_realizations(sampler: Sampler, n: int, stream: Stream, most: int = 16) -> int:
    """Return how many realizations differ: 1 for a fixed set, all for given sets, or `most`."""
    if isinstance(sampler, GivenPoints):
        sets = len(sampler.sets[n])
        return min(most, sets) if sampler.cycle else sets
    first, second = sampler.draw_stream(n, stream, 0, 2)
    return 1 if np.array_equal(first, second) else most


def _pairs(dims: int) -> list[tuple[int, int]]:
    return list(combinations(range(min(dims, MOST_PROJECTED_AXES)), 2))


def _projected(
    figure: Callable[[Array], float], choose: Callable[[Array], Any], points: Array
) -> float:
    """Return the worst or the mean value of a figure over projections onto two axes."""
    if points.shape[1] < 3:
        raise ParameterError("Projections on two axes need point sets in at least 3 dims.")
    values = [figure(points[:, pair]) for pair in map(list, _pairs(points.shape[1]))]
    return float(choose(np.array(values)))


def _minimum_distance(points: Array) -> float:
    return float(nearest_distances(points).min())


def _t_value(points: Array, base: int) -> float | None:
    if not base:
        raise ParameterError("The coordinates of the set have digits in different bases.")
    from mcspectra.quality.nets import net_t_value

    return net_t_value(points, base)


def _elementary_intervals(points: Array, base: int) -> float | None:
    t = _t_value(points, base)
    return None if t is None else float(t == 0)


def _transport_cost(points: Array) -> float:
    if points.shape[1] > 2:
        raise ParameterError(
            f"The transport cost is computed in 1 and 2 dims only, not in {points.shape[1]}."
        )
    if points.shape[1] == 2 and len(points) > _MOST_TRANSPORTED:
        raise ParameterError(
            f"{len(points)} points are too many for the transport cost; "
            f"give at most {_MOST_TRANSPORTED}."
        )
    from mcspectra.samplers.relaxation import transport_cost

    return transport_cost(points)


FIGURES: Mapping[str, Callable[..., float | None]] = {
    "minimum_distance": _minimum_distance,
    "relative_minimum_distance": relative_minimum_distance,
    "mean_nearest_distance": lambda points: float(nearest_distances(points).mean()),
    "star_discrepancy": star_discrepancy,
    "l2_star_discrepancy": partial(l2_discrepancy, kind="star"),
    "centered_discrepancy": partial(l2_discrepancy, kind="centered"),
    "wraparound_discrepancy": partial(l2_discrepancy, kind="wraparound"),
    "mixture_discrepancy": partial(l2_discrepancy, kind="mixture"),
    "generalized_l2_discrepancy": generalized_l2_discrepancy,
    "diaphony": diaphony,
    "transport_cost": _transport_cost,
    "t_value": _t_value,
    "elementary_intervals": _elementary_intervals,
    "worst_projected_distance": partial(_projected, _minimum_distance, np.min),
    "mean_projected_distance": partial(_projected, _minimum_distance, np.mean),
    "worst_projected_discrepancy": partial(_projected, star_discrepancy, np.max),
    "mean_projected_discrepancy": partial(_projected, star_discrepancy, np.mean),
    "worst_projected_diaphony": partial(_projected, diaphony, np.max),
    "mean_projected_diaphony": partial(_projected, diaphony, np.mean),
}
"""Functions by the name of a figure. Each computes its figure of quality for a set (n, d).

`core.results` describes each figure.
"""

# Figures of quality that depend on the base b in which coordinates have digits
_OF_DIGITS = ("t_value", "elementary_intervals")
