"""Mitsuba with a working LLVM: find the library, test it in a subprocess, set the variant.

Dr.Jit compiles for the CPU through libLLVM.
Some versions of libLLVM end the process with SIGABRT when they compile the first kernel.
In a test on an AVX-512 machine, LLVM 15 and 16 ended the process.
Every candidate is therefore tested in a subprocess first.
The first candidate is the user's ``DRJIT_LIBLLVM_PATH``.
The next candidate is the library in the package karellen-llvm-core.
The last candidates are system libraries of version 19 or newer.
The cache folder (`mcspectra.core.cache`) stores the result of each test.
Therefore the test of a library runs only at its first use.
"""

from __future__ import annotations

import contextlib
import ctypes.util
import functools
import hashlib
import importlib.util
import json
import os
import platform
import re
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, files, version
from pathlib import Path
from typing import Any, TypeAlias

from mcspectra.core.cache import cache_folder
from mcspectra.core.errors import MissingDependency

__all__ = [
    "CUDA_VARIANT",
    "LARGEST_SAMPLE",
    "LOCK",
    "SCALAR_VARIANT",
    "VARIANT",
    "Verdict",
    "compilations",
    "describe",
    "find_library",
    "import_mitsuba",
    "load_mitsuba",
    "mitsuba_folder",
    "threads_for_files",
]

VARIANT = "llvm_ad_rgb"
"""The vectorized variant of Mitsuba for the CPU, with float32 and RGB."""

SCALAR_VARIANT = "scalar_rgb"
"""The variant without LLVM: Mitsuba's integrators render whole images, one ray at a time."""

CUDA_VARIANT = "cuda_ad_rgb"
"""The variant for NVIDIA's processors; `describe` lists it if it works."""

LARGEST_SAMPLE = 1.0 - 2.0**-24
"""The largest float32 below 1. Rounding a coordinate up to 1 would leave the unit square."""

LOCK = threading.RLock()
"""Lock for all work with Dr.Jit, whose recorded operations are shared by all threads.

The current variant of Mitsuba is also shared by all threads.
"""

_LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
_OLDEST_LLVM = 19
_PROBE_SECONDS = 120.0
_INSTALL = "install it with: pip install 'mcspectra[render]'"
_SYSTEM_FOLDERS = {
    # Folders that may hold libLLVM on each platform, with patterns of file names
    "Linux": (
        ("/usr/lib", "*/libLLVM*.so*"),
        ("/usr/lib", "llvm*/lib/libLLVM*.so*"),
        ("/usr/lib64", "libLLVM*.so*"),
        ("/usr/lib64", "llvm*/lib/libLLVM*.so*"),
        ("/usr/local/lib", "libLLVM*.so*"),
    ),
    "Darwin": (
        ("/opt/homebrew/opt", "llvm*/lib/libLLVM*.dylib"),
        ("/usr/local/opt", "llvm*/lib/libLLVM*.dylib"),
    ),
    "Windows": (("C:/Program Files/LLVM/bin", "LLVM-C*.dll"),),
}
_OWN_PLUGINS = """
import mitsuba as mi, os
mi.file_resolver().clear()
mi.file_resolver().append(os.path.dirname(mi.__file__))
"""  # Mitsuba would search the current folder first, which may be untrusted
# Unsuitable versions of LLVM fail at three operations, which this program tests:
# the minimum of two numbers, ray tracing, and sampling directions on a rough metal surface
_RAYS = """
import drjit as dr
scene = mi.load_dict({"type": "scene", "ball": {
    "type": "sphere", "bsdf": {"type": "roughconductor"}, "emitter": {"type": "area"}}})
x = dr.linspace(mi.Float, 0.1, 0.9, 64)
hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(0, 0, -5), mi.Vector3f(0, 0, 1)))
wo = hit.bsdf().sample(mi.BSDFContext(), hit, x, mi.Point2f(x, dr.minimum(x, 0.5)))[0].wo
dr.eval(wo)
print("works", dr.isfinite(wo.x)[0])
"""
_PROBE = f"""{_OWN_PLUGINS}
mi.set_variant({VARIANT!r})
{_RAYS}
import ctypes, os
numbers = [ctypes.c_uint() for _ in range(3)]
ctypes.CDLL(os.environ[{_LIBRARY_VARIABLE!r}]).LLVMGetVersion(*map(ctypes.byref, numbers))
print("version", ".".join(str(number.value) for number in numbers))
"""
_CUDA_PROBE = f"""{_OWN_PLUGINS}
mi.set_variant({CUDA_VARIANT!r})
{_RAYS}
"""
_SCALAR_PROBE = f"""{_OWN_PLUGINS}
mi.set_variant({SCALAR_VARIANT!r})
print("works", mi.load_dict({{"type": "independent"}}).next_1d() < 1)
"""
_Run: TypeAlias = "subprocess.CompletedProcess[str]"
_loaded: list[Any] = []


