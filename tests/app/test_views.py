"""Figures change their data only: no models come or go once they stand on the page."""

from __future__ import annotations

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.models import ColumnDataSource
from mcspectra.app.look import LOOKS
from mcspectra.app.views import ConvergenceView, make_views

from mcspectra.app.compute import compute
from mcspectra.app.state import Setup

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
    terms, curve = compute("terms", setup, 16), compute("convergence", setup, 16)
    assert f"measured {float(terms['measured_variance']):.4g}" in said["TermsView"]
    assert f"Fitted rate {float(curve['rate']):.3f}" in said["ConvergenceView"]
    assert said["PointsView"] == "16 points, all weights 1."


def test_rounding_noise_is_neither_shown_nor_fitted() -> None:
    setup = SETUPS["two dims"]
    curve = compute("convergence", setup, 16).copy(deep=True)
    view = ConvergenceView(setup, LOOKS["light"])
    assert "rounding" not in view.show(curve)
    shown, lines = [], []
    for noise in (1e-40, 1e-36):
        curve["variance"][-1] = noise
        curve["variance_ci"][-1] = [0.5 * noise, 2.0 * noise]
        assert f"1 of {curve.sizes['n']} counts are rounding noise" in view.show(curve)
        points, line = (
            next(each.data for each in view.figure.select(ColumnDataSource) if name in each.data)
            for name in ("v", "fit")
        )
        shown.append(list(points["v"]))
        lines.append(line["fit"].tolist())
    assert shown[0] == shown[1] == curve["variance"].values[:-1].tolist()
    assert lines[0] == lines[1]
    # The line has the fitted rate
    n = curve["n"].values
    rate = np.log(lines[0][-1] / lines[0][0]) / np.log(n[-1] / n[0])
    assert rate == pytest.approx(float(curve["rate"]))
