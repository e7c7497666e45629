"""Products: each part acts on its own axes, as objects or nested specs."""

from __future__ import annotations

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.densities import Linear, PiecewiseConstant, Product, Tent

X = np.random.default_rng(1).random((300, 3))


def test_parts_act_on_their_own_axes():
    table = PiecewiseConstant(values=[[1, 2], [3, 0.5]])
    p = Product(parts=[Tent(dims=1), table])
    assert p.dims == 3
    np.testing.assert_allclose(p.pdf(X), Tent(dims=1).pdf(X[:, :1]) * table.pdf(X[:, 1:]))
    x = p.sample(X)
    np.testing.assert_array_equal(x[:, :1], Tent(dims=1).sample(X[:, :1]))
    np.testing.assert_array_equal(x[:, 1:], table.sample(X[:, 1:]))
    np.testing.assert_allclose(p.invert(x), X, atol=1e-14)
    assert p.breaks == (*Tent(dims=1).breaks, *table.breaks)


def test_a_product_of_lines_is_the_line_in_more_dims():
    whole = Linear(dims=3, slope=[1, -2, 0.5])
    p = Product(parts=["linear(slope=1)", "linear(dims=2, slope=[-2, 0.5])"])
    np.testing.assert_allclose(p.pdf(X), whole.pdf(X), rtol=1e-14)
    np.testing.assert_array_equal(p.sample(X), whole.sample(X))
    assert Product(parts=["linear", "uniform"]).reciprocal_integral() == pytest.approx(np.log(3))


def test_specs_keep_the_dims_of_parts():
    p = Product(parts=[Linear(dims=2), Tent(dims=1), Linear(dims=3, slope=1.5)])
    assert p.spec == "product(parts=['linear(dims=2)', 'tent', 'linear(dims=3, slope=1.5)'])"
    assert mcs.density(p.spec) == p
    nested = Product(parts=[p, "mixture(parts=['tent', 'uniform'], dims=2)"])
    again = mcs.density(nested.spec, dims=8)
    assert again.spec == nested.spec
    u = np.random.default_rng(2).random((50, 8))
    np.testing.assert_array_equal(again.sample(u), nested.sample(u))


def test_mixtures_in_products_bring_their_extra_coordinate():
    p = Product(parts=["tent", "mixture(parts=['tent', 'uniform'], selection='extra')", "linear"])
    assert (p.dims, p.primary_dims, p.has_inverse) == (3, 4, False)
    u = np.random.default_rng(3).random((100, 4))
    x = p.sample(u)
    assert x.shape == (100, 3)
    np.testing.assert_array_equal(x[:, 2:], Linear(dims=1).sample(u[:, 3:]))
    p.check()
    with pytest.raises(DensityError, match="no inverse"):
        p.invert(x)


def test_zeros_of_a_part_are_probed():
    p = Product(parts=["linear", PiecewiseConstant(values=[1, 0] + [1] * 20_000)])
    zeros = p.zero_points()
    assert zeros.shape == (1, 2)
    assert (p.pdf(zeros) == 0).all()
    with pytest.raises(DensityError, match="would miss"):
        mcs.Estimator("constant", p)


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        ([], "1 to 1024"),
        ("linear", "1 to 1024"),
        (None, "1 to 1024"),
        ([None], "hold None"),
        ([1.5], "is not a density"),
        (["no-such"], "no density"),
        (["linear(dims=1024)", "linear"], "more than 1024 dims"),
        (["linear(slope=3)"], "slope is 3"),
        (["linear | linear"], "chains"),
    ],
)
def test_bad_parts(parts, says):
    with pytest.raises(ParameterError, match=says):
        Product(parts=parts)


def test_dims_are_those_of_the_parts():
    with pytest.raises(ParameterError, match="2 dims, but 3"):
        mcs.density("product(parts=['tent', 'tent'])", dims=3)
