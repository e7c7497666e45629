"""Veach's scene compared with the published numbers; names, files and film coordinates."""

import math
import os
from pathlib import Path

import numpy as np
import pytest

from mcspectra.core.errors import FileFormatError, McspectraError, ParameterError, UnknownName
from mcspectra.rendering import (
    SCENES,
    describe_pixel,
    load_mitsuba,
    load_scene,
    project,
    veach,
)
from mcspectra.rendering.backend import threads_for_files
from mcspectra.rendering.scenes import emitter_name, film_size, find_emitter, sensor_of

pytestmark = pytest.mark.render

LIGHTS = ["light-0", "light-1", "light-2", "light-3", "fill-light"]
# Edges (y, z) and roughness, as published.
PLATES = [
    ((-2.70651, 0.25609), (-2.08375, -0.526323), 0.005),
    ((-3.28825, 1.36972), (-2.83856, 0.476536), 0.02),
    ((-3.73096, 2.70046), (-3.43378, 1.74564), 0.05),
    ((-3.99615, 4.0667), (-3.82069, 3.08221), 0.1),
]


def test_four_spheres_have_equal_power():
    scene = veach()
    power = [scene[k]["radius"] ** 2 * scene[k]["emitter"]["radiance"]["value"] for k in LIGHTS[:4]]
    # The smallest radius is published with four digits: 0.03333 for 1/30, 1e-4 relative.
    assert power == pytest.approx([1.0] * 4, rel=2e-3)
    assert [scene[k]["center"] for k in LIGHTS[:4]] == [
        [x, 0.0, 0.0] for x in (-3.75, -1.25, 1.25, 3.75)
    ]


@pytest.mark.parametrize("i", range(4))
@pytest.mark.parametrize("t", [0.05, 0.5, 0.95])
def test_plates_lie_between_their_edges_and_face_up(i, t):
    front, back, alpha = PLATES[i]
    y, z = (1 - t) * np.array(front) + t * np.array(back)
    for x in (-3.9, 0.3, 3.9):
        column, row = project("veach", [x, y, z])
        seen = describe_pixel("veach", math.floor(column), math.floor(row))
        assert seen["shape"] == f"plate-{i}"
        assert seen["bsdf"] == "RoughConductor"
        edge = np.array(back) - np.array(front)
        assert np.dot(seen["normal"][1:], edge) == pytest.approx(0.0, abs=1e-6)
        assert seen["normal"][1] > 0
    assert veach()[f"plate-{i}"]["bsdf"]["alpha"] == alpha


def test_plates_end_at_their_edges():
    for i, (front, back, _) in enumerate(PLATES):
        edge = np.array(back) - np.array(front)
        for x, (y, z) in ((4.1, front), (0.0, back + 0.08 * edge), (0.0, front - 0.08 * edge)):
            seen = describe_pixel("veach", *map(math.floor, project("veach", [x, y, z])))
            assert seen["shape"] != f"plate-{i}"


@pytest.mark.parametrize(("x", "y"), [(0, 0), (568, 100), (767, 511), (384, 500)])
def test_project_undoes_the_camera(x, y):
    seen = describe_pixel("veach", x, y)
    assert seen["shape"] in ("wall", "floor")
    # float32 coordinates up to 15 at 60 pixels per unit: 15 × 2^-23 × 60 × 10 roundings.
    assert project("veach", seen["position"]) == pytest.approx((x + 0.5, y + 0.5), abs=1e-3)


def test_floor_and_wall_are_where_they_should_be():
    floor, wall = describe_pixel("veach", 384, 500), describe_pixel("veach", 568, 100)
    assert floor["position"][1] == pytest.approx(-4.14615)
    assert wall["position"][2] == pytest.approx(-2.0)
    assert wall["normal"] == pytest.approx((0.0, 0.0, 1.0))
    assert floor["normal"] == pytest.approx((0.0, 1.0, 0.0))


def test_lights_and_film_follow_the_options():
    assert [emitter_name(e) for e in load_scene("veach").emitters()] == LIGHTS
    few = "veach(lights=['light-3', 'fill-light'], width=96, height=64)"
    assert [emitter_name(e) for e in load_scene(few).emitters()] == ["light-3", "fill-light"]
    assert film_size(few) == (96, 64)
    assert film_size("veach") == (768, 512)
    assert find_emitter("veach", 3).get_shape().id() == "light-3"
    assert find_emitter("veach", "fill-light").get_shape().id() == "fill-light"
    assert "veach" in SCENES


def test_scene_is_loaded_once(scene_files):
    assert load_scene("veach") is load_scene(" veach ")
    assert load_scene(scene_files["dark"]) is load_scene(Path(scene_files["dark"]))


def test_changed_file_is_read_again(scene_files, tmp_path):
    file = tmp_path / "scene.xml"
    file.write_text(Path(scene_files["dark"]).read_text())
    assert load_scene(file).emitters() == []
    file.write_text(Path(scene_files["textured"]).read_text())
    os.utime(file, ns=(1, 1))  # the time differs for any resolution of the file system
    assert [emitter_name(e) for e in load_scene(file).emitters()] == ["screen", "sky"]


