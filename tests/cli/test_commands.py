"""Each verb as a user runs it: text, JSON, seeds, pipes, exit codes."""

import io
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from tests.processes import python

import mcspectra as mcs
from mcspectra.cli.main import _NOW, GROUPS, VERBS


@pytest.mark.parametrize(
    "kind",
    [
        "samplers",
        "randomizations",
        "densities",
        "integrands",
        "scenes",
        "filters",
        "screen-samplers",
    ],
)
def test_list(run, run_json, kind):
    rows = run_json("list", kind)
    assert all(row["name"] and row["summary"] for row in rows)
    assert len({row["name"] for row in rows}) == len(rows)
    code, out, _ = run("list", kind)
    assert code == 0
    assert all(row["name"] in out for row in rows)


def test_points_equal_those_of_the_library(run, run_json, tmp_path):
    expected = mcs.sampler("jittered | shift", dims=3).draw(27, realizations=2, rng=5)
    arguments = ("points", "jittered | shift", "-n", 27, "-d", 3, "-m", 2, "--seed", 5)
    assert np.array_equal(run_json(*arguments)["points"], expected)
    code, out, _ = run(*arguments)
    assert code == 0
    sets = [np.loadtxt(io.StringIO(part)) for part in out.split("#\n")]
    assert np.array_equal(np.stack([s for s in sets if s.size]), expected)


def test_spectrum_writes_values_and_pictures(run, tmp_path):
    for ending in ("npz", "csv", "tex", "png", "pdf", "svg"):
        file = tmp_path / f"s.{ending}"
        arguments = ("spectrum", "jittered", "-n", 16, "--half-width", 8, "-m", 4, "-o", file)
        assert run(*arguments)[0] == 0
        assert file.stat().st_size > 400
    stored = np.load(tmp_path / "s.npz")
    assert stored["power"].shape == (17, 17)


def test_variance_text_and_json_agree(run, run_json):
    arguments = ("variance", "gaussian", "-d", 2, "--sampler", "jittered", "-n", 16, "-m", 50)
    data = run_json(*arguments, "--half-width", 8)
    total = data["dc_term"] + data["power_term"] + data["cross_term"]
    assert total == pytest.approx(data["predicted_variance"])
    _, out, _ = run(*arguments, "--half-width", 8)
    assert f"{data['cross_term']:.6g}" in out
    assert f"{data['captured']:.6g}" in out


def test_variance_under_mis_and_infinite_weights(run):
    code, out, _ = run(
        *("variance", "linear", "-d", 1, "--density", "uniform", "--density", "linear(slope=2)"),
        *("--sampler", "random", "-n", 8, "-m", 50, "--half-width", 8),
    )
    assert code == 0
    assert "balance[uniform, linear(slope=2)]" in out
    code, out, err = run(
        *("variance", "polynomial(coefficients=[0,0,1])", "-d", 1, "--density", "linear(slope=2)"),
        *("--sampler", "random", "-n", 8, "-m", 50, "--half-width", 8),
    )
    assert code == 0
    assert "infinite" in out
    assert "undefined" in out
    assert err.startswith("mcspectra: Warning: ∫1/p diverges")
    assert "inf\n" not in out
    assert "nan" not in out


def test_converge_rates(run, run_json):
    data = run_json(
        *("converge", "christensen-gaussian", "--sampler", "random", "--sampler", "jittered"),
        *("--counts", "16,64,256", "-m", 400),
    )
    rates = {curve["sampler"]: curve["rate"] for curve in data["curves"]}
    assert rates["random"] == pytest.approx(-1, abs=0.2)
    assert rates["jittered"] == pytest.approx(-2, abs=0.2)
    code, out, _ = run(
        *("converge", "step", "--plus", "linear", "-d", 1, "--sampler", "jittered"),
        *("--counts", "4", "-m", 10),
    )
    assert code == 0
    assert "–" in out


def test_doctor_and_cite(run_json):
    found = run_json("doctor")
    assert found["works"] is True
    assert "largest difference" in found["transforms"]
    assert "bokeh" in found["extras"]["report"]
    entries = run_json("cite")
    assert any("10.1111/cgf.13613" in entry["bibtex"] for entry in entries)


