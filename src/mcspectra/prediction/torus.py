"""Variances of sets that are statistically the same after any translation of the torus.

C_ml of such sets is diagonal, so that with P(m) = ⟨|S_m|²⟩

    Var = Σ_{m≠0} |g_m|² P(m) = Σ_{m in C} |g_m|² P(m) + (∫g² − I² − Σ_{m in C} |g_m|²) / n + …,

C the frequencies that are counted: a box, strips along the axes, where functions that are not periodic
have their energy, and integer diagonals, where jumps along these have theirs. Beyond, P tends to
1/n. By how much the border of the box departs from that, weighted by |g_m|², is the error of the tail.

P is known in closed form; or from one transform of a set that is shifted at random as a whole; or
it is the mean over sets that are drawn. Of lattices P is 1 on the dual lattice and 0 elsewhere: its
frequencies alone are counted, n times as many as of a box, and what is beyond goes on as the last
shells do; or, where coefficients are not known exactly, the mean over the lattice is a function of the
offset within one of its cells, whose variance a quadrature finds. Of homogeneous sets, whose law has the symmetries of the
cube, |g_m|² is averaged over these, which is the same as to average P.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import NoClosedForm
from mcspectra.core.streams import Stream
from mcspectra.estimators.quadrature import mesh
from mcspectra.integrands import Integrand
from mcspectra.integrands._quadrature import grid_coefficients
from mcspectra.prediction.known import Known, Predicted, half_interval
from mcspectra.samplers import DigitalShift, Lms, Owen, Permute, Randomization
from mcspectra.samplers._primes import is_prime
from mcspectra.samplers.law import Independent, Law, Scrambled, Shifted, Source
from mcspectra.spectra.closed_forms import moments_of

__all__ = [
    "DrawnSettings",
    "DualSettings",
    "MovesSettings",
    "TorusSettings",
    "cost_of_moves",
    "lattice_basis",
    "moves_at_once",
    "moves_resolve",
    "of_moves",
    "of_torus",
]


@final
@dataclass(frozen=True)
class Reach:
    """How far coefficients are counted in some number of dims.

    Attributes
    ----------
    box
        Half width of the box about 0.
    strips
        Ends of strips along the axes, and their half widths up to there: sets that are drawn count the
        first ones alone.
    diagonal
        End of integer diagonals.
    """

    box: int
    strips: tuple[tuple[int, int], ...]
    diagonal: int = 0


@final
@dataclass(frozen=True, kw_only=True)
class TorusSettings:
    """Which coefficients are counted.

    Changes are those of seven cells in 2-D and 3-D at n = 64 and 256: a jump along a line, smooth functions
    and a disk with jittered, latin-hypercube, halton and rank1-lattice under shift, and poisson-disk.

    Attributes
    ----------
    exact, table
        Reach by number of dims, where coefficients are known exactly and where they are those of a table
        of g. Exact ones cost a few operations each; a table has `nodes` along each wave of the box.
    nodes
        Nodes of the finer table for a wave of the highest frequency. Half as many change variances by
        0.4 % where g jumps and multiply the error by 4 to 30; twice as many change them by 0.1 %.
    least_nodes
        Nodes along each axis at least, by number of dims. Half and twice change variances by less than
        0.2 %.
    block
        Frequencies whose power has a closed form that are in memory together. The result does not depend
        on it.
    precision
        Relative error of transforms, far below that of the sums.
    shells
        Shells of the box, each √2 wide, whose power shows how white the tail is: those above an eighth of
        the half width. Half and twice change no variance, and errors by factors of 0.5 to 3.
    vague
        Error of ∫g² in many dims, relative to the variance, above which other methods know more: ∫g² is
        then a mean over 2^20 points, and sums of products find its error by themselves.
    """

    exact: Mapping[int, Reach] = field(
        default_factory=lambda: {
            1: Reach(2**12, ((2**16, 0),)),
            2: Reach(256, ((2**12, 12), (2**16, 2)), 2**14),
            3: Reach(32, ((512, 2), (2**12, 0)), 2**10),
        }
    )
    table: Mapping[int, Reach] = field(
        default_factory=lambda: {
            1: Reach(2**12, ()),
            2: Reach(128, ((2**10, 4),)),
            3: Reach(16, ((128, 1),)),
        }
    )
    nodes: int = 8
    least_nodes: Mapping[int, int] = field(default_factory=lambda: {1: 256, 2: 256, 3: 32})
    block: int = 2**18
    precision: float = 1e-9
    shells: int = 6
    vague: float = 0.01


@final
@dataclass(frozen=True, kw_only=True)
class DrawnSettings:
    """How many sets are drawn where power has no closed form, and how its law is fitted.

    Changes are those of a smooth function in 2-D with poisson-disk at n = 64, whose half interval is 3.1 %.

    Attributes
    ----------
    least_sets, most_sets, points
        Sets that give all frequencies, sets at most, and points of all sets, which limit the work at large
        n. Half and twice as many change the variance by less than 0.8 %.
    slow, slow_points
        Largest `max_count` of samplers that take long, since they optimize their points, and points of all
        their sets. They draw half as many first sets, which are kept for other integrands.
    precision
        Half interval, relative to the variance, up to which more sets are drawn. Half as much is not
        reached by `most_sets`; twice as much changes the variance by 1.9 %.
    low
        Half width of the frequencies that all sets are transformed at: they hold the energy of smooth
        functions. Half and twice change the variance by less than 0.5 %.
    length, least_lengths
        |m| n^(-1/d) up to which power follows a smooth law of the length, and different lengths that such a
        fit takes at least: the first peak of stochastic sets lies at 1. Both are insensitive: half and
        twice change the variance by less than 0.1 %.
    agrees
        Standard errors within which the law and the measured power must agree. Insensitive between 1 and 4.
    steps
        Newton steps of the fit, which have converged. Insensitive between 6 and 24.
    least_box, box
        Half width of the box of a homogeneous set at least, and in units of n^(1/d). Half and twice change
        the variance by less than 0.3 %; half a box triples the error.
    """

    least_sets: int = 16
    most_sets: int = 1024
    points: int = 2**18
    slow: int = 2**16
    slow_points: int = 2**16
    precision: float = 0.015
    low: int = 32
    length: float = 0.35
    least_lengths: int = 10
    agrees: float = 2.0
    steps: int = 12
    least_box: int = 32
    box: float = 6.0


@final
@dataclass(frozen=True, kw_only=True)
class DualSettings:
    """Which frequencies of a dual lattice are counted.

    Changes are those of a disk with rank1-lattice | shift at n = 64, whose half interval is 0.11 %.

    Attributes
    ----------
    frequencies
        Frequencies of the dual lattice in a box. Half and twice change the variance by less than 0.04 %.
    periods, strip
        Ends of strips in units of n, and frequencies of the dual lattice there. Half and twice change the
        variance by less than 0.03 %.
    jump
        Largest energy of an octave relative to that before it: a half where g jumps along curves, less
        elsewhere. Less would cut the tail of jumps; one would give jumps no end.
    whole
        Differences of lattice points from multiples of 1/n, times n, that are rounding: coordinates are
        right to 2^-53. Insensitive between 5e-7 and 2e-6.
    """

    frequencies: int = 2**19
    periods: int = 2**8
    strip: int = 2**18
    jump: float = 0.5
    whole: float = 1e-6


@final
@dataclass(frozen=True, kw_only=True)
class MovesSettings:
    """How many offsets move a set.

    Changes are those of a jump along a line with rank1-lattice | shift, a ball in 4-D with
    kronecker | shift, and a smooth function with sobol | digital-shift.

    Attributes
    ----------
    offsets, least_offsets, evaluations
        Offsets, evaluations of g that limit their number at large n, and offsets below which the method
        refuses, with intervals of 35 %. Half and twice as many offsets change variances by less than
        1.2 %, within intervals of 1 to 3 %.
    block
        Evaluations at a time. The result does not depend on it.
    spreads
        Successive parts of the offsets, whose variances give the standard error, with Student's t. With 8
        and 32 parts half intervals are between those of 16 and 1.6 times as much.
    steps
        Rounds of reduction that make vectors of a lattice short. Insensitive between 6 and 24.
    """

    offsets: int = 2**13
    least_offsets: int = 2**6
    evaluations: int = 2**23
    block: int = 2**20
    spreads: int = 16
    steps: int = 12


_TORUS, _DRAWN, _DUALS, _MOVES = TorusSettings(), DrawnSettings(), DualSettings(), MovesSettings()

_DIAGONALS = {
    1: (),
    2: ((1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1)),
    3: ((1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1)),
}
"""Directions in which jumps along diagonals have their energy."""
_NORMAL = 1.96
"""Standard errors of half a 95 % interval."""
_ROUNDING = 4e-15
"""Rounding error of ∫g², relative: some units in the last place of double precision."""
_RELATIVE = 1e-9
"""Relative error of sums whose terms do not cancel."""
_OFFSET_STREAM = 0x0FF5E7
"""Label of the random numbers of the offsets."""
_BITS = 2.0**53
"""Coordinates are whole multiples of its inverse."""


@final
@dataclass(frozen=True)
class Region:
    """Frequencies m = Σ_i k_i vectors_i, k on a grid, with what they weigh.

    Attributes
    ----------
    vectors, low, high
        int64 (q, d), and the range of k along each of its q axes, both ends included.
    energy
        |g_m|², doubled where −m is not in the region: (channels or 1, *grid).
    table
        The same by a coarser table; None where coefficients are exact.
    near
        Whether sets that are drawn count it.
    """

    vectors: Array
    low: tuple[int, ...]
    high: tuple[int, ...]
    energy: Array
    table: Array | None = None
    near: bool = True

    @property
    def dims(self) -> int:
        """Number of dims d."""
        return int(self.vectors.shape[1])

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of k along the axes."""
        return tuple(h - l + 1 for l, h in zip(self.low, self.high, strict=True))

    def frequencies(self) -> Array:
        """Every m: int64 (F, d) in C order."""
        return _listed(self.vectors, self.low, self.high)

    def power_of(self, points: Array) -> Array:
        """|S_m|² of one set (n, d), on the grid."""
        import finufft

        y = np.remainder(points @ self.vectors.T.astype(float), 1.0)
        middle = np.array([l + size // 2 for l, size in zip(self.low, self.shape, strict=True)])
        weights = np.exp(-2j * np.pi * np.remainder(y @ middle, 1.0)) / len(points)
        transform = getattr(finufft, f"nufft{len(self.low)}d1")
        axes = [np.ascontiguousarray(2.0 * np.pi * axis) for axis in y.T]
        found = transform(
            *axes, weights, self.shape, eps=_TORUS.precision, isign=-1, nthreads=1, upsampfac=1.25
        )
        return np.asarray(np.abs(found) ** 2)

    def power(self, law: Law) -> Array:
        """The closed form of P, on the grid."""
        m = self.frequencies().astype(float)
        blocks = [m[start : start + _TORUS.block] for start in range(0, len(m), _TORUS.block)]
        blocks = [moments_of(law, law.name, some).power(some) for some in blocks]
        return np.concatenate(blocks).reshape(self.shape)

    def symmetrized(self) -> Region:
        """A box averaged over the symmetries of the cube."""

        def mean(half: Array) -> Array:
            axes = range(1, half.ndim)
            beyond = 0.5 * half[:, 1:]
            whole = np.concatenate([np.flip(beyond, tuple(axes)), half[:, :1], beyond], axis=1)
            for axis in axes:
                whole = 0.5 * (whole + np.flip(whole, axis))
            turned = [whole.transpose(0, *order) for order in itertools.permutations(axes)]
            found = np.asarray(sum(turned) / len(turned))[:, half.shape[1] - 1 :].copy()
            found[:, 1:] *= 2.0
            return found

        table = None if self.table is None else mean(self.table)
        return replace(self, energy=mean(self.energy), table=table)


def _energies(g: Integrand) -> tuple[Region, ...]:
    """|g_m|² over all regions that are counted, the box first; those of m = 0 are 0.

    Coefficients where they are known exactly, else from two tables of g.
    """
    exact, d = g.fourier_source == "exact", g.dims
    reach = (_TORUS.exact if exact else _TORUS.table)[d]

    def region(vectors: Array, low: list[int], high: list[int], *, near: bool = True) -> Region:
        if exact:
            shape = [h - l + 1 for l, h in zip(low, high, strict=True)]
            f = g.fourier(_listed(vectors, low, high)).reshape(*shape, -1)
            found = [np.ascontiguousarray(np.moveaxis(np.abs(f) ** 2, -1, 0))]
        else:
            # From a table of g and from a coarser one, of a region along permuted axes
            order = vectors.argmax(axis=1)
            m = [np.arange(low[i], high[i] + 1, dtype=float) for i in np.argsort(order)]
            found = []
            for nodes in (_TORUS.nodes, _TORUS.nodes // 2):
                least = (max(_TORUS.least_nodes[d], nodes * int(np.abs(axis).max())) for axis in m)
                value = grid_coefficients(g, [1 << (k - 1).bit_length() for k in least], m)
                value = value if g.channels else value[..., None]
                found.append(np.ascontiguousarray(np.abs(value.transpose(d, *order)) ** 2))
        for energy in found:
            if low[0] > 0:
                energy *= 2.0
            else:  # the box has both m and −m where k_0 = 0
                energy[:, 1:] *= 2.0
                middle = math.prod(-2 * l + 1 for l in low[1:]) // 2
                energy[:, 0].reshape(len(energy), -1)[:, middle] = 0.0
        table = None if exact else found[1]
        return Region(vectors, tuple(low), tuple(high), found[0], table, near)

    one = np.eye(d, dtype=np.int64)
    regions = [region(one, [0] + [-reach.box] * (d - 1), [reach.box] * d)]
    for axis in range(d):
        vectors, start = np.roll(one, -axis, axis=0), reach.box
        for stop, width in reach.strips:
            low, high = [start + 1] + [-width] * (d - 1), [stop] + [width] * (d - 1)
            regions.append(region(vectors, low, high, near=start == reach.box))
            start = stop
    for direction in _DIAGONALS[d] if reach.diagonal else ():
        most = max(map(abs, direction))
        low, high = [reach.box // most + 1], [reach.diagonal // most]
        regions.append(region(np.array([direction]), low, high))
    return tuple(regions)


def of_torus(law: Law, known: Known, stream: Stream) -> Predicted:
    """Predict the variance with a set that is the same after any translation, in 1 to 3 dims.

    Raises
    ------
    NoClosedForm
        The set is another, or has more dims, or ∫g² diverges.
    """
    n, dims = law.n, law.dims
    inner = law.inner if isinstance(law, Shifted) else law
    if not law.stationary or (dims > 3 and not isinstance(law, Independent)):
        raise NoClosedForm(
            f"{law.name} is not known to be the same after any translation, or has over 3 dims."
        )
    square, square_error = known.square
    mean = np.atleast_1d(np.asarray(known.g.integral, float))
    spread = square - mean**2
    spread = np.where(spread > _ROUNDING * square, spread, 0.0)
    if not np.isfinite(square).all():
        raise NoClosedForm(f"∫g² of {known.g.spec} diverges.")
    if isinstance(law, Independent):
        error = square_error / n + _ROUNDING * square / n
        if dims > 3 and (error > _TORUS.vague * spread / n).any():
            raise NoClosedForm(f"∫g² of {known.g.spec} is not known well enough by quadrature.")
        return Predicted(spread / n, error, "∫g²")

    if inner.fixed:
        points = inner.draw(Stream.from_rng(0), 0, 1)[0]
        if known.g.fourier_source == "exact" and lattice_basis(points) is not None:
            return _of_dual(points, known)
    regions = known.once("torus", lambda: _energies(known.g))
    if inner.fixed:
        powers = [r.power_of(points) for r in regions]
        sampling, how = np.zeros(len(spread)), "one transform"
    else:
        try:
            powers = [r.power(law) for r in regions]
            sampling, how = np.zeros(len(spread)), "closed form"
        except NoClosedForm:
            if inner is law:
                box = known.once("torus, symmetrized", regions[0].symmetrized)
                width = max(_DRAWN.least_box, math.ceil(_DRAWN.box * n ** (1.0 / dims)))
                regions = (_cropped(box, width)[0],)
            else:
                regions = tuple(r for r in regions if r.near)
            powers, sampling, count = _drawn(inner, regions, stream, isotropic=inner is law)
            how = f"{count} sets"

    # Add the tail, and what it may be off by
    counted = sum(r.energy.reshape(len(spread), -1).sum(axis=1) for r in regions)
    variance = _total(regions, powers)
    rest = np.where(np.abs(spread - counted) > _ROUNDING * square, spread - counted, 0.0)
    tail, excess = np.maximum(rest, 0.0) / n, np.maximum(-rest, 0.0) / n
    # Root mean square over the outer shells of the box of n P(m), weighted by |g_m|², minus 1
    box, power = regions[0], n * powers[0].reshape(-1) - 1.0
    axes = [np.abs(np.arange(l, h + 1)) for l, h in zip(box.low, box.high, strict=True)]
    edges = box.high[0] * 0.5 ** (0.5 * np.arange(_TORUS.shells, -1, -1))
    place = np.searchsorted(edges, mesh(*axes).max(axis=-1), side="left").reshape(-1)
    departure = np.ones(len(spread))
    for c, energy in enumerate(box.energy.reshape(len(spread), -1)):
        weight, above = (
            np.bincount(place, each, _TORUS.shells + 2)[1:-1] for each in (energy, energy * power)
        )
        if (weight > 0.0).any():
            ratio = above[weight > 0.0] / weight[weight > 0.0]
            departure[c] = math.sqrt(float(np.mean(ratio**2)))
    errors = [sampling, _NORMAL * departure * tail, square_error / n, excess]
    if regions[0].table is not None:
        coarse = tuple(replace(r, energy=r.table) for r in regions if r.table is not None)
        rest = spread - sum(r.energy.reshape(len(spread), -1).sum(axis=1) for r in coarse)
        errors.append(np.abs(_total(coarse, powers) + np.maximum(rest, 0.0) / n - variance - tail))
    error = np.sqrt(sum(e**2 for e in errors)) + _ROUNDING * square / n
    share = np.clip((counted + mean**2) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    return Predicted(variance + tail, error, how, share, tail)


def lattice_basis(points: Array) -> Array | None:
    """n times a basis of the lattice of n points, an upper triangle of int64; None for other sets."""
    n, dims = points.shape
    exact = np.remainder(points - points[0], 1.0) * n
    if np.abs(exact - np.rint(exact)).max() > _DUALS.whole:
        return None
    whole = np.rint(exact).astype(np.int64) % n
    basis, left = n * np.eye(dims, dtype=np.int64), whole
    for axis in range(dims):
        some = left[left[:, axis] > 0]
        if len(some):
            basis[axis] = some[some[:, axis].argmin()]
        left = left[left[:, axis] == 0]
    dual = _dual(basis, n)
    full = math.prod(np.diag(dual).tolist()) == n
    return basis if full and not (whole @ dual.T % n).any() else None


def _dual(basis: Array, n: int) -> Array:
    """A basis of the dual lattice, a lower triangle of int64."""
    return np.asarray(np.rint(n * np.linalg.inv(basis).T), np.int64)


def _of_dual(points: Array, known: Known) -> Predicted:
    """Sum |g_m|² over the dual lattice of a lattice; beyond, octaves go on as the last ones do."""
    g, (n, dims) = known.g, points.shape

    def listed(axis: int, low: list[int], high: list[int]) -> Array:
        """Vectors of the dual lattice between bounds, those of `axis` first: int64 (F, d)."""
        basis = lattice_basis(np.roll(points, -axis, axis=1))
        assert basis is not None
        dual, m = _dual(basis, n), np.zeros((1, dims), np.int64)
        for j in reversed(range(dims)):
            first = -((m[:, j] - low[j]) // dual[j, j])
            k = first[:, None] + np.arange((high[j] - low[j]) // dual[j, j] + 1)
            m = (m[:, None] + k[..., None] * dual[j]).reshape(-1, dims)
            m = m[m[:, j] <= high[j]]
        return np.roll(m, axis, axis=1)

    def summed(m: Array, size: Array, end: int, beyond: Array) -> tuple[Array, Array]:
        """Σ |g_m|², and how much is left where `beyond`, from the last two octaves of sizes to `end`."""
        energy = np.abs(g.fourier(m).reshape(len(m), -1)) ** 2
        last = energy[beyond & (2 * size > end)].sum(axis=0)
        before = energy[beyond & (2 * size <= end) & (4 * size > end)].sum(axis=0)
        ratio = np.minimum(last / np.maximum(before, 1e-300), _DUALS.jump)
        return energy.sum(axis=0), last * ratio / (1.0 - ratio)

    # A box, and strips along the axes, whose octaves go on by themselves
    width = int(0.5 * (_DUALS.frequencies * n) ** (1.0 / dims))
    end = _DUALS.periods * n
    narrow = min(width, int(0.5 * (_DUALS.strip * n / end) ** (1.0 / max(1, dims - 1))))
    m = listed(0, [-width] * dims, [width] * dims)
    m = m[m.any(axis=1)]
    size = np.abs(m).max(axis=1)
    strips = dims > 1 and end > width
    along = np.sort(np.abs(m), axis=1)[:, -2] <= narrow if strips else np.zeros(len(m), bool)
    value, tail = summed(m, size, width, ~along)
    for axis in range(dims if strips else 0):
        m = listed(axis, [width + 1] + [-narrow] * (dims - 1), [end] + [narrow] * (dims - 1))
        counted, left = summed(m, m[:, axis], end, np.ones(len(m), bool))
        value, tail = value + 2.0 * counted, tail + 2.0 * left
    square = np.maximum(known.square[0], 1e-300)
    share = np.clip(1.0 - n * tail / square, 0.0, 1.0)
    error = tail + _RELATIVE * value
    return Predicted(value + tail, error, "dual lattice", share, tail)


def of_moves(law: Law, known: Known, stream: Stream) -> Predicted:
    """The variance of the mean of g over a fixed set that is shifted or scrambled, in any dims.

    The means at offsets of our own, a Kronecker sequence of a random vector, have this variance to a share
    that does not depend on n; of a lattice those in one of its cells are all there are. Digital
    shifts and permutations of other bases are drawn at random. So are linear scrambles, which stand for nested
    ones, too, since pairs of points have the same law. The interval is by Student's t of successive parts. Pairs,
    E g(u) g(u + x_k) over independent u, need more: the square of the mean is their mean over all pairs of points.

    Raises
    ------
    NoClosedForm
        The last step is no shift and no scramble of a fixed set; or n is so large that too few offsets are
        left.
    """
    g, n = known.g, law.n
    count = min(_MOVES.offsets, _MOVES.evaluations // n)
    if not moves_at_once(law):
        raise NoClosedForm(f"{law.name} does not move {n} points at once, or too many of them.")
    assert isinstance(law, Shifted | Scrambled)
    own = stream.child(_OFFSET_STREAM)
    shifted, points = isinstance(law, Shifted), law.inner.draw(Stream.from_rng(0), 0, 1)[0]
    words, cell, how = (points * _BITS).astype(np.uint64), np.eye(g.dims), "offsets of the set"
    if shifted and (basis := lattice_basis(points)) is not None:
        # Short vectors of the lattice, in which the mean is the smoothest
        cell, how = basis.astype(float), "offsets of a lattice"
        for _ in range(_MOVES.steps):
            for i, j in itertools.permutations(range(g.dims), 2):
                cell[i] -= np.rint(cell[i] @ cell[j] / (cell[j] @ cell[j])) * cell[j]
        cell = cell / n
    elif not shifted:
        how = "digital shifts of the net"
    scramble = _scramble(law) if isinstance(law, Scrambled) and not law.xor else None
    if scramble is not None:
        how = f"{scramble.name} scrambles of the set"

    # Means of g over the moved sets. Multiples of a random vector are independent in pairs, so that they
    # do as well as random offsets at least; those of a fixed vector might be the points of the set itself
    start, step = own.uniforms(0, 1, 2 * g.dims).reshape(2, g.dims)
    offsets = (start + np.arange(count)[:, None] * step) % 1.0
    means, first = [], 0
    for some in np.array_split(offsets, max(1, len(offsets) * n // _MOVES.block)):
        if shifted:
            x = (points + (some @ cell)[:, None]) % 1.0
        elif scramble is not None:
            x = scramble.apply(np.broadcast_to(points, (len(some), *points.shape)), own, first)
        else:
            x = (words ^ (some[:, None] * _BITS).astype(np.uint64)) / _BITS
        means.append(g(x).reshape(len(some), n, -1).mean(axis=1))
        first += len(some)
    of_offsets = np.concatenate(means)
    value = of_offsets.var(axis=0)
    spreads = [part.var(axis=0, ddof=1) for part in np.array_split(of_offsets, _MOVES.spreads)]
    return Predicted(value, half_interval(np.array(spreads)), how)


def _scramble(law: Scrambled) -> Randomization:
    """The cheapest scramble that has the law's distribution of pairs of points."""
    if law.kind == "digital-shift":
        return DigitalShift(base=law.bases)
    if law.kind == "permutation":
        return Permute(base=law.bases)
    linear = all(map(is_prime, law.bases))
    return Lms(base=law.bases) if linear else Owen(base=law.bases)


def moves_at_once(law: Law) -> bool:
    """Whether one random offset, or one scramble, moves a fixed set of not too many points."""
    if not isinstance(law, Shifted | Scrambled):
        return False
    if isinstance(law, Scrambled) and not law.shifts:
        return False
    return law.inner.fixed and law.n <= _MOVES.evaluations // _MOVES.least_offsets


def moves_resolve(law: Law, known: Known) -> bool:
    """Whether `of_moves` resolves a set of 1 to 3 dims better than other methods do.

    These are shifted lattices, where the coefficients of g are not exact, and nets in base 2 with a
    digital shift, whose weights depend on g.
    """
    if law.dims > 3 or not moves_at_once(law):
        return False
    if not isinstance(law, Shifted):
        return isinstance(law, Scrambled) and law.xor
    if known.given.fourier_source == "exact":
        return False
    return lattice_basis(law.inner.draw(Stream.from_rng(0), 0, 1)[0]) is not None


def cost_of_moves(law: Law, known: Known) -> float:  # noqa: ARG001
    """Evaluations of g by `of_moves`."""
    return float(min(_MOVES.offsets * law.n, _MOVES.evaluations))


def _drawn(
    inner: Law, regions: tuple[Region, ...], stream: Stream, *, isotropic: bool
) -> tuple[list[Array], Array, int]:
    """Mean power over sets, half the 95 % interval of Σ |g_m|² P(m), and the number of sets.

    The first sets give all frequencies, more the low ones alone, which few coefficients of smooth
    functions hold: until the error is small beside the variance, or for some number of points. Where
    power depends on the length of m alone, and fits the measured one, a smooth law takes its place.
    """
    from scipy.special import stdtrit

    n = inner.n
    assert inner.source is not None
    dear = inner.source.max_count <= _DRAWN.slow
    points, first = (
        (_DRAWN.slow_points, _DRAWN.least_sets // 2) if dear else (_DRAWN.points, _DRAWN.least_sets)
    )
    most = min(max(points // n, first), _DRAWN.most_sets)
    box = regions[0]
    low, part = _cropped(box, _DRAWN.low)
    length = np.linalg.norm(low.frequencies(), axis=1).reshape(low.shape) / n ** (1.0 / box.dims)
    inside = (length > 0.0) & (length <= _DRAWN.length)
    lawful = isotropic and len(np.unique(np.rint(length[inside] ** 2 * n))) >= _DRAWN.least_lengths
    core = replace(low, energy=np.where(inside, low.energy, 0.0) if lawful else 0.0 * low.energy)
    sums, low_sum, count = [np.zeros(r.shape) for r in regions], np.zeros(low.shape), 0
    values: tuple[list[Array], ...] = ([], [], [])  # of the core, the other low ones, all others
    while True:
        for x in (
            _sets(inner.source, n, stream, count, min(first, most))
            if dear
            else inner.draw(stream, count, min(first, most))
        ):
            if count < first:
                powers = [r.power_of(x) for r in regions]
                of_low = powers[0][part]
                for total, power in zip(sums, powers, strict=True):
                    total += power
                values[2].append(_total(regions, powers) - _total((low,), [of_low]))
            else:
                of_low = low.power_of(x)
            values[0].append(_total((core,), [of_low]))
            values[1].append(_total((low,), [of_low]) - values[0][-1])
            low_sum += of_low
            count += 1
        errors = [np.std(part, axis=0, ddof=1) / math.sqrt(len(part)) for part in values]
        mean = low_sum / count
        if lawful:
            law, error = _power_law(mean, length, inside, core.energy, count)
            away = np.abs(_total((core,), [law]) - np.mean(values[0], axis=0))
            if (away <= _DRAWN.agrees * errors[0]).all():
                mean, errors[0] = np.where(inside, law, mean), np.minimum(error, errors[0])
        half = float(stdtrit(first - 1, 0.975)) * np.sqrt(sum(e**2 for e in errors))
        value = sum(np.mean(part_values, axis=0) for part_values in values)
        if (half <= _DRAWN.precision * value).all() or count + first > most:
            break
    powers = [total / first for total in sums]
    powers[0][part] = mean
    return powers, half, count


@lru_cache(maxsize=32)
def _sets(sampler: Source, n: int, stream: Stream, first: int, count: int) -> Array:
    """Sets that are expensive to make, kept for other integrands."""
    return sampler.draw_stream(n, stream, first, count)


def _power_law(
    mean: Array, length: Array, inside: Array, energy: Array, count: int
) -> tuple[Array, Array]:
    """log P = a + b log |m| + c |m|² of low frequencies, and the standard error of Σ |g_m|² P(m).

    |S_m|² of one set are exponentially distributed, independent but for ±m: maximum likelihood.
    """
    x = np.stack([np.ones(inside.sum()), np.log(length[inside]), length[inside] ** 2], axis=1)
    measured = mean[inside]
    weight = np.ones(inside.shape)
    weight[0] = 0.5
    weight = count * weight[inside]
    beta = np.zeros(3)
    beta[0] = math.log(measured.mean())
    for _ in range(_DRAWN.steps):
        law = np.exp(x @ beta)
        information = (x * weight[:, None]).T @ x
        beta = beta + np.linalg.solve(information, x.T @ (weight * (measured / law - 1.0)))
    law = np.exp(x @ beta)
    found = np.zeros(inside.shape)
    found[inside] = law
    slopes = energy[:, inside] * law @ x
    variance = np.einsum("ci,ij,cj->c", slopes, np.linalg.inv(information), slopes)
    return found, np.sqrt(variance)


def _cropped(box: Region, width: int) -> tuple[Region, tuple[slice, ...]]:
    """The part of a box of at most this half width, and where it is on the grid."""
    k = min(width, box.high[0])
    low, high = tuple(max(l, -k) for l in box.low), tuple(min(h, k) for h in box.high)
    starts = zip(low, high, box.low, strict=True)
    part = tuple(slice(l - first, h - first + 1) for l, h, first in starts)
    table = None if box.table is None else box.table[:, *part]
    return replace(box, low=low, high=high, energy=box.energy[:, *part], table=table), part


def _total(regions: tuple[Region, ...], powers: list[Array]) -> Array:
    """Σ |g_m|² P(m) over all regions, (channels or 1,)."""
    parts = [
        r.energy.reshape(len(r.energy), -1) @ p.reshape(-1)
        for r, p in zip(regions, powers, strict=True)
    ]
    return np.asarray(sum(parts))


def _listed(vectors: Array, low: Sequence[int], high: Sequence[int]) -> Array:
    """All m of a region: int64 (F, d)."""
    axes = [np.arange(l, h + 1) for l, h in zip(low, high, strict=True)]
    return np.asarray(mesh(*axes).reshape(-1, len(axes)) @ vectors)
