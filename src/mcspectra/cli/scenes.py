"""The verbs of scenes: an image, a pixel, a map of all pixels, and frames of any renderer."""

from __future__ import annotations

import argparse
import math
import shutil
import textwrap
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcspectra.cli.common import (
    VerbOutput,
    folder_name,
    given_of,
    group,
    index_or_name,
    joint_dims,
    option,
    out,
    page_table,
    read_sampler,
    real,
    text_table,
    verb,
    whole,
    wholes,
)
from mcspectra.cli.texts import remedies_table
from mcspectra.core.checks import TARGET_LIMITS
from mcspectra.core.display import counted, printable, shown
from mcspectra.core.errors import Parameter, ParameterError, writing
from mcspectra.core.images import ENCODED_EXTENSIONS, LINEAR_EXTENSIONS
from mcspectra.core.registry import optional_package

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["frames_", "map_", "pixel_", "render_"]

_WIDTH = 100  # width of wrapped sentences in columns
_AROUND = 8  # side, in pixels, of the square of pixels for which samplers are compared
_SPP, _COMPARED_SPP, _REFERENCE_SPP = 16, 4, 1024
_PAGE_BYTES = 1_000_000  # bytes of the page and the pictures of a map
# Number of figures and bytes of the page of a pixel, for direct light and for whole paths.
# A figure takes about as long to draw as a map of 128 × 128 pixels
_PIXEL_PAGES, _PIXEL_SIDE = {"direct": (5, 600_000), "paths": (2, 300_000)}, 128
_PIXEL_BYTES = 12  # bytes of three float32 numbers of a pixel of an image
_DRY_RUN = option("--dry-run", "only print the size, the time and the storage, from a short run")


_DIRECT = (
    "strategy",
    "realizations",
    "reference",
    "compare",
    "reference_spp",
    "crop",
    "film",
    "light",
    "heuristic",
)
_WHOLE = ("variant", "joint_dims", "sensor", "define", "spp_map")