@dataclass(frozen=True)
class Verdict:
    """Result of the test of one libLLVM.

    Attributes
    ----------
    library
        Path of libLLVM.
    works
        Whether Mitsuba compiled and ran a kernel with this library.
    reason
        Why the test failed; empty if the library works.
    version
        Version of LLVM if it works, e.g. ``19.1.7``.
    """

    library: str
    works: bool
    reason: str
    version: str = ""


def load_mitsuba() -> Any:
    """Return the module `mitsuba` with its variant set to `VARIANT`.

    Raises
    ------
    MissingDependency
        If Mitsuba is not installed, or no libLLVM works; the message names the package to install.
    """
    with LOCK:
        if not _loaded:
            if importlib.util.find_spec("mitsuba") is None:
                raise MissingDependency(_no_mitsuba())
            if not _already_running():
                best, refused = find_library()
                if best is None:
                    raise MissingDependency(_no_library(refused))
                os.environ[_LIBRARY_VARIABLE] = best.library
            mitsuba = _imported()
            _check_mapped()
            _loaded.append(mitsuba)
        mitsuba = _loaded[0]
        if mitsuba.variant() != VARIANT:
            mitsuba.set_variant(VARIANT)
        return mitsuba


def find_library(*, fresh: bool = False) -> tuple[Verdict | None, list[Verdict]]:
    """Return the first working libLLVM, if any, and the verdicts on the libraries tested before it.

    Parameters
    ----------
    fresh
        Whether to test again instead of using cached verdicts.

    Notes
    -----
    A test takes about a second, a cached verdict less than a millisecond.
    """
    refused: list[Verdict] = []
    for library in _candidates():
        verdict = _verdict(library, fresh)
        if verdict.works:
            return verdict, refused
        refused.append(verdict)
    return None, refused


def describe() -> dict[str, Any]:
    """Describe the rendering backend from new tests. This process does not import Mitsuba.

    Returns
    -------
    dict
        ``mitsuba`` and ``drjit`` (versions or None), ``library`` (path of LLVM or None),
        ``llvm`` (version of LLVM or None), ``variant`` (the vectorized variant if it works),
        ``variants`` (all tested variants that work),
        ``refused`` (rejected libraries with reasons, or None),
        ``reason`` (why the vectorized variant does not work, or None).
    """
    found: dict[str, Any] = {name: _version(name) for name in ("mitsuba", "drjit")}
    found |= dict.fromkeys(("library", "llvm", "variant", "refused", "reason")) | {"variants": []}
    if found["mitsuba"] is None:
        return found | {"reason": _no_mitsuba()}
    best, refused = find_library(fresh=True)
    try:
        scalar = [SCALAR_VARIANT] if _worked(_tried(_SCALAR_PROBE)) else []
    except (OSError, subprocess.TimeoutExpired):
        scalar = []
    scalar += [CUDA_VARIANT] if _cuda_works() else []
    found |= {"variants": scalar, "refused": _reasons(refused) or None}
    if best is None:
        return found | {"reason": _no_library(refused)}
    found |= {"library": best.library, "llvm": best.version or None, "variant": VARIANT}
    return found | {"variants": [VARIANT, *scalar]}


def _cuda_works() -> bool:
    """Whether the CUDA variant traces rays. Without a driver the result is false, not an error."""
    if ctypes.util.find_library("nvcuda" if platform.system() == "Windows" else "cuda") is None:
        return False
    try:
        return _worked(_tried(_CUDA_PROBE))
    except (OSError, subprocess.TimeoutExpired):
        return False


