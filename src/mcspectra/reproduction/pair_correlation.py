"""Pair correlation: its transform is the power spectrum, and it gives the variance directly."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.plots.description import Axis, Dots, Line, Mark, Panel, ReferenceLine
from mcspectra.plots.scales import log_axis, name_axis
from mcspectra.plots.style import INK, MARKERS, PALETTE
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, largest_distance
from mcspectra.reproduction.panels import plot_of, whiskers

__all__ = ["exhibit"]

SAMPLERS = ("random", "jittered", "poisson-disk")
_COUNTED = ("jittered | shift", "poisson-disk")
_TITLES = {
    "random": "random",
    "poisson-disk": "Poisson disk",
    "jittered | shift": "jittered, shifted",
    "jittered": "jittered, not shifted",
}
_SMOOTH = "christensen-gaussian"
N = 64


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Count pairs of points, transform their density, and compute variances from it."""
    realizations = 400 if quick else 2000
    pairs = {name: count_pairs(name, realizations, seed) for name in SAMPLERS}
    variances = {name: by_pairs(name, realizations, seed) for name in _COUNTED}
    # Points that are not shifted have the same mean g(r) as shifted points, but another variance
    averaged = variances["jittered | shift"][0]
    curve = mcs.convergence(_SMOOTH, "jittered", [N], realizations=10 * realizations, rng=seed + 2)
    fixed = Measured.of(curve.isel(n=0), "variance")
    variances["jittered"] = averaged, fixed
    # The closed form of G, which depends on both positions
    closed = {
        name: float(_from_pairs(_SMOOTH, name, N)["predicted_variance"])
        for name in ("random", "jittered")
    }
    known = {name: float(mcs.exact_variance(_SMOOTH, name, N)) for name in closed}
    n, ramp = 16, mcs.Estimator("linear", dims=1)
    value = float(_from_pairs(ramp, "jittered", n)["predicted_variance"])

    # Select bins of distance below the radius of the Poisson-disk points
    disk, radius = pairs["poisson-disk"], mcs.samplers.PoissonDisk(dims=2).radius(N)
    width = float(disk["r"][1] - disk["r"][0])
    inside = disk["pair_correlation"].values[disk["r"].values + width / 2 < radius]

    # Draw g(r), and its closed form if there is one
    marks: list[Mark] = []
    for k, (name, data) in enumerate(pairs.items()):
        r, g = data["r"].values, data["pair_correlation"].values
        half = CONFIDENCE_Z * data["pair_correlation_se"].values
        line = g if name == "poisson-disk" else mcs.spectra.closed_form_pair_correlation(name, N, r)
        label = name if name == "jittered" else _TITLES[name]
        marks.append(Line(x=r, y=line, color=PALETTE[k], width=1.2, label=label))
        marks.append(whiskers(r, g, np.stack([g - half, g + half], axis=-1), k, label, 3.0))
    x = Axis(label="distance r (sides of the domain)", low=0.0, high=0.4)
    y = Axis(label="pair correlation g(r)", low=0.0)
    return Exhibit(
        numbers={
            "N": N,
            "times": number(averaged.value / fixed.value, 2),
        },
        plots=(
            plot_of("pair-variances", _predictions(variances, closed, known["random"])),
            plot_of("pair-correlation", Panel(marks=tuple(marks), x=x, y=y, grid=True)),
        ),
        claims=(
            *(_as_closed(name, pairs[name]) for name in ("random", "jittered")),
            Claim(
                f"No two Poisson-disk points are closer than the radius {number(radius)}: largest "
                "g(r) below the radius.",
                float(inside.max()),
                expected=0.0,
            ),
            *(_transformed(name) for name in ("random", "jittered")),
            Claim(
                f"The variance from pairs of f = x with {n} jittered points is 1/(12N³): relative "
                "difference.",
                12 * n**3 * value - 1,
                at_most=1e-6,
            ),
            *(
                Claim(
                    f"The variance of exp(−x² − y²) from the closed-form pairs of {name} points "
                    "agrees with quadrature: relative difference.",
                    closed[name] / known[name] - 1,
                    at_most=1e-5,
                )
                for name in closed
            ),
            *(_counted_pairs(name, *variances[name]) for name in _COUNTED),
            Claim(
                "The variance from counted pairs of jittered | shift points agrees with "
                "quadrature.",
                variances["jittered | shift"][0],
                expected=float(mcs.exact_variance(_SMOOTH, "jittered | shift", N)),
                digits=4,
            ),
            Claim(
                "Without a shift g(r) does not determine the variance: prediction by g(r) divided "
                "by the measured variance of jittered points.",
                averaged / fixed,
                above=1.0,
            ),
        ),
    )


