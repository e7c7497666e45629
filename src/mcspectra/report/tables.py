"""Tables of a report, as text and explanations; the template turns them into HTML."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from mcspectra.report.formatting import (
    MISSING,
    interval,
    number,
    number_beside,
    rate,
    with_error,
)
from mcspectra.studies import SummaryRow

__all__ = ["Cell", "Table", "summary_table", "terms_table"]

_NO_CURVE = "convergence was not analysed"
_NO_TERMS = "the terms were not analysed"
_NO_RATE = "fewer than two counts have a variance above rounding noise"
_BOTTLENECK = (
    " The bottleneck is the technique with the slowest rate where techniques were analysed (undecided: "
    "their intervals overlap), else the term that adds most."
)
_NO_NUMBER = "there is no finite number"


@final
@dataclass(frozen=True, kw_only=True)
class Cell:
    """Text of a cell, why it has none (a tooltip), and whether it is a number.

    `order` is the number that the cell is sorted by, `link` where its text leads.
    """

    text: str
    why: str = ""
    numeric: bool = True
    order: float | None = None
    link: str = ""


@final
@dataclass(frozen=True, kw_only=True)
class Table:
    """Caption, column heads and rows of cells; the first `heads` cells of a row are its heads."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    heads: int


def summary_table(
    rows: Sequence[SummaryRow],
    *,
    links: Sequence[str] | None = None,
    bottlenecks: Sequence[str] | None = None,
) -> Table:
    """Return the table that is read first: one row for every estimator and sampler.

    Parameters
    ----------
    rows
        What is known of each pair.
    links
        Where the name of each row's estimator leads; nowhere by default.
    bottlenecks
        The technique that sets each row's rate; where it is empty, the largest term stands for it.
    """
    limits: Sequence[str | None] = [None] * len(rows) if bottlenecks is None else bottlenecks
    extra = zip(links or [""] * len(rows), limits, strict=True)
    return Table(
        caption="Rates are exponents of variance in n (random sampling: −1), ± half their 95 % "
        "interval. Predicted / measured is the share of the variance that the truncated spectrum "
        "explains, ± half its 95 % interval." + (_BOTTLENECK if bottlenecks is not None else ""),
        columns=(
            "Estimator",
            "Sampler",
            "Rate",
            "Variance at largest n",
            "Predicted / measured",
            "Largest term" if bottlenecks is None else "Bottleneck",
            "Notes",
        ),
        rows=tuple(_summary_cells(row, *more) for row, more in zip(rows, extra, strict=True)),
        heads=2,
    )


def terms_table(rows: Sequence[SummaryRow]) -> Table:
    """Return one estimator's three terms against its measured variance."""
    return Table(
        caption="dc + power + cross = predicted, each term and predicted / measured ± half their 95 % "
        "interval; beside it the measured variance and its 95 % interval.",
        columns=(
            "Sampler",
            "n",
            "dc",
            "power",
            "cross",
            "Predicted",
            "Measured",
            "95 % interval",
            "Predicted / measured",
        ),
        rows=tuple(_term_cells(row) for row in rows if row.terms_n is not None),
        heads=1,
    )


def _summary_cells(row: SummaryRow, link: str, bottleneck: str | None) -> tuple[Cell, ...]:
    term = _largest(row) if bottleneck is None else bottleneck or _costliest(row)
    no_rate = _NO_CURVE if row.n is None else _NO_RATE
    variance = number(row.variance)
    at = f" (n = {row.n})" if row.n is not None and variance != MISSING else ""
    slope = rate(row.rate, row.rate_low, row.rate_high)
    return (
        Cell(text=row.estimator, numeric=False, link=link),
        Cell(text=row.sampler, numeric=False),
        _cell(slope, no_rate, row.rate),
        _cell(variance + at, _NO_CURVE if row.n is None else _NO_NUMBER, row.variance),
        _cell(_captured(row), _no_term(row), row.captured),
        _cell(term, _no_term(row)),
        Cell(text=row.note or "", numeric=False),
    )


def _term_cells(row: SummaryRow) -> tuple[Cell, ...]:
    why = _no_term(row)

    def value(given: float | None, low: float | None = None, high: float | None = None) -> Cell:
        return _cell(with_error(number_beside(given, row.power), _half(low, high)), why)

    return (
        Cell(text=_sampler_of(row), numeric=False),
        _cell(str(row.terms_n), why),
        value(row.dc, row.dc_low, row.dc_high),
        value(row.power, row.power_low, row.power_high),
        value(row.cross, row.cross_low, row.cross_high),
        value(row.predicted),
        value(row.measured),
        _cell(interval(row.measured_low, row.measured_high), why),
        _cell(_captured(row), why),
    )


def _captured(row: SummaryRow) -> str:
    return with_error(number(row.captured), _half(row.captured_low, row.captured_high))


def _half(low: float | None, high: float | None) -> float | None:
    return None if low is None or high is None else 0.5 * (high - low)


def _sampler_of(row: SummaryRow) -> str:
    """The sampler, with the channel that `summarize` appends to the estimator's name."""
    head, bracket, channel = row.estimator.rpartition(" [")
    several = bool(head and bracket and channel.rstrip("]").isdigit())
    return f"{row.sampler}, channel {channel.rstrip(']')}" if several else row.sampler


def _largest(row: SummaryRow) -> str:
    if row.largest_term is None:
        return MISSING
    values = {"dc": row.dc, "power": row.power, "cross": row.cross}
    return f"{row.largest_term} {number(values[row.largest_term])}"


def _costliest(row: SummaryRow) -> str:
    """The term that adds most to the variance: the cross term often takes from it."""
    values = {"dc": row.dc, "power": row.power, "cross": row.cross}
    adding = {name: v for name, v in values.items() if v is not None and v > 0}
    if not adding:
        return _largest(row)
    name = max(adding, key=lambda each: adding[each])
    return f"{name} {number(adding[name])}"


def _no_term(row: SummaryRow) -> str:
    return row.note or (_NO_TERMS if row.terms_n is None else _NO_NUMBER)


def _cell(text: str, why: str, order: float | None = None) -> Cell:
    return Cell(text=text, why=why if text.startswith(MISSING) else "", order=order)
