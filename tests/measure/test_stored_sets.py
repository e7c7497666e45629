"""Errors follow the number of stored sets, however often translations use them again.

Twenty samplers have eight jittered sets each, all different. Over these samplers a statistic spreads by its
true standard error, which each of them has to state from its own eight sets.
"""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.estimators.moments import Moments
from mcspectra.samplers import Shift

SETS, SAMPLERS, N = 8, 20, 64
# The standard deviation of 20 values is known to 1/√38 = 16 %: four errors either way, and twice
# as much room for errors on the safe side
LOW, HIGH = 1.0 - 4 * 0.16, 2.0 * (1.0 + 4 * 0.16)


def statistics(sampler, realizations, seed):
    """Values with the standard errors that are stated of them."""
    options = {"realizations": realizations, "rng": seed}
    f = mcs.integrand("disk(center=0.47, radius=0.3)", dims=2)
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
        "variance": (np.log(curve["variance"][0]), np.log(most / least) / (2 * 2.36)),  # t of 7
        "power term": (terms["power_term"], terms["power_term_se"]),
        "cross term": (terms["cross_term"], terms["cross_term_se"]),
        "listed": (one["power"][0], one["power_se"][0]),
        "quality": (figure.mean, figure.standard_error),
    }


@pytest.mark.parametrize("realizations", [40, 160])
def test_stated_errors_are_the_spread_over_disjoint_sets(realizations):
    """They fell as if all realizations were independent."""
    points = mcs.sampler("jittered", dims=2).draw(N, realizations=SETS * SAMPLERS, rng=9)
    found = [
        statistics(mcs.Sampler.from_points(own).then(Shift()), realizations, seed)
        for seed, own in enumerate(np.split(points, SAMPLERS))
    ]
    for name in found[0]:
        values, errors = np.array([[float(v) for v in each[name]] for each in found]).T
        stated = np.sqrt(np.mean(errors**2))
        assert LOW < stated / np.std(values, ddof=1) < HIGH, name


def test_one_set_tells_no_error_of_its_sampler():
    sampler = mcs.sampler("gaussian-blue-noise(sets=1, iterations=20) | shift", dims=2)
    curve = mcs.convergence("gaussian", sampler, [16], realizations=100)
    assert curve["variance_ci"].values.ravel().tolist() == [0.0, np.inf]
    terms = mcs.variance_terms("gaussian", sampler, 16, half_width=4, realizations=100)
    assert np.isnan(terms["power_term_se"])


def test_groups_merge_as_they_are_made():
    values = np.random.default_rng(1).random((100, 3))
    whole = Moments.of(values, sets=7)
    parts = [Moments.of(values[a:b], first=a, sets=7) for a, b in ((0, 3), (3, 50), (50, 100))]
    joined = parts[0].merge(parts[1]).merge(parts[2])
    for name in ("count", "mean", "m2"):
        np.testing.assert_allclose(getattr(joined.stored, name), getattr(whole.stored, name))
    # Leaving out one group after the other, by hand
    label = np.arange(100) % 7
    left = np.array([values[label != k].var(axis=0, ddof=1) for k in range(7)])
    jackknife = np.sqrt(6 / 7 * ((left - left.mean(axis=0)) ** 2).sum(axis=0))
    relative, _ = joined.stored.errors()
    np.testing.assert_allclose(relative * values.var(axis=0, ddof=1), jackknife)


def test_given_sets_that_are_drawn_again_count_once():
    """A hundred realizations of five sets without randomization: the error of five means."""
    points = np.random.default_rng(2).random((5, 16, 2))
    sampler = mcs.samplers.GivenPoints(points=points, cycle=True)
    curve = mcs.convergence("gaussian", sampler, [16], realizations=100)
    few = mcs.convergence("gaussian", mcs.Sampler.from_points(points), [16], realizations=5)
    assert float(curve["mean_se"][0]) == pytest.approx(float(few["mean_se"][0]), rel=1e-6)
