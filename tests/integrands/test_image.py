"""Images: orientation, files, channels, coefficients at every frequency."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.integrands import Image

L_SHAPE = np.array([[1.0, 0.0, 0.0], [1.0, 2.0, 3.0]])  # two rows, three columns


def test_orientation():
    """x_0 runs to the right along the width, x_1 down from the top row."""
    f = Image(values=L_SHAPE)
    assert f(np.array([0.99, 0.01])) == 0  # top right
    assert f(np.array([0.99, 0.99])) == 3  # bottom right
    assert f(np.array([0.01, 0.01])) == 1  # top left
    centres = np.array([[[(c + 0.5) / 3, (r + 0.5) / 2] for c in range(3)] for r in range(2)])
    assert np.array_equal(f(centres), L_SHAPE)
    assert f.breaks == ((1 / 3, 2 / 3), (0.5,))
    # Brighter to the right and below: f_(1,0) of Σ_c mean_c and f_(0,1) of the row means
    columns, rows = L_SHAPE.mean(axis=0), L_SHAPE.mean(axis=1)
    for m, means in (((1, 0), columns), ((0, 1), rows)):
        edges = np.arange(means.size + 1) / means.size
        waves = np.diff(np.exp(-2j * np.pi * edges)) / (-2j * np.pi)
        assert abs(f.fourier([m])[0] - means @ waves) < 1e-15


@pytest.mark.parametrize("shape", [(1, 1), (5, 4), (4, 5), (3, 8, 2)])
def test_coefficients_pixel_by_pixel(shape):
    rng = np.random.default_rng(3)
    values = rng.normal(size=shape)
    f = Image(values=values)
    height, width = shape[:2]
    m = np.array([[0, 0], [1, -2], [width, 3], [0, height], [-3 * width + 1, 7], [1000, -777]])

    def pixel_waves(size, frequency):
        edges = np.arange(size + 1) / size
        waves = np.exp(-2j * np.pi * frequency[:, None] * edges)
        safe = np.where(frequency == 0, 1, frequency)[:, None]
        found = np.diff(waves, axis=1) / (-2j * np.pi * safe)
        return np.where(frequency[:, None] == 0, 1 / size, found)

    across, down = pixel_waves(width, m[:, 0]), pixel_waves(height, m[:, 1])
    expected = np.einsum("kc,kr,rc...->k...", across, down, values)
    # Phases are of size 2π|m|: their rounding is that many ulps.
    assert np.abs(f.fourier(m) - expected).max() < 2 * np.pi * 1000 * np.finfo(float).eps


def test_many_pixels_have_no_breaks_but_box_moments():
    values = np.random.default_rng(4).random((65, 3))
    f = Image(values=values)
    assert f.breaks == ((1 / 3, 2 / 3), ())
    low, high = np.array([1 / 3, 7 / 65]), np.array([2 / 3, 9.5 / 65])
    mean, square = f.box_moments(low, high)
    column, weight = values[7:10, 1], np.array([1, 1, 0.5]) / 2.5
    assert mean == pytest.approx(weight @ column, rel=1e-12)
    assert square == pytest.approx(weight @ column**2, rel=1e-12)


def test_channels():
    values = np.random.default_rng(5).random((4, 6, 3))
    x = np.random.default_rng(6).random((20, 2))
    every = Image(values=values)
    assert every.channels == 3
    assert every(x).shape == (20, 3)
    for c in range(3):
        one = Image(values=values, channel=c)
        assert one.channels == 0
        assert np.array_equal(one(x), every(x)[:, c])
    gray = Image(values=values, channel="luminance")
    assert np.allclose(gray(x), every(x) @ [0.2126, 0.7152, 0.0722])
    single = Image(values=values[..., :1])
    assert single.channels == 0
    assert isinstance(single.integral, float)


def test_the_given_array_can_change():
    values = np.ones((2, 2))
    f = Image(values=values)
    values[:] = 7
    assert f.integral == 1


def test_files(tmp_path):
    from PIL import Image as Picture

    levels = np.array([[0, 255, 255], [255, 0, 0]], np.uint8)  # 0 and 1 in sRGB and linear
    Picture.fromarray(np.stack([levels, levels // 2, levels], axis=-1)).save(tmp_path / "a.png")
    spec = f"image(path={str(tmp_path / 'a.png')!r}, channel=0)"
    f = mcs.integrand(spec)
    assert f.spec == spec
    assert np.array_equal(f(np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]])), [0, 1, 1])
    assert f.integral == pytest.approx(0.5)
    np.save(tmp_path / "b.npy", L_SHAPE)
    g = Image(path=tmp_path / "b.npy")
    assert g.channels == 0
    assert np.array_equal(g.fourier_grid(3), Image(values=L_SHAPE).fourier_grid(3))


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({}, "either path"),
        ({"path": "a.png", "values": [[1]]}, "either path"),
        ({"path": 3}, "path is 3"),
        ({"values": [[1, np.nan]]}, "NaN"),
        ({"values": [1, 2]}, "(2,)"),
        ({"values": np.zeros((0, 4))}, "(0, 4)"),
        ({"values": [[1], [1, 2]]}, "array of numbers"),
        ({"values": [[1]], "channel": 1}, "channel is 1"),
        ({"values": [[1]], "channel": True}, "channel is True"),
        ({"values": np.ones((2, 2, 2)), "channel": "luminance"}, "luminance"),
        ({"values": [[1]], "channel": "red"}, "'red'"),
    ],
)
def test_refused(parameters, words):
    with pytest.raises(ParameterError) as caught:
        Image(**parameters)
    assert words in str(caught.value)


def test_a_missing_file(tmp_path):
    with pytest.raises(FileFormatError, match=r"none\.png"):
        Image(path=tmp_path / "none.png")
