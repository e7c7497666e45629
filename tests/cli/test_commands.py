"""Each verb as a user types it: text, JSON, seeds, pipes, exit codes."""

import contextlib
import io
import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.cli.main import main
from mcspectra.core.errors import StoreError
from mcspectra.studies import result_paths


def run(capsys, *arguments):
    code = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def run_json(capsys, *arguments):
    code, out, err = run(capsys, *arguments, "--json")
    assert code == 0, err
    return json.loads(out)


@pytest.mark.parametrize(
    "verb", ["run", "list", "points", "spectrum", "variance", "converge", "doctor", "cite"]
)
def test_every_verb_has_help_and_the_common_options(capsys, verb):
    code, out, _ = run(capsys, verb, "--help")
    assert code == 0
    for option in ("--json", "--seed", "--quiet"):
        assert option in out


@pytest.mark.parametrize(
    "kind", ["samplers", "randomizations", "densities", "integrands", "scenes"]
)
def test_list(capsys, kind):
    rows = run_json(capsys, "list", kind)
    assert all(row["name"] and row["summary"] for row in rows)
    assert len({row["name"] for row in rows}) == len(rows)
    code, out, _ = run(capsys, "list", kind)
    assert code == 0
    assert all(row["name"] in out for row in rows)


def test_points_are_those_of_the_library(capsys, tmp_path):
    expected = mcs.sampler("jittered | shift", dims=3).draw(27, realizations=2, rng=5)
    arguments = ("points", "jittered | shift", "-n", 27, "-d", 3, "-m", 2, "--seed", 5)
    assert np.array_equal(run_json(capsys, *arguments)["points"], expected)
    code, out, _ = run(capsys, *arguments)
    assert code == 0
    sets = [np.loadtxt(io.StringIO(part)) for part in out.split("#\n")]
    assert np.array_equal(np.stack([s for s in sets if s.size]), expected)
    for ending in ("dat", "bin", "npz", "csv"):
        file = tmp_path / f"p.{ending}"
        assert run(capsys, *arguments, "-o", file)[0] == 0
        again = mcs.Sampler.from_files(file).draw(27, realizations=2)
        assert np.allclose(again, expected, atol=1e-7 if ending == "bin" else 0), ending


def test_points_pipe_into_spectrum(capsys, monkeypatch):
    _, text, _ = run(capsys, "points", "jittered", "-n", 64)
    monkeypatch.setattr(sys, "stdin", io.StringIO(text))
    data = run_json(capsys, "spectrum", "-", "-n", 64, "--half-width", 8, "-m", 1)
    expected = mcs.power_spectrum("jittered", 64, half_width=8, realizations=1)
    assert np.allclose(data["radial_power"], expected["radial_power"])


def test_spectrum_writes_values_and_pictures(capsys, tmp_path):
    for ending in ("npz", "png", "pdf"):
        file = tmp_path / f"s.{ending}"
        arguments = ("spectrum", "jittered", "-n", 16, "--half-width", 8, "-m", 4, "-o", file)
        assert run(capsys, *arguments)[0] == 0
        assert file.stat().st_size > 500
    stored = np.load(tmp_path / "s.npz")
    assert stored["power"].shape == (17, 17)


def test_variance_text_and_json_agree(capsys):
    arguments = ("variance", "gaussian", "-d", 2, "--sampler", "jittered", "-n", 16, "-m", 50)
    data = run_json(capsys, *arguments, "--half-width", 8)
    total = data["dc_term"] + data["power_term"] + data["cross_term"]
    assert total == pytest.approx(data["predicted_variance"])
    _, out, _ = run(capsys, *arguments, "--half-width", 8)
    assert f"{data['cross_term']:.6g}" in out
    assert f"{data['captured']:.6g}" in out


def test_variance_under_mis_and_infinite_weights(capsys):
    code, out, _ = run(
        capsys,
        *("variance", "linear", "-d", 1, "--density", "uniform", "--density", "linear(slope=2)"),
        *("--sampler", "random", "-n", 8, "-m", 50, "--half-width", 8),
    )
    assert code == 0
    assert "balance[uniform, linear(slope=2)]" in out
    code, out, err = run(
        capsys,
        *("variance", "polynomial(coefficients=[0,0,1])", "-d", 1, "--density", "linear(slope=2)"),
        *("--sampler", "random", "-n", 8, "-m", 50, "--half-width", 8),
    )
    assert code == 0
    assert "infinite" in out
    assert "undefined" in out
    assert err.startswith("mcspectra: Warning: ∫1/p diverges")
    assert "inf\n" not in out
    assert "nan" not in out


