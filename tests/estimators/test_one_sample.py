"""One-sample model: mixture sampling with the balance heuristic, exact variances, invalid input."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import DensityError, ParameterError

CUBIC = mcs.integrand("polynomial(coefficients=[1, -3, 0, 3])", dims=1)
PAIR = ["uniform", "linear(slope=0.8)"]
CHANCE = (0.3, 0.7)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(60)
X, DX = (NODES + 1) / 2, WEIGHTS / 2  # 60 nodes are exact for the smooth functions below
F, P = 1 - 3 * X + 3 * X**3, np.stack([np.ones(60), 1 + 0.8 * (X - 0.5)])


def _variance(weights):
    """Compute Σ_t ∫ (w_t f)²/(P_t p_t) − (∫ f)² for one point."""
    return sum(
        ((w * F) ** 2 / (chance * p) * DX).sum()
        for w, chance, p in zip(weights, CHANCE, P, strict=True)
    ) - ((F * DX).sum() ** 2)


@pytest.mark.parametrize("selection", ["extra", "coordinate"])
@pytest.mark.parametrize("beta", [0.0, 0.5, 1.0, 2.0, 5.0])
def test_exact_variance_is_the_quadrature_of_the_definition(selection, beta):
    e = mcs.estimators.OneSampleMIS(
        CUBIC, PAIR, CHANCE, heuristic=f"power(beta={beta})", selection=selection, dims=1
    )
    q = (np.array(CHANCE)[:, None] * P) ** beta
    expected = _variance(q / q.sum(axis=0)) / 6
    assert mcs.exact_variance(e, "random", 6) == pytest.approx(expected, rel=2e-6)


def test_balance_is_the_mixture_and_the_best():
    """The variance of mixture sampling is ∫f²/Σ P p − I²; all other weights have more."""
    balance = mcs.estimators.OneSampleMIS(CUBIC, PAIR, CHANCE, dims=1)
    mixture = ((F**2 / (np.array(CHANCE) @ P)) * DX).sum() - (F * DX).sum() ** 2
    exact = mcs.exact_variance(balance, "random", 1)
    assert exact == pytest.approx(mixture, rel=1e-6)
    for heuristic in ("power", "power(beta=0)", "cutoff(alpha=0.45)", "maximum", "variance-aware"):
        other = mcs.estimators.OneSampleMIS(CUBIC, PAIR, CHANCE, heuristic=heuristic, dims=1)
        assert mcs.exact_variance(other, "random", 1) >= exact * (1 - 1e-6)
    optimal = mcs.estimators.OneSampleMIS(
        CUBIC, PAIR, CHANCE, heuristic="optimal(pilot='quadrature')", dims=1
    )
    root = np.sqrt(np.array(CHANCE) @ P)
    alpha, *_ = np.linalg.lstsq((P * np.sqrt(DX) / root).T, F * np.sqrt(DX) / root, rcond=None)
    left = (((F - alpha @ P) / root) ** 2 * DX).sum()
    assert mcs.exact_variance(optimal, "random", 1) == pytest.approx(left, rel=1e-5)
    assert left < exact


@pytest.mark.parametrize("selection", ["extra", "coordinate"])
def test_balance_is_the_mixture_density_point_by_point(selection):
    parts = f"parts={PAIR}, weights={list(CHANCE)}, selection={selection!r}"
    mixed = mcs.Estimator(CUBIC, mcs.density(f"mixture({parts})", dims=1))
    e = mcs.estimators.OneSampleMIS(CUBIC, PAIR, CHANCE, selection=selection, dims=1)
    u = np.random.default_rng(1).random((3, 200, e.dims))
    np.testing.assert_allclose(e.warp(0, u), mixed.warp(0, u), atol=1e-14)
    np.testing.assert_allclose(e.primary_values(0, u), mixed.primary_values(0, u), rtol=1e-12)


@pytest.mark.parametrize("heuristic", ["balance", "maximum", "optimal", "variance-aware"])
@pytest.mark.parametrize("sampler", ["random", "jittered", "sobol | owen"])
def test_estimates_are_unbiased(heuristic, sampler):
    e = mcs.estimators.OneSampleMIS(CUBIC, PAIR, CHANCE, heuristic=heuristic, dims=1)
    d = mcs.convergence(e, sampler, [16], realizations=3000, rng=4)
    assert abs(float(d["bias"][0])) < 4.5 * float(d["mean_se"][0])


@pytest.mark.parametrize("heuristic", ["balance", "power", "optimal"])
@pytest.mark.parametrize("space", ["domain", "primary"])
def test_terms_keep_the_identity_in_both_views(heuristic, space):
    e = mcs.estimators.OneSampleMIS(CUBIC, PAIR, CHANCE, heuristic=heuristic, dims=1)
    d = mcs.variance_terms(
        e, "jittered", 16, half_width=6, realizations=40, space=space, engine="direct"
    )
    total = float(d["dc_term"] + d["power_term"] + d["cross_term"])
    assert total == pytest.approx(float(d["truncated_variance"][-1]), rel=1e-10)
    t = mcs.technique_terms(
        e, "jittered", 16, half_width=6, realizations=40, space=space, engine="direct"
    )
    assert float(t["technique_power_term"].squeeze()) == pytest.approx(float(d["power_term"]))


def test_channels_and_2d():
    f = mcs.Integrand.from_function(lambda x: x * x[..., :1], dims=2)
    densities = ["uniform", "linear(slope=1)"]
    for heuristic in ("balance", "optimal"):
        e = mcs.estimators.OneSampleMIS(f, densities, heuristic=heuristic)
        assert (e.dims, e.domain_dims, e.channels) == (3, 2, 2)
        d = mcs.convergence(e, "random", [16], realizations=2000)
        z = np.abs(d["mean"][0] - [1 / 3, 1 / 4]) / d["mean_se"][0]
        assert (z < 4.5).all()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"probabilities": [0.5]}, "list of 2"),
        ({"probabilities": 0.5}, "list of 2"),
        ({"probabilities": [0.5, 0.4]}, "sum 1"),
        ({"probabilities": [1.0, 0.0]}, "greater than 0"),
        ({"selection": "last"}, "extra"),
    ],
)
def test_bad_input(options, words):
    with pytest.raises(ParameterError, match=words):
        mcs.estimators.OneSampleMIS(CUBIC, PAIR, dims=1, **options)


def test_bad_parts():
    with pytest.raises(ParameterError, match="one or more"):
        mcs.estimators.OneSampleMIS(CUBIC, [])
    with pytest.raises(DensityError, match="would miss"):
        mcs.estimators.OneSampleMIS(CUBIC, ["piecewise-constant(values=[0, 1])"] * 2)
    e = mcs.estimators.OneSampleMIS(CUBIC, PAIR, dims=1)
    with pytest.raises(ParameterError, match="2 dims"):
        mcs.convergence(e, mcs.sampler("jittered", dims=1), [4])
