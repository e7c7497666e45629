"""Randomisations of digits: they keep elementary intervals, and strata whose sides are powers.

All work in the base in which the digits of the sampler mean something (its `digit_bases`): 2, or
the primes of halton, the base of faure.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol, TypeAlias, TypeVar, final, runtime_checkable

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import _digit_kernels, _scramble_kernels
from mcspectra.samplers._primes import LARGEST_BASE, is_prime
from mcspectra.samplers.base import MAX_COUNT, Randomization, Sampler, Structure

__all__ = ["DigitalShift", "Lms", "Owen", "Permute"]

Base: TypeAlias = int | Sequence[int] | None

_FITS: dict[Structure, Structure] = {s: s for s in Structure if s is not Structure.TORUS}
"""What randomisations of digits leave."""


@final
@dataclass(frozen=True, kw_only=True)
class DigitalShift(Randomization):
    """Digital shift: one random digit added to each digit, modulo the base, the same for all points.

    Elementary intervals go to elementary intervals, and every point becomes uniform. In base 2 that
    is the XOR of all 53 bits with one random word for each coordinate.

    Attributes
    ----------
    base
        Base of the digits, one or one for each dim; by default that of the sampler, else 2.

    References
    ----------
    Dick, Pillichshammer (2010), "Digital Nets and Sequences", section 4.4,
    doi 10.1017/CBO9780511761188.
    """

    name: ClassVar[str] = "digital-shift"
    pointwise: ClassVar[bool] = True
    fits: ClassVar[Mapping[Structure, Structure]] = _FITS
    debiases: ClassVar[bool] = True
    base: Base = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "base", _checked_base(self.base))

    def fit(self, sampler: Sampler) -> Randomization:
        """Take over the bases of the sampler."""
        return _fitted(self, sampler)

    def counts_near(self, sampler: Sampler, n: int) -> tuple[int | None, int]:
        """On strata, the sampler's counts that are powers of the base."""
        return _counts_near(self, sampler, n)

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Add each realisation's own digits."""
        return _permuted(points, stream.keys(first, len(points)), self.base, shift=True)


