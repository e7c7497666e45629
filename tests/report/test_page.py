"""Pages: order of blocks, escaping, self-containment, atomic writing, descriptions of figures."""

import base64
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from tests.report.parsed import Parsed

from mcspectra.core.errors import StoreError
from mcspectra.plots import backend_matplotlib
from mcspectra.plots.description import Axis, Line, Panel, Plot
from mcspectra.report.page import (
    Collapsible,
    FactList,
    Figure,
    Figures,
    Markup,
    Page,
    Paragraph,
    Section,
    Sentences,
    Table,
    TableCell,
    anchors,
    columns_of,
    maths,
    powers,
    table_of,
    write_json,
    write_page,
)

EVIL = "</script><u>&\"'"


def plot(words="A line from 0 to 1.", kind="line"):
    x = np.array([0.0, 1.0])
    panel = Panel(marks=(Line(x=x, y=x, color="#0072B2"),), x=Axis(label="x"), y=Axis(label="y"))
    return Plot(kind=kind, panels=(panel,), caption="A line.", words=words)


def page(evil=EVIL, live=False):
    table = Table(
        caption=evil,
        columns=("Name", "Value", "Why"),
        rows=(
            (
                TableCell(text=evil, link="#a"),
                TableCell(text="1.0", order=1.0),
                TableCell(text="–", why=evil),
            ),
            (
                TableCell(text="b", numeric=False),
                TableCell(text="2", order=2.0),
                TableCell(text="agrees", mark="yes"),
            ),
        ),
        sortable=True,
        stacked=True,
    )
    blocks = (
        Paragraph(text=evil),
        Paragraph(text=evil, kind="heading"),
        Paragraph(text=evil, kind="quote"),
        Paragraph(text=evil, kind="code"),
        Paragraph(text=Markup("<math><mi>x</mi></math>"), kind="formula"),
        FactList(rows=((evil, evil),), code=True),
        Sentences(rows=((evil, evil),)),
        table,
        Collapsible(
            summary=evil, blocks=(Figures(figures=(Figure(plot=plot(evil), name="folded"),)),)
        ),
        Figures(figures=(Figure(plot=plot(), name="a-line", live=live),)),
    )
    first = Section(title=evil, anchor="a", blocks=blocks, beside=evil, mark="no", fresh=True)
    second = Section(title="b", anchor="b", blocks=(Paragraph(text="b"),), code=True)
    left_out = Section(title="c", anchor="c", blocks=())
    return Page(
        title=evil, what="test", lead=(Paragraph(text=evil),), sections=(first, second, left_out)
    )


def test_regions_have_distinct_labels(tmp_path):
    """Equal tables in one section and in two sections have different labels."""
    table = table_of("Rates.", ("Name",), [("a",)])
    sections = [Section(title=t, anchor=t, blocks=(table, table)) for t in ("one", "two")]
    file = write_page(Page(title="p", what="test", sections=tuple(sections)), tmp_path / "x.html")
    found = [each["aria-label"] for each in Parsed(file.read_text("utf-8")).all("div")]
    assert found == ["one: Rates.", "one: Rates. (2)", "two: Rates.", "two: Rates. (2)"]


@pytest.mark.parametrize(("count", "classes"), [(1, "wide"), (2, "wide abreast")])
def test_only_panels_in_one_row_scroll_on_a_phone(tmp_path, count, classes):
    wide = replace(plot(), panels=plot().panels * count, columns=2, wide=True)
    section = Section(title="a", anchor="a", blocks=(Figures(figures=(Figure(plot=wide),)),))
    file = write_page(Page(title="p", what="test", sections=(section,)), tmp_path / "x.html")
    assert Parsed(file.read_text("utf-8")).all("figure") == [{"class": classes}]


