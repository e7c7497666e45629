"""Plots of components and of their numbers, each drawn by both libraries."""

import math

import matplotlib as mpl
import numpy as np
import pytest
from tests.plots.drawing import drawn_by_both, marks

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.plots.components import component_result
from mcspectra.plots.description import BarChart, Dots, Heatmap, Line, TextMark
from mcspectra.plots.groups import as_group
from mcspectra.plots.kinds import describe
from mcspectra.plots.variance import overlaid

mpl.use("Agg")


def described(component, kind=None, **options):
    """Return the plot of a component, drawn by both backends."""
    plot = describe(*component_result(component, kind, **options))
    drawn_by_both(plot)
    return plot


@pytest.mark.parametrize("dims", [1, 2])
def test_f_and_p_share_an_axis_with_the_samples(dims):
    density = mcs.density("linear(slope=1)", dims=dims)
    plot = described(mcs.Estimator("gaussian(width=0.3)", density, dims=dims), n=16)
    x = density.sample(mcs.sampler("jittered", dims=dims).draw(16, rng=0)[0])
    dots = marks(plot, Dots)[-1]
    np.testing.assert_array_equal(dots.x, x[:, 0])
    if dims == 1:
        f, p = marks(plot, Line)
        assert p.y.mean() == pytest.approx(f.y.mean(), rel=1e-3)  # ∫p = 1, and 256 cells
        assert dots.marker == "|"
        assert (dots.y < min(f.y.min(), p.y.min())).all()
    else:
        f, p = marks(plot, Heatmap)
        at = (np.arange(64) + 0.5) / 64
        grid = np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1)
        np.testing.assert_allclose(p.values, density.pdf(grid).T)


def test_functions_alone_have_no_points_and_densities_show_p():
    assert not marks(described(mcs.integrand("disk", dims=2)), Dots)
    assert not marks(described(mcs.integrand("step", dims=1)), Dots)
    plot = described(mcs.density("linear(slope=1)", dims=1))
    assert plot.labels == ("p", "jittered")
    assert plot.caption.startswith("The density p with")


def test_more_dims_are_cut_through_the_center():
    plot = described(mcs.Estimator("gaussian(width=0.3)", dims=3), n=8)
    assert "section through the center of 3 dims" in plot.caption
    (f,) = marks(plot, Heatmap)
    x = [(0.5 + k) / 64 for k in (3, 50)]
    exact = mcs.integrand("gaussian(width=0.3)", dims=3)(np.array([*x, 0.5]))
    assert f.values[50, 3] == pytest.approx(float(exact))


def test_only_strata_cut_by_an_edge_cause_variance():
    """A stratum that an edge cuts into s and 1 − s has the variance s (1 − s) / n²."""
    f = mcs.Integrand.from_function(lambda x: (x[..., 0] < 0.35).astype(float), dims=1)
    kind, found = component_result(mcs.Estimator(f), "strata", n=8)
    (data,) = found.values()
    s = 8 * 0.35 - 2
    parts = data["stratum_variance"].values
    assert np.flatnonzero(parts).tolist() == [2]
    assert parts[2] == pytest.approx(s * (1 - s) / 64, abs=1 / 256 / 64)  # 256 cells per stratum
    slides = data["sliding_variance"].values
    assert slides[0] == pytest.approx(parts.sum())
    assert slides[-1] == pytest.approx(slides[0])
    # At its best offset, the edge at 0 that the torus has is still cut
    moved = np.mod(s - data["offset"].values, 1.0)
    edge = np.mod(-data["offset"].values, 1.0)
    exact = (moved * (1 - moved) + edge * (1 - edge)) / 64
    np.testing.assert_allclose(slides, exact, atol=2 / 256 / 64)
    plot = describe(kind, found)
    drawn_by_both(plot)
    assert len(plot.panels) == 2


def test_strata_in_two_dims_are_a_map():
    plot = described(mcs.Estimator("disk", dims=2), "strata", n=16)
    (cells,) = marks(plot, Heatmap)
    assert cells.values.sum() == pytest.approx(1.0)
    with pytest.raises(ParameterError, match="k\\^d"):
        component_result(mcs.Estimator("disk", dims=2), "strata", n=15, sampler="random")


