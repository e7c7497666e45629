"""Frames of any renderer: known noise is measured, and problems of frames are reported."""

import json
import shutil
import socket
import threading
from contextlib import contextmanager

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from tests.plots.drawing import written_by_bokeh
from tests.report.drawing import no_pdf
from tests.report.figures import leave_out_figures

from mcspectra import rendering
from mcspectra.cli.main import main
from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.core.images import read_image
from mcspectra.estimators.moments import Moments
from mcspectra.plots.kinds import PLOT_KINDS, describe, kinds_of
from mcspectra.rendering import frame_files, write_exr, write_png
from mcspectra.rendering.frame_statistics import _variance_of_variance
from mcspectra.report.frames_page import frame_findings

HEIGHT, WIDTH = 96, 128
TRUTH = np.exp(np.linspace(-2.0, 1.0, WIDTH)) * np.ones((HEIGHT, 1))
SIGMA = 0.3  # relative standard deviation of one sample


def white(rng):
    return rng.standard_normal((HEIGHT, WIDTH))


def blue(rng):
    noise = white(rng)
    return noise - gaussian_filter(noise, 1.5, mode="wrap")


def filtered(rng):
    return gaussian_filter(white(rng), 1.0, mode="wrap")


def tiled(rng):
    return np.tile(rng.standard_normal((32, 32)), (3, 4))


def write(folder, noise=white, *, counts=(16, 64), frames=8, seed=1, change=lambda k, image: image):
    """Write frames of known variance TRUTH²·SIGMA²/n as .npy, and return their names."""
    rng = np.random.default_rng(seed)
    folder.mkdir(exist_ok=True)
    for n in counts:
        for k in range(frames):
            error = noise(rng)
            image = TRUTH * (1 + error / error.std() * SIGMA / np.sqrt(n))
            np.save(folder / f"view_{n}spp_{k}.npy", change(k, image).astype(np.float32))
    return folder


@contextmanager
def monkeyed_header(samples):
    """EXR headers with a number of samples per pixel, as in pbrt."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(frame_files, "exr_attributes", lambda _: {"samplesPerPixel": samples})
        yield


def frames(paths, **options):
    """Without FLIP, which takes more time than the rest: 11.8 of 20 s at 1920 × 1080."""
    return rendering.frames(paths, **({"flip": False} | options))


def said(result):
    return " ".join(frame_findings(result))


NOISES = (white, blue, filtered, tiled)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A folder of frames for each type of noise, by name."""
    folder = tmp_path_factory.mktemp("plain")
    return {noise.__name__: write(folder / noise.__name__, noise) for noise in NOISES}


@pytest.fixture(scope="module")
def found(plain):
    """The measured results of each folder."""
    return {name: frames(folder, target=0.05) for name, folder in plain.items()}


@pytest.mark.parametrize("noise", [noise.__name__ for noise in NOISES])
def test_variances_and_rates_agree_with_the_frames(found, noise):
    result = found[noise]
    assert result["n"].values.tolist() == [16, 64]
    truth = SIGMA**2 * TRUTH**2
    for n in (16, 64):
        low, high = result["picture_variance_ci"].sel(n=n).values
        assert low < truth.mean() / n < high
        assert high / low < 1.2
    low, high = result["picture_rate_ci"].values
    assert low < -1.0 < high
    assert high - low < 0.3

    # Intervals of pixels cover: at least 900 of 12,288 correlated pixels are independent
    for name, value in (("variance_ci", truth / 16), ("rate_ci", -1.0)):
        ends = result[name].sel(n=16) if "n" in result[name].dims else result[name]
        covered = ((ends[..., 0] < value) & (ends[..., 1] > value)).values.mean()
        assert covered > (0.9 if name == "variance_ci" else 0.88)
    # σ / mean is 0.3/√n at every pixel: 36 samples reach 0.05
    assert abs(float(np.log(result["needed_spp"].median() / 36))) < 0.25


