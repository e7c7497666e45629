"""Statistics of maps compared with one fit per pixel."""

import numpy as np
import pytest
from scipy.stats import norm, t

import mcspectra as mcs
from mcspectra.core.fits import LineFits, fit_rate
from mcspectra.core.streams import Stream
from mcspectra.rendering import map_statistics as statistics
from mcspectra.rendering import map_tiles as prediction
from mcspectra.rendering import maps as results
from mcspectra.rendering.map_tiles import Maps
from mcspectra.samplers import sampler

NS = np.array([4, 9, 16, 36, 64])


def random_curves(strategies=2, height=3, width=4):
    generator = np.random.default_rng(5)
    shape = (strategies, len(NS), height, width)
    slope = generator.uniform(-2, -1, (strategies, 1, height, width))
    noise = np.exp(0.2 * generator.standard_normal(shape))
    variance = NS.reshape(1, -1, 1, 1) ** slope * noise
    return variance, generator.uniform(0.1, 0.3, shape)


def lines(level, rate, se=0.1):
    """The fit of exact lines log V = level + rate · log n, for one pixel."""
    variance = np.exp(level + rate * np.log(NS)).reshape(1, -1, 1, 1)
    return statistics.fit_lines(NS, variance, np.full_like(variance, se), np.ones_like(variance))


def test_lines_agree_with_fits_of_single_curves():
    variance, se = random_curves()
    mean = np.ones_like(variance)
    variance[0, -2:, 0, 0] = 1e-20  # rounding of float32 at large n is ignored
    fits = statistics.fit_lines(NS, variance, se, mean)
    low, high = np.moveaxis(statistics.interval(fits.rate, fits.rate_se), -1, 0)
    floor = np.full(len(NS), 1e-15)
    for place in np.ndindex(2, 3, 4):
        s, y, x = place
        one = fit_rate(NS, variance[s, :, y, x], se[s, :, y, x], floor)
        got = (fits.rate[place], low[place], high[place], fits.chi2[place])
        assert got == pytest.approx((one.rate, *one.interval, one.chi2), rel=1e-12)


def test_missed_variances_give_no_rate():
    variance, se = random_curves()
    variance[0, 0, 1, 1] = 0.0
    variance[1, :4, 2, 2] = 0.0
    variance[1, :, 2, 3] = np.nan
    se[1, 1, 0, 1] = 0.6  # the error of very few realizations
    fits = statistics.fit_lines(NS, variance, se, np.ones_like(variance))
    without = np.isnan(fits.rate)
    assert np.argwhere(without).tolist() == [[0, 1, 1], [1, 0, 1], [1, 2, 2], [1, 2, 3]]
    for other in (fits.rate_se, fits.level):
        assert np.array_equal(without, np.isnan(other))


def test_errors_of_a_line_are_those_of_many_lines():
    # 4000 curves with known errors: rates and levels must scatter by their stated errors.
    generator = np.random.default_rng(2)
    se = np.broadcast_to(np.array([0.1, 0.2, 0.1, 0.3, 0.2]).reshape(1, -1, 1, 1), (1, 5, 1, 4000))
    exact = 3.0 - 1.5 * np.log(NS).reshape(1, -1, 1, 1)
    variance = np.exp(exact + se * generator.standard_normal(se.shape))
    fits = statistics.fit_lines(NS, variance, se, np.ones_like(variance))
    student = 3.182446305284263 / 1.959963984540054  # quantile ratio for three degrees of freedom
    # without the widening by lack of fit: χ²/3 is 2.6049 at 5 %, above which Student's t is used
    wide = np.where(fits.chi2 > 7.814727903251179 / 3, student, 1.0) * np.sqrt(fits.chi2)
    plain = np.maximum(wide, 1.0)
    for value, error, true in (
        (fits.rate, fits.rate_se, -1.5),
        (fits.at(50.0)[0], fits.at(50.0)[1], 3.0 - 1.5 * np.log(50.0)),
    ):
        z = ((value - true) / (error / plain)).ravel()
        assert abs(z.mean()) < 4 / 4000**0.5
        assert abs(z.var() - 1) < 4 * (2 / 4000) ** 0.5


