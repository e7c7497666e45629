"""Digital nets in base 2: Sobol' and Niederreiter sequences, the net of Larcher and Pillichshammer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers import _digital_kernels
from mcspectra.samplers._repeated import repeated
from mcspectra.samplers.base import MAX_COUNT, Sampler, Structure, check_dims

__all__ = ["LarcherPillichshammer", "Niederreiter", "Sobol"]

_BITS = 32
_MAX_DEGREE = 13  # of Niederreiter's polynomials: 1,377 of them are irreducible


@final
@dataclass(frozen=True, kw_only=True)
class Sobol(Sampler):
    """Sobol' points 0 … n−1, 32 bits, deterministic; randomise with owen or digital-shift.

    Notes
    -----
    Natural order: dimension 0 is the van der Corput sequence of the index, not of its Gray code.
    Counts other than powers of two are made, with a `NotPowerOfTwoWarning`: the sets are then not
    balanced in elementary intervals.

    References
    ----------
    Joe, Kuo (2008), "Constructing Sobol sequences with better two-dimensional projections",
    doi 10.1137/070709359: table new-joe-kuo-6, its first 1,111 dims.
    """

    name: ClassVar[str] = "sobol"
    unbiased: ClassVar[bool] = False
    fixed: ClassVar[bool] = True
    structure: ClassVar[Structure] = Structure.DIGITS
    sequence: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 1111
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        check_dims(self)

    def direction_numbers(self, n: int) -> Array:
        """Return the columns of the generator matrices: uint32 (dims, 32), 2^31 being ½."""
        del n  # a sequence: the same for all counts
        return _sobol_directions()[: self.dims]

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        return _net_points(self.direction_numbers(n), n, count)

    def _count_warning(self, n: int) -> str | None:
        return _not_balanced(n, "Sobol'")


@final
@dataclass(frozen=True, kw_only=True)
class Niederreiter(Sampler):
    """Niederreiter points 0 … n−1 in base 2, 32 bits, deterministic; randomise with owen.

    Up to 1377 dims; any count, with a warning where it is not a power of two.

    Notes
    -----
    Coordinate j has the j-th irreducible polynomial p over the field of two elements (x, x + 1,
    x² + x + 1, … of degrees e_j), and row q·e_j + u of its matrix holds the coefficients of
    x^-1, x^-2, … in x^u / p^(q+1), u < e_j, in the order of Bratley, Fox and Niederreiter. The
    sequence has t = Σ (e_j − 1). A single axis of degree e > 1 is sure to be balanced at n = 2^k
    for k divisible by e only; scrambling does not change that.

    References
    ----------
    Niederreiter (1988), "Low-discrepancy and low-dispersion sequences",
    doi 10.1016/0022-314X(88)90025-X; Bratley, Fox, Niederreiter (1992), "Implementation and tests
    of low-discrepancy sequences", doi 10.1145/146382.146385.
    """

    name: ClassVar[str] = "niederreiter"
    unbiased: ClassVar[bool] = False
    fixed: ClassVar[bool] = True
    structure: ClassVar[Structure] = Structure.DIGITS
    sequence: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 1377
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        check_dims(self)

    def direction_numbers(self, n: int) -> Array:
        """Return the columns of the generator matrices: uint32 (dims, 32), 2^31 being ½."""
        del n  # a sequence: the same for all counts
        return _niederreiter_directions(self.dims)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        return _net_points(self.direction_numbers(n), n, count)

    def _count_warning(self, n: int) -> str | None:
        return _not_balanced(n, "Niederreiter")


@final
@dataclass(frozen=True, kw_only=True)
class LarcherPillichshammer(Sampler):
    """Larcher and Pillichshammer's (0, m, 2)-net of n = 2^m points, deterministic (2-D).

    The first coordinate is i/n; the matrix of the second is the upper triangle of ones, which
    makes the star discrepancy less than that of hammersley. Randomise with owen or digital-shift.

    References
    ----------
    Larcher, Pillichshammer (2001), "Walsh series analysis of the L2-discrepancy of symmetrisized
    point sets", Monatshefte für Mathematik 132, 1–18; Kollig, Keller (2002), "Efficient
    multidimensional sampling", doi 10.1111/1467-8659.00706.
    """

    name: ClassVar[str] = "larcher-pillichshammer"
    unbiased: ClassVar[bool] = False
    fixed: ClassVar[bool] = True
    structure: ClassVar[Structure] = Structure.DIGITS
    max_dims: ClassVar[int | None] = 2
    dims: int = 2

    def __post_init__(self) -> None:
        if self.dims != 2:
            raise ParameterError(
                f"larcher-pillichshammer: dims is {self.dims!r}; it must be 2, "
                "for other dims use sobol or niederreiter."
            )
        check_dims(self)

    def direction_numbers(self, n: int) -> Array:
        """Return the columns of both matrices for n = 2^m points: uint32 (2, 32), 2^31 being ½."""
        m = self.check_count(n).bit_length() - 1
        out = np.zeros((2, _BITS), np.uint32)
        for k in range(m):
            out[0, k] = 1 << (_BITS - m + k)
            out[1, k] = 2**_BITS - (1 << (_BITS - 1 - k))
        return out

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        return _net_points(self.direction_numbers(n), n, count)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        below = 1 << (n.bit_length() - 1)
        return below, n if n == below else min(2 * below, 2 * MAX_COUNT)


def _net_points(directions: Array, n: int, count: int) -> Array:
    """The first `n` points, `count` times: float64 (count, n, d)."""
    points = np.empty((n, len(directions)))
    _digital_kernels.fill_binary(directions, points)
    return repeated(points, count)


def _not_balanced(n: int, name: str) -> str | None:
    if not n & (n - 1):
        return None
    below = 1 << (n.bit_length() - 1)
    return f"{n} {name} points are not balanced; {below} and {2 * below} would be."


@lru_cache
def _sobol_directions() -> Array:
    """Direction numbers of all dims: uint32 (1111, 32)."""
    table = files("mcspectra.samplers") / "data" / "sobol-joe-kuo-6.npz"
    with table.open("rb") as file, np.load(file, allow_pickle=False) as data:
        polynomials = data["polynomials"].astype(np.int64)
        initial = data["initial"].astype(np.int64)
    out = np.zeros((len(polynomials), _BITS), np.uint32)
    _digital_kernels.direction_numbers(polynomials, initial, out)
    out.setflags(write=False)
    return out


@lru_cache(maxsize=16)
def _niederreiter_directions(dims: int) -> Array:
    """Direction numbers of the first `dims` irreducible polynomials: uint32 (dims, 32)."""
    out = np.zeros((dims, _BITS), np.uint32)
    for j, polynomial in enumerate(_irreducible()[:dims]):
        rows = _laurent_rows(polynomial)
        for k in range(_BITS):  # column k of the matrix: bit 31 − k of each row
            bits = [(row >> (_BITS - 1 - k)) & 1 for row in rows]
            out[j, k] = int("".join(map(str, bits)), 2)
    out.setflags(write=False)
    return out


def _laurent_rows(polynomial: int) -> list[int]:
    """Row q·e + u: coefficients of x^-1 … x^-32 in x^u / p^(q+1), the first in bit 31."""
    degree = polynomial.bit_length() - 1
    rows: list[int] = []
    power = 1
    while len(rows) < _BITS:
        power = _times(power, polynomial)
        series = _quotient(1 << (_BITS + degree), power)  # x^-1 … x^-(32 + e)
        rows += [(series >> (degree - u)) & (2**_BITS - 1) for u in range(degree)]
    return rows[:_BITS]


def _times(a: int, b: int) -> int:
    """Product of two polynomials over the field of two elements, bit k being that of x^k."""
    product = 0
    while b:
        product ^= a if b & 1 else 0
        a, b = a << 1, b >> 1
    return product


def _quotient(a: int, b: int) -> int:
    """Quotient of two such polynomials, without the remainder."""
    quotient, width = 0, b.bit_length()
    while a.bit_length() >= width:
        shift = a.bit_length() - width
        quotient |= 1 << shift
        a ^= b << shift
    return quotient


@lru_cache
def _irreducible() -> tuple[int, ...]:
    """All irreducible polynomials up to degree 13, in the order of their numbers: a sieve."""
    limit = 2 << _MAX_DEGREE
    composite = np.zeros(limit, dtype=bool)
    for p in range(2, 2 << (_MAX_DEGREE // 2)):
        if not composite[p]:
            cofactors = np.arange(2, limit >> (p.bit_length() - 1))
            products = np.zeros_like(cofactors)
            for k in range(p.bit_length()):
                products ^= cofactors << k if (p >> k) & 1 else 0
            composite[products[products < limit]] = True
    return tuple((np.flatnonzero(~composite[2:]) + 2).tolist())
