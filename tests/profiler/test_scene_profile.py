"""`mcspectra.profile` of a scene: sampler, samples per pixel, causes and worst pixels."""

import json
import math

import numpy as np
import pytest
from tests.rendering.small_scenes import SCENES

import mcspectra as mcs
from mcspectra.cli.main import main
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.profiler import profile_scene
from mcspectra.profiler.scene_profile import (
    Needed,
    _in_order,
    _rare,
    _scale,
    _spp,
    _Work,
    plan_scene,
    sampler_name,
)
from mcspectra.rendering import load_mitsuba
from mcspectra.rendering.paths import Tracer
from mcspectra.rendering.plugin import register_samplers
from mcspectra.rendering.rendered import Film, RenderedPixels, chosen_tiles
from mcspectra.rendering.scenes import as_scene

FILM = {"width": 24, "height": 16}


@pytest.fixture(scope="module")
def found():
    scene = SCENES["plate"](**FILM)
    scene["sensor"]["sampler"] = {"type": "independent", "sample_count": 16}
    return profile_scene(scene, target=0.05, pixels=128, seconds=4.0)


class Rendered:
    """Normal values instead of renders, with the known error σ / mean = spread n^(rate/2)."""

    film = Film(64, 32, 0)
    samples, seconds = 10**9, 1.0

    def __init__(self, spread, rate):
        self.spread, self.rate = spread, rate

    def estimates(self, plugin, n, tiles, side, realizations, stream):
        assert side == 1
        sigma = self.spread[tiles[:, 1], tiles[:, 0]] * n ** (self.rate / 2)
        normal = stream.generator(0).standard_normal((realizations, len(tiles)))
        return 1.0 + sigma * normal


def test_a_known_rate_is_not_estimated():
    """With the known rate, the interval is wide by the errors of the pixels only."""
    spread = np.exp(np.random.default_rng(1).normal(0.0, 0.6, (32, 64)))
    widths = {}
    for rate in (None, -1.0):
        work = _Work(Rendered(spread, -1.0), Stream.from_rng(3), 30.0, 0.0)
        tiles, _ = chosen_tiles(Rendered.film, 256, Stream.from_rng(100))
        values = {n: work.rendered.estimates("", n, tiles, 1, 8, work._stream()) for n in (16, 64)}
        needed = work._needed("", values, np.ones(len(tiles)), tiles, 0.5, 0.01, rate)
        low, high = needed.spp_ci
        assert low < (np.median(spread) / 0.01) ** 2 < high
        widths[rate] = high / low
    assert widths[-1.0] < widths[None]


@pytest.mark.parametrize("rate", [-1.0, -1.5])
@pytest.mark.parametrize("target", [0.15, 0.03])
def test_needed_samples_are_those_of_the_quantile(rate, target):
    spread = np.exp(np.random.default_rng(1).normal(0.0, 0.6, (32, 64)))
    hits, errors = 0, []
    for seed in range(12):
        work = _Work(Rendered(spread, rate), Stream.from_rng(seed), 30.0, 0.0)
        tiles, side = chosen_tiles(Rendered.film, 1024, Stream.from_rng(100 + seed))
        values = {
            n: work.rendered.estimates("", n, tiles, side, 16, work._stream()) for n in (16, 64)
        }
        for share in (0.5, 0.95):
            needed = work._needed("", values, np.ones(len(tiles)), tiles, share, target)
            true = (np.quantile(spread, share) / target) ** (-2.0 / rate)
            low, high = needed.spp_ci
            hits += low <= true <= high
            errors.append(needed.spp / true)
    # 24 intervals of 95 %: fewer than 19 hits have probability 1e-3
    assert hits >= 19
    assert 0.85 < np.median(errors) < 1.15


