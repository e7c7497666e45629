"""Direct illumination of two points by light and BSDF sampling: Figure 1 of the paper."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, Dots, Line, Panel, Pixels, Plot, Segments, TextMark
from mcspectra.plots.style import ACCENT, FAINT, GRAY, INK, PALETTE
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
    """Draw the integrands of two pixels on the unit square, and measure eight rates."""
    f, spp = integrands(), 16 if quick else 64
    options: dict[str, Any] = {"realizations": 80 if quick else 800, "rng": seed}
    found = mcs.convergence(list(f.values()), list(SAMPLERS), _COUNTS, **options)
    curves = {
        (case, sampler): found.isel(estimator=i, sampler=j)
        for (i, case), (j, sampler) in itertools.product(enumerate(_CASES), enumerate(SAMPLERS))
    }
    shown: dict[str, tuple[Case, str]] = {
        _NAMES["light"]: (("P", "light"), "jittered"),
        _NAMES["bsdf"]: (("P", "bsdf"), "jittered"),
        "light sampling, shifted": (("P", "light"), "jittered | shift"),
    }
    light, bsdf, shifted = (rate_text(curves[key]) for key in shown.values())
    return Exhibit(
        numbers={"light": light, "bsdf": bsdf, "shifted": shifted, "spp": spp},
        plots=(
            plot_of(
                "direct-illumination-sketch",
                _sketch(seed),
                variance_panel(
                    {name: curves[key] for name, key in shown.items()},
                    rates={name: _expected(*key) for name, key in shown.items()},
                    relative=True,
                    title="variance at P",
                    x="number of samples N",
                    beside=0.6,
                ),
            ),
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
    """Return the expected rate: −2 for light sampling at P with jittered points, otherwise −1.5.

    From P, the whole light is visible, so the integrand has no jump inside the unit square.
    Shifted points wrap around the border of the square, which adds a jump.
    """
    return -2.0 if (case, sampler) == (("P", "light"), "jittered") else -1.5


def _same_integral(curves: Mapping[tuple[Case, str], xr.Dataset]) -> Claim:
    """Compare the mean of light sampling with the mean of BSDF sampling, at the largest N."""
    differences, errors = [], []
    for point, sampler in itertools.product("PQ", SAMPLERS):
        light, bsdf = (curves[(point, s), sampler].isel(n=-1) for s in _NAMES)
        differences.append(float(light["mean"] - bsdf["mean"]))
        errors.append(math.hypot(float(light["mean_se"]), float(bsdf["mean_se"])))
    text = f"Light and BSDF sampling estimate the same radiance, N = {_COUNTS[-1]}"
    return largest_distance(text, np.array(differences), np.array(errors))


def _sketch(seed: int) -> Panel:
    """Return a sketch of sensor, light and lobe, with samples of both strategies at the point P."""
    p, eye, light = np.array([0.42, 0.0]), np.array([0.05, 0.62]), (0.62, 0.88, 0.85)
    u = mcs.sampler("jittered", 1).draw(6, rng=seed)[0, :, 0]
    lobe_axis, half = math.atan2(1.0, 0.75), 0.62
    turns = np.linspace(-0.999, 0.999, 80)
    size = 0.36 * np.cos(np.pi / 2 * turns) ** 0.7
    angles = lobe_axis + half * turns
    edge = p + size[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)

    # Rays of BSDF sampling end on the light, or at a fixed distance if they miss it
    on_light = np.stack([light[0] + u * (light[1] - light[0]), np.full(6, light[2])], axis=-1)
    angles = lobe_axis + half * (2 * u - 1) * 0.9
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    far = p + light[2] / ways[:, 1:] * ways
    hits = (far[:, 0] >= light[0]) & (far[:, 0] <= light[1])
    far = np.where(hits[:, None], far, p + 0.68 * ways)

    def rays(ends: Array) -> Array:
        return np.stack([np.broadcast_to(p, ends.shape), ends], axis=1)

    def level(low: float, high: float, y: float) -> Array:
        return np.array([[[low, y], [high, y]]])

    box = eye + np.array([[-0.04, 0.05], [0.05, 0.05], [0.05, -0.05], [-0.04, -0.05]])
    return Panel(
        marks=(
            Line(x=edge[:, 0], y=edge[:, 1], low=0 * turns, high=edge[:, 1], color=FAINT,
                 width=0.0),
            Line(x=edge[:, 0], y=edge[:, 1], color=GRAY, width=1.6),
            Segments(ends=level(0.0, 1.12, 0.0), color=INK, width=2.5),
            Segments(ends=np.stack([box, np.roll(box, -1, axis=0)], axis=1), color=INK),
            Segments(ends=np.array([[eye, p]]), color=GRAY, width=1.4),
            Segments(ends=rays(on_light), color=PALETTE[0], width=1.6),
            Segments(ends=rays(far[~hits]), color=PALETTE[1], width=1.0),
            Segments(ends=rays(far[hits]), color=PALETTE[1], width=2.4),
            Segments(ends=level(light[0], light[1], light[2]), color=PALETTE[4], width=6.0),
            Dots(x=p[:1], y=p[1:], color=INK, size=9.0),
            TextMark(x=0.05, y=0.72, text="sensor", side="middle"),
            TextMark(x=0.75, y=0.91, text="light", side="middle"),
            TextMark(x=p[0], y=-0.07, text="P", side="middle"),
            TextMark(x=0.86, y=0.07, text="lobe of the BSDF", side="middle"),
        ),
        x=Axis(low=-0.06, high=1.16, ticks={}),
        y=Axis(low=-0.13, high=0.98, ticks={}),
        title="samples at P (sketch)",
        framed=True,
    )  # fmt: skip


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
