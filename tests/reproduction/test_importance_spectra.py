"""Spectra of importance samples: findings, formulas by other routes, and contradictions."""

import numpy as np
import pytest
from scipy.integrate import quad

import mcspectra as mcs
from mcspectra.reproduction import importance_spectra as spectra
from mcspectra.reproduction.claims import judge


def test_the_level_by_quadrature():
    p = mcs.density(spectra.DENSITY, 1)
    one = quad(lambda x: float(1 / p.pdf(np.array([x]))), 0, 1)[0]
    assert pytest.approx(one**2, rel=1e-10) == spectra.LEVEL


def test_the_coefficient_of_the_density_by_quadrature():
    p = mcs.density(spectra.DENSITY, 1)
    sine = quad(lambda x: float(p.pdf(np.array([x]))) * np.sin(2 * np.pi * x), 0, 1)[0]
    assert abs(sine) == pytest.approx(spectra.SLOPE / (2 * np.pi), rel=1e-10)


def test_spectra_of_another_sampler_disagree():
    jittered, random = (spectra.spectrum(name, 100, 1) for name in ("jittered", "random"))
    assert judge(spectra._ring_level("random", jittered, 1)).agrees is False
    assert judge(spectra._ring_level("jittered", random, 1)).agrees is False
    assert judge(spectra._below_random(random)).agrees is False
    assert judge(spectra._below_random(jittered)).agrees is False


def test_weights_matter(monkeypatch):
    right = spectra.sums
    monkeypatch.setattr(spectra, "sums", lambda *a, weighted: right(*a, weighted=not weighted))
    assert judge(spectra._without_weights(300, 1)).agrees is False
    assert judge(spectra._dc_component("random", 100, 1)).agrees is False
