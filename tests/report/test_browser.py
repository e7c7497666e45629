"""The report in Chromium: tooltips, legends, sorting, phones, print; no network and no errors."""

from collections.abc import Callable
from importlib.resources import files
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page
from tests.report.drawing import no_pdf

from mcspectra.cli.main import main
from mcspectra.report import write_comparison, write_report

pytestmark = pytest.mark.browser
Make = dict[str, Callable[..., Any]]
LOCAL = ("file:", "data:", "blob:", "about:", "http://127.0.0.1", "http://localhost")
# Bokeh puts tooltips at the end of the page; a search of the whole page would take far longer
_SHOWN = """word => Array.from(document.querySelectorAll("body > .bk-Tooltip"))
    .some(each => each.shadowRoot.textContent.includes(word))"""
EVIL = "</script><script>document.title='run'</script>$$x$$"


@pytest.fixture(scope="module", name="folder")
def _folder(make, once, tmp_path_factory):
    """Write reports of a small study, which has a malicious name, and of a comparison."""
    with no_pdf():
        return once("browser", lambda: _written(make, tmp_path_factory))


def _written(make, tmp_path_factory):
    root = tmp_path_factory.mktemp("browser")
    cells = {}
    for sampler in ("random", "jittered"):
        terms = make["terms"](sampler, matrix=True)
        cells["1-D", sampler] = {"convergence": make["curve"](sampler), "terms": terms}
    cells["2-D", "random"] = {"terms": make["terms"]("random", dims=2, half_width=6)}
    cells[EVIL, EVIL] = {"convergence": make["curve"]("random", rate=-1.2)}
    write_report(make["study"](root / "a", cells))
    make["study"](root / "b", {("1-D", "random"): {"convergence": make["curve"](rate=-1.3)}})
    write_comparison(root / "a", root / "b", root / "comparison.html")
    return root


@pytest.fixture(scope="module", name="images")
def _images(once, tmp_path_factory):
    """Write the pages of a map, of frames and of a gate."""
    return once("images", lambda: _pages_of_images(tmp_path_factory))


def _pages_of_images(tmp_path_factory):
    root, rng = tmp_path_factory.mktemp("images"), np.random.default_rng(1)
    for name, mean in (("new", 0.9), ("old", 1.0)):
        (root / name).mkdir()
        for k in range(6):
            image = mean * (1 + 0.2 * rng.standard_normal((24, 24)))
            np.save(root / name / f"v_16spp_{k}.npy", image.astype(np.float32))
    new, old = str(root / "new"), str(root / "old")
    small = ["--size", "24,16", "--crop", "8,6,6,4", "--counts", "4,16", "-m", "8"]
    for code, words in (
        (0, ["map", "veach", *small, "-o", str(root / "map")]),
        (0, ["frames", new, "--against", old, "-o", str(root / "frames")]),
        (3, ["gate", new, old, "-o", str(root / "gate")]),
    ):
        with no_pdf():
            assert main([*words, "--quiet"]) == code
    return root


class Visit:
    """An open page with its network requests and error messages."""

    def __init__(self, browser, path, **options):
        self.asked: list[str] = []
        self.complaints: list[str] = []
        context = browser.new_context(**options)
        self.page: Page = context.new_page()
        self.page.route("**/*", self._route)
        self.page.on("console", self._note)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(path.as_uri())

    def _route(self, route):
        if route.request.url.startswith(LOCAL):
            route.continue_()
        else:
            self.asked.append(route.request.url)
            route.abort()

    def _note(self, message):
        if message.type in ("error", "warning"):
            self.complaints.append(message.text)

    def show(self, label, *, last=False):
        """Scroll to the first or last plot whose words start with `label`, and wait for it."""
        self.unfold()
        found = self.page.locator(f".live:has(img[alt^='{label}'])")
        plot = (found.last if last else found.first).locator(".plot")
        plot.locator("xpath=../..").scroll_into_view_if_needed()
        plot.locator("canvas").first.wait_for(state="visible")
        self.page.wait_for_function("Bokeh.documents.every(d => d.is_idle)")
        return plot

    def unfold(self):
        """Open all details."""
        self.page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true; })")

    def wrongs(self):
        """Return the findings of axe-core that are serious or critical, in both color schemes."""
        self.page.evaluate((files("axe_playwright_python") / "axe.min.js").read_text("utf-8"))
        found = []
        # Only the contrast of colors depends on the scheme
        for scheme, rules in (("light", ""), ("dark", ", runOnly: ['color-contrast']")):
            self.page.emulate_media(color_scheme=scheme)
            run = f"axe.run({{resultTypes: ['violations']{rules}}})"
            found += self.page.evaluate(run)["violations"]
        return [
            f"{each['id']}: {each['nodes'][0]['html'][:200]} {each['nodes'][0]['failureSummary']}"
            for each in found
            if each["impact"] in ("serious", "critical")
        ]

    def leave(self):
        """Close the page, and check that there were no network requests and no errors."""
        self.page.context.close()
        assert self.asked == []
        assert self.complaints == []


