"""Smoothed lights: rates of smooth integrands again, at the price of a bias."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.report.axes import log_axis
from mcspectra.report.formatting import number, rate
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._pixels import draw_primary, pixel_panel, pixel_rate
from mcspectra.report.reproduction.base import Exhibit, Finding, agreement, identity
from mcspectra.report.style import (
    INK,
    NARROW,
    PALETTE,
    WIDE,
    legend_below,
    new_figure,
    outer_labels,
    quiet,
    quiet_colorbar,
)

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["exhibit"]

_EDGES = {"sharp": 0.0, "smooth": 1.0}
_RATES = {"sharp": -1.5, "smooth": -2.0}
_COUNTS = tuple(side**2 for side in (16, 23, 32, 45, 64))
_DISK = "disk(center=0.47)"
_RADIUS = 0.25
_WIDTHS = (0.0, 0.02, 0.05, 0.1, 0.2)
_BUDGETS = (64, 256, 1024)


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure a pixel under a light with a sharp and a smooth edge, a ramp, and a smoothed disk."""
    from mcspectra.variance.convergence import convergence
    from mcspectra.variance.variants import smoothing_scan

    pixels = {name: _pixel(edge) for name, edge in _EDGES.items()}
    found = convergence(
        list(pixels.values()), "jittered", _COUNTS, realizations=80 if quick else 800, rng=seed
    )
    curves = {name: found.isel(estimator=i) for i, name in enumerate(pixels)}
    scan = smoothing_scan(
        _DISK, "jittered", _BUDGETS, _WIDTHS, realizations=300 if quick else 3000, rng=seed
    )
    findings = (
        *(_rate(name, curve) for name, curve in curves.items()),
        _gain(curves),
        _ramp(0.2),
        _ramp(0.05),
        _bias(scan),
        *(_best(scan, n) for n in _BUDGETS),
        _narrower(scan),
    )
    return Exhibit(
        name="light-smoothing",
        title="Smoothed lights restore the rate",
        slide="(A figure without words.) Light smoothing: discontinuities that come from the borders of lights are taken out "
        "by lights that fade.",
        caption=_caption(curves, scan),
        pictures=(_squares(pixels), _convergence(curves), _widths(scan)),
        findings=findings,
    )


def _pixel(edge: float) -> Any:
    """BSDF sampling at P of Figure 1, under a light whose radiance rises over `edge` of its half side."""
    from mcspectra.rendering.pixel import Pixel
    from mcspectra.rendering.scenes import named_pixels

    scene = f"smooth-light(edge={edge})"
    x, y = named_pixels(scene)["P"]
    return Pixel(scene=scene, x=x, y=y, strategy="bsdf")


def _caption(curves: dict[str, xr.Dataset], scan: xr.Dataset) -> str:
    rates = {
        name: rate(float(c["rate"]), *map(float, c["rate_ci"].values)) for name, c in curves.items()
    }
    best = ", ".join(
        f"{number(float(w), 2)} (N = {n})"
        for w, n in zip(scan["best_width"], _BUDGETS, strict=True)
    )
    return (
        f"BSDF sampling of a square light converges at {rates['sharp']}: its outline is an edge in f/p. A light that "
        f"fades to its border has none, and {rates['smooth']}. Fading changes the light, though, and a smoothed edge "
        f"of a given picture is a bias that N does not lower. Of a disk the width with the least squared error is {best}: "
        "it shrinks with the budget."
    )


def _rate(name: str, curve: xr.Dataset) -> Finding:
    return pixel_rate(
        f"Rate of BSDF sampling at P under a light with a {name} edge, jittered.",
        curve,
        _RATES[name],
    )


def _gain(curves: dict[str, xr.Dataset]) -> Finding:
    """Ratio of relative variances at the largest N."""
    logs, halves = [], []
    for curve in curves.values():
        last = curve.isel(n=-1)
        logs.append(float(np.log(last["variance"] / last["mean"] ** 2)))
        halves.append(float(np.diff(np.log(last["variance_ci"].values))[0]) / 2)
    ratio, factor = float(np.exp(logs[0] - logs[1])), float(np.exp(math.hypot(*halves)))
    return agreement(
        f"At N = {_COUNTS[-1]}, variance over squared mean with the sharp edge over that with the smooth one.",
        measured=ratio,
        interval=(ratio / factor, ratio * factor),
        above=1.0,
        scale="log",
    )


def _ramp(width: float) -> Finding:
    """Exact: within strata of a ramp of the slope 1/δ, 1/(12 δ n³) in all."""
    from mcspectra.integrands.registry import integrand
    from mcspectra.integrands.smoothing import smoothed
    from mcspectra.variance.exact import exact_variance

    n = 1024
    ramp = smoothed(integrand("step(at=0.47)", dims=1), width)
    value = 12 * width * n**3 * float(exact_variance(ramp, "jittered", n))
    # Two strata at the ends of the ramp are not full: they change δn strata by two at most
    bound = 2 / (width * n)
    return Finding(
        statement=f"In one dim a step smoothed over δ = {width} has the variance 1/(12 δ N³) with jittered points, not "
        f"one of N⁻²: 12 δ N³ times the exact variance, N = {n}.",
        expected=f"1 ± {number(bound, 2)}",
        measured=value,
        interval=None,
        agrees=abs(value - 1) <= bound,
        note="Tolerance: the two strata at the ends of the ramp, of the δN on it.",
    )


