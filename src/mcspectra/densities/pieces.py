"""Products of 1-D densities that are constant or linear between given positions on each axis.

`AlignedStrata` moves edges to borders of strata.
Points of equal weight need strata of equal volume.
Borders of equal strata miss an edge, unless n times the position of the edge is a whole number.
Strata of unequal volume need weighted points. A warp provides both the strata and the weights.

Let s be the number of strata. The piece j between two edges, of length L_j, gets k_j strata.
All k_j are at least 1, and nearly proportional to the L_j. The density is p = k_j/(s L_j).
Its cdf maps the edges to (k_0 + … + k_j)/s in primary space, which are borders of equal strata.
The weights 1/p differ from 1 only by the rounding of the k_j. The estimator is unbiased.

An alternative is to round the numbers k_j of strata at random, and to use equal weights.
With random rounding, however, an edge would still cut strata and determine the variance.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array, as_integer, as_real, as_real_array
from mcspectra.core.display import counted
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import checked, settle
from mcspectra.densities.base import Density
from mcspectra.densities.tabulated import check_masses, shown

__all__ = [
    "AlignedStrata",
    "GridDensity",
    "PiecewiseLinear",
]

_MAX_GRID_DIMS = 64
_MAX_BINS = 4096
_MOST_STRATA = 2**24
_MOST_EDGES = 4096
_LEAST_WIDTH = 1e-15
_SAME_SLOPE = 1e-12


def _piece(ends: Array, x: Array) -> Array:
    """Return j with ends[j] <= x < ends[j+1]. The point 1 belongs to the last piece."""
    return np.asarray(np.clip(np.searchsorted(ends, x, side="right") - 1, 0, len(ends) - 2))


def _as_edges(name: str, edges: Any) -> Any:
    """Convert edges to a tuple of ascending positions, or to one tuple of positions per dim."""
    if not isinstance(edges, Sequence | np.ndarray) or isinstance(edges, str):
        raise ParameterError(
            f"edges is {edges!r:.80}; give a list of places in (0, 1), one list per dim."
        )
    nested = len(edges) > 0 and isinstance(edges[0], Sequence | np.ndarray)
    found = []
    for axis in edges if nested else [edges]:
        if not isinstance(axis, Sequence | np.ndarray) or isinstance(axis, str):
            raise ParameterError(f"edges holds {axis!r:.80}; give one list of places for each dim.")
        if len(axis) > _MOST_EDGES:
            raise ParameterError(f"edges has {len(axis)} places; give at most {_MOST_EDGES}.")
        places = tuple(as_real(name, e, above=0.0) for e in axis)
        if any(not a < b for a, b in itertools.pairwise((0.0, *places, 1.0))):
            raise ParameterError(f"edges is {list(places)}; give ascending places in (0, 1).")
        found.append(places)
    return tuple(found) if nested else found[0]


@final
@dataclass(frozen=True, kw_only=True)
class AlignedStrata(Density):
    """Piecewise constant density whose warp moves edges to borders of equal strata.

    Attributes
    ----------
    edges
        Ascending positions in (0, 1): one list in 1-D, else one list per dim, which may be empty.
    strata
        Number of strata s along each axis: one number for all dims, or one per dim.
        For jittered samples, n = s^d.
    """

    edges: Any = checked(_as_edges)
    strata: int | Sequence[int] = 16

    def _check(self) -> None:
        strata = self.strata
        several = isinstance(strata, Sequence | np.ndarray) and not isinstance(strata, str)
        sides: Any = tuple(strata) if several else (strata,) * self.dims  # type: ignore[arg-type]
        if len(sides) != self.dims:
            raise ParameterError(
                f"strata has {counted(len(sides), 'number')}; give one for each of {self.dims} "
                "dims."
            )
        numbers = tuple(as_integer("strata", s, least=1, most=_MOST_STRATA) for s in sides)
        settle(self, strata=numbers if several else numbers[0])
        for s, axis in zip(numbers, self._per_axis, strict=True):
            if len(axis) + 1 > s:
                raise ParameterError(
                    f"{len(axis)} edges make {len(axis) + 1} pieces, but strata is {s}; give "
                    "at least one stratum for each piece."
                )

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims: 1 for a list of edges, else the number of lists."""
        return len(self._per_axis)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Positions of the edges in primary space, on borders of strata."""
        return tuple(tuple(u[1:-1].tolist()) for _, u, _ in self._pieces)

    def reciprocal_integral(self) -> float:
        """Return ∫ 1/p: the product over axes of Σ L_j/p_j."""
        return float(np.prod([(np.diff(x) / p).sum() for x, _, p in self._pieces]))

    @property
    def _per_axis(self) -> tuple[tuple[float, ...], ...]:
        nested = bool(self.edges) and isinstance(self.edges[0], tuple)
        return self.edges if nested else (self.edges,)

    @cached_property
    def _pieces(self) -> list[tuple[Array, Array, Array]]:
        """For each axis, the ends of the pieces in x and in u, and the density in each piece."""
        given: Any = self.strata
        sides = given if isinstance(given, tuple) else (given,) * self.dims
        found = []
        for edges, strata in zip(self._per_axis, sides, strict=True):
            ends = np.array([0.0, *edges, 1.0])
            counts = _allocated(np.diff(ends), strata)
            share = np.concatenate([[0], np.cumsum(counts)]) / strata
            found.append((ends, share, counts / (strata * np.diff(ends))))
        return found

    def _pdf(self, x: Array) -> Array:
        out = np.ones(x.shape[:-1])
        for i, (ends, _, p) in enumerate(self._pieces):
            out *= p[_piece(ends, x[..., i])]
        return out

    def _sample(self, u: Array) -> Array:
        pairs = [_mapped(u[..., i], b, a) for i, (a, b, _) in enumerate(self._pieces)]
        return np.stack(pairs, axis=-1)

    def _invert(self, x: Array) -> Array:
        pairs = [_mapped(x[..., i], a, b) for i, (a, b, _) in enumerate(self._pieces)]
        return np.stack(pairs, axis=-1)


def _allocated(lengths: Array, strata: int) -> Array:
    """Return whole numbers ≥ 1 near `strata` · lengths, of sum `strata`, by largest remainders.

    Each piece gets at least one stratum, even a piece that is shorter than a stratum.
    The longer pieces divide the remaining strata in proportion to their lengths.
    """
    counts = np.ones(len(lengths), np.int64)
    long = np.ones(len(lengths), bool)
    while True:
        left = strata - np.count_nonzero(~long)
        quota = left * lengths / lengths[long].sum()
        short = long & (quota < 1.0)
        if not short.any():
            break
        long &= ~short
    counts[long] = np.floor(quota[long]).astype(np.int64)
    missing = strata - int(counts.sum())
    remainder = np.where(long, quota - np.floor(quota), -1.0)
    counts[np.argsort(-remainder, kind="stable")[:missing]] += 1
    return counts


def _mapped(x: Array, source: Array, target: Array) -> Array:
    """Map x by the piecewise linear function from the positions `source` to `target`.

    Rounding never moves a point across the border between two pieces.
    """
    j = _piece(source, x)
    slope = np.diff(target) / np.diff(source)
    moved = target[j] + (x - source[j]) * slope[j]
    inside = np.minimum(moved, np.nextafter(target[j + 1], 0.0))
    return np.asarray(np.where(x < source[j + 1], inside, target[j + 1]))


def _as_lines(name: str, given: Any) -> tuple[tuple[float, ...], ...]:
    """Convert the borders of the bins of each dim to tuples, and check them."""
    if not isinstance(given, Sequence | np.ndarray) or not len(given):
        raise ParameterError(f"{name} is {given!r:.80}; give one list of borders for each dim.")
    lines = [given] if np.ndim(given[0]) == 0 else given
    if len(lines) > _MAX_GRID_DIMS:
        raise ParameterError(f"{name} has {len(lines)} dims; give at most {_MAX_GRID_DIMS}.")
    found = []
    for i, line in enumerate(lines):
        own = f"{name}[{i}]"
        nodes = as_real_array(own, line)
        if nodes.ndim != 1 or not 2 <= nodes.size <= _MAX_BINS + 1:
            raise ParameterError(
                f"{own} has shape {nodes.shape}; give 2 to {_MAX_BINS + 1} borders from 0 to 1."
            )
        widths = np.diff(nodes)
        if nodes[0] != 0.0 or nodes[-1] != 1.0 or not (widths >= _LEAST_WIDTH).all():
            raise ParameterError(
                f"{own} runs from {nodes[0]:g} to {nodes[-1]:g} with a smallest step of "
                f"{widths.min():g}; borders must increase from 0 to 1 in steps of "
                f"{_LEAST_WIDTH:g} or more."
            )
        found.append(tuple(nodes.tolist()))
    return tuple(found)


@final
@dataclass(frozen=True, kw_only=True)
class GridDensity(Density):
    """Product over the dims of histograms with bins of equal probability.

    VEGAS adapts maps of this kind [Lepage1978]_, so the borders can come from VEGAS.

    Attributes
    ----------
    nodes
        Increasing borders of the bins of each dim: N + 1 numbers from 0 to 1 for N bins.
        N may differ between dims. In 1-D, `nodes` may be the list of borders itself.
        u in [i/N, (i+1)/N) maps linearly to bin i, where p_i = 1/(N width_i).
    """

    name: ClassVar[str] = "grid"
    nodes: Any = checked(_as_lines)

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims, which is the number of lists of nodes."""
        return len(self.nodes)

    @cached_property
    def _lines(self) -> list[Array]:
        return [np.array(line) for line in self.nodes]

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Positions i/N of the borders between bins of different width."""
        return tuple(
            tuple((1 + np.flatnonzero(np.diff(np.diff(line)))) / (len(line) - 1))
            for line in self._lines
        )

    def reciprocal_integral(self) -> float:
        """Return ∫ 1/p = Π N Σ width²."""
        sums = [(len(line) - 1) * float((np.diff(line) ** 2).sum()) for line in self._lines]
        return float(np.prod(sums))

    def _pdf(self, x: Array) -> Array:
        p = np.ones(x.shape[:-1])
        for axis, line in enumerate(self._lines):
            p /= (line.size - 1) * np.diff(line)[_piece(line, x[..., axis])]
        return p

    def _sample(self, u: Array) -> Array:
        x = np.empty(u.shape)
        for axis, line in enumerate(self._lines):
            scaled = np.minimum(u[..., axis], BELOW_ONE) * (line.size - 1)
            i = np.minimum(scaled.astype(np.int64), line.size - 2)
            value = line[i] + (scaled - i) * np.diff(line)[i]
            x[..., axis] = np.minimum(value, np.nextafter(line[i + 1], 0.0))
        return x

    def _invert(self, x: Array) -> Array:
        u = np.empty(x.shape)
        for axis, line in enumerate(self._lines):
            i = _piece(line, x[..., axis])
            u[..., axis] = (i + (x[..., axis] - line[i]) / np.diff(line)[i]) / (line.size - 1)
        return u


def _as_nodes(name: str, values: object) -> Any:
    """Check relative densities that are given at nodes."""
    table = as_real_array(name, values).copy()
    if table.ndim != 1 or table.size < 2:
        raise ParameterError(
            f"{name} have shape {table.shape}; give a flat list of at least two nodes."
        )
    return shown(check_masses(table))


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class PiecewiseLinear(Density):
    """1-D density that is linear between nodes at x = 0, 1/(k−1), …, 1, given by its values there.

    Attributes
    ----------
    values
        Relative density at each of k ≥ 2 nodes: at least 0 and not all 0. The scale is arbitrary.
        Cells between two nodes of density 0 get no samples.

    Notes
    -----
    Consider a cell with the densities a and b at its ends.
    The share r of the cell's mass lies left of t = (a + b) r/(a + √D) with D = a² + (b² − a²) r.
    As in `Linear`, the formula starts from the lower end, so that all terms are positive.
    The formula has no cancellation if a is close to b, or if a or b is 0.
    """

    dims: int = field(default=1, init=False)
    values: Any = checked(_as_nodes)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """The cdf at the inner nodes at which the slope changes."""
        bend = np.abs(np.diff(self._nodes, 2)) > _SAME_SLOPE
        found = np.unique(self._cdf[1:-1][bend])
        return (tuple(found[(found > 0) & (found < 1)].tolist()),)

    def zero_points(self) -> Array:
        """Return the centers of the empty cells."""
        return ((np.flatnonzero(self._masses == 0) + 0.5) / self._masses.size)[:, None]

    def reciprocal_integral(self) -> float:
        """Return ∫ 1/p: the mean over cells of ln(b/a)/(b − a). It is infinite if a node is 0."""
        p = self._nodes / self._masses.mean()
        if not p.all():
            return math.inf
        mean, t = 0.5 * (p[1:] + p[:-1]), (p[1:] - p[:-1]) / (p[1:] + p[:-1])
        stretch = np.divide(np.arctanh(t), t, out=np.ones_like(t), where=t != 0)
        return float((stretch / mean).mean())

    @cached_property
    def _nodes(self) -> Array:
        values = np.asarray(self.values, np.float64)
        return np.asarray(values / values.max())

    @cached_property
    def _masses(self) -> Array:
        return np.asarray(0.5 * (self._nodes[1:] + self._nodes[:-1]))

    @cached_property
    def _cdf(self) -> Array:
        """Cdf at the nodes (k,), from 0 to exactly 1."""
        sums = np.concatenate([[0.0], np.cumsum(self._masses)])
        return np.asarray(sums / sums[-1])

    def _cell(self, x: Array) -> tuple[Array, Array]:
        """Return the cell that contains x and the position t in it, from 0 to 1."""
        scaled = x * self._masses.size
        cell = np.minimum(scaled.astype(np.int64), self._masses.size - 1)
        return cell, scaled - cell

    def _pdf(self, x: Array) -> Array:
        cell, t = self._cell(x[..., 0])
        line = (1.0 - t) * self._nodes[cell] + t * self._nodes[cell + 1]
        return np.asarray(line / self._masses.mean())

    def _sample(self, u: Array) -> Array:
        # Take the last cell that starts at or below u. This skips empty cells
        cell = np.searchsorted(self._cdf[:-1], u, side="right") - 1
        low, high = self._cdf[cell], self._cdf[cell + 1]
        share = np.divide(u - low, high - low, out=np.zeros_like(u), where=high > low)
        # Scale both ends so that no square underflows
        top = np.maximum(self._nodes[cell], self._nodes[cell + 1])
        top = np.maximum(top, np.finfo(float).tiny)
        a, b = self._nodes[cell] / top, self._nodes[cell + 1] / top
        rising = a * a + (b * b - a * a) * share
        falling = b * b + (a * a - b * b) * (1.0 - share)
        bottom = a + np.sqrt(np.where(b >= a, rising, falling))
        t = np.divide((a + b) * share, bottom, out=np.zeros_like(share), where=bottom > 0)
        return np.asarray((cell + np.minimum(t, 1.0)) / self._masses.size)

    def _invert(self, x: Array) -> Array:
        cell, t = self._cell(x)
        a, b = self._nodes[cell], self._nodes[cell + 1]
        part = t * np.where(b >= a, a + 0.5 * t * (b - a), a - 0.5 * t * (a - b))
        return np.asarray(np.minimum(self._cdf[cell] + part / self._masses.sum(), 1.0))
