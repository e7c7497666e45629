"""The quality parameter t of nets, determined by counting points.

An elementary interval in base b is a box with sides b^-k_j.
The corners of the box are multiples of its sides.
A (t, m, d)-net is a set of n = b^m points with this property:
every elementary interval of volume b^(t−m) contains b^t of its points.
"""

from __future__ import annotations

import math

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.quality.sets import as_set
from mcspectra.samplers._digital_kernels import all_balanced, leading_digits
from mcspectra.samplers._primes import LARGEST_BASE, power_from

__all__ = ["elementary_intervals", "net_t_value"]

# Largest allowed work of a check: the number of points times the number of interval shapes.
# A check with the largest allowed work takes about a minute
_MOST_WORK = 2**34


def net_t_value(points: object, base: int = 2) -> int | None:
    """Return the smallest t for which a set is a (t, m, d)-net.

    Parameters
    ----------
    points
        Point set in [0,1), (n, d).
        Coordinates that are at most 2^-52 below a multiple of b^-m are rounded up to it.
    base
        Base b of the digits.

    Returns
    -------
    int or None
        The quality parameter t, from 0 to m. None if n is not a power b^m.

    Raises
    ------
    DomainError
        If the points are not in the unit cube.
    ParameterError
        If there are too many interval shapes, which would take more than about a minute.

    Notes
    -----
    Volumes b^-1, b^-2, … are checked until one fails.
    There are binomial(q + d − 1, d − 1) shapes of volume b^-q. The cost per shape is O(n d).
    """
    x, base, places = _as_net(points, base)
    if base**places != len(x):
        return None
    digits = leading_digits(x, base, places)
    for level in range(1, places + 1):
        _check_work(len(x), x.shape[1], level)
        if not all_balanced(digits, base, places, level):
            return places - level + 1
    return 0


def elementary_intervals(points: object, base: int = 2, t: int = 0) -> bool:
    """Whether each elementary interval of volume b^(t−m) contains b^t of the n = b^m points.

    Parameters and errors are the same as in `net_t_value`.
    In addition, a CountError is raised if n is not a power of the base.
    """
    x, base, places = _as_net(points, base)
    if base**places != len(x):
        raise CountError(
            f"The number of points, {len(x)}, is not a power of the base {base}; give b^m points."
        )
    level = places - as_integer("t", t, least=0, most=places)
    _check_work(len(x), x.shape[1], level)
    digits = leading_digits(x, base, places)
    return bool(all_balanced(digits, base, places, level))


def _as_net(points: object, base: int) -> tuple[Array, int, int]:
    """Return points (n, d), base, and the smallest m with base^m ≥ n."""
    base = as_integer("base", base, least=2, most=LARGEST_BASE)
    x = as_set(points)
    return x, base, power_from(len(x), base)


def _check_work(size: int, dims: int, level: int) -> None:
    shapes = math.comb(level + dims - 1, level)
    if size * shapes > _MOST_WORK:
        raise ParameterError(
            f"Checking {shapes:.3g} shapes of elementary intervals would take too long; "
            "give fewer points or dims."
        )
