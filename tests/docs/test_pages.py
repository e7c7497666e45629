"""All pages: links, citations, public names, verbs, and the code of the README."""

import importlib
import inspect
import json
import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from docutils import nodes
from sphinx import addnodes

import mcspectra as mcs
from mcspectra.cli.main import VERBS, main
from mcspectra.core.references import works

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))
NOTEBOOKS = [page for page in PAGES if "file_format: mystnb" in (DOCS / page).read_text("utf-8")]
PACKAGES = sorted(name for name in mcs.__all__ if inspect.ismodule(getattr(mcs, name)))
_FENCE = re.compile(r"^( *)(```+).*?^\1\2$", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\]\(([^)\s]+)\)")
_CITED = re.compile(r"\{cite\}`(\w+)`")
_DOCUMENTED = re.compile(r"^\.\. auto(?:class|function):: (\w+)$", re.MULTILINE)


@pytest.fixture(scope="module", autouse=True)
def _extensions():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(DOCS / "_extensions")
        yield
        for name in ("bibliography", "docstrings", "mathml", "terms", "verbs"):
            sys.modules.pop(name, None)


def _text(page):
    return (DOCS / page).read_text(encoding="utf-8")


def _anchors(page):
    """Return the anchors of headings, as GitHub and MyST make them."""
    titles = re.findall(r"^#+ (.+)$", _FENCE.sub("", _text(page)), re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", title.lower()) for title in titles)
    return {title.strip().replace(" ", "-") for title in plain}


def test_modules_and_names_in_contributing_exist():
    sources = {p.name: p for room in ("src", "tests") for p in (ROOT / room).rglob("*.py")}
    told = re.findall(
        r"`(?:[\w/]+/)?(\w+\.py)(?:: (\w+))?`", (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    )
    assert len(told) > 20
    for name, member in told:
        assert name in sources, name
        assert not member or re.search(
            rf"^(def |class )?{member}\b", sources[name].read_text(), re.MULTILINE
        )


@pytest.mark.parametrize("page", PAGES)
def test_relative_links_resolve(page):
    for target in _LINK.findall(_FENCE.sub("", _text(page))):
        path, _, anchor = target.partition("#")
        if "://" in target:
            continue
        linked = (DOCS / page).parent / path if path else DOCS / page
        assert linked.exists(), target
        if anchor:
            assert anchor in _anchors(linked.resolve().relative_to(DOCS.resolve()).as_posix()), (
                target
            )


def test_a_missing_anchor_is_detected():
    assert "the-three-terms" in _anchors("theory.md")
    assert "the-four-terms" not in _anchors("theory.md")


def _rows_of_calls():
    """Return the calls of the last table of CONTRIBUTING.md, each with its files."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for row in text.rpartition("|---|---|\n")[2].strip().splitlines():
        call, files = re.fullmatch(r"\| `(.+?)` \| (.+) \|", row.replace(r"\|", "¦")).groups()
        yield call.replace("¦", "|"), re.findall(r"`(.+?)`", files)


@pytest.mark.parametrize(("call", "files"), list(_rows_of_calls()), ids=lambda value: value[:16])
def test_the_files_that_determine_a_call_run_in_it(call, files):
    source, ran = ROOT / "src" / "mcspectra", set()

    def note(frame, event, _):
        if event == "call":
            ran.add(frame.f_code.co_filename)

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        eval(call, {"mcs": mcs})
    finally:
        sys.setprofile(before)
    assert len(files) <= 15
    assert {str(source / file) for file in files} <= ran


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md"])
def test_links_of_pages_at_the_root_resolve(page):
    for target in _LINK.findall((ROOT / page).read_text(encoding="utf-8")):
        assert "://" in target or (ROOT / target.partition("#")[0]).exists(), target


def test_the_api_has_every_public_name_once():
    names = [name for name in mcs.__all__ if name not in PACKAGES and name != "__version__"]
    assert sorted(_DOCUMENTED.findall(_text("api/mcspectra.md"))) == sorted(names)


def test_classes_and_functions_have_the_right_directive():
    for kind, name in re.findall(
        r"^\.\. auto(\w+):: (\w+)$", _text("api/mcspectra.md"), re.MULTILINE
    ):
        assert (kind == "class") == inspect.isclass(getattr(mcs, name)), name


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_package_has_a_page(package):
    page = _text(f"api/{package}.md")
    assert f".. automodule:: mcspectra.{package}" in page
    left_out = re.findall(r":exclude-members: (.*)", page)
    left_out = set(left_out[0].split(", ")) if left_out else set()
    assert left_out <= set(_DOCUMENTED.findall(_text("api/mcspectra.md")))
    own = set(getattr(getattr(mcs, package), "__all__", ()))
    assert left_out == own & (set(mcs.__all__) - set(PACKAGES))


def test_the_reference_has_the_help_of_every_verb():
    verbs = importlib.import_module("verbs")
    assert verbs.VERBS is VERBS
    section = verbs.help_of("points")
    assert section.startswith("usage: mcspectra points")
    assert "--seed S" in section
    assert "\x1b" not in section


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_every_verb_has_a_help_text(verb):
    text = importlib.import_module("verbs").help_of(verb)
    assert text.startswith(f"usage: mcspectra {verb}")
    assert all(option in text for option in ("--json", "--seed", "--quiet"))
    assert max(map(len, text.splitlines())) <= 200


def test_a_failing_help_is_an_error():
    with pytest.raises(RuntimeError, match="ended with 2"):
        importlib.import_module("verbs").help_of("no-such-verb")


def test_pages_cite_works_that_exist():
    cited = {key for page in PAGES for key in _CITED.findall(_text(page))}
    assert len(cited) > 10
    assert cited <= set(works())


_FORMULA = re.compile(r"\$\$(.+?)\$\$|(?<![$`])\$([^$]+)\$", re.DOTALL)


def test_every_formula_of_the_theory_can_be_drawn():
    mathml = importlib.import_module("mathml").mathml
    formulas = _FORMULA.findall(_text("theory.md"))
    assert len(formulas) > 250
    for display, inline in formulas:
        assert mathml(display or inline).startswith("<math xmlns=")


def test_a_command_without_mathml_is_an_error():
    mathml = importlib.import_module("mathml").mathml
    with pytest.raises(ValueError, match="nosuch"):
        mathml(r"\nosuch{x}")


def test_bars_are_as_wide_as_the_formula_below():
    formula = importlib.import_module("mathml").mathml(r"\overline{S_m}")
    assert formula.count('<mrow class="overline"><mrow><msub>') == 1
    assert "mover" not in formula


@pytest.mark.parametrize(
    ("line", "read"),
    [
        ("power |f_m|² at m_ and f*g", r"power \|f_m\|² at m\_ and f\*g"),
        (
            "*Integer* m, ``|m|``, `f`_ and [Owen1997]_",
            "*Integer* m, ``|m|``, `f`_ and [Owen1997]_",
        ),
        ("* an item, |m|", r"* an item, \|m\|"),
        (":param half_width: |m| up to K", r":param half_width: \|m\| up to K"),
    ],
)
def test_mathematics_in_docstrings_is_escaped(line, read):
    assert importlib.import_module("docstrings").escaped(line) == read


def test_quick_start_and_how_to_pages_are_notebooks():
    pages = {"quick-start.md", *(f"how-to/{path.name}" for path in (DOCS / "how-to").glob("*.md"))}
    assert set(NOTEBOOKS) == pages
    assert len(pages) == 7


@pytest.mark.parametrize("page", NOTEBOOKS)
def test_notebooks_are_text_without_outputs(page):
    cells = re.findall(r"```\{code-cell\}\n(.*?)```", _text(page), re.DOTALL)
    assert len(cells) >= 3
    assert max(len(line) for line in _text(page).splitlines()) <= 120


def test_the_code_of_the_readme_is_in_the_quick_start():
    readme, page = (ROOT / "README.md").read_text(encoding="utf-8"), _text("quick-start.md")
    assert len(readme.splitlines()) <= 120
    for block in re.findall(r"```python\n(.*?)```", readme, re.DOTALL):
        assert all(line in page for line in block.splitlines())
    for command in re.findall(r"^    make .*$", readme, re.MULTILINE)[:2]:
        assert command in page


def _outputs_of_the_readme():
    """Return the commands of the README with their printed output."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for block in re.findall(r"```console\n(.*?)```", readme, re.DOTALL):
        command, _, printed = block.partition("\n")
        if command.startswith("$ mcspectra"):
            yield shlex.split(command)[2:], printed.strip("\n")


@pytest.mark.parametrize(
    ("arguments", "printed"), list(_outputs_of_the_readme()), ids=lambda a: a[0]
)
def test_commands_of_the_readme_print_the_quoted_output(arguments, printed, capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    assert main(arguments) == 0
    assert capsys.readouterr().out.strip("\n") == printed


def test_the_readme_has_three_commands_with_outputs():
    verbs = [arguments[0] for arguments, _ in _outputs_of_the_readme()]
    assert verbs == ["profile", "frames", "bench"]


def test_the_quick_start_quotes_the_captured_shares():
    page = _text("quick-start.md")
    words = re.sub(r"\s+", " ", page)
    (fourier,) = re.findall(r"still ([\d.]+) times the measured variance", words)
    (wide,) = re.findall(r"([\d.]+) times with a half width of 512", words)
    (cosine,) = re.findall(r"cosine basis, a half width of 64 gives ([\d.]+\d) times", words)
    code = re.findall(r"^(estimator|terms) = (.*)$", page, re.MULTILINE)
    names = {"mcs": mcs}
    for name, expression in code:
        names[name] = eval(expression, names)
    further = [
        mcs.variance_terms(names["estimator"], "jittered", 16, **options)
        for options in ({"half_width": 512}, {"half_width": 64, "basis": "cosine"})
    ]
    for said, terms in zip((fourier, wide, cosine), (names["terms"], *further), strict=True):
        assert f"{float(terms['captured']):.2f}" == said
    excess = float(names["terms"]["power_term"] / names["terms"]["measured_variance"])
    assert "fourteen times the variance" in words
    assert round(excess) == 14


def test_the_variance_of_the_quick_start_is_predicted(capsys):
    """The Fourier basis is not used here: its sum gives 2.88 times the measured variance."""
    (command,) = re.findall(r"^mcspectra (variance .*)$", _text("quick-start.md"), re.MULTILINE)
    assert main([*shlex.split(command), "--json"]) == 0
    captured = json.loads(capsys.readouterr().out)["captured"]
    assert 0.95 < float(np.squeeze(captured)) < 1.05


@pytest.fixture
def terms():
    return importlib.import_module("terms")


def test_the_glossary_has_its_terms_once(terms):
    names = terms.glossary_terms(_text("conventions.md"))
    assert len(names) == len(set(names)) > 40
    assert {"primary space", "half width", "Owen scrambling", "effective sample size"} <= {*names}


def test_the_first_mention_of_a_term_is_linked(terms):
    page = nodes.section()
    page += nodes.title("", "Lattices")
    paragraph = nodes.paragraph("", "A power spectrum of lattices. Samples miss ")
    paragraph += nodes.literal("", "torus")
    paragraph += nodes.Text(" and another lattice in a sublattice")
    page += paragraph
    terms.link_terms(page, ["lattice", "power spectrum", "torus", "MIS"])
    links = [(x["reftarget"], x.astext()) for x in page.findall(addnodes.pending_xref)]
    assert links == [("power spectrum", "power spectrum"), ("lattice", "lattices")]
    assert paragraph.astext().startswith("A power spectrum of lattices. Samples miss torus")


# Pages of text only: lists of names, included files, and short guides
_WITHOUT_FIGURES = {"commands.md", "references.md", "security.md", "changelog.md"}
_WITHOUT_FIGURES |= {"contributing.md", "add-an-analysis.md"}


@pytest.mark.parametrize("page", [p for p in PAGES if not p.startswith(("api/", "decisions/"))])
def test_pages_have_a_figure(page):
    figure = "![" in _text(page) or "plt.show()" in _text(page)
    assert figure == (page not in _WITHOUT_FIGURES)


@pytest.mark.parametrize("name", sorted(p.name for p in (DOCS / "figures").glob("*.png")))
def test_every_figure_is_on_a_page(name):
    pages = [_text(page) for page in PAGES] + [(ROOT / "README.md").read_text("utf-8")]
    assert any(f"figures/{name})" in text for text in pages)
