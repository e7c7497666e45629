"""Rotations: symmetries exactly, what they keep, and the window's distances and uniformity."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.distance import pdist

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import Jittered, RandomRotation, Rank1Lattice, Sobol, Structure

LEVEL = 1 - (1 - 1e-6) ** (1 / 8)  # Šidák: 8 statistical tests in this file share 1e-6
BELOW_ONE = np.nextafter(1.0, 0.0)
CLIPPED = RandomRotation(boundary="clipped")
STREAM = Stream.from_rng(7)


def toroidal_distances(points):
    """Sorted distances of all pairs of (n, d) points."""
    difference = points[:, None] - points[None]
    difference -= np.rint(difference)
    upper = np.triu_indices(len(points), 1)
    return np.sort(np.linalg.norm(difference, axis=-1)[upper])


@pytest.mark.parametrize("dims", [1, 2, 3])
def test_all_symmetries_of_the_cube_are_equally_likely(dims):
    point = np.array([0.1, 0.2, 0.3])[:dims]
    images = [
        tuple(np.where(signs, BELOW_ONE - point[list(order)], point[list(order)]))
        for order in itertools.permutations(range(dims))
        for signs in itertools.product((False, True), repeat=dims)
    ]
    moved = RandomRotation().apply(np.tile(point, (9600, 1, 1)), STREAM, 0)[:, 0]
    counts = np.array([(moved == image).all(axis=1).sum() for image in images])
    assert counts.sum() == 9600
    assert stats.chisquare(counts).pvalue > LEVEL


@pytest.mark.parametrize("spec", ["poisson-disk", "random", "rank1-lattice", "sobol"])
@pytest.mark.parametrize("dims", [2, 3])
def test_toroidal_distances_are_kept(spec, dims):
    source = mcs.sampler(spec, dims)
    plain = source.draw(32, realizations=5, rng=1)
    moved = source.then(RandomRotation()).draw(32, realizations=5, rng=1)
    for before, after in zip(plain, moved, strict=True):
        np.testing.assert_allclose(
            toroidal_distances(after), toroidal_distances(before), atol=8 * 2.0**-53
        )


def test_lattices_stay_lattices():
    """Differences of lattice points are lattice points: the set of them has n elements."""
    points = Rank1Lattice(dims=3).then(RandomRotation()).draw(31, realizations=10, rng=2)
    for p in points:
        steps = np.rint((p[:, None] - p[None]) * 31).astype(int) % 31
        assert len(np.unique(steps.reshape(-1, 3), axis=0)) == 31


@pytest.mark.parametrize("sides", [4, 7])
def test_strata_are_kept(sides):
    points = Jittered(dims=2).then(RandomRotation()).draw(sides**2, realizations=40, rng=3)
    cells = np.sort(np.floor(points * sides) @ [sides, 1], axis=1)
    np.testing.assert_array_equal(cells, np.tile(np.arange(sides**2), (40, 1)))


def test_elementary_intervals_are_kept():
    points = Sobol(dims=2).then(RandomRotation()).draw(64, realizations=40, rng=3)
    for k in range(7):
        cells = np.floor(points * [2**k, 2 ** (6 - k)]) @ [2 ** (6 - k), 1]
        np.testing.assert_array_equal(np.sort(cells, axis=1), np.tile(np.arange(64), (40, 1)))


@pytest.mark.parametrize("step", [RandomRotation(), CLIPPED], ids=lambda step: step.spec)
def test_results_stay_below_one_at_the_edges(step):
    edges = np.array([0.0, 5e-324, 0.5, BELOW_ONE])
    points = np.stack(np.meshgrid(edges, edges), axis=-1).reshape(1, -1, 2)
    moved = step.apply(np.tile(points, (2000, 1, 1)), STREAM, 0)
    assert moved.min() >= 0.0
    assert moved.max() < 1.0


@pytest.mark.parametrize("n", [1, 2, 9, 64])
def test_the_window_shows_the_turned_plane(n):
    """Slow reference: 49 copies of the set in complex numbers, the n nearest to the centre.

    The numbers of a realisation are the centre, the angle and the final translation.
    """
    plain = mcs.sampler("random", 2).draw(n, realizations=20, rng=5)
    moved = CLIPPED.apply(plain, STREAM, 0)
    shifts = [complex(i, j) for i in range(-3, 4) for j in range(-3, 4)]
    for points, seen, numbers in zip(plain, moved, STREAM.uniforms(0, 20, 5), strict=True):
        center, turn = complex(*numbers[:2]), np.exp(2j * np.pi * numbers[2])
        copies = np.concatenate([points @ [1, 1j] + shift for shift in shifts])
        turned = (copies - center) * turn
        norms = np.maximum(np.abs(turned.real), np.abs(turned.imag))
        nearest = np.argsort(norms)
        window = turned[nearest[:n]] / (2 * norms[nearest[n]]) + complex(0.5, 0.5)
        x = (np.stack([window.real, window.imag], axis=1) + numbers[3:]) % 1.0
        np.testing.assert_allclose(seen[np.argsort(seen[:, 0])], x[np.argsort(x[:, 0])], atol=1e-13)


def test_a_turned_grid_keeps_its_angles():
    """Seen without the final translation, all neighbours of a square grid are at right angles."""
    points = mcs.sampler("regular", 2).draw(64, realizations=20, rng=5)
    moved = (CLIPPED.apply(points, STREAM, 0) - STREAM.uniforms(0, 20, 5)[:, None, 3:]) % 1.0
    angles = []
    for p in moved:
        step = p[:, None] - p[None]
        length = np.hypot(step[..., 0], step[..., 1]) + np.eye(64)
        near = step[length < 1.2 * length.min()]
        directions = np.arctan2(near[:, 1], near[:, 0]) * 4
        angles.append(directions[0] % (2 * np.pi) / 4)
        np.testing.assert_allclose(np.exp(1j * (directions - directions[0])), 1.0, atol=1e-9)
        np.testing.assert_allclose(np.hypot(near[:, 0], near[:, 1]), length.min(), rtol=1e-9)
    assert np.ptp(angles) > 0.5


def test_windows_hold_n_different_points_of_the_set():
    """Undoing nothing: the scale is near 1, so that least distances shrink or grow by little."""
    source = mcs.sampler("poisson-disk", 2)
    for n in (1, 2, 3, 10, 200):
        plain = source.draw(n, realizations=10, rng=6)
        moved = CLIPPED.apply(plain, STREAM, 0)
        assert len(np.unique(moved.reshape(-1, 2), axis=0)) == 10 * n
    inside = [p[(np.abs(p - 0.5) < 0.5).all(axis=1)] for p in moved]
    assert np.median([pdist(p).min() for p in inside]) < np.median(
        [toroidal_distances(p)[0] for p in plain]
    ) * np.sqrt(200 / 150)


def test_coinciding_points_are_seen_as_often():
    doubled = np.repeat(Jittered(dims=2).draw(16, realizations=50, rng=1), 2, axis=1)
    moved = CLIPPED.apply(doubled, STREAM, 0)
    assert moved.shape == doubled.shape
    assert all(16 <= len(np.unique(p, axis=0)) <= 17 for p in moved)


@pytest.mark.parametrize("spec", ["regular", "jittered", "halton"])
def test_clipped_points_are_uniform(spec):
    points = mcs.sampler(f"{spec} | random-rotation(boundary='clipped')", 2).draw(
        4, realizations=6400, rng=9
    )
    cells = (np.floor(points[:, 3] * 8) @ [8, 1]).astype(int)
    assert stats.chisquare(np.bincount(cells, minlength=64)).pvalue > LEVEL


def test_declared_properties():
    turned, clipped = Sobol(dims=2).then(RandomRotation()), Sobol(dims=2).then(CLIPPED)
    assert (turned.unbiased, clipped.unbiased) == (False, True)
    assert (turned.structure, clipped.structure) == (Structure.DIGITS, Structure.TORUS)
    assert Jittered(dims=2).then(RandomRotation()).structure is Structure.STRATA
    assert Jittered(dims=2).then(CLIPPED).structure is Structure.TORUS
    assert (RandomRotation().stationary, CLIPPED.stationary) == (False, True)


@pytest.mark.parametrize("dims", [1, 3])
def test_windows_are_two_dimensional(dims):
    with pytest.raises(ParameterError, match="needs 2 dims"):
        Jittered(dims=dims).then(CLIPPED)


@pytest.mark.parametrize("boundary", ["any", None, True, 1])
def test_bad_boundaries(boundary):
    with pytest.raises(ParameterError, match="toroidal, clipped"):
        RandomRotation(boundary=boundary)
