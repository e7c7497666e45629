"""Jitter of other widths, antithetic pairs and the triangular lattice: exact geometry, moments."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.spatial import cKDTree

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.samplers import AntitheticJittered, BoxJitter, GaussianJitter, Hexagonal, sampler
from mcspectra.samplers._grid import corners

LEVEL = 1 - (1 - 1e-6) ** (1 / 8)  # Šidák: the statistical tests of this file share 1e-6


def moves_in_cells(points, s):
    """Toroidal displacement of every point from the centre of its cell, in sides of a cell."""
    centers = corners((s,) * points.shape[-1]) + 0.5 / s
    return ((points - centers + 0.5) % 1.0 - 0.5) * s


@pytest.mark.parametrize("cls", [BoxJitter, GaussianJitter])
@pytest.mark.parametrize(("dims", "s"), [(1, 7), (2, 4), (3, 3)])
def test_no_width_is_the_regular_grid(cls, dims, s):
    points = cls(dims=dims, width=0.0).draw(s**dims, realizations=2, rng=1)
    np.testing.assert_allclose(moves_in_cells(points, s), 0.0, atol=1e-14)


@pytest.mark.parametrize("width", [0.1, 0.5, 1.0, 1.7, 2.0])
def test_box_jitter_is_uniform_in_its_box(width):
    """Whatever the width, up to where the box is as wide as the torus."""
    s = 4
    moves = moves_in_cells(BoxJitter(width=width).draw(s * s, realizations=2000, rng=3), s)
    assert np.abs(moves).max() <= width / 2 + 1e-12
    share = moves.ravel() / width + 0.5
    assert stats.kstest(share, "uniform").pvalue > LEVEL
    first, second = (np.floor(8 * np.clip(share[i::2], 0, 1 - 1e-9)) for i in (0, 1))
    assert stats.chisquare(np.bincount((8 * first + second).astype(int))).pvalue > LEVEL


def test_box_jitter_as_wide_as_a_cell_stays_in_the_cell():
    points = BoxJitter(width=1.0).draw(25, realizations=200, rng=3)
    cells = np.floor(points * 5) @ [5, 1]
    np.testing.assert_array_equal(cells, np.tile(np.arange(25), (200, 1)))


@pytest.mark.parametrize(
    ("width", "unbiased"), [(0.5, False), (0.0, False), (1, True), (1.5, False), (3.0, True)]
)
def test_box_jitter_is_unbiased_where_the_boxes_tile_the_torus(width, unbiased):
    """The mean of cos(2π s x), which the centres of the cells make −1, tells."""
    source = BoxJitter(dims=1, width=width)
    assert source.unbiased == unbiased
    waves = np.cos(2 * np.pi * 8 * source.draw(8, realizations=4000, rng=4)).mean()
    expected = -np.sinc(width)
    assert abs(waves - expected) < stats.norm.isf(LEVEL / 2) / np.sqrt(2 * 8 * 4000)
    assert (abs(expected) < 1e-12) == unbiased


@pytest.mark.parametrize("width", [0.1, 0.25, 0.6])
def test_gaussian_jitter_is_gaussian(width):
    """On a torus of 16 cells, where 0.6 cells wrap at 13 standard deviations."""
    moves = moves_in_cells(
        GaussianJitter(dims=1, width=width).draw(16, realizations=3000, rng=5), 16
    )
    assert stats.kstest(moves.ravel() / width, "norm").pvalue > LEVEL


def test_gaussian_jitter_of_any_width_is_in_range():
    points = GaussianJitter(width=1000.0).draw(4, realizations=5000, rng=5)
    assert points.min() >= 0.0
    assert points.max() < 1.0


@pytest.mark.parametrize("name", ["box-jitter", "gaussian-jitter"])
@pytest.mark.parametrize("width", ["-0.1", "1001", "1e999", "'1'", "True", "None", "[1, 2]"])
def test_impossible_widths(name, width):
    with pytest.raises(ParameterError, match=r"^width is .*; give a finite number"):
        sampler(f"{name}(width={width})")
    with pytest.raises(ParameterError, match="width is nan"):
        BoxJitter(width=float("nan"))


@pytest.mark.parametrize(("dims", "s"), [(1, 7), (2, 5), (3, 4), (6, 2), (4, 1)])
def test_antithetic_pairs(dims, s):
    """Both points in the cell, and their midpoint its centre."""
    n = 2 * s**dims
    pairs = AntitheticJittered(dims=dims).draw(n, realizations=50, rng=6).reshape(50, -1, 2, dims)
    np.testing.assert_array_equal(
        np.floor(pairs * s) / s, np.broadcast_to(corners((s,) * dims)[:, None], pairs.shape)
    )
    centers = corners((s,) * dims) + 0.5 / s
    np.testing.assert_allclose(
        pairs.mean(axis=2), np.broadcast_to(centers, (50, n // 2, dims)), rtol=0, atol=1e-15
    )


def test_antithetic_points_are_uniform_in_their_cells():
    inside = AntitheticJittered().draw(32, realizations=3000, rng=7) * 4 % 1.0
    for half in (inside[:, ::2], inside[:, 1::2]):
        pairs = (8 * np.floor(8 * half[..., 0]) + np.floor(8 * half[..., 1])).astype(int)
        assert stats.chisquare(np.bincount(pairs.ravel(), minlength=64)).pvalue > LEVEL


def test_antithetic_pairs_integrate_linear_integrands_exactly():
    means = AntitheticJittered(dims=3).draw(54, realizations=20, rng=8).mean(axis=1)
    np.testing.assert_allclose(means, 0.5, rtol=0, atol=1e-15)


def test_antithetic_counts_are_twice_those_of_grids():
    possible = [2 * s * s for s in range(1, 20)]
    source = AntitheticJittered()
    for n in range(1, 600):
        below, above = source._counts_near(n)
        assert below == max((m for m in possible if m <= n), default=None)
        assert above == min(m for m in possible if m >= n)
    with pytest.raises(CountError, match="18 and 32"):
        source.draw(25)


@pytest.mark.parametrize(
    ("spec", "integrand", "rate", "slack"),
    [
        # −(1 + 4/d) and −1.5. `slack` bounds the pre-asymptotic bend, as in test_convergence.
        ("antithetic-jittered", "christensen-gaussian", -3.0, 0.03),
        ("antithetic-jittered", "disk(center=[0.463, 0.517], radius=0.27)", -1.5, 0.05),
        ("gaussian-jitter | shift", "disk(center=[0.463, 0.517], radius=0.27)", -1.5, 0.05),
        ("box-jitter | shift", "disk(center=[0.463, 0.517], radius=0.27)", -1.5, 0.05),
    ],
)
def test_rates(spec, integrand, rate, slack):
    counts = [32, 128, 512, 2048] if "antithetic" in spec else [16, 64, 256, 1024]
    estimator = mcs.Estimator(integrand, dims=2)
    found = mcs.convergence(estimator, spec, counts, realizations=1000, rng=2)
    low, high = found["rate_ci"].values
    assert abs(float(found["rate"]) - rate) < 4 * (high - low) / 2 / 1.96 + slack


def neighbour_distances(points):
    """Toroidal distances to the six nearest neighbours: (n, 6), sorted."""
    return cKDTree(points, boxsize=1.0).query(points, k=7)[0][:, 1:]


@pytest.mark.parametrize("n", [12, 30, 56, 168, 1400, 3828])
def test_every_point_of_the_hexagonal_lattice_has_the_same_six_neighbours(n):
    """Two along its row and four in the rows next to it, at about the distances of the ideal."""
    distances = neighbour_distances(Hexagonal().draw(n)[0])
    np.testing.assert_allclose(distances, np.broadcast_to(distances[0], distances.shape), rtol=1e-9)
    ideal = np.sqrt(2 / (np.sqrt(3) * n))
    ratio = distances[0, -1] / distances[0, 0]
    assert ratio < (1.12 if n < 56 else 1.061 if n < 780 else 1.02)
    assert distances[0, 0] <= ideal * (1 + 1e-12) <= distances[0, -1] * (1 + 1e-9)


def test_hexagonal_counts_are_the_nearest_regular_arrays():
    """By trying all numbers of rows: the nearest to the ratio of the ideal lattice."""
    wanted = [2 * a * min(range(1, a + 2), key=lambda b: abs(b - a / 3**0.5)) for a in range(1, 30)]
    source = Hexagonal()
    for n in range(1, wanted[-1]):
        below, above = source._counts_near(n)
        assert below == max((m for m in wanted if m <= n), default=None)
        assert above == min(m for m in wanted if m >= n)
    assert wanted[:8] == [2, 4, 12, 16, 30, 36, 56, 80]


def test_hexagonal_rows():
    points = Hexagonal().draw(12)[0].reshape(4, 3, 2)
    np.testing.assert_allclose(points[..., 1], np.repeat([[1, 3, 5, 7]], 3, axis=0).T / 8)
    np.testing.assert_allclose(points[0, :, 0], [1 / 12, 5 / 12, 9 / 12])
    np.testing.assert_allclose(points[1, :, 0], [3 / 12, 7 / 12, 11 / 12])


@pytest.mark.parametrize("dims", [0, 1, 3, 2.5, "2", None])
def test_hexagonal_is_two_dimensional(dims):
    with pytest.raises(ParameterError, match="must be 2"):
        Hexagonal(dims=dims)
