"""The three terms: findings, and wrong inputs that must disagree."""

from __future__ import annotations

from typing import Any

import numpy as np
from tests.reproduction.conftest import Disagreeing

from mcspectra.reproduction import generalised_formula as module


def test_a_matrix_is_split_into_its_terms() -> None:
    matrix = np.arange(9.0).reshape(3, 3)
    assert module.split(matrix) == (4.0, 8.0, 24.0)


def test_terms_of_another_sampler_disagree(disagreeing: Disagreeing) -> None:
    right = module.terms
    swapped = {"random": "jittered", "jittered": "random", "sobol | owen": "random"}

    def wrong(f: Any, sampler: str, _: int, seed: int) -> Any:
        return right(f, swapped[sampler], 400, seed)

    assert disagreeing(module, terms=wrong) == [1, 5, 6, 7, 8, 12, 13, 14, 15]


def test_incomplete_sums_and_matrices_that_are_not_hermitian_disagree(
    disagreeing: Disagreeing,
) -> None:
    right = module.terms

    def wrong(f: Any, sampler: str, _: int, seed: int) -> Any:
        data = right(f, sampler, 100, seed)
        if sampler != "jittered":
            return data
        matrix = data["cross_matrix"].copy()
        matrix[0, 1] += 1e-6j
        short = data["predicted_variance"] - data["cross_term"]
        return data.assign(predicted_variance=short, cross_matrix=matrix)

    assert {0, 9} <= set(disagreeing(module, terms=wrong))
