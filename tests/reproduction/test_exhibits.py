"""Every claim of every quick exhibit agrees; exhibits with other tests are made in those tests.

Exhibits that are marked slow are also made, with wrong parts, by the tests of their own files.
These tests compare the list of findings that disagree, so all other findings must agree.
"""

from functools import cache

import pytest

from mcspectra.plots import backend_bokeh
from mcspectra.reproduction.gallery import make_exhibit, texts

ELSEWHERE = {
    "direct-illumination",
    "environment-channels",
    "estimator",
    "real-and-integer-frequencies",
    "veach-pictures",
}
RENDERED = {"light-smoothing", "mis-slowest"}
SLOW = {
    "bias",
    "dimensionality",
    "generalised-formula",
    "importance-terms",
    "mis-slowest",
    "pair-correlation",
    "phase",
}

made = cache(make_exhibit)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,
            marks=[pytest.mark.render] * (name in RENDERED) + [pytest.mark.slow] * (name in SLOW),
        )
        for name in texts()
        if name not in ELSEWHERE
    ],
)
def test_all_findings_agree(name, sound):
    sound(*made(name, quick=True, seed=1))


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize("name", texts())
def test_bokeh_draws_every_plot(name):
    """The lecture is drawn by Matplotlib. The tests of plots draw all marks by both backends."""
    for plot in made(name, quick=True, seed=1)[0].plots:
        backend_bokeh.draw(plot)
