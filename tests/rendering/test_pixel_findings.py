"""Rates from the literature, reproduced at pixels with intervals."""

import numpy as np
import pytest
from tests.rendering.samples import Z, slope_error, uniforms

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.rendering import Pixel, describe_pixel, named_pixels, pixel_mis

pytestmark = [pytest.mark.render, pytest.mark.usefixtures("coarse_pixels")]

COUNTS = [16, 64, 256, 1024]
WALL = {"scene": "veach", "x": 568, "y": 100, "light": "light-3"}
PLACES = {
    "wall": WALL,
    "plate-3": {"scene": "veach", "x": 600, "y": 430, "light": "light-3"},
    "plate-2": {"scene": "veach", "x": 560, "y": 345, "light": "light-3"},
}
LIGHT, BSDF = 0, 1


def rates(
    estimators,
    sampler="jittered",
    counts=COUNTS,
    realizations=150,
):
    """Rates of estimators with their intervals: rows of (low, rate, high)."""
    found = mcs.convergence(
        estimators, sampler, counts, realizations=realizations, rng=1, fit_last=len(counts)
    )
    rate = found["rate"].values
    half = Z * np.array([slope_error(found.isel(estimator=k)) for k in range(len(estimators))])
    return np.stack([rate - half, rate, rate + half], axis=1)


def check_slowest_decides(technique, whole):
    """The BSDF technique is significantly slower than the other, and MIS is as slow as it is."""
    assert technique[BSDF, 0] > technique[LIGHT, 2]
    assert whole[0] < technique[BSDF, 2]
    assert whole[2] > technique[BSDF, 0]


@pytest.mark.parametrize(
    "shape", ["wall", *(pytest.param(f"plate-{k}", marks=pytest.mark.slow) for k in (3, 2))]
)
def test_slowest_technique_determines_mis(shape):
    place = PLACES[shape]
    assert describe_pixel(place["scene"], place["x"], place["y"])["shape"] == shape
    mis = pixel_mis(**place)
    found = rates([*(mis.primary_integrand(t) for t in (LIGHT, BSDF)), mis])
    check_slowest_decides(found[:2], found[2])


@pytest.fixture(scope="module")
def figure1():
    """Rates of BSDF sampling, and of plain and mirrored light sampling, shifted sets."""
    x, y = named_pixels("figure1")["P"]
    sharp, smooth = (
        Pixel(scene=scene, x=x, y=y, strategy="bsdf") for scene in ("figure1", "smooth-light")
    )
    light = Pixel(scene="figure1", x=x, y=y, strategy="light")
    found = rates(
        [sharp, smooth, light, mcs.Mirrored(light, "integrand")],
        "jittered | shift",
        [64, 256, 1024, 4096],
        100,
    )
    return dict(zip(("sharp", "smooth", "shifted", "mirrored"), found, strict=True))


def test_smoothing_the_edge_of_the_light_raises_the_rate_of_the_bsdf(
    figure1,
):
    assert figure1["smooth"][2] < figure1["sharp"][0]
    assert figure1["sharp"][0] < -1.5 < figure1["sharp"][2]  # edges give n^-1.5


def test_mirroring_raises_the_shifted_rate(figure1):
    assert figure1["mirrored"][2] < figure1["shifted"][0]
    assert figure1["mirrored"][0] < -2.0 < figure1["mirrored"][2]  # without edges the rate is n^-2


SPECTRA = [
    pytest.param(WALL, "light", id="light-wall"),
    pytest.param(WALL, "bsdf", id="bsdf-wall", marks=pytest.mark.slow),
    pytest.param(PLACES["plate-3"], "light", id="light-plate", marks=pytest.mark.slow),
    pytest.param(PLACES["plate-3"], "bsdf", id="bsdf-plate"),
]


