"""Screen-space samplers and the spectra of their errors: theory, protocols, files and bad input."""

import json
import stat
import sys

import numpy as np
import pytest
from tests.plots.drawing import written_by_bokeh

import mcspectra as mcs
from mcspectra import rendering
from mcspectra.cli.main import main
from mcspectra.core import trust
from mcspectra.core.errors import (
    ConfigError,
    CountError,
    DomainError,
    FileFormatError,
    McspectraError,
    ParameterError,
)
from mcspectra.core.streams import Stream
from mcspectra.core.trust import process_trust
from mcspectra.plots.kinds import describe, kinds_of
from mcspectra.plots.screens import SCREENS, mask_names
from mcspectra.rendering import FunctionScreen, ScreenBlock, as_screen_sampler, screen_spectrum
from mcspectra.rendering import screen_samplers as module
from mcspectra.report.screen_page import screen_findings, screen_summary
from mcspectra.samplers.dither import dither_mask, spatiotemporal_mask

KEYS = Stream(1).keys(0, 1)[0]
MASK = "sobol | decorrelate(mask='spatiotemporal', width=32)"
IDENTITY = mcs.Integrand.from_function(lambda u: u[..., 0], dims=1, integral=0.5)
SIGMAS = 5.0  # largest deviation of a statistic, in standard errors


def points_of(source, n, block, *, dims=2, seed=0, stream=3):
    """Return the points (frames, height, width, n, dims) of a source."""
    place = ScreenBlock(*block)
    made = as_screen_sampler(source, dims).frames_of(n, place, seed, Stream(stream))
    return np.stack(list(made))


class TestSpatiotemporalMask:
    def test_one_frame_is_a_dither_mask(self):
        np.testing.assert_array_equal(spatiotemporal_mask(16, 1, KEYS)[0], dither_mask(16, KEYS))

    def test_ranks_are_a_permutation_with_the_same_bits(self):
        mask = spatiotemporal_mask(16, 8, KEYS)
        np.testing.assert_array_equal(np.sort(mask.ravel()), np.arange(8 * 16 * 16))
        np.testing.assert_array_equal(mask, spatiotemporal_mask(16, 8, KEYS))

    def test_it_is_blue_in_each_frame_and_in_time(self):
        mask = (spatiotemporal_mask(32, 16, KEYS) + 0.5) / (16 * 32 * 32) - 0.5
        power = np.abs(np.fft.fftn(mask)) ** 2 / mask.size * 12.0
        down = np.fft.fftfreq(32)
        radius, times = np.hypot(down[:, None], down), np.abs(np.fft.fftfreq(16))
        space = power.mean(axis=0)
        # A Gaussian over space and time would leave white noise in a frame: power 1 at low radius
        assert space[(radius > 0) & (radius < 0.125)].max() < 0.05
        assert power[times < 0.1].mean() < 0.05
        assert space[radius > 0.35].mean() > 1.2
        assert power[times > 0.3].mean() > 1.2

    @pytest.mark.parametrize("cells", [(0, 1), (16, 0), (2048, 2), (16, 257)])
    def test_sizes_are_limited(self, cells):
        with pytest.raises(ParameterError):
            spatiotemporal_mask(*cells, KEYS)


