"""Sentences about results: their contents, and no statements that intervals do not support."""

import msgspec
import pytest
import xarray as xr

from mcspectra.report import explain
from mcspectra.report.sentences import answer, further_sentences, headline
from mcspectra.studies import SummaryRow


def case(
    *,
    dc=0.0,
    power=1.0,
    predicted=1.0,
    measured=1.0,
    width=1.02,
    space="domain",
):
    """Return a row and its terms; 95 % intervals extend by the factor `width` both ways."""
    cross = predicted - dc - power
    ends = [predicted / width, predicted * width]
    terms = xr.Dataset(
        {
            "dc_term": dc,
            "power_term": power,
            "cross_term": cross,
            "predicted_variance_ci": ("bound", ends),
            "captured_by_half_width": ("half_width", [0.0] * 33),
        },
        attrs={"space": space},
    )
    row = SummaryRow(
        estimator="e",
        sampler="s",
        terms_n=16,
        dc=dc,
        power=power,
        cross=cross,
        cross_low=cross - predicted * (width - 1.0),
        cross_high=cross + predicted * (width - 1.0),
        predicted=predicted,
        measured=measured,
        measured_low=measured / width,
        measured_high=measured * width,
        captured=predicted / measured if measured else None,
    )
    return row, terms


def curve(rate, half=0.03, **more):
    """Return a row that has only a rate."""
    ends = {} if rate is None else {"rate_low": rate - half, "rate_high": rate + half}
    return SummaryRow(estimator="e", sampler="s", n=1024, rate=rate, **ends, **more)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (curve(-1.52), "−1.52 ± 0.03 is faster than"),
        (curve(-0.5), "−0.50 ± 0.03 is slower than"),
        (curve(-1.52, fit_first_n=64), "−1.52 ± 0.03, fitted over n = 64 … 1024, is faster than"),
        (curve(-1.01), "is within three standard errors of"),
        (curve(-1.52, half=0.5), "is within three standard errors of"),
        (
            curve(-1.7, half=2.68),
            "The rate is not resolved: use five or more counts, more realizations or larger",
        ),
        (curve(-1.7, half=float("inf")), "The rate is not resolved"),
        (curve(None, variance=0.0), "is zero"),
        (curve(None, variance=1.0), "needs two counts"),
        (SummaryRow(estimator="e", sampler="s"), ""),
    ],
)
def test_rate(row, words):
    assert words in explain(row)


@pytest.mark.parametrize(
    ("options", "said", "unsaid"),
    [
        (
            {"predicted": 0.03, "measured": 0.03},
            ["removes 97 % of the power term", "a random shift would lose this gain"],
            [],
        ),
        ({"predicted": 0.0003, "measured": 0.0003}, ["removes 99.97 %"], []),
        (
            {"predicted": 1.5, "measured": 1.5},
            ["adds 50 %", "a random shift of unbiased points would avoid this"],
            [],
        ),
        ({"dc": 0.95, "power": 0.05}, ["95 % of the variance is the dc term"], []),
        ({"dc": 0.5, "power": 0.5}, [], ["dc term"]),
        (
            {"predicted": 0.61, "power": 0.61},
            ["The spectrum up to half width 32 accounts for only 61 % of the measured variance"],
            [],
        ),
        ({"predicted": 2.9}, ["predicts 2.90 times the measured variance"], []),
        ({"predicted": 0.98}, ["agree (98 %)"], []),
        ({"predicted": 1.00002}, ["agree (100 %)"], []),
        (
            {"predicted": 0.7, "power": 0.7, "width": 1.5},
            ["predicts 70 % of the measured variance; the 95 % interval"],
            ["only"],
        ),
        (
            {"measured": 0.0, "predicted": 0.0, "power": 0.0},
            ["The measured variance is zero, so no term needs an explanation."],
            ["cross term"],
        ),
    ],
)
def test_sentences_about_the_terms(options, said, unsaid):
    text = explain(*case(**options))
    assert all(words in text for words in said)
    assert not any(words in text for words in unsaid)


@pytest.mark.parametrize("predicted", [0.9, 1.1])
def test_cross_term__an_interval_around_zero_gives_no_claim(predicted):
    text = explain(*case(predicted=predicted, measured=predicted, width=1.2))
    assert "does not differ significantly from zero (power term: 1.00)" in text
    assert "removes" not in text
    assert "adds" not in text


