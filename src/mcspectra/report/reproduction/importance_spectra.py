"""Power spectra of importance samples: their level, their DC component, and what weights take out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.estimators.moments import CONFIDENCE_Z
from mcspectra.report.axes import log_axis
from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._limits import mean_and_error
from mcspectra.report.reproduction.base import (
    Exhibit,
    Finding,
    agreement,
    comparison,
    identity,
    normal_interval,
)
from mcspectra.report.style import (
    INK,
    NARROW,
    PALETTE,
    WIDE,
    entitle,
    legend_below,
    new_figure,
    outer_labels,
    quiet,
    quiet_colorbar,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

__all__ = ["exhibit"]

_SAMPLERS = ("random", "jittered", "poisson-disk")
_SLOPE = 1.6
_DENSITY = f"linear(slope={_SLOPE})"
_LEVEL = float((np.log((1 + _SLOPE / 2) / (1 - _SLOPE / 2)) / _SLOPE) ** 2)  # ∫1/p in two dims
_N = 256
_HALF_WIDTH = 40


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure spectra of weighted points in the plane, and of the same points without weights."""
    realizations = 300 if quick else 3000
    spectra = {name: _spectrum(name, realizations, seed) for name in _SAMPLERS}
    findings = (
        _ring("random", spectra["random"], 1),
        _ring("random", spectra["random"], _HALF_WIDTH),
        _ring("jittered", spectra["jittered"], 1),
        _ring("jittered", spectra["jittered"], _HALF_WIDTH),
        _below(spectra["poisson-disk"]),
        *(_dc(name, realizations, seed) for name in ("random", "jittered")),
        _rate(1),
        _rate(0),
        _without_weights(realizations, seed),
        _level_in_the_limit(),
    )
    return Exhibit(
        name="importance-spectra",
        title="Power spectrum of importance samples",
        slide="Power Spectrum of Importance Samples",
        formula=r"\langle S_m^* S_m \rangle = \frac{1}{N} \int \frac{dx}{p(x)} \quad \text{(random)}, \qquad m \neq 0",
        caption=_caption(findings),
        pictures=(_images(spectra, realizations, seed), _radial(spectra)),
        findings=findings,
    )


def _caption(findings: tuple[Finding, ...]) -> str:
    low, high = (number(float(f.measured or 0)) for f in findings[2:4])
    dc = [number(float(f.measured or 0)) for f in findings[5:7]]
    return (
        f"Points of p = Π (1 + {_SLOPE}(x − ½)), weighted by 1/p. The level of random points is ∫1/p = "
        f"{number(_LEVEL, 4)} in place of 1. Jittered ones still have little power at low frequencies, N⟨|S|²⟩ = {low} at "
        f"|m| ≈ 1, and reach the level at high ones ({high} at |m| ≈ {_HALF_WIDTH}): a warp keeps strata, though not their shapes. "
        f"What is new is the component at m = 0: the weights do not sum to 1, and N Var(S₀) is {dc[0]} with random and "
        f"{dc[1]} with jittered points."
    )


def _spectrum(name: str, realizations: int, seed: int) -> xr.Dataset:
    from mcspectra.samplers.registry import sampler
    from mcspectra.spectra.power import power_spectrum

    return power_spectrum(
        sampler(name, 2), _N, density=_DENSITY, half_width=_HALF_WIDTH,
        realizations=realizations, rng=seed,
    )  # fmt: skip


def _at_ring(spectrum: xr.Dataset, ring: int) -> tuple[float, float]:
    row = spectrum.isel(radius=ring - 1)
    return _N * float(row["radial_power"]), _N * float(row["radial_power_se"])


def _closed_ring(name: str, ring: int) -> float:
    """N times the mean of the closed form over the frequencies whose |m| rounds to `ring`."""
    from mcspectra.spectra.closed_forms import closed_form_power

    side = np.arange(-_HALF_WIDTH, _HALF_WIDTH + 1)
    m = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    m = m[np.rint(np.hypot(m[:, 0], m[:, 1])) == ring]
    return _N * float(closed_form_power(name, _N, m, _DENSITY).mean())


