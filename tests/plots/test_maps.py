"""Plots of scenes: maps, images by strategy, and incident light at a pixel."""

import numpy as np
import pytest
import xarray as xr
from tests.plots.drawing import drawn_by_both, marks

from mcspectra.core.errors import McspectraError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.plots.description import Heatmap, Pixels, Segments
from mcspectra.plots.kinds import PLOT_KINDS, describe, kinds_of
from mcspectra.plots.maps import incident_maps, located, rms_error, strategy_images, worst_pixels
from mcspectra.plots.text import number
from mcspectra.rendering.files import encode_srgb


def variance_map(**changes):
    """Return a map as in a store, with text as attributes."""
    values = np.random.default_rng(1).random((2, 3, 4))
    pixels = ("y", "x")
    found = {
        "mean": (("strategy", *pixels), values),
        "variance": (
            ("strategy", "n", *pixels),
            values[:, None] * np.array([9.0, 1.0])[:, None, None],
        ),
        "rate": (("strategy", *pixels), -1.0 - values),
        "rate_se": (("strategy", *pixels), values),
        "bottleneck": (pixels, np.arange(12.0).reshape(3, 4) % 3 - 1),
        "dominant_technique": (pixels, np.arange(12.0).reshape(3, 4) % 2),
        "mis_gain": (pixels, values[0] + 0.5),
        "predicted_ratio": (("strategy", *pixels), np.where(np.arange(4) % 2, np.nan, values)),
        "interpolation_factor": (("strategy", *pixels), 1.0 + values),
        "bounce_share": (("bounce", *pixels), values[:2] - 0.1),
        "decision_share": (("decision", *pixels), values[:2] - 0.1),
        "largest_bounce": (pixels, np.arange(12.0).reshape(3, 4) % 3 - 1),
        "largest_decision": (pixels, np.arange(12.0).reshape(3, 4) % 3 - 1),
        "best_sampler": (("strategy", *pixels), np.arange(24.0).reshape(2, 3, 4) % 2 - 1),
    }
    coords = {"n": [4, 16], "y": np.arange(3), "x": np.arange(4)}
    coords |= {"bounce": [0, 1], "decision": ["film", "light"]}
    return xr.Dataset(found | changes, coords, {"labels_strategy": ["light", "bsdf"]})


MAPS = [kind for kind in PLOT_KINDS if kind.startswith("map-")]


def test_maps_have_a_plot_for_each_quantity():
    assert list(kinds_of(variance_map())) == MAPS


def test_only_measured_pixels_are_marked_as_the_worst():
    """Earlier versions drew five rings around one measured pixel."""
    measured = np.zeros((3, 4))
    measured[[0, 2], [1, 3]] = 1.0
    data = variance_map(measured=(("y", "x"), measured))
    assert {tuple(place) for place in worst_pixels(data)} == {(0, 1), (2, 3)}
    assert "Rings: the 2 pixels" in describe("map-picture", data).caption
    assert len(worst_pixels(variance_map())) == 5


@pytest.mark.parametrize("kind", MAPS)
def test_maps_are_drawn(kind):
    plot = describe(kind, {"a": variance_map(), "b | c": variance_map()})
    # Layers have the same marks, so a pair of maps is drawn for a number and for names
    pair = kind in ("map-mean", "map-best-sampler")
    drawn_by_both(plot if pair else describe(kind, variance_map()))
    if kind == "map-picture":
        assert [mark.rgb.shape for mark in marks(plot, Pixels)] == [(3, 4, 3)]
        return
    assert plot.wide
    assert len({image.scale for image in marks(plot, Heatmap)}) == 1
    assert "pixels for a, b | c" in plot.words
    assert all(panel.y.flipped for panel in plot.panels)