class TestDecorrelateInTime:
    def test_a_mask_repeats_after_its_frames(self):
        mask = points_of(MASK, 1, (32, 32, 17), dims=1)[..., 0, 0]
        # Values within a rank are random, so equal ranks agree to the size of a rank
        assert np.abs(mask[0] - mask[16]).max() < 1.0 / (16 * 32 * 32)
        assert np.abs(mask[0] - mask[1]).max() > 0.1

    def test_golden_adds_the_golden_ratio(self):
        chain = "sobol | decorrelate(mask='blue-noise', width=16, time='golden')"
        mask = points_of(chain, 1, (16, 16, 3), dims=1)[..., 0, 0]
        step = (mask[2] - mask[0]) % 1.0
        assert np.abs(step - 2 * (np.sqrt(5.0) - 1) / 2 % 1.0).max() < 1.0 / 16**2

    def test_move_moves_the_mask(self):
        chain = "sobol | decorrelate(mask='blue-noise', width=16, time='move')"
        still = points_of(chain.replace(", time='move'", ""), 1, (16, 16, 2), dims=1)[..., 0, 0]
        moved = points_of(chain, 1, (16, 16, 2), dims=1)[..., 0, 0]
        down, across = (int(0.7548776662466927**k * 16) for k in (2, 1))
        expected = np.roll(still[1], (-down, -across), axis=(0, 1))
        assert np.abs(moved[1] - expected).max() < 1.0 / 16**2

    def test_advance_takes_later_points_of_the_sequence(self):
        chain = "sobol | decorrelate(mask='blue-noise', width=8, advance=True)"
        found = points_of(chain, 4, (8, 8, 3), dims=2)
        sobol = mcs.sampler("sobol", 2).draw(16)[0]
        for frame in range(3):
            shift = (found[frame, 3, 5] - sobol[4 * frame : 4 * frame + 4]) % 1.0
            np.testing.assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-12)

    @pytest.mark.parametrize(
        ("chain", "words"),
        [
            ("sobol | decorrelate(mask='white', time='golden')", "only mask='blue-noise'"),
            ("jittered | decorrelate(advance=True)", "is not a sequence"),
            ("sobol | decorrelate(mask='spatiotemporal', frames=0)", "from 1 to 64"),
            ("sobol | decorrelate(time='later')", "repeat, golden, move"),
        ],
    )
    def test_bad_options_are_one_sentence(self, chain, words):
        with pytest.raises(ParameterError, match=words):
            mcs.sampler(chain, 2)


