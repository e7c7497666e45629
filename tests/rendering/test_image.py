"""Images: the same numbers as single pixels, moments over realizations, crops, bad input."""

import threading
from typing import Any

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core import progress
from mcspectra.core.errors import CountError, McspectraError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.rendering import image as module
from mcspectra.rendering.image import compare_strategies, reference, render
from mcspectra.rendering.wavefront import Wavefront

pytestmark = pytest.mark.render

VEACH = "veach(width=24, height=16)"
SOBOL = "sobol | owen"  # computed in kernels: see test_kernel_sets
DRAWN = "sobol | digital-shift"


def test_every_pixel_is_the_mean_of_its_realization_of_the_sampler():
    found = render(VEACH, "mis", DRAWN, 8, rng=3)["image"]
    waves = Wavefront(VEACH, film="sampled", emission=True)
    points = mcs.sampler(DRAWN, 6).draw_stream(8, Stream.from_rng(3).child(0), 0, 24 * 16)
    reading = [(x, y) for y in range(16) for x in range(24)]
    expected = waves.means("mis", reading, points).reshape(16, 24, 3)
    np.testing.assert_array_equal(found, expected)


def test_moments_agree_with_single_images(monkeypatch):
    single: list[Any] = []
    original = Wavefront.means

    def kept(self, *given):
        single.append(original(self, *given))
        return single[-1]

    monkeypatch.setattr(Wavefront, "means", kept)
    result = render(VEACH, "light", DRAWN, 4, realizations=5, rng=1)
    images = np.concatenate([m.reshape(-1, 16, 24, 3) for m in single])
    assert len(images) == 5
    np.testing.assert_allclose(result["image"], images.mean(axis=0), rtol=1e-13)
    variance = images.var(axis=0, ddof=1)
    np.testing.assert_allclose(result["variance"], variance, rtol=1e-10, atol=1e-25)
    np.testing.assert_allclose(result["image_se"] ** 2, variance / 5, rtol=1e-10, atol=1e-25)


