"""The contract of densities: warp and inverse, shapes, range, mass, and samples of the pdf."""

import numpy as np
import pytest
from scipy.stats import chi2

import mcspectra as mcs
from mcspectra.core.errors import DensityError
from mcspectra.densities import Learned, PiecewiseConstant, reciprocal_integral
from mcspectra.densities.adaptive import integrate

EPS = np.finfo(float).eps
LAST = np.nextafter(1.0, 0.0)
FALSE_ALARM = 1e-6  # false-alarm probability of the whole module
SIDE = {1: 1024, 2: 128}  # the environment has 32 × 64 pixels, one of them the sun
BINS = 8
SAMPLES = 10_000
TESTS = 220  # three χ² tests for each of at most 73 densities
CLOSE = 1e-6


def dense(dims, rows=2000):
    """Return points with both ends, tiny numbers and values between, mixed over the dims."""
    line = np.concatenate([[0, 5e-324, 1e-300, 1e-17, LAST], np.linspace(0, LAST, rows)])
    return np.stack([np.roll(line, 7 * i) for i in range(dims)], axis=-1)


def test_samples_are_in_the_unit_cube_and_keep_their_shape(density):
    """Samples have the shape of the given points, which do not change."""
    u = dense(density.primary_dims)
    kept = u.copy()
    x = density.sample(u)
    np.testing.assert_array_equal(u, kept)
    kept_x = x.copy()
    density.pdf(x)
    assert x.dtype == np.float64
    assert x.shape == (*u.shape[:-1], density.dims)
    assert x.min() >= 0
    assert x.max() < 1
    stacked = u[:6].reshape(2, 3, -1)
    np.testing.assert_array_equal(density.sample(stacked), x[:6].reshape(2, 3, -1))
    assert density.pdf(x[:6].reshape(2, 3, -1)).shape == (2, 3)
    if density.has_inverse:
        assert density.invert(stacked).shape == stacked.shape
        density.invert(x)
    np.testing.assert_array_equal(x, kept_x)


def test_invert_undoes_sample(density):
    if not density.has_inverse:
        with pytest.raises(DensityError, match="inverse"):
            density.invert(np.full(density.dims, 0.5))
        return
    u = dense(density.dims)
    x = density.sample(u)
    back = density.invert(x)
    assert back.min() >= 0
    assert back.max() < 1
    # x has a rounding error of eps, and u one of |du/dx| <= p in 1-D. In products and tables p is
    # that of one axis, at most the product of p's maximum and the other axes' lengths. Logarithms
    # of truncated normals at z = 15 add |log Φ| = 118 times eps.
    steep = max(1.0, float(density.pdf(x).max()))
    close = (np.abs(back - u) <= 500 * EPS * steep).all(axis=-1)
    # At a pole of the warp many u map to one x, so compare x there
    again = (np.abs(density.sample(back) - x) <= 4 * EPS).all(axis=-1)
    assert (close | again).all()


def test_sample_pdf_agrees_with_sample_and_pdf(density):
    u = dense(density.primary_dims, 500)
    x, pdf = density.sample_pdf(u)
    np.testing.assert_array_equal(x, density.sample(u))
    np.testing.assert_allclose(pdf, density.pdf(x), rtol=1e-12, atol=0.0)


def test_samples_follow_a_pdf_of_mass_one(density):
    """χ² of samples in cells against integrals of the pdf; the Jacobian in three or more dims."""
    dims = density.dims
    x = density.sample(np.random.default_rng(3).random((20_000, density.primary_dims)))
    assert (density.pdf(x) > 0).all()
    if dims > 2:
        density.check()
        return
    found = integrate(density.pdf, dims, cells=16, most_cells=2**14)
    assert abs(found.totals[-1] - 1) <= 2e-4  # jumps between nodes (check_density)
    masses = found.cells.reshape((16,) * dims)
    counts, _ = np.histogramdd(x, bins=[16] * dims, range=[(0, 1)] * dims)
    assert counts[masses == 0].sum() == 0
    expected = len(x) * masses
    full = expected > 5
    assert agree(counts[full], expected[full], full.sum())


def agree(counts, expected, freedom):
    """Return whether a χ² test accepts the counts, at Šidák's level for all tests."""
    statistic = ((counts - expected) ** 2 / expected).sum()
    return statistic <= chi2.isf(1 - (1 - FALSE_ALARM) ** (1 / TESTS), freedom)


