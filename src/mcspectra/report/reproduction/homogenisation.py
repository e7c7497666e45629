"""Homogenisation, or Cranley-Patterson rotation: shift all points, wrap them around the torus."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._homogenised_coefficients import (
    PAIRS,
    SAMPLERS,
    Coefficients,
    before_and_after,
    farthest_correlation,
    mean_at,
)
from mcspectra.report.reproduction.base import Exhibit, Finding, comparison, identity
from mcspectra.report.style import (
    ACCENT,
    FAINT,
    GRAY,
    INK,
    PALETTE,
    WIDE,
    entitle,
    new_figure,
    quiet,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["exhibit"]

_N = 64


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Show the steps of a shift, and what it does to coefficients of several samplers."""
    realizations = 2000 if quick else 20_000
    pairs = {name: before_and_after(name, _N, realizations, seed) for name in SAMPLERS}
    before, after = pairs["jittered"]
    findings = (
        _one_translation(seed),
        _same_power(pairs),
        _phase(seed),
        _correlated_before(before),
        *(_correlated_after(name, pair[1]) for name, pair in pairs.items()),
        _grid_mean(seed, realizations),
    )
    return Exhibit(
        name="homogenisation",
        title="Homogenisation by a shift and toroidal wrapping",
        slide="Homogenization or Cranley-Patterson rotation. Stationarity can be imposed using homogenization or "
        "Cranley-Patterson rotation for all samplers (Pilleboue et al. 2015).",
        formula=r"x_k \mapsto (x_k + \Delta) \bmod 1, \qquad S_m \mapsto e^{-2\pi i\, m \cdot \Delta} \, S_m",
        caption=_caption(before, after),
        pictures=(_steps(seed), _spread(before, after)),
        findings=findings,
    )


def _caption(before: Coefficients, after: Coefficients) -> str:
    c0, c1 = (float(_correlation(c).real) for c in (before, after))
    return (
        f"One random vector Δ moves all points; what leaves the domain comes in again at the other side. The power "
        f"|S_m|² of every realisation stays, its phase becomes random. Of {_N} jittered points in two dims, "
        f"N·Cov(S_m, S_l) at {_pair_text()} is {number(_N * c0)} before the shift and {number(_N * c1)} after it: "
        "coefficients of different frequencies are no longer correlated, for any sampler, which makes the points "
        "stationary."
    )


def _pair_text() -> str:
    m, l = PAIRS[0]
    return f"m = {_vector(m)}, l = {_vector(l)}"


def _vector(m: tuple[int, int]) -> str:
    return f"({m[0]}, {m[1]})".replace("-", "−")


def _correlation(c: Coefficients) -> complex:
    return complex(c.covariance()[0])


def _drawn(seed: int, realizations: int = 1) -> tuple[Array, Array]:
    """Points before and after the shift, (realizations, n, 2), of the same random numbers."""
    from mcspectra.samplers.registry import sampler

    plain, shifted = sampler("jittered", 2), sampler("jittered | shift", 2)
    return (
        plain.draw(_N, realizations=realizations, rng=seed),
        shifted.draw(_N, realizations=realizations, rng=seed),
    )


def _moves(seed: int, realizations: int = 1) -> Array:
    before, after = _drawn(seed, realizations)
    return np.asarray((after - before) % 1.0)


def _one_translation(seed: int) -> Finding:
    """Differences on the torus from that of the first point."""
    moves = _moves(seed, 100)
    apart = (moves - moves[:, :1] + 0.5) % 1.0 - 0.5
    return identity(
        "All points of a realisation are moved by the same vector on the torus: largest deviation.",
        error=float(np.abs(apart).max()),
        at_most=1e-15,
    )


def _same_power(pairs: dict[str, tuple[Coefficients, Coefficients]]) -> Finding:
    error = max(float(np.abs(b.power() - a.power()).max()) for b, a in pairs.values())
    return identity(
        f"A shift leaves |S_m|² at integer m as it is, in every realisation of {', '.join(pairs)}: largest difference.",
        error=error,
        at_most=1e-14,
        note="Rounding of phases of 2π·8 at most.",
    )


def _phase(seed: int) -> Finding:
    before, after = _drawn(seed)
    m = np.array([3, -2])
    s0, s1 = (np.exp(-2j * np.pi * (x[0] @ m)).mean() for x in (before, after))
    turned = s0 * np.exp(-2j * np.pi * (_moves(seed)[0, 0] @ m))
    return identity(
        "The shift by Δ multiplies S_m by exp(−2πi m·Δ), at m = (3, −2).",
        error=float(abs(s1 - turned)),
        at_most=1e-13,
    )


