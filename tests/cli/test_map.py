"""The verb ``map``: files, numbers, resumption, and one sentence for bad input."""

import json
import shutil
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from tests.report.drawing import no_layout

from mcspectra.cli.main import main
from mcspectra.core.images import exr_attributes, read_image
from mcspectra.plots.backend_matplotlib import draw
from mcspectra.plots.kinds import describe, kinds_of
from mcspectra.rendering.files import write_exr
from mcspectra.report.map_page import map_layers, map_summary

pytestmark = pytest.mark.render

SMALL = ("--size", "24,16", "--crop", "8,6,6,4", "--counts", "4,16", "-m", "8")


def run(capsys, *arguments):
    code = main(["map", *map(str, arguments)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture(scope="module")
def made(once, tmp_path_factory):
    """A map on disk, which tests only read, and the result of the function."""
    from mcspectra.rendering import variance_map

    def drawn():
        folder = tmp_path_factory.mktemp("map") / "out"
        with no_layout():
            asked = ["map", "veach", *SMALL, "--seed", "3", "--out", str(folder), "--quiet"]
            assert main(asked) == 0
        options: dict[str, Any] = {"size": (24, 16), "crop": (8, 6, 6, 4), "counts": (4, 16)}
        return folder, variance_map("veach", realizations=8, rng=3, **options)

    return once("map", drawn)


def test_layers_hold_the_maps(made):
    import OpenEXR

    folder, result = made
    channels = OpenEXR.File(str(folder / "maps.exr"), separate_channels=True).channels()
    expected = map_layers(result)
    assert channels.keys() == {f"{name}.Y" for name in expected}
    for name in ("variance.light.n16", "rate.bsdf", "rate_ci.mis.low", "bottleneck", "mis_gain"):
        stored = channels[f"{name}.Y"].pixels
        assert np.array_equal(stored, expected[name].astype(np.float32), equal_nan=True)
    light = result["variance"].sel(strategy="light", n=16).values
    assert np.array_equal(expected["variance.light.n16"], light, equal_nan=True)


def test_pictures_and_page(made):
    folder, result = made
    page = (folder / "report.html").read_text(encoding="utf-8")
    kinds = [kind.removeprefix("map-").replace("-", "_") for kind in kinds_of(result)]
    assert {"mean", "variance", "rate", "rate_se", "bottleneck", "gain"} <= set(kinds)
    for kind in kinds:
        assert (folder / f"{kind}.png").read_bytes().startswith(b"\x89PNG")
    assert "All pixels share the same points, so their errors are correlated" in page
    assert "<h1>Variance map of " in page
    assert "light sampling" in page
    assert not any(raw in page for raw in ("stream_key", "labels_strategy", "estimator_name"))
    assert "http" not in page.replace("http-equiv", "")
    assert page.count("data:image/png;base64,") == len(kinds)
    assert not list(folder.glob(".*"))


@pytest.mark.usefixtures("undrawn")
def test_json_is_strict_and_complete(made, tmp_path, capsys):
    folder, result = shutil.copytree(made[0], tmp_path / "out"), made[1]
    stored = json.loads((folder / "map.json").read_text(), parse_constant=pytest.fail)
    rate = float(np.nanmedian(result["rate"].sel(strategy="mis")))
    assert stored["strategies"]["mis"]["rate"] == rate
    assert sum(stored["bottleneck"].values()) == pytest.approx(1.0)
    assert (stored["seed"], stored["counts"], stored["scene"]) == (3, [4, 16], "veach")
    again = ("veach", *SMALL, "--seed", 3, "--out", folder, "--resume", "--json")
    code, out, err = run(capsys, *again)
    assert (code, err) == (0, "")
    printed = json.loads(out)
    assert printed.pop("report") == str(folder / "report.html")
    assert printed == stored


@pytest.mark.usefixtures("undrawn")
def test_text_has_a_row_per_strategy(tmp_path, capsys):
    options = ("--strategies", "bsdf,light", "--predict-every", 0, "--out", tmp_path)
    code, out, _ = run(capsys, "veach", *SMALL, *options)
    assert code == 0
    header, _, *rows, note, last = out.splitlines()
    assert note.startswith(
        "Medians over the 24 pixels that show a lit surface; mean and variance at"
    )
    assert "Half of the light or more is missed by BSDF sampling" in note
    assert "All pixels share the same points" in note
    assert header.split()[:4] == ["Strategy", "Mean", "Variance", "Rate"]
    assert [row.partition("  ")[0] for row in rows] == ["light sampling", "BSDF sampling"]
    assert last == f"map: {tmp_path / 'report.html'}"


@pytest.mark.usefixtures("undrawn")
def test_options_reach_the_map(tmp_path, capsys):
    options = (
        *("--strategies", "light, mis-bsdf", "--sampler", "random", "--light", "light-3"),
        *("--heuristic", "power", "--channel", "1", "--points", "own", "--smoothing", "3"),
        *("--predict-every", "0", "--workers", "1", "--json", "--out", tmp_path / "map"),
    )
    code, out, err = run(capsys, "veach", *SMALL, *options)
    assert code == 0, err
    found = json.loads(out)
    assert list(found["strategies"]) == ["light", "mis-bsdf"]
    expected = {
        "sampler": "random", "light": "light-3", "heuristic": "power", "channel": 1,
        "points": "own", "smoothing": 3, "crop": [8, 6, 6, 4], "size": [24, 16],
    }  # fmt: skip
    assert {name: found[name] for name in expected} == expected
    assert "predicted_ratio" not in found["strategies"]["light"]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("veach", "--crop", "1,2,3"), "--crop has 3 values; give 4"),
        (("veach", "--crop", "a,b,c,d"), "--crop is 'a'"),
        (("veach", "--size", "0,4"), "--size is 0; give a whole number from 1"),
        (("veach", "--counts", "four"), "--counts is 'four'"),
        (("veach", "-m", "1"), "--realizations is 1; give a whole number from 2"),
        (("veach", "-m", "nan"), "--realizations is 'nan'"),
        (("veach", "--light=-1"), "light is -1; give a whole number from 0 to 4"),
        (("veach", "--channel", "rgb"), "channel is 'rgb'"),
        (("veach", "--workers", "0"), "--workers is 0"),
        (("veach", "--seed", "-1"), "--seed"),
        (("veach", "--resume"), "--resume finds no map in the folder"),
        (("veach", "--integrator", ""), "--integrator is ''; give 'scene'"),
        (("veach", "--pixels", ""), "--pixels is ''; give a number of pixels, or a share"),
        (("veach", "--size", "9,8", "--pixels", "1e9"), "more than the 72 pixels of the image"),
        (("veach", "--integrator", "path", "--joint-dims", "99999999"), "from 0 to 64"),
        (("veach", "--integrator", "path", "--joint-dims", "1"), "from 2 to 64"),
        (("veach", "--integrator", "path", "--target", "1e9"), "greater than 0 and at most 1000"),
    ],
)
def test_bad_input_is_one_sentence(options, sentence, tmp_path, capsys):
    code, out, err = run(capsys, *options, "--out", tmp_path / "out")
    assert (code, out) == (2, "")
    assert sentence in err
    assert err.startswith("mcspectra: ")
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_invalid_folders_for_a_map_are_refused(made, tmp_path, capsys):
    folder, _ = made
    (tmp_path / "file").write_text("")
    for target, more, sentence in (
        (folder, (), "already holds results"),
        (folder, ("--resume", "--seed", 4), "belongs to another study"),
        (tmp_path / "file", (), "the name of a file"),
    ):
        code, out, err = run(capsys, "veach", *SMALL, "--out", target, *more)
        assert (code, out) == (2, "")
        assert sentence in err


