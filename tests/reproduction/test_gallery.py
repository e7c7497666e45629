"""The gallery: page, images and findings of invented exhibits."""

import base64
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mcspectra.cli.main import main
from mcspectra.core.errors import ParameterError, StoreError, UnknownName
from mcspectra.plots.description import Line, Panel, Pixels, Plot
from mcspectra.report.page import Slider
from mcspectra.reproduction import gallery
from mcspectra.reproduction.claims import (
    VERDICT_WIDENING,
    Claim,
    Exhibit,
    Finding,
    Measured,
    about,
    correction,
)
from mcspectra.reproduction.gallery import (
    ExhibitTexts,
    Slide,
    measured_text,
    reproduce,
    verdict,
)

TEXTS = {
    "good": ExhibitTexts(
        summary="good things",
        slides=(
            Slide(
                number=7,
                title="A good one",
                statement="Slide & quotation",
                reason="quick {quick}, seed {seed}",
                figure="plot",
                more=("photo",),
                formula=r"\frac{1}{N} \sum_k x_k",
                explorer="sampler=jittered | shift",
            ),
            Slide(number=3, title="An earlier one", statement="", reason="", figure="photo"),
        ),
        plots={k: {"caption": "A $ sign.", "words": '"Words"'} for k in ("photo", "plot")},
    ),
    "bad": ExhibitTexts(
        summary="bad things",
        slides=(Slide(number=9, title="A bad one", statement="No", reason="", figure="none"),),
        plots={},
    ),
}


COUNTED = "1 agree, 1 limit or correct a slide, 1 do not agree, 1 without verdict"


def _plot(photograph):
    ends = np.array([0.0, 1.0])
    rgb = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    mark = Pixels(rgb=rgb) if photograph else Line(x=ends, y=ends, color="#0072B2", label="line")
    return Plot(
        kind="photo" if photograph else "plot",
        panels=(Panel(marks=(mark,)),),
    )


def _good(*, quick, seed):
    return Exhibit(
        numbers={"quick": quick, "seed": seed},
        plots=(_plot(False), _plot(True)),
        sliders={"plot": Slider("n", {"1": _plot(False), "2": _plot(False)}, "1")},
        claims=(
            Claim("One is <one>.", Measured(1.0, 0.9, 1.1), expected=1.0),
            Claim("One is <one>.", Measured(np.inf, -np.inf, 2.0), expected=1.0, note="why"),
            *about("photo", Claim("One is <one>.", "words", shown="1")),
            *about("photo", correction(Claim("One is <one>.", 1.0, expected=1.0))),
        ),
    )


def _bad(*, quick, seed):
    raise ZeroDivisionError("it broke")


@pytest.fixture(scope="module", autouse=True)
def exhibits():
    here: dict[str, Callable[..., Exhibit]] = {"good": _good, "bad": _bad}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gallery, "texts", lambda: TEXTS)
        patch.setattr(gallery, "load_exhibit", here.__getitem__)
        # Other processes would not have these exhibits
        patch.setattr("mcspectra.core.parallel.available_workers", lambda: 1)
        yield


@pytest.fixture(scope="module")
def good(tmp_path_factory, exhibits):
    """Make a gallery of the good exhibit and return its folder."""
    folder = tmp_path_factory.mktemp("good")
    reproduce(folder, ["good"], seed=7)
    return folder


def test_findings_are_plain_json(good):
    rows = json.loads((good / "findings.json").read_text(encoding="utf-8"))
    assert [set(row) for row in rows] == [
        {
            *("exhibit", "slide", "statement", "expected", "measured", "interval", "agrees"),
            *("note", "corrects"),
        }
    ] * 4
    assert [row["slide"] for row in rows] == [7, 7, 3, 3]
    assert [row["measured"] for row in rows] == [1.0, "inf", "words", 1.0]
    ends = pytest.approx((1.0 - 0.1 * VERDICT_WIDENING, 1.0 + 0.1 * VERDICT_WIDENING))
    assert rows[0]["interval"] == ends
    assert [row["interval"] for row in rows[1:]] == [["-inf", 2.0], None, None]
    assert [row["agrees"] for row in rows] == [True, False, None, True]
    assert [row["corrects"] for row in rows] == [False, False, False, True]


