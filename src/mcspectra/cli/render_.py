"""Render a scene's direct illumination by one of our samplers.

SCENE is the name of a built-in scene, e.g. 'veach' or "veach(lights=['light-3'])", or a Mitsuba XML
file. Prints the mean radiance, the root mean square of the pixels' standard errors where there are
several images (-m) or a --reference, and samples a second, with the time that kernels take to
compile. An .exr holds image, variance and standard error, a .png the image in sRGB.

--compare renders a reference, light, BSDF and multiple importance sampling at equal samples: a .png
shows them side by side, an .exr holds a layer of each, and their distance to the reference is printed.
"""

from __future__ import annotations

import argparse
import math
import time
from typing import TYPE_CHECKING, Any

from mcspectra.cli.common import (
    index_or_name,
    one_sentence_warnings,
    print_json,
    seed_option,
    whole_number,
)
from mcspectra.cli.progress import progress_bars
from mcspectra.core.errors import ParameterError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["add_arguments", "run"]

_SPP, _REFERENCE_SPP = 16, 1024


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    parser.add_argument("scene", metavar="SCENE", help="name of a scene, or a Mitsuba XML file")
    parser.add_argument("--strategy", help="light, bsdf, mis (default), mis-light or mis-bsdf")
    parser.add_argument(
        "--sampler", default="sobol | owen", metavar="SPEC", help="default 'sobol | owen'"
    )
    parser.add_argument(
        "--spp", metavar="N", help=f"samples a pixel (default {_SPP}; reference {_REFERENCE_SPP})"
    )
    parser.add_argument(
        "-m", "--realizations", metavar="R", help="independent images (default 1; reference 16)"
    )
    parser.add_argument(
        "--reference", action="store_true", help="--spp counts the samples of all images together"
    )
    parser.add_argument(
        "--compare", action="store_true", help="a reference and all strategies, --spp 4 each"
    )
    parser.add_argument(
        "--reference-spp", metavar="N", help="samples of the reference of --compare (default 1024)"
    )
    parser.add_argument("--crop", metavar="X,Y,W,H", help="part of the film, in pixels")
    parser.add_argument("--width", metavar="W", help="width of a built-in scene's film")
    parser.add_argument("--height", metavar="H", help="height of a built-in scene's film")
    parser.add_argument("--film", default="sampled", help="sampled (default) or center")
    parser.add_argument("--light", metavar="NAME", help="name or number of one light that counts")
    parser.add_argument("--heuristic", default="balance", help="balance (default) or power")
    parser.add_argument(
        "--exposure", default="0", metavar="STOPS", help="makes a .png brighter (default 0)"
    )
    parser.add_argument(
        "-o", "--out", action="append", metavar="FILE", help=".exr or .png; may be given twice"
    )


def run(options: argparse.Namespace) -> int:
    """Render, write and say how noisy it is."""
    from mcspectra.rendering.files import check_image_path, write_render

    exposure = _exposure(options.exposure)
    files = [check_image_path(file) for file in options.out or []]
    if options.compare:
        from mcspectra.cli.render_compare import run_comparison

        return run_comparison(options, _sized(options), _settings(options), files, exposure)
    if options.reference_spp is not None:
        raise ParameterError("--reference-spp is for --compare; with --reference give --spp.")
    with one_sentence_warnings(options.quiet), progress_bars(options.quiet):
        start = time.perf_counter()
        result = _render(options)
        seconds = time.perf_counter() - start
    for file in files:
        write_render(file, result, exposure=exposure)
    figures = _figures(result, seconds, list(map(str, files)))
    if options.json:
        print_json(figures)
    elif not options.quiet:
        _print(figures)
    return 0


def _render(options: argparse.Namespace) -> xr.Dataset:
    from mcspectra.rendering.image import reference, render

    default = _REFERENCE_SPP if options.reference else _SPP
    spp = default if options.spp is None else whole_number("--spp", options.spp)
    settings = {
        "strategy": "mis" if options.strategy is None else options.strategy,
        **_settings(options),
    }
    scene, images = _sized(options), options.realizations
    if options.reference:
        batches = 16 if images is None else whole_number("--realizations", images, least=2)
        return reference(scene, spp, batches=batches, **settings)
    count = 1 if images is None else whole_number("--realizations", images)
    return render(scene, spp=spp, realizations=count, **settings)


def _settings(options: argparse.Namespace) -> dict[str, Any]:
    """Arguments that all ways to render share."""
    return {
        "sampler": options.sampler,
        "crop": None if options.crop is None else _crop(options.crop),
        "film": options.film,
        "light": index_or_name(options.light),
        "heuristic": options.heuristic,
        "rng": seed_option(options),
    }


def _sized(options: argparse.Namespace) -> str:
    """Return the scene with the size of its film among its parameters."""
    sizes = {
        name: whole_number(f"--{name}", text)
        for name, text in (("width", options.width), ("height", options.height))
        if text is not None
    }
    scene = str(options.scene)
    if not sizes:
        return scene
    from mcspectra.core.spec import parse
    from mcspectra.rendering.scenes import SCENES

    if scene.lower().endswith(".xml"):
        raise ParameterError(
            f"--width and --height are for built-in scenes ({', '.join(SCENES)}); "
            f"the film of {scene!r} is set in the file."
        )
    call = parse(scene)
    given = ", ".join(f"{key}={value!r}" for key, value in {**call.arguments, **sizes}.items())
    return f"{call.name}({given})"


def _crop(text: str) -> list[int]:
    parts = text.split(",")
    if len(parts) != 4:
        raise ParameterError(f"--crop is {text!r}; give X,Y,W,H, four whole numbers.")
    return [whole_number("--crop", part.strip(), least=0) for part in parts]


def _exposure(text: str) -> float:
    from mcspectra.core.checks import as_real

    try:
        stops = float(text)
    except ValueError:
        raise ParameterError(f"--exposure is {text!r}; give a number of stops.") from None
    return as_real("--exposure", stops, least=-64.0, most=64.0)


def _figures(result: xr.Dataset, seconds: float, files: list[str]) -> dict[str, Any]:
    told = result.attrs
    techniques = 2 if told["strategy"] == "mis" else 1
    pixels = result.sizes["x"] * result.sizes["y"]
    samples = pixels * told["spp"] * told["realizations"] * techniques
    kept = ("scene", "strategy", "sampler", "spp", "realizations", "seed")
    errors = result.get("image_se")
    return {
        **{name: told[name] for name in kept},
        "width": result.sizes["x"],
        "height": result.sizes["y"],
        "mean": result["image"].mean(("y", "x")).values,
        "rms_se": None if errors is None else math.sqrt(float((errors**2).mean())),
        "samples": samples,
        "samples_per_second": samples / seconds,
        "files": files,
    }


def _print(figures: dict[str, Any]) -> None:
    many = figures["realizations"] > 1
    print(
        f"{figures['scene']}, {figures['strategy']}, {figures['sampler']}: {figures['width']} × "
        f"{figures['height']} pixels, {figures['spp']} samples each"
        + (f", {figures['realizations']} images" if many else "")
    )
    mean = " ".join(f"{value:.5g}" for value in figures["mean"])
    print(f"mean radiance (R G B)  {mean}")
    if many:
        print(f"rms standard error     {figures['rms_se']:.3g}")
    print(f"samples a second       {figures['samples_per_second']:.3g}")
    for file in figures["files"]:
        print(f"wrote {file}")
