"""A pixel's direct illumination as an integrand on the unit square (Mitsuba 3, ``llvm_ad_rgb``).

Method
------
The camera ray through the pixel's centre fixes one surface point, once and for all. Its direct
illumination is ∫ f_r L_e V cos over directions, and each strategy is the primary-space integrand
g(u) = f/p at the direction that the renderer makes of u in [0,1)²: ``light`` samples a light,
``bsdf`` the BSDF. With ``mis-light`` and ``mis-bsdf`` each is weighted by a heuristic
[VeachGuibas1995]_ for equal numbers of samples, so that their sum, with independent points, is
multiple importance sampling. What the camera itself sees of a light is no part of it.

Mitsuba computes in float32: values carry relative errors of about 1e-7, and averages of them are
taken in float64. One light alone is the clean experiment. With all lights Mitsuba selects one
(uniformly, or by ``sampling_weight``) by stretching the first coordinate, which cuts the square
into strips and adds discontinuities; ``dims=3`` selects by a third coordinate instead.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.integrands.base import Integrand
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.scenes import emitter_name, film_size, find_emitter, load_scene, sensor_of
from mcspectra.rendering.techniques import (
    LARGEST_SAMPLE,
    POWERS,
    heuristic_weight,
    sample_bsdf,
    sample_light,
)

__all__ = ["STRATEGIES", "Pixel", "describe_pixel", "pixel_strategies"]

STRATEGIES = ("light", "bsdf", "mis-light", "mis-bsdf")
_CHUNK = 2**20  # samples in one kernel: some 100 MiB of Dr.Jit's memory, and no faster if larger


@final
@dataclass(frozen=True, kw_only=True)
class Pixel(Integrand):
    """Direct illumination seen in one pixel of a scene, by light or BSDF sampling.

    Parameters
    ----------
    scene
        A scene's name or the path of a Mitsuba XML file (see `load_scene`).
    x, y
        Pixel, counted from the left and from the top. The ray goes through its centre.
    strategy
        ``"light"``, ``"bsdf"``, or their shares of multiple importance sampling, ``"mis-light"``
        and ``"mis-bsdf"``, which belong together.
    light
        Index or name of one light that counts alone, the others being dark but in the way. All
        lights by default.
    heuristic
        ``"balance"`` or ``"power"`` (β = 2), for the two ``mis-`` strategies.
    channel
        ``"luminance"`` (Rec. 709), 0, 1 or 2 for red, green or blue, or ``"rgb"`` for all three.
    dims
        2, or 3 to leave the choice of a light, or of a lobe of the BSDF, to a third coordinate.

    Raises
    ------
    ParameterError
        The pixel is outside the film, sees nothing or a light; its BSDF or a light that counts is
        a delta function; its BSDF needs ``dims=3``; there is no such light; or a parameter is not
        one of those allowed.
    MissingDependency
        Mitsuba or LLVM is missing.
    """

    name: ClassVar[str] = "pixel"
    scene: str = "veach"
    x: int
    y: int
    strategy: str = "light"
    light: int | str | None = None
    heuristic: str = "balance"
    channel: str | int = "luminance"
    dims: int = 2

    def __post_init__(self) -> None:
        as_choice("strategy", self.strategy, STRATEGIES)
        as_choice("heuristic", self.heuristic, tuple(POWERS))
        _check_channel(self.channel)
        as_integer("dims of a pixel", self.dims, least=2, most=3)
        with LOCK:
            hit = _receiver(self.scene, self.x, self.y)
            _check_lights(self.scene, self.light)
            if self.strategy.endswith("bsdf") and self.dims == 2:
                _check_single_lobe(hit)

    @property
    def channels(self) -> int:  # type: ignore[override]
        """3 with ``channel="rgb"``, else 0."""
        return 3 if self.channel == "rgb" else 0

    def _evaluate(self, x: Array) -> Array:
        samples = _as_samples(x.reshape(-1, self.dims))
        out = np.empty((len(samples), 3) if self.channels else len(samples))
        for start in range(0, len(samples), _CHUNK):
            part = slice(start, start + _CHUNK)
            with LOCK:
                out[part] = self._render(samples[part])
        if not np.isfinite(out).all():
            bad = int(np.count_nonzero(~np.isfinite(out)))
            raise ParameterError(
                f"Mitsuba gave {bad} NaN or infinite values for {self.spec}; "
                "check the scene's materials and lights."
            )
        return out.reshape((*x.shape[:-1], *out.shape[1:]))

    def _render(self, samples: Array) -> Array:
        """Values at float32 samples (M, dims): float32 (M,) or (M, 3)."""
        mitsuba, hit = load_mitsuba(), _primary_hit(load_scene(self.scene), self.x, self.y)
        emitter = None if self.light is None else find_emitter(self.scene, self.light)
        u = mitsuba.Point2f(*(mitsuba.Float(np.ascontiguousarray(c)) for c in samples.T[:2]))
        extra = mitsuba.Float(np.ascontiguousarray(samples[:, 2])) if self.dims == 3 else None
        technique = sample_light if self.strategy.endswith("light") else sample_bsdf
        value, own, other = technique(hit, emitter, u, extra)
        if self.strategy.startswith("mis"):
            value *= heuristic_weight(own, other, POWERS[self.heuristic])
        return _numbers(value, self.channel, len(samples))


def pixel_strategies(
    scene: str,
    x: int,
    y: int,
    *,
    light: int | str | None = None,
    heuristic: str = "balance",
    channel: str | int = "luminance",
    dims: int = 2,
) -> dict[str, Integrand]:
    """Return all strategies of a pixel by name; parameters and errors as those of `Pixel`."""
    return {
        strategy: Pixel(
            scene=scene,
            x=x,
            y=y,
            strategy=strategy,
            light=light,
            heuristic=heuristic,
            channel=channel,
            dims=dims,
        )
        for strategy in STRATEGIES
    }


def describe_pixel(scene: str, x: int, y: int) -> dict[str, Any]:
    """Say what the ray through a pixel's centre meets.

    Returns
    -------
    dict
        ``shape`` (id), ``bsdf`` (type), ``light`` (name if the shape emits, else None),
        ``position`` and ``normal`` (three floats each, world space); all None where the ray leaves
        the scene.

    Raises
    ------
    ParameterError
        The pixel is outside the film.
    """
    with LOCK:
        _check_pixel(scene, x, y)
        hit = _primary_hit(load_scene(scene), x, y)
        if not hit.bsdf:
            return dict.fromkeys(("shape", "bsdf", "light", "position", "normal"))
        return {
            "shape": hit.shape,
            "bsdf": hit.bsdf.class_name(),
            "light": hit.light,
            "position": _triple(hit.interaction.p),
            "normal": _triple(hit.interaction.n),
        }


@dataclass(frozen=True)
class _Hit:
    """What the camera ray meets; `bsdf` is None if it meets nothing, `light` if nothing shines."""

    scene: Any
    interaction: Any
    shape: str
    bsdf: Any
    light: str | None


@functools.lru_cache(maxsize=256)
def _primary_hit(scene: Any, x: int, y: int) -> _Hit:
    """Follow the ray through the centre of pixel, lens and shutter."""
    import drjit

    mitsuba, sensor = load_mitsuba(), scene.sensors()[0]
    width, height = sensor.film().crop_size()
    position = mitsuba.Point2f((x + 0.5) / int(width), (y + 0.5) / int(height))
    time = sensor.shutter_open() + 0.5 * sensor.shutter_open_time()
    ray, _ = sensor.sample_ray(time, 0.5, position, mitsuba.Point2f(0.5))
    interaction = scene.ray_intersect(ray)
    # Opaque: the point becomes data, so that all pixels share their compiled kernels.
    drjit.make_opaque(interaction)
    emitter = interaction.emitter(scene)[0]
    light = emitter_name(emitter) if emitter else None
    if not interaction.is_valid()[0]:
        return _Hit(scene, interaction, "", None, light)
    shape = interaction.shape[0]
    return _Hit(scene, interaction, str(shape.id()), interaction.bsdf()[0], light)


def _receiver(scene: str, x: int, y: int) -> _Hit:
    """Return the hit of a pixel that reflects light in a way that can be sampled."""
    _check_pixel(scene, x, y)
    hit = _primary_hit(load_scene(scene), x, y)
    where = f"Pixel ({x}, {y}) of {scene!r}"
    if hit.light is not None:
        raise ParameterError(f"{where} sees the light {hit.light!r}; choose a surface it lights.")
    if not hit.bsdf:
        raise ParameterError(f"{where} sees nothing; choose one that sees a surface.")
    if int(hit.bsdf.flags()) & int(load_mitsuba().BSDFFlags.Delta):
        raise ParameterError(
            f"{where} sees the shape {hit.shape!r}, whose BSDF ({hit.bsdf.class_name()}) has a "
            "perfectly specular part, a delta function; choose a rough or diffuse surface."
        )
    return hit


def _check_pixel(scene: str, x: object, y: object) -> None:
    sensor_of(scene)
    for name, value, size in zip("xy", (x, y), film_size(scene), strict=True):
        try:
            as_integer(name, value, least=0, most=size - 1)
        except ParameterError as error:
            raise ParameterError(f"The pixel is outside the film of {scene!r}: {error}") from None


def _check_channel(channel: object) -> None:
    if channel in ("luminance", "rgb") or (type(channel) is int and 0 <= channel <= 2):
        return
    raise ParameterError(f"channel is {channel!r}; give 'luminance', 'rgb', 0, 1 or 2.")


def _check_lights(scene: str, light: int | str | None) -> None:
    chosen = load_scene(scene).emitters() if light is None else [find_emitter(scene, light)]
    if not chosen:
        raise ParameterError(f"The scene {scene!r} has no lights; add an emitter to it.")
    delta = int(load_mitsuba().EmitterFlags.Delta)
    for emitter in chosen:
        if int(emitter.flags()) & delta:
            raise ParameterError(
                f"The light {emitter_name(emitter)!r} of {scene!r} ({emitter.class_name()}) is a "
                "delta function, which BSDF sampling never meets; choose another with light=."
            )


def _check_single_lobe(hit: _Hit) -> None:
    """Refuse a BSDF that asks for a third random number, which two dims cannot give it."""
    mitsuba = load_mitsuba()
    grid = (np.arange(8, dtype=np.float32) + 0.5) / 8
    u = mitsuba.Point2f(*(mitsuba.Float(c.ravel()) for c in np.meshgrid(grid, grid)))
    low, high = (_sample_direction(hit, lobe, u).numpy() for lobe in (0.0, LARGEST_SAMPLE))
    if not np.array_equal(low, high, equal_nan=True):
        raise ParameterError(
            f"The BSDF of the shape {hit.shape!r} ({hit.bsdf.class_name()}) chooses among lobes by "
            "a random number of its own; give dims=3, the third coordinate will be that number."
        )


def _sample_direction(hit: _Hit, lobe: float, u: Any) -> Any:
    mitsuba = load_mitsuba()
    return hit.bsdf.sample(mitsuba.BSDFContext(), hit.interaction, mitsuba.Float(lobe), u)[0].wo


def _as_samples(u: Array) -> Array:
    """Return float32 samples in [0,1), never rounded up to 1."""
    if u.size and not (np.isfinite(u).all() and u.min() >= 0.0 and u.max() <= 1.0):
        raise DomainError("A pixel's samples must be finite and in [0,1); some are not.")
    return np.minimum(u, LARGEST_SAMPLE).astype(np.float32)


def _numbers(color: Any, channel: str | int, count: int) -> Array:
    """Copy a color to an array (count,) or (count, 3); Dr.Jit keeps constants at width 1."""
    if channel == "rgb":
        return np.broadcast_to(np.asarray(color.numpy()).T, (count, 3))
    chosen = load_mitsuba().luminance(color) if channel == "luminance" else color[channel]
    return np.broadcast_to(np.asarray(chosen.numpy()), (count,))


def _triple(vector: Any) -> tuple[float, float, float]:
    return float(vector.x[0]), float(vector.y[0]), float(vector.z[0])
