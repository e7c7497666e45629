"""The accessor of results: figures and sentences."""

import numpy as np
import pytest
import xarray as xr
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from tests.processes import python

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.plots.text import number
from mcspectra.report import accessor

FAST = {"realizations": 20}
RESULTS = {
    "convergence": lambda: mcs.convergence("disk", ["jittered", "random"], [16, 64], **FAST),
    "terms": lambda: mcs.variance_terms("disk", "jittered", 16, half_width=3, **FAST),
    "spectrum": lambda: mcs.power_spectrum("jittered", 16, half_width=4, **FAST),
    "lines": lambda: mcs.power_spectrum(mcs.sampler("jittered", dims=1), 16, half_width=4, **FAST),
    "pair-correlation": lambda: mcs.pair_correlation("jittered", 16, **FAST),
    "remedies": lambda: mcs.remedies(
        mcs.Estimator("linear", dims=1),
        "jittered | shift",
        1024,
        realizations=100,
        kinds=["unshifted"],
    ),
    "warp": lambda: mcs.quality.warp_quality("linear"),
    "primary": lambda: mcs.explain.primary_picture(mcs.Estimator("disk", "linear")),
}
PANELS = {"warp": 2}


@pytest.fixture(scope="module", params=RESULTS)
def result(request):
    return request.param, RESULTS[request.param]()


def test_every_result_is_drawn(result):
    kind, data = result
    assert data.mcspectra.kinds[0] == kind
    drawn = data.mcspectra.plot()
    several = drawn if isinstance(drawn, list) else [drawn]
    assert len(several) == PANELS.get(kind, 1)
    assert all(isinstance(axes, Axes) for axes in several)
    found = data.mcspectra.figures()
    assert tuple(found) == data.mcspectra.kinds
    assert all(isinstance(figure, Figure) for figure in found.values())


def test_given_axes_are_drawn_into_and_returned(result):
    kind, data = result
    figure = Figure()
    panels = figure.subplots(1, 2)
    wanted = panels if kind in PANELS else panels[0]
    drawn = data.mcspectra.plot(axes=wanted)
    assert drawn is wanted or list(drawn) == list(wanted)
    assert panels[0].has_data()
    assert panels[1].has_data() == (kind in PANELS)
    assert not figure.legends  # a legend of the whole figure belongs to the user
    figure.canvas.draw()


def test_figures_of_each_kind_accept_axes():
    data = RESULTS["terms"]()
    for kind in data.mcspectra.kinds:
        count = len(data.mcspectra.plot(kind)) if kind in ("bands", "product") else 1
        panels = np.atleast_1d(Figure().subplots(1, count))
        data.mcspectra.plot(kind, axes=panels)
        assert all(axes.has_data() for axes in panels)


def test_ax_is_an_alias_of_axes_for_one_panel():
    data = RESULTS["convergence"]()
    one = Figure().subplots()
    assert data.mcspectra.plot(ax=one) is one
    assert one.has_data()
    with pytest.raises(ParameterError, match="axes and ax are the same"):
        data.mcspectra.plot(axes=one, ax=one)
    with pytest.raises(ParameterError, match=r"Give axes by name: plot\(axes=\.\.\.\)"):
        data.mcspectra.plot(one)
    with pytest.raises(ParameterError, match="2 matplotlib Axes of one figure"):
        RESULTS["warp"]().mcspectra.plot(ax=one)


@pytest.mark.parametrize("samplers", [["random", "jittered"], ["random", "jittered", "sobol"]])
def test_the_legend_in_given_axes_covers_no_curve(samplers):
    data = mcs.convergence("gaussian", samplers, [16, 64, 256], **FAST)
    for size in ((9, 3.6), (5, 2.6)):
        figure = Figure(figsize=size)
        left, _ = figure.subplots(1, 2)
        data.mcspectra.plot(axes=left)
        figure.canvas.draw()
        box = left.get_legend().get_window_extent()
        for line in left.lines:
            path = line.get_transform().transform_path(line.get_path())
            assert not path.intersects_bbox(box, filled=False)


def test_the_caption_names_the_shown_channel():
    data = mcs.convergence("environment", ["random", "jittered"], [16, 64], **FAST)
    axes = data.mcspectra.plot()
    assert "channel 0 of 3" in axes.get_title("left") + axes.get_title()


