"""What would lower the noise of an estimator at a budget of evaluations, and why."""

from __future__ import annotations

import argparse
import json
import textwrap
from typing import TYPE_CHECKING, Any

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
from mcspectra.core.checks import as_choice

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["add_arguments", "run"]

_VALUES = (
    "kind",
    "change",
    "error",
    "error_ci",
    "error_ratio",
    "error_ratio_ci",
    "verdict",
    "rate",
    "rate_ci",
    "rate_difference",
    "rate_difference_ci",
    "rate_verdict",
    "rank_by_rate",
    "reason",
    "cost",
    "error_at_cost",
)
_WIDTH = 100


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    add_estimator_arguments(parser)
    parser.add_argument(
        "--sampler", action=Once, required=True, metavar="SPEC", help="sampler as it is used now"
    )
    parser.add_argument(
        "--budget", required=True, metavar="B", help="evaluations of the integrand an estimate"
    )
    parser.add_argument("-m", "--realizations", default=1000, metavar="R", help="default 1000")
    parser.add_argument(
        "--kind", action="append", metavar="KIND", help="changes to try; repeatable, default all"
    )


def run(options: argparse.Namespace) -> int:
    """Measure, rank and print."""
    from mcspectra.variance.counterfactuals import KINDS
    from mcspectra.variance.remedies import remedies

    kinds = options.kind and [as_choice("--kind", kind, tuple(KINDS)) for kind in options.kind]
    estimator = build_estimator(options)
    with one_sentence_warnings(options.quiet), progress_bars(options.quiet):
        result = remedies(
            estimator,
            read_sampler(options.sampler, estimator.dims),
            whole_number("--budget", options.budget),
            realizations=whole_number("--realizations", options.realizations, least=100),
            rng=seed_option(options),
            kinds=kinds,
        )
    if options.json:
        print_json({**result.attrs, "remedies": [_row(result, r) for r in result["remedy"].values]})
    elif not options.quiet:
        print(_text(result))
    return 0


def _row(result: xr.Dataset, remedy: Any) -> dict[str, Any]:
    picked = result.sel(remedy=remedy)
    return {"remedy": str(remedy), **{name: picked[name].values for name in _VALUES}}


def _text(result: xr.Dataset) -> str:
    """A table in the order of the errors, then the sentences."""
    attrs = result.attrs
    header = ["remedy", "", "error", "ratio", "95 %", "rate", "95 %"]
    rows = []
    for name in result["remedy"].values:
        row = _row(result, name)
        rows.append(
            [
                row["remedy"],
                str(row["verdict"]),
                f"{row['error']:.4g}",
                f"{row['error_ratio']:.3g}",
                "{:.3g} … {:.3g}".format(*row["error_ratio_ci"]),
                f"{row['rate']:.2f}",
                "{:.2f} … {:.2f}".format(*row["rate_ci"]),
            ]
        )
    about = f"{attrs['estimator']}  with  {attrs['sampler']},  {attrs['budget']} evaluations"
    sentences = (attrs["diagnosis"], attrs["recommendation"])
    paragraphs = [textwrap.fill(text, _WIDTH) for text in sentences if text]
    left_out = json.loads(attrs["not_tried"]) if "not_tried" in attrs else []
    if left_out:
        paragraphs.append("not tried:")
        paragraphs += [
            textwrap.fill(reason, _WIDTH, initial_indent="  ", subsequent_indent="    ")
            for reason in left_out
        ]
    return "\n".join([about, text_table(header, rows), *paragraphs])
