"""How homogenization affects convergence: some integrands lose their rate, others keep it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import (
    Claim,
    Exhibit,
    Measured,
    about,
    correction,
    known_rate,
    rate_text,
)
from mcspectra.reproduction.panels import plot_of, variance_panel

__all__ = ["exhibit"]

COUNTS = (16, 64, 256, 1024)
SAMPLERS = ("jittered", "jittered | shift")
_NETS = ("sobol | owen", "sobol | owen | shift")
# N times the variance for the disk is 1e-2. Frequencies above the half width would add 2e-7.
_HALF_WIDTH = 384


@final
@dataclass(frozen=True)
class ConvergenceCase:
    """An integrand with its rates for plain and for shifted jittered points."""

    title: str
    spec: str
    dims: int
    plain: float
    shifted: float

    @property
    def integrand(self) -> mcs.Integrand:
        """The integrand of `spec`."""
        return mcs.integrand(self.spec, self.dims)


LINE = ConvergenceCase("f(x) = x", "linear", 1, -3.0, -2.0)
BELL = ConvergenceCase("exp(−x² − y²)", "christensen-gaussian", 2, -2.0, -1.5)
DISK = ConvergenceCase("disk", "disk(center=[0.45, 0.52], radius=0.3)", 2, -1.5, -1.5)
COSINE = ConvergenceCase("cos(2π(x + y))", "cosine(frequency=[1, 1])", 2, -2.0, -2.0)


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Compare measured with exact variances, with and without a shift."""
    realizations = 1000 if quick else 10_000
    cases = (LINE, BELL, DISK, COSINE)
    curves = {case: measured(case, realizations, seed) for case in cases}
    known = {case: {name: exact(case, name) for name in SAMPLERS} for case in cases}
    nets = measured(BELL, min(realizations, 4000), seed, _NETS)
    rates = [rate_text(curves[BELL][name]) for name in SAMPLERS]
    a, b = map(rate_text, nets.values())
    plain, shifted = (Measured.of(curves[LINE][s].isel(n=-1), "variance") for s in SAMPLERS)
    return Exhibit(
        numbers={"plain": rates[0], "shifted": rates[1], "a": a, "b": b},
        plots=(
            plot_of(
                "homogenisation-convergence",
                *(
                    variance_panel(curves[case], exact=known[case], title=case.title, letters=2.2)
                    for case in (BELL, DISK, COSINE)
                ),
            ),
            plot_of(
                "lost-correlations",
                variance_panel(curves[LINE], exact=known[LINE], title=f"{LINE.title}, jittered"),
                variance_panel(
                    nets,
                    exact={name: curve["variance"].values for name, curve in nets.items()},
                    title="exp(−x² − y²), Owen-scrambled Sobol'",
                ),
            ),
        ),
        claims=(
            *(
                known_rate(
                    f"{case.title}: the variance of {name} points has the rate {number(rate, 2)}.",
                    curves[case][name],
                    rate,
                    known[case][name],
                )
                for case in cases
                for name, rate in zip(SAMPLERS, (case.plain, case.shifted), strict=True)
            ),
            correction(
                Claim(
                    "Counterexample: for cos(2π(x + y)), which is periodic, the exact variances "
                    "with "
                    "and without a shift are equal, N = 16 … 1024: largest relative difference.",
                    float(np.abs(np.divide(*reversed(known[COSINE].values())) - 1.0).max()),
                    at_most=1e-12,
                )
            ),
            *about(
                "lost-correlations",
                # The exact ratio is (1/(6N²) − 1/(12N³)) / (1/(12N³)) = 2N − 1
                Claim(
                    "On f(x) = x the shift multiplies the variance of jittered points by 2N − "
                    "1, at N "
                    f"= {COUNTS[-1]}.",
                    shifted / plain,
                    expected=2.0 * COUNTS[-1] - 1.0,
                ),
                Claim(
                    "Other correlations are also lost: on exp(−x² − y²) a shift worsens the "
                    "rate of "
                    "Owen-scrambled Sobol' points: difference of the rates.",
                    Measured.of(nets[_NETS[1]], "rate") - Measured.of(nets[_NETS[0]], "rate"),
                    above=0.5,
                ),
            ),
        ),
    )


def measured(
    case: ConvergenceCase, realizations: int, seed: int, samplers: tuple[str, ...] = SAMPLERS
) -> dict[str, xr.Dataset]:
    """Measure the convergence of all samplers."""
    data = mcs.convergence(
        case.integrand, list(samplers), list(COUNTS), realizations=realizations, rng=seed
    )
    return {name: data.sel(sampler=name) for name in samplers}


def exact(case: ConvergenceCase, sampler: str) -> Array:
    """Return the exact variances at all counts."""
    f = case.integrand
    if case != DISK or sampler == "jittered":
        return np.array([float(mcs.exact_variance(f, sampler, n)) for n in COUNTS])
    # The variance of an indicator f is (1/N)(∫f² − Σ |f_m|² Π sinc²(πm_i/s)), where s² = N
    power = np.abs(f.fourier_grid(_HALF_WIDTH)) ** 2
    m, square = np.arange(-_HALF_WIDTH, _HALF_WIDTH + 1), float(np.squeeze(f.integral))
    windows = [(n, np.sinc(m / n**0.5) ** 2) for n in COUNTS]
    return np.array([(square - window @ power @ window) / n for n, window in windows])
