"""Quadrature of integrands: Fourier coefficients on tensor grids, and integrals on adaptive boxes.

Method
------
Each axis is divided into C cells of width 1/C, with q Gauss-Legendre nodes at offsets o_q:

    ∫_0^1 f(x) exp(−2πi m x) dx ≈ Σ_q (w_q/C) exp(−2πi m o_q) FFT_q[m mod C],

where FFT_q transforms, over the cells, the values at node q of each cell.
For q = 1 this is the midpoint grid, which requires its half-sample phase exp(−πi m/C).
In contrast to a plain FFT, the jump between f(1) and f(0) does no harm: it is at a cell's edge.
For smooth f, periodic or not, the rule converges spectrally in q.
If a cell contains a discontinuity, the cell is divided there into pieces of q nodes each.
Few cells contain a discontinuity, so the rule sums over the nodes of their pieces directly.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.streams import Stream, golden_vector

__all__ = [
    "PROBE",
    "AxisRule",
    "Estimate",
    "adaptive_integral",
    "axis_rules",
    "cell_integrals",
    "gauss_rule",
    "grid_coefficients",
    "lattice_integral",
    "probe",
    "product_coefficients",
    "refined_coefficients",
    "search_breaks",
    "slabs",
]

# Nodes per cell. With 16 of them, the error is 1e-10 at 4 nodes per wavelength.
# At 8 nodes per wavelength, the error is at the level of rounding
_ORDER = 16
_LEAST_NODES = {1: 256, 2: 256, 3: 64, 4: 32}
_BUDGET = 2**22  # Maximum number of evaluations of a refined grid
_LIMIT = 2**24  # Maximum number of evaluations of a first grid. More raise an error
_FOURIER_TOLERANCE = 1e-10
_BLOCK = 2**18  # Number of points that are evaluated at once

# Least number of nodes per axis for bases whose functions are not constant in cells
_PRODUCT_NODES = {1: 512, 2: 512, 3: 64, 4: 32}
# Number of nodes along each axis of a cell. It is for bases that are constant in each cell
_CELL_NODES = {1: 64, 2: 16, 3: 4, 4: 2}
_CELLS = {1: 32, 2: 8, 3: 4, 4: 2, 5: 2}
_CELL_ORDER = {1: 16, 2: 8, 3: 6, 4: 5, 5: 4}
_INTEGRAL_BUDGET = 2**21  # Maximum number of evaluations of an integral on boxes
_INTEGRAL_TOLERANCE = 1e-12
_LATTICE_POINTS = 2**20
PROBE = 2**17
"""Number of points of `probe`. Each of them represents 1/PROBE of the volume."""
_SIGMAS = 3.0
# f is evaluated near the corners of a box, at a distance that is this fraction of the box.
# The first fraction is for boxes in 1-D, and the second for boxes in more dims
_INSET = (1e-10, 1e-6)
_LEAST_INSET = 2.0**-51  # Least distance to a corner, as a fraction of the corner's coordinate
# Near a corner, f may differ from its polynomial by this multiple of the last coefficients.
# A larger difference indicates a jump
_SMOOTH = 100.0
# If f differs from the polynomials of the boxes at this number of probe points or more,
# the error of ∫f is estimated from the differences at these points instead of the boxes
_LEAST_SEEN = 30
_LOOKS = 2  # The second set of probe points is this many times as large as the first
# Smallest size of a box as a fraction of its coordinates, and smallest size next to 0
_SMALLEST, _TINIEST = 2.0**-44, 2.0**-500
# Later changes of an integral are extrapolated from the ratio of its previous changes.
# Upper limit of this ratio, and number of levels from which the ratio is computed
_SLOW, _LEVELS = 0.99, 4
_HALVES, _UNSETTLED = 0.55, 1.5

_LINE, _END = 2**14, 2.0**-40  # Number of steps along a line, and position of its first point
_CANDIDATES = 16  # Jumps are searched for in this many of the largest steps of a line
# Number of times that a step is cut in two, which reduces its width to 2^-46.
# Cuts are not at the middle, to avoid dyadic fractions
_CUTS, _CUT = 34, 0.4871
# Number of peaks that are examined on a line, and number of bisections toward each peak.
# A peak is a pole if its values grow by more than the factor `_GROWN`
_PEAKS, _CLIMBS, _GROWN = 4, 24, 4.0
# At a jump, at least this fraction of the original change remains after all cuts of the step
_STAYS = 0.5
# Offset of a second, parallel line. Both lines are compared at this distance from a jump
_ASIDE, _ABOUT = 2.0**-20, 2.0**-30
_SAME_BREAK = 2.0**-40
_FOUND = 2.0**-46  # Uncertainty of the position of a break that was detected


class QuadratureIntegrand(Protocol):
    """The attributes and methods of `mcspectra.integrands.Integrand` that quadrature uses."""

    @property
    def dims(self) -> int: ...
    @property
    def channels(self) -> int: ...
    @property
    def spec(self) -> str: ...
    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]: ...
    def __call__(self, x: Array, /) -> Array: ...
    def box_moments(self, lo: Array, hi: Array, /) -> tuple[Array, Array] | None: ...


@functools.lru_cache(maxsize=32)
def gauss_rule(order: int) -> tuple[Array, Array]:
    """Return nodes and weights (order,) of Gauss-Legendre quadrature on [0,1]."""
    node, weight = np.polynomial.legendre.leggauss(order)
    return 0.5 * (node + 1.0), 0.5 * weight


@final
@dataclass(frozen=True)
class Estimate:
    """A value that was computed with an estimate of its error.

    Attributes
    ----------
    value, error, method
        The value, an estimate of its largest absolute error, and the name of the method.
    unseen
        Part of the error, by channel, from regions that contain test points (`probe`) but no nodes.
        None if the nodes resolve f at all test points.
    """

    value: Array
    error: float
    method: str
    unseen: Array | None = None


@final
@dataclass(frozen=True)
class AxisRule:
    """Composite Gauss-Legendre rule on [0,1], for integrals of f(x) exp(−2πi m x).

    Attributes
    ----------
    cells, order
        Number C of equal cells, and number q of nodes in each cell.
        The first C q nodes, which belong to the equal cells, are called *uniform*.
        All other nodes belong to parts of cells that are cut at a break.
    nodes, weights
        Arrays of shape (P,). Uniform nodes in cut cells have weight 0.
    """

    cells: int
    order: int
    nodes: Array
    weights: Array

    @staticmethod
    def make(count: int, order: int, breaks: Sequence[float] = ()) -> AxisRule:
        """Make a rule of `count` uniform nodes, `order` nodes per cell, and cut cells at breaks."""
        cells = count // order
        node, weight = gauss_rule(order)
        nodes = ((np.arange(cells)[:, None] + node) / cells).ravel()
        weights = np.tile(weight / cells, (cells, 1))
        places = np.array([b * cells for b in breaks if 0.0 < b < 1.0])
        places = places[places != np.rint(places)]
        cut = np.unique(np.floor(places)).astype(np.intp)
        weights[cut] = 0.0
        ends = np.unique(np.concatenate([places, cut, cut + 1]))
        low, width = ends[:-1, None], np.diff(ends)[:, None]
        piece = np.isin(np.floor(low + 0.5 * width), cut).ravel()
        extra = ((low + width * node) / cells)[piece].ravel()
        extra_weights = (width * weight / cells)[piece].ravel()
        return AxisRule(
            cells,
            order,
            np.concatenate([nodes, extra]),
            np.concatenate([weights.ravel(), extra_weights]),
        )

    def transform(self, values: Array, m: Array) -> Array:
        """Return coefficients (..., U) at integers m (U,), from values (..., P) at the nodes."""
        uniform = self.cells * self.order
        weighted = values * self.weights
        grid = weighted[..., :uniform].reshape(*values.shape[:-1], self.cells, self.order)
        spectrum = np.fft.fft(grid, axis=-2)[..., np.mod(m, self.cells).astype(np.intp), :]
        offsets = self.nodes[: self.order]
        phase = np.exp(-2j * np.pi * m[:, None] * offsets)
        found = np.einsum("...uq,uq->...u", spectrum, phase)
        if self.nodes.size > uniform:
            waves = np.exp(-2j * np.pi * self.nodes[uniform:, None] * m)
            found += weighted[..., uniform:] @ waves
        return np.asarray(found)


def refined_coefficients(function: QuadratureIntegrand, m: Sequence[Array]) -> Estimate:
    """Return coefficients (U_0, …, U_{d−1}[, channels]) at all combinations of integers m[i].

    The first grid has 16 nodes per wavelength of the highest frequency, or 8 in three or more dims.
    If the nodes exceed 2^24 evaluations, the first grid has 4 nodes per wavelength.
    The grid has at least 256 nodes per axis (64 in 3-D, 32 in 4-D, 16 in more dims).
    The number of nodes is doubled until two grids agree to 1e-10 of the largest coefficient.
    Doubling also ends if the next grid would exceed 2^22 evaluations.

    Raises
    ------
    ParameterError
        If the first grid exceeds 2^24 evaluations.
    """
    # Choose the size of the first grid from the highest frequency along each axis
    dims, least = len(m), _LEAST_NODES.get(len(m), 16)
    highest = [int(np.abs(axis).max()) for axis in m]
    for per_wave in (16, 8, 4) if dims <= 2 else (8, 4):
        counts = [1 << (max(least, per_wave * h) - 1).bit_length() for h in highest]
        if math.prod(counts) <= _LIMIT:
            break
    else:
        raise ParameterError(
            f"The Fourier coefficients of {function.spec} up to |m| = {max(highest)} in {dims} "
            f"dims take {float(math.prod(counts)):.2g} evaluations, more than {_LIMIT:.2g}; "
            "request lower frequencies, or give exact coefficients (fourier=)."
        )

    coarse = grid_coefficients(function, [c // 2 for c in counts], m)
    while True:
        fine = grid_coefficients(function, counts, m)
        error = float(np.abs(fine - coarse).max())
        settled = error <= _FOURIER_TOLERANCE * float(np.abs(fine).max())
        if settled or math.prod(counts) * 2 ** len(counts) > _BUDGET:
            shown = " x ".join(map(str, counts))
            return Estimate(fine, error, f"{shown} nodes")
        coarse, counts = fine, [2 * c for c in counts]


def grid_coefficients(
    function: QuadratureIntegrand, counts: Sequence[int], m: Sequence[Array]
) -> Array:
    """Transform one tensor grid, slab by slab: first along all other axes, then along the first."""
    rules = [
        AxisRule.make(count, min(_ORDER, count), breaks)
        for count, breaks in zip(counts, function.breaks, strict=True)
    ]
    parts = []
    for _, values in slabs(function, rules):
        for axis in range(len(rules) - 1, 0, -1):
            turned = rules[axis].transform(np.moveaxis(values, axis + 1, -1), m[axis])
            values = np.moveaxis(turned, -1, axis + 1)
        parts.append(values)
    whole = np.moveaxis(np.concatenate(parts, axis=1), 1, -1)
    found = np.moveaxis(rules[0].transform(whole, m[0]), -1, 1)
    return np.moveaxis(found, 0, -1) if function.channels else found[0]


def slabs(function: QuadratureIntegrand, rules: Sequence[AxisRule]) -> Iterator[tuple[int, Array]]:
    """Yield slabs of the node grid along the first axis: their start, and values (C, p, P_1, …)."""
    first, rest = rules[0].nodes, [rule.nodes for rule in rules[1:]]
    step = max(1, _BLOCK // math.prod(nodes.size for nodes in rest))
    for start in range(0, first.size, step):
        points = _tensor([first[start : start + step], *rest])
        yield start, np.moveaxis(_columns(function, points), -1, 0)


def _tensor(axes: Sequence[Array]) -> Array:
    """Return the points (n_0, …, n_{d−1}, d) of a tensor grid."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def _columns(function: QuadratureIntegrand, x: Array) -> Array:
    values = function(x)
    return values if function.channels else values[..., None]


