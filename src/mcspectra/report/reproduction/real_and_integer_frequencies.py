"""Predictions from real frequencies diverge from the variance; those from integers follow it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.axes import count_axis, log_axis
from mcspectra.report.formatting import number, rate
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._frequency_sums import (
    COUNTS,
    NAMES,
    SAMPLERS,
    exact_variances,
    integer_sums,
    measured,
    real_limit,
    real_sums,
)
from mcspectra.report.reproduction.base import (
    Exhibit,
    Finding,
    comparison,
    identity,
    normal_interval,
    rate_finding,
)
from mcspectra.report.style import (
    ACCENT,
    INK,
    NARROW,
    PALETTE,
    WIDE,
    entitle,
    legend_below,
    new_figure,
    quiet,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["exhibit"]

_RATES = {"f": -2.0, "g": -3.0}
_LAST = COUNTS[-1]


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Sum products of spectra over integers and over half-integers, and measure the variance."""
    curves = measured(1000 if quick else 10_000, seed)
    findings = (
        *(_measured_rate(name, "jittered", curves[name]) for name in NAMES),
        *(_measured_rate(name, "random", curves[name]) for name in NAMES),
        *(_integers(name, sampler) for name in NAMES for sampler in SAMPLERS),
        *(_real_rate(name, sampler) for name in NAMES for sampler in SAMPLERS),
        *(_real_level(name) for name in NAMES),
        _power_between(200 if quick else 2000, seed),
    )
    return Exhibit(
        name="real-and-integer-frequencies",
        title="Real against integer frequencies: predicted rates diverge",
        slide="Real vs. Integer Frequencies; Convergence Rates Diverges at Real Frequencies (Random and Jittered, "
        "integer and real frequencies, f(x) and g(x)); Finite sampling domain is not properly handled; Fourier "
        "series based Variance Formulation.",
        formula=r"\mathrm{Var}(I_N) = \sum_{m \in \mathbb{Z}, \, m \neq 0} \langle \mathcal{P}_{S_N}(m) \rangle "
        r"\times \mathcal{P}_f(m)",
        caption=_caption(curves),
        pictures=(_convergence(curves), _spectrum()),
        findings=findings,
    )


def _caption(curves: dict[str, xr.Dataset]) -> str:
    rates = " and ".join(
        f"{rate(float(c['rate']), *map(float, c['rate_ci'].values))} for {name}"
        for name, c in ((n, curves[n].sel(sampler="jittered | shift")) for n in NAMES)
    )
    levels = " and ".join(f"{number(real_limit(n))} for {n}" for n in NAMES)
    return (
        f"Of f(x) = x, which jumps where the domain ends, and g(x) = (1 − cos 2πx)/2, which does not, jittered and "
        f"shifted points converge with the rates {rates}. The sum over integer frequencies follows the variance. "
        f"Between the integers ⟨S⟩ is the transform of the domain itself, whatever N, and a sum over real "
        f"frequencies takes it for variance: it tends to {levels}, with the rate 0, for every sampler."
    )


def _measured_rate(name: str, sampler: str, curves: xr.Dataset) -> Finding:
    shown = "jittered | shift" if sampler == "jittered" else sampler
    expected = _RATES[name] if sampler == "jittered" else -1.0
    exact = _slope(exact_variances(name, sampler))
    return rate_finding(
        f"The variance of {name} converges, with {shown} points, at the rate {number(expected, 2)}.",
        curves.sel(sampler=shown),
        expected=expected,
        tolerance=abs(exact - expected),
        note=f"Tolerance: the exact variances at these N have the slope {number(exact, 5)}.",
    )


def _slope(values: Array) -> float:
    return float(np.polyfit(np.log(COUNTS), np.log(values), 1)[0])


def _integers(name: str, sampler: str) -> Finding:
    error = np.abs(integer_sums(name, sampler) / exact_variances(name, sampler) - 1.0)
    return identity(
        f"The sum over integer frequencies is the variance of {name} with {sampler} points, shifted: largest "
        f"relative difference for N = {COUNTS[0]} … {_LAST}.",
        error=float(error.max()),
        at_most=1e-2 if name == "f" else 1e-9,
        note="What lies beyond the last frequency is less than 1 % of it." if name == "f" else "",
    )


def _real_rate(name: str, sampler: str) -> Finding:
    last = real_sums(name, sampler)[-2:]
    slope = float(np.log(last[1] / last[0]) / np.log(COUNTS[-1] / COUNTS[-2]))
    return Finding(
        statement=f"The rate that real frequencies predict for {name} with {sampler} points tends to 0, "
        f"N = {COUNTS[-2]} … {_LAST}.",
        expected="0 ± 0.02",
        measured=slope,
        interval=None,
        agrees=abs(slope) <= 0.02,
    )