def test_the_first_image_equals_a_single_image():
    waves = Wavefront(VEACH, film="sampled", emission=True)
    assert waves.dims("light") == 4
    two = render(VEACH, "light", SOBOL, 4, realizations=2)
    one = render(VEACH, "light", SOBOL, 4)
    assert set(one) == {"image"}
    # (a + b)/2 and (a − b)²/2 determine a and b up to their order
    spread = np.sqrt(two["variance"].values / 2)
    np.testing.assert_allclose(
        np.abs(one["image"].values - two["image"].values), spread, rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize("lanes", [32, 8 * 24 * 3 + 5, 8 * 24 * 16 * 2])
def test_tiles_and_threads_do_not_change_the_image(monkeypatch, lanes):
    options: dict[str, Any] = {"spp": 8, "realizations": 3, "crop": (3, 2, 9, 4), "rng": 2}
    whole = render(VEACH, "bsdf", workers=1, **options)
    monkeypatch.setattr(module, "_TILE_LANES", lanes)
    tiled = render(VEACH, "bsdf", workers=3, **options)
    np.testing.assert_allclose(tiled["image"], whole["image"], rtol=1e-14)
    np.testing.assert_allclose(tiled["variance"], whole["variance"], rtol=1e-10, atol=1e-25)
    again = render(VEACH, "bsdf", workers=1, **options)
    assert again.identical(tiled)


@pytest.mark.parametrize(
    "sampler", [SOBOL, "random", "sobol | owen | decorrelate(mode='digital-shift')"]
)
def test_a_crop_is_the_same_part_of_the_whole(sampler):
    whole = render(VEACH, "light", sampler, 4, rng=9)["image"]
    crop = render(VEACH, "light", sampler, 4, rng=9, crop=(5, 3, 7, 6))["image"]
    assert crop.shape == (6, 7, 3)
    assert whole.sel(x=crop.x, y=crop.y).identical(crop.assign_attrs(whole.attrs))


def test_the_error_of_a_reference_is_the_distance_to_another():
    a = reference(VEACH, 128, batches=16, rng=1, sampler="random")
    b = reference(VEACH, 128, batches=16, rng=2, sampler="random")
    total = np.sqrt(a["image_se"] ** 2 + b["image_se"] ** 2).values
    noisy = total > 0
    z = (a["image"] - b["image"]).values[noisy] / total[noisy]
    # t distributions with 15 to 30 degrees of freedom have variance 1.07 to 1.15. Heavy tails of
    # the values correlate mean and variance, which reduces it. Neighbors' z are independent.
    assert 0.7 < z.var() < 1.3
    assert abs(z.mean()) < 4 / np.sqrt(len(z))


def test_provenance_records_the_options():
    result = render(VEACH, "mis", SOBOL, 4, realizations=2, heuristic="power", rng=7)
    told = result.attrs
    assert told["strategy"] == "mis"
    assert (told["spp"], told["realizations"], told["seed"]) == (4, 2, 7)
    assert (told["sampler"], told["heuristic"]) == (SOBOL, "power")
    assert told["scene"] == VEACH
    assert result["image"].attrs["units"] == "W/(m² sr)"
    assert result["channel"].values.tolist() == ["R", "G", "B"]


def test_strategies_are_compared_at_equal_samples():
    images = compare_strategies(VEACH, 4, reference_spp=32)
    assert list(images) == ["reference", "light", "bsdf", "mis"]
    assert [images[s].attrs["spp"] for s in ("light", "bsdf", "mis")] == [4, 4, 2]
    assert "image_se" in images["reference"]


def test_progress_ends_at_one():
    heard: list[float] = []
    thread = threading.get_ident()

    def listen(what, fraction):
        assert (what, threading.get_ident()) == ("render", thread)
        heard.append(fraction)

    with progress.listening(listen):
        render(VEACH, "light", spp=4, realizations=2)
    assert heard == sorted(heard)
    assert heard[-1] == 1.0


def test_memory_of_points_is_bounded(monkeypatch):
    monkeypatch.setattr(module, "_TILE_LANES", 2**13)
    sizes: list[int] = []
    original = Wavefront.means

    def watched(self, strategy, pixels, u):
        sizes.append(u.shape[0] * u.shape[1])
        return original(self, strategy, pixels, u)

    monkeypatch.setattr(Wavefront, "means", watched)
    render(VEACH, "light", "random", 100, realizations=3)
    assert max(sizes) <= 2**13
    assert sum(sizes) == 24 * 16 * 100 * 3


@pytest.mark.parametrize(
    "crop",
    [
        (0, 0, 25, 1),
        (24, 0, 1, 1),
        (0, 0, 0, 1),
        (-1, 0, 2, 2),
        (0, 0, 2),
        "0,0,2,2",
        5,
    ],
)
def test_invalid_crops_raise(crop):
    with pytest.raises(ParameterError, match="crop"):
        render(VEACH, crop=crop)


@pytest.mark.parametrize(
    "options",
    [
        {"spp": 0},
        {"spp": 2**40},
        {"realizations": 0},
        {"realizations": 10**12},
        {"strategy": "path"},
        {"sampler": "soboll"},
        {"sampler": 3},
        {"film": "gaussian"},
        {"light": "sun"},
        {"heuristic": "best"},
        {"rng": -1},
        {"workers": 0},
        {"scene": "kitchen"},
        {"scene": "veach(width=65536, height=65536)", "spp": 1},
    ],
)
def test_invalid_options_raise(options):
    with pytest.raises(McspectraError):
        render(**{"scene": VEACH, **options})


def test_counts_that_a_sampler_cannot_make_are_refused():
    with pytest.raises(CountError, match="jittered"):
        render(VEACH, "light", "jittered", 5)


def test_invalid_references_and_comparisons_raise():
    with pytest.raises(ParameterError, match="multiple of batches"):
        reference(VEACH, 100, batches=16)
    with pytest.raises(ParameterError, match="batches"):
        reference(VEACH, batches=1)
    with pytest.raises(ParameterError, match="even"):
        compare_strategies(VEACH, 5)
