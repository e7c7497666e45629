"""Every row of the table of exact variances: quadrature, and simulation within 4 σ."""

import math

import numpy as np
import pytest

import mcspectra as mcs

REALIZATIONS = 4000


@pytest.fixture(autouse=True)
def small(few_probes):
    """Search functions for details at few points; none of them has small details."""


def _fraction(x):
    return x - math.floor(x)


def _measured(estimator, sampler, n, expected, *, rng=1, sigmas=4.0):
    """Check that the measured variance agrees within `sigmas` of its own standard error."""
    d = mcs.convergence(estimator, sampler, [n], realizations=REALIZATIONS, rng=rng)
    low, high = d["variance_ci"].values[0]
    relative_se = math.log(high / low) / (2 * 1.959963984540054)
    pull = math.log(float(d["variance"][0]) / expected) / relative_se
    assert abs(pull) < sigmas, (float(d["variance"][0]), expected, pull)


X1 = mcs.Estimator("linear", dims=1)
X2 = mcs.Estimator("linear", dims=2)


@pytest.mark.parametrize("n", [4, 25, 100])
@pytest.mark.parametrize(
    ("estimator", "sampler", "formula"),
    [
        (X1, "random", lambda n: 1 / (12 * n)),
        (X1, "jittered", lambda n: 1 / (12 * n**3)),
        (X1, "jittered | shift", lambda n: 1 / (6 * n**2) - 1 / (12 * n**3)),
        (X2, "jittered", lambda n: 1 / (12 * n**2)),
        (X2, "jittered | shift", lambda n: n**-1.5 / 6 - n**-2 / 12),
    ],
)
def test_ramp(estimator, sampler, formula, n):
    assert mcs.exact_variance(estimator, sampler, n) == pytest.approx(formula(n), rel=1e-6)
    _measured(estimator, sampler, n, formula(n))


def test_step_at_a_random_place_1d():
    """1[x<a], a uniform: regular midpoints 1/(12n²), jittered 1/(6n²) on average over a."""
    n = 8
    rng = np.random.default_rng(5)
    places = rng.random(4000)
    regular = mcs.sampler("regular", dims=1).draw(n)[0, :, 0]
    errors = np.array([(regular < a).mean() - a for a in places])
    squares = errors**2
    assert abs(squares.mean() - 1 / (12 * n**2)) < 4 * squares.std() / math.sqrt(places.size)
    exact = np.array(
        [
            mcs.exact_variance(mcs.Estimator(f"step(at={a})", dims=1), "jittered", n)
            for a in places[:200]
        ]
    )
    assert np.allclose(
        exact, [_fraction(a * n) * (1 - _fraction(a * n)) / n**2 for a in places[:200]]
    )
    assert abs(exact.mean() - 1 / (6 * n**2)) < 4 * exact.std() / math.sqrt(exact.size)
    for a in (0.3, 0.77):
        expected = _fraction(a * n) * (1 - _fraction(a * n)) / n**2
        _measured(mcs.Estimator(f"step(at={a})", dims=1), "jittered", n, expected)


@pytest.mark.parametrize("n", [400, 1000])
def test_smoothed_step_1d(n):
    """Ramp of width δ: → 1/(12 δ n³) once n ≫ 1/δ."""
    width = 0.2
    estimator = mcs.Estimator(f"smoothed-step(at=0.437, width={width})", dims=1)
    exact = mcs.exact_variance(estimator, "jittered", n)
    # Two strata contain the knees: a relative difference of at most 2 of the δn strata inside
    assert exact == pytest.approx(1 / (12 * width * n**3), rel=2 / (width * n))
    _measured(estimator, "jittered", n, exact)


@pytest.mark.parametrize("n", [7, 64])
def test_two_techniques_the_slowest_wins(n):
    """½x + ½·1[x<a], each half as a technique: 1/(48n³) + {an}(1−{an})/(4n²)."""
    a = 0.371
    half_ramp = mcs.integrand("linear(gradient=[0.5])", dims=1)
    half_step = mcs.Integrand.from_function(lambda x: 0.5 * (x[..., 0] < a), dims=1, integral=a / 2)
    estimator = mcs.estimators.TechniqueSum([half_ramp, half_step])
    expected = 1 / (48 * n**3) + _fraction(a * n) * (1 - _fraction(a * n)) / (4 * n**2)
    _measured(estimator, "jittered", n, expected)


@pytest.mark.parametrize("n", [16, 100])
def test_step_2d(n):
    """1[x<a] in 2-D, jittered: n^-1.5 {a√n}(1−{a√n})."""
    a = 0.3127
    part = _fraction(a * math.sqrt(n))
    expected = n**-1.5 * part * (1 - part)
    estimator = mcs.Estimator(f"step(at={a})", dims=2)
    assert mcs.exact_variance(estimator, "jittered", n) == pytest.approx(expected, rel=1e-9)
    _measured(estimator, "jittered", n, expected)


