"""Maps over an image, as pictures with a colour bar or a legend."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.errors import ParameterError
from mcspectra.report.axes import log_ticks
from mcspectra.report.style import (
    FAINT,
    GRAY,
    INK,
    SMALL_SIZE,
    WIDE,
    entitle,
    new_figure,
    outer_labels,
    quiet,
    quiet_colorbar,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

__all__ = ["MAP_CAPTIONS", "map_figures"]

MAP_CAPTIONS = {
    "mean": "Mean estimate at the largest number of samples.",
    "variance": "Variance of the estimate at the largest number of samples.",
    "rate": "Fitted exponent of variance in the number of samples; random sampling is −1.",
    "rate_se": "Standard error of the exponent.",
    "bottleneck": "Technique whose share of MIS has the slower rate, by the 95 % interval of their difference.",
    "dominant": "Technique whose share of MIS has the larger variance, at the largest number of samples.",
    "gain": "Variance of the better single strategy over that of MIS, at the same total of samples. "
    "Above 1, MIS is better.",
    "predicted": "Predicted over measured variance, at the largest number of samples.",
}
"""Kind of figure to what it shows."""

_NAMES = {
    "light": "light",
    "bsdf": "BSDF",
    "mis-light": "MIS, light share",
    "mis-bsdf": "MIS, BSDF share",
    "mis": "MIS",
}
_SEQUENTIAL, _DIVERGING = "viridis", "PuOr_r"
_TECHNIQUES = ("#0072B2", "#D55E00")
_SPREAD = (1.0, 99.0)  # percentiles that a scale spans: single pixels would take up all of it
_DECADES = 6.0
_LARGEST_RATIO = 8.0  # of the scales of ratios


def map_figures(result: xr.Dataset) -> Iterator[tuple[str, Figure]]:
    """Draw the maps of `variance_map`, one figure a kind, a panel a strategy.

    Parameters
    ----------
    result
        What `mcspectra.rendering.variance_map` returns.

    Returns
    -------
    iterator of tuple
        Kind of figure, a key of `MAP_CAPTIONS`, and the figure. Pixels without a number are light
        gray.

    Raises
    ------
    ParameterError
        The result is no map.
    """
    needed = {"variance", "mean", "rate"}
    if not needed <= set(getattr(result, "data_vars", ())) or "x" not in result.dims:
        raise ParameterError(
            "What is to be drawn has no maps of mean, variance and rate; give what variance_map "
            "returns."
        )
    return _figures(result)


def _figures(result: xr.Dataset) -> Iterator[tuple[str, Figure]]:
    """The figures of `map_figures`, one after the other."""
    last = result.isel(n=-1)
    yield "mean", _logarithmic(last["mean"], "mean estimate")
    yield "variance", _logarithmic(last["variance"], "variance")
    yield "rate", _rates(result["rate"])
    yield "rate_se", _logarithmic(result["rate_se"], "standard error of the rate")
    for kind, name in (("bottleneck", "bottleneck"), ("dominant", "dominant_technique")):
        if name in result:
            yield kind, _techniques(result[name])
    if "mis_gain" in result:
        yield "gain", _ratios(result["mis_gain"], "variance of the better strategy / of MIS")
    if "predicted_ratio" in result:
        there = result["predicted_ratio"].dropna("x", how="all").dropna("y", how="all")
        yield "predicted", _ratios(there, "predicted / measured variance")


def _logarithmic(data: xr.DataArray, label: str) -> Figure:
    from matplotlib.colors import LogNorm

    values = data.values[np.isfinite(data.values) & (data.values > 0)]
    low, high = np.percentile(values, _SPREAD) if values.size else (0.1, 1.0)
    low = max(low, high * 10.0**-_DECADES)
    if not low < high:
        low, high = low / 2, high * 2
    figure = _images(data, _SEQUENTIAL, LogNorm(low, high), label)
    _bar_ticks(figure, log_ticks(low, high))
    return figure


def _rates(data: xr.DataArray) -> Figure:
    from matplotlib.colors import Normalize

    values = data.values[np.isfinite(data.values)]
    low, high = np.percentile(values, _SPREAD) if values.size else (-2.0, -1.0)
    # Never narrower than −2 … −1, smooth and random: noise would look like structure. Not much
    # wider either: what lies beyond comes of variances that few realisations make.
    low, high = max(min(low, -2.0), -3.0), min(max(high, -1.0), -0.5)
    return _images(data, _SEQUENTIAL, Normalize(low, high), "exponent of variance")


def _ratios(data: xr.DataArray, label: str) -> Figure:
    from matplotlib.colors import LogNorm

    values = np.abs(np.log(data.values[np.isfinite(data.values) & (data.values > 0)]))
    reach = float(np.exp(np.percentile(values, _SPREAD[1]))) if values.size else 2.0
    reach = min(max(reach, 1.5), _LARGEST_RATIO)
    figure = _images(data, _DIVERGING, LogNorm(1 / reach, reach), label)
    _bar_ticks(
        figure,
        [t for t in (0.125, 0.25, 0.5, 0.8, 1, 1.25, 2, 4, 8) if 1 <= max(t, 1 / t) <= reach],
    )
    return figure


def _techniques(data: xr.DataArray) -> Figure:
    """Which of two techniques, with a legend instead of a bar."""
    from matplotlib.colors import ListedColormap, NoNorm
    from matplotlib.patches import Patch

    colors = ("#FFFFFF", *_TECHNIQUES)
    figure, (axes,) = _panels(data, 1)
    image = np.ma.masked_array(np.nan_to_num(data.values + 1).astype(int), np.isnan(data.values))
    axes.imshow(image, cmap=_map_of(ListedColormap(colors)), norm=NoNorm(), **_placed(data))
    handles = [
        Patch(facecolor=color, edgecolor=GRAY, linewidth=0.5, label=label)
        for color, label in zip(
            (*colors, FAINT), ("undecided", "light", "BSDF", "no number"), strict=True
        )
    ]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=4, frameon=False,
        fontsize=SMALL_SIZE, labelcolor=INK,
    )  # fmt: skip
    return figure


def _images(data: xr.DataArray, colors: str, norm: Normalize, label: str) -> Figure:
    """Panels of all strategies on one scale, with a bar."""
    strategies = data["strategy"].values.tolist() if "strategy" in data.dims else [None]
    figure, panels = _panels(data, len(strategies))
    for axes, strategy in zip(panels, strategies, strict=True):
        own = data if strategy is None else data.sel(strategy=strategy)
        drawn = axes.imshow(
            np.ma.masked_invalid(own.values), cmap=_map_of(colors), norm=norm, **_placed(own)
        )
        outer_labels(axes)
        if strategy is not None:
            entitle(axes, _NAMES.get(strategy, strategy))
    bar = figure.colorbar(drawn, ax=panels, shrink=0.9, aspect=30, pad=0.02, extend="both")
    quiet_colorbar(bar, label)
    bar.minorticks_off()
    return figure


def _panels(data: xr.DataArray, count: int) -> tuple[Figure, list[Axes]]:
    """Axes side by side, at most three, in the proportions of the image."""
    columns = 1 if count == 1 else min(count, 3) if count != 4 else 2
    rows = -(-count // columns)
    width = (WIDE - 1.0) / columns
    proportion = min(max(data.sizes["y"] / data.sizes["x"], 0.1), 2.0)
    figure = new_figure(WIDE, rows * (width * proportion + 0.35) + 0.3)
    grid = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for spare in grid[count:]:
        spare.remove()
    for axes in grid[:count]:
        quiet(axes)
    return figure, grid[:count]


def _placed(data: xr.DataArray) -> dict[str, Any]:
    x, y = data["x"].values, data["y"].values
    extent = (x[0] - 0.5, x[-1] + 0.5, y[-1] + 0.5, y[0] - 0.5)
    return {"extent": extent, "interpolation": "nearest", "aspect": "equal"}


def _map_of(colors: Any) -> Any:
    """A colour map whose masked values are light gray."""
    from matplotlib import colormaps

    chosen = colormaps[colors] if isinstance(colors, str) else colors
    return chosen.with_extremes(bad=FAINT)


def _bar_ticks(figure: Figure, ticks: Sequence[float]) -> None:
    """Put plain ticks on the bar, the last axes of a figure."""
    from matplotlib.ticker import NullLocator

    axis = figure.axes[-1].yaxis
    axis.set_ticks(list(ticks), labels=[f"{t:.3g}" for t in ticks])
    axis.set_minor_locator(NullLocator())
