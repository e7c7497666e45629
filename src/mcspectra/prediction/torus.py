"""Variances of sets that are statistically the same after any translation of the torus.

The covariance matrix C_ml is diagonal. With the power P(m) = ⟨|S_m|²⟩,

    Var = Σ_{m≠0} |g_m|² P(m) = Σ_{m in C} |g_m|² P(m) + (∫g² − I² − Σ_{m in C} |g_m|²) / n + …,

Here C is the set of frequencies that are summed: a box, strips, and multiples of vectors.
Strips along the axes hold the energy of functions that are not periodic.
Multiples of a few integer vectors hold the energy of jumps along diagonals.
Outside the set C, the power P tends to 1/n.
The error of the tail is the difference between P and 1/n at the box's border, weighted by |g_m|².

P may have a closed form. For a set that is shifted as a whole, P comes from one transform.
Otherwise P is the mean over drawn sets.

For lattices, P is 1 on the dual lattice and 0 elsewhere.
Only frequencies of the dual lattice are summed, n times as many as in a box.
The sum over all higher frequencies is extrapolated from the last octaves.
If coefficients are not known exactly, g is averaged over lattices with several offsets.
The mean over a lattice is a function of its offset: quadrature gives the variance.

Homogeneous sets have the symmetries of the cube.
Averaging |g_m|² over the symmetries of the cube is equivalent to averaging P.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
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
    """Ranges of the frequencies that are summed, for one number of dims.

    Attributes
    ----------
    box
        Half width of the box of frequencies about 0.
    strips
        Strips of frequencies along each axis: the largest frequency and half width of each strip.
        If the power comes from drawn sets, each axis uses only its first strip of frequencies.
    diagonal
        Largest |m_i| of frequencies along diagonals of the cube, or 0 without diagonals.
    """

    box: int
    strips: tuple[tuple[int, int], ...]
    diagonal: int = 0


@final
@dataclass(frozen=True, kw_only=True)
class TorusSettings:
    """Settings for the Fourier coefficients that are summed.

    The effects of the settings were measured in seven cases in 2-D and 3-D at n = 64 and 256.
    The integrands are a jump along a line, smooth functions and a disk.
    The samplers are poisson-disk, and four samplers under shift:
    jittered, latin-hypercube, halton and rank1-lattice.

    Attributes
    ----------
    exact, table
        Ranges of the frequencies that are summed, by number of dims.
        `exact` is for exact Fourier coefficients, `table` for coefficients from a table of g.
        Exact coefficients cost a few operations each.
        A table of g has `nodes` nodes per wavelength of the highest frequency in the box.
    nodes
        Number of nodes per wavelength of the highest frequency, in the finer table.
        If g jumps, half as many nodes change variances by 0.4 % and multiply the error by 4 to 30.
        Twice as many nodes change variances by 0.1 %.
    least_nodes
        Least number of nodes along each axis, by number of dims.
        Half or twice as many nodes change variances by less than 0.2 %.
    block
        Number of frequencies in memory at a time, if the power has a closed form.
        The number of frequencies in memory has no effect on the result.
    precision
        Relative error of the Fourier transforms, far below the error of the variance.
    shells
        Number of shells of frequencies in the box. The radii of shells grow in steps of √2.
        The power in the shells tests whether the power outside the box is white.
        The innermost shell begins at an eighth of the half width of the box.
        Half or twice as many shells change no variance. Errors change by factors of 0.5 to 3.
    vague
        Largest error of ∫g² in many dims, relative to the variance.
        If the error is larger, `NoClosedForm` is raised.
        In many dims ∫g² is a mean over 2^20 points. Sums of products compute their own error.
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
    """Settings for samplers whose power has no closed form and is estimated from drawn sets.

    Some settings are for a smooth function of |m| that is fitted to the estimated power.

    Effects of settings were measured for a smooth function in 2-D, poisson-disk and n = 64.
    The variance of the smooth test function is predicted with an interval of ±3.1 %.

    Attributes
    ----------
            least_sets, most_sets, points
        Number of sets that are transformed at all frequencies, and largest number of sets.
        `points` is the total number of points, which limits the work at large n.
        Half or twice as many sets or points change the variance by less than 0.8 %.
    slow, slow_points
        Largest `max_count` of slow samplers, which optimize their points.
        `slow_points` is the total number of points of all sets of a slow sampler.
        For slow samplers, the number of sets that are drawn first is `least_sets` / 2.
        The sets of slow samplers are cached for other integrands.
    precision
        More sets are drawn if the half interval, relative to the variance, exceeds this number.
        With the precision 0.0075 instead of 0.015, more than `most_sets` sets would be needed.
        With the precision 0.03 instead of 0.015, the predicted variance changes by 1.9 %.
    low
        Half width of the box of low frequencies. At low frequencies, all sets are transformed.
        The low frequencies hold the energy of smooth functions.
        Half or twice the half width changes the variance by less than 0.5 %.
    length, least_lengths
        Largest scaled frequency |m| n^(-1/d) at which a smooth function of |m| fits the power.
        `least_lengths` is the least number of lengths |m| to which the smooth function is fitted.
        The power of stochastic sets has its first peak at the scaled frequency 1.
        Halving or doubling `length` or `least_lengths` changes the variance by less than 0.1 %.
    agrees
        The smooth function and the measured power must agree within this number of standard errors.
        Any limit from 1 to 4 standard errors gives the same predicted variance.
    steps
        Number of Newton steps, after which the fit has converged.
        The predicted variance is the same for 6 to 24 Newton steps.
    least_box, box
        Half width of the box for homogeneous sets: least value, and value in units of n^(1/d).
        Half or twice the size of the box changes the variance by less than 0.3 %.
        Half the size of the box triples the error of the variance.
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
    """Settings for the frequencies of a dual lattice that are summed.

    The effects of the settings were measured for a disk with rank1-lattice | shift at n = 64.
    For the disk and a lattice of 64 points, the predicted variance has an interval of ±0.11 %.

    Attributes
    ----------
    frequencies
        Number of frequencies of the dual lattice in a box.
        Half or twice as many frequencies change the variance by less than 0.04 %.
    periods, strip
        Strips of frequencies along the axes reach up to the frequency `periods` · n.
        Each strip has about `strip` frequencies of the dual lattice.
        If strips are half or twice as long or wide, the variance changes by less than 0.03 %.
    jump
        Largest ratio of the energies Σ |g_m|² of two successive octaves of frequency.
        The ratio of energies is one half if g jumps along curves, and less otherwise.
        If the largest ratio were below one half, the spectrum of a jump would lose its tail.
        If the largest ratio were one, the extrapolated tail of the spectrum would be infinite.
    whole
        Rounding error of n times the differences of lattice points, which are multiples of 1/n.
        Coordinates are accurate to 2^-53. The result is the same for errors from 5e-7 to 2e-6.
    """

    frequencies: int = 2**19
    periods: int = 2**8
    strip: int = 2**18
    jump: float = 0.5
    whole: float = 1e-6


@final
@dataclass(frozen=True, kw_only=True)
class MovesSettings:
    """Settings for the offsets that move a set.

    The effects of the settings were measured in three cases.
    The sampler rank1-lattice | shift samples a jump along a line.
    The sampler kronecker | shift samples a ball in 4-D.
    The sampler sobol | digital-shift samples a smooth function.

    Attributes
    ----------
    offsets, least_offsets, evaluations
        Number of offsets, and number of evaluations of g, which limits the offsets at large n.
        With fewer than `least_offsets` offsets, intervals exceed 35 % and an error is raised.
        Halving or doubling the number of offsets changes variances by less than 1.2 %.
        A change of 1.2 % is within the intervals of predicted variances, which are 1 to 3 %.
    block
        Number of evaluations per call. The number has no effect on the result.
    spreads
        Number of parts into which the offsets are divided.
        The spread of the variances over the parts of the offsets gives the standard error.
        With offsets in 8 or 32 parts instead of 16, intervals are 1 to 1.6 times as wide.
    steps
        Number of rounds of lattice reduction. Values from 6 to 24 give the same results.
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
"""Directions of diagonals, which hold the energy of jumps along diagonals."""
_NORMAL = 1.96
"""Half of a 95 % interval in standard errors."""
_ROUNDING = 4e-15
"""Relative rounding error of ∫g²: some units in the last place of double precision."""
_RELATIVE = 1e-9
"""Relative error of sums whose terms do not cancel."""
_OFFSET_STREAM = 0x0FF5E7
"""Label of the stream of random numbers for offsets."""
_BITS = 2.0**53
"""Inverse of the smallest spacing of coordinates."""


