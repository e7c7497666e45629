"""Write a variance map: EXR layers, images, numbers and one self-contained page."""

from __future__ import annotations

import json
import math
import shlex
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array
from mcspectra.plots import kinds
from mcspectra.plots.groups import along
from mcspectra.plots.maps import STRATEGIES, bounce_name, worst_pixels
from mcspectra.plots.text import MISSING, number, percent, rate
from mcspectra.rendering.files import write_exr
from mcspectra.rendering.maps import missed
from mcspectra.rendering.scenes import SCENES, sized
from mcspectra.report import page as html

__all__ = [
    "map_layers",
    "map_note",
    "map_sentences",
    "map_summary",
    "map_table",
    "page_seconds",
    "subset_note",
    "write_map",
]

_TELLING = 0.1  # a cause is named if it applies to more than this share of the pixels
_DRAWN = 512  # longest side of a map that is drawn to estimate the time of a page
_COLUMNS = {
    "mean": "Mean",
    "variance": "Variance",
    "rate": "Rate",
    "rate_se": "Standard error of the rate",
    "predicted_ratio": "Predicted / measured",
    "predicted_within_ci": "Pixels whose interval holds 1",
}


_TOLD = 0.005  # smallest share of the variance that is named in a sentence
_METHODS = {
    "strata": "quadrature within the strata",
    "random": "∫g²",
    "spectrum": "the power spectrum on the torus",
    "gains": "gains by level",
}
"""Names of prediction methods, by the value of the attribute ``prediction``."""

_CAUSES = {
    "bounce": "Variance of one path that first appears with the random numbers of a bounce (the "
    "increase of the cumulative Sobol' index): its share of the image's variance, its median share "
    "over pixels, and the share of pixels at which it is the largest (by 95 % intervals).",
    "decision": "Variance of one path that first appears with a decision, summed over all bounces.",
}
"""Captions of the tables of variance shares."""

_PROVENANCE = {
    "scene": "Scene",
    "integrator": "Integrator",
    "dims": "Dims",
    "joint_dims": "Joint dims",
    "sampler": "Sampler",
    "seed": "Seed",
    "realizations": "Realizations",
    "light": "Light",
    "heuristic": "Heuristic",
    "channel": "Channel",
    "points": "Points of the pixels",
    "smoothing": "Smoothing",
    "camera": "Camera",
    "size": "Size, pixels",
    "crop": "Crop: x, y, width, height",
    "prediction": "Prediction",
    "pixels_measured": "Pixels measured",
}
"""Attributes of a map that its page shows, and their labels."""


