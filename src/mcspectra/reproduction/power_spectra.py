"""Power spectra of one point set, and their expectation over many sets."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.plots.description import Plot, Scale
from mcspectra.plots.kinds import describe
from mcspectra.plots.text import number
from mcspectra.report.page import Slider
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, about
from mcspectra.reproduction.panels import at_ring, frequency_panel, plot_of, ring_mean

__all__ = ["exhibit"]

SAMPLERS = ("random", "jittered", "poisson-disk")
N = 256
HALF_WIDTH = 48


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Show single and expected spectra, and check their level, speckle and low frequencies."""
    realizations = 200 if quick else 2000
    single, expected = measured_spectra(1, seed), measured_spectra(realizations, seed)
    random, jittered, disk = (expected[name] for name in SAMPLERS)
    ring = int(np.argmax(disk["radial_power"].values)) + 1
    claims = (
        _speckle("one set", single["random"], 1),
        _speckle(f"the mean over {realizations} sets", random, realizations),
        _ring_level("random", random, 1, 1.0),
        _ring_level("jittered", jittered, 1, closed_ring(1)),
        _ring_level("jittered", jittered, HALF_WIDTH, closed_ring(HALF_WIDTH)),
        Claim(
            "Poisson-disk points have less power than random points at |m| ≈ 1, but more than "
            "jittered points.",
            at_ring(disk, 1, N),
            above=closed_ring(1),
            below=1.0,
        ),
        Claim(
            f"Poisson-disk points have a ring above the level of random points, at |m| ≈ {ring}.",
            at_ring(disk, ring, N),
            above=1.0,
        ),
        _exponent("jittered", jittered, 2.0),
        _exponent("random", random, 0.0),
    )
    low = ", ".join(f"{number(at_ring(d, 1, N).value)} ({name})" for name, d in expected.items())
    averaged = {r: measured_spectra(r, seed) for r in (1, 4, 16, 64)} | {realizations: expected}
    frames = {str(r): _maps("power-spectra", data) for r, data in averaged.items()}
    return Exhibit(
        numbers={
            "speckle": number(claims[0].value),
            "low": low,
            "half_width": HALF_WIDTH,
            "N": N,
            "realizations": realizations,
        },
        plots=(
            _maps("one-set", single),
            frames[str(realizations)],
            describe("radial", expected),
        ),
        claims=(*about("one-set", claims[0]), *about("power-spectra", *claims[1:])),
        sliders={"power-spectra": Slider("sets averaged", frames, str(realizations))},
    )


def _maps(kind: str, data: dict[str, xr.Dataset]) -> Plot:
    scale = Scale(label="N · |S|²   (random: 1)", high=2.5, beyond=True)
    return plot_of(
        kind,
        *(frequency_panel(N * data[name]["power"].values, scale, name) for name in SAMPLERS),
    )


def measured_spectra(realizations: int, seed: int) -> dict[str, xr.Dataset]:
    """Return the spectra of the three samplers."""
    return {
        name: mcs.power_spectrum(
            mcs.sampler(name, 2), N, half_width=HALF_WIDTH, realizations=realizations, rng=seed
        )
        for name in SAMPLERS
    }


def _speckle(what: str, spectrum: xr.Dataset, realizations: int) -> Claim:
    flat = np.asarray(spectrum["power"].values).ravel()
    power = N * flat[: flat.size // 2]  # one frequency of each pair ±m, without 0
    # The coefficient of variation of M values of Gamma(R) has the variance (1 + 1/R) / (2 R M)
    se = math.sqrt((1 + 1 / realizations) / (2 * realizations * power.size))
    return Claim(
        f"For {what} of random points, the power at a frequency has a relative standard deviation "
        f"of 1/√R (R = {realizations}).",
        Measured.normal(float(power.std(ddof=1) / power.mean()), se),
        expected=realizations**-0.5,
        # Only in the limit N → ∞, |S_m|² is exponential and independent at different frequencies.
        # For finite N, the relative error is about 1/N
        tolerance=1.0 / N * realizations**-0.5,
        note="Relative tolerance 1/N: powers of N points are exponential up to this error.",
    )


def closed_ring(ring: int) -> float:
    """Return N times the power of jittered points, in closed form and averaged over a ring."""
    return N * ring_mean(lambda m: mcs.closed_form_power("jittered", N, m), HALF_WIDTH, ring)


def _ring_level(name: str, spectrum: xr.Dataset, ring: int, expected: float) -> Claim:
    return Claim(
        f"The mean of N · ⟨P⟩ over |m| ≈ {ring} of {name} points agrees with the closed form.",
        at_ring(spectrum, ring, N),
        expected=expected,
        digits=4,
    )


def _exponent(name: str, spectrum: xr.Dataset, expected: float) -> Claim:
    return Claim(
        f"The power of {name} points starts as |ν|^{expected:.0f}.",
        Measured.of(
            mcs.spectra.low_frequency_exponent(spectrum, up_to=3.0), "low_frequency_exponent"
        ),
        expected=expected,
        # The slope d log(1 − sinc²(πν/s)) / d log ν is 2 − 4/15 (πν/s)² …; here s = 16, ν ≤ 3
        tolerance=0.1 if expected else 0.0,
        note="Tolerance 0.1: the exponent of 1 − sinc² changes by this much up to |m| = 3."
        if expected
        else "",
    )