def synthetic(**changes):
    """A map of made-up numbers, which needs no renderer."""
    shape = (2, 2, 3, 5)
    values = np.geomspace(1e-9, 1e3, 60).reshape(shape)
    return xr.Dataset(
        {
            "variance": (("strategy", "n", "y", "x"), values),
            "mean": (("strategy", "y", "x"), values[:, 0]),
            "rate": (("strategy", "y", "x"), np.linspace(-9, 9, 30).reshape(2, 3, 5)),
            "rate_se": (("strategy", "y", "x"), values[:, 1]),
            "bottleneck": (("y", "x"), np.resize([-1.0, 0.0, 1.0, np.nan], (3, 5))),
            "mis_gain": (("y", "x"), np.resize([0.01, 1.0, 40.0], (3, 5))),
        }
        | changes,
        coords={"strategy": ["light", "bsdf"], "n": [4, 16], "y": range(3), "x": range(7, 12)},
    )


@pytest.mark.parametrize("fill", [None, np.nan, 0.0])
def test_maps_of_any_numbers_can_be_drawn(fill):
    result = synthetic()
    if fill is not None:
        result = result * np.nan + fill if np.isnan(fill) else result * 0 + fill
    kinds = kinds_of(result)
    assert "map-gain" in kinds
    for kind in kinds:
        figure = draw(describe(kind, result))
        if fill is not None:  # the layout takes half of the time, and fits the labels of all maps
            figure.set_layout_engine("none")
        figure.canvas.draw()


