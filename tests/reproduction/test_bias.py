"""Bias: formulas by other methods, and wrong inputs that must disagree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from tests.reproduction.conftest import Disagreeing

from mcspectra.reproduction import bias
from mcspectra.reproduction.claims import (
    GALLERY_FINDINGS,
    judge,
    largest_distance,
    normal_limit,
)


@pytest.mark.parametrize("width", [0.0, 0.3, 1.0])
def test_bias_of_boxes_by_quadrature(width: float) -> None:
    n = 5
    centers = (np.arange(n) + 0.5) / n
    means = [
        quad(lambda t, c=c: (c + t * width / n) ** 2, -0.5, 0.5)[0]  # type: ignore[misc]
        for c in centers
    ]
    assert bias.box_bias(n, width) == pytest.approx(np.mean(means) - 1 / 3, abs=1e-14)


def test_wrong_sets_and_widths_disagree(disagreeing: Disagreeing) -> None:
    """Swap biased with unbiased sets, and bounded with periodic sets."""
    right = bias.sums
    others = {
        "jittered": bias.BOXES,
        "sobol | owen": bias.BOUNDED,
        bias.BOUNDED: "poisson-disk",
        "poisson-disk": bias.BOUNDED,
    }

    def wrong(name: str, _: int, *rest: Any) -> Any:
        weights = 2.0 if name == "random" else 1.0
        return weights * right(others.get(name, name), 2000, *rest)

    assert disagreeing(bias, sums=wrong, WIDTH=0.6) == [0, 1, 2, 3, 4, 5, 7]


def test_the_limit_of_many_normal_errors() -> None:
    from scipy.stats import norm

    level = (1 - 2 * norm.sf(normal_limit(65))) ** (65 * GALLERY_FINDINGS)
    assert level == pytest.approx(0.95, rel=1e-9)


def test_the_largest_distance_counts() -> None:
    ones = np.ones(4)
    assert judge(largest_distance("x", 3.0 * ones, ones)).agrees is True
    assert judge(largest_distance("x", np.array([0, 0, -6.0, 0]), ones)).agrees is False
