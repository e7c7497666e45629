"""Disks and half-planes: shares of boxes, volumes, Fourier coefficients of their indicators."""

from __future__ import annotations

import itertools
import math

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.integrands._axes import gauss_rule, interval_fourier

__all__ = [
    "ball_fourier",
    "ball_volume",
    "cut_cube_volume",
    "cut_disk_fourier",
    "disk_share",
    "half_plane_fourier",
    "half_plane_share",
]

_CYCLES, _ORDER = 8, 32  # 32 Gauss nodes integrate 8 cycles of a wave to rounding
_BLOCK = 2**22  # complex numbers in one block of a sum over nodes: 64 MiB
_CONDITION = 1e-10  # relative rounding that inclusion and exclusion may cost


def ball_volume(dims: int, radius: float) -> float:
    """Volume of a d-ball."""
    return float(math.pi ** (dims / 2) * radius**dims / math.gamma(dims / 2 + 1))


def ball_fourier(m: Array, center: Array, radius: float) -> Array:
    """∫_ball exp(−2πi m·x) dx = (r/|m|)^{d/2} J_{d/2}(2π r |m|) exp(−2πi m·c), m (..., d)."""
    from scipy.special import jv

    dims = m.shape[-1]
    length = np.sqrt((m * m).sum(axis=-1))
    safe = np.where(length > 0, length, 1.0)
    size = (radius / safe) ** (dims / 2) * jv(dims / 2, 2 * np.pi * radius * safe)
    size = np.where(length > 0, size, ball_volume(dims, radius))
    return np.asarray(size * np.exp(-2j * np.pi * (m @ center)))


def disk_share(lo: Array, hi: Array, center: Array, radius: float) -> Array:
    """Share of the rectangles [lo, hi], (..., 2), that lies in a disk.

    By inclusion and exclusion of quadrants, with rectangles wholly inside or outside told apart
    first: there the difference of nearly equal areas would leave rounding where 0 or 1 is right.
    """
    a, b = (lo - center) / radius, (hi - center) / radius
    box = (b - a).prod(axis=-1)
    area = (
        _quadrant(b[..., 0], b[..., 1])
        - _quadrant(a[..., 0], b[..., 1])
        - _quadrant(b[..., 0], a[..., 1])
        + _quadrant(a[..., 0], a[..., 1])
    )
    farthest = (np.maximum(np.abs(a), np.abs(b)) ** 2).sum(axis=-1)
    nearest = (np.clip(0.0, a, b) ** 2).sum(axis=-1)
    share = np.clip(area / box, 0.0, 1.0)
    return np.where(farthest <= 1.0, 1.0, np.where(nearest >= 1.0, 0.0, share))


def _quadrant(x: Array, y: Array) -> Array:
    """Area of the unit disk within (−∞, x] × (−∞, y]."""
    x, y = np.clip(x, -1.0, 1.0), np.clip(y, -1.0, 1.0)
    k = np.sqrt(1.0 - y * y)
    inner = np.clip(x, -k, k)
    strip = y * (inner + k)  # where the chord is cut at height y
    below = _half_area(inner) - _half_area(-k) + strip
    caps = _half_area(np.minimum(x, -k)) + _half_area(np.maximum(x, k)) - _half_area(k)
    return np.asarray(np.where(y < 0, below, _half_area(x) + caps + strip))


def _half_area(x: Array) -> Array:
    """∫_{−1}^x √(1−t²) dt."""
    return np.asarray(0.5 * (x * np.sqrt(1.0 - x * x) + np.arcsin(x) + 0.5 * np.pi))