def test_the_answer_has_the_least_variance_at_most_pixels():
    """Light, BSDF and MIS are each best at one of four pixels; at the last, light misses half."""
    single = np.array([[1.0, 4.0, 4.0, 0.1], [4.0, 1.0, 4.0, 4.0], [2.0, 2.0, 2.0, 2.0]])
    means = np.ones((3, 1, 4))
    means[0, 0, 3] = 0.5
    place = ("strategy", "y", "x")
    result = xr.Dataset(
        {
            "variance": (
                ("strategy", "n", "y", "x"),
                single[:, None, None] * np.ones((1, 1, 1, 1)),
            ),
            "mean": (place, means),
            "mean_se": (place, np.full((3, 1, 4), 0.01)),
            "rate": (place, -means),
            "rate_se": (place, means),
            "mis_gain": (("y", "x"), [[0.5, 0.5, 2.0, 0.1]]),
            "mis_gain_ci": (("y", "x", "bound"), np.ones((1, 4, 2))),
        },
        {"strategy": ["light", "bsdf", "mis"], "n": [16], "bound": ["low", "high"]},
        {"sampler": "jittered", "realizations": 64},
    )
    said = map_summary(result)["answer"]
    assert said.startswith(
        "Use BSDF sampling with jittered: for equal total samples it has the least variance at 50 "
        "% of the pixels, light sampling at 25 %, MIS at 25 %. Median RMSE at n = 16 of each "
        "technique, at pixels where no strategy misses light: light sampling 2.00, BSDF sampling "
        "2.00, MIS 1.41."
    )


def test_summaries_count_intervals():
    gains = np.array([[[0.5, 2.0], [1.5, 3.0], [0.1, 0.9], [np.nan, np.nan], [2.0, 9.0]]])
    ci = (("y", "x", "bound"), np.repeat(gains, 3, axis=0))
    result = synthetic(mis_gain_ci=ci).assign_coords(bound=["low", "high"])
    found = map_summary(result)
    assert found["mis_gain"]["above_1"] == 0.5
    assert found["mis_gain"]["below_1"] == 0.25
    assert found["bottleneck"] == {"light": 4 / 12, "bsdf": 4 / 12, "undecided": 4 / 12}


def test_a_map_of_whole_paths_names_its_worst_pixels_and_resumes(capsys, tmp_path, request):
    folder = tmp_path / "out"
    asked = ("penumbra", "--size", "12,8", "--integrator", "path(max_depth=2)", "--counts", "4,16",
             "-m", 8, "--out", folder)  # fmt: skip
    with no_layout():
        code, out, err = run(capsys, *asked)
    assert code == 0, err
    assert "path" in out
    summary = json.loads((folder / "map.json").read_text(encoding="utf-8"))
    worst = summary["worst_pixels"]
    assert [each["variance"] for each in worst] == sorted(
        (each["variance"] for each in worst), reverse=True
    )
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert f" {worst[0]['x']} {worst[0]['y']} --integrator" in page
    assert "mcspectra pixel &#39;penumbra(width=12, height=8)&#39; " in page
    request.getfixturevalue("undrawn")  # Pictures that exist stay
    before = (folder / "maps.exr").read_bytes()
    code, _, err = run(capsys, *asked, "--resume")
    assert code == 0, err
    assert (folder / "maps.exr").read_bytes() == before
    assert {"bounces.png", "decisions.png", "picture.png"} <= {f.name for f in folder.iterdir()}
    assert sum(row["share"] for row in summary["bounces"].values()) == pytest.approx(1.0)
    assert "variance by bounce: " in page
    assert run(capsys, "nosuch", "--out", tmp_path / "refused")[0] == 2
    assert not (tmp_path / "refused").exists()


