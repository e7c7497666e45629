"""Power spectra of importance samples: level, dc component, and effect of the weights."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import Dots, Mark, Panel, Plot, ReferenceLine, Scale
from mcspectra.plots.scales import log_axis, unit_panel
from mcspectra.plots.style import INK, PALETTE
from mcspectra.plots.text import number
from mcspectra.report.page import Slider
from mcspectra.reproduction.claims import Claim, Exhibit, Measured
from mcspectra.reproduction.panels import (
    at_ring,
    frequency_panel,
    plot_of,
    ring_mean,
    whiskers,
)

__all__ = ["exhibit"]

SAMPLERS = ("random", "jittered", "poisson-disk")
SLOPE = 1.6
DENSITY = f"linear(slope={SLOPE})"
LEVEL = float((np.log((1 + SLOPE / 2) / (1 - SLOPE / 2)) / SLOPE) ** 2)  # ∫1/p in two dims
N = 256
HALF_WIDTH = 40


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure spectra of weighted points in the plane, and of the same points without weights."""
    realizations = 300 if quick else 3000
    spectra = {name: spectrum(name, realizations, seed) for name in SAMPLERS}
    rings = [
        Claim(
            f"The mean of N⟨|S_m|²⟩ over |m| ≈ {ring} of {name} importance samples is {what}.",
            at_ring(spectra[name], ring, N),
            expected=_closed_ring(name, ring),
            digits=4,
        )
        for name, what in (("random", "∫1/p"), ("jittered", "the closed form"))
        for ring in (1, HALF_WIDTH)
    ]

    # S_0 is the mean of 1/p. Compare its variance with the closed form
    zero, many = np.zeros((1, 2)), 4 * realizations
    dc = [
        Claim(
            f"The component at m = 0 of {name} importance samples varies: N Var(S₀) agrees with "
            "the closed form.",
            Measured.mean(N * (sums(name, many, seed, weighted=True)[:, 0].real - 1.0) ** 2),
            expected=N
            * float(mcs.spectra.closed_form_covariance(name, N, zero, zero, DENSITY).real[0]),
            digits=4,
        )
        for name in ("random", "jittered")
    ]
    low, high, dc_random, dc_jittered = (number(claim.value) for claim in (*rings[2:], *dc))

    # Draw points above their spectra, and draw the spectra against |m|
    few = realizations // 3
    frames = {
        f"{slope:g}": _maps(
            slope, {name: spectrum(name, few, seed, slope) for name in SAMPLERS}, seed
        )
        for slope in (0.0, 0.8)
    } | {f"{SLOPE:g}": _maps(SLOPE, spectra, seed)}
    radii = np.arange(1, HALF_WIDTH + 1)
    marks: list[Mark] = [ReferenceLine(at=LEVEL, color=INK, width=1.0, label="∫1/p")]
    for k, (name, data) in enumerate(spectra.items()):
        found = [at_ring(data, int(ring), N) for ring in radii]
        ends = np.array([(each.low, each.high) for each in found])
        marks.append(whiskers(radii, np.array([each.value for each in found]), ends, k, name, 3.0))
    x = log_axis("|m| (cycles per unit)", 1.0, float(HALF_WIDTH))
    y = log_axis("N · ⟨|S|²⟩", _closed_ring("jittered", 1) / 1.5, 4.0)
    return Exhibit(
        numbers={
            "slope": SLOPE,
            "level": number(LEVEL, 4),
            "low": low,
            "high": high,
            "half_width": HALF_WIDTH,
            "dc_random": dc_random,
            "dc_jittered": dc_jittered,
            "N": N,
            "realizations": realizations,
        },
        plots=(
            frames[f"{SLOPE:g}"],
            plot_of("importance-radial", Panel(marks=tuple(marks), x=x, y=y, grid=True)),
        ),
        sliders={"importance-spectra": Slider("slope of the density", frames, f"{SLOPE:g}")},
        claims=(
            *rings,
            Claim(
                "Warped Poisson-disk points have less power than random points at |m| ≈ 1, but "
                "more than jittered points.",
                at_ring(spectra["poisson-disk"], 1, N),
                above=_closed_ring("jittered", 1),
                below=LEVEL,
            ),
            *dc,
            _rate(1),
            _rate(0),
            # The power of N random points is 1/N + (1 − 1/N) |p_m|².
            # A linear density of slope s has p_m = i s/(2πm)
            Claim(
                "Without the weights 1/p the spectrum tends to the spectrum of the density: "
                "⟨|S_m|²⟩ → |p_m|² at m = (1, 0).",
                Measured.mean(
                    np.abs(sums("random", realizations, seed, weighted=False)[:, 1]) ** 2
                ),
                expected=1 / N + (1 - 1 / N) * (SLOPE / (2 * np.pi)) ** 2,
                digits=4,
            ),
            Claim(
                "At high frequencies, m = (4000, 0), jittered importance samples have the level "
                "∫1/p of random points: relative difference.",
                N * float(mcs.closed_form_power("jittered", N, [[4000, 0]], DENSITY)[0]) / LEVEL
                - 1,
                at_most=1e-3,
                note="Transforms of strata fall as 1/m, their squares as 1/m².",
            ),
        ),
    )


