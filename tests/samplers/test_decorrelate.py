"""Decorrelated pixels: one shared set, and shifts that are white, blue or low-discrepancy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import Decorrelate, DigitalShift, Halton, Jittered, Owen, Shift, Sobol
from mcspectra.samplers.lattice import golden_steps

LEVEL = 1 - (1 - 1e-6) ** (1 / 6)  # Šidák: 6 statistical tests in this file share 1e-6
STREAM = Stream.from_rng(5)


@pytest.mark.parametrize("mask", ["white", "blue-noise", "r2"])
def test_pixels_differ_by_a_translation_only(mask):
    source = Jittered(dims=2).then(Decorrelate(mask=mask, width=16))
    points = source.draw(16, realizations=40, rng=1)
    shared = Jittered(dims=2).draw(16, rng=1)
    moved = points - shared
    steps = moved - moved[:, :1]
    np.testing.assert_allclose(steps, np.rint(steps), atol=4 * 2.0**-53)
    assert len(np.unique(points[:, 0], axis=0)) == 40


@pytest.mark.parametrize(
    ("mode", "step"), [("shift", Shift()), ("digital-shift", DigitalShift()), ("owen", Owen())]
)
def test_white_masks_are_the_randomisation_itself(mode, step):
    """For a fixed set the shared realisation is the set: the same as without decorrelate."""
    np.testing.assert_array_equal(
        Sobol(dims=3).then(Decorrelate(mode=mode)).draw(32, realizations=10, rng=2, first=3),
        Sobol(dims=3).then(step).draw(32, realizations=10, rng=2, first=3),
    )


@pytest.mark.parametrize("mask", ["blue-noise", "r2"])
def test_digital_masks_keep_nets(mask):
    step = Decorrelate(mode="digital-shift", mask=mask, width=8)
    points = Sobol(dims=2).then(step).draw(64, realizations=20, rng=3)
    for k in range(7):
        cells = np.floor(points * [2**k, 2 ** (6 - k)]) @ [2 ** (6 - k), 1]
        np.testing.assert_array_equal(np.sort(cells, axis=1), np.tile(np.arange(64), (20, 1)))
    words = [(p * 2.0**53).astype(np.uint64) for p in (points, Sobol(dims=2).draw(64))]
    word = words[0] ^ words[1]
    np.testing.assert_array_equal(word, np.broadcast_to(word[:, :1], word.shape))


def test_blue_noise_shifts_take_each_stratum_once():
    width = 16
    step = Decorrelate(mask="blue-noise", width=width)
    for first in (0, width**2, 5 * width):
        offsets = step.offsets(STREAM, first, width**2, 3)
        strata = np.sort(np.floor(offsets * width**2), axis=0)
        np.testing.assert_array_equal(strata, np.arange(width**2)[:, None] + np.zeros(3))


def test_blue_noise_shifts_have_little_power_at_low_frequencies():
    """White shifts have a mean power of 1/12 at every frequency; below half the way to the middle
    of the band a tenth of it is far more than void and cluster leaves."""
    width = 32
    offsets = Decorrelate(mask="blue-noise", width=width).offsets(STREAM, 0, width**2, 2)
    for image in offsets.T.reshape(2, width, width):
        power = np.abs(np.fft.fft2(image - image.mean())) ** 2 / width**2
        m = np.fft.fftfreq(width, 1 / width)
        radius = np.hypot(m[:, None], m)
        low = (radius > 0) & (radius < width / 8)
        assert power[low].mean() < 0.1 / 12


def test_r2_shifts_step_by_the_golden_vector():
    offsets = Decorrelate(mask="r2").offsets(STREAM, 2**40, 100, 2)
    steps = np.diff(offsets, axis=0) % 1.0
    np.testing.assert_allclose(
        steps, golden_steps(2) * 2.0**-64 + np.zeros((99, 1)), atol=4 * 2.0**-53
    )


@pytest.mark.parametrize("mask", ["blue-noise", "r2"])
def test_points_of_one_pixel_are_uniform_over_seeds(mask):
    step = Decorrelate(mask=mask, width=8)
    offsets = np.concatenate([step.offsets(Stream.from_rng(s), 77, 1, 2) for s in range(3200)])
    cells = (np.floor(offsets * 4) @ [4, 1]).astype(int)
    assert stats.chisquare(np.bincount(cells, minlength=16)).pvalue > LEVEL
    # and within the ranks of the mask
    fine = np.floor(offsets[:, 0] * 64 % 1.0 * 16).astype(int)
    assert stats.chisquare(np.bincount(fine, minlength=16)).pvalue > LEVEL


def test_errors_of_neighbours_are_blue_noise():
    """The image of estimates of x has less low-frequency power than with white shifts."""
    width = 32
    m = np.fft.fftfreq(width, 1 / width)
    radius = np.hypot(m[:, None], m)
    low = (radius > 0) & (radius < 4)
    powers = {}
    for mask in ("white", "blue-noise"):
        spec = f"regular | decorrelate(mask='{mask}', width={width})"
        points = mcs.sampler(spec, 2).draw(4, realizations=width**2, rng=1)
        image = points[..., 0].mean(axis=1).reshape(width, width)
        powers[mask] = np.mean((np.abs(np.fft.fft2(image)) ** 2)[low]) / image.var()
    assert powers["blue-noise"] < 0.5 * powers["white"]


def test_variance_over_pixels_is_that_of_the_shift():
    """Exact: n = 16 equidistant points under a uniform shift, 1/(12 n²) for the mean of x."""
    for mask in ("white", "blue-noise", "r2"):
        spec = f"rank1-lattice | decorrelate(mask='{mask}', width=64)"
        means = mcs.sampler(spec, 1).draw(16, realizations=4096, rng=1)[..., 0].mean(axis=1)
        ratio = means.var(ddof=1) * 12 * 16**2
        assert abs(ratio - 1) < stats.norm.isf(LEVEL / 2) * np.sqrt(0.8 / 4096)


def test_declared_properties():
    assert Decorrelate().fits == Shift.fits
    assert Decorrelate(mode="owen").fits == Owen.fits
    assert (Decorrelate().stationary, Decorrelate(mode="owen").stationary) == (True, False)
    assert Sobol(dims=2).then(Decorrelate()).unbiased


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"mode": "mirror"}, "shift, digital-shift, owen"),
        ({"mask": "blue"}, "white, blue-noise, r2"),
        ({"width": 0}, "width"),
        ({"width": 300}, "width"),
        ({"width": 2.5}, "width"),
        ({"width": float("nan")}, "width"),
        ({"mode": "owen", "mask": "r2"}, "a mask gives one"),
    ],
)
def test_bad_parameters(arguments, words):
    with pytest.raises(ParameterError, match=words):
        Decorrelate(**arguments)


def test_counts_are_those_of_the_mode():
    jittered = Jittered(dims=2)
    for mode, step in (("shift", Shift()), ("digital-shift", DigitalShift()), ("owen", Owen())):
        for n in (16, 30, 36, 60):
            counts = Decorrelate(mode=mode).counts_near(jittered, n)
            assert counts == step.fit(jittered).counts_near(jittered, n)


def test_misfits_are_refused():
    with pytest.raises(ParameterError, match="would break"):
        mcs.sampler("rank1-lattice | decorrelate(mode='owen')", 2)
    with pytest.raises(ParameterError, match="base 3"):
        Halton(dims=2).then(Decorrelate(mode="digital-shift", mask="r2"))
