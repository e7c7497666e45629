"""Deterministic split of a mixture: counts in proportion, and weight 1/p for every point."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.densities import Defensive, Mixture
from mcspectra.estimators import split_mixture

F = mcs.integrand("polynomial(coefficients=[0, 0, 1])", dims=1)
MIX = Mixture(dims=1, parts=["uniform", "linear(slope=1.5)"], weights=[1, 2])


def test_points_weigh_one_over_the_mixtures_pdf():
    e = split_mixture(F, MIX)
    assert e.counts == (1, 2)
    points = e.draw(mcs.sampler("jittered", dims=1), 8, Stream.from_rng(1), 0, 3)
    x, weights = e.weighted_points(points)
    assert x.shape == (3, 24, 1)
    np.testing.assert_allclose(weights, 1 / (24 * MIX.pdf(x)), rtol=1e-14)


def test_the_variance_is_that_of_a_stratified_mixture():
    """Check n Var = ∫ f²/p − Σ_t w_t μ_t² with μ_t = ∫ f p_t/p, for n points in total."""
    x = (np.arange(200_000)[:, None] + 0.5) / 200_000
    p, f = MIX.pdf(x), F(x)
    means = [(f * part.pdf(x) / p).mean() for part in MIX.parts]
    expected = (f**2 / p).mean() - means[0] ** 2 / 3 - 2 * means[1] ** 2 / 3
    found = mcs.exact_variance(split_mixture(F, MIX), "random", 4)
    assert found == pytest.approx(expected / 12, rel=1e-7)
    assert found < mcs.exact_variance(mcs.Estimator(F, MIX), "random", 12)


@pytest.mark.parametrize(
    ("weights", "counts"),
    [
        (None, (1, 1)),
        ([2, 4], (1, 2)),
        ([0.1, 0.9], (1, 9)),
        ([0.3, 0.7], (3, 7)),
        ([1, 999], (1, 999)),
    ],
)
def test_counts_are_the_smallest_in_proportion(weights, counts):
    mixture = Mixture(dims=1, parts=["uniform", "linear"], weights=weights)
    assert split_mixture(F, mixture).counts == counts


def test_defensive_mixtures_and_specs():
    e = split_mixture(F, Defensive(density="tent", dims=1, share=0.2))
    assert e.counts == (4, 1)
    by_spec = split_mixture(F, "defensive(density='tent', share=0.2, selection='extra')")
    assert by_spec.spec == e.spec


@pytest.mark.parametrize(
    ("mixture", "most", "says"),
    [
        ("linear", 100, "not a mixture"),
        (3, 100, "not a density"),
        (
            Mixture(dims=1, parts=["uniform", "linear"], weights=[1, np.pi]),
            1000,
            "no common denominator",
        ),
        (MIX, 2, "no common denominator"),
        (MIX, 0, "most is 0"),
        (Mixture(dims=2, parts=["uniform", "linear"]), 10, "dims"),
    ],
)
def test_bad_mixtures(mixture, most, says):
    with pytest.raises(ParameterError, match=says):
        split_mixture(F, mixture, most=most)
