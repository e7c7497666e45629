"""The cross term depends on phase: examples with shifted strata, and with equal power spectra."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, Line, Mark, Panel, Plot, ReferenceLine
from mcspectra.plots.style import GRAY, INK, PALETTE, TERM_COLORS
from mcspectra.plots.text import number
from mcspectra.report.page import Slider
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, about, known_rate, rate_text
from mcspectra.reproduction.panels import plot_of, variance_panel, whiskers

__all__ = ["exhibit"]

COUNTS = (16, 64, 256, 1024)
N = 16
HALF_WIDTH = 48
BAR = "disk(center=0.5, radius=0.25)"  # 1/4 and 3/4 are borders of 4^k strata
OFFSETS = (0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875)
LABELS = {
    0.0: "not displaced",
    0.125: "displaced by 1/8 of a side",
    0.5: "displaced by half a side",
}
RATES = {0.0: -3.0, 0.125: -2.0, 0.5: -2.0}
_HIGHEST = 12  # highest frequency of two functions with equal power spectra


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Move the strata while f stays fixed, and then move f while the strata stay fixed."""
    realizations = 1000 if quick else 10_000
    scan = {offset: bar_terms(offset, realizations, seed) for offset in OFFSETS}
    curves = {offset: displaced_curve(offset, realizations, seed) for offset in LABELS}
    second = np.array([float(data["power_term"]) for data in scan.values()])
    rates = ", ".join(f"{rate_text(curve)} ({LABELS[offset]})" for offset, curve in curves.items())

    # Move f instead of the points: each coefficient is multiplied by a phase
    m, still = _matrix("jittered")
    bar = mcs.integrand(BAR, 1).fourier(m)
    turned = bar * np.exp(2j * np.pi * m[:, 0] * 0.3 / N)

    # Average the third variance term over 64 offsets of the strata.
    # The average is exact if no two frequencies differ by a multiple of 64 · (number of strata)
    values = [_third(bar, _matrix(displaced(k / 64))[1]) for k in range(64)]

    # Predict the variances of two functions with equal power spectra, and compare with quadrature
    m, functions = _equal_power()
    (one_second, one_third), (other_second, other_third) = map(_predicted, functions)
    direct = [_stratified(m, f) for f in functions]
    times = (one_second + one_third) / (other_second + other_third)

    # Draw the exact terms over all frequencies, and the measured variance
    at, s = np.array(OFFSETS), np.linspace(0.0, 1.0, 101)
    power = exact_second(N)
    total = np.array([exact_bar(float(t), N) for t in s])
    lines = {
        "power_term": ("second term: from powers alone", np.full_like(s, power)),
        "cross_term": ("third term: from phases, too", total - power),
        "predicted_variance": ("their sum, the variance", total),
    }
    marks: list[Mark] = [ReferenceLine(at=0.0, color=INK, width=0.7)]
    for name, (label, term) in lines.items():
        color = TERM_COLORS[name]
        marks.append(Line(x=s, y=1e3 * term, color=color, width=2.4, label=label))
    found = [Measured.of(data, "measured_variance", log=True) for data in scan.values()]
    value = 1e3 * np.array([each.value for each in found])
    ends = 1e3 * np.array([(each.low, each.high) for each in found])
    dots = whiskers(at, value, ends, 0, "measured variance", 6.0)
    marks.append(replace(dots, color=INK))
    x = Axis(label="offset of the strata, in widths", low=-0.02, high=1.02)
    terms = Panel(marks=tuple(marks), x=x, y=Axis(label="terms · 10³"), grid=True)
    frames = {f"{t:g}": _displaced(t, terms) for t in OFFSETS}
    exact = {LABELS[offset]: exact_curve(offset) for offset in curves}
    shown = {LABELS[offset]: curve for offset, curve in curves.items()}
    return Exhibit(
        numbers={
            "second": number(1e3 * power),
            "N": N,
            "least": number(-1e3 * power),
            "most": number(1e3 * (exact_bar(0.5, N) - power)),
            "rates": rates,
        },
        plots=(
            frames["0.5"],
            plot_of(
                "phase-convergence",
                variance_panel(
                    shown, exact=exact, title="bar and cosine, jittered points", letters=0.7
                ),
            ),
            _functions(),
        ),
        sliders={"phase-offsets": Slider("offset of the strata, in widths", frames, "0.5")},
        claims=(
            Claim(
                "The second term does not depend on the position of the strata, for "
                f"{len(scan)} offsets and the same random numbers: largest relative difference.",
                float(np.ptp(second) / second[0]),
                at_most=1e-9,
            ),
            Claim(
                "Shifting the strata by Δ is the same as changing the phases of f_m by 2πmΔ: "
                "difference of the third terms.",
                _third(bar, _matrix(displaced(0.3))[1]) - _third(turned, still),
                at_most=1e-14,
            ),
            *(
                Claim(
                    f"Bar, strata {LABELS[offset]}: the variance is 2 s(1 − s)/N², with s = "
                    f"{number(offset)}.",
                    Measured.of(scan[offset], "measured_variance", log=True),
                    expected=exact_bar(offset, N),
                    tolerance=1e-25,
                    note="Tolerance: rounding." if offset == 0.0 else "",
                )
                for offset in LABELS
            ),
            Claim(
                "Phase determines the sign of the third term: it is negative for edges at borders "
                "of strata.",
                Measured.of(scan[0.0], "cross_term"),
                below=0.0,
            ),
            Claim(
                "Phase determines the sign of the third term: it is positive for edges in the "
                "middle of strata.",
                Measured.of(scan[0.5], "cross_term"),
                above=0.0,
            ),
            Claim(
                "The third term averaged over all offsets (homogenization) is 0: mean relative to "
                "the largest magnitude.",
                float(np.mean(values) / np.abs(values).max()),
                at_most=1e-12,
            ),
            *about(
                "phase-convergence",
                *(
                    known_rate(
                        "Shifting strata affects convergence: bar and cosine, strata "
                        f"{LABELS[offset]}: rate {number(rate, 2)}.",
                        curves[offset],
                        rate,
                        exact_curve(offset),
                    )
                    for offset, rate in RATES.items()
                ),
            ),
            Claim(
                "Two functions with equal |f_m| have the same second term: relative difference.",
                one_second / other_second - 1.0,
                at_most=1e-14,
            ),
            Claim(
                "The three terms predict the different variances of these functions with jittered "
                "points: ratio of the predictions minus the ratio by quadrature over strata.",
                times - direct[0] / direct[1],
                at_most=1e-9,
                note=f"The ratio is {number(times, 4)}.",
            ),
        ),
    )


