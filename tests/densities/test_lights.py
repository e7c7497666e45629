"""Solid-angle sampling: Ω by quadrature and formulas; tiny, huge and grazing lights."""

import math

import numpy as np
import pytest

from mcspectra.densities import SphericalRectangle, SphericalTriangle

RECTANGLES = [
    SphericalRectangle(),
    SphericalRectangle(corner=(1, 2, 3), edge0=(0, 1, 1), edge1=(-2, 0, 0), origin=(0.5, 0.1, -1)),
    SphericalRectangle(corner=(-1, -0.2, 0.1), edge0=(3, 0, 0), edge1=(0, 1, 0)),
    SphericalRectangle(corner=(-3, -4, 0.5), edge0=(2, 0, 0), edge1=(0, 3, 0)),
]
TRIANGLES = [
    SphericalTriangle(),
    SphericalTriangle(a=(1, 0, 0), b=(0, 1, 0), c=(0, 0, 1)),
    SphericalTriangle(a=(1, -1, 0.2), b=(0, 2, 0.1), c=(-1, -1, 0.4)),
    SphericalTriangle(a=(4, 3, 5), b=(4, 3.5, 5), c=(4.2, 3, 6), origin=(1, 1, 1)),
]
FAR = [
    SphericalRectangle(corner=(1e4, 3, 1), edge0=(0, 0, 1e-4), edge1=(0, 1e-4, 0)),
    SphericalRectangle(corner=(1e4, 3, 1), edge0=(1, 0, 0), edge1=(0, 1, 0)),
    SphericalTriangle(a=(1e4, 0, 0), b=(1e4, 1e-4, 0), c=(1e4, 0, 1e-4)),
    SphericalTriangle(a=(1e4, 0, 0.1), b=(1e4, 1, 0.1), c=(1e4 + 1, 0, 0.1)),
]
NEAR = [
    SphericalRectangle(corner=(-1, -0.3, 1e-4), edge0=(1.2, 0, 0), edge1=(0, 1, 0)),
    SphericalTriangle(a=(1, 0, 1e-4), b=(-1, 2, 1e-4), c=(-1, -2, 1e-4)),
]


def name(density):
    return density.spec[:40]


def on_light(density, x):
    """Return points of the light relative to the origin, by the meaning of (s, t) in docstrings."""
    s, t = x[..., :1], x[..., 1:]
    if isinstance(density, SphericalRectangle):
        point = np.array(density.corner) + s * np.array(density.edge0) + t * np.array(density.edge1)
    else:
        a, b, c = (np.array(v) for v in (density.a, density.b, density.c))
        point = b + np.sqrt(t) * ((1 - s) * a + s * c - b)
    return point - np.array(density.origin)


def gauss(function, order=60):
    """Integral over the unit square; t = τ² removes the root of the triangle's map."""
    node, weight = np.polynomial.legendre.leggauss(order)
    line, w = 0.5 * (node + 1), 0.5 * weight
    x = np.stack(np.meshgrid(line, line**2, indexing="ij"), axis=-1)
    return np.einsum("i,j,ij->", w, w * 2 * line, function(x))


def jacobian(density, x):
    """Return |∂ω/∂(s, t)| by differences of unit vectors."""
    step = 1e-6
    sides = []
    for e in step * np.eye(2):
        ahead, behind = (on_light(density, x + d) for d in (e, -e))
        ahead, behind = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (ahead, behind))
        sides.append((ahead - behind) / (2 * step))
    return np.linalg.norm(np.cross(*sides), axis=-1)


@pytest.mark.parametrize("density", [*RECTANGLES, *TRIANGLES], ids=name)
def test_solid_angle_by_quadrature_of_the_jacobian(density):
    value = gauss(lambda x: jacobian(density, np.clip(x, 2e-6, 1 - 2e-6)), 120)
    # Nodes resolve a kernel of width 0.1/3; the ends omit 2e-6, with a density of up to 10
    assert density.solid_angle == pytest.approx(value, rel=1e-4)
    x = np.random.default_rng(1).uniform(0.05, 0.95, (50, 2))
    np.testing.assert_allclose(
        density.pdf(x), jacobian(density, x) / density.solid_angle, rtol=1e-6
    )


def test_known_solid_angles():
    """A face of a cube around the origin, an octant, and a rectangle as two triangles."""
    face = SphericalRectangle(corner=(-1, -1, 1), edge0=(2, 0, 0), edge1=(0, 2, 0))
    assert face.solid_angle == pytest.approx(4 * math.pi / 6, rel=1e-15)
    assert TRIANGLES[1].solid_angle == pytest.approx(math.pi / 2, rel=1e-15)
    half = SphericalTriangle(a=(-0.5, -0.5, 1), b=(0.5, -0.5, 1), c=(0.5, 0.5, 1))
    assert 2 * half.solid_angle == pytest.approx(SphericalRectangle().solid_angle, rel=1e-15)


