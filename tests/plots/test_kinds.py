"""Kinds of plots: every analysis has a plot, and unusual results can be drawn."""

import dataclasses
import math

import numpy as np
import pytest
import xarray as xr
from tests.plots.drawing import drawn_by_both, marks
from tests.testing.test_analyses import QUICK

import mcspectra as mcs
from mcspectra.core.analysis import ANALYSES, Subject, compute
from mcspectra.core.errors import ParameterError
from mcspectra.plots import backend_matplotlib
from mcspectra.plots.description import BarChart, Dots, Heatmap, Line, ReferenceLine
from mcspectra.plots.groups import labelled
from mcspectra.plots.kinds import PLOT_KINDS, describe, kinds_of
from mcspectra.plots.style import TERM_COLORS, sampler_styles
from mcspectra.plots.variance import usable_counts
from mcspectra.reproduction.claims import Measured
from mcspectra.reproduction.panels import term_panel

# Kinds of plots of the results of `QUICK`
PATHS = (
    "map-bounces",
    "map-decisions",
    "map-largest-bounce",
    "map-largest-decision",
    "map-best-sampler",
)
PLOTS = {
    "convergence": ["convergence"],
    "terms": ["terms", "captured", "contributions", "product", "bands"],
    "techniques": ["techniques", "technique-rates"],
    "spectrum": ["spectrum", "radial"],
    "points": ["points"],
    "pcf": ["pair-correlation"],
    "anova": ["anova"],
    "anova-spectrum": ["anova"],
    "predict": ["prediction"],
    "plan": ["prediction"],
    "profile": ["profile"],
    "remedies": ["remedies"],
    "modes": ["modes"],
    "map": [
        kind
        for kind in PLOT_KINDS
        if kind.startswith("map-") and kind not in {*PATHS, "map-interpolation"}  # of a subset
    ],
}
TERMS = ("terms", "captured", "contributions", "product", "bands")
# Marks that differ between dims are in contributions and products; other kinds have the same axes
EVERY_DIM = [
    pytest.param(
        dims,
        kind,
        marks=[pytest.mark.slow] if dims > 1 and kind not in ("contributions", "product") else [],
    )
    for dims in (1, 2, 3)
    for kind in TERMS
]


def said(plot):
    """Return all text of a plot as one string."""
    found = [plot.caption, plot.words, *plot.labels]
    for panel in plot.panels:
        found += [panel.title, panel.note, panel.x.label, panel.y.label]
        found += [t for axis in (panel.x, panel.y) for t in (axis.ticks or {}).values()]
        found += [text for mark in panel.marks for text in getattr(mark, "texts", ())]
    return "\n".join(found)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.render) if n == "map" else n for n in QUICK]
)
def test_every_analysis_has_plots_that_both_backends_draw(name):
    (options, estimator, sampler), expected = QUICK[name], PLOTS[name]
    if isinstance(estimator, str):
        estimator = mcs.estimators.as_estimator(estimator)
    dims = 2 if estimator is None else estimator.dims
    subject = Subject(estimator, mcs.sampler(sampler, dims=dims))
    result = compute(ANALYSES.load(name)(**options), subject)
    assert list(kinds_of(result)) == expected
    for kind in expected:
        plot = describe(kind, result)
        assert plot.kind == kind
        assert plot.caption.endswith(".")
        assert plot.words.endswith(".")
        # `test_maps` draws all layers of a map
        if name != "map" or kind == expected[0]:
            drawn_by_both(plot)
        # Several results by name also give one plot; other tests draw pairs of terms and of maps
        several = describe(kind, {"one": result, "another | of them": result})
        assert several.kind == kind
        if kind == expected[0] and name not in ("terms", "map"):
            drawn_by_both(several)


