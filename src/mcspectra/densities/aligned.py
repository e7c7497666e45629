"""Strata with borders at given edges, as a density that is constant between them.

Points of equal weight need strata of equal volume, whose borders do not fall on an edge unless n times
its place is a whole number; strata of other volumes need weights. Both come from a warp: k_j of s
strata are given to a piece between edges, in proportion to its length L_j and at least one, and the
piecewise constant density p = k_j/(s L_j) has the edges at (k_0 + … + k_j)/s of primary space, on
borders of the s equal strata there. Weights 1/p differ from 1 by the rounding of the k_j alone, and the
estimator is unbiased. (Rounding the k_j at random, with equal weights, would be as well, but its
variance is that of the strata that an edge cuts.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real
from mcspectra.core.errors import ParameterError
from mcspectra.densities.base import Density

__all__ = ["AlignedStrata"]

_MOST_STRATA = 2**24
_MOST_EDGES = 4096


@final
@dataclass(frozen=True, kw_only=True)
class AlignedStrata(Density):
    """Piecewise constant, so that equal strata of primary space have borders at given edges.

    Attributes
    ----------
    edges
        Ascending places in (0, 1): a list in 1-D, else one list, which may be empty, for each dim.
    strata
        s, strata along each axis, one number or one for each dim; n = s^d for jittered samples.
    """

    name: ClassVar[str] = "aligned-strata"
    edges: Any
    strata: int | Sequence[int] = 16

    def __post_init__(self) -> None:
        object.__setattr__(self, "edges", _checked_edges(self.edges))
        strata = self.strata
        several = isinstance(strata, Sequence | np.ndarray) and not isinstance(strata, str)
        sides: Any = tuple(strata) if several else (strata,) * self.dims  # type: ignore[arg-type]
        if len(sides) != self.dims:
            raise ParameterError(
                f"strata has {len(sides)} numbers; give one for each of {self.dims} dims."
            )
        checked = tuple(as_integer("strata", s, least=1, most=_MOST_STRATA) for s in sides)
        object.__setattr__(self, "strata", checked if several else checked[0])
        for s, axis in zip(checked, self._per_axis, strict=True):
            if len(axis) + 1 > s:
                raise ParameterError(
                    f"{len(axis)} edges make {len(axis) + 1} pieces, but strata is {s}; give at "
                    "least one stratum for each piece."
                )

    @property
    def dims(self) -> int:  # type: ignore[override]
        """1 for a list of edges, else the number of lists."""
        return len(self._per_axis)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Borders of primary-space strata that the edges are mapped to."""
        return tuple(tuple(u[1:-1].tolist()) for _, u, _ in self._pieces)

    def reciprocal_integral(self) -> float:
        """Product over axes of Σ L_j/p_j."""
        return float(np.prod([(np.diff(x) / p).sum() for x, _, p in self._pieces]))

    @property
    def _per_axis(self) -> tuple[tuple[float, ...], ...]:
        nested = bool(self.edges) and isinstance(self.edges[0], tuple)
        return self.edges if nested else (self.edges,)

    @cached_property
    def _pieces(self) -> list[tuple[Array, Array, Array]]:
        """For each axis the ends of the pieces in x and in u, and the density of each piece."""
        given: Any = self.strata
        sides = given if isinstance(given, tuple) else (given,) * self.dims
        return [_axis_pieces(e, s) for e, s in zip(self._per_axis, sides, strict=True)]

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


def _checked_edges(edges: Any) -> Any:
    """Return a tuple of ascending places, or of such tuples."""
    if not isinstance(edges, Sequence | np.ndarray) or isinstance(edges, str):
        raise ParameterError(
            f"edges is {edges!r}; give a list of places in (0, 1), one list a dim."
        )
    nested = len(edges) > 0 and isinstance(edges[0], Sequence | np.ndarray)
    if nested:
        return tuple(_checked_axis(axis) for axis in edges)
    return _checked_axis(edges)


def _checked_axis(axis: Any) -> tuple[float, ...]:
    if not isinstance(axis, Sequence | np.ndarray) or isinstance(axis, str):
        raise ParameterError(f"edges holds {axis!r}; give one list of places for each dim.")
    if len(axis) > _MOST_EDGES:
        raise ParameterError(f"edges has {len(axis)} places; give at most {_MOST_EDGES}.")
    places = tuple(as_real("edges", e, above=0.0) for e in axis)
    if any(not a < b for a, b in zip((0.0, *places), (*places, 1.0), strict=True)):
        raise ParameterError(f"edges is {list(places)}; give ascending places in (0, 1).")
    return places


def _axis_pieces(edges: tuple[float, ...], strata: int) -> tuple[Array, Array, Array]:
    ends = np.array([0.0, *edges, 1.0])
    counts = _allocated(np.diff(ends), strata)
    share = np.concatenate([[0], np.cumsum(counts)]) / strata
    return ends, share, counts / (strata * np.diff(ends))


def _allocated(lengths: Array, strata: int) -> Array:
    """Whole numbers that add up to `strata`, at least 1, near `strata` · lengths: largest remainders.

    Where short pieces take more than their share, the others share what is left.
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


def _piece(ends: Array, x: Array) -> Array:
    return np.clip(np.searchsorted(ends, x, side="right") - 1, 0, len(ends) - 2)


def _mapped(x: Array, source: Array, target: Array) -> Array:
    """Map pieces between ends linearly, each to its own side of the borders also when rounded."""
    j = _piece(source, x)
    slope = np.diff(target) / np.diff(source)
    moved = target[j] + (x - source[j]) * slope[j]
    inside = np.minimum(moved, np.nextafter(target[j + 1], 0.0))
    return np.asarray(np.where(x < source[j + 1], inside, target[j + 1]))
