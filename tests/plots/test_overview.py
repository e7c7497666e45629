"""The row of small pictures of one estimator, with results of all analyses or of a few."""

import pytest
from tests.plots.drawing import drawn_by_both

import mcspectra as mcs
from mcspectra.core.analysis import ANALYSES, Subject, compute
from mcspectra.plots.description import BarChart, Dots, Heatmap, Line
from mcspectra.plots.overview import overview
from mcspectra.plots.style import sampler_styles
from mcspectra.plots.variance import overlaid

SAMPLERS = ("random", "jittered")


def results(estimator, dims):
    """Return small results of the analyses of the row, by analysis and sampler."""
    options = {
        "points": {"n": 16},
        "spectrum": {"n": 16, "half_width": 4, "realizations": 8},
        "convergence": {"counts": (4, 16, 64), "realizations": 50},
        "terms": {"n": 16, "half_width": 4, "realizations": 50},
        "predict": {"counts": (4, 16)},
    }
    return {
        name: {
            sampler: compute(
                ANALYSES.load(name)(**given),
                Subject(estimator, mcs.sampler(sampler, dims=dims)),
                rng=1,
            )
            for sampler in SAMPLERS
        }
        for name, given in options.items()
    }


@pytest.mark.parametrize("dims", [1, 2])
def test_a_row_has_five_pictures_that_both_libraries_draw(dims):
    density = "linear(slope=1)" if dims == 1 else None
    found = results(mcs.Estimator("gaussian(width=0.3)", density, dims=dims), dims)
    found["convergence"] = overlaid(found["convergence"], found.pop("predict"))
    row = list(overview(found, "jittered", sampler_styles(SAMPLERS)))
    assert [plot.caption.partition(" ")[0] for plot in row] == [
        "Integrand",
        "Points",
        "Spectrum:",
        "Variance",
        "Terms",
    ]
    first = Line if dims == 1 else Heatmap
    for plot, kind in zip(row, (first, Dots, first, Line, BarChart), strict=True):
        assert plot.small
        assert len(plot.panels) == 1
        assert any(isinstance(mark, kind) for mark in plot.panels[0].marks)
        assert len(plot.words) > 30
        drawn_by_both(plot)


def test_the_caption_of_the_terms_states_an_incomplete_sum():
    terms = results(mcs.Estimator("gaussian(width=0.3)", dims=1), 1)["terms"]
    for share, caption in ((0.95, "add up"), (0.29, "frequency 4 sum to 29 % of the measured")):
        found = {"random": terms["random"].assign(captured=share)}
        (plot,) = overview({"terms": found}, "random", sampler_styles(SAMPLERS))
        assert caption in plot.caption


def test_absent_analyses_have_no_picture():
    assert list(overview({"convergence": {}}, "random", {})) == []
