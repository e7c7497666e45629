"""Homogenisation and convergence: findings, and what would contradict them."""

import numpy as np
import pytest

from mcspectra.reproduction import homogenisation_convergence as module
from mcspectra.reproduction.claims import judge
from mcspectra.variance.exact import exact_variance


def test_swapped_samplers_disagree():
    case = module.LINE
    curves = module.measured(case, 400, 1)
    plain, shifted = module.SAMPLERS
    exact = {name: module.exact(case, name) for name in curves}

    assert judge(module._rate_of(case, plain, curves[plain], exact[plain])).agrees is True
    swapped = {plain: curves[shifted], shifted: curves[plain]}
    assert judge(module._rate_of(case, plain, swapped[plain], exact[plain])).agrees is False
    assert judge(module._price(swapped)).agrees is False


def test_a_function_that_is_not_periodic_is_not_the_same_when_shifted():
    case = module.BELL
    exact = {name: module.exact(case, name) for name in module.SAMPLERS}
    assert judge(module._same(exact)).agrees is False


def test_the_disk_after_a_shift_is_the_mean_over_fixed_offsets():
    """The variance of the homogenised set is that of displaced strata, averaged over the offset."""
    case = module.DISK
    found = module.exact(case, "jittered | shift")[1]
    n, side = module.COUNTS[1], 12
    offsets = [(i + 0.5, j + 0.5) for i in range(side) for j in range(side)]
    values = [
        exact_variance(case.spec, f"jittered | strata-shift(offset=[{i / side}, {j / side}])", n)
        for i, j in offsets
    ]
    # A mean over 144 offsets of a continuous periodic function with kinks: errors of 1/144.
    assert np.mean(values) == pytest.approx(found, rel=1 / 144)
