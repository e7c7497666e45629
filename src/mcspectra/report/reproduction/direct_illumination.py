"""Direct illumination of two points by light and by BSDF sampling: the paper's Figure 1."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from mcspectra.report.formatting import rate
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._limits import largest_distance
from mcspectra.report.reproduction._pixels import draw_primary, pixel_panel, pixel_rate
from mcspectra.report.reproduction.base import Exhibit, Finding
from mcspectra.report.style import (
    ACCENT,
    PAPER,
    WIDE,
    legend_below,
    new_figure,
    outer_labels,
    quiet_colorbar,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["exhibit"]

_SCENE = "figure1"
_CASES = tuple(itertools.product("PQ", ("light", "bsdf")))
_SAMPLERS = ("jittered", "jittered | shift")
_COUNTS = tuple(side**2 for side in (8, 11, 16, 23, 32, 45, 64))
_NAMES = {"light": "light sampling", "bsdf": "BSDF sampling"}
_SEEN = {"P": "sees all of the light", "Q": "sees a part of it"}

Case: TypeAlias = tuple[str, str]
Curves: TypeAlias = "dict[tuple[Case, str], xr.Dataset]"


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Draw the integrands of two pixels on the square, and measure their eight rates."""
    from mcspectra.variance.convergence import convergence

    integrands = _integrands()
    found = convergence(
        list(integrands.values()), list(_SAMPLERS), _COUNTS,
        realizations=80 if quick else 800, rng=seed,
    )  # fmt: skip
    curves = {
        (case, sampler): found.isel(estimator=i, sampler=j)
        for (i, case), (j, sampler) in itertools.product(enumerate(_CASES), enumerate(_SAMPLERS))
    }
    findings = (
        *(_rate(case, sampler, curve) for (case, sampler), curve in curves.items()),
        _same_integral(curves),
    )
    return Exhibit(
        name="direct-illumination",
        title="Direct illumination by light and by BSDF sampling",
        slide="Correlated Importance Sampling affects convergence rate. Direct Illumination Integral; Light PDF "
        "Sampling: Light IS; BSDF PDF Sampling: BSDF IS (Figure 1 of the paper).",
        formula=r"I_N = \frac{1}{N} \sum_{k=1}^N \frac{f(x_k)}{p(x_k)}",
        caption=_caption(curves),
        pictures=(_scene(quick, seed), _squares(integrands), _convergence(curves)),
        findings=findings,
    )


def _integrands() -> dict[Case, Any]:
    """f/p of each pixel and strategy as a function of the random numbers."""
    from mcspectra.rendering.pixel import pixel_strategies
    from mcspectra.rendering.scenes import named_pixels

    pixels = named_pixels(_SCENE)
    return {(p, s): pixel_strategies(_SCENE, *pixels[p])[s] for p, s in _CASES}


def _expected(case: Case, sampler: str) -> float:
    """Smooth is light sampling of a light that is seen whole, as long as nothing wraps around."""
    return -2.0 if (case, sampler) == (("P", "light"), "jittered") else -1.5


def _rate(case: Case, sampler: str, curve: xr.Dataset) -> Finding:
    point, strategy = case
    return pixel_rate(
        f"Rate of {_NAMES[strategy]} at {point}, which {_SEEN[point]}, {sampler}.",
        curve,
        _expected(case, sampler),
    )


def _same_integral(curves: Curves) -> Finding:
    """Differences of light and BSDF sampling at the largest N."""
    differences, errors = [], []
    for point, sampler in itertools.product("PQ", _SAMPLERS):
        pair = [curves[(point, s), sampler].isel(n=-1) for s in _NAMES]
        differences.append(float(pair[0]["mean"] - pair[1]["mean"]))
        errors.append(float(math.hypot(*(float(c["mean_se"]) for c in pair))))
    return largest_distance(
        f"Light and BSDF sampling estimate the same radiance, N = {_COUNTS[-1]}",
        np.array(differences),
        np.array(errors),
    )


