"""Report on one pixel: a self-contained page, table rows, sentences and numbers for JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from mcspectra.core.fits import UNRESOLVED, is_resolved
from mcspectra.improve.answers import Answer
from mcspectra.plots.kinds import describe
from mcspectra.plots.maps import incident_maps, located
from mcspectra.plots.style import sampler_styles
from mcspectra.plots.text import MISSING, interval, number, percent, rate, typeset
from mcspectra.plots.variance import task_curves
from mcspectra.report import page as html
from mcspectra.report.sentences import answer, basis_name, explain
from mcspectra.report.tables import analysis_table, summary_table, terms_table
from mcspectra.studies import SummaryRow
from mcspectra.studies.summary import rows_of

__all__ = [
    "STRATEGY_NAMES",
    "about_pixel",
    "answer_table",
    "bottleneck_sentence",
    "picture_of",
    "pixel_answer",
    "pixel_rows",
    "pixel_sentences",
    "pixel_summary",
    "remedies_blocks",
    "remedies_summary",
    "term_rows",
    "write_pixel",
]

STRATEGY_NAMES = {
    "light": "light",
    "bsdf": "BSDF",
    "balance": "MIS, balance",
    "power": "MIS, power",
}
"""Names of strategies in tables and figures."""

_TERMS = ("dc_term", "power_term", "cross_term", "predicted_variance", "measured_variance")
_REMEDY = (
    "kind",
    "change",
    "error",
    "error_ci",
    "error_ratio",
    "error_ratio_ci",
    "verdict",
    "rate",
    "rate_ci",
    "rate_verdict",
    "reason",
)
_GIVEN = "balance"  # heuristic that renderers use by default
_PINHOLE = "pinhole"
_FIXED = (
    "Direct light at one fixed point, seen through the center of the pixel: without the variation "
    "inside the pixel and without indirect light. With --integrator scene whole paths are measured."
)
_MOST_LIGHTS = 8  # largest number of lights that are listed by name
_ABOUT_RATES = (
    "Rates are exponents of variance in n (random sampling: −1), ± half their 95 % interval; "
    "unresolved if that exceeds 0.5. MIS takes n samples of each technique. Predicted / measured "
    "is at the largest n, ± half its 95 % interval, with the prediction method in brackets."
)
_ABOUT_TERMS = (
    "Terms in primary space, where all points have equal weights, so the dc term is 0. A basis "
    "that fits the sampler has a small cross term. If g is not periodic, its opposite sides form a "
    "jump in the Fourier basis, which therefore converges slowly for points that are not shifted."
)
_ABOUT_SPACES = (
    "g = f/p on the unit square of random numbers, where the sampler's points lie. Jumps inside "
    "are orange. Jumps between opposite sides are blue; they matter for shifted points, which wrap "
    "around. Below each image: length × mean height of the jumps."
)
_ABOUT_INCIDENT = (
    "Directions above the surface point of the pixel, with azimuth around its shading normal. "
    "Light sampling draws from the lights in the upper map, BSDF sampling from the reflectance; "
    "both integrate f."
)


def write_pixel(tree: xr.DataTree, folder: str | Path) -> Path:
    """Write ``report.html``, ``pixel.json`` and ``figures/``. Older files are replaced.

    Parameters
    ----------
    tree
        Result of `mcspectra.studies.analyse_pixel`.
    folder
        Output folder; created if missing.

    Returns
    -------
    Path
        Path of the page, which is self-contained.

    Raises
    ------
    StoreError
        If the folder cannot be written.
    """
    root, known = Path(folder), tree.attrs
    html.write_json(root / "pixel.json", pixel_summary(tree))
    counts = ", ".join(map(str, known["counts"]))
    settings = (
        f"{_FIXED} n = {counts} samples of each technique, {known['realizations']} realizations, "
        "seed "
        f"{known['rng']}; terms, bottleneck and remedies with {known['sampler']}."
    )
    facts = (
        ("Scene", str(known["scene"])),
        ("Dims", str(known["dims"])),
    )
    about = tuple((name.capitalize(), text) for name, text in about_pixel(tree))
    said = tuple((name[:1].upper() + name[1:], text) for name, text in pixel_sentences(tree))
    sees = (
        html.FactList(rows=about),
        picture_of(tree),
        html.Paragraph(text="Explanation", kind="heading"),
        html.Sentences(rows=said),
    )
    page = html.Page(
        title=f"Pixel ({known['x']}, {known['y']}) of {Path(known['scene']).name}",
        what="pixel",
        lead=(html.Paragraph(text=pixel_answer(tree)), html.Paragraph(text=settings, kind="soft")),
        sections=html.sections_of(
            {
                "Surface and lights": sees,
                **dict(_sections(tree)),
                "Provenance": html.provenance(facts, tree["convergence"].attrs),
            }
        ),
    )
    return html.write_page(page, root / "report.html", root / "figures")


def pixel_answer(tree: xr.DataTree) -> str:
    """Recommend a strategy and sampler at equal evaluations, compared with MIS as given."""
    return typeset(str(_compared(tree)))


def answer_table(tree: xr.DataTree) -> html.Table:
    """Return the errors of all strategies and samplers that `pixel_answer` compares."""
    found = _compared(tree)
    assert found is not None
    rows = [
        (
            each.name,
            number(each.rmse, 2),
            interval(*each.rmse_ci),
            number(each.gain),
            each.verdict,
        )
        for each in sorted(found.results, key=lambda each: each.rmse)
    ]
    return html.table_of(
        f"Errors at {found.budget} evaluations, which MIS divides between its techniques. Gain: "
        f"variance of {found.given.name} divided by this variance.",
        ("Set-up", "RMSE", "95 % interval", "Gain", "Verdict"),
        rows,
        words=(0, -1),
        stacked=True,
    )


def _compared(tree: xr.DataTree) -> Answer | None:
    """Compare all strategies and samplers at equal evaluations with MIS as given."""
    curves, setups = tree["convergence"].to_dataset(), {}
    for strategy, name in STRATEGY_NAMES.items():
        techniques = 1 if strategy in ("light", "bsdf") else 2
        points = curves.assign_coords(n=curves["n"] * techniques).sel(strategy=strategy)
        for sampler in map(str, curves["sampler"].values):
            setups[f"{name} with {sampler}"] = points.sel(sampler=sampler)
    given = f"{STRATEGY_NAMES[_GIVEN]} with {tree.attrs['sampler']}"
    why = str(tree.attrs.get(f"cause_{_GIVEN}", ""))
    return answer(setups, given, why)


def picture_of(tree: xr.DataTree) -> html.Figures:
    """Return a picture of the scene with a ring around the pixel."""
    known = tree.attrs
    place = f"({known['x']}, {known['y']})"
    image = tree["picture"]["image"].transpose("y", "x", "channel").values
    plot = located(
        image,
        np.array([[known["x"], known["y"]]]),
        size=known["film"],
        caption=f"The ring marks the pixel {place} in a small picture of the scene.",
    )
    return html.Figures(figures=(html.Figure(plot=plot, name="picture"),))


def pixel_rows(tree: xr.DataTree) -> list[SummaryRow]:
    """Return one row per strategy and sampler, with the prediction and, if available, the terms.

    Parameters
    ----------
    tree
        Result of `mcspectra.studies.analyse_pixel`.
    """
    curves, rows = tree["convergence"].to_dataset(), list[SummaryRow]()
    for strategy in curves["strategy"].values:
        predicted = tree[f"predict/{strategy}"].to_dataset()
        for sampler in map(str, curves["sampler"].values):
            found = {
                "convergence": curves.sel(strategy=strategy, sampler=sampler, drop=True),
                "predict": predicted.sel(sampler=sampler, drop=True),
            }
            if sampler == tree.attrs["sampler"]:
                found["terms"] = tree[f"terms/{strategy}/auto"].to_dataset()
            rows += rows_of(STRATEGY_NAMES[strategy], sampler, found)
    return rows


def term_rows(tree: xr.DataTree) -> list[SummaryRow]:
    """Return one row per strategy and basis. The field `sampler` contains "strategy; basis"."""
    rows: list[SummaryRow] = []
    for strategy, views in tree["terms"].children.items():
        seen: dict[str, xr.DataTree] = {}
        for view in views.children.values():  # the best basis may be the Fourier basis
            seen.setdefault(str(view.attrs["basis"]), view)
        for basis, view in seen.items():
            label = f"{STRATEGY_NAMES[strategy]}; {basis_name(basis)}"
            rows += rows_of(str(strategy), label, {"terms": view.to_dataset()})
    return rows


def about_pixel(tree: xr.DataTree) -> list[tuple[str, str]]:
    """Return the surface that the ray hits, and its lights, as pairs of a name and a text."""
    known = tree.attrs
    place = ", ".join(number(v) for v in known["position"])
    normal = ", ".join(number(v) for v in known["normal"])
    lights = known["lights"]
    shown = ", ".join(lights[:_MOST_LIGHTS])
    more = f" and {len(lights) - _MOST_LIGHTS} more" if len(lights) > _MOST_LIGHTS else ""
    camera, channel = known.get("camera", _PINHOLE), str(known["channel"])
    channel = channel if channel == "luminance" else f"channel {channel}"
    return [
        ("shape", f"{known['shape']} ({known['bsdf']})"),
        ("position", f"({place}), normal ({normal})"),
        ("lights", f"{shown}{more}"),
        ("lit by", "all of them" if known["light"] == "all" else f"{known['light']} alone"),
        ("value", f"{number(known['value'], 5)} (direct illumination, {channel})"),
        *([("not shown", known["scene_note"])] if known.get("scene_note") else []),
        *([] if camera == _PINHOLE else [("camera", f"the ray starts at the {camera}")]),
    ]


def pixel_sentences(tree: xr.DataTree) -> list[tuple[str, str]]:
    """Return sentences on each strategy, the bottleneck, the fastest strategy and the remedies."""
    known, every = tree.attrs, pixel_rows(tree)
    rows = [row for row in every if row.sampler == known["sampler"]]
    said = [("measured", _FIXED)]
    for strategy, row in zip(STRATEGY_NAMES, rows, strict=True):
        terms = tree[f"terms/{strategy}/auto"].to_dataset()
        text = f"{explain(row, terms)} {known[f'diagnosis_{strategy}']}"
        said.append((STRATEGY_NAMES[strategy], text.strip()))
    said += [("bottleneck", bottleneck_sentence(tree)), ("fastest", _fastest(every))]
    # Report regions without points only once,
    # and use the names of strategies instead of their specs
    note = str(tree["convergence"].attrs.get("note", ""))
    for name, spec in zip(
        *(tree["convergence"][v].values for v in ("strategy", "spec")), strict=True
    ):
        note = note.replace(f"{spec} with ", f"{name} with ").replace(f"{spec}: ", f"{name}: ")
    if note:
        said.append(("not met", note))
    if "remedies" in tree.children:
        said.append(("remedies", typeset(str(tree["remedies"].attrs["answer"]))))
    return said


def bottleneck_sentence(tree: xr.DataTree) -> str:
    """Name the technique whose part of MIS has the slower rate, if rates differ significantly."""
    found = tree["techniques"].to_dataset()
    rates = [
        f"the rate {text}"
        if "±" in (text := rate(float(value), *map(float, ends)))
        else "a rate that more realizations would resolve"
        for value, ends in zip(
            found["technique_rate"].values, found["technique_rate_ci"].values, strict=True
        )
    ]
    slow, names = int(found["bottleneck"]), ("light sampling", "BSDF sampling")
    if slow < 0:
        return (
            "The bottleneck of MIS (balance heuristic) is undecided: the shares of light and BSDF "
            f"sampling converge with {rates[0]} and {rates[1]}, and the difference may be 0."
        )
    # Add a note if the technique with the slower rate has less than half of the variance
    last = found["technique_variance"].isel(n=-1).values
    part, later = float(last[slow] / last.sum()), ""
    if part < 0.5:
        n, slopes = int(found["n"][-1]), found["technique_rate"].values
        later = f" at larger n; at n = {n} it has {percent(part)} of the variance"
        gap = float(slopes[slow] - slopes[1 - slow])
        if gap > 0.0 and last[slow] > 0.0:  # n at which the lines of both techniques cross
            crossing = n * float(last[1 - slow] / last[slow]) ** (1.0 / gap)
            later += f", and more than half beyond n ≈ {number(crossing, 2)} by the fitted lines"
    name = names[slow][0].upper() + names[slow][1:]
    return (
        f"{name} is the bottleneck of MIS (balance heuristic): its share converges with "
        f"{rates[slow]}, the share of {names[1 - slow]} with {rates[1 - slow]}, and the slower "
        f"rate determines the rate of the sum{later}."
    )


def _fastest(rows: list[SummaryRow]) -> str:
    """Name the strategies and samplers with the steepest rate and with the least variance."""
    fitted = [
        row
        for row in rows
        if None not in (row.rate, row.rate_low, row.rate_high)
        and is_resolved(row.rate_low or 0.0, row.rate_high or 0.0)
    ]
    least = min(rows, key=lambda row: math.inf if row.variance is None else row.variance)
    text = (
        f"The least variance at n = {least.n} of each technique is {number(least.variance)}: "
        f"{least.estimator} with {least.sampler}."
    )
    if not fitted:
        return f"The rates are {UNRESOLVED}. {text}"
    best = min(fitted, key=lambda row: row.rate or 0.0)
    shown = rate(best.rate, best.rate_low, best.rate_high)
    return f"The steepest rate is {shown}: {best.estimator} with {best.sampler}. {text}"


def pixel_summary(tree: xr.DataTree) -> dict[str, Any]:
    """Return all numbers of a pixel except its maps, grouped by analysis."""
    curves, techniques = tree["convergence"].to_dataset(), tree["techniques"].to_dataset()
    rates = [
        {"strategy": str(strategy), "sampler": str(sampler), "n": curves["n"].values}
        | {v: one[v].values for v in ("variance", "variance_ci", "rate", "rate_ci")}
        | {
            v: known[v].values
            for v in ("predicted_variance", "predicted_variance_ci", "method", "how")
        }
        for strategy in curves["strategy"].values
        for sampler in curves["sampler"].values
        for one in [curves.sel(strategy=strategy, sampler=sampler)]
        for known in [tree[f"predict/{strategy}"].to_dataset().sel(sampler=sampler)]
    ]
    names = [n for term in (*_TERMS, "captured") for n in (term, f"{term}_ci")]
    terms = [
        {"strategy": strategy, "view": view}
        | {key: node.attrs[key] for key in ("basis", "sampler", "n")}
        | {name: node[name].values for name in names if name in node}
        for strategy, views in tree["terms"].children.items()
        for view, node in views.children.items()
    ]
    slow = int(techniques["bottleneck"])
    shares = ("technique_rate", "technique_rate_ci", "technique_variance", "rate", "rate_ci")
    found: dict[str, Any] = {
        "pixel": {
            k: v for k, v in tree.attrs.items() if not str(k).startswith(("cause_", "diagnosis_"))
        },
        "rates": rates,
        "terms": terms,
        "techniques": {
            "estimator": techniques.attrs["estimator"],
            "techniques": ["light", "bsdf"],
            "bottleneck": ("light", "bsdf")[slow] if slow >= 0 else "undecided",
            "n": techniques["n"].values,
            **{name: techniques[name].values for name in shares},
        },
        "jumps": [
            {"integrand": name, "kind": str(kind)}
            | {v: float(node[f"primary_jump_{v}"].sel(kind=kind)) for v in ("length", "height")}
            for name, node in (
                tree["pictures"].children if "pictures" in tree.children else {}
            ).items()
            for kind in node.to_dataset()["kind"].values
        ],
        "answer": pixel_answer(tree),
        "sentences": dict(pixel_sentences(tree)),
    }
    if "remedies" in tree.children:
        found["remedies"] = remedies_summary(tree["remedies"].to_dataset())
    return found


def _sections(tree: xr.DataTree) -> Iterator[tuple[str, tuple[html.Block, ...]]]:
    """Yield the title and the blocks of each section that has figures or tables."""
    known = tree.attrs

    # Show rates and predictions: the summary table without the columns on terms
    curves = tree["convergence"].to_dataset()
    table = summary_table(pixel_rows(tree))
    table = replace(
        html.columns_of(table, table.columns[:5]),
        caption=_ABOUT_RATES,
        columns=("Strategy", *table.columns[1:5]),
    )
    styles = sampler_styles(list(map(str, curves["sampler"].values)))
    by_strategy = {
        STRATEGY_NAMES[str(strategy)]: {name: each.sel(sampler=name) for name in styles}
        for strategy in curves["strategy"].values
        for each in [curves.sel(strategy=strategy)]
    }
    x = "number of samples n of each technique"
    plot = task_curves(by_strategy, styles, by="by each strategy", x=x, alike=True)
    yield "Strategies at equal cost", (answer_table(tree),)
    yield "Rates and predictions", (table, *html.figures_of({"rates": plot}))

    # Show the three terms in the best basis, and the captured variance in all bases
    trees = tree["terms"].children.items()
    fitting = {STRATEGY_NAMES[name]: views["auto"].to_dataset() for name, views in trees}
    every = {
        f"{STRATEGY_NAMES[name]}; {basis_name(view.attrs['basis'])}": view.to_dataset()
        for name, views in trees
        for view in views.children.values()
    }
    first = next(iter(fitting.values())).attrs
    table = terms_table(term_rows(tree))
    table = replace(table, columns=("Strategy; basis", *table.columns[1:]))
    bars, shares = describe("terms", fitting), describe("captured", every)
    where = f"At n = {first['n']} with {known['sampler']}, {basis_name(first['basis'])} basis."
    bars = replace(bars, caption=f"{bars.caption} {where}")
    figures = html.figures_of({"terms": bars, "captured": shares})
    yield "Three terms", (html.Paragraph(text=_ABOUT_TERMS), table, *figures)

    # Show integrands on the unit square, and the incident light
    if "pictures" in tree.children:
        group = {}
        for name, node in tree["pictures"].children.items():
            # A name such as "balance-bsdf" has two parts: a heuristic of MIS and a technique
            strategy, _, technique = name.partition("-")
            title = (
                f"{STRATEGY_NAMES[technique]} share, {strategy}"
                if technique
                else STRATEGY_NAMES[name]
            )
            group[title] = node.to_dataset()
        plot = replace(describe("primary", group), caption=_ABOUT_SPACES, wide=True)
        yield "Integrands on the square", html.figures_of({"integrands": plot})
    plot = replace(incident_maps(tree["incident"].to_dataset()), caption=_ABOUT_INCIDENT)
    yield "Incident light", html.figures_of({"incident": plot})

    # Show the bottleneck
    found = tree["techniques"].to_dataset()
    variances = found["technique_variance"].isel(n=-1).values
    total = float(variances.sum())
    slopes = (found["technique_rate"].values, found["technique_rate_ci"].values)
    rows = [
        (
            name,
            rate(float(slope), *map(float, ends)),
            number(float(variance)),
            percent(float(variance) / total) if total > 0 else MISSING,
        )
        for name, slope, ends, variance in zip(("light", "BSDF"), *slopes, variances, strict=True)
    ]
    where = f"n = {int(found['n'][-1])}, {known['sampler']}"
    table = html.table_of(
        f"Shares of MIS with the balance heuristic, {where}.",
        ("Technique", "Rate", "Variance", "Share of all"),
        rows,
    )
    yield "Bottleneck", (html.Paragraph(text=bottleneck_sentence(tree)), table)

    # Show the remedies
    if "remedies" in tree.children:
        yield "Remedies", remedies_blocks(tree["remedies"].to_dataset(), str(known["sampler"]))


def remedies_summary(found: xr.Dataset) -> dict[str, Any]:
    """Return the answer and all numbers of `mcspectra.remedies`."""
    ranked = [
        {"remedy": str(name)} | {v: found[v].sel(remedy=name).values for v in _REMEDY}
        for name in found["remedy"].values
    ]
    known = ("budget", "diagnosis", "answer", "not_tried")
    return {**{k: found.attrs[k] for k in known}, "ranked": ranked}


def remedies_blocks(found: xr.Dataset, sampler: str) -> tuple[html.Block, ...]:
    """Return the answer, a table of all changes that were tried, and a figure of their errors."""
    made = analysis_table("remedies", {sampler: found})
    assert made is not None
    table = html.columns_of(made[1], made[1].columns[1:])
    text = html.Paragraph(text=found.attrs["answer"])
    figures = html.figures_of({"remedies": describe("remedies", found)})
    return (text, table, *figures)
