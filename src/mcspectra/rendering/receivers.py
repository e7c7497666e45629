"""Surface points seen by a pixel: at its centre, or at every position in the pixel.

Hold `backend.LOCK` around every call.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.rendering.backend import load_mitsuba
from mcspectra.rendering.scenes import (
    Scene,
    emitter_name,
    film_size,
    load_scene,
    scene_name,
)
from mcspectra.rendering.techniques import LARGEST_SAMPLE

__all__ = [
    "Hit",
    "check_film_receivers",
    "check_pixel",
    "check_receiver",
    "check_single_lobe",
    "film_hits",
    "hits_of",
    "primary_hit",
]

_SCENES, _PIXELS = 4, 256  # whose hits are kept; of each scene
_PROBES = 16  # positions along each side of a pixel at which `check_film_receivers` looks


@dataclass(frozen=True)
class Hit:
    """Surfaces met by camera rays.

    Attributes
    ----------
    scene
        The Mitsuba scene.
    interaction
        The surface interactions.
    bsdf
        The BSDF, None if the ray meets nothing; of many rays, a pointer for each.
    active
        Whether there is a surface that does not shine: one bool, or a mask.
    shape, light
        Of one ray: id of the shape, and name of the light it meets or None.
    """

    scene: Any
    interaction: Any
    bsdf: Any
    active: Any
    shape: str = ""
    light: str | None = None


def primary_hit(scene: Any, x: int, y: int) -> Hit:
    """Follow the ray through the centre of pixel, lens and shutter."""
    return hits_of(scene)(x, y)


@functools.lru_cache(maxsize=_SCENES)
def hits_of(scene: Any) -> Callable[[int, int], Hit]:
    """Return `primary_hit` of one scene, which remembers its last pixels.

    Hits keep their scene alive, with its meshes and textures, and BSDFs that Dr.Jit then traces
    for all scenes: so those of few scenes are remembered.
    """
    return functools.lru_cache(maxsize=_PIXELS)(functools.partial(_primary_hit, scene))


def _primary_hit(scene: Any, x: int, y: int) -> Hit:
    import drjit

    mitsuba = load_mitsuba()
    # Opaque: position and point become data, so that all pixels share their compiled kernels.
    position = mitsuba.Point2f(*_on_film(scene, x, y))
    drjit.make_opaque(position)
    interaction = scene.ray_intersect(_camera_ray(scene, position))
    drjit.make_opaque(interaction)
    emitter = interaction.emitter(scene)[0]
    light = emitter_name(emitter, scene) if emitter else None
    if not interaction.is_valid()[0]:
        return Hit(scene, interaction, None, active=False, light=light)
    shape = str(interaction.shape[0].id())
    return Hit(scene, interaction, interaction.bsdf()[0], light is None, shape, light)


def film_hits(scene: Any, x: int, y: int, film: Array) -> Hit:
    """Follow a ray through each position (M, 2) in [0,1)² of a pixel, and the centre of the lens.

    A float32 tells positions apart that differ by 2⁻²⁴ of the whole film.
    """
    import drjit

    mitsuba = load_mitsuba()
    columns = [np.ascontiguousarray(c, np.float32) for c in _on_film(scene, x, y, *film.T)]
    interaction = scene.ray_intersect(_camera_ray(scene, mitsuba.Point2f(*columns)))
    shines = interaction.emitter(scene) != drjit.zeros(mitsuba.EmitterPtr)
    return Hit(scene, interaction, interaction.bsdf(), interaction.is_valid() & ~shines)


def check_pixel(scene: Scene, x: object, y: object) -> tuple[int, int]:
    """Return x and y as Python integers; a pixel off the scene's film is a ParameterError."""
    width, height = film_size(scene)
    try:
        column = as_integer("x", x, least=0, most=width - 1)
        return column, as_integer("y", y, least=0, most=height - 1)
    except ParameterError as error:
        where = scene_name(scene)
        raise ParameterError(f"The pixel is outside the film of {where}: {error}") from None


