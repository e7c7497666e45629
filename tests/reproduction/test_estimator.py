"""The estimator and its sampling function: findings, and what would contradict them."""

import numpy as np
import pytest
from scipy.integrate import quad

from mcspectra.reproduction import estimator
from mcspectra.reproduction.claims import judge
from mcspectra.reproduction.gallery import make_exhibit


@pytest.fixture(scope="module")
def made():
    return make_exhibit("estimator", quick=True, seed=1)


def test_all_findings_agree(made, sound):
    sound(made)


def test_pictures_have_words_and_caption_has_figures(made):
    assert [p.kind for p in made.plots] == ["estimator", "points"]
    assert "0.5577" in made.caption


def test_expected_values_by_other_routes(made):
    bell = quad(lambda x: np.exp(-(x**2)), 0, 1)[0] ** 2
    square = quad(lambda x: np.exp(-2 * x**2), 0, 1)[0] ** 2
    assert float(made.findings[0].expected) == pytest.approx(bell, rel=1e-6)
    shown = made.findings[3].expected
    assert shown.endswith("×10⁻⁴")
    mantissa = float(shown.partition("×")[0])
    assert mantissa * 1e-4 == pytest.approx((square - bell**2) / 64, rel=1e-3)


def test_a_wrong_integral_disagrees(monkeypatch):
    monkeypatch.setattr(estimator, "integral", lambda: 0.57)
    found = estimator.exhibit(quick=True, seed=1).findings
    assert [f.agrees for f in found[:3]] == [False] * 3


def test_weights_without_the_density_disagree(monkeypatch):
    monkeypatch.setattr(estimator, "pdf", lambda x: 1.02 * np.ones_like(x))
    assert judge(estimator._weights_sum_to_one(1000, 1)).agrees is False
