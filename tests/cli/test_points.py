"""The verb `points`: files, pictures, quality figures."""

import json

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.pointfiles import EXTENSIONS, read_points
from mcspectra.quality import summarize


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_every_format_holds_the_points_of_the_library(run, tmp_path, extension):
    file = tmp_path / f"p{extension}"
    assert run("points", "jittered", "-n", 16, "-m", 3, "--seed", 5, "-o", file) == (0, "", "")
    expected = mcs.sampler("jittered", 2).draw(16, realizations=3, rng=5)
    np.testing.assert_array_equal(read_points(file), expected)


def test_several_files_hold_one_draw(run, tmp_path):
    files = [tmp_path / name for name in ("p.dat", "p.npz", "p.svg")]
    outs = [part for file in files for part in ("-o", file)]
    code, out, err = run("points", "random", "-n", 16, *outs, "-o", "-")
    assert (code, err) == (0, "")
    assert out == run("points", "random", "-n", 16)[1]
    np.testing.assert_array_equal(read_points(files[0]), read_points(files[1]))
    assert json.loads(run("points", "random", "-n", 4, *outs, "--json")[1])["files"] == [
        *map(str, files)
    ]
    code, _, err = run(
        "points", "random", "-n", 4, "-o", tmp_path / "q.dat", "-o", tmp_path / "q.x"
    )
    assert (code, "extension '.x'" in err) == (2, True)
    assert not (tmp_path / "q.dat").exists()


@pytest.mark.parametrize(("extension", "start"), [(".png", b"\x89PNG"), (".pdf", b"%PDF")])
def test_pictures_by_extension(run, tmp_path, extension, start):
    file = tmp_path / f"P{extension.upper()}"
    assert run("points", "random", "-n", 16, "-o", file)[0] == 0
    assert file.read_bytes().startswith(start)


def test_pictures_name_sampler_count_seed_and_density(run, tmp_path):
    file = tmp_path / "p.svg"
    density = ("--density", "linear(slope=0.5)")
    code, out, _ = run("points", "random", "-n", 9, "--seed", 7, *density, "-o", file, "--json")
    assert code == 0
    assert json.loads(out)["files"] == [str(file)]
    assert "<!-- random, n = 9, seed 7, density linear(slope=0.5) -->" in file.read_text()


def test_quality_equals_the_library_with_16_sets(run):
    code, out, _ = run("points", "sobol | owen", "-n", 16, "--quality", "--json")
    assert code == 0
    found = json.loads(out)
    assert (found["sampler"], found["n"], found["realizations"]) == ("sobol | owen", 16, 16)
    expected = summarize(mcs.quality_figures("sobol | owen", 16))
    assert list(found["quality"]) == [figure.name for figure in expected]
    for figure in expected:
        entry = found["quality"][figure.name]
        assert entry["mean"] == pytest.approx(figure.mean)
        assert entry["standard_error"] == pytest.approx(figure.standard_error)


def test_quality_table_has_reasons_for_missing_figures(run, tmp_path):
    file = tmp_path / "p.csv"
    arguments = ("points", "random", "-n", 10, "-m", 1, "--quality", "-o", file)
    code, out, _ = run(*arguments)
    assert code == 0
    assert out.startswith("random, n = 10, 1 set\n")
    row = next(line for line in out.splitlines() if line.startswith("diaphony"))
    assert row.endswith(" -")  # One set has no standard error
    assert "no t_value: 10 is not a power of 2." in out
    assert len(read_points(file)) == 1
    assert run(*arguments, "--quiet") == (0, out, "")


def test_quality_of_given_and_of_warped_points(run, tmp_path):
    sets = np.random.default_rng(0).random((3, 8, 2))
    mcs.core.pointfiles.write_points(tmp_path / "p.npz", sets)
    spec = f"points(path={str(tmp_path / 'p.npz')!r})"
    given = json.loads(run("points", spec, "-n", 8, "--quality", "--json")[1])
    assert given["realizations"] == 3
    density = ("--density", "linear(slope=1.5)", "--quality", "--json", "-m", 2)
    warped = json.loads(run("points", "random", "-n", 8, *density)[1])
    points = mcs.density("linear(slope=1.5)", 2).sample(
        mcs.sampler("random", 2).draw(8, realizations=2, rng=0)
    )
    expected = mcs.quality_figures(points)["diaphony"].mean().item()
    assert warped["quality"]["diaphony"]["mean"] == pytest.approx(expected)
