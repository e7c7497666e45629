"""Exact expected power spectra, and covariances of S_m, for samplers with a known law.

Random, jittered and lattice points are derived in docs/theory.md, "Closed forms".
At *integer* m, a Cranley-Patterson shift multiplies S_m by a random phase.
The shift does not change the power. It makes the covariance matrix C_ml diagonal.

Method
------
There are different closed forms for the three kinds of sets listed below.
All closed forms use two transforms, which are given here for one axis.
In several dims, each transform is the product of the transforms of the axes.
The transform of the unit interval is χ(ν) = sinc(πν) exp(−iπν).
The transform of a grid of s points is A_s(ν) = (1/s) Σ_{j<s} exp(−2πi νj/s).

* Sets of N independent *motifs*, small groups of points. Each cell has the same number of motifs.
  M(ν) is the mean of exp(−2πi ν·ξ) over the points ξ of one motif, in units of cells.
  The mean is ⟨S_ν⟩ = A(ν) ⟨M(ν/s)⟩, and the covariance is
  C_ml = (1/N) A(m − l) [⟨M(m/s) conj M(l/s)⟩ − ⟨M(m/s)⟩ conj⟨M(l/s)⟩].
  For random points, one cell contains n motifs of one point each.
  For jittered, box-jitter and gaussian-jitter points, each motif is a single point.
  Motifs of antithetic-jittered are pairs of points.
* Sets that are the same in every realization, and grids with a common offset.
  The coefficients S_ν of fixed sets, and of grids with a given offset, are known.
* Sets for which the joint distribution of two points is known.
  C_ml + ⟨S_m⟩ conj⟨S_l⟩ = (1/n²) Σ ⟨exp(−2πi (m·x − l·y))⟩ over all ordered pairs of points x, y.
  If x and y are the same point, the mean is the product of χ(m − l) over the axes.
  For two different points the axes are independent, given the strata they share.
  On each axis, the mean over two coordinates is one of three products:
  *free* = χ(m) conj χ(l), if the two coordinates are uniform and independent;
  *same* = A_s(m − l) χ(m/s) conj χ(l/s), if the two coordinates share one of s strata;
  *apart* = (s *free* − *same*) / (s − 1), if the two coordinates lie in different strata.
  Within strata, the two coordinates are uniform and independent.
  For determinantal sets, the joint distribution of two points is known from the kernel.

Importance-sampled points x = T(u), with weights 1/(n p), are covered for some densities p:
the density must be a product over the axes, with monotone warps T.
For warped points, the transform M_t(m) of the warped stratum that starts at t replaces χ.
The products *same* and *apart* above are then averaged over the strata, each with its own t.
If the points are shifted at random, the average is taken over all t from 0 to 1.
On one axis, let A_δ(m) be the coefficient S_m of the grid with offset δ.
A grid with one random offset δ has C_ml = Π_i ∫ A_δ(m_i) conj A_δ(l_i) dδ − δ_m0 δ_l0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial, singledispatch
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array, as_frequencies
from mcspectra.core.errors import (
    Function,
    InfiniteWeightVarianceWarning,
    NoClosedForm,
    ParameterError,
    warn,
)
from mcspectra.densities import Density, Linear, TruncatedNormal, Uniform
from mcspectra.densities.registry import as_warp
from mcspectra.integrands import Integrand
from mcspectra.integrands._quadrature import AxisRule
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.samplers.law import (
    Fixed,
    GroupedAxes,
    Independent,
    Law,
    Motif,
    Moved,
    PairedAxes,
    Scrambled,
    Shifted,
    Stationary,
    Strata,
    UniformPoint,
    mean_of_terms,
    scrambled,
)

__all__ = [
    "SpectralMoments",
    "closed_form_covariance",
    "closed_form_power",
    "moments_of",
    "points_at",
]

_SCRAMBLED_BITS = 32
"""Number of bits that scrambles permute. Lower bits are uniform and independent."""
_MOST_PAIR_TERMS = 2**31
"""Largest number of terms of a sum over digits and frequencies, which takes half a minute."""
_TERMS_AT_ONCE = 2**22
"""Number of terms held in memory at a time: 64 MB of complex numbers."""

# The closed forms of importance-sampled points use the following constants.
_BLOCK = 2**20  # number of values processed at a time
# Largest number of strata times number of frequency pairs, which takes minutes.
_MAX_STRATA_WORK = 2**31
_ORDER = 16
_CELLS = 64
_HIGHEST = 2**16
_PROBES = 4096


def closed_form_power(
    sampler: Sampler | str,
    n: int,
    frequencies: Any,
    density: Density | str | None = None,
) -> Array:
    """Return the exact expected power ⟨|S_ν|²⟩ at listed frequencies.

    Parameters
    ----------
    sampler, n
        Sampler (or spec string) and number of points. Each sampler may be followed by a shift.
        Supported samplers are random, jittered, multi-jittered, regular grids, lattices and nets.
        Latin hypercubes, orthogonal arrays of strength 2 and determinantal sets are supported.
        Grids whose points are displaced at random are also supported.
    frequencies
        Real frequencies ν, shape (..., d), in cycles per unit.
        Frequencies must be integers if a shift is applied, or if sets wrap around the torus.
    density
        Importance density. For random points, any density is allowed.
        Jittered, latin-hypercube and grids allow densities that are products over the axes.
        With a product density, a shift or strata-shift may follow these samplers.
        The frequencies of shifted points must be integers.

    Returns
    -------
    ndarray
        float64 (...). If ∫1/p diverges, the power is infinite, and there is a warning.

    Raises
    ------
    NoClosedForm
        If no closed form is known for this combination.

    Examples
    --------
    >>> closed_form_power("random", 10, [[3, 0], [0, 0]])
    array([0.1, 1. ])
    """
    source, p, nu = points_at(sampler, frequencies, density)
    law = source.law(source.check_count(n))
    if p is None or isinstance(p, Uniform):
        return moments_of(law, source.spec, nu).power(nu)
    reciprocal = p.reciprocal_integral()
    if not np.isfinite(reciprocal):
        warn(
            f"∫1/p diverges for {p.spec}: the expected power is infinite.",
            InfiniteWeightVarianceWarning,
        )
        return np.full(nu.shape[:-1], np.inf)
    if isinstance(law, Independent):
        n = law.n
        return np.asarray(reciprocal / n + (n - 1) / n * np.abs(_product(_interval(nu))) ** 2)
    _check_integers(source.spec, nu)
    covariance = _weighted_covariance(law, source.spec, nu, nu, p)
    return np.asarray(covariance.real + _is_zero(nu))


def closed_form_covariance(
    sampler: Sampler | str,
    n: int,
    frequencies: Any,
    others: Any,
    density: Density | str | None = None,
) -> Array:
    """Return the exact covariance C_ml = ⟨S_m conj S_l⟩ − ⟨S_m⟩ conj⟨S_l⟩ of listed pairs m, l.

    Parameters
    ----------
    sampler, n, density
        Sampler, number of points and importance density, same as for `closed_form_power`.
    frequencies, others
        Frequencies m and l, with shapes (..., d) that broadcast. A density requires integers.

    Returns
    -------
    ndarray
        complex128 (...).

    Raises
    ------
    NoClosedForm
        If no closed form is known for this combination, or if ∫1/p diverges, so C_ml is infinite.

    Examples
    --------
    >>> closed_form_covariance("jittered", 4, [[1], [1]], [[1], [-3]]).real.round(3)
    array([0.047, 0.068])
    """
    source, p, m = points_at(sampler, frequencies, density)
    law = source.law(source.check_count(n))
    other = as_frequencies(others, m.shape[-1])
    try:
        m, other = np.broadcast_arrays(m, other)
    except ValueError:
        raise ParameterError(
            f"frequencies and others have shapes {m.shape} and {other.shape}, which do not "
            "broadcast; give one l for each m, or insert axes of length 1."
        ) from None
    if p is None or isinstance(p, Uniform):
        return moments_of(law, source.spec, m, other).covariance(m, other)
    _check_integers(source.spec, m, other)
    if not np.isfinite(p.reciprocal_integral()):
        raise NoClosedForm(
            f"∫1/p diverges for {p.spec}: the covariances of S_m are infinite; measure the "
            "variance of the estimate by convergence instead."
        )
    return _weighted_covariance(law, source.spec, m, other, p)


@final
@dataclass(frozen=True)
class SpectralMoments:
    """Exact moments of S_ν under a sampler's law."""

    mean: Callable[[Array], Array]  # function that returns ⟨S_ν⟩ (...) for frequencies ν (..., d)
    # Function that maps two arrays of frequencies, both (..., d), to C_ml: complex (...)
    covariance: Callable[[Array, Array], Array]
    # Whether the moments hold only at integer frequencies, because points wrap around the torus
    integer: bool = False

    def power(self, nu: Array) -> Array:
        """⟨|S_ν|²⟩."""
        return np.asarray(self.covariance(nu, nu).real + np.abs(self.mean(nu)) ** 2)


