"""Map variance, its rate and what decides it over an image of a scene.

Writes DIR/maps.exr (all layers), DIR/*.png, DIR/map.json and DIR/report.html; DIR/tiles keeps what is
finished, and --resume goes on from there.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mcspectra.cli.common import (
    counts_option,
    index_or_name,
    one_sentence_warnings,
    print_json,
    seed_option,
    text_table,
    whole_number,
)
from mcspectra.cli.progress import progress_bars

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    parser.add_argument("scene", help="scene, e.g. veach, or a Mitsuba XML file")
    parser.add_argument("--out", default="out/map", metavar="DIR", help="output folder")
    parser.add_argument("--resume", action="store_true", help="go on with the tiles of DIR")
    parser.add_argument("--crop", metavar="X0,Y0,W,H", help="part of the image; all by default")
    parser.add_argument("--size", metavar="W,H", help="pixels of the image; those of the film")
    parser.add_argument(
        "--strategies", metavar="NAME,…", help="light, bsdf, mis-light, mis-bsdf, mis; all of them"
    )
    parser.add_argument("--sampler", default="jittered", metavar="SPEC", help="default jittered")
    parser.add_argument("--counts", default="4,9,16,36,64", metavar="N,N,…", help="samples n")
    parser.add_argument("-m", "--realizations", default=64, metavar="R", help="default 64")
    parser.add_argument("--light", metavar="NAME", help="the one light that counts; all by default")
    parser.add_argument("--heuristic", default="balance", help="balance (default) or power")
    parser.add_argument("--channel", default="luminance", help="luminance (default), 0, 1 or 2")
    parser.add_argument("-d", "--dims", default=2, metavar="D", help="2, or 3 to select lobes")
    parser.add_argument("--points", default="shared", help="shared (default) or own for each pixel")
    parser.add_argument("--smoothing", default=1, metavar="K", help="odd: average rates over K × K")
    parser.add_argument(
        "--predict-every", default=1, metavar="K", help="predict every so many pixels; 0: none"
    )
    parser.add_argument("--workers", metavar="N", help="threads; all processors by default")


def run(options: argparse.Namespace) -> int:
    """Measure, write and print."""
    from mcspectra.rendering.maps import variance_map
    from mcspectra.report.map_page import map_note, map_summary, write_map

    silent = options.quiet or options.json
    folder = Path(options.out)
    with one_sentence_warnings(silent), progress_bars(silent):
        result = variance_map(options.scene, **_arguments(options), out=folder / "tiles")
        page = write_map(result, folder)
    summary = map_summary(result)
    if options.json:
        print_json({**summary, "report": str(page)})
    elif not options.quiet:
        print(f"{_text(summary)}\n{map_note(summary)}\nmap: {page}")
    return 0


def _arguments(options: argparse.Namespace) -> dict[str, Any]:
    """Arguments of `variance_map` from the options."""
    chosen: dict[str, Any] = {
        "sampler": options.sampler,
        "counts": counts_option(options.counts),
        "realizations": whole_number("--realizations", options.realizations, least=2),
        "light": index_or_name(options.light),
        "heuristic": options.heuristic,
        "channel": index_or_name(options.channel),
        "dims": whole_number("--dims", options.dims),
        "points": options.points,
        "smoothing": whole_number("--smoothing", options.smoothing),
        "predict_every": whole_number("--predict-every", options.predict_every, least=0),
        "rng": seed_option(options),
        "resume": options.resume,
    }
    for name in ("crop", "size"):
        text = getattr(options, name)
        chosen[name] = None if text is None else _integers(f"--{name}", text)
    if options.strategies is not None:
        chosen["strategies"] = [part.strip() for part in options.strategies.split(",")]
    if options.workers is not None:
        chosen["workers"] = whole_number("--workers", options.workers)
    return chosen


def _integers(name: str, text: str) -> list[int]:
    return [whole_number(name, part.strip(), least=0) for part in text.split(",")]


def _text(summary: dict[str, Any]) -> str:
    rows = [
        [name, "", *(f"{value:.4g}" for value in row.values())]
        for name, row in summary["strategies"].items()
    ]
    header = ["strategy", "", *next(iter(summary["strategies"].values()))]
    return text_table(header, rows)