def test_methods__one_row_per_method_at_the_largest_n():
    """Methods without a value have no row; the dots are at the values."""
    samplers = ["random", "sobol | owen"]
    found = mcs.predict("gaussian", samplers, [16, 64], method="all", half_width=4, realizations=50)
    assert kinds_of(found) == ("prediction",)
    plot = describe("prediction", found)
    for panel, sampler in zip(plot.panels, samplers, strict=True):
        one = found.sel(sampler=sampler).isel(n=-1)
        there = one["predicted_variance"].notnull().values
        assert 1 < there.sum() < there.size
        assert list(panel.y.ticks.values()) == one["method"].values[there].tolist()
        (dots,) = panel.marks
        np.testing.assert_array_equal(dots.x, one["predicted_variance"].values[there])
    assert "n = 64" in plot.caption
    drawn_by_both(plot)


def test_chains__spectra_and_shares_of_one_and_of_many():
    draws = np.random.default_rng(1).standard_normal((2, 300, 8))
    one, many = mcs.measure.chain_error(draws[..., 0]), mcs.measure.chain_error(draws)
    assert kinds_of(one) == kinds_of(many) == ("chains",)
    plot = describe("chains", one)
    draw, error = (line.y for line in marks(plot, Line)[-2:])
    np.testing.assert_array_equal(error, one["error_share"])
    np.testing.assert_array_equal(draw, one["draw_share"])
    plot = describe("chains", many)
    assert "2 quantities with more effective draws are omitted" in plot.caption
    assert len(plot.labels) == 6
    drawn_by_both(plot)
    drawn_by_both(describe("chains", {"a": one, "still": mcs.measure.chain_error(np.ones(300))}))
    drawn_by_both(describe("chains", mcs.measure.chain_error(np.ones(300))))


@pytest.mark.parametrize(("dims", "kind"), EVERY_DIM)
def test_terms__every_dim(make, kind, dims):
    data = make["terms"](dims=dims, n={1: 16, 2: 16, 3: 8}[dims], half_width=3, realizations=20)
    plot = describe(kind, {"jittered": data, "other": data})
    assert "jittered" in said(plot)
    assert "other" in said(plot)
    drawn_by_both(plot)


@pytest.mark.parametrize(("dims", "kind"), [each for each in EVERY_DIM if each.values[0] < 3])
def test_terms__infinite_terms_are_labeled(make, kind, dims):
    plot = describe(kind, {"random": make["infinite"](dims=dims, half_width=3, realizations=20)})
    assert "infinite" in said(plot) or "no finite" in said(plot)
    assert "nan" not in said(plot).lower()
    drawn_by_both(plot)


@pytest.mark.parametrize("kind", TERMS)
def test_terms__zero_variance(make, kind):
    data = make["terms"](half_width=3, realizations=20)
    zero = data.map(lambda v: v * 0.0, keep_attrs=True)
    zero["captured_by_half_width"] = zero["captured_by_half_width"] * math.nan
    drawn_by_both(describe(kind, {"regular": zero}))


def test_terms__bars_are_a_waterfall_with_the_intervals_of_the_terms(make):
    data = make["terms"]()
    names = ("dc_term", "power_term", "cross_term", "predicted_variance", "measured_variance")
    for name in names[1:3]:
        data[f"{name}_ci"] = ("bound", float(data[name]) * np.array([0.5, 2.0]))
    plot = describe("terms", {"jittered": data})
    (bars,) = marks(plot, BarChart)
    terms = [float(data[n]) for n in names]
    np.testing.assert_allclose(bars.value - bars.base, terms, atol=1e-18)
    np.testing.assert_allclose(bars.base[1:3], bars.value[:2])  # each begins where the last ended
    np.testing.assert_allclose(bars.value[2], terms[3])  # and the last one ends at the prediction
    np.testing.assert_array_equal(bars.base[3:], 0.0)
    ends = np.stack([bars.low, bars.high], axis=1)
    assert np.isnan(ends[0]).all()
    shifted = [data[f"{n}_ci"] + start for n, start in zip(names[1:], bars.base[1:], strict=True)]
    np.testing.assert_allclose(ends[1:], shifted)
    (panel,) = plot.panels
    assert panel.x.kind == "linear"
    assert panel.x.low <= 0.0 < np.max(bars.value) < panel.x.high


