"""If strata are aligned with the edges of an integrand, the rate of smooth integrands remains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import (
    Axis,
    Dots,
    Heatmap,
    Line,
    Mark,
    Panel,
    Plot,
    ReferenceLine,
    Scale,
    Segments,
    TextMark,
)
from mcspectra.plots.scales import unit_panel
from mcspectra.plots.style import ACCENT, FAINT, INK, PALETTE
from mcspectra.plots.text import number
from mcspectra.report.page import Slider
from mcspectra.reproduction.claims import (
    Claim,
    Exhibit,
    Measured,
    about,
    known_rate,
    rate_text,
    slope,
)
from mcspectra.reproduction.panels import plot_of, strata, variance_panel

__all__ = ["edge", "edge_panel", "exhibit"]

COUNTS = (16, 64, 256, 1024)
# With 2^k strata, an edge at 1/3 cuts a stratum into 1/3 and 2/3, so s(1 − s) is always 2/9.
PLACES = {"aligned: edge at 1/2": 0.5, "not aligned: edge at 1/3": 1 / 3}
ALIGNED, CUT = PLACES
RATES = {ALIGNED: -2.0, CUT: -1.5}
_KINDS = Scale(
    kind="names",
    names=("right of the edge", "left of the edge", "cut by the edge"),
    colors=("#FFFFFF", "#D6E6F1", "#F5C9A9"),
)
# The largest value of f is 2. With a higher limit, white texts and dots are readable on f
_VALUES = Scale(high=2.6)
_PIXELS = 240
_SAME = 1e-9  # least distance of an edge from a border that is not a rounding error
_OBLIQUE = "half-space(normal=[1, 0.618], offset=0.7)"


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure variances of an edge plus a ramp, for edges on and between borders of strata."""
    realizations = 1000 if quick else 10_000
    plain, shifted = (
        {name: measured(edge(a), sampler, realizations, seed) for name, a in PLACES.items()}
        for sampler in ("jittered", "jittered | shift")
    )
    oblique = np.array([float(mcs.exact_variance(_OBLIQUE, "jittered", n)) for n in COUNTS])
    a, b, c, d = map(rate_text, (*plain.values(), *shifted.values()))

    # Deform the strata so that one border is at 1/3
    f, place, counts = edge(1 / 3), [[1 / 3], []], COUNTS[-2:]
    known = [float(mcs.exact_variance(mcs.aligned(f, place, n), "jittered", n)) for n in counts]

    frames = {f"{s:g}": _cut(s) for s in (0.0, 0.125, 0.25, 0.375, 0.5, 0.75, 1.0)}
    references = {name: exact(a) for name, a in PLACES.items()}
    after = {name: homogenised() for name in PLACES}
    limits = float(exact(0.5).min()), float(homogenised().max())
    aligned, cut = (Measured.of(plain[name].isel(n=-1), "variance") for name in PLACES)
    return Exhibit(
        numbers={"a": a, "b": b, "c": c, "d": d},
        plots=(
            frames["0.5"],
            _strata(),
            plot_of(
                "strata-alignment-convergence",
                variance_panel(plain, exact=references, title="jittered", limits=limits),
                variance_panel(shifted, exact=after, title="jittered | shift", limits=limits),
            ),
        ),
        sliders={
            "edge-and-strata": Slider("position of the edge in its strata s =", frames, "0.5")
        },
        claims=(
            *(
                Claim(
                    f"{name.capitalize()}: the variance is s(1 − s) N^(−3/2) + 1/(12N²) at "
                    f"N = {COUNTS[-1]}, where s is the part of a stratum to the left of the edge.",
                    Measured.of(plain[name].isel(n=-1), "variance", log=True),
                    expected=float(exact(PLACES[name])[-1]),
                    digits=4,
                )
                for name in PLACES
            ),
            Claim(
                "Benefit of alignment: variance of the edge at 1/3 divided by the variance of the "
                f"edge at 1/2, N = {COUNTS[-1]}.",
                cut / aligned,
                expected=float(exact(PLACES[CUT])[-1] / exact(PLACES[ALIGNED])[-1]),
            ),
            *about(
                "strata-alignment-convergence",
                *(
                    known_rate(
                        f"Jittered points, {name}: the variance has the rate {number(rate, 2)}.",
                        plain[name],
                        rate,
                        references[name],
                    )
                    for name, rate in RATES.items()
                ),
                *(
                    known_rate(
                        f"After a shift, edge at {name.rpartition(' ')[2]}: the rate is −1.5, "
                        "with or "
                        "without alignment before.",
                        curve,
                        -1.5,
                        homogenised(),
                    )
                    for name, curve in shifted.items()
                ),
                known_rate(
                    "An oblique edge cuts strata at any position: the rate of jittered points "
                    "is −1.5.",
                    measured(_OBLIQUE, "jittered", realizations, seed),
                    -1.5,
                    oblique,
                ),
                Claim(
                    "Strata deformed to have a border at 1/3 restore the rate −2: rate of the "
                    "exact "
                    f"variances from N = {counts[0]} to {counts[1]}, minus −2.",
                    slope(counts, np.array(known)) + 2.0,
                    # With s strata per axis, the border at 1/3 is rounded to whole strata.
                    # The rounding changes the variance by a fraction 1/s², and s is at least 16
                    at_most=1 / 256,
                ),
            ),
        ),
    )