def write_map(result: xr.Dataset, folder: str | Path) -> Path:
    """Write ``maps.exr``, ``*.png``, ``map.json`` and ``report.html``. Older files are replaced.

    Parameters
    ----------
    result
        Result of `mcspectra.rendering.variance_map`.
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
        If the extra ``report`` is not installed.
    """
    html.check_page_packages()
    root = Path(folder)
    summary = map_summary(result)
    html.write_json(root / "map.json", summary)
    write_exr(root / "maps.exr", map_layers(result), comment=json.dumps(result.attrs))

    # Assemble the page
    known = result.attrs
    x0, y0, width, height = summary["crop"]
    counts = ", ".join(map(str, summary["counts"]))
    each = "paths" if "path" in result["strategy"].values else "of each technique"
    settings = (
        f"{width} × {height} pixels from ({x0}, {y0}), sampler {known['sampler']}, "
        f"n = {counts} {each}, {known['realizations']} realizations, {known['points']} points."
    )
    sentences = tuple(html.Paragraph(text=text) for text in _sentences(summary))
    last = str(result["strategy"].values[-1])
    first = f" by {result['sampler'].values[0]}" if "sampler" in result.dims else ""
    worst = html.table_of(
        f"Pixels with the largest variance, {STRATEGIES.get(last, last)}{first} at n = "
        f"{summary['counts'][-1]}, their share of the image's variance, and the command that "
        "analyzes the pixel.",
        ("Pixel", "Variance", "Share of all", "Command"),
        [_worst_row(each, known, root) for each in summary["worst_pixels"]],
        stacked=True,
    )
    causes = tuple(
        html.table_of(
            caption,
            (kind.capitalize(), "Share of all", "Median share", "Largest at"),
            [(name, *map(percent, row.values())) for name, row in summary[f"{kind}s"].items()],
            stacked=True,
        )
        for kind, caption in _CAUSES.items()
        if f"{kind}s" in summary
    )
    shown = [each for each in kinds.kinds_of(result) if each.startswith("map-")]
    plots = {
        kind.removeprefix("map-").replace("-", "_"): kinds.describe(kind, result)
        for kind in sorted(shown, key=lambda each: each != "map-picture")
    }
    picture = {kind: plots.pop(kind) for kind in ("picture",) if kind in plots}
    own = ((name, summary[key]) for key, name in _PROVENANCE.items() if key in known)
    facts = ((name, ", ".join(map(str, v)) if isinstance(v, list) else str(v)) for name, v in own)
    page = html.Page(
        title=f"Variance map of {Path(known['scene']).name}",
        what="map",
        lead=(
            *([html.Paragraph(text=subset_note(summary))] if "subset" in summary else []),
            *([html.Paragraph(text=summary["answer"])] if "answer" in summary else []),
            html.Paragraph(text=settings, kind="soft"),
        ),
        sections=html.sections_of(
            {
                "Summary": (*html.figures_of(picture), map_table(summary), *sentences),
                "Where the variance comes from": causes,
                "Worst pixels": (worst,) if worst.rows else (),
                "Maps": html.figures_of(plots),
                "Provenance": html.provenance(facts, known),
            }
        ),
    )
    return html.write_page(page, root / "report.html", root)


def page_seconds(figures: int, size: tuple[int, int]) -> float:
    """Estimate the seconds to write a page with this number of maps, from drawing one map twice."""
    from mcspectra.plots.backend_matplotlib import draw, encode

    height, width = (min(side, _DRAWN) for side in size[::-1])
    y, x = np.mgrid[:height, :width]
    values = (1.0 + x + y)[None]
    place = ("strategy", "y", "x")
    made = xr.Dataset(
        {"mean": (place, values), "rate": (place, values)},
        {"strategy": ["path"], "y": np.arange(height), "x": np.arange(width)},
    )
    spent = []
    for _ in range(2):  # the first drawing also loads fonts
        start = time.perf_counter()
        encode(draw(kinds.describe("map-mean", made)))
        spent.append(time.perf_counter() - start)
    return spent[0] + figures * spent[1]


def map_table(summary: Mapping[str, Any]) -> html.Table:
    """Return a table of the medians per strategy. Its caption is the text of `map_note`."""
    rows = summary["strategies"]
    columns = ("Strategy", *(_COLUMNS[name] for name in next(iter(rows.values()))))
    shown = [(_named(name), *_shown_numbers(row)) for name, row in rows.items()]
    return html.table_of(map_note(summary), columns, shown, stacked=True)


def _worst_row(
    pixel: Mapping[str, Any], known: Mapping[str, Any], root: Path
) -> tuple[html.TableCell | str, ...]:
    """Return the table row of a pixel: the command to analyze it, and a link to its page if any."""
    x, y = pixel["x"], pixel["y"]
    page = f"pixel-{x}-{y}/report.html"
    scene, film = known["scene"], known["size"] == known.get("film")
    if not film and scene.partition("(")[0] in SCENES:
        width, height = json.loads(known["size"])
        scene, film = sized(scene, width=width, height=height), True
    command = f"mcspectra pixel {shlex.quote(scene)} {x} {y}"
    if known.get("integrator", "direct light") != "direct light":
        command += f" --integrator {shlex.quote(known['integrator'])}"
    command += f" --out {shlex.quote(str(root / Path(page).parent))}"
    why = ""
    if scene == "dict" or not film:
        command = MISSING
        why = "The scene is not a file, or the size of the map differs from the size of its film."
    return (
        html.TableCell(
            text=f"({x}, {y})", numeric=False, link=page if (root / page).is_file() else ""
        ),
        number(pixel["variance"]),
        percent(pixel["share"]),
        html.TableCell(text=command, why=why, numeric=False),
    )


