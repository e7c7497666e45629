"""Reports of analyses from other packages: a table of scalars, curves and maps without own code."""

import numpy as np
import xarray as xr

from mcspectra.core.analysis import ANALYSES, Analysis
from mcspectra.core.results import Variable
from mcspectra.report import write_report
from mcspectra.report.tables import analysis_table


def result(shift=0.0, **coords):
    gap = {"long_name": "largest gap", "units": "cells"}
    return xr.Dataset(
        {
            "gap": ((), 1.5 + shift, gap),
            "gap_ci": (("bound",), [1.25, 2.0]),
            "curve": (("place",), np.arange(3.0) + shift, {"long_name": "mean gap", "units": "1"}),
            "curve_se": (("place",), np.full(3, 0.1)),
            "table": (("place", "other"), np.ones((3, 2))),
            "words": (("place",), np.array(["a", "b", "c"])),
        },
        coords,
        attrs={"realizations": 4},
    )


GAPS = {name: result(k) for k, name in enumerate(("random", "jittered"))}


def test_scalars_are_in_a_table_with_meaning_and_interval():
    heading, table = analysis_table("gaps", GAPS)
    assert heading == "Gaps"
    shown = [[cell.text for cell in row] for row in table.rows]
    assert shown == [
        ["random", "largest gap", "cells", "1.50", "1.25 … 2.00"],
        ["jittered", "largest gap", "cells", "2.50", "1.25 … 2.00"],
    ]


def test_results_without_numbers_have_no_table():
    assert analysis_table("gaps", {s: each[["table"]] for s, each in GAPS.items()}) is None


class Gaps(Analysis, frozen=True, kw_only=True):
    """Gaps between points, an analysis of another package."""

    variables = tuple(
        Variable("made up", "1", None, "fU", name)
        for name in ("gap", "gap_ci", "curve", "curve_se", "table", "words")
    )


def test_curves_are_drawn_and_settings_are_listed(make, tmp_path, monkeypatch):
    monkeypatch.setattr(ANALYSES, "_builtin", {**ANALYSES._builtin, "gaps": f"{__name__}:Gaps"})
    cells = {("e", s): {"gaps": each} for s, each in GAPS.items()}
    page = write_report(make["study"](tmp_path, cells))
    text = page.read_text(encoding="utf-8")
    assert [p.name for p in (tmp_path / "figures").glob("*.png")] == [
        "e-gaps.png"
    ] or "gaps" in text
    assert "<dt>Gaps</dt><dd>4 realizations</dd>" in text