@pytest.mark.parametrize("f", ["gaussian(width=0.3)", "step"])
def test_the_histogram_has_the_mean_and_deviation_of_the_estimates(f):
    estimator = mcs.Estimator(f, dims=1)
    plot = described(estimator, "estimates", n=16, sampler="random")
    (bars,) = marks(plot, BarChart)
    assert bars.value.sum() == pytest.approx(1.0)
    sigma = math.sqrt(float(mcs.exact_variance(estimator, "random", 16)))
    mean = float((bars.at * bars.value).sum())
    assert mean == pytest.approx(estimator.integral, abs=5 * sigma / math.sqrt(1000))
    (curve,) = marks(plot, Line)
    width = bars.at[1] - bars.at[0]
    top = width / (sigma * math.sqrt(2 * math.pi))
    assert curve.y.max() == pytest.approx(top, rel=5 / math.sqrt(2 * 1000))
    if f == "step":
        assert width == pytest.approx(1 / 16)


def test_the_product_of_powers_sums_to_the_power_term():
    found = {
        name: mcs.variance_terms(
            "gaussian(width=0.2)", name, 16, dims=1, half_width=8, realizations=50, rng=1
        )
        for name in ("random", "jittered | shift")
    }
    plot = describe("product", found)
    drawn_by_both(plot)
    f, s, both = plot.panels
    (power,) = (mark for mark in f.marks if isinstance(mark, Line))
    for line, product, data in zip(
        (m for m in s.marks if isinstance(m, Line)), both.marks, found.values(), strict=True
    ):
        assert product.y.sum() == pytest.approx(float(data["power_term"]))
        np.testing.assert_allclose(power.y * line.y / 16, product.y)
    assert "sum" in plot.labels[0]


def test_predictions_at_other_counts_overlay_the_curves_with_slopes():
    curve = mcs.convergence("gaussian(width=0.3)", "random", [4, 16], dims=1, realizations=50)
    theory = mcs.predict("gaussian(width=0.3)", "random", [4, 16, 64], dims=1)
    plot = describe("convergence", overlaid(as_group(curve)[0], as_group(theory)[0]))
    drawn_by_both(plot)
    (crosses,) = (dots for dots in marks(plot, Dots) if dots.label == "predicted")
    np.testing.assert_array_equal(crosses.x, [4.0, 16.0, 64.0])
    (slope,) = (line for line in marks(plot, Line) if line.label == "theory's slope")
    assert np.diff(np.log(slope.y)) / np.diff(np.log(slope.x)) == pytest.approx(-1.0)
    (text,) = marks(plot, TextMark)
    assert text.text.endswith("(theory −1.00)")
    assert plot.panels[0].x.high > 64
    assert curve.mcspectra.plot(overlay=theory).get_ylabel() == "variance"
    with pytest.raises(ParameterError, match="overlay is a result of predict"):
        curve.mcspectra.plot(overlay=curve)


def test_slopes_of_equal_curves_do_not_overlap():
    curve = mcs.convergence("gaussian(width=0.3)", "random", [4, 16], dims=1, realizations=50)
    plot = describe("convergence", dict.fromkeys("abc", curve))
    axis = plot.panels[0].y
    heights = sorted(math.log(text.y) for text in marks(plot, TextMark))
    assert len(heights) == 3
    assert np.diff(heights).min() > 0.05 * math.log(axis.high / axis.low) / 2
    assert heights[-1] < math.log(axis.high)


def test_components_have_a_method_plot():
    sampler = mcs.sampler("jittered", dims=2)
    assert sampler.plot().get_xlabel() == "x₀"
    assert sampler.plot("spectrum", n=16).get_xlabel() == "m₀ (cycles)"
    assert mcs.density("linear(slope=1)", dims=1).plot().get_ylabel() == "p(x)"
    assert mcs.integrand("step", dims=1).plot().get_ylabel() == "f(x)"
    assert len(mcs.Estimator("step", dims=1).plot("strata")) == 2
    with pytest.raises(ParameterError, match="kind"):
        sampler.plot("strata")
    with pytest.raises(ParameterError, match="has no plot"):
        component_result(mcs.samplers.Shift())
