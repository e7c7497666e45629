"""Points chosen among random places by how far they are from the others, on the torus.

Dart throwing takes the first random place that is far enough, Mitchell's method the farthest of several
candidates; farthest-point optimisation repeatedly moves each point to the farthest place of all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream, mix_uniform
from mcspectra.samplers import _candidate_kernels as kernels
from mcspectra.samplers._kernels import translate
from mcspectra.samplers.base import Sampler, Structure, check_dims
from mcspectra.samplers.optimised import OptimisedSampler, check_sets
from mcspectra.samplers.poisson import densest_distance

__all__ = ["BestCandidate", "DartThrowing", "FarthestPoint"]

_CHUNK = 4096  # moves between reports of progress
_TRIALS = 100_000  # darts in a row that may miss: then less than a ten-thousandth is uncovered


@final
@dataclass(frozen=True, kw_only=True)
class DartThrowing(Sampler):
    """Random points, each rejected if it is too close to an earlier one, until n are accepted (Cook).

    The law is that of `poisson-disk`, whose method is faster, for up to 8 dims; distances are
    toroidal. A set is begun anew when 100,000 darts in a row have missed.

    Attributes
    ----------
    dims
        1 to 8.
    radius_
        Minimum distance relative to that of the densest known packing of n points, above 0, at
        most 1. Dart throwing jams at about 0.75 in 1-D, 0.78 in 2-D, 0.8 above, and classic
        rejection gets slow before.

    References
    ----------
    Cook (1986), "Stochastic sampling in computer graphics", doi 10.1145/7529.8927; radius relative
    to the densest packing: Lagae, Dutré (2008), "A comparison of methods for generating Poisson
    disk distributions", doi 10.1111/j.1467-8659.2007.01100.x.
    """

    name: ClassVar[str] = "dart-throwing"
    structure: ClassVar[Structure] = Structure.TORUS
    max_dims: ClassVar[int | None] = 8
    max_count: ClassVar[int] = 2**22
    dims: int = DEFAULT_DIMS
    radius_: float = 0.65

    def __post_init__(self) -> None:
        check_dims(self)
        radius = as_real("radius", self.radius_, above=0.0, most=1.0)
        object.__setattr__(self, "radius_", radius)

    def radius(self, n: int) -> float:
        """Return the minimum distance between any two of n points, in units of the domain."""
        return self.radius_ * densest_distance(self.check_count(n), self.dims)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        radius = self.radius(n)
        # Cells no smaller than a disk, so that it can only touch those next to its own
        side = max(1, min(int(1.0 / radius), int(n ** (1.0 / min(self.dims, 3)))))
        attempts = 3 + 300 // n  # few points jam often: whether they fit is luck
        out = np.empty((count, n, self.dims))
        keys = stream.keys(first, count)
        if not kernels.throw_darts(keys, radius**2, side, _TRIALS, attempts, out):
            raise CountError(
                f"{self.spec} found no room for {n} points in {self.dims} dims with {_TRIALS} darts; "
                "give a smaller radius."
            )
        return out


@final
@dataclass(frozen=True, kw_only=True)
class BestCandidate(Sampler):
    """Each point is the best of random candidates: the farthest from all earlier points.

    Progressive: the first points of a set are themselves one. Distances are toroidal. The time is
    O(candidates · n²).

    Attributes
    ----------
    dims
        Any number.
    candidates
        Candidates for each point there is already: point i (from 0) is chosen from candidates · i.

    References
    ----------
    Mitchell (1991), "Spectrally optimal sampling for distribution ray tracing",
    doi 10.1145/122718.122736.
    """

    name: ClassVar[str] = "best-candidate"
    structure: ClassVar[Structure] = Structure.TORUS
    max_count: ClassVar[int] = 2**16
    dims: int = DEFAULT_DIMS
    candidates: int = 4

    def __post_init__(self) -> None:
        check_dims(self)
        candidates = as_integer("candidates", self.candidates, least=1, most=10_000)
        object.__setattr__(self, "candidates", candidates)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        out = np.empty((count, n, self.dims))
        kernels.pick_candidates(stream.keys(first, count), self.candidates, out)
        return out


@final
@dataclass(frozen=True, kw_only=True)
class FarthestPoint(OptimisedSampler):
    """Farthest-point optimised points: minimum distance near that of the densest packing (2-D torus).

    From random points on, every point in turn is taken out and put into the centre of the largest
    empty disk: the farthest place there is from all others. The minimum distance never decreases. One
    sweep over n points takes O(n²) with a small constant: 1024 points and 30 sweeps, 2 s.

    Attributes
    ----------
    dims
        2.
    sweeps
        Largest number of moves of every point; fewer if nothing changes any more. After 30 the
        minimum distance is about 0.92 of that of the hexagonal packing.

    References
    ----------
    Schlömer, Heck, Deussen (2011), "Farthest-point optimized point sets with maximized minimum
    distance", doi 10.1145/2018323.2018345.
    """

    name: ClassVar[str] = "farthest-point"
    max_dims: ClassVar[int | None] = 2
    dims: int = 2
    sweeps: int = 30

    def __post_init__(self) -> None:
        if self.dims != 2:
            raise ParameterError(
                f"farthest-point: dims is {self.dims!r}; it must be 2, "
                "for other dims use best-candidate or dart-throwing."
            )
        check_dims(self)
        check_sets(self)
        sweeps = as_integer("sweeps", self.sweeps, least=1, most=100_000)
        object.__setattr__(self, "sweeps", sweeps)

    def _optimize(self, n: int, keys: Array, report: Callable[[float], None]) -> Array:
        from mcspectra.samplers import _voronoi_kernels as voronoi

        uniforms = np.array([mix_uniform(keys[0], keys[1], i) for i in range(2 * n + 2)])
        points, offset = uniforms[:-2].reshape(n, 2), uniforms[-2:].reshape(1, 2)
        buckets, holes = voronoi.point_buckets(points), np.empty((n, 4))
        voronoi.measure_all(points, buckets, holes)
        for sweep in range(self.sweeps):
            before = points.copy()
            for start in range(0, n, _CHUNK):
                report((sweep + start / n) / self.sweeps)
                stop = min(start + _CHUNK, n)
                voronoi.move_points(start, stop, points, buckets, holes)
            if np.array_equal(points, before):
                break
        # Holes of equal size (there are, among few points) were chosen by where they are
        moved = np.empty((1, n, 2))
        translate(points[None], offset, moved)
        result: Array = moved[0]
        return result
