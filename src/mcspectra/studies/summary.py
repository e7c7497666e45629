"""Summarize a study in one table with a row for each pair of an estimator and a sampler.

A row has the rate, the ratio of predicted to measured variance, and the largest term.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mcspectra.core.checks import Array, as_instance

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["SummaryRow", "asked_of", "pairs_of", "rows_of", "summarize"]

TERMS = ("dc", "power", "cross")
_READ = ("convergence", "terms", "predict")


class SummaryRow(msgspec.Struct, frozen=True, kw_only=True):
    """Summary of one estimator with one sampler; values that were not computed are None.

    ``ratio`` is predicted variance divided by measured variance.
    For a result of ``predict``, ``method`` is the method of the prediction, one of `METHODS`.
    Without ``predict``, the prediction is a sum of variance terms, and ``method`` is their basis.
    The ``ratio`` of such a sum is the same number as ``captured`` in the result of ``terms``.
    """

    estimator: str
    sampler: str
    n: int | None = None
    rate: float | None = None
    rate_low: float | None = None
    rate_high: float | None = None
    variance: float | None = None
    fit_first_n: int | None = None
    terms_n: int | None = None
    basis: str | None = None
    dc: float | None = None
    power: float | None = None
    cross: float | None = None
    predicted: float | None = None
    measured: float | None = None
    measured_low: float | None = None
    measured_high: float | None = None
    captured: float | None = None
    captured_low: float | None = None
    captured_high: float | None = None
    ratio: float | None = None
    ratio_low: float | None = None
    ratio_high: float | None = None
    method: str | None = None
    dc_low: float | None = None
    dc_high: float | None = None
    power_low: float | None = None
    power_high: float | None = None
    cross_low: float | None = None
    cross_high: float | None = None
    largest_term: str | None = None
    note: str | None = None


def summarize(tree: xr.DataTree) -> list[SummaryRow]:
    """Return one row per estimator, sampler and channel of a result tree, in the study's order.

    Raises
    ------
    ParameterError
        If the argument is not a tree of results, as returned by `open_results`.
    """
    import xarray as xr

    as_instance("tree", tree, xr.DataTree, "the result of open_results")
    return [
        row
        for _, estimator, sampler, found in pairs_of(tree)
        for row in rows_of(estimator, sampler, found)
    ]


def pairs_of(tree: xr.DataTree) -> list[tuple[str, str, str, dict[str, xr.Dataset]]]:
    """Return a tuple for each pair of an estimator and a sampler, in the study's order.

    A tuple has the estimator's names in the store and in the study, the sampler, and results.
    The order of the study is restored, because file systems may list groups in any order.
    """
    asked = asked_of(tree.attrs.get("study") or {})
    pairs = ((name, sampler) for name, samplers in asked.items() for sampler in samplers)
    places = {names: place for place, names in enumerate(pairs)}
    found = []
    for key, node in tree.children.items():
        for slug, child in node.children.items():
            analyses = {str(name): each.to_dataset() for name, each in child.children.items()}
            known = next(iter(analyses.values())).attrs if analyses else {}
            names = str(known.get("estimator_name", key)), str(known.get("sampler_spec", slug))
            found += [(str(key), *names, analyses)] if analyses else []
    return sorted(found, key=lambda each: (places.get(each[1:3], len(places)), *each[:3]))


def asked_of(study: Mapping[str, Any]) -> dict[str, Sequence[str]]:
    """Return the samplers of every estimator and map of a study, in the study's order."""
    entries = [*(study.get("estimators") or []), *(study.get("maps") or [])]
    return {e["name"]: e.get("samplers") or study.get("samplers") or [] for e in entries}


