"""Forged ledgers with valid digests: results are read correctly or refused with a sentence.

``python -m tests.studies.test_forged`` prints the numbers of refused and shown ledgers of each
kind.
"""

import contextlib
import itertools
import json
import sqlite3
import sys
import tempfile
from collections import Counter
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pytest
import xarray as xr
from tests.report.figures import leave_out_figures

from mcspectra.cli.main import main
from mcspectra.core.errors import McspectraError, StoreError
from mcspectra.core.records import pack
from mcspectra.report import write_comparison, write_report
from mcspectra.studies import decode_study, make_plan, run_study, summarize
from mcspectra.studies import ledger as ledger_module
from mcspectra.studies.files import plain_study, planned_groups
from mcspectra.studies.ledger import Ledger, StudyNote
from mcspectra.studies.results import (
    export_results,
    open_results,
    result_scalars,
    showing,
    study_status,
    write_zarr,
)

STUDY = """
title = "forged"
seed = 3
samplers = ["random", "jittered"]
[convergence]
counts = [4, 16, 64]
realizations = 20
[terms]
n = 16
half_width = 4
realizations = 20
[predict]
counts = [4, 16]
[spectrum]
n = 16
half_width = 4
realizations = 20
[[estimators]]
name = "smooth"
integrand = "gaussian"
dims = 1
"""
CONFIG = decode_study(STUDY)
PATHS = tuple(cell.path for cell in make_plan(CONFIG, ".").cells)


@pytest.fixture(scope="module")
def honest(once, tmp_path_factory):
    """Results of a real run, by path."""
    return once("honest", lambda: honest_results(tmp_path_factory.mktemp("honest")))


def honest_results(folder):
    run_study(CONFIG, folder, workers=1)
    tree = open_results(folder)
    return {path: tree[path].to_dataset(inherit=False) for path in PATHS}


def forged_ledger(folder, results, names=None, study=None):
    """Write a ledger with these results under other names."""
    note = StudyNote.of(CONFIG, {})
    if study is not None:
        note = msgspec.structs.replace(note, config=json.dumps(study))
    paths = tuple((names or {}).get(path, path) for path in results)
    with Ledger.create(folder, note, paths) as ledger:
        for path, (name, result) in zip(paths, results.items(), strict=True):
            payload = result if isinstance(result, bytes) else pack(result)
            scalars = {} if isinstance(result, bytes) else {"rate": -1.0}
            ledger.finish(path, payload, scalars)
            assert name in PATHS
    return folder


def with_other_paths(honest):
    """Yield cells that the study does not have."""
    names = (
        *("../../evil/terms", "..", "", "a//terms", "/etc/passwd", "smooth/random/terms/"),
        *("smooth/random/\x1b]52;c;aGk=\x07", "smooth/\u202eran/terms", "smooth/random/terms\n"),
        *(
            "e/x/terms",
            "smooth/random/plan",
            "smooth/owen/terms",
            "smooth/random/terms/x",
            "a" * 10**6,
        ),
        *(
            "smooth\\random\\terms",
            "C:/windows/terms",
            "smooth/random/\ud800",
            "smooth/random/zarr.json",
        ),
        *("smooth/./terms", "SMOOTH/random/terms", "smooth/random /terms", "smooth/-/terms"),
    )
    for name in names:
        yield f"path {name[:30]!a}", honest, {PATHS[1]: name}, None


def with_other_studies(honest):
    """Yield texts that are not a study, or not the study of these cells."""
    plain = plain_study(CONFIG)
    for text in (
        [],
        {},
        3,
        "x",
        None,
        {"estimators": 3},
        {"estimators": [3]},
        {"estimators": [{}]},
    ):
        yield f"study {text}", honest, None, text
    for key, value in {
        "title": 5,
        "samplers": [["random"], 3],
        "seed": "x",
        "estimators": [{"name": 3, "samplers": "random"}],
        "terms": 5,
        "a\x1b[2J": {},
    }.items():
        yield f"study with {key!a}", honest, None, plain | {key: value}


