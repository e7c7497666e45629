"""Figure 1 of the paper: eight rates of two pixels under a square light, 95 % intervals."""

from statistics import NormalDist

import pytest
from tests.rendering.samples import slope_error

import mcspectra as mcs
from mcspectra.rendering import named_pixels, pixel_strategies

pytestmark = [pytest.mark.render, pytest.mark.slow]

COUNTS = tuple(side**2 for side in (8, 11, 16, 23, 32, 45, 64))
REALIZATIONS = 400
CURVES = [(name, strategy) for name in "PQ" for strategy in ("light", "bsdf")]
SAMPLERS = ["jittered", "jittered | shift"]
# Šidák: all eight intervals hold together with a probability of 99 %.
SIGMAS = NormalDist().inv_cdf(1 - (1 - 0.99 ** (1 / 8)) / 2)


def estimators(scene):
    pixels = named_pixels(scene)
    return [
        mcs.Estimator(pixel_strategies(scene, *pixels[name])[strategy]) for name, strategy in CURVES
    ]


@pytest.fixture(scope="module")
def curves():
    return mcs.convergence(
        estimators("figure1"), SAMPLERS, COUNTS, realizations=REALIZATIONS, rng=1
    )


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize(("name", "strategy"), CURVES)
def test_rate(curves, name, strategy, sampler):
    fastest = (name, strategy, sampler) == ("P", "light", "jittered")
    expected = -2.0 if fastest else -1.5
    at = {"estimator": CURVES.index((name, strategy)), "sampler": SAMPLERS.index(sampler)}
    error = slope_error(curves.isel(at))
    difference = float(curves["rate"].isel(at)) - expected
    assert error < 0.04  # the rates -1.5 and -2 are a dozen standard errors apart
    assert abs(difference) < min(0.1, SIGMAS * error)


def test_strategies_agree_on_the_mean(curves):
    mean, se = curves["mean"].isel(n=-1).values, curves["mean_se"].isel(n=-1).values
    for light, bsdf in ((0, 1), (2, 3)):
        for s in range(len(SAMPLERS)):
            error = (se[light, s] ** 2 + se[bsdf, s] ** 2) ** 0.5
            assert abs(mean[light, s] - mean[bsdf, s]) < 4 * error
