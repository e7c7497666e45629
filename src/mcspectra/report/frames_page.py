"""Findings about the noise of rendered frames: as sentences, as EXR layers and as one page."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array
from mcspectra.core.fits import is_resolved
from mcspectra.core.images import Rings, load_openexr
from mcspectra.core.results import strict_json
from mcspectra.plots import kinds
from mcspectra.plots.text import interval, number, percent, rate
from mcspectra.rendering.files import write_exr
from mcspectra.report import page as html
from mcspectra.report.map_page import map_layers

__all__ = [
    "check_frames_packages",
    "filter_table",
    "frame_findings",
    "frame_layers",
    "frame_summary",
    "frame_table",
    "write_frames",
]

_COLUMNS = ("Samples per pixel", "Frames", "Variance", "95 %", "σ / mean")
_MEASURES = {"mean_flip": "FLIP", "relmse": "relMSE", "smape": "SMAPE"}
_LOW = 0.125  # frequencies below this limit in cycles per pixel count as low
# Noise counts as white if its relative power at low frequencies is between 0.8 and 1.25
_BLUE, _RED = 0.8, 1.25
_UNSURE = 0.5  # a power with a relative error above this limit is not interpreted
_ALIKE = 0.1  # smallest correlation of neighboring errors that is reported
# In white noise, the larger of two correlations exceeds 2.24 standard errors in 5 % of cases
_SURE = 2.24
_HEAVY = 0.5  # tail index above which the variance is infinite
_CARRIED = 0.05  # fireflies are reported if they hold more than this share of the variance
_MOST = 0.5  # a cause with more than this share is called the main source of the variance
# Effect of findings that come first on the page, which lists findings by decreasing effect.
# For example, a bias comes first because it changes the meaning of all other numbers
_SURELY = 100.0


def frame_summary(result: xr.Dataset) -> dict[str, Any]:
    """Return numbers of the whole image for each number of samples, and all attributes."""
    # Attributes store lists as JSON text
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
        for name in ("bias", "relmse", "smape"):
            if f"image_{name}" in one:
                row |= {name: float(one[f"image_{name}"])}
                row |= {f"{name}_ci": one[f"image_{name}_ci"].values.tolist()}
        rows.append(row)
    found: dict[str, Any] = {**told, "samples": rows}
    for name in ("denoised_variance", "denoised_square", "denoised_boiling"):
        if name in result:
            found |= {name: float(result[name]), f"{name}_ci": result[f"{name}_ci"].values.tolist()}
    last = result.isel(n=-1)
    if "squared_bias" in last:
        found["squared_bias"] = float(last["squared_bias"])
    if "frame" in last.dims:
        found["frame_errors"] = [
            {"frame": frame, **_errors(last.sel(frame=frame))}
            for frame in last["frame"].values.tolist()
        ]
    for name in ("boiling", "effective_frames"):
        if name in last:
            found |= {name: float(last[name]), f"{name}_ci": last[f"{name}_ci"].values.tolist()}
    if "frame_correlation" in last:
        found["frame_correlation"] = float(last["frame_correlation"].sel(lag_t=1))
    if "filter" in last.dims:
        found["filtered"] = [
            {"filter": spec, **_left(last.sel(filter=spec), "filtered")}
            for spec in last["filter"].values.tolist()
        ]
    if "sigma" in last.dims:
        found["gaussian"] = [
            {"sigma": sigma, **_left(last.sel(sigma=sigma), "gaussian")}
            for sigma in last["sigma"].values.tolist()
        ]
    for name in ("picture_rate", "picture_ratio", "equal_time_ratio"):
        if name in result:
            found |= {name: float(result[name]), f"{name}_ci": result[f"{name}_ci"].values.tolist()}
    if "needed_spp" in result:
        best = result["relative_rmse"].isel(n=-1).values
        seen = best[np.isfinite(best)]
        if seen.size:
            found["reached_share"] = float((seen <= told["target"]).mean())
    return found


def _errors(one: xr.Dataset) -> dict[str, Any]:
    """Return the errors of one frame of the sequences against its reference."""
    return {
        key: value
        for name in ("bias", "relmse", "smape")
        for key, value in (
            (name, float(one[f"frame_{name}"])),
            (f"{name}_ci", one[f"frame_{name}_ci"].values.tolist()),
        )
    }


def _left(one: xr.Dataset, name: str) -> dict[str, Any]:
    """Return the variance after one filter, as numbers for the page."""
    row: dict[str, Any] = {}
    for part in ("variance", "ratio", "picture_ratio"):
        if (full := f"{name}_{part}") in one:
            row |= {part: float(one[full]), f"{part}_ci": one[f"{full}_ci"].values.tolist()}
    return row


def frame_findings(result: xr.Dataset) -> list[str]:
    """Return the findings as sentences, with the largest effect first.

    The effect is |ln r|, where r is the factor by which a finding changes the variance.
    """
    found = frame_summary(result)
    every = [
        *_against(found),
        *_referred(result, found),
        *_doubts(found),
        *_after(found),
        *_commanded(found),
        *_noise(result, found),
    ]
    return [each.text for each in sorted(every, key=lambda each: -each.effect)]


def _after(found: dict[str, Any]) -> Iterator[_Finding]:
    """Describe correlations over time, and compare the frames after a filter."""
    if "boiling" in found:
        level, (low, high) = found["boiling"], found["boiling_ci"]
        frames, ends = found["effective_frames"], found["effective_frames_ci"]
        said = (
            f"below 1/8 cycle per frame the errors have {number(level)} (95 %: "
            f"{interval(low, high)}) times the power of white noise, and the mean of "
            f"{found['times']} frames is as noisy as that of {number(frames)} independent ones "
            f"(95 %: {interval(*ends)}). Consecutive frames have correlation "
            f"{number(found['frame_correlation'])}."
        )
        if low > 1.0:
            yield _Finding(math.log(level), f"The noise boils: {said}")
        elif high < 1.0:
            yield _Finding(-math.log(level), f"The noise cancels over time: {said}")
        else:
            yield _Finding(0.0, f"The errors show no correlation over time: {said}")
    if "picture_ratio" not in found or found["identical"]:
        return
    asked = found.get("filtered", [])
    curve = [
        {"filter": f"a Gaussian of σ = {row['sigma']:g} pixels", **row}
        for row in found.get("gaussian", [])
    ]
    value = found["picture_ratio"]
    alone = _shift(value, *found["picture_ratio_ci"])
    opposites = []
    for row in asked or curve:
        ratio, ends = row["picture_ratio"], row["picture_ratio_ci"]
        effect = _shift(ratio, *ends)
        times = f"(95 %: {interval(*ends)})"
        if alone > 0 and effect > 0 and (ratio < 1.0) != (value < 1.0):
            each = _Finding(
                effect,
                f"These frames are {_compare(value)} per pixel than those of {found['against']}, "
                f"and {_compare(ratio)} after {row['filter']}: variance × {number(ratio)} {times}.",
            )
            opposites.append(each)
        elif asked:
            each = _Finding(
                effect,
                f"After {row['filter']} the variance is {number(ratio)} {times} times the "
                f"variance of {found['against']}.",
            )
        else:
            continue
        if asked:
            yield each
    # A Gaussian filter may reverse which of two sets of frames has less variance.
    # If no filter was given, report the Gaussian that most strongly reverses the two variances
    if not asked and opposites:
        yield max(opposites)


def _referred(result: xr.Dataset, found: dict[str, Any]) -> Iterator[_Finding]:
    """Describe the errors relative to the reference, and the tile with the largest error."""
    if "reference" not in found:
        return
    last, biased = found["samples"][-1], found["reference_biased_pixels"]
    whole, pixels = last["bias"], found["reference_pixels"]
    low, high = last["bias_ci"]
    sure = not low <= 0.0 <= high
    variance, square = last["picture_variance"], max(found["squared_bias"], 0.0)
    tile = np.abs(np.nan_to_num(result["tile_bias"].isel(n=-1).values))
    place = np.unravel_index(int(tile.argmax()), tile.shape)
    worst = result["tile_bias"].isel(n=-1, tile_y=place[0], tile_x=place[1])
    ends = result["tile_bias_ci"].isel(n=-1, tile_y=place[0], tile_x=place[1]).values
    about = (
        f"relMSE {number(last['relmse'])}, SMAPE {number(last['smape'])}"
        + (f", FLIP {number(last['mean_flip'])}" if "mean_flip" in last else "")
        + f"; the tile with the largest bias is at x = {float(worst['tile_x']):.0f}, "
        f"y = {float(worst['tile_y']):.0f}: {_signed(float(worst))} (95 %: "
        f"{_signed(float(ends[0]))} … {_signed(float(ends[1]))})"
    )
    if "frame_errors" in found:
        row = max(found["frame_errors"], key=lambda each: each["relmse"])
        about += (
            f"; of the frames, {row['frame']} has the largest relMSE, {number(row['relmse'])}, and "
            f"the bias {_signed(row['bias'])} (95 %: {_signed(row['bias_ci'][0])} … "
            f"{_signed(row['bias_ci'][1])})"
        )
    about += "."
    if biased or sure:
        yield _Finding(
            max(_lost(square / (square + variance)), 0.05),
            f"The frames are biased against the reference: the image mean by {_signed(whole)} "
            f"(95 %: {_signed(low)} … {_signed(high)}), and {biased} of {pixels} pixels differ by "
            f"more than {number(found['reference_z_limit'])} standard errors. Bias makes "
            f"{_share(square / (square + variance))} of the squared error of a frame; {about}",
        )
    else:
        yield _Finding(
            0.0,
            f"No bias against the reference is significant: image mean {_signed(whole)} (95 %: "
            f"{_signed(low)} … {_signed(high)}); {about}",
        )


def _share(share: float) -> str:
    return percent(share) if share >= 0.005 else "less than 1 %"


def _commanded(found: dict[str, Any]) -> Iterator[_Finding]:
    """Describe the error of frames that an external program (a denoiser) has filtered."""
    if "filter_command" not in found:
        return
    whole = found["samples"][-1]["picture_variance"]
    variance, square = found["denoised_variance"], found["denoised_square"]
    ends = [end / whole for end in found["denoised_variance_ci"]]
    bias = [max(end / whole, 0.0) for end in found["denoised_square_ci"]]
    total = (variance + max(square, 0.0)) / whole
    against = "the reference" if "reference" in found else "the mean of the frames"
    yield _Finding(
        abs(math.log(total)) if total > 0 else 0.0,
        f"After the command the variance is {number(variance / whole)} (95 %: {interval(*ends)}) "
        f"times that of the frames, and the squared bias against {against} is "
        f"{number(max(square, 0.0) / whole)} (95 %: {interval(*bias)}) times that variance. The "
        "filter was run on all frames, because the error of a denoiser cannot be predicted from "
        "a spectrum.",
    )
    if "denoised_boiling" in found:
        level, (low, high) = found["denoised_boiling"], found["denoised_boiling_ci"]
        said = (
            f"below 1/8 cycle per frame the errors have {number(level)} (95 %: "
            f"{interval(low, high)}) times the power of white noise, and "
            f"{number(found['boiling'])} times before the command."
        )
        if low > 1.0:
            yield _Finding(math.log(level), f"After the command the noise boils: {said}")
        else:
            yield _Finding(0.0, f"After the command no boiling is significant: {said}")


def _compare(ratio: float) -> str:
    return f"{number(max(ratio, 1.0 / ratio))} times {'worse' if ratio > 1.0 else 'better'}"


class _Finding(NamedTuple):
    """A sentence about frames, and the size of the effect on the variance that it describes.

    The page lists findings by decreasing effect.
    """

    effect: float
    text: str


def _lost(share: float) -> float:
    """Return −ln(1 − share): the effect of a source of noise with this share of the variance."""
    return -math.log1p(-min(max(share, 0.0), 1.0 - 1e-9))


def _against(found: dict[str, Any]) -> Iterator[_Finding]:
    """Compare two sets of frames: bias, variance, and variance at equal time."""
    if "picture_ratio" not in found:
        return
    if found["identical"]:
        yield _Finding(
            math.inf,
            f"The means are identical: {found['against']} contains the same frames.",
        )
        return
    ours, others = found["compared_n"]
    if found["pairs"]:
        yield _Finding(
            _SURELY,
            f"{found['pairs']} frames of {found['against']} have the seeds of these frames "
            f"(correlation {number(found['pair_correlation'])}), so the frames are compared as "
            "pairs.",
        )
    biased, pixels = found["biased_pixels"], found["compared_pixels"]
    z = found["mean_difference_z"]
    if biased or abs(z) > 3:
        mean = percent(abs(found["mean_difference"]))
        yield _Finding(
            _SURELY,
            f"The two do not converge to one image: {biased} of {pixels} pixels differ by more "
            f"than {number(found['z_limit'])} standard errors (limit for the largest of all "
            f"pixels, 95 %), and the image means differ by {mean} ({number(abs(z))} standard "
            "errors).",
        )
    low, high = found["picture_ratio_ci"]
    ends = interval(low, high)
    effect = _shift(found["picture_ratio"], low, high)
    at = f"At {ours} samples per pixel" if found["spp_known"][-1] else "In one frame"
    scaled = ""
    if ours != others:
        scaled = f" The others have {others} samples per pixel; " + (
            f"their variance is scaled by the {found['scaled_by']} rate "
            f"{number(found['scaled_rate'])}."
            if found.get("scaled_by")
            else "the variances are not scaled, because a number of samples is unknown."
        )
    yield _Finding(
        effect,
        f"{at} the variance is {number(found['picture_ratio'])} "
        f"(95 %: {ends}) times the variance of {found['against']}.{scaled}",
    )
    if "equal_time_ratio" in found:
        ends = interval(*found["equal_time_ratio_ci"])
        yield _Finding(
            effect,
            f"At equal time the ratio is {number(found['equal_time_ratio'])} (95 %: {ends}).",
        )
    if not biased and abs(z) <= 3:
        yield _Finding(
            effect,
            "No difference is found between the means of the images, or of single pixels. "
            "`mcspectra gate` also tests regions, and finds smaller differences.",
        )


def _shift(ratio: float, low: float, high: float) -> float:
    """Return the effect of a ratio: |ln ratio| if its interval excludes 1, or else 0."""
    return abs(math.log(ratio)) if ratio > 0 and not low <= 1.0 <= high else 0.0


def _doubts(found: dict[str, Any]) -> Iterator[_Finding]:
    """Yield warnings about unreliable numbers.

    Each kind of problem is reported once, at the largest number of samples where it occurs.
    """
    last = len(found["samples"]) - 1
    for k in range(last, -1, -1):
        if pair := found["related"][k]:
            yield _Finding(
                math.inf,
                f"Give every frame its own seed: the errors of the frames {pair[0]} and {pair[1]} "
                f"have correlation {number(found['relation'][k])}, so the variances are too small.",
            )
            break
    for k in range(last, -1, -1):
        if change := found["drift"][k]:
            yield _Finding(
                _lost(found["drift_share"][k]),
                f"The frames drift: their image means change by {_signed(change)} per frame, "
                "in the order of their names. Brightness explains "
                f"{percent(found['drift_share'][k])} of the measured variance. Give frames of one "
                "exposure and one scene.",
            )
            break
        if _flickers(found, k):
            yield _Finding(
                _lost(found["drift_share"][k]),
                "The frames differ mainly in brightness, which explains "
                f"{percent(found['drift_share'][k])} of the measured variance. Possible causes are "
                "a changing exposure or light, and points shared by all pixels.",
            )
            break
    for k in range(last, -1, -1):
        count, expected = found["outliers"][k], found["outliers_expected"][k]
        share, tail = found["outlier_share"][k], found["tail_index"][k]
        # Report fireflies only if their number exceeds that of normal noise by four standard errors
        if count and count > expected + 4 * expected**0.5 and share > _CARRIED:
            yield _Finding(
                # Fireflies are listed last, unless they cause more than half of the variance
                _lost(share) if share > _MOST else 0.0,
                f"Fireflies: at {count} pixels one frame is far brighter than the others "
                f"({number(expected, 2)} pixels expected for normal noise). These pixels cause "
                f"{percent(share)} of the image's variance"
                + (
                    f". The tail index of all errors is {number(tail, 2)}; above ½ the variance is "
                    "infinite."
                    if tail and tail > _HEAVY
                    else "."
                ),
            )
            break
    missing = max(found["missing"])
    if missing:
        yield _Finding(0.0, f"Pixels excluded because a frame is NaN or infinite there: {missing}.")
    if not np.isfinite([row["picture_variance_ci"][1] for row in found["samples"]]).all():
        yield _Finding(
            0.0,
            "The variance has no upper bound yet: one pixel of one frame causes over 5 % of the "
            "sum of squared errors.",
        )


def _flickers(found: dict[str, Any], k: int) -> bool:
    """Whether changes of brightness between frames make most of the variance."""
    return bool(found["drift_share"][k] > _MOST)


def _signed(change: float) -> str:
    return ("+" if change > 0 else "−") + percent(abs(change))


def _steps(samples: list[dict[str, Any]]) -> str | None:
    """Describe the exponents between neighboring numbers of samples, if they are all resolved."""
    said = []
    for a, b in pairwise(samples):
        step = math.log(b["n"] / a["n"]) if a["n"] and b["n"] else 1.0
        slope = math.log(b["picture_variance"] / a["picture_variance"]) / step
        # Intervals of variances are nearly symmetric on a logarithmic scale
        halves = (math.log(e["picture_variance_ci"][1] / e["picture_variance"]) for e in (a, b))
        half = math.hypot(*halves) / step
        if not is_resolved(slope - half, slope + half):
            return None
        said.append(f"{rate(slope, slope - half, slope + half)} from {a['n']} to {b['n']} samples")
    if len(said) < 2:
        return None
    return (
        "The variance of the image follows no single power of the number of samples: the exponent "
        f"is {' and '.join(said)}."
    )


def _noise(result: xr.Dataset, found: dict[str, Any]) -> Iterator[_Finding]:
    """Describe the rate, the target, and correlations of errors between pixels."""
    if "picture_rate" in found:
        slope, (low, high) = found["picture_rate"], found["picture_rate_ci"]
        if not is_resolved(low, high):
            yield _Finding(
                0.0,
                _steps(found["samples"])
                or f"The rate of the image's variance is not resolved: {interval(low, high)}.",
            )
        elif low > 0.0:
            yield _Finding(
                math.inf,
                "The variance of the image grows with the number of samples, to the power "
                f"{rate(slope, low, high)}: check that no numbers of samples are swapped in the "
                "names. No number of samples is predicted for a target.",
            )
        else:
            yield _Finding(
                0.0,
                "The variance of the image falls as the number of samples to the power "
                f"{rate(slope, low, high)}.",
            )
    if "needed_median" in found and "reached_share" in found:
        known = found["spp_known"][-1]
        times = "" if known else " times as many"
        resolved = "picture_rate" in found and is_resolved(*found["picture_rate_ci"])
        # Relative error of σ² for normal noise. The number of samples needed is proportional to σ²
        doubt = math.sqrt(2.0 / max(found["samples"][-1]["frames"] - 1, 1))
        yield _Finding(
            0.0,
            f"{percent(found['reached_share'])} of the pixels reach σ / mean = "
            f"{number(found['target'])} "
            + (f"at {result['n'].values[-1]} samples" if known else "in a frame")
            + (". By their rates" if resolved else ". If the variance falls as 1/n")
            + f", half of the pixels need {number(found['needed_median'])}{times}, and "
            f"95 % need at most {number(found['needed_95'])}{times}. The estimate for one pixel "
            f"scatters by ± {percent(doubt)}; this scatter is removed from both numbers.",
        )
    if (found["drift"][-1] and found["drift_share"][-1] > _CARRIED) or _flickers(found, -1):
        yield _Finding(
            0.0,
            "Correlations of errors between pixels are not interpreted, because the brightness of "
            "the frames changes.",
        )
        return
    last = result.isel(n=-1)
    lowest = last["radius"].values < _LOW
    power, ends = last["error_spectrum"].values[lowest], last["error_spectrum_ci"].values[lowest]
    # Weight each ring by its number of frequencies
    sizes = Rings(result.sizes["y"], result.sizes["x"]).sizes[lowest]
    weight = np.nan_to_num(sizes) / max(float(np.nansum(sizes)), 1.0)
    level = float(weight @ np.nan_to_num(power))
    half = float(np.linalg.norm(weight * np.nan_to_num(ends[:, 1] - power)))
    near = last["error_correlation"]
    beside = tuple(
        float(near.reindex(lag_y=[y], lag_x=[x], fill_value=0.0).squeeze())
        for y, x in ((0, 1), (1, 0))
    )
    have = f"{number(level)} ± {number(half, 2)} times the power of white noise"
    below = f"below {_LOW} cycles per pixel " + (
        f"the errors have {have}" if power.size else "this small image has no frequencies"
    )
    # The error of a power is relative, so its interval is from power / factor to power · factor
    factor = math.exp(min(half / level, 700.0)) if level > 0 else math.inf
    if level < _BLUE and level * factor < 1.0:
        yield _Finding(
            _lost(1.0 - level),
            f"Blue noise, which the eye or a denoiser removes easily: {below}.",
        )
    elif level > _RED and level > factor:
        yield _Finding(
            math.log(level),
            f"Errors of neighboring pixels are correlated: {below}. Possible causes are a wide "
            "reconstruction filter and points shared by pixels.",
        )
    elif half > _UNSURE * level or not power.size:
        yield _Finding(
            0.0, f"These frames cannot decide whether the noise is white between pixels: {below}."
        )
    elif not found["repeat"][-1]:
        white = level < factor and level * factor > 1.0
        yield _Finding(
            0.0, f"The noise is {'white' if white else 'nearly white'} between pixels: {below}."
        )
    if max(map(abs, beside)) > max(_ALIKE, _SURE * found["correlation_error"][-1]):
        yield _Finding(
            _lost(max(map(abs, beside))),
            f"Errors of neighboring pixels have correlation {number(beside[0])} horizontally and "
            f"{number(beside[1])} vertically.",
        )
    if lag := found["repeat"][-1]:
        yield _Finding(
            _lost(abs(found["repeat_correlation"][-1])),
            f"The noise repeats after {lag[1]} pixels horizontally and {lag[0]} vertically "
            f"(correlation {number(found['repeat_correlation'][-1])}): tiles share points or "
            "seeds.",
        )


def frame_table(found: dict[str, Any]) -> html.Table:
    """Return the numbers of `frame_summary` as a table."""
    last = found["samples"][-1]
    others = [name for name in _MEASURES if name in last]
    rows = [
        [
            str(row["n"] or "unknown"),
            str(row["frames"]),
            number(row["picture_variance"]),
            interval(*row["picture_variance_ci"]),
            number(row["median_relative_rmse"]),
            *(number(row[name]) for name in others),
        ]
        for row in found["samples"]
    ]
    caption = "Variance of one frame, averaged over pixels; median of σ / mean over pixels"
    if "mean_flip" in last:
        image = "reference" if "reference" in found else "mean image"
        caption += f"; mean FLIP between one frame and the {image}"
    columns = (*_COLUMNS, *(_MEASURES[name] for name in others))
    return html.table_of(f"{caption}.", columns, rows, words=(), stacked=True)


def filter_table(found: dict[str, Any]) -> html.Table | None:
    """Return the variance after each requested filter, or None."""
    rows = found.get("filtered", [])
    if not rows:
        return None
    columns = ["Filter", "Variance", "95 %", "/ white", "95 %"]
    compared = "picture_ratio" in rows[0]
    columns += ["/ others", "95 %"] if compared else []
    shown = [
        [
            row["filter"],
            *(
                text
                for name in ("variance", "ratio", *(["picture_ratio"] if compared else []))
                for text in (
                    number(row[name]),
                    interval(*row[f"{name}_ci"]),
                )
            ),
        ]
        for row in rows
    ]
    caption = (
        "Variance after a filter, averaged over pixels, and its ratio to what the filter leaves of "
        "white noise of the same variance"
    )
    caption += "; ratio to the filtered variance of the other frames" if compared else ""
    return html.table_of(f"{caption}.", tuple(columns), shown, words=(0,), stacked=True)


def frame_layers(result: xr.Dataset) -> dict[str, Array]:
    """Return EXR layers: the mean image, and maps of quantities for each number of samples."""
    maps = result.drop_vars(
        [n for n in result if not {"y", "x"} <= set(result[n].dims)] + ["image"]
    )
    image = result["image"].values
    return {"": image if image.shape[2] == 3 else image[..., 0], **map_layers(maps)}


def check_frames_packages() -> None:
    """Check that `write_frames` can run, before frames are read.

    Raises
    ------
    MissingDependency
        If the extra ``report`` or OpenEXR is not installed.
    """
    html.check_page_packages("frames,report")
    load_openexr()


def write_frames(result: xr.Dataset, folder: str | Path) -> Path:
    """Write ``frames.exr``, images, ``frames.json`` and ``report.html``. Older files are replaced.

    Parameters
    ----------
    result
        Result of `mcspectra.rendering.frames`.
    folder
        Output folder; created if missing.

    Returns
    -------
    Path
        Path of the page.

    Raises
    ------
    StoreError
        If the folder cannot be written.
    FileFormatError
        If the layers cannot be written.
    MissingDependency
        If the extra ``report`` or OpenEXR is not installed.
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
    after = filter_table(found)
    layer = (("Layer", found["layer"]),) if "layer" in found else ()
    facts = (("Frames", found["frames"]), *layer)
    page = html.Page(
        title=f"Noise of {Path(found['frames']).name}",
        what="frames",
        lead=tuple(html.Paragraph(text=text) for text in said[:1]),
        sections=html.sections_of(
            {
                "Summary": (
                    frame_table(found),
                    *([] if after is None else [after]),
                    *(html.Paragraph(text=text) for text in said[1:]),
                ),
                "Pixels": html.figures_of(plots),
                "Provenance": html.provenance(facts, result.attrs),
            }
        ),
    )
    return html.write_page(page, root / "report.html", root)
