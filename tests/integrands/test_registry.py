"""Names, dims and invalid parameters in user input."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import DomainError, ParameterError, SpecError, UnknownName
from mcspectra.integrands import INTEGRANDS, Gaussian, as_integrand, integrand


def test_every_name_has_a_summary_that_starts_with_a_sentence():
    for name in INTEGRANDS:
        cls = INTEGRANDS.load(name)
        assert cls.name == name
        assert issubclass(cls, mcs.Integrand)
        assert cls.summary().endswith(".")


def test_dims():
    assert integrand("gaussian").dims == 2
    assert integrand("gaussian", dims=5).dims == 5
    assert integrand("gaussian(dims=3)").dims == 3
    assert integrand("gaussian(dims=3)", dims=3).dims == 3
    assert integrand("christensen-disk").dims == 2
    f = Gaussian(dims=1)
    assert as_integrand(f) is f
    assert as_integrand("step", 3).dims == 3


def test_equal_specs_are_equal_integrands():
    assert integrand("gaussian(center=[0.5, 0.5])") == Gaussian(center=np.array([0.5, 0.5]))
    assert hash(Gaussian(center=[0.5, 0.5])) == hash(Gaussian(center=(0.5, 0.5)))
    assert integrand("gaussian") != integrand("gaussian", dims=3)


@pytest.mark.parametrize(
    ("spec", "dims", "words"),
    [
        (7, None, "string"),
        ("gaussian(dims=0)", None, "gaussian: dims"),
        ("christensen-disk", 3, "for 2 dims"),
        ("image", None, "either path"),
        ("gaussian(width=0)", None, "width"),
        ("gaussian(width=True)", None, "width"),
        ("gaussian(center=[0.5])", None, "center has 1 value;"),
        ("gaussian(center=[0.5, 'x'])", None, "center[1]"),
        ("constant(value=None)", None, "value"),
        ("linear(gradient=[1, 2, 3])", None, "gradient has 3 values"),
        ("linear(offset=[1])", None, "offset"),
        ("polynomial(coefficients=[])", None, "coefficients"),
        ("polynomial(coefficients='123')", None, "coefficients"),
        (f"polynomial(coefficients={[0] * 22})", None, "21"),
        ("polynomial(coefficients=[1, None])", None, "coefficients[1]"),
        ("cosine(frequency=0.5)", None, "whole number"),
        ("cosine(frequency=[1, 2.5])", None, "frequency[1]"),
        ("step(at=1.5)", None, "at most 1"),
        ("step(axis=2)", None, "axis"),
        ("step(axis=-1)", None, "axis"),
        ("smoothed-step(at=-0.1)", None, "at least 0"),
        ("smoothed-step(width=0)", None, "width"),
        ("disk(radius=0)", None, "radius"),
        ("disk(center=[0.5, 0.5, 0.5])", None, "center has 3 values"),
        ("half-space(normal=[0, 0])", None, "normal"),
        ("half-space(offset=None)", None, "offset"),
    ],
)
def test_refused(spec, dims, words):
    with pytest.raises(ParameterError) as caught:
        integrand(spec, dims=dims)
    assert words in str(caught.value)
    assert str(caught.value).count("\n") == 0


def test_kinds_of_errors():
    with pytest.raises(UnknownName):
        integrand("nothing-like-this")
    with pytest.raises(SpecError):
        integrand("gaussian(1)")


def test_numbers_from_python_are_checked_too():
    for name, parameter in (("gaussian", "center"), ("disk", "center"), ("linear", "gradient")):
        for value in (np.nan, 1j, [1.0, np.nan]):
            with pytest.raises(ParameterError, match=parameter):
                INTEGRANDS.load(name)(**{parameter: value})


def test_as_integrand_refuses():
    with pytest.raises(ParameterError, match="from_function"):
        as_integrand(np.sin)
    with pytest.raises(ParameterError, match="not an integrand"):
        as_integrand(None)
    with pytest.raises(ParameterError, match="has 1 dim, but 2"):
        as_integrand(Gaussian(dims=1), 2)


@pytest.mark.parametrize("points", [np.zeros((4, 3)), 0.5, [[0.1, np.nan]], [[0.1, 1.1]], None])
def test_bad_points(points):
    with pytest.raises(DomainError):
        Gaussian()(points)
