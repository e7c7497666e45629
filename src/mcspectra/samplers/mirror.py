"""Mirroring of samples: reflections at random, in all directions at once, or by folding."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.core.jit import kernel
from mcspectra.core.streams import Stream, mix_bits
from mcspectra.samplers.base import MAX_COUNT, Randomization, Sampler, Structure

__all__ = ["Mirror", "folded"]

_BELOW_ONE = 1.0 - 2.0**-53
_MOST_DIMS = 30  # 2^d images of at least one point
_NOTHING_LEFT: dict[Structure, Structure] = dict.fromkeys(Structure, Structure.NONE) | {
    Structure.UNKNOWN: Structure.UNKNOWN
}
_IMAGES: dict[Structure, Structure] = {s: s for s in Structure} | {Structure.TORUS: Structure.NONE}
"""Reflections of a cell are cells; images of points near a face lie close to one another."""


@final
@dataclass(frozen=True, kw_only=True)
class Mirror(Randomization):
    """Mirroring: put samples into one random mirror image of the integrand, into all, or fold them.

    Attributes
    ----------
    mode
        ``"random"``: every coordinate of every sample is reflected or not, as by a fair coin.
        ``"uniform"``: each of n/2^d samples becomes its 2^d reflections, one after the other.
        ``"fold"``: u → 1 − |2u − 1| in every coordinate (the baker's transform), nothing random.

    Notes
    -----
    Reflected at its upper faces, an integrand f on [0,1)^d becomes g(k + x) = f(x reflected in the
    coordinates with k_j = 1), k ∈ {0,1}^d, which is continuous across all faces and of period 2. A
    sample x can be put at k + x for one image k chosen at random, or for all of them, or the whole
    set can be stretched over [0,2)^d. The result holds the arguments of f for each sample.

    1 − u would leave [0,1) for u = 0. Reflected is 1 − 2^-53 − u instead: multiples of 2^-53, which
    float64 points are, go to such multiples one to one, both here and in folding. Uniform samples
    stay exactly uniform, and each half-open cell of a grid goes to the cell opposite.

    Random reflection and folding do away with strata, elementary intervals and differences; the
    uniform mode keeps strata and intervals, with 2^d times as many points in each.

    References
    ----------
    Hickernell (2002), "Obtaining O(N^(−2+ε)) convergence for lattice quadrature rules",
    doi 10.1007/978-3-642-56046-0_18, for the baker's transform. The other modes are our reading of
    mirrored samples; the uniform one is the antithetic variate of Hammersley, Morton (1956),
    doi 10.1017/S0305004100031455, in every coordinate.
    """

    name: ClassVar[str] = "mirror"
    fits: ClassVar[Mapping[Structure, Structure]] = _NOTHING_LEFT
    mode: str = "random"

    def __post_init__(self) -> None:
        as_choice("mode", self.mode, ("random", "uniform", "fold"))
        if self.mode == "uniform":
            object.__setattr__(self, "fits", _IMAGES)
        object.__setattr__(self, "pointwise", self.mode != "uniform")

    def fit(self, sampler: Sampler) -> Randomization:
        """Refuse the uniform mode in too many dims."""
        if self.mode == "uniform" and sampler.dims > _MOST_DIMS:
            raise ParameterError(
                f"mirror(mode='uniform') makes 2^d images of a point, but {sampler.spec} has "
                f"{sampler.dims} dims; use at most {_MOST_DIMS}, or mode='random'."
            )
        return Randomization.fit(self, sampler)

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Mirror each realisation; the uniform mode returns 2^d points for each of `points`."""
        if self.mode == "uniform":
            return _all_images(points)
        if self.mode == "fold":
            return folded(points)
        out = np.empty(points.shape)
        _reflect_at_random(stream.keys(first, len(points)), points, out)
        return out

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        """Draw n points of `sampler`, or n/2^d in the uniform mode, and mirror them."""
        points = sampler.draw_stream(n // self._images(sampler), stream, first, count)
        return self.apply(points, own, first)

    def counts_near(self, sampler: Sampler, n: int) -> tuple[int | None, int]:
        """Return the counts of `sampler`, times 2^d for the uniform mode."""
        images = self._images(sampler)
        below = sampler._counts_near(n // images)[0] if n >= images else None
        above = sampler._counts_near(-(-n // images))[1]
        return (below and below * images), above * images

    def max_count(self, sampler: Sampler) -> int:
        """Return the counts of `sampler`, times 2^d for the uniform mode."""
        return min(sampler.max_count * self._images(sampler), MAX_COUNT)

    def count_warning(self, sampler: Sampler, n: int) -> str | None:
        """Return the warning of `sampler`."""
        return sampler._count_warning(n // self._images(sampler))

    def _images(self, sampler: Sampler) -> int:
        return 1 << sampler.dims if self.mode == "uniform" else 1


def folded(points: Array) -> Array:
    """Return u → 1 − |2u − 1| of coordinates in [0,1), within [0,1)."""
    doubled = 2.0 * points
    return np.where(doubled < 1.0, doubled, _BELOW_ONE - (doubled - 1.0))


def _all_images(points: Array) -> Array:
    """All reflections of each point, one after the other: (R, n·2^d, d)."""
    count, n, dims = points.shape
    images = np.arange(1 << dims)[:, None] >> np.arange(dims)[::-1] & 1
    out = np.where(images == 1, _BELOW_ONE - points[:, :, None], points[:, :, None])
    return out.reshape(count, n << dims, dims)


@kernel
def _reflect_at_random(keys: Array, points: Array, out: Array) -> None:
    # Reflect each coordinate if its bit is set: 64 coordinates share a random number.
    count, n, dims = points.shape
    words = (dims + 63) // 64
    for r in range(count):
        for i in range(n):
            for word in range(words):
                bits = mix_bits(keys[r, 0], keys[r, 1], i * words + word)
                for j in range(64 * word, min(64 * word + 64, dims)):
                    x = points[r, i, j]
                    out[r, i, j] = _BELOW_ONE - x if bits & np.uint64(1) else x
                    bits >>= np.uint64(1)