def adaptive_integral(
    function: QuadratureIntegrand,
    breaks: tuple[Array, ...],
    probed: Array | None = None,
    *,
    budget: int = _INTEGRAL_BUDGET,
) -> Estimate:
    """Return ∫ f of C ≥ 1 channels in up to 5 dims, on boxes that are divided until sums agree.

    Cells are first cut at the `breaks` of each axis. In each, a Gauss-Legendre tensor rule is used.
    If `probed` is given, it holds the values at the points of `probe`.
    Each point of the probe represents 2^-17 of the volume.

    While the `budget` of evaluations lasts, a cell is divided into 2^d parts for three reasons.
    The integral over the cell may change by more than 1e-12 ∫|f|, divided by the number of cells.
    At a probe point in the cell, f may differ from the polynomial through the nodes of the cell.
    Near a corner of the cell, f may jump away from the polynomial.

    The error is the sum of the last differences and an estimate of all later differences.
    A second value of ∫ f adds a correction: the mean of f minus the polynomials at probe points.
    The error of the corrected value is three standard errors of the correction.
    The value with the smaller error is used.

    If only probe points showed that a box must be divided, other regions may have been missed.
    The correction of ∫ f and its error are then computed from 2^18 other points.
    """
    dims, method = function.dims, "adaptive Gauss-Legendre quadrature with a probe"
    order = _CELL_ORDER[dims]

    # Cut the first cells at the breaks. `low` and `size` are corners and sides of cells, (N, d)
    edges = [np.union1d(_uniform(dims), axis) for axis in breaks]
    low = _tensor([e[:-1] for e in edges]).reshape(-1, dims)
    size = _tensor([np.diff(e) for e in edges]).reshape(-1, dims)

    def cells_of(x: Array) -> Array:
        found = [np.searchsorted(e, t, side="right") - 1 for e, t in zip(edges, x.T, strict=True)]
        return np.asarray(np.ravel_multi_index(tuple(found), tuple(len(e) - 1 for e in edges)))

    # Evaluate f at the points of the probe, and find the cell of each point
    points = probe(dims)
    cell = cells_of(points)
    seen = probed = _at_points(function, points) if probed is None else probed

    weights = _tensor([gauss_rule(order)[1]] * dims).reshape(-1, dims).prod(axis=-1)
    coarse = weights @ _cell_values(function, low, size, order)[0] * size.prod(axis=-1)[:, None]
    total, error = np.zeros(coarse.shape[1]), np.zeros(coarse.shape[1])
    scale = np.maximum(np.abs(coarse).sum(axis=0), np.abs(seen).mean(axis=0))
    halves = _tensor([np.array([0.0, 0.5])] * dims).reshape(-1, dims)
    digits = 2 ** np.arange(dims)[::-1]
    fresh, surprises = np.full(len(points), True), np.zeros(coarse.shape[1])
    # Sum of the errors at the probe's points, in boxes whose integral did not change
    alone = np.zeros(coarse.shape[1])
    levels: list[tuple[Array, Array, Array, Array, Array]] = []
    left: list[Array] = []  # summed changes of the integrals of cells, by level
    while True:
        # Halve the boxes along every axis. The parts of a box are stored next to each other
        budget -= len(low) * (2 * order) ** dims
        part = cell * 2**dims + (points >= (low + 0.5 * size)[cell]) @ digits
        low = (low[:, None] + halves * size[:, None]).reshape(-1, dims)
        size = np.repeat(0.5 * size, 2**dims, axis=0)
        volume = size.prod(axis=-1)
        values, corners = _cell_values(function, low, size, order)
        fine = (weights @ values * volume[:, None]).reshape(len(coarse), 2**dims, -1)
        better = fine.sum(axis=1)

        # As long as the budget lasts, divide a box again if its integral changed too much
        scale = np.maximum(scale, np.abs(fine).sum(axis=(0, 1)))
        difference = np.abs(better - coarse)
        changed = (difference > _INTEGRAL_TOLERANCE * scale / len(coarse)).any(axis=1)
        missed = _residuals(values, seen, points, low, size, part)
        share = np.minimum(1.0 / PROBE, volume)[part, None]
        missed[np.abs(missed) * share <= _INTEGRAL_TOLERANCE * scale] = 0.0
        bad = changed | (np.bincount(cell, missed.any(axis=1), len(coarse)) > 0)
        surprise = fresh & ~changed[cell] & missed.any(axis=1)
        alone += missed[surprise].sum(axis=0) / PROBE
        surprises = np.maximum(surprises, np.abs(missed[surprise]).max(axis=0, initial=0.0))
        slivers = (_slivers(values, corners) * volume[:, None]).reshape(fine.shape).sum(axis=1)
        slivers[slivers <= _INTEGRAL_TOLERANCE * scale / len(coarse)] = 0.0
        bad |= slivers.any(axis=1)
        bad &= (size > _SMALLEST * (low + size) + _TINIEST).all(axis=-1)[:: 2**dims]
        done = np.count_nonzero(bad) * (4 * order) ** dims > budget or not bad.any()
        settled = np.full(len(bad), True) if done else ~bad
        total += better[settled].sum(axis=0)
        left.append(difference[changed].sum(axis=0))
        after = np.where((settled & changed)[:, None], _after(left[-_LEVELS:]), 1.0)
        error += (difference * after + slivers * ~changed[:, None])[settled].sum(axis=0)
        keep = np.repeat(bad & (not done), 2**dims)
        levels.append((low, size, values, keep, np.repeat(changed, 2**dims)))
        if done:
            break
        low, size, coarse = low[keep], size[keep], fine[bad].reshape(-1, fine.shape[-1])
        inside = keep[part]
        cell = (np.cumsum(keep) - 1)[part[inside]]
        points, seen, fresh = points[inside], seen[inside], (fresh & ~surprise)[inside]

    # Correct the integral over unresolved boxes by the values at the probe's points
    rest = missed[changed[cell]] / PROBE
    shift, spread = rest.sum(axis=0), _SIGMAS * np.sqrt((rest**2).sum(axis=0))
    better_known = (np.count_nonzero(rest, axis=0) >= _LEAST_SEEN) & (spread < error)
    biased = ~better_known & (_SIGMAS * np.abs(shift) > 2.0 * spread)
    total = np.where(better_known, total + shift, total)
    error = np.where(better_known, spread, np.where(biased, error + np.abs(shift) + spread, error))
    # Add the error of jumps that were not resolved because their cells have negligible weight
    error += _SIGMAS * _INTEGRAL_TOLERANCE * scale
    error += _FOUND * sum(map(len, breaks)) * np.ptp(probed, axis=0)
    if not surprises.any():
        return Estimate(total, float(error.max()), method)

    # Probe points have found regions that all nodes missed, so test the other cells at new points.
    # In 1-D, the first probe points hit every region that is as wide as one of the found regions.
    # In more dims, there may be a region that all 2^18 points miss, with probability 5 %
    again = probe(dims, _LOOKS)
    rest = _hidden(levels, again, cells_of(again), _at_points(function, again)) / len(again)
    rest[np.abs(rest) * len(again) <= _INTEGRAL_TOLERANCE * scale] = 0.0
    largest = np.maximum(np.abs(rest).max(axis=0), surprises / len(again))
    unseen = largest if dims > 1 else np.where(rest.any(axis=0), largest, 0.0)
    unseen = _SIGMAS * np.sqrt((rest**2).sum(axis=0) + unseen**2)
    error += unseen
    shift = rest.sum(axis=0)
    total += np.where(np.abs(shift) > np.sqrt((rest**2).sum(axis=0)), shift, 0.0)
    unseen = np.maximum(np.abs(alone), np.abs(shift)) + unseen
    return Estimate(total, float(error.max()), method, unseen)