@final
@dataclass(frozen=True)
class Region:
    """Frequencies m = Σ_i k_i vectors_i, with k on a grid, and their weights.

    Attributes
    ----------
    vectors, low, high
        The vectors, int64 (q, d), and the range of k along each of the q axes, both ends included.
    energy
        |g_m|², doubled where −m is not in the region: (channels or 1, *grid).
    table
        Energies |g_m|² from a coarser table of g, or None if the coefficients are exact.
    near
        Whether frequencies of the region are also summed if the power comes from drawn sets.
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
        """Number of values of k along each axis."""
        return tuple(h - l + 1 for l, h in zip(self.low, self.high, strict=True))

    def frequencies(self) -> Array:
        """Return every frequency m of the region, int64 (F, d), in C order."""
        return _listed(self.vectors, self.low, self.high)

    def transform(self) -> Callable[[Array], Array]:
        """Return a function of one point set (n, d): |S_m|² at all frequencies of the grid.

        The function keeps the plan of its Fourier transform, so only one thread may call it.
        If there are few points, the plan takes longer to make than the transform.
        """
        import finufft

        middle = np.array([l + size // 2 for l, size in zip(self.low, self.shape, strict=True)])
        options = {"eps": _TORUS.precision, "isign": -1, "nthreads": 1, "upsampfac": 1.25}
        plan = finufft.Plan(1, self.shape, **options)

        def power(points: Array) -> Array:
            y = np.remainder(points @ self.vectors.T.astype(float), 1.0)
            weights = np.exp(-2j * np.pi * np.remainder(y @ middle, 1.0)) / len(points)
            plan.setpts(*(np.ascontiguousarray(2.0 * np.pi * axis) for axis in y.T))
            return np.asarray(np.abs(plan.execute(weights)) ** 2)

        return power

    def power(self, law: Law) -> Array:
        """Return the closed form of the power P on the grid."""
        m = self.frequencies().astype(float)
        blocks = [m[start : start + _TORUS.block] for start in range(0, len(m), _TORUS.block)]
        blocks = [moments_of(law, law.name, some).power(some) for some in blocks]
        return np.concatenate(blocks).reshape(self.shape)

    def symmetrized(self) -> Region:
        """Average |g_m|² over all permutations and reflections of the axes, for a box."""

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
    """Return |g_m|² in all regions of summed frequencies. The first region is the box.

    The value at m = 0 is 0.
    The coefficients are exact if known. Otherwise they come from two tables of g.
    """
    exact, d = g.fourier_source == "exact", g.dims
    reach = (_TORUS.exact if exact else _TORUS.table)[d]

    def region(vectors: Array, low: list[int], high: list[int], *, near: bool = True) -> Region:
        if exact:
            shape = [h - l + 1 for l, h in zip(low, high, strict=True)]
            f = g.fourier(_listed(vectors, low, high)).reshape(*shape, -1)
            found = [np.ascontiguousarray(np.moveaxis(np.abs(f) ** 2, -1, 0))]
        else:
            # Compute the coefficients from a fine and a coarse table of g, with the axes permuted
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
            else:  # The frequencies with k_0 = 0 include both m and −m
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
    """Predict the variance of a set that is the same after any translation, in 1 to 3 dims.

    Raises
    ------
    NoClosedForm
        If the set has another law or more than 3 dims, or ∫g² diverges.
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
        powers = [r.transform()(points) for r in regions]
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

    # Add the tail and the error of the tail
    counted = sum(r.energy.reshape(len(spread), -1).sum(axis=1) for r in regions)
    variance = _total(regions, powers)
    rest = np.where(np.abs(spread - counted) > _ROUNDING * square, spread - counted, 0.0)
    tail, excess = np.maximum(rest, 0.0) / n, np.maximum(-rest, 0.0) / n
    # Root mean square of n P(m) − 1, weighted by |g_m|², over the outer shells of the box
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
    """Return n times a basis of a lattice, upper triangular int64, or None for other sets."""
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
    """Return a basis of the dual lattice, as a lower triangular matrix of int64."""
    return np.asarray(np.rint(n * np.linalg.inv(basis).T), np.int64)


