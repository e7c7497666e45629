"""Bilinear tables: values between nodes, continuity, quadratures, seams, and refusals."""

import math

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from tests.densities.conftest import pixel_centers

import mcspectra as mcs
from mcspectra.densities import Bilinear, PiecewiseConstant

VALUES = np.array([[1.0, 0.2, 3.0], [0.5, 4.0, 0.0], [2.0, 1.0, 0.7], [0.1, 0.3, 2.0]])


def grid(n):
    return pixel_centers(n, n)


@pytest.mark.parametrize("nodes", ["corners", "centers"])
def test_values_between_nodes_agree_with_scipy(nodes):
    height, width = VALUES.shape
    p = Bilinear(values=VALUES, nodes=nodes)
    if nodes == "corners":
        ys, xs = np.linspace(0, 1, height), np.linspace(0, 1, width)
    else:
        ys, xs = ((np.arange(k) + 0.5) / k for k in (height, width))
    reference = RegularGridInterpolator((ys, xs), VALUES)
    x = grid(40)
    held = np.clip(x, [xs[0], ys[0]], [xs[-1], ys[-1]])  # centers: outermost values continue
    expected = reference(held[..., ::-1])
    ratio = p.pdf(x)[expected > 0] / expected[expected > 0]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)


@pytest.mark.parametrize("options", [{"nodes": "corners"}, {}, {"periodic": True}])
def test_the_marginal_and_the_conditional_cdf_agree_with_quadrature(options):
    """Midpoints are exact where p is linear, and off by a fraction of a squared step at a knot."""
    p = Bilinear(values=VALUES, **options)
    line = (np.arange(600) + 0.5) / 600
    for x, y in ([0.3, 0.6], [0.81, 0.07], [0.95, 0.97]):
        u = p.invert([x, y])
        below = np.stack(np.meshgrid(line, y * line), axis=-1)
        assert u[1] == pytest.approx(y * p.pdf(below).mean(), abs=1e-4)
        left, whole = (np.stack([a * line, np.full(600, y)], axis=-1) for a in (x, 1.0))
        assert u[0] == pytest.approx(x * p.pdf(left).mean() / p.pdf(whole).mean(), abs=1e-4)


def test_the_warp_is_continuous():
    """Steps of T halve with steps of u on lines in both directions; for tables they do not."""
    values = np.random.default_rng(1).uniform(0.5, 2, (6, 5))

    def largest(p, axis, n):
        line = np.full((n, 2), 0.4142)
        line[:, axis] = (np.arange(n) + 0.5) / n
        return np.abs(np.diff(p.sample(line), axis=0)).max()

    for axis in (0, 1):
        steps = [largest(Bilinear(values=values), axis, n) for n in (2**10, 2**14)]
        assert steps[1] < steps[0] / 8
    steps = [largest(PiecewiseConstant(values=values), 1, n) for n in (2**10, 2**14)]
    assert steps[1] > 0.9 * steps[0]


def test_periodic_tables_close_over_the_seam():
    p = Bilinear(values=VALUES, periodic=True)
    y = np.linspace(0, 1, 50)
    left, right = (p.pdf(np.stack([np.full(50, x), y], axis=-1)) for x in (0.0, 1.0))
    np.testing.assert_array_equal(left, right)
    shifted = Bilinear(values=np.roll(VALUES, 1, axis=1), periodic=True)
    x = grid(30)
    moved = np.stack([(x[..., 0] + 1 / 3) % 1, x[..., 1]], axis=-1)
    np.testing.assert_allclose(shifted.pdf(moved), p.pdf(x), rtol=1e-12)
    clamped = Bilinear(values=VALUES)
    assert clamped.pdf([0.0, 0.5]) != pytest.approx(clamped.pdf([1.0, 0.5]))