def _caption(curves: Curves) -> str:
    def shown(case: Case, sampler: str = _SAMPLERS[0]) -> str:
        curve = curves[case, sampler]
        return rate(float(curve["rate"]), *map(float, curve["rate_ci"].values))

    return (
        "What the random numbers see is f/p on the unit square. Under light sampling P, which sees all of the light, has "
        f"a smooth one: rate {shown(('P', 'light'))} with jittered points. Under BSDF sampling the light's outline is an "
        f"edge in it: {shown(('P', 'bsdf'))}. At Q the occluder cuts both: {shown(('Q', 'light'))} and "
        f"{shown(('Q', 'bsdf'))}. A random shift makes an edge of the border of the square, and takes light sampling "
        f"at P to {shown(('P', 'light'), _SAMPLERS[1])}."
    )


def _scene(quick: bool, seed: int) -> Picture:
    from mcspectra.rendering.files import encode_srgb
    from mcspectra.rendering.image import render
    from mcspectra.rendering.scenes import named_pixels

    spp, width = (16, 192) if quick else (64, 384)
    scene = f"{_SCENE}(width={width}, height={width * 2 // 3})"
    image = render(scene, "light", "sobol | owen | decorrelate", spp, rng=seed)["image"].values
    figure = new_figure(WIDE, 5.0)
    axes = figure.subplots()
    axes.imshow(encode_srgb(image))
    axes.set_axis_off()
    for name, (x, y) in named_pixels(scene).items():
        _mark(axes, name, x, y)
    return Picture(
        kind="figure1-scene",
        caption=f"A square light over a floor, and an occluder; light sampling, {spp} samples a pixel. P sees all of the "
        "light, Q a part of it. The arrangement is that of the paper's Figure 1; its numbers are ours.",
        alt="A floor lit by a square light from above, with the shadow of a square occluder at the right; P is marked in "
        "the light at the left, Q at the border of the shadow.",
        figure=figure,
    )


def _mark(axes: Axes, name: str, x: int, y: int) -> None:
    axes.plot(x, y, "o", ms=7, mfc=ACCENT, mec=PAPER)
    box = {"boxstyle": "round,pad=0.2", "fc": PAPER, "ec": "none"}
    axes.annotate(name, (x, y), (9, 9), textcoords="offset points", fontsize=11, bbox=box)


def _squares(integrands: dict[Case, Any]) -> Picture:
    figure = new_figure(WIDE, 2.8)
    panels = figure.subplots(1, 4)
    for axes, ((point, strategy), g) in zip(panels, integrands.items(), strict=True):
        drawn = draw_primary(axes, g, f"{point}, {_NAMES[strategy]}")
        outer_labels(axes)
        bar = figure.colorbar(drawn, ax=axes, orientation="horizontal", pad=0.02, aspect=14)
        quiet_colorbar(bar, "f/p (over its mean)")
    return Picture(
        kind="direct-illumination-integrands",
        caption="f/p over the random numbers u in [0,1)², divided by its mean.",
        alt="Four squares. P by light sampling: a smooth gradient. P by BSDF sampling: a bright patch with a sharp "
        "outline on black. Q by light sampling: a gradient with a black part cut off; Q by BSDF sampling: a patch of "
        "which a part is cut off.",
        figure=figure,
    )


def _convergence(curves: Curves) -> Picture:
    figure = new_figure(WIDE, 5.6)
    grid = figure.subplots(2, 2, sharex=True)
    for axes, case in zip(grid.ravel(), _CASES, strict=True):
        shown = {sampler: curves[case, sampler] for sampler in _SAMPLERS}
        theory = {sampler: _expected(case, sampler) for sampler in _SAMPLERS}
        pixel_panel(axes, shown, theory, f"{case[0]}, {_NAMES[case[1]]}")
    for axes in grid[0]:
        axes.set_xlabel("")
    for axes in grid[:, 0]:
        axes.set_ylabel("variance / mean²")
    legend_below(figure, grid[0, 0])
    return Picture(
        kind="direct-illumination",
        caption="Variance over the squared mean, with 95 % intervals, of jittered points, shifted or not; dashed, the "
        "rates of theory.",
        alt="Four logarithmic plots against N. P by light sampling: slope −2 without and −1.5 with a shift. In the three "
        "others both curves have the slope −1.5.",
        figure=figure,
    )
