"""The explorer in a real browser, without requests to other machines."""

import contextlib
import io
import urllib.error
import urllib.request

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect
from tests.app.visit import (
    PATIENCE,
    SMALL,
    any_state,
    card,
    controls,
    done,
    figures,
    head,
    open_state,
    program,
    state_of,
    wait_for,
)

from mcspectra.app.state import THEMES
from mcspectra.plots.text import number

pytestmark = pytest.mark.browser


def test_all_widgets_have_names(page, address):
    open_state(page, address, SMALL)
    expect(controls(page).get_by_role("slider", name="Points n, A", exact=True)).to_be_visible()
    name = "Compare with a second set-up, B"
    expect(controls(page).get_by_role("checkbox", name=name, exact=True)).to_be_visible()
    lines = page.locator("body").aria_snapshot().splitlines()
    for role in ("slider", "checkbox", "combobox", "textbox", "button", "figure", "progressbar"):
        own = [line.strip() for line in lines if line.strip().startswith(f"- {role}")]
        assert all('"' in line for line in own), own
    bar = page.get_by_role("progressbar", name="Progress of A", exact=True)
    expect(bar).to_have_count(1)


def test_copied_python_gives_the_displayed_figures(page, address):
    open_state(page, address, SMALL)
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(program(page), "copied", "exec"), {})  # noqa: S102
    found = dict(line.split() for line in printed.getvalue().splitlines())
    cells = head(page).get_by_role("row", name="A jittered").get_by_role("cell").all_inner_texts()
    assert cells[2] == number(float(found["measured_variance"]))
    shown = float(cells[4].split()[0].replace("−", "-"))
    assert shown == pytest.approx(float(found["rate"]), abs=5e-3)


def test_an_invalid_entry_leaves_gray_figures_and_no_numbers(page, address):
    open_state(page, address, SMALL)
    height = page.evaluate("document.documentElement.scrollHeight")
    field = controls(page).get_by_label("Sampler spec, A", exact=True)
    field.fill("no-such")
    field.press("Enter")
    expect(head(page).get_by_role("alert")).to_contain_text(
        "A: There is no sampler called 'no-such'"
    )
    expect(field).to_have_value("no-such")
    figure = card(page, "A: Convergence")
    expect(figure).to_have_css("opacity", "0.35")
    assert page.evaluate("document.documentElement.scrollHeight") == pytest.approx(height, abs=80)
    row = head(page).get_by_role("row", name="A no-such")
    assert row.get_by_role("cell").all_inner_texts()[2:] == ["–", "–", "–"]
    assert program(page).startswith("# There is no")
    field.fill("jittered")
    field.press("Enter")
    done(page)
    expect(figure).to_have_css("opacity", "1")


def test_a_narrow_page_does_not_scroll_sideways(page, address):
    any_state(page, address)
    page.set_viewport_size({"width": 390, "height": 800})
    page.wait_for_timeout(500)  # Figures follow the width of the page in later frames
    page.wait_for_function("document.documentElement.scrollWidth <= 390", timeout=10_000)
    page.set_viewport_size({"width": 1300, "height": 900})


def test_the_theme_is_the_browsers_unless_it_is_chosen(page, address):
    any_state(page, address)
    for theme in THEMES:  # the server sends the choice; loading the page again takes seconds
        with urllib.request.urlopen(f"{address}?{SMALL}&theme={theme}") as answer:
            assert f'<html lang="en" data-theme="{theme}">' in answer.read().decode()
    colors = {}
    for theme in THEMES:
        page.evaluate("theme => { document.documentElement.dataset.theme = theme; }", theme)
        for preferred in ("light", "dark"):
            page.emulate_media(color_scheme=preferred)
            color = page.evaluate("getComputedStyle(document.body).backgroundColor")
            colors[theme, preferred] = color
    page.emulate_media(color_scheme="light")
    page.evaluate("document.documentElement.dataset.theme = 'auto'")
    light, dark = "rgb(255, 255, 255)", "rgb(27, 30, 35)"
    assert colors == {
        ("auto", "light"): light, ("auto", "dark"): dark,
        ("light", "light"): light, ("light", "dark"): light,
        ("dark", "light"): dark, ("dark", "dark"): dark,
    }  # fmt: skip


def test_the_integrand_is_next_to_its_density(page, address):
    open_state(page, address, SMALL)
    figure = figures(page).locator("[role=group][aria-label^='A: Integrand f']")
    expect(figure.get_by_text("f/p from")).to_be_visible()
    assert figure.locator("canvas").count() >= 3


