"""Techniques of direct illumination at surface points: light and BSDF sampling, and MIS weights.

Each makes a direction of u in [0,1)² at every point and returns f/p, its own density and that of
the other technique, per solid angle [VeachGuibas1995]_. The points may be one for all samples or
one a sample. Hold `backend.LOCK` around every call.
"""

from __future__ import annotations

from typing import Any, Protocol

from mcspectra.rendering.backend import load_mitsuba

__all__ = [
    "LARGEST_SAMPLE",
    "POWERS",
    "Receiver",
    "Techniques",
    "follow_bsdf",
    "heuristic_weight",
    "look_at_sky",
    "sample_bsdf",
    "sample_light",
]

LARGEST_SAMPLE = 1.0 - 2.0**-24
"""The largest float32 below 1: rounding u up to 1 would leave the square."""

POWERS = {"balance": 1, "power": 2}
"""Heuristics to their exponent β."""

Techniques = tuple[Any, Any, Any]
"""Value f/p, own density, density of the other technique."""


class Receiver(Protocol):
    """Surface points that are lit; `bsdf` is one BSDF, or a pointer for each point."""

    @property
    def scene(self) -> Any:
        """The Mitsuba scene."""

    @property
    def interaction(self) -> Any:
        """The surface interactions."""

    @property
    def bsdf(self) -> Any:
        """The BSDF of each."""


def sample_light(
    hit: Receiver, emitter: Any, u: Any, extra: Any = None, active: Any = True
) -> Techniques:
    """Sample a light.

    Parameters
    ----------
    hit
        Where the light arrives.
    emitter
        The one light that counts; None selects one of all.
    u
        Samples in [0,1)², a `Point2f`.
    extra
        A third number in [0,1), which selects the light; None takes it from the first of u.
    active
        Mask of points; elsewhere the value is 0.
    """
    import drjit

    mitsuba, at = load_mitsuba(), hit.interaction
    sample, weight = _emitter_direction(hit, emitter, u, extra, active)
    towards = at.to_local(sample.d)
    value, bsdf_pdf = hit.bsdf.eval_pdf(mitsuba.BSDFContext(), at, towards, active)
    value *= weight
    useful = active & (sample.pdf > 0.0) & drjit.any(value != 0.0)
    visible = useful & ~hit.scene.ray_test(at.spawn_ray_to(sample.p), useful)
    # BSDF sampling never meets a light that is a delta function: its density there is 0.
    other = drjit.select(sample.delta, 0.0, bsdf_pdf)
    return drjit.select(visible, value, 0.0), sample.pdf, other


def sample_bsdf(
    hit: Receiver, emitter: Any, u: Any, extra: Any = None, active: Any = True
) -> Techniques:
    """Sample the BSDF; parameters as those of `sample_light`, `extra` selects the lobe."""
    value, own, other, _ = follow_bsdf(hit, emitter, u, extra, active)
    return value, own, other


def follow_bsdf(
    hit: Receiver, emitter: Any, u: Any, extra: Any = None, active: Any = True
) -> tuple[Any, Any, Any, Any]:
    """`sample_bsdf` with the direction in the world, a `Vector3f`."""
    import drjit

    mitsuba, at, scene = load_mitsuba(), hit.interaction, hit.scene
    lobe = mitsuba.Float(0.5) if extra is None else extra
    sample, weight = hit.bsdf.sample(mitsuba.BSDFContext(), at, lobe, u, active)
    useful = active & (sample.pdf > 0.0) & drjit.any(weight != 0.0)
    ray = at.spawn_ray(at.to_world(sample.wo))
    # UV: without texture coordinates textured lights come out wrong by 10-15 %.
    met = scene.ray_intersect(ray, mitsuba.RayFlags.UV, False, useful)
    found = met.emitter(scene, useful)
    # A ray that meets no light has a null pointer, whose calls give zero.
    shines = useful if emitter is None else useful & (found == mitsuba.EmitterPtr(emitter))
    value = drjit.select(shines, weight * found.eval(met, shines), 0.0)
    direction = mitsuba.DirectionSample3f(scene, met, at)
    # Light sampling never gives the one direction of a specular lobe: its density there is 0.
    rough = shines & ~mitsuba.has_flag(sample.sampled_type, mitsuba.BSDFFlags.Delta)
    if emitter is None:
        light_pdf = scene.pdf_emitter_direction(at, direction, rough)
    else:
        light_pdf = emitter.pdf_direction(at, direction, rough)
    return value, sample.pdf, drjit.select(rough, light_pdf, 0.0), ray.d


def look_at_sky(hit: Receiver, emitter: Any, direction: Any, active: Any = True) -> tuple[Any, Any]:
    """Evaluate f_r L V cos and the BSDF's density in given directions.

    Parameters
    ----------
    hit, active
        As for `sample_light`.
    emitter
        The environment.
    direction
        Unit vectors in the world, a `Vector3f`.
    """
    import drjit

    mitsuba, at = load_mitsuba(), hit.interaction
    value, pdf = hit.bsdf.eval_pdf(mitsuba.BSDFContext(), at, at.to_local(direction), active)
    useful = active & drjit.any(value != 0.0)
    visible = useful & ~hit.scene.ray_test(at.spawn_ray(direction), useful)
    far = drjit.zeros(mitsuba.SurfaceInteraction3f, drjit.width(direction))
    far.wi = -direction
    return drjit.select(visible, value * emitter.eval(far, visible), 0.0), pdf


def heuristic_weight(own: Any, other: Any, power: int) -> Any:
    """Return own^β / (own^β + other^β), from the ratio: squares overflow float32 for mirrors."""
    import drjit

    ratio = drjit.select(own > 0.0, other / own, 0.0)
    return 1.0 / (1.0 + ratio**power)


def _emitter_direction(
    hit: Receiver, emitter: Any, u: Any, extra: Any, active: Any
) -> tuple[Any, Any]:
    """Sample one light, or select one of all by the first or the extra coordinate."""
    at = hit.interaction
    if emitter is not None:
        return emitter.sample_direction(at, u, active)  # type: ignore[no-any-return]
    if extra is None:
        return hit.scene.sample_emitter_direction(at, u, False, active)  # type: ignore[no-any-return]
    import drjit

    index, reciprocal, _ = hit.scene.sample_emitter(extra, active)
    selected = drjit.gather(load_mitsuba().EmitterPtr, hit.scene.emitters_dr(), index, active)
    sample, weight = selected.sample_direction(at, u, active)
    sample.pdf *= hit.scene.pdf_emitter(index, active)
    return sample, weight * reciprocal
