"""Densities of pictures and environment maps: pixels, solid angles, channels, compensation."""

import dataclasses
import math

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from scipy import optimize
from tests.densities.conftest import pixel_centers

import mcspectra as mcs
from mcspectra.core.environments import synthetic_sky
from mcspectra.core.errors import DensityError
from mcspectra.densities import (
    Bilinear,
    EnvironmentDensity,
    ImageDensity,
    PiecewiseConstant,
    compensated,
)
from mcspectra.densities.tabulated import WARPS

SKY = synthetic_sky(6, 10)
REC709 = np.array([0.2126, 0.7152, 0.0722])


def solid_angles(height):
    """Return the shares of the rows, by differences of cosines."""
    return -np.diff(np.cos(np.pi * np.arange(height + 1) / height)) / 2


PIXELS = np.array([[0, 51, 102], [153, 204, 255]], np.uint8)


@pytest.mark.parametrize("kind", ["png8", "png16", "exr", "npy"])
def test_pictures_of_known_pixels(tmp_path, kind):
    values = PIXELS / 255.0
    path = tmp_path / f"p.{kind.rstrip('0123456789')}"
    if kind == "png8":
        Image.fromarray(PIXELS).save(path)
    elif kind == "png16":
        Image.fromarray(PIXELS.astype(np.uint16) * 257).save(path)
    elif kind == "exr":
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"Y": values.astype(np.float32)}).write(str(path))
    else:
        np.save(path, values)
    p = ImageDensity(path=path, linear=True)
    precision = 1e-7 if kind == "exr" else 1e-14  # float32
    np.testing.assert_allclose(p.pdf(pixel_centers(2, 3)), values / values.mean(), rtol=precision)
    assert mcs.density(p.spec).pdf([0.9, 0.9]) == p.pdf([0.9, 0.9])


def test_jpeg_and_srgb(tmp_path):
    picture = np.kron([[0, 188], [188, 255]], np.ones((16, 16))).astype(np.uint8)
    Image.fromarray(picture).save(tmp_path / "p.jpg", quality=100)
    found = ImageDensity(path=tmp_path / "p.jpg").pdf(pixel_centers(2, 2))
    half = ((188 / 255 + 0.055) / 1.055) ** 2.4
    expected = np.array([[0, half], [half, 1]])
    np.testing.assert_allclose(found, expected / expected.mean(), atol=0.03)  # one step of 255


def test_channels_and_floor(tmp_path):
    colors = np.zeros((1, 2, 3))
    colors[0, 0] = [1, 0, 0]
    colors[0, 1] = [0, 3, 0]
    np.save(tmp_path / "c.npy", colors)
    row = pixel_centers(1, 2)[0]
    by = {c: ImageDensity(path=tmp_path / "c.npy", channel=c).pdf(row) for c in ("luminance", 0)}
    red, green = 0.2126, 3 * 0.7152
    np.testing.assert_allclose(by["luminance"], np.array([red, green]) * 2 / (red + green))
    np.testing.assert_array_equal(by[0], [2, 0])
    floored = ImageDensity(path=tmp_path / "c.npy", channel=0, floor=0.5)
    np.testing.assert_allclose(floored.pdf(row), [1.6, 0.4])  # 1 and ¼ over their mean
    assert math.isfinite(floored.reciprocal_integral())


@pytest.mark.parametrize("channel", ["luminance", 0, 1, 2])
def test_pixels_have_mass_radiance_times_solid_angle(channel):
    p = EnvironmentDensity(values=SKY, channel=channel)
    radiance = SKY @ REC709 if channel == "luminance" else SKY[..., channel]
    masses = radiance * solid_angles(6)[:, None]
    np.testing.assert_allclose(p.pdf(pixel_centers(6, 10)), masses / masses.mean(), rtol=1e-12)


