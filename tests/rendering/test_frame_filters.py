"""Error after filters, and sequences in time: predictions agree with frames that are filtered."""

import json
import shlex
import shutil
import sys

import numpy as np
import pytest
from scipy.ndimage import convolve1d, gaussian_filter
from tests.plots.drawing import drawn_by_both

from mcspectra import rendering
from mcspectra.cli.main import main
from mcspectra.core.errors import FileFormatError, McspectraError, ParameterError
from mcspectra.plots.kinds import describe
from mcspectra.rendering.frame_filters import FILTERS, chains_of
from mcspectra.report.frames_page import frame_findings, write_frames

SHAPE = (48, 64)


def autoregressive(rng, rho, times, noise):
    """Return errors with the correlation ρ^k at a lag of k frames, in equilibrium."""
    errors = [noise(rng)]
    for _ in range(times - 1):
        errors.append(rho * errors[-1] + np.sqrt(1 - rho**2) * noise(rng))
    return errors


def white(rng):
    return rng.standard_normal(SHAPE)


def blue(rng):
    noise = rng.standard_normal(SHAPE)
    return noise - gaussian_filter(noise, 1.5, mode="wrap")


def correlated(rng):
    wide = rng.standard_normal([size + 16 for size in SHAPE])
    return 2 * np.sqrt(np.pi) * gaussian_filter(wide, 1.0)[8:-8, 8:-8]


def write(folder, *, rho=0.0, times=16, seeds=4, noise=white, seed=1, moving=True, size=1.0):
    """Write sequences of a moving gradient with errors of known correlation."""
    rng = np.random.default_rng(seed)
    folder.mkdir()
    across = np.arange(SHAPE[1]) / SHAPE[1]
    for s in range(seeds):
        for t, error in enumerate(autoregressive(rng, rho, times, noise)):
            mean = 5.0 + np.sin(2 * np.pi * (across - moving * t / 7)) * np.ones(SHAPE)
            np.save(folder / f"shot_s{s}_t{t:03d}.npy", (mean + size * error).astype(np.float32))
    return folder


def frames(paths, **options):
    return rendering.frames(paths, **({"flip": False} | options))


def wanted(rho, alpha):
    """Return what an average over frames leaves of AR(1) noise, relative to white noise."""
    q = rho * (1 - alpha)
    return (1 + q) / (1 - q)


def test_the_oracle_of_averages_over_frames():
    assert [wanted(rho, 0.1) for rho in (0.5, 0.9, 0.97)] == pytest.approx(
        [2.64, 9.53, 14.75], abs=5e-3
    )


@pytest.mark.parametrize(
    "rho", [0.0, *(pytest.param(rho, marks=pytest.mark.slow) for rho in (0.5, 0.9)), 0.97]
)
def test_averages_over_frames_of_autoregressive_noise(tmp_path, rho):
    times = 48
    result = frames(write(tmp_path / "a", rho=rho, times=times), filters="ema(alpha=0.1)")
    n, chain = result["n"].values[0], "ema(alpha=0.1)"
    ratio = result["filtered_ratio"].sel(n=n, filter=chain).item()
    low, high = result["filtered_ratio_ci"].sel(n=n, filter=chain).values
    assert low < wanted(rho, 0.1) < high
    assert high / low < 1.3
    assert ratio == pytest.approx(wanted(rho, 0.1), rel=0.1)

    # Correlations, and the effective number of frames 1 + 2 Σ (1 − k/T) ρ^k
    lags = np.arange(times)
    ends = result["frame_correlation_ci"].sel(n=n).values
    inside = (ends[:, 0] <= rho**lags) & (rho**lags <= ends[:, 1])
    assert inside.mean() > 0.8  # neighboring lags are not independent
    truth = times / (1 + 2 * ((1 - lags[1:] / times) * rho ** lags[1:]).sum())
    low, high = result["effective_frames_ci"].sel(n=n).values
    assert low < truth < high
    pixels = result["pixel_effective_frames"].sel(n=n).values
    assert np.median(pixels) == pytest.approx(truth, rel=0.2)

    # Power below ⅛ cycle per frame, and white noise at every frequency for ρ = 0
    joint = result["joint_spectrum"].sel(n=n).values
    low, high = result["boiling_ci"].sel(n=n).values
    if rho == 0.0:
        assert low < 1.0 < high
        assert abs(joint[5:, 1:].mean() - 1.0) < 0.05
    else:
        assert low > 1.5
        assert joint[5:, 0].mean() > 3 * joint[5:, -1].mean()


