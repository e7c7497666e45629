"""The formula for homogenised samples: findings, and what would contradict them."""

from __future__ import annotations

import numpy as np
import pytest

from mcspectra.integrands.registry import integrand
from mcspectra.report.reproduction import homogenised_formula as module
from mcspectra.report.reproduction.base import Exhibit


@pytest.fixture(scope="module")
def made() -> Exhibit:
    return module.exhibit(quick=True, seed=1)


def test_all_findings_agree(made: Exhibit) -> None:
    assert made.name == "homogenised-formula"
    assert [f.statement for f in made.findings if f.agrees is not True] == []
    assert all(len(p.alt) > 40 for p in made.pictures)


def test_points_that_are_not_shifted_disagree() -> None:
    data = module._terms("jittered", 1000, 2)
    assert module._no_third("jittered", data).agrees is False
    assert module._all_of_it("jittered", data).agrees is False


def test_shifted_points_are_not_above() -> None:
    assert module._only_then_measured(module._terms("jittered | shift", 1000, 2)).agrees is False


def test_what_is_cut_off_is_the_power_beyond() -> None:
    """∫f² by the midpoint rule on 1600² cells, which is exact to 1/1600² for a smooth f."""
    x = (np.arange(1600) + 0.5) / 1600
    f = integrand(module._BELL, 2)
    square = (f(np.stack(np.meshgrid(x, x), axis=-1)) ** 2).mean()
    kept = (np.abs(f.fourier_grid(module._HALF_WIDTH)) ** 2).sum()
    assert module._beyond() == pytest.approx(square - kept, rel=2e-3)
