"""Homogenization and convergence: findings, and wrong inputs that must disagree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.reproduction.conftest import Disagreeing

from mcspectra.prediction.exact import exact_variance
from mcspectra.reproduction import homogenisation_convergence as module


def test_swapped_samplers_and_a_function_that_is_not_periodic_disagree(
    disagreeing: Disagreeing,
) -> None:
    measured, exact = module.measured, module.exact

    def swapped(case: module.ConvergenceCase, _: int, seed: int, *samplers: Any) -> Any:
        found = measured(case, 400, seed, *samplers)
        return dict(zip(found, reversed(found.values()), strict=True))

    def not_periodic(case: module.ConvergenceCase, sampler: str) -> Any:
        return exact(module.BELL if case == module.COSINE else case, sampler)

    assert {0, 1, 8, 9, 10} <= set(disagreeing(module, measured=swapped, exact=not_periodic))


def test_the_disk_after_a_shift_is_the_mean_over_fixed_offsets() -> None:
    """The variance of homogenized sets is the mean variance of displaced strata over offsets."""
    case = module.DISK
    found = module.exact(case, "jittered | shift")[1]
    n, side = module.COUNTS[1], 12
    offsets = [(i + 0.5, j + 0.5) for i in range(side) for j in range(side)]
    values = [
        exact_variance(case.spec, f"jittered | strata-shift(offset=[{i / side}, {j / side}])", n)
        for i, j in offsets
    ]
    # The mean over 144 offsets of a continuous periodic function with kinks has the error 1/144.
    assert np.mean(values) == pytest.approx(found, rel=1 / 144)
