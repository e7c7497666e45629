"""Strata alignment: findings, and what would contradict them."""

import numpy as np
import pytest

from mcspectra.reproduction import strata_alignment as module
from mcspectra.reproduction.claims import judge
from mcspectra.variance.exact import exact_variance


def test_the_other_edge_disagrees():
    data = module.measured(module.edge(1 / 3), "jittered", 400, 1)
    curves = dict.fromkeys(module.PLACES, data)
    assert judge(module._rate_of(module.ALIGNED, curves, -2.0)).agrees is False
    assert judge(module._level(module.ALIGNED, data)).agrees is False
    assert judge(module._level(module.CUT, data)).agrees is True
    assert judge(module._gain(curves)).agrees is False


@pytest.mark.parametrize("a", [0.5, 1 / 3])
def test_exact_variances_are_those_of_quadrature(a):
    """Step and ramp of the package's own, whose variances add in every stratum."""
    parts = [
        [float(exact_variance(f, "jittered", n)) for n in module.COUNTS]
        for f in (f"step(at={a})", "linear")
    ]
    assert np.sum(parts, axis=0) == pytest.approx(module.exact(a), rel=1e-5)


@pytest.mark.parametrize("a", [0.5, 1 / 3])
def test_homogenised_variances_are_those_of_quadrature(a):
    parts = [
        [float(exact_variance(f, "jittered | shift", n)) for n in module.COUNTS]
        for f in (f"step(at={a})", "linear")
    ]
    assert np.sum(parts, axis=0) == pytest.approx(module.homogenised(), rel=1e-5)