@pytest.mark.slow
def test_one_pixel_has_a_standard_error_too():
    """Earlier versions took the scatter over pixels alone, which is 0 for one pixel."""
    hits = 0
    for seed in range(40):
        work = _Work(Rendered(np.full((32, 64), 0.5), -1.5), Stream.from_rng(seed), 30.0, 0.0)
        pixel = np.array([[3, 5]])
        values = {n: work.rendered.estimates("", n, pixel, 1, 64, work._stream()) for n in (16, 64)}
        needed = work._needed("", values, np.ones(1), pixel, 0.5, 0.03)
        low, high = needed.spp_ci
        hits += low <= (0.5 / 0.03) ** (2.0 / 1.5) <= high
        assert 1.0 < high / low < 5.0
    # 40 intervals of 95 %: fewer than 33 hits have probability 1e-3
    assert hits >= 33
    near = np.random.default_rng(0).normal(size=(2, 64, 1))
    log, error = _Work._ratio(*near)
    assert 0.0 < error < 0.4
    assert abs(log) < 3.0 * error


class Dark(Rendered):
    """Every 16th pixel is dark: only one sample of 500 finds light, which is 500 times brighter."""

    def estimates(self, plugin, n, tiles, side, realizations, stream):
        values = super().estimates(plugin, n, tiles, side, realizations, stream)
        found = stream.generator(1).binomial(n, 1 / 500, values.shape) * 500.0 / n
        return np.where(tiles[:, 0] % 16 == 0, found, values)


def test_dark_pixels_without_variance_do_not_hide_the_spread_of_the_others():
    """A dark pixel may have no variance in half of the renders.

    Earlier versions then took all errors for equal, and printed the number of some other pixels.
    """
    spread = np.exp(np.random.default_rng(1).normal(0.0, 0.6, (32, 64)))
    truth = np.where(np.arange(64) % 16 == 0, math.sqrt(499.0), spread)
    for seed in range(12):
        work = _Work(Dark(spread, -1.0), Stream.from_rng(seed), 30.0, 0.0)
        tiles, _ = chosen_tiles(Rendered.film, 128, Stream.from_rng(seed))
        values = {n: work.rendered.estimates("", n, tiles, 1, 20, work._stream()) for n in (16, 64)}
        needed = work._needed("", values, np.ones(len(tiles)), tiles, 0.5, 0.05, -1.0)
        errors = truth[tiles[:, 1], tiles[:, 0]]
        true = (np.median(errors) / 0.05) ** 2
        # 20 renders: errors of 32 % of a variance, and a median of 128 pixels with a scatter of 1.2
        # has an error of 1.25 * 0.32 / sqrt(128) = 4 %; that of new renders is 12 %
        assert 1 / 1.5 < needed.spp / true < 1.5
        raw, known = work._logs(values[64], np.ones(len(tiles))), errors < 20.0
        narrowed = work._narrowed(values[64], np.ones(len(tiles)))
        assert 0.7 * np.std(raw[known]) < np.std(narrowed[known]) <= np.std(raw[known])


@pytest.mark.parametrize("renders", [8, 16, 32])
def test_the_spread_of_the_pixels_is_recovered_from_few_renders(renders):
    """Earlier versions found a spread of 0.62 from 8 renders, and of 0.67 from 16."""
    spread, found = 0.69, []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        sigma = 0.01 * np.exp(0.5 * rng.normal(0.0, spread, 1024))
        values = 1.0 + sigma * rng.standard_normal((renders, 1024))
        logs = _Work._narrowed(values, np.ones(1024))
        found.append(_scale(logs - np.median(logs)))
    # Logarithms of variances of 8 renders are not exactly normal, which changes the spread by 2 %
    error = 3.0 * np.std(found, ddof=1) / math.sqrt(len(found))
    assert np.mean(found) == pytest.approx(spread, abs=math.hypot(error, 0.02 * spread))


def test_rare_paths_are_noticed():
    """Among 2000 pixels of normal values, about 2 are taken for pixels with rare paths."""
    rng = np.random.default_rng(0)
    for renders in (8, 64):
        values = 1.0 + 0.1 * rng.standard_normal((renders, 2000))
        assert _rare(values, np.ones(2000)).sum() <= 9  # a Poisson number of mean 2: p = 5e-5
        one = np.where(np.arange(renders)[:, None] == 3, 1.0, 0.0) + 1e-3 * values
        assert _rare(one, one.mean(axis=0)).all()
    constant = np.ones((8, 3))
    assert not _rare(constant, np.ones(3)).any()
    assert _rare(constant, np.array([1.0, 2.0, 1.5])).tolist() == [False, True, True]


