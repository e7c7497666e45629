"""The law of a sampler: the joint distribution of the points of one realization.

The variance of an estimator combines the spectrum of its integrand with the sampler's covariance:

    Var(I_n) = Σ_m Σ_l conj(f_m) f_l C_ml,     C_ml = ⟨S_m conj(S_l)⟩ − ⟨S_m⟩ conj⟨S_l⟩,

The covariance C_ml is a property of the sampler's law.
A sampler states its law once, in `Sampler.law`. All else is computed by functions of the law.
Functions of a law compute closed forms, exact variances, predictions and rates.
The orthonormal basis that fits the sampler is also chosen by a function of the law.
Each function chooses a formula by the outermost class of a law, and calls itself on inner laws.
The name of a sampler never decides which formula is used.

A law is a small tree of frozen classes. Leaves describe how points are drawn:

    Independent:  n independent uniform points
    Strata:       one independent motif (one point or a pair) in each cell of a grid
    PairedAxes:   pairs of points that share, or do not share, strata of each axis
    Fixed:        the set is the same every time
    Stationary:   a set whose law is the same after any translation of the torus
    Choice:       one of several laws, chosen at random
    GroupedAxes:  independent sets in groups of axes, with points paired at random
    Unknown:      points that can only be drawn

Operators describe how a set is randomized:

    Shifted:      one uniform translation of all points (Cranley-Patterson)
    Moved:        one fixed translation of all points
    Scrambled:    random permutations of the digits of all points
    Folded:       the map u → 1 − |2u − 1| of every coordinate
    Mirrored:     reflections of every coordinate

The order of the points does not belong to the law, because estimates are sums over points.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import ClassVar, Literal, Protocol, Self, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import Function, NoClosedForm, ParameterError
from mcspectra.core.fields import settle
from mcspectra.core.streams import Stream

__all__ = [
    "AntitheticPair",
    "BoxPoint",
    "Choice",
    "Fixed",
    "Folded",
    "GaussianPoint",
    "GroupedAxes",
    "Independent",
    "Law",
    "Mirrored",
    "Motif",
    "Moved",
    "PairPattern",
    "PairedAxes",
    "Scramble",
    "Scrambled",
    "Shifted",
    "Source",
    "Stationary",
    "Strata",
    "UniformPoint",
    "Unknown",
    "as_scrambled",
    "bases_to_scramble",
    "independent_sets",
    "is_power",
    "latin_hypercube",
    "leaf_of",
    "mean_of_terms",
    "moved",
    "paired_axes_of_array",
    "scrambled",
    "shifted",
    "unmoved",
]


_MOST_TERMS = 2**32
"""Largest number of terms of a sum over points and frequencies. The sum takes half a minute."""
_MOST_COUNTS = 2**28
"""Largest number of comparisons of digits: the number of points times levels of digits.

