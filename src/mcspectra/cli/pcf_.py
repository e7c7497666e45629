"""Pair correlation g(r) of a sampler: density of pairs at a distance, random points 1.

Prints r, r in units of the mean spacing n^(-1/d), g(r) and its standard error.
"""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

from mcspectra.cli.common import (
    one_sentence_warnings,
    print_json,
    read_sampler,
    real_number,
    realizations_option,
    seed_option,
    text_table,
    whole_number,
)
from mcspectra.cli.progress import progress_bars

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    parser.add_argument("sampler", help="sampler spec; - reads one point set from standard input")
    parser.add_argument("-n", required=True, metavar="N", help="points in a set, at least 2")
    parser.add_argument("-d", "--dims", metavar="D", help="number of dims (default 2)")
    parser.add_argument("-m", "--realizations", metavar="R", help="default 16, or all sets given")
    parser.add_argument("--bins", default=100, metavar="B", help="bins of r (default 100)")
    parser.add_argument(
        "--boundary",
        default="toroidal",
        help="toroidal (default): distances wrap around; border: they do not, for sets that end",
    )
    parser.add_argument(
        "--max-distance", metavar="R", help="largest r (default 0.5, with border 0.25)"
    )


def run(options: argparse.Namespace) -> int:
    """Estimate and print."""
    from mcspectra.spectra.pair_correlation import pair_correlation

    dims = None if options.dims is None else whole_number("--dims", options.dims)
    most = options.max_distance
    with one_sentence_warnings(options.quiet), progress_bars(options.quiet):
        sampler = read_sampler(options.sampler, dims)
        result = pair_correlation(
            sampler,
            whole_number("-n", options.n),
            bins=whole_number("--bins", options.bins),
            realizations=realizations_option(options.realizations, sampler, 16),
            rng=seed_option(options),
            boundary=options.boundary,
            max_distance=None if most is None else real_number("--max-distance", most),
        )
    spacing = result.attrs["n"] ** (-1.0 / sampler.dims)
    if options.json:
        names = ("r", "pair_correlation", "pair_correlation_se")
        values = {name: result[name].values for name in names}
        print_json({**result.attrs, "mean_spacing": spacing, **values})
    elif not options.quiet:
        print(_text(result, spacing))
    return 0


def _text(result: xr.Dataset, spacing: float) -> str:
    columns = (result[name].values for name in ("r", "pair_correlation", "pair_correlation_se"))
    rows = [
        [f"{r:.5g}", f"{r / spacing:.3f}", f"{g:.5g}", f"{se:.2g}" if math.isfinite(se) else "–"]
        for r, g, se in zip(*columns, strict=True)
    ]
    return text_table(["r", "r·n^(1/d)", "g(r)", "std. error"], rows)
