"""Maps compared with the same pixels measured one by one; tiles and bad input."""

from typing import Any

import numpy as np
import pytest
import xarray as xr

import mcspectra as mcs
from mcspectra.core.analysis import Subject, compute
from mcspectra.core.errors import (
    CountError,
    FileFormatError,
    ParameterError,
    UnknownName,
)
from mcspectra.core.options import checked
from mcspectra.core.progress import listening
from mcspectra.estimators.base import draw_sets
from mcspectra.rendering import map_tiles as tiles
from mcspectra.rendering import variance_map
from mcspectra.rendering.builtin import figure1
from mcspectra.rendering.map_tiles import Lighting, Measurement, Receivers
from mcspectra.rendering.maps import Map
from mcspectra.samplers import sampler
from mcspectra.testing import check_analysis

pytestmark = [pytest.mark.render, pytest.mark.usefixtures("coarse_pixels")]

COUNTS = (4, 16, 36)
SMALL: dict[str, Any] = {"size": (24, 16), "counts": COUNTS, "realizations": 16, "rng": 7}
PLATE = (16, 10)  # coordinates on the film of SMALL
SUBJECT = Subject(None, sampler("jittered", 2))
SCENE = "veach(width=24, height=16)"


@pytest.fixture(scope="module")
def small():
    return variance_map("veach", **SMALL)


def pixel(strategy, place=PLATE, **options):
    x, y = place
    return mcs.rendering.Pixel(scene=SCENE, x=x, y=y, strategy=strategy, **options)


def identical(a, b):
    names = sorted(map(str, a.data_vars))
    return names == sorted(map(str, b.data_vars)) and all(
        np.array_equal(a[name].values, b[name].values, equal_nan=True) for name in names
    )


@pytest.mark.parametrize("strategy", ["light", "mis-light", "mis"])
def test_a_pixel_agrees_with_convergence(small, strategy):
    # The same points: the only difference is Mitsuba's float32.
    if strategy == "mis":
        estimator: Any = mcs.estimators.TechniqueSum([pixel("mis-light"), pixel("mis-bsdf")])
    else:
        estimator = pixel(strategy)
    one = mcs.convergence(estimator, "jittered", COUNTS, realizations=16, rng=7)
    own = small.sel(strategy=strategy, x=PLATE[0], y=PLATE[1])
    assert own["variance"].values == pytest.approx(one["variance"].values, rel=1e-4)
    for name in ("rate", "rate_ci", "fit_chi2"):
        assert own[name].values == pytest.approx(one[name].values, rel=1e-3)
    assert float(own["mean"]) == pytest.approx(float(one["mean"][-1]), rel=1e-6)
    assert float(own["mean_se"]) == pytest.approx(float(one["mean_se"][-1]), rel=1e-4)


def test_own_points_are_numbered_by_the_pixel():
    # Pixel (x, y) uses realizations (y·width + x)·R … of the stream of each count.
    x, y = PLATE
    found = variance_map(
        "veach", ("light", "bsdf"), size=(24, 16), crop=(x - 1, y, 3, 1), counts=(4, 16),
        realizations=16, points="own", rng=7,
    )  # fmt: skip
    stream = mcs.core.streams.Stream.from_rng(7).child(16)
    own = ((y * 24 + x) * 16, 16)
    points = draw_sets("independent", (1, 1), sampler("jittered", 2), 16, stream, *own)
    np.testing.assert_array_equal(points[0], sampler("jittered", 2).draw_stream(16, stream, *own))
    for strategy, u in zip(("light", "bsdf"), points, strict=True):
        expected = pixel(strategy)(u).mean(axis=1).var(ddof=1)
        got = float(found["variance"].sel(strategy=strategy, n=16, x=x, y=y))
        assert got == pytest.approx(float(expected), rel=1e-4)


