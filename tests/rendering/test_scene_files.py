"""All files of a scene are found, and a change of one file changes the state."""

import os

import pytest

from mcspectra.rendering import scenes
from mcspectra.rendering.scenes import referenced_files, watched_state

SCENE = """<scene version="3.0.0">
  <default name="image" value="wall.png"/>
  <path value="textures"/>
  <include filename="parts/lights.xml"/>
  <bsdf type="diffuse"><texture type="bitmap" name="reflectance">
    <string name="filename" value="$image"/></texture></bsdf>
  <shape type="obj"><string name="filename" value="missing.obj"/></shape>
  <sensor type="perspective"><string name="fov_axis" value="x"/></sensor>
</scene>"""
LIGHTS = """<scene version="3.0.0">
  <include filename="scene.xml"/>
  <emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>
</scene>"""
NAMES = ["parts/lights.xml", "parts/sky.exr", "textures/wall.png"]


@pytest.fixture
def scene(tmp_path):
    for name in ("parts", "textures", "unused"):
        (tmp_path / name).mkdir()
    for name in (*NAMES, "unused/wall.png", "x"):
        (tmp_path / name).write_text("any", encoding="utf-8")
    (tmp_path / "x").unlink()
    (tmp_path / "parts" / "lights.xml").write_text(LIGHTS, encoding="utf-8")
    (tmp_path / "scene.xml").write_text(SCENE, encoding="utf-8")
    return tmp_path / "scene.xml"


def test_files_of_includes_paths_and_defaults_are_found(scene):
    assert referenced_files(scene) == {(scene.parent / name).resolve() for name in NAMES}
    sizes = {path.name: size for path, size, _ in watched_state(scene)}
    assert sizes == {
        "scene.xml": len(SCENE),
        "lights.xml": len(LIGHTS),
        "sky.exr": 3,
        "wall.png": 3,
    }


@pytest.mark.parametrize("name", [*NAMES, "scene.xml"])
def test_the_state_of_a_scene_reflects_every_change(scene, name):
    before = watched_state(scene)
    assert {path for path, *_ in before} == referenced_files(scene) | {scene.resolve()}
    assert watched_state(scene) == before
    os.utime(scene.parent / name, ns=(1, 1))
    after = watched_state(scene)
    assert after != before
    assert {path for path, *_ in after} == {path for path, *_ in before}


def test_the_state_of_a_scene_reflects_added_and_removed_files(scene):
    before = watched_state(scene)
    (scene.parent / "textures" / "wall.png").unlink()
    assert watched_state(scene) == tuple(s for s in before if s[0].name != "wall.png")
    lights = scene.parent / "parts" / "lights.xml"
    lights.write_text(LIGHTS.replace("sky.exr", "../unused/wall.png"), encoding="utf-8")
    assert (scene.parent / "unused" / "wall.png").resolve() in [p for p, *_ in watched_state(scene)]


def test_only_changed_scenes_are_read_again(scene, monkeypatch):
    before = watched_state(scene)
    monkeypatch.setattr(scenes, "referenced_files", lambda _: 1 / 0)
    assert watched_state(scene) == before


@pytest.mark.parametrize("text", ["", "<scene>", "\x00", "<scene><string value='a\x01b'/></scene>"])
def test_files_that_are_not_xml_refer_to_no_files(tmp_path, text):
    file = tmp_path / "scene.xml"
    file.write_text(text, encoding="utf-8")
    assert referenced_files(file) == set()


def test_files_elsewhere_are_found(tmp_path):
    folder = tmp_path / "scene"
    folder.mkdir()
    (tmp_path / "a.png").write_text("any")
    (folder / "scene.xml").write_text(
        "<scene><string name='filename' value='../a.png'/></scene>", encoding="utf-8"
    )
    assert referenced_files(folder / "scene.xml") == {(tmp_path / "a.png").resolve()}
