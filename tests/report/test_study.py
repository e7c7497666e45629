"""The page of a study: structure, escaping, self-containment, unusual results, reproducibility."""

import math
import re
import socket
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.report.conftest import blank_figures
from tests.report.parsed import Parsed

import mcspectra as mcs
from mcspectra.core.errors import StoreError
from mcspectra.plots.text import number
from mcspectra.report import study as module
from mcspectra.report import write_report
from mcspectra.report.page import Paragraph, Table
from mcspectra.report.study import study_toml
from mcspectra.studies import StudyStatus, open_results
from mcspectra.studies.files import decode_study, plain_study
from mcspectra.studies.ledger import StudyNote

Make = dict[str, Callable[..., Any]]


@pytest.fixture(scope="module")
def folder(once, request):
    """Write the report of a small study; `test_page_at_another_path` draws figures as well."""

    def written():
        study = Path(request.getfixturevalue("study_folder"))
        with blank_figures():
            write_report(study)
        return study

    return once("report", written)


@pytest.fixture(scope="module")
def page(folder):
    """Return the parsed page."""
    return Parsed((folder / "report.html").read_text(encoding="utf-8"))


@pytest.fixture
def blank():
    """Replace the contents of figure files by nothing."""
    with blank_figures():
        yield


def test_sections(page):
    ids = [attributes["id"] for attributes in page.all("section")]
    assert ids[-2:] == ["summary", "provenance"]
    assert len(ids) == 4
    links = {attributes["href"] for attributes in page.all("a")}
    assert links == {f"#{i}" for i in ids}
    assert Counter(tag for tag, _ in page.tags)["h1"] == 1
    assert all(attributes["scope"] in ("col", "row") for attributes in page.all("th"))


def test_ids_are_unique(page):
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(set(ids)) == len(ids)


def test_interactive_figures_also_have_images(page):
    packed = [s for s in page.all("script") if s.get("type") == "application/gzip"]
    assert packed.pop()["id"] == "bokeh"
    assert len(packed) == 6 + 3  # all but captured, bands and cross-matrix
    plots = [d for d in page.all("div") if d.get("class") == "plot"]
    assert len(plots) == len(packed)


def test_summary_can_be_sorted_and_links_to_sections(page):
    (table,) = (t for t in page.all("table") if t.get("class") == "sortable")
    assert table
    orders = [float(str(d["data-order"])) for d in page.all("td") if "data-order" in d]
    assert -3.0 in orders
    assert all(math.isfinite(order) for order in orders)


def test_page_at_another_path(make, tmp_path):
    study = make["study"](tmp_path / "s", {("e", "random"): {"points": make["points"](n=4)}})
    (tmp_path / "web").mkdir()
    page = write_report(study, tmp_path / "web" / "x.html")
    assert page == tmp_path / "web" / "x.html"
    files = list((tmp_path / "web" / "figures").iterdir())
    assert len(files) == 2 + 2  # points, f with points
    for file in files:
        assert file.read_bytes().startswith(b"%PDF" if file.suffix == ".pdf" else b"\x89PNG")
    images = Parsed(page.read_text(encoding="utf-8")).all("img")
    assert len(images) == 2 + 2  # small pictures and figures
    assert all(int(str(attributes["width"])) > 100 for attributes in images)
    assert not (study / "report.html").exists()
    with pytest.raises(StoreError, match="cannot be written"):
        write_report(study, tmp_path / "nowhere" / "x.html")


def test_figures_have_descriptions_and_sizes(page):
    images = page.all("img")
    row = 5 + 3  # small pictures: all in 1-D; f, points and spectrum in 2-D
    # Details: all kinds in 1-D; image, radial mean, points and f in 2-D
    assert len(images) == row + 11 + 4
    for attributes in images:
        assert len(str(attributes["alt"])) > 30
        assert attributes["width"] == attributes["height"] == "2"  # The size of the blank image
    assert page.tags.count(("figcaption", {})) == len(images)


def test_numbers_and_sentences(page):
    assert "−3.00 ± 0.03" in page.text
    assert "Variance at n = 1024" in page.text
    assert "7.45×10⁻¹¹" in page.text
    assert "The cross term removes" in page.text
    assert "nan" not in page.text.lower().split()


def test_samplers_in_the_order_of_the_study(page):
    places = [page.text.index(f"{s}: The rate") for s in ("random", "jittered", "jittered | shift")]
    assert places == sorted(places)


