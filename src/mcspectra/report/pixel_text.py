"""What is known of a pixel, as rows, sentences and numbers for JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.report.formatting import number, rate
from mcspectra.report.sentences import explain
from mcspectra.studies import SummaryRow, summarize

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "STRATEGY_NAMES",
    "about_pixel",
    "bottleneck_sentence",
    "pixel_rows",
    "pixel_sentences",
    "pixel_summary",
    "term_rows",
]

STRATEGY_NAMES = {
    "light": "light",
    "bsdf": "BSDF",
    "balance": "MIS, balance",
    "power": "MIS, power",
}
"""Strategies as tables and figures call them."""

_TERMS = ("dc_term", "power_term", "cross_term", "predicted_variance", "measured_variance")
_REMEDY = ("kind", "change", "error", "error_ci", "error_ratio", "error_ratio_ci", "verdict")
_REMEDY_RATE = ("rate", "rate_ci", "rate_verdict", "reason")
_PINHOLE = "pinhole"
_HALF = 0.5  # of the variance
_MOST_LIGHTS = 8  # named one by one


def pixel_rows(tree: xr.DataTree) -> list[SummaryRow]:
    """One row for every strategy and sampler; terms where they were analysed.

    Parameters
    ----------
    tree
        What `mcspectra.studies.analyse_pixel` returns.
    """
    curves = tree["convergence"].to_dataset()
    parts: dict[str, xr.Dataset] = {}
    for i, strategy in enumerate(curves["strategy"].values):
        for j, sampler in enumerate(curves["sampler"].values):
            names = {"estimator_name": STRATEGY_NAMES[strategy], "sampler_spec": str(sampler)}
            curve = curves.sel(strategy=strategy, sampler=sampler, drop=True)
            parts[f"/{i}/{j}/convergence"] = curve.assign_attrs(names)
            if sampler == tree.attrs["sampler"]:
                terms = tree[f"terms/{strategy}/auto"].to_dataset()
                parts[f"/{i}/{j}/terms"] = terms.assign_attrs(names)
    return _summarized(parts)


def term_rows(tree: xr.DataTree) -> list[SummaryRow]:
    """One row for every strategy and basis of the terms, which stands in the place of the sampler."""
    parts: dict[str, xr.Dataset] = {}
    for i, (strategy, views) in enumerate(tree["terms"].children.items()):
        seen: set[str] = set()
        for j, view in enumerate(views.children.values()):
            basis = str(view.attrs["basis"])
            if basis in seen:  # the fitting basis may be Fourier's
                continue
            seen.add(basis)
            label = f"{STRATEGY_NAMES[strategy]}; {basis}"
            names = {"estimator_name": strategy, "sampler_spec": label}
            parts[f"/{i}/{j}/terms"] = view.to_dataset().assign_attrs(names)
    return _summarized(parts)


def _summarized(parts: dict[str, xr.Dataset]) -> list[SummaryRow]:
    import xarray as xr

    tree: xr.DataTree = xr.DataTree.from_dict(dict(parts))
    return summarize(tree)


def about_pixel(tree: xr.DataTree) -> list[tuple[str, str]]:
    """What the ray meets and what lights it, as names and texts."""
    known = tree.attrs
    place = ", ".join(number(v) for v in known["position"])
    normal = ", ".join(number(v) for v in known["normal"])
    lights = known["lights"]
    shown = ", ".join(lights[:_MOST_LIGHTS])
    more = f" and {len(lights) - _MOST_LIGHTS} more" if len(lights) > _MOST_LIGHTS else ""
    camera = known.get("camera", _PINHOLE)
    return [
        ("shape", f"{known['shape']} ({known['bsdf']})"),
        ("position", f"({place}), normal ({normal})"),
        ("lights", f"{shown}{more}"),
        ("lit by", "all of them" if known["light"] == "all" else f"{known['light']} alone"),
        ("value", f"{number(known['value'], 5)} (direct illumination, {_channel(known)})"),
        *([] if camera == _PINHOLE else [("camera", f"its ray starts at the {camera}")]),
    ]


def _channel(known: dict[Any, Any]) -> str:
    channel = known["channel"]
    return str(channel) if channel == "luminance" else f"channel {channel}"


def pixel_sentences(tree: xr.DataTree) -> list[tuple[str, str]]:
    """Explain each strategy with the sampler of the terms, the bottleneck, and what would help."""
    return list(_sentences(tree))


def _sentences(tree: xr.DataTree) -> Iterator[tuple[str, str]]:
    known = tree.attrs
    rows = [row for row in pixel_rows(tree) if row.sampler == known["sampler"]]
    for strategy, row in zip(STRATEGY_NAMES, rows, strict=True):
        terms = tree[f"terms/{strategy}/auto"].to_dataset()
        text = f"{explain(row, terms)} {known[f'diagnosis_{strategy}']}"
        yield STRATEGY_NAMES[strategy], text.strip()
    yield "bottleneck", bottleneck_sentence(tree)
    yield "fastest", _fastest(pixel_rows(tree))
    if "remedies" in tree.children:
        yield "remedies", tree["remedies"].attrs["recommendation"]


def bottleneck_sentence(tree: xr.DataTree) -> str:
    """Say which technique's share of MIS has the slower rate, where the intervals tell."""
    found = tree["techniques"].to_dataset()
    rates = [
        rate(float(value), *map(float, ends))
        for value, ends in zip(
            found["technique_rate"].values, found["technique_rate_ci"].values, strict=True
        )
    ]
    slow, names = int(found["bottleneck"]), ("light sampling", "BSDF sampling")
    if slow >= 0:
        name = names[slow][0].upper() + names[slow][1:]
        return (
            f"{name} is the bottleneck of MIS (balance heuristic): its share converges with the rate "
            f"{rates[slow]}, that of {names[1 - slow]} with {rates[1 - slow]}, and the slower rate "
            f"becomes that of the sum{_still_small(found, slow)}."
        )
    return (
        "No technique is told to be the bottleneck of MIS (balance heuristic): the shares of light and "
        f"BSDF sampling converge with the rates {rates[0]} and {rates[1]}."
    )


