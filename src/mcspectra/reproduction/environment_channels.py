"""Environment maps: sampling by luminance leaves jumps, but a density per channel leaves none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, Heatmap, Line, Mark, Panel, Plot, Scale, TextMark
from mcspectra.plots.scales import unit_axis, unit_panel
from mcspectra.plots.style import INK, PALETTE
from mcspectra.plots.text import number
from mcspectra.rendering.files import encode_srgb
from mcspectra.reproduction.claims import (
    Claim,
    Exhibit,
    Measured,
    correction,
    known_rate,
    pixel_rate,
    rate_text,
)
from mcspectra.reproduction.panels import plot_of, variance_panel

__all__ = ["exhibit"]

# An RGB map of eight pixels with a sun, a sky and a ground
PIXELS = np.array(
    [[0.3, 0.4, 0.9], [0.2, 0.5, 1.0], [6.0, 1.0, 0.4], [14.0, 12.0, 7.0],
     [0.6, 5.0, 0.8], [0.4, 0.7, 4.0], [0.1, 0.9, 0.3], [1.2, 0.3, 0.2]]
)  # fmt: skip
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709
_COLORS = {"red": PALETTE[1], "green": PALETTE[2], "blue": PALETTE[0]}
_WAYS = {"one": "gray channel", "own": "its own channel", "mis": "MIS of all channels"}
RATES = {"one": -2.0, "own": -3.0, "mis": -2.0}
COUNTS = {
    "one": (192, 384, 768, 1536, 3072),
    "own": (64, 128, 256, 512, 1024),
    "mis": (64, 128, 256, 512, 1024),
}
# The sky as a dome: sun, clouds, leaves and walls by zenith angle (rows) and azimuth (columns)
_KINDS = {
    "sky": (0.3, 0.5, 1.0),
    "cloud": (1.0, 1.0, 1.0),
    "sun": (9.0, 5.0, 1.5),
    "leaves": (0.2, 0.6, 0.15),
    "wall": (1.0, 0.35, 0.2),
    "haze": (0.8, 0.8, 0.9),
}
_BLUE, _CLOUD, _SUN, _LEAF, _BRICK, _HAZE = _KINDS.values()
DOME = np.array(
    [[_BLUE, _BLUE, _CLOUD, _BLUE, _BLUE, _BLUE, _BLUE, _BLUE],
     [_BLUE, _BLUE, _CLOUD, _CLOUD, _BLUE, _SUN, _BLUE, _BLUE],
     [_HAZE, _LEAF, _HAZE, _HAZE, _BRICK, _BRICK, _HAZE, _HAZE],
     [_LEAF, _LEAF, _LEAF, _HAZE, _BRICK, _BRICK, _LEAF, _HAZE]]
)  # fmt: skip
# With many counts, the fitted rate depends little on where single strata meet an edge
DOME_COUNTS = tuple(side**2 for side in (16, 20, 25, 32, 40, 51, 64, 81, 102))
DOME_RATES = {"one": -1.5, "own": -2.0, "mis": -1.5}
_SIDE = 256
_ROOM = 0.08  # least width of a name in the figure of one row
_COSTS = {"one": 1, "own": 3, "mis": 3}  # number of evaluations of f per point


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure rates of three color channels, each sampled by three densities.

    The densities follow the gray channel, the color channel itself, or all channels (by MIS).
    A 2-D map of the sky is sampled by the gray channel and by the color channel.
    """
    by = ways()
    # The ends of a curve decide its rate
    sizes = {way: each[:: 2 if quick else 1] for way, each in COUNTS.items()}
    options: dict[str, Any] = {"realizations": 300 if quick else 1500, "rng": seed}
    curves = {way: mcs.convergence(by[way], "jittered", sizes[way], **options) for way in _WAYS}
    exact = {
        way: np.array([mcs.exact_variance(by[way], "jittered", n) for n in sizes[way]])
        for way in _WAYS
    }
    shown = {
        way: ", ".join(rate_text(curve.sel(channel=c)) for c in range(3))
        for way, curve in curves.items()
    }
    gains = [_gain(c, curves) for c in range(3)]

    # Sample the dome by the gray channel, by each color channel, and by all channels
    by = dome_ways()
    options["realizations"] = 60 if quick else 200
    planes = {
        way: mcs.convergence(by[way], "jittered", DOME_COUNTS, **options) for way in DOME_RATES
    }
    red = {f"dome_{way}": rate_text(curve.sel(channel=0)) for way, curve in planes.items()}

    # Sample red in the built-in sky, by bilinear densities of luminance and of red
    sky = "environment(channel={!r}, interpolation='bilinear')"
    estimators = [mcs.Estimator(sky.format(0), sky.format(c)) for c in ("luminance", 0)]
    options["realizations"] = 60 if quick else 600
    plane = mcs.convergence(estimators, "jittered", [1024], **options)
    by_gray, by_red = (Measured.of(plane.isel(n=0, estimator=i), "variance") for i in (0, 1))

    # Draw the variances at equal numbers of evaluations
    panels = [
        variance_panel(
            {
                _WAYS[way]: curve.sel(channel=channel).assign_coords(n=curve["n"] * _COSTS[way])
                for way, curve in curves.items()
            },
            exact={_WAYS[way]: values[:, channel] for way, values in exact.items()},
            title=color,
            x="evaluations of f",
            limits=(3e-9, 1e-2),
        )
        for channel, color in enumerate(_COLORS)
    ]
    return Exhibit(
        numbers={
            **red,
            "gray": shown["one"],
            "own": shown["own"],
            "evaluations": COUNTS["one"][-1],
            "lower": ", ".join(number(claim.value) for claim in gains),
            "mis": shown["mis"],
        },
        plots=(
            _jumps(planes),
            _sky(),
            _toy(),
            plot_of("environment-channels", *panels),
        ),
        claims=(
            *(
                pixel_rate(
                    f"Dome, variance of {color} sampled by {_WAYS[way]}, jittered: rate.",
                    curve.sel(channel=c),
                    DOME_RATES[way],
                )
                for way, curve in planes.items()
                if way != "mis"
                for c, color in enumerate(_COLORS)
                # Luminance is mostly green, so green sampled by luminance has only small jumps.
                # With small jumps, the green channel reaches its asymptotic rate only at large n
                if (way, color) != ("one", "green")
            ),
            *(
                replace(_rate_of(way, c, curves[way], exact[way]), corrects=way == "mis")
                for way in _WAYS
                for c in range(3)
            ),
            *gains,
            *(_continuous(c) for c in range(3)),
            correction(
                pixel_rate(
                    f"Dome, variance of red sampled by {_WAYS['mis']}, jittered: rate.",
                    planes["mis"].sel(channel=0),
                    DOME_RATES["mis"],
                )
            ),
            Claim(
                "Red irradiance from a whole sky with 1024 jittered points: variance by luminance "
                "divided by variance by red.",
                by_gray / by_red,
                above=1.0,
            ),
        ),
    )


