"""Tables and pictures: cells, borders, orientation, breaks, and what they refuse."""

from __future__ import annotations

import math

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import mcspectra as mcs
from mcspectra.core.errors import DensityError, FileFormatError, ParameterError
from mcspectra.densities import ImageDensity, PiecewiseConstant


def centers(height, width):
    """Centers of pixels, (height, width, 2): x_0 over columns, x_1 over rows."""
    y, x = np.meshgrid(
        (np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij"
    )
    return np.stack([x, y], axis=-1)


def test_one_dimension_by_hand():
    p = mcs.density("piecewise-constant(values=[1, 3])")
    assert p.dims == 1
    np.testing.assert_array_equal(p.pdf([[0.2], [0.5], [0.9]]), [0.5, 1.5, 1.5])
    np.testing.assert_allclose(p.sample([[0.125], [0.25], [0.625]])[:, 0], [0.25, 0.5, 0.75])
    assert p.breaks == ((0.25,),)
    assert p.reciprocal_integral() == pytest.approx((1 / 0.5 + 1 / 1.5) / 2)


def test_two_dimensions_by_hand():
    """Rows hold 1/4 and 3/4; x_1 picks the row, x_0 the column in it."""
    p = mcs.density("piecewise-constant(values=[[1, 1], [0, 6]])", dims=2)
    np.testing.assert_array_equal(p.pdf(centers(2, 2)), [[0.5, 0.5], [0, 3]])
    np.testing.assert_allclose(p.sample([0.5, 0.125]), [0.5, 0.25])
    np.testing.assert_allclose(p.sample([0.5, 0.625]), [0.75, 0.75])
    assert p.breaks == ((), (0.25,))
    assert p.reciprocal_integral() == math.inf


def test_separable_tables_have_breaks_along_both_axes():
    p = PiecewiseConstant(values=np.outer([1, 3], [2, 2, 4]))
    assert p.breaks == ((0.5,), (0.25,))
    assert PiecewiseConstant(values=np.ones((4, 4))).breaks == ((), ())
    assert PiecewiseConstant(values=[1, 0, 0, 1]).breaks == ((0.5,),)


@pytest.mark.parametrize("cells", [3, 7, 10, 49, 613, 1000])
def test_every_border_belongs_to_one_cell(cells):
    """Samples at the ends of every cell are looked up in that cell, whatever i/k rounds to."""
    rng = np.random.default_rng(cells)
    weights = rng.random(cells) * (rng.random(cells) > 0.5) + 0.0
    weights[0] = 1.0
    p = PiecewiseConstant(values=weights)
    borders = np.concatenate([[0.0], np.cumsum(weights) / weights.sum()])
    near = np.concatenate([borders, np.nextafter(borders, 0), np.nextafter(borders, 1)])
    x = p.sample(near[(near >= 0) & (near < 1), None])
    assert (p.pdf(x) > 0).all()
    at = np.arange(cells)[:, None] / cells
    np.testing.assert_array_equal(p.pdf(at), weights / weights.mean())
    np.testing.assert_array_equal(p.pdf(np.nextafter(at[1:], 0)), (weights / weights.mean())[:-1])


def test_invert_gives_the_border_where_there_is_no_mass():
    p = PiecewiseConstant(values=[1, 0, 1])
    np.testing.assert_allclose(p.invert([[0.34], [0.5], [0.66]])[:, 0], 0.5)


def test_scale_does_not_matter():
    u = np.random.default_rng(1).random((100, 1))
    small, large = (
        PiecewiseConstant(values=np.array([1, 2, 0, 5]) * s) for s in (2.0**-1000, 2.0**1020)
    )
    np.testing.assert_array_equal(small.sample(u), large.sample(u))
    np.testing.assert_array_equal(small.pdf(u), large.pdf(u))


def test_arrays_are_copied_and_small_ones_shown():
    given = np.ones((20, 20))
    p = PiecewiseConstant(values=given)
    given[0, 0] = 1e9
    assert p.pdf([0.01, 0.01]) == 1
    assert p.spec == "piecewise-constant(values=<array 20x20>)"
    assert (
        PiecewiseConstant(values=np.array([1, 2])).spec == "piecewise-constant(values=[1.0, 2.0])"
    )


@pytest.mark.parametrize(
    "values",
    [
        [],
        [[]],
        [[], []],
        3,
        None,
        "12",
        ["1", "2"],
        [1, "a"],
        [[1, 2], [3]],
        [[[1.0]]],
        [0, 0],
        [1, -1],
        [1, math.nan],
        [1, math.inf],
        [1j, 2],
        {},
        [10**400],
    ],
)
def test_bad_tables(values):
    with pytest.raises(ParameterError, match=r"^values ") as caught:
        PiecewiseConstant(values=values)
    assert "\n" not in str(caught.value)


def test_tables_in_other_dims():
    with pytest.raises(ParameterError, match="for 1 dims, but 2"):
        mcs.density("piecewise-constant(values=[1, 2])", dims=2)
    with pytest.raises(ParameterError, match="needs values"):
        mcs.density("piecewise-constant")


PIXELS = np.array([[0, 51, 102], [153, 204, 255]], np.uint8)


@pytest.mark.parametrize("kind", ["png8", "png16", "exr", "npy"])
def test_pictures_of_known_pixels(tmp_path, kind):
    values = PIXELS / 255.0
    path = tmp_path / f"p.{kind.rstrip('0123456789')}"
    if kind == "png8":
        Image.fromarray(PIXELS).save(path)
    elif kind == "png16":
        Image.fromarray(PIXELS.astype(np.uint16) * 257).save(path)
    elif kind == "exr":
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"Y": values.astype(np.float32)}).write(str(path))
    else:
        np.save(path, values)
    p = ImageDensity(path=path, linear=True)
    precision = 1e-7 if kind == "exr" else 1e-14  # float32
    np.testing.assert_allclose(p.pdf(centers(2, 3)), values / values.mean(), rtol=precision)
    assert mcs.density(p.spec).pdf([0.9, 0.9]) == p.pdf([0.9, 0.9])


