"""Digital nets: Sobol', Niederreiter, Larcher and Pillichshammer, Faure, and given matrices.

Coordinate j has a generator matrix C_j in base b.
The digits of coordinate j of point i are C_j times the digits of i (lowest first), modulo b.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.decoding import check_decoded_size, opened
from mcspectra.core.display import needed
from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.core.fields import settle, whole
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.samplers import _digital_kernels
from mcspectra.samplers._primes import LARGEST_BASE, is_prime, power_from, prime_from
from mcspectra.samplers.base import MAX_COUNT, FixedSet, PlaneSampler, Sampler, Structure
from mcspectra.samplers.law import Fixed, Law, is_power

__all__ = ["DigitalNet", "Faure", "JoinedPairs", "LarcherPillichshammer", "Niederreiter", "Sobol"]

_BITS = 32
_TERNARY_DIGITS = 20  # digits in base 3; 3^20 exceeds the largest count
_MAX_DEGREE = 13  # largest degree of Niederreiter's polynomials: 1,377 dims
_NO_MATRICES = (
    "matrices is not a list of matrices; give each matrix as a list of rows of "
    "digits, or as a list of whole numbers, one for each column."
)


class _BinaryNet(FixedSet):
    """A net with 32-bit generator matrices in base 2."""

    structure: ClassVar[Structure] = Structure.DIGITS

    @abstractmethod
    def direction_numbers(self, n: int) -> Array:
        """Return columns of matrices for n points: uint32 (dims, 32), where 2^31 means ½."""

    def link(self, n: int) -> tuple[int, ...]:  # noqa: ARG002
        """Return the columns of the matrix U of `JoinedPairs` for n points; bit 0 is row 0."""
        return _LINK

    def _law(self, n: int) -> Law:
        count = n.bit_length() - 1
        digital = 2**count == n and set(self.digit_bases) == {2}

        def columns() -> Array:
            return self.direction_numbers(n)[:, :count].astype(np.uint64)

        return Fixed(
            n=n,
            dims=self.dims,
            bases=self.digit_bases,
            digital=is_power(n, self.digit_bases[0]),
            columns=columns if digital else None,
        )

    def _set(self, n: int) -> Array:
        points = np.empty((n, self.dims))
        _digital_kernels.fill_binary(self.direction_numbers(n), points)
        return points


@final
@dataclass(frozen=True, kw_only=True)
class Sobol(_BinaryNet):
    """Sobol' points 0 … n−1, 32 bits, deterministic; randomize with owen or digital-shift.

    Attributes
    ----------
    directions
        A file of direction numbers, instead of Joe and Kuo's table.
    base
        Base of the file: 2, or 3 for polynomials over the field of three elements (20 digits).

    Raises
    ------
    FileFormatError
        If the file is not a table of direction numbers in this base.

    Notes
    -----
    The points are in natural order, not in the order of the Gray code:
    dimension 0 is the van der Corput sequence of the index.
    Counts that are not powers of the base cause a warning:
    sets whose number of points is not a power of the base are not balanced.

    A file has one line per dim: number of the dim, degree s, polynomial a, numbers m_1 … m_s.
    Headings and text after ``#`` are ignored.
    In base 2, the number a encodes the inner coefficients of the polynomial, as in [JoeKuo2008]_.
    A line with degree 0 stands for the van der Corput sequence.
    If the first line of a file has the number 2, the van der Corput sequence is inserted before it.
    In base 3, the number a encodes all coefficients of the polynomial: its digits p_i.
    Digit p_i is the coefficient of x^i.
    The recurrence m_k = m_(k−s) − Σ_j 3^j p_(s−j) m_(k−j) holds digit by digit, modulo 3.

    References
    ----------
    [JoeKuo2008]_, for base 2: the first 1,111 dims of the table new-joe-kuo-6;
    [Ostromoukhov2024]_, for base 3
    """

    sequence: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 1111
    dims: int = DEFAULT_DIMS
    directions: str | None = None
    base: int = 2

    def __post_init__(self) -> None:
        settle(self, base=as_integer("base", self.base, least=2, most=3))
        if self.directions is not None:
            settle(self, max_dims=len(_directions_of_file(self.directions, self.base)))
        elif self.base != 2:
            raise ParameterError("sobol: base 3 needs a table; give its file as directions=.")
        Sampler.__post_init__(self)

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """The base of the direction numbers."""
        return (self.base,) * self.dims

    def direction_numbers(self, n: int) -> Array:
        """Return the columns of the generator matrices: uint32 (dims, 32); 2^31 means ½.

        In base 3, return the digits of the columns: int64 (dims, 20, 20).
        """
        del n  # the matrices of a sequence are the same for all counts
        if self.directions is None:
            return _sobol_directions()[: self.dims]
        return _directions_of_file(self.directions, self.base)[: self.dims]

    def _set(self, n: int) -> Array:
        if self.base == 2:
            return _BinaryNet._set(self, n)
        points = np.empty((n, self.dims))
        _digital_kernels.fill_base(self.direction_numbers(n), self.base, points)
        return points

    def _count_warning(self, n: int) -> str | None:
        return _not_balanced(n, self.base, "Sobol'", "would be")


@lru_cache
def _sobol_directions() -> Array:
    """Return the direction numbers of all dims: uint32 (1111, 32)."""
    table = files("mcspectra.samplers") / "data" / "sobol-joe-kuo-6.npz"
    with table.open("rb") as file, np.load(file, allow_pickle=False) as data:
        return _binary_directions(data["polynomials"], data["initial"])


def _binary_directions(polynomials: Array, initial: Array) -> Array:
    """Return direction numbers uint32 (d, 32), given polynomials (d,) and first numbers (d, s)."""
    out = np.zeros((len(polynomials), _BITS), np.uint32)
    _digital_kernels.direction_numbers(polynomials.astype(np.int64), initial.astype(np.int64), out)
    out.setflags(write=False)
    return out


def _directions_of_file(path: str, base: int) -> Array:
    """Return the direction numbers of a file, which is read again after changes."""
    try:
        stamp = Path(path).stat().st_mtime_ns
    except (OSError, ValueError, TypeError):
        stamp = 0  # the file cannot be read; `_read_directions` raises an error with the reason
    return _read_directions(path, base, stamp)


@lru_cache(maxsize=16)
def _read_directions(path: str, base: int, stamp: int) -> Array:
    """Read a table of direction numbers: uint32 (d, 32) in base 2, else digits (d, 20, 20)."""
    del stamp
    with opened(path, "direction numbers") as (stream, size, name, _):
        check_decoded_size(name, size, 128 * size)
        lines = stream.read().decode().splitlines()
    rows = [
        (k, words) for k, line in enumerate(lines, 1) if (words := line.partition("#")[0].split())
    ]
    rows = [(k, words) for k, words in rows if words[0] != "d"]

    # Check each line: the polynomial has degree s; number k has k digits, the last of them not 0
    least = 0 if base == 2 else 1
    digits = _BITS if base == 2 else _TERNARY_DIGITS
    table: list[tuple[int, list[int]]] = []
    for k, words in rows:
        try:
            number, degree, coded, *first = map(int, words)
        except ValueError:
            number, degree, coded, first = 0, -1, 0, []
        lead = base**degree if base > 2 else 0
        most = 2 * lead if base > 2 else 2 ** max(degree - 1, 0)
        good = least <= degree <= digits and len(first) >= degree and lead <= coded < most
        first = first[:degree]
        if not good or any(m % base == 0 or not 0 < m < base**i for i, m in enumerate(first, 1)):
            raise FileFormatError(
                f"{name}, line {k}, is not the number of a dim, a degree, a polynomial in base "
                f"{base} and its direction numbers m_1 … m_s, below base^k and not divisible by "
                "the base."
            )
        if base == 2 and number == 2 and not table:
            table.append((1, []))
        table.append((coded if base > 2 else 2**degree | coded << 1 | 1, first))
    if not table:
        raise FileFormatError(f"{name} holds no direction numbers; give a line for each dim.")

    if base == 2:
        initial = np.zeros((len(table), max(1, *(len(first) for _, first in table))), np.int64)
        for j, (_, first) in enumerate(table):
            initial[j, : len(first)] = first
        return _binary_directions(np.array([p for p, _ in table]), initial)

    # Continue with the recurrence on digits, lowest first, and convert the digits to columns
    out = np.zeros((len(table), digits, digits), np.int64)
    for j, (polynomial, first) in enumerate(table):
        degree = len(first)
        p = [polynomial // base**i % base for i in range(degree)]
        m = np.zeros((digits, digits + 1), np.int64)
        for k in range(digits):
            if k < degree:
                m[k, :digits] = [first[k] // base**i % base for i in range(digits)]
                continue
            m[k] = m[k - degree]
            for i in range(1, degree + 1):
                m[k, i:] -= p[degree - i] * m[k - i, : digits + 1 - i]
            m[k] %= base
        for k in range(digits):
            out[j, k, : k + 1] = m[k, k::-1]
    out.setflags(write=False)
    return out


@final
@dataclass(frozen=True, kw_only=True)
class Niederreiter(_BinaryNet):
    """Niederreiter points 0 … n−1 in base 2, 32 bits, deterministic; randomize with owen.

    Up to 1377 dims; any count, with a warning if it is not a power of two.

    Notes
    -----
    Coordinate j belongs to the j-th irreducible polynomial p over the field of two elements:
    the polynomials are x, x + 1, x² + x + 1, … The degree of polynomial j is e_j.
    Row q·e_j + u of the matrix, u < e_j, holds the coefficients of x^-1, x^-2, … in x^u / p^(q+1).
    The rows have the order of Bratley, Fox and Niederreiter.

    The sequence has quality parameter t = Σ (e_j − 1).
    An axis of degree e > 1 is sure to be balanced only at n = 2^k with k divisible by e.
    Scrambling does not change the numbers n at which an axis is balanced.

    References
    ----------
    [Niederreiter1988]_, [BratleyFoxNiederreiter1992]_
    """

    sequence: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 1377
    dims: int = DEFAULT_DIMS

    def direction_numbers(self, n: int) -> Array:
        """Return the columns of the generator matrices: uint32 (dims, 32); 2^31 means ½."""
        del n  # the matrices of a sequence are the same for all counts
        return _niederreiter_directions(self.dims)

    def _count_warning(self, n: int) -> str | None:
        return _not_balanced(n, 2, "Niederreiter", "would be")


@lru_cache(maxsize=16)
def _niederreiter_directions(dims: int) -> Array:
    """Return direction numbers of the first `dims` irreducible polynomials: uint32 (dims, 32)."""
    out = np.zeros((dims, _BITS), np.uint32)
    for j, polynomial in enumerate(_irreducible()[:dims]):
        # Row q·e + u has the coefficients of x^-1 … x^-32 in x^u / p^(q+1), the first in bit 31
        degree = polynomial.bit_length() - 1
        rows: list[int] = []
        power = 1
        while len(rows) < _BITS:
            power = _times(power, polynomial)
            series = _quotient(1 << (_BITS + degree), power)  # coefficients of x^-1 … x^-(32 + e)
            rows += [(series >> (degree - u)) & (2**_BITS - 1) for u in range(degree)]
        for k in range(_BITS):  # column k of the matrix is bit 31 − k of each row
            bits = [(row >> (_BITS - 1 - k)) & 1 for row in rows[:_BITS]]
            out[j, k] = int("".join(map(str, bits)), 2)
    out.setflags(write=False)
    return out


def _times(a: int, b: int) -> int:
    """Return the product of two polynomials over GF(2); bit k is the coefficient of x^k."""
    product = 0
    while b:
        product ^= a if b & 1 else 0
        a, b = a << 1, b >> 1
    return product


def _quotient(a: int, b: int) -> int:
    """Return the quotient of two polynomials over GF(2), without the remainder."""
    quotient, width = 0, b.bit_length()
    while a.bit_length() >= width:
        shift = a.bit_length() - width
        quotient |= 1 << shift
        a ^= b << shift
    return quotient


@lru_cache
def _irreducible() -> tuple[int, ...]:
    """Return all irreducible polynomials up to degree 13, in numerical order, by a sieve."""
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


# Columns of the matrices U in `JoinedPairs`, as numbers whose lowest bit is row 0.
# One matrix U serves all counts of Sobol' points.
# The matrices of Larcher and Pillichshammer depend on m, so each m has its own matrix U
_LINK: tuple[int, ...] = (1, 3, 5, 14, 16, 49, 122, 170, 459, 612)
_LARCHER_LINKS: tuple[tuple[int, ...], ...] = (
    (),
    (1,),
    (3, 1),
    (4, 3, 6),
    (13, 4, 10, 1),
    (11, 22, 15, 31, 8),
    (61, 17, 54, 32, 30, 45),
    (55, 85, 3, 38, 91, 33, 110),
    (214, 113, 246, 163, 193, 127, 129, 236),
    (333, 409, 100, 270, 22, 429, 111, 210, 274),
    (599, 230, 885, 125, 878, 312, 947, 200, 255, 377),
    (1437, 700, 522, 115, 1056, 1658, 433, 1934, 1761, 587, 1838),
    (3903, 4029, 2288, 1310, 2679, 3637, 942, 1296, 3864, 236, 3827, 1973),
    (5844, 7270, 2580, 3691, 2257, 1928, 5156, 680, 3976, 7643, 570, 2988, 8069),
    (15989, 9739, 5517, 11281, 8758, 1497, 12800, 3692, 13457, 2731, 7078, 5237, 5198, 13643),
    (15722, 32601, 15241, 4605, 30347, 23335, 8508, 10879, 29879, 27691, 22594, 10657, 29256, 28395,
     31821),
    (52519, 51555, 566, 32745, 52751, 36442, 24726, 49012, 8964, 40120, 33625, 25792, 28379, 9079,
     63193, 3107),
)  # fmt: skip


@final
@dataclass(frozen=True, kw_only=True)
class JoinedPairs(_BinaryNet):
    """Points in four dims whose coordinates are two copies of a binary net in two dims.

    Attributes
    ----------
    plane
        The net in two dims, with generator matrices C_1 and C_2.

    Notes
    -----
    The matrices of the points are C_1, C_2, C_1 U and C_2 U with an invertible matrix U.
    For coordinates 3 and 4, the digits of a point's index are first multiplied by the matrix U.
    Multiplying the index by U changes only the order of the points in the plane.
    Coordinates 3 and 4 are therefore as evenly spread as coordinates 1 and 2.
    In contrast, coordinates 3 and 4 of Sobol' points do not form a (0, m, 2)-net for most m.

    For Sobol' points, U is upper triangular, so it does not depend on the number of points.
    The first ten columns of U are the best of 3000 random choices.
    The ten columns give the least quality parameter t: 1, 2 and 3 for 16, 64 and 256 points.
    For Larcher and Pillichshammer's net of 2^m points, with m up to 16,
    the matrix U is the best of 80 to 3000 random matrices.
    With the best U, the digitally shifted points in 4-D give the smallest variance.
    This variance is a sum over the dual net.
    In this sum, a Walsh function has the weight Π_i 4^-a_i, where index k_i has a_i binary digits.
    """

    max_dims: ClassVar[int | None] = 4
    plane: Any = None
    dims: int = 4

    @property
    def spec(self) -> str:
        """Spec of the net in two dims; no spec string describes these points in four dims."""
        return str(self.plane.spec)

    def direction_numbers(self, n: int) -> Array:
        """Return the columns of the generator matrices: uint32 (4, 32); 2^31 means ½."""
        own = np.asarray(self.plane.direction_numbers(n), np.uint32)
        linked = own.copy()
        # Nets that are defined outside of this package get the default matrix U
        link = self.plane.link(n) if isinstance(self.plane, _BinaryNet) else _LINK
        for column, rows in enumerate(link):
            parts = [own[:, j] for j in range(len(link)) if rows >> j & 1]
            linked[:, column] = np.bitwise_xor.reduce(parts)
        return np.concatenate([own, linked])[: self.dims]


@final
@dataclass(frozen=True, kw_only=True)
class LarcherPillichshammer(PlaneSampler, _BinaryNet):
    """Larcher and Pillichshammer's (0, m, 2)-net of n = 2^m points, deterministic (2-D).

    The first coordinate is i/n. The matrix of the second coordinate is the upper triangle of ones.
    The star discrepancy of this net is smaller than the star discrepancy of hammersley.
    Randomize with owen or digital-shift.

    References
    ----------
    [LarcherPillichshammer2001]_, [KolligKeller2002]_
    """

    other_dims: ClassVar[str] = "for other dims use sobol or niederreiter"

    def direction_numbers(self, n: int) -> Array:
        """Return the columns of the two matrices for n = 2^m points: uint32 (2, 32); 2^31 is ½."""
        m = self.check_count(n).bit_length() - 1
        out = np.zeros((2, _BITS), np.uint32)
        for k in range(m):
            out[0, k] = 1 << (_BITS - m + k)
            out[1, k] = 2**_BITS - (1 << (_BITS - 1 - k))
        return out

    def link(self, n: int) -> tuple[int, ...]:
        """Return the columns of the matrix U of `JoinedPairs` for n = 2^m ≤ 65,536 points."""
        most = 2 ** (len(_LARCHER_LINKS) - 1)
        return _LARCHER_LINKS[as_integer("n", n, least=1, most=most).bit_length() - 1]

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        below = 1 << (n.bit_length() - 1)
        return below, n if n == below else min(2 * below, 2 * MAX_COUNT)


class _AnyBaseNet(FixedSet):
    """A net with generator matrices modulo any base."""

    structure: ClassVar[Structure] = Structure.DIGITS

    @abstractmethod
    def _columns(self, n: int) -> Array:
        """Return the columns of the matrices for n points: int64 (dims, columns, rows)."""

    def _law(self, n: int) -> Law:
        bases = self.digit_bases
        return Fixed(n=n, dims=self.dims, bases=bases, digital=is_power(n, bases[0]))

    def _set(self, n: int) -> Array:
        points = np.empty((n, self.dims))
        columns = np.ascontiguousarray(self._columns(n))
        _digital_kernels.fill_base(columns, self.digit_bases[0], points)
        return points

    def _count_warning(self, n: int) -> str | None:
        return _not_balanced(n, self.digit_bases[0], self.name, "can be")


@final
@dataclass(frozen=True, kw_only=True)
class Faure(_AnyBaseNet):
    """Faure points 0 … n−1, deterministic: a (0, d)-sequence in a prime base b ≥ d.

    Up to 1000 dims; any count, with a warning if it is not a power of b.
    Randomize with owen, lms or digital-shift.

    Attributes
    ----------
    base
        A prime, at least `dims`; by default the smallest prime that is at least `dims`.

    Notes
    -----
    Matrix j is the (j−1)-th power of Pascal's matrix modulo b.
    The entry in row r and column c is binomial(c, r) (j−1)^(c−r).

    References
    ----------
    [Faure1982]_
    """

    sequence: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 1000
    dims: int = DEFAULT_DIMS
    base: int | None = whole(None, least=2, most=LARGEST_BASE)

    def _check(self) -> None:
        if self.base is not None and (self.base < self.dims or not is_prime(self.base)):
            raise ParameterError(
                f"faure: base is {self.base}; give a prime that is at least dims = {self.dims}."
            )

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """Bases of the dims: the same prime for all."""
        return (self.base or prime_from(self.dims),) * self.dims

    def generator_matrices(self, digits: int) -> Array:
        """Return the matrices with `digits` rows and columns: int64 (dims, digits, digits)."""
        digits = as_integer("digits", digits, least=1, most=32)
        return _pascal_powers(self.digit_bases[0], self.dims, digits)

    def _columns(self, n: int) -> Array:
        base = self.digit_bases[0]
        matrices = _pascal_powers(base, self.dims, max(1, power_from(n, base)))
        return matrices.transpose(0, 2, 1)


@lru_cache(maxsize=16)
def _pascal_powers(base: int, dims: int, digits: int) -> Array:
    """Return powers 0 … dims − 1 of Pascal's upper triangular matrix modulo a prime ≥ dims."""
    r, c = np.indices((digits, digits))
    pascal = np.array([[math.comb(k, i) % base for k in range(digits)] for i in range(digits)])
    out = np.empty((dims, digits, digits), np.int64)
    for j in range(dims):
        powers = np.array([pow(j, k, base) for k in range(digits)], np.int64)  # 0^0 is 1
        out[j] = pascal * np.where(c >= r, powers[c - r], 0) % base
    out.setflags(write=False)
    return out