def test_provenance(folder, page):
    tree = open_results(folder)
    assert tree.attrs["study_hash"] in page.text
    assert "mcspectra run study.toml" in page.text
    assert f"numpy {tree.attrs['version_numpy']}" in page.text
    assert f"Machine{socket.gethostname()}" in page.text.replace("\n", "")


@pytest.mark.parametrize(
    ("study", "options"),
    [
        ('integrand = "gaussian"', ""),
        ("integrand = \"python(function='a.b:f')\"", " --allow-code a.b:f"),
        (
            (
                'a = "python(function=\\"m:g\\", dims=2)"\nb = "python( function = \'m:f\')"\n'
                "c = \"python(function='m:g')\""
            ),
            " --allow-code m:g --allow-code m:f",
        ),
        ("integrand = \"python(function='m:f; rm')\"", " --allow-code m:f"),
    ],
)
def test_the_command_allows_python_functions(study, options):
    assert module._allowed(study) == options


def test_the_page_contains_the_study(folder):
    attributes = open_results(folder).attrs
    again = decode_study(study_toml(attributes["study"]))
    assert StudyNote.of(again, {}).study_hash == attributes["study_hash"]


def test_study_toml__odd_text_and_all_tables():
    config = decode_study(
        'title = "a \\"b\\" \\\\ \\u007f \\n ü 🎲"\nsamplers = ["x(path=\'C:\\\\\\\\y\')"]\n'
        "[convergence]\ncounts = [1, 2]\n"
        '[[estimators]]\nname = "e"\nintegrand = "f"\ndensities = ["p", "q"]\n'
        "[estimators.terms]\nn = 4\ncross_matrix = true\n"
        '[[estimators]]\nname = "g"\nintegrands = ["f"]\ntechnique_counts = [2]\n'
        "[estimators.spectrum]\nn = 4\n"
    )
    assert decode_study(study_toml(plain_study(config))) == config


def test_names_are_escaped(make, tmp_path):
    evil = '<script>alert("1")</script> & $\\frac{$'
    cells = {(evil, evil): {"convergence": make["curve"]("random")}}
    text = write_report(make["study"](tmp_path, cells, title=evil)).read_text(encoding="utf-8")
    page = Parsed(text)
    assert "<script>alert" not in text
    assert page.text.count(evil) >= 4
    assert evil in str(page.all("img")[0]["alt"])


@pytest.mark.usefixtures("undrawn")
def test_unusual_results_are_shown_with_reasons(make, tmp_path):
    """Each unusual result is on the page with a reason."""
    small = {"half_width": 2, "realizations": 10}
    cells = {
        ("infinite", "random"): {"terms": make["infinite"](**small)},
        ("channels", "random"): {
            "convergence": make["curve"]("random", channels=3),
            "terms": make["terms"](**small, channels=3),
        },
        ("part", "random"): {"convergence": make["curve"]("random", zero=(0, 1, 2, 3))},
        ("part", "jittered"): {"convergence": make["curve"]("jittered", counts=(64,))},
        ("part", "shift"): {"points": make["points"](n=4)},
        ("techniques", "random"): {"terms": make["terms"](**small, techniques=2)},
    }
    page = Parsed(write_report(make["study"](tmp_path, cells)).read_text(encoding="utf-8"))
    assert "infinite because ∫1/p diverges" in page.text
    assert "random, channel 2" in page.text
    assert "Shown: channel 0 of 3." in page.text
    assert "No convergence results for shift." in page.text
    assert "No points results for random, jittered." in page.text
    assert "Each technique has its own panel." in page.text
    assert "there is no rate to fit" in page.text
    assert page.all("abbr")
    assert all(attributes["title"] for attributes in page.all("abbr"))


@pytest.mark.usefixtures("undrawn")
def test_predictions_are_drawn_in_the_measured_curves(make, tmp_path):
    """Predictions are crosses in the convergence figure, also at other counts."""
    f = mcs.integrand("gaussian(width=0.3)")
    curve = make["curve"]("random")
    same = mcs.predict(f, "random", curve["n"].values.tolist())
    cells = {
        ("same", "random"): {"convergence": curve, "predict": same},
        ("other", "random"): {"convergence": curve, "predict": mcs.predict(f, "random", [25])},
    }
    page = Parsed(write_report(make["study"](tmp_path, cells)).read_text(encoding="utf-8"))
    assert page.text.count("Crosses are predictions") == 2
    assert "Predicted variance against the number of points" not in page.text
    assert page.text.count("Predictions in numbers") == 2
    text = " ".join(page.text.split())
    for n, value in zip(same["n"].values, same["predicted_variance"].values, strict=True):
        assert f"random {n} {number(float(value), 6)}" in text


