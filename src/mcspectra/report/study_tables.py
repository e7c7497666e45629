"""Tables of a study's further analyses: remedies, techniques, axes, exact variances, maps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.report.anything import any_table, summary_of
from mcspectra.report.collect import EstimatorGroup
from mcspectra.report.formatting import interval, number, percent, rate, with_error
from mcspectra.report.tables import Cell, Table

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["FURTHER", "further_tables"]

_DRAWN = ("convergence", "terms", "spectrum", "points", "pcf")  # have figures, and the main tables
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")

Rows = Iterator[tuple[Cell, ...]]


def further_tables(group: EstimatorGroup) -> Iterator[tuple[str, Table]]:
    """Yield a heading and a table for each further analysis that the estimator has."""
    for analysis, (heading, caption, columns, rows) in FURTHER.items():
        there = group.having(analysis)
        if there:
            found = tuple(row for sampler, data in there.items() for row in rows(sampler, data))
            yield heading, Table(caption=caption, columns=columns, rows=found, heads=1)
    for analysis in (each for each in group.analyses if each not in (*FURTHER, *_DRAWN)):
        numbers = any_table(group.having(analysis))
        if numbers is not None:
            yield summary_of(analysis).removesuffix("."), numbers


def _remedies(sampler: str, data: xr.Dataset) -> Rows:
    names, changes, verdicts = (data.attrs[f"labels_{k}"] for k in ("remedy", "change", "verdict"))
    for i, name in enumerate(names):
        one = data.isel(remedy=i)
        yield (
            _text(sampler),
            _text(name),
            Cell(text=number(_value(one["error"]))),
            Cell(text=number(_value(one["error_ratio"]))),
            Cell(text=interval(*_ends(one["error_ratio_ci"]))),
            Cell(text=rate(_value(one["rate"]), *_ends(one["rate_ci"]))),
            _text(verdicts[i]),
            _text(changes[i]),
        )


def _techniques(sampler: str, data: xr.Dataset) -> Rows:
    several = data.sizes.get("n", 1) > 1
    last = data.isel(n=-1) if "n" in data.sizes else data
    total = _value(last["measured_variance"].sum())
    for t in range(data.sizes["technique"]):
        one = last.isel(technique=t)
        variance = _value(one["technique_variance"].sum())
        slope = _rate_of(one) if several and "technique_rate" in one else "–"
        share = percent(variance / total) if total > 0 and np.isfinite(variance) else "–"
        yield (
            _text(sampler),
            Cell(text=str(t)),
            Cell(text=number(variance)),
            Cell(text=share),
            Cell(text=slope),
            _text(str(data.attrs.get("bottleneck", "–"))),
        )


def _rate_of(one: xr.Dataset) -> str:
    """Rate of a technique; of several channels the first one's."""
    found = one.isel(channel=0) if "channel" in one["technique_rate"].dims else one
    return rate(_value(found["technique_rate"]), *_ends(found["technique_rate_ci"]))


def _anova(sampler: str, data: xr.Dataset) -> Rows:
    labels = data.attrs["labels_subset_label"]
    shares = data["anova_share"]
    mean = shares.mean("channel") if "channel" in shares.dims else shares
    for i in np.argsort(-mean.values)[:10]:
        yield _text(sampler), _text(_axes(labels[i])), Cell(text=percent(float(mean.values[i])))


def _exact(sampler: str, data: xr.Dataset) -> Rows:
    why = str(data.attrs.get("note", ""))
    for n, values in zip(data["n"].values, data["exact_variance"].values, strict=True):
        text = ", ".join(number(float(v), 6) for v in np.atleast_1d(values))
        yield _text(sampler), Cell(text=str(n)), Cell(text=text, why=why)


def _map(sampler: str, data: xr.Dataset) -> Rows:
    bottleneck = data["bottleneck"].values if "bottleneck" in data else np.array([])
    decided = {t: int((bottleneck == t).sum()) for t in (0, 1)}
    where = f"light {decided[0]}, BSDF {decided[1]}" if bottleneck.size else "–"
    for i, strategy in enumerate(data.attrs["labels_strategy"]):
        one = data.isel(strategy=i)
        slope, error = _median(one["rate"]), _median(one["rate_se"])
        variance = _median(one["variance"].isel(n=-1))
        yield (
            _text(sampler),
            _text(strategy),
            Cell(text=number(variance)),
            Cell(text=with_error(rate(slope, None, None), 2.0 * error)),
            _text(where),
        )


FURTHER: Mapping[str, tuple[str, str, tuple[str, ...], Callable[[str, Any], Rows]]] = {
    "remedies": (
        "Remedies",
        (
            "Changes at equal cost in the order of their errors; ratios are to the set-up as given, and "
            "their intervals hold together at 95 %."
        ),
        ("Sampler", "Remedy", "Error", "Ratio", "95 % interval", "Rate", "Verdict", "What to do"),
        _remedies,
    ),
    "techniques": (
        "Techniques",
        (
            "Variance of each technique's part at the largest n, its share of the measured variance (sums "
            "differ from 100 % where techniques are correlated) and its rate. The bottleneck is the "
            "technique whose rate is slower than all others'. Techniques are numbered in the estimator's "
            "order, from 0."
        ),
        ("Sampler", "Technique", "Variance", "Share", "Rate", "Bottleneck"),
        _techniques,
    ),
    "anova": (
        "Axes",
        (
            "Shares of the variance by axes of primary space, the ten largest; channels are averaged. An "
            "estimate of a small share can be negative."
        ),
        ("Sampler", "Axes", "Share"),
        _anova,
    ),
    "exact": (
        "Exact variance",
        "Without sampling.",
        ("Sampler", "n", "Variance"),
        _exact,
    ),
    "map": (
        "Map",
        (
            "Medians over pixels at the largest n, rates ± two standard errors of one pixel; pixels at which "
            "one technique's share of multiple importance sampling has the slower rate."
        ),
        ("Sampler", "Strategy", "Variance", "Rate", "Bottleneck, pixels"),
        _map,
    ),
}
"""Heading, caption, columns and rows of further analyses by their names."""


def _axes(label: str) -> str:
    """``x₀x₁`` for the x0x1 of a store, as figures write it."""
    return label.translate(_SUBSCRIPTS)


def _text(text: str) -> Cell:
    return Cell(text=text, numeric=False)


def _value(array: xr.DataArray) -> float:
    return float(array.values)


def _ends(array: xr.DataArray) -> tuple[float, float]:
    low, high = (float(end) for end in array.values)
    return low, high


def _median(array: xr.DataArray) -> float:
    values = array.values[np.isfinite(array.values)]
    return float(np.median(values)) if values.size else float("nan")