def _displaced(offset: float, terms: Panel) -> Plot:
    """Plot f and the strata moved by an offset, and mark the offset in a plot of the terms."""
    places = ((np.arange(N) + offset) / N).tolist()
    side = 1 / N
    cut = [(e - (e - offset * side) % side) for e in (0.25, 0.75)] if offset else []
    strata = [
        Line(
            x=np.array([c, c + side]), y=np.array([1.0, 1.0]), low=np.zeros(2), high=np.ones(2),
            color="#F5C9A9", width=0.0,
        )
        for c in cut
    ]  # fmt: skip
    x, y = np.array([0.0, 0.25, 0.25, 0.75, 0.75, 1.0]), np.array([0.0, 0, 1, 1, 0, 0])
    bar = Panel(
        marks=(
            *strata,
            *(ReferenceLine(at=at, axis="x", color=GRAY, width=0.7) for at in places),
            Line(x=x, y=y, color=INK, width=2.4),
        ),
        x=Axis(label="x (domain, 0 to 1)", low=0.0, high=1.0),
        y=Axis(label="f(x)", low=0.0, high=1.1),
        title=f"f and strata, offset {offset:g}",
    )
    here = ReferenceLine(at=offset, axis="x", color="#F5C9A9", width=5.0)
    return plot_of("phase-offsets", bar, replace(terms, marks=(here, *terms.marks)))


def displaced(offset: float) -> str:
    """Return the spec of jittered points whose strata are shifted by a fraction of their side."""
    return f"jittered | strata-shift(offset={offset})"


def bar_terms(offset: float, realizations: int, seed: int) -> xr.Dataset:
    """Return the variance terms for the indicator of an interval, with shifted strata."""
    options: dict[str, Any] = {"half_width": HALF_WIDTH, "realizations": realizations, "rng": seed}
    return mcs.variance_terms(mcs.integrand(BAR, 1), displaced(offset), N, **options)


def smooth() -> mcs.Integrand:
    """Return the indicator of an interval plus a cosine.

    Edges at borders of strata add no variance, but the cosine does.
    """

    def f(x: Array) -> Array:
        return np.asarray((np.abs(x[..., 0] - 0.5) < 0.25) + np.cos(2 * np.pi * x[..., 0]))

    return mcs.Integrand.from_function(f, dims=1, integral=0.5)


