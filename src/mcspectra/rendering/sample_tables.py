"""Tables of points for renderers that ask for one or two numbers at a time.

Method
------
Padding, as in pbrt: every request for two numbers (or one) takes a two-dimensional (or one-
dimensional) set of its own, its points in a random order of its own, so that requests are
independent of one another and each is as well distributed as the sampler makes it (Kollig and
Keller 2002; Pharr, Jakob and Humphreys 2023, section 8.3). Tables hold float32, the renderer's
numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import gcd
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.jit import kernel
from mcspectra.core.parallel import available_workers, map_in_order
from mcspectra.core.streams import Stream, mix_bits
from mcspectra.samplers import Sampler, as_sampler

__all__ = ["LARGEST_SAMPLE", "MOST_SAMPLES", "PaddedSets", "Rounds"]

LARGEST_SAMPLE = np.float32(1.0 - 2.0**-24)
"""The largest float32 below 1."""

MOST_SAMPLES = 2**16
"""Most samples a pixel: with the fewest sets, a table is then as large as it may be."""

_MOST_NUMBERS = 2**27  # of one table: 512 MiB
_FEWEST_SETS = 509  # a prime: requests of one pixel beyond it meet their first sets again
_BLOCK_NUMBERS = 2**19  # drawn at once: 4 MiB of float64
_GOLDEN = (5**0.5 - 1) / 2


@kernel
def _shuffle(points: Array, keys: Array, largest: Any, out: Array) -> None:
    # Fisher and Yates inside out; points (R, n, d) float64, keys (R, 2), out (R, n, d) float32.
    for r in range(points.shape[0]):
        for i in range(points.shape[1]):
            j = int(mix_bits(keys[r, 0], keys[r, 1], i) % np.uint64(i + 1))
            for k in range(points.shape[2]):
                out[r, i, k] = out[r, j, k]
                out[r, j, k] = min(np.float32(points[r, i, k]), largest)


@final
@dataclass(frozen=True)
class Rounds:
    """Which set each request of each pixel takes: set (pixel + request · stride) mod size.

    Attributes
    ----------
    size
        Number of sets.
    stride
        Relatively prime to `size`, so that the first `size` requests of a pixel meet as many sets.
    """

    size: int
    stride: int

    @staticmethod
    def of(pixels: int, requests: int, numbers_each: int) -> Rounds:
        """Lay out sets for the first `requests` of every pixel, as many as memory permits."""
        size = max(_FEWEST_SETS, pixels * requests + 1)
        size = min(size, _MOST_NUMBERS // numbers_each)
        golden = int(size * _GOLDEN)
        strides = (s for s in (pixels, *range(golden, size)) if s < size and gcd(s, size) == 1)
        return Rounds(size, next(strides, 1))


@final
@dataclass(frozen=True, kw_only=True)
class PaddedSets:
    """Sets of one sampler for requests of one and of two numbers, and joint sets in more dims.

    Parameters
    ----------
    spec
        Spec of a sampler, in 2 dims and in `joint` dims.
    count
        Points of a set, that is samples a pixel.
    joint
        Dims of joint sets, 0 for none.

    Raises
    ------
    ParameterError
        The spec, the count or the dims are not possible; for counts the nearest are named.
    """

    spec: str
    count: int
    joint: int = 0
    _samplers: tuple[Sampler, Sampler, Sampler | None] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        count = as_integer("sample_count", self.count, least=1, most=MOST_SAMPLES)
        pair = as_sampler(self.spec, 2)
        pair.check_count(count)
        joint = None
        if self.joint:
            joint = as_sampler(self.spec, as_integer("joint_dims", self.joint, least=2, most=64))
            joint.check_count(count)
        object.__setattr__(self, "_samplers", (_in_one_dim(self.spec, count, pair), pair, joint))

    def pads(self, dims: int, stream: Stream, first: int, sets: int) -> Array:
        """Sets first … first+sets−1 in 1 or 2 dims, shuffled: float32 (sets, count, dims)."""
        sampler = self._samplers[dims - 1]
        assert sampler is not None
        return self._filled(sampler, dims, stream.child(dims), first, sets, shuffled=True)

    def joints(self, stream: Stream, first: int, sets: int) -> Array:
        """Joint sets, in the sampler's own order: float32 (sets, count, joint)."""
        sampler = self._samplers[2]
        assert sampler is not None
        return self._filled(sampler, self.joint, stream.child(3), first, sets, shuffled=False)

    def _filled(
        self, sampler: Sampler, dims: int, stream: Stream, first: int, sets: int, *, shuffled: bool
    ) -> Array:
        out = np.empty((sets, self.count, dims), np.float32)
        points, order = stream.child(0), stream.child(1)
        size = max(1, _BLOCK_NUMBERS // (self.count * sampler.dims))

        def fill(start: int) -> None:
            part = out[start : start + size]
            drawn = sampler.draw_stream(self.count, points, first + start, len(part))[..., :dims]
            if shuffled:
                _shuffle(drawn, order.keys(first + start, len(part)), LARGEST_SAMPLE, part)
            else:
                np.minimum(drawn.astype(np.float32), LARGEST_SAMPLE, out=part)

        workers = available_workers() if sets > size else 1
        for _ in map_in_order(fill, range(0, sets, size), workers):
            pass
        return out


def _in_one_dim(spec: str, count: int, pair: Sampler) -> Sampler:
    """Return the sampler in one dim, or `pair`, of which the first coordinates then serve."""
    try:
        sampler = as_sampler(spec, 1)
        sampler.check_count(count)
    except ParameterError:
        return pair
    return sampler