def test_row_headers_that_are_numbers_have_a_label_on_a_phone(tmp_path):
    table = table_of("", ("n", "Variance"), [("16", "0.5")], words=(), stacked=True)
    section = Section(title="a", anchor="a", blocks=(table,))
    file = write_page(Page(title="p", what="test", sections=(section,)), tmp_path / "x.html")
    found = Parsed(file.read_text("utf-8"))
    assert {"scope": "row", "data-label": "n"} in found.all("th")


def test_figures_without_a_neighbor_are_full_width(tmp_path):
    """A figure without a neighbor takes both columns, and so does a row of live panels."""
    rows = Figure(plot=replace(plot(), panels=plot().panels * 4, columns=2), live=True)
    three = Figure(plot=replace(plot(), panels=plot().panels * 3, columns=3))
    figures = tuple(Figure(plot=plot()) for _ in range(3))
    blocks = (Figures(figures=(figures[0], rows, figures[1], figures[2], three)),)
    section = Section(title="a", anchor="a", blocks=blocks)
    file = write_page(Page(title="p", what="test", sections=(section,)), tmp_path / "x.html")
    classes = [each.get("class", "") for each in Parsed(file.read_text("utf-8")).all("figure")]
    assert classes == ["", "wide abreast", "", "alone", "wide abreast"]


def test_all_text_is_escaped_and_all_tags_close(tmp_path):
    text = write_page(page(), tmp_path / "x.html").read_text(encoding="utf-8")
    found = Parsed(text)
    assert "<u>" not in text
    assert found.text.count(EVIL) >= 15
    assert EVIL in str(found.all("img")[0]["alt"])
    assert found.all("abbr") == [{"title": EVIL}]
    assert "<math><mi>x</mi></math>" in text
    assert {a["href"] for a in found.all("a")} == {"#a", "#b"}
    assert [d["data-order"] for d in found.all("td") if "data-order" in d] == ["1.0", "2.0"]
    assert all(image["alt"] for image in found.all("img"))


def test_nothing_is_loaded(tmp_path):
    text = write_page(page(), tmp_path / "x.html").read_text(encoding="utf-8")
    assert not re.search(r"url\(|@import|<link|https?://(?!www\.w3\.org)", text)
    for image in Parsed(text).all("img"):
        head, _, data = str(image["src"]).partition(",")
        assert head == "data:image/png;base64"
        png = base64.b64decode(data)
        size = [int.from_bytes(png[i : i + 4], "big") for i in (16, 20)]
        assert size == [int(str(image[k])) for k in ("width", "height")]


def test_figures_become_files_where_a_folder_is_given(tmp_path):
    text = write_page(page(), tmp_path / "x.html", tmp_path / "figures").read_text("utf-8")
    names = sorted(each.name for each in (tmp_path / "figures").iterdir())
    assert names == ["a-line.pdf", "a-line.png", "folded.pdf", "folded.png"]
    assert "(figures/a-line.pdf)" in Parsed(text).text


def test_the_same_page_has_the_same_bytes(tmp_path):
    first, second = (write_page(page(live=True), tmp_path / n).read_bytes() for n in "ab")
    assert first == second


def test_live_figures_bring_the_script_once(tmp_path):
    found = Parsed(write_page(page(live=True), tmp_path / "x.html").read_text("utf-8"))
    packed = [s for s in found.all("script") if s.get("type") == "application/gzip"]
    assert [s.get("id") for s in packed] == [None, "bokeh"]
    assert sum(d.get("class") == "plot" for d in found.all("div")) == 1


