"""The bias of an estimate is the sum of f's coefficients times the means of S; unbiased sets have none."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, Mark, Panel, Plot, Rule
from mcspectra.plots.scales import count_axis
from mcspectra.plots.style import PALETTE
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, largest_distance, mean_and_error
from mcspectra.reproduction.panels import whiskers

__all__ = ["exhibit"]

N = 16
DENSITY = "linear(slope=1)"
_UNBIASED = ("random", "jittered", "sobol | owen")
WIDTH = 0.5
BOXES = f"box-jitter(width={WIDTH})"
BOUNDED = "poisson-disk(boundary='bounded')"
_M = np.arange(33)
_COUNTS = (2, 4, 8, 16)


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure ⟨S_m⟩ of sets with and without bias, and the bias of an integral of x²."""
    realizations = 2000 if quick else 20_000
    weighted = {name: sums(name, realizations, seed, DENSITY) for name in _UNBIASED}
    boxes, bounded, disks = (sums(s, realizations, seed) for s in (BOXES, BOUNDED, "poisson-disk"))
    biases = {
        label: {n: _bias(name, n, 20 * realizations, seed) for n in _COUNTS}
        for label, name in (
            ("jittered", "jittered"),
            ("middle halves of strata", BOXES),
            ("middle halves, shifted", f"{BOXES} | shift"),
        )
    }
    found = biases["middle halves of strata"][N]
    mean, bias = number(float(boxes.mean(axis=0)[N].real)), number(found[0])
    return Exhibit(
        numbers={"N": N, "mean": mean, "bias": bias},
        plots=(_means(weighted["jittered"], boxes, bounded), _against_n(biases)),
        claims=(
            *(_no_mean(name, each) for name, each in weighted.items()),
            _box_mean(boxes),
            _bounded_border(bounded),
            _toroidal_border(disks),
            Claim(
                f"Points in the middle halves of {N} strata estimate ∫x² with the bias −(1 − w²)/(12N²), w = ½.",
                Measured.normal(*found),
                expected=box_bias(N),
                digits=5,
            ),
            _summed_bias(),
            _midpoint_rule(),
            largest_distance(
                f"A random shift removes the bias of those points, N = {_COUNTS[0]} … {_COUNTS[-1]}",
                *np.array(list(biases["middle halves, shifted"].values())).T,
            ),
        ),
    )


def sums(name: str, realizations: int, seed: int, density: str = "uniform") -> Array:
    """S_m at m = 0 … 32 of points in 1-D: complex (realizations, 33)."""
    p = mcs.density(density, 1)
    x = p.sample(mcs.sampler(name, 1).draw(N, realizations=realizations, rng=seed))
    weights = 1.0 / p.pdf(x)
    return np.stack([(weights * np.exp(-2j * np.pi * m * x[..., 0])).mean(axis=1) for m in _M], -1)


def _no_mean(name: str, found: Array) -> Claim:
    parts = np.concatenate([found.real - (_M == 0), found.imag[:, 1:]], axis=1)
    return largest_distance(
        f"Importance samples of {name} points, p = ½ + x, have ⟨S₀⟩ = 1 and ⟨S_m⟩ = 0, m = 1 … {_M[-1]}, real and "
        "imaginary parts",
        *mean_and_error(parts),
    )


def _real_mean(found: Array, m: int) -> Measured:
    """Re ⟨S_m⟩."""
    return Measured.mean(found[:, m].real)


def _box_mean(found: Array) -> Claim:
    """Each point is uniform in a box about the center of its stratum: (−1)^k sinc(π k w) at m = kN."""
    return Claim(
        f"Points in the middle halves of {N} strata have ⟨S_m⟩ = −sinc(π/2) at m = {N}.",
        _real_mean(found, N),
        expected=-float(np.sinc(WIDTH)),
        digits=5,
    )


def _bounded_border(found: Array) -> Claim:
    return Claim(
        "Poisson-disk points whose disks stick out of the domain are more likely near its border: Re ⟨S₁⟩ > 0.",
        _real_mean(found, 1),
        above=0.0,
    )