def test_shift__no_promise_where_the_samples_are_weighted():
    weighted = explain(*case(dc=0.3, power=0.7, predicted=0.1, measured=0.1))
    assert "removes 90 % of the sum of dc and power terms" in weighted
    assert "shift" not in weighted
    primary = explain(*case(power=1.0, predicted=0.1, measured=0.1, space="primary"))
    assert "a random shift would lose this gain" in primary


@pytest.mark.parametrize("spec", ["random", "jittered | shift"])
@pytest.mark.parametrize(("predicted", "words"), [(0.9, "removes 10 % of"), (1.1, "adds 10 % to")])
def test_cross_term__of_shifted_points_is_chance(spec, predicted, words):
    row, terms = case(predicted=predicted, measured=predicted)
    text = explain(row, terms.assign_attrs(sampler_spec=spec))
    assert f"{words} the power term, by chance: its mean is zero for randomly shifted" in text
    digital = explain(row, terms.assign_attrs(sampler_spec="sobol | digital-shift"))
    assert "by chance" not in digital


def test_infinite_terms(make):
    terms = make["infinite"](half_width=2, realizations=10)
    row = SummaryRow(estimator="e", sampler="s", terms_n=16, measured=0.25)
    text = explain(row, terms)
    assert "dc and power terms are infinite because ∫1/p diverges" in text
    assert "0.250" in text
    assert "removes" not in text


def test_simulated_jitter_of_a_ramp(make):
    """For f = x, power is 1/(6n²) − …, cross is negative, and the sum is 1/(12n³)."""
    terms = make["terms"]("jittered", n=16, half_width=32, realizations=400)
    low, high = terms["measured_variance_ci"].values
    row = SummaryRow(
        estimator="e",
        sampler="s",
        terms_n=16,
        dc=float(terms["dc_term"]),
        power=float(terms["power_term"]),
        cross=float(terms["cross_term"]),
        predicted=float(terms["predicted_variance"]),
        measured=float(terms["measured_variance"]),
        measured_low=low,
        measured_high=high,
        captured=float(terms["captured"]),
        cross_low=1.5 * float(terms["cross_term"]),
        cross_high=0.5 * float(terms["cross_term"]),
    )
    text = explain(row, terms)
    assert "The cross term removes" in text
    assert "has not converged" in text


@pytest.mark.parametrize(
    ("predicted", "words"),
    [
        (0.5, "removes 50 % of the diagonal of the cosine basis."),
        (1.5, "adds 50 % to the diagonal of the cosine basis."),
        (1.01, "does not differ significantly from zero (power term: 1.00)."),
    ],
)
def test_sentences_on_other_bases_do_not_mention_shifts(predicted, words):
    row, terms = case(predicted=predicted, measured=predicted)
    text = explain(msgspec.structs.replace(row, basis="cosine"), terms)
    assert words in text
    assert "shift" not in text


def test_the_cross_term_follows_its_own_interval():
    """A cross term of −1.23e-7 ± 0.61e-7 is not zero, whatever the prediction's interval."""
    row, terms = case(predicted=0.9, measured=0.9, width=1.5)
    certain = msgspec.structs.replace(row, cross_low=-0.15, cross_high=-0.05)
    assert "The cross term removes 10 %" in explain(certain, terms)
    unknown = msgspec.structs.replace(row, cross_low=None, cross_high=None)
    assert "cross term" not in explain(unknown, terms)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"predicted": 2.9}, "The Fourier sum has not converged at half width 32 (basis = 'auto'"),
        ({"predicted": 0.5, "power": 0.5}, "50 % of the variance is beyond half width\u00a032."),
        ({"predicted": 0.5, "measured": 0.5}, "Correlation removes 50 % of dc + power."),
        ({"predicted": 1.5, "measured": 1.5}, "Correlation adds 50 % to dc + power."),
        ({}, "Prediction agrees."),
        (
            {"predicted": 1.18, "power": 1.18, "width": 1.3},
            "Predicts 118 %, but its interval contains 100 %.",
        ),
    ],
)
def test_headline_explains_a_wrong_prediction(options, words):
    assert headline(*case(**options)).startswith(words)


@pytest.mark.parametrize("predicted", [0.5, 0.85, 0.95, 1.0, 1.08, 1.18, 3.0])
@pytest.mark.parametrize("width", [1.01, 1.3])
def test_sentence_and_headline_report_the_same_agreement(predicted, width):
    row, terms = case(predicted=predicted, power=predicted, width=width)
    said = "Prediction and measurement agree" in explain(row, terms)
    assert said == ("Prediction agrees" in headline(row, terms))


