"""The gate: errors are found, clean pairs pass at the level, and what is unknown stays open."""

import json
import re
import shutil

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.stats import binom
from tests.plots.drawing import written_by_bokeh

from mcspectra import rendering
from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.plots.kinds import describe, kinds_of
from mcspectra.rendering import gate, write_png, write_reference
from mcspectra.rendering.gate_relabelings import relabelled
from mcspectra.rendering.gate_t_tests import cautious
from mcspectra.rendering.gate_tests import (
    Contrast,
    levels_of,
    relabelling_count,
)
from mcspectra.report.gate_page import gate_findings

SIZE = 32
TRUTH = np.exp(np.linspace(-2.0, 1.0, SIZE)) * np.ones((SIZE, 1))


def frames(rng, count, *, spikes=2e-3, sigma=0.2):
    """Return frames with skewed noise of mean zero: rare bright pixels above normal noise."""
    shape = (count, SIZE, SIZE)
    rare = (rng.random(shape) < spikes) * rng.exponential(5.0, shape)
    return TRUTH * (1 + sigma * rng.standard_normal(shape) + rare - 5.0 * spikes)


def write(folder, images, spp=16, first=0):
    folder.mkdir(exist_ok=True)
    for k, image in enumerate(images):
        name = "" if spp is None else f"_{spp}spp"
        np.save(folder / f"view{name}_{first + k:02}.npy", image.astype(np.float32))
    return folder


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """Two folders of eight clean frames each, and the frames of the first one."""
    rng, folder = np.random.default_rng(1), tmp_path_factory.mktemp("clean")
    images = frames(rng, 8)
    return write(folder / "a", images), write(folder / "b", frames(rng, 8)), images


def said(result):
    return " ".join(gate_findings(result))


def failed(result):
    """Names of the failed tests without their sizes."""
    names = result["test"].values[result["test_p"].values <= result.attrs["level"]]
    return {str(name).split()[0] for name in names}


def outcome(images, first, level, *, paired=False, alike=True, rng=0):
    """Run the tests on arrays."""
    rows = images.astype(np.float32)
    channels = rows.mean(axis=(1, 2), dtype=np.float64)[:, None]
    levels = levels_of(rows, np.zeros(rows.shape[1:], bool), 1, channels)
    contrast = Contrast(first=first, second=len(images) - first, paired=paired)
    if not alike or relabelling_count(contrast) * level < 1:
        return cautious(levels, contrast, level, alike=alike, noise=alike)
    weights = contrast.relabelings(100, np.random.default_rng(rng))
    return relabelled(levels, contrast, weights, level)


CLEAN = {
    "exact": ((5, 5), 0.05, True),
    "unbalanced": ((3, 6), 0.05, True),
    "single": ((1, 20), 0.05, True),
    "t tests": ((3, 3), 0.01, True),
    "one against eight": ((1, 8), 0.01, True),
    "unequal": ((6, 6), 0.01, False),
}


def alarms(name, pairs):
    (first, second), level, alike = CLEAN[name]
    rng = np.random.default_rng(7)
    p = [
        outcome(frames(rng, first + second), first, level, alike=alike, rng=k).p
        for k in range(pairs)
    ]
    return sum(value <= level for value in p), level


# The others differ in their numbers of frames alone; below, all have a thousand pairs
@pytest.mark.parametrize("name", ["exact", "single", "t tests", "unequal"])
def test_clean_pairs_alarm_at_most_at_the_level(name):
    count, level = alarms(name, 30)
    # The bound is exceeded with probability below 1e-4 if alarms have the level
    assert count <= binom.ppf(1 - 1e-4, 30, level)


@pytest.mark.slow
@pytest.mark.parametrize("name", CLEAN)
def test_clean_pairs_alarm_at_most_at_the_level_in_a_thousand_pairs(name):
    count, level = alarms(name, 1000)
    assert count <= binom.ppf(1 - 1e-4, 1000, level)


