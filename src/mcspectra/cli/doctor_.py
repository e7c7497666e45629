"""Say what is installed and whether it works: versions, kernels, NUFFT, GPU, renderer, extras."""

from __future__ import annotations

import argparse
import os
import platform
from importlib import metadata
from typing import Any

from mcspectra.cli.common import Answer
from mcspectra.core.cache import cache_folder, cache_size
from mcspectra.core.parallel import available_workers
from mcspectra.core.results import package_versions

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb has no options of its own."""


def run(options: argparse.Namespace) -> Answer:  # noqa: ARG001
    """Try each part and say what was found; exit 1 if a part that is always needed fails."""
    found: dict[str, Any] = {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processors": available_workers(),
        **package_versions(),
        "cache of point sets": _cache(),
        "numba cache": os.environ.get("NUMBA_CACHE_DIR", "beside the package"),
    }
    works, sentence = _try_transform()
    found["transforms"] = sentence
    found["gpu"] = _gpu()
    found["renderer"] = _renderer()
    found["optional packages"] = _optional_packages()
    width = max(map(len, found))
    lines = [
        f"{name.replace('_', ' ').ljust(width)}  {_joined(v) if isinstance(v, dict) else v}"
        for name, v in found.items()
    ]
    return Answer("\n".join(lines), {**found, "works": works}, 0 if works else 1)


def _try_transform() -> tuple[bool, str]:
    """Compare one NUFFT with the direct sum."""
    import numpy as np

    from mcspectra.spectra.transforms import FrequencyGrid, Transform, direct_sum

    grid = FrequencyGrid(2, 8)
    points = np.random.default_rng(0).random((2, 256, 2))
    try:
        got = Transform(grid, 256, engine="nufft").coefficients(points)
    except (ImportError, OSError, RuntimeError) as error:
        return False, f"NUFFT fails: {type(error).__name__}: {error}"
    error_size = float(np.abs(got - direct_sum(points, grid.half_indices())).max())
    return error_size < 1e-8, f"NUFFT against the direct sum: largest difference {error_size:.1e}"


def _cache() -> str:
    """Where sets that took long are kept; the folder may be deleted at any time."""
    entries, size = cache_size()
    return f"{entries} sets, {size / 2**20:.1f} MiB in {cache_folder()}"


def _renderer() -> dict[str, Any]:
    from mcspectra.rendering.backend import describe

    return describe()


def _gpu() -> str:
    """Name of the device, or why the engine cannot be used."""
    from mcspectra.spectra.transforms import gpu_description

    return gpu_description()[1]


def _optional_packages() -> dict[str, str]:
    """Version of each, or what installs it."""
    return {name: _version(name) for name in ("qmcpy", "pyarrow", "vegas")}


def _version(package: str) -> str:
    extra = {"pyarrow": "parquet"}.get(package, package)
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return f"not installed (pip install 'mcspectra[{extra}]')"


def _joined(value: dict[str, Any]) -> str:
    texts = {k: ", ".join(v) if isinstance(v, list) else v for k, v in value.items()}
    return "; ".join(f"{key} {text}" for key, text in texts.items() if text)
