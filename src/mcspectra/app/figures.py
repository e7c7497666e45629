"""Figures of a set-up: the plots of its results and of its integrand."""

from __future__ import annotations

import numpy as np
import xarray as xr

from mcspectra.plots.description import Axis, Heatmap, Line, Panel, Plot, Scale
from mcspectra.plots.kinds import describe, kinds_of
from mcspectra.plots.scales import signed_scale, unit_axis, unit_panel
from mcspectra.plots.style import PALETTE
from mcspectra.plots.text import number

__all__ = ["FIGURES", "figures_of"]

FIGURES = {
    "integrand": "Integrand f, density p, and sampled function f/p",
    "points": "Points",
    "terms": "Terms of the variance",
    "convergence": "Convergence",
    "prediction": "Predicted variance",
    "spectrum": "Power spectrum",
    "lines": "Power spectrum",
    "radial": "Radial power",
    "contributions": "Contributions by frequency",
    "cross-matrix": "Cross matrix: pairs of frequencies",
    "bands": "Covariance of bands",
}
"""Kinds of plots in the order on the page, and their titles."""


def figures_of(kind: str, value: xr.Dataset, name: str) -> list[Plot]:
    """Describe the figures of a result.

    Parameters
    ----------
    kind
        Name of the part, one of `mcspectra.app.compute.UPDATE_KINDS`.
    value
        The result.
    name
        Name of the result in the figures.
    """
    if kind == "integrand":
        # Show f, p and f/p side by side, because a constant f/p would mean no variance
        flat = len(value.dims) == 1
        panels = tuple(_panel(str(name), each, flat) for name, each in value.items())
        values = {name: each.to_numpy() for name, each in value.items()}
        ends = (
            f"{name} from {number(float(np.nanmin(v)))} to {number(float(np.nanmax(v)))}"
            for name, v in values.items()
        )
        return [
            Plot(
                kind="integrand",
                panels=panels,
                columns=len(panels),
                caption="Where f/p is constant, importance sampling leaves no variance.",
                words="; ".join(ends) + ".",
                height=1.0,
                share="x" if flat else "both",
            )
        ]
    # Skip the plot "integrand" of the points: the figure of f, p and f/p replaces it
    shown = set(kinds_of(value)) - {"integrand"}
    return [describe(each, {name: value}) for each in FIGURES if each in shown]


def _panel(name: str, data: xr.DataArray, flat: bool) -> Panel:
    values = data.to_numpy()
    finite = np.where(np.isfinite(values), values, np.nan)
    if flat:
        x = data["x0"].to_numpy()
        line = Line(
            x=x, y=finite, color=PALETTE[0], hover={name: [number(float(v)) for v in values]}
        )
        return Panel(marks=(line,), x=unit_axis("x₀"), y=Axis(label=name), title=name, square=True)
    x0, x1 = (data[axis].to_numpy() for axis in ("x0", "x1"))
    low, high = float(np.nanmin(finite)), float(np.nanmax(finite))
    above = Scale(label=" ", low=0.0, high=high or 1.0)
    scale = signed_scale(" ", [finite]) if low < 0 else above
    image = Heatmap(values=finite.T, x=x0, y=x1, scale=scale, name=name)
    return unit_panel([image], name)
