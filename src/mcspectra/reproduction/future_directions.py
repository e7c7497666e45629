"""Answers to the talk's future directions: insights, and methods beyond importance sampling."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.kinds import describe
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, about, rate_claim, slope
from mcspectra.reproduction.panels import plot_of, primary_panel, variance_panel
from mcspectra.reproduction.strata_alignment import edge

__all__ = ["exhibit"]

# Squares of multiples of 6. With these counts, the edge at 1/3.5 lies inside a stratum
COUNTS = (36, 144, 576, 2304)
AT = 2 / 7
BUDGET = 256
_TABLE = 8  # cells along each side of the tabulated density for importance sampling
_LATTICE = 64  # number of points of the designed lattice
_TESTED = ((0.3, 0.6), (0.7, 0.8), (1.0, 0.7), (1.3, 0.5), (0.1, 0.31), (1.45, 0.62))


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Diagnose an integrand that has an edge, and compare remedies with importance sampling."""
    found = mcs.remedies(
        edge(AT), "jittered", BUDGET, realizations=150 if quick else 1000, rng=seed
    )
    realizations = 200 if quick else 1500
    options: dict[str, Any] = {"realizations": realizations, "rng": seed}
    curves = {
        "uniform points": mcs.convergence(edge(AT), "jittered", list(COUNTS), **options),
        "importance sampling": mcs.convergence(_weighted(), "jittered", list(COUNTS), **options),
        "aligned strata": _measured_aligned(realizations, seed),
    }
    exact = {
        "uniform points": _exact(),
        "aligned strata": np.array(
            [float(mcs.exact_variance(_aligned(n), "jittered", n)) for n in COUNTS]
        ),
    }
    last = {name: Measured.of(curve.isel(n=-1), "variance") for name, curve in curves.items()}
    with tempfile.TemporaryDirectory() as folder:
        lattice = mcs.design(
            "lattice", "half-spaces", _LATTICE, rng=seed, path=Path(folder, "lattice.json")
        )
        ratio = _designed(lattice, 100 if quick else 1000, seed)
    best = found.isel(remedy=0)
    low, high = map(float, best["error_ratio_ci"].values)
    align = last["uniform points"] / last["aligned strata"]
    usual = last["importance sampling"] / last["uniform points"]
    return Exhibit(
        numbers={
            "diagnosis": found.attrs["diagnosis"].partition(". ")[0],
            "best": str(best["remedy"].values),
            "times": number(1 / float(best["error_ratio"]), 2),
            "align": number(align.value, 2),
            "usual": number(usual.value, 2),
            "design": number(ratio.value, 2),
            "budget": BUDGET,
            "N": COUNTS[-1],
        },
        plots=(
            describe("remedies", found),
            plot_of(
                "better-than-importance",
                primary_panel(edge(AT), "given: the edge cuts strata"),
                primary_panel(
                    _aligned(36).primary_integrand(0),
                    "strata aligned with the edge",
                ),
                variance_panel(curves, exact=exact, title="variance, jittered points"),
            ),
        ),
        claims=(
            Claim(
                "The diagnosis names the edge and its remedy, a border of strata.",
                found.attrs["diagnosis"],
                holds="discontinuity" in found.attrs["diagnosis"]
                and "border of strata" in found.attrs["diagnosis"],
                shown="a discontinuity on planes normal to an axis",
            ),
            Claim(
                f"The best remedy at {BUDGET} evaluations has less variance than jittered points: "
                "ratio.",
                Measured(float(best["error_ratio"]), low, high, log=True),
                below=1.0,
            ),
            *about(
                "better-than-importance",
                Claim(
                    "Strata aligned with the edge: the exact variances have the rate −2.",
                    slope(COUNTS, exact["aligned strata"]),
                    expected=-2.0,
                    # Rounding the edge to whole strata changes the variance by a fraction 1/s²
                    tolerance=0.05,
                    shown="−2 ± 0.05",
                ),
                Claim(
                    f"Aligned strata at N = {COUNTS[-1]} have the exact variance.",
                    Measured.of(curves["aligned strata"].isel(n=-1), "variance", log=True),
                    expected=float(exact["aligned strata"][-1]),
                    digits=4,
                ),
                rate_claim(
                    "Importance sampling by a table of f keeps the edge: the rate stays near −1.5.",
                    curves["importance sampling"],
                    -1.5,
                    0.25,
                    "Tolerance: half of the distance to −2; exact variances are not known.",
                ),
                Claim(
                    f"At N = {COUNTS[-1]}, aligned strata have less variance than importance "
                    "sampling: ratio.",
                    last["importance sampling"] / last["aligned strata"],
                    above=1.0,
                ),
                Claim(
                    f"A lattice of {_LATTICE} points designed for half-spaces has less variance on "
                    f"{len(_TESTED)} other half-spaces than jittered points: ratio of mean "
                    "variances.",
                    ratio,
                    below=1.0,
                ),
            ),
        ),
    )


def _aligned(n: int) -> mcs.Estimator:
    """Return an estimator whose strata have a border at the discontinuity of the integrand."""
    return mcs.aligned(edge(AT), [[AT], []], n)


def _measured_aligned(realizations: int, seed: int) -> xr.Dataset:
    """Measure the variance with aligned strata, whose borders change with the number of points."""
    options: dict[str, Any] = {"realizations": realizations, "rng": seed}
    curves = [mcs.convergence(_aligned(n), "jittered", [n], **options) for n in COUNTS]
    return xr.concat([c[["mean", "variance", "variance_ci"]] for c in curves], dim="n")


def _weighted() -> mcs.Estimator:
    """Return traditional importance sampling: a density from a table of f."""
    u = (np.arange(16 * _TABLE) + 0.5) / (16 * _TABLE)
    values = np.asarray(edge(AT)(np.stack(np.meshgrid(u, u), axis=-1)))
    table = values.reshape(_TABLE, 16, _TABLE, 16).mean(axis=(1, 3))
    return mcs.Estimator(edge(AT), mcs.densities.PiecewiseConstant(values=table))


def _exact() -> Array:
    """Return exact variances of jittered points."""
    return np.array([float(mcs.exact_variance(edge(AT), "jittered", n)) for n in COUNTS])


def _designed(lattice: mcs.Sampler, realizations: int, seed: int) -> Measured:
    """Return the mean variance of the lattice over half-spaces, relative to jittered points."""
    options: dict[str, Any] = {"realizations": realizations, "rng": seed}
    tested = [
        f"half-space(normal=[{np.cos(a)}, {np.sin(a)}], offset={offset})" for a, offset in _TESTED
    ]
    both = [mcs.convergence(tested, s, [_LATTICE], **options) for s in (lattice, "jittered")]
    means = []
    for data in both:
        value = data["variance"].values.ravel()
        half = np.diff(data["variance_ci"].values.reshape(-1, 2), axis=1)[:, 0] / 2
        spread = float(np.sqrt((half**2).sum()) / len(value))
        means.append(Measured(v := float(value.mean()), v - spread, v + spread))
    return means[0] / means[1]