def _predictions(
    variances: Mapping[str, tuple[Measured, Measured]], closed: Mapping[str, float], random: float
) -> Panel:
    """Plot variances from pairs divided by the variance, for one sampler per row.

    Parameters
    ----------
    variances
        Variances from counted pairs and measured variances, by sampler.
    closed
        Variances from the closed form of G, by sampler.
    random
        Exact variance of random points, whose g is 1.
    """
    ratios = {name: _ratio(*pair) for name, pair in variances.items()}
    exact = closed["random"] / random
    ratios["random"] = Measured(exact, exact, exact)
    names = [*_TITLES]
    # For stationary points G is g, so both have the same prediction
    both = {
        **ratios,
        "jittered": _ratio(Measured.normal(closed["jittered"], 0.0), variances["jittered"][1]),
    }
    marks: list[Mark] = [ReferenceLine(at=1.0, axis="x", color=INK, dashes="--")]
    kinds = {
        "from g: pairs by their difference": ratios,
        "from G: pairs by both positions": both,
    }
    for k, (label, found) in enumerate(kinds.items()):
        value, low, high = np.array(
            [(found[name].value, found[name].low, found[name].high) for name in names]
        ).T
        place = np.arange(len(names)) + 0.2 * (2 * k - 1)
        marks.append(
            Dots(
                x=value, y=place, low=low, high=high, across=True,
                color=PALETTE[1 - k], marker=MARKERS[1 - k], size=9.0, label=label,
            )
        )  # fmt: skip
    high = max(each.high for each in ratios.values())
    return Panel(
        marks=tuple(marks),
        x=log_axis("prediction divided by the measured variance", 0.8, 1.3 * high),
        y=name_axis([_TITLES[name] for name in names]),
        grid=True,
    )


def count_pairs(name: str, realizations: int, seed: int) -> xr.Dataset:
    """Measure the pair correlation of points in two dims."""
    points = mcs.sampler(name, 2)
    return mcs.pair_correlation(
        points, N, bins=60, max_distance=0.4, realizations=realizations, rng=seed
    )


def by_pairs(name: str, realizations: int, seed: int) -> tuple[Measured, Measured]:
    """Return the variance from counted pairs, and the variance from a separate measurement."""
    found = _from_pairs(_SMOOTH, name, N, realizations=2 * realizations, rng=seed)
    curve = mcs.convergence(_SMOOTH, name, [N], realizations=10 * realizations, rng=seed + 1)
    counted = Measured.of(found, "predicted_variance")
    return counted, Measured.of(curve.isel(n=0), "variance")


def _from_pairs(estimator: mcs.Estimator | str, name: str, n: int, **options: int) -> xr.Dataset:
    """Predict the variance from the pair correlation."""
    return mcs.predict(estimator, name, [n], method="pair-correlation", **options).isel(n=0)


def _as_closed(name: str, data: xr.Dataset) -> Claim:
    r, width = data["r"].values, float(data["r"][1] - data["r"][0])
    # The counts in a bin are proportional to r, so use Simpson's rule with the weight r
    nodes = [(-0.5, 1), (0.0, 4), (0.5, 1)]
    weights = [w * (r + t * width) for t, w in nodes]
    values = [
        mcs.spectra.closed_form_pair_correlation(name, N, np.abs(r + t * width)) for t, _ in nodes
    ]
    expected = sum(w * v for w, v in zip(weights, values, strict=True)) / sum(weights)
    return largest_distance(
        f"Counted pairs of {N} {name} points in two dims agree with the closed form of g(r) at "
        f"{r.size} distances",
        data["pair_correlation"].values - expected,
        data["pair_correlation_se"].values,
    )


def _transformed(name: str) -> Claim:
    """Compare N⟨|S_m|²⟩ with 1 + (N − 1) ∫ g(|h|) cos(2πmh) dh over the torus, in 1-D for m ≠ 0."""
    n, m = 16, np.arange(1, 49)
    # The pair correlation g is linear up to the distance 1/n and constant above,
    # so Gauss-Legendre nodes are placed in intervals of length 1/n
    nodes, weights = np.polynomial.legendre.leggauss(16)
    h = ((np.arange(n // 2)[:, None] + (nodes + 1) / 2) / n).ravel()
    g = mcs.spectra.closed_form_pair_correlation(mcs.sampler(name, 1), n, h)
    g = g * np.tile(weights, n // 2) / (2 * n)
    found = 1 + (n - 1) * 2 * (g * np.cos(2 * np.pi * m[:, None] * h)).sum(axis=1)
    return Claim(
        f"The transform of the pair correlation of {n} {name} points is their power, m = 1 … "
        f"{m[-1]}: largest difference of N⟨|S_m|²⟩.",
        float(np.abs(found - n * mcs.closed_form_power(name, n, m[:, None])).max()),
        at_most=1e-11,
    )


def _ratio(counted: Measured, measured: Measured) -> Measured:
    """Divide the variance from pairs by the measured variance."""
    times = counted.value / measured.value
    errors = (
        (counted.high - counted.value) / counted.value / CONFIDENCE_Z,
        float(np.log(measured.high / measured.low) / 2) / CONFIDENCE_Z,
    )
    return Measured.normal(times, times * float(np.hypot(*errors)))


def _counted_pairs(name: str, counted: Measured, measured: Measured) -> Claim:
    """Compare the variance from pairs with the measured variance, by the interval of the ratio."""
    return Claim(
        f"The variance from counted pairs of {name} points agrees with the measured one: ratio.",
        _ratio(counted, measured),
        expected=1.0,
        shown="1",
    )