def test_clean_frames_pass_with_the_bias_that_would_be_found(clean):
    result = gate(clean[0], clean[1])
    assert result.attrs["verdict"] == "pass"
    assert result.attrs["method"] == "relabeling"
    assert result.attrs["p"] > 0.01
    text = said(result)
    assert text.startswith("Pass: no difference is significant")
    assert "It would have found a bias of" in text
    assert "in a region of 1 % of the image" in text
    assert "samples per pixel in both sets" in text
    assert float(result["p_share"].sum()) == pytest.approx(1.0)
    # p-values of single pixels are uniform: each of 20 bars has 51 ± 7 of 1024 pixels
    assert np.abs(result["p_share"].values - 0.05).max() < 5 * 7 / 1024


def test_the_stated_bias_is_found_with_90_percent(tmp_path, clean):
    """Of 30 pairs with the stated bias, at least 21 fail (probability 0.997 at 90 %)."""
    stated = gate(clean[0], clean[1], level=0.05).attrs["detectable_image"]
    rng = np.random.default_rng(3)
    found = 0
    for k in range(30):
        images = frames(rng, 16)
        images[:8] *= 1 + stated
        found += outcome(images, 8, 0.05, rng=k).p <= 0.05
    assert found >= 21


def blurred(images, rng):
    return gaussian_filter(images, (0, 1.0, 1.0))


def dark_corner(images, rng):
    images[:, 8:16, 16:24] *= 0.5
    return images


def noisier(images, rng):
    return TRUTH + (images - TRUTH) * 1.3


def texture(images, rng):
    """Change every pixel by ± 15 %; all means over tiles remain."""
    sign = np.where(np.add.outer(np.arange(SIZE), np.arange(SIZE)) % 2, 1.15, 0.85)
    return images * sign


@pytest.mark.parametrize(
    ("change", "test", "words"),
    [
        (lambda images, rng: images * 0.9, "image", "the image mean is"),
        (dark_corner, "tiles", "% lower than the reference"),
        (noisier, "noise", "the new frames are noisier"),
        (blurred, "filter", "more correlated"),
        (texture, "spread", "many pixels"),
    ],
)
def test_errors_are_found_and_named(tmp_path, clean, change, test, words):
    rng = np.random.default_rng(4)
    result = gate(write(tmp_path / "new", change(frames(rng, 8), rng)), clean[1])
    assert result.attrs["verdict"] == "fail"
    assert test in failed(result)
    assert words in said(result)


def test_the_place_of_an_error_is_named(tmp_path, clean):
    images = dark_corner(frames(np.random.default_rng(4), 8), None)
    result = gate(write(tmp_path / "new", images), clean[1])
    smallest = result["smallest_p"].values
    assert (smallest[8:16, 16:24] <= 0.01).any()
    assert smallest[24:, :8].min() > 0.01


def test_less_noise_passes_by_t_tests(tmp_path):
    rng = np.random.default_rng(5)
    plain, quiet = (frames(rng, 8, spikes=0.0) for _ in range(2))
    reference = write(tmp_path / "reference", plain)
    result = gate(write(tmp_path / "new", TRUTH + (quiet - TRUTH) * 0.5), reference)
    assert result.attrs["verdict"] == "pass"
    assert result.attrs["method"] == "t tests, unequal noise"
    # Two variances of 7 · 1024 degrees of freedom: the ratio has a relative error of 2.4 %
    assert result.attrs["noise_ratio"] == pytest.approx(0.25, rel=5 * 0.024)
    assert "The variance of the new frames is 0.2" in said(result)


def test_one_frame_against_a_reference_with_many(tmp_path):
    rng = np.random.default_rng(6)
    many = write(tmp_path / "many", frames(rng, 24))
    one = write(tmp_path / "one", frames(rng, 1))
    result = gate(one, many, level=0.05)
    assert result.attrs["verdict"] == "pass"
    assert result.attrs["relabelings"] == 25
    wrong = gate(write(tmp_path / "wrong", 0.7 * frames(rng, 1)), many)
    assert wrong.attrs["verdict"] == "fail"
    assert wrong.attrs["method"] == "t tests"


