"""The variance of homogenised samples is the power term alone."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mcspectra.integrands.registry import integrand
from mcspectra.report.figures.maps import cross_matrices
from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._terms import interval_of, quotient
from mcspectra.report.reproduction.base import (
    Exhibit,
    Finding,
    Interval,
    agreement,
    comparison,
    identity,
)
from mcspectra.report.style import INK, LABEL_SIZE, PALETTE, WIDE, legend_below, new_figure, quiet

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["exhibit"]

_SAMPLERS = ("jittered", "latin-hypercube", "poisson-disk", "sobol | owen")
_BELL = "gaussian(center=[0.3, 0.35], width=0.2)"
_N = 64
_N1 = 16
_HALF_WIDTH = 24

Terms: TypeAlias = "dict[str, xr.Dataset]"


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure the terms of four samplers with and without a shift, and sum closed forms."""
    realizations = 600 if quick else 10_000
    plain = {name: _terms(name, realizations, seed) for name in _SAMPLERS}
    shifted = {name: _terms(f"{name} | shift", realizations, seed) for name in _SAMPLERS}
    findings = (
        *(_closed_sum(n) for n in (16, 256)),
        *(_no_third(name, data) for name, data in shifted.items()),
        *(_all_of_it(name, data) for name, data in shifted.items()),
        _no_first(shifted),
        _only_then(),
        _only_then_measured(plain["jittered"]),
    )
    return Exhibit(
        name="homogenised-formula",
        title="The variance of homogenised samples",
        slide="Fourier series based Variance Formulation; Variance Formulation: For Homogenized Samples: Var(I_N) is "
        "the sum over m ≠ 0 of f_m* f_m ⟨S_m* S_m⟩.",
        formula=r"\mathrm{Var}(I_N) = \sum_{m \neq 0} f_m^* f_m \, \langle S_m^* S_m \rangle",
        caption=_caption(plain, shifted),
        pictures=(_ratios(plain, shifted), _matrices(200 if quick else 2000, seed)),
        findings=findings,
    )


def _terms(name: str, realizations: int, seed: int) -> xr.Dataset:
    from mcspectra.variance.terms import variance_terms

    return variance_terms(
        _BELL, name, _N, half_width=_HALF_WIDTH, realizations=realizations, rng=seed
    )


def _ratio(data: xr.Dataset) -> tuple[float, Interval]:
    """Power term over measured variance, with the errors of both."""
    power, (low, high) = quotient(data, "power_term", float(data["measured_variance"]))
    ends = interval_of(data, "measured_variance")
    half = math.hypot(math.log(ends[1] / ends[0]) / 2, (high - low) / (2 * power))
    return power, (power * math.exp(-half), power * math.exp(half))


def _caption(plain: Terms, shifted: Terms) -> str:
    of = [
        ", ".join(f"{number(_ratio(d)[0])} ({name})" for name, d in data.items())
        for data in (plain, shifted)
    ]
    return (
        f"Σ |f_m|² ⟨|S_m|²⟩ over the measured variance, for {_N} points of four samplers on a Gaussian bell: "
        f"{of[0]} as they are, {of[1]} after a random shift. The shift leaves the power and takes away the third "
        "term, so that the formula holds, and the variance is what the formula says: often a larger one."
    )


def _closed_sum(n: int) -> Finding:
    """f = x: |f_m|² = 1/(4π²m²); both closed forms, the tail beyond by the integral test."""
    from mcspectra.spectra.closed_forms import closed_form_power

    m = np.arange(1.0, 2**16 + 1)
    total = 2 * float((closed_form_power("jittered", n, m[:, None]) / (4 * np.pi**2 * m**2)).sum())
    expected = 1 / (6 * n**2) - 1 / (12 * n**3)
    # What is beyond has at most the power 1/n: Σ 1/m² < 1/2^16, relatively 6n²/(2π²n) / 2^16.
    tail = 2 / (4 * np.pi**2 * n * m[-1]) / expected
    return identity(
        f"f(x) = x and {n} jittered points, shifted: the sum is 1/(6N²) − 1/(12N³): relative difference.",
        error=total / expected - 1.0,
        at_most=float(tail),
        note=f"Limit: what frequencies beyond {int(m[-1])} add at most.",
    )


def _no_third(name: str, data: xr.Dataset) -> Finding:
    scale = float(data["predicted_variance"])
    value, interval = quotient(data, "cross_term", scale)
    return comparison(
        f"{name}, shifted: the third term is 0, as a share of the variance.",
        expected=0.0,
        measured=value,
        interval=interval,
    )


