"""Scenes by name or by file, loaded once a process, and what is needed to find a pixel in them."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mcspectra.core.checks import as_choice, as_integer, as_reals
from mcspectra.core.errors import FileFormatError, ParameterError, close_match_hint
from mcspectra.core.registry import Registry
from mcspectra.core.spec import parse
from mcspectra.rendering.backend import LOCK, load_mitsuba

__all__ = [
    "SCENES",
    "emitter_name",
    "film_size",
    "find_emitter",
    "load_scene",
    "project",
    "sensor_of",
    "veach",
]

SCENES = Registry(
    "scene",
    "mcspectra.scenes",
    {"veach": "mcspectra.rendering.scenes:veach"},
    functions=True,
)
"""Names to functions that return a scene as a Mitsuba dictionary."""

_SPHERES: dict[str, tuple[tuple[float, float, float], float, float]] = {
    # name: center, radius, radiance
    "light-0": ((-3.75, 0.0, 0.0), 0.03333, 901.803),
    "light-1": ((-1.25, 0.0, 0.0), 0.1, 100.0),
    "light-2": ((1.25, 0.0, 0.0), 0.3, 11.1111),
    "light-3": ((3.75, 0.0, 0.0), 0.9, 1.23457),
    "fill-light": ((10.0, 10.0, 4.0), 0.5, 800.0),
}
_PLATES: tuple[tuple[tuple[float, float], tuple[float, float], float], ...] = (
    # (y, z) of the lower edge at the front, (y, z) of the edge at the back, GGX roughness
    ((-2.70651, 0.25609), (-2.08375, -0.526323), 0.005),
    ((-3.28825, 1.36972), (-2.83856, 0.476536), 0.02),
    ((-3.73096, 2.70046), (-3.43378, 1.74564), 0.05),
    ((-3.99615, 4.0667), (-3.82069, 3.08221), 0.1),
)
_FLOOR_Y, _WALL_Z = -4.14615, -2.0
_HALF_WIDTH, _FRONT_Z, _WALL_TOP = 12.0, 15.0, 12.0  # ours: larger than what the camera sees
_GRAY = 0.4  # ours too: reflectance of floor and wall


def veach(
    *, lights: Sequence[str] | None = None, width: int = 768, height: int = 512
) -> dict[str, Any]:
    """Four glossy plates under four spheres of equal power, from Veach's thesis.

    Parameters
    ----------
    lights
        Which lights to keep: names among light-0 (smallest) … light-3 (widest) and fill-light.
        All by default.
    width, height
        Film size in pixels. The plates fill a 3:2 frame; a square one crops them.

    Returns
    -------
    dict
        The scene for `mitsuba.load_dict`. Shapes: plate-0 (smoothest) … plate-3, floor, wall.

    Raises
    ------
    ParameterError
        An unknown light, none at all, or a film without pixels.

    Notes
    -----
    Positions, radii, radiances, roughness and camera as in [Veach1997]_ and the scene files that
    several renderers publish. The plates are copper, floor and wall are gray: our choice.
    """
    kept = _check_lights(tuple(_SPHERES) if lights is None else lights)
    scene: dict[str, Any] = {"type": "scene", "sensor": _camera(width, height)}
    scene |= {name: _sphere_light(*_SPHERES[name]) for name in _SPHERES if name in kept}
    scene |= {f"plate-{i}": _plate(*plate) for i, plate in enumerate(_PLATES)}
    floor = _rectangle((0, _FLOOR_Y, (_FRONT_Z + _WALL_Z) / 2), _FRONT_Z - _WALL_Z, (0, 0, -1))
    wall = _rectangle((0, (_WALL_TOP + _FLOOR_Y) / 2, _WALL_Z), _WALL_TOP - _FLOOR_Y, (0, 1, 0))
    gray = {"type": "diffuse", "reflectance": _GRAY}
    return scene | {"floor": {**floor, "bsdf": gray}, "wall": {**wall, "bsdf": gray}}


def load_scene(scene: str | Path) -> Any:
    """Return a Mitsuba scene, the same object for the same request.

    Parameters
    ----------
    scene
        A name in `SCENES`, with parameters in brackets if need be (``"veach(width=384)"``), or the
        path of a Mitsuba XML file. A file that has changed is read again.

    Raises
    ------
    UnknownName
        No scene of that name.
    FileFormatError
        The file is missing, or Mitsuba cannot read it.
    MissingDependency
        Mitsuba or LLVM is missing.
    """
    path = _as_file(scene)
    with LOCK:
        if path is None:
            return _from_name(str(scene).strip())
        if not path.is_file():
            raise FileFormatError(
                f"There is no scene file {str(scene)!r}; give the path of a Mitsuba XML file "
                f"or one of the names {', '.join(SCENES)}."
            )
        return _from_file(str(path.resolve()), path.stat().st_mtime_ns)


def sensor_of(scene: str | Path) -> Any:
    """Return the first camera of a scene; a scene without one is a ParameterError."""
    sensors = load_scene(scene).sensors()
    if not sensors:
        raise ParameterError(f"The scene {str(scene)!r} has no camera; add a <sensor> to it.")
    return sensors[0]


def film_size(scene: str | Path) -> tuple[int, int]:
    """Return width and height of a scene's film (of its crop window, if it has one), in pixels."""
    width, height = sensor_of(scene).film().crop_size()
    return int(width), int(height)


