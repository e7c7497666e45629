"""Many pixels at once compared with one pixel at a time, and invalid requests."""

from pathlib import Path

import numpy as np
import pytest

from mcspectra.core.errors import DomainError, FileFormatError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.rendering import Pixel, wavefront
from mcspectra.rendering.wavefront import WAVEFRONT_STRATEGIES, Wavefront

pytestmark = pytest.mark.render

VEACH = "veach(width=96, height=64)"
PIXELS = np.array([[71, 12], [75, 53], [47, 25], [10, 60]])
STRATEGIES = ("light", "bsdf", "mis-light", "mis-bsdf")


def uniforms(*shape, seed=1):
    return Stream.from_rng(seed).uniforms(0, 1, int(np.prod(shape))).reshape(shape)


def all_pixels():
    """All pixels of the films of 40 × 30 pixels."""
    return np.stack(np.meshgrid(np.arange(40), np.arange(30)), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize(
    ("light", "heuristic", "dims"),
    [(None, "balance", 3), (None, "power", 2), ("light-3", "balance", 2)],
)
@pytest.mark.parametrize("strategy", STRATEGIES)
def test_values_agree_with_each_pixel_alone(strategy, dims, heuristic, light):
    u = uniforms(len(PIXELS), 32, dims)
    found = Wavefront(VEACH, light, heuristic=heuristic).values(strategy, PIXELS, u)
    assert found.dtype == np.float32
    for (x, y), samples, values in zip(PIXELS, u, found, strict=True):
        pixel = Pixel(
            scene=VEACH,
            x=int(x),
            y=int(y),
            strategy=strategy,
            light=light,
            heuristic=heuristic,
            channel="rgb",
            dims=dims,
        )
        np.testing.assert_array_equal(values, pixel(samples))


@pytest.mark.parametrize("film", ["center", "sampled"])
def test_mis_is_the_sum_of_its_shares_each_with_its_own_columns(film):
    both = Wavefront(VEACH, film=film)
    place = 2 if film == "sampled" else 0
    u = uniforms(len(PIXELS), 16, both.dims("mis"))
    light = both.values("mis-light", PIXELS, u[..., : place + 2])
    bsdf = both.values("mis-bsdf", PIXELS, np.delete(u, [place, place + 1], axis=-1))
    np.testing.assert_allclose(both.values("mis", PIXELS, u), light + bsdf, rtol=1e-6)


@pytest.mark.parametrize("strategy", WAVEFRONT_STRATEGIES)
def test_sampled_position_in_the_middle_is_the_center(strategy):
    center, sampled = Wavefront(VEACH), Wavefront(VEACH, film="sampled")
    u = uniforms(len(PIXELS), 16, center.dims(strategy))
    middle = np.concatenate([np.full((len(PIXELS), 16, 2), 0.5), u], axis=-1)
    np.testing.assert_array_equal(
        sampled.values(strategy, PIXELS, middle), center.values(strategy, PIXELS, u)
    )


def test_sampled_positions_agree_with_a_larger_film():
    # The center of pixel (x, y) of a film three times as large is a position in pixel (x/3, y/3).
    large, small = Wavefront("veach(width=288, height=192)"), Wavefront(VEACH, film="sampled")
    u = uniforms(9, 8, 2)
    inside = np.stack(np.meshgrid(np.arange(3), np.arange(3)), axis=-1).reshape(-1, 2)
    expected = large.values("light", 3 * PIXELS[0] + inside, u)
    places = np.broadcast_to((inside[:, None] + 0.5) / 3, (9, 8, 2))
    found = small.values("light", np.tile(PIXELS[0], (9, 1)), np.concatenate([places, u], axis=-1))
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=1e-6)  # positions are float32


def test_shared_samples_are_used_at_every_pixel():
    waves, u = Wavefront(VEACH), uniforms(40, 2)
    own = np.broadcast_to(u, (len(PIXELS), 40, 2))
    np.testing.assert_array_equal(
        waves.means("light", PIXELS, u), waves.means("light", PIXELS, own)
    )


def test_means_agree_with_the_values_in_float64():
    waves, u = Wavefront(VEACH, film="sampled"), uniforms(len(PIXELS), 50, 6)
    expected = waves.values("mis", PIXELS, u).astype(np.float64).mean(axis=1)
    found = waves.means("mis", PIXELS, u)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, expected, rtol=1e-13)


@pytest.mark.parametrize("lanes", [7, 32, 100])
@pytest.mark.parametrize("shape", [(4, 32, 2), (32, 2)])
def test_chunks_do_not_change_values(monkeypatch, lanes, shape):
    u = uniforms(*shape)
    waves = Wavefront(VEACH)
    expected = waves.values("light", PIXELS, u)
    monkeypatch.setattr(wavefront, "CHUNK_SAMPLES", lanes)
    np.testing.assert_array_equal(waves.values("light", PIXELS, u), expected)
    found, mean = waves.means("light", PIXELS, u), expected.astype(float).mean(axis=1)
    np.testing.assert_allclose(found, mean, rtol=1e-13)