def _ring(name: str, spectrum: xr.Dataset, ring: int) -> Finding:
    value, se = _at_ring(spectrum, ring)
    expected = _closed_ring(name, ring)
    what = "∫1/p" if name == "random" else "that of the closed form"
    return comparison(
        f"N⟨|S_m|²⟩ of {name} importance samples, the mean over |m| ≈ {ring}, is {what}.",
        expected=expected,
        measured=value,
        interval=normal_interval(value, se),
        text=number(expected, 4),
    )


def _below(spectrum: xr.Dataset) -> Finding:
    value, se = _at_ring(spectrum, 1)
    return agreement(
        "Poisson-disk points, warped, have less power than random ones at |m| ≈ 1, but more than jittered ones.",
        measured=value,
        interval=normal_interval(value, se),
        above=_closed_ring("jittered", 1),
        below=_LEVEL,
    )


def _dc(name: str, realizations: int, seed: int) -> Finding:
    """S_0 is the mean of 1/p; its variance against the closed form."""
    from mcspectra.spectra.closed_forms import closed_form_covariance

    squares = _N * (_sums(name, realizations * 4, seed, weighted=True)[:, 0].real - 1.0) ** 2
    value, se = (float(v) for v in mean_and_error(squares))
    zero = np.zeros((1, 2))
    expected = _N * float(closed_form_covariance(name, _N, zero, zero, _DENSITY).real[0])
    return comparison(
        f"The component at m = 0 of {name} importance samples varies: N Var(S₀) is that of the closed form.",
        expected=expected,
        measured=value,
        interval=normal_interval(value, se),
        text=number(expected, 4),
    )


def _sums(name: str, realizations: int, seed: int, *, weighted: bool) -> Array:
    """S at m = (0, 0) and (1, 0): complex (realizations, 2)."""
    from mcspectra.densities.registry import density
    from mcspectra.samplers.registry import sampler

    p = density(_DENSITY, 2)
    x = p.sample(sampler(name, 2).draw(_N, realizations=realizations, rng=seed))
    w = 1.0 / p.pdf(x) if weighted else np.ones(x.shape[:-1])
    return np.stack([(w * np.exp(-2j * np.pi * m * x[..., 0])).mean(axis=1) for m in (0, 1)], -1)


def _rate(m: int) -> Finding:
    """In 1-D: strata of the length 1/N, in which the weighted wave changes by as much."""
    from mcspectra.spectra.closed_forms import closed_form_covariance

    low, high = (
        float(closed_form_covariance("jittered", n, [[m]], [[m]], _DENSITY).real[0])
        for n in (512, 1024)
    )
    slope = float(np.log2(high / low))
    return Finding(
        statement=f"In one dim, Var(S{'₀₁'[m]}) of jittered importance samples falls as N⁻³: exact rate between N = 512 "
        "and 1024.",
        expected="−3.0 ± 0.01",
        measured=slope,
        interval=None,
        agrees=abs(slope + 3.0) <= 0.01,
        note="Tolerance: the next term of the variance is smaller by 1/N, times derivatives of 1/p.",
    )


def _without_weights(realizations: int, seed: int) -> Finding:
    """N random points of p: 1/N + (1 − 1/N) |p_m|², p_m = i s/(2πm) of a linear density."""
    power = np.abs(_sums("random", realizations, seed, weighted=False)[:, 1]) ** 2
    value, se = (float(v) for v in mean_and_error(power))
    expected = 1 / _N + (1 - 1 / _N) * (_SLOPE / (2 * np.pi)) ** 2
    return comparison(
        "Without the weights 1/p the spectrum is that of the density: ⟨|S_m|²⟩ → |p_m|² at m = (1, 0).",
        expected=expected,
        measured=value,
        interval=normal_interval(value, se),
        text=number(expected, 4),
    )


def _level_in_the_limit() -> Finding:
    from mcspectra.spectra.closed_forms import closed_form_power

    m = np.array([[4000, 0]])
    return identity(
        "At high frequencies, m = (4000, 0), jittered importance samples have the level ∫1/p of random ones: relative "
        "difference.",
        error=_N * float(closed_form_power("jittered", _N, m, _DENSITY)[0]) / _LEVEL - 1,
        at_most=1e-3,
        note="Transforms of strata fall as 1/m, their squares as 1/m².",
    )