def test_several_estimators_are_drawn_by_name():
    data = mcs.convergence(["disk", "gaussian"], ["jittered", "random"], [16, 64], **FAST)
    shown = [t.get_text() for t in data.mcspectra.plot().figure.legends[0].get_texts()]
    assert [text.split("  ")[0] for text in shown[-4:]] == [
        f"{f}, {s}" for f in ("disk", "gaussian") for s in ("jittered", "random")
    ]
    assert "gaussian, random: " in data.mcspectra.summary()


def test_each_variant_of_a_sampler_has_a_curve_and_a_sentence():
    data = mcs.improve.mirror_study("disk", "jittered", [16, 64], realizations=40)
    shown = [t.get_text() for t in data.mcspectra.plot().figure.legends[0].get_texts()]
    said = data.mcspectra.summary()
    for mirroring in ("original", "integrand", "random", "uniform"):
        for homogenized in ("homogenized", "not homogenized"):
            name = f"{mirroring}, {homogenized}"
            assert f"disk, jittered, {name}: " in said
            assert sum(text.startswith(f"{name}  ") for text in shown) == 1


def test_remedies_are_drawn_in_order_and_described():
    data = RESULTS["remedies"]()
    axes = data.mcspectra.plot()
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names == list(data["remedy"].values)
    dots = [c for c in axes.collections if isinstance(c, PathCollection)]
    drawn = np.concatenate([each.get_offsets() for each in dots])
    np.testing.assert_array_equal(np.sort(drawn[:, 0]), np.sort(data["error_ratio"].values))
    said = data.mcspectra.summary()
    assert data.attrs["answer"] in said
    assert data.attrs["diagnosis"] in said


def test_summary_has_rates():
    data = mcs.convergence("gaussian", "jittered", [16, 64, 256], realizations=300)
    assert "faster" in data.mcspectra.summary() or "−2" in data.mcspectra.summary()


def test_summary_has_terms():
    data = mcs.variance_terms("disk", "random", 16, half_width=1, realizations=1000)
    assert "The spectrum up to half width 1 accounts for only" in data.mcspectra.summary()


def test_summary_of_other_results_has_numbers():
    data = xr.Dataset({"rate": 2.5, "rate_ci": ("bound", [2.0, 3.0]), "power": ("m0", [1.0])})
    assert data.mcspectra.summary() == (
        "fitted exponent of variance in n; random sampling: −1: 2.50 (2.00 … 3.00); expected power "
        "⟨|S_m|²⟩; random points: ∫1/p / n: over m0."
    )


def test_summary_describes_each_channel():
    data = mcs.convergence("environment", "random", [16, 64], **FAST)
    said = data.mcspectra.summary()
    assert all(f"environment [{k}], random: " in said for k in range(3))


def test_results_without_a_figure_give_an_error():
    data = xr.Dataset({"words": ("x", ["a"])})
    for draw in (data.mcspectra.plot, data.mcspectra.figures):
        with pytest.raises(ParameterError, match="No figure shows words"):
            draw()
    assert data.mcspectra.kinds == xr.Dataset().mcspectra.kinds == ()


def test_pyplot_shows_and_writes_the_figure(tmp_path):
    data = RESULTS["convergence"]()
    assert not plt.get_fignums()
    data.mcspectra.figures()
    assert not plt.get_fignums()
    axes = data.mcspectra.plot()
    assert plt.gcf() is axes.figure
    plt.savefig(tmp_path / "a.png")
    axes.figure.savefig(tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    data.mcspectra.plot(axes=Figure().subplots())
    assert len(plt.get_fignums()) == 1


def test_importing_the_module_registers_the_accessor():
    code = "import xarray as xr, mcspectra.report.accessor; print(xr.Dataset().mcspectra.kinds)"
    done = python("-c", code, check=True)
    assert done.stdout == "()\n"
    assert accessor.Result(xr.Dataset()).kinds == ()


def test_summaries_of_predictions_have_values_methods_and_rates():
    found = mcs.predict("disk", ["random", "jittered | shift"], [64, 256])
    random, jittered = found["predicted_variance"].isel(n=-1).values
    text = found.mcspectra.summary()
    assert (
        f"random: variance {number(random)} at n = 256 by exact (quadrature), rate −1.00 now"
        in text
    )
    assert f"jittered | shift: variance {number(jittered)} at n = 256" in text
    assert "and −1.50 at large n." in text
    alone = mcs.predict("gaussian", "jittered", [16]).mcspectra.summary()
    assert alone.startswith("jittered: variance ")
    assert "over n" not in alone
