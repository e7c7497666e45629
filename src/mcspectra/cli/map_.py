"""Map variance, its rate and what decides it over an image of a scene.

Writes DIR/maps.exr (all layers), DIR/*.png, DIR/map.json and DIR/report.html; DIR/tiles keeps what is
finished, and --resume goes on from there.
"""

from __future__ import annotations

import argparse
import functools
from pathlib import Path

from mcspectra.cli.common import Answer, Read, index_or_name, text_table, whole, wholes

__all__ = ["add_arguments", "run"]


def _names(name: str, text: str) -> list[str]:
    del name
    return [part.strip() for part in text.split(",")]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options; those that are not given are left to `variance_map`."""
    add = functools.partial(parser.add_argument, action=Read)
    add("scene", help="scene, e.g. veach, or a Mitsuba XML file")
    add("--out", default="out/map", metavar="DIR", help="output folder")
    parser.add_argument("--resume", action="store_true", help="go on with the tiles of DIR")
    add("--crop", read=wholes(least=0), metavar="X0,Y0,W,H",
        help="part of the image; all by default")  # fmt: skip
    add("--size", read=wholes(least=0), metavar="W,H",
        help="pixels of the image; those of the film")  # fmt: skip
    add("--strategies", read=_names, metavar="NAME,…",
        help="light, bsdf, mis-light, mis-bsdf, mis; all of them")  # fmt: skip
    add("--sampler", metavar="SPEC", help="default jittered")
    add("--counts", read=wholes(), metavar="N,N,…", help="samples n, default 4,9,16,36,64")
    add("-m", "--realizations", read=whole(2), metavar="R", help="default 64")
    add("--light", read=index_or_name, metavar="NAME",
        help="the one light that counts; all by default")  # fmt: skip
    add("--heuristic", help="balance (default) or power")
    add("--channel", read=index_or_name, help="luminance (default), 0, 1 or 2")
    add("-d", "--dims", read=whole(), metavar="D", help="2, or 3 to select lobes")
    add("--points", help="shared (default) or own for each pixel")
    add("--smoothing", read=whole(), metavar="K", help="odd: average rates over K × K")
    add("--predict-every", read=whole(0), metavar="K",
        help="predict every so many pixels; 0: none")  # fmt: skip
    add("--workers", read=whole(), metavar="N", help="threads; all processors by default")


_PASSED = (
    *("crop", "size", "strategies", "sampler", "counts", "realizations", "light", "heuristic"),
    *("channel", "dims", "points", "smoothing", "predict_every", "workers"),
)


def run(options: argparse.Namespace) -> Answer:
    """Measure and write."""
    from mcspectra.rendering.maps import variance_map
    from mcspectra.report.map_page import map_note, map_summary, write_map

    given = {name: getattr(options, name) for name in _PASSED}
    folder = Path(options.out)
    result = variance_map(
        options.scene,
        rng=options.seed or 0,
        out=folder / "tiles",
        resume=options.resume,
        **{name: value for name, value in given.items() if value is not None},
    )
    page, summary = write_map(result, folder), map_summary(result)
    shown = summary["strategies"]
    rows = [[name, "", *(f"{v:.4g}" for v in row.values())] for name, row in shown.items()]
    table = text_table(["strategy", "", *next(iter(shown.values()))], rows)
    return Answer(f"{table}\n{map_note(summary)}\nmap: {page}", {**summary, "report": page})
