"""Plots of warps and of primary-space integrands: marks and texts."""

import math

import numpy as np
import pytest
from tests.plots.drawing import drawn_by_both, marks

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.plots.description import Heatmap, Line, ReferenceLine, Segments
from mcspectra.plots.kinds import describe

SIDE = 16


def warp(spec, dims=2):
    return mcs.quality.warp_quality(mcs.density(spec, dims=dims), resolution=SIDE)


def picture(integrand, density=None, dims=2):
    return mcs.explain.primary_picture(
        mcs.Estimator(integrand, density, dims=dims), resolution=SIDE
    )


def test_jumps_have_correct_positions():
    """The seam of the octahedral map runs from the center to the right."""
    plot = describe("warp", {"sphere": warp("sphere")})
    (torn,) = marks(plot, Segments)
    assert len(torn.ends) == SIDE / 2
    np.testing.assert_allclose(torn.ends[..., 1], 0.5)
    assert torn.ends[..., 0].min() == 0.5
    assert torn.ends[..., 0].max() == 1.0
    assert "jumps of length 0.5" in plot.words
    assert plot.panels[0].title == "sphere"
    drawn_by_both(plot)


def test_axes_are_not_swapped():
    """The warp of a table jumps between rows at u_1 = ¼, for all u_0."""
    plot = describe("warp", {"table": warp("piecewise-constant(values=[[1, 2], [8, 1]])")})
    (torn,) = marks(plot, Segments)
    np.testing.assert_allclose(torn.ends[..., 1], 0.25)
    (stretch,) = marks(plot, Heatmap)
    assert stretch.values.shape == (SIDE, SIDE)


def test_grid_lines_are_interrupted_at_jumps():
    smooth, torn = (describe("warp", {"a": warp(s)}) for s in ("disk", "sphere"))
    gaps = [sum(np.isnan(line.x).sum() for line in marks(p, Line)) for p in (smooth, torn)]
    assert gaps[0] == 2 * SIDE  # one gap after each line
    assert gaps[1] > gaps[0]


def test_warps__several_results_and_a_single_one():
    plot = describe("warp", {"a": warp("disk"), "b": warp('disk(warp="polar")')})
    assert len({image.scale for image in marks(plot, Heatmap)}) == 1
    assert "continuous\nmean stretch" in plot.panels[1].x.label
    assert len(plot.panels) == 4
    assert describe("warp", warp("disk")).panels[0].title == "disk"
    drawn_by_both(describe("warp", warp("uniform")))


def test_warps__one_dim():
    plot = describe("warp", {"table": warp("piecewise-constant(values=[1, 0, 1])", 1)})
    (curve,), (jump,) = marks(plot, Line), marks(plot, ReferenceLine)
    assert np.isnan(curve.y).sum() == 1
    assert jump.at == pytest.approx(0.5)


def test_primary__interior_and_boundary():
    plot = describe("primary", {"half": picture("half-space(normal=[1, 0], offset=0.5)")})
    assert (
        plot.panels[0].x.label == "u₀\ninside 1.00 × 1.00\nsides 1.00 × 1.00"
    )  # two lines, since one line would be too long
    assert plot.labels == ("jump inside", "jump between opposite sides")
    whole = [line for line in marks(plot, Line) if np.isfinite(line.x + line.y).all()]
    assert [set(line.x) for line in whole] == [{0.0}, {1.0}]
    drawn_by_both(plot)


def test_primary__one_dim_and_poles():
    data = {
        "step": picture("step(at=0.3)", "linear(slope=1)", 1),
        "pole": picture("constant", "linear(slope=2)", 1),
    }
    plot = describe("primary", data)
    assert "sides unbounded" in plot.words
    assert "inside 1.00 ×" in plot.words
    drawn_by_both(plot)


def test_primary__constant_and_channels():
    assert "inside none, sides none" in describe("primary", picture("constant")).words
    colors = mcs.Integrand.from_function(lambda x: x[..., [0, 1, 0]], dims=2)
    assert (
        "sides 2.00 ×"
        in describe("primary", mcs.explain.primary_picture(colors, resolution=SIDE)).words
    )


@pytest.mark.parametrize("kind", ["warp", "primary"])
def test_missing_variables_and_mixed_dims_give_errors(kind):
    make = {"warp": lambda d: warp("uniform", d), "primary": lambda d: picture("constant", dims=d)}
    with pytest.raises(ParameterError, match="cannot share a figure"):
        describe(kind, {"a": make[kind](2), "b": make[kind](1)})
    with pytest.raises(ParameterError, match="has no"):
        describe(kind, {"a": warp("uniform").drop_vars(["jump"])})
    assert not math.isnan(sum(panel.x.high for panel in describe(kind, make[kind](2)).panels))