def test_one_frame_of_each_is_undecided(tmp_path):
    rng = np.random.default_rng(6)
    folders = [write(tmp_path / name, frames(rng, 1)) for name in "ab"]
    result = gate(*folders)
    assert result.attrs["verdict"] == "undecided"
    assert "p" not in result.attrs
    assert said(result).startswith("Undecided: the noise is not known")
    assert "give at least 2 + 2" in said(result)
    # The reference of one frame has its own number of samples
    mixed = gate(write(tmp_path / "c", frames(rng, 4), spp=64), folders[1])
    assert "give two or more frames of each" in said(mixed)


def test_a_target_that_would_be_missed_is_undecided(clean):
    result = gate(clean[0], clean[1], target=1e-4)
    assert result.attrs["verdict"] == "undecided"
    assert "0.010 % is wanted" in said(result)
    assert "needs" in said(result)
    assert gate(clean[0], clean[1], target=0.5).attrs["verdict"] == "pass"


def test_copies_are_named(tmp_path, clean):
    same = gate(clean[0], clean[0])
    assert same.attrs["verdict"] == "pass"
    assert "copies or used the same seeds" in said(same)
    files = sorted(str(file) for file in clean[0].glob("*.npy"))
    assert gate(files[::-1], clean[0]).attrs["copy"] == 1
    # The frames that are not copies are tested
    rng = np.random.default_rng(20)
    mixed = write(tmp_path / "mixed", [*clean[2][:4], *0.7 * frames(rng, 4)])
    part = gate(mixed, clean[0])
    assert part.attrs["verdict"] == "fail"
    assert part.attrs["frames_new"] == 4
    assert "4 of 8 new frames are copies" in said(part)
    # A difference of rounding is no difference
    near = gate(write(tmp_path / "near", clean[2] * (1 + 2e-7)), clean[0])
    assert near.attrs["copy"] == 1


def test_frames_of_the_same_seeds_are_compared_as_pairs(tmp_path, clean):
    """A bias of 0.2 % is far below the noise, but not below the noise of the differences."""
    rng = np.random.default_rng(8)
    # Every second new frame changes a little for other reasons than its seed
    images = clean[2] * (1 + 0.01 * rng.standard_normal(clean[2].shape))
    assert gate(write(tmp_path / "clean", images), clean[0]).attrs["verdict"] == "pass"
    result = gate(write(tmp_path / "new", images[::-1] * 1.002), clean[0])
    assert result.attrs["verdict"] == "fail"
    assert result.attrs["method"] == "sign flips of pairs"
    assert "8 frames of the two sets have the same seeds" in said(result)


def test_seeds_used_twice_are_left_out(tmp_path, clean):
    rng = np.random.default_rng(9)
    folder = write(tmp_path / "new", frames(rng, 8))
    shutil.copy(folder / "view_16spp_02.npy", folder / "view_16spp_05.npy")
    shutil.copy(clean[1] / "view_16spp_03.npy", folder / "view_16spp_06.npy")
    result = gate(folder, clean[1])
    assert (result.attrs["frames_new"], result.attrs["frames_reference"]) == (6, 8)
    assert "view_16spp_05.npy; give every frame its own seed" in said(result)
    assert "1 of 7 new frames are copies of reference frames" in said(result)
    # The same seed with another result
    shared = np.load(clean[1] / "view_16spp_03.npy")
    changed = shared * (1 + 0.02 * rng.standard_normal(shared.shape))
    np.save(folder / "view_16spp_06.npy", changed.astype(np.float32))
    result = gate(folder, clean[1])
    assert (result.attrs["frames_new"], result.attrs["frames_reference"]) == (7, 7)
    assert "1 frames of the reference have seeds of new frames" in said(result)


