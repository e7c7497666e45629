"""Names, dims and conversion of densities."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError, UnknownName
from mcspectra.densities import DENSITIES, Linear, as_density


def test_all_names_load_and_have_a_summary():
    expected = {"image", "linear", "piecewise-constant", "truncated-normal", "uniform"}
    assert expected <= set(DENSITIES)
    for name in DENSITIES:
        cls = DENSITIES.load(name)
        assert cls.name == name
        assert len(cls.summary()) > 10


@pytest.mark.parametrize(
    ("spec", "dims", "expected"),
    [
        ("uniform", None, 2),
        ("uniform", 5, 5),
        ("uniform(dims=3)", None, 3),
        ("piecewise-constant(values=[1, 2])", None, 1),
        ("piecewise-constant(values=[[1, 2]])", None, 2),
    ],
)
def test_dims(spec, dims, expected):
    assert mcs.density(spec, dims).dims == expected


def test_as_density():
    line = Linear(dims=1)
    assert as_density(None, 3) is None
    assert as_density(line) is line
    assert as_density(line, 1) is line
    assert as_density("linear", 1) == line
    with pytest.raises(ParameterError, match="has 1 dim, but 2"):
        as_density(line, 2)
    for wrong in (3, lambda x: x, ["linear"]):
        with pytest.raises(ParameterError, match="is not a density"):
            as_density(wrong)
    with pytest.raises(ParameterError):
        mcs.density(None)


def test_the_error_for_an_unknown_name_names_the_list():
    with pytest.raises(UnknownName, match="'mcspectra list densities' shows them"):
        mcs.density("qqq")


@pytest.mark.parametrize(
    "template",
    [
        "cosine-weighted(dims={})",
        "exponential(dims={})",
        "linear(dims={}, slope=[1, 2])",
        "power(dims={})",
        "tent(dims={})",
        "truncated-normal(dims={})",
        "uniform(dims={})",
        "mixture(dims={}, parts=['tent', 'linear'])",
        "defensive(dims={}, density='tent')",
        "mixture(parts=['tent', 'linear'], axis={}, dims=3)",
        "defensive(density='tent', axis={}, dims=3)",
    ],
)
def test_whole_floats_are_read_as_integers(template):
    given, expected = mcs.density(template.format("2.0")), mcs.density(template.format("2"))
    assert given.spec == expected.spec
    assert type(given.dims) is int
    u = np.random.default_rng(5).random((7, expected.dims))
    np.testing.assert_array_equal(given.sample(u), expected.sample(u))
    np.testing.assert_array_equal(given.pdf(u), expected.pdf(u))
    assert len(given.breaks) == given.primary_dims
