"""The wheel, outside the sources and without a renderer: its contents, and a built-in study."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.processes import python

EXTRAS = ("mitsuba", "drjit", "qmcpy", "hypothesis")
BLOCK = f"""import sys
sys.modules.update(dict.fromkeys({EXTRAS}))
"""
# `run tour --dry-run` without its time estimate, which would compile kernels
PLAN = """
from mcspectra.studies import make_plan, read_study
from mcspectra.studies.files import study_file
file = study_file("tour")
for cell in make_plan(read_study(file), file.parent).cells:
    assert cell.error is None, cell.error
    print(cell.estimator_name, cell.sampler_spec)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The unpacked wheel, next to a `sitecustomize` that hides the extras."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=Path(__file__).parents[1], check=True, capture_output=True)
    (file,) = folder.glob("*.whl")
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder / "site")
    (folder / "site" / "sitecustomize.py").write_text(BLOCK)
    return folder / "site"


def run(wheel, folder, *arguments):
    return python(
        "-m", "mcspectra", *arguments, cwd=folder, env={**os.environ, "PYTHONPATH": str(wheel)}
    )


def test_the_wheel_contains_data_files_and_no_tests(wheel):
    names = {str(file.relative_to(wheel)) for file in wheel.rglob("*")}
    data = {"tour.toml", "veach.toml", "data/window.png", "data/blue.dat"}
    assert {f"mcspectra/studies/builtin/{name}" for name in data} <= names
    assert {"mcspectra/py.typed", "mcspectra/__init__.pyi"} <= names
    assert {name.split("/")[0].split("-")[0] for name in names} == {"mcspectra", "sitecustomize.py"}


def test_the_tour_is_found_and_planned_anywhere(wheel, tmp_path):
    done = python("-c", PLAN, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(wheel)})
    assert (done.returncode, done.stderr) == (0, "")
    assert "red of an image" in done.stdout
    assert "points from a file" in done.stdout


@pytest.mark.endurance  # it compiles its kernels again
def test_the_tour_runs_anywhere(wheel, tmp_path):
    few = [f"{name}.realizations=8" for name in ("convergence", "terms", "spectrum")]
    few += [f"estimators[{i}].{n}.realizations=8" for i in (0, 1) for n in ("terms", "spectrum")]
    few += ["estimators[4].terms.realizations=8", "estimators[5].convergence.realizations=8"]
    done = run(wheel, tmp_path, "run", "tour", "--quiet", *(f"--set={each}" for each in few))
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "out" / "tour" / "report.html").stat().st_size > 10**6


def test_features_of_an_extra_name_it(wheel, tmp_path):
    done = run(wheel, tmp_path, "run", "veach")
    assert done.returncode == 2
    assert "pip install 'mcspectra[render]'" in done.stderr
    assert not list(tmp_path.iterdir())
