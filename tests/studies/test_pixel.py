"""The analysis of a pixel: parts equal single analyses; sentences follow the numbers."""

import re
from typing import Any

import numpy as np
import pytest
import xarray as xr
from tests.fonts import fonts_once
from tests.rendering.small_scenes import plate
from tests.report.drawing import no_pdf
from tests.studies.conftest import of_a_bell, predicted_bell

import mcspectra as mcs
from mcspectra.core.errors import CountError, McspectraError, ParameterError
from mcspectra.explain.diagnosis import Diagnosis
from mcspectra.integrands import _quadrature
from mcspectra.plots.text import number
from mcspectra.rendering import Pixel, named_pixels, pixel_mis
from mcspectra.rendering.pixel import incident_light
from mcspectra.report.page import powers
from mcspectra.report.pixel_page import (
    STRATEGY_NAMES,
    about_pixel,
    bottleneck_sentence,
    pixel_answer,
    pixel_rows,
    pixel_sentences,
    pixel_summary,
    term_rows,
    write_pixel,
)
from mcspectra.studies import pixel as module
from mcspectra.studies.pixel import (
    EFFORTS,
    PIXEL_STRATEGIES,
    PixelEffort,
    analyse_pixel,
    find_pixel,
)

__all__ = ["fonts_once"]

pytestmark = [pytest.mark.render, pytest.mark.usefixtures("coarse_pixels")]

SAMPLERS = ("random", "jittered | shift")
COUNTS = (4, 16, 64)
SMALL = PixelEffort(
    counts={2: COUNTS, 3: (8, 64)},
    realizations=100,
    half_width={2: 6, 3: 2},
    resolution=32,
    remedies=("unshifted", "techniques"),
)
OPTIONS: dict[str, Any] = {"realizations": 100, "rng": 3}


