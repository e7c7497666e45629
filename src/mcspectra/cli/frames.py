"""The verb of frames: files of any renderer, the noise of their pixels, and what it looks like."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from mcspectra.cli.common import Answer, option, real, text_table, verb, whole
from mcspectra.core.errors import MissingDependency, ParameterError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["frames_"]


@verb(
    option("FILES", "a folder, a pattern in quotes, or files: .exr, .pfm, .npy", nargs="+"),
    option("--spp N", "samples a pixel; by default from names and headers", whole()),
    option("--against PATH", "frames of another renderer or setting of the same view"),
    option("--target E", "σ / mean that pixels should reach", real(above=0.0)),
    option("--seconds S", "time of a frame; by default from headers", real(above=0.0)),
    option("--seconds-against S", "time of a frame of the others", real(above=0.0)),
    option("--layer NAME", "layer or channel of EXR files"),
    option("--tone-mapped", "take PNG and JPEG, too"),
    option("--no-flip", "leave FLIP out, which takes longer than all else together"),
    option("--tev HOST:PORT", "show the layers in a tev that listens there, e.g. localhost:14158"),
    option("--out DIR", "write frames.exr, pictures, frames.json and report.html"),
)
def frames_(options: argparse.Namespace) -> Answer:
    """Variance, rate and error spectrum of independent renders of one view, by any renderer.

    Frames of several numbers of samples give rates; --against holds two sets against each other: bias,
    variance and equal time.
    """
    from mcspectra.rendering.frame_statistics import frames
    from mcspectra.report import frames_page

    files = options.files
    result = frames(
        files[0] if len(files) == 1 else files,
        spp=options.spp,
        against=options.against,
        target=options.target,
        seconds=options.seconds,
        seconds_against=options.seconds_against,
        layer=options.layer,
        tone_mapped=options.tone_mapped,
        flip=not options.no_flip,
    )
    found, said = frames_page.frame_summary(result), frames_page.frame_findings(result)
    columns, rows = frames_page.frame_table(found)
    lines = [
        text_table([columns[0], "", *columns[1:]], [[row[0], "", *row[1:]] for row in rows]),
        *said,
    ]
    data = {**found, "findings": said}
    if options.tev:
        _show(result, options.tev)
    if options.out:
        data["report"] = frames_page.write_frames(result, options.out)
        lines.append(f"frames: {data['report']}")
    return Answer("\n".join(lines), data)


def _show(result: xr.Dataset, address: str) -> None:
    """Send every layer to tev, a picture each."""
    import numpy as np

    from mcspectra.report.frames_page import frame_layers

    host, _, port = address.rpartition(":")
    if not port.isdecimal():
        raise ParameterError(f"--tev is {address!r}; give HOST:PORT, as tev --hostname takes it.")
    try:
        from tevclient import Ipc
    except ImportError:
        raise MissingDependency(
            "--tev needs the package tevclient; install it with: pip install 'mcspectra[frames]'"
        ) from None
    tev = Ipc(host or "localhost", int(port))
    try:
        with tev:
            for name, plane in frame_layers(result).items():
                values = np.ascontiguousarray(np.atleast_3d(plane), np.float32)
                channels = ["R", "G", "B"] if values.shape[2] == 3 else ["Y"]
                title, (height, width, _) = f"mcspectra {name or 'mean'}", values.shape
                tev.create_image(title, width, height, channels)
                tev.update_image(title, values, channel_names=channels)
    except OSError as error:
        tev.__exit__(None, None, None)  # it keeps a socket that could not be connected
        raise ParameterError(f"No tev answers at {address}: {error.strerror or error}.") from None