@verb(
    option("SCENE", "name of a scene, or a Mitsuba XML file"),
    option(
        "--integrator SPEC",
        "render whole paths with an integrator of Mitsuba, e.g. 'path(max_depth=5)', or scene "
        "for the scene's own (default: direct light)",
    ),
    option(
        "--sampler SPEC",
        "sampler of all pixels (default 'sobol | owen'; with --integrator the scene's own)",
    ),
    option(
        "--spp N",
        f"samples per pixel (default {_SPP}; with --reference {_REFERENCE_SPP}; with --integrator "
        "the scene's)",
        whole(),
    ),
    option("--width W", "width of a built-in scene's film", whole()),
    option("--height H", "height of a built-in scene's film", whole()),
    option(
        "--exposure STOPS",
        "brightness of a .png in stops, which are factors of two (default 0)",
        real(least=-64.0, most=64.0),
        default=0.0,
    ),
    out(".exr: linear radiance; .png: the image in sRGB"),
    _DRY_RUN,
    group(
        lambda parser: parser.add_argument_group("direct light"),
        option("--strategy STRATEGY", "light, bsdf, mis (default), mis-light or mis-bsdf"),
        option("-m, --realizations R", "independent images (default 1; reference 16)", whole()),
        option(
            "--reference",
            "render a reference from independent images; --spp is then the sum of their samples",
        ),
        option(
            "--compare",
            "render a reference and all strategies with --spp samples each (default "
            f"{_COMPARED_SPP})",
        ),
        option(
            "--reference-spp N", "samples of the reference of --compare (default 1024)", whole()
        ),
        option("--crop X,Y,W,H", "part of the film, in pixels", wholes("X,Y,W,H", least=0)),
        option("--film FILM", "position of samples in a pixel: sampled (default) or center"),
        option("--light NAME", "use only the light of this name or number", index_or_name),
        option("--heuristic HEURISTIC", "heuristic of MIS: balance (default) or power"),
    ),
    group(
        lambda parser: parser.add_argument_group("with --integrator"),
        option(
            "--variant VARIANT",
            "variant of Mitsuba, e.g. scalar_rgb (default llvm_ad_rgb; without LLVM scalar_rgb)",
        ),
        option(
            "--joint-dims K",
            "with --sampler: first numbers of a path that are joint; each later request has its "
            "own points (padded) (default 4 for randomized nets, else 0)",
            joint_dims,
        ),
        option(
            "--spp-map FILE",
            "samples of each pixel, an image of whole numbers, as written by mcspectra map "
            "--target E -o FILE.exr; rounded up to powers of two",
        ),
        option("--sensor I", "index of the camera (default 0)", whole(0)),
        option("-D, --define KEY=VALUE", "value of $KEY in the file; repeatable", repeated="all"),
    ),
)
def render_(options: argparse.Namespace) -> VerbOutput:
    """Render a scene with a sampler of this package.

    SCENE is the name of a built-in scene, e.g. 'veach' or "veach(lights=['light-3'])",
    or a Mitsuba XML file, which is never changed.

    Without --integrator the image is direct light by one strategy.
    The verb prints the mean radiance and the samples per second.
    The samples per second include the time to compile kernels.
    With several images (-m) or a --reference, the verb also prints a standard error:
    the root mean square of the standard errors of all pixels.
    --compare renders a reference, and one image for each strategy with equal samples:
    light sampling, BSDF sampling, and multiple importance sampling.
    A .png shows the images of --compare side by side, and an .exr has one layer for each image.
    The verb prints the error of each image.

    With --integrator Mitsuba renders whole paths, and --sampler replaces the scene's own sampler.
    With --spp-map each pixel has its own number of samples, by default of
    'larcher-pillichshammer | digital-shift(jitter=True)'.
    Our samplers are padded: each request of the integrator has its own points.
    With randomized nets, the first 4 numbers of a path come from one point set (--joint-dims).
    A scene file can also name a sampler of this package:
    <sampler type="mcspectra"> with <string name="spec" value="sobol | owen"/>.
    Without a spec, it is the default of --spp-map for powers of two, else 'sobol | owen'.
    """
    from mcspectra.rendering.files import check_image_path, write_render
    from mcspectra.rendering.image import reference, render
    from mcspectra.rendering.scenes import SCENES, sized

    whole_paths = options.integrator is not None
    for name in _DIRECT if whole_paths else _WHOLE:
        if getattr(options, name) not in (None, False):
            flag, way = f"--{name.replace('_', '-')}", "leave it out with --integrator"
            text = (
                f"for direct light; {way}" if whole_paths else "for whole paths; give --integrator"
            )
            raise ParameterError(f"{flag} is {text}.")
    files = [check_image_path(file) for file in options.out]
    settings = {
        "sampler": options.sampler or "sobol | owen",
        "crop": options.crop,
        "film": options.film or "sampled",
        "light": options.light,
        "heuristic": options.heuristic or "balance",
        "rng": options.seed or 0,
    }

    # Add the size of the film to the parameters of the scene
    scene = str(options.scene)
    sizes = given_of(options, "width", "height")
    if sizes:
        if scene.lower().endswith(".xml"):
            raise ParameterError(
                f"--width and --height are for built-in scenes ({', '.join(SCENES)}); "
                f"the film of {shown(scene)} is set in the file."
            )
        scene = sized(scene, **sizes)
    if options.dry_run:
        return _render_cost(options, scene, settings)
    if whole_paths:
        return _whole_paths(options, scene, files)
    if options.compare:
        return _compare(options, scene, settings, files)

    # Render the image, and measure the time
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
    seconds = time.perf_counter() - start
    for file in files:
        write_render(file, result, exposure=options.exposure)

    # Report the noise
    told, errors = result.attrs, result.get("image_se")
    width, height = result.sizes["x"], result.sizes["y"]
    samples = _samples(told) * width * height
    kept = ("scene", "strategy", "sampler", "spp", "realizations", "seed")
    data = {
        **{name: told[name] for name in kept},
        "width": width,
        "height": height,
        "mean": result["image"].mean(("y", "x")).values,
        "rms_se": None if errors is None else math.sqrt(float((errors**2).mean())),
        "samples": samples,
        "samples_per_second": samples / seconds,
        "files": files,
    }
    many = told["realizations"] > 1
    lines = [
        f"{told['scene']}, {told['strategy']}, {told['sampler']}: {width} × {height} pixels, "
        f"{told['spp']} samples each" + (f", {told['realizations']} images" if many else ""),
        f"mean radiance (R G B)  {_colour(data['mean'])}",
        *([f"rms standard error     {data['rms_se']:.3g}"] if many else []),
        f"samples per second     {data['samples_per_second']:.3g}",
        *(f"wrote {file}" for file in files),
    ]
    return VerbOutput("\n".join(lines), data)


