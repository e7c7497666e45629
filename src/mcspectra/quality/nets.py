"""The quality t of nets, by counting points.

A set of n = b^m points is a (t, m, d)-net in base b if every elementary interval of volume b^(t−m),
a box of sides b^-k_j at multiples of them, holds b^t points.

The shapes of the intervals of volume b^-level are the ways to write `level` as a sum of d ordered
parts k_j ≥ 0. They are gone through in the order of Nijenhuis and Wilf's NEXCOM.
"""

from __future__ import annotations

import math

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.jit import kernel
from mcspectra.quality.sets import as_set
from mcspectra.samplers._primes import LARGEST_BASE, power_from

__all__ = ["elementary_intervals", "net_t_value"]

_MOST_WORK = 2**34  # points times shapes of intervals of one volume: about a minute


def net_t_value(points: object, base: int = 2) -> int | None:
    """Return the smallest t for which a set is a (t, m, d)-net, by counting.

    Parameters
    ----------
    points
        The set, shape (n, d), in [0,1). Coordinates within 2^-52 below a multiple of b^-m count
        as that multiple, which they are but for rounding.
    base
        The base b.

    Returns
    -------
    int or None
        t from 0 to m; None if n is not a power b^m.

    Raises
    ------
    DomainError
        Not points of the unit cube.
    ParameterError
        It would take more than about a minute: there are too many shapes of intervals.

    Notes
    -----
    Volumes b^-1, b^-2, … are tried until one fails; the shapes of volume b^-q are
    binomial(q + d − 1, d − 1), each in O(n d).
    """
    x, base, places = _as_net(points, base)
    if base**places != len(x):
        return None
    digits = _leading_digits(x, base, places)
    for level in range(1, places + 1):
        _check_work(len(x), x.shape[1], level)
        if not _all_balanced(digits, base, places, level):
            return places - level + 1
    return 0


def elementary_intervals(points: object, base: int = 2, t: int = 0) -> bool:
    """Whether every elementary interval of volume b^(t−m) holds b^t of the n = b^m `points`.

    Parameters and errors as for `net_t_value`; a CountError if n is not a power of the base.
    """
    x, base, places = _as_net(points, base)
    if base**places != len(x):
        raise CountError(
            f"{len(x)}, the number of points, is not a power of the base {base}; give b^m points."
        )
    level = places - as_integer("t", t, least=0, most=places)
    _check_work(len(x), x.shape[1], level)
    digits = _leading_digits(x, base, places)
    return bool(_all_balanced(digits, base, places, level))


def _as_net(points: object, base: int) -> tuple[Array, int, int]:
    """Points (n, d), base, and the smallest m with base^m ≥ n."""
    base = as_integer("base", base, least=2, most=LARGEST_BASE)
    x = as_set(points)
    return x, base, power_from(len(x), base)


def _leading_digits(x: Array, base: int, places: int) -> Array:
    """First digits of each coordinate as a whole number: int64 (d, n)."""
    scale = float(base**places)
    nudge = 0.0 if base & (base - 1) == 0 else scale * 2.0**-52
    return np.minimum(np.floor(x.T * scale + nudge), scale - 1.0).astype(np.int64)


def _check_work(size: int, dims: int, level: int) -> None:
    shapes = math.comb(level + dims - 1, level)
    if size * shapes > _MOST_WORK:
        raise ParameterError(
            f"Checking {shapes:.3g} shapes of elementary intervals would take too long; "
            "give fewer points or dims."
        )


@kernel
def _next_parts(parts: Array) -> bool:
    # The next composition, in place; False after the last, (0, …, 0, level).
    h = 0
    while parts[h] == 0:
        h += 1
    if h == parts.size - 1:
        return False
    first = parts[h]
    parts[h] = 0
    parts[0] = first - 1
    parts[h + 1] += 1
    return True


@kernel
def _balanced(digits: Array, base: int, places: int, parts: Array, cells: Array) -> bool:
    # Whether all intervals of one shape hold equally many points.
    cells[:] = 0
    boxes = 1
    for j in range(parts.size):
        if parts[j]:
            below = base ** (places - parts[j])
            width = base ** parts[j]
            boxes *= width
            for i in range(cells.size):
                cells[i] = cells[i] * width + digits[j, i] // below
    room = np.full(boxes, cells.size // boxes)
    for i in range(cells.size):
        room[cells[i]] -= 1
        if room[cells[i]] < 0:
            return False
    return True


@kernel
def _all_balanced(digits: Array, base: int, places: int, level: int) -> bool:
    """Whether every elementary interval of volume base^-level holds n/base^level points.

    digits int64 (d, n): the first `places` ≥ level digits of each coordinate, as a whole number.
    """
    parts = np.zeros(digits.shape[0], np.int64)
    parts[0] = level
    cells = np.empty(digits.shape[1], np.int64)
    while True:
        if not _balanced(digits, base, places, parts, cells):
            return False
        if level == 0 or not _next_parts(parts):
            return True
