"""Errors depend on the number of stored sets, not on the number of shifted copies.

Twenty samplers have eight jittered sets each, all different. The standard deviation of a statistic
over the samplers is its true standard error. Each sampler has to estimate it from its eight sets.
"""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.estimators.moments import Moments
from mcspectra.samplers import Shift

SETS, SAMPLERS, N = 8, 20, 64
# A standard deviation of 20 values has an error of 1/√38 = 16 %. Stated errors may be four of these
# below or above it, and up to twice as large in addition, because overestimates are safe
LOW, HIGH = 1.0 - 4 * 0.16, 2.0 * (1.0 + 4 * 0.16)


def statistics(f, sampler, realizations, seed):
    """Return values with their stated standard errors."""
    options = {"realizations": realizations, "rng": seed}
    spectrum = mcs.power_spectrum(sampler, N, half_width=6, **options)
    fit = mcs.spectra.low_frequency_exponent(spectrum, up_to=6)
    low, high = fit["low_frequency_exponent_ci"].values
    pairs = mcs.pair_correlation(sampler, N, bins=20, **options).isel(r=3)
    curve = mcs.convergence(f, sampler, [N], **options)
    least, most = curve["variance_ci"].values[0]
    terms = mcs.variance_terms(f, sampler, N, half_width=6, **options)
    one = mcs.spectra.power_at(sampler, N, [[1, 2]], **options)
    figures = mcs.quality_figures(sampler, N, figures=["relative_minimum_distance"], **options)
    (figure,) = mcs.quality.summarize(figures)
    counted = mcs.predict(
        f, sampler, [N], method="pair-correlation", realizations=realizations, rng=seed
    )
    bottom, top = counted["predicted_variance_ci"].values[0]
    return {
        "counted pairs": (counted["predicted_variance"][0], (top - bottom) / (2 * 2.36)),
        "ring": (spectrum["radial_power"][2], spectrum["radial_power_se"][2]),
        "exponent": (fit["low_frequency_exponent"], (high - low) / 4),
        "pairs": (pairs["pair_correlation"], pairs["pair_correlation_se"]),
        "variance": (
            np.log(curve["variance"][0]),
            np.log(most / least) / (2 * 2.36),
        ),  # Student's t, 7 degrees
        "power term": (terms["power_term"], terms["power_term_se"]),
        "cross term": (terms["cross_term"], terms["cross_term_se"]),
        "listed": (one["power"][0], one["power_se"][0]),
        "quality": (figure.mean, figure.standard_error),
    }


@pytest.mark.parametrize("realizations", [80, pytest.param(160, marks=pytest.mark.slow)])
def test_stated_errors_equal_the_spread_over_disjoint_sets(realizations):
    """Stated errors do not shrink as if all realizations were independent.

    Errors of 80 independent realizations would be √10 too small, which is below the least ratio.
    """
    f = mcs.integrand("disk(center=0.47, radius=0.3)", dims=2)
    points = mcs.sampler("jittered", dims=2).draw(N, realizations=SETS * SAMPLERS, rng=9)
    found = [
        statistics(f, mcs.Sampler.from_points(own).then(Shift()), realizations, seed)
        for seed, own in enumerate(np.split(points, SAMPLERS))
    ]
    for name in found[0]:
        values, errors = np.array([[float(v) for v in each[name]] for each in found]).T
        stated = np.sqrt(np.mean(errors**2))
        assert LOW < stated / np.std(values, ddof=1) < HIGH, name


def test_a_single_stored_set_gives_no_error():
    sampler = mcs.sampler("gaussian-blue-noise(sets=1, iterations=20) | shift", dims=2)
    curve = mcs.convergence("gaussian", sampler, [16], realizations=100)
    assert curve["variance_ci"].values.ravel().tolist() == [0.0, np.inf]
    terms = mcs.variance_terms("gaussian", sampler, 16, half_width=4, realizations=100)
    assert np.isnan(terms["power_term_se"])


def test_merged_groups_equal_the_groups_of_all_values():
    values = np.random.default_rng(1).random((100, 3))
    whole = Moments.of(values, sets=7)
    parts = [Moments.of(values[a:b], first=a, sets=7) for a, b in ((0, 3), (3, 50), (50, 100))]
    joined = parts[0].merge(parts[1]).merge(parts[2])
    for name in ("count", "mean", "m2"):
        np.testing.assert_allclose(getattr(joined.stored, name), getattr(whole.stored, name))
    # The jackknife over groups, computed directly
    label = np.arange(100) % 7
    left = np.array([values[label != k].var(axis=0, ddof=1) for k in range(7)])
    jackknife = np.sqrt(6 / 7 * ((left - left.mean(axis=0)) ** 2).sum(axis=0))
    relative, _ = joined.stored.errors()
    np.testing.assert_allclose(relative * values.var(axis=0, ddof=1), jackknife)


def test_given_sets_that_are_drawn_again_do_not_reduce_the_error():
    """A hundred realizations of five sets have the error of five means."""
    points = np.random.default_rng(2).random((5, 16, 2))
    sampler = mcs.samplers.GivenPoints(points=points, cycle=True)
    curve = mcs.convergence("gaussian", sampler, [16], realizations=100)
    few = mcs.convergence("gaussian", mcs.Sampler.from_points(points), [16], realizations=5)
    assert float(curve["mean_se"][0]) == pytest.approx(float(few["mean_se"][0]), rel=1e-6)
