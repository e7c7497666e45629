"""Direct illumination of many pixels at once, from tables of our own points.

Method
------
All samples of a chunk of pixels run in one kernel, the strategies are those of `techniques`, and
values are added up over the samples of each pixel in float64 before they leave it. Chunks bound the
memory by their number of samples, whatever the number of pixels and samples a pixel.

The columns of u are, in this order: two for the position in the pixel, if that is sampled; then
two for the direction, or three if the third selects (a light, or a lobe of the BSDF). The strategy
``mis`` adds up both techniques at the same surface point, so it has one such block for the light
and then one for the BSDF.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_real_array
from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.rendering.backend import LARGEST_SAMPLE, LOCK, load_mitsuba
from mcspectra.rendering.kernel_nets import NetPoints
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
    follow_camera,
    heuristic_weight,
    sample_bsdf,
    sample_light,
)

__all__ = ["CHUNK_SAMPLES", "FILMS", "WAVEFRONT_STRATEGIES", "Wavefront"]

WAVEFRONT_STRATEGIES = ("light", "bsdf", "mis-light", "mis-bsdf", "mis")
FILMS = ("center", "sampled")
CHUNK_SAMPLES = 2**20
"""Samples in one kernel: some 200 MiB of Dr.Jit's memory, and no faster if larger."""

_Columns: TypeAlias = Callable[[Any], list[Any]]
_LOOP_SAMPLES = 16  # most samples that a lane runs over: more would leave too few lanes
_MOST_VALUES = 2**26  # lanes whose values are returned one by one: 768 MiB of float32


class _Places:
    """Which pixel and which points each lane takes, `each` of them in succession."""

    def __init__(self, pixels: Array, points: Array | NetPoints, each: int, lanes: int) -> None:
        import drjit

        mitsuba = load_mitsuba()
        self.pixels, self.corners = pixels, _corners(pixels)
        lane = drjit.arange(mitsuba.UInt32, lanes)
        count = drjit.opaque(mitsuba.UInt32, points.shape[-2])
        # Opaque: a count written into the kernel would have it compiled anew for each.
        self.each = drjit.opaque(mitsuba.UInt32, each)
        self.pixel = lane // drjit.opaque(mitsuba.UInt32, points.shape[-2] // each)
        own = self.pixel * count
        if isinstance(points, NetPoints):
            first, net = lane * self.each - own, points.lanes(mitsuba, self.pixel)
            self.columns: _Columns = lambda sample: net(first + sample)
        else:
            row = lane * self.each - (0 if points.ndim == 3 else own)
            table, dims = mitsuba.Float(points.ravel()), points.shape[-1]
            self.columns = lambda sample: _row(table, (row + sample) * dims, dims)


def _row(table: Any, first: Any, dims: int) -> list[Any]:
    """Successive numbers of a table, in [0,1)."""
    import drjit

    columns = (drjit.gather(load_mitsuba().Float, table, first + k) for k in range(dims))
    return [drjit.minimum(column, LARGEST_SAMPLE) for column in columns]