def test_without_solid_angles_a_map_is_a_picture():
    p = EnvironmentDensity(values=SKY[..., 0], sin_theta=False)
    np.testing.assert_allclose(
        p.pdf(pixel_centers(6, 10)), SKY[..., 0] / SKY[..., 0].mean(), rtol=1e-12
    )


def test_an_even_map_samples_directions_evenly():
    """cos θ of the samples is uniform up to rows; its cdf at row borders is exact."""
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


@pytest.mark.parametrize(("compensation", "multiple"), [(True, 1.0), (0.5, 0.5), (0, 0.0)])
def test_compensation_subtracts_the_mean_over_directions(compensation, multiple):
    radiance = SKY[..., 2]
    mean = (radiance.mean(axis=1) * solid_angles(6)).sum()
    left = np.maximum(radiance - multiple * mean, 0) * solid_angles(6)[:, None]
    p = EnvironmentDensity(values=radiance, compensation=compensation)
    np.testing.assert_allclose(
        p.pdf(pixel_centers(6, 10)), left / left.mean(), rtol=1e-9, atol=1e-12
    )
    assert len(p.zero_points()) == np.count_nonzero(left == 0)


def test_compensated_maps_need_another_technique():
    """Alone an error, since p is 0 where f is not; in MIS unbiased, and better than without."""
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
    x = pixel_centers(6, 10)
    np.testing.assert_array_equal(p.pdf(x), mcs.density(p.spec).pdf(x))
    np.testing.assert_array_equal(p.pdf(x), EnvironmentDensity(values=SKY, channel=0).pdf(x))


def test_the_default_is_the_synthetic_sky():
    x = pixel_centers(32, 64)
    given = EnvironmentDensity(values=synthetic_sky(32, 64))
    np.testing.assert_array_equal(mcs.density("environment").pdf(x), given.pdf(x))
    assert given.spec == "environment(values=<array 32x64x3>)"


@pytest.mark.parametrize("warp", WARPS)
def test_warps_of_pictures_and_maps_equal_the_warps_of_tables(tmp_path, warp):
    values = np.random.default_rng(5).random((5, 12))
    np.save(tmp_path / "p.npy", values)
    picture = ImageDensity(path=tmp_path / "p.npy", warp=warp)
    sky = EnvironmentDensity(values=values, sin_theta=False, warp=warp)
    same = PiecewiseConstant(values=values, warp=warp)
    u = np.random.default_rng(9).random((100, 2))
    for p in (picture, sky):
        np.testing.assert_allclose(p.sample(u), same.sample(u), rtol=0, atol=1e-14)
        np.testing.assert_allclose(p.pdf(u), same.pdf(u), rtol=1e-13)
        assert p.has_inverse == same.has_inverse == (warp != "alias")
        np.testing.assert_allclose(p.breaks[1], same.breaks[1], rtol=1e-13)
    np.testing.assert_array_equal(picture.sample(u), same.sample(u))
    assert dataclasses.replace(picture, warp="alias").warp == "alias"


TABLE = [1.0, 1.0, 4.0, 2.0, 0.5, 8.0]


def _second_moment(own, f, other, share):
    """Return ∫ f²/(β p' + (1 − β) p_s) for cells of equal size."""
    mix = share * own + (1 - share) * other
    return np.mean(np.where(f > 0, f**2 / np.where(mix > 0, mix, 1e-300), 0))


@pytest.mark.parametrize("counts", [(1, 1), (1, 3), (5, 1)])
@pytest.mark.parametrize("other", [[1.0] * 6, [6, 5, 4, 3, 2, 1], [0, 0, 1, 5, 5, 5]])
def test_compensation_minimizes_the_second_moment(counts, other):
    """Compare with a constrained minimizer that does not use λ."""
    f = np.array(TABLE) / np.mean(TABLE)
    second = np.array(other) / np.mean(other)
    share = counts[0] / sum(counts)
    density = compensated(
        PiecewiseConstant(values=TABLE), [PiecewiseConstant(values=other)], counts
    )
    own = np.array(density.values)
    assert own.mean() == pytest.approx(1, abs=1e-12)
    found = optimize.minimize(
        lambda p: _second_moment(p, f, second, share),
        np.ones(6),
        bounds=[(1e-9, None)] * 6,
        constraints={"type": "eq", "fun": lambda p: p.mean() - 1},
        options={"ftol": 1e-14, "maxiter": 500},
    )
    least = _second_moment(own, f, second, share)
    assert least <= found.fun * (1 + 1e-7)
    assert least == pytest.approx(found.fun, rel=1e-4)
    np.testing.assert_allclose(own, found.x, atol=2e-2)


