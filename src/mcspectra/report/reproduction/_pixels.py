"""Rates of rendered pixels, whose limits are known but not their exact variances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.report.axes import count_axis, log_axis
from mcspectra.report.formatting import number
from mcspectra.report.reproduction.base import Finding, rate_finding
from mcspectra.report.style import PALETTE, entitle, quiet

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

__all__ = ["draw_primary", "pixel_panel", "pixel_rate"]

_TOLERANCE = 0.125
_NOTE = (
    "Tolerance: a quarter of the distance between −1.5 (edges) and −2 (smooth). Curves bend towards their limits, and "
    "exact variances of pixels are not known."
)
_RATES = (-1.5, -2.0)
_RESOLUTION = 256


def pixel_rate(statement: str, curve: xr.Dataset, expected: float) -> Finding:
    """Judge a rate in the plane against −1.5 or −2; say where the other of them would agree too."""
    judged = {
        rate: rate_finding(statement, curve, expected=rate, tolerance=_TOLERANCE, note=_NOTE)
        for rate in _RATES
    }
    finding = judged.pop(expected)
    ((other, rival),) = judged.items()
    if not (finding.agrees and rival.agrees):
        return finding
    weak = f"{_NOTE} So few realisations do not rule out {number(other, 2)}."
    return replace(finding, note=weak)


def pixel_panel(
    axes: Axes,
    curves: Mapping[str, xr.Dataset],
    theory: Mapping[str, float],
    title: str,
) -> None:
    """Draw variances relative to the squared mean, 95 % intervals, with lines of the rates of theory.

    Parameters
    ----------
    curves
        Of `mcspectra.convergence`, one estimator and sampler each, by label; colours follow their order.
    theory
        Rate of each label; its line goes through the last variance.
    """
    quiet(axes, grid=True)
    ends: list[float] = []
    for (label, curve), color, marker in zip(curves.items(), PALETTE, "os^Dv", strict=False):
        scale = float(curve["mean"][-1]) ** -2
        n, variance = curve["n"].values, scale * curve["variance"].values
        low, high = scale * curve["variance_ci"].values.T
        axes.errorbar(
            n, variance, [variance - low, high - variance],
            fmt=marker, ms=4, lw=1, color=color, label=label,
        )  # fmt: skip
        line = variance[-1] * (n / n[-1]) ** theory[label]
        axes.plot(n, line, "--", color=color, lw=1)
        ends += [*low, *high, *line]
    count_axis(axes, "x", [int(v) for v in n], most=5)
    log_axis(axes, "y", min(ends), max(ends), most=5)
    axes.set_xlabel("number of samples N")
    entitle(axes, title)


def draw_primary(axes: Axes, integrand: Any, title: str) -> AxesImage:
    """Draw an integrand on the unit square, over its mean."""
    u = (np.arange(_RESOLUTION) + 0.5) / _RESOLUTION
    values = np.asarray(integrand(np.stack(np.meshgrid(u, u), axis=-1)))
    quiet(axes)
    drawn = axes.imshow(
        values / values.mean(), origin="lower", extent=(0, 1, 0, 1), cmap="cividis",
        interpolation="nearest", vmin=0.0,
    )  # fmt: skip
    axes.set(xticks=[0, 1], yticks=[0, 1], xlabel="u₀", ylabel="u₁")
    entitle(axes, title)
    return drawn