def test_frames_of_few_and_of_many_together_have_no_bias_of_the_rate(tmp_path):
    """The mean of log s² is 1.27 below log σ² for two values, and 0.07 for sixteen."""
    folder = write(tmp_path / "a", counts=(4,), frames=16)
    write(folder, counts=(64,), frames=2, seed=2)
    rate = frames(folder)["rate"].values
    # Standard deviations of log s²: √ψ'(½) = 2.22 for two values, √ψ'(7.5) = 0.38 for sixteen
    error = np.hypot(2.22, 0.38) / np.log(64 / 4) / np.sqrt(rate.size)
    assert abs(rate.mean() + 1.0) < 4 * error


def test_blue_noise_filters_and_tiles_are_distinguished(found):
    assert "white between pixels" in said(found["white"])
    assert "Blue noise" in said(found["blue"])
    assert "Errors of neighboring pixels are correlated" in said(found["filtered"])
    assert "repeats after 32 pixels horizontally and 0 vertically" in said(found["tiled"])
    assert not any("repeats" in said(found[name]) for name in ("white", "blue", "filtered"))


@pytest.mark.parametrize("count", [2, 3, 8])
def test_correlations_and_spectra_have_no_bias(tmp_path, count):
    """Also holds for few frames: the mean of signs of two frames is 0.57 for correlation 0.78."""
    result = frames(write(tmp_path / "a", filtered, counts=(4,), frames=count))
    # A Gaussian filter of 1 pixel: neighbors have correlation exp(−1/4); the squares sum to 2π
    beside = result["error_correlation"].sel(n=4, lag_y=0, lag_x=1).item()
    independent = HEIGHT * WIDTH * (count - 1) / (2 * np.pi)
    assert abs(beside - np.exp(-0.25)) < 4 * (1 - np.exp(-0.5)) / np.sqrt(independent)
    # Power 4π exp(−4π²|ν|²) by radial frequency, at the centers of rings
    radius, power = result["radius"].values, result["error_spectrum"].values[0]
    wanted = 4 * np.pi * np.exp(-4 * np.pi**2 * radius**2)
    rings = 2 * np.pi * radius * (radius[1] - radius[0]) * HEIGHT * WIDTH / 2
    error = wanted * np.sqrt(2 * np.pi / rings / (count - 1))
    some = slice(4, 14)
    assert (np.abs(power - wanted)[some] < 4.5 * error[some]).all()


def test_frames_of_one_seed_are_named(tmp_path, found):
    folder = write(tmp_path / "a")
    shutil.copy(folder / "view_64spp_2.npy", folder / "view_64spp_5.npy")
    result = frames(folder)
    text = said(result)
    assert "view_64spp_2.npy" in text
    assert "view_64spp_5.npy have correlation" in text
    assert "have correlation 1.00" in text
    assert "Give every frame its own seed" not in said(found["white"])


def test_fireflies_are_reported_and_leave_no_upper_bound(tmp_path, plain, found):
    rng = np.random.default_rng(5)

    def burn(k, image):
        return image + 20.0 * (rng.random(image.shape) < 2e-4)

    text = said(frames(write(tmp_path / "a", change=burn)))
    assert "Fireflies: at" in text
    assert "Fireflies" not in said(found["white"])
    single = frames(
        write(
            tmp_path / "c",
            change=lambda k, i: (
                i + (k == 3) * 500.0 * (TRUTH.max() == TRUTH) * (np.arange(HEIGHT) == 7)[:, None]
            ),
        )
    )
    assert np.isinf(single["picture_variance_ci"].values[:, 1]).all()
    assert "no upper bound" in said(single)
    assert np.isinf(frames(tmp_path / "c", against=plain["white"])["picture_ratio_ci"][1])
    assert frames(plain["white"], against=tmp_path / "c")["picture_ratio_ci"][0] == 0.0


def test_pixels_that_are_not_finite_are_counted_and_excluded(tmp_path):
    def spoil(k, image):
        image[3, 4] = np.nan if k == 2 else image[3, 4]
        image[5, 6] = np.inf if k == 1 else image[5, 6]
        return image

    result = frames(write(tmp_path / "a", change=spoil))
    assert np.isnan(result["variance"].values[:, [3, 5], [4, 6]]).all()
    assert np.isfinite(result["variance"].values).sum() == 2 * (HEIGHT * WIDTH - 2)
    assert "Pixels excluded because a frame is NaN or infinite there: 2." in said(result)


