"""Samplers as renderers use them: each request of a path for random numbers has its own set.

A path requests random numbers one or two at a time (`mcspectra.rendering.paths.Dimension`).
A renderer answers each request with a separate, shuffled set in one or two dims.
Random numbers of different requests are therefore independent.
If a single point set had all dims of a path, numbers of different requests would be dependent.
Rendered images have no such dependence between different requests.
The variances with separate sets and with a single set differ by factors of up to 6.

`Padded` draws the points that our Mitsuba plugin gives to a pixel.
The first `joint_dims` numbers come from one set of the sampler, as in the plugin.
Mitsuba's own samplers are also padded, because they shuffle the points at each request.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_joint_dims
from mcspectra.core.errors import McspectraError
from mcspectra.core.fields import settle
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.rendering.paths import Dimension, in_dims
from mcspectra.rendering.plugin import joint_dims_of, joint_sampler, padded_sets
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.samplers.law import Independent

__all__ = ["Padded", "as_rendered", "padding_note", "requests_of"]

_FIRST_PAD = 16  # label of the random stream for the first random numbers of a path


def requests_of(dimensions: Sequence[Dimension]) -> tuple[int, ...]:
    """Return how many numbers each request of a path takes (1 or 2), in order of the requests."""
    found: list[int] = []
    for use in dimensions:
        if use.part == "y" and found and found[-1] == 1:
            found[-1] = 2
        else:
            found.append(1)
    return tuple(found)


def as_rendered(
    sampler: Sampler | str, dimensions: Sequence[Dimension], joint_dims: int | None = None
) -> Sampler:
    """Return the sampler of a path's random numbers, in the way that a renderer uses it.

    Parameters
    ----------
    sampler
        A sampler or its spec.
        Samplers without a spec, such as given points, are returned unchanged: all dims are joint.
        Random points are also returned unchanged: padding does not change their distribution.
    dimensions
        The bounce and the decision for which each random number of the path is used.
    joint_dims
        How many of the first numbers come from one joint set; 0 for none.
        The default comes from `joint_dims_of`. If all numbers are joint, `sampler` is returned.

    Raises
    ------
    ParameterError
        If `joint_dims` is 1 or not a whole number, or the sampler has too few dims.
    """
    dims = len(dimensions)
    joint = None
    if joint_dims is not None:
        joint = as_integer("joint_dims", joint_dims, least=0)
        joint = joint if joint >= dims > 1 else as_joint_dims("joint_dims", joint)
    try:
        pair = as_sampler(sampler if isinstance(sampler, str) else sampler.spec, 2)
    except McspectraError:
        pair = None  # The sampler has no 2-D version, or no spec recreates it
    if pair is not None and joint is None:
        joint = joint_dims_of(pair)
    if (
        pair is None
        or (joint or 0) >= dims
        or isinstance(pair.law(pair.nearest_count(16)), Independent)
    ):
        made = as_sampler(sampler, dims if isinstance(sampler, str) else None)
        return made if made.dims == dims else in_dims(made, dims)
    joint = joint or 0
    return Padded(source=pair, joint=joint, requests=requests_of(dimensions))


@final
@dataclass(frozen=True, kw_only=True)
class Padded(Sampler):
    """Shuffled sets of one sampler, one set per request of a path. The first dims may be joint.

    Attributes
    ----------
    source
        The sampler in two dims. For requests of one number, its 1-D version is used if it exists.
    joint
        How many of a path's first random numbers come from one joint set; 0 for none.
    requests
        How many random numbers a path takes at each request: 1 or 2.
        After the first `joint` numbers, each request is answered by its own shuffled set.
    """

    name: ClassVar[str] = "padded"
    source: Sampler
    joint: int = 0
    requests: tuple[int, ...] = ()
    dims: int = DEFAULT_DIMS
    _whole: Sampler | None = field(init=False, repr=False, compare=False, default=None)

    def __post_init__(self) -> None:
        settle(self, dims=sum(self.requests))
        if self.joint:
            settle(self, _whole=joint_sampler(self.source, self.joint))
        Sampler.__post_init__(self)

    @property
    def spec(self) -> str:
        """Spec of the sampler without padding. The renderer pads, as `padding_note` describes."""
        return self.source.spec

    @property
    def plain(self) -> Sampler:
        """This sampler with its randomizations. For other samplers, `plain` has no randomizations.

        Randomizations of a padded sampler cannot be removed: they are applied before the padding.
        """
        return self

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        sets = padded_sets(self.source.spec, n, self.joint)
        out = np.empty((count, n, self.dims))
        place = 0
        for number, width in enumerate(self.requests):
            columns = slice(place, place + width)
            if place + width > self.joint:
                own = stream.child(_FIRST_PAD + number)
                out[..., columns] = sets.pads(width, own, first, count)
            place += width
        if self._whole is not None:
            joint = sets.joints(stream, first, count)
            inside = sum(w for k, w in enumerate(self.requests) if self._fits(k))
            out[..., :inside] = joint[..., :inside]
        return out

    def _fits(self, number: int) -> bool:
        """Whether all random numbers of a request come from the joint set."""
        return sum(self.requests[: number + 1]) <= self.joint

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return self.source._counts_near(n)

    def _count_warning(self, n: int) -> str | None:
        return self.source._count_warning(n)


def padding_note(sampler: Sampler) -> str:
    """Describe in a sentence how the random numbers of a path are taken from a sampler."""
    if not isinstance(sampler, Padded):
        return "All numbers of a path are joint: they come from one point of the sampler."
    if not sampler.joint:
        return "Padded: each request of the integrator has its own shuffled points."
    return (
        f"The first {sampler.joint} numbers of a path are joint, and every later request of the "
        "integrator has its own shuffled points (padded), as in rendered images."
    )
