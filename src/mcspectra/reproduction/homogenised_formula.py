"""For homogenized samples, the variance equals the power term."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.plots.kinds import describe
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
    realizations = 600 if quick else 3000
    shifted = {name: terms(f"{name} | shift", realizations, seed) for name in SAMPLERS}
    rows = {name: ratios(name, 4 * realizations, seed) for name in SAMPLERS}
    x = "Σ |f_m|² ⟨|S_m|²⟩ / measured variance"

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
        numbers={"N": N, "matrices": drawn},
        plots=(
            plot_of(
                "homogenised-formula",
                interval_panel(rows, ("as they are", "shifted"), x, at=1.0, ratio=True),
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
                    shift,
                    expected=1.0,
                )
                for name, (_, shift) in rows.items()
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
            *(
                Claim(
                    f"For {name} points without a shift on f = x + y, the sum exceeds the "
                    "variance: ratio.",
                    rows[name][0],
                    above=1.0,
                )
                for name in SAMPLERS
                if name != "poisson-disk"
            ),
        ),
    )


def terms(name: str, realizations: int, seed: int) -> xr.Dataset:
    """Return the variance terms of the integrand `BELL` for one sampler."""
    return mcs.variance_terms(
        BELL, name, N, half_width=HALF_WIDTH, realizations=realizations, rng=seed
    )


def ratios(name: str, realizations: int, seed: int) -> tuple[Measured, Measured]:
    """Return the sum over m ≠ 0 divided by the variance, for points as they are and shifted.

    The integrand x + y has only frequencies along the axes, with |f_m|² = 1/(4π²m²).
    A shift does not change any power, so points have the same sum with and without a shift.
    The sum over m has a closed form, because Σ cos(2πmd)/m² over m ≥ 1 is π²(d² − d + 1/6).
    Along each axis it is half of the mean of d² − d + 1/6 over all pairs of points,
    where d is the distance between the two points.
    """
    points = mcs.sampler(name, 2).draw(N, realizations=realizations // 4, rng=seed)
    ranks = 2 * np.arange(N) - N + 1
    distance = 2 * (ranks[:, None] * np.sort(points, axis=1)).mean(axis=1) / N
    squared_distance = 2 * points.var(axis=1)
    sums = 0.5 * (squared_distance - distance + 1 / 6)
    power = Measured.mean(sums.sum(axis=-1))
    plane = mcs.Integrand.from_function(lambda x: np.asarray(x.sum(axis=-1)), dims=2, integral=1.0)
    samplers = [name, f"{name} | shift"]
    curves = mcs.convergence(plane, samplers, [N], realizations=realizations, rng=seed + 1)
    found = [
        power / Measured.of(curves.sel(sampler=each).isel(n=0), "variance", log=True)
        for each in samplers
    ]
    return found[0], found[1]


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
