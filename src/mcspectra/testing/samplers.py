"""The contract of samplers: range, shape, type, realisations, counts, a uniform expectation."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.testing.contract import demand

__all__ = ["check_sampler"]

_REALIZATIONS = 640
_CELLS = 35
_FALSE_ALARM = 1e-6


def check_sampler(sampler: Sampler | str, *, counts: tuple[int, ...] = (16, 64)) -> None:
    """Check a sampler against the contract of all samplers.

    Parameters
    ----------
    sampler
        The sampler, or its spec string.
    counts
        Numbers of points to try; the nearest possible ones are taken.

    Raises
    ------
    BrokenContract
        Points are not float64 of shape (R, n, dims) in [0,1); a realisation depends on the call
        that draws it; a fixed set is not the same each time; a count that `nearest_count` names
        cannot be drawn; or the sampler says that it is unbiased and the points of all realisations
        say otherwise (false alarm: 1e-6).

    Examples
    --------
    >>> check_sampler("jittered | shift")
    """
    source = as_sampler(sampler)
    if not isinstance(counts, Iterable):
        raise ParameterError(f"counts is {counts!r}; give a list of numbers of points.")
    for count in counts:
        n = source.nearest_count(as_integer("counts", count, least=1))
        _check_points(source, n)
        _check_repeats(source, n)
        if source.unbiased:
            _check_uniform(source, n)


def _check_points(source: Sampler, n: int) -> None:
    points = source.draw(n, realizations=3, rng=1)
    wanted = (3, n, source.dims)
    _demand(
        isinstance(points, np.ndarray), source, n, f"gives {type(points).__name__}, not an array"
    )
    _demand(points.shape == wanted, source, n, f"gives shape {points.shape}, not {wanted}")
    _demand(points.dtype == np.float64, source, n, f"gives {points.dtype}, not float64")
    low, high = float(points.min()), float(points.max())
    _demand(
        low >= 0.0 and high < 1.0, source, n, f"gives points from {low} to {high}, not in [0,1)"
    )


def _check_repeats(source: Sampler, n: int) -> None:
    whole = source.draw(n, realizations=6, rng=7)
    for first, count in ((0, 1), (1, 3), (5, 1)):
        part = source.draw(n, realizations=count, rng=7, first=first)
        _demand(
            np.array_equal(part, whole[first : first + count]),
            source,
            n,
            f"gives different points for realisation {first} in another call",
        )
    same = not source.fixed or bool((whole == whole[0]).all())
    _demand(same, source, n, "is declared fixed, but its realisations are different sets")


def _check_uniform(source: Sampler, n: int) -> None:
    """Mean counts of points in cells against n over the number of cells, for all axes and pairs.

    The spread over realisations gives the error of each mean, whatever ties the points of a set
    together. Cells are 35 to an axis and 5 × 7 to a pair, which few strata are.
    """
    from scipy.stats import norm

    points = source.draw(n, realizations=_REALIZATIONS, rng=20)
    deviations = np.concatenate([_deviations(cells, n) for cells in _cells(points)])
    worst = float(np.abs(deviations).max())
    p = -np.expm1(deviations.size * np.log1p(-2 * norm.sf(worst)))
    _demand(
        p > _FALSE_ALARM,
        source,
        n,
        f"is declared unbiased, but its points are not uniform ({worst:.3g} standard errors in one "
        f"of {deviations.size} cells)",
    )


def _cells(points: Array) -> Iterator[Array]:
    """Number of the cell, of 35, of each point: by every coordinate and by pairs of neighbours."""
    dims = points.shape[2]
    coarse, fine = np.floor(5 * points), np.floor(7 * points)
    for j in range(dims):
        yield np.floor(_CELLS * points[..., j])
        if dims > 1:
            yield 7 * coarse[..., j] + fine[..., (j + 1) % dims]


def _deviations(cells: Array, n: int) -> Array:
    """Deviations of the mean counts of 35 cells in standard errors; cells (R, n)."""
    counts = np.stack([(cells == cell).sum(axis=1) for cell in range(_CELLS)])
    # Never below that of one point in one realisation: cells that are always, or never, hit
    error = np.maximum(counts.std(axis=1, ddof=1), np.sqrt(n / _CELLS / len(cells)))
    deviations: Array = (counts.mean(axis=1) - n / _CELLS) / (error / np.sqrt(len(cells)))
    return deviations


def _demand(holds: bool, source: Sampler, n: int, sentence: str) -> None:
    demand(holds, f"{source.spec} with n = {n}", sentence)
