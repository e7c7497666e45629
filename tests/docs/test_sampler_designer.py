"""The how-to page for sampler designers: its three commands lead from a program to a PDF."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.processes import python

import mcspectra as mcs
from mcspectra.cli.main import main
from mcspectra.core.streams import Stream

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "sampler-designer.md"
TEXT = PAGE.read_text(encoding="utf-8")
PROGRAM = re.search(r"```cpp\n(.*?)```", TEXT, re.DOTALL).group(1)
COMMANDS = re.search(r"```bash\n(.*?)```", TEXT, re.DOTALL).group(1).splitlines()

# The same program in Python, for machines without a compiler
IN_PYTHON = f"""#!{sys.executable}
import random, sys
side = round(float(sys.argv[1]) ** 0.5)
random.seed(int(sys.argv[2]))
for row in range(side):
    for column in range(side):
        x = (column + 0.5 * row + random.random()) / side
        print(repr(x % 1.0), repr((row + random.random()) / side))
"""


def test_there_are_three_commands():
    assert [shlex.split(line)[0] for line in COMMANDS] == ["c++", "mcspectra", "mcspectra"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the program, compiled by the first command if there is a compiler."""
    root = tmp_path_factory.mktemp("designer")
    (root / "mine.cpp").write_text(PROGRAM, encoding="utf-8")
    compiler = next(filter(None, map(shutil.which, ("c++", "g++", "clang++"))), None)
    if compiler:
        _, *arguments = shlex.split(COMMANDS[0])
        subprocess.run([compiler, *arguments], cwd=root, check=True, timeout=120)
    else:
        (root / "mine").write_text(IN_PYTHON, encoding="utf-8")
        (root / "mine").chmod(0o755)
    return root


def run(folder, line, *more):
    _, *arguments = shlex.split(line)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    given = ("-m", "mcspectra", *arguments, *more)
    return python(*given, cwd=folder, env=environment, timeout=500)


def test_a_new_user_gets_a_comparison_in_three_commands(folder, monkeypatch, capsys):
    """The last command runs in its own process; the others run in this process."""
    monkeypatch.chdir(folder)
    assert main(shlex.split(COMMANDS[1])[1:]) == 0
    assert capsys.readouterr().err == ""
    assert (folder / "mine.png").read_bytes().startswith(b"\x89PNG")
    fewer = ("-n", "16,64", "-m", "40")
    done = run(folder, COMMANDS[2], *fewer, "--quiet", "--json")
    assert done.returncode == 0, done.stderr
    pdf = (folder / "report.pdf").read_bytes()
    assert pdf.startswith(b"%PDF")
    assert b"/Subtype /Type3" not in pdf
    assert len(re.findall(rb"/Type /Page\b", pdf)) >= 7


def test_without_permission_nothing_runs(folder, monkeypatch, capsys):
    line = re.sub(r" --allow-code \S+", "", COMMANDS[2])
    monkeypatch.chdir(folder)
    assert main(shlex.split(line)[1:]) == 2
    said = capsys.readouterr().err
    assert "--allow-code './mine {n} {seed}'" in said
    assert said.count("\n") == 1


def test_the_program_equals_the_function_on_the_page(folder):
    """Both make bricks: one point in each cell of a row, every second row moved by half a cell."""
    source = mcs.Sampler.from_command(f"{folder / 'mine'} {{n}} {{seed}}", dims=2)
    x = source.draw(64, realizations=20, rng=1)
    cells = np.floor(((8 * x[..., 0] - 0.5 * np.floor(8 * x[..., 1])) % 8.0) + 1e-9)
    for each, own in zip(x, cells, strict=True):
        row = np.floor(8 * each[:, 1])
        assert len({*zip(row, own % 8, strict=True)}) == 64


def test_the_program_of_a_screen_prints_a_block(tmp_path):
    from mcspectra.rendering import CommandScreen, ScreenBlock

    compiler = next(filter(None, map(shutil.which, ("c++", "g++", "clang++"))), None)
    if compiler is None:
        pytest.skip("there is no compiler")
    (tmp_path / "screen.cpp").write_text(
        re.findall(r"```cpp\n(.*?)```", TEXT, re.DOTALL)[1], encoding="utf-8"
    )
    program = tmp_path / "screen"
    subprocess.run([compiler, program.with_suffix(".cpp"), "-o", program], check=True, timeout=120)
    source = CommandScreen(run=f"{program} {{width}} {{height}} {{frames}} {{n}} {{seed}}")
    points = np.stack(list(source.frames_of(3, ScreenBlock(5, 4, 2), 0, Stream(1))))
    assert points.shape == (2, 4, 5, 3, 2)
    assert np.unique(points).size == points.size
