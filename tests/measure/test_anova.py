"""ANOVA parts of variances against closed forms for integrands and for samplers."""

from itertools import combinations

import numpy as np
import pytest
from tests import oracles

import mcspectra as mcs

# Limit of the largest of up to 210 pulls: the Šidák limit at level 1e-4 is 4.9 σ
SIGMAS = 5.0


def _product(a):
    """Return f = Π (1 + a_i (x_i − ½)) and a_i²/12, with σ²_u = Π_{i∈u} a_i²/12."""
    a = np.asarray(a, float)
    return mcs.Integrand.from_function(
        lambda x: np.prod(1 + a * (x - 0.5), axis=-1), dims=len(a), integral=1.0
    ), a**2 / 12


def _sobol_g(a):
    """Return Sobol's g and the factors 1/(3 (1 + a_i)²) of σ²_u.

    g = Π (|4x_i − 2| + a_i)/(1 + a_i), and σ²_u = Π_{i∈u} 1/(3 (1 + a_i)²).
    """
    a = np.asarray(a, float)
    return oracles.sobol_g(a)[0], 1 / (3 * (1 + a) ** 2)


def _axes(label):
    return [int(i) for i in label.split("x")[1:]]


def _check(found, expected, *, name="anova_variance"):
    pull = (found[name].values - expected) / found[f"{name}_se"].values
    assert np.abs(pull).max() < SIGMAS, (found[name].values, expected, pull)


FAST = 0.5 ** np.arange(20)


@pytest.mark.parametrize(
    ("function", "a", "realizations"),
    [
        (_product, [1.0, 0.8, 0.5, 0.3, 0.1], 20_000),
        (_product, 1.5 * FAST, 4_000),
        (_sobol_g, [0.0, 1.0, 4.5, 9.0, 99.0], 20_000),
        (_sobol_g, np.arange(20) * 2.0, 4_000),
    ],
)
def test_variances_of_integrands(function, a, realizations):
    f, part = function(a)
    found = mcs.anova_variances(mcs.Estimator(f), realizations=realizations, rng=3)
    dims, variance = len(part), np.prod(1 + part) - 1
    assert found.sizes["subset"] == dims + dims * (dims - 1) // 2
    expected = np.array([np.prod(part[_axes(u)]) for u in found["subset_label"].values])
    _check(found, expected)
    # The total variance of axis i sums over all u that contain i
    _check(found, part / (1 + part) * (1 + variance), name="total_variance")
    _check(found, variance - expected.sum(), name="higher_order_variance")
    low, high = found["variance_ci"].values
    assert low * 0.9 < variance < high * 1.1
    ratio = found["anova_variance"] / found["anova_share"]
    assert np.allclose(ratio, ratio[0])
    assert float(ratio[0] / found["variance"]) == pytest.approx(1, abs=5 / np.sqrt(realizations))


@pytest.mark.parametrize("function", [_product, _sobol_g])
def test_effective_dimensions(function):
    """Both effective dimensions follow from the known σ²_u: no truncation share is near 99 %."""
    a = [1.5, 1.0, 0.05, 0.01, 0.01] if function is _product else [0.0, 1.0, 30.0, 99.0, 99.0]
    f, part = function(a)
    found = mcs.anova_variances(mcs.Estimator(f), realizations=20_000, rng=1)
    variance = np.prod(1 + part) - 1
    shares = (np.cumprod(1 + part) - 1) / variance
    assert np.allclose(found["truncation_share"], shares, atol=0.02)
    assert float(found["truncation_share"][-1]) == pytest.approx(1.0)
    assert int(found["effective_dimension_truncation"]) == 1 + int(np.argmax(shares >= 0.99)) == 2
    singles = part.sum() / variance
    assert singles < 0.97
    assert int(found["effective_dimension_superposition"]) == 2
    mean = (part / (1 + part)).sum() * (1 + variance) / variance
    assert float(found["mean_dimension"]) == pytest.approx(mean, abs=0.05)