The largest number of comparisons takes about a minute."""
_TERMS_AT_ONCE = 2**22
"""Number of terms held in memory at a time: 64 MB of complex numbers."""


class Source(Protocol):
    """Attributes of a sampler that its law (joint distribution of the points) uses."""

    @property
    def spec(self) -> str: ...
    @property
    def max_count(self) -> int: ...
    def draw_stream(self, n: int, stream: Stream, first: int, count: int, /) -> Array: ...
    def __hash__(self) -> int: ...


@dataclass(frozen=True, kw_only=True)
class Law(ABC):
    """The joint distribution of the n points of one realization.

    Attributes
    ----------
    n, dims
        Number of points and of coordinates.
    source
        The sampler that draws points with this joint distribution.
    fixed
        Whether all realizations are the same set.
    uniform
        Whether every point is uniform on [0,1)^d, so that estimates are unbiased.
    stationary
        Whether the law is the same after any translation of the torus.
    """

    fixed: ClassVar[bool] = False
    uniform: ClassVar[bool] = True
    stationary: ClassVar[bool] = False
    n: int
    dims: int
    source: Source | None = field(default=None, compare=False, repr=False)

    def draw(self, stream: Stream, first: int, count: int) -> Array:
        """Draw realizations first … first + count − 1: float64 (count, n, dims)."""
        assert self.source is not None
        return self.source.draw_stream(self.n, stream, first, count)

    @property
    def name(self) -> str:
        """Name in messages: the spec of the sampler, or the class of the law."""
        return type(self).__name__ if self.source is None else self.source.spec

    def of(self, source: Source) -> Self:
        """Return a copy of this joint distribution, with `source` as the sampler that draws it."""
        return replace(self, source=source)


# Basic laws: how points are drawn before any randomization


@final
@dataclass(frozen=True, kw_only=True)
class Independent(Law):
    """n independent uniform points."""

    stationary: ClassVar[bool] = True


class Motif(ABC):
    """Abstract base class of motifs. A motif is the group of points in one cell of `Strata`.

    The coordinates of the points are in units of cells.

    Attributes
    ----------
    size
        Number of points.
    wraps
        Whether points may leave their cell and are then wrapped around the torus.
        If points wrap, transforms are valid only at integer frequencies.
    uniform
        Whether every point of the motif is uniform in its cell.
        If points wrap, this states whether every point of the motif is uniform on the torus.
    """

    size: ClassVar[int] = 1
    wraps: bool = False
    uniform: bool = True

    @abstractmethod
    def mean(self, a: Array) -> Array:
        """Return the mean ⟨M(a)⟩ at frequencies a (..., d).

        M(a) is the mean of exp(−2πi a·ξ) over the points ξ of one motif.
        """

    @abstractmethod
    def second(self, a: Array, b: Array) -> Array:
        """Return ⟨M(a) conj M(b)⟩ for the frequencies a and b (..., d)."""


@dataclass(frozen=True)
class _Point(Motif):
    """One point with independent coordinates; `axis` gives the transform of a coordinate."""

    @abstractmethod
    def axis(self, a: Array) -> Array:
        """Fourier transform of each coordinate at the frequencies a."""

    def mean(self, a: Array) -> Array:
        """Return the product of the transforms of the axes."""
        return np.asarray(np.prod(self.axis(a), axis=-1))

    def second(self, a: Array, b: Array) -> Array:
        """Return ⟨M(a) conj M(b)⟩: for one point, the Fourier transform of its density at a − b."""
        return self.mean(a - b)


@final
@dataclass(frozen=True)
class UniformPoint(_Point):
    """Motif of one uniform point in the cell."""

    def axis(self, a: Array) -> Array:
        """Return χ(a) = sinc(πa) exp(−iπa)."""
        return np.asarray(np.sinc(a) * np.exp(-1j * np.pi * np.remainder(a, 2.0)))


@final
@dataclass(frozen=True)
class BoxPoint(_Point):
    """A uniform point in a box of the given width around the center of the cell."""

    width: float

    @property
    def wraps(self) -> bool:  # type: ignore[override]
        """Boxes wider than a cell wrap around the torus."""
        return self.width > 1.0

    @property
    def uniform(self) -> bool:  # type: ignore[override]
        """Whether the boxes tile the torus."""
        return self.width >= 1.0 and self.width.is_integer()

    def axis(self, a: Array) -> Array:
        """Return exp(−iπa) sinc(π width a)."""
        return np.asarray(_center(a) * np.sinc(self.width * a))


@final
@dataclass(frozen=True)
class GaussianPoint(_Point):
    """A Gaussian point around the center of the cell; `width` is the standard deviation."""

    width: float
    wraps: ClassVar[bool] = True  # type: ignore[misc]
    uniform: ClassVar[bool] = False  # type: ignore[misc]

    def axis(self, a: Array) -> Array:
        """Return exp(−iπa) exp(−2π² width² a²)."""
        return np.asarray(_center(a) * np.exp(-2.0 * (np.pi * self.width * a) ** 2))


@final
@dataclass(frozen=True)
class AntitheticPair(Motif):
    """A uniform point of a cell and its reflection through the cell's center [Haber1967]_."""

    size: ClassVar[int] = 2

    def mean(self, a: Array) -> Array:
        """Return the transform of one uniform point."""
        return UniformPoint().mean(a)

    def second(self, a: Array, b: Array) -> Array:
        """Return the moment of M(a) = exp(−iπ Σ a) cos(2π a·η), η uniform in the centered cell."""
        mean = 0.5 * (np.prod(np.sinc(a - b), axis=-1) + np.prod(np.sinc(a + b), axis=-1))
        return np.asarray(np.prod(_center(a - b), axis=-1) * mean)


