"""Strata aligned with the edges of an integrand keep the rate of what is smooth."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.axes import log_axis
from mcspectra.report.formatting import number, rate
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._curves import (
    convergence_panel,
    known_rate,
    slope,
    variance_ratio,
)
from mcspectra.report.reproduction.base import Exhibit, Finding, comparison, identity
from mcspectra.report.style import (
    ACCENT,
    FAINT,
    INK,
    PALETTE,
    WIDE,
    entitle,
    legend_below,
    new_figure,
    quiet,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

    from mcspectra.integrands import Integrand

__all__ = ["exhibit"]

COUNTS = (16, 64, 256, 1024)
_LAST = COUNTS[-1]
# For a = 1/3 every number of strata 2^k leaves the share 1/3 or 2/3 of one: s(1 − s) is always 2/9.
PLACES = {"aligned: edge at 1/2": 0.5, "not aligned: edge at 1/3": 1 / 3}
_ALIGNED, _CUT = PLACES
_OBLIQUE = "half-space(normal=[1, 0.618], offset=0.7)"

Curves: TypeAlias = "dict[str, xr.Dataset]"


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure variances of an edge and a ramp, for edges on and off the borders of strata."""
    realizations = 1000 if quick else 10_000
    plain = {name: _curve(_edge(a), "jittered", realizations, seed) for name, a in PLACES.items()}
    shifted = {
        name: _curve(_edge(a), "jittered | shift", realizations, seed) for name, a in PLACES.items()
    }
    oblique = _curve(_OBLIQUE, "jittered", realizations, seed)
    findings = (
        _rate(_ALIGNED, plain, -2.0),
        _rate(_CUT, plain, -1.5),
        *(_level(name, plain[name]) for name in PLACES),
        *(_shifted_rate(name, data) for name, data in shifted.items()),
        _oblique_rate(oblique),
        _bent(),
        _gain(plain),
    )
    return Exhibit(
        name="strata-alignment",
        title="Without homogenisation, alignment of strata helps",
        slide="No Homogenization: Strata alignment helps; Strata-alignment affects Convergence.",
        caption=_caption(plain, shifted),
        pictures=(_strata(), _convergence(plain, shifted)),
        findings=findings,
    )


def _edge(a: float) -> Integrand:
    """1 left of x = a, else 0, plus the ramp y, in the plane."""
    from mcspectra.integrands.base import Integrand

    def f(x: Array) -> Array:
        return np.asarray((x[..., 0] < a) + x[..., 1])

    return Integrand.from_function(f, dims=2, integral=a + 0.5)


def exact(a: float) -> Array:
    """Variances of jittered points: those of the edge and of the ramp, which are independent."""
    side = np.sqrt(COUNTS)
    share = a * side - np.floor(a * side)
    return np.asarray(share * (1 - share) / side**3 + 1 / (12 * side**4))


def _curve(f: Integrand | str, sampler: str, realizations: int, seed: int) -> xr.Dataset:
    from mcspectra.variance.convergence import convergence

    return convergence(f, sampler, list(COUNTS), realizations=realizations, rng=seed)


def _caption(plain: Curves, shifted: Curves) -> str:
    a, b, c, d = (
        rate(float(data["rate"]), *map(float, data["rate_ci"].values))
        for data in (*plain.values(), *shifted.values())
    )
    return (
        f"An edge along a border of strata costs nothing: jittered points have the rate {a}. At 1/3, where strata "
        f"are cut, it is {b}. After a random shift borders lie anywhere, and the rates are {c} and {d}: only without "
        "homogenisation does alignment help. An oblique edge cuts strata wherever they lie."
    )


def _rate(name: str, curves: Curves, expected: float) -> Finding:
    return known_rate(
        f"Jittered points, {name}: the variance has the rate {number(expected, 2)}.",
        curves[name],
        expected,
        exact(PLACES[name]),
    )


def _level(name: str, curve: xr.Dataset) -> Finding:
    expected = float(exact(PLACES[name])[-1])
    low, high = curve["variance_ci"].sel(n=_LAST).values
    return comparison(
        f"{name.capitalize()}: the variance is s(1 − s) N^(−3/2) + 1/(12N²), with s the share of a stratum left of "
        f"the edge, at N = {_LAST}.",
        expected=expected,
        measured=float(curve["variance"].sel(n=_LAST)),
        interval=(float(low), float(high)),
        scale="log",
        text=number(expected, 4),
    )


def homogenised() -> Array:
    """Variances after a shift: the edge and the wrap have s(1 − s) averaged, 1/6 each; the ramp its own.

    Edge and wrap are more than a stratum apart, so that they cut different ones; the places of the edge
    do not matter. The ramp has N^(−3/2)/6 − N^(−2)/12, of its own wrap.
    """
    side = np.sqrt(COUNTS)
    return np.asarray(2 / 6 / side**3 + 1 / (6 * side**3) - 1 / (12 * side**4))