def test_additive_functions_have_dimension_one():
    f = mcs.Integrand.from_function(lambda x: x.sum(axis=-1), dims=6)
    found = mcs.anova_variances(mcs.Estimator(f), realizations=5000, rng=1)
    assert float(found["mean_dimension"]) == pytest.approx(1.0, abs=1e-12)
    assert float(found["anova_share"][:6].sum()) == pytest.approx(1.0, abs=1e-12)
    assert int(found["effective_dimension_superposition"]) == 1
    assert int(found["effective_dimension_truncation"]) == 6
    one = mcs.anova_variances(mcs.Estimator(f), realizations=5000, rng=1, order=1)
    assert one.sizes["subset"] == 6
    assert np.array_equal(one["anova_variance"], found["anova_variance"][:6])


def test_effective_dimensions_above_the_order_are_nan():
    f, _ = _product([6.0] * 5)
    found = mcs.anova_variances(mcs.Estimator(f), realizations=2000, rng=1)
    assert np.isnan(float(found["effective_dimension_superposition"]))
    assert float(found["higher_order_variance"]) > 0


def test_parts_of_random_points_are_those_of_f_divided_by_n():
    f, part = _product([1.0, 0.5, 0.5])
    found = mcs.anova_variances(mcs.Estimator(f), "random", 16, realizations=4000, rng=2)
    expected = [np.prod(part[_axes(u)]) / 16 for u in found["subset_label"].values]
    _check(found, np.array(expected))


def test_latin_hypercubes_reduce_the_parts_of_single_axes():
    """The parts are exact: a single axis has σ²_i/n³, as for jittered points in 1-D."""
    n, a = 8, np.array([1.0, 0.8, 0.6])
    f, part = _product(a)
    found = mcs.anova_variances(mcs.Estimator(f), "latin-hypercube", n, realizations=10_000, rng=2)
    centres = (1 - n**-2) / 12
    pair = 1 / (144 * n) + centres**2 / (n * (n - 1))
    expected = [
        part[u[0]] / n**3 if len(u) == 1 else np.prod(a[u] ** 2) * pair
        for u in map(_axes, found["subset_label"].values)
    ]
    _check(found, np.array(expected))


def test_parts_of_jittered_points_are_exact():
    """The parts follow exactly from the moments of the strata.

    Points with equal numbers share a stratum, so the order of the points must not matter.
    """
    side, a = 4, np.array([1.0, 0.6])
    f, part = _product(a)
    n, between = side**2, part * (1 - side**-2)
    expected = [*(part - between) / n, (part.prod() - between.prod()) / n]
    found = mcs.anova_variances(mcs.Estimator(f), "jittered", n, realizations=10_000, rng=2)
    _check(found, np.array(expected))
    assert np.abs(found["anova_share"] - expected / np.sum(expected)).max() < 0.05


def test_parts_of_two_axes_sum_to_the_variance():
    """In 2-D, the parts up to order 2 sum to the variance.

    The sum differs from the sample variance by the sample value of Cov(I, I'), which is nearly 0.
    """
    f = mcs.Estimator("gaussian(center=[0.3, 0.6], width=0.2)", dims=2)
    found = mcs.anova_variances(f, "jittered", 16, realizations=200, rng=2)
    total = float(found["anova_variance"].sum())
    assert abs(total / float(found["variance"]) - 1) < 5 / np.sqrt(200)
    assert float(found["anova_share"].sum()) == pytest.approx(1.0, abs=1e-12)
    assert abs(float(found["higher_order_variance"])) < 1e-12 * total