def test_two_sets_are_compared(tmp_path, plain):
    a, b = plain["white"], write(tmp_path / "b", seed=9)
    halved = write(
        tmp_path / "c", seed=3, change=lambda k, image: TRUTH + (image - TRUTH) * np.sqrt(2)
    )
    same = frames(a, against=b, seconds=2.0, seconds_against=1.0)
    low, high = same["picture_ratio_ci"].values
    assert low < 1.0 < high
    assert float(same["equal_time_ratio"]) == pytest.approx(2.0 * float(same["picture_ratio"]))
    assert "No difference is found" in said(same)
    # Deviates of equal sets are standard normal: 12,288 of them
    z = same["difference_z"].values
    assert abs(z.std() - 1.0) < 4 / np.sqrt(2 * z.size)
    low, high = frames(a, against=halved)["picture_ratio_ci"].values
    assert low < 0.5 < high

    def brighten(k, image):
        image[:, 60:64] += 0.6 * TRUTH[:, 60:64]
        return image

    text = said(frames(a, against=write(tmp_path / "d", change=brighten, seed=4)))
    assert "do not converge to one image: 384 of 12288 pixels" in text


def test_pixels_that_are_not_finite_in_one_set_are_excluded_from_both(tmp_path):
    """The brightest and noisiest columns have a NaN in one frame of one set."""

    def holed(k, image):
        return np.where((k == 0) & (np.arange(WIDTH) > 100), np.nan, image)

    ours = write(tmp_path / "a", counts=(16,), change=holed)
    result = frames(ours, against=write(tmp_path / "b", counts=(16,), seed=2))
    low, high = result["picture_ratio_ci"].values
    assert low < 1.0 < high
    assert high / low < 1.2
    assert abs(result.attrs["mean_difference_z"]) < 4
    assert result.attrs["compared_pixels"] == HEIGHT * 101
    assert result.attrs["biased_pixels"] == 0


def test_two_equal_values_of_a_pixel_do_not_prove_equality(tmp_path):
    """Pixels of two values: a quarter do not vary between two frames, and half of these differ."""

    def coins(seed, folder):
        rng = np.random.default_rng(seed)
        folder.mkdir()
        for k in range(2):
            np.save(folder / f"{k}.npy", rng.integers(0, 2, (HEIGHT, WIDTH)).astype(np.float32))
        return folder

    result = frames(coins(1, tmp_path / "a"), against=coins(2, tmp_path / "b"))
    assert result.attrs["biased_pixels"] == 0
    assert not result.attrs["identical"]


@pytest.mark.parametrize("count", [2, 4])
def test_relative_errors_of_few_frames_have_the_right_median(tmp_path, count):
    result = frames(write(tmp_path / "a", counts=(16,), frames=count), target=SIGMA / 4)
    sigma = result["relative_rmse"].values / (SIGMA / 4)
    # Half of the pixels, to five standard errors
    assert abs((sigma < 1.0).mean() - 0.5) < 5 * 0.5 / np.sqrt(sigma.size)


def test_earlier_output_files_are_not_frames(tmp_path, monkeypatch):
    leave_out_figures(monkeypatch.setattr)
    folder = tmp_path / "a"
    folder.mkdir()
    for k, image in enumerate(np.random.default_rng(1).random((3, 8, 8))):
        np.save(folder / f"{k}.npy", image)
    shown = []
    for _ in range(2):
        assert (
            main(["frames", str(folder), "--out", str(folder / "out"), "--no-flip", "--quiet"]) == 0
        )
        shown.append(json.loads((folder / "out" / "frames.json").read_text())["frame_count"])
    assert shown == [[3], [3]]


