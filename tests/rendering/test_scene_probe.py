"""Scenes whose materials Mitsuba cannot evaluate: rejected, without affecting the next scene."""

import numpy as np
import pytest

from mcspectra.core.errors import ParameterError
from mcspectra.rendering import Pixel, load_mitsuba, load_scene, variance_map
from mcspectra.rendering.scenes import SCENES, what_fails
from mcspectra.rendering.wavefront import Wavefront

pytestmark = pytest.mark.render

_PLASTIC = '<bsdf type="roughplastic"/>'
_NORMALS = '<texture name="normalmap" type="checkerboard"/>'
_NORMALMAP = f'<bsdf type="normalmap">{_NORMALS}{_PLASTIC}</bsdf>'
_BUMPMAP = f'<bsdf type="bumpmap"><texture type="checkerboard"/>{_PLASTIC}</bsdf>'
_TEXT = """<scene version="3.0.0">
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="0, 3, 6" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
  </sensor>
  <shape type="sphere" id="other"><point name="center" x="9" y="0" z="0"/></shape>
  <shape type="rectangle" id="floor">
    <transform name="to_world"><rotate x="1" angle="-90"/><scale value="2"/></transform>
    {bsdf}
  </shape>
  <shape type="rectangle" id="lamp">
    <transform name="to_world"><rotate x="1" angle="90"/><translate y="2"/></transform>
    <emitter type="area"/>
  </shape>
</scene>"""
_CASES = {
    "normalmap": (_NORMALMAP, r"Texture::eval_3\(\): not implemented"),
    "bumpmap": (_BUMPMAP, r"Texture::eval_1_grad\(\): not implemented"),
    "nested": (f'<bsdf type="twosided">{_NORMALMAP}</bsdf>', r"Texture::eval_3\(\)"),
}


def use_pixel(scene):
    return Pixel(scene=scene, x=4, y=4, dims=3)(np.full((4, 3), 0.3))


def use_map(scene):
    return variance_map(scene, ["light"], counts=[1, 4], realizations=2)


def use_means(scene):
    return Wavefront(scene).means("light", np.array([[4, 4]]), np.full((4, 2), 0.3))


def use_values(scene):
    return Wavefront(scene).values("light", np.array([[4, 4]]), np.full((4, 2), 0.3))


@pytest.mark.parametrize(
    "case", ["normalmap", pytest.param("bumpmap", marks=pytest.mark.slow), "nested"]
)
def test_materials_that_cannot_be_evaluated_are_named(case, tmp_path):
    bsdf, reason = _CASES[case]
    file = tmp_path / "bad.xml"
    file.write_text(_TEXT.format(bsdf=bsdf), encoding="utf-8")
    message = rf"cannot evaluate the BSDF \(\w+\) of the shape 'floor' in .*bad.xml.*: .*{reason}"
    for _ in range(2):  # a rejected scene is not cached
        with pytest.raises(ParameterError, match=message):
            load_scene(str(file))


@pytest.mark.parametrize(
    "use",
    [
        use_pixel,
        use_map,
        *(pytest.param(f, marks=pytest.mark.slow) for f in (use_means, use_values)),
    ],
)
def test_the_next_scene_works(use, tmp_path):
    file, good = tmp_path / "bad.xml", tmp_path / "good.xml"
    file.write_text(_TEXT.format(bsdf=_NORMALMAP), encoding="utf-8")
    good.write_text(_TEXT.format(bsdf=_PLASTIC), encoding="utf-8")
    with pytest.raises(ParameterError, match="cannot evaluate") as raised:
        use(str(file))
    assert raised.value.__context__ is None  # frames of the context would keep the scene in memory
    for again in (use_means, use_values, use_map):  # each makes virtual calls
        again(str(good))
    assert np.isfinite(np.asarray(use_pixel(str(good)))).all()


def test_a_broken_scene_in_memory_breaks_the_others(tmp_path):
    """Reason for the probe: Mitsuba itself loads a scene in addition to ours."""
    good = tmp_path / "good.xml"
    good.write_text(_TEXT.format(bsdf=_PLASTIC), encoding="utf-8")
    bad = load_mitsuba().load_string(_TEXT.format(bsdf=_NORMALMAP))
    with pytest.raises(RuntimeError):
        use_values(str(good))
    found = what_fails(bad)
    assert found is not None
    assert found[0] == "the BSDF (NormalMap) of the shape 'floor'"


@pytest.mark.parametrize("name", SCENES)
def test_our_own_scenes_pass(name):
    assert what_fails(load_scene(name)) is None


@pytest.mark.parametrize("kind", ["mask", "dielectric", "null", "hair", "principled"])
def test_materials_that_mitsuba_can_evaluate_pass(kind):
    inside = _PLASTIC if kind == "mask" else ""
    text = _TEXT.format(bsdf=f'<bsdf type="{kind}">{inside}</bsdf>')
    assert what_fails(load_mitsuba().load_string(text)) is None


def test_lights_are_tested():
    class Light:
        def id(self):
            return "lamp"

        def class_name(self):
            return "Broken"

        def sample_direction(self, *_):
            raise RuntimeError("not implemented")

    class Scene:
        def shapes(self):
            return []

        def emitters(self):
            return [Light()]

    found = what_fails(Scene())
    assert found is not None
    assert (found[0], str(found[1])) == ("the light 'lamp' (Broken)", "not implemented")
