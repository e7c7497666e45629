"""Settings of a study's analyses reach its cells: basis, bands, fit window, precision."""

import pytest

from mcspectra.core.errors import ConfigError
from mcspectra.plots.kinds import describe
from mcspectra.report import write_report
from mcspectra.studies import make_plan, open_results, run_study, summarize
from mcspectra.studies.files import decode_study

STUDY = """
title = "settings"
seed = 5
samplers = ["jittered", "jittered | shift"]
[convergence]
counts = [4, 16, 64, 256]
realizations = 400
fit_last = "auto"
relative_error = 0.1
[terms]
n = 16
half_width = 4
realizations = 60
basis = "auto"
bands = "wedge"
[[estimators]]
name = "two"
integrand = "gaussian"
dims = 2
[[estimators]]
name = "one"
integrand = "linear"
dims = 1
convergence = { counts = [4, 16, 64], realizations = 50, fit_last = 2 }
terms = { n = 16, half_width = 4, realizations = 60, basis = "walsh", bands = "dyadic" }
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    run_study(decode_study(STUDY), folder, workers=2)
    return folder


def test_convergence_cells_have_window_and_precision(finished):
    tree = open_results(finished)
    stored = tree["two/jittered/convergence"].to_dataset()
    assert stored.attrs["fit_window"] == "auto"
    assert (stored["realizations_used"] < 400).any()
    one = tree["one/jittered/convergence"].to_dataset()
    assert (one.attrs["fit_last"], float(one["fit_first_n"])) == (2, 16)
    assert set(one["realizations_used"].values) == {50}


def test_terms_cells_have_basis_and_bands(finished):
    tree = open_results(finished)
    fourier = tree["two/jittered-shift/terms"].to_dataset()
    assert fourier.attrs["basis"] == "fourier"
    cosine = tree["two/jittered/terms"].to_dataset()
    assert cosine.attrs["basis"] == "cosine"
    assert cosine["band"].attrs["long_name"].startswith("band (wedge")
    assert tree["one/jittered/terms"].attrs["basis"] == "walsh"


def test_summary_has_window_basis_and_errors(finished):
    tree = open_results(finished)
    row = next(r for r in summarize(tree) if (r.estimator, r.sampler) == ("one", "jittered"))
    terms = tree["one/jittered/terms"]
    assert (row.fit_first_n, row.basis) == (16, "walsh")
    assert [row.power_low, row.power_high] == terms["power_term_ci"].values.tolist()
    assert [row.cross_low, row.cross_high] == terms["cross_term_ci"].values.tolist()


@pytest.mark.usefixtures("undrawn")
def test_the_report_shows_basis_window_precision_and_errors(finished):
    text = write_report(finished).read_text(encoding="utf-8")
    for words in (
        "cosine basis, half width 4, domain space",
        "quadrature (jittered)",
        "Fourier basis",
        "Walsh basis",
        "400 realizations at most, fewer once the variance has a standard error of 10 %",
        "the last counts that lie on a line",
        "rates fitted to the last 2 counts",
        "fitted over n = 16 … 64,",
        "does not differ significantly from zero (power term: ",
        "fit_last = &#34;auto&#34;",
    ):
        assert words in text, words
    wedges = describe("bands", open_results(finished)["two/jittered/terms"].to_dataset())
    assert "wedge: direction of m" in wedges.caption
    terms = open_results(finished)["two/jittered-shift/terms"]
    low, high = terms["power_term_ci"].values
    half = f"± {(high - low) / 2:.1e}"[:5]
    assert half in text


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('basis = "auto"', 'basis = "fuorier"', "fuorier"),
        ('basis = "auto"', "basis = 3", "terms.basis is 3; it must be one of"),
        (
            'basis = "auto"',
            'basis = "haar"\nspace = "time"',
            "terms.space is 'time'; it must be one of domain, primary",
        ),
        (
            "half_width = 4, realizations = 60, b",
            "half_width = 5, realizations = 60, b",
            "power of",
        ),
        ('bands = "dyadic"', 'bands = "wedge"', "for 2 dims"),
        ('fit_last = "auto"', "fit_last = 1", "fit_last is 1; give a whole number of at least 2"),
        (
            "relative_error = 0.1",
            "relative_error = 1.5",
            "is 1.5; give a finite number at least 0.0001",
        ),
        ("relative_error = 0.1", 'relative_error = "5 %"', "is '5 %'; give a finite number"),
    ],
)
def test_settings_are_refused_before_anything_runs(tmp_path, old, new, words):
    assert old in STUDY
    with pytest.raises(ConfigError) as caught:
        make_plan(decode_study(STUDY.replace(old, new, 1)), tmp_path)
    assert words in str(caught.value)
