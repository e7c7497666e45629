"""Exact covariances of sets known by their pairs: Latin hypercubes, orthogonal arrays, multi-jitter.

C_ml + ⟨S_m⟩ conj⟨S_l⟩ = (1/n²) Σ over ordered pairs of points of ⟨exp(−2πi (m·x − l·y))⟩. A point with
itself gives χ(m − l) on each axis. For two different points the axes are independent, given which
strata they share, and each axis is one of three laws:

* free: independent uniform points, χ(m) conj χ(l);
* same: independent points of one of s strata, A_s(m − l) χ(m/s) conj χ(l/s);
* apart: points of two different ones of s strata, (s free − same) / (s − 1).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.spectra.closed_terms import Moments, comb, interval, product

__all__ = ["latin_hypercube", "multi_jittered", "orthogonal_array"]


def latin_hypercube(n: int) -> Moments:
    """One point in each n-th of every axis, at random."""
    return _moments(n, lambda m, other: (1.0 - 1.0 / n) * product(_apart(m, other, n)))


def orthogonal_array(s: int, dims: int, *, shared_out: bool) -> Moments:
    """Strength 2, s² points, levels renamed at random: two rows agree on one axis at most.

    Of the s²(s² − 1) ordered pairs, s²(s − 1) agree on each axis. Points of a level are
    independent in it, or share it out (`shared_out`): each in an s-th of it of its own.
    """
    n = s * s

    def pairs(m: Array, other: Array) -> Array:
        differ = _apart(m, other, s)
        agree = _level_mates(m, other, s) if shared_out else _same(m, other, s)
        on_one = sum(
            product(np.where(np.arange(dims) == axis, agree, differ)) for axis in range(dims)
        )
        return np.asarray((s - 1) / n * (on_one + (s + 1 - dims) * product(differ)))

    return _moments(n, pairs)


def multi_jittered(sides: tuple[int, int]) -> Moments:
    """Columns × rows cells; the points of a column share it out, those of a row likewise.

    Two points are in one column, in one row, or in neither; what is not shared is independent.
    """
    columns, rows = sides

    def pairs(m: Array, other: Array) -> Array:
        s = np.array(sides)
        free, same = _free(m, other), _same(m, other, s)
        # Sums over pairs of strata of an axis, divided by s²: all different ones, and equal ones
        different = free - same / s
        mates = _level_mates(m, other, s, np.array([rows, columns])) / s
        return np.asarray(
            product(different)
            + mates[..., 0] * different[..., 1]
            + different[..., 0] * mates[..., 1]
        )

    return _moments(columns * rows, pairs)


def _moments(n: int, pairs: Callable[[Array, Array], Array]) -> Moments:
    """Moments of n points each uniform, from (1/n²) Σ over pairs of different points."""

    def covariance(m: Array, other: Array) -> Array:
        second = product(interval(m - other)) / n + pairs(m, other)
        return np.asarray(second - product(_free(m, other)))

    return Moments(lambda nu: product(interval(nu)), covariance)


def _free(m: Array, other: Array) -> Array:
    return np.asarray(interval(m) * np.conj(interval(other)))


def _same(m: Array, other: Array, s: int | Array) -> Array:
    return comb(m - other, s) * _free(m / s, other / s)


def _apart(m: Array, other: Array, s: int | Array) -> Array:
    strata = np.asarray(s, float)
    difference = strata * _free(m, other) - _same(m, other, s)
    return np.asarray(difference / np.maximum(strata - 1.0, 1.0))  # one stratum has no such pair


def _level_mates(m: Array, other: Array, s: int | Array, parts: int | Array | None = None) -> Array:
    """Two points of one of s strata, in different ones of its `parts` (s if not given)."""
    return comb(m - other, s) * _apart(m / s, other / s, s if parts is None else parts)
