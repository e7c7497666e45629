"""Validity of formulas of the variance: predictions divided by the exact variance.

The integrand has only the frequencies 0, 1 and 8, so sums over frequencies are finite.
With N = 16 strata, the frequencies 8 and −8 are correlated without a random shift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import final

import numpy as np

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, BarChart, Heatmap, Panel, Scale, TextMark
from mcspectra.plots.scales import name_axis
from mcspectra.plots.style import PALETTE
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, about, correction
from mcspectra.reproduction.panels import plot_of

__all__ = ["exhibit"]

N = 16
DENSITY = "linear(slope=1.5)"
_FREQUENCIES = np.arange(-8, 9)
_COEFFICIENTS = {0: 1.0, 1: 0.5j, 8: -0.25j}  # f(x) = 1 − sin 2πx + ½ sin 16πx
FORMULAS = ("∫ over real ν", "Σ over integer m", "3 terms, printed", "3 terms, ⟨Sₘ Sₗ*⟩")


@final
@dataclass(frozen=True)
class ValidityCase:
    """A case in the checklists of the slides: a sampler, with or without importance sampling."""

    title: str
    sampler: str
    weighted: bool

    @property
    def density(self) -> str | None:
        """Spec of the density, or None if it is constant."""
        return DENSITY if self.weighted else None


CASES = (
    ValidityCase("homogenized", "jittered | shift", False),
    ValidityCase("jittered", "jittered", False),
    ValidityCase("random, by p", "random", True),
    ValidityCase("jittered, by p", "jittered", True),
)


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Compute the predictions of four formulas for four kinds of points."""
    realizations = 40_000 if quick else 200_000
    variances = [_variance(case, realizations, seed) for case in CASES]
    ratios = np.array(
        [
            [
                _predicted(row, case) / variance.value
                for case, variance in zip(CASES, variances, strict=True)
            ]
            for row in range(len(FORMULAS))
        ]
    )
    titles = [case.title for case in CASES]
    return Exhibit(
        numbers={
            "N": N,
            "times": number(variances[0].value / variances[1].value, 2),
            "random": number(float(ratios[1, 2]), 3),
            "weighted": number(float(ratios[1, 3]), 3),
            "printed": number(float(ratios[2, 2]), 3),
            "printed_jittered": number(float(ratios[2, 3]), 3),
        },
        plots=(
            plot_of(
                "valid-before",
                _checklist(ratios[:2].T, titles, FORMULAS[:2]),
                _cost(variances[:2], titles[:2]),
            ),
            plot_of("valid-now", _checklist(ratios, FORMULAS, titles)),
        ),
        claims=(
            Claim(
                "Homogenized points, p = 1: the sum over integer frequencies divided by the "
                "variance.",
                Measured(
                    1.0,
                    variances[0].low / variances[0].value,
                    variances[0].high / variances[0].value,
                )
                / (1 / ratios[1, 0]),
                expected=1.0,
            ),
            _fails(
                "Homogenized points, p = 1: the integral over real frequencies is not the "
                "variance (finite domain)",
                ratios[0, 0],
                variances[0],
            ),
            *(
                _fails(
                    f"{case.title}: the sum over integer frequencies is not the variance",
                    ratios[1, k],
                    variances[k],
                )
                for k, case in enumerate(CASES)
                if k
            ),
            *about(
                "valid-now",
                *(
                    Claim(
                        f"{case.title.capitalize()}: the three terms "
                        "predict the measured variance.",
                        variance,
                        expected=_predicted(3, case),
                        digits=4,
                    )
                    for case, variance in zip(CASES, variances, strict=True)
                ),
                *(
                    correction(
                        _fails(
                            f"{CASES[k].title}: the three terms with ⟨S_m* S_l⟩, as printed, are "
                            "not the variance",
                            ratios[2, k],
                            variances[k],
                        )
                    )
                    for k in (2, 3)
                ),
            ),
        ),
    )


def integrand() -> mcs.Integrand:
    """Return f(x) = 1 − sin 2πx + ½ sin 16πx."""

    def f(x: Array) -> Array:
        x = 2 * np.pi * x[..., 0]
        return np.asarray(1.0 - np.sin(x) + 0.5 * np.sin(8 * x))

    return mcs.Integrand.from_function(f, dims=1, integral=1.0)


