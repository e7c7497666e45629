"""Pair correlation: transform of the power spectrum, and a route to the variance without frequencies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcspectra.estimators.moments import CONFIDENCE_Z
from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._limits import largest_distance
from mcspectra.report.reproduction.base import (
    Exhibit,
    Finding,
    comparison,
    identity,
    normal_interval,
)
from mcspectra.report.style import NARROW, PALETTE, WIDE, legend_below, new_figure, quiet

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["exhibit"]

_SAMPLERS = ("random", "jittered", "poisson-disk")
_COUNTED = ("jittered | shift", "poisson-disk")
_SMOOTH = "christensen-gaussian"
_N = 64


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Count pairs, transform their density, and find variances from it."""
    realizations = 400 if quick else 4000
    pairs = {name: _pairs(name, realizations, seed) for name in _SAMPLERS}
    routes = {name: _routes(name, realizations, seed) for name in _COUNTED}
    findings = (
        *(_as_closed(name, pairs[name]) for name in ("random", "jittered")),
        _hole(pairs["poisson-disk"]),
        *(_transform(name) for name in ("random", "jittered")),
        _formula_in_one_dim(),
        *(_known_pairs(name) for name in ("random", "jittered")),
        *(_counted_pairs(name, *routes[name]) for name in _COUNTED),
        _shifted(routes["jittered | shift"][0]),
    )
    return Exhibit(
        name="pair-correlation",
        title="Relation to the pair correlation",
        slide="Supplementary document: 4.2 Relation to the PCF. How we can use other statistical tools to represent "
        "variance? PCF is there but what else?",
        formula=r"\mathrm{Var}(I_N) = \frac{1}{N} \int g^2 + \left( 1 - \frac{1}{N} \right) \iint g(u) \, g(v) \, "
        r"G(u, v) \, du \, dv - I^2",
        caption=_caption(routes),
        pictures=(_curves(pairs), _comparison(routes)),
        findings=findings,
    )


def _caption(routes: dict[str, tuple[xr.Dataset, xr.Dataset]]) -> str:
    both = "; ".join(
        f"{name}: {number(float(found['variance']))} from pairs, {number(_measured(curve)[0])} measured"
        for name, (found, curve) in routes.items()
    )
    return (
        "Power and pair correlation say the same in two ways: N⟨|S_m|²⟩ − 1 is N − 1 times the transform of the density "
        f"of differences. So pairs alone give the variance. Of exp(−x² − y²) with N = {_N} points: {both}. For points "
        "that are not stationary G depends on both places, and a curve g(r), their mean, has lost what decides the "
        "variance, as the power spectrum has lost the phase."
    )


def _pairs(name: str, realizations: int, seed: int) -> xr.Dataset:
    from mcspectra.samplers.registry import sampler
    from mcspectra.spectra.pair_correlation import pair_correlation

    return pair_correlation(
        sampler(name, 2), _N, bins=60, realizations=realizations, rng=seed, max_distance=0.4
    )


def _routes(name: str, realizations: int, seed: int) -> tuple[xr.Dataset, xr.Dataset]:
    """The variance from counted pairs, and measured with other random numbers."""
    from mcspectra.variance.convergence import convergence
    from mcspectra.variance.routes import variance_from_pair_correlation

    found = variance_from_pair_correlation(
        _SMOOTH, name, _N, realizations=2 * realizations, rng=seed
    )
    curve = convergence(_SMOOTH, name, [_N], realizations=10 * realizations, rng=seed + 1)
    return found, curve


def _measured(curve: xr.Dataset) -> tuple[float, float]:
    """Variance and half its 95 % interval, relative."""
    variance = float(curve["variance"][0])
    low, high = curve["variance_ci"].values[0]
    return variance, float(np.log(high / low) / 2)


