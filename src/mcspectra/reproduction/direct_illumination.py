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
from mcspectra.plots.style import ACCENT, GRAY, INK, PALETTE
from mcspectra.rendering.files import encode_srgb
from mcspectra.reproduction.claims import Claim, Exhibit, largest_distance, pixel_rate, rate_text
from mcspectra.reproduction.panels import plot_of, primary_panel, variance_panel

__all__ = ["exhibit"]

_SCENE = "figure1"
_CASES = tuple(itertools.product("PQ", ("light", "bsdf")))
SAMPLERS = ("jittered", "jittered | shift")
_COUNTS = tuple(side**2 for side in (8, 11, 16, 23, 32, 45, 64))
_NAMES = {"light": "light sampling", "bsdf": "BSDF sampling"}
_SHORT = {"light": "light", "bsdf": "BSDF"}
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
            plot_of(
                "direct-illumination-sketch",
                _sketch(seed),
                variance_panel(
                    {f"{p}, {_SHORT[s]}": curves[(p, s), "jittered"] for p, s in _CASES},
                    rates={f"{p}, {_SHORT[s]}": _expected((p, s), "jittered") for p, s in _CASES},
                    relative=True,
                    title="variance, jittered points",
                    x="number of samples N",
                    beside=0.7,
                ),
                *(primary_panel(f["P", s], f"f/p at P, {_NAMES[s]}") for s in _NAMES),
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
    """Return a sketch of sensor, light, lobe, occluder and samples at the points P and Q."""
    p, q = np.array([0.42, 0.0]), np.array([1.02, 0.0])
    eye, light = np.array([0.05, 0.62]), (0.62, 0.88, 0.85)
    shade = (0.86, 1.02, 0.42)  # ends and height of the occluder
    u = mcs.sampler("jittered", 1).draw(6, rng=seed)[0, :, 0]
    lobe_axis, half = math.atan2(1.0, 0.75), 0.62
    turns = np.linspace(-0.999, 0.999, 80)
    size = 0.42 * np.cos(np.pi / 2 * turns) ** 0.7
    angles = lobe_axis + half * turns
    edge = p + size[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)

    on_light = np.stack([light[0] + u * (light[1] - light[0]), np.full(6, light[2])], axis=-1)
    slopes = 1 / np.tan(lobe_axis + half * (2 * u - 1) * 0.9)
    far = np.stack([p[0] + light[2] * slopes, np.full(6, light[2])], axis=-1)
    hits = (far[:, 0] >= light[0]) & (far[:, 0] <= light[1])
    # Rays end at the occluder if they cross it
    at = shade[2] / light[2]
    crossing = {"P": p + at * (far - p), "Q": q + at * (on_light - q)}
    blocked = {k: (c[:, 0] >= shade[0]) & (c[:, 0] <= shade[1]) for k, c in crossing.items()}
    far = np.where(blocked["P"][:, None], crossing["P"], far)
    from_q = np.where(blocked["Q"][:, None], crossing["Q"], on_light)

    def rays(place: Array, ends: Array) -> Array:
        return np.stack([np.broadcast_to(place, ends.shape), ends], axis=1)

    def level(low: float, high: float, y: float) -> Array:
        return np.array([[[low, y], [high, y]]])

    box = eye + np.array([[-0.04, 0.05], [0.05, 0.05], [0.05, -0.05], [-0.04, -0.05]])
    return Panel(
        marks=(
            Line(x=edge[:, 0], y=edge[:, 1], low=0 * turns, high=edge[:, 1], color="#F5E3B8",
                 width=0.0),
            Line(x=edge[:, 0], y=edge[:, 1], color=PALETTE[4], width=1.6),
            Segments(ends=level(0.0, 1.12, 0.0), color=INK, width=2.5),
            Segments(ends=np.stack([box, np.roll(box, -1, axis=0)], axis=1), color=INK),
            Segments(ends=np.array([[eye, p]]), color=GRAY, width=1.4),
            Segments(ends=rays(p, far[~hits]), color=GRAY, width=0.8),
            Segments(ends=rays(q, from_q[blocked["Q"]]), color=GRAY, width=0.8),
            Segments(ends=rays(p, on_light), color=PALETTE[0]),
            Segments(ends=rays(p, far[hits]), color=PALETTE[1], width=2.0),
            Segments(ends=rays(q, from_q[~blocked["Q"]]), color=PALETTE[2]),
            Segments(ends=level(light[0], light[1], light[2]), color=PALETTE[4], width=5.0),
            Segments(ends=level(*shade), color=INK, width=4.0),
            Dots(x=np.array([p[0], q[0]]), y=np.zeros(2), color=INK, size=8.0),
            TextMark(x=0.0, y=0.74, text="sensor"),
            TextMark(x=0.75, y=0.93, text="light", side="middle"),
            TextMark(x=1.03, y=0.52, text="occluder", side="middle"),
            TextMark(x=p[0], y=-0.1, text="P", side="middle"),
            TextMark(x=q[0], y=-0.1, text="Q", side="middle"),
            TextMark(x=0.2, y=0.28, text="lobe →", side="middle"),
        ),
        x=Axis(low=-0.02, high=1.22, ticks={}),
        y=Axis(low=-0.16, high=1.0, ticks={}),
        title="samples at P and Q",
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
