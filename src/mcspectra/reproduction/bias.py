"""The bias of an estimate: the sum of the integrand's coefficients times the means of S_m."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, BarChart, Dots, Line, Mark, Panel, ReferenceLine
from mcspectra.plots.scales import count_axis, name_axis, unit_axis
from mcspectra.plots.style import INK, PALETTE
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, largest_distance, mean_and_error
from mcspectra.reproduction.panels import plot_of, whiskers

__all__ = ["exhibit"]

N = 16
DENSITY = "linear(slope=1)"
_UNBIASED = ("random", "jittered", "sobol | owen")
WIDTH = 0.5
BOXES = f"box-jitter(width={WIDTH})"
BOUNDED = "poisson-disk(boundary='bounded')"
_M = np.arange(33)
_COUNTS = (2, 4, 8, 16)
# With this number of realizations, the bias in the figure exceeds ten standard errors
_DRAWN = 100_000
_KINDS = ("importance samples", "middle halves")  # kinds of points in the figure
_BINS = 4 * N  # four bins per stratum, so that its middle half is exactly two bins


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure the means ⟨S_m⟩ of biased and unbiased sets, and the bias of the integral of x²."""
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

    # Sum conj(f_m) ⟨S_m⟩ over m ≠ 0. Only multiples of N contribute.
    # The imaginary parts at m and −m cancel
    k = np.arange(1, 20_001)
    coefficients = 1 / (2 * (np.pi * k * N) ** 2)
    total = float((2 * coefficients * (-1.0) ** k * np.sinc(WIDTH * k)).sum())

    # Compare with regular points at the centers of the strata (w = 0)
    middles = {n: mcs.sampler("regular", 1).draw(n)[0, :, 0] for n in _COUNTS}
    errors = [(v**2).mean() - 1 / 3 - box_bias(n, 0.0) for n, v in middles.items()]

    # Plot for unbiased and biased points how the density of the points determines the bias
    plain, none = _way_to_the_bias(
        ("jittered", DENSITY), ("jittered, by p", "importance samples", "no bias"),
        seed, PALETTE[0], below=False,
    )  # fmt: skip
    gaps, some = _way_to_the_bias(
        (BOXES, "uniform"), ("middle halves", "middle halves of strata", "bias"),
        seed, PALETTE[1], below=True,
    )  # fmt: skip
    zero = ReferenceLine(at=0.0, color=PALETTE[6])
    away = Panel(
        marks=(zero, _with_errors(_M[1:], mean_and_error(bounded.real[:, 1:]), 0, "", 3.0)),
        x=Axis(label="frequency m (cycles per unit)"),
        y=Axis(label="Re ⟨S_m⟩"),
        title="Poisson disk, bounded",
        grid=True,
    )
    n, known = np.array(_COUNTS, float), "−(1 − w²)/12"
    rule = ReferenceLine(at=box_bias(1), color=PALETTE[1], dashes="--", width=1.2, label=known)
    dots = [
        _with_errors(n * 1.04 ** (k - 1), n**2 * np.array(list(values.values())).T, k, label)
        for k, (label, values) in enumerate(biases.items())
    ]
    x, y = count_axis("number of points N", _COUNTS), Axis(label="N² · bias of ∫x²")
    scaled = Panel(marks=(zero, rule, *dots), x=x, y=y, grid=True)
    return Exhibit(
        numbers={
            "N": N,
            "mean": number(float(boxes.mean(axis=0)[N].real)),
            "bias": number(found[0]),
        },
        plots=(
            plot_of("bias-coefficients", plain[1], gaps[1], _sums_panel((none, some), box_bias(N))),
            plot_of("bias-steps", *plain, *gaps),
            plot_of("bias-bounded", away),
            plot_of("bias", scaled),
        ),
        claims=(
            *(
                largest_distance(
                    f"Importance samples from {name} points, p = ½ + x, have ⟨S₀⟩ = 1 and "
                    f"⟨S_m⟩ = 0, m = 1 … {_M[-1]}, real and imaginary parts",
                    *mean_and_error(
                        np.concatenate([each.real - (_M == 0), each.imag[:, 1:]], axis=1)
                    ),
                )
                for name, each in weighted.items()
            ),
            # The points are uniform in boxes of width w/N around the centers of strata.
            # Therefore ⟨S_m⟩ at m = kN is (−1)^k sinc(π k w)
            Claim(
                f"Points in the middle halves of {N} strata have ⟨S_m⟩ = −sinc(π/2) at m = {N}.",
                Measured.mean(boxes[:, N].real),
                expected=-float(np.sinc(WIDTH)),
                digits=5,
            ),
            Claim(
                "Poisson-disk points without periodic distances are denser near the border of the "
                "domain: Re ⟨S₁⟩ > 0.",
                Measured.mean(bounded[:, 1].real),
                above=0.0,
            ),
            Claim(
                "With periodic distances, Re ⟨S₁⟩ of Poisson-disk points is 0.",
                Measured.mean(disks[:, 1].real),
                expected=0.0,
            ),
            Claim(
                f"Points in the middle halves of {N} strata estimate ∫x² with the bias "
                "−(1 − w²)/(12N²), w = ½.",
                Measured.normal(*found),
                expected=box_bias(N),
                digits=5,
            ),
            Claim(
                "This bias equals Σ f_m* ⟨S_m⟩ over m ≠ 0: relative difference.",
                total / box_bias(N) - 1,
                at_most=1e-10,
                note="The terms beyond the last of 20 000 multiples of N are below the limit.",
            ),
            Claim(
                "Regular points (the midpoint rule) have no variance, but the bias −1/(12N²), "
                f"N = {_COUNTS[0]} … {_COUNTS[-1]}: largest difference.",
                float(np.abs(errors).max()),
                at_most=1e-15,
            ),
            largest_distance(
                "A random shift removes the bias of points in the middle halves of strata, "
                f"N = {_COUNTS[0]} … {_COUNTS[-1]}",
                *np.array(list(biases["middle halves, shifted"].values())).T,
            ),
        ),
    )