def test_without_a_cutoff_there_is_no_variance():
    """The mixture is p itself, so f/mixture is constant."""
    table = PiecewiseConstant(values=[2, 3, 4, 5])
    own = compensated(table, ["uniform"], (3, 1))
    p = np.array([2, 3, 4, 5]) / 3.5
    np.testing.assert_allclose(own.values, (p - 0.25) / 0.75, rtol=1e-14)
    x = (np.arange(40)[:, None] + 0.5) / 40
    np.testing.assert_allclose(0.75 * own.pdf(x) + 0.25, table.pdf(x), rtol=1e-14)


def _balance_variance(own, f):
    """One random point each of `own` and of the uniform density, from sums over cells."""
    mix = own + 1
    parts = (own, np.ones_like(own))
    return sum(np.mean(p * (f / mix) ** 2) - np.mean(p * f / mix) ** 2 for p in parts)


def test_variance_goes_down_and_the_support_stays_covered():
    table = PiecewiseConstant(values=TABLE)
    f = mcs.Integrand.from_function(table.pdf, dims=1, integral=1.0)
    p, own = np.array(TABLE) / np.mean(TABLE), compensated(table, ["uniform"])
    before = _balance_variance(p, p)
    after = _balance_variance(np.array(own.values), p)
    assert after < 0.3 * before
    for density, expected in ((table, before), (own, after)):
        e = mcs.MultipleImportance(f, [density, "uniform"])  # checks the support
        assert mcs.exact_variance(e, "random", 1) == pytest.approx(expected, rel=1e-6)
    partly = PiecewiseConstant(values=[1, 0, 1, 0, 1, 0, 1, 0, 1, 0])
    kept = compensated(table, [partly])
    assert (np.array(kept.values) > 0).all()  # the other density has a gap in every cell


def test_two_dims_have_rows_along_axis_1():
    values = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 9.0]])
    own = compensated(PiecewiseConstant(values=values), ["linear(slope=1)"], (2, 1))
    x = np.stack(np.meshgrid((np.arange(3) + 0.5) / 3, [0.25, 0.75]), axis=-1)
    # The mean of a linear density is its value at the center
    other = mcs.density("linear(slope=1)", dims=2).pdf(x)
    left = values / values.mean() - other / 3
    assert (left > 0).all()
    np.testing.assert_allclose(own.values, left * 1.5, rtol=1e-12)


def test_without_others_the_table_and_its_warp_are_kept():
    table = PiecewiseConstant(values=[[1, 2], [3, 4]], warp="hierarchical")
    own = compensated(table, [])
    np.testing.assert_allclose(own.values, np.array([[1, 2], [3, 4]]) / 2.5)
    assert own.warp == "hierarchical"


def test_tables_of_several_blocks_of_cells():
    """Where nothing is cut off, its share and those of other techniques add up to λ p."""
    p = np.random.default_rng(1).random((300, 500)) ** 4
    own = compensated(PiecewiseConstant(values=p), ["uniform", "linear(slope=1)"]).values
    assert np.mean(own) == pytest.approx(1, abs=1e-9)
    assert np.mean(own == 0) > 0.3
    linear = mcs.density("linear(slope=1)", dims=2).pdf(pixel_centers(300, 500))
    level = ((own + 1 + linear) / p)[own > 0]
    np.testing.assert_allclose(level, level[0], rtol=1e-9)
