"""Tables: contents of cells, and dashes with reasons."""

import msgspec
import numpy as np
import xarray as xr

from mcspectra.report import summary_table, terms_table
from mcspectra.report.page import markup
from mcspectra.report.sentences import bottleneck
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
    ratio=0.96,
    method="fourier",
    largest_term="power",
)


def texts(table):
    """Return the texts of the only row."""
    (row,) = table.rows
    assert len(row) == len(table.columns)
    return [cell.text for cell in row]


def test_summary():
    assert texts(summary_table([FULL])) == [
        "e",
        "s",
        "−1.52 ± 0.03",
        "1.23×10⁻⁶",
        "0.960 (Fourier)",
        "detail at frequencies where the sampler is noisy",
        "Faster than random sampling.",
    ]


def test_terms():
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


def test_terms__have_half_widths_of_intervals():
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
        ratio_low=0.94,
        ratio_high=0.98,
    )
    assert texts(terms_table([row]))[2:5] == [
        "0",
        "2.00×10⁻⁶ ± 2.0×10⁻⁷",
        "−8.0×10⁻⁷ ± 1.0×10⁻⁷",
    ]
    assert texts(terms_table([row]))[-1] == "0.960 ± 0.020"
    assert texts(summary_table([row]))[4] == "0.960 ± 0.020 (Fourier)"
    blank = SummaryRow(
        estimator="e", sampler="s", terms_n=4, dc=1e-20, power=1e-6, dc_low=0, dc_high=1e-20
    )
    assert texts(terms_table([blank]))[2] == "≈ 0"


def test_terms__rounding_is_shown_as_zero():
    row = SummaryRow(estimator="e", sampler="s", terms_n=4, dc=1e-20, power=1e-6)
    assert texts(terms_table([row]))[2] == "≈ 0"


def test_every_dash_has_a_reason():
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


def test_terms__only_analyzed_rows_with_channel_names():
    rows = [SummaryRow(estimator="e", sampler="s", n=4)]
    assert terms_table(rows).rows == ()
    channel = SummaryRow(estimator="e [2]", sampler="s", terms_n=4)
    assert terms_table([channel]).rows[0][0].text == "s, channel 2"


def test_summary__a_negative_term_is_not_the_bottleneck():
    row = msgspec.structs.replace(FULL, dc=3e-6, power=2e-6, cross=-9e-6, largest_term="cross")
    assert texts(summary_table([row]))[5] == "weights: p does not follow f"
    negative = msgspec.structs.replace(row, dc=0.0, power=0.0)
    assert texts(summary_table([negative]))[5] == "–"


def test_summary__links_orders_and_bottlenecks():
    found = [{"techniques": xr.Dataset(attrs={"bottleneck": "light"})}, {}]
    table = summary_table([FULL, FULL], links=["#a", "#b"], analyses=found)
    assert table.columns[5] == "Bottleneck"
    assert [row[5].text for row in table.rows] == [
        "light",
        "detail at frequencies where the sampler is noisy",
    ]
    assert [row[0].link for row in table.rows] == ["#a", "#b"]
    assert [cell.order for cell in table.rows[0]][2:5] == [-1.52, 1.234e-6, 0.96]


def test_summary__unusual_counts_are_shown():
    rows = [FULL, FULL, msgspec.structs.replace(FULL, n=256)]
    table = summary_table(rows)
    assert table.columns[3] == "Variance at n = 1024"
    assert [row[3].text for row in table.rows] == ["1.23×10⁻⁶", "1.23×10⁻⁶", "1.23×10⁻⁶ (n = 256)"]


def test_summary__names_the_prediction_method():
    row = msgspec.structs.replace(FULL, ratio=1.02, ratio_low=0.97, ratio_high=1.07, method="exact")
    table = summary_table([row])
    assert table.rows[0][4].text == "1.020 ± 0.050 (exact)"
    assert table.rows[0][4].order == 1.02
    assert table.rows[0][6].text == "Faster than random sampling; prediction agrees."
    far = msgspec.structs.replace(row, ratio=2.0, ratio_low=1.5, ratio_high=2.7)
    assert summary_table([far]).rows[0][6].text.endswith("predicted × 2.00.")


def terms(power, **attrs):
    """Return the power term by frequency in one dim."""
    m = np.arange(-4, 5)
    return xr.Dataset({"power_contribution": ("m0", power)}, {"m0": m}, attrs)


def test_bottleneck__median_frequency_of_the_power_term():
    low = terms([0, 0, 0, 5, 9, 5, 0, 0, 1])
    high = terms([9, 1, 0, 0, 9, 0, 0, 1, 9])
    row = msgspec.structs.replace(FULL, terms_n=8)
    assert bottleneck(row, low) == "coarse shape (|\u2060m|\u2060\u00a0≤\u00a01)"
    assert bottleneck(row, high) == "edges and detail (|\u2060m|\u2060\u00a0≥\u00a04)"
    assert bottleneck(msgspec.structs.replace(row, basis="cosine"), high).endswith(
        "(|\u2060m|\u2060\u00a0≤\u00a02)"
    )
    walsh = msgspec.structs.replace(row, basis="walsh")
    assert bottleneck(walsh, high) == "detail at frequencies where the sampler is noisy"


def test_bottlenecks_are_written_to_pages_without_escapes():
    text = bottleneck(msgspec.structs.replace(FULL, terms_n=8), terms([0, 0, 0, 5, 9, 5, 0, 0, 1]))
    plain = text.replace("\u00a0", " ")
    assert markup("{}", text) == plain
    assert markup("{}", f"\u202e{text}") == rf"\u202e{plain}"