class TestSpectrum:
    def test_white_noise_has_power_1(self):
        found = screen_spectrum("random", "gaussian(width=0.3)", 2, block=(16, 16, 64), seeds=4)
        one = found.isel(sampler=0)
        # The power of a frequency has relative error 1; pairs of frequencies of opposite sign agree
        cells = one["relative_power"].values
        # The taper of three axes divides the number of independent values by (35/18)³
        error = np.sqrt(2.0 * (35 / 18) ** 3 / (16 * 16 * 64 * 4))
        assert abs(float(np.nanmean(cells)) - 1.0) < SIGMAS * error * 2
        share = np.pi * 0.125**2
        assert abs(float(one["low_share"]) - 1.0) < SIGMAS * error / np.sqrt(share)
        white = found.attrs["white_variance"]
        np.testing.assert_allclose(float(one["pixel_error"]), white, rtol=SIGMAS * 4 * error)
        for low, high in one["filtered_ratio_ci"].values:
            assert low < 1.2
            assert high > 0.8

    def test_the_mean_power_is_the_error_of_a_pixel(self):
        found = screen_spectrum(MASK, IDENTITY, 1, block=(32, 32, 16), seeds=2).isel(sampler=0)
        errors = points_of(MASK, 1, (32, 32, 16), dims=1, stream=0)[..., 0, 0] - 0.5
        np.testing.assert_allclose(float(found["pixel_error"]), (errors**2).mean(), rtol=1e-3)
        # Uniform points have the variance 1/12; the mask is stratified over all its values
        np.testing.assert_allclose(float(found["pixel_error"]), 1 / 12, rtol=1e-3)

    def test_a_mask_is_blue_in_space_and_time(self):
        found = screen_spectrum(MASK, IDENTITY, 1, block=(32, 32, 64), seeds=2).isel(sampler=0)
        assert float(found["low_share"]) < 0.02
        assert float(found["slow_share"]) < 0.1
        ratio = found["filtered_ratio"]
        assert float(ratio.sel(filter="gaussian")) < 0.02
        assert float(ratio.sel(filter="ema")) < 0.15
        assert float(ratio.sel(filter="both")) < 0.005

    def test_golden_steps_have_the_lines_of_theory(self):
        """The errors cos 2π(δ + t·α) have the power of the taper's kernel at ± α."""
        chain = "sobol | decorrelate(mask='blue-noise', width=32, time='golden')"
        f = mcs.Integrand.from_function(
            lambda u: np.cos(2 * np.pi * u[..., 0]), dims=1, integral=0.0
        )
        frames, seeds = 32, 4
        found = screen_spectrum(chain, f, 1, block=(32, 32, frames), seeds=seeds).isel(sampler=0)
        step, t = (np.sqrt(5.0) - 1) / 2, np.arange(frames)

        taper = (1 - np.cos(2 * np.pi * (t + 0.5) / frames)) * np.sqrt(2 / 3)

        def kernel(nu):
            waves = taper * np.exp(-2j * np.pi * nu[:, None] * t)
            return np.abs(waves.sum(axis=1)) ** 2 / frames

        nu = found["frequency"].values
        expected = (kernel(nu - step) + kernel(nu + step)) / 2
        # Blue noise: weight the rings by their power, as the time profile is the same in all rings
        power = found["error_power"].values
        measured = np.nansum(power, axis=1) / np.nansum(power) * frames
        weight = np.where((nu > 0) & (nu < 0.5), 2.0, 1.0)
        measured *= (expected * weight).sum() / (measured * weight).sum()
        # The two lines interfere with random phases in about 32²/2 frequencies of each block
        error = np.sqrt(kernel(nu - step) * kernel(nu + step)) / np.sqrt(32 * 32 / 2 * seeds)
        # Random places within the 32² ranks add white noise of the relative variance 4π²/12/32⁴
        within = 4 * np.pi**2 / 12 / 32**4
        assert (np.abs(measured - expected) < SIGMAS * (error + within) + 0.02 * expected).all()

    @pytest.mark.parametrize("rho", [0.5, 0.9])
    def test_ema_of_ar1_noise(self, rho):
        """The variance after the EMA is α/(2 − α)·(1 + q)/(1 − q) with q = ρ(1 − α)."""
        alpha, frames, side, drawn = 0.1, 384, 16, {}

        def series(seed):
            rng, scale = np.random.default_rng(seed), np.sqrt(1 - rho**2)
            z = rng.standard_normal((frames, side * side))
            for t in range(1, frames):
                z[t] = rho * z[t - 1] + scale * z[t]
            return np.clip(0.5 + 0.1 * z, 0.0, 1.0 - 2**-53)

        def points(x, y, frame, n, seed):
            if seed not in drawn:
                drawn[seed] = series(seed)
            return drawn[seed][frame[0]][y * side + x][:, None, None]

        found = screen_spectrum(points, IDENTITY, 1, block=(side, side, frames), seeds=6)
        one = found.isel(sampler=0)
        errors = one["filtered_error"].sel(filter=["ema", "none"]).values
        q = rho * (1 - alpha)
        expected = (1 + q) / (1 - q)
        measured = errors[0] / errors[1] / (alpha / (2 - alpha))
        low, high = one["filtered_ratio_ci"].sel(filter="ema").values
        half = np.log(high / low) / 2
        assert abs(np.log(measured / expected)) < 2 * half
        assert half < 0.1

    def test_a_part_of_a_mask_has_little_leakage(self):
        """A block of 32 pixels of a mask of 64: the taper keeps low frequencies dark."""
        chain = "sobol | decorrelate(mask='blue-noise', width=64)"
        found = screen_spectrum(chain, IDENTITY, 1, block=(32, 32, 1), seeds=8).isel(sampler=0)
        assert float(found["low_share"]) < 0.005
        whole = screen_spectrum(chain, IDENTITY, 1, block=(64, 64, 1), seeds=2).isel(sampler=0)
        ratio = found["filtered_ratio"] / whole["filtered_ratio"]
        np.testing.assert_allclose(ratio.sel(filter="gaussian"), 1.0, atol=0.1)

    def test_filters_match_filtered_images(self):
        """A mask that repeats in the block: the errors are those of repeated, filtered frames."""
        from scipy.ndimage import gaussian_filter

        found = screen_spectrum(MASK, IDENTITY, 1, block=(32, 32, 16), seeds=2).isel(sampler=0)
        errors = points_of(MASK, 1, (32, 32, 16), dims=1, stream=0)[..., 0, 0] - 0.5
        kept, images = 0.0, []
        for t in range(16 * 12):
            kept = 0.9 * kept + 0.1 * errors[t % 16]
            images.append(kept)
        blurred = gaussian_filter(errors, (0, 1.5, 1.5), mode="wrap")
        measured = found["filtered_error"].sel(filter=["gaussian", "ema"]).values
        expected = [(blurred**2).mean(), (np.array(images[-16:]) ** 2).mean()]
        np.testing.assert_allclose(measured, expected, rtol=0.1)  # another seed of the same mask

    def test_a_winner_needs_separate_intervals(self):
        found = screen_spectrum(["random", "sobol | owen"], IDENTITY, 1, block=(16, 16, 64))
        assert (found["best"].values == -1).all()
        masks = ["random", "sobol | decorrelate(mask='blue-noise', width=16)"]
        found = screen_spectrum(masks, IDENTITY, 1, block=(16, 16, 64))
        assert int(found["best"].sel(filter="gaussian")) == 1
        said = screen_findings(found)
        assert any("blue-noise" in each and "is best" in each for each in said)
        assert int(found["best"].sel(filter="ema")) == 0  # a mask that never changes keeps errors

    def test_one_frame_has_no_time(self):
        found = screen_spectrum("random", IDENTITY, 1, block=(32, 32, 1))
        assert found.sizes["frequency"] == 1
        assert list(screen_summary(found)["best"]) == ["none", "gaussian"]

    def test_the_same_seed_gives_the_same_bits(self):
        a, b, c = (
            screen_spectrum(["random", MASK], IDENTITY, 2, block=(16, 16, 8), sigma=0.5, rng=k)
            for k in (7, 7, 8)
        )
        assert a.identical(b)
        assert not np.array_equal(a["error_power"], c["error_power"])

    def test_too_few_frames_for_the_average_are_reported(self):
        found = screen_spectrum(["random", MASK], IDENTITY, 1, block=(32, 32, 16))
        assert "hold for random only if" in found.attrs["note"]
        assert "spatiotemporal" not in found.attrs["note"]