def _toroidal_border(found: Array) -> Claim:
    return Claim(
        "With distances around the border, Re ⟨S₁⟩ of Poisson-disk points is 0.",
        _real_mean(found, 1),
        expected=0.0,
    )


def _bias(name: str, n: int, realizations: int, seed: int) -> tuple[float, float]:
    """Mean and standard error of I_N − 1/3 for f = x²."""
    x = mcs.sampler(name, 1).draw(n, realizations=realizations, rng=seed)[..., 0]
    mean, se = mean_and_error((x**2).mean(axis=1) - 1 / 3)
    return float(mean), float(se)


def box_bias(n: int, width: float = WIDTH) -> float:
    """Boxes of the width w/n about the centers: ⟨x²⟩ is less than with n strata by (1 − w²)/(12n²)."""
    return -(1 - width**2) / (12 * n**2)


def _summed_bias() -> Claim:
    """Σ_{m ≠ 0} conj(f_m) ⟨S_m⟩: ⟨S⟩ lives on multiples of N, and imaginary parts of ±m cancel."""
    k = np.arange(1, 20_001)
    coefficients = 1 / (2 * (np.pi * k * N) ** 2)
    total = float((2 * coefficients * (-1.0) ** k * np.sinc(WIDTH * k)).sum())
    return Claim(
        "That bias is Σ f_m* ⟨S_m⟩ over m ≠ 0: relative difference.",
        total / box_bias(N) - 1,
        at_most=1e-10,
        note="The terms beyond the last of 20 000 multiples of N are below that.",
    )


def _midpoint_rule() -> Claim:
    """Regular points at the centers: w = 0."""
    x = {n: mcs.sampler("regular", 1).draw(n)[0, :, 0] for n in _COUNTS}
    errors = [(v**2).mean() - 1 / 3 - box_bias(n, 0.0) for n, v in x.items()]
    return Claim(
        f"Regular points, the midpoint rule, have no variance at all but the bias −1/(12N²), N = {_COUNTS[0]} … "
        f"{_COUNTS[-1]}: largest difference.",
        float(np.abs(errors).max()),
        at_most=1e-15,
    )


def _means(weighted: Array, boxes: Array, bounded: Array) -> Plot:
    titles = ("jittered, p = ½ + x", "middle halves of strata", "Poisson disk, bounded")
    panels = []
    for k, (title, found) in enumerate(zip(titles, (weighted, boxes, bounded), strict=True)):
        mean, se = mean_and_error(found.real[:, 1:])
        ends = np.stack([mean - 1.96 * se, mean + 1.96 * se], axis=-1)
        marks = (Rule(at=0.0, color=PALETTE[-1]), whiskers(_M[1:], mean, ends, 0, "", 3.0))
        x = Axis(label="frequency m (cycles per unit)")
        y = Axis(label="" if k else "Re ⟨S_m⟩")
        panels.append(Panel(marks=marks, x=x, y=y, title=title, grid=True))
    return Plot(kind="bias-coefficients", panels=tuple(panels), columns=3, height=0.85, wide=True)


def _against_n(biases: Mapping[str, Mapping[int, tuple[float, float]]]) -> Plot:
    n = np.array(_COUNTS, float)
    marks: list[Mark] = [
        Rule(at=0.0, color=PALETTE[-1]),
        Rule(at=box_bias(1), color=PALETTE[1], dashes="--", width=1.2, label="−(1 − w²)/12"),
    ]
    for k, (label, values) in enumerate(biases.items()):
        mean, se = n**2 * np.array(list(values.values())).T
        ends = np.stack([mean - 1.96 * se, mean + 1.96 * se], axis=-1)
        marks.append(whiskers(n * 1.04 ** (k - 1), mean, ends, k, label))
    x, y = count_axis("number of points N", _COUNTS), Axis(label="N² · bias of ∫x²")
    return Plot(
        kind="bias", panels=(Panel(marks=tuple(marks), x=x, y=y, grid=True),), height=0.4, wide=True
    )
