"""Figures: what they draw, and that odd results do not break them."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.report import figures, sampler_styles
from mcspectra.report.figures.variance import usable_counts

Make = dict[str, Callable[..., Any]]
TERM_FIGURES = ("three_terms", "captured_curves", "contributions", "band_covariances")


def texts(figure: Any) -> str:
    """All text of a figure in one string."""
    figure.canvas.draw()
    from matplotlib.text import Text

    return "\n".join(t.get_text() for t in figure.findobj(Text) if t.get_visible())


@pytest.mark.parametrize("name", TERM_FIGURES)
@pytest.mark.parametrize("dims", [1, 2, 3])
def test_term_figures__every_dim(make: Make, name: str, dims: int) -> None:
    data = make["terms"](dims=dims, n={1: 16, 2: 16, 3: 8}[dims], half_width=3, realizations=20)
    shown = texts(getattr(figures, name)({"jittered": data, "other": data}))
    assert "jittered" in shown
    assert "other" in shown


@pytest.mark.parametrize("name", TERM_FIGURES)
@pytest.mark.parametrize("dims", [1, 2])
def test_term_figures__infinite_terms_are_named(make: Make, name: str, dims: int) -> None:
    data = make["infinite"](dims=dims, half_width=3, realizations=20)
    shown = texts(getattr(figures, name)({"random": data}))
    assert "infinite" in shown or "no finite" in shown
    assert "nan" not in shown.lower()


@pytest.mark.parametrize("name", TERM_FIGURES)
def test_term_figures__zero_variance(make: Make, name: str) -> None:
    data = make["terms"](half_width=3, realizations=20)
    zero = data.map(lambda v: v * 0.0, keep_attrs=True)
    zero["captured"] = zero["captured"] * math.nan
    zero["captured_by_half_width"] = zero["captured_by_half_width"] * math.nan
    assert texts(getattr(figures, name)({"regular": zero}))


def test_three_terms__bars_are_as_long_as_the_terms(make: Make) -> None:
    data = make["terms"]()
    figure = figures.three_terms({"jittered": data})
    widths = [patch.get_width() for patch in figure.axes[0].patches]
    names = ("dc_term", "power_term", "cross_term", "predicted_variance", "measured_variance")
    assert widths == [pytest.approx(float(data[name])) for name in names]


def test_three_terms__every_bar_has_the_whiskers_of_its_interval(make: Make) -> None:
    data = make["terms"]()
    names = ("power_term", "cross_term", "predicted_variance", "measured_variance")
    for name in names[:2]:
        data[f"{name}_ci"] = ("bound", float(data[name]) * np.array([0.5, 2.0]))
    figure = figures.three_terms({"jittered": data})
    lines = [c.get_segments()[0][:, 0] for c in figure.axes[0].collections]
    np.testing.assert_allclose(lines[::2], [data[f"{name}_ci"].values for name in names])
    low, high = figure.axes[0].get_xlim()
    assert low < min(map(min, lines))
    assert high > max(map(max, lines))


def test_three_terms__rounding_does_not_stretch_the_axis(make: Make) -> None:
    data = make["terms"]()
    data["dc_term"] = data["dc_term"] * 0.0 + 1e-17
    figure = figures.three_terms({"jittered": data})
    assert "≈ 0" in texts(figure)
    smallest = float(data["measured_variance"])
    threshold = float(figure.axes[0].get_xaxis().get_transform().linthresh)
    assert smallest / 10 < threshold <= smallest


def test_contributions__a_panel_for_each_technique(make: Make) -> None:
    data = make["terms"](techniques=2, half_width=3, realizations=20)
    shown = texts(figures.contributions({"random": data}))
    assert "technique 0" in shown
    assert "technique 1" in shown


def test_contributions__shells_sum_to_what_lies_inside_the_half_width(make: Make) -> None:
    data = make["terms"](dims=3, n=8, half_width=2, realizations=20)
    figure = figures.contributions({"x": data})
    bars = next(c for c in figure.axes[0].collections if c.get_label() == "contribution cₘ")
    ends = np.array([segment[:, 1] for segment in bars.get_segments()])
    m = np.arange(-2, 3)
    length = np.sqrt(sum(g**2 for g in np.meshgrid(m, m, m)))
    expected = data["contribution"].values[np.rint(length) <= 2].sum()
    assert ends.sum() == pytest.approx(expected)


@pytest.mark.parametrize(
    ("bands", "some"),
    [("anova", ["constant", "x0", "x1", "x0x1"]), ("wedge", ["constant", "0°", "15°", "165°"])],
)
def test_band_covariances__bands_have_their_names(bands: str, some: list[str]) -> None:
    sampler = mcs.sampler("jittered", dims=2)
    terms = mcs.variance_terms("disk", sampler, 16, half_width=6, realizations=20, bands=bands)
    figure = figures.band_covariances({"a": terms, "b": terms})
    for axes in figure.axes[:4]:
        names = [t.get_text() for t in axes.get_xticklabels()]
        assert set(some) <= set(names)
        assert [float(tick) for tick in axes.get_xticks()] == list(range(len(names)))


def test_band_covariances__many_shells_have_whole_ticks_and_one_legend(make: Make) -> None:
    data = make["terms"](dims=1, half_width=40, realizations=20)
    figure = figures.band_covariances({"a": data, "b": data})
    for axes in figure.axes[:4]:
        ticks = [float(tick) for tick in axes.get_xticks()]
        assert len(ticks) <= 7
        assert all(tick.is_integer() for tick in ticks)
    drawn = {tuple(map(tuple, c.get_color())) for a in figure.axes[1:4:2] for c in a.collections}
    assert len(drawn) == 2  # the same two colours in every panel: those of the legend


def test_first_of_several_channels(make: Make) -> None:
    data = make["terms"](channels=3, half_width=3, realizations=20)
    data["dc_term"][1:] = 99.0
    assert "99" not in texts(figures.three_terms({"x": data}))


def test_cross_matrices__real_and_imaginary(make: Make) -> None:
    data = make["terms"](matrix=True, half_width=4, realizations=20)
    figure = figures.cross_matrices({"x": data})
    real, imaginary = (axes.images[0].get_array() for axes in figure.axes[:2])
    np.testing.assert_array_equal(real, data["cross_matrix"].values.real)
    np.testing.assert_array_equal(imaginary, data["cross_matrix"].values.imag)


def test_cross_matrices__only_of_one_dimension(make: Make) -> None:
    data = make["terms"](matrix=True, half_width=2, realizations=20)
    flat = data.assign_coords(m_0=("m", data["m"].values))
    with pytest.raises(ParameterError, match="one-dimensional"):
        figures.cross_matrices({"x": flat})


def test_power_images__n_times_power_with_dc_masked(make: Make) -> None:
    data = make["spectrum"](dims=2, half_width=3)
    image = figures.power_images({"x": data}).axes[0].images[0].get_array()
    expected = 16 * data["power"].values.T
    assert np.isnan(image.filled(np.nan)[3, 3]) if np.ma.isMA(image) else np.isnan(image[3, 3])
    expected[3, 3] = np.nan
    np.testing.assert_allclose(np.ma.filled(image, np.nan), expected)


def test_power_images__one_colour_scale(make: Make) -> None:
    data = {s: make["spectrum"](s, dims=2, half_width=3) for s in ("random", "jittered")}
    figure = figures.power_images(data)
    scales = {axes.images[0].get_clim() for axes in figure.axes if axes.images}
    assert len(scales) == 1


@pytest.mark.parametrize("name", ["power_images", "power_lines"])
def test_power__wrong_number_of_dims(make: Make, name: str) -> None:
    with pytest.raises(ParameterError, match="3 frequency dims"):
        getattr(figures, name)({"x": make["spectrum"](dims=3, n=8, half_width=2)})


@pytest.mark.parametrize("dims", [1, 2, 3])
def test_radial_power__axis_in_units_of_the_root_of_n(make: Make, dims: int) -> None:
    data = make["spectrum"](dims=dims, n=64, half_width=3)
    line = figures.radial_power({"x": data}).axes[0].lines[1]
    np.testing.assert_allclose(line.get_xdata(), data["radius"].values / 64 ** (1 / dims))
    np.testing.assert_allclose(line.get_ydata(), np.maximum(64 * data["radial_power"].values, 1e-4))


def test_convergence__fitted_line_and_label(make: Make) -> None:
    figure = figures.convergence_curves({"jittered": make["curve"]("jittered")})
    axes = figure.axes[0]
    # An exact power law: the fitted line goes through its ends.
    fitted = next(
        line for line in axes.lines if line.get_linestyle() == "-" and len(line.get_xdata()) == 2
    )
    np.testing.assert_allclose(fitted.get_ydata(), 0.08 * np.array([16.0, 1024.0]) ** -3)
    assert "jittered  −3.00 ± 0.03" in texts(figure)


def test_convergence__only_the_last_counts_were_fitted(make: Make) -> None:
    data = make["curve"]("jittered").assign_attrs(fit_last=2)
    axes = figures.convergence_curves({"jittered": data}).axes[0]
    assert any(list(line.get_xdata()) == pytest.approx([256, 1024]) for line in axes.lines)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"zero": (2, 3)}, "2 of 4 at rounding level"),
        ({"zero": (0, 1, 2, 3)}, "no variance above rounding noise"),
        ({"counts": (64,), "zero": ()}, "random"),
    ],
)
def test_convergence__odd_curves(make: Make, options: dict[str, Any], words: str) -> None:
    assert words in texts(
        figures.convergence_curves({"random": make["curve"]("random", **options)})
    )


def test_convergence__rounding_noise_is_no_variance(make: Make) -> None:
    data = make["curve"]("random")
    data["variance"][3] = 1e-33  # (16 ulps of 0.5)² is 3e-30
    assert usable_counts(data).tolist() == [True, True, True, False]


def test_points__strata_of_a_strip(make: Make) -> None:
    figure = figures.point_sets(
        {"jittered": make["points"](n=8), "random": make["points"]("random", n=8)}
    )
    assert [t.get_text() for t in figure.axes[0].get_yticklabels()] == ["jittered", "random"]


def test_points__first_two_of_three_axes(make: Make) -> None:
    assert "axes 0 and 1 of 3" in texts(figures.point_sets({"x": make["points"](dims=3, n=8)}))


def test_one_dataset_alone_and_with_a_sampler_dim(make: Make) -> None:
    one = make["curve"]("jittered")
    assert "jittered" in texts(figures.convergence_curves(one))
    two = xr.concat([make["curve"]("random"), one], dim="sampler", combine_attrs="drop_conflicts")
    two = two.assign_coords(sampler=["random", "jittered"])
    shown = texts(figures.convergence_curves(two))
    assert "random  −1.00" in shown
    assert "jittered  −3.00" in shown


def test_styles_are_used(make: Make) -> None:
    styles = sampler_styles(["other", "random"])
    axes = figures.convergence_curves({"random": make["curve"]("random")}, styles=styles).axes[0]
    assert styles["random"].color in {line.get_color() for line in axes.lines}


@pytest.mark.parametrize("data", [None, {}, 3, "random"])
def test_nothing_to_draw(data: Any) -> None:
    with pytest.raises(ParameterError, match="needs a dataset"):
        figures.three_terms(data)


@pytest.mark.parametrize("name", figures.__all__)
def test_wrong_analysis(name: str) -> None:
    with pytest.raises(ParameterError, match="has no "):
        getattr(figures, name)({"random": xr.Dataset()})


def test_names_with_dollars_are_no_mathematics(make: Make) -> None:
    name = r"from-file(path='$a_{$\frac')"
    assert "$a" in texts(figures.convergence_curves({name: make["curve"]("random")}))