def with_other_payloads(honest):
    """Yield results that no analysis produces, as functions that make them."""

    def instead(path, make):
        return lambda: honest | {path: make()}

    for path, other in itertools.islice(itertools.permutations(PATHS, 2), 0, 60, 3):
        yield "result of another cell", honest | {path: honest[other]}, None, None
    for path, data in honest.items():
        yield "empty result", honest | {path: xr.Dataset()}, None, None
        yield "no result", honest | {path: b"mcs1 and no more"}, None, None
        for make in changed(data):
            yield "changed variable", instead(path, make), None, None
        for name, value in data.attrs.items():
            others = ("", "\x1b[31m", -1, 0, 10**18, float("nan"), [], ["x"], {}, "x" * 10**5)
            for place, each in enumerate(others):
                if (len(name) + place) % 3 == 0:
                    make = partial(data.assign_attrs, {name: each})
                    yield "changed attribute", instead(path, make), None, None
            rest = {key: value for key, value in data.attrs.items() if key != name}
            make = lambda data=data, rest=rest: data.drop_attrs().assign_attrs(rest)
            yield "missing attribute", instead(path, make), None, None
            assert value is not None


def changed(data):
    """Yield functions that make a dataset with a variable or a dim removed, renamed or changed."""
    assign = lambda name, *variable: partial(data.assign, {name: variable})
    for name, variable in data.variables.items():
        yield partial(data.drop_vars, name)
        if name not in data.dims:
            yield partial(data.rename, {name: "x\x1b[2J"})
            yield partial(data.rename, {name: "__class__"})
        values = np.asarray(variable.values)
        for each in (0 * values, np.full(values.shape, np.nan), np.full(values.shape, -np.inf)):
            yield assign(name, variable.dims, each, variable.attrs)
        yield assign(name, variable.dims, np.full(values.shape, "1"), variable.attrs)
        yield assign(name, variable.dims, values.astype(complex), variable.attrs)
        yield assign(name, variable.dims, values.astype(bool), {"units": 3, "x": []})
        yield assign(f"{name}_se", (), np.float64(-1.0))
        if variable.dims and name not in data.dims:
            flat = [f"other{axis}" for axis in range(variable.ndim)]
            yield assign(name, flat, values)
    for dim in data.dims:
        for part in (slice(0, 0), slice(0, 1), slice(None, None, -1)):
            yield partial(data.isel, {dim: part})
        yield partial(data.rename, {dim: "channel"})


def all_forgeries(honest):
    yield from with_other_paths(honest)
    yield from with_other_studies(honest)
    yield from with_other_payloads(honest)


def shown(folder):
    """Return the table that `mcspectra run` prints."""
    with showing(folder):
        return summarize(open_results(folder))


VERBS = {
    "open": open_results,
    "summary": lambda folder: shown(folder),
    "scalars": result_scalars,
    "status": study_status,
    "verify": lambda folder: study_status(folder, verify=True),
    "store": write_zarr,
    "report": write_report,
    "comparison": lambda folder: write_comparison(folder.parent / "honest", folder),
    **{
        end: lambda folder, end=end: export_results(folder, folder.parent / f"x{end}")
        for end in (".csv", ".zarr")
    },
}


def tried(forgery, folder, verbs=VERBS):
    """Count the verbs that show something, and the verbs that refuse with a sentence."""
    kind, results, names, study = forgery
    results = results() if callable(results) else results
    found = Counter()
    try:
        forged_ledger(folder, results, names, study)
    except (McspectraError, UnicodeError, OverflowError):  # The forgery itself is not possible
        return Counter()
    for verb in verbs.values():
        try:
            verb(folder)
            found[f"{kind.split()[0]} read"] += 1
        except McspectraError:
            found[f"{kind.split()[0]} refused"] += 1
    here = {path.name for path in folder.parent.iterdir()}
    assert here <= {folder.name, "honest", "x.csv", "x.zarr"}
    return found


@pytest.fixture
def place(tmp_path, honest, monkeypatch):
    leave_out_figures(monkeypatch.setattr)
    (tmp_path / "in").mkdir()
    forged_ledger(tmp_path / "in" / "honest", honest)
    return tmp_path / "in" / "forged"


MAPS = """
title = "maps"
samplers = ["random"]
[spectrum]
n = 16
half_width = 4
[[estimators]]
name = "a, A"
integrand = "gaussian"
dims = 1
samplers = ["jittered | shift", "jittered"]
[[estimators]]
name = "a. a"
integrand = "gaussian"
dims = 1
[estimators.predict]
counts = [4]
[[maps]]
name = "a a"
scene = "cornell-box"
"""


@pytest.mark.parametrize("text", [STUDY, MAPS])
def test_paths_of_the_plan_are_those_of_the_study(text):
    config = decode_study(text)
    groups = planned_groups(plain_study(config))
    found = [f"{e}/{s}/{a}" for e, (own, asked) in groups.items() for s in own for a in asked]
    assert found == [cell.path for cell in make_plan(config, ".").cells]


