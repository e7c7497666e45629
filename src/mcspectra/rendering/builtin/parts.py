"""Parts of the built-in scenes: a camera, rectangles, materials, and points with names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from mcspectra.core.checks import as_integer
from mcspectra.rendering.backend import load_mitsuba

__all__ = ["Point", "area_light", "diffuse", "named_points", "perspective", "rectangle"]

Point = tuple[float, float, float]

_LARGEST_FILM = 65_536
_Scene = TypeVar("_Scene", bound=Callable[..., dict[str, Any]])


def named_points(**points: Point) -> Callable[[_Scene], _Scene]:
    """Name points of the world that a scene's function makes; `named_pixels` finds their pixels."""

    def keep(scene: _Scene) -> _Scene:
        scene.named_points = points  # type: ignore[attr-defined]
        return scene

    return keep


def perspective(
    origin: Point, target: Point, fov: float, width: int, height: int
) -> dict[str, Any]:
    """Make a camera with +y up, a vertical field of view in degrees, and a film of box pixels.

    Raises
    ------
    ParameterError
        A film without pixels, or of more than 65536 along a side.
    """
    size = {
        name: as_integer(name, value, least=1, most=_LARGEST_FILM)
        for name, value in (("width", width), ("height", height))
    }
    transform = load_mitsuba().ScalarTransform4f()
    view = transform.look_at(origin=list(origin), target=list(target), up=[0.0, 1.0, 0.0])
    film = {"type": "hdrfilm", "filter": {"type": "box"}, **size}
    lens = {"type": "perspective", "fov": fov, "fov_axis": "y"}
    return {**lens, "to_world": view, "film": film}


def rectangle(
    center: Sequence[float], across: Sequence[float], along: Sequence[float]
) -> dict[str, Any]:
    """Make a parallelogram center ± across ± along that faces across × along.

    `across` and `along` are half its sides, normal to each other.
    """
    normal = np.cross(across, along)
    columns = [across, along, normal / np.linalg.norm(normal), center]
    matrix = np.vstack([np.array(columns, dtype=float).T, [0.0, 0.0, 0.0, 1.0]])
    transform = load_mitsuba().ScalarTransform4f(matrix.tolist())
    return {"type": "rectangle", "to_world": transform}


def diffuse(reflectance: float | Sequence[float], *, both_sides: bool = False) -> dict[str, Any]:
    """Make a Lambertian BSDF, gray or of an RGB color; black from behind unless `both_sides`."""
    value = reflectance if isinstance(reflectance, float) else list(reflectance)
    bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}
    return {"type": "twosided", "bsdf": bsdf} if both_sides else bsdf


def area_light(radiance: float | dict[str, Any]) -> dict[str, Any]:
    """Return the BSDF and emitter of a black shape that emits gray or textured radiance."""
    color = {"type": "rgb", "value": radiance} if isinstance(radiance, float) else radiance
    return {"bsdf": diffuse(0.0), "emitter": {"type": "area", "radiance": color}}