@pytest.mark.parametrize(("place", "strategy"), SPECTRA)
def test_spectrum_predicts_the_variance(place, strategy):
    """All of the variance for light sampling; for edges, the share below the half width.

    The spectrum of a light with edges misses a positive part: its tail above 24 waves.
    """
    terms = mcs.variance_terms(
        Pixel(**place, strategy=strategy),
        "jittered",
        64,
        half_width=24,
        realizations=300,
        rng=1,
        space="primary",
        basis="cosine",
    )
    low, high = terms["measured_variance_ci"].values
    assert low < float(terms["predicted_variance"]) < high
    captured = float(terms["captured"])
    assert captured > 0.85
    if strategy == "light":
        assert captured == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("n", [16, pytest.param(64, marks=pytest.mark.slow)])
def test_quadrature_of_strata_predicts_the_variance(n):
    """Within 4 σ of 1000 measured realizations, with σ from the reported interval."""
    light = Pixel(**WALL)
    exact = mcs.exact_variance(light, "jittered", n, tolerance=1e-2)  # σ is 4 %
    found = mcs.convergence(light, "jittered", [n], realizations=1000, rng=3)
    low, high = found["variance_ci"].values[0]
    error = np.log(high / low) / (2 * 1.96)
    assert abs(np.log(float(found["variance"][0]) / exact)) < 4 * error


def test_positions_in_the_pixel_average_it():
    """The mean over a pixel, first over a grid of positions, then by four and by five dims."""
    place = {"scene": "figure1", "x": 200, "y": 190}
    whole = [Pixel(**place, strategy=s, dims=d) for s, d in (("light", 4), ("bsdf", 5))]
    means, errors = [], []
    for k, pixel in enumerate(whole):
        values = pixel(uniforms(2**18, pixel.dims, k))
        means.append(values.mean())
        errors.append(values.std() / 2**9)
    assert abs(means[0] - means[1]) < 4 * np.hypot(*errors)
    side = 16
    grid = (np.stack(np.divmod(np.arange(side**2), side), axis=-1) + 0.5) / side
    u = np.repeat(grid, 1024, axis=0)
    both = np.concatenate([u, np.tile(uniforms(1024, 2, 7), (side**2, 1))], axis=1)
    values = whole[0](both).reshape(side**2, 1024).mean(axis=0)
    assert abs(values.mean() - means[0]) < 4 * np.hypot(errors[0], values.std() / 32)


def test_the_central_position_is_the_pixel_of_two_dims():
    u = uniforms(1000, 3)
    for strategy in ("light", "bsdf", "mis-light", "mis-bsdf"):
        middle = np.full((1000, 2), 0.5)
        for dims in (2, 3):
            flat = Pixel(**PLACES["plate-3"], strategy=strategy, dims=dims)(u[:, :dims])
            film = Pixel(**PLACES["plate-3"], strategy=strategy, dims=dims + 2)
            moved = film(np.concatenate([middle, u[:, :dims]], axis=1))
            np.testing.assert_allclose(moved, flat, rtol=1e-4, atol=1e-5 * flat.max())


def test_first_two_samples_run_from_the_upper_left_corner():
    """Positions near a border of the pixel match those near the opposite border of its neighbor."""
    u, small = uniforms(500, 2), 2.0**-10
    here, right, below = (
        Pixel(scene="figure1", x=x, y=y, dims=4) for x, y in ((200, 190), (201, 190), (200, 191))
    )

    def at(pixel, dx, dy):
        return pixel(np.column_stack([np.full(500, dx), np.full(500, dy), u]))

    np.testing.assert_allclose(at(here, 1 - small, 0.5), at(right, small, 0.5), rtol=1e-3)
    np.testing.assert_allclose(at(here, 0.5, 1 - small), at(below, 0.5, small), rtol=1e-3)
    assert not np.allclose(at(here, small, 0.5), at(right, small, 0.5), rtol=1e-3)


def test_rays_that_hit_a_light_or_nothing_count_as_zero():
    """The left border of light-3 crosses the pixel: wall on the left, light on the right."""
    assert describe_pixel("veach", 579, 72)["light"] == "light-3"
    u = uniforms(2**14, 4)
    values = Pixel(scene="veach", x=579, y=72, dims=4)(u)
    assert (values[u[:, 0] < 0.1] > 0).all()
    assert (values[u[:, 0] > 0.9] == 0).all()
    with pytest.raises(ParameterError, match="only lights"):
        Pixel(scene="veach", x=642, y=72, dims=4)
