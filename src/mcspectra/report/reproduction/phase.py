"""The third term encodes phase: strata that are shifted, and functions of equal power spectra."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.integrands.registry import integrand
from mcspectra.report.formatting import number, rate
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._curves import convergence_panel, known_rate
from mcspectra.report.reproduction._phase_variances import (
    BAR,
    HALF_WIDTH,
    HIGHEST,
    N,
    closed_matrix,
    displaced,
    displaced_curve,
    displaced_terms,
    equal_power,
    exact_bar,
    exact_curve,
    series,
    stratified,
    third_term,
)
from mcspectra.report.reproduction._terms import interval_of
from mcspectra.report.reproduction.base import Exhibit, Finding, agreement, comparison, identity
from mcspectra.report.style import INK, PALETTE, WIDE, entitle, legend_below, new_figure, quiet

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["exhibit"]

OFFSETS = (0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875)
CURVES = (0.0, 0.125, 0.5)

Scan: TypeAlias = "list[xr.Dataset]"


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Displace strata against edges, and edges against strata."""
    realizations = 1000 if quick else 10_000
    scan = [displaced_terms(o, realizations, seed) for o in OFFSETS]
    curves = {_label(o): displaced_curve(o, realizations, seed) for o in CURVES}
    findings = (
        _same_second(scan),
        _turned(),
        *(_variance(o, data) for o, data in zip(OFFSETS, scan, strict=True) if o in CURVES),
        _signs(scan[0], negative=True),
        _signs(scan[OFFSETS.index(0.5)], negative=False),
        _mean_of_third(),
        *(_rate(o, curves[_label(o)]) for o in CURVES),
        *_equal_power_findings(),
    )
    return Exhibit(
        name="phase",
        title="The third term encodes phase",
        slide="Third term is difficult to analyze. Third Term: Encodes phase (Ramamoorthi et al. 2012). Strata shifting "
        "affects convergence.",
        formula=r"S_m \mapsto e^{-2\pi i\, m \Delta} S_m: \qquad C_{mm} \mapsto C_{mm}, \qquad "
        r"C_{ml} \mapsto e^{-2\pi i\, (m - l) \Delta}\, C_{ml}",
        caption=_caption(scan, curves),
        pictures=(_offsets(scan), _convergence(curves), _functions()),
        findings=findings,
    )


def _label(offset: float) -> str:
    return {
        0.0: "not displaced",
        0.125: "displaced by 1/8 of a side",
        0.5: "displaced by half a side",
    }[offset]


def _caption(scan: Scan, curves: dict[str, xr.Dataset]) -> str:
    third = [float(d["cross_term"]) for d in scan]
    second = number(float(scan[0]["power_term"]))
    rates = ", ".join(
        f"{rate(float(c['rate']), *map(float, c['rate_ci'].values))} ({label})"
        for label, c in curves.items()
    )
    return (
        f"Strata moved by a part of their side keep all |S_m|, and with them the second term, {second} for {N} "
        f"jittered points and a bar; the third follows the phase, from {number(min(third))} to {number(max(third))}. "
        f"Displacement affects convergence: rates of a bar and a cosine are {rates}. Two functions of equal power "
        "spectra differ in the third term alone."
    )


def _same_second(scan: Scan) -> Finding:
    second = np.array([float(d["power_term"]) for d in scan])
    return identity(
        f"The second term does not depend on where the strata lie, for {len(OFFSETS)} offsets and the same random "
        "numbers: largest relative difference.",
        error=float(np.ptp(second) / second[0]),
        at_most=1e-9,
    )


def _turned() -> Finding:
    """The third term of points displaced by Δ is that of f displaced by −Δ: a phase of its coefficients."""
    offset = 0.3
    m, moved = closed_matrix(displaced(offset))
    _, c = closed_matrix("jittered")
    f = integrand(BAR, 1).fourier(m)
    turned = f * np.exp(2j * np.pi * m[:, 0] * offset / N)
    return identity(
        "Moving the strata by Δ is the same as turning the phases of f_m by 2πmΔ: difference of the third terms.",
        error=third_term(f, moved) - third_term(turned, c),
        at_most=1e-14,
    )


def _variance(offset: float, data: xr.Dataset) -> Finding:
    expected = exact_bar(offset, N)
    low, high = interval_of(data, "measured_variance")
    return comparison(
        f"Bar, strata {_label(offset)}: the variance is 2 s(1 − s)/N², with s = {number(offset)}.",
        expected=expected,
        measured=float(data["measured_variance"]),
        interval=(low, high),
        scale="log",
        tolerance=1e-25,
        note="Tolerance: rounding." if offset == 0.0 else "",
    )


def _signs(data: xr.Dataset, *, negative: bool) -> Finding:
    where = "at borders of strata it is negative" if negative else "in the middle it is positive"
    return agreement(
        f"Phase decides the sign of the third term: with the edges {where}.",
        measured=float(data["cross_term"]),
        interval=interval_of(data, "cross_term"),
        below=0.0 if negative else math.inf,
        above=-math.inf if negative else 0.0,
    )