def map_layers(result: xr.Dataset) -> dict[str, Array]:
    """Return all images of a map by name: ``variance.light.n16``, ``mis_gain_ci.low``, …

    Returns
    -------
    dict
        Arrays (y, x) by name, with NaN where a value is missing.
    """
    return {
        str(name): values
        for variable in result.data_vars
        for name, values in _layers(str(variable), result[variable])
    }


def _layers(name: str, data: xr.DataArray) -> Iterator[tuple[str, Array]]:
    """Yield a layer for each combination of sampler, strategy, bounce and count.

    An interval gives two layers: an image of all lower ends, and an image of all upper ends.
    """
    outer = next((dim for dim in data.dims if dim not in ("y", "x")), None)
    if outer is None:
        yield name, data.values
        return
    for label in data[outer].values.tolist():
        part = f"n{label}" if outer == "n" else str(label)
        yield from _layers(f"{name}.{part}", data.sel({outer: label}))


def map_summary(result: xr.Dataset) -> dict[str, Any]:
    """Return medians over pixels by strategy, fractions of pixels, and the provenance.

    With several samplers, the entry of a strategy is called "STRATEGY, SAMPLER".
    All other entries describe the first sampler, except the entry about the best sampler.
    """
    subset = _subset(result)
    if subset:
        # Interpolated pixels are less noisy than measured ones, and are left out
        result = result.where(result["measured"] == 1.0)
    whole, several, parts = result, "sampler" in result.dims, list(along(result, "sampler"))
    strategies = {
        f"{strategy}, {name}" if several else str(strategy): _strategy_summary(
            each.sel(strategy=strategy).isel(n=-1)
        )
        for name, each in parts
        for strategy in result["strategy"].values
    }
    if several:
        result = parts[0][1].assign_attrs(sampler=parts[0][0])
    last = result.isel(n=-1)
    found: dict[str, Any] = {**result.attrs, "counts": result["n"].values.tolist()}
    found |= {name: json.loads(found[name]) for name in ("size", "crop") if name in found}
    found |= {"subset": subset} if subset else {}
    found["strategies"] = strategies
    for name in ("bottleneck", "dominant_technique"):
        if name in result:
            labels = {"light": 0, "bsdf": 1, "undecided": -1}
            found[name] = {k: _share(result[name].values, v) for k, v in labels.items()}
    if "mis_gain" in result:
        low, high = (result["mis_gain_ci"].sel(bound=b).values for b in ("low", "high"))
        known = max(int(np.isfinite(low).sum()), 1)
        found["mis_gain"] = {
            "median": _median(result["mis_gain"].values),
            "above_1": float((low > 1).sum() / known),
            "below_1": float((high < 1).sum() / known),
        }
        light, bsdf = (last["variance"].sel(strategy=s).values for s in ("light", "bsdf"))
        found["light_suffices"] = float(((high < 1) & (light < bsdf)).sum() / known)
        if strategies.keys() >= {"light", "bsdf", "mis"}:
            found["answer"] = _answer(last, found)
    for kind in ("bounce", "decision"):
        if kind in result.dims:
            found[f"{kind}s"] = _causes(result, kind)
    if "best_sampler" in whole:
        labels = {"no difference": -1} | {str(v): k for k, v in enumerate(whole["sampler"].values)}
        found["best_sampler"] = {
            str(strategy): {
                name: _share(whole["best_sampler"].sel(strategy=strategy).values, label)
                for name, label in labels.items()
            }
            for strategy in whole["strategy"].values
        }
    if "best_sampler" in whole and "answer" not in found:
        found["answer"] = _sampler_answer(whole.isel(strategy=-1, n=-1), found)
    # List the pixels at which the last strategy has the largest variance, at the largest n
    variance = result["variance"].isel(strategy=-1, n=-1).values
    part = subset["measured"] / subset["pixels"] if subset else 1.0
    found["worst_pixels"] = [
        {
            "x": int(result["x"][column]),
            "y": int(result["y"][row]),
            "variance": float(variance[row, column]),
            "share": part * float(variance[row, column]) / float(np.nansum(variance)),
        }
        for row, column in worst_pixels(result)
    ]
    return found