@pytest.mark.usefixtures("undrawn")
def test_several_samplers_are_compared_and_resume(capsys, tmp_path):
    import OpenEXR

    folder = tmp_path / "out"
    asked = ("penumbra(width=12, height=8)", "--integrator", "path(max_depth=2)",
             "--counts", "4,16", "-m", 16, "--chains", 16,
             "--sampler", "random", "--sampler", "sobol | owen", "--out", folder)  # fmt: skip
    code, out, err = run(capsys, *asked)
    assert code == 0, err
    assert "whole paths, sobol | owen" in out
    summary = json.loads((folder / "map.json").read_text(encoding="utf-8"))
    shares = summary["best_sampler"]["path"]
    assert list(shares) == ["no difference", "random", "sobol | owen"]
    assert sum(shares.values()) == pytest.approx(1.0)
    assert list(summary["bounces"]) == ["camera", "bounce 1", "bounce 2"]
    channels = OpenEXR.File(str(folder / "maps.exr"), separate_channels=True).channels()
    named = {
        "variance.sobol | owen.path.n16.Y",
        "bounce_share.1.Y",
        "decision_share_ci.light.low.Y",
    }
    assert named | {"best_sampler.path.Y", "largest_bounce.Y"} <= channels.keys()
    before = (folder / "maps.exr").read_bytes()
    code, _, err = run(capsys, *asked, "--resume")
    assert code == 0, err
    assert (folder / "maps.exr").read_bytes() == before


def test_a_map_of_black_pixels_has_a_page(capsys, tmp_path):
    asked = ("penumbra(width=24, height=18)", "--crop", "0,0,3,2", "--integrator", "path", "-m", 4,
             "--counts", "4,16", "--chains", 8, "--out", tmp_path)  # fmt: skip
    with no_layout():
        code, _, err = run(capsys, *asked)
    assert code == 0, err
    assert "variance by bounce: unknown." in (tmp_path / "report.html").read_text()


@pytest.mark.usefixtures("undrawn")
def test_a_map_of_a_subset_says_so_and_resumes(tmp_path, capsys):
    asked = [
        "map", "penumbra(width=24, height=18)", "--integrator", "path(max_depth=2)",
        "--counts", "4,16", "-m", "8",
        "--chains", "0", "--pixels", "20%", "--sampler", "random", "--sampler", "sobol | owen",
        "--out", str(tmp_path / "out"),
    ]  # fmt: skip
    assert main(asked) == 0
    out = capsys.readouterr().out
    assert out.startswith("A map of a subset: ")
    assert "one at random in each stratum" in out
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "A map of a subset: " in page
    summary = json.loads((tmp_path / "out" / "map.json").read_text(encoding="utf-8"))
    subset = summary["subset"]
    assert subset["pixels"] == 432
    assert summary["pixels_measured"] == subset["measured"]
    assert sum(summary["best_sampler"]["path"].values()) == pytest.approx(1.0)
    before = (tmp_path / "out" / "maps.exr").read_bytes()
    assert b"interpolation_factor.random.path" in before
    assert main([*asked, "--resume"]) == 0
    assert (tmp_path / "out" / "maps.exr").read_bytes() == before


def test_the_estimated_storage_of_a_subset_counts_the_interpolated_pixels(tmp_path, capsys):
    """Earlier versions counted only the measured pixels in the database."""
    asked = [
        "map", "penumbra(width=128, height=96)", "--integrator", "path(max_depth=2)",
        "--counts", "4,16", "-m", "8", "--chains", "8", "--pixels", "1%",
    ]  # fmt: skip
    assert main([*asked, "--dry-run", "--json"]) == 0
    estimated = json.loads(capsys.readouterr().out)["storage"]
    assert main([*asked, "-o", str(tmp_path)]) == 0
    stored = sum(file.stat().st_size for file in tmp_path.rglob("*") if file.is_file())
    assert 1 / 1.2 < estimated / stored < 1.2