def check_receiver(scene: Scene, x: int, y: int) -> Hit:
    """Return the surface at the pixel's centre if its reflection can be sampled.

    Raises
    ------
    ParameterError
        It sees nothing, a light, or a BSDF that is a delta function.
    """
    hit = primary_hit(load_scene(scene), x, y)
    where = f"Pixel ({x}, {y}) of {scene_name(scene)}"
    if hit.light is not None:
        raise ParameterError(
            f"{where} sees the light {hit.light!r}; choose a pixel that sees a surface."
        )
    if not hit.bsdf:
        raise ParameterError(f"{where} sees nothing; choose a pixel that sees a surface.")
    _raise_delta(where, hit.bsdf, hit.shape)
    return hit


def check_film_receivers(scene: Scene, x: int, y: int, *, single_lobe: bool) -> None:
    """Raise a ParameterError unless the surfaces on a grid of positions can be sampled.

    Parameters
    ----------
    scene, x, y
        The pixel. Parts of it may see a light or nothing, but not all.
    single_lobe
        Whether a BSDF must do without a third random number.
    """
    middles = (np.arange(_PROBES) + 0.5) / _PROBES
    film = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
    hits = film_hits(load_scene(scene), x, y, film)
    where = f"Pixel ({x}, {y}) of {scene_name(scene)}"
    seen = np.flatnonzero(np.broadcast_to(hits.active.numpy(), len(film)))
    if not seen.size:
        raise ParameterError(
            f"{where} sees only lights or empty space; choose a pixel that sees a surface."
        )
    shapes, bsdfs = hits.interaction.shape, hits.bsdf
    for k in {str(shapes[int(k)].id()): int(k) for k in seen}.values():
        _raise_delta(where, bsdfs[k], str(shapes[k].id()))
        if single_lobe:
            one = _one_of(hits, k, film, x, y)
            check_single_lobe(one, dims=4)


def check_single_lobe(hit: Hit, dims: int) -> None:
    """Refuse a BSDF that needs one random number more than `dims` has."""
    mitsuba = load_mitsuba()
    grid = (np.arange(8, dtype=np.float32) + 0.5) / 8
    u = mitsuba.Point2f(*(mitsuba.Float(c.ravel()) for c in np.meshgrid(grid, grid)))
    low, high = (_sampled_direction(hit, lobe, u).numpy() for lobe in (0.0, LARGEST_SAMPLE))
    if not np.array_equal(low, high, equal_nan=True):
        raise ParameterError(
            f"The BSDF of the shape {hit.shape!r} ({hit.bsdf.class_name()}) selects a lobe by "
            f"an extra random number; give dims={dims + 1}, the last coordinate is that number."
        )


def _one_of(hits: Hit, k: int, film: Array, x: int, y: int) -> Hit:
    """The hit of one of many rays by itself."""
    mitsuba, scene = load_mitsuba(), hits.scene
    position = mitsuba.Point2f(*map(float, _on_film(scene, x, y, *film[k])))
    interaction = scene.ray_intersect(_camera_ray(scene, position))
    shape = str(interaction.shape[0].id())
    return Hit(scene, interaction, interaction.bsdf()[0], active=True, shape=shape)


def _on_film(scene: Any, x: int, y: int, dx: Any = 0.5, dy: Any = 0.5) -> tuple[Any, Any]:
    """Coordinates in [0,1) of a position in a pixel on the film's crop window, in float64."""
    width, height = scene.sensors()[0].film().crop_size()
    return (x + dx) / int(width), (y + dy) / int(height)


def _camera_ray(scene: Any, position: Any) -> Any:
    """The ray through a position of the film, halfway through the shutter's time."""
    sensor = scene.sensors()[0]
    time = sensor.shutter_open() + 0.5 * sensor.shutter_open_time()
    return sensor.sample_ray(time, 0.5, position, load_mitsuba().Point2f(0.5))[0]


def _raise_delta(where: str, bsdf: Any, shape: str) -> None:
    if int(bsdf.flags()) & int(load_mitsuba().BSDFFlags.Delta):
        raise ParameterError(
            f"{where} sees the shape {shape!r}, whose BSDF ({bsdf.class_name()}) has a "
            "perfectly specular part, a delta function; choose a rough or diffuse surface."
        )


def _sampled_direction(hit: Hit, lobe: float, u: Any) -> Any:
    mitsuba = load_mitsuba()
    return hit.bsdf.sample(mitsuba.BSDFContext(), hit.interaction, mitsuba.Float(lobe), u)[0].wo
