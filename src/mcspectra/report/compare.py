"""Two studies side by side: ratios of variances, differences of rates, curves over each other."""

from __future__ import annotations

import base64
import math
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from mcspectra.core.errors import ParameterError
from mcspectra.estimators.moments import CONFIDENCE_Z
from mcspectra.report import figures
from mcspectra.report.collect import collect
from mcspectra.report.embed import bokeh_script, packed_plot
from mcspectra.report.encode import encode
from mcspectra.report.formatting import MISSING, interval, number, rate
from mcspectra.report.html import page_template, provenance, replace_page, writing
from mcspectra.report.interactive import alt_text, convergence_plot
from mcspectra.report.sections import Image
from mcspectra.report.style import sampler_styles
from mcspectra.report.tables import Cell, Table
from mcspectra.studies import open_results

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["COMPARISON_NAME", "Difference", "compare_curves", "write_comparison"]

COMPARISON_NAME = "comparison.html"

Curves = dict[tuple[str, str], "xr.Dataset"]


@final
@dataclass(frozen=True, kw_only=True)
class Difference:
    """Second result over (or minus) the first, with 95 % intervals; NaN where there is none.

    Parameters
    ----------
    n
        The largest count that both have; None where they share none.
    ratio, ratio_low, ratio_high
        Variance of the second over that of the first at `n`.
    rate, rate_low, rate_high
        Rate of the second minus that of the first.
    """

    n: int | None
    ratio: float
    ratio_low: float
    ratio_high: float
    rate: float
    rate_low: float
    rate_high: float


def compare_curves(first: xr.Dataset, second: xr.Dataset) -> Difference:
    """Compare two results of `convergence` (of several channels the first) as independent ones.

    The logarithm of a variance and a rate are taken as normal, their standard errors from the
    results' own intervals.
    """
    pair = [d.isel(channel=0) if "channel" in d.dims else d for d in (first, second)]
    shared = np.intersect1d(pair[0]["n"].values, pair[1]["n"].values)
    n = int(shared[-1]) if shared.size else None
    log_ratio = log_half = math.nan
    if n is not None:
        log_ratio, log_half = _log_ratio(*(_log_variance(each.sel(n=n)) for each in pair))
    slope, half = _minus(*(_rate_and_half(each) for each in pair))
    return Difference(
        n=n,
        ratio=math.exp(log_ratio),
        ratio_low=math.exp(log_ratio - log_half),
        ratio_high=math.exp(log_ratio + log_half),
        rate=slope,
        rate_low=slope - half,
        rate_high=slope + half,
    )


def write_comparison(first: str | Path, second: str | Path, out: str | Path | None = None) -> Path:
    """Write a page that compares the results of two studies, pair by pair of equal names.

    Parameters
    ----------
    first, second
        Folders of results (with ``results.zarr``).
    out
        The page; ``comparison.html`` in `second` by default.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    StoreError
        There are no results in a folder, or the page cannot be written.
    ParameterError
        Both folders are the same.
    """
    if Path(first).resolve() == Path(second).resolve():
        raise ParameterError(
            f"Both folders are {str(first)!r}; give two different ones to compare."
        )
    trees = [open_results(folder) for folder in (first, second)]
    curves = [_curves(tree) for tree in trees]
    page = Path(second) / COMPARISON_NAME if out is None else Path(out)
    with writing(page):
        replace_page(page, _page([Path(first), Path(second)], trees, curves))
    return page


def _curves(tree: xr.DataTree) -> Curves:
    """Results of `convergence` by estimator and sampler, in the study's order."""
    return {
        (group.name, sampler): data
        for group in collect(tree)
        for sampler, data in group.having("convergence").items()
    }


def _page(folders: list[Path], trees: list[xr.DataTree], curves: list[Curves]) -> str:
    both = [pair for pair in curves[0] if pair in curves[1]]
    titles = [str((tree.attrs.get("study") or {}).get("title", "Results")) for tree in trees]
    return page_template("compare.html.j2").render(
        titles=titles,
        folders=[str(folder) for folder in folders],
        table=_table(both, *curves) if both else None,
        pictures=list(_pictures(both, *curves)),
        only=[[pair for pair in mine if pair not in both] for mine in curves],
        origins=[provenance(*each) for each in zip(trees, folders, strict=True)],
        command=shlex.join(["mcspectra", "report", str(folders[0]), "--compare", str(folders[1])]),
        bokeh=bokeh_script() if both else "",
    )


