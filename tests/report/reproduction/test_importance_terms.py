"""Terms under importance sampling: findings, and what would contradict them."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.integrate import quad

from mcspectra.report.reproduction import _importance_cases as cases
from mcspectra.report.reproduction import importance_terms as module
from mcspectra.report.reproduction._terms import term_bars
from mcspectra.report.reproduction.base import Exhibit
from mcspectra.variance.exact import exact_variance


@pytest.fixture(scope="module")
def made() -> Exhibit:
    return module.exhibit(quick=True, seed=1)


def test_all_findings_agree(made: Exhibit) -> None:
    assert made.name == "importance-terms"
    assert [f.statement for f in made.findings if f.agrees is not True] == []
    assert all(len(p.alt) > 40 for p in made.pictures)


@pytest.mark.parametrize("case", [cases.GOOD, cases.BAD, cases.FLAT], ids=lambda c: c.title)
def test_the_terms_of_random_points_sum_to_the_variance(case: cases.Case) -> None:
    """By another route: ∫f²/p − I² over N by adaptive quadrature."""
    f, p = cases.function_of(case.function), cases.density_of(case.amplitude)
    assert p is not None

    def ratio(x: float) -> float:
        at = np.array([x])
        return float(f(at)) ** 2 / float(p.pdf(at))

    expected = (quad(ratio, 0.0, 1.0)[0] - 1.0) / cases.N
    assert sum(cases.exact_random(case)) == pytest.approx(expected, rel=1e-9)


def test_the_third_term_of_the_bar_is_what_a_shift_takes_away() -> None:
    """1/(2N²) less 1/(3N²); sums up to 128 and 256, extrapolated in 1/K."""
    near, far = (cases.exact_bar(k) for k in (128, 256))
    assert 2 * far - near == pytest.approx(1 / (6 * cases.N**2), rel=5e-3)
    f = cases.function_of("bar")
    gap = exact_variance(f, "jittered", cases.N) - exact_variance(f, "jittered | shift", cases.N)
    assert gap == pytest.approx(1 / (6 * cases.N**2), rel=1e-6)


def test_other_cases_disagree() -> None:
    of = {case: cases.terms(case, 300, 1) for case in (cases.GOOD, cases.BAD, cases.LINE)}
    swapped = {cases.GOOD: of[cases.BAD], cases.BAD: of[cases.GOOD]}
    assert [f.agrees for f in module._predictions(swapped)] == [False, False]
    assert module._negative("", of[cases.BAD]).agrees is False
    assert module._counter_shift(of[cases.LINE]).agrees is False
    assert module._counter_bar(of[cases.LINE]).agrees is False
    assert module._all_first(of[cases.GOOD]).agrees is False
    assert module._crucial(cases.BAD, of[cases.BAD]).agrees is False


def test_a_second_term_that_may_be_zero_disagrees() -> None:
    good, line = (cases.terms(case, 100, 1) for case in (cases.GOOD, cases.LINE))
    assert module._second_positive([good, line]).agrees is True
    low = -0.01 * float(line["power_term"])
    wrong = line.assign(power_term_ci=("bound", [low, 3 * float(line["power_term"])]))
    assert module._second_positive([good, wrong]).agrees is False
    assert module._second_positive([wrong, good]).interval == (
        low,
        wrong["power_term_ci"].values[1],
    )


def test_bars_of_rounding_errors_have_the_label_0() -> None:
    axes = Figure().subplots()
    data = cases.terms(cases.FLAT, 100, 1)
    term_bars(axes, data.assign(cross_term=1e-14 * data["dc_term"]), 1e-3, "f = 1")
    labels = [text.get_text() for text in axes.texts]
    assert labels[1:3] == ["0", "0"]
    assert labels[0] == labels[3] != "0"