@pytest.mark.filterwarnings("ignore")
def test_real_results_are_read(place, honest):
    assert set(tried(("honest", honest, None, None), place)) == {"honest read"}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["../../evil/terms", "e/x/terms", "smooth/random/\x1b[2J", ""])
def test_a_cell_outside_the_study_is_refused(place, honest, name):
    forged_ledger(place, honest, {PATHS[1]: name})
    for verb in ("open", "report", ".csv"):
        with pytest.raises(
            StoreError, match="which its study does not have|list of cells: it was changed"
        ):
            VERBS[verb](place)
    assert "list of cells" in study_status(place, verify=True).damaged
    with pytest.raises(StoreError, match="belongs to another study"):
        run_study(CONFIG, place, resume=True)


STRANGE = "2026-01-01T00:00:00+00:00\n\x1b[2JFORGED"
TALLIES = {
    "digest": [{"digest": "x"}, {"digest": "-1"}, {"digest": "f" * 10**5}],
    "number": [{"size": 10**400}, {"size": -1}, {"done": -1}, {"done": 10**30}],
    "time": [{"started": STRANGE}, {"finished": "x" * 10**6}],
    "hosts": [{"hosts": []}, {"hosts": ["a\nFORGED"]}, {"hosts": ["x" * 10**6]}],
    "holder": [
        {"holder": {"host": "\x1b[2J\nFORGED", "pid": 1, "since": STRANGE}},
        {"holder": {"host": "x" * 10**6, "pid": 10**400, "since": STRANGE[:25]}},
        {"holder": {"host": "x" * 10**6, "pid": 1, "since": STRANGE[:25]}},
    ],
    "text": ["[" * 10**5, "null", '{"done":1e999}', '{"size":' + "9" * 5000 + "}"],
}


def forged_note(folder, name, text):
    """Replace both copies of a note, with valid digests."""
    with contextlib.closing(sqlite3.connect(folder / "study.sqlite")) as connection:
        study = Ledger.read(folder).study
        digest = ledger_module._digest(study, "note", (name,), text.encode())
        for table in ("texts", "notes"):
            connection.execute(
                f"UPDATE {table} SET text = ?, digest = ? WHERE kind = 'note' AND name = ?",
                (text, digest, name),
            )
        connection.commit()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", TALLIES)
def test_forged_tallies_give_sentences(place, honest, capsys, kind):
    """``status --verify`` used to end with ValueError, OverflowError or IndexError."""
    for number, changed in enumerate(TALLIES[kind]):
        folder = forged_ledger(place.with_name(f"forged{number}"), honest)
        with Ledger.read(folder) as ledger:
            plain = msgspec.to_builtins(ledger.tally)
        forged_note(
            folder, "tally", changed if isinstance(changed, str) else json.dumps(plain | changed)
        )
        for verb in (("status",), ("status", "--verify"), ("status", "--verify", "--json")):
            assert main([verb[0], str(folder), *verb[1:]]) in (0, 1)
            out, err = capsys.readouterr()
            assert "Unexpected" not in err
            lines = out.splitlines()
            assert not any(line.startswith(("FORGED", "\x1b")) for line in lines)
            assert "--json" in verb or max(map(len, lines)) < 1100
        kept = study_status(folder, verify=True).done
        with Ledger.resume(folder, StudyNote.of(CONFIG, {}), PATHS) as ledger:
            assert tuple(ledger.done) == kept


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", [None, b"\xff", 5, "a", ""])
def test_paths_of_other_types_give_sentences(place, honest, capsys, path):
    forged_ledger(place, honest)
    with contextlib.closing(sqlite3.connect(place / "study.sqlite")) as connection:
        connection.execute("UPDATE cells SET path = ? WHERE place = 0", (path,))
        connection.commit()
    for more in ((), ("--verify",)):
        main(["status", str(place), *more])
        assert "Unexpected" not in capsys.readouterr().err
    assert "list of cells" in study_status(place, verify=True).damaged