def search_breaks(
    function: QuadratureIntegrand, *, budget: int = _INTEGRAL_BUDGET
) -> tuple[tuple[Array, ...], Array]:
    """Return the breaks that f declares along each axis, and the jumps and poles that are found.

    The search begins with the values at the points of `probe`. These values are also returned.

    Along each axis, two lines go through points of the probe.
    Other lines go through the points of the probe where f is least and greatest.
    The largest steps of each line are cut down to 2^-46. If a step remains, it is a jump or a pole.
    A jump is normal to the axis if a neighboring line jumps at the same position.
    Boxes and tables are then cut at this position, because they could miss a thin slab.
    If all breaks would make too many boxes, those with the largest jumps are used.
    """
    dims, points = function.dims, probe(function.dims)
    breaks = [np.array([b for b in axis if 0.0 < b < 1.0]) for axis in function.breaks]
    seen = _at_points(function, points)
    spread = np.where(seen.std(axis=0) > 0.0, seen.std(axis=0), np.inf)
    lines = points[np.unique([0, 1, *seen.argmin(axis=0), *seen.argmax(axis=0)])]
    rows, steps = np.arange(len(lines))[:, None], (np.arange(_LINE) + math.sqrt(0.5)) / _LINE
    # Each break is a tuple: whether it is a peak, the negative of its height, its axis and place
    found: list[tuple[bool, float, int, float]] = []
    for axis in range(dims):

        def at(t: Array, aside: float = 0.0, axis: int = axis) -> Array:
            """Return values (L, M, C) of f at t (L, M) on lines that are moved by `aside`."""
            x = np.repeat((lines[:, None] + aside) % 1.0, t.shape[1], axis=1)
            x[..., axis] = np.clip(t, _END, 1.0 - _END)
            return _at_points(function, x.reshape(-1, dims)).reshape(*t.shape, -1) / spread

        def apart(one: Array, other: Array) -> Array:
            return np.asarray(np.abs(one - other).max(axis=-1))

        # Find the largest steps of each line
        t = np.tile([_END, *steps, 1.0 - _END], (len(lines), 1))
        t = np.sort(np.concatenate([t, lines[:, axis, None]], axis=1), axis=1)
        y = y_line = at(t)
        step = apart(y[:, 1:], y[:, :-1])
        chosen = np.argpartition(step, -_CANDIDATES, axis=1)[:, -_CANDIDATES:]
        low, high, first = t[rows, chosen], t[rows, chosen + 1], step[rows, chosen]
        y_low, y_high = y[rows, chosen], y[rows, chosen + 1]

        # Bisect the largest steps of each line. Only a step at a jump of f keeps its height
        for _ in range(_CUTS):
            middle = low + _CUT * (high - low)
            y = at(middle)
            left = apart(y, y_low) >= apart(y_high, y)
            low, high = np.where(left, low, middle), np.where(left, middle, high)
            y_low, y_high = (
                np.where(left[..., None], y_low, y),
                np.where(left[..., None], y, y_high),
            )
        stays = apart(y_high, y_low) > np.maximum(_STAYS * first, _INTEGRAL_TOLERANCE)
        if dims > 1:
            here, beside = (
                np.maximum(apart(at(high + _ABOUT, far), y), apart(y, at(low - _ABOUT, far)))
                for far, y in ((0.0, y_low), (_ASIDE, at(low, _ASIDE)))
            )
            stays &= beside > _STAYS * here
        places = 0.5 * (low + high)

        # Search for the tops of the highest peaks on each line. Toward a pole, values keep growing
        size = np.abs(y_line).max(axis=-1)
        peaks = (size[:, 1:-1] >= size[:, :-2]) & (size[:, 1:-1] >= size[:, 2:])
        top = 1 + np.argpartition(peaks * size[:, 1:-1], -_PEAKS, axis=1)[:, -_PEAKS:]
        window, values = (a[rows[..., None], top[..., None] + (-1, 0, 1)] for a in (t, size))
        for _ in range(_CLIMBS):
            between = 0.5 * (window[..., 1:] + window[..., :-1])
            new = np.abs(at(between.reshape(len(lines), -1))).max(axis=-1).reshape(between.shape)
            five, of_five = (
                np.stack([a[..., 0], b[..., 0], a[..., 1], b[..., 1], a[..., 2]], axis=-1)
                for a, b in ((window, between), (values, new))
            )
            pick = 1 + of_five[..., 1:4].argmax(axis=-1)[..., None] + (-1, 0, 1)
            window, values = (np.take_along_axis(a, pick, axis=-1) for a in (five, of_five))
        grown = values[..., 1] > _GROWN * size[rows, top]
        for peak, heights, at_places in (
            (False, first[stays], places[stays]),
            (True, values[..., 1][grown], window[..., 1][grown]),
        ):
            found += [(peak, -h, axis, b) for h, b in zip(heights, at_places, strict=True)]

    # Take jumps before peaks, and the highest first, while the number of boxes is affordable.
    # If f grows at the border of the cube, no break is needed, because boxes end there
    for peak, _, axis, place in sorted(found):
        if min(place, 1.0 - place) < _ABOUT:
            continue
        if (np.abs(breaks[axis] - place) > (_ABOUT if peak else _SAME_BREAK)).all():
            more = [np.append(b, [place] * (i == axis)) for i, b in enumerate(breaks)]
            boxes = math.prod(len(np.union1d(_uniform(dims), b)) - 1 for b in more)
            if boxes * (2 * _CELL_ORDER[dims]) ** dims <= 2 * budget:
                breaks = more
    return tuple(np.sort(b) for b in breaks), seen


