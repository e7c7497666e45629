"""The disk and directions: moments, reference maps, special points, poles and seams."""

import math

import numpy as np
import pytest
from tests.densities.conftest import midpoints

import mcspectra as mcs
from mcspectra.core.errors import DensityError
from mcspectra.densities import DiskDensity, HemisphereDensity, SphereDensity

WARPS = ("polar", "concentric")
LAST = np.nextafter(1.0, 0.0)
ALL = [
    *(HemisphereDensity(weighting=w, warp=t) for w in ("uniform", "cosine") for t in WARPS),
    *(SphereDensity(warp=t) for t in WARPS),
]
DISKS = [DiskDensity(radius=0.3, center=(0.4, 0.6), warp=t) for t in WARPS]
each = pytest.mark.parametrize("density", ALL, ids=lambda p: p.spec)


def directions(density, x):
    """Return unit vectors (..., 3) of points of the lat-long square."""
    theta = x[..., 1] * (math.pi if density.name == "sphere" else math.pi / 2)
    phi = 2 * math.pi * x[..., 0]
    return np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1
    )


def moments(density):
    """Return E ω_2, E ω_0² and E ω_2² in closed form."""
    if density.name == "sphere":
        return 0.0, 1 / 3, 1 / 3
    return (0.5, 1 / 3, 1 / 3) if density.weighting == "uniform" else (2 / 3, 1 / 4, 1 / 2)


@each
def test_moments(density):
    """Midpoint rule in u; its error is of order side^-2, or side^-1.5 at the end of a root."""
    w = directions(density, density.sample(midpoints(256)))
    mean, side, up = moments(density)
    error = 2 * 256**-1.5
    np.testing.assert_allclose(w.mean(axis=0), [0, 0, mean], atol=error)
    np.testing.assert_allclose(w.T @ w / len(w), np.diag([side, side, up]), atol=error)


@each
def test_the_pdf_is_the_density_of_directions_times_the_jacobian(density):
    x = np.random.default_rng(1).random((200, 2))
    scale = math.pi if density.name == "sphere" else math.pi / 2
    theta = scale * x[:, 1]
    steradian = 2 * math.pi * scale * np.sin(theta)
    per = {
        "sphere": 1 / (4 * math.pi),
        "uniform": 1 / (2 * math.pi),
        "cosine": np.cos(theta) / math.pi,
    }
    expected = per[getattr(density, "weighting", "sphere")] * steradian
    np.testing.assert_allclose(density.pdf(x), expected, rtol=1e-12)


@pytest.mark.parametrize("density", [*ALL, *DISKS], ids=lambda p: p.spec)
def test_the_two_warps_share_one_pdf_and_jacobian(density):
    """p(T(u)) |det ∂T/∂u| = 1 by central differences, away from the creases and the seam."""
    u = np.random.default_rng(2).uniform(0.02, 0.98, (800, 2))
    a, b = np.abs(u - 0.5).T
    u = u[(np.abs(a - b) > 1e-3) & (a > 1e-3) & (b > 1e-3) & (np.abs(a + b - 0.5) > 1e-3)]
    step = 1e-6
    slopes = [
        (density.sample(u + e) - density.sample(u - e)) / (2 * step) for e in step * np.eye(2)
    ]
    area = np.abs(np.linalg.det(np.stack(slopes, axis=-1)))
    # Relative third derivatives within 1e-3 of a pole or crease: step²·1e6; rounding is eps/step
    np.testing.assert_allclose(area * density.pdf(density.sample(u)), 1.0, rtol=1e-5)


def octahedral(a, b):
    """Return the equal-area map in Cartesian form, a and b in [-1, 1]; slow and scalar."""
    signed = 1 - (abs(a) + abs(b))
    radius = 1 - abs(signed)
    phi = math.pi / 4 * (1.0 if radius == 0 else (abs(b) - abs(a)) / radius + 1)
    z = math.copysign(1 - radius**2, signed)
    flat = radius * math.sqrt(2 - radius**2)
    return [
        math.copysign(math.cos(phi), a) * flat,
        math.copysign(math.sin(phi), b) * flat,
        z,
    ]


def test_the_octahedral_map_agrees_with_its_cartesian_form():
    density = SphereDensity()
    u = np.concatenate([np.random.default_rng(3).random((500, 2)), midpoints(9)])
    expected = np.array([octahedral(*(2 * each - 1)) for each in u])
    np.testing.assert_allclose(directions(density, density.sample(u)), expected, atol=1e-15 * 8)


