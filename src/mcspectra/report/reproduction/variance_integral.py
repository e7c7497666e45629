"""Variance as the sum of sampling power times integrand power, for stationary samples."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction.base import (
    Exhibit,
    Finding,
    comparison,
    identity,
    rate_finding,
)
from mcspectra.report.style import (
    LABEL_SIZE,
    WIDE,
    entitle,
    new_figure,
    quiet,
    quiet_colorbar,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["exhibit"]

_BELL = "gaussian(center=[0.45, 0.6], width=0.1)"
_SAMPLERS = ("random", "jittered | shift", "poisson-disk")
_DENSITY = "linear(slope=1.5)"
_SLOPE = "linear(gradient=1.0, offset=0.5)"
_N = 64
_HALF_WIDTH = 12

Terms: TypeAlias = "dict[str, xr.Dataset]"


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Compare the sum of products of spectra with variances, where it holds and where it does not."""
    realizations = 1000 if quick else 10_000
    terms = {name: _terms(name, realizations, seed) for name in _SAMPLERS}
    weighted = _weighted(realizations, seed)
    findings = (
        *(_closed_sum(name) for name in _SAMPLERS[:2]),
        *(_against_exact(name, terms[name]) for name in _SAMPLERS[:2]),
        *(_diagonal(name, terms[name]) for name in _SAMPLERS),
        _rate(quick, seed),
        _not_weighted(weighted),
    )
    return Exhibit(
        name="variance-integral",
        title="The variance of stationary samples is an integral of two power spectra",
        slide="Monte Carlo Estimation Variance for Stationary Samples: Var(I_N) = ∫ ⟨P_S(ν)⟩ × P_f(ν) dν "
        "(Durand 2011; Subr & Kautz 2013). Only valid for constant PDFs (uniformly distributed samples).",
        formula=r"\mathrm{Var}(I_N) = \int_{\Omega} \langle \mathcal{P}_{S_N}(\nu) \rangle \times "
        r"\mathcal{P}_f(\nu) \, d\nu",
        caption=_caption(terms, weighted),
        pictures=(_products(terms), _bars(terms, weighted)),
        findings=findings,
    )


def _caption(terms: Terms, weighted: xr.Dataset) -> str:
    each = ", ".join(
        f"{number(float(d['power_term']))} against {number(float(d['measured_variance']))} ({name})"
        for name, d in terms.items()
    )
    missed = float(weighted["power_term"]) / float(weighted["measured_variance"])
    return (
        f"For points that are the same after any translation, of constant density, the sum over integer "
        f"frequencies of ⟨P_S⟩ times P_f is the variance: {each}. For importance samples it is not: of random "
        f"points of p = {_DENSITY} it is {number(missed)} times the variance."
    )


def _terms(name: str, realizations: int, seed: int) -> xr.Dataset:
    from mcspectra.variance.terms import variance_terms

    return variance_terms(
        _BELL, name, _N, half_width=_HALF_WIDTH, realizations=realizations, rng=seed
    )


def _weighted(realizations: int, seed: int) -> xr.Dataset:
    """Terms of random points with a density, where frequencies are correlated."""
    from mcspectra.estimators import Estimator
    from mcspectra.variance.terms import variance_terms

    estimator = Estimator(_SLOPE, _DENSITY, dims=1)
    return variance_terms(
        estimator, "random", _N, half_width=16, realizations=realizations, rng=seed
    )


def _power_f() -> tuple[Array, Array]:
    """Integer frequencies (M, 2) without 0, and |f_m|² there."""
    from mcspectra.integrands.registry import integrand

    side = np.arange(-_HALF_WIDTH, _HALF_WIDTH + 1)
    m = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    m = m[(m != 0).any(axis=1)]
    return m, np.abs(integrand(_BELL, 2).fourier(m)) ** 2


def _exact(name: str) -> float:
    from mcspectra.variance.exact import exact_variance

    return float(exact_variance(_BELL, name, _N))


def _closed_sum(name: str) -> Finding:
    from mcspectra.spectra.closed_forms import closed_form_power

    m, power = _power_f()
    total = float((power * closed_form_power(name, _N, m)).sum())
    return identity(
        f"Σ |f_m|² ⟨|S_m|²⟩ with the closed form of {name} points differs from quadrature, relatively, by at most "
        "what is cut off.",
        error=total / _exact(name) - 1.0,
        # |f_m|² beyond the half width: jumps of f at the border, exp(−(0.4/0.1)²/2) = 3e-4 of it
        at_most=1e-5,
    )


def _against_exact(name: str, data: xr.Dataset) -> Finding:
    low, high = (float(end) for end in data["power_term_ci"].values)
    expected = _exact(name)
    return comparison(
        f"Σ |f_m|² ⟨|S_m|²⟩ with the simulated spectrum of {name} points is the exact variance.",
        expected=expected,
        measured=float(data["power_term"]),
        interval=(low, high),
        text=number(expected, 4),
    )


def _diagonal(name: str, data: xr.Dataset) -> Finding:
    scale = float(data["measured_variance"])
    low, high = (float(end) / scale for end in data["cross_term_ci"].values)
    return comparison(
        f"Nothing is missing for {name} points: correlations between frequencies add nothing, as a share of the "
        "measured variance.",
        expected=0.0,
        measured=float(data["cross_term"]) / scale,
        interval=(low, high),
    )


