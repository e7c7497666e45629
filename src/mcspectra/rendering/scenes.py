"""Scenes by name, file or dictionary, loaded once a process; their pixels, cameras and lights."""

from __future__ import annotations

import functools
import gc
import math
import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mcspectra.core.checks import as_integer, as_reals
from mcspectra.core.errors import FileFormatError, ParameterError, close_match_hint
from mcspectra.core.registry import Registry
from mcspectra.core.spec import parse
from mcspectra.rendering._scene_files import watched_state
from mcspectra.rendering._scene_probe import what_fails
from mcspectra.rendering.backend import LOCK, VARIANT, load_mitsuba
from mcspectra.rendering.dict_scene import DictScene
from mcspectra.rendering.plugin import register_samplers

__all__ = [
    "SCENES",
    "Scene",
    "as_scene",
    "emitter_name",
    "emitter_names",
    "film_size",
    "find_emitter",
    "load_scene",
    "mitsuba_reason",
    "named_pixels",
    "project",
    "scene_name",
    "sensor_of",
]

Scene = str | Path | DictScene | Mapping[str, Any]
"""What names a scene: a name in `SCENES`, an XML file, a Mitsuba dictionary."""

SCENES = Registry(
    "scene",
    "mcspectra.scenes",
    {
        "figure1": "mcspectra.rendering.builtin.figure1:figure1",
        "penumbra": "mcspectra.rendering.builtin.penumbra:penumbra",
        "sky": "mcspectra.rendering.builtin.sky:sky",
        "smooth-light": "mcspectra.rendering.builtin.figure1:smooth_light",
        "veach": "mcspectra.rendering.builtin.veach:veach",
    },
    functions=True,
)
"""Names to functions that return a scene as a Mitsuba dictionary."""


def as_scene(scene: object) -> str | Path | DictScene:
    """Return a hashable request for a scene: a name, a path, or a dictionary made a `DictScene`.

    Raises
    ------
    ParameterError
        `scene` has another type, or is a dictionary without a scene.
    """
    if isinstance(scene, Path | DictScene):
        return scene
    if isinstance(scene, Mapping):
        return DictScene(scene)
    if not isinstance(scene, str) or not scene.strip():
        raise ParameterError(
            f"scene is {scene!r}; give the name of a scene, an XML file or a Mitsuba dictionary."
        )
    return scene


def scene_name(scene: Scene) -> str:
    """Return the name of a scene in messages, quoted: its name, path, or ``'dict'``."""
    return repr(str(as_scene(scene)))


def load_scene(scene: Scene) -> Any:
    """Return a Mitsuba scene, the same object for the same request.

    Parameters
    ----------
    scene
        A name in `SCENES`, with parameters in brackets if need be (``"veach(width=384)"``), the
        path of a Mitsuba XML file, or a dictionary for `mitsuba.load_dict`. A file is read again if
        it, or a texture, mesh or other file that it refers to, has changed; what it refers to by a
        relative path is looked for beside it.

    Raises
    ------
    UnknownName
        No scene of that name.
    ParameterError
        Not a scene at all, or Mitsuba cannot evaluate a material or a light of it.
    FileFormatError
        The file is missing, or Mitsuba cannot read it or the dictionary; its reason is quoted.
    MissingDependency
        Mitsuba or LLVM is missing.
    """
    request = as_scene(scene)
    with LOCK:
        if isinstance(request, DictScene):
            return _from_dict(request)
        path = _as_file(request)
        if path is None:
            return _from_name(str(request).strip())
        if not path.is_file():
            raise FileFormatError(
                f"There is no scene file {str(scene)!r}; give the path of a Mitsuba XML file "
                f"or one of the names {', '.join(SCENES)}."
            )
        return _from_file(str(path.resolve()), watched_state(path))


def named_pixels(scene: Scene) -> dict[str, tuple[int, int]]:
    """Return the pixels (x, y) to which a built-in scene gives names; none for other scenes.

    A name is left out where the film, by its shape, does not show the point.
    """
    request = as_scene(scene)
    if isinstance(request, DictScene) or _as_file(request) is not None:
        return {}
    points = getattr(SCENES.load(parse(str(request)).name), "named_points", {})
    with LOCK:
        load_scene(request)
        found = {name: _pixel_of(request, point) for name, point in points.items()}
    return {name: pixel for name, pixel in found.items() if pixel is not None}


def sensor_of(scene: Scene) -> Any:
    """Return the first camera of a scene; a scene without one is a ParameterError."""
    sensors = load_scene(scene).sensors()
    if not sensors:
        raise ParameterError(f"The scene {scene_name(scene)} has no camera; add a <sensor> to it.")
    return sensors[0]


