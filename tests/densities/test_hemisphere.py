"""Directions: moments, references of the maps, poles and seams."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.densities import HemisphereDensity, PiecewiseConstant, SphereDensity
from mcspectra.densities.adaptive import integrate

WARPS = ("polar", "concentric")
WEIGHTINGS = ("uniform", "cosine")
ALL = [
    *(HemisphereDensity(weighting=w, warp=t) for w in WEIGHTINGS for t in WARPS),
    *(SphereDensity(warp=t) for t in WARPS),
]
each = pytest.mark.parametrize("density", ALL, ids=lambda p: p.spec)


def midpoints(side):
    line = (np.arange(side) + 0.5) / side
    return np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)


def directions(density, x):
    """Unit vectors (..., 3) of points of the lat-long square."""
    theta = x[..., 1] * (math.pi if density.name == "sphere" else math.pi / 2)
    phi = 2 * math.pi * x[..., 0]
    return np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1
    )


def moments(density):
    """E ω_2, E ω_0² and E ω_2², in closed form."""
    if density.name == "sphere":
        return 0.0, 1 / 3, 1 / 3
    return (0.5, 1 / 3, 1 / 3) if density.weighting == "uniform" else (2 / 3, 1 / 4, 1 / 2)


@each
def test_moments(density):
    """By the midpoint rule in u; its error is of order side^-2, side^-1.5 at the end of a root."""
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


@each
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
    # Relative third derivatives within 1e-3 of a pole or crease: step²·1e6, and rounding eps/step
    np.testing.assert_allclose(area * density.pdf(density.sample(u)), 1.0, rtol=1e-5)


@each
def test_a_tabulated_version_has_the_same_masses(density):
    masses = integrate(density.pdf, 2, cells=8).cells.reshape(8, 8)
    table = PiecewiseConstant(values=masses.T)
    shares = [
        np.histogramdd(p.sample(midpoints(512)), bins=8, range=[(0, 1)] * 2)[0] / 512**2
        for p in (density, table)
    ]
    assert np.abs(shares[0] - shares[1]).max() < 4 * 2 * 512 / 8 / 512**2
    np.testing.assert_allclose(masses.sum(), 1.0, rtol=1e-9)


def octahedral(a, b):
    """The equal-area map in Cartesian form, a and b in [-1, 1]: slow and scalar."""
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


def test_the_octahedral_map_in_another_form():
    density = SphereDensity()
    u = np.concatenate([np.random.default_rng(3).random((500, 2)), midpoints(9)])
    expected = np.array([octahedral(*(2 * each - 1)) for each in u])
    np.testing.assert_allclose(directions(density, density.sample(u)), expected, atol=1e-15 * 8)


def test_concentric_directions_are_continuous():
    """Also across seams, folds and, on the sphere, from a side to its mirror image."""
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
def test_digits_next_to_both_poles(spec):
    """u at 1e-12 of a pole comes back with the digits that it had."""
    density = mcs.density(spec)
    near = [[0.5 + 1e-12, 0.5 + 3e-12], [1 - 1e-12, 1 - 3e-12], [1e-12, 3e-12], [0.3, 1e-12]]
    np.testing.assert_allclose(density.invert(density.sample(near)), near, rtol=0, atol=4e-16)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        (HemisphereDensity, {"weighting": "sine"}),
        (HemisphereDensity, {"weighting": None}),
        (HemisphereDensity, {"warp": "octahedral"}),
        (SphereDensity, {"warp": 3}),
    ],
)
def test_bad_parameters(kind, options):
    with pytest.raises(ParameterError, match="must be one of"):
        kind(**options)
    with pytest.raises(ParameterError, match="dims"):
        mcs.density(kind.name, dims=3)