def _table(both: list[tuple[str, str]], first: Curves, second: Curves) -> Table:
    return Table(
        caption="Ratio: variance of B over that of A at the largest common n; below 1, B has less "
        "noise. Difference: rate of B minus rate of A; negative, B falls faster. Intervals are 95 %, "
        "of the two as independent: too wide where both used the same seed.",
        columns=(
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
        rows=tuple(_row(pair, first[pair], second[pair]) for pair in both),
        heads=2,
    )


def _row(pair: tuple[str, str], first: xr.Dataset, second: xr.Dataset) -> tuple[Cell, ...]:
    found = compare_curves(first, second)
    variances = [_variance_at(each, found.n) for each in (first, second)]
    slopes = [_rate_and_half(each) for each in (first, second)]
    return (
        Cell(text=pair[0], numeric=False),
        Cell(text=pair[1], numeric=False),
        _cell(MISSING if found.n is None else str(found.n), found.n),
        *(_cell(number(v), v) for v in variances),
        _cell(number(found.ratio), found.ratio),
        _cell(interval(found.ratio_low, found.ratio_high), None),
        *(_cell(rate(s, s - half, s + half), s) for s, half in slopes),
        _cell(rate(found.rate, found.rate_low, found.rate_high), found.rate),
    )


def _cell(text: str, order: float | None) -> Cell:
    known = order is not None and math.isfinite(order)
    why = "the two have no such number in common" if text == MISSING else ""
    return Cell(text=text, why=why, order=order if known else None)


def _pictures(both: list[tuple[str, str]], first: Curves, second: Curves) -> Iterator[Image]:
    """Draw a plot for each estimator: A's and B's curves of every common sampler."""
    for estimator in dict.fromkeys(name for name, _ in both):
        samplers = [sampler for name, sampler in both if name == estimator]
        group: Mapping[str, Any] = {
            f"{which}: {sampler}": curves[estimator, sampler]
            for sampler in samplers
            for which, curves in (("A", first), ("B", second))
        }
        yield _picture(estimator, group)


def _picture(estimator: str, group: Mapping[str, Any]) -> Image:
    """A plot, and the picture that stands for it without scripts and on paper."""
    styles = sampler_styles(list(group))
    plot = convergence_plot(group, styles=styles)
    png, _ = encode(figures.convergence_curves(group, styles=styles))
    return Image(
        caption=estimator,
        plot=packed_plot(plot),
        plot_alt=alt_text(plot),
        data=base64.b64encode(png).decode("ascii"),
        # Bytes 16 to 24 of a PNG are its width and height.
        width=int.from_bytes(png[16:20], "big"),
        height=int.from_bytes(png[20:24], "big"),
        alt=alt_text(plot),
    )


def _variance_at(data: xr.Dataset, n: int | None) -> float:
    one = data.isel(channel=0) if "channel" in data.dims else data
    return math.nan if n is None else float(one["variance"].sel(n=n))


def _log_variance(at: xr.Dataset) -> tuple[float, float]:
    """Logarithm of a variance and its standard error; NaN where the variance is not positive."""
    value = float(at["variance"])
    low, high = (float(end) for end in at["variance_ci"].values)
    if not (value > 0 and low > 0 and math.isfinite(high)):
        return math.nan, math.nan
    return math.log(value), math.log(high / low) / (2 * CONFIDENCE_Z)


def _log_ratio(first: tuple[float, float], second: tuple[float, float]) -> tuple[float, float]:
    """Logarithm of second over first, and half its 95 % interval."""
    return second[0] - first[0], CONFIDENCE_Z * math.hypot(first[1], second[1])


def _rate_and_half(data: xr.Dataset) -> tuple[float, float]:
    """Rate and half its 95 % interval."""
    one = data.isel(channel=0) if "channel" in data.dims else data
    low, high = (float(end) for end in one["rate_ci"].values)
    return float(one["rate"]), 0.5 * (high - low)


def _minus(first: tuple[float, float], second: tuple[float, float]) -> tuple[float, float]:
    """Second minus first, and half the interval of independent ones."""
    return second[0] - first[0], math.hypot(first[1], second[1])