def ways() -> dict[str, Any]:
    """Return the estimators of the map times cos(π(x − ½)), by name."""
    constant = mcs.densities.PiecewiseConstant
    own = [constant(values=PIXELS[:, c]) for c in range(3)]
    parts = np.diff(np.sin(np.pi * (np.arange(9) / 8 - 0.5)) / np.pi)
    f = mcs.Integrand.from_function(radiance, dims=1, integral=PIXELS.T @ parts)
    return mcs.estimators.channel_estimators(f, own, constant(values=PIXELS @ LUMINANCE))


def radiance(x: Array) -> Array:
    """Return the radiance, which is the map times the cosine."""
    pixel = np.minimum((np.asarray(x)[..., 0] * 8).astype(np.intp), 7)
    return np.asarray(PIXELS[pixel] * np.cos(np.pi * (np.asarray(x) - 0.5)))


def dome_ways() -> dict[str, Any]:
    """Return the estimators of the irradiance from the dome, by name."""
    constant = mcs.densities.PiecewiseConstant
    own = [constant(values=DOME[..., c]) for c in range(3)]
    rows, columns = DOME.shape[:2]
    ends = np.cos(np.pi * np.arange(rows + 1) / rows)
    weights = (ends[:-1] - ends[1:]) / np.pi  # the integral of sin(πy) over each row
    integral = np.einsum("rkc,r->c", DOME, weights) / columns
    f = mcs.Integrand.from_function(dome_radiance, dims=2, integral=integral)
    return mcs.estimators.channel_estimators(f, own, constant(values=DOME @ LUMINANCE))