def moments_of(law: Law, name: str, *frequencies: Array) -> SpectralMoments:
    """Return the exact moments of a law, if they are known at the given frequencies.

    Raises
    ------
    NoClosedForm
        If the moments are unknown. The message contains `name`, the spec of the sampler.
    """
    moments = _moments(law)
    if moments is None:
        raise _unknown(name)
    if moments.integer and not all(np.array_equal(nu, np.rint(nu)) for nu in frequencies):
        raise _unknown(name, "at real frequencies")
    return moments


def points_at(
    sampler: Sampler | str, frequencies: Any, density: Density | str | None = None
) -> tuple[Sampler, Density | None, Array]:
    """Convert specs to a sampler and a density with the dims of the frequencies, and check them."""
    # An empty list of frequencies has no dims; for such a list, `as_frequencies` raises an error
    dims = np.shape(frequencies)[-1] or None if np.ndim(frequencies) else None
    drawn = getattr(density, "primary_dims", dims)
    source = as_sampler(sampler, None if isinstance(sampler, Sampler) else drawn)
    p = as_warp(density, source.dims)
    return source, p, as_frequencies(frequencies, source.dims if p is None else p.dims)


def _unknown(name: str, reason: str = "") -> NoClosedForm:
    return NoClosedForm(
        f"No closed-form power is known for {name}{' ' if reason else ''}{reason}; "
        "use power_spectrum, or variance_terms for covariances."
    )


