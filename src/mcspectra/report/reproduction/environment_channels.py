"""Environment maps sampled by the gray channel keep the jumps of the colours; each by its own channel does not."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.axes import count_axis, log_axis
from mcspectra.report.formatting import number, rate
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._curves import known_rate
from mcspectra.report.reproduction.base import Exhibit, Finding, agreement, identity
from mcspectra.report.style import (
    INK,
    PALETTE,
    WIDE,
    entitle,
    legend_below,
    new_figure,
    outer_labels,
    quiet,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["exhibit"]

# A map of eight pixels, red, green and blue: a sun, a sky and a ground
_PIXELS = np.array(
    [[0.3, 0.4, 0.9], [0.2, 0.5, 1.0], [6.0, 1.0, 0.4], [14.0, 12.0, 7.0],
     [0.6, 5.0, 0.8], [0.4, 0.7, 4.0], [0.1, 0.9, 0.3], [1.2, 0.3, 0.2]]
)  # fmt: skip
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709
_COLORS = ("red", "green", "blue")
_WAYS = {"one": "gray channel", "own": "its own channel", "mis": "MIS of all channels"}
_RATES = {"one": -2.0, "own": -3.0, "mis": -2.0}
_COUNTS = {
    "one": (192, 384, 768, 1536, 3072),
    "own": (64, 128, 256, 512, 1024),
    "mis": (64, 128, 256, 512, 1024),
}
_COSTS = {"one": 1, "own": 3, "mis": 3}

Curves: TypeAlias = "dict[str, xr.Dataset]"


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure rates of three channels by gray, own and mixed densities, and a map in the plane."""
    from mcspectra.variance.convergence import convergence

    ways = _ways()
    realizations = 400 if quick else 4000
    curves = {
        way: convergence(ways[way], "jittered", _COUNTS[way], realizations=realizations, rng=seed)
        for way in _WAYS
    }
    exact = {way: _exact(ways[way], way) for way in _WAYS}
    findings = (
        *(_rate(way, c, curves[way], exact[way]) for way in _WAYS for c in range(3)),
        *(_gain(c, curves) for c in range(3)),
        *(_continuous(c) for c in range(3)),
        _in_the_plane(60 if quick else 600, seed),
    )
    return Exhibit(
        name="environment-channels",
        title="Environment maps: the gray channel against all channels",
        slide="In environment map sampling, simply importance sampling w.r.t. the gray channel introduces "
        "discontinuities. IS all the channels.",
        caption=_caption(curves, findings),
        pictures=(_map(), _convergence(curves, exact)),
        findings=findings,
    )


def _caption(curves: Curves, findings: tuple[Finding, ...]) -> str:
    def shown(way: str) -> str:
        cells = (curves[way].sel(channel=c) for c in range(3))
        return ", ".join(rate(float(c["rate"]), *map(float, c["rate_ci"].values)) for c in cells)

    gains = ", ".join(number(float(f.measured or 0)) for f in findings[9:12])
    return (
        "A channel over the density of luminance keeps the ratio of both, which jumps wherever the colour changes. With "
        f"jittered points the rates of red, green and blue are {shown('one')}; each sampled by its own channel, "
        f"{shown('own')}. At {_COUNTS['one'][-1]} evaluations the variance is {gains} times lower. MIS over the three "
        f"densities weights every point for every channel and brings the jumps back: {shown('mis')}."
    )


def _ways() -> dict[str, Any]:
    """The ways of sampling the map times cos(π(x − ½)), by name."""
    from mcspectra.densities.tabulated import PiecewiseConstant
    from mcspectra.estimators.channels import channel_estimators
    from mcspectra.integrands.base import Integrand

    own = [PiecewiseConstant(values=_PIXELS[:, c]) for c in range(3)]
    parts = np.diff(np.sin(np.pi * (np.arange(9) / 8 - 0.5)) / np.pi)
    f = Integrand.from_function(_radiance, dims=1, integral=_PIXELS.T @ parts)
    return channel_estimators(f, own, PiecewiseConstant(values=_PIXELS @ _LUMINANCE))


def _radiance(x: Array) -> Array:
    pixel = np.minimum((np.asarray(x)[..., 0] * 8).astype(np.intp), 7)
    return np.asarray(_PIXELS[pixel] * np.cos(np.pi * (np.asarray(x) - 0.5)))


def _exact(estimator: Any, way: str) -> Array:
    from mcspectra.variance.exact import exact_variance

    return np.array([exact_variance(estimator, "jittered", n) for n in _COUNTS[way]])


def _rate(way: str, channel: int, curve: xr.Dataset, exact: Array) -> Finding:
    return known_rate(
        f"Variance of {_COLORS[channel]}, sampled by {_WAYS[way]}, jittered: rate.",
        curve.sel(channel=channel),
        _RATES[way],
        exact[:, channel],
    )


def _gain(channel: int, curves: Curves) -> Finding:
    """At equal numbers of evaluations: n points, or a third of them for each channel."""
    one, own = (curves[way].sel(channel=channel).isel(n=-1) for way in ("one", "own"))
    halves = [np.diff(np.log(c["variance_ci"].values))[0] / 2 for c in (one, own)]
    ratio, factor = float(one["variance"] / own["variance"]), float(np.exp(np.hypot(*halves)))
    return agreement(
        f"At {_COUNTS['one'][-1]} evaluations, variance of {_COLORS[channel]} by the gray channel over that by its own "
        "channel.",
        measured=ratio,
        interval=(ratio / factor, ratio * factor),
        above=1.0,
        scale="log",
    )


def _weighted(density: Array, channel: int) -> Array:
    """f/p in primary space: values at the two ends of each piece, (pieces, 2), for p by pixels."""
    ends = np.arange(9) / 8
    cosine = np.cos(np.pi * (ends - 0.5))
    ratio = _PIXELS[:, channel] / (density / density.mean())
    return np.stack([ratio * cosine[:-1], ratio * cosine[1:]], axis=1)


