"""The estimator I_N and its sampling function S(x), for random, jittered and Poisson-disk points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.figures.points import point_sets
from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction.base import (
    Exhibit,
    Finding,
    agreement,
    comparison,
    identity,
    normal_interval,
)
from mcspectra.report.style import (
    ACCENT,
    GRAY,
    INK,
    LABEL_SIZE,
    WIDE,
    entitle,
    new_figure,
    quiet,
    sampler_styles,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["exhibit"]

_SAMPLERS = ("random", "jittered", "poisson-disk")
_BELL = "gaussian(center=0.4, width=0.2)"
_DENSITY = "linear(slope=-1.2)"
_SQUARE = "christensen-gaussian"
_N = 64


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Show the estimator, its combs of weighted peaks, and that its mean is the integral."""
    from mcspectra.variance.convergence import convergence

    realizations = 1000 if quick else 10_000
    curves = convergence(_SQUARE, list(_SAMPLERS), [_N], realizations=realizations, rng=seed)
    one = {name: curves.sel(sampler=name).isel(n=0) for name in _SAMPLERS}
    findings = (
        *(_unbiased(name, data) for name, data in one.items()),
        _exact_variance("random", one["random"]),
        _exact_variance("jittered", one["jittered"]),
        _less_noise(one["poisson-disk"]),
        _weights_sum_to_one(realizations, seed),
        _inner_product(seed),
    )
    return Exhibit(
        name="estimator",
        title="Monte Carlo estimator and its sampling function",
        slide="Monte Carlo Estimator: I_N = (1/N) Σ f(x_k)/p(x_k). Random vs. Correlated Samples: "
        "S(x) = (1/N) Σ δ(x − x_k)/p(x_k), for Random, Jitter and Poisson Disk.",
        formula=r"I_N = \frac{1}{N} \sum_{k=1}^N \frac{f(x_k)}{p(x_k)}, \qquad "
        r"S(x) = \frac{1}{N} \sum_{k=1}^N \frac{\delta(x - x_k)}{p(x_k)}",
        caption=_caption(one),
        pictures=(_combs(seed), _points(seed)),
        findings=findings,
    )


def _caption(one: dict[str, xr.Dataset]) -> str:
    means = ", ".join(f"{number(float(d['mean']), 4)} ({name})" for name, d in one.items())
    variances = ", ".join(f"{number(float(d['variance']))} ({name})" for name, d in one.items())
    integral = number(_integral(), 4)
    return (
        f"The estimate is the integral of f times a comb of peaks S, one for each point, of the height "
        f"1/(N p). Its mean is the integral for all three samplers: of exp(−x² − y²), {integral}, with "
        f"N = {_N} points the means are {means}. What differs is the variance: {variances}."
    )


def _integral() -> float:
    from mcspectra.integrands.registry import integrand

    return float(np.squeeze(integrand(_SQUARE).integral))


def _unbiased(name: str, data: xr.Dataset) -> Finding:
    mean, se = float(data["mean"]), float(data["mean_se"])
    return comparison(
        f"The mean of I_N is the integral for {name} points.",
        expected=_integral(),
        measured=mean,
        interval=normal_interval(mean, se),
        text=number(_integral(), 7),
    )


def _exact_variance(name: str, data: xr.Dataset) -> Finding:
    expected = _exact(name)
    low, high = data["variance_ci"].values
    return comparison(
        f"The variance of I_N with {_N} {name} points is that of quadrature over strata.",
        expected=expected,
        measured=float(data["variance"]),
        interval=(float(low), float(high)),
        scale="log",
        text=number(expected, 4),
    )


def _exact(name: str) -> float:
    from mcspectra.variance.exact import exact_variance

    return float(exact_variance(_SQUARE, name, _N))


def _less_noise(data: xr.Dataset) -> Finding:
    low, high = data["variance_ci"].values
    return agreement(
        f"Correlated points lower the variance: {_N} Poisson-disk points are below random ones.",
        measured=float(data["variance"]),
        interval=(float(low), float(high)),
        below=_exact("random"),
        scale="log",
    )


def _weights_sum_to_one(realizations: int, seed: int) -> Finding:
    x = _warped("random", _N, seed, realizations)
    sums = (1.0 / _pdf(x)).mean(axis=1)
    mean, se = float(sums.mean()), float(sums.std(ddof=1)) / realizations**0.5
    return comparison(
        f"The peaks of S, of the height 1/(N p), sum to 1 on average, for p = {_DENSITY}.",
        expected=1.0,
        measured=mean,
        interval=normal_interval(mean, se),
        text="1",
    )


