"""The cache of pixel hits, and the objects it keeps in memory."""

import gc
import weakref
from typing import Any

import pytest

from mcspectra.rendering import techniques
from mcspectra.rendering.scenes import load_scene


class Stub:
    """A stand-in for a scene."""


@pytest.mark.render
def test_a_pixel_is_traced_once():
    scene = load_scene("figure1")
    assert techniques.primary_hit(scene, 96, 205) is techniques.primary_hit(scene, 96, 205)


def test_few_scenes_and_pixels_are_cached(monkeypatch):
    traced: list[tuple[int, int]] = []

    def hit(scene, x, y):
        traced.append((x, y))
        return scene, x, y

    monkeypatch.setattr(techniques, "_primary_hit", hit)
    techniques.hits_of.cache_clear()
    first: Any = Stub()
    alive = weakref.ref(first)
    for x in range(300):
        assert techniques.primary_hit(first, x, 0) == (first, x, 0)
    techniques.primary_hit(first, 299, 0)
    assert len(traced) == 300
    techniques.primary_hit(first, 0, 0)  # the least recent of 300 scenes is no longer cached
    assert len(traced) == 301
    del first
    gc.collect()
    assert alive() is not None
    for _ in range(4):
        techniques.primary_hit(Stub(), 0, 0)
    gc.collect()
    assert alive() is None
    techniques.hits_of.cache_clear()
