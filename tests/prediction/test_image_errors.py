"""Spectra of error images: predictions agree with measurements, and rank masks."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import McspectraError, NoClosedForm, ParameterError


def bands(found, count=4):
    """Return predicted over measured power in `count` bands."""
    names = ("predicted_power", "measured_power")
    parts = (np.array_split(found[name].values, count) for name in names)
    return np.array([p.mean() / m.mean() for p, m in zip(*parts, strict=True)])


@pytest.mark.parametrize(
    ("integrand", "chain"),
    [
        ("gaussian(width=0.3)", "sobol | decorrelate(mask='white', width=32)"),
        ("gaussian(width=0.1)", "sobol | shift | decorrelate(mask='blue-noise', width=32)"),
        ("gaussian(width=0.3)", "jittered | decorrelate(mask='blue-noise', width=32)"),
        ("gaussian(width=0.1)", "random | decorrelate(mask='r2', width=32)"),
        ("disk", "sobol | shift | decorrelate(mask='blue-noise', width=32)"),
    ],
)
def test_predictions_are_what_is_measured(integrand, chain):
    found = mcs.prediction.image_error_spectrum(integrand, chain, 4, dims=2, half_width=24)
    # Smooth: equal up to the rest of ∫f². The disk: 2.5 % of ∫f² beyond the half width are treated
    # as white;
    # within a band, 16 images give that to about 1 %
    assert np.abs(bands(found) - 1.0).max() < (0.1 if integrand == "disk" else 0.005)


def test_white_masks_make_white_noise_of_the_variance_of_a_pixel():
    chain = "sobol | decorrelate(mask='white', width=32)"
    found = mcs.prediction.image_error_spectrum("cosine(frequency=1)", chain, 1, dims=1, images=16)
    # One frequency of one point has the power 2 |f_1|²
    variance = 2 * abs(mcs.integrand("cosine(frequency=1)", dims=1).fourier([[1]]).item()) ** 2
    values = found["predicted_power"].values
    sizes = np.pi * 2 * found["radius"].values * 32**2 / 32 / 2 / 2  # Size of each ring, in pairs
    assert abs(values.mean() / variance - 1) < 4 / np.sqrt(16 * sizes.sum())
    assert abs(float(found["low_share"]) - 1.0) < 4 / np.sqrt(16 * sizes[:4].sum())


def test_a_mask_of_blue_noise_has_less_at_low_frequencies():
    low = {
        mask: mcs.prediction.image_error_spectrum(
            "gaussian(width=0.3)", f"jittered | decorrelate(mask={mask!r}, width=32)", 4, dims=2
        )["low_share"].item()
        for mask in ("white", "blue-noise")
    }
    assert low["blue-noise"] < 0.5
    assert low["white"] > 0.8


def test_the_low_share_is_that_of_frequencies_below_an_eighth():
    chain = "sobol | decorrelate(mask='blue-noise', width=32)"
    found = mcs.prediction.image_error_spectrum(
        "gaussian(width=0.3)", chain, 4, dims=2, half_width=8, images=2
    )
    distance = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(32)]))
    sizes = np.bincount((32 * distance).astype(int).ravel())[:16]
    np.testing.assert_allclose(found["radius"], (np.arange(16) + 0.5) / 32)
    power = found["predicted_power"].values
    share = np.average(power[:4], weights=sizes[:4]) / np.average(power, weights=sizes)
    assert float(found["low_share"]) == pytest.approx(share, rel=1e-9)


def test_the_tail_is_the_energy_that_the_half_width_leaves():
    f = mcs.integrand("disk")
    chain = "sobol | shift | decorrelate(mask='blue-noise', width=16)"
    found = mcs.prediction.image_error_spectrum(f, chain, 4, half_width=12)
    energy = (np.abs(f.fourier_grid(12)) ** 2).sum()  # Of ∫f² = ∫f
    assert float(found["tail_term"]) == pytest.approx((f.integral - energy) / 4)


def test_pixels_of_different_integrands():
    """A light moves from pixel to pixel, and each pixel has its own coefficients."""
    places = np.linspace(0.2, 0.8, 16**2)
    functions = [
        mcs.integrand(f"gaussian(center={p!r}, width=0.2)", dims=2) for p in places.tolist()
    ]
    chain = "random | decorrelate(mask='blue-noise', width=16)"
    found = mcs.prediction.image_error_spectrum(functions, chain, 4, half_width=12)
    # Jumps at the border leave up to 2 % of ∫f² beyond the half width, which are treated as white
    assert np.abs(bands(found) - 1.0).max() < 0.1
    one = mcs.prediction.image_error_spectrum(functions[0], chain, 4, half_width=12)
    same = mcs.prediction.image_error_spectrum([functions[0]] * 16**2, chain, 4, half_width=12)
    np.testing.assert_allclose(same["predicted_power"], one["predicted_power"], rtol=1e-6)


@pytest.mark.parametrize(
    ("changes", "error", "match"),
    [
        (
            {"sampler": "sobol"},
            NoClosedForm,
            "do not share a spectrum; end the sampler with decorrelate",
        ),
        ({"sampler": "sobol | decorrelate(mode='owen')"}, NoClosedForm, "mode shift"),
        ({"integrand": ["disk"] * 3}, ParameterError, "3 integrands for 64 × 64 pixels"),
        ({"integrand": "gaussian", "dims": 5}, ParameterError, "limits are 3 dims"),
        ({"half_width": 0}, ParameterError, "half_width is 0"),
        ({"half_width": 10**5}, ParameterError, "too many"),
        ({"images": 1}, ParameterError, "images is 1"),
        ({"n": 0}, McspectraError, "n is 0"),
        ({"n": 2**20}, ParameterError, "too many"),
    ],
)
def test_what_cannot_be_is_refused(changes, error, match):
    given = {
        "integrand": "disk",
        "sampler": "sobol | decorrelate(mask='blue-noise')",
        "n": 4,
        "dims": 2,
    }
    with pytest.raises(error, match=match):
        mcs.prediction.image_error_spectrum(**(given | changes))


def test_a_tail_that_may_not_be_white_is_named_and_met_by_default():
    """In bands of r2 with a lattice, the part beyond was a sixth of the truth, without a note."""
    given = {"dims": 2, "images": 4, "half_width": 4}
    chain = "rank1-lattice | decorrelate(mask='r2', width=16)"
    few = mcs.prediction.image_error_spectrum("disk", chain, 16, **given)
    assert "raise half_width" in few.attrs["note"]
    assert np.abs(bands(few) - 1.0).max() > 0.3
    smooth = mcs.prediction.image_error_spectrum("cosine(frequency=[1, 2])", chain, 16, **given)
    assert "note" not in smooth.attrs
    many = mcs.prediction.image_error_spectrum("disk", chain, 16, **(given | {"half_width": None}))
    assert many.attrs["half_width"] > 24
    assert np.abs(bands(many) - 1.0).max() < 0.1
