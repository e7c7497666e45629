"""Scene files rendered as Mitsuba's own command does, with our samplers known to it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import FileFormatError, McspectraError, ParameterError
from mcspectra.rendering.backend import LOCK, import_mitsuba
from mcspectra.rendering.plugin import register_samplers
from mcspectra.rendering.scenes import mitsuba_reason

__all__ = ["render_file"]

_SEEDS = 2**32
_MOST_SAMPLES = 2**24


def render_file(
    file: str | Path,
    variant: str | None = None,
    *,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    definitions: Mapping[str, object] | None = None,
    out: str | Path | None = None,
) -> Array:
    """Render a scene file by the integrator and the sampler it names, which may be ours.

    Parameters
    ----------
    file
        A Mitsuba XML file; its sampler may be ``<sampler type="mcspectra">``.
    variant
        One of Mitsuba's variants; by default ``llvm_ad_rgb``, or ``scalar_rgb`` without LLVM.
    spp
        Samples a pixel instead of the file's.
    seed
        Seed of the image, an integer from 0 to 2^32 − 1.
    sensor
        Index of the camera.
    definitions
        Values of the file's ``$name``.
    out
        EXR file to write the film to.

    Returns
    -------
    ndarray
        float64, shape (height, width, channels), radiance.

    Raises
    ------
    FileFormatError
        The file is missing, or Mitsuba cannot read or render it; its reason is quoted.
    ParameterError
        A parameter is out of range, or the sampler in the file is not possible.
    MissingDependency
        Mitsuba is missing, or LLVM for the variant.
    """
    options = {"seed": as_integer("seed", seed, least=0, most=_SEEDS - 1)}
    if spp is not None:
        options["spp"] = as_integer("spp", spp, least=1, most=_MOST_SAMPLES)
    target = None if out is None else Path(out).expanduser()
    if target is not None and (target.suffix.lower() != ".exr" or not target.parent.is_dir()):
        raise ParameterError(f"out is {str(out)!r}; give an .exr file in a folder that exists.")
    with LOCK, _variant(variant) as mitsuba, _plain_errors(str(file)):
        path = Path(file).expanduser()
        if not path.is_file():
            raise FileFormatError(f"There is no scene file {str(file)!r}; give a Mitsuba XML file.")
        named = {name: str(value) for name, value in (definitions or {}).items()}
        scene = mitsuba.load_file(str(path), **named)
        if not isinstance(scene, mitsuba.Scene):
            raise FileFormatError(
                f"{str(file)!r} holds no scene; its root element must be <scene>."
            )
        if not (cameras := scene.sensors()):
            raise ParameterError("The scene has no camera; add a <sensor> to it.")
        camera = cameras[as_integer("sensor", sensor, least=0, most=len(cameras) - 1)]
        image = mitsuba.render(scene, sensor=camera, **options)
        if target is not None:
            camera.film().write(str(target))
        return np.array(image, dtype=np.float64)


@contextmanager
def _variant(variant: str | None) -> Iterator[Any]:
    """Set a variant that knows our samplers, and the one before it afterwards."""
    names = register_samplers(variant)
    mitsuba = import_mitsuba()
    before = mitsuba.variant()
    mitsuba.set_variant(names[0])
    try:
        yield mitsuba
    finally:
        if before is not None:
            mitsuba.set_variant(before)


@contextmanager
def _plain_errors(file: str) -> Iterator[None]:
    """Give Mitsuba's errors, or ours that it carries, as one sentence."""
    try:
        yield
    except McspectraError:
        raise
    except (RuntimeError, TypeError) as error:
        cause = error.__cause__
        if isinstance(cause, McspectraError):
            raise cause from None
        raise FileFormatError(f"Mitsuba cannot render {file!r}: {mitsuba_reason(error)}.") from None