def test_a_page_that_fails_leaves_the_old_one(tmp_path, monkeypatch):
    file = write_page(page(), tmp_path / "x.html")
    before = file.read_bytes()

    def fail(_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(backend_matplotlib, "draw", fail)
    with pytest.raises(StoreError.__mro__[1], match="cannot be written"):
        write_page(page(), file)
    assert file.read_bytes() == before


def test_a_missing_folder_gives_an_error(tmp_path):
    with pytest.raises(StoreError, match="cannot be written"):
        write_page(page(), tmp_path / "nowhere" / "x.html")
    with pytest.raises(StoreError, match="cannot be written"):
        write_json(tmp_path, {})


def test_json_is_strict(tmp_path):
    write_json(tmp_path / "new" / "x.json", {"a": np.array([1.0, math.nan]), "b": (math.inf, "∞")})
    text = (tmp_path / "new" / "x.json").read_text(encoding="utf-8")
    assert json.loads(text) == {"a": [1.0, None], "b": ["inf", "∞"]}


def test_anchors_are_distinct():
    assert anchors(["A b", "a-b", "c"], "e-") == ["e-a-b", "e-a-b-2", "e-c"]


def test_columns_are_chosen_by_name():
    table = table_of("", ("a", "b", "c"), [("1", "2", "3")])
    chosen = columns_of(table, ("c", "a"))
    assert chosen.columns == ("c", "a")
    assert [cell.text for cell in chosen.rows[0]] == ["3", "1"]


def test_values_inserted_in_html_are_escaped_once():
    inner = Markup("<b>{}</b>").format(EVIL)
    assert inner == "<b>&lt;/script&gt;&lt;u&gt;&amp;&quot;&#x27;</b>"
    assert Markup("<p>{}{}</p>").format(inner, 2) == f"<p>{inner}2</p>"


@pytest.mark.parametrize(
    ("text", "html"),
    [
        ("⟨S_m*⟩ = 0, f_m", "⟨S<sub>m</sub>*⟩ = 0, f<sub>m</sub>"),
        ("Var(I_N) ~ N^(−3/2), 2^d", "Var(I<sub>N</sub>) ~ N<sup>−3/2</sup>, 2<sup>d</sup>"),
        ("strata_shift <b>", "strata_shift &lt;b&gt;"),
    ],
)
def test_subscripts_and_exponents_become_html(text, html):
    assert maths(text) == html


@pytest.mark.parametrize(
    ("text", "html"),
    [
        ("falls as n^−1.5. Then", "falls as n<sup>−1.5</sup>. Then"),
        ("about as |t|^0.41", "about as |t|<sup>0.41</sup>"),
        ("file a_b^2x <b>", "file a_b^2x &lt;b&gt;"),
        (Markup("<i>n^2</i>"), "<i>n^2</i>"),
    ],
)
def test_numbers_in_exponents_of_sentences_are_raised(text, html):
    assert powers(text) == html


def test_figures_of_a_deck_have_larger_texts_and_more_pixels():
    """Half of the panel's width in inches with the same font size gives texts twice as large."""
    page, lecture = (
        backend_matplotlib.draw(plot()),
        backend_matplotlib.draw(plot(), look=backend_matplotlib.LECTURE),
    )
    zoom = backend_matplotlib.LECTURE.zoom
    assert lecture.get_figwidth() == pytest.approx(page.get_figwidth() / zoom)
    sizes = [
        backend_matplotlib.encode(figure, with_pdf=False, dpi=dpi)[0][16:20]
        for figure, dpi in ((page, 120), (lecture, backend_matplotlib.LECTURE.dpi))
    ]
    assert int.from_bytes(sizes[1], "big") > 1.2 * int.from_bytes(sizes[0], "big")


def test_symbolic_links_at_output_paths_are_not_followed(tmp_path):
    """A link made by somebody else could lead to any file."""
    key, figures = tmp_path / "key", tmp_path / "figures"
    key.write_text("mine")
    figures.mkdir()
    for name in (".x.html.partial", "x.html", "figures/a.png", "figures/a.pdf"):
        (tmp_path / name).symlink_to(key)
    section = Section(
        title="a", anchor="a", blocks=(Figures(figures=(Figure(plot=plot(), name="a"),)),)
    )
    write_page(Page(title="p", what="test", sections=(section,)), tmp_path / "x.html", figures)
    assert key.read_text() == "mine"
    assert not any(file.is_symlink() for file in tmp_path.rglob("*"))
