"""Terms under importance sampling: findings, and what would contradict them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from mcspectra.report.reproduction import importance_terms as module
from mcspectra.report.reproduction.base import Exhibit
from mcspectra.variance.exact import exact_variance


@pytest.fixture(scope="module")
def made() -> Exhibit:
    return module.exhibit(quick=True, seed=1)


def test_all_findings_agree(made: Exhibit) -> None:
    assert made.name == "importance-terms"
    assert [f.statement for f in made.findings if f.agrees is not True] == []
    assert all(len(p.alt) > 40 for p in made.pictures)


@pytest.mark.parametrize("case", [module.GOOD, module.BAD, module.FLAT], ids=lambda c: c.title)
def test_the_terms_of_random_points_sum_to_the_variance(case: module.Case) -> None:
    """By another route: ∫f²/p − I² over N by adaptive quadrature."""
    f, p = module._function(case.function), module._density(case.amplitude)
    assert p is not None

    def ratio(x: float) -> float:
        at = np.array([x])
        return float(f(at)) ** 2 / float(p.pdf(at))

    expected = (quad(ratio, 0.0, 1.0)[0] - 1.0) / module._N
    assert sum(module.exact_random(case)) == pytest.approx(expected, rel=1e-9)


def test_the_third_term_of_the_bar_is_what_a_shift_takes_away() -> None:
    """1/(2N²) less 1/(3N²); sums up to 128 and 256, extrapolated in 1/K."""
    near, far = (module.exact_bar(k) for k in (128, 256))
    assert 2 * far - near == pytest.approx(1 / (6 * module._N**2), rel=5e-3)
    f = module._function("bar")
    gap = exact_variance(f, "jittered", module._N) - exact_variance(
        f, "jittered | shift", module._N
    )
    assert gap == pytest.approx(1 / (6 * module._N**2), rel=1e-6)


def test_other_cases_disagree() -> None:
    of = {case: module._terms(case, 300, 1) for case in (module.GOOD, module.BAD, module.LINE)}
    swapped = {module.GOOD: of[module.BAD], module.BAD: of[module.GOOD]}
    assert [f.agrees for f in module._predictions(swapped)] == [False, False]
    assert module._negative("", of[module.BAD]).agrees is False
    assert module._counter_shift(of[module.LINE]).agrees is False
    assert module._counter_bar(of[module.LINE]).agrees is False
    assert module._all_first(of[module.GOOD]).agrees is False


def test_a_negative_second_term_disagrees() -> None:
    data = module._terms(module.GOOD, 20, 1)
    assert module._second_positive([data]).agrees is True
    wrong = data.assign(power_contribution=data["power_contribution"] - np.float64(1.0))
    assert module._second_positive([wrong]).agrees is False