def _center(a: Array) -> Array:
    """Return exp(−iπa) for each coordinate: the transform of a point at the center of a cell."""
    return np.asarray(np.exp(-1j * np.pi * np.remainder(a, 2.0)))


@final
@dataclass(frozen=True, kw_only=True)
class Strata(Law):
    """One independent motif in each cell of a grid.

    Attributes
    ----------
    sides
        Number of cells along each axis.
    motif
        The points in each cell.
    """

    sides: tuple[int, ...]
    motif: Motif = UniformPoint()

    @property
    def uniform(self) -> bool:  # type: ignore[override]
        """Whether a point of the motif is uniform."""
        return self.motif.uniform

    @property
    def jittered(self) -> bool:
        """Whether each cell holds one uniform point."""
        return isinstance(self.motif, UniformPoint)


Relation: TypeAlias = Literal["apart", "same", "mates"]
"""Relation of two points on one axis.

Two points with the relation *apart* are independent and lie in two different strata.
Two points with the relation *same* are independent and lie in one stratum.
Two points with the relation *mates* are uniform in two different parts of one stratum."""


@final
@dataclass(frozen=True)
class PairPattern:
    """A group of ordered pairs of points. On each axis, all pairs have the same relation.

    Attributes
    ----------
    share
        Number of ordered pairs of points in the group, divided by n².
    axes
        Relation of the two points on each axis; the axes are independent.
    """

    share: float
    axes: tuple[Relation, ...]


@final
@dataclass(frozen=True, kw_only=True)
class PairedAxes(Law):
    """Points whose pairs may share strata of single axes: Latin hypercubes and orthogonal arrays.

    Attributes
    ----------
    strata
        Number of strata of each axis.
    parts
        Number of parts of each stratum; each part contains at most one point.
    patterns
        Groups of ordered pairs of different points, by the relation of the points on each axis.
    base
        Base in which every realization is a scrambled net [Tang1993]_; None if there is none.
    """

    strata: tuple[int, ...]
    parts: tuple[int, ...]
    patterns: tuple[PairPattern, ...]
    base: int | None = None

    @property
    def latin(self) -> bool:
        """Whether each of n strata on every axis contains one point."""
        return self.strata == (self.n,) * self.dims


def latin_hypercube(n: int, dims: int) -> PairedAxes:
    """Return the law of a Latin hypercube: one point per stratum on every axis [McKay1979]_."""
    apart: list[Relation] = ["apart"] * dims
    pattern = PairPattern(1.0 - 1.0 / n, tuple(apart))
    return PairedAxes(n=n, dims=dims, strata=(n,) * dims, parts=(1,) * dims, patterns=(pattern,))


