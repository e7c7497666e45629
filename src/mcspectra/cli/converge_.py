"""Variance against the number of points, and the fitted rate."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.cli.common import (
    add_estimator_arguments,
    build_estimator,
    counts_option,
    one_sentence_warnings,
    print_json,
    read_sampler,
    real_number,
    seed_option,
    text_table,
    whole_number,
)
from mcspectra.cli.progress import progress_bars
from mcspectra.core.errors import ParameterError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    add_estimator_arguments(parser)
    parser.add_argument(
        "--sampler", action="append", required=True, metavar="SPEC", help="sampler; repeatable"
    )
    parser.add_argument("--counts", required=True, metavar="N,N,…", help="ascending counts")
    parser.add_argument("-m", "--realizations", default=1000, metavar="R", help="default 1000")
    parser.add_argument(
        "--fit-last", metavar="K", help="fit the last K counts only; auto: the longest straight run"
    )
    parser.add_argument(
        "--relative-error",
        metavar="E",
        help="stop at each count once the variance is known to this fraction; -m is then the most",
    )


def run(options: argparse.Namespace) -> int:
    """Measure and print."""
    from mcspectra.variance.convergence import convergence

    estimator = build_estimator(options)
    last = _window(options.fit_last)
    precision = options.relative_error
    with one_sentence_warnings(options.quiet), progress_bars(options.quiet):
        result = convergence(
            estimator,
            [read_sampler(text, estimator.dims) for text in options.sampler],
            counts_option(options.counts),
            realizations=whole_number("--realizations", options.realizations, least=2),
            rng=seed_option(options),
            fit_last=last,
            relative_error=None
            if precision is None
            else real_number("--relative-error", precision),
        )
    if options.json:
        print_json(
            {**result.attrs, "curves": [_curve(result, s) for s in result["sampler"].values]}
        )
    elif not options.quiet:
        print(_text(result))
    return 0


def _window(given: str | None) -> int | str | None:
    if given is None or given == "auto":
        return given
    try:
        return whole_number("--fit-last", given, least=2)
    except ParameterError:
        raise ParameterError(
            f"--fit-last is {given!r}; give a whole number of at least 2, or auto."
        ) from None


def _curve(result: xr.Dataset, sampler: Any) -> dict[str, Any]:
    """All variables of one sampler's curve."""
    picked = result.sel(sampler=sampler)
    values = {str(name): variable.values for name, variable in picked.data_vars.items()}
    return {"sampler": str(sampler), "n": result["n"].values, **values}


def _text(result: xr.Dataset) -> str:
    """One row a sampler (and channel): variances, rate ± half its interval, window and lack of fit."""
    counts = [f"n = {n}" for n in result["n"].values]
    header = ["sampler", "", *counts, "rate", "±", "fit from n", "χ²/dof"]
    several = result.sizes.get("channel", 1) > 1
    rows = []
    for sampler in result["sampler"].values:
        curve = result.sel(sampler=sampler)
        channels = [curve.isel(channel=c) for c in range(curve.sizes.get("channel", 0))] or [curve]
        for channel, picked in enumerate(channels):
            values = [f"{v:.4g}" for v in picked["variance"].values]
            label = f"[{channel}]" if several else ""
            rows.append([str(sampler), label, *values, *_fit(picked)])
    lines = [f"variance of {result.attrs['estimator']}", text_table(header, rows)]
    notes = [result.attrs["note"]] if "note" in result.attrs else []
    return "\n".join([*lines, *_unreached(result), *notes])


def _fit(curve: xr.Dataset) -> list[str]:
    """Rate, half its interval, smallest count of the fit and lack of fit; dashes for what is not."""
    low, high = curve["rate_ci"].values
    rate, first, chi2 = (float(curve[name]) for name in ("rate", "fit_first_n", "fit_chi2"))
    if not np.isfinite(rate):
        return ["–"] * 4
    shown = [f"{rate:+.3f}", f"{(high - low) / 2:.3f}", f"{first:.0f}"]
    return [*shown, f"{chi2:.3g}" if np.isfinite(chi2) else "–"]


def _unreached(result: xr.Dataset) -> Iterator[str]:
    """A line for each sampler about the counts at which the wanted precision was not reached."""
    if "reached" not in result:
        return
    for sampler in result["sampler"].values:
        missed = result["n"].values[result["reached"].sel(sampler=sampler).values == 0]
        if missed.size:
            goal, most = result.attrs["relative_error"], result.attrs["realizations"]
            yield (
                f"{sampler}: the relative error {goal:g} was not reached with {most} realisations "
                f"at n = {', '.join(map(str, missed))}"
            )