def _maps(slope: float, spectra: dict[str, xr.Dataset], seed: int) -> Plot:
    """Return a plot of points with a linear density, and of the spectra of their weighted sums."""
    scale = Scale(label="N · ⟨|S|²⟩", high=1.5 * LEVEL, beyond=True)
    p, points = mcs.density(f"linear(slope={slope})", 2), []
    for name in SAMPLERS:
        x, y = p.sample(mcs.sampler(name, 2).draw(N, rng=seed)[0]).T
        points.append(unit_panel([Dots(x=x, y=y, color=PALETTE[0], size=1.8)], name))
    return plot_of(
        "importance-spectra",
        *points,
        *(
            frequency_panel(N * d["power"].values, scale, "", y=not k)
            for k, d in enumerate(spectra.values())
        ),
    )


def spectrum(name: str, realizations: int, seed: int, slope: float = SLOPE) -> xr.Dataset:
    """Return the expected power of weighted points, in two dims."""
    options: dict[str, Any] = {"half_width": HALF_WIDTH, "realizations": realizations, "rng": seed}
    density = f"linear(slope={slope})"
    return mcs.power_spectrum(mcs.sampler(name, 2), N, density=density, **options)


def _closed_ring(name: str, ring: int) -> float:
    return N * ring_mean(lambda m: mcs.closed_form_power(name, N, m, DENSITY), HALF_WIDTH, ring)


def sums(name: str, realizations: int, seed: int, *, weighted: bool) -> Array:
    """Return S at m = (0, 0) and (1, 0): complex, (realizations, 2)."""
    p = mcs.density(DENSITY, 2)
    x = p.sample(mcs.sampler(name, 2).draw(N, realizations=realizations, rng=seed))
    w = 1.0 / p.pdf(x) if weighted else np.ones(x.shape[:-1])
    return np.stack([(w * np.exp(-2j * np.pi * m * x[..., 0])).mean(axis=1) for m in (0, 1)], -1)


def _rate(m: int) -> Claim:
    """Compare exact variances of S_m in 1-D, which fall as N⁻³.

    The reason: in each stratum, the weighted wave exp(−2πimx)/p(x) varies by O(1/N).
    """
    low, high = (
        float(mcs.spectra.closed_form_covariance("jittered", n, [[m]], [[m]], DENSITY).real[0])
        for n in (512, 1024)
    )
    return Claim(
        f"In one dim, Var(S{'₀₁'[m]}) of jittered importance samples falls as N⁻³: exact rate "
        "between N = 512 and 1024.",
        float(np.log2(high / low)),
        expected=-3.0,
        tolerance=0.01,
        shown="−3.0 ± 0.01",
        note=(
            "Tolerance: the next term of the variance is smaller by 1/N, times derivatives of 1/p."
        ),
    )
