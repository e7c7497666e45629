"""Write a report: one self-contained page, and its figures beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcspectra.core.errors import StorageError, StoreError
from mcspectra.report.collect import EstimatorGroup, Pair, collect
from mcspectra.report.embed import bokeh_script
from mcspectra.report.formatting import slug
from mcspectra.report.gaps import gaps_of
from mcspectra.report.sections import Section, section_of
from mcspectra.report.style import sampler_styles
from mcspectra.report.tables import Table, summary_table
from mcspectra.studies import SummaryRow, open_results
from mcspectra.studies.ledger import LEDGER_NAME, Ledger, check_links

if TYPE_CHECKING:
    import xarray as xr
    from jinja2 import Template

__all__ = [
    "REPORT_NAME",
    "page_template",
    "provenance",
    "replace_page",
    "study_toml",
    "write_report",
    "writing",
]

REPORT_NAME = "report.html"
_FIGURES = "figures"
_WRONG_PLACE = (
    FileNotFoundError,
    NotADirectoryError,
    IsADirectoryError,
    FileExistsError,
    PermissionError,
)
_FUNCTION = re.compile(r"""python\(\s*function\s*=\s*\\?['"]([A-Za-z_][\w.]*:[A-Za-z_]\w*)""")


def write_report(folder: str | Path, out: str | Path | None = None) -> Path:
    """Write ``report.html`` and ``figures/*.png, *.pdf`` for the results of a study.

    The page stands alone: styles, scripts and pictures are inside, nothing is loaded. Without
    scripts, and on paper, pictures stand where the interactive plots are. The same results give the
    same bytes.

    Parameters
    ----------
    folder
        Folder of a study's results (with ``results.zarr``); a report that is there is replaced.
    out
        The page; ``report.html`` in `folder` by default. Figures go to the folder ``figures``
        beside it.

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
    check_links(root)
    tree = open_results(root)
    groups = collect(tree)
    styles = sampler_styles([pair.sampler for group in groups for pair in group.pairs])
    page = root / REPORT_NAME if out is None else Path(out)
    figures = page.parent / _FIGURES
    with writing(page):
        figures.mkdir(exist_ok=True)
        sections = [
            section_of(group, anchor, styles, figures)
            for group, anchor in zip(groups, _anchors(groups), strict=True)
        ]
        replace_page(page, _page(tree, root, groups, sections))
    return page


@contextmanager
def writing(page: Path) -> Iterator[None]:
    """Turn failures to write a page into one sentence.

    Raises
    ------
    StoreError
        It is no place for a file: the folder is not there, or not open to the user.
    StorageError
        The disk is full, or fails.
    """
    try:
        yield
    except OSError as error:
        raise (StoreError if isinstance(error, _WRONG_PLACE) else StorageError)(
            f"The report cannot be written to {str(page)!r}: {error.strerror}."
        ) from None


def replace_page(page: Path, text: str) -> None:
    """Write a page in one step, so that a reader never sees half of it."""
    partial = page.parent / f".{page.name}.partial"
    partial.write_text(text, encoding="utf-8")
    partial.replace(page)


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


def _page(
    tree: xr.DataTree,
    root: Path,
    groups: Sequence[EstimatorGroup],
    sections: Sequence[Section],
) -> str:
    study = tree.attrs.get("study") or {}
    live = any(image.plot for section in sections for image in section.images)
    return page_template("template.html.j2").render(
        title=study.get("title", "Results"),
        samplers=len({pair.sampler for group in groups for pair in group.pairs}),
        summary=_overview(groups, sections),
        gaps=gaps_of(root),
        sections=sections,
        bokeh=bokeh_script() if live else "",
        study=(text := study_toml(study)),
        allowed=_allowed(text),
        **provenance(tree, root),
    )


def _allowed(study: str) -> str:
    """Options that a study with Python functions needs on the command line, with a blank before."""
    names = dict.fromkeys(_FUNCTION.findall(study))
    return "".join(f" --allow-code {name}" for name in names)


def _overview(groups: Sequence[EstimatorGroup], sections: Sequence[Section]) -> Table | None:
    """The table that is read first; names of estimators lead to their sections."""
    rows: list[SummaryRow] = []
    links: list[str] = []
    bottlenecks: list[str] = []
    for group, section in zip(groups, sections, strict=True):
        for pair in group.pairs:
            rows += pair.rows
            links += [f"#e-{section.anchor}"] * len(pair.rows)
            bottlenecks += [_bottleneck(pair)] * len(pair.rows)
    return summary_table(rows, links=links, bottlenecks=bottlenecks) if rows else None


def _bottleneck(pair: Pair) -> str:
    """The technique that sets the rate, where techniques were analysed."""
    found = pair.analyses.get("techniques")
    return "" if found is None else str(found.attrs.get("bottleneck") or "")


def provenance(tree: xr.DataTree, root: Path) -> dict[str, Any]:
    """Where the results in `root` come from: seed, hash of the study, machines and versions."""
    return {
        "seed": (tree.attrs.get("study") or {}).get("seed", "unknown"),
        "study_hash": tree.attrs.get("study_hash", "unknown"),
        "hosts": ", ".join(_hosts(root)),
        "versions": {
            str(key).removeprefix("version_"): value
            for key, value in sorted(tree.attrs.items())
            if str(key).startswith("version_")
        },
    }


def _hosts(root: Path) -> list[str]:
    """Machines that the study was computed on, as its ledger has them."""
    if not (root / LEDGER_NAME).exists():
        return []
    with Ledger.read(root) as ledger:
        return list(ledger.tally.hosts)


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