def dome_radiance(x: Array) -> Array:
    """Return the radiance of the dome at (azimuth, zenith angle), times sin(πy) = sin 2θ."""
    x = np.asarray(x)
    rows, columns = DOME.shape[:2]
    row, column = (
        np.minimum((x[..., k] * size).astype(np.intp), size - 1)
        for k, size in ((1, rows), (0, columns))
    )
    return np.asarray(DOME[row, column] * np.sin(np.pi * x[..., 1])[..., None])


def _jumps(planes: Mapping[str, xr.Dataset]) -> Plot:
    """Plot f/p of red along the row of the sun, and the variances of red."""
    row = 1
    marks: list[Mark] = []
    for k, (way, table) in enumerate(_tables().items()):
        # The conditional density maps each pixel to an interval of random numbers
        borders = np.concatenate([[0.0], np.cumsum(table[row]) / table[row].sum()])
        ratio = DOME[row, :, 0] / table[row]
        ratio /= ratio @ np.diff(borders)
        u, y = np.repeat(borders, 2)[1:-1], np.repeat(ratio, 2)
        marks.append(Line(x=u, y=y, color=PALETTE[k], width=2.4))
        if way == "one":
            marks += _kinds_of(row, borders, ratio)
    section = Panel(
        marks=tuple(marks),
        x=unit_axis("random number u along the row"),
        y=Axis(label="f/p of red (over its mean)", low=0.0, high=1.6),
        title="a row of the map, red",
        grid=True,
    )
    red = {_WAYS[way]: curve.sel(channel=0) for way, curve in planes.items()}
    curves = variance_panel(
        red,
        rates={_WAYS[way]: rate for way, rate in DOME_RATES.items()},
        title="variance of red, jittered",
        x="number of points N",
        beside=0.6,
    )
    return plot_of("environment-map", section, curves)


def _kinds_of(row: int, borders: Array, ratio: Array) -> list[Mark]:
    """Name what is seen in a row of the map, once for each wide run of equal pixels."""
    names = {color: name for name, color in _KINDS.items()}
    seen = [names[tuple(color)] for color in DOME[row].tolist()]
    first = [0, *(k for k in range(1, len(seen)) if seen[k] != seen[k - 1])]
    last = [*first[1:], len(seen)]
    return [
        TextMark(
            x=float(borders[a] + borders[b]) / 2, y=float(ratio[a]), text=seen[a], side="above"
        )
        for a, b in zip(first, last, strict=True)
        if borders[b] - borders[a] > _ROOM
    ]


def _tables() -> dict[str, Array]:
    """Return the tables of the densities by the gray channel and by red."""
    return {"one": DOME @ LUMINANCE, "own": DOME[..., 0]}


def _sky() -> Plot:
    """Return the map, and f/p of red on the unit square, for both densities."""
    u = (np.arange(_SIDE) + 0.5) / _SIDE
    grid = np.stack(np.meshgrid(u, u), axis=-1)
    values = []
    for table in _tables().values():
        density = mcs.densities.PiecewiseConstant(values=table)
        x = density.sample(grid.reshape(-1, 2)).reshape(grid.shape)
        p = density.pdf(x.reshape(-1, 2)).reshape(x.shape[:-1])
        ratio = dome_radiance(x)[..., 0] / p
        values.append(ratio / ratio.mean())
    scale = Scale(label="f/p of red (over its mean)", high=float(max(map(np.max, values))))
    maps = [
        unit_panel(
            [Heatmap(values=each, x=u, y=u, scale=scale, name="f/p over its mean")],
            f"p by {_WAYS[way]}",
            "u₀",
            "u₁",
        )
        for each, way in zip(values, _tables(), strict=True)
    ]
    kinds = {name: np.array(color) for name, color in _KINDS.items()}
    place = np.array(
        [[next(k for k, c in enumerate(kinds.values()) if (c == p).all()) for p in r] for r in DOME]
    )
    rgb = np.round(
        255
        * np.clip(encode_srgb(np.array([c / max(1.0, c.max()) for c in kinds.values()])), 0.0, 1.0)
    ).astype(int)
    names = Scale(
        kind="names", names=tuple(kinds), colors=tuple(f"#{r:02X}{g:02X}{b:02X}" for r, g, b in rgb)
    )
    rows, columns = place.shape
    at = [(np.arange(size) + 0.5) / size for size in (columns, rows)]
    image = Heatmap(values=place[::-1].astype(float), x=at[0], y=at[1], scale=names, name="kind")
    shown = unit_panel([image], "the map of the dome", "azimuth", "zenith at the top")
    return plot_of("dome-map", shown, *maps)


