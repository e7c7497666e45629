"""Rank-1 lattices: given or built generating vectors, Korobov and Fibonacci lattices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.jit import kernel
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers._repeated import repeated
from mcspectra.samplers.base import MAX_COUNT, Sampler, Structure, check_dims

__all__ = ["Fibonacci", "Korobov", "Rank1Lattice"]

_EVALUATIONS = 2**24  # kernel values per component: about 0.1 s
_LEAST_CANDIDATES = 16


@final
@dataclass(frozen=True, kw_only=True)
class Rank1Lattice(Sampler):
    """Rank-1 lattice {k z / n}, k = 0 … n−1, deterministic; randomise with shift.

    Any dims, any count.

    Attributes
    ----------
    vector
        Generating vector z, one whole number for each dim. By default it is built component by
        component for each n.

    Notes
    -----
    The construction minimises, one component after the other, the squared worst-case error of the
    shifted lattice in the Korobov space of smoothness α = 2 with product weights γ_j = 1/j²,

        P_2 = −1 + (1/n) Σ_k Π_j (1 + γ_j 2π² B_2({k z_j/n})),   B_2(x) = x² − x + 1/6,

    over the z_j ≤ n/2 coprime to n: all of them as long as that takes at most 2^24 values of B_2
    a component (n up to 5,792), else evenly spread ones, 16 at least. Kept in memory by (n, d).

    References
    ----------
    Sloan, Reztsov (2002), "Component-by-component construction of good lattice rules",
    doi 10.1090/S0025-5718-01-01342-4.
    """

    name: ClassVar[str] = "rank1-lattice"
    structure: ClassVar[Structure] = Structure.TORUS
    unbiased: ClassVar[bool] = False
    fixed: ClassVar[bool] = True
    dims: int = DEFAULT_DIMS
    vector: Sequence[int] | None = None

    def __post_init__(self) -> None:
        check_dims(self)
        if self.vector is not None:
            object.__setattr__(self, "vector", _checked_vector(self.vector, self.dims))

    def generating_vector(self, n: int) -> Array:
        """Return z for `n` points: int64 (dims,), 0 ≤ z_j < max(n, 2)."""
        n = self.check_count(n)
        if self.vector is not None:
            return np.array([z % n for z in self.vector], dtype=np.int64)
        return np.array(_built_vector(n, self.dims), dtype=np.int64)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        return _lattices(self.generating_vector(n), n, count)


@final
@dataclass(frozen=True, kw_only=True)
class Korobov(Sampler):
    """Korobov lattice: the rank-1 lattice of (1, a, a², …) modulo n; randomise with shift.

    Any dims, any count.

    Attributes
    ----------
    a
        Generator. By default it is searched for each n.

    Notes
    -----
    The search takes the least squared worst-case error P_2 of the class of smoothness α = 2 with
    equal weights,

        P_2 = −1 + (1/n) Σ_k Π_j (1 + 2π² B_2({k a^(j−1)/n})),   B_2(x) = x² − x + 1/6,

    of the a ≤ n/2 coprime to n (n − a gives the reflected lattice): of all of them as long as that
    takes at most 2^24 values of B_2 (n up to 4,096 in 2-D), else of evenly spread ones, 16 at
    least. Kept in memory by (n, d).

    References
    ----------
    Korobov (1959), "The approximate computation of multiple integrals", Dokl. Akad. Nauk SSSR 124,
    1207–1210; Sloan, Joe (1994), "Lattice methods for multiple integration", section 4.5.
    """

    name: ClassVar[str] = "korobov"
    structure: ClassVar[Structure] = Structure.TORUS
    unbiased: ClassVar[bool] = False
    fixed: ClassVar[bool] = True
    dims: int = DEFAULT_DIMS
    a: int | None = None

    def __post_init__(self) -> None:
        check_dims(self)
        if self.a is not None:
            object.__setattr__(self, "a", as_integer("a", self.a, least=1))

    def generating_vector(self, n: int) -> Array:
        """Return (1, a, a², …) modulo n: int64 (dims,)."""
        n = self.check_count(n)
        a = _best_generator(n, self.dims) if self.a is None else self.a
        return np.array(_powers(a, n, self.dims), dtype=np.int64)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        return _lattices(self.generating_vector(n), n, count)


@final
@dataclass(frozen=True, kw_only=True)
class Fibonacci(Sampler):
    """Fibonacci lattice: n = F_m points {k (1, F_(m−1)) / n}, deterministic (2-D).

    The counts are the Fibonacci numbers 1, 2, 3, 5, 8, …. Randomise with shift.

    References
    ----------
    Sloan, Joe (1994), "Lattice methods for multiple integration", section 4.3; Niederreiter,
    Sloan (1994), "Integration of nonperiodic functions of two variables by Fibonacci lattice
    rules", doi 10.1016/0377-0427(92)00004-S.
    """

    name: ClassVar[str] = "fibonacci"
    structure: ClassVar[Structure] = Structure.TORUS
    unbiased: ClassVar[bool] = False
    fixed: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 2
    dims: int = 2

    def __post_init__(self) -> None:
        if self.dims != 2:
            raise ParameterError(
                f"fibonacci: dims is {self.dims!r}; it must be 2, "
                "for other dims use korobov or rank1-lattice."
            )
        check_dims(self)

    def generating_vector(self, n: int) -> Array:
        """Return (1, F_(m−1)) modulo n = F_m: int64 (2,)."""
        n = self.check_count(n)
        before = _FIBONACCI[_FIBONACCI.index(n) - 1] if n > 1 else 1
        return np.array([1 % n, before % n])

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        return _lattices(self.generating_vector(n), n, count)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        below = max(f for f in _FIBONACCI if f <= n)
        return below, min(f for f in _FIBONACCI if f >= n)


def _fibonacci_numbers() -> tuple[int, ...]:
    """Return 1, 2, 3, 5, 8, … to the first beyond the largest count."""
    numbers = [1, 2]
    while numbers[-1] <= MAX_COUNT:
        numbers.append(numbers[-1] + numbers[-2])
    return tuple(numbers)


_FIBONACCI = _fibonacci_numbers()


@kernel
def _fill_multiples(vector: Array, out: Array) -> None:
    # k z / n, k = 0 … n−1, by adding z modulo n: vector int64 (d,), z_j < n; out (n, d)
    n, dims = out.shape
    for j in range(dims):
        step, multiple = vector[j], 0
        for k in range(n):
            out[k, j] = multiple / n
            multiple += step
            if multiple >= n:
                multiple -= n


def _lattices(vector: Array, n: int, count: int) -> Array:
    """The lattice of a generating vector, `count` times: float64 (count, n, d)."""
    points = np.empty((n, len(vector)))
    _fill_multiples(vector % n, points)
    return repeated(points, count)


def _checked_vector(vector: object, dims: int) -> tuple[int, ...]:
    if not isinstance(vector, Sequence | np.ndarray) or isinstance(vector, str):
        raise ParameterError(
            f"vector is {vector!r}; give a list of whole numbers, one for each of the {dims} dims."
        )
    if len(vector) != dims:
        raise ParameterError(
            f"vector has {len(vector)} components, but dims is {dims}; give one for each dim."
        )
    return tuple(as_integer(f"vector[{j}]", z, least=0) for j, z in enumerate(vector))


@lru_cache(maxsize=256)
def _built_vector(n: int, dims: int) -> tuple[int, ...]:
    """Generating vector by the component-by-component construction."""
    k, bernoulli = np.arange(n), _bernoulli(n)
    candidates = _candidates(n, _EVALUATIONS // n)
    product, vector = np.ones(n), []
    for j in range(1, dims + 1):
        # All first components give the same points: take 1
        options = candidates if j > 1 else candidates[:1]
        errors = [product @ bernoulli[k * z % n] for z in options]
        best = int(options[_first_least(errors)])
        product *= 1.0 + bernoulli[k * best % n] / j**2
        vector.append(best)
    return tuple(vector)


@lru_cache(maxsize=256)
def _best_generator(n: int, dims: int) -> int:
    """Generator of the Korobov lattice of least P_2 (see there)."""
    k, factors = np.arange(n), 1.0 + _bernoulli(n)
    candidates = _candidates(n, _EVALUATIONS // (n * dims))
    errors = []
    for a in candidates:
        product = np.ones(n)
        for z in _powers(int(a), n, dims):
            product *= factors[k * z % n]
        errors.append(product.mean())
    return int(candidates[_first_least(errors)])


def _powers(a: int, n: int, dims: int) -> list[int]:
    """Return 1, a, a², … modulo n, in whole numbers of any size."""
    powers = [1 % n]
    while len(powers) < dims:
        powers.append(powers[-1] * a % n)
    return powers


def _bernoulli(n: int) -> Array:
    """2π² B_2(k/n) for k = 0 … n−1."""
    x = np.arange(n) / n
    return np.asarray(2.0 * np.pi**2 * (x * x - x + 1.0 / 6.0))


def _candidates(n: int, most: int) -> Array:
    """Numbers 1 … n/2 coprime to n (z and n − z give equal errors), thinned evenly to `most`."""
    z = np.arange(1, max(2, n // 2 + 1))
    z = z[np.gcd(z, n) == 1]
    spread = np.linspace(0, z.size - 1, min(max(_LEAST_CANDIDATES, most), z.size))
    return np.asarray(z[spread.astype(np.int64)])


def _first_least(errors: Sequence[float]) -> int:
    """First index whose error is least but for rounding, so that sums in another order agree."""
    values = np.asarray(errors)
    tolerance = 1e-9 * float(np.abs(values).max())
    return int(np.flatnonzero(values <= values.min() + tolerance)[0])
