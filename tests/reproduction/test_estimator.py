"""The estimator and its sampling function: findings, and wrong inputs that must disagree."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad
from tests.reproduction.conftest import Disagreeing

from mcspectra.reproduction import estimator
from mcspectra.reproduction.claims import Exhibit
from mcspectra.reproduction.gallery import make_exhibit


def test_all_findings_agree(sound: Callable[[Exhibit], None]) -> None:
    """Expected values agree with quadrature. Plots are in the order of the slides."""
    made = make_exhibit("estimator", quick=True, seed=1)[0]
    sound(made)
    assert [p.kind for p in made.plots] == ["integral", "estimator", "points", "sampling-function"]
    bell = quad(lambda x: np.exp(-(x**2)), 0, 1)[0] ** 2
    square = quad(lambda x: np.exp(-2 * x**2), 0, 1)[0] ** 2
    area = quad(lambda x: np.exp(-((x - 0.4) ** 2) / (2 * 0.2**2)), 0, 1)[0]
    assert float(made.findings[1].expected) == pytest.approx(area, rel=1e-6)
    shown = made.findings[6].expected
    assert shown.endswith("×10⁻⁴")
    mantissa = float(shown.partition("×")[0])
    assert mantissa * 1e-4 == pytest.approx((square - bell**2) / 64, rel=1e-3)


def test_a_wrong_integral_disagrees(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(estimator, "bell_area", lambda: 0.57)
    found = estimator.exhibit(quick=True, seed=1).findings
    assert [f.agrees for f in found[:4]] == [False] * 4


def test_weights_without_the_density_disagree(disagreeing: Disagreeing) -> None:
    assert disagreeing(estimator, pdf=lambda x: 1.02 * np.ones_like(x)) == [4]
