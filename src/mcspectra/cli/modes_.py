"""Leading modes of the covariance of the spectra: which patterns of frequencies vary together.

Prints the eigenvalues, their share of the whole, and what each mode gives to the variance. With --out
FILE.npz the patterns are written too.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.cli.common import (
    Once,
    add_estimator_arguments,
    build_estimator,
    one_sentence_warnings,
    print_json,
    read_sampler,
    seed_option,
    text_table,
    whole_number,
)
from mcspectra.cli.progress import progress_bars
from mcspectra.core.errors import FileFormatError, ParameterError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["add_arguments", "run"]

_VALUES = (
    "eigenvalue",
    "eigenvalue_se",
    "eigenvalue_share",
    "eigenvalue_residual",
    "mode_contribution",
)
_HEADER = ["mode", "", "eigenvalue", "standard error", "share", "numerical residual ≤"]
_ROUNDING = 1e-13  # of the sum of all: what eigenvalues of zero come out as


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    add_estimator_arguments(parser)
    parser.add_argument(
        "--sampler", action=Once, required=True, metavar="SPEC", help="sampler spec"
    )
    parser.add_argument("-n", required=True, metavar="N", help="points (of each technique)")
    parser.add_argument("-m", "--realizations", default=1000, metavar="R", help="default 1000")
    parser.add_argument("--half-width", default=32, metavar="K", help="default 32")
    parser.add_argument("--modes", default=8, metavar="M", help="how many (default 8)")
    parser.add_argument(
        "--passes", default=3, metavar="P", help="over the realisations (default 3)"
    )
    parser.add_argument(
        "--points-only", action="store_true", help="of S_m, the points' own, not of conj(f_m) S_m"
    )
    parser.add_argument("--space", help="domain or primary (default: domain where there is one)")
    parser.add_argument(
        "--basis", default="fourier", help="fourier (default), cosine, walsh, haar or auto"
    )
    parser.add_argument(
        "--bands", default="radial", help="partition of --band: radial, dyadic, anova or wedge"
    )
    parser.add_argument(
        "--band", action="append", metavar="LABEL", help="only this band; repeatable"
    )
    parser.add_argument(
        "--channel", default=0, metavar="C", help="of an integrand with several (default 0)"
    )
    parser.add_argument("-o", "--out", metavar="FILE", help=".npz")


def run(options: argparse.Namespace) -> int:
    """Find the modes and print."""
    from mcspectra.variance.modes import covariance_modes

    if options.out is not None and Path(options.out).suffix != ".npz":
        raise ParameterError(f"--out is {options.out!r}; it must end in .npz.")
    estimator = build_estimator(options)
    domain = "domain" if estimator.domain_integrand is not None else "primary"
    with one_sentence_warnings(options.quiet), progress_bars(options.quiet):
        result = covariance_modes(
            estimator,
            read_sampler(options.sampler, estimator.dims),
            whole_number("-n", options.n),
            half_width=whole_number("--half-width", options.half_width, least=0),
            modes=whole_number("--modes", options.modes),
            weighted=not options.points_only,
            bands=options.bands,
            band=options.band,
            channel=whole_number("--channel", options.channel, least=0),
            passes=whole_number("--passes", options.passes, least=2),
            realizations=whole_number("--realizations", options.realizations, least=2),
            rng=seed_option(options),
            space=options.space or domain,
            basis=options.basis,
        )
    if options.out:
        _write(result, options.out)
    if options.json:
        values = {name: result[name].values for name in (*_VALUES, "band_trace", "noise_edge")}
        print_json({**result.attrs, **values})
    elif not options.quiet:
        print(_text(result))
    return 0


def _text(result: xr.Dataset) -> str:
    attrs = result.attrs
    about = f"{attrs['estimator']}  with  {attrs['sampler']},  n = {attrs['n']}"
    trace, edge = float(result["band_trace"]), float(result["noise_edge"])
    shown = int(np.count_nonzero(result["eigenvalue"].values > _ROUNDING * trace))
    if not shown:
        return f"{about}\nno mode: the coefficients do not vary"
    columns = (result[name].values[:shown] for name in _VALUES)
    rows = [
        [str(place), "", *(f"{v:.5g}" if np.isfinite(v) else "–" for v in values)]
        for place, values in enumerate(zip(*columns, strict=True))
    ]
    lines = [about, text_table([*_HEADER, "part of variance"], rows)]
    if shown < result.sizes["mode"]:
        lines.append(f"{result.sizes['mode'] - shown} more of rounding size")
    if "note" in attrs:
        lines.append(attrs["note"])
    lines.append(
        f"largest eigenvalue of a flat spectrum with the same sum (noise edge): {edge:.6g}"
    )
    return "\n".join([*lines, f"sum of all eigenvalues: {trace:.6g}"])


def _write(result: xr.Dataset, path: str) -> None:
    try:
        np.savez(path, **{str(name): v.values for name, v in result.variables.items()})  # type: ignore[arg-type]
    except OSError as error:
        raise FileFormatError(f"{path!r} cannot be written: {error.strerror}.") from None