def test_terms__a_term_of_rounding_size_is_a_printed_number(make):
    data = make["terms"]()
    data["dc_term"] = data["dc_term"] * 0.0 + 1e-17
    plot = describe("terms", {"jittered": data})
    assert "≈ 0" in said(plot)
    (bars,) = marks(plot, BarChart)
    assert bars.value[0] == 0.0


def test_terms__colors_are_those_of_the_exhibits(make):
    data = make["terms"]()
    for name in ("dc_term", "power_term", "cross_term"):
        data[f"{name}_ci"] = ("bound", float(data[name]) * np.array([0.5, 2.0]))
    (bars,) = marks(describe("terms", {"jittered": data}), BarChart)
    panel = term_panel([1.0, 2.0, -1.0], Measured(2.0, 1.9, 2.1), 1.0, "title")
    (slide,) = (m for m in panel.marks if isinstance(m, BarChart))
    assert list(bars.color) == list(TERM_COLORS.values())
    assert list(slide.color) == list(bars.color)


def test_contributions__a_panel_for_each_technique(make):
    data = make["terms"](techniques=2, half_width=3, realizations=20)
    plot = describe("contributions", {"random": data, "jittered": data})
    assert [panel.title for panel in plot.panels[:2]] == [
        "random, technique 0",
        "random, technique 1",
    ]
    assert (len(plot.panels), plot.columns) == (4, 2)


def test_contributions__shells_sum_to_the_part_within_the_half_width(make):
    data = make["terms"](dims=3, n=8, half_width=2, realizations=20)
    (bars,) = marks(describe("contributions", {"x": data}), BarChart)
    m = np.arange(-2, 3)
    length = np.sqrt(sum(g**2 for g in np.meshgrid(m, m, m)))
    expected = data["contribution"].values[np.rint(length) <= 2].sum()
    assert bars.value.sum() == pytest.approx(expected)


def test_contributions__an_image_is_not_transposed(make):
    data = make["terms"](dims=2, half_width=3, realizations=20)
    (image,) = marks(describe("contributions", {"x": data}), Heatmap)
    np.testing.assert_array_equal(image.values, data["contribution"].transpose("m1", "m0"))
    np.testing.assert_array_equal(image.x, data["m0"])


@pytest.mark.parametrize(
    ("bands", "some"),
    [("anova", ["constant", "x0", "x1", "x0x1"]), ("wedge", ["constant", "0°", "15°", "165°"])],
)
def test_bands__have_their_names(bands, some):
    sampler = mcs.sampler("jittered", dims=2)
    terms = mcs.variance_terms("disk", sampler, 16, half_width=6, realizations=20, bands=bands)
    for panel in describe("bands", {"a": terms, "b": terms}).panels:
        assert set(some) <= set(panel.x.ticks.values())


def test_bands__shares_add_up_to_one_on_a_linear_axis(make):
    plot = describe("bands", {"x": make["terms"](dims=1, half_width=6, realizations=20)})
    assert sum(bars.value.sum() for bars in marks(plot, BarChart)) == pytest.approx(1.0)
    (panel,) = (p for p in plot.panels if p.y.label == "share of variance")
    assert panel.y.kind == "linear"
    assert panel.y.low <= min(b.value.min() for b in marks(plot, BarChart))


def test_bands__many_shells_have_whole_ticks_and_one_legend(make):
    data = make["terms"](dims=1, half_width=40, realizations=20)
    plot = describe("bands", {"a": data, "b": data})
    for panel in plot.panels:
        assert len(panel.x.ticks) <= 7
        assert all(tick.is_integer() for tick in panel.x.ticks)
    assert plot.labels == ("within the band", "with other bands")
    assert len({bars.color for bars in marks(plot, BarChart)}) == 2


