"""The dataset of quality figures and its summary."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.quality import FIGURES, diaphony, star_discrepancy, summarize


def test_all_figures_of_all_realizations_are_described():
    figures = mcs.quality_figures("jittered", 16, realizations=3)
    assert set(figures) == {name for name in FIGURES if "projected" not in name}
    for array in figures.values():
        assert array.dims == ("realization",)
        assert array.sizes["realization"] == 3
        assert array.attrs["long_name"]
        assert array.attrs["units"] == "1"
    points = mcs.sampler("jittered", 2).draw(16, realizations=3, rng=0)
    np.testing.assert_array_equal(figures["diaphony"], [diaphony(x) for x in points])
    np.testing.assert_array_equal(figures["star_discrepancy"], list(map(star_discrepancy, points)))


def test_realizations_do_not_depend_on_threads():
    one, four = (mcs.quality_figures("random", 32, realizations=5, workers=w) for w in (1, 4))
    assert one.equals(four)


@pytest.mark.parametrize(
    ("spec", "dims", "n", "base", "t"),
    [
        ("sobol | owen", 2, 64, 2, 0),
        ("faure", 3, 27, 3, 0),
        ("regular(position='corner')", 2, 16, 2, 2),
    ],
)
def test_net_figures_use_the_base_of_the_digits(spec, dims, n, base, t):
    figures = mcs.quality_figures(mcs.sampler(spec, dims), n, realizations=1)
    assert figures.attrs["base"] == base
    assert figures["t_value"].item() == t
    assert figures["elementary_intervals"].item() == (t == 0)


def test_figures_that_cannot_be_computed_have_a_reason():
    figures = mcs.quality_figures(mcs.sampler("random", 5), 10, realizations=2)
    reasons = {name: array.attrs.get("missing", "") for name, array in figures.items()}
    assert "1, 2, 3, 8, 24 dims, not in 5" in reasons["relative_minimum_distance"]
    assert "not in 5" in reasons["star_discrepancy"]
    assert reasons["t_value"] == "10 is not a power of 2."
    for name, array in figures.items():
        assert bool(np.isnan(array).all()) == bool(reasons[name])
        assert bool(np.isnan(array).any()) == bool(reasons[name])


@pytest.mark.parametrize(("dims", "cost"), [(1, 1 / 12 / 16**2), (2, 1 / 6 / 16)])
def test_transport_cost_of_a_grid(dims, cost):
    regular = mcs.sampler("regular", dims)
    figures = mcs.quality_figures(regular, 16, figures=["transport_cost"], realizations=1)
    assert figures["transport_cost"].item() == pytest.approx(cost, rel=1e-9)


def test_transport_cost_has_limits():
    for dims, n, words in ((3, 8, "1 and 2 dims only, not in 3"), (2, 8193, "give at most 8192")):
        points = np.full((n, dims), 0.5)
        figures = mcs.quality_figures(points, figures=["transport_cost"])
        assert words in figures["transport_cost"].attrs["missing"]


def test_projections_worst_and_mean():
    x = np.random.default_rng(1).random((20, 3))
    figures = mcs.quality_figures(x)
    pairs = [x[:, pair] for pair in ([0, 1], [0, 2], [1, 2])]
    stars = [star_discrepancy(pair) for pair in pairs]
    waves = [diaphony(pair) for pair in pairs]
    gaps = [mcs.quality.nearest_distances(pair).min() for pair in pairs]
    assert figures["worst_projected_discrepancy"].item() == max(stars)
    assert figures["mean_projected_discrepancy"].item() == pytest.approx(np.mean(stars))
    assert figures["worst_projected_diaphony"].item() == max(waves)
    assert figures["worst_projected_distance"].item() == min(gaps)
    assert figures["mean_projected_distance"].item() == pytest.approx(np.mean(gaps))
    assert figures.attrs["projections"].startswith("3 of 3 pairs")


def test_projections_are_limited_and_reported():
    wanted = ["worst_projected_distance"]
    figures = mcs.quality_figures(mcs.sampler("random", 30), 4, figures=wanted, realizations=1)
    assert list(figures) == wanted
    assert figures.attrs["projections"].startswith("45 of 435 pairs")
    flat = mcs.quality_figures("random", 4, figures=wanted, realizations=1)
    assert "at least 3 dims" in flat["worst_projected_distance"].attrs["missing"]


def test_given_points_are_all_measured():
    sets = np.random.default_rng(2).random((3, 8, 2))
    figures = mcs.quality_figures(sets, figures=["diaphony"])
    np.testing.assert_array_equal(figures["diaphony"], [diaphony(x) for x in sets])


def test_summary_is_mean_and_standard_error():
    figures = mcs.quality_figures("random", 10, figures=["diaphony", "t_value"], realizations=9)
    wave, net = summarize(figures)
    values = figures["diaphony"].values
    assert (wave.name, wave.long_name) == ("diaphony", figures["diaphony"].attrs["long_name"])
    assert wave.mean == pytest.approx(values.mean())
    assert wave.standard_error == pytest.approx(values.std(ddof=1) / 3)
    assert (net.missing, math.isnan(net.mean)) == ("10 is not a power of 2.", True)
    alone = summarize(mcs.quality_figures("random", 8, figures=["diaphony"], realizations=1))[0]
    assert math.isnan(alone.standard_error)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"figures": ["diafony"]}, "Did you mean 'diaphony'"),
        ({"figures": [3]}, "no quality figure 3. The names are in"),
        ({"figures": "diaphony"}, "list of names"),
        ({"figures": []}, "list of names"),
        ({"figures": 3}, "list of names"),
        ({"realizations": 0}, "realizations"),
        ({"rng": -1}, "rng"),
        ({"workers": 0}, "workers"),
    ],
)
def test_bad_arguments(arguments, words):
    with pytest.raises(ParameterError, match=words):
        mcs.quality_figures("random", 8, **arguments)


def test_a_missing_or_impossible_count_gives_an_error():
    with pytest.raises(ParameterError, match="give the number of points to draw from random"):
        mcs.quality_figures("random")
    with pytest.raises(CountError, match="nearest counts are 4 and 9"):
        mcs.quality_figures("jittered", 5)
