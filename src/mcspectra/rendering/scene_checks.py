"""What of a scene cannot be analysed: participating media, delta lights, delta BSDFs."""

from __future__ import annotations

from typing import Any

from mcspectra.core.errors import ParameterError
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.scenes import Scene, emitter_name, find_emitter, load_scene, scene_name

__all__ = [
    "check_lights",
    "check_media",
    "check_scene",
    "delta_bsdf",
    "delta_light",
]


def check_scene(scene: Scene, *, light: int | str | None = None) -> list[str]:
    """List all in a scene that direct illumination by sampled directions cannot deal with.

    Parameters
    ----------
    scene
        A scene as of `load_scene`.
    light
        The one light that will count; by default all will. The others may then be anything.

    Returns
    -------
    list of str
        A sentence for each: no camera, no lights, participating media, lights that are delta
        functions (point, spot, directional, …), shapes whose BSDF has a delta function (dielectric,
        smooth conductor, mask, …). Empty if everything is supported. Shapes inside instances do
        not show; a pixel that sees one says so itself.

    Raises
    ------
    ParameterError
        There is no such light.
    UnknownName, FileFormatError, MissingDependency
        The scene cannot be loaded.

    Notes
    -----
    A shape with a delta BSDF only excludes the pixels that see it.
    """
    with LOCK:
        loaded = load_scene(scene)
        return [
            *_without_camera(scene, loaded),
            *_media(scene, loaded),
            *_lights(scene, light),
            *filter(None, (delta_bsdf(s.bsdf(), s.id()) for s in loaded.shapes() if s.bsdf())),
        ]


def check_media(scene: Scene) -> None:
    """Raise a ParameterError if a scene has participating media; the message says which shapes."""
    with LOCK:
        _raise_first(_media(scene, load_scene(scene)))


def check_lights(scene: Scene, light: int | str | None = None) -> None:
    """Raise a ParameterError unless the lights that count can be sampled and reach surfaces.

    There must be at least one, none a delta function, and no participating media on the way.
    """
    check_media(scene)
    with LOCK:
        _raise_first(_lights(scene, light))


def delta_light(emitter: Any) -> bool:
    """Whether an emitter shines from a point or in one direction only."""
    return bool(int(emitter.flags()) & int(load_mitsuba().EmitterFlags.Delta))


def delta_bsdf(bsdf: Any, shape: str) -> str:
    """Say that the BSDF of `shape` has a delta function; empty if it has none."""
    if not int(bsdf.flags()) & int(load_mitsuba().BSDFFlags.Delta):
        return ""
    return (
        f"The BSDF of {_called('shape', shape)} ({bsdf.class_name()}) has a perfectly specular "
        "part, a delta function; choose a rough or diffuse one."
    )


def _raise_first(sentences: list[str]) -> None:
    if sentences:
        raise ParameterError(sentences[0])


def _without_camera(scene: Scene, loaded: Any) -> list[str]:
    return (
        []
        if loaded.sensors()
        else [f"The scene {scene_name(scene)} has no camera; add a <sensor>."]
    )


def _media(scene: Scene, loaded: Any) -> list[str]:
    holders = [_called("shape", s.id()) for s in loaded.shapes() if _has_medium(s)]
    holders += [_called("camera", s.id()) for s in loaded.sensors() if s.get_medium()]
    where = f"The scene {scene_name(scene)} has participating media ({', '.join(holders)})"
    return [f"{where}, which are not supported; take them out."] if holders else []


def _has_medium(shape: Any) -> bool:
    return shape.interior_medium() is not None or shape.exterior_medium() is not None


def _lights(scene: Scene, light: int | str | None) -> list[str]:
    chosen = load_scene(scene).emitters() if light is None else [find_emitter(scene, light)]
    if not chosen:
        return [f"The scene {scene_name(scene)} has no lights; add an emitter to it."]
    return [
        f"The light {emitter_name(e)!r} of {scene_name(scene)} ({e.class_name()}) is a delta function, "
        "which BSDF sampling never meets; replace it, or choose another with light=."
        for e in chosen
        if delta_light(e)
    ]


def _called(kind: str, name: str) -> str:
    return f"the {kind} {name!r}" if name else f"a {kind} without id"