def sums(name: str, realizations: int, seed: int, density: str = "uniform") -> Array:
    """Return S_m of 1-D points at m = 0 … 32: complex, (realizations, 33)."""
    x, weights = _weighted(name, realizations, seed, density)
    return np.stack([(weights * np.exp(-2j * np.pi * m * x)).mean(axis=1) for m in _M], -1)


def _weighted(name: str, realizations: int, seed: int, density: str) -> tuple[Array, Array]:
    """Return points and their weights 1/p, both (realizations, N)."""
    p = mcs.density(density, 1)
    x = p.sample(mcs.sampler(name, 1).draw(N, realizations=realizations, rng=seed))
    return x[..., 0], 1.0 / p.pdf(x)


def _way_to_the_bias(
    points: tuple[str, str], titles: tuple[str, str, str], seed: int, color: str, *, below: bool
) -> tuple[tuple[Panel, Panel, Panel], Measured]:
    """Plot the mean of the sampling function, the means of S_m, and the sum that is the bias.

    `points` is a pair: the name of a sampler, and a density.
    Only the lower row of panels has labels on its x axes (`below` is True).
    Also return N² times the measured bias of ∫x².
    """
    name, density = points
    x, weights = _weighted(name, _DRAWN, seed, density)
    edges = np.linspace(0.0, 1.0, _BINS + 1)
    height = np.histogram(x, edges, weights=weights)[0] * _BINS / x.size
    middles = edges[:-1] + 0.5 / _BINS
    bars = BarChart(at=middles, value=height, color=color, thickness=1.0 / _BINS, opacity=0.6)
    first = Panel(
        marks=(bars, ReferenceLine(at=1.0, color=INK, dashes="--", width=1.0)),
        x=unit_axis("x" if below else ""),
        y=Axis(label="⟨S(x)⟩", low=0.0, high=2.3),
        title=titles[0],
    )
    # Powers of exp(−2πi x) by repeated multiplication, since exponentials are slow
    step, power, sums_ = np.exp(-2j * np.pi * x), weights.astype(complex), list[Array]()
    for _ in _M:
        sums_.append(power.mean(axis=1))
        power *= step
    found = np.stack(sums_, axis=-1)
    mean, se = mean_and_error(found.real)
    ticks = {float(v): str(v) for v in (0, N, 2 * N)}
    second = Panel(
        marks=(
            ReferenceLine(at=0.0, color=INK, width=0.7),
            BarChart(at=_M.astype(float), value=mean, color=color, thickness=0.0),
            Dots(
                x=_M.astype(float), y=mean, low=mean - 1.96 * se, high=mean + 1.96 * se,
                color=color, size=4.0,
            ),
        ),
        x=Axis(label="frequency m", ticks=ticks),
        y=Axis(label="⟨Sₘ⟩", low=-0.8, high=1.15),
        title=titles[1],
    )  # fmt: skip
    # For f = x², f_0 is 1/3 and f_m is 1/(2π²m²) + i/(2πm). Frequencies m and −m are added
    m = _M[1:]
    coefficients = np.append(1 / 3, 1 / (np.pi * m) ** 2 + 1j / (np.pi * m))
    parts = (coefficients.conj() * found).real
    parts[:, 0] -= 1 / 3
    total, se = N**2 * np.array(mean_and_error(np.cumsum(parts, axis=1)))
    measured = Measured.mean(N**2 * ((weights * x**2).mean(axis=1) - 1 / 3))
    third = Panel(
        marks=(
            ReferenceLine(at=0.0, color=INK, width=0.7),
            Line(x=_M, y=total, low=total - 1.96 * se, high=total + 1.96 * se, color=color,
                 step=True, width=2.0, label=f"sum over |m| ≤ M, {titles[0]}"),
            ReferenceLine(
                at=measured.value, color=INK, dashes="--", width=1.4, label="measured bias"
            ),
        ),
        x=Axis(label="largest frequency M" if below else "", ticks=ticks),
        y=Axis(label="N² · bias of ∫x²", low=-0.09, high=0.04),
        title=titles[2],
    )  # fmt: skip
    return (first, second, third), measured


