"""Interactive figures: what they draw is what the results hold; legends, tooltips, words."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr
from bokeh.document import Document
from bokeh.models import ColumnDataSource, HoverTool, Legend, Plot, Row
from bokeh.models.tools import WheelZoomTool

from mcspectra.core.errors import ParameterError
from mcspectra.report import interactive, sampler_styles
from mcspectra.report.figures.spectra import without_dc
from mcspectra.report.interactive.frame import plain_text, plot_color
from mcspectra.report.interactive.images import shade_ticks, shades, signed_mapper
from mcspectra.report.interactive.signed import signed_scale

Make = dict[str, Callable[..., Any]]
SAMPLERS = ("random", "jittered", "jittered | shift")
PLOTS = {
    interactive.convergence_plot: ("curve", {}),
    interactive.terms_plot: ("terms", {}),
    interactive.contribution_plot: ("terms", {}),
    interactive.band_plot: ("terms", {}),
    interactive.spectrum_plot: ("spectrum", {}),
    interactive.radial_plot: ("spectrum", {}),
    interactive.points_plot: ("points", {}),
}


def group(make: Make, kind: str, **options: Any) -> dict[str, xr.Dataset]:
    """Results of every sampler."""
    return {sampler: make[kind](sampler, **options) for sampler in SAMPLERS}


def sources(plot: Any) -> list[dict[str, Any]]:
    """Columns of all that is drawn."""
    return [dict(source.data) for source in plot.select({"type": ColumnDataSource})]


def column(plot: Any, sampler: str, name: str) -> np.ndarray:
    """A column of what is drawn of one sampler."""
    (found,) = (s for s in sources(plot) if s.get("name", [""])[:1] == [sampler] and name in s)
    return np.asarray(found[name])


@pytest.mark.parametrize("dims", [1, 2])
@pytest.mark.parametrize("draw", PLOTS, ids=lambda f: f.__name__)
def test_every_plot(make: Make, draw: Callable[..., Any], dims: int) -> None:
    kind, _ = PLOTS[draw]
    options = {} if kind == "curve" else {"dims": dims}
    if kind in ("terms", "spectrum"):
        options["half_width"] = 6
    drawn = draw(group(make, kind, **options))
    figures = list(drawn.select({"type": Plot}))
    assert figures
    for figure in figures:
        assert figure.toolbar.logo is None
        assert figure.toolbar.active_scroll is None
        assert figure.toolbar.active_drag is None
        assert figure.background_fill_color is None
        assert figure.select({"type": HoverTool})
        assert figure.select({"type": WheelZoomTool})
    for legend in drawn.select({"type": Legend}):
        assert legend.click_policy == "hide"
        assert len(legend.items) >= 3
        assert all(item.renderers for item in legend.items)
    text = interactive.alt_text(drawn)
    assert len(text) > 40
    assert all(sampler in text for sampler in SAMPLERS)
    document = Document()
    document.add_root(drawn)
    assert document.validate() is None
    assert "$$" not in str(document.to_json())


def test_convergence__holds_the_results(make: Make) -> None:
    data = group(make, "curve")
    plot = interactive.convergence_plot(data)
    for sampler, each in data.items():
        np.testing.assert_array_equal(column(plot, sampler, "variance"), each["variance"])
        np.testing.assert_array_equal(column(plot, sampler, "low"), each["variance_ci"][:, 0])
        np.testing.assert_array_equal(column(plot, sampler, "high"), each["variance_ci"][:, 1])
    labels = [item.label.value for item in plot.select_one({"type": Legend}).items]
    assert labels[1] == "jittered: −3.00 ± 0.03"
    assert labels[-1].startswith("n⁻¹")
    assert list(plot.xaxis.ticker.ticks) == [16, 64, 256, 1024]


def test_convergence__a_single_count_has_ticks_of_variance(make: Make) -> None:
    plot = interactive.convergence_plot({"a": make["curve"]("jittered", counts=(64,))})
    low, high = make["curve"]("jittered", counts=(64,))["variance_ci"].values[0]
    assert len(plot.yaxis.ticker.ticks) >= 1
    assert all(low <= tick <= high for tick in plot.yaxis.ticker.ticks)


def test_convergence__reference_has_slope_minus_one_and_passes_the_noisiest_start(
    make: Make,
) -> None:
    plot = interactive.convergence_plot(group(make, "curve"))
    (drawn,) = plot.select_one({"type": Legend}).items[-1].renderers
    line = drawn.data_source.data
    np.testing.assert_allclose(np.asarray(line["x"]) * line["y"], 0.08, rtol=1e-12)


def test_convergence__zeros_are_counted_not_drawn(make: Make) -> None:
    data = {"jittered": make["curve"]("jittered", zero=(1, 2))}
    plot = interactive.convergence_plot(data)
    assert len(column(plot, "jittered", "variance")) == 2
    assert "2 of 4 at rounding level" in plot.select_one({"type": Legend}).items[0].label.value


def test_convergence__nothing_but_zeros(make: Make) -> None:
    data = {"jittered": make["curve"]("jittered", zero=(0, 1, 2, 3))}
    plot = interactive.convergence_plot(data)
    assert "(no rate)" in plot.select_one({"type": Legend}).items[0].label.value


def test_terms__bars_are_in_the_order_of_their_values(make: Make) -> None:
    data = group(make, "terms")
    plot = interactive.terms_plot(data)
    drawn = np.concatenate([column(plot, s, "x") for s in SAMPLERS])
    values = np.concatenate(
        [[float(d[t]) for t in ("dc_term", "power_term", "cross_term", "predicted_variance",
                                "measured_variance")] for d in data.values()]
    )  # fmt: skip
    values[np.abs(values) < 1e-12] = 0.0
    np.testing.assert_array_equal(np.sign(drawn), np.sign(values))
    np.testing.assert_array_equal(
        np.argsort(drawn, kind="stable"), np.argsort(values, kind="stable")
    )
    rows = [column(plot, s, "y") for s in SAMPLERS]
    np.testing.assert_array_equal(np.rint(rows), np.tile(np.arange(5), (3, 1)))


def test_terms__infinite_ones_say_why(make: Make) -> None:
    plot = interactive.terms_plot({"random": make["infinite"](half_width=4)})
    assert list(column(plot, "random", "mark"))[:2] == ["∞: ∫1/p diverges"] * 2
    assert column(plot, "random", "text")[0] == "infinite: ∫1/p diverges"
    assert column(plot, "random", "x")[0] == 0


def test_spectrum__map_has_m0_to_the_right_and_no_dc(make: Make) -> None:
    each = make["spectrum"]("jittered", dims=2, n=16, half_width=4)
    image = next(s for s in sources(interactive.spectrum_plot({"jittered": each})) if "power" in s)
    expected = without_dc(each, 2)
    shown = image["power"][0]
    np.testing.assert_allclose(shown.T, expected, rtol=2.0**-10)
    assert np.isnan(shown[4, 4])
    m0, m1 = image["m₀"][0], image["m₁"][0]
    np.testing.assert_array_equal(m0[0], np.arange(-4, 5))
    np.testing.assert_array_equal(m1[:, 0], np.arange(-4, 5))


def test_spectrum__one_scale_and_common_zoom(make: Make) -> None:
    row = interactive.spectrum_plot(group(make, "spectrum", dims=2, n=16, half_width=3))
    assert isinstance(row, Row)
    assert len({id(plot.x_range) for plot in row.children}) == 1
    mappers = {id(plot.renderers[0].glyph.color_mapper) for plot in row.children}
    assert len(mappers) == 1


def test_spectrum__lines_hold_the_power(make: Make) -> None:
    each = make["spectrum"]("jittered", dims=1, n=16, half_width=8)
    shown = column(interactive.spectrum_plot({"jittered": each}), "jittered", "y")
    expected = without_dc(each, 1)
    there = np.isfinite(expected)
    np.testing.assert_allclose(shown[there], np.maximum(expected[there], 1e-4))


def test_contribution__map_sums_to_the_predicted_variance(make: Make) -> None:
    each = make["terms"]("random", dims=2, half_width=4)
    plot = interactive.contribution_plot({"random": each})
    image = next(s for s in sources(plot) if "contribution" in s)
    total = float(image["contribution"][0].sum())
    rounding = 2.0**-10 * float(np.abs(each["contribution"]).sum())
    assert total == pytest.approx(float(each["predicted_variance"]), abs=rounding)
    np.testing.assert_allclose(
        image["contribution"][0].T, each["contribution"], rtol=2.0**-10, atol=1e-30
    )


def test_contribution__shells_in_three_dims(make: Make) -> None:
    plot = interactive.contribution_plot(
        {"random": make["terms"]("random", dims=3, n=27, half_width=3)}
    )
    np.testing.assert_array_equal(column(plot, "random", "m"), np.arange(4))


def test_band__tooltips_share_the_variance(make: Make) -> None:
    each = make["terms"]("jittered", half_width=4)
    plot = interactive.band_plot({"jittered": each})
    matrix = each["band_covariance"].values
    image = next(s for s in sources(plot) if "covariance" in s)
    np.testing.assert_allclose(image["covariance"][0], matrix.T, rtol=2.0**-10, atol=1e-30)
    shares = next(s for s in sources(plot) if "share of a by itself" in s)
    own = [
        float(text.removesuffix(" %").replace("−", "-")) for text in shares["share of a by itself"]
    ]
    np.testing.assert_allclose(own, 100 * np.diag(matrix) / matrix.sum(), atol=0.51)


def test_points__weights_set_areas(make: Make) -> None:
    each = make["points"]("random", dims=2, n=16)
    weights = np.array([1.0, 4.0, -1.0] + [1.0] * 13)
    weighted = each.assign(weights=("point", weights))
    plot = interactive.points_plot({"random": weighted})
    (found,) = (s for s in sources(plot) if "weight" in s)
    np.testing.assert_allclose(found["size"] ** 2 / found["size"][0] ** 2, np.abs(weights))
    np.testing.assert_array_equal(found["x"], each["points"][:, 0])
    np.testing.assert_array_equal(found["y"], each["points"][:, 1])


def test_names_never_become_mathematics(make: Make) -> None:
    evil = "$$x$$ \\(y\\) \\[z\\]"
    plot = interactive.convergence_plot({evil: make["curve"]("random")})
    label = plot.select_one({"type": Legend}).items[0].label.value
    assert "$$" not in label
    assert "\\(" not in label
    assert "\\[" not in label
    assert plain_text("$1") == "$1"


def test_colors_are_seen_on_dark_and_light() -> None:
    def luminance(color: str) -> float:
        parts = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))

    styles = sampler_styles([str(i) for i in range(7)])
    for style in styles.values():
        seen = luminance(plot_color(style)) + 0.05
        assert seen / (luminance("#191817") + 0.05) > 3.0
        assert 1.05 / seen > 2.0


@pytest.mark.parametrize("draw", PLOTS, ids=lambda f: f.__name__)
@pytest.mark.parametrize("bad", [{}, None, 3, {"x": xr.Dataset()}, {"x": None}])
def test_bad_input(draw: Callable[..., Any], bad: Any) -> None:
    with pytest.raises(ParameterError):
        draw(bad)


def test_spectrum__three_dims_are_refused_with_the_way_out(make: Make) -> None:
    with pytest.raises(ParameterError, match="radial_plot"):
        interactive.spectrum_plot({"s": make["spectrum"](dims=3, n=8, half_width=2)})


@pytest.mark.parametrize("top", [1e-30, 3.0, 1e5])
@pytest.mark.parametrize("decades", [0.5, 3.0])
def test_shades__one_for_each_color_and_none_for_what_is_not_finite(
    top: float, decades: float
) -> None:
    sizes = top * 10.0 ** -np.linspace(0.0, decades, 50)
    values = np.concatenate([-sizes, [0.0], sizes[::-1]])
    scale = signed_scale([values])
    found = shades(scale, values)
    assert found.dtype == np.int8
    assert (found[0], found[50], found[-1]) == (-127, 0, 127)
    assert (np.diff(found.astype(int)) >= 0).all()
    np.testing.assert_array_equal(shades(scale, np.array([np.nan, np.inf, -np.inf])), -128)
    mapper = signed_mapper()
    assert len(mapper.palette) == 255
    assert mapper.low == -127.5
    assert mapper.high == 127.5
    ticks = shade_ticks(scale, 5)
    assert 0.0 in ticks
    assert max(abs(place) for place in ticks) <= 127.0 + 1e-9
