"""Closed forms: findings, and wrong inputs that must disagree."""

from __future__ import annotations

import numpy as np
from tests.reproduction.conftest import Disagreeing

from mcspectra.reproduction import closed_forms
from mcspectra.reproduction.claims import judge, largest_distance


def test_the_limit_holds_simultaneously_for_frequencies_and_findings() -> None:
    """The largest of 128 normal errors exceeds the limit once in 1950 times."""
    z = np.random.default_rng(2).standard_normal((4000, 128))
    ones = np.ones(128)
    beyond = sum(not judge(largest_distance("", row, ones)).agrees for row in z)
    assert beyond <= 2 + 4 * np.sqrt(2)  # Poisson with mean 4000 · 0.00051 = 2


def test_wrong_samplers_and_formulas_disagree(disagreeing: Disagreeing) -> None:
    simulate, printed = closed_forms.simulate, closed_forms.printed
    swapped = {"random": "jittered", "jittered": "random"}
    assert disagreeing(
        closed_forms,
        simulate=lambda name, nu, few, *more: simulate(swapped[name], nu, min(few, 2000), *more),
        printed=lambda name, m: printed(name, 1.0001 * m),
    ) == [0, 1, 2, 3]