def test_cross_matrix__real_and_imaginary(make):
    data = make["terms"](matrix=True, half_width=4, realizations=20)
    real, imaginary = marks(describe("cross-matrix", {"x": data}), Heatmap)
    np.testing.assert_array_equal(real.values, data["cross_matrix"].values.real)
    np.testing.assert_array_equal(imaginary.values, data["cross_matrix"].values.imag)


def test_cross_matrix__only_of_one_dimension(make):
    data = make["terms"](matrix=True, half_width=2, realizations=20)
    with pytest.raises(ParameterError, match="one-dimensional"):
        describe("cross-matrix", {"x": data.assign_coords(m_0=("m", data["m"].values))})


def cosine(data):
    """Return a result in a basis without negative frequencies."""
    m = {"m0": 0, "m1": 1, "m": 0, "l": 0}
    ends = {d: data[d].values - data[d].values[0] for d in m if d in data.coords}
    return data.assign_coords(ends).assign_attrs(basis="cosine")


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("contributions", {"dims": 1}),
        ("contributions", {"dims": 2}),
        ("cross-matrix", {"matrix": True, "dims": 1}),
    ],
)
def test_frequencies_of_different_bases_are_shown_and_labeled(make, kind, options):
    data = make["terms"](half_width=3, realizations=20, **options)
    plot = describe(kind, {"fourier one": data, "cosine one": cosine(data)})
    assert plot.share in ("", "y")
    assert {(panel.x.low, panel.x.high) for panel in plot.panels} == {(-3.5, 3.5), (-0.5, 6.5)}
    assert [("cosine basis" in panel.x.label) for panel in plot.panels] == [
        "cosine one" in panel.title for panel in plot.panels
    ]
    figure = backend_matplotlib.draw(plot)
    for panel, axes in zip(plot.panels, backend_matplotlib.panel_axes(figure), strict=True):
        assert axes.get_xlim() == (panel.x.low, panel.x.high)
        assert axes.get_xlabel() == panel.x.label
        assert axes.xaxis.label.get_visible()
    drawn_by_both(plot)
    same = describe(kind, {"one": data, "other": data})
    assert same.share == "both"
    assert "basis" not in said(same)


def test_convergence__intervals_without_upper_end_are_visible(make):
    data = make["curve"]("random", rate=-1.0)
    data["variance_ci"][0, 1] = math.inf
    (panel,) = describe("convergence", {"random": data}).panels
    assert panel.y.high >= 2.0 * float(data["variance"][0])


@pytest.mark.parametrize("kind", ["contributions", "spectrum"])
def test_different_half_widths_have_separate_limits(make, kind):
    make_it = make["terms" if kind == "contributions" else "spectrum"]
    plot = describe(kind, {f"h{h}": make_it(dims=2, half_width=h) for h in (2, 4)})
    assert plot.share == ""
    axes = backend_matplotlib.panel_axes(backend_matplotlib.draw(plot))
    assert [each.get_xlim() for each in axes] == [(-2.5, 2.5), (-4.5, 4.5)]


def test_cross_matrix__large_matrices_are_cropped_around_dc():
    m = np.arange(300)
    matrix = xr.DataArray(np.eye(300, dtype=complex), {"m": m, "l": m}, ("m", "l"))
    data = xr.Dataset({"cross_matrix": matrix}, {"m0": m}, attrs={"basis": "cosine"})
    first, _ = describe("cross-matrix", {"x": data}).panels
    assert (first.x.low, first.x.high) == (-0.5, 256.5)


def test_frequency_ticks_are_integers_and_the_legend_has_no_sampler_color(make):
    data = make["terms"](dims=1, half_width=2, realizations=20)
    plot = describe("contributions", {"one": data, "other": data})
    assert plot.labels == ("power part |fₘ|² Cₘₘ",)
    for kind in ("contributions", "captured"):
        for panel in describe(kind, data).panels:
            assert all(float(tick).is_integer() for tick in panel.x.ticks)


