"""Kinds of plots: which results they can show, and which function describes the plot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.display import shown
from mcspectra.core.errors import ParameterError
from mcspectra.plots import maps, points, screens, spectra, variance, warps
from mcspectra.plots.description import Axis, Dots, Heatmap, Line, Mark, Panel, Plot, Scale
from mcspectra.plots.groups import (
    Data,
    Group,
    Styles,
    abreast,
    as_group,
    frequency_dims,
    intervals,
    numbers,
)
from mcspectra.plots.scales import name_axis
from mcspectra.plots.style import labels, sampler_styles

__all__ = ["PLOT_KINDS", "PlotKind", "anything", "describe", "kinds_of", "shown_variables"]


@final
@dataclass(frozen=True)
class PlotKind:
    """A kind of plot.

    Attributes
    ----------
    describe
        Function that returns the plot of a group of results.
    variables
        Variables that a result must have.
    dims
        Number of frequency dims that a result must have. None: any number.
    pixels
        Whether this kind shows results over the pixels of an image.
    """

    describe: Callable[[Group, Styles], Plot]
    variables: tuple[str, ...]
    dims: int | None = None
    pixels: bool = False

    def fits(self, data: xr.Dataset) -> bool:
        """Whether this kind of plot can show the result."""
        if {"y", "x"} <= set(data.dims) and not self.pixels:
            return False
        return not self.lacks(data) and self.dims in (None, len(frequency_dims(data)))

    def lacks(self, data: xr.Dataset) -> list[str]:
        """Return the required variables that the result lacks. Text may be an attribute instead."""
        return [
            v for v in self.variables if v not in data.variables and f"labels_{v}" not in data.attrs
        ]


def shown_variables(data: xr.Dataset) -> dict[str, int]:
    """Return the variables that `anything` shows, with their numbers of dims.

    The variables are real and have one or two dims; if there are none, scalars are shown.
    Intervals and standard errors are not listed: they are drawn with other variables.
    """
    partners = {f"{name}{end}" for name in data.data_vars for end in ("_ci", "_se")}
    found = {
        str(name): values.ndim
        for name, values in data.data_vars.items()
        if values.ndim <= 2 and values.dtype.kind in "iufb" and name not in partners and values.size
    }
    return {name: dims for name, dims in found.items() if dims} or found


def anything(group: Group, styles: Styles) -> Plot:
    """Plot all variables of a result that no other kind of plot shows.

    Variables over one dim become curves of all samplers in one panel.
    Variables over two dims become maps, one panel per sampler.
    Without variables over one or two dims, scalars are plotted side by side.
    """
    first, names = next(iter(group.values())), labels(list(group), 30)
    panels, said = [], []
    for name, dims in shown_variables(first).items():
        title = str(first[name].attrs.get("long_name", name))
        unit = str(first[name].attrs.get("units", ""))
        over = [str(dim) for dim in first[name].dims]
        said.append(f"{title}, over {' and '.join(over)}" if over else title)
        label = f"{title} ({unit})" if unit not in ("", "1") else title
        there = {sampler: each for sampler, each in group.items() if name in each}
        if dims == 2:
            for sampler, each in there.items():
                shown = each[name].values.astype(float)
                finite = shown[np.isfinite(shown)]
                low, high = (
                    (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
                )
                scale = Scale(label=label, low=low, high=high if high > low else low + 1.0)
                (y, y_ticks), (x, x_ticks) = (_places(each[name], dim) for dim in each[name].dims)
                panels.append(
                    Panel(
                        marks=(Heatmap(values=shown, x=x, y=y, scale=scale, name=name),),
                        x=Axis(label=over[1], ticks=x_ticks),
                        y=Axis(label=over[0], ticks=y_ticks),
                        title=sampler if len(group) > 1 else label,
                    )
                )
            continue
        marks: list[Mark] = []
        for row, (sampler, each) in enumerate(there.items()):
            x, ticks = (np.array([float(row)]), None) if not dims else _places(each[name], over[0])
            y, style = np.atleast_1d(each[name].values), styles[sampler]
            hover = {"sampler": [names[sampler]] * x.size, "x": numbers(x), "value": numbers(y)}
            both: dict[str, Any] = {"x": x, "y": y, "color": style.color, "label": names[sampler]}
            # Use each value's interval if it has one, otherwise two standard errors on either side
            ends = None
            if f"{name}_ci" in each:
                ends = np.reshape(each[f"{name}_ci"].values, (-1, 2))
            elif f"{name}_se" in each:
                error = np.atleast_1d(each[f"{name}_se"].values)
                ends = np.stack([y - 2.0 * error, y + 2.0 * error], axis=-1)
            if ends is not None:
                both["low"], both["high"] = ends.T
                hover["interval"] = intervals(ends)
            if ticks is None and dims:  # a line plot needs a numeric axis
                marks.append(Line(dashes=style.dashes, hover=hover, **both))
            else:
                marks.append(Dots(marker=style.marker, hover=hover, **both))
        if dims:
            axis = Axis(label=over[0], ticks=ticks)
        else:
            axis = name_axis([names[sampler] for sampler in there], flipped=False)
        panels.append(Panel(marks=tuple(marks), x=axis, y=Axis(label=label), grid=True))
    return Plot(
        panels=tuple(panels),
        columns=min(2, abreast(len(panels))),
        caption="; ".join(said)[:1].upper() + "; ".join(said)[1:] + ".",
        words=f"{'; '.join(said)}, for {', '.join(group)}.",
    )


def _places(values: xr.DataArray, dim: Any) -> tuple[Array, Mapping[float, str] | None]:
    """Return positions along a dim, and tick texts if its labels are not numbers."""
    at = values[dim].values
    if at.dtype.kind in "iuf":
        return at.astype(float), None
    return np.arange(float(at.size)), {float(k): str(text) for k, text in enumerate(at)}


PLOT_KINDS: Mapping[str, PlotKind] = {
    "convergence": PlotKind(
        variance.convergence, ("n", "variance", "variance_ci", "mean", "rate", "rate_ci")
    ),
    "cross-matrix": PlotKind(spectra.cross_matrix, ("cross_matrix",), 1),
    "terms": PlotKind(
        variance.terms,
        ("dc_term", "power_term", "cross_term", "predicted_variance_ci", "measured_variance_ci"),
    ),
    "captured": PlotKind(variance.captured, ("captured_by_half_width",)),
    "contributions": PlotKind(spectra.contributions, ("contribution", "power_contribution")),
    "product": PlotKind(spectra.product, ("integrand_power", "power_contribution")),
    "bands": PlotKind(spectra.bands, ("band_covariance",)),
    "spectrum": PlotKind(spectra.spectrum, ("power",), 2),
    "lines": PlotKind(spectra.lines, ("power",), 1),
    "radial": PlotKind(spectra.radial, ("power", "radial_power")),
    "anisotropy": PlotKind(spectra.anisotropy, ("anisotropy_db", "spectrum_sets")),
    "pair-correlation": PlotKind(
        spectra.pair_correlation, ("pair_correlation", "pair_correlation_ci")
    ),
    "quality": PlotKind(points.quality, ("points_made", "quality_sets")),
    "points": PlotKind(points.points, ("points", "axis")),
    "integrand": PlotKind(points.integrand, ("points", "integrand_value")),
    "remedies": PlotKind(variance.remedies, ("remedy", "error_ratio", "error_ratio_ci", "verdict")),
    "techniques": PlotKind(variance.techniques, ("technique_covariance", "technique_variance_ci")),
    "technique-rates": PlotKind(
        variance.technique_rates, ("n", "technique_variance", "technique_rate", "rate_ci")
    ),
    "anova": PlotKind(variance.anova, ("anova_variance", "anova_variance_se", "subset_label")),
    "profile": PlotKind(variance.profile, ("n", "variance", "variance_ci", "integral")),
    "prediction": PlotKind(
        variance.prediction, ("n", "predicted_variance", "predicted_variance_ci")
    ),
    "modes": PlotKind(
        spectra.modes, ("eigenvalue", "eigenvalue_se", "eigenvalue_share", "mode_vector")
    ),
    "chains": PlotKind(spectra.chains, ("error_share", "chain_spectrum", "fitted_spectrum")),
    "strata": PlotKind(points.strata, ("stratum_variance", "sliding_variance")),
    "estimates": PlotKind(variance.estimates, ("estimate",)),
    "warp": PlotKind(warps.warp, ("warped", "stretch", "jump")),
    "primary": PlotKind(warps.primary, ("primary_value", "primary_jump", "face_jump")),
    **{
        kind: PlotKind(describe, variables, pixels=True)
        for kind, (variables, describe) in {**maps.MAPS, **screens.SCREENS}.items()
    },
    "anything": PlotKind(anything, (), pixels=True),
}
"""Kinds of plots by name. The accessor's ``plot`` uses the first kind that fits a result."""


