"""Terms for importance sampling: findings, and wrong inputs that must disagree."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from tests.reproduction.conftest import Disagreeing

from mcspectra.plots.description import TextMark
from mcspectra.prediction.exact import exact_variance
from mcspectra.reproduction import importance_terms as module
from mcspectra.reproduction.claims import Measured
from mcspectra.reproduction.panels import term_panel


@pytest.mark.parametrize("case", [module.GOOD, module.BAD, module.FLAT], ids=lambda c: c.title)
def test_the_terms_of_random_points_sum_to_the_variance(case: module.TermsCase) -> None:
    """The sum agrees with (∫f²/p − I²) / N by adaptive quadrature."""
    f, p = case.estimator.integrand, case.estimator.density
    assert p is not None

    def ratio(x: float) -> float:
        at = np.array([x])
        return float(f(at)) ** 2 / float(p.pdf(at))

    expected = (quad(ratio, 0.0, 1.0)[0] - 1.0) / module.N
    assert sum(case.exact_random()) == pytest.approx(expected, rel=1e-9)


def test_the_printed_terms_are_those_of_the_reflected_integrand() -> None:
    """Reflecting f = 1 − sin 2πx gives the same terms as reflecting the density instead."""
    found = module.GOOD.exact_random(printed=True)
    assert found == pytest.approx(module.BAD.exact_random(), rel=1e-9)


def test_the_third_term_of_the_bar_is_removed_by_a_shift() -> None:
    """The difference 1/(2N²) − 1/(3N²) agrees with sums up to 128 and 256, extrapolated in 1/K."""
    near, far = (module.exact_bar(k) for k in (128, 256))
    assert 2 * far - near == pytest.approx(1 / (6 * module.N**2), rel=5e-3)
    f = module.BAR.integrand
    gap = exact_variance(f, "jittered", module.N) - exact_variance(f, "jittered | shift", module.N)
    assert gap == pytest.approx(1 / (6 * module.N**2), rel=1e-6)


@pytest.mark.parametrize("case", [module.LINE, module.BAR, module.STRATIFIED])
def test_exact_terms_sum_to_the_exact_variance(case: module.TermsCase) -> None:
    expected = exact_variance(case.estimator, case.sampler, module.N)
    assert sum(case.exact()) == pytest.approx(expected, rel=1e-6)


def test_wrong_cases_and_an_undecided_second_term_disagree(
    disagreeing: Disagreeing, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = module.TermsCase.terms
    others = {
        module.GOOD: module.BAD,
        module.BAD: module.GOOD,
        module.BAR: module.LINE,
        module.FLAT: module.GOOD,
        module.STRATIFIED: module.BAD,
    }

    def wrong(case: module.TermsCase, _: int, seed: int) -> Any:
        if case.function != "line":
            return right(others[case], 300, seed)
        data = right(replace(case, sampler="jittered"), 300, seed)
        size = float(data["power_term"])
        return data.assign(power_term_ci=("bound", [-0.01 * size, 3 * size]))

    monkeypatch.setattr(module.TermsCase, "terms", wrong)
    assert disagreeing(module) == [0, 3, 4, 5, 6, 7, 8, 9, 12, 13, 14, 17, 18, 19]


def test_bars_of_rounding_errors_have_the_label_0() -> None:
    panel = term_panel([1.0, 1e-14, -1e-14], Measured(1.0, 0.9, 1.1), 1e-3, "f = 1")
    labels = [mark.text for mark in panel.marks if isinstance(mark, TextMark)]
    assert labels[1:3] == ["0", "0"]
    assert labels[0] == labels[3] == labels[4] != "0"