def _real_level(name: str) -> Finding:
    limit = real_limit(name)
    value = float(real_sums(name, "jittered")[-1])
    return Finding(
        statement=f"The sum over half-integer frequencies of {name} tends to ∫ (f ⋆ box)² − I²/2, jittered points.",
        expected=f"{number(limit, 4)} ± 1 %",
        measured=value,
        interval=None,
        agrees=abs(value / limit - 1.0) <= 0.01,
        note=f"At N = {_LAST}.",
    )


def _power_between(realizations: int, seed: int) -> Finding:
    from mcspectra.spectra.listed import power_at

    found = power_at("jittered", 64, [[0.5]], realizations=realizations, rng=seed)
    value, se = float(found["power"][0]), float(found["power_se"][0])
    expected = float(_power(64, np.array([0.5]))[0])
    return comparison(
        "Between the integers the power does not vanish: at ν = ½ that of 64 jittered points is (2/π)² and the "
        "little that their variance adds.",
        expected=expected,
        measured=value,
        interval=normal_interval(value, se),
        text=number(expected, 6),
    )


def _power(n: int, nu: Array) -> Array:
    from mcspectra.spectra.closed_forms import closed_form_power

    return closed_form_power("jittered", n, nu[:, None])


def _convergence(curves: dict[str, xr.Dataset]) -> Picture:
    figure = new_figure(WIDE, 3.9)
    panels = figure.subplots(1, 2)
    for axes, name in zip(panels, NAMES, strict=True):
        quiet(axes, grid=True)
        for sampler, color in zip(SAMPLERS, PALETTE, strict=False):
            _draw(axes, name, sampler, color, curves[name])
        count_axis(axes, "x", COUNTS)
        low = float(exact_variances(name, "jittered").min())
        log_axis(axes, "y", low / 2, 2 * float(real_sums(name, "random").max()))
        axes.set_xlabel("number of points N")
        entitle(axes, {"f": "f(x) = x", "g": "g(x) = (1 − cos 2πx)/2"}[name])
    panels[0].set_ylabel("variance")
    legend_below(figure, panels[0], columns=3)
    return Picture(
        kind="real-and-integer-frequencies",
        caption="Measured variance with 95 % intervals, and what sums over integer and over half-integer frequencies "
        "predict. Jittered points are shifted where the variance is measured.",
        alt="Two logarithmic plots against N. Measured points lie on the lines of integer frequencies, which fall; "
        "those of real frequencies become level, for random and jittered points alike.",
        figure=figure,
    )


def _draw(axes: Axes, name: str, sampler: str, color: str, curves: xr.Dataset) -> None:
    curve = curves.sel(sampler="jittered | shift" if sampler == "jittered" else sampler)
    variance, (low, high) = curve["variance"].values, curve["variance_ci"].values.T
    axes.plot(COUNTS, real_sums(name, sampler), "--", color=color, lw=1.4, label=f"{sampler}: real")
    axes.plot(COUNTS, integer_sums(name, sampler), color=color, lw=1.4, label=f"{sampler}: integer")
    bars = [variance - low, high - variance]
    axes.errorbar(
        COUNTS, variance, bars, fmt="o", ms=4, lw=1, color=color, label=f"{sampler}: measured"
    )


def _spectrum() -> Picture:
    figure = new_figure(NARROW, 3.2)
    axes = figure.subplots()
    quiet(axes, grid=True)
    nu = np.arange(10, 801) / 200  # the integers included
    whole = np.arange(1.0, 5.0)
    for n, color in zip((16, 64, 256), ("#56B4E9", "#0072B2", INK), strict=True):
        axes.plot(nu, _power(n, nu), color=color, lw=1.3, label=f"N = {n}")
        axes.plot(whole, _power(n, whole), "o", ms=4, color=ACCENT)
    log_axis(axes, "y", float(_power(256, whole).min()), 1.0)
    axes.set(xlabel="frequency ν (cycles per unit)", ylabel="⟨|S|²⟩", xlim=(0, 4.1))
    legend_below(figure, axes, columns=3)
    return Picture(
        kind="spectrum",
        caption="Expected power of jittered points at real frequencies (lines) and at the integers (orange dots): "
        "the lobes between them stay as N grows.",
        alt="Three curves with lobes of equal height between the integers, and deep notches at these, deeper for "
        "larger N.",
        figure=figure,
    )