def test_smooth_2d_tends_to_the_gradient_formula():
    """Any smooth f, jittered: → (1/(12n²)) ∫|∇f|²; here f = exp(−x²−y²)."""
    estimator = mcs.Estimator("christensen-gaussian")
    node, weight = np.polynomial.legendre.leggauss(40)
    x = 0.5 * (node + 1)
    w = np.outer(weight, weight) / 4
    g = np.exp(-2 * (x[:, None] ** 2 + x[None, :] ** 2)) * 4 * (x[:, None] ** 2 + x[None, :] ** 2)
    limit = float((w * g).sum()) / 12
    for n in (64, 1024):
        exact = mcs.exact_variance(estimator, "jittered", n)
        # The next term is smaller by O(side²) = O(1/n), with second derivatives of order 1
        assert exact == pytest.approx(limit / n**2, rel=2 / n)
    _measured(estimator, "jittered", 1024, limit / 1024**2)


def test_disk_2d():
    """Disk of radius R, generic center: 1.0428109·R·n^-1.5; centered R = ¼: 0.80 to 0.87 of it."""
    radius, sides = 0.2371, 200
    n = sides * sides
    values = []
    rng = np.random.default_rng(3)
    for _ in range(12):
        centre = (0.5 + 0.02 * rng.random(2)).tolist()
        disk = mcs.Estimator(f"disk(center={centre}, radius={radius})")
        values.append(mcs.exact_variance(disk, "jittered", n) * n**1.5)
    mean, se = np.mean(values), np.std(values, ddof=1) / math.sqrt(len(values))
    assert abs(mean - 1.0428109 * radius) < 4 * se + 1e-3 * radius
    centred = mcs.Estimator("disk(radius=0.25)")
    # 0.796, 0.840, 0.874 at these n; it approaches 1 slowly (0.897 at n = 4096)
    for n in (256, 576, 1024):
        ratio = mcs.exact_variance(centred, "jittered", n) * n**1.5 / (1.0428109 * 0.25)
        assert 0.79 < ratio < 0.88
    exact = mcs.exact_variance(centred, "jittered", 256)
    _measured(centred, "jittered", 256, exact)


def test_squared_over_linear_density():
    """f = x², p = 2x, random: 1/(72n), although Var(S_0) is infinite."""
    estimator = mcs.Estimator(
        mcs.Integrand.from_function(lambda x: x[..., 0] ** 2, dims=1, integral=1 / 3),
        "linear(slope=2)",
    )
    assert mcs.exact_variance(estimator, "random", 5) == pytest.approx(1 / 360, rel=1e-9)
    _measured(estimator, "random", 5, 1 / 360)


@pytest.mark.parametrize(
    ("sampler", "dims", "n", "density"),
    [
        ("regular | shift", 1, 8, None),
        ("regular | shift", 2, 16, "linear(slope=1)"),
        ("jittered | strata-shift(offset=0.3)", 1, 8, "linear(slope=1)"),
        ("jittered | strata-shift(offset=0.3)", 2, 16, None),
    ],
)
def test_other_exact_variances_agree_with_simulation(sampler, dims, n, density):
    estimator = mcs.Estimator(mcs.integrand("gaussian(center=0.3)", dims=dims), density)
    sampler = mcs.sampler(sampler, dims=dims)
    _measured(estimator, sampler, n, mcs.exact_variance(estimator, sampler, n), rng=7)


def test_mis_is_the_sum_over_techniques():
    estimator = mcs.MultipleImportance(
        mcs.integrand("polynomial(coefficients=[0, 0, 1])", dims=1),
        ["uniform", "linear(slope=1.5)"],
        heuristic="power",
        counts=(1, 2),
    )
    for name in ("random", "jittered"):
        _measured(estimator, name, 6, mcs.exact_variance(estimator, name, 6), rng=3)


@pytest.mark.parametrize(
    ("f", "spec", "n"),
    [
        ("cosine(frequency=[1, 2])", "regular | shift", 16),
        ("cosine(frequency=[1, 2])", "uniform-jitter", 16),
        ("cosine(frequency=[2, 1], phase=0.3)", "regular | shift", 9),
    ],
)
def test_frequencies_off_the_dual_lattice_have_exactly_no_variance(f, spec, n):
    assert mcs.exact_variance(mcs.Estimator(f, dims=2), spec, n) == 0.0


def test_small_variances_are_not_taken_for_rounding():
    """Periodic jittered in 1-D: (1 − sinc²(π/n))/2n of the cosine; about 1e-11 here."""
    n, sampler = 4096, mcs.sampler("jittered", dims=1)
    found = mcs.exact_variance(mcs.Estimator("cosine(frequency=1)", dims=1), sampler, n)
    assert found == pytest.approx((1 - np.sinc(1 / n) ** 2) / (2 * n), rel=1e-5)
