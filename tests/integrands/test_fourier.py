"""Coefficients against independent formulas: Bessel functions, polygons, sums of pieces."""

import itertools

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.integrands.indicators import _cut_cube_volume, _cut_disk_fourier


def some_frequencies(dims=2, largest=300, count=200):
    rng = np.random.default_rng(7)
    spread = largest ** rng.random((count, 1))
    return np.rint(rng.uniform(-1, 1, (count, dims)) * spread)


def test_chords_of_a_whole_disk_give_bessel_functions():
    m = some_frequencies()
    disk = mcs.integrands.Disk(center=(0.47, 0.52), radius=0.31)
    chords = _cut_disk_fourier(m, np.array([0.47, 0.52]), 0.31)
    assert np.abs(chords - disk.fourier(m)).max() < 1e-13


def test_coefficients_of_a_ball_are_those_of_its_sections():
    """Along an axis: ∫ π(r² − x²) cos(2πkx) dx over |x| < r, times the phase of the center."""
    ball = mcs.integrands.Disk(center=(0.45, 0.5, 0.6), radius=0.37, dims=3)
    k = np.arange(1, 8)
    x, weights = np.polynomial.legendre.leggauss(64)
    sections = 0.37 * weights * np.pi * 0.37**2 * (1 - x**2)
    expected = np.cos(2 * np.pi * 0.37 * np.outer(k, x)) @ sections * np.exp(-1.2j * np.pi * k)
    found = ball.fourier(np.stack([0 * k, 0 * k, k], axis=-1))
    assert np.abs(found - expected).max() < 1e-13


def test_the_pieces_of_a_disk_on_the_torus_sum_to_the_whole():
    """Integer shifts do not change exp(−2πi m·x)."""
    m = some_frequencies()
    center = np.array([0.13, 0.95])
    pieces = [
        mcs.integrands.Disk(center=center + shift, radius=0.37).fourier(m)
        for shift in itertools.product((-1, 0, 1), repeat=2)
    ]
    whole = mcs.integrands.Disk(center=(0.5, 0.5), radius=0.37).fourier(m)
    moved = whole * np.exp(-2j * np.pi * m @ (center - 0.5))
    assert np.abs(np.sum(pieces, axis=0) - moved).max() < 1e-13


def clip_square(normal, offset):
    """Return vertices of the unit square where normal·x < offset (Sutherland and Hodgman)."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    kept = []
    for p, q in zip(square, np.roll(square, -1, axis=0), strict=True):
        inside_p, inside_q = offset - normal @ p, offset - normal @ q
        if inside_p >= 0:
            kept.append(p)
        if inside_p * inside_q < 0:
            kept.append(p + (q - p) * inside_p / (inside_p - inside_q))
    return np.array(kept)


def polygon_fourier(vertices, m):
    """Apply Gauss's theorem: f_m = i/(2π|m|²) Σ_edges (m·n) ∫_edge exp(−2πi m·x) ds."""
    total = 0.0
    for p, q in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        edge = q - p
        flux = m[:, 0] * edge[1] - m[:, 1] * edge[0]
        wave = np.exp(-1j * np.pi * m @ (p + q)) * np.sinc(m @ edge)
        total = total + flux * wave
    return 1j * total / (2 * np.pi * (m**2).sum(axis=1))


@pytest.mark.parametrize(
    ("normal", "offset"),
    [
        ((1, 2), 0.9),
        ((-1, 0.3), -0.4),
        ((0.2, -1), -0.1),
        ((1, -1), 0.0),
        ((1, 1), 1.0),
        ((3, 1e-7), 1.0),
        ((0, -2), -0.4),
        ((0.5, 0), 0.2),
        ((-0.7, -0.6), -1.1),
    ],
)
def test_half_planes_are_polygons(normal, offset):
    m = np.concatenate([some_frequencies(), np.outer(np.arange(-20, 21), [1, 2]), [[5, -5]]])
    m = m[m.any(axis=1)]
    expected = polygon_fourier(clip_square(np.array(normal, float), offset), m)
    found = mcs.integrands.HalfSpace(normal=normal, offset=offset).fourier(m)
    assert np.abs(found - expected).max() < 1e-13


def test_a_gaussian_at_high_frequencies_decays_like_its_jump():
    """f_m → i (f(1) − f(0)) / (2π m); the next term is (f'(1) − f'(0)) / (2π m)²."""
    f = mcs.integrands.Gaussian(center=0.3, width=0.2, dims=1)
    m = np.array([[10.0**k] for k in range(2, 8)])
    ends = f(np.array([[0.0], [1.0]]))
    slope = -(np.array([0.0, 1.0]) - 0.3) / 0.2**2 * ends
    a = 2j * np.pi * m[:, 0]
    expected = (ends[0] - ends[1]) / a + (slope[0] - slope[1]) / a**2
    curvature = 1 / 0.2**2
    assert (np.abs(f.fourier(m) - expected) < 3 * curvature / np.abs(a) ** 3 + 1e-17).all()


@pytest.mark.parametrize("center", [-30.0, 0.0, 1.0, 1.5, 12.0])
def test_a_gaussian_from_afar(center):
    f = mcs.integrands.Gaussian(center=center, width=0.5, dims=1)
    node, weight = np.polynomial.legendre.leggauss(60)
    x = 0.5 * (node + 1)
    for m in (0, 3):
        expected = (0.5 * weight * f(x[:, None]) * np.exp(-2j * np.pi * m * x)).sum()
        # Relative error: the tail 58 widths away is 1e-740 = 0, 22 widths away 1e-105
        assert abs(f.fourier([[m]])[0] - expected) <= 1e-12 * f(x[:, None]).max()


def test_moderate_degrees_keep_their_digits():
    f = mcs.integrands.Polynomial(coefficients=[0.0] * 20 + [1.0], dims=1)
    node, weight = np.polynomial.legendre.leggauss(60)
    x = 0.5 * (node + 1)
    m = np.arange(-8, 9)
    expected = (0.5 * weight * x**20 * np.exp(-2j * np.pi * m[:, None] * x)).sum(axis=1)
    assert np.abs(f.fourier(m[:, None]) - expected).max() < 1e-14


@pytest.mark.parametrize("dims", [3, 4, 6])
def test_the_volume_of_a_cut_cube(dims):
    """Irwin-Hall distribution: ½ at the middle of a sum of uniforms, c^d/d! below 1."""
    normal = np.ones(dims)
    assert _cut_cube_volume(normal, dims / 2) == pytest.approx(0.5, rel=1e-12)
    assert _cut_cube_volume(normal, 0.8) == pytest.approx(
        0.8**dims / np.prod(np.arange(1, dims + 1))
    )
    assert _cut_cube_volume(-normal, -dims + 0.8) == pytest.approx(_cut_cube_volume(normal, 0.8))
    assert _cut_cube_volume(normal, 0.0) == 0
    assert _cut_cube_volume(normal, dims) == 1


def test_an_ill_conditioned_volume_is_refused():
    assert _cut_cube_volume(np.array([1.0, 1e-8, 1e-8, 1e-8]), 0.5) is None
    f = mcs.integrands.HalfSpace(normal=(1.0, 1e-8, 1e-8), offset=0.5, dims=3)
    assert f.integral == pytest.approx(0.5, abs=1e-6)