def _uniform(dims: int) -> Array:
    """Return the edges of the first boxes along an axis."""
    return np.linspace(0.0, 1.0, _CELLS[dims] + 1)


def _at_points(function: QuadratureIntegrand, points: Array) -> Array:
    """Return values (K, C) at points (K, d)."""
    steps = range(0, len(points), _BLOCK)
    return np.concatenate([_columns(function, points[i : i + _BLOCK]) for i in steps])


def _after(left: list[Array]) -> Array:
    """Return an estimate of all later changes of an integral, divided by the last change.

    The changes are assumed to form a geometric series.
    If each change is half of the change before, the result is 1.
    Next to a pole, successive changes shrink slowly, and the ratio of changes rises.
    Therefore, if the ratio of successive changes exceeds 0.55, the estimate is increased by half.
    """
    first, last = np.maximum(left[0], 1e-300), left[-1]
    ratio = np.minimum((last / first) ** (1.0 / max(1, len(left) - 1)), _SLOW)
    return np.asarray(np.where(ratio > _HALVES, _UNSETTLED * ratio / (1.0 - ratio), 1.0))


def _hidden(
    levels: list[tuple[Array, Array, Array, Array, Array]],
    points: Array,
    cell: Array,
    seen: Array,
) -> Array:
    """Return `seen` minus the polynomials of the smallest boxes that contain the points: (K, C).

    Each of the `levels` has the lower corners, sizes and values at nodes of its boxes.
    Two flags tell for each box whether it was divided again, and whether its integral changed.
    `cell` is the index of the starting box of each of the points (K, d).
    The result is 0 at points in boxes whose integral changed at the last division.
    """
    dims, found, number = points.shape[1], np.zeros(seen.shape), np.arange(len(points))
    digits = 2 ** np.arange(dims)[::-1]
    for low, size, values, keep, changed in levels:
        of = cell * 2**dims
        part = of + (points[number] >= low[of + 2**dims - 1]) @ digits
        out = ~keep[part] & ~changed[part]
        last = number[out]
        found[last] = _residuals(values, seen[last], points[last], low, size, part[out])
        inside = keep[part]
        number, cell = number[inside], (np.cumsum(keep) - 1)[part[inside]]
    return found