def test_changed_mesh_is_read_again(tmp_path):
    file, mesh = tmp_path / "scene.xml", tmp_path / "panel.obj"
    shape = '<shape type="obj"><string name="filename" value="panel.obj"/></shape>'
    file.write_text(f'<scene version="3.0.0">{shape}</scene>')
    for size in (1, 2):
        mesh.write_text(f"v 0 0 0\nv {size} 0 0\nv 0 {size} 0\nf 1 2 3\n")
        os.utime(mesh, ns=(size, size))
        (panel,) = load_scene(file).shapes()
        assert panel.bbox().max.x == size
        assert load_scene(file) is load_scene(file)


@pytest.mark.parametrize(
    ("scene", "error", "words"),
    [
        ("veech", UnknownName, "Did you mean 'veach'"),
        ("veach(width=0)", ParameterError, "width is 0"),
        ("veach(fov=3)", ParameterError, "no parameter 'fov'"),
        ("veach(lights=[])", ParameterError, "light-0"),
        ("veach(lights=['sun'])", ParameterError, "'sun'"),
        ("veach(lights=3)", ParameterError, "lights is 3"),
        ("veach | veach", McspectraError, "chains"),
        ("", ParameterError, "give the name"),
        ("missing.xml", FileFormatError, "There is no scene file 'missing.xml'"),
        (Path("missing"), FileFormatError, "There is no scene file"),
    ],
)
def test_bad_requests_are_one_sentence(scene, error, words):
    with pytest.raises(error, match=None) as caught:
        load_scene(scene)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


_BITMAP = """<scene version="3.0.0"><sensor type="perspective"/>
  <shape type="rectangle" id="floor"><bsdf type="diffuse">
    <texture type="bitmap" name="reflectance"><string name="filename" value="{}"/></texture>
  </bsdf></shape></scene>"""


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "No document element found"),
        ("<scene version='3.0.0'><shape type='sphe'/></scene>", 'Plugin "sphe" not found'),
        ("<scene version='3.0.0'>\n<shape type='sphere'>\n</scene>", "(line 3"),
        ("<scene version='3.0.0'>\n<shape type='sphere' ids='a'/></scene>", "line 2"),
        ("<scene version='3.0.0'>\n\n<integer name='a' value='b'/></scene>", "line 3"),
        ("<scene version='3.0.0'><shape type='$kind'/></scene>", "undefined parameter: $kind"),
        (_BITMAP.format("missing.png"), "missing.png"),
        ("<scene version='3.0.0'><string name='\xff' value='b'/></scene>", "utf-8"),
    ],
)
def test_broken_file_is_one_sentence(tmp_path, text, words):
    file = tmp_path / "broken.xml"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(
        FileFormatError, match=r"Mitsuba cannot read the scene .*broken\.xml"
    ) as caught:
        load_scene(str(file))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert ".cpp" not in str(caught.value)


def test_a_texture_is_found_next_to_its_scene(tmp_path, monkeypatch):
    scenes, elsewhere = tmp_path / "scenes", tmp_path / "elsewhere"
    (scenes / "textures").mkdir(parents=True)
    elsewhere.mkdir()
    pixels = np.full((4, 4, 3), 0.25, np.float32)
    bitmap = load_mitsuba().Bitmap(pixels)
    with threads_for_files():
        bitmap.write(str(scenes / "textures" / "gray.exr"))
    (scenes / "scene.xml").write_text(_BITMAP.format("textures/gray.exr"))
    for folder in (elsewhere, scenes):
        monkeypatch.chdir(folder)
        scene = load_scene(os.path.relpath(scenes / "scene.xml"))
        at = load_mitsuba().SurfaceInteraction3f()
        at.uv = load_mitsuba().Point2f(0.4, 0.6)
        reflectance = scene.shapes()[0].bsdf().eval_diffuse_reflectance(at)
        np.testing.assert_allclose(np.ravel(reflectance.numpy()), 0.25, rtol=1e-5)
    # The folder of one scene is not searched for the textures of another.
    (elsewhere / "other.xml").write_text(_BITMAP.format("textures/gray.exr"))
    monkeypatch.chdir(elsewhere)
    with pytest.raises(FileFormatError, match=r"gray\.exr"):
        load_scene("other.xml")


def test_file_of_something_else_is_refused(tmp_path):
    file = tmp_path / "bsdf.xml"
    file.write_text("<bsdf version='3.0.0' type='diffuse'/>")
    with pytest.raises(FileFormatError, match="holds no scene"):
        load_scene(str(file))


def test_scene_without_camera_is_refused(scene_files):
    with pytest.raises(ParameterError, match="no camera"):
        sensor_of(scene_files["blind"])


@pytest.mark.parametrize(
    "point", [(0, 0, 30), (0, 100, 0), (0, 0), (0, 0, 0, 0), (0, math.nan, 0), "abc", 1.0, None]
)
def test_project_rejects_points_outside_the_view(point):
    with pytest.raises(ParameterError):
        project("veach", point)


@pytest.mark.parametrize("light", [5, -1, 1.5, "light-9", True])
def test_an_unknown_light_lists_the_existing_ones(light):
    with pytest.raises(ParameterError, match="light-3"):
        find_emitter("veach", light)


def test_scene_without_lights_has_none_to_find(scene_files):
    for light in (0, "sun"):
        with pytest.raises(ParameterError, match="has no light"):
            find_emitter(scene_files["dark"], light)
