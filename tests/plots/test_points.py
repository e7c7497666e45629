"""Point sets: correct positions, reported limits, and the card of a sampler."""

import numpy as np
import pytest
import xarray as xr
from PIL import Image as Picture
from tests.plots.drawing import marks

import mcspectra as mcs
from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.plots.backend_matplotlib import draw, write
from mcspectra.plots.description import Dots, Heatmap, Line, Segments
from mcspectra.plots.kinds import describe
from mcspectra.plots.points import point_sets, sampler_card


def random_sets(count, n, dims):
    return np.random.default_rng(0).random((count, n, dims))


def test_strips_have_names_and_borders_of_strata(make):
    data = {"jittered": make["points"](n=8), "random": make["points"]("random", n=8)}
    (panel,) = describe("points", data).panels
    assert list(panel.y.ticks.values()) == ["jittered", "random"]
    borders = [m for m in panel.marks if isinstance(m, Segments)]
    np.testing.assert_allclose(borders[0].ends[:, 0, 0], np.arange(9) / 8)


def test_the_first_two_of_three_axes(make):
    plot = describe("points", {"x": make["points"](dims=3, n=8)})
    assert "Axes 0 and 1 of 3" in plot.caption
    (dots,) = marks(plot, Dots)
    np.testing.assert_array_equal(dots.y, make["points"](dims=3, n=8)["points"][:, 1])


def test_dot_areas_are_proportional_to_weights(make):
    data = make["points"](dims=2, n=16)
    data["weights"] = ("point", np.where(np.arange(16) < 8, 1.0, 4.0))
    (dots,) = marks(describe("points", {"x": data}), Dots)
    assert (dots.size[8] / dots.size[0]) ** 2 == pytest.approx(4.0)
    assert dots.hover["weight"][8] == "4.000"


def test_a_square_holds_all_points():
    x = random_sets(1, 50, 2)
    plot = point_sets(x[0], "random")
    (panel,) = plot.panels
    (dots,) = panel.marks
    np.testing.assert_array_equal(np.stack([dots.x, dots.y], axis=1), x[0])
    assert panel.square
    assert (panel.x.low, panel.x.high, panel.y.low, panel.y.high) == (0, 1, 0, 1)
    assert plot.caption == "random"


@pytest.mark.parametrize(("count", "shown"), [(1, 1), (2, 2), (4, 4), (6, 6), (9, 6)])
@pytest.mark.parametrize("dims", [1, 2])
def test_sets_are_drawn_side_by_side_up_to_a_limit(count, shown, dims):
    x = random_sets(count, 8, dims)
    plot = point_sets(x, "random")
    assert len(plot.panels) == shown
    assert plot.caption == ("random" if shown == count else "random, 6 of 9 sets")
    for dots, points in zip(marks(plot, Dots), x, strict=False):
        np.testing.assert_array_equal(dots.x, points[:, 0])


@pytest.mark.parametrize(("dims", "shown", "said"), [(3, 3, ""), (6, 6, ""), (9, 6, " of 9")])
def test_more_dims_are_drawn_as_pairs_of_axes(dims, shown, said):
    x = random_sets(2, 8, dims)
    plot = point_sets(x)
    pairs = [(i, j) for j in range(1, shown) for i in range(j)]
    for dots, (i, j) in zip(marks(plot, Dots), pairs, strict=True):
        np.testing.assert_array_equal(np.stack([dots.x, dots.y], axis=1), x[0][:, [i, j]])
    assert plot.caption.startswith("1 of 2 sets")
    assert plot.caption.endswith(said)
    assert plot.panels[1].x.label == "x₀"


@pytest.mark.parametrize("n", [1, 16, 1024, 65536])
def test_dots_are_visible_and_separate(n):
    figure = draw(point_sets(random_sets(1, n, 2)))
    figure.canvas.draw()
    (axes,) = figure.axes
    diameter = np.sqrt(axes.collections[0].get_sizes()[0])
    spacing = 72 * axes.get_window_extent().width / figure.dpi / np.sqrt(n)
    assert 0.4 <= diameter <= 7
    assert diameter < 0.5 * spacing


def test_dark_pixels_are_at_the_points(tmp_path):
    points = np.array([[0.25, 0.75], [0.6, 0.1]])
    plot = point_sets(points)
    write(plot, tmp_path / "p.png")
    pixels = np.asarray(Picture.open(tmp_path / "p.png").convert("L"))
    figure = draw(plot)
    figure.set_dpi(200)
    figure.canvas.draw()
    box = figure.axes[0].get_position()
    height, width = pixels.shape
    for x, y in points:
        column = int((box.x0 + x * box.width) * width)
        row = int((1 - box.y0 - y * box.height) * height)
        assert pixels[row, column] < 80


@pytest.mark.parametrize(
    ("points", "error", "words"),
    [
        (np.full((2**20 + 1, 2), 0.5), ParameterError, "too many for a plot"),
        ([0.5], ParameterError, "give .n, d."),
        ([[0.5, 1.0]], DomainError, r"\[0,1\)"),
        ([], DomainError, "at least one point"),
    ],
)
def test_invalid_points_give_an_error(points, error, words):
    with pytest.raises(error, match=words):
        point_sets(points)


@pytest.mark.parametrize(("dims", "panels"), [(1, 3), (2, 4), (3, 2)])
def test_cards_show_points_spectrum_and_sections(dims, panels):
    sampler = mcs.sampler("random", dims=dims)
    points = xr.Dataset({"points": (("point", "axis"), sampler.draw(16, rng=0)[0])})
    power = mcs.power_spectrum(sampler, 16, half_width=3, realizations=20)
    plot = sampler_card({"points": points, "spectrum": power})
    assert len(plot.panels) == panels
    assert len(marks(plot, Heatmap)) == (dims == 2)
    more = sampler_card({"points": points, "spectrum": power}, random_sets(1, 9, 2)[0])
    assert len(more.panels) == panels + 1
    assert more.panels[-1].title == "4-D, n = 9"
    assert "axes 2 and 3 of points in 4-D" in more.caption
    along = [line for line in marks(plot, Line) if line.label]
    if dims == 2:
        shown = 16 * power["power"].sel(m0=[1, 2, 3], m1=0).values
        np.testing.assert_allclose(along[0].y, shown)
    draw(more).canvas.draw()