FILTERED = {
    "gaussian(sigma=1.5)": lambda image: gaussian_filter(image, 1.5, mode="nearest"),
    "box(width=5)": lambda image: both(image, np.full(5, 0.2)),
    "a-trous(levels=2)": lambda image: both(
        both(image, np.array([1, 4, 6, 4, 1]) / 16), np.array([1, 0, 4, 0, 6, 0, 4, 0, 1]) / 16
    ),
}


def both(image, weights):
    down = convolve1d(image, weights, axis=0, mode="nearest")
    return convolve1d(down, weights, axis=1, mode="nearest")


@pytest.mark.parametrize(
    "noise", [*(pytest.param(each, marks=pytest.mark.slow) for each in (white, blue)), correlated]
)
def test_root_mean_squares_after_filters_agree_with_frames_held_back(tmp_path, noise):
    """Intervals contain the error of other frames, which is within 5 % of the predicted RMSE."""
    kinds = [*FILTERED, "gaussian(sigma=1.5) | ema(alpha=0.3)"]
    folder = write(tmp_path / "a", noise=noise, times=12, seeds=6, rho=0.6, moving=False)
    result = frames(folder, filters=kinds)
    rng = np.random.default_rng(77)
    held = {kind: [] for kind in kinds}
    for _ in range(100):  # their mean square has an error of about 1 %
        errors = autoregressive(rng, 0.6, 14, noise)
        for kind, apply in FILTERED.items():
            held[kind].append((apply(errors[-1]) ** 2).mean())
        average = errors[0]
        for error in errors[1:]:
            average = 0.7 * average + 0.3 * error
        held[kinds[-1]].append((FILTERED["gaussian(sigma=1.5)"](average) ** 2).mean())
    for kind in kinds:
        real = np.mean(held[kind])
        left = result["filtered_variance"].sel(filter=kind).item()
        low, high = result["filtered_variance_ci"].sel(filter=kind).values[0]
        assert np.sqrt(left / real) == pytest.approx(1.0, abs=0.05)
        assert low / 1.05 < real < high * 1.05


def test_independent_frames_are_filtered_in_space(tmp_path):
    rng = np.random.default_rng(5)
    for k in range(8):
        np.save(tmp_path / f"{k}.npy", 5 + white(rng))
    result = frames(tmp_path, filters=["box(width=3)", "gaussian(sigma=1.0)"])
    for kind, left in (("box(width=3)", 1 / 9), ("gaussian(sigma=1.0)", 1 / 4 / np.pi)):
        low, high = result["filtered_variance_ci"].sel(filter=kind).values[0]
        assert low < left < high
        assert high / low < 1.3
    with pytest.raises(McspectraError, match="gaussian needs sigma"):
        frames(tmp_path, filters="gaussian")


def test_two_frames_give_an_interval(tmp_path):
    """Two deviations are one another's negative and have no spread: normal noise bounds them."""
    held = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        folder = tmp_path / f"{seed}"
        folder.mkdir()
        for k in range(2):
            np.save(folder / f"{k}.npy", 5 + white(rng))
        low, high = frames(folder, filters="box(width=3)")["filtered_variance_ci"].values[0, 0]
        held.append(low < 1 / 9 < high)
    assert sum(held) >= 9


@pytest.mark.slow
def test_two_sequences_give_intervals(tmp_path):
    held = []
    for seed in range(16):
        folder = write(tmp_path / f"{seed}", rho=0.7, times=12, seeds=2, seed=seed)
        result = frames(folder, filters="ema(alpha=0.5)")
        lags = np.arange(1, 12)
        truth = 12 / (1 + 2 * ((1 - lags / 12) * 0.7**lags).sum())
        ends = (result["effective_frames_ci"].values[0], result["filtered_ratio_ci"].values[0, 0])
        held += [
            low < value < high
            for (low, high), value in zip(ends, (truth, wanted(0.7, 0.5)), strict=True)
        ]
    assert sum(held) >= 26  # of 32, with a probability of at least 0.93 each