def test_gain_compares_equal_totals():
    better, worse, mis = lines(0.0, -2.0), lines(1.0, -1.5), lines(0.5, -1.5)
    single = LineFits(
        **{
            name: np.concatenate([getattr(worse, name), getattr(better, name)])
            for name in LineFits.__dataclass_fields__
        }
    )
    met = np.zeros((2, 1, 1), bool)
    value, ci = statistics.gain(single, mis, 64, met)
    assert value[0, 0] == pytest.approx(64.0**-2 / (np.exp(0.5) * 32.0**-1.5), rel=1e-12)
    assert ci[0, 0, 0] < value[0, 0] < ci[0, 0, 1]
    assert ci[0, 0].prod() == pytest.approx(value[0, 0] ** 2)
    missing = lines(0.0, -2.0, se=np.nan)
    assert np.isnan(statistics.gain(missing, mis, 64, met[:1])[0]).all()
    # If the better strategy missed light, the other counts; if both did, there is no gain
    alone = statistics.gain(worse, mis, 64, met[:1])[0]
    assert statistics.gain(single, mis, 64, np.array([[[False]], [[True]]]))[0] == alone
    assert np.isnan(statistics.gain(single, mis, 64, ~met)[0]).all()


def test_slowest_needs_an_interval_that_excludes_zero():
    rate = np.array([[[-2.0, -1.0, -1.5, np.nan, np.nan]], [[-1.0, -2.0, -1.6, -1.0, np.nan]]])
    found = statistics.slowest(rate, np.full_like(rate, 0.1))
    assert np.array_equal(found[0], [1, 0, -1, -1, np.nan], equal_nan=True)


def test_slowest_is_decided_where_intervals_still_overlap():
    """1.96 · √2 · 0.1 = 0.277 is sufficient; separate intervals would need 0.392."""
    rate, se = np.array([[[-2.0, -2.0]], [[-1.7, -1.73]]]), np.full((2, 1, 2), 0.1)
    assert np.array_equal(statistics.slowest(rate, se)[0], [1, -1])


@pytest.mark.parametrize("difference", [0.0, 0.2, 0.5, 1.0])
def test_slowest_decides_as_often_as_a_normal_test(difference):
    """Fractions of right, wrong and no decisions, for errors that differ by a factor of 3."""
    count, errors = 20_000, np.array([0.05, 0.15])
    noise = np.random.default_rng(11).standard_normal((2, count, 1))
    se = np.broadcast_to(errors[:, None, None], noise.shape)
    rate = np.array([-2.0, -2.0 + difference])[:, None, None] + noise * se
    found = statistics.slowest(rate, se)
    step = difference / np.hypot(*errors)
    for technique, chance in ((1, norm.cdf(step - 1.96)), (0, norm.cdf(-step - 1.96))):
        spread = (chance * (1 - chance) / count) ** 0.5
        assert abs((found == technique).mean() - chance) <= 4.5 * spread + 1e-4


def test_dominant_needs_an_interval_that_excludes_one():
    variance = np.array([[[4.0, 1.0, 1.1, np.nan, 0.0, 0.0]], [[1.0, 4.0, 1.0, 1.0, 0.0, 1.0]]])
    found = statistics.dominant(variance, np.full_like(variance, 0.2))
    assert np.array_equal(found[0], [0, 1, -1, np.nan, np.nan, 1], equal_nan=True)


@pytest.mark.parametrize("independent", [True, False])
def test_smoothing_is_a_weighted_mean_of_the_window(independent):
    generator = np.random.default_rng(3)
    rate, se = generator.normal(-1.5, 0.2, (2, 5, 6)), generator.uniform(0.1, 0.4, (2, 5, 6))
    rate[0, 2, 3] = se[0, 2, 3] = np.nan
    smooth, error = statistics.smooth(rate, se, 3, independent)
    for s, y, x in np.ndindex(rate.shape):
        window = (s, slice(max(y - 1, 0), y + 2), slice(max(x - 1, 0), x + 2))
        known = np.isfinite(rate[window])
        values, errors = rate[window][known], se[window][known]
        if np.isnan(rate[s, y, x]):
            assert np.isnan(smooth[s, y, x])
            continue
        assert smooth[s, y, x] == pytest.approx(np.average(values, weights=errors**-2))
        together = np.average(errors, weights=errors**-2)
        expected = (errors**-2).sum() ** -0.5 if independent else together
        assert error[s, y, x] == pytest.approx(expected)
    same = statistics.smooth(rate, se, 1, independent)
    assert np.array_equal(same[0], rate, equal_nan=True)


def step(u):
    """Integrands with an edge: u0 + a·u1 < 0.7."""
    return (u[:, :1] + u[:, 1:] * np.linspace(0.2, 1.0, 40) < 0.7).astype(float)


