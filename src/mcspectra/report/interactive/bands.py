"""Covariances between bands of frequencies to look into."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.figures.groups import Group, as_group
from mcspectra.report.figures.maps import band_labels, band_shares, band_unit
from mcspectra.report.formatting import percent
from mcspectra.report.interactive.frame import add_hover, in_words, new_plot, panel_row, set_ticks
from mcspectra.report.interactive.images import (
    MAP_DECADES,
    PANEL,
    color_bar,
    image,
    shade_ticks,
    shades,
    signed_mapper,
)
from mcspectra.report.interactive.signed import SignedScale, signed_scale
from mcspectra.report.words import band_words, for_each

if TYPE_CHECKING:
    import xarray as xr
    from bokeh.models import LayoutDOM
    from bokeh.plotting import figure

__all__ = ["band_plot"]


def band_plot(data: Group) -> LayoutDOM:
    """Plot the covariance between band-limited estimates, Cov(I_a, I_b), as a map.

    Parameters
    ----------
    data
        ``band_covariance(band, band_other)`` by sampler; of several channels the first is shown.

    Returns
    -------
    LayoutDOM
        A figure; of several results a row of figures that zoom together.

    Raises
    ------
    ParameterError
        Nothing to draw, or the variable is missing.
    """
    group = as_group(data, "band_covariance")
    matrices = {name: each["band_covariance"].values for name, each in group.items()}
    scale = signed_scale(list(matrices.values()), MAP_DECADES)
    plots = [_band_map(name, each, matrices[name], scale) for name, each in group.items()]
    words = "Covariance between bands of frequencies. " + for_each(group, band_words)
    return in_words(panel_row(plots), words)  # type: ignore[no-any-return]


def _band_map(name: str, data: xr.Dataset, matrix: Array, scale: SignedScale) -> figure:
    unit = band_unit(data)
    plot = new_plot(
        f"band a{unit}", f"band b{unit}", title=name, height=PANEL + 66, width=PANEL,
        sizing_mode="fixed",
    )  # fmt: skip
    bands = np.arange(len(matrix))
    names = band_labels(data, len(matrix))
    stride = max(1, len(names) // 6)
    for axis in (plot.xaxis, plot.yaxis):
        set_ticks(axis, {float(b): names[b] for b in bands[::stride]})
    own, through = band_shares(matrix)
    mapper = signed_mapper()
    columns = {"covariance": matrix, "shade": shades(scale, matrix)}
    texts = {
        "share of a by itself": [_share(s) for s in own],
        "share of a through others": [_share(s) for s in through],
    }
    image(plot, columns, "shade", [bands, bands], mapper, ("band a", "band b"))
    _band_shares(plot, texts)
    color_bar(plot, mapper, f"Cov(I_a, I_b){scale.note}", shade_ticks(scale, 5))
    return plot


def _share(value: float) -> str:
    return percent(float(value)) if np.isfinite(value) else "no finite share"


def _band_shares(plot: figure, texts: Mapping[str, list[str]]) -> None:
    """Lay unseen marks along the diagonal that say what share of the variance a band has."""
    from bokeh.models import ColumnDataSource

    titles = {title: title for title in texts}
    count = len(next(iter(texts.values())))
    source = ColumnDataSource({"at": np.arange(count), **texts})
    marks = plot.rect("at", "at", 1, 1, source=source, fill_alpha=0.0, line_alpha=0.0)
    add_hover(plot, [marks], titles)
