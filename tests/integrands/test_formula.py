"""Formulas: the values of NumPy's functions, and an error message for everything else."""

import pickle

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.integrands import Formula
from mcspectra.integrands.formula import FUNCTIONS, MOST_PARTS

X = np.random.default_rng(3).random((5, 7, 3))
x, y, z = np.moveaxis(X, -1, 0)

VALUES = {
    "exp(-x**2 - y**2)": np.exp(-(x**2) - y**2),
    "x0 - x1*x2": x - y * z,
    "-x ** 2": -(x**2),
    "2 ** -x ** y": 2.0 ** (-(x**y)),
    "7": np.full(x.shape, 7.0),
    "1 - 2 - 3": np.full(x.shape, -4.0),
    "pi * e / 2": np.full(x.shape, np.pi * np.e / 2),
    "x % 0.25": x % 0.25,
    "x < 0.5": (x < 0.5).astype(float),
    "0.25 < x <= y": ((x > 0.25) & (x <= y)).astype(float),
    "(x < 0.5) * (y >= z)": (x < 0.5) * (y >= z) * 1.0,
    "where(x > y, sqrt(x - min(x, y)), -1)": np.where(x > y, np.sqrt(np.abs(x - y)), -1.0),
    "hypot(x - 0.5, y - 0.5) + arctan2(y, x)": np.hypot(x - 0.5, y - 0.5) + np.arctan2(y, x),
    "max(abs(x - y), 1e-3)": np.maximum(np.abs(x - y), 1e-3),
    "9007199254740993 - 9007199254740992": np.zeros(x.shape),
}

REFUSED = {
    "__import__('os').system('true')": "no function",
    "().__class__": "functions only",
    "x.__class__": "functions only",
    "eval('1')": "no function 'eval'",
    "lambda: 1": "functions only",
    "[x for x in y]": "functions only",
    "x[0]": "functions only",
    "(x := 1)": "functions only",
    "x if y else z": "functions only",
    "x and y": "functions only",
    "not x": "operator Not",
    "x == y": "operator Eq",
    "~x": "operator Invert",
    "f'{x}'": "functions only",
    "'a' * 9": "real numbers",
    "1j": "real numbers",
    "True": "real numbers",
    "exp": "no 'exp'",
    "x3": "Did you mean|coordinates",
    "exq(x)": "Did you mean 'exp'",
    "exp()": "1 positional argument",
    "exp(x, y)": "1 positional argument",
    "exp(x, out=y)": "1 positional argument",
    "exp(*x)": "1 positional argument",
    "exp(**x)": "1 positional argument",
    "exp(x)(y)": "no function",
    "x y": "cannot be read",
    "x = 1": "cannot be read",
    "x\x00": "cannot be read",
    "": "give text",
    "  ": "give text",
    "log(-1)": "NaN or infinite",
    "9**9**9**9": "NaN or infinite",
    "1" + "0" * 400: "too large",
    "x" * 10_000: "has no 'xxx",
    "+" * 10**6 + "x": "give at most",
    "(" * 10**6: "give at most",
    "x<" * 10**6 + "x": "give at most",
    "+".join(["x"] * MOST_PARTS): "give at most",
    "-" * 200 + "x": "give at most",
    "(" * 400 + "x" + ")" * 400: "cannot be read|levels",
    "exp(" * 150 + "x" + ")" * 150: "give at most",
}


@pytest.mark.parametrize("text", VALUES)
def test_values_are_numpys(text):
    np.testing.assert_allclose(Formula(expression=text, dims=3)(X), VALUES[text], rtol=1e-15)


@pytest.mark.parametrize("text", REFUSED, ids=lambda text: text[:24])
def test_anything_else_gets_a_sentence(text):
    with pytest.raises(ParameterError, match=REFUSED[text]) as caught:
        Formula(expression=text, dims=3)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("given", [None, b"x"])
def test_what_is_no_text_is_refused(given):
    with pytest.raises(ParameterError, match="give text"):
        Formula(expression=given)


@pytest.mark.parametrize(("text", "dims"), [("y", 1), ("x3", 3)])
def test_coordinates_beyond_the_dims_are_refused(text, dims):
    with pytest.raises(ParameterError, match=f"in {dims} dims has no '{text}'"):
        Formula(expression=text, dims=dims)
    assert Formula(expression=text, dims=dims + 1).dims == dims + 1


def test_every_function_takes_its_arguments():
    for name, (_, arity) in FUNCTIONS.items():
        call = f"{name}({', '.join(['x', 'y', 'z'][:arity])})"
        assert np.isfinite(Formula(expression=call, dims=3)(X)).all(), call


@pytest.mark.parametrize("text", ["1/(x - 0.5)", "log(x*y*z)"])
def test_what_is_infinite_on_a_line_only_is_taken(text):
    assert np.isfinite(Formula(expression=text, dims=3)(X)).all()


def test_a_place_where_it_is_not_finite_is_named():
    f = Formula(expression="1/x")
    with pytest.raises(ParameterError, match=r"NaN or infinite, for example at \(0, 0.5\)"):
        f([[0.25, 0.5], [0.0, 0.5]])


def test_comparisons_to_numbers_are_breaks_of_the_quadrature():
    f = Formula(expression="(x < 0.3)*(0.2 <= y)*(y <= 1)*(x < pi)*(x < y)", dims=2)
    assert f.breaks == ((0.3,), (0.2,))
    g = Formula(expression="(x0 < 0.3)*(1 + y)", dims=2)
    assert g.integral == pytest.approx(0.45, rel=1e-12)


def test_integral_and_coefficients_are_those_of_the_same_function_in_closed_form():
    known = mcs.integrand("gaussian(center=[0.3, 0.6], width=0.25)", dims=2)
    text = "exp(-((x - 0.3)**2 + (y - 0.6)**2) / (2 * 0.25**2))"
    f = mcs.integrand(f"formula(expression={text!r})", dims=2)
    scale = known([0.3, 0.6]) / f([0.3, 0.6])
    assert scale * f.integral == pytest.approx(known.integral, rel=1e-10)
    np.testing.assert_allclose(scale * f.fourier_grid(4), known.fourier_grid(4), atol=1e-10)


def test_specs_and_pickles_make_it_again():
    f = Formula(expression="where(x < 0.5, 1, x/2)", dims=1)
    assert mcs.integrand(f.spec, dims=1) == f
    assert pickle.loads(pickle.dumps(f)) == f


def test_a_formula_has_parts_and_levels_to_count_and_no_characters():
    """Earlier versions refused more than 1000 characters."""
    text = " + ".join(f"{0.1:.15f} * sin({k} * x0)".ljust(80) for k in range(30))
    assert len(text) > 2000
    assert np.isfinite(Formula(expression=text, dims=1)(X[..., :1])).all()