def test_a_sampler_that_is_worse_per_pixel_is_better_after_a_filter(tmp_path):
    """Blue noise of 1.3 times the variance."""
    ours, others = tmp_path / "blue", tmp_path / "white"
    for folder, noise, size in ((ours, blue, 1.18), (others, white, 1.0)):
        rng = np.random.default_rng(len(folder.name))
        folder.mkdir()
        for k in range(6):
            np.save(folder / f"{k}.npy", 5 + size * noise(rng))
    text = " ".join(frame_findings(frames(ours, against=others, filters="gaussian(sigma=1.5)")))
    assert "after gaussian(sigma=1.5)" in text
    assert "worse per pixel" in text
    assert "times better after" in text


@pytest.mark.parametrize(
    "spec", ["a-trous(levels=3)", "box(width=4)", "ema(alpha=0.2)", "gaussian(sigma=2.0)"]
)
def test_transfer_functions_are_those_of_the_weights(spec):
    assert spec.partition("(")[0] in FILTERS
    found = chains_of(spec)[0].filters[0]
    assert found.spec == spec
    weights = found.weights()
    assert weights.sum() == pytest.approx(1.0)
    assert found.transfer(np.zeros(1)).item() == pytest.approx(1.0)
    # Parseval: the mean of |K|² over the frequencies is the sum of the squared weights
    frequency = np.arange(4 * weights.size) / (4 * weights.size)
    assert found.transfer(frequency).mean() == pytest.approx((weights**2).sum())


def test_a_chain_is_a_product():
    chain = chains_of("gaussian(sigma=1) | box(width=3) | ema(alpha=0.5)")[0]
    assert chain.temporal
    assert chain.space.size == 9 + 3 - 1
    memory, beyond = chain.memory(3)
    np.testing.assert_allclose(memory, 1 / 3 * 0.5 ** np.arange(3), rtol=1e-5)
    assert memory[0] + 2 * memory[1:].sum() + beyond == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"filters": 3}, ParameterError, "filters is 3; give specs"),
        ({"filters": "blur"}, McspectraError, "no filter called 'blur'"),
        ({"filters": "gaussian(sigma=nan)"}, McspectraError, "sigma"),
        ({"filters": "gaussian(sigma=-1)"}, McspectraError, "sigma"),
        ({"filters": "gaussian(sigma=50)"}, ParameterError, "give a narrower filter"),
        ({"sequence": "shot"}, ParameterError, "sequence is 'shot'; give names with"),
        ({"sequence": "x_{seed}_{frame}.npy"}, FileFormatError, "does not match the sequence"),
    ],
)
def test_invalid_filters_and_sequences_are_refused(tmp_path, options, error, match):
    folder = write(tmp_path / "a", times=2, seeds=2)
    with pytest.raises(error, match=match):
        frames(folder, **options)


def independent(folder, count=12, noise=white, gain=1.0, seed=9):
    """Write independent frames of 5 with the variance 1."""
    rng = np.random.default_rng(seed)
    folder.mkdir()
    for k in range(count):
        np.save(folder / f"{k}.npy", 5.0 * gain + noise(rng))
    return folder


# Without NumPy, whose import takes longer than the work of a program
HALVE = (
    "import sys; from array import array; data = open(sys.argv[1], 'rb').read(); "
    "start = 10 + int.from_bytes(data[8:10], 'little'); "
    "values = array('f' if b'<f4' in data[:start] else 'd', data[start:]); "
    "values = array(values.typecode, (5.5 + (value - 5) / 2 for value in values)); "
    "open(sys.argv[2], 'wb').write(data[:start] + values.tobytes())"
)


def command(code, *words):
    return shlex.join([sys.executable, "-c", code, "{input}", "{output}", *words])