def test_parts_equal_the_anova_bands_of_the_spectrum():
    """Rows of the ANOVA band covariance, measured from frequencies, equal the ANOVA variances."""
    f = mcs.Estimator("gaussian(center=[0.3, 0.6], width=0.2)", dims=2)
    found = mcs.anova_variances(f, "latin-hypercube", 16, realizations=10_000, rng=2)
    terms = mcs.variance_terms(
        f, "latin-hypercube", 16, realizations=10_000, rng=5, half_width=16, bands="anova"
    )
    rows = terms["band_covariance"].values.sum(axis=1)[1:]
    # The error of the spectrum is about as large, so the difference has √2 times this error
    pull = (found["anova_variance"].values - rows) / found["anova_variance_se"].values
    assert np.abs(pull).max() < SIGMAS * np.sqrt(2)


def test_given_points_get_random_partners():
    points = np.random.default_rng(0).random((4000, 4, 2))
    f, part = _product([1.0, 0.5])
    found = mcs.anova_variances(
        mcs.Estimator(f), mcs.Sampler.from_points(points), 4, realizations=4000
    )
    _check(found, np.array([part[0], part[1], part[0] * part[1]]) / 4)


def test_techniques_and_channels():
    mis = mcs.MultipleImportance("gaussian", ["uniform", "linear(slope=1)"])
    found = mcs.anova_variances(mis, "jittered", 4, realizations=50)
    assert float(found["anova_share"].sum()) == pytest.approx(1.0)
    two = mcs.Integrand.from_function(lambda x: x * np.array([1.0, 2.0]), dims=2)
    pair = mcs.anova_variances(mcs.Estimator(two), realizations=500)
    assert pair["anova_variance"].dims == ("subset", "channel")
    assert np.allclose(np.diag(pair["anova_share"][:2]), 1.0)
    one = mcs.anova_variances(mcs.Estimator("linear", dims=1), realizations=50)
    assert float(one["anova_share"][0]) == pytest.approx(1.0)
    assert float(one["total_variance"][0]) == pytest.approx(float(one["anova_variance"][0]))


def test_shares_of_a_constant_are_nan():
    found = mcs.anova_variances(mcs.Estimator("constant", dims=3), realizations=10)
    assert np.isnan(found["anova_share"]).all()
    assert np.isnan(float(found["effective_dimension_truncation"]))


def test_intervals_of_shares_and_dimensions_cover_them():
    """In 100 runs of 300 pairs, 95 % of the intervals of shares and dimensions hold the truth."""
    f, part = _product([1.0, 0.5, 0.2])
    variance = np.prod(1 + part) - 1
    truth = {
        "anova_share": np.array([*part, *(part[[0, 0, 1]] * part[[1, 2, 2]])]) / variance,
        "higher_order_share": part.prod() / variance,
        "mean_dimension": (part / (1 + part)).sum() * (1 + variance) / variance,
        "truncation_share": (np.cumprod(1 + part) - 1)[:2] / variance,
        "effective_dimension_truncation": 3.0,
    }
    inside = {name: [] for name in truth}
    for seed in range(100):
        found = mcs.anova_variances(mcs.Estimator(f), realizations=300, rng=seed)
        for name, value in truth.items():
            low, high = found[f"{name}_ci"].values.reshape(-1, 2)[: np.size(value)].T
            inside[name].append((low <= value) & (value <= high))
    for name, hits in inside.items():
        # Intervals of one run are correlated, so allow 4 binomial σ of 100 independent intervals
        assert np.mean(hits) > 0.95 - 4 * np.sqrt(0.05 * 0.95 / 100), name


def test_effective_dimensions_beyond_the_order_have_no_upper_end():
    f, _ = _product([6.0] * 5)
    found = mcs.anova_variances(mcs.Estimator(f), realizations=2000, rng=1)
    low, high = found["effective_dimension_superposition_ci"].values
    assert np.isinf(high)
    assert low == 2 or np.isinf(low)


