"""Unsupported parts are listed completely, one sentence each, with the name of the part."""

from typing import Any

import pytest

from mcspectra.core.errors import ParameterError, UnknownName
from mcspectra.rendering import Pixel, check_scene
from mcspectra.rendering.builtin import figure1
from mcspectra.rendering.scene_checks import check_lights, check_media
from mcspectra.rendering.wavefront import Wavefront

pytestmark = pytest.mark.render


FOG = {"type": "cube", "bsdf": {"type": "null"}, "interior": {"type": "homogeneous"}}
LAMPS = {
    "point": {"type": "point", "position": [0, 1, 0]},
    "spot": {"type": "spot"},
    "directional": {"type": "directional", "direction": [0, -1, 0]},
    "projector": {"type": "projector"},
}
SPECULAR = {
    "dielectric": {"type": "dielectric"},
    "thin": {"type": "thindielectric"},
    "conductor": {"type": "conductor"},
    "plastic": {"type": "plastic"},
    "mask": {"type": "mask", "opacity": 0.5, "nested": {"type": "diffuse"}},
    "blend": {
        "type": "blendbsdf",
        "weight": 0.5,
        "first": {"type": "conductor"},
        "second": {"type": "diffuse"},
    },
    "two-sided": {"type": "twosided", "nested": {"type": "conductor"}},
}
ROUGH: dict[str, dict[str, Any]] = {
    "diffuse": {"type": "diffuse"},
    "rough-conductor": {"type": "roughconductor"},
    "rough-plastic": {"type": "roughplastic"},
    "rough-dielectric": {"type": "roughdielectric"},
    "principled": {"type": "principled"},
    "bent": {
        "type": "normalmap",
        "normalmap": {"type": "rgb", "value": [0.5, 0.5, 1.0]},
        "nested": {"type": "diffuse"},
    },
}


def ball(bsdf):
    return {"type": "sphere", "bsdf": bsdf}


def one(scene, **options):
    sentences = check_scene(scene, **options)
    assert len(sentences) == 1
    assert "\n" not in sentences[0]
    assert sentences[0].endswith(".")
    return sentences[0]


@pytest.mark.parametrize("name", list(LAMPS))
def test_delta_lights_are_named(name):
    scene = figure1() | {name: LAMPS[name]}
    assert f"The light '{name}' of 'dict'" in one(scene)
    assert "delta function" in one(scene)
    assert check_scene(scene, light="light") == []
    with pytest.raises(ParameterError, match=f"The light '{name}'"):
        check_lights(scene)
    check_lights(scene, "light")


def test_lights_without_id_have_a_number(tmp_path):
    file = tmp_path / "scene.xml"
    camera = '<sensor type="perspective"/>'
    lights = '<emitter type="constant" id="sky"/><emitter type="point"/>'
    file.write_text(f'<scene version="3.0.0">{camera}{lights}</scene>')
    assert "The light 'emitter-1' of " in one(file)
    assert check_scene(file, light="sky") == []
    assert one(file) == check_scene(file, light="emitter-1")[0]


@pytest.mark.parametrize("name", list(SPECULAR))
def test_specular_shapes_are_named(name):
    sentence = one(figure1() | {"ball": ball(SPECULAR[name])})
    assert "the shape 'ball' (" in sentence
    assert "delta function" in sentence


@pytest.mark.parametrize("name", list(ROUGH))
def test_rough_shapes_are_supported(name):
    assert check_scene(figure1() | {"ball": ball(ROUGH[name])}) == []


def test_media_are_named_with_their_shapes():
    scene = figure1() | {"fog": FOG, "mist": {**FOG, "bsdf": {"type": "diffuse"}}}
    media, null = check_scene(scene)
    assert "participating media (the shape 'fog', the shape 'mist')" in media
    assert "the shape 'fog' (Null)" in null
    for check in (check_media, check_lights):
        with pytest.raises(ParameterError, match="participating media"):
            check(scene)
    with pytest.raises(ParameterError, match="participating media"):
        Pixel(scene=scene, x=96, y=205)
    with pytest.raises(ParameterError, match="participating media"):
        Wavefront(scene)


def test_a_medium_around_the_camera_is_reported():
    scene = figure1()
    scene["sensor"]["medium"] = {"type": "homogeneous"}
    assert "participating media (the camera 'sensor')" in one(scene)


def test_a_medium_outside_a_shape_is_reported():
    fog = {"type": "sphere", "bsdf": {"type": "diffuse"}, "exterior": {"type": "homogeneous"}}
    assert "the shape 'ball'" in one(figure1() | {"ball": fog})


def test_all_is_listed_at_once_and_in_order():
    scene = {key: value for key, value in figure1().items() if key not in ("sensor", "light")}
    scene |= {"fog": FOG, "ball": ball(SPECULAR["dielectric"])} | LAMPS
    sentences = check_scene(scene)
    words = ["no camera", "media", *[f"The light '{n}'" for n in LAMPS], "'fog'", "'ball'"]
    assert len(sentences) == len(words)
    for sentence, word in zip(sentences, words, strict=True):
        assert word in sentence


def test_scene_of_nothing():
    assert check_scene({"type": "scene"}) == [
        "The scene 'dict' has no camera; add a <sensor>.",
        "The scene 'dict' has no lights; add an emitter to it.",
    ]


def test_files_are_named_by_their_path(scene_files):
    path = scene_files["lamp"]
    assert check_scene(path) == [s for s in check_scene(path) if path in s] != []
    assert check_scene(path, light="screen") == []
    assert "the shape 'floor' (SmoothConductor)" in check_scene(scene_files["mirror"])[0]


def test_shapes_without_id_are_reported_without_a_name(tmp_path):
    file = tmp_path / "anonymous.xml"
    file.write_text(
        "<scene version='3.0.0'><sensor type='perspective'/><emitter type='constant'/>"
        "<shape type='sphere'><bsdf type='conductor'/></shape></scene>"
    )
    (sentence,) = check_scene(file)
    assert "The BSDF of a shape without id (SmoothConductor)" in sentence


def test_unknown_lights_and_scenes_are_errors():
    with pytest.raises(ParameterError, match="no light 'sun'"):
        check_scene("veach", light="sun")
    with pytest.raises(UnknownName, match="veach"):
        check_scene("veech")
    with pytest.raises(ParameterError, match="give the name"):
        check_scene(None)
