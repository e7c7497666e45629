"""Report the noise of whole paths at a pixel, as a page, tables, sentences and JSON numbers."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from mcspectra.core.display import between
from mcspectra.improve.answers import Answer, CandidateResult
from mcspectra.measure.anova import EFFECTIVE_SHARE
from mcspectra.plots.kinds import describe
from mcspectra.plots.text import interval, number, percent, rate, typeset
from mcspectra.report import page as html
from mcspectra.report.pixel_page import picture_of, remedies_blocks, remedies_summary
from mcspectra.report.sentences import answer

__all__ = [
    "path_answer",
    "path_sentences",
    "path_summary",
    "path_tables",
    "write_path",
]

_TOGETHER = 0.3  # interactions with a smaller share of the variance are not reported
_NEARLY_ALL = 0.95  # above this share, interactions are the only cause that is named
_SHOWN = 0.005  # smallest share of the variance that is named
_CHARGED = ("order", "roulette", "selection")  # kinds of changes that affect the cost of paths
_ABOUT_CHARGED = (
    "Costs are counted in random numbers: each turn of the integrator's loop (a ray and at most "
    "one shadow ray) uses the same number of them. A change that needs a pilot run is charged for "
    "it: the set-up as given may use the pilot's paths for its estimate. The listed variance "
    "leaves out the pilot's cost."
)
_TABLES = {
    # Column headers and caption of each table; empty columns at the end are dropped
    "Rates": (
        ("Sampler", "Rate", "n", "Variance", "95 % interval", "Predicted"),
        "Rates are exponents of variance in n (random sampling: −1), ± half their 95 % interval.",
    ),
    "Parts of the variance": (
        ("Part", "First-order index", "Total index", "Cumulative index"),
        (
            "Sobol' indices: shares of the variance of one random path by the bounce or decision "
            "that uses the random numbers, in their order. First-order: alone. Total: with all "
            "interactions; these overlap. Cumulative: of all numbers up to here. Shares of 0 are "
            "omitted."
        ),
    ),
    "Lights": (
        ("Light", "Share", "95 % interval", "Mean", "Chosen", "Better chosen"),
        (
            "Share: Cov(light's part, path) / variance of one random path. Shares sum to 1; a "
            "share is negative if the light is visible when others are not. Mean: the light's part "
            "of the mean. Chosen: probability of choosing the light. Better chosen: probability in "
            "proportion to the root of the second moment of the light's part; a twentieth is "
            "spread evenly."
        ),
    ),
}


def path_tables(tree: xr.DataTree) -> dict[str, html.Table]:
    """Return the non-empty tables by title: rates, parts of the variance, and shares of lights.

    Parameters
    ----------
    tree
        Result of `mcspectra.studies.analyse_path`.
    """
    curves, last = tree["convergence"].to_dataset(), {"n": -1}
    rows: dict[str, list[list[str]]] = {title: [] for title in _TABLES}
    for sampler in curves["sampler"].values.tolist():
        one = curves.sel(sampler=sampler)
        at = one.isel(last)
        rows["Rates"].append(
            [sampler, rate(float(one["rate"]), *one["rate_ci"].values.tolist()), str(int(at["n"])),
             number(float(at["variance"])), interval(*at["variance_ci"].values.tolist())]
        )  # fmt: skip
        if "predict" in tree.children:
            known = tree["predict"].to_dataset().sel(sampler=sampler).isel(last)
            rows["Rates"][-1].append(number(float(known["predicted_variance"])))
    for kind in ("bounce", "decision"):
        found = _parts(tree, kind)
        names = found["axis_label"].values.tolist()
        columns = [found[v].values for v in ("anova_share", "total_share", "truncation_share")]
        columns[0] = columns[0][: len(names)]
        shown = list(zip(names, *columns, strict=True))
        # A kind of decision, such as the choice of a light, recurs at many bounces of a path.
        # Decisions therefore have no order, and the table shows no cumulative share for them
        if kind == "decision":
            shown = [(name, alone, total, np.nan) for name, alone, total, _ in shown]
        for name, *shares in shown:
            if not np.nan_to_num(shares[:2]).any():
                continue
            texts = ["" if np.isnan(share) else percent(float(share)) for share in shares]
            rows["Parts of the variance"].append([name, *texts])
    if "lights" in tree.children:
        lights = tree["lights"].to_dataset()
        for light in lights["light"].values[np.argsort(-lights["light_share"].values)]:
            one = lights.sel(light=light)
            ends = interval(*(100.0 * one["light_share_ci"].values).tolist())
            chosen = (percent(float(one[f"light_{v}"])) for v in ("probability", "selection"))
            rows["Lights"].append(
                [str(light), percent(float(one["light_share"])), f"{ends} %",
                 number(float(one["light_mean"])), *chosen]
            )  # fmt: skip
    return {
        title: html.table_of(caption, columns[: len(found[0])], found, stacked=True)
        for (title, found), (columns, caption) in zip(rows.items(), _TABLES.values(), strict=True)
        if found
    }


def path_answer(tree: xr.DataTree) -> str:
    """Recommend a set-up for these paths, and name the cause of the noise."""
    curves, said = tree["convergence"].to_dataset(), dict(path_sentences(tree))
    if "noise" in said:
        return said["noise"]
    why = said.get("by decision", said.get("by bounce", ""))
    if "remedies" not in tree.children:
        measured = {str(s): curves.sel(sampler=s) for s in curves["sampler"].values}
        return typeset(str(answer(measured, why=why) or "Only one sampler was measured."))
    return typeset(str(_tabled(tree, why)))


def _tabled(tree: xr.DataTree, why: str) -> Answer:
    """Return the answer whose gains and verdicts are those of the table of changes.

    The variable `error` excludes the cost of a pilot run. The ratio and the verdict include it.
    """
    found = tree["remedies"].to_dataset()
    given, budget = found.sel(remedy="as given"), int(tree["remedies"].attrs["budget"])
    rate, results = float(given["rate"]), list[CandidateResult]()

    def needed(gain: float) -> float:
        """Return how many evaluations the given set-up needs for the same variance."""
        with np.errstate(over="ignore"):
            return float(budget * np.power(gain, -1.0 / rate)) if rate < 0.0 < gain else math.nan

    rows = [found.isel(remedy=k) for k in range(found.sizes["remedy"])]
    for row in (given, *(row for row in rows if row["verdict"].item() != "given")):
        verdict, name = row["verdict"].item(), _setup(tree, row)
        low, high = np.sqrt(row["error_ci"].values).tolist()
        least, gain, most = (
            math.inf if ratio == 0.0 else 1.0 / ratio
            for ratio in (
                float(row["error_ratio_ci"][1]),
                float(row["error_ratio"]),
                float(row["error_ratio_ci"][0]),
            )
        )
        results.append(
            CandidateResult(
                name,
                f"use {name}",
                ("", name),
                budget,
                math.sqrt(float(row["error"])),
                (low, high),
                gain=gain,
                gain_ci=(least, most),
                rate=float(row["rate"]),
                needed=needed(gain),
                needed_ci=(needed(least), needed(most)),
                verdict=verdict,
            )
        )
    named = why and not why.startswith("No ")
    cause = f"Cause: {why[:1].lower()}{why[1:]}" if named else ""
    return Answer.of(budget, results, why=cause)


def _setup(tree: xr.DataTree, row: xr.Dataset) -> str:
    """Return the name of a changed set-up: another sampler, or the given sampler with a change."""
    name, given = str(row["remedy"].item()), str(tree.attrs["sampler"])
    if name == "as given":
        return given
    return name if row["kind"].item() == "sampler" else f"{given} with {name}"


def path_sentences(tree: xr.DataTree) -> list[tuple[str, str]]:
    """Return findings about the sources of noise, the effective dimension, and the best points."""
    known = tree.attrs
    said = []
    for kind, axes in (("bounce", "bounce"), ("request", "decision")):
        if kind not in tree["anova"].children:
            continue
        found = _parts(tree, kind)
        shares = found["anova_share"].values
        if not np.isfinite(shares).all():
            return [("noise", "The pixel has no noise: every path has the same value.")]
        order = np.argsort(-shares)[:3]
        parts = [
            f"{found['subset_label'].values[k]} ({percent(float(shares[k]))})"
            for k in order
            if k == order[0] or shares[k] > _SHOWN
        ]
        text = f"The largest parts of the variance are {', '.join(parts)}."
        together, most = 1.0 - float(shares.sum()), max(float(shares[order[0]]), 0.0)
        if together > _NEARLY_ALL:
            text = (
                f"Nearly all of the variance comes from interactions: no {axes} alone causes more "
                f"than {percent(most)}. They fall"
            )
        elif together > _TOGETHER:
            text += f" {percent(together)} are interactions: they fall"
        if together > _TOGETHER:
            text += " only if the points are well spread in these dimensions jointly."
        said.append((f"by {axes}", text))
    if "coordinate" in tree["anova"].children:
        found = _parts(tree, "coordinate")
        least, ends = (found[f"effective_dimension_truncation{end}"].values for end in ("", "_ci"))
        if np.isfinite(least):
            name = known["dimensions"][int(least) - 1]
            low, high = (f"{end:.0f}" for end in ends)
            around = "" if low == high else f" (95 %: {low} to {high})"
            text = (
                f"The first {int(least)} of {known['dims']} coordinates{around}, "
                f"up to {name}, hold {percent(EFFECTIVE_SHARE)} of the variance of a path."
            )
            said.append(("effective dimension", text))
    ratio = ""
    if "remedies" in tree.children:
        tried = tree["remedies"].to_dataset()
        better = (tried["verdict"].values == "better") & (tried["kind"].values == "sampler")
        best = tried.isel(remedy=int(np.argmax(better))) if better.any() else None
        row = tried.sel(remedy="as given") if best is None else best
        name, n = _setup(tree, row), int(tree["remedies"].attrs["budget"])
        size = float(row["error"])
        if best is None and "random" in tried["remedy"].values:
            # The table has ratios to the given sampler only
            other = tried.sel(remedy="random")
            around = between(*map(number, other["error_ratio_ci"].values.tolist()))
            ratio = (
                f"; random numbers have {number(float(other['error_ratio']))} times this variance "
                f"(95 %: {around})"
            )
    else:
        curves = tree["convergence"].to_dataset().isel(n=-1)
        rows = dict(zip(curves["sampler"].values, curves["variance"].values.tolist(), strict=True))
        name, n = min(rows, key=lambda each: rows[each]), int(curves["n"])
        size = rows[name]
    text = f"With {name} the variance at n = {n} is {number(size)}{ratio}"
    said.append(("sampler", f"{text}."))

    # Describe the lights with most variance, and the best remedy
    if "lights" in tree.children:
        lights = tree["lights"].to_dataset()
        largest = lights.isel(light=np.argsort(-lights["light_share"].values)[:3])
        pairs = zip(largest["light"].values, largest["light_share"].values, strict=True)
        named = ", ".join(f"{light} ({percent(float(share))})" for light, share in pairs)
        gain = number(float(lights["selection_ratio"]))
        gains = between(*map(number, lights["selection_ratio_ci"].values.tolist()))
        text = (
            f"The lights with the largest shares of a path's variance are {named}. Choosing lights "
            f"by their second moments multiplies the variance by {gain} (95 %: {gains}, "
            "measured on other paths)."
        )
        said.append(("lights", text))
    elif known.get("lights_note"):
        said.append(("lights", str(known["lights_note"])))
    if "remedies" in tree.children:
        # Find the smallest number of leading coordinates that need QMC points:
        # random numbers in all other coordinates do not make the variance significantly worse
        tried = tree["remedies"].to_dataset()
        enough = (tried["kind"].values == "padding") & (tried["verdict"].values != "worse")
        fewest = [int(str(name).split()[0]) for name in tried["remedy"].values[enough]]
        text = f"Use {known['sampler']} for all {known['dims']} coordinates."
        if fewest:
            dims = min(fewest)
            text = (
                f"{known['sampler']} for the first {dims} coordinates, up to "
                f"{known['dimensions'][dims - 1]}, and random numbers for the others are not "
                f"significantly worse than {known['sampler']} for all {known['dims']}."
            )
        said.append(("padding", f"{text} {known['padding']}"))
        text = f"Compared with {known['sampler']} as given: {tree['remedies'].attrs['answer']}"
        said.append(("remedies", text))
    else:
        said.append(("padding", str(known["padding"])))
    return said


def path_summary(tree: xr.DataTree) -> dict[str, Any]:
    """Return all numbers of a pixel, grouped by analysis."""
    curves = tree["convergence"].to_dataset()
    names = ("variance", "variance_ci", "mean", "rate", "rate_ci")
    rates = [
        {"sampler": sampler, "n": curves["n"].values}
        | {v: curves[v].sel(sampler=sampler).values for v in names if v in curves}
        for sampler in curves["sampler"].values.tolist()
    ]
    parts = {}
    for kind, node in tree["anova"].children.items():
        found = node.to_dataset()
        parts[kind] = {
            "subset": found["subset_label"].values.tolist(),
            "axis": found["axis_label"].values.tolist(),
        } | {v: found[v].values for s in ("anova", "total", "truncation") for v in _share(s)}
        sizes = ("mean_dimension", "effective_dimension_truncation", "variance")
        parts[kind] |= {v: found[v].values for name in sizes for v in (name, f"{name}_ci")}
    known: dict[str, Any] = {"pixel": dict(tree.attrs), "rates": rates, "parts": parts}
    known |= {"answer": path_answer(tree), "sentences": dict(path_sentences(tree))}
    if "lights" in tree.children:
        lights = tree["lights"].to_dataset()
        known["lights"] = {str(name): lights[name].values for name in ("light", *lights.data_vars)}
    if "remedies" in tree.children:
        known["remedies"] = remedies_summary(tree["remedies"].to_dataset())
    return known


def write_path(tree: xr.DataTree, folder: str | Path) -> Path:
    """Write ``report.html``, ``pixel.json`` and ``figures/``. Older files are replaced.

    Parameters
    ----------
    tree
        Result of `mcspectra.studies.analyse_path`.
    folder
        Output folder; created if missing.

    Raises
    ------
    StoreError
        If the folder cannot be written.
    """
    root, known = Path(folder), tree.attrs
    html.write_json(root / "pixel.json", path_summary(tree))
    counts = ", ".join(map(str, known["counts"]))
    settings = (
        f"Whole paths of the integrator {known['integrator']}: {known['dims']} random numbers "
        f"each. {known['padding']} n = {counts} paths, {known['realizations']} realizations, seed "
        f"{known['rng']}."
    )
    curves = {"convergence": describe("convergence", tree["convergence"].to_dataset())}
    parts = {kind: describe("anova", _parts(tree, kind)) for kind in tree["anova"].children}
    plots = {"Rates": curves, "Parts of the variance": parts}
    said = tuple((name[:1].upper() + name[1:], text) for name, text in path_sentences(tree))
    sections: dict[str, tuple[html.Block, ...]] = {
        "Explanation": (html.Sentences(rows=said), picture_of(tree))
    }
    for title, table in path_tables(tree).items():
        sections[title] = (table, *html.figures_of(plots.get(title, {})))
    if "remedies" in tree.children:
        # List changes that cost more, and changes that could not be tried
        found = tree["remedies"].to_dataset()
        costs = [
            (str(name), str(one["reason"].item()))
            for name in found["remedy"].values
            for one in [found.sel(remedy=name)]
            if one["kind"].item() in _CHARGED
        ]
        costs += [each.split(": ", 1) for each in json.loads(found.attrs["not_tried"])]
        about = html.Paragraph(text=_ABOUT_CHARGED, kind="soft")
        blocks = remedies_blocks(found, str(known["sampler"]))
        sections["Remedies"] = (*blocks, about, html.Sentences(rows=tuple(costs)))
    facts = (
        ("Scene", str(known["scene"])),
        ("Integrator", str(known["integrator"])),
        ("Mean", f"{number(known['value'], 5)} ({known['channel']})"),
        ("Coordinates", ", ".join(known["dimensions"])),
    )
    sections["Provenance"] = html.provenance(facts, tree["convergence"].attrs)
    page = html.Page(
        title=f"Pixel ({known['x']}, {known['y']}) of {Path(known['scene']).name}: whole paths",
        what="pixel",
        lead=(html.Paragraph(text=path_answer(tree)), html.Paragraph(text=settings, kind="soft")),
        sections=html.sections_of(sections),
    )
    return html.write_page(page, root / "report.html", root / "figures")


def _parts(tree: xr.DataTree, kind: str) -> xr.Dataset:
    return tree[f"anova/{kind}"].to_dataset()


def _share(name: str) -> tuple[str, str]:
    return f"{name}_share", f"{name}_share_ci"