def test_converge_rates(capsys):
    data = run_json(
        capsys,
        *("converge", "christensen-gaussian", "--sampler", "random", "--sampler", "jittered"),
        *("--counts", "16,64,256", "-m", 400),
    )
    rates = {curve["sampler"]: curve["rate"] for curve in data["curves"]}
    assert rates["random"] == pytest.approx(-1, abs=0.2)
    assert rates["jittered"] == pytest.approx(-2, abs=0.2)
    code, out, _ = run(
        capsys,
        *("converge", "step", "--plus", "linear", "-d", 1, "--sampler", "jittered"),
        *("--counts", "4", "-m", 10),
    )
    assert code == 0
    assert "–" in out


def test_doctor_and_cite(capsys):
    found = run_json(capsys, "doctor")
    assert found["works"] is True
    assert "largest difference" in found["transforms"]
    assert "cufinufft" in found["gpu"] or "engine='gpu'" in found["gpu"]
    assert set(found["optional packages"]) == {"qmcpy", "pyarrow", "vegas"}
    entries = run_json(capsys, "cite")
    assert any("10.1111/cgf.13613" in entry["bibtex"] for entry in entries)


def test_seed_changes_results_and_quiet_keeps_the_points(capsys):
    one = run(capsys, "points", "random", "-n", 4, "--seed", 1)[1]
    assert one == run(capsys, "points", "random", "-n", 4, "--seed", 1)[1]
    assert one != run(capsys, "points", "random", "-n", 4, "--seed", 2)[1]
    quiet = run(capsys, "points", "sobol", "-n", 3, "--quiet")
    assert len(quiet[1].splitlines()) == 3
    assert quiet[2] == ""


def test_version(capsys):
    assert run(capsys, "--version")[1].strip() == mcs.__version__


def test_closed_pipe_is_no_error():
    command = f"{sys.executable} -m mcspectra points random -n 200000 | head -n 1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert len(done.stdout.splitlines()) == 1


STUDY = """
title = "long"
samplers = ["random", "jittered", "jittered | shift"]
[terms]
n = 1024
half_width = 100
realizations = 400
[[estimators]]
name = "a"
integrand = "gaussian"
[[estimators]]
name = "b"
integrand = "disk"
"""


