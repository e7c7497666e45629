"""What frames of a renderer say, in words, as layers, and as one page."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array
from mcspectra.core.fits import is_resolved
from mcspectra.core.images import load_openexr
from mcspectra.core.results import strict_json
from mcspectra.plots import kinds
from mcspectra.plots.text import interval, number, percent, rate
from mcspectra.rendering.files import write_exr
from mcspectra.report import page as html
from mcspectra.report.map_page import map_layers

__all__ = [
    "check_frames_packages",
    "frame_findings",
    "frame_layers",
    "frame_summary",
    "frame_table",
    "write_frames",
]

_COLUMNS = ("Samples a pixel", "Frames", "Variance", "95 %", "σ / mean", "FLIP")
_LOW = 0.125  # cycles a pixel
_BLUE, _RED = 0.8, 1.25  # power there, below and above which noise is not called white
_UNSURE = 0.5  # error of that power, relative to it, which tells nothing
_ALIKE = 0.1  # correlation of neighbors that is worth a word
_SURE = 2.24  # standard errors that the larger of two correlations of white noise exceeds in 5 %
_HEAVY = 0.5  # tail index of infinite variance
_CARRIED = 0.05  # share of the variance in fireflies that is worth a word


def frame_summary(result: xr.Dataset) -> dict[str, Any]:
    """Numbers over the whole picture: a row for each number of samples, and what is told besides."""
    # Lists were written as text
    told = {
        key: json.loads(value) if isinstance(value, str) and value[:1] == "[" else value
        for key, value in result.attrs.items()
    }
    rows = []
    for k, n in enumerate(result["n"].values.tolist()):
        one = result.isel(n=k)
        row = {
            "n": n if told["spp_known"][k] else None,
            "frames": told["frame_count"][k],
            "picture_variance": float(one["picture_variance"]),
            "picture_variance_ci": one["picture_variance_ci"].values.tolist(),
            "median_relative_rmse": float(one["relative_rmse"].median()),
        }
        if "flip" in one:
            row["mean_flip"] = float(one["flip"].mean())
        rows.append(row)
    found: dict[str, Any] = {**told, "samples": rows}
    for name in ("picture_rate", "picture_ratio", "equal_time_ratio"):
        if name in result:
            found |= {name: float(result[name]), f"{name}_ci": result[f"{name}_ci"].values.tolist()}
    if "needed_spp" in result and np.isfinite(result["needed_spp"].values).any():
        need = result["needed_spp"].values
        best = result["relative_rmse"].isel(n=-1).values
        seen = best[np.isfinite(best)]
        found["reached_share"] = float((seen <= told["target"]).mean())
        percentiles = np.nanpercentile(need, [50, 95])
        found["needed_median"], found["needed_95"] = map(float, percentiles)
    return found


def frame_findings(result: xr.Dataset) -> list[str]:
    """What the numbers say, a sentence each, most important first."""
    found = frame_summary(result)
    return [*_against(found), *_doubts(found), *_noise(result, found)]


def _against(found: dict[str, Any]) -> Iterator[str]:
    """Two sets of frames: bias, variance, and both at equal time."""
    if "picture_ratio" not in found:
        return
    if found["identical"]:
        yield f"The means are the same to the last bit: {found['against']} holds the same frames."
        return
    ours, others = found["compared_n"]
    at = f"{ours} samples a pixel" + ("" if ours == others else f", the others {others}")
    biased, pixels = found["biased_pixels"], found["compared_pixels"]
    z = found["mean_difference_z"]
    apart = (
        f"the means of the pictures differ by {percent(abs(found['mean_difference']))} (as unlikely as {number(abs(z))} "
        "standard errors of a normal)"
    )
    if biased or abs(z) > 3:
        yield (
            f"The two do not converge to one picture: {biased} of {pixels} pixels differ by more than "
            f"{number(found['z_limit'])} standard errors (none would in 95 % of equal pairs), and {apart}."
        )
    ends = interval(*found["picture_ratio_ci"])
    yield f"At {at} the variance is {number(found['picture_ratio'])} ({ends}) of that of {found['against']}."
    if "equal_time_ratio" in found:
        ends = interval(*found["equal_time_ratio_ci"])
        yield f"At equal time it is {number(found['equal_time_ratio'])} ({ends})."
    if not biased and abs(z) <= 3:
        yield f"No bias is seen: no pixel differs significantly, and {apart}."


def _doubts(found: dict[str, Any]) -> Iterator[str]:
    """What makes the other numbers doubtful, of the frames of the most samples that show it."""
    last = len(found["samples"]) - 1
    for k in range(last, -1, -1):
        if pair := found["related"][k]:
            yield (
                f"The frames {pair[0]} and {pair[1]} are not independent: their errors correlate by "
                f"{number(found['relation'][k])}. Give every frame a seed of its own; variances are too small."
            )
            break
    for k in range(last, -1, -1):
        count, expected = found["outliers"][k], found["outliers_expected"][k]
        share, tail = found["outlier_share"][k], found["tail_index"][k]
        # More than normal noise has, by four standard errors of a count
        if count and count > expected + 4 * expected**0.5 and share > _CARRIED:
            yield (
                f"Fireflies: at {count} pixels one frame is far brighter ({number(expected, 2)} expected of normal "
                f"noise); these pixels make {percent(share)} of the picture's variance"
                + (
                    f"; the errors of all pixels together have the tail index {number(tail, 2)}, and from ½ on the variance is infinite."
                    if tail and tail > _HEAVY
                    else "."
                )
            )
            break
    missing = max(found["missing"])
    if missing:
        yield f"Pixels that are NaN or infinite in some frame, and have no numbers: {missing}."
    if not np.isfinite([row["picture_variance_ci"][1] for row in found["samples"]]).all():
        yield "The variance has no upper bound yet: one pixel of one frame makes over 5 % of all squared errors."


def _noise(result: xr.Dataset, found: dict[str, Any]) -> Iterator[str]:
    """The rate, the target, and how pixels err together."""
    if "picture_rate" in found:
        slope, (low, high) = found["picture_rate"], found["picture_rate_ci"]
        yield (
            f"The variance of the picture falls as samples to the power {rate(slope, low, high)}."
            if is_resolved(low, high)
            else f"The rate of the picture's variance is not resolved: {interval(low, high)}."
        )
    if "needed_median" in found:
        known = found["spp_known"][-1]
        times = "" if known else " times as many"
        # Of normal noise; the need is proportional to σ²
        doubt = math.sqrt(2.0 / max(found["samples"][-1]["frames"] - 1, 1))
        yield (
            f"{percent(found['reached_share'])} of the pixels reach σ / mean = {number(found['target'])} "
            + (f"at {result['n'].values[-1]} samples" if known else "in a frame")
            + (". By their rates" if "rate" in result else ". If the variance falls as 1/n")
            + f", half of the pixels need {number(found['needed_median'])}{times}, and "
            f"95 % need at most {number(found['needed_95'])}{times}. The estimate for one pixel has an error of "
            f"± {percent(doubt)}; this error makes the last number too large."
        )
    last = result.isel(n=-1)
    lowest = last["radius"].values < _LOW
    power, ends = last["error_spectrum"].values[lowest], last["error_spectrum_ci"].values[lowest]
    level = float(power.sum()) / max(power.size, 1)
    half = float(np.linalg.norm(ends[:, 1] - power)) / max(power.size, 1)
    near = last["error_correlation"]
    beside = tuple(
        float(near.reindex(lag_y=[y], lag_x=[x], fill_value=0.0).squeeze())
        for y, x in ((0, 1), (1, 0))
    )
    have = f"{number(level)} ± {number(half, 2)} times the power of white noise"
    below = f"below {_LOW} cycles a pixel " + (
        f"the errors have {have}" if power.size else "so small a picture has no errors"
    )
    factor = (
        math.exp(min(half / level, 700.0)) if level > 0 else math.inf
    )  # errors of powers are relative
    if level < _BLUE and level * factor < 1.0:
        yield f"Blue noise: {below}, which the eye, and a denoiser, blurs away."
    elif level > _RED and level > factor:
        yield (
            f"Neighbors err together: {below}; a wide reconstruction filter, or points shared by pixels."
        )
    elif half > _UNSURE * level or not power.size:
        yield f"Whether the noise is white between pixels is not resolved: {below}."
    elif not found["repeat"][-1]:
        white = level < factor and level * factor > 1.0
        yield f"The noise is {'white' if white else 'nearly white'} between pixels: {below}."
    if max(map(abs, beside)) > max(_ALIKE, _SURE * found["correlation_error"][-1]):
        yield f"Errors of neighbors correlate by {number(beside[0])} across and {number(beside[1])} down."
    if lag := found["repeat"][-1]:
        yield (
            f"The noise repeats after {lag[1]} pixels across and {lag[0]} down (correlation "
            f"{number(found['repeat_correlation'][-1])}): tiles share points or seeds."
        )


def frame_table(found: dict[str, Any]) -> html.Table:
    """The numbers of `frame_summary` over the picture."""
    rows = [
        [
            str(row["n"] or "unknown"),
            str(row["frames"]),
            number(row["picture_variance"]),
            interval(*row["picture_variance_ci"]),
            number(row["median_relative_rmse"]),
            number(row.get("mean_flip")),
        ]
        for row in found["samples"]
    ]
    caption = "Variance of one frame, mean over the pixels; median over the pixels of σ / mean"
    if "mean_flip" in found["samples"][0]:
        caption += "; mean FLIP of one frame against the mean"
    shown = len(_COLUMNS) - ("mean_flip" not in found["samples"][0])
    return html.table_of(f"{caption}.", _COLUMNS[:shown], [row[:shown] for row in rows], words=())


def frame_layers(result: xr.Dataset) -> dict[str, Array]:
    """Layers of EXR: the mean picture, and every number of the pixels by name and samples."""
    maps = result.drop_vars(
        [n for n in result if not {"y", "x"} <= set(result[n].dims)] + ["image"]
    )
    image = result["image"].values
    return {"": image if image.shape[2] == 3 else image[..., 0], **map_layers(maps)}


def check_frames_packages() -> None:
    """Refuse `write_frames` before frames are read.

    Raises
    ------
    MissingDependency
        The extra ``report`` is not installed, or OpenEXR is not.
    """
    html.check_page_packages("frames,report")
    load_openexr()


def write_frames(result: xr.Dataset, folder: str | Path) -> Path:
    """Write ``frames.exr``, pictures, ``frames.json`` and ``report.html``; older ones are replaced.

    Parameters
    ----------
    result
        What `mcspectra.rendering.frames` returns.
    folder
        Made if need be.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    StoreError
        The folder cannot be written.
    FileFormatError
        The layers cannot be written.
    MissingDependency
        The extra ``report`` is not installed, or OpenEXR is not.
    """
    check_frames_packages()
    root = Path(folder)
    found, said = frame_summary(result), frame_findings(result)
    html.write_json(root / "frames.json", {**found, "findings": said})
    write_exr(root / "frames.exr", frame_layers(result), comment=json.dumps(strict_json(found)))
    plots = {
        kind.replace("-", "_"): kinds.describe(kind, result)
        for kind in kinds.kinds_of(result)
        if kind.startswith("frames-")
    }
    layer = (("Layer", found["layer"]),) if "layer" in found else ()
    facts = (("Frames", found["frames"]), *layer)
    page = html.Page(
        title=f"Noise of {Path(found['frames']).name}",
        what="frames",
        lead=tuple(html.Paragraph(text=text) for text in said[:1]),
        sections=html.sections_of(
            {
                "Summary": (frame_table(found), *(html.Paragraph(text=text) for text in said[1:])),
                "Pixels": html.figures_of(plots),
                "Provenance": html.provenance(facts, result.attrs),
            }
        ),
    )
    return html.write_page(page, root / "report.html", root)