def test_the_first_channel_is_shown_and_named(make):
    data = make["terms"](channels=3, half_width=3, realizations=20)
    data["dc_term"][1:] = 99.0
    plot = describe("terms", {"x": data})
    assert "99" not in said(plot)
    assert plot.caption.endswith("Shown: channel 0 of 3.")
    assert [panel.title for panel in plot.panels] == ["channel 0 of 3: x"]


def test_spectrum__n_times_power_without_dc(make):
    data = make["spectrum"](dims=2, half_width=3)
    (image,) = marks(describe("spectrum", {"x": data}), Heatmap)
    expected = 16 * data["power"].values.T
    expected[3, 3] = np.nan
    np.testing.assert_allclose(image.values, expected)


def test_spectrum__one_color_scale(make):
    data = {s: make["spectrum"](s, dims=2, half_width=3) for s in ("random", "jittered")}
    assert len({image.scale for image in marks(describe("spectrum", data), Heatmap)}) == 1


@pytest.mark.parametrize("kind", ["spectrum", "lines"])
def test_spectrum__wrong_number_of_dims(make, kind):
    data = make["spectrum"](dims=3, n=8, half_width=2)
    assert kinds_of(data) == ("radial",)
    with pytest.raises(ParameterError, match="3 frequency dims"):
        describe(kind, {"x": data})


@pytest.mark.parametrize("dims", [1, 2, 3])
def test_radial__axis_in_units_of_the_root_of_n(make, dims):
    data = make["spectrum"](dims=dims, n=64, half_width=3)
    (line,) = [m for m in marks(describe("radial", {"x": data}), Line) if m.label]
    np.testing.assert_allclose(line.x, data["radius"].values / 64 ** (1 / dims))
    np.testing.assert_allclose(line.y, np.maximum(64 * data["radial_power"].values, 1e-4))


def test_convergence__fitted_line_and_label(make):
    plot = describe("convergence", {"jittered": make["curve"]("jittered")})
    line = next(m for m in marks(plot, Line) if m.label.startswith("jittered"))
    # For an exact power law, the fitted line passes through the ends
    np.testing.assert_allclose(line.y, 0.08 * np.array([16.0, 1024.0]) ** -3)
    assert line.label == "jittered  −3.00 ± 0.03"


def test_convergence__only_the_last_counts_were_fitted(make):
    data = make["curve"]("jittered").assign_attrs(fit_last=2)
    lines = marks(describe("convergence", {"jittered": data}), Line)
    assert any(list(line.x) == pytest.approx([256, 1024]) for line in lines)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"zero": (2, 3)}, "2 of 4 at rounding level"),
        ({"zero": (0, 1, 2, 3)}, "no variance above rounding noise"),
        ({"counts": (64,), "zero": ()}, "random"),
    ],
)
def test_convergence__unusual_curves(make, options, words):
    plot = describe("convergence", {"random": make["curve"]("random", **options)})
    assert words in said(plot)
    drawn_by_both(plot)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_convergence__values_that_are_not_finite_are_counted(make, bad):
    data = make["curve"]("random", zero=(0,))
    data["variance"][3] = bad
    plot = describe("convergence", {"random": data})
    assert "1 of 4 not finite; 1 of 4 at rounding level" in said(plot)
    drawn_by_both(plot)
    data["variance"][:] = bad
    data["variance_ci"][:] = bad
    plot = describe("convergence", {"random": data})
    assert "4 of 4 not finite" in said(plot)
    assert plot.panels[0].note == "no finite variance"
    drawn_by_both(plot)


def test_convergence__no_line_without_intervals(make):
    data = make["curve"]("random")
    data["variance_ci"][:] = math.nan
    plot = describe("convergence", {"random": data})
    assert not any(
        line.label.startswith("random") for line in marks(plot, Line) if line.dashes != ":"
    )
    drawn_by_both(plot)


