"""Randomizations of digits: they preserve elementary intervals, and strata with suitable sides.

Suitable sides of strata are powers of the base. Each sampler has a base for its digits.
The base is usually 2; halton, for instance, has primes. All randomizations act in this base.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.display import counted
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import checked, choice, flag, settle
from mcspectra.core.streams import Stream, uniforms
from mcspectra.samplers import _scramble_kernels as kernels
from mcspectra.samplers._primes import LARGEST_BASE, is_prime
from mcspectra.samplers.base import MAX_COUNT, FixedSet, Randomization, Sampler, Structure
from mcspectra.samplers.law import Law, Scramble, Unknown, scrambled
from mcspectra.samplers.radical import RadicalInverses

__all__ = ["DigitalShift", "Lms", "Owen", "Permute"]

# The jitter and the digital shift use different random numbers.
# The random keys of the jitter are the keys of the digital shift XOR this constant
_JITTER = 0x6A09E667F3BCC908
_BELOW_ONE = 1.0 - 2.0**-53

Base: TypeAlias = int | Sequence[int] | None


def _as_base(name: str, base: object) -> Base:
    if isinstance(base, Sequence | np.ndarray) and not isinstance(base, str):
        return tuple(as_integer(name, b, least=2, most=LARGEST_BASE) for b in base)
    return as_integer(name, base, least=2, most=LARGEST_BASE)


class _OfDigits(Randomization):
    """A randomization of digits in `base`, by default the sampler's base, or 2 if it has none."""

    pointwise: ClassVar[bool] = True
    fits: ClassVar[Mapping[Structure, Structure]] = {
        s: s for s in Structure if s is not Structure.TORUS
    }
    debiases: ClassVar[bool] = True
    keeps_pairs: ClassVar[bool] = True
    base: Base

    def fit(self, sampler: Sampler) -> Self:
        """Adopt the bases of the sampler; raise an error if `base` would break its structure."""
        if sampler.antithetic and not self.keeps_pairs:
            raise ParameterError(
                f"{self.name} would break the pairs of {sampler.spec}, whose points mirror "
                "each other; use shift, digital-shift or permute."
            )
        Randomization.fit(self, sampler)
        own = sampler.digit_bases
        bases = own if self.base is None else self._bases(sampler.dims)
        if sampler.structure is Structure.DIGITS and bases != own:
            raise ParameterError(
                f"{self.spec} would break the elementary intervals of {sampler.spec}, whose digits "
                f"are in base {', '.join(map(str, own if len(set(own)) > 1 else own[:1]))}; "
                "leave base out."
            )
        if sampler.structure is Structure.STRATA:
            breaks = f"{self.spec} would break the strata of {sampler.spec}"
            if len(set(bases)) > 1 or not is_prime(bases[0]):
                raise ParameterError(f"{breaks}; give one prime as base=.")
            if next(_powers_possible(sampler, bases[0], range(32)), None) is None:
                raise ParameterError(
                    f"{breaks}, whose counts are never powers of {bases[0]}; use shift."
                )
        return self if self.base is not None or set(bases) == {2} else replace(self, base=bases)  # type: ignore[type-var]

    def counts_near(self, sampler: Sampler, n: int) -> tuple[int | None, int]:
        """For strata, allow only counts that are powers of the base: sides are then also powers."""
        if not sampler.powers_only:
            return sampler._counts_near(n)
        base, places = self._bases(sampler.dims)[0], 0
        while base ** (places + 1) <= n:
            places += 1
        below = next(_powers_possible(sampler, base, range(places, -1, -1)), None)
        if below == n:
            return n, n
        above = next(_powers_possible(sampler, base, range(places + 1, 32)), 2 * MAX_COUNT)
        return below, above

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        """Draw a fixed set once, or make randomized points directly if there is a kernel."""
        out, keys = np.empty((count, n, sampler.dims)), own.keys(first, count)
        if not self._fill(keys, sampler, n, out):
            points = sampler.draw_stream(n, stream, first, 1 if sampler.fixed else count)
            if count == 1 and isinstance(sampler, FixedSet):
                out = points  # overwrite the points, which nothing else uses
            self._scramble(keys, np.array(self._bases(sampler.dims)), points, out)
        return out

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Randomize the digits of each realization by its own random numbers."""
        out = np.empty(points.shape)
        bases = np.array(self._bases(points.shape[2]))
        self._scramble(stream.keys(first, len(points)), bases, points, out)
        return out

    @abstractmethod
    def _scramble(self, keys: Array, bases: Array, points: Array, out: Array) -> None:
        """Randomize the digits of points (R or 1, n, d) in the given bases."""

    def _fill(self, keys: Array, sampler: Sampler, n: int, out: Array) -> bool:  # noqa: ARG002
        """Make the randomized points of `sampler` directly, if there is a kernel for this.

        Return whether the points were made.
        """
        return False

    def _bases(self, dims: int) -> tuple[int, ...]:
        """Return one base per dim."""
        if not isinstance(self.base, Sequence):
            return (self.base or 2,) * dims
        if len(self.base) != dims:
            raise ParameterError(
                f"base has {counted(len(self.base), 'value')}; give one number or one for each of "
                f"the {dims} dims."
            )
        return tuple(self.base)

    @property
    def _binary(self) -> bool:
        return self.base in (None, 2) or (isinstance(self.base, tuple) and set(self.base) == {2})


def _places(n: int, base: int) -> int:
    """Return the least number of digits that can write n different numbers in a base."""
    places = 0
    while base**places < n:
        places += 1
    return places


def _powers_possible(sampler: Sampler, base: int, exponents: range) -> Iterator[int]:
    """Yield, in ascending order, the powers of `base` that are possible numbers of points.

    The sides of the sampler's strata must then also be powers of `base`.
    """
    powers = (base**k for k in exponents if base**k <= MAX_COUNT)
    return (n for n in powers if n in sampler._counts_near(n) and sampler.digit_strata(n, base))


class _OfPlaces(_OfDigits):
    """Base class: one permutation or shift (`shift`) per digit place, the same for all points."""

    shift: ClassVar[bool] = False

    def _scramble(self, keys: Array, bases: Array, points: Array, out: Array) -> None:
        if self._binary:
            kernels.xor_digits(keys, points, out)
        else:
            kernels.permute_digits(keys, bases, self.shift, points, out)

    def law_of(self, law: Law, n: int) -> Law:  # noqa: ARG002
        """Return the law; in base 2 a permutation is a digital shift."""
        bases = self._bases(law.dims)
        kind: Scramble = "digital-shift" if self.shift or set(bases) == {2} else "permutation"
        return scrambled(law, kind, bases)

    def _fill(self, keys: Array, sampler: Sampler, n: int, out: Array) -> bool:
        del n
        if self._binary or not isinstance(sampler, RadicalInverses):
            return False
        if not (sampler.fixed and sampler.of_one_index):
            return False
        kernels.fill_permuted(keys, np.array(sampler.digit_bases), self.shift, sampler.skip, out)
        return True


@final
@dataclass(frozen=True, kw_only=True)
class DigitalShift(_OfPlaces):
    """Digital shift: one random digit added to each digit modulo the base, the same for all points.

    Elementary intervals map to elementary intervals, and every point becomes uniform.
    In base 2 this is the XOR of all 53 bits with one random word per coordinate.

    Attributes
    ----------
    base
        Base of the digits, one number or one per dim; by default the sampler's base, else 2.
    jitter
        Whether each point has its own random digits after the first m, the smallest m with b^m ≥ n.
        Points of nets then keep their elementary intervals, and fill these intervals uniformly.

    Notes
    -----
    Without `jitter`, all points have one offset in their elementary intervals.
    For smooth functions, the variance is then the same as with a shifted grid.
    With `jitter`, the variance is at most that of stratified points.
    The relative places of points in the net stay the same.
    If the points of a net are far apart, as in larcher-pillichshammer, they stay far apart.
    Nets with points far apart have less variance than with owen, which does not keep them apart.

    References
    ----------
    [DickPillichshammer2010]_, section 4.4
    """

    shift: ClassVar[bool] = True
    base: Base = checked(_as_base, None)
    jitter: bool = flag(default=False)

    def _check(self) -> None:
        if self.jitter:
            settle(self, keeps_pairs=False, pointwise=False)

    def law_of(self, law: Law, n: int) -> Law:
        """Return the law. With jitter, nothing is known of pairs of points."""
        if not self.jitter:
            return _OfPlaces.law_of(self, law, n)
        return Unknown(n=law.n, dims=law.dims)

    def _scramble(self, keys: Array, bases: Array, points: Array, out: Array) -> None:
        _OfPlaces._scramble(self, keys, bases, points, out)
        if not self.jitter:
            return
        # Replace all digits after the first m, where m is the smallest number with b^m ≥ n
        n, dims = out.shape[1:]
        sides = np.array([float(base) ** _places(n, int(base)) for base in bases])
        own = uniforms(keys ^ np.uint64(_JITTER), n * dims).reshape(out.shape)
        # Keep as many digits of the jitter as fit into a float together with the first m
        fine = 2.0 ** (52.0 - np.ceil(np.log2(sides)))
        own = np.floor(own * fine) / fine
        np.floor(out * sides, out=out)
        out += own
        out /= sides
        np.minimum(out, _BELOW_ONE, out=out)

    def _fill(self, keys: Array, sampler: Sampler, n: int, out: Array) -> bool:
        return not self.jitter and _OfPlaces._fill(self, keys, sampler, n, out)


@final
@dataclass(frozen=True, kw_only=True)
class Permute(_OfPlaces):
    """Random digit permutations: one for each place of each coordinate, the same for all points.

    Elementary intervals map to elementary intervals, and every point becomes uniform.
    In base 2 this equals digital-shift.

    Attributes
    ----------
    base
        Base of the digits: one number, or one per dim, as for digital-shift.

    References
    ----------
    [Matousek1998]_
    """

    base: Base = checked(_as_base, None)


@final
@dataclass(frozen=True, kw_only=True)
class Owen(_OfDigits):
    """Owen's nested uniform scrambling: the permutation of a digit depends on all digits above it.

    Digits are scrambled down to 2^-32 (32 bits in base 2).
    Lower digits become independent and uniform.
    Scrambling preserves the balance of nets in the same base.
    In other sets, scrambling mainly preserves the counts in elementary intervals of single axes.

    Attributes
    ----------
    method
        ``"nested"``: all permutations are independent, up to a 64-bit hash of the higher digits.
        ``"hash"``, in base 2 only, is about six times as fast.
        A few multiplications scramble all bits of the reversed word.
        In each multiplication, lower bits change only higher bits.
        Every point is exactly uniform, and nets stay nets.
        The variance depends only on the joint distribution of pairs of points.
        The bit flips below the first digit in which points differ were tested for independence.
        The tests find no dependence between the bit flips of two points.
        For many points together, the tests find that bit flips depend on each other.
    base
        Base of the digits: one number, or one per dim, as for digital-shift.

    Notes
    -----
    The hash is from Laine and Karras, in the form and with the constants of Vegdahl (2021).
    The seed is longer than in the published hashes: two rounds use 126 random bits.
    Each round has a random summand and a random odd factor.

    Halton, hammersley and van-der-corput points are drawn and scrambled in one step.
    Each point derives from the earlier point with which it shares the most digits [Helmer2021]_.

    References
    ----------
    [Owen1995]_, [Owen1997]_, [Burley2020]_, [Vegdahl2021]_
    """

    keeps_pairs: ClassVar[bool] = False
    method: str = choice("nested", "hash")
    base: Base = checked(_as_base, None)

    def law_of(self, law: Law, n: int) -> Law:  # noqa: ARG002
        """Return the law after nested scrambling.

        For two points, scrambling by hashes gives the same joint distribution as nested scrambling.
        """
        return scrambled(law, "nested", self._bases(law.dims))

    def _check(self) -> None:
        if self.method == "hash" and not self._binary:
            raise ParameterError(
                f"owen(method='hash') is for digits in base 2, not {self.base}; "
                "use method='nested'."
            )

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        """Draw scrambled points.

        Radical inverses are drawn and scrambled together, with the random numbers of `stream`.
        Without scrambling, radical inverses use no random numbers.
        """
        if self.method == "nested" and isinstance(sampler, RadicalInverses) and sampler.fixed:
            return sampler.draw_nested(n, stream, first, count)
        return _OfDigits.draw(self, sampler, n, stream, own, first, count)

    def _scramble(self, keys: Array, bases: Array, points: Array, out: Array) -> None:
        if self.method == "hash":
            kernels.scramble_hashed(keys, points, out)
        else:
            kernels.scramble_trees(keys, bases, points, out)


@final
@dataclass(frozen=True, kw_only=True)
class Lms(_OfDigits):
    """Random linear matrix scrambling: each generator matrix times a random lower triangular one.

    The digits of each coordinate are multiplied by a random lower triangular matrix.
    The matrix has a nonzero diagonal. Arithmetic is modulo the base, a prime. Nets stay nets.
    Pairs of points of a net have the same law as with owen.
    Variances are therefore the same as with owen, at lower cost.
    There are fewer different sets than with owen, and these sets are more regular.

    Attributes
    ----------
    shift
        Whether a digital shift follows.
        Without the shift points are not uniform, because the origin does not move.
    base
        Base of the digits: one number, or one per dim, as for digital-shift.

    References
    ----------
    [Matousek1998]_
    """

    keeps_pairs: ClassVar[bool] = False
    shift: bool = flag(default=True)
    base: Base = checked(_as_base, None)

    def law_of(self, law: Law, n: int) -> Law:  # noqa: ARG002
        """Return the law (joint distribution) after a linear scramble, with or without a shift."""
        return scrambled(law, "linear", self._bases(law.dims), shifts=self.shift)

    @property
    def debiases(self) -> bool:  # type: ignore[override]
        """Whether every point is uniform: true if a shift follows."""
        return self.shift

    def fit(self, sampler: Sampler) -> Self:
        """Check that all bases are primes."""
        fitted = _OfDigits.fit(self, sampler)
        composite = [b for b in fitted._bases(sampler.dims) if not is_prime(b)]
        if composite:
            raise ParameterError(
                f"lms needs digits in a prime base, but {sampler.spec} has base {composite[0]}; "
                "use permute or owen."
            )
        return fitted

    def _scramble(self, keys: Array, bases: Array, points: Array, out: Array) -> None:
        if self._binary:
            kernels.mix_matrices(keys, self.shift, points, out)
        else:
            kernels.mix_triangles(keys, bases, self.shift, points, out)

    def _fill(self, keys: Array, sampler: Sampler, n: int, out: Array) -> bool:
        directions = getattr(sampler, "direction_numbers", None)
        if not self._binary or directions is None:
            return False
        kernels.fill_mixed(keys, self.shift, directions(n), out)
        return True
