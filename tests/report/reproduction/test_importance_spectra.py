"""Spectra of importance samples: findings, formulas by other routes, and contradictions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

import mcspectra as mcs
from mcspectra.report.reproduction import importance_spectra as spectra
from mcspectra.report.reproduction.base import Exhibit


@pytest.fixture(scope="module")
def made() -> Exhibit:
    return spectra.exhibit(quick=True, seed=1)


def test_all_findings_agree(made: Exhibit) -> None:
    assert made.name == "importance-spectra"
    assert [f.statement for f in made.findings if f.agrees is not True] == []
    assert all(len(p.alt) > 40 for p in made.pictures)


def test_the_level_by_quadrature() -> None:
    p = mcs.density(spectra._DENSITY, 1)
    one = quad(lambda x: float(1 / p.pdf(np.array([x]))), 0, 1)[0]
    assert pytest.approx(one**2, rel=1e-10) == spectra._LEVEL


def test_the_coefficient_of_the_density_by_quadrature() -> None:
    p = mcs.density(spectra._DENSITY, 1)
    sine = quad(lambda x: float(p.pdf(np.array([x]))) * np.sin(2 * np.pi * x), 0, 1)[0]
    assert abs(sine) == pytest.approx(spectra._SLOPE / (2 * np.pi), rel=1e-10)


def test_spectra_of_another_sampler_disagree() -> None:
    jittered, random = (spectra._spectrum(name, 100, 1) for name in ("jittered", "random"))
    assert spectra._ring("random", jittered, 1).agrees is False
    assert spectra._ring("jittered", random, 1).agrees is False
    assert spectra._below(random).agrees is False
    assert spectra._below(jittered).agrees is False


def test_weights_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    right = spectra._sums
    monkeypatch.setattr(spectra, "_sums", lambda *a, weighted: right(*a, weighted=not weighted))
    assert spectra._without_weights(300, 1).agrees is False
    assert spectra._dc("random", 100, 1).agrees is False
