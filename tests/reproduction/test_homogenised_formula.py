"""The formula for homogenized samples: findings, and wrong inputs that must disagree."""

from __future__ import annotations

from typing import Any

from tests.reproduction.conftest import Disagreeing

from mcspectra.reproduction import homogenised_formula as module


def test_swapped_shifted_and_plain_points_disagree(disagreeing: Disagreeing) -> None:
    right = module.terms

    def swapped(name: str, _: int, seed: int) -> Any:
        other = name.removesuffix(" | shift") if "shift" in name else f"{name} | shift"
        return right(other, 1000, seed)

    ratios = module.ratios
    turned = lambda name, _, seed: ratios(name, 1600, seed)[::-1]
    assert {2, 6, 12} <= set(disagreeing(module, terms=swapped, ratios=turned))


def test_the_sum_is_the_exact_variance_of_shifted_points() -> None:
    """For one axis the exact variance after a shift is known; f = x + y has two of them."""
    plain, shifted = module.ratios("latin-hypercube", 1600, 3)
    assert shifted.low < 1.0 < shifted.high
    assert plain.low < 2 * module.N - 1 < plain.high
