"""Boards without a page: figures appear, disappear and turn gray with their results."""

from collections import OrderedDict
from dataclasses import replace
from queue import SimpleQueue

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.models import InlineStyleSheet

from mcspectra.app import compute as compute_module
from mcspectra.app.board import Board
from mcspectra.app.compute import UPDATE_KINDS, compute
from mcspectra.app.figures import FIGURES, figures_of
from mcspectra.app.page import Explorer, FirstPage
from mcspectra.app.state import ExplorerSetup, ExplorerState
from mcspectra.core.errors import McspectraError
from mcspectra.measure import convergence
from mcspectra.plots.backend_bokeh import Drawn

SMALL = ExplorerSetup(n=16, half_width=4, realizations=16, counts=(4, 16, 64))
SMALL_QUERY = ExplorerState(a=SMALL).query()


class Page:
    """A page as seen by a board: functions from a job run in the page's own thread."""

    def __init__(self):
        self.acts, self.texts = SimpleQueue(), []
        self.board = Board(
            "A", InlineStyleSheet(), later=self.acts.put, on_update=self.texts.append,
            on_shown=lambda: None,
        )  # fmt: skip


@pytest.fixture
def page():
    return Page()


@pytest.fixture
def board(page):
    return page.board


@pytest.fixture
def shown(page):
    """Run a set-up to its end; return the kinds of its figures."""

    def run(board, setup):
        board.run(setup)
        while board.busy:
            page.acts.get(timeout=60)()
        return set(board.cards)

    return run


def visible(explorer):
    """Return the places of figures that take room on the page."""
    roots = {name: root for name, root in explorer.roots.items() if ": " in name}
    return {name: root for name, root in roots.items() if root.visible}


def is_gray(board, kind):
    return board.cards[kind].layout.styles["opacity"] != "1"


def test_figures_of_another_number_of_dims_replace_earlier_ones(board, shown):
    assert shown(board, SMALL) == set(FIGURES) - {"lines", "cross-matrix"}
    assert shown(board, replace(SMALL, dims=1)) == set(FIGURES) - {"spectrum"}


def test_figures_turn_gray_and_back(board, shown):
    shown(board, SMALL)
    shown(board, replace(SMALL, sampler="no-such"))
    assert board.latest == {}
    assert all(is_gray(board, kind) for kind in board.cards)
    shown(board, SMALL)
    assert not any(is_gray(board, kind) for kind in board.cards)


def test_unchanged_figures_are_not_drawn_again(board, shown, monkeypatch):
    shown(board, SMALL)
    updated = []
    monkeypatch.setattr(Drawn, "update", lambda _, plot: updated.append(plot.kind))
    shown(board, replace(SMALL, strata_shift=0.25))
    assert "points" in updated
    assert "integrand" not in updated


def test_headings_name_the_side_of_a_pair(board, shown):
    shown(board, SMALL)
    board.pair(True)
    heading = board.cards["points"].layout.children[0]
    assert heading.text == "<h2>A: Points</h2>"
    board.pair(False)
    assert heading.text == "<h2>Points</h2>"


def test_panels_of_the_integrand_are_smaller_in_a_pair(board, shown):
    shown(board, SMALL)
    panels = board.cards["integrand"].drawn.model.children
    alone = [panel.frame_width for panel in panels]
    board.pair(True)
    assert all(panel.frame_width < alone[0] for panel in panels)
    assert [panel.left[0].visible for panel in panels] == [True, False, False]
    board.pair(False)
    assert [panel.frame_width for panel in panels] == alone
    assert all(panel.left[0].visible for panel in panels)


def test_a_refused_entry_leaves_gray_figures_and_no_numbers(board, shown):
    shown(board, SMALL)
    board.refuse("n is -5; give another.")
    assert board.latest == {}
    assert all(is_gray(board, kind) for kind in board.cards)