def test_a_stored_reference_gives_the_same_verdicts(tmp_path, clean):
    pytest.importorskip("OpenEXR")
    rng = np.random.default_rng(10)
    images = frames(rng, 20)
    file = write_reference(write(tmp_path / "many", images), tmp_path / "reference.exr")
    good = gate(clean[0], file)
    assert good.attrs["verdict"] == "pass"
    assert (good.attrs["frames_reference"], good.attrs["spp_reference"]) == (20, 16)
    assert good.attrs["finest"] == 4
    from_frames = gate(clean[0], tmp_path / "many")
    for name in ("tiles 8", "image"):
        one, other = (each["test_statistic"].sel(test=name) for each in (good, from_frames))
        assert float(one) == pytest.approx(float(other), rel=1e-3)
    wrong = gate(write(tmp_path / "wrong", 0.93 * frames(rng, 8)), file)
    assert wrong.attrs["verdict"] == "fail"
    # The layers are the mean and the variance of one frame
    mean = rendering.frames(tmp_path / "many", flip=False)
    from mcspectra.core.images import read_image

    assert np.allclose(read_image(file)[..., 0], mean["mean"][0], rtol=1e-5)
    assert np.allclose(
        read_image(file, layer="variance")[..., 0], mean["variance"][0], rtol=1e-4, atol=1e-9
    )
    # Frames with the seeds of stored frames are recognized
    again = gate(write(tmp_path / "again", images[:8] * 1.003), file)
    assert again.attrs["paired"] == 1
    assert again.attrs["verdict"] == "fail"


def test_the_mean_must_not_depend_on_the_samples(tmp_path, clean):
    """An error of accumulation: the mean falls from 4 to 16 samples."""
    rng = np.random.default_rng(11)
    folder = write(tmp_path / "new", frames(rng, 8))
    write(folder, 1.15 * frames(rng, 8), spp=4)
    result = gate(folder, clean[1])
    assert result.attrs["verdict"] == "fail"
    assert "at 4 samples per pixel the image mean is" in said(result)
    write(folder, frames(rng, 8), spp=4)
    assert gate(folder, clean[1]).attrs["verdict"] == "pass"


def test_unequal_samples_per_pixel_compare_means_only(tmp_path, clean):
    rng = np.random.default_rng(12)
    fine = write(tmp_path / "fine", frames(rng, 8, sigma=0.05, spikes=1e-4), spp=256)
    result = gate(clean[0], fine)
    assert result.attrs["verdict"] == "pass"
    assert "noise is not compared" in said(result)
    wrong = gate(write(tmp_path / "wrong", 0.9 * frames(rng, 8)), fine)
    assert wrong.attrs["verdict"] == "fail"


def test_pixels_that_are_not_finite_are_excluded_and_counted(tmp_path, clean):
    images = frames(np.random.default_rng(13), 8)
    images[2, 3, 4], images[5, 6, 7] = np.nan, np.inf
    result = gate(write(tmp_path / "new", images), clean[1])
    assert result.attrs["verdict"] == "pass"
    assert result.attrs["excluded"] == 2
    assert "2 in the new frames, 0 in the reference" in said(result)


def test_noise_free_regions_of_other_brightness_are_found(tmp_path, clean):
    def lit(images, value):
        images[:, :4, :4] = value
        return images

    rng = np.random.default_rng(14)
    a = write(tmp_path / "a", lit(frames(rng, 8), 2.0))
    b = write(tmp_path / "b", lit(frames(rng, 8), 2.01))
    assert gate(a, b).attrs["verdict"] == "fail"
    c = write(tmp_path / "c", lit(frames(rng, 8), 2.0 + 1e-6))
    assert gate(a, c).attrs["verdict"] == "pass"


