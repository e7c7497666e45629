"""Mirroring of the integrand and of the samples, which homogenisation then does not harm."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.axes import count_axis, log_axis
from mcspectra.report.formatting import number, rate
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._curves import known_rate
from mcspectra.report.reproduction._mirrored_variances import (
    INTEGRAND,
    MIRRORINGS,
    RATES,
    exact_mirrored,
)
from mcspectra.report.reproduction.base import Exhibit, Finding, agreement, identity
from mcspectra.report.style import (
    ACCENT,
    FAINT,
    GRAY,
    INK,
    PALETTE,
    WIDE,
    entitle,
    legend_below,
    new_figure,
    outer_labels,
    quiet,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["exhibit"]

_COUNTS = (64, 256, 1024, 4096)
_TITLES = {"original": "original", "random": "mirror-random", "uniform": "mirror-uniform"}
_WORDS = {False: "not homogenised", True: "homogenised"}


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Draw integrand and samples, and measure the six curves of convergence."""
    from mcspectra.variance.variants import mirror_study

    study = mirror_study(
        INTEGRAND, "jittered", _COUNTS, mirrorings=list(MIRRORINGS),
        realizations=250 if quick else 2500, rng=seed,
    )  # fmt: skip
    cells = list(itertools.product(MIRRORINGS, (False, True)))
    exact = {
        c: np.array([exact_mirrored(c[0], n, homogenized=c[1]) for n in _COUNTS]) for c in cells
    }
    findings = (
        *(_rate(cell, _cell(study, *cell), exact[cell]) for cell in cells),
        _cost_of_homogenization(study),
        _gain_of_mirroring(study),
        _jump("original"),
        _jump("mirrored"),
        *(_domain(dims) for dims in (1, 2)),
    )
    return Exhibit(
        name="mirroring",
        title="Mirroring the integrand and the samples",
        slide="Integrand Mirroring: Original → Mirrored; Homogenization (CPr): After Toroidal wrapping. Sampling "
        "Integrand Mirroring: Original, Mirror-random, Mirror-uniform. Convergence: Homogenized not good; No "
        "homogenized good. Take away: Homogenization introduces boundary discontinuities; Integrand Mirroring helps "
        "avoid these discontinuities; But, Integrand mirroring quadruples the sampling domain in 2D.",
        caption=_caption(study),
        pictures=(_integrands(), _samples(seed), _convergence(study, exact)),
        findings=findings,
    )


def _cell(study: xr.Dataset, mirroring: str, homogenized: bool) -> xr.Dataset:
    return study.sel(mirroring=mirroring, homogenized=homogenized)


def _caption(study: xr.Dataset) -> str:
    def shown(mirroring: str, homogenized: bool) -> str:
        cell = _cell(study, mirroring, homogenized)
        return rate(float(cell["rate"]), *map(float, cell["rate_ci"].values))

    return (
        f"A random shift moves strata across the border, where f(1) meets f(0): the rate of a smooth integrand falls "
        f"from {shown('original', False)} to {shown('original', True)}. The mirrored integrand has no jump there: with "
        f"mirror-uniform the rates are {shown('uniform', False)} and, shifted, {shown('uniform', True)} (the curve "
        "bends; its limit is −2). Mirror-random reflects each sample by a coin, whose own variance falls as 1/N only. "
        "The price: the same N is spread over a domain 2^d times as large. The slides name the variants; these "
        "definitions are ours."
    )


def _rate(cell: tuple[str, bool], curve: xr.Dataset, exact: Array) -> Finding:
    mirroring, homogenized = cell
    expected = RATES[cell]
    return known_rate(
        f"Variance of exp(−x² − y²), {_TITLES[mirroring]}, jittered, {_WORDS[homogenized]}: rate.",
        curve,
        expected,
        exact,
    )


def _ratio(above: xr.Dataset, below: xr.Dataset) -> tuple[float, tuple[float, float]]:
    """Ratio of the variances at the largest N with a 95 % interval, both taken as independent."""
    values = [float(c["variance"][-1]) for c in (above, below)]
    halves = [np.diff(np.log(c["variance_ci"].values[-1]))[0] / 2 for c in (above, below)]
    ratio, factor = values[0] / values[1], float(np.exp(np.hypot(*halves)))
    return ratio, (ratio / factor, ratio * factor)


