"""Groups: results of one analysis, each with a name. Plots are made from such groups."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.plots.description import Line, Panel
from mcspectra.plots.style import LineStyle, labels, line_widths
from mcspectra.plots.text import interval, number

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "Data",
    "Group",
    "Styles",
    "abreast",
    "along",
    "as_group",
    "for_each",
    "frequency_dims",
    "intervals",
    "labelled",
    "lines_of",
    "method_of",
    "not_finite",
    "numbers",
    "pairs",
    "point_dims",
    "root_of_n",
    "shared",
    "variant_dims",
]

Group: TypeAlias = "Mapping[str, xr.Dataset]"
"""Results with one channel, by name of the sampler. Labels are stored as coordinates."""

Data: TypeAlias = "xr.Dataset | Group"
"""Results by name, or one result, which may have several estimators, samplers or variants."""

Styles: TypeAlias = Mapping[str, LineStyle]
"""Style of each sampler."""

# Variables of a curve, such as a variance that depends on n.
# If a result has several variants of a curve, it is divided into one result for each variant
_CURVE = {
    "n",
    "variance",
    "variance_ci",
    "rate",
    "rate_ci",
}


def as_group(data: Data) -> tuple[dict[str, xr.Dataset], str]:
    """Return the first channel of results by name, and a note if there are more channels.

    Raises
    ------
    ParameterError
        If `data` contains no result.
    """
    import xarray as xr

    given: Any = data
    if isinstance(given, xr.Dataset):
        group = {name: each for *_, name, each in pairs(given)}
    elif isinstance(given, Mapping) and given:
        group = {str(name): each for name, each in given.items()}
    else:
        group = {}
    if not group or not all(isinstance(each, xr.Dataset) for each in group.values()):
        raise ParameterError(
            f"A plot needs a dataset or a mapping of sampler names to datasets, not {data!r:.80}."
        )
    channels = max(each.sizes.get("channel", 0) for each in group.values())
    note = f"Shown: channel 0 of {channels}." if channels > 1 else ""
    first = {n: d.isel(channel=0) if "channel" in d.dims else d for n, d in group.items()}
    return {name: labelled(each) for name, each in first.items()}, note


def pairs(data: xr.Dataset) -> Iterator[tuple[str, str, str, xr.Dataset]]:
    """Yield each combination: estimator, points (sampler and variant), name, and result."""
    several, variants = {"estimator", "sampler"} & set(data.dims), variant_dims(data)
    for estimator, of_estimator in along(data, "estimator"):
        for sampler, of_sampler in along(of_estimator, "sampler"):
            for place in itertools.product(*(range(data.sizes[dim]) for dim in variants)):
                at = dict(zip(variants, place, strict=True))
                variant = ", ".join(_place(dim, data[dim].values[k]) for dim, k in at.items())
                points = f"{sampler}, {variant}" if variant else sampler
                name = f"{estimator}, {points}" if "estimator" in several else points
                yield (
                    estimator,
                    points,
                    name if several or not variant else variant,
                    of_sampler.isel(at),
                )


def variant_dims(data: xr.Dataset) -> list[str]:
    """Return the dims along which one sampler has several curves, as in `mirror_study`."""
    if not set(map(str, data.variables)) >= _CURVE:
        return []
    known = ("estimator", "sampler", "channel", "y", "x")
    return [str(dim) for dim in data["rate"].dims if dim not in known]


def frequency_dims(data: xr.Dataset) -> list[str]:
    """Return the names of the frequency dims of a result: m0, m1, …"""
    return sorted(str(d) for d in data.dims if str(d)[0] == "m" and str(d)[1:].isdigit())


def root_of_n(dims: int) -> str:
    """Return the text of n^(1/d): n, √n, ∛n or n^(1/4)."""
    return {1: "n", 2: "√n", 3: "∛n"}.get(dims, f"n^(1/{dims})")


def point_dims(data: xr.Dataset) -> int:
    """Return the number of dims of the points of a result; for a bench, the first number."""
    return int(str(data.attrs["dims"]).strip("[]").partition(",")[0])


def abreast(count: int) -> int:
    """Return the number of panels per row: at most three, or two for four panels."""
    return -(-count // -(-count // 3))


def shared(panels: Sequence[Panel]) -> Literal["", "x", "y", "both"]:
    """Return which axes are equal in all panels and can be shared."""
    x, y = (
        all(axis == axes[0] for axis in axes)
        for axes in zip(*((p.x, p.y) for p in panels), strict=True)
    )
    return "both" if x and y else "x" if x else "y" if y else ""


def for_each(group: Group, words: Callable[[xr.Dataset], str]) -> str:
    """Return the names and descriptions of all results as one text."""
    return "; ".join(f"{name}: {words(each)}" for name, each in group.items()) + "."


def lines_of(
    curves: Mapping[str, Sequence[Array]],
    styles: Styles,
    under: tuple[str, str],
    *,
    texts: Mapping[str, Sequence[str]] | None = None,
    notes: Mapping[str, str] | None = None,
) -> list[Line]:
    """Return one line per name. Earlier lines are thicker, so that coinciding lines stay visible.

    Parameters
    ----------
    curves
        For each name: x and y, and optionally the two ends of a band.
    styles
        Line style of each name in the plot.
    under
        Titles of x and y in the tooltip.
    texts
        Texts for y in the tooltip. Default: numbers.
    notes
        Texts that follow the names in the legend.
    """
    names, made = labels(list(curves), 40), list[Line]()
    for (name, (x, y, *ends)), width in zip(curves.items(), line_widths(len(curves)), strict=True):
        shown = (texts or {}).get(name) or numbers(y)
        made.append(
            Line(
                x=x,
                y=y,
                color=styles[name].color,
                dashes=styles[name].dashes,
                width=width,
                low=ends[0] if ends else None,
                high=ends[1] if ends else None,
                label=names[name] + (notes or {}).get(name, ""),
                hover={"sampler": [name] * x.size, under[0]: numbers(x), under[1]: shown},
            )
        )
    return made


def numbers(values: Array | Iterable[float], digits: int = 4) -> list[str]:
    """Format values as texts."""
    return [number(float(value), digits) for value in values]


def not_finite(values: Array | float, data: xr.Dataset | None = None) -> str:
    """Return a text if values are not finite; infinity means that ∫1/p diverges.

    If `data` has infinite terms or an infinite ∫1/p, NaN values also count as infinite.
    """
    known = [] if data is None else [data[t].values for t in ("dc_term", "power_term") if t in data]
    level = 0.0 if data is None else float(data.attrs.get("random_level", 0.0))
    infinite = any(np.isinf(v).any() for v in (values, level, *known))
    return "infinite: ∫1/p diverges" if infinite else "not finite"


def intervals(ends: Array, digits: int = 4) -> list[str]:
    """Format intervals (k, 2) as texts."""
    return [interval(float(low), float(high), digits) for low, high in ends]


def along(data: xr.Dataset, dim: str) -> Iterator[tuple[str, xr.Dataset]]:
    """Yield the label and the slice for each index along a dim.

    If the result does not have the dim, yield a label and the whole result.
    """
    if dim not in data.dims:
        yield str(data.attrs.get(f"{dim}_spec", data.attrs.get(dim, dim))), data
        return
    for k in range(data.sizes[dim]):
        each = data.isel({dim: k})
        yield str(each[dim].values) if dim in each.coords else f"{dim} {k}", each


def method_of(one: xr.Dataset, channel: int = 0) -> str:
    """Return the method of a prediction with its details: ``torus (464 sets)``."""
    name, how = (str(one[key].item()) for key in ("method", "how"))
    known = not np.isnan(one["predicted_variance"].values.reshape(-1)[channel])
    return f"{name} ({how})" if known and how else name


def _place(dim: str, value: Any) -> str:
    """Return a short text for a coordinate: ``uniform``, ``not homogenized``, ``width 0.1``."""
    if value.dtype.kind == "b":
        return dim if value else f"not {dim}"
    return str(value) if value.dtype.kind == "U" else f"{dim} {value}"


def labelled(stored: xr.Dataset) -> xr.Dataset:
    """Return a stored result in which the attributes ``labels_*`` are text coordinates again."""
    texts = {
        str(key).removeprefix("labels_"): np.array(value)
        for key, value in stored.attrs.items()
        if str(key).startswith("labels_")
    }
    # If an array of labels has the name of a dim, it is the coordinate of this dim.
    # All other labels, such as verdicts, belong to a dim with as many entries.
    # Two labels belong to the dim "bound", which has size 2, unless another dim also has size 2.
    # The dim "bound" comes first in the list, so that other dims of size 2 replace it
    dims = sorted(map(str, stored.dims), key=lambda dim: dim != "bound")
    own: dict[tuple[int, ...], Any] = {
        texts[dim].shape: dim for dim in dims if dim in texts and dim != "bound"
    }
    own |= {(stored.sizes[dim],): dim for dim in dims if (stored.sizes[dim],) not in own}
    # A two-dimensional array of labels gets the dims of a variable of the same shape
    for values in stored.data_vars.values():
        if values.ndim > 1:
            own.setdefault(values.shape[:2], values.dims[:2])
    return stored.assign_coords(
        {
            name: (name if name in stored.dims else own[values.shape], values)
            for name, values in texts.items()
            if values.shape in own and stored.sizes.get(name, values.size) == values.size
        }
    )
