"""What every density promises: warp and inverse, shapes, range, mass, and samples that follow it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from mcspectra.core.errors import DensityError
from mcspectra.densities.adaptive import integrate

EPS = np.finfo(float).eps
LAST = np.nextafter(1.0, 0.0)
FALSE_ALARM = 1e-6  # of the whole module


def dense(dims, rows=2000):
    """Points with both ends, tiny numbers and everything between, mixed over the dims."""
    line = np.concatenate([[0, 5e-324, 1e-300, 1e-17, LAST], np.linspace(0, LAST, rows)])
    return np.stack([np.roll(line, 7 * i) for i in range(dims)], axis=-1)


def test_samples_are_in_the_unit_cube_and_keep_their_shape(density):
    u = dense(density.primary_dims)
    x = density.sample(u)
    assert x.dtype == np.float64
    assert x.shape == (*u.shape[:-1], density.dims)
    assert x.min() >= 0
    assert x.max() < 1
    stacked = u[:6].reshape(2, 3, -1)
    np.testing.assert_array_equal(density.sample(stacked), x[:6].reshape(2, 3, -1))
    assert density.pdf(x[:6].reshape(2, 3, -1)).shape == (2, 3)
    if density.has_inverse:
        assert density.invert(stacked).shape == stacked.shape


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
    # x carries a rounding error of eps, u that of |du/dx| <= p in 1-D; in products and tables p is
    # that of one axis, at most the product of p's maximum and the other axes' lengths. Logarithms
    # of truncated normals at z = 15 add |log Φ| = 118 times eps.
    steep = max(1.0, float(density.pdf(x).max()))
    close = (np.abs(back - u) <= 500 * EPS * steep).all(axis=-1)
    # At a pole of the warp many u are one x: there x has to come back
    again = (np.abs(density.sample(back) - x) <= 4 * EPS).all(axis=-1)
    assert (close | again).all()


def test_small_shares_keep_their_digits_in_lines():
    import mcspectra as mcs

    u = np.logspace(-300, -17, 50)[:, None]
    for slope in (-2, -1, 0, 1e-9, 1, 2):
        p = mcs.density(f"linear(slope={slope})", dims=1)
        np.testing.assert_allclose(p.invert(p.sample(u)), u, rtol=8 * EPS)


def test_samples_never_land_where_the_density_is_zero(density):
    u = np.random.default_rng(1).random((20_000, density.primary_dims))
    assert (density.pdf(density.sample(u)) > 0).all()


def test_the_input_is_left_alone(density):
    u, x = dense(density.primary_dims, 50), dense(density.dims, 50)
    kept, kept_x = u.copy(), x.copy()
    density.sample(u)
    density.pdf(x)
    if density.has_inverse:
        density.invert(x)
    np.testing.assert_array_equal(u, kept)
    np.testing.assert_array_equal(x, kept_x)


def test_the_mass_is_one(density):
    if density.dims <= 2:
        found = integrate(density.pdf, density.dims, cells=64 // density.dims)
        assert (
            abs(found.totals[-1] - 1) <= 1e-4
        )  # what jumps between nodes may hide (check_density)
        return
    if not density.one_to_one:
        density.check()
        return
    # Products: the warp takes a box to a box, of volume ∫1 dx = ∫1/p(T(u)) du
    inner = 0.25 + 0.5 * np.random.default_rng(2).random((100_000, density.dims))
    values = 0.5**density.dims / density.pdf(density.sample(inner))
    low, high = density.sample(np.repeat([[0.25], [0.75]], density.dims, axis=1))
    error = values.std() / np.sqrt(len(inner))
    assert abs(values.mean() - np.prod(high - low)) <= 6 * error + 1e-12


def test_samples_follow_the_pdf(density):
    """χ² of samples in cells against the integral of the pdf; the Jacobian in 3-D and more."""
    if density.dims > 2:
        density.check()
        return
    n, cells = 20_000, 16
    x = density.sample(np.random.default_rng(3).random((n, density.primary_dims)))
    expected = n * integrate(density.pdf, density.dims, cells=cells).cells
    index = np.minimum((x * cells).astype(int), cells - 1) @ cells ** np.arange(density.dims)[::-1]
    counts = np.bincount(index, minlength=cells**density.dims)
    assert counts[expected == 0].sum() == 0
    full = expected > 5
    statistic = ((counts - expected)[full] ** 2 / expected[full]).sum()
    each = 1 - (1 - FALSE_ALARM) ** (1 / 60)  # Šidák, for the number of densities
    assert statistic <= chi2.isf(each, full.sum())


def test_the_exact_reciprocal_integral_is_that_of_the_quadrature(density):
    from mcspectra.densities import reciprocal_integral

    exact = density.reciprocal_integral()
    if density.dims == 1:
        found = reciprocal_integral(density)
        assert np.isinf(exact) == np.isinf(found)
        if np.isfinite(exact):
            np.testing.assert_allclose(found, exact, rtol=1e-9 if not density.breaks[0] else 1e-3)
    else:
        assert exact >= 1  # Jensen


def test_breaks_are_shares(density):
    assert len(density.breaks) == density.primary_dims
    for axis in density.breaks:
        assert all(0 < b < 1 for b in axis)
        assert list(axis) == sorted(set(axis))


def test_spec_makes_it_again(density):
    import mcspectra as mcs

    if density.name == "function" or "<array" in density.spec:
        return
    again = mcs.density(density.spec, dims=density.dims)
    u = dense(density.primary_dims, 100)
    np.testing.assert_array_equal(again.sample(u), density.sample(u))
    assert again.spec == density.spec
