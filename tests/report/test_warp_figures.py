"""Figures of warps and of primary-space integrands: what they draw and say."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.report import figures

SIDE = 16


def texts(figure):
    from matplotlib.text import Text

    figure.canvas.draw()
    return "\n".join(t.get_text() for t in figure.findobj(Text) if t.get_visible())


def warp(spec, dims=2):
    return mcs.warp_quality(mcs.density(spec, dims=dims), resolution=SIDE)


def picture(integrand, density=None, dims=2):
    return mcs.primary_picture(mcs.Estimator(integrand, density, dims=dims), resolution=SIDE)


def segments(figure):
    found = [c.get_segments() for c in figure.axes[1].findobj(LineCollection)]
    return [s for each in found for s in each if len(s)]


def test_warp_maps__jumps_lie_where_they_are():
    """The seam of the octahedral map: from the centre to the right."""
    figure = figures.warp_maps({"sphere": warp("sphere")})
    drawn = np.array(segments(figure))
    assert len(drawn) == SIDE / 2
    np.testing.assert_allclose(drawn[..., 1], 0.5)
    assert drawn[..., 0].min() == 0.5
    assert drawn[..., 0].max() == 1.0
    shown = texts(figure)
    assert "jumps of length 0.5" in shown
    assert "sphere" in shown


def test_warp_maps__an_axis_is_not_swapped():
    """Rows of a table tear along u_1 = ¼, all along u_0."""
    figure = figures.warp_maps({"table": warp("piecewise-constant(values=[[1, 2], [8, 1]])")})
    drawn = np.array(segments(figure))
    np.testing.assert_allclose(drawn[..., 1], 0.25)
    stretch = figure.axes[1].images[0].get_array()
    assert stretch.shape == (SIDE, SIDE)


def test_warp_maps__several_and_one_alone():
    shown = texts(figures.warp_maps({"a": warp("disk"), "b": warp('disk(warp="polar")')}))
    assert "continuous" in shown
    assert "mean stretch" in shown
    assert "disk" in texts(figures.warp_maps(warp("disk")))
    assert texts(figures.warp_maps(warp("uniform")))


def test_warp_maps__one_dim():
    figure = figures.warp_maps({"table": warp("piecewise-constant(values=[1, 0, 1])", 1)})
    (curve, *marks) = figure.axes[0].lines
    assert np.isnan(curve.get_ydata()).sum() == 1
    assert len(marks) == 1
    assert marks[0].get_xdata()[0] == pytest.approx(0.5)


def test_primary_pictures__interior_and_boundary():
    figure = figures.primary_pictures({"half": picture("half-space(normal=[1, 0], offset=0.5)")})
    shown = texts(figure)
    assert "inside 1 × 1, sides 1 × 1" in shown
    assert "jump between opposite sides" in shown
    lines = [line for line in figure.axes[0].lines if len(line.get_xdata()) == SIDE]
    marked = [line for line in lines if np.isfinite(line.get_xdata() + line.get_ydata()).all()]
    assert [set(line.get_xdata()) for line in marked] == [{0.0}, {1.0}]


def test_primary_pictures__one_dim_and_poles():
    data = {
        "step": picture("step(at=0.3)", "linear(slope=1)", 1),
        "pole": picture("constant", "linear(slope=2)", 1),
    }
    shown = texts(figures.primary_pictures(data))
    assert "sides unbounded" in shown
    assert "inside 1 ×" in shown


def test_primary_pictures__constant_and_channels():
    assert "inside none, sides none" in texts(figures.primary_pictures(picture("constant")))
    colors = mcs.Integrand.from_function(lambda x: x[..., [0, 1, 0]], dims=2)
    data = mcs.primary_picture(colors, resolution=SIDE)
    assert "sides 2 ×" in texts(figures.primary_pictures(data))


@pytest.mark.parametrize("name", ["warp_maps", "primary_pictures"])
def test_bad_input(name):
    draw = getattr(figures, name)
    with pytest.raises(ParameterError, match="has no"):
        draw({"a": mcs.warp_quality("uniform", resolution=4).drop_vars(["jump"])})
    with pytest.raises(ParameterError, match="needs a dataset"):
        draw({})
    with pytest.raises(ParameterError, match="needs a dataset"):
        draw(3)


def test_dims_are_not_mixed():
    with pytest.raises(ParameterError, match="different figures"):
        figures.warp_maps({"a": warp("uniform"), "b": warp("uniform", 1)})


def test_warp_maps__four_stand_two_by_two():
    names = ["disk", 'disk(warp="polar")', "sphere", "hemisphere"]
    figure = figures.warp_maps({name: warp(name) for name in names})
    panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
    assert len(panels) == 8
    places = {(s.rowspan.start, s.colspan.start) for s in (a.get_subplotspec() for a in panels)}
    assert places == {(row, column) for row in range(4) for column in range(2)}
