"""Homogenization (Cranley-Patterson rotation): shift all points and wrap them around the torus."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, Dots, Panel, Plot, Segments
from mcspectra.plots.style import ACCENT, FAINT, GRAY, INK, PALETTE
from mcspectra.plots.text import number
from mcspectra.report.page import Slider
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, mean_and_error, normal_limit
from mcspectra.reproduction.panels import plot_of

__all__ = ["exhibit"]

N = 64
SAMPLERS = ("jittered", "latin-hypercube", "poisson-disk", "sobol | owen")
# Pairs of frequencies m, l at which the Fourier coefficients of jittered points are correlated.
# The components of m − l are multiples of 8, the number of strata per axis for 64 points.
# For (1, 0) and (0, 1), m − l is not a multiple of 8: these two coefficients are uncorrelated.
PAIRS = (
    ((3, 0), (-5, 0)),
    ((0, 3), (0, -5)),
    ((3, 1), (-5, 1)),
    ((1, 1), (1, -7)),
    ((2, 5), (-6, -3)),
    ((1, 0), (0, 1)),
)
_PAIR = "m = (3, 0), l = (−5, 0)"


@final
@dataclass(frozen=True)
class Coefficients:
    """Coefficients S_m and S_l of R realizations at all pairs of frequencies, (R, pairs, 2)."""

    values: Array

    @property
    def products(self) -> Array:
        """Products (S_m − mean) conj(S_l − mean), (R, pairs), whose mean is the covariance."""
        away = self.values - self.values.mean(axis=0)
        return np.asarray(away[..., 0] * away[..., 1].conj())

    @property
    def covariance(self) -> Array:
        """Covariance of S_m and S_l for each pair of frequencies."""
        return np.asarray(self.products.sum(axis=0) / (len(self.values) - 1))

    def farthest(self) -> tuple[float, float]:
        """Return the largest covariance in standard errors, and a limit that tests whether it is 0.

        If all true covariances are 0, and errors are normal, the maximum rarely exceeds the limit.
        """
        products, value = self.products, self.covariance
        parts = [
            np.abs(value.real) / mean_and_error(products.real)[1],
            np.abs(value.imag) / mean_and_error(products.imag)[1],
        ]
        return float(np.max(parts)), normal_limit(2 * value.size)


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Show how points are shifted, and how the shift changes coefficients of several samplers."""
    realizations = 2000 if quick else 20_000
    pairs = {name: before_and_after(name, realizations, seed) for name in SAMPLERS}
    before, after = pairs["jittered"]
    powers = [[np.abs(each.values) ** 2 for each in pair] for pair in pairs.values()]
    c0, c1 = (number(N * float(each.covariance[0].real)) for each in (before, after))

    # On the torus, all points must have moved by the same shift as the first
    plain, moved = _drawn("jittered", 100, seed)
    moves = (moved - plain) % 1.0
    apart = (moves - moves[:, :1] + 0.5) % 1.0 - 0.5

    # Multiply S_m by the phase of the shift, and compare
    plain, moved = _drawn("jittered", 1, seed)
    s0, s1 = _sums(np.concatenate([plain, moved]), np.array([3, -2]))
    turned = s0 * np.exp(-2j * np.pi * (((moved - plain) % 1.0)[0, 0] @ np.array([3, -2])))
    panels = []
    for each, title in ((before, "jittered"), (after, "jittered | shift")):
        m, l = (N**0.5 * each.values[:500, 0, k].real for k in (0, 1))
        x, y = Axis(label="√N · Re S_m"), Axis(label="√N · Re S_l")
        dots = Dots(x=m, y=l, color=PALETTE[0], size=1.8)
        panels.append(Panel(marks=(dots,), x=x, y=y, title=title, grid=True))
    se = mean_and_error(before.products.real)[1][0]
    steps = {f"{t:g}": _steps(seed, t) for t in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)}
    return Exhibit(
        numbers={"N": N, "pair": _PAIR, "c0": c0, "c1": c1},
        plots=(
            steps["0.6"],
            plot_of("homogenisation-correlation", *panels),
        ),
        sliders={"homogenisation-steps": Slider("shift Δ = t · (0.7, 0.5), t =", steps, "0.6")},
        claims=(
            Claim(
                "All points of a realization are shifted by the same vector on the torus: largest "
                "deviation.",
                float(np.abs(apart).max()),
                at_most=1e-15,
            ),
            Claim(
                "A shift does not change |S_m|² at integer m, in every realization of "
                f"{', '.join(pairs)}: largest difference.",
                max(float(np.abs(b - a).max()) for b, a in powers),
                at_most=1e-14,
                note="Limit: rounding of phases up to 2π·8.",
            ),
            Claim(
                "The shift by Δ multiplies S_m by exp(−2πi m·Δ), at m = (3, −2).",
                float(abs(s1 - turned)),
                at_most=1e-13,
            ),
            Claim(
                "Before the shift, coefficients of jittered points are correlated if m − l is the "
                f"frequency of the strata: N·Cov(S_m, S_l) at {_PAIR} agrees with the closed form.",
                Measured.normal(before.covariance[0].real, se) / (1 / N),
                expected=N
                * float(mcs.spectra.closed_form_covariance("jittered", N, *PAIRS[0]).real),
                digits=4,
            ),
            *(
                Claim(
                    f"After a shift, coefficients of {name} points at different frequencies are "
                    f"not correlated: largest |Cov(S_m, S_l)| of {len(PAIRS)} pairs, in standard "
                    "errors.",
                    distance,
                    at_most=limit,
                    shown=f"≤ {limit:.1f}",
                    note="Limit: largest of the same number of normal errors (real and imaginary "
                    "parts) at the level of the gallery.",
                )
                for name, (_, shifted) in pairs.items()
                for distance, limit in [shifted.farthest()]
            ),
            Claim(
                "A shift makes deterministic points random: ⟨S_m⟩ of a regular grid at its own "
                "frequency m = (8, 0) is 1 or −1 before the shift and 0 after it (real part).",
                grid_mean("regular | shift", realizations, seed),
                expected=0.0,
            ),
        ),
    )