def paired_axes_of_array(s: int, dims: int, *, shared_out: bool) -> PairedAxes:
    """Return the law of an orthogonal array of strength 2 with s² points and random level names.

    There are s²(s² − 1) ordered pairs of different points.
    On each axis, s²(s − 1) ordered pairs of points have equal levels.
    No pair of points has equal levels on two axes.
    Each level of an axis is a stratum with s points.
    With `shared_out`, each stratum has s parts with one point each.
    Without `shared_out`, the points in a stratum are independent.
    """
    if dims == 1 and shared_out:
        return latin_hypercube(s * s, 1)
    n, apart = s * s, list[Relation](["apart"] * dims)
    agree: Relation = "mates" if shared_out else "same"
    found = [PairPattern((s - 1) / n * (s + 1 - dims), tuple(apart))]
    for axis in range(dims):
        axes = apart.copy()
        axes[axis] = agree
        found.append(PairPattern((s - 1) / n, tuple(axes)))
    return PairedAxes(
        n=n,
        dims=dims,
        strata=(s,) * dims,
        parts=(s,) * dims,
        patterns=tuple(found),
        base=s if shared_out and s > 1 else None,
    )


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Fixed(Law):
    """The same set every time.

    Attributes
    ----------
    bases
        Base of the digits of each coordinate if the set fills elementary intervals evenly.
        None if the set is not a digital construction.
    vector
        Generating vector z of a rank-1 lattice {k z / n}; None for other sets.
    sides, corner
        Number of grid cells along each axis, and each point's position within its cell, in cells.
        None for sets that are not grids.
    even
        Whether the evenness of the set depends only on differences of points on the torus.
        Examples are lattices and Kronecker points. Translations preserve their evenness.
    digital
        Whether the digits of the points form a group under addition without carry.
        If the digits form a group, every point has the same relation to all other points.
    columns
        Columns of the generator matrices of a digital net in base 2: uint64 (dims, log2 n).
        A column is a 32-bit number with the first digit highest. None if the matrices are unknown.
    seed
        Seed of the set, if one realization of a sampler stands for all realizations.
    """

    fixed: ClassVar[bool] = True
    uniform: ClassVar[bool] = False
    bases: tuple[int, ...] | None = None
    vector: Sequence[int] | None = None
    sides: tuple[int, ...] | None = None
    corner: float = 0.0
    even: bool = False
    digital: bool = False
    columns: Callable[[], Array] | None = None
    seed: int = 0

    @cached_property
    def points(self) -> Array:
        """The set, float64 (n, dims)."""
        if self.source is None and self.vector is not None:
            steps = np.arange(self.n)[:, None] * (np.asarray(self.vector, np.int64) % self.n)
            return np.asarray(steps % self.n / self.n)
        return np.asarray(self.draw(Stream.from_rng(self.seed), 0, 1)[0])

    def agreements(self, bases: Sequence[int], levels: int) -> Array:
        """Return how many points, on average, share the first digits of a point (itself included).

        Entry (l_1, …, l_d) of the array (levels + 1, …) is a mean over all points of the set.
        For each point, count the points with the same first l_j digits in every coordinate j.
        The digits of coordinate j are in base `bases[j]`.

        Raises
        ------
        ParameterError
            If counting the points would take more than about a minute.
        """
        work = float(self.n) * float(levels + 1) ** self.dims
        if work > _MOST_COUNTS:
            raise ParameterError(
                f"{levels} levels in {self.dims} dims of {self.n} points are {work:.2g} counts, "
                f"more than {_MOST_COUNTS:.2g}; lower levels, n or dims."
            )
        points, found = self.points, np.empty((levels + 1,) * self.dims)

        def fill(cells: Array, axis: int, at: tuple[int, ...]) -> None:
            if axis == self.dims:
                found[at] = np.sum(np.bincount(cells).astype(float) ** 2) / self.n
                return
            for level in range(levels + 1):
                # Convert the first digits to whole numbers.
                # A coordinate k/b^level may be rounded down when it is stored as a float.
                # Adding `nudge` ensures that the result is still k
                base, scale = bases[axis], float(bases[axis] ** level)
                nudge = 0.0 if base & (base - 1) == 0 else scale * 2.0**-50
                digits = np.floor(points[:, axis] * scale + nudge)
                prefix = np.minimum(digits, scale - 1.0).astype(np.int64)
                inner = cells * base**level + prefix if self.n > 1 else cells
                fill(np.unique(inner, return_inverse=True)[1], axis + 1, (*at, level))

        fill(np.zeros(self.n, np.int64), 0, ())
        return found


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Stationary(Law):
    """A set whose law is the same after any translation of the torus.

    Attributes
    ----------
    power
        ⟨|S_m|²⟩ at integer m of shape (..., d) in closed form; None if it can only be measured.
    sets
        Number of different sets; None if every realization is a new set.
    """

    stationary: ClassVar[bool] = True
    power: Callable[[Array], Array] | None = None
    sets: int | None = None


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Choice(Law):
    """One of several laws, each with the same probability.

    Attributes
    ----------
    laws
        The laws to choose from, or a random selection of them if there are many.
    sets
        Number of all possible laws, from which `laws` are selected; None if it is unlimited.
    """

    laws: tuple[Law, ...]
    sets: int | None = None

    @property
    def uniform(self) -> bool:  # type: ignore[override]
        """Whether every point is uniform under each of the laws."""
        return all(law.uniform for law in self.laws)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class GroupedAxes(Law):
    """Independent sets in groups of axes, whose points are paired in random orders.

    Point i of the whole set combines the points π_g(i) of the sets of all groups g.
    The permutations π_g are random and independent.
    A Latin hypercube is made of strata of single axes.

    Attributes
    ----------
    parts
        For each group of axes, the law of its set of n points.
    axes
        The axes of each group; by default the first group takes the first axes, and so on.
    """

    parts: tuple[Law, ...]
    axes: tuple[tuple[int, ...], ...] = ()

    def __post_init__(self) -> None:
        if not self.axes:
            ends = np.cumsum([0, *(part.dims for part in self.parts)]).tolist()
            axes = tuple(tuple(range(a, b)) for a, b in pairwise(ends))
            settle(self, axes=axes)
        listed = sorted(axis for group in self.axes for axis in group)
        fits = [part.dims for part in self.parts] == [len(group) for group in self.axes]
        if not (fits and listed == list(range(self.dims))):
            dims = ", ".join(str(part.dims) for part in self.parts)
            raise ParameterError(
                f"The axes {self.axes} of a product of laws in {dims} dims must list each of its "
                f"{self.dims} axes once, as many for each law as it has dims."
            )
        if any(part.n != self.n for part in self.parts):
            counts = ", ".join(str(part.n) for part in self.parts)
            raise ParameterError(
                f"The laws of a product have {counts} points; each must have n = {self.n}."
            )

    @property
    def uniform(self) -> bool:  # type: ignore[override]
        """Whether every point is uniform in each group of axes."""
        return all(part.uniform for part in self.parts)

    @property
    def stationary(self) -> bool:  # type: ignore[override]
        """Whether the sets of all groups of axes are stationary."""
        return all(part.stationary for part in self.parts)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Unknown(Law):
    """Points whose joint distribution is unknown, so that they can only be drawn.

    Attributes
    ----------
    is_uniform
        Whether the sampler declares that every point is uniform.
    sets
        Number of different sets; None if every realization is a new set.
    strata
        Number of strata of each axis that hold one point each, None if it is unknown.
    bases
        Base of the digits of each coordinate in which every set is a net, None if it is unknown.
    """

    is_uniform: bool = True
    sets: int | None = None
    strata: tuple[int, ...] | None = None
    bases: tuple[int, ...] | None = None

    @property
    def uniform(self) -> bool:  # type: ignore[override]
        """Whether the sampler declares that every point is uniform."""
        return self.is_uniform


