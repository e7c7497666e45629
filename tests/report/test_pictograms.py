"""Small images: marks have correct positions, and the SVG can be parsed."""

import base64
import io
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from PIL import Image

from mcspectra.report.reprs import curve, map_image, scatter, strip

SVG = "{http://www.w3.org/2000/svg}"


def pixels_of(svg):
    data = re.search(r'base64,([^"]*)"', svg).group(1)
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


def path_of(svg, index):
    path = ET.fromstring(svg).findall(f"{SVG}path")[index]
    return np.array(re.findall(r"[ML]([\d.-]+) ([\d.-]+)", path.get("d")), dtype=float)


def test_points_have_correct_positions():
    points = np.array([[0.0, 0.0], [0.25, 0.75], [0.999, 0.5]])
    dots = ET.fromstring(scatter(points, "p")).iter(f"{SVG}circle")
    found = np.array([[float(d.get("cx")), float(d.get("cy"))] for d in dots])
    np.testing.assert_allclose(found, [[0, 100], [25, 25], [99.9, 50]], atol=0.005)


def test_points_of_one_dim_are_lines():
    path = ET.fromstring(strip(np.array([0.125, 0.5]), "p")).find(f"{SVG}path")
    assert path.get("d") == "M12.50 35V65M50.00 35V65"


def test_a_curve_runs_through_its_values():
    values = np.linspace(0, 2, 201)  # 0.5 % of the values are clipped at each end, at 0.01 and 1.99
    xy = path_of(curve(values, "f"), 1)
    np.testing.assert_allclose(xy[:, 0], 100 * (np.arange(201) + 0.5) / 201, atol=0.006)
    np.testing.assert_allclose(xy[:, 1], 95 - 90 * values / 1.99, atol=0.006)


def test_a_curve_has_gaps_at_missing_values():
    svg = curve(np.array([1.0, np.nan, 2.0, 3.0]), "f")
    (line,) = ET.fromstring(svg).findall(f"{SVG}path")[1:]
    assert line.get("d").count("M") == 2
    assert len(path_of(svg, 1)) == 3


def test_infinite_values_end_at_the_frame():
    xy = path_of(curve(np.array([1.0, np.inf, 2.0]), "f"), 1)
    assert xy[1, 1] == 0.0


@pytest.mark.parametrize("values", [np.zeros(5), np.full(5, np.nan), np.full((4, 4), np.inf)])
def test_flat_and_missing_values_are_drawn(values):
    draw = curve if values.ndim == 1 else map_image
    ET.fromstring(draw(values, "f"))


def test_a_map_has_axis_0_to_the_right_and_axis_1_upwards():
    values = np.zeros((200, 100))
    values[150:, 90:] = 1.0  # top right
    shown = pixels_of(map_image(values, "f"))
    assert shown.shape == (100, 200, 3)
    np.testing.assert_array_equal(shown[0, -1], [253, 231, 37])
    np.testing.assert_array_equal(shown[-1, 0], [68, 1, 84])


def test_three_channels_are_colors_and_two_are_not():
    values = np.zeros((10, 10, 3))
    values[..., 0] = 1.0
    assert (pixels_of(map_image(values, "f")) == [255, 0, 0]).all()
    assert (pixels_of(map_image(values[..., :2], "f")) == [68, 1, 84]).all()


def test_labels_are_escaped():
    assert ET.fromstring(scatter(np.zeros((1, 2)), '<"&>')).get("aria-label") == '<"&>'
