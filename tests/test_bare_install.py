"""The package without its extras, which are hidden from a process that uses everything else."""

import tomllib
from pathlib import Path

from tests.bare import EXTRAS
from tests.processes import python

ROOT = Path(__file__).parents[1]


def project():
    return tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def test_required_and_extra_packages():
    def names(wanted):
        return {each.partition(">=")[0] for each in wanted}

    found, extras = project()["dependencies"], project()["optional-dependencies"]
    assert names(found) == {
        *("numpy", "scipy", "numba", "finufft", "xarray", "msgspec"),
        *("matplotlib", "rich", "lazy-loader", "platformdirs"),
    }
    for extra, hidden in EXTRAS.items():
        listed = {name.replace("-", "_") for name in names(extras[extra])}
        assert listed - {"pillow", "karellen_llvm_core", "OpenEXR"} <= set(hidden)
    assert extras["all"] == ["mcspectra[report,store,cluster,render,frames]"]


def test_the_package_works_without_extras(tmp_path):
    done = python(ROOT / "tests" / "bare.py", "--hide", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(done.stdout.splitlines()) == 7
