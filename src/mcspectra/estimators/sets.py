"""Relations between the point sets of several techniques: independent, shared or joint.

* ``"independent"``: each technique draws a set of its own, from a stream of its own. Covariances
  between techniques are 0.
* ``"shared"``: all techniques get the same primary points; their counts must be equal. Techniques
  whose integrands vary against each other then cancel, others add up.
* ``"joint"``: one set of n · Σ counts points is split. Of a *sequence* (`Sampler.sequence`) technique
  t gets a run of n · counts[t] consecutive points, the first technique the first ones. Other sets
  are dealt: of every Σ counts consecutive points, counts[t] chosen at random go to technique t.
  Neighbors in order are neighbors in space for strata, so that each technique gets a share of
  every neighborhood; the random choice makes each technique's points uniform, hence unbiased.
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

_TECHNIQUE = 1 << 20  # stream labels of the second and further techniques
_DEAL = (1 << 20) - 1  # and of the choice of who gets which point of a joint set


def check_sets(sets: object, counts: tuple[int, ...]) -> str:
    """Return `sets` if it is one of `SETS` and possible with these counts."""
    chosen = as_choice("sets", sets, SETS)
    if chosen == "shared" and len(set(counts)) > 1:
        raise ParameterError(
            f"sets is 'shared' and counts is {list(counts)}; techniques that share their points "
            "need equal counts."
        )
    return chosen


def set_sizes(sets: str, counts: tuple[int, ...], n: int) -> list[int]:
    """Sizes of the sets that are drawn of the sampler."""
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
    """Points of each technique, (count, n · counts[t], d), for realizations first … first+count−1.

    The first draw uses `stream` itself: it gets the points of ``sampler.draw(size, rng)``.
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

    # Deal each group of Σ counts consecutive points to the techniques
    total, group = n * sum(counts), sum(counts)
    keys = stream.child(_DEAL).uniforms(first, count, total).reshape(count, n, group)
    order = np.argsort(keys, axis=2)[..., None]
    mixed = np.take_along_axis(drawn[0].reshape(count, n, group, -1), order, axis=2)
    parts = np.split(mixed, np.cumsum(counts)[:-1], axis=2)
    return [part.reshape(count, -1, sampler.dims) for part in parts]