@pytest.mark.parametrize("exact", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_programs_are_measured(tmp_path, exact):
    """The program leaves a quarter of the variance 1 and adds a bias of ½."""
    np.save(tmp_path / "truth.npy", np.full(SHAPE, 5.0))
    result = frames(
        independent(tmp_path / "a", count=3),
        filter_command=command(HALVE),
        reference=tmp_path / "truth.npy" if exact else None,
    )
    low, high = result["denoised_variance_ci"].values
    assert low < 0.25 < high
    assert high - low < 0.1
    low, high = result["denoised_square_ci"].values
    assert low < 0.25 < high
    assert high - low < 0.2
    assert "After the command the variance is 0.2" in " ".join(frame_findings(result))


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ("denoise {input}", "give a program with {input} and {output}"),
        ("denoise '{input} {output}", "quotes closed"),
        ("no-such-program {input} {output}", "cannot be run: No such file"),
        (command("raise ValueError('too dark')"), "exit code 1 .*too dark"),
        (command("pass"), "wrote no file"),
        ("denoise {inputs} {output}", "with the folders {inputs} and {outputs}"),
        (command("import time; time.sleep(9)"), "took more than 0.2 s"),
    ],
)
def test_programs_that_fail_are_reported(tmp_path, given, match):
    with pytest.raises(ParameterError, match=match):
        frames(
            independent(tmp_path / "a", count=2),
            filter_command=given,
            filter_timeout=0.2 if "sleep" in given else 30.0,
        )


def test_errors_against_a_reference(tmp_path):
    """A region of 12 × 16 pixels is brighter by 2 %; relMSE is 1 / 25 without it."""
    truth = np.full(SHAPE, 5.0)
    np.save(tmp_path / "truth.npy", truth)
    folder = independent(tmp_path / "a")
    result = frames(folder, reference=str(tmp_path / "truth.npy"))
    assert result["image_relmse"].item() == pytest.approx(1 / 25.01, rel=0.02)
    # The mean of |x| is √(2/π), over about 2 · 5 + 0.01
    assert result["image_smape"].item() == pytest.approx(np.sqrt(2 / np.pi) / 10, rel=0.05)
    assert "No bias against the reference is significant" in " ".join(frame_findings(result))
    assert result.attrs["reference_biased_pixels"] == 0
    low, high = result["image_bias_ci"].values[0]
    assert low < 0.0 < high

    truth[12:24, 16:32] *= 0.96
    np.save(tmp_path / "truth.npy", truth)
    result = frames(folder, reference=tmp_path / "truth.npy")
    tiles = result["tile_bias"].isel(n=0)
    place = np.unravel_index(np.argmax(tiles.values), tiles.shape)
    assert 12 <= tiles["tile_y"].values[place[0]] < 24
    assert 16 <= tiles["tile_x"].values[place[1]] < 32
    low, high = result["tile_bias_ci"].isel(n=0).values[place]
    assert low < 0.04 / 0.96 < high
    assert "tile with the largest bias" in " ".join(frame_findings(result))
    np.save(tmp_path / "small.npy", truth[:3])
    with pytest.raises(ParameterError, match="reference of the same view"):
        frames(folder, reference=tmp_path / "small.npy")


def truths(folder, times, gain=1.0):
    """Write the true image of each frame of the sequences of `write`."""
    folder.mkdir()
    across = np.arange(SHAPE[1]) / SHAPE[1]
    for t in range(times):
        mean = 5.0 + np.sin(2 * np.pi * (across - t / 7)) * np.ones(SHAPE)
        np.save(folder / f"true_{t:03d}.npy", mean * (gain if t == 2 else 1.0))
    return f"{folder}/true_{{frame}}.npy"


def test_sequences_against_references_of_each_frame(tmp_path):
    """One reference is darker by 9 %, which is the bias of one frame."""
    folder = write(tmp_path / "a", times=6, seeds=4)
    result = frames(folder, reference=truths(tmp_path / "t", 6))
    assert result["frame"].values.tolist() == list(range(6))
    low, high = result["image_bias_ci"].values[0]
    assert low < 0.0 < high
    assert result["image_relmse"].item() == pytest.approx(5 / 24**1.5, rel=0.03)
    # The square of a mean of 4 values, minus its variance, has the variance 2 / (4 · 3)
    error = np.sqrt(2 / 12 / result["bias_z"].size / 6)
    assert abs(result["squared_bias"].item()) < 4 * error
    assert abs(result["bias_z"].values.std() - 1.0) < 0.05
    assert "No bias against the reference is significant" in " ".join(frame_findings(result))

    result = frames(folder, reference=truths(tmp_path / "w", 6, gain=1 / 1.1))
    biases = result["frame_bias"].values[0]
    assert np.argmax(biases) == 2
    low, high = result["frame_bias_ci"].values[0, 2]
    assert low < 0.1 < high
    assert result["squared_bias"].item() == pytest.approx(
        25.5 * (0.1 / 1.1) ** 2 / 6, abs=4 * error
    )
    assert "of the frames, " in " ".join(frame_findings(result))
    plot = describe("frames-errors", result)
    assert "Bias of 6 frames" in plot.words


