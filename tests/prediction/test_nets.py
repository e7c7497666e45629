"""Exact variances of scrambled nets and Latin hypercubes: 1-D theory, slow sums, simulation."""

import itertools
import math

import numpy as np
import pytest
from scipy.special import ndtri

import mcspectra as mcs
from mcspectra.prediction.exact import level_variances

REALIZATIONS = 3000


@pytest.fixture(autouse=True)
def small(few_probes):
    """Search functions for details at few points; none of them has small details."""


def _pull(estimator, sampler, n, expected, rng):
    """Return the difference of log variances in standard errors of the measured variance."""
    d = mcs.convergence(estimator, sampler, [n], realizations=REALIZATIONS, rng=rng)
    low, high = d["variance_ci"].values[0]
    se = math.log(high / low) / (2 * ndtri(0.975))
    return math.log(float(d["variance"][0]) / expected) / se


@pytest.mark.parametrize("n", [1, 16, 1024])
@pytest.mark.parametrize("net", ["van-der-corput", "sobol"])
def test_a_scrambled_net_in_1d_is_jittered(n, net):
    """One point in each n-th of the axis, independent and uniform: 1/(12 n³) for f = x."""
    ramp = mcs.Estimator("linear", dims=1)
    found = mcs.exact_variance(ramp, mcs.sampler(f"{net} | owen", dims=1), n)
    assert found == pytest.approx(1 / (12 * n**3), rel=1e-6)
    f = mcs.Estimator("gaussian(center=0.3)", "linear(slope=1)", dims=1)
    assert mcs.exact_variance(f, mcs.sampler(f"{net} | owen", dims=1), n) == pytest.approx(
        mcs.exact_variance(f, "jittered", n), rel=1e-6
    )


@pytest.mark.parametrize(("net", "base"), [("van-der-corput(base=3)", 3), ("faure", 2)])
def test_powers_of_the_base_in_1d(net, base):
    f = mcs.Estimator("gaussian(center=0.3)", dims=1)
    found = mcs.exact_variance(f, mcs.sampler(f"{net} | owen", dims=1), base**3)
    assert found == pytest.approx(mcs.exact_variance(f, "jittered", base**3), rel=1e-6)


@pytest.mark.parametrize("n", [1, 8, 64])
def test_a_digitally_shifted_net_in_1d_is_a_shifted_grid(n):
    """The grid {j/n}, permuted, with one offset uniform in a cell: 1/(12 n²) for f = x."""
    shifted = mcs.sampler("sobol | digital-shift", dims=1)
    found = mcs.exact_variance(mcs.Estimator("linear", dims=1), shifted, n)
    assert found == pytest.approx(1 / (12 * n**2), rel=1e-9)
    f = mcs.Estimator("gaussian(center=0.3)", "linear(slope=1)", dims=1)
    expected = mcs.exact_variance(f, "uniform-jitter", n)
    assert mcs.exact_variance(f, shifted, n) == pytest.approx(expected, rel=1e-6)


def test_additive_functions_add_up():
    """A net with t = 0 is a net along its axes: f = a x + b y has (a² + b²)/(12 n³)."""
    f = mcs.Estimator("linear(gradient=[1, 2])")
    assert mcs.exact_variance(f, "sobol | owen", 64) == pytest.approx(5 / (12 * 64**3), rel=1e-6)


CASES = [
    ("sobol | owen", "gaussian(center=0.3)", None, 2, 16),
    ("sobol | owen", "disk", None, 2, 64),
    ("sobol | owen", "gaussian(center=0.3)", "linear(slope=1)", 2, 12),
    ("sobol | owen(method='hash')", "gaussian(center=0.3)", None, 2, 16),
    ("sobol | owen | digital-shift", "gaussian(center=0.3)", None, 3, 8),
    ("sobol | digital-shift", "gaussian(center=0.3)", None, 2, 16),
    pytest.param(
        *("sobol | digital-shift", "gaussian(center=0.3)", "linear(slope=1)", 2, 8),
        marks=pytest.mark.slow,
    ),
    ("sobol | digital-shift", "step(at=0.3)", None, 2, 8),
    ("sobol | permute", "gaussian(center=0.3)", None, 3, 8),
    ("niederreiter | digital-shift", "gaussian(center=0.3)", None, 2, 12),
    ("larcher-pillichshammer | owen", "gaussian(center=0.3)", None, 2, 32),
    ("halton | owen", "gaussian(center=0.3)", None, 2, 13),
    ("faure | owen", "gaussian(center=0.3)", None, 3, 9),
    ("latin-hypercube", "gaussian(center=0.3)", "linear(slope=1)", 2, 5),
    ("latin-hypercube", "gaussian(center=0.3)", None, 3, 6),
    ("n-rooks", "disk", None, 2, 2),
    ("latin-hypercube | shift", "gaussian(center=0.3)", None, 2, 4),
    pytest.param(
        *("antithetic-jittered", "gaussian(center=0.3)", "linear(slope=1)", 1, 8),
        marks=pytest.mark.slow,
    ),
    ("antithetic-jittered", "gaussian(center=0.3)", None, 2, 18),
    pytest.param(*("antithetic-jittered", "step(at=0.3)", None, 2, 8), marks=pytest.mark.slow),
]


