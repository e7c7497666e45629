"""Color: channels with their own densities, with shared points, or with one density for all."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.integrands import Channel


def _colours(x):
    t = x[..., 0]
    return np.stack([1 + t**2, 2 - t + t**2], axis=-1)


F = mcs.Integrand.from_function(_colours, dims=1, integral=[4 / 3, 11 / 6])
OWN = ["linear(slope=0.75)", "linear(slope=-0.5)"]
COUNTS = [8, 16, 32, 64, 128]


def test_shared_points_give_each_channel_the_estimates_of_its_own_estimator():
    together = mcs.convergence(
        mcs.estimators.ChannelSampling(F, OWN, sets="shared"), "jittered", COUNTS[:2], rng=3
    )
    for c, density in enumerate(OWN):
        alone = mcs.convergence(
            mcs.Estimator(Channel(integrand=F, channel=c), density), "jittered", COUNTS[:2], rng=3
        )
        np.testing.assert_allclose(
            together["variance"].isel(channel=c), alone["variance"], rtol=1e-12
        )
        np.testing.assert_allclose(together["mean"].isel(channel=c), alone["mean"], rtol=1e-14)


def test_own_points_have_the_exact_variances_and_are_independent():
    n, realizations = 16, 4000
    own = mcs.convergence(
        mcs.estimators.ChannelSampling(F, OWN), "jittered", [n], realizations=realizations, rng=8
    )
    for c, density in enumerate(OWN):
        scalar = mcs.Estimator(Channel(integrand=F, channel=c), density)
        exact = mcs.exact_variance(scalar, "jittered", n)
        measured = float(own["variance"].isel(channel=c, n=0))
        # The estimates are sums over many strata: kurtosis 3 within 0.1, relative SE √(2/R)
        assert measured == pytest.approx(exact, rel=4.5 * np.sqrt(2.1 / realizations))


@pytest.mark.parametrize(("sets", "expected"), [("independent", 0.0), ("shared", None)])
def test_only_shared_points_tie_the_channels_together(sets, expected):
    estimator = mcs.estimators.ChannelSampling(F, OWN, sets=sets)
    stream = mcs.sampler("random", dims=1)
    from mcspectra.core.streams import Stream

    values = estimator.estimate(estimator.draw(stream, 64, Stream.from_rng(4), 0, 2000))
    correlation = np.corrcoef(values.T)[0, 1]
    if expected is None:
        # f_0/p_0 and f_1/p_1 at the same u have the correlation that quadrature gives
        u = (np.arange(100_000) + 0.5)[:, None] / 100_000
        g = sum(estimator.primary_values(c, u) for c in (0, 1))
        expected = np.corrcoef(g.T)[0, 1]
        assert abs(expected) > 0.2
    assert correlation == pytest.approx(expected, abs=4.5 / np.sqrt(2000))


def test_a_density_with_jumps_costs_the_rate_and_a_density_for_each_channel_does_not():
    ways = mcs.estimators.channel_estimators(F, OWN, "piecewise-constant(values=[2, 3, 4, 4.5, 5])")
    # Use many counts: the position of a jump in its stratum changes with n, and so does the
    # variance
    counts = [16, 23, 32, 45, 64, 91, 128, 181, 256, 362, 512]
    curve = mcs.convergence(list(ways.values()), "jittered", counts, realizations=500, rng=6)
    rates = curve["rate_ci"].assign_coords(estimator=list(ways))
    # 1-D jittered rates: −3 if smooth, −2 with jumps of g inside strata (4/5, 3/5, … are no
    # borders)
    for way in ("own", "shared", "mis"):
        low, high = rates.sel(estimator=way).transpose("bound", "channel").values
        assert (low < -2.8).all()
        assert (high < -2.8).all()
    assert (rates.sel(estimator="one", bound="low") > -2.5).all()
    assert (rates.sel(estimator="one", bound="low") < -2).all()
    assert (rates.sel(estimator="one", bound="high") > -2).all()


def test_every_way_is_unbiased():
    ways = mcs.estimators.channel_estimators(F, OWN, "uniform")
    found = mcs.convergence(list(ways.values()), "random", [16], realizations=4000, rng=9)
    assert (np.abs(found["bias"]) < 4.5 * found["mean_se"]).all()


def test_the_terms_sum_to_the_measured_variance_in_primary_space():
    terms = mcs.variance_terms(
        mcs.estimators.ChannelSampling(F, OWN),
        "jittered",
        8,
        space="primary",
        realizations=200,
        rng=2,
    )
    total = terms["dc_term"] + terms["power_term"] + terms["cross_term"]
    np.testing.assert_allclose(total, terms["predicted_variance"], rtol=1e-12)
    assert terms["predicted_variance"].dims == ("channel",)


def test_luminance_is_the_weighted_sum():
    f = mcs.Integrand.from_function(
        lambda x: np.repeat(x, 3, axis=-1) * [1, 2, 3], dims=1, integral=[0.5, 1, 1.5]
    )
    y = Channel(integrand=f, channel="luminance")
    assert y([[0.5]])[0] == pytest.approx(0.5 * (0.2126 + 2 * 0.7152 + 3 * 0.0722))
    assert y.integral == pytest.approx(y([[0.5]])[0])


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (
            lambda: mcs.estimators.ChannelSampling("linear", ["uniform"], dims=1),
            ParameterError,
            "scalar",
        ),
        (
            lambda: mcs.estimators.ChannelSampling(F, ["uniform"]),
            ParameterError,
            "one for each channel",
        ),
        (lambda: mcs.estimators.ChannelSampling(F, []), ParameterError, "one for each channel"),
        (
            lambda: mcs.estimators.ChannelSampling(F, "uniform"),
            ParameterError,
            "one for each channel",
        ),
        (lambda: mcs.estimators.ChannelSampling(F, [None, None]), ParameterError, "holds None"),
        (
            lambda: mcs.estimators.ChannelSampling(F, OWN, sets="joint"),
            ParameterError,
            "independent",
        ),
        (
            lambda: mcs.estimators.ChannelSampling(
                F, ["uniform", "piecewise-constant(values=[1, 0])"]
            ),
            DensityError,
            r"\[1\]",
        ),
        (lambda: Channel(integrand=F, channel=2), ParameterError, "channel"),
        (lambda: Channel(integrand=F), ParameterError, "luminance needs 3"),
        (
            lambda: Channel(integrand=mcs.integrand("linear", dims=1), channel=0),
            ParameterError,
            "scalar",
        ),
    ],
)
def test_what_cannot_be_gets_a_sentence(make, error, words):
    with pytest.raises(error, match=words):
        make()


def test_a_density_needs_to_cover_its_own_channel_only():
    f = mcs.Integrand.from_function(
        lambda x: np.stack([(x[..., 0] < 0.5) * 1.0, 1 + 0 * x[..., 0]], axis=-1), dims=1
    )
    half = "piecewise-constant(values=[1, 0])"
    assert mcs.estimators.ChannelSampling(f, [half, "uniform"]).channels == 2
    with pytest.raises(DensityError):
        mcs.estimators.ChannelSampling(f, ["uniform", half])
