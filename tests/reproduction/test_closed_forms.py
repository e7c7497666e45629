"""Closed forms: findings, and what would contradict them."""

import numpy as np

from mcspectra.reproduction import closed_forms
from mcspectra.reproduction.claims import judge, largest_distance


def test_the_limit_holds_for_all_frequencies_and_findings_at_once():
    """Normal errors: the largest of 128 exceeds its limit once in 1950 times."""
    z = np.random.default_rng(2).standard_normal((4000, 128))
    ones = np.ones(128)
    beyond = sum(not judge(largest_distance("", row, ones)).agrees for row in z)
    assert beyond <= 2 + 4 * np.sqrt(2)  # a mean of 4000 · 0.00051 = 2, Poisson


def test_a_power_that_is_off_disagrees():
    nu = np.array([1.0, 2.5, 3.0])
    data = closed_forms.simulate("jittered", nu, 2000, 1)
    assert judge(closed_forms._agrees_with_simulation("jittered", data, nu)).agrees is True
    assert judge(closed_forms._agrees_with_simulation("random", data, nu)).agrees is False


def test_another_formula_disagrees(monkeypatch):
    right = closed_forms.printed
    monkeypatch.setattr(closed_forms, "printed", lambda name, m: right(name, 1.0001 * m))
    assert judge(closed_forms._as_printed("jittered")).agrees is False
    assert judge(closed_forms._as_printed("random")).agrees is False