def rows_of(estimator: str, sampler: str, found: Mapping[str, xr.Dataset]) -> list[SummaryRow]:
    """Make the rows of one pair of estimator and sampler: one row per channel.

    The dict `found` holds the result of each analysis, by the name of the analysis.
    The list is empty if there are no results of `convergence` or of `terms`.
    """
    read = {name: found[name] for name in _READ if name in found}
    first = read.get("convergence", read.get("terms"))
    if first is None:
        return []
    rows = []
    channels = first.sizes.get("channel", 0)
    for channel in range(max(1, channels)):
        of = {k: each.isel(channel=channel) if channels else each for k, each in read.items()}
        values: dict[str, Any] = {
            "estimator": estimator + (f" [{channel}]" if channels else ""),
            "sampler": sampler,
        }
        if "convergence" in of:
            curve = of["convergence"]
            fit_first = _number(curve.get("fit_first_n", math.nan))
            values |= {
                **_with_bounds(curve, rate="rate"),
                # A rate without an interval gets an interval of infinite width
                **(
                    {}
                    if np.isfinite(curve["rate_ci"]).any()
                    else {"rate_low": -math.inf, "rate_high": math.inf}
                ),
                "n": int(curve["n"].values[-1]),
                "variance": _number(curve["variance"].values[-1]),
                "fit_first_n": None if fit_first is None else int(fit_first),
            }
        if "terms" in of:
            terms = of["terms"]
            each = _with_bounds(terms, **{name: f"{name}_term" for name in TERMS})
            each |= _with_bounds(terms, captured="captured", measured="measured_variance")
            sizes = {name: abs(each[name]) for name in TERMS if each[name] is not None}
            known = each["captured"] is not None and any(sizes.values())
            values |= {
                **each,
                "terms_n": int(terms.attrs["n"]),
                "basis": terms.attrs.get("basis"),
                "predicted": _number(terms["predicted_variance"]),
                "largest_term": max(sizes, key=sizes.__getitem__) if known else None,
                "note": terms.attrs.get("note"),
            }
        rows.append(SummaryRow(**values, **_ratio(of, values)))
    return rows


def _ratio(found: dict[str, xr.Dataset], row: dict[str, Any]) -> dict[str, Any]:
    """Return the ratio of predicted to measured variance at the largest n that both have.

    Without a result of ``convergence``, the measured variance of ``terms`` is used.
    If several methods have a prediction, the most trusted method is used.
    """
    import xarray as xr

    curve, terms = found.get("convergence"), found.get("terms")
    if curve is None and terms is not None and "measured_variance_ci" in terms:
        values = {name: terms[f"measured_{name}"] for name in ("variance", "variance_ci")}
        curve = xr.Dataset(values).expand_dims(n=[int(terms.attrs["n"])])
    for methods, each in _by_method(found["predict"]) if "predict" in found else ():
        if curve is None or "measured" in methods:
            continue
        there = np.isin(each["n"].values, curve["n"].values) & (
            each["predicted_variance"].values > 0
        )
        if not there.any():
            continue
        known, method = each.isel(n=there), methods[there][-1]
        value, n = known["predicted_variance"], known["n"].values[-1]
        measured = float(curve["variance"].sel(n=n))
        if not measured > 0:
            continue
        ratio = float(value[-1]) / measured

        # Compute an interval of the ratio from the errors of both variances, in logarithms
        def half(low: float, middle: float, high: float) -> tuple[float, float]:
            return (math.log(middle / low) if low > 0 else math.inf), math.log(high / middle)

        below, above = half(*_ends(curve["variance_ci"].sel(n=n), measured))
        own = half(*_ends(known["predicted_variance_ci"].sel(n=n), float(value[-1])))
        return {
            "ratio": ratio,
            "ratio_low": _number(ratio * math.exp(-math.hypot(above, own[0]))),
            "ratio_high": _number(ratio * math.exp(math.hypot(below, own[1]))),
            "method": str(method),
        }
    if row.get("captured") is None:
        return {}
    ends = {f"ratio{end}": row[f"captured{end}"] for end in ("", "_low", "_high")}
    return {**ends, "method": row["basis"] or "fourier"}


def _by_method(data: xr.Dataset) -> Iterator[tuple[Array, xr.Dataset]]:
    """Yield predicted variances for all n, with an array of the method used at each n."""
    names = np.asarray(
        data["method"].values if "method" in data.coords else data.attrs["labels_method"]
    )
    if "method" not in data.dims:
        yield names, data
        return
    for k, name in enumerate(names):
        yield np.full(data.sizes["n"], name), data.isel(method=k)


def _ends(interval: xr.DataArray, middle: float) -> tuple[float, float, float]:
    """Return low end, middle and high end of an interval, widened to contain the middle."""
    low, high = map(float, interval.values)
    return min(low, middle), middle, max(high, middle)


def _with_bounds(data: xr.Dataset, **variables: str) -> dict[str, Any]:
    """Return values by name with the ends of their 95 % intervals; None if a value is unknown.

    An end of an interval may be infinite.
    """
    found: dict[str, Any] = {}
    for name, variable in variables.items():
        ends = data[f"{variable}_ci"].values if f"{variable}_ci" in data else (math.nan, math.nan)
        low, high = (None if np.isnan(end) else float(end) for end in ends)
        found |= {name: _number(data[variable]), f"{name}_low": low, f"{name}_high": high}
    return found


def _number(value: Any) -> float | None:
    """Return a finite float, or None."""
    number = float(np.asarray(value))
    return number if np.isfinite(number) else None
