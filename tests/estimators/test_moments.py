"""Mergeable moments and the interval of the variance."""

import numpy as np
import pytest

from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.estimators.moments import Measured, Moments


def test_merged_moments_are_those_of_all_values():
    values = np.random.default_rng(1).exponential(size=(1000, 3)) + np.array([0.0, 1e6, -3.0])
    whole = Moments.of(values)
    merged = Moments.of(values[:1])
    for start, stop in ((1, 7), (7, 500), (500, 1000)):
        merged = merged.merge(Moments.of(values[start:stop]))
    assert merged.count == 1000
    # For 1e6 + noise, second moments have an error of 1e-16·1e12/1 = 1e-4 in the offset column at
    # worst
    for name, tolerance in (("mean", 1e-14), ("m2", 1e-9), ("m3", 1e-7), ("m4", 1e-7)):
        assert np.allclose(getattr(merged, name), getattr(whole, name), rtol=tolerance), name
    assert np.allclose(whole.variance, values.var(axis=0, ddof=1))


LAWS = {
    "normal": (lambda rng, s: rng.standard_normal(s), 1.0),
    "uniform": (lambda rng, s: rng.random(s), 1 / 12),
    "exponential": (lambda rng, s: rng.exponential(size=s), 1.0),
    "student": (lambda rng, s: rng.standard_t(5, s), 5 / 3),
    "gumbel": (lambda rng, s: rng.gumbel(size=s), np.pi**2 / 6),
    "two peaks": (lambda rng, s: rng.standard_normal(s) + 4.0 * (rng.random(s) < 0.5), 5.0),
}


@pytest.mark.parametrize("count", [20, 100, 1000])
@pytest.mark.parametrize("law", LAWS)
def test_interval_covers_the_variance(law, count):
    """Of 1000 samples with kurtoses 1.5 to 9, 93 to 97 % of intervals hold, within 3 binomial σ."""
    draw, variance = LAWS[law]
    low, high = Moments.of(draw(np.random.default_rng(2), (count, 1000))).variance_ci.T
    covered = ((low <= variance) & (variance <= high)).mean()
    assert 0.93 - 3 * np.sqrt(0.07 * 0.93 / 1000) < covered < 0.97 + 3 * np.sqrt(0.03 * 0.97 / 1000)


def test_heavier_tails_are_covered_nine_times_in_ten():
    """Lognormal estimates have kurtosis 114; shrinkage to 3 alone covered 54 % of 20 values."""
    values = np.exp(np.random.default_rng(3).standard_normal((20, 2000)))
    low, high = Moments.of(values).variance_ci.T
    truth = np.e * (np.e - 1)
    assert ((low <= truth) & (truth <= high)).mean() > 0.9 - 4 * np.sqrt(0.1 * 0.9 / 2000)


def test_one_value_that_makes_the_variance_bounds_nothing():
    values = np.zeros((20, 3))
    values[3] = [1.0, -1e-3, 1e6]
    found = Moments.of(values)
    assert not found.resolved.any()
    assert np.isinf(found.variance_ci[:, 1]).all()
    assert (found.variance_ci[:, 0] < found.variance).all()
    assert Moments.of(np.random.default_rng(4).random((20, 500))).resolved.all()


def test_a_single_value_has_no_variance():
    m = Moments.of(np.ones((1, 2)))
    assert np.isnan(m.variance).all()
    assert np.isnan(m.variance_ci).all()


def test_constant_values_have_zero_variance():
    m = Moments.of(np.full((10, 1), 0.1))
    assert m.variance[0] == 0
    assert (m.variance_ci == 0).all()


def test_extremes_merge_to_those_of_all_values():
    values = np.random.default_rng(5).standard_normal((1000, 2))
    whole = Moments.of(values, tails=True)
    merged = Moments.of(values[:1], tails=True)
    for start, stop in ((1, 150), (150, 900), (900, 1000)):
        merged = Moments.of(values[start:stop], tails=True).merge(merged)
    np.testing.assert_array_equal(merged.extremes, whole.extremes)
    ordered = np.sort(values, axis=0)
    np.testing.assert_array_equal(whole.extremes, ordered[[*range(64), *range(-64, 0)]])