def _mean_of_third() -> Finding:
    """The mean over equally spaced offsets is exact for all m − l but multiples of 64 strata."""
    f = integrand(BAR, 1).fourier(closed_matrix("jittered")[0])
    values = [third_term(f, closed_matrix(displaced(k / 64))[1]) for k in range(64)]
    return identity(
        "Averaged over all offsets, which is homogenisation, the third term is 0: over its largest size.",
        error=float(np.mean(values) / np.abs(values).max()),
        at_most=1e-12,
    )


def _rate(offset: float, curve: xr.Dataset) -> Finding:
    expected = -3.0 if offset == 0.0 else -2.0
    return known_rate(
        f"Strata shifting affects convergence: bar and cosine, strata {_label(offset)}: rate {number(expected, 2)}.",
        curve,
        expected,
        exact_curve(offset),
    )


def _equal_power_findings() -> list[Finding]:
    _, c = closed_matrix("jittered", HIGHEST)
    m, peak, chirp = equal_power()
    second = [float(np.abs(f) ** 2 @ np.diag(c).real) for f in (peak, chirp)]
    total = [second[k] + third_term(f, c) for k, f in enumerate((peak, chirp))]
    direct = [stratified(m, f) for f in (peak, chirp)]
    ratio = total[0] / total[1]
    return [
        identity(
            "Two functions of equal |f_m| have the same second term: relative difference.",
            error=second[0] / second[1] - 1.0,
            at_most=1e-14,
        ),
        identity(
            "Their variances with jittered points differ, and the three terms know it: ratio of both predictions less "
            "that of quadrature over strata.",
            error=ratio - direct[0] / direct[1],
            at_most=1e-9,
            note=f"The ratio is {number(ratio, 4)}.",
        ),
    ]


def _offsets(scan: Scan) -> Picture:
    figure = new_figure(WIDE, 3.2)
    axes = figure.subplots()
    quiet(axes, grid=True)
    for (name, label), color in zip(
        (("power_term", "second term"), ("cross_term", "third term"), ("predicted_variance", "sum")),
        PALETTE, strict=False,
    ):  # fmt: skip
        values = 1e3 * np.array([float(d[name]) for d in scan])
        ends = 1e3 * np.array([interval_of(d, name) for d in scan])
        axes.errorbar(
            OFFSETS, values, np.abs(ends.T - values), fmt="o-", ms=4, lw=1.2, color=color, label=label
        )  # fmt: skip
    s = np.linspace(0.0, 1.0, 100)
    exact = 1e3 * np.array([exact_bar(t, N) for t in s])
    axes.plot(s, exact, "--", color=INK, lw=1, label="exact variance, all frequencies")
    axes.axhline(0.0, color=INK, lw=0.7)
    axes.set(xlabel="offset of the strata (sides)", ylabel="terms · 10³", xlim=(-0.02, 1.02))
    legend_below(figure, axes, columns=4)
    return Picture(
        kind="phase-offsets",
        caption=f"Terms of the variance of a bar with {N} jittered points against the offset of the strata, over "
        f"|m| ≤ {HALF_WIDTH}, with 95 % intervals.",
        alt="Curves over the offset. The second term is level; the third is negative at 0 and positive at a half; "
        "their sum follows the arch of the exact variance.",
        figure=figure,
    )


def _convergence(curves: dict[str, xr.Dataset]) -> Picture:
    figure = new_figure(WIDE * 0.75, 3.6)
    axes = figure.subplots()
    convergence_panel(
        axes, curves, {_label(o): exact_curve(o) for o in CURVES}, "bar and cosine, jittered points"
    )
    axes.set_ylabel("variance")
    legend_below(figure, axes, columns=3)
    return Picture(
        kind="phase-convergence",
        caption="Variance against the number of points for strata displaced by parts of their side: measured, with "
        "95 % intervals, and exact (lines).",
        alt="Logarithmic plot of three falling lines. That of strata that are not displaced is steeper than the other "
        "two, which are parallel.",
        figure=figure,
    )


def _functions() -> Picture:
    m, peak, chirp = equal_power()
    x = np.linspace(0.0, 1.0, 600)
    figure = new_figure(WIDE, 2.7)
    panels = figure.subplots(1, 2)
    _, c = closed_matrix("jittered", HIGHEST)
    for axes, f, title in zip(
        panels, (peak, chirp), ("equal phases", "phases πm²/12"), strict=True
    ):
        second = float(np.abs(f) ** 2 @ np.diag(c).real)
        _draw(axes, x, series(x, m, f), f"{title}: variance {number(second + third_term(f, c))}")
    panels[0].set_ylabel("f(x)")
    return Picture(
        kind="phase-functions",
        caption=f"Two functions with the same power spectrum, and their exact variances with {N} jittered points.",
        alt="On the left a function with one peak at the border of the domain, on the right one whose waves are spread "
        "over the domain.",
        figure=figure,
    )


def _draw(axes: Axes, x: Array, values: Array, title: str) -> None:
    quiet(axes, grid=True)
    axes.plot(x, values, color=PALETTE[0], lw=1.3)
    axes.set(xlabel="x (domain, 0 to 1)", xlim=(0, 1))
    entitle(axes, title)