class Wavefront:
    """Direct illumination of a scene, for any pixels and any samples.

    Parameters
    ----------
    scene
        A scene, as for `load_scene`.
    light
        Index or name of the only light to use; all by default.
    film
        ``"center"``: rays through the pixels' centres. ``"sampled"``: through a point of the pixel
        that the first two columns of u choose, uniformly (a box filter).
    heuristic
        ``"balance"`` or ``"power"`` (β = 2), for the ``mis`` strategies.
    emission
        Whether lights that the camera sees are part of the image.

    Raises
    ------
    ParameterError
        A parameter is not one of those allowed, or the scene has no camera or no lights.

    Notes
    -----
    Rays start at the centre of the lens, in the middle of the shutter's time. A light that is a
    delta function has no part in ``bsdf``, nor a specular lobe in ``light``; ``mis`` has both.
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
            sensor_of(scene)
            self._request, self._scene = scene, load_scene(scene)
            check_media(scene)
            self.width, self.height = film_size(scene)
            self._size = _opaque_floats(self.width, self.height)
            self._emitter = None if light is None else find_emitter(scene, light)
            if not self._scene.emitters():
                raise ParameterError(
                    f"The scene {scene_name(scene)} has no lights; add an emitter."
                )
            self.selects_lobe = any(_has_lobes(shape.bsdf()) for shape in self._scene.shapes())
        # Tiles are evaluated again and again with other points, so their first hits are kept.
        self._center_hits = functools.lru_cache(maxsize=4)(self._trace_centers)

    def dims(self, strategy: str, *, select: bool | None = None) -> int:
        """Return the number of columns that a strategy takes.

        With `select` the third of each block selects; by default where a BSDF of the scene needs
        that.
        """
        as_choice("strategy", strategy, WAVEFRONT_STRATEGIES)
        if select is None:
            select = self.selects_lobe and not strategy.endswith("light")
        blocks = 2 if strategy == "mis" else 1
        return 2 * (self.film == "sampled") + blocks * (3 if select else 2)

    def values(self, strategy: str, pixels: Any, u: Any) -> Array:
        """Return the estimate of every sample of every pixel: float32 (P, S, 3).

        Parameters and errors as those of `means`; more than 2^26 samples are refused too.
        """
        pixels, u = self._checked(strategy, pixels, u)
        count = u.shape[-2]
        if len(pixels) * count > _MOST_VALUES:
            raise ParameterError(
                f"{len(pixels)} pixels with {count} samples are {len(pixels) * count:.3g} values; "
                f"ask for {_MOST_VALUES:.3g} at a time, or for means."
            )
        out = np.empty((len(pixels), count, 3), np.float32)
        for rows, columns in _chunks(len(pixels), count):
            out[rows, columns] = self._lanes(strategy, pixels[rows], _part(u, rows, columns))
        return out

    def means(self, strategy: str, pixels: Any, u: Any) -> Array:
        """Return the estimate of every pixel, the mean over its samples.

        Parameters
        ----------
        strategy
            ``"light"``, ``"bsdf"``, their shares of multiple importance sampling ``"mis-light"``
            and ``"mis-bsdf"``, or ``"mis"``, their sum.
        pixels
            Integers (P, 2): x and y, counted from the left and from the top.
        u
            Samples in [0,1), (P, S, dims), or (S, dims) for all pixels alike; see `dims`.

        Returns
        -------
        ndarray
            float64 (P, 3): red, green and blue.

        Raises
        ------
        ParameterError
            An unknown strategy, pixels outside the film, u of the wrong shape, or NaN and infinite
            values from the renderer.
        DomainError
            Samples that are NaN or outside [0,1).
        """
        pixels, u = self._checked(strategy, pixels, u)
        count = u.shape[-2]
        out = np.zeros((len(pixels), 3))
        for rows, columns in _chunks(len(pixels), count):
            out[rows] += self._sums(strategy, pixels[rows], _as_samples(_part(u, rows, columns)))
        out /= count
        return out

    def net_means(self, strategy: str, pixels: Array, points: NetPoints) -> Array:
        """`means` by points that the kernel computes, a set for each pixel; nothing is checked."""
        return self._sums(strategy, pixels, points) / points.count

    def _checked(self, strategy: str, pixels: Any, u: Any) -> tuple[Array, Array]:
        allowed = (self.dims(strategy, select=False), self.dims(strategy, select=True))
        pixels = _as_pixels(pixels, self.width, self.height)
        u = as_real_array("u", u)
        if u.ndim not in (2, 3) or u.shape[-1] not in allowed or u.shape[-2] == 0:
            raise ParameterError(
                f"u has shape {u.shape}; {strategy!r} takes (pixels, samples, dims) or "
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

    def _lanes(self, strategy: str, pixels: Array, u: Array) -> Array:
        """Estimates of one chunk: float32 (P, S, 3)."""
        count = u.shape[-2]
        with LOCK:
            place = _Places(pixels, _as_samples(u), 1, len(pixels) * count)
            color = self._color(strategy, place, self._center(place), 0)
            lanes = np.asarray(color.numpy())
        # Dr.Jit keeps constants at width 1.
        lanes = np.broadcast_to(lanes, (3, len(pixels) * count)).T
        lanes = lanes.reshape(len(pixels), count, 3)
        check_finite(lanes, self._request, pixels)
        return lanes

    def _sums(self, strategy: str, pixels: Array, points: Array | NetPoints) -> Array:
        """Sums over the samples of each pixel of one chunk: float64 (P, 3).

        A lane runs over some samples of its pixel in a recorded loop, so that one number a lane is
        stored, in float64.
        """
        import drjit

        mitsuba = load_mitsuba()
        count = points.shape[-2]
        each = max(k for k in range(1, _LOOP_SAMPLES + 1) if count % k == 0)
        lanes = len(pixels) * (count // each)
        with LOCK:
            place = _Places(pixels, points, each, lanes)
            center = self._center(place)

            def more(sample: Any, _: Any) -> Any:
                return sample < place.each

            def add(sample: Any, total: Any) -> tuple[Any, Any]:
                color = self._color(strategy, place, center, sample)
                return sample + 1, total + mitsuba.Color3d(color)

            start = drjit.zeros(mitsuba.UInt32, lanes), drjit.zeros(mitsuba.Color3d, lanes)
            _, total = drjit.while_loop(start, more, add, mode="symbolic")
            parts: Array = total.numpy().T.reshape(len(pixels), -1, 3)
        sums: Array = parts.sum(axis=1) if parts.shape[1] > 1 else parts[:, 0]
        check_finite(sums, self._request, pixels)
        return sums

    def _color(self, strategy: str, place: _Places, center: Hit | None, sample: Any) -> Any:
        """Estimates of the lanes of a chunk, float32, each by one of its samples."""
        columns = place.columns(sample)
        hits = self._sampled(place, columns) if center is None else center
        blocks = columns if center is not None else columns[2:]
        color = self._direct(strategy, hits, blocks)
        return color + self._seen(hits.interaction) if self.emission else color

    def _center(self, place: _Places) -> Hit | None:
        """What the lanes' rays through the centres of pixels meet; None if others are taken."""
        import drjit

        if self.film == "sampled":
            return None
        kept = self._center_hits(place.pixels.tobytes())
        at = drjit.gather(load_mitsuba().SurfaceInteraction3f, kept, place.pixel)
        return Hit(self._scene, at, at.bsdf())

    def _sampled(self, place: _Places, columns: list[Any]) -> Hit:
        """What rays through the points of the film that the first two columns choose meet."""
        import drjit

        corner = (drjit.gather(load_mitsuba().Float, c, place.pixel) for c in place.corners)
        at = self._trace(*(c + u for c, u in zip(corner, columns[:2], strict=True)))
        return Hit(self._scene, at, at.bsdf())

    def _trace_centers(self, pixels: bytes) -> Any:
        """First hits through the centres of pixels, given as the bytes of int64 (P, 2)."""
        import drjit

        x, y = _corners(np.frombuffer(pixels, np.int64).reshape(-1, 2))
        found = self._trace(x + 0.5, y + 0.5)
        drjit.eval(found)
        return found

    def _trace(self, x: Any, y: Any) -> Any:
        """Follow rays through points of the film, in pixels."""
        position = load_mitsuba().Point2f(x / self._size[0], y / self._size[1])
        return follow_camera(self._scene, position)

    def _direct(self, strategy: str, hits: Hit, blocks: list[Any]) -> Any:
        """Reflected light by one technique, or by both, each with its own block of columns."""
        if strategy != "mis":
            return self._technique(strategy, hits, blocks)
        half = len(blocks) // 2
        return self._technique("mis-light", hits, blocks[:half]) + self._technique(
            "mis-bsdf", hits, blocks[half:]
        )

    def _technique(self, strategy: str, hits: Hit, block: list[Any]) -> Any:
        mitsuba = load_mitsuba()
        sample = sample_light if strategy.endswith("light") else sample_bsdf
        extra = block[2] if len(block) == 3 else None
        active = hits.interaction.is_valid()
        direction = mitsuba.Point2f(block[0], block[1])
        value, own, other = sample(hits, self._emitter, direction, extra, active)
        if strategy.startswith("mis"):
            value *= heuristic_weight(own, other, POWERS[self.heuristic])
        return value

    def _seen(self, interaction: Any) -> Any:
        """Light that the camera sees itself."""
        mitsuba = load_mitsuba()
        found = interaction.emitter(self._scene)
        counts = True if self._emitter is None else found == mitsuba.EmitterPtr(self._emitter)
        return found.eval(interaction, counts)


