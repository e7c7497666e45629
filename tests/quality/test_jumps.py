"""Jumps between cells: positions and lengths; slopes, roots and poles are not jumps."""

import numpy as np
import pytest

from mcspectra.quality.jumps import curve_length, find_jumps, grid_centers


def scalar(function):
    return lambda x: np.asarray(function(x), float)[..., None]


def found(function, dims=1, side=64, scale=1.0):
    return find_jumps(scalar(function), dims, side, scale=scale)


@pytest.mark.parametrize("height", [1.0, -0.3, 1e-4, 1e6])
@pytest.mark.parametrize("at", [0.1, 0.5, 0.987])
def test_a_step(at, height):
    jumps = found(lambda x: np.where(x[:, 0] < at, 0.0, height), scale=abs(height))
    cell = int(at * 64 - 0.5)
    expected = np.zeros((1, 64))
    expected[0, cell] = abs(height)
    np.testing.assert_allclose(jumps.heights, expected)
    assert jumps.length == 1
    assert jumps.mean_height == pytest.approx(abs(height))
    assert not jumps.poles.any()


def test_a_step_on_a_slope():
    """The error of the height is the slope over 2^-30 of a cell."""
    for height in (0.1, 0.001):
        jumps = found(lambda x, height=height: 3 * x[:, 0] + height * (x[:, 0] > 1 / 3))
        assert np.count_nonzero(jumps.heights) == 1
        assert jumps.heights.max() == pytest.approx(height, abs=3 / 64 / 2**26)


@pytest.mark.parametrize(
    "function",
    [
        lambda x: 1 + 0 * x,
        lambda x: 50 * x,
        lambda x: np.sin(200 * x),
        np.sqrt,
        lambda x: np.abs(x - 0.4),
        lambda x: np.abs(x - 0.4) ** 0.3,
        lambda x: np.tanh((x - 0.5) * 1e4),
    ],
)
def test_continuous_functions_have_no_jumps(function):
    jumps = found(lambda x: function(x[:, 0]))
    assert not jumps.heights.any()
    assert jumps.length == 0
    assert jumps.mean_height == 0


def test_a_pole_at_an_edge():
    jumps = found(lambda x: np.maximum(x[:, 0] - 0.4, 1e-30) ** -0.5 * (x[:, 0] > 0.4))
    assert np.argwhere(jumps.poles).tolist() == [[0, int(0.4 * 64 - 0.5)]]


def test_lines_and_circles():
    """Lengths are exact for axis-parallel lines, and within a few percent for circles."""
    side = 256
    across = found(lambda x: x[:, 0] > 0.3, 2, side)
    assert across.length == 1.0
    assert not across.heights[1].any()
    both = found(lambda x: 1.0 * (x[:, 1] > 0.3) + 2.0 * (x[:, 1] > 0.8), 2, side)
    assert both.length == 2.0
    assert both.mean_height == pytest.approx(1.5)
    slanted = found(lambda x: x[:, 0] + 0.37 * x[:, 1] > 0.6, 2, side)
    assert slanted.length == pytest.approx(np.hypot(1, 0.37), rel=0.02)
    circle = found(lambda x: np.hypot(*(x - 0.5).T) < 0.3, 2, side)
    assert circle.length == pytest.approx(2 * np.pi * 0.3, rel=0.03)


def test_the_largest_change_of_a_vector_counts():
    jumps = find_jumps(lambda x: np.where(x < 0.5, 0.0, [[3.0, 4.0]]), 2, 16, scale=1.0)
    assert set(np.unique(jumps.heights)) == {0.0, 3.0, 4.0}


def test_curve_length_of_marked_intervals():
    crossed = np.zeros((2, 20, 20), bool)
    assert curve_length(crossed) == 0
    crossed[0, 7] = True
    assert curve_length(crossed) == pytest.approx(1.0)
    assert curve_length(np.ones((1, 5), bool)) == 5


def test_centers():
    np.testing.assert_array_equal(grid_centers(2, 1), [[0.25], [0.75]])
    np.testing.assert_array_equal(grid_centers(2, 2)[1, 0], [0.75, 0.25])