def test_wide_light_on_the_wall():
    # Light sampling gives a smooth integrand: −2. The light's edge makes BSDF sampling −1.5, and
    # MIS follows it [Singh et al.]. This is a single pixel, as in test_pixel.
    found = variance_map(
        "veach", crop=(568, 100, 1, 1), light="light-3", counts=(16, 64, 256, 1024),
        realizations=400, rng=1, predict_every=4,
    ).squeeze()  # fmt: skip
    for strategy, theory in {"light": -2.0, "bsdf": -1.5, "mis": -1.5}.items():
        one = found.sel(strategy=strategy)
        # 0.05: contribution of lower orders at these counts
        assert abs(float(one["rate"]) - theory) < 4 * float(one["rate_se"]) + 0.05
        ratio = np.log(float(one["predicted_ratio"]))
        low, high = np.log(one["predicted_ratio_ci"].values)
        assert abs(ratio) < 2 * (high - low) / 2  # the limit is four standard errors
    assert float(found["bottleneck"]) == 1
    assert float(found["mis_gain_ci"].sel(bound="high")) < 1  # light sampling alone is better


@pytest.mark.slow  # `test_wide_light_on_the_wall` has one pixel
def test_predictions_cover_the_measurement():
    found = variance_map(
        "veach", size=(48, 32), crop=(4, 3, 24, 4), light="light-3", counts=(4, 64),
        realizations=200, points="own", strategies=("light", "mis"),
    )  # fmt: skip
    low, high = (found["predicted_ratio_ci"].sel(bound=b).values for b in ("low", "high"))
    share = ((low < 1) & (high > 1)).mean(axis=(1, 2))
    pixels = 24 * 4
    assert (share > 0.95 - 4 * (0.95 * 0.05 / pixels) ** 0.5).all()
    assert found.attrs["prediction"] == "strata"


@pytest.mark.parametrize("lamp", [False, True])
def test_predictions_that_miss_a_rare_light_have_infinite_error(lamp):
    # One BSDF sample in a million hits the lamp: prediction and measurement both miss it, and would
    # agree. Light sampling takes every second sample from it.
    scene = figure1()
    if lamp:
        light = {"type": "area", "radiance": {"type": "rgb", "value": 1e6}}
        center = [-1.19, 2.0, 0.72]
        scene["lamp"] = {"type": "sphere", "center": center, "radius": 0.002, "emitter": light}
    found = variance_map(
        scene, ("light", "bsdf"), crop=(96, 205, 1, 1), counts=(4, 64), realizations=64, rng=3
    ).squeeze()
    known = np.isfinite(found["predicted_ratio"]).sel(strategy=["light", "bsdf"]).values
    assert known.tolist() == [True, not lamp]


def test_pixels_that_are_not_receivers_have_no_values(small):
    seen = np.isfinite(small["mean"].values[0])
    assert 0 < (~seen).sum() < 40
    for y, x in (*np.argwhere(~seen)[::4], *np.argwhere(seen)[::90]):
        light = mcs.rendering.describe_pixel(SCENE, int(x), int(y))["light"]
        assert (light is None) == seen[y, x]
    known = np.isfinite(small["variance"].values)
    assert np.array_equal(known, np.broadcast_to(seen, known.shape))
    assert small.attrs["pixels_measured"] == seen.sum()
    assert np.isnan(small["bottleneck"].values[~seen]).all()
    assert np.isnan(small["rate"].values[:, ~seen]).all()


def test_variables_are_labelled(small):
    assert list(small["strategy"].values) == ["light", "bsdf", "mis-light", "mis-bsdf", "mis"]
    for name, variable in small.data_vars.items():
        assert variable.attrs["long_name"], name
        assert "units" in variable.attrs
    assert small["rate_ci"].dims == ("strategy", "y", "x", "bound")
    assert (small["rate_ci"].diff("bound").values >= 0).sum() == np.isfinite(small["rate"]).sum()
    assert set(np.unique(small["bottleneck"])[:-1]) <= {-1.0, 0.0, 1.0}