def _as_closed(name: str, data: xr.Dataset) -> Finding:
    from mcspectra.spectra.pair_correlation import closed_form_pair_correlation

    r, width = data["r"].values, float(data["r"][1] - data["r"][0])
    # A bin counts pairs in proportion to r: Simpson's rule with that weight
    nodes = [(-0.5, 1), (0.0, 4), (0.5, 1)]
    weighted = [w * (r + t * width) for t, w in nodes]
    values = [closed_form_pair_correlation(name, _N, np.abs(r + t * width)) for t, _ in nodes]
    expected = sum(w * v for w, v in zip(weighted, values, strict=True)) / sum(weighted)
    return largest_distance(
        f"Counted pairs of {_N} {name} points in the plane have the closed form of g(r), {r.size} distances",
        data["pair_correlation"].values - expected,
        data["pair_correlation_se"].values,
    )


def _hole(data: xr.Dataset) -> Finding:
    from mcspectra.samplers.poisson import PoissonDisk

    radius = PoissonDisk(dims=2).radius(_N)
    width = float(data["r"][1] - data["r"][0])
    inside = data["pair_correlation"].values[data["r"].values + width / 2 < radius]
    largest = float(inside.max())
    return Finding(
        statement=f"No two Poisson-disk points are nearer than their radius {number(radius)}: largest g(r) below it.",
        expected="0",
        measured=largest,
        interval=None,
        agrees=largest == 0.0,
    )