def test_the_curves_of_two_set_ups_share_a_plot():
    setups = ExplorerState(a=SMALL, b=replace(SMALL, sampler="random"))
    explorer = Explorer(Document(), setups.query())
    for k, (board, sampler) in enumerate(
        zip(explorer._boards.values(), ("jittered", "random"), strict=True)
    ):
        curve = convergence("gaussian", sampler, [4, 16], dims=2, realizations=20)
        board.latest["convergence"] = curve
        explorer._shown()
        assert len(visible(explorer)) == k
    (joint,) = visible(explorer)["A and B: convergence"].children
    assert joint.children[0].text == "<h2>A and B: Convergence</h2>"
    assert "A: jittered" in joint.children[2].text
    assert "B: random" in joint.children[2].text
    explorer._shown()
    assert visible(explorer)["A and B: convergence"].children == [joint]
    explorer._choose_comparison("", True, False)
    assert visible(explorer) == {}


def test_a_second_set_up_has_random_points(monkeypatch):
    """The box next to "Compare with a second set-up, B" adds it, with all else as in A."""
    explorer = Explorer(Document(), SMALL_QUERY)
    explorer._shown()  # the controls
    run = []
    monkeypatch.setattr(Board, "run", lambda board, setup: run.append((board, setup)))
    explorer._compare.active = True
    other = replace(SMALL, sampler="random")
    assert explorer.state == ExplorerState(a=SMALL, b=other)
    assert explorer.roots["head"].tags == [explorer.state.query(), True]
    assert list(explorer._controls) == ["A", "B"]
    assert run == [(explorer._boards["B"], other)]


def test_figures_of_two_set_ups_are_in_pairs():
    """If only one set-up has a figure, the place of the other's figure is blank."""
    setups = ExplorerState(a=SMALL, b=replace(SMALL, sampler="random"))
    explorer = Explorer(Document(), setups.query())
    (plot,) = figures_of("points", compute("points", SMALL, 2), "jittered")
    explorer._boards["A"]._place(plot)
    explorer._shown()
    found = visible(explorer)
    assert list(found) == ["A: points", "B: points"]
    assert [len(each.children) for each in found.values()] == [1, 0]
    explorer._choose_comparison("", True, False)
    assert list(visible(explorer)) == ["A: points"]


def test_a_new_figure_sends_only_its_own_models():
    """A change of one root element lays out and draws only the figures in this element."""
    document = Document()
    explorer = Explorer(document, SMALL_QUERY)
    for root in explorer.roots.values():
        document.add_root(root)
    explorer._shown()  # the first call also shows the controls
    events = []
    document.on_change(events.append)
    for kind in ("points", "spectrum"):
        for plot in figures_of(kind, compute(kind, SMALL, 16), "jittered"):
            explorer._boards["A"]._place(plot)
            events.clear()
            explorer._shown()
            moved = {each.model for each in events if each.attr == "children"}
            assert moved == {explorer.roots[f"A: {plot.kind}"]}
    events.clear()
    explorer._shown()
    assert events == []


def test_a_new_page_has_the_top_figure_if_its_results_are_cached():
    """The browser then gets this figure together with the page, and the controls later."""
    pair = ExplorerState(a=SMALL, b=replace(SMALL, sampler="random"))
    for state, kind, top in (
        (pair, "convergence", "A and B: convergence"),
        (ExplorerState(a=SMALL), "integrand", "A: integrand"),
    ):
        for _, setup in state.setups():
            compute(kind, setup, 16)
        explorer = Explorer(Document(), state.query())
        explorer.prepare()
        assert list(visible(explorer)) == [top]
        assert [explorer.roots[name].children for name in ("side", "foot")] == [[], []]


def test_a_new_page_computes_nothing(monkeypatch):
    monkeypatch.setattr(compute_module, "_computed", lambda *_: pytest.fail("computed"))
    monkeypatch.setattr(compute_module, "_RESULTS", OrderedDict())  # Without those of other tests
    for state in (
        ExplorerState(a=replace(SMALL, integrand="disk")),
        ExplorerState(a=replace(SMALL, seed=9), b=replace(SMALL, seed=9, sampler="random")),
    ):
        explorer = Explorer(Document(), state.query())
        explorer.prepare()
        assert visible(explorer) == {}


