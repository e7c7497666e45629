"""The uniform disk: areas, moments, special points, and what it refuses."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.densities import DiskDensity, PiecewiseConstant
from mcspectra.densities.adaptive import integrate

WARPS = ("polar", "concentric")
LAST = np.nextafter(1.0, 0.0)


def midpoints(side):
    line = (np.arange(side) + 0.5) / side
    return np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("warp", WARPS)
def test_areas_are_kept(warp):
    """|det ∂T/∂u| = π r² everywhere but at the creases, by differences within one sector."""
    disk = DiskDensity(radius=0.3, center=(0.4, 0.6), warp=warp)
    step = 1e-6
    u = np.random.default_rng(1).uniform(0.01, 0.99, (500, 2))
    u = u[np.abs(np.abs(u[:, 0] - 0.5) - np.abs(u[:, 1] - 0.5)) > 1e-4]
    slopes = [(disk.sample(u + e) - disk.sample(u - e)) / (2 * step) for e in step * np.eye(2)]
    area = np.abs(np.linalg.det(np.stack(slopes, axis=-1)))
    # Third derivatives of √u at 0.01 are 4e4 times step²/6, a rounding error is eps/step
    np.testing.assert_allclose(area, math.pi * 0.09, rtol=1e-7)


@pytest.mark.parametrize("warp", WARPS)
def test_moments(warp):
    """E x = c and E (x − c)² = r²/4, by the midpoint rule in u (error of order side^-2)."""
    disk = DiskDensity(radius=0.25, center=(0.3, 0.5), warp=warp)
    x = disk.sample(midpoints(256)) - [0.3, 0.5]
    np.testing.assert_allclose(x.mean(axis=0), 0.0, atol=1e-5)
    np.testing.assert_allclose(x.T @ x / len(x), np.eye(2) * 0.0625 / 4, atol=1e-5)


def test_a_tabulated_version_has_the_same_masses():
    masses = integrate(DiskDensity().pdf, 2, cells=8).cells.reshape(8, 8)
    np.testing.assert_allclose(masses.sum(), 1.0, atol=1e-4)  # the quadrature's, along a curve
    kinds = [*(DiskDensity(warp=warp) for warp in WARPS), PiecewiseConstant(values=masses.T)]
    shares = [
        np.histogramdd(p.sample(midpoints(512)), bins=8, range=[(0, 1)] * 2)[0] / 512**2
        for p in kinds
    ]
    # A border of a cell is crossed by about 512/8 small squares, of which at most all are miscounted
    for share in shares[:2]:
        assert np.abs(share - shares[2]).max() < 4 * 2 * 512 / 8 / 512**2


def test_special_points_of_the_polar_warp():
    disk = DiskDensity(warp="polar")
    u = [[0, 0.25], [0.25, 0.25], [0.5, 1], [0.7, 0]]
    expected = [[0.75, 0.5], [0.5, 0.75], [0, 0.5], [0.5, 0.5]]
    np.testing.assert_allclose(disk.sample(u), expected, atol=1e-15)


def test_special_points_of_the_concentric_warp():
    """Sides' middles to the axes, corners to the diagonals, squares to circles; π/8 up at half way."""
    disk = DiskDensity()
    c = 0.5 * math.sqrt(0.5)
    angle = math.pi / 8
    pairs = {
        (0.5, 0.5): (0.5, 0.5),
        (1.0, 0.5): (LAST, 0.5),
        (0.5, 0.0): (0.5, 0.0),
        (1.0, 1.0): (0.5 + c, 0.5 + c),
        (0.0, 1.0): (0.5 - c, 0.5 + c),
        (0.0, 0.0): (0.5 - c, 0.5 - c),
        (0.25, 0.5): (0.25, 0.5),
        (1.0, 0.75): (0.5 + 0.5 * math.cos(angle), 0.5 + 0.5 * math.sin(angle)),
        (0.25, 1.0): (0.5 - 0.5 * math.sin(angle), 0.5 + 0.5 * math.cos(angle)),
    }
    np.testing.assert_allclose(disk.sample(list(pairs)), list(pairs.values()), atol=1e-15)
    np.testing.assert_allclose(disk.invert(list(pairs.values())), list(pairs), atol=1e-14)


@pytest.mark.parametrize("warp", WARPS)
def test_invert_away_from_the_centre(warp):
    disk = DiskDensity(warp=warp, radius=0.4, center=(0.45, 0.5))
    u = np.random.default_rng(2).random((2000, 2))
    x = disk.sample(u)
    rho = np.hypot(*(x - [0.45, 0.5]).T)
    # x is known to an ulp: so is an angle, over ρ
    assert (np.abs(disk.invert(x) - u).max(axis=1) <= 8e-16 * (1 + 1 / rho)).all()


def test_the_rim_is_inside_and_the_rest_is_not():
    for warp in WARPS:
        disk = DiskDensity(radius=1e-6, center=(0.1, 0.9), warp=warp)
        rim = np.linspace(0, 1, 4001)
        u = np.concatenate([np.stack([rim, np.full(4001, e)], axis=1) for e in (LAST, 1.0)])
        assert (disk.pdf(disk.sample(u)) > 0).all()
    disk = DiskDensity()
    assert disk.pdf([0.5, 1e-9]) == pytest.approx(4 / math.pi)
    assert disk.pdf([0.1, 0.1]) == 0
    assert (disk.pdf(disk.zero_points()) == 0).all()
    assert disk.reciprocal_integral() == math.inf
    assert mcs.density("disk(radius=0.2)").pdf([0.5, 0.7000001]) == 0


def test_points_outside_go_to_the_rim():
    u = DiskDensity(warp="polar", radius=0.25).invert([[0.5, 1.0], [0.0, 0.5]])
    np.testing.assert_allclose(u, [[0.25, LAST], [0.5, LAST]], atol=1e-15)


def test_an_integrand_outside_the_disk_is_refused():
    with pytest.raises(DensityError, match="would miss"):
        mcs.Estimator("constant", "disk")
    estimator = mcs.Estimator("disk(radius=0.2)", "disk(radius=0.3)")
    assert estimator.primary_values(0, np.array([[0.5, 0.5]]))[0] == pytest.approx(math.pi * 0.09)


@pytest.mark.parametrize(
    "options",
    [
        {"radius": 0},
        {"radius": 0.51},
        {"radius": 1e-7},
        {"radius": math.nan},
        {"radius": "a"},
        {"radius": True},
        {"center": (0.1, 0.5)},
        {"center": (0.5, 0.5, 0.5)},
        {"center": (0.5, math.inf)},
        {"center": 0.6},
        {"center": None},
        {"warp": "square"},
        {"warp": None},
    ],
)
def test_bad_parameters(options):
    with pytest.raises(ParameterError) as caught:
        DiskDensity(**options)
    assert "\n" not in str(caught.value)


def test_other_dims_are_refused():
    with pytest.raises(ParameterError, match="dims"):
        mcs.density("disk", dims=3)