@pytest.mark.parametrize(("kind", "dims"), [("spectrum", 2), ("lines", 1), ("contributions", 2)])
def test_spectra_of_nan_are_not_called_infinite(make, kind, dims):
    data = make["terms" if kind == "contributions" else "spectrum"](dims=dims, half_width=2)
    empty = data.map(lambda v: v * math.nan, keep_attrs=True)
    plot = describe(kind, {"x": empty})
    assert {panel.note for panel in plot.panels} == {"not finite"}
    drawn_by_both(plot)
    if kind != "lines":
        infinite = describe(kind, {"x": empty.assign_attrs(random_level=math.inf)})
        assert infinite.panels[0].note == "infinite: ∫1/p diverges"


def test_convergence__rounding_noise_is_not_drawn(make):
    data = make["curve"]("random")
    data["variance"][3] = 1e-33  # (16 ulps of 0.5)² is 3e-30
    assert usable_counts(data).tolist() == [True, True, True, False]


def test_single_results_with_and_without_dims(make):
    one = make["curve"]("jittered")
    assert "jittered" in said(describe("convergence", one))
    two = xr.concat([make["curve"]("random"), one], dim="sampler", combine_attrs="drop_conflicts")
    shown = said(describe("convergence", two.assign_coords(sampler=["random", "jittered"])))
    assert "random  −1.00" in shown
    assert "jittered  −3.00" in shown


def test_styles_are_used(make):
    styles = sampler_styles(["other", "random"])
    plot = describe("convergence", {"random": make["curve"]("random")}, styles)
    assert styles["random"].color in {dots.color for dots in marks(plot, Dots)}


@pytest.mark.parametrize("data", [None, {}, 3, "random", {"a": 3}])
def test_nothing_to_draw(data):
    with pytest.raises(ParameterError, match="needs a dataset"):
        describe("terms", data)


@pytest.mark.parametrize("kind", [kind for kind in PLOT_KINDS if kind != "anything"])
def test_wrong_analysis(kind):
    with pytest.raises(ParameterError, match="has no "):
        describe(kind, {"random": xr.Dataset()})


def test_errors_for_unknown_kinds_list_the_kinds(make):
    with pytest.raises(ParameterError, match="kind is 'radail'.*Did you mean 'radial'"):
        describe("radail", make["spectrum"]())


def correlation(values=(0.0, 0.5, 1.0)):
    return xr.Dataset(
        {
            "pair_correlation": ("r", list(values)),
            "pair_correlation_ci": (("r", "bound"), np.add.outer(values, [-0.1, 0.3])),
        },
        {"r": [0.1, 0.2, 0.3]},
        {"n": 16, "dims": 2},
    )


def test_pair_correlation__describes_the_minimum():
    plot = describe("pair-correlation", {"random": correlation(), "shift": correlation()})
    assert "random: least 0 at r = 0.100" in plot.words
    (random, shift) = marks(plot, Line)
    np.testing.assert_allclose(random.x, [0.4, 0.8, 1.2])  # in units of 1/√16
    assert (random.label, shift.label) == ("random", "shift")
    np.testing.assert_allclose(random.high - random.low, 0.4)
    none = describe("pair-correlation", {"random": correlation((math.nan,) * 3)})
    assert "random: no number." in none.words


def remedies():
    """Return a result as in a store, with text as attributes."""
    ratio = np.array([0.5, 1.0, math.nan])
    found = {
        "error_ratio": ("remedy", ratio),
        "error_ratio_ci": (("remedy", "bound"), np.stack([ratio / 1.2, ratio * 1.2], -1)),
    }
    names, verdicts = ["owen", "as given", "broken"], ["better", "given", "undecided"]
    return xr.Dataset(found, attrs={"labels_remedy": names, "labels_verdict": verdicts})


def test_remedies__stored_results_have_a_panel_per_sampler():
    assert kinds_of(remedies()) == ("remedies",)
    plot = describe("remedies", {"a": remedies(), "b": remedies()})
    assert [panel.title for panel in plot.panels] == ["a", "b"]
    assert list(plot.panels[0].y.ticks.values()) == ["owen", "as given", "broken"]
    assert "owen 0.500, as given 1.00" in plot.words
    assert [dots.x.tolist() for dots in marks(plot, Dots)[:3]] == [[0.5], [1.0], []]
    drawn_by_both(plot)


