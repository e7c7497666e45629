"""The noise of whole paths at a pixel: one page that stands alone, rows, sentences, numbers for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.plots.kinds import describe
from mcspectra.plots.text import interval, number, percent, rate
from mcspectra.report.page import (
    Cell,
    Facts,
    Figure,
    Figures,
    Page,
    Section,
    Sentences,
    Table,
    Text,
    text_cells,
    versions_of,
    write_json,
    write_page,
)
from mcspectra.variance.anova import EFFECTIVE_SHARE

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["PATH_TABLES", "path_rows", "path_sentences", "path_summary", "write_path"]

PATH_TABLES = {
    "rates": ("Sampler", "Rate", "n", "Variance", "95 %", "Predicted"),
    "parts": ("Part", "Alone", "With all others", "Up to here"),
    "padding": ("Good coordinates", "n", "Variance", "95 %"),
}
"""Columns of the tables of `path_rows`."""

_ABOUT = {
    "rates": "Rates are exponents of variance in n (random sampling: −1), ± half their 95 % interval.",
    "parts": (
        "Shares of the variance of one random path by what its numbers decide, in their order: by them "
        "alone, with all sets of numbers that hold them (these overlap), and by all numbers up to here."
    ),
    "padding": (
        "Variance with points of the sampler for the first coordinates alone, up to the end of a bounce, "
        "and random numbers for all others."
    ),
}


def path_rows(tree: xr.DataTree) -> dict[str, list[list[str]]]:
    """Rows of the tables of `PATH_TABLES` as texts.

    Parameters
    ----------
    tree
        What `mcspectra.studies.analyse_path` returns.
    """
    curves, last = tree["convergence"].to_dataset(), {"n": -1}
    rows: dict[str, list[list[str]]] = {"rates": [], "parts": [], "padding": []}
    for sampler in curves["sampler"].values.tolist():
        one = curves.sel(sampler=sampler)
        predicted = float("nan")
        if "predict" in tree.children:
            known = tree["predict"].to_dataset().sel(sampler=sampler)
            predicted = float(known["predicted_variance"].isel(last))
        at = one.isel(last)
        rows["rates"].append(
            [sampler, rate(float(one["rate"]), *one["rate_ci"].values.tolist()), str(int(at["n"])),
             number(float(at["variance"])), interval(*at["variance_ci"].values.tolist()),
             number(predicted)]
        )  # fmt: skip
    for kind in ("bounce", "decision"):
        found = _parts(tree, kind)
        names = found["axis_label"].values.tolist()
        columns = [found[v].values for v in ("anova_share", "total_share", "truncation_share")]
        columns[0] = columns[0][: len(names)]
        shown = list(zip(names, *columns, strict=True))
        if kind == "decision":  # their order is not that of the numbers
            shown = [(name, alone, total, np.nan) for name, alone, total, _ in shown]
        for name, *shares in shown:
            texts = ["" if np.isnan(share) else percent(float(share)) for share in shares]
            rows["parts"].append([name, *texts])
    padding = tree["padding"].to_dataset()
    for dims in padding["dims"].values.tolist():
        at = padding.sel(dims=dims).isel(last)
        ends = interval(*at["variance_ci"].values.tolist())
        rows["padding"].append([str(dims), str(int(at["n"])), number(float(at["variance"])), ends])
    return rows


def path_sentences(tree: xr.DataTree) -> list[tuple[str, str]]:
    """What the noise is made of, how many numbers count, and which points help."""
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
        parts = [f"{found['subset_label'].values[k]} {percent(float(shares[k]))}" for k in order]
        said.append((f"by {axes}", f"Most of the variance is made by {', '.join(parts)}."))
    if "coordinate" in tree["anova"].children:
        found = _parts(tree, "coordinate")
        least, ends = (found[f"effective_dimension_truncation{end}"].values for end in ("", "_ci"))
        if np.isfinite(least):
            name = known["dimensions"][int(least) - 1]
            text = (
                f"The first {int(least)} of {known['dims']} coordinates ({interval(*ends.tolist())}), up to "
                f"{name}, hold {percent(EFFECTIVE_SHARE)} of the variance of a path."
            )
            said.append(("effective dimension", text))
    curves = tree["convergence"].to_dataset().isel(n=-1)
    best = curves.isel(sampler=int(np.argmin(curves["variance"].values)))
    text = (
        f"The least variance at n = {int(best['n'])} is {number(float(best['variance']))}: "
        f"{best['sampler'].item()}."
    )
    if "random" in curves["sampler"].values and best["sampler"].item() != "random":
        ratio = float(curves["variance"].sel(sampler="random") / best["variance"])
        text += f" Random numbers have {number(ratio)} times as much."
    said.append(("sampler", text))
    padding = tree["padding"].to_dataset().isel(n=-1)
    whole = padding["variance_ci"].isel(dims=-1)
    enough = padding["variance_ci"].sel(bound="low") <= float(whole.sel(bound="high"))
    dims = int(padding["dims"].values[enough.values][0])
    if dims < known["dims"]:
        text = (
            f"Points of {known['sampler']} for the first {dims} coordinates, up to "
            f"{known['dimensions'][dims - 1]}, and random numbers for the others are as good as for all "
            f"{known['dims']}, as far as 95 % intervals tell."
        )
    else:
        text = f"All {dims} coordinates deserve points of {known['sampler']}."
    return [*said, ("padding", text)]


def path_summary(tree: xr.DataTree) -> dict[str, Any]:
    """All numbers of a pixel, by what they are of."""
    curves, padding = (tree[name].to_dataset() for name in ("convergence", "padding"))
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
    found = {"dims": padding["dims"].values, "n": padding["n"].values}
    found |= {v: padding[v].values for v in ("variance", "variance_ci")}
    known: dict[str, Any] = {"pixel": dict(tree.attrs), "rates": rates, "parts": parts}
    return known | {"padding": found, "sentences": dict(path_sentences(tree))}


def write_path(tree: xr.DataTree, folder: str | Path) -> Path:
    """Write ``report.html``, ``pixel.json`` and ``figures/``; older ones are replaced.

    Parameters
    ----------
    tree
        What `mcspectra.studies.analyse_path` returns.
    folder
        Made if need be.

    Raises
    ------
    StoreError
        The folder cannot be written.
    """
    root, known = Path(folder), tree.attrs
    write_json(root / "pixel.json", path_summary(tree))
    rows = path_rows(tree)
    counts = ", ".join(map(str, known["counts"]))
    settings = (
        f"Whole paths of the integrator {known['integrator']}: {known['dims']} random numbers each. n = "
        f"{counts} paths, {known['realizations']} realisations, seed {known['rng']}."
    )
    plots = {
        "rates": {"convergence": describe("convergence", tree["convergence"].to_dataset())},
        "parts": {kind: describe("anova", _parts(tree, kind)) for kind in tree["anova"].children},
        "padding": {},
    }
    titles = {"rates": "Rates", "parts": "Parts of the variance", "padding": "Good coordinates"}
    sections = [
        Section(
            title=title,
            anchor=name,
            blocks=(
                _table(name, rows[name]),
                Figures(figures=tuple(Figure(plot=p, name=n) for n, p in plots[name].items())),
            )[: 2 if plots[name] else 1],
        )
        for name, title in titles.items()
    ]
    facts = (
        ("Scene", str(known["scene"])),
        ("Integrator", str(known["integrator"])),
        ("Mean", f"{number(known['value'], 5)} ({known['channel']})"),
        ("Coordinates", ", ".join(known["dimensions"])),
        ("Versions", versions_of(tree["convergence"].attrs)),
    )
    said = tuple((name[:1].upper() + name[1:], text) for name, text in path_sentences(tree))
    page = Page(
        title=f"Pixel ({known['x']}, {known['y']}) of {Path(known['scene']).name}: whole paths",
        what="pixel",
        lead=(Text(text=settings, kind="soft"),),
        sections=(
            Section(title="Explanation", anchor="pixel", blocks=(Sentences(rows=said),)),
            *sections,
            Section(title="Provenance", anchor="provenance", blocks=(Facts(rows=facts),)),
        ),
    )
    return write_page(page, root / "report.html", root / "figures")


def _parts(tree: xr.DataTree, kind: str) -> xr.Dataset:
    return tree[f"anova/{kind}"].to_dataset()


def _share(name: str) -> tuple[str, str]:
    return f"{name}_share", f"{name}_share_ci"


def _table(name: str, rows: Sequence[Sequence[str]]) -> Table:
    cells = tuple(
        (*text_cells(first), *(Cell(text=text) for text in rest)) for first, *rest in rows
    )
    return Table(caption=_ABOUT[name], columns=PATH_TABLES[name], rows=cells)
