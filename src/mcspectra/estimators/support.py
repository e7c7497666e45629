"""Search for a region in which f is not 0 but the density is, by evaluations at probes.

All probes are the same in each run:

* 4096 points of an additive recurrence; in 1-D also the centers of 8192 cells;
* points next to faces and corners, at distances 2^-4, 2^-8 and 2^-12;
* known zeros of the densities (empty cells of tables at any position);
* landmarks of integrands: both sides of their breaks, and the brightest pixels of an image;
* gaps of the warps of 1-D densities, and of the 1-D parts of products and mixtures.
  A warp x = T(u) has a gap if x jumps across an interval in which p = 0.
  In each of 1024 intervals of u, bisection finds the largest jump. Jumps above 2^-30 count.

A density may be 0 at single points, such as a power at 0 or a tent at its ends.
No probe lies at such isolated zeros of a density.
In 2-D and more, regions that contain no probe are missed.
The search also misses a gap of the density if the warp has no gap there.
`mcspectra.densities.NumericalDensity` computes a warp from a pdf.
The computed warp has a gap wherever the density is 0 on an interval wider than 2^-18.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import DensityError, point_in_words
from mcspectra.densities import Density, Mixture, Product
from mcspectra.integrands import Integrand

__all__ = ["check_support", "probe_points", "uncovered"]

_PROBES = 4096
_CELLS = 8192
# Distances of probes from faces and corners. At smaller distances, steep powers underflow to 0
_NEAR = (2.0**-4, 2.0**-8, 2.0**-12)
_FACES = 512
_MOST_CORNERS = 4  # dims
_BESIDE = 2.0**-30
_INTERVALS = 1024
_BISECTIONS = 32


def check_support(integrand: Integrand, densities: Sequence[Density]) -> None:
    """Raise an error if every density is 0 at a probe where f is not 0.

    Raises
    ------
    DensityError
        If f is not 0 at a probe where all densities are 0; the message gives the position.
    """
    x = uncovered(integrand, densities)
    if not len(x):
        return
    missed = np.asarray(integrand(x)).reshape(len(x), -1).any(axis=1)
    if missed.any():
        where = point_in_words(x[missed][0])
        names = " and ".join(density.spec for density in densities)
        raise DensityError(
            f"{names} is 0 at {where}, where {integrand.spec} is not: the estimate would miss "
            "that part; choose a density that is positive wherever f is not 0."
        )


def uncovered(integrand: Integrand, densities: Sequence[Density]) -> Array:
    """Return the probes (k, d) at which every density is 0. This does not call f."""
    dims = integrand.dims
    found = [probe_points(dims)]

    # Add points next to faces, one axis after another. In few dims, add points next to the corners
    points, k, near = found[0][:_FACES].copy(), np.arange(_FACES), np.resize(_NEAR, _FACES)
    points[k, k % dims] = np.where(k // dims % 2 == 0, near, 1.0 - near)
    found.append(points)
    if dims <= _MOST_CORNERS:
        ends = [[e, 1.0 - e] for e in _NEAR]
        found += [np.array(list(itertools.product(pair, repeat=dims))) for pair in ends]
    if dims == 1:
        found.append(((np.arange(_CELLS) + 0.5) / _CELLS)[:, None])

    # Add points on both sides of every break of f. Probe points give the other coordinates.
    # Also add the landmarks of f, which are points in small regions where f may differ from 0
    found.append(integrand.landmarks())
    for axis, breaks in enumerate(integrand.breaks):
        sides = np.array([*np.subtract(breaks, _BESIDE), *np.add(breaks, _BESIDE)])
        sides = sides[(sides >= 0) & (sides < 1)]
        points = np.resize(found[0], (len(sides), dims))
        points[:, axis] = sides
        found.append(points)

    # Add gaps of the warps and known zeros of the densities
    found += [_gaps(density) for density in densities]
    found += [density.zero_points() for density in densities]
    x = np.concatenate(found)
    covered = sum((density.pdf(x) for density in densities), np.zeros(len(x))) > 0
    return np.asarray(x[~covered])


def probe_points(dims: int, count: int = _PROBES) -> Array:
    """Return points (count, dims) off all grid lines: multiples of square roots, modulo 1."""
    primes = np.array([2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59, 61, 67, 71])
    steps = np.sqrt(np.resize(primes, dims) + np.arange(dims) // primes.size)
    return np.asarray((0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0)


def _gaps(density: Density) -> Array:
    """Return points in gaps of a 1-D warp, or of 1-D parts of a product or mixture.

    Each point is the middle of the largest step of x = T(u) in one of 1024 intervals of u.
    Each interval is halved 32 times: the half in which x moves more is kept.
    At a jump, x moves by the width of the gap; elsewhere, the movement goes to zero.
    """
    if isinstance(density, Product):
        return density.lifted([_gaps(part) for part in density.parts])
    if isinstance(density, Mixture):
        return np.concatenate([_gaps(part) for part in density.parts])
    if density.dims > 1 or not density.one_to_one:
        return np.empty((0, density.dims))
    u = np.linspace(0.0, 1.0, _INTERVALS + 1)[:, None]
    x = density.sample(u)
    low, high, x_low, x_high = u[:-1], u[1:], x[:-1], x[1:]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        x_middle = density.sample(middle)
        left = np.abs(x_middle - x_low) > np.abs(x_high - x_middle)
        low, high = np.where(left, low, middle), np.where(left, middle, high)
        x_low, x_high = np.where(left, x_low, x_middle), np.where(left, x_middle, x_high)
    wide = np.abs(x_high - x_low)[:, 0] > _BESIDE
    return np.asarray(0.5 * (x_low + x_high)[wide])