@final
@dataclass(frozen=True, kw_only=True)
class Permute(Randomization):
    """Random digit permutations: one for each place of each coordinate, the same for all points.

    Elementary intervals go to elementary intervals, and every point becomes uniform. In base 2 that
    is the same as digital-shift.

    Attributes
    ----------
    base
        As for digital-shift.

    References
    ----------
    Matoušek (1998), "On the L2-discrepancy for anchored boxes", doi 10.1006/jcom.1998.0489.
    """

    name: ClassVar[str] = "permute"
    pointwise: ClassVar[bool] = True
    fits: ClassVar[Mapping[Structure, Structure]] = _FITS
    debiases: ClassVar[bool] = True
    base: Base = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "base", _checked_base(self.base))

    def fit(self, sampler: Sampler) -> Randomization:
        """Take over the bases of the sampler."""
        return _fitted(self, sampler)

    def counts_near(self, sampler: Sampler, n: int) -> tuple[int | None, int]:
        """On strata, the sampler's counts that are powers of the base."""
        return _counts_near(self, sampler, n)

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Permute the digits of each realisation by its own permutations."""
        return _permuted(points, stream.keys(first, len(points)), self.base, shift=False)


@final
@dataclass(frozen=True, kw_only=True)
class Owen(Randomization):
    """Owen's nested uniform scrambling: the permutation of a digit depends on all digits above it.

    Digits are scrambled down to 2^-32 (32 bits in base 2); lower digits become independent
    and uniform. Only the balance of nets in that base survives it: other sets keep
    their multiplicities in the elementary intervals of each axis and little else.

    Attributes
    ----------
    method
        ``"nested"``: all permutations independent, up to a 64-bit hash of the digits above.
        ``"hash"``: in base 2 only, some six times as fast: all bits by a few multiplications in
        which lower bits of the reversed word change higher ones only. Points are
        exactly uniform, nets stay nets, and the flips of two points below their first different
        digit pass tests of independence, on which variances depend; those of many points together
        do not.
    base
        As for digital-shift.

    Notes
    -----
    The hash is Laine and Karras's in the form and with the constants of Vegdahl (2021), its seed
    made longer: two rounds, each with a random summand and a random odd factor, 126 random bits.

    References
    ----------
    Owen (1995), "Randomly permuted (t, m, s)-nets and (t, s)-sequences",
    doi 10.1007/978-1-4612-2552-2_19; Owen (1997), "Scrambled net variance for integrals of smooth
    functions", doi 10.1214/aos/1031594731; Burley (2020), "Practical hash-based Owen scrambling",
    Journal of Computer Graphics Techniques 9(4), 1–20; Vegdahl (2021), "Building a better LK hash",
    psychopath.io.
    """

    name: ClassVar[str] = "owen"
    pointwise: ClassVar[bool] = True
    fits: ClassVar[Mapping[Structure, Structure]] = _FITS
    debiases: ClassVar[bool] = True
    method: str = "nested"
    base: Base = None

    def __post_init__(self) -> None:
        as_choice("method", self.method, ("nested", "hash"))
        object.__setattr__(self, "base", _checked_base(self.base))
        if self.base is not None:
            self._check_method(self.base)

    def fit(self, sampler: Sampler) -> Randomization:
        """Take over the bases of the sampler."""
        _check_pairs(self, sampler)
        fitted = _fitted(self, sampler)
        self._check_method(fitted.base)
        return fitted

    def counts_near(self, sampler: Sampler, n: int) -> tuple[int | None, int]:
        """On strata, the sampler's counts that are powers of the base."""
        return _counts_near(self, sampler, n)

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        """Hash the words of binary sequences where they are made."""
        if self.method == "hash" and isinstance(sampler, _HasDirections):
            out = np.empty((count, n, sampler.dims))
            directions = sampler.direction_numbers(n)
            _scramble_kernels.fill_hashed(own.keys(first, count), directions, out)
            return out
        return self.apply(sampler.draw_stream(n, stream, first, count), own, first)

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Scramble each realisation with its own tree of permutations."""
        out = np.empty(points.shape)
        keys = stream.keys(first, len(points))
        if not _binary(self.base):
            bases = np.array(_as_bases(self.base, points.shape[2]))
            _digit_kernels.scramble_trees(keys, bases, points, out)
        elif self.method == "hash":
            _scramble_kernels.scramble_hashed(keys, points, out)
        else:
            _scramble_kernels.scramble_nested(keys, points, out)
        return out

    def _check_method(self, base: Base) -> None:
        if self.method == "hash" and not _binary(base):
            raise ParameterError(
                f"owen(method='hash') is for digits in base 2, not {base}; use method='nested'."
            )


@final
@dataclass(frozen=True, kw_only=True)
class Lms(Randomization):
    """Random linear matrix scrambling: each generator matrix times a random lower triangular one.

    The digits of each coordinate are multiplied by a random lower triangular matrix, its diagonal
    not zero, modulo the base, a prime: nets stay nets. Pairs of points of a net are moved as by
    owen, so that variances are the same, at less cost; sets are fewer and more regular.

    Attributes
    ----------
    shift
        Whether a digital shift follows: without it the origin stays where it is, and points are
        not uniform.
    base
        As for digital-shift.

    References
    ----------
    Matoušek (1998), "On the L2-discrepancy for anchored boxes", doi 10.1006/jcom.1998.0489.
    """

    name: ClassVar[str] = "lms"
    pointwise: ClassVar[bool] = True
    fits: ClassVar[Mapping[Structure, Structure]] = _FITS
    shift: bool = True
    base: Base = None

    def __post_init__(self) -> None:
        if not isinstance(self.shift, bool):
            raise ParameterError(f"shift is {self.shift!r}; give True or False.")
        object.__setattr__(self, "base", _checked_base(self.base))

    @property
    def debiases(self) -> bool:  # type: ignore[override]
        """Only the shift makes every point uniform."""
        return self.shift

    def fit(self, sampler: Sampler) -> Randomization:
        """Take over the bases of the sampler; they must be primes."""
        _check_pairs(self, sampler)
        fitted = _fitted(self, sampler)
        composite = [b for b in _as_bases(fitted.base, sampler.dims) if not is_prime(b)]
        if composite:
            raise ParameterError(
                f"lms needs digits in a prime base, but {sampler.spec} has base {composite[0]}; "
                "use permute or owen."
            )
        return fitted

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        """Multiply the matrices of binary sequences instead of their points."""
        if _binary(self.base) and isinstance(sampler, _HasDirections):
            out = np.empty((count, n, sampler.dims))
            directions = sampler.direction_numbers(n)
            _scramble_kernels.fill_mixed(own.keys(first, count), self.shift, directions, out)
            return out
        return self.apply(sampler.draw_stream(n, stream, first, count), own, first)

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Multiply the digits of each realisation by its own matrices."""
        out = np.empty(points.shape)
        keys = stream.keys(first, len(points))
        if _binary(self.base):
            _scramble_kernels.mix_matrices(keys, self.shift, points, out)
        else:
            bases = np.array(_as_bases(self.base, points.shape[2]))
            _digit_kernels.mix_triangles(keys, bases, self.shift, points, out)
        return out


