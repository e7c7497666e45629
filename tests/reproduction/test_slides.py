"""Names of exhibits."""

import pytest

from mcspectra.core.errors import UnknownName
from mcspectra.reproduction.gallery import exhibit_names, load_exhibit, slides

_ORDER = [
    "estimator",
    "power-spectra",
    "variance-integral",
    "real-and-integer-frequencies",
    "closed-forms",
    "homogenisation",
    "homogenisation-convergence",
    "strata-alignment",
    "homogenised-formula",
    "generalised-formula",
    "importance-terms",
    "phase",
    "dimensionality",
    "direct-illumination",
    "veach-pictures",
    "mis-slowest",
    "environment-channels",
    "mirroring",
    "light-smoothing",
    "importance-spectra",
    "pair-correlation",
    "bias",
]


def test_all_exhibits_are_in_the_order_of_the_slides():
    assert exhibit_names([]) == list(slides()) == _ORDER


def test_chosen_names_are_distinct_and_keep_the_order():
    assert exhibit_names(["bias", "phase", "bias"]) == ["phase", "bias"]


def test_errors_for_unknown_names_suggest_similar_names():
    with pytest.raises(UnknownName, match="no figure called 'biass'.*Did you mean 'bias'"):
        exhibit_names(["phase", "biass"])
    with pytest.raises(UnknownName):
        load_exhibit("")
