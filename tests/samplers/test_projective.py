"""Projective blue noise: declared distances in every projection, uniform points, clear errors."""

from itertools import combinations

import numpy as np
import pytest
from scipy import stats
from scipy.spatial import cKDTree

from mcspectra.core.errors import CountError
from mcspectra.core.streams import Stream
from mcspectra.samplers import ProjectiveBlueNoise, sampler
from mcspectra.samplers.poisson import densest_distance

FALSE_ALARMS = 1e-6
CHECKS = 4  # number of statistical tests in this file
LEVEL = 1 - (1 - FALSE_ALARMS) ** (1 / CHECKS)  # Šidák
ROUNDING = 1e-12


def smallest_distances(points):
    """Return toroidal minimum distances of points (n, d) in projections on k axes, k = 1 … d."""
    dims = points.shape[1]
    smallest = np.full(dims, np.inf)
    for k in range(1, dims + 1):
        for axes in combinations(range(dims), k):
            tree = cKDTree(points[:, axes], boxsize=1.0)
            smallest[k - 1] = min(smallest[k - 1], tree.query(tree.data, k=2)[0][:, 1].min())
    return smallest


@pytest.mark.parametrize(
    ("dims", "n"), [(1, 50), (2, 2), (2, 3), (2, 400), (3, 5), (3, 150), (4, 60), (5, 30), (6, 20)]
)
def test_every_projection_keeps_the_declared_distance(dims, n):
    source = ProjectiveBlueNoise(dims=dims)
    radii = np.array(source.radii(n))
    for points in source.draw(n, realizations=4, rng=1):
        assert points.shape == (n, dims)
        assert (smallest_distances(points) >= radii * (1 - ROUNDING)).all()


def test_the_radii_are_tight():
    """Minimum distances come close to the declared radii, for every number of axes."""
    source = ProjectiveBlueNoise(dims=3)
    least = np.min([smallest_distances(x) for x in source.draw(300, realizations=4, rng=2)], axis=0)
    assert (least < 1.05 * np.array(source.radii(300))).all()


def test_radii_are_relative_to_the_densest_packings():
    source = sampler("projective-blue-noise(radius=0.3)", 3)
    expected = [0.3 / 50, 0.3 * np.sqrt(2 / np.sqrt(3) / 50), 0.3 * np.cbrt(np.sqrt(2) / 50)]
    assert source.radii(50) == pytest.approx(expected)
    assert source.radii(50)[2] == 0.3 * densest_distance(50, 3)


def test_the_law_equals_that_of_plain_dart_throwing():
    """For n = 2 the second point is uniform where allowed; cells of its offset from the first."""
    source = ProjectiveBlueNoise(radius_=0.4)
    points = source.draw(2, realizations=20_000, rng=3)
    gap = (points[:, 1] - points[:, 0]) % 1.0
    cells = (np.floor(gap * 10) @ [10, 1]).astype(int)
    one, two = source.radii(2)
    x = Stream(1).uniforms(0, 400_000, 2)
    short = np.minimum(x, 1 - x)
    allowed = x[(short.min(axis=1) >= one) & (np.hypot(*short.T) >= two)]
    expected = np.bincount((np.floor(allowed * 10) @ [10, 1]).astype(int), minlength=100)
    counts = np.bincount(cells, minlength=100)
    assert (counts[expected == 0] == 0).all()
    # With few expected counts the two-sample χ² test would be inaccurate
    full = expected > 200
    table = np.array([counts[full], expected[full]])
    assert stats.chi2_contingency(table).pvalue > LEVEL


@pytest.mark.parametrize("index", [0, 29])
def test_every_point_is_uniform(index):
    points = ProjectiveBlueNoise(dims=2).draw(30, realizations=10_000, rng=4)[:, index]
    counts = np.bincount((np.floor(points * 6) @ [6, 1]).astype(int), minlength=36)
    assert stats.chisquare(counts).pvalue > LEVEL


def test_functions_of_one_coordinate_gain_in_any_dims():
    """Distances along an axis give less variance than dart throwing."""
    n, realizations = 64, 400
    means = {
        name: sampler(name, 3).draw(n, realizations=realizations, rng=5)[..., 0].mean(axis=1)
        for name in ("projective-blue-noise", "dart-throwing")
    }
    ratio = means["projective-blue-noise"].var() / means["dart-throwing"].var()
    assert ratio < stats.f.isf(1 - LEVEL, realizations - 1, realizations - 1)


def test_a_set_without_room_is_an_error():
    with pytest.raises(CountError, match="no room for 100 points in 2 dims .* smaller radius") as e:
        sampler("projective-blue-noise(radius=0.95)").draw(100, rng=1)
    assert "\n" not in str(e.value)
    with pytest.raises(CountError, match="at most 4096 points, not 1000000"):
        ProjectiveBlueNoise().draw(10**6)
