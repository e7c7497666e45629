"""Searches for each kind of sampler. A search yields samplers with less and less variance.

Samplers are designed for a class of integrands f, whose members are random functions.
Let P(m) = E|f_m|² be the mean power of the class at the frequency m.
A set that is shifted at random has the variance Σ_{m≠0} P(m) |S_m|².
For a lattice, the variance is the sum of P over the dual lattice.
For digital shifts, the same formulas hold with Walsh coefficients instead of Fourier coefficients.
Let κ be the Walsh series of P.
With a digital shift, the variance is (1/n²) Σ_ij κ(x_i xor x_j).
For a digital net, this variance is the mean of κ over the points.
If sets are folded after the shift, the variance is that of g(x) = f(1 − |2x − 1|), not of f.
The folded function g is continuous on the torus [Hickernell2002]_.
Each search tries plain sets and folded sets, and keeps the kind with less variance.

If sets together contain each cell of a grid exactly once, they need no shift.
*Features* are functions φ_t with Σ_t φ_t(x) φ_t(y) = Cov(f(x), f(y)) at centers of cells.
The mean of φ_t over the points of a set is taken for every feature φ_t, and squared.
The variance is the sum of these squares over t, averaged over the sets.
The search exchanges cells between sets to lower this variance.
Simulated annealing [KirkpatrickEtAl1983]_ lets the search leave local minima.
Exchanges start from random sets, or from the cosets of a digital net if these are better.
All points of a set have the same offset within their cells, except for reflections.
Reflecting the offset in a cell changes the sign of a feature's slope in this cell.
Reflections are chosen so that the slopes cancel.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import CountError
from mcspectra.core.pointfiles import write_points
from mcspectra.core.progress import report
from mcspectra.core.streams import Stream
from mcspectra.estimators.quadrature import grid
from mcspectra.improve.designs import _kernels
from mcspectra.improve.designs.objectives import Objective, Values
from mcspectra.samplers import Sampler, sampler
from mcspectra.samplers.nets import _irreducible, _quotient, _sobol_directions
from mcspectra.samplers.optimised import minimize
from mcspectra.samplers.randomizations import folded
from mcspectra.samplers.stratified import SharedCells, write_cells
from mcspectra.spectra.bases import hadamard

__all__ = ["KINDS", "Design", "SearchSettings", "mean_variances"]

_FOLD = " | mirror(mode='fold')"


@final
@dataclass(frozen=True)
class SearchSettings:
    """Settings of the searches for designs, which are samplers made for a class of integrands.

    Larger numbers make searches longer. Comments give variance ratios for several values.
    A variance ratio is the mean variance of a design divided by that of ``sobol | owen``.
    Unless stated otherwise, ratios are measured with about 64 points in 2-D.
    Ratios are means over 400 integrands of the class ``gaussians`` that the search did not use.
    """

    # Settings of the classes of integrands

    # Maximum number of random integrands (members) that represent a class.
    # The variance ratio of lattices is the same with 512, 1024 and 2048 members.
    members: int = 1024
    # Features of a class (see `features`) are computed from this number of batches of members.
    # The variance ratio of strata designs is 0.019 with one batch, and 0.014 with six batches.
    # If few members of a class cause most of its variance, more batches matter more.
    # For Gaussians of random orientation, point sets have 0.74, 0.54, 0.44 and 0.43 times the
    # variance of a folded lattice with 1, 4, 6 and 12 batches. A batch takes about 8 s.
    batches: int = 6
    # Maximum size of a table with the values of all members of the class at the points of a grid.
    # A table of this size takes 128 MB in single precision.
    table_values: int = 2**25
    # Whether a usual sampler that has less variance is returned instead of the design.
    # If this setting is off, designs of different kinds can be compared with each other.
    return_rival: bool = True
    # Number of points at which all members of the class are evaluated at once.
    # For 1024 members of the class, the values take 64 MB in double precision.
    block: int = 2**13
    # Number of points, and of integrands, with which a search measures the variance of a sampler.
    # Only searches of nets, and of lattices in 3 or more dims, measure the variance of samplers.
    # The variance ratio of nets is 0.167 for half or twice as many points.
    # The variance ratio of nets is 0.164 to 0.167 for half or twice as many members of the class.
    # In 3-D, a search with 128 integrands finds a lattice with the variance ratio 0.313, not 0.295.
    judge_points: int = 2**16
    judge_members: int = 256

    # Settings of lattices

    # Number of points of the table from which the spectrum of a class is estimated.
    # In more than three dims, the number of points of the table is doubled.
    # With half or twice as many points, the variance ratio of lattices is 0.020 to 0.021 in 2-D.
    # In 3-D, the variance ratio of lattices is 0.27 to 0.30 for half or twice as many points.
    frequencies: int = 2**16
    # Number of generating vectors from which the search of lattices starts in 3 or more dims.
    # One generating vector is built axis by axis, and all others are random.
    # In 3-D the variance ratio is 0.295 with 24 or 48 initial vectors.
    # With 96 initial vectors, the variance ratio is 0.274, but the search takes twice as long.
    vectors: int = 48
    # Number of the best generating vectors whose variances are measured at the end of a search.
    # In 3-D the variance ratio is the same for 6 and 24 measured vectors.
    judged: int = 12

    # Settings of nets, and of Owen scramblings (trees)

    # Maximum number of points of a net, or of a set with Owen scrambling.
    # The search for scramblings compares all pairs of points, whose number grows as n².
    most_points: int = 2**12
    # Maximum number of leading bits of a point's coordinates, for all axes together.
    # With 18 bits, the table of Walsh coefficients has 2^18 values for each integrand.
    table_bits: int = 18
    # Number of generator matrices from which the search of nets starts.
    # The first matrices are Sobol' matrices. All others are random scramblings of Sobol' matrices.
    # The variance ratio of nets is the same for 3 and 12 initial matrices.
    net_starts: int = 6
    # Number of Owen scramblings (trees) in a design of kind ``owen``.
    # Errors can be estimated because scramblings give independent point sets.
    # The variance ratio is 0.235 for 32 scramblings, and 0.224 for 64 and 128 scramblings.
    trees: int = 64
    # Number of scramblings that decide whether sets are folded.
    # With 4 and 16 scramblings, the variance ratio is the same.
    first_trees: int = 8

    # Settings of point sets that together fill the cells of a grid.
    # Ratios for `cells`, `features` and `trials` are from searches without annealing

    # Number of cells of the grid. There are cells/n sets of n points, and at least 16 sets.
    # The variance ratio of strata designs is 0.033, 0.031 and 0.033 with 2^15, 2^16 and 2^17 cells.
    cells: int = 2**16
    # Number of features that represent the covariance of the integrands.
    # For n > 160 points, the number of features is n, but at most 320. In 3 or more dims it is 320:
    # features beyond 160 and 320 have 19 and 7 % of the variance of a folded lattice
    # (Gaussians of random orientation, 64 points in 4-D).
    # In 2-D the variance ratio of strata designs is 0.031 for half or twice as many features.
    features: int = 160
    # Number of exchanges of cells between sets that are tried in a round.
    # The time of a search is proportional to the number of exchanges and of rounds.
    # With 2^19, 2^20, 2^21 exchanges, the variance ratio of strata designs is 0.035, 0.031, 0.028.
    trials: int = 2**20
    # Number of rounds of exchanges.
    # Twice as many rounds lower the variance over the members of the search by 22 %,
    # but the variance over other members only by 2 % (Gaussians of random orientation, one batch).
    rounds: int = 48
    # The same in 3 or more dims, where the annealing must be slower. With 320 features, point sets
    # in 4-D have 0.61 times the variance of a folded lattice after 48 rounds, and 0.51 after 240.
    rounds_of_many_dims: int = 192
    # Number of rounds after which the search continues with the best start only.
    # Designs of kind ``points`` for ``half-spaces`` have the variance ratio 0.735
    # with 2, 4 and 8 rounds before the search continues with the best start.
    first_rounds: int = 4
    # Exchanges that increase the error are also accepted at first (annealing).
    # The temperature begins with this fraction of the mean squared error of a set, and falls to 0.
    # The variance ratio of strata designs is 0.025 for 0, and 0.014 for 0.01 and 0.02.
    warmth: float = 0.02
    # Number of rounds at the end that accept only exchanges which lower the error.
    cold_rounds: int = 4
    # Whether the search for sets of cells also starts from the cosets of a digital net.
    # With 64 points in 4-D, a short search from cosets ends with less variance than from random
    # sets (tests/improve/test_design.py).
    cosets: bool = True
    # Number of shapes of strata that are compared, starting with the most even shapes.
    # For each shape, the variance is estimated from `shape_realizations` realizations.
    # A variance from 32 realizations has a relative error of √(2/31) = 25 %.
    # The variances of good and bad shapes of strata differ by more than 25 %.
    shapes: int = 12
    shape_realizations: int = 32

    # Settings of point sets that are optimized on the torus

    # Number of points in the table from which the spectrum is estimated.
    # With more points, each gradient takes more time.
    # For designs of kind ``points`` with n = 5000, the variance ratio is 0.082.
    # With half as many points in the table, the variance ratio is 0.20; with twice as many, 0.078.
    torus_frequencies: int = 2**14


class Design(NamedTuple):
    """A sampler that a search found.

    `variance` is the expected variance, and `done` is the finished fraction of the search.
    `make` returns the sampler. Its argument is the path of a .npz file.
    The file is written only if the sampler has stored sets.
    """

    variance: float
    done: float
    make: Callable[[Path], Sampler]


Search = Callable[[Objective, int, Stream, SearchSettings], Iterator[Design]]


def evaluated(values: Values, x: Array, block: int) -> Array:
    """Evaluate M functions at N points, block by block, in single precision: float32 (M, N)."""
    blocks = [values(x[start : start + block]) for start in range(0, len(x), block)]
    return np.concatenate([block.astype(np.float32) for block in blocks], axis=1)


def mean_variances(values: Values, source: Sampler, n: int, realizations: int, seed: int) -> Array:
    """For each of M functions, return the variance of its mean over n points, (M,)."""
    points = source.draw(n, realizations=realizations, rng=seed)
    found = values(points.reshape(-1, source.dims))
    means = found.reshape(len(found), realizations, n).mean(axis=2)
    return np.asarray(means.var(axis=1, ddof=1))


def _fourier_power(
    values: Values, dims: int, fold: bool, size: int, block: int
) -> tuple[Array, Array]:
    """Return frequencies, int64 (K, d), and 2 E|f_m|², (K,), with the largest values first.

    Of the frequencies m and −m, only one is listed. In up to 3 dims, frequencies form a grid.
    In more dims, a grid would have few frequencies along each axis.
    Functions that are not periodic have most of their power along the axes.
    Therefore all frequencies of a hyperbolic cross are used, and all frequencies of a ball.
    Their coefficients are estimated from values of f at the points of a lattice.
    If the lattice cannot distinguish several frequencies, only the lowest is kept.
    """
    if dims <= 3:
        side = int(size ** (1.0 / dims) + 1e-9)
        x, shape = grid(np.arange(side) / side, dims), (side,) * dims
        along = np.rint(np.fft.fftfreq(side) * side).astype(np.int64)
        m = grid(along, dims)
        found = np.arange(len(m))
    else:
        vector = sampler("korobov", dims).generating_vector(size)  # type: ignore[attr-defined]
        x, shape = np.arange(size)[:, None] * vector % size / size, (size,)
        radius = (size / 4 * math.gamma(dims / 2 + 1)) ** (1 / dims) / math.sqrt(math.pi)
        ball = grid(np.arange(-int(radius), int(radius) + 1), dims)
        for reach in (64, 32, 16, 8, 4, 2):
            m, weight = np.zeros((1, 0), np.int64), np.ones(1)
            along = np.arange(-reach, reach + 1)
            for _ in range(dims):
                products = weight[:, None] * np.maximum(1, np.abs(along))
                row, column = np.nonzero(products <= reach)
                m, weight = np.column_stack([m[row], along[column]]), products[row, column]
            if len(m) <= size // 2:
                break
        lengths = (ball**2).sum(axis=1) ** (dims / 2) / radius**dims
        m = np.concatenate([m, ball[lengths <= 1.0]])
        weight = np.concatenate([weight / reach, lengths[lengths <= 1.0]])
        m = m[np.argsort(weight, kind="stable")]
        found, first = np.unique(m @ vector % size, return_index=True)
        m = m[first]
    table = evaluated(values, folded(x) if fold else x, block)

    # Transform two functions g and h at once, by the transform F of g + ih:
    # |F(m)|² + |F(−m)|² = 2 |g_m|² + 2 |h_m|²
    power = np.zeros(shape)
    for k in range(0, len(table), 2):
        second = table[k + 1] if k + 1 < len(table) else 0.0
        power += np.abs(np.fft.fftn((table[k] + 1j * second).reshape(shape))) ** 2
    power += np.roll(np.flip(power), 1, axis=tuple(range(power.ndim)))
    power = power.reshape(-1)[found] / float(len(x)) ** 2
    leading = m[np.arange(len(m)), (m != 0).argmax(axis=1)]
    kept = np.flatnonzero(leading > 0)
    kept = kept[np.argsort(-power[kept], kind="stable")]
    return np.ascontiguousarray(m[kept]), power[kept]


def _best_vector(
    m: Array, power: Array, dims: int, n: int, generator: np.random.Generator, starts: int
) -> Iterator[tuple[float, Array]]:
    """Yield generating vectors of lattices with small power on the dual lattice.

    In 2-D, all generating vectors are tried. In more dims, they are improved axis by axis.
    """
    sums = np.empty(n)
    for start in range(starts if dims > 2 else 1):
        vector = np.ones(dims, np.int64)
        if start:
            vector[1:] = generator.integers(1, max(n, 2), dims - 1)
        best = math.inf
        for sweep in range(6):
            for axis in range(1, dims):
                seen = np.ones(len(m), bool)
                # The first sweep chooses one component of the vector after another.
                # Frequencies with nonzero entries along later axes are ignored in this sweep
                if start == sweep == 0:
                    seen = (m[:, axis + 1 :] == 0).all(axis=1)
                _kernels.best_multiple(m[seen], power[seen], vector, axis, n, sums)
                vector[axis] = sums.argmin()
            value = float(sums.min()) if dims > 1 else float(power[m[:, 0] % n == 0].sum())
            if value >= best * (1.0 - 1e-9):
                break
            best = value
        yield best, vector.copy()


def _judge(
    objective: Objective, n: int, stream: Stream, settings: SearchSettings
) -> Callable[[Sampler], float]:
    """Return a function that measures all samplers with the same integrands and random numbers."""
    values = objective.functions(settings.judge_members, stream.generator(4))
    sets, seed = max(2, min(64, settings.judge_points // n)), stream.child(4).key
    return lambda made: float(mean_variances(values, made, n, sets, seed).sum())


def _lattices(
    objective: Objective, n: int, stream: Stream, settings: SearchSettings
) -> Iterator[Design]:
    plane, judge = objective.dims <= 2, _judge(objective, n, stream, settings)
    size = settings.frequencies if objective.dims <= 3 else 2 * settings.frequencies
    members = min(settings.members, settings.table_values // size)
    values = objective.functions(members, stream.generator(0))

    def made_of(vector: Array, fold: bool) -> Sampler:
        text = f"rank1-lattice(vector={vector.tolist()}) | shift{_FOLD if fold else ''}"
        return sampler(text, objective.dims)

    for fold in (False, True):
        m, power = _fourier_power(values, objective.dims, fold, size, settings.block)
        most = max(2**12, 2**27 // n)
        found = list[tuple[float, Array]]()
        for value, vector in _best_vector(
            m[:most], power[:most], objective.dims, n, stream.generator(1), settings.vectors
        ):
            if not found:  # Yield a first result, because the search may be interrupted
                yield Design(math.inf, fold / 2, partial(_as_made, made_of(vector, fold)))
            found.append((value, vector))
            report("lattice", (fold + len(found) / settings.vectors) / 2)
        kept = 1 if plane else settings.judged
        for value, vector in sorted(found, key=lambda each: each[0])[:kept]:
            made = made_of(vector, fold)
            if not plane:  # the table of frequencies may lack important frequencies
                value = judge(made)
            yield Design(value, (fold + 1) / 2, partial(_as_made, made))


def _as_made(made: Sampler, path: Path) -> Sampler:
    del path
    return made


def _power_of_two(n: int, kind: str, most: int) -> int:
    m = n.bit_length() - 1
    if n != 1 << m or not 2 <= n <= most:
        above = min(max(2, 1 << m + 1), most)
        raise CountError(
            f"A design of kind {kind!r} cannot have {n} points; give a power of two from 2 to "
            f"{most}, e.g. {above}.",
            (above,),
        )
    return m


def _axis_bits(n: int, dims: int, most: int) -> int:
    """Return how many bits of each coordinate are used: log2 n + 2, or fewer in many dims."""
    return max(1, min(most // dims, n.bit_length() + 1))


def _tables(
    objective: Objective, bits: int, stream: Stream, settings: SearchSettings, *, owen: bool
) -> Iterator[tuple[str, Array]]:
    """Yield randomizations of nets, each with a table of its kernel κ.

    The code of a point consists of the leading bits of its coordinates.
    For two points with the codes a and b, κ is the entry a xor b of the table.
    """
    dims = objective.dims
    members = min(settings.members, settings.table_values >> dims * bits)
    values = objective.functions(members, stream.generator(0))
    for fold in (False, True):
        # Compute E|f_m|² for Walsh functions of the bits of all axes, (2^(d bits),).
        # The value at m = 0 is 0
        x = grid((np.arange(1 << bits) + 0.5) / (1 << bits), dims)
        table, power = evaluated(values, folded(x) if fold else x, settings.block), np.zeros(len(x))
        for start in range(0, len(table), 16):
            rows = hadamard(table[start : start + 16])
            power += (rows.astype(np.float64) ** 2).sum(axis=0)
        power[0], tail = 0.0, _FOLD if fold else ""
        power = power / float(len(x)) ** 2
        yield f" | digital-shift{tail}", hadamard(power)
        # For Owen scrambling, average the power over groups of Walsh functions.
        # On each axis, the Walsh indices of a group have their last nonzero digit at the same place
        if owen:
            codes = np.arange(len(power))
            level = np.zeros(len(power), np.int64)
            for axis in range(dims):
                digits = codes >> axis * bits & (1 << bits) - 1
                last = np.where(digits, bits - np.log2(np.maximum(digits & -digits, 1)), 0)
                level = level * (bits + 1) + last.astype(np.int64)
            means = np.bincount(level, power) / np.maximum(np.bincount(level), 1)
            yield f" | owen{tail}", hadamard(means[level])


def _nets(
    objective: Objective,
    n: int,
    stream: Stream,
    settings: SearchSettings,
    *,
    polynomial: bool,
    frames: int | None = None,
) -> Iterator[Design]:
    dims, bits = objective.dims, _axis_bits(n, objective.dims, settings.table_bits)
    m = _power_of_two(
        n, "polynomial-lattice" if polynomial else "digital-net", settings.most_points
    )
    rows, modulus = max(m, bits), next(p for p in _irreducible() if p.bit_length() == m + 1)
    span = np.empty(n, np.int64)
    sobol = (_sobol_directions()[:dims, :m] >> np.uint32(32 - rows)).astype(np.int64)

    def code(columns: Array) -> Array:
        """Combine the digits of each column into one integer. The columns (d, m) are int64.

        The integer of a column contains the leading bits of this column on all axes.
        """
        top = columns >> rows - bits
        return np.asarray(sum(top[j] << (dims - 1 - j) * bits for j in range(dims)))

    def hankel(q: int) -> Array:
        """Return columns of a generator matrix, from the binary digits of q / modulus."""
        series = _quotient(q << (rows + m), modulus)
        return np.array([series >> m - c & (1 << rows) - 1 for c in range(m)])

    judge = _judge(objective, n, stream, settings)
    tables = list(itertools.islice(_tables(objective, bits, stream, settings, owen=True), frames))
    for frame, (tail, table) in enumerate(tables):
        generator = stream.generator(1)
        for start in range(settings.net_starts):
            if polynomial:
                q = np.concatenate([[1], generator.integers(1, n, dims - 1)])
                best, columns = math.inf, np.stack([hankel(int(x)) for x in q])
                for _, axis in itertools.product(range(3), range(1, dims)):
                    for x in range(1, n):
                        trial = columns.copy()
                        trial[axis] = hankel(x)
                        value = _kernels.span_mean(table, code(trial), span)
                        if value < best * (1.0 - 1e-9):
                            best, columns = value, trial
            else:
                columns = sobol.copy()
                # To each row of a matrix, add a random sum of the rows above it.
                # These additions do not change the quality parameter t of the net
                if start > 1:
                    for j, r in itertools.product(range(dims), range(1, rows)):
                        mixed = columns[j] >> rows - r & generator.integers(0, 1 << r)
                        columns[j] ^= (np.bitwise_count(mixed) & 1).astype(np.int64) << rows - 1 - r
                if start:  # The first net remains the Sobol' net
                    flat = code(columns)
                    _kernels.improve_code(table, flat, dims * bits, span)
                    for j in range(dims):
                        top = flat >> (dims - 1 - j) * bits & (1 << bits) - 1
                        columns[j] = top << rows - bits | columns[j] & (1 << rows - bits) - 1
            text = f"digital-net(matrices={columns.tolist()}, digits={rows}){tail}"
            made = sampler(text, dims)
            done = (frame + (start + 1) / settings.net_starts) / len(tables)
            yield Design(judge(made), done, partial(_as_made, made))


def _trees(
    objective: Objective, n: int, stream: Stream, settings: SearchSettings
) -> Iterator[Design]:
    _power_of_two(n, "owen", settings.most_points)
    dims, bits = objective.dims, _axis_bits(n, objective.dims, settings.table_bits)
    trees, tried = settings.trees, settings.first_trees
    starts = sampler("sobol | owen", dims).draw_stream(n, stream.child(1), 0, trees)
    places = (dims - 1 - np.arange(dims)) * bits

    def flipped(table: Array, first: int, last: int) -> tuple[float, Array]:
        """Improve Owen scramblings (trees); return their mean variance and their point sets."""
        codes = ((starts[first:last] * 2.0**bits).astype(np.int64) << places).sum(axis=2)
        energy = 0.0
        for tree in codes:
            while _kernels.flip_tree(table, tree, dims, bits):
                pass
            energy += float(table[tree[:, None] ^ tree].mean()) / len(codes)
        top = codes[..., None] >> places & (1 << bits) - 1
        return energy, (top + starts[first:last] * 2.0**bits % 1.0) / 2.0**bits

    # Choose the randomization with the least mean variance over the first `tried` scramblings.
    # Then report the mean variance over all scramblings
    frames = list(_tables(objective, bits, stream, settings, owen=False))
    begun = [(*flipped(table, 0, tried), tail, table) for tail, table in frames]
    energy, sets, tail, table = min(begun, key=lambda each: each[0])
    yield Design(math.inf, tried / trees, partial(_of_sets, sets, tail))
    for first in range(tried, trees, tried):
        value, more = flipped(table, first, first + tried)
        energy, sets = energy + value, np.concatenate([sets, more])
        report("owen", len(sets) / trees)
    yield Design(energy * tried / trees, 1.0, partial(_of_sets, sets, tail))


def _of_sets(sets: Array, tail: str, path: Path) -> Sampler:
    write_points(path, list(sets))
    return sampler(f"points(path={str(path)!r}, cycle=True){tail}", sets.shape[2])


def _shapes(n: int, dims: int) -> list[tuple[int, ...]]:
    """Return all ordered products of `dims` numbers that equal n, the most even first."""
    found: list[tuple[int, ...]] = [(n,)] if dims == 1 else []
    if dims > 1:
        divisors = (k for k in range(1, n + 1) if n % k == 0)
        found = [(k, *rest) for k in divisors for rest in _shapes(n // k, dims - 1)]
    return sorted(found, key=lambda shape: sum(np.log(shape) ** 2))


def _shared(
    objective: Objective, n: int, stream: Stream, settings: SearchSettings, *, free: bool
) -> Iterator[Design]:
    dims, most = objective.dims, settings.cells // 16
    if n > most:
        raise CountError(
            f"Sets that share a grid have at most {most} points, not {n}; give fewer, or use "
            "kind='lattice'.",
            (most,),
        )
    # A set of n points can make the means of about n features nearly 0.
    # About n integrands of the class are enough to compute n features
    members = min(2 * settings.members, max(settings.members, 8 * n))
    values = objective.functions(members, stream.generator(0))

    # Choose the shape of strata whose jittered points have the least variance
    def jittered(shape: tuple[int, ...]) -> float:
        corners, sets = (
            np.stack(np.unravel_index(np.arange(n), shape), axis=-1),
            settings.shape_realizations,
        )
        x = (corners + stream.uniforms(0, sets, n * dims).reshape(-1, n, dims)) / shape
        found = values(x.reshape(-1, dims)).reshape(-1, sets, n)
        return float(found.mean(axis=2).var(axis=1).sum())

    shape = np.array(min(_shapes(n, dims)[: settings.shapes], key=jittered))
    wanted = np.full(dims, settings.cells ** (1.0 / dims))
    if free and n & (n - 1) == 0:  # Cosets of a net require grids with powers of two as sides
        wanted = 2.0 ** ((settings.cells.bit_length() + dims - 2 - np.arange(dims)) // dims)
    parts = np.maximum(1, np.rint(wanted / shape)).astype(np.int64)
    sides, sets = shape * parts, int(parts.prod())
    cells = np.stack(np.unravel_index(np.arange(sides.prod()), sides), axis=-1)

    # Compute features: linear combinations of the integrands with the largest variances.
    # Each batch of integrands is combined with the features of the batches before it
    batches = settings.batches if objective.whole is None else 1
    most = 2 * settings.features
    if dims < 3:
        most = min(max(settings.features, n), most)
    table = np.empty((0, len(cells)), np.float32)
    for batch in range(batches):
        if batch:
            values = objective.functions(members, stream.child(6).generator(batch))
        added = evaluated(values, (cells + 0.5) / sides, settings.block) * batches**-0.5
        added -= added.mean(axis=1, keepdims=True)
        table = np.concatenate([table, added.astype(np.float32)])
        sizes, turned = np.linalg.eigh((table @ table.T).astype(np.float64))
        count = most if batch + 1 == batches else 2 * most
        kept = np.argsort(-sizes)[:count]
        kept = kept[sizes[kept] > 1e-9 * sizes.max()]
        table = turned[:, kept].T.astype(np.float32) @ table
        report("features of the class", (batch + 1) / batches)
    features = np.ascontiguousarray(table.T)
    del table, added
    features = np.pad(
        features, ((0, 0), (0, -features.shape[1] % 16))
    )  # `swap_cells` adds 16 at once

    # Each set starts with one random cell of each stratum, or with a coset of a net
    place = np.ravel_multi_index(tuple((cells // parts).T), tuple(shape))
    order = np.lexsort((stream.generator(1).random(len(cells)), place))
    owner = np.empty(len(cells), np.int64)
    owner[order] = np.tile(np.arange(sets), n)
    yield Design(math.inf, 0.0, partial(_of_cells, features, owner.copy(), cells, sides))
    begun = [owner]
    if free and settings.cosets:
        cosets = _cosets(objective, n, sides, stream, settings)
        begun += [] if cosets is None else [cosets]
    rounds = settings.rounds if dims < 3 else settings.rounds_of_many_dims
    keys = stream.child(2).keys(0, rounds)

    def variance_of(sums: Array) -> float:
        return float((sums.astype(np.float64) ** 2).sum()) / (sets * n**2)

    def exchanged(owner: Array, sums: Array, turn: int, warmth: float = 0.0) -> float:
        """Exchange cells for one round, and return the new variance."""
        temperature = warmth * n**2 * variance_of(sums)
        _kernels.swap_cells(
            features, owner, place, sums, sides, free, keys[turn], settings.trials, temperature
        )
        return variance_of(sums)

    # Continue with the start that has the least variance after some rounds
    tried, first = [], settings.first_rounds
    for owner in begun:
        sums = np.zeros((sets, features.shape[1]), np.float32)
        np.add.at(sums, owner, features)
        variance = min(exchanged(owner, sums, turn) for turn in range(first))
        tried.append((variance, owner, sums))
    _, owner, sums = min(tried, key=lambda each: each[0])
    # The temperature falls linearly, and is 0 in the last rounds
    cooled = rounds - settings.cold_rounds
    for turn in range(first, rounds):
        warmth = settings.warmth * max(0.0, (cooled - turn) / max(1, cooled - first))
        variance = exchanged(owner, sums, turn, warmth)
        cells_of = partial(_of_cells, features, owner.copy(), cells, sides)
        yield Design(variance, (turn + 1) / rounds, cells_of)


def _cosets(
    objective: Objective, n: int, sides: Array, stream: Stream, settings: SearchSettings
) -> Array | None:
    """Return for each cell the index of the coset of a digital net that contains the cell, (N,).

    The numbers of cells along the axes, `sides`, are powers of two.
    """
    if n < 4 or (np.append(sides, n) & np.append(sides, n) - 1).any():
        return None
    nets = _nets(objective, n, stream, settings, polynomial=False, frames=1)
    spec = min(nets, key=lambda c: c.variance).make(Path()).spec
    points = sampler(spec.partition(" | ")[0], len(sides)).draw(n)[0]
    codes = np.ravel_multi_index(tuple((points * sides).astype(np.int64).T), tuple(sides))
    if len(np.unique(codes)) < n:
        return None

    # The codes of the net's cells are all exclusive ors of a few basis vectors.
    # In the codes of all cells, clear the leading bit of each basis vector by an exclusive or.
    # The modified codes of two cells are equal if both cells are in the same coset of the net
    rest, left = np.arange(sides.prod()), codes
    while left.max() > 0:
        vector = left.max()
        left, rest = (np.minimum(c, c ^ vector) for c in (left, rest))
    return np.unique(rest, return_inverse=True)[1]


def _of_cells(features: Array, owner: Array, cells: Array, sides: Array, path: Path) -> Sampler:
    """Make a sampler from sets of cells, and choose in which cells the offset is reflected.

    Reflections are chosen so that the slopes of the features nearly cancel in each set.
    """
    sets = np.argsort(owner, kind="stable").reshape(owner.max() + 1, -1)
    signed = cells[sets] + 1
    table = features.reshape(*sides, -1)
    for axis, side in enumerate(sides):
        signs = np.ones(sets.shape, np.int64)
        if side > 1:
            slopes = np.gradient(table, axis=axis).reshape(features.shape)
            _kernels.reflect(slopes, sets, signs)
        signed[..., axis] *= signs
    write_cells(path, signed)
    return SharedCells(path=str(path))


def _points(
    objective: Objective, n: int, stream: Stream, settings: SearchSettings
) -> Iterator[Design]:
    """Search sets that fill the cells of a grid. In 1 to 3 dims, also optimize a set directly."""
    dims = objective.dims
    if n <= settings.cells // 16 or dims > 3:
        for found in _shared(objective, n, stream, settings, free=True):
            yield found._replace(done=0.8 * found.done)
    if dims > 3:
        return
    values = objective.functions(settings.members, stream.generator(0))
    for fold in (False, True):
        m, power = _fourier_power(values, dims, fold, settings.torus_frequencies, settings.block)
        ((value, vector),) = itertools.islice(
            _best_vector(m[: 2**14], power[: 2**14], dims, n, stream.generator(1), 1), 1
        )
        lattice = np.arange(n)[:, None] * vector % n / n
        moved = lattice + 0.02 / n ** (1 / dims) * stream.generator(2).standard_normal((n, dims))
        function = _energy(m, power, dims)
        for start in (moved, stream.generator(3).random((n, dims)))[: 1 if n > 256 else 2]:
            found_set = minimize(function, start, iterations=60, longest=0.2 / n ** (1 / dims))
            value = function(found_set)[0]
            tail = f" | shift{_FOLD if fold else ''}"
            sets = np.remainder(found_set, 1.0)[None] % 1.0
            yield Design(value, 0.9 + 0.1 * fold, partial(_of_sets, sets, tail))


def _energy(m: Array, power: Array, dims: int) -> Callable[[Array], tuple[float, Array]]:
    """Return a function that computes Σ_m P(m) |S_m|² and its gradient by transforms."""
    import finufft

    side = 2 * int(np.abs(m).max()) + 1
    weights = np.zeros((side,) * dims)
    for sign in (1, -1):
        weights[tuple((sign * m + side // 2).T)] = 0.5 * power
    along = np.arange(side) - side // 2
    # With the tolerance 1e-9, the energy agrees with a direct sum to 1e-8 (`test_design.py`)
    options = {"eps": 1e-9, "isign": -1, "nthreads": 1, "upsampfac": 1.25}
    forward, backward = (finufft.Plan(kind, weights.shape, **options) for kind in (1, 2))

    def function(points: Array) -> tuple[float, Array]:
        n = len(points)
        axes = [np.ascontiguousarray(2.0 * np.pi * np.remainder(x, 1.0)) for x in points.T]
        for plan in (forward, backward):
            plan.setpts(*axes)
        s = forward.execute(np.ones(n, np.complex128)) / n
        gradient = np.empty(points.shape)
        for j in range(dims):
            slope = along.reshape([-1 if i == j else 1 for i in range(dims)])
            coefficients = weights * s.conj() * (-4j * np.pi / n) * slope
            gradient[:, j] = backward.execute(coefficients).real
        return float((weights * np.abs(s) ** 2).sum()), gradient

    return function


KINDS: dict[str, Search] = {
    "lattice": _lattices,
    "polynomial-lattice": partial(_nets, polynomial=True),
    "digital-net": partial(_nets, polynomial=False),
    "owen": _trees,
    "strata": partial(_shared, free=False),
    "points": _points,
}
"""Kinds of samplers, each with its search."""
