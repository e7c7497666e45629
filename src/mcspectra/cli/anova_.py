"""Which axes the variance of an estimator comes from: parts by subsets, effective dimension."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

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

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["add_arguments", "run"]

_ROUNDING = 1e-14  # of the variance: sums of terms that cancel
_NUMBERS = (
    "variance",
    "mean_dimension",
    "effective_dimension_truncation",
    "effective_dimension_superposition",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    add_estimator_arguments(parser)
    parser.add_argument(
        "--sampler",
        action=Once,
        metavar="SPEC",
        help="sampler spec (default random: with one point, the parts of the integrand itself)",
    )
    parser.add_argument("-n", default=1, metavar="N", help="points (of each technique; default 1)")
    parser.add_argument("-m", "--realizations", default=10_000, metavar="R", help="default 10000")
    parser.add_argument(
        "--order", default=2, metavar="S", help="list subsets of up to 1 or 2 axes (default 2)"
    )


def run(options: argparse.Namespace) -> int:
    """Analyse and print."""
    from mcspectra.variance.anova import anova_variances

    estimator = build_estimator(options)
    with one_sentence_warnings(options.quiet), progress_bars(options.quiet):
        result = anova_variances(
            estimator,
            read_sampler(options.sampler or "random", estimator.dims),
            whole_number("-n", options.n),
            order=whole_number("--order", options.order, most=2),
            realizations=whole_number("--realizations", options.realizations, least=2),
            rng=seed_option(options),
        )
    if options.json:
        print_json(_data(result))
    elif not options.quiet:
        print(_text(result))
    return 0


def _data(result: xr.Dataset) -> dict[str, Any]:
    names = [str(name) for name in result.data_vars]
    labels = {"subset": result["subset_label"].values}
    return {**result.attrs, **labels, **{name: result[name].values for name in names}}


def _text(result: xr.Dataset) -> str:
    attrs = result.attrs
    lines = [f"{attrs['estimator']}  with  {attrs['sampler']},  n = {attrs['n']}"]
    for channel in range(result.sizes.get("channel", 1)):
        one = result.isel(channel=channel) if "channel" in result.dims else result
        lines += [f"channel {channel}"] if "channel" in result.dims else []
        lines += [
            _table(one),
            *(f"{_words(name)}: {_number(one, name, attrs['order'])}" for name in _NUMBERS),
        ]
    return "\n".join(lines)


def _table(one: xr.Dataset) -> str:
    """Rows of subsets, then what larger ones have."""
    names = ("anova_variance", "anova_variance_se", "anova_share")
    columns = (one[name].values for name in ("subset_label", *names))
    floor = _ROUNDING * float(one["variance"])
    rows = [[str(u), "", *_cells(values, floor)] for u, *values in zip(*columns, strict=True)]
    rest = [float(one[f"higher_order_variance{end}"]) for end in ("", "_se")]
    share = 1.0 - float(np.sum(one["anova_share"].values))
    rows.append(["larger subsets", "", *_cells([*rest, share], floor)])
    return text_table(["axes", "", "variance", "std. error", "share"], rows)


def _words(name: str) -> str:
    return name.replace("_", " ")


def _number(one: xr.Dataset, name: str, order: int) -> str:
    """A number; where there is a variance but too much of it in larger subsets, what is known."""
    value = float(one[name])
    if np.isfinite(value):
        return f"{value:.6g}"
    varies = np.isfinite(float(one["mean_dimension"]))
    return f"more than {order}" if varies and name.endswith("superposition") else "undefined"


def _cells(values: Sequence[float], floor: float) -> list[str]:
    """Variance, standard error and share; 0 below the floor of rounding."""
    return [_shown(v, f) for v, f in zip(values, (floor, floor, _ROUNDING), strict=True)]


def _shown(value: float, floor: float) -> str:
    if abs(value) < floor:
        return "0"
    return f"{value:.5g}" if np.isfinite(value) else "undefined"
