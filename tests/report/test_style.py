"""Colours, labels, panels."""

import itertools

import matplotlib as mpl
import pytest

from mcspectra.report.style import (
    DASHES,
    PALETTE,
    labels,
    new_figure,
    panel_blocks,
    sampler_styles,
)


def test_sampler_styles__the_same_for_the_same_name_and_distinct() -> None:
    names = [f"s{i}" for i in range(len(PALETTE) * len(DASHES))]
    styles = sampler_styles([*names, "s0"])
    assert list(styles) == names
    assert len(set(styles.values())) == len(names)
    assert len({s.color for s in list(styles.values())[: len(PALETTE)]}) == len(PALETTE)


def test_sampler_styles__more_names_than_styles_repeat() -> None:
    assert len(sampler_styles([f"s{i}" for i in range(60)])) == 60


def test_labels__short_distinct_and_without_mathematics() -> None:
    names = ["sobol(" + "x" * 60 + f"{i}" + "y" * 60 + ")" for i in range(3)]
    made = labels([*names, "$a$"], 20)
    assert len(set(made.values())) == 4
    assert all(len(text) <= 20 for name, text in made.items() if name in names)
    assert made["$a$"] == r"\$a\$"


@pytest.mark.parametrize(("count", "parts"), list(itertools.product((1, 2, 3, 4, 7), (1, 2, 3))))
def test_panel_blocks__one_panel_for_each_part(count: int, parts: int) -> None:
    figure, blocks = panel_blocks(count, parts, 1.0)
    panels = [axes for block in blocks for axes in block]
    assert [len(block) for block in blocks] == [parts] * count
    assert len(set(map(id, panels))) == count * parts
    assert set(figure.axes) == set(panels)


def test_new_figure__pyplot_knows_nothing() -> None:
    before = dict(mpl.rcParams)
    figure = new_figure(3, 2)
    assert figure.canvas.manager is None
    assert dict(mpl.rcParams) == before
