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


def test_all_exhibits_stand_in_the_order_of_the_slides():
    assert exhibit_names([]) == list(slides()) == _ORDER


def test_chosen_names_keep_that_order_and_come_once():
    assert exhibit_names(["bias", "phase", "bias"]) == ["phase", "bias"]


def test_unknown_names_are_answered_with_close_ones():
    with pytest.raises(UnknownName, match="no figure called 'biass'.*Did you mean 'bias'"):
        exhibit_names(["phase", "biass"])
    with pytest.raises(UnknownName):
        load_exhibit("")
