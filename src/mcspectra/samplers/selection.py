"""Randomizations that select or reorder the points of a sampler: subset, skip, shuffle."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import NotPowerOfTwoWarning, ParameterError
from mcspectra.core.fields import choice, whole
from mcspectra.core.jit import kernel
from mcspectra.core.streams import Stream, mix_bits, mix_uniform
from mcspectra.samplers.base import MAX_COUNT, Randomization, Sampler, Structure
from mcspectra.samplers.law import Fixed, Independent, Law

__all__ = ["Shuffle", "Skip", "Subset"]

_NUMBERS = 2**24  # number of coordinates of whole sets in memory at a time: 128 MiB
_PARTS: dict[Structure, Structure] = dict.fromkeys(Structure, Structure.NONE) | {
    Structure.UNKNOWN: Structure.UNKNOWN,
    Structure.TORUS: Structure.TORUS,
}
"""Structures that a subset of the points keeps: minimum distances remain, full strata do not."""

_MOST_MADE = 2**27
"""Largest number of coordinates of a set from which points are selected: 1 GiB."""


@final
@dataclass(frozen=True, kw_only=True)
class Subset(Randomization):
    """Subset: n points out of a larger set of the sampler, in their order.

    Attributes
    ----------
    of
        Number N of points of the whole set.
        The default, the sampler's smallest count ≥ n, makes any n possible with any sampler.
    pick
        ``"random"``: every subset of n of the N points has the same probability.
        ``"run"``: n successive points from a random start, continued cyclically.

    Notes
    -----
    The points of a subset are at least as far apart as the points of the whole set.
    Strata or intervals of the whole set that contain one point each are preserved only if n = N.

    References
    ----------
    [Knuth1997]_, section 3.4.2, algorithm S.
    """

    fits: ClassVar[Mapping[Structure, Structure]] = _PARTS
    of: int | None = whole(None, least=1, most=MAX_COUNT)
    pick: str = choice("random", "run")

    def fit(self, sampler: Sampler) -> Randomization:
        """Check that `sampler` can make the number of points of the whole set."""
        if self.of is not None:
            _check_size(self, sampler, self.of)
            with warnings.catch_warnings():
                # A random subset is not balanced, whatever the number of points of the whole set
                warnings.simplefilter("ignore", NotPowerOfTwoWarning)
                sampler.check_count(self.of)
        return Randomization.fit(self, sampler)

    def law_of(self, law: Law, n: int) -> Law:
        """Return the law of the subset; it is known for independent points and for the full set."""
        if isinstance(law, Independent):
            return Independent(n=n, dims=law.dims)
        return law if law.n == n else Randomization.law_of(self, law, n)

    def count_inside(self, sampler: Sampler, n: int) -> int:
        """Return the size of the whole set."""
        return self.of or sampler._counts_near(n)[1]

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Return a copy of all points."""
        del stream, first
        return points.copy()

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        """Draw whole sets of points, and select n points of each set at random."""

        def pick(points: Array, start: int, out: Array) -> None:
            _pick(own.keys(start, len(out)), self.pick == "run", points, out)

        size = self.of or sampler._counts_near(n)[1]
        return _picked(sampler, size, pick, stream, first, np.empty((count, n, sampler.dims)))

    def counts_near(self, sampler: Sampler, n: int) -> tuple[int | None, int]:
        """Return the nearest allowed counts: (n, n) if n itself is allowed.

        Every n up to the size of the whole set is allowed.
        """
        below, above = sampler._counts_near(n) if self.of is None else (self.of, self.of)
        if n <= above <= MAX_COUNT:
            return n, n
        return below, 2 * MAX_COUNT

    def max_count(self, sampler: Sampler) -> int:
        """Return the size of the whole set."""
        return self.of or sampler.max_count

    def count_warning(self, sampler: Sampler, n: int) -> str | None:
        """Return the warning of `sampler` for the whole set, if all its points are taken."""
        return sampler._count_warning(n) if self.of is None else None