def _correlated_before(before: Coefficients) -> Finding:
    from mcspectra.spectra.closed_forms import closed_form_covariance

    m, l = PAIRS[0]
    expected = _N * float(closed_form_covariance("jittered", _N, m, l).real)
    value, interval = before.real_part(0)
    return comparison(
        f"Before the shift, coefficients of jittered points one stratum's frequency apart are correlated: N·Cov(S_m, "
        f"S_l) at {_pair_text()} is its closed form.",
        expected=expected,
        measured=_N * value,
        interval=(_N * interval[0], _N * interval[1]),
        text=number(expected, 4),
    )


def _correlated_after(name: str, after: Coefficients) -> Finding:
    distance, limit = farthest_correlation(after)
    return Finding(
        statement=f"After a shift, coefficients of {name} points at different frequencies are not correlated: largest "
        f"|Cov(S_m, S_l)| of {len(PAIRS)} pairs, in standard errors.",
        expected=f"≤ {limit:.1f}",
        measured=distance,
        interval=None,
        agrees=distance <= limit,
        note="The limit is that of as many normal errors, real and imaginary, at the gallery's level.",
    )


def _grid_mean(seed: int, realizations: int) -> Finding:
    """Of a regular grid of 8 × 8, at m = (8, 0): |⟨S⟩| is 1 before the shift."""
    value, interval = mean_at("regular | shift", _N, (8, 0), realizations, seed)
    return comparison(
        "Points that are not random at all become so: ⟨S_m⟩ of a regular grid at its own frequency m = (8, 0), 1 or "
        "−1 before the shift, is 0 after it (real part).",
        expected=0.0,
        measured=value,
        interval=interval,
    )


def _steps(seed: int) -> Picture:
    n = 16
    from mcspectra.samplers.registry import sampler

    x = sampler("jittered", 2).draw(n, rng=seed)[0]
    move = np.array([0.42, 0.3])
    outside = (x + move >= 1.0).any(axis=1)
    figure = new_figure(WIDE, 2.9)
    panels = figure.subplots(1, 3)
    _draw_step(panels[0], x, outside, np.zeros(2), "1: jittered points")
    _draw_step(panels[1], x + move, outside, move, "2: shifted by Δ")
    for start, end in zip(x, x + move, strict=True):
        panels[1].plot(*np.stack([start, end]).T, color=GRAY, lw=0.5, zorder=1)
    _draw_step(panels[2], (x + move) % 1.0, outside, move, "3: wrapped around")
    return Picture(
        kind="homogenisation-steps",
        caption=f"{n} jittered points with their strata; shifted by Δ = (0.42, 0.30), which moves the strata too; "
        "those outside the domain (orange) wrapped around. Strata now are cut by the border of the domain.",
        alt="Three squares. Left, one point in each of 16 strata; middle, points and strata moved up and to the "
        "right, beyond the square; right, those beyond have come in again at the left and below.",
        figure=figure,
    )


def _draw_step(axes: Axes, x: Array, outside: Array, move: Array, title: str) -> None:
    from matplotlib.patches import Rectangle

    quiet(axes)
    wrapped = bool((x < 1.0).all())
    places = [[(v + k / 4) % 1.0 if wrapped else v + k / 4 for k in range(5)] for v in move]
    spans = [(0.0, 1.0) if wrapped else (v, v + 1.0) for v in move]
    axes.vlines(places[0], *spans[1], color=FAINT, lw=0.8)
    axes.hlines(places[1], *spans[0], color=FAINT, lw=0.8)
    axes.add_patch(Rectangle((0, 0), 1, 1, fill=False, ec=INK, lw=1.2))
    colors = np.where(outside, ACCENT, PALETTE[0])
    axes.scatter(x[:, 0], x[:, 1], s=14, c=colors, zorder=3)
    axes.set(xlim=(-0.04, 1.46), ylim=(-0.04, 1.46), aspect="equal", xticks=[0, 1], yticks=[0, 1])
    axes.set(xlabel="x₀", ylabel="x₁")
    entitle(axes, title)


def _spread(before: Coefficients, after: Coefficients) -> Picture:
    figure = new_figure(WIDE, 3.0)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, c, title in zip(
        panels, (before, after), ("jittered", "jittered | shift"), strict=True
    ):
        _draw_pairs(axes, c, title)
    panels[0].set_ylabel("√N · Re S_l")
    return Picture(
        kind="homogenisation-correlation",
        caption=f"Re S_l against Re S_m in 500 realisations, {_pair_text()}: related before the shift, not after it.",
        alt="Two clouds of dots. The left one is elongated along a diagonal, the right one is round.",
        figure=figure,
    )


def _draw_pairs(axes: Axes, c: Coefficients, title: str) -> None:
    quiet(axes, grid=True)
    m, l = (_N**0.5 * part.real[:500] for part in c.of_pair(0))
    axes.plot(m, l, ".", ms=3, color=PALETTE[0], alpha=0.6)
    axes.set_xlabel("√N · Re S_m")
    entitle(axes, title)