def test_breaks_are_shares_and_the_reciprocal_integral_agrees_with_quadrature(density):
    assert len(density.breaks) == density.primary_dims
    for axis in density.breaks:
        assert all(0 < b < 1 for b in axis)
        assert list(axis) == sorted(set(axis))
    by_quadrature = {mcs.Density.reciprocal_integral, Learned.reciprocal_integral}
    if density.dims > 1 and type(density).reciprocal_integral in by_quadrature:
        return
    exact = density.reciprocal_integral()
    if density.dims == 1:
        found = reciprocal_integral(density)
        assert np.isinf(exact) == np.isinf(found)
        if np.isfinite(exact):
            np.testing.assert_allclose(found, exact, rtol=1e-9 if not density.breaks[0] else 1e-3)
    else:
        assert exact >= 1  # Jensen's inequality


def test_the_spec_makes_an_equal_density(density):
    if density.name == "function" or "<array" in density.spec:
        return
    again = mcs.density(density.spec, dims=density.dims)
    u = dense(density.primary_dims, 100)
    np.testing.assert_array_equal(again.sample(u), density.sample(u))
    assert again.spec == density.spec


def squares(density, side):
    """Return masses (side²,) by 4 × 4 Gauss points per cell; jumps within cells cause errors."""
    node, weight = np.polynomial.legendre.leggauss(4)
    line = ((np.arange(side)[:, None] + 0.5 * (node + 1)) / side).ravel()
    values = density.pdf(np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1))
    weights = np.tile(weight, side)
    cells = (values * weights * weights[:, None]).reshape(side, 4, side, 4).sum(axis=(1, 3))
    return cells / cells.sum()


def increasing(density):
    """Return whether the warp is the inverse cdf: in 1-D, except alias tables and mixtures."""
    return density.dims == 1 and density.has_inverse and getattr(density, "warp", "") != "alias"


def test_pdf_and_warp_agree_with_a_table_of_cell_masses(density):
    """Compare with a second implementation, within the resolution of cells.

    ∫|p − mean of p in its cell| is at most the width of a cell times the variation of p. Warps that
    invert the cdf map to the same cells. For all warps, T of one and then T⁻¹ of the other is
    uniform.
    """
    side, dims = SIDE.get(density.dims), density.dims
    if side is None:
        return
    by_rule = dims == 2
    masses = squares(density, side) if by_rule else integrate(density.pdf, 1, cells=side).cells
    table = PiecewiseConstant(values=masses.reshape((side,) * dims).T)  # rows are along x_1
    fine = 16 if dims == 1 else 4
    line = (np.arange(side * fine) + 0.5) / (side * fine)
    x = np.stack(np.meshgrid(*[line] * dims, indexing="ij"), axis=-1)
    p = density.pdf(x)
    variation = sum(np.abs(np.diff(p, axis=axis)).mean() * line.size for axis in range(dims))
    assert np.abs(p - table.pdf(x)).mean() <= variation / side + 1e-6
    random = np.random.default_rng(9)
    u = random.random((SAMPLES, density.primary_dims))
    if not increasing(density):
        assert uniform(table.invert(density.sample(u)))
        if density.has_inverse:
            assert uniform(density.invert(table.sample(random.random((SAMPLES, dims)))))
        return
    borders = (np.arange(1, side) / side)[:, None]
    cdf = table.invert(borders)
    np.testing.assert_allclose(density.invert(borders), cdf, atol=CLOSE)
    nearest = np.searchsorted(cdf[:, 0], u[:, 0] + [[-CLOSE], [CLOSE]])
    inner = nearest[0] == nearest[1]
    assert np.abs(density.sample(u) - table.sample(u))[inner].max() <= 1 / side
    gap = np.abs(density.invert(table.sample(u)) - u)
    assert gap.max() <= table.pdf(table.sample(u)).max() / side + CLOSE


def uniform(v):
    """Return whether a χ² test of bins accepts points (k, d) as uniform."""
    dims = v.shape[-1]
    counts, _ = np.histogramdd(v, bins=[BINS] * dims, range=[(0, 1)] * dims)
    return agree(counts, len(v) / BINS**dims, BINS**dims - 1)
