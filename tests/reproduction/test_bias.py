"""Bias: findings, the formulas they use by other routes, and what would contradict them."""

import numpy as np
import pytest
from scipy.integrate import quad

from mcspectra.reproduction import bias
from mcspectra.reproduction.claims import (
    GALLERY_FINDINGS,
    judge,
    largest_distance,
    normal_limit,
)


@pytest.mark.parametrize("width", [0.0, 0.3, 1.0])
def test_bias_of_boxes_by_quadrature(width):
    n = 5
    centers = (np.arange(n) + 0.5) / n
    means = [quad(lambda t, c=c: (c + t * width / n) ** 2, -0.5, 0.5)[0] for c in centers]
    assert bias.box_bias(n, width) == pytest.approx(np.mean(means) - 1 / 3, abs=1e-14)


def test_sets_with_means_disagree():
    for name in (bias.BOXES, bias.BOUNDED):
        assert judge(bias._no_mean(name, bias.sums(name, 2000, 1, bias.DENSITY))).agrees is False
    random = bias.sums("random", 500, 1, bias.DENSITY)
    assert judge(bias._no_mean("weights twice too large", 2.0 * random)).agrees is False


def test_toroidal_and_bounded_sets_are_told_apart():
    bounded, toroidal = (bias.sums(name, 2000, 1) for name in (bias.BOUNDED, "poisson-disk"))
    assert judge(bias._bounded_border(toroidal)).agrees is False
    assert judge(bias._toroidal_border(bounded)).agrees is False


def test_another_width_disagrees(monkeypatch):
    monkeypatch.setattr(bias, "WIDTH", 0.6)
    found = bias.sums(bias.BOXES, 2000, 1)
    assert judge(bias._box_mean(found)).agrees is False
    assert judge(bias._summed_bias()).agrees is False  # of a width that is fixed in box_bias


def test_the_limit_of_many_normal_errors():
    from scipy.stats import norm

    level = (1 - 2 * norm.sf(normal_limit(65))) ** (65 * GALLERY_FINDINGS)
    assert level == pytest.approx(0.95, rel=1e-9)


def test_the_largest_distance_counts():
    ones = np.ones(4)
    assert judge(largest_distance("x", 3.0 * ones, ones)).agrees is True
    assert judge(largest_distance("x", np.array([0, 0, -6.0, 0]), ones)).agrees is False
