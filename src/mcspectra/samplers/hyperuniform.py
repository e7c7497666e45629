"""Hyperuniform sets: noisy lattices, sets without low frequencies, determinantal sets.

In a hyperuniform set, the power n⟨|S_m|²⟩ goes to 0 with the frequency |m|.

Notation of the kernels: R realizations, n points, d dims, K frequencies.
Complex numbers are stored as two real arrays, so that inner loops access neighbors in memory.
Inner loops have no running sum, so that compilers vectorize them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from math import cos, log, pi, sin, sqrt
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import real, whole
from mcspectra.core.jit import kernel
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream, mix_uniform, uniforms
from mcspectra.samplers.base import Sampler, Structure
from mcspectra.samplers.law import Law, Stationary, mean_of_terms
from mcspectra.samplers.optimised import OptimisedSampler, Report, minimize, random_points, wrap
from mcspectra.samplers.stratified import GridSampler, corners

__all__ = [
    "Determinantal",
    "PerturbedLattice",
    "StealthyHyperuniform",
    "fill_normals",
    "frequencies_within",
    "half_shells",
    "nearest_frequencies",
    "summed_power",
]

_GOAL = 1e-22  # sum of powers that counts as zero; rounding gives 1e-28, random points give 1
_STARTS = 20
_PAIRS = 2**20  # number of pairs of waves and frequencies compared at a time
_BLOCK = 16  # number of basis vectors between two tests of the proposals
_BATCH = 8  # number of proposals that are tested together, with one pass over the basis


@final
@dataclass(frozen=True, kw_only=True)
class PerturbedLattice(GridSampler):
    """Grid of s^d points, moved by a Gaussian random field and a uniform translation; any dims.

    Attributes
    ----------
    width
        Standard deviation of each coordinate's displacement, as a multiple of the spacing 1/s.
    correlation
        Exponent β, −2 ≤ β ≤ 2. If β is 0, the displacements of different points are independent.
        The power spectrum of the displacements is proportional to |k|^(−β).
        The power of the points therefore grows like |m|^(2−β).

    Notes
    -----
    The field is periodic, and is computed from white noise by a fast Fourier transform.
    For independent displacements n⟨|S_m|²⟩ = 1 − exp(−4π²|m|²(width/s)²).
    The formula for |S_m|² does not hold at the frequencies of the grid, m ≡ 0 modulo s.

    References
    ----------
    [Gabrielli2002]_, [Gabrielli2004]_.
    """

    structure: ClassVar[Structure] = Structure.TORUS
    dims: int = DEFAULT_DIMS
    width: float = real(0.25, least=0.0, most=1e3)
    correlation: float = real(0.0, least=-2.0, most=2.0)

    def displacement_correlation(self, n: int) -> Array:
        """Correlation of the displacements of two grid points, by their offset: shape (s, …, s)."""
        sides = self.sides(n)
        if n == 1 or self.correlation == 0.0:
            return np.asarray(np.arange(n) == 0, float).reshape(sides)
        return np.asarray(np.fft.ifftn(_gains(sides, self.correlation) ** 2).real)

    def _law(self, n: int) -> Law:
        return Stationary(n=n, dims=self.dims, power=lambda m: self._power(n, m))

    def _power(self, n: int, m: Array) -> Array:
        """Return ⟨|S_m|²⟩ at integer m (..., d), which a common translation does not change.

        The power is (1/n) Σ_r exp(−2πi m·r/s) exp(−4π² |m|² (width/s)² (1 − ρ(r))).
        The sum runs over all positions r of the grid, which are integers from 0 to s − 1.
        ρ(r) is the correlation of displacements at offset r ([Gabrielli2004]_, Gaussian case).
        """
        sides = self._sides(n)
        if self.correlation == 0.0:
            gauss = np.exp(-2.0 * (np.pi * self.width * m / sides[0]) ** 2)
            square = np.prod(gauss, axis=-1) ** 2
            on_grid = (np.mod(m, sides[0]) == 0).all(axis=-1)
            return np.asarray((1.0 - square) / n + square * on_grid)
        places = np.stack(np.unravel_index(np.arange(n), sides), axis=-1)
        apart = 1.0 - self.displacement_correlation(n).reshape(-1)

        def terms(rows: Array) -> Array:
            spread = (2.0 * np.pi * self.width / sides[0]) ** 2 * (rows**2).sum(axis=-1)
            phases = 2.0 * np.pi * np.remainder(rows @ places.T / sides[0], 1.0)
            return np.asarray(np.cos(phases) * np.exp(-np.outer(spread, apart)))

        return mean_of_terms(n, m, terms)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        keys, sides = stream.keys(first, count), self._sides(n)
        offsets, moves = uniforms(keys, self.dims), np.empty((count, n * self.dims))
        fill_normals(keys, self.dims, moves)
        field = moves.reshape(count, n, self.dims)

        # Filter the white noise, so that its power is proportional to |k|^(−β); keep its variance
        if self.correlation != 0.0 and n == 1:
            field = np.zeros_like(field)  # the only frequency of the field is 0
        elif self.correlation != 0.0:
            gains, axes = _gains(sides, self.correlation), tuple(range(1, self.dims + 1))
            waves = np.fft.fftn(field.reshape(count, *sides, self.dims), axes=axes)
            filtered = np.fft.ifftn(waves * gains[..., None], axes=axes)
            field = filtered.real.reshape(field.shape)
        points = corners(sides) + field * (self.width / sides[0])
        return wrap(points + offsets[:, None])


@lru_cache(maxsize=2)
def _gains(sides: tuple[int, ...], beta: float) -> Array:
    """Return |k|^(−β/2) on the grid of frequencies, 0 at k = 0, with mean square 1."""
    squares = np.zeros(sides)
    for j, s in enumerate(sides):
        shape = [1] * len(sides)
        shape[j] = s
        squares += (np.fft.fftfreq(s, 1.0 / s) ** 2).reshape(shape)
    squares.flat[0] = np.inf if beta > 0 else 0.0
    gains: Array = squares ** (-beta / 4)
    gains /= np.sqrt(np.mean(gains**2))
    gains.setflags(write=False)
    return gains


@kernel
def fill_normals(keys: Array, start: int, out: Array) -> None:
    """Fill out (R, size) with standard normals, made from the random numbers after `start`."""
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        for i in range(0, out.shape[1], 2):
            radius = sqrt(-2.0 * log(1.0 - mix_uniform(k0, k1, start + i)))
            angle = 2.0 * pi * mix_uniform(k0, k1, start + i + 1)
            out[r, i] = radius * cos(angle)
            if i + 1 < out.shape[1]:
                out[r, i + 1] = radius * sin(angle)


@final
@dataclass(frozen=True, kw_only=True)
class StealthyHyperuniform(OptimisedSampler):
    """Disordered points with zero power at the frequencies 0 < |m| ≤ K; any dims.

    Attributes
    ----------
    stealthiness
        χ, the number of constrained frequencies per degree of freedom, below ½.
        K is the largest radius that contains at most χ d (n − 1) pairs ±m.
        At χ ≥ ½ (in 1-D at χ ≥ ⅓) the points crystallize.
    iterations
        Largest number of descent steps before a restart from other points.
    sets
        Largest number of different sets, see `OptimisedSampler`.

    Notes
    -----
    Limited-memory BFGS starts from independent uniform points.
    The descent lowers the sum of n|S_m|² over the constrained frequencies to below 1e-22.
    The start is random and the sum is invariant under translation, so every point is uniform.

    References
    ----------
    [Uche2004]_, [Torquato2015]_, [Morse2023]_.
    """

    max_dims: ClassVar[int | None] = 64
    max_count: ClassVar[int] = 2**14  # computing time grows as n²
    dims: int = DEFAULT_DIMS
    stealthiness: float = real(0.4, above=0.0)
    iterations: int = whole(10_000, least=1, most=10**6)

    def _check(self) -> None:
        if self.stealthiness >= 0.5:
            raise ParameterError(
                f"stealthiness is {self.stealthiness:g}; give less than 0.5: at 0.5 or more, all "
                "sets are crystals."
            )

    def constrained(self, n: int) -> Array:
        """Return the constrained frequencies of `n` points, one per pair ±m: int64 (K, dims)."""
        most = int(self.stealthiness * self.dims * (self.check_count(n) - 1))
        return half_shells(most, self.dims)

    def _optimize(self, n: int, keys: Array, report: Report) -> Array:
        frequencies = self.constrained(n)
        if not frequencies.size:
            return random_points(keys, n, self.dims)

        def power(points: Array) -> tuple[float, Array]:
            return summed_power(frequencies, points)

        longest = n ** (-1.0 / self.dims) / 4
        for start in random_points(keys, n * _STARTS, self.dims).reshape(_STARTS, n, self.dims):
            points = wrap(
                minimize(
                    power,
                    start,
                    iterations=self.iterations,
                    longest=longest,
                    report=report,
                    goal=_GOAL,
                )
            )
            if power(points)[0] <= 2 * _GOAL:
                return points
        raise ParameterError(
            f"stealthy-hyperuniform found no set of {n} points without low frequencies in "
            f"{_STARTS} starts; lower stealthiness (now {self.stealthiness:g}) or raise iterations "
            f"(now {self.iterations})."
        )


def summed_power(frequencies: Array, points: Array) -> tuple[float, Array]:
    """Return Σ_m |Σ_i exp(2π i m·x_i)|²/n over frequencies (K, d), and its gradient (n, d)."""
    gradient, orders = np.empty(points.shape), int(np.abs(frequencies).max()) + 1
    return _power_sum(points, frequencies, orders, gradient), gradient


@kernel
def _power_sum(points: Array, frequencies: Array, orders: int, gradient: Array) -> float:
    # Every component of a frequency is below `orders`.
    n, dims = points.shape

    # Tabulate cos and sin of 2π m x of each coordinate
    c, s = np.empty((dims, orders, n)), np.empty((dims, orders, n))
    for j in range(dims):
        for order in range(orders):
            for i in range(n):
                c[j, order, i] = cos(2.0 * pi * order * points[i, j])
                s[j, order, i] = sin(2.0 * pi * order * points[i, j])

    re, im = np.empty(n), np.empty(n)
    slope = np.zeros((dims, n))
    total = 0.0
    for k in range(frequencies.shape[0]):
        m = frequencies[k]

        # Compute exp(2π i m·x) of every point, as a product over the coordinates
        re[:] = 1.0
        im[:] = 0.0
        for j in range(dims):
            if m[j] == 0:
                continue
            sign = 1.0 if m[j] > 0 else -1.0
            cj, sj = c[j, abs(m[j])], s[j, abs(m[j])]
            for i in range(n):
                a, b = re[i], im[i]
                re[i] = a * cj[i] - sign * b * sj[i]
                im[i] = sign * a * sj[i] + b * cj[i]

        # Compute the power |Σ_i exp(2π i m·x_i)|²/n, and its derivative for each point
        a, b = 0.0, 0.0
        for i in range(n):
            a += re[i]
            b += im[i]
        total += (a * a + b * b) / n
        for j in range(dims):
            factor = 4.0 * pi * m[j] / n
            if factor != 0.0:
                for i in range(n):
                    slope[j, i] += factor * (b * re[i] - a * im[i])
    gradient[:] = slope.T
    return total


@final
@dataclass(frozen=True, kw_only=True)
class Determinantal(Sampler):
    """Points of the projection determinantal process of n Fourier waves on the torus; any dims.

    The kernel is K(x, y) = Σ exp(2πi m·(x − y)) over M, the n frequencies of smallest norm.
    Ties between norms are broken lexicographically.
    The set M need not be symmetric, so any count up to 2048 is possible.
    An exact draw takes about n³ log n steps.

    Notes
    -----
    Points are drawn exactly, one after another, each by rejection from uniform proposals.
    See Hough et al., algorithm 18, and Lavancier et al., algorithm 1.
    The process is stationary. Its pair density is n² − |K(x, y)|².
    Its power is n⟨|S_k|²⟩ = 1 − #{(m, m') in M × M: m − m' = k}/n.
    The process is thus hyperuniform, with power ∝ |k|.
    Variances of smooth integrands fall as n^(−1−1/d).

    References
    ----------
    [Hough2006]_, [Lavancier2015]_, [Bardenet2020]_.
    """

    structure: ClassVar[Structure] = Structure.TORUS
    max_dims: ClassVar[int | None] = 64
    max_count: ClassVar[int] = 2**11
    cost_of_more: ClassVar[str] = "the time grows as n³ log n: 4096 points take about a minute"
    dims: int = DEFAULT_DIMS

    def frequencies(self, n: int) -> Array:
        """Return M, the frequencies of the kernel for `n` points: int64 (n, dims)."""
        return nearest_frequencies(self.check_count(n), self.dims)

    def _law(self, n: int) -> Law:
        return Stationary(n=n, dims=self.dims, power=lambda m: self._power(n, m))

    def _power(self, n: int, m: Array) -> Array:
        """Return ⟨|S_m|²⟩ at integer frequencies m (..., d): (1 − s)/n, and 1 at m = 0.

        The kernel has n frequencies k. For a fraction s of these frequencies,
        the sum k + m is also a frequency of the kernel.
        """
        waves = self.frequencies(n)
        flat = np.rint(m).reshape(-1, self.dims).astype(np.int64)
        rows, back = np.unique(flat, axis=0, return_inverse=True)

        # Identify each frequency by one number, a random linear combination of its components
        factors = np.random.default_rng(n).integers(2**63, size=self.dims)
        numbers = np.sort(waves @ factors)
        pairs = np.zeros(len(rows))
        near = np.flatnonzero((np.abs(rows) <= 2 * np.abs(waves).max(axis=0)).all(axis=1))
        for some in np.array_split(near, len(near) * n // _PAIRS + 1):
            moved = numbers + (rows[some] @ factors)[:, None]
            found = numbers[np.minimum(np.searchsorted(numbers, moved), n - 1)]
            pairs[some] = (found == moved).sum(axis=1)
        share = pairs[back.reshape(-1)].reshape(m.shape[:-1]) / n
        return np.asarray((1.0 - share) / n + np.all(m == 0, axis=-1))

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        out = np.empty((count, n, self.dims))
        _fill_determinantal(stream.keys(first, count), self.frequencies(n), out)
        return out


@kernel
def _add_block(re: Array, im: Array, vr: Array, vi: Array, cr: Array, ci: Array) -> float:
    # Project a feature vector onto one block of basis vectors. Write the coefficients to cr and ci,
    # and return the sum of their squared absolute values.
    cr[:] = 0.0
    ci[:] = 0.0
    for k in range(re.size):
        a, b = re[k], im[k]
        for j in range(_BLOCK):
            cr[j] += vr[k, j] * a + vi[k, j] * b
            ci[j] += vr[k, j] * b - vi[k, j] * a
    total = 0.0
    for j in range(_BLOCK):
        total += cr[j] * cr[j] + ci[j] * ci[j]
    return total


@kernel
def _append(re: Array, im: Array, basis: tuple[Array, Array], i: int, cr: Array, ci: Array) -> None:
    # Append the feature vector to the i vectors of the basis, by Gram-Schmidt orthogonalization.
    for block in range((i + _BLOCK - 1) // _BLOCK):
        vr, vi, sr, si = basis[0][block], basis[1][block], cr[block], ci[block]
        for k in range(re.size):
            a, b = 0.0, 0.0
            for j in range(_BLOCK):
                a += sr[j] * vr[k, j] - si[j] * vi[k, j]
                b += sr[j] * vi[k, j] + si[j] * vr[k, j]
            re[k] -= a
            im[k] -= b
    scale = 1.0 / sqrt((re * re + im * im).sum())
    for k in range(re.size):
        re[k] *= scale
        im[k] *= scale
        basis[0][i // _BLOCK, k, i % _BLOCK] = re[k]
        basis[1][i // _BLOCK, k, i % _BLOCK] = im[k]


@kernel
def _draw(k0: np.uint64, k1: np.uint64, m: Array, basis: tuple[Array, Array], out: Array) -> None:
    # Draw one realization by rejection. Proposals that were not rejected are kept for later points.
    # A later point must pass the tests of all earlier points too, so no test has to be repeated.
    n, dims = out.shape
    x, most, within = np.empty((_BATCH, dims)), np.empty(_BATCH), np.empty(_BATCH)
    re, im = np.empty((_BATCH, n)), np.empty((_BATCH, n))
    shape = (_BATCH, (n + _BLOCK - 1) // _BLOCK, _BLOCK)
    cr, ci = np.zeros(shape), np.zeros(shape)
    i, number = 0, 0
    while i < n:
        # Draw random positions x as proposals, and compute their feature vectors exp(2π i m·x)
        for p in range(_BATCH):
            for j in range(dims):
                x[p, j] = mix_uniform(k0, k1, number + j)
            most[p] = n * mix_uniform(k0, k1, number + dims)
            number += dims + 1
            for k in range(n):
                phase = 0.0
                for j in range(dims):
                    phase += m[k, j] * x[p, j]
                re[p, k] = cos(2.0 * pi * phase)
                im[p, k] = sin(2.0 * pi * phase)

        # Project the feature vectors of the proposals onto the basis.
        # Reject a proposal p if the squared norm of its projection reaches its random limit most[p]
        within[:] = 0.0
        for block in range((i + _BLOCK - 1) // _BLOCK):
            vr, vi = basis[0][block], basis[1][block]
            for p in range(_BATCH):
                if within[p] < most[p]:
                    within[p] += _add_block(re[p], im[p], vr, vi, cr[p, block], ci[p, block])

        # Accept the remaining proposals in order. Each accepted point adds a vector to the basis.
        # For each new basis vector, update the projections of the later proposals in the batch.
        for p in range(_BATCH):
            if i == n or within[p] >= most[p]:
                continue
            out[i] = x[p]
            _append(re[p], im[p], basis, i, cr[p], ci[p])
            for q in range(p + 1, _BATCH):
                if within[q] < most[q]:
                    a, b = 0.0, 0.0
                    for k in range(n):
                        a += re[p, k] * re[q, k] + im[p, k] * im[q, k]
                        b += re[p, k] * im[q, k] - im[p, k] * re[q, k]
                    cr[q, i // _BLOCK, i % _BLOCK], ci[q, i // _BLOCK, i % _BLOCK] = a, b
                    within[q] += a * a + b * b
            i += 1


@kernel
def _fill_determinantal(keys: Array, m: Array, out: Array) -> None:
    # Draw R realizations (R, n, d) of the determinantal process with the frequencies m (n, d).
    # After i points, the density of the next point is ‖P φ(x)‖²/(n − i), with feature vector φ(x).
    # The projection P removes the feature vectors of the drawn points.
    # Uniform proposals are rejected with the bound ‖P φ(x)‖² ≤ ‖φ(x)‖² = n.
    n = out.shape[1]
    shape = ((n + _BLOCK - 1) // _BLOCK, n, _BLOCK)
    basis = np.empty(shape), np.empty(shape)
    for r in range(out.shape[0]):
        basis[0][:] = 0.0
        basis[1][:] = 0.0
        _draw(keys[r, 0], keys[r, 1], m, basis, out[r])


def frequencies_within(square: int, dims: int) -> Array:
    """Return integer vectors with |m|² ≤ `square`, in order of |m|², then m: int64 (K, dims)."""
    reach = math.isqrt(square)
    axis = np.arange(-reach, reach + 1)
    found, norms = np.zeros((1, 0), np.int64), np.zeros(1, np.int64)
    for _ in range(dims):
        total = norms[:, None] + axis**2
        row, column = np.nonzero(total <= square)
        found = np.column_stack([found[row], axis[column]])
        norms = total[row, column]
    order = np.argsort(norms, kind="stable")
    return found[order]


def nearest_frequencies(count: int, dims: int) -> Array:
    """Return the `count` integer vectors of smallest norm; ties are broken by the order of m."""
    # Start somewhat below the radius of the ball of volume `count`
    log_volume = 0.5 * dims * math.log(math.pi) - math.lgamma(0.5 * dims + 1)
    square = int(0.8 * math.exp(2.0 / dims * (math.log(count) - log_volume))) if dims <= 3 else 0
    while len(found := frequencies_within(square, dims)) < count:
        square += 1
    nearest: Array = found[:count]
    return nearest


def half_shells(most: int, dims: int) -> Array:
    """Return vectors with 0 < |m|² ≤ K², one per ±m, for the largest K with at most `most` pairs.

    Each pair is represented by the vector whose first nonzero component is positive.
    """
    found = nearest_frequencies(2 * most + 2, dims)
    norms = np.sum(found**2, axis=1)
    inside = found[norms < norms[-1]]  # without the last shell, which may be incomplete
    first = np.argmax(inside != 0, axis=1)
    half: Array = inside[inside[np.arange(len(inside)), first] > 0]
    return half