def test_swapped_colors_are_found(tmp_path):
    rng = np.random.default_rng(15)
    weights = np.array([1.0, 0.8, 0.5])
    for name, tint in (("a", weights), ("b", weights), ("c", weights[::-1])):
        images = frames(rng, 8)[..., None] * tint
        write(tmp_path / name, images / (tint @ np.array([0.2126, 0.7152, 0.0722])))
    assert gate(tmp_path / "a", tmp_path / "b").attrs["verdict"] == "pass"
    assert gate(tmp_path / "c", tmp_path / "b").attrs["verdict"] == "fail"


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_the_unit_of_radiance_is_free(tmp_path, scale):
    rng = np.random.default_rng(16)
    a, b, c = (frames(rng, 6) for _ in range(3))
    first = write(tmp_path / "a", scale * a)
    good = gate(first, write(tmp_path / "b", scale * b))
    assert good.attrs["verdict"] == "pass"
    other = gate(write(tmp_path / "c", a), write(tmp_path / "d", b))
    assert np.allclose(good["test_p"], other["test_p"], atol=0.03)
    assert gate(first, write(tmp_path / "e", 0.8 * scale * c)).attrs["verdict"] == "fail"


@pytest.mark.parametrize("level", [0.0, 1.0, 1e-5, float("nan"), "a"])
def test_levels_outside_the_unit_interval_are_refused(clean, level):
    with pytest.raises(ParameterError, match="level"):
        gate(clean[0], clean[1], level=level)


def test_bad_files_are_refused(tmp_path, clean):
    other = write(tmp_path / "other", frames(np.random.default_rng(1), 4)[:, :16])
    with pytest.raises(ParameterError, match="frames of one view"):
        gate(other, clean[1])
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileFormatError, match="folder of frames"):
        gate(tmp_path / "empty", clean[1])
    with pytest.raises(FileFormatError, match="There is no"):
        gate(tmp_path / "missing", clean[1])
    png = tmp_path / "png"
    png.mkdir()
    for k in range(2):
        write_png(png / f"v_{k}.png", np.zeros((SIZE, SIZE)) + k / 4)
    with pytest.raises(FileFormatError, match="tone-mapped"):
        gate(png, clean[1])
    shots = tmp_path / "shots"
    shots.mkdir()
    for seed in range(2):
        for time in range(2):
            np.save(shots / f"shot_s{seed}_t{time}.npy", np.ones((SIZE, SIZE)))
    with pytest.raises(ParameterError, match="frames of one time"):
        gate(shots, clean[1])
    nothing = write(tmp_path / "nothing", np.full((2, SIZE, SIZE), np.nan))
    with pytest.raises(ParameterError, match="no finite pixel"):
        gate(nothing, clean[1])


def test_plots_of_a_gate(clean):
    result = gate(clean[0], clean[1])
    kinds = [kind for kind in kinds_of(result) if kind.startswith("gate-")]
    assert kinds == ["gate-p", "gate-difference", "gate-histogram", "gate-single"]
    for kind in kinds:  # `tests/cli/test_gate.py` has a page, which Matplotlib draws
        written_by_bokeh(describe(kind, result))
    json.dumps(result.attrs)


def test_the_named_tile_lies_in_the_changed_region(clean, tmp_path):
    """Rows 8 to 19 and columns 4 to 11 are half as bright; the named tile is mostly inside."""
    _, reference, _ = clean
    images = frames(np.random.default_rng(9), 8)
    images[:, 8:20, 4:12] -= 0.5 * TRUTH[8:20, 4:12]
    text = gate_findings(rendering.gate(write(tmp_path / "new", images), reference))[0]
    assert text.startswith("Fail: in the tile")
    left, right, top, bottom = map(int, re.findall(r"\d+", text)[:4])
    change = float(re.search(r"is ([\d.]+) % lower", text)[1])
    inside = max(0, min(right, 11) - max(left, 4) + 1) * max(0, min(bottom, 19) - max(top, 8) + 1)
    assert inside >= 0.5 * (right - left + 1) * (bottom - top + 1)
    assert 30 < change < 70
