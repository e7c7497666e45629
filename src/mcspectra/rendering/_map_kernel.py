"""Estimates of many pixels by many realisations: one Dr.Jit loop over the samples of each.

A lane is one realisation of one pixel and runs over its samples in a recorded loop, which adds up
float32 values in float64. So what is copied is one number a lane, memory does not grow with the
number of samples, and a lane has the same bits whichever others run beside it. A technique's plain
estimate and its weighted one, for multiple importance sampling, come from one evaluation. Measured
against one lane a sample with a sum over blocks: 2 to 3 times as fast (two cores, Veach's scene).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.scenes import Scene, find_emitter, load_scene, scene_name
from mcspectra.rendering.techniques import (
    LARGEST_SAMPLE,
    POWERS,
    heuristic_weight,
    sample_bsdf,
    sample_light,
)

__all__ = ["NOTHING", "RECEIVER", "SHINES", "SPECULAR", "TECHNIQUES", "Lighting", "Receivers"]

TECHNIQUES = ("light", "bsdf")
RECEIVER, NOTHING, SHINES, SPECULAR = range(4)
"""What a pixel sees: a surface that is lit, nothing, a light, a perfectly specular surface."""

_SAMPLE: Final = {"light": sample_light, "bsdf": sample_bsdf}


@final
@dataclass(frozen=True, kw_only=True)
class Lighting:
    """Which light is estimated, and on which grid of pixels.

    Attributes
    ----------
    scene, light, heuristic, channel
        As those of `Pixel`; no ``"rgb"``.
    size
        Width and height in pixels of the grid laid over the film.
    """

    scene: Scene
    light: int | str | None
    heuristic: str
    channel: str | int
    size: tuple[int, int]


@dataclass(frozen=True)
class _Hits:
    """Surface points for `techniques`."""

    scene: Any
    interaction: Any
    bsdf: Any


class Receivers:
    """The lit surface points that pixels see, and estimates of their direct illumination.

    Parameters
    ----------
    lighting
        Scene, lights and grid.
    pixels
        Integers (P, 2), x and y of each; within the grid.

    Attributes
    ----------
    status
        What each pixel sees, int8 (P,): `RECEIVER` where there is something to estimate.
    pixels
        Those of the receivers, whose estimates are made; a single one stands twice.
    """

    def __init__(self, lighting: Lighting, pixels: Array) -> None:
        self._lighting = lighting
        with LOCK:
            load_mitsuba()  # before anyone imports Dr.Jit: it picks the libLLVM that works
            self.status = self._look(pixels)[0]
            seen = pixels[self.status == RECEIVER]
            # NumPy adds up a single column in another order than many: one pixel stands twice.
            self.pixels = np.repeat(seen, 2, axis=0) if len(seen) == 1 else seen
            # Traced again for these alone, so that no lane is spent on the others.
            self._kept = self._look(self.pixels)[1] if len(self.pixels) else None

    def __len__(self) -> int:
        return len(self.pixels)

    def estimates(self, technique: str, u: Array) -> tuple[Array, Array]:
        """Return plain and weighted estimates: float64 (R, P) each, means over samples.

        Parameters
        ----------
        technique
            ``"light"`` or ``"bsdf"``.
        u
            Samples, (R, n, dims) for all pixels alike, or (R, P, n, dims); dims 2, or 3 with the
            third selecting a light or a lobe.

        Raises
        ------
        ParameterError
            Mitsuba gives NaN or infinite values.
        """
        with LOCK:
            sums = self._sums(technique, u)
        for each in sums:
            self._check_finite(each)
        return sums[0] / u.shape[-2], sums[1] / u.shape[-2]

    def values(self, technique: str, u: Array) -> tuple[Array, Array]:
        """Return plain and weighted values at samples u (N, dims): float64 (N, P) each."""
        return self.estimates(technique, u[:, None, :])

    def chooses_lobe(self) -> bool:
        """Whether a BSDF asks for a third random number, which two dims cannot give it."""
        with LOCK:
            low, high = (self._directions(lobe) for lobe in (0.0, LARGEST_SAMPLE))
        return not np.array_equal(low, high, equal_nan=True)

    def _look(self, pixels: Array) -> tuple[Array, Any]:
        """Status of pixels and their first hits, as data: kernels are shared by all pixels."""
        import drjit

        mitsuba, scene = load_mitsuba(), load_scene(self._lighting.scene)
        sensor = scene.sensors()[0]
        position = ((pixels + 0.5) / self._lighting.size).astype(np.float32)
        film = mitsuba.Point2f(*(mitsuba.Float(np.ascontiguousarray(c)) for c in position.T))
        time = sensor.shutter_open() + 0.5 * sensor.shutter_open_time()
        ray, _ = sensor.sample_ray(time, 0.5, film, mitsuba.Point2f(0.5))
        at = scene.ray_intersect(ray)
        specular = mitsuba.has_flag(at.bsdf().flags(), mitsuba.BSDFFlags.Delta)
        status = drjit.select(specular, mitsuba.Int32(SPECULAR), RECEIVER)
        status[at.emitter(scene) != None] = SHINES  # `is not` would not compare lane by lane
        status[~at.is_valid()] = NOTHING
        drjit.make_opaque(at)
        return np.broadcast_to(np.asarray(status.numpy()), len(pixels)).astype(np.int8), at

    def _gathered(self, pixel: Any) -> _Hits:
        import drjit

        at = drjit.gather(load_mitsuba().SurfaceInteraction3f, self._kept, pixel)
        return _Hits(load_scene(self._lighting.scene), at, at.bsdf())

    def _sums(self, technique: str, u: Array) -> tuple[Array, Array]:
        import drjit

        mitsuba, lanes = load_mitsuba(), len(u) * len(self)
        total: Any = drjit.float64_array_t(mitsuba.Float)
        columns = [mitsuba.Float(c) for c in _columns(u)]
        # Opaque: numbers written into the kernel would have it compiled anew for each.
        count, width = (drjit.opaque(mitsuba.UInt32, k) for k in (u.shape[-2], len(self)))
        lane = drjit.arange(mitsuba.UInt32, lanes)
        realization = lane // width
        hits = self._gathered(lane - realization * width)
        first = (lane if u.ndim == 4 else realization) * count

        def add(k: Any, plain: Any, weighted: Any) -> tuple[Any, Any, Any]:
            sample = [drjit.gather(mitsuba.Float, c, first + k) for c in columns]
            value, weight = self._value(technique, hits, sample)
            return k + 1, plain + total(value), weighted + total(value * weight)

        start = (mitsuba.UInt32(0), drjit.zeros(total, lanes), drjit.zeros(total, lanes))
        sums: Any = drjit.while_loop(start, lambda k, *_: k < count, add)
        plain, weighted = sums[1:]
        drjit.eval(plain, weighted)
        shape = (len(u), len(self))
        return np.asarray(plain.numpy()).reshape(shape), np.asarray(weighted.numpy()).reshape(shape)

    def _value(self, technique: str, hits: _Hits, sample: list[Any]) -> tuple[Any, Any]:
        """Value of one sample in the chosen channel, and its weight."""
        mitsuba, own = load_mitsuba(), self._lighting
        emitter = None if own.light is None else find_emitter(own.scene, own.light)
        extra = sample[2] if len(sample) == 3 else None
        u = mitsuba.Point2f(sample[0], sample[1])
        color, density, other = _SAMPLE[technique](hits, emitter, u, extra)
        chosen = mitsuba.luminance(color) if own.channel == "luminance" else color[own.channel]
        return chosen, heuristic_weight(density, other, POWERS[own.heuristic])

    def _directions(self, lobe: float) -> Array:
        """Directions of BSDF sampling, eight at every point."""
        import drjit

        mitsuba, tries = load_mitsuba(), 8
        lane = drjit.arange(mitsuba.UInt32, len(self) * tries)
        hits = self._gathered(lane // tries)
        u = mitsuba.Point2f(*((mitsuba.Float(k * lane % tries) + 0.5) / tries for k in (1, 3)))
        context = mitsuba.BSDFContext()
        sample, _ = hits.bsdf.sample(context, hits.interaction, mitsuba.Float(lobe), u)
        return np.asarray(sample.wo.numpy())

    def _check_finite(self, estimates: Array) -> None:
        if np.isfinite(estimates).all():
            return
        x, y = self.pixels[np.argwhere(~np.isfinite(estimates))[0, 1]]
        raise ParameterError(
            f"Mitsuba gave NaN or infinite values at the pixel ({x}, {y}) of "
            f"{scene_name(self._lighting.scene)}; check the materials and lights that it sees."
        )


def _columns(u: Array) -> list[Array]:
    """Columns of samples as float32 in [0,1), never rounded up to 1."""
    flat = np.minimum(u.reshape(-1, u.shape[-1]).T, LARGEST_SAMPLE)
    return list(np.ascontiguousarray(flat, np.float32))