def _images(spectra: dict[str, xr.Dataset], realizations: int, seed: int) -> Picture:
    figure = new_figure(WIDE, 4.9)
    grid = figure.subplots(2, 3)
    for axes, name in zip(grid[0], _SAMPLERS, strict=True):
        _draw_points(axes, name, seed)
        outer_labels(axes)
    for axes, name in zip(grid[1], _SAMPLERS, strict=True):
        drawn = _image(axes, spectra[name])
        axes.set(xlabel="m₀ (cycles per unit)", ylabel="m₁ (cycles per unit)")
        outer_labels(axes)
    bar = figure.colorbar(drawn, ax=list(grid[1]), extend="max", shrink=0.9, pad=0.02)
    quiet_colorbar(bar, "N · ⟨|S|²⟩")
    return Picture(
        kind="importance-spectra",
        caption=f"Above, {_N} importance samples of p = Π (1 + {_SLOPE}(x − ½)), denser at the upper right. Below, N times "
        f"the expected power of the weighted points, {realizations} sets; m = 0 is left out.",
        alt="Three squares of points that are denser at the upper right, and three images of power below: flat for "
        "random, a small dark hole for jittered, a blurred dark disk for Poisson disk.",
        figure=figure,
    )


def _draw_points(axes: Axes, name: str, seed: int) -> None:
    from mcspectra.densities.registry import density
    from mcspectra.samplers.registry import sampler

    x = density(_DENSITY, 2).sample(sampler(name, 2).draw(_N, rng=seed)[0])
    quiet(axes)
    axes.plot(*x.T, ".", ms=3, color=PALETTE[0])
    axes.set(xlim=(0, 1), ylim=(0, 1), xticks=[0, 1], yticks=[0, 1], aspect="equal", ylabel="x₁")
    axes.set_xlabel("x₀", labelpad=-4)
    entitle(axes, name)


def _image(axes: Axes, spectrum: xr.Dataset) -> AxesImage:
    power = _N * np.asarray(spectrum["power"].values)
    power[_HALF_WIDTH, _HALF_WIDTH] = np.nan
    edge = _HALF_WIDTH + 0.5
    quiet(axes)
    drawn = axes.imshow(
        power.T, origin="lower", extent=(-edge, edge, -edge, edge), vmin=0.0,
        vmax=1.5 * _LEVEL, cmap="viridis", interpolation="nearest",
    )  # fmt: skip
    ticks = [-_HALF_WIDTH, 0, _HALF_WIDTH]
    axes.set(xticks=ticks, yticks=ticks)
    return drawn


def _radial(spectra: dict[str, xr.Dataset]) -> Picture:
    figure = new_figure(NARROW, 3.2)
    axes = figure.subplots()
    quiet(axes, grid=True)
    rings = np.arange(1, _HALF_WIDTH + 1)
    for (name, data), color, marker in zip(spectra.items(), PALETTE, "os^", strict=False):
        value, se = np.array([_at_ring(data, int(ring)) for ring in rings]).T
        axes.errorbar(
            rings, value, CONFIDENCE_Z * se, fmt=marker, ms=3, lw=0.8, color=color, label=name
        )
    axes.axhline(_LEVEL, color=INK, lw=1, label="∫1/p")
    log_axis(axes, "x", 1.0, float(_HALF_WIDTH))
    log_axis(axes, "y", _closed_ring("jittered", 1) / 1.5, 4.0)
    axes.set(xlabel="|m| (cycles per unit)", ylabel="N · ⟨|S|²⟩")
    legend_below(figure, axes, columns=4)
    return Picture(
        kind="importance-radial",
        caption="The expected power of weighted points, averaged over directions, with 95 % intervals. The level of "
        "random points is ∫1/p.",
        alt="Logarithmic plot against the length of the frequency: random level at 1.89, jittered rising from 0.1 with "
        "slope 2 to it, Poisson disk in between at the left.",
        figure=figure,
    )
