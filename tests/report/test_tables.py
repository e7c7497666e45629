"""Tables: cells, dashes with their reasons."""

import msgspec

from mcspectra.report import summary_table, terms_table
from mcspectra.report.tables import Table
from mcspectra.studies import SummaryRow

FULL = SummaryRow(
    estimator="e",
    sampler="s",
    n=1024,
    rate=-1.52,
    rate_low=-1.55,
    rate_high=-1.49,
    variance=1.234e-6,
    terms_n=256,
    dc=0.0,
    power=2e-6,
    cross=-8e-7,
    predicted=1.2e-6,
    measured=1.25e-6,
    measured_low=1.2e-6,
    measured_high=1.3e-6,
    captured=0.96,
    largest_term="power",
)


def texts(table: Table) -> list[str]:
    """Texts of the only row."""
    (row,) = table.rows
    assert len(row) == len(table.columns)
    return [cell.text for cell in row]


def test_summary() -> None:
    assert texts(summary_table([FULL])) == [
        "e",
        "s",
        "−1.52 ± 0.03",
        "1.23×10⁻⁶ (n = 1024)",
        "0.960",
        "power 2.00×10⁻⁶",
        "",
    ]


def test_terms() -> None:
    assert texts(terms_table([FULL])) == [
        "s",
        "256",
        "0",
        "2.00×10⁻⁶",
        "−8.00×10⁻⁷",
        "1.20×10⁻⁶",
        "1.25×10⁻⁶",
        "1.20×10⁻⁶ … 1.30×10⁻⁶",
        "0.960",
    ]


def test_terms__have_half_their_intervals() -> None:
    row = msgspec.structs.replace(
        FULL,
        dc_low=0.0,
        dc_high=0.0,
        power_low=1.8e-6,
        power_high=2.2e-6,
        cross_low=-9e-7,
        cross_high=-7e-7,
        captured_low=0.94,
        captured_high=0.98,
    )
    assert texts(terms_table([row]))[2:5] == [
        "0",
        "2.00×10⁻⁶ ± 2.0×10⁻⁷",
        "−8.00×10⁻⁷ ± 1.0×10⁻⁷",
    ]
    assert texts(terms_table([row]))[-1] == "0.960 ± 0.020"
    assert texts(summary_table([row]))[4] == "0.960 ± 0.020"
    blank = SummaryRow(
        estimator="e", sampler="s", terms_n=4, dc=1e-20, power=1e-6, dc_low=0, dc_high=1e-20
    )
    assert texts(terms_table([blank]))[2] == "≈ 0"


def test_terms__rounding_is_shown_as_such() -> None:
    row = SummaryRow(estimator="e", sampler="s", terms_n=4, dc=1e-20, power=1e-6)
    assert texts(terms_table([row]))[2] == "≈ 0"


def test_every_dash_has_a_reason() -> None:
    rows = [
        SummaryRow(estimator="e", sampler="nothing"),
        SummaryRow(estimator="e", sampler="one count", n=4, variance=0.0),
        SummaryRow(estimator="e", sampler="infinite", terms_n=4, note="infinite: ∫1/p diverges"),
    ]
    for table in (summary_table(rows), terms_table(rows)):
        dashes = [cell for row in table.rows for cell in row if cell.text.startswith("–")]
        assert dashes
        assert all(cell.why for cell in dashes)
    assert summary_table(rows).rows[2][4].why == "infinite: ∫1/p diverges"


def test_terms__only_where_analysed_and_channels_named() -> None:
    rows = [SummaryRow(estimator="e", sampler="s", n=4)]
    assert terms_table(rows).rows == ()
    channel = SummaryRow(estimator="e [2]", sampler="s", terms_n=4)
    assert terms_table([channel]).rows[0][0].text == "s, channel 2"


def test_summary__a_term_that_takes_away_is_no_bottleneck() -> None:
    row = msgspec.structs.replace(FULL, dc=1e-6, power=2e-6, cross=-9e-6, largest_term="cross")
    assert summary_table([row], bottlenecks=[""]).rows[0][5].text == "power 2.00×10⁻⁶"
    assert summary_table([row]).rows[0][5].text == "cross −9.00×10⁻⁶"
    negative = msgspec.structs.replace(row, dc=0.0, power=0.0)
    assert summary_table([negative], bottlenecks=[""]).rows[0][5].text == "cross −9.00×10⁻⁶"


def test_summary__links_orders_and_bottlenecks() -> None:
    table = summary_table([FULL, FULL], links=["#a", "#b"], bottlenecks=["light", ""])
    assert table.columns[5] == "Bottleneck"
    assert [row[5].text for row in table.rows] == ["light", "power 2.00×10⁻⁶"]
    assert [row[0].link for row in table.rows] == ["#a", "#b"]
    assert [cell.order for cell in table.rows[0]][2:5] == [-1.52, 1.234e-6, 0.96]
