"""An analysis of another package: a table of its numbers, curves and images, without code here."""

import numpy as np
import pytest
import xarray as xr

from mcspectra.report.collect import EstimatorGroup, Pair
from mcspectra.report.gallery import pictures
from mcspectra.report.settings import settings
from mcspectra.report.study_tables import further_tables
from mcspectra.report.style import sampler_styles


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


@pytest.fixture
def group():
    pairs = tuple(
        Pair(sampler=name, analyses={"gaps": result(k)}, rows=())
        for k, name in enumerate(("random", "jittered"))
    )
    return EstimatorGroup(key="a", name="a", spec="gaussian", pairs=pairs)


def test_numbers_stand_in_a_table_with_meaning_and_interval(group):
    ((heading, table),) = further_tables(group)
    assert heading == "Gaps"
    shown = [[cell.text for cell in row] for row in table.rows]
    assert shown == [
        ["random", "largest gap", "cells", "1.50", "1.25 … 2.00"],
        ["jittered", "largest gap", "cells", "2.50", "1.25 … 2.00"],
    ]


def test_curves_and_images_are_drawn(group):
    curve, image = pictures(group, sampler_styles(["random", "jittered"]))
    assert (curve.kind, image.kind) == ("gaps-curve", "gaps-table")
    assert curve.caption == "Gaps. Mean gap, over place."
    (panel,) = curve.figure.axes
    assert [line.get_label() for line in panel.lines] == ["random", "jittered"]
    np.testing.assert_array_equal(panel.lines[1].get_ydata(), [1.0, 2.0, 3.0])
    assert len(panel.collections) == 2  # bands of two standard errors
    assert sum(bool(axes.images) for axes in image.figure.axes) == 2


def test_its_settings_are_said(group):
    assert list(settings(group)) == [("gaps", "4 realisations")]


def test_results_without_numbers_have_no_table(group):
    bare = [
        Pair(sampler=p.sampler, analyses={"gaps": p.analyses["gaps"][["table"]]}, rows=())
        for p in group.pairs
    ]
    group = EstimatorGroup(key="a", name="a", spec="", pairs=tuple(bare))
    assert list(further_tables(group)) == []
    assert [p.kind for p in pictures(group, sampler_styles(["random", "jittered"]))] == [
        "gaps-table"
    ]
