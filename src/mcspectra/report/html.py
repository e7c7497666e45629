"""Write a report: one self-contained page, and its figures beside it."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from mcspectra.core.errors import StoreError
from mcspectra.report.collect import ANALYSES, EstimatorGroup, Pair, collect
from mcspectra.report.encode import encode
from mcspectra.report.formatting import percent, slug
from mcspectra.report.gallery import pictures
from mcspectra.report.sentences import explain
from mcspectra.report.study_tables import further_tables
from mcspectra.report.style import LineStyle, sampler_styles
from mcspectra.report.tables import Table, summary_table, terms_table
from mcspectra.studies import SummaryRow, open_results

if TYPE_CHECKING:
    import xarray as xr
    from jinja2 import Template

__all__ = ["REPORT_NAME", "page_template", "write_report"]

REPORT_NAME = "report.html"
_FIGURES = "figures"


def write_report(folder: str | Path) -> Path:
    """Write ``report.html`` and ``figures/*.png, *.pdf`` for the results of a study.

    The page stands alone: styles and pictures are inside, nothing is loaded and nothing runs. The
    same results give the same bytes.

    Parameters
    ----------
    folder
        Folder of a study's results (with ``results.zarr``); a report that is there is replaced.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    StoreError
        There are no results in `folder`, or it cannot be written.
    """
    root = Path(folder)
    tree = open_results(root)
    groups = collect(tree)
    styles = sampler_styles([pair.sampler for group in groups for pair in group.pairs])
    try:
        (root / _FIGURES).mkdir(exist_ok=True)
        anchors = _anchors(groups)
        sections = [
            _section(group, anchor, styles, root / _FIGURES)
            for group, anchor in zip(groups, anchors, strict=True)
        ]
        page = root / REPORT_NAME
        partial = root / f".{REPORT_NAME}.partial"
        partial.write_text(_page(tree, groups, sections), encoding="utf-8")
        partial.replace(page)
    except OSError as error:
        raise StoreError(
            f"The report cannot be written to {str(root)!r}: {error.strerror}."
        ) from None
    return page


@final
@dataclass(frozen=True, kw_only=True)
class _Image:
    """A picture in the page: its bytes as a data address, and where the file is."""

    data: str
    width: int
    height: int
    caption: str
    alt: str
    wide: bool
    name: str


@final
@dataclass(frozen=True, kw_only=True)
class _Section:
    """What the page shows of one estimator."""

    anchor: str
    name: str
    spec: str
    settings: tuple[tuple[str, str], ...]
    sentences: tuple[tuple[str, str], ...]
    missing: tuple[str, ...]
    terms: Table | None
    tables: tuple[tuple[str, Table], ...]
    images: tuple[_Image, ...]


def _section(
    group: EstimatorGroup, anchor: str, styles: Mapping[str, LineStyle], folder: Path
) -> _Section:
    rows = [row for pair in group.pairs for row in pair.rows]
    table = terms_table(rows)
    return _Section(
        anchor=anchor,
        name=group.name,
        spec=group.spec,
        settings=tuple(_settings(group)),
        sentences=tuple(s for pair in group.pairs for s in _sentences(pair)),
        missing=tuple(_missing(group)),
        terms=table if table.rows else None,
        tables=tuple(further_tables(group)),
        images=tuple(_images(group, anchor, styles, folder)),
    )


def _images(
    group: EstimatorGroup, anchor: str, styles: Mapping[str, LineStyle], folder: Path
) -> Iterator[_Image]:
    """Draw, write and embed the figures of an estimator, one at a time."""
    for picture in pictures(group, styles):
        name = f"{anchor}-{picture.kind}"
        png, pdf = encode(picture.figure)
        (folder / f"{name}.png").write_bytes(png)
        (folder / f"{name}.pdf").write_bytes(pdf)
        # Bytes 16 to 24 of a PNG are its width and height.
        width, height = (int.from_bytes(png[i : i + 4], "big") for i in (16, 20))
        yield _Image(
            data=base64.b64encode(png).decode("ascii"),
            width=width,
            height=height,
            caption=picture.caption,
            alt=picture.alt,
            wide=picture.wide,
            name=name,
        )


def _sentences(pair: Pair) -> Iterator[tuple[str, str]]:
    """What is said about a pair, channel by channel."""
    terms = pair.analyses.get("terms")
    for channel, row in enumerate(pair.rows):
        several = len(pair.rows) > 1
        picked = terms
        if terms is not None and "channel" in terms.dims:
            picked = terms.isel(channel=channel)
        text = explain(row, picked)
        if text:
            yield (f"{pair.sampler}, channel {channel}" if several else pair.sampler), text


def _settings(group: EstimatorGroup) -> Iterator[tuple[str, str]]:
    """How each analysis was done, once for every distinct setting."""
    for analysis in ANALYSES[:3]:
        samplers: dict[str, list[str]] = {}
        for sampler, each in group.having(analysis).items():
            samplers.setdefault(_setting(analysis, each), []).append(sampler)
        for text, names in samplers.items():
            yield analysis, text if len(samplers) == 1 else f"{text} ({', '.join(names)})"


def _setting(analysis: str, data: xr.Dataset) -> str:
    known = data.attrs
    if "n" in known:
        counts = f"n = {known['n']}"
    else:
        n = data["n"].values
        counts = f"n = {n[0]} … {n[-1]}" if len(n) > 1 else f"n = {n[0]}"
    parts = [counts, f"{known.get('realizations', '?')} realisations{_stopping(known)}"]
    if analysis == "convergence":
        parts += _fit_setting(known)
    if analysis == "terms":
        parts += [f"{known['basis']} basis"] if "basis" in known else []
        parts += [f"half width {data.sizes['half_width'] - 1}", f"{known.get('space', '?')} space"]
        parts += [f"coefficients: {known['coefficients']}"] if "coefficients" in known else []
    return ", ".join(parts)


def _stopping(known: Mapping[Any, Any]) -> str:
    if "relative_error" not in known:
        return ""
    error = percent(float(known["relative_error"]))
    return f" at most, fewer where the variance has a standard error of {error}"


def _fit_setting(known: Mapping[Any, Any]) -> Iterator[str]:
    if known.get("fit_window") == "auto":
        yield "rates fitted to as many of the last counts as lie on a line"
    elif "fit_last" in known:
        yield f"rates fitted to the last {known['fit_last']} counts"


def _missing(group: EstimatorGroup) -> Iterator[str]:
    """Analyses that some samplers of this estimator have and others lack."""
    for analysis in ANALYSES:
        there = group.having(analysis)
        lacking = [pair.sampler for pair in group.pairs if pair.sampler not in there]
        if there and lacking:
            yield f"No {analysis} results for {', '.join(lacking)}."


def _anchors(groups: Sequence[EstimatorGroup]) -> list[str]:
    """Names for anchors and files: the groups' keys, kebab-case and distinct."""
    anchors: list[str] = []
    for group in groups:
        base = anchor = slug(group.key)
        repeat = 2
        while anchor in anchors:
            anchor, repeat = f"{base}-{repeat}", repeat + 1
        anchors.append(anchor)
    return anchors


def _page(tree: xr.DataTree, groups: Sequence[EstimatorGroup], sections: Sequence[_Section]) -> str:
    study = tree.attrs.get("study") or {}
    rows: list[SummaryRow] = [r for group in groups for pair in group.pairs for r in pair.rows]
    return page_template("template.html.j2").render(
        title=study.get("title", "Results"),
        seed=study.get("seed", "unknown"),
        samplers=len({pair.sampler for group in groups for pair in group.pairs}),
        summary=summary_table(rows) if rows else None,
        sections=sections,
        study_hash=tree.attrs.get("study_hash", "unknown"),
        versions={
            str(key).removeprefix("version_"): value
            for key, value in sorted(tree.attrs.items())
            if str(key).startswith("version_")
        },
        study=study_toml(study),
    )


def page_template(name: str) -> Template:
    """Load a page template; everything put into it is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("mcspectra.report", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name)


def study_toml(study: Mapping[str, Any]) -> str:
    """Write a study (as stored: plain dicts and lists) as TOML, so that it can be run again."""
    lines = list(_pairs(study))
    for name, table in _tables(study):
        lines += ["", f"[{name}]", *_pairs(table)]
    for kind in ("estimators", "maps"):
        for entry in study.get(kind) or []:
            lines += ["", f"[[{kind}]]", *_pairs(entry)]
            for name, table in _tables(entry):
                lines += [f"[{kind}.{name}]", *_pairs(table)]
    return "\n".join(lines) + "\n"


def _tables(table: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Tables inside a table."""
    return ((name, value) for name, value in table.items() if isinstance(value, dict))


def _pairs(table: Mapping[str, Any]) -> Iterator[str]:
    """Lines ``key = value`` of all that is no table. JSON's strings and lists are TOML's."""
    for key, value in table.items():
        if value is None or isinstance(value, dict) or key in ("estimators", "maps"):
            continue
        # TOML wants the delete character escaped, JSON leaves it alone.
        yield f"{key} = {json.dumps(value, ensure_ascii=False)}".replace("\x7f", "\\u007f")