def kinds_of(data: Data) -> tuple[str, ...]:
    """Return the kinds of plots that can show a result; ``anything`` if there is no other."""
    first = next(iter(as_group(data)[0].values()))
    fitting = (name for name, kind in PLOT_KINDS.items() if kind.fits(first) and name != "anything")
    return tuple(fitting) or (("anything",) if shown_variables(first) else ())


def describe(kind: str, data: Data, styles: Styles | None = None) -> Plot:
    """Describe a plot of one result or of several results.

    Parameters
    ----------
    kind
        One of `PLOT_KINDS`.
    data
        A dataset, which may have the dims estimator and sampler, or datasets by sampler name.
        Only the first channel is shown.
    styles
        Style of each name. Default: distinct styles.

    Raises
    ------
    ParameterError
        If the kind is unknown, if there is nothing to draw, or if the kind does not fit the result.
    """
    chosen = PLOT_KINDS[as_choice("kind", kind, tuple(PLOT_KINDS))]
    # Only a plot of convergence separates the curves of a bench by integrand
    if isinstance(data, xr.Dataset) and "points_made" in data and kind != "convergence":
        data = data.drop_vars("rate")
    group, note = as_group(data)
    for name, each in group.items():
        if lacking := chosen.lacks(each):
            raise ParameterError(
                f"The result for {shown(name)} has no {' and no '.join(lacking)}; the plot "
                f"{shown(kind)} needs a result of another analysis."
            )
        if not chosen.fits(each):
            other = "'radial'" if "power" in chosen.variables else "'contributions'"
            raise ParameterError(
                f"The result for {shown(name)} has {len(frequency_dims(each))} frequency dims, "
                f"but the plot {shown(kind)} shows {chosen.dims}; use {other} for any number of "
                "dims."
            )
    plot = chosen.describe(group, styles or sampler_styles(list(group)))
    plot = replace(plot, kind=kind)
    if not note:
        return plot
    label = note.removeprefix("Shown: ").rstrip(".")
    titles = [f"{label}: {panel.title}" if panel.title else label for panel in plot.panels]
    panels = tuple(replace(p, title=t) for p, t in zip(plot.panels, titles, strict=True))
    return replace(plot, panels=panels, caption=f"{plot.caption} {note}")
