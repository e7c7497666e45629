"""A light that fades restores the rate of smooth integrands. Smoothing a sharp one adds a bias."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.plots.description import Axis, Line, Mark, Panel, ReferenceLine
from mcspectra.plots.scales import log_axis
from mcspectra.plots.style import INK, PALETTE
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, pixel_rate, rate_text
from mcspectra.reproduction.panels import plot_of, primary_panel, variance_panel, whiskers

__all__ = ["exhibit"]

_EDGES = {"sharp": 0.0, "smooth": 1.0}
_NAMES = {"sharp": "light with a sharp outline", "smooth": "light that fades out"}
_RATES = {"sharp": -1.5, "smooth": -2.0}
_COUNTS = tuple(side**2 for side in (16, 23, 32, 45, 64))
_RESOLUTION = 400
DISK, RADIUS = "disk(center=0.47)", 0.25
WIDTHS = (0.0, 0.02, 0.05, 0.1, 0.2)
BUDGETS = (64, 256, 1024)


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure a pixel under lights with a sharp and a smooth edge, a ramp, and a smoothed disk."""
    pixels = {name: _pixel(edge) for name, edge in _EDGES.items()}
    options: dict[str, Any] = {"realizations": 240 if quick else 800, "rng": seed}
    found = mcs.convergence(list(pixels.values()), "jittered", _COUNTS, **options)
    curves = {name: found.isel(estimator=i) for i, name in enumerate(pixels)}
    options["realizations"] = 300 if quick else 3000
    scan = mcs.improve.smoothing_scan(DISK, "jittered", BUDGETS, WIDTHS, **options)
    sharp, smooth = map(rate_text, curves.values())
    best = ", ".join(
        f"{number(float(width), 2)} (N = {n})"
        for width, n in zip(scan["best_width"], BUDGETS, strict=True)
    )
    variances = variance_panel(
        {_NAMES[name]: curve for name, curve in curves.items()},
        rates={_NAMES[name]: rate for name, rate in _RATES.items()},
        relative=True,
        title="variance",
        x="number of samples N",
        beside=0.6,
    )
    # Draw the errors of the disk against the width of the ramp
    widths, marks = np.array(WIDTHS[1:]), list[Mark]()
    for k, n in enumerate(BUDGETS):
        cell, label = scan.sel(n=n, width=widths), f"N = {n}"
        mse = cell["mse"].values
        edge = float(scan["mse"].sel(n=n, width=0.0))
        marks += [
            ReferenceLine(at=edge, color=PALETTE[k], dashes=":"),
            Line(x=widths, y=mse, color=PALETTE[k], width=1.1, label=label),
            whiskers(widths, mse, cell["mse_ci"].values, k, label),
        ]
    dense = np.geomspace(widths[0], widths[-1], 50)
    line = (np.pi * dense**2 / 12) ** 2
    marks.append(Line(x=dense, y=line, color=INK, width=1.1, label="bias²"))
    x = log_axis("width δ of the edge", widths[0], widths[-1])
    y = log_axis("mean squared error", 1e-7, 5e-4)
    return Exhibit(
        numbers={"sharp": sharp, "smooth": smooth, "best": best, "radius": RADIUS},
        plots=(
            plot_of(
                "smoothed-light",
                *(primary_panel(g, f"{name} edge") for name, g in pixels.items()),
            ),
            plot_of("light-smoothing", _sections(pixels), variances),
            plot_of("smoothing-error", Panel(marks=tuple(marks), x=x, y=y, grid=True)),
        ),
        claims=(
            *(
                pixel_rate(
                    f"Rate of BSDF sampling at P under a light with a {name} edge, jittered.",
                    curve,
                    _RATES[name],
                )
                for name, curve in curves.items()
            ),
            Claim(
                f"BSDF sampling, N = {_COUNTS[-1]}: variance / mean² with the sharp edge divided "
                "by the same with the smooth edge.",
                _relative(curves["sharp"]) / _relative(curves["smooth"]),
                above=1.0,
            ),
            _ramp(0.2),
            _ramp(0.05),
            _bias(scan),
            *(_best_pays(scan, n) for n in BUDGETS),
            _narrower(scan),
        ),
    )