def test_maps__a_panel_per_strategy_at_the_largest_number_of_samples():
    plot = describe("map-variance", variance_map())
    assert [panel.title for panel in plot.panels] == ["light sampling", "BSDF sampling"]
    shown = [image.values for image in marks(plot, Heatmap)]
    np.testing.assert_array_equal(shown, variance_map()["variance"].isel(n=-1))
    several = describe("map-mean", {"a": variance_map(), "b": variance_map()})
    assert several.panels[3].title == "b: BSDF sampling"


def test_maps__techniques_are_named_and_ratio_scales_are_symmetric():
    (image,) = marks(describe("map-bottleneck", variance_map()), Heatmap)
    assert image.scale.names == ("undecided", "light", "BSDF")
    assert (
        "undecided 33 %, light 33 %, BSDF 33 %" in describe("map-bottleneck", variance_map()).words
    )
    (image,) = marks(describe("map-gain", variance_map()), Heatmap)
    assert image.scale.low * image.scale.high == pytest.approx(1.0)
    assert image.scale.ticks[1.0] == "1"


def test_maps__bounces_decisions_and_samplers_have_names():
    plot = describe("map-bounces", {"a": variance_map(), "b": variance_map()})
    assert [panel.title for panel in plot.panels] == [
        "camera",
        "bounce 1",
    ]  # shown once for all samplers
    low = marks(plot, Heatmap)[0].scale.low
    assert -0.1 <= low < 0.0  # estimates below 0 are distinguished from 0
    (image,) = marks(describe("map-largest-decision", variance_map()), Heatmap)
    assert image.scale.names == ("undecided", "film", "light")
    best = describe("map-best-sampler", {"a": variance_map(), "b | c": variance_map()})
    assert marks(best, Heatmap)[0].scale.names == ("no difference", "a", "b | c")
    assert [panel.title for panel in best.panels] == ["light sampling", "BSDF sampling"]


def test_maps__predictions_are_cropped_to_known_pixels():
    shown = marks(describe("map-predicted", variance_map()), Heatmap)
    assert {image.values.shape for image in shown} == {(3, 2)}


def test_maps__without_a_number():
    nothing = (("y", "x"), np.full((3, 4), np.nan))
    plot = describe("map-gain", variance_map(mis_gain=nothing))
    assert "no number" in plot.words
    drawn_by_both(plot)


def test_maps__gray_pixels_are_explained():
    assert "Gray" not in describe("map-rate", variance_map()).caption
    rates = variance_map()["rate"].copy()
    rates[:, 0] = np.nan
    caption = describe("map-rate", variance_map(rate=rates)).caption
    assert "Gray pixels (33 %) have no value: no lit surface is seen" in caption
    assert "or too little variance" in caption
    # A logarithmic scale has no color for a variance of 0
    silent = variance_map()["variance"].copy()
    silent[:, :, 0] = 0.0
    assert "the variance is 0" in describe("map-variance", variance_map(variance=silent)).caption


def test_maps__rings_mark_the_noisiest_pixels():
    plot = describe("map-picture", variance_map())
    assert "the 5 pixels with the largest variance" in plot.caption
    worst = variance_map()["variance"].isel(n=-1, strategy=-1).values
    row, column = np.unravel_index(np.argmax(worst), (3, 4))
    centers = [ring.ends.mean(axis=(0, 1)) for ring in marks(plot, Segments)]
    np.testing.assert_allclose(centers[0], [column + 0.5, 3 - row - 0.5])


def test_a_ring_marks_a_pixel_of_a_larger_film():
    plot = located(np.ones((30, 40, 3)), np.array([[100, 20]]), size=(400, 300))
    drawn_by_both(plot)
    rings = marks(plot, Segments)
    assert len(rings) == 2  # dark on bright and bright on dark pictures
    for ring in rings:
        np.testing.assert_allclose(ring.ends.mean(axis=(0, 1)), [10.05, 30 - 2.05])


def test_maps__other_results_give_an_error():
    with pytest.raises(ParameterError, match="has no rate"):
        describe("map-mean", variance_map().drop_vars("rate"))


