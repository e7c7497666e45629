"""Halton points: against SciPy, balance in base b, and the law of the permuted digits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from mcspectra.core.errors import ParameterError
from mcspectra.samplers import Halton

LEVEL = 1 - (1 - 1e-6) ** (1 / 8)  # Šidák: 8 statistical tests in this file share 1e-6
SIGMAS = stats.norm.isf(LEVEL / 2)
EPS = np.finfo(float).eps


@pytest.mark.parametrize("dims", [1, 2, 10, 64])
def test_unscrambled_points_are_scipys(dims):
    # SciPy sums digit by digit: at most 10 roundings of numbers below 1 at 1,000 points
    np.testing.assert_allclose(
        Halton(dims=dims).draw(1000)[0],
        qmc.Halton(d=dims, scramble=False).random(1000),
        rtol=0,
        atol=10 * EPS,
    )


def test_skip_leaves_out_the_first_points():
    whole = Halton(dims=5).draw(1000)[0]
    for skip in (1, 7, 500):
        part = Halton(dims=5, skip=skip).draw(500)[0]
        np.testing.assert_allclose(part, whole[skip : skip + 500], rtol=0, atol=EPS)


def test_a_thousand_dims_have_a_thousand_primes():
    second = Halton(dims=1000, skip=1).draw(1)[0, 0]  # radical inverse of 1 is 1/b
    primes = np.rint(1 / second).astype(int)
    assert primes[[0, 1, 2, 3, 999]].tolist() == [2, 3, 5, 7, 7919]
    assert all(p % q for p in primes for q in range(2, int(p**0.5) + 1))


@pytest.mark.parametrize("source", [Halton(dims=3), Halton(dims=3, scramble="permute")])
def test_one_point_in_each_interval_of_its_base(source):
    """The first b^k points hold one in each [a/b^k, (a+1)/b^k), and likewise in boxes (2^i, 3^j)."""
    for j, (base, power) in enumerate([(2, 6), (3, 4), (5, 3)]):
        n = base**power
        x = source.draw(n, realizations=20, rng=1)[..., j]
        # Half an interval's 2^-40 up: plain points sit on the ends of intervals, within rounding
        strata = np.sort(np.floor(x * n + 2.0**-40), axis=1)
        np.testing.assert_array_equal(strata, np.tile(np.arange(n), (len(x), 1)))
    points = source.draw(72, realizations=20, rng=1)
    boxes = np.floor(points[..., :2] * [8, 9] + 2.0**-40) @ [9, 1]
    np.testing.assert_array_equal(np.sort(boxes, axis=1), np.tile(np.arange(72), (20, 1)))


def test_digits_are_permuted_uniformly_and_independently():
    """Base 3: the images of the digits 0, 1, 2 at two positions are 36 equally likely pairs."""
    points = Halton(dims=2, scramble="permute").draw(9, realizations=18_000, rng=2)
    digits = np.floor(points[..., 1] * 9).astype(int)
    first = digits[:, :3] // 3 @ [9, 3, 1]  # indices 0, 1, 2 have the lowest digits 0, 1, 2
    second = digits[:, ::3] % 3 @ [9, 3, 1]  # indices 0, 3, 6 the next
    codes = np.unique(first * 27 + second, return_counts=True)[1]
    assert len(codes) == 36
    assert stats.chisquare(codes).pvalue > LEVEL


def test_the_tail_is_uniform_and_shared():
    n = 27
    x = Halton(dims=2, scramble="permute").draw(n, realizations=4000, rng=3)[..., 1] * n % 1.0
    np.testing.assert_allclose(x, x[:, :1] + np.zeros(n), atol=n * EPS)
    assert stats.kstest(x[:, 0], "uniform").pvalue > LEVEL


@pytest.mark.parametrize("dims", [2, 10])
def test_mean_coordinates_have_the_variance_of_shared_offsets(dims):
    """At n = b^k the mean of coordinate j is (n − 1)/2n + u/n: variance 1/(12 n²) exactly."""
    n = 64
    means = Halton(dims=dims, scramble="permute").draw(n, realizations=5000, rng=4)[..., 0].mean(1)
    # Kurtosis of a uniform law is 9/5: the standard error of its variance is sqrt(0.8/R)
    ratio = means.var(ddof=1) * 12 * n * n
    assert abs(ratio - 1) < SIGMAS * np.sqrt(0.8 / 5000)


def test_permuted_points_beat_random_ones():
    """Christensen et al. (2018): rate −1.9 for exp(−x²−y²); a tenth of 1/n at n = 256 is far above."""
    points = Halton(dims=2, scramble="permute").draw(256, realizations=500, rng=5)
    values = np.exp(-np.square(points).sum(axis=-1))
    assert values.mean(axis=1).var(ddof=1) < 0.1 * values.var() / 256


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"skip": -1}, "skip"),
        ({"skip": 0.5}, "skip"),
        ({"skip": 2**40}, "skip"),
        ({"skip": None}, "skip"),
        ({"scramble": "owen"}, "none, permute"),
        ({"scramble": True}, "none, permute"),
        ({"dims": 1001}, "from 1 to 1000"),
    ],
)
def test_bad_parameters(arguments, words):
    with pytest.raises(ParameterError, match=words):
        Halton(**arguments)
