"""Checks for unsupported parts of a scene: media, delta lights and BSDFs, lenses, broken maps."""

from __future__ import annotations

from typing import Any

from mcspectra.core.errors import IncompleteImageWarning, ParameterError, warn
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.scenes import (
    Scene,
    emitter_name,
    find_emitter,
    load_scene,
    scene_name,
    sensor_of,
)
from mcspectra.rendering.skies import rotation_of

__all__ = [
    "camera_rays",
    "check_environment",
    "check_lights",
    "check_media",
    "check_scene",
    "delta_bsdf",
    "delta_light",
    "filter_note",
    "integrator_note",
    "warn_integrator",
    "warn_lens",
    "warn_missed",
]


def check_scene(scene: Scene, *, light: int | str | None = None) -> list[str]:
    """List the parts of a scene that prevent a measurement of direct illumination.

    Parameters
    ----------
    scene
        A scene: a name, a file or a dictionary, as in `load_scene`.
    light
        The only light to use; by default all lights. The unused lights may be of any type.

    Returns
    -------
    list of str
        A sentence for each unsupported part; empty if everything is supported.
        A scene must have a light, and a camera without lens and shutter.
        A scene must not have participating media, or an integrator that computes indirect light.
        Lights must not be delta functions (point, spot, directional, …).
        An environment must not be scaled, and its pixels must be radiances.
        Shapes must not have a BSDF with a delta function (dielectric, smooth conductor, mask, …).
        Shapes inside instances are not listed; a pixel that shows such a shape reports it.

    Raises
    ------
    ParameterError
        If no light has this name or index.
    UnknownName, FileFormatError, MissingDependency
        If the scene cannot be loaded.

    Notes
    -----
    A shape with a delta BSDF excludes only the pixels that show it.
    """
    with LOCK:
        loaded = load_scene(scene)
        camera = f"The scene {scene_name(scene)} has no camera; add a <sensor>."
        return [
            *([] if loaded.sensors() else [camera]),
            *_lens(scene, loaded),
            *_media(scene, loaded),
            *_integrator(scene, loaded),
            *_lights(scene, light),
            *_environment(scene, light),
            *(delta_bsdf(s.bsdf(), s.id()) for s in loaded.shapes() if _specular(s)),
        ]


def check_media(scene: Scene) -> None:
    """Raise a ParameterError if a scene has participating media; the message names the shapes."""
    with LOCK:
        _raise_first(_media(scene, load_scene(scene)))


def check_lights(scene: Scene, light: int | str | None = None) -> None:
    """Raise a ParameterError unless the used lights can be sampled and reach surfaces.

    There must be at least one light, no delta function among them, and no participating media.
    An environment must not be scaled, and its pixels must be radiances.
    """
    check_media(scene)
    with LOCK:
        _raise_first(_lights(scene, light))
    check_environment(scene, light)


def check_environment(scene: Scene, light: int | str | None = None) -> None:
    """Raise a ParameterError if the environment is used, and is scaled or has invalid pixels.

    Mitsuba does not report the scale of an environment, and its light sampling ignores the scale.
    """
    with LOCK:
        _raise_first(_environment(scene, light))


def warn_lens(scene: Scene) -> None:
    """Warn that the camera has a lens or a shutter, over which rays are not sampled."""
    with LOCK:
        sentences = _lens(scene, load_scene(scene))
    for sentence in sentences:
        warn(sentence, IncompleteImageWarning)


def integrator_note(scene: Scene) -> str:
    """Return a note if results do not use the integrator of the scene, otherwise an empty text."""
    with LOCK:
        return "".join(_integrator(scene, load_scene(scene)))


def filter_note(scene: Scene) -> str:
    """Return a note if images and paths use different pixel filters; empty for a box filter."""
    with LOCK:
        rfilter = sensor_of(scene).film().rfilter()
        if rfilter.is_box_filter():
            return ""
    return (
        f"The film of {scene_name(scene)} has a {rfilter.class_name()}, which averages over "
        "neighboring pixels; a map measures the paths through each pixel's square, which is a box "
        "filter."
    )


def warn_integrator(scene: Scene) -> None:
    """Warn if results do not use the integrator of the scene."""
    if note := integrator_note(scene):
        warn(note, IncompleteImageWarning)


def camera_rays(scene: Scene) -> str:
    """Describe where camera rays start. For a lens or a shutter, only the central ray is used."""
    with LOCK:
        sensor = load_scene(scene).sensors()[0]
        lens, shutter = _aperture(sensor) > 0.0, sensor.shutter_open_time() > 0.0
    parts = ["center of the lens"] * lens + ["middle of the shutter's time"] * shutter
    return ", ".join(parts) or "pinhole"