def _bias(scan: xr.Dataset) -> Finding:
    """A ramp of the width δ about the radius R: π(R² + δ²/12)."""
    width = scan["width"].values[1:]
    error = scan["smoothing_bias"].values[1:] / (np.pi * width**2 / 12) - 1.0
    return identity(
        "A disk whose edge is a ramp of the width δ has the bias πδ²/12: largest relative difference.",
        error=float(np.abs(error).max()),
        at_most=1e-3,
        note="Integrals of smoothed disks are quadratures.",
    )


def _best(scan: xr.Dataset, n: int) -> Finding:
    """Mean squared error with the edge over that of the best width."""
    cell = scan.sel(n=n)
    best = int(np.argmin(cell["mse"].values))
    logs = np.log(cell["mse_ci"].values[[0, best]])
    ratio = float(cell["mse"][0] / cell["mse"][best])
    factor = float(np.exp(math.hypot(*(np.diff(logs, axis=1)[:, 0] / 2))))
    return agreement(
        f"There is a width that pays: squared error of a disk with its edge over that of the best width, bias included, "
        f"N = {n}.",
        measured=ratio,
        interval=(ratio / factor, ratio * factor),
        above=1.0,
        scale="log",
    )


def _narrower(scan: xr.Dataset) -> Finding:
    first, last = (float(scan["best_width"].sel(n=n)) for n in (_BUDGETS[0], _BUDGETS[-1]))
    return Finding(
        statement=f"The best width shrinks with the budget: that of N = {_BUDGETS[-1]} over that of N = {_BUDGETS[0]}.",
        expected="< 1",
        measured=last / first,
        interval=None,
        agrees=last < first,
        note=f"Of the widths {', '.join(f'{w:g}' for w in _WIDTHS)}.",
    )


def _squares(pixels: dict[str, Any]) -> Picture:
    figure = new_figure(NARROW, 3.6)
    panels = figure.subplots(1, 2)
    for axes, (name, g) in zip(panels, pixels.items(), strict=True):
        drawn = draw_primary(axes, g, f"{name} edge")
        outer_labels(axes)
        bar = figure.colorbar(drawn, ax=axes, orientation="horizontal", pad=0.02, aspect=18)
        quiet_colorbar(bar, "f/p (over its mean)")
    return Picture(
        kind="smoothed-light",
        caption="f/p under BSDF sampling at P, over the random numbers: a light with a sharp and with a smooth edge.",
        alt="Two squares. Left, a bright patch with a sharp outline on black; right, one that fades to black.",
        figure=figure,
    )


def _convergence(curves: dict[str, xr.Dataset]) -> Picture:
    figure = new_figure(NARROW, 3.3)
    axes = figure.subplots()
    pixel_panel(axes, {f"{k} edge": c for k, c in curves.items()},
                {f"{k} edge": r for k, r in _RATES.items()}, "BSDF sampling at P, jittered")  # fmt: skip
    axes.set_ylabel("variance / mean²")
    legend_below(figure, axes)
    return Picture(
        kind="light-smoothing",
        caption="Variance over the squared mean with 95 % intervals; dashed, the rates of theory, −1.5 and −2.",
        alt="Logarithmic plot against N: the smooth edge starts with more variance, relative to its smaller mean, falls "
        "with slope −2 and crosses the sharp one, which falls with −1.5.",
        figure=figure,
    )


def _widths(scan: xr.Dataset) -> Picture:
    figure = new_figure(WIDE, 3.3)
    axes = figure.subplots()
    quiet(axes, grid=True)
    widths = np.array(_WIDTHS[1:])
    for n, color, marker in zip(_BUDGETS, PALETTE, "os^", strict=False):
        cell = scan.sel(n=n, width=widths)
        mse, (low, high) = cell["mse"].values, cell["mse_ci"].values.T
        axes.errorbar(
            widths, mse, [mse - low, high - mse], fmt=f"{marker}-", ms=4, lw=1.1, color=color,
            label=f"N = {n}",
        )  # fmt: skip
        edge = float(scan["mse"].sel(n=n, width=0.0))
        axes.axhline(edge, color=color, lw=0.9, ls=":")
    dense = np.geomspace(widths[0], widths[-1], 50)
    axes.plot(dense, (np.pi * dense**2 / 12) ** 2, color=INK, lw=1.1, label="bias², (πδ²/12)²")
    log_axis(axes, "x", widths[0], widths[-1])
    log_axis(axes, "y", 1e-7, 5e-4)
    axes.set(xlabel="width δ of the edge (sides of the domain)", ylabel="mean squared error")
    legend_below(figure, axes, columns=4)
    return Picture(
        kind="smoothing-widths",
        caption=f"Mean squared error, bias² + variance, of a disk of the radius {_RADIUS} against the width of its edge, "
        "jittered, 95 % intervals; dotted, with its edge.",
        alt="Logarithmic plot against the width. Each count has a curve that falls, has a minimum, further left for more "
        "points, and rises with the line of the squared bias.",
        figure=figure,
    )
