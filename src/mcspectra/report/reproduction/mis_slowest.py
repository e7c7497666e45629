"""Multiple importance sampling converges like its slowest technique: a toy, and pixels of Veach's scene."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.axes import count_axis, log_axis
from mcspectra.report.formatting import number, rate
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._curves import slope
from mcspectra.report.reproduction._pixels import pixel_panel, pixel_rate
from mcspectra.report.reproduction.base import (
    Exhibit,
    Finding,
    agreement,
    comparison,
    identity,
    rate_finding,
)
from mcspectra.report.style import PALETTE, WIDE, entitle, legend_below, new_figure, quiet

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["exhibit"]

_AT = 0.3
_COUNTS = (16, 32, 64, 128, 256, 512)
_SIDES = (6, 8, 11, 16, 23, 32)  # of strata; at full quality, twice as many
_PIXELS = {
    "wall": {"scene": "veach", "x": 568, "y": 100, "light": "light-3"},
    "plate": {"scene": "veach", "x": 600, "y": 430, "light": "light-3"},
}
_WHERE = {"wall": "the diffuse wall", "plate": "the roughest plate"}
_NAMES = ("light sampling", "BSDF sampling", "MIS")
_RATES = {"light sampling": -2.0, "BSDF sampling": -1.5, "MIS": -1.5}


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure techniques and their sum, of the toy and of two pixels."""
    toy = _toy(400 if quick else 4000, seed)
    sides = [side if quick else 2 * side for side in _SIDES]
    pixels = {name: _pixel(name, sides, 80 if quick else 500, seed) for name in _PIXELS}
    findings = (
        *(_toy_rate(toy, technique) for technique in (0, 1)),
        _toy_sum(toy),
        _toy_bottleneck(toy),
        _toy_formula(),
        *(_pixel_rate(where, name, pixels[where]) for where in _PIXELS for name in _NAMES),
        *(_follows(where, pixels[where]) for where in _PIXELS),
        *(_parts(where, pixels[where]) for where in _PIXELS),
    )
    return Exhibit(
        name="mis-slowest",
        title="Multiple importance sampling follows the slowest technique",
        slide="Variance Convergence: Importance Sampling. For multiple importance sampling (MIS), convergence is "
        "determined by the BxDF sampling strategy. In MIS, the worst of the two strategies would determine the overall "
        "convergence rate.",
        formula=r"\mathrm{Var}(I_N) = \sum_t \mathrm{Var} \left( \frac{1}{N} \sum_{k=1}^N \frac{w_t(x_{t,k}) "
        r"f(x_{t,k})}{p_t(x_{t,k})} \right)",
        caption=_caption(pixels),
        pictures=(_pixel_curves(pixels), _toy_curves(toy)),
        findings=findings,
    )


def _caption(pixels: dict[str, xr.Dataset]) -> str:
    texts = []
    for where, found in pixels.items():
        rates = (found.isel(estimator=i) for i in range(3))
        shown = (rate(float(c["rate"]), *map(float, c["rate_ci"].values)) for c in rates)
        texts.append(
            f"{_WHERE[where]}: " + ", ".join(f"{n} {r}" for n, r in zip(_NAMES, shown, strict=True))
        )
    return (
        "Techniques have points of their own, so that their variances add up, and of a sum of powers of N the slowest is "
        f"left. At two pixels of Veach's scene under its widest light, jittered: {'; '.join(texts)}. Weights lower "
        "the edge that BSDF sampling sees and leave it there: MIS has its rate, and where light sampling alone is smooth, "
        "adding BSDF samples is worse from some N on."
    )


def _toy(realizations: int, seed: int) -> xr.Dataset:
    from mcspectra.estimators.mis import TechniqueSum
    from mcspectra.variance.techniques import technique_terms

    return technique_terms(
        TechniqueSum(["linear", f"step(at={_AT})"], dims=1), "jittered", _COUNTS,
        half_width=1, realizations=realizations, rng=seed,
    )  # fmt: skip


def _exact(technique: int) -> Array:
    """1/(12n³) of f = x, and {an}(1 − {an})/n² of 1[x < a]."""
    n = np.array(_COUNTS, float)
    part = _AT * n % 1.0
    return np.asarray(1 / (12 * n**3) if technique == 0 else part * (1 - part) / n**2)


def _toy_rate(toy: xr.Dataset, technique: int) -> Finding:
    expected, name = ((-3.0, "f = x"), (-2.0, f"1[x < {_AT}]"))[technique]
    curve = toy.sel(technique=technique)[["technique_rate", "technique_rate_ci"]].rename(
        technique_rate="rate", technique_rate_ci="rate_ci"
    )
    return _near_limit(
        f"Toy: rate of the technique {name}, jittered.", curve, expected, _exact(technique)
    )


def _toy_sum(toy: xr.Dataset) -> Finding:
    both = _exact(0) + _exact(1)
    return _near_limit("Toy: the sum has the rate of the slower technique.", toy, -2.0, both)


def _near_limit(statement: str, curve: xr.Dataset, expected: float, exact: Array) -> Finding:
    here = slope(_COUNTS, exact)
    return rate_finding(
        statement,
        curve,
        expected=expected,
        tolerance=abs(here - expected),
        note=f"Tolerance: the exact variances at these N have the slope {number(here, 5)}.",
    )


def _toy_bottleneck(toy: xr.Dataset) -> Finding:
    return _named(
        "Toy: the technique whose interval lies above all others", toy.attrs["bottleneck"]
    )