def test_the_image_shows_the_radiance_of_a_light():
    # light-3 covers the pixel around its center; its BSDF is black.
    seen = Wavefront(VEACH, emission=True)
    from mcspectra.rendering import project

    x, y = (int(v) for v in project(VEACH, (3.75, 0.0, 0.0)))
    mean = seen.means("light", [[x, y]], uniforms(4, 2))
    np.testing.assert_allclose(mean, np.full((1, 3), 1.23457), rtol=1e-6)
    other = Wavefront(VEACH, light="light-2", emission=True)
    np.testing.assert_array_equal(other.means("light", [[x, y]], uniforms(4, 2)), np.zeros((1, 3)))


def test_lobes_need_a_column_of_their_own(scene_files):
    waves = Wavefront(scene_files["textured"], film="sampled")
    assert waves.selects_lobe
    assert [waves.dims(s) for s in WAVEFRONT_STRATEGIES] == [4, 5, 4, 5, 8]
    with pytest.raises(ParameterError, match="selects a lobe.*give 5 dims"):
        waves.means("bsdf", [[20, 15]], uniforms(8, 4))
    assert waves.means("bsdf", [[20, 15]], uniforms(8, 5)).min() > 0
    assert not Wavefront(VEACH).selects_lobe


def test_a_mirror_reflects_the_light_in_full_in_mis(scene_files):
    waves = Wavefront(scene_files["mirror"])
    u = uniforms(4, 4)
    mirrored = waves.means("bsdf", all_pixels(), u[:, 2:])
    assert mirrored.max() > 0.5
    np.testing.assert_array_equal(waves.means("mis", all_pixels(), u), mirrored)


def test_a_point_light_is_fully_included_in_mis(scene_files, tmp_path):
    # In this scene, a screen below the lamp keeps all of its light from the floor.
    text = Path(scene_files["lamp"]).read_text(encoding="utf-8")
    (tmp_path / "low.xml").write_text(text.replace('y="4"', 'y="1"'), encoding="utf-8")
    waves, u = Wavefront(tmp_path / "low.xml", light="lamp"), uniforms(4, 4)
    alone = waves.means("light", all_pixels(), u[:, :2])
    assert alone.max() > 0.0
    np.testing.assert_array_equal(waves.means("mis", all_pixels(), u), alone)


@pytest.mark.parametrize(
    ("pixels", "message"),
    [
        ([[96, 0]], "x runs from 0 to 95, y from 0 to 63"),
        ([[0, -1]], "outside the film"),
        ([[0, 2**70]], "give integers"),
        ([[0.5, 1.0]], "give integers"),
        ([[True, False]], "give integers"),
        ([0, 1], "give integers"),
        ([[0, 1, 2]], "give integers"),
        (np.empty((0, 2), int), "give integers"),
        ("pixels", "give integers"),
    ],
)
def test_invalid_pixels_raise(pixels, message):
    with pytest.raises(ParameterError, match=message):
        Wavefront(VEACH).means("light", pixels, uniforms(4, 2))


@pytest.mark.parametrize(
    ("u", "error"),
    [
        (np.full((4, 2), np.nan), DomainError),
        (np.full((4, 2), np.inf), DomainError),
        (np.full((4, 2), -0.1), DomainError),
        (np.full((4, 2), 1.1), DomainError),
        (np.full((4, 2), 1j), DomainError),
        (np.zeros((4, 1)), ParameterError),
        (np.zeros((4, 4)), ParameterError),
        (np.zeros((0, 2)), ParameterError),
        (np.zeros(2), ParameterError),
        (np.zeros((3, 4, 2)), ParameterError),
        (np.zeros((1, 4, 4, 2)), ParameterError),
    ],
)
def test_invalid_samples_raise(u, error):
    with pytest.raises(error):
        Wavefront(VEACH).means("light", PIXELS, u)


def test_too_many_values_are_refused_at_once():
    u = np.broadcast_to(np.zeros(2), (2**25, 2))
    with pytest.raises(ParameterError, match="use means"):
        Wavefront(VEACH).values("light", PIXELS, u)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"film": "gaussian"}, "center, sampled"),
        ({"heuristic": "maximum of all"}, "balance, power"),
        ({"light": "moon"}, "no light 'moon'"),
        ({"light": 17}, "light"),
        ({"scene": 3}, "name of a scene"),
    ],
)
def test_invalid_options_raise(options, message):
    with pytest.raises(ParameterError, match=message):
        Wavefront(**{"scene": VEACH, **options})
    with pytest.raises(ParameterError, match="mis-bsdf"):
        Wavefront(VEACH).means("both", PIXELS, uniforms(4, 2))


@pytest.mark.parametrize(("name", "message"), [("dark", "no lights"), ("blind", "no camera")])
def test_invalid_scenes_raise(scene_files, name, message):
    with pytest.raises(ParameterError, match=message):
        Wavefront(scene_files[name])


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileFormatError, match="nothing.xml"):
        Wavefront(tmp_path / "nothing.xml")


def test_samples_rounded_up_to_one_stay_below():
    waves = Wavefront(VEACH)
    below, above = np.full((4, 2), 1.0 - 2.0**-24), np.full((4, 2), 1.0 - 2.0**-53)
    np.testing.assert_array_equal(
        waves.values("light", PIXELS, above), waves.values("light", PIXELS, below)
    )
