"""A common suite for every class: shapes, integrals, coefficients and box moments by quadrature."""

from functools import reduce

import numpy as np
import pytest

import mcspectra as mcs

# Quadrature from values only resolves a border in 1-D to rounding, in 2-D to 1e-3, in 3-D to 1e-2
POWER = {1: 1e-9, 2: 1e-3, 3: 4e-2}


def columns(f, x):
    values = f(x)
    return values if f.channels else values[..., None]


def test_shapes(f):
    values = f(np.full((4, 7, f.dims), 0.5))
    channels = (f.channels,) if f.channels else ()
    assert values.shape == (4, 7, *channels)
    assert values.dtype == np.float64
    assert np.shape(f.integral) == channels
    m = np.zeros((2, 3, f.dims))
    assert f.fourier(m).shape == (2, 3, *channels)
    assert f.fourier(m).dtype == np.complex128
    assert f.fourier_grid(2).shape == (5,) * f.dims + channels
    assert len(f.breaks) == f.dims
    assert all(0 < b < 1 for axis in f.breaks for b in axis)


def test_the_spec_makes_it_again(f):
    again = mcs.integrand(f.spec, dims=f.dims)
    assert again.spec == f.spec
    x = np.random.default_rng(1).random((50, f.dims))
    assert np.array_equal(again(x), f(x))


def test_the_integral(f, oracle):
    value, error = oracle(lambda x: columns(f, x), f.breaks)
    assert error < POWER[f.dims]
    assert np.abs(value - f.integral).max() <= error


def is_curved(f):
    """Return whether f jumps along a line without a break, where Gauss rules fail."""
    return f.dims > 1 and any(name in f.spec for name in ("disk", "half-space"))


def by_gauss(function, all_breaks, nodes):
    """Integrate a piecewise smooth function, values (P, C), by Gauss rules in each box: (C,)."""
    nodes, weights = np.polynomial.legendre.leggauss(nodes)
    axes, shares = [], []
    for breaks in all_breaks:
        ends = np.array([0.0, *breaks, 1.0])
        low, width = ends[:-1, None], np.diff(ends)[:, None]
        axes.append((low + width * (nodes + 1) / 2).ravel())
        shares.append((width * weights / 2).ravel())
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    return reduce(np.multiply.outer, shares).ravel() @ function(x)


def smooth_oracle(function, breaks):
    """Return the integral and its error, from rules with 56 and 48 nodes per part of an axis."""
    value, other = (by_gauss(function, breaks, nodes) for nodes in (56, 48))
    return value, np.abs(value - other).max() + 1e-13 * (1 + np.abs(value).max())


def test_coefficients(f, oracle):
    """Test small, large, negative and degenerate m (along an axis or a diagonal), and waves'
    own."""
    curved = is_curved(f)
    rng = np.random.default_rng(2)
    special = np.array([[1, 1, 1], [2, 4, 2], [0, 3, 0], [-5, 0, 0]])[:, : f.dims]
    waves_own = np.array([[3, 0, 0], [1, -2, 0]])[:, : f.dims]
    m = np.concatenate([special, rng.integers(-12, 13, (3, f.dims)), waves_own])
    m = m[[3, 4]] if curved else m  # Frequencies at which the quadrature takes seconds

    def waves(x):
        angle = 2 * np.pi * x @ m.T
        both = np.concatenate([np.cos(angle), -np.sin(angle)], axis=-1)
        product = columns(f, x)[..., None] * both[..., None, :]
        return product.reshape(*x.shape[:-1], -1)

    value, error = (oracle if curved else smooth_oracle)(waves, f.breaks)
    assert error < (POWER[f.dims] if curved else 1e-12 * (1 + np.abs(value).max()))
    real, imaginary = value.reshape(-1, 2, len(m)).transpose(1, 2, 0)
    expected = real + 1j * imaginary
    found = f.fourier(m).reshape(len(m), -1)
    slack = 0.0 if f.fourier_source == "exact" or "rounding" in f.fourier_source else POWER[3]
    assert np.abs(found - expected).max() <= np.sqrt(2) * error + slack


