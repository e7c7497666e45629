"""Expected power of random and jittered points in closed form, against the slides and simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.axes import log_axis
from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction.base import (
    GALLERY_FINDINGS,
    Exhibit,
    Finding,
    comparison,
    identity,
    normal_interval,
)
from mcspectra.report.style import (
    PALETTE,
    WIDE,
    entitle,
    legend_below,
    line_widths,
    new_figure,
    quiet,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["exhibit"]

_N = 16
_DENSITY = "linear(slope=1)"
_INTEGERS = np.arange(1.0, 65.0)
_REALS = np.arange(1.0, 65.0) * 0.37 + 0.05

Simulated: TypeAlias = "dict[str, xr.Dataset]"


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Compare the closed forms with the slides' formulas, with simulation, and with their limits."""
    realizations = 4000 if quick else 40_000
    nu = np.concatenate([_INTEGERS, _REALS])
    simulated = {s: _simulated(s, nu, realizations, seed) for s in ("random", "jittered")}
    findings = (
        *(_as_printed(name) for name in simulated),
        *(_as_simulated(name, data, nu) for name, data in simulated.items()),
        _in_the_plane(realizations // 4, seed),
        _low_limit(),
        _strata_multiple(),
        _level(realizations, seed),
    )
    return Exhibit(
        name="closed-forms",
        title="Expected power spectra in closed form",
        slide="Expected power spectra (supplementary document). Random: 1 at m = 0, else 1/N + (N−1)/N Sinc(πm)²; "
        "Jittered: (1/N)(1 − Sinc(πm/N)²) + Sinc(πm)².",
        formula=r"\langle S_m^* S_m \rangle = \frac{1}{N} \left( 1 - \mathrm{Sinc}\left(\frac{\pi m}{N}\right)^2 "
        r"\right) + \mathrm{Sinc}(\pi m)^2",
        caption=_caption(findings),
        pictures=(_curves(simulated, nu),),
        findings=findings,
    )


def _caption(findings: tuple[Finding, ...]) -> str:
    random, jittered = (number(float(f.measured or 0)) for f in findings[2:4])
    return (
        f"The closed forms of the slides hold at real frequencies as at integer ones: simulated spectra of N = {_N} "
        f"points lie within {random} (random) and {jittered} (jittered) standard errors at all of "
        f"{_INTEGERS.size + _REALS.size} frequencies. At the integers the Sinc(πm) vanish: random points have "
        "1/N everywhere, jittered ones have less at frequencies below N: N³ times their power at m = 1 tends to π²/3."
    )


def _closed(name: str, nu: Array, n: int = _N) -> Array:
    from mcspectra.spectra.closed_forms import closed_form_power

    return closed_form_power(name, n, nu[:, None])


def _printed(name: str, m: Array) -> Array:
    """The formulas as the slides print them; NumPy's sinc(x) is Sinc(πx)."""
    if name == "random":
        return np.where(m == 0, 1.0, 1 / _N + (_N - 1) / _N * np.sinc(m) ** 2)
    return np.asarray((1 - np.sinc(m / _N) ** 2) / _N + np.sinc(m) ** 2)


def _as_printed(name: str) -> Finding:
    nu = np.concatenate([[0.0], _INTEGERS, _REALS])
    return identity(
        f"The closed form of {name} points is that of the slides, integer and real frequencies: largest difference.",
        error=float(np.abs(_closed(name, nu) - _printed(name, nu)).max()),
        at_most=1e-14,
    )


def _simulated(name: str, nu: Array, realizations: int, seed: int) -> xr.Dataset:
    from mcspectra.samplers.registry import sampler
    from mcspectra.spectra.listed import power_at

    return power_at(sampler(name, 1), _N, nu[:, None], realizations=realizations, rng=seed)


def _as_simulated(name: str, data: xr.Dataset, nu: Array) -> Finding:
    return _farthest(
        f"Simulated spectra of {name} points agree with the closed form at {nu.size} frequencies, half of them "
        "integers",
        data["power"].values,
        data["power_se"].values,
        _closed(name, nu),
    )


def _farthest(statement: str, power: Array, se: Array, expected: Array) -> Finding:
    """The largest distance in standard errors, against its quantile for so many frequencies."""
    from scipy.special import ndtri

    distance = float(np.max(np.abs(power - expected) / se))
    level = 0.95 ** (1 / (GALLERY_FINDINGS * power.size))
    limit = float(ndtri((1 + level) / 2))
    return Finding(
        statement=f"{statement}: largest distance in standard errors.",
        expected=f"≤ {limit:.1f}",
        measured=distance,
        interval=None,
        agrees=distance <= limit,
        note=f"The limit is that of {power.size} normal errors at the gallery's level.",
    )


def _in_the_plane(realizations: int, seed: int) -> Finding:
    from mcspectra.samplers.registry import sampler
    from mcspectra.spectra.closed_forms import closed_form_power
    from mcspectra.spectra.listed import power_at

    m = np.array([[i, j] for i in range(9) for j in range(-8, 9) if (i, j) > (0, 0)], float)
    found = power_at(sampler("jittered", 2), 64, m, realizations=realizations, rng=seed)
    return _farthest(
        f"In two dims too, 64 jittered points at {len(m)} integer frequencies",
        found["power"].values,
        found["power_se"].values,
        closed_form_power("jittered", 64, m),
    )


def _low_limit() -> Finding:
    n = 1024
    value = n**3 * float(_closed("jittered", np.array([1.0]), n)[0])
    return identity(
        "N³ times the power of jittered points at m = 1 tends to π²/3, with which variance falls as N⁻³: relative "
        "difference at N = 1024.",
        error=value / (np.pi**2 / 3) - 1.0,
        # 1 − sinc²(x) = x²/3 − 2x⁴/45 …: relatively 2 (π/N)²/15 = 1.3e-6, beside rounding
        at_most=1e-5,
    )


def _strata_multiple() -> Finding:
    m = _N * np.arange(1.0, 5.0)
    return identity(
        "At multiples of N, the frequency of the strata, jittered points have the power 1/N of random ones: "
        "largest difference.",
        error=float(np.abs(_closed("jittered", m) - _closed("random", m)).max()),
        at_most=1e-15,
    )


def _level(realizations: int, seed: int) -> Finding:
    """Importance samples: ∫1/p / N at integers, ln 3 / N for p = ½ + x."""
    from mcspectra.samplers.registry import sampler
    from mcspectra.spectra.listed import power_at

    found = power_at(
        sampler("random", 1), _N, [[5.0]], density=_DENSITY, realizations=realizations, rng=seed
    )
    value, se = float(found["power"][0]), float(found["power_se"][0])
    expected = np.log(3.0) / _N
    return comparison(
        "Of random importance samples of p = ½ + x the power at integers is ∫1/p / N = ln 3 / N.",
        expected=expected,
        measured=value,
        interval=normal_interval(value, se),
        text=number(expected, 5),
    )


def _curves(simulated: Simulated, nu: Array) -> Picture:
    figure = new_figure(WIDE, 3.5)
    panels = figure.subplots(1, 2, sharey=True)
    _panel(panels[0], simulated, nu, _INTEGERS, "integer frequencies")
    _panel(panels[1], simulated, nu, _REALS, "real frequencies")
    panels[0].set_ylabel("⟨|S|²⟩")
    legend_below(figure, panels[0], columns=4)
    return Picture(
        kind="closed-forms",
        caption=f"Closed forms (lines) and simulated spectra (dots, with 95 % intervals) of {_N} random and jittered "
        "points, at integer and at real frequencies.",
        alt="Two logarithmic plots of power against frequency. At integers random points are level at 1/16, jittered "
        "ones rise to it; at real frequencies both carry the lobes of sinc². Dots lie on the lines.",
        figure=figure,
    )


def _panel(axes: Axes, simulated: Simulated, nu: Array, shown: Array, title: str) -> None:
    quiet(axes, grid=True)
    chosen = np.isin(nu, shown) & (nu <= 24)
    line = np.arange(1.0, 25.0) if shown is _INTEGERS else np.linspace(0.4, 24.0, 1200)
    styles = zip(PALETTE, line_widths(2), strict=False)
    for (name, data), (color, width) in zip(simulated.items(), styles, strict=True):
        axes.plot(line, _closed(name, line), color=color, lw=width, label=f"{name}, closed form")
        power, se = (data[key].values[chosen] for key in ("power", "power_se"))
        axes.errorbar(
            nu[chosen], power, 1.96 * se, fmt="o", ms=3, lw=1, color=color, label=f"{name}, simulated"
        )  # fmt: skip
    log_axis(axes, "y", 5e-4, 1.0)
    axes.set(xlabel="frequency (cycles per unit)", xlim=(0, 24.5))
    entitle(axes, title)
