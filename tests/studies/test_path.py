"""The noise of whole paths: variance components, padding, the verb and its page."""

import json
from typing import Any

import numpy as np
import pytest
import xarray as xr
from tests.fonts import fonts_once
from tests.report.drawing import no_pdf

import mcspectra as mcs
from mcspectra.cli.main import main
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.rendering import builtin, path_pixel
from mcspectra.rendering.scenes import emitter_names
from mcspectra.report.path_page import path_answer, path_sentences, path_summary, write_path
from mcspectra.samplers import as_sampler
from mcspectra.studies import analyse_path, path
from mcspectra.studies.path import path_remedies, shares_by_light

__all__ = ["fonts_once"]

pytestmark = [pytest.mark.render, pytest.mark.usefixtures("coarse_pixels")]

SCENE, X, Y = "penumbra(width=16, height=12)", 8, 9
PATH = "path(max_depth=3, rr_depth=2)"
SAMPLERS = ("random", "sobol | owen")
COUNTS = (16, 128)


@pytest.fixture(scope="module")
def tree(once):
    def analyse():
        with pytest.MonkeyPatch.context() as patch:
            # Fewer paths for the variance components than usual; their errors are compared below
            patch.setattr(path, "_EFFORTS", {"quick": (COUNTS, 200, 4_000, 2**12, False)})
            return analyse_path(SCENE, X, Y, integrator=PATH, samplers=SAMPLERS, rng=3)

    return once("path", analyse)


def test_shares_by_bounce_sum_to_the_variance_of_a_path(tree):
    parts = tree["anova/bounce"].to_dataset()
    assert parts["axis_label"].values.tolist() == ["camera", "bounce 1", "bounce 2", "bounce 3"]
    whole = parts["anova_share"].sum() + parts["higher_order_share"]
    assert float(whole) == pytest.approx(1.0, abs=1e-12)
    # Compare with the variance of other random paths, within 5 standard errors of both
    f = path_pixel(SCENE, X, Y, integrator=PATH)
    values = f(np.random.default_rng(17).random((2**14, f.dims)))
    deviation = (values - values.mean()) ** 2
    total = parts["anova_variance"].sum() + parts["higher_order_variance"]
    count = parts.attrs["realizations"]
    error = deviation.std() * np.hypot(len(values) ** -0.5, count**-0.5)
    assert abs(float(total) - deviation.mean()) < 5 * error
    # The integrand does not use the numbers drawn in the last iteration of a path of three
    assert float(parts["total_share"][3]) == 0.0
    assert float(parts["total_share"][1]) > 0.5


def test_groupings_agree(tree):
    # Subsets up to the end of a bounce keep the same numbers in every grouping
    bounce, request = (tree[f"anova/{kind}"].to_dataset() for kind in ("bounce", "request"))
    names = request["axis_label"].values.tolist()
    last = [
        k for k, n in enumerate(names) if n in ("film", "bounce 1 roulette", "bounce 2 roulette")
    ]
    np.testing.assert_allclose(
        request["truncation_share"].values[last], bounce["truncation_share"].values[:3], atol=1e-12
    )
    of_all = tree["anova/decision"]["axis_label"].values.tolist()
    assert of_all == ["film", "light", "lobe", "direction", "roulette"]


def test_padding_ends_at_all_coordinates_and_starts_near_random_points(tree):
    found = tree["remedies"].to_dataset()
    kinds = found["kind"].values
    assert set(found["remedy"].values[kinds == "padding"]) == {
        f"{k} good coordinates" for k in (2, 8, 14)
    }
    # The last numbers are unused; the film coordinates alone give the variance of random points
    one = {str(name): found.sel(remedy=name) for name in found["remedy"].values}
    assert float(one["14 good coordinates"]["error_ratio"]) == 1.0
    low, high = one["2 good coordinates"]["error_ci"].values
    assert low / 1.3 < float(one["random"]["error"]) < high * 1.3
    assert one["2 good coordinates"]["verdict"] != "better"
    assert one["8 good coordinates"]["verdict"] != "worse"


