"""Checks for samplers of your own: what the library promises of every one of its own."""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import McspectraError
from mcspectra.samplers import Sampler, as_sampler

__all__ = ["BrokenContract", "check_sampler"]

_REALIZATIONS = 640  # 40 in each of 16 cells
_FALSE_ALARM = 1e-6


class BrokenContract(McspectraError, AssertionError):
    """A sampler does not do what it promises; the message says what and for which count."""


def check_sampler(sampler: Sampler | str, *, counts: tuple[int, ...] = (16, 64)) -> None:
    """Try what every sampler promises.

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
        that draws it; a count that `nearest_count` names cannot be drawn; or the sampler says that
        it is unbiased and χ² of single points says otherwise (false alarm: 1e-6).

    Examples
    --------
    >>> check_sampler("jittered | shift")
    """
    source = as_sampler(sampler)
    for count in counts:
        n = source.nearest_count(as_integer("counts", count, least=1))
        _check_points(source, n)
        _check_repeats(source, n)
        if source.unbiased:
            _check_uniform(source, n)


def _check_points(source: Sampler, n: int) -> None:
    points = source.draw(n, realizations=3, rng=1)
    wanted = (3, n, source.dims)
    _demand(isinstance(points, np.ndarray), source, n, f"gives {type(points).__name__}, no array")
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
            f"gives other points for realisation {first} when it is drawn by another call",
        )


def _check_uniform(source: Sampler, n: int) -> None:
    """χ² over 16 cells, of one point picked from each realisation: these are independent."""
    from scipy.stats import chisquare

    points = source.draw(n, realizations=_REALIZATIONS, rng=20)
    picked = np.random.default_rng(n).integers(n, size=_REALIZATIONS)
    cells = _cells(points[np.arange(_REALIZATIONS), picked])
    p = float(chisquare(np.bincount(cells, minlength=16)).pvalue)
    _demand(
        p > _FALSE_ALARM,
        source,
        n,
        f"says it is unbiased, but single points are not uniform (p {p:.1e})",
    )


def _cells(x: Array) -> Array:
    """Number of the cell, of 16, that each point is in: by its first and last coordinate."""
    cells = 16 * x[:, 0] if x.shape[1] == 1 else 4 * np.floor(4 * x[:, 0]) + np.floor(4 * x[:, -1])
    whole: Array = cells.astype(np.int64)
    return whole


def _demand(holds: bool, source: Sampler, n: int, sentence: str) -> None:
    if not holds:
        raise BrokenContract(f"{source.spec} with n = {n} {sentence}.")