def test_jpeg_and_srgb(tmp_path):
    picture = np.kron([[0, 188], [188, 255]], np.ones((16, 16))).astype(np.uint8)
    Image.fromarray(picture).save(tmp_path / "p.jpg", quality=100)
    found = ImageDensity(path=tmp_path / "p.jpg").pdf(centers(2, 2))
    half = ((188 / 255 + 0.055) / 1.055) ** 2.4
    expected = np.array([[0, half], [half, 1]])
    np.testing.assert_allclose(found, expected / expected.mean(), atol=0.03)  # one step of 255


def test_channels_and_floor(tmp_path):
    colors = np.zeros((1, 2, 3))
    colors[0, 0] = [1, 0, 0]
    colors[0, 1] = [0, 3, 0]
    np.save(tmp_path / "c.npy", colors)
    row = centers(1, 2)[0]
    by = {c: ImageDensity(path=tmp_path / "c.npy", channel=c).pdf(row) for c in ("luminance", 0)}
    red, green = 0.2126, 3 * 0.7152
    np.testing.assert_allclose(by["luminance"], np.array([red, green]) * 2 / (red + green))
    np.testing.assert_array_equal(by[0], [2, 0])
    floored = ImageDensity(path=tmp_path / "c.npy", channel=0, floor=0.5)
    np.testing.assert_allclose(floored.pdf(row), [1.6, 0.4])  # 1 and ¼ over their mean
    assert math.isfinite(floored.reciprocal_integral())


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"path": "none.png"}, FileFormatError, "no file"),
        ({"path": None}, FileFormatError, "is not a path"),
        ({"channel": 3}, ParameterError, "channel is 3"),
        ({"channel": -1}, ParameterError, "channel is -1"),
        ({"channel": "red"}, ParameterError, "channel is 'red'"),
        ({"channel": 0.5}, ParameterError, "channel is 0.5"),
        ({"channel": None}, ParameterError, "channel is None"),
        ({"floor": -1}, ParameterError, "floor is -1"),
        ({"floor": math.nan}, ParameterError, "floor is nan"),
        ({"linear": 1}, ParameterError, "linear is 1"),
    ],
)
def test_bad_picture_options(tmp_path, options, error, says):
    np.save(tmp_path / "p.npy", np.ones((2, 2, 3)))
    with pytest.raises(error, match=says):
        ImageDensity(**{"path": tmp_path / "p.npy", **options})


@pytest.mark.parametrize(
    ("pixels", "error", "says"),
    [
        (np.zeros((2, 2)), DensityError, "black"),
        (np.array([[1.0, -1.0]]), DensityError, "1 negative"),
        (np.ones((2, 2, 4)), ParameterError, "channel instead"),
    ],
)
def test_bad_pictures(tmp_path, pixels, error, says):
    np.save(tmp_path / "p.npy", pixels)
    with pytest.raises(error, match=says):
        mcs.density(f"image(path={str(tmp_path / 'p.npy')!r})")