@pytest.mark.parametrize(
    "spec", ["jittered", "random", "jittered | shift", "random | shift", "sobol | owen"]
)
def test_predictions_agree_with_measured_variances(spec):
    points, n, realizations = sampler(spec, dims=2), 64, 4000
    forecast = prediction.prediction_for(points, n, Stream.from_rng(3))
    assert forecast is not None
    predicted, se = forecast.variance(step(forecast.samples))
    drawn = points.draw(n, realizations=realizations, rng=1)
    estimates = step(drawn.reshape(-1, 2)).reshape(realizations, n, -1).mean(axis=1)
    measured = estimates.var(axis=0, ddof=1)
    error = np.hypot(se, measured * (2 / realizations) ** 0.5)
    # limit by Šidák's correction for 40 pixels
    assert (np.abs(predicted - measured) < 4.5 * error).all()
    assert se.mean() < 0.25 * predicted.mean()


def test_gains_include_variation_within_the_cells_of_the_grid():
    """A grid of midpoints misses a quarter of the variance of a smooth integrand."""
    forecast = prediction.prediction_for(sampler("sobol | owen", dims=2), 64, Stream.from_rng(3))
    assert forecast is not None
    predicted, se = forecast.variance(mcs.integrand("gaussian", 2)(forecast.samples)[:, None])
    exact = mcs.exact_variance("gaussian", "sobol | owen", 64)
    assert abs(predicted[0] - exact) < 4.0 * se[0]
    assert se[0] < 0.1 * exact


def test_strata_are_predicted_without_bias():
    # g = u0 in 2 × 2 strata of side ½: every stratum has the variance ¼/12, the estimate a quarter.
    made = [
        prediction.prediction_for(sampler("jittered", dims=2), 4, Stream.from_rng(seed))
        for seed in range(40)
    ]
    found = np.array([p.variance(p.samples[:, :1])[0][0] for p in made if p is not None])
    error = found.std(ddof=1) / len(found) ** 0.5
    assert abs(found.mean() - 1 / 48 / 4) < 4 * error
    assert error < 1e-3 / 48


def test_integrals_of_predictions_have_honest_errors():
    forecast = prediction.prediction_for(sampler("jittered", dims=2), 64, Stream.from_rng(4))
    assert forecast is not None
    mean, se = forecast.mean(step(forecast.samples))
    a = np.linspace(0.2, 1.0, 40)
    # The area of u0 + a·u1 < 0.7 in the unit square; for a > 0.7 the edge leaves at u1 < 1.
    exact = np.where(a < 0.7, 0.7 - a / 2, 0.245 / a)
    assert (np.abs(mean - exact) < 4.5 * se).all()  # limit by Šidák's correction for 40 integrals
    assert (se < 0.01).all()


@pytest.mark.parametrize("spec", ["jittered", "random", "jittered | shift"])
def test_light_that_only_another_technique_hits_is_an_error(spec):
    forecast = prediction.prediction_for(sampler(spec, dims=2), 64, Stream.from_rng(5))
    assert forecast is not None
    u = forecast.samples
    met, size = 1.0 + u[:, :1], len(u)
    mean, se = forecast.mean(met)
    assert np.allclose(prediction.surely(forecast, met), 1.5, rtol=0.01)
    assert (prediction.surely(forecast, met) < mean).all()
    # Within the values' own error: M²/(q n) with q = 1/N.
    short = 2.0 * se
    assert np.allclose(prediction.unmet(forecast, met, mean + short), size * short**2 / 64)
    assert np.isposinf(prediction.unmet(forecast, met, mean + 0.1)).all()
    assert (prediction.unmet(forecast, met, mean - 0.1) == 0.0).all()


def test_strategies_that_hit_less_light_than_another_are_found():
    row = {"light": 0, "bsdf": 1, "mis-light": 2, "mis-bsdf": 3, "mis": 4}
    means = [1.0, 0.5, 0.6, 0.4, 1.0]
    mean = np.array(means).reshape(-1, 1, 1) + np.zeros((5, 1, 3))
    # Student's t at three standard errors: 235.8 with one degree of freedom, 3.03 with 199.
    se = np.array([0.08, 0.085, np.nan]) + np.zeros((5, 1, 3))
    found = results.missed(row, mean, se, 200)
    assert np.argwhere(found).tolist() == [[1, 0, 0]]
    assert not results.missed(row, mean, se, 2).any()
    alone = results.missed({"bsdf": 0}, mean[1:2], se[:1], 200)
    assert not alone.any()


def test_ratios_with_missed_light_are_excluded():
    shape = (1, 1, 3)
    maps = Maps(
        status=np.zeros((1, 3), np.int8),
        mean=np.full((1, 2, 1, 3), 1.0),
        variance=np.full((1, 2, 1, 3), 1.0),
        relative_se=np.full((1, 2, 1, 3), 0.1),
        predicted=np.full(shape, 2.0),
        predicted_se=np.full(shape, 0.1),
        path_variance=np.zeros((2, 1, 3)),
        shares=np.zeros((3, 0, 1, 3)),
        largest=np.zeros((2, 1, 3)),
    )
    maps.predicted_se[0, 0, 2] = np.inf
    found = results._predicted(maps, 0.5, np.array([[[False, True, False]]]))
    assert np.array_equal(found["predicted_ratio"], [[[2.0, np.nan, np.nan]]], equal_nan=True)
    assert np.isnan(found["predicted_ratio_ci"][0, 0, 1:]).all()


