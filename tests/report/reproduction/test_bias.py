"""Bias: findings, the formulas they use by other routes, and what would contradict them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from mcspectra.report.reproduction import _limits, bias
from mcspectra.report.reproduction.base import GALLERY_FINDINGS, Exhibit


@pytest.fixture(scope="module")
def made() -> Exhibit:
    return bias.exhibit(quick=True, seed=1)


def test_all_findings_agree(made: Exhibit) -> None:
    assert made.name == "bias"
    assert [f.statement for f in made.findings if f.agrees is not True] == []
    assert all(len(p.alt) > 40 for p in made.pictures)


@pytest.mark.parametrize("width", [0.0, 0.3, 1.0])
def test_bias_of_boxes_by_quadrature(width: float) -> None:
    n = 5
    centers = (np.arange(n) + 0.5) / n
    means = [
        quad(lambda t, c=c: (c + t * width / n) ** 2, -0.5, 0.5)[0]  # type: ignore[misc]
        for c in centers
    ]
    assert bias._box_bias(n, width) == pytest.approx(np.mean(means) - 1 / 3, abs=1e-14)


def test_sets_with_means_disagree() -> None:
    for name in (bias._BOXES, bias._BOUNDED):
        assert bias._no_mean(name, bias._sums(name, 2000, 1, bias._DENSITY)).agrees is False
    random = bias._sums("random", 500, 1, bias._DENSITY)
    assert bias._no_mean("weights twice too large", 2.0 * random).agrees is False


def test_toroidal_and_bounded_sets_are_told_apart() -> None:
    bounded, toroidal = (bias._sums(name, 2000, 1) for name in (bias._BOUNDED, "poisson-disk"))
    assert bias._border(toroidal).agrees is False
    assert bias._border(bounded, toroidal=True).agrees is False


def test_another_width_disagrees(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bias, "_WIDTH", 0.6)
    found = bias._sums(bias._BOXES, 2000, 1)
    assert bias._box_mean(found).agrees is False
    assert bias._summed_bias().agrees is False  # of a width that is fixed in _box_bias


def test_the_limit_of_many_normal_errors() -> None:
    from scipy.stats import norm

    level = (1 - 2 * norm.sf(_limits.normal_limit(65))) ** (65 * GALLERY_FINDINGS)
    assert level == pytest.approx(0.95, rel=1e-9)


def test_the_largest_distance_counts() -> None:
    ones = np.ones(4)
    assert _limits.largest_distance("x", 3.0 * ones, ones).agrees is True
    assert _limits.largest_distance("x", np.array([0, 0, -6.0, 0]), ones).agrees is False
