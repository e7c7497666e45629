"""Parts of the explorer's page, and waits for them."""

from urllib.parse import parse_qs, urlsplit

from playwright.sync_api import expect

from mcspectra.app.state import ExplorerState

PATIENCE = 90_000  # Milliseconds; a quiet machine needs less than one second
SMALL = "half_width=4&realizations=16&n=16&counts=4,16,64&density=linear(slope=0.5)"

# A search of the whole page visits ten thousand elements, so tests search the part that they mean


def head(page):
    """The messages and the table of results."""
    return page.locator("main > div").first


def figures(page):
    """The figures of both set-ups."""
    return page.locator("#figures")


def card(page, name):
    """A figure with its heading, by its label."""
    return figures(page).locator(f"[role=group][aria-label='{name}']")


def controls(page):
    """The controls of both set-ups."""
    return page.locator("aside")


def program(page):
    """The exported Python code."""
    return page.locator("main > div").last.get_by_role("textbox", name="As Python").input_value()


def open_state(page, address, query):
    """Load a state, unless the page shows it already, and wait for its job to end."""
    here = parse_qs(urlsplit(page.url).query) == parse_qs(query)
    if not (here and head(page).get_by_text("A: Done.").is_visible()):
        page.goto(f"{address}?{query}")
    done(page)


def any_state(page, address):
    """Show any state on the page; loading a page costs seconds."""
    if not (page.url.startswith(address) and head(page).get_by_text("A: Done.").is_visible()):
        open_state(page, address, SMALL)


def done(page, side="A"):
    """Wait for a side's job to end."""
    expect(head(page).get_by_text(f"{side}: Done.")).to_be_visible()


def wait_for(page, key, value):
    """Wait until the address holds a value."""
    page.wait_for_url(lambda url: parse_qs(urlsplit(url).query).get(key) == [value])


def state_of(page):
    """Return the state in the address."""
    return ExplorerState.from_query(urlsplit(page.url).query)