def test_a_failed_exhibit_does_not_stop_others(tmp_path):
    seen: list[str] = []
    made = reproduce(
        tmp_path, quick=True, done=lambda entry: seen.append(f"{entry.name} {entry.tally}")
    )
    assert made.failed == ("bad",)
    assert seen == [f"good {COUNTED}", "bad failed"]
    rows = json.loads((tmp_path / "findings.json").read_text(encoding="utf-8"))
    failed = rows[-1]
    assert (failed["exhibit"], failed["agrees"]) == ("bad", False)
    assert "ZeroDivisionError: it broke" in failed["note"]
    page = made.page.read_text(encoding="utf-8")
    assert "This exhibit failed: ZeroDivisionError: it broke" in page


def test_the_page_is_self_contained_and_escaped(good):
    page = (good / "index.html").read_text(encoding="utf-8")
    assert "One is &lt;one&gt;." in page
    assert "Slide &amp; quotation" in page
    assert 'alt="&#34;Words&#34;"' in page
    assert "<math" in page
    assert "<mfrac>" in page
    assert re.findall(r'(?:src|href)="(?!data:|#)([^"]*)', page) == [
        "http://localhost:5006/?sampler=jittered+%7C+shift"
    ]
    assert "prefers-color-scheme: dark" in page
    inside = {
        base64.b64decode(text) for text in re.findall(r"data:image/png;base64,([^\"]+)", page)
    }
    files = sorted((good / "figures").iterdir())
    assert [f.name for f in files if f.suffix == ".png"] == ["good-photo.png", "good-plot.png"]
    assert {f.read_bytes() for f in files if f.suffix == ".png"} <= inside


def test_the_same_seed_gives_the_same_bytes(good, tmp_path):
    reproduce(tmp_path, ["good"], seed=7)
    for name in ("index.html", "findings.json", "figures/good-plot.png"):
        assert (good / name).read_bytes() == (tmp_path / name).read_bytes()


def test_images_keep_their_colors(good):
    from PIL import Image

    for name, mode in (("photo", "RGB"), ("plot", "P")):
        with Image.open(good / f"figures/good-{name}.png") as image:
            assert image.mode == mode


def test_quick_runs_write_no_pdf_files(good, tmp_path):
    reproduce(tmp_path, ["good"], quick=True)
    assert not list((tmp_path / "figures").glob("*.pdf"))
    assert len(list((good / "figures").glob("*.pdf"))) == 2


def test_screens_are_in_the_order_of_the_talk(good):
    page = (good / "index.html").read_text(encoding="utf-8")
    screens = re.findall(r'<section id="([^"]+)" class="screen', page)
    assert screens == ["start", "photo", "plot", "provenance"]
    assert page.count('type="range"') == 1


@pytest.mark.parametrize(
    ("agrees", "corrects", "texts", "word"),
    [
        ((True, True), (False, False), {}, "Holds"),
        ((True, None), (False, False), {"holds_if": "x"}, "Holds if"),
        ((True, True), (False, True), {"corrected": "x"}, "Corrected"),
        ((True, None), (False, True), {"corrected": "x"}, "Holds"),
        ((True, False), (False, True), {"corrected": "x"}, "Not reproduced"),
        ((None, None), (False, False), {"answer": "x"}, "No verdict"),
        ((True, True), (False, False), {"answer": "x"}, "Answered"),
        ((True, True), (False, False), {"partly": "x"}, "Answered in part"),
    ],
)
def test_verdicts_follow_from_findings(agrees, corrects, texts, word):
    slide = Slide(number=1, title="", statement="", reason="", figure="", **texts)
    findings = [
        Finding(statement="", expected="", measured=None, interval=None, agrees=a, corrects=c)
        for a, c in zip(agrees, corrects, strict=True)
    ]
    assert verdict(slide, findings)[0] == word


