"""Exact variance of an estimator, without sampling: random, stratified and regular sets.

Prints the variance at each n, and the exponent of variance in n from one to the next.
"""

from __future__ import annotations

import argparse
import math
from typing import Any

import numpy as np

from mcspectra.cli.common import (
    Once,
    add_estimator_arguments,
    build_estimator,
    one_sentence_warnings,
    print_json,
    read_sampler,
    text_table,
    whole_number,
)

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    add_estimator_arguments(parser)
    parser.add_argument(
        "--sampler", action=Once, required=True, metavar="SPEC", help="sampler spec"
    )
    parser.add_argument(
        "-n", required=True, metavar="N,N,…", help="points (of each technique); one or several n"
    )


def run(options: argparse.Namespace) -> int:
    """Integrate and print."""
    from mcspectra.variance.exact import exact_variance

    estimator = build_estimator(options)
    sampler = read_sampler(options.sampler, estimator.dims)
    counts = [whole_number("-n", part.strip()) for part in options.n.split(",")]
    with one_sentence_warnings(options.quiet):
        variances = [np.atleast_1d(exact_variance(estimator, sampler, n)) for n in counts]
    if options.json:
        values: list[Any] = [v if estimator.channels else v[0] for v in variances]
        about = {"estimator": estimator.spec, "sampler": sampler.spec}
        print_json({**about, "n": counts, "exact_variance": values})
    elif not options.quiet:
        print(f"exact variance of {estimator.spec}  with  {sampler.spec}")
        print(text_table(["n", "", "variance", "local rate"], _rows(counts, variances)))
    return 0


def _rows(counts: list[int], variances: list[Any]) -> list[list[str]]:
    """One row a count and channel: variance, and its exponent since the count before."""
    rows = []
    for place, n in enumerate(counts):
        for channel, variance in enumerate(variances[place]):
            label = f"[{channel}]" if len(variances[place]) > 1 else ""
            before = (counts[place - 1], variances[place - 1][channel]) if place else None
            shown = "infinite" if math.isinf(variance) else f"{variance:.9g}"
            rows.append([str(n), label, shown, _local_rate(before, n, variance)])
    return rows


def _local_rate(before: tuple[int, float] | None, n: int, variance: float) -> str:
    if before is None or before[0] == n or min(before[1], variance) <= 0.0:
        return "–"
    if math.isinf(before[1]) or math.isinf(variance):
        return "–"
    return f"{math.log(variance / before[1]) / math.log(n / before[0]):+.4f}"
