"""Area-preserving maps between the unit square and the disk or the sphere, in polar coordinates.

A point of the unit disk is (ρ, turn), a direction (θ/π, turn), with turn = φ/2π in [0,1]. Maps to the
disk keep area but for the factor π, those to the sphere but for 4π.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["DISK_MAPS", "SPHERE_MAPS", "WARPS"]

_Pair = tuple[Array, Array]


def _polar_to_disk(u: Array) -> _Pair:
    """turn = u_0, ρ² = u_1: distorts without bound at the centre; the seam is a jump of x."""
    return np.sqrt(u[..., 1]), u[..., 0]


def _polar_from_disk(radius: Array, turn: Array) -> Array:
    return np.stack([turn, radius**2], axis=-1)


def _concentric_to_disk(u: Array) -> _Pair:
    """Squares about the centre to circles (Shirley & Chiu 1997), distorting by at most 4/π."""
    a, b = 2.0 * u[..., 0] - 1.0, 2.0 * u[..., 1] - 1.0
    wide = np.abs(a) > np.abs(b)
    long, short = np.where(wide, a, b), np.where(wide, b, -a)
    local = np.divide(short, long, out=np.zeros_like(long), where=long != 0)
    quarter = np.where(wide, 0.0, 0.25) + np.where(long < 0, 0.5, 0.0)
    return np.abs(long), (quarter + local / 8.0) % 1.0


def _concentric_from_disk(radius: Array, turn: Array) -> Array:
    quarter = np.rint(4.0 * turn)
    local = radius * (8.0 * (turn - quarter / 4.0))
    index = quarter.astype(np.int64) % 4
    a = np.choose(index, [radius, -local, -radius, local])
    b = np.choose(index, [local, radius, -local, -radius])
    return np.asarray(0.5 * (np.stack([a, b], axis=-1) + 1.0))


def _polar_to_sphere(u: Array) -> _Pair:
    """turn = u_0, sin²(θ/2) = u_1: separable on the lat-long square."""
    half = np.sqrt(np.minimum(u[..., 1], 1.0 - u[..., 1]))
    theta = 2.0 / np.pi * np.arcsin(half)
    return np.where(u[..., 1] > 0.5, 1.0 - theta, theta), u[..., 0]


def _polar_from_sphere(theta: Array, turn: Array) -> Array:
    share = np.sin(0.5 * np.pi * np.minimum(theta, 1.0 - theta)) ** 2
    return np.stack([turn, np.where(theta > 0.5, 1.0 - share, share)], axis=-1)


def _octahedral_to_sphere(u: Array) -> _Pair:
    """The square folded to an octahedron, equal areas (Clarberg 2008): one pole at the corners."""
    a, b = np.abs(2.0 * u[..., 0] - 1.0), np.abs(2.0 * u[..., 1] - 1.0)
    lower = a + b > 1.0
    radius = np.where(lower, (1.0 - a) + (1.0 - b), a + b)
    ratio = np.divide(b - a, radius, out=np.zeros_like(radius), where=radius != 0)
    turn = (np.clip(ratio, -1.0, 1.0) + 1.0) / 8.0
    turn = np.where(u[..., 0] < 0.5, 0.5 - turn, turn)
    turn = np.where(u[..., 1] < 0.5, -turn, turn) % 1.0
    theta = 2.0 / np.pi * np.arcsin(radius / np.sqrt(2.0))
    return np.where(lower, 1.0 - theta, theta), turn


def _octahedral_from_sphere(theta: Array, turn: Array) -> Array:
    lower = theta > 0.5
    radius = np.sqrt(2.0) * np.sin(0.5 * np.pi * np.where(lower, 1.0 - theta, theta))
    below, left = turn > 0.5, np.abs(turn - 0.5) < 0.25
    folded = np.where(below, 1.0 - turn, turn)
    folded = np.where(left, 0.5 - folded, folded)
    # Of |a| and |b|: their sum is the radius, or 2 − radius, their difference radius·ratio
    b = 4.0 * radius * folded
    a = radius - b
    a, b = np.where(lower, 1.0 - b, a), np.where(lower, 1.0 - a, b)
    signed = np.stack([np.where(left, -a, a), np.where(below, -b, b)], axis=-1)
    return np.asarray(0.5 * (signed + 1.0))


WARPS = ("polar", "concentric")

DISK_MAPS: Mapping[str, tuple[Callable[[Array], _Pair], Callable[[Array, Array], Array]]] = {
    "polar": (_polar_to_disk, _polar_from_disk),
    "concentric": (_concentric_to_disk, _concentric_from_disk),
}
"""Square to (ρ, turn) of the unit disk, and back."""

SPHERE_MAPS: Mapping[str, tuple[Callable[[Array], _Pair], Callable[[Array, Array], Array]]] = {
    "polar": (_polar_to_sphere, _polar_from_sphere),
    "concentric": (_octahedral_to_sphere, _octahedral_from_sphere),
}
"""Square to (θ/π, turn) of the sphere, and back."""