def test_fonts_in_the_pdf_can_be_edited(good):
    pdf = (good / "figures/good-plot.pdf").read_bytes()
    assert b"/Type3" not in pdf
    assert b"/CIDFontType2" in pdf


def test_an_interrupt_stops_and_leaves_no_partial_file(tmp_path, monkeypatch):
    def interrupted(name):
        if name == "bad":
            raise KeyboardInterrupt
        return _good

    monkeypatch.setattr(gallery, "load_exhibit", interrupted)
    assert main(["reproduce", "--out", str(tmp_path)]) == 130
    assert [path.name for path in tmp_path.iterdir()] == ["figures"]


def test_an_unwritable_folder_gives_an_error(tmp_path):
    (tmp_path / "figures").write_text("a file")
    with pytest.raises(StoreError, match="cannot be written"):
        reproduce(tmp_path, ["good"])
    (tmp_path / "figures").unlink()
    (tmp_path / "index.html").mkdir()
    with pytest.raises(StoreError, match="cannot be written"):
        reproduce(tmp_path, ["good"], quick=True)
    assert not list(tmp_path.glob(".*partial"))


def test_other_files_are_kept(tmp_path):
    (tmp_path / "figures").mkdir()
    kept = [tmp_path / "notes.txt", tmp_path / "figures" / "mine.png"]
    for path in kept:
        path.write_text("mine")
    (tmp_path / "index.html").write_text("old")
    reproduce(tmp_path, ["good"], quick=True)
    assert all(path.read_text() == "mine" for path in kept)
    assert (tmp_path / "index.html").read_text(encoding="utf-8") != "old"
    assert not list(tmp_path.glob(".*partial"))


def test_bad_input_gives_an_error_before_any_work(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(UnknownName, match="Did you mean 'good'"):
        reproduce(out, ["goood"])
    for seed in (-1, 0.5, "x", float("nan")):
        with pytest.raises(ParameterError, match="seed"):
            reproduce(out, ["good"], seed=seed)
    assert not out.exists()
    with pytest.raises(ParameterError, match="is empty"):
        reproduce("", ["good"])
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="cannot be written"):
        reproduce(tmp_path / "file", ["good"])


@pytest.mark.parametrize(
    ("value", "interval", "shown"),
    [
        (-2.998765, (-3.0009, -2.9966), ("−2.9988", "−3.0009 … −2.9966")),
        (0.5, (0.1, 0.9), ("0.500", "0.100 … 0.900")),
        (None, None, ("–", "")),
        ("words", None, ("words", "")),
        (2.5e-13, None, ("2.50×10⁻¹³", "")),
    ],
)
def test_digits_follow_the_interval(value, interval, shown):
    finding = Finding(statement="s", expected="1", measured=value, interval=interval, agrees=True)
    assert measured_text(finding) == shown


def test_the_command_reports_disagreements_and_failures(tmp_path, capsys):
    assert main(["reproduce", "--quick", "--seed", "5", "--out", str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    assert f"good: {COUNTED}" in out
    assert "does not agree: One is <one>.: why" in out
    assert f"2 slides; findings: {COUNTED}; 1 failed" in out
    assert err.strip() == "mcspectra: The figure bad failed: ZeroDivisionError: it broke"
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "quick True, seed 5" in page
    assert "<code>mcspectra reproduce --quick --seed 5</code>" in page


def test_command_in_json_and_quiet(tmp_path, capsys):
    assert main(["reproduce", "good", "--json", "--quick", "--out", str(tmp_path)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["figures"], told["failed"]) == (["good"], [])
    assert (told["agree"], told["correct"], told["judged"]) == (1, 1, 3)
    assert Path(told["gallery"]).exists()
    assert main(["reproduce", "good", "--quiet", "--quick", "--out", str(tmp_path)]) == 0
    assert [line.split(":")[0] for line in capsys.readouterr().out.splitlines()][1:] == ["page"]


def test_the_command_lists_exhibits_without_making_them(capsys):
    assert main(["reproduce", "--list"]) == 0
    assert capsys.readouterr().out == "good  good things\nbad   bad things\n"
    assert main(["reproduce", "--list", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[1] == {"name": "bad", "summary": "bad things"}