@functools.lru_cache(maxsize=8)
def probe(dims: int, times: int = 1) -> Array:
    """Return points (2^17 `times`, d) that avoid cell borders, nodes and dyadic numbers.

    The points are the same in every call. They form a Latin hypercube.
    Along each axis, the points form a permuted regular grid with an irrational offset.
    A slab normal to an axis is always hit if its width is at least 2^-17.
    A region of volume v that is not a slab is hit by 2^17 points with probability 1 − exp(−2^17 v).
    A region of volume 8e-5 is missed with a probability below 5e-5.
    """
    keys = Stream(times - 1).uniforms(0, dims, times * PROBE)
    offsets = np.sqrt(np.arange(2, 2 + dims) + 0.5)[:, None] % 1.0
    points = np.ascontiguousarray(((np.argsort(keys, axis=1) + offsets) / (times * PROBE)).T)
    points.flags.writeable = False
    return points


def _residuals(
    values: Array, seen: Array, points: Array, low: Array, size: Array, cell: Array
) -> Array:
    """Return residuals (K, C): values `seen` at the points (K, d), minus polynomials.

    The polynomial of each of the N cells interpolates the `values` (N, q^d, C) at its nodes.
    """
    from mcspectra.integrands._kernels import subtract_polynomials

    order = round(values.shape[1] ** (1.0 / points.shape[1]))
    nodes = 2.0 * gauss_rule(order)[0] - 1.0
    inverse = np.linalg.inv(np.polynomial.legendre.legvander(nodes, order - 1))
    found, flat = seen.copy(), np.ascontiguousarray(values).reshape(len(values), -1)
    # A copy of the points can be written to, as numba compiles the kernel for such arrays only
    subtract_polynomials(flat, points.copy(), low, size, inverse, cell, found)
    return found


