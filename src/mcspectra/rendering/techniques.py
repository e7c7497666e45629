"""Visible surface points of pixels, and the techniques that sample their direct illumination.

A technique, light or BSDF sampling, computes a direction from u in [0,1)² at a surface point.
A technique returns f/p, and the densities of both techniques per steradian [VeachGuibas1995]_.
All samples share one surface point, or each sample has a separate surface point.
Hold the lock `backend.LOCK` around every call.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.rendering.backend import LARGEST_SAMPLE, load_mitsuba
from mcspectra.rendering.scenes import Scene, emitter_name, film_size, load_scene, scene_name

__all__ = [
    "POWERS",
    "Hit",
    "Techniques",
    "check_film_receivers",
    "check_finite",
    "check_pixel",
    "check_receiver",
    "check_single_lobe",
    "chooses_lobe",
    "chosen_channel",
    "corners_of",
    "film_hits",
    "follow_bsdf",
    "follow_camera",
    "heuristic_weight",
    "hits_of",
    "lane_sums",
    "look_at_sky",
    "pixel_sums",
    "primary_hit",
    "sample_bsdf",
    "sample_columns",
    "sample_light",
]

POWERS = {"balance": 1, "power": 2}
"""Exponents β of the power heuristics, by name."""

Techniques = tuple[Any, Any, Any]
"""Three arrays: the value f/p, the density of the technique, and that of the other technique."""

_SCENES, _PIXELS = 4, 256  # number of scenes with cached hits, and number of pixels per scene
_PROBES = 16  # number of tested positions along each side of a pixel


@dataclass(frozen=True)
class Hit:
    """Surface points that one ray hits, or that many rays hit (arrays).

    Attributes
    ----------
    scene, interaction
        The Mitsuba scene, and the surface interactions.
    bsdf
        The BSDF. None if a single ray hits nothing; for many rays, an array of pointers.
    active
        Whether a ray hits a surface that is not a light: one bool, or a mask for many rays.
    shape, light
        For one ray: id of the shape that it hits, and name of the light, or None.
    """

    scene: Any
    interaction: Any
    bsdf: Any
    active: Any = True
    shape: str = ""
    light: str | None = None


def primary_hit(scene: Any, x: int, y: int) -> Hit:
    """Follow the ray through the centers of pixel and lens, at the middle of the shutter's time."""
    return hits_of(scene)(x, y)


@functools.lru_cache(maxsize=_SCENES)
def hits_of(scene: Any) -> Callable[[int, int], Hit]:
    """Return `primary_hit` for one scene, with a cache of the most recent pixels.

    Cached hits keep their scene in memory, with its meshes, textures and BSDFs.
    Dr.Jit traces these BSDFs for all scenes. Therefore only a few scenes are cached.
    """
    return functools.lru_cache(maxsize=_PIXELS)(functools.partial(_primary_hit, scene))


def _primary_hit(scene: Any, x: int, y: int) -> Hit:
    import drjit

    # Make the position an input of the kernel and not a constant in its code.
    # All pixels then share one compiled kernel
    position = load_mitsuba().Point2f(*_on_film(scene, x, y))
    drjit.make_opaque(position)
    interaction = follow_camera(scene, position)
    drjit.make_opaque(interaction)
    emitter = interaction.emitter(scene)[0]
    light = emitter_name(emitter, scene) if emitter else None
    if not interaction.is_valid()[0]:
        return Hit(scene, interaction, None, active=False, light=light)
    shape = str(interaction.shape[0].id())
    return Hit(scene, interaction, interaction.bsdf()[0], light is None, shape, light)


def film_hits(scene: Any, x: int, y: int, film: Array) -> Hit:
    """Follow a ray through each position (M, 2) in [0,1)² of a pixel and the center of the lens.

    In float32, a position is resolved to 2⁻²⁴ of the whole film.
    """
    import drjit

    mitsuba = load_mitsuba()
    columns = [np.ascontiguousarray(c, np.float32) for c in _on_film(scene, x, y, *film.T)]
    interaction = follow_camera(scene, mitsuba.Point2f(*columns))
    shines = interaction.emitter(scene) != drjit.zeros(mitsuba.EmitterPtr)
    return Hit(scene, interaction, interaction.bsdf(), interaction.is_valid() & ~shines)