@final
@dataclass(frozen=True, kw_only=True)
class DigitalNet(_AnyBaseNet):
    """Digital net from given generator matrices, deterministic; randomize with owen or lms.

    The number of dims is at most the number of matrices.
    Matrices with m columns make at most b^m points. Sets can be balanced if n is a power of b.

    Attributes
    ----------
    matrices
        One matrix per dim: a list of its rows of digits, or a list of its columns.
        A column is a whole number whose highest digit belongs to the first row.
        Alternatively, the path of a text file with matrices.
    base
        The base b; a file that states its base overrides it.
    digits
        Number of rows of matrices that are given as columns. Each column has this number of digits.
        The highest digit of a column comes first. By default there are as many rows as columns.
    dims
        Number of dims, by default the number of matrices. Matrices beyond it are ignored.

    Notes
    -----
    Files have one of two formats. LatNet Builder, the Magic Point Shop and QMCPy use the first:
    each of the first four lines has a number (base, dims, largest n, digits).
    After that, each line has the columns of one matrix, as whole numbers.
    In the first four lines, text after the number is ignored.
    All lines that start with ``#`` are ignored.
    MatBuilder uses the second format: square matrices of digits, one below the other.
    Each line has one row of a matrix. Such files do not state the base, so give it as `base`.

    References
    ----------
    [Niederreiter1987]_, [Paulin2022]_
    """

    matrices: str | Sequence[Any]
    base: int = 2
    digits: int | None = None
    dims: int = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if not isinstance(self.matrices, str):
            settle(self, matrices=_as_tuples(self.matrices))
        settle(self, base=as_integer("base", self.base, least=2, most=LARGEST_BASE))
        most = len(self._net()[1])
        given: Any = self.dims
        settle(self, dims=most if given is None else given)
        Sampler.__post_init__(self)
        if self.dims > most:
            raise ParameterError(
                f"digital-net: {needed(self.dims, 'dim')}, but there are {most} matrices; "
                "give one for each dim."
            )

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """The base of the matrices, taken from the file if the file states a base."""
        return (self._net()[0],) * self.dims

    @property
    def max_count(self) -> int:  # type: ignore[override]
        """Largest number of points: b^m for matrices of m columns."""
        base, columns = self._net()
        return int(min(base ** columns.shape[1], MAX_COUNT))

    def generator_matrices(self) -> Array:
        """Return the matrices as int64 (dims, rows, columns)."""
        return np.ascontiguousarray(self._columns(0).transpose(0, 2, 1))

    def _law(self, n: int) -> Law:
        count = n.bit_length() - 1
        law = _AnyBaseNet._law(self, n)
        if 2**count != n or set(self.digit_bases) != {2}:
            return law

        def columns() -> Array:
            matrices = self.generator_matrices()[:, :_BITS, :count]
            places = 2 ** np.arange(_BITS - 1, _BITS - 1 - matrices.shape[1], -1, dtype=np.int64)
            return np.tensordot(matrices, places, axes=([1], [0])).astype(np.uint64)

        return replace(law, columns=columns)  # type: ignore[call-arg]

    def _net(self) -> tuple[int, Array]:
        if isinstance(self.matrices, str):
            return _net_of_file(self.matrices, self.base)
        return self.base, _columns_of_lists(self.matrices, self.base, self.digits)

    def _columns(self, n: int) -> Array:
        del n
        return self._net()[1][: self.dims]