def warn_missed(scene: Scene, strategy: str, light: int | str | None = None) -> None:
    """Warn of light that a single strategy leaves out of an image.

    BSDF sampling never hits a light that is a delta function.
    Light sampling gives 0 for a BSDF that is a delta function.
    """
    with LOCK:
        if strategy == "bsdf":
            loaded = load_scene(scene)
            lights = [emitter_name(e, loaded) for e in _chosen(scene, light) if delta_light(e)]
            missed = [f"the light {name!r}" for name in lights]
        elif strategy == "light":
            shapes = [s for s in load_scene(scene).shapes() if _specular(s)]
            missed = [f"specular reflection by {_called('shape', s.id())}" for s in shapes]
        else:
            return
    if missed:
        other = "light" if strategy == "bsdf" else "bsdf"
        more = f" and {len(missed) - 1} more" if len(missed) > 1 else ""
        warn(
            f"The strategy {strategy!r} leaves out {missed[0]}{more} of {scene_name(scene)}, a "
            f"delta function; choose 'mis' or {other!r}.",
            IncompleteImageWarning,
        )


def delta_light(emitter: Any) -> bool:
    """Whether an emitter shines only from one point or only in one direction."""
    return bool(int(emitter.flags()) & int(load_mitsuba().EmitterFlags.Delta))


def delta_bsdf(bsdf: Any, shape: str) -> str:
    """Return a sentence if the BSDF of `shape` has a delta function, otherwise an empty text."""
    if not int(bsdf.flags()) & int(load_mitsuba().BSDFFlags.Delta):
        return ""
    return (
        f"The BSDF of {_called('shape', shape)} ({bsdf.class_name()}) has a perfectly specular "
        "part, a delta function; choose a rough or diffuse one."
    )


def _raise_first(sentences: list[str]) -> None:
    if sentences:
        raise ParameterError(sentences[0])


def _lens(scene: Scene, loaded: Any) -> list[str]:
    """Return a sentence if the first camera has a lens, and a sentence if it has a shutter.

    The sentences say that neither the lens nor the time of the open shutter is sampled.
    """
    sensors = loaded.sensors()[:1]
    found = {
        f"a lens (of radius {radius:.3g})": radius > 0.0 for radius in map(_aperture, sensors)
    } | {"a shutter (open for a while)": any(s.shutter_open_time() > 0.0 for s in sensors)}
    return [
        f"The camera of {scene_name(scene)} has {what}, which is not sampled: every ray starts at "
        "the center of the lens, halfway through the time that the shutter is open."
        for what, there in found.items()
        if there
    ]


def _aperture(sensor: Any) -> float:
    """Radius of a camera's lens, or 0 for a pinhole."""
    if not sensor.needs_aperture_sample():
        return 0.0
    parameters = load_mitsuba().traverse(sensor)
    if "aperture_radius" not in parameters:
        return 0.0
    radius = parameters["aperture_radius"]
    return float(radius if isinstance(radius, float) else radius[0])


def _media(scene: Scene, loaded: Any) -> list[str]:
    filled = (s for s in loaded.shapes() if s.interior_medium() or s.exterior_medium())
    holders = [_called("shape", s.id()) for s in filled]
    holders += [_called("camera", s.id()) for s in loaded.sensors() if s.get_medium()]
    where = f"The scene {scene_name(scene)} has participating media ({', '.join(holders)})"
    advice = "give an integrator for whole paths, or remove them"
    return [f"{where}, which direct light ignores; {advice}."] if holders else []


def _integrator(scene: Scene, loaded: Any) -> list[str]:
    found = loaded.integrator()
    if found is None or found.class_name() == "DirectIntegrator":
        return []
    note = (
        f"The integrator of {scene_name(scene)} ({found.class_name()}) is not used: this measures "
        "direct light alone; pixel and map measure whole paths with integrator='scene' "
        "(--integrator scene)."
    )
    return [note]


def _lights(scene: Scene, light: int | str | None) -> list[str]:
    chosen = _chosen(scene, light)
    if not chosen:
        return [f"The scene {scene_name(scene)} has no lights; add an emitter to it."]
    loaded = load_scene(scene)
    return [
        f"The light {emitter_name(e, loaded)!r} of {scene_name(scene)} ({e.class_name()}) is a "
        "delta function, which BSDF sampling never hits; replace it, or choose another with "
        "light=."
        for e in chosen
        if delta_light(e)
    ]


def _chosen(scene: Scene, light: int | str | None) -> list[Any]:
    """Return the lights that are used."""
    if light is None:
        return list(load_scene(scene).emitters())
    return [find_emitter(scene, light)]


def _environment(scene: Scene, light: int | str | None) -> list[str]:
    """Return a sentence for each environment that is scaled, or whose pixels are not a radiance."""
    found, chosen = [], _chosen(scene, light)
    import drjit

    for emitter in chosen:
        parameters = load_mitsuba().traverse(emitter) if emitter.is_environment() else {}
        if "to_world" in parameters:  # constant environments have no rotation and may be scaled
            try:
                rotation_of(emitter)
            except ParameterError as error:
                found.append(str(error))
        if "data" in parameters:
            values = parameters["data"].array
            if not drjit.all(drjit.isfinite(values) & (values >= 0.0)):
                found.append(
                    f"The map of the environment {emitter_name(emitter)!r} has pixels that are "
                    "NaN, infinite or negative; replace them."
                )
    return found


def _specular(shape: Any) -> bool:
    return bool(shape.bsdf() and delta_bsdf(shape.bsdf(), shape.id()))


def _called(kind: str, name: str) -> str:
    return f"the {kind} {name!r}" if name else f"a {kind} without id"
