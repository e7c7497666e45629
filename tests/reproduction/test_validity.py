"""Which formula is valid: predictions by other methods, and wrong inputs that must disagree."""

import pytest
from scipy.integrate import quad

import mcspectra as mcs
from mcspectra.reproduction import validity


@pytest.mark.parametrize("case", validity.CASES, ids=lambda case: case.title)
def test_three_terms_are_the_exact_variance(case):
    estimator = mcs.Estimator(validity.integrand(), case.density)
    expected = float(mcs.exact_variance(estimator, case.sampler, validity.N))
    assert validity._predicted(3, case) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("case", validity.CASES[2:], ids=lambda case: case.title)
def test_the_printed_terms_are_the_variance_of_the_reflected_integrand(case):
    f = validity.integrand()
    reflected = mcs.Integrand.from_function(lambda x: f(1.0 - x), dims=1, integral=1.0)
    estimator = mcs.Estimator(reflected, case.density)
    expected = float(mcs.exact_variance(estimator, case.sampler, validity.N))
    assert validity._predicted(2, case) == pytest.approx(expected, rel=1e-6)


def test_coefficients_at_real_frequencies_by_quadrature():
    import numpy as np

    nu = 1.37

    def f(x):
        wave = 1.0 - np.sin(2 * np.pi * x) + 0.5 * np.sin(16 * np.pi * x)
        return complex(wave * np.exp(-2j * np.pi * nu * x))

    expected = quad(f, 0, 1, complex_func=True, limit=200)[0]
    assert validity.coefficients(np.array([nu]))[0] == pytest.approx(expected, abs=1e-9)


def test_the_third_term_is_needed(disagreeing):
    right = validity._predicted
    found = disagreeing(validity, _predicted=lambda row, case: right(min(row, 1), case))
    assert found[-3:] == [6, 7, 8]
