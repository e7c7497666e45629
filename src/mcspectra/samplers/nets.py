"""Digital nets in any base: given generator matrices, Faure's sequence.

Digit r of coordinate j of point i is the r-th entry of C_j·(digits of i, the lowest first) modulo
the base b.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.decoding import check_decoded_size, opened
from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers import _digital_kernels
from mcspectra.samplers._primes import LARGEST_BASE, is_prime, power_from, prime_from
from mcspectra.samplers._repeated import repeated
from mcspectra.samplers.base import MAX_COUNT, Sampler, Structure, check_dims
from mcspectra.samplers.net_quality import elementary_intervals, net_t_value, t_value

__all__ = ["DigitalNet", "Faure", "elementary_intervals", "net_t_value", "t_value"]

_NO_MATRICES = (
    "matrices is not a list of matrices; give each matrix as a list of rows of "
    "digits, or as a list of whole numbers, one for each column."
)


@final
@dataclass(frozen=True, kw_only=True)
class DigitalNet(Sampler):
    """Digital net from given generator matrices, deterministic; randomise with owen or lms.

    As many dims as matrices; at most b^m points for matrices of m columns, balanced (with luck)
    where n is a power of b.

    Attributes
    ----------
    matrices
        One matrix for each dim: a list of its rows of digits, or a list of its columns as whole
        numbers, the highest digit of which is that of the first row. Or a text file of them.
    base
        The base b.
    digits
        Rows of matrices given as columns: digits of each number, from highest to lowest; by
        default as many as columns.
    dims
        By default the number of matrices; fewer leaves out the last ones.

    Notes
    -----
    Files have one number a line (what follows it is ignored, so are lines that start with ``#``):
    base, dims, largest n, digits; then the columns of one matrix a line, as whole numbers. LatNet
    Builder, the Magic Point Shop and QMCPy share nets in this form.

    References
    ----------
    Niederreiter (1987), "Point sets and sequences with small discrepancy",
    doi 10.1007/BF01294651.
    """

    name: ClassVar[str] = "digital-net"
    structure: ClassVar[Structure] = Structure.DIGITS
    unbiased: ClassVar[bool] = False
    fixed: ClassVar[bool] = True
    matrices: str | Sequence[Any]
    base: int = 2
    digits: int | None = None
    dims: int = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        base = as_integer("base", self.base, least=2, most=LARGEST_BASE)
        object.__setattr__(self, "base", base)
        if not isinstance(self.matrices, str):
            object.__setattr__(self, "matrices", _as_tuples(self.matrices))
        given: Any = self.dims
        most = len(self._columns())
        object.__setattr__(self, "dims", most if given is None else given)
        check_dims(self)
        if self.dims > most:
            raise ParameterError(
                f"digital-net: {self.dims} dims are needed, but there are {most} matrices; "
                "give one for each dim."
            )

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """The base of the matrices, which a file says itself."""
        return (self._net()[0],) * self.dims

    @property
    def max_count(self) -> int:  # type: ignore[override]
        """b^m for matrices of m columns."""
        base, columns = self._net()
        return int(min(base ** columns.shape[1], MAX_COUNT))

    def generator_matrices(self) -> Array:
        """Return the matrices as int64 (dims, rows, columns)."""
        return np.ascontiguousarray(self._columns()[: self.dims].transpose(0, 2, 1))

    def _net(self) -> tuple[int, Array]:
        if isinstance(self.matrices, str):
            return _net_of_file(self.matrices)
        return self.base, _columns_of_lists(self.matrices, self.base, self.digits)

    def _columns(self) -> Array:
        return self._net()[1]

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        base, columns = self._net()
        return _net_points(columns[: self.dims], base, n, count)

    def _count_warning(self, n: int) -> str | None:
        return _not_a_power(n, self._net()[0], "digital-net")


@final
@dataclass(frozen=True, kw_only=True)
class Faure(Sampler):
    """Faure points 0 … n−1, deterministic: a (0, d)-sequence in a prime base b ≥ d.

    Up to 1000 dims; any count, with a warning where it is not a power of b. Randomise with owen,
    lms or digital-shift.

    Attributes
    ----------
    base
        A prime, at least `dims`; by default the smallest such.

    Notes
    -----
    Matrix j is the (j−1)-th power of Pascal's matrix modulo b: the entry in row r and column c is
    binomial(c, r) (j−1)^(c−r).

    References
    ----------
    Faure (1982), "Discrépance de suites associées à un système de numération (en dimension s)",
    Acta Arithmetica 41, 337–351, doi 10.4064/aa-41-4-337-351.
    """

    name: ClassVar[str] = "faure"
    structure: ClassVar[Structure] = Structure.DIGITS
    sequence: ClassVar[bool] = True
    unbiased: ClassVar[bool] = False
    fixed: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 1000
    dims: int = DEFAULT_DIMS
    base: int | None = None

    def __post_init__(self) -> None:
        check_dims(self)
        if self.base is None:
            return
        base = as_integer("base", self.base, least=2, most=LARGEST_BASE)
        if base < self.dims or not is_prime(base):
            raise ParameterError(
                f"faure: base is {base}; give a prime that is at least dims = {self.dims}."
            )
        object.__setattr__(self, "base", base)

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """The same prime for all dims."""
        return (self.base or prime_from(self.dims),) * self.dims

    def generator_matrices(self, digits: int) -> Array:
        """Return the matrices with `digits` rows and columns: int64 (dims, digits, digits)."""
        digits = as_integer("digits", digits, least=1, most=32)
        return _pascal_powers(self.digit_bases[0], self.dims, digits)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        base = self.digit_bases[0]
        matrices = _pascal_powers(base, self.dims, max(1, power_from(n, base)))
        return _net_points(matrices.transpose(0, 2, 1), base, n, count)

    def _count_warning(self, n: int) -> str | None:
        return _not_a_power(n, self.digit_bases[0], "faure")


def _net_points(columns: Array, base: int, n: int, count: int) -> Array:
    """The net of columns (d, m, rows), `count` times: float64 (count, n, d)."""
    points = np.empty((n, len(columns)))
    _digital_kernels.fill_base(np.ascontiguousarray(columns), base, points)
    return repeated(points, count)


def _not_a_power(n: int, base: int, name: str) -> str | None:
    above: int = base ** power_from(n, base)
    if above == n:
        return None
    return f"{n} {name} points are not balanced; {above // base} and {above} can be."


@lru_cache(maxsize=16)
def _pascal_powers(base: int, dims: int, digits: int) -> Array:
    """Powers 0 … dims−1 of Pascal's upper triangular matrix modulo a prime ≥ dims."""
    r, c = np.indices((digits, digits))
    pascal = np.array([[math.comb(k, i) % base for k in range(digits)] for i in range(digits)])
    powers = [pascal * np.where(c >= r, _powers(j, base, digits)[c - r], 0) for j in range(dims)]
    out = np.stack(powers) % base
    out.setflags(write=False)
    return out


def _powers(value: int, base: int, count: int) -> Array:
    """value^0, value^1, … modulo the base; 0^0 is 1."""
    return np.array([pow(value, k, base) for k in range(count)], dtype=np.int64)


def _as_tuples(matrices: object) -> Any:
    """Lists and arrays, nested, as tuples: they can be compared, hashed and written."""
    if isinstance(matrices, np.ndarray):
        matrices = matrices.tolist()
    if isinstance(matrices, Sequence) and not isinstance(matrices, str | bytes):
        return tuple(_as_tuples(part) for part in matrices)
    if isinstance(matrices, int | float | np.number):
        return matrices
    raise ParameterError(_NO_MATRICES)


@lru_cache(maxsize=16)
def _columns_of_lists(matrices: Any, base: int, digits: int | None) -> Array:
    """Columns of matrices given as lists: int64 (d, columns, rows)."""
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
    """One matrix as its columns of digits: int64 (columns, rows)."""
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
def _net_of_file(path: str) -> tuple[int, Array]:
    """Base and columns (d, m, rows) of a text file of generator matrices."""
    with opened(path, "generator matrices") as (stream, size, name, _):
        check_decoded_size(name, size, 128 * size)  # words of a digit, and their integers
        lines = stream.read().decode().splitlines()
    kept = [line.partition("#")[0].split() for line in lines]
    kept = [words for words in kept if words]
    try:
        base, dims, _, digits = (int(words[0]) for words in kept[:4])
        matrices = tuple(tuple(int(word) for word in words) for words in kept[4 : 4 + dims])
        if len(matrices) != dims or base < 2:
            raise ValueError
        return base, _columns_of_lists(matrices, base, digits)
    except ValueError as error:
        reason = str(error) if isinstance(error, ParameterError) else ""
        raise FileFormatError(
            f"{path} is not a file of generator matrices (base, dims, n, digits, then a line of "
            f"columns for each dim). {reason}".strip()
        ) from None
