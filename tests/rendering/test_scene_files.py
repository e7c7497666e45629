"""All files that a scene refers to are found, and a change of one is a change of the map."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from mcspectra.core.errors import StoreError
from mcspectra.rendering import _scene_files, variance_map
from mcspectra.rendering._scene_files import referenced_files, scene_state, watched_state

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
def scene(tmp_path: Path) -> Path:
    for name in ("parts", "textures", "unused"):
        (tmp_path / name).mkdir()
    for name in (*NAMES, "unused/wall.png", "x"):
        (tmp_path / name).write_text("any", encoding="utf-8")
    (tmp_path / "x").unlink()
    (tmp_path / "parts" / "lights.xml").write_text(LIGHTS, encoding="utf-8")
    (tmp_path / "scene.xml").write_text(SCENE, encoding="utf-8")
    return tmp_path / "scene.xml"


def test_files_of_includes_paths_and_defaults_are_found(scene: Path) -> None:
    assert referenced_files(scene) == {(scene.parent / name).resolve() for name in NAMES}
    state = scene_state(scene)
    assert list(state) == NAMES
    assert [size for size, _ in state.values()] == [len(LIGHTS), 3, 3]


@pytest.mark.parametrize("name", NAMES)
def test_every_change_shows(scene: Path, name: str) -> None:
    before = scene_state(scene)
    os.utime(scene.parent / name, ns=(1, 1))
    assert scene_state(scene) == before | {name: (before[name][0], 1)}


@pytest.mark.parametrize("name", [*NAMES, "scene.xml"])
def test_a_watched_scene_shows_every_change(scene: Path, name: str) -> None:
    before = watched_state(scene)
    assert {path for path, *_ in before} == referenced_files(scene) | {scene.resolve()}
    assert watched_state(scene) == before
    os.utime(scene.parent / name, ns=(1, 1))
    after = watched_state(scene)
    assert after != before
    assert {path for path, *_ in after} == {path for path, *_ in before}


def test_a_watched_scene_shows_files_that_come_and_go(scene: Path) -> None:
    before = watched_state(scene)
    (scene.parent / "textures" / "wall.png").unlink()
    assert watched_state(scene) == tuple(s for s in before if s[0].name != "wall.png")
    lights = scene.parent / "parts" / "lights.xml"
    lights.write_text(LIGHTS.replace("sky.exr", "../unused/wall.png"), encoding="utf-8")
    assert (scene.parent / "unused" / "wall.png").resolve() in [p for p, *_ in watched_state(scene)]


def test_only_changed_scenes_are_read_again(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = watched_state(scene)
    monkeypatch.setattr(_scene_files, "referenced_files", lambda _: 1 / 0)
    assert watched_state(scene) == before


@pytest.mark.parametrize("text", ["", "<scene>", "\x00", "<scene><string value='a\x01b'/></scene>"])
def test_what_is_no_xml_refers_to_nothing(tmp_path: Path, text: str) -> None:
    file = tmp_path / "scene.xml"
    file.write_text(text, encoding="utf-8")
    assert scene_state(file) == {}


def test_files_elsewhere_keep_their_whole_path(tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    (tmp_path / "a.png").write_text("any")
    (folder / "scene.xml").write_text(
        "<scene><string name='filename' value='../a.png'/></scene>", encoding="utf-8"
    )
    assert list(scene_state(folder / "scene.xml")) == [(tmp_path / "a.png").resolve().as_posix()]


@pytest.mark.render
def test_tiles_of_another_texture_are_not_resumed(
    scene_files: dict[str, str], tmp_path: Path
) -> None:
    part, file = tmp_path / "part.xml", tmp_path / "scene.xml"
    part.write_text("<scene version='3.0.0'/>", encoding="utf-8")
    text = Path(scene_files["textured"]).read_text(encoding="utf-8")
    included = text.replace("</scene>", "<include filename='part.xml'/></scene>")
    file.write_text(included, encoding="utf-8")

    def measured() -> object:
        return variance_map(
            file, ["light"], counts=(1, 8), realizations=2, dims=3, light="screen",
            predict_every=0, size=(4, 3), out=tmp_path / "tiles", resume=True,
        )  # fmt: skip

    measured()
    measured()
    os.utime(part, ns=(1, 1))
    with pytest.raises(StoreError, match="other settings"):
        measured()
