"""Direct illumination of many pixels at once, from tables of our own points.

Method
------
All samples of a chunk of pixels run in one kernel, by the strategies of `techniques`.
The kernel adds up the samples of each pixel in float64.
Memory is limited by the number of samples in a chunk.
Memory does not depend on the number of pixels or of samples per pixel.

The first two columns of u are the position in the pixel, if it is sampled.
Two columns of u are the direction. A further column may select a light or a lobe of the BSDF.
The strategy ``mis`` adds up both techniques at the same surface point.
For ``mis``, a block of columns belongs to the light, and the following block to the BSDF.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_real_array
from mcspectra.core.display import shown
from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.rendering.backend import LARGEST_SAMPLE, LOCK, load_mitsuba
from mcspectra.rendering.kernel_sets import NetPoints
from mcspectra.rendering.scene_checks import check_media
from mcspectra.rendering.scenes import (
    Scene,
    film_size,
    find_emitter,
    load_scene,
    scene_name,
    sensor_of,
)
from mcspectra.rendering.techniques import (
    POWERS,
    Hit,
    check_finite,
    corners_of,
    follow_camera,
    heuristic_weight,
    lane_sums,
    sample_bsdf,
    sample_light,
)

__all__ = ["CHUNK_SAMPLES", "FILMS", "WAVEFRONT_STRATEGIES", "Wavefront"]

WAVEFRONT_STRATEGIES = ("light", "bsdf", "mis-light", "mis-bsdf", "mis")
FILMS = ("center", "sampled")
CHUNK_SAMPLES = 2**20
"""Number of samples per kernel, for about 200 MiB of Dr.Jit's memory; more are not faster."""

# Maximum number of samples that each parallel lane sums.
# If each lane summed more samples, too few lanes would run in parallel
_LOOP_SAMPLES = 16
_MOST_VALUES = 2**26  # maximum number of samples returned one by one (768 MiB)