def test_the_grid(f):
    """The grid is Hermitian, has the integral in the middle, and agrees with `fourier`."""
    grid = f.fourier_grid(3)
    mirrored = np.flip(grid, axis=tuple(range(f.dims))).conj()
    assert np.abs(grid - mirrored).max() < 1e-14 * max(1.0, np.abs(grid).max())
    assert np.allclose(grid[(3,) * f.dims], f.integral, rtol=0, atol=1e-12)
    m = np.stack(np.meshgrid(*[np.arange(-3, 4)] * f.dims, indexing="ij"), axis=-1)
    other_grid = f.fourier_source.startswith("FFT")  # Another grid has another error
    assert np.abs(f.fourier(m) - grid).max() < (POWER[3] if other_grid else 1e-14)


def edges(rng, count):
    return np.concatenate([[0.0], np.sort(rng.random(count)), [1.0]])


def boxes(f, rng):
    cuts = [edges(rng, 7 + i) for i in range(f.dims)]
    low = np.stack(np.meshgrid(*(c[:-1] for c in cuts), indexing="ij"), axis=-1)
    high = np.stack(np.meshgrid(*(c[1:] for c in cuts), indexing="ij"), axis=-1)
    return low, high


def test_box_moments(f, oracle):
    """Boxes with irregular borders sum to the whole; four boxes agree with quadrature."""
    low, high = boxes(f, np.random.default_rng(3))
    found = f.box_moments(low, high)
    if found is None:
        assert f.dims == 3
        return
    volume = (high - low).prod(axis=-1)
    whole = f.box_moments(np.zeros(f.dims), np.ones(f.dims))
    for part, total in zip(found, whole, strict=True):
        share = volume[..., None] if f.channels else volume
        summed = (part * share).sum(axis=tuple(range(f.dims)))
        assert np.allclose(summed, total, rtol=0, atol=1e-13)
    assert np.allclose(whole[0], f.integral, rtol=0, atol=1e-13)

    for index in map(tuple, np.random.default_rng(5).integers(0, low.shape[0], (4, f.dims))):
        a, b = low[index], high[index]

        def moments(u, a=a, b=b):
            values = columns(f, a + (b - a) * u)
            return np.concatenate([values, values**2], axis=-1)

        places = zip(f.breaks, a, b, strict=True)
        if is_curved(f):
            breaks = tuple(tuple((np.array(p) - s) / (t - s)) for p, s, t in places)
            value, error = oracle(moments, breaks)
        else:
            breaks = [[(p - s) / (t - s) for p in each if s < p < t] for each, s, t in places]
            value, error = smooth_oracle(moments, breaks)
        assert error < (POWER[f.dims] if is_curved(f) else 1e-12 * (1 + np.abs(value).max()))
        expected = np.concatenate([np.ravel(part[index]) for part in found])
        # Differences of primitives have an error of an ulp of the whole in a box of small volume
        rounding = 8 * np.finfo(float).eps * np.abs(whole).max() / (b - a).prod()
        assert np.abs(value - expected).max() <= error + rounding


def test_variance_of_small_boxes_is_not_lost_to_rounding():
    """Var = Σ (g_i h_i)²/12 to first order; differences of primitives fail in boxes of side
    2^-10."""
    side = 2.0**-10
    low = np.random.default_rng(6).random((100, 2)) * (1 - side)
    for spec in ("gaussian", "christensen-gaussian", "christensen-bilinear", "cosine"):
        f = mcs.integrand(spec)
        mean, square = f.box_moments(low, low + side)
        h = 1e-6
        steps = [np.array([h, 0.0]), np.array([0.0, h])]
        centre = low + side / 2
        squared = sum(((f(centre + s) - f(centre - s)) / (2 * h)) ** 2 for s in steps)
        # Next order: side² times second derivatives squared, at most (2π)⁴; rounding 4 ulps of f².
        bound = side**4 * (2 * np.pi) ** 4 + 4 * np.finfo(float).eps + 1e-8 * side**2
        assert np.abs(square - mean**2 - squared * side**2 / 12).max() < bound


def test_reference_functions():
    x = np.random.default_rng(8).random((100, 2))
    radius = (x**2).sum(axis=-1)
    known = {
        "disk": (0.5, radius < 2 / np.pi),
        "triangle": (0.5, x[:, 1] > x[:, 0]),
        "step": (1 / np.pi, x[:, 0] < 1 / np.pi),
        "gaussian": (0.5577462853510337, np.exp(-radius)),
        "bilinear": (0.25, x.prod(axis=-1)),
    }
    for name, (integral, values) in known.items():
        f = mcs.integrand(f"christensen-{name}")
        assert f.integral == pytest.approx(integral, abs=4e-16)
        assert f.integral_source == "exact"
        np.testing.assert_allclose(f(x), values, rtol=1e-14)
