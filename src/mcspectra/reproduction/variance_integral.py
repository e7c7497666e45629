"""Variance as the sum of sampling power × integrand power, for stationary samples."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import Panel, Plot, TextMark
from mcspectra.plots.scales import log_scale
from mcspectra.plots.text import number
from mcspectra.report.page import Slider
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, judge, rate_claim, slope
from mcspectra.reproduction.panels import frequency_panel, interval_panel, plot_of

__all__ = ["exhibit"]

BELL = "gaussian(center=[0.45, 0.6], width=0.1)"
SAMPLERS = ("random", "jittered | shift", "poisson-disk")
DENSITY = "linear(slope=1.5)"
N = 64
HALF_WIDTH = 12
SHIFTED = SAMPLERS[1]
# One scale for all maps: N ⟨P_S⟩ of random importance samples is 1.7, the largest value
_POWER = log_scale("relative power", 1e-3, 2.0)


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Compare the variance with the sum of products of spectra, with and without stationarity."""
    realizations = 500 if quick else 5000
    terms = {
        name: mcs.variance_terms(
            BELL, name, N, half_width=HALF_WIDTH, realizations=realizations, rng=seed
        )
        for name in SAMPLERS
    }
    weighted = importance_terms(realizations, seed)
    lost = Measured.of(weighted, "power_term") / exact_weighted()

    # Increase N. Sampling power ∝ ν² gives the rate −1 − 2/d = −2.
    # The rate holds because the integrand, a Gaussian bell, vanishes at the border
    counts = [64, 256, 1024] if quick else [64, 256, 1024, 4096]
    sampler, realizations = "jittered | shift", 1000 if quick else 2000
    curve = mcs.convergence(BELL, sampler, counts, realizations=realizations, rng=seed)
    known = slope(counts, np.array([exact(sampler, n) for n in counts]))

    # Draw spectra and products, and the sums divided by the exact or measured variance
    frames = {str(n): _product(n) for n in (16, 36, 64, 144, 256)}
    shown = {name: Measured.of(terms[name], "power_term") / exact(name) for name in SAMPLERS[:2]}
    disk = terms["poisson-disk"]
    power, variance = float(disk["power_term"]), Measured.of(disk, "measured_variance")
    shown["poisson-disk"] = Measured(
        power / variance.value, power / variance.high, power / variance.low
    )
    shown["importance samples"] = lost
    x = "Σ P_f ⟨P_S⟩ / variance (1: complete)"
    return Exhibit(
        numbers={
            "sum": number(float(np.nansum(_product_map(SHIFTED, N)))),
            "variance": number(exact(SHIFTED)),
            "missed": number(
                float(np.nansum(_product_map("random", N, DENSITY))) / exact_weighted()
            ),
            "N": N,
            "half_width": HALF_WIDTH,
        },
        plots=(
            frames[str(N)],
            plot_of(
                "ratio",
                interval_panel({name: [each] for name, each in shown.items()}, [""], x, at=1.0),
            ),
        ),
        sliders={"variance-integral": Slider("number of points N", frames, str(N))},
        claims=(
            *(_closed_sum(name) for name in SAMPLERS[:2]),
            *(
                Claim(
                    f"Σ |f_m|² ⟨|S_m|²⟩ with the simulated spectrum of {name} points is the exact "
                    "variance.",
                    Measured.of(terms[name], "power_term"),
                    expected=exact(name),
                    digits=4,
                )
                for name in SAMPLERS[:2]
            ),
            *(_diagonal(name, terms[name]) for name in SAMPLERS),
            rate_claim(
                "The rate of jittered, shifted points on this bell is −1 − b/d with the exponent b "
                "= 2 of their spectrum.",
                curve,
                -2.0,
                abs(known + 2.0),
                "Tolerance: the exact variances at these counts have the slope "
                f"{number(known, 4)}.",
            ),
            Claim(
                f"With importance samples of {DENSITY} the sum of products is not the variance: "
                "ratio.",
                lost,
                holds=not judge(Claim("", lost, expected=1.0)).agrees,
                shown="not 1",
            ),
        ),
    )


