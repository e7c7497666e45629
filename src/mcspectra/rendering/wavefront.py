"""Direct illumination of many pixels at once, from tables of our own points.

Method
------
A lane is one sample of one pixel. All lanes of a chunk run in one kernel, the strategies are those
of `techniques`, and what comes back is averaged over the samples of each pixel in float64. Chunks
bound the memory by their number of lanes, whatever the number of pixels and samples.

The columns of u are, in this order: two for the position in the pixel, if that is sampled; then
two for the direction, or three if the third selects (a light, or a lobe of the BSDF). The strategy
``mis`` adds up both techniques at the same surface point, so it has one such block for the light
and then one for the BSDF.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_real_array
from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.scenes import (
    Scene,
    film_size,
    find_emitter,
    load_scene,
    scene_name,
    sensor_of,
)
from mcspectra.rendering.techniques import (
    LARGEST_SAMPLE,
    POWERS,
    heuristic_weight,
    sample_bsdf,
    sample_light,
)

__all__ = ["CHUNK_LANES", "FILMS", "WAVEFRONT_STRATEGIES", "Wavefront"]

WAVEFRONT_STRATEGIES = ("light", "bsdf", "mis-light", "mis-bsdf", "mis")
FILMS = ("center", "sampled")
CHUNK_LANES = 2**20
"""Lanes in one kernel: some 200 MiB of Dr.Jit's memory, and no faster if larger."""

_MOST_VALUES = 2**26  # lanes whose values are returned one by one: 768 MiB of float32


@dataclass(frozen=True)
class _Hits:
    """What the camera rays meet, one or many."""

    scene: Any
    interaction: Any
    bsdf: Any


class Wavefront:
    """Direct illumination of a scene, for any pixels and any samples.

    Parameters
    ----------
    scene
        A scene as of `load_scene`.
    light
        Index or name of one light that counts alone; all by default.
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
            self._scene = load_scene(scene)
            self.width, self.height = film_size(scene)
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
            lanes = self._lanes(strategy, pixels[rows], _part(u, rows, columns))
            out[rows] += lanes.sum(axis=1, dtype=np.float64)
        out /= count
        return out

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
                f"u is for {len(u)} pixels, pixels are {len(pixels)}; give one row each."
            )
        if u.shape[-1] < self.dims(strategy):
            raise ParameterError(
                f"u has {u.shape[-1]} dims, but a BSDF of the scene chooses among lobes by a number "
                f"of its own; give {self.dims(strategy)} dims."
            )
        return pixels, u

    def _lanes(self, strategy: str, pixels: Array, u: Array) -> Array:
        """Estimates of one chunk: float32 (P, S, 3)."""
        count = u.shape[-2]
        with LOCK:
            color = self._color(strategy, pixels, _as_samples(u), count)
            lanes = np.asarray(color.numpy())
        # Dr.Jit keeps constants at width 1.
        lanes = np.broadcast_to(lanes, (3, len(pixels) * count)).T
        lanes = lanes.reshape(len(pixels), count, 3)
        if not np.isfinite(lanes).all():
            x, y = pixels[np.argwhere(~np.isfinite(lanes))[0, 0]]
            raise ParameterError(
                f"Mitsuba gave NaN or infinite values at the pixel ({x}, {y}); check the materials "
                "and lights that it sees."
            )
        return lanes

    def _color(self, strategy: str, pixels: Array, u: Array, count: int) -> Any:
        import drjit

        mitsuba = load_mitsuba()
        lane = drjit.arange(mitsuba.UInt32, len(pixels) * count)
        # Opaque: a count written into the kernel would have it compiled anew for each.
        samples = drjit.opaque(mitsuba.UInt32, count)
        pixel = lane // samples
        columns = _columns(u, lane - pixel * samples)
        hits = self._hits(pixels, pixel, columns)
        blocks = columns[2 if self.film == "sampled" else 0 :]
        color = self._direct(strategy, hits, blocks)
        return color + self._seen(hits.interaction) if self.emission else color

    def _hits(self, pixels: Array, pixel: Any, columns: list[Any]) -> _Hits:
        import drjit

        mitsuba = load_mitsuba()
        if self.film == "center":
            kept = self._center_hits(pixels.tobytes())
            at = drjit.gather(mitsuba.SurfaceInteraction3f, kept, pixel)
        else:
            corner = (drjit.gather(mitsuba.Float, c, pixel) for c in _corners(pixels))
            at = self._trace(*(c + u for c, u in zip(corner, columns[:2], strict=True)))
        return _Hits(self._scene, at, at.bsdf())

    def _trace_centers(self, pixels: bytes) -> Any:
        """First hits through the centres of pixels, given as the bytes of int64 (P, 2)."""
        import drjit

        x, y = _corners(np.frombuffer(pixels, np.int64).reshape(-1, 2))
        found = self._trace(x + 0.5, y + 0.5)
        drjit.eval(found)
        return found

    def _trace(self, x: Any, y: Any) -> Any:
        """Follow rays through points of the film, in pixels."""
        import drjit

        mitsuba, sensor = load_mitsuba(), self._scene.sensors()[0]
        size = (drjit.opaque(mitsuba.Float, float(n)) for n in (self.width, self.height))
        position = mitsuba.Point2f(*(p / n for p, n in zip((x, y), size, strict=True)))
        time = sensor.shutter_open() + 0.5 * sensor.shutter_open_time()
        ray, _ = sensor.sample_ray(time, 0.5, position, mitsuba.Point2f(0.5))
        return self._scene.ray_intersect(ray)

    def _direct(self, strategy: str, hits: _Hits, blocks: list[Any]) -> Any:
        """Reflected light by one technique, or by both, each with its own block of columns."""
        if strategy != "mis":
            return self._technique(strategy, hits, blocks)
        half = len(blocks) // 2
        return self._technique("mis-light", hits, blocks[:half]) + self._technique(
            "mis-bsdf", hits, blocks[half:]
        )

    def _technique(self, strategy: str, hits: _Hits, block: list[Any]) -> Any:
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
    """Return float32 samples (dims, …) in [0,1), never rounded up to 1."""
    if not (u.min() >= 0.0 and u.max() <= 1.0):  # NaN fails both
        raise DomainError("Samples must be finite and in [0,1); some are not.")
    columns = np.moveaxis(u, -1, 0).astype(np.float32)
    return np.minimum(columns, np.float32(LARGEST_SAMPLE), out=columns)


def _columns(u: Array, sample: Any) -> list[Any]:
    """Columns of u for each lane; those that all pixels share are gathered by sample."""
    import drjit

    mitsuba = load_mitsuba()
    columns = [mitsuba.Float(np.ascontiguousarray(column).ravel()) for column in u]
    if u.ndim == 3:
        return columns
    return [drjit.gather(mitsuba.Float, column, sample) for column in columns]


def _corners(pixels: Array) -> tuple[Any, Any]:
    mitsuba = load_mitsuba()
    x, y = (mitsuba.Float(np.ascontiguousarray(c, np.float32)) for c in pixels.T)
    return x, y


def _chunks(pixels: int, samples: int) -> Iterator[tuple[slice, slice]]:
    """Slices of pixels and samples of at most `CHUNK_LANES` lanes each."""
    width = min(samples, CHUNK_LANES)
    height = max(1, CHUNK_LANES // width)
    for row in range(0, pixels, height):
        for column in range(0, samples, width):
            yield slice(row, row + height), slice(column, column + width)


def _part(u: Array, rows: slice, columns: slice) -> Array:
    return u[columns] if u.ndim == 2 else u[rows, columns]
