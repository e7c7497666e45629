"""Mirroring of integrands or samples. With it, homogenization does not reduce the rate.

Mirror-uniform draws n/4 points, and evaluates f at all four mirror images of each point.
Mirror-uniform sampling therefore samples h, the mean of f over the four images.
Mirror-random chooses one of the four images of each point at random.
The choice adds variance: the mean variance of f over the four images of a point, divided by n.

The mean over the images, h = q(x) q(y), is continuous on the torus.
With shifted strata of side 1/s, the variance is Σ |h_m|² (1 − Π_i sinc²(πm_i/s)) / n.
The sum is over integers m ≠ 0, and is computed from products over the axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

import mcspectra as mcs
from mcspectra.core.checks import BELOW_ONE, Array
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
from mcspectra.plots.scales import log_axis, name_axis, unit_panel
from mcspectra.plots.style import ACCENT, FAINT, INK, MARKERS, PALETTE
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import (
    Claim,
    Exhibit,
    Measured,
    about,
    correction,
    known_rate,
    rate_text,
)
from mcspectra.reproduction.panels import AXES, plot_of, strata, variance_panel

__all__ = ["exhibit"]

INTEGRAND = "christensen-gaussian"
_COUNTS = (64, 256, 1024, 4096)
_TITLES = {"original": "original", "random": "mirror-random", "uniform": "mirror-uniform"}
_WORDS = {False: "not homogenized", True: "homogenized"}
RATES = {
    ("original", False): -2.0, ("original", True): -1.5,
    ("random", False): -1.0, ("random", True): -1.0,
    ("uniform", False): -2.0, ("uniform", True): -2.0,
}  # fmt: skip
"""Expected rates for each kind of mirroring, with and without homogenization."""


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Draw integrand and samples, and measure the convergence of six estimators."""
    options: dict[str, Any] = {"realizations": 250 if quick else 2500, "rng": seed}
    study = mcs.improve.mirror_study(
        INTEGRAND, "jittered", _COUNTS, mirrorings=list(_TITLES), **options
    )
    cells = {(m, h): study.sel(mirroring=m, homogenized=h) for m, h in RATES}
    exact = {
        (m, h): np.array([exact_mirrored(m, n, homogenized=h) for n in _COUNTS]) for m, h in RATES
    }
    shown = {key: rate_text(cell) for key, cell in cells.items()}
    last = {key: Measured.of(cell.isel(n=-1), "variance") for key, cell in cells.items()}
    moved = last["original", True]

    # Compute the jump |f(0, y) − f(1, y)| at the border, for f and for f(fold(2u))
    y = np.linspace(0.0, 1.0, 257)
    original = np.exp(-(y**2)) * (1.0 - np.exp(-1.0))
    g = mcs.Mirrored(INTEGRAND).primary_integrand(0)
    ends = (g(np.stack([np.full_like(y, u), y], axis=-1)) for u in (0.0, BELOW_ONE))
    mirrored = np.subtract(*ends)

    # Plot the samples, and plot the variances against N with the slopes of the expected rates
    own = mcs.sampler("jittered", 2).draw(16, rng=seed)[0]
    panels = []
    for mirroring, side in (("original", 8), ("random", 8), ("uniform", 4)):
        spec = "jittered" if mirroring == "original" else f"jittered | mirror(mode={mirroring!r})"
        x, y = mcs.sampler(spec, 2).draw(64, rng=seed)[0].T
        marks: list[Mark] = [*strata(side), Dots(x=x, y=y, color=PALETTE[0], size=3.0)]
        if mirroring == "uniform":
            marks.append(Dots(x=own[:, 0], y=own[:, 1], color=ACCENT, size=3.0))
        panels.append(unit_panel(marks, _TITLES[mirroring], "x", "y"))
    curves = [
        variance_panel(
            {_WORDS[h]: cells[m, h] for h in (False, True)},
            exact={_WORDS[h]: exact[m, h] for h in (False, True)},
            rates={_WORDS[h]: RATES[m, h] for h in (False, True)},
            title=title,
            x="evaluations N",
            limits=(3e-10, 1e-3),
            beside=0.9,
        )
        for m, title in _TITLES.items()
    ]
    together = [
        variance_panel(
            {_TITLES[m]: cells[m, shifted] for m in _TITLES},
            exact={_TITLES[m]: exact[m, shifted] for m in _TITLES},
            rates={_TITLES[m]: RATES[m, shifted] for m in _TITLES},
            title=_WORDS[shifted],
            x="number of evaluations N",
            limits=(3e-10, 1e-3),
            beside=0.6,
        )
        for shifted in (True, False)
    ]
    rates = {
        shifted: [
            known_rate(
                f"Variance of exp(−x² − y²), {_TITLES[m]}, jittered, {_WORDS[h]}: rate.",
                cell,
                RATES[m, h],
                exact[m, h],
            )
            for (m, h), cell in cells.items()
            if h == shifted
        ]
        for shifted in (False, True)
    }
    harmed = Claim(
        f"Homogenization harms the original: at N = {_COUNTS[-1]} the shift multiplies its "
        "variance by more than 1.",
        moved / last["original", False],
        above=1.0,
    )
    helped = Claim(
        f"Mirroring helps homogenized sets: at N = {_COUNTS[-1]}, variance of the original "
        "divided by mirror-uniform, both shifted.",
        moved / last["uniform", True],
        above=1.0,
    )
    worse = Claim(
        f"Mirror-random harms: at N = {_COUNTS[-1]} its variance divided by the variance of the "
        "original, both shifted.",
        last["random", True] / moved,
        above=1.0,
    )
    harm, help_ = (moved / last[key] for key in (("original", False), ("uniform", True)))
    return Exhibit(
        numbers={
            "random": shown["random", False],
            "harm": number(harm.value, 2),
            "help": number(help_.value, 2),
            "most": _COUNTS[-1],
            "original": shown["original", False],
            "original_shifted": shown["original", True],
            "uniform": shown["uniform", False],
            "uniform_shifted": shown["uniform", True],
        },
        plots=(
            _integrands(),
            plot_of("mirrored-samples", *panels),
            plot_of("mirroring-homogenized", *curves),
            plot_of("mirroring-plain", *curves),
            plot_of("mirroring-convergence", *together),
            _take_away(last, seed),
        ),
        claims=(
            # Draw the integrand twice: wrapped around, and mirrored
            Claim(
                "The original jumps by up to 1 − 1/e where it wraps around.",
                float(np.abs(original).max()),
                expected=float(1 - np.exp(-1)),
                tolerance=1e-12,
                digits=4,
            ),
            Claim(
                "The mirrored integrand is continuous where it wraps around: largest jump.",
                float(np.abs(mirrored).max()),
                at_most=1e-12,
            ),
            *about("mirrored-samples", _unbiased(seed)),
            *about("mirroring-homogenized", *rates[True], harmed),
            *about("mirroring-plain", *rates[False]),
            *about("mirroring-convergence", helped, correction(worse)),
            *about("take-away", *(_domain(dims) for dims in (1, 2))),
        ),
    )