def _render_cost(
    options: argparse.Namespace, scene: str, settings: Mapping[str, Any]
) -> VerbOutput:
    """Estimate the size, time and storage of an image from images with few samples."""
    from mcspectra.core.images import read_image
    from mcspectra.rendering.costs import SceneCost, timed_work
    from mcspectra.rendering.image import render
    from mcspectra.rendering.plugin import default_spec
    from mcspectra.rendering.scenes import as_scene, film_size, render_file, sensor_of

    request = as_scene(scene)
    size = film_size(request)
    whole, spp = options.integrator is not None, options.spp
    own = None if options.integrator == "scene" else options.integrator
    if options.spp_map is not None:
        spp = max(round(float(read_image(options.spp_map, linear=True).mean())), 1)
    if whole:
        spp = spp or int(sensor_of(request).sampler().sample_count())
        images, each = 1, 1
    else:
        each = 1 if options.strategy not in (None, "mis") else 2
        images = 1 if options.reference else options.realizations or 1
        spp = spp or (_REFERENCE_SPP if options.reference else _SPP)
        if options.compare:
            # The reference and MIS use samples of both techniques; other images use one technique
            spp, each = 2 * (options.reference_spp or _REFERENCE_SPP) + 4 * (options.spp or 4), 1
        size = size if options.crop is None else (options.crop[2], options.crop[3])
    loaded = time.perf_counter() - options.begun  # the time for imports is included

    def work(count: int) -> None:
        if whole:
            keys: dict[str, Any] = given_of(options, "sampler", "joint_dims", "sensor")
            render_file(scene, options.variant, integrator=own, spp=count, **keys)
        else:
            strategy = options.strategy or "mis"
            render(scene, spp=count, strategy=strategy, **settings)

    paced = timed_work(work, spp * images, first=4, most=max(4, min(spp, 1024)))
    pixels = size[0] * size[1]
    sampler = options.sampler or ("the scene's sampler" if whole else "sobol | owen")
    if options.spp_map is not None:
        sampler = options.sampler or default_spec(joint_dims=options.joint_dims)
    found = SceneCost(
        scene=scene,
        what=f"{spp} samples of each with {sampler}" + (f", {images} images" if images > 1 else ""),
        size=size,
        pixels=pixels,
        samples=pixels * spp * images * each,
        samples_per_second=pixels * each / paced.each,
        seconds=loaded + paced.seconds,
        storage=_PIXEL_BYTES * pixels * len(options.out),
    )
    return VerbOutput(found.text, found.to_dict())


def _samples(told: Mapping[Any, Any]) -> int:
    """Return the number of samples per pixel in all images together; MIS counts both techniques."""
    return int(told["spp"] * told["realizations"] * (2 if told["strategy"] == "mis" else 1))


def _colour(values: Any) -> str:
    return " ".join(f"{value:.5g}" for value in values)


def _compare(
    options: argparse.Namespace, scene: str, settings: Mapping[str, Any], files: list[Path]
) -> VerbOutput:
    """Render a reference and all strategies. Write these images, and print their errors."""
    from mcspectra.plots.backend_matplotlib import draw, encode
    from mcspectra.plots.maps import rms_error, strategy_images
    from mcspectra.rendering.files import write_comparison
    from mcspectra.rendering.image import compare_strategies

    for name in ("strategy", "realizations"):
        if getattr(options, name) is not None:
            raise ParameterError(f"--compare renders all strategies once; leave out --{name}.")
    if options.reference:
        raise ParameterError("--compare also renders a reference; leave out --reference.")

    # Render and write the images
    spp = options.spp or _COMPARED_SPP
    count = options.reference_spp or _REFERENCE_SPP
    images = compare_strategies(scene, spp, reference_spp=count, **settings)
    for file in files:
        if file.suffix.lower() == ".exr":
            write_comparison(file, images)
        else:
            with writing(file):
                plot = strategy_images(images, exposure=options.exposure)
                file.write_bytes(encode(draw(plot), with_pdf=False)[0])

    # Report the error of each image
    data, table = {}, []
    for name, image in images.items():
        mean = image["image"].mean(("y", "x")).values
        error = None if name == "reference" else rms_error(image, images["reference"])
        data[name] = {"samples": _samples(image.attrs), "mean": mean, "rms_error": error}
        shown = "" if error is None else f"{error:.3g}"
        table.append([name, _colour(mean), str(data[name]["samples"]), shown])
    header = ["image", "mean radiance (R G B)", "samples per pixel", "rms error"]
    lines = [text_table(header, table), *(f"wrote {file}" for file in files)]
    return VerbOutput(
        "\n".join(lines), {"scene": scene, "spp": spp, "images": data, "files": files}
    )


def _whole_paths(options: argparse.Namespace, scene: str, files: list[Path]) -> VerbOutput:
    """Render a scene with one of Mitsuba's integrators, and write the image."""
    from mcspectra.rendering.files import write_png
    from mcspectra.rendering.scenes import render_file

    definitions = {}
    for text in options.define or []:
        key, equals, value = text.partition("=")
        if not (key and equals):
            raise ParameterError(f"--define is {shown(text)}; give KEY=VALUE.")
        definitions[key] = value
    films = [file for file in files if file.suffix.lower() == ".exr"]
    if options.spp_map is not None:
        return _by_map(options, scene, files)
    start = time.perf_counter()
    image = render_file(
        scene,
        options.variant,
        integrator=None if options.integrator == "scene" else options.integrator,
        sampler=options.sampler,
        joint_dims=options.joint_dims,
        spp=options.spp,
        seed=options.seed or 0,
        sensor=options.sensor or 0,
        definitions=definitions,
        out=next(iter(films), None),
    )
    seconds = time.perf_counter() - start
    for file in files:
        if file in films[1:]:
            with writing(file):
                shutil.copyfile(films[0], file)
        elif file not in films:
            write_png(file, image[..., :3], exposure=options.exposure)
    height, width, channels = image.shape
    means = image.mean(axis=(0, 1))
    sampler = options.sampler or "scene's own"
    whose = "scene's own" if options.integrator == "scene" else options.integrator
    size = f"{width} × {height} pixels, {counted(channels, 'channel')}"
    lines = [
        f"{scene}, integrator: {whose}, sampler: {sampler}: {size}, {seconds:.1f} s",
        f"mean radiance  {_colour(means)}",
        *(f"wrote {file}" for file in files),
    ]
    data = {
        "scene": scene,
        "integrator": options.integrator,
        "sampler": options.sampler,
        "width": width,
        "height": height,
        "mean": means,
        "seconds": seconds,
        "files": files,
    }
    return VerbOutput("\n".join(lines), data)


