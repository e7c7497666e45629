"""Power spectra of one set of points, and their expectation over many sets."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.figures.spectra import radial_power
from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction.base import (
    Exhibit,
    Finding,
    agreement,
    comparison,
    normal_interval,
)
from mcspectra.report.style import WIDE, entitle, new_figure, outer_labels, quiet, quiet_colorbar

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

__all__ = ["exhibit"]

_SAMPLERS = ("random", "jittered", "poisson-disk")
_N = 256
_HALF_WIDTH = 48
_TOP = 2.5  # end of the colour scale, in n · power

Spectra: TypeAlias = "dict[str, xr.Dataset]"


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Show single and expected spectra, and judge their level, speckle and low frequencies."""
    realizations = 200 if quick else 2000
    single, expected = _spectra(1, seed), _spectra(realizations, seed)
    random, jittered, disk = (expected[name] for name in _SAMPLERS)
    findings = (
        _speckle("one set", single["random"], 1),
        _speckle(f"the mean over {realizations} sets", random, realizations),
        _ring("random", random, 1, 1.0),
        _ring("jittered", jittered, 1, _closed_ring(1)),
        _ring("jittered", jittered, _HALF_WIDTH, _closed_ring(_HALF_WIDTH)),
        _below_random(disk),
        _peak(disk),
        _exponent("jittered", jittered, 2.0),
        _exponent("random", random, 0.0),
    )
    return Exhibit(
        name="power-spectra",
        title="Power spectra of point sets and their expectation",
        slide="Fourier Statistics: Power Spectrum; Point Samples' Expected Power Spectra: Random, Jitter, "
        "Poisson Disk.",
        formula=r"\langle \mathcal{P}_S(\nu) \rangle = \left\langle \left| \frac{1}{N} \sum_{k=1}^N "
        r"e^{-i 2\pi \nu \cdot x_k} \right|^2 \right\rangle",
        caption=_caption(expected, findings),
        pictures=(_images(single, expected, realizations), _radial(expected)),
        findings=findings,
    )


def _spectra(realizations: int, seed: int) -> Spectra:
    from mcspectra.samplers.registry import sampler
    from mcspectra.spectra.power import power_spectrum

    return {
        name: power_spectrum(
            sampler(name, 2), _N, half_width=_HALF_WIDTH, realizations=realizations, rng=seed
        )
        for name in _SAMPLERS
    }


def _caption(expected: Spectra, findings: tuple[Finding, ...]) -> str:
    low = ", ".join(f"{number(_at_ring(d, 1)[0])} ({name})" for name, d in expected.items())
    speckle = " and ".join(number(float(f.measured or 0)) for f in findings[:2])
    return (
        f"The spectrum of one set is speckle, as strong as its mean; averaging removes it (standard deviation "
        f"over mean of random points: {speckle}) and leaves what belongs to the sampler. At the lowest "
        f"frequencies N times the power is {low}: random points are flat, jittered ones fall to nothing as "
        "|ν|², Poisson-disk points keep a low level and a ring around it."
    )