def test_crops_and_tiles_do_not_change_bits(small, monkeypatch):
    single = variance_map("veach", crop=(*PLATE, 1, 1), **SMALL)
    assert identical(single, small.isel(x=[PLATE[0]], y=[PLATE[1]]))
    monkeypatch.setattr(tiles, "TILE_LANES", 29 * 16)  # two tiles that end within a row
    crop = variance_map("veach", crop=(3, 9, 11, 5), **SMALL)
    assert identical(crop, small.isel(x=slice(3, 14), y=slice(9, 14)))


def test_threads_and_blocks_do_not_change_bits(small, monkeypatch):
    import drjit

    before = drjit.thread_count()
    options = SMALL | {"crop": (8, 9, 6, 3), "strategies": ("light", "mis-bsdf")}
    part = small.isel(x=slice(8, 14), y=slice(9, 12)).sel(strategy=["light", "mis-bsdf"])
    two = variance_map("veach", workers=2, **options)
    assert identical(two, part[list(two)])  # `small` is measured with one thread
    assert drjit.thread_count() == before == 1
    monkeypatch.setattr(tiles, "_KEPT_NUMBERS", 0)  # tables are drawn again for each tile
    assert identical(variance_map("veach", **options), two)
    monkeypatch.setattr(tiles, "_BLOCK_REALIZATIONS", 10)
    merged = variance_map("veach", **options)
    assert np.allclose(merged["variance"], part["variance"], rtol=1e-10, equal_nan=True)


def test_own_points_do_not_depend_on_tiles(small, monkeypatch):
    strategies = ["light", "mis-bsdf"]
    options = {**SMALL, "points": "own", "crop": (8, 9, 6, 3), "strategies": strategies}
    whole = variance_map("veach", **options)
    monkeypatch.setattr(tiles, "TILE_LANES", 10 * 16)  # two tiles that end within a row
    assert identical(variance_map("veach", **options), whole)
    shared = small.isel(x=slice(8, 14), y=slice(9, 12)).sel(strategy=strategies)
    assert not np.array_equal(shared["variance"], whole["variance"], equal_nan=True)


def test_lobes_use_a_third_dimension(scene_files):
    scene, place = scene_files["textured"], {"crop": (18, 16, 4, 2), "realizations": 200}
    with pytest.raises(ParameterError, match="give dims=3"):
        variance_map(scene, counts=(4, 16), **place)
    found = variance_map(scene, counts=(8, 27), dims=3, points="own", **place)
    light, bsdf, mis = (found.sel(strategy=s) for s in ("light", "bsdf", "mis"))
    for other in (bsdf, mis):  # all strategies estimate the same value
        z = (light["mean"] - other["mean"]) / np.hypot(light["mean_se"], other["mean_se"])
        assert float(np.abs(z).max()) < 4.5  # limit by Šidák's correction for 16 values
    # Light sampling alone selects no lobe.
    variance_map(scene, ("light",), counts=(4, 16), crop=(18, 16, 1, 1), realizations=4)


def test_channels_and_heuristics():
    options = {**SMALL, "crop": (*PLATE, 1, 1), "predict_every": 0}
    red = variance_map("veach", channel=0, heuristic="power", **options)
    estimator = [pixel(s, channel=0, heuristic="power") for s in ("mis-light", "mis-bsdf")]
    one = mcs.convergence(
        mcs.estimators.TechniqueSum(estimator), "jittered", COUNTS, realizations=16, rng=7
    )
    own = red["variance"].sel(strategy="mis").squeeze().values
    assert own == pytest.approx(one["variance"].values, rel=1e-4)
    assert "predicted_ratio" not in red