def _still_small(found: xr.Dataset, slow: int) -> str:
    """Say so where the slower technique's part of the variance is the smaller one up to now."""
    last = found["technique_variance"].isel(n=-1).values
    part = float(last[slow] / last.sum())
    if not part < _HALF:
        return ""
    n = int(found["n"][-1])
    return f" at larger n; at n = {n} it has {100 * part:.2g} % of the variance"


def _fastest(rows: list[SummaryRow]) -> str:
    """The steepest rate, and the least variance at the largest n, of all pairs."""
    fitted = [row for row in rows if row.rate is not None]
    least = min(rows, key=lambda row: math.inf if row.variance is None else row.variance)
    text = (
        f"The least variance at n = {least.n} of each technique is {number(least.variance)}: "
        f"{least.estimator} with {least.sampler}."
    )
    if not fitted:
        return text
    best = min(fitted, key=lambda row: row.rate or 0.0)
    shown = rate(best.rate, best.rate_low, best.rate_high)
    return f"The steepest rate is {shown}: {best.estimator} with {best.sampler}. {text}"


def pixel_summary(tree: xr.DataTree) -> dict[str, Any]:
    """All numbers of a pixel but its maps, as plain lists and dictionaries."""
    known = tree.attrs
    about = {k: v for k, v in known.items() if not str(k).startswith("diagnosis_")}
    found = {
        "pixel": about,
        "rates": list(_rates(tree["convergence"].to_dataset())),
        "terms": list(_terms(tree)),
        "techniques": _techniques(tree["techniques"].to_dataset()),
        "jumps": list(_jumps(tree)),
        "sentences": dict(pixel_sentences(tree)),
    }
    if "remedies" in tree.children:
        found["remedies"] = _remedies(tree["remedies"].to_dataset())
    return found


def _rates(curves: xr.Dataset) -> Iterator[dict[str, Any]]:
    for strategy in curves["strategy"].values:
        for sampler in curves["sampler"].values:
            one = curves.sel(strategy=strategy, sampler=sampler)
            values = {v: one[v].values for v in ("variance", "variance_ci", "rate", "rate_ci")}
            yield {
                "strategy": str(strategy),
                "sampler": str(sampler),
                "n": one["n"].values,
            } | values


def _terms(tree: xr.DataTree) -> Iterator[dict[str, Any]]:
    for strategy, views in tree["terms"].children.items():
        for view, node in views.children.items():
            names = [n for term in (*_TERMS, "captured") for n in (term, f"{term}_ci")]
            yield {
                "strategy": strategy,
                "view": view,
                "basis": node.attrs["basis"],
                "sampler": node.attrs["sampler"],
                "n": node.attrs["n"],
                **{name: node[name].values for name in names if name in node},
            }


def _techniques(found: xr.Dataset) -> dict[str, Any]:
    names = ("technique_rate", "technique_rate_ci", "technique_variance", "rate", "rate_ci")
    slow = int(found["bottleneck"])
    return {
        "estimator": found.attrs["estimator"],
        "techniques": ["light", "bsdf"],
        "bottleneck": ("light", "bsdf")[slow] if slow >= 0 else "undecided",
        "n": found["n"].values,
        **{name: found[name].values for name in names},
    }


def _jumps(tree: xr.DataTree) -> Iterator[dict[str, Any]]:
    if "pictures" not in tree.children:
        return
    for name, node in tree["pictures"].children.items():
        for kind in node.to_dataset()["kind"].values:
            sizes = [float(node[f"primary_jump_{v}"].sel(kind=kind)) for v in ("length", "height")]
            yield {"integrand": name, "kind": str(kind), "length": sizes[0], "height": sizes[1]}


def _remedies(found: xr.Dataset) -> dict[str, Any]:
    known = {k: found.attrs[k] for k in ("budget", "diagnosis", "recommendation", "not_tried")}
    ranked = [
        {"remedy": str(name)}
        | {v: np.asarray(found[v].sel(remedy=name)).tolist() for v in (*_REMEDY, *_REMEDY_RATE)}
        for name in found["remedy"].values
    ]
    return {**known, "ranked": ranked}