def _subset(result: xr.Dataset) -> dict[str, float]:
    """Return the number of measured pixels, of all pixels, and a factor for interpolation errors.

    Variances may be wrong by this factor; its median over all interpolated pixels is returned.
    The interpolation factor is that of the last strategy and the first sampler.
    """
    if "measured" not in result:
        return {}
    measured = result["measured"].values == 1.0
    factor = result["interpolation_factor"].isel(strategy=-1)
    factor = factor.isel(sampler=0) if "sampler" in factor.dims else factor
    return {
        "measured": int(measured.sum()),
        "pixels": measured.size,
        "interpolation_factor": _median(factor.values[~measured]),
    }


def subset_note(summary: Mapping[str, Any]) -> str:
    """Return the sentences on the measured pixels and the error of interpolation, if any."""
    subset = summary.get("subset")
    if subset is None:
        return ""
    count, total = subset["measured"], subset["pixels"]
    factor = subset["interpolation_factor"]
    measured = f"{count:,} of {total:,} pixels ({percent(count / total)})"
    told = (
        "the error of interpolation is unknown, because too few pixels have a variance."
        if not math.isfinite(factor)
        else f"the interpolated variance is typically off by at most a factor of {number(factor)} "
        "(95 %, by leaving pixels out)."
    )
    return (
        f"A map of a subset: {measured} are measured, one at random in each stratum of the image. "
        f"All others are interpolated: {told}"
    )


def _causes(result: xr.Dataset, kind: str) -> dict[str, dict[str, float]]:
    """Return the share of the variance due to each bounce or decision, for image and pixels."""
    shares, weights = result[f"{kind}_share"], result["path_variance"]
    total = float(weights.where(shares.notnull().all(kind)).sum())
    found = {}
    for k, label in enumerate(result[kind].values.tolist()):
        own = shares.isel({kind: k})
        found[bounce_name(label) if kind == "bounce" else label] = {
            "share": float((own * weights).sum()) / total if total > 0 else math.nan,
            "median": _median(own.values),
            "largest": _share(result[f"largest_{kind}"].values, k),
        }
    return found


def _named(strategy: str) -> str:
    """Return the name of a strategy in words, and its sampler if there are several samplers."""
    name, comma, sampler = strategy.partition(", ")
    return f"{STRATEGIES.get(name, name)}{comma}{sampler}"


def _answer(last: xr.Dataset, found: Mapping[str, Any]) -> str:
    """Name the strategy that has the least variance at most pixels, for equal total samples.

    At a pixel, MIS is best if its gain over the better single strategy exceeds 1.
    At a given n, MIS takes n samples with each of two strategies, so 2 n samples in total.
    """
    names = ("light", "bsdf")
    singles = np.stack([last["variance"].sel(strategy=name).values for name in names])
    gain = last["mis_gain"].values
    known = np.isfinite(singles).all(axis=0) & np.isfinite(gain)
    if not known.any():
        return "No strategy is recommended: no pixel has measurements of all strategies."
    # Exclude strategies that significantly miss light
    three = last.sel(strategy=[*names, "mis"]).transpose("strategy", "y", "x", ...)
    rows = {name: k for k, name in enumerate((*names, "mis"))}
    lost = missed(rows, three["mean"].values, three["mean_se"].values, found["realizations"])
    singles[lost[:2]] = np.inf
    better = (gain > 1.0) | np.isinf(singles).all(axis=0)
    best = np.where(better, 2, np.argmin(singles, axis=0))[known]
    shares = dict(zip((*names, "mis"), np.bincount(best, minlength=3) / best.size, strict=True))
    first, *others = sorted(shares, key=lambda name: -shares[name])
    rest = "".join(
        f", {STRATEGIES[name]} at {percent(shares[name])}" for name in others if shares[name]
    )
    met = np.isfinite(singles).all(axis=0)
    errors = ", ".join(
        f"{STRATEGIES[k]} {number(_median(last['variance'].sel(strategy=k).values[met]) ** 0.5)}"
        for k in shares
    )
    where = "" if met[known].all() else ", at pixels where no strategy misses light"
    text = (
        f"Use {STRATEGIES[first]} with {found['sampler']}: for equal total samples it has the "
        f"least variance at {percent(shares[first])} of the pixels{rest}. Median RMSE at n = "
        f"{found['counts'][-1]} of each technique{where}: {errors}."
    )
    slow = found.get("bottleneck", {})
    worse = max(names, key=lambda name: slow.get(name, 0.0))
    if slow.get(worse, 0.0) > _TELLING:
        text += (
            f" Cause: {STRATEGIES[worse]} has the slower rate in MIS at {percent(slow[worse])} of "
            "the pixels."
        )
    return text