# Operators on laws: how a set of points is randomized


@final
@dataclass(frozen=True, kw_only=True)
class Shifted(Law):
    """One uniform translation of all points on the torus (Cranley-Patterson).

    Attributes
    ----------
    inner
        The law of the set before the translation.
    """

    stationary: ClassVar[bool] = True
    inner: Law


@dataclass(frozen=True, kw_only=True)
class _Image(Law):
    """The law of a set that is mapped point by point, such as a translated set.

    The mapped set is fixed if the original set is fixed, and uniform if the original is uniform.
    """

    inner: Law

    @property
    def fixed(self) -> bool:  # type: ignore[override]
        """Whether the set before the map is the same in every realization."""
        return self.inner.fixed

    @property
    def uniform(self) -> bool:  # type: ignore[override]
        """Whether every point of the set before the map is uniform."""
        return self.inner.uniform


@final
@dataclass(frozen=True, kw_only=True)
class Moved(_Image):
    """One fixed translation of all points on the torus.

    Attributes
    ----------
    inner
        The law of the set before the translation.
    by
        The translation along each axis, from 0 to 1.
    """

    by: tuple[float, ...]


Scramble: TypeAlias = Literal["digital-shift", "permutation", "linear", "nested"]
"""Kind of randomization of digits, from the most special to the most general kind.

A digital shift adds one random digit to each place.
A permutation permutes the b possible digits at each position of the expansion.
A linear scramble is a random lower triangular matrix and a shift.
Nested permutations depend on all higher digits."""