def test_remedies__ratios_over_many_decades_are_inside_the_panel():
    """An interval without a lower end must not stretch the axis, nor hide a ratio."""
    given = remedies()
    given["error_ratio"].values[:] = [3e-5, 1.0, 4.0]
    given["error_ratio_ci"].values[:] = [[0.0, 1e-4], [1.0, 1.0], [np.nan, np.nan]]
    plot = describe("remedies", given)
    axis = plot.panels[0].x
    assert axis.low < 3e-5
    assert 4.0 < axis.high < 100.0
    given["error_ratio_ci"].values[0] = [1e-20, 1e-4]
    assert 1e-8 < describe("remedies", given).panels[0].x.low < 3e-5


def test_labels_of_another_length_are_ignored():
    found = labelled(remedies().assign_attrs(labels_other=["one"]))
    assert list(found["verdict"].values) == ["better", "given", "undecided"]
    assert "other" not in found.coords


def test_convergence__one_count_has_no_lines_in_plot_and_caption():
    curve = mcs.convergence("gaussian", "random", [16, 32], realizations=8, rng=0)
    one, two = (
        describe("convergence", each) for each in (curve.isel(n=[0]).assign(rate=np.nan), curve)
    )
    assert not marks(one, Line)
    assert "lines" not in one.caption
    assert "fitted lines" in two.caption


def test_plan__the_target_is_a_line_and_the_axis_ends_with_the_curve():
    found = mcs.plan(mcs.integrand("gaussian", dims=1), "jittered", target_error=0.1, relative=True)
    plot = describe("prediction", found)
    (rule,), (line,) = marks(plot, ReferenceLine), marks(plot, Line)
    assert rule.at == pytest.approx((0.1 * mcs.integrand("gaussian", dims=1).integral) ** 2)
    assert line.x[-1] < plot.panels[0].x.high < 2 * line.x[-1] < found["n"][-1]


def test_anova__a_few_parts_with_the_largest_first():
    size = np.arange(1.0, 21.0)
    labels = [f"x{k}" for k in range(20)]
    data = xr.Dataset(
        {"anova_variance": ("subset", size), "anova_variance_se": ("subset", 0.1 * size)},
        {"subset_label": ("subset", labels)},
    )
    plot = describe("anova", {"a": data})
    (bars,) = marks(plot, BarChart)
    np.testing.assert_array_equal(bars.value, np.arange(20.0, 8.0, -1.0))
    assert "8 smaller parts are omitted" in plot.caption
    assert "each axis of primary space alone (first-order) and from the inter" in plot.caption
    size[[3, 7, 17]] = 0.0, -1e-15, 1e-15  # rounding
    (bars,) = marks(describe("anova", {"a": data.assign_attrs(axes="bounce", order=1)}), BarChart)
    np.testing.assert_array_equal(bars.value, [20, 19, 17, 16, 15, 14, 13, 12, 11, 10, 9, 7])


def test_techniques__bars_sum_to_the_variance():
    matrix = np.array([[2.0, -0.5], [-0.5, 1.0]])
    data = xr.Dataset(
        {
            "technique_covariance": (("technique", "technique_other"), matrix),
            "technique_variance_ci": (("technique", "bound"), [[1.5, 2.5], [0.5, 1.5]]),
        }
    )
    (bars,) = marks(describe("techniques", {"a": data}), BarChart)
    assert bars.value.sum() == matrix.sum()
    assert np.isnan(bars.low).tolist() == [False, False, True]


