"""Scenes given as dictionaries: one object for equal contents, copies, and bad dictionaries."""

import pickle
from typing import Any

import numpy as np
import pytest

from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.rendering import (
    Pixel,
    load_mitsuba,
    load_scene,
    named_pixels,
    project,
)
from mcspectra.rendering.builtin import figure1
from mcspectra.rendering.scenes import DictScene, as_scene, film_size, scene_name, sensor_of

pytestmark = pytest.mark.render


def edited(**changes):
    return figure1() | changes


def test_equal_contents_are_one_scene():
    # Each scene creates its own transforms and, for the smooth light, its own bitmap.
    assert load_scene(figure1()) is load_scene(figure1())
    assert load_scene(figure1(edge=0.5)) is load_scene(figure1(edge=0.5))
    assert DictScene(figure1(edge=0.5)) == DictScene(figure1(edge=0.5))
    assert hash(DictScene(figure1())) == hash(DictScene(figure1()))


def test_any_other_content_is_another_scene():
    rectangle = figure1()["floor"]
    moved = rectangle | {"to_world": figure1()["light"]["to_world"]}
    others: list[dict[str, Any]] = [
        figure1(edge=0.5),
        figure1(edge=0.25),
        figure1(width=100),
        edited(floor=moved),
        edited(floor=rectangle | {"flip_normals": True}),
        edited(floor=rectangle | {"flip_normals": 1}),
        dict(reversed(figure1().items())),
    ]
    handles = {DictScene(scene) for scene in [figure1(), *others]}
    assert len(handles) == len(others) + 1
    assert DictScene(figure1()) != figure1()


def test_objects_of_mitsuba_compare_by_identity():
    load = load_mitsuba().load_dict
    first, second = load({"type": "diffuse"}), load({"type": "diffuse"})
    pair = [{"type": "scene", "floor": {"type": "rectangle", "b": b}} for b in (first, second)]
    assert load_scene(pair[0]) is load_scene(dict(pair[0]))
    assert load_scene(pair[0]) is not load_scene(pair[1])


def test_later_changes_do_not_affect_the_scene():
    scene = figure1()
    handle = as_scene(scene)
    assert as_scene(handle) is handle
    scene["floor"]["bsdf"] = {"type": "conductor"}
    del scene["sensor"]
    assert handle == DictScene(figure1())
    assert isinstance(handle, DictScene)
    handle.contents["floor"].clear()
    assert film_size(handle) == (384, 256)


def test_a_pixel_of_a_dictionary_equals_that_of_the_named_scene():
    x, y = named_pixels("figure1")["Q"]
    u = (np.arange(200).reshape(100, 2) + 0.5) / 200
    by_dict = Pixel(scene=figure1(), x=x, y=y)
    np.testing.assert_array_equal(by_dict(u), Pixel(scene="figure1", x=x, y=y)(u))
    assert by_dict.spec == f"pixel(scene=dict, x={x}, y={y})"
    assert hash(by_dict) == hash(Pixel(scene=figure1(), x=x, y=y))
    assert by_dict == Pixel(scene=figure1(), x=x, y=y)
    assert named_pixels(figure1()) == {}


def test_messages_call_it_dict():
    blind = {key: value for key, value in figure1().items() if key != "sensor"}
    assert scene_name(blind) == "'dict'"
    with pytest.raises(ParameterError, match="The scene 'dict' has no camera"):
        sensor_of(blind)
    with pytest.raises(ParameterError, match="camera of 'dict' does not see"):
        project(figure1(), (0, 0, 100))


def holding_itself():
    scene: dict[str, Any] = {"type": "scene"}
    scene["again"] = scene
    return scene


def listing_itself():
    entries: list[Any] = []
    entries.append(entries)
    return entries


def test_lists_and_arrays_are_copied():
    center, data = [0.0, 1.0, 2.0], np.ones((2, 3), np.float32)
    ball = {"type": "sphere", "center": center}
    scene = {"type": "scene", "ball": ball, "data": data}
    handle = DictScene(scene)
    center[0] = 5.0
    data[:] = 2.0
    assert handle.contents["ball"]["center"] == [0.0, 1.0, 2.0]
    assert (handle.contents["data"] == 1.0).all()
    assert handle != DictScene(scene)
    assert pickle.loads(pickle.dumps(handle)) == handle


@pytest.mark.parametrize(
    ("scene", "error", "words"),
    [
        ({}, ParameterError, "type None; it must be 'scene'"),
        ({"type": "diffuse"}, ParameterError, "type 'diffuse'; it must be 'scene'"),
        ({"type": "scene", 1: 2}, ParameterError, "A key of the scene dictionary is 1"),
        ({"type": "scene", "a": {None: 2}}, ParameterError, "dictionary is None"),
        (holding_itself(), ParameterError, "remove parts that contain themselves"),
        (
            {"type": "scene", "a": listing_itself()},
            ParameterError,
            "remove parts that contain themselves",
        ),
        ({"type": "scene", "a": 5}, FileFormatError, 'integer "a": 5'),
        ({"type": "scene", "a": {"type": "sphre"}}, FileFormatError, 'Plugin "sphre" not found'),
        ({"type": "scene", "a": {"radius": 1}}, FileFormatError, "missing 'type'"),
        ({"type": "scene", "a": {"type": "sphere", "radius": "x"}}, FileFormatError, "wrong type"),
        ({"type": "scene", "a": {"type": "sphere", "radius": object()}}, FileFormatError, "radius"),
        ({"type": "scene", "a": {"type": "ply", "filename": "no.ply"}}, FileFormatError, "no.ply"),
    ],
)
def test_bad_dictionaries_are_one_sentence(scene, error, words):
    with pytest.raises(error) as caught:
        load_scene(scene)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert ".cpp" not in str(caught.value)


@pytest.mark.parametrize("scene", [None, 7, "", "  ", [], ["veach"], b"veach", np.zeros(3)])
def test_invalid_scenes_are_rejected(scene):
    with pytest.raises(ParameterError, match="give the name of a scene"):
        as_scene(scene)
