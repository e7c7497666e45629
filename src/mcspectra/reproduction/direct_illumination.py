"""Direct illumination of two points by light and by BSDF sampling: the paper's Figure 1."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.plots.description import Dots, Panel, Pixels, Plot, TextMark
from mcspectra.plots.style import ACCENT
from mcspectra.rendering.files import encode_srgb
from mcspectra.reproduction.claims import Claim, Exhibit, largest_distance, pixel_rate, rate_text
from mcspectra.reproduction.panels import plot_of, primary_panel, variance_panel

__all__ = ["exhibit"]

_SCENE = "figure1"
_CASES = tuple(itertools.product("PQ", ("light", "bsdf")))
SAMPLERS = ("jittered", "jittered | shift")
_COUNTS = tuple(side**2 for side in (8, 11, 16, 23, 32, 45, 64))
_NAMES = {"light": "light sampling", "bsdf": "BSDF sampling"}
_SEEN = {"P": "all of the light is visible", "Q": "a part of the light is visible"}

Case: TypeAlias = tuple[str, str]


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Draw the integrands of two pixels on the unit square, and measure their eight rates."""
    f, spp = integrands(), 16 if quick else 64
    options: dict[str, Any] = {"realizations": 80 if quick else 800, "rng": seed}
    found = mcs.convergence(list(f.values()), list(SAMPLERS), _COUNTS, **options)
    curves = {
        (case, sampler): found.isel(estimator=i, sampler=j)
        for (i, case), (j, sampler) in itertools.product(enumerate(_CASES), enumerate(SAMPLERS))
    }
    rates = {
        f"{point.lower()}_{strategy}": rate_text(curves[(point, strategy), "jittered"])
        for point, strategy in _CASES
    }
    return Exhibit(
        numbers={
            **rates,
            "shifted": rate_text(curves[("P", "light"), "jittered | shift"]),
            "spp": spp,
        },
        plots=(
            _scene(spp, seed),
            plot_of(
                "direct-illumination-integrands",
                *(primary_panel(g, f"{p}, {_NAMES[s]}") for (p, s), g in f.items()),
            ),
            plot_of(
                "direct-illumination",
                *(
                    variance_panel(
                        {sampler: curves[case, sampler] for sampler in SAMPLERS},
                        rates={sampler: _expected(case, sampler) for sampler in SAMPLERS},
                        relative=True,
                        title=f"{case[0]}, {_NAMES[case[1]]}",
                        x="number of samples N",
                    )
                    for case in _CASES
                ),
            ),
        ),
        claims=(
            *(
                pixel_rate(
                    f"Rate of {_NAMES[strategy]} at {point}, where {_SEEN[point]}, {sampler}.",
                    curve,
                    _expected((point, strategy), sampler),
                )
                for ((point, strategy), sampler), curve in curves.items()
            ),
            _same_integral(curves),
        ),
    )


def integrands() -> dict[Case, Any]:
    """Return f/p of each pixel and strategy as a function of the random numbers."""
    pixels = mcs.rendering.named_pixels(_SCENE)
    return {(p, s): mcs.rendering.pixel_strategies(_SCENE, *pixels[p])[s] for p, s in _CASES}


def _expected(case: Case, sampler: str) -> float:
    """Return the expected rate: −2 only if the light is fully visible and points do not wrap."""
    return -2.0 if (case, sampler) == (("P", "light"), "jittered") else -1.5


def _same_integral(curves: Mapping[tuple[Case, str], xr.Dataset]) -> Claim:
    """Compare the means of light and BSDF sampling at the largest N."""
    differences, errors = [], []
    for point, sampler in itertools.product("PQ", SAMPLERS):
        light, bsdf = (curves[(point, s), sampler].isel(n=-1) for s in _NAMES)
        differences.append(float(light["mean"] - bsdf["mean"]))
        errors.append(math.hypot(float(light["mean_se"]), float(bsdf["mean_se"])))
    text = f"Light and BSDF sampling estimate the same radiance, N = {_COUNTS[-1]}"
    return largest_distance(text, np.array(differences), np.array(errors))


def _scene(spp: int, seed: int) -> Plot:
    width = 48 * math.isqrt(spp)
    height = width * 2 // 3
    scene = f"{_SCENE}(width={width}, height={height})"
    sampler = "sobol | owen | decorrelate"
    image = mcs.rendering.render(scene, "light", sampler, spp, rng=seed)["image"].values
    x, y = np.array(list(mcs.rendering.named_pixels(scene).values()), float).T + 0.5
    return Plot(
        kind="figure1-scene",
        panels=(
            Panel(
                marks=(
                    Pixels(rgb=np.round(255 * encode_srgb(image)).astype(np.uint8)),
                    Dots(x=x, y=height - y, color="#FFFFFF", size=8.0),
                    Dots(x=x, y=height - y, color=ACCENT, size=6.0),
                    *(
                        TextMark(x=px, y=height - py, text=name)
                        for name, px, py in zip(
                            mcs.rendering.named_pixels(scene), x, y, strict=True
                        )
                    ),
                )
            ),
        ),
        height=2 / 3,
    )