def project(scene: str | Path, point: Sequence[float]) -> tuple[float, float]:
    """Return the film coordinates, in pixels, at which the camera sees a point of the world.

    Pixel (i, j) covers [i, i+1) × [j, j+1), so its number is the floor of the result. What stands
    between the camera and the point is not asked; see `describe_pixel`.

    Raises
    ------
    ParameterError
        The point is not three finite numbers, or lies outside the camera's view.
    """
    if not isinstance(point, Sequence | np.ndarray):
        raise ParameterError(f"point is {point!r}; give three numbers, x, y and z.")
    target = as_reals("point", point, 3)
    with LOCK:
        mitsuba, sensor = load_mitsuba(), sensor_of(scene)
        interaction = mitsuba.Interaction3f()
        interaction.p = mitsuba.Point3f(*target)
        seen, _ = sensor.sample_direction(interaction, mitsuba.Point2f(0.5))
        if not float(seen.pdf[0]) > 0.0:
            raise ParameterError(f"The camera of {str(scene)!r} does not see the point {target}.")
        return float(seen.uv.x[0]), float(seen.uv.y[0])


def find_emitter(scene: str | Path, light: int | str) -> Any:
    """Return the emitter of a scene with this index or name (its id, or that of its shape).

    Raises
    ------
    ParameterError
        There is no such light; the message lists those there are.
    """
    emitters = load_scene(scene).emitters()
    names = [emitter_name(emitter) for emitter in emitters]
    if isinstance(light, str):
        if light in names:
            return emitters[names.index(light)]
        hint, _ = close_match_hint(light, names)
        raise ParameterError(f"The scene {str(scene)!r} has no light {light!r}.{hint}")
    if not emitters:
        raise ParameterError(f"The scene {str(scene)!r} has no lights; add an emitter to it.")
    try:
        return emitters[as_integer("light", light, least=0, most=len(emitters) - 1)]
    except ParameterError as error:
        raise ParameterError(f"{error} The lights are {', '.join(names)}.") from None


def emitter_name(emitter: Any) -> str:
    """Return the id of the shape that an emitter sits on, else its own."""
    shape = emitter.get_shape()
    return str(shape.id() if shape is not None else emitter.id())


@functools.lru_cache(maxsize=8)
def _from_name(scene: str) -> Any:
    return _built(scene, load_mitsuba().load_dict, SCENES.build(parse(scene)))


@functools.lru_cache(maxsize=8)
def _from_file(path: str, _modified: int) -> Any:
    return _built(path, load_mitsuba().load_file, path)


def _built(name: str, load: Callable[..., Any], source: object) -> Any:
    try:
        # Unoptimised: merging would rename shapes and shuffle their order.
        scene = load(source, optimize=False)
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise FileFormatError(f"Mitsuba cannot read the scene {name!r}: {reason}") from None
    if not isinstance(scene, load_mitsuba().Scene):
        raise FileFormatError(f"{name!r} holds no scene; its root element must be <scene>.")
    return scene


def _as_file(scene: object) -> Path | None:
    """Return the path that a request means, None if it means a name."""
    if isinstance(scene, Path):
        return scene.expanduser()
    if not isinstance(scene, str) or not scene.strip():
        raise ParameterError(f"scene is {scene!r}; give the name of a scene or an XML file.")
    looks = scene.lower().endswith(".xml") or (("/" in scene or "\\" in scene) and "(" not in scene)
    return Path(scene).expanduser() if looks else None


def _check_lights(lights: object) -> tuple[str, ...]:
    allowed = tuple(_SPHERES)
    given = (lights,) if isinstance(lights, str) else lights
    if not isinstance(given, Sequence | set) or not given:
        raise ParameterError(f"lights is {lights!r}; give one or more of {', '.join(allowed)}.")
    return tuple(as_choice("a light", name, allowed) for name in given)


def _camera(width: int, height: int) -> dict[str, Any]:
    size = {"width": as_integer("width", width, least=1, most=65_536)}
    size |= {"height": as_integer("height", height, least=1, most=65_536)}
    view = (
        load_mitsuba()
        .ScalarTransform4f()
        .look_at(origin=[0.0, 2.0, 15.0], target=[0.0, -2.0, 2.5], up=[0.0, 1.0, 0.0])
    )
    film = {"type": "hdrfilm", "filter": {"type": "box"}, **size}
    lens = {"type": "perspective", "fov": 28.0, "fov_axis": "y"}
    return {**lens, "to_world": view, "film": film}


def _sphere_light(
    center: tuple[float, float, float], radius: float, radiance: float
) -> dict[str, Any]:
    black = {"type": "diffuse", "reflectance": 0.0}
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    return {
        "type": "sphere",
        "center": list(center),
        "radius": radius,
        "bsdf": black,
        "emitter": emitter,
    }


def _plate(front: tuple[float, float], back: tuple[float, float], alpha: float) -> dict[str, Any]:
    edge = np.array(back) - np.array(front)
    middle = (np.array(back) + np.array(front)) / 2
    length = float(np.hypot(*edge))
    along = (0.0, float(edge[0] / length), float(edge[1] / length))
    shape = _rectangle((0.0, float(middle[0]), float(middle[1])), length, along, half_width=4.0)
    copper = {"type": "roughconductor", "distribution": "ggx", "material": "Cu", "alpha": alpha}
    return {**shape, "bsdf": copper}


def _rectangle(
    center: tuple[float, float, float],
    length: float,
    along: tuple[float, float, float],
    half_width: float = _HALF_WIDTH,
) -> dict[str, Any]:
    """Make a rectangle, its width along x, its length along a unit vector normal to x."""
    across = np.array([1.0, 0.0, 0.0])
    normal = np.cross(across, along)
    columns = [half_width * across, length / 2 * np.array(along), normal, np.array(center)]
    matrix = np.vstack([np.array(columns).T, [0.0, 0.0, 0.0, 1.0]])
    transform = load_mitsuba().ScalarTransform4f(matrix.tolist())
    return {"type": "rectangle", "to_world": transform}
