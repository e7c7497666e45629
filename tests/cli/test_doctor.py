"""The renderer in `doctor`: working variants, refused libraries, and missing packages."""

import importlib.util
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from mcspectra.cli.main import main
from mcspectra.rendering import backend

pytestmark = pytest.mark.render

ABORTING = "#include <stdlib.h>\n__attribute__((constructor)) static void stop(void) { abort(); }\n"


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("MCSPECTRA_CACHE", str(tmp_path / "cache"))


def only(monkeypatch, library):
    """Hide all libraries except the one that the variable names."""
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(library))
    monkeypatch.setattr(backend, "_wheel_library", list)
    monkeypatch.setattr(backend, "_system_libraries", list)


def aborting_library(folder, monkeypatch):
    """Build a library that ends the process when loaded; without a compiler, a failing probe."""
    library = folder / "libLLVM-99.so"
    compiler = shutil.which("cc")
    if compiler is None:
        library.write_text("stands for one")
        monkeypatch.setattr(backend, "_PROBE", "import os; os.abort()")
        return library
    source = folder / "stop.c"
    source.write_text(ABORTING, encoding="utf-8")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source], check=True)
    return library


def test_renderer_names_variants_library_and_the_version_that_is_kept():
    found = backend.describe()
    assert found["variants"] == ["llvm_ad_rgb", "scalar_rgb"]
    assert int(found["llvm"].split(".")[0]) >= 17
    assert Path(found["library"]).is_file()
    assert found["refused"] is found["reason"] is None
    kept, _ = backend.find_library()  # reads the verdict that was stored
    assert kept is not None
    assert (kept.library, kept.version) == (found["library"], found["llvm"])


def test_an_invalid_library_is_skipped(monkeypatch, tmp_path, capsys):
    library = tmp_path / "libLLVM-99.so"
    library.write_text("no library")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(library))
    assert main(["doctor"]) == 0
    (line,) = (x for x in capsys.readouterr().out.splitlines() if x.startswith("renderer"))
    assert f"refused {library}: the test ended with" in line
    assert "variants llvm_ad_rgb, scalar_rgb" in line


def test_library_that_aborts_leaves_the_scalar_variant(monkeypatch, tmp_path):
    only(monkeypatch, aborting_library(tmp_path, monkeypatch))
    found: dict[str, Any] = backend.describe()
    assert found["variant"] is None
    assert found["library"] is None
    assert "the test ended with signal 6" in found["refused"]
    assert "pip install 'mcspectra[render]'" in found["reason"]


def test_missing_library_is_named(monkeypatch, tmp_path):
    only(monkeypatch, tmp_path / "libLLVM-nowhere.so")
    found = backend.describe()
    assert "libLLVM-nowhere.so: there is no such file" in found["reason"]
    assert found["variants"] == ["scalar_rgb"]


def test_without_mitsuba_doctor_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    monkeypatch.setattr(backend, "_version", lambda _: None)
    assert main(["doctor"]) == 0
    assert "not installed; install it with: pip install 'mcspectra[render]'" in (
        capsys.readouterr().out
    )