def follow_camera(scene: Any, position: Any) -> Any:
    """Return the first hits of rays through film positions in [0,1)², at the shutter's mid-time."""
    sensor = scene.sensors()[0]
    time = sensor.shutter_open() + 0.5 * sensor.shutter_open_time()
    mitsuba = load_mitsuba()
    ray, _ = sensor.sample_ray(time, 0.5, position, mitsuba.Point2f(0.5))
    # Coherent rays, those of neighboring pixels together, save 10 % of an image's time
    return scene.ray_intersect(ray, mitsuba.RayFlags.All, True)


def _on_film(scene: Any, x: int, y: int, dx: Any = 0.5, dy: Any = 0.5) -> tuple[Any, Any]:
    """Convert a position in a pixel to float64 coordinates in [0,1) on the film's crop window."""
    width, height = scene.sensors()[0].film().crop_size()
    return (x + dx) / int(width), (y + dy) / int(height)


def check_pixel(scene: Scene, x: object, y: object) -> tuple[int, int]:
    """Return x and y as Python integers. A pixel outside the film is a ParameterError."""
    width, height = film_size(scene)
    try:
        column = as_integer("x", x, least=0, most=width - 1)
        return column, as_integer("y", y, least=0, most=height - 1)
    except ParameterError as error:
        where = scene_name(scene)
        raise ParameterError(f"The pixel is outside the film of {where}: {error}") from None