def test_the_smallest_period_is_reported(tmp_path):
    def small_tiles(rng):
        return np.tile(rng.standard_normal((8, 8)), (12, 16))

    assert "repeats after 8 pixels horizontally and 0 vertically" in said(
        frames(write(tmp_path / "a", small_tiles))
    )


@pytest.mark.parametrize("shape", [(1, 40), (40, 1), (1, 1), (2, 2)])
def test_frames_of_few_pixels_are_described_in_words(tmp_path, shape, capsys):
    rng = np.random.default_rng(1)
    for k in range(2):
        np.save(tmp_path / f"{k}.npy", -1.0 - rng.random(shape))
    assert main(["frames", str(tmp_path), "--target", "0.1", "--no-flip"]) == 0
    shown = capsys.readouterr()
    assert "cannot decide whether the noise is white" in shown.out
    assert shown.err == ""
    assert "cannot decide" in frames(tmp_path, flip=False).mcspectra.summary()


def test_names_and_headers_that_disagree_are_refused(tmp_path):
    for k in range(2):
        write_exr(tmp_path / f"{k}_64spp.exr", {"": np.full((4, 4), 1.0 + k)}, comment="")
    with monkeyed_header(16), pytest.raises(ParameterError, match="64 .*in its name and 16"):
        frames(tmp_path)


def test_samples_and_times_come_from_headers_and_folders(tmp_path):
    import OpenEXR

    rng = np.random.default_rng(0)
    for k in range(2):
        pixels = rng.random((8, 8, 3)).astype(np.float32)
        pbrt = {"samplesPerPixel": 32, "renderTimeSeconds": 1.5}
        blender = {"cycles.ViewLayer.samples": "128", "RenderTime": "01:02.50"}
        for folder, header in (("pbrt", pbrt), ("blender", blender)):
            (tmp_path / folder).mkdir(exist_ok=True)
            full = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
            channels = {f"ViewLayer.{c}": pixels[..., i].copy() for i, c in enumerate("RGB")}
            OpenEXR.File(full, channels).write(str(tmp_path / folder / f"{k}.exr"))
        (tmp_path / "plain/spp_4").mkdir(parents=True, exist_ok=True)
        write_exr(tmp_path / f"plain/spp_4/{k}.exr", {"": pixels})
    found = {name: frames(tmp_path / name) for name in ("pbrt", "blender", "plain")}
    assert [found[name]["n"].item() for name in found] == [32, 128, 4]
    assert found["pbrt"].attrs["seconds"] == "[1.5]"
    assert found["blender"].attrs["seconds"] == "[62.5]"
    assert [found[name].attrs.get("layer") for name in found] == ["ViewLayer", "ViewLayer", None]
    assert frames(tmp_path / "blender", layer="ViewLayer.G")["mean"].shape == (1, 8, 8)


def test_portable_float_maps(tmp_path):
    values = np.random.default_rng(2).random((3, 5, 7, 3)).astype("<f4")
    for k, frame in enumerate(values[:2]):
        header = b"PF\n7 5\n-1.0\n"
        (tmp_path / f"{k}.pfm").write_bytes(header + frame[::-1].tobytes())
    (tmp_path / "2.pfm").write_bytes(b"PF\n7 5\n1.0\n" + values[2][::-1].astype(">f4").tobytes())
    image = frames(tmp_path)["image"].values
    np.testing.assert_allclose(image, values.astype(float).mean(axis=0), rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "error", "match"),
    [
        (lambda p: None, FileFormatError, "holds no .exr"),
        (lambda p: np.save(p / "a.npy", np.ones((4, 4))), ParameterError, ("one frame, "
            ".*a.npy; give two")),
        (lambda p: [np.save(p / f"{k}.npy", np.ones((4, 4))) for k in "ab"], ParameterError,
         "the same to the last bit"),
        (lambda p: [np.save(p / f"{k}.npy", np.full((4, 4), np.nan)) for k in "ab"], ParameterError,
         "a.npy has no finite pixel"),
        (lambda p: [np.save(p / f"{k}.npy", np.eye(k)) for k in (3, 4)], ParameterError, ("of "
            "one view")),
        (lambda p: [write_png(p / f"{k}.png", np.eye(4) / k) for k in (1, 2)], FileFormatError,
         "tone-mapped"),
        (lambda p: [np.save(p / f"{k}.npy", np.eye(4)) for k in ("a_4spp", "b")], ParameterError,
         "has no number of samples"),
        (lambda p: [np.save(p / f"{k}_0spp.npy", np.eye(4) * k) for k in (1, 2)], ParameterError,
         "has 0 samples"),
        (lambda p: [(p / f"{k}.exr").write_bytes(b"no picture") for k in "ab"], FileFormatError,
         "cannot be read"),
        (lambda p: [(p / f"{k}.pfm").write_bytes(b"PF\n99 99\n-1\nxx") for k in "ab"],
         FileFormatError, "truncated"),
    ],
)  # fmt: skip
def test_invalid_frames_are_rejected(tmp_path, make, error, match):
    make(tmp_path)
    with pytest.raises(error, match=match):
        frames(tmp_path)


