"""Verdict of a gate as sentences, a page, JUnit XML, and annotations on GitHub."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import xarray as xr

from mcspectra.core.display import counted, printable
from mcspectra.core.errors import writing
from mcspectra.plots import kinds
from mcspectra.plots.text import number
from mcspectra.report import page as html

__all__ = [
    "gate_findings",
    "gate_summary",
    "gate_table",
    "github_annotation",
    "write_gate",
    "write_github_summary",
    "write_junit",
]

_COLUMNS = ("Test", "p-value", "Statistic", "Bias that would be found")
_TESTS = {
    "image": "mean of the image",
    "tiles": "largest difference of tiles of {0} × {0} pixels",
    "pixels": "largest difference of pixels",
    "spread": "differences of all tiles of {0} × {0} pixels together",
    "trend": "mean of the image against samples per pixel",
    "noise": "noise of the new frames",
    "filter": "correlation of neighboring errors",
}
_MEANS = ("image", "tiles", "pixels", "spread", "trend")
_MARKS: dict[str, Any] = {"pass": "yes", "fail": "no", "undecided": "none"}
# Ratios of variances outside this range are mentioned
_QUIET, _LOUD = 0.8, 1.25


def gate_summary(result: xr.Dataset) -> dict[str, Any]:
    """Return the attributes and the tests as plain Python data."""
    told = {
        key: json.loads(value) if isinstance(value, str) and value[:1] == "[" else value
        for key, value in result.attrs.items()
    }
    tests = []
    for k, name in enumerate(result["test"].values.tolist()):
        one = result.isel(test=k)
        tests.append(
            {
                "test": str(name),
                "p": float(one["test_p"]),
                "statistic": float(one["test_statistic"]),
                "detectable": float(one["detectable"]),
            }
        )
    return {**told, "tests": tests}


def gate_findings(result: xr.Dataset) -> list[str]:
    """Return sentences: the verdict with its reason, the bias that can be found, and remarks."""
    found = gate_summary(result)
    return [_reason(result, found), *_power(found), *_remarks(found)]


def _reason(result: xr.Dataset, found: dict[str, Any]) -> str:
    """Return the verdict and its reason in one sentence."""
    verdict = found["verdict"]
    if verdict == "undecided":
        why = found.get("why")
        if why:
            return f"Undecided: {why[:1].lower()}{why[1:]}"
        seen = found.get("detectable_image")
        wanted = _percent(found.get("target", 1.0))
        known = "no bias" if seen is None else f"only a bias of {_percent(seen)} or more"
        return (
            f"Undecided: these frames would have shown {known} of the image mean, but {wanted} is "
            "wanted; give more frames, or more samples per pixel."
        )
    if verdict == "pass":
        if found["copy"]:
            return (
                "Pass: the new frames equal the frames of the reference up to rounding, so they "
                "are copies or used the same seeds."
            )
        return (
            f"Pass: no difference is significant (p = {_p(found['p'])} for "
            f"{counted(len(found['tests']), 'test')} together, level {_p(found['level'])})."
        )
    said = [_failure(test, result, found) for test in _failed(found)]
    return f"Fail: {said[0]} (p = {_p(_failed(found)[0]['p'])})."


def _failed(found: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the failed tests: first the image, then other means by p-value, then the noise."""
    order = list(_TESTS)
    failed = [each for each in found["tests"] if each["p"] <= found["level"]]

    def rank(test: dict[str, Any]) -> tuple[bool, bool, float, int]:
        name = test["test"].split()[0]
        place = order.index(name)
        return name not in _MEANS, name != "image", test["p"], place

    return sorted(failed, key=rank)