def coefficients(nu: Array) -> Array:
    """Return ∫ f(x) exp(−2πiνx) dx over [0, 1] at real frequencies."""
    total = np.zeros(len(nu), complex)
    for m, value in _COEFFICIENTS.items():
        for k in {m, -m}:
            own = value if k == m else np.conj(value)
            total += own * np.exp(-1j * np.pi * (nu - k)) * np.sinc(nu - k)
    return total


@cache
def _predicted(row: int, case: ValidityCase) -> float:
    """Return the variance that a formula predicts."""
    m = _FREQUENCIES[:, None].astype(float)
    f = coefficients(m[:, 0])
    c = mcs.spectra.closed_form_covariance(case.sampler, N, m[:, None], m[None], case.density)
    if row >= 2:
        # As printed, the product of the coefficients of S has the other conjugate
        c = c.conj() if row == 2 else c
        return float((f.conj()[:, None] * f * c).sum().real)
    if row == 1:
        power = np.diag(c).real * np.abs(f) ** 2
        return float(power[_FREQUENCIES != 0].sum())
    # Sum over half-integers. Between integers the mean ⟨S⟩ is not zero, so the power has bias
    nu = 0.5 * np.arange(1.0, 4001.0)
    return float(np.abs(coefficients(nu)) ** 2 @ _power(case, nu))


def _power(case: ValidityCase, nu: Array) -> Array:
    """Return ⟨|S|²⟩ at real frequencies. For warped strata, |⟨S⟩|² is a lower bound."""
    if case.weighted and case.sampler == "jittered":
        return np.asarray(np.sinc(nu) ** 2)
    base = case.sampler.partition(" ")[0]
    return np.asarray(mcs.closed_form_power(base, N, nu[:, None], case.density))


def _variance(case: ValidityCase, realizations: int, seed: int) -> Measured:
    """Measure the variance of the estimator."""
    estimator = mcs.Estimator(integrand(), case.density)
    curve = mcs.convergence(estimator, case.sampler, [N], realizations=realizations, rng=seed)
    return Measured.of(curve.isel(n=0), "variance", log=True)


def _fails(statement: str, ratio: float, variance: Measured) -> Claim:
    """Return the statement, to be tested, that a prediction is wrong by more than ten percent."""
    ends = (variance.value / variance.high, variance.value / variance.low)
    measured = Measured(ratio, ratio * ends[0], ratio * ends[1], log=True)
    bound = {"above": 1.1} if ratio > 1 else {"below": 0.9}
    return Claim(f"{statement[0].upper()}{statement[1:]}: ratio.", measured, **bound)  # type: ignore[arg-type]


def _checklist(ratios: Array, rows: Sequence[str], columns: Sequence[str]) -> Panel:
    """Return a table of ratios. Orange cells mark formulas that do not hold."""
    wrong = (np.abs(np.log(ratios)) > np.log(1.1)).astype(float)
    scale = Scale(
        kind="names",
        names=("valid: prediction = variance", "not valid"),
        colors=("#CFE8DC", "#F5C9A9"),
    )
    x, y = np.arange(float(len(columns))), np.arange(float(len(rows)))
    texts = tuple(
        TextMark(x=float(i), y=float(j), text=f"× {number(float(ratios[j, i]), 3)}", side="middle")
        for j in range(len(rows))
        for i in range(len(columns))
    )
    image = Heatmap(values=wrong, x=x, y=y, scale=scale, name="valid")
    return Panel(
        marks=(image, *texts),
        x=Axis(
            low=-0.5, high=len(columns) - 0.5, ticks=dict(zip(x.tolist(), columns, strict=True))
        ),
        y=Axis(
            low=-0.5,
            high=len(rows) - 0.5,
            ticks=dict(zip(y.tolist(), rows, strict=True)),
            flipped=True,
        ),
        title="prediction / variance",
    )


def _cost(variances: Sequence[Measured], titles: Sequence[str]) -> Panel:
    """Return bars of the variances with and without homogenization, p = 1."""
    value, low, high = np.array([(v.value, v.low, v.high) for v in variances]).T * 1e3
    at = np.arange(float(len(value)))
    bars = BarChart(
        at=at, value=value, low=low, high=high, color=PALETTE[0], lying=True, thickness=0.6
    )
    texts = (
        TextMark(x=float(end), y=float(place), text=number(float(v), 2))
        for place, v, end in zip(at, value, high, strict=True)
    )
    return Panel(
        marks=(bars, *texts),
        x=Axis(label="variance · 10³", low=0.0, high=1.15 * float(high.max())),
        y=name_axis(titles),
    )
