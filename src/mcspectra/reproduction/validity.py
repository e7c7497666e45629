"""Validity of three formulas of the variance: predictions divided by the exact variance.

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
from mcspectra.plots.description import Axis, Heatmap, Panel, Plot, Scale, TextMark
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, about
from mcspectra.reproduction.panels import plot_of

__all__ = ["exhibit"]

N = 16
DENSITY = "linear(slope=-1.8)"
_FREQUENCIES = np.arange(-8, 9)
_COEFFICIENTS = {0: 1.0, 1: -0.5, 8: -0.25j}  # f(x) = 1 − cos 2πx + ½ sin 16πx
FORMULAS = ("∫ over real ν", "Σ over integer m", "three terms")


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
    ValidityCase("homogenized, p = 1", "jittered | shift", False),
    ValidityCase("not homogenized, p = 1", "jittered", False),
    ValidityCase("importance, random", "random", True),
    ValidityCase("importance, jittered", "jittered", True),
)


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Compute the predictions of three formulas for four kinds of points."""
    realizations = 40_000 if quick else 200_000
    variances = [_variance(case, realizations, seed) for case in CASES]
    ratios = np.array(
        [
            [
                _predicted(row, case) / variance.value
                for case, variance in zip(CASES, variances, strict=True)
            ]
            for row in range(3)
        ]
    )
    return Exhibit(
        numbers={
            "N": N,
            "times": number(variances[0].value / variances[1].value, 2),
            "random": number(float(ratios[1, 2]), 3),
            "weighted": number(float(ratios[1, 3]), 3),
        },
        plots=(
            _checklist("valid-before", ratios[:2], FORMULAS[:2], variances),
            _checklist("valid-now", ratios, FORMULAS, variances),
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
                        expected=_predicted(2, case),
                        digits=4,
                    )
                    for case, variance in zip(CASES, variances, strict=True)
                ),
            ),
        ),
    )


def integrand() -> mcs.Integrand:
    """Return f(x) = 1 − cos 2πx + ½ sin 16πx."""

    def f(x: Array) -> Array:
        x = 2 * np.pi * x[..., 0]
        return np.asarray(1.0 - np.cos(x) + 0.5 * np.sin(8 * x))

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
    if row == 2:
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


def _checklist(
    kind: str, ratios: Array, names: tuple[str, ...], variances: Sequence[Measured]
) -> Plot:
    """Return a table of ratios with a row per case. Orange cells mark formulas that do not hold."""
    shown = ratios.T[::-1]
    wrong = (np.abs(np.log(shown)) > np.log(1.1)).astype(float)
    scale = Scale(
        kind="names",
        names=("valid: prediction = variance", "not valid"),
        colors=("#CFE8DC", "#F5C9A9"),
    )
    x, y = np.arange(len(names), dtype=float), np.arange(len(CASES), dtype=float)
    texts = tuple(
        TextMark(x=float(i), y=float(j), text=f"× {number(float(shown[j, i]), 3)}", side="middle")
        for j in range(len(CASES))
        for i in range(len(names))
    )
    columns = Axis(low=-0.5, high=len(names) - 0.5, ticks=dict(zip(x.tolist(), names, strict=True)))
    titles = [
        f"{case.title} ({number(each.value, 2)})"
        for case, each in reversed(list(zip(CASES, variances, strict=True)))
    ]
    rows = Axis(low=-0.5, high=len(CASES) - 0.5, ticks=dict(zip(y.tolist(), titles, strict=True)))
    image = Heatmap(values=wrong, x=x, y=y, scale=scale, name="valid")
    panel = Panel(
        marks=(image, *texts),
        x=columns,
        y=rows,
        title="prediction / variance (in brackets: variance)",
    )
    return plot_of(kind, panel)
