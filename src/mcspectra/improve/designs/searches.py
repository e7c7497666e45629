"""Searches, one for each kind of sampler: each yields better and better ones.

A set that is shifted at random has the variance Σ_{m≠0} P(m) |S_m|², P(m) = E|f_m|² of the class: for a
lattice the sum of P over its dual lattice. Under a digital shift it is the same in the Walsh basis, or
(1/n²) Σ_ij κ(x_i xor x_j), κ the Walsh series of P; for a digital net the mean of κ over its points
alone. Both hold for g(x) = f(1 − |2x − 1|), too, for sets that are folded after the shift, whose
functions are continuous on the torus [Hickernell2002]_; each search takes what is better.

Sets that share out the cells of a grid need no shift. With features φ_t, Σ_t φ_t(x) φ_t(y) =
Cov(f(x), f(y)) at the centres of cells, their variance is the mean over sets of Σ_t (mean φ_t)²,
which exchanges of cells between sets lower, from the cosets of a designed digital net where that is a
better start than random sets. What is left are offsets within cells, alike in a set but for
reflections: these are chosen so that the sum of the signed slopes is small.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

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

__all__ = ["KINDS", "Design", "mean_variances"]

_MOST = 2**12  # points of nets and trees
_BITS = 18  # of the codes of all axes together, at most
_FREQUENCIES = 2**16  # points of a table of them
_MEMBERS, _VALUES = 1024, 2**25  # members at most, and values of a table of them
_BLOCK = 2**13  # points at once
_STARTS, _VECTORS, _JUDGED = 6, 48, 12  # of nets; of lattices in many dims, and those measured
_TREES, _TRIED = 64, 8
_MEASURED, _JUDGES = 2**16, 256  # points and members that samplers are measured with
_TORUS = 2**14  # frequencies of sets on the torus
_CELLS = 2**16
_FEATURES = 160
_TRIALS = 2**20
_FIRST_ROUNDS, _ROUNDS, _LEAST_GAIN = 4, 24, 0.003
_SHAPES, _REALIZATIONS = 12, 32
_FOLD = " | mirror(mode='fold')"


class Design(NamedTuple):
    """A sampler that was found: its expected variance, the share of the search done, and its maker.

    `make` is given the path of a .npz file, which it writes where the sampler needs one.
    """

    variance: float
    done: float
    make: Callable[[Path], Sampler]


Search = Callable[[Objective, int, Stream], Iterator[Design]]


def evaluated(values: Values, x: Array) -> Array:
    """Values in single precision, by blocks of points: float32 (M, N)."""
    blocks = [values(x[start : start + _BLOCK]) for start in range(0, len(x), _BLOCK)]
    return np.concatenate([block.astype(np.float32) for block in blocks], axis=1)


def mean_variances(values: Values, source: Sampler, n: int, realizations: int, seed: int) -> Array:
    """Variance over realisations of the mean of each function: (M,)."""
    points = source.draw(n, realizations=realizations, rng=seed)
    found = values(points.reshape(-1, source.dims))
    means = found.reshape(len(found), realizations, n).mean(axis=2)
    return np.asarray(means.var(axis=1, ddof=1))


def _fourier_power(values: Values, dims: int, fold: bool, size: int) -> tuple[Array, Array]:
    """Frequencies m, one of each m and −m, and 2 E|f_m|², the strongest first: int64 (K, d), (K,).

    Up to 3 dims from a grid. In more dims a grid has few frequencies along an axis, where functions that are not
    periodic have theirs: there from a lattice, frequencies of a hyperbolic cross and of a ball, the
    lowest of those that the lattice cannot tell apart.
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
    table = evaluated(values, folded(x) if fold else x)

    # Two functions a transform: |F(m)|² + |F(−m)|² of g + ih is 2 |g_m|² + 2 |h_m|²
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
    m: Array, power: Array, dims: int, n: int, generator: np.random.Generator
) -> Iterator[tuple[float, Array]]:
    """Vectors of small dual sums: all in 2-D; else axis after axis, then again while it helps."""
    sums = np.empty(n)
    for start in range(_VECTORS if dims > 2 else 1):
        vector = np.ones(dims, np.int64)
        if start:
            vector[1:] = generator.integers(1, max(n, 2), dims - 1)
        best = math.inf
        for sweep in range(6):
            for axis in range(1, dims):
                seen = np.ones(len(m), bool)
                if start == sweep == 0:  # components that there are so far
                    seen = (m[:, axis + 1 :] == 0).all(axis=1)
                _kernels.best_multiple(m[seen], power[seen], vector, axis, n, sums)
                vector[axis] = sums.argmin()
            value = float(sums.min()) if dims > 1 else float(power[m[:, 0] % n == 0].sum())
            if value >= best * (1.0 - 1e-9):
                break
            best = value
        yield best, vector.copy()