@runtime_checkable
class _HasDirections(Protocol):
    """Samplers of binary nets that give their generator matrices."""

    dims: int

    def direction_numbers(self, n: int) -> Array: ...


_Step = TypeVar("_Step", DigitalShift, Permute, Owen, Lms)


def _permuted(points: Array, keys: Array, base: Base, *, shift: bool) -> Array:
    out = np.empty(points.shape)
    if _binary(base):
        _scramble_kernels.xor_digits(keys, points, out)
    else:
        bases = np.array(_as_bases(base, points.shape[2]))
        _digit_kernels.permute_digits(keys, bases, shift, points, out)
    return out


def _fitted(step: _Step, sampler: Sampler) -> _Step:
    """Return `step` in the bases of the sampler, or raise if its base or strata do not fit."""
    Randomization.fit(step, sampler)
    bases = sampler.digit_bases if step.base is None else _as_bases(step.base, sampler.dims)
    if sampler.structure is Structure.DIGITS and bases != sampler.digit_bases:
        raise ParameterError(
            f"{step.spec} would break the elementary intervals of {sampler.spec}, whose digits "
            f"are in base {_in_words(sampler.digit_bases)}; leave base out."
        )
    if sampler.structure is Structure.STRATA:
        _check_strata(step, sampler, bases)
    return step if step.base is not None or _binary(bases) else replace(step, base=bases)


def _check_pairs(step: Randomization, sampler: Sampler) -> None:
    if sampler.antithetic:
        raise ParameterError(
            f"{step.name} would break the pairs of {sampler.spec}, whose points mirror each other; "
            "use shift, digital-shift or permute."
        )


def _check_strata(step: _Step, sampler: Sampler, bases: tuple[int, ...]) -> None:
    if len(set(bases)) > 1 or not is_prime(bases[0]):
        raise ParameterError(
            f"{step.spec} would break the strata of {sampler.spec}; give one prime as base=."
        )
    if next(_powers_possible(sampler, bases[0], range(32)), None) is None:
        raise ParameterError(
            f"{step.spec} would break the strata of {sampler.spec}, whose counts are never "
            f"powers of {bases[0]}; use shift."
        )


def _counts_near(step: _Step, sampler: Sampler, n: int) -> tuple[int | None, int]:
    """On strata powers of the base only: their sides then are powers, too."""
    if not sampler.powers_only:
        return sampler._counts_near(n)
    base = _as_bases(step.base, 1)[0] if not isinstance(step.base, tuple) else step.base[0]
    places = 0
    while base ** (places + 1) <= n:
        places += 1
    below = next(_powers_possible(sampler, base, range(places, -1, -1)), None)
    if below == n:
        return n, n
    above = next(_powers_possible(sampler, base, range(places + 1, 32)), 2 * MAX_COUNT)
    return below, above


def _powers_possible(sampler: Sampler, base: int, exponents: range) -> Iterator[int]:
    """Powers of `base` that the sampler can make, in the order of the exponents."""
    powers = (base**k for k in exponents if base**k <= MAX_COUNT)
    return (n for n in powers if n in sampler._counts_near(n) and sampler.digit_strata(n, base))


def _checked_base(base: object) -> Base:
    if base is None:
        return None
    if isinstance(base, Sequence | np.ndarray) and not isinstance(base, str):
        return tuple(_one_base(b) for b in base)
    return _one_base(base)


def _one_base(base: object) -> int:
    return as_integer("base", base, least=2, most=LARGEST_BASE)


def _as_bases(base: Base, dims: int) -> tuple[int, ...]:
    """One base for each dim."""
    if isinstance(base, Sequence):
        if len(base) != dims:
            raise ParameterError(
                f"base has {len(base)} values; give one number or one for each of the {dims} dims."
            )
        return tuple(base)
    return (2 if base is None else base,) * dims


def _binary(base: Base) -> bool:
    return base is None or base == 2 or (isinstance(base, tuple) and set(base) == {2})


def _in_words(bases: tuple[int, ...]) -> str:
    return str(bases[0]) if len(set(bases)) == 1 else ", ".join(map(str, bases))
