"""Ratios f/p where p vanishes, and pdfs that overflow floats."""

import warnings

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import DensityError, UndefinedRatioWarning, point_in_words
from mcspectra.densities.base import bounded_product, divide_by_density

IDENTITY = mcs.Integrand.from_function(lambda x: x[..., 0], dims=1, integral=0.5)


@pytest.mark.parametrize("sampler", ["halton", "sobol"])
def test_a_sample_at_a_common_zero_warns(sampler):
    """f/p = ½ everywhere except at the origin, where both are 0: the mean is 15/32, not ½."""
    estimator = mcs.Estimator(IDENTITY, "linear(slope=2)")
    with pytest.warns(
        UndefinedRatioWarning, match=r"\(0\).*whatever its limit.*\| shift"
    ) as caught:
        found = mcs.convergence(estimator, sampler, [16], realizations=2)
    assert float(found["mean"][0]) == pytest.approx(15 / 32, abs=1e-15)
    assert len({str(each.message) for each in caught}) == 1


def test_the_warning_is_shown_once_for_an_estimator():
    estimator = mcs.Estimator(IDENTITY, "linear(slope=2)")
    u = np.zeros((2, 1))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        for _ in range(3):
            estimator.primary_values(0, u)
    assert len(caught) == 1


def test_randomized_samplers_do_not_warn():
    estimator = mcs.Estimator(IDENTITY, "linear(slope=2)")
    found = mcs.convergence(estimator, "sobol | shift", [16], realizations=4)
    assert float(found["mean"][0]) == pytest.approx(0.5, abs=1e-15)


def test_zeros_of_the_density_alone_are_errors_with_advice():
    x = np.array([[0.0], [0.5]])
    with pytest.raises(
        DensityError, match=r"where f is not 0; .* randomize the sampler .* else choose"
    ):
        divide_by_density(np.ones(2), np.array([0.0, 1.0]), x, "name")
    with pytest.raises(DensityError, match="its weight is infinite; .* randomize the sampler"):
        mcs.Estimator(IDENTITY, "linear(slope=2)").weight(0, x)


def test_one_zero_of_many_channels_is_enough():
    x, pdf = np.array([[0.0], [0.5]]), np.array([0.0, 2.0])
    with pytest.raises(DensityError, match="where f is not"):
        divide_by_density(np.array([[0.0, 1.0], [1, 1]]), pdf, x, "name")
    with pytest.warns(UndefinedRatioWarning):
        found = divide_by_density(np.array([[0.0, 0.0], [1, 4]]), pdf, x, "name")
    np.testing.assert_array_equal(found, [[0, 0], [0.5, 2]])


def test_points_in_messages_are_truncated():
    assert point_in_words([0.25, 1 / 3]) == "(0.25, 0.333333)"
    assert point_in_words(np.zeros(6)) == "(0, 0, 0, 0, 0, 0)"
    assert point_in_words(np.zeros(1024)) == "(0, 0, 0, 0, 0, 0, … 1018 more)"


def test_products_whose_partial_products_overflow():
    factors = np.array([[1e200, 1e200, 1e-300], [2, 3, 4], [1e200, 1e200, 0]])
    np.testing.assert_allclose(bounded_product(factors, "name"), [1e100, 24, 0], rtol=1e-12)
    with pytest.raises(DensityError, match=r"name reaches exp\(921.034\), more than a float"):
        bounded_product(np.array([1e200, 1e200]), "name")


@pytest.mark.parametrize(
    ("spec", "point"),
    [
        ("truncated-normal(sigma=0.01)", 0.5),
        ("exponential(rate=100)", 0.0),
        ("linear(slope=2)", 1.0),
        ("tent", 0.5),
    ],
)
def test_a_pdf_that_overflows_is_an_error(spec, point):
    p = mcs.density(spec, dims=1024)
    with pytest.raises(DensityError, match="more than a float can hold") as caught:
        p.pdf(np.full(1024, point))
    assert len(str(caught.value)) < 250
    few = mcs.density(spec, dims=3)
    one = mcs.density(spec, dims=1)
    assert few.pdf(np.full(3, point)) == pytest.approx(float(one.pdf([point])) ** 3, rel=1e-13)