def symmetrized(x: Array) -> Array:
    """Return q(x), the mean of exp(−y²) over the two mirror images y = x and y = 1 − x."""
    return np.asarray((np.exp(-(x**2)) + np.exp(-((1 - x) ** 2))) / 2)


def exact_mirrored(mirroring: str, n: int, *, homogenized: bool) -> float:
    """Return the variance of I_n with n evaluations of f. Here n is s², or 4s² for ``uniform``."""
    if mirroring == "original":
        sampler = "jittered | shift" if homogenized else "jittered"
        return float(mcs.exact_variance(INTEGRAND, sampler, n))
    if mirroring == "uniform":
        return _of_the_mean(n // 4, homogenized)
    return among_images() / n + _of_the_mean(n, homogenized)


def _of_the_mean(n: int, homogenized: bool) -> float:
    """Return the variance of h with n jittered points."""
    s = math.isqrt(n)
    if homogenized:
        whole, power = _axis()
        m = np.arange(len(power))
        seen = power[0] + 2.0 * (power[1:] * np.sinc(m[1:] / s) ** 2).sum()
        return float((whole**2 - seen**2) / n)
    # Sum n⁻² (∫∫ h² n − (∫∫ h n)²) over the strata; both integrals are products over axes
    nodes, weights = np.polynomial.legendre.leggauss(24)
    q = symmetrized((np.arange(s)[:, None] + (nodes + 1) / 2) / s)
    means, squares = q @ weights / 2, q**2 @ weights / 2
    return float((squares.sum() ** 2 - (means**2).sum() ** 2) / n**2)


@cache
def _axis() -> tuple[float, Array]:
    """Return ∫q², and |q_m|² for m = 0 … 4096, which falls as m⁻⁴."""
    samples = 2**16
    x = (np.arange(samples) + 0.5) / samples
    power = np.abs(np.fft.rfft(symmetrized(x)) / samples)[:4097] ** 2
    nodes, weights = np.polynomial.legendre.leggauss(40)
    return float(weights @ symmetrized((nodes + 1) / 2) ** 2 / 2), power


def among_images() -> float:
    """Return ∫f² − ∫h², the variance of f between mirror images."""
    square = float(np.pi / 8 * math.erf(math.sqrt(2.0)) ** 2)  # (∫ exp(−2x²) dx)²
    return square - _axis()[0] ** 2


def _unbiased(seed: int) -> Claim:
    """Check that a mirror-uniform set consists of a quarter of its points and their images."""
    points = mcs.sampler("jittered | mirror(mode='uniform')", 2).draw(64, rng=seed)[0]
    folded = np.minimum(points, 1.0 - points)
    distinct = np.unique(np.round(folded, 12), axis=0)
    return Claim(
        "Mirror-uniform: 64 points are the four images of 16 points: number of distinct points "
        "after folding.",
        float(len(distinct)),
        expected=16.0,
    )


def _domain(dims: int) -> Claim:
    """Check that 2^d n points on the mirrored integrand have 1/2^d of the variance of n points."""
    f = INTEGRAND if dims == 2 else "gaussian(center=0.2, width=0.4, dims=1)"
    n, images = 64, 2**dims
    mirrored = float(mcs.exact_variance(mcs.Mirrored(f), "jittered", images * n))
    plain = float(mcs.exact_variance(f, "jittered", n))
    return Claim(
        f"Mirroring the integrand enlarges the domain {images} times in {dims} "
        f"dim{'s' * (dims > 1)}: {images}N jittered points have the strata of N points and "
        f"1/{images} of their variance: relative difference.",
        images * mirrored / plain - 1.0,
        at_most=1e-9,
    )


def _take_away(last: Mapping[tuple[str, bool], Measured], seed: int) -> Plot:
    """Return plots: the jump and its removal, the domains of both integrands, and the variances."""
    t = np.linspace(0.0, 2.0, 801)
    sections: list[Mark] = []
    for folded, color, label in (
        (t % 1.0, ACCENT, "wrapped around: jumps"),
        (1.0 - np.abs(1.0 - t), PALETTE[0], "mirrored: no jump"),
    ):
        jumps = np.abs(np.diff(folded, append=folded[-1])) > 0.5
        y = np.where(jumps, np.nan, np.exp(-(folded**2)))
        width = 4.0 if color == ACCENT else 1.6
        sections.append(Line(x=t, y=y, color=color, width=width, label=label))
    jump = np.exp([-1.0, 0.0])
    sections += [
        Line(x=np.ones(2), y=jump, color=ACCENT, dashes=":", width=2.0),
        TextMark(x=1.0, y=1.02, text="jump", color=ACCENT, side="above"),
        TextMark(x=1.0, y=0.32, text="no jump", color=PALETTE[0], side="below"),
    ]
    ticks = {0.0: "0", 1.0: "1", 2.0: "2"}
    cut = Panel(
        marks=tuple(sections),
        x=Axis(label="x", low=0.0, high=2.0, ticks=ticks),
        y=Axis(label="f(x, 0)", low=0.0, high=1.25),
        title="boundary discontinuities",
        grid=True,
    )
    x, y = 2.0 * mcs.sampler("jittered", 2).draw(64, rng=seed)[0].T
    lines = [
        ReferenceLine(at=k / 4, axis=a, color=FAINT, width=0.8) for a in AXES for k in range(9)
    ]
    square = np.array(
        [[(0, 0), (1, 0)], [(1, 0), (1, 1)], [(1, 1), (0, 1)], [(0, 1), (0, 0)]], float
    )
    domain = Panel(
        marks=(
            *lines,
            Dots(x=x, y=y, color=PALETTE[0], size=3.5),
            Segments(ends=square, color=INK, width=2.4, label="domain of f"),
        ),
        x=Axis(label="x", low=0.0, high=2.0, ticks={0.0: "0", 1.0: "1", 2.0: "2"}),
        y=Axis(label="y", low=0.0, high=2.0, ticks={0.0: "0", 1.0: "1", 2.0: "2"}),
        title="64 points on 4 times the domain",
        square=True,
    )
    rows = {
        "original": ("original", False),
        "shifted": ("original", True),
        "mirror-random": ("random", True),
        "mirror-uniform": ("uniform", True),
    }
    found = [last[key] for key in rows.values()]
    value, low, high = np.array([(each.value, each.low, each.high) for each in found]).T
    names = ["original", "original, shifted", "mirror-random, shifted", "mirror-uniform, shifted"]
    dots = [
        Dots(
            x=value[[k]], y=np.array([float(k)]), low=low[[k]], high=high[[k]], across=True,
            size=7.0, color=color, marker=marker,
        )
        for k, (color, marker) in enumerate(
            zip((PALETTE[6], ACCENT, PALETTE[3], PALETTE[0]), MARKERS, strict=False)
        )
    ]  # fmt: skip
    said = [
        TextMark(x=2.2 * float(value[k]), y=float(k), text=number(float(value[k]), 2))
        for k in range(len(names))
    ]
    variances = Panel(
        marks=(*dots, *said),
        x=log_axis("variance", float(low.min()) / 2, 1000 * float(high.max()), most=3),
        y=name_axis(names),
        title=f"variance with {_COUNTS[-1]} evaluations",
        grid=True,
    )
    return plot_of("take-away", cut, domain, variances)


def _integrands() -> Plot:
    t = (np.arange(400) + 0.5) / 200 - 1.0
    axis: dict[str, Any] = {"low": -1.0, "high": 1.0, "ticks": {-1.0: "−1", 0.0: "0", 1.0: "1"}}
    scale = Scale(high=1.0)
    images, sections = [], []
    for folded, title in ((t % 1.0, "original: wrapped around"), (np.abs(t), "mirrored")):
        values = np.exp(-(folded[:, None] ** 2) - folded**2)
        borders = [ReferenceLine(at=0.0, axis=a, color="#FFFFFF", width=0.8) for a in AXES]
        image = Heatmap(values=values, x=t, y=t, scale=scale, name="f")
        images.append(
            Panel(
                marks=(image, *borders),
                x=Axis(**axis),
                y=Axis(label="y", **axis),
                title=title,
                square=True,
            )
        )
        jumps = np.abs(np.diff(folded, append=folded[-1])) > 0.5
        line = Line(x=t, y=np.where(jumps, np.nan, np.exp(-(folded**2))), color=INK, width=1.4)
        y = Axis(label="f(x, 0)", low=0.0, high=1.1)
        sections.append(Panel(marks=(line,), x=Axis(label="x", **axis), y=y, grid=True))
    return Plot(kind="mirrored-integrand", panels=(*images, *sections), rows=(2.0, 1.0))
