"""Maps over frequencies to look into: power, contributions to the variance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.report.figures.groups import Group, as_group, frequency_dims
from mcspectra.report.figures.maps import (
    by_frequency,
    one_technique,
)
from mcspectra.report.figures.spectra import color_top, power_label, without_dc
from mcspectra.report.formatting import number
from mcspectra.report.interactive.curves import spectrum_lines
from mcspectra.report.interactive.frame import (
    GRID,
    add_hover,
    in_words,
    legend_below,
    new_plot,
    panel_row,
    plot_color,
    set_ticks,
)
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
from mcspectra.report.style import LineStyle, sampler_styles
from mcspectra.report.words import for_each, low_power_words, peak_words

if TYPE_CHECKING:
    import xarray as xr
    from bokeh.models import LayoutDOM
    from bokeh.plotting import figure

__all__ = ["contribution_plot", "spectrum_plot"]


def spectrum_plot(data: Group, *, styles: Mapping[str, LineStyle] | None = None) -> LayoutDOM:
    """Plot power spectra, dc left out: maps of (m₀, m₁) on one colour scale, or in 1-D lines.

    Parameters
    ----------
    data
        ``power(m0)`` or ``power(m0, m1)`` by sampler, with attribute ``n``.
    styles
        How each sampler is drawn, where they are lines.

    Returns
    -------
    LayoutDOM
        A figure; of several two-dimensional results a row of figures that zoom together.

    Raises
    ------
    ParameterError
        Nothing to draw, or a spectrum of more than two dims.
    """
    group = as_group(data, "power")
    dims = {len(frequency_dims(each)) for each in group.values()}
    if dims == {1}:
        drawn: LayoutDOM = spectrum_lines(group, styles or sampler_styles(list(group)))
    else:
        drawn = _power_maps(group)
    words = "Power over frequencies. " + for_each(group, _power_words)
    return in_words(drawn, words)  # type: ignore[no-any-return]


def contribution_plot(data: Group, *, styles: Mapping[str, LineStyle] | None = None) -> LayoutDOM:
    """Plot each frequency's contribution c_m to the variance: maps in 2-D, else stems.

    Stems stand over m in 1-D and over shells of |m| in more than two dims; a line shows what the
    power alone would give.

    Parameters
    ----------
    data
        ``contribution`` and ``power_contribution`` on m0, m1, … by sampler; of several channels
        and techniques the first is shown.
    styles
        How each sampler is drawn, where they are stems.

    Returns
    -------
    LayoutDOM
        A figure; of several two-dimensional results a row of figures that zoom together.

    Raises
    ------
    ParameterError
        Nothing to draw, or a variable is missing.
    """
    group = {
        name: one_technique(each, 0)
        for name, each in as_group(data, "contribution", "power_contribution").items()
    }
    if all(len(frequency_dims(each)) == 2 for each in group.values()):
        drawn: LayoutDOM = _contribution_maps(group)
    else:
        drawn = _stems(group, styles or sampler_styles(list(group)))
    words = "Contribution of each frequency to the variance. " + for_each(group, peak_words)
    return in_words(drawn, words)  # type: ignore[no-any-return]


def _power_words(data: xr.Dataset) -> str:
    return low_power_words(data) if "radial_power" in data else f"n = {data.attrs['n']}"


def _power_maps(group: Mapping[str, xr.Dataset]) -> LayoutDOM:
    from bokeh.models import LinearColorMapper
    from bokeh.palettes import Viridis256

    plots = {name: _square_map(name, each) for name, each in group.items()}
    images = {name: without_dc(each, 2) for name, each in group.items()}
    mapper = LinearColorMapper(
        palette=Viridis256, low=0.0, high=color_top(list(images.values())), nan_color="#808080"
    )
    for name, plot in plots.items():
        axes = [group[name][m].values for m in ("m0", "m1")]
        image(plot, {"power": images[name]}, "power", axes, mapper)
        color_bar(plot, mapper, power_label(group.values()))
    return panel_row(list(plots.values()))


def _contribution_maps(group: Mapping[str, xr.Dataset]) -> LayoutDOM:
    images = {n: d["contribution"].transpose("m0", "m1").values for n, d in group.items()}
    scale = signed_scale(list(images.values()), MAP_DECADES)
    mapper = signed_mapper()
    plots = []
    for name, values in images.items():
        plot = _square_map(name, group[name])
        axes = [group[name][m].values for m in ("m0", "m1")]
        power = group[name]["power_contribution"].transpose("m0", "m1").values
        columns = {"contribution": values, "power part": power, "shade": shades(scale, values)}
        image(plot, columns, "shade", axes, mapper)
        color_bar(plot, mapper, f"contribution cₘ{scale.note}", shade_ticks(scale, 5))
        plots.append(plot)
    return panel_row(plots)


def _square_map(name: str, data: xr.Dataset) -> figure:
    """Make an empty panel over (m₀, m₁)."""
    if len(frequency_dims(data)) != 2:
        raise ParameterError(
            f"The spectrum of {name!r} has {len(frequency_dims(data))} frequency dims; this figure "
            "shows 1 or 2: use radial_plot for any number of dims."
        )
    return new_plot(
        "m₀", "m₁", title=name, height=PANEL + 66, width=PANEL, sizing_mode="fixed",
    )  # fmt: skip


def _stems(group: Mapping[str, xr.Dataset], styles: Mapping[str, LineStyle]) -> figure:
    curves = {name: by_frequency(each) for name, each in group.items()}
    scale = signed_scale([values for _, *both in curves.values() for values in both])
    shells = len(frequency_dims(next(iter(group.values())))) > 1
    plot = new_plot(
        "shell |m| (rounded)" if shells else "frequency m",
        f"{'Σ cₘ in the shell' if shells else 'cₘ'}{scale.note}",
    )
    set_ticks(plot.yaxis, scale.ticks())
    entries = {
        name: _stem(plot, name, curve, scale, styles[name]) for name, curve in curves.items()
    }
    rows = {"sampler": "name", "|m|" if shells else "m": "m", "contribution": "text",
            "power part": "power_text"}  # fmt: skip
    add_hover(plot, [drawn[1] for drawn in entries.values()], rows)
    legend_below(plot, entries)
    return plot


def _stem(
    plot: figure,
    name: str,
    curve: tuple[Array, Array, Array],
    scale: SignedScale,
    style: LineStyle,
) -> list[Any]:
    from bokeh.models import ColumnDataSource

    m, total, power = curve
    source = ColumnDataSource(
        {
            "m": m,
            "c": scale.place(total),
            "power": scale.place(power),
            "text": [number(float(v), 4) for v in total],
            "power_text": [number(float(v), 4) for v in power],
            "name": [name] * len(m),
        }
    )
    color = plot_color(style)
    return [
        plot.segment("m", 0.0, "m", "c", source=source, color=color, line_width=1.5, alpha=0.7),
        plot.scatter("m", "c", source=source, color=color, size=4),
        plot.step("m", "power", source=source, color=GRID, mode="center"),
    ]
