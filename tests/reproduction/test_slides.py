"""Names of exhibits."""

from urllib.parse import parse_qsl, urlencode

import pytest

from mcspectra.app.state import ExplorerState
from mcspectra.core.errors import UnknownName
from mcspectra.reproduction.gallery import exhibit_names, load_exhibit, texts

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
    "validity",
    "generalised-formula",
    "importance-terms",
    "phase",
    "dimensionality",
    "direct-illumination",
    "veach-pictures",
    "mis-slowest",
    "environment-channels",
    "mirroring",
    "future-directions",
    "light-smoothing",
    "importance-spectra",
    "pair-correlation",
    "bias",
]


def test_all_exhibits_are_in_the_order_of_the_slides():
    assert exhibit_names([]) == list(texts()) == _ORDER


def test_chosen_names_are_distinct_and_keep_the_order():
    assert exhibit_names(["bias", "phase", "bias"]) == ["phase", "bias"]


def test_errors_for_unknown_names_suggest_similar_names():
    with pytest.raises(UnknownName, match="no figure called 'biass'.*Did you mean 'bias'"):
        exhibit_names(["phase", "biass"])
    with pytest.raises(UnknownName):
        load_exhibit("")


def test_slides_are_numbered_without_gaps_and_figures_are_distinct():
    slides = [slide for each in texts().values() for slide in each.slides]
    assert sorted(slide.number for slide in slides) == list(range(1, len(slides) + 1))
    assert len({slide.figure for slide in slides}) == len(slides)
    for each in texts().values():
        used = {kind for slide in each.slides for kind in (slide.figure, *slide.more)}
        assert used == set(each.plots)


def test_every_link_is_a_state_of_the_explorer():
    for each in texts().values():
        for slide in each.slides:
            if slide.explorer:
                query = urlencode(parse_qsl(slide.explorer))
                state = ExplorerState.from_query(query)
                assert ExplorerState.from_query(state.query()) == state