def test_seed_changes_results_and_quiet_keeps_the_points(run):
    one = run("points", "random", "-n", 4, "--seed", 1)[1]
    assert one == run("points", "random", "-n", 4, "--seed", 1)[1]
    assert one != run("points", "random", "-n", 4, "--seed", 2)[1]
    quiet = run("points", "sobol", "-n", 3, "--quiet")
    assert len(quiet[1].splitlines()) == 3
    assert quiet[2] == ""


def test_version(run):
    assert run("--version")[1].strip() == mcs.__version__


def test_a_closed_pipe_is_not_an_error():
    # The output, of 200 kB, does not fit into the pipe
    command = f"{sys.executable} -m mcspectra points random -n 5000 | head -n 1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert len(done.stdout.splitlines()) == 1


def test_a_terminal_without_unicode_loses_characters_and_a_closed_input_gives_a_sentence():
    environment = {
        **os.environ,
        "PYTHONIOENCODING": "ascii",
        "PYTHONUTF8": "0",
        "PYTHONCOERCECLOCALE": "0",
        "LC_ALL": "C",
    }
    code = (
        "from mcspectra.cli.main import main; "
        "print(main(['list', 'integrands']), main(['points', '-', '-n', '4']))"
    )
    command = f'{sys.executable} -c "{code}" <&-'
    done = subprocess.run(
        command, shell=True, capture_output=True, text=True, check=False, env=environment
    )
    assert done.stdout.splitlines()[-1] == "0 2", done.stderr
    assert "gaussian" in done.stdout
    assert "closed" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_pipe_is_not_a_study_file(run, tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    code, _, err = run("run", tmp_path / "pipe.toml")
    assert code == 2
    assert "not a file" in err


def test_variance_in_another_basis_with_named_bands(run, run_json):
    arguments = ("variance", "gaussian", "--sampler", "sobol | owen", "-n", 16, "-m", 40)
    found = run_json(*arguments, "--half-width", 8, "--basis", "auto", "--bands", "anova")
    expected = mcs.variance_terms(
        "gaussian", "sobol | owen", 16, half_width=8, realizations=40, basis="walsh", bands="anova"
    )
    assert found["basis"] == "walsh"
    assert found["band_labels"] == ["constant", "x0", "x1", "x0x1"]
    for name in ("cross_term", "cross_term_se", "captured_ci", "band_covariance"):
        np.testing.assert_allclose(found[name], expected[name].values)
    code, out, _ = run(*arguments, "--half-width", 8, "--basis", "walsh")
    assert code == 0
    assert "walsh basis" in out
    low, high = (float(end) for end in expected["cross_term_ci"].values)
    assert f"{low:.4g} … {high:.4g}" in out
    assert found["batches"] == expected.attrs["batches"] == 20


def test_converge_stops_at_a_precision_and_chooses_its_window(run, run_json):
    arguments = ("converge", "gaussian", "--sampler", "jittered", "--counts", "4,16,64,256")
    found = run_json(*arguments, "--relative-error", 0.2, "--fit-last", "auto")
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
    _, out, _ = run(*arguments, "--relative-error", 0.2, "--fit-last", "auto")
    assert "fit from n" in out.splitlines()[1]
    shown = [f"{curve['fit_first_n']:.0f}", f"{curve['fit_chi2']:.3g}"]
    assert out.splitlines()[-1].split()[-2:] == shown


def test_converge_prints_an_infinite_upper_end(run, run_json):
    """It was not printed before, and JSON had null, as for unknown numbers."""
    arguments = ("converge", "disk(center=0.4, radius=0.006)", "-d", 1, "--sampler", "random")
    arguments = (*arguments, "--counts", "4,16", "-m", 300)
    curve = run_json(*arguments)["curves"][0]
    (low, high), known = curve["variance_ci"]
    assert high == "inf"
    assert known[1] < 1
    assert curve["rate_ci"] == ["-inf", "inf"]
    _, out, _ = run(*arguments)
    assert (
        f"{curve['variance'][0]:.4g} (≥ {low:.4g})  {curve['variance'][1]:.4g}  unresolved" in out
    )
    assert "tails not resolved at n = 4: few estimates cause the variance, tail index k̂ = " in out


def test_techniques_print_no_unresolved_rate(run):
    given = ("-d", 1, "--density", "uniform", "--density", "tent", "--sampler", "random")
    _, out, _ = run(
        "variance", "--split", "techniques", "gaussian", *given, "--counts", "4,8", "-m", 20
    )
    rows = [line.split() for line in out.splitlines() if line[:2] in ("0 ", "1 ")]
    assert [row[1] for row in rows] == ["unresolved"] * 2


def test_converge_finds_no_rate_in_noise_or_in_rounding(run, run_json):
    """The rate of five realizations is −1.03 ± 1.34; a rate of 1e-34 is rounding."""
    arguments = (
        "converge",
        "gaussian",
        "--sampler",
        "random",
        "--sampler",
        "sobol",
        "--counts",
        "16,64",
    )
    code, out, _ = run(*arguments, "-m", 5)
    assert code == 0
    row = next(line.split() for line in out.splitlines() if line.startswith("random"))
    assert row[3] == "unresolved"
    assert float(row[4]) > 0.5
    assert "is not resolved: use five or more counts, more realizations or larger counts" in out
    assert "sobol has no variance: add owen or shift, or compare |bias|" in out
    assert [line.split()[1:4] for line in out.splitlines() if line.startswith("sobol  ")] == [
        ["0", "0", "–"]
    ]
    curve = run_json(*arguments, "-m", 5)["curves"][0]
    assert curve["rate_ci"][1] - curve["rate_ci"][0] == pytest.approx(2 * float(row[4]), rel=1e-2)
    assert "resolved" not in run(*arguments, "-m", 500)[1]


def test_converge_says_which_counts_missed_the_precision(run, run_json):
    arguments = ("converge", "gaussian", "--sampler", "random", "--counts", "4,16", "-m", 20)
    code, out, _ = run(*arguments, "--relative-error", 0.01)
    assert code == 0
    assert (
        "random: the relative error 0.01 was not reached with 20 realizations at n = 4, 16" in out
    )
    assert run_json(*arguments, "--relative-error", 0.01)["curves"][0]["reached"] == [0, 0]
    assert "reached" not in run(*arguments)[1]


def test_help_fits_a_screen_and_has_every_verb(run):
    code, out, err = run("--help")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 80
    assert [line for line in lines if line in GROUPS] == list(GROUPS)
    for verb, text in VERBS.items():
        assert [line.split(maxsplit=1) for line in lines].count([verb, text]) == 1
    assert run()[:2] == (0, out)


@pytest.mark.parametrize("old", sorted(_NOW))
def test_an_old_verb_names_the_new_one(run, old):
    assert old not in VERBS
    assert _NOW[old].split()[0] in VERBS
    for more in ((), ("--help",), ("gaussian", "-n", 4)):
        code, out, err = run(old, *more)
        assert (code, out) == (2, "")
        assert err == f"mcspectra: The verb '{old}' is now 'mcspectra {_NOW[old]}'.\n"


def test_one_option_has_one_name_in_all_verbs(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    short = {"-n": set(), "-m": {"--realizations"}, "-d": {"--dims"}, "-o": {"--out"}}
    short |= {"-h": {"--help"}, "-D": {"--define"}}
    for verb in VERBS:
        _, out, _ = run(verb, "--help")
        found = dict(re.findall(r"^  (-\w)(?: \S+?)?(?:, (--[\w-]+)|\s)", out, re.MULTILINE))
        assert set(found) <= set(short), verb
        for flag, long in found.items():
            assert long in (short[flag] or {"", "--counts"}), (verb, flag, long)
        assert not re.search(r"--(samplers|evaluations|to|mode)\b", out), verb
        assert all(flag in out for flag in ("--json", "--seed", "--quiet")), verb


def test_options_of_all_verbs_may_come_before_or_after_the_verb(run):
    after = run("points", "random", "-n", 4, "--json", "--seed", 3, "--quiet")
    assert after[0] == 0
    assert run("--json", "--seed", 3, "--quiet", "points", "random", "-n", 4) == after
    assert run("--json", "--seed=3", "points", "random", "-n", 4, "--quiet") == after


def test_an_unknown_option_before_the_verb_gives_a_sentence(run):
    for given, lack in (
        (("--frob", "doctor"), "no option '--frob' before the verb"),
        (("--json",), "no verb"),
        (("--seed", 3), "no verb"),
    ):
        code, out, err = run(*given)
        assert (code, out) == (2, "")
        assert err == f"mcspectra: There is {lack}; see 'mcspectra --help'.\n"


def test_errors_quote_the_typed_options(run, tmp_path):
    """Options appear as flags, and positional arguments as in the help."""
    for given, start in (
        (("design", "density", "gaussian", "-n", 16, "--family", "vegas"), "--family is 'vegas'; "),
        (("design", "magic", "gaussian", "-n", 16), "KIND is 'magic'; "),
        (("list", "magic"), "KIND is 'magic'; "),
        (("status", 5000 * "x"), "DIR is 'xxx"),
        (("pixel", "veach", 1, -2), "Y is -2; "),
    ):
        code, out, err = run(*given)
        assert (code, out) == (2, "")
        assert err.startswith(f"mcspectra: {start}"), err


def test_every_positional_argument_is_in_capitals(run):
    for verb in VERBS:
        _, out, _ = run(verb, "--help")
        _, positional, rest = out.partition("positional arguments:\n")
        for name in re.findall(
            r"^  (\S+)", rest.partition("\n\n")[0] if positional else "", re.MULTILINE
        ):
            assert name.isupper(), (verb, name)


def test_the_help_lists_each_method_once(run):
    _, out, _ = run("predict", "--help")
    (_, _, listed), *_ = re.findall(r"(--method METHOD)(.*?):([^:]*); default", out, re.DOTALL)
    names = re.sub(r"\s", "", listed).split(",")
    assert "exact" in names
    assert not {"auto", "all"} & {*names}


def test_frames_are_listed_alike_in_the_help_and_in_errors(run, tmp_path):
    (tmp_path / "x.txt").write_text("x")
    endings = {".exr", ".pfm", ".npy", ".npz", ".png", ".jpg", ".jpeg"}
    for text in (run("frames", "--help")[1], run("frames", tmp_path)[2]):
        assert {*re.findall(r" (\.\w+)", text.partition("options:")[0])} == endings


def test_messages_shorten_long_values(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    long = 5000 * "k"
    (tmp_path / "study.toml").write_text(f"{long} = 1\n")
    for given in (
        (long,),
        (f"--{long}", "doctor"),
        ("list", long),
        ("doctor", long),
        ("points", long, "-n", 4),
        ("points", f"random({long}=1)", "-n", 4),
        ("points", f"{long}({long}={long})", "-n", 4),
        ("points", "random", "-n", 4, "-o", long),
        ("run", long),
        ("run", "study.toml", "--out", "out"),
        ("run", "tour", "--set", long),
        ("run", "tour", "--set", f"{long}=1"),
        ("profile", f"{long}.npy"),
        ("init", long),
    ):
        code, out, err = run(*given)
        assert (code, out) == (2, "")
        assert re.search("k{40}", err)
        assert not re.search("k{80}", err)
        assert len(err) < 600


@pytest.mark.parametrize(
    ("raised", "code", "words"),
    [
        (KeyboardInterrupt, 130, "Interrupted."),
        (MemoryError, 2, "Not enough memory; use fewer"),
    ],
)
def test_every_error_gives_an_exit_code_and_a_line(run, monkeypatch, raised, code, words):
    def ended(arguments, begun):
        raise raised

    monkeypatch.setattr("mcspectra.cli.main._dispatch", ended)
    found, out, err = run("points", "random", "-n", 4)
    assert (found, out) == (code, "")
    assert err.startswith(f"mcspectra: {words}")
    assert err.count("\n") == 1


def test_an_interrupted_command_does_not_wait_for_running_tasks():
    """Python's normal exit is skipped: it waits for native code, and may abort."""
    code = """
import atexit, sys, time
from mcspectra.cli import main as module
from mcspectra.studies.executors import Threads

def ended(arguments, begun):
    Threads(1).submit(None, lambda: time.sleep(100))
    atexit.register(print, "Python has ended")
    raise KeyboardInterrupt("finished work is in out; --resume continues")

module._dispatch = ended
sys.exit(module.main())
"""
    done = python("-c", code)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == ("mcspectra: Interrupted; finished work is in out; --resume continues.\n")


def test_several_samplers_share_one_picture_of_a_spectrum(run, run_json, tmp_path):
    arguments = ("spectrum", "jittered", "random", "-n", 16, "-m", 4, "--half-width", 4)
    code, out, _ = run(*arguments, "--show", "radial", "-o", tmp_path / "r.svg")
    assert code == 0
    assert "jittered\n|m|" in out
    assert "random\n|m|" in out
    assert "anisotropy dB" in out
    assert (tmp_path / "r.svg").stat().st_size > 1000
    assert np.shape(run_json(*arguments)["power"])[0] == 2
    assert "is given twice" in run("spectrum", "random", "random", "-n", 16)[2]
