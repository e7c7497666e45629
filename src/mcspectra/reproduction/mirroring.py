"""Mirroring of integrands or samples. With it, homogenization does not reduce the rate.

The mirrored integrand f(|x|, |y|) on [−1, 1)² consists of four copies of f, each reflected.
Original sampling places n points into the copy [0, 1)².
Mirror-random places each of n points into one of the four copies, chosen at random.
Mirror-uniform places the same n/4 points into all four copies.
A point x of [0, 1) is at x − 1 in the reflected copy, where the mirrored integrand is f(1 − x).

Mirror-uniform evaluates f at all four mirror images of each point.
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
from dataclasses import replace
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
from mcspectra.plots.scales import log_axis, name_axis
from mcspectra.plots.style import ACCENT, GRAY, INK, MARKERS, PALETTE
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
from mcspectra.reproduction.panels import AXES, plot_of, variance_panel

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

    # Plot the variances against N; in each figure, a gray line has the variances of the other
    curves = {
        h: [
            _compared(
                variance_panel(
                    {_WORDS[h]: cells[m, h]},
                    exact={_WORDS[h]: exact[m, h]},
                    title=title,
                    x="evaluations N",
                    limits=(3e-10, 1e-3),
                    beside=0.9,
                    first=int(h),
                ),
                exact[m, not h],
                f"{_WORDS[not h]} (exact)",
            )
            for m, title in _TITLES.items()
        ]
        for h in (True, False)
    }
    together = [
        variance_panel(
            {_TITLES[m]: cells[m, shifted] for m in _TITLES},
            exact={_TITLES[m]: exact[m, shifted] for m in _TITLES},
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
            plot_of("mirrored-samples", *(_samples(m, seed) for m in _TITLES)),
            plot_of("mirroring-homogenized", *curves[True]),
            plot_of("mirroring-plain", *curves[False]),
            plot_of("mirroring-convergence", *together),
            _take_away(seed),
            plot_of("mirroring-balance", _balance(last)),
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
            *about("mirrored-samples", _unbiased(seed), _folded(seed)),
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


def placed(mirroring: str, seed: int) -> tuple[Array, Array]:
    """Return positions in the mirrored integrand's domain, and the points where f is evaluated.

    The samplers return only points where f is evaluated. Points that they reflect are in a
    reflected copy of f.
    """
    images = 4 if mirroring == "uniform" else 1
    spec = "jittered" if mirroring == "original" else f"jittered | mirror(mode={mirroring!r})"
    own = np.repeat(mcs.sampler("jittered", 2).draw(64 // images, rng=seed)[0], images, axis=0)
    evaluated = mcs.sampler(spec, 2).draw(64, rng=seed)[0]
    return own - (evaluated != own), evaluated


def _folded(seed: int) -> Claim:
    """Check that the mirrored integrand has the values of f at the points of the samplers."""
    f = mcs.integrand(INTEGRAND)
    pairs = [placed(m, seed) for m in ("random", "uniform")]
    away = max(float(np.abs(np.exp(-(x**2).sum(axis=-1)) - f(u)).max()) for x, u in pairs)
    return Claim(
        "Mirror-random and mirror-uniform are points on the mirrored integrand: largest "
        "difference between its values at the positions in the plot and f at the samplers' points.",
        away,
        at_most=1e-12,
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


def _compared(panel: Panel, variances: Array, label: str) -> Panel:
    """Add a wide gray line of other variances behind the marks of a panel."""
    n = np.array(_COUNTS, float)
    line = Line(x=n, y=variances, color=GRAY, width=4.0, label=label)
    return replace(panel, marks=(line, *panel.marks))


def _samples(mirroring: str, seed: int) -> Panel:
    """Return 64 points and their strata over the original or the mirrored integrand, in gray."""
    low, side = (0.0, 8) if mirroring == "original" else (-1.0, 8 if mirroring == "uniform" else 16)
    t = low + (np.arange(256) + 0.5) / 256 * (1.0 - low)
    values = np.exp(-(t[:, None] ** 2) - t**2)
    at = np.linspace(low, 1.0, side + 1)
    rows = np.array([[[low, v], [1.0, v]] for v in at])
    square = np.array(
        [[(0, 0), (1, 0)], [(1, 0), (1, 1)], [(1, 1), (0, 1)], [(0, 1), (0, 0)]], float
    )
    x, y = placed(mirroring, seed)[0].T
    # The axes are a little longer than the domain, so that no point is cut off
    axis: dict[str, Any] = {"low": -1.05, "high": 1.05, "ticks": {-1.0: "−1", 0.0: "0", 1.0: "1"}}
    return Panel(
        marks=(
            Heatmap(
                values=values, x=t, y=t, scale=Scale(low=-0.6, high=2.4, palette="paper"), name="f"
            ),
            Segments(ends=np.concatenate([rows, rows[:, :, ::-1]]), color="#FFFFFF", width=0.7),
            Segments(ends=square, color=INK, width=2.2, label="domain of f"),
            Dots(x=x, y=y, color=PALETTE[0], size=3.6),
        ),
        x=Axis(label="x", **axis),
        y=Axis(label="y", **axis),
        title=_TITLES[mirroring],
        square=True,
        framed=True,
    )


def _take_away(seed: int) -> Plot:
    """Return plots: the jump and its removal, and points on the mirrored integrand's domain."""
    t = np.linspace(-1.0, 1.0, 801)
    sections: list[Mark] = []
    for folded, color, width, label in (
        (t % 1.0, ACCENT, 4.5, "wrapped around: jumps"),
        (np.abs(t), PALETTE[0], 1.8, "mirrored: no jump"),
    ):
        jumps = np.abs(np.diff(folded, append=folded[-1])) > 0.5
        y = np.where(jumps, np.nan, np.exp(-(folded**2)))
        sections.append(Line(x=t, y=y, color=color, width=width, label=label))
    sections += [
        Line(x=np.zeros(2), y=np.exp([-1.0, 0.0]), color=ACCENT, dashes=":", width=2.0),
        TextMark(x=0.04, y=0.5, text="jump", color=ACCENT),
        TextMark(x=0.0, y=1.03, text="no jump", color=PALETTE[0], side="above"),
    ]
    cut = Panel(
        marks=tuple(sections),
        x=Axis(label="x", low=-1.0, high=1.0, ticks={-1.0: "−1", 0.0: "0", 1.0: "1"}),
        y=Axis(label="f(x, 0)", low=0.0, high=1.2),
        title="boundary discontinuities",
        grid=True,
    )
    return plot_of("take-away", cut, replace(_samples("uniform", seed), title="4 times the domain"))


def _balance(last: Mapping[tuple[str, bool], Measured]) -> Panel:
    """Return the variances at the largest N: original, and all variants after a shift."""
    rows = {
        "original": ("original", False),
        "original, shifted": ("original", True),
        "mirror-random, shifted": ("random", True),
        "mirror-uniform, shifted": ("uniform", True),
    }
    found = [last[key] for key in rows.values()]
    value, low, high = np.array([(each.value, each.low, each.high) for each in found]).T
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
        for k in range(len(rows))
    ]
    return Panel(
        marks=(*dots, *said),
        x=log_axis("variance", float(low.min()) / 2, 100 * float(high.max()), most=5),
        y=name_axis(list(rows)),
        title=f"variance with {_COUNTS[-1]} evaluations",
        grid=True,
    )


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
