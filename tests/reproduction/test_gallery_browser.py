"""The gallery in Chromium: contents, phones, dark mode, print; no network, scripts or errors."""

from importlib.resources import files

import pytest
from playwright.sync_api import Page

from mcspectra.reproduction import closed_forms, strata_alignment
from mcspectra.reproduction.gallery import load_exhibit, reproduce

pytestmark = pytest.mark.browser
NAMES = ["closed-forms", "strata-alignment", "bias"]
SCREENS = [
    *("start", "closed-forms", "edge-and-strata", "strata-alignment-convergence"),
    *("bias-coefficients", "provenance"),
]
EVIL = "</p><script>document.title = 'run'</script><img src=http://example.com/x.png>"


@pytest.fixture(scope="module", name="gallery")
def _gallery(tmp_path_factory):
    """Make two exhibits, and one that fails with an error message that contains markup.

    Pages look the same with a tenth of the realizations.
    """
    load, simulate, measured = load_exhibit, closed_forms.simulate, strata_alignment.measured

    def broken(*, quick, seed):
        raise ValueError(EVIL)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "mcspectra.reproduction.gallery.load_exhibit",
            lambda name: broken if name == "bias" else load(name),
        )
        patch.setattr(
            closed_forms,
            "simulate",
            lambda name, nu, realizations, *rest: simulate(name, nu, realizations // 10, *rest),
        )
        patch.setattr(
            strata_alignment,
            "measured",
            lambda f, sampler, realizations, seed: measured(f, sampler, realizations // 10, seed),
        )
        made = reproduce(tmp_path_factory.mktemp("gallery"), NAMES, quick=True)
    assert made.failed == ("bias",)
    return made.page.as_uri()


class Visits:
    """Opened pages of the gallery, their network requests and their error messages."""

    def __init__(self, browser, gallery):
        self.browser, self.gallery = browser, gallery
        self.asked: list[str] = []
        self.complaints: list[str] = []
        self.page: Page | None = None

    def open(self, **options):
        """Open the gallery in a new page with these options of Playwright."""
        page = self.browser.new_context(**options).new_page()
        page.route("**/*", self._route)
        page.on("console", self._note)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.goto(self.gallery)
        return page

    def __call__(self, width=1200, scheme="light"):
        """Return the page that all tests share, at its first screen and with all details closed."""
        if self.page is None:
            self.page = self.open()
        self.page.set_viewport_size({"width": width, "height": 800})
        self.page.emulate_media(color_scheme=scheme)
        self.page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = false; })")
        self.page.evaluate("location.hash = '#start'")
        self.page.wait_for_selector("#start.current")
        return self.page

    def _route(self, asking):
        if asking.request.url.startswith(("file:", "data:")):
            asking.continue_()
        else:
            self.asked.append(asking.request.url)
            asking.abort()

    def _note(self, message):
        if message.type in ("error", "warning"):
            self.complaints.append(message.text)


@pytest.fixture(scope="module", name="opened")
def _opened(browser, gallery):
    visits = Visits(browser, gallery)
    yield visits
    if visits.page is not None:
        visits.page.context.close()


@pytest.fixture(name="visit")
def _visit(opened):
    """Show the gallery; at the end, check that there were no network requests or errors."""
    yield opened
    assert (opened.asked, opened.complaints) == ([], [])


def _shown(page):
    """Return the ids of the visible screens."""
    return page.locator(".screen").evaluate_all(
        "all => all.filter(e => e.offsetHeight > 0).map(e => e.id)"
    )


def test_one_screen_is_shown_and_the_keyboard_turns_the_pages(visit):
    page = visit()
    assert _shown(page) == ["start"]
    for key, place in (("ArrowRight", 1), ("End", 5), ("ArrowLeft", 4), ("Home", 0)):
        page.keyboard.press(key)
        assert _shown(page) == [SCREENS[place]]
        assert page.url.endswith(f"#{SCREENS[place]}")
    assert page.evaluate("document.documentElement.scrollHeight") <= 0.2 * 53354


def test_thumbnails_go_to_their_slides(visit):
    page = visit()
    links = page.locator("nav ol a")
    assert links.evaluate_all("all => all.map(a => a.hash.slice(1))") == SCREENS
    links.nth(2).click()
    assert _shown(page) == [SCREENS[2]]
    assert links.nth(2).get_attribute("aria-current") == "true"


def test_a_slider_changes_the_figure(visit):
    page = visit()
    page.evaluate("location.hash = '#edge-and-strata'")
    page.wait_for_selector("#edge-and-strata.current")
    slider = page.locator("#edge-and-strata input")
    images = page.locator("#edge-and-strata .slides img")
    before = images.evaluate_all("all => all.findIndex(i => i.offsetHeight > 0)")
    slider.focus()
    page.keyboard.press("ArrowRight")
    assert images.evaluate_all("all => all.findIndex(i => i.offsetHeight > 0)") == before + 1
    assert page.locator("#edge-and-strata output").inner_text() == "0.75"