def test_one_number_of_samples_is_not_given_to_frames_of_several(tmp_path):
    for k, spp in enumerate((4, 4, 16, 16)):
        np.save(tmp_path / f"{k}_{spp}spp.npy", np.eye(4) * (k + 1))
    with pytest.raises(ParameterError, match="spp is 8, but the frames have 4 and 16 samples"):
        frames(tmp_path, spp=8)
    assert frames(str(tmp_path / "*_4spp.npy"), spp=8)["n"] == 8


@pytest.mark.parametrize(
    "options",
    [{"spp": 0}, {"target": 0.0}, {"target": np.nan}, {"seconds": -1.0}, {"layer": "none"}],
)
def test_options_out_of_range_are_refused(tmp_path, options):
    rng = np.random.default_rng(0)
    for k in range(2):
        write_exr(tmp_path / f"{k}.exr", {"": rng.random((8, 8, 3))})
    with pytest.raises((ParameterError, FileFormatError)):
        frames(tmp_path, **options)


@pytest.mark.parametrize("paths", [3, [], [3], "nowhere/*.exr", "nowhere", None])
def test_invalid_paths_of_frames_are_rejected(paths):
    with pytest.raises((ParameterError, FileFormatError)):
        frames(paths)


def test_tone_mapped_pictures_on_request(tmp_path):
    rng = np.random.default_rng(0)
    for k in range(2):
        write_png(tmp_path / f"{k}.png", rng.random((8, 8, 3)))
    assert frames(tmp_path, tone_mapped=True)["variance"].shape == (1, 8, 8)