def _by_map(options: argparse.Namespace, scene: str, files: list[Path]) -> VerbOutput:
    """Render a scene with the samples per pixel of a file."""
    from mcspectra.core.images import read_image
    from mcspectra.rendering.adaptive import render_adaptive
    from mcspectra.rendering.files import write_exr, write_png
    from mcspectra.rendering.plugin import default_spec

    for name in ("spp", "variant", "sensor", "define"):
        if getattr(options, name) is not None:
            raise ParameterError(f"--{name} does not go with --spp-map; leave it out.")
    spp = read_image(options.spp_map, linear=True)
    start = time.perf_counter()
    try:
        image = render_adaptive(
            scene,
            spp,
            integrator=None if options.integrator == "scene" else options.integrator,
            sampler=options.sampler,
            joint_dims=options.joint_dims,
            seed=options.seed or 0,
        )
    except ParameterError as error:
        if Parameter("spp") not in error.args:
            raise
        # The numbers come from the file, and --spp is another option
        told = (part for part in error.args if part != Parameter("spp"))
        raise ParameterError(f"--spp-map {shown(str(options.spp_map))}", *told) from None
    seconds = time.perf_counter() - start
    for file in files:
        if file.suffix.lower() == ".exr":
            write_exr(file, {"": image}, comment=f"samples per pixel: {options.spp_map}")
        else:
            write_png(file, image, exposure=options.exposure)
    height, width, _ = image.shape
    sampler = options.sampler or default_spec(joint_dims=options.joint_dims)
    mean = image.mean(axis=(0, 1))
    size = f"{width} × {height} pixels, {seconds:.1f} s"
    ends = f"{spp.min():.0f} to {spp.max():.0f}, mean {spp.mean():.1f}"
    lines = [
        f"{scene}, integrator: {options.integrator}, sampler: {sampler}: {size}",
        f"samples per pixel by {options.spp_map}: {ends}, rounded up to powers of two",
        f"mean radiance  {_colour(mean)}",
        *(f"wrote {file}" for file in files),
    ]
    data = {
        "scene": scene,
        "integrator": options.integrator,
        "sampler": sampler,
        "width": width,
        "height": height,
        "spp": {"least": spp.min(), "most": spp.max(), "mean": spp.mean()},
        "mean": mean,
        "seconds": seconds,
        "files": files,
    }
    return VerbOutput("\n".join(lines), data)