def test_an_unsupported_count_is_refused_first():
    with pytest.raises(mcs.McspectraError, match="jittered"):
        analyse_path(SCENE, X, Y, integrator=PATH, samplers=["jittered"], counts=(15, 64))
    with pytest.raises(ParameterError, match="channel is 'rgb'"):
        analyse_path(SCENE, X, Y, integrator=PATH, channel="rgb")
    with pytest.raises(ParameterError, match="ascending"):
        analyse_path(SCENE, X, Y, integrator=PATH, counts=(64,))


def test_only_a_significant_change_is_recommended(tree):
    """Earlier versions compared the headline with random numbers, and contradicted the table."""
    found = tree["remedies"].to_dataset().copy(deep=True)
    found["error_ratio_ci"].values[:] = (0.3, 250.0)
    verdicts = np.where(found["remedy"].values == "as given", "given", "undecided")
    undecided = tree.copy()
    undecided["remedies"] = xr.DataTree(found.assign_coords(verdict=("remedy", verdicts)))
    said = path_answer(undecided)
    assert said.startswith(f"Keep sobol | owen: none of the {len(verdicts) - 1} tested changes")
    assert "(95 %: 0.300 to 250)" in dict(path_sentences(undecided))["sampler"]
    # The printed gain is that of the table
    changed = path_answer(tree)
    given = float(found["error"].sel(remedy="as given"))
    assert f"instead of {given**0.5:.2g}" in changed
    assert "random would need" not in changed


def test_parts_are_interactions_if_no_decision_causes_variance_alone(tree):
    parts = tree["anova/request"].to_dataset().copy(deep=True)
    parts["anova_share"].values[:] = 0.0
    parts["anova_share"].values[1] = 0.004
    found = tree.copy()
    found["anova/request"] = xr.DataTree(parts)
    assert dict(path_sentences(found))["by decision"].startswith(
        "Nearly all of the variance comes from interactions: no decision alone causes more than 0.4"
    )


