"""The verbs predict and variance, its splits, and views of spectrum equal their functions."""

import io
import re

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.analysis import ANALYSES


def test_exact_variance_of_a_line(run, run_json):
    """Jittered points and a linear function: 1/(12 n³), so the local rate is −3."""
    arguments = (
        "predict",
        "linear",
        "-d",
        1,
        "--sampler",
        "jittered",
        "--counts",
        "4, 8",
        "--method",
        "exact",
    )
    data = run_json(*arguments)
    assert data["n"] == [4, 8]
    assert data["predicted_variance"] == pytest.approx([1 / (12 * 4**3), 1 / (12 * 8**3)])
    code, out, _ = run(*arguments)
    assert code == 0
    rows = [line.split() for line in out.splitlines()[3:5]]
    assert [row[1:3] for row in rows] == [["0.00130208333", "−3.00"], ["0.000162760417", "−3.00"]]
    assert rows[0][-2:] == ["exact", "(quadrature)"]


def test_exact_variance_of_zero_has_no_rate(run):
    given = ("--sampler", "regular", "--counts", "4,8,16", "--method", "exact")
    code, out, _ = run("predict", "linear", "-d", 1, *given)
    assert code == 0
    assert [line.split()[1:3] for line in out.splitlines()[3:]] == [["0", "–"]] * 3


def test_quiet_keeps_the_result(run):
    arguments = ("variance", "linear", "-d", 1, "--sampler", "jittered", "-n", 4, "-m", 20)
    loud, quiet = run(*arguments), run(*arguments, "--quiet")
    assert loud[1] == quiet[1] != ""
    assert quiet[2] == ""


def test_anova_equals_the_function(run, run_json):
    arguments = ("variance", "gaussian", "--split", "axes", "-d", 3, "-m", 300, "--seed", 2)
    data = run_json(*arguments)
    estimator = mcs.Estimator("gaussian", dims=3)
    expected = mcs.anova_variances(estimator, realizations=300, rng=2)
    assert data["subset"] == ["x0", "x1", "x2", "x0x1", "x0x2", "x1x2"]
    for name in ("anova_variance", "anova_variance_se", "anova_share", "total_variance"):
        assert data[name] == expected[name].values.tolist()
    code, out, _ = run(*arguments)
    assert code == 0
    lines = out.splitlines()
    rows = [line.replace("larger subsets", "larger").split() for line in lines]
    rows = [row for row in rows if row[0].startswith(("x", "larger"))]
    assert sum(float(row[3]) for row in rows) == pytest.approx(1.0, abs=1e-3)
    low, high = expected["anova_share_ci"].values[0]
    assert rows[0][4:] == [f"{low:.4g}", "…", f"{high:.4g}"]
    low, high = expected["mean_dimension_ci"].values
    dimension = f"{float(expected['mean_dimension']):.6g}"
    assert f"mean dimension: {dimension}, 95 % interval {low:.4g} … {high:.4g}" in lines


def test_anova_of_points_and_order(run_json):
    data = run_json(
        *("variance", "linear", "-d", 2, "--sampler", "latin-hypercube", "-n", 8, "-m", 100),
        *("--split=axes", "--order", 1, "--density", "uniform"),
    )
    assert data["subset"] == ["x0", "x1"]
    assert (data["n"], data["order"]) == (8, 1)
    assert len(data["anova_variance"]) == 2


def test_modes_equal_the_function(run, run_json, tmp_path):
    file = tmp_path / "modes.npz"
    arguments = ("variance", "gaussian", "-d", 2, "--sampler", "jittered", "-n", 16, "-m", 60)
    options = (
        "--split",
        "modes",
        "--half-width",
        4,
        "--modes",
        3,
        "--bands",
        "anova",
        "--band",
        "x0",
    )
    data = run_json(*arguments, *options, "-o", file)
    expected = mcs.covariance_modes(
        *(mcs.Estimator("gaussian", dims=2), "jittered", 16),
        half_width=4,
        modes=3,
        realizations=60,
        bands="anova",
        band=["x0"],
    )
    for name in ("eigenvalue", "eigenvalue_share", "mode_contribution"):
        assert data[name] == expected[name].values.tolist()
    assert data["band_trace"] == float(expected["band_trace"])
    assert np.array_equal(np.load(file)["mode_vector"], expected["mode_vector"])
    code, out, _ = run(*arguments, *options)
    assert code == 0
    assert f"{data['eigenvalue'][0]:.5g}" in out
    assert out.splitlines()[-1].startswith("sum of all eigenvalues: ")