def _failure(test: dict[str, Any], result: xr.Dataset, found: dict[str, Any]) -> str:
    """Describe a failed test."""
    name, _, size = test["test"].partition(" ")
    if name == "image":
        change = found.get("mean_difference")
        if change is None:
            return "the image means differ"
        if test["p"] <= found["level"] and abs(change) < 1e-7:
            return "a channel of the image has another mean"
        word = "higher" if change > 0 else "lower"
        return f"the image mean is {_percent(abs(change))} {word} than in the reference"
    if name in ("tiles", "pixels"):
        return _place(result, int(size), name)
    if name == "spread":
        each = "pixels" if int(size) == 1 else f"tiles of {size} × {size} pixels"
        return f"many {each} differ from the reference by more than noise"
    if name == "trend":
        spp, change, _ = min(found["trend"], key=lambda row: row[2])
        word = "higher" if change > 0 else "lower"
        return (
            f"at {int(spp)} samples per pixel the image mean is {_percent(abs(change))} {word} "
            f"than at {found['spp_new']}"
        )
    if name == "noise":
        return (
            f"the new frames are noisier: their variance is {number(found['noise_ratio'])} times "
            "the variance of the reference at equal samples"
        )
    return (
        "errors of neighboring pixels are more correlated than in the reference, as after a "
        "denoiser or with a wider reconstruction filter"
    )


