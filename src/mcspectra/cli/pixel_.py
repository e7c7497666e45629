"""Everything about one pixel of a scene: what it sees, rates, terms, bottleneck, remedies.

The pixel is X Y, counted from the left and from the top, or the name of one (figure1 has P and Q). With
--out DIR, DIR/report.html, DIR/pixel.json and DIR/figures/*.png are written.
"""

from __future__ import annotations

import argparse
import textwrap
from typing import TYPE_CHECKING

from mcspectra.cli.common import Answer, adder, index_or_name, text_table, whole, wholes
from mcspectra.core.errors import ParameterError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["add_arguments", "run"]

_WIDTH = 100


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options; those that are not given are left to `analyse_pixel`."""
    add = adder(parser)
    add("scene", "scene, e.g. veach, or a Mitsuba XML file")
    add("X", "column of the pixel, or the name of a pixel")
    add("Y", "row of the pixel", whole(0), nargs="?")
    add("--light NAME", "the one light that counts; all by default", index_or_name)
    add("--channel CHANNEL", "luminance (default), 0, 1 or 2", index_or_name)
    add("-d, --dims D", "2, or 3 to select lobes", whole())
    add(
        "--samplers SPEC",
        "samplers to compare; random, jittered, 'jittered | shift' and 'sobol | owen'. The first "
        "that is not random is that of terms, bottleneck and remedies",
        nargs="+",
    )
    add("--counts N,N,…", "samples n of each technique", wholes())
    add("-m, --realizations R", "estimates for each n", whole(4))
    add("--budget B", "evaluations at which remedies are ranked; twice the largest n", whole())
    add("--no-remedies", "leave remedies out")
    effort = adder(parser.add_mutually_exclusive_group())
    effort("--quick", "some seconds (default)")
    effort("--full", "some minutes: more of everything")
    add("--out DIR", "write the report into this folder")


_PASSED = ("light", "channel", "dims", "samplers", "counts", "realizations", "budget")


def run(options: argparse.Namespace) -> Answer:
    """Analyse and write."""
    from mcspectra.report.pixel_page import write_pixel
    from mcspectra.report.pixel_text import pixel_summary
    from mcspectra.studies.pixel import analyse_pixel

    x: int | str = options.x
    if options.y is not None:
        x = whole(0)("X", options.x)
    elif options.x.lstrip("-").isdecimal():
        raise ParameterError(f"The pixel has a column, {x}, and no row; give X and Y.")
    given = {name: getattr(options, name) for name in _PASSED}
    tree = analyse_pixel(
        options.scene,
        x,
        options.y,
        remedies=not options.no_remedies,
        effort="full" if options.full else "quick",
        rng=options.seed or 0,
        **{name: value for name, value in given.items() if value is not None},
    )
    text, data = _text(tree), pixel_summary(tree)
    if options.out is not None:
        data["report"] = page = write_pixel(tree, options.out)
        text += f"\n\nreport: {page}"
    return Answer(text, data)


def _text(tree: xr.DataTree) -> str:
    """What it sees, the rates, the terms, and the sentences."""
    from mcspectra.report.formatting import interval, number, rate
    from mcspectra.report.pixel_text import about_pixel, pixel_rows, pixel_sentences, term_rows

    known = tree.attrs
    head = [f"pixel ({known['x']}, {known['y']}) of {known['scene']}"]
    head += [f"  {name}: {text}" for name, text in about_pixel(tree)]
    said = [
        textwrap.fill(f"{name}: {text}", _WIDTH, subsequent_indent="  ")
        for name, text in pixel_sentences(tree)
    ]
    rates = [
        [row.estimator, row.sampler, rate(row.rate, row.rate_low, row.rate_high), str(row.n),
         number(row.variance)]
        for row in pixel_rows(tree)
    ]  # fmt: skip
    terms = [
        [row.sampler, f"n = {row.terms_n}",
         *(number(v) for v in (row.dc, row.power, row.cross, row.predicted, row.measured)),
         interval(row.measured_low, row.measured_high), number(row.captured)]
        for row in term_rows(tree)
    ]  # fmt: skip
    about = ["terms", "", "dc", "power", "cross", "predicted", "measured", "95 %", "captured"]
    tables = [
        text_table(["strategy", "sampler", "rate", "n", "variance"], rates),
        text_table(about, terms),
    ]
    if "remedies" in tree.children:
        found = tree["remedies"].to_dataset()
        ratios = []
        for name in found["remedy"].values:
            one = found.sel(remedy=name)
            bounds = interval(*one["error_ratio_ci"].values.tolist())
            ratio = number(float(one["error_ratio"]))
            ratios.append([str(name), str(one["verdict"].item()), ratio, bounds])
        tables.append(text_table(["remedy", "", "error / given", "95 %"], ratios))
    parts = [head, *([table] for table in tables), said]
    return "\n\n".join("\n".join(part) for part in parts)