def test_modes_of_the_points_alone(run_json):
    arguments = ("variance", "gaussian", "-d", 1, "--sampler", "random", "-n", 4, "-m", 50)
    options = (
        "--split",
        "modes",
        "--half-width",
        2,
        "--modes",
        1,
        "--points-only",
        "--basis",
        "cosine",
    )
    data = run_json(*arguments, *options)
    expected = mcs.covariance_modes(
        *(mcs.Estimator("gaussian", dims=1), "random", 4),
        half_width=2,
        modes=1,
        realizations=50,
        weighted=False,
        basis="cosine",
    )
    assert data["eigenvalue"] == expected["eigenvalue"].values.tolist()
    assert (data["weighted"], data["basis"]) == (0, "cosine")


def test_modes_without_variance_say_so(run):
    arguments = ("variance", "constant", "-d", 1, "--sampler", "jittered", "-n", 4, "-m", 20)
    code, out, _ = run(*arguments, "--split", "modes", "--half-width", 2, "--modes", 2)
    assert code == 0
    assert out.splitlines()[-1] == "no mode: the coefficients do not vary"
    arguments = ("variance", "linear", "-d", 1, "--sampler", "regular | shift", "-n", 4, "-m", 50)
    _, out, _ = run(*arguments, "--split", "modes", "--half-width", 4, "--modes", 4)
    assert "2 more at rounding level" in out  # S_4 has a phase, so there are two modes
    assert "nan" not in out


SPECTRUM = ("spectrum", "jittered", "-n", 16, "--half-width", 5, "-m", 20)


@pytest.fixture(scope="module")
def spectrum():
    return mcs.power_spectrum("jittered", 16, half_width=5, realizations=20)


@pytest.mark.parametrize(
    ("view", "function", "names"),
    [
        ("radial", mcs.spectra.radial_statistics, ["radial_power", "anisotropy_db"]),
        ("slices", mcs.spectra.slices, ["slice_power", "slice_radius"]),
        ("wedges", mcs.spectra.wedge_means, ["angle", "wedge_power", "wedge_power_se"]),
        ("exponent", mcs.spectra.low_frequency_exponent, ["low_frequency_exponent_ci"]),
    ],
)
def test_views_of_a_spectrum(run, run_json, spectrum, view, function, names):
    data = run_json(*SPECTRUM, "--show", view)
    expected = function(spectrum)
    assert data["n"] == 16
    for name in names:
        assert np.allclose(
            np.array(data[name], float), expected[name].values, rtol=1e-12, equal_nan=True
        )
    code, out, _ = run(*SPECTRUM, "--show", view)
    assert code == 0
    first = float(expected[names[-1]].values.ravel()[0])
    last_power = {
        "radial": lambda: f"{16 * float(expected['radial_power'][-1]):.5g}",
        "slices": lambda: f"{16 * float(expected['slice_power'][-1, -1]):.5g}",
        "wedges": lambda: f"{16 * float(expected['wedge_power'][-1]):.5g}",
        "exponent": lambda: f"{first:.3g} … ",  # The interval shows that it is not resolved
    }[view]()
    assert last_power in out.splitlines()[-1]
    assert "nan" not in out


def test_a_spectrum_shows_radial_power_by_default(run):
    assert run(*SPECTRUM)[1] == run(*SPECTRUM, "--show", "power")[1]


def test_a_missing_exponent_has_a_reason(run, run_json):
    arguments = ("spectrum", "regular", "-n", 64, "--half-width", 6, "-m", 2, "--show", "exponent")
    code, out, _ = run(*arguments)
    assert code == 0
    assert out.startswith("no exponent: 3 of 3 lengths have no power")
    assert run_json(*arguments)["low_frequency_exponent"] is None


def test_an_infinite_exact_variance_is_printed(run):
    given = ("cosine", "-d", 1, "--density", "power", "--sampler", "random", "--counts", "4,8")
    code, out, _ = run("predict", *given, "--method", "exact")
    assert code == 0
    assert [line.split()[1] for line in out.splitlines()[3:]] == ["infinite"] * 2