def test_without_scripts_all_slides_are_shown(visit):
    page = visit.open(java_script_enabled=False)
    for name in SCREENS:
        assert page.locator(f"#{name}").is_visible()
    assert page.locator(".slider").first.is_hidden()
    page.context.close()


def test_failures_are_shown_and_run_no_scripts(visit):
    page = visit()
    assert page.title() == "The slides, reproduced – mcspectra lecture"
    page.evaluate("location.hash = '#bias-coefficients'")
    page.wait_for_selector("#bias-coefficients.current")
    assert EVIL in page.locator("#bias-coefficients").inner_text()
    assert "Failed" in page.locator("#start").text_content()
    assert page.locator("#bias-coefficients img, #bias-coefficients script").count() == 0


@pytest.mark.parametrize(("width", "scheme"), [(390, "dark"), (1200, "light")])
def test_nothing_overflows_and_every_image_loads(visit, width, scheme):
    page = visit(width, scheme)
    for _ in SCREENS:
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.keyboard.press("ArrowRight")
    sizes = page.locator("main img").evaluate_all(
        "all => all.map(i => [i.naturalWidth, i.alt.length])"
    )
    assert len(sizes) >= 3
    assert all(pixels > 300 and letters > 40 for pixels, letters in sizes)
    outside = """all => all.filter(e => { const r = e.getBoundingClientRect();
        return r.left < 0 || r.right > innerWidth; }).map(e => e.textContent)"""
    assert (
        page.locator("main :is(h1, h2, p, li, blockquote, figcaption, dd)").evaluate_all(outside)
        == []
    )


@pytest.mark.parametrize(("width", "scheme"), [(390, "light"), (1300, "dark")])
def test_axe_finds_nothing_serious_on_any_screen(visit, width, scheme):
    page = visit(width, scheme)
    page.evaluate((files("axe_playwright_python") / "axe.min.js").read_text("utf-8"))
    wrong = set()
    for _ in SCREENS:
        page.evaluate(
            "document.querySelectorAll('.current details').forEach(d => { d.open = true; })"
        )
        found = page.evaluate("axe.run({resultTypes: ['violations']})")["violations"]
        wrong |= {
            f"{each['id']}: {each['nodes'][0]['html'][:200]} {each['nodes'][0]['failureSummary']}"
            for each in found
            if each["impact"] in ("serious", "critical")
        }
        page.locator("nav button").last.click()
    assert wrong == set()


def test_the_figure_of_a_screen_is_large_and_fits(visit):
    """A figure takes three eighths of the screen, and heading to folded parts need no scrolling."""
    page = visit(1300)
    page.set_viewport_size({"width": 1300, "height": 900})
    page.keyboard.press("ArrowRight")
    for name in SCREENS[1:-2]:
        box = page.locator(f"#{name} figure .frame").first.bounding_box()
        assert box["width"] * box["height"] > 0.375 * 1300 * 900
        folded = page.locator(f"#{name} > .folded").bounding_box()
        assert folded["y"] + folded["height"] <= page.locator("nav").bounding_box()["y"] + 1
        page.keyboard.press("ArrowRight")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_verdicts_have_enough_contrast(visit, scheme):
    """The WCAG 2.1 contrast is at least 4.5, as required for text of this size."""
    page = visit(scheme=scheme)
    colors = page.evaluate(
        """() => [document.body, ...document.querySelectorAll(".contents .yes, .contents .no")].map(
        (e, k) => getComputedStyle(e)[k ? "color" : "backgroundColor"].match(/[0-9.]+/g)
            .slice(0, 3).map(Number))"""
    )
    body, *verdicts = map(_luminance, colors)
    assert len(verdicts) == len(SCREENS) - 2
    for each in verdicts:
        assert (max(body, each) + 0.05) / (min(body, each) + 0.05) >= 4.5


def _luminance(color):
    """Return the relative luminance of an sRGB color with values from 0 to 255."""
    parts = [c / 255 for c in color]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return float(0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2])


def test_formulas_and_tables_fit_their_frames(visit):
    """Formulas are not cut off at the top or bottom, and phones show findings in one column."""
    page = visit()
    page.keyboard.press("ArrowRight")
    page.locator("#closed-forms summary").last.click()
    cut = "all => all.filter(e => e.scrollHeight > e.clientHeight).length"
    assert page.locator("#closed-forms .formula").count() == 1
    assert page.locator(".formula").evaluate_all(cut) == 0
    rows = page.locator("#closed-forms table.stacked").first.locator("tbody tr").first
    assert rows.evaluate("row => getComputedStyle(row).display") == "table-row"
    page.set_viewport_size({"width": 390, "height": 800})
    assert rows.evaluate("row => getComputedStyle(row).display") == "block"
    assert (
        page.locator(".scroll").evaluate_all(
            "all => all.filter(e => e.scrollWidth > e.clientWidth).length"
        )
        == 0
    )


def test_printing_gives_one_sheet_per_screen(visit):
    printed = visit().pdf(prefer_css_page_size=True)
    assert printed.count(b"/Type /Page\n") == len(SCREENS)