@pytest.fixture(scope="module", autouse=True)
def small_effort():
    """Reduce the work, and predict a bell."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(EFFORTS, "quick", SMALL)
        patch.setattr(module, "predict", predicted_bell)
        # Points for means and nodes for coefficients; the usual numbers would take many seconds
        patch.setattr("mcspectra.rendering.pixel._POINTS", 2**12)
        patch.setattr(_quadrature, "_LEAST_NODES", {2: 64, 3: 16})
        patch.setattr(_quadrature, "_BUDGET", 2**14)
        yield


@pytest.fixture(scope="module")
def analysed(once, small_effort):
    """The analysis of pixel Q, and the arguments and outputs of its calls of `predict`."""

    def analyse():
        calls = []

        def predicted(estimator, *given, **options):
            found = predicted_bell(estimator, *given, **options)
            calls.append((estimator.spec, *map(list, given), options, found))
            return found

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, "predict", predicted)
            return analyse_pixel("figure1", "Q", samplers=SAMPLERS, budget=128, rng=3), calls

    return once("pixel", analyse)


@pytest.fixture(scope="module")
def tree(analysed):
    return analysed[0]


def estimators():
    x, y = named_pixels("figure1")["Q"]
    singles = {
        s: mcs.Estimator(Pixel(scene="figure1", x=x, y=y, strategy=s)) for s in ("light", "bsdf")
    }
    return singles | {h: pixel_mis("figure1", x, y, heuristic=h) for h in ("balance", "power")}


def same(found, expected, *names):
    for name in names or expected.data_vars:
        assert np.array_equal(found[name].values, expected[name].values, equal_nan=True), name


@pytest.fixture
def only_balance(monkeypatch):
    """Diagnose only the balance heuristic; make no pictures, and terms of a bell."""
    usual, terms = module.diagnose, of_a_bell(mcs.variance_terms)

    def diagnosed(estimator, *given):
        named = "balance" in estimator.spec
        return usual(estimator, *given) if named else Diagnosis([], unseen="Left out.")

    picture = mcs.explain.primary_picture("disk", resolution=8)
    monkeypatch.setattr(module, "diagnose", diagnosed)
    monkeypatch.setattr(module, "variance_terms", terms)
    monkeypatch.setattr(module, "primary_picture", lambda *_, **__: picture)
    monkeypatch.setattr(module, "preview", lambda *_: np.zeros((2, 2, 3)))


@pytest.mark.usefixtures("only_balance")
def test_the_cause_belongs_to_the_named_sampler():
    """Only a shift carries a jump into strata, so plain strata must not report that cause."""
    found = analyse_pixel(
        "figure1",
        "P",
        samplers=("jittered", "jittered | shift"),
        counts=(4, 16),
        realizations=50,
        remedies=False,
        rng=3,
    )
    said = pixel_answer(found)
    assert "balance with jittered would need about" in said
    assert "shift carries" not in said


def test_curves_equal_those_of_convergence(tree):
    """Two of the four strategies, because each strategy has kernels of its own."""
    made = estimators()
    pair = ["bsdf", "power"]
    direct = mcs.convergence([made[name] for name in pair], list(SAMPLERS), COUNTS, **OPTIONS)
    found = tree["convergence"].to_dataset()
    assert found["strategy"].values.tolist() == list(PIXEL_STRATEGIES)
    assert found["spec"].values.tolist() == [each.spec for each in made.values()]
    same(found.sel(strategy=pair), direct)


def test_predictions_equal_those_of_predict_and_appear_on_the_page(analysed):
    tree, calls = analysed
    asked = {spec: call for spec, *call, _ in calls}
    said = {spec: answer for spec, *_, answer in calls}
    for name in PIXEL_STRATEGIES:
        spec = estimators()[name].spec
        samplers, counts, options = asked[spec]
        assert samplers == [mcs.sampler(s, dims=2) for s in SAMPLERS]
        assert (counts, options["rng"]) == (list(COUNTS), 3)
        found, direct = tree[f"predict/{name}"].to_dataset(), said[spec]
        same(found, direct)
        assert np.array_equal(found["method"], direct["method"])
    direct = said[estimators()["balance"].spec]
    rows = [row for row in pixel_rows(tree) if row.estimator == STRATEGY_NAMES["balance"]]
    measured = tree["convergence"]["variance"].sel(strategy="balance")
    for row in rows:
        at = {"sampler": row.sampler, "n": COUNTS[-1]}
        ratio = float(direct["predicted_variance"].sel(at) / measured.sel(at))
        assert row.ratio == pytest.approx(ratio, rel=1e-12)
        assert row.method == str(direct["method"].sel(at).values)
    said = dict(pixel_sentences(tree))["MIS, balance"]
    assert f"({rows[SAMPLERS.index(tree.attrs['sampler'])].method})" in said
    listed = next(r for r in pixel_summary(tree)["rates"] if r["strategy"] == "balance")
    assert np.array_equal(listed["predicted_variance"], direct["predicted_variance"][0])


@pytest.mark.parametrize(("strategy", "view"), [("light", "auto"), ("balance", "fourier")])
def test_terms_equal_those_of_variance_terms(tree, strategy, view):
    direct = mcs.variance_terms(
        estimators()[strategy],
        SAMPLERS[1],
        16,
        half_width=6,
        space="primary",
        basis=view,
        **OPTIONS,
    )
    same(tree[f"terms/{strategy}/{view}"].to_dataset(), direct)


def test_techniques_pictures_and_light_are_direct_calls(tree):
    balance = estimators()["balance"]
    direct = mcs.technique_terms(
        balance, SAMPLERS[1], COUNTS, half_width=6, space="primary", basis="auto", **OPTIONS
    )
    same(tree["techniques"].to_dataset(), direct)
    picture = mcs.explain.primary_picture(balance, technique=1, resolution=32)
    same(tree["pictures/balance-bsdf"].to_dataset(), picture, "primary_value")
    same(
        tree["incident"].to_dataset(),
        incident_light("figure1", *named_pixels("figure1")["Q"], resolution=64),
    )


def test_remedies_are_direct_calls(tree):
    kinds = SMALL.remedies
    direct = mcs.remedies(estimators()["balance"], SAMPLERS[1], 128, kinds=kinds, **OPTIONS)
    found = tree["remedies"].to_dataset()
    same(found, direct)
    assert found["remedy"].values.tolist() == direct["remedy"].values.tolist()
    assert found.attrs["answer"] == direct.attrs["answer"]


def test_steps_of_float32_are_not_jumps(tree):
    """From P the whole light is visible, so g of its samples is smooth; from Q it is cut."""
    assert float(tree["pictures/light"]["primary_jump_length"].sel(kind="interior")) > 0
    x, y = named_pixels("veach")["wall"]
    smooth = mcs.Estimator(Pixel(scene="veach", x=x, y=y, light="light-3"))
    raw = mcs.explain.primary_picture(smooth, resolution=32)
    cleaned = module._without_rounding(raw)
    floor = 1e-5 * float(raw["primary_value"].max())
    assert cleaned.attrs["smallest_jump"] == pytest.approx(floor)
    assert float(cleaned["primary_jump_length"].sel(kind="interior")) == 0.0
    kept = cleaned["face_jump"].values
    assert kept[kept > 0].min() > floor
    assert np.array_equal(kept, np.where(raw["face_jump"] > floor, raw["face_jump"], 0.0))


def test_a_picture_without_rounding_is_unchanged(tree):
    raw = mcs.explain.primary_picture(
        mcs.Estimator(mcs.integrand("step(at=0.3)", dims=2)), resolution=32
    )
    same(module._without_rounding(raw), raw)


def test_rows_for_all_pairs_and_terms(tree):
    rows = pixel_rows(tree)
    pairs = [(row.estimator, row.sampler) for row in rows]
    assert pairs == [(name, s) for name in STRATEGY_NAMES.values() for s in SAMPLERS]
    rates = tree["convergence"]["rate"].values.ravel().tolist()
    assert [row.rate for row in rows] == rates
    assert [row.captured is not None for row in rows] == [s == SAMPLERS[1] for _, s in pairs]
    # The fitting basis of shifted points is Fourier: one row instead of two.
    assert [row.sampler for row in term_rows(tree)] == [
        f"{name}; Fourier" for name in STRATEGY_NAMES.values()
    ]


def test_summary_holds_the_numbers(tree):
    summary = pixel_summary(tree)
    assert (summary["pixel"]["x"], summary["pixel"]["y"]) == named_pixels("figure1")["Q"]
    assert summary["pixel"]["shape"] == "floor"
    assert len(summary["rates"]) == len(PIXEL_STRATEGIES) * len(SAMPLERS)
    last = summary["rates"][-1]
    assert (last["strategy"], last["sampler"]) == ("power", SAMPLERS[-1])
    assert float(last["rate"]) == float(tree["convergence"]["rate"].values[-1, -1])
    for terms in summary["terms"]:
        total = terms["dc_term"] + terms["power_term"] + terms["cross_term"]
        assert total == pytest.approx(terms["predicted_variance"], rel=1e-9)
    assert [r["remedy"] for r in summary["remedies"]["ranked"]] == tree["remedies"][
        "remedy"
    ].values.tolist()
    assert {j["integrand"] for j in summary["jumps"]} == set(tree["pictures"].children)


@pytest.mark.parametrize(
    ("slow", "words"),
    [(0, "^Light sampling is the bottleneck"), (1, "^BSDF sampling is the bottleneck"),
     (-1, "^The bottleneck of MIS .* is undecided")],
)  # fmt: skip
def test_the_bottleneck_in_words(tree, slow, words):
    changed = tree.copy(deep=True)
    changed["techniques"]["bottleneck"] = slow
    text = bottleneck_sentence(changed)
    assert re.search(words, text)
    found = changed["techniques"]
    for value, (low, high) in zip(
        found["technique_rate"].values, found["technique_rate_ci"].values, strict=True
    ):
        shown = f"{value:.2f}"[:5].replace("-", "−")
        assert (shown if high - low <= 1 else "a rate that more realizations would resolve") in text


def test_a_bottleneck_names_the_smallest_n(tree):
    changed = tree.copy(deep=True)
    found = changed["techniques"]
    found["bottleneck"] = 1
    found["technique_rate"].values[:] = [-2.0, -1.0]
    found["technique_variance"].values[-1] = [0.9, 0.1]
    n = int(found["n"][-1])  # The curves have ratio 9 here, and their exponents differ by 1
    expected = rf"more than half beyond n ≈ {number(9.0 * n, 2)} by the fitted lines\.$"
    assert re.search(expected, bottleneck_sentence(changed))


@pytest.mark.parametrize(("part", "words"), [(0.04, "it has 4 % of the variance"), (0.5, "")])
def test_a_bottleneck_that_does_not_show_yet(tree, part, words):
    changed = tree.copy(deep=True)
    changed["techniques"]["bottleneck"] = 1
    changed["techniques"]["technique_variance"].values[-1] = [1.0 - part, part]
    text = bottleneck_sentence(changed)
    n = int(changed["techniques"]["n"][-1])
    if words:
        assert text.endswith(f"determines the rate of the sum at larger n; at n = {n} {words}.")
    else:
        assert text.endswith("determines the rate of the sum.")


def test_a_camera_with_a_lens_is_mentioned(tree):
    assert tree.attrs["camera"] == "pinhole"
    assert "camera" not in dict(about_pixel(tree))
    changed = tree.copy()
    changed.attrs = tree.attrs | {"camera": "center of the lens"}
    assert dict(about_pixel(changed))["camera"] == "the ray starts at the center of the lens"


def test_sentences_name_jumps_bottleneck_and_remedy(tree):
    said = dict(pixel_sentences(tree))
    assert "of all lines through the cube cross a discontinuity of the integrand" in said["light"]
    assert "wraps around, so the integrand is discontinuous there" in said["light"]
    assert said["bottleneck"] == bottleneck_sentence(tree)
    assert said["remedies"] == tree["remedies"].attrs["answer"]
    resolved = [r for r in pixel_rows(tree) if r.rate and r.rate_high - r.rate_low <= 1]
    rates = {(r.estimator, r.sampler): r.rate for r in resolved}
    best = min(rates, key=lambda pair: rates[pair])
    assert f": {best[0]} with {best[1]}. The least variance" in said["fastest"]


def test_light_missed_by_a_strategy_is_mentioned(tree):
    changed = tree.copy()
    curves = tree["convergence"].to_dataset()
    spec = str(curves["spec"].sel(strategy="bsdf").values)
    note = f"{spec} with random: all estimates are equal at n = 4"
    changed["convergence"] = xr.DataTree(curves.assign_attrs(note=note))
    said = dict(pixel_sentences(changed))
    assert said["not met"] == "bsdf with random: all estimates are equal at n = 4"


def test_an_unresolved_steepest_rate_is_not_a_finding(tree):
    """The page used to report a steepest rate of −1.70 ± 2.68."""
    wide = tree.copy()
    curves = tree["convergence"].to_dataset()
    ends = curves["rate"] + xr.DataArray([-2.68, 2.68], dims="bound")
    wide["convergence"] = xr.DataTree(curves.assign(rate_ci=ends.transpose(..., "bound")))
    said = dict(pixel_sentences(wide))["fastest"]
    assert said.startswith(
        "The rates are not resolved: use five or more counts, more realizations or larger counts"
    )
    assert "±" not in said


def test_the_page_needs_no_other_files(tree, tmp_path):
    with no_pdf():
        page = write_pixel(tree, tmp_path).read_text(encoding="utf-8")
    assert not re.search(r"https?:|<script src|<link|src=\"(?!data:)|url\(", page)
    said = pixel_answer(tree)
    assert said.startswith(("Use ", "Keep "))
    assert page.index(powers(said)) < page.index("Surface and lights")
    for name, _ in pixel_sentences(tree):
        assert f"<b>{name[0].upper()}{name[1:]}</b>" in page
    for strategy in STRATEGY_NAMES.values():
        for sampler in SAMPLERS:
            heads = (f'<th scope="row">{re.escape(name)}' for name in (strategy, sampler))
            row = r"</th>\s*".join(heads)
            assert re.search(row, page), (strategy, sampler)
    for name in ("rates", "terms", "captured", "integrands", "incident", "remedies"):
        png = (tmp_path / "figures" / f"{name}.png").read_bytes()
        assert png.startswith(b"\x89PNG")


@pytest.mark.usefixtures("undrawn", "only_balance")
def test_three_dims_have_no_pictures_of_g(tmp_path):
    """A BSDF with lobes needs a third coordinate."""
    found = analyse_pixel(
        "sky", "plastic", dims=3, samplers=["jittered"], remedies=False, realizations=20
    )
    assert "pictures" not in found.children
    assert "remedies" not in found.children
    assert "of all lines through the cube cross" in dict(pixel_sentences(found))["MIS, balance"]
    page = write_pixel(found, tmp_path).read_text(encoding="utf-8")
    assert 'id="integrands"' not in page
    assert pixel_summary(found)["jumps"] == []


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"x": "R"}, ParameterError, "no pixel named 'R'.*P, Q|no pixel named 'R'"),
        ({"scene": "sky(width=16, height=8)", "x": "R"}, ParameterError, "metal, .*plastic"),
        ({"x": 3}, ParameterError, "give x and y"),
        ({"x": "Q", "y": 3}, ParameterError, "give x and y"),
        ({"x": 384, "y": 0}, ParameterError, "outside the film"),
        ({"x": 1.5, "y": 0}, ParameterError, "outside the film"),
        ({"channel": "rgb"}, ParameterError, "channel is 'rgb'; give 'luminance', 0, 1 or 2"),
        ({"channel": 7}, ParameterError, "channel is 7"),
        ({"dims": 4}, ParameterError, "dims"),
        ({"light": "moon"}, ParameterError, "no light"),
        ({"samplers": []}, ParameterError, "list of samplers"),
        ({"samplers": "jittered"}, ParameterError, "list of samplers"),
        ({"samplers": ["jittered", "jittered"]}, ParameterError, "only once"),
        ({"samplers": ["jitered"]}, McspectraError, "jittered"),
        ({"counts": [16]}, ParameterError, "at least two"),
        ({"counts": [16, 4]}, ParameterError, "ascending"),
        ({"counts": [16, 20]}, CountError, "20"),
        ({"counts": [16, float("nan")]}, ParameterError, "counts"),
        ({"counts": [4, 2**60]}, ParameterError, "counts"),
        ({"realizations": 3}, ParameterError, "realizations"),
        ({"realizations": 10**10}, ParameterError, "from 4 to 1000000000"),
        ({"realizations": float("inf")}, ParameterError, "realizations"),
        ({"budget": 4}, ParameterError, "budget"),
        ({"budget": 2**40}, ParameterError, "budget"),
        ({"rng": -1}, ParameterError, "rng"),
        ({"effort": "hasty"}, ParameterError, "quick"),
        ({"scene": "figur1"}, McspectraError, "figure1"),
        ({"scene": "no-such.xml", "x": 1, "y": 1}, McspectraError, "no scene file"),
    ],
)
def test_bad_input_is_one_sentence(changes, error, words):
    given: dict[str, Any] = {"scene": "figure1", "x": "Q", "samplers": ["jittered"]}
    given |= changes
    with pytest.raises(error, match=words) as caught:
        analyse_pixel(**given)
    assert "\n" not in str(caught.value)


def test_a_scene_without_named_pixels_suggests_no_name():
    with pytest.raises(ParameterError, match=r"no pixel named 'P'; give x and y\.$"):
        find_pixel(plate(width=16, height=8), "P", None)
