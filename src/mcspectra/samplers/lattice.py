"""Multiples of a vector on the torus: rank-1, Korobov and Fibonacci lattices, Kronecker points."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_reals
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import settle, whole
from mcspectra.core.jit import kernel
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.samplers.base import MAX_COUNT, FixedSet, PlaneSampler, Sampler, Structure
from mcspectra.samplers.law import Fixed, Law

__all__ = ["Fibonacci", "Korobov", "Kronecker", "Rank1Lattice", "golden_steps", "nested_lattices"]

# Largest number of kernel values in the search for one component of a generating vector.
# A search with this number of kernel values takes 0.1 s
_EVALUATIONS = 2**24
_LEAST_CANDIDATES = 16
_BITS = 64
_S11, _UNIT = np.uint64(11), 2.0**-53


class _Lattice(FixedSet):
    """Abstract lattice: the points {k z / n}, k = 0 … n − 1, of a generating vector z."""

    structure: ClassVar[Structure] = Structure.TORUS

    def generating_vector(self, n: int) -> Array:
        """Return z for `n` points: int64 (dims,), 0 ≤ z_j < max(n, 2)."""
        return np.array(self._vector(self.check_count(n)), dtype=np.int64)

    @abstractmethod
    def _vector(self, n: int) -> Sequence[int]:
        """Return the generating vector z for n points."""

    def _law(self, n: int) -> Law:
        return Fixed(
            n=n, dims=self.dims, vector=tuple(self.generating_vector(n).tolist()), even=True
        )

    def _set(self, n: int) -> Array:
        points = np.empty((n, self.dims))
        _fill_lattice(self.generating_vector(n) % n, points)
        return points


@kernel
def _fill_lattice(vector: Array, out: Array) -> None:
    # Fill out (n, d) with k z / n, k = 0 … n − 1, by repeated addition of vector z, int64 (d,)
    n, dims = out.shape
    for j in range(dims):
        step, multiple = vector[j], 0
        for k in range(n):
            out[k, j] = multiple / n
            multiple += step
            if multiple >= n:
                multiple -= n


@final
@dataclass(frozen=True, kw_only=True)
class Rank1Lattice(_Lattice):
    """Rank-1 lattice {k z / n}, k = 0 … n−1, deterministic; randomize with shift.

    Any dims, any count.

    Attributes
    ----------
    vector
        Generating vector z, one whole number per dim.
        The default is built component by component for each n.

    Notes
    -----
    The construction chooses one component after another, and minimizes P_2.
    P_2 is the squared worst-case error of the shifted lattice in a Korobov space.
    The space has smoothness α = 2 and product weights γ_j = 1/j²:

        P_2 = −1 + (1/n) Σ_k Π_j (1 + γ_j 2π² B_2({k z_j/n})),   B_2(x) = x² − x + 1/6,

    The minimum is over all z_j ≤ n/2 coprime to n.
    The search tries all z_j if this takes at most 2^24 values of B_2 (n up to 5,792).
    For larger n, the search tries at least 16 evenly spaced values of z_j.
    The vector for each pair (n, d) is kept in memory.

    References
    ----------
    [Sloan2002]_
    """

    dims: int = DEFAULT_DIMS
    vector: Sequence[int] | None = None

    def _check(self) -> None:
        vector: Any = self.vector
        if vector is None:
            return
        if not isinstance(vector, Sequence | np.ndarray) or isinstance(vector, str):
            raise ParameterError(
                f"vector is {vector!r}; give a list of whole numbers, one for each of the "
                f"{self.dims} dims."
            )
        if len(vector) != self.dims:
            raise ParameterError(
                f"vector has {len(vector)} components, but dims is {self.dims}; give one for each "
                "dim."
            )
        checked = (as_integer(f"vector[{j}]", z, least=0) for j, z in enumerate(vector))
        settle(self, vector=tuple(checked))

    def _vector(self, n: int) -> Sequence[int]:
        return _built_vector(n, self.dims) if self.vector is None else [z % n for z in self.vector]


@lru_cache(maxsize=256)
def _built_vector(n: int, dims: int) -> tuple[int, ...]:
    """Return the generating vector of the component-by-component construction."""
    k, bernoulli = np.arange(n), _bernoulli(n)
    candidates = _candidates(n, _EVALUATIONS // n)
    product, vector = np.ones(n), []
    for j in range(1, dims + 1):
        # In one dim all components give the same points, so the first component is 1
        options = candidates if j > 1 else candidates[:1]
        errors = [product @ bernoulli[k * z % n] for z in options]
        best = int(options[_first_least(errors)])
        product *= 1.0 + bernoulli[k * best % n] / j**2
        vector.append(best)
    return tuple(vector)


def nested_lattices(sampler: Sampler, n: int, parts: int, *, at_once: bool = False) -> Sampler:
    """Return a sampler of lattices for n points that contain good lattices of fewer points.

    Parameters
    ----------
    sampler
        A `Rank1Lattice`, with or without randomizations.
        Any other sampler, or a lattice with a given generating vector, is returned unchanged.
    n, parts
        Number of points n, a multiple of `parts`.
        By default, `parts` is a power of two.
        For each power of two k up to `parts`, the points 0, k, 2k, … form a lattice.
        With `at_once`, only the points 0, parts, 2 parts, … form a lattice.
        The points 0, parts, 2 parts, … form the lattice of `Rank1Lattice` for n/parts points.
    """
    plain = sampler.plain
    if not isinstance(plain, Rank1Lattice) or plain.vector is not None:
        return sampler
    vector = tuple(plain._vector(n // parts))
    steps = [n] if at_once else [n // parts << k for k in range(1, parts.bit_length())]
    for count in steps:
        vector = _extended_vector(vector, count, parts if at_once else 2)
    made: Sampler = replace(plain, vector=vector)
    for step in sampler.randomizations:
        made = made.then(step)
    return made


@lru_cache(maxsize=256)
def _extended_vector(inner: tuple[int, ...], n: int, parts: int) -> tuple[int, ...]:
    """Return the generating vector of n points with the least error P_2.

    Only vectors that are equal to `inner` modulo n/parts are compared.
    """
    k, bernoulli, factors = np.arange(n), _bernoulli(n), np.arange(parts) * (n // parts)
    product, vector = np.ones(n), []
    for j, z in enumerate(inner, 1):
        options = z + factors
        whole = options[np.gcd(options, n) == 1]
        options = whole if whole.size else options
        errors = [product @ bernoulli[k * option % n] for option in options]
        best = int(options[_first_least(errors)])
        product *= 1.0 + bernoulli[k * best % n] / j**2
        vector.append(best)
    return tuple(vector)


@final
@dataclass(frozen=True, kw_only=True)
class Korobov(_Lattice):
    """Korobov lattice: the rank-1 lattice of (1, a, a², …) modulo n; randomize with shift.

    Any dims, any count.

    Attributes
    ----------
    a
        Generator. By default a search finds one for each n.

    Notes
    -----
    The search minimizes P_2, as in `Rank1Lattice` but with equal weights γ_j = 1.
    Candidates are all a ≤ n/2 coprime to n, since n − a gives the reflected lattice.
    The search tries all candidates if it takes at most 2^24 values of B_2 (n ≤ 4,096 in 2-D).
    For larger n, the search tries at least 16 evenly spaced values of a.
    The generator for each pair (n, d) is kept in memory.

    References
    ----------
    [Korobov1959]_, [SloanJoe1994]_, section 4.5
    """

    dims: int = DEFAULT_DIMS
    a: int | None = whole(None, least=1)

    def _vector(self, n: int) -> Sequence[int]:
        return _powers(_best_generator(n, self.dims) if self.a is None else self.a, n, self.dims)


@lru_cache(maxsize=256)
def _best_generator(n: int, dims: int) -> int:
    """Return the generator of the Korobov lattice of smallest P_2 (see `Korobov`)."""
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
    """Return 1, a, a², … modulo n, computed in exact integers."""
    powers = [1 % n]
    while len(powers) < dims:
        powers.append(powers[-1] * a % n)
    return powers


def _bernoulli(n: int) -> Array:
    """Return 2π² B_2(k/n) for k = 0 … n − 1."""
    x = np.arange(n) / n
    return np.asarray(2.0 * np.pi**2 * (x * x - x + 1.0 / 6.0))


def _candidates(n: int, most: int) -> Array:
    """Return numbers z ≤ n/2 coprime to n (n − z is equivalent), at most `most`, evenly thinned."""
    z = np.arange(1, max(2, n // 2 + 1))
    z = z[np.gcd(z, n) == 1]
    spread = np.linspace(0, z.size - 1, min(max(_LEAST_CANDIDATES, most), z.size))
    return np.asarray(z[spread.astype(np.int64)])


def _first_least(errors: Sequence[float]) -> int:
    """Return the first index whose error is smallest up to rounding."""
    values = np.asarray(errors)
    tolerance = 1e-9 * float(np.abs(values).max())
    return int(np.flatnonzero(values <= values.min() + tolerance)[0])


@final
@dataclass(frozen=True, kw_only=True)
class Fibonacci(PlaneSampler, _Lattice):
    """Fibonacci lattice: n = F_m points {k (1, F_(m−1)) / n}, deterministic (2-D).

    The counts are the Fibonacci numbers 1, 2, 3, 5, 8, …. Randomize with shift.

    References
    ----------
    [SloanJoe1994]_, section 4.3, [NiederreiterSloan1994]_
    """

    other_dims: ClassVar[str] = "for other dims use korobov or rank1-lattice"

    def _vector(self, n: int) -> Sequence[int]:
        before = _FIBONACCI[_FIBONACCI.index(n) - 1] if n > 1 else 1
        return [1 % n, before % n]

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        below = max(f for f in _FIBONACCI if f <= n)
        return below, min(f for f in _FIBONACCI if f >= n)


_FIBONACCI = [1, 2]  # Fibonacci numbers up to the first one above the largest count
while _FIBONACCI[-1] <= MAX_COUNT:
    _FIBONACCI.append(_FIBONACCI[-1] + _FIBONACCI[-2])


@final
@dataclass(frozen=True, kw_only=True)
class Kronecker(FixedSet):
    """Kronecker points {k α}, k = 0, 1, …, deterministic; randomize with shift.

    Any dims, any count.

    Attributes
    ----------
    alpha
        The vector α, one number per dim. The default is the vector of the R-sequence: α_j = φ^(−j).
        The number φ > 1 is the root of φ^(d+1) = φ + 1; in 1-D, φ is the golden ratio.

    Notes
    -----
    Multiples are computed exactly, in integer units of 2^-64 modulo 1.
    The difference of two points therefore depends only on the difference of their indices.
    Simple fractions such as 0.5 put all points on few lines.
    The sampler does not check that α is irrational.

    References
    ----------
    [Roberts2018]_, [Niederreiter1992]_
    """

    structure: ClassVar[Structure] = Structure.TORUS
    sequence: ClassVar[bool] = True
    dims: int = DEFAULT_DIMS
    alpha: Sequence[float] | None = None

    def _check(self) -> None:
        alpha: Any = self.alpha
        if alpha is None:
            return
        listed = isinstance(alpha, Sequence | np.ndarray) and not isinstance(alpha, str)
        if not listed and self.dims > 1:
            raise ParameterError(
                f"alpha is {alpha!r}; give a list of {self.dims} numbers, one for each dim."
            )
        values = as_reals("alpha", alpha, self.dims)
        for j, value in enumerate(values):
            if not _in_units(value):
                raise ParameterError(
                    f"alpha[{j}] is {value!r}, a whole number: all points would have coordinate 0; "
                    "give irrational numbers, e.g. 0.6180339887498949."
                )
        settle(self, alpha=values)

    def steps(self) -> Array:
        """Return α modulo 1 in units of 2^-64: uint64 (dims,)."""
        if self.alpha is None:
            return golden_steps(self.dims)
        return np.array([_in_units(a) for a in self.alpha], dtype=np.uint64)

    def _law(self, n: int) -> Law:
        return Fixed(n=n, dims=self.dims, even=True)

    def _set(self, n: int) -> Array:
        points = np.empty((n, self.dims))
        _fill_kronecker(self.steps(), points)
        return points


@lru_cache(maxsize=64)
def golden_steps(dims: int) -> Array:
    """Return φ^(−1) … φ^(−d) in units of 2^-64, φ^(d+1) = φ + 1: uint64 (dims,), read-only."""
    bits = _BITS + 32  # 32 extra bits, because each power of φ adds rounding error
    one = 1 << bits

    # Find 1/φ by bisection: x = 1/φ solves x^(d+1) + x^d = 1
    ratio, high = 0, one
    while high - ratio > 1:
        middle = (ratio + high) // 2
        power = one
        for _ in range(dims):
            power = power * middle >> bits
        if power + (power * middle >> bits) <= one:
            ratio = middle
        else:
            high = middle

    power, steps = one, []
    for _ in range(dims):
        power = power * ratio >> bits
        steps.append(power >> (bits - _BITS))
    array = np.array(steps, dtype=np.uint64)
    array.setflags(write=False)
    return array


@kernel
def _fill_kronecker(steps: Array, out: Array) -> None:
    # Fill out (n, d) with 0, α, 2α, … modulo 1; steps uint64 (d,) is α in units of 2^-64
    n, dims = out.shape
    for j in range(dims):
        multiple = np.uint64(0)
        for k in range(n):
            out[k, j] = np.float64(multiple >> _S11) * _UNIT
            multiple += steps[j]


def _in_units(value: float) -> int:
    """Return the fraction of a float in units of 2^-64."""
    one = 1 << _BITS
    return round(Fraction(value) % 1 * one) % one
