"""Irradiance by environment maps: integrals, normals, interpolation and invalid input."""

import math

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

import mcspectra as mcs
from mcspectra.core.environments import directions
from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.integrands import Environment, synthetic_sky

SKY = synthetic_sky(6, 10)


def midpoints(height, width):
    y, x = np.meshgrid(
        (np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij"
    )
    return np.stack([x, y], axis=-1)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -3), (1, 0, 0), (1, -2, 0.5)])
def test_an_even_sky_gives_pi(normal):
    """∫ max(0, n·ω) dω = π for every normal."""
    f = Environment(values=np.ones((4, 8)), normal=normal)
    assert f.channels == 0
    assert f.integral == pytest.approx(math.pi, rel=1e-4)
    assert f.integral_source == ("exact" if normal[0] == 0 else "quadrature")


@pytest.mark.parametrize("height", [5, 6])
@pytest.mark.parametrize("up", [1, -1])
def test_exact_integrals_against_midpoints(height, up):
    """The horizon may or may not be a border of rows."""
    f = Environment(values=synthetic_sky(height, 10), normal=(0, 0, up))
    reference = f(midpoints(1200, 50)).mean(axis=(0, 1))
    assert f.integral_source == "exact"
    np.testing.assert_allclose(f.integral, reference, rtol=1e-5)


def test_values_by_hand():
    f = Environment(values=SKY, normal=(0, 2, 0))
    x = midpoints(6, 10)
    cosine = np.maximum(directions(x)[..., 1], 0)
    expected = 2 * math.pi**2 * np.sin(math.pi * x[..., 1]) * cosine
    np.testing.assert_allclose(f(x), expected[..., None] * SKY, rtol=1e-13, atol=1e-13)
    assert (f(x[:, 5:]) == 0).all()  # φ > π is behind the surface


def test_turning_the_map_turns_the_normal():
    u = np.random.default_rng(1).random((300, 2))
    quarter = np.roll(synthetic_sky(6, 12), 3, axis=1)
    turned = Environment(values=quarter, normal=(-1, 2, 0.5))
    plain = Environment(values=synthetic_sky(6, 12), normal=(2, 1, 0.5))
    moved = np.stack([(u[:, 0] + 0.25) % 1, u[:, 1]], axis=-1)
    np.testing.assert_allclose(turned(moved), plain(u), rtol=1e-11, atol=1e-11)


def test_bilinear_values_are_those_of_scipy():
    pixels = np.random.default_rng(7).random((6, 10, 3))
    f = Environment(values=pixels, interpolation="bilinear", normal=(0, 0, 1))
    flat = Environment(values=np.ones((1, 1)), normal=(0, 0, 1))
    x = np.random.default_rng(2).random((500, 2)) * [1, 0.499]
    wrapped = np.concatenate([pixels[:, -1:], pixels, pixels[:, :1]], axis=1)
    columns, rows = (np.arange(12) - 0.5) / 10, (np.arange(6) + 0.5) / 6
    reference = RegularGridInterpolator((rows, columns), wrapped)
    held = np.stack([np.clip(x[:, 1], rows[0], rows[-1]), x[:, 0]], axis=-1)
    np.testing.assert_allclose(f(x), reference(held) * flat(x)[:, None], rtol=1e-11)
    one = Environment(values=[[2.0]], interpolation="bilinear")
    np.testing.assert_allclose(one(x), 2 * flat(x), rtol=1e-14)


def test_channels():
    every = Environment(values=SKY)
    single = [Environment(values=SKY, channel=c) for c in range(3)]
    x = np.random.default_rng(3).random((50, 2))
    np.testing.assert_array_equal(every(x), np.stack([f(x) for f in single], axis=-1))
    assert [f.integral for f in single] == pytest.approx(every.integral.tolist())


def test_breaks_hold_what_quadrature_needs():
    assert Environment(values=np.ones((2, 4))).breaks == ((0.25, 0.5, 0.75), (0.5,))
    tilted = Environment(values=np.ones((3, 1)), normal=(1, 0, 1))
    assert tilted.breaks == ((), (1 / 3, 2 / 3))
    centers = Environment(values=np.ones((1, 2)), interpolation="bilinear")
    assert centers.breaks == ((0.25, 0.75), (0.5,))
    assert Environment(values=np.ones((65, 65))).breaks == ((), (0.5,))


def test_files_and_specs(tmp_path):
    np.save(tmp_path / "sky.npy", SKY)
    f = Environment(path=tmp_path / "sky.npy", channel=1, normal=[1, 0, 1])
    again = mcs.integrand(f.spec)
    assert again.spec == f.spec
    x = np.random.default_rng(4).random((50, 2))
    np.testing.assert_array_equal(again(x), f(x))
    default = mcs.integrand("environment", dims=2)
    np.testing.assert_array_equal(default(x), Environment(values=synthetic_sky(32, 64))(x))


def test_each_channel_by_its_own_density():
    """For the jittered blue channel, its own density beats luminance, which beats uniform."""
    f = mcs.integrand("environment(channel=2)")
    specs = ("uniform", "environment", "environment(channel=2)")
    estimators = [mcs.Estimator(f, spec) for spec in specs]
    found = mcs.convergence(estimators, "jittered", [256], realizations=300, rng=5)
    low, high = np.moveaxis(found["variance_ci"].values.reshape(3, 2), -1, 0)
    assert high[2] < low[1] / 5
    assert high[1] < low[0]
    means, errors = found["mean"].values.ravel(), found["mean_se"].values.ravel()
    assert (np.abs(means - f.integral) < 4 * errors).all()


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"normal": (0, 0, 0)}, ParameterError, "normal is .*not all 0"),
        ({"normal": (0, 1)}, ParameterError, "normal has 2 values"),
        ({"normal": (0, math.inf, 0)}, ParameterError, "inf"),
        ({"interpolation": "cubic"}, ParameterError, "interpolation is 'cubic'"),
        ({"channel": "red"}, ParameterError, "channel is 'red'"),
        ({"values": -SKY}, ParameterError, "at least 0"),
        ({"values": SKY * math.nan}, ParameterError, "finite"),
        ({"values": [1.0]}, ParameterError, r"shape \(1,\)"),
        ({"values": SKY, "path": "sky.exr"}, ParameterError, "give one of them"),
        ({"path": "no-such.exr"}, FileFormatError, "no file"),
    ],
)
def test_bad_input(options, error, says):
    with pytest.raises(error, match=says) as caught:
        Environment(**options)
    assert "\n" not in str(caught.value)


def test_normals_of_any_length():
    x = np.random.default_rng(6).random((20, 2))
    short, unit, long = (Environment(values=SKY, normal=(0, s, s)) for s in (1e-300, 1, 1e300))
    np.testing.assert_allclose(short(x), unit(x), rtol=1e-12)
    np.testing.assert_allclose(long(x), unit(x), rtol=1e-12)