def test_techniques__rates_of_each_and_of_their_sum():
    both = mcs.MultipleImportance("gaussian", ["linear", "uniform"], dims=1)
    data = mcs.technique_terms(both, "jittered", [4, 16, 64], half_width=2, realizations=45)
    plot = describe("technique-rates", {"jittered": data, "again": data})
    assert [label.split("  ")[0] for label in plot.labels] == [
        "technique 0",
        "technique 1",
        "all together",
    ]
    first = marks(plot, Dots)[0]
    np.testing.assert_array_equal(first.y, data["technique_variance"].isel(technique=0))
    (bars, _) = marks(describe("techniques", {"a": data, "b": data}), BarChart)
    last = data["technique_covariance"].isel(n=-1)
    assert bars.value.sum() == pytest.approx(float(last.sum()))


def stranger(shift=0.0):
    gap = {"long_name": "largest gap", "units": "cells"}
    return xr.Dataset(
        {
            "gap": ((), 1.5 + shift, gap),
            "gap_ci": (("bound",), [1.25, 2.0]),
            "curve": (("place",), np.arange(3.0) + shift, {"long_name": "mean gap", "units": "1"}),
            "curve_se": (("place",), np.full(3, 0.1)),
            "table": (("place", "other"), np.ones((3, 2))),
            "words": (("place",), np.array(["a", "b", "c"])),
        }
    )


def test_anything__curves_and_maps():
    assert kinds_of(stranger()) == ("anything",)
    plot = describe("anything", {"random": stranger(), "jittered": stranger(1.0)})
    curves, *maps = plot.panels
    assert curves.y.label == "mean gap"
    random, jittered = curves.marks
    np.testing.assert_array_equal(jittered.y, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(random.high - random.low, 0.4)
    assert [panel.title for panel in maps] == ["random", "jittered"]
    assert plot.caption == "Mean gap, over place; table, over place and other."
    drawn_by_both(plot)


def test_anything__text_labels_along_an_axis_and_scalars():
    named = stranger().assign_coords(place=["a", "b", "c"])[["curve"]]
    (dots,) = marks(describe("anything", named), Dots)
    assert dots.low is None
    alone = describe("anything", {"a": stranger()[["gap", "gap_ci"]], "b": stranger(1.0)[["gap"]]})
    assert [float(d.y[0]) for d in marks(alone, Dots)] == [1.5, 2.5]
    assert alone.panels[0].y.label == "largest gap (cells)"
    assert kinds_of(xr.Dataset()) == ()
    drawn_by_both(alone)


def test_describe_does_not_change_results(make):
    data = make["terms"](dims=2, half_width=3, realizations=20)
    before = data.copy(deep=True)
    for kind in kinds_of(data):
        plot = describe(kind, data)
        assert dataclasses.replace(plot).words == plot.words
    xr.testing.assert_identical(data, before)


def test_reference_lines_mark_the_level_of_random_points(make):
    for kind in ("lines", "radial"):
        assert [r.at for r in marks(describe(kind, make["spectrum"]()), ReferenceLine)] == [1.0]


def test_a_bench_has_all_the_plots_that_it_lists():
    bench = mcs.sampler_bench(["jittered", "random"], counts=[16, 64], dims=2, realizations=10)
    assert {"spectrum", "radial", "pair-correlation", "points"} <= set(bench.mcspectra.kinds)
    few = bench.isel(integrand=slice(2))  # a figure of all eight takes most of the time
    assert few.mcspectra.kinds == bench.mcspectra.kinds
    for kind in bench.mcspectra.kinds:
        drawn_by_both(describe(kind, few))


def test_a_result_with_its_cross_matrix_is_drawn_as_the_matrix(make):
    data = make["terms"](matrix=True, half_width=2, realizations=20)
    assert kinds_of(data)[0] == "cross-matrix"
    plane = mcs.variance_terms(
        "gaussian", "jittered", 16, half_width=1, realizations=20, cross_matrix=True
    )
    assert kinds_of(plane)[0] == "terms"
    with pytest.raises(ParameterError, match="2 frequency dims, but the plot 'cross-matrix'"):
        describe("cross-matrix", {"x": plane})