@pytest.mark.parametrize("density", FAR, ids=name)
def test_far_and_tiny_lights_keep_their_digits(density):
    """∫p = 1 by quadrature, where p contains 1/Ω and Ω is as small as 1e-16."""
    assert density.solid_angle < 1e-11
    assert gauss(density.pdf, 12) == pytest.approx(1.0, rel=1e-12)
    u = np.random.default_rng(2).random((2000, 2))
    assert np.abs(density.invert(density.sample(u)) - u).max() < 4e-15


@pytest.mark.parametrize("density", NEAR, ids=name)
def test_lights_next_to_the_origin(density):
    """Ω is close to 2π; p has a peak like 1/z², and u is recovered to the digits of x."""
    assert 6.28 < density.solid_angle < 2 * math.pi
    u = np.random.default_rng(3).random((2000, 2))
    x = density.sample(u)
    w = on_light(density, x)
    w /= np.linalg.norm(w, axis=-1, keepdims=True)
    # Over almost a hemisphere, cos θ is uniform with mean ½ and variance 1/12
    assert abs(w[:, 2].mean() - 0.5) < 5 / math.sqrt(12 * 2000)
    back = density.invert(x)
    assert np.abs(back - u).max() < 1e-15 * density.pdf(x).max() ** 0.5 * 100


def urena(density, u):
    """Return the paper's closed form in local coordinates: (s, t)."""
    corner = on_light(density, np.zeros(2))
    e0, e1 = np.array(density.edge0, float), np.array(density.edge1, float)
    l0, l1 = np.linalg.norm(e0), np.linalg.norm(e1)
    x0, y0 = corner @ e0 / l0, corner @ e1 / l1
    z0 = -abs(corner @ np.cross(e0, e1)) / (l0 * l1)
    x1, y1 = x0 + l0, y0 + l1
    v = [np.array(p) for p in ((x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0))]
    n = [np.cross(v[i], v[(i + 1) % 4]) for i in range(4)]
    n = [each / np.linalg.norm(each) for each in n]
    g = [math.acos(-n[i] @ n[(i + 1) % 4]) for i in range(4)]
    angle = u[:, 0] * density.solid_angle + 2 * math.pi - g[2] - g[3]
    fu = (np.cos(angle) * n[0][2] - n[2][2]) / np.sin(angle)
    cu = np.copysign(1 / np.sqrt(fu**2 + n[0][2] ** 2), fu)
    x = np.clip(-cu * z0 / np.sqrt(1 - cu**2), x0, x1)
    d = np.sqrt(x**2 + z0**2)
    h0, h1 = y0 / np.sqrt(d**2 + y0**2), y1 / np.sqrt(d**2 + y1**2)
    h = h0 + u[:, 1] * (h1 - h0)
    return np.stack([(x - x0) / l0, (h * d / np.sqrt(1 - h * h) - y0) / l1], axis=-1)


@pytest.mark.parametrize("density", RECTANGLES, ids=name)
def test_the_map_of_urena_fajardo_and_king(density):
    u = np.random.default_rng(5).random((500, 2))
    # The closed form subtracts angles of order 1: errors of 1e-15 over Ω, and their roots if cos is
    # 1
    np.testing.assert_allclose(density.sample(u), urena(density, u), atol=1e-10)


def arvo(density, u):
    """Return directions of Arvo's closed form."""
    corners = [on_light(density, np.array(p, float)) for p in ((0, 1), (0, 0), (1, 1))]
    a, b, c = (v / np.linalg.norm(v) for v in corners)

    def apart(x, y):
        rest = x - (x @ y)[..., None] * y
        return rest / np.linalg.norm(rest, axis=-1, keepdims=True)

    alpha = math.acos(apart(b, a) @ apart(c, a))
    area = u[:, 0] * density.solid_angle
    s, t = np.sin(area - alpha), np.cos(area - alpha)
    p, v = t - math.cos(alpha), s + math.sin(alpha) * (a @ b)
    q = ((v * t - p * s) * math.cos(alpha) - v) / ((v * s + p * t) * math.sin(alpha))
    third = q[:, None] * a + np.sqrt(1 - q**2)[:, None] * apart(c, a)
    z = 1 - u[:, 1] * (1 - third @ b)
    return z[:, None] * b + np.sqrt(1 - z**2)[:, None] * apart(third, b)


@pytest.mark.parametrize("density", TRIANGLES, ids=name)
def test_the_map_of_arvo(density):
    u = np.random.default_rng(6).uniform(0.01, 0.99, (500, 2))
    w = on_light(density, density.sample(u))
    w /= np.linalg.norm(w, axis=-1, keepdims=True)
    # The closed form's angles have errors of 1e-16 over Ω = 2e-3 at least; √(1 − z²) takes a root
    np.testing.assert_allclose(w, arvo(density, u), atol=1e-10)


def test_the_ends_of_the_square():
    for density in (RECTANGLES[0], TRIANGLES[0]):
        ends = np.array([[0.0, 0.0], [1.0, 1.0], [1e-30, 1e-25]])
        x = density.sample(ends)
        np.testing.assert_allclose(x[:2], [[0, 0], [1, 1]], atol=1e-15)
        np.testing.assert_allclose(density.invert(x)[2], ends[2], rtol=1e-12)
