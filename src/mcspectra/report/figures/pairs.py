"""Pair correlations over distance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from mcspectra.report.figures.groups import Group, as_group
from mcspectra.report.figures.panels import GivenAxes, rows_of
from mcspectra.report.style import GRAY, NARROW, LineStyle, labels, legend_below, sampler_styles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["pair_correlations"]


def pair_correlations(
    data: Group, *, styles: Mapping[str, LineStyle] | None = None, axes: GivenAxes = None
) -> Figure:
    """Draw g(r) with a band of two standard errors to either side, and the level of random points.

    Parameters
    ----------
    data
        Results of `pair_correlation`, by sampler.
    styles
        How each sampler is drawn.
    axes
        Axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        Nothing to draw, or a variable is missing.
    """
    group = as_group(data, "pair_correlation", "pair_correlation_se")
    styles = styles or sampler_styles(list(group))
    names = labels(list(group), 40)
    height = 2.7 + 0.16 * ((len(group) + 1) // 2)
    figure, (panel,) = rows_of(axes, 1, NARROW, height, grid=True)
    panel.axhline(1.0, color=GRAY, lw=0.9)
    for name, each in group.items():
        r, g = each["r"].values, each["pair_correlation"].values
        spread = 2.0 * each["pair_correlation_se"].values
        style = styles[name]
        panel.fill_between(r, g - spread, g + spread, color=style.color, alpha=0.2, linewidth=0)
        panel.plot(r, g, color=style.color, ls=style.dashes, lw=1.2, label=names[name])
    panel.set(xlabel="distance r", ylabel="pair correlation g(r)")
    panel.set_ylim(bottom=0.0)
    legend_below(figure, panel)
    return figure
