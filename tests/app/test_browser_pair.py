"""The explorer with two set-ups in a real browser."""

from importlib.resources import files

import pytest
from playwright.sync_api import expect
from tests.app.visit import (
    PATIENCE,
    SMALL,
    card,
    controls,
    done,
    figures,
    head,
    open_state,
    state_of,
)

from mcspectra.app.state import ExplorerState

pytestmark = pytest.mark.browser
_CARDS = "[role=group][aria-label^='A: '], [role=group][aria-label^='B: ']"
_PLACES = "(a, b) => [a, b].map(each => each.getBoundingClientRect().toJSON())"
_PAIR = "&".join([SMALL, *(f"b.{each}" for each in SMALL.split("&")), "b.sampler=random"])


def test_the_default_page_opens_and_its_tab_closes_during_its_job(context, address):
    """This test comes first: the page of the next test computes after the abandoned job."""
    tab = context.new_page()
    tab.goto(address)
    expect(card(tab, "A and B: Convergence").locator("canvas").first).to_be_visible()
    expect(controls(tab).get_by_label("Sampler, A").first).to_be_visible()
    head(tab).get_by_text("% done.").first.wait_for()
    tab.close()


def test_the_address_restores_two_set_ups(page, address, terminal):
    open_state(page, address, _PAIR)
    done(page, "B")
    assert "Traceback" not in terminal.read_text()  # of the job whose tab was closed
    assert state_of(page) == ExplorerState.from_query(_PAIR)
    for title in ("Points", "Power spectrum", "Terms of the variance"):
        cards = [card(page, f"{side}: {title}") for side in "AB"]
        for side, each in zip("AB", cards, strict=True):
            expect(each.get_by_role("heading", name=f"{side}: {title}")).to_be_visible()
        # The figures of A and B are side by side, with A on the left, after they were laid out
        for _ in range(PATIENCE // 100):
            left, right = cards[0].evaluate(_PLACES, cards[1].element_handle())
            if left["y"] == right["y"] and left["right"] <= right["x"]:
                break
            page.wait_for_timeout(100)
        else:
            pytest.fail(f"{title}: A is at {left}, B is at {right}")
    # The curves of A and B are in one plot
    both = card(page, "A and B: Convergence")
    expect(both.get_by_role("heading", name="A and B: Convergence")).to_be_visible()
    expect(figures(page).locator(_CARDS)).to_have_count(16)


@pytest.mark.parametrize(
    ("scheme", "rules"), [("light", ""), ("dark", ", runOnly: ['color-contrast']")]
)
def test_axe_finds_nothing_serious(page, address, scheme, rules):
    """Only the contrast of colors depends on the scheme."""
    page.emulate_media(color_scheme=scheme)
    open_state(page, address, _PAIR)
    done(page, "B")
    page.evaluate((files("axe_playwright_python") / "axe.min.js").read_text("utf-8"))
    run = f"axe.run(document, {{resultTypes: ['violations']{rules}}})"
    found = page.evaluate(run)["violations"]
    page.emulate_media(color_scheme="light")
    assert [each["id"] for each in found if each["impact"] in ("serious", "critical")] == []


def test_the_plot_of_both_turns_gray_if_one_cannot_be_computed(page, address):
    open_state(page, address, _PAIR)
    done(page, "B")
    field = controls(page).get_by_label("Sampler spec, A", exact=True)
    field.fill("no-such")
    field.press("Enter")
    both = card(page, "A and B: Convergence")
    expect(both).to_have_css("opacity", "0.35")
    field.fill("jittered")
    field.press("Enter")
    done(page)
    expect(both).to_have_css("opacity", "1")


def test_a_second_set_up_goes(page, address):
    """In test_board.py::test_a_second_set_up_has_random_points, it comes."""
    open_state(page, address, _PAIR)
    done(page, "B")
    controls(page).get_by_role("checkbox", name="Compare with").uncheck()
    page.wait_for_url(lambda url: "b.sampler" not in url)
    expect(figures(page).locator(_CARDS)).to_have_count(9)
    expect(card(page, "A: Convergence")).to_be_visible()


def test_no_network_request_was_made_and_no_error_was_logged(page, seen):
    assert seen == {"elsewhere": [], "errors": []}