def _all_of_it(name: str, data: xr.Dataset) -> Finding:
    value, interval = _ratio(data)
    beyond = _beyond() / _N / float(data["measured_variance"])
    return comparison(
        f"{name}, shifted: the sum over m ≠ 0 is the measured variance: their ratio.",
        expected=1.0,
        measured=value,
        interval=interval,
        tolerance=beyond,
        scale="log",
        text=f"1 ± {number(beyond, 2)}",
        note=f"Tolerance: what f has beyond |m| = {_HALF_WIDTH}, at the power 1/N of random points.",
    )


@cache
def _beyond() -> float:
    """∫f² less Σ |f_m|² up to the half width; a Gaussian's square has a width smaller by √2."""
    square = _BELL.replace("width=0.2", f"width={0.2 / math.sqrt(2)}")
    power = np.abs(integrand(_BELL, 2).fourier_grid(_HALF_WIDTH)) ** 2
    return float(np.squeeze(integrand(square, 2).integral)) - float(power.sum())


def _no_first(shifted: Terms) -> Finding:
    return identity(
        "The first term is 0, as weights are all 1/N: largest, as a share of the variance.",
        error=max(float(d["dc_term"]) / float(d["measured_variance"]) for d in shifted.values()),
        at_most=1e-15,
    )


def _only_then() -> Finding:
    """(1/(6N²) − 1/(12N³)) / (1/(12N³)) = 2N − 1, of what quadrature says of the variance."""
    from mcspectra.variance.exact import exact_variance

    power = 1 / (6 * _N**2) - 1 / (12 * _N**3)
    ratio = power / float(exact_variance(integrand("linear", 1), "jittered", _N))
    return identity(
        f"Without the shift the sum is not the variance: on f(x) = x, 2N − 1 times that of {_N} jittered points: "
        "relative difference from this.",
        error=ratio / (2 * _N - 1) - 1.0,
        at_most=1e-9,
    )


def _only_then_measured(data: xr.Dataset) -> Finding:
    value, interval = _ratio(data)
    return agreement(
        "Jittered points that are not shifted, on the bell: the sum is more than the variance: their ratio.",
        measured=value,
        interval=interval,
        above=1.0,
        scale="log",
    )


def _ratios(plain: Terms, shifted: Terms) -> Picture:
    figure = new_figure(WIDE, 2.9)
    axes = figure.subplots()
    quiet(axes, grid=True)
    _draw(axes, plain, -0.13, PALETTE[1], "as they are")
    _draw(axes, shifted, 0.13, PALETTE[0], "shifted")
    axes.axvline(1.0, color=INK, lw=1, ls="--")
    axes.set_yticks(range(len(plain)), list(plain), fontsize=LABEL_SIZE)
    axes.set(xlabel="Σ |f_m|² ⟨|S_m|²⟩ over measured variance", ylim=(len(plain) - 0.5, -0.5))
    axes.set_xlim(left=0.0)
    legend_below(figure, axes)
    return Picture(
        kind="homogenised-formula",
        caption=f"The sum over m ≠ 0 over the measured variance of {_N} points on a Gaussian bell that the border "
        "cuts, with 95 % intervals. For shifted points it is 1.",
        alt="Two intervals for each of four samplers. Those of shifted points lie at 1; jittered and Sobol' points "
        "that are not shifted lie above it.",
        figure=figure,
    )


def _draw(axes: Axes, terms: Terms, away: float, color: str, label: str) -> None:
    for row, data in enumerate(terms.values()):
        value, (low, high) = _ratio(data)
        axes.hlines(row + away, low, high, color=color, lw=2)
        axes.plot(value, row + away, "o", ms=5, color=color, label=label if row == 0 else None)


def _matrices(realizations: int, seed: int) -> Picture:
    from mcspectra.variance.terms import variance_terms

    names = ("jittered", "jittered | shift")
    data = {
        name: variance_terms(
            integrand("linear", 1), name, _N1, half_width=32, realizations=realizations,
            rng=seed, cross_matrix=True,
        )
        for name in names
    }  # fmt: skip
    return Picture(
        kind="homogenised-matrix",
        caption=f"Cross matrix of {_N1} points on f(x) = x, estimated from {realizations} realisations: jittered "
        "points have diagonals N apart, which a shift takes away; only the main diagonal is left, and noise.",
        alt="Four square images with the frequencies m and l along the sides. On the left, stripes parallel to the "
        "main diagonal, 16 apart; after the shift the main diagonal alone, over a weak random pattern.",
        figure=cross_matrices(data),
    )
