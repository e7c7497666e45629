"""The bias of an estimate is the sum of f's coefficients times the means of S; unbiased sets have none."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.axes import count_axis
from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._limits import largest_distance, mean_and_error
from mcspectra.report.reproduction.base import (
    Exhibit,
    Finding,
    agreement,
    comparison,
    identity,
    normal_interval,
)
from mcspectra.report.style import PALETTE, WIDE, entitle, legend_below, new_figure, quiet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["exhibit"]

_N = 16
_DENSITY = "linear(slope=1)"
_UNBIASED = ("random", "jittered", "sobol | owen")
_WIDTH = 0.5
_BOXES = f"box-jitter(width={_WIDTH})"
_BOUNDED = "poisson-disk(boundary='bounded')"
_M = np.arange(33)
_COUNTS = (2, 4, 8, 16)


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure ⟨S_m⟩ of sets with and without bias, and the bias of an integral of x²."""
    realizations = 2000 if quick else 20_000
    weighted = {name: _sums(name, realizations, seed, _DENSITY) for name in _UNBIASED}
    boxes, bounded = (_sums(name, realizations, seed) for name in (_BOXES, _BOUNDED))
    biases = {
        name: {n: _bias(name, n, 20 * realizations, seed) for n in _COUNTS}
        for name in ("jittered", _BOXES, f"{_BOXES} | shift")
    }
    findings = (
        *(_no_mean(name, sums) for name, sums in weighted.items()),
        _box_mean(boxes),
        _border(bounded),
        _border(_sums("poisson-disk", realizations, seed), toroidal=True),
        _measured_bias(biases[_BOXES][_N]),
        _summed_bias(),
        _midpoint_rule(),
        _unshifted(biases[f"{_BOXES} | shift"]),
    )
    return Exhibit(
        name="bias",
        title="Bias for sampling-based integrators",
        slide="Supplementary document: 3 Bias for sampling-based integrator; 3.1 Expectation of sampling Fourier "
        "coefficients.",
        formula=r"\langle I_N \rangle - I = \sum_{m \in \mathbb{Z}} f_m^* \langle S_m \rangle - f_0, \qquad "
        r"\langle S_m \rangle = 0, \; m \neq 0",
        caption=_caption(boxes, biases[_BOXES][_N]),
        pictures=(_means(weighted["jittered"], boxes, bounded), _against_n(biases)),
        findings=findings,
    )


def _caption(boxes: Array, bias: tuple[float, float]) -> str:
    mean = number(float(boxes.mean(axis=0)[_N].real))
    return (
        "Points that are each distributed as p have ⟨S_m⟩ = 0 at all integer m ≠ 0 and ⟨S₀⟩ = 1, however they are "
        f"correlated; weighted by 1/p too. Points that keep to the middle halves of {_N} strata do not: ⟨S_m⟩ = {mean} "
        f"at m = {_N}. The estimate of ∫x² is then off by {number(bias[0])}, the sum of f's coefficients times "
        "these means. The bias does not average out over pixels or frames; a random shift removes it."
    )


def _sums(name: str, realizations: int, seed: int, density: str | None = None) -> Array:
    """S_m at m = 0 … 32 of points in 1-D: complex (realizations, 33)."""
    from mcspectra.densities.registry import density as as_density
    from mcspectra.samplers.registry import sampler

    x = sampler(name, 1).draw(_N, realizations=realizations, rng=seed)
    p = as_density(density or "uniform", 1)
    x = p.sample(x)
    weights = 1.0 / p.pdf(x)
    return np.stack([(weights * np.exp(-2j * np.pi * m * x[..., 0])).mean(axis=1) for m in _M], -1)


def _no_mean(name: str, sums: Array) -> Finding:
    parts = np.concatenate([sums.real - (_M == 0), sums.imag[:, 1:]], axis=1)
    mean, se = mean_and_error(parts)
    return largest_distance(
        f"Importance samples of {name} points, p = ½ + x, have ⟨S₀⟩ = 1 and ⟨S_m⟩ = 0, m = 1 … {_M[-1]}, real and "
        "imaginary parts",
        mean,
        se,
    )


def _box_mean(sums: Array) -> Finding:
    """Each point is uniform in a box about the center of its stratum: (−1)^k sinc(π k w) at m = kN."""
    mean, se = mean_and_error(sums.real)
    expected = -float(np.sinc(_WIDTH))
    return comparison(
        f"Points in the middle halves of {_N} strata have ⟨S_m⟩ = −sinc(π/2) at m = {_N}.",
        expected=expected,
        measured=float(mean[_N]),
        interval=normal_interval(float(mean[_N]), float(se[_N])),
        text=number(expected, 5),
    )


def _border(sums: Array, *, toroidal: bool = False) -> Finding:
    mean, se = mean_and_error(sums.real)
    value, interval = float(mean[1]), normal_interval(float(mean[1]), float(se[1]))
    if toroidal:
        return comparison(
            "With distances around the border, Re ⟨S₁⟩ of Poisson-disk points is 0.",
            expected=0.0,
            measured=value,
            interval=interval,
        )
    return agreement(
        "Poisson-disk points whose disks stick out of the domain are more likely near its border: Re ⟨S₁⟩ > 0.",
        measured=value,
        interval=interval,
        above=0.0,
    )


def _bias(name: str, n: int, realizations: int, seed: int) -> tuple[float, float]:
    """Mean and standard error of I_N − 1/3 for f = x²."""
    from mcspectra.samplers.registry import sampler

    x = sampler(name, 1).draw(n, realizations=realizations, rng=seed)[..., 0]
    mean, se = mean_and_error((x**2).mean(axis=1) - 1 / 3)
    return float(mean), float(se)


