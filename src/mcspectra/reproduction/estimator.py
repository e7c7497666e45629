"""The estimator I_N and its sampling function S(x): random, jittered and Poisson-disk points."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import (
    Axis,
    Dots,
    Line,
    Mark,
    Panel,
    Plot,
    ReferenceLine,
    Segments,
    TextMark,
)
from mcspectra.plots.scales import name_axis, unit_axis, unit_panel
from mcspectra.plots.style import INK, PALETTE, sampler_styles
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, about
from mcspectra.reproduction.panels import plot_of

__all__ = ["exhibit"]

SAMPLERS = ("random", "jittered", "poisson-disk")
BELL = "gaussian(center=0.4, width=0.2)"
DENSITY = "linear(slope=-1.2)"
SQUARE = "christensen-gaussian"
N = 64
_SHOWN = 16  # number of points in the figures of one dim
_INTEGRAL = PALETTE[3]  # color of the integral
_SETS = 60  # number of sets in the figure of estimates


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Show the estimator as a sum of weighted peaks, and compare its mean with the integral."""
    realizations = 1000 if quick else 10_000
    curves = mcs.convergence(SQUARE, list(SAMPLERS), [N], realizations=realizations, rng=seed)
    one = {name: curves.sel(sampler=name).isel(n=0) for name in SAMPLERS}
    variances = ", ".join(f"{number(float(d['variance']))} ({name})" for name, d in one.items())
    weighted = mcs.convergence(
        mcs.Estimator(mcs.integrand(BELL, 1), DENSITY),
        list(SAMPLERS),
        [_SHOWN],
        realizations=realizations,
        rng=seed,
    )
    mean_of = {
        name: Measured.normal(float(data["mean"]), float(data["mean_se"]))
        for name in SAMPLERS
        for data in [weighted.sel(sampler=name).isel(n=0)]
    }
    # Sum conj(f_m) S_m for an integrand that has only the frequencies m = ±3
    at = _warped("jittered", N, seed, 1)[0]
    direct = float((np.cos(6 * np.pi * at) / pdf(at)).mean())
    sums = {m: (np.exp(-2j * np.pi * m * at) / pdf(at)).mean() for m in (-3, 3)}

    panels = []
    for name, style in sampler_styles(SAMPLERS).items():
        x, y = mcs.sampler(name, 2).draw(256, rng=seed)[0].T
        panels.append(unit_panel([Dots(x=x, y=y, color=style.color, size=2.0)], name))
    return Exhibit(
        numbers={
            "area": number(bell_area(), 4),
            "N": N,
            "shown": _SHOWN,
            "sets": f"{realizations:,}",
            "variances": variances,
        },
        plots=(
            _area(),
            _values(seed, mean_of),
            plot_of("points", *panels),
            _combs(seed),
        ),
        claims=(
            Claim(
                "The integral of the bell agrees with Gauss-Legendre quadrature: difference.",
                bell_area() - float(np.squeeze(mcs.integrand(BELL, 1).integral)),
                at_most=1e-12,
            ),
            *about(
                "estimator",
                *(
                    Claim(
                        f"The mean of I_N is the integral of the bell, {_SHOWN} {name} points of "
                        "density p.",
                        mean,
                        expected=bell_area(),
                        digits=7,
                    )
                    for name, mean in mean_of.items()
                ),
                Claim(
                    "The peaks of S, with weights 1/(N p), sum to 1 on average, for p = "
                    f"{DENSITY}.",
                    Measured.mean(
                        (1.0 / pdf(_warped("random", N, seed, realizations))).mean(axis=1)
                    ),
                    expected=1.0,
                    shown="1",
                ),
                Claim(
                    "I_N is the sum of conj(f_m) S_m over frequencies, for f = cos(6πx) under "
                    "importance sampling.",
                    float(abs(direct - complex(0.5 * sums[3] + 0.5 * sums[-3]))),
                    at_most=1e-13,
                ),
            ),
            *about(
                "points",
                *(
                    Claim(
                        f"The variance of I_N with {N} {name} points agrees with quadrature over "
                        "strata.",
                        Measured.of(one[name], "variance", log=True),
                        expected=_exact(name),
                        digits=4,
                    )
                    for name in ("random", "jittered")
                ),
                Claim(
                    "Correlated points reduce the variance: 64 Poisson-disk points against random "
                    "points.",
                    Measured.of(one["poisson-disk"], "variance", log=True),
                    below=_exact("random"),
                ),
            ),
        ),
    )


def _exact(name: str) -> float:
    return float(mcs.exact_variance(SQUARE, name, N))


def _warped(name: str, n: int, seed: int, realizations: int) -> Array:
    """Return points with density p, (realizations, n)."""
    u = mcs.sampler(name, 1).draw(n, realizations=realizations, rng=seed)
    return np.asarray(mcs.density(DENSITY, 1).sample(u)[..., 0])


def pdf(x: Array) -> Array:
    """Return the density of the importance samples."""
    return np.asarray(mcs.density(DENSITY, 1).pdf(x[..., None]))


