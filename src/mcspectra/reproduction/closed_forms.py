"""Expected power of random and jittered points: closed forms, formulas on slides and simulation."""

from __future__ import annotations

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, Dots, Line, Mark, Panel, Plot
from mcspectra.plots.scales import log_axis
from mcspectra.plots.style import PALETTE, line_widths
from mcspectra.plots.text import number
from mcspectra.report.page import Slider
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, largest_distance
from mcspectra.reproduction.panels import plot_of

__all__ = ["exhibit"]

N = 16
_INTEGERS = np.arange(1.0, 65.0)
_REALS = np.arange(1.0, 65.0) * 0.37 + 0.05
# Frequencies in the picture, and the smallest ratio of two frequencies that have dots
_LEAST, _MOST, _APART = 0.35, 24, 1.07


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Compare closed forms with formulas of the reproduced slides, simulations, and limits."""
    realizations = 4000 if quick else 40_000
    nu = np.concatenate([_INTEGERS, _REALS])
    known = np.concatenate([[0.0], nu])
    simulated = {name: simulate(name, nu, realizations, seed) for name in ("random", "jittered")}
    as_simulated = [
        largest_distance(
            f"Simulated spectra of {name} points agree with the closed form at {nu.size} "
            "frequencies, half of them integers",
            data["power"].values - _closed(name, nu),
            data["power_se"].values,
        )
        for name, data in simulated.items()
    ]
    random, jittered = (number(claim.value) for claim in as_simulated)

    # Simulate at integer frequencies: in two dims, and with importance sampling
    modes = np.array([[i, j] for i in range(9) for j in range(-8, 9) if (i, j) > (0, 0)], float)
    few = realizations // 4
    plane = mcs.spectra.power_at(mcs.sampler("jittered", 2), 64, modes, realizations=few, rng=seed)
    weighted = mcs.spectra.power_at(
        mcs.sampler("random", 1),
        N,
        [[5.0]],
        density="linear(slope=1)",
        realizations=realizations,
        rng=seed,
    )
    low = 1024**3 * float(_closed("jittered", np.array([1.0]), 1024)[0])
    multiples = N * np.arange(1.0, 5.0)

    frames = {str(N): _compared(N, nu, simulated)}
    for n in (4, 8, 32, 64):
        few = realizations * 4 // n
        drawn = {name: simulate(name, nu, few, seed, n) for name in simulated}
        frames[str(n)] = _compared(n, nu, drawn)
    frames = {n: frames[n] for n in sorted(frames, key=int)}
    return Exhibit(
        numbers={"N": N, "random": random, "jittered": jittered, "frequencies": nu.size},
        plots=(frames[str(N)],),
        sliders={"closed-forms": Slider("number of points N", frames, str(N))},
        claims=(
            *(
                Claim(
                    f"The closed form of {name} points agrees with the slides at integer and real "
                    "frequencies: largest difference.",
                    float(np.abs(_closed(name, known) - printed(name, known)).max()),
                    at_most=1e-14,
                )
                for name in simulated
            ),
            *as_simulated,
            largest_distance(
                f"The closed form also holds in two dims, 64 jittered points at {len(modes)} "
                "integer frequencies",
                plane["power"].values - mcs.closed_form_power("jittered", 64, modes),
                plane["power_se"].values,
            ),
            Claim(
                "N³ times the power of jittered points at m = 1 tends to π²/3, so the variance "
                "falls as N⁻³: relative difference at N = 1024.",
                low / (np.pi**2 / 3) - 1.0,
                # The relative error is 2 (π/N)²/15 = 1.3e-6:
                # the series of 1 − sinc²(x) is x²/3 − 2x⁴/45 …
                at_most=1e-5,
            ),
            Claim(
                "At multiples of N, the frequency of the strata, jittered points have the power "
                "1/N of random points: largest difference.",
                float(np.abs(_closed("jittered", multiples) - _closed("random", multiples)).max()),
                at_most=1e-15,
            ),
            Claim(
                "Random importance samples of p = ½ + x have the power ∫1/p / N = ln 3 / N at "
                "integer frequencies.",
                Measured.normal(float(weighted["power"][0]), float(weighted["power_se"][0])),
                expected=float(np.log(3.0) / N),
                digits=5,
            ),
        ),
    )


def _compared(n: int, nu: Array, simulated: dict[str, xr.Dataset]) -> Plot:
    """Return closed forms and simulated spectra, at integer and at real frequencies."""
    panels = []
    for line, at, title in (
        (np.arange(1.0, _MOST + 1), _INTEGERS, "integer frequencies"),
        (np.geomspace(_LEAST, _MOST, 2000), _REALS, "real frequencies"),
    ):
        marks: list[Mark] = []
        # On the logarithmic axis, omit dots that would touch
        shown = [float(at[0])]
        for each in at[at <= _MOST]:
            if each >= _APART * shown[-1]:
                shown.append(float(each))
        chosen = np.isin(nu, shown)
        looks = zip(PALETTE, line_widths(2), strict=False)
        for (name, data), (color, width) in zip(simulated.items(), looks, strict=True):
            y, label = _closed(name, line, n), f"{name}, closed form"
            marks.append(Line(x=line, y=y, color=color, width=width, label=label))
            power, half = data["power"].values[chosen], 1.96 * data["power_se"].values[chosen]
            label = f"{name}, simulated"
            marks.append(
                Dots(
                    x=nu[chosen], y=power, low=power - half, high=power + half,
                    color=color, size=4.5, label=label,
                )
            )  # fmt: skip
        ticks = {float(v): str(v) for v in (0.5, 1, 2, 4, 8, 16)}
        x = Axis(label="frequency m", kind="log", low=_LEAST, high=1.1 * _MOST, ticks=ticks)
        least = float(_closed("jittered", np.array([1.0]), n)[0])
        y_axis = log_axis("⟨S_m* S_m⟩", least, 1.0)
        panels.append(Panel(marks=tuple(marks), x=x, y=y_axis, title=title, grid=True))
    return plot_of("closed-forms", *panels)


def _closed(name: str, nu: Array, n: int = N) -> Array:
    return mcs.closed_form_power(name, n, nu[:, None])


def printed(name: str, m: Array) -> Array:
    """Return the formula of the slides. The Sinc(πx) of the slides is NumPy's sinc(x)."""
    if name == "random":
        return np.where(m == 0, 1.0, 1 / N + (N - 1) / N * np.sinc(m) ** 2)
    return np.asarray((1 - np.sinc(m / N) ** 2) / N + np.sinc(m) ** 2)


def simulate(name: str, nu: Array, realizations: int, seed: int, n: int = N) -> xr.Dataset:
    """Simulate the power of 1-D points at the given frequencies."""
    return mcs.spectra.power_at(
        mcs.sampler(name, 1), n, nu[:, None], realizations=realizations, rng=seed
    )