def test_the_early_figure_is_the_one_of_the_first_round():
    """It shows the same numbers as a page that has waited for its first round."""
    state = ExplorerState(a=SMALL, b=replace(SMALL, sampler="random"))
    curves = {side: compute("convergence", setup, 16) for side, setup in state.setups()}
    early, late = (Explorer(Document(), state.query()) for _ in range(2))
    early.prepare()
    card = early._both
    shown = [dict(source.data) for source in card.drawn._sources]
    for explorer in (early, late):
        for side, board in explorer._boards.items():
            board.latest["convergence"] = curves[side]
        explorer._shown()
    assert early._both is card
    assert len(shown) > 0
    for old, source in zip(shown, late._both.drawn._sources, strict=True):
        np.testing.assert_equal(old, dict(source.data))


def test_the_early_integrand_is_not_drawn_again_by_the_job(page, monkeypatch):
    page.board.latest["integrand"] = compute("integrand", SMALL, 16)
    assert page.board.show("integrand", SMALL) == ["integrand"]
    card, updated = page.board.cards["integrand"], []
    monkeypatch.setattr(Drawn, "update", lambda _, plot: updated.append(plot.kind))
    page.board.run(SMALL)
    while page.board.busy:
        page.acts.get(timeout=60)()
    assert page.board.cards["integrand"] is card
    assert "integrand" not in updated


def test_the_controls_come_with_the_first_figure():
    explorer = Explorer(Document(), SMALL_QUERY)
    (plot,) = figures_of("points", compute("points", SMALL, 2), "jittered")
    explorer._boards["A"]._place(plot)
    assert explorer.roots["side"].children == []
    explorer._shown()
    children = explorer.roots["side"].children
    assert explorer._controls["A"].layout in children[-1].children
    assert len(explorer.roots["foot"].children) == 2
    explorer._shown()
    assert explorer.roots["side"].children == children


def test_the_first_page_is_made_in_advance_and_used_once():
    first = FirstPage()
    assert first.take("n=16") is None  # other pages do not wait for the first page
    first.make()
    assert first.take("theme=dark") is None
    explorer = first.take("")
    assert explorer.state == Explorer(Document(), "").state
    assert list(visible(explorer)) == ["A and B: convergence"]
    assert first.take("") is None


def test_odd_addresses_get_a_sentence():
    explorer = Explorer(Document(), "n=100000000000")
    assert explorer.state == ExplorerState()
    assert explorer._refused.visible
    text = explorer._refused.text
    assert 'role="alert"' in text
    assert "give a whole number from 1 to 65536" in text
    assert "The defaults are shown." in text


def test_each_update_has_a_callback_of_its_own(page, board):
    """The browser gets a figure after the callback, even if all results are there already."""
    board.run(SMALL)
    acts = [page.acts.get(timeout=60) for _ in range(len(UPDATE_KINDS) + 1)]
    for done, act in enumerate(acts[:-1], start=1):
        act()
        assert list(board.latest) == list(UPDATE_KINDS[:done])
    acts[-1]()
    assert not board.busy


def test_texts_are_written_once_also_if_the_first_round_does_not_end(page, board, monkeypatch):
    board.run(SMALL)
    while board.busy:
        page.acts.get(timeout=60)()
    assert page.texts == [""]

    def fail(kind, setup, realizations):
        if kind == "spectrum":
            raise McspectraError("refused")
        return compute(kind, setup, realizations)

    monkeypatch.setattr(compute_module, "compute", fail)
    board.run(replace(SMALL, seed=1))
    while board.busy:
        page.acts.get(timeout=60)()
    assert page.texts == ["", ""]
    board.run(replace(SMALL, sampler="no-such"))
    while board.busy:
        page.acts.get(timeout=60)()
    assert page.texts[:2] == ["", ""]
    assert [text[:30] for text in page.texts[2:]] == ["There is no sampler called 'no"]