@final
@dataclass(frozen=True, kw_only=True)
class Skip(Randomization):
    """Skip: leave out the first points of a sequence.

    Attributes
    ----------
    count
        Number of points to leave out.

    Notes
    -----
    The sampler must be a sequence (sobol, halton, kronecker, random, …), or sets of given points.
    Other samplers are refused: without its first points, a set covers only a part of the domain.
    If only the origin is omitted, the balance of a net is lost.
    In base b, a run of b^m points is a balanced net only if `count` is a multiple of b^m.
    Skipped points are computed and discarded.

    References
    ----------
    [Owen2022]_.
    """

    fixed: ClassVar[bool] = True
    pointwise: ClassVar[bool] = True
    count: int = whole(0, least=0, most=MAX_COUNT)

    def fit(self, sampler: Sampler) -> Randomization:
        """Check that the sampler is a sequence."""
        _check_size(self, sampler, self.count)
        if not (sampler.sequence or sampler.structure is Structure.UNKNOWN):
            raise ParameterError(
                f"skip would break the uniform coverage of {sampler.spec}, which is not a "
                "sequence; use a sequence such as sobol, halton or kronecker, or use subset."
            )
        return Randomization.fit(self, sampler)

    def law_of(self, law: Law, n: int) -> Law:
        """Return the law. Points of a fixed sequence are fixed, even if some are skipped."""
        if isinstance(law, Independent):
            return Independent(n=n, dims=law.dims)
        if isinstance(law, Fixed):
            return Fixed(n=n, dims=law.dims, bases=law.bases)
        return Randomization.law_of(self, law, n)

    def count_inside(self, sampler: Sampler, n: int) -> int:  # noqa: ARG002
        """Return the number of points to draw, including the omitted points."""
        return n + self.count

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Return all points except the first `count`."""
        del stream, first
        return points[:, self.count :].copy()

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        """Draw n + count points and leave out the first."""
        del own

        def pick(points: Array, start: int, out: Array) -> None:
            del start
            out[:] = points[:, self.count :]

        out = np.empty((count, n, sampler.dims))
        return _picked(sampler, n + self.count, pick, stream, first, out)

    def counts_near(self, sampler: Sampler, n: int) -> tuple[int | None, int]:
        """Return the counts of `sampler` minus the omitted points."""
        below, above = sampler._counts_near(n + self.count)
        kept = 0 if below is None else below - self.count
        return (kept if kept > 0 else None), above - self.count

    def max_count(self, sampler: Sampler) -> int:
        """Return the largest count of `sampler` minus the omitted points."""
        return max(sampler.max_count - self.count, 0)

    def count_warning(self, sampler: Sampler, n: int) -> str | None:
        """Return the sampler's warning, or a warning if `count` is not a multiple of n."""
        sentence = sampler._count_warning(n)
        if sentence is None and sampler.structure is Structure.DIGITS and self.count % n:
            return (
                f"{n} points of {sampler.spec} after the first {self.count} are not balanced; they "
                f"are after a multiple of {n}."
            )
        return sentence


@final
@dataclass(frozen=True, kw_only=True)
class Shuffle(Randomization):
    """Shuffle: the same points in random order, every order with the same probability.

    Several shuffled sets can be combined into points with more dims. The sets are uncorrelated.
    The first points are a random subset.

    References
    ----------
    [Knuth1997]_, section 3.4.2, algorithm P.
    """

    def law_of(self, law: Law, n: int) -> Law:  # noqa: ARG002
        """Return the law, which does not include the order of points."""
        return law

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Reorder each realization by its own permutation."""
        out = points.copy()
        _shuffle_points(stream.keys(first, len(points)), out)
        return out


def _check_size(step: Randomization, sampler: Sampler, size: int) -> None:
    if size * sampler.dims > _MOST_MADE:
        raise ParameterError(
            f"{step.spec} has to make {size} points in {sampler.dims} dims first; "
            f"at most {_MOST_MADE // sampler.dims} are possible."
        )


def _picked(
    sampler: Sampler,
    size: int,
    pick: Callable[[Array, int, Array], None],
    stream: Stream,
    first: int,
    out: Array,
) -> Array:
    """Fill out (R, n, d) with the function `pick`, which gets a few sets at a time."""
    block = max(1, _NUMBERS // (size * sampler.dims))
    for start in range(0, len(out), block):
        part = out[start : start + block]
        pick(sampler.draw_stream(size, stream, first + start, len(part)), first + start, part)
    return out


@kernel
def _pick(keys: Array, run: bool, points: Array, out: Array) -> None:
    # Select n of N points of each realization: out (R, n, d), points (R, N, d)
    for r in range(out.shape[0]):
        n, size = out.shape[1], points.shape[1]
        k0, k1 = keys[r, 0], keys[r, 1]
        start = int(mix_uniform(k0, k1, 0) * size)
        taken = 0
        for i in range(size):
            # Selection sampling: take a point with probability (number needed)/(number left)
            if run:
                if taken == n:
                    break
                out[r, taken] = points[r, (start + i) % size]
                taken += 1
            elif mix_uniform(k0, k1, i) * (size - i) < n - taken:
                out[r, taken] = points[r, i]
                taken += 1


@kernel
def _shuffle_points(keys: Array, out: Array) -> None:
    # Shuffle in place from the end (Fisher and Yates); the modulo bias is below n/2^64
    count, n, dims = out.shape
    for r in range(count):
        for i in range(n - 1, 0, -1):
            chosen = np.int64(mix_bits(keys[r, 0], keys[r, 1], i) % np.uint64(i + 1))
            for j in range(dims):
                out[r, i, j], out[r, chosen, j] = out[r, chosen, j], out[r, i, j]