def test_a_slider_by_keyboard(page, address):
    open_state(page, address, SMALL)
    controls(page).get_by_role("slider", name="Strata shift, A").press("ArrowRight")
    wait_for(page, "strata_shift", "0.05")
    controls(page).get_by_role("slider", name="Density slope, A").press("ArrowRight")
    wait_for(page, "density", "linear(slope=0.55)")
    done(page)
    expect(head(page).get_by_role("cell", name="strata-shift(offset=0.05)")).to_be_visible()


def test_another_sampler_and_a_randomization(page, address):
    any_state(page, address)
    controls(page).get_by_label("Sampler, A").first.select_option("sobol")
    wait_for(page, "sampler", "sobol")
    controls(page).get_by_role("checkbox", name="owen").check()
    wait_for(page, "sampler", "sobol | owen")
    done(page)
    expect(figures(page).get_by_role("figure", name="plot of variance against n")).to_be_visible()


@pytest.mark.render
def test_a_pixel_of_the_scene(page, address):
    any_state(page, address)
    controls(page).get_by_role("button", name="Show Veach's scene, A").click()
    picture = page.get_by_role("figure", name="Veach's scene")
    expect(picture).to_be_visible()
    picture.scroll_into_view_if_needed()
    page.wait_for_timeout(500)
    place = picture.bounding_box()
    assert place is not None
    x, y = place["x"] + 0.6 * place["width"], place["y"] + 0.5 * place["height"]
    # The picture is shown: the plates are lit
    image = Image.open(io.BytesIO(page.screenshot())).convert("L")
    box = (int(x) - 60, int(y) - 40, int(x) + 60, int(y) + 40)
    assert np.ptp(np.asarray(image.crop(box), float)) > 100
    page.mouse.click(x, y)
    page.wait_for_url("**integrand=pixel**")
    assert "veach" in state_of(page).a.integrand
    # The mouse wheel scrolls the page, also over the clicked picture
    before = page.evaluate("window.scrollY")
    page.mouse.wheel(0, 200)
    page.wait_for_function("before => window.scrollY > before", arg=before)
    done(page)


def test_a_formula(page, address):
    any_state(page, address)
    field = controls(page).get_by_label("Formula, A", exact=True)
    field.fill("__import__('os')")
    field.press("Enter")
    expect(head(page).get_by_role("alert")).to_contain_text("no function '__import__'")
    field.fill("exp(-x/2)*(y < 0.5)")
    field.press("Enter")
    wait_for(page, "integrand", "formula(expression='exp(-x/2)*(y < 0.5)')")
    done(page)


def test_a_broken_picture_gets_a_sentence(page, address, tmp_path):
    if not page.url.startswith(address):
        any_state(page, address)
    file = tmp_path / "broken.png"
    file.write_bytes(b"\x89PNG\r\n\x1a\nnothing")
    controls(page).locator("input[type=file]").set_input_files(file)
    expect(head(page).get_by_role("alert")).to_contain_text("damaged")


@pytest.mark.slow  # test_board.py::test_odd_addresses_get_a_sentence is quick
def test_odd_addresses_get_a_sentence(page, address):
    page.goto(f"{address}?n=100000000000")
    expect(head(page).get_by_role("alert")).to_contain_text("give a whole number from 1 to 65536")
    expect(card(page, "A: Points")).to_be_visible()
    expect(head(page).get_by_role("alert")).to_contain_text("The defaults are shown.")


@pytest.mark.slow  # test_server.py::test_the_first_document_has_the_top_figure… is quick
def test_the_default_page_opens_again_and_in_another_tab(page, address):
    """The first page is made in advance; a reload and another tab get pages of their own."""
    other = page.context.new_page()
    for tab, load in ((page, "goto"), (page, "reload"), (other, "goto")):
        getattr(tab, load)(*([address] if load == "goto" else []))
        both = card(tab, "A and B: Convergence")
        expect(both.locator("canvas").first).to_be_visible(timeout=PATIENCE)
        expect(controls(tab).get_by_label("Sampler, A").first).to_be_visible(timeout=PATIENCE)
    other.close()


@pytest.mark.parametrize(
    ("header", "value"), [("Host", "evil.example"), ("Origin", "http://evil.example")]
)
@pytest.mark.parametrize("path", ["", "ws", "static/js/bokeh.min.js", "no-such"])
def test_other_hosts_and_origins_are_refused(address, header, value, path):
    request = urllib.request.Request(address + path, headers={header: value})
    with pytest.raises(urllib.error.HTTPError) as caught:
        urllib.request.urlopen(request)
    with caught.value as answer:
        assert answer.code == 403
        assert b"only its own pages" in answer.read()


def test_no_network_request_was_made_and_no_error_was_logged(page, seen):
    assert seen == {"elsewhere": [], "errors": []}