def test_page_layers_json_and_plots(tmp_path, capsys, plain, found):
    folder, out, other = plain["white"], tmp_path / "out", write(tmp_path / "b", seed=3)
    truth = tmp_path / "truth.npy"
    np.save(truth, TRUTH)
    arguments = ["frames", str(folder), "--against", str(other), "--reference", str(truth)]
    with no_pdf():
        assert main([*arguments, "--target", "0.05", "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "white between pixels" in text
    result = frames(folder, against=other, target=0.05, flip=True, reference=truth)
    over_time = {f"frames-{kind}" for kind in ("average", "effective", "errors", "joint", "time")}
    kinds = [kind for kind in PLOT_KINDS if kind.startswith("frames-") and kind not in over_time]
    if "flip" not in result:
        kinds.remove("frames-flip")
    assert set(kinds) <= set(kinds_of(result))
    assert "convergence" not in kinds_of(result)
    # The page has a picture of each kind by Matplotlib
    pictures = {f"{kind.replace('-', '_')}.png" for kind in kinds}
    assert {file.name for file in out.iterdir()} >= {"frames.exr", "frames_rate.png", *pictures}
    for kind in kinds:
        written_by_bokeh(describe(kind, result))
    told = json.loads((out / "frames.json").read_text())
    assert all(sentence in text for sentence in told["findings"])
    assert "No difference is found" in (out / "report.html").read_text()
    layer = read_image(out / "frames.exr", layer="variance.n16")[..., 0]
    np.testing.assert_allclose(layer, found["white"]["variance"].sel(n=16), rtol=1e-6)


def test_flip_is_skipped_on_request(plain, found, capsys):
    assert "flip" not in found["white"]
    assert main(["frames", str(plain["white"]), "--no-flip"]) == 0
    assert "FLIP" not in capsys.readouterr().out


def test_layers_reach_tev(plain, capsys):
    """A listener in the role of tev receives every layer with its name."""
    pytest.importorskip("tevclient")
    received = bytearray()
    server = socket.create_server(("127.0.0.1", 0))

    def listen():
        connection, _ = server.accept()
        with connection:
            while data := connection.recv(2**16):
                received.extend(data)

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    port = server.getsockname()[1]
    arguments = ["frames", str(plain["white"]), "--no-flip", "--tev"]
    assert main([*arguments, f"127.0.0.1:{port}"]) == 0
    thread.join(10)
    server.close()
    for name in (b"mcspectra mean", b"mcspectra variance.n16", b"mcspectra rate"):
        assert name in received
    assert main([*arguments, f"127.0.0.1:{port}"]) == 2
    assert "No tev answers at" in capsys.readouterr().err
    assert main([*arguments, "tev"]) == 2


def test_samples_for_most_pixels_do_not_grow_with_the_number_of_frames(tmp_path):
    """Of 24 frames the unshrunk rates gave 3.6 times as many samples as of 8 frames."""
    target, spread = 0.02, 0.6
    rng = np.random.default_rng(8)
    relative = SIGMA * np.exp(spread * rng.standard_normal((HEIGHT, WIDTH)))
    wanted = np.percentile((relative / target) ** 2, 95)
    found = {}
    for count in (8, 24):
        folder = tmp_path / f"{count}"
        folder.mkdir()
        for n in (16, 64):
            for k in range(count):
                image = TRUTH * (1 + relative / np.sqrt(n) * white(rng))
                np.save(folder / f"view_{n}spp_{k}.npy", image.astype(np.float32))
        found[count] = frames(folder, target=target).attrs["needed_95"] / wanted
    # The 95 % point of 12,288 pixels has an error of 3 %; the rate of the image has one of 3 %,
    # extrapolated by a factor of 20
    assert found == {8: pytest.approx(1.0, rel=0.15), 24: pytest.approx(1.0, rel=0.15)}


def test_a_variance_that_grows_is_reported_and_not_extrapolated(tmp_path):
    folder = write(tmp_path / "a", counts=(16,), change=lambda k, i: TRUTH + (i - TRUTH) / 4)
    write(folder, counts=(64,), seed=2, change=lambda k, i: TRUTH + (i - TRUTH) * 4)
    result = frames(folder, target=0.01)
    assert "grows with the number of samples" in frame_findings(result)[0]
    assert "needed_spp" not in result
    assert "half of the pixels need" not in said(result)


def test_frames_that_drift_are_named_and_not_called_a_filter(tmp_path, found):
    folder = write(tmp_path / "a", change=lambda k, image: image * 1.05**k)
    result = frames(folder)
    first = frame_findings(result)[0]
    assert "The frames drift: their image means change by +" in first
    # A line through eight means 1.05^k has the slope 0.0487 of their mean
    assert json.loads(result.attrs["drift"])[1] == pytest.approx(0.0487, abs=1e-3)
    assert "Errors of neighboring pixels are correlated" not in said(result)
    assert all("drift" not in said(found[noise.__name__]) for noise in NOISES)


def test_frames_that_flicker_are_named(tmp_path):
    gain = np.random.default_rng(4).permutation(np.linspace(0.5, 1.5, 16))
    result = frames(write(tmp_path / "a", change=lambda k, image: image * gain[k]))
    assert "differ mainly in brightness" in frame_findings(result)[0]
    assert "Errors of neighboring pixels are correlated" not in said(result)


def test_low_frequencies_are_weighted_by_their_number(tmp_path):
    """Power ν² of blue noise: the mean of ν² below ⅛ is ½·⅛² by area, and ⅓·⅛² by radius."""

    def square(rng):
        y, x = np.fft.fftfreq(HEIGHT)[:, None], np.fft.rfftfreq(WIDTH)
        return np.fft.irfft2(np.fft.rfft2(white(rng)) * np.hypot(y, x), s=(HEIGHT, WIDTH))

    text = said(frames(write(tmp_path / "a", square, counts=(4,), frames=24)))
    told = float(text.partition("the errors have ")[2].partition(" ")[0])
    whole = np.mean(np.fft.fftfreq(HEIGHT)[:, None] ** 2 + np.fft.fftfreq(WIDTH) ** 2)
    # Below ⅛ there are 603 pairs of frequencies in 23 independent frames
    assert told == pytest.approx(0.125**2 / 2 / whole, rel=4 / np.sqrt(603 * 23))


def test_two_sets_of_the_same_seeds_are_compared_as_pairs(tmp_path, plain):
    """A gain of 0.3 % is far below the noise of a mean, but not below that of a difference."""
    same = write(tmp_path / "b", change=lambda k, image: 1.003 * image)
    result = frames(plain["white"], against=same)
    text = said(result)
    assert "8 frames of" in text
    assert "correlation 1.00" in text
    assert "do not converge to one image" in text
    assert result.attrs["pairs"] == 8
    low, high = result["picture_ratio_ci"].values
    assert low < 1.003**-2 < high
    assert high / low < 1.01
    other = frames(plain["white"], against=write(tmp_path / "c", seed=5))
    assert other.attrs["pairs"] == 0


def test_sets_of_unequal_samples_are_scaled_by_the_measured_rate(tmp_path, plain):
    more = write(tmp_path / "b", counts=(256,), seed=6)
    result = frames(plain["white"], against=more)
    low, high = result["picture_ratio_ci"].values
    assert low < 1.0 < high
    assert "scaled by the measured rate −" in said(result)
    single = frames(write(tmp_path / "c", counts=(16,)), against=more)
    assert float(single["picture_ratio"]) == pytest.approx(1.0, rel=0.1)
    assert "scaled by the assumed rate −1" in said(single)


def test_the_largest_effect_is_the_first_finding(tmp_path):
    rng = np.random.default_rng(5)

    def burn(size):
        return lambda k, image: image + size * (rng.random(image.shape) < 2e-4)

    strong = frames(write(tmp_path / "a", filtered, counts=(16,), change=burn(20.0)))
    weak = frames(write(tmp_path / "b", filtered, counts=(16,), change=burn(3.0)))
    assert frame_findings(strong)[0].startswith("Fireflies")
    assert frame_findings(weak)[0].startswith("Errors of neighboring pixels are correlated")
    assert any(each.startswith("Fireflies") for each in frame_findings(weak)[1:])


@pytest.mark.parametrize("count", [2, 3, 4, 6])
def test_the_error_of_a_variance_has_no_bias_for_skewed_noise(count):
    """Exponential noise has k₄ = 6, so that Var(s²) = 6/R + 2/(R − 1)."""
    values = np.random.default_rng(count).standard_exponential((count, 400, 400))
    estimate = _variance_of_variance(Moments.of(values)).mean()
    truth = 6 / count + 2 / (count - 1)
    # The standard deviation of one estimate is about 12 times the truth
    assert abs(estimate / truth - 1.0) < 4 * 12 / 400


def test_intervals_of_the_mean_variance_of_heavy_tailed_noise(tmp_path):
    """For 6 frames of Student's t with 5 degrees, 94 % of 1,000 intervals cover."""
    covered = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        (tmp_path / f"{seed}").mkdir()
        for k in range(6):
            np.save(tmp_path / f"{seed}" / f"{k}.npy", 9.0 + rng.standard_t(5, (32, 32)))
        low, high = frames(tmp_path / f"{seed}")["picture_variance_ci"].values[0]
        covered += low < 5 / 3 < high
    assert covered >= 25  # 28.2 are expected; fewer than 25 have a probability below 2 %