def _powers(name: str, n: int, density: str | None = None) -> tuple[Array, Array]:
    """Return maps of ⟨P_S⟩ and P_f. The power at m = 0 is NaN."""
    side = np.arange(-HALF_WIDTH, HALF_WIDTH + 1)
    m = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1)
    bell = np.abs(mcs.integrand(BELL, 2).fourier_grid(HALF_WIDTH)) ** 2
    bell[HALF_WIDTH, HALF_WIDTH] = np.nan
    sampling = mcs.closed_form_power(name, n, m.reshape(-1, 2), density).reshape(bell.shape)
    return sampling, bell


def _product_map(name: str, n: int, density: str | None = None) -> Array:
    """Return a map of ⟨P_S⟩ × P_f."""
    sampling, bell = _powers(name, n, density)
    return sampling * bell


def _product(n: int) -> Plot:
    """Return maps of ⟨P_S⟩, P_f and their product, for constant and for linear p."""
    panels = list[Panel]()
    for name, density, variance, title in (
        (SHIFTED, None, exact(SHIFTED, n), "N ⟨P_S⟩, p = 1"),
        ("random", DENSITY, exact_weighted(n), "N ⟨P_S⟩, p ≠ 1"),
    ):
        sampling, bell = _powers(name, n, density)
        top, total = float(np.nanmax(bell)), float(np.nansum(sampling * bell))
        product = frequency_panel(n * sampling * bell / top, _POWER, "= product", y=False)
        texts = (
            TextMark(x=0.0, y=y, text=f"{word} = {number(value)}", color="#FFFFFF", side="middle")
            for y, word, value in ((-8.2, "Σ", total), (-10.6, "Var", variance))
        )
        panels += [
            frequency_panel(n * sampling, _POWER, title),
            frequency_panel(bell / top, _POWER, "× P_f", y=False),
            replace(product, marks=(*product.marks, *texts)),
        ]
    return plot_of("variance-integral", *panels)


def importance_terms(realizations: int, seed: int) -> xr.Dataset:
    """Return the variance terms of importance samples, whose coefficients S_m are correlated."""
    return mcs.variance_terms(
        _estimator(), "random", N, half_width=HALF_WIDTH, realizations=realizations, rng=seed
    )


@cache
def _estimator() -> mcs.Estimator:
    """Return the estimator, which keeps its integrals for all numbers of points."""
    return mcs.Estimator(BELL, DENSITY, dims=2)


@cache
def exact_weighted(n: int = N) -> float:
    """Return the exact variance of importance samples."""
    return float(mcs.exact_variance(_estimator(), "random", n))


@cache
def _bell() -> mcs.Integrand:
    return mcs.integrand(BELL, 2)


@cache
def exact(name: str, n: int = N) -> float:
    """Return the exact variance for the integrand `BELL`."""
    return float(mcs.exact_variance(_bell(), name, n))


def integrand_power() -> tuple[Array, Array]:
    """Return all integer frequencies (M, 2) except 0, and |f_m|² at them."""
    side = np.arange(-HALF_WIDTH, HALF_WIDTH + 1)
    m = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    m = m[(m != 0).any(axis=1)]
    return m, np.abs(mcs.integrand(BELL, 2).fourier(m)) ** 2


def _closed_sum(name: str) -> Claim:
    m, power = integrand_power()
    total = float((power * mcs.closed_form_power(name, N, m)).sum())
    return Claim(
        f"Σ |f_m|² ⟨|S_m|²⟩ with the closed form of {name} points agrees with quadrature up to the "
        "truncation: relative difference.",
        total / exact(name) - 1.0,
        # On the torus, the integrand jumps by exp(−(0.4/0.1)²/2) = 3e-4 at the border.
        # Because of this jump, frequencies above the half width contribute to the variance
        at_most=1e-5,
    )


def _diagonal(name: str, data: xr.Dataset) -> Claim:
    return Claim(
        f"The sum is complete for {name} points: correlations between frequencies add nothing, as "
        "a share of the measured variance.",
        Measured.of(data, "cross_term") / float(data["measured_variance"]),
        expected=0.0,
    )
