"""Standard errors of the terms equal the standard deviation over independent runs."""

import numpy as np
import pytest
from scipy.special import stdtrit

import mcspectra as mcs
from mcspectra.core.records import merged
from mcspectra.measure.sums import RunningSpread, ratio_factors, spread

RUNS = 40
# Relative error of a standard deviation of that many values: 11 %
SPREAD = 1 / np.sqrt(2 * (RUNS - 1))


@pytest.fixture(scope="module")
def runs():
    estimator = mcs.Estimator("gaussian(center=0.3, width=0.3)", "linear(slope=0.8)", dims=1)
    return [
        mcs.variance_terms(estimator, "jittered", 8, half_width=16, realizations=160, rng=seed)
        for seed in range(RUNS)
    ]


@pytest.mark.parametrize("term", ["dc_term", "power_term", "cross_term"])
def test_errors_of_terms_equal_their_spread(runs, term):
    values = np.array([float(d[term]) for d in runs])
    claimed = np.sqrt(np.mean([float(d[f"{term}_se"]) ** 2 for d in runs]))
    # The mean of squared errors is far more precise than their standard deviation.
    # Batches of 8 realizations overestimate by up to √(8/7)
    assert 1 - 4 * SPREAD < claimed / np.std(values, ddof=1) < np.sqrt(8 / 7) * (1 + 4 * SPREAD)


def test_the_interval_of_captured_covers_the_truth(runs):
    """At most 10 of 40 intervals of 95 % miss the value from 50 times as many realizations."""
    estimator = mcs.Estimator("gaussian(center=0.3, width=0.3)", "linear(slope=0.8)", dims=1)
    truth = float(
        mcs.variance_terms(estimator, "jittered", 8, half_width=16, realizations=8000, rng=999)[
            "captured"
        ]
    )
    low, high = np.array([d["captured_ci"].values for d in runs]).T
    missed = np.count_nonzero((truth < low) | (truth > high))
    assert missed <= 10  # binomial(40, 0.05) exceeds 10 with probability 5e-6
    claimed = np.median(np.log(high / low)) / 2 / stdtrit(19, 0.975)
    spread = np.std(np.log([float(d["captured"]) for d in runs]), ddof=1)
    # Intervals are wider if few batches hold most of the error, but less than twice as wide
    assert 1 - 4 * SPREAD < claimed / spread < 2


def test_intervals_of_ratios_cover_under_heavy_weights():
    """Intervals of ratios cover 90 % although the weights have an infinite fourth moment.

    Plain Student intervals covered 75 % of 500 simulations. Here f = exp(−x), p = 1.5 √x, and the
    Fourier sum is truncated at |m| = 2. Quadrature in y, with x = y⁴, gives the true variances.
    """
    m = np.arange(-2, 3)
    coefficients = (1 - np.exp(-1)) / (1 + 2j * np.pi * m)

    def values(x):
        cut = (coefficients * np.exp(2j * np.pi * m * x[..., None])).sum(axis=-1).real
        return np.stack([cut, np.exp(-x)]) / (1.5 * np.sqrt(x))

    y = (np.arange(2**16) + 0.5) / 2**16
    density = 1.5 * np.sqrt(y**4) * 4 * y**3
    first, second = ((values(y**4) ** k * density).mean(axis=1) for k in (1, 2))
    truth = np.divide(*(second - first**2))
    rng, inside = np.random.default_rng(1), []
    for _ in range(500):
        estimates = values(rng.random((100, 8)) ** (2 / 3)).mean(axis=-1)
        above, below = estimates.reshape(2, 20, 5).var(axis=-1, ddof=1)
        ratio = np.divide(*estimates.var(axis=-1, ddof=1))
        low, high = ratio * ratio_factors(above, below, np.full(20, 0.05))
        inside.append(low <= truth <= high)
    assert np.mean(inside) > 0.9 - 4 * np.sqrt(0.1 * 0.9 / 500)


def _merged(blocks, weights):
    """Return the spread of four blocks, merged as (a, b) and (c, d)."""
    a, b, c, d = map(RunningSpread.of, blocks, weights)
    return merged(merged(a, b), merged(c, d))


