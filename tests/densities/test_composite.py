"""Mixtures and products: the choosing coordinate, extra coordinates, defensive shares, specs."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.densities import (
    Defensive,
    Linear,
    Mixture,
    PiecewiseConstant,
    Product,
    Tent,
    check_density,
)
from mcspectra.densities.registry import as_warp

PARTS = [Tent(dims=1, peak=0.3), Linear(dims=1, slope=1)]
X = np.random.default_rng(1).random((300, 3))


def test_the_pdf_is_the_weighted_sum_for_either_selection():
    x = np.linspace(0, 1, 101)[:, None]
    expected = 0.25 * PARTS[0].pdf(x) + 0.75 * PARTS[1].pdf(x)
    for selection in ("coordinate", "extra"):
        p = Mixture(parts=PARTS, weights=[2, 6], selection=selection)
        np.testing.assert_allclose(p.pdf(x), expected, rtol=1e-15)


def test_parts_of_the_choosing_coordinate_use_the_warps_of_the_parts():
    p = Mixture(parts=PARTS, weights=[1, 3])
    v = np.random.default_rng(1).random((200, 1))
    np.testing.assert_allclose(p.sample(0.25 * v), PARTS[0].sample(v), atol=1e-14)
    np.testing.assert_allclose(p.sample(0.25 + 0.75 * v), PARTS[1].sample(v), atol=1e-14)
    assert p.breaks == ((0.3 * 0.25, 0.25),)


def test_an_extra_coordinate_does_not_change_the_others():
    p = Mixture(parts=PARTS, weights=[1, 3], selection="extra")
    u = np.random.default_rng(2).random((500, 2))
    first = u[:, 1] < 0.25
    x = p.sample(u)
    assert x.shape == (500, 1)
    np.testing.assert_array_equal(x[first], PARTS[0].sample(u[first, :1]))
    np.testing.assert_array_equal(x[~first], PARTS[1].sample(u[~first, :1]))
    assert p.breaks == ((0.3,), (0.25,))


@pytest.mark.parametrize("axis", [0, 1])
def test_the_choosing_axis_is_stretched(axis):
    parts = [Linear(dims=2, slope=2), Linear(dims=2, slope=-2)]
    p = Mixture(parts=parts, weights=[1, 1], axis=axis)
    v = np.random.default_rng(3).random((100, 2))
    for t, part in enumerate(parts):
        u = v.copy()
        u[:, axis] = 0.5 * (t + v[:, axis])
        np.testing.assert_allclose(p.sample(u), part.sample(v), atol=1e-14)


@pytest.mark.parametrize("dims", [1, 2])
def test_a_mixture_of_tables_is_the_table_of_the_sum(dims):
    rng = np.random.default_rng(dims)
    tables = [rng.random((4,) * dims) for _ in range(3)]
    parts = [PiecewiseConstant(values=t) for t in tables]
    p = Mixture(parts=parts, weights=[1, 2, 3])
    whole = PiecewiseConstant(
        values=sum(w * t / t.mean() for w, t in zip((1, 2, 3), tables, strict=True))
    )
    x = rng.random((1000, dims))
    np.testing.assert_allclose(p.pdf(x), whole.pdf(x), rtol=1e-13)
    assert p.reciprocal_integral() == pytest.approx(whole.reciprocal_integral(), rel=1e-6)
    # Shares of a fine jittered set in the cells are the masses, except for strata cut by borders
    side = 4096 if dims == 1 else 128
    grid = (np.stack(np.meshgrid(*[np.arange(side)] * dims, indexing="ij"), -1) + 0.5) / side
    cells = np.minimum((p.sample(grid.reshape(-1, dims)) * 4).astype(int), 3)
    shares = np.bincount(cells @ 4 ** np.arange(dims), minlength=4**dims) / side**dims
    expected = whole._pdf_table.ravel() / 4**dims  # rows run along axis 1
    np.testing.assert_allclose(shares, expected, atol=3 * 4**dims * 2 / side)


def test_defensive_is_the_mixture_with_the_uniform():
    p = Defensive(density="power(exponent=4)", dims=2, share=0.25)
    x = np.random.default_rng(4).random((100, 2))
    np.testing.assert_allclose(p.pdf(x), 0.75 * 25 * np.prod(x, axis=1) ** 4 + 0.25, rtol=1e-13)
    assert p.reciprocal_integral() <= 4
    assert not len(p.zero_points())
    assert mcs.density(p.spec, dims=2).spec == p.spec


def test_zeros_are_those_of_all_parts():
    left, right = PiecewiseConstant(values=[1, 0, 0]), PiecewiseConstant(values=[0, 0, 1])
    p = Mixture(parts=[left, right])
    np.testing.assert_allclose(np.unique(p.zero_points()), [0.5])
    with pytest.raises(DensityError, match="would miss"):
        mcs.Estimator("constant", p)


def test_preimages_map_back_to_the_points():
    p = Mixture(parts=PARTS, weights=[1, 3])
    x = np.random.default_rng(5).random((50, 1))
    u = p.preimages(x)
    assert u.shape == (100, 1)
    np.testing.assert_allclose(p.sample(u), np.concatenate([x, x]), atol=1e-12)


def test_exact_variances_account_for_the_jumps():
    """Random points: Var = (∫ f²/p − I²)/n for any selection; quadrature over x, not u."""
    f = mcs.integrand("step(at=0.4)", dims=1)
    x = (np.arange(2_000_000) + 0.5) / 2_000_000
    for selection in ("coordinate", "extra"):
        p = Mixture(parts=[Tent(dims=1, peak=0.75), Linear(dims=1)], selection=selection)
        e = mcs.Estimator(f, p)
        expected = ((f(x[:, None]) ** 2) / p.pdf(x[:, None])).mean() - float(f.integral) ** 2
        if selection == "coordinate":
            found = mcs.exact_variance(e, "random", 1)
            assert found == pytest.approx(expected, rel=1e-6)
        d = mcs.convergence(e, "random", [1], realizations=20_000, rng=1)
        # Standard error of the estimate from the fourth moment, by the width of the interval
        low, high = d["variance_ci"].values[0]
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        assert abs(middle - expected) <= 2.5 * half  # five standard errors
    assert p.primary_dims == 2


def test_extra_coordinates_in_all_analyses():
    p = Mixture(parts=["uniform", "linear"], dims=1, selection="extra")
    f = mcs.integrand("gaussian", dims=1)
    e = mcs.Estimator(f, p)
    assert (e.dims, e.domain_dims, e.primary_integrand().dims) == (2, 1, 2)
    domain = mcs.variance_terms(e, "random", 16, half_width=32, realizations=400, rng=1)
    primary = mcs.variance_terms(
        e, "random", 16, half_width=8, realizations=400, rng=1, space="primary"
    )
    assert domain["contribution"].dims == ("m0",)
    assert primary["contribution"].dims == ("m0", "m1")
    assert float(domain["measured_variance"]) == float(primary["measured_variance"])
    sampler = mcs.sampler("random", dims=2)
    found = mcs.power_spectrum(sampler, 16, density=p, half_width=4, realizations=2000, rng=2)
    exact = mcs.closed_form_power(sampler, 16, found["m0"].values[:, None], density=p)
    gap = np.abs(found["power"].values - exact)
    assert (gap <= 5 * found["power_se"].values + 1e-12).all()
    by_spec = mcs.power_spectrum(
        sampler, 16, density=p.spec, half_width=4, realizations=2000, rng=2
    )
    np.testing.assert_array_equal(found["power"], by_spec["power"])
    with pytest.raises(ParameterError, match="needs a sampler in 2 dims"):
        e.check_sampler(mcs.sampler("random", dims=1), 4)


def test_warps_for_a_samplers_points():
    extra = "mixture(parts=['uniform', 'linear'], selection='extra')"
    assert as_warp(extra, 3).dims == 2
    assert as_warp("linear", 3).dims == 3
    assert as_warp(None, 3) is None
    with pytest.raises(ParameterError, match="takes points of 2 dims"):
        as_warp(Linear(dims=2), 3)
    with pytest.raises(ParameterError, match="dims"):
        as_warp(extra, 1)


def test_one_technique_of_several_has_no_extra_coordinate():
    p = Mixture(parts=["uniform", "linear"], dims=1, selection="extra")
    with pytest.raises(ParameterError, match="extra coordinate"):
        mcs.MultipleImportance(mcs.integrand("gaussian", dims=1), [p, "uniform"])


@pytest.mark.parametrize("dims", [1, 2, 4])
@pytest.mark.parametrize("selection", ["coordinate", "extra"])
def test_the_check_finds_wrong_shares(dims, selection):
    """Combine the samples of one mixture with the pdf of another."""
    parts = [mcs.density(s, dims=dims) for s in ("linear", "power")]
    right = Mixture(parts=parts, weights=[1, 3], selection=selection)
    check_density(right)
    wrong = Mixture(parts=parts, weights=[3, 1], selection=selection)

    class Both(mcs.Density):
        name = "both"
        dims = right.dims
        primary_dims = right.primary_dims
        has_inverse = one_to_one = False
        spec = "both"

        def _pdf(self, x):
            return wrong._pdf(x)

        def _sample(self, u):
            return right._sample(u)

    with pytest.raises(DensityError, match="do not follow its pdf"):
        check_density(Both())


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


def test_a_product_of_linear_densities_is_linear_in_more_dims():
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


def test_mixtures_in_products_add_their_extra_coordinate():
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
    several = Product(parts=["linear", PiecewiseConstant(values=[1] + [0] * 8)]).zero_points()
    assert len(np.unique(several[:, 0])) == 4  # positions of the other coordinate
    assert (p.pdf(zeros) == 0).all()
    with pytest.raises(DensityError, match="would miss"):
        mcs.Estimator("constant", p)