def _cost_of_homogenization(study: xr.Dataset) -> Finding:
    ratio, interval = _ratio(_cell(study, "original", True), _cell(study, "original", False))
    return agreement(
        f"Homogenised is not good: at N = {_COUNTS[-1]} the shift multiplies the variance of the original by more "
        "than 1.",
        measured=ratio,
        interval=interval,
        above=1.0,
        scale="log",
    )


def _gain_of_mirroring(study: xr.Dataset) -> Finding:
    ratio, interval = _ratio(_cell(study, "original", True), _cell(study, "uniform", True))
    return agreement(
        f"Mirroring helps where sets are homogenised: at N = {_COUNTS[-1]}, variance of the original over "
        "mirror-uniform, both shifted.",
        measured=ratio,
        interval=interval,
        above=1.0,
        scale="log",
    )


def _jump(which: str) -> Finding:
    """Largest |f(0, y) − f(1, y)| of the integrand over the period that a shift wraps around."""
    y = np.linspace(0.0, 1.0, 257)
    height = np.exp(-(y**2)) * (1.0 - np.exp(-1.0)) if which == "original" else _mirrored_gap(y)
    if which == "mirrored":
        return identity(
            "Where the mirrored integrand wraps around it is continuous: largest jump.",
            error=float(np.abs(height).max()),
            at_most=1e-12,
        )
    largest = float(np.abs(height).max())
    return Finding(
        statement="Where the original wraps around it jumps, by up to 1 − 1/e.",
        expected=number(1 - np.exp(-1), 4),
        measured=largest,
        interval=None,
        agrees=bool(abs(largest - (1 - np.exp(-1))) <= 1e-12),
    )


def _mirrored_gap(y: Array) -> Array:
    """f(fold(2u)) at both ends of an axis."""
    from mcspectra.estimators.mirrored import Mirrored

    g = Mirrored(INTEGRAND).primary_integrand(0)
    ends = [np.stack([np.full_like(y, u), y], axis=-1) for u in (0.0, np.nextafter(1.0, 0.0))]
    return np.asarray(g(ends[0]) - g(ends[1]))


def _domain(dims: int) -> Finding:
    """Each image gets the strata that n/2^d points have in the domain, each sampled once."""
    from mcspectra.estimators.mirrored import Mirrored
    from mcspectra.variance.exact import exact_variance

    f = INTEGRAND if dims == 2 else "gaussian(center=0.2, width=0.4, dims=1)"
    n, images = 64, 2**dims
    mirrored = float(exact_variance(Mirrored(f), "jittered", images * n))
    plain = float(exact_variance(f, "jittered", n))
    return identity(
        f"Mirroring the integrand makes the domain {images} times as large in {dims} dim{'s' * (dims > 1)}: {images}N jittered points in "
        f"it have strata as those of N, the variance 1/{images} of that of N. Relative difference.",
        error=images * mirrored / plain - 1.0,
        at_most=1e-9,
    )


def _integrands() -> Picture:
    figure = new_figure(WIDE, 5.0)
    grid = figure.subplots(2, 2, height_ratios=[2, 1])
    t = (np.arange(400) + 0.5) / 200 - 1.0
    for column, (mode, title) in enumerate(
        (("wrap", "original: wrapped around"), ("reflect", "mirrored"))
    ):
        folded = t % 1.0 if mode == "wrap" else np.abs(t)
        values = np.exp(-(folded[:, None] ** 2) - folded**2)
        axes = grid[0, column]
        quiet(axes)
        axes.imshow(
            values, origin="lower", extent=(-1, 1, -1, 1), cmap="cividis", vmin=0, vmax=1,
        )  # fmt: skip
        axes.axhline(0, color="white", lw=0.8)
        axes.axvline(0, color="white", lw=0.8)
        axes.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1], ylabel="y", aspect="equal")
        entitle(axes, title)
        line = np.where(
            np.abs(np.diff(folded, append=folded[-1])) > 0.5, np.nan, np.exp(-(folded**2))
        )
        quiet(grid[1, column], grid=True)
        grid[1, column].plot(t, line, color=INK, lw=1.4)
        grid[1, column].set(
            xlabel="x", ylabel="f(x, 0)", ylim=(0, 1.1), xticks=[-1, 0, 1], xlim=(-1, 1)
        )
    return Picture(
        kind="mirrored-integrand",
        caption="exp(−x² − y²) as a shifted set sees it: wrapped around, with jumps at the borders of the domain "
        "(white lines), and mirrored, continuous, over a period of 2.",
        alt="Left, four copies of a bell's quarter with jumps between them, and a saw-tooth section. Right, four "
        "mirrored copies that join to a whole bell, and a section without jumps.",
        figure=figure,
    )


