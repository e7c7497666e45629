"""Figures of pair correlations, remedies and maps, and the text that a store keeps apart."""

import numpy as np
import pytest

from mcspectra.core.results import dataset
from mcspectra.report.further_pictures import (
    map_pictures,
    pair_pictures,
    remedy_pictures,
    with_labels,
)
from mcspectra.report.sentences import further_sentences


def correlation(values=(0.0, 0.5, 1.0)):
    g = np.array(values)
    return dataset(
        {"pair_correlation": (("r",), g), "pair_correlation_se": (("r",), np.full(3, 0.1))},
        {"r": [0.1, 0.2, 0.3]},
        n=16,
    )


def stored_remedies():
    """What a study's cell holds: text as attributes."""
    ratio = np.array([0.5, 1.0])
    found = dataset(
        {
            "error_ratio": (("remedy",), ratio),
            "error_ratio_ci": (("remedy", "bound"), np.stack([ratio / 1.2, ratio * 1.2], -1)),
        },
        {},
        diagnosis="g jumps.",
        recommendation="Sample with owen.",
    )
    return found.assign_attrs(
        labels_remedy=["owen", "as given"], labels_verdict=["better", "given"]
    )


def stored_map():
    rng = np.random.default_rng(1)
    values = rng.random((2, 3, 4))
    return dataset(
        {
            "mean": (("strategy", "y", "x"), values),
            "variance": (("strategy", "n", "y", "x"), values[:, None] * np.ones((2, 2, 1, 1))),
            "rate": (("strategy", "y", "x"), -1.0 - values),
            "rate_se": (("strategy", "y", "x"), values),
        },
        {"n": [4, 16], "y": np.arange(3), "x": np.arange(4)},
    ).assign_attrs(labels_strategy=["light", "bsdf"])


def test_pair_correlations_are_one_figure():
    (picture,) = pair_pictures({"random": correlation(), "shift": correlation()}, None)
    assert picture.kind == "pair-correlation"
    assert "random: least 0 at r = 0.100" in picture.alt


def test_pair_correlations_without_numbers():
    (picture,) = pair_pictures({"random": correlation((np.nan,) * 3)}, None)
    assert "random: no number." in picture.alt


def test_remedies_have_a_figure_for_each_sampler():
    found = list(remedy_pictures({"a": stored_remedies(), "b": stored_remedies()}, {}))
    assert [p.kind for p in found] == ["remedies-0", "remedies-1"]
    assert "owen 0.500, as given 1.00" in found[1].alt
    (axes,) = found[0].figure.axes
    assert [t.get_text() for t in axes.get_yticklabels()] == ["owen", "as given"]


def test_maps_have_a_figure_for_each_quantity():
    found = list(map_pictures({"a": stored_map(), "b | c": stored_map()}, {}))
    kinds = ["mean", "variance", "rate"]
    assert [p.kind for p in found] == [f"map-{i}-{k}" for i in (0, 1) for k in kinds]
    assert all(p.wide for p in found)
    assert "4 × 3 pixels for b | c" in found[-1].alt
    assert [axes.get_title() for axes in found[0].figure.axes[:2]] == ["light", "BSDF"]


def test_labels_of_another_length_are_left_alone():
    stored = stored_remedies().assign_attrs(labels_other=["one"])
    found = with_labels(stored, "remedy")
    assert list(found["verdict"].values) == ["better", "given"]
    assert "other" not in found.coords


@pytest.mark.parametrize(
    ("analyses", "text"),
    [
        ({}, ""),
        ({"remedies": stored_remedies()}, "g jumps. Sample with owen."),
        ({"exact": dataset({}, {}, note="No form.")}, "No exact variance at every n: No form."),
        ({"exact": dataset({}, {})}, ""),
    ],
)
def test_further_sentences(analyses, text):
    assert further_sentences(analyses) == text
