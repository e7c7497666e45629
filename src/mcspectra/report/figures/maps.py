"""Where in frequency the variance comes from: contributions, cross matrix, bands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.report.axes import signed_axis, signed_bar_ticks, signed_norm, threshold_note
from mcspectra.report.figures.groups import Group, as_group, frequency_dims
from mcspectra.report.figures.panels import GivenAxes, blocks_of
from mcspectra.report.style import (
    FAINT,
    GRAY,
    INK,
    LineStyle,
    entitle,
    labels,
    legend_below,
    outer_labels,
    quiet_colorbar,
    sampler_styles,
    say,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.colors import SymLogNorm
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

__all__ = [
    "band_covariances",
    "band_labels",
    "band_shares",
    "band_unit",
    "by_frequency",
    "contributions",
    "cross_matrices",
    "one_technique",
]

_DIVERGING = "RdBu_r"
_MOST_NUMBERS, _MOST_TICKS = 7, 13  # numbers and names of bands along an axis
_MOST_LETTERS = 16  # that fit unturned
_MOST_ENTRIES = 257  # entries a side of a matrix panel; more are not told apart


def contributions(
    data: Group, *, styles: Mapping[str, LineStyle] | None = None, axes: GivenAxes = None
) -> Figure:
    """Draw the contribution c_m of every frequency to the variance; the sum of all is the variance.

    One panel for each sampler and technique: a map in 2-D, bars over m in 1-D, bars over shells of
    |m| in more dims.

    Parameters
    ----------
    data
        ``contribution`` and ``power_contribution`` on m0, m1, … by sampler; of several channels
        the first is shown.
    styles
        How each sampler is drawn.
    axes
        Axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        Nothing to draw, or a variable is missing.
    """
    group = as_group(data, "contribution", "power_contribution")
    styles = styles or sampler_styles(list(group))
    first = next(iter(group.values()))
    two_dims = len(frequency_dims(first)) == 2
    techniques = max(each.sizes.get("technique", 1) for each in group.values())
    figure, blocks = blocks_of(axes, len(group), techniques, 1.0 if two_dims else 0.9)
    panels = []
    for (name, each), block, title in zip(
        group.items(), blocks, labels(list(group), 26).values(), strict=True
    ):
        for technique, panel in enumerate(block):
            panels.append((panel, one_technique(each, technique), styles[name]))
            entitle(panel, title if techniques == 1 else f"{title}, technique {technique}")
    if two_dims:
        _contribution_images(figure, [(panel, each) for panel, each, _ in panels])
    else:
        _contribution_bars(panels)
        legend_below(figure, panels[0][0])
    return figure


def cross_matrices(data: Group, *, axes: GivenAxes = None) -> Figure:
    """Draw conj(f_m) f_l C_ml of one-dimensional results, real and imaginary parts.

    Parameters
    ----------
    data
        ``cross_matrix(m, l)`` by sampler; of several channels the first is shown, of more than 257
        frequencies the inner ones.
    axes
        Axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        Nothing to draw, or a variable is missing.
    """
    group = as_group(data, "cross_matrix")
    inner = {name: _inner(each["cross_matrix"]) for name, each in group.items()}
    parts = {name: (m.values.real, m.values.imag) for name, m in inner.items()}
    norm = signed_norm([m.values.real for m in inner.values()])
    figure, blocks = blocks_of(axes, len(group), 2, 1.0)
    names = labels(list(group), 26)
    for (name, matrix), block in zip(inner.items(), blocks, strict=True):
        ends = _extent(matrix["m"].values)
        for panel, part, word in zip(block, parts[name], ("real", "imaginary"), strict=True):
            drawn = _image(panel, part, norm, ends)
            _mark_dc(panel)
            entitle(panel, f"{names[name]}: {word}")
            panel.set(xlabel="l", ylabel="m")
            outer_labels(panel)
    _signed_bar(figure, drawn, norm, "conj(fₘ) fₗ Cₘₗ")
    return figure


def band_covariances(
    data: Group, *, styles: Mapping[str, LineStyle] | None = None, axes: GivenAxes = None
) -> Figure:
    """Draw the covariance of band-limited estimates and, below, each band's share of the variance.

    Parameters
    ----------
    data
        ``band_covariance(band, band_other)`` by sampler; of several channels the first is shown.
    styles
        Not used: bars mean the same for every sampler.
    axes
        Axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        Nothing to draw, or the variable is missing.
    """
    del styles  # one legend for all panels: their colours are those of its two entries
    group = as_group(data, "band_covariance")
    matrices = {name: each["band_covariance"].values for name, each in group.items()}
    norm = signed_norm(list(matrices.values()))
    figure, blocks = blocks_of(axes, len(group), 2, 0.92)
    names = labels(list(group), 26)
    shares = {name: band_shares(matrix) for name, matrix in matrices.items()}
    for (name, matrix), (image, bars) in zip(matrices.items(), blocks, strict=True):
        drawn = _image(image, matrix, norm, (-0.5, len(matrix) - 0.5))
        entitle(image, names[name])
        unit = band_unit(group[name])
        image.set(xlabel=f"band b{unit}", ylabel=f"band a{unit}")
        outer_labels(image)
        _band_bars(bars, shares, name)
        bars.set_xlabel(f"band a{unit}")
        _band_ticks(image, bars, band_labels(group[name], len(matrix)))
    _signed_bar(figure, drawn, norm, "Cov(I_a, I_b)")
    legend_below(figure, blocks[0][1])
    return figure


def one_technique(data: xr.Dataset, technique: int) -> xr.Dataset:
    if "technique" not in data.dims:
        return data
    return data.isel(technique=min(technique, data.sizes["technique"] - 1))


def _contribution_images(figure: Figure, panels: list[tuple[Axes, xr.Dataset]]) -> None:
    maps = [each["contribution"].transpose("m0", "m1").values for _, each in panels]
    norm = signed_norm(maps)
    for (axes, each), values in zip(panels, maps, strict=True):
        drawn = _image(axes, values.T, norm, _extent(each["m0"].values))
        axes.set(xlabel="m₀", ylabel="m₁")
        outer_labels(axes)
    _signed_bar(figure, drawn, norm, "contribution cₘ")


def _contribution_bars(panels: list[tuple[Axes, xr.Dataset, LineStyle]]) -> None:
    """Draw what the power alone would give as a grey shape, the contribution as coloured bars."""
    curves = [by_frequency(each) for _, each, _ in panels]
    every = np.concatenate([values for _, *both in curves for values in both])
    shells = len(frequency_dims(panels[0][1])) > 1
    for (axes, _, style), (m, total, power) in zip(panels, curves, strict=True):
        scale = signed_axis(axes, "y", every, 6)
        axes.fill_between(
            m, power, step="mid", color=FAINT, lw=0, label="power part |fₘ|² Cₘₘ", zorder=1
        )
        axes.vlines(m, 0, total, style.color, lw=_bar_width(m), label="contribution cₘ", zorder=2)
        axes.axhline(0.0, color=GRAY, lw=0.6)
        axes.set_xlabel("shell |m| (rounded)" if shells else "frequency m")
        axes.set_ylabel(_with_scale("Σ cₘ in the shell" if shells else "cₘ", scale))
        axes.set_xlim(m[0] - 0.5, m[-1] + 0.5)
        outer_labels(axes)
        if not np.isfinite(total).any():
            say(axes, "infinite: ∫1/p diverges")


def by_frequency(data: xr.Dataset) -> tuple[Array, Array, Array]:
    """Frequencies, contributions and their power part: by m in 1-D, summed over shells otherwise."""
    dims = frequency_dims(data)
    total, power = (
        data[name].transpose(*dims).values for name in ("contribution", "power_contribution")
    )
    axes = [data[d].values.astype(float) for d in dims]
    if len(dims) == 1:
        return axes[0], total, power
    length = np.sqrt(sum(np.square(m) for m in np.meshgrid(*axes, indexing="ij")))
    shell = np.rint(length).astype(np.int64).ravel()
    # Shells beyond the half width are cut by the corners of the grid, and say little.
    keep = int(max(axes[0])) + 1
    summed = [np.bincount(shell, values.ravel())[:keep] for values in (total, power)]
    return np.arange(keep), summed[0], summed[1]


def band_shares(matrix: Array) -> tuple[Array, Array]:
    """Share of every band in the predicted variance: by itself, and through the other bands."""
    total = float(matrix.sum())
    if not np.isfinite(total) or total == 0:
        return np.full(len(matrix), np.nan), np.full(len(matrix), np.nan)
    own = np.diag(matrix) / total
    return own, matrix.sum(axis=1) / total - own


def band_unit(data: xr.Dataset) -> str:
    """What counts the bands: |m| where they are its shells, of other partitions nothing."""
    meaning = data["band"].attrs.get("long_name", "radial") if "band" in data.coords else "radial"
    return ", |m|" if "radial" in meaning else ""


def band_labels(data: xr.Dataset, count: int) -> list[str]:
    """What each band is called; its number where the result does not say."""
    attributes = data["band"].attrs if "band" in data.coords else {}
    names = str(attributes.get("labels", "")).split(", ")
    return names if len(names) == count else [str(band) for band in range(count)]


def _band_ticks(image: Axes, bars: Axes, names: list[str]) -> None:
    """Put names at whole bands: all of them, or every second, fourth, … where they are many."""
    stride = 1
    most = _MOST_NUMBERS if all(name.isdigit() for name in names) else _MOST_TICKS
    while len(names) / stride > most:
        stride *= 2
    shown = names[::stride]
    places = range(0, len(names), stride)
    turned = 90 if sum(map(len, shown)) > _MOST_LETTERS else 0
    image.set_yticks(places, shown)
    for axes in (image, bars):
        axes.set_xticks(places, shown, rotation=turned)


def _band_bars(axes: Axes, shares: Mapping[str, tuple[Array, Array]], name: str) -> None:
    own, through = shares[name]
    band = np.arange(len(own))
    scale = signed_axis(axes, "y", np.concatenate([v for both in shares.values() for v in both]), 6)
    axes.vlines(band - 0.2, 0, own, GRAY, lw=_bar_width(band), label="within the band")
    axes.vlines(band + 0.2, 0, through, INK, lw=_bar_width(band), label="with other bands")
    axes.axhline(0.0, color=GRAY, lw=0.6)
    axes.set_ylabel(_with_scale("share of variance", scale))
    axes.set_xlim(-0.7, len(own) - 0.3)
    if len(shares) > 1:
        outer_labels(axes)
    if not np.isfinite(own).any():
        say(axes, "no finite share")


def _bar_width(positions: Array) -> float:
    return float(np.clip(110.0 / len(positions), 0.5, 5.0))


def _with_scale(label: str, scale: str) -> str:
    return f"{label}\n({scale})" if scale else label


def _image(axes: Axes, values: Array, norm: SymLogNorm, ends: tuple[float, float]) -> AxesImage:
    if not np.isfinite(values).any():
        say(axes, "infinite: ∫1/p diverges")
    drawn = axes.imshow(
        values,
        origin="lower",
        extent=(*ends, *ends),
        norm=norm,
        cmap=_DIVERGING,
        interpolation="nearest",
    )
    ticks = sorted({ends[0] + 0.5, 0.0, ends[1] - 0.5})
    axes.set(xticks=ticks, yticks=ticks)
    return drawn


def _signed_bar(figure: Figure, drawn: AxesImage, norm: SymLogNorm, label: str) -> None:
    images = [axes for axes in figure.axes if axes.images]
    bar = figure.colorbar(drawn, ax=images, shrink=0.85, aspect=24, pad=0.02)
    signed_bar_ticks(bar, norm)
    quiet_colorbar(bar, f"{label}\n({threshold_note(float(norm.linthresh))})")


def _mark_dc(axes: Axes) -> None:
    """Frame the row and the column of frequency 0."""
    for edge in (-0.5, 0.5):
        axes.axhline(edge, color=GRAY, lw=0.4)
        axes.axvline(edge, color=GRAY, lw=0.4)


def _inner(matrix: xr.DataArray) -> xr.DataArray:
    """The matrix around dc, as large as a panel can show."""
    if matrix.dims[-2:] != ("m", "l") or "m_0" in matrix.coords:
        raise ParameterError(
            "The cross matrix is drawn for one-dimensional results of one technique only; "
            "use contributions or band_covariances."
        )
    cut = max(matrix.sizes["m"] - _MOST_ENTRIES, 0) // 2
    inside: Any = slice(cut, matrix.sizes["m"] - cut)
    return matrix.isel(m=inside, l=inside)


def _extent(m: Array) -> tuple[float, float]:
    return float(m[0]) - 0.5, float(m[-1]) + 0.5