@pytest.mark.filterwarnings("ignore::mcspectra.core.errors.NotPowerOfTwoWarning")
@pytest.mark.parametrize(("sampler", "f", "density", "dims", "n"), CASES)
def test_simulation_agrees(sampler, f, density, dims, n):
    estimator = mcs.Estimator(mcs.integrand(f, dims=dims), density)
    sampler = mcs.sampler(sampler, dims=dims)
    limit = -ndtri(0.5 * (1 - (1 - 1e-3) ** (1 / len(CASES))))
    assert abs(_pull(estimator, sampler, n, mcs.exact_variance(estimator, sampler, n), 5)) < limit


# Made once, because it keeps what quadrature finds
PARABOLA = mcs.Integrand.from_function(lambda x: (x[..., 0] - 0.5) ** 2, dims=1)


@pytest.mark.parametrize("s", [1, 3, 8])
def test_antithetic_pairs_take_away_lines_and_leave_the_second_order(s):
    """x: 0. (x − ½)² in cells of side a = 1/s: the pair's mean is t² + const, t = ±a/2: a⁴/180
    each."""
    sampler = mcs.sampler("antithetic-jittered", dims=1)
    assert mcs.exact_variance("linear", sampler, 2 * s) == pytest.approx(0.0, abs=1e-18)
    found = mcs.exact_variance(PARABOLA, sampler, 2 * s)
    assert found == pytest.approx(s**-5 / 180, rel=1e-6)


def test_scrambled_sequences_are_those_of_the_randomisation():
    for spec in ("halton", "halton(skip=3)"):
        inside = spec.replace("halton", "halton(scramble='owen')", 1).replace(")(", ", ")
        expected = mcs.exact_variance("gaussian", mcs.sampler(f"{spec} | owen", dims=2), 9)
        assert mcs.exact_variance("gaussian", mcs.sampler(inside, dims=2), 9) == expected


@pytest.mark.parametrize("n", [2, 3, 10])
def test_latin_hypercubes_take_single_axes_from_n_cubed_and_products_as_they_are(n):
    """f = x + y: 2/(12 n³). f = (x − ½)(y − ½): the means of strata remain, with mean square
    ((1 − n^-2)/12)² each, and 1/144 in total: (1/n) [1/144 + ((1 − n^-2)/12)² /(n − 1)]."""
    both = mcs.Estimator("linear(gradient=[1, 1])")
    found = mcs.exact_variance(both, "latin-hypercube", n)
    assert found == pytest.approx(2 / (12 * n**3), rel=1e-9)
    product = mcs.Integrand.from_function(lambda x: (x - 0.5).prod(axis=-1), dims=2, integral=0.0)
    expected = (1 / 144 + ((1 - n**-2) / 12) ** 2 / (n - 1)) / n
    assert mcs.exact_variance(product, "latin-hypercube", n) == pytest.approx(expected, rel=1e-9)
    assert mcs.exact_variance(both, "latin-hypercube", 1) == pytest.approx(1 / 6, rel=1e-9)


def test_two_techniques_and_channels():
    two = mcs.Integrand.from_function(
        lambda x: np.stack([x[..., 0], x[..., 0] * x[..., 1]], axis=-1), dims=2
    )
    found = mcs.exact_variance(two, "sobol | owen", 16)
    single = mcs.Integrand.from_function(lambda x: x[..., 0] * x[..., 1], dims=2)
    assert found == pytest.approx(
        [1 / (12 * 16**3), mcs.exact_variance(single, "sobol | owen", 16)], rel=1e-6
    )
    mis = mcs.MultipleImportance(single, ["uniform", "linear(slope=1)"])
    assert abs(_pull(mis, "sobol | owen", 8, mcs.exact_variance(mis, "sobol | owen", 8), 3)) < 4


@pytest.mark.parametrize(("bases", "digits"), [((2,), (3,)), ((3, 2), (1, 2)), ((2, 2), (2, 0))])
def test_levels_are_those_of_the_definition(bases, digits):
    """Compare σ²_l with inclusion and exclusion of mean squares of block means."""
    sides = tuple(b**k for b, k in zip(bases, digits, strict=True))
    values = np.random.default_rng(2).random((*sides, 1))
    found = level_variances(values, bases)[..., 0]

    def blocks(level):
        means = values[..., 0]
        for axis, (b, k, side) in enumerate(zip(bases, level, sides, strict=True)):
            shape = (*means.shape[:axis], b**k, side // b**k, *means.shape[axis + 1 :])
            means = means.reshape(shape).mean(axis=axis + 1)
        return (means**2).mean()

    for level in itertools.product(*(range(k + 1) for k in digits)):
        total = 0.0
        for less in itertools.product(*((0, 1) if k else (0,) for k in level)):
            coarser = tuple(k - c for k, c in zip(level, less, strict=True))
            total += (-1) ** sum(less) * blocks(coarser)
        assert found[level] == pytest.approx(total, abs=1e-14)
    assert found.sum() == pytest.approx((values**2).mean())