def _half(spectrum: xr.Dataset) -> Array:
    """N · power of one of each pair ±m, without m = 0."""
    flat = np.asarray(spectrum["power"].values).ravel()
    return np.asarray(_N * flat[: flat.size // 2])


def _speckle(what: str, spectrum: xr.Dataset, realizations: int) -> Finding:
    """The coefficient of variation of powers that are exponential, averaged R times: 1/√R."""
    power = _half(spectrum)
    value = float(power.std(ddof=1) / power.mean())
    # Of M values of Gamma(R): variance of the coefficient (1 + 1/R) / (2 R M)
    se = math.sqrt((1 + 1 / realizations) / (2 * realizations * power.size))
    return comparison(
        f"Of {what} of random points, the power at a frequency varies by 1/√R of its mean "
        f"(R = {realizations}).",
        expected=realizations**-0.5,
        measured=value,
        interval=normal_interval(value, se),
        # |S_m|² is exponential for N → ∞ only, and powers correlate: both change it by about 1/N
        tolerance=1.0 / _N * realizations**-0.5,
        note="Tolerance 1/N of it: powers of N points are exponential up to that.",
    )


def _at_ring(spectrum: xr.Dataset, ring: int) -> tuple[float, float]:
    row = spectrum.isel(radius=ring - 1)
    return _N * float(row["radial_power"]), _N * float(row["radial_power_se"])


def _closed_ring(ring: int) -> float:
    """Mean of the closed form over the integer frequencies whose |m| rounds to `ring`."""
    from mcspectra.spectra.closed_forms import closed_form_power

    side = np.arange(-_HALF_WIDTH, _HALF_WIDTH + 1)
    m = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    m = m[np.rint(np.hypot(m[:, 0], m[:, 1])) == ring]
    return _N * float(closed_form_power("jittered", _N, m).mean())


def _ring(name: str, spectrum: xr.Dataset, ring: int, expected: float) -> Finding:
    value, se = _at_ring(spectrum, ring)
    return comparison(
        f"N · ⟨P⟩ of {name} points, the mean over |m| ≈ {ring}, is that of the closed form.",
        expected=expected,
        measured=value,
        interval=normal_interval(value, se),
        text=number(expected, 4),
    )


def _below_random(spectrum: xr.Dataset) -> Finding:
    value, se = _at_ring(spectrum, 1)
    return agreement(
        "Poisson-disk points have less power than random ones at |m| ≈ 1, but more than jittered ones.",
        measured=value,
        interval=normal_interval(value, se),
        above=_closed_ring(1),
        below=1.0,
    )


def _peak(spectrum: xr.Dataset) -> Finding:
    ring = int(np.argmax(spectrum["radial_power"].values)) + 1
    value, se = _at_ring(spectrum, ring)
    return agreement(
        f"Poisson-disk points have a ring above the level of random ones, at |m| ≈ {ring}.",
        measured=value,
        interval=normal_interval(value, se),
        above=1.0,
    )


def _exponent(name: str, spectrum: xr.Dataset, expected: float) -> Finding:
    """Exponent over the lowest frequencies, where 1 − sinc² has bent by little."""
    from mcspectra.spectra.shapes import low_frequency_exponent

    fit = low_frequency_exponent(spectrum, up_to=3.0)
    low, high = (float(end) for end in fit["low_frequency_exponent_ci"].values)
    return comparison(
        f"The power of {name} points starts as |ν|^{expected:.0f}.",
        expected=expected,
        measured=float(fit["low_frequency_exponent"]),
        interval=(low, high),
        # d log(1 − sinc²(πν/s)) / d log ν = 2 − 4/15 (πν/s)² …, s = 16, ν ≤ 3
        tolerance=0.1 if expected else 0.0,
        note="Tolerance 0.1: 1 − sinc² bends by as much up to |m| = 3." if expected else "",
    )


def _images(single: Spectra, expected: Spectra, realizations: int) -> Picture:
    figure = new_figure(WIDE, 4.9)
    grid = figure.subplots(2, 3)
    for row, (data, what) in enumerate(((single, "one set"), (expected, "expected"))):
        for axes, name in zip(grid[row], _SAMPLERS, strict=True):
            drawn = _image(axes, data[name])
            axes.set_xlabel("m₀ (cycles per unit)" if row else "")
            outer_labels(axes)
            entitle(axes, f"{name}, {what}")
    bar = figure.colorbar(drawn, ax=list(grid.ravel()), extend="max", shrink=0.7, pad=0.02)
    quiet_colorbar(bar, "N · |S|²   (random: 1)")
    return Picture(
        kind="power-spectra",
        caption=f"N times the power over the frequencies m₀, m₁ = −{_HALF_WIDTH} … {_HALF_WIDTH} (cycles per unit), "
        f"N = {_N}. Above, of one set; below, its mean over {realizations} sets. m = 0 is left out.",
        alt="Six images of power. One set: grainy. Expected: flat for random, a small dark hole for "
        "jittered, a dark disk within a bright ring for Poisson disk.",
        figure=figure,
    )


def _image(axes: Axes, spectrum: xr.Dataset) -> AxesImage:
    power = _N * np.asarray(spectrum["power"].values)
    power[_HALF_WIDTH, _HALF_WIDTH] = np.nan
    edge = _HALF_WIDTH + 0.5
    drawn = axes.imshow(
        power.T,
        origin="lower",
        extent=(-edge, edge, -edge, edge),
        vmin=0.0,
        vmax=_TOP,
        cmap="viridis",
        interpolation="nearest",
    )
    quiet(axes)
    ticks = [-_HALF_WIDTH, 0, _HALF_WIDTH]
    axes.set(ylabel="m₁ (cycles per unit)", xticks=ticks, yticks=ticks)
    return drawn


def _radial(expected: Spectra) -> Picture:
    return Picture(
        kind="radial",
        caption="The expected power, averaged over directions, against the length of the frequency: the slope at "
        "the left is 0 for random and Poisson-disk points, 2 for jittered ones.",
        alt="Logarithmic plot of N times the radial mean power: random constant at 1, jittered rising with "
        "slope 2, Poisson disk low and constant, then a peak above 1.",
        figure=radial_power(expected),
    )
