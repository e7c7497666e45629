"""Strata alignment: findings, and what would contradict them."""

from __future__ import annotations

import numpy as np
import pytest

from mcspectra.report.reproduction import strata_alignment as module
from mcspectra.report.reproduction.base import Exhibit
from mcspectra.variance.exact import exact_variance


@pytest.fixture(scope="module")
def made() -> Exhibit:
    return module.exhibit(quick=True, seed=1)


def test_all_findings_agree(made: Exhibit) -> None:
    assert made.name == "strata-alignment"
    assert [f.statement for f in made.findings if f.agrees is not True] == []
    assert all(len(p.alt) > 40 for p in made.pictures)


def test_the_other_edge_disagrees() -> None:
    data = module._curve(module._edge(1 / 3), "jittered", 400, 1)
    curves = dict.fromkeys(module.PLACES, data)
    assert module._rate(module._ALIGNED, curves, -2.0).agrees is False
    assert module._level(module._ALIGNED, data).agrees is False
    assert module._level(module._CUT, data).agrees is True
    assert module._gain(curves).agrees is False


@pytest.mark.parametrize("a", [0.5, 1 / 3])
def test_exact_variances_are_those_of_quadrature(a: float) -> None:
    """Step and ramp of the package's own, whose variances add in every stratum."""
    parts = [
        [float(exact_variance(f, "jittered", n)) for n in module.COUNTS]
        for f in (f"step(at={a})", "linear")
    ]
    assert np.sum(parts, axis=0) == pytest.approx(module.exact(a), rel=1e-5)


@pytest.mark.parametrize("a", [0.5, 1 / 3])
def test_homogenised_variances_are_those_of_quadrature(a: float) -> None:
    parts = [
        [float(exact_variance(f, "jittered | shift", n)) for n in module.COUNTS]
        for f in (f"step(at={a})", "linear")
    ]
    assert np.sum(parts, axis=0) == pytest.approx(module.homogenised(), rel=1e-5)