@pytest.mark.usefixtures("undrawn")
def test_a_map_writes_samples_that_render_reads(tmp_path, capsys, monkeypatch):
    scene = "penumbra(width=16, height=12)"
    # The comparison of samplers has its own tests
    advice = SimpleNamespace(text="advice", to_dict=dict)
    compare = "mcspectra.profiler.scene_profile.profile_scene"
    monkeypatch.setattr(compare, lambda *_, **__: advice)
    file, image = tmp_path / "spp.exr", tmp_path / "image.exr"
    asked = ["map", scene, "--integrator", "path(max_depth=2)", "--counts", "4,16", "-m", "8",
             "--chains", "0", "-o", str(tmp_path / "map"), "-o", str(file)]  # fmt: skip
    assert main(asked) == 2
    assert "give --target" in capsys.readouterr().err
    assert main([*asked, "--target", "0.1", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)["samples_per_pixel"]
    assert data["files"] == [str(file)]
    spp = read_image(file)[..., 0]
    assert spp.shape == (12, 16)
    assert spp.min() == data["least"] >= 4
    low, high = (read_image(file, layer=name)[..., 0] for name in ("low", "high"))
    assert (low <= spp).all()
    assert (spp <= high).all()
    assert json.loads(exr_attributes(file)["comments"])["target"] == 0.1
    render = ["render", scene, "--integrator", "path(max_depth=2)", "--spp-map", str(file)]
    assert main([*render, "-o", str(image)]) == 0
    assert "rounded up to powers of two" in capsys.readouterr().out
    assert read_image(image).shape == (12, 16, 3)
    wrong = tmp_path / "wrong.exr"
    write_exr(wrong, {"": np.ones((3, 4))})
    assert main([*render[:-1], str(wrong), "-o", str(image)]) == 2
    assert "wrong.exr' has the shape (3, 4)" in capsys.readouterr().err
    assert main([*render, "--spp", "4"]) == 2
    assert "--spp does not go with --spp-map" in capsys.readouterr().err


def compared_maps(first, second):
    """A map of two samplers with these variances at four pixels, and the best at each pixel."""
    place = ("sampler", "strategy", "n", "y", "x")
    variance = np.array([first, second])[:, None, None, None, :]
    # Relative standard errors of 1 %: differences above 3 % are sure
    ratio = np.array(first) / np.array(second)
    best = np.select([ratio < 0.97, ratio > 1.03], [0.0, 1.0], -1.0)
    return xr.Dataset(
        {
            "variance": (place, variance),
            "rate": (place[:2] + place[3:], -np.ones((2, 1, 1, 4))),
            "rate_se": (place[:2] + place[3:], np.full((2, 1, 1, 4), 0.1)),
            "mean": (place[:2] + place[3:], np.ones((2, 1, 1, 4))),
            "best_sampler": (("strategy", "y", "x"), best[None, None]),
        },
        {"sampler": ["sobol | owen", "multijitter"], "strategy": ["path"], "n": [64],
         "x": np.arange(4), "y": [0]},
        {"sampler": "sobol | owen, multijitter", "realizations": 64},
    )  # fmt: skip


def test_the_headline_of_samplers_agrees_with_their_variances():
    # The first sampler is surely best at half of the pixels, but its variance is larger
    said = map_summary(compared_maps([0.9, 0.9, 1.0, 1.3], [1.0, 1.0, 1.0, 1.0]))["answer"]
    assert said.startswith("No sampler is best everywhere, so keep sobol | owen.")
    assert "sobol | owen at 50 %, multijitter at 25 %; no difference at 25 % of the pixels" in said
    assert "sobol | owen has 1 % more variance than multijitter in the geometric mean" in said
    said = map_summary(compared_maps([1.5, 1.5, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]))["answer"]
    assert said.startswith("Use multijitter: 18 % less variance than sobol | owen")
    said = map_summary(compared_maps([1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]))["answer"]
    assert said.startswith("Keep sobol | owen: at no pixel")