def test_rare_paths_widen_the_interval_upward():
    spread = np.exp(np.random.default_rng(1).normal(0.0, 0.6, (32, 64)))
    tiles, _ = chosen_tiles(Rendered.film, 128, Stream.from_rng(0))
    ends = {}
    for kind in (Rendered, Dark):
        work = _Work(kind(spread, -1.0), Stream.from_rng(0), 30.0, 0.0)
        values = {n: work.rendered.estimates("", n, tiles, 1, 20, work._stream()) for n in (16, 64)}
        for share in (0.5, 0.95):
            found = work._needed("", values, np.ones(len(tiles)), tiles, share, 0.1, -1.0)
            ends[kind, share] = found.spp_ci[1] / found.spp
    assert 1.0 < ends[Rendered, 0.5] < 2.0
    assert ends[Rendered, 0.95] < 3.0
    assert ends[Dark, 0.5] < 3.0
    # More than 5 % of the pixels are dark, and any of them may be noisier than the others
    assert ends[Dark, 0.95] > 3.0 * ends[Rendered, 0.95]


def test_a_sampler_with_one_number_of_samples_has_the_usual_slope():
    """A sampler with twice the least variance is not measured at more samples."""
    work = _Work(Rendered(np.full((32, 64), 0.5), -1.0), Stream.from_rng(0), 30.0, 0.0)
    tiles, _ = chosen_tiles(Rendered.film, 64, Stream.from_rng(0))
    values = {16: work.rendered.estimates("", 16, tiles, 1, 16, work._stream())}
    low, high = work._needed("", values, np.ones(len(tiles)), tiles, 0.5, 0.1).spp_ci
    assert low < 25.0 < high
    assert work._quantities(values, np.ones(len(tiles)), np.ones(len(tiles), bool))[1] < -1.0


def test_samples_for_more_pixels_are_never_fewer():
    half, most = Needed(0.5, 185.0, (141.0, 243.0)), Needed(0.95, 176.0, (135.0, 260.0))
    assert _in_order([half, most]) == (half, Needed(0.95, 185.0, (141.0, 260.0)))
    assert _in_order([half, Needed(0.95, 300.0, (200.0, 400.0))])[1].spp == 300.0


@pytest.mark.parametrize(("pixels", "renders"), [(1024, 32), (256, 128), (4, 1024)])
def test_few_pixels_are_rendered_more_often(pixels, renders):
    class Fast(Rendered):
        """Renders of 10^9 samples per second."""

        def estimates(self, plugin, n, tiles, side, realizations, stream):
            self.samples += 10**9
            self.seconds += 1.0
            return super().estimates(plugin, n, tiles, side, realizations, stream)

    work = _Work(Fast(np.full((32, 64), 0.5), -1.0), Stream.from_rng(0), 30.0, 0.0)
    assert work.planned({"given": "independent"}, pixels, "given")[1] == renders


def test_a_crop_of_one_pixel_is_profiled():
    scene = SCENES["plate"](**FILM)
    made = profile_scene(scene, target=0.05, crop=(10, 9, 1, 1), seconds=2.0)
    low, high = made.needed[0].spp_ci
    assert low < made.needed[0].spp < high
    assert made.needed[0] == made.needed[1] or made.needed[0].spp <= made.needed[1].spp
    assert "1 pixel rendered" in str(made)


def test_a_better_sampler_is_found_and_confirmed(found):
    assert found.answer.given.name == "independent"
    assert found.answer.changes
    low, high = found.answer.gain_ci
    assert 1.0 < low < found.answer.gain < high
    assert found.confirmed_ci[0] < 1.2
    assert found.confirmed_ci[1] > 0.8
    assert "Use " in found.text
    assert "samples per pixel at half of the pixels" in found.text
    name = found.answer.best.name
    assert f"worst pixels at 64 samples per pixel with {name}" in found.text
    assert "of the variance (random numbers, one path per pixel)" in found.text
    assert " times the variance of those in the comparison" in found.text