@pytest.mark.parametrize(
    "oracle",
    [
        oracles.ishigami(),
        pytest.param(oracles.sobol_g([0.0, 1.0, 4.5, 9.0]), marks=pytest.mark.slow),
    ],
    ids=["ishigami", "g"],
)
def test_intervals_of_sobol_indices_cover_them(oracle):
    """In 200 runs of 500 pairs, 90 to 99 % of the 95 % intervals of each index hold the truth."""
    f, *indices = oracle
    known = np.stack(indices)
    hits = np.zeros_like(known)
    for seed in range(200):
        found = mcs.anova_variances(mcs.Estimator(f), order=1, realizations=500, rng=seed)
        ends = np.stack([found["anova_share_ci"].values, found["total_share_ci"].values])
        hits += (ends[..., 0] <= known) & (known <= ends[..., 1])
    assert (hits >= 0.90 * 200).all(), hits
    assert (hits <= 0.99 * 200).all(), hits


def test_closed_forms_of_sobol_indices_agree_with_quadrature():
    """The closed forms agree with quadrature of f² and with sums of σ²_u over the subsets u."""
    ishigami, first, total = oracles.ishigami(a=5.0, b=0.2)
    square = mcs.Integrand.from_function(lambda x: (ishigami(x) - 2.5) ** 2, dims=3).integral
    alone = mcs.Integrand.from_function(
        lambda x: 25 * (np.sin(np.pi * x[..., 0]) ** 2 - 0.5) ** 2, dims=1
    ).integral
    assert first[1] * square == pytest.approx(alone, rel=1e-9)
    assert first.sum() + total[2] == pytest.approx(1.0, abs=1e-14)
    part = 1 / (3 * (1 + np.arange(5.0)) ** 2)
    sizes = {u: np.prod(part[list(u)]) for s in range(1, 6) for u in combinations(range(5), s)}
    whole = sum(sizes.values())
    _, first, total = oracles.sobol_g(range(5))
    assert first == pytest.approx(part / whole, rel=1e-14)
    held = [sum(v for u, v in sizes.items() if i in u) / whole for i in range(5)]
    assert total == pytest.approx(held, rel=1e-13)


def test_fewer_than_four_realizations_give_no_intervals():
    """With two realizations, both products of deviations are equal: intervals had no width."""
    f = mcs.Estimator("gaussian", dims=2)
    intervals = ("anova_share", "total_share", "mean_dimension", "effective_dimension_truncation")
    for realizations in (2, 3, 4):
        found = mcs.anova_variances(f, realizations=realizations)
        known = realizations == 4
        assert (np.isfinite(found["anova_variance_se"]) == known).all()
        for name in intervals:
            assert (np.isfinite(found[f"{name}_ci"]) == known).all()
        assert (found["anova_share_ci"][:, 1] > found["anova_share_ci"][:, 0]).all() == known
        assert known or f"{realizations} realizations give no error" in found.attrs["note"]


def test_parts_of_groups_follow_the_same_formulas_as_parts_of_axes():
    f, part = _product([1.0, 0.8, 0.5, 0.3, 0.1])
    groups = [1, 0, 1, 2, 0]
    found = mcs.anova_variances(mcs.Estimator(f), groups=groups, realizations=20_000, rng=3)
    of_group = np.array([np.prod(1 + part[np.array(groups) == g]) - 1 for g in range(3)])
    assert found.sizes["axis"] == 3
    _check(found, np.array([np.prod(of_group[_axes(u)]) for u in found["subset_label"].values]))
    variance = np.prod(1 + part) - 1
    _check(found, of_group / (1 + of_group) * (1 + variance), name="total_variance")


@pytest.mark.parametrize("groups", [[0, 1], [0, 0, 2], [1, 1, 1]])
def test_groups_are_numbered_without_gaps(groups):
    f, _ = _product([1.0, 0.8, 0.5])
    with pytest.raises(mcs.McspectraError, match="for each of the 3 axes, numbered from 0"):
        mcs.anova_variances(mcs.Estimator(f), groups=groups)
