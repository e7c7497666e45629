"""Signs of the three terms, under constant densities and importance sampling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.integrands.registry import integrand
from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._terms import interval_of, term_bars, term_finding
from mcspectra.report.reproduction.base import Exhibit, Finding, agreement, identity
from mcspectra.report.style import WIDE, new_figure

if TYPE_CHECKING:
    import xarray as xr

    from mcspectra.densities import Density
    from mcspectra.estimators import Estimator
    from mcspectra.integrands import Integrand

__all__ = ["exhibit"]

_N = 16
_FEW, _MANY = 4, 64  # half widths: f with one cycle needs no more than 1


@dataclass(frozen=True)
class Case:
    """An estimator and a sampler; `amplitude` is that of the density 1 + a cos(2πx), 0 a constant."""

    title: str
    function: str
    amplitude: float
    sampler: str


LINE = Case("f = x, p = 1, jittered", "line", 0.0, "jittered")
BAR = Case("bar, p = 1, jittered", "bar", 0.0, "jittered")
GOOD = Case("cosine, p as f, random", "cosine", -0.8, "random")
STRATIFIED = Case("cosine, p as f, jittered", "cosine", -0.8, "jittered")
BAD = Case("cosine, p against f, random", "cosine", 0.8, "random")
FLAT = Case("f = 1, p as the cosine, random", "one", -0.8, "random")
CASES = (LINE, BAR, GOOD, STRATIFIED, BAD, FLAT)


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure terms in cases that confirm the statements of the slides, and in some that do not."""
    realizations = 1000 if quick else 20_000
    of = {case: _terms(case, realizations, seed) for case in CASES}
    shifted = _terms(Case("", "line", 0.0, "jittered | shift"), realizations, seed)
    findings = (
        _second_positive([*of.values(), shifted]),
        _no_first([of[LINE], of[BAR], shifted]),
        _negative(
            "For constant PDF the third term is negative on f(x) = x, jittered points.", of[LINE]
        ),
        _counter_bar(of[BAR]),
        _counter_shift(shifted),
        *_predictions(of),
        _negative("With IS that follows f, random points, the third term is negative.", of[GOOD]),
        _negative(
            "With IS that follows f, jittered points, the third term is negative.", of[STRATIFIED]
        ),
        _positive(
            "Counter-example: with IS that is low where f is high, the third term is positive.",
            of[BAD],
            "cross_term",
        ),
        _first_adds(of[GOOD]),
        _all_first(of[FLAT]),
        _perfect(seed),
    )
    return Exhibit(
        name="importance-terms",
        title="First and third term under importance sampling",
        slide="Third Term Crucial. First term cannot be ignored for IS variance prediction. Second term is always "
        "positive. For constant PDF, first term is zero, therefore, third term is negative and reduces variance. With "
        "IS, both the first and the third term reduces variance.",
        formula=r"N \times \mathrm{third} = \mathrm{Cov}(f^2, 1/p) \quad \mathrm{(random\ points,\ covariance\ over\ "
        r"the\ domain)}",
        caption=_caption(of),
        pictures=(_bars(of),),
        findings=findings,
    )


def _function(name: str) -> Integrand:
    from mcspectra.integrands.base import Integrand

    if name == "line":
        return integrand("linear", 1)
    if name == "bar":  # edges in the middle of strata 4 and 10 of 16
        return integrand(f"disk(center={7.5 / _N}, radius={3 / _N})", 1)
    height = 0.0 if name == "one" else 1.0

    def f(x: Array) -> Array:
        return np.asarray(1.0 - height * np.cos(2 * np.pi * x[..., 0]))

    return Integrand.from_function(f, dims=1, integral=1.0)


def _density(amplitude: float) -> Density | None:
    from mcspectra.densities.base import Density

    if amplitude == 0.0:
        return None
    return Density.from_functions(
        pdf=lambda x: 1.0 + amplitude * np.cos(2 * np.pi * x[..., 0]), dims=1
    )


def _estimator(case: Case) -> Estimator:
    from mcspectra.estimators import Estimator

    return Estimator(_function(case.function), _density(case.amplitude))


def _terms(case: Case, realizations: int, seed: int) -> xr.Dataset:
    from mcspectra.variance.terms import variance_terms

    half_width = _MANY if case.function in ("line", "bar") else _FEW
    return variance_terms(
        _estimator(case),
        case.sampler,
        _N,
        half_width=half_width,
        realizations=realizations,
        rng=seed,
    )


def exact_random(case: Case) -> tuple[float, float, float]:
    """The three terms of random points: means over the domain, periodic, so that midpoints are exact.

    N times the terms are I² (∫1/p − 1), ∫1/p (∫f² − I²), and Cov(f², 1/p) of x uniform.
    """
    x = (np.arange(4096) + 0.5)[:, None] / 4096
    f, p = _function(case.function)(x), 1.0 + case.amplitude * np.cos(2 * np.pi * x[:, 0])
    integral, square, inverse = f.mean(), (f**2).mean(), (1 / p).mean()
    first = integral**2 * (inverse - 1.0)
    second = inverse * (square - integral**2)
    third = (f**2 / p).mean() - square * inverse
    return float(first) / _N, float(second) / _N, float(third) / _N


def _caption(of: dict[Case, xr.Dataset]) -> str:
    third = {case: number(float(data["cross_term"])) for case, data in of.items()}
    return (
        f"The second term is a sum of variances and never negative. So is the first, I² Var(S₀): it never reduces the "
        f"variance, but without it there is no prediction of importance sampling; for f = 1 it is all there is. For "
        f"constant PDF the third term is {third[LINE]} on f(x) = x, but {third[BAR]} on a bar whose edges cut "
        f"strata in the middle, and 0 after a shift. For random points it is the covariance of f² and 1/p over N: "
        f"{third[GOOD]} where p is high where f is, {third[BAD]} where it is low there."
    )


