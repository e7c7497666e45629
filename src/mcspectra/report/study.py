"""The report of a study: summary, missing analyses, one section per estimator, and provenance."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import xarray as xr

from mcspectra.core.checks import as_path
from mcspectra.core.errors import StoreError
from mcspectra.plots import kinds
from mcspectra.plots.overview import overview
from mcspectra.plots.style import LineStyle, sampler_styles
from mcspectra.plots.text import percent, typeset
from mcspectra.plots.variance import overlaid
from mcspectra.report import page as html
from mcspectra.report.page import Markup
from mcspectra.report.sentences import (
    answer,
    basis_name,
    explain,
    further_sentences,
    headline,
)
from mcspectra.report.tables import analysis_table, summary_of, summary_table, terms_table
from mcspectra.studies import SummaryRow, open_results, study_status
from mcspectra.studies.ledger import LEDGER_NAME, Ledger
from mcspectra.studies.results import showing
from mcspectra.studies.summary import asked_of, pairs_of, rows_of

__all__ = ["REPORT_NAME", "Estimates", "collect", "provenance", "study_toml", "write_report"]

REPORT_NAME = "report.html"

_FIRST = ("convergence", "terms", "spectrum", "points")  # analyses that are shown first
_OF_SAMPLERS = ("spectrum", "points", "pcf")  # analyses of points only, which estimators share
_WITHOUT_SETTINGS = ("points",)  # n is the only setting of these analyses, and captions show it
_FOLDED = ("predict",)  # analyses whose tables are collapsed
_TITLES = {"pcf": "Pair correlation", "anova": "Axes"}
_LIVE = frozenset(
    {"convergence", "terms", "contributions", "spectrum", "lines", "radial", "points"}
)
_DETAILS: Mapping[str, tuple[str, ...]] = {
    "Frequencies": (
        "contributions",
        "product",
        "captured",
        "bands",
        "cross-matrix",
    ),
    "Spectra and points of the samples": (
        "spectrum",
        "lines",
        "radial",
        "pair-correlation",
        "points",
        "integrand",
    ),
}
"""Titles of collapsed blocks, and the kinds of figures in each of them."""

_MOST_ROWS = 40  # show pictures for at most this many estimators: a page of about 10 MB
_MOST_GAPS = 50  # largest number of rows in the table of missing analyses
_LONGEST_KEY = 60  # largest number of characters in a group's name in the store
_NOT_DONE = "not computed yet"
_FUNCTION = re.compile(r"""python\(\s*function\s*=\s*\\?['"]([A-Za-z_][\w.]*:[A-Za-z_]\w*)""")

_HOW_TO_READ = Markup(
    "f<sub>m</sub> are the Fourier coefficients of the integrand and S<sub>m</sub> of the samples. "
    "The covariances C<sub>ml</sub> = ⟨S<sub>m</sub> conj(S<sub>l</sub>)⟩ − "
    "⟨S<sub>m</sub>⟩ conj(⟨S<sub>l</sub>⟩) give the variance of the estimate as a sum of three "
    "terms."
)
_TERMS = (
    (
        "dc",
        Markup("|f<sub>0</sub>|² C<sub>00</sub>: noise of the weights; zero for uniform sampling"),
    ),
    (
        "power",
        Markup("Σ<sub>m≠0</sub> |f<sub>m</sub>|² C<sub>mm</sub>: the two power spectra multiplied"),
    ),
    (
        "cross",
        Markup(
            "Σ<sub>m≠l</sub> conj(f<sub>m</sub>) f<sub>l</sub> C<sub>ml</sub>: variance that "
            "correlation between frequencies adds or, if negative, removes"
        ),
    ),
)


@final
@dataclass(frozen=True, kw_only=True)
class Estimates:
    """Results of one estimator with all its samplers.

    Attributes
    ----------
    key
        Name of the estimator's group in the store.
    analyses
        Results by analysis (in the order of the report) and sampler (in the order of the study).
    rows
        Summary rows by sampler, one row per channel.
    """

    key: str
    name: str
    spec: str
    analyses: Mapping[str, Mapping[str, xr.Dataset]]
    rows: Mapping[str, Sequence[SummaryRow]]

    def of(self, sampler: str, channel: int | None = None) -> dict[str, xr.Dataset]:
        """Return the results of a sampler by analysis, for one channel (None: for all channels)."""
        found = {a: each[sampler] for a, each in self.analyses.items() if sampler in each}
        if channel is None:
            return found
        return {a: d.isel(channel=channel) if "channel" in d.dims else d for a, d in found.items()}


def write_report(folder: str | Path, out: str | Path | None = None) -> Path:
    """Write ``report.html`` and ``figures/*.png, *.pdf`` for the results of a study.

    The page is self-contained: styles, scripts and images are embedded.
    Images replace interactive plots without scripts, and when the page is printed.
    The same results always give the same bytes.

    Parameters
    ----------
    folder
        Folder of a study's results (with ``results.zarr``). An existing report is replaced.
    out
        Path of the page. Default: ``report.html`` in `folder`.
        The figures are written to the folder ``figures`` next to the page.

    Returns
    -------
    Path
        Path of the page.

    Raises
    ------
    ParameterError
        If `folder` or `out` is not a path.
    StoreError
        If `folder` has no results, or the page cannot be written.
    MissingDependency
        If the extra ``report`` is not installed.
    """
    html.check_page_packages()
    root = as_path("folder", folder)
    file = html.page_file(root, REPORT_NAME, out)
    with showing(root):
        return _written(root, file)


def _written(root: Path, file: Path) -> Path:
    """Write the page of the results in `root` to `file`."""
    tree = open_results(root)
    study, estimates = tree.attrs.get("study") or {}, collect(tree)
    samplers = list(dict.fromkeys(s for each in estimates for s in each.rows))
    asked = asked_of(study)
    styles, names = sampler_styles(samplers), html.anchors((each.key for each in estimates), "e-")

    # Assemble summary, missing analyses, a section per estimator, and the provenance
    rows = [
        (row, each.of(sampler, channel), f"#{anchor}")
        for each, anchor in zip(estimates, names, strict=True)
        for sampler, found in each.rows.items()
        for channel, row in enumerate(found)
    ]
    sections = []
    for place, (each, anchor) in enumerate(zip(estimates, names, strict=True)):
        before = list(zip(estimates[:place], names, strict=False))
        pictures = len(estimates) <= _MOST_ROWS
        shown = tuple(_estimator(each, anchor, styles, before, pictures=pictures))
        sections.append(html.Section(title=each.name, anchor=anchor, blocks=shown))
    gaps = tuple(_gaps(root, asked))
    blocks = (*_summary(rows, bool(estimates)), *gaps)
    # The summary follows the pictures of estimators, or comes first if there are no pictures
    place = len(sections) if len(estimates) <= _MOST_ROWS else 0
    sections.insert(place, html.Section(title="Summary", anchor="summary", blocks=blocks))
    text = study_toml(study)
    again = _allowed(text)
    redo = html.markup(
        "save the study below as <code>study.toml</code> (its paths are relative to its folder), "
        "then run<br><code>mcspectra run study.toml --out NEW_FOLDER{}</code>{}",
        again,
        " (your own code that the study names)" if again else "",
    )
    write = Markup(
        "<code>mcspectra report FOLDER</code>; to compare with another run, "
        "<code>mcspectra report FOLDER --compare OTHER_FOLDER</code>"
    )
    facts = (
        *provenance(tree, root),
        ("To repeat the study", redo),
        ("To rewrite this page", write),
    )
    origin = (
        html.FactList(rows=facts),
        html.Collapsible(summary="The study", blocks=(html.Paragraph(text=text, kind="code"),)),
    )
    sections.append(html.Section(title="Provenance", anchor="provenance", blocks=origin))
    absent = len(asked) - len(estimates)
    lead = (
        f"Monte Carlo noise of {_count(max(len(asked), len(estimates)), 'estimator')}"
        f"{f' ({absent} without results)' if absent > 0 else ''} with "
        f"{_count(len(samplers), 'sampler')}, measured, predicted and explained; seed "
        f"{study.get('seed', 'unknown')}."
    )
    page = html.Page(
        title=study.get("title", "Results"),
        what="report",
        lead=(
            *(_answers(estimates) if len(estimates) > _MOST_ROWS else ()),
            html.Paragraph(text=lead, kind="soft"),
            *gaps[1:2],  # number of missing analyses; a table of them follows the summary
        ),
        sections=tuple(sections),
    )
    figures = file.parent / "figures"
    if figures.is_symlink():
        raise StoreError(
            f"{str(figures)!r} is a symbolic link, so files elsewhere might be overwritten; remove "
            "it."
        )
    return html.write_page(page, file, figures)


def collect(tree: xr.DataTree) -> list[Estimates]:
    """Return all estimators of a result tree, with estimators and samplers in the study's order."""
    groups: dict[tuple[str, str], dict[str, dict[str, xr.Dataset]]] = {}
    for key, name, sampler, analyses in pairs_of(tree):
        groups.setdefault((key, name), {})[sampler] = analyses
    found = []
    for (key, name), pairs in groups.items():
        every = [data for analyses in pairs.values() for data in analyses.values()]
        specs = (str(data.attrs["estimator"]) for data in every if "estimator" in data.attrs)
        done = {a for each in pairs.values() for a in each}
        places = {a: (_FIRST.index(a) if a in _FIRST else len(_FIRST), a) for a in done}
        found.append(
            Estimates(
                key=key,
                name=name,
                spec=next(specs, ""),
                analyses={
                    a: {s: of[a] for s, of in pairs.items() if a in of}
                    for a in sorted(done, key=places.__getitem__)
                },
                rows={s: rows_of(name, s, of) for s, of in pairs.items()},
            )
        )
    return found


def provenance(tree: xr.DataTree, root: Path) -> tuple[tuple[str, str | Markup], ...]:
    """Return the provenance of the results in `root`: seed, study hash, machines, versions."""
    hosts: Sequence[str] = ()
    if (root / LEDGER_NAME).exists():
        with Ledger.read(root) as ledger:
            hosts = ledger.tally.hosts
    return (
        ("Seed", str((tree.attrs.get("study") or {}).get("seed", "unknown"))),
        (
            "Study hash (SHA-256)",
            html.markup("<code>{}</code>", tree.attrs.get("study_hash", "unknown")),
        ),
        *((("Machine", ", ".join(hosts)),) if hosts else ()),
        ("Versions", html.versions_of(tree.attrs)),
    )


def study_toml(study: Mapping[str, Any]) -> str:
    """Return a study (plain dicts and lists, as stored) as TOML text that can be run again."""

    def pairs(table: Mapping[str, Any]) -> Iterator[str]:
        """Yield ``key = value`` for each entry that is not a table, with the value as JSON."""
        for key, value in table.items():
            if value is None or isinstance(value, dict) or key in ("estimators", "maps"):
                continue
            # TOML requires that the delete character is escaped, but JSON does not
            yield f"{key} = {json.dumps(value, ensure_ascii=False)}".replace("\x7f", "\\u007f")

    lines = list(pairs(study))
    for name, table in study.items():
        if isinstance(table, dict):
            lines += ["", f"[{name}]", *pairs(table)]
    for kind in ("estimators", "maps"):
        for entry in study.get(kind) or []:
            lines += ["", f"[[{kind}]]", *pairs(entry)]
            for name, table in entry.items():
                if isinstance(table, dict):
                    lines += [f"[{kind}.{name}]", *pairs(table)]
    return "\n".join(lines) + "\n"


def _answers(estimates: Sequence[Estimates]) -> Iterator[html.Block]:
    """Yield the recommendation for each estimator, as collapsed blocks."""
    rows = tuple((each.name, text) for each in estimates if (text := _advice(each)[0]))
    if rows:
        yield html.Collapsible(summary="What to do", blocks=(html.Sentences(rows=rows),))


def _advice(each: Estimates) -> tuple[str, str]:
    """Return the recommendation for an estimator, or "", and the sampler to show in pictures."""
    kept, tried = (each.analyses.get(name, {}) for name in ("profile", "remedies"))
    curves = {
        sampler: curve.mean("channel") if "channel" in curve.dims else curve
        for sampler, curve in each.analyses.get("convergence", {}).items()
    }
    found = answer(curves)
    said = [str(data.attrs["answer"]) for data in (*kept.values(), *tried.values())][:1]
    if not said and found is not None:
        said = [str(found)]
    sampler = found.best.name if found is not None else next(iter(each.rows), "")
    return typeset(said[0]) if said else "", sampler


def _allowed(study: str) -> str:
    """Return the command-line options for the Python functions of a study.

    Each option begins with a blank.
    """
    return "".join(f" --allow-code {name}" for name in dict.fromkeys(_FUNCTION.findall(study)))


def _summary(
    rows: Sequence[tuple[SummaryRow, Mapping[str, Any], str]], any_results: bool
) -> Iterator[html.Block]:
    if rows:
        summary, analyses, links = zip(*rows, strict=True)
        yield summary_table(summary, analyses=analyses, links=links)
        yield html.Paragraph(
            text=Markup(
                "A dash marks a missing number; its tooltip gives the reason. <span "
                'class="scripted">Click a column header to sort. In figures, point at a mark to '
                "see exact values, and click a name in a legend to hide or show its marks.</span>"
            ),
            kind="soft",
        )
    elif any_results:
        yield html.Paragraph(
            text="This study has no convergence and no terms; its other results follow."
        )
    else:
        yield html.Paragraph(text="There are no results yet.")
    yield html.Collapsible(
        summary="How to read this",
        blocks=(
            html.Paragraph(text=_HOW_TO_READ),
            html.FactList(rows=_TERMS),
            html.Paragraph(
                text="The sum includes only frequencies up to a half width, so it predicts only a "
                "part of the variance, given by predicted / measured. All intervals are 95 %."
            ),
        ),
    )


def _stored(names: Iterable[str]) -> dict[str, str]:
    """Map names in the store to full names. If two names in the store are equal, keep the first."""
    given = list(names)
    found: dict[str, str] = {}
    for key, name in zip(html.anchors(given), given, strict=True):
        found.setdefault(key[:_LONGEST_KEY].strip("-."), name)
    return found


def _gaps(root: Path, asked: Mapping[str, Sequence[str]]) -> Iterator[html.Block]:
    """Yield the analyses that failed, with reasons, and analyses that were not computed yet."""
    heading = html.Paragraph(text="What is missing", kind="heading")
    try:
        status = study_status(root)
    except StoreError as error:  # the ledger, which records failures, is missing
        yield heading
        yield html.Paragraph(text=f"It is unknown whether analyses failed. {error}")
        return
    lacking = {**dict.fromkeys(status.missing, _NOT_DONE), **status.failed}
    if not lacking:
        return
    failed, missing = len(status.failed), len(status.missing)
    counts = [f"{k} {what}" for k, what in ((failed, "failed"), (missing, _NOT_DONE)) if k]
    again = "--resume --retry tries" if failed else "--resume computes"
    yield heading
    yield html.Paragraph(
        text=f"Of {len(status.done) + failed + missing} analyses, {' and '.join(counts)}. "
        f"mcspectra run with {again} them. All other analyses are in this report."
    )
    # Collect one row per estimator, sampler and reason, listing all analyses with this reason
    estimators = _stored(asked)
    found: dict[tuple[str, str, str], list[str]] = {}
    for path, reason in sorted(lacking.items()):
        key, own, analysis = path.split("/", 2)
        estimator = estimators.get(key, key)
        sampler = _stored(asked.get(estimator, ())).get(own, own)
        found.setdefault((estimator, sampler, reason), []).append(analysis)
    rows = [(e, s, ", ".join(names), why) for (e, s, why), names in found.items()]
    more = len(rows) - _MOST_GAPS
    yield html.table_of(
        f"{more} more rows: mcspectra status FOLDER --json lists all." if more > 0 else "",
        ("Estimator", "Sampler", "Analyses", "Why"),
        rows[:_MOST_GAPS],
        words=range(4),
        heads=2,
    )


def _estimator(
    each: Estimates,
    anchor: str,
    styles: Mapping[str, LineStyle],
    before: Sequence[tuple[Estimates, str]],
    *,
    pictures: bool,
) -> Iterator[html.Block]:
    """Yield the answer, a sentence and a row of pictures. Everything else is collapsed."""
    advice, sampler = _advice(each)
    if advice:
        yield html.Paragraph(text=advice, kind="answer")
    if rows := each.rows.get(sampler, ())[:1]:
        found = each.of(sampler, 0)
        said = headline(rows[0], found.get("terms"), len(each.rows))
        yield html.Paragraph(text=f"{sampler}: {said}") if said else html.Paragraph(text=sampler)
    drawn = _with_predictions(each.analyses)
    row = tuple(html.Figure(plot=plot) for plot in overview(drawn, sampler, styles))
    if pictures and row:
        yield html.Figures(figures=row, small=True)
    blocks = tuple(_details(each, drawn, anchor, styles, before))
    yield html.Collapsible(summary="All figures, numbers and settings", blocks=blocks)


def _details(
    each: Estimates,
    drawn: Mapping[str, Mapping[str, xr.Dataset]],
    anchor: str,
    styles: Mapping[str, LineStyle],
    before: Sequence[tuple[Estimates, str]],
) -> Iterator[html.Block]:
    """Yield sentences, figures and tables of an estimator."""
    if each.spec:
        spec = html.markup("<code>{}</code>", each.spec)
        yield html.FactList(rows=(("Integrand / density", spec),))

    # Describe each sampler, and give notes on missing analyses
    sentences = []
    for sampler, rows in each.rows.items():
        for channel, row in enumerate(rows):
            text = explain(row, each.of(sampler, channel).get("terms"))
            name = f"{sampler}, channel {channel}" if len(rows) > 1 else sampler
            sentences += [(name, text)] if text else []
        further = further_sentences(each.of(sampler))
        sentences += [(sampler, further)] if further else []
    if sentences:
        yield html.Sentences(rows=tuple(sentences))
    for analysis, found in each.analyses.items():
        lacking = [sampler for sampler in each.rows if sampler not in found]
        if lacking:
            yield html.Paragraph(
                text=f"No {analysis} results for {', '.join(lacking)}.", kind="soft"
            )

    # Show figures; if an earlier estimator shows the same points, only link to its figures
    shown: list[html.Figure] = []
    names: set[str] = set()  # file names in use: two analyses can have the same kind of figure
    details: dict[str, list[html.Figure]] = {summary: [] for summary in _DETAILS}
    linked: dict[str, tuple[str, str]] = {}
    for analysis, found in drawn.items():
        same = _shown_before(analysis, found, before)
        if same is not None:
            linked[analysis] = same
            continue
        for figure in _figures(analysis, found, anchor, styles):
            folds = (s for s, kinds_in in _DETAILS.items() if figure.plot.kind in kinds_in)
            own = f"{figure.name}-{analysis}" if figure.name in names else figure.name
            names.add(own)
            details.get(next(folds, ""), shown).append(replace(figure, name=own))
    if not shown:
        shown = [figure for figures in details.values() for figure in figures]
        details = {}
    if shown:
        yield html.Figures(figures=tuple(shown))

    # Show the table of terms and the tables of all analyses
    terms = terms_table([row for rows in each.rows.values() for row in rows])
    if terms.rows:
        yield html.Collapsible(summary="Three terms in numbers", blocks=(terms,))
    for analysis, found in each.analyses.items():
        made = analysis_table(analysis, found)
        if made is None:
            continue
        if analysis in _FOLDED:
            yield html.Collapsible(summary=made[0], blocks=(made[1],))
        else:
            yield html.Paragraph(text=made[0], kind="heading")
            yield made[1]

    # Show the detailed figures, and the settings of the analyses
    for summary, figures in details.items():
        if figures:
            yield html.Collapsible(summary=summary, blocks=(html.Figures(figures=tuple(figures)),))
    yield html.Collapsible(summary="Settings", blocks=(html.FactList(rows=tuple(_settings(each))),))
    for place in dict.fromkeys(linked.values()):
        what = " and ".join(
            "pair correlation" if a == "pcf" else a for a in linked if linked[a] == place
        )
        text = html.markup('Same samples as in <a href="#{}">{}</a>; see its {}.', *place, what)
        yield html.Paragraph(text=text, kind="soft")


def _with_predictions(
    analyses: Mapping[str, Mapping[str, xr.Dataset]],
) -> dict[str, Mapping[str, xr.Dataset]]:
    """Return the analyses to draw, with predictions and measured curves in one plot if possible."""
    measured, predicted = (analyses.get(name, {}) for name in ("convergence", "predict"))
    if not predicted or not set(predicted) <= set(measured):
        return dict(analyses)
    rest = {name: found for name, found in analyses.items() if name != "predict"}
    return rest | {"convergence": overlaid(measured, predicted)}


def _shown_before(
    analysis: str, found: Mapping[str, xr.Dataset], before: Sequence[tuple[Estimates, str]]
) -> tuple[str, str] | None:
    """Return the anchor and name of the first estimator with identical results, if any."""
    if analysis not in _OF_SAMPLERS:
        return None
    for each, anchor in before:
        there = each.analyses.get(analysis, {})
        # Compare points only: a result may also contain values of f, which may differ
        if all(
            s in there and _samples(there[s]).equals(_samples(data)) for s, data in found.items()
        ):
            return anchor, each.name
    return None


def _samples(data: xr.Dataset) -> xr.Dataset:
    """Remove the values of f and p from a result of the analysis ``points``, and keep the points.

    Results of other analyses are returned unchanged.
    """
    return data[["points"]] if "integrand_value" in data else data


def _figures(
    analysis: str,
    found: Mapping[str, xr.Dataset],
    anchor: str,
    styles: Mapping[str, LineStyle],
) -> Iterator[html.Figure]:
    """Yield the figures of an analysis. If the cross term is only noise, its bands are left out."""
    several = [found] if analysis != "map" else [{s: data} for s, data in found.items()]
    for place, data in enumerate(several):
        for kind in kinds.kinds_of(data):
            if kind == "bands" and not any(_correlated(each) for each in data.values()):
                continue
            if (
                kind == "prediction" and analysis == "convergence"
            ):  # the convergence figure shows predictions as crosses
                continue
            plot = kinds.describe(kind, data, styles)
            if kind == "anything":
                plot = replace(plot, caption=f"{summary_of(analysis)} {plot.caption}")
                kind = analysis
            name = f"{anchor.removeprefix('e-')}-{kind}" + (f"-{place}" if place else "")
            yield html.Figure(plot=plot, name=name, live=plot.kind in _LIVE)


def _correlated(data: xr.Dataset) -> bool:
    """Whether the interval of the cross term excludes 0.

    Older results contain no interval of the cross term; for these results the answer is True.
    """
    if "cross_term_ci" not in data:
        return True
    ends = data["cross_term_ci"].values.reshape(-1, 2)
    return bool(((ends[:, 0] > 0) | (ends[:, 1] < 0)).any())


def _settings(each: Estimates) -> Iterator[tuple[str, str]]:
    """Yield the settings of each analysis, with each distinct setting only once."""
    for analysis, found in each.analyses.items():
        if analysis in _WITHOUT_SETTINGS:
            continue
        samplers: dict[str, list[str]] = {}
        for sampler, data in found.items():
            samplers.setdefault(_setting(analysis, data), []).append(sampler)
        for text, names in samplers.items():
            title = _TITLES.get(analysis, analysis.capitalize())
            yield title, text if len(samplers) == 1 else f"{text} ({', '.join(names)})"


def _setting(analysis: str, data: xr.Dataset) -> str:
    known = data.attrs
    if "budget" in known:
        counts = f"{known['budget']} evaluations"
    elif "n" in known:
        counts = f"n = {known['n']}"
    else:
        n = data["n"].values.tolist() if "n" in data else []
        counts = f"n = {n[0]} … {n[-1]}" if len(n) > 1 else ", ".join(f"n = {k}" for k in n)
    parts = [counts] if counts else []
    if "realizations" in known:
        realizations = f"{known['realizations']} realizations"
        if "relative_error" in known:
            error = percent(float(known["relative_error"]))
            realizations += f" at most, fewer once the variance has a standard error of {error}"
        parts.append(realizations)
    if analysis == "convergence" and known.get("fit_window") == "auto":
        parts.append("rates fitted to the last counts that lie on a line")
    elif analysis == "convergence" and "fit_last" in known:
        parts.append(f"rates fitted to the last {known['fit_last']} counts")
    if analysis == "terms":
        parts += [f"{basis_name(known['basis'])} basis"] if "basis" in known else []
        parts += [f"half width {data.sizes['half_width'] - 1}", f"{known.get('space', '?')} space"]
        parts += [f"coefficients: {known['coefficients']}"] if "coefficients" in known else []
    return ", ".join(parts)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
