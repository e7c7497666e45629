"""Variances predicted in many dims: parts of g by subsets of the axes, and one law for all pairs of points.

Method
------
With g = Σ_v g_v, the ANOVA of g [Owen1997]_, the variance of the mean of g over a set that is
randomised the same way along every axis is (1/n²) Σ over pairs (a, b) of points of

    Σ_i s_i k_i(a_i, b_i)  +  c Σ_{|v| ≥ 2} Π_{i∈v} t_i κ_i(a_i, b_i),

where k_i and κ_i are correlations of the two values that the randomisation leaves on axis i. For nested
scrambling they depend on how many digits of a_i and b_i agree, for a digital shift on their digits'
difference, for a shift on their difference on the torus. The first sum, of single axes, is exact.
In the second, energies σ²_v = c Π t_i take the place of those of all subsets of two and more axes: for
products of functions of one axis they are right. Others have the same total energy, and the same energy
of all subsets with axis i.

From g alone, at points of our own: profiles g(·, z) along each axis for many z. Their mean is g_i; the
spread about it is what the axis does together with others, and the digits' or Fourier energies of it
are κ_i. ∫g² is a mean over scrambled nets with Student's t.

Strata of a grid need no model: with x and x' in the same stratum, Var = E (g(x) − g(x'))² / 2n.
Latin hypercubes have one law for all pairs: different ones of n strata on each axis [Stein1987]_.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import NoClosedForm
from mcspectra.core.jit import kernel
from mcspectra.core.streams import Stream
from mcspectra.integrands import Integrand
from mcspectra.samplers import Jittered, LatinHypercube, Random, Randomized, Sampler, as_sampler
from mcspectra.samplers.base import Structure
from mcspectra.spectra.bases import hadamard, parts_of
from mcspectra.variance.prediction.known import Known, Predicted

__all__ = ["of_subsets"]

_LEAST_DIMS = 2
_OWN = Stream.from_rng(0x5B5E75)  # of our own points, which no sampler shares
_REPLICATES, _REPLICATE = 16, 1 << 13  # scrambled nets for ∫g², and their points
_MIXED = 1 << 13  # mixed differences of each group
_STRATA = 1 << 13  # pairs within strata, of each replicate
_PROFILE_WORK = 1 << 19  # evaluations along all axes together
_NODES = 64  # along an axis
_GROUPS = 4  # of profiles, independent of each other: their spread is the error
_SHAPES = 1 << 23  # numbers of all axes that correlations are measured on
_STANDS_OUT, _HALVINGS = 4.0, 40  # a jump: a change so many times those beside it
_CELLS = 1 << 12  # along an axis, for correlations
_FINE = 1 << 16  # and for single axes
_TORUS = 1 << 15  # differences on the torus
_MOST_WORK = 2.0**34  # pairs of points times axes times groups
_DRAWS = 8  # of a set that is random before its shift or scramble
_KEEP_LAW = frozenset({"owen", "digital-shift", "permute"})  # of nested scrambling
_DIGITS = 1 << 13  # cells of an axis that digits tell apart, or more where there are more points
_SWEEPS, _SCALES, _LARGEST = 60, 28.0, 1e6  # of the fit of products
_MODEL = 0.1
_SCALE = 4  # 2^-k at most, that mixed differences are measured at


def of_subsets(sampler: Sampler, n: int, known: Known, stream: Stream) -> Predicted:
    """Predict the variance from parts by subsets of the axes and the law of pairs of points.

    Parameters
    ----------
    sampler, n
        random, jittered, latin-hypercube; any set with shift; nets and sequences with owen, and those
        in base 2 with digital-shift.
    known
        The integrand, two dims or more; about 2^20 evaluations, once for all counts and samplers.
    stream
        Of draws of sets that are random before their shift or scramble.

    Returns
    -------
    Predicted
        `share` is that of single axes and of pairs within strata; what several axes do together,
        by the law of products, is `tail`.

    Raises
    ------
    NoClosedForm
        One dim, or a sampler whose pairs of points have no law that is known here.
    """
    g = known.g
    if g.dims < _LEAST_DIMS:
        raise NoClosedForm("Subsets of axes need two dims; use exact_variance or convergence.")
    source = sampler.as_chain(n)
    base, steps = parts_of(source)
    names = {step.name for step in steps}
    if isinstance(base, Jittered) and not steps:
        return known.once(f"subsets: strata {n}", lambda: _of_strata(base, n, g))
    parts = known.once("subsets: parts", lambda: _all_parts(g))
    if isinstance(base, Random) and names <= _KEEP_LAW | {"shift", "shuffle", "lms"}:
        variance, half = np.array([[p.variance, p.half] for p in parts]).T / n
        return Predicted(variance, half, np.ones(len(parts)), np.zeros(len(parts)), "energy of g")
    law, codes, rows = _law_of(source, n, stream)
    if float(len(rows)) * codes[..., 0].size * (1 + _GROUPS) > _MOST_WORK:
        raise NoClosedForm(
            f"The pairs of {n} points of {source.spec} in {g.dims} dims are too many; use convergence."
        )
    found = []
    for c, p in enumerate(parts):
        first, rest = known.once(f"subsets: {c} {law}", functools.partial(_tables, law, p))
        scale, t = p.products
        weighted = rest * t.T[:, None]
        mode = ("digits", "xor", "torus").index(law.kind)
        sums = [pair_sums(x, rows, mode, law.bases[0], first, weighted) for x in codes]
        by_set = np.array(sums).mean(axis=1) / n  # (sets, 2, 1 + groups)
        ones, more = by_set[:, 0].mean(axis=0), by_set[:, 1].mean(axis=0) * scale
        # Several axes: their energy is known; of nets their share in fine differences, too
        if law.latin:
            whole, most = np.sum(first[:, -1, 0]), p.joint[0].sum()
            energy = np.clip(p.variance - whole, most / g.dims, 0.5 * most)
            more = np.full(more.shape, energy * (1.0 + 1.0 / max(n - 1.0, 1.0)) / n)
            model = min(p.half, energy) / n
        else:
            spread = 0.0 if law.kind == "torus" else p.fine_pairs(n)
            model = float(np.hypot(_MODEL, spread)) * more[0]
        value = ones[0] + more[0]
        drawn = _half(by_set[:, 0, 0] + scale[0] * by_set[:, 1, 0]) if len(codes) > 1 else 0.0
        error = float(np.sqrt(_half((ones + more)[1:]) ** 2 + model**2 + drawn**2))
        found.append((value, error, ones[0] / value, more[0]))
    return Predicted(*np.array(found).T, "subsets of axes")


@final
@dataclass(frozen=True)
class _Parts:
    """Energies and profiles of one channel of g."""

    variance: float
    half: float  # of its 95 % interval
    knots: list[Array]  # of each axis: ends of its smooth pieces
    nodes: list[Array]  # of each axis
    profiles: list[Array]  # of each axis, (groups, profiles, nodes)
    joint: Array  # energy of axis i with others, of all groups and of each: (1 + groups, d)
    pairs: Array  # and Σ_v |v| (|v| − 1)/2 σ²_v: (1 + groups,)
    fine: Array  # mixed differences within 2^-k and 2^-l, by what products would have: (k, l)

    def fine_pairs(self, n: int) -> float:
        """How far energies of n cells of two axes are from those of products, relatively."""
        levels = np.arange(max(1, n.bit_length() - 1))
        found = self.fine[tuple(np.minimum(k, _SCALE) for k in (levels, levels[::-1]))]
        return float(np.sqrt(((found - 1.0) ** 2).mean()))

    def main(self, axis: int, count: int) -> Array:
        """g_i at the centres of equal cells, of all groups and of each: (1 + groups, count)."""
        own = self.profiles[axis].mean(axis=1)
        return self._along(axis, np.concatenate([own.mean(axis=0)[None], own]), count)

    def rest(self, axis: int, count: int) -> Array:
        """What some of the profiles have beside g_i: (groups, profiles, count)."""
        given = self.profiles[axis]
        step = max(1, len(self.profiles) * _GROUPS * given.shape[1] * count // _SHAPES)
        return self._along(axis, (given - given.mean(axis=1, keepdims=True))[:, ::step], count)

    @functools.cached_property
    def products(self) -> tuple[Array, Array]:
        """c and t of the energies c Π t_i of the subsets v of two and more axes: (1 + groups[, d])."""
        each = [_product_law(u, e) for u, e in zip(self.joint, self.pairs, strict=True)]
        return np.array([c for c, _ in each]), np.stack([t for _, t in each])

    def _along(self, axis: int, values: Array, count: int) -> Array:
        """Values (…, nodes) at the centres of equal cells, interpolated piece by piece."""
        from scipy.interpolate import PchipInterpolator

        x = (np.arange(count) + 0.5) / count
        out = np.empty((*values.shape[:-1], count))
        nodes, ends = self.nodes[axis], self.knots[axis]
        for low, high in itertools.pairwise(ends):
            own, there = (nodes > low) & (nodes < high), (x >= low) & (x <= high)
            if own.sum() > 1:
                out[..., there] = PchipInterpolator(nodes[own], values[..., own], -1)(x[there])
            elif there.any():
                nearest = int(np.abs(nodes - 0.5 * (low + high)).argmin())
                out[..., there] = values[..., nearest, None]
        return out - out.mean(axis=-1, keepdims=True)


@final
@dataclass(frozen=True)
class _Law:
    """What the covariance of the values at two points depends on, along each axis.

    digits: in how many first digits in `bases` the coordinates agree, `levels` at most. xor and torus:
    the difference of two multiples of 1/bases, digit by digit or on the torus.
    """

    kind: str
    bases: tuple[int, ...]
    levels: tuple[int, ...]
    latin: bool = False  # all points differ in the first digit

    def table(self, axis: int, parts: _Parts) -> tuple[Array, Array]:
        """Covariances of g_i (1 + groups, differences), and of the rest of profiles (groups, …)."""
        base = self.bases[axis]
        if self.kind != "digits":
            covariance = _by_xor if self.kind == "xor" else _on_torus
            k = max(4, _FINE // base)
            main = covariance(parts.main(axis, base * k))[..., ::k]
            k = 1 if base == _TORUS else max(4, _CELLS // base)
            rest = parts.rest(axis, _CELLS if base == _TORUS else base * k)
            tables = np.stack([covariance(x).mean(axis=0)[::k] for x in rest])
            if base == _TORUS:
                x, known = np.arange(base) / base, np.arange(_CELLS + 1) / _CELLS
                tables = np.stack([np.interp(x, known, np.append(t, t[0])) for t in tables])
            return main, tables
        levels = self.levels[axis]
        fewer = min(levels, max(1, math.floor(math.log(_CELLS, base) + 1e-9)))
        cells, coarse = base**levels, base**fewer
        fine = _FINE if len(parts.knots[axis]) == 2 else 4 * _FINE  # a jump is where it is
        fine, medium = max(1, fine // cells), max(1, _CELLS // coarse)
        rest = _by_digits(parts.rest(axis, coarse * medium), base, fewer).mean(axis=1)
        return _by_digits(parts.main(axis, cells * fine), base, levels), rest


def _by_digits(values: Array, base: int, levels: int) -> Array:
    """Covariance under nested scrambling by how many digits agree: (…, levels + 2), the last none differ."""
    means = values.reshape(*values.shape[:-1], base**levels, -1).mean(axis=-1)
    energy = [(values**2).mean(axis=-1)]
    while means.shape[-1] > 1:
        energy.append((means**2).mean(axis=-1))
        means = means.reshape(*means.shape[:-1], -1, base).mean(axis=-1)
    within = np.stack([np.zeros(means.shape[:-1]), *reversed(energy)], axis=-1)
    apart = within[..., :-1] - np.diff(within, axis=-1) / (base - 1)
    return np.concatenate([apart, within[..., -1:]], axis=-1)


def _by_xor(values: Array) -> Array:
    """Covariance under a digital shift in base 2 by the difference of the digits: (…, cells)."""
    return np.asarray(hadamard((hadamard(values) / values.shape[-1]) ** 2))


def _on_torus(values: Array) -> Array:
    """Covariance under a shift by the difference on the torus: (…, cells)."""
    cells = values.shape[-1]
    return np.fft.irfft(np.abs(np.fft.rfft(values)) ** 2, cells) / cells


@kernel
def pair_sums(codes: Array, rows: Array, mode: int, cells: int, first: Array, rest: Array) -> Array:
    """Sums over all points b of covariances with the points a listed as rows: (rows, 2, variants).

    codes (n, d, digits), rows (rows,), first and rest (d, differences, variants): Σ_i first_i, and
    Σ_{|v| ≥ 2} Π_{i∈v} rest_i. mode 0: digits that agree; 1: bits that differ; 2: the torus of `cells`.
    """
    out = np.zeros((rows.size, 2, first.shape[2]))
    one, more, total = np.zeros(first.shape[2]), np.zeros(first.shape[2]), np.zeros(first.shape[2])
    for r in range(rows.size):
        a = codes[rows[r]]
        for k in range(codes.shape[0]):
            b = codes[k]
            one[:], more[:], total[:] = 0.0, 0.0, 0.0
            for i in range(codes.shape[1]):
                if mode == 0:
                    place = 0
                    while place < codes.shape[2] and a[i, place] == b[i, place]:
                        place += 1
                    if place == codes.shape[2]:
                        place = first.shape[1] - 1
                elif mode == 1:
                    place = a[i, 0] ^ b[i, 0]
                else:
                    place = a[i, 0] - b[i, 0]
                    if place < 0:
                        place += cells
                for v in range(one.size):
                    x = rest[i, place, v]
                    more[v] += x * (more[v] + total[v])
                    total[v] += x
                    one[v] += first[i, place, v]
            for v in range(one.size):
                out[r, 0, v] += one[v]
                out[r, 1, v] += more[v]
    return out


def _of_strata(base: Jittered, n: int, g: Integrand) -> Predicted:
    """Half the mean square of differences within strata, by scrambled nets of pairs."""
    sides = np.array(base.sides(n), float)
    u = _net(2 * g.dims, _STRATA, _REPLICATES, 1)
    x, other = u[..., : g.dims], u[..., g.dims :]
    within = (np.floor(x * sides) + other) / sides
    change = _values(g, x) - _values(g, np.minimum(within, np.nextafter(1.0, 0.0)))
    spread = 0.5 * (change**2).mean(axis=1) / n
    error = _half(spread)
    return Predicted(
        spread.mean(axis=0), error, np.ones(len(error)), 0.0 * error, "pairs in strata"
    )


def _all_parts(g: Integrand) -> list[_Parts]:
    """Energies, and profiles along all axes through the same points, of each channel."""
    d = g.dims
    x = _net(d, _REPLICATE, _REPLICATES, 0)
    values = _values(g, x)
    mean = values.mean(axis=(0, 1))
    squares = ((values - mean) ** 2).mean(axis=1)
    count = max(4, 1 << round(math.log2(_PROFILE_WORK / (_GROUPS * _NODES * d))))
    through = _net(d, count, _GROUPS, 2)

    def profiles(axis: int, at: Array, through: Array = through) -> Array:
        """(groups, profiles, nodes, channels)"""
        points = np.repeat(through[:, :, None], len(at), axis=2)
        points[..., axis] = at
        return _values(g, points)

    knots, nodes, found = [], [], []
    for axis in range(d):
        ends = np.unique([0.0, 1.0, *(b for b in g.breaks[axis] if 0.0 < b < 1.0)])
        pieces = np.maximum(4, np.ceil(_NODES * np.diff(ends))).astype(int)
        at = np.concatenate(
            [
                low + (np.arange(k) + 0.5) / k * (high - low)
                for low, high, k in zip(ends[:-1], ends[1:], pieces, strict=True)
            ]
        )
        along = profiles(axis, at)
        # Bisect jumps of the mean that nothing declares: changes that stand out between two nodes
        change = np.abs(np.diff(along.mean(axis=(0, 1)), axis=0)).max(axis=-1)
        beside = np.maximum(np.append(change[1:], 0.0), np.append(0.0, change[:-1]))
        jumps = []
        for k in np.flatnonzero((change > _STANDS_OUT * beside) & (change > 1e-9 * change.sum())):
            low, high = at[k], at[k + 1]
            if any(low < b < high for b in ends):
                continue
            few = through[:, :: max(1, count // 16)]
            left, right = (profiles(axis, np.array([e]), few).mean((0, 1, 2)) for e in (low, high))
            channel = int(np.abs(right - left).argmax())
            for _ in range(_HALVINGS):
                middle = 0.5 * (low + high)
                value = profiles(axis, np.array([middle]), few).mean((0, 1, 2))
                nearer = abs(value - left)[channel] < abs(value - right)[channel]
                low, high = (middle, high) if nearer else (low, middle)
            jumps.append(0.5 * (low + high))
        knots.append(np.unique([*ends, *jumps]))
        nodes.append(at)
        found.append(along)
    # Energy of each axis with others: of what profiles have beside their mean
    joint = np.empty((1 + _GROUPS, d, values.shape[-1]))
    within = np.ones((d, _SCALE + 1, values.shape[-1]))
    for axis, (given, at) in enumerate(zip(found, nodes, strict=True)):
        cuts = np.concatenate([[0.0], 0.5 * (at[1:] + at[:-1]), [1.0]])
        for b in knots[axis][1:-1]:  # a node stands for its own side of a break
            cuts[np.searchsorted(at, b)] = b
        weight = np.diff(cuts)[:, None]
        rest = given - given.mean(axis=1, keepdims=True)
        rest = rest - (rest * weight).sum(axis=2, keepdims=True)
        joint[1:, axis] = (rest**2 * weight).sum(axis=(1, 2)) / (given.shape[1] - 1)
        # Part of it that is within cells of 2^-k
        for k in range(1, _SCALE + 1):
            cell = np.floor(at * 2.0**k)[:, None] == np.arange(2**k)
            share = cell * weight / np.maximum((cell * weight).sum(axis=0), 1e-300)
            means = np.einsum("gjnc,nk->gjkc", rest, share)
            coarse = (means**2 * (cell * weight).sum(axis=0)[:, None]).sum(axis=(0, 1, 2))
            fully = (rest**2 * weight).sum(axis=(0, 1, 2))
            within[axis, k] = 1.0 - np.divide(
                coarse, fully, out=np.zeros(len(fully)), where=fully > 0.0
            )
    joint[0] = joint[1:].mean(axis=0)
    pairs, fine = _of_pairs(g, joint[0], within)
    return [
        _Parts(
            float(squares[:, c].mean()),
            float(_half(squares)[c]),
            knots,
            nodes,
            [along[..., c] for along in found],
            joint[..., c],
            pairs[:, c],
            fine[..., c],
        )
        for c in range(values.shape[-1])
    ]


def _of_pairs(g: Integrand, joint: Array, within: Array) -> tuple[Array, Array]:
    """Σ_v |v| (|v| − 1)/2 σ²_v from mixed differences of pairs of axes, and how they shrink.

    (1 + groups, channels), and (k, l, channels): the energy of differences within 2^-k and 2^-l along
    two axes, by that of products of curves of which a part `within` (d, k, channels) is finer.
    """
    d, few = g.dims, _SCALE + 1
    relative = np.divide(joint, joint.sum(axis=0), out=np.zeros(joint.shape), where=joint > 0.0)
    chance = np.triu(np.outer(relative.max(axis=1), relative.max(axis=1)), 1).ravel()
    fine = np.ones((few, few, joint.shape[1]))
    if not chance.any():
        return np.zeros((1 + _GROUPS, joint.shape[1])), fine
    cumulative = np.cumsum(chance / chance.sum())

    def energy(k: int, l: int, count: int, label: int) -> Array:
        """Of each group, by the part that is as fine: (groups, channels)."""
        u = _net(2 * d + 2, count, _GROUPS, label)
        x, other = u[..., :d], u[..., d : 2 * d]
        pair = np.minimum(np.searchsorted(cumulative, u[..., -1]), np.flatnonzero(chance)[-1])
        i, j = np.where(u[..., -2] < 0.5, np.divmod(pair, d), np.divmod(pair, d)[::-1])
        first, second = (np.arange(d) == axis[..., None] for axis in (i, j))
        scale = np.where(first, 2.0**k, np.where(second, 2.0**l, 1.0))
        other = np.minimum((np.floor(x * scale) + other) / scale, np.nextafter(1.0, 0.0))
        change = _values(g, x) - _values(g, np.where(first, other, x))
        change = change - _values(g, np.where(second, other, x))
        change = change + _values(g, np.where(first | second, other, x))
        part = within[i, k] * within[j, l] * (chance[pair] / chance.sum())[..., None]
        squares = np.divide(0.25 * change**2, part, out=np.zeros(part.shape), where=part > 0.0)
        return np.asarray(squares.mean(axis=1))

    found = energy(0, 0, _MIXED, 3)
    for k, l in itertools.combinations_with_replacement(range(few), 2):
        if l > 0:
            ratio = energy(k, l, _MIXED // 8, 4 + few * k + l).mean(axis=0)
            ratio = np.divide(
                ratio, found.mean(axis=0), out=np.ones(ratio.shape), where=ratio > 0.0
            )
            fine[k, l] = fine[l, k] = ratio
    return np.concatenate([found.mean(axis=0)[None], found]), fine


def _law_of(source: Sampler, n: int, stream: Stream) -> tuple[_Law, Array, Array]:
    """The law of pairs of a sampler; codes of its points (sets, n, d, digits), and rows that show all."""
    base, steps = parts_of(source)
    names, d = {step.name for step in steps}, source.dims
    every, one = np.arange(n), np.arange(1)
    if isinstance(base, LatinHypercube) and base.strength == 1 and names <= {"shuffle"}:
        codes = np.arange(n)[None, :, None, None].repeat(d, axis=2)
        return _Law("digits", (n,) * d, (1,) * d, latin=True), codes, one
    last = steps[-1].name if steps else ""
    points = base
    net = base.fixed and n & (n - 1) == 0 and base.structure is Structure.DIGITS
    if last == "shift":
        points = Randomized(base=base, steps=steps[:-1]) if steps[:-1] else base
    elif (
        not names or not names <= _KEEP_LAW or not ("owen" in names or set(base.digit_bases) == {2})
    ):
        raise NoClosedForm(
            f"No law of pairs of points is known for {source.spec} in {d} dims; use convergence."
        )
    x = points.draw_stream(n, stream, 0, 1 if points.fixed else _DRAWS)
    if last == "shift":
        lattice = np.abs(x * n - np.rint(x * n)).max() < 1e-6
        cells = n if lattice else _TORUS
        codes = np.rint(x * cells).astype(np.int64)[..., None] % cells
        return (
            _Law("torus", (cells,) * d, (1,) * d),
            codes,
            one if lattice and _is_group(x[0], n) else every,
        )
    if "owen" not in names:
        cells = 1 << (n - 1).bit_length()
        codes = np.floor(x * cells).astype(np.int64)[..., None]
        return _Law("xor", (cells,) * d, (1,) * d), codes, one if net else every
    bases = base.digit_bases
    levels = tuple(math.ceil(math.log(max(n, _DIGITS), b) - 1e-9) for b in bases)
    codes = np.zeros((*x.shape, max(levels)), np.int64)
    for axis, (b, most) in enumerate(zip(bases, levels, strict=True)):
        # Coordinates rounded down to below a digit count as that digit
        whole = np.floor(x[..., axis] * b**most + (0.0 if b & (b - 1) == 0 else 1e-9))
        for level in range(most):
            codes[..., axis, level] = whole // b ** (most - 1 - level) % b
    return _Law("digits", bases, levels), codes, one if net and set(bases) == {2} else every


def _is_group(x: Array, n: int) -> bool:
    """Whether the differences of a set on the torus are the set again: multiples of one point."""
    whole = np.rint(x * n).astype(np.int64) % n
    return bool(
        (np.arange(n)[:, None] * (whole[1 % n] - whole[0]) % n == (whole - whole[0]) % n).all()
    )


def _tables(law: _Law, parts: _Parts) -> tuple[Array, Array]:
    """Covariances of g_i by the difference of two points, and correlations of the rest.

    Both (d, differences, 1 + groups).
    """
    of_axes = [law.table(axis, parts) for axis in range(len(parts.nodes))]
    width = max(first.shape[-1] for first, _ in of_axes)

    def stacked(tables: list[Array]) -> Array:
        # Where fewer digits are known, more that agree are no difference
        wide = [np.pad(t, ((0, 0), (0, width - t.shape[-1])), "edge") for t in tables]
        return np.ascontiguousarray(np.stack(wide).transpose(0, 2, 1))

    none = -1 if law.kind == "digits" else 0  # index of no difference
    first, rest = (stacked(list(tables)) for tables in zip(*of_axes, strict=True))
    rest = np.concatenate([rest.mean(axis=-1, keepdims=True), rest], axis=-1)
    whole = rest[:, none, None, :]
    return first, np.divide(rest, whole, out=np.zeros(rest.shape), where=whole > 0.0)


def _product_law(joint: Array, pairs: float) -> tuple[float, Array]:
    """c and t (d,) with Σ_{v ∋ i, |v| ≥ 2} c Π t = joint_i, and Σ_v |v| (|v| − 1)/2 c Π t = pairs."""
    whole = float(joint.sum())
    if not whole > 0.0:
        return 0.0, np.zeros(joint.shape)

    def of_scale(log_scale: float) -> tuple[float, float, Array]:
        """Pairs, c and t."""
        scale = whole * math.exp(log_scale)
        t = np.sqrt(joint / scale / len(joint))
        for _ in range(_SWEEPS):
            found = scale * t * np.expm1(np.log1p(t).sum() - np.log1p(t))
            t = t * np.sqrt(np.divide(joint, found, out=np.ones(t.shape), where=found > 0.0))
            t = np.minimum(t, _LARGEST)
        r = t / (1.0 + t)
        many = scale * math.exp(np.log1p(t).sum()) * 0.5 * (r.sum() ** 2 - (r**2).sum())
        return many, scale, t

    low, high = -_SCALES, _SCALES
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if of_scale(middle)[0] > pairs else (low, middle)
    return of_scale(high)[1:]


def _net(dims: int, n: int, replicates: int, label: int) -> Array:
    """Scrambled nets of our own, (replicates, n, dims)."""
    return as_sampler("sobol | owen", dims).draw_stream(n, _OWN.child(label), 0, replicates)


def _values(g: Integrand, x: Array) -> Array:
    """g at points (…, d): (…, channels or 1)."""
    return np.asarray(g(x)).reshape(*x.shape[:-1], -1)


def _half(replicates: Array) -> Array:
    """Half of the 95 % interval of the mean over the first axis, by Student's t."""
    from scipy.special import stdtrit

    count = len(replicates)
    half = stdtrit(count - 1, 0.975) * replicates.std(axis=0, ddof=1) / math.sqrt(count)
    return np.asarray(half)
