"""Light that arrives at a pixel's point, over the directions above it: f before any sampling."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.results import dataset
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.draws import check_channel
from mcspectra.rendering.receivers import Hit, check_pixel, check_receiver
from mcspectra.rendering.scene_checks import check_lights
from mcspectra.rendering.scenes import Scene, as_scene, find_emitter, scene_name

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["incident_light"]


def incident_light(
    scene: Scene,
    x: int,
    y: int,
    *,
    light: int | str | None = None,
    channel: str | int = "luminance",
    resolution: int = 128,
) -> xr.Dataset:
    """Look from the point that a pixel's centre sees in all directions of the upper hemisphere.

    Parameters
    ----------
    scene, x, y, light
        As for `Pixel`.
    channel
        ``"luminance"``, 0, 1 or 2.
    resolution
        Rows of elevation, 4 to 1024; there are four times as many columns of azimuth.

    Returns
    -------
    xarray.Dataset
        On (elevation, azimuth), in degrees above the surface and around its shading normal, at the
        centres of cells: ``incident_radiance``, L_e of the lights that count, where nothing is in
        the way; ``reflected_radiance``, f_r L_e cos per steradian, whose integral over directions is
        that of every strategy of `Pixel`. "Above" is the side of the camera.

    Raises
    ------
    ParameterError
        As for `Pixel`, or `resolution` is out of range, or the channel is ``"rgb"``.
    """
    request = as_scene(scene)
    rows = as_integer("resolution", resolution, least=4, most=1024)
    chosen = check_channel(channel)
    if chosen == "rgb":
        raise ParameterError("channel is 'rgb'; give 'luminance', 0, 1 or 2, one at a time.")
    elevation = (np.arange(rows) + 0.5) * (90.0 / rows)
    azimuth = (np.arange(4 * rows) + 0.5) * (90.0 / rows)
    with LOCK:
        x, y = check_pixel(request, x, y)
        check_lights(request, light)
        hit = check_receiver(request, x, y)
        emitter = None if light is None else find_emitter(request, light)
        seen = _look(hit, emitter, _directions(elevation, azimuth), chosen)
    shape = (elevation.size, azimuth.size)
    names = ("incident_radiance", "reflected_radiance")
    dims = ("elevation", "azimuth")
    return dataset(
        {name: (dims, values.reshape(shape)) for name, values in zip(names, seen, strict=True)},
        {"elevation": elevation, "azimuth": azimuth},
        scene=scene_name(request),
        x=x,
        y=y,
        light=light,
        channel=chosen,
    )


def _directions(elevation: Array, azimuth: Array) -> Array:
    """Unit vectors (3, rows · columns) in the frame of the surface."""
    up, around = np.meshgrid(np.radians(elevation), np.radians(azimuth), indexing="ij")
    level = np.cos(up)
    vectors = np.stack([level * np.cos(around), level * np.sin(around), np.sin(up)])
    return vectors.reshape(3, -1)


def _look(hit: Hit, emitter: Any, directions: Array, channel: str | int) -> tuple[Array, Array]:
    """L and f_r L cos along each direction."""
    import drjit

    mitsuba, at = load_mitsuba(), hit.interaction
    side = np.where(at.wi.z.numpy() < 0.0, -1.0, 1.0)
    local = directions * np.array([1.0, 1.0, side.item()])[:, None]
    towards = mitsuba.Vector3f(*(np.ascontiguousarray(c, np.float32) for c in local))
    # UV: without texture coordinates textured lights come out wrong.
    met = hit.scene.ray_intersect(at.spawn_ray(at.to_world(towards)), mitsuba.RayFlags.UV, False)
    found = met.emitter(hit.scene)
    counts = True if emitter is None else found == mitsuba.EmitterPtr(emitter)
    radiance = drjit.select(counts, found.eval(met), 0.0)
    reflected = radiance * hit.bsdf.eval(mitsuba.BSDFContext(), at, towards)
    width = directions.shape[1]
    return _numbers(radiance, channel, width), _numbers(reflected, channel, width)


def _numbers(color: Any, channel: str | int, count: int) -> Array:
    chosen = load_mitsuba().luminance(color) if channel == "luminance" else color[channel]
    return np.broadcast_to(np.asarray(chosen.numpy(), np.float64), count)
