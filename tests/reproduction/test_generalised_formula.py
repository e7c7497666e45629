"""The three terms: findings, and what would contradict them."""

import numpy as np

from mcspectra.integrands.registry import integrand
from mcspectra.reproduction import generalised_formula as module
from mcspectra.reproduction.claims import judge


def test_a_matrix_is_split_into_its_terms():
    matrix = np.arange(9.0).reshape(3, 3)
    assert module.split(matrix) == (4.0, 8.0, 24.0)


def test_terms_of_another_sampler_disagree():
    data = module.terms(integrand("linear", 1), "random", 400, 1)
    assert judge(module._line_terms(data)[0]).agrees is False
    jittered = module.terms(integrand("linear", 1), "jittered", 400, 1)
    assert judge(module._only_power(jittered)).agrees is False


def test_without_a_term_the_sum_is_not_the_variance():
    data = module.terms(integrand("linear", 1), "jittered", 100, 1)
    assert judge(module._sum_is_variance([data])).agrees is True
    short = data.assign(predicted_variance=data["predicted_variance"] - data["cross_term"])
    assert judge(module._sum_is_variance([short])).agrees is False


def test_a_matrix_that_is_not_hermitian_disagrees():
    data = module.terms(integrand("linear", 1), "jittered", 100, 1)
    matrix = data["cross_matrix"].copy()
    matrix[0, 1] += 1e-6j
    assert judge(module._third_is_real([data])).agrees is True
    assert judge(module._third_is_real([data.assign(cross_matrix=matrix)])).agrees is False