def _sums_panel(measured: Sequence[Measured], biased: float) -> Panel:
    """Return the measured biases of both kinds of points, and the sums of f_m* ⟨S_m⟩ − f_0."""
    at = np.arange(2.0)
    marks: list[Mark] = [ReferenceLine(at=0.0, axis="x", color=INK, width=0.7)]
    for k, found in enumerate(measured):
        value, low, high = np.array([[found.value], [found.low], [found.high]])
        marks.append(
            Dots(
                x=value, y=at[k : k + 1] + 0.18, low=low, high=high, across=True,
                color=PALETTE[k], size=6.0, label=f"measured, {_KINDS[k]}",
            )
        )  # fmt: skip
    sums_ = np.array([0.0, N**2 * biased])
    marks.append(
        Dots(x=sums_, y=at - 0.18, color=INK, marker="D", size=6.0, label="Σ fₘ* ⟨Sₘ⟩ − f₀")
    )
    return Panel(
        marks=tuple(marks),
        x=Axis(label="N² · bias of ∫x²", low=-0.09, high=0.04),
        y=name_axis(["", ""]),
        title="bias",
        grid=True,
    )


def _bias(name: str, n: int, realizations: int, seed: int) -> tuple[float, float]:
    """Return the mean and the standard error of I_N − 1/3 for f = x²."""
    x = mcs.sampler(name, 1).draw(n, realizations=realizations, rng=seed)[..., 0]
    mean, se = mean_and_error((x**2).mean(axis=1) - 1 / 3)
    return float(mean), float(se)


def _with_errors(
    x: Array, found: Sequence[Array] | Array, k: int, label: str, size: float = 4.0
) -> Dots:
    """Return means as dots, with 95 % intervals from their standard errors."""
    y, se = found
    return whiskers(x, y, np.stack([y - 1.96 * se, y + 1.96 * se], axis=-1), k, label, size)


def box_bias(n: int, width: float = WIDTH) -> float:
    """Return the bias of ∫x² for points in boxes of width w/n around the centers of n strata."""
    return -(1 - width**2) / (12 * n**2)