def test_the_verb_prints_writes_and_refuses(tmp_path, capsys, tree, monkeypatch):
    monkeypatch.setattr("mcspectra.studies.path.analyse_path", lambda *_, **__: tree)
    asked = ["pixel", SCENE, str(X), str(Y), "--integrator", PATH]
    with no_pdf():
        assert main([*asked, "--json", "--out", str(tmp_path / "out")]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["pixel"]["dims"] == 20
    assert {"by bounce", "by decision", "sampler", "padding", "remedies"} <= printed[
        "sentences"
    ].keys()
    # The answer is the first change that is significantly better, as in the remedies
    ranked = printed["remedies"]["ranked"]
    first = next(each for each in ranked if each["verdict"] == "better")
    assert printed["answer"].startswith(f"Use sobol | owen with {first['remedy']}: RMSE")
    change = first["change"][:1].upper() + first["change"][1:]
    assert printed["sentences"]["remedies"].startswith(
        f"Compared with sobol | owen as given: {change}: RMSE"
    )
    assert printed["sentences"]["sampler"].startswith("With sobol | owen the variance at n = 128")
    assert printed["remedies"]["answer"] in printed["sentences"]["remedies"]
    assert "Cause: the largest parts of the variance are " in printed["answer"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "good coordinates" in page
    assert "bounce 1 light" in page
    assert main(asked) == 0
    told = capsys.readouterr().out
    assert "20 random numbers per path" in told
    assert "roulette from depth 1" in told
    assert main([*asked, "--light", "lamp"]) == 2
    assert "--light is for direct light" in capsys.readouterr().err


def test_remedies_and_rates_use_the_same_realizations(tree):
    curves, found = tree["convergence"].to_dataset().isel(n=-1), tree["remedies"].to_dataset()
    for sampler, remedy in (("random", "random"), ("sobol | owen", "as given")):
        variance = float(curves["variance"].sel(sampler=sampler))
        assert float(found["error"].sel(remedy=remedy)) == pytest.approx(variance, rel=1e-9)


def test_remedies_have_equal_cost_and_list_untried_changes(tree):
    found = tree["remedies"].to_dataset()
    kinds = dict(zip(found["remedy"].values, found["kind"].values, strict=True))
    assert {"given", "sampler", "padding", "order", "roulette"} <= set(kinds.values())
    one = {str(name): found.sel(remedy=name) for name in found["remedy"].values}
    # Random points are worse than the net; film coordinates alone hardly gain
    assert one["random"]["verdict"] == "worse"
    assert one["2 good coordinates"]["verdict"] != "better"
    # The cost of roulette is the number of random numbers that its paths use
    f = path_pixel(SCENE, X, Y, integrator=PATH)
    other = path_pixel(SCENE, X, Y, integrator="path(max_depth=3, rr_depth=1)")
    cost = one["roulette from depth 1"]["cost"].values[-1] / found.attrs["budget"]
    assert cost == pytest.approx(other.numbers_per_path / f.numbers_per_path, rel=1e-12)
    assert cost < 1.0
    # The pilot counts: finding the order of coordinates took more paths than the budget
    assert one["coordinates by share"]["verdict"] == "worse"
    assert "Its pilot takes" in one["coordinates by share"]["reason"].item()
    reasons = json.loads(found.attrs["not_tried"])
    assert any(
        r.startswith("heuristic of MIS: PathIntegrator has no such property") for r in reasons
    )
    assert any(r.endswith("the scene has 1.") for r in reasons)
    # The sentence on padding agrees with these results
    said = dict(path_sentences(tree))["padding"]
    for name, each in one.items():
        if kinds[name] == "padding" and each["verdict"] == "worse":
            assert f"first {name.split()[0]} coordinates" not in said


@pytest.fixture(scope="module")
def lamps():
    film = {"type": "hdrfilm", "width": 48, "height": 32, "rfilter": {"type": "box"}}
    scene: dict[str, Any] = builtin.veach()
    return scene | {"sensor": scene["sensor"] | {"film": film}}


@pytest.fixture(scope="module")
def lights(once, lamps):
    f = path_pixel(lamps, 24, 26, integrator="path(max_depth=3)")
    return once("lights", lambda: shares_by_light(f, 2**13, Stream.from_rng(5)))


def test_the_improved_light_selection_pays_from_the_stated_count(lamps, lights):
    f = path_pixel(lamps, 24, 26, integrator="path(max_depth=3)")
    assert lights["light"].values.tolist() == emitter_names(f.scene)
    assert float(lights["light_share"].sum()) == pytest.approx(1.0, abs=1e-4)  # float32
    for name in ("light_probability", "light_selection"):
        assert float(lights[name].sum()) == pytest.approx(1.0, abs=1e-12)
    # Compare with the variance of other paths, within 5 standard errors of both ratios
    chosen = path_pixel(
        lamps, 24, 26, integrator="path(max_depth=3)", selection=lights["light_selection"].values
    )
    u = np.random.default_rng(6).random((2**14, f.dims))
    squares = [(v - v.mean()) ** 2 for v in (chosen(u), f(u))]
    after, before = (s.mean() for s in squares)
    error = (squares[0] / after - squares[1] / before).std() * (2**-14 + 2**-13) ** 0.5
    assert abs(np.log(float(lights["selection_ratio"])) - np.log(after / before)) < 5 * error

    # The pilot's paths count as additional samples; at the break-even count the ratio is 1
    random = as_sampler("random", f.dims)
    found = path_remedies(
        f, random, (64, 256), Stream.from_rng(7),
        realizations=400, samplers=(), ends=(), lights=lights,
    )  # fmt: skip
    one = found.sel(remedy="lights by second moment")
    pilot = int(lights.attrs["pilot"])
    beside = float(one["error"]) / float(found.sel(remedy="as given")["error"])
    rate = float(found.sel(remedy="as given")["rate"])
    charged = beside * ((256 + pilot) / 256) ** -rate
    assert float(one["error_ratio"]) == pytest.approx(charged, rel=1e-9)
    assert one["verdict"] == ("worse" if one["error_ratio_ci"][0] > 1 else "undecided")


@pytest.mark.usefixtures("undrawn")  # The page that the verb writes above has pictures
def test_a_page_of_lights_has_their_table(lights, tree, tmp_path):
    found = tree.copy()
    found["lights"] = xr.DataTree(lights)
    page = write_path(found, tmp_path).read_text(encoding="utf-8")
    assert path_answer(found).split(":")[0] in page
    assert "Better chosen" in page
    assert "Choosing lights by their second moments" in dict(path_sentences(found))["lights"]
    assert len(path_summary(found)["lights"]["light_share"]) == 5