def _rate_of(way: str, channel: int, curve: xr.Dataset, exact: Array) -> Claim:
    text = f"Variance of {list(_COLORS)[channel]}, sampled by {_WAYS[way]}, jittered: rate."
    return known_rate(text, curve.sel(channel=channel), RATES[way], exact[:, channel])


def _gain(channel: int, curves: Mapping[str, xr.Dataset]) -> Claim:
    """Compare variances at equal numbers of evaluations: n points, or n/3 per channel."""
    one, own = (
        Measured.of(curves[way].sel(channel=channel).isel(n=-1), "variance")
        for way in ("one", "own")
    )
    return Claim(
        f"At {COUNTS['one'][-1]} evaluations: variance of {list(_COLORS)[channel]} by the gray "
        "channel divided by the variance by its own channel.",
        one / own,
        above=1.0,
    )


def weighted(table: Array, channel: int, t: Array) -> Array:
    """Return f/p, with a density from `table`, at positions t in each of 8 pixels, (8, len(t))."""
    x = (np.arange(8)[:, None] + t) / 8
    times = PIXELS[:, channel] / (table / table.mean())
    return np.asarray(times[:, None] * np.cos(np.pi * (x - 0.5)))


def _continuous(channel: int) -> Claim:
    own = weighted(PIXELS[:, channel], channel, np.array([0.0, 1.0]))
    return Claim(
        f"f/p of {list(_COLORS)[channel]} sampled by its own channel has no jumps: largest jump "
        "between pixels.",
        float(np.abs(own[1:, 0] - own[:-1, 1]).max()),
        at_most=1e-14,
    )


def _toy() -> Plot:
    centers, t = (np.arange(8) + 0.5) / 8, np.linspace(0.0, 1.0, 40)
    gray = PIXELS @ LUMINANCE
    marks: dict[str, list[Mark]] = {
        "map": [
            Line(x=centers, y=PIXELS[:, c], color=color, step=True, label=name)
            for c, (name, color) in enumerate(_COLORS.items())
        ],
        f"f/p, p by {_WAYS['one']}": [],
        f"f/p, p by {_WAYS['own']}": [],
    }
    marks["map"].append(
        Line(x=centers, y=gray, color=INK, dashes="--", width=1.2, step=True, label="gray")
    )
    for title, own in zip(list(marks)[1:], (False, True), strict=True):
        for c, color in enumerate(_COLORS.values()):
            # Map the part of f/p in each pixel from x to primary space
            table = PIXELS[:, c] if own else gray
            borders = np.concatenate([[0.0], np.cumsum(table) / table.sum()])
            values = weighted(table, c, t)
            mean = (values.mean(axis=1) * np.diff(borders)).sum()
            u = borders[:-1, None] + np.diff(borders)[:, None] * t
            gap = np.full((8, 1), np.nan)
            x, y = (np.hstack([each, gap]).ravel() for each in (u, values / mean))
            marks[title].append(Line(x=x, y=y, color=color, width=1.4))
    labels = [
        ("x (place in the map)", "radiance"),
        *[("u (primary space)", "f/p (over its mean)")] * 2,
    ]
    return plot_of(
        "one-row",
        *(
            Panel(
                marks=tuple(each),
                x=unit_axis(x),
                y=Axis(label=y, low=0.0),
                title=title,
                grid=True,
            )
            for (title, each), (x, y) in zip(marks.items(), labels, strict=True)
        ),
    )