def displaced_curve(offset: float, realizations: int, seed: int) -> xr.Dataset:
    """Measure the convergence for the indicator of an interval plus a cosine."""
    spec = displaced(offset)
    return mcs.convergence(smooth(), spec, list(COUNTS), realizations=realizations, rng=seed)


def exact_bar(offset: float, n: int) -> float:
    """Return 2 s(1 − s)/N²: both edges cut a stratum into the parts s = offset and 1 − s."""
    return 2 * offset * (1 - offset) / n**2


def exact_second(n: int) -> float:
    """Return 1/(3N²), the mean of `exact_bar` over all offsets: a shift leaves the second term."""
    return 1 / (3 * n**2)


def exact_curve(offset: float) -> Array:
    """Return the exact variances for `smooth`, by quadrature on either side of each edge."""
    node, weight = np.polynomial.legendre.leggauss(8)
    node, weight = (node + 1) / 2, weight / 2
    # The edge cuts a stratum at the fraction 1 − offset of its length
    t = np.concatenate([node * (1 - offset), 1 - offset + node * offset])
    w = np.concatenate([weight * (1 - offset), weight * offset])
    found = []
    for n in COUNTS:
        f = smooth()((((np.arange(n)[:, None] + t + offset) / n) % 1.0)[..., None])
        found.append(float((((f - (f @ w)[:, None]) ** 2) @ w).sum()) / n**2)
    return np.array(found)


def _matrix(sampler: str, half_width: int = HALF_WIDTH) -> tuple[Array, Array]:
    """Return frequencies (M, 1), and the matrix C_ml in closed form."""
    m = np.arange(-half_width, half_width + 1)[:, None]
    return m, mcs.spectra.closed_form_covariance(sampler, N, m[:, None], m[None])


def _third(f: Array, c: Array) -> float:
    """Return the sum of conj(f_m) f_l C_ml over m ≠ l."""
    matrix = f.conj()[:, None] * f[None] * c
    return float((matrix.sum() - np.trace(matrix)).real)


def _equal_power() -> tuple[Array, tuple[Array, Array]]:
    """Return frequencies, and the coefficients of two real functions with equal |f_m|.

    The first function is a peak (all phases 0). The second is a wide chirp (phases π m²/K).
    """
    m = np.arange(-_HIGHEST, _HIGHEST + 1)[:, None]
    size = 1.0 / (1.0 + np.abs(m[:, 0]))
    chirp = size * np.exp(1j * np.pi * np.sign(m[:, 0]) * m[:, 0] ** 2 / _HIGHEST)
    return m, (size + 0j, chirp)


def _series(x: Array, m: Array, f: Array) -> Array:
    """Return the real function Σ f_m exp(2πi m x) at points x."""
    return np.asarray((np.exp(2j * np.pi * x[..., None] * m[:, 0]) @ f).real)


def _stratified(m: Array, f: Array) -> float:
    """Return the variance of jittered points for a series, by quadrature in each stratum."""
    node, weight = np.polynomial.legendre.leggauss(16)
    values = _series((np.arange(N)[:, None] + (node + 1) / 2) / N, m, f)
    weight = np.tile(weight / 2, (N, 1))
    mean = (values * weight).sum(axis=1)
    return float(((values - mean[:, None]) ** 2 * weight).sum()) / N**2


def _predicted(f: Array) -> tuple[float, float]:
    """Return the power and cross terms of the variance of a Fourier series at jittered points."""
    _, c = _matrix("jittered", _HIGHEST)
    return float(np.abs(f) ** 2 @ np.diag(c).real), _third(f, c)


def _functions() -> Plot:
    m, functions = _equal_power()
    x = np.linspace(0.0, 1.0, 600)
    panels = []
    for f, phases in zip(functions, ("equal phases", "phases πm²/12"), strict=True):
        panels.append(
            Panel(
                marks=(Line(x=x, y=_series(x, m, f), color=PALETTE[0]),),
                x=Axis(label="x (domain, 0 to 1)", low=0.0, high=1.0),
                y=Axis(label="f(x)"),
                title=f"{phases}: variance {number(sum(_predicted(f)))}",
                grid=True,
            )
        )
    return plot_of("phase-functions", *panels)