def test_concentric_directions_are_continuous():
    """Continuity across seams, folds and, on the sphere, from a side to its mirror image."""
    h = 1e-4
    u = np.random.default_rng(4).uniform(0, 1 - h, (20_000, 2))
    u[:5000, 1] = 0.5 - h / 2
    for density in ALL:
        if density.warp == "polar":
            continue
        here = directions(density, density.sample(u))
        for axis in np.eye(2):
            there = directions(density, density.sample(u + h * axis))
            stretch = np.linalg.norm(there - here, axis=-1) / h
            # Cosine: θ = asin ρ, vertical at the rim, moves at most √(2h)
            bound = math.sqrt(8 * h) / h if density.spec == "hemisphere" else 8.0
            assert stretch.max() < bound
    line = np.linspace(0, 1, 101)
    edge = [np.stack([line if flip else 1 - line, np.ones(101)], axis=1) for flip in (0, 1)]
    left, right = (directions(SphereDensity(), SphereDensity().sample(e)) for e in edge)
    np.testing.assert_allclose(left, right, atol=1e-14)


def test_poles_and_seams():
    sphere = SphereDensity()
    np.testing.assert_allclose(sphere.sample([0.5, 0.5])[1], 0.0, atol=1e-300)
    corners = sphere.sample([[0, 0], [1, 0], [0, 1], [1, 1]])
    assert (corners[:, 1] > 1 - 1e-15).all()
    below, above = sphere.sample([[0.8, 0.5 - 1e-9], [0.8, 0.5]])
    assert below[0] > 0.99
    assert above[0] == 0
    for turn in (0.0, 0.3, 0.99):
        np.testing.assert_allclose(sphere.invert([turn, 0.0]), 0.5, atol=1e-15)
        np.testing.assert_allclose(HemisphereDensity().invert([turn, 0.0]), 0.5, atol=1e-15)
    for density in ALL:
        assert density.pdf([0.3, 0.0]) == 0
        low = density.sample([0.3, 0.0])
        assert np.isfinite(low).all()
        assert density.reciprocal_integral() == math.inf


@pytest.mark.parametrize("spec", ['sphere(warp="polar")', "sphere"])
def test_digits_are_kept_next_to_both_poles(spec):
    """u at 1e-12 from a pole is recovered with its digits."""
    density = mcs.density(spec)
    near = [[0.5 + 1e-12, 0.5 + 3e-12], [1 - 1e-12, 1 - 3e-12], [1e-12, 3e-12], [0.3, 1e-12]]
    np.testing.assert_allclose(density.invert(density.sample(near)), near, rtol=0, atol=4e-16)


@pytest.mark.parametrize("warp", WARPS)
def test_moments_of_the_disk(warp):
    """E x = c and E (x − c)² = r²/4, by the midpoint rule in u (error of order side^-2)."""
    disk = DiskDensity(radius=0.25, center=(0.3, 0.5), warp=warp)
    x = disk.sample(midpoints(256)) - [0.3, 0.5]
    np.testing.assert_allclose(x.mean(axis=0), 0.0, atol=1e-5)
    np.testing.assert_allclose(x.T @ x / len(x), np.eye(2) * 0.0625 / 4, atol=1e-5)


def test_special_points_of_the_polar_warp():
    disk = DiskDensity(warp="polar")
    u = [[0, 0.25], [0.25, 0.25], [0.5, 1], [0.7, 0]]
    expected = [[0.75, 0.5], [0.5, 0.75], [0, 0.5], [0.5, 0.5]]
    np.testing.assert_allclose(disk.sample(u), expected, atol=1e-15)


def test_special_points_of_the_concentric_warp():
    """Midpoints of sides map to the axes, corners to the diagonals, squares to circles."""
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
def test_invert_away_from_the_center(warp):
    disk = DiskDensity(warp=warp, radius=0.4, center=(0.45, 0.5))
    u = np.random.default_rng(2).random((2000, 2))
    x = disk.sample(u)
    rho = np.hypot(*(x - [0.45, 0.5]).T)
    # x is accurate to an ulp, and so is the angle divided by ρ
    assert (np.abs(disk.invert(x) - u).max(axis=1) <= 8e-16 * (1 + 1 / rho)).all()


def test_the_rim_belongs_to_the_disk():
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


def test_points_outside_map_to_the_rim():
    u = DiskDensity(warp="polar", radius=0.25).invert([[0.5, 1.0], [0.0, 0.5]])
    np.testing.assert_allclose(u, [[0.25, LAST], [0.5, LAST]], atol=1e-15)


def test_an_integrand_outside_the_disk_is_refused():
    with pytest.raises(DensityError, match="would miss"):
        mcs.Estimator("constant", "disk")
    estimator = mcs.Estimator("disk(radius=0.2)", "disk(radius=0.3)")
    assert estimator.primary_values(0, np.array([[0.5, 0.5]]))[0] == pytest.approx(math.pi * 0.09)
