"""Variance against the number of points, and the fitted rate."""

from __future__ import annotations

import argparse
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
    last: Any = options.fit_last
    if last not in (None, "auto"):
        last = whole_number("--fit-last", last, least=2)
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


def _curve(result: xr.Dataset, sampler: Any) -> dict[str, Any]:
    picked = result.sel(sampler=sampler)
    names = ("variance", "variance_ci", "mean", "mean_se", "bias", "rate", "rate_ci")
    return {
        "sampler": str(sampler),
        "n": result["n"].values,
        **{name: picked[name].values for name in names},
    }


def _text(result: xr.Dataset) -> str:
    """One row a sampler (and channel): variances, then rate ± half its interval."""
    header = ["sampler", "", *(f"n = {n}" for n in result["n"].values), "rate", "±"]
    rows = []
    channels = range(result.sizes.get("channel", 1))
    for sampler in result["sampler"].values:
        for channel in channels:
            picked = result.sel(sampler=sampler)
            if "channel" in picked.dims:
                picked = picked.isel(channel=channel)
            low, high = picked["rate_ci"].values
            label = f"[{channel}]" if len(channels) > 1 else ""
            values = [f"{v:.4g}" for v in picked["variance"].values]
            rate = float(picked["rate"])
            shown = [f"{rate:+.3f}", f"{(high - low) / 2:.3f}"] if np.isfinite(rate) else ["–", "–"]
            rows.append([str(sampler), label, *values, *shown])
    return f"variance of {result.attrs['estimator']}\n{text_table(header, rows)}"