@pytest.mark.parametrize(
    ("strategies", "expected"),
    [
        (("light",), {"light"}),
        ("bsdf", {"bsdf"}),
        (["mis"], {"mis-light", "mis-bsdf", "mis"}),
        (("mis-bsdf", "light"), {"light", "mis-bsdf"}),
    ],
)
def test_strategies_are_a_choice(small, strategies, expected):
    found = variance_map("veach", strategies, crop=(8, 9, 6, 3), **SMALL)
    assert set(found["strategy"].values) == expected
    assert ("bottleneck" in found) == ("mis" in expected)
    assert "mis_gain" not in found
    part = small.isel(x=slice(8, 14), y=slice(9, 12)).sel(strategy=found["strategy"])
    assert np.array_equal(found["variance"], part["variance"], equal_nan=True)


def test_predictions_of_every_third_pixel(small):
    found = variance_map("veach", crop=(1, 5, 9, 6), predict_every=3, **SMALL)
    whole = small["predicted_ratio"].isel(x=slice(1, 10), y=slice(5, 11))
    there = np.isfinite(found["predicted_ratio"].values)
    kept = (found["x"].values % 3 == 0) & (found["y"].values % 3 == 0)[:, None]
    assert np.array_equal(there, np.isfinite(whole.values) & kept)
    assert np.allclose(found["predicted_ratio"].values[there], whole.values[there], rtol=1e-12)


def test_smoothing_narrows_the_intervals_of_own_points():
    options = {**SMALL, "crop": (8, 0, 9, 5), "light": "light-3", "points": "own"}
    rough, smooth = (variance_map("veach", ("light",), smoothing=k, **options) for k in (1, 3))
    assert float(smooth["rate_se"].mean()) < 0.5 * float(rough["rate_se"].mean())
    assert smooth.attrs["smoothing"] == 3
    assert np.array_equal(smooth["variance"], rough["variance"], equal_nan=True)


def test_progress_is_reported(monkeypatch):
    monkeypatch.setattr(tiles, "TILE_LANES", 25 * 16)
    told: list[float] = []
    with listening(lambda _, done: told.append(done)):
        variance_map("veach", ("light",), crop=(0, 6, 24, 4), **SMALL)
    assert told[-1] == 1.0
    assert len(told) == 4
    assert told == sorted(told)


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize(
    ("largest", "realizations"), [(64, 64), (4096, 64), (64, 10**6), (2**20, 2)]
)
def test_tiles_bound_the_memory(own, largest, realizations):
    lighting = Lighting(
        scene="veach", light=None, heuristic="balance", channel="luminance", size=(9999, 9999)
    )
    plan = Measurement(
        lighting=lighting,
        strategies=("light",),
        sampler=sampler("random", 2),
        counts=(4, largest),
        realizations=realizations,
        stream=mcs.core.streams.Stream(1),
        own=own,
        predict_every=1,
    )
    assert 1 <= plan.tile_pixels * plan.block <= 2**19
    tables = plan.block * largest * 2 * (plan.tile_pixels if own else 1)
    assert tables <= 2**23


def test_values_that_are_not_finite_are_refused(monkeypatch):
    sums = Receivers._sums
    monkeypatch.setattr(Receivers, "_sums", lambda *a: tuple(e * np.nan for e in sums(*a)))
    with pytest.raises(ParameterError, match=r"NaN or infinite values, first at pixel \(8, 9\)"):
        variance_map("veach", crop=(8, 9, 2, 2), **SMALL)


