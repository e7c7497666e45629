"""The gallery in Chromium: contents, phones, dark mode, print; no network, scripts or errors."""

import pytest
from playwright.sync_api import Page

from mcspectra.reproduction.gallery import load_exhibit, reproduce

pytestmark = pytest.mark.browser
NAMES = ["closed-forms", "strata-alignment", "bias"]
EVIL = "</p><script>document.title = 'run'</script><img src=http://example.com/x.png>"
SHOWN = """name => { const y = document.getElementById(name).getBoundingClientRect().y;
    return y > -1 && y < innerHeight; }"""  # scroll positions are whole pixels


@pytest.fixture(scope="module", name="gallery")
def _gallery(tmp_path_factory):
    """Make two exhibits, and one that fails with an error message that contains markup."""
    load = load_exhibit

    def broken(*, quick, seed):
        raise ValueError(EVIL)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "mcspectra.reproduction.gallery.load_exhibit",
            lambda name: broken if name == "bias" else load(name),
        )
        made = reproduce(tmp_path_factory.mktemp("gallery"), NAMES, quick=True)
    assert made.failed == ("bias",)
    return made.page.as_uri()


@pytest.fixture(name="visit")
def _visit(browser, gallery):
    """Open the gallery; at the end, check that there were no network requests or errors."""
    asked: list[str] = []
    complaints: list[str] = []
    opened: list[Page] = []

    def route(asking):
        if asking.request.url.startswith(("file:", "data:")):
            asking.continue_()
        else:
            asked.append(asking.request.url)
            asking.abort()

    def note(message):
        if message.type in ("error", "warning"):
            complaints.append(message.text)

    def visit(width=1200, **options):
        context = browser.new_context(viewport={"width": width, "height": 800}, **options)
        page = context.new_page()
        page.route("**/*", route)
        page.on("console", note)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(gallery)
        opened.append(page)
        return page

    yield visit
    for page in opened:
        page.context.close()
    assert (asked, complaints) == ([], [])


def test_contents_link_to_every_figure(visit):
    page = visit()
    links = page.locator("nav a")
    assert links.evaluate_all("all => all.map(a => a.hash.slice(1))") == [*NAMES, "provenance"]
    for place, name in enumerate(NAMES):
        page.evaluate("scrollTo(0, 0)")
        links.nth(place).press("Enter")
        assert page.url.endswith(f"#{name}")
        page.wait_for_function(SHOWN, arg=name)


def test_failures_are_shown_and_run_no_scripts(visit):
    page = visit()
    assert page.title() == "The slides, reproduced – mcspectra gallery"
    assert EVIL in page.locator("#bias").inner_text()
    assert page.locator("nav li").nth(2).inner_text().endswith("failed")
    assert page.locator("#bias img, #bias script").count() == 0


@pytest.mark.parametrize(("width", "scheme"), [(390, "dark"), (1200, "light")])
def test_nothing_overflows_and_every_image_loads(visit, width, scheme):
    page = visit(width, color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    sizes = page.locator("img").evaluate_all("all => all.map(i => [i.naturalWidth, i.alt.length])")
    assert len(sizes) >= 3
    assert all(pixels > 300 and letters > 40 for pixels, letters in sizes)
    outside = """all => all.filter(e => { const r = e.getBoundingClientRect();
        return r.left < 0 || r.right > innerWidth; }).map(e => e.textContent)"""
    assert page.locator("h1, h2, p, li, blockquote, figcaption, dd").evaluate_all(outside) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_verdicts_have_enough_contrast(visit, scheme):
    """The WCAG 2.1 contrast is at least 4.5, as required for text of this size."""
    page = visit(color_scheme=scheme)
    colors = page.evaluate(
        """() => [document.body, ...document.querySelectorAll("nav .yes, nav .no")].map(
        (e, k) => getComputedStyle(e)[k ? "color" : "backgroundColor"].match(/[0-9.]+/g)
            .slice(0, 3).map(Number))"""
    )
    body, *verdicts = map(_luminance, colors)
    assert len(verdicts) == len(NAMES)
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
    cut = "all => all.filter(e => e.scrollHeight > e.clientHeight).length"
    assert page.locator(".formula").count() == 1
    assert page.locator(".formula").evaluate_all(cut) == 0
    rows = page.locator("table.stacked").first.locator("tbody tr").first
    assert rows.evaluate("row => getComputedStyle(row).display") == "table-row"
    page.set_viewport_size({"width": 390, "height": 800})
    assert rows.evaluate("row => getComputedStyle(row).display") == "block"
    assert (
        page.locator(".scroll").evaluate_all(
            "all => all.filter(e => e.scrollWidth > e.clientWidth).length"
        )
        == 0
    )


def test_the_page_can_be_printed(visit):
    assert visit().pdf().startswith(b"%PDF")
