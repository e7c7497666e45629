"""The formula for homogenised samples: findings, and what would contradict them."""

import numpy as np
import pytest

from mcspectra.integrands.registry import integrand
from mcspectra.reproduction import homogenised_formula as module
from mcspectra.reproduction.claims import judge


def test_points_that_are_not_shifted_disagree():
    data = module.terms("jittered", 1000, 2)
    assert judge(module._no_third("jittered", data)).agrees is False
    assert judge(module._all_of_it("jittered", data)).agrees is False


def test_shifted_points_are_not_above():
    assert judge(module._more_than_all(module.terms("jittered | shift", 1000, 2))).agrees is False


def test_what_is_cut_off_is_the_power_beyond():
    """∫f² by the midpoint rule on 1600² cells, which is exact to 1/1600² for a smooth f."""
    x = (np.arange(1600) + 0.5) / 1600
    f = integrand(module.BELL, 2)
    square = (f(np.stack(np.meshgrid(x, x), axis=-1)) ** 2).mean()
    kept = (np.abs(f.fourier_grid(module.HALF_WIDTH)) ** 2).sum()
    assert module.beyond() == pytest.approx(square - kept, rel=2e-3)
