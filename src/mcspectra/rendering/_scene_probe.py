"""Whether Mitsuba can evaluate the materials and lights of a scene that it has read.

A virtual call of Dr.Jit traces every BSDF that is alive in the process, whatever scene it belongs to:
one whose evaluation fails makes all other scenes fail with it. So each is called once, by
itself, before a scene is used. Calls that are only traced take microseconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from mcspectra.rendering.backend import load_mitsuba

__all__ = ["what_fails"]


def what_fails(scene: Any) -> tuple[str, RuntimeError] | None:
    """Return the first part of a scene that cannot be evaluated, and the error; None if all can.

    Hold `backend.LOCK` around the call.
    """
    for name, part, use in (*_materials(scene), *_lights(scene)):
        try:
            use(part)
        except RuntimeError as error:
            return name, error
    return None


def _materials(scene: Any) -> Iterator[tuple[str, Any, Any]]:
    """Label, BSDF and call of each BSDF, those of several shapes once."""
    seen: list[Any] = []
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        if bsdf is None or any(bsdf is other for other in seen):
            continue
        seen.append(bsdf)
        yield f"the BSDF ({bsdf.class_name()}) of the shape {shape.id()!r}", bsdf, _reflect


def _lights(scene: Any) -> Iterator[tuple[str, Any, Any]]:
    for light in scene.emitters():
        yield f"the light {light.id()!r} ({light.class_name()})", light, _shine


def _reflect(bsdf: Any) -> None:
    mitsuba, at = load_mitsuba(), _point()
    context, u = mitsuba.BSDFContext(), mitsuba.Point2f(0.5)
    bsdf.sample(context, at, mitsuba.Float(0.5), u)
    bsdf.eval_pdf(context, at, mitsuba.Vector3f(0.0, 0.6, 0.8))


def _shine(light: Any) -> None:
    at = _point()
    light.sample_direction(at, load_mitsuba().Point2f(0.5))
    light.eval(at)


def _point() -> Any:
    """A surface point in its own frame."""
    import drjit

    mitsuba = load_mitsuba()
    at = drjit.zeros(mitsuba.SurfaceInteraction3f)
    at.n = at.wi = mitsuba.Normal3f(0.0, 0.0, 1.0)
    at.sh_frame = mitsuba.Frame3f(at.n)
    at.dp_du, at.dp_dv = mitsuba.Vector3f(1.0, 0.0, 0.0), mitsuba.Vector3f(0.0, 1.0, 0.0)
    return at