def _sampler_answer(last: xr.Dataset, found: Mapping[str, Any]) -> str:
    """Name the best sampler, and the bounce and the decision that add most variance.

    A recommended sampler is significantly the best at more pixels than any other sampler.
    The recommended sampler also has the least geometric mean of the variance over the pixels.
    """
    names = list(map(str, last["sampler"].values))
    shares = found["best_sampler"][str(last["strategy"].item())]
    best = max(names, key=lambda name: shares[name])
    variances = np.stack([last["variance"].sel(sampler=name).values for name in names])
    known = np.isfinite(variances).all(axis=0) & (variances > 0.0).all(axis=0)
    at = f"at n = {found['counts'][-1]}"
    if not known.any():
        return f"Keep {names[0]}: no pixel has a variance with all samplers {at}."
    logs = dict(zip(names, np.log(variances[:, known]).mean(axis=1), strict=True))
    least = min(names, key=lambda name: logs[name])
    sure = ", ".join(f"{name} at {percent(shares[name])}" for name in names if shares[name])
    even = percent(shares["no difference"])
    told = (
        f"Surely least variance {at}: {sure or 'no sampler'}; no difference at {even} of the "
        "pixels."
    )

    def larger(name: str, other: str) -> str:
        """Compare two samplers by the geometric means of their variances over the pixels."""
        more = math.expm1(logs[name] - logs[other])
        return f"{percent(abs(more))} {'more' if more > 0.0 else 'less'} variance than {other}"

    if not any(shares[name] for name in names):
        text = f"Keep {names[0]}: at no pixel a sampler has significantly less variance. {told}"
    elif best != least:
        text = (
            f"No sampler is best everywhere, so keep {names[0]}. {told} But {best} has "
            f"{larger(best, least)} in the geometric mean over pixels."
        )
    else:
        verb = "Keep" if best == names[0] else "Use"
        other = min((name for name in names if name != best), key=lambda name: logs[name])
        text = f"{verb} {best}: {larger(best, other)} in the geometric mean over pixels. {told}"
    makes = [
        f"{max(rows, key=lambda name: rows[name]['share'])} "
        f"({percent(max(row['share'] for row in rows.values()))})"
        for rows in (found.get("bounces"), found.get("decisions"))
        if rows
    ]
    return f"{text} Cause: most variance comes from {' and from '.join(makes)}." if makes else text


def map_note(summary: Mapping[str, Any]) -> str:
    """Describe the numbers of `map_summary`, and warn if pixels have correlated errors."""
    paths = any(name.partition(",")[0] == "path" for name in summary["strategies"])
    seen = "" if paths else " that show a lit surface"
    which = "measured pixels" if "subset" in summary else "pixels"
    note = (
        f"Medians over the {summary['pixels_measured']} {which}{seen}; mean and "
        f"variance at n = {summary['counts'][-1]}."
    )
    if summary.get("prediction") in _METHODS:
        note += (
            f" Predicted by {_METHODS[summary['prediction']]}; each pixel's 95 % interval includes "
            "the errors of the prediction and of the measurement."
        )
    rows = {name: row["mean"] for name, row in summary["strategies"].items() if "mis-" not in name}
    lost = [_named(name) for name, mean in rows.items() if mean < 0.5 * max(rows.values())]
    if lost:
        note += (
            f" Half of the light or more is missed by {' and '.join(lost)}, as the means show: the "
            "variances of these strategies are too small."
        )
    if summary["points"] == "own":
        return note
    return (
        f"{note} All pixels share the same points, so their errors are correlated: a median or "
        "share over pixels is not more certain than one pixel."
    )


