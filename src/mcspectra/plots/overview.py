"""A row of small pictures of one estimator: f and p, points, spectrum, convergence, terms."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mcspectra.plots.description import BarChart, Line, Panel, Plot
from mcspectra.plots.groups import Group, Styles, as_group
from mcspectra.plots.kinds import PLOT_KINDS
from mcspectra.plots.points import integrand, points
from mcspectra.plots.scales import name_axis
from mcspectra.plots.spectra import lines, radial, spectrum
from mcspectra.plots.style import labels
from mcspectra.plots.text import percent
from mcspectra.plots.variance import convergence, terms

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["overview"]

_HEIGHT = 0.95  # height of a panel relative to its width, equal for all pictures
_TITLE = 24  # largest number of letters in the title of a small picture
_COMPLETE = 0.1  # the terms add up to the measured variance up to this relative difference
_TERMS = ("dc", "power", "cross", "sum", "measured")


def overview(analyses: Mapping[str, Group], sampler: str, styles: Styles) -> Iterator[Plot]:
    """Yield the small pictures of an estimator, for those analyses that have results.

    Parameters
    ----------
    analyses
        Results by analysis and sampler.
    sampler
        Sampler that is shown in pictures of a single sampler.
    styles
        Style of each sampler.
    """
    found = {name: as_group(group)[0] for name, group in analyses.items() if group}
    title = labels([sampler], _TITLE)[sampler]
    sets = found.get("points", {})
    if sampler in sets and PLOT_KINDS["integrand"].fits(sets[sampler]):
        own = "density_value" in sets[sampler]
        plot = integrand({sampler: sets[sampler]}, styles)
        panel = _plain(plot.panels[0])
        yield _small(plot, panel, f"Integrand f{', density p' if own else ''} and samples")
    if sampler in sets:
        flat = sets[sampler].sizes["axis"] == 1
        plot = points(sets if flat else {sampler: sets[sampler]}, styles)
        yield _small(plot, plot.panels[0], "Points")
    spectra = found.get("spectrum", {})
    if sampler in spectra:
        data = spectra[sampler]
        if PLOT_KINDS["spectrum"].fits(data):
            plot = spectrum({sampler: data}, styles)
            panel = replace(_plain(plot.panels[0]), title=title)
        else:
            plot = (lines if PLOT_KINDS["lines"].fits(data) else radial)(spectra, styles)
            panel = replace(plot.panels[0], y=replace(plot.panels[0].y, label=""))
        yield _small(plot, panel, "Spectrum: n · power (random points: 1)")
    if curves := found.get("convergence"):
        plot = convergence(curves, styles, small=True)
        theory = any("predicted_n" in each for each in curves.values())
        caption = f"Variance and its slope{' (in brackets: theory)' if theory else ''}"
        yield _small(plot, _named_only(plot.panels[0], curves, styles), caption)
    if sampler in found.get("terms", {}):
        plot = terms({sampler: found["terms"][sampler]}, styles)
        panel = plot.panels[0]
        marks = tuple(
            replace(mark, texts=()) if isinstance(mark, BarChart) else mark for mark in panel.marks
        )
        names = _TERMS[: len(panel.y.ticks or ())]
        panel = replace(panel, marks=marks, y=name_axis(names), title=title)
        yield _small(plot, panel, _terms_caption(found["terms"][sampler]))


def _terms_caption(data: xr.Dataset) -> str:
    """Return a caption that tells whether the sum of the terms reaches the measured variance."""
    share = float(data["captured"]) if "captured" in data else math.nan
    if not math.isfinite(share) or abs(share - 1.0) <= _COMPLETE:
        return "Terms of the variance add up"
    width = data.sizes["half_width"] - 1
    return f"Terms up to frequency {width} sum to {percent(share)} of the measured variance"


def _small(plot: Plot, panel: Panel, caption: str) -> Plot:
    return replace(
        plot, panels=(panel,), columns=1, caption=caption, height=_HEIGHT, rows=(), small=True,
        share="",
    )  # fmt: skip


def _plain(panel: Panel) -> Panel:
    """Return a panel without color bars."""
    marks: list[Any] = []
    for mark in panel.marks:
        each: Any = mark
        scale = getattr(each, "scale", None)
        marks.append(each if scale is None else replace(each, scale=replace(scale, label="")))
    return replace(panel, marks=tuple(marks))


def _named_only(panel: Panel, curves: Group, styles: Styles) -> Panel:
    """Return a panel of curves whose legend shows only the names of the samplers."""
    short = labels(list(curves), _TITLE)
    names = {styles[name].color: short[name] for name in curves}
    marks: list[Any] = []
    for mark in panel.marks:
        each: Any = mark
        if getattr(each, "label", ""):
            measured = not isinstance(each, Line) or each.dashes != "-."
            own = names.get(getattr(each, "color", ""), "") if measured else ""
            each = replace(each, label=own)
        marks.append(each)
    return replace(panel, marks=tuple(marks))
