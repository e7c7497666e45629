"""Signs of the three terms, under constant densities and importance sampling."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._importance_cases import (
    BAD,
    BAR,
    CASES,
    FLAT,
    GOOD,
    LINE,
    MANY,
    STRATIFIED,
    Case,
    N,
    exact_bar,
    exact_random,
    terms,
    terms_of_own,
)
from mcspectra.report.reproduction._terms import interval_of, term_bars, term_finding
from mcspectra.report.reproduction.base import Exhibit, Finding, agreement, identity
from mcspectra.report.style import WIDE, new_figure

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["exhibit"]


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure terms in cases that confirm the statements of the slides, and in some that do not."""
    realizations = 1000 if quick else 20_000
    of = {case: terms(case, realizations, seed) for case in CASES}
    shifted = terms(Case("", "line", 0.0, "jittered | shift"), realizations, seed)
    findings = (
        _second_positive([*(data for case, data in of.items() if case != FLAT), shifted]),
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
        *(_crucial(case, of[case]) for case in (LINE, GOOD)),
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
    """The case whose interval comes nearest to 0."""
    worst = min(
        every, key=lambda data: interval_of(data, "power_term")[0] / float(data["power_term"])
    )
    return _positive(
        f"The second term is always positive: that of the {len(every)} cases (f = 1 aside, which has none) whose "
        "interval comes nearest to 0.",
        worst,
        "power_term",
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


def _counter_bar(data: xr.Dataset) -> Finding:
    """Variance: ¼ of both strata over N²; after a shift 1/6 of each: the third term is the difference."""
    return term_finding(
        "Counter-example: the third term of jittered points of constant PDF is positive for a bar whose edges halve "
        "strata, 1/(6N²) in all, here over |m| ≤ 64.",
        data,
        "cross_term",
        exact_bar(MANY),
        note=f"1/(6N²) is {number(1 / (6 * N**2))}.",
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


def _crucial(case: Case, data: xr.Dataset) -> Finding:
    """First and second term over the measured variance, whose interval it takes."""
    both = float(data["dc_term"] + data["power_term"])
    low, high = (both / end for end in reversed(interval_of(data, "measured_variance")))
    return agreement(
        f"Third term is crucial, {case.title}: without it the first two predict more than twice the variance: their "
        "ratio.",
        measured=both / float(data["measured_variance"]),
        interval=(low, high),
        above=2.0,
        scale="log",
    )


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
    data = terms_of_own(seed)
    rest = float(data["dc_term"] + data["power_term"])
    return identity(
        "With IS by f itself (1 − 0.8 cos 2πx) the third term takes away all of the first two: their sum, relative to "
        "these.",
        error=float(data["predicted_variance"]) / rest,
        at_most=1e-9,
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
        caption=f"The three terms and their sum, {N} points, with 95 % intervals. The bar is 1 from 4.5/16 to "
        "10.5/16, the cosine 1 − cos 2πx; p is 1 ∓ 0.8 cos 2πx.",
        alt="Six panels of four bars. The third bar is below zero for f = x and where the density follows f, above "
        "zero for the bar and where the density is against f; for f = 1 only the first bar is not zero.",
        figure=figure,
    )
