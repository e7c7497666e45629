"""The verb `profile`: files of draws, and functions in Python that are named."""

import json
import math
import os
import pickle

import numpy as np
import pytest
import xarray as xr

import mcspectra as mcs
from mcspectra.core import trust

DRAWS = np.random.default_rng(1).standard_normal((2, 100))


def _csv(file, header, rows):
    lines = [header, *(",".join(f"{value!r}" for value in row) for row in rows.tolist())]
    file.write_text("\n".join(lines), encoding="utf-8")
    return file


@pytest.fixture
def files(tmp_path):
    """The same draws in every format."""
    np.save(tmp_path / "both.npy", DRAWS)
    for k in range(2):
        np.save(tmp_path / f"{k}.npy", DRAWS[k])
        _csv(tmp_path / f"{k}.csv", "# stan\nlp__,mu", np.stack([DRAWS[k], DRAWS[k]], axis=1))
    labels = np.repeat([3.0, 7.0], 100)
    rows = np.stack([labels, np.arange(200.0), DRAWS.ravel(), np.ones(200)], axis=1)
    _csv(tmp_path / "chains.csv", "chain,draw,mu,w", rows)
    posterior = xr.Dataset({"mu": (("chain", "draw"), DRAWS)})
    tree = xr.DataTree.from_dict({"/posterior": posterior})
    tree.to_zarr(tmp_path / "both.zarr", consolidated=False)
    return tmp_path


@pytest.mark.parametrize(
    "names",
    [
        ("both.npy",),
        ("0.npy", "1.npy"),
        ("0.csv", "1.csv"),
        ("chains.csv", "--weights", "w"),
        ("both.zarr",),
    ],
)
def test_every_format_has_the_answer_of_the_library(run_json, files, names):
    found = run_json("profile", *(n if n[0] == "-" or "." not in n else files / n for n in names))
    expected = mcs.measure.chain_error(DRAWS)
    for name in ("mean", "mcse", "ess"):
        np.testing.assert_allclose(np.ravel(found[name]), expected[name], rtol=1e-12)
    assert np.ravel(found["cause"]) == "none"


def test_the_text_names_causes_and_periods(run, files):
    np.save(files / "walk.npy", np.cumsum(DRAWS[0]))
    code, out, _ = run("profile", files / "walk.npy")
    assert code == 0
    assert out.startswith("1 × 100 draws\n")
    assert "stuck-chain: the chain drifts" in out
    assert "error share" in out
    assert "run several from scattered starts." in out
    code, out, _ = run("profile", files / "both.npy")
    assert out.rstrip().endswith("cause: none.")


def test_constant_draws_are_a_sentence(run, files):
    np.save(files / "constant.npy", np.full((4, 100), 0.1))
    code, out, _ = run("profile", files / "constant.npy")
    assert code == 0
    assert out == (
        "4 × 100 draws\nstuck-chain: the draws are constant: all are 0.1, and their mean has no "
        "error to estimate.\n"
    )
    np.save(files / "stuck.npy", np.arange(4.0)[:, None] + np.zeros(100))
    assert (
        "stuck-chain: no chain moves: each repeats one value"
        in run("profile", files / "stuck.npy")[1]
    )


def test_the_figure_is_written(run, files):
    both = ("-o", files / "f.svg", "--out", files / "f.csv")
    assert run("profile", files / "both.npy", *both, "--quiet")[0] == 0
    assert "cycles per draw" in (files / "f.svg").read_text("utf-8")
    assert "error_share" in (files / "f.csv").read_text("utf-8")


def test_weights_of_a_file(run_json, files):
    weights = np.random.default_rng(2).random((2, 100))
    np.save(files / "w.npy", weights)
    found = run_json("profile", files / "both.npy", "--weights", files / "w.npy")
    assert found["mcse"] == mcs.measure.chain_error(DRAWS, weights=weights)["mcse"].item()


@pytest.mark.parametrize("name", ["pipe.npy", "pipe.csv", "pipe.nc", "pipe.zarr", "zero.csv"])
def test_pipes_and_devices_are_refused(run, tmp_path, name):
    """A pipe blocked forever, and a device filled the memory."""
    os.mkfifo(tmp_path / name) if name[0] == "p" else (tmp_path / name).symlink_to("/dev/zero")
    code, _, err = run("profile", tmp_path / name)
    assert code == 2
    assert "is a device or a pipe; give" in err or "is not a folder; give" in err


def test_a_huge_sparse_table_is_refused(run, tmp_path):
    (tmp_path / "a.csv").touch()
    os.truncate(tmp_path / "a.csv", 2**40)
    assert "MB of memory to read" in run("profile", tmp_path / "a.csv")[2]


RAN = []


class Evil:
    def __reduce__(self):
        return RAN.append, ("code of the store",)


def store(folder, own=(), **changed):
    """Write a store of format 2 whose only chunk is a pickle, or 20 numbers."""
    chunk = pickle.dumps(Evil()) if changed.pop("evil", False) else np.arange(20.0).tobytes()
    array = {"chunks": [1, 20], "compressor": None, "dtype": "<f8", "fill_value": None}
    array |= {"filters": None, "order": "C", "shape": [1, 20], "zarr_format": 2} | changed
    files = {
        ".zgroup": {"zarr_format": 2},
        "mu/.zarray": array,
        "mu/.zattrs": {"_ARRAY_DIMENSIONS": ["chain", "draw"]},
        **dict(own),
    }
    (folder / "mu").mkdir(parents=True)
    for name, document in files.items():
        (folder / name).write_text(json.dumps(document))
    (folder / "mu" / "0.0").write_bytes(chunk)
    return folder


