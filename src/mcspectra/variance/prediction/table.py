"""The route of samplers of which nothing is known but their sets: measured on a table of g.

The table holds g at the middles of fine cells, once for all samplers and counts, and is linear between
them. Its variance is measured with sets of the sampler; what the table leaves out is as fine as its cells,
and counts as white: ∫(g − table)²/n.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import NoClosedForm
from mcspectra.core.streams import Stream
from mcspectra.estimators import Estimator
from mcspectra.estimators.moments import CONFIDENCE_Z, rounding_floor
from mcspectra.integrands import Integrand
from mcspectra.integrands.base import Derived
from mcspectra.samplers.base import Sampler
from mcspectra.variance.convergence import count_moments
from mcspectra.variance.prediction.known import Known, Predicted

__all__ = ["of_table"]

_CELLS = {1: 2**16, 2: 2**10, 3: 100}  # along each axis
_PROBE = 2**16  # points, random, at which the table is held against g
_BLOCK = 2**16  # points at a time
_POINTS = 2**22  # of all sets together, about a second
_LEAST, _MOST = 200, 10_000  # sets


@final
@dataclass(frozen=True, eq=False)
class _Table(Derived):
    """Values at the middles of cells, ((cells,) * dims flattened, channels or 1), linear between them."""

    name: ClassVar[str] = "table"
    text = "a table of {0.integrand.spec}"
    integrand: Integrand
    values: Array

    @property
    def is_black_box(self) -> bool:
        return False

    @property
    def evaluations_per_point(self) -> int:
        return 0

    def _integral(self) -> Any:
        mean = self.values.mean(axis=0)
        return mean if self.channels else mean[0]

    def _evaluate(self, x: Array) -> Array:
        cells = _CELLS[self.dims]
        place = x * cells - 0.5
        low = np.clip(place.astype(np.int64), 0, cells - 2)  # beyond the outermost nodes as inside
        part = place - low
        total = np.zeros((*x.shape[:-1], self.values.shape[1]))
        for corner in itertools.product((0, 1), repeat=self.dims):
            index = np.zeros(x.shape[:-1], np.int64)
            weight = np.ones(x.shape[:-1])
            for axis, side in enumerate(corner):
                index = index * cells + low[..., axis] + side
                weight = weight * (part[..., axis] if side else 1.0 - part[..., axis])
            total += weight[..., None] * self.values[index]
        return total if self.channels else total[..., 0]


def of_table(sampler: Sampler, n: int, known: Known, stream: Stream) -> Predicted:
    """Measure a table of g with sets of the sampler, and add what the table leaves out."""
    if known.g.dims not in _CELLS or known.g.costly:
        raise NoClosedForm("A table takes 1 to 3 dims, and a million evaluations.")
    if np.isinf(known.square[0]).any():
        raise NoClosedForm("∫g² diverges.")
    table, missed, miss = known.once("table", lambda: _tabulated(known.g))
    sets = min(max(_POINTS // n, _LEAST), _MOST)
    moments = count_moments(Estimator(table), sampler, n, sets, stream)
    if not (moments.resolved & (moments.variance > rounding_floor(moments.mean))).all():
        raise NoClosedForm(f"{sets} sets do not tell the variance of {sampler.spec}.")
    tail = missed / n
    # Points may be as good within cells as they are beyond, or as bad as at random
    error = CONFIDENCE_Z * moments.relative_se * moments.variance + tail + miss / n
    share = 1.0 - np.minimum(missed / known.square[0], 1.0)
    return Predicted(moments.variance + tail, error, share, tail, f"{sets} sets on a table of g")


def _tabulated(g: Integrand) -> tuple[_Table, Array, Array]:
    """A table of g, and ∫(g − table)² with half its 95 % interval, by channel."""
    cells = _CELLS[g.dims]
    middle = (np.arange(cells) + 0.5) / cells
    nodes = np.stack(np.meshgrid(*[middle] * g.dims, indexing="ij"), axis=-1)
    nodes = nodes.reshape(-1, g.dims)
    values = np.concatenate([g(nodes[i : i + _BLOCK]) for i in range(0, len(nodes), _BLOCK)])
    table = _Table(g, values.reshape(len(nodes), -1))
    probe = np.random.default_rng(0).random((_PROBE, g.dims))
    missed = ((g(probe) - table(probe)) ** 2).reshape(_PROBE, -1)
    error = CONFIDENCE_Z * missed.std(axis=0, ddof=1) / math.sqrt(_PROBE)
    return table, missed.mean(axis=0), error
