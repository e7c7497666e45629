"""Render a scene file as the command `mitsuba` does, with our samplers known to it.

The file's sampler may be <sampler type="mcspectra"> with <string name="spec" value="sobol | owen"/>;
its integrator is any of Mitsuba's. Writes an EXR file, by default beside the scene.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from mcspectra.cli.common import Answer, adder, whole
from mcspectra.core.errors import ParameterError

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options, which are named like those of Mitsuba's command."""
    add = adder(parser)
    variants = "e.g. llvm_ad_rgb (default, if there is LLVM for it) or scalar_rgb"
    add("scene", "Mitsuba XML file")
    add("-m, --mode VARIANT", variants, repeated="once")
    add("-o, --out FILE", "EXR file; by default beside the scene")
    add("--spp N", "samples a pixel; by default the file's", whole())
    add("-s, --sensor I", "index of the camera", whole(0), default=0)
    again = "value of $KEY in the file; may be given several times"
    add("-D, --define KEY=VALUE", again, _definition, repeated="all")


def run(options: argparse.Namespace) -> Answer:
    """Render, write and say where the image is."""
    from mcspectra.rendering.stock import render_file

    out = Path(options.out) if options.out else Path(options.scene).with_suffix(".exr")
    start = time.perf_counter()
    image = render_file(
        options.scene,
        options.mode,
        spp=options.spp,
        seed=options.seed or 0,
        sensor=options.sensor,
        definitions=dict(options.define or []),
        out=out,
    )
    height, width, channels = image.shape
    means = [float(value) for value in image.mean(axis=(0, 1))]
    seconds = time.perf_counter() - start
    return Answer(
        f"{out}: {width} × {height} pixels, {channels} channels, {seconds:.1f} s",
        {"image": out, "width": width, "height": height, "mean": means},
    )


def _definition(name: str, text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise ParameterError(f"{name} is {text!r}; give KEY=VALUE.")
    return key, value
