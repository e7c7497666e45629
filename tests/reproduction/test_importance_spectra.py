"""Spectra of importance samples: formulas by other methods, and wrong inputs that must disagree."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from tests.reproduction.conftest import Disagreeing

import mcspectra as mcs
from mcspectra.reproduction import importance_spectra as spectra


def test_the_level_by_quadrature() -> None:
    p = mcs.density(spectra.DENSITY, 1)
    one = quad(lambda x: float(1 / p.pdf(np.array([x]))), 0, 1)[0]
    assert pytest.approx(one**2, rel=1e-10) == spectra.LEVEL


def test_the_coefficient_of_the_density_by_quadrature() -> None:
    p = mcs.density(spectra.DENSITY, 1)
    sine = quad(lambda x: float(p.pdf(np.array([x]))) * np.sin(2 * np.pi * x), 0, 1)[0]
    assert abs(sine) == pytest.approx(spectra.SLOPE / (2 * np.pi), rel=1e-10)


def test_spectra_of_another_sampler_and_sums_without_weights_disagree(
    disagreeing: Disagreeing,
) -> None:
    spectrum, sums = spectra.spectrum, spectra.sums
    others = {"random": "jittered", "jittered": "random", "poisson-disk": "random"}
    assert {0, 2, 4, 5, 6, 9} <= set(
        disagreeing(
            spectra,
            spectrum=lambda name, _, seed, slope=1.6: spectrum(others[name], 100, seed, slope),
            sums=lambda *a, weighted: sums(*a, weighted=not weighted),
        )
    )
