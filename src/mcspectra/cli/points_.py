"""Draw point sets; write, picture or judge them.

Text goes to standard output in UTK's format (a point a line, '#' between sets), files by ending:
.dat, .bin, .npz, .csv, .parquet hold points; .svg, .png, .pdf are pictures. With --quality the
output is a table of distances, discrepancies and so on, over 16 sets unless -m says how many.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcspectra.cli.common import (
    Answer,
    adder,
    one_sentence_warnings,
    read_sampler,
    text_table,
    whole,
)
from mcspectra.core.errors import FileFormatError

if TYPE_CHECKING:
    from mcspectra.core.checks import Array

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options; the short ones are those of UTK's programs."""
    add = adder(parser)
    add("sampler", "sampler spec, e.g. 'jittered | shift'; - reads points")
    add("-n N", "points in a set", whole(), required=True)
    add("-d, --dims D", "number of dims (default 2)", whole())
    add("-m, --realizations R", "number of sets (default 1)", whole())
    add("-s S", "short for --seed", _seed, dest="seed")
    add("--density SPEC", "warp the points to this density")
    add("-o, --out FILE", "file; - is stdout", default="-")
    add("--quality", "print quality figures, not points")


def run(options: argparse.Namespace) -> Answer:
    """Draw, then write or measure."""
    from mcspectra.core.pointfiles import EXTENSIONS, format_dat, write_points
    from mcspectra.densities import as_density
    from mcspectra.report.point_pictures import PICTURE_EXTENSIONS, write_point_picture

    sampler = read_sampler(options.sampler, options.dims)
    density = as_density(options.density, sampler.dims)
    seed, n, file = options.seed or 0, options.n, options.out
    extension = Path(file).suffix.lower()
    if file != "-" and extension not in (*EXTENSIONS, *PICTURE_EXTENSIONS):
        given = f"the extension {Path(file).suffix!r}" if extension else "no extension"
        raise FileFormatError(
            f"{file} has {given}; points are {', '.join(EXTENSIONS)} files, pictures "
            f"{', '.join(PICTURE_EXTENSIONS)}."
        )
    count = options.realizations
    if count is None and options.quality:
        from mcspectra.core.streams import Stream
        from mcspectra.quality.figures import different_realizations

        count = different_realizations(sampler, sampler.check_count(n), Stream.from_rng(seed))
    points = sampler.draw(n, realizations=count or 1, rng=seed)
    meta: dict[str, Any] = {"sampler": sampler.spec, "n": points.shape[1], "seed": seed}
    if density is not None:
        points, meta["density"] = density.sample(points), density.spec
    if extension in EXTENSIONS and file != "-":
        write_points(file, list(points), meta=meta)
    elif file != "-":
        title = ", ".join([sampler.spec, f"n = {meta['n']}", f"seed {seed}"])
        title += f", density {density.spec}" if density is not None else ""
        write_point_picture(file, points, title)
    if options.quality:
        return _quality(sampler if density is None else points, points, meta, options)
    if options.json:
        written = {"shape": points.shape, "file": file}
        return Answer(data={**meta, **({"points": points} if file == "-" else written)})
    # The points are the result: --quiet silences warnings only
    return Answer(format_dat(list(points)).rstrip("\n") if file == "-" else "")


def _seed(name: str, text: str) -> int:
    del name
    return whole(0)("--seed", text)


def _quality(
    source: Any, points: Array, meta: dict[str, Any], options: argparse.Namespace
) -> Answer:
    """Measure the points; the table is the result, --quiet silences remarks only."""
    from mcspectra.quality import quality_figures, summarize

    count, n, _ = points.shape
    with one_sentence_warnings(quiet=True):  # said when the points were drawn
        figures = summarize(quality_figures(source, n, realizations=count, rng=meta["seed"]))
    rows, missing = [], []
    data: dict[str, dict[str, Any]] = {}
    for each in figures:
        error = "-" if math.isnan(each.standard_error) else f"{each.standard_error:.2g}"
        if each.missing:
            missing.append(f"no {each.name}: {each.missing}")
            data[each.name] = {"mean": None, "standard_error": None, "missing": each.missing}
        else:
            rows.append([each.name, each.long_name, f"{each.mean:.5g}", error])
            data[each.name] = {"mean": each.mean, "standard_error": each.standard_error}
    title = f"{meta['sampler']}, n = {meta['n']}, {count} set{'s' if count > 1 else ''}"
    table = text_table(["figure", "what it is", "mean", "± standard error"], rows)
    lines = [title, table, *([] if options.quiet else missing)]
    about = {**meta, "realizations": count, "quality": data}
    return Answer("\n".join(lines), about if options.json else None)