def before_and_after(name: str, realizations: int, seed: int) -> tuple[Coefficients, Coefficients]:
    """Return the coefficients of a sampler's points, and of the same points shifted."""
    plain, shifted = (
        Coefficients(np.moveaxis(_sums(x, np.array(PAIRS)), -1, 0))
        for x in _drawn(name, realizations, seed)
    )
    return plain, shifted


def _drawn(name: str, realizations: int, seed: int) -> tuple[Array, Array]:
    """Return points before and after a shift, (realizations, n, 2), from equal random numbers."""
    plain, shifted = (
        mcs.sampler(spec, 2).draw(N, realizations=realizations, rng=seed)
        for spec in (name, f"{name} | shift")
    )
    return plain, shifted


def _sums(x: Array, m: Array) -> Array:
    """Return S_m, (..., R), for points (R, n, 2) and frequencies m, (..., 2)."""
    found = [np.exp(-2j * np.pi * (x @ each)).mean(axis=1) for each in m.reshape(-1, 2)]
    return np.stack(found).reshape(*m.shape[:-1], len(x))


def grid_mean(name: str, realizations: int, seed: int) -> Measured:
    """Return the mean of Re S_m of 8 × 8 points at m = (8, 0)."""
    x = mcs.sampler(name, 2).draw(N, realizations=realizations, rng=seed)
    return Measured.mean(_sums(x, np.array((8, 0))).real)


def _steps(seed: int, share: float) -> Plot:
    x = mcs.sampler("jittered", 2).draw(16, rng=seed)[0]
    move = share * np.array([0.7, 0.5])
    outside = (x + move >= 1.0).any(axis=1)
    panels = []
    for at, (dx, dy), title in (
        (x, np.zeros(2), "1: jittered points"),
        (x + move, move, "2: shifted by Δ"),
        ((x + move) % 1.0, move, "3: wrapped around"),
    ):
        # Draw borders of strata as pairs (start, end). Wrapped borders stay in the unit square
        wrapped = bool((at < 1.0).all())
        lines = []
        for k in range(5):
            u, v = ((d + k / 4) % 1.0 if wrapped else d + k / 4 for d in (dx, dy))
            left, low = (0.0, 0.0) if wrapped else (dx, dy)
            lines += [[(u, low), (u, low + 1)], [(left, v), (left + 1, v)]]
        square = np.array(
            [[(0, 0), (1, 0)], [(1, 0), (1, 1)], [(1, 1), (0, 1)], [(0, 1), (0, 0)]], float
        )
        paths = np.stack([x, x + move], axis=1) if title.startswith("2") else np.zeros((0, 2, 2))
        axes = [
            Axis(label=label, low=-0.04, high=1.74, ticks={0.0: "0", 1.0: "1"})
            for label in ("x₀", "x₁")
        ]
        panels.append(
            Panel(
                marks=(
                    Segments(ends=np.array(lines), color=FAINT, width=0.8),
                    Segments(ends=square, color=INK),
                    Segments(ends=paths, color=GRAY, width=0.5),
                    Dots(x=at[~outside, 0], y=at[~outside, 1], color=PALETTE[0]),
                    Dots(x=at[outside, 0], y=at[outside, 1], color=ACCENT),
                ),
                x=axes[0],
                y=axes[1],
                title=title,
                square=True,
            )
        )
    return plot_of("homogenisation-steps", *panels)
