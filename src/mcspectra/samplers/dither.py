"""Blue noise in the cells of a toroidal grid: void and cluster, dither masks, low discrepancy.

Void and cluster fills the cells of a fine grid one by one, always at the emptiest place.
Low-discrepancy blue noise starts from a blue-noise set.
The method then moves the points within their cells, so that they form a low-discrepancy set.

A spatio-temporal mask fills the cells of T frames of s × s cells, which also repeat in time.
Two cells of one frame repel each other by a Gaussian in space.
Two cells at one place repel each other by a Gaussian in time; other cells do not interact.
Every frame is then blue in space, and every pixel is blue in time.

The array ``pattern`` bool (T·s, s) is true for each cell that contains a point, called a one.
Opposite edges of the pattern are joined, as on a torus.
The rows of frame t are t·s … t·s + s − 1; sets and dither masks have one frame.
``energy`` float64 (T·s, s) is the sum of Gaussians around the cells that contain a one.
``weights`` is a tuple: one Gaussian along an axis of space (2·reach + 1,), and one over time (T,).
For each row of the pattern, ``heads`` int64 (2, T·s) holds the column numbers of two cells.
The first cell is the tightest cluster: of all cells with a one, it has the highest energy.
The second cell is the largest void: of all cells with a zero, it has the lowest energy.
A column number is −1 if the row of the pattern has no ones, or no zeros.
A ``grid`` is the tuple of the arrays ``pattern``, ``energy`` and ``heads``.
The cell in row i and column j has the number i·s + j.
Arrays ``points`` float64 (s, s, 2) have one point in each of s × s cells, in units of cells:
the point of cell (i, j) is in [i, i+1) × [j, j+1), on the torus.

The width of the Gaussian is 1.5 cells, as in Ulichney's paper.
If the ones of the pattern are more than three cells apart, a wider Gaussian is used.
If the Gaussian of each point did not reach the next point, voids would not be found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import whole
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_uniform
from mcspectra.samplers._kernels import _mix_below, _shuffle
from mcspectra.samplers.base import PlaneSampler, Structure
from mcspectra.samplers.optimised import OptimisedSampler, Report, random_points

__all__ = [
    "LowDiscrepancyBlueNoise",
    "VoidAndCluster",
    "dither_mask",
    "snap_in_chunks",
    "spatiotemporal_mask",
]

_MOST_SIDE = 2048
_MOST_FRAMES, _MOST_CELLS = 256, 2**22  # the largest masks take about a minute
_ONES = 0.1  # fraction of ones in the first pattern of a mask, Ulichney (1993)
_SIGMA = 1.5  # width of the Gaussian in cells, Ulichney (1993)
# Width of the Gaussian, relative to the mean spacing of the cells that contain a one.
# If 10 % of the cells contain a one, the Gaussian is 1.5 cells wide.
_SIGMA_PER_SPACING = 0.47
# Width of the Gaussian in time, in frames, as in the authors' program [Wolfe2022]_.
# A width in proportion to the spacing of the ones in time would cause peaks in the spectrum.
_SIGMA_TIME = 1.9
_WIDTHS = 6.0  # cutoff radius of the Gaussian, in widths; its value there is 1.5e-8
_CLEAR = 1e-9  # smallest gain of energy by a move; rounding errors are smaller, so relaxation ends
_CLUSTER, _VOID = 0, 1
_REPELLING = 0.5  # width in cells of the Gaussians by which points repel each other
_REACH = 2  # number of cells on either side whose points contribute to the energy
_REPORTS = 10
_LAST_STEP = 0.05  # size of the random moves in the last phase, in cells


def dither_mask(size: int, keys: Array) -> Array:
    """Make a blue-noise dither mask: the ranks of size × size cells on a torus.

    Parameters
    ----------
    size
        Cells along a side, at most 2048.
    keys
        Keys of the random numbers, uint64 (2,), from `Stream.keys`.

    Returns
    -------
    ndarray
        The ranks 0 … size² − 1, int64 (size, size).
        For every k, the k cells of rank below k form a blue-noise set.

    References
    ----------
    [Ulichney1993]_.
    """
    return np.asarray(spatiotemporal_mask(size, 1, keys)[0])


def spatiotemporal_mask(size: int, frames: int, keys: Array) -> Array:
    """Make a mask that is blue noise in every frame, and in time at every pixel.

    Parameters
    ----------
    size
        Cells along a side, at most 2048.
    frames
        Number of frames, at most 256; the mask repeats after them.
    keys
        Keys of the random numbers, uint64 (2,), from `Stream.keys`.

    Returns
    -------
    ndarray
        The ranks 0 … frames · size² − 1, int64 (frames, size, size).

    Raises
    ------
    ParameterError
        If a number is out of range, or there are more than 2^22 cells.

    Notes
    -----
    The energy has separate kernels for space and time.
    With one Gaussian over space and time together, each single frame would be white noise.
    A mask of 64 × 64 cells and 16 frames takes about a second.

    References
    ----------
    [Wolfe2022]_, [Ulichney1993]_.
    """
    size = as_integer("size", size, least=1, most=_MOST_SIDE)
    frames = as_integer("frames", frames, least=1, most=_MOST_FRAMES)
    cells = frames * size * size
    if cells > _MOST_CELLS:
        raise ParameterError(
            f"{frames} frames of {size} × {size} cells are {cells:,} cells; use at most "
            f"{_MOST_CELLS:,}."
        )
    if cells == 1:
        return np.zeros((1, 1, 1), np.int64)
    grid, weights = _random_grid(keys[0], keys[1], max(1, round(_ONES * cells)), frames, size)
    while not _relax(grid, weights, cells):
        pass
    order, ranks = np.empty(cells, np.int64), np.empty(cells, np.int64)
    _rank_all(grid, order)
    ranks[order] = np.arange(cells)
    return ranks.reshape(frames, size, size)


@final
@dataclass(frozen=True, kw_only=True)
class VoidAndCluster(PlaneSampler, OptimisedSampler):
    """Void and cluster: blue noise in cells of a fine grid, jittered within; 2-D, progressive.

    Makes up to 65,536 points, in the order of their ranks.
    For every k, the first k points are spread evenly.
    A set of 4096 points takes a quarter of a second, and a set of 16,384 points two seconds.

    Attributes
    ----------
    cells
        Number of grid cells per point, from 4 to 256; more cells make the grid less visible.
    sets
        Largest number of different sets, see `OptimisedSampler`.
        None makes a new set for each realization.

    References
    ----------
    [Ulichney1993]_.
    """

    other_dims: ClassVar[str] = "for other dims use poisson-disk"
    cells: int = whole(16, least=4, most=256)

    def _optimize(self, n: int, keys: Array, report: Report) -> Array:
        side = math.isqrt(self.cells * n - 1) + 1
        grid, weights = _random_grid(keys[0], keys[1], n, 1, side)
        rounds = 0
        while not _relax(grid, weights, n):
            rounds += 1
            report(1.0 - 0.5 ** (rounds / 4))  # the number of rounds until the end is unknown
        order, points = np.empty(n, np.int64), np.empty((n, 2))
        _rank_ones(grid, order)
        _jitter_cells(keys[0], keys[1], order, side, points)
        return points


@kernel
def _spread(cell: Any, sign: float, weights: Any, energy: Array) -> None:
    # Add the Gaussians around a cell, times `sign`, to the energy.
    space, time = weights
    side, reach = energy.shape[1], space.size // 2
    top, i = cell // side // side * side, cell // side % side
    for k in range(space.size):
        row = energy[top + (i + k - reach) % side]
        height = sign * space[k]
        j = (cell - reach) % side
        for m in range(space.size):
            row[j] += height * space[m]
            j = j + 1 if j + 1 < side else 0
    for later in range(1, time.size):
        energy[(cell // side + later * side) % energy.shape[0], cell % side] += sign * time[later]


@kernel
def _find_heads(i: int, pattern: Array, energy: Array, heads: Array) -> None:
    # For row i, store in heads the columns of the tightest cluster and of the largest void.
    high, low = -np.inf, np.inf
    heads[_CLUSTER, i] = heads[_VOID, i] = -1
    for j in range(pattern.shape[1]):
        e = energy[i, j]
        if pattern[i, j]:
            if e > high:
                high, heads[_CLUSTER, i] = e, j
        elif e < low:
            low, heads[_VOID, i] = e, j


@kernel
def _random_grid(k0: np.uint64, k1: np.uint64, ones: int, frames: int, side: int) -> Any:
    # Return a grid with `ones` ones in random cells, and the weights of the Gaussians.
    rows = frames * side
    pattern, order = np.zeros((rows, side), np.bool_), np.empty(rows * side, np.int64)
    _shuffle(k0, k1, 0, order)
    for cell in order[:ones]:
        pattern[cell // side, cell % side] = True
    grid = pattern, np.empty((rows, side)), np.empty((2, rows), np.int64)
    return grid, _start(grid)


@kernel
def _start(grid: Any) -> Any:
    # Compute the energy of all cells, and find the tightest cluster and largest void of each row.
    # The pattern must contain at least one 1. Return the weights of the Gaussians.
    pattern, energy, heads = grid
    (rows, side), cells = pattern.shape, np.flatnonzero(pattern)
    frames = rows // side
    sigma = max(_SIGMA, _SIGMA_PER_SPACING * side / np.sqrt(cells.size / frames))
    reach = min(int(np.ceil(_WIDTHS * sigma)), (side - 1) // 2)
    space: Array = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    later = np.arange(frames)
    time: Array = np.exp(-0.5 * (np.minimum(later, frames - later) / _SIGMA_TIME) ** 2)
    weights = space, time
    energy[:] = 0.0
    for cell in cells:
        _spread(cell, 1.0, weights, energy)
    for i in range(rows):
        _find_heads(i, pattern, energy, heads)
    return weights


@kernel
def _flip(cell: int, grid: Any, weights: Any) -> None:
    # Turn a one into a zero, or a zero into a one.
    pattern, energy, heads = grid
    (rows, side), reach = pattern.shape, weights[0].size // 2
    i, j = cell // side, cell % side
    pattern[i, j] = not pattern[i, j]
    _spread(cell, 1.0 if pattern[i, j] else -1.0, weights, energy)
    for k in range(weights[0].size):
        _find_heads(i // side * side + (i + k - reach) % side, pattern, energy, heads)

    # Flipping a cell changes the energy of one cell in each other frame, at the same place
    for other in range(i + side, i + rows, side):
        row = other % rows
        kind = _CLUSTER if pattern[row, j] else _VOID
        head, sign = heads[kind, row], 1.0 if kind == _CLUSTER else -1.0
        if head == j:
            _find_heads(row, pattern, energy, heads)
        elif sign * energy[row, j] > sign * energy[row, head]:
            heads[kind, row] = j


@kernel
def _head(kind: int, grid: Any) -> int:
    # Return the cell of the tightest cluster or of the largest void; one must exist.
    _, energy, heads = grid
    sign = 1.0 if kind == _CLUSTER else -1.0
    best, cell = -np.inf, -1
    for i in range(energy.shape[0]):
        j = heads[kind, i]
        if j >= 0 and sign * energy[i, j] > best:
            best, cell = sign * energy[i, j], i * energy.shape[1] + j
    return cell


@kernel
def _relax(grid: Any, weights: Any, steps: int) -> bool:
    # Move tightest clusters to largest voids, at most `steps` times; return whether it converged.
    energy = grid[1]
    side = energy.shape[1]
    for _ in range(steps):
        cluster = _head(_CLUSTER, grid)
        before = energy[cluster // side, cluster % side] - 1.0
        _flip(cluster, grid, weights)
        void = _head(_VOID, grid)
        if energy[void // side, void % side] > before - _CLEAR:
            _flip(cluster, grid, weights)
            return True
        _flip(void, grid, weights)
    return False


@kernel
def _rank_ones(grid: Any, order: Array) -> None:
    # Remove the ones of the pattern, one by one, always at the tightest cluster.
    # Write the cells to `order` (ones,) in reverse: the cell of the first removed one comes last.
    weights, again = _start(grid), order.size // 2
    for rank in range(order.size - 1, -1, -1):
        order[rank] = _head(_CLUSTER, grid)
        _flip(order[rank], grid, weights)
        # When half of the points are left, they are farther apart and need a wider Gaussian
        if rank == again and rank > 0:
            weights, again = _start(grid), again // 2


@kernel
def _rank_all(grid: Any, order: Array) -> None:
    # Rank all cells, given a relaxed pattern of at most half of them; out is order (s²,).
    pattern, energy, heads = grid
    ones, half = np.count_nonzero(pattern), order.size // 2
    first = pattern.copy()
    _rank_ones(grid, order[:ones])

    # Set cells to one, largest void first, until half of the cells are ones
    filled = first, energy, heads
    weights = _start(filled)
    for rank in range(ones, half):
        order[rank] = _head(_VOID, filled)
        _flip(order[rank], filled, weights)

    # If more than half of the cells are ones, set the tightest cluster of zeros next
    rest = order[half:]
    pattern[:] = ~first
    _rank_ones(grid, rest)
    rest[:] = rest[::-1].copy()


@kernel
def _jitter_cells(k0: np.uint64, k1: np.uint64, cells: Array, side: int, out: Array) -> None:
    # Fill out (n, 2) with one uniform point in each of the listed cells (n,).
    # One random shift by whole cells, modulo the side, moves all points together.
    number = side * side  # the first side² random numbers have shuffled the side² cells
    down, across = _mix_below(k0, k1, number, side), _mix_below(k0, k1, number + 1, side)
    for p in range(cells.size):
        number += 2
        x = (cells[p] // side + down) % side + mix_uniform(k0, k1, number)
        y = (cells[p] + across) % side + mix_uniform(k0, k1, number + 1)
        out[p, 0], out[p, 1] = min(x / side, BELOW_ONE), min(y / side, BELOW_ONE)


@final
@dataclass(frozen=True, kw_only=True)
class LowDiscrepancyBlueNoise(PlaneSampler, OptimisedSampler):
    """Low-discrepancy blue noise in s × s cells, s a power of two (2-D).

    Counts are 4^k up to 65,536. Points come in row-major order of their cells.
    A set of 1024 points takes a quarter of a second; the time is proportional to n.

    Attributes
    ----------
    chunk
        Number of consecutive cells that keep the order of the blue-noise set, a power of two ≤ 64.
        More cells give cleaner blue noise, fewer cells a lower discrepancy.
    sweeps
        Number of attempts to move each point of the blue-noise set.
    sets
        Largest number of different sets, see `OptimisedSampler`.
        None makes a new set for each realization.

    Notes
    -----
    The set has one point in each cell, and one in each of n equal intervals of either axis.
    For all 2^j ≥ chunk, the set also has one point in each interval of 2^j by 2^−j cells.
    With chunk = 2 the set is a (0,2)-net.
    The points are exactly uniform over the cells and along each axis.
    Within a cell, the density of the point is not quite constant.
    Add shift for unbiased means.

    The blue-noise set is a jittered set, with points relaxed within their cells.
    Relaxation minimizes the overlap of Gaussians around the points.
    The width of each Gaussian is half the side of a cell.
    A blue-noise set is computed for every realization.
    Ahmed et al. instead keep a table of one blue-noise set.

    References
    ----------
    [Ahmed2016]_.
    """

    name: ClassVar[str] = "ldbn"
    structure: ClassVar[Structure] = Structure.STRATA
    unbiased: ClassVar[bool] = False
    other_dims: ClassVar[str] = "for other dims use projective-blue-noise or sobol | owen"
    chunk: int = whole(16, least=2, most=64)
    sweeps: int = whole(100, least=1, most=10**5)

    def _check(self) -> None:
        if self.chunk & (self.chunk - 1):
            raise ParameterError(f"chunk is {self.chunk}; give a power of two from 2 to 64.")

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        below = 1 << (n.bit_length() - 1) // 2 * 2
        return below, below if below == n else 4 * below

    def _optimize(self, n: int, keys: Array, report: Report) -> Array:
        side = math.isqrt(n)
        corners = np.stack(np.meshgrid(np.arange(side), np.arange(side), indexing="ij"), axis=-1)
        followed = corners + random_points(keys, n, 2).reshape(side, side, 2)
        for sweep in range(self.sweeps):
            number = 2 * n * (sweep + 1)
            step = _LAST_STEP ** (sweep / self.sweeps)
            _relax_in_cells(keys[0], keys[1], number, step, followed)
            if (sweep + 1) % max(1, self.sweeps // _REPORTS) == 0:
                report((sweep + 1) / self.sweeps)
        points = np.empty((side, side, 2))
        number = 2 * n * (self.sweeps + 1)
        snap_in_chunks(keys[0], keys[1], number, min(self.chunk, side), followed, points)
        return points.reshape(n, 2)


@kernel
def _energy(i: int, j: int, x: float, y: float, points: Array) -> float:
    # Return the energy that the point of cell (i, j) would have at (x, y).
    side, total = points.shape[0], 0.0
    reach = min(_REACH, (side - 1) // 2)
    for u in range(i - reach, i + reach + 1):
        for v in range(j - reach, j + reach + 1):
            if u != i or v != j:
                other = points[u % side, v % side]
                # Neighbors across the border of the torus are moved by one period
                dx = other[0] - u % side + u - x
                dy = other[1] - v % side + v - y
                total += np.exp(-(dx * dx + dy * dy) / (2 * _REPELLING * _REPELLING))
    return total


@kernel
def _relax_in_cells(k0: np.uint64, k1: np.uint64, number: int, step: float, points: Array) -> None:
    # Move each point by up to `step` if this lowers its energy and keeps it in its cell.
    side = points.shape[0]
    for i in range(side):
        for j in range(side):
            here = points[i, j]
            x = here[0] + step * (2.0 * mix_uniform(k0, k1, number) - 1.0)
            y = here[1] + step * (2.0 * mix_uniform(k0, k1, number + 1) - 1.0)
            number += 2
            if x < i or x >= i + 1 or y < j or y >= j + 1:
                continue
            if _energy(i, j, x, y, points) < _energy(i, j, here[0], here[1], points):
                here[0], here[1] = x, y


@kernel
def _snap_line(low: int, chunk: int, line: int, positions: Array, out: Array) -> None:
    # A line of s cells is one cell wide. Divide this width into s intervals, one for each cell.
    # For the point in each cell, `positions` (s,) has the coordinate across the line of cells.
    # `out` (s,) gets, for each cell, the index of the interval that is assigned to it.
    # The intervals of the chunks follow a van der Corput sequence with shifted digits.
    # The number `low` contains the digits of the random shift.
    side, digits = positions.size, 0
    while chunk << digits < side:
        digits += 1
    for block in range(side // chunk):
        # All points of a chunk have the same low digits.
        # The low digits are the digits of the chunk's number, reversed and then randomly shifted
        mine = 0
        for k in range(digits):
            mine |= ((block >> k) & 1) << (digits - 1 - k)
        mine ^= low & ((1 << digits) - 1)

        # The high digits are the rank of the point within the chunk
        start = block * chunk
        for rank, index in enumerate(np.argsort(positions[start : start + chunk])):
            out[start + index] = line * side + ((rank << digits) | mine)


@kernel
def snap_in_chunks(
    k0: np.uint64, k1: np.uint64, number: int, chunk: int, points: Array, out: Array
) -> None:
    """Move points to a low-discrepancy set, keeping their order in chunks; out (s, s, 2).

    In each column, the s cells get s different intervals of the column's width.
    In each row, the s cells get s different intervals of the row's height.
    Within a chunk, intervals follow the order of the points.
    Chunks follow the van der Corput sequence with randomly shifted digits.
    A point is uniform within its interval.
    """
    side = points.shape[0]
    for line in range(side):
        x, y = _mix_below(k0, k1, number, side), _mix_below(k0, k1, number + 1, side)
        _snap_line(x, chunk, line, points[line, :, 0], out[line, :, 0])
        _snap_line(y, chunk, line, points[:, line, 1], out[:, line, 1])
        number += 2
    for i in range(side):
        for j in range(side):
            for axis in range(2):
                value = (out[i, j, axis] + mix_uniform(k0, k1, number)) / (side * side)
                out[i, j, axis] = min(value, BELOW_ONE)
                number += 1
