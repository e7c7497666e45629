"""Render a scene file as the command `mitsuba` does, with our samplers known to it.

The file's sampler may be <sampler type="mcspectra"> with <string name="spec" value="sobol | owen"/>;
its integrator is any of Mitsuba's. Writes an EXR file, by default beside the scene.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from mcspectra.cli.common import (
    Once,
    one_sentence_warnings,
    print_json,
    seed_option,
    whole_number,
)
from mcspectra.core.errors import ParameterError

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options, which are named like those of Mitsuba's command."""
    parser.add_argument("scene", help="Mitsuba XML file")
    parser.add_argument(
        "-m",
        "--mode",
        metavar="VARIANT",
        action=Once,
        help="e.g. llvm_ad_rgb (default, if there is LLVM for it) or scalar_rgb",
    )
    parser.add_argument("-o", "--out", metavar="FILE", help="EXR file; by default beside the scene")
    parser.add_argument("--spp", metavar="N", help="samples a pixel; by default the file's")
    parser.add_argument("-s", "--sensor", default=0, metavar="I", help="index of the camera")
    parser.add_argument(
        "-D",
        "--define",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="value of $KEY in the file; may be given several times",
    )


def run(options: argparse.Namespace) -> int:
    """Render, write and say where the image is."""
    from mcspectra.rendering.stock import render_file

    out = Path(options.out) if options.out else Path(options.scene).with_suffix(".exr")
    start = time.perf_counter()
    with one_sentence_warnings(options.quiet or options.json):
        image = render_file(
            options.scene,
            options.mode,
            spp=None if options.spp is None else whole_number("--spp", options.spp),
            seed=seed_option(options),
            sensor=whole_number("--sensor", options.sensor, least=0),
            definitions=dict(_definition(text) for text in options.define),
            out=out,
        )
    height, width, channels = image.shape
    means = [float(value) for value in image.mean(axis=(0, 1))]
    if options.json:
        print_json({"image": str(out), "width": width, "height": height, "mean": means})
    elif not options.quiet:
        seconds = time.perf_counter() - start
        print(f"{out}: {width} × {height} pixels, {channels} channels, {seconds:.1f} s")
    return 0


def _definition(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise ParameterError(f"--define is {text!r}; give KEY=VALUE.")
    return key, value