def _inner_product(seed: int) -> Finding:
    """I_N = Σ conj(f_m) S_m, of an integrand with two frequencies m = ±3."""
    x = _warped("jittered", _N, seed, 1)[0]
    direct = float((np.cos(6 * np.pi * x) / _pdf(x)).mean())
    s = {m: (np.exp(-2j * np.pi * m * x) / _pdf(x)).mean() for m in (-3, 3)}
    return identity(
        "I_N is the sum of conj(f_m) S_m over frequencies, for f = cos(6πx) under importance sampling.",
        error=abs(direct - complex(0.5 * s[3] + 0.5 * s[-3])),
        at_most=1e-13,
    )


def _warped(name: str, n: int, seed: int, realizations: int) -> Array:
    """Points of the density p, shape (realizations, n)."""
    from mcspectra.densities.registry import density
    from mcspectra.samplers.registry import sampler

    u = sampler(name, 1).draw(n, realizations=realizations, rng=seed)
    return np.asarray(density(_DENSITY, 1).sample(u)[..., 0])


def _pdf(x: Array) -> Array:
    from mcspectra.densities.registry import density

    return np.asarray(density(_DENSITY, 1).pdf(x[..., None]))


def _combs(seed: int) -> Picture:
    n = 16
    figure = new_figure(WIDE, 4.4)
    top, *rows = figure.subplots(4, 1, sharex=True, height_ratios=[2.2, 1, 1, 1])
    _draw_integrand(top)
    styles = sampler_styles(_SAMPLERS)
    for axes, name in zip(rows, _SAMPLERS, strict=True):
        x = _warped(name, n, seed, 1)[0]
        axes.vlines(x, 0, 1 / (n * _pdf(x)), color=styles[name].color, lw=1.3)
        axes.plot(x, 1 / (n * _pdf(x)), "^", ms=3.5, color=styles[name].color)
        quiet(axes)
        axes.set(ylim=(0, 3.2 / n), yticks=[0, 2 / n], ylabel="S(x)")
        entitle(axes, name, "left")
    rows[-1].set(xlabel="x (domain, 0 to 1)", xlim=(0, 1))
    return Picture(
        kind="estimator",
        caption=f"Above, an integrand f and an importance density p; below, the sampling function S of "
        f"{n} points of p: peaks of the height 1/(N p(x_k)), dense and low where p is large.",
        alt="Curves of f and p over x from 0 to 1, and three rows of vertical peaks at the points: "
        "irregular for random points, one in each stratum for jittered, with a minimum distance for "
        "Poisson disk.",
        figure=figure,
    )


def _draw_integrand(axes: Axes) -> None:
    from mcspectra.integrands.registry import integrand

    x = np.linspace(0.0, 1.0, 400, endpoint=False)
    f = np.asarray(integrand(_BELL, 1)(x[:, None]))
    quiet(axes)
    axes.fill_between(x, 0, f, color="#0072B2", alpha=0.15, lw=0)
    axes.plot(x, f, color=INK, lw=1.4)
    axes.plot(x, _pdf(x), color=ACCENT, lw=1.4, ls="--")
    axes.text(0.24, 1.02, "f(x)", fontsize=LABEL_SIZE, color=INK)
    axes.text(0.02, 1.66, "p(x)", fontsize=LABEL_SIZE, color=ACCENT)
    axes.axhline(0, color=GRAY, lw=0.6)
    axes.set(ylim=(0, 1.9), ylabel="value")


def _points(seed: int) -> Picture:
    from mcspectra.core.results import dataset
    from mcspectra.samplers.registry import sampler

    n = 256
    drawn = {
        name: dataset({"points": (("point", "axis"), sampler(name, 2).draw(n, rng=seed)[0])}, {})
        for name in _SAMPLERS
    }
    return Picture(
        kind="points",
        caption=f"{n} points in the unit square of each sampler: random ones clump and leave holes, jittered ones "
        "lie one to a stratum, Poisson-disk points keep a minimum distance.",
        alt="Three squares of points: random, jittered, Poisson disk, from clumped to evenly spaced.",
        figure=point_sets(drawn),
    )
