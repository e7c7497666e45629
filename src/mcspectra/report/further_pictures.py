"""Figures of a study's further analyses: pair correlations, remedies, maps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mcspectra.report import figures
from mcspectra.report.figures.scene_maps import MAP_CAPTIONS
from mcspectra.report.formatting import number
from mcspectra.report.picture import Picture
from mcspectra.report.style import LineStyle

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["map_pictures", "pair_pictures", "remedy_pictures", "with_labels"]

Datasets: TypeAlias = "Mapping[str, xr.Dataset]"
Styles: TypeAlias = Mapping[str, LineStyle]

_LEFT_OUT = ("rate_se",)  # of the kinds of maps: the table has its median


def pair_pictures(data: Datasets, styles: Styles) -> Iterator[Picture]:
    """Draw the pair correlations of all samplers in one figure."""
    lows = (f"{name}: {_lowest_pair(each)}." for name, each in data.items())
    yield Picture(
        kind="pair-correlation",
        caption="Pair correlation g(r) of the points before any warp: density of points at distance r "
        "from another one, over that of random points, ± two standard errors.",
        alt="Pair correlation against the distance. " + " ".join(lows),
        figure=figures.pair_correlations(data, styles=styles),
    )


def remedy_pictures(data: Datasets, styles: Styles) -> Iterator[Picture]:
    """Draw the remedies of each sampler, a figure each."""
    del styles  # colours are those of the verdicts
    for place, (sampler, stored) in enumerate(data.items()):
        each = with_labels(stored, "remedy")
        yield Picture(
            kind=f"remedies-{place}",
            caption=f"{sampler}: error of each change over that of the set-up as given, with intervals "
            "that hold together at 95 %; left of 1 there is less noise.",
            alt=f"Ratios of errors for {sampler}. {_ratios_in_words(each)}.",
            figure=figures.remedy_ratios(each),
        )


def map_pictures(data: Datasets, styles: Styles) -> Iterator[Picture]:
    """Draw the maps of each sampler, a figure for each quantity."""
    del styles  # maps have scales of colour
    for place, (sampler, stored) in enumerate(data.items()):
        each = with_labels(stored, "strategy")
        for kind, figure in figures.map_figures(each):
            if kind in _LEFT_OUT:
                continue
            yield Picture(
                kind=f"map-{place}-{kind.replace('_', '-')}",
                caption=f"{sampler}: {MAP_CAPTIONS[kind]}",
                alt=f"Map of {each.sizes['x']} × {each.sizes['y']} pixels for {sampler}. "
                f"{MAP_CAPTIONS[kind]}",
                figure=figure,
            )


def with_labels(stored: xr.Dataset, dim: str) -> xr.Dataset:
    """Make the coordinates of text along `dim` again, which a store keeps as ``labels_*``."""
    head = "labels_"
    texts = {str(key): value for key, value in stored.attrs.items() if str(key).startswith(head)}
    return stored.assign_coords(
        {
            key.removeprefix(head): (dim, np.array(value))
            for key, value in texts.items()
            if len(value) == stored.sizes[dim]
        }
    )


def _lowest_pair(data: xr.Dataset) -> str:
    """Where g is smallest, as ``least 0.12 at r = 0.03``."""
    g = data["pair_correlation"].values
    if not np.isfinite(g).any():
        return "no number"
    least = int(np.nanargmin(g))
    return f"least {number(float(g[least]))} at r = {number(float(data['r'].values[least]))}"


def _ratios_in_words(data: xr.Dataset) -> str:
    pairs = zip(data["remedy"].values, data["error_ratio"].values, strict=True)
    return ", ".join(f"{name} {number(float(ratio))}" for name, ratio in pairs)