@verb(
    option("SCENE", "scene, e.g. veach, or a Mitsuba XML file"),
    option("X", "column of the pixel, or the name of a pixel"),
    option("Y", "row of the pixel", whole(0), nargs="?"),
    option(
        "--integrator SPEC",
        "measure whole paths of this integrator, e.g. 'path(max_depth=5)', or scene for the "
        "scene's own (default: direct light)",
    ),
    option(
        "--light NAME", "use only the light of this name or number (default: all)", index_or_name
    ),
    option("--channel CHANNEL", "luminance (default), 0, 1 or 2", index_or_name),
    option(
        "-d, --dims D",
        "2, or 3 with a third coordinate that selects lobes; with --integrator: number of "
        "coordinates that use the sampler's points",
        whole(),
    ),
    option(
        "--sampler SPEC",
        "sampler to compare; repeatable (default random, jittered, 'jittered | shift' and 'sobol "
        "| owen'). The first sampler that is not random gets terms, bottleneck and remedies",
        repeated="all",
        dest="samplers",
    ),
    option("-n, --counts N,N,…", "numbers of samples of each technique", wholes()),
    option("-m, --realizations R", "number of estimates at each n", whole(4)),
    option(
        "--budget B",
        "evaluations per estimate at which remedies are compared (default twice the largest n)",
        whole(),
    ),
    option(
        "--joint-dims K",
        "with --integrator: first numbers of a path that are joint; each later request of the "
        "integrator has its own points (padded), as in rendered images (default 4 for scrambled "
        "nets, else 0)",
        joint_dims,
    ),
    option(
        "--target E",
        "with --integrator: also compare samplers as they are rendered at the pixels around this "
        "one, and print the samples per pixel for this relative error, as mcspectra profile does",
        real(**TARGET_LIMITS),
    ),
    option("--no-remedies", "do not search for remedies"),
    group(
        lambda parser: parser.add_mutually_exclusive_group(),
        option("--quick", "about a minute (default)"),
        option("--full", "several minutes: larger counts, more realizations, all remedies"),
    ),
    option("-o, --out DIR", "folder for report.html, pixel.json and figures", repeated="once"),
    _DRY_RUN,
)
def pixel_(options: argparse.Namespace) -> VerbOutput:
    """Measure and explain the noise of one pixel of a scene: rates, terms, bottleneck, remedies.

    The pixel is X Y, counted from the left and from the top, or its name (figure1 has P and Q).

    Without --integrator, direct light is measured. With --integrator, whole paths are measured.
    The results for paths are rates of samplers, and the variance by bounce, decision and light.
    The results for paths include the number of coordinates in which good points help.
    """
    x: int | str = options.x
    if options.y is not None:
        x = whole(0)("X", options.x)
    elif options.x.lstrip("-").isdecimal():
        raise ParameterError(f"The pixel has a column, {x}, but no row; give X and Y.")

    if options.out is not None:
        from mcspectra.report.page import check_page_packages

        check_page_packages("render,report")

    # Pass only options that the user gave, because the function has defaults for all others
    passed = ("light", "channel", "dims", "samplers", "counts", "realizations", "budget")
    asked = {
        "remedies": not options.no_remedies,
        "effort": "full" if options.full else "quick",
        "rng": options.seed or 0,
        **given_of(options, *passed),
    }
    if options.integrator is None:
        for name in ("joint_dims", "target"):
            if getattr(options, name) is not None:
                flag = f"--{name.replace('_', '-')}"
                raise ParameterError(f"{flag} is for whole paths; give --integrator.")
        from mcspectra.report import pixel_page
        from mcspectra.report.page import columns_of
        from mcspectra.report.tables import summary_table, terms_table
        from mcspectra.studies.pixel import analyse_pixel, plan_pixel

        if options.dry_run:
            imports = time.perf_counter() - options.begun
            planned = plan_pixel(options.scene, x, options.y, **asked).later(imports)
            return _pixel_cost(options, x, planned)

        # Describe the pixel; show the rates of its strategies and the terms of the variance
        tree = analyse_pixel(options.scene, x, options.y, **asked)
        head = [f"pixel ({tree.attrs['x']}, {tree.attrs['y']}) of {tree.attrs['scene']}"]
        head += [f"  {name}: {text}" for name, text in pixel_page.about_pixel(tree)]
        rates = summary_table(pixel_page.pixel_rows(tree))
        rates = columns_of(rates, rates.columns[:5])
        terms = terms_table(pixel_page.term_rows(tree))
        lead = textwrap.fill(pixel_page.pixel_answer(tree), _WIDTH)
        parts = ["\n".join(head), lead, page_table(pixel_page.answer_table(tree))]
        parts += [page_table(rates, "Strategy"), page_table(terms, "Strategy; basis")]
        data, said = pixel_page.pixel_summary(tree), pixel_page.pixel_sentences(tree)
        write: Any = pixel_page.write_pixel
    else:
        from mcspectra.report import path_page
        from mcspectra.studies.path import analyse_path, plan_path

        refused = [f"--{name}" for name in ("light", "budget") if name in asked]
        if refused:
            raise ParameterError(
                f"{refused[0]} is for direct light; leave it out with --integrator."
            )
        asked |= given_of(options, "joint_dims")
        if options.dry_run:
            imports = time.perf_counter() - options.begun
            planned = plan_path(options.scene, x, options.y, integrator=options.integrator, **asked)
            return _pixel_cost(options, x, planned.later(imports))
        tree = analyse_path(options.scene, x, options.y, integrator=options.integrator, **asked)
        known, answer = tree.attrs, textwrap.fill(path_page.path_answer(tree), _WIDTH)
        title = (
            f"pixel ({known['x']}, {known['y']}) of {known['scene']}, integrator "
            f"{known['integrator']}: {known['dims']} random numbers per path"
        )
        parts = [f"{title}\n{answer}"]
        parts += map(page_table, path_page.path_tables(tree).values())
        data, said = path_page.path_summary(tree), path_page.path_sentences(tree)
        write = path_page.write_path
    written = None if options.out is None else write(tree, options.out)

    # Print the changes that were tried, the findings in sentences, and the name of a written page
    def filled(named: list[tuple[str, str]]) -> list[str]:
        return [textwrap.fill(f"{k}: {v}", _WIDTH, subsequent_indent="  ") for k, v in named]

    if "remedies" in tree.children:
        found = tree["remedies"].to_dataset()
        pilots = [
            (name, pilot + costs)
            for name, reason in zip(found["remedy"].values, found["reason"].values, strict=True)
            for _, pilot, costs in [str(reason).partition("Its pilot")]
            if pilot
        ]
        parts.append("\n".join([remedies_table(found), *filled(pilots)]))
    parts.append("\n".join(filled(said)))
    if options.target is not None:
        from mcspectra.profiler.scene_profile import profile_scene

        # Compare samplers at pixels around this pixel
        crop = _around(options.scene, tree.attrs["x"], tree.attrs["y"])
        advice = profile_scene(options.scene, **_as_rendered(options, crop))
        differs = textwrap.fill(
            f"The next comparison differs: it renders the {crop[2]} × {crop[3]} pixels around this "
            "one with the scene's filter and integrator, and changes only the sampler.",
            _WIDTH,
        )
        parts.insert(1, f"{differs}\n{advice.text}")
        data["profile"] = advice.to_dict()
    if written is not None:
        data["report"] = written
        parts.append(f"report: {printable(written)}")
    return VerbOutput("\n\n".join(parts), data)