def check_receiver(scene: Scene, x: int, y: int) -> Hit:
    """Return the surface at the center of a pixel if its reflection can be sampled.

    A ParameterError is raised if the ray hits nothing, a light, or a BSDF that is a delta function.
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
    """Raise a ParameterError unless surfaces at a grid of positions in the pixel can be sampled.

    A part of the pixel may show a light or nothing, but not the whole pixel.
    With `single_lobe`, a BSDF must not need a third random number.
    """
    middles = (np.arange(_PROBES) + 0.5) / _PROBES
    film = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
    loaded = load_scene(scene)
    hits = film_hits(loaded, x, y, film)
    where = f"Pixel ({x}, {y}) of {scene_name(scene)}"
    seen = np.flatnonzero(np.broadcast_to(hits.active.numpy(), len(film)))
    if not seen.size:
        raise ParameterError(
            f"{where} sees only lights or empty space; choose a pixel that sees a surface."
        )
    shapes, bsdfs = hits.interaction.shape, hits.bsdf
    for k in {str(shapes[int(k)].id()): int(k) for k in seen}.values():
        shape = str(shapes[k].id())
        _raise_delta(where, bsdfs[k], shape)
        if single_lobe:
            position = load_mitsuba().Point2f(*map(float, _on_film(loaded, x, y, *film[k])))
            one = follow_camera(loaded, position)
            check_single_lobe(Hit(loaded, one, one.bsdf()[0], shape=shape), dims=4)


def _raise_delta(where: str, bsdf: Any, shape: str) -> None:
    if int(bsdf.flags()) & int(load_mitsuba().BSDFFlags.Delta):
        raise ParameterError(
            f"{where} sees the shape {shape!r}, whose BSDF ({bsdf.class_name()}) has a "
            "perfectly specular part, a delta function; choose a rough or diffuse surface, or "
            "measure whole paths with ",
            Parameter("integrator", "scene"),
            ".",
        )


def check_single_lobe(hit: Hit, dims: int) -> None:
    """Raise an error if a BSDF needs one more random number than there are `dims`."""
    mitsuba = load_mitsuba()
    grid = (np.arange(8, dtype=np.float32) + 0.5) / 8
    u = mitsuba.Point2f(*(mitsuba.Float(c.ravel()) for c in np.meshgrid(grid, grid)))
    if chooses_lobe(hit, u):
        raise ParameterError(
            f"The BSDF of the shape {hit.shape!r} ({hit.bsdf.class_name()}) selects a lobe by "
            "an extra random number; give ",
            Parameter("dims", dims + 1),
            ": the last coordinate then selects the lobe.",
        )


def chooses_lobe(hit: Hit, u: Any) -> bool:
    """Whether directions that the BSDF samples at u depend on a third random number."""
    mitsuba = load_mitsuba()
    context, at = mitsuba.BSDFContext(), hit.interaction
    low, high = (
        hit.bsdf.sample(context, at, mitsuba.Float(lobe), u)[0].wo.numpy()
        for lobe in (0.0, LARGEST_SAMPLE)
    )
    return not np.array_equal(low, high, equal_nan=True)


def sample_columns(u: Array) -> list[Any]:
    """Return the columns of samples u (M, dims) as `Float` in [0,1).

    Values that float32 would round up to 1 are replaced by the largest float32 below 1.
    """
    columns = np.minimum(np.array(u.T, np.float32, order="C"), np.float32(LARGEST_SAMPLE))
    return [load_mitsuba().Float(c) for c in columns]


def corners_of(pixels: Array) -> list[Any]:
    """Return the coordinates x and y of pixels (P, 2) as `Float`."""
    return [load_mitsuba().Float(np.ascontiguousarray(c, np.float32)) for c in pixels.T]


def lane_sums(
    lanes: int, count: int, numbers: int, values: Callable[[Any], Callable[[Any], Sequence[Any]]]
) -> Array:
    """Sum float32 values over k < `count` in float64, separately in each lane: (lanes, numbers).

    A lane is one of many computations that run in parallel.
    Dr.Jit records a single loop over k, so the required memory does not grow with `count`.
    The function `values` gets the numbers of all lanes and returns another function.
    Given k, this other function computes the k-th values of all lanes in parallel.
    """
    import drjit

    mitsuba = load_mitsuba()
    real: Any = drjit.float64_array_t(mitsuba.Float)
    # Make `count` an input of the kernel. As a constant, each new value would need a compilation
    end, at = drjit.opaque(mitsuba.UInt32, count), values(drjit.arange(mitsuba.UInt32, lanes))

    def add(k: Any, *sums: Any) -> tuple[Any, ...]:
        return (k + 1, *(s + real(v) for s, v in zip(sums, at(k), strict=True)))

    start = (mitsuba.UInt32(0), *(drjit.zeros(real, lanes) for _ in range(numbers)))
    _, *sums = drjit.while_loop(start, lambda k, *_: k < end, add)
    drjit.eval(sums)
    return np.stack([np.broadcast_to(s.numpy(), lanes) for s in sums], axis=-1)


def pixel_sums(
    u: Array, pixels: int, numbers: int, values: Callable[[Any], Callable[[Any], Sequence[Any]]]
) -> Array:
    """Sum values over samples u, separately for each realization and pixel: (numbers, R, P).

    Samples u are (R, n, D), equal for all pixels, or (R, P, n, D).

    Each of the parallel lanes computes one realization of one pixel.
    The function `values` gets the pixel of each lane and returns another function.
    Given the index of a row of u, this other function computes the values of the sample in it.
    """
    import drjit

    count, width = (drjit.opaque(load_mitsuba().UInt32, k) for k in (u.shape[-2], pixels))

    def of_lane(lane: Any) -> Callable[[Any], Sequence[Any]]:
        realization = lane // width
        at = values(lane - realization * width)
        first = (lane if u.ndim == 4 else realization) * count
        return lambda k: at(first + k)

    found = lane_sums(len(u) * pixels, u.shape[-2], numbers, of_lane)
    return np.ascontiguousarray(found.T).reshape(numbers, len(u), pixels)


def chosen_channel(color: Any, channel: str | int) -> Any:
    """Return the luminance of a color, or the channel with this index."""
    return load_mitsuba().luminance(color) if channel == "luminance" else color[channel]


def check_finite(values: Array, scene: Scene, pixels: Array) -> None:
    """Raise an error for NaN and infinity among values (P, …) at pixels (P, 2)."""
    if np.isfinite(values.sum()):  # one sum is much faster than testing each value
        return
    bad = ~np.isfinite(values)
    if bad.any():
        x, y = pixels[np.argwhere(bad)[0, 0]]
        raise ParameterError(
            f"Mitsuba gave {np.count_nonzero(bad)} NaN or infinite values, first at pixel "
            f"({x}, {y}) of {scene_name(scene)}; check the materials and lights that it sees."
        )


def sample_light(
    hit: Hit, emitter: Any, u: Any, extra: Any = None, active: Any = True
) -> Techniques:
    """Sample a light with u, a `Point2f`. If `emitter` is None, also choose one of all lights.

    The third number in [0,1), `extra`, selects the light.
    If `extra` is None, the first coordinate of u selects the light as well.
    The value is 0 at points where the mask `active` is False.
    """
    import drjit

    mitsuba, at = load_mitsuba(), hit.interaction
    if emitter is not None:
        sample, weight = emitter.sample_direction(at, u, active)
    elif extra is None:
        sample, weight = hit.scene.sample_emitter_direction(at, u, False, active)
    else:
        index, reciprocal, _ = hit.scene.sample_emitter(extra, active)
        selected = drjit.gather(mitsuba.EmitterPtr, hit.scene.emitters_dr(), index, active)
        sample, weight = selected.sample_direction(at, u, active)
        sample.pdf *= hit.scene.pdf_emitter(index, active)
        weight *= reciprocal
    towards = at.to_local(sample.d)
    value, bsdf_pdf = hit.bsdf.eval_pdf(mitsuba.BSDFContext(), at, towards, active)
    value *= weight
    useful = active & (sample.pdf > 0.0) & drjit.any(value != 0.0)
    visible = useful & ~hit.scene.ray_test(at.spawn_ray_to(sample.p), useful)
    # BSDF sampling never hits a delta light, so its density is 0 there
    other = drjit.select(sample.delta, 0.0, bsdf_pdf)
    return drjit.select(visible, value, 0.0), sample.pdf, other


def sample_bsdf(
    hit: Hit, emitter: Any, u: Any, extra: Any = None, active: Any = True
) -> Techniques:
    """Sample the BSDF. Parameters are as in `sample_light`, but `extra` selects the lobe."""
    value, own, other, _ = follow_bsdf(hit, emitter, u, extra, active)
    return value, own, other


def follow_bsdf(
    hit: Hit, emitter: Any, u: Any, extra: Any = None, active: Any = True
) -> tuple[Any, Any, Any, Any]:
    """Sample the BSDF as in `sample_bsdf`, and also return the direction in the world."""
    import drjit

    mitsuba, at, scene = load_mitsuba(), hit.interaction, hit.scene
    lobe = mitsuba.Float(0.5) if extra is None else extra
    sample, weight = hit.bsdf.sample(mitsuba.BSDFContext(), at, lobe, u, active)
    useful = active & (sample.pdf > 0.0) & drjit.any(weight != 0.0)
    ray = at.spawn_ray(at.to_world(sample.wo))
    # Without UV texture coordinates, the values of textured lights are wrong by 10-15 %
    met = scene.ray_intersect(ray, mitsuba.RayFlags.UV, False, useful)
    found = met.emitter(scene, useful)
    # A ray that hits no light has a null pointer. Calls of a null pointer return zero
    shines = useful if emitter is None else useful & (found == mitsuba.EmitterPtr(emitter))
    value = drjit.select(shines, weight * found.eval(met, shines), 0.0)
    direction = mitsuba.DirectionSample3f(scene, met, at)
    # Light sampling never gives the exact direction of a specular lobe: its density is 0 there
    rough = shines & ~mitsuba.has_flag(sample.sampled_type, mitsuba.BSDFFlags.Delta)
    if emitter is None:
        light_pdf = scene.pdf_emitter_direction(at, direction, rough)
    else:
        light_pdf = emitter.pdf_direction(at, direction, rough)
    return value, sample.pdf, drjit.select(rough, light_pdf, 0.0), ray.d


def look_at_sky(hit: Hit, emitter: Any, direction: Any, active: Any = True) -> tuple[Any, Any]:
    """Evaluate f_r L V cos and the BSDF's density, for directions toward the environment."""
    import drjit

    mitsuba, at = load_mitsuba(), hit.interaction
    value, pdf = hit.bsdf.eval_pdf(mitsuba.BSDFContext(), at, at.to_local(direction), active)
    useful = active & drjit.any(value != 0.0)
    visible = useful & ~hit.scene.ray_test(at.spawn_ray(direction), useful)
    far = drjit.zeros(mitsuba.SurfaceInteraction3f, drjit.width(direction))
    far.wi = -direction
    return drjit.select(visible, value * emitter.eval(far, visible), 0.0), pdf


def heuristic_weight(own: Any, other: Any, power: int) -> Any:
    """Return the weight own^β / (own^β + other^β) of one of two densities.

    The weight is computed from the ratio of the densities.
    For mirrors, the squares of the densities would overflow.
    """
    import drjit

    ratio = drjit.select(own > 0.0, other / own, 0.0)
    return 1.0 / (1.0 + ratio**power)