@pytest.mark.parametrize(
    ("options", "error", "sentence"),
    [
        ({"scene": "veech"}, UnknownName, "veach"),
        ({"scene": "none.xml"}, FileFormatError, "no scene file"),
        ({"strategies": ("light", "path")}, ParameterError, "must be one of bsdf, light"),
        ({"strategies": ()}, ParameterError, "give one or more"),
        ({"strategies": 3}, ParameterError, "one flat list"),
        ({"sampler": "jitterd"}, UnknownName, "jittered"),
        ({"counts": (4, 5)}, CountError, "cannot make 5 points"),
        ({"counts": (4,)}, ParameterError, "two or more ascending"),
        ({"counts": (16, 4)}, ParameterError, "ascending"),
        ({"counts": "4,16"}, ParameterError, "one flat list"),
        ({"counts": (4, 2**60)}, CountError, "n is"),
        ({"realizations": 1}, ParameterError, "at least|from 2"),
        ({"crop": (0, 0, 25, 3)}, ParameterError, "reaches outside the grid of 24 × 16"),
        ({"crop": (-1, 0, 2, 2)}, ParameterError, "crop x0 is -1"),
        ({"crop": (0, 0, 0, 2)}, ParameterError, "crop width is 0"),
        ({"crop": (0, 0, 2)}, ParameterError, "crop has 3 values; give 4"),
        ({"crop": "0,0,2,2"}, ParameterError, "one flat list"),
        ({"size": (0, 4)}, ParameterError, "size is 0"),
        ({"size": (10**6, 4)}, ParameterError, "from 1 to 65536"),
        ({"size": (65_536, 65_536)}, ParameterError, "give a crop or a smaller size"),
        ({"light": "lamp"}, ParameterError, "has no light 'lamp'"),
        ({"heuristic": "cutoff"}, ParameterError, "balance, power"),
        ({"channel": "rgb"}, ParameterError, "channel is 'rgb'"),
        ({"dims": 4}, ParameterError, "from 2 to 3"),
        ({"points": "mine"}, ParameterError, "own, shared"),
        ({"smoothing": 2}, ParameterError, "odd"),
        ({"smoothing": 99}, ParameterError, "from 1 to 31"),
        ({"predict_every": -1}, ParameterError, "at least 0"),
        ({"rng": -1}, ParameterError, "rng"),
        ({"workers": 0}, ParameterError, "workers is 0"),
    ],
)
def test_bad_input_is_one_sentence(options, error, sentence):
    given = {"scene": "veach", **SMALL, **options}
    with pytest.raises(error, match=sentence) as caught:
        variance_map(**given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("scene", "sentence"), [("lamp", "delta"), ("dark", "no lights"), ("blind", "no camera")]
)
def test_scenes_that_cannot_be_measured(scene_files, scene, sentence):
    with pytest.raises(ParameterError, match=sentence):
        variance_map(scene_files[scene], counts=(4, 16), realizations=4)


def test_pixels_that_see_nothing_useful(scene_files):
    for scene, crop in (("mirror", (20, 18, 1, 1)), ("mirror", (0, 0, 1, 1))):
        with pytest.raises(ParameterError, match="No pixel of the crop"):
            variance_map(scene_files[scene], counts=(4, 16), realizations=4, crop=crop)


def test_crops_may_touch_the_borders():
    plan = Map(scene="veach", crop=(23, 15, 1, 1), size=(24, 16))
    assert checked(plan).need(SUBJECT).cost == (4 + 9 + 16 + 36 + 64) * 64 * 4
    whole = Map(scene="veach", size=(1024, 1024))
    assert checked(whole).need(SUBJECT).memory < 2**30


def test_tiles_measured_apart_change_nothing(monkeypatch):
    monkeypatch.setattr(tiles, "TILE_LANES", 16 * 8)  # a tile has 16 pixels, across several rows
    plan = Map(
        scene="penumbra",
        strategies=("light", "bsdf"),
        counts=(4, 16),
        realizations=8,
        size=(8, 6),
        crop=(1, 0, 7, 6),
        predict_every=2,
    )
    check_analysis(plan)
    found = compute(plan, SUBJECT, 3, workers=2)
    assert float(found["variance"].max()) > 0
    monkeypatch.undo()
    xr.testing.assert_identical(compute(plan, SUBJECT, 3, workers=1), found)


@pytest.mark.parametrize(
    "changes",
    [
        {"realizations": 1},
        {"counts": (16, 4)},
        {"crop": (0, 0, 9, 9), "size": (8, 6)},
        {"size": (65_536, 65_536)},
        {"channel": "rgb"},
    ],
)
def test_impossible_maps_are_rejected_without_the_scene(changes):
    with pytest.raises(ParameterError):
        checked(Map(scene="never-read.xml", **changes)).need(SUBJECT)