@pytest.fixture(scope="module", name="visit")
def _visit(browser, folder):
    """Open the report of the study once for all tests that leave it as it was."""
    visit = Visit(browser, folder / "a" / "report.html")
    yield visit
    visit.leave()


def sweep(visit, plot, word):
    """Move the pointer over a plot, row by row, until a tooltip shows `word`."""
    box = plot.bounding_box()
    for part in range(100):
        x = box["x"] + box["width"] * (0.35 + 0.06 * (part % 10))
        visit.page.mouse.move(x, box["y"] + 60 + 17 * (part // 10))
        visit.page.wait_for_timeout(60)
        if visit.page.evaluate(_SHOWN, word):
            return True
    return False


def test_tooltips_show_exact_values(visit):
    assert sweep(visit, visit.show("Bars of the three terms"), "95 %:")
    assert sweep(
        visit,
        visit.show(
            "Signed contribution of each frequency to the variance. random: largest", last=True
        ),
        "power part:",
    )


def test_a_click_in_the_legend_hides_a_line(visit):
    plot = visit.show("Logarithmic plot of variance")
    hidden = """() => Bokeh.documents.flatMap(d => Array.from(d._all_models.values()))
        .filter(m => m.type === "GlyphRenderer" && !m.visible).length"""
    assert visit.page.evaluate(hidden) == 0
    plot.get_by_text("jittered −3.00 ± 0.03").click()
    assert visit.page.evaluate(hidden) == 3  # points, whiskers and fitted line
    plot.get_by_text("jittered −3.00 ± 0.03").click()
    assert visit.page.evaluate(hidden) == 0


def test_the_summary_table_can_be_sorted(visit):
    head = visit.page.get_by_role("button", name="Rate")
    rates = """() => Array.from(document.querySelectorAll(".sortable tbody tr"))
        .map(row => row.cells[2].dataset.order ?? null)"""
    # A key reaches the button also while plots are still laid out, which moves it under a pointer
    head.press("Enter")
    assert visit.page.evaluate(rates) == ["-3.0", "-1.2", "-1.0", None]
    head.press("Enter")
    assert visit.page.evaluate(rates) == ["-1.0", "-1.2", "-3.0", None]
    assert visit.page.locator("th[aria-sort='descending']").count() == 1
    visit.page.get_by_role("button", name="Sampler").press("Enter")


@pytest.mark.parametrize("name", ["a/report.html", "comparison.html", "bench"])
def test_all_plots_are_drawn_without_overflow_or_serious_axe_findings(browser, request, name):
    """Check the page on a phone and on a desktop, in both color schemes."""
    # A worker without the test of the bench need not write its page
    if name == "bench":
        path = request.getfixturevalue("bench_page")
    else:
        path = request.getfixturevalue("folder") / name
    visit = Visit(browser, path, viewport={"width": 390, "height": 800})
    visit.unfold()
    # Elements, not locators, which search the whole page again at each step
    for place in visit.page.query_selector_all(".live"):
        place.scroll_into_view_if_needed()
        place.wait_for_selector("canvas", state="visible")
    for width in (390, 1200):
        visit.page.set_viewport_size({"width": width, "height": 800})
        assert visit.page.evaluate("document.documentElement.scrollWidth") <= width
    assert visit.wrongs() == []
    assert visit.page.title() != "run"
    visit.leave()


@pytest.mark.render
@pytest.mark.parametrize("name", ["map", "frames", "gate"])
def test_pages_of_images_have_no_overflow_and_no_serious_axe_findings(browser, images, name):
    visit = Visit(browser, images / name / "report.html", viewport={"width": 390, "height": 800})
    visit.unfold()
    for width in (390, 1200):
        visit.page.set_viewport_size({"width": width, "height": 800})
        assert visit.page.evaluate("document.documentElement.scrollWidth") <= width
    assert visit.wrongs() == []
    visit.leave()


def test_images_replace_plots_without_scripts_and_in_print(browser, folder):
    visit = Visit(browser, folder / "a" / "report.html", java_script_enabled=False)
    for summary in visit.page.locator("summary").all():
        summary.click()
    assert visit.page.locator("img:visible").count() == visit.page.locator("img").count() > 9
    assert visit.page.locator("th button").count() == 0
    visit.leave()
    visit = Visit(browser, folder / "a" / "report.html")
    plot = visit.show("Logarithmic plot of variance")
    visit.page.emulate_media(media="print")
    assert not plot.is_visible()
    assert visit.page.locator("img:visible").count() == visit.page.locator("img").count()
    assert visit.page.pdf().startswith(b"%PDF")
    # A sheet of A4 is narrower than a tablet, but has two figures side by side
    visit.page.set_viewport_size({"width": 794, "height": 1123})
    columns = "g => getComputedStyle(g).gridTemplateColumns.split(' ').length"
    galleries = visit.page.locator(".gallery:not(.strip)").all()
    assert {gallery.evaluate(columns) for gallery in galleries} == {2}
    visit.leave()


def test_a_link_into_closed_details_opens_them(visit):
    visit.page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = false; })")
    inside = visit.page.locator("details dl").first
    assert not inside.is_visible()
    inside.evaluate("d => { d.id = 'x'; location.hash = 'x'; }")
    inside.wait_for(state="visible")