def image(seed, strategy, spp, batches=1, shape=(5, 7)):
    values = 1.5 * Stream.from_rng(seed).uniforms(0, 1, 3 * shape[0] * shape[1])
    arrays = {"image": (("y", "x", "channel"), values.reshape(*shape, 3))}
    if batches > 1:
        arrays["image_se"] = (("y", "x", "channel"), np.full((*shape, 3), 0.25))
    return xr.Dataset(arrays, attrs={"strategy": strategy, "spp": spp, "realizations": batches})


def images(**options):
    return {
        "reference": image(1, "mis", 64, 16, **options),
        "light": image(2, "light", 4, **options),
        "bsdf": image(3, "bsdf", 4, **options),
        "mis": image(4, "mis", 2, **options),
    }


@pytest.mark.parametrize("exposure", [0.0, -1.5])
def test_strategy_images_show_the_given_pixels(exposure):
    made = images()
    shown = marks(strategy_images(made, exposure=exposure), Pixels)
    for pixels, data in zip(shown, made.values(), strict=True):
        expected = np.rint(255 * encode_srgb(data["image"].values * 2.0**exposure))
        np.testing.assert_array_equal(pixels.rgb, expected)


def test_strategy_images_are_labeled_with_samples_and_errors():
    made = images()
    panels = strategy_images(made).panels
    assert [panel.title for panel in panels] == [
        "reference",
        "light sampling",
        "BSDF sampling",
        "MIS",
    ]
    off = [f"rms error {number(rms_error(made[s], made['reference']))}" for s in ("light", "mis")]
    assert panels[0].x.label == "1024 + 1024 samples per pixel\nrms standard error 0.250"
    assert panels[1].x.label == f"4 samples per pixel\n{off[0]}"
    assert panels[3].x.label == f"2 + 2 samples per pixel\n{off[1]}"
    drawn_by_both(strategy_images(made))


def test_error_is_over_pixels_and_channels():
    a, b = image(1, "mis", 1), image(1, "mis", 1)
    assert rms_error(a, b) == 0.0
    b["image"][2, 3, 1] += 2.0
    assert rms_error(b, a) == pytest.approx(2.0 / np.sqrt(5 * 7 * 3), rel=1e-12)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"reference": image(1, "mis", 1)},
        {"light": image(1, "light", 1), "mis": image(1, "mis", 1)},
        {"reference": image(1, "mis", 1), "mis": image(1, "mis", 1, shape=(5, 8))},
        {"reference": xr.Dataset(), "mis": xr.Dataset()},
    ],
)
def test_invalid_comparisons_give_an_error(given):
    with pytest.raises(ParameterError, match="give the result of compare_strategies"):
        strategy_images(given)


@pytest.mark.parametrize("exposure", [np.nan, np.inf, 65, "bright"])
def test_invalid_exposures_give_an_error(exposure):
    with pytest.raises(McspectraError, match="exposure"):
        strategy_images(images(), exposure=exposure)


def sky(values):
    coords = {"elevation": [22.5, 67.5], "azimuth": [60.0, 180.0, 300.0]}
    both = dict.fromkeys(
        ("incident_radiance", "reflected_radiance"),
        (("elevation", "azimuth"), values, {"units": "radiance"}),
    )
    return xr.Dataset(both, coords)


def test_light_has_a_logarithmic_scale_with_black_for_no_light():
    plot = incident_maps(sky(np.array([[0.0, 1.0, 10.0], [1e-9, 5.0, 2.0]])))
    shown = marks(plot, Heatmap)[0]
    assert shown.scale.kind == "log"
    assert shown.values.min() == shown.scale.low == pytest.approx(10.0 * 1e-4 / 2)
    drawn_by_both(plot)


def test_missing_light_is_noted():
    plot = incident_maps(sky(np.zeros((2, 3))))
    assert plot.panels[0].note == "no light from the center of any cell"
    drawn_by_both(plot)
