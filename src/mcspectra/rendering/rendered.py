"""Values of chosen pixels exactly as Mitsuba renders them, with any sampler and the film's filter.

Method
------
Mitsuba's samplers split a wavefront into sequences of n lanes, one sequence per pixel.
Each sequence has its own points, as each pixel of an image does.
Here a sequence is one pixel in one of R images, and one wavefront computes all R images.
Only the measured pixels are traced.
Positions in the pixel, on the lens and in time are sampled as in Mitsuba's own loop.
The samplers are objects of Mitsuba's own samplers, or of our plugin.
Paths therefore take their random numbers in the same way as in an image.

With a box filter, a pixel is the mean of its own samples.
With another filter, samples in neighboring pixels also count.
The neighbors are then traced as well, and a pixel is Σ w·L / Σ w over all these samples.
Pixels are measured in square tiles, because adjacent pixels share the neighbors that they need.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.paths import Tracer
from mcspectra.rendering.scenes import Scene, film_size, mitsuba_reason, sensor_of
from mcspectra.rendering.techniques import check_finite, chosen_channel, lane_sums

__all__ = ["OWN_SAMPLER", "Film", "RenderedPixels", "chosen_tiles", "pixels_of", "preview"]

OWN_SAMPLER = "scene's own"
"""A value that stands for the sampler of the scene's own camera."""

_LANES = 2**20  # samples in one wavefront, which take some 100 MiB
# Maximum number of pixels of a preview, number of paths per pixel, and random numbers per path.
# If a path needs more random numbers, a hash function computes them from the given ones
_PREVIEW, _PREVIEW_PATHS, _PREVIEW_DIMS = 2**14, 16, 8
_WIDE_LANES = 2**22  # largest wavefront if a single tile has more samples than `_LANES`


@final
@dataclass(frozen=True)
class Film:
    """Size of a film in pixels, and a margin of pixels for the reconstruction filter.

    The filter uses samples from up to `margin` pixels beyond the border of a tile.
    """

    width: int
    height: int
    margin: int

    @staticmethod
    def of(scene: Any) -> Film:
        """Read the film of a scene's first camera."""
        film = sensor_of(scene).film()
        kept = film.rfilter()
        margin = 0 if kept.is_box_filter() else max(0, math.ceil(kept.radius() - 0.5))
        width, height = film.crop_size()
        return Film(int(width), int(height), margin)