def edge(a: float) -> mcs.Integrand:
    """Return the 2-D integrand 1[x < a] + y."""

    def f(x: Array) -> Array:
        return np.asarray((x[..., 0] < a) + x[..., 1])

    return mcs.Integrand.from_function(f, dims=2, integral=a + 0.5)


def exact(a: float) -> Array:
    """Return variances of jittered points. The edge and the ramp have independent errors."""
    side = np.sqrt(COUNTS)
    share = a * side - np.floor(a * side)
    return np.asarray(share * (1 - share) / side**3 + 1 / (12 * side**4))


def homogenised() -> Array:
    """Return variances after a random shift. The mean of s(1 − s) over all shifts is 1/6.

    The edge has a uniform position s in its stratum, and so has the border of the domain.
    The edge and the border are more than a stratum apart, so they cut different strata.
    The position of the edge therefore does not matter.
    The ramp adds N^(−3/2)/6 − N^(−2)/12 because it jumps at the border.
    """
    side = np.sqrt(COUNTS)
    return np.asarray(2 / 6 / side**3 + 1 / (6 * side**3) - 1 / (12 * side**4))


def measured(f: mcs.Integrand | str, sampler: str, realizations: int, seed: int) -> xr.Dataset:
    """Measure the convergence at all counts."""
    return mcs.convergence(f, sampler, list(COUNTS), realizations=realizations, rng=seed)


def edge_panel(
    a: float, across: Array, up: Array, title: str, points: Array | None = None, *, y: str = "y"
) -> Panel:
    """Return a map of f = 1[x < a] + y with strata, and mark the strata that the edge cuts.

    The borders of strata, including 0 and 1, are at x = `across` and at y = `up`.
    The panel also has the `points` (N, 2), if they are given.
    """
    u = (np.arange(_PIXELS) + 0.5) / _PIXELS
    values = np.asarray(edge(a)(np.stack(np.meshgrid(u, u), axis=-1)))
    upright = [[[x, 0.0], [x, 1.0]] for x in across[1:-1]]
    lying = [[[0.0, y], [1.0, y]] for y in up[1:-1]]
    marks: list[Mark] = [
        Heatmap(values=values, x=u, y=u, scale=_VALUES, name="f"),
        Segments(ends=np.array(upright + lying), color=FAINT, width=0.7),
    ]
    # An edge at a border of strata cuts no stratum
    if np.abs(across - a).min() > _SAME:
        k = int(np.searchsorted(across, a))
        sides = [[[x, 0.0], [x, 1.0]] for x in across[k - 1 : k + 1]]
        rungs = [[[across[k - 1], y], [across[k], y]] for y in up]
        marks.append(
            Segments(
                ends=np.array(sides + rungs), color=ACCENT, width=1.8,
                label="strata cut by the edge",
            )
        )  # fmt: skip
    edges = np.array([a, a])
    marks.append(Line(x=edges, y=np.array([0.0, 1.0]), color="#000000", width=2.6, label="edge"))
    if points is not None:
        # White dots with a black border are visible on all colors
        for color, size in (("#000000", 5.0), ("#FFFFFF", 3.6)):
            marks.append(Dots(x=points[:, 0], y=points[:, 1], color=color, size=size))
    return unit_panel(marks, title, "x", y)


