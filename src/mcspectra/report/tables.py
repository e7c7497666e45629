"""Tables of a report: the summary, the three terms, and a table for each of the other analyses."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from mcspectra.core.analysis import ANALYSES
from mcspectra.core.checks import as_instances
from mcspectra.core.errors import McspectraError, ParameterError
from mcspectra.plots.groups import along, labelled, method_of
from mcspectra.plots.text import (
    MISSING,
    SUBSCRIPTS,
    interval,
    number,
    percent,
    rate,
    with_error,
)
from mcspectra.report.page import Table, TableCell, number_cell, table_of
from mcspectra.report.sentences import basis_name, bottleneck, headline
from mcspectra.studies import SummaryRow

__all__ = ["analysis_table", "first_channel", "summary_of", "summary_table", "terms_table"]

_CERTAIN = 2e-6  # if an interval has a smaller relative width, its value is shown with six digits
_NO_CURVE = "convergence was not analyzed"
_NO_TERMS = "neither terms nor a prediction was analyzed"
_NO_RATE = "fewer than two counts have a variance above rounding noise"
_NO_NUMBER = "the value is not finite"
_ROW = "a row of mcspectra.studies.summarize"
_DRAWN = (
    "convergence",
    "terms",
    "spectrum",
    "points",
    "pcf",
)  # analyses whose results are shown as figures, without a table of their own

Rows = Iterator[Sequence[str | TableCell]]
Analyses = Mapping[str, Any]


def summary_table(
    rows: Sequence[SummaryRow],
    *,
    analyses: Sequence[Analyses] | None = None,
    links: Sequence[str] | None = None,
) -> Table:
    """Return the summary table with one row per estimator and sampler.

    Parameters
    ----------
    rows
        Summary of each pair of estimator and sampler.
    analyses
        Results of all analyses for each row, restricted to the channel of the row.
        The column of bottlenecks is derived from these results.
    links
        Address of a hyperlink on the estimator in each row. Default: no links.

    Raises
    ------
    ParameterError
        If an argument is not a list of the required type, or the lists differ in length.
    """
    cells, rows = [], as_instances("rows", rows, SummaryRow, _ROW)
    found = as_instances(
        "analyses", [{}] * len(rows) if analyses is None else analyses, Mapping, "a mapping"
    )
    links = as_instances("links", [""] * len(rows) if links is None else links, str, "a text")
    if not len(rows) == len(found) == len(links):
        raise ParameterError(
            f"There are {len(rows)} rows, {len(found)} analyses and {len(links)} links; give the "
            "same number of each."
        )
    counts = Counter(row.n for row in rows if row.n is not None)
    usual = counts.most_common(1)[0][0] if counts else None
    for row, of_row, link in zip(rows, found, links, strict=True):
        terms, no_term = of_row.get("terms"), row.note or _NO_TERMS
        no_number = _NO_CURVE if row.n is None else _NO_NUMBER
        variance = number(row.variance)
        at = f" (n = {row.n})" if row.n not in (None, usual) and variance != MISSING else ""
        method = basis_name(row.method) if row.method else ""
        predicted = with_error(row.ratio, _half(row.ratio_low, row.ratio_high))
        techniques = of_row.get("techniques")
        slow = "" if techniques is None else str(techniques.attrs.get("bottleneck") or "")
        limit = bottleneck(row, terms, slow)
        cells.append(
            (
                TableCell(text=row.estimator, numeric=False, link=link),
                row.sampler,
                number_cell(
                    rate(row.rate, row.rate_low, row.rate_high),
                    row.rate,
                    why=_NO_CURVE if row.n is None else _NO_RATE,
                ),
                number_cell(variance + at, row.variance, why=no_number),
                number_cell(
                    f"{predicted} ({method})" if method else predicted, row.ratio, why=no_term
                ),
                TableCell(text=limit or MISSING, why="" if limit else no_term, numeric=False),
                headline(row, terms, len(rows)),
            )
        )
    return table_of(
        "Rates are exponents of variance in n (random sampling: −1), ± half their 95 % interval; "
        "unresolved if that exceeds 0.5. "
        "Predicted / measured has ± half its 95 % interval and the prediction method in brackets; "
        "the name of a basis means a sum over frequencies up to a half width. The bottleneck is "
        "the technique with the slowest rate (undecided: the intervals overlap), or else the "
        "largest term; |m| ≤ k or |m| ≥ k means that half of the power term is below or above the "
        "frequency k.",
        (
            "Estimator",
            "Sampler",
            "Rate",
            "Variance" if usual is None else f"Variance at n = {usual}",
            "Predicted / measured",
            "Bottleneck",
            "In words",
        ),
        cells,
        words=(0, 1, -1),
        heads=2,
        sortable=True,
    )


def terms_table(rows: Sequence[SummaryRow]) -> Table:
    """Return a table of the three terms of one estimator and its measured variance.

    Raises
    ------
    ParameterError
        If `rows` is not a list of summary rows.
    """
    cells = []
    every = as_instances("rows", rows, SummaryRow, _ROW)
    for row in (each for each in every if each.terms_n is not None):
        why = row.note or _NO_NUMBER

        values = (
            (row.dc, row.dc_low, row.dc_high),
            (row.power, row.power_low, row.power_high),
            (row.cross, row.cross_low, row.cross_high),
            (row.predicted, None, None),
            (row.measured, None, None),
        )
        captured = with_error(row.captured, _half(row.captured_low, row.captured_high))
        # `summarize` appends the channel to the estimator's name
        head, bracket, channel = row.estimator.rpartition(" [")
        several = bool(head and bracket and channel.rstrip("]").isdigit())
        name = f"{row.sampler}, channel {channel.rstrip(']')}" if several else row.sampler
        cells.append(
            (
                name,
                str(row.terms_n),
                *(
                    number_cell(with_error(value, _half(low, high), row.power), why=why)
                    for value, low, high in values
                ),
                number_cell(interval(row.measured_low, row.measured_high), why=why),
                number_cell(captured, why=why),
            )
        )
    return table_of(
        "Sum: dc + power + cross over the frequencies up to the half width. Captured: the sum "
        "divided by the measured variance. The terms show which frequencies cause the variance; "
        "they are not the prediction. Values have ± half their 95 % interval; the column 95 % "
        "interval belongs to the measured variance.",
        ("Sampler", "n", "dc", "power", "cross", "Sum", "Measured", "95 % interval", "Captured"),
        cells,
    )


def analysis_table(analysis: str, found: Mapping[str, xr.Dataset]) -> tuple[str, Table] | None:
    """Return the heading and table of an analysis by sampler, or None if it has only figures."""
    if analysis in _DRAWN:
        return None
    made = _TABLES.get(analysis) or (summary_of(analysis).removesuffix("."), *_OF_ANYTHING)
    heading, caption, columns, words, rows = made
    cells = [row for sampler, data in found.items() for row in rows(sampler, data)]
    heads, stacked = 1 if analysis in _TABLES else 2, analysis == "remedies"
    if not cells:
        return None
    return heading, table_of(caption, columns, cells, words=words, heads=heads, stacked=stacked)


def summary_of(analysis: str) -> str:
    """Return the summary of an analysis, or its name if the package that defines it is missing."""
    try:
        return str(ANALYSES.load(analysis).summary())
    except McspectraError:
        return f"{analysis.capitalize()}."


def first_channel(data: xr.Dataset) -> xr.Dataset:
    """Return the first channel of a result if it has channels, or else the result."""
    return data.isel(channel=0) if "channel" in data.dims else data


def _remedies(sampler: str, data: xr.Dataset) -> Rows:
    found = labelled(data)
    for name in found["remedy"].values:
        one = found.sel(remedy=name)
        yield (
            sampler,
            str(name),
            number(float(one["error"])),
            number(float(one["error_ratio"])),
            interval(*_ends(one["error_ratio_ci"])),
            rate(float(one["rate"]), *_ends(one["rate_ci"])),
            str(one["verdict"].item()),
            str(one["change"].item()),
        )


def _techniques(sampler: str, data: xr.Dataset) -> Rows:
    several = data.sizes.get("n", 1) > 1
    last = data.isel(n=-1) if "n" in data.sizes else data
    total = float(last["measured_variance"].sum())
    for t in range(data.sizes["technique"]):
        one = last.isel(technique=t)
        variance, slope = float(one["technique_variance"].sum()), MISSING
        if several and "technique_rate" in one:
            rates = first_channel(one[["technique_rate", "technique_rate_ci"]])
            slope = rate(float(rates["technique_rate"]), *_ends(rates["technique_rate_ci"]))
        share = percent(variance / total) if total > 0 and np.isfinite(variance) else MISSING
        slow = str(data.attrs.get("bottleneck", MISSING))
        yield sampler, str(t), number(variance), share, slope, slow


def _anova(sampler: str, data: xr.Dataset) -> Rows:
    labels, shares = data.attrs["labels_subset_label"], data["anova_share"]
    mean = shares.mean("channel") if "channel" in shares.dims else shares
    for i in np.argsort(-mean.values)[:10]:
        axes = labels[i].translate(SUBSCRIPTS)  # the name x0x1 in the store is shown as x₀x₁
        yield sampler, axes, percent(float(mean.values[i]))


def _predict(sampler: str, data: xr.Dataset) -> Rows:
    for _, each in along(first_channel(labelled(data)), "method"):
        rates = [number(float(each[name])) for name in ("predicted_rate", "limit_rate", "bend_n")]
        for k, n in enumerate(each["n"].values):
            one = each.isel(n=k)
            value, (low, high) = (
                float(one["predicted_variance"]),
                _ends(one["predicted_variance_ci"]),
            )
            certain = high - low <= _CERTAIN * value
            why = str(one["how"].item()) if math.isnan(value) else ""
            yield (
                sampler,
                str(n),
                TableCell(text=number(value, 6 if certain else 3), why=why),
                interval(low, high),
                method_of(one),
                *rates,
            )


def _map(sampler: str, data: xr.Dataset) -> Rows:
    slow = data["bottleneck"].values if "bottleneck" in data else np.array([])
    where = f"light {(slow == 0).sum()}, BSDF {(slow == 1).sum()}" if slow.size else MISSING
    for i, strategy in enumerate(data.attrs["labels_strategy"]):
        one = data.isel(strategy=i)
        slope, error, variance = (
            float(np.median(known)) if (known := v[np.isfinite(v)]).size else math.nan
            for v in (one["rate"].values, one["rate_se"].values, one["variance"].isel(n=-1).values)
        )
        shown = rate(slope, slope - 2.0 * error, slope + 2.0 * error)
        yield sampler, strategy, number(variance), shown, where


def _numbers(sampler: str, data: xr.Dataset) -> Rows:
    """Yield scalars with their meanings and intervals, for analyses from other packages."""
    drawn = first_channel(data)
    partners = {f"{name}{end}" for name in drawn.data_vars for end in ("_ci", "_se")}
    for name, value in drawn.data_vars.items():
        if value.ndim or value.dtype.kind not in "iufb" or name in partners:
            continue
        ends = _ends(drawn[f"{name}_ci"]) if f"{name}_ci" in drawn else (None, None)
        long_name, units = value.attrs.get("long_name", name), value.attrs.get("units", "")
        yield sampler, str(long_name), str(units), number(float(value)), interval(*ends)


_OF_ANYTHING = (
    "Scalars of the result (first channel).",
    ("Sampler", "Quantity", "Unit", "Value", "95 % interval"),
    (0, 1, 2),
    _numbers,
)

_TABLES: Mapping[
    str, tuple[str, str, tuple[str, ...], tuple[int, ...], Callable[[str, Any], Rows]]
] = {
    # Heading, caption, columns, indices of columns with words, and the function that yields rows
    "remedies": (
        "Remedies",
        (
            "Changes at equal cost, ordered by variance (mean squared error if biased). Ratios are "
            "relative to the set-up as given; their 95 % intervals hold simultaneously."
        ),
        (
            "Sampler",
            "Remedy",
            "Variance",
            "Ratio",
            "95 % interval",
            "Rate",
            # Verdicts do not wrap: only the columns 0, 1 and −1 are listed as columns of words
            "Verdict",
            "What to do",
        ),
        (0, 1, -1),
        _remedies,
    ),
    "techniques": (
        "Techniques",
        (
            "Variance of each technique's part at the largest n, its share of the measured "
            "variance (shares of correlated techniques do not add up to 100 %) and its rate. The "
            "bottleneck is the technique with the slowest rate. Techniques are numbered from 0 in "
            "the estimator's order."
        ),
        ("Sampler", "Technique", "Variance", "Share", "Rate", "Bottleneck"),
        (0, -1),
        _techniques,
    ),
    "anova": (
        "Axes",
        (
            "The ten largest shares of the variance by axes of primary space, averaged over "
            "channels: first-order Sobol' indices of axes, and indices of interactions of sets. An "
            "estimate of a small share can be negative."
        ),
        ("Sampler", "Axes", "Sobol' index"),
        (0, 1),
        _anova,
    ),
    "predict": (
        "Predictions in numbers",
        (
            "Variances predicted from f and the sampler without measured estimates (first "
            "channel). Rate: exponent over these counts. At large n: asymptotic exponent. Bend: n "
            "at which the exponent changes."
        ),
        ("Sampler", "n", "Variance", "95 % interval", "Method", "Rate", "At large n", "Bend"),
        (0, 4),
        _predict,
    ),
    "map": (
        "Map",
        (
            "Medians over pixels at the largest n; rates ± two standard errors of one pixel. "
            "Bottleneck: number of pixels at which a technique's share of multiple importance "
            "sampling has the slower rate."
        ),
        ("Sampler", "Strategy", "Variance", "Rate", "Bottleneck, pixels"),
        (0, 1, -1),
        _map,
    ),
}


def _ends(array: xr.DataArray) -> tuple[float, float]:
    low, high = (float(end) for end in array.values)
    return low, high


def _half(low: float | None, high: float | None) -> float | None:
    return None if low is None or high is None else 0.5 * (high - low)
