"""Spheres lit by an environment map alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.environments import synthetic_sky
from mcspectra.rendering.backend import load_mitsuba
from mcspectra.rendering.builtin.parts import diffuse, named_points, perspective, rectangle

__all__ = ["sky"]

_MAP_SIZE = (64, 128)
_RADIUS = 0.8
_SPHERES: dict[str, tuple[float, dict[str, Any]]] = {
    # name: x of the center, BSDF
    "diffuse": (-1.9, diffuse((0.25, 0.2, 0.15))),
    "plastic": (
        0.0,
        {
            "type": "roughplastic",
            "diffuse_reflectance": {"type": "rgb", "value": [0.1, 0.2, 0.5]},
            "alpha": 0.15,
        },
    ),
    "metal": (1.9, {"type": "roughconductor", "distribution": "ggx", "alpha": 0.15}),
}
_FRONT = 0.6 * _RADIUS  # of the named points, to the camera's side of a sphere and upwards
_UP = _RADIUS + 0.8 * _RADIUS


@named_points(
    floor=(0.0, 0.0, 2.0),
    contact=(-1.9, 0.0, 0.75),
    diffuse=(-1.9, _UP, _FRONT),
    plastic=(0.0, _UP, _FRONT),
    metal=(1.9, _UP, _FRONT),
)
def sky(*, width: int = 384, height: int = 256) -> dict[str, Any]:
    """Diffuse, plastic and metal spheres on a floor under a synthetic sky with a sun.

    Parameters
    ----------
    width, height
        Film size in pixels.

    Returns
    -------
    dict
        The scene for `mitsuba.load_dict`. Shapes: diffuse, plastic, metal, floor; emitter: sky.

    Raises
    ------
    ParameterError
        A film without pixels.

    Notes
    -----
    The map is `mcspectra.integrands.synthetic_sky` with 64 × 128 pixels, its first row towards +y;
    nothing is downloaded. Mitsuba places its columns at atan2(x, −z) = 2π (column + ½) / 128, its
    rows at acos(y) = π row / 63, from pole to pole, and interpolates linearly.
    The named pixels see the floor in the open and where the diffuse sphere touches it, and the
    upper front of each sphere. The BSDF of plastic chooses between two lobes (``dims=3``).
    """
    pixels = synthetic_sky(*_MAP_SIZE).astype(np.float32)
    scene = {
        "type": "scene",
        "sensor": perspective((0.0, 2.2, 8.0), (0.0, 0.75, 0.0), 28.0, width, height),
        "sky": {"type": "envmap", "bitmap": load_mitsuba().Bitmap(pixels)},
        "floor": {**rectangle((0, 0, 0), (8, 0, 0), (0, 0, -8)), "bsdf": diffuse(0.15)},
    }
    return scene | {name: _sphere(x, bsdf) for name, (x, bsdf) in _SPHERES.items()}


def _sphere(x: float, bsdf: dict[str, Any]) -> dict[str, Any]:
    return {"type": "sphere", "center": [x, _RADIUS, 0.0], "radius": _RADIUS, "bsdf": bsdf}
