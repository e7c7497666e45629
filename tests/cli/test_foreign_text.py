"""Untrusted titles, names, specs and paths: no verb prints control characters or extra lines."""

import csv
import shutil

import numpy as np
import OpenEXR
import pytest
from tests.report.parsed import Parsed

from mcspectra.cli.main import VERBS, main

EVIL = (
    "a\x1b]52;c;aGk=\x07b\x1b[2J\x9b1A\x08\x7f\u202ec\u2066d\u200be\ufefff\u2028g\u034f"
    "\U000e0041\r\tA\nFORGED"
)
SEEN = (
    "a\\x1b]52;c;aGk=\\x07b\\x1b[2J\\x9b1A\\x08\\x7f\\u202ec\\u2066d\\u200be\\ufefff\\u2028g\\u034f"
    "\\U000e0041"
)
SHORT = "\x1b]0;x\x07\u202e\nFORGED"


def assert_harmless(*texts):
    for text in texts:
        strange = {c for c in text if not c.isprintable()} - {"\n"}
        assert not strange, text
        assert "\u034f" not in text
        assert not any(line.lstrip().startswith("FORGED") for line in text.splitlines()), text


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def toml(text):
    escapes = "".join(f"\\U{ord(c):08x}" for c in text)
    return f'"{escapes}"'


def study(integrand="linear"):
    return f"""
title = {toml(EVIL)}
seed = 1
samplers = ["random"]
[[estimators]]
name = {toml(EVIL)}
integrand = {toml(integrand)}
dims = 1
[[estimators]]
name = {toml("=1+" + SHORT)}
integrand = "linear"
dims = 1
[convergence]
counts = [4, 8]
realizations = 8
"""


VERBS_OF_FOLDERS = [
    ("status",), ("status", "--verify"), ("status", "--json"), ("report",), ("report", "--json"),
    ("export", "-o", "all.csv"), ("export", "--json", "-o", "again.csv"),
    ("export", "-o", "none.csv", "--select", EVIL),
]  # fmt: skip


@pytest.mark.usefixtures("undrawn")
def test_verbs_of_studies(run, here):
    file = here / f"{SHORT}.toml"
    file.write_text(study(), encoding="utf-8")
    for more in (["--dry-run"], ["--dry-run", "--json"], [], ["--resume"], ["--resume", "--json"]):
        code, out, err = run("run", file, "--out", here / SHORT, *more)
        assert code == 0, err
        assert_harmless(out, err)
    code, out, err = run("status", here / SHORT)
    assert out.startswith(f"{SEEN}\\r\\tA\\nFORGED: finished\n")
    for verb, *more in VERBS_OF_FOLDERS:
        code, out, err = run(verb, here / SHORT, *more)
        assert code == (2 if EVIL in more else 0), err
        assert_harmless(out, err)
    shutil.copytree(here / SHORT, here / "other")
    assert_harmless(*run("report", here / SHORT, "--compare", here / "other")[1:])

    # Check pages and tables as well
    for page in (here / SHORT / "report.html", here / "other" / "comparison.html"):
        text = page.read_text("utf-8")
        assert SEEN in Parsed(text).text
        assert not {c for c in text if not c.isprintable()} - {"\n", "\u2060"}


@pytest.mark.usefixtures("undrawn")
def test_failures_and_what_is_missing(run, here):
    file = here / "study.toml"
    file.write_text(study("image('\\u202e\x1b[2J.png')"), encoding="utf-8")
    for more in (["--dry-run"], ["--json"], ["--set", EVIL], ["--set", f"{EVIL}=1"]):
        code, out, err = run("run", file, "--out", here / "out", *more)
        assert code in (0, 1, 2)
        assert out + err
        assert_harmless(out, err)
    for more in ([], ["--json"]):
        assert_harmless(*run("status", here / "out", *more)[1:])
    file.write_text(f"{toml(EVIL * 10_000)} = 1\n" + study(), encoding="utf-8")
    code, out, err = run("run", file)
    assert code == 2
    assert len(err) < 2500
    assert_harmless(out, err)


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_every_verb_escapes_control_characters(run, here, verb):
    for arguments in (
        [EVIL],
        [f"--{EVIL}"],
        [EVIL, "--json"],
        ["linear", "--sampler", EVIL, "-d", "1"],
        ["linear", "--density", EVIL, "--sampler", "random"],
        ["random", "--density", EVIL],
        [f"gaussian(width={EVIL})"],
        [f"image('{SHORT}')", "--sampler", "random"],
        [f"random | {EVIL}", "-n", "4"],
        ["random", "-n", EVIL],
        ["--out", EVIL],
    ):
        if verb in ("bench", "doctor", "reproduce") and arguments[0] == "--out":
            continue  # This verb works without arguments
        _, out, err = run(verb, *arguments, "--seed", "1")
        assert_harmless(out, err)


def test_columns_of_draws(run, here):
    draws = np.random.default_rng(1).standard_normal((50, 3)).tolist()
    with (here / "draws.csv").open("w", newline="", encoding="utf-8") as stream:
        names = [SHORT.replace("\n", " "), "=1+1", r"\input{x}^^5cinput{x}"]
        csv.writer(stream).writerows([names, *draws])
    code, out, err = run("profile", "draws.csv", "-o", "curve.csv", "--out", "curve.tex")
    assert code == 0, err
    tex = (here / "curve.tex").read_text("utf-8")
    assert_harmless(out, err, (here / "curve.csv").read_text("utf-8"), tex)
    assert r"\input" not in tex
    assert "^^" not in tex


def test_layers_of_frames(run, here):
    pixels = np.random.default_rng(2).random((8, 8)).astype(np.float32)
    for k in range(3):
        channels = {f"\x1b[2J\u202e{c}": pixels + k for c in "XYZ"}
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, channels).write(str(here / f"f{k}.exr"))
    code, out, err = run("frames", here)
    assert code == 2
    assert_harmless(out, err)


@pytest.mark.render
@pytest.mark.parametrize(
    "inside",
    [
        "<shape type='{0}'/>",
        "<{0}/>",
        "<integer name='{0}' value='{0}'/>",
        "<ref id='{0}'/>",
        "<shape type='sphere'><string name='{0}' value='1'/></shape>",
        "<bsdf type='diffuse' id='{0}'/><bsdf type='diffuse' id='{0}'/>",
        "<include filename='{0}'/>",
        "<shape type='obj'><string name='filename' value='{0}.obj'/></shape>",
        "<emitter type='envmap'><string name='filename' value='{0}.exr'/></emitter>",
    ],
)
@pytest.mark.parametrize("verb", ["render", "pixel"])
def test_names_of_scenes(here, capfd, verb, inside):
    """This includes the output of native code."""
    name = "a\u202e\u200b\x7f\x9b2Jb"  # XML allows no other control characters
    text = f"<scene version='3.0.0'>{inside.format(name)}</scene>"
    (here / "scene.xml").write_text(text, encoding="utf-8")
    more = ["-n", "4"] if verb == "pixel" else []
    code = main([verb, "scene.xml", *more])
    out, err = capfd.readouterr()
    assert code == 2
    assert_harmless(out, err)


@pytest.mark.parametrize("length", [300, 5000])
@pytest.mark.parametrize(
    "verb", ["status", "report", "export", "run", "frames", "render", "profile"]
)
def test_a_name_that_is_too_long_is_bad_input(run, here, verb, length):
    """``status`` used to end with an unexpected OSError and code 1."""
    code, _, err = run(verb, "x" * length, *(["-o", "a.csv"] if verb == "export" else []))
    assert code == 2
    assert "Unexpected" not in err
    assert len(err) < 2100