@pytest.mark.filterwarnings("ignore")
def test_a_forged_header_prints_short_lines(place, honest, capsys):
    note = msgspec.structs.replace(
        StudyNote.of(CONFIG, {}),
        title="x" * 10**6,
        seed=10**4000,
        versions={"mcspectra": "\nFORGED" + "x" * 10**6},
    )
    Ledger.create(place, note, PATHS).close()
    for verb in (("status",), ("status", "--verify")):
        assert main([verb[0], str(place), *verb[1:]]) in (0, 1)
        lines = capsys.readouterr().out.splitlines()
        assert max(map(len, lines)) < 1100
        assert not any(line.startswith("FORGED") for line in lines)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["missing", "undeclared", "dims", "numbers", "attribute"])
def test_an_impossible_result_gives_a_sentence(place, honest, kind):
    path = next(path for path in PATHS if path.endswith("terms"))
    data = honest[path]
    made = {
        "missing": data.drop_vars("captured"),
        "undeclared": data.assign(x=1.0),
        "dims": data.assign(power_term=("other", [1.0])),
        "numbers": data.assign(power_term=((), "1")),
        "attribute": data.assign_attrs(n="many"),
    }[kind]
    forged_ledger(place, honest | {path: made})
    with pytest.raises(StoreError, match="cannot be shown|is damaged: terms"):
        write_report(place)
    if kind in ("undeclared", "dims", "numbers"):
        with pytest.raises(StoreError, match=f"The cell {path} in .* is damaged: terms"):
            open_results(place, path)


@pytest.mark.parametrize("text", ["", "3", "{", "[" * 10**5, '{"rate": "x"}', '{"rate": []}'])
def test_forged_study_texts_give_sentences(place, honest, text, monkeypatch):
    monkeypatch.setattr("mcspectra.studies.ledger.json.dumps", lambda _: text)
    forged_ledger(place, honest)
    monkeypatch.undo()
    with pytest.raises(StoreError, match=r"The scalars of .* are damaged"):
        result_scalars(place)
    note = msgspec.structs.replace(StudyNote.of(CONFIG, {}), config=text)
    Ledger.create(place.parent / "other", note, PATHS).close()
    for verb in (open_results, write_report):  # The ledger has no cells
        with contextlib.suppress(StoreError):
            verb(place.parent / "other")
    study_status(place.parent / "other", verify=True)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("step", [400, pytest.param(15, marks=pytest.mark.endurance)])
def test_forgeries_are_read_or_refused_in_a_sentence(place, honest, step):
    found = all_trials(honest, place, step)
    print(dict(found))
    assert found["path read"] < found["path refused"]


def all_trials(honest, place, step=1):
    found = Counter()
    with tempfile.TemporaryDirectory(dir=place.parent.parent) as base:
        forged_ledger(Path(base) / "x" / "honest", honest)
        for number, forgery in enumerate(all_forgeries(honest)):
            if number % step == 0:
                made = Path(base) / "x" / f"forged{number}"
                found += tried(forgery, made)
                found[f"{forgery[0].split()[0]} forgeries"] += 1
                for each in (made, *made.parent.glob("x.*")):
                    removed(each)
    return found


def removed(place):
    import shutil

    shutil.rmtree(place) if place.is_dir() else place.unlink(missing_ok=True)


if __name__ == "__main__":
    leave_out_figures(setattr)
    with tempfile.TemporaryDirectory() as folder:
        made = honest_results(Path(folder) / "run")
        (Path(folder) / "in").mkdir()
        trials = all_trials(made, Path(folder) / "in" / "x", int((*sys.argv, 1)[1]))
        print(json.dumps(dict(sorted(trials.items())), indent=1))


HEADERS = {
    "study_hash": {"study_hash": "0" * 64},
    "plan": {"plan": "0" * 64},
    "version": {"versions": {"version_mcspectra": "0.0.1"}},
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", HEADERS)
def test_verify_and_resume_refuse_the_same_headers(place, honest, kind, capsys):
    note = StudyNote.of(CONFIG, {})
    changes = dict(HEADERS[kind])
    paths = list(reversed(PATHS)) if changes.pop("plan", None) else PATHS
    changed = msgspec.structs.replace(note, **changes)
    Ledger.create(place, changed, paths).close()
    with pytest.raises(StoreError) as refused:
        Ledger.resume(place, note, PATHS)
    status = study_status(place, verify=True)
    assert main(["status", str(place), "--verify"]) == 1
    told = capsys.readouterr().out
    assert "keeps the results" not in told
    if kind == "study_hash":  # The text or the hash may be forged
        assert "so that --resume may refuse" in status.damaged["the header"]
    else:
        assert status.refusal in str(refused.value)
        assert "--resume refuses this folder" in told