def _of_dual(points: Array, known: Known) -> Predicted:
    """Sum |g_m|² over the dual lattice of a lattice, and extrapolate beyond the last octaves."""
    g, (n, dims) = known.g, points.shape

    def listed(axis: int, low: list[int], high: list[int]) -> Array:
        """Return vectors of the dual lattice within bounds, `axis` first: int64 (F, d)."""
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
        """Return Σ |g_m|², and an estimate of the sum beyond `end`.

        The sums over the last two octaves are continued as a geometric series.
        Only frequencies where `beyond` is true are included in these sums over octaves.
        """
        energy = np.abs(g.fourier(m).reshape(len(m), -1)) ** 2
        last = energy[beyond & (2 * size > end)].sum(axis=0)
        before = energy[beyond & (2 * size <= end) & (4 * size > end)].sum(axis=0)
        ratio = np.minimum(last / np.maximum(before, 1e-300), _DUALS.jump)
        return energy.sum(axis=0), last * ratio / (1.0 - ratio)

    # Sum over a box and over strips along the axes. Extrapolate each of the two sums by octaves
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
    """Predict the variance of the mean of g over a fixed set that is shifted or scrambled.

    The set is moved by random offsets, and g is averaged over each moved set.
    The prediction is the variance of the averages over the moved sets.
    The relative error of the prediction does not depend on n.

    For shifts, the offsets are a Kronecker sequence of a random vector.
    For a lattice, the offsets lie within one of its cells.
    Digital shifts, permutations in other bases and linear scrambles are drawn at random.
    Linear scrambles also replace nested scrambles, because their pairs of points have the same law.
    The sequence of offsets is divided into successive parts, and each part gives a variance.
    The spread of the variances of the parts gives the interval, with Student's t.

    Estimating E g(u) g(u + x_k) for each x_k from independent u would need more evaluations.
    The squared mean of g over one moved set already averages over all pairs of points.

    Raises
    ------
    NoClosedForm
        If the last step is neither a shift nor a scramble of a fixed set.
        If n is so large that too few offsets remain.
    """
    g, n = known.g, law.n
    count = min(_MOVES.offsets, _MOVES.evaluations // n)
    if not moves_at_once(law):
        raise NoClosedForm(f"{law.name} does not move {n} points at once, or has too many.")
    assert isinstance(law, Shifted | Scrambled)
    own = stream.child(_OFFSET_STREAM)
    shifted, points = isinstance(law, Shifted), law.inner.draw(Stream.from_rng(0), 0, 1)[0]
    words, cell, how = (points * _BITS).astype(np.uint64), np.eye(g.dims), "offsets of the set"
    if shifted and (basis := lattice_basis(points)) is not None:
        # Use short vectors of the lattice, along which the mean is smoothest
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

    # Average g over the moved sets. The offsets are multiples of a random vector.
    # Multiples of a random vector, plus a random start, are pairwise independent.
    # Pairwise independent offsets are at least as good as random offsets.
    # Multiples of a fixed vector might coincide with the points of the set
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
    """Return the cheapest scramble with the same distribution of pairs of points."""
    if law.kind == "digital-shift":
        return DigitalShift(base=law.bases)
    if law.kind == "permutation":
        return Permute(base=law.bases)
    linear = all(map(is_prime, law.bases))
    return Lms(base=law.bases) if linear else Owen(base=law.bases)


def moves_at_once(law: Law) -> bool:
    """Return whether one random offset or scramble moves all points of a fixed set.

    Return False if n is too large to evaluate g for enough offsets.
    """
    if not isinstance(law, Shifted | Scrambled):
        return False
    if isinstance(law, Scrambled) and not law.shifts:
        return False
    return law.inner.fixed and law.n <= _MOVES.evaluations // _MOVES.least_offsets


def moves_resolve(law: Law, known: Known) -> bool:
    """Return whether `of_moves` resolves a set in 1 to 3 dims better than other methods.

    Random moves are better for shifted lattices if the coefficients of g are not exact.
    Random moves are also better for digital shifts in base 2, whose weights depend on g.
    """
    if law.dims > 3 or not moves_at_once(law):
        return False
    if not isinstance(law, Shifted):
        return isinstance(law, Scrambled) and law.xor
    if known.given.fourier_source == "exact":
        return False
    return lattice_basis(law.inner.draw(Stream.from_rng(0), 0, 1)[0]) is not None


def cost_of_moves(law: Law, known: Known) -> float:  # noqa: ARG001
    """Return the number of evaluations of g by `of_moves`."""
    return float(min(_MOVES.offsets * law.n, _MOVES.evaluations))


def _drawn(
    inner: Law, regions: tuple[Region, ...], stream: Stream, *, isotropic: bool
) -> tuple[list[Array], Array, int]:
    """Return mean power over sets, half the 95 % interval of Σ |g_m|² P(m), and the number of sets.

    For some point sets, which are drawn first, Fourier transforms are computed at all frequencies.
    Further sets are transformed only at low frequencies, which hold the energy of smooth functions.
    Sets are added until the error is small compared with the variance,
    or until the sets together have the largest allowed number of points.
    If power depends only on the length of m, a smooth function may fit the measured power.
    The smooth function then replaces the measured power.
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
    # Add the variance from frequencies at which a smooth function of |m| may replace the power,
    # the variance from all other low frequencies, and the variance from higher frequencies
    values: tuple[list[Array], ...] = ([], [], [])
    transforms, low_power_of = [r.transform() for r in regions], low.transform()
    while True:
        for x in (
            _sets(inner.source, n, stream, count, min(first, most))
            if dear
            else inner.draw(stream, count, min(first, most))
        ):
            if count < first:
                powers = [power_of(x) for power_of in transforms]
                of_low = powers[0][part]
                for total, power in zip(sums, powers, strict=True):
                    total += power
                values[2].append(_total(regions, powers) - _total((low,), [of_low]))
            else:
                of_low = low_power_of(x)
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
    """Draw sets of a slow sampler, which are cached for other integrands."""
    return sampler.draw_stream(n, stream, first, count)


def _power_law(
    mean: Array, length: Array, inside: Array, energy: Array, count: int
) -> tuple[Array, Array]:
    """Fit log P = a + b log |m| + c |m|² at low m. Return P and the error of Σ |g_m|² P(m).

    The |S_m|² of one set are exponentially distributed and independent except for ±m.
    The fit is by maximum likelihood.
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
    """Return the box's frequencies within half width `width`, and their places on the grid."""
    k = min(width, box.high[0])
    low, high = tuple(max(l, -k) for l in box.low), tuple(min(h, k) for h in box.high)
    starts = zip(low, high, box.low, strict=True)
    part = tuple(slice(l - first, h - first + 1) for l, h, first in starts)
    table = None if box.table is None else box.table[:, *part]
    return replace(box, low=low, high=high, energy=box.energy[:, *part], table=table), part


def _total(regions: tuple[Region, ...], powers: list[Array]) -> Array:
    """Return Σ |g_m|² P(m) over the frequencies of all regions, for each channel."""
    parts = [
        r.energy.reshape(len(r.energy), -1) @ p.reshape(-1)
        for r, p in zip(regions, powers, strict=True)
    ]
    return np.asarray(sum(parts))


def _listed(vectors: Array, low: Sequence[int], high: Sequence[int]) -> Array:
    """Return all frequencies m of a region: int64 (F, d)."""
    axes = [np.arange(l, h + 1) for l, h in zip(low, high, strict=True)]
    return np.asarray(mesh(*axes).reshape(-1, len(axes)) @ vectors)