@pytest.mark.parametrize(
    ("law", "index"), [("exponential", 0.0), ("pareto", 0.4), ("bounded", -0.5)]
)
def test_tail_index_is_that_of_the_law(law, index):
    """Mean of 300 fits to 63 of 20 000 values; a Pareto law of exponent 2.5 has k = 0.4."""
    rng, shape = np.random.default_rng(6), (20_000, 300)
    values = {
        "exponential": lambda: rng.exponential(size=shape),
        "pareto": lambda: rng.pareto(2.5, shape),
        # Density 2x: 0 is farther from the mean than 1, and 1/k = −2 because the density vanishes
        # there
        "bounded": lambda: rng.random(shape) ** 0.5,
    }[law]()
    found = Moments.of(values, tails=True).tail_index
    # The bias of the fit is O(1/63), and |x − mean| is Pareto distributed up to (mean/x)²
    assert abs(found.mean() - index) < 0.06 + 4 * found.std() / np.sqrt(300)


def test_infinite_variance_is_not_resolved():
    """Student's t with 2 degrees: seven of eight samples of 1000 report it; with 5 degrees, 1 in
    11."""
    rng = np.random.default_rng(7)
    heavy, light = (Moments.of(rng.standard_t(df, (1000, 500)), tails=True) for df in (2, 5))
    # 87 and 9 % in 2000 other samples; 4 σ of 500
    assert abs((~heavy.resolved).mean() - 0.87) < 4 * np.sqrt(0.87 * 0.13 / 500)
    assert abs((~light.resolved).mean() - 0.09) < 4 * np.sqrt(0.09 * 0.91 / 500)
    assert np.isinf(heavy.variance_ci[~heavy.resolved, 1]).all()


@pytest.mark.parametrize("count", [300, 500, 1000])
def test_estimates_without_heavy_tails_are_resolved(count):
    """Skewed values whose two sides together look heavy, and shares of hits with coarse last
    steps."""
    rng, shape = np.random.default_rng(8), (count, 1000)
    for values in (
        rng.normal(size=shape),
        rng.random(shape),
        rng.gamma(16, size=shape),
        rng.exponential(size=shape),
        rng.binomial(16, 0.2, shape) / 16,
        rng.binomial(4, 0.1, shape) / 4,
        rng.integers(0, 2, shape) / 1.0,
    ):
        # 1 % of the samples, 4 σ
        assert (~Moments.of(values, tails=True).resolved).mean() < 0.01 + 4 * np.sqrt(0.01 / 1000)


def test_errors_of_differences_and_ratios_add_as_independent_ones_do():
    difference = Measured.normal(5.0, 3.0) - Measured.normal(1.0, 4.0)
    assert difference.value == 4.0
    assert (difference.high - difference.low) / 2 == pytest.approx(5.0 * CONFIDENCE_Z, rel=1e-14)
    ratio = Measured(6.0, 6.0 / np.exp(0.3), 6.0 * np.exp(0.3), log=True) / Measured(
        2.0, 2.0 / np.exp(0.4), 2.0 * np.exp(0.4), log=True
    )
    assert ratio.value == 3.0
    assert np.allclose([ratio.low, ratio.high], [3.0 / np.exp(0.5), 3.0 * np.exp(0.5)], rtol=1e-14)
    zero, unknown = Measured(0.0, 0.0, 0.0), Measured(1.0, 0.5, np.inf)
    assert np.isnan((zero / difference).value)
    assert np.isnan((difference / unknown).high)


@pytest.mark.parametrize("exponent", [0.2, 0.3])
def test_intervals_of_variances_of_heavy_values_cover(exponent):
    """u^−0.3 has no fourth moment: intervals from the kurtosis alone cover 85 %."""
    rng, seeds = np.random.default_rng(1), 400
    truth = 1.0 / (1.0 - 2.0 * exponent) - 1.0 / (1.0 - exponent) ** 2
    ends = [
        Moments.of((1.0 - rng.random(1000)) ** -exponent, tails=True).variance_ci
        for _ in range(seeds)
    ]
    covered = np.mean([low <= truth <= high for low, high in ends])
    assert covered >= 0.95 - 3 * np.sqrt(0.05 * 0.95 / seeds)


def test_a_tail_of_more_values_is_not_resolved_sooner():
    """The share of unresolved runs does not fall with the number of values."""
    rng = np.random.default_rng(2)
    shares = [
        np.mean(
            [
                not Moments.of((1.0 - rng.random(count)) ** -0.3, tails=True).resolved
                for _ in range(600)
            ]
        )
        for count in (1000, 10_000)
    ]
    assert abs(shares[1] - shares[0]) < 4 * np.sqrt(2 * 0.25 / 600)