def test_a_warning_is_shown_once(run):
    given = ("converge", "linear", "-d", 1, "--sampler", "sobol | digital-shift", "-n", "16,60")
    code, _, err = run(*given, "-m", 20)
    assert code == 0
    assert err.count("60 Sobol' points are not balanced") == 1


@pytest.mark.parametrize(("verb", "name"), [("spectrum", "power"), ("pcf", "pair_correlation")])
def test_all_sets_given_are_used_by_default(run, run_json, monkeypatch, verb, name):
    del name
    for sets in (1, 3):
        code, points, _ = run("points", "jittered", "-n", 16, "-m", sets)
        assert code == 0
        monkeypatch.setattr("sys.stdin", io.StringIO(points))
        options = ["--half-width", 3] if verb == "spectrum" else ["--bins", 4]
        data = run_json(verb, "-", "-n", 16, *options)
        assert data["realizations"] == sets


def test_asking_for_more_sets_than_given(run, monkeypatch):
    _, points, _ = run("points", "jittered", "-n", 16)
    monkeypatch.setattr("sys.stdin", io.StringIO(points))
    code, _, err = run("spectrum", "-", "-n", 16, "-m", 5)
    assert code == 2
    assert "holds 1 realization, but" in err


AXES = ("variance", "--split", "axes")


def test_effective_dimensions_beyond_the_order(run):
    """Similar to Π(1 + 3(x − ½)) in 3 dims: subsets of three axes have more than 1 %."""
    code, out, _ = run(*AXES, "polynomial(coefficients=[0, 1])", "-d", 3, "-m", "2e4")
    assert code == 0
    assert "effective dimension superposition: more than 2" in out
    code, out, _ = run(*AXES, "constant", "-d", 2, "-m", 10)
    assert code == 0
    assert out.count("undefined") == 4 + 3
    assert "nan" not in out


def test_shares_at_rounding_level_are_zero(run):
    _, out, _ = run(*AXES, "linear", "-d", 3, "-m", 200)
    shares = {line.split()[0]: line.split()[3] for line in out.splitlines()[3:9]}
    assert shares["x1"] == shares["x2"] == shares["x1x2"] == "0"
    assert shares["x0"] == "1"


SEVERAL = {
    "converge": ("--counts", "4,16", "-m", 20),
    "predict": ("--counts", "4,16"),
    "plan": ("--target-error", 0.1),
    "variance": ("-n", 16, "--half-width", 4, "-m", 20),
}


def test_several_samplers_wherever_the_analysis_takes_them(run, run_json):
    """Options follow from the declaration: two samplers are a dim, one sampler is not."""
    verbs = {
        cls.verb
        for name in ANALYSES
        if "sampler" in (cls := ANALYSES.load(name)).several and cls.verb
    }
    assert verbs == set(SEVERAL)
    two = ("--sampler", "jittered", "--sampler", "random")
    for verb, options in SEVERAL.items():
        code, out, _ = run(verb, "linear", "-d", 1, *two, *options)
        assert code == 0
        assert "jittered" in out
        assert "random" in out
        assert "nan" not in out
        assert run_json(verb, "linear", "-d", 1, *two, *options)["sampler"] == [
            "jittered",
            "random",
        ]
        one = run_json(verb, "linear", "-d", 1, *two[:2], *options)
        assert one["sampler"] == "jittered"
        twice = run(verb, "linear", "-d", 1, *two, *two[:2], *options)
        assert twice[0] == 2
        assert "The sampler jittered is listed twice; list each once." in twice[2]
    code, _, err = run("remedies", "linear", "-d", 1, *two, "--budget", 4)
    assert code == 2
    assert "--sampler is given twice; give it once" in err


def test_several_predictions_equal_single_predictions(run_json):
    two = ("--sampler", "jittered", "--sampler", "random")
    data = run_json("predict", "gaussian", *two, "--counts", "16,64")
    expected = mcs.predict("gaussian", ["jittered", "random"], [16, 64])
    assert data["predicted_variance"] == expected["predicted_variance"].values.tolist()
    assert data["method"] == expected["method"].values.tolist()


