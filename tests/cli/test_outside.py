"""Verbs of analyses in other packages: options, help, text and JSON."""

import argparse
import json
import re
import sys

import pytest

from mcspectra.cli.analysis import analysis_verb
from mcspectra.cli.main import _ANALYSES, VERBS, main
from mcspectra.core.analysis import _TAKEN, _TAKEN_BY_SUBJECTS, ANALYSES

MODULE = '''
"""Gaps of one-dimensional sets."""

from typing import Annotated, Literal, final

import numpy as np
import xarray as xr
from msgspec import Meta

from mcspectra.core.analysis import Analysis, whole
from mcspectra.core.options import COUNT, REALIZATIONS
from mcspectra.core.results import Variable


@final
class Gaps(Analysis, frozen=True, kw_only=True):
    """Gaps between neighbors of one-dimensional sets.

    No part of its help.
    """

    verb = "gaps"
    about = "sampler"
    variables = (
        Variable("largest gap", "1", (), name="largest"),
        Variable("95 % interval of it", "1", ("bound",), name="largest_ci"),
        Variable("mean gap", "1", ("place",), name="gap"),
        Variable("many numbers", "1", ("place", "row"), name="many"),
    )

    n: Annotated[int, COUNT]
    realizations: Annotated[int, REALIZATIONS] = 10
    ends: Annotated[Literal["wrap", "open"], Meta(description="What happens at 100 %.")] = "open"
    names: Annotated[tuple[str, ...] | None, Meta(description="Names of gaps.")] = None
    weights: Annotated[tuple[float, ...], Meta(description="Weights of gaps.")] = (1.0, 0.5)
    sort: Annotated[bool, Meta(description="Sort the gaps.")] = True

    def reduction(self, subject, stream):
        def gaps():
            x = np.sort(subject.sampler.draw_stream(self.n, stream, 0, self.realizations)[..., 0])
            gap = np.diff(x).mean(0) * self.weights[0]
            gap = np.sort(gap) if self.sort else gap
            found = {
                "largest": ((), gap.max(), {"long_name": "largest gap", "units": "1"}),
                "largest_ci": (("bound",), np.array([0.25, 0.5])),
                "gap": (("place",), gap),
                "many": (("place", "row"), np.ones((len(gap), 20_000))),
            }
            about = {"sampler": subject.sampler.spec, "n": self.n, "names": str(self.names)}
            return xr.Dataset(found, attrs=about | {"realizations": self.realizations})

        return whole(gaps)
'''


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run the command with an installed package of two analyses, one of which is broken."""
    (tmp_path / "their_gaps.py").write_text(MODULE, encoding="utf-8")
    about = tmp_path / "their_gaps-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: their-gaps\nVersion: 1.0\n")
    entries = "[mcspectra.analyses]\ngap-widths = their_gaps:Gaps\nbroken = their_nothing:Nothing\n"
    (about / "entry_points.txt").write_text(entries)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("COLUMNS", "200")

    def call(*arguments):
        code = main([str(a) for a in arguments])
        return (code, *capsys.readouterr())

    yield call
    sys.modules.pop("their_gaps", None)


def test_an_analysis_of_another_package_is_a_verb(run):
    code, out, err = run("--help")
    assert (code, err) == (0, "")
    assert re.search(
        r"^  gaps +Gaps between neighbors of one-dimensional sets\.$", out, re.MULTILINE
    )
    assert "broken" not in out
    code, out, _ = run("list", "analyses")
    assert code == 0
    assert "mcspectra gaps" in out
    assert "no verb: for study files" in out
    assert "not available: The analysis 'broken' (their_nothing:Nothing)" in out


def test_its_help_is_derived_from_its_options(run):
    code, out, _ = run("gaps", "--help")
    assert code == 0
    assert "No part of its help" not in out
    lines = " ".join(out.split())
    assert "-n N points of each technique" in lines
    assert "-m R, --realizations R independent realizations" in lines
    assert "default 10, or all given sets of points" in lines
    assert "--ends ENDS what happens at 100 %: open, wrap; default open" in lines
    assert "--names NAMES names of gaps; repeatable" in lines
    assert "--weights W weights of gaps; default 1,0.5" in lines
    assert "--no-sort sort the gaps; on by default" in lines
    assert all(option in out for option in ("--density", "--json", "--seed", "--out"))


def test_its_result_is_shown_without_code_for_it(run, tmp_path):
    arguments = ("gaps", "random", "-d", 1, "-n", 4, "--names", "a,b", "--names", "c")
    code, out, err = run(*arguments, "--no-sort", "--weights", "2,1")
    assert (code, err) == (0, "")
    title, header, _, number, columns, *_ = out.splitlines()
    assert title == "random,  n = 4"
    assert header.split() == ["unit", "value", "95", "%"]
    assert number.split()[:2] == ["largest", "gap"]
    assert number.endswith("0.25 … 0.5")
    assert columns.split() == ["place", "gap"]
    assert out.splitlines()[-1] == "many: over place, row; --out writes it"
    code, out, _ = run(*arguments, "--json", "--out", tmp_path / "gaps.npz")
    data = json.loads(out)
    assert (data["names"], data["realizations"]) == ("('a,b', 'c')", 10)
    assert data["largest_ci"] == [0.25, 0.5]
    assert len(data["gap"]) == 3
    assert "many" not in data
    assert (tmp_path / "gaps.npz").stat().st_size > 400_000


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("-n", "x"), "-n is 'x'; give a whole number"),
        (("-n", 4, "-m", 1), "--realizations is 1"),
        (("-n", 4, "--ends", "round"), "--ends is 'round'; it must be one of open, wrap"),
        (("-n", 4, "--weights", "1,x"), "--weights is 'x'"),
        ((), "required: -n"),
        (
            ("-n", 4, "--out", "gaps.gif"),
            "must end in .npz, .csv, .tex, .svg, .png, .pdf, .pgf or .html",
        ),
        (("-n", 4, "--out", "no/such/gaps.npz"), "cannot be written"),
    ],
)
def test_invalid_options_give_one_sentence(run, options, words):
    code, out, err = run("gaps", "random", "-d", 1, *options)
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "door", "word", "owner"),
    [
        ("gap-widths", "verb", "gaps", "other-gaps"),
        ("other-gaps", "verb", "converge", "convergence"),
        ("other-gaps", "function", "power_spectrum", "spectrum"),
    ],
)
def test_two_analyses_with_the_same_verb_or_function_are_named(
    run, tmp_path, name, door, word, owner
):
    other = MODULE.replace('verb = "gaps"', f'verb = "other"\n    {door} = "{word}"')
    (tmp_path / "other_gaps.py").write_text(other, encoding="utf-8")
    entries = tmp_path / "their_gaps-1.0.dist-info" / "entry_points.txt"
    entries.write_text(entries.read_text() + "other-gaps = other_gaps:Gaps\n")
    first, second = sorted([name, owner])
    sentence = f"The analyses {first!r} and {second!r} have the same {door} {word!r};"
    code, out, err = run("--help")
    assert (code, err) == (0, "")
    assert f"left out: other-gaps: {sentence}" in out
    assert ("left out: gap-widths: " in out) == (owner == "other-gaps")
    assert ("left out: " + owner in out) == (owner == "other-gaps")
    code, out, err = run("other-gaps")
    assert (code, out) == (2, "")
    assert sentence in err
    assert run("cite")[0] == run("converge", "--help")[0] == 0
    code, _, err = run("gaps", "--help")
    assert code == (2 if owner == "other-gaps" else 0)
    assert (sentence in err) == (owner == "other-gaps")
    code, _, err = run("no-such-verb")
    assert (code, "There is no verb 'no-such-verb'" in err) == (2, True)
    sys.modules.pop("other_gaps", None)


def test_a_verb_of_the_package_itself_is_refused(run, tmp_path):
    module = tmp_path / "their_gaps.py"
    module.write_text(MODULE.replace('verb = "gaps"', 'verb = "run"'), encoding="utf-8")
    sentence = "The analysis 'gap-widths' has the verb 'run', which belongs to mcspectra itself"
    code, out, _ = run("--help")
    assert code == 0
    assert f"left out: gap-widths: {sentence}" in out
    code, _, err = run("gap-widths")
    assert (code, sentence in err) == (2, True)
    assert "every estimator of a study file" in run("--help")[1]
    assert run("run", "--help")[0] == 0


def test_an_analysis_that_cannot_be_imported_says_why(run):
    code, out, err = run("broken", "random")
    assert (code, out) == (2, "")
    assert "The analysis 'broken' (their_nothing:Nothing) cannot be loaded: No module named" in err


@pytest.mark.parametrize("about", ["estimator", "sampler"])
@pytest.mark.parametrize("option", ["seed", "out", "dims", "json", "help", "quiet", "debug"])
def test_an_option_with_a_name_of_its_verb_is_refused(run, tmp_path, option, about):
    module = MODULE.replace("ends:", f"{option}:").replace('"sampler"\n', f'"{about}"\n')
    (tmp_path / "their_gaps.py").write_text(module, encoding="utf-8")
    code, out, err = run("gaps", "random", "-n", 4)
    assert (code, out) == (2, "")
    sentence = f"Gaps has the option {option!r}, but that name is taken by all analyses"
    assert err.startswith(f"mcspectra: {sentence}")
    assert err.count("\n") == 1


def test_declarations_of_verbs_are_used():
    for name in ("convergence", "spectrum", "pcf", "remedies"):
        analysis, parser = ANALYSES.load(name), argparse.ArgumentParser()
        for declare in analysis_verb([name]).options:
            declare(parser)
        declared = {action.dest for action in parser._actions}
        declared -= set(analysis.__struct_fields__)
        assert declared <= _TAKEN | _TAKEN_BY_SUBJECTS


def test_the_table_of_verbs_agrees_with_the_analyses():
    own = {name for name, target in ANALYSES.items() if target.startswith("mcspectra.")}
    verbs: dict[str, set[str]] = {}
    for name in own:
        verbs.setdefault(ANALYSES.load(name).verb, set()).add(name)
    verbs.pop("")
    assert verbs == {verb: set(names) for verb, names in _ANALYSES.items()}
    assert set(verbs) <= set(VERBS)
    for names in _ANALYSES.values():
        splits = [ANALYSES.load(name).split for name in names]
        assert len(set(splits)) == len(names)
        assert all(splits) == (len(names) > 1)


def test_an_analysis_of_another_package_is_a_split_of_ours(run, tmp_path):
    module = tmp_path / "their_gaps.py"
    ours = MODULE.replace('verb = "gaps"', 'verb = "variance"\n    split = "gaps"')
    module.write_text(ours.replace('    about = "sampler"\n', ""), encoding="utf-8")
    code, out, _ = run("variance", "--help")
    assert code == 0
    assert "gaps: gaps between neighbors of one-dimensional sets" in " ".join(out.split())
    assert "with --split gaps:" in out
    subject = ("variance", "linear", "-d", 1, "--sampler", "random", "-n", 4)
    code, out, err = run(*subject, "--split", "gaps", "--ends", "wrap")
    assert (code, err) == (0, "")
    assert "largest gap" in out
    assert "--ends is for --split gaps; give that" in run(*subject, "--ends", "wrap")[2]
    assert "mcspectra variance --split gaps" in run("list", "analyses")[1]
    # If two analyses have the same name, the one of this package is used
    module.write_text(ours.replace('split = "gaps"', 'split = "modes"'), encoding="utf-8")
    sys.modules.pop("their_gaps", None)
    assert "have the same verb 'variance --split modes'" in run("gap-widths")[2]
    assert run("variance", "--split", "modes", "--help")[0] == 0
