"""Strata alignment: findings, and wrong inputs that must disagree."""

from __future__ import annotations

import numpy as np
import pytest
from tests.reproduction.conftest import Disagreeing

from mcspectra.prediction.exact import exact_variance
from mcspectra.reproduction import strata_alignment as module


def test_the_other_edge_disagrees(disagreeing: Disagreeing) -> None:
    data = module.measured(module.edge(1 / 3), "jittered", 400, 1)
    found = disagreeing(module, measured=lambda *_: data)
    assert {3, 0, 2} <= set(found)
    assert {4, 1}.isdisjoint(found)


@pytest.mark.parametrize("a", [0.5, 1 / 3])
def test_exact_variances_agree_with_quadrature(a: float) -> None:
    """The variances of the package's own step and ramp add up in every stratum."""
    parts = [
        [float(exact_variance(f, "jittered", n)) for n in module.COUNTS]
        for f in (f"step(at={a})", "linear")
    ]
    assert np.sum(parts, axis=0) == pytest.approx(module.exact(a), rel=1e-5)


@pytest.mark.parametrize("a", [0.5, 1 / 3])
def test_homogenized_variances_agree_with_quadrature(a: float) -> None:
    parts = [
        [float(exact_variance(f, "jittered | shift", n)) for n in module.COUNTS]
        for f in (f"step(at={a})", "linear")
    ]
    assert np.sum(parts, axis=0) == pytest.approx(module.homogenised(), rel=1e-5)
