"""Sums over integer frequencies give the variance. Sums over real frequencies diverge.

On the unit interval, f(x) = x jumps at the border, and g(x) = (1 − cos 2πx)/2 does not.
Half-integers are the frequencies of a domain of twice the length, [0, 2).
In the second half of this domain, f is 0 and there are no points.
For Δν = ½ and N → ∞, the sum over half-integers ν ≠ 0 tends to ∫ (f ⋆ box)² − I²/2.
This limit holds because |⟨S_ν⟩|² is the power spectrum of a box: 1 on [0, 1) and 0 on [1, 2).
"""

from __future__ import annotations

from functools import cache

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, Dots, Line, Mark, Panel, Plot, Segments
from mcspectra.plots.scales import count_axis, log_axis
from mcspectra.plots.style import ACCENT, INK, PALETTE
from mcspectra.plots.text import number
from mcspectra.report.page import Slider
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, about, known_rate, rate_text
from mcspectra.reproduction.panels import plot_of, slope_labels, whiskers

__all__ = ["exhibit"]

COUNTS = (16, 64, 256, 1024)
NAMES = {"f": "f(x) = x", "g": "g(x) = (1 − cos 2πx)/2"}
# Spec of each sampler whose variance is measured
SAMPLERS = {
    "random": "random",
    "jittered": "jittered | shift",
}
RATES = {"f": -2.0, "g": -3.0}
_SHOWN = 64  # number of points that the figure shows at first
# Number of frequencies in a sum.
# For f(x) = x, the omitted frequencies are a fraction 12 N / (4π² 2^16) of the sum.
# At N = 1024, the omitted frequencies are 0.5 % of the sum.
_HIGHEST = 2**16


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Sum products of spectra over integers and half-integers, and measure the variance."""
    curves = measured(1000 if quick else 10_000, seed)
    rates = " and ".join(
        f"{rate_text(curves[name].sel(sampler='jittered | shift'))} for {name}" for name in NAMES
    )
    levels = " and ".join(f"{number(real_limit(name))} for {name}" for name in NAMES)
    pairs = [(name, sampler) for name in NAMES for sampler in SAMPLERS]
    found = mcs.spectra.power_at(
        "jittered", 64, [[0.5]], realizations=200 if quick else 2000, rng=seed
    )

    # Draw sums over real and integer frequencies, and the variance
    panels = []
    n = np.array(COUNTS, float)
    for name, title in NAMES.items():
        marks: list[Mark] = []
        lines: list[tuple[Array, float, str]] = []
        for k, (sampler, spec) in enumerate(SAMPLERS.items()):
            for step, dashes, what in ((0.5, "--", "real"), (1.0, "-", "integer")):
                y, label = frequency_sums(name, sampler, step), f"{sampler}: {what}"
                marks.append(Line(x=n, y=y, color=PALETTE[k], dashes=dashes, label=label))  # type: ignore[arg-type]
                rate = RATES[name] if sampler == "jittered" else -1.0
                lines.append((y, rate if what == "integer" else 0.0, PALETTE[k]))
            curve = curves[name].sel(sampler=spec)
            ends = curve["variance_ci"].values
            marks.append(whiskers(n, curve["variance"].values, ends, k, f"{sampler}: measured"))
        low = float(exact_variances(name, "jittered").min()) / 2
        high = 2 * float(frequency_sums(name, "random", 0.5).max())
        marks += slope_labels(n, lines, (low, high))
        x, y_axis = count_axis("number of points N", COUNTS), log_axis("variance", low, high)
        panels.append(Panel(marks=tuple(marks), x=x, y=y_axis, title=title, grid=True))
    # Draw curves over real frequencies ν, which include the integers, and dots at the integers
    nu, whole = np.arange(10, 801) / 200, np.arange(1.0, 5.0)

    # Draw the power of jittered points also between integer frequencies
    power: list[Mark] = []
    for count, color in zip((16, 64, 256), ("#56B4E9", "#0072B2", INK), strict=True):
        lobes, notches = (
            mcs.closed_form_power("jittered", count, at[:, None]) for at in (nu, whole)
        )
        power.append(Line(x=nu, y=lobes, color=color, label=f"N = {count}"))
        power.append(Dots(x=whole, y=notches, color=ACCENT))
    x = Axis(label="frequency ν (cycles per unit)", low=0.0, high=4.1)
    y_axis = log_axis("⟨|S|²⟩", float(notches.min()), 1.0)
    combs = {str(n): _comb(n) for n in (4, 16, 64, 256)}
    here = COUNTS.index(_SHOWN)
    real, whole_sum = (float(frequency_sums("f", "jittered", step)[here]) for step in (0.5, 1.0))
    return Exhibit(
        numbers={
            "rates": rates,
            "levels": levels,
            "N": _SHOWN,
            "real": number(real),
            "whole": number(whole_sum),
            "exact": number(float(exact_variances("f", "jittered")[here])),
        },
        sliders={"comb": Slider("number of points N", combs, str(_SHOWN))},
        plots=(
            combs[str(_SHOWN)],
            plot_of("real-and-integer-frequencies", *panels),
            plot_of("spectrum", Panel(marks=tuple(power), x=x, y=y_axis, grid=True)),
        ),
        claims=(
            *(_integers(*pair) for pair in pairs),
            Claim(
                "The power does not vanish between the integers: at ν = ½ the power of 64 jittered "
                "points is (2/π)² plus a small variance.",
                Measured.normal(float(found["power"][0]), float(found["power_se"][0])),
                expected=float(mcs.closed_form_power("jittered", 64, [[0.5]])[0]),
                digits=6,
            ),
            *about(
                "real-and-integer-frequencies",
                *(
                    known_rate(
                        f"The variance of {name} with {spec} points has the rate "
                        f"{number(rate, 2)}.",
                        curves[name].sel(sampler=spec),
                        rate,
                        exact_variances(name, sampler),
                    )
                    for sampler, spec in reversed(SAMPLERS.items())
                    for name, rate in (
                        RATES if sampler == "jittered" else dict.fromkeys(NAMES, -1.0)
                    ).items()
                ),
                *(_real_rate(*pair) for pair in pairs),
                *(_real_level(name) for name in NAMES),
            ),
        ),
    )


def _comb(n: int) -> Plot:
    """Plot ⟨P_S⟩ × P_f as a curve over real frequencies, and as a comb of lines at integers."""
    nu, whole = np.arange(20, 1640) / 400, np.arange(1.0, 5.0)
    panels = []
    for sampler in SAMPLERS:
        line, teeth = (
            np.abs(transform("f", at)) ** 2 * mcs.closed_form_power(sampler, n, at[:, None])
            for at in (nu, whole)
        )
        low, high = 1e-8, 1.0
        stems = np.stack([np.stack([whole, 0 * whole + low], -1), np.stack([whole, teeth], -1)], 1)
        marks = (
            Line(x=nu, y=line, low=0 * nu + low, high=line, color="#D9E8F2", width=0.0),
            Line(x=nu, y=line, color=PALETTE[0], label="real frequencies: ∫ over the line"),
            Segments(ends=stems, color=ACCENT, width=2.0),
            Dots(
                x=whole, y=teeth, color=ACCENT, size=7.0, label="integer frequencies: Σ of the comb"
            ),
        )
        x = Axis(label="frequency ν (cycles per unit)", low=0.0, high=4.2)
        title = f"{sampler} points, N = {n}"
        panels.append(
            Panel(marks=marks, x=x, y=log_axis("⟨P_S⟩ × P_f", low, high), title=title, grid=True)
        )
    return plot_of("comb", *panels)


def measured(realizations: int, seed: int) -> dict[str, xr.Dataset]:
    """Measure the convergence for two functions, with two samplers each."""
    samplers = list(SAMPLERS.values())
    return {
        name: mcs.convergence(
            _integrand(name), samplers, list(COUNTS), realizations=realizations, rng=seed
        )
        for name in NAMES
    }


def _integrand(name: str) -> mcs.Integrand:
    def f(x: Array) -> Array:
        x = x[..., 0]
        return x if name == "f" else np.asarray(0.5 - 0.5 * np.cos(2 * np.pi * x))

    return mcs.Integrand.from_function(f, dims=1, integral=0.5)


@cache
def exact_variances(name: str, sampler: str) -> Array:
    """Return the exact variances of shifted points at all counts."""
    f, spec = _integrand(name), f"{sampler} | shift"
    return np.array([float(mcs.exact_variance(f, spec, n)) for n in COUNTS])


@cache
def frequency_sums(name: str, sampler: str, step: float) -> Array:
    """Return Σ |f(ν)|² ⟨|S_ν|²⟩ Δν over multiples ν ≠ 0 of the step Δν, for each count."""
    nu = step * np.arange(1.0, _HIGHEST + 1)
    power = np.abs(transform(name, nu)) ** 2
    sums = [power @ mcs.closed_form_power(sampler, n, nu[:, None]) for n in COUNTS]
    return 2 * step * np.array(sums)


@cache
def real_limit(name: str) -> float:
    """Return ∫ (f ⋆ box)² − I²/2, the limit of the sum over half-integers for N → ∞."""
    node, weight = np.polynomial.legendre.leggauss(60)
    t, weight = (node + 1) / 2, weight / 2
    # f ⋆ box is F(t) on [0, 1] and I − F(t − 1) on [1, 2], where F is the integral of f from 0
    partial = t**2 / 2 if name == "f" else t / 2 - np.sin(2 * np.pi * t) / (4 * np.pi)
    return float(weight @ (partial**2 + (0.5 - partial) ** 2)) - 0.5 * 0.5**2


def transform(name: str, nu: Array) -> Array:
    """Return ∫ f(x) exp(−2πiνx) dx over [0, 1] for ν ≠ 0."""

    def box(nu: Array) -> Array:
        return np.asarray(np.exp(-1j * np.pi * nu) * np.sinc(nu))

    if name == "g":
        return np.asarray(box(nu) / 2 - (box(nu - 1) + box(nu + 1)) / 4)
    w = 2 * np.pi * nu
    return np.asarray(np.exp(-1j * w) * (1j / w + 1 / w**2) - 1 / w**2)


def _integers(name: str, sampler: str) -> Claim:
    error = np.abs(frequency_sums(name, sampler, 1.0) / exact_variances(name, sampler) - 1.0)
    return Claim(
        f"The sum over integer frequencies is the variance of {name} with shifted {sampler} "
        f"points: largest relative difference for N = {COUNTS[0]} … {COUNTS[-1]}.",
        float(error.max()),
        at_most=1e-2 if name == "f" else 1e-9,
        note="Frequencies beyond the last one add less than 1 %." if name == "f" else "",
    )


def _real_rate(name: str, sampler: str) -> Claim:
    last = frequency_sums(name, sampler, 0.5)[-2:]
    return Claim(
        f"The rate that real frequencies predict for {name} with {sampler} points tends to 0, "
        f"N = {COUNTS[-2]} … {COUNTS[-1]}.",
        float(np.log(last[1] / last[0]) / np.log(COUNTS[-1] / COUNTS[-2])),
        expected=0.0,
        tolerance=0.02,
        shown="0 ± 0.02",
    )


def _real_level(name: str) -> Claim:
    limit = real_limit(name)
    return Claim(
        f"For jittered points, the sum over half-integer frequencies of {name} tends to "
        "∫ (f ⋆ box)² − I²/2.",
        float(frequency_sums(name, "jittered", 0.5)[-1]),
        expected=limit,
        tolerance=0.01 * limit,
        shown=f"{number(limit, 4)} ± 1 %",
        note=f"At N = {COUNTS[-1]}.",
    )
