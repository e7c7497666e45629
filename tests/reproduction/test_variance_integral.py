"""The variance of stationary samples: findings, and wrong inputs that must disagree."""

import numpy as np
import pytest
from scipy.integrate import quad

from mcspectra.reproduction import variance_integral
from mcspectra.reproduction.claims import judge


def test_reference_of_importance_samples_by_quadrature():
    """The reference is (∫f²/p − I²)/N for a bell and p, which are products over the axes."""

    def axis(center, power, weight):
        def part(x):
            bell = np.exp(-((x - center) ** 2) / 0.02)
            return bell**power / (1 + 1.5 * (x - 0.5)) ** weight

        return quad(part, 0, 1)[0]

    second, first = (axis(0.45, k, k - 1) * axis(0.6, k, k - 1) for k in (2, 1))
    expected = (second - first**2) / 64
    assert variance_integral.exact_weighted() == pytest.approx(expected, rel=1e-9)


def test_power_of_the_bell_by_quadrature():
    m, power = variance_integral.integrand_power()

    def axis(center, frequency):
        def bell(x):
            return complex(np.exp(-((x - center) ** 2) / 0.02 - 2j * np.pi * frequency * x))

        return quad(bell, 0, 1, complex_func=True)[0]

    expected = abs(axis(0.45, 2) * axis(0.6, -1)) ** 2
    (row,) = np.flatnonzero((m == (2, -1)).all(axis=1))
    assert power[row] == pytest.approx(expected, rel=1e-9)
    assert len(m) == 25**2 - 1


def test_correlated_frequencies_disagree():
    """Importance samples have covariances C_ml from 1/p."""
    weighted = variance_integral.importance_terms(1000, 1)
    assert judge(variance_integral._diagonal("random", weighted)).agrees is False


def test_the_sum_of_another_sampler_disagrees(monkeypatch):
    exact = variance_integral.exact("random")
    monkeypatch.setattr(variance_integral, "exact", lambda name, n=64: exact * 1.0001)
    assert judge(variance_integral._closed_sum("random")).agrees is False