def _shifted_rate(name: str, curve: xr.Dataset) -> Finding:
    return known_rate(
        f"After a shift, edge at {name.rpartition(' ')[2]}: the rate is −1.5, aligned before or not.",
        curve,
        -1.5,
        homogenised(),
    )


def _oblique_rate(curve: xr.Dataset) -> Finding:
    from mcspectra.variance.exact import exact_variance

    known = np.array([float(exact_variance(_OBLIQUE, "jittered", n)) for n in COUNTS])
    return known_rate(
        "An oblique edge cuts strata wherever it lies: the rate of jittered points is −1.5.",
        curve,
        -1.5,
        known,
    )


def _bent() -> Finding:
    from mcspectra.variance.alignment import aligned
    from mcspectra.variance.exact import exact_variance

    f, place = _edge(1 / 3), [[1 / 3], []]
    known = [float(exact_variance(aligned(f, place, n), "jittered", n)) for n in COUNTS[-2:]]
    return identity(
        "Strata bent so that they have a border at 1/3 restore the rate −2: that of the exact variances from N = "
        f"{COUNTS[-2]} to {_LAST}, less −2.",
        error=slope(COUNTS[-2:], np.array(known)) + 2.0,
        # s/3 strata are rounded to whole ones: relative changes of 1/s² of the variance, s = 16
        at_most=1 / 256,
    )


def _gain(plain: Curves) -> Finding:
    value, interval = variance_ratio(*(plain[name].sel(n=_LAST) for name in (_CUT, _ALIGNED)))
    known = {name: exact(place)[-1] for name, place in PLACES.items()}
    return comparison(
        f"What alignment is worth: variance of the edge at 1/3 over that of the edge at 1/2, N = {_LAST}.",
        expected=float(known[_CUT] / known[_ALIGNED]),
        measured=value,
        interval=interval,
        scale="log",
    )


def _strata() -> Picture:
    figure = new_figure(WIDE, 2.9)
    panels = figure.subplots(1, 3, sharey=True)
    _draw(panels[0], [(0.5, 0.0), (0.5, 1.0)], "aligned: x = 1/2")
    _draw(panels[1], [(1 / 3, 0.0), (1 / 3, 1.0)], "not aligned: x = 1/3")
    _draw(panels[2], [(0.7, 0.0), (0.082, 1.0)], "oblique")
    panels[0].set_ylabel("x₁")
    return Picture(
        kind="strata-alignment",
        caption="Edges of three integrands and 8 × 8 strata: those that the edge cuts (orange) have a variance of "
        "the order of the jump, all others only that of the smooth rest.",
        alt="Three squares with a grid of strata. On the left the edge runs along a border and no stratum is cut; in "
        "the middle a column of 8 strata is cut, on the right an oblique band of them.",
        figure=figure,
    )


def _draw(axes: Axes, edge: list[tuple[float, float]], title: str) -> None:
    from matplotlib.patches import Rectangle

    side = 8
    quiet(axes)
    x, y = np.array(edge).T
    ticks = np.arange(side + 1) / side
    at = np.interp(ticks, y, x)
    for row in range(side):
        low, high = sorted(at[row : row + 2])
        for column in range(side):
            if column / side < high - 1e-9 and low + 1e-9 < (column + 1) / side:
                corner = (column / side, row / side)
                axes.add_patch(Rectangle(corner, 1 / side, 1 / side, fc=ACCENT, alpha=0.35, lw=0))
    axes.vlines(ticks, 0, 1, color=FAINT, lw=0.7)
    axes.hlines(ticks, 0, 1, color=FAINT, lw=0.7)
    axes.fill_betweenx(y, 0, x, color=PALETTE[0], alpha=0.18, lw=0)
    axes.plot(x, y, color=INK, lw=1.6)
    axes.set(xlim=(0, 1), ylim=(0, 1), aspect="equal", xticks=[0, 1], yticks=[0, 1], xlabel="x₀")
    entitle(axes, title)


def _convergence(plain: Curves, shifted: Curves) -> Picture:
    figure = new_figure(WIDE, 3.4)
    panels = figure.subplots(1, 2, sharey=True)
    known = {name: exact(a) for name, a in PLACES.items()}
    after = {name: homogenised() for name in PLACES}
    convergence_panel(panels[0], plain, known, "jittered")
    convergence_panel(panels[1], shifted, after, "jittered | shift")
    for axes in panels:
        log_axis(axes, "y", exact(0.5).min(), homogenised().max(), most=5)
    panels[0].set_ylabel("variance")
    legend_below(figure, panels[0])
    return Picture(
        kind="strata-alignment-convergence",
        caption="Variance of an edge and a ramp against the number of points: measured, with 95 % intervals, and "
        "exact (lines). Left, jittered points; right, the same shifted at random.",
        alt="Two logarithmic plots. On the left the line of the aligned edge falls more steeply; on the right both "
        "lines coincide.",
        figure=figure,
    )
