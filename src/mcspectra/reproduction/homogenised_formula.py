"""For homogenized samples, the variance equals the power term."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.plots.kinds import describe
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, about
from mcspectra.reproduction.generalised_formula import exact_matrix
from mcspectra.reproduction.panels import in_columns, interval_panel, matrix_panel, plot_of

__all__ = ["exhibit"]

SAMPLERS = ("jittered", "latin-hypercube", "poisson-disk", "sobol | owen")
BELL = "gaussian(center=[0.3, 0.35], width=0.2)"
N = 64
HALF_WIDTH = 24


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure the terms of four samplers with and without a shift, and sum closed forms."""
    realizations = 600 if quick else 10_000
    plain = {name: terms(name, realizations, seed) for name in SAMPLERS}
    shifted = {name: terms(f"{name} | shift", realizations, seed) for name in SAMPLERS}
    before, after = (
        ", ".join(f"{number(share(d).value)} ({name})" for name, d in data.items())
        for data in (plain, shifted)
    )
    rows = {name: [share(data[name]) for data in (plain, shifted)] for name in SAMPLERS}
    x = "Σ |f_m|² ⟨|S_m|²⟩ / measured variance"

    left_out = {
        name: beyond() / N / float(data["measured_variance"]) for name, data in shifted.items()
    }

    # For f(x) = x, check by quadrature that (1/(6N²) − 1/(12N³)) / (1/(12N³)) is 2N − 1
    line = mcs.integrand("linear", 1)
    power = 1 / (6 * N**2) - 1 / (12 * N**3)
    times = power / float(mcs.exact_variance(line, "jittered", N))
    drawn = 200 if quick else 2000
    matrices = {
        name: mcs.variance_terms(
            line, name, 16, half_width=32, realizations=drawn, rng=seed, cross_matrix=True
        )
        for name in ("jittered", "jittered | shift")
    }
    return Exhibit(
        numbers={"N": N, "before": before, "after": after, "matrices": drawn},
        plots=(
            plot_of(
                "homogenised-formula", interval_panel(rows, ("as they are", "shifted"), x, at=1.0)
            ),
            plot_of(
                "homogenised-matrix",
                *(
                    matrix_panel(name, exact_matrix(line, name, None, 40).real, y=not k)
                    for k, name in enumerate(matrices)
                ),
            ),
            replace(in_columns(describe("cross-matrix", matrices)), kind="measured-matrix"),
        ),
        claims=(
            *about(
                "homogenised-matrix",
                *(_closed_sum(n) for n in (16, 256)),
                *(
                    Claim(
                        f"{name}, shifted: the third term is 0, as a share of the variance.",
                        Measured.of(data, "cross_term") / float(data["predicted_variance"]),
                        expected=0.0,
                    )
                    for name, data in shifted.items()
                ),
            ),
            *(
                Claim(
                    f"{name}, shifted: the sum over m ≠ 0 is the measured variance: ratio.",
                    share(shifted[name]),
                    expected=1.0,
                    tolerance=part,
                    shown=f"1 ± {number(part, 2)}",
                    note=f"Tolerance: part of f beyond |m| = {HALF_WIDTH}, with the power 1/N of "
                    "random points.",
                )
                for name, part in left_out.items()
            ),
            Claim(
                "The first term is 0, since all weights are 1/N: largest, as a share of the "
                "variance.",
                max(float(d["dc_term"]) / float(d["measured_variance"]) for d in shifted.values()),
                at_most=1e-15,
            ),
            Claim(
                f"Without the shift the sum is not the variance: for f(x) = x and {N} jittered "
                "points it is 2N − 1 times the variance: relative difference.",
                times / (2 * N - 1) - 1.0,
                at_most=1e-9,
            ),
            Claim(
                "For jittered points without a shift on the bell, the sum exceeds the variance: "
                "ratio.",
                share(plain["jittered"]),
                above=1.0,
            ),
        ),
    )


def terms(name: str, realizations: int, seed: int) -> xr.Dataset:
    """Return the variance terms of the integrand `BELL` for one sampler."""
    return mcs.variance_terms(
        BELL, name, N, half_width=HALF_WIDTH, realizations=realizations, rng=seed
    )


def share(data: xr.Dataset) -> Measured:
    """Return the power term divided by the measured variance.

    The interval includes the error of the power term and the error of the variance.
    """
    variance = Measured.of(data, "measured_variance")
    power = Measured.of(data, "power_term") / variance.value
    half = math.hypot(
        math.log(variance.high / variance.low) / 2, (power.high - power.low) / (2 * power.value)
    )
    ends = (power.value * math.exp(-half), power.value * math.exp(half))
    return Measured(power.value, *ends, log=True)


def _closed_sum(n: int) -> Claim:
    """Compare closed forms for f = x, with |f_m|² = 1/(4π²m²), and bound the rest of the sum."""
    m = np.arange(1.0, 2**16 + 1)
    power = mcs.closed_form_power("jittered", n, m[:, None])
    total = 2 * float((power / (4 * np.pi**2 * m**2)).sum())
    expected = 1 / (6 * n**2) - 1 / (12 * n**3)
    return Claim(
        f"f(x) = x and {n} jittered points, shifted: the sum is 1/(6N²) − 1/(12N³): relative "
        "difference.",
        total / expected - 1.0,
        # Bound the sum over frequencies m > 2^16, relative to the whole sum.
        # At these frequencies the power of the points is at most 1/n, and Σ 1/m² < 1/2^16
        at_most=float(2 / (4 * np.pi**2 * n * m[-1]) / expected),
        note=f"Limit: bound of the sum over frequencies beyond {int(m[-1])}.",
    )


@cache
def beyond() -> float:
    """Return ∫f² minus the sum of |f_m|² over frequencies up to the half width.

    The square f² is a Gaussian whose width is that of f divided by √2.
    """
    square = BELL.replace("width=0.2", f"width={0.2 / math.sqrt(2)}")
    power = np.abs(mcs.integrand(BELL, 2).fourier_grid(HALF_WIDTH)) ** 2
    return float(np.squeeze(mcs.integrand(square, 2).integral)) - float(power.sum())