BLOCK_PROGRAM = f"""#!{sys.executable}
import random, sys
how, *given = sys.argv[1:]
numbers = list(map(int, given))
if how == "block":
    width, height, frames, n, seed = numbers
    places = [(x, y, t) for t in range(frames) for y in range(height) for x in range(width)]
else:
    x, y, t, n, seed = numbers
    places = [(x, y, t)]
if how == "wait":
    import time
    time.sleep(60)
for x, y, t in places:
    for i in range(n):
        u, v = (x + 10 * y + 0.5) / 256, (t + 16 * i + 0.25) / 256
        print(*({{"many": (u, v, u), "out": (u, 1.5), "nan": (u, "nan")}}.get(how, (u, v))))
if how == "few" or how == "more":
    print(0.5, 0.5)
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    file = tmp_path_factory.mktemp("screen") / "mine"
    file.write_text(BLOCK_PROGRAM, encoding="utf-8")
    file.chmod(file.stat().st_mode | stat.S_IEXEC)
    before = process_trust()
    mcs.samplers.allow_code(str(file))
    yield file
    trust._process = before


class TestCommand:
    @pytest.mark.parametrize(
        ("how", "places"),
        [
            ("block", "{width} {height} {frames}"),
            ("pixel", "{x} {y} {frame}"),
        ],
    )
    def test_points_are_at_their_pixels(self, program, how, places):
        spec = f"command('{program} {how} {places} {{n}} {{seed}}')"
        found = points_of(spec, 2, (3, 2, 2))
        assert found.shape == (2, 2, 3, 2, 2)
        x, y, t, i = 2, 1, 1, 1
        expected = [(x + 10 * y + 0.5) / 256, (t + 16 * i + 0.25) / 256]
        np.testing.assert_array_equal(found[t, y, x, i], expected)

    def test_some_axes_may_be_printed_and_others_run(self, program):
        """Frames run one by one; with the wrong placeholders the program prints other counts."""
        spec = f"command('{program} block {{width}} {{height}} 1 {{n}} {{frame}}')"
        found = points_of(spec, 1, (3, 2, 2))
        np.testing.assert_array_equal(found[0], found[1])

    @pytest.mark.parametrize(
        ("how", "error", "words"),
        [
            ("more", ParameterError, "printed 2 points in 2 dims at frame = 0, y = 0, x = 0"),
            ("many", ParameterError, "1 point in 3 dims"),
            ("out", DomainError, r"must lie in \[0,1\)"),
            ("nan", FileFormatError, "is not a finite number"),
            ("pixel --x", ParameterError, "ended with exit code 1: ValueError"),
        ],
    )
    def test_bad_output_is_one_sentence(self, program, how, error, words):
        spec = f"command('{program} {how} {{x}} {{y}} {{frame}} {{n}} {{seed}}')"
        with pytest.raises(error, match=words):
            points_of(spec, 1, (4, 4, 1))

    def test_a_program_that_hangs_is_stopped(self, program):
        spec = f"command('{program} wait {{x}} {{y}} {{frame}} {{n}} {{seed}}', timeout=0.5)"
        with pytest.raises(ParameterError, match="took more than 0.5 s"):
            points_of(spec, 1, (4, 4, 1))

    def test_too_many_processes_are_refused_before_the_first(self):
        mcs.samplers.allow_code("./no-such")
        spec = "command('./no-such {x} {y} {frame} {n} {seed}')"
        with pytest.raises(ParameterError, match="would run 65,536 processes"):
            screen_spectrum(spec, "gaussian", 1, block=(32, 32, 32), seeds=2)
        spec = "command('./no-such {n} {seed}')"
        with pytest.raises(ParameterError, match="would run 65,536 processes"):
            screen_spectrum(spec, "gaussian", 1, block=(32, 32, 32), seeds=2)

    def test_slow_programs_are_refused_after_the_first_process(self, program, monkeypatch):
        monkeypatch.setattr(module, "_SETTINGS", module.ScreenSettings(most_seconds=1e-6))
        spec = f"command('{program} pixel {{x}} {{y}} {{frame}} {{n}} {{seed}}')"
        with pytest.raises(ParameterError, match="16 processes of a block"):
            points_of(spec, 1, (4, 4, 1))

    def test_without_a_seed_there_is_one_block_and_no_interval(self, program):
        spec = f"command('{program} block {{width}} {{height}} {{frames}} {{n}} 1', name='mine')"
        found = screen_spectrum(spec, "gaussian", 1, block=(16, 16, 4))
        assert int(found["blocks"][0]) == 1
        assert np.isnan(found["filtered_ratio_ci"].values).all()
        assert "mine: only one block exists" in found.attrs["note"]


def half(x, y, frame, n, seed):
    """Points of a pixel: random, with the seed."""
    rng = np.random.default_rng([seed, int(frame[0])])
    return rng.random((x.size, n, 2))


def broken(x, y, frame, n, seed):
    """Raise an error."""
    raise KeyError("no table")


class TestPython:
    def test_a_function_by_its_name(self):
        mcs.samplers.allow_code(f"{__name__}:half", f"{__name__}:broken")
        found = points_of(f"python('{__name__}:half')", 3, (4, 5, 2))
        assert found.shape == (2, 5, 4, 3, 2)
        np.testing.assert_array_equal(found, points_of(half, 3, (4, 5, 2)))
        assert not np.array_equal(found, points_of(half, 3, (4, 5, 2), stream=4))
        with pytest.raises(CountError, match="cannot make the points of frame 0: 'no table'"):
            points_of(f"python('{__name__}:broken')", 3, (4, 5, 2))

    @pytest.mark.parametrize(
        ("made", "words"),
        [
            (lambda x, *_: np.zeros((x.size, 3)), r"returned shape \(16, 3\); \(16, 1, 2\)"),
            (lambda x, *_: np.full((x.size, 2), 1.0), r"must lie in \[0,1\)"),
            (lambda x, *_: np.full((x.size, 2), np.nan), "NaN"),
            (lambda x, *_: None, "not an array of real numbers"),
        ],
    )
    def test_bad_results_are_one_sentence(self, made, words):
        with pytest.raises(McspectraError, match=words):
            points_of(FunctionScreen(function=made), 1, (4, 4, 1))


class TestTiles:
    def test_png_slices_in_the_order_of_their_numbers(self, tmp_path):
        from PIL import Image

        for t in (10, 2, 0):
            picture = np.full((4, 6, 4), 255, np.uint8)
            picture[..., 0] = t
            picture[..., 1] = np.arange(6) + 100
            Image.fromarray(picture).save(tmp_path / f"stbn_vec2_2Dx1D_6x4x3_{t}.png")
        spec = f"tiles(path='{tmp_path}/stbn_vec2_2Dx1D_6x4x3_*.png')"
        found = points_of(spec, 1, (8, 4, 4))
        np.testing.assert_allclose(found[:, 0, 0, 0, 0], (np.array([0, 2, 10, 0]) + 0.5) / 256)
        np.testing.assert_allclose(
            found[0, 0, [0, 1, 6], 0, 1], (np.array([100, 101, 100]) + 0.5) / 256
        )

    @pytest.mark.parametrize("shape", [(5, 4, 6, 2), (4, 6, 2)])
    def test_arrays_with_and_without_time(self, tmp_path, shape):
        values = np.random.default_rng(1).random(shape)
        np.save(tmp_path / "mask.npy", values)
        spec = f"tiles(path='{tmp_path}/mask.npy')"
        found = points_of(spec, 1, (6, 4, 7))[:, :, :, 0]
        whole = values if len(shape) == 4 else values[None]
        np.testing.assert_array_equal(found[6], whole[6 % len(whole)])
        golden = points_of(spec.replace(")", ", time='golden')"), 1, (6, 4, 2))[:, :, :, 0]
        step = (golden[1] - whole[1 % len(whole)]) % 1.0
        assert np.ptp(step.reshape(-1, 2), axis=0).max() < 1e-12

    def test_ranks_bytes_and_slices_as_samples(self, tmp_path):
        mask = spatiotemporal_mask(8, 4, KEYS)
        np.save(tmp_path / "ranks.npy", mask[..., None])
        (tmp_path / "mask.bin").write_bytes((mask % 256).astype(np.uint8).tobytes())
        ranks = points_of(f"tiles(path='{tmp_path}/ranks.npy')", 2, (8, 8, 2), dims=1)[..., 0]
        np.testing.assert_array_equal(ranks[1, :, :, 1], (mask[3] + 0.5) / mask.size)
        spec = f"tiles(path='{tmp_path}/mask.bin', shape=[4, 8, 8, 1])"
        codes = points_of(spec, 1, (8, 8, 1), dims=1)
        np.testing.assert_array_equal(codes[0, :, :, 0, 0], (mask[0] % 256 + 0.5) / 256)

    def test_a_mask_moves_a_shared_set(self, tmp_path):
        np.save(tmp_path / "mask.npy", np.random.default_rng(1).random((8, 8, 2)))
        spec = f"tiles(path='{tmp_path}/mask.npy', points='sobol')"
        found = points_of(spec, 4, (8, 8, 1))[0]
        shared = mcs.sampler("sobol", 2).draw(4)[0]
        move = (found - shared) % 1.0
        np.testing.assert_allclose(move - move[:, :, :1], 0.0, atol=1e-12)

    def test_a_whole_mask_is_known_exactly(self, tmp_path):
        np.save(tmp_path / "mask.npy", spatiotemporal_mask(16, 4, KEYS)[..., None])
        spec = f"tiles(path='{tmp_path}/mask.npy', name='mine')"
        whole = screen_spectrum(spec, IDENTITY, 1, block=(16, 16, 8), sigma=1.0)
        assert np.ptp(whole["filtered_ratio_ci"].values, axis=-1).max() == 0.0
        part = screen_spectrum(spec, IDENTITY, 1, block=(8, 8, 4), sigma=0.5)
        assert int(part["blocks"][0]) == 4
        assert (np.ptp(part["filtered_ratio_ci"].values, axis=-1) > 0).all()

    @pytest.mark.parametrize(
        ("write", "words"),
        [
            (lambda f: np.save(f, np.full((4, 4, 2), 1.0)), r"must lie in \[0,1\)"),
            (lambda f: np.save(f, np.full((4, 4, 2), np.nan)), "NaN"),
            (lambda f: np.save(f, np.zeros(4)), r"shape \(4,\)"),
            (lambda f: np.save(f, np.zeros((4, 4, 2), complex)), "complex128"),
            (lambda f: np.save(f, np.zeros((4, 4, 1))), "1 channel"),
            (lambda f: np.save(f, np.full((4, 4, 2), 0.5)), "equal channels"),
            (lambda f: np.save(f, -np.ones((4, 4, 2), int)), "negative ranks"),
            (lambda f: f.write_bytes(b"no array"), "cannot be read as a mask"),
            (lambda f: None, "no file"),
        ],
    )
    def test_bad_files_are_one_sentence(self, tmp_path, write, words):
        file = tmp_path / "mask.npy"
        write(file)
        with pytest.raises(McspectraError, match=words):
            as_screen_sampler(f"tiles(path='{file}')", 2)

    def test_other_errors_of_files(self, tmp_path):
        (tmp_path / "mask.bin").write_bytes(b"12345678")
        np.save(tmp_path / "mask.npy", np.random.default_rng(1).random((4, 4, 2)))
        for spec, words in (
            ("tiles(path='{}/mask.bin')", "8 bytes and no shape"),
            ("tiles(path='{}/mask.bin', shape=[1, 2, 2, 3])", "with the product 8"),
            ("tiles(path='{}/mask.bin', shape=[8])", "frames, height, width, channels"),
            ("tiles(path='{}/mask.gif')", "does not end in .png"),
            ("tiles(path='{}/no*.png')", "No file matches"),
            ("tiles(path=3)", "give the name of a file"),
        ):
            with pytest.raises(McspectraError, match=words):
                as_screen_sampler(spec.format(tmp_path), 2)
        with pytest.raises(ParameterError, match="1 frame, but n is 4; give points='sobol'"):
            screen_spectrum(f"tiles(path='{tmp_path}/mask.npy')", "gaussian", 4, block=(8, 8, 1))


def tables_file(folder, **changes):
    """Write a file in the published layout, and return it with its arrays."""
    rng, text, arrays = np.random.default_rng(5), "", {}
    for name, count in module._TABLES.items():
        arrays[name] = rng.integers(0, 256, changes.get(name, count))
        text += f"static const int {name}[{count}] = {{{','.join(map(str, arrays[name]))}}};\n\n"
    file = folder / "tables_4spp.cpp"
    file.write_text(f"// {text}", encoding="ascii")
    return file, arrays


class TestTables:
    def test_samples_follow_the_published_formula(self, tmp_path):
        file, arrays = tables_file(tmp_path)
        found = points_of(f"tables(path='{file}')", 4, (7, 5, 3), dims=3)
        for x, y, t, i, j in ((0, 0, 0, 0, 0), (6, 4, 2, 3, 2), (3, 1, 1, 2, 1)):
            pixel = x + y * 128
            ranked = (4 * t + i) ^ arrays["rankingTile"][j + pixel * 8]
            value = arrays["sobol_256spp_256d"][j + ranked * 256]
            value ^= arrays["scramblingTile"][j % 8 + pixel * 8]
            assert found[t, y, x, i, j] == (0.5 + value) / 256

    def test_bad_files_are_one_sentence(self, tmp_path):
        file, _ = tables_file(tmp_path, scramblingTile=12)
        with pytest.raises(FileFormatError, match="has 12 numbers in scramblingTile"):
            as_screen_sampler(f"tables(path='{file}')", 2)
        with pytest.raises(ParameterError, match="optimized for 8 dims"):
            as_screen_sampler(f"tables(path='{file}')", 9)


class TestBadInput:
    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"samplers": []}, "no samplers"),
            ({"samplers": ["random", "random"]}, "listed twice"),
            ({"n": 0}, "n is 0"),
            ({"block": (16, 16)}, "give width, height and number of frames"),
            ({"block": (16, 16, 0)}, "block is 0"),
            ({"block": (2, 16, 1)}, "at least 4 × 4 pixels"),
            ({"block": 16}, "width, height and number of frames"),
            ({"block": (16, 16, 8), "sigma": 2.0}, "the Gaussian reaches 8 pixels"),
            ({"sigma": -1.0}, "sigma"),
            ({"sigma": float("nan")}, "sigma"),
            ({"alpha": 0.0}, "alpha"),
            ({"alpha": 1.5}, "alpha"),
            ({"seeds": 1}, "seeds is 1"),
            ({"integrand": "constant"}, "no variance"),
            ({"integrand": "gaussain"}, "gaussian"),
            ({"samplers": "sobol | decorrelate(width=8)"}, "makes images of 8 × 8 pixels"),
            ({"n": 2**20}, "fewer points|evaluations"),
        ],
    )
    def test_one_sentence(self, changes, words):
        given = {"samplers": "random", "integrand": "gaussian", "n": 1, "block": (32, 32, 4)}
        given |= changes
        with pytest.raises(McspectraError, match=words) as caught:
            screen_spectrum(given.pop("samplers"), given.pop("integrand"), given.pop("n"), **given)
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 400

    def test_code_needs_permission(self):
        for spec in (
            "command('./other {x} {y} {frame} {n} {seed}')",
            "python('tests.rendering.test_files:main')",
        ):
            with pytest.raises(ConfigError, match="--allow-code"):
                as_screen_sampler(spec, 2)

    @pytest.mark.parametrize(
        ("places", "words"),
        [
            ("{x} {n}", "add {y}, or {height}"),
            ("{x} {width} {y} {n}", "has both {x} and {width}"),
            ("{x} {y} {k}", "{k} stands for nothing"),
        ],
    )
    def test_placeholders_are_checked(self, places, words):
        with pytest.raises(ParameterError, match=words.replace("{", r"\{").replace("}", r"\}")):
            rendering.CommandScreen(run=f"./mine {places}")


@pytest.fixture(scope="module")
def spectrum():
    masks = ["random", MASK]
    return screen_spectrum(masks, IDENTITY, 1, block=(32, 32, 32), seeds=2)


class TestCommandLine:
    ARGUMENTS = ("bench", "random", MASK, "--screen", "gaussian(width=0.3)", "--quiet")
    BLOCK = ("--block", "32,32,16", "-m", "2", "-o")

    def test_a_ranking(self, capsys, tmp_path):
        code = main([*self.ARGUMENTS, *self.BLOCK, str(tmp_path / "screen.csv")])
        text = capsys.readouterr().out
        assert code == 0
        assert "After Gaussian σ = 1.5, sobol | decorrelate" in text
        lines = (tmp_path / "screen.csv").read_text(encoding="utf-8").splitlines()
        rows = [line for line in lines if not line.startswith("#")]
        assert len(rows) == 1 + 2 * 4

    def test_a_page(self, tmp_path):
        assert main([*self.ARGUMENTS, *self.BLOCK, str(tmp_path / "out")]) == 0
        found = json.loads((tmp_path / "out" / "screen.json").read_text(encoding="utf-8"))
        assert found["best"]["gaussian"] == MASK
        assert {path.name for path in (tmp_path / "out").iterdir()} == {
            "index.html",
            "screen.csv",
            "screen.json",
        }
        # Matplotlib draws every kind of plot
        page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
        assert page.count('<img src="data:image/png;base64,') == len(SCREENS)

    @pytest.mark.parametrize("kind", SCREENS)
    def test_plots_are_written_by_bokeh(self, kind, spectrum):
        assert kinds_of(spectrum) == tuple(SCREENS)
        plot = describe(kind, spectrum)
        written_by_bokeh(plot)
        assert plot.words

    def test_short_names_of_masks(self):
        chain = "sobol | decorrelate(mask='blue-noise', time='golden', advance=True)"
        assert mask_names([chain, "random"]) == {
            chain: "sobol, blue-noise, golden, advance",
            "random": "random",
        }
