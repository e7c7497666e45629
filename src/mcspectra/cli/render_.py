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
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcspectra.cli.common import (
    Answer,
    adder,
    index_or_name,
    real,
    text_table,
    whole,
    wholes,
    writing,
)
from mcspectra.core.errors import ParameterError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["add_arguments", "run"]

_SPP, _COMPARED_SPP, _REFERENCE_SPP = 16, 4, 1024


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    add = adder(parser)
    add("SCENE", "name of a scene, or a Mitsuba XML file")
    add("--strategy STRATEGY", "light, bsdf, mis (default), mis-light or mis-bsdf")
    add("--sampler SPEC", "default 'sobol | owen'", default="sobol | owen")
    add("--spp N", f"samples a pixel (default {_SPP}; reference {_REFERENCE_SPP})", whole())
    add("-m, --realizations R", "independent images (default 1; reference 16)", whole())
    add("--reference", "--spp counts the samples of all images together")
    add("--compare", f"a reference and all strategies, --spp {_COMPARED_SPP} each")
    add("--reference-spp N", "samples of the reference of --compare (default 1024)", whole())
    add("--crop X,Y,W,H", "part of the film, in pixels", wholes("X,Y,W,H", least=0))
    add("--width W", "width of a built-in scene's film", whole())
    add("--height H", "height of a built-in scene's film", whole())
    add("--film FILM", "sampled (default) or center", default="sampled")
    add("--light NAME", "name or number of one light that counts", index_or_name)
    add("--heuristic HEURISTIC", "balance (default) or power", default="balance")
    stops = real(least=-64.0, most=64.0)
    add("--exposure STOPS", "makes a .png brighter (default 0)", stops, default=0.0)
    add("-o, --out FILE", ".exr or .png; may be given twice", repeated="all")


def run(options: argparse.Namespace) -> Answer:
    """Render, write and say how noisy it is."""
    from mcspectra.rendering.files import check_image_path, write_render
    from mcspectra.rendering.image import reference, render

    files = [check_image_path(file) for file in options.out or []]
    settings = {
        "sampler": options.sampler,
        "crop": options.crop,
        "film": options.film,
        "light": options.light,
        "heuristic": options.heuristic,
        "rng": options.seed or 0,
    }
    scene = _sized(options)
    if options.compare:
        return _compare(options, scene, settings, files)
    if options.reference_spp is not None:
        raise ParameterError("--reference-spp is for --compare; with --reference give --spp.")
    settings["strategy"] = options.strategy or "mis"
    start = time.perf_counter()
    if options.reference:
        batches = 16 if options.realizations is None else options.realizations
        if batches < 2:
            raise ParameterError("--realizations is 1; give a whole number of at least 2.")
        result = reference(scene, options.spp or _REFERENCE_SPP, batches=batches, **settings)
    else:
        result = render(
            scene, spp=options.spp or _SPP, realizations=options.realizations or 1, **settings
        )
    figures = _figures(result, time.perf_counter() - start)
    for file in files:
        write_render(file, result, exposure=options.exposure)
    many = figures["realizations"] > 1
    lines = [
        f"{figures['scene']}, {figures['strategy']}, {figures['sampler']}: {figures['width']} × "
        f"{figures['height']} pixels, {figures['spp']} samples each"
        + (f", {figures['realizations']} images" if many else ""),
        f"mean radiance (R G B)  {_colour(figures['mean'])}",
        *([f"rms standard error     {figures['rms_se']:.3g}"] if many else []),
        f"samples a second       {figures['samples_per_second']:.3g}",
        *(f"wrote {file}" for file in files),
    ]
    return Answer("\n".join(lines), {**figures, "files": files})


def _sized(options: argparse.Namespace) -> str:
    """Return the scene with the size of its film among its parameters."""
    given = {"width": options.width, "height": options.height}
    sizes = {name: size for name, size in given.items() if size is not None}
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
    shown = ", ".join(f"{key}={value!r}" for key, value in {**call.arguments, **sizes}.items())
    return f"{call.name}({shown})"


def _figures(result: xr.Dataset, seconds: float) -> dict[str, Any]:
    told = result.attrs
    samples = _samples(told) * result.sizes["x"] * result.sizes["y"]
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
    }


def _samples(told: Mapping[Any, Any]) -> int:
    """Samples of a pixel in all images: multiple importance sampling takes each twice."""
    return int(told["spp"] * told["realizations"] * (2 if told["strategy"] == "mis" else 1))


def _colour(values: Any) -> str:
    return " ".join(f"{value:.5g}" for value in values)


def _compare(
    options: argparse.Namespace, scene: str, settings: Mapping[str, Any], files: list[Path]
) -> Answer:
    """Render a reference and all strategies, write them side by side, say how far each is off."""
    from mcspectra.rendering.files import write_comparison
    from mcspectra.rendering.image import compare_strategies
    from mcspectra.report.encode import encode_exact
    from mcspectra.report.figures.strategy_images import rms_error, strategy_images

    for name in ("strategy", "realizations"):
        if getattr(options, name) is not None:
            raise ParameterError(f"--compare renders all strategies once; leave out --{name}.")
    if options.reference:
        raise ParameterError("--compare renders a reference too; leave out --reference.")
    spp = options.spp or _COMPARED_SPP
    count = options.reference_spp or _REFERENCE_SPP
    images = compare_strategies(scene, spp, reference_spp=count, **settings)
    for file in files:
        if file.suffix.lower() == ".exr":
            write_comparison(file, images)
        else:
            with writing(file):
                file.write_bytes(encode_exact(strategy_images(images, exposure=options.exposure)))
    data, table = {}, []
    for name, image in images.items():
        mean = image["image"].mean(("y", "x")).values
        error = None if name == "reference" else rms_error(image, images["reference"])
        data[name] = {"samples": _samples(image.attrs), "mean": mean, "rms_error": error}
        shown = "" if error is None else f"{error:.3g}"
        table.append([name, _colour(mean), str(data[name]["samples"]), shown])
    header = ["image", "mean radiance (R G B)", "samples a pixel", "rms error"]
    lines = [text_table(header, table), *(f"wrote {file}" for file in files)]
    return Answer("\n".join(lines), {"scene": scene, "spp": spp, "images": data, "files": files})