def _pixel(edge: float) -> Any:
    """Return BSDF sampling of the pixel of point P in the scene of Figure 1.

    The light's soft border has the width `edge` times half the side of the light.
    Light sampling is left out: Mitsuba samples texels of a soft light, which adds small jumps.
    """
    scene = f"smooth-light(edge={edge})"
    x, y = mcs.rendering.named_pixels(scene)["P"]
    return mcs.rendering.Pixel(scene=scene, x=x, y=y, strategy="bsdf")


def _sections(pixels: Mapping[str, Any]) -> Panel:
    """Return f/p over u₀, on the line through the maximum under the light that fades out."""
    u = (np.arange(_RESOLUTION) + 0.5) / _RESOLUTION
    grid = np.stack(np.meshgrid(u, u), axis=-1)
    values = {name: np.asarray(g(grid)) for name, g in pixels.items()}
    row = int(values["smooth"].max(axis=1).argmax())
    lines = [
        Line(x=u, y=v[row] / v.mean(), color=PALETTE[k], width=1.8, label=_NAMES[name])
        for k, (name, v) in enumerate(values.items())
    ]
    return Panel(
        marks=tuple(lines),
        x=Axis(label="random number u₀", low=0.0, high=1.0, ticks={0.0: "0", 0.5: "0.5", 1.0: "1"}),
        y=Axis(label="f/p (over its mean)", low=0.0),
        title="integrand along one line",
        grid=True,
    )


def _relative(curve: xr.Dataset) -> Measured:
    """Return variance / mean² at the largest N."""
    last = curve.isel(n=-1)
    return Measured.of(last, "variance") / float(last["mean"]) ** 2


def _ramp(width: float) -> Claim:
    """Compare the exact variance with 1/(12 δ n³), a sum over the strata on a ramp of slope 1/δ."""
    n = 1024
    smoothed = mcs.smoothed(mcs.integrand("step(at=0.47)", dims=1), width)
    # The ramp covers δn strata. At each of its two ends, it may end inside a stratum
    bound = 2 / (width * n)
    return Claim(
        f"In one dim a step smoothed over δ = {width} has the variance 1/(12 δ N³) with jittered "
        f"points instead of O(N⁻²): 12 δ N³ times the exact variance, N = {n}.",
        12 * width * n**3 * float(mcs.exact_variance(smoothed, "jittered", n)),
        expected=1.0,
        tolerance=bound,
        shown=f"1 ± {number(bound, 2)}",
        note="Tolerance: the two strata at the ends of the ramp, out of δN strata.",
    )


def _bias(scan: xr.Dataset) -> Claim:
    """Compare the bias with πδ²/12: a ramp of width δ at radius R has the area π(R² + δ²/12)."""
    width = scan["width"].values[1:]
    error = scan["smoothing_bias"].values[1:] / (np.pi * width**2 / 12) - 1.0
    return Claim(
        "A disk whose edge is a ramp of width δ has the bias πδ²/12: largest relative difference.",
        float(np.abs(error).max()),
        at_most=1e-3,
        note="Integrals of smoothed disks are computed by quadrature.",
    )


def _best_pays(scan: xr.Dataset, n: int) -> Claim:
    """Compare the mean squared errors for the sharp edge and for the best width of the ramp."""
    cell = scan.sel(n=n)
    best = int(np.argmin(cell["mse"].values))
    edge, least = (Measured.of(cell.isel(width=k), "mse") for k in (0, best))
    return Claim(
        "Some smoothing width reduces the error: squared error of a disk with a sharp edge divided "
        f"by the error at the best width, bias included, N = {n}.",
        edge / least,
        above=1.0,
    )


def _narrower(scan: xr.Dataset) -> Claim:
    first, last = (float(scan["best_width"].sel(n=n)) for n in (BUDGETS[0], BUDGETS[-1]))
    return Claim(
        f"The best width shrinks with the budget: width at N = {BUDGETS[-1]} divided by width at "
        f"N = {BUDGETS[0]}.",
        last / first,
        below=1.0,
        shown="< 1",
        note=f"Widths tried: {', '.join(f'{w:g}' for w in WIDTHS)}.",
    )
