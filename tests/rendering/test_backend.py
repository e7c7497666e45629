"""The search for LLVM: order, verdicts, cache, and the message if none works."""

import importlib.util
import json
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tests.processes import python

from mcspectra.core.errors import MissingDependency
from mcspectra.rendering import backend, load_scene
from mcspectra.rendering.backend import (
    VARIANT,
    Verdict,
    describe,
    find_library,
    load_mitsuba,
    threads_for_files,
)

pytestmark = pytest.mark.render


@pytest.fixture
def not_loaded(monkeypatch):
    """Make `load_mitsuba` start without a loaded module."""
    monkeypatch.setattr(backend, "_loaded", [])
    monkeypatch.setattr(backend, "_already_running", lambda: False)


@pytest.fixture
def own_cache(monkeypatch, tmp_path):
    folder = tmp_path / "cache"
    monkeypatch.setenv("MCSPECTRA_CACHE", str(folder))
    return folder


@pytest.fixture
def all_work(monkeypatch):
    """Let every library that exists pass its test, which takes a process."""
    usual = backend._probe

    def probe(library):
        return (Verdict(library, True, ""), True) if Path(library).is_file() else usual(library)

    monkeypatch.setattr(backend, "_probe", probe)


def _library(folder, text="not a library"):
    file = folder / "libLLVM-99.so"
    file.write_text(text)
    return str(file)


def _no_probe(library):
    raise AssertionError(f"{library} was probed")


def test_loaded_module_has_the_variant_even_after_another_was_set():
    mitsuba = load_mitsuba()
    assert mitsuba.variant() == VARIANT
    mitsuba.set_variant("scalar_rgb")
    assert load_mitsuba().variant() == VARIANT


def test_files_are_written_and_read_on_one_core(tmp_path):
    """With one thread, Mitsuba would wait forever for a thread that compresses the pixels."""
    mitsuba = load_mitsuba()
    import drjit

    file = str(tmp_path / "pixels.exr")
    pixels = np.random.default_rng(1).random((200, 300, 3), np.float32)
    assert drjit.thread_count() == 1
    with threads_for_files():
        mitsuba.Bitmap(pixels).write(file)
    scene = {
        "type": "scene",
        "camera": {"type": "perspective"},
        "sky": {"type": "envmap", "filename": file},
    }
    assert len(load_scene(scene).emitters()) == 1
    assert drjit.thread_count() == 1


@pytest.mark.parametrize(
    ("driver", "output", "listed"),
    [
        (None, "works True", False),
        ("libcuda.so.1", "", False),
        ("libcuda.so.1", "works True", True),
    ],
)
def test_cuda_is_listed_only_if_it_works(monkeypatch, own_cache, driver, output, listed):
    monkeypatch.setattr("ctypes.util.find_library", lambda _: driver)

    def tried(program, variables=None):
        del variables
        told = output if backend.CUDA_VARIANT in program else "works True\nversion 19.1.7"
        return SimpleNamespace(returncode=0, stdout=told, stderr="")

    monkeypatch.setattr(backend, "_tried", tried)
    found = describe()
    assert (backend.CUDA_VARIANT in found["variants"]) == listed
    assert ("cuda" in json.dumps(found)) == listed


def test_a_second_search_uses_the_stored_verdict(monkeypatch, own_cache):
    first, _ = find_library()
    assert first is not None
    assert len(list(own_cache.iterdir())) == 1
    monkeypatch.setattr(backend, "_probe", _no_probe)
    assert find_library()[0] == first
    with pytest.raises(AssertionError, match="was probed"):
        find_library(fresh=True)


@pytest.mark.parametrize("kept", ["", "{", "[]", '{"works": true}', "null"])
def test_a_broken_cache_file_is_replaced(monkeypatch, own_cache, tmp_path, kept):
    library = _library(tmp_path)
    own_cache.mkdir()
    file = own_cache / f"llvm-{backend._fingerprint(library)}.json"
    file.write_text(kept)
    verdict = Verdict(library, False, "no")
    assert backend._read_verdict(file, library) is None
    monkeypatch.setattr(backend, "_probe", lambda _: (verdict, True))
    assert backend._verdict(library, fresh=False) == verdict
    assert backend._read_verdict(file, library) == verdict


def test_verdicts_are_stored_in_the_chosen_cache(monkeypatch, own_cache, tmp_path):
    verdict = Verdict(_library(tmp_path), False, "no")
    monkeypatch.setattr(backend, "_probe", lambda _: (verdict, True))
    backend._verdict(verdict.library, fresh=False)
    assert [file.name[:5] for file in own_cache.iterdir()] == ["llvm-"]


def test_cache_that_cannot_be_written_is_no_error(own_cache, all_work):
    own_cache.write_text("a file where the folder should be")
    best, _ = find_library()
    assert best is not None
    assert best.works


def test_fingerprint_follows_the_file(tmp_path):
    library = _library(tmp_path)
    before = backend._fingerprint(library)
    assert backend._fingerprint(library) == before
    _library(tmp_path, "another version")
    assert backend._fingerprint(library) != before