def _box_bias(n: int, width: float = _WIDTH) -> float:
    """Boxes of the width w/n about the centers: ⟨x²⟩ is less than with n strata by (1 − w²)/(12n²)."""
    return -(1 - width**2) / (12 * n**2)


def _measured_bias(bias: tuple[float, float]) -> Finding:
    return comparison(
        f"Points in the middle halves of {_N} strata estimate ∫x² with the bias −(1 − w²)/(12N²), w = ½.",
        expected=_box_bias(_N),
        measured=bias[0],
        interval=normal_interval(*bias),
        text=number(_box_bias(_N), 5),
    )


def _summed_bias() -> Finding:
    """Σ_{m ≠ 0} conj(f_m) ⟨S_m⟩: ⟨S⟩ lives on multiples of N, and imaginary parts of ±m cancel."""
    k = np.arange(1, 20_001)
    coefficients = 1 / (2 * (np.pi * k * _N) ** 2)
    total = float((2 * coefficients * (-1.0) ** k * np.sinc(_WIDTH * k)).sum())
    return identity(
        "That bias is Σ f_m* ⟨S_m⟩ over m ≠ 0: relative difference.",
        error=total / _box_bias(_N) - 1,
        at_most=1e-10,
        note="The terms beyond the last of 20 000 multiples of N are below that.",
    )


def _midpoint_rule() -> Finding:
    """Regular points at the centers: w = 0."""
    from mcspectra.samplers.registry import sampler

    x = {n: sampler("regular", 1).draw(n)[0, :, 0] for n in _COUNTS}
    errors = [(v**2).mean() - 1 / 3 - _box_bias(n, 0.0) for n, v in x.items()]
    return identity(
        f"Regular points, the midpoint rule, have no variance at all but the bias −1/(12N²), N = {_COUNTS[0]} … "
        f"{_COUNTS[-1]}: largest difference.",
        error=float(np.abs(errors).max()),
        at_most=1e-15,
    )


def _unshifted(biases: dict[int, tuple[float, float]]) -> Finding:
    mean, se = np.array(list(biases.values())).T
    return largest_distance(
        f"A random shift removes the bias of those points, N = {_COUNTS[0]} … {_COUNTS[-1]}",
        mean,
        se,
    )


def _means(weighted: Array, boxes: Array, bounded: Array) -> Picture:
    figure = new_figure(WIDE, 2.9)
    panels = figure.subplots(1, 3)
    titles = ("jittered, p = ½ + x", "middle halves of strata", "Poisson disk, bounded")
    for axes, sums, title in zip(panels, (weighted, boxes, bounded), titles, strict=True):
        mean, se = mean_and_error(sums.real[:, 1:])
        quiet(axes, grid=True)
        axes.axhline(0, color=PALETTE[-1], lw=0.8)
        axes.errorbar(_M[1:], mean, 1.96 * se, fmt="o", ms=3, lw=1, color=PALETTE[0])
        axes.set_xlabel("frequency m (cycles per unit)")
        entitle(axes, title)
    panels[0].set_ylabel("Re ⟨S_m⟩")
    return Picture(
        kind="bias-coefficients",
        caption=f"Mean of S_m with 95 % intervals, {_N} points; m = 0, where it is 1, is left out, and scales differ. "
        f"Left, importance samples: all about 0. Middle, points in the middle halves of their strata: −0.64 at m = "
        f"{_N}. Right, Poisson-disk points, which are denser at the border: above 0 at low frequencies.",
        alt="Three plots of means against the frequency. Left, all scatter about zero. Middle, zero but for a low dot "
        "at minus 0.64 for frequency 16. Right, a plateau at 0.025 for low frequencies.",
        figure=figure,
    )


def _against_n(biases: dict[str, dict[int, tuple[float, float]]]) -> Picture:
    figure = new_figure(WIDE, 3.1)
    axes = figure.subplots()
    quiet(axes, grid=True)
    axes.axhline(0, color=PALETTE[-1], lw=0.8)
    axes.axhline(_box_bias(1), color=PALETTE[1], lw=1.2, ls="--", label="−(1 − w²)/12")
    _draw_biases(axes, biases)
    count_axis(axes, "x", _COUNTS)
    axes.set(xlabel="number of points N", ylabel="N² · bias of ∫x²")
    legend_below(figure, axes, columns=4)
    return Picture(
        kind="bias",
        caption="N² times the distance of the mean estimate from the integral, with 95 % intervals. Of points in the "
        "middle halves of strata it is −1/16; of jittered points, and of the former after a random shift, 0.",
        alt="Plot against N. Dots of points in the middle halves of strata lie on a level line at minus 0.0625, those "
        "of jittered and of shifted points about zero; intervals of the shifted ones grow with N.",
        figure=figure,
    )


def _draw_biases(axes: Axes, biases: dict[str, dict[int, tuple[float, float]]]) -> None:
    labels = ("jittered", "middle halves of strata", "middle halves, shifted")
    n = np.array(_COUNTS)
    for k, (label, values) in enumerate(zip(labels, biases.values(), strict=True)):
        mean, se = n**2 * np.array(list(values.values())).T
        axes.errorbar(
            n * 1.04 ** (k - 1), mean, 1.96 * se,
            fmt=("o", "s", "^")[k], ms=4, lw=1, color=PALETTE[k], label=label,
        )  # fmt: skip
