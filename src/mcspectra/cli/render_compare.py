"""The option --compare of the verb `render`: a reference and each strategy, side by side."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcspectra.cli.common import (
    one_sentence_warnings,
    print_json,
    text_table,
    whole_number,
)
from mcspectra.cli.progress import progress_bars
from mcspectra.core.errors import ParameterError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["run_comparison"]

_SPP, _REFERENCE_SPP = 4, 1024


def run_comparison(
    options: argparse.Namespace,
    scene: str,
    settings: Mapping[str, Any],
    files: list[Path],
    exposure: float,
) -> int:
    """Render all, write pictures side by side and layers, and say how far each is off.

    Parameters
    ----------
    options
        Those of the verb.
    scene, settings
        Scene, and arguments of `compare_strategies` beside the numbers of samples.
    files, exposure
        Files to write, and the exposure of those that are pictures.
    """
    from mcspectra.rendering.image import compare_strategies

    for name in ("strategy", "realizations"):
        if getattr(options, name) is not None:
            raise ParameterError(f"--compare renders all strategies once; leave out --{name}.")
    if options.reference:
        raise ParameterError("--compare renders a reference too; leave out --reference.")
    spp = _SPP if options.spp is None else whole_number("--spp", options.spp)
    most = options.reference_spp
    count = _REFERENCE_SPP if most is None else whole_number("--reference-spp", most)
    with one_sentence_warnings(options.quiet), progress_bars(options.quiet):
        images = compare_strategies(scene, spp, reference_spp=count, **settings)
    for file in files:
        _write(file, images, exposure)
    rows = _rows(images)
    if options.json:
        written = list(map(str, files))
        print_json({"scene": scene, "spp": spp, "images": rows, "files": written})
    elif not options.quiet:
        _print(rows, files)
    return 0


def _write(file: Path, images: Mapping[str, xr.Dataset], exposure: float) -> None:
    from mcspectra.core.errors import FileFormatError
    from mcspectra.rendering.files import write_comparison
    from mcspectra.report.encode import encode_exact
    from mcspectra.report.figures.strategy_images import strategy_images

    if file.suffix.lower() == ".exr":
        write_comparison(file, images)
        return
    picture = encode_exact(strategy_images(images, exposure=exposure))
    try:
        file.write_bytes(picture)
    except OSError as error:
        raise FileFormatError(f"{str(file)!r} cannot be written: {error.strerror}.") from None


def _rows(images: Mapping[str, xr.Dataset]) -> dict[str, dict[str, Any]]:
    from mcspectra.report.figures.strategy_images import rms_error

    rows: dict[str, dict[str, Any]] = {}
    for name, data in images.items():
        told = data.attrs
        techniques = 2 if told["strategy"] == "mis" else 1
        rows[name] = {
            "samples": told["spp"] * told["realizations"] * techniques,
            "mean": data["image"].mean(("y", "x")).values,
            "rms_error": None if name == "reference" else rms_error(data, images["reference"]),
        }
    return rows


def _print(rows: Mapping[str, Mapping[str, Any]], files: list[Path]) -> None:
    table = [
        [
            name,
            " ".join(f"{value:.5g}" for value in row["mean"]),
            str(row["samples"]),
            "" if row["rms_error"] is None else f"{row['rms_error']:.3g}",
        ]
        for name, row in rows.items()
    ]
    print(text_table(["image", "mean radiance (R G B)", "samples a pixel", "rms error"], table))
    for file in files:
        print(f"wrote {file}")
