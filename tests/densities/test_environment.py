"""Environment maps as densities: solid angles, channels, compensation, and what they refuse."""

from __future__ import annotations

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.environments import synthetic_sky
from mcspectra.core.errors import DensityError, FileFormatError, ParameterError
from mcspectra.densities import Bilinear, EnvironmentDensity
from mcspectra.densities._warps import WARPS

SKY = synthetic_sky(6, 10)
REC709 = np.array([0.2126, 0.7152, 0.0722])


def centers(height, width):
    y, x = np.meshgrid(
        (np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij"
    )
    return np.stack([x, y], axis=-1)


def solid_angles(height):
    """Shares of the rows, by the difference of cosines."""
    return -np.diff(np.cos(np.pi * np.arange(height + 1) / height)) / 2


@pytest.mark.parametrize("channel", ["luminance", 0, 1, 2])
def test_pixels_hold_radiance_times_solid_angle(channel):
    p = EnvironmentDensity(values=SKY, channel=channel)
    radiance = SKY @ REC709 if channel == "luminance" else SKY[..., channel]
    masses = radiance * solid_angles(6)[:, None]
    np.testing.assert_allclose(p.pdf(centers(6, 10)), masses / masses.mean(), rtol=1e-12)


def test_without_solid_angles_it_is_a_picture():
    p = EnvironmentDensity(values=SKY[..., 0], sin_theta=False)
    np.testing.assert_allclose(p.pdf(centers(6, 10)), SKY[..., 0] / SKY[..., 0].mean(), rtol=1e-12)


def test_an_even_map_samples_directions_evenly():
    """cos θ of the samples is uniform, up to the steps of rows: its cdf at row borders is exact."""
    p = EnvironmentDensity(values=np.ones((16, 4)))
    u = np.stack(np.full((2, 1001), 0.5), axis=-1)
    u[:, 1] = np.linspace(0, np.nextafter(1, 0), 1001)
    theta = np.pi * p.sample(u)[:, 1]
    borders = np.pi * np.arange(17) / 16
    found = np.interp(borders, theta, u[:, 1])
    np.testing.assert_allclose(found, (1 - np.cos(borders)) / 2, atol=1e-3)


def test_bilinear_maps_are_sin_weighted_and_periodic():
    p = EnvironmentDensity(values=SKY, channel=1, interpolation="bilinear")
    weights = np.sin(np.pi * (np.arange(6) + 0.5) / 6)[:, None]
    same = Bilinear(values=SKY[..., 1] * weights, periodic=True)
    u = np.random.default_rng(1).random((500, 2))
    np.testing.assert_allclose(p.sample(u), same.sample(u), rtol=0, atol=1e-12)
    np.testing.assert_allclose(p.pdf([0.0, 0.4]), p.pdf([1.0, 0.4]), rtol=1e-12)


@pytest.mark.parametrize("warp", WARPS)
def test_warps_share_the_pdf(warp):
    p = EnvironmentDensity(values=SKY, warp=warp)
    x = p.sample(np.random.default_rng(2).random((300, 2)))
    np.testing.assert_array_equal(p.pdf(x), EnvironmentDensity(values=SKY).pdf(x))
    assert p.has_inverse == (warp != "alias")


@pytest.mark.parametrize(("compensation", "multiple"), [(True, 1.0), (0.5, 0.5), (0, 0.0)])
def test_compensation_subtracts_the_mean_over_directions(compensation, multiple):
    radiance = SKY[..., 2]
    mean = (radiance.mean(axis=1) * solid_angles(6)).sum()
    left = np.maximum(radiance - multiple * mean, 0) * solid_angles(6)[:, None]
    p = EnvironmentDensity(values=radiance, compensation=compensation)
    np.testing.assert_allclose(p.pdf(centers(6, 10)), left / left.mean(), rtol=1e-9, atol=1e-12)
    assert len(p.zero_points()) == np.count_nonzero(left == 0)


def test_compensated_maps_need_another_technique():
    """Alone an error, as p is 0 where f is not; in MIS unbiased, and better than without."""
    f = mcs.integrand("environment(channel=1)")
    plain, compensated = (
        mcs.density(f"environment(channel=1, compensation={c})") for c in (False, True)
    )
    with pytest.raises(DensityError, match="is 0 at"):
        mcs.Estimator(f, compensated)
    estimators = [mcs.MultipleImportance(f, [p, "uniform"]) for p in (plain, compensated)]
    found = mcs.convergence(estimators, "random", [256], realizations=1000, rng=3)
    means, errors = found["mean"].values.ravel(), found["mean_se"].values.ravel()
    assert (np.abs(means - f.integral) < 4 * errors).all()
    (_, high), (low, _) = found["variance_ci"].values.reshape(2, 2)[[1, 0]]
    assert high < low


def test_a_file_is_read_and_named(tmp_path):
    path = tmp_path / "sky.npy"
    np.save(path, SKY)
    p = EnvironmentDensity(path=path, channel=0)
    assert p.spec == f"environment(path={str(path)!r}, channel=0)"
    x = centers(6, 10)
    np.testing.assert_array_equal(p.pdf(x), mcs.density(p.spec).pdf(x))
    np.testing.assert_array_equal(p.pdf(x), EnvironmentDensity(values=SKY, channel=0).pdf(x))


def test_the_default_is_the_synthetic_sky():
    x = centers(32, 64)
    given = EnvironmentDensity(values=synthetic_sky(32, 64))
    np.testing.assert_array_equal(mcs.density("environment").pdf(x), given.pdf(x))
    assert given.spec == "environment(values=<array 32x64x3>)"


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"values": np.zeros((2, 2))}, DensityError, "is black"),
        ({"values": np.ones((4, 8)), "compensation": True}, DensityError, "leaves nothing"),
        ({"values": SKY, "compensation": 1e9}, DensityError, "1e\\+09 times the mean"),
        ({"values": SKY, "compensation": -1}, ParameterError, "compensation is -1"),
        ({"values": SKY, "compensation": math.nan}, ParameterError, "compensation is nan"),
        ({"values": SKY, "compensation": "yes"}, ParameterError, "compensation is 'yes'"),
        ({"values": SKY, "sin_theta": 1}, ParameterError, "sin_theta is 1"),
        ({"values": SKY, "channel": 3}, ParameterError, "channel is 3"),
        ({"values": SKY, "channel": "red"}, ParameterError, "channel is 'red'"),
        ({"values": SKY, "interpolation": "cubic"}, ParameterError, "interpolation is 'cubic'"),
        ({"values": SKY, "warp": "none"}, ParameterError, "warp is 'none'"),
        (
            {"values": SKY, "interpolation": "bilinear", "warp": "alias"},
            ParameterError,
            "marginal warp only",
        ),
        ({"values": SKY, "path": "sky.exr"}, ParameterError, "not both"),
        ({"values": -SKY}, ParameterError, "at least 0"),
        ({"values": SKY * math.nan}, ParameterError, "finite"),
        ({"values": SKY * math.inf}, ParameterError, "finite"),
        ({"values": [1, 2]}, ParameterError, r"shape \(2,\)"),
        ({"values": np.ones((0, 3))}, ParameterError, r"shape \(0, 3\)"),
        ({"values": "sky"}, ParameterError, "not an array of numbers"),
        ({"values": [[1, 2], [3]]}, ParameterError, "not an array of numbers"),
        ({"values": SKY * 1j}, ParameterError, "not an array of numbers"),
        ({"values": np.broadcast_to(1.0, (10**6, 10**6))}, ParameterError, "read at most"),
        ({"path": 3}, FileFormatError, "3 is not a path"),
        ({"path": "no-such.exr"}, FileFormatError, "no file"),
    ],
)
def test_bad_input(options, error, says):
    with pytest.raises(error, match=says) as caught:
        EnvironmentDensity(**options)
    assert "\n" not in str(caught.value)