def _rate(quick: bool, seed: int) -> Finding:
    """A bell that vanishes at the border: power ν² at 0, so that the rate is −1 − 2/2."""
    from mcspectra.variance.convergence import convergence

    counts = [64, 256, 1024] if quick else [64, 256, 1024, 4096]
    curve = convergence(
        _BELL, "jittered | shift", counts, realizations=1000 if quick else 4000, rng=seed
    )
    exact = _exact_slope(counts)
    return rate_finding(
        "The rate of jittered, shifted points on this bell is −1 − b/d with the exponent b = 2 of their spectrum.",
        curve,
        expected=-2.0,
        tolerance=abs(exact + 2.0),
        note=f"Tolerance: the exact variances at these counts have the slope {number(exact, 4)}.",
    )


def _exact_slope(counts: list[int]) -> float:
    from mcspectra.variance.exact import exact_variance

    exact = [float(exact_variance(_BELL, "jittered | shift", n)) for n in counts]
    return float(np.polyfit(np.log(counts), np.log(exact), 1)[0])


def _not_weighted(data: xr.Dataset) -> Finding:
    """Of random points of a density, against their exact variance."""
    value, interval = _ratio(data, _exact_weighted())
    away = comparison("", expected=1.0, measured=value, interval=interval)
    return Finding(
        statement=f"With importance samples of {_DENSITY} the sum of products is not the variance: their ratio is "
        "not 1.",
        expected="not 1",
        measured=value,
        interval=interval,
        agrees=not away.agrees,
    )


def _exact_weighted() -> float:
    from mcspectra.estimators import Estimator
    from mcspectra.variance.exact import exact_variance

    return float(exact_variance(Estimator(_SLOPE, _DENSITY, dims=1), "random", _N))


def _ratio(data: xr.Dataset, exact: float | None = None) -> tuple[float, tuple[float, float]]:
    """The sum of products over the exact variance, or over the measured one with the error of that."""
    power = float(data["power_term"])
    if exact is None:
        low, high = (power / float(end) for end in data["measured_variance_ci"].values[::-1])
        return power / float(data["measured_variance"]), (low, high)
    low, high = (float(end) / exact for end in data["power_term_ci"].values)
    return power / exact, (low, high)


def _products(terms: Terms) -> Picture:
    from mcspectra.integrands.registry import integrand

    figure = new_figure(WIDE, 4.7)
    grid = figure.subplots(2, 3)
    power = np.abs(integrand(_BELL, 2).fourier_grid(_HALF_WIDTH)) ** 2
    power[_HALF_WIDTH, _HALF_WIDTH] = np.nan
    for column, (name, data) in enumerate(terms.items()):
        products = data["power_contribution"].values.copy()
        products[_HALF_WIDTH, _HALF_WIDTH] = np.nan
        sampling = _N * products / power
        _panel(figure, grid[0, column], sampling, f"N · ⟨P_S⟩, {name}", 2.0, "random: 1")
        _panel(figure, grid[1, column], 1e6 * products, "⟨P_S⟩ × P_f", None, "variance · 10⁶")
    for axes in grid[1]:
        axes.set_xlabel("m₀ (cycles per unit)")
    for axes in grid[:, 0]:
        axes.set_ylabel("m₁")
    return Picture(
        kind="variance-integral",
        caption=f"Above, the power of {_N} points of three stationary samplers; below, its product with the power of "
        "a Gaussian bell: the sum of the lower image is the variance. m = 0 is left out.",
        alt="Two rows of three images over the frequencies. Below, random has a spot around 0; jittered and Poisson "
        "disk, whose power has a hole there, a weaker one.",
        figure=figure,
    )


def _panel(
    figure: Figure, axes: Axes, image: Array, title: str, top: float | None, label: str
) -> None:
    edge = _HALF_WIDTH + 0.5
    drawn = axes.imshow(
        image.T,
        origin="lower",
        extent=(-edge, edge, -edge, edge),
        vmin=0.0,
        vmax=top,
        cmap="viridis",
        interpolation="nearest",
    )
    quiet(axes)
    axes.set(xticks=[-_HALF_WIDTH, 0, _HALF_WIDTH], yticks=[-_HALF_WIDTH, 0, _HALF_WIDTH])
    entitle(axes, title)
    quiet_colorbar(figure.colorbar(drawn, ax=axes, shrink=0.8), label)


def _bars(terms: Terms, weighted: xr.Dataset) -> Picture:
    shown = {name: _ratio(terms[name], _exact(name)) for name in _SAMPLERS[:2]}
    shown["poisson-disk"] = _ratio(terms["poisson-disk"])
    shown[f"random, p = {_DENSITY}"] = _ratio(weighted, _exact_weighted())
    figure = new_figure(WIDE, 2.3)
    axes = figure.subplots()
    quiet(axes, grid=True)
    for row, (value, interval) in enumerate(shown.values()):
        axes.hlines(row, *interval, color="#0072B2", lw=2)
        axes.plot(value, row, "o", ms=5, color="#0072B2")
    axes.axvline(1.0, color="#262626", lw=1, ls="--")
    axes.set_yticks(range(len(shown)), list(shown), fontsize=LABEL_SIZE)
    axes.set(xlabel="Σ P_f ⟨P_S⟩ over variance (1: all of it)", ylim=(len(shown) - 0.5, -0.5))
    axes.set_xlim(left=0.0)
    return Picture(
        kind="ratio",
        caption="The sum of products over the exact variance (for Poisson-disk points the measured one), with "
        "95 % intervals: 1 for stationary samples of "
        "constant density, another number for importance samples.",
        alt="Four intervals on an axis of the ratio: three at 1, that of importance samples away from it.",
        figure=figure,
    )
