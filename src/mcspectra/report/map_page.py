"""Write a map of an image: layers, pictures, numbers, and one page that stands alone."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import StoreError
from mcspectra.rendering.files import write_exr
from mcspectra.report.encode import encode
from mcspectra.report.figures.scene_maps import MAP_CAPTIONS, map_figures
from mcspectra.report.html import page_template

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["map_layers", "map_note", "map_summary", "write_map"]

_NAMES = {
    "mean": "Mean",
    "variance": "Variance",
    "rate": "Rate",
    "rate_se": "Error of the rate",
    "bottleneck": "Bottleneck",
    "dominant": "Larger variance",
    "gain": "Gain of MIS",
    "predicted": "Predicted / measured",
}


def write_map(result: xr.Dataset, folder: str | Path) -> Path:
    """Write ``maps.exr``, ``*.png``, ``map.json`` and ``report.html``; older ones are replaced.

    Parameters
    ----------
    result
        What `mcspectra.rendering.variance_map` returns.
    folder
        Made if need be.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    StoreError
        The folder cannot be written.
    FileFormatError
        The layers cannot be written.
    """
    root = Path(folder)
    summary = map_summary(result)
    try:
        root.mkdir(parents=True, exist_ok=True)
        write_exr(root / "maps.exr", map_layers(result), comment=json.dumps(result.attrs))
        text = json.dumps(_finite(summary), indent=2, allow_nan=False)
        (root / "map.json").write_text(text + "\n", encoding="utf-8")
        pictures = {kind: encode(figure)[0] for kind, figure in map_figures(result)}
        for kind, png in pictures.items():
            (root / f"{kind}.png").write_bytes(png)
        page = root / "report.html"
        page.write_text(_page(result, summary, pictures), encoding="utf-8")
    except OSError as error:
        raise StoreError(f"{str(root)!r} cannot be written: {error.strerror}.") from None
    return page


def map_layers(result: xr.Dataset) -> dict[str, Array]:
    """Name every image of a map: ``variance.light.n16``, ``rate.bsdf``, ``mis_gain_ci.low``, …

    Returns
    -------
    dict
        Names to arrays (y, x); NaN where there is no number.
    """
    return {
        str(name): values
        for variable in result.data_vars
        for name, values in _layers(str(variable), result[variable])
    }


def _layers(name: str, data: xr.DataArray) -> Iterator[tuple[str, Array]]:
    """One layer for each strategy, count and bound."""
    outer = next((dim for dim in data.dims if dim not in ("y", "x")), None)
    if outer is None:
        yield name, data.values
        return
    for label in data[outer].values.tolist():
        part = f"n{label}" if outer == "n" else str(label)
        yield from _layers(f"{name}.{part}", data.sel({outer: label}))


def map_summary(result: xr.Dataset) -> dict[str, Any]:
    """Medians over pixels by strategy, and shares of pixels, beside the provenance."""
    last = result.isel(n=-1)
    strategies = {
        str(strategy): _strategy_summary(last.sel(strategy=strategy))
        for strategy in result["strategy"].values
    }
    found: dict[str, Any] = {**result.attrs, "counts": result["n"].values.tolist()}
    found |= {name: json.loads(found[name]) for name in ("size", "crop") if name in found}
    found["strategies"] = strategies
    for name in ("bottleneck", "dominant_technique"):
        if name in result:
            labels = {"light": 0, "bsdf": 1, "undecided": -1}
            found[name] = {k: _share(result[name].values, v) for k, v in labels.items()}
    if "mis_gain" in result:
        low, high = (result["mis_gain_ci"].sel(bound=b).values for b in ("low", "high"))
        known = max(int(np.isfinite(low).sum()), 1)
        found["mis_gain"] = {
            "median": _median(result["mis_gain"].values),
            "above_1": float((low > 1).sum() / known),
            "below_1": float((high < 1).sum() / known),
        }
    return found


def map_note(summary: Mapping[str, Any]) -> str:
    """Say what the numbers of `map_summary` are, and whether pixels err together."""
    note = (
        f"Medians over the {summary['pixels_measured']} pixels that see a lit surface; mean and "
        f"variance at n = {summary['counts'][-1]}."
    )
    if summary["points"] == "own":
        return note
    return (
        f"{note} All pixels have the same points, so their errors are alike: neither medians nor "
        "shares of pixels average them out."
    )


def _strategy_summary(data: xr.Dataset) -> dict[str, float]:
    found = {name: _median(data[name].values) for name in ("mean", "variance", "rate", "rate_se")}
    if "predicted_ratio" in data:
        low, high = (data["predicted_ratio_ci"].sel(bound=b).values for b in ("low", "high"))
        known = max(int(np.isfinite(low).sum()), 1)
        found["predicted_ratio"] = _median(data["predicted_ratio"].values)
        found["predicted_within_ci"] = float(((low <= 1) & (high >= 1)).sum() / known)
    return found


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def _share(values: Array, label: int) -> float:
    known = values[np.isfinite(values)]
    return float((known == label).mean()) if known.size else float("nan")


def _page(result: xr.Dataset, summary: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    known = result.attrs
    x0, y0, width, height = summary["crop"]
    counts = ", ".join(map(str, summary["counts"]))
    return page_template("maps.html.j2").render(
        title=known["scene"],
        settings=(
            f"{width} × {height} pixels from ({x0}, {y0}), sampler {known['sampler']}, n = {counts} "
            f"of each technique, {known['realizations']} realisations, {known['points']} points."
        ),
        note=map_note(summary),
        columns=["strategy", *next(iter(summary["strategies"].values()))],
        rows=[
            [name, *(f"{value:.4g}" for value in row.values())]
            for name, row in summary["strategies"].items()
        ],
        sentences=list(_sentences(summary)),
        figures=[
            {
                "kind": kind,
                "name": _NAMES[kind],
                "caption": MAP_CAPTIONS[kind],
                "data": base64.b64encode(png).decode("ascii"),
            }
            for kind, png in pictures.items()
        ],
        provenance=known,
    )


def _sentences(summary: Mapping[str, Any]) -> Iterator[str]:
    """What the shares of pixels say."""
    if "bottleneck" in summary:
        share = summary["bottleneck"]
        yield (
            f"The BSDF share of MIS has the slower rate in {share['bsdf']:.0%} of the pixels, the "
            f"light share in {share['light']:.0%}; in {share['undecided']:.0%} the 95 % interval "
            "of their difference contains 0."
        )
    if "mis_gain" in summary:
        gain = summary["mis_gain"]
        yield (
            f"At equal totals of samples MIS has less variance than the better single strategy in "
            f"{gain['above_1']:.0%} of the pixels, more in {gain['below_1']:.0%}, by 95 % "
            f"intervals; the median gain is {gain['median']:.3g}."
        )


def _finite(value: Any) -> Any:
    """Replace what JSON has no number for by null."""
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
