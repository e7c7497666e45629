"""Draw point sets and write them.

Text goes to standard output in UTK's format (a point a line, '#' between sets), files by ending:
.dat, .bin, .npz, .csv.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

from mcspectra.cli.common import (
    one_sentence_warnings,
    print_json,
    read_sampler,
    seed_option,
    whole_number,
)

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    parser.add_argument("sampler", help="sampler spec, e.g. 'jittered | shift'; - reads points")
    parser.add_argument("-n", required=True, metavar="N", help="points in a set")
    parser.add_argument("-d", "--dims", metavar="D", help="number of dims (default 2)")
    parser.add_argument("-m", "--realizations", default=1, metavar="R", help="number of sets")
    parser.add_argument("--density", metavar="SPEC", help="warp the points to this density")
    parser.add_argument("-o", "--out", default="-", metavar="FILE", help="file; - is stdout")


def run(options: argparse.Namespace) -> int:
    """Draw and write."""
    from mcspectra.core.pointfiles import format_dat, write_points
    from mcspectra.densities import as_density

    dims = None if options.dims is None else whole_number("--dims", options.dims)
    sampler = read_sampler(options.sampler, dims)
    density = as_density(options.density, sampler.dims)
    count = whole_number("--realizations", options.realizations)
    seed = seed_option(options)
    with one_sentence_warnings(options.quiet):
        points = sampler.draw(whole_number("-n", options.n), realizations=count, rng=seed)
    if density is not None:
        points = density.sample(points)
    meta: dict[str, Any] = {"sampler": sampler.spec, "n": points.shape[1], "seed": seed}
    if density is not None:
        meta["density"] = density.spec
    if options.out != "-":
        write_points(options.out, list(points), meta=meta)
        if options.json:
            print_json({**meta, "shape": points.shape, "file": options.out})
    elif options.json:
        print_json({**meta, "points": points})
    else:  # the points are the result: --quiet silences warnings only
        sys.stdout.write(format_dat(list(points)))
    return 0