def bell_area() -> float:
    """Return the integral of the bell by quadrature over 16 equal intervals."""
    node, weight = np.polynomial.legendre.leggauss(12)
    x = (np.arange(16)[:, None] + (node + 1) / 2) / 16
    values = np.asarray(mcs.integrand(BELL, 1)(x[..., None]))
    return float((values @ weight).sum() / 32)


def _area() -> Plot:
    x = np.linspace(0.0, 1.0, 400, endpoint=False)
    f = np.asarray(mcs.integrand(BELL, 1)(x[:, None]))
    marks = (
        Line(x=x, y=f, low=0 * f, high=f, color="#8CC1E0", width=0.0),
        Line(x=x, y=f, color=INK, width=1.8),
        TextMark(x=0.66, y=0.6, text="f(x)"),
        TextMark(x=0.4, y=0.4, text=f"area I = {number(bell_area(), 4)}", side="middle"),
    )
    x_axis = Axis(label="x (domain, 0 to 1)", low=0.0, high=1.0)
    return plot_of(
        "integral", Panel(marks=marks, x=x_axis, y=Axis(label="f(x)", low=0.0, high=1.1))
    )


def _values(seed: int, mean_of: Mapping[str, Measured]) -> Plot:
    """Plot f/p at one set of random points, and estimates from many sets of three samplers.

    The means of the estimates, with their intervals, are `mean_of`.
    """
    f, area = mcs.integrand(BELL, 1), bell_area()
    x = np.linspace(0.0, 1.0, 400, endpoint=False)
    y = np.asarray(f(x[:, None]))
    styles = sampler_styles(SAMPLERS)
    at = _warped("random", _SHOWN, seed, 1)[0]
    value = np.asarray(f(at[:, None])) / pdf(at)
    mean = float(value.mean())
    ends = np.stack([np.stack([at, 0 * value], -1), np.stack([at, value], -1)], 1)
    color = styles["random"].color
    one = Panel(
        marks=(
            Line(x=x, y=y, low=0 * y, high=y, color="#E9E9E9", width=0.0),
            Line(x=x, y=y, color=INK, width=1.4),
            Line(x=x, y=pdf(x), color=INK, dashes="--", width=1.4),
            Segments(ends=ends, color=color, width=1.3),
            Dots(x=at, y=value, color=color, size=5.0),
            ReferenceLine(
                at=mean,
                color=color,
                width=2.2,
                label=f"mean of the {_SHOWN} values f/p: {number(mean)}",
            ),
            ReferenceLine(
                at=area,
                color=_INTEGRAL,
                dashes="--",
                width=2.2,
                label=f"integral I: {number(area)}",
            ),
            TextMark(x=0.2, y=0.75, text="f(x)", side="left"),
            TextMark(x=0.08, y=1.58, text="p(x)"),
        ),
        x=unit_axis("x"),
        y=Axis(
            label="f, p, and f/p (dots)",
            low=0.0,
            high=1.75,
            ticks={0.0: "0", 0.5: "0.5", 1.0: "1", 1.5: "1.5"},
        ),
        title=f"{_SHOWN} random samples",
    )
    marks: list[Mark] = [ReferenceLine(at=area, axis="x", color=_INTEGRAL, dashes="--", width=2.2)]
    height = np.linspace(0.1, -0.34, _SETS)
    for k, (name, style) in enumerate(styles.items()):
        at = _warped(name, _SHOWN, seed + 1, _SETS)
        found = (np.asarray(f(at[..., None])) / pdf(at)).mean(axis=1)
        each = mean_of[name]
        low, high = np.array([each.low]), np.array([each.high])
        marks += [
            Dots(x=found, y=k + height, color=style.color, size=3.0),
            Dots(
                x=np.array([each.value]), y=np.array([k + 0.3]), low=low, high=high, across=True,
                color=INK, marker="D", size=7.0, label="mean of the estimates, with 95 % interval",
            ),
        ]  # fmt: skip
    many = Panel(
        marks=tuple(marks),
        x=Axis(label="estimate from one set"),
        y=name_axis(["random", "jittered", "Poisson disk"]),
        title=f"{_SETS} sets of {_SHOWN} samples",
    )
    return plot_of("estimator", one, many)


def _combs(seed: int) -> Plot:
    """Plot the sampling function S of three samplers."""
    rows = []
    for name, style in sampler_styles(SAMPLERS).items():
        at = _warped(name, _SHOWN, seed, 1)[0]
        peak = 1 / (_SHOWN * pdf(at))
        ends = np.stack([np.stack([at, 0 * peak], -1), np.stack([at, peak], -1)], 1)
        tick = 2 / _SHOWN
        rows.append(
            Panel(
                marks=(
                    Segments(ends=ends, color=style.color, width=1.3),
                    Dots(x=at, y=peak, color=style.color, marker="^", size=3.5),
                ),
                x=Axis(label="x (domain, 0 to 1)", low=0.0, high=1.0),
                y=Axis(
                    label="S(x)", low=0.0, high=1.6 * tick, ticks={0.0: "0", tick: number(tick)}
                ),
                title=name,
            )
        )
    return plot_of("sampling-function", *rows)
