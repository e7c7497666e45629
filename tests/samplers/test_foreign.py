"""Samplers that other packages register: a broken one does not hide the others."""

import json

import pytest

import mcspectra as mcs
from mcspectra.cli.main import main
from mcspectra.core.errors import ParameterError

ENTRIES = {
    "no-class": "math:sin",
    "no-module": "nowhere_at_all:Thing",
    "no-attribute": "math:Thing",
    "broken": "broken_foreign:Thing",
    "syntax": "syntax_foreign:Thing",
    "misuse": "misuse_foreign:Thing",
    "exits": "exits_foreign:Thing",
}

UNLISTABLE = {
    "no-sampler": "mcspectra.samplers.randomizations:Shift",
    "no-signature": "unsigned_foreign:Thing",
}
"""Registered components that cannot be described as samplers."""

UNSIGNED = """
from mcspectra.samplers import Sampler

class Odd(type(Sampler)):
    __signature__ = 3

class Thing(Sampler, metaclass=Odd):
    "Thing."
"""


def test_broken_entries_are_listed_as_such_and_refused_in_a_sentence(tmp_path, monkeypatch, capsys):
    (tmp_path / "broken_foreign.py").write_text("1 / 0\n")
    (tmp_path / "syntax_foreign.py").write_text("def\n")
    (tmp_path / "misuse_foreign.py").write_text("import mcspectra as m\nm.sampler('nope')\n")
    (tmp_path / "exits_foreign.py").write_text("import sys\nsys.exit(3)\n")
    (tmp_path / "unsigned_foreign.py").write_text(UNSIGNED)
    info = tmp_path / "foreign-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign\nVersion: 1\n")
    entries = {**ENTRIES, **UNLISTABLE}
    lines = "".join(f"{name} = {target}\n" for name, target in entries.items())
    (info / "entry_points.txt").write_text(f"[mcspectra.samplers]\n{lines}")
    monkeypatch.syspath_prepend(tmp_path)

    assert main(["list", "samplers", "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    assert {name for name, row in rows.items() if "not available" in row["summary"]} >= {
        *ENTRIES,
        *UNLISTABLE,
    }
    assert "not available" not in rows["jittered"]["summary"]

    for name, target in ENTRIES.items():
        assert main(["points", name, "-n", "4"]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith(f"mcspectra: The sampler {name!r} ({target}) ")
        assert err.count("\n") == 1


def test_chains_have_a_largest_length():
    with pytest.raises(
        ParameterError, match="32 randomizations, the most allowed; leave the others out"
    ):
        mcs.sampler("random" + " | shift" * 33)
    assert mcs.sampler("random" + " | shift" * 32).draw(4, rng=1).shape == (1, 4, 2)


def test_nested_lists_are_points():
    assert mcs.sampler([[0.1, 0.2], [0.3, 0.4]]).draw(2).tolist() == [[[0.1, 0.2], [0.3, 0.4]]]