def _transform(name: str) -> Finding:
    """N⟨|S_m|²⟩ = 1 + (N − 1) ∫ g(|h|) cos(2πmh) dh over the torus, m ≠ 0, in 1-D."""
    from mcspectra.samplers.registry import sampler
    from mcspectra.spectra.closed_forms import closed_form_power
    from mcspectra.spectra.pair_correlation import closed_form_pair_correlation

    n, m = 16, np.arange(1, 49)
    one = sampler(name, 1)
    # g is linear up to 1/n and constant beyond: Gauss-Legendre nodes in pieces of 1/n
    nodes, weights = np.polynomial.legendre.leggauss(16)
    h = ((np.arange(n // 2)[:, None] + (nodes + 1) / 2) / n).ravel()
    g = closed_form_pair_correlation(one, n, h) * np.tile(weights, n // 2) / (2 * n)
    found = 1 + (n - 1) * 2 * (g * np.cos(2 * np.pi * m[:, None] * h)).sum(axis=1)
    return identity(
        f"The transform of the pair correlation of {n} {name} points is their power, m = 1 … {m[-1]}: largest "
        "difference of N⟨|S_m|²⟩.",
        error=float(np.abs(found - n * closed_form_power(name, n, m[:, None])).max()),
        at_most=1e-11,
    )


def _formula_in_one_dim() -> Finding:
    from mcspectra.estimators.importance import Estimator
    from mcspectra.variance.routes import variance_from_pair_correlation

    n = 16
    value = float(
        variance_from_pair_correlation(Estimator("linear", dims=1), "jittered", n)["variance"]
    )
    return identity(
        f"From pairs, the variance of f = x with {n} jittered points is 1/(12N³): relative difference.",
        error=12 * n**3 * value - 1,
        at_most=1e-6,
    )


def _known_pairs(name: str) -> Finding:
    from mcspectra.variance.exact import exact_variance
    from mcspectra.variance.routes import variance_from_pair_correlation

    value = float(variance_from_pair_correlation(_SMOOTH, name, _N)["variance"])
    return identity(
        f"From the known pairs of {name} points the variance of exp(−x² − y²) is that of quadrature: relative "
        "difference.",
        error=value / float(exact_variance(_SMOOTH, name, _N)) - 1,
        at_most=1e-5,
    )


def _counted_pairs(name: str, found: xr.Dataset, curve: xr.Dataset) -> Finding:
    """The ratio of both, with the errors of both."""
    value, se = float(found["variance"]), float(found["variance_se"])
    measured, half = _measured(curve)
    ratio = value / measured
    error = float(np.hypot(se / value, half / CONFIDENCE_Z))
    return comparison(
        f"From counted pairs of {name} points the variance is the measured one: ratio.",
        expected=1.0,
        measured=ratio,
        interval=normal_interval(ratio, ratio * error),
        text="1",
    )


def _shifted(found: xr.Dataset) -> Finding:
    from mcspectra.variance.exact import exact_variance

    expected = float(exact_variance(_SMOOTH, "jittered | shift", _N))
    value = float(found["variance"])
    return comparison(
        "From counted pairs of jittered | shift points the variance is that of quadrature.",
        expected=expected,
        measured=value,
        interval=normal_interval(value, float(found["variance_se"])),
        text=number(expected, 4),
    )


def _curves(pairs: dict[str, xr.Dataset]) -> Picture:
    figure = new_figure(WIDE, 3.3)
    axes = figure.subplots()
    quiet(axes, grid=True)
    for (name, data), color in zip(pairs.items(), PALETTE, strict=False):
        _draw_pairs(axes, name, data, color)
    axes.set(
        xlabel="distance r (sides of the domain)",
        ylabel="pair correlation g(r)",
        xlim=(0, 0.4),
        ylim=(0, None),
    )
    legend_below(figure, axes, columns=3)
    return Picture(
        kind="pair-correlation",
        caption=f"Density of pairs at a distance, random points = 1, of {_N} points in the plane: counted (dots, 95 % "
        "intervals) and closed forms (lines).",
        alt="Plot of g against r. Random: level at 1. Jittered: rises from 0 to just above 1 within a stratum's "
        "diagonal. Poisson disk: 0 up to the radius, then a peak and a ripple about 1.",
        figure=figure,
    )


def _draw_pairs(axes: Axes, name: str, data: xr.Dataset, color: str) -> None:
    from mcspectra.spectra.pair_correlation import closed_form_pair_correlation

    r = data["r"].values
    if name != "poisson-disk":
        axes.plot(r, closed_form_pair_correlation(name, _N, r), color=color, lw=1.2)
    bars = CONFIDENCE_Z * data["pair_correlation_se"].values
    fmt = "o-" if name == "poisson-disk" else "o"
    axes.errorbar(
        r, data["pair_correlation"].values, bars, fmt=fmt, ms=3, lw=0.9, color=color, label=name
    )


def _comparison(routes: dict[str, tuple[xr.Dataset, xr.Dataset]]) -> Picture:
    figure = new_figure(NARROW, 2.1)
    axes = figure.subplots()
    quiet(axes, grid=True)
    ends = []
    for row, (found, curve) in enumerate(routes.values()):
        value, se = float(found["variance"]), float(found["variance_se"])
        measured, half = _measured(curve)
        spans = (normal_interval(value, se), (measured * np.exp(-half), measured * np.exp(half)))
        for k, (middle, (low, high)) in enumerate(zip((value, measured), spans, strict=True)):
            axes.errorbar(
                1e4 * middle, row + 0.15 * (2 * k - 1),
                xerr=[[1e4 * (middle - low)], [1e4 * (high - middle)]],
                fmt="os"[k], ms=5, lw=1.2, color=PALETTE[k],
                label=("from pairs", "measured")[k] if row == 0 else None,
            )  # fmt: skip
            ends.append(1e4 * high)
    axes.set_yticks(range(len(routes)), list(routes))
    axes.set(
        xlabel="variance of I_N, times 10⁴",
        xlim=(0, 1.15 * max(ends)),
        ylim=(len(routes) - 0.5, -0.5),
    )
    legend_below(figure, axes)
    return Picture(
        kind="variance-from-pairs",
        caption=f"The variance of exp(−x² − y²) with {_N} points from counted pairs, and measured, with 95 % intervals.",
        alt="Two rows, jittered with shift and Poisson disk; in each the dot from pairs and the measured square "
        "coincide within their intervals.",
        figure=figure,
    )