def test_ctrl_c_leaves_a_resumable_store(tmp_path, hear_interrupts):
    (tmp_path / "study.toml").write_text(STUDY)
    command = [sys.executable, "-m", "mcspectra", "run", "study.toml", "--out", "out"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        with contextlib.suppress(StoreError):
            if any(path.endswith("/terms") for path in result_paths(tmp_path / "out")):
                break
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "--resume" in err
    assert "Traceback" not in err
    again = subprocess.run(
        [*command, "--quiet"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert again.returncode == 2
    assert "--resume" in again.stderr
    done = subprocess.run(
        [*command, "--resume", "--json"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert len(json.loads(done.stdout)["rows"]) == 6
    assert (tmp_path / "out/report.html").exists()
    assert any((tmp_path / "out/figures").iterdir())


def test_a_terminal_without_unicode_loses_characters_not_results():
    import os

    environment = {
        **os.environ,
        "PYTHONIOENCODING": "ascii",
        "PYTHONUTF8": "0",
        "PYTHONCOERCECLOCALE": "0",
        "LC_ALL": "C",
    }
    command = [sys.executable, "-m", "mcspectra", "list", "integrands"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert "gaussian" in done.stdout


def test_closed_standard_input_is_a_sentence():
    command = f"{sys.executable} -m mcspectra points - -n 4 <&-"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "closed" in done.stderr


def test_a_pipe_is_no_study_file(tmp_path):
    import os

    os.mkfifo(tmp_path / "pipe.toml")
    command = [sys.executable, "-m", "mcspectra", "run", str(tmp_path / "pipe.toml")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2
    assert "not a file" in done.stderr


def test_variance_in_another_basis_with_named_bands(capsys):
    arguments = ("variance", "gaussian", "--sampler", "sobol | owen", "-n", 16, "-m", 40)
    found = run_json(capsys, *arguments, "--half-width", 8, "--basis", "auto", "--bands", "anova")
    expected = mcs.variance_terms(
        "gaussian", "sobol | owen", 16, half_width=8, realizations=40, basis="walsh", bands="anova"
    )
    assert found["basis"] == "walsh"
    assert found["band_labels"] == ["constant", "x0", "x1", "x0x1"]
    for name in ("cross_term", "cross_term_se", "captured_ci", "band_covariance"):
        np.testing.assert_allclose(found[name], expected[name].values)
    code, out, _ = run(capsys, *arguments, "--half-width", 8, "--basis", "walsh")
    assert code == 0
    assert "walsh basis" in out
    low, high = (float(end) for end in expected["cross_term_ci"].values)
    assert f"{low:.4g} … {high:.4g}" in out
    assert found["batches"] == expected.attrs["batches"] == 20


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--basis", "sine"), "basis is 'sine'; it must be one of fourier, cosine"),
        (("--basis", "haar", "--half-width", 12), "needs a power of two"),
        (("--bands", "rings"), "bands is 'rings'"),
    ],
)
def test_variance_refuses_other_bases_and_bands(capsys, options, words):
    code, out, err = run(capsys, "variance", "gaussian", "--sampler", "random", "-n", 16, *options)
    assert (code, out) == (2, "")
    assert words in err


def test_converge_stops_at_a_precision_and_chooses_its_window(capsys):
    arguments = ("converge", "gaussian", "--sampler", "jittered", "--counts", "4,16,64,256")
    found = run_json(capsys, *arguments, "--relative-error", 0.2, "--fit-last", "auto")
    assert found["fit_window"] == "auto"
    expected = mcs.convergence(
        mcs.Estimator("gaussian"),
        ["jittered"],
        [4, 16, 64, 256],
        relative_error=0.2,
        fit_last="auto",
    )
    (curve,) = found["curves"]
    for name in ("variance", "mse", "fit_first_n", "fit_chi2", "realizations_used", "reached"):
        np.testing.assert_allclose(curve[name], expected[name].values[0])
    _, out, _ = run(capsys, *arguments, "--relative-error", 0.2, "--fit-last", "auto")
    assert "fit from n" in out.splitlines()[1]
    shown = [f"{curve['fit_first_n']:.0f}", f"{curve['fit_chi2']:.3g}"]
    assert out.splitlines()[-1].split()[-2:] == shown


def test_converge_says_which_counts_missed_the_precision(capsys):
    arguments = ("converge", "gaussian", "--sampler", "random", "--counts", "4,16", "-m", 20)
    code, out, _ = run(capsys, *arguments, "--relative-error", 0.01)
    assert code == 0
    assert (
        "random: the relative error 0.01 was not reached with 20 realisations at n = 4, 16" in out
    )
    assert run_json(capsys, *arguments, "--relative-error", 0.01)["curves"][0]["reached"] == [0, 0]
    assert "reached" not in run(capsys, *arguments)[1]


@pytest.mark.parametrize("given", ["foo", "2.5", "nan"])
def test_converge_names_the_windows_it_takes(capsys, given):
    code, _, err = run(
        capsys, "converge", "gaussian", "--sampler", "random", "--counts", "4,16",
        f"--fit-last={given}",
    )  # fmt: skip
    assert code == 2
    assert f"--fit-last is '{given}'; give a whole number of at least 2, or 'auto'." in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            "spectrum random -n 4 --half-width 0",
            "--half-width is 0; give a whole number of at least 1",
        ),
        ("spectrum random -n 4 --half-width 100000", "use at most 1.34e+08: --half-width ≤ 5792"),
        ("spectrum random -n 4 -d 5 --half-width 2 --engine nufft", "use --engine direct."),
        ("variance gaussian --sampler random -n 4 --eps 0.5", "--eps is 0.5; give a finite number"),
        ("pcf random -n 1", "'mcspectra pcf' needs n of at least 2"),
        ("pcf random -n 4 --boundary border --max-distance 0.5", "--max-distance is 0.5; with"),
        (
            "exact gaussian --sampler sobol -n 16",
            "use 'mcspectra converge' or 'mcspectra variance'.",
        ),
        ("render veach --film foo", "--film is 'foo'; it must be one of"),
    ],
)
def test_errors_name_options_and_verbs_as_they_are_typed(capsys, arguments, words):
    code, _, err = run(capsys, *arguments.split())
    assert code == 2
    assert words in err


def test_converge_fits_two_counts_or_more(capsys):
    code, _, err = run(
        capsys, "converge", "gaussian", "--sampler", "random", "--counts", "4,16", "--fit-last", 1
    )
    assert code == 2
    assert "--fit-last is 1; give a whole number of at least 2" in err


@pytest.mark.parametrize("given", ["0", "-1", "nan", "inf", "x"])
def test_converge_refuses_other_precisions(capsys, given):
    code, _, err = run(
        capsys, "converge", "gaussian", "--sampler", "random", "--counts", "4,16",
        f"--relative-error={given}",
    )  # fmt: skip
    assert code == 2
    assert "--relative-error is" in err


def test_gallery(capsys, tmp_path):
    arguments = ("gallery", "random", "--quick", "--out", tmp_path / "g")
    assert run_json(capsys, *arguments)["gallery"] == str(tmp_path / "g" / "index.html")
    assert run(capsys, "gallery", "nothing", "--out", tmp_path / "h")[0] == 2
    assert not (tmp_path / "h").exists()