@pytest.mark.slow
def test_samples_per_pixel_hold_the_truth(found):
    """Half of the pixels reach the target with independent samples, whose rate is −1."""
    scene = as_scene(SCENES["plate"](**FILM))
    film = Film.of(scene)
    tiles, side = chosen_tiles(film, 10**6, Stream.from_rng(0))
    rendered = RenderedPixels(Tracer(scene, "scene", "luminance", (24, 16)), film)
    values = rendered.estimates("independent", 64, tiles, side, 200, Stream.from_rng(5))
    seen = values.mean(axis=0) > 0
    errors = values[:, seen].std(axis=0, ddof=1) / values[:, seen].mean(axis=0)
    true = 64 * (np.median(errors) / 0.05) ** 2
    low, high = found.needed_now[0].spp_ci
    assert low < true < high
    assert high < 8 * low  # A busy machine makes fewer renders in the time
    # Dark pixels with rare paths may be taken for pixels near the median. Then the interval is wide
    plate, hits = SCENES["plate"](**FILM), 0
    plate["sensor"]["sampler"] = {"type": "independent", "sample_count": 16}
    for seed in range(8):
        made = profile_scene(plate, target=0.05, pixels=128, seconds=1.0, rng=seed)
        low, high = made.needed_now[0].spp_ci
        hits += low < true < high
    # 8 intervals of 95 %: fewer than 6 hits have probability 6e-3
    assert hits >= 6


@pytest.mark.slow
def test_causes_and_worst_pixels_are_named(found):
    assert found.causes[0].decision == "bounce 1 light"
    assert found.causes[0].share > 0.5
    assert sum(cause.share for cause in found.causes) == pytest.approx(1.0, abs=1e-6)
    assert len(found.worst) == 5
    x, y, error = found.worst[0]
    assert 0 <= x < 24
    assert 0 <= y < 16
    assert error >= found.worst[-1][2]
    assert f"mcspectra pixel dict {x} {y} --integrator scene" in found.text
    json.dumps(found.to_dict())
    assert "<pre>" in found._repr_html_()


@pytest.mark.slow
def test_samplers_are_named_as_they_are_rendered(found):
    names = {result.name for result in found.answer.results}
    assert {"multijitter", "ldsampler", "sobol | owen (padded)"} <= names
    assert "sobol | owen (joint_dims=4)" in names


def test_equal_ends_and_open_intervals_of_samples():
    assert _spp(Needed(0.5, 27.9, (27.8, 28.0))) == "28"
    assert _spp(Needed(0.5, 28.0, (20.0, 40.0))) == "28 (20 to 40)"
    assert _spp(Needed(0.5, 28.0, (20.0, np.inf))) == "28 (20 or more)"
    assert _spp(Needed(0.5, np.inf, (1.0, np.inf))) == "an unknown number of"
    # This interval excludes nothing
    assert _spp(Needed(0.95, 5e7, (1e-11, 2e26))) == "an unknown number of"
    assert _spp(Needed(0.95, 5e4, (65.0, 3e7))) == "50000 (65 to 30000000)"


@pytest.mark.parametrize(
    "name", ["independent", "stratified", "multijitter", "orthogonal", "ldsampler"]
)
def test_samplers_of_mitsuba_have_their_names(name):
    mitsuba = load_mitsuba()
    assert sampler_name(mitsuba.load_dict({"type": name, "sample_count": 25})) == name


def test_our_sampler_is_named_with_its_spec():
    register_samplers()
    made = load_mitsuba().load_dict({"type": "mcspectra", "spec": "halton | permute"})
    assert sampler_name(made) == "mcspectra[halton | permute, joint_dims=0, sample_count=4]"


