"""Scenes for the tests of the interface to the renderer."""

import gc

import pytest
from tests.fonts import fonts_once

from mcspectra.rendering import scenes
from mcspectra.rendering.paths import dimensions_of
from mcspectra.rendering.skies import _sky
from mcspectra.rendering.techniques import hits_of

__all__ = ["fonts_once"]

_CAMERA = """
  <sensor type="perspective">
    <float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0, 3, 6" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm">
      <integer name="width" value="40"/><integer name="height" value="30"/>
    </film>
  </sensor>
"""
_FLOOR = """
  <shape type="rectangle" id="floor">
    <transform name="to_world"><rotate x="1" angle="-90"/><scale value="2"/></transform>
    {bsdf}
  </shape>
"""
_SCREEN = """
  <shape type="rectangle" id="screen">
    <transform name="to_world"><rotate x="1" angle="90"/><translate y="2"/></transform>
    <emitter type="area"><texture type="checkerboard" name="radiance">
      <rgb name="color0" value="0.2, 0.9, 0.2"/><rgb name="color1" value="0.8, 0.1, 0.7"/>
    </texture></emitter>
  </shape>
"""
_SKY = '<emitter type="constant" id="sky"><rgb name="radiance" value="0.1, 0.2, 0.3"/></emitter>'
_LAMP = '<emitter type="point" id="lamp"><point name="position" x="0" y="4" z="0"/></emitter>'
_LAYERED = """<bsdf type="principled"><rgb name="base_color" value="0.5, 0.3, 0.2"/>
    <float name="roughness" value="0.3"/><float name="metallic" value="0.3"/></bsdf>"""
_MIRROR = '<bsdf type="conductor"/>'
_GRAY = '<bsdf type="diffuse"/>'


def _scene(bsdf, *lights, camera=_CAMERA):
    return f'<scene version="3.0.0">{camera}{_FLOOR.format(bsdf=bsdf)}{"".join(lights)}</scene>'


_TEXTS = {
    "textured": _scene(_LAYERED, _SCREEN, _SKY),
    "mirror": _scene(_MIRROR, _SCREEN),
    "lamp": _scene(_GRAY, _SCREEN, _LAMP),
    "dark": _scene(_GRAY),
    "blind": _scene(_GRAY, _SCREEN, camera=""),
}


@pytest.fixture(scope="module", autouse=True)
def forget_scenes():
    """Drop a module's scenes: every call of Dr.Jit traces the BSDFs of all scenes in memory."""
    yield
    caches = (scenes._built, hits_of, dimensions_of, _sky)
    used = any(cache.cache_info().currsize for cache in caches)
    for cache in caches:
        cache.cache_clear()
    if used:
        gc.collect()
        gc.freeze()  # the next pass skips all objects that are left: half a second for each module


@pytest.fixture(scope="session")
def scene_files(tmp_path_factory):
    """Paths of small scenes: textured (layered BSDF, sky), mirror, lamp, dark, blind."""
    folder = tmp_path_factory.mktemp("scenes")
    for name, text in _TEXTS.items():
        (folder / f"{name}.xml").write_text(text, encoding="utf-8")
    return {name: str(folder / f"{name}.xml") for name in _TEXTS}