def _has_lobes(bsdf: Any) -> bool:
    """Whether a BSDF has several components on a side, among which a random number chooses."""
    flags = load_mitsuba().BSDFFlags
    parts = [int(bsdf.flags(i)) for i in range(bsdf.component_count())]
    sides = (int(flags.FrontSide), int(flags.BackSide))
    return any(sum(bool(part & side) for part in parts) > 1 for side in sides)


def _as_pixels(pixels: Any, width: int, height: int) -> Array:
    given = np.asarray(pixels)
    if given.dtype.kind not in "iu" or given.ndim != 2 or given.shape[1] != 2 or len(given) == 0:
        raise ParameterError(
            f"pixels have shape {given.shape} and type {given.dtype}; give integers (P, 2), "
            "x and y of each."
        )
    outside = ((given < 0) | (given >= (width, height))).any(axis=1)
    if outside.any():
        x, y = given[outside][0]
        raise ParameterError(
            f"The pixel ({x}, {y}) is outside the film; x runs from 0 to {width - 1}, "
            f"y from 0 to {height - 1}."
        )
    return np.ascontiguousarray(given, np.int64)


def _as_samples(u: Array) -> Array:
    """Return contiguous float32 samples after checking their range."""
    samples = np.ascontiguousarray(u, np.float32)
    if not (samples.min() >= 0.0 and samples.max() <= 1.0):  # NaN fails both
        raise DomainError(
            "u has samples that are NaN or outside [0,1); give finite numbers in [0,1)."
        )
    return samples


def _opaque_floats(*numbers: int) -> tuple[Any, ...]:
    """Numbers as data of kernels: division by one written into a kernel is rounded otherwise."""
    import drjit

    return tuple(drjit.opaque(load_mitsuba().Float, float(number)) for number in numbers)


def _corners(pixels: Array) -> tuple[Any, Any]:
    mitsuba = load_mitsuba()
    x, y = (mitsuba.Float(np.ascontiguousarray(c, np.float32)) for c in pixels.T)
    return x, y


def _chunks(pixels: int, samples: int) -> Iterator[tuple[slice, slice]]:
    """Slices of pixels and samples of at most `CHUNK_SAMPLES` samples each."""
    width = min(samples, CHUNK_SAMPLES)
    height = max(1, CHUNK_SAMPLES // width)
    for row in range(0, pixels, height):
        for column in range(0, samples, width):
            yield slice(row, row + height), slice(column, column + width)


def _part(u: Array, rows: slice, columns: slice) -> Array:
    return u[columns] if u.ndim == 2 else u[rows, columns]
