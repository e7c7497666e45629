"""A test of renders against a reference, for the test suite of a renderer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcspectra.rendering.frame_files import Frames

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ImagesDiffer", "ImagesUndecided", "assert_same_image"]


class ImagesDiffer(AssertionError):
    """The new frames differ from the reference. The comparison of the frames is in `result`."""

    def __init__(self, message: str, result: xr.Dataset) -> None:
        super().__init__(message)
        self.result = result


class ImagesUndecided(AssertionError):
    """There are too few frames for a verdict. The comparison of the frames is in `result`."""

    def __init__(self, message: str, result: xr.Dataset) -> None:
        super().__init__(message)
        self.result = result


def assert_same_image(
    new: Frames,
    reference: Frames,
    *,
    level: float = 0.01,
    target: float | None = None,
    report: str | Path | None = None,
    **options: Any,
) -> xr.Dataset:
    """Assert that new renders agree with a reference in mean and noise.

    Parameters
    ----------
    new, reference
        Frames to test and the reference, as in `mcspectra.rendering.gate`.
    level, target
        Probability of a false alarm, and relative bias of the image mean that must be found.
    report
        Folder for a page with figures, which is written if the assertion fails.
    **options
        Further parameters of `mcspectra.rendering.gate`.

    Returns
    -------
    xarray.Dataset
        The comparison of the frames by `mcspectra.rendering.gate`, with the verdict ``pass``.

    Raises
    ------
    ImagesDiffer
        If the verdict is ``fail``.
    ImagesUndecided
        If the verdict is ``undecided``.
    FileFormatError, ParameterError
        If files or options are not valid for `mcspectra.rendering.gate`.

    Notes
    -----
    With K such tests, a test suite gives a false alarm with at most the probability K · `level`.
    """
    from mcspectra.rendering.gate import gate
    from mcspectra.report.gate_page import gate_findings, write_gate

    result = gate(new, reference, level=level, target=target, **options)
    verdict = result.attrs["verdict"]
    if verdict == "pass":
        return result
    lines = gate_findings(result)
    if report is not None:
        lines.append(f"See {write_gate(result, report)}")
    error = ImagesDiffer if verdict == "fail" else ImagesUndecided
    raise error("\n".join(lines), result)
