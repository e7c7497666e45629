"""Callables as integrands: accepted and rejected functions."""

import dataclasses
import math
import pickle

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError

make = mcs.Integrand.from_function


def test_scalar_and_channels():
    f = make(lambda x: x[..., 0] * x[..., 1], dims=2)
    assert f.channels == 0
    assert f(np.full((4, 7, 2), 0.5)).shape == (4, 7)
    assert f.integral == pytest.approx(0.25, abs=1e-15)
    assert f.spec == "function(<lambda>)"
    g = make(lambda x: np.stack([x[..., 0], x[..., 0] ** 2], -1), dims=1, integral=[0.5, 1 / 3])
    assert g.channels == 2
    assert g(np.zeros((4, 7, 1))).shape == (4, 7, 2)
    assert g.integral_source == "exact"
    assert np.array_equal(g.integral, [0.5, 1 / 3])
    assert g.fourier([[1], [2]]).shape == (2, 2)


def test_booleans_and_integers_are_numbers():
    f = make(lambda x: x[..., 0] < 0.25, dims=1)
    assert f(np.array([[0.1], [0.5]])).dtype == np.float64
    assert f.integral == pytest.approx(0.25, abs=1e-12)


def test_one_channel_stays_a_channel():
    f = make(lambda x: x, dims=1)
    assert f.channels == 1
    assert f.integral.shape == (1,)


def test_known_coefficients():
    f = make(
        lambda x: np.cos(2 * np.pi * x[..., 0]),
        dims=1,
        integral=0,
        fourier=lambda m: 0.5 * (np.abs(m[..., 0]) == 1),
    )
    assert f.fourier_source == "exact"
    assert np.array_equal(f.fourier_grid(2), [0, 0.5, 0, 0.5, 0])
    assert f.fourier_grid(2).dtype == np.complex128


def branch(x):
    return 1.0 if x < 0.5 else 0.0


@pytest.mark.parametrize(
    ("function", "dims", "words"),
    [
        ("x**2", 1, "callable"),
        (lambda x: x[..., 0], 0, "dims"),
        (lambda x: x[..., 0] * np.inf + 1, 1, "NaN or infinite at 28 of 28 points"),
        (lambda x: x[..., 0] + 1j, 1, "complex"),
        (lambda x: np.full(x.shape[:-1], "a"), 1, "real numbers"),
        (lambda _: [[1], [1, 2]], 1, "ragged"),
        (lambda _: 1.0, 1, "shape ()"),
        (lambda x: x[0], 2, "shape (7, 2)"),
        (lambda x: x[..., None], 2, "(4, 7, 2, 1)"),
        (lambda x: np.zeros((*x.shape[:-1], 0)), 2, "(4, 7, 0)"),
        (lambda x: math.sin(x), 1, "one point at a time"),
        (branch, 1, "one point at a time"),
        (lambda x: math.exp(x[0] * x[1]), 2, "one point at a time"),
    ],
)
def test_refused_functions(function, dims, words):
    with pytest.raises(ParameterError) as caught:
        make(function, dims=dims)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("known", "words"),
    [
        ({"integral": "half"}, "half"),
        ({"integral": float("nan")}, "finite"),
        ({"integral": [1, 2]}, "one finite number"),
        ({"integral": 1j}, "real number"),
        ({"fourier": 3}, "callable"),
        ({"fourier": lambda m: m}, "shape (2, 3, 2)"),
        ({"fourier": lambda m: np.full(m.shape[:-1], np.nan)}, "NaN"),
        ({"fourier": lambda _: None}, "type object"),
    ],
)
def test_refused_knowledge(known, words):
    with pytest.raises(ParameterError) as caught:
        make(lambda x: x[..., 0], dims=2, **known)
    assert words in str(caught.value)


def test_a_wrong_number_of_channels_in_the_integral():
    with pytest.raises(ParameterError, match="3 finite numbers"):
        make(lambda x: x, dims=3, integral=[1, 2])


def test_errors_of_the_function_are_its_own():
    def broken(x):
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        make(broken, dims=1)


def test_every_call_is_checked():
    f = make(lambda x: np.where(x[..., 0] == 0.125, np.nan, 1.0), dims=2)
    with pytest.raises(ParameterError, match=r"1 of 3 points, the first \(0.125, 0.5\)"):
        f(np.array([[0.1, 0.1], [0.125, 0.5], [0.3, 0.3]]))
    g = make(lambda x: x[..., 0] if len(x) == 4 else x[..., :1], dims=2)
    with pytest.raises(ParameterError, match="1 value at each point"):
        g(np.zeros((3, 2)))


def wave(x):
    return np.cos(3.0 * x).sum(axis=-1)


def test_what_is_found_out_stays_in_one_cache():
    f = make(wave, dims=2)
    mcs.predict(f, ["jittered", "rank1-lattice | shift"], [16], max_evaluations=2**40)
    mcs.exact_variance(f, "random", 4)
    f.fourier_grid(1)
    fields = {field.name for field in dataclasses.fields(f)}
    assert set(vars(f)) - fields == {"_cache"}
    for name in ("integral", "coefficients", "breaks", "cut", "moments", "square"):
        assert getattr(f._cache, name) is not None, name


def test_pickles_keep_what_was_found_out():
    f = make(wave, dims=2)
    integral = f.integral
    calls = []
    again = pickle.loads(pickle.dumps(f))
    object.__setattr__(again, "function", calls.append)
    assert again.integral == integral
    assert not calls