def _as_tuples(matrices: object) -> Any:
    """Convert nested lists and arrays to tuples, which can be compared, hashed and printed."""
    if isinstance(matrices, np.ndarray):
        matrices = matrices.tolist()
    if isinstance(matrices, Sequence) and not isinstance(matrices, str | bytes):
        return tuple(_as_tuples(part) for part in matrices)
    if isinstance(matrices, int | float | np.number):
        return matrices
    raise ParameterError(_NO_MATRICES)


@lru_cache(maxsize=16)
def _columns_of_lists(matrices: Any, base: int, digits: int | None) -> Array:
    """Return the columns of matrices given as lists: int64 (d, columns, rows)."""
    listed = isinstance(matrices, tuple) and all(isinstance(m, tuple) and m for m in matrices)
    if not (listed and matrices):
        raise ParameterError(_NO_MATRICES)
    read = [_matrix(j, m, base, digits) for j, m in enumerate(matrices)]
    if len({c.shape for c in read}) > 1:
        shapes = ", ".join(f"{c.shape[1]}x{c.shape[0]}" for c in read)
        raise ParameterError(f"matrices have shapes {shapes}; give all the same shape.")
    if base ** read[0].shape[1] > 2**53:
        raise ParameterError(
            f"matrices have {read[0].shape[1]} rows; {base}^rows must be at most 2^53."
        )
    return np.stack(read)


