"""Warnings about missing parts of an image: a lens, a shutter, delta lights and surfaces."""

import warnings

import numpy as np
import pytest

from mcspectra.core.errors import IncompleteImageWarning, ParameterError
from mcspectra.rendering import Pixel, check_scene, variance_map
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.image import render
from mcspectra.rendering.scene_checks import camera_rays, check_lights, warn_missed

pytestmark = pytest.mark.render

FILM = {"type": "hdrfilm", "width": 6, "height": 4}


def scene(camera=None, **more):
    """A diffuse wall that fills the view, plus a test's objects; lit by a constant sky."""
    sensor = {"type": "perspective", "film": FILM} | (camera or {})
    sky = {} if "sky" in more else {"sky": {"type": "constant"}}
    with LOCK:
        away = load_mitsuba().ScalarTransform4f().translate([0, 0, 2]).rotate([0, 1, 0], 180)
    wall = {"type": "rectangle", "to_world": away.scale(9), "bsdf": {"type": "diffuse"}}
    return {"type": "scene", "sensor": sensor, "wall": wall} | sky | more


def sky(values, **more):
    return {"type": "envmap", "bitmap": load_mitsuba().Bitmap(values.astype(np.float32)), **more}


def silent(scene, strategy="mis", **options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        render(scene, strategy, spp=1, **options)


LENS = {"type": "thinlens", "aperture_radius": 0.25, "focus_distance": 1.0}
SHUTTER = {"shutter_open": 0.0, "shutter_close": 0.5}


@pytest.mark.parametrize(
    ("camera", "words", "rays"),
    [
        (LENS, ["a lens (of radius 0.25)"], "center of the lens"),
        (SHUTTER, ["a shutter"], "middle of the shutter's time"),
        (LENS | SHUTTER, 2 * ["has a"], "center of the lens, middle of the shutter's time"),
    ],
)
def test_cameras_that_are_not_sampled_are_named(camera, words, rays):
    made = scene(camera)
    sentences = check_scene(made)
    assert len(sentences) == len(words)
    for sentence, word in zip(sentences, words, strict=True):
        assert word in sentence
        assert sentence.count("\n") == 0
    for measure in (
        lambda: render(made, spp=1),
        lambda: variance_map(made, counts=(1, 4), realizations=2, predict_every=0),
    ):
        with pytest.warns(IncompleteImageWarning) as heard:
            result = measure()
        assert [str(each.message) for each in heard] == sentences
        assert result.attrs["camera"] == rays


def test_pinholes_are_rendered_in_silence():
    assert check_scene(scene()) == []
    silent(scene())
    assert camera_rays(scene()) == "pinhole"


def test_strategies_that_miss_a_light_warn():
    lamp = {"type": "point", "position": [0, 0, 1]}
    made = scene(lamp=lamp, spot={"type": "spot"})
    with pytest.warns(
        IncompleteImageWarning, match=r"'bsdf' leaves out the light 'lamp' and 1 more"
    ):
        found = render(made, "bsdf", spp=4)["image"]
    # the light is silently missing
    np.testing.assert_array_equal(found, render(scene(), "bsdf", spp=4)["image"])
    silent(made, "light")
    silent(made, "mis")
    silent(made, "bsdf", light="sky")


def test_strategies_that_miss_a_mirror_warn():
    made = scene(ball={"type": "sphere", "bsdf": {"type": "conductor"}})
    with pytest.warns(IncompleteImageWarning, match="'light' leaves out specular .*'ball'"):
        render(made, "light", spp=1)
    silent(made, "bsdf")
    warn_missed(made, "mis-light")


def test_scaled_environments_are_refused():
    with LOCK:
        transform = load_mitsuba().ScalarTransform4f
        twice, turned = (
            transform().scale(2),
            transform().rotate([0.6, 0, 0.8], 40).scale([-1, 1, 1]),
        )
    made = scene(sky=sky(np.ones((4, 8, 3)), to_world=twice))
    (sentence,) = check_scene(made)
    assert "'sky' is not a rotation or reflection" in sentence
    # Mitsuba renders this without a warning, twice as bright by light sampling.
    for refused in (lambda: render(made, "light", spp=1), lambda: Pixel(scene=made, x=1, y=1)):
        with pytest.raises(ParameterError, match="not a rotation or reflection"):
            refused()
    assert check_scene(scene(sky=sky(np.ones((4, 8, 3)), to_world=turned))) == []
    assert check_scene(scene(sky={"type": "constant", "to_world": twice})) == []


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_environments_with_a_broken_pixel_are_refused(value):
    pixels = np.ones((4, 8, 3))
    pixels[2, 3, 1] = value
    made = scene(sky=sky(pixels), lamp={"type": "point"})
    assert any("'sky' has pixels that are NaN" in each for each in check_scene(made))
    assert not any("NaN" in each for each in check_scene(made, light="lamp"))
    for refused in (
        lambda: render(made, "light", spp=1),
        lambda: check_lights(made, "sky"),
        lambda: Pixel(scene=made, x=1, y=1, light="sky"),
    ):
        with pytest.raises(ParameterError, match="'sky' has pixels that are NaN"):
            refused()


def test_maps_that_show_nothing_name_the_obstacle():
    made = scene(
        wall={"type": "rectangle"}, ball={"type": "sphere", "bsdf": {"type": "dielectric"}}
    )
    with pytest.raises(ParameterError, match=r"choose another crop\. The BSDF of the shape 'ball'"):
        variance_map(made, counts=(1, 4), realizations=2)