def _place(result: xr.Dataset, size: int, name: str) -> str:
    """Describe where the largest difference is, among the most significant tiles."""
    smallest, change = result["smallest_p"].values, result["difference"].values
    finest = int(result.attrs["finest"])
    times = max(size // finest, 1)
    least = smallest <= np.nanmin(smallest) * (1 + 1e-9)
    # Compare tiles of this size by their mean difference, divided by its error
    height, width = (-(-side // times) for side in change.shape)
    padded = np.full((height * times, width * times), np.nan)
    padded[: change.shape[0], : change.shape[1]] = np.where(np.isfinite(change), change, np.nan)
    tiles = padded.reshape(height, times, width, times).swapaxes(1, 2).reshape(height, width, -1)
    count = np.isfinite(tiles).sum(axis=2)
    total, squares = np.nansum(tiles, axis=2), np.nansum(tiles**2, axis=2)
    spread = np.sqrt(np.maximum(squares - total**2 / np.maximum(count, 1), 0.0))
    away = np.abs(total) / np.where((times > 1) & (spread > 0), spread, 1.0)
    rows, columns = np.nonzero(least)
    chosen = np.zeros((height, width), bool)
    chosen[rows // times, columns // times] = True
    row, column = np.unravel_index(int(np.argmax(np.where(chosen, away, -1.0))), away.shape)
    top, left = int(row) * times, int(column) * times
    part = (slice(top, top + times), slice(left, left + times))
    base = float(np.nanmean(result["mean"].values[part]))
    difference = float(np.nanmean(change[part]))
    x, y = left * finest, top * finest
    where = (
        f"at the pixel x = {x}, y = {y}"
        if name == "pixels"
        else f"in the tile x = {x} to {x + size - 1}, y = {y} to {y + size - 1}"
    )
    if base > 0 and abs(difference) < 10 * base:
        word = "higher" if difference > 0 else "lower"
        return f"{where} the mean is {_percent(abs(difference) / base)} {word} than the reference"
    return f"{where} the mean is {number(base + difference)} instead of {number(base)}"


def _power(found: dict[str, Any]) -> Iterator[str]:
    """Describe the smallest bias that the gate would have found.

    Also describe how many samples are needed to find a smaller bias.
    """
    seen, region = found.get("detectable_image"), found.get("detectable_region")
    if seen is None:
        return
    text = f"It would have found a bias of {_percent(seen)} of the image mean"
    if region is not None and region < 10.0:
        text += f", or of {_percent(region)} in a region of 1 % of the image"
    if found["verdict"] == "undecided":
        text = "If the variance falls as 1/n"
    else:
        text += ", with 90 % probability. If the variance falls as 1/n"
    # Choose a power of ten below the detectable bias, and compute the samples that detect it
    wanted = found.get("target")
    if wanted is None or wanted >= seen:
        wanted = 10.0 ** math.floor(math.log10(seen / 1.5))
    times = (seen / wanted) ** 2
    spp = found.get("spp_new")
    give = (
        f"{_rounded(spp * times)} samples per pixel"
        if spp
        else f"{number(times, 2)} times as many samples"
    )
    same = spp == found.get("spp_reference")
    both = "in both sets" if same else "and a reference of as many more"
    yield f"{text}, a bias of {_percent(wanted)} needs {give} {both}."


def _percent(fraction: float) -> str:
    """Return a fraction as a percentage with two digits."""
    return f"{number(100.0 * fraction, 2)} %"


def _p(value: float) -> str:
    """Return a p-value or a level with two digits."""
    return f"{value:.2g}"


def _rounded(count: float) -> str:
    """Round up to two digits, with commas between thousands."""
    step = 10 ** max(math.floor(math.log10(count)) - 1, 0)
    return f"{math.ceil(count / step) * step:,}"


def _remarks(found: dict[str, Any]) -> Iterator[str]:
    """Yield sentences about other failed tests, the method, and the tests that were omitted."""
    others = _failed(found)[1:] if found["verdict"] == "fail" else []
    sizes: dict[str, list[int]] = {}
    for each in others:
        name, _, size = each["test"].partition(" ")
        sizes.setdefault(name, []).append(int(size or 0))
    if sizes:
        yield f"Also significant: {'; '.join(_listed(*each) for each in sizes.items())}."
    yield from found.get("notes") or []
    frames = f"{found['frames_new']} + {found['frames_reference']} frames"
    method = found["method"]
    if method == "t tests":
        yield (
            f"{frames} have too few relabelings for an exact test at level "
            f"{_p(found['level'])}, so t tests compare the image and wide tiles only; 5 + 5 "
            "frames are enough for the level 0.01."
        )
    elif method.startswith("t tests"):
        what = "noise" if "noise" in method else "numbers of samples per pixel"
        yield (
            f"The two sets have different {what}, so Welch's t tests compare the image and wide "
            "tiles only" + ("." if "noise" in method else "; the noise is not compared.")
        )
    if method.startswith("t tests") and not any(t["test"][:5] == "tiles" for t in found["tests"]):
        yield "Tiles are not tested, because their noise is too skewed for these numbers of frames."
    ratio = found.get("noise_ratio")
    if ratio and found["spp_new"] == found["spp_reference"] and not _QUIET < ratio < _LOUD:
        yield f"The variance of the new frames is {number(ratio)} times that of the reference."
    if found["method"] != "none" and found["spp_new"] is None and found["spp_reference"] is None:
        yield "The numbers of samples per pixel are not known and are assumed equal."
    if found["finest"] > 1 and found["method"] != "none":
        yield (
            f"The finest tested tiles have {found['finest']} × {found['finest']} pixels; "
            "smaller errors are only found if they change the mean of such a tile."
        )
    missing = found["missing_new"], found["missing_reference"]
    if any(missing):
        yield (
            f"Pixels excluded because a frame is NaN or infinite there: {missing[0]} in the new "
            f"frames, {missing[1]} in the reference."
        )


def _described(test: str) -> str:
    name, _, size = test.partition(" ")
    if test == "spread 1":
        return "differences of all pixels together"
    return _TESTS[name].format(size)


def _listed(name: str, sizes: list[int]) -> str:
    """Describe together the tests of one kind that failed at several sizes."""
    if name not in ("tiles", "spread"):
        return _TESTS[name]
    wide = ", ".join(str(size) for size in sorted(sizes) if size > 1)
    parts = (["pixels"] if 1 in sizes else []) + ([f"tiles of {wide} pixels"] if wide else [])
    of = "largest difference of" if name == "tiles" else "differences of all"
    return f"{of} {' and of '.join(parts)}"


def gate_table(found: dict[str, Any]) -> html.Table:
    """Return the tests of `gate_summary` as a table."""
    rows = [
        [
            _described(each["test"]),
            _p(each["p"]),
            number(each["statistic"]),
            _percent(each["detectable"]) if math.isfinite(each["detectable"]) else "—",
        ]
        for each in found["tests"]
    ]
    caption = "p-values are corrected for all tests together. Statistics are in standard errors."
    known = any(math.isfinite(each["detectable"]) for each in found["tests"])
    if known:
        caption += " The last column is the relative bias that is found with 90 % probability."
    shown = len(_COLUMNS) - (not known)
    return html.table_of(caption, _COLUMNS[:shown], [row[:shown] for row in rows], stacked=True)


def write_gate(result: xr.Dataset, folder: str | Path) -> Path:
    """Write ``report.html``, ``gate.json`` and the figures. Older files are replaced.

    Parameters
    ----------
    result
        Result of `mcspectra.rendering.gate`.
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
    MissingDependency
        If the extra ``report`` is not installed.
    """
    html.check_page_packages("frames,report")
    root = Path(folder)
    found, said = gate_summary(result), gate_findings(result)
    html.write_json(root / "gate.json", {**found, "findings": said})
    tested = found["method"] not in ("none", "comparison")
    plots = {
        kind.replace("-", "_"): kinds.describe(kind, result)
        for kind in kinds.kinds_of(result)
        if kind.startswith("gate-") and tested
    }
    facts = (
        ("New", f"{found['new']}, {_frames(found, 'new')}"),
        ("Reference", f"{found['reference']}, {_frames(found, 'reference')}"),
        ("Method", found["method"]),
        ("Level", _p(found["level"])),
    )
    sections: dict[str, Any] = {
        "Verdict": tuple(html.Paragraph(text=text) for text in said[1:]),
        "Where": html.figures_of(plots),
        "Tests": (gate_table(found),) if found["tests"] else (),
        "Provenance": html.provenance(facts, result.attrs),
    }
    page = html.Page(
        title=f"Gate: {found['verdict']}",
        what="gate",
        lead=(html.Paragraph(text=said[0], kind="answer"),),
        sections=html.sections_of(sections),
    )
    return html.write_page(page, root / "report.html", root)


def _frames(found: dict[str, Any], which: str) -> str:
    spp = found.get(f"spp_{which}")
    count = f"{found[f'frames_{which}']} frames"
    return count if spp is None else f"{count} of {spp} samples per pixel"


def write_junit(result: xr.Dataset, file: str | Path) -> Path:
    """Write the tests as JUnit XML. ``fail`` becomes a failure, and ``undecided`` a skipped test.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    found, said = gate_summary(result), gate_findings(result)
    verdict, path = found["verdict"], Path(file)
    cases = [(_described(each["test"]), each) for each in found["tests"]]
    failed = {each["test"] for each in _failed(found)} if verdict == "fail" else set()
    suite = ET.Element(
        "testsuite",
        name="mcspectra gate",
        tests=str(len(cases) + 1),
        failures=str(len(failed) + (verdict == "fail")),
        skipped=str(int(verdict == "undecided")),
        errors="0",
    )

    def case(name: str) -> ET.Element:
        return ET.SubElement(suite, "testcase", classname="mcspectra.gate", name=name)

    whole = case("verdict")
    kind = {"fail": "failure", "undecided": "skipped"}.get(verdict)
    if kind is not None:
        ET.SubElement(whole, kind, message=printable(said[0], 2000))
    ET.SubElement(whole, "system-out").text = printable("\n".join(said), lines=True)
    for name, each in cases:
        own = case(name)
        if each["test"] in failed:
            text = f"{_failure(each, result, found)} (p = {_p(each['p'])})"
            ET.SubElement(own, "failure", message=printable(text, 2000))
    suites = ET.Element("testsuites")
    suites.append(suite)
    ET.indent(suites)
    with writing(path):
        path.write_bytes(ET.tostring(suites, encoding="utf-8", xml_declaration=True))
    return path


def github_annotation(result: xr.Dataset) -> str:
    """Return the verdict as a command of a GitHub workflow; GitHub shows it next to the run."""
    kind = {"pass": "notice", "fail": "error", "undecided": "warning"}[result.attrs["verdict"]]
    text = printable(" ".join(gate_findings(result)[:2]), 2000)
    for letter, code in (("%", "%25"), ("\r", "%0D"), ("\n", "%0A")):
        text = text.replace(letter, code)
    return f"::{kind} title=mcspectra gate::{text}"


def write_github_summary(result: xr.Dataset) -> Path | None:
    """Append findings and tests as Markdown to the summary page of a GitHub workflow, if it runs.

    The path is the environment variable ``GITHUB_STEP_SUMMARY``.
    """
    place = os.environ.get("GITHUB_STEP_SUMMARY")
    if not place:
        return None
    found, said = gate_summary(result), gate_findings(result)
    table = gate_table(found)

    def row(cells: Any) -> str:
        return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"

    lines = [f"### mcspectra gate: {found['verdict']}", "", *said, ""]
    if found["tests"]:
        lines += [row(table.columns), row("---" for _ in table.columns)]
        lines += [row(cell.text for cell in cells) for cells in table.rows]
    path = Path(place)
    with writing(path), path.open("a", encoding="utf-8") as stream:
        stream.write(printable("\n".join(lines), lines=True) + "\n")
    return path