_SCRAMBLES: tuple[Scramble, ...] = ("digital-shift", "permutation", "linear", "nested")


@final
@dataclass(frozen=True, kw_only=True)
class Scrambled(Law):
    """Random permutations of the digits of all points.

    Attributes
    ----------
    inner
        The law of the set before the digits are randomized.
    kind
        Kind of randomization.
        Pairs of points have the same distribution after nested and after linear scrambles.
        Nested and linear scrambles therefore give the same variances.
    bases
        Base of the digits of each coordinate.
    shifts
        Whether every point becomes uniform.
        Matrices alone do not make points uniform, because they map the origin to itself.
    """

    inner: Law
    kind: Scramble
    bases: tuple[int, ...]
    shifts: bool = True

    @property
    def uniform(self) -> bool:  # type: ignore[override]
        """Whether points are uniform: always after a shift, else if the inner law is uniform."""
        return self.shifts or self.inner.uniform

    @property
    def nested_pairs(self) -> bool:
        """Whether pairs of points have the same law as after nested scrambling."""
        return self.kind in ("linear", "nested") and self.shifts

    @property
    def xor(self) -> bool:
        """Whether the scramble is one digital shift in base 2 (XOR) of all points."""
        return self.kind in ("digital-shift", "permutation") and set(self.bases) == {2}


@final
@dataclass(frozen=True, kw_only=True)
class Folded(_Image):
    """Map u → 1 − |2u − 1| of every coordinate: equivalent to folding the integrand."""


@final
@dataclass(frozen=True, kw_only=True)
class Mirrored(_Image):
    """Reflections u → 1 − u of coordinates.

    Attributes
    ----------
    inner
        The law of the set before the reflections.
    mode
        ``"random"``: each coordinate of each point is reflected with probability ½.
        ``"uniform"``: each of n/2^d points is replaced by its 2^d reflections.
    """

    mode: Literal["random", "uniform"]

    @property
    def fixed(self) -> bool:  # type: ignore[override]
        """Whether all realizations are the same set, as for uniform reflections of a fixed set."""
        return self.mode == "uniform" and self.inner.fixed


# Joint distributions (laws) of randomized sets


def shifted(law: Law) -> Law:
    """Return the law after one uniform translation of the torus."""
    while isinstance(law, Moved):
        law = law.inner
    return law if law.stationary else Shifted(n=law.n, dims=law.dims, inner=law)


def moved(law: Law, by: Sequence[float]) -> Law:
    """Return the law after one fixed translation of the torus."""
    if isinstance(law, Moved):
        by = [a + b for a, b in zip(law.by, by, strict=True)]
        law = law.inner
    if law.stationary:
        return law
    return Moved(n=law.n, dims=law.dims, inner=law, by=tuple(float(b) % 1.0 for b in by))


def scrambled(law: Law, kind: Scramble, bases: Sequence[int], *, shifts: bool = True) -> Law:
    """Return the law after the digits in the given bases are randomized.

    The law of stratified points does not change if the sides of the strata are powers of the base:
    scrambling maps strata to strata, and points are already uniform within a stratum.
    Scrambling does not change the law of points that are stratified along single axes either.
    Samplers refuse scrambles that break their strata.
    """
    digits = tuple(map(int, bases))
    if isinstance(law, Scrambled) and law.bases == digits:
        kind = max(kind, law.kind, key=_SCRAMBLES.index)
        return replace(law, kind=kind, shifts=shifts or law.shifts, source=None)
    if isinstance(law, Independent | PairedAxes):
        return law
    if isinstance(law, Strata) and not law.motif.wraps:
        return law
    return Scrambled(n=law.n, dims=law.dims, inner=law, kind=kind, bases=digits, shifts=shifts)


