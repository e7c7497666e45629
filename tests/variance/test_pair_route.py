"""Variances from pairs of points: against strata quadrature, formulas and simulation."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

import mcspectra as mcs
from mcspectra.core.errors import NoClosedForm, ParameterError
from mcspectra.variance._pair_kernels import pair_sum_1d, pair_sum_2d

MIS = mcs.MultipleImportance(
    mcs.integrand("gaussian(width=0.25)", dims=1),
    [mcs.density("linear(slope=1)", dims=1), mcs.density("linear(slope=-1)", dims=1)],
    counts=(1, 2),
)


def within(found, expected, expected_se=0.0, sigmas=4.0):
    error = abs(float(found["variance"]) - expected)
    return error <= sigmas * np.hypot(float(found["variance_se"]), expected_se)


def simulated(estimator, sampler, n, realizations=4000):
    d = mcs.convergence(estimator, sampler, [n], realizations=realizations, rng=77)
    low, high = d["variance_ci"].values[0]
    variance = float(d["variance"][0])
    return variance, variance * np.log(high / low) / (2 * 1.959963984540054)


@pytest.mark.parametrize(("add", "dims"), [(pair_sum_1d, 1), (pair_sum_2d, 2)])
def test_pair_sums_are_linear_between_entries(add, dims):
    generator = np.random.default_rng(1)
    points, table = generator.random((30, dims)), generator.random((5,) * dims)
    points[:5] = np.round(points[:5] * 5) / 5 % 1  # differences at the entries, and 0
    differences = np.array([points[a] - points[b] for a in range(30) for b in range(a)])
    expected = map_coordinates(table, (differences % 1 * 5).T, order=1, mode="grid-wrap").sum()
    assert add(points, table) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("estimator", "spec", "dims", "n"),
    [
        ("linear", "random", 1, 5),
        ("linear", "jittered", 2, 16),
        ("gaussian(width=0.25)", "jittered", 3, 27),
        ("gaussian(width=0.25)", "jittered(sides=[2, 6])", 2, 12),
        (mcs.Estimator("gaussian", density="linear(slope=1)", dims=1), "jittered", 1, 7),
        (MIS, "jittered", 1, 4),
        (MIS, "random", 1, 4),
    ],
)
def test_known_pairs_give_the_variance_of_strata_quadrature(estimator, spec, dims, n):
    if isinstance(estimator, str):
        estimator = mcs.Estimator(estimator, dims=dims)
    sampler = mcs.sampler(spec, dims=dims)
    found = mcs.variance_from_pair_correlation(estimator, sampler, n)
    exact = mcs.exact_variance(estimator, sampler, n)
    np.testing.assert_allclose(found["variance"], exact, rtol=1e-6)
    assert float(found["variance_se"]) == 0.0
    assert found.attrs["method"] == "known pairs"


@pytest.mark.parametrize(
    ("estimator", "spec", "dims", "n"),
    [
        ("linear", "jittered | shift", 1, 8),
        ("gaussian(width=0.25)", "jittered | shift", 2, 16),
        ("linear", "jittered | shift", 2, 64),
        ("disk", "random | shift", 2, 32),
        (MIS, "jittered | shift", 1, 4),
    ],
)
def test_counted_pairs_agree_with_the_exact_variance(estimator, spec, dims, n):
    if isinstance(estimator, str):
        estimator = mcs.Estimator(estimator, dims=dims)
    sampler = mcs.sampler(spec, dims=dims)
    found = mcs.variance_from_pair_correlation(estimator, sampler, n, realizations=2000, rng=3)
    assert found.attrs["method"] == "counted pairs"
    if spec.startswith("random"):
        exact = mcs.integrand("disk").integral * (1 - mcs.integrand("disk").integral) / n
    else:
        exact = mcs.exact_variance(estimator, sampler, n)
    assert within(found, exact)
    assert float(found["variance_se"]) < 0.1 * exact


@pytest.mark.parametrize(
    ("spec", "n"),
    [("poisson-disk", 64), ("latin-hypercube | shift", 16), ("sobol | owen | shift", 16)],
)
@pytest.mark.parametrize("integrand", ["gaussian(width=0.25)", "disk", "linear"])
def test_counted_pairs_agree_with_simulation(spec, n, integrand):
    estimator = mcs.Estimator(integrand, dims=2)
    found = mcs.variance_from_pair_correlation(estimator, spec, n, rng=3)
    assert within(found, *simulated(estimator, spec, n))


def test_counted_pairs_of_1d_nets():
    estimator = mcs.Estimator("gaussian(width=0.25)", dims=1)
    sampler = mcs.sampler("sobol | owen | shift", dims=1)
    found = mcs.variance_from_pair_correlation(estimator, sampler, 8, realizations=2000, rng=3)
    assert within(found, *simulated(estimator, sampler, 8))


def test_channels_are_kept():
    f = mcs.Integrand.from_function(
        lambda x: np.stack([x[..., 0], 2 * x[..., 0], x[..., 0] ** 2], axis=-1), dims=1
    )
    for spec in ("jittered", "jittered | shift"):
        sampler = mcs.sampler(spec, dims=1)
        found = mcs.variance_from_pair_correlation(mcs.Estimator(f), sampler, 4, realizations=50)
        assert found["variance"].dims == ("channel",)
        first, second, _ = found["variance"].values
        assert second == pytest.approx(4 * first, rel=1e-9)
        assert found["variance_se"].shape == (3,)


@pytest.mark.parametrize("workers", [1, 3])
def test_workers_do_not_matter(workers):
    arguments = ("gaussian", "jittered | shift", 16)
    one = mcs.variance_from_pair_correlation(*arguments, realizations=20, workers=1)
    many = mcs.variance_from_pair_correlation(*arguments, realizations=20, workers=workers)
    assert one.equals(many)


@pytest.mark.parametrize(
    ("spec", "dims", "n"),
    [
        ("sobol", 2, 16),
        ("jittered | strata-shift", 2, 16),
        ("regular | shift", 2, 16),
        ("uniform-jitter", 1, 4),
        ("jittered | shift", 3, 27),
        ("latin-hypercube", 2, 16),
    ],
)
def test_other_sets_are_refused(spec, dims, n):
    estimator = mcs.Estimator("gaussian", dims=dims)
    with pytest.raises(NoClosedForm, match="use exact_variance or variance_terms"):
        mcs.variance_from_pair_correlation(estimator, mcs.sampler(spec, dims=dims), n)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"n": 0}, "n is 0"),
        ({"n": np.nan}, "n is nan"),
        ({"n": 2**20}, "too many pairs"),
        ({"realizations": 0}, "realizations is 0"),
        ({"realizations": 1.5}, "realizations is 1.5"),
    ],
)
def test_bad_input(arguments, sentence):
    given = {"n": 16} | arguments
    with pytest.raises(ParameterError, match=sentence):
        mcs.variance_from_pair_correlation("gaussian", "jittered | shift", **given)