def test_one_reference_of_a_still_sequence(tmp_path):
    folder = write(tmp_path / "a", times=4, moving=False)
    across = np.arange(SHAPE[1]) / SHAPE[1]
    np.save(tmp_path / "truth.npy", 5.0 + np.sin(2 * np.pi * across) * np.ones(SHAPE))
    result = frames(folder, reference=tmp_path / "truth.npy")
    assert result["frame_bias"].shape == (1, 4)
    assert result.attrs["reference_biased_pixels"] == 0


@pytest.mark.parametrize(
    ("name", "error", "match"),
    [
        ("true_{frame}.npy", FileFormatError, "There is no reference"),
        ("t/true_{frame}.npy", ParameterError, "Frame 3 of the sequences has no reference"),
        ("t/{frame}_{frame}.npy", ParameterError, "a name with one {frame}"),
    ],
)
def test_references_of_sequences_are_checked(tmp_path, name, error, match):
    folder = write(tmp_path / "a", times=4, seeds=2)
    truths(tmp_path / "t", 3)
    with pytest.raises(error, match=match):
        frames(folder, reference=f"{tmp_path}/{name}")
    with pytest.raises(ParameterError, match="these are frames of one view; give one file"):
        frames(independent(tmp_path / "b", count=2), reference=f"{tmp_path}/{name}"[-16:])


def test_programs_filter_frames_of_sequences(tmp_path):
    """The program leaves a quarter of the variance and adds a bias of ½ at every frame."""
    result = frames(
        write(tmp_path / "a", times=2, seeds=3, moving=False), filter_command=command(HALVE)
    )
    low, high = result["denoised_variance_ci"].values
    assert low < 0.25 < high
    assert high - low < 0.1
    # The bias is 0.5 − (truth − 5) / 2
    low, high = result["denoised_square_ci"].values
    assert low < 0.25 + 0.125 < high
    low, high = result["denoised_boiling_ci"].values
    assert low < 1.0 < high


ACCUMULATE = (
    "import sys, numpy as np; from pathlib import Path; old = None\n"
    "for file in sorted(Path(sys.argv[1]).iterdir()):\n"
    "    image = np.load(file)\n"
    "    old = image if old is None else 0.5 * old + 0.5 * image\n"
    "    np.save(Path(sys.argv[2]) / file.name, old)"
)


def test_programs_filter_whole_sequences(tmp_path):
    """An average over frames leaves α / (2 − α) = ⅓ of white noise, and makes it boil."""
    times, seeds = 16, 3
    folder = write(tmp_path / "a", times=times, seeds=seeds, moving=False)
    given = shlex.join([sys.executable, "-c", ACCUMULATE, "{inputs}", "{outputs}"])
    result = frames(folder, filter_command=given)
    # The variance of frame t is ⅓ + ⅔ / 4^t
    wanted_variance = 1 / 3 + 2 / 3 * (1 - 0.25**times) / (1 - 0.25) / times
    low, high = result["denoised_variance_ci"].values
    assert low < wanted_variance < high
    assert high / low < 1.2
    assert result["denoised_square"].item() == pytest.approx(0.0, abs=0.02)
    assert result["denoised_boiling_ci"].values[0] > 1.5
    assert result["denoised_correlation"].sel(lag_t=1).item() == pytest.approx(0.5, abs=0.1)
    assert "After the command the noise boils" in " ".join(frame_findings(result))
    with pytest.raises(ParameterError, match="are not sequences; give {input} and {output}"):
        frames(independent(tmp_path / "b", count=2), filter_command=given)


GIVEN = ("gaussian(sigma=1.0) | ema(alpha=0.5)", "box(width=3)")