def cut_disk_fourier(m: Array, center: Array, radius: float) -> Array:
    """Coefficients of a disk cut by the unit square, m (..., 2): chords, integrated over x_0.

    Along a chord the integral is exact; over x_0 = c_0 + r sin θ, where chords are smooth between
    the kinks at which the circle meets the borders, Gauss-Legendre panels are short enough for the
    highest frequency to be integrated to rounding. Cost O(U_0 U_1 (|m| + const)) for U_i distinct m_i.
    """
    m0, where0 = np.unique(m[..., 0], return_inverse=True)
    m1, where1 = np.unique(m[..., 1], return_inverse=True)
    theta, weight = _angles(center, radius, float(np.abs(m).sum(axis=-1).max()))
    total = np.zeros((m0.size, m1.size), np.complex128)
    step = max(1, _BLOCK // (m0.size + m1.size))
    for start in range(0, theta.size, step):
        t = theta[start : start + step]
        half = radius * np.cos(t)
        low, high = np.clip(center[1] - half, 0.0, 1.0), np.clip(center[1] + half, 0.0, 1.0)
        waves = np.exp(-2j * np.pi * m0[:, None] * (center[0] + radius * np.sin(t)))
        chords = interval_fourier(m1[:, None], low, high)
        total += (waves * (weight[start : start + step] * half)) @ chords.T
    return np.asarray(total[where0.reshape(m.shape[:-1]), where1.reshape(m.shape[:-1])])


def _angles(center: Array, radius: float, cycles: float) -> tuple[Array, Array]:
    """Nodes and weights in θ on panels between kinks, each with at most `_CYCLES` cycles."""
    ends = np.arcsin(np.clip((np.array([0.0, 1.0]) - center[0]) / radius, -1.0, 1.0))
    meets = np.arccos(np.clip(np.abs(np.array([center[1], 1.0 - center[1]])) / radius, 0.0, 1.0))
    kinks = np.unique(np.clip([*ends, *meets, *-meets], ends[0], ends[1]))
    node, weight = gauss_rule(_ORDER)
    nodes, weights = [np.empty(0)], [np.empty(0)]
    for low, high in itertools.pairwise(kinks):
        count = math.ceil(1 + cycles * radius * (high - low) / _CYCLES)
        edges = np.linspace(low, high, count + 1)
        width = np.diff(edges)[:, None]
        nodes.append((edges[:-1, None] + width * node).ravel())
        weights.append((width * weight).ravel())
    return np.concatenate(nodes), np.concatenate(weights)


def half_plane_share(lo: Array, hi: Array, normal: Array, offset: float) -> Array:
    """Share of the boxes [lo, hi], (..., 1) or (..., 2), in which normal·x < offset.

    In units of the box, with both components of the normal made positive by reflection, it is the
    distribution function of a u + b v for uniform u, v: a trapezoid with corners at b and a, a ≥ b.
    """
    sides = (hi - lo) * normal
    level = offset - lo @ normal - np.minimum(sides, 0.0).sum(axis=-1)
    sides = np.sort(np.abs(sides), axis=-1)
    a = sides[..., -1]
    b = sides[..., 0] if sides.shape[-1] == 2 else np.zeros_like(a)
    level = np.clip(level, 0.0, a + b)
    mirrored = np.minimum(level, a + b - level)  # the distribution is symmetric about (a + b)/2
    twice = np.where(b > 0, 2.0 * a * b, 1.0)
    share = np.where(mirrored < b, mirrored**2 / twice, (mirrored - 0.5 * b) / a)
    return np.asarray(np.where(level > 0.5 * (a + b), 1.0 - share, share))


def cut_cube_volume(normal: Array, offset: float) -> float | None:
    """Volume of {x in [0,1]^d: normal·x < offset}; None where rounding would spoil it.

    With k positive components after reflection, Σ_v (−1)^|v| (offset − n·v)_+^k / (k! Π n_i) over
    the corners v of the cube (Barrow and Smith, Amer. Math. Monthly 86,
    1979). The terms cancel: the relative rounding is checked.
    """
    level = offset - np.minimum(normal, 0.0).sum()
    n = np.abs(normal[normal != 0])
    if level <= 0 or level >= n.sum():
        return float(level > 0)
    if n.size > 16:
        return None
    low = min(level, n.sum() - level)
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=n.size)))
    terms = np.maximum(low - corners @ n, 0.0) ** n.size / (math.factorial(n.size) * n.prod())
    volume = float((terms * (-1.0) ** corners.sum(axis=-1)).sum())
    if np.finfo(float).eps * n.size * terms.sum() > _CONDITION * volume:
        return None
    return volume if level == low else 1.0 - volume


def half_plane_fourier(m: Array, normal: Array, offset: float) -> Array:
    """Coefficients of the indicator of normal·x < offset on the unit square, m (..., 2).

    The region is {x_k < α + β x_j} or its complement, with k the axis on which the normal is larger,
    so that |β| ≤ 1; where the line is inside, x_j in [a, b], the integral along x_k is exact and
    what is left is one of exp(−2πi (m_j + β m_k) x_j), regular also where m is normal to the line.
    """
    k = int(np.argmax(np.abs(normal)))
    mj, mk = m[..., 1 - k], m[..., k]
    alpha, beta = float(offset / normal[k]), float(-normal[1 - k] / normal[k])
    a, b = (0.0, 1.0) if beta == 0 else np.clip(sorted((-alpha / beta, (1 - alpha) / beta)), 0, 1)
    if beta == 0 and not 0 < alpha < 1:
        a = b = 0.0
    full = _where_full(alpha, beta)
    below = _under_line(mj, mk, alpha, beta, float(a), float(b))
    below += np.where(mk == 0, interval_fourier(mj, *full), 0.0)
    whole = ((mj == 0) & (mk == 0)).astype(float)
    return np.asarray(below if normal[k] > 0 else whole - below)


def _where_full(alpha: float, beta: float) -> tuple[float, float]:
    """The interval of x in [0,1] where α + βx ≥ 1."""
    if beta == 0:
        return (0.0, 1.0) if alpha >= 1 else (0.0, 0.0)
    cross = min(max((1.0 - alpha) / beta, 0.0), 1.0)
    return (cross, 1.0) if beta > 0 else (0.0, cross)


def _under_line(mj: Array, mk: Array, alpha: float, beta: float, a: float, b: float) -> Array:
    """∫_a^b ∫_0^{α+βx} exp(−2πi (m_j x + m_k y)) dy dx for integer m_j, m_k."""
    flat = mk == 0
    safe = np.where(flat, 1.0, mk)
    edge = np.exp(-2j * np.pi * mk * alpha) * interval_fourier(mj + beta * mk, a, b)
    base = interval_fourier(mj, a, b)
    tilted = (base - edge) / (2j * np.pi * safe)
    return np.where(flat, alpha * base + beta * _ramp_fourier(mj, a, b), tilted)


def _ramp_fourier(m: Array, a: float, b: float) -> Array:
    """∫_a^b x exp(−2πi m x) dx for integer m, by parts."""
    zero = m == 0
    c = 2j * np.pi * np.where(zero, 1.0, m)
    at_a, at_b = np.exp(-c * a), np.exp(-c * b)
    return np.where(zero, 0.5 * (b * b - a * a), (a * at_a - b * at_b) / c + (at_a - at_b) / c**2)
