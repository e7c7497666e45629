"""What a report shows of one estimator: settings, sentences, tables, figures."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import final

from mcspectra.report.collect import EstimatorGroup, Pair
from mcspectra.report.embed import packed_plot
from mcspectra.report.encode import encode
from mcspectra.report.gallery import pictures
from mcspectra.report.interactive import alt_text
from mcspectra.report.live import live_plot
from mcspectra.report.sentences import explain, further_sentences
from mcspectra.report.settings import missing_analyses, settings
from mcspectra.report.study_tables import further_tables
from mcspectra.report.style import LineStyle
from mcspectra.report.tables import Table, terms_table

__all__ = ["Image", "Section", "section_of"]


@final
@dataclass(frozen=True, kw_only=True)
class Image:
    """A picture in the page: its bytes in base 64, and as `plot` the interactive form, if any."""

    caption: str
    data: str = ""
    width: int = 0
    height: int = 0
    alt: str = ""
    wide: bool = False
    name: str = ""
    plot: str = ""
    plot_alt: str = ""


@final
@dataclass(frozen=True, kw_only=True)
class Section:
    """What the page shows of one estimator."""

    anchor: str
    name: str
    spec: str
    settings: tuple[tuple[str, str], ...]
    sentences: tuple[tuple[str, str], ...]
    missing: tuple[str, ...]
    terms: Table | None
    tables: tuple[tuple[str, Table], ...]
    images: tuple[Image, ...]


def section_of(
    group: EstimatorGroup, anchor: str, styles: Mapping[str, LineStyle], folder: Path
) -> Section:
    """Tables, sentences and figures of one estimator; figures are written to `folder` as well."""
    rows = [row for pair in group.pairs for row in pair.rows]
    table = terms_table(rows)
    return Section(
        anchor=anchor,
        name=group.name,
        spec=group.spec,
        settings=tuple(settings(group)),
        sentences=tuple(s for pair in group.pairs for s in _sentences(pair)),
        missing=tuple(missing_analyses(group)),
        terms=table if table.rows else None,
        tables=tuple(further_tables(group)),
        images=tuple(_images(group, anchor, styles, folder)),
    )


def _images(
    group: EstimatorGroup, anchor: str, styles: Mapping[str, LineStyle], folder: Path
) -> Iterator[Image]:
    """Draw, write and embed the figures of an estimator, one at a time."""
    for picture in pictures(group, styles):
        name = f"{anchor}-{picture.kind}"
        png, pdf = encode(picture.figure)
        (folder / f"{name}.png").write_bytes(png)
        (folder / f"{name}.pdf").write_bytes(pdf)
        # Bytes 16 to 24 of a PNG are its width and height.
        width, height = (int.from_bytes(png[i : i + 4], "big") for i in (16, 20))
        plot = live_plot(picture.kind, group, styles)
        yield Image(
            data=base64.b64encode(png).decode("ascii"),
            width=width,
            height=height,
            caption=picture.caption,
            alt=picture.alt,
            wide=picture.wide,
            name=name,
            plot="" if plot is None else packed_plot(plot),
            plot_alt="" if plot is None else alt_text(plot),
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
    further = further_sentences(pair.analyses)
    if further:
        yield pair.sampler, further