def _matrix(j: int, matrix: tuple[Any, ...], base: int, digits: int | None) -> Array:
    """Return one matrix as its columns of digits: int64 (columns, rows)."""
    if all(isinstance(row, tuple) for row in matrix):
        if len({len(row) for row in matrix}) != 1 or not matrix[0]:
            raise ParameterError(f"matrices[{j}] has rows of different lengths or empty ones.")
        entries = [
            [as_integer(f"matrices[{j}]", x, least=0, most=base - 1) for x in row] for row in matrix
        ]
        return np.array(entries, dtype=np.int64).T
    rows = len(matrix) if digits is None else as_integer("digits", digits, least=1, most=53)
    most = base**rows - 1
    numbers = [as_integer(f"matrices[{j}]", x, least=0, most=most) for x in matrix]
    places = [base**r for r in range(rows - 1, -1, -1)]
    return np.array([[x // p % base for p in places] for x in numbers], dtype=np.int64)


@lru_cache(maxsize=16)
def _net_of_file(path: str, given: int) -> tuple[int, Array]:
    """Return base and columns (d, m, rows) of a file of matrices; `given` is the default base."""
    with opened(path, "generator matrices") as (stream, size, name, _):
        # The decoded text and the parsed integers take up to 128 bytes for each byte of the file
        check_decoded_size(name, size, 128 * size)
        lines = stream.read().decode().splitlines()
    kept = [line.partition("#")[0].split() for line in lines]
    kept = [words for words in kept if words]
    try:
        width = len(kept[0]) if kept else 0
        if width > 1 and {len(words) for words in kept} == {width} and len(kept) % width == 0:
            # Square matrices of digits, one below the other
            entries = np.array(kept, dtype=np.int64).reshape(-1, width, width)
            return given, _columns_of_lists(_as_tuples(entries), given, None)
        base, dims, _, digits = (int(words[0]) for words in kept[:4])
        matrices = tuple(tuple(int(word) for word in words) for words in kept[4 : 4 + dims])
        if len(matrices) != dims or base < 2:
            raise ValueError
        return base, _columns_of_lists(matrices, base, digits)
    except ValueError as error:
        reason = str(error) if isinstance(error, ParameterError) else ""
        raise FileFormatError(
            f"{path} is not a file of generator matrices (base, dims, n, digits, then a line of "
            f"columns for each dim; or only square matrices, one row per line). {reason}".strip()
        ) from None


def _not_balanced(n: int, base: int, name: str, verb: str) -> str | None:
    """Return a warning for a count that is not a power of the base, else None."""
    above: int = base ** power_from(n, base)
    if above == n:
        return None
    return f"{n} {name} points are not balanced; {above // base} and {above} {verb}."