def test_spread_of_merged_blocks_equals_that_of_all_blocks():
    """The spread of merged blocks equals the spread computed from all blocks at once.

    The blocks have weights w, and their deviations are from the mean with weights w².
    """
    generator = np.random.default_rng(1)
    weights = np.array([3.0, 3.0, 3.0, 1.0])
    values = 50.0 + generator.standard_normal((4, 2, 3)) + 1j * generator.standard_normal((4, 2, 3))
    for blocks in (values.real, values):
        running = _merged(blocks, weights)
        off = blocks - np.average(blocks, axis=0, weights=weights**2)
        squares = np.tensordot((weights / weights.sum()) ** 2, np.abs(off) ** 2, axes=1)
        np.testing.assert_allclose(running.error(), np.sqrt(squares * 4 / 3), rtol=1e-10)
    equal = _merged(values.real, [7] * 4)
    same = spread(values.real - values.real.mean(axis=0), np.full(4, 0.25))
    np.testing.assert_allclose(equal.error(), same, rtol=1e-10)


def _matrix_runs():
    return [
        mcs.variance_terms(
            "gaussian(center=0.3, width=0.3)", mcs.sampler("jittered | mirror", dims=1), 8,
            half_width=4, realizations=160, rng=seed, bands="dyadic", cross_matrix=True,
        )
        for seed in range(RUNS)
    ]  # fmt: skip


def test_errors_of_maps_bands_and_matrices_equal_their_spread():
    runs = _matrix_runs()
    names = ("contribution", "band_covariance", "coefficient_covariance", "cross_matrix")
    for name in names:
        values = np.array([d[name].values for d in runs])
        spread_found = (np.abs(values - values.mean(axis=0)) ** 2).sum(axis=0) / (RUNS - 1)
        claimed = np.mean([d[f"{name}_se"].values ** 2 for d in runs], axis=0)
        some = spread_found > 1e-6 * spread_found.max()  # S_0 = 1 has no variance
        assert some.mean() > 0.5
        ratio = np.sqrt(claimed[some] / spread_found[some])
        # Each spread has an error of 11 %, and there are dozens of them, so allow 5 σ. Batches
        # overestimate by at most √(8/7)
        assert ratio.min() > 1 / (1 + 5 * SPREAD), name
        assert ratio.max() < np.sqrt(8 / 7) / (1 - 5 * SPREAD), name
        assert 1 - 2 * SPREAD < np.median(ratio) < np.sqrt(8 / 7) * (1 + 2 * SPREAD), name


def test_two_batches_have_one_degree_of_freedom():
    """Four realizations make two batches: the quantile of Student's t is 12.7 instead of 1.96."""
    d = mcs.variance_terms("linear", mcs.sampler("random", 1), 4, half_width=4, realizations=4)
    assert d.attrs["batches"] == 2
    low, high = d["power_term_ci"].values
    assert (high - low) / 2 == pytest.approx(12.7062 * float(d["power_term_se"]), rel=1e-5)


def test_three_realizations_give_no_errors_and_four_do():
    estimator = mcs.Estimator("gaussian", dims=1)
    two = mcs.variance_terms(estimator, "jittered", 8, half_width=4, realizations=3)
    assert np.isnan(float(two["cross_term_se"]))
    for name in ("captured_ci", "power_term_ci", "contribution_se", "band_covariance_se"):
        assert np.isnan(two[name]).all()
    assert two.attrs["batches"] == 1
    four = mcs.variance_terms(estimator, "jittered", 8, half_width=4, realizations=4)
    assert float(four["power_term_se"]) > 0


def test_each_channel_has_its_own_error():
    f = mcs.Integrand.from_function(lambda x: np.concatenate([x, 2 * x], axis=-1), dims=1)
    d = mcs.variance_terms(f, "random", 8, half_width=4, realizations=40, rng=1)
    assert d["power_term_se"].dims == ("channel",)
    np.testing.assert_allclose(d["power_term_se"][1] / d["power_term_se"][0], 4.0)
    np.testing.assert_allclose(d["captured_ci"][0], d["captured_ci"][1])
