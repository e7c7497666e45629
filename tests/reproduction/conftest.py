"""Checks for every exhibit, and exhibits with wrong parts."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest
from tests.fonts import fonts_once

from mcspectra.plots import backend_matplotlib
from mcspectra.reproduction.claims import Exhibit
from mcspectra.reproduction.gallery import Slide, make_exhibit

__all__ = ["fonts_once"]

Disagreeing = Callable[..., list[int]]


@pytest.fixture(scope="session", name="sound")
def _sound() -> Callable[..., None]:
    """Check that all claims agree, all texts exist, and Matplotlib draws every plot."""

    def check(made: Exhibit, slides: tuple[Slide, ...] = ()) -> None:
        assert [f.statement for f in made.findings if f.agrees is not True] == []
        assert all(len(slide.reason) > 60 for slide in slides)
        for plot in made.plots:
            assert len(plot.words) > 40
            assert len(plot.caption) > 40
            backend_matplotlib.draw(plot)

    return check


@pytest.fixture(name="disagreeing")
def _disagreeing(monkeypatch: pytest.MonkeyPatch) -> Disagreeing:
    """Replace names of a module, make its exhibit, and return the findings that do not agree.

    The exhibit is made with all its texts.
    """

    def made(module: ModuleType, **others: Any) -> list[int]:
        for name, other in others.items():
            monkeypatch.setattr(module, name, other)
        name = module.__name__.rpartition(".")[2].replace("_", "-")
        found = make_exhibit(name, quick=True, seed=1)[0].findings
        return [
            place
            for place, finding in enumerate(found)
            if finding.agrees is False or "are needed to decide" in finding.note
        ]

    return made
