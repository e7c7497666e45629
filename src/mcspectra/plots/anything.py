"""Results that no kind of plot knows, such as those of a stranger's analysis.

Variables of one dim are curves of all samplers in one panel, those of two are maps, a panel for each
sampler; where there are neither, single numbers stand beside each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, Dots, Image, Line, Mark, Panel, Plot, Scale
from mcspectra.plots.groups import Group, Styles, abreast, intervals, numbers
from mcspectra.plots.scales import name_axis
from mcspectra.plots.style import LineStyle, labels

__all__ = ["anything", "shown_variables"]


def shown_variables(data: xr.Dataset) -> dict[str, int]:
    """Return the variables of real numbers that are shown, with their dims: one or two, else none.

    Intervals and standard errors belong to others.
    """
    partners = {f"{name}{end}" for name in data.data_vars for end in ("_ci", "_se")}
    found = {
        str(name): values.ndim
        for name, values in data.data_vars.items()
        if values.ndim <= 2 and values.dtype.kind in "iufb" and name not in partners and values.size
    }
    return {name: dims for name, dims in found.items() if dims} or found


def anything(group: Group, styles: Styles) -> Plot:
    """Every variable of one dim as curves, of two as maps; single numbers where there are neither."""
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
            panels += [
                _map(name, sampler if len(group) > 1 else label, label, each[name])
                for sampler, each in there.items()
            ]
            continue
        marks: list[Mark] = []
        for row, (sampler, each) in enumerate(there.items()):
            x, ticks = (np.array([float(row)]), None) if not dims else _places(each[name])
            joined = ticks is None and bool(dims)
            y, ends = np.atleast_1d(each[name].values), _ends(each, name)
            marks.append(_curve(names[sampler], styles[sampler], x, y, ends, joined))
        if dims:
            axis = Axis(label=over[0], ticks=ticks)
        else:
            axis = name_axis([names[sampler] for sampler in there], flipped=False)
        panels.append(Panel(marks=tuple(marks), x=axis, y=Axis(label=label), grid=True))
    return Plot(
        kind="anything",
        panels=tuple(panels),
        columns=min(2, abreast(len(panels))),
        caption="; ".join(said)[:1].upper() + "; ".join(said)[1:] + ".",
        words=f"{'; '.join(said)}, for {', '.join(group)}.",
    )


def _places(values: xr.DataArray) -> tuple[Array, Mapping[float, str] | None]:
    """Places along the only dim of a variable, and texts where its labels are no numbers."""
    (dim,) = values.dims
    at = values[dim].values
    if at.dtype.kind in "iuf":
        return at.astype(float), None
    return np.arange(float(at.size)), {float(k): str(text) for k, text in enumerate(at)}


def _ends(data: xr.Dataset, name: str) -> Array | None:
    """Interval of each value (…, 2): its own, or two standard errors to either side."""
    if f"{name}_ci" in data:
        return np.reshape(data[f"{name}_ci"].values, (-1, 2))
    if f"{name}_se" not in data:
        return None
    value, error = (np.atleast_1d(data[key].values) for key in (name, f"{name}_se"))
    return np.stack([value - 2.0 * error, value + 2.0 * error], axis=-1)


def _curve(
    label: str, style: LineStyle, x: Array, y: Array, ends: Array | None, joined: bool
) -> Mark:
    low, high = (None, None) if ends is None else ends.T
    shown = {"sampler": [label] * x.size, "x": numbers(x), "value": numbers(y)}
    shown |= {} if ends is None else {"interval": intervals(ends)}
    both: dict[str, Any] = {"low": low, "high": high, "label": label, "hover": shown}
    if joined:  # names are no axis that a line could run along
        return Line(x=x, y=y, color=style.color, dashes=style.dashes, **both)
    return Dots(x=x, y=y, color=style.color, marker=style.marker, **both)


def _map(name: str, title: str, label: str, values: xr.DataArray) -> Panel:
    (y, y_ticks), (x, x_ticks) = (
        _places(values.isel({d: 0}).drop_vars([d], errors="ignore")) for d in values.dims[::-1]
    )
    shown = values.values.astype(float)
    finite = shown[np.isfinite(shown)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    scale = Scale(label=label, low=low, high=high if high > low else low + 1.0)
    down, across = map(str, values.dims)
    return Panel(
        marks=(Image(values=shown, x=x, y=y, scale=scale, name=name),),
        x=Axis(label=across, ticks=x_ticks),
        y=Axis(label=down, ticks=y_ticks),
        title=title,
    )