def test_the_users_library_comes_first_and_a_bad_one_is_skipped(
    monkeypatch, own_cache, all_work, tmp_path
):
    missing = str(tmp_path / "libLLVM-nowhere.so")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", missing)
    best, refused = find_library()
    assert best is not None
    assert refused == [Verdict(missing, False, "there is no such file")]


def test_an_invalid_library_is_rejected_with_a_reason(own_cache, tmp_path):
    verdict, final = backend._probe(_library(tmp_path))
    assert final
    assert not verdict.works
    assert "the test ended with" in verdict.reason


@pytest.mark.parametrize(
    ("probe", "seconds", "reason", "final"),
    [
        ("import os; os.abort()", 60.0, "the test ended with", True),
        ("import time; time.sleep(60)", 0.5, "did not finish", False),
        ("print('works False')", 60.0, "status 0", True),
    ],
)
def test_the_test_of_a_library_survives_crashes_and_hangs(
    monkeypatch,
    tmp_path,
    probe,
    seconds,
    reason,
    final,
):
    monkeypatch.setattr(backend, "_PROBE", probe)
    monkeypatch.setattr(backend, "_PROBE_SECONDS", seconds)
    verdict, kept = backend._probe(_library(tmp_path))
    assert not verdict.works
    assert reason in verdict.reason
    assert kept is final


def test_without_library_the_error_says_what_to_install(monkeypatch, not_loaded):
    monkeypatch.setattr(backend, "_candidates", lambda: iter(()))
    with pytest.raises(MissingDependency, match=r"pip install 'mcspectra\[render\]'.*LLVM ≥ 19"):
        load_mitsuba()
    assert "none was found" in describe()["reason"]


def test_without_mitsuba_the_error_names_the_extra(monkeypatch, not_loaded):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    monkeypatch.setattr(backend, "_version", lambda _: None)
    with pytest.raises(MissingDependency, match=r"pip install 'mcspectra\[render\]'"):
        load_mitsuba()
    found = describe()
    assert found["mitsuba"] is None
    assert found["variant"] is None
    assert "not installed" in found["reason"]


@pytest.mark.parametrize(
    ("path", "version"),
    [
        ("/a/libLLVM-15.so", 15),
        ("/a/libLLVM.so.19.1", 19),
        ("/a/libLLVM-14.0.6.so.1", 14),
        ("/a/llvm@20/lib/libLLVM.dylib", 20),
        ("/a/llvm-21/lib/libLLVM.so", 21),
        ("/a/bin/LLVM-C.dll", None),
    ],
)
def test_version_is_read_from_the_path(path, version):
    assert backend._llvm_version(path) == version


def test_system_libraries_run_from_new_to_old_without_those_too_old(monkeypatch, tmp_path):
    for version in (15, 19, 21):
        (tmp_path / f"libLLVM-{version}.so").touch()
    folders = {backend.platform.system(): ((str(tmp_path), "libLLVM*.so*"),)}
    monkeypatch.setattr(backend, "_SYSTEM_FOLDERS", folders)
    names = [Path(path).name for path in backend._system_libraries()]
    assert names == ["libLLVM-21.so", "libLLVM-19.so"]


def test_candidates_name_each_file_once(monkeypatch, tmp_path):
    library = os.path.realpath(_library(tmp_path))
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", library)
    monkeypatch.setattr(backend, "_wheel_library", lambda: [library])
    monkeypatch.setattr(backend, "_system_libraries", lambda: [library])
    assert list(backend._candidates()) == [library]


_MITSUBA_FIRST = """
import json, os, pathlib, sys
from mcspectra.rendering import backend
found = backend.describe()
print(json.dumps([found, "mitsuba" in sys.modules]))
os.environ["DRJIT_LIBLLVM_PATH"] = found["library"]
import mitsuba
mitsuba.set_variant("llvm_ad_rgb")
import mcspectra as mcs

def first_use():
    backend._loaded.clear()
    try:
        mcs.rendering.named_pixels("figure1")
    except mcs.McspectraError as error:
        return f"{type(error).__name__} {error}"
    return "works"

print(first_use())
# The same library, marked as broken: the loaded library matters, not who set the variant
(verdict,) = pathlib.Path(os.environ["MCSPECTRA_CACHE"]).iterdir()
verdict.write_text(json.dumps({"works": False, "reason": "signal 6", "version": ""}))
print(first_use())
"""


def test_describe_leaves_mitsuba_alone_and_a_broken_llvm_before_us_is_refused_in_a_sentence(
    own_cache,
):
    """A program describes the backend, then imports Mitsuba before our first use of it."""
    del own_cache
    described, works, refusal = python("-c", _MITSUBA_FIRST, check=True).stdout.splitlines()
    found, imported = json.loads(described)
    assert not imported
    assert found["variant"] == VARIANT
    assert found["reason"] is None
    assert Path(found["library"]).is_file()
    assert found["mitsuba"]
    assert found["drjit"]
    assert works == "works"
    if not sys.platform.startswith("linux"):  # only Linux says what is loaded
        return
    assert refusal.startswith("MissingDependency Mitsuba was imported before mcspectra")
    assert f"{os.path.realpath(found['library'])}: signal 6" in refusal