def test_frames_and_profile_agree_on_the_samples_for_a_target(tmp_path):
    """Normal noise of independent samples: both know the quantiles of σ / mean."""
    spread = np.exp(np.random.default_rng(1).normal(0.0, 0.6, (32, 64)))
    pixels = np.stack(np.meshgrid(np.arange(64), np.arange(32)), axis=-1).reshape(-1, 2)
    rendered = Rendered(spread, -1.0)
    stream = Stream.from_rng(3)
    values = {n: rendered.estimates("", n, pixels, 1, 24, stream.child(n)) for n in (16, 64)}
    for n, images in values.items():
        for k, image in enumerate(images):
            np.save(tmp_path / f"view_{n}spp_{k}.npy", image.reshape(32, 64).astype(np.float32))
    found = mcs.rendering.frames(tmp_path, target=0.05, flip=False)
    frames = np.quantile(found["needed_spp"].values, [0.5, 0.95])
    work = _Work(rendered, Stream.from_rng(0), 30.0, 0.0)
    for share, other in zip((0.5, 0.95), frames, strict=True):
        needed = work._needed("", values, np.ones(len(pixels)), pixels, share, 0.05)
        true = (np.quantile(spread, share) / 0.05) ** 2
        assert needed.spp_ci[0] < true < needed.spp_ci[1]
        # A variance of 24 frames has an error of 29 %, which widens the quantiles of frames
        assert other == pytest.approx(needed.spp, rel=0.35)


def test_target_is_for_scenes():
    with pytest.raises(ParameterError, match="target is for scenes"):
        mcs.profile("gaussian(width=0.3)", target=0.1)


@pytest.mark.slow
def test_the_command_profiles_a_scene(capsys):
    command = ["profile", "penumbra(width=32, height=24)", "--integrator", "direct"]
    options = ["--pixels", "32", "--seconds", "1", "--target", "0.1"]
    assert main([*command, *options, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["target"] == 0.1
    assert len(data["needed"]) == 2


def test_a_dry_run_prints_size_and_time(capsys):
    command = ["profile", "penumbra(width=32, height=24)", "--integrator", "direct"]
    assert main([*command, "--dry-run", "--seconds", "1"]) == 0
    assert "nothing is stored" in capsys.readouterr().out


def test_a_plan_counts_the_pixels_of_the_crop():
    scene = "penumbra(width=32, height=24)"
    asked = {"integrator": "direct", "seconds": 1.0}
    assert plan_scene(scene, crop=(4, 4, 8, 8), **asked).pixels == 64
    with pytest.raises(ParameterError, match="crop is"):
        plan_scene(scene, crop=(30, 0, 8, 8), **asked)
    with pytest.raises(ParameterError, match="target"):
        plan_scene(scene, target=-1.0)


def test_a_plan_counts_the_samples_for_the_target():
    rendered = Rendered(np.ones((16, 16)), -1.0)
    pixels = np.stack(np.meshgrid(np.arange(16), np.arange(16)), axis=-1).reshape(-1, 2)
    values = rendered.estimates("", 64, pixels, 1, 16, Stream.from_rng(3))
    work = _Work(rendered, Stream.from_rng(0), 30.0, 0.0)
    # The error is 1/8 with 64 samples. Near each of two quantiles, 32 pixels are rendered 16 times
    assert work._nearby(values, 0.125) == 0
    few, more = (work._nearby(values, target) for target in (0.125 / 2, 0.125 / 4))
    assert few == 2 * 32 * 16 * 256
    assert more == 2 * 32 * 16 * 1024
    assert work._nearby(0.0 * values, 0.125) == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["veach", "--budget", "4096"], "--budget is not for scenes"),
        (["veach", "--target", "nan"], "--target"),
        (["gaussian", "--target", "0.1"], "--target is for scenes"),
        (["veach", "--integrator", "nosuch"], "nosuch"),
        (["veach", "--integrator", ""], "--integrator is ''"),
        (["veach", "--seconds", "nan"], "at least 1 and at most 86400"),
        (["veach", "--pixels", "1e9"], "from 16 to 65536"),
        (["veach", "--joint-dims", "99999999"], "from 2 to 64"),
        (["missing.xml"], "There is no scene file"),
    ],
)
def test_bad_commands_are_one_sentence(capsys, options, words):
    assert main(["profile", *options]) == 2
    printed = capsys.readouterr().err
    assert words in printed
    assert printed.count("\n") == 1
