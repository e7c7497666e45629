"""Draw point sets; write, picture or judge them.

Text goes to standard output in UTK's format (a point a line, '#' between sets), files by ending:
.dat, .bin, .npz, .csv, .parquet hold points; .svg, .png, .pdf are pictures. With --quality the
output is a table of distances, discrepancies and so on, over 16 sets unless -m says how many.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcspectra.cli.common import (
    one_sentence_warnings,
    print_json,
    read_sampler,
    seed_option,
    text_table,
    whole_number,
)
from mcspectra.cli.progress import progress_bars
from mcspectra.core.checks import Array

if TYPE_CHECKING:
    from mcspectra.quality import FigureSummary
    from mcspectra.samplers import Sampler

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options; the short ones are those of UTK's programs."""
    parser.add_argument("sampler", help="sampler spec, e.g. 'jittered | shift'; - reads points")
    parser.add_argument("-n", required=True, metavar="N", help="points in a set")
    parser.add_argument("-d", "--dims", metavar="D", help="number of dims (default 2)")
    parser.add_argument("-m", "--realizations", metavar="R", help="number of sets (default 1)")
    parser.add_argument("-s", dest="seed", metavar="S", help="short for --seed")
    parser.add_argument("--density", metavar="SPEC", help="warp the points to this density")
    parser.add_argument("-o", "--out", default="-", metavar="FILE", help="file; - is stdout")
    parser.add_argument("--quality", action="store_true", help="print quality figures, not points")


def run(options: argparse.Namespace) -> int:
    """Draw, then write or measure."""
    from mcspectra.densities import as_density

    dims = None if options.dims is None else whole_number("--dims", options.dims)
    sampler = read_sampler(options.sampler, dims)
    density = as_density(options.density, sampler.dims)
    seed, n = seed_option(options), whole_number("-n", options.n)
    _check_extension(options.out)
    with one_sentence_warnings(options.quiet), progress_bars(options.quiet):
        count = _realizations(options, sampler, n, seed)
        points = sampler.draw(n, realizations=count, rng=seed)
    if density is not None:
        points = density.sample(points)
    meta: dict[str, Any] = {"sampler": sampler.spec, "n": points.shape[1], "seed": seed}
    if density is not None:
        meta["density"] = density.spec
    if options.out != "-":
        _write(options.out, points, meta)
    if options.quality:
        figures = _measure(sampler if density is None else points, points, seed)
        _print_quality(figures, {**meta, "realizations": count}, options)
    elif options.json:
        written = {"shape": points.shape, "file": options.out}
        print_json({**meta, **({"points": points} if options.out == "-" else written)})
    elif options.out == "-":  # the points are the result: --quiet silences warnings only
        _print(points)
    return 0


def _realizations(options: argparse.Namespace, sampler: Sampler, n: int, seed: int) -> int:
    if options.realizations is not None:
        return whole_number("--realizations", options.realizations)
    if not options.quality:
        return 1
    from mcspectra.core.streams import Stream
    from mcspectra.quality.figures import different_realizations

    return different_realizations(sampler, sampler.check_count(n), Stream.from_rng(seed))


def _check_extension(path: str) -> None:
    """Refuse other files before anything is drawn."""
    from mcspectra.core.errors import FileFormatError
    from mcspectra.core.pointfiles import EXTENSIONS
    from mcspectra.report.point_pictures import PICTURE_EXTENSIONS

    extension = Path(path).suffix
    if path != "-" and extension.lower() not in (*EXTENSIONS, *PICTURE_EXTENSIONS):
        given = f"the extension {extension!r}" if extension else "no extension"
        raise FileFormatError(
            f"{path} has {given}; points are {', '.join(EXTENSIONS)} files, pictures "
            f"{', '.join(PICTURE_EXTENSIONS)}."
        )


def _write(path: str, points: Array, meta: dict[str, Any]) -> None:
    from mcspectra.core.pointfiles import EXTENSIONS, write_points
    from mcspectra.report.point_pictures import write_point_picture

    if Path(path).suffix.lower() in EXTENSIONS:
        write_points(path, list(points), meta=meta)
        return
    parts = [meta["sampler"], f"n = {meta['n']}", f"seed {meta['seed']}"]
    parts += [f"density {meta['density']}"] if "density" in meta else []
    write_point_picture(path, points, ", ".join(parts))


def _measure(source: Any, points: Array, seed: int) -> list[FigureSummary]:
    from mcspectra.quality import quality_figures, summarize

    count, n, _ = points.shape
    with one_sentence_warnings(quiet=True):  # said when the points were drawn
        return summarize(quality_figures(source, n, realizations=count, rng=seed))


def _print_quality(
    figures: list[FigureSummary], meta: dict[str, Any], options: argparse.Namespace
) -> None:
    if options.json:
        print_json({**meta, "quality": {f.name: _as_json(f) for f in figures}})
        return
    count = meta["realizations"]
    print(f"{meta['sampler']}, n = {meta['n']}, {count} set{'s' if count > 1 else ''}")
    rows = [[f.name, f.long_name, f"{f.mean:.5g}", _error(f)] for f in figures if not f.missing]
    print(text_table(["figure", "what it is", "mean", "± standard error"], rows))
    for figure in figures:
        if figure.missing and not options.quiet:
            print(f"no {figure.name}: {figure.missing}")


def _error(figure: FigureSummary) -> str:
    return "-" if math.isnan(figure.standard_error) else f"{figure.standard_error:.2g}"


def _as_json(figure: FigureSummary) -> dict[str, Any]:
    if figure.missing:
        return {"mean": None, "standard_error": None, "missing": figure.missing}
    return {"mean": figure.mean, "standard_error": figure.standard_error}


def _print(points: Array) -> None:
    from mcspectra.core.pointfiles import format_dat

    sys.stdout.write(format_dat(list(points)))