def film_size(scene: Scene) -> tuple[int, int]:
    """Return width and height of a scene's film (of its crop window, if it has one), in pixels."""
    width, height = sensor_of(scene).film().crop_size()
    return int(width), int(height)


def project(scene: Scene, point: Sequence[float]) -> tuple[float, float]:
    """Return the film coordinates, in pixels, at which the camera sees a point of the world.

    Pixel (i, j) covers [i, i+1) × [j, j+1), so its number is the floor of the result. Objects
    between the camera and the point are ignored; see `describe_pixel`.

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
            raise ParameterError(
                f"The camera of {scene_name(scene)} does not see the point {target}."
            )
        return float(seen.uv.x[0]), float(seen.uv.y[0])


def find_emitter(scene: Scene, light: int | str) -> Any:
    """Return the emitter of a scene with this index or name (its id, or that of its shape).

    Raises
    ------
    ParameterError
        There is no such light; the message lists all lights.
    """
    emitters, names = load_scene(scene).emitters(), emitter_names(scene)
    if isinstance(light, str):
        if light in names:
            return emitters[names.index(light)]
        hint, _ = close_match_hint(light, names)
        raise ParameterError(f"The scene {scene_name(scene)} has no light {light!r}.{hint}")
    if not emitters:
        raise ParameterError(f"The scene {scene_name(scene)} has no lights; add an emitter to it.")
    try:
        return emitters[as_integer("light", light, least=0, most=len(emitters) - 1)]
    except ParameterError as error:
        raise ParameterError(f"{error} The lights are {', '.join(names)}.") from None


def emitter_name(emitter: Any, scene: Any = None) -> str:
    """Return the id of the shape that an emitter sits on, else its own.

    One without an id is called ``emitter-K``, K its number among those of `scene`, a Mitsuba scene;
    by its class if there is no `scene`.
    """
    shape = emitter.get_shape()
    name = str(shape.id() if shape is not None else emitter.id())
    if name or scene is None:
        return name or str(emitter.class_name())
    return next(f"emitter-{k}" for k, e in enumerate(scene.emitters()) if e == emitter)


def emitter_names(scene: Scene) -> list[str]:
    """Return the names of all lights of a scene, in their order."""
    loaded = load_scene(scene)
    return [emitter_name(emitter, loaded) for emitter in loaded.emitters()]


def _pixel_of(scene: Scene, point: Sequence[float]) -> tuple[int, int] | None:
    try:
        x, y = project(scene, point)
    except ParameterError:
        return None
    return math.floor(x), math.floor(y)


@functools.lru_cache(maxsize=8)
def _from_name(scene: str) -> Any:
    return _built(scene, load_mitsuba().load_dict, SCENES.build(parse(scene)))


@functools.lru_cache(maxsize=8)
def _from_file(path: str, _state: Hashable) -> Any:
    return _built(path, load_mitsuba().load_file, path)


@functools.lru_cache(maxsize=8)
def _from_dict(scene: DictScene) -> Any:
    return _built("dict", load_mitsuba().load_dict, scene.contents)


def _built(name: str, load: Callable[..., Any], source: object) -> Any:
    register_samplers(VARIANT)  # the scene may name one of ours
    try:
        # Unoptimised: merging would rename shapes and shuffle their order.
        scene = load(source, optimize=False)
    except (RuntimeError, TypeError) as error:
        raise FileFormatError(
            f"Mitsuba cannot read the scene {name!r}: {mitsuba_reason(error)}."
        ) from None
    if not isinstance(scene, load_mitsuba().Scene):
        raise FileFormatError(f"{name!r} holds no scene; its root element must be <scene>.")
    found = what_fails(scene)
    if found is None:
        return scene
    part, reason = found[0], mitsuba_reason(found[1])
    # Its materials are traced with those of every other scene as long as they live.
    del scene, found
    gc.collect()
    raise ParameterError(
        f"Mitsuba cannot evaluate {part} in the scene {name!r}: {reason}; change its parameters "
        "or textures."
    )


def mitsuba_reason(error: Exception) -> str:
    """Return Mitsuba's words on one line, without the places in its own source code.

    Of an error in a plugin written in Python that is the last line, after the error's name.
    """
    text = str(error).strip()
    if "Traceback" in text:
        text = text.splitlines()[-1].partition(": ")[2]
    return " ".join(re.sub(r"\[\w+\.(?:cpp|h):\d+\]\s*", "", text).split()).rstrip(".")


def _as_file(request: str | Path) -> Path | None:
    """Return the path that a request means, None if it means a name."""
    if isinstance(request, Path):
        return request.expanduser()
    looks = request.lower().endswith(".xml")
    looks = looks or (("/" in request or "\\" in request) and "(" not in request)
    return Path(request).expanduser() if looks else None
