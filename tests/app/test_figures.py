"""Figures of a set-up: new results change only data, and texts contain the measured values."""

from dataclasses import replace

import pytest
from bokeh.document import Document

from mcspectra.app.compute import UPDATE_KINDS, compute
from mcspectra.app.figures import FIGURES, figures_of
from mcspectra.app.state import ExplorerSetup
from mcspectra.plots.backend_bokeh import Drawn, draw
from mcspectra.plots.text import number

SMALL = ExplorerSetup(n=16, half_width=4, counts=(4, 16, 64))
SETUPS = {
    "two dims": SMALL,
    "one dim": replace(SMALL, half_width=8, dims=1, sampler="jittered | shift"),
    "weights": replace(SMALL, density="linear(slope=1.0)"),
    "real frequencies": replace(SMALL, frequency_step=0.25),
    "techniques": replace(SMALL, integrand="technique-sum(integrands=['gaussian', 'disk'])"),
}


@pytest.mark.parametrize("name", SETUPS)
def test_new_results_bring_no_new_models(name):
    setup = SETUPS[name]
    drawn: dict[str, Drawn] = {}
    document = Document()
    for kind in UPDATE_KINDS:
        for plot in figures_of(kind, compute(kind, setup, 8), "s"):
            drawn[plot.kind] = draw(plot)
            document.add_root(drawn[plot.kind].model)
    assert set(drawn) <= set(FIGURES)
    assert len(drawn) == 9 + (name == "one dim")  # The cross matrix is only drawn in one dim
    before = set(document.models)
    for kind in UPDATE_KINDS:
        for plot in figures_of(kind, compute(kind, setup, 16), "s"):
            assert drawn[plot.kind].fits(plot), plot.kind
            drawn[plot.kind].update(plot)
    assert set(document.models) == before


def test_texts_contain_the_measured_values():
    setup = SETUPS["two dims"]
    said = {
        plot.kind: plot.words
        for kind in UPDATE_KINDS
        for plot in figures_of(kind, compute(kind, setup, 16), "s")
    }
    terms = compute("terms", setup, 16)
    assert number(float(terms["measured_variance"])) in said["terms"]
    assert "16 points" in said["points"]
    assert said["integrand"].startswith("f from ")
    assert all(len(text) > 20 for text in said.values())
