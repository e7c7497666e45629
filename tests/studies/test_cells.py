"""Cells of a study equal the results of the functions and are stored without text."""

import functools

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.plots.groups import labelled
from mcspectra.plots.kinds import describe
from mcspectra.report import write_report
from mcspectra.report.tables import analysis_table
from mcspectra.studies import make_plan, open_results, run_study, summarize
from mcspectra.studies.files import decode_study

STUDY = """
title = "further"
seed = 5
samplers = ["jittered | shift"]
[predict]
counts = [4, 16]
method = "exact"
[[estimators]]
name = "edge"
integrand = "linear"
dims = 1
anova = { realizations = 40 }
pcf = { n = 8, bins = 10, realizations = 4, boundary = "border" }
remedies = { budget = 64, realizations = 100, kinds = ["unshifted"] }
spectrum = { n = 8, half_width = 3, realizations = 6, frequency_step = 0.5 }
[[estimators]]
name = "sum"
integrands = ["linear", "step(at=0.3)"]
dims = 1
techniques = { counts = [4, 16], half_width = 4, realizations = 30, fit_last = 2 }
[[estimators]]
name = "wave"
integrand = "cosine(frequency=2)"
dims = 1
predict = { counts = [4, 16], method = "all", half_width = 4, realizations = 30 }
[[estimators]]
name = "none"
integrand = "disk"
predict = { counts = [4], method = "exact" }
samplers = ["poisson-disk"]
"""
SAMPLER = "jittered | shift"


@pytest.fixture(scope="module")
def finished(once, tmp_path_factory):
    """The results of the study; one test writes its report."""

    def computed():
        folder = tmp_path_factory.mktemp("study")
        run_study(decode_study(STUDY), folder, workers=2)
        return folder

    return once("cells", computed)


@functools.cache
def _expected():
    edge = mcs.Estimator("linear", dims=1)
    both = mcs.estimators.TechniqueSum(["linear", "step(at=0.3)"], dims=1)
    return {
        "edge/jittered-shift/anova": mcs.anova_variances(edge, SAMPLER, realizations=40, rng=5),
        "edge/jittered-shift/pcf": mcs.pair_correlation(
            mcs.sampler(SAMPLER, 1), 8, bins=10, realizations=4, boundary="border", rng=5
        ),
        "edge/jittered-shift/remedies": mcs.remedies(
            edge, SAMPLER, 64, realizations=100, kinds=["unshifted"], rng=5
        ),
        "edge/jittered-shift/spectrum": mcs.power_spectrum(
            mcs.sampler(SAMPLER, 1), 8, half_width=3, realizations=6, frequency_step=0.5, rng=5
        ),
        "wave/jittered-shift/predict": mcs.predict(
            mcs.Estimator("cosine(frequency=2)", dims=1),
            SAMPLER,
            [4, 16],
            method="all",
            half_width=4,
            realizations=30,
            rng=5,
        ),
        "sum/jittered-shift/techniques": mcs.technique_terms(
            both, SAMPLER, [4, 16], half_width=4, realizations=30, fit_last=2, rng=5
        ),
    }


def test_cells_equal_the_results_of_the_functions(finished):
    tree = open_results(finished)
    for path, expected in _expected().items():
        stored = tree[path].to_dataset()
        assert set(stored.data_vars) == set(expected.data_vars), path
        for name in expected.data_vars:
            assert np.array_equal(stored[name], expected[name], equal_nan=True), (path, name)
        for name, coord in expected.coords.items():
            if coord.dtype.kind == "U" and name != "bound":
                assert stored.attrs[f"labels_{name}"] == coord.values.tolist()
                assert name not in stored.coords


def test_exact_variances(finished):
    found = open_results(finished)["edge/jittered-shift/predict"]
    estimator = mcs.Estimator("linear", dims=1)
    wanted = [mcs.exact_variance(estimator, SAMPLER, n) for n in (4, 16)]
    assert found["predicted_variance"].values.tolist() == wanted
    assert "note" not in found.attrs


def test_a_missing_closed_form_is_a_note_not_a_failure(finished):
    found = open_results(finished)["none/poisson-disk/predict"]
    assert np.isnan(found["predicted_variance"].values).all()
    with pytest.raises(mcs.NoClosedForm) as caught:
        mcs.exact_variance(mcs.Estimator("disk"), "poisson-disk", 4)
    assert found.attrs["note"] == str(caught.value).rstrip(".")
    assert found.attrs["labels_method"] == ["none"]


def test_results_of_several_methods_keep_their_labels(finished):
    """Texts along two dims become attributes of a store; plots and tables read them."""
    stored = open_results(finished)["wave/jittered-shift/predict"].to_dataset()
    again, expected = labelled(stored), _expected()["wave/jittered-shift/predict"]
    assert again["how"].dims == ("method", "n")
    for name in ("method", "how"):
        assert (again[name].values == expected[name].values).all()
    assert "homogenized" in describe("prediction", {SAMPLER: stored}).words
    heading, table = analysis_table("predict", {SAMPLER: stored})
    rows = [[cell.text for cell in row] for row in table.rows]
    assert heading == "Predictions in numbers"
    assert len(rows) == 2 * 12
    assert [SAMPLER, "4", "homogenized (power in closed form)"] in [r[:2] + r[4:5] for r in rows]


@pytest.mark.usefixtures("undrawn")
def test_the_report_has_tables_of_all_analyses(finished):
    text = write_report(finished).read_text(encoding="utf-8")
    tree = open_results(finished)
    remedies = tree["edge/jittered-shift/remedies"]
    for heading in ("Remedies", "Techniques", "Axes"):
        assert f"<h3>{heading}</h3>" in text
    assert "Predictions in numbers" in text
    assert remedies.attrs["labels_remedy"][0] in text
    assert tree["sum/jittered-shift/techniques"].attrs["bottleneck"] in text
    assert tree["none/poisson-disk/predict"].attrs["note"][:30] in text
    assert summarize(tree) == []


def test_the_report_contains_the_study(finished):
    from mcspectra.report.study import study_toml

    config = decode_study(STUDY)
    assert decode_study(study_toml(open_results(finished).attrs["study"])) == config


@pytest.mark.render
@pytest.mark.usefixtures("undrawn")
def test_maps_equal_the_results_of_variance_map(tmp_path):
    from mcspectra.rendering import variance_map

    text = """
title = "map"
seed = 3
[[maps]]
name = "m"
scene = "penumbra"
samplers = ["jittered"]
strategies = ["mis"]
size = [4, 4]
crop = [1, 2, 2, 2]
counts = [4, 16]
realizations = 6
predict_every = 0
"""
    (cell,) = make_plan(decode_study(text), tmp_path).cells
    stored = cell.compute(3)
    direct = variance_map(
        "penumbra", ["mis"], "jittered", [4, 16], 6, size=(4, 4), crop=(1, 2, 2, 2), rng=3,
        predict_every=0,
    )  # fmt: skip
    for name in direct.data_vars:
        assert np.array_equal(stored[name], direct[name], equal_nan=True), name
    assert stored["strategy"].values.tolist() == direct["strategy"].values.tolist()
    run_study(decode_study(text), tmp_path, workers=1)
    assert "<h3>Map</h3>" in write_report(tmp_path).read_text(encoding="utf-8")
