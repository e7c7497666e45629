"""Relations between the point sets of the techniques: independent, shared or joint.

* ``"independent"``: each technique draws its own set from its own random stream.
  Covariances between techniques are 0.
* ``"shared"``: all techniques use the same primary points, so their counts must be equal.
  Errors cancel if techniques vary in opposite ways, and add up otherwise.
* ``"joint"``: one set of n · Σ counts points is divided among the techniques.
  From a *sequence* (`Sampler.sequence`), technique t gets n · counts[t] consecutive points.
  Other sets are divided into groups of Σ counts consecutive points.
  From each group, technique t gets counts[t] points that are chosen at random.
  Consecutive points of strata are neighbors in space,
  so each technique has points in every neighborhood.
  The random choice makes the points of each technique uniform, so estimates are unbiased.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream

if TYPE_CHECKING:
    from mcspectra.samplers.base import Sampler

__all__ = ["SETS", "check_sets", "draw_sets", "set_sizes"]

SETS = ("independent", "shared", "joint")

_TECHNIQUE = 1 << 20  # Random stream of the second technique
_DEAL = (1 << 20) - 1  # Random stream that divides a joint set among the techniques


def check_sets(sets: object, counts: tuple[int, ...]) -> str:
    """Return `sets` if it is one of `SETS` and is possible with these counts."""
    chosen = as_choice("sets", sets, SETS)
    if chosen == "shared" and len(set(counts)) > 1:
        raise ParameterError(
            f"sets is 'shared' and counts is {list(counts)}; techniques that share their points "
            "need equal counts."
        )
    return chosen


def set_sizes(sets: str, counts: tuple[int, ...], n: int) -> list[int]:
    """Return the sizes of the point sets that are drawn from the sampler."""
    if sets == "joint":
        return [n * sum(counts)]
    return [n * counts[0]] if sets == "shared" else [n * count for count in counts]


def draw_sets(
    sets: str,
    counts: tuple[int, ...],
    sampler: Sampler,
    n: int,
    stream: Stream,
    first: int,
    count: int,
) -> list[Array]:
    """Return the points of each technique, (count, n · counts[t], d), for several realizations.

    The realizations are first … first+count−1. The first set is drawn with `stream` itself,
    so its points equal those of ``sampler.draw(size, rng)``.
    """
    sizes = set_sizes(sets, counts, n)
    streams = [stream, *(stream.child(_TECHNIQUE + t) for t in range(1, len(sizes)))]
    drawn = [
        sampler.draw_stream(size, own, first, count)
        for size, own in zip(sizes, streams, strict=True)
    ]
    if sets == "shared":
        return drawn * len(counts)
    if sets == "independent":
        return drawn
    if sampler.sequence:
        return np.split(drawn[0], np.cumsum([n * c for c in counts])[:-1], axis=1)

    # Distribute the points of each group of Σ counts consecutive points to the techniques
    total, group = n * sum(counts), sum(counts)
    keys = stream.child(_DEAL).uniforms(first, count, total).reshape(count, n, group)
    order = np.argsort(keys, axis=2)[..., None]
    mixed = np.take_along_axis(drawn[0].reshape(count, n, group, -1), order, axis=2)
    parts = np.split(mixed, np.cumsum(counts)[:-1], axis=2)
    return [part.reshape(count, -1, sampler.dims) for part in parts]