def import_mitsuba() -> Any:
    """Return the module `mitsuba` with a working libLLVM, but set no variant.

    Dr.Jit searches for libLLVM when it is imported, for any variant.
    If a program imports Dr.Jit first by itself, Dr.Jit may load a library that aborts the process.

    Raises
    ------
    MissingDependency
        If Mitsuba is not installed. A missing libLLVM is not an error here.
    """
    with LOCK:
        if importlib.util.find_spec("mitsuba") is None:
            raise MissingDependency(_no_mitsuba())
        if "mitsuba" not in sys.modules:
            best, _ = find_library()
            if best is not None:
                os.environ[_LIBRARY_VARIABLE] = best.library
        return _imported()


def _check_mapped() -> None:
    """Raise an error if the caller's own import of Dr.Jit loaded an unsuitable libLLVM."""
    try:  # Linux lists the libraries that this process has loaded
        lines = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return
    mapped = {line.split(maxsplit=5)[5] for line in lines if "/libLLVM" in line}
    verdicts = [_verdict(path, fresh=False) for path in sorted(mapped) if Path(path).is_file()]
    if not verdicts or any(verdict.works for verdict in verdicts):
        return
    best, _ = find_library()
    order = "call mcspectra.rendering.load_mitsuba() before you import mitsuba or drjit"
    raise MissingDependency(
        "Mitsuba was imported before mcspectra could choose a libLLVM, and loaded one that does "
        f"not work ({_reasons(verdicts)}); "
        + (
            f"{order}, or set {_LIBRARY_VARIABLE}={best.library}."
            if best
            else f"{_INSTALL}, and {order}."
        )
    )


def _imported() -> Any:
    ours = "mitsuba" not in sys.modules
    try:
        import mitsuba
    except ImportError as error:
        raise MissingDependency(f"Mitsuba is installed but cannot be imported: {error}.") from error
    if ours:
        # Mitsuba would first search the current folder for its plugins, which are code.
        # Files outside Mitsuba's own folder are still opened relative to the current folder.
        module: Any = mitsuba
        resolver = module.file_resolver()
        resolver.clear()
        resolver.append(str(mitsuba_folder()))
    return mitsuba


@contextlib.contextmanager
def compilations() -> Iterator[list[float]]:
    """List the seconds in which each kernel is compiled in the block, at the end of the block.

    Kernels in Dr.Jit's cache on disk are loaded, not compiled, so the list does not have them.
    """
    load_mitsuba()
    import drjit

    found: list[float] = []
    with drjit.scoped_set_flag(drjit.JitFlag.KernelHistory, True):
        drjit.kernel_history_clear()
        yield found
        for each in drjit.kernel_history([drjit.KernelType.JIT]):
            if not (each["cache_hit"] or each["cache_disk"]):
                found.append(each["backend_time"] / 1000.0)
        drjit.kernel_history_clear()


@contextlib.contextmanager
def threads_for_files() -> Iterator[None]:
    """Let Dr.Jit use at least two threads inside the block, which reads or writes EXR files.

    Mitsuba waits for another thread of Dr.Jit, which compresses or decompresses the pixels.
    With one thread, for example on a machine with one core, Mitsuba would wait forever.
    """
    import drjit

    before = drjit.thread_count()
    if before < 2:
        drjit.set_thread_count(2)
    try:
        yield
    finally:
        if before < 2:
            drjit.set_thread_count(before)


@functools.cache
def mitsuba_folder() -> Path | None:
    """Return Mitsuba's package folder with its plugins and data; None if not installed."""
    spec = importlib.util.find_spec("mitsuba")
    return None if spec is None or spec.origin is None else Path(spec.origin).resolve().parent


def _already_running() -> bool:
    """Whether the caller's program has already set the variant, which shows that LLVM works."""
    module = sys.modules.get("mitsuba")
    return module is not None and module.variant() == VARIANT


def _no_mitsuba() -> str:
    return f"Rendering needs Mitsuba 3, which is not installed; {_INSTALL}."


def _no_library(refused: list[Verdict]) -> str:
    tried = _reasons(refused) or "none was found"
    return (
        f"Mitsuba needs a working libLLVM of version {_OLDEST_LLVM} or newer ({tried}); {_INSTALL}"
        f" (Linux x86-64), or install the system's LLVM ≥ {_OLDEST_LLVM} and set "
        f"{_LIBRARY_VARIABLE} to its library."
    )


