"""Plots over frequency: power spectra, pair correlations, Markov chains, and contributions.

Power is shown as n · power, so that random points have the value 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.core.errors import ParameterError
from mcspectra.plots.description import (
    Axis,
    BarChart,
    Dots,
    Heatmap,
    Line,
    Mark,
    Panel,
    Plot,
    ReferenceLine,
    Scale,
    TextMark,
)
from mcspectra.plots.groups import (
    Group,
    Styles,
    abreast,
    for_each,
    frequency_dims,
    intervals,
    lines_of,
    not_finite,
    numbers,
    point_dims,
    root_of_n,
    shared,
)
from mcspectra.plots.scales import (
    linear_axis,
    log_axis,
    log_scale,
    signed_axis,
    signed_scale,
    tick_label,
    whole_ticks,
)
from mcspectra.plots.style import FAINT, GRAY, INK, labels, sampler_styles
from mcspectra.plots.text import NEGLIGIBLE, number, percent

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "anisotropy",
    "bands",
    "chains",
    "contributions",
    "cross_matrix",
    "frequency_map",
    "lines",
    "modes",
    "pair_correlation",
    "product",
    "radial",
    "relative_power",
    "spectrum",
]

_FLOOR = 1e-4  # smallest power that is shown; below it there is practically no noise
_LINEAR_TOP = 12.0  # largest power that is shown on a linear axis
_MOST_NUMBERS, _MOST_NAMES = 7, 13  # how many numbers, or how many names, may label an axis
_MOST_ENTRIES = 257  # largest number of entries along each side of a matrix that is drawn
_MOST_CHAINS = 6  # largest number of quantities of Markov chains in one plot
_SPACINGS = 6.0  # largest distance that is shown, in units of the mean spacing of points
_TEXT_WIDTH = 0.16  # width of a text "slope 1", relative to the panel
_TEXT_HEIGHT = 1.7  # factor from a line to the middle of the text next to it
_SLOPES = (1, 2, 4)  # slopes of the guide lines for the radial mean
_LEVEL = "expected power relative to random points (∫1/p / n); m = 0 is omitted."


def spectrum(group: Group, _: Styles, *, logarithmic: bool = False) -> Plot:
    """Plot two-dimensional power spectra on a common color scale, without the value at m = 0.

    If `logarithmic` is true, the scale has three decades. Smaller powers have the lowest color.
    """
    images = {name: relative_power(each) for name, each in group.items()}
    # The scale ends at 2, or at the 99th percentile if that is larger
    every = np.concatenate([np.ravel(values) for values in images.values()])
    top = max(2.0, float(np.percentile(np.append(0.0, every[np.isfinite(every)]), 99.0)))
    scale = Scale(label=_power_label(group), low=0.0, high=top, beyond=True)
    if logarithmic:
        scale = replace(log_scale(scale.label, 1e-3 * top, top), beyond=True)
        images = {name: np.maximum(values, scale.low) for name, values in images.items()}
    panels = [
        frequency_map(name, group[name], values, scale, "power") for name, values in images.items()
    ]
    return Plot(
        panels=tuple(panels),
        columns=abreast(len(panels)),
        caption=f"Power spectra on one color scale: {_LEVEL}",
        words="Maps of the power over the frequencies m₀ and m₁. " + for_each(group, _power_words),
        height=1.0,
        share=shared(panels),
    )


def lines(group: Group, styles: Styles) -> Plot:
    """Plot one-dimensional power spectra over m, without m = 0, with the level of random points."""
    curves = {n: (d["m0"].values.astype(float), relative_power(d)) for n, d in group.items()}
    hover = {}
    for name, each in group.items():
        half = each["power_se"].values if "power_se" in each else np.zeros(each.sizes["m0"])
        half = each.attrs.get("student_t", CONFIDENCE_Z) * half
        half *= _points(each) / _random_level(each)
        power = curves[name][1]
        hover[name] = [
            number(float(p), 4) + (f" ± {number(float(h), 2)}" if h > 0 else "")
            for p, h in zip(power, half, strict=True)
        ]
    axis = Axis(label="frequency m (cycles per unit)")
    return Plot(
        panels=(_power_panel(group, curves, styles, hover, axis),),
        caption=f"Power spectra: {_LEVEL}",
        words="Power against frequency m. " + for_each(group, _power_words),
    )


def radial(group: Group, styles: Styles) -> Plot:
    """Plot the power averaged over directions, against |m| in units of n^(1/d)."""
    curves = {}
    for name, each in group.items():
        n, dims = _points(each), len(frequency_dims(each))
        power = n / _random_level(each) * each["radial_power"].values
        curves[name] = (each["radius"].values / n ** (1 / dims), power)
    every = np.concatenate([x[x > 0] for x, _ in curves.values()])
    label = f"frequency |m| / {root_of_n(dims)}"
    axis = log_axis(label, float(every.min(initial=1.0)), float(every.max(initial=1.0)))
    hover = {name: numbers(power) for name, (_, power) in curves.items()}
    panel = _with_guides(_power_panel(group, curves, styles, hover, axis))
    return Plot(
        panels=(panel,),
        caption="Mean power over all directions against the length of the frequency, in units of "
        "n^(1/d). The slope at low frequencies determines the rate; dotted lines are guides."
        + (
            " In three or more dims it replaces an image of the whole spectrum." if dims > 2 else ""
        ),
        words="Logarithmic plot of n times the radial mean power. " + for_each(group, _power_words),
    )


def pair_correlation(group: Group, styles: Styles) -> Plot:
    """Plot the pair correlation g(r) with its 95 % interval and the level of random points.

    Distances are in mean spacings n^(−1/d), so that sets of different sizes are comparable.
    """
    curves, dims = {}, 1
    for name, each in group.items():
        g, ends = (each[f"pair_correlation{part}"].values for part in ("", "_ci"))
        dims = point_dims(each)
        r = each["r"].values * _points(each) ** (1.0 / dims)
        near = r <= _SPACINGS
        curves[name] = (r[near], g[near], *ends[near].T)
    found: list[Mark] = [ReferenceLine(at=1.0), *lines_of(curves, styles, ("r", "g"))]
    x = Axis(label=f"distance r · {root_of_n(dims)} (mean spacings)", low=0.0)
    y = Axis(label="pair correlation g(r)   (random: 1)", low=0.0)
    panel = Panel(marks=tuple(found), x=x, y=y, grid=True)
    return Plot(
        panels=(panel,),
        caption="Pair correlation g(r) of the points before any warp: density of points at "
        "distance r from another point, relative to random points, with 95 % intervals. "
        "Distances are in mean spacings n^(−1/d).",
        words="Pair correlation against the distance. " + for_each(group, _pair_words),
        height=0.52,
    )


def anisotropy(group: Group, styles: Styles) -> Plot:
    """Plot the variance of the power over directions in dB, relative to random points.

    If the power of random points is averaged over k sets, its variance is mean² / k.
    The level of random points is 0 dB, so that results from any numbers of sets are comparable.
    """
    curves, dims = {}, 1
    for name, each in group.items():
        dims = point_dims(each)
        level = 10.0 * np.log10(float(each["spectrum_sets"]))
        curves[name] = (
            each["radius"].values / _points(each) ** (1.0 / dims),
            each["anisotropy_db"].values + level,
        )
    every = np.concatenate([x for x, _ in curves.values()])
    x = log_axis(f"frequency |m| / {root_of_n(dims)}", float(every.min()), float(every.max()))
    found = np.concatenate([y[np.isfinite(y)] for _, y in curves.values()])
    low, high = float(found.min(initial=-10.0)), float(found.max(initial=10.0))
    y = linear_axis("anisotropy (dB)   (random: 0)", low, high)
    marks: list[Mark] = [ReferenceLine(at=0.0), *lines_of(curves, styles, ("|m|", "dB"))]
    return Plot(
        panels=(Panel(marks=tuple(marks), x=x, y=y, grid=True),),
        caption="Anisotropy: variance of the power over directions / mean², in dB. "
        "0 dB is the level of random points, which noise alone causes.",
        words="Anisotropy against the length of the frequency. "
        + for_each(group, lambda d: f"largest {number(float(d['anisotropy_db'].max()))} dB"),
    )


def contributions(group: Group, styles: Styles) -> Plot:
    """Plot the contribution of each frequency to the variance: as maps in 2-D, otherwise as bars.

    There is one panel per sampler and technique.
    The gray area is the contribution of the power term alone, without correlations.
    In three or more dims, bars are sums over shells of |m|.
    """
    first = next(iter(group.values()))
    dims, techniques = len(frequency_dims(first)), first.sizes.get("technique", 1)
    parts = [
        (f"{name}, technique {t}" if techniques > 1 else name, name, one)
        for name, each in group.items()
        for t in range(techniques)
        for one in [each.isel(technique=t) if "technique" in each.dims else each]
    ]
    panels, bases = [], _bases(group)
    if dims == 2:
        values = [one["contribution"].transpose("m0", "m1").values for *_, one in parts]
        scale = signed_scale("contribution cₘ", values)
        for (title, name, one), each in zip(parts, values, strict=True):
            power = one["power_contribution"].transpose("m0", "m1").values
            panel = frequency_map(title, one, each, scale, "contribution", power)
            x = replace(panel.x, label=f"{panel.x.label}{bases[name]}")
            panels.append(replace(panel, x=x))
    else:
        curves = [_by_frequency(one) for *_, one in parts]
        label = "cₘ" if dims == 1 else "Σ cₘ in the shell"
        axis = signed_axis(label, [values for _, *both in curves for values in both], 6)
        for (title, name, one), (m, total, power) in zip(parts, curves, strict=True):
            shown = {
                "sampler": [title] * m.size,
                "m" if dims == 1 else "|m|": numbers(m),
                "contribution": numbers(total),
                "power part": numbers(power),
            }
            low, high = float(m[0]) - 0.5, float(m[-1]) + 0.5
            below = "frequency m" if dims == 1 else "shell |m| (rounded)"
            marks = (
                Line(x=m, y=power, low=np.zeros(m.size), high=power, color=FAINT, width=0.0,
                     step=True, label="power part |fₘ|² Cₘₘ"),
                BarChart(at=m, value=total, color=styles[name].color, thickness=0.0, hover=shown),
                ReferenceLine(at=0.0, width=0.6),
            )  # fmt: skip
            panels.append(
                Panel(
                    marks=marks,
                    x=Axis(
                        label=f"{below}{bases[name]}",
                        low=low,
                        high=high,
                        ticks=whole_ticks(low, high),
                    ),
                    y=axis,
                    title=title,
                    note="" if np.isfinite(total).any() else not_finite(total, one),
                )
            )
    what = {1: "at each frequency m", 2: "of each frequency (m₀, m₁)"}.get(
        dims, f"of each shell of |m| (in {dims} dims the frequencies of a shell are summed)"
    )
    return Plot(
        panels=tuple(panels),
        columns=techniques if 1 < techniques <= 3 else abreast(len(panels)),
        caption=f"Contribution {what} to the variance. The contributions sum to the predicted "
        "variance; negative ones reduce it."
        + (" Each technique has its own panel." if techniques > 1 else ""),
        words="Signed contribution of each frequency to the variance. "
        + for_each(group, _peak_words),
        height=1.0 if dims == 2 else 0.75 if len(panels) > 1 else 0.5,
        share=shared(panels),
    )


def product(group: Group, styles: Styles) -> Plot:
    """Plot the power of f, the power of the samples, and their product, by length of the frequency.

    Each value belongs to a shell of |m|. The power of f is summed over the shell.
    The power of the samples is averaged over the shell with the weights |f_m|².
    Power of f times power of samples is therefore exactly what the shell adds to the power term.
    """
    f, s, both, notes = {}, {}, {}, {}
    for name, each in group.items():
        lengths, of_f, products = _shells(each)
        f[name] = lengths, of_f
        with np.errstate(divide="ignore", invalid="ignore"):
            s[name] = lengths, _points(each) * np.where(of_f > 0, products / of_f, np.nan)
        both[name] = lengths, products
        notes[name] = f": sum {number(float(products.sum()), 3)}"
    first = next(iter(group))
    curve = Line(
        x=f[first][0], y=_above(f[first][1], f[first][1]), color=INK, width=1.2,
        hover={"|m|": numbers(f[first][0]), "P_f": numbers(f[first][1])},
    )  # fmt: skip
    label = "|m|"
    low, high = float(f[first][0][0]), float(f[first][0][-1])
    x = Axis(label=label, low=low - 0.5, high=high + 0.5, ticks=whole_ticks(low, high))
    panels = [
        Panel(
            marks=(curve,), x=x, y=_log_axis_of("", [curve.y]), grid=True,
            title="P_f (integrand)",
        )
    ]  # fmt: skip
    for title, curves, said in (
        ("n · P_S (samples)", s, None),
        ("P_S · P_f", both, notes),
    ):
        top = np.concatenate([y for _, y in curves.values()])
        shown = {name: (at, _above(y, top)) for name, (at, y) in curves.items()}
        own = lines_of(shown, styles, (label, "value"), notes=said)
        marks: list[Mark] = list(own)
        if said is None:  # the legend lists each sampler once
            marks = [ReferenceLine(at=1.0), *(replace(line, label="") for line in own)]
        axis = _log_axis_of("", [y for _, y in shown.values()])
        note = "" if np.isfinite(top).any() else not_finite(top, group[first])
        panels.append(Panel(marks=tuple(marks), x=x, y=axis, title=title, grid=True, note=note))
    return Plot(
        panels=tuple(panels),
        columns=3,
        caption="The power of f times the power of the samples, by the length of the frequency. "
        "The sum of the products is the power term of the variance. A dip of one power removes a "
        "peak of the other.",
        words="Power of f, power of samples and their product. "
        + for_each(group, lambda d: f"products sum to {number(float(_shells(d)[2].sum()), 4)}"),
        height=0.9,
        wide=True,
    )


def _shells(data: xr.Dataset) -> tuple[Array, Array, Array]:
    """Return the lengths |m| ≥ 1, and |f_m|² and |f_m|² C_mm summed over shells and techniques."""
    dims = frequency_dims(data)
    kept = [d for d in ("technique",) if d in data.dims]
    grid = np.meshgrid(*[data[d].values.astype(float) for d in dims], indexing="ij")
    shell = np.rint(np.sqrt(sum(np.square(m) for m in grid))).astype(np.int64).ravel()
    last = int(max(data[dims[0]].values)) + 1  # shells of a larger radius are incomplete
    found = [
        np.bincount(shell, data[name].sum(kept).transpose(*dims).values.ravel())[1:last]
        for name in ("integrand_power", "power_contribution")
    ]
    return np.arange(1.0, last), found[0], found[1]


def _above(values: Array, every: Array) -> Array:
    """Return values for a logarithmic axis: NaN if they are only rounding errors of the largest."""
    top = float(np.max(every, where=np.isfinite(every), initial=0.0))
    return np.where(values > NEGLIGIBLE * top, values, np.nan)


def _log_axis_of(label: str, curves: Sequence[Array]) -> Axis:
    every = np.concatenate(list(curves))
    every = every[np.isfinite(every) & (every > 0)]
    return log_axis(label, float(every.min(initial=1.0)), float(every.max(initial=0.0)), 5)


def bands(group: Group, _: Styles) -> Plot:
    """Plot the covariance between frequency bands, and the share of each band in the variance."""
    matrices = {name: each["band_covariance"].values for name, each in group.items()}
    scale = signed_scale("Cov(I_a, I_b)", list(matrices.values()))
    shares = {name: _band_shares(matrix) for name, matrix in matrices.items()}
    # Shares add up to 1, which can be seen only on a linear axis
    every = np.concatenate([v[np.isfinite(v)] for both in shares.values() for v in both])
    low, high = float(every.min(initial=0.0)), float(every.max(initial=0.0)) or 1.0
    room = 0.06 * (high - low)
    axis = Axis(label="share of variance", low=low - room * (low < 0), high=high + room)
    panels = []
    for name, matrix in matrices.items():
        attributes = group[name]["band"].attrs if "band" in group[name].coords else {}
        unit = ", |m|" if "radial" in attributes.get("long_name", "radial") else ""
        count, (own, through) = len(matrix), shares[name]
        names = str(attributes.get("labels", "")).split(", ")
        names = names if len(names) == count else [str(band) for band in range(count)]
        # Label every band, or every second, fourth, … band if there are many
        most, stride = _MOST_NUMBERS if all(n.isdigit() for n in names) else _MOST_NAMES, 1
        while count / stride > most:
            stride *= 2
        ticks = {float(k): names[k] for k in range(0, count, stride)}
        at = np.arange(float(count))
        each = {"share of band a alone": own, "share of band a with others": through}
        marks = [
            BarChart(
                at=at + side,
                value=part,
                color=color,
                thickness=0.4,
                label=label,
                hover={"band": names, "share": [_share(s) for s in part]},
            )
            for side, part, color, label in (
                (-0.2, own, GRAY, "within the band"),
                (0.2, through, INK, "with other bands"),
            )
        ]
        panels.append(
            Panel(
                marks=(*marks, ReferenceLine(at=0.0, width=0.6)),
                x=Axis(label=f"band a{unit}", low=-0.7, high=count - 0.3, ticks=ticks),
                y=axis,
                title=name,
                note="" if np.isfinite(own).any() else "no finite share",
            )
        )
        image = Heatmap(
            values=matrix,
            x=at,
            y=at,
            scale=scale,
            name="covariance",
            hover={title: np.broadcast_to(v[:, None], matrix.shape) for title, v in each.items()},
        )
        finite = np.isfinite(matrix).any()
        panels.append(
            Panel(
                marks=(image,),
                x=Axis(label=f"band b{unit}", low=-0.5, high=count - 0.5, ticks=ticks),
                y=Axis(label=f"band a{unit}", low=-0.5, high=count - 0.5, ticks=ticks),
                title=name,
                square=True,
                note="" if finite else not_finite(matrix, group[name]),
            )
        )
    first = next(iter(group.values()))
    meaning = str(first["band"].attrs.get("long_name", "")) if "band" in first.coords else ""
    meaning = (
        meaning.removeprefix("band (").removesuffix(")") or "shells of |m|, one frequency wide"
    )
    return Plot(
        panels=tuple(panels),
        columns=2,
        caption=f"Covariance between bands of frequencies ({meaning}): orange pairs add variance, "
        "blue pairs remove it. Bars: each band's share of the predicted variance, alone and "
        "through covariance with other bands. All bars add up to 1.",
        words="Matrix of covariances between frequency bands. " + for_each(group, _band_words),
        height=0.92,
        wide=not all(name.isdigit() for name in names),
    )


def cross_matrix(group: Group, _: Styles) -> Plot:
    """Plot the real and imaginary parts of the cross matrix conj(f_m) f_l C_ml, for 1-D results."""
    inner = {}
    for name, each in group.items():
        matrix = each["cross_matrix"]
        if matrix.dims[-2:] != ("m", "l") or {"m_0", "m_technique"} & set(map(str, matrix.coords)):
            raise ParameterError(
                "The cross matrix is drawn only for one-dimensional results of one technique; use "
                "the kind contributions or bands."
            )
        # Crop the matrix around m = 0 to the size of a panel. Without negative m, keep the lowest m
        m = matrix["m"].values
        start = max(m.size - _MOST_ENTRIES, 0) // 2 if m[0] < 0 else 0
        inside: Any = slice(start, m.size - start if m[0] < 0 else _MOST_ENTRIES)
        inner[name] = matrix.isel(m=inside, l=inside)
    scale = signed_scale("conj(fₘ) fₗ Cₘₗ", [matrix.values.real for matrix in inner.values()])
    panels, bases = [], _bases(group)
    for name, matrix in inner.items():
        m = matrix["m"].values.astype(float)
        ends = {"low": float(m[0]) - 0.5, "high": float(m[-1]) + 0.5, "ticks": _frequency_ticks(m)}
        # Draw a frame around the row and the column of frequency 0
        dc = [
            ReferenceLine(at=at, axis=axis, width=0.4) for at in (-0.5, 0.5) for axis in ("x", "y")
        ]
        for part, word in ((matrix.values.real, "real"), (matrix.values.imag, "imaginary")):
            panels.append(
                Panel(
                    marks=(Heatmap(values=part, x=m, y=m, scale=scale, name=f"{word} part"), *dc),
                    x=Axis(label=f"l{bases[name]}", **ends),  # type: ignore[arg-type]
                    y=Axis(label=f"m{bases[name]}", **ends),  # type: ignore[arg-type]
                    title=f"{word}: {name}",
                    square=True,
                    note="" if np.isfinite(part).any() else not_finite(part, group[name]),
                )
            )
    return Plot(
        panels=tuple(panels),
        columns=2,
        caption="Cross matrix conj(fₘ) fₗ Cₘₗ. Its sum is the predicted variance, its diagonal is "
        "the power term, and the framed row and column belong to frequency 0.",
        words="Real and imaginary parts of the cross matrix, with marks on the diagonal m = l and "
        f"on the row and column of dc, for {', '.join(group)}.",
        height=1.0,
        share=shared(panels),
    )


def modes(group: Group, styles: Styles) -> Plot:
    """Plot eigenvalues of the coefficients' covariance, and in 1-D and 2-D the leading modes."""
    most = 2  # number of modes that are drawn
    first = next(iter(group.values()))
    dims = frequency_dims(first)
    values = {name: np.abs(each["mode_vector"].values[:most]) ** 2 for name, each in group.items()}
    scale = Scale(
        label="|mode|²",
        low=0.0,
        high=max(float(np.nanmax(v, initial=0.0)) for v in values.values()) or 1.0,
    )
    panels = []
    for name, each in group.items():
        size, color = each["eigenvalue"].values, styles[name].color
        at, spread = np.arange(float(size.size)), CONFIDENCE_Z * each["eigenvalue_se"].values
        share = [_share(s) for s in each["eigenvalue_share"].values]
        shown = {"mode": numbers(at), "eigenvalue": numbers(size), "share of the trace": share}
        dots = Dots(
            x=at,
            y=np.where(size > 0, size, np.nan),
            color=color,
            marker=styles[name].marker,
            low=np.where(size > spread, size - spread, np.nan),
            high=size + spread,
            label="eigenvalue, with its 95 % interval",
            hover=shown,
        )
        edge = float(each["noise_edge"]) if "noise_edge" in each else np.nan
        rule = (
            [ReferenceLine(at=edge, dashes="--", label="largest of pure noise")] if edge > 0 else []
        )
        every = np.array([*size, *(size + spread), *(r.at for r in rule)])
        every = every[np.isfinite(every) & (every > 0)]
        axis = log_axis("eigenvalue", float(every.min(initial=np.inf)), float(every.max(initial=0)))
        ticks = {float(k): str(k) for k in range(0, size.size, max(1, size.size // 6))}
        modes_axis = Axis(label="mode", low=-0.6, high=size.size - 0.4, ticks=ticks)
        panels.append(Panel(marks=(*rule, dots), x=modes_axis, y=axis, title=name, grid=True))
        for k, mode in enumerate(values[name] if len(dims) <= 2 else ()):
            title = f"mode {k}, {share[k]}"
            if len(dims) == 2:
                panels.append(frequency_map(title, each, mode, scale, "|mode|²"))
                continue
            m = each[dims[0]].values.astype(float)
            line = Line(x=m, y=mode, color=color, step=True)
            panels.append(
                Panel(
                    marks=(line,), x=Axis(label="frequency m"), y=Axis(label="|mode|²"), title=title
                )
            )
    return Plot(
        panels=tuple(panels),
        columns=len(panels) // len(group),
        caption="Leading eigenvalues of the covariance of the coefficients, the largest eigenvalue "
        "expected from pure noise, and the frequencies of the first modes.",
        words="Eigenvalues of the covariance. "
        + for_each(group, lambda d: ", ".join(numbers(d["eigenvalue"].values[:3], 3))),
        height=0.95 if len(dims) == 2 else 0.62,
        wide=len(panels) > len(group),
    )


def chains(group: Group, styles: Styles) -> Plot:
    """Plot spectra of Markov chains with fits, and the share of each band in error and variance.

    If there are many quantities, those with the smallest effective sample sizes are shown.
    """
    # Draw one curve per quantity of each result
    single: dict[str, xr.Dataset] = {}
    for name, each in group.items():
        own = name if len(group) > 1 else ""
        if "quantity" not in each.dims:
            single[own or "chains"] = each
        for k in range(each.sizes.get("quantity", 0)):
            one = each.isel(quantity=k)
            single[", ".join(filter(None, [own, str(one["quantity"].item())]))] = one
    worst = sorted(single, key=lambda name: float(single[name]["ess"].fillna(-1.0)))[:_MOST_CHAINS]
    shown = {name: each for name, each in single.items() if name in worst}
    styles = styles if shown.keys() <= styles.keys() else sampler_styles(list(shown))
    names, levels = labels(list(shown), 40), [np.empty(0)]
    spectra: list[Mark] = []
    shares: list[Mark] = []
    for name, each in shown.items():
        low, high = each["band_low"].values, each["band_high"].values
        x = np.sqrt(np.maximum(low, high / 2) * high)  # the lowest band starts at 0
        error, draw, measured, fitted = (
            each[key].values
            for key in ("error_share", "draw_share", "chain_spectrum", "fitted_spectrum")
        )
        ends, color, label = each["chain_spectrum_ci"].values, styles[name].color, names[name]
        levels += [measured[measured > 0], fitted[fitted > 0]]
        hover = {
            "chain": [name] * x.size,
            "period in draws": list(map(str, each["band"].values)),
            "spectrum": numbers(measured),
            "95 %": intervals(ends),
            "share of the error": numbers(error, 3),
            "share of the draws": numbers(draw, 3),
        }
        dots = Dots(x=x, y=measured, color=color, marker=styles[name].marker, hover=hover)
        spectra.append(Line(x=x, y=fitted, color=color, label=label))
        spectra.append(replace(dots, low=ends[:, 0], high=ends[:, 1], label=label))
        shares.append(Line(x=x, y=draw, color=color, dashes=":", label=""))
        shares += [Line(x=x, y=error, color=color, label=label), replace(dots, y=error)]
    every = np.concatenate(levels)
    least, most = (float(every.min()), float(every.max())) if every.size else (1.0, 1.0)
    bottom = min(float(each["band_high"].values[0]) for each in shown.values()) / 2
    axis, hidden = log_axis("frequency in cycles per draw", bottom, 0.5), len(single) - len(shown)
    density = log_axis("spectral density S", least / 3, 3 * most)
    still = "" if every.size else "the chains do not move"
    return Plot(
        panels=(
            Panel(marks=tuple(spectra), x=axis, y=density, grid=True, note=still),
            Panel(
                marks=tuple(shares), x=axis, y=Axis(label="share", low=0.0, high=1.05), grid=True
            ),
        ),
        caption="Top: spectrum of the chains in time, measured in octaves with 95 % intervals, and "
        "its fit. Bottom: share of each octave in the squared error of the mean, and (dotted) in "
        "the variance of the draws."
        + (f" {hidden} quantities with more effective draws are omitted." if hidden else ""),
        words="Spectra of chains in time and shares of the error by frequency. "
        + for_each(
            shown, lambda d: f"effective draws {number(float(d['ess']))}, {d['cause'].item()}"
        ),
        height=0.5,
        share="x",
    )


def _bases(group: Group) -> dict[str, str]:
    """Return the basis as a suffix for frequency labels, if there are several bases."""
    found = {name: str(each.attrs.get("basis", "fourier")) for name, each in group.items()}
    several = len(set(found.values())) > 1
    return {name: f" ({basis} basis)" if several else "" for name, basis in found.items()}


def relative_power(data: xr.Dataset) -> Array:
    """Return n · power, which is 1 for random points, over (m0, m1, …), with NaN at m = 0."""
    names = frequency_dims(data)
    scale = _points(data) / _random_level(data)
    power = np.array(scale * data["power"].transpose(*names).values)
    power[tuple(size // 2 for size in power.shape)] = np.nan
    return power


def _points(data: xr.Dataset) -> int:
    """Return the number of points n of a spectrum. A bench has one number per sampler."""
    return int(data.attrs["n"] if "n" in data.attrs else data["pictured_n"])


def _random_level(data: xr.Dataset) -> float:
    """Return ∫1/p, which is n · power of random points with density p, or 1 if it diverges."""
    level = float(data.attrs.get("random_level", 1.0))
    return level if np.isfinite(level) else 1.0


def _power_label(group: Group) -> str:
    weighted = any(_random_level(each) != 1.0 for each in group.values())
    return f"n · ⟨|Sₘ|²⟩{' / ∫1/p' if weighted else ''}   (random: 1)"


def _power_panel(
    group: Group,
    curves: Mapping[str, tuple[Array, Array]],
    styles: Styles,
    hover: Mapping[str, Sequence[str]],
    axis: Axis,
) -> Panel:
    """Return a panel with lines of power, logarithmic for high peaks or a logarithmic x axis."""
    every = np.concatenate([y[np.isfinite(y)] for _, y in curves.values()])
    top, low = float(every.max(initial=1.5)), float(every.min(initial=0.5))
    logarithmic = axis.kind == "log" or top > _LINEAR_TOP
    shown = {n: (x, np.maximum(y, _FLOOR) if logarithmic else y) for n, (x, y) in curves.items()}
    under = (axis.label.partition(" ")[0], "power")
    marks: list[Mark] = [ReferenceLine(at=1.0), *lines_of(shown, styles, under, texts=hover)]
    label = _power_label(group)
    power = Axis(label=label, low=0.0, high=1.08 * top)
    if logarithmic:
        power = log_axis(label, max(low, _FLOOR), top)
        if low < _FLOOR:
            ticks = {**(power.ticks or {}), _FLOOR: f"≤ {tick_label(_FLOOR)}"}
            power = replace(power, ticks=ticks)
    note = "" if every.size else "not finite"
    return Panel(marks=tuple(marks), x=axis, y=power, grid=True, note=note)


def _with_guides(panel: Panel) -> Panel:
    """Return a logarithmic panel with dotted guide lines of a few slopes through (1, 1)."""
    low, left = panel.y.low, panel.x.low
    if panel.y.kind != "log" or not low or not left or low > 0.3 or left > 0.5:
        return panel
    marks: list[Mark] = []
    for slope in _SLOPES:
        start = max(left * 1.15, (1.3 * low) ** (1.0 / slope))
        at = np.array([start, 1.0])
        marks.append(Line(x=at, y=at**slope, color=GRAY, dashes=":", width=0.8))
        # Place the text above or below the line, where it is farthest from all curves
        places = [
            (_distance(panel, x, tall * x**slope), x, tall)
            for tall in (1.0 / _TEXT_HEIGHT, _TEXT_HEIGHT)
            for x in map(float, start ** np.linspace(0.9, 0.45, 10))
        ]
        _, x, tall = max(places)
        marks.append(
            TextMark(
                x=x,
                y=tall**0.55 * x**slope,
                text=f"slope {slope}",
                color=GRAY,
                side="below" if tall < 1.0 else "above",
            )
        )
    return replace(panel, marks=(*marks, *panel.marks))


def _distance(panel: Panel, x: float, y: float) -> float:
    """Return the smallest |ln y' − ln y| over the curves within the width of a short text at x."""
    span = math.log(panel.x.high / panel.x.low) if panel.x.low and panel.x.high else 1.0
    at = math.log(x) + _TEXT_WIDTH * span * np.linspace(-0.5, 0.5, 7)
    smallest = math.inf
    for mark in panel.marks:
        if isinstance(mark, Line):
            known = (mark.y > 0) & (mark.x > 0)
            if known.any():
                curve = np.interp(at, np.log(mark.x[known]), np.log(mark.y[known]))
                smallest = min(smallest, float(np.abs(curve - math.log(y)).min()))
    return smallest


def frequency_map(
    title: str, data: xr.Dataset, values: Array, scale: Scale, name: str, power: Array | None = None
) -> Panel:
    """Return a panel that maps values (m0, m1) over both frequencies."""
    m0, m1 = (data[m].values.astype(float) for m in ("m0", "m1"))
    more = {} if power is None else {"power part": power.T}
    x, y = (
        Axis(
            label=f"{label} (cycles)",
            low=1.5 * float(m[0]) - 0.5 * float(m[1]) if m.size > 1 else None,
            high=1.5 * float(m[-1]) - 0.5 * float(m[-2]) if m.size > 1 else None,
            ticks=_frequency_ticks(m),
        )
        for label, m in (("m₀", m0), ("m₁", m1))
    )
    return Panel(
        marks=(Heatmap(values=values.T, x=m0, y=m1, scale=scale, name=name, hover=more),),
        x=x,
        y=y,
        title=title,
        square=True,
        note="" if np.isfinite(values).any() else not_finite(values, data),
    )


def _frequency_ticks(m: Array) -> dict[float, str]:
    return {float(t): f"{t:g}".replace("-", "−") for t in sorted({m[0], 0.0, m[-1]})}


def _by_frequency(data: xr.Dataset) -> tuple[Array, Array, Array]:
    """Return frequencies, their contributions to the variance, and their parts of the power term.

    In 1-D, each frequency has its own values. In more dims, values are summed over shells of |m|.
    """
    dims = frequency_dims(data)
    total, power = (
        data[name].transpose(*dims).values for name in ("contribution", "power_contribution")
    )
    axes = [data[d].values.astype(float) for d in dims]
    if len(dims) == 1:
        return axes[0], total, power
    length = np.sqrt(sum(np.square(m) for m in np.meshgrid(*axes, indexing="ij")))
    shell = np.rint(length).astype(np.int64).ravel()
    # Omit incomplete shells beyond the half width (only corners of the grid)
    keep = int(max(axes[0])) + 1
    summed = [np.bincount(shell, values.ravel())[:keep] for values in (total, power)]
    return np.arange(float(keep)), summed[0], summed[1]


def _band_shares(matrix: Array) -> tuple[Array, Array]:
    """Return the variance of each band alone, and the part from correlations with other bands.

    The returned values are fractions of the predicted variance.
    """
    total = float(matrix.sum())
    if not np.isfinite(total) or total == 0:
        return np.full(len(matrix), np.nan), np.full(len(matrix), np.nan)
    own = np.diag(matrix) / total
    return own, matrix.sum(axis=1) / total - own


def _share(value: float) -> str:
    return percent(float(value)) if np.isfinite(value) else "no finite share"


def _power_words(data: xr.Dataset) -> str:
    if "radial_power" not in data:
        return f"n = {data.attrs['n']}"
    low, high = (_points(data) * float(data["radial_power"].values[i]) for i in (0, -1))
    return f"{number(low)} at the lowest and {number(high)} at the highest frequencies"


def _pair_words(data: xr.Dataset) -> str:
    g = data["pair_correlation"].values
    if not np.isfinite(g).any():
        return "no number"
    least = int(np.nanargmin(g))
    return f"least {number(float(g[least]))} at r = {number(float(data['r'].values[least]))}"


def _peak_words(data: xr.Dataset) -> str:
    """Describe the largest contribution and its frequency.

    If the contributions at m and −m are equal, the later frequency in the data is named.
    """
    values = data["contribution"]
    if not np.isfinite(values.values).any():
        return not_finite(values.values, data)
    flat = np.abs(np.nan_to_num(values.values)).ravel()
    place = np.unravel_index(len(flat) - 1 - int(np.argmax(flat[::-1])), values.shape)
    at = [
        f"{values[d].values[i]:g}"
        for d, i in zip(values.dims, place, strict=True)
        if str(d) in frequency_dims(data)
    ]
    peak = number(float(values.values[place]))
    sign = "±" if any((data[m].values < 0).any() for m in frequency_dims(data)) else ""
    return f"largest, {peak}, at m = {sign}({', '.join(at)})".replace("-", "−")


def _band_words(data: xr.Dataset) -> str:
    own, _ = _band_shares(data["band_covariance"].values)
    if not np.isfinite(own).any():
        return "no finite share"
    return f"{percent(float(own.sum()))} of the predicted variance on the diagonal"
