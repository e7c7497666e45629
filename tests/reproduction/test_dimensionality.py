"""Growth with the number of dims: findings, and wrong inputs that must disagree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.reproduction.conftest import Disagreeing

from mcspectra.integrands.registry import integrand
from mcspectra.reproduction import dimensionality as module


def test_entries_count_pairs_of_frequencies() -> None:
    assert module.entries(1, 64) == 129**2
    assert module.entries(3, 1) == 27**2


def test_subsets_are_bit_masks_of_axes() -> None:
    found = module.subsets(2, 1).reshape(3, 3)
    assert found.tolist() == [[3, 1, 3], [2, 0, 2], [3, 1, 3]]


def test_bands_have_the_names_of_their_subsets() -> None:
    data = module.bell_terms("random", 3, (8, 1), 4, 1)
    names = data["band"].attrs["labels"].split(", ")
    subsets = module.labelled_subsets(data)
    assert sorted(subsets) == list(range(8))
    ones = [subset.bit_count() for subset in subsets]
    assert ones == sorted(ones), names


def test_wrong_maps_and_bands_disagree(disagreeing: Disagreeing) -> None:
    right = module.bell_terms

    def wrong(
        name: str, dims: int, size: Any, count: int, seed: int, *, matrix: bool = False
    ) -> Any:
        if name != "jittered":
            return right("latin-hypercube", dims, size, 100, seed)
        # Two findings compare terms of the set with |m| ≤ 24, which stay right
        count = count if size == (64, 24) else 20
        data = right(name, dims, size, count, seed, matrix=matrix)
        return data.assign(
            contribution=data["contribution"] * 1.001, band_covariance=2 * data["band_covariance"]
        )

    assert disagreeing(module, bell_terms=wrong) == list(range(2, 13))


def test_components_agree_with_the_product_formula() -> None:
    """For a product of three factors with mean a and mean square b, one axis has (b − a²) a⁴."""
    side = np.abs(integrand(module.BELL, 1).fourier_grid(8)) ** 2
    mean_square, mean = side.sum(), side[8]
    found = module.components(3, 8)
    assert found[1] == pytest.approx((mean_square - mean) * mean**2, rel=1e-9)
    assert found[7] == pytest.approx((mean_square - mean) ** 3, rel=1e-9)
