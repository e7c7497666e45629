"""Mitsuba's samplers: their counts, their points, and no side effects on the renderer."""

import math

import numpy as np
import pytest
from tests.processes import python

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.quality.nets import net_t_value
from mcspectra.rendering.backend import import_mitsuba
from mcspectra.rendering.point_sampler import MitsubaSampler
from mcspectra.samplers import sampler

pytestmark = pytest.mark.render

NAMES = ["independent", "stratified", "multijitter", "orthogonal", "ldsampler"]


@pytest.mark.parametrize("name", NAMES)
def test_counts_are_the_ones_that_mitsuba_does_not_round(name):
    mitsuba = import_mitsuba()
    mitsuba.set_log_level(mitsuba.LogLevel.Error)  # Mitsuba otherwise reports every rounding
    source = MitsubaSampler(sampler=name)
    possible = [n for n in range(1, 257) if source._source(n).sample_count() == n]
    for n in range(1, 120):
        below, above = source._counts_near(n)
        assert below == max((c for c in possible if c <= n), default=None)
        assert above == min(c for c in possible if c >= n)


def test_impossible_counts_name_the_nearest():
    with pytest.raises(CountError, match="nearest counts are 9 and 25"):
        MitsubaSampler(sampler="orthogonal").draw(16)
    with pytest.raises(CountError, match="nearest count is 4"):
        MitsubaSampler(sampler="ldsampler").draw(1)
    with pytest.raises(CountError, match="at most 1048576 points"):
        MitsubaSampler().draw(2**21)


def test_stratified_has_one_point_in_each_cell():
    points = sampler("mitsuba(sampler='stratified')", 2).draw(36, realizations=20, rng=1)
    cells = np.sort(np.floor(points * 6) @ [6, 1], axis=1)
    assert (cells == np.arange(36)).all()


@pytest.mark.parametrize(("name", "n"), [("multijitter", 20), ("orthogonal", 25)])
def test_one_point_in_each_nth_of_an_axis(name, n):
    points = MitsubaSampler(sampler=name).draw(n, realizations=20, rng=1)
    # float32: a point at the center of its stratum is far from borders; others may not be
    middles = MitsubaSampler(sampler=name, jitter=False).draw(n, realizations=20, rng=1)
    for axis in (0, 1):
        assert (np.sort(np.floor(middles[..., axis] * n), axis=1) == np.arange(n)).all()
    assert not np.array_equal(points, middles)


def test_ldsampler_pairs_are_nets():
    for points in MitsubaSampler(sampler="ldsampler", dims=4).draw(64, realizations=10, rng=1):
        assert net_t_value(points[:, :2]) == 0
        assert net_t_value(points[:, 2:]) == 0


@pytest.mark.parametrize("dims", [1, 3])
def test_dims_are_drawn_as_pairs_then_one(dims):
    source = MitsubaSampler(sampler="independent", dims=dims)
    flat = MitsubaSampler(sampler="independent", dims=1).draw(8 * dims, rng=1)
    np.testing.assert_array_equal(source.draw(8, rng=1).ravel(), flat.ravel())


def test_nearby_realizations_are_independent():
    means = MitsubaSampler(sampler="independent").draw(16, realizations=2000, rng=1).mean((1, 2))
    scaled = (means - 0.5) * math.sqrt(12 * 32)
    correlation = float(np.mean(scaled[1:] * scaled[:-1]))
    assert abs(correlation) < 5 / math.sqrt(1999)
    assert abs(scaled.var() - 1) < 5 * math.sqrt(2 / 2000)


def test_stratified_variance_rate():
    # On a disk, the variance of jittered points falls as n^(−3/2) (Mitchell 1996).
    curve = mcs.convergence(
        mcs.Estimator("disk", dims=2),
        MitsubaSampler(sampler="stratified"),
        [16, 64, 256],
        realizations=200,
        rng=1,
    )
    low, high = curve["rate_ci"].values
    assert low < -1.5 < high


_PROGRAM = """
import mcspectra as mcs
pixel, points = "pixel(x=100, y=100)", mcs.sampler("mitsuba", 2)
{steps}
print(value, again, points.draw(4, rng=1).sum().hex())
"""
_PIXEL = "value = float(mcs.integrand(pixel)([[0.3, 0.4]])[0])"
_DRAW = "points.draw(4, rng=1)"


def test_points_drawn_between_pixels_disturb_nothing():
    """The slow test below has new processes, in either order."""
    points, pixel = mcs.sampler("mitsuba", 2), mcs.integrand("pixel(x=100, y=100)")
    first, value = points.draw(4, rng=1), pixel([[0.3, 0.4]])
    again = points.draw(4, rng=1)
    np.testing.assert_array_equal(again, first)
    np.testing.assert_array_equal(pixel([[0.3, 0.4]]), value)


@pytest.mark.slow
def test_points_and_pixels_do_not_disturb_each_other_in_either_order():
    outputs = set()
    for steps in (
        f"{_PIXEL}; {_DRAW}; again = value; {_PIXEL}",
        f"{_DRAW}; {_PIXEL}; again = value",
    ):
        run = python("-c", _PROGRAM.format(steps=steps), check=True)
        outputs.add(run.stdout)
    assert len(outputs) == 1


def test_the_variant_does_not_change():
    mitsuba = import_mitsuba()
    before = mitsuba.variant()
    sampler("mitsuba", 3).draw(4)
    assert mitsuba.variant() == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"sampler": "sobol"}, "it must be one of independent"),
        ({"sampler": 3}, "sampler is 3"),
        ({"dims": 1025}, "dims is 1025"),
        ({"jitter": "no"}, "jitter is 'no'"),
        ({"jitter": 1}, "jitter is 1"),
        ({"sampler": "independent", "jitter": False}, "jitter is False; give True or, with"),
    ],
)
def test_bad_parameters(arguments, words):
    with pytest.raises(ParameterError, match=words):
        MitsubaSampler(**arguments)