def test_options_of_the_command_line(tmp_path, capsys):
    folder = write(tmp_path / "a", times=4, seeds=3, rho=0.8)
    arguments = ["frames", str(folder), "--filter", GIVEN[0], "--filter", GIVEN[1], "--no-flip"]
    assert main([*arguments, "--sequence", "s{seed}_t{frame}.npy"]) == 2
    assert "does not match the sequence" in capsys.readouterr().err
    assert main([*arguments, "--sequence", "shot_s{seed}_t{frame}.npy", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert tuple(row["filter"] for row in told["filtered"]) == GIVEN
    assert any("The noise boils" in each for each in told["findings"])
    assert main(["frames", str(folder), "--filter", "gauss(sigma=1)"]) == 2
    assert "There is no filter called 'gauss'" in capsys.readouterr().err


@pytest.mark.slow
def test_page_and_figures(tmp_path):
    folder = write(tmp_path / "a", times=8, seeds=3, rho=0.8)
    other = write(tmp_path / "b", times=8, seeds=3, seed=2)
    result = frames(folder, against=other, filters=GIVEN)
    out = write_frames(result, tmp_path / "out").parent
    assert "The noise boils" in (out / "report.html").read_text()
    assert (out / "frames_joint.png").exists()
    for kind in ("filter", "average", "joint", "time", "effective"):
        drawn_by_both(describe(f"frames-{kind}", result))


@pytest.mark.parametrize("kind", ["filter", "average", "joint", "time"])
def test_plots_are_described(tmp_path, kind):
    folder = write(tmp_path / "a", times=8, seeds=3, rho=0.8)
    plot = describe(f"frames-{kind}", frames(folder))
    assert plot.panels[0].marks
    assert "nan" not in plot.words


def test_sequences_must_be_complete(tmp_path):
    folder = write(tmp_path / "a", times=3, seeds=2)
    (folder / "shot_s1_t001.npy").unlink()
    with pytest.raises(ParameterError, match="seed 1 has no frame 1"):
        frames(folder)
    for file in folder.glob("shot_s1*"):
        file.unlink()
    with pytest.raises(ParameterError, match="There is 1 sequence of 3 frames"):
        frames(folder, sequence="shot_s{seed}_t{frame}.npy")


def test_filters_over_frames_need_sequences(tmp_path):
    rng = np.random.default_rng(5)
    for k in range(3):
        np.save(tmp_path / f"{k}.npy", white(rng))
    with pytest.raises(ParameterError, match=r"ema.* acts over frames"):
        frames(tmp_path, filters="ema(alpha=0.2)")


def test_patterns_of_names_are_given(tmp_path):
    folder = write(tmp_path / "a", times=3, seeds=2)
    for file in folder.iterdir():
        _, seed, frame = file.stem.split("_")
        (folder / seed).mkdir(exist_ok=True)
        file.rename(folder / seed / f"{frame}.npy")
    result = frames(folder, sequence="s{seed}/t{frame}.npy")
    assert (result.attrs["sequences"], result.attrs["times"]) == ("[2]", 3)
    assert frames(folder, sequence="s{seed}/t*{frame}.npy").attrs["times"] == 3


def test_sequences_of_one_seed_are_named(tmp_path):
    folder = write(tmp_path / "a", times=3, seeds=3)
    for t in range(3):
        shutil.copy(folder / f"shot_s1_t{t:03d}.npy", folder / f"shot_s2_t{t:03d}.npy")
    assert frame_findings(frames(folder))[0].startswith("Give every frame its own seed")


def test_noise_that_alternates_cancels_over_time(tmp_path):
    rng = np.random.default_rng(3)
    for s in range(3):
        error = white(rng)
        for t in range(8):
            np.save(tmp_path / f"a_s{s}_t{t}.npy", 5 + (-1) ** t * error)
    assert "The noise cancels over time" in " ".join(frame_findings(frames(tmp_path)))


def test_a_scene_that_moves_is_not_noise(tmp_path):
    """The variance of the gradient over time is half, and that of the noise is 0.01."""
    result = frames(write(tmp_path / "a", size=0.1))
    low, high = result["picture_variance_ci"].values[0]
    assert low < 0.01 < high
    assert high / low < 1.1


def test_sets_of_sequences_are_compared(tmp_path):
    a = write(tmp_path / "a", rho=0.9)
    b = write(tmp_path / "b", rho=0.9, seed=2)
    result = frames(a, against=b)
    assert abs(result.attrs["mean_difference_z"]) < 4
    assert result.attrs["biased_pixels"] == 0
    z = result["difference_z"].values
    assert abs(z.std() - 1.0) < 0.1
    assert result.attrs["pairs"] == 0
    same = write(tmp_path / "c", rho=0.9, size=1.1)
    assert frames(a, against=same).attrs["pairs"] == 4
