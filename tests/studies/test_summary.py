"""The row of a pair: predicted over measured variance, and the method of the prediction."""

import numpy as np
import pytest
import xarray as xr

from mcspectra.plots.text import rate
from mcspectra.report.tables import summary_table
from mcspectra.studies import summarize

COUNTS = np.array([4, 16, 64])
CURVE = xr.Dataset(
    {
        "variance": ("n", [1.0, 0.1, 0.01]),
        "variance_ci": (("n", "bound"), [[0.9, 1.1], [0.09, 0.12], [0.008, 0.0125]]),
        "rate": -1.66,
        "rate_ci": ("bound", [-1.8, -1.5]),
    },
    {"n": COUNTS},
)
TERMS = xr.Dataset(
    {
        **{
            f"{name}_term": value for name, value in (("dc", 0.0), ("power", 0.1), ("cross", -0.02))
        },
        "predicted_variance": 0.08,
        "measured_variance": 0.1,
        "captured": 0.8,
        "captured_ci": ("bound", [0.7, 0.9]),
    },
    attrs={"n": 16, "basis": "walsh"},
)
EXACT = xr.Dataset(
    {
        "predicted_variance": ("n", [1.0, 0.11, np.nan]),
        "predicted_variance_ci": (("n", "bound"), [[1.0, 1.0], [0.11, 0.11], [np.nan, np.nan]]),
    },
    {"n": COUNTS, "method": ("n", ["exact", "exact", "none"])},
)
PREDICTED = xr.Dataset(
    {
        "predicted_variance": ("n", [0.2, 0.012]),
        "predicted_variance_ci": (("n", "bound"), [[0.1, 0.3], [0.010, 0.015]]),
    },
    {"n": [16, 64], "method": ("n", ["exact", "torus"])},
)


def row(**found):
    named = {"estimator_name": "e", "sampler_spec": "s"}
    tree = {f"/e/s/{name}": data.assign_attrs(named) for name, data in found.items()}
    (only,) = summarize(xr.DataTree.from_dict(tree))
    return only


def test_without_a_prediction_the_method_is_the_basis():
    found = row(convergence=CURVE, terms=TERMS)
    assert (found.ratio, found.ratio_low, found.ratio_high) == (0.8, 0.7, 0.9)
    assert found.method == "walsh"


def test_exact_variances_at_the_last_count_that_has_one():
    found = row(convergence=CURVE, terms=TERMS, predict=EXACT)
    assert found.ratio == pytest.approx(1.1)
    assert (found.ratio_low, found.ratio_high) == pytest.approx((0.11 / 0.12, 0.11 / 0.09))
    assert found.method == "exact"
    assert found.captured == 0.8


def test_predictions_come_first_with_both_errors():
    found = row(convergence=CURVE, terms=TERMS, predict=PREDICTED)
    assert found.ratio == pytest.approx(1.2)
    low = np.hypot(np.log(12.5 / 10), np.log(12 / 10))
    high = np.hypot(np.log(10 / 8), np.log(15 / 12))
    assert found.ratio_low == pytest.approx(1.2 * np.exp(-low))
    assert found.ratio_high == pytest.approx(1.2 * np.exp(high))
    assert found.method == "torus"


def test_the_most_trusted_predicting_method_is_used():
    """Method names are a coordinate or labels of a store; the measurement is not a prediction."""
    names = ["exact", "torus", "measured"]
    value = [[np.nan, np.nan], [0.2, 0.012], [0.1, 0.01]]
    found = xr.Dataset(
        {
            "predicted_variance": (("method", "n"), value),
            "predicted_variance_ci": (("method", "n", "bound"), np.stack([value, value], -1)),
        },
        {"n": [16, 64], "method": names},
    )
    stored = found.drop_vars("method").assign_attrs(labels_method=names)
    for each in (found, stored):
        assert row(convergence=CURVE, predict=each).ratio == pytest.approx(1.2)
        assert row(convergence=CURVE, predict=each).method == "torus"
    assert row(convergence=CURVE, predict=found.isel(method=[0, 2])).ratio is None


def test_a_measured_variance_of_zero_gives_no_ratio():
    silent = CURVE.assign(variance=0.0 * CURVE["variance"])
    assert row(convergence=silent, predict=PREDICTED).ratio is None
    tree = xr.DataTree.from_dict({"/e/s/predict": PREDICTED})
    assert summarize(tree) == []


def test_unknown_ends_of_intervals_are_infinite():
    """A rate with an infinite interval is not shown without it."""
    variance_ci = CURVE["variance_ci"].copy(data=[[0.9, np.inf], [0.09, np.inf], [0.008, np.inf]])
    blind = CURVE.assign(variance_ci=variance_ci, rate_ci=("bound", [-np.inf, np.inf]))
    found = row(convergence=blind, predict=PREDICTED)
    assert (found.rate_low, found.rate_high) == (-np.inf, np.inf)
    assert rate(found.rate, found.rate_low, found.rate_high) == "unresolved"
    assert summary_table([found]).rows[0][2].text == "unresolved"
    assert found.ratio_low == 0.0