def chosen_tiles(
    film: Film, pixels: int, stream: Stream, crop: tuple[int, int, int, int] | None = None
) -> tuple[Array, int]:
    """Choose square tiles: one at random in each stratum of the image, or of a part of the image.

    Returns
    -------
    tuple
        The upper left pixels of the tiles, (T, 2), and the side of a tile in pixels.
        The tiles have about `pixels` pixels in total, or cover all of a small film.
    """
    *start, width, height = crop or (0, 0, film.width, film.height)
    corner = np.array(start)
    side = 1 if film.margin == 0 else min(4, width, height)
    if width * height <= pixels:
        x, y = (np.arange(0, k - k % side, side) for k in (width, height))
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) + corner, side
    count = max(1, pixels // side**2)
    across = max(1, min(width // side, round(math.sqrt(count * width / height))))
    down = max(1, min(height // side, round(count / across)))
    u = stream.uniforms(0, across * down, 2).reshape(down, across, 2)
    place = np.stack(np.meshgrid(np.arange(across), np.arange(down)), axis=-1)
    most = np.array([width, height]) - side + 1
    found = np.floor((place + u) * most / (across, down)).astype(np.int64)
    return np.minimum(found, most - 1).reshape(-1, 2) + corner, side


@final
@dataclass
class RenderedPixels:
    """Measures pixels of a scene in the same way as its renderer.

    Attributes
    ----------
    tracer
        Traces the paths of the integrator, in one channel.
    seconds, samples
        Total time of the wavefronts and their number of samples, for estimates of the cost.
    """

    tracer: Tracer
    film: Film
    seconds: float = 0.0
    samples: int = 0
    _made: dict[Any, Any] = field(default_factory=dict, repr=False)

    def sampler(self, plugin: str | Mapping[str, Any], n: int) -> Any:
        """Return a sampler object for n samples per pixel, or None if Mitsuba would round n."""
        mitsuba = load_mitsuba()
        if plugin == OWN_SAMPLER:
            made = sensor_of(self.tracer.scene).sampler().fork()
            made.set_sample_count(n)
        else:
            given = {"type": plugin} if isinstance(plugin, str) else dict(plugin)
            made = mitsuba.load_dict({**given, "sample_count": n})
        return made if int(made.sample_count()) == n else None

    def estimates(
        self,
        plugin: str | Mapping[str, Any],
        n: int,
        tiles: Array,
        side: int,
        realizations: int,
        stream: Stream,
    ) -> Array:
        """Return R independent values of each pixel of tiles (T, 2): float64 (R, T · side²).

        Raises
        ------
        ParameterError
            If the sampler cannot make n samples, or Mitsuba cannot trace the paths.
        """
        wide = side + 2 * self.film.margin
        each = wide * wide * n
        step = max(1, _LANES // each)
        # Each row of `cells` is one tile in one realization
        cells = np.tile(tiles, (realizations, 1))
        found = []
        for number, first in enumerate(range(0, len(cells), step)):
            part = cells[first : first + step]
            seed = int(stream.keys(number, 1)[0, 0] >> np.uint64(32))
            with LOCK:
                start = time.perf_counter()
                try:
                    found.append(self._values(plugin, n, part, side, seed))
                except (RuntimeError, TypeError) as error:
                    raise ParameterError(
                        f"Mitsuba cannot render {self.tracer.integrator} with {plugin}: "
                        f"{mitsuba_reason(error)}."
                    ) from None
                self.seconds += time.perf_counter() - start
                self.samples += len(part) * each
        values = np.concatenate(found).reshape(realizations, len(tiles) * side**2)
        pixels = pixels_of(tiles, side)
        check_finite(values.T, self.tracer.scene, pixels)
        return values

    def _values(
        self, plugin: str | Mapping[str, Any], n: int, cells: Array, side: int, seed: int
    ) -> Array:
        import drjit

        mitsuba, margin = load_mitsuba(), self.film.margin
        wide = side + 2 * margin
        key = (str(plugin), n)
        if key not in self._made:
            self._made[key] = self.sampler(plugin, n)
        source = self._made[key]
        if source is None:
            raise ParameterError(f"{plugin} cannot make {n} samples per pixel.")
        lanes = len(cells) * wide * wide * n
        source = source.fork()
        source.set_sample_count(n)
        source.set_samples_per_wavefront(n)
        source.seed(mitsuba.UInt32(seed), lanes)

        # Find the pixel of each lane; the margin of a tile may lie outside the film
        lane = drjit.arange(mitsuba.UInt32, lanes)
        count, row, area = (drjit.opaque(mitsuba.UInt32, k) for k in (n, wide, wide * wide))
        pixel = lane // count
        cell = pixel // area
        place = pixel - cell * area
        line = place // row
        corner = [mitsuba.Int32(np.ascontiguousarray(c, np.int32)) for c in cells.T]
        x, y = (drjit.gather(mitsuba.Int32, c, cell) for c in corner)
        x += mitsuba.Int32(place - line * row) - margin
        y += mitsuba.Int32(line) - margin
        sides = (self.film.width, self.film.height)
        width, height = (drjit.opaque(mitsuba.Int32, k) for k in sides)
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        position = source.next_2d()
        color = self.tracer.trace(source, mitsuba.Float(x), mitsuba.Float(y), position)
        value = chosen_channel(color, self.tracer.channel)
        value = drjit.select(inside, value, 0.0)
        if margin == 0:
            # Add in a fixed order, so that the bits do not depend on threads
            drjit.eval(value)
            kept = value.numpy().reshape(len(cells) * side * side, n)
            means = kept.mean(axis=1, dtype=np.float64)
            return np.asarray(means.reshape(len(cells), side * side))

        # Weight the samples of the neighbors by the filter
        u, v = position.x, position.y
        drjit.eval(value, inside, u, v)
        reach, kept = 2 * margin + 1, sensor_of(self.tracer.scene).film().rfilter()

        def of_lane(out: Any) -> Callable[[Any], Sequence[Any]]:
            each, own = (drjit.opaque(mitsuba.UInt32, k) for k in (side * side, side))
            block = out // each
            line = (out - block * each) // own
            column = out - block * each - line * own

            def weighted(k: Any) -> Sequence[Any]:
                near = k // count
                dy = near // reach
                dx = near - dy * reach
                source = ((block * row + line + dy) * row + column + dx) * count + k - near * count
                at = [
                    drjit.gather(mitsuba.Float, w, source) + mitsuba.Float(d) - (margin + 0.5)
                    for w, d in ((u, dx), (v, dy))
                ]
                weight = kept.eval(at[0]) * kept.eval(at[1])
                weight &= drjit.gather(mitsuba.Bool, inside, source)
                return weight * drjit.gather(mitsuba.Float, value, source), weight

            return weighted

        total, weight = lane_sums(len(cells) * side * side, reach * reach * n, 2, of_lane).T
        return np.asarray((total / weight).reshape(len(cells), side * side))


def preview(scene: Scene, integrator: str) -> Array:
    """Return a small picture of a scene, linear RGB (height, width, 3), by few random paths.

    Pixels of the picture are pixels of the film; of a large film, every k-th row and column.
    """
    ends = film_size(scene)
    step = max(1, math.ceil(math.sqrt(ends[0] * ends[1] / _PREVIEW)))
    columns, rows = (np.arange(min(step // 2, end - 1), end, step) for end in ends)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    tracer = Tracer(scene, integrator, "rgb", ends)
    u = Stream(0).uniforms(0, len(pixels) * _PREVIEW_PATHS, _PREVIEW_DIMS)
    u = u.reshape(1, len(pixels), _PREVIEW_PATHS, _PREVIEW_DIMS)
    means = tracer.means(u, pixels)[0]
    return np.asarray(means.reshape(len(rows), len(columns), 3))


def pixels_of(tiles: Array, side: int) -> Array:
    """Return the pixels (T · side², 2) of tiles (T, 2), as x and y."""
    offsets = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    return np.asarray((tiles[:, None] + offsets).reshape(-1, 2))