def test_predictions_are_judged_by_simultaneous_intervals_of_all_rows():
    """A distance of 2.3 standard errors is chance among 18 rows (z = 2.98), not alone (1.96)."""
    half = 1.15 ** (1.96 / 2.3)
    row = SummaryRow(
        estimator="e", sampler="s", ratio=1.15, ratio_low=1.15 / half, ratio_high=1.15 * half
    )
    assert "predicted × 1.15" in headline(row).lower()
    assert "prediction agrees" in headline(row, rows=18).lower()


def test_headline_without_terms():
    assert headline(curve(-1.52)) == "Faster than random sampling."
    assert headline(curve(-1.0)) == "Random sampling's rate."
    assert headline(curve(-1.2, half=0.3)) == "Rate undecided."
    assert headline(SummaryRow(estimator="e", sampler="s")) == ""
    noted = SummaryRow(estimator="e", sampler="s", note="terms are infinite: ∫1/p diverges")
    assert headline(noted) == "Terms are infinite: ∫1/p diverges."


@pytest.mark.parametrize(
    ("analyses", "text"),
    [
        ({}, ""),
        (
            {"remedies": xr.Dataset(attrs={"diagnosis": "g jumps.", "answer": "Use owen."})},
            "g jumps. Use owen.",
        ),
        (
            {"predict": xr.Dataset(attrs={"note": "No form", "method": "exact"})},
            "No exact variance at every n: No form.",
        ),
        ({"predict": xr.Dataset(attrs={"note": "no variance", "method": "auto"})}, ""),
        (
            {"convergence": xr.Dataset(attrs={"note": "sobol has no variance"})},
            "Sobol has no variance.",
        ),
    ],
)
def test_further_sentences(analyses, text):
    assert further_sentences(analyses) == text


def measured(variance, mean=1.0, width=1.2):
    """Return a curve at n = 4, 16, …; intervals extend by `width`, means have error 0.01."""
    n = [4 ** (k + 1) for k in range(len(variance))]
    ends = [[v / width, v * width] for v in variance]
    return xr.Dataset(
        {
            "variance": ("n", variance),
            "variance_ci": (("n", "bound"), ends),
            "mean": ("n", [mean] * len(n)),
            "mean_se": ("n", [0.01] * len(n)),
        },
        {"n": n},
    )


def test_the_answer_is_the_least_error_that_is_significant_and_unbiased():
    random = measured([0.04, 0.01, 0.0025])
    setups = {"sobol": measured([0.02, 0.0001]), "random": random}
    text = "Use sobol: RMSE 0.01 (0.0091 to 0.011) at 16 evaluations instead of 0.1."
    assert str(answer(setups)) == text
    assert str(answer(setups, why="Jumps are many.")) == f"{text} Cause: jumps are many."
    assert "Cause" not in str(answer(setups, why="No jump was found."))
    slow = {"sobol": setups["sobol"], "random": random.assign(rate=-1.0)}
    assert "; random would need about 1600 (1100 to 2300) evaluations for the same RMSE" in str(
        answer(slow)
    )
    for other in (
        measured([0.02, 0.0099]),  # not significantly less
        measured([0.02, 0.0001], mean=1.1),  # another mean
        measured([0.0, 0.0]),  # no variance between realizations
    ):
        found = answer({"random": random, "other": other})
        assert str(found) == "Keep random: no tested change is significantly better."
    assert not answer({"random": random})


@pytest.mark.parametrize(
    ("other", "verdict", "has_gain"),
    [
        (measured([0.02, 0.0001]), "better", True),
        (measured([0.02, 0.0099]), "undecided", True),
        (measured([0.2, 0.1]), "worse", True),
        (measured([0.02, 0.0001], mean=1.1), "undecided", False),
        (measured([0.0, 0.0]), "undecided", False),
    ],
)
def test_verdicts_follow_from_the_intervals_of_the_gain(other, verdict, has_gain):
    """Earlier versions called a set-up with another mean worse, beside a gain above 1."""
    found = answer({"random": measured([0.04, 0.01]), "other": other}).results[1]
    assert found.verdict == verdict
    assert (found.gain == found.gain) == has_gain
