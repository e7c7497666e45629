"""Figures change their data only: no models come or go once they stand on the page."""

from __future__ import annotations

import pytest
from bokeh.document import Document
from bokeh.models import ColumnDataSource

from mcspectra.app.compute import compute
from mcspectra.app.state import Setup
from mcspectra.app.views import make_views

SETUPS = {
    "two dims": Setup(n=16, half_width=4),
    "one dim": Setup(n=16, half_width=8, dims=1, sampler="jittered | shift"),
    "weights": Setup(n=16, half_width=4, density="linear(slope=1.0)"),
    "real frequencies": Setup(n=16, half_width=4, frequency_step=0.25),
}


@pytest.mark.parametrize("name", SETUPS)
def test_new_results_bring_no_new_models(name: str) -> None:
    setup = SETUPS[name]
    views = make_views(setup, "light")
    document = Document()
    for view in views:
        document.add_root(view.figure)
        view.show(compute(view.kind, setup, 8))
    before = set(document.models)
    data = {each.id: each.data for each in document.models if isinstance(each, ColumnDataSource)}
    for view in views:
        view.show(compute(view.kind, setup, 16))
    assert set(document.models) == before
    kept = [each for each in before if data.get(each.id) is getattr(each, "data", None)]
    assert not [each for each in kept if isinstance(each, ColumnDataSource)]


def test_every_sentence_holds_what_was_measured() -> None:
    setup = SETUPS["two dims"]
    said = {
        type(view).__name__: view.show(compute(view.kind, setup, 16))
        for view in make_views(setup, "dark")
    }
    terms, curve = compute("terms", setup, 16), compute("curve", setup, 16)
    assert f"measured {float(terms['measured_variance']):.4g}" in said["TermsView"]
    assert f"Fitted rate {float(curve['rate']):.3f}" in said["ConvergenceView"]
    assert said["PointsView"] == "16 points, all weights 1."