def _reasons(refused: list[Verdict]) -> str:
    return "; ".join(f"{v.library}: {v.reason}" for v in refused)


def _candidates() -> Iterator[str]:
    """Yield paths of libraries in the order in which they are tested, each file once."""
    seen = set()
    given = os.environ.get(_LIBRARY_VARIABLE)
    for path in ([given] if given else []) + _wheel_library() + _system_libraries():
        real = os.path.realpath(path)
        if real not in seen:
            seen.add(real)
            yield real


def _wheel_library() -> list[str]:
    try:
        listed = files("karellen-llvm-core") or []
    except PackageNotFoundError:
        return []
    paths = (str(f.locate()) for f in listed if f.name.startswith("libLLVM."))
    return sorted(path for path in paths if Path(path).is_file())[:1]


def _system_libraries() -> list[str]:
    """Return the system's libraries, newest first. Names that state an old version are left out."""
    folders = _SYSTEM_FOLDERS.get(platform.system(), ())
    found = {str(path) for folder, pattern in folders for path in Path(folder).glob(pattern)}
    versions = {path: _llvm_version(path) for path in found}
    usable = [path for path in found if (versions[path] or _OLDEST_LLVM) >= _OLDEST_LLVM]
    return sorted(usable, key=lambda path: (-(versions[path] or 0), path))


def _llvm_version(path: str) -> int | None:
    """Return the major LLVM version in the path of a library after resolving links, or None."""
    match = re.search(r"(?:LLVM(?:-C)?|llvm)[-@.](?:so\.)?(\d+)", os.path.realpath(path))
    return int(match.group(1)) if match else None


def _verdict(library: str, fresh: bool) -> Verdict:
    file = cache_folder() / f"llvm-{_fingerprint(library)}.json"
    cached = None if fresh else _read_verdict(file, library)
    if cached is not None:
        return cached
    verdict, final = _probe(library)
    if final:
        # If the cache cannot be written, the next start repeats the test.
        draft = file.with_suffix(f".{os.getpid()}.tmp")
        kept = {name: getattr(verdict, name) for name in ("works", "reason", "version")}
        with contextlib.suppress(OSError):
            file.parent.mkdir(parents=True, exist_ok=True)
            draft.write_text(json.dumps(kept), encoding="utf-8")
            draft.replace(file)
    return verdict


def _fingerprint(library: str) -> str:
    """Hash everything that a verdict depends on. Clusters share home folders: hash the host too."""
    try:
        status = Path(library).stat()
        size, modified = status.st_size, status.st_mtime_ns
    except OSError:
        size, modified = -1, -1
    versions = [_version(name) for name in ("mitsuba", "drjit")]
    parts = [library, size, modified, *versions, sys.version, platform.node(), _PROBE]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:24]


def _probe(library: str) -> tuple[Verdict, bool]:
    """Test `library` in a subprocess; return the verdict and whether to store it."""
    if not Path(library).is_file():
        return Verdict(library, False, "there is no such file"), False
    try:
        run = _tried(_PROBE, {_LIBRARY_VARIABLE: library})
    except (OSError, subprocess.TimeoutExpired) as error:
        return Verdict(library, False, f"the test did not finish: {error}"), False
    if _worked(run):
        return Verdict(library, True, "", run.stdout.partition("version ")[2].strip()), True
    lines = [line.strip() for line in run.stderr.splitlines() if line.strip()]
    ending = f"signal {-run.returncode}" if run.returncode < 0 else f"status {run.returncode}"
    last = f" ({lines[-1][:160]})" if lines else ""
    return Verdict(library, False, f"the test ended with {ending}{last}"), True


def _tried(program: str, variables: Mapping[str, str] | None = None) -> _Run:
    """Run a program in a separate process that imports nothing from the current folder."""
    command = [sys.executable, "-P", "-c", program]
    kept: dict[str, Any] = {"capture_output": True, "text": True, "timeout": _PROBE_SECONDS}
    return subprocess.run(command, env={**os.environ, **(variables or {})}, check=False, **kept)


def _worked(run: _Run) -> bool:
    return run.returncode == 0 and "works True" in run.stdout


def _read_verdict(file: Path, library: str) -> Verdict | None:
    try:
        kept = json.loads(file.read_text(encoding="utf-8"))
        return Verdict(library, bool(kept["works"]), str(kept["reason"]), str(kept["version"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None