def _pixel_cost(options: argparse.Namespace, x: int | str, planned: Any) -> VerbOutput:
    """Add the page, and the comparison of samplers as they are rendered, to an estimate."""
    from dataclasses import replace

    if options.out is not None:
        from mcspectra.report.map_page import page_seconds

        figures, size = _PIXEL_PAGES["direct" if options.integrator is None else "paths"]
        page = page_seconds(figures, (_PIXEL_SIDE, _PIXEL_SIDE))
        planned = replace(planned.later(page), storage=size)
    if options.target is not None:
        from mcspectra.profiler.scene_profile import plan_scene
        from mcspectra.studies.pixel import find_pixel

        crop = _around(options.scene, *find_pixel(options.scene, x, options.y))
        planned = planned.then(plan_scene(options.scene, **_as_rendered(options, crop)))
    return VerbOutput(planned.text, planned.to_dict())


def _around(scene: str, x: int, y: int) -> tuple[int, int, int, int]:
    """Return the square of pixels around a pixel, for which samplers are compared: x, y, w, h."""
    from mcspectra.rendering.scenes import film_size

    sizes = film_size(scene)
    side = min(_AROUND, *sizes)
    left, top = (
        min(max(int(k) - side // 2, 0), size - side) for k, size in zip((x, y), sizes, strict=True)
    )
    return left, top, side, side


def _folder_or_exr(name: str, text: str) -> str:
    """Read the name of a folder, or the name of a file with the extension .exr."""
    return text if Path(text).suffix.lower() == ".exr" else folder_name(name, text)


def _map_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the map analysis, which is imported only if needed."""
    from mcspectra.cli.analysis import declared
    from mcspectra.core.options import options_of
    from mcspectra.rendering.maps import Map

    for each in options_of(Map):
        if each.name != "scene":
            declared(each)(parser)


@verb(
    option("SCENE", "scene, e.g. veach, or a Mitsuba XML file"),
    option(
        "-o, --out PATH",
        "output folder (default out/map); with --target also a file .exr, which gets samples per "
        "pixel for mcspectra render --spp-map; repeatable",
        _folder_or_exr,
        repeated="all",
        default=[],
    ),
    option("--resume", "continue the map in the output folder"),
    option(
        "--sampler SPEC",
        "sampler (default jittered; with --integrator 'larcher-pillichshammer | "
        "digital-shift(jitter=True)' for powers of two, else 'sobol | owen'); several are compared "
        "at each pixel; repeatable",
        repeated="all",
    ),
    option("--workers N", "threads (default: all processors)", whole()),
    option(
        "--target E",
        "with --integrator: also compare samplers as they are rendered, and print the samples per "
        "pixel for this relative error, as mcspectra profile does",
        real(**TARGET_LIMITS),
    ),
    _DRY_RUN,
    _map_options,
)
def map_(options: argparse.Namespace) -> VerbOutput:
    """Map the variance, its rate and the bottleneck over an image of a scene.

    Without --integrator the map compares strategies for direct light.
    With --integrator the map measures whole paths and the shares of bounces and decisions.
    Writes DIR/report.html, DIR/maps.exr (all layers), DIR/map.json and pictures.
    DIR/study.sqlite keeps finished tiles, so that --resume can continue.

    With --pixels 1%, a random pixel of each stratum is measured; other pixels are interpolated.
    With --target and -o FILE.exr, the map also writes samples per pixel for the target error.
    """
    from mcspectra.core.analysis import Subject
    from mcspectra.core.options import checked, options_of
    from mcspectra.core.trust import process_trust
    from mcspectra.plots.groups import labelled
    from mcspectra.rendering.files import check_image_path
    from mcspectra.rendering.maps import Map, compared
    from mcspectra.report.map_page import map_summary, map_table, subset_note, write_map
    from mcspectra.report.page import check_page_packages
    from mcspectra.studies import StudyConfig, open_results, run_study
    from mcspectra.studies.files import SceneConfig
    from mcspectra.studies.ledger import LEDGER_NAME

    # Reject invalid options before the folder is created
    check_page_packages("render,report")
    if options.target is not None and (options.integrator is None or options.size is not None):
        raise ParameterError(
            "--target is for whole paths at the scene's own size; give --integrator and no --size."
        )
    files = [Path(each) for each in options.out if each.lower().endswith(".exr")]
    folders = [each for each in options.out if Path(each) not in files]
    if len(folders) > 1:
        raise ParameterError(f"--out names {len(folders)} folders; give one, and files .exr.")
    if files and options.target is None:
        raise ParameterError(
            f"{shown(str(files[0]))} would hold samples per pixel for an error; give --target."
        )
    files = [check_image_path(file, (".exr",)) for file in files]
    folder = folders[0] if folders else "out/map"
    if options.resume and not (Path(folder) / LEDGER_NAME).is_file():
        raise ParameterError(
            f"--resume finds no map in the folder {shown(str(folder))}; leave it out to begin a "
            "map, or name the folder of a map with --out."
        )
    analysis = checked(Map(**given_of(options, *(each.name for each in options_of(Map)))))
    samplers = options.sampler or [analysis.default_sampler]
    subjects = [Subject(None, read_sampler(each, analysis.points_dims)) for each in samplers]
    parts = analysis.of_samplers(subjects)
    if options.dry_run:
        return _map_cost(options, parts, subjects)

    # Run a study with one map per sampler, and write its results
    entries = tuple(
        SceneConfig(name=f"map-{k}" if k else "map", samplers=(each,), kind="map", analysis=part)
        for k, (each, part) in enumerate(zip(samplers, parts, strict=True))
    )
    study = StudyConfig(title=f"Map of {options.scene}", seed=options.seed or 0, scenes=entries)
    # The user gave the scene on the command line, so its files may be in any folder
    trust = process_trust().widened(folders=(Path(Path.cwd().anchor),))
    run_study(study, folder, resume=options.resume, workers=options.workers, trust=trust)
    tree = open_results(folder)
    found = [node.to_dataset() for node in tree.subtree if node.name == "map" and node.data_vars]
    maps = [labelled(each).assign_coords(bound=["low", "high"]) for each in found]
    result = maps[0] if len(maps) == 1 else compared(maps)
    page, summary = write_map(result, folder), map_summary(result)
    table = map_table(summary)
    text = f"{page_table(table)}\n{table.caption}\nmap: {printable(page)}"
    if "subset" in summary:
        text = f"{textwrap.fill(subset_note(summary), _WIDTH)}\n\n{text}"
    data = {**summary, "report": page}
    if files:
        from mcspectra.rendering.adaptive import samples_per_pixel

        wanted = samples_per_pixel(result, options.target)
        for file in files:
            wanted.write(file)
        lines = [textwrap.fill(wanted.text, _WIDTH), *(f"wrote {file}" for file in files)]
        text = f"{text}\n\n" + "\n".join(lines)
        data["samples_per_pixel"] = {**wanted.to_dict(), "files": files}
    if options.target is not None:
        from mcspectra.profiler.scene_profile import profile_scene

        advice = profile_scene(options.scene, **_as_rendered(options, options.crop))
        text, data["profile"] = f"{advice.text}\n\n{text}", advice.to_dict()
    return VerbOutput(text, data)


def _map_cost(options: argparse.Namespace, parts: Any, subjects: Any) -> VerbOutput:
    """Estimate the size, time and storage of a map and of its page from a few pixels."""
    from dataclasses import replace

    from mcspectra.core.streams import Stream
    from mcspectra.report.map_page import page_seconds

    seed, imports = options.seed or 0, time.perf_counter() - options.begun
    costs = [
        part.cost(subject, Stream.from_rng(seed))
        for part, subject in zip(parts, subjects, strict=True)
    ]
    first = costs[0]
    seconds, samples = (sum(getattr(c, k) for c in costs) for k in ("seconds", "samples"))
    # A map has five figures: mean, variance, rate, error of the rate, and the picture.
    # Maps that compare strategies, or that show shares of the variance, have four more figures.
    # A map of a subset of the pixels has one more figure. So does a comparison of samplers
    figures = 5 + (4 if parts[0].integrator is None or parts[0].chains != 0 else 0)
    figures += (parts[0].pixels is not None) + (len(parts) > 1)
    others = "".join(f", {each.sampler.spec}" for each in subjects[1:])
    found = replace(
        first,
        what=first.what + others,
        samples=samples,
        samples_per_second=samples / sum(c.samples / c.samples_per_second for c in costs),
        seconds=imports + seconds + page_seconds(figures, first.size),
        storage=sum(c.storage for c in costs) + _PAGE_BYTES,
    )
    if options.target is not None:
        from mcspectra.profiler.scene_profile import plan_scene

        found = found.then(plan_scene(options.scene, **_as_rendered(options, options.crop)))
    return VerbOutput(found.text, found.to_dict())


def _as_rendered(options: argparse.Namespace, crop: Any) -> dict[str, Any]:
    """Return how the scene's profile, or its plan, compares samplers at the pixels of a crop."""
    return {
        "target": options.target,
        "integrator": None if options.integrator == "scene" else options.integrator,
        "joint_dims": options.joint_dims,
        "crop": crop,
        "rng": options.seed or 0,
    }


@verb(
    option(
        "FILES",
        f"a folder, a pattern in quotes, or files: {', '.join(LINEAR_EXTENSIONS)}; with "
        f"--tone-mapped also {', '.join(ENCODED_EXTENSIONS)}",
        nargs="+",
    ),
    option("--spp N", "samples per pixel (default: from names and headers)", whole()),
    option(
        "--sequence NAME",
        "names of sequences, such as 'shot_s{seed}_t{frame}.exr' (default: found in the names)",
    ),
    option(
        "--filter SPEC",
        "report the error after a filter, such as 'gaussian(sigma=1.5) | ema(alpha=0.1)'; "
        "repeatable",
        repeated="all",
        default=[],
    ),
    option(
        "--filter-command COMMAND",
        "program that filters a frame, such as 'denoise {input} -o {output}', or the folder of a "
        "sequence with {inputs} and {outputs}; its error is measured",
    ),
    option("--filter-timeout S", "longest time of the program (default: 300)", real(above=0.0)),
    option(
        "--reference FILE",
        "true image, or 'truth/t{frame}.exr' for sequences: report bias, relMSE and SMAPE by "
        "region and frame",
    ),
    option("--against PATH", "frames of another renderer or setting of the same view"),
    option("--target E", "relative error, σ / mean, that pixels should reach", real(above=0.0)),
    option("--seconds S", "render time per frame (default: from headers)", real(above=0.0)),
    option("--seconds-against S", "render time per frame of --against", real(above=0.0)),
    option("--layer NAME", "layer or channel of EXR files"),
    option("--tone-mapped", "also accept PNG and JPEG"),
    option("--no-flip", "skip FLIP, which takes most of the time"),
    option("--tev HOST:PORT", "show the layers in the viewer tev, e.g. at localhost:14158"),
    option(
        "-o, --out DIR",
        "folder for report.html, frames.exr, frames.json and pictures",
        repeated="once",
    ),
)
def frames_(options: argparse.Namespace) -> VerbOutput:
    """Measure the noise of independent renders of one view by any renderer.

    The results are variance, bias and error spectrum.
    Frames with different numbers of samples per pixel also give rates of the variance.
    --against compares two sets of frames: bias, variance, and variance at equal time.
    Sequences of several seeds also give the correlation of errors over time.
    """
    from mcspectra.rendering.frame_statistics import frames
    from mcspectra.report import frames_page

    files = options.files
    if options.out:
        frames_page.check_frames_packages()
    result = frames(
        files[0] if len(files) == 1 else files,
        spp=options.spp,
        against=options.against,
        target=options.target,
        seconds=options.seconds,
        seconds_against=options.seconds_against,
        layer=options.layer,
        tone_mapped=options.tone_mapped,
        flip=not options.no_flip,
        sequence=options.sequence,
        filters=options.filter,
        filter_command=options.filter_command,
        reference=options.reference,
        **({"filter_timeout": options.filter_timeout} if options.filter_timeout else {}),
    )
    found, said = frames_page.frame_summary(result), frames_page.frame_findings(result)
    tables = [frames_page.frame_table(found), frames_page.filter_table(found)]
    lines = [*(page_table(each) for each in tables if each is not None), *said]
    data = {**found, "findings": said}
    if options.tev:
        _show(result, options.tev)
    if options.out:
        data["report"] = frames_page.write_frames(result, options.out)
        lines.append(f"report: {data['report']}")
    return VerbOutput("\n".join(lines), data)


def _show(result: xr.Dataset, address: str) -> None:
    """Send every layer to the viewer tev as a separate picture."""
    import numpy as np

    from mcspectra.report.frames_page import frame_layers

    host, _, port = address.rpartition(":")
    if not port.isdecimal():
        raise ParameterError(f"--tev is {address!r}; give HOST:PORT, as for tev --hostname.")
    tev = optional_package("tevclient", "frames", "--tev needs").Ipc(host or "localhost", int(port))
    try:
        with tev:
            for name, plane in frame_layers(result).items():
                values = np.ascontiguousarray(np.atleast_3d(plane), np.float32)
                channels = ["R", "G", "B"] if values.shape[2] == 3 else ["Y"]
                title, (height, width, _) = f"mcspectra {name or 'mean'}", values.shape
                tev.create_image(title, width, height, channels)
                tev.update_image(title, values, channel_names=channels)
    except OSError as error:
        tev.__exit__(None, None, None)  # close the socket after a failed connection
        raise ParameterError(f"No tev answers at {address}: {error.strerror or error}.") from None
