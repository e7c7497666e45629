"""From a result tree to what a report shows: pairs of estimator and sampler in the study's order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

from mcspectra.studies import SummaryRow, summarize

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["EstimatorGroup", "Pair", "collect"]

_FIRST = ("convergence", "terms", "spectrum", "points")  # others as they are stored


@final
@dataclass(frozen=True, kw_only=True)
class Pair:
    """One estimator with one sampler: its analyses by name and its summary, a row a channel."""

    sampler: str
    analyses: Mapping[str, xr.Dataset]
    rows: tuple[SummaryRow, ...]


@final
@dataclass(frozen=True, kw_only=True)
class EstimatorGroup:
    """One estimator with all its samplers; `key` is its group in the store."""

    key: str
    name: str
    spec: str
    pairs: tuple[Pair, ...]

    @property
    def analyses(self) -> tuple[str, ...]:
        """Analyses that one of its samplers has, whoever's they are, in the order of a report."""
        found = dict.fromkeys(name for pair in self.pairs for name in pair.analyses)
        return tuple(sorted(found, key=lambda name: (_place(_FIRST, name), name)))

    def having(self, analysis: str) -> dict[str, xr.Dataset]:
        """Datasets of one analysis, by sampler."""
        return {p.sampler: p.analyses[analysis] for p in self.pairs if analysis in p.analyses}


def collect(tree: xr.DataTree) -> list[EstimatorGroup]:
    """Return all estimators of a result tree with their pairs, in the study's order.

    Groups of a store come in whatever order the file system lists them; the study's own lists of
    estimators and samplers decide here, so that a report does not depend on it.
    """
    order = _study_order(tree.attrs.get("study") or {})
    rows: dict[tuple[str, str], list[SummaryRow]] = {}
    for row in summarize(tree):
        rows.setdefault((row.estimator, row.sampler), []).append(row)
    groups = [_group(str(key), node, rows, order) for key, node in tree.children.items()]
    names = list(order)
    return sorted(
        (group for group in groups if group.pairs),
        key=lambda g: (names.index(g.name) if g.name in order else len(names), g.key),
    )


def _study_order(study: Mapping[str, Any]) -> dict[str, list[str]]:
    """Samplers by estimator, as the study lists them."""
    shared = study.get("samplers") or []
    entries = [*(study.get("estimators") or []), *(study.get("maps") or [])]
    return {e["name"]: e.get("samplers") or shared for e in entries}


def _group(
    key: str,
    node: xr.DataTree,
    rows: Mapping[tuple[str, str], Sequence[SummaryRow]],
    order: Mapping[str, list[str]],
) -> EstimatorGroup:
    found: list[Pair] = []
    name, spec = key, ""
    for slug, child in node.children.items():
        analyses = {str(name): each.to_dataset() for name, each in child.children.items()}
        if not analyses:
            continue
        attributes = next(iter(analyses.values())).attrs
        name = str(attributes.get("estimator_name", key))
        sampler = str(attributes.get("sampler_spec", slug))
        specs = [str(d.attrs["estimator"]) for d in analyses.values() if "estimator" in d.attrs]
        spec = specs[0] if specs else spec
        found.append(
            Pair(sampler=sampler, analyses=analyses, rows=_rows_of(name, sampler, analyses, rows))
        )
    samplers = order.get(name, [])
    found.sort(key=lambda p: (_place(samplers, p.sampler), p.sampler))
    return EstimatorGroup(key=key, name=name, spec=spec, pairs=tuple(found))


def _place(names: Sequence[str], name: str) -> int:
    return names.index(name) if name in names else len(names)


def _rows_of(
    name: str,
    sampler: str,
    analyses: Mapping[str, xr.Dataset],
    rows: Mapping[tuple[str, str], Sequence[SummaryRow]],
) -> tuple[SummaryRow, ...]:
    """Rows of a pair: `summarize` names the channels of an estimator ``name [0]``, ``name [1]`` …"""
    channels = max((d.sizes.get("channel", 0) for d in analyses.values()), default=0)
    names = [f"{name} [{c}]" for c in range(channels)] or [name]
    return tuple(row for each in names for row in rows.get((each, sampler), ()))