def _continuous(channel: int) -> Finding:
    own = _weighted(_PIXELS[:, channel], channel)
    return identity(
        f"f/p of {_COLORS[channel]} has no jumps when it is sampled by its own channel: largest one between pixels.",
        error=float(np.abs(own[1:, 0] - own[:-1, 1]).max()),
        at_most=1e-14,
    )


def _in_the_plane(realizations: int, seed: int) -> Finding:
    """The built-in sky, its red channel, by bilinear densities of luminance and of red."""
    from mcspectra.estimators.importance import Estimator
    from mcspectra.variance.convergence import convergence

    f = "environment(channel=0, interpolation='bilinear')"
    densities = [f"environment(channel={c!r}, interpolation='bilinear')" for c in ("luminance", 0)]
    found = convergence(
        [Estimator(f, p) for p in densities], "jittered", [1024],
        realizations=realizations, rng=seed,
    ).isel(n=0)  # fmt: skip
    gray, red = found["variance"].values
    factor = float(
        np.exp(np.hypot(*np.diff(np.log(found["variance_ci"].values), axis=1)[:, 0] / 2))
    )
    return agreement(
        "Of a whole sky, irradiance in red with 1024 jittered points: variance by luminance over that by red.",
        measured=float(gray / red),
        interval=(float(gray / red / factor), float(gray / red * factor)),
        above=1.0,
        scale="log",
    )


def _map() -> Picture:
    figure = new_figure(WIDE, 3.0)
    panels = figure.subplots(1, 3)
    _draw_map(panels[0])
    for axes, way in zip(panels[1:], ("one", "own"), strict=True):
        for channel in range(3):
            _draw_weighted(axes, way, channel)
        entitle(axes, f"f/p, p by {_WAYS[way]}")
    panels[1].set_ylabel("f/p (over its mean)")
    legend_below(figure, panels[1], columns=3)
    return Picture(
        kind="environment-map",
        caption="Left, a map of eight pixels (values by channel). Then f/p against the random number u in primary "
        "space: with p by the gray channel it jumps where the colour changes; with p by the channel itself it is continuous.",
        alt="A step plot of three channels over eight pixels; then three curves with many jumps; then three "
        "continuous arches.",
        figure=figure,
    )


def _draw_map(axes: Axes) -> None:
    quiet(axes, grid=True)
    for channel in range(3):
        axes.stairs(_PIXELS[:, channel], np.arange(9) / 8, color=_color(channel), lw=1.4)
    axes.stairs(_PIXELS @ _LUMINANCE, np.arange(9) / 8, color=INK, lw=1.2, ls="--")
    axes.text(0.97, 13.0, "dashed: gray", fontsize=7.5, color=INK, ha="right")
    axes.set(xlabel="x (place in the map)", ylabel="radiance", ylim=(0, None), xlim=(0, 1))
    entitle(axes, "map")


def _color(channel: int) -> str:
    return (PALETTE[1], PALETTE[2], PALETTE[0])[channel]


def _draw_weighted(axes: Axes, way: str, channel: int) -> None:
    """f/p against u: pieces between the borders of pixels, moved to primary space."""
    quiet(axes, grid=True)
    table = _PIXELS @ _LUMINANCE if way == "one" else _PIXELS[:, channel]
    borders = np.concatenate([[0.0], np.cumsum(table) / table.sum()])
    t = np.linspace(0.0, 1.0, 40)
    ratio = _PIXELS[:, channel] / table
    x = (np.arange(8)[:, None] + t) / 8
    values = ratio[:, None] * np.cos(np.pi * (x - 0.5))
    u = borders[:-1, None] + np.diff(borders)[:, None] * t
    gap = np.full((8, 1), np.nan)
    mean = (values.mean(axis=1) * np.diff(borders)).sum()
    axes.plot(
        np.hstack([u, gap]).ravel(), np.hstack([values, gap]).ravel() / mean,
        color=_color(channel), lw=1.4, label=_COLORS[channel],
    )  # fmt: skip
    axes.set(xlabel="u (primary space)", xlim=(0, 1))
    axes.set_ylim(0, auto=True)  # the next channel may be higher


def _convergence(curves: Curves, exact: dict[str, Array]) -> Picture:
    figure = new_figure(WIDE, 3.3)
    panels = figure.subplots(1, 3, sharey=True)
    for channel, axes in enumerate(panels):
        quiet(axes, grid=True)
        for way, color, marker in zip(_WAYS, PALETTE, "os^", strict=False):
            n = np.array(_COUNTS[way]) * _COSTS[way]
            cell = curves[way].sel(channel=channel)
            variance, (low, high) = cell["variance"].values, cell["variance_ci"].values.T
            axes.plot(n, exact[way][:, channel], color=color, lw=1.2)
            axes.errorbar(
                n, variance, [variance - low, high - variance],
                fmt=marker, ms=4, lw=1, color=color, label=_WAYS[way],
            )  # fmt: skip
        count_axis(axes, "x", _COUNTS["one"])
        log_axis(axes, "y", 3e-9, 1e-2)
        axes.set(xlabel="evaluations of f", ylabel="variance")
        outer_labels(axes)
        entitle(axes, _COLORS[channel])
    legend_below(figure, panels[0], columns=3)
    return Picture(
        kind="environment-channels",
        caption="Variance of each channel against the number of evaluations, jittered, 95 % intervals; lines are exact.",
        alt="Three logarithmic plots. By the gray channel and by MIS of all channels variance falls with slope −2, by "
        "its own channel with slope −3; red and blue gain most.",
        figure=figure,
    )