def as_scrambled(law: Law) -> Law:
    """Convert the law of an orthogonal array with s parts per stratum to a scrambled net's law.

    The second digits are permuted within each first digit [Tang1993]_.
    Nested scrambling of one realization therefore has the same law as the sampler.
    If the set is not an orthogonal array with s parts per stratum, its law is returned unchanged.
    """
    if not isinstance(law, PairedAxes) or law.base is None or law.source is None:
        return law
    bases = (law.base,) * law.dims
    one = Fixed(n=law.n, dims=law.dims, bases=bases).of(law.source)
    return Scrambled(
        n=law.n, dims=law.dims, inner=one, kind="nested", bases=bases, source=law.source
    )


def unmoved(law: Law) -> tuple[Law, Array]:
    """Return the law of the points before their translations, and the sum of fixed translations.

    Only translations that come after all other randomizations are removed from the law.
    """
    by = np.zeros(law.dims)
    while isinstance(law, Moved | Shifted):
        if isinstance(law, Moved):
            by = by + np.array(law.by)
        law = law.inner
    return law, by


def leaf_of(law: Law) -> Law:
    """Return the joint distribution (law) of the set before all randomizations."""
    while isinstance(law, Shifted | Moved | Scrambled | Folded | Mirrored):
        law = law.inner
    return law


def bases_to_scramble(laws: Sequence[Law]) -> tuple[int, ...] | None:
    """Return the bases of the digits in which all given sets are nets, or None.

    The best randomization of nets is scrambling of the digits in their bases.
    The result is None for lattices, which scrambling breaks, and for sets that are not nets.
    For lattices and for sets that are not nets, a shift is the better randomization.
    A set of a few points can be both a net and a lattice.
    If all other sets are lattices, a set that is a net and a lattice counts as a lattice.
    Otherwise, a set that is a net and a lattice counts as a net.
    """
    found = {law.bases if isinstance(law, Fixed | Unknown) else None for law in laws}
    if len(found) > 1 or all(isinstance(law, Fixed) and law.even for law in laws):
        return None
    return found.pop()


def is_power(n: int, base: int) -> bool:
    """Whether n is a power of the base; 1 counts as a power."""
    while n % base == 0:
        n //= base
    return n == 1


def mean_of_terms(n: int, nu: Array, terms: Callable[[Array], Array]) -> Array:
    """Return the mean of the function `terms` over n points, at frequencies (..., d).

    The function gets frequencies in blocks (F, d).

    Raises
    ------
    NoClosedForm
        If the sum would have too many terms.
    """
    # The points also need memory, even at a single frequency.
    # Therefore the number of terms is computed with at least 64 frequencies
    if float(n) * max(64, nu[..., 0].size) > _MOST_TERMS:
        raise NoClosedForm(
            f"The exact transform of {n} points at {nu[..., 0].size} frequencies would take more "
            f"than {_MOST_TERMS:.2g} terms; use ",
            Function("power_spectrum"),
            ", or ask for fewer frequencies.",
        )
    rows = nu.reshape(-1, nu.shape[-1])
    block = max(1, _TERMS_AT_ONCE // n)
    parts = [terms(rows[i : i + block]).mean(axis=-1) for i in range(0, len(rows), block)]
    return np.concatenate(parts).reshape(nu.shape[:-1])


def independent_sets(law: Law) -> int | None:
    """Return the number of different sets, or None if every realization is a new set.

    A randomization makes new realizations from a few sets.
    However, power spectra, distances of points and variances depend on the sets only.
    Standard errors must therefore be based on the number of sets.
    If there are K sets, realization r uses set r modulo K.
    """
    match law:
        case Stationary() | Choice() | Unknown():
            return law.sets
        case Shifted() | Moved() | Scrambled() | Folded() | Mirrored():
            return independent_sets(law.inner)
        case GroupedAxes():
            known = [independent_sets(part) for part in law.parts]
            return min((sets for sets in known if sets is not None), default=None)
    return None
