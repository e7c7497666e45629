"""Terms under importance sampling: findings, and what would contradict them."""

import numpy as np
import pytest
from scipy.integrate import quad

from mcspectra.plots.description import Text
from mcspectra.reproduction import importance_terms as module
from mcspectra.reproduction.claims import judge
from mcspectra.reproduction.panels import term_panel
from mcspectra.variance.exact import exact_variance


@pytest.mark.parametrize("case", [module.GOOD, module.BAD, module.FLAT], ids=lambda c: c.title)
def test_the_terms_of_random_points_sum_to_the_variance(case):
    """By another route: ∫f²/p − I² over N by adaptive quadrature."""
    f, p = case.estimator.integrand, case.estimator.density
    assert p is not None

    def ratio(x):
        at = np.array([x])
        return float(f(at)) ** 2 / float(p.pdf(at))

    expected = (quad(ratio, 0.0, 1.0)[0] - 1.0) / module.N
    assert sum(case.exact_random()) == pytest.approx(expected, rel=1e-9)


def test_the_third_term_of_the_bar_is_what_a_shift_takes_away():
    """1/(2N²) less 1/(3N²); sums up to 128 and 256, extrapolated in 1/K."""
    near, far = (module.exact_bar(k) for k in (128, 256))
    assert 2 * far - near == pytest.approx(1 / (6 * module.N**2), rel=5e-3)
    f = module.BAR.integrand
    gap = exact_variance(f, "jittered", module.N) - exact_variance(f, "jittered | shift", module.N)
    assert gap == pytest.approx(1 / (6 * module.N**2), rel=1e-6)


def test_other_cases_disagree():
    of = {case: case.terms(300, 1) for case in (module.GOOD, module.BAD, module.LINE)}
    swapped = {module.GOOD: of[module.BAD], module.BAD: of[module.GOOD]}
    assert [judge(claim).agrees for claim in module._predictions(swapped)] == [False, False]
    assert judge(module._negative("", of[module.BAD])).agrees is False
    assert judge(module._shift_removes(of[module.LINE])).agrees is False
    assert judge(module._bar_adds(of[module.LINE])).agrees is False
    assert judge(module._all_first(of[module.GOOD])).agrees is False
    assert judge(module._crucial(module.BAD, of[module.BAD])).agrees is False


def test_a_second_term_that_may_be_zero_disagrees():
    good, line = (case.terms(100, 1) for case in (module.GOOD, module.LINE))
    assert judge(module._second_positive([good, line])).agrees is True
    low = -0.01 * float(line["power_term"])
    wrong = line.assign(power_term_ci=("bound", [low, 3 * float(line["power_term"])]))
    assert judge(module._second_positive([good, wrong])).agrees is False
    assert judge(module._second_positive([wrong, good])).interval == (
        low,
        wrong["power_term_ci"].values[1],
    )


def test_bars_of_rounding_errors_have_the_label_0():
    data = module.FLAT.terms(100, 1)
    panel = term_panel(data.assign(cross_term=1e-14 * data["dc_term"]), 1e-3, "f = 1")
    labels = [mark.text for mark in panel.marks if isinstance(mark, Text)]
    assert labels[1:3] == ["0", "0"]
    assert labels[0] == labels[3] != "0"
