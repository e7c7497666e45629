"""Write everything about a pixel: one page that stands alone, its figures, and its numbers."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from mcspectra.core.errors import StoreError
from mcspectra.report.figures.pixel import incident_maps, remedy_ratios, strategy_curves
from mcspectra.report.figures.variance import captured_curves, three_terms
from mcspectra.report.figures.warps import primary_pictures
from mcspectra.report.formatting import interval, number, rate
from mcspectra.report.html import page_template
from mcspectra.report.pixel_text import (
    STRATEGY_NAMES,
    about_pixel,
    bottleneck_sentence,
    pixel_rows,
    pixel_sentences,
    pixel_summary,
    term_rows,
)
from mcspectra.report.style import WIDE
from mcspectra.report.tables import Cell, Table, summary_table, terms_table

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

__all__ = ["write_pixel"]

_DPI = 120
_RATE_COLUMNS = 4

_SPACES = (
    "g = f/p on the square of random numbers, what the sampler's points meet. Jumps inside are drawn in "
    "orange, those between opposite sides, which shifted points wrap around, in blue; below each "
    "picture, their length × mean height."
)
_RATES = (
    "Rates are exponents of variance in n (random sampling: −1), ± half their 95 % interval. MIS takes "
    "n samples of each technique."
)
_TERMS = (
    "Terms in primary space, whose points have equal weights: the dc term is 0. A basis that fits the "
    "sampler has a small cross term; the Fourier basis sees the jump between opposite sides of a g that "
    "is not periodic, and converges slowly for points that are not shifted."
)
_INCIDENT = (
    "Directions above the point that the pixel sees, azimuth around its shading normal. Light sampling "
    "draws from the upper map's lights, BSDF sampling from the reflectance; f is what both integrate."
)


@final
@dataclass(frozen=True, kw_only=True)
class _Picture:
    """A figure in the page: its bytes as a data address, and its caption."""

    data: str
    caption: str
    wide: bool


@final
@dataclass(frozen=True, kw_only=True)
class _Section:
    """A part of the page."""

    anchor: str
    name: str
    text: str = ""
    tables: tuple[Table, ...] = ()
    figures: tuple[_Picture, ...] = ()


def write_pixel(tree: xr.DataTree, folder: str | Path) -> Path:
    """Write ``report.html``, ``pixel.json`` and ``figures/*.png``; older ones are replaced.

    Parameters
    ----------
    tree
        What `mcspectra.studies.analyse_pixel` returns.
    folder
        Made if need be.

    Returns
    -------
    Path
        The page, which needs none of the other files.

    Raises
    ------
    StoreError
        The folder cannot be written.
    """
    root = Path(folder)
    try:
        (root / "figures").mkdir(parents=True, exist_ok=True)
        text = json.dumps(_plain(pixel_summary(tree)), indent=2, allow_nan=False)
        (root / "pixel.json").write_text(text + "\n", encoding="utf-8")
        page = root / "report.html"
        page.write_text(_page(tree, _sections(tree, root / "figures")), encoding="utf-8")
    except OSError as error:
        raise StoreError(f"{str(root)!r} cannot be written: {error.strerror}.") from None
    return page


def _page(tree: xr.DataTree, sections: list[_Section]) -> str:
    known = tree.attrs
    counts = ", ".join(map(str, known["counts"]))
    versions = {k: v for k, v in tree["convergence"].attrs.items() if str(k).startswith("version_")}
    return page_template("pixel.html.j2").render(
        title=f"Pixel ({known['x']}, {known['y']}) of {Path(known['scene']).name}",
        settings=(
            f"n = {counts} samples of each technique, {known['realizations']} realisations, seed "
            f"{known['rng']}; terms, bottleneck and remedies with {known['sampler']}."
        ),
        about=about_pixel(tree),
        sentences=pixel_sentences(tree),
        sections=sections,
        provenance={"scene": known["scene"], "dims": known["dims"], **versions},
    )


def _sections(tree: xr.DataTree, folder: Path) -> list[_Section]:
    """All parts of the page; figures are written into the folder on the way."""
    parts = (_rates, _terms, _pictures, _incident, _bottleneck, _remedies)
    return [section for part in parts for section in part(tree, folder)]


def _rates(tree: xr.DataTree, folder: Path) -> Iterator[_Section]:
    figure = strategy_curves(tree["convergence"].to_dataset(), STRATEGY_NAMES)
    caption = (
        "Variance against n with 95 % intervals. Rates, ± half their 95 % interval, in the order and "
        "the colours of the legend."
    )
    yield _Section(
        anchor="rates",
        name="Rates",
        tables=(_rate_table(tree),),
        figures=(_picture(figure, folder / "rates.png", caption),),
    )


def _rate_table(tree: xr.DataTree) -> Table:
    """The summary without its columns about terms, which have a table of their own."""
    table = summary_table(pixel_rows(tree))
    return replace(
        table,
        caption=_RATES,
        columns=("Strategy", *table.columns[1:_RATE_COLUMNS]),
        rows=tuple(row[:_RATE_COLUMNS] for row in table.rows),
    )


def _terms(tree: xr.DataTree, folder: Path) -> Iterator[_Section]:
    fitting = {
        STRATEGY_NAMES[name]: views["auto"].to_dataset()
        for name, views in tree["terms"].children.items()
    }
    every = {
        f"{STRATEGY_NAMES[name]}; {view.attrs['basis']}": view.to_dataset()
        for name, views in tree["terms"].children.items()
        for view in views.children.values()
    }
    basis, n = next(iter(fitting.values())).attrs["basis"], next(iter(fitting.values())).attrs["n"]
    bars = f"Parts of the variance at n = {n} with {tree.attrs['sampler']}, {basis} basis."
    share = "Predicted over measured variance against the half width of the spectrum."
    yield _Section(
        anchor="terms",
        name="Three terms",
        text=_TERMS,
        tables=(_named(terms_table(term_rows(tree)), "Strategy; basis"),),
        figures=(
            _picture(three_terms(fitting), folder / "terms.png", bars),
            _picture(captured_curves(every), folder / "captured.png", share),
        ),
    )


def _pictures(tree: xr.DataTree, folder: Path) -> Iterator[_Section]:
    if "pictures" not in tree.children:
        return
    children = tree["pictures"].children
    group = {_integrand_name(name): node.to_dataset() for name, node in children.items()}
    picture = _picture(primary_pictures(group), folder / "integrands.png", _SPACES)
    yield _Section(anchor="integrands", name="Integrands on the square", figures=(picture,))


def _integrand_name(name: str) -> str:
    """``BSDF share, balance`` for ``balance-bsdf``."""
    strategy, _, technique = name.partition("-")
    return f"{STRATEGY_NAMES[technique]} share, {strategy}" if technique else STRATEGY_NAMES[name]


def _incident(tree: xr.DataTree, folder: Path) -> Iterator[_Section]:
    figure = incident_maps(tree["incident"].to_dataset())
    picture = _picture(figure, folder / "incident.png", _INCIDENT)
    yield _Section(anchor="incident", name="Light that arrives", figures=(picture,))


def _bottleneck(tree: xr.DataTree, folder: Path) -> Iterator[_Section]:  # noqa: ARG001
    found = tree["techniques"].to_dataset()
    share = found["technique_variance"].isel(n=-1).values
    total = float(share.sum())
    rows = [
        (
            Cell(text=name, numeric=False),
            Cell(text=rate(float(slope), *map(float, ends))),
            Cell(text=number(float(variance))),
            Cell(text=f"{variance / total:.0%}".replace("%", " %") if total > 0 else "–"),
        )
        for name, slope, ends, variance in zip(
            ("light", "BSDF"),
            found["technique_rate"].values,
            found["technique_rate_ci"].values,
            share,
            strict=True,
        )
    ]
    table = Table(
        caption=f"Shares of MIS with the balance heuristic, n = {int(found['n'][-1])}, "
        f"{tree.attrs['sampler']}.",
        columns=("Technique", "Rate", "Variance", "Part of all"),
        rows=tuple(rows),
        heads=1,
    )
    text = bottleneck_sentence(tree)
    yield _Section(anchor="bottleneck", name="Bottleneck", text=text, tables=(table,))


def _remedies(tree: xr.DataTree, folder: Path) -> Iterator[_Section]:
    if "remedies" not in tree.children:
        return
    found = tree["remedies"].to_dataset()
    caption = (
        "Error of each change at the budget relative to MIS (balance) with the sampler as given; the 95 % "
        "intervals of all hold together. Green: better; orange: worse; grey: cannot be told."
    )
    picture = _picture(remedy_ratios(found), folder / "remedies.png", caption)
    yield _Section(
        anchor="remedies",
        name="Remedies",
        text=found.attrs["recommendation"],
        tables=(_remedy_table(found),),
        figures=(picture,),
    )


def _remedy_table(found: xr.Dataset) -> Table:
    rows = []
    for name in found["remedy"].values:
        one = found.sel(remedy=name)
        rows.append(
            (
                Cell(text=str(name), numeric=False),
                Cell(text=str(one["verdict"].item()), numeric=False),
                Cell(text=number(float(one["error_ratio"]))),
                Cell(text=interval(*one["error_ratio_ci"].values.tolist())),
                Cell(text=rate(float(one["rate"]), *map(float, one["rate_ci"].values))),
                Cell(text=str(one["reason"].item()), numeric=False),
            )
        )
    return Table(
        caption=f"At {found.attrs['budget']} evaluations, in the order of the error.",
        columns=("Change", "Verdict", "Error ratio", "95 % interval", "Rate", "Why"),
        rows=tuple(rows),
        heads=1,
    )


def _named(table: Table, head: str) -> Table:
    """The table with another name of its first column."""
    return replace(table, columns=(head, *table.columns[1:]))


def _picture(figure: Figure, file: Path, caption: str) -> _Picture:
    """Write and embed a figure, in all its shades: a palette would make steps of smooth values."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    file.write_bytes(buffer.getvalue())
    return _Picture(
        data=base64.b64encode(buffer.getvalue()).decode("ascii"),
        caption=caption,
        wide=figure.get_figwidth() >= WIDE,
    )


def _plain(value: Any) -> Any:
    """Lists and numbers that JSON has; null for NaN and infinity."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
