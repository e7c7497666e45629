"""Everything about one pixel of a scene: what it sees, rates, terms, bottleneck, remedies.

The pixel is X Y, counted from the left and from the top, or the name of one (figure1 has P and Q). With
--out DIR, DIR/report.html, DIR/pixel.json and DIR/figures/*.png are written.
"""

from __future__ import annotations

import argparse
import textwrap
from typing import TYPE_CHECKING, Any

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
from mcspectra.core.errors import ParameterError

if TYPE_CHECKING:
    import xarray as xr

    from mcspectra.studies import SummaryRow

__all__ = ["add_arguments", "run"]

_WIDTH = 100


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    parser.add_argument("scene", help="scene, e.g. veach, or a Mitsuba XML file")
    parser.add_argument("x", metavar="X", help="column of the pixel, or the name of a pixel")
    parser.add_argument("y", metavar="Y", nargs="?", help="row of the pixel")
    parser.add_argument("--light", metavar="NAME", help="the one light that counts; all by default")
    parser.add_argument("--channel", default="luminance", help="luminance (default), 0, 1 or 2")
    parser.add_argument("-d", "--dims", default=2, metavar="D", help="2, or 3 to select lobes")
    parser.add_argument(
        "--samplers",
        nargs="+",
        metavar="SPEC",
        help="samplers to compare; random, jittered, 'jittered | shift' and 'sobol | owen'. The "
        "first that is not random is that of terms, bottleneck and remedies",
    )
    parser.add_argument("--counts", metavar="N,N,…", help="samples n of each technique")
    parser.add_argument("-m", "--realizations", metavar="R", help="estimates for each n")
    parser.add_argument(
        "--budget",
        metavar="B",
        help="evaluations at which remedies are ranked; twice the largest n",
    )
    parser.add_argument("--no-remedies", action="store_true", help="leave remedies out")
    effort = parser.add_mutually_exclusive_group()
    effort.add_argument("--quick", action="store_true", help="some seconds (default)")
    effort.add_argument("--full", action="store_true", help="some minutes: more of everything")
    parser.add_argument("--out", metavar="DIR", help="write the report into this folder")


def run(options: argparse.Namespace) -> int:
    """Analyse, write and print."""
    from mcspectra.report.pixel_page import write_pixel
    from mcspectra.report.pixel_text import pixel_summary
    from mcspectra.studies.pixel import analyse_pixel

    silent = options.quiet or options.json
    x, y = _place(options.x, options.y)
    with one_sentence_warnings(silent), progress_bars(silent):
        tree = analyse_pixel(options.scene, x, y, **_arguments(options))
        page = None if options.out is None else write_pixel(tree, options.out)
    if options.json:
        print_json(pixel_summary(tree) | ({} if page is None else {"report": str(page)}))
    elif not options.quiet:
        print(_text(tree) + ("" if page is None else f"\n\nreport: {page}"))
    return 0


def _place(x: str, y: str | None) -> tuple[int | str, int | None]:
    if y is not None:
        return whole_number("X", x, least=0), whole_number("Y", y, least=0)
    if x.lstrip("-").isdecimal():
        raise ParameterError(f"The pixel has a column, {x}, and no row; give X and Y.")
    return x, None


def _arguments(options: argparse.Namespace) -> dict[str, Any]:
    """Arguments of `analyse_pixel` from the options; those not given keep their defaults."""
    chosen: dict[str, Any] = {
        "light": index_or_name(options.light),
        "channel": index_or_name(options.channel),
        "dims": whole_number("--dims", options.dims),
        "remedies": not options.no_remedies,
        "effort": "full" if options.full else "quick",
        "rng": seed_option(options),
    }
    if options.samplers is not None:
        chosen["samplers"] = options.samplers
    if options.counts is not None:
        chosen["counts"] = counts_option(options.counts)
    if options.realizations is not None:
        chosen["realizations"] = whole_number("--realizations", options.realizations, least=4)
    if options.budget is not None:
        chosen["budget"] = whole_number("--budget", options.budget)
    return chosen


def _text(tree: xr.DataTree) -> str:
    """What it sees, the rates, the terms, and the sentences."""
    from mcspectra.report.pixel_text import about_pixel, pixel_rows, pixel_sentences, term_rows

    known = tree.attrs
    head = [f"pixel ({known['x']}, {known['y']}) of {known['scene']}"]
    head += [f"  {name}: {text}" for name, text in about_pixel(tree)]
    said = [
        textwrap.fill(f"{name}: {text}", _WIDTH, subsequent_indent="  ")
        for name, text in pixel_sentences(tree)
    ]
    parts = [head, [_rate_table(pixel_rows(tree))], [_term_table(term_rows(tree))], said]
    if "remedies" in tree.children:
        parts.insert(3, [_remedy_table(tree["remedies"].to_dataset())])
    return "\n\n".join("\n".join(part) for part in parts)


def _rate_table(rows: list[SummaryRow]) -> str:
    from mcspectra.report.formatting import number, rate

    cells = [
        [row.estimator, row.sampler, rate(row.rate, row.rate_low, row.rate_high), str(row.n),
         number(row.variance)]
        for row in rows
    ]  # fmt: skip
    return text_table(["strategy", "sampler", "rate", "n", "variance"], cells)


def _term_table(rows: list[SummaryRow]) -> str:
    from mcspectra.report.formatting import interval, number

    cells = [
        [row.sampler, f"n = {row.terms_n}",
         *(number(v) for v in (row.dc, row.power, row.cross, row.predicted, row.measured)),
         interval(row.measured_low, row.measured_high), number(row.captured)]
        for row in rows
    ]  # fmt: skip
    header = ["terms", "", "dc", "power", "cross", "predicted", "measured", "95 %", "captured"]
    return text_table(header, cells)


def _remedy_table(found: xr.Dataset) -> str:
    from mcspectra.report.formatting import interval, number

    cells = []
    for name in found["remedy"].values:
        one = found.sel(remedy=name)
        bounds = interval(*one["error_ratio_ci"].values.tolist())
        cells.append(
            [str(name), str(one["verdict"].item()), number(float(one["error_ratio"])), bounds]
        )
    return text_table(["remedy", "", "error / given", "95 %"], cells)
