"""Homogenisation and convergence: findings, and what would contradict them."""

from __future__ import annotations

import numpy as np
import pytest

from mcspectra.report.reproduction import homogenisation_convergence as module
from mcspectra.report.reproduction.base import Exhibit
from mcspectra.variance.exact import exact_variance


@pytest.fixture(scope="module")
def made() -> Exhibit:
    return module.exhibit(quick=True, seed=1)


def test_all_findings_agree(made: Exhibit) -> None:
    assert made.name == "homogenisation-convergence"
    assert [f.statement for f in made.findings if f.agrees is not True] == []
    assert all(len(p.alt) > 40 for p in made.pictures)


def test_swapped_samplers_disagree() -> None:
    case = module.CASES[0]
    curves = module._curves(case, 400, 1)
    plain, shifted = module._SAMPLERS
    exact = {name: module._exact(case, name) for name in curves}
    assert module._rate(case, plain, curves, exact).agrees is True
    swapped = {plain: curves[shifted], shifted: curves[plain]}
    assert module._rate(case, plain, swapped, exact).agrees is False
    assert module._price(swapped).agrees is False


def test_a_function_that_is_not_periodic_is_not_the_same_when_shifted() -> None:
    case = module.CASES[1]
    exact = {name: module._exact(case, name) for name in module._SAMPLERS}
    assert module._same(exact).agrees is False


def test_the_disk_after_a_shift_is_the_mean_over_fixed_offsets() -> None:
    """The variance of the homogenised set is that of displaced strata, averaged over the offset."""
    case = module.CASES[2]
    found = module._exact(case, "jittered | shift")[1]
    n, side = module.COUNTS[1], 12
    offsets = [(i + 0.5, j + 0.5) for i in range(side) for j in range(side)]
    values = [
        exact_variance(case.spec, f"jittered | strata-shift(offset=[{i / side}, {j / side}])", n)
        for i, j in offsets
    ]
    # A mean over 144 offsets of a continuous periodic function with kinks: errors of 1/144.
    assert np.mean(values) == pytest.approx(found, rel=1 / 144)
