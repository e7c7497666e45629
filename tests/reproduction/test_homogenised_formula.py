"""The formula for homogenized samples: findings, and wrong inputs that must disagree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.reproduction.conftest import Disagreeing

from mcspectra.integrands.registry import integrand
from mcspectra.reproduction import homogenised_formula as module


def test_swapped_shifted_and_plain_points_disagree(disagreeing: Disagreeing) -> None:
    right = module.terms

    def swapped(name: str, _: int, seed: int) -> Any:
        other = name.removesuffix(" | shift") if "shift" in name else f"{name} | shift"
        return right(other, 1000, seed)

    assert {2, 6, 12} <= set(disagreeing(module, terms=swapped))


def test_the_truncated_power_agrees_with_quadrature() -> None:
    """∫f² comes from the midpoint rule on 1600² cells, with error 1/1600² for smooth f."""
    x = (np.arange(1600) + 0.5) / 1600
    f = integrand(module.BELL, 2)
    square = (f(np.stack(np.meshgrid(x, x), axis=-1)) ** 2).mean()
    kept = (np.abs(f.fourier_grid(module.HALF_WIDTH)) ** 2).sum()
    assert module.beyond() == pytest.approx(square - kept, rel=2e-3)