class Wavefront:
    """Direct illumination of a scene, for any pixels and any samples.

    Parameters
    ----------
    scene
        A scene: a name, a file or a dictionary, as in `load_scene`.
    light
        Index or name of the only light to use; by default all lights.
    film
        ``"center"``: rays go through the centers of the pixels.
        ``"sampled"``: rays go through random points of the pixel, from the first two columns.
        With sampled positions, the image has a box filter.
    heuristic
        ``"balance"`` or ``"power"`` (β = 2), for the ``mis`` strategies.
    emission
        Whether the image includes directly visible lights.

    Raises
    ------
    ParameterError
        If a parameter is not allowed, or the scene has no camera or no lights.

    Notes
    -----
    Rays start at the center of the lens, in the middle of the shutter's time.
    ``bsdf`` excludes lights that are delta functions, and ``light`` excludes specular lobes.
    ``mis`` includes both.
    """

    def __init__(
        self,
        scene: Scene,
        light: int | str | None = None,
        film: str = "center",
        *,
        heuristic: str = "balance",
        emission: bool = False,
    ) -> None:
        self.film = as_choice("film", film, FILMS)
        self.heuristic = as_choice("heuristic", heuristic, tuple(POWERS))
        self.emission = bool(emission)
        with LOCK:
            load_mitsuba()
            import drjit

            sensor_of(scene)
            self._request, self._scene = scene, load_scene(scene)
            check_media(scene)
            self.width, self.height = film_size(scene)
            # Pass the size to the kernel as data: a division by a constant is rounded differently
            sides = (float(side) for side in (self.width, self.height))
            self._size = [drjit.opaque(load_mitsuba().Float, side) for side in sides]
            self._emitter = None if light is None else find_emitter(scene, light)
            if not self._scene.emitters():
                raise ParameterError(
                    f"The scene {scene_name(scene)} has no lights; add an emitter."
                )
            # A BSDF with several components on one side selects a component by a random number
            flags = load_mitsuba().BSDFFlags
            bsdfs = [shape.bsdf() for shape in self._scene.shapes()]
            self.selects_lobe = any(
                sum(bool(int(b.flags(i)) & int(side)) for i in range(b.component_count())) > 1
                for b in bsdfs
                for side in (flags.FrontSide, flags.BackSide)
            )
        # Tiles are evaluated repeatedly with other points, so cache their first hits
        self._center_hits = functools.lru_cache(maxsize=4)(self._trace_centers)

    def dims(self, strategy: str, *, select: bool | None = None) -> int:
        """Return the number of columns that a strategy uses.

        With `select`, the third column of each block selects a light or a lobe.
        The default is True if a BSDF of the scene needs the third column.
        """
        as_choice("strategy", strategy, WAVEFRONT_STRATEGIES)
        if select is None:
            select = self.selects_lobe and not strategy.endswith("light")
        blocks = 2 if strategy == "mis" else 1
        return 2 * (self.film == "sampled") + blocks * (3 if select else 2)

    def values(self, strategy: str, pixels: Any, u: Any) -> Array:
        """Return the estimate of every sample of every pixel: float32 (P, S, 3).

        Parameters and errors are the same as in `means`. More than 2^26 samples raise an error.
        """
        pixels, u = self._checked(strategy, pixels, u)
        count = u.shape[-2]
        if len(pixels) * count > _MOST_VALUES:
            raise ParameterError(
                f"{len(pixels)} pixels with {count} samples are {len(pixels) * count:.3g} values; "
                f"compute at most {_MOST_VALUES:.3g} at a time, or use means."
            )
        out = np.empty((len(pixels), count, 3), np.float32)
        for rows, columns, samples in _chunks(len(pixels), u):
            out[rows, columns] = self._parts(strategy, pixels[rows], samples, 1)
        return out

    def means(self, strategy: str, pixels: Any, u: Any) -> Array:
        """Return the estimate of every pixel: the mean over its samples.

        Parameters
        ----------
        strategy
            ``"light"`` or ``"bsdf"``: sampling of the light or of the BSDF alone.
            ``"mis-light"`` or ``"mis-bsdf"``: one of the two parts of multiple importance sampling.
            ``"mis"``: the sum of the two parts.
        pixels
            Integers (P, 2): x and y, counted from the left and from the top.
        u
            Samples in [0,1): (P, S, dims), or (S, dims) if all pixels share them; see `dims`.

        Returns
        -------
        ndarray
            float64 (P, 3): red, green and blue.

        Raises
        ------
        ParameterError
            If the strategy is unknown, pixels are outside the film, or u has the wrong shape.
            If the renderer returns NaN or infinite values.
        DomainError
            If samples are NaN or outside [0,1).
        """
        pixels, u = self._checked(strategy, pixels, u)
        out = np.zeros((len(pixels), 3))
        for rows, _, samples in _chunks(len(pixels), u):
            out[rows] += self._sums(strategy, pixels[rows], samples)
        out /= u.shape[-2]
        return out

    def net_means(self, strategy: str, pixels: Array, points: NetPoints) -> Array:
        """Same as `means`, without checks. The kernel computes the points, one set per pixel."""
        sums = self._sums(strategy, pixels, points)
        sums /= points.count
        return sums

    def _checked(self, strategy: str, pixels: Any, u: Any) -> tuple[Array, Array]:
        allowed = (self.dims(strategy, select=False), self.dims(strategy, select=True))
        given, u = np.asarray(pixels), as_real_array("u", u)
        if (
            given.dtype.kind not in "iu"
            or given.ndim != 2
            or given.shape[1:] != (2,)
            or not len(given)
        ):
            raise ParameterError(
                f"pixels have shape {given.shape} and type {given.dtype}; give integers (P, 2), "
                "x and y of each."
            )
        outside = ((given < 0) | (given >= (self.width, self.height))).any(axis=1)
        if outside.any():
            x, y = given[outside][0]
            raise ParameterError(
                f"The pixel ({x}, {y}) is outside the film; x runs from 0 to {self.width - 1}, "
                f"y from 0 to {self.height - 1}."
            )
        pixels = np.ascontiguousarray(given, np.int64)
        if u.ndim not in (2, 3) or u.shape[-1] not in allowed or u.shape[-2] == 0:
            raise ParameterError(
                f"u has shape {u.shape}; {shown(strategy)} takes (pixels, samples, dims) or "
                f"(samples, dims) with {allowed[0]} or {allowed[1]} dims."
            )
        if u.ndim == 3 and len(u) != len(pixels):
            raise ParameterError(
                f"u has {len(u)} rows for {len(pixels)} pixels; give one row for each pixel."
            )
        if u.shape[-1] < self.dims(strategy):
            raise ParameterError(
                f"u has {u.shape[-1]} dims, but a BSDF of the scene selects a lobe by an extra "
                f"number; give {self.dims(strategy)} dims."
            )
        return pixels, u

    def _sums(self, strategy: str, pixels: Array, points: Array | NetPoints) -> Array:
        """Return sums over the samples of each pixel in a chunk: float64 (P, 3)."""
        count = points.shape[-2]
        each = max(k for k in range(1, _LOOP_SAMPLES + 1) if count % k == 0)
        parts = self._parts(strategy, pixels, points, each)
        sums: Array = parts.sum(axis=1) if parts.shape[1] > 1 else parts[:, 0]
        return sums

    def _parts(self, strategy: str, pixels: Array, points: Array | NetPoints, each: int) -> Array:
        """Return sums over runs of `each` successive samples: float64 (P, n / each, 3).

        Each run of samples is summed by one of many lanes, which work in parallel.
        """
        import drjit

        mitsuba, count, at_center = load_mitsuba(), points.shape[-2], self.film == "center"

        def of_lane(lane: Any) -> Callable[[Any], Any]:
            run, runs, own = (drjit.opaque(mitsuba.UInt32, k) for k in (each, count // each, count))
            pixel = lane // runs
            if isinstance(points, NetPoints):
                first, columns = lane * run - pixel * own, points.lanes(mitsuba, pixel)
            else:
                first = lane * run - (0 if points.ndim == 3 else pixel * own)
                table, dims = mitsuba.Float(points.ravel()), points.shape[-1]
                kind, largest = type(table), LARGEST_SAMPLE
                columns = lambda row: [
                    drjit.minimum(drjit.gather(kind, table, row * dims + k), largest)
                    for k in range(dims)
                ]
            if at_center:
                kept = self._center_hits(pixels.tobytes())
                at = drjit.gather(mitsuba.SurfaceInteraction3f, kept, pixel)
                center = Hit(self._scene, at, at.bsdf())
            else:
                x, y = (drjit.gather(mitsuba.Float, c, pixel) for c in corners_of(pixels))

            def color(k: Any) -> Any:
                blocks = columns(first + k)
                if at_center:
                    hits = center
                else:
                    at = self._trace(x + blocks[0], y + blocks[1])
                    hits, blocks = Hit(self._scene, at, at.bsdf()), blocks[2:]
                if strategy == "mis":  # each of the two techniques uses one half of the columns
                    half = len(blocks) // 2
                    found = self._technique("mis-light", hits, blocks[:half])
                    found += self._technique("mis-bsdf", hits, blocks[half:])
                else:
                    found = self._technique(strategy, hits, blocks)
                if self.emission:  # add directly visible lights
                    seen = hits.interaction.emitter(self._scene)
                    emitter = self._emitter
                    counts = True if emitter is None else seen == mitsuba.EmitterPtr(emitter)
                    found += seen.eval(hits.interaction, counts)
                return found

            return color

        with LOCK:
            sums = lane_sums(len(pixels) * (count // each), each, 3, of_lane)
        parts: Array = sums.reshape(len(pixels), -1, 3)
        check_finite(parts, self._request, pixels)
        return parts

    def _trace_centers(self, pixels: bytes) -> Any:
        """Return the first surface point on the ray through the center of each pixel.

        The results are cached, so `pixels` must be hashable: the bytes of an int64 array (P, 2).
        """
        import drjit

        x, y = corners_of(np.frombuffer(pixels, np.int64).reshape(-1, 2))
        found = self._trace(x + 0.5, y + 0.5)
        drjit.eval(found)
        return found

    def _trace(self, x: Any, y: Any) -> Any:
        """Follow rays through points of the film, which are given in pixels."""
        position = load_mitsuba().Point2f(x / self._size[0], y / self._size[1])
        return follow_camera(self._scene, position)

    def _technique(self, strategy: str, hits: Hit, block: list[Any]) -> Any:
        sample = sample_light if strategy.endswith("light") else sample_bsdf
        extra = block[2] if len(block) == 3 else None
        active, u = hits.interaction.is_valid(), load_mitsuba().Point2f(block[0], block[1])
        value, own, other = sample(hits, self._emitter, u, extra, active)
        if strategy.startswith("mis"):
            value *= heuristic_weight(own, other, POWERS[self.heuristic])
        return value


def _chunks(pixels: int, u: Array) -> Iterator[tuple[slice, slice, Array]]:
    """Split the samples of many pixels into chunks of at most `CHUNK_SAMPLES` samples.

    For each chunk, yield the slice of pixels, the slice of samples, and the samples as float32.
    """
    width = min(u.shape[-2], CHUNK_SAMPLES)
    height = max(1, CHUNK_SAMPLES // width)
    for row in range(0, pixels, height):
        for column in range(0, u.shape[-2], width):
            rows, columns = slice(row, row + height), slice(column, column + width)
            part = np.ascontiguousarray(u[columns] if u.ndim == 2 else u[rows, columns], np.float32)
            # Comparisons with NaN are false, so this condition also finds NaN
            if not (part.min() >= 0.0 and part.max() <= 1.0):
                raise DomainError(
                    "u has samples that are NaN or outside [0,1); give finite numbers in [0,1)."
                )
            yield rows, columns, part