def test_a_store_runs_no_code(run, tmp_path, monkeypatch):
    """numcodecs before 0.16.6 loads pickles of any store, later ones if it is allowed."""
    monkeypatch.setattr("numcodecs.pickles.ALLOW_UNSAFE_PICKLE_DECODE", True, raising=False)
    pickled = {"id": "pickle", "protocol": 5}
    texts = {"dtype": "|O", "fill_value": None}
    for number, changed in enumerate(
        (
            texts | {"filters": [{"id": "vlen-utf8"}, pickled]},
            texts | {"filters": [pickled]},
            {"compressor": pickled},
            {"dtype": [["a", "<f8"]]},
        )
    ):
        code, _, err = run("profile", store(tmp_path / f"{number}.zarr", evil=True, **changed))
        assert code == 2
        assert "which is not read from a file: give a store" in err
        assert err.count("\n") == 1
    assert not RAN


def test_a_store_is_refused_for_its_size_and_for_links(run, tmp_path):
    for number, changed in enumerate(
        (
            {"shape": [1, 10**12]},
            {"chunks": [10**6, 10**6]},
            {"shape": [1, 10**6], "chunks": [1, 1]},
        )
    ):
        code, _, err = run("profile", store(tmp_path / f"{number}.zarr", **changed))
        assert code == 2
        assert "MB of memory to read" in err
    linked = store(tmp_path / "linked.zarr")
    (linked / "mu" / "0.0").unlink()
    (linked / "mu" / "0.0").symlink_to("/dev/zero")
    assert "is a link, a device or a pipe; give a store" in run("profile", linked)[2]


def test_a_sound_store_of_format_2_is_read(run, tmp_path):
    assert run("profile", store(tmp_path / "sound.zarr"))[0] == 0
    consolidated = {".zmetadata": {"zarr_consolidated_format": 1, "metadata": {}}}
    assert run("profile", store(tmp_path / "other.zarr", consolidated))[0] == 0


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("none.npy",), "There is no file"),
        (("draws.txt",), "is not a file of draws, which ends in .npy, .csv, .nc or .zarr. Give"),
        (("both.npy", "gaussian"), "'gaussian' is not a file of draws"),
        (("both.npy", "--budget", "512"), "--budget is for integrands; leave it out with files"),
        (("both.npy", "--sampler", "random"), "--sampler is for integrands"),
        (("gaussian", "--weights", "w"), "--weights is for files of draws; leave it out."),
        (("both.npy", "0.npy"), "do not hold one chain each"),
        (("0.npy", "0.csv"), "do not hold one chain each"),
        (("chains.csv", "--weights", "nu"), "no column 'nu'. Did you mean 'mu'?"),
        (("both.npy", "--weights", "w"), "no column 'w'"),
        (("bad.csv",), "bad.csv cannot be read as draws of Markov chains"),
        (("ragged.csv",), "ragged.csv cannot be read as draws of Markov chains"),
        (("empty.csv",), "empty.csv holds no draws; give a line of names"),
        (("names.csv",), "names.csv holds no draws"),
        (("text.csv",), "could not convert string to float"),
    ],
)
def test_bad_input_is_one_sentence(run, files, names, words):
    (files / "draws.txt").write_text("1\n")
    (files / "bad.csv").write_text("a,b\n1,2,3\n")
    (files / "empty.csv").touch()
    (files / "names.csv").write_text("a,b\n")
    (files / "text.csv").write_text("a\nx\n" + "1\n" * 20)
    (files / "ragged.csv").write_text("chain,b\n1,2\n2,3\n2,4\n")
    code, out, err = run("profile", *(files / n if "." in n else n for n in names))
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


FUNCTIONS = """
import numpy as np
def bump(x): return np.exp(-(x**2).sum(axis=-1))
def broken(x): raise ValueError("no such thing")
number = 3
"""


@pytest.fixture
def own_module(tmp_path, monkeypatch):
    """A module with functions; what a test allows is forgotten afterwards."""
    (tmp_path / "functions_of_a_user.py").write_text(FUNCTIONS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(trust, "_process", trust.process_trust())
    return "functions_of_a_user"


def test_functions_in_python_are_named_on_the_command_line(run_json, own_module):
    name = f"{own_module}:bump"
    given = (name, "-d", 2, "--budget", 1024, "--allow-code", name)
    found = run_json("profile", *given)
    truth = (math.erf(1.0) * math.pi**0.5 / 2) ** 2
    low, high = found["integral_ci"]
    assert low < truth < high
    same = mcs.profile(lambda x: np.exp(-(x**2).sum(axis=-1)), dims=2, budget=1024)
    assert found["integral"] == same.integral
    spec = f"python(function='{name}')"
    assert run_json("profile", spec, *given[1:])["integral"] == same.integral
    low, high = run_json("integrate", *given)["interval"]
    assert low < truth < high


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("bump", [], "allow it by --allow-code functions_of_a_user:bump"),
        ("bump", ["--allow-code"], "--dims is missing; give the number of inputs"),
        ("none", ["--allow-code", "-d2"], "cannot be imported"),
        ("number", ["--allow-code", "-d2"], "is 3, not a function"),
        ("broken", ["--allow-code", "-d2"], "failed at its first points: ValueError: no such"),
    ],
)
def test_functions_that_cannot_be_used_are_one_sentence(run, own_module, name, options, words):
    text = f"{own_module}:{name}"
    allowed = [part for each in options for part in ([each, text] if "code" in each else [each])]
    code, _, err = run("profile", text, *allowed)
    assert code == 2
    assert words in err
    assert err.count("\n") == 1
