"""The table a person reads first: rate, predicted/measured and largest term of every pair."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["SummaryRow", "summarize"]

TERMS = ("dc", "power", "cross")


class SummaryRow(msgspec.Struct, frozen=True, kw_only=True):
    """One estimator with one sampler; what was not analysed is None."""

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
    dc_low: float | None = None
    dc_high: float | None = None
    power_low: float | None = None
    power_high: float | None = None
    cross_low: float | None = None
    cross_high: float | None = None
    largest_term: str | None = None
    note: str | None = None


def summarize(tree: xr.DataTree) -> list[SummaryRow]:
    """One row for every estimator, sampler and channel of a result tree, in the study's order."""
    places = _places(tree.attrs.get("study", {}))
    pairs = [pair for estimator in tree.children.values() for pair in estimator.children.values()]
    pairs.sort(key=lambda pair: places.get(_names(pair), len(places)))
    return [row for pair in pairs for row in _rows(pair)]


def _places(study: dict[str, Any]) -> dict[tuple[str, str], int]:
    """Place of every (estimator, sampler) in the study file; the store keeps no order."""
    names = [
        (e["name"], sampler)
        for e in [*study.get("estimators", []), *study.get("maps", [])]
        for sampler in (e.get("samplers") or study.get("samplers") or [])
    ]
    return {name: place for place, name in enumerate(names)}


def _names(pair: xr.DataTree) -> tuple[str, str]:
    attrs = next(iter(pair.children.values())).attrs
    return attrs.get("estimator_name", ""), attrs.get("sampler_spec", "")


def _rows(pair: xr.DataTree) -> list[SummaryRow]:
    curve = pair["convergence"].to_dataset() if "convergence" in pair.children else None
    terms = pair["terms"].to_dataset() if "terms" in pair.children else None
    first = curve if curve is not None else terms
    if first is None:
        return []
    channels = first.sizes.get("channel", 0)
    rows = []
    for channel in range(max(1, channels)):
        pick: dict[str, Any] = {"channel": channel} if channels else {}
        values: dict[str, Any] = {
            "estimator": first.attrs["estimator_name"] + (f" [{channel}]" if channels else ""),
            "sampler": first.attrs["sampler_spec"],
        }
        if curve is not None:
            values |= _rate_values(curve.isel(pick))
        if terms is not None:
            values |= _term_values(terms.isel(pick))
        rows.append(SummaryRow(**values))
    return rows


def _rate_values(curve: xr.Dataset) -> dict[str, Any]:
    low, high = curve["rate_ci"].values
    first = _number(curve.get("fit_first_n", math.nan))
    return {
        "n": int(curve["n"].values[-1]),
        "variance": _number(curve["variance"].values[-1]),
        "rate": _number(curve["rate"]),
        "rate_low": _number(low),
        "rate_high": _number(high),
        "fit_first_n": None if first is None else int(first),
    }


def _term_values(terms: xr.Dataset) -> dict[str, Any]:
    each = {name: _number(terms[f"{name}_term"]) for name in TERMS}
    known = {name: abs(value) for name, value in each.items() if value is not None}
    low, high = terms["measured_variance_ci"].values
    intervals = [_bounds(terms, name, f"{name}_term") for name in TERMS]
    return {
        **each,
        **{key: value for bounds in intervals for key, value in bounds.items()},
        **_bounds(terms, "captured", "captured"),
        "terms_n": int(terms.attrs["n"]),
        "basis": terms.attrs.get("basis"),
        "predicted": _number(terms["predicted_variance"]),
        "measured": _number(terms["measured_variance"]),
        "measured_low": _number(low),
        "measured_high": _number(high),
        "captured": _number(terms["captured"]),
        "largest_term": _largest(known) if _number(terms["captured"]) is not None else None,
        "note": terms.attrs.get("note"),
    }


def _bounds(terms: xr.Dataset, name: str, variable: str) -> dict[str, float | None]:
    """Ends of a 95 % interval; results of older versions have none."""
    low, high = terms[f"{variable}_ci"].values if f"{variable}_ci" in terms else (math.nan,) * 2
    return {f"{name}_low": _number(low), f"{name}_high": _number(high)}


def _largest(known: dict[str, float]) -> str | None:
    return max(known, key=known.__getitem__) if any(known.values()) else None


def _number(value: Any) -> float | None:
    """A finite float, or None."""
    number = float(np.asarray(value))
    return number if np.isfinite(number) else None