def _samples(seed: int) -> Picture:
    from mcspectra.samplers.registry import sampler

    specs = ("jittered", "jittered | mirror(mode='random')", "jittered | mirror(mode='uniform')")
    figure = new_figure(WIDE, 2.9)
    panels = figure.subplots(1, 3)
    for axes, spec, mirroring in zip(panels, specs, MIRRORINGS, strict=True):
        x = sampler(spec, 2).draw(64, rng=seed)[0]
        own = sampler("jittered", 2).draw(16, rng=seed)[0]
        _draw_samples(axes, x, own if mirroring == "uniform" else x[:0], mirroring)
        outer_labels(axes)
    return Picture(
        kind="mirrored-samples",
        caption="64 points: jittered; each reflected or not along each axis by a coin; 16 jittered points, each in all "
        "four images (orange: the points themselves). Strata are those of the points before mirroring.",
        alt="Three squares of points: one to a stratum; in clumps and with holes; and a pattern that is symmetric about "
        "both middle lines.",
        figure=figure,
    )


def _draw_samples(axes: Axes, x: Array, own: Array, mirroring: str) -> None:
    side = 4 if mirroring == "uniform" else 8
    quiet(axes)
    lines = np.arange(side + 1) / side
    axes.vlines(lines, 0, 1, color=FAINT, lw=0.7)
    axes.hlines(lines, 0, 1, color=FAINT, lw=0.7)
    axes.scatter(x[:, 0], x[:, 1], s=9, color=PALETTE[0], zorder=3)
    axes.scatter(own[:, 0], own[:, 1], s=9, color=ACCENT, zorder=4)
    axes.set(xlim=(0, 1), ylim=(0, 1), xticks=[0, 1], yticks=[0, 1], aspect="equal", xlabel="x")
    axes.set_ylabel("y")
    entitle(axes, _TITLES[mirroring])


def _convergence(study: xr.Dataset, exact: dict[tuple[str, bool], Array]) -> Picture:
    figure = new_figure(WIDE, 5.6)
    grid = figure.subplots(2, 3, sharex=True, sharey=True)
    for row, homogenized in enumerate((True, False)):
        for axes, mirroring in zip(grid[row], MIRRORINGS, strict=True):
            cell = _cell(study, mirroring, homogenized)
            _draw_curve(axes, cell, exact[mirroring, homogenized], RATES[mirroring, homogenized])
            axes.set_xlabel("number of samples N" if row else "")
            axes.set_ylabel("variance")
            outer_labels(axes)
            entitle(axes, f"{_TITLES[mirroring]}, {_WORDS[homogenized]}")
    legend_below(figure, grid[0, 0], columns=3)
    return Picture(
        kind="mirroring-convergence",
        caption="Variance with 95 % intervals, exact variances, and lines of the rates of theory through the last "
        "of these. Above, sets that are shifted at random; below, the same without the shift.",
        alt="Six logarithmic plots, three mirrorings with and without a shift. The original has −1.5 shifted and −2 "
        "not shifted, mirror-random −1 in both, mirror-uniform −2 in both.",
        figure=figure,
    )


def _draw_curve(axes: Axes, cell: xr.Dataset, exact: Array, expected: float) -> None:
    quiet(axes, grid=True)
    n, variance, (low, high) = (
        np.array(_COUNTS, float),
        cell["variance"].values,
        cell["variance_ci"].values.T,
    )
    theory = exact[-1] * (n / n[-1]) ** expected
    axes.plot(n, theory, ls="--", lw=1, color=GRAY, label="rate of theory")
    axes.plot(n, exact, color=INK, lw=1.1, label="exact")
    axes.errorbar(
        n, variance, [variance - low, high - variance],
        fmt="o", ms=4, lw=1, color=PALETTE[0], label="measured",
    )  # fmt: skip
    text = f"slope {number(expected, 2)}"
    axes.annotate(text, (n[1], theory[1]), (8, 8), textcoords="offset points", fontsize=8)
    count_axis(axes, "x", _COUNTS)
    log_axis(axes, "y", 1e-9, 1e-3, most=4)