@pytest.mark.usefixtures("blank")
def test_a_plan_and_a_prediction_have_separate_files(make, tmp_path):
    f = mcs.integrand("gaussian(width=0.3)")
    found = {
        "plan": mcs.plan(f, "random", target_error=0.1),
        "predict": mcs.predict(f, "random", [4, 16]),
    }
    file = write_report(make["study"](tmp_path, {("e", "random"): found}))
    cited = set(re.findall(r"figures/[^\s\"<]*prediction[^\s\"<]*\.pdf", file.read_text("utf-8")))
    assert len(cited) == 2
    assert all((file.parent / each).exists() for each in cited)


def test_only_spectra(make, tmp_path):
    cells = {("e", "random"): {"spectrum": make["spectrum"](dims=3, n=8, half_width=2)}}
    page = Parsed(write_report(make["study"](tmp_path, cells)).read_text(encoding="utf-8"))
    assert "no convergence and no terms" in page.text
    assert len(page.all("img")) == 2  # the small picture and the figure
    assert "dims it replaces an image of the whole spectrum." in page.text


@pytest.mark.usefixtures("undrawn")
def test_no_results_yet(make, tmp_path):
    cells: Any = {("e", "random"): {}}
    page = Parsed(write_report(make["study"](tmp_path, cells)).read_text(encoding="utf-8"))
    assert "There are no results yet." in page.text


def test_figures_cannot_be_written(make, tmp_path):
    make["study"](tmp_path, {("e", "random"): {"points": make["points"](n=4)}})
    (tmp_path / "figures").write_text("a file in the way")
    with pytest.raises(StoreError, match="cannot be written"):
        write_report(tmp_path)


@pytest.fixture(name="small")
def _small(make, tmp_path):
    """Write a finished study with one cell."""
    study: Path = make["study"](tmp_path, {("e", "random"): {"convergence": make["curve"]()}})
    return study


ASKED = {"E!": ["random", "jittered | shift"], "a": ["b"]}


def lacking(failed, missing=()):
    """Return a status with one finished cell and the given failed and missing cells."""
    return StudyStatus(
        title="t", study_hash="", seed=1, versions={}, format=3, state="unfinished", holder=None,
        hosts=(), started=None, finished=None, done=("e/random/points",), failed=failed,
        missing=missing, damaged={}, recorded=0, results_bytes=0, ledger_bytes=0, verified=False,
    )  # fmt: skip


def gaps():
    """Return the sentence and the table of missing analyses."""
    _, sentence, table = module._gaps(Path(), ASKED)
    assert isinstance(sentence, Paragraph)
    assert isinstance(table, Table)
    return str(sentence.text), table


@pytest.mark.usefixtures("undrawn")
def test_a_finished_study_has_no_gaps(small):
    assert list(module._gaps(small, {})) == []
    text = write_report(small).read_text(encoding="utf-8")
    assert "What is missing" not in text


def test_analyses_with_the_same_reason_share_a_row(monkeypatch):
    failed = {
        "e/random/terms": "It raised.",
        "e/random/spectrum": "It raised.",
        "e/jittered-shift/terms": "It raised.",
        "a/b/predict": "NaN.",
    }
    monkeypatch.setattr(module, "study_status", lambda _: lacking(failed, ("e/shift/terms",)))
    sentence, table = gaps()
    assert [tuple(cell.text for cell in row) for row in table.rows] == [
        ("a", "b", "predict", "NaN."),
        ("E!", "jittered | shift", "terms", "It raised."),
        ("E!", "random", "spectrum, terms", "It raised."),
        ("E!", "shift", "terms", "not computed yet"),
    ]
    assert "Of 6 analyses, 4 failed and 1 not computed yet." in sentence
    assert "--resume --retry" in sentence


def test_missing_analyses_need_no_retry(monkeypatch):
    monkeypatch.setattr(module, "study_status", lambda _: lacking({}, ("e/shift/terms",)))
    (_, sentence, _) = module._gaps(Path(), ASKED)
    assert isinstance(sentence, Paragraph)
    assert "--resume" in sentence.text
    assert "--retry" not in sentence.text