def _check_integers(name: str, *frequencies: Array) -> None:
    if not all(np.array_equal(nu, np.rint(nu)) for nu in frequencies):
        raise _unknown(name, "with a density at real frequencies")


@singledispatch
def _moments(law: Law) -> SpectralMoments | None:  # noqa: ARG001
    """Return the moments of a law, or None if they are unknown."""
    return None


@_moments.register
def _(law: Independent) -> SpectralMoments:
    point = UniformPoint()
    return _motifs((1,) * law.dims, law.n, point)


@_moments.register
def _(law: Strata) -> SpectralMoments:
    return _motifs(law.sides, law.n // law.motif.size, law.motif)


@_moments.register
def _(law: PairedAxes) -> SpectralMoments:
    strata, parts = np.array(law.strata), np.array(law.parts)

    def pairs(m: Array, other: Array) -> Array:
        relations = {
            "apart": _apart(m, other, strata),
            "same": _same(m, other, strata),
            "mates": _level_mates(m, other, strata, parts),
        }
        return np.asarray(
            sum(
                each.share
                * _product(np.stack([relations[r][..., j] for j, r in enumerate(each.axes)], -1))
                for each in law.patterns
            )
        )

    return _of_pairs(law.n, pairs)


@_moments.register
def _(law: GroupedAxes) -> SpectralMoments | None:
    # Groups of axes are independent, both for single points and for pairs of different points
    n, parts = law.n, []
    for part, axes in zip(law.parts, law.axes, strict=True):
        moments = _moments(part)
        if moments is None:
            return None
        parts.append((moments, list(axes)))

    def mean(nu: Array) -> Array:
        return np.asarray(math.prod(each.mean(nu[..., axes]) for each, axes in parts))

    def covariance(m: Array, other: Array) -> Array:
        different: Any = 1.0
        for each, axes in parts:
            a, b = m[..., axes], other[..., axes]
            second = each.covariance(a, b) + each.mean(a) * np.conj(each.mean(b))
            different = different * (n * second - each.mean(a - b)) / max(n - 1, 1)
        second = mean(m - other) / n + (1.0 - 1.0 / n) * different
        return np.asarray(second - mean(m) * np.conj(mean(other)))

    return SpectralMoments(mean, covariance, any(each.integer for each, _ in parts))


@_moments.register
def _(law: Stationary) -> SpectralMoments | None:
    return None if law.power is None else _stationary(law.power)


@_moments.register
def _(law: Shifted) -> SpectralMoments | None:
    if isinstance(law.inner, Fixed) and law.inner.sides is not None:
        return _offset_grid(np.asarray(law.inner.sides, float))
    inner = _moments(law.inner)
    return None if inner is None else _stationary(inner.power)


@_moments.register
def _(law: Moved) -> SpectralMoments | None:
    inner = _moments(law.inner)
    return None if inner is None else _moved(inner, np.array(law.by))


def _motifs(sides: tuple[int, ...], count: int, motif: Motif) -> SpectralMoments:
    """Return moments of S_ν for `count` independent motifs, equally many in each cell."""
    s = np.asarray(sides, float)

    def covariance(m: Array, other: Array) -> Array:
        a, b = m / s, other / s
        within = motif.second(a, b) - motif.mean(a) * np.conj(motif.mean(b))
        return np.asarray(_product(_comb(m - other, s)) * within / count)

    return SpectralMoments(
        lambda nu: _product(_comb(nu, s)) * motif.mean(nu / s), covariance, motif.wraps
    )


def _offset_grid(s: Array) -> SpectralMoments:
    """Return moments of a grid of s points along each axis, all with the same uniform offset."""

    def covariance(m: Array, other: Array) -> Array:
        offset = _product(_interval((m - other) / s))
        offset = offset - _product(_interval(m / s)) * np.conj(_product(_interval(other / s)))
        return np.asarray(_product(_comb(m, s)) * np.conj(_product(_comb(other, s))) * offset)

    return SpectralMoments(lambda nu: _product(_comb(nu, s) * _interval(nu / s)), covariance)


def _stationary(power: Callable[[Array], Array]) -> SpectralMoments:
    """Return moments at integer frequencies of a stationary set, whose S_m are uncorrelated."""

    def covariance(m: Array, other: Array) -> Array:
        same = np.all(m == other, axis=-1)
        return np.asarray(np.where(same, power(m) - _is_zero(m), 0.0) + 0j)

    return SpectralMoments(lambda nu: _is_zero(nu) + 0j, covariance, integer=True)


@_moments.register
def _(law: Fixed) -> SpectralMoments:
    # Compute S_ν of a fixed set from the dual lattice, or by summation
    def mean(nu: Array) -> Array:
        if law.sides is not None:
            s = np.asarray(law.sides, float)
            corner = np.exp(-2j * np.pi * np.remainder(law.corner * nu / s, 1.0))
            return _product(_comb(nu, s) * corner)
        if law.vector is not None and np.array_equal(nu, np.rint(nu)):
            # For a lattice, S_ν is 1 if ν·z ≡ 0 modulo n. Residues are multiplied without overflow
            n, vector = law.n, np.asarray(law.vector, np.int64)
            residues = np.rint(np.remainder(nu, n)).astype(np.int64) * (vector % n) % n
            return np.asarray((residues.sum(axis=-1) % n == 0) + 0j)

        def terms(rows: Array) -> Array:
            return np.asarray(np.exp(-2j * np.pi * np.remainder(rows @ law.points.T, 1.0)))

        return mean_of_terms(law.n, nu, terms)

    return SpectralMoments(
        mean, lambda m, other: np.zeros(np.broadcast(m, other).shape[:-1], complex)
    )


def _of_pairs(n: int, pairs: Callable[[Array, Array], Array]) -> SpectralMoments:
    """Return moments of n uniform points, given the part of C_ml from pairs of different points."""

    def covariance(m: Array, other: Array) -> Array:
        second = _product(_interval(m - other)) / n + pairs(m, other)
        return np.asarray(second - _product(_free(m, other)))

    return SpectralMoments(lambda nu: _product(_interval(nu)), covariance)


def _free(m: Array, other: Array) -> Array:
    return np.asarray(_interval(m) * np.conj(_interval(other)))


def _same(m: Array, other: Array, s: int | Array) -> Array:
    return _comb(m - other, s) * _free(m / s, other / s)


def _apart(m: Array, other: Array, s: int | Array) -> Array:
    strata = np.asarray(s, float)
    difference = strata * _free(m, other) - _same(m, other, s)
    # If there is only one stratum, no pair lies in different strata
    return np.asarray(difference / np.maximum(strata - 1.0, 1.0))


def _level_mates(m: Array, other: Array, s: int | Array, parts: int | Array | None = None) -> Array:
    """Return ⟨exp(−2πi (m x − l y))⟩ for x and y in different parts of a common stratum."""
    return _comb(m - other, s) * _apart(m / s, other / s, s if parts is None else parts)


@_moments.register
def _(law: Scrambled) -> SpectralMoments | None:
    net = law.inner
    if isinstance(net, GroupedAxes):  # each axis has its own permutation of digits
        parts = tuple(
            scrambled(part, law.kind, [law.bases[axis] for axis in axes], shifts=law.shifts)
            for part, axes in zip(net.parts, net.axes, strict=True)
        )
        return _moments(replace(net, parts=parts))
    if not isinstance(net, Fixed):
        return None
    if law.nested_pairs:
        return _of_pairs(law.n, partial(_nested_pairs, net, law.bases))
    if law.kind in ("digital-shift", "permutation"):
        shifted = law.kind == "digital-shift"
        return _of_pairs(law.n, partial(_place_pairs, net, law.bases, shifted))
    return None


def _nested_pairs(law: Fixed, bases: Sequence[int], m: Array, other: Array) -> Array:
    """Return (1/n²) Σ over pairs of different points, after nested scrambling.

    Suppose that two coordinates agree in their first a digits and differ in the next digit.
    Divide [0,1) into b^a strata, and each stratum into b parts.
    After scrambling, both coordinates are in one random stratum, but in two different parts of it.
    Each scrambled coordinate is uniform within its part [Owen1997]_.
    """
    n, levels = law.n, [_levels(law.points[:, j], b) for j, b in enumerate(bases)]
    most = max(levels)
    shares = (law.agreements(bases, most) - 1.0) / n
    # `shares` are fractions of the pairs of points that agree in a or more digits.
    # Subtract successive fractions to get the fraction of pairs that agree in exactly a digits
    for axis in range(law.dims):
        shares = np.moveaxis(shares, axis, 0)
        shares = np.concatenate([shares[:-1] - shares[1:], shares[-1:]])
        shares = np.moveaxis(shares, 0, axis)

    # For all frequencies, sum over the number of digits that agree, one axis after another
    total = shares[..., None]
    flat, far = (np.broadcast_to(a, m.shape).reshape(-1, law.dims) for a in (m, other))
    if float(shares.size) * len(flat) > _MOST_PAIR_TERMS:
        raise NoClosedForm(
            f"The covariances of {n} scrambled points at {len(flat)} pairs of frequencies take "
            f"more than {_MOST_PAIR_TERMS:.2g} terms; use ",
            Function("power_spectrum"),
            ", or ask for fewer.",
        )
    for axis in range(law.dims - 1, -1, -1):
        b, row, column = bases[axis], flat[:, axis : axis + 1], far[:, axis : axis + 1]
        by_level = [_level_mates(row, column, b**a, b)[:, 0] for a in range(most)]
        # Append the mean for pairs with equal coordinates, which remain equal after scrambling
        by_level.append(_same(row, column, b ** _scrambled_digits(b))[:, 0])
        total = np.einsum("...af,af->...f", total, np.array(by_level))
    return np.asarray(total.reshape(m.shape[:-1]))


def _scrambled_digits(base: int) -> int:
    return math.floor(_SCRAMBLED_BITS / math.log2(base))


def _levels(x: Array, base: int) -> int:
    """Return the least number of digits that distinguishes all coordinates.

    If more digits are needed than are scrambled, return the number of scrambled digits.
    """
    most = _scrambled_digits(base)
    different = len(np.unique(x))
    for level in range(most):
        if len(np.unique(np.floor(x * base**level + 1e-9))) == different:
            return level
    return most


def _place_pairs(net: Fixed, bases: Sequence[int], shifted: bool, m: Array, other: Array) -> Array:
    """Return the part of C_ml from pairs of different points, if digits are changed at random.

    If `shifted` is true, a random digit is added to the k-th digit of all points, for each k.
    The joint law of two changed digits then depends only on the difference of the digits.
    If `shifted` is false, a random permutation is applied to the k-th digits.
    The joint law of two changed digits then depends only on whether the digits are equal.
    The changes of digits at different places k are independent, so the means are multiplied.
    All digits after the last changed digit are replaced by one uniform number per coordinate.
    If the digits form a group, the pairs with one given point represent all pairs.
    """
    n, dims, points = net.n, net.dims, net.points
    flat, far = (np.broadcast_to(a, m.shape).reshape(-1, dims) for a in (m, other))
    places = [_scrambled_digits(b) for b in bases]
    rows = 1 if net.digital else n
    if float(rows * n) * len(flat) * sum(places) > _MOST_PAIR_TERMS:
        raise NoClosedForm(
            f"The covariances of {n} points with changed digits at {len(flat)} pairs of "
            f"frequencies take more than {_MOST_PAIR_TERMS:.2g} terms; use ",
            Function("power_spectrum"),
            ", or ask for fewer.",
        )
    # At each digit place of an axis, the mean depends on the difference of two digits modulo b.
    # For each place, store an array (b, frequencies) of the means for the b possible differences
    factors = list[list[Array]]()
    for axis, b in enumerate(bases):
        digit, own = np.arange(b), list[Array]()
        for place in range(1, places[axis] + 1):
            left, right = (
                np.exp(-2j * np.pi * np.remainder(np.outer(digit, f[:, axis] / b**place), 1.0))
                for f in (flat, far)
            )
            right = np.conj(right)
            by_difference = np.stack(
                [(left * np.roll(right, -step, axis=0)).mean(axis=0) for step in digit]
            )
            if not shifted:
                by_difference[1:] = by_difference[1:].mean(axis=0)
            own.append(by_difference)
        own[-1] = own[-1] * _interval((flat[:, axis] - far[:, axis]) / float(b) ** places[axis])
        factors.append(own)

    total = np.zeros(len(flat), complex)
    # Find the digits of the coordinates on each axis, with the highest digit first.
    # Rounding may have moved a coordinate from a multiple of b^-places to just below it.
    # To correct this, the small number `nudge` is added to all coordinates before reading digits.
    digits = []
    for axis, b in enumerate(bases):
        nudge = 0.0 if b & (b - 1) == 0 else 2.0**-52
        scale = float(b) ** places[axis]
        whole = np.minimum((points[:, axis] + nudge) * scale, scale - 1.0).astype(np.int64)
        powers = b ** np.arange(places[axis] - 1, -1, -1, dtype=np.int64)
        digits.append(whole[:, None] // powers % b)
    block = max(1, _TERMS_AT_ONCE // max(1, len(flat)))
    for i in range(rows):
        others = np.delete(np.arange(n), i)
        for start in range(0, n - 1, block):
            there = others[start : start + block]
            each = np.ones((len(there), len(flat)), complex)
            for axis, b in enumerate(bases):
                differences = (digits[axis][there] - digits[axis][i]) % b
                for place, factor in enumerate(factors[axis]):
                    each *= factor[differences[:, place]]
            total += each.sum(axis=0)
    return np.asarray(total.reshape(m.shape[:-1]) / (n * rows))


def _moved(moments: SpectralMoments, by: Array) -> SpectralMoments:
    """Return moments at integer frequencies after a fixed translation, which adds phases."""

    def phase(nu: Array) -> Array:
        return np.asarray(np.exp(-2j * np.pi * np.remainder((nu * by).sum(axis=-1), 1.0)))

    return SpectralMoments(
        lambda nu: moments.mean(nu) * phase(nu),
        lambda m, other: moments.covariance(m, other) * phase(m - other),
        integer=True,
    )


def _interval(nu: Array) -> Array:
    """Return χ(ν) for each coordinate: the transform of the unit interval."""
    return np.asarray(np.sinc(nu) * np.exp(-1j * np.pi * np.remainder(nu, 2.0)))


def _comb(nu: Array, sides: Any) -> Array:
    """Return A_s(ν) for each coordinate: the transform of the grid {j/s}, which has period s."""
    s = np.asarray(sides, float)
    # Subtract the nearest multiple of s from ν: then |rest| ≤ s/2, and the divisor is never 0
    rest = nu - s * np.rint(nu / s)
    return np.asarray(_interval(rest) / _interval(rest / s))


def _product(values: Array) -> Array:
    """Return the product over the last array axis, which has one value per coordinate."""
    return np.asarray(np.prod(values, axis=-1))


def _is_zero(m: Array) -> Array:
    return np.asarray(np.all(m == 0, axis=-1).astype(float))


# ---- Covariances of importance-sampled points


def _weighted_covariance(law: Law, name: str, m: Array, other: Array, density: Density) -> Array:
    """Return C_ml of importance-sampled points at integers m and l of the same shape (..., d)."""
    zero = np.all(m == 0, axis=-1) & np.all(other == 0, axis=-1)

    # Find out whether the points are shifted, at random or by a fixed offset.
    # If the points are shifted, find the law of the points before the shift
    n, offset, shifted = law.n, np.zeros(density.dims), False
    while isinstance(law, Shifted | Moved):
        if isinstance(law, Moved):
            offset = offset + np.array(law.by)
        shifted |= isinstance(law, Shifted)
        law = law.inner

    if isinstance(law, Fixed) and law.sides is not None:
        if not shifted:
            raise NoClosedForm(
                f"{name} is the same every time, so its points do not vary; add shift, or use ",
                Function("power_spectrum"),
                ".",
            )
        highest, power = _highest(m, other), np.ones(m.shape[:-1])
        for i, (p, s) in enumerate(zip(_factors(density), law.sides, strict=True)):
            axis = _StrataAxis(p, s, *_all_offsets(p, s, 1.0 / s, highest))
            power = power * axis.mean_product(axis.of_grid, m[..., i], other[..., i])
        return np.asarray(power - zero)
    reciprocal = _reciprocal(density, m - other)
    if isinstance(law, Independent):
        return np.asarray((reciprocal - zero) / n)
    latin = isinstance(law, PairedAxes) and law.latin
    if isinstance(law, PairedAxes) and latin:
        sides = law.strata
    elif isinstance(law, Strata) and law.jittered:
        sides = law.sides
    else:
        raise NoClosedForm(
            f"No covariances are known for {name} with the density {density.spec}; give random, "
            "jittered, latin-hypercube, or a grid with shift, or use ",
            Function("variance_terms"),
            ".",
        )
    # On each axis, average over all strata; if points are shifted, average over all shifts too
    highest, pairs = _highest(m, other), np.ones(m.shape[:-1])
    for i, (p, s) in enumerate(zip(_factors(density), sides, strict=True)):
        rule = np.remainder(np.arange(s) / s + offset[i], 1.0), np.full(s, 1.0 / s)
        axis = _StrataAxis(p, s, *(_all_offsets(p, s, 1.0, highest) if shifted else rule))
        same = axis.mean_product(axis.of_stratum, m[..., i], other[..., i])
        if latin:  # two points of a Latin hypercube never share a stratum
            free = (m[..., i] == 0) & (other[..., i] == 0)
            same = (n * free - same) / max(n - 1, 1)
        pairs = pairs * same
    if latin:
        return np.asarray(reciprocal / n + (1.0 - 1.0 / n) * pairs - zero)
    return np.asarray((reciprocal - pairs) / n)


@final
@dataclass(frozen=True)
class _StrataAxis:
    """Positions t at which importance-sampled strata or grids start on one axis, with weights.

    A start t is the lower end of a stratum, or the offset of a grid.
    Means over the starts of strata or grids are weighted; each start t has one weight.
    """

    density: Density
    sides: int
    starts: Array
    weights: Array

    def mean_product(self, of: Callable[[Array], Array], m: Array, other: Array) -> Array:
        """Average `of(m)` · conj `of(other)` with weights over all starts of strata or grids."""
        known, back = np.unique(np.stack([m, other]), return_inverse=True)
        row, column = back.reshape(2, -1)
        if float(self.starts.size) * max(row.size, known.size * self.sides) > _MAX_STRATA_WORK:
            raise NoClosedForm(
                f"The covariances of {row.size} pairs of frequencies over {self.sides} strata of "
                f"{self.density.spec} take more than {_MAX_STRATA_WORK:.2g} terms; ask for fewer."
            )
        values = of(known)
        out = np.empty(row.size, complex)
        block = max(1, _BLOCK // self.starts.size)
        for i in range(0, row.size, block):
            left, right = values[row[i : i + block]], values[column[i : i + block]]
            out[i : i + block] = np.einsum("ij,ij,j->i", left, np.conj(right), self.weights)
        return out.reshape(m.shape)

    def of_stratum(self, m: Array) -> Array:
        """Return the transform M_t(m) of the stratum at each start t: (frequencies, starts).

        The axis is periodic: a stratum that extends beyond 1 continues at 0.
        """
        end = self.starts + 1.0 / self.sides
        over = np.maximum(end - 1.0, 0.0)
        first = _strips(m, self._warp(self.starts), self._warp(np.minimum(end, 1.0)))
        return np.asarray(self.sides * (first + _strips(m, np.zeros(1), self._warp(over))))

    def of_grid(self, m: Array) -> Array:
        """Return S_m of the grid with offset t for each start t: (frequencies, starts)."""
        total = np.zeros((m.size, self.starts.size), complex)
        for j in range(self.sides):
            x = self._warp(self.starts + j / self.sides)
            total += np.exp(-2j * np.pi * np.outer(m, x)) / self.density.pdf(x[:, None])
        return total / self.sides

    def _warp(self, u: Array) -> Array:
        """Return T(u), with T(1) = 1. Numbers u that rounding moved outside [0,1) are clipped."""
        x = self.density.sample(np.clip(u, 0.0, 1.0)[:, None])[:, 0]
        return np.where(u <= 0.0, 0.0, np.where(u >= 1.0, 1.0, x))


def _strips(m: Array, low: Array, high: Array) -> Array:
    """Return ∫ exp(−2πi m x) dx from low to high: (frequencies, intervals)."""
    width, middle = high - low, 0.5 * (low + high)
    return np.asarray(
        width * np.sinc(np.outer(m, width)) * np.exp(-2j * np.pi * np.outer(m, middle))
    )


def _all_offsets(density: Density, sides: int, length: float, highest: int) -> tuple[Array, Array]:
    """Return a quadrature rule over the start t of the strata, in [0, length).

    The range of t is split where a stratum starts or ends at 0 or at a break of the density.
    """
    breaks = np.array([0.0, *density.breaks[0]])
    ends = np.concatenate([breaks, breaks - 1.0 / sides]) % 1.0 % length
    cells = max(_CELLS, 2 * highest)
    rule = AxisRule.make(_ORDER * cells, _ORDER, tuple(np.unique(ends / length).tolist()))
    return rule.nodes * length, rule.weights


def _highest(m: Array, other: Array) -> int:
    highest = max(float(np.abs(m).max(initial=0)), float(np.abs(other).max(initial=0)))
    if highest > _HIGHEST:
        raise NoClosedForm(
            f"Frequencies up to {highest:.3g} take too fine a quadrature; give {_HIGHEST} at most."
        )
    return int(highest)


def _factors(density: Density) -> list[Density]:
    """Return the density of each axis.

    Raise an error if the density is no product over the axes, or if a warp is not monotone.
    """
    if density.dims == 1:
        factors = [density]
    elif isinstance(density, Linear):
        slopes = np.broadcast_to(density.slope, density.dims)
        factors = [Linear(dims=1, slope=float(slope)) for slope in slopes]
    elif isinstance(density, TruncatedNormal):
        both = (np.broadcast_to(each, density.dims) for each in (density.mean, density.sigma))
        factors = [
            TruncatedNormal(dims=1, mean=float(mean), sigma=float(sigma))
            for mean, sigma in zip(*both, strict=True)
        ]
    else:
        factors = list(getattr(density, "parts", ())) if density.name == "product" else []
    # Check at probe points that the warps are monotone
    u = (np.arange(_PROBES) / _PROBES)[:, None]
    monotone = all(
        p.dims == 1
        and getattr(p, "primary_dims", 1) == 1
        and (np.diff(p.sample(u)[:, 0]) >= 0).all()
        for p in factors
    )
    if not factors or not monotone:
        raise NoClosedForm(
            f"Covariances of stratified points are known for densities that are products over the "
            f"axes, of increasing warps, not for {density.spec}; use ",
            Function("variance_terms"),
            ".",
        )
    return factors


def _reciprocal(density: Density, k: Array) -> Array:
    """Return the Fourier coefficients of 1/p at integers k (..., d)."""
    try:
        factors = _factors(density)
    except NoClosedForm:
        whole = Integrand.from_function(
            lambda x: 1.0 / density.pdf(x),
            dims=density.dims,
            integral=density.reciprocal_integral(),
        )
        return whole.fourier(k)
    found = np.ones(k.shape[:-1], complex)
    for i, p in enumerate(factors):
        known, back = np.unique(k[..., i], return_inverse=True)
        count = 1 << (max(2**14, _ORDER * _highest(known, known)) - 1).bit_length()
        jumps = p.sample(np.array(p.breaks[0], float)[:, None])[:, 0]
        rule = AxisRule.make(count, _ORDER, tuple(jumps.tolist()))
        values = rule.transform(1.0 / p.pdf(rule.nodes[:, None]), known)
        found *= values[back].reshape(k.shape[:-1])
    return found
