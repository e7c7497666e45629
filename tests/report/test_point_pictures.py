"""Pictures of point sets: every point where it belongs, limits said, the same bytes again."""

import re

import numpy as np
import pytest
from PIL import Image

from mcspectra.core.errors import DomainError, FileFormatError, ParameterError
from mcspectra.report.point_pictures import point_picture, write_point_picture


def random_sets(count, n, dims):
    return np.random.default_rng(0).random((count, n, dims))


def offsets(axes):
    return np.asarray(axes.collections[0].get_offsets())


def caption(figure):
    return figure.texts[0].get_text()


def test_a_square_holds_all_points():
    x = random_sets(1, 50, 2)
    figure = point_picture(x[0], "random")
    np.testing.assert_array_equal(offsets(figure.axes[0]), x[0])
    box = figure.axes[0].get_position()
    width, height = figure.get_size_inches()
    assert box.width * width == pytest.approx(box.height * height)
    assert figure.axes[0].get_xlim() == figure.axes[0].get_ylim() == (0, 1)
    assert caption(figure) == "random"


@pytest.mark.parametrize(("count", "shown"), [(1, 1), (2, 2), (4, 4), (6, 6), (9, 6)])
@pytest.mark.parametrize("dims", [1, 2])
def test_sets_stand_side_by_side_up_to_a_limit(count, shown, dims):
    x = random_sets(count, 8, dims)
    figure = point_picture(x, "random")
    assert len(figure.axes) == shown
    assert caption(figure) == ("random" if shown == count else "random, 6 of 9 sets")
    if dims == 2:
        for axes, points in zip(figure.axes, x, strict=False):
            np.testing.assert_array_equal(offsets(axes), points)
    boxes = {tuple(axes.get_position().bounds) for axes in figure.axes}
    assert len(boxes) == shown
    assert all(x0 >= 0 and y0 >= 0 and x0 + w <= 1 and y0 + h <= 1 for x0, y0, w, h in boxes)


@pytest.mark.parametrize(("dims", "shown", "said"), [(3, 3, ""), (6, 6, ""), (9, 6, " of 9")])
def test_more_dims_are_a_matrix_of_projections(dims, shown, said):
    x = random_sets(2, 8, dims)
    figure = point_picture(x)
    pairs = [(i, j) for j in range(1, shown) for i in range(j)]
    for axes, (i, j) in zip(figure.axes, pairs, strict=True):
        np.testing.assert_array_equal(offsets(axes), x[0][:, [i, j]])
    assert caption(figure).startswith("1 of 2 sets")
    assert caption(figure).endswith(said)


@pytest.mark.parametrize("n", [1, 16, 1024, 65536])
def test_dots_neither_vanish_nor_touch(n):
    figure = point_picture(random_sets(1, n, 2))
    axes = figure.axes[0]
    diameter = np.sqrt(axes.collections[0].get_sizes()[0])
    spacing = 72 * figure.get_size_inches()[0] * axes.get_position().width / np.sqrt(n)
    assert 0.5 <= diameter <= 7
    assert diameter < 0.5 * spacing


def test_dark_pixels_lie_at_the_points(tmp_path):
    points = np.array([[0.25, 0.75], [0.6, 0.1]])
    write_point_picture(tmp_path / "p.png", points)
    pixels = np.asarray(Image.open(tmp_path / "p.png").convert("L"))
    box = point_picture(points).axes[0].get_position()
    height, width = pixels.shape
    for x, y in points:
        column = int((box.x0 + x * box.width) * width)
        row = int((1 - box.y0 - y * box.height) * height)
        assert pixels[row, column] < 80
    assert np.mean(pixels < 80) < 0.01


@pytest.mark.parametrize("extension", [".svg", ".png", ".pdf"])
def test_the_same_picture_has_the_same_bytes(tmp_path, extension):
    x = random_sets(1, 32, 2)
    files = [tmp_path / f"{k}{extension}" for k in "ab"]
    for file in files:
        write_point_picture(file, x, "random | $shift, ünïcode")
    assert files[0].read_bytes() == files[1].read_bytes()
    assert len(files[0].read_bytes()) > 1000


def test_many_points_are_an_image_within_the_svg(tmp_path):
    for n, inside in ((2**14, 0), (2**14 + 1, 1)):
        write_point_picture(tmp_path / "p.svg", random_sets(1, n, 2))
        text = (tmp_path / "p.svg").read_text()
        assert len(re.findall("<image", text)) == inside


@pytest.mark.parametrize(
    ("points", "error", "words"),
    [
        (np.full((2**20 + 1, 2), 0.5), ParameterError, "too many to see"),
        ([0.5], ParameterError, "give .n, d."),
        ([[0.5, 1.0]], DomainError, r"\[0,1\)"),
        ([], DomainError, "at least one point"),
    ],
)
def test_what_cannot_be_drawn(points, error, words):
    with pytest.raises(error, match=words):
        point_picture(points)


def test_files_that_are_no_pictures_or_cannot_be_written(tmp_path):
    with pytest.raises(FileFormatError, match="give .svg, .png, .pdf"):
        write_point_picture(tmp_path / "p.gif", [[0.5, 0.5]])
    with pytest.raises(FileFormatError, match="cannot be written"):
        write_point_picture(tmp_path / "no" / "p.png", [[0.5, 0.5]])