def _second_positive(every: list[xr.Dataset]) -> Finding:
    least = min(float(data["power_contribution"].min()) for data in every)
    return Finding(
        statement=f"The second term is always positive: least |f_m|² Cov(S_m, S_m) of all frequencies of {len(every)} "
        "cases.",
        expected="≥ 0",
        measured=least,
        interval=None,
        agrees=least >= 0.0,
        note="It is 0 where f is constant, or where no S_m varies, as those of a regular grid.",
    )


def _no_first(constant: list[xr.Dataset]) -> Finding:
    return identity(
        "For constant PDF the first term is zero: largest.",
        error=max(float(data["dc_term"]) for data in constant),
        at_most=1e-20,
    )


def _negative(statement: str, data: xr.Dataset) -> Finding:
    return agreement(
        statement,
        measured=float(data["cross_term"]),
        interval=interval_of(data, "cross_term"),
        below=0.0,
    )


def _positive(statement: str, data: xr.Dataset, name: str) -> Finding:
    return agreement(
        statement, measured=float(data[name]), interval=interval_of(data, name), above=0.0
    )


def exact_bar(half_width: int) -> float:
    """The third term of the bar up to a half width, by the closed form of C_ml; 1/(6N²) in all."""
    from mcspectra.spectra.closed_forms import closed_form_covariance

    m = np.arange(-half_width, half_width + 1)[:, None]
    f = _function("bar").fourier(m)
    matrix = f.conj()[:, None] * f * closed_form_covariance("jittered", _N, m[:, None], m[None])
    return float((matrix.sum() - np.trace(matrix)).real)


def _counter_bar(data: xr.Dataset) -> Finding:
    """Variance: ¼ of both strata over N²; after a shift 1/6 of each: the third term is the difference."""
    return term_finding(
        "Counter-example: the third term of jittered points of constant PDF is positive for a bar whose edges halve "
        "strata, 1/(6N²) in all, here over |m| ≤ 64.",
        data,
        "cross_term",
        exact_bar(_MANY),
        note=f"1/(6N²) is {number(1 / (6 * _N**2))}.",
    )


def _counter_shift(data: xr.Dataset) -> Finding:
    return term_finding(
        "Counter-example: of shifted points of constant PDF the third term is neither negative nor positive.",
        data,
        "cross_term",
        0.0,
    )


def _predictions(of: dict[Case, xr.Dataset]) -> list[Finding]:
    return [
        term_finding(
            f"{case.title}: the third term is the covariance of f² and 1/p over the domain, over N.",
            of[case],
            "cross_term",
            exact_random(case)[2],
        )
        for case in (GOOD, BAD)
    ]


def _first_adds(data: xr.Dataset) -> Finding:
    return term_finding(
        "The first term does not reduce the variance: it is I² Var(S₀), which is never negative; with IS that follows "
        "f it is I² (∫1/p − 1)/N.",
        data,
        "dc_term",
        exact_random(GOOD)[0],
        note="The statement of the slides holds in so far as the third term outweighs it.",
    )


def _all_first(data: xr.Dataset) -> Finding:
    share = float(data["dc_term"] / data["measured_variance"])
    return identity(
        "First term cannot be ignored for IS: of f = 1 it is the whole variance; its share less 1.",
        error=share - 1.0,
        at_most=1e-9,
    )


def _perfect(seed: int) -> Finding:
    """With p = f every estimate is I: the third term is minus the other two."""
    case = Case("", "own", -0.8, "jittered")
    p = _density(case.amplitude)
    data = _terms_of_own(p, seed)
    rest = float(data["dc_term"] + data["power_term"])
    return identity(
        "With IS by f itself (1 − 0.8 cos 2πx) the third term takes away all of the first two: their sum, relative to "
        "these.",
        error=float(data["predicted_variance"]) / rest,
        at_most=1e-9,
    )


def _terms_of_own(p: Density | None, seed: int) -> xr.Dataset:
    from mcspectra.estimators import Estimator
    from mcspectra.integrands.base import Integrand
    from mcspectra.variance.terms import variance_terms

    def f(x: Array) -> Array:
        return np.asarray(1.0 - 0.8 * np.cos(2 * np.pi * x[..., 0]))

    own = Integrand.from_function(f, dims=1, integral=1.0)
    return variance_terms(
        Estimator(own, p), "jittered", _N, half_width=_FEW, realizations=100, rng=seed
    )


def _bars(of: dict[Case, xr.Dataset]) -> Picture:
    figure = new_figure(WIDE, 4.8)
    panels = figure.subplots(2, 3)
    for axes, (case, data) in zip(panels.ravel(), of.items(), strict=True):
        term_bars(axes, data, 1e-3, case.title)
    for axes in panels[:, 0]:
        axes.set_ylabel("terms · 10³")
    return Picture(
        kind="importance-terms",
        caption=f"The three terms and their sum, {_N} points, with 95 % intervals. The bar is 1 from 4.5/16 to "
        "10.5/16, the cosine 1 − cos 2πx; p is 1 ∓ 0.8 cos 2πx.",
        alt="Six panels of four bars. The third bar is below zero for f = x and where the density follows f, above "
        "zero for the bar and where the density is against f; for f = 1 only the first bar is not zero.",
        figure=figure,
    )
