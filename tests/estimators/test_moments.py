"""Mergeable moments and the interval of the variance."""

import numpy as np
import pytest

from mcspectra.estimators import Moments


def test_merged_moments_are_those_of_all_values():
    values = np.random.default_rng(1).exponential(size=(1000, 3)) + np.array([0.0, 1e6, -3.0])
    whole = Moments.of(values)
    merged = Moments.of(values[:1])
    for start, stop in ((1, 7), (7, 500), (500, 1000)):
        merged = merged.merge(Moments.of(values[start:stop]))
    assert merged.count == 1000
    # 1e6 + noise: second moments keep 1e-16·1e12/1 = 1e-4 at worst of the offset column
    for name, tolerance in (("mean", 1e-14), ("m2", 1e-9), ("m3", 1e-7), ("m4", 1e-7)):
        assert np.allclose(getattr(merged, name), getattr(whole, name), rtol=tolerance), name
    assert np.allclose(whole.variance, values.var(axis=0, ddof=1))


@pytest.mark.parametrize("kind", ["normal", "uniform", "exponential", "bernoulli"])
def test_interval_covers_the_variance(kind):
    """1000 samples of 400: coverage of the 95 % interval, within 5 binomial σ of 93…97 %."""
    rng = np.random.default_rng(2)
    draw, variance = {
        "normal": (lambda s: rng.standard_normal(s), 1.0),
        "uniform": (lambda s: rng.random(s), 1 / 12),
        "exponential": (lambda s: rng.exponential(size=s), 1.0),
        "bernoulli": (lambda s: (rng.random(s) < 0.3).astype(float), 0.21),
    }[kind]
    low, high = Moments.of(draw((400, 1000))).variance_ci.T
    covered = ((low <= variance) & (variance <= high)).mean()
    sigma = np.sqrt(0.05 * 0.95 / 1000)
    # skew data with 400 values: the kurtosis is itself uncertain, which costs a few percent
    assert covered > (0.90 if kind == "exponential" else 0.95) - 5 * sigma


def test_a_single_value_has_no_variance():
    m = Moments.of(np.ones((1, 2)))
    assert np.isnan(m.variance).all()
    assert np.isnan(m.variance_ci).all()


def test_constant_values_have_zero_variance():
    m = Moments.of(np.full((10, 1), 0.1))
    assert m.variance[0] == 0
    assert (m.variance_ci == 0).all()