def test_all_methods_are_rows_and_missing_values_have_a_reason(run, run_json):
    given = ("predict", "gaussian", "--sampler", "sobol | owen", "--counts", "16,64")
    options = ("--method", "all", "-m", 50, "--half-width", 4)
    code, out, _ = run(*given, *options)
    assert code == 0
    rows, reasons = out.split("no value from\n")
    for n in (16, 64):
        assert re.search(rf"^{n} .* exact \(quadrature\)$", rows, re.MULTILINE)
        assert re.search(rf"^{n} .* measured \(50 realizations\)$", rows, re.MULTILINE)
    assert reasons.count("  torus: sobol | owen is not known to be the same") == 1
    data = run_json(*given, *options)
    assert "measured" in data["method"]
    code, _, err = run("predict", "gaussian", *given[2:], "--method", "torus")
    assert code == 2
    assert "The method torus does not apply to gaussian with sobol | owen" in err


def test_a_plan_without_an_answer_says_why(run):
    """The same holds for `predict`; among other samplers, such a sampler is a note."""
    sampler = ("--sampler", "sobol", "--target-error")
    why = "a deterministic sampler has no variance: add owen or shift, or compare |bias|"
    code, out, err = run("plan", "gaussian", *sampler, 0.1)
    assert (code, out) == (2, "")
    assert why in err
    code, _, err = run("predict", "gaussian", "--sampler", "sobol", "--counts", "16,64")
    assert code == 2
    assert why in err.lower()
    code, out, _ = run("plan", "gaussian", *sampler, 0.1, "--sampler", "random")
    assert code == 0
    assert "n = 7 with random" in out.splitlines()[0]
    assert out.splitlines()[-1].startswith("sobol: a deterministic sampler has no variance")


def test_variance_prints_the_variance_beyond_its_half_width(run, run_json):
    arguments = ("variance", "disk", "--sampler", "random", "-n", 16, "--half-width", 4, "-m", 50)
    data = run_json(*arguments)
    _, out, _ = run(*arguments)
    rows = {line.split("  ")[0]: line.split()[-1] for line in out.splitlines()}
    assert rows["energy share"] == f"{data['energy_share']:.6g}"
    assert rows["tail term"] == f"{data['tail_term']:.6g}"
    _, out, _ = run("variance", "gaussian", "--sampler", "sobol", "-n", 16, "-m", 20)
    assert "e-3" not in out
    assert "sobol has no variance: add owen or shift, or compare |bias|" in out


def test_variance_has_a_table_for_each_sampler(run, run_json):
    rest = ("-n", 16, "--half-width", 4, "-m", 50)
    samplers = ("random", "sobol | owen")
    both = ("variance", "gaussian", *(part for s in samplers for part in ("--sampler", s)), *rest)
    data = run_json(*both)
    assert data["sampler"] == list(samplers)
    _, out, _ = run(*both)
    title, about, *tables = out.split("\n\n")[0].splitlines() + out.split("\n\n")[1:]
    assert title == "gaussian,  n = 16"
    assert "50 realizations; domain space" in about
    for k, sampler in enumerate(samplers):
        alone = run_json("variance", "gaussian", "--sampler", sampler, *rest)
        assert data["cross_term"][k] == alone["cross_term"]
        assert data["band_covariance"][k] == alone["band_covariance"]
        _, text, _ = run("variance", "gaussian", "--sampler", sampler, *rest)
        assert tables[k].splitlines() == [sampler, *text.splitlines()[2:]]


OF_SPLITS = {
    "terms": ("--cross-matrix", "--bands"),
    "techniques": ("--counts", "--fit-last"),
    "axes": ("--order", "--groups"),
    "modes": ("--modes", "--points-only", "--bands"),
}


@pytest.mark.parametrize("split", OF_SPLITS)
def test_a_split_refuses_options_of_other_splits(run, split):
    subject = ("linear", "-d", 1, "--sampler", "random", "-n", 4, "--split", split)
    own = set(OF_SPLITS[split])
    flags = ("--cross-matrix", "--points-only")
    for owner, options in OF_SPLITS.items():
        for option in set(options) - own:
            code, out, err = run("variance", *subject, option, *([] if option in flags else ["1"]))
            assert (code, out) == (2, "")
            assert re.search(rf"{option} is for --split .*{owner}", err), err
            assert err.count("\n") == 1