def _cut(s: float) -> Plot:
    """Plot two edges, at a border of strata and at position s within strata; plot the variance."""
    side, n = 8, 64
    borders = np.arange(side + 1) / side
    pictures = list[Panel]()
    for place, name in ((0.0, "aligned"), (s, "cut" if 0.0 < s < 1.0 else "aligned")):
        picture = edge_panel(
            (4 + place) / side, borders, borders, f"{name}: s = {place:g}",
            y="" if pictures else "y",
        )  # fmt: skip
        texts = (
            TextMark(x=x, y=0.06, text=text, color="#FFFFFF", side="middle")
            for x, text in ((0.24, "f = 1 + y"), (0.82, "f = y"))
        )
        pictures.append(replace(picture, marks=(*picture.marks, *texts)))
    at = np.linspace(0.0, 1.0, 101)

    def variance(s: Array) -> Array:
        return np.asarray(1e4 * (s * (1 - s) / side**3 + 1 / (12 * n**2)))

    here = np.array([0.0, s])
    curve = Panel(
        marks=(
            Line(x=at, y=variance(at), color=PALETTE[0], width=1.8, label="jittered"),
            ReferenceLine(
                at=float(1e4 * homogenised()[COUNTS.index(n)]),
                color=PALETTE[6],
                dashes="--",
                width=1.4,
                label="after a random shift",
            ),
            Dots(x=here, y=variance(here), color=PALETTE[0], size=9.0),
        ),
        x=Axis(label="position s of the edge", low=-0.04, high=1.04),
        y=Axis(label="variance · 10⁴", low=0.0),
        title=f"exact variance, N = {n}",
        grid=True,
    )
    return plot_of("edge-and-strata", *pictures, curve)


def _strata() -> Plot:
    side = 8
    middle, ticks = (np.arange(side) + 0.5) / side, np.arange(side + 1) / side
    panels = []
    for (low, high), title in (
        ((0.5, 0.5), "aligned: x = 1/2"),
        ((1 / 3, 1 / 3), "not aligned: x = 1/3"),
        ((0.7, 0.082), "oblique"),
    ):
        # In row k of the strata, the edge is at x = ends[k] at the bottom of the row.
        # At the top of the row, the edge is at x = ends[k + 1]
        ends = low + (high - low) * ticks
        left, right = (reach(ends[:-1], ends[1:]) for reach in (np.minimum, np.maximum))
        cut = (ticks[:-1] < right[:, None] - 1e-9) & (left[:, None] + 1e-9 < ticks[1:])
        values = np.where(cut, 2.0, (ticks[1:] <= left[:, None] + 1e-9) * 1.0)
        panels.append(
            unit_panel(
                (
                    Heatmap(values=values, x=middle, y=middle, scale=_KINDS, name="stratum"),
                    *strata(side),
                    Line(x=np.array([low, high]), y=np.array([0.0, 1.0]), color=INK, width=1.6),
                ),
                title,
            )
        )
    return plot_of("strata-alignment", *panels)