def test_unequal_strata_and_three_dims():
    unequal = prediction.prediction_for(sampler("jittered(sides_=(2, 8))", 2), 16, Stream(1))
    assert unequal is not None
    value = unequal.variance(unequal.samples[:, :1])[0][0]
    assert value == pytest.approx(1 / 48 / 16, rel=0.01)
    assert prediction.prediction_for(sampler("jittered", 3), 27, Stream(1)) is not None
    assert prediction.prediction_for(sampler("jittered | shift", 3), 27, Stream(1)) is None
    # Not by a sum that ignores terms between frequencies
    for spec in ("latin-hypercube", "halton | owen", "sobol | digital-shift"):
        assert prediction.prediction_for(sampler(spec, 2), 16, Stream(1)) is None


def test_errors_of_few_strata_use_students_t():
    """If J strata differ equally, there are J degrees of freedom; if one differs, there is one."""
    squares = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    expected = t.ppf(0.975, [1, 4, 1]) / norm.ppf(0.975)
    assert np.allclose(prediction._student(squares), expected, rtol=1e-6)


def chains(count, pixels, seed):
    """f(x) = x₀ + 2 x₁ + 3 x₀ x₁ + 0 x₂ for normal x, the first k from one point: (R, 4, P)."""
    x, y = np.random.default_rng(seed).normal(size=(2, count, 3, pixels))
    mixed = [np.concatenate([x[:, :k], y[:, k:]], axis=1) for k in range(4)]
    return np.stack([z[:, 0] + 2 * z[:, 1] + 3 * z[:, 0] * z[:, 1] for z in mixed], axis=1)


def test_shares_of_a_known_function():
    # Var = 1 + 4 + 9; x₀ alone contributes 1, x₁ adds 4 + 9, and x₂ nothing
    partitions = [np.eye(3, dtype=bool), np.array([[True, False, True], [False, True, False]])]
    whole, shares, largest = statistics.path_shares(chains(1000, 400, 7), partitions)
    expected = np.array([1, 13, 0, 1, 13]) / 14
    share, low, high = shares
    # The mean over independent pixels at 5 σ; the coverage of the intervals at 4 σ
    error = share.std(axis=1) / 20
    assert (np.abs(share.mean(axis=1) - expected) <= 5 * error + 1e-12).all()
    assert abs(whole[0].mean() - 14) < 5 * whole[0].std() / 20
    inside = ((low <= expected[:, None]) & (high >= expected[:, None])).mean(axis=1)
    assert (inside[[0, 1, 3, 4]] > 0.95 - 4 * (0.95 * 0.05 / 400) ** 0.5).all()
    assert np.array_equal(share[2], np.zeros(400))
    np.testing.assert_allclose(share[:3].sum(axis=0), 1.0, rtol=1e-12)
    np.testing.assert_allclose(share[3:].sum(axis=0), 1.0, rtol=1e-12)
    assert (share[0] < 0).any()  # negative estimates are not cut off
    assert np.array_equal(largest, np.ones((2, 400)))


def test_shares_of_equal_parts_have_no_largest():
    x, y = np.random.default_rng(3).normal(size=(2, 64, 2, 2000))
    values = np.stack([y.sum(axis=1), x[:, 0] + y[:, 1], x.sum(axis=1)], axis=1)
    _, _, (largest,) = statistics.path_shares(values, [np.eye(2, dtype=bool)])
    assert (largest == statistics.UNDECIDED).mean() > 0.95 - 4 * (0.95 * 0.05 / 2000) ** 0.5


def test_shares_of_a_single_chain_are_not_reported():
    values = np.zeros((128, 3, 2))
    values[5, 1:, 0] = 1.0
    whole, shares, largest = statistics.path_shares(values, [np.eye(2, dtype=bool)])
    assert whole[0, 0] > 0
    assert np.isnan(shares).all()
    assert np.isnan(largest).all()


def test_the_least_variance_needs_intervals_that_exclude_one():
    variance = np.array([[1.0, 1.0, 1.0, 0.0], [1.2, 3.0, 3.0, 1.0], [3.0, 3.1, 0.1, 1.0]])
    found = statistics.least(variance, np.full((3, 4), 0.1))
    assert np.array_equal(found, [statistics.UNDECIDED, 0.0, 2.0, np.nan], equal_nan=True)