def test_products_of_lines_by_hand():
    """Corners of (1 + x)(3 − 2y): T_1 and T_0 are those of `linear` densities."""
    p = Bilinear(values=np.outer([3, 1], [1, 2]), nodes="corners")
    expected = mcs.density("linear(slope=[0.6666666666666666, -1])", dims=2)
    u = np.random.default_rng(2).random((500, 2))
    np.testing.assert_allclose(p.pdf(u), expected.pdf(u), rtol=1e-13)
    np.testing.assert_allclose(p.sample(u), expected.sample(u), rtol=0, atol=1e-14)
    assert p.breaks == ((), ())


def test_no_cancellation_in_nearly_even_cells():
    """u is recovered to rounding if nodes differ by factors of 1e-15 to 1e15."""
    u = np.random.default_rng(3).random((2000, 2))
    for ratio in (1 + 1e-15, 1 + 1e-8, 1e-8, 1e-15):
        p = Bilinear(values=[[1, ratio], [1, ratio]], nodes="corners")
        np.testing.assert_allclose(p.invert(p.sample(u)), u, rtol=0, atol=1e-15)


def test_empty_areas_are_never_sampled():
    values = np.zeros((6, 6))
    values[1, 1] = values[4, 3] = 1
    values[4, 4] = 1e-3
    p = Bilinear(values=values, nodes="corners")
    u = np.concatenate([np.random.default_rng(4).random((20_000, 2)), grid(50).reshape(-1, 2)])
    x = p.sample(u)
    assert (p.pdf(x) > 0).all()
    assert np.abs(p.invert(x) - u).max() < 1e-12
    empty = p.zero_points()
    assert len(empty) == 25 - 4 - 6  # 10 of 25 rectangles touch a node
    assert (p.pdf(empty) == 0).all()


@pytest.mark.parametrize("values", [[[7]], [[0, 0, 7, 0]], [[0], [7], [0]], np.eye(9)[[3]]])
def test_small_and_narrow_tables(values):
    p = Bilinear(values=values)
    u = grid(40).reshape(-1, 2)
    x = p.sample(u)
    assert np.abs(p.invert(x) - u).max() < 1e-12
    # Midpoints of 360 = 8 · 45 cells: every knot of these tables is a border, so the rule is exact
    # to x²
    assert p.pdf(grid(360)).mean() == pytest.approx(1, rel=1e-12)
    one = Bilinear(values=[[7]])
    np.testing.assert_allclose(one.sample(u), u, rtol=0, atol=1e-15)


def test_scale_does_not_matter():
    u = np.random.default_rng(5).random((100, 2))
    tiny, large = (Bilinear(values=VALUES * 2.0**e) for e in (-1000, 1020))
    np.testing.assert_array_equal(tiny.sample(u), large.sample(u))
    np.testing.assert_array_equal(tiny.pdf(u), large.pdf(u))


def test_bilinear_densities_restore_the_smooth_rate():
    """Jittered, f/p smooth: Var = ∫|∇g|²/(12 n²); tables jump on lines, which gives n^-1.5."""
    values = np.random.default_rng(6).uniform(0.5, 2, (5, 5))
    n, realizations = 64**2, 400

    def estimator(p):
        f = mcs.Integrand.from_function(lambda x: p.pdf(x) * (1 + x[..., 0] + x[..., 1]), dims=2)
        return mcs.Estimator(f, p)

    smooth, table = Bilinear(values=values), PiecewiseConstant(values=values)
    found = mcs.convergence(
        [estimator(smooth), estimator(table)], "jittered", [n], realizations=realizations, rng=1
    )["variance"].values.ravel()
    u, h = grid(500), 1e-6
    slopes = [
        (smooth.sample(u + step) - smooth.sample(u - step)).sum(axis=-1) / (2 * h)
        for step in (np.array([h, 0]), np.array([0, h]))
    ]
    limit = sum((slope**2).mean() for slope in slopes) / (12 * n**2)
    # Sums of many strata are normal: a variance has the relative standard error √(2/(R−1))
    assert found[0] == pytest.approx(limit, rel=4 * math.sqrt(2 / (realizations - 1)))
    assert found[1] > 2 * limit
