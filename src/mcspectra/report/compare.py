"""Comparison of two studies: ratios of variances, differences of rates, and curves in one plot."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
import xarray as xr

from mcspectra.core.checks import as_path
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.core.display import counted
from mcspectra.core.errors import ParameterError
from mcspectra.estimators.moments import Measured
from mcspectra.plots import kinds
from mcspectra.plots.text import MISSING, interval, number, rate, typeset
from mcspectra.report import page as html
from mcspectra.report.study import collect, provenance
from mcspectra.report.tables import first_channel
from mcspectra.studies import open_results
from mcspectra.studies.results import showing

__all__ = ["COMPARISON_NAME", "Difference", "compare_curves", "verdict", "write_comparison"]

COMPARISON_NAME = "comparison.html"

Curves = dict[tuple[str, str], "xr.Dataset"]


class Difference(NamedTuple):
    """Difference of two results with 95 % intervals; unknown values are NaN.

    Parameters
    ----------
    n
        Largest count that both results have, or None.
    ratio
        Variance of the second result divided by the variance of the first, at `n`.
    rate
        Rate of the second result minus the rate of the first result.
    """

    n: int | None
    ratio: Measured
    rate: Measured


def compare_curves(first: xr.Dataset, second: xr.Dataset) -> Difference:
    """Compare the first channels of two `convergence` results, treated as independent."""
    one, other = first_channel(first), first_channel(second)
    shared = np.intersect1d(one["n"].values, other["n"].values)
    n, ratio = None, Measured(math.nan, math.nan, math.nan)
    if shared.size:
        n = int(shared[-1])
        before, after = (Measured.of(each.sel(n=n), "variance") for each in (one, other))
        ratio = after / before
    return Difference(n, ratio, Measured.of(other, "rate") - Measured.of(one, "rate"))


def verdict(first: Curves, second: Curves) -> str:
    """Return sentences that say where the second study has significantly less or more noise.

    A ratio of variances differs significantly from 1 if its interval does not contain 1.
    The intervals hold simultaneously for all pairs in both studies [Sidak1967]_.
    """
    both = [pair for pair in first if pair in second]
    same = [pair for pair in both if first[pair]["variance"].equals(second[pair]["variance"])]
    found = {pair: compare_curves(first[pair], second[pair]) for pair in both if pair not in same}
    found = {pair: each for pair, each in found.items() if math.isfinite(each.ratio.high)}
    if not both:
        return "A and B have no curve in common, so there is no verdict."
    wider = NormalDist().inv_cdf(0.5 + 0.5 * 0.95 ** (1.0 / max(len(found), 1))) / CONFIDENCE_Z
    ends = {
        pair: [
            each.ratio.value * (end / each.ratio.value) ** wider
            for end in (each.ratio.low, each.ratio.high)
        ]
        for pair, each in found.items()
    }
    less = [pair for pair, (_, high) in ends.items() if high < 1.0]
    more = [pair for pair, (low, _) in ends.items() if low > 1.0]
    open_ = len(found) - len(less) - len(more)
    unknown = len(both) - len(found) - len(same)
    counts = [
        f"{count} {what}"
        for count, what in (
            (len(less), "less noise"),
            (len(more), "more noise"),
            (open_, "no significant difference"),
            (len(same), "the same variances"),
            (unknown, "no ratio"),
        )
        if count
    ]
    if len(same) == len(both):
        text = "A and B have the same variances"
    elif not (less or more):
        text = "No difference between the noise of A and B is significant"
    elif not more:
        text = "B has less noise than A"
    elif not less:
        text = "B has more noise than A"
    else:
        text = "B has less noise than A for some curves and more for others"
    if open_ == len(both):
        text += f" ({counted(len(both), 'common curve')})."
    else:
        text += f". Of {counted(len(both), 'common curve')}: {', '.join(counts)}."
    for pairs, what, best in ((less, "largest gain", min), (more, "largest loss", max)):
        if pairs:
            name, sampler = pair = best(pairs, key=lambda each: found[each].ratio.value)
            each, (low, high) = found[pair], ends[pair]
            text += (
                f" The {what}: the variance of {name} with {sampler} at n = {each.n} is "
                f"{number(each.ratio.value, 3)} times the variance in A "
                f"({interval(low, high, 3)})."
            )
    return text


def write_comparison(first: str | Path, second: str | Path, out: str | Path | None = None) -> Path:
    """Write a page that compares two studies for every estimator and sampler in both studies.

    Parameters
    ----------
    first, second
        Folders of results (with ``results.zarr``).
    out
        Path of the page. Default: ``comparison.html`` in `second`.

    Returns
    -------
    Path
        Path of the page.

    Raises
    ------
    StoreError
        If a folder has no results, or the page cannot be written.
    ParameterError
        If both folders are the same, or if an argument is not a path.
    MissingDependency
        If the extra ``report`` is not installed.
    """
    html.check_page_packages()
    folders = [as_path("first", first), as_path("second", second)]
    file = html.page_file(folders[1], COMPARISON_NAME, out)
    if folders[0].resolve() == folders[1].resolve():
        raise ParameterError(
            f"Both folders are {str(first)!r}; give two different ones to compare."
        )
    with showing(" or ".join(map(str, folders))):
        return _written(folders, file, str(second))


def _written(folders: list[Path], file: Path, second: str) -> Path:
    """Write the page that compares the results in two folders to `file`."""
    trees = [open_results(folder) for folder in folders]
    curves: list[Curves] = [
        {
            (each.name, sampler): data
            for each in collect(tree)
            for sampler, data in each.analyses.get("convergence", {}).items()
        }
        for tree in trees
    ]
    command = shlex.join(["mcspectra", "report", *map(str, folders[:1]), "--compare", second])
    origins: list[html.Block] = []
    for letter, tree, folder in zip("AB", trees, folders, strict=True):
        origins += [
            html.Paragraph(text=letter, kind="heading"),
            html.FactList(rows=provenance(tree, folder)),
        ]
    titles = [str((tree.attrs.get("study") or {}).get("title", "Results")) for tree in trees]
    named = [
        html.markup("{} (<code>{}</code>)", title, str(folder))
        for title, folder in zip(titles, folders, strict=True)
    ]
    facts = zip("AB", named, strict=True)
    page = html.Page(
        title="Comparison",
        what=f"comparison of {titles[0]} and {titles[1]}",
        lead=(
            html.Paragraph(text=typeset(verdict(*curves)), kind="answer"),
            html.FactList(rows=tuple(facts)),
        ),
        sections=html.sections_of(
            {
                "Side by side": tuple(_side_by_side(*curves)),
                "Provenance": (
                    *origins,
                    html.FactList(rows=(("To reproduce", command),), code=True),
                ),
            }
        ),
    )
    return html.write_page(page, file)


def _side_by_side(first: Curves, second: Curves) -> Iterator[html.Block]:
    """Yield a table and plots of the set-ups that both studies have.

    Also yield lists of the set-ups that only one study has.
    """
    both = [pair for pair in first if pair in second]
    if both:
        yield html.table_of(
            "Ratio: variance of B divided by variance of A at the largest common n. Below 1, B has "
            "less noise. Difference: rate of B minus rate of A. If it is negative, the variance of "
            "B falls faster. The 95 % intervals assume independent results; they are too wide if "
            "both studies used the same seed. Each interval holds for its row alone; the sentence "
            "at the top uses wider intervals, which hold for all rows together.",
            (
                "Estimator",
                "Sampler",
                "n",
                "Variance A",
                "Variance B",
                "Ratio B/A",
                "95 % interval",
                "Rate A",
                "Rate B",
                "Difference B − A",
            ),
            [_row(pair, first[pair], second[pair]) for pair in both],
            words=(0, 1),
            heads=2,
            sortable=True,
        )
    else:
        yield html.Paragraph(text="The studies share no estimator and sampler with a convergence.")
    plots = []
    for estimator in dict.fromkeys(name for name, _ in both):
        overlay = {
            f"{letter}: {sampler}": curves[name, sampler]
            for name, sampler in both
            if name == estimator
            for letter, curves in (("A", first), ("B", second))
        }
        plot = kinds.describe("convergence", overlay)
        plots.append(replace(plot, caption=f"{estimator}. {plot.caption}"))
    yield from html.figures_of(plots, live=True)
    for letter, mine in (("A", first), ("B", second)):
        lines = [
            f"{estimator}, with {sampler}"
            for estimator, sampler in mine
            if (estimator, sampler) not in both
        ]
        if lines:
            yield html.Paragraph(text=f"Only in {letter}: {'; '.join(lines)}.")


def _row(
    pair: tuple[str, str], first: xr.Dataset, second: xr.Dataset
) -> tuple[str | html.TableCell, ...]:
    cell = partial(html.number_cell, why="not available in both studies")
    found = compare_curves(first, second)
    variances = [
        math.nan if found.n is None else float(first_channel(each)["variance"].sel(n=found.n))
        for each in (first, second)
    ]
    slopes = [Measured.of(first_channel(each), "rate") for each in (first, second)]
    return (
        *pair,
        cell(MISSING if found.n is None else str(found.n), found.n),
        *(cell(number(v), v) for v in variances),
        cell(number(found.ratio.value), found.ratio.value),
        cell(interval(found.ratio.low, found.ratio.high)),
        *(cell(rate(s.value, s.low, s.high), s.value) for s in (*slopes, found.rate)),
    )