def test_a_long_list_of_gaps_is_cut(monkeypatch):
    failed = {f"e{i:05}/random/terms": "It raised." for i in range(3000)}
    monkeypatch.setattr(module, "study_status", lambda _: lacking(failed))
    _, table = gaps()
    assert len(table.rows) == 50
    assert "2950 more rows" in table.caption


@pytest.mark.usefixtures("undrawn")
def test_an_unreadable_ledger_is_reported(small, monkeypatch):
    def refuse(_):
        raise StoreError("The ledger has format 9 <x>.")

    monkeypatch.setattr(module, "study_status", refuse)
    text = write_report(small).read_text(encoding="utf-8")
    assert "It is unknown whether analyses failed. The ledger has format 9 &lt;x&gt;." in text


@pytest.mark.usefixtures("undrawn")
def test_the_page_has_the_reasons(small, monkeypatch):
    status = lacking({"e/random/terms": "It raised ValueError: <b>."})
    monkeypatch.setattr(module, "study_status", lambda _: status)
    text = write_report(small).read_text(encoding="utf-8")
    assert "What is missing" in text
    assert "It raised ValueError: &lt;b&gt;." in text


@pytest.mark.usefixtures("blank")
def test_figures_of_shared_samples_appear_once(make, tmp_path):
    spectra = {s: make["spectrum"](s, dims=2, n=16, half_width=3) for s in ("random", "jittered")}
    cells = {("first", s): {"spectrum": data} for s, data in spectra.items()}
    cells["second", "random"] = {"spectrum": spectra["random"], "points": make["points"](n=4)}
    cells["other", "random"] = {"spectrum": 2.0 * spectra["random"].assign_attrs()}
    cells["other", "random"]["spectrum"].attrs = spectra["random"].attrs
    page = Parsed(write_report(make["study"](tmp_path, cells)).read_text(encoding="utf-8"))
    assert "Same samples as in first; see its spectrum." in page.text
    names = {p.name for p in (tmp_path / "figures").glob("*.png")}
    kinds = ("spectrum", "radial")
    assert names == {f"first-{k}.png" for k in kinds} | {f"other-{k}.png" for k in kinds} | {
        "second-points.png",
        "second-integrand.png",
    }


@pytest.mark.usefixtures("blank")
def test_bands_of_an_insignificant_cross_term_are_omitted(make, tmp_path):
    terms = make["terms"]("jittered", half_width=4, realizations=20)
    noise = terms.assign(cross_term_ci=("bound", [-1.0, 1.0]))
    certain = terms.assign(cross_term_ci=("bound", [-2.0, -1.0]))
    cells = {("noise", "jittered"): {"terms": noise}, ("certain", "jittered"): {"terms": certain}}
    write_report(make["study"](tmp_path, cells))
    names = {p.name for p in (tmp_path / "figures").glob("*-bands.png")}
    assert names == {"certain-bands.png"}


def test_everything_but_the_answer_and_the_row_is_collapsed(page):
    for name in (
        "All figures, numbers and settings",
        "Frequencies",
        "Spectra and points of the samples",
        "Three terms in numbers",
    ):
        assert name in page.text
    assert page.tags.count(("details", {})) >= 6
    assert all("open" not in attributes for attributes in page.all("details"))


def test_the_first_screen_has_answer_sentence_and_pictures_in_order(folder):
    text = (folder / "report.html").read_text(encoding="utf-8")
    section = text[text.index("<main>") :]
    marks = (
        'class="answer"',
        "Faster than random sampling",
        "Integrand f and samples",
        "Points</figcaption>",
        "Spectrum: n",
        "Variance and its slope",
        "<figcaption>Terms ",
        "All figures, numbers and settings",
        'id="summary"',
    )
    places = [section.index(mark) for mark in marks]
    assert places == sorted(places)


@pytest.mark.usefixtures("undrawn")
def test_many_estimators_have_a_table_without_pictures(make, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_MOST_ROWS", 1)
    cells = {(name, "random"): {"convergence": make["curve"]("random")} for name in ("a", "b")}
    page = Parsed(write_report(make["study"](tmp_path, cells)).read_text(encoding="utf-8"))
    assert next(attributes["id"] for attributes in page.all("section")) == "summary"
    assert "Variance and its slope" not in page.text
