"""Closed forms: findings, and what would contradict them."""

from __future__ import annotations

import numpy as np
from tests.reproduction.conftest import Disagreeing

from mcspectra.reproduction import closed_forms
from mcspectra.reproduction.claims import judge, largest_distance


def test_the_limit_holds_for_all_frequencies_and_findings_at_once() -> None:
    """Normal errors: the largest of 128 exceeds its limit once in 1950 times."""
    z = np.random.default_rng(2).standard_normal((4000, 128))
    ones = np.ones(128)
    beyond = sum(not judge(largest_distance("", row, ones)).agrees for row in z)
    assert beyond <= 2 + 4 * np.sqrt(2)  # a mean of 4000 · 0.00051 = 2, Poisson


def test_another_sampler_and_another_formula_disagree(disagreeing: Disagreeing) -> None:
    simulate, printed = closed_forms.simulate, closed_forms.printed
    swapped = {"random": "jittered", "jittered": "random"}
    assert disagreeing(
        closed_forms,
        simulate=lambda name, nu, _, seed: simulate(swapped[name], nu, 2000, seed),
        printed=lambda name, m: printed(name, 1.0001 * m),
    ) == [0, 1, 2, 3]