def map_sentences(result: xr.Dataset) -> Iterator[str]:
    """Yield the findings of a map: answer, medians of the strategies, explanations, and causes."""
    summary = map_summary(result)
    if "subset" in summary:
        yield subset_note(summary)
    if "answer" in summary:
        yield summary["answer"]
    for strategy, row in summary["strategies"].items():
        shown = dict(zip(row, _shown_numbers(row), strict=True))
        name = _named(strategy)
        yield f"{name[:1].upper()}{name[1:]}: variance {shown['variance']}, rate {shown['rate']}."
    yield map_note(summary)
    yield from _sentences(summary)


def _shown_numbers(row: Mapping[str, float]) -> list[str]:
    """Format the numbers of a strategy. If a rate is not resolved, a word replaces it."""
    slope, half = row["rate"], 2.0 * row["rate_se"]
    known = rate(slope, slope - half, slope + half).partition(" ")[0]
    shown = {name: percent if name.endswith("within_ci") else number for name in row}
    return [known if name == "rate" else shown[name](value) for name, value in row.items()]


def _strategy_summary(data: xr.Dataset) -> dict[str, float]:
    found = {name: _median(data[name].values) for name in ("mean", "variance", "rate", "rate_se")}
    if "predicted_ratio" in data:
        low, high = (data["predicted_ratio_ci"].sel(bound=b).values for b in ("low", "high"))
        known = max(int(np.isfinite(low).sum()), 1)
        found["predicted_ratio"] = _median(data["predicted_ratio"].values)
        found["predicted_within_ci"] = float(((low <= 1) & (high >= 1)).sum() / known)
    return found


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def _share(values: Array, label: int) -> float:
    known = values[np.isfinite(values)]
    return float((known == label).mean()) if known.size else float("nan")


def _sentences(summary: Mapping[str, Any]) -> Iterator[str]:
    """Yield sentences on parts of the scene that were not measured, and on the results.

    Most results are shares of the pixels, or shares of the variance, in percent.
    """
    if summary.get("scene_note"):
        yield summary["scene_note"]
    if summary.get("padding"):
        yield summary["padding"]
    if math.isfinite(summary.get("bottleneck", {}).get("bsdf", math.nan)):
        share = summary["bottleneck"]
        yield (
            f"The BSDF share of MIS has the slower rate in {percent(share['bsdf'])} of the pixels, "
            f"the light share in {percent(share['light'])}. In {percent(share['undecided'])} the "
            "95 % interval of the difference contains 0."
        )
    for kind in ("bounces", "decisions"):
        if kind in summary:
            parts = {k: v["share"] for k, v in summary[kind].items() if v["share"] >= _TOLD}
            told = ", ".join(
                f"{k} ({percent(v)})" for k, v in sorted(parts.items(), key=lambda p: -p[1])
            )
            yield f"Shares of the image's variance by {kind[:-1]}: {told or 'unknown'}."
    for strategy, shares in summary.get("best_sampler", {}).items():
        told = ", ".join(f"{k} ({percent(v)})" for k, v in shares.items())
        yield (
            f"Sampler with the least variance, {_named(strategy)} at n = {summary['counts'][-1]}, "
            f"by share of the pixels: {told}."
        )
    if "mis_gain" in summary:
        gain = summary["mis_gain"]
        yield (
            f"For equal total samples MIS has significantly less variance than the better single "
            f"strategy in {percent(gain['above_1'])} of the pixels, and significantly more in "
            f"{percent(gain['below_1'])}. In the median pixel, the better strategy has "
            f"{number(gain['median'])} times the variance of MIS. Light sampling alone is "
            f"significantly better than MIS in {percent(summary['light_suffices'])} of the pixels."
        )