def _named(statement: str, found: str) -> Finding:
    return Finding(
        statement=f"{statement} is the slower one.",
        expected="technique 1",
        measured=found,
        interval=None,
        agrees=found == "technique 1",
    )


def _toy_formula() -> Finding:
    from mcspectra.estimators.mis import TechniqueSum
    from mcspectra.variance.exact import exact_variance

    toy = TechniqueSum(["linear", f"step(at={_AT})"], dims=1)
    exact = np.array([exact_variance(toy, "jittered", n) for n in _COUNTS])
    return identity(
        "Toy: the variance of the sum is 1/(12N³) + {aN}(1 − {aN})/N², {·} the fractional part: largest relative "
        "difference.",
        error=float(np.abs(exact / (_exact(0) + _exact(1)) - 1).max()),
        at_most=1e-9,
    )


def _pixel(where: str, sides: list[int], realizations: int, seed: int) -> xr.Dataset:
    """Light and BSDF sampling alone, MIS, and its two techniques, on a dim estimator."""
    from mcspectra.rendering.pixel import pixel_strategies
    from mcspectra.rendering.pixel_mis import pixel_mis
    from mcspectra.variance.convergence import convergence

    place: dict[str, Any] = _PIXELS[where]
    alone, mis = pixel_strategies(**place), pixel_mis(**place)
    parts = [mis.primary_integrand(t) for t in (0, 1)]
    return convergence(
        [alone["light"], alone["bsdf"], mis, *parts], "jittered", [side**2 for side in sides],
        realizations=realizations, rng=seed,
    )  # fmt: skip


def _pixel_rate(where: str, name: str, found: xr.Dataset) -> Finding:
    return pixel_rate(
        f"Veach's scene, {_WHERE[where]}: rate of {name}, jittered.",
        found.isel(estimator=_NAMES.index(name)),
        _RATES[name],
    )


def _follows(where: str, found: xr.Dataset) -> Finding:
    """Difference of two rates, both with intervals, taken as independent."""
    curves = [found.isel(estimator=i) for i in (2, 1)]
    difference = float(curves[0]["rate"] - curves[1]["rate"])
    half = float(math.hypot(*(np.diff(c["rate_ci"].values)[0] / 2 for c in curves)))
    return comparison(
        f"Veach's scene, {_WHERE[where]}: rate of MIS minus that of BSDF sampling.",
        expected=0.0,
        measured=difference,
        interval=(difference - half, difference + half),
        tolerance=0.125,
        text="0 ± 0.12",
        note="Tolerance: a quarter of the distance to the rate of light sampling.",
    )


def _parts(where: str, found: xr.Dataset) -> Finding:
    """Share of the BSDF technique in the variance of MIS at the largest N."""
    light, bsdf = (found.isel(estimator=i, n=-1) for i in (3, 4))
    ratio = float(bsdf["variance"] / light["variance"])
    halves = [np.diff(np.log(c["variance_ci"].values))[0] / 2 for c in (light, bsdf)]
    factor = float(np.exp(math.hypot(*halves)))
    return agreement(
        f"Veach's scene, {_WHERE[where]}: what is left of MIS at N = {int(light['n'])} is its BSDF technique; variance "
        "of that over that of its light technique.",
        measured=ratio,
        interval=(ratio / factor, ratio * factor),
        above=1.0,
        scale="log",
    )


def _pixel_curves(pixels: dict[str, xr.Dataset]) -> Picture:
    figure = new_figure(WIDE, 3.9)
    panels = figure.subplots(1, 2)
    for axes, (where, found) in zip(panels, pixels.items(), strict=True):
        curves = {name: found.isel(estimator=i) for i, name in enumerate(_NAMES)}
        pixel_panel(axes, curves, _RATES, _WHERE[where])
    panels[0].set_ylabel("variance / mean²")
    panels[0].set_xlabel("samples N of each technique")
    panels[1].set_xlabel("samples N of each technique")
    legend_below(figure, panels[0], columns=3)
    return Picture(
        kind="mis-slowest",
        caption="Variance over the squared mean at two pixels of Veach's scene, with 95 % intervals, jittered; MIS has N "
        "samples of each technique, balance heuristic. Dashed, the rates of theory.",
        alt="Two logarithmic plots. Light sampling falls with slope −2; BSDF sampling and, below it, MIS fall with slope "
        "−1.5.",
        figure=figure,
    )


def _toy_curves(toy: xr.Dataset) -> Picture:
    figure = new_figure(WIDE, 3.2)
    axes = figure.subplots()
    quiet(axes, grid=True)
    rows = (
        ("f = x", toy["technique_variance"].sel(technique=0), _exact(0)),
        (f"f = 1[x < {_AT}]", toy["technique_variance"].sel(technique=1), _exact(1)),
        ("sum", toy["measured_variance"], _exact(0) + _exact(1)),
    )
    for (label, measured, exact), color, marker in zip(rows, PALETTE, "os^", strict=False):
        axes.plot(_COUNTS, exact, color=color, lw=1.2)
        axes.plot(_COUNTS, measured.values, marker, ms=5, mfc="none", color=color, label=label)
    count_axis(axes, "x", _COUNTS)
    log_axis(axes, "y", 3e-10, 2e-3)
    axes.set(xlabel="number of points N of each technique", ylabel="variance")
    entitle(axes, "two techniques and their sum")
    legend_below(figure, axes, columns=3)
    return Picture(
        kind="toy-techniques",
        caption="Measured variances (marks) and exact ones (lines) of two techniques and of their sum, jittered points.",
        alt="Logarithmic plot: the linear technique falls with slope −3, the step with −2, and the sum lies on the step's "
        "curve.",
        figure=figure,
    )