def _cell_values(
    function: QuadratureIntegrand, low: Array, size: Array, order: int
) -> tuple[Array, Array]:
    """Return values at the nodes of boxes (N, d) and near their corners: (N, q^d or 2^d, C)."""
    dims = low.shape[1]
    nodes = _tensor([gauss_rule(order)[0]] * dims).reshape(-1, dims)
    ends = _tensor([np.array([0.0, 1.0])] * dims).reshape(-1, dims)
    step = max(1, _BLOCK // len(nodes))
    found = []
    for i in range(0, len(low), step):
        first, edge = low[i : i + step, None], size[i : i + step, None]
        least = np.minimum(_LEAST_INSET * (first + edge), 0.25 * edge)
        inset = np.maximum(_INSET[dims > 1] * edge, least)
        inset = inset * (1.0 - 2.0 * ends)
        points = np.concatenate([nodes * edge, ends * edge + inset], axis=1)
        found.append(_columns(function, np.clip(first + points, 0.0, 1.0)))
    both = np.concatenate(found)
    return both[:, : len(nodes)], both[:, len(nodes) :]


def _slivers(values: Array, corners: Array) -> Array:
    """Return a bound of ∫|f| between the outer nodes and the faces of a box: (N, C).

    The result is the bound of ∫|f| divided by the volume of the box.
    It is 0 if f does not jump between the outer nodes and the faces.
    There is a jump if f near a corner differs too much from the polynomial through the nodes.
    Differences count if they exceed a multiple of the last coefficients of the polynomial.
    The last coefficients estimate the error of the polynomial.
    """
    dims = round(math.log2(corners.shape[1]))
    order = round(values.shape[1] ** (1.0 / dims))
    node = gauss_rule(order)[0]
    legendre = np.polynomial.legendre.legvander
    inverse = np.linalg.inv(legendre(2.0 * node - 1.0, order - 1))
    inside = 1.0 - 2.0 * _INSET[dims > 1]
    at_ends = legendre(np.array([-inside, inside]), order - 1) @ inverse
    last: Array = np.zeros(values[:, 0].shape)
    ends = values
    for axis in range(dims):
        tail = inverse[-2:] @ values.reshape(len(values) * order**axis, order, -1)
        last += np.abs(tail).reshape(len(values), -1, values.shape[-1]).max(axis=1)
        ends = at_ends @ ends.reshape(len(values) * 2**axis, order, -1)
    missed = np.abs(corners - ends.reshape(corners.shape))
    missed[missed <= _SMOOTH * last[:, None]] = 0.0
    return np.asarray(missed.sum(axis=1) * node[0] * 2.0 ** (1 - dims))


def lattice_integral(function: QuadratureIntegrand) -> Estimate:
    """Return ∫ f in any number of dims as a mean over 2^20 Kronecker points: value (C,).

    The points are ½ + k α modulo 1, with the steps α of `golden_vector`.
    The points are divided into 16 successive parts, which are shifted copies of each other.
    The error is three standard errors of the mean over the 16 parts. The true error is smaller.
    """
    alpha, sums = golden_vector(function.dims), []
    for start in range(1, _LATTICE_POINTS, 2**14):
        points = (0.5 + np.arange(start, start + 2**14)[:, None] * alpha) % 1.0
        sums.append(_columns(function, points).sum(axis=0))
    means = np.array(sums).reshape(16, -1, len(sums[0])).sum(axis=1) * (16 / _LATTICE_POINTS)
    value, spread = means.mean(axis=0), means.std(axis=0, ddof=1) / math.sqrt(len(means))
    method = "mean over 2^20 points of a Kronecker sequence"
    return Estimate(value, float(_SIGMAS * spread.max()), method)


def axis_rules(f: QuadratureIntegrand, half_width: int) -> list[AxisRule]:
    """Return composite Gauss-Legendre rules with 16 nodes per wavelength, or fewer beyond 2-D.

    Raises
    ------
    ParameterError
        If the product of the rules has more than 2^24 nodes.
    """
    least = _PRODUCT_NODES.get(f.dims, 16)
    for per_wave in (16, 8, 4):
        count = 1 << (max(least, per_wave * half_width) - 1).bit_length()
        if float(count) ** f.dims <= _LIMIT:
            return [AxisRule.make(count, min(_ORDER, count), breaks) for breaks in f.breaks]
    raise ParameterError(
        f"The coefficients of {f.spec} up to half width {half_width} in {f.dims} dims take "
        f"{float(count) ** f.dims:.2g} evaluations, more than {_LIMIT:.2g}; lower ",
        Parameter("half_width"),
        ".",
    )


def product_coefficients(
    f: QuadratureIntegrand, rules: Sequence[AxisRule], functions: Sequence[Array]
) -> Array:
    """Return ∫ f Π_i φ_i for all products of real functions φ_i of one coordinate each.

    Parameters
    ----------
    f
        The integrand.
    rules
        A rule for each axis, with P_i nodes.
    functions
        Values of the functions at the nodes of each axis, (P_i, N_i).

    Returns
    -------
    ndarray
        float64 of shape (channels or 1, N_0 · … · N_{d−1}), in C order.
    """
    total: Array | float = 0.0
    for start, values in slabs(f, rules):
        weighted = [rule.weights[:, None] * phi for rule, phi in zip(rules, functions, strict=True)]
        weighted[0] = weighted[0][start : start + values.shape[1]]
        # Sum the values (C, P_0, …) over nodes, axis by axis. Each sum appends an axis
        for phi in weighted:
            values = np.tensordot(values, phi, axes=([1], [0]))
        total = total + values
    return np.asarray(total).reshape(max(1, f.channels), -1)


def cell_integrals(f: QuadratureIntegrand, size: int) -> tuple[Array, str]:
    """Return ∫ f over size^d equal cells: float64 (channels or 1, size^d), and the method.

    Raises
    ------
    ParameterError
        If the nodes of the cells need more than 2^24 evaluations.
    """
    cells = float(size) ** f.dims
    if cells > _LIMIT:
        raise ParameterError(
            f"{cells:.2g} cells in {f.dims} dims are more than {_LIMIT:.2g}; lower ",
            Parameter("half_width"),
            " or levels.",
        )
    # Use the means over boxes, if the integrand has them
    low = np.stack(np.meshgrid(*[np.arange(size) / size] * f.dims, indexing="ij"), axis=-1)
    low = low.reshape(-1, f.dims)
    moments = f.box_moments(low, low + 1.0 / size)
    if moments is not None:
        return np.asarray(moments[0]).reshape(len(low), -1).T / cells, "exact"

    # Otherwise sum over the nodes of each cell, slab by slab
    nodes = _CELL_NODES.get(f.dims, 2)
    while nodes > 1 and (float(nodes) * size) ** f.dims > _LIMIT:
        nodes //= 2
    order = min(nodes, _ORDER)
    rules = [AxisRule.make(size * nodes, order, breaks) for breaks in f.breaks]
    cell = [np.floor(rule.nodes * size).astype(np.int64) for rule in rules]
    total = np.zeros((max(1, f.channels), *[size] * f.dims))
    for start, values in slabs(f, rules):
        stop = start + values.shape[1]
        for axis in range(f.dims, 1, -1):
            values = _sum_by(values, axis, rules[axis - 1].weights, cell[axis - 1])
        values = _sum_by(values, 1, rules[0].weights[start:stop], cell[0][start:stop])
        total[:, np.unique(cell[0][start:stop])] += values
    return total.reshape(len(total), -1), "composite Gauss-Legendre quadrature"


def _sum_by(values: Array, axis: int, weights: Array, cell: Array) -> Array:
    """Return weighted sums of values over the nodes of each cell on an axis; skip empty cells."""
    order = np.argsort(cell, kind="stable")
    first = np.flatnonzero(np.diff(cell[order], prepend=-1))
    shape = [1] * values.ndim
    shape[axis] = -1
    weighted = np.take(values, order, axis=axis) * weights[order].reshape(shape)
    return np.asarray(np.add.reduceat(weighted, first, axis=axis))
