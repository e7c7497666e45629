"""Expected power spectrum of a sampler.

Prints the radial mean, as power times n (random points: 1), or what --show asks for. With --out
FILE.npz all values are written, with FILE.png or FILE.pdf the picture.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.cli.common import (
    add_engine_argument,
    one_sentence_warnings,
    print_json,
    read_sampler,
    realizations_option,
    seed_option,
    whole_number,
)
from mcspectra.cli.progress import progress_bars
from mcspectra.cli.spectrum_views import VIEWS
from mcspectra.core.checks import as_choice
from mcspectra.core.errors import FileFormatError, ParameterError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    parser.add_argument("sampler", help="sampler spec; - reads one point set from standard input")
    parser.add_argument("-n", required=True, metavar="N", help="points in a set")
    parser.add_argument("-d", "--dims", metavar="D", help="number of dims (default 2)")
    parser.add_argument("-m", "--realizations", metavar="R", help="default 100, or all sets given")
    parser.add_argument("--density", metavar="SPEC", help="importance density")
    parser.add_argument("--half-width", default=64, metavar="K", help="default 64")
    parser.add_argument(
        "--frequency-step", default="1", metavar="S", help="below 1: real frequencies"
    )
    parser.add_argument(
        "--show",
        default="power",
        help="power (default): radial mean; radial: with errors and anisotropy; slices; wedges: by "
        "direction; exponent: b of power ∝ |m|^b",
    )
    add_engine_argument(parser)
    parser.add_argument("-o", "--out", metavar="FILE", help=".npz, .png or .pdf")


def run(options: argparse.Namespace) -> int:
    """Estimate and print."""
    from mcspectra.spectra.power import power_spectrum

    view = VIEWS[as_choice("--show", options.show, tuple(VIEWS))]
    dims = None if options.dims is None else whole_number("--dims", options.dims)
    if options.out is not None and Path(options.out).suffix not in (".npz", ".png", ".pdf"):
        raise ParameterError(f"--out is {options.out!r}; it must end in .npz, .png or .pdf.")
    try:
        step = float(options.frequency_step)
    except ValueError:
        raise ParameterError(
            f"--frequency-step is {options.frequency_step!r}; give a number greater than 0."
        ) from None
    with one_sentence_warnings(options.quiet), progress_bars(options.quiet):
        sampler = read_sampler(options.sampler, dims)
        result = power_spectrum(
            sampler,
            whole_number("-n", options.n),
            density=options.density,
            half_width=whole_number("--half-width", options.half_width),
            frequency_step=step,
            realizations=realizations_option(options.realizations, sampler, 100),
            rng=seed_option(options),
            engine=options.engine,
        )
    if options.out:
        _write(result, Path(options.out))
    text, data = view(result)
    if options.json:
        print_json(data)
    elif not options.quiet:
        print(text)
    return 0


def _write(result: xr.Dataset, path: Path) -> None:
    try:
        if path.suffix == ".npz":
            np.savez(path, **{str(name): v.values for name, v in result.variables.items()})  # type: ignore[arg-type]
            return
        from mcspectra.report import figures

        dims = len(result["power"].dims)
        draw = {1: figures.power_lines, 2: figures.power_images}.get(dims, figures.radial_power)
        draw(result).savefig(path)
    except OSError as error:
        raise FileFormatError(f"{str(path)!r} cannot be written: {error.strerror}.") from None