def _judge(objective: Objective, n: int, stream: Stream) -> Callable[[Sampler], float]:
    """Measures samplers with members and random numbers that are the same for all."""
    values = objective.functions(_JUDGES, stream.generator(4))
    sets, seed = max(2, min(64, _MEASURED // n)), stream.child(4).key
    return lambda made: float(mean_variances(values, made, n, sets, seed).sum())


def _lattices(objective: Objective, n: int, stream: Stream) -> Iterator[Design]:
    plane, judge = objective.dims <= 2, _judge(objective, n, stream)
    size = _FREQUENCIES if objective.dims <= 3 else 2 * _FREQUENCIES
    values = objective.functions(min(_MEMBERS, _VALUES // size), stream.generator(0))

    def made_of(vector: Array, fold: bool) -> Sampler:
        text = f"rank1-lattice(vector={vector.tolist()}) | shift{_FOLD if fold else ''}"
        return sampler(text, objective.dims)

    for fold in (False, True):
        m, power = _fourier_power(values, objective.dims, fold, size)
        most = max(2**12, 2**27 // n)
        found = list[tuple[float, Array]]()
        for value, vector in _best_vector(
            m[:most], power[:most], objective.dims, n, stream.generator(1)
        ):
            if not found:  # what there is if the search is interrupted
                yield Design(math.inf, fold / 2, partial(_as_made, made_of(vector, fold)))
            found.append((value, vector))
            report("lattice", (fold + len(found) / _VECTORS) / 2)
        for value, vector in sorted(found, key=lambda each: each[0])[: 1 if plane else _JUDGED]:
            made = made_of(vector, fold)
            if not plane:  # frequencies that are not counted may be those that matter
                value = judge(made)
            yield Design(value, (fold + 1) / 2, partial(_as_made, made))


def _as_made(made: Sampler, path: Path) -> Sampler:
    del path
    return made


def _power_of_two(n: int, kind: str) -> int:
    m = n.bit_length() - 1
    if n != 1 << m or not 2 <= n <= _MOST:
        above = min(max(2, 1 << m + 1), _MOST)
        raise CountError(
            f"A design of kind {kind!r} cannot have {n} points; give a power of two from 2 to {_MOST}, "
            f"e.g. {above}.",
            (above,),
        )
    return m


def _axis_bits(n: int, dims: int) -> int:
    """Digits of each axis that tables know: two more than the points need."""
    return max(1, min(_BITS // dims, n.bit_length() + 1))


def _tables(
    objective: Objective, bits: int, stream: Stream, *, owen: bool
) -> Iterator[tuple[str, Array]]:
    """Randomisations, and the kernel κ of each over codes."""
    dims = objective.dims
    members = min(_MEMBERS, _VALUES >> dims * bits)
    values = objective.functions(members, stream.generator(0))
    for fold in (False, True):
        # E|f_m|² of Walsh functions of all axes' bits together, 0 at m = 0: (2^(d bits),)
        x = grid((np.arange(1 << bits) + 0.5) / (1 << bits), dims)
        table, power = evaluated(values, folded(x) if fold else x), np.zeros(len(x))
        for start in range(0, len(table), 16):
            rows = hadamard(table[start : start + 16])
            power += (rows.astype(np.float64) ** 2).sum(axis=0)
        power[0], tail = 0.0, _FOLD if fold else ""
        power = power / float(len(x)) ** 2
        yield f" | digital-shift{tail}", hadamard(power)
        if owen:  # power is the same within levels: those of the last digit that counts
            codes = np.arange(len(power))
            level = np.zeros(len(power), np.int64)
            for axis in range(dims):
                digits = codes >> axis * bits & (1 << bits) - 1
                last = np.where(digits, bits - np.log2(np.maximum(digits & -digits, 1)), 0)
                level = level * (bits + 1) + last.astype(np.int64)
            means = np.bincount(level, power) / np.maximum(np.bincount(level), 1)
            yield f" | owen{tail}", hadamard(means[level])


def _nets(
    objective: Objective, n: int, stream: Stream, *, polynomial: bool, frames: int | None = None
) -> Iterator[Design]:
    dims, bits = objective.dims, _axis_bits(n, objective.dims)
    m = _power_of_two(n, "polynomial-lattice" if polynomial else "digital-net")
    rows, modulus = max(m, bits), next(p for p in _irreducible() if p.bit_length() == m + 1)
    span = np.empty(n, np.int64)
    sobol = (_sobol_directions()[:dims, :m] >> np.uint32(32 - rows)).astype(np.int64)

    def code(columns: Array) -> Array:
        """Columns int64 (d, m) of `rows` digits as the first bits of all axes."""
        top = columns >> rows - bits
        return np.asarray(sum(top[j] << (dims - 1 - j) * bits for j in range(dims)))

    def hankel(q: int) -> Array:
        """Columns of the matrix of q / modulus."""
        series = _quotient(q << (rows + m), modulus)
        return np.array([series >> m - c & (1 << rows) - 1 for c in range(m)])

    judge = _judge(objective, n, stream)
    tables = list(itertools.islice(_tables(objective, bits, stream, owen=True), frames))
    for frame, (tail, table) in enumerate(tables):
        generator = stream.generator(1)
        for start in range(_STARTS):
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
                if start > 1:  # other matrices of the same strength: add higher rows to lower ones
                    for j, r in itertools.product(range(dims), range(1, rows)):
                        mixed = columns[j] >> rows - r & generator.integers(0, 1 << r)
                        columns[j] ^= (np.bitwise_count(mixed) & 1).astype(np.int64) << rows - 1 - r
                if start:  # the first candidate is Sobol' itself
                    flat = code(columns)
                    _kernels.improve_code(table, flat, dims * bits, span)
                    for j in range(dims):
                        top = flat >> (dims - 1 - j) * bits & (1 << bits) - 1
                        columns[j] = top << rows - bits | columns[j] & (1 << rows - bits) - 1
            text = f"digital-net(matrices={columns.tolist()}, digits={rows}){tail}"
            made = sampler(text, dims)
            done = (frame + (start + 1) / _STARTS) / len(tables)
            yield Design(judge(made), done, partial(_as_made, made))


def _trees(objective: Objective, n: int, stream: Stream) -> Iterator[Design]:
    _power_of_two(n, "owen")
    dims, bits = objective.dims, _axis_bits(n, objective.dims)
    starts = sampler("sobol | owen", dims).draw_stream(n, stream.child(1), 0, _TREES)
    places = (dims - 1 - np.arange(dims)) * bits

    def flipped(table: Array, first: int, last: int) -> tuple[float, Array]:
        """The mean variance of some trees, and their sets."""
        codes = ((starts[first:last] * 2.0**bits).astype(np.int64) << places).sum(axis=2)
        energy = 0.0
        for tree in codes:
            while _kernels.flip_tree(table, tree, dims, bits):
                pass
            energy += float(table[tree[:, None] ^ tree].mean()) / len(codes)
        top = codes[..., None] >> places & (1 << bits) - 1
        return energy, (top + starts[first:last] * 2.0**bits % 1.0) / 2.0**bits

    # The better randomisation by the first trees; all of them count, once they are there
    frames = list(_tables(objective, bits, stream, owen=False))
    begun = [(*flipped(table, 0, _TRIED), tail, table) for tail, table in frames]
    energy, sets, tail, table = min(begun, key=lambda each: each[0])
    yield Design(math.inf, _TRIED / _TREES, partial(_of_sets, sets, tail))
    for first in range(_TRIED, _TREES, _TRIED):
        value, more = flipped(table, first, first + _TRIED)
        energy, sets = energy + value, np.concatenate([sets, more])
        report("owen", len(sets) / _TREES)
    yield Design(energy * _TRIED / _TREES, 1.0, partial(_of_sets, sets, tail))


def _of_sets(sets: Array, tail: str, path: Path) -> Sampler:
    write_points(path, list(sets))
    return sampler(f"points(path={str(path)!r}, cycle=True){tail}", sets.shape[2])


def _shapes(n: int, dims: int) -> list[tuple[int, ...]]:
    """Ways to write n as a product of `dims` numbers in order, the most even ones first."""
    found: list[tuple[int, ...]] = [(n,)] if dims == 1 else []
    if dims > 1:
        divisors = (k for k in range(1, n + 1) if n % k == 0)
        found = [(k, *rest) for k in divisors for rest in _shapes(n // k, dims - 1)]
    return sorted(found, key=lambda shape: sum(np.log(shape) ** 2))


def _shared(objective: Objective, n: int, stream: Stream, *, free: bool) -> Iterator[Design]:
    dims = objective.dims
    if n > _CELLS // 16:
        raise CountError(
            f"Sets that share a grid have at most {_CELLS // 16} points, not {n}; give fewer, or use "
            "kind='lattice'.",
            (_CELLS // 16,),
        )
    members = min(2 * _MEMBERS, max(_MEMBERS, 8 * n))  # n points can do justice to some n features
    values = objective.functions(members, stream.generator(0))

    # The shape of strata with the least variance by themselves
    def jittered(shape: tuple[int, ...]) -> float:
        corners = np.stack(np.unravel_index(np.arange(n), shape), axis=-1)
        x = (corners + stream.uniforms(0, _REALIZATIONS, n * dims).reshape(-1, n, dims)) / shape
        found = values(x.reshape(-1, dims)).reshape(-1, _REALIZATIONS, n)
        return float(found.mean(axis=2).var(axis=1).sum())

    shape = np.array(min(_shapes(n, dims)[:_SHAPES], key=jittered))
    wanted = np.full(dims, _CELLS ** (1.0 / dims))
    if free and n & (n - 1) == 0:  # a grid that cosets of nets share out
        wanted = 2.0 ** ((_CELLS.bit_length() + dims - 2 - np.arange(dims)) // dims)
    parts = np.maximum(1, np.rint(wanted / shape)).astype(np.int64)
    sides, sets = shape * parts, int(parts.prod())
    cells = np.stack(np.unravel_index(np.arange(sides.prod()), sides), axis=-1)

    # Features: as many combinations of members as matter
    table = evaluated(values, (cells + 0.5) / sides)
    table -= table.mean(axis=1, keepdims=True)
    sizes, turned = np.linalg.eigh((table @ table.T).astype(np.float64))
    kept = np.argsort(-sizes)[: min(max(_FEATURES, n), 2 * _FEATURES)]
    kept = kept[sizes[kept] > 1e-9 * sizes.max()]
    features = np.ascontiguousarray((turned[:, kept].T.astype(np.float32) @ table).T)
    del table

    # Begin with one random cell of each stratum in each set, or with cosets of a net, which are sets
    place = np.ravel_multi_index(tuple((cells // parts).T), tuple(shape))
    order = np.lexsort((stream.generator(1).random(len(cells)), place))
    owner = np.empty(len(cells), np.int64)
    owner[order] = np.tile(np.arange(sets), n)
    yield Design(math.inf, 0.0, partial(_of_cells, features, owner.copy(), cells, sides))
    begun = [owner]
    if free and (cosets := _cosets(objective, n, sides, stream)) is not None:
        begun.append(cosets)
    keys = stream.child(2).keys(0, _ROUNDS)

    def exchanged(owner: Array, sums: Array, turn: int) -> float:
        """The variance after a round of exchanges."""
        _kernels.swap_cells(features, owner, place, sums, sides, free, keys[turn], _TRIALS)
        return float((sums.astype(np.float64) ** 2).sum()) / (sets * n**2)

    # The one that is better after some rounds goes on
    tried = []
    for owner in begun:
        sums = np.zeros((sets, len(kept)), np.float32)
        np.add.at(sums, owner, features)
        first = min(exchanged(owner, sums, turn) for turn in range(_FIRST_ROUNDS))
        tried.append((first, owner, sums))
    last, owner, sums = min(tried, key=lambda each: each[0])
    for turn in range(_FIRST_ROUNDS, _ROUNDS):
        variance = exchanged(owner, sums, turn)
        finished = turn + 1 == _ROUNDS or variance > (1.0 - _LEAST_GAIN) * last
        done = 1.0 if finished else (turn + 1) / _ROUNDS
        yield Design(variance, done, partial(_of_cells, features, owner.copy(), cells, sides))
        if finished:
            return
        last = variance


def _cosets(objective: Objective, n: int, sides: Array, stream: Stream) -> Array | None:
    """Which coset of a designed digital net each cell is in, (N,); None where the grid is no power of two."""
    if n < 4 or (np.append(sides, n) & np.append(sides, n) - 1).any():
        return None
    nets = (c for c in _nets(objective, n, stream, polynomial=False, frames=1))
    spec = min(nets, key=lambda c: c.variance).make(Path()).spec
    points = sampler(spec.partition(" | ")[0], len(sides)).draw(n)[0]
    codes = np.ravel_multi_index(tuple((points * sides).astype(np.int64).T), tuple(sides))
    if len(np.unique(codes)) < n:
        return None

    # Clear the leading digit of each vector of the span's echelon form from all codes
    rest, left = np.arange(sides.prod()), codes
    while left.max() > 0:
        vector = left.max()
        left, rest = (np.minimum(c, c ^ vector) for c in (left, rest))
    return np.unique(rest, return_inverse=True)[1]


def _of_cells(features: Array, owner: Array, cells: Array, sides: Array, path: Path) -> Sampler:
    """Choose reflections by the slopes of the features, and write the cells."""
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


def _points(objective: Objective, n: int, stream: Stream) -> Iterator[Design]:
    """Sets that share a grid; then, in up to 3 dims, one set on the torus by its gradient."""
    dims = objective.dims
    if n <= _CELLS // 16 or dims > 3:
        for found in _shared(objective, n, stream, free=True):
            yield found._replace(done=0.8 * found.done)
    if dims > 3:
        return
    values = objective.functions(_MEMBERS, stream.generator(0))
    for fold in (False, True):
        m, power = _fourier_power(values, dims, fold, _TORUS)
        ((value, vector),) = itertools.islice(
            _best_vector(m[: 2**14], power[: 2**14], dims, n, stream.generator(1)), 1
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
    """Σ_m P(m) |S_m|² and its gradient, through transforms and their adjoints."""
    import finufft

    side = 2 * int(np.abs(m).max()) + 1
    weights = np.zeros((side,) * dims)
    for sign in (1, -1):
        weights[tuple((sign * m + side // 2).T)] = 0.5 * power
    along = np.arange(side) - side // 2
    settings = {"eps": 1e-9, "nthreads": 1, "upsampfac": 1.25}
    forward = getattr(finufft, f"nufft{dims}d1")
    backward = getattr(finufft, f"nufft{dims}d2")

    def function(points: Array) -> tuple[float, Array]:
        n = len(points)
        axes = [np.ascontiguousarray(2.0 * np.pi * np.remainder(x, 1.0)) for x in points.T]
        s = forward(*axes, np.ones(n, np.complex128), weights.shape, isign=-1, **settings) / n
        gradient = np.empty(points.shape)
        for j in range(dims):
            slope = along.reshape([-1 if i == j else 1 for i in range(dims)])
            coefficients = weights * s.conj() * (-4j * np.pi / n) * slope
            gradient[:, j] = backward(*axes, coefficients, isign=-1, **settings).real
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
"""Kinds of samplers, to their searches."""