def test_help_groups_options_by_the_splits_that_have_them(run):
    code, out, _ = run("variance", "--help")
    assert code == 0
    common, *groups = re.split(r"^with --split (.*):$", out, flags=re.MULTILINE)
    found = dict(zip(groups[::2], groups[1::2], strict=True))
    assert list(found) == [
        "terms, techniques or modes", "terms or modes", "terms", "techniques", "axes", "modes",
    ]  # fmt: skip
    assert "--half-width" in found["terms, techniques or modes"]
    assert "--order" in found["axes"]
    assert "--realizations" in common
    assert "10000 with --split axes" in " ".join(common.split())
    _, out, _ = run("variance", "--split", "axes", "--help")
    assert out.index("--order") < out.index("with --split terms:")
    code, _, err = run("variance", "linear", "--split", "term")
    assert (code, "--split is 'term'; it must be one of terms, techniques, axes" in err) == (
        2,
        True,
    )


@pytest.mark.parametrize("counts", [("-n", 4), ("--counts", "4,8"), ("-n", "4,8e0")])
def test_techniques_take_one_count_or_several(run_json, counts):
    given = ("--density", "uniform", "--density", "tent", "--sampler", "random", "-m", 20)
    found = run_json("variance", "linear", "-d", 1, "--split", "techniques", *given, *counts)
    expected = mcs.technique_terms(
        mcs.MultipleImportance("linear", ["uniform", "tent"], dims=1),
        "random",
        [4, 8] if "," in str(counts[1]) else 4,
        realizations=20,
    )
    np.testing.assert_array_equal(found["technique_variance"], expected["technique_variance"])


def test_all_files_come_from_one_run_and_are_checked_first(run, tmp_path, monkeypatch):
    from mcspectra.cli import analysis

    calls = []
    compute = analysis.compute
    monkeypatch.setattr(analysis, "compute", lambda *a: calls.append(a) or compute(*a))
    files = [tmp_path / f"v.{end}" for end in ("npz", "csv", "html")]
    arguments = ("variance", "linear", "-d", 1, "--sampler", "random", "-n", 4, "-m", 20)
    code, _, err = run(*arguments, *(part for file in files for part in ("-o", file)))
    assert (code, err, len(calls)) == (0, "", 1)
    value = float(np.load(files[0])["measured_variance"])
    assert f"{value:.6g}"[:5] in files[1].read_text()
    assert all(file.stat().st_size > 100 for file in files)
    for bad in ("v.gif", "no/v.csv"):
        code, _, err = run(*arguments, "-o", tmp_path / "w.csv", "-o", tmp_path / bad)
        assert (code, len(calls)) == (2, 1)
        assert bad in err
        assert not (tmp_path / "w.csv").exists()


@pytest.mark.parametrize(
    ("text", "words"), [("1.5e0", "-n is 1.5; give a whole"), ("1e999", "-n is '1e999'")]
)
def test_counts_are_whole_numbers_in_any_notation(run, run_json, text, words):
    arguments = ("variance", "linear", "-d", 1, "--sampler", "random")
    assert run_json(*arguments, "-n", "1.6e1", "-m", "2e1")["n"] == 16
    code, _, err = run(*arguments, "-n", text)
    assert code == 2
    assert words in err


def test_errors_name_options_and_verbs_as_they_are_typed(run):
    subject = ("gaussian", "--sampler", "random", "-n", 64)
    _, _, err = run("variance", *subject, "--max-evaluations", 100)
    assert err.startswith("mcspectra: 'mcspectra variance' takes at least 64000 evaluations")
    assert "--max-evaluations is 100" in err
    _, _, err = run("variance", *subject, "--split", "axes", "--max-evaluations", 100)
    assert err.startswith("mcspectra: 'mcspectra variance --split axes' takes at least")
    with pytest.raises(
        mcs.core.errors.BudgetError, match=r"^variance_terms takes .*max_evaluations is"
    ):
        mcs.variance_terms("gaussian", "random", 64, max_evaluations=100)


def test_the_picture_is_that_of_the_view(run, tmp_path):
    radial = ("spectrum", "jittered", "-n", 16, "--dims", 2, "--realizations", 5)
    assert run(*radial, "--show", "radial", "-o", tmp_path / "radial.svg")[0] == 0
    assert "|m| / √n" in (tmp_path / "radial.svg").read_text("utf-8")
    matrix = ("variance", "gaussian", "--dims", 1, "--sampler", "jittered", "-n", 16)
    matrix += ("--half-width", 2, "--realizations", 20, "--cross-matrix")
    assert run(*matrix, "-o", tmp_path / "matrix.svg")[0] == 0
    assert "imaginary: jittered" in (tmp_path / "matrix.svg").read_text("utf-8")
