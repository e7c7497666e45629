"""Heuristics: weights as defined, variances by quadrature, optimal weights, invalid input."""

from functools import cache

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError, UnknownName
from mcspectra.core.streams import Stream
from mcspectra.estimators.heuristics import HEURISTICS, PowerHeuristic, as_heuristic

SQUARE = mcs.integrand("polynomial(coefficients=[0, 0, 1])", dims=1)
CUBIC = mcs.integrand("polynomial(coefficients=[1, -3, 0, 3])", dims=1)  # Changes sign
PAIR = ["uniform", "linear(slope=1.5)"]
TRIPLE = ["linear(slope=-1.5)", "uniform", "linear(slope=1.9)"]
ALL = [
    "balance",
    "power",
    "power(beta=0)",
    "power(beta=0.5)",
    "power(beta=7)",
    "cutoff",
    "cutoff(alpha=0.7)",
    "maximum",
    "optimal",
    "optimal(pilot='quadrature')",
    "variance-aware",
    "variance-aware(pilot='quadrature')",
]

NODES, WEIGHTS = np.polynomial.legendre.leggauss(40)


def _integrate(function, cuts=()):
    """Integrate over [0,1] with 40 nodes in each of 8 panels, cut at `cuts`."""
    ends = np.unique([*np.linspace(0, 1, 9), *cuts])
    low, width = ends[:-1, None], np.diff(ends)[:, None]
    x = (low + width * (NODES + 1) / 2).ravel()
    return (function(x) * (width * WEIGHTS / 2).ravel()).sum(axis=-1)


def _definition(name, q):
    """Compute w_t of q = n_t p_t (T, k) from the definitions, with loops."""
    w = np.zeros_like(q)
    for k in range(q.shape[1]):
        column, top = q[:, k], q[:, k].max()
        if name.startswith("power"):
            beta = as_heuristic(name).beta
            parts = [c**beta if c > 0 else 0.0 for c in column]
        elif name.startswith("cutoff"):
            alpha = as_heuristic(name).alpha
            parts = [c if c >= alpha * top else 0.0 for c in column]
        elif name == "maximum":
            parts = [1.0 if c == top else 0.0 for c in column]
        else:
            parts = list(column)
        w[:, k] = np.array(parts) / sum(parts)
    return w


def _factors(f, pdfs):
    """Compute v_t = second moment / variance of f/p_t."""
    found = []
    for p in pdfs:
        square, mean = _integrate(lambda x, p=p: f(x) ** 2 / p(x)), _integrate(f)
        found.append(square / (square - mean**2))
    return np.array(found)


def _system(f, pdfs, counts):
    """Compute A and b of the optimal weights, and Σ n_t p_t."""

    def q(x):
        return sum(c * p(x) for c, p in zip(counts, pdfs, strict=True))

    a = [[_integrate(lambda x, s=s, t=t: s(x) * t(x) / q(x)) for t in pdfs] for s in pdfs]
    b = [_integrate(lambda x, s=s: f(x) * s(x) / q(x)) for s in pdfs]
    return np.array(a), np.array(b), q


def _reference(f, pdfs, counts, name, n, cuts):
    """Compute Σ_t (1/n_t) (∫ (w_t f)²/p_t − (∫ w_t f)²) of random points."""
    if name.startswith("optimal"):
        a, b, q = _system(f, pdfs, counts)
        return (_integrate(lambda x: f(x) ** 2 / q(x)) - np.linalg.solve(a, b) @ b) / n
    scale = np.array(counts, float)
    if name.startswith("variance-aware"):
        scale = scale * _factors(f, pdfs)
    total = 0.0
    for t, p in enumerate(pdfs):

        def share(x, t=t):
            return _definition(
                name, np.stack([c * s(x) for c, s in zip(scale, pdfs, strict=True)])
            )[t]

        square = _integrate(lambda x, p=p, w=share: (w(x) * f(x)) ** 2 / p(x), cuts)
        mean = _integrate(lambda x, w=share: w(x) * f(x), cuts)
        total += (square - mean**2) / (n * counts[t])
    return total


def _crossings(slopes, counts, alpha):
    """Solve c_s p_s = α c_t p_t for linear densities: exact borders of cutoff and maximum."""
    found = []
    for s, c in zip(slopes, counts, strict=True):
        for t, d in zip(slopes, counts, strict=True):
            slope, level = c * s - alpha * d * t, c * (1 - s / 2) - alpha * d * (1 - t / 2)
            if slope and 0 < -level / slope < 1:
                found.append(-level / slope)
    return found


CASE = (CUBIC, (-1.5, 0, 1.9), (2, 1, 3))


def _estimator(f, slopes, counts, name, **options):
    densities = [f"linear(slope={s})" if s else "uniform" for s in slopes]
    return mcs.MultipleImportance(f, densities, heuristic=name, counts=counts, **options)


def _parts(f, slopes):
    pdfs = [lambda x, s=s: 1 + s * (x - 0.5) for s in slopes]
    return (lambda x: f(x[:, None])), pdfs


@cache
def _exact(name):
    """Exact variance of n = 5 random points, shared by the tests that compare with it."""
    return mcs.exact_variance(_estimator(*CASE, name), "random", 5)


def _estimates(e, sampler, n, realizations):
    return e.estimate(e.draw(mcs.sampler(sampler, dims=1), n, Stream.from_rng(3), 0, realizations))


@pytest.mark.parametrize("name", ALL)
def test_the_exact_variance_is_the_quadrature_of_the_definition_and_that_of_a_simulation(name):
    (f, slopes, counts), n, realizations = CASE, 5, 2000
    exact = _exact(name)
    alpha = getattr(as_heuristic(name), "alpha", 1.0)
    cuts = _crossings(slopes, counts, alpha)
    function, pdfs = _parts(f, slopes)
    expected = _reference(function, pdfs, counts, name, n, cuts)
    # exact_variance has an error of 1e-6; α and v of 4096 pilot points make another estimator
    if name in ("optimal", "variance-aware"):
        assert expected * (1 - 2e-6) < exact or name != "optimal"
        assert exact == pytest.approx(expected, rel=0.05)
    else:
        assert exact == pytest.approx(expected, rel=2e-6)

    # Compare mean and mean square: 24 tests at 4.5 σ
    found = _estimates(_estimator(f, slopes, counts, name), "random", n, realizations)
    assert abs(found.mean() - f.integral) < 4.5 * np.sqrt(exact / realizations)
    squares = (found - f.integral) ** 2
    assert abs(squares.mean() - exact) < 4.5 * squares.std() / np.sqrt(realizations)


@pytest.mark.parametrize("name", [name for name in ALL if "optimal" not in name])
def test_weights_sum_to_one(name):
    densities = [
        "piecewise-constant(values=[0, 1, 3])",
        "piecewise-constant(values=[2, 0, 1])",
        "uniform",
    ]
    e = mcs.MultipleImportance("linear", densities, heuristic=name, counts=(1, 2, 1), dims=1)
    x = np.random.default_rng(1).random((500, 1))
    weights = e.combination.weights(x)
    np.testing.assert_allclose(weights.sum(axis=0), 1, rtol=1e-14)
    assert (weights >= 0).all()
    # A technique that cannot sample x has weight 0, also for β = 0
    pdf = np.stack([p.pdf(x) for p in e.densities])
    assert not weights[pdf == 0].any()


@pytest.mark.parametrize("name", ["balance", "power(beta=0)", "power(beta=200)", "maximum"])
def test_weights_of_extreme_densities_stay_finite(name):
    densities = ["truncated-normal(mean=0.9, sigma=0.03)", "uniform"]
    e = mcs.MultipleImportance("constant", densities, heuristic=name, dims=1)
    x = np.linspace(0, 1, 101)[:, None]
    np.testing.assert_allclose(e.combination.weights(x).sum(axis=0), 1, rtol=1e-12)


def test_family_relations():
    """cutoff(0) = power(1) = balance; cutoff(1) = maximum = power(∞); ties share equally."""
    q = np.random.default_rng(2).random((3, 200))
    make = {name: as_heuristic(name) for name in ("balance", "maximum")}
    for t in range(3):
        balance = make["balance"].ratio(q, t)
        np.testing.assert_allclose(as_heuristic("power(beta=1)").ratio(q, t), balance, rtol=1e-14)
        np.testing.assert_allclose(as_heuristic("cutoff(alpha=0)").ratio(q, t), balance, rtol=1e-14)
        top = make["maximum"].ratio(q, t)
        np.testing.assert_allclose(as_heuristic("cutoff(alpha=1)").ratio(q, t), top)
        apart = np.sort(q, axis=0)[-1] > 1.01 * np.sort(q, axis=0)[-2]
        steep = as_heuristic("power(beta=9000)").ratio(q, t)
        np.testing.assert_allclose(steep[apart], top[apart], atol=1e-12)
    np.testing.assert_allclose(make["maximum"].ratio(np.ones((4, 2)), 1) * 1, 0.25)


def test_optimal_is_never_above_the_others_nor_balance_above_veachs_bound():
    f, _, counts = CASE
    exact = {name: 5 * _exact(name) for name in ALL if name not in ("optimal", "variance-aware")}
    best = exact["optimal(pilot='quadrature')"]
    assert all(best <= value * (1 + 1e-6) for value in exact.values())
    # Veach 1997, Theorem 9.2, for nonnegative weights
    slack = (1 / min(counts) - 1 / sum(counts)) * f.integral**2
    for name, value in exact.items():
        if "optimal" not in name:
            assert exact["balance"] <= value + slack + 1e-12, name


def test_optimal_of_what_the_densities_span_has_no_variance():
    """f = 2 p_0 − p_1 is its own control variate: α = (2, −1)."""
    f = mcs.integrand("linear(gradient=[-1.5], offset=1.75)", dims=1)  # 2 − (1 + 1.5 (x − ½))
    e = mcs.MultipleImportance(f, PAIR, heuristic="optimal", dims=1)
    np.testing.assert_allclose(e.combination.control, [2, -1], atol=1e-9)
    assert _estimates(e, "random", 4, 50) == pytest.approx(1, abs=1e-12)


def test_optimal_alpha_is_the_solution_of_the_normal_equations():
    """α of the direct estimator minimizes ∫ (f − Σ α p)²/q, checked by least squares."""
    e = _estimator(SQUARE, (0, 1.5), (1, 2), "optimal(pilot='quadrature')")
    x = (np.arange(20_000) + 0.5) / 20_000
    p = np.stack([np.ones_like(x), 1 + 1.5 * (x - 0.5)], axis=1)
    root = np.sqrt(p @ [1, 2])[:, None]
    alpha, *_ = np.linalg.lstsq(p / root, x**2 / root[:, 0], rcond=None)
    np.testing.assert_allclose(e.combination.control, alpha, rtol=1e-6)


def test_pilots_are_deterministic_and_close_to_quadrature():
    def control(text):
        return _estimator(CUBIC, (0, 1.5), (1, 1), text).combination.control

    assert np.array_equal(control("optimal"), control("optimal(seed=0)"))
    assert not np.array_equal(control("optimal"), control("optimal(seed=1)"))
    exact = control("optimal(pilot='quadrature')")
    runs = np.array([control(f"optimal(samples=2000, seed={s})") for s in range(40)])
    # α is a ratio of means: consistent, with a bias of O(1/2000) of its spread
    z = (runs.mean(axis=0) - exact) / (runs.std(axis=0, ddof=1) / np.sqrt(40))
    assert np.abs(z).max() < 4


def test_optimal_from_a_poor_pilot_is_unbiased():
    """α from 3 points has a large error, but is fixed before the estimate draws: no bias."""
    for seed in range(3):
        e = _estimator(SQUARE, (0, 1.5), (1, 1), f"optimal(samples=3, seed={seed})")
        means = [e.primary_integrand(t).integral for t in (0, 1)]
        assert sum(means) == pytest.approx(1 / 3, rel=1e-9)


def test_optimal_with_identical_densities_and_with_nothing_to_fit():
    same = mcs.MultipleImportance(SQUARE, ["linear(slope=1)"] * 2, heuristic="optimal", dims=1)
    a, b = same.combination.control
    assert a == pytest.approx(b)
    one = mcs.MultipleImportance(
        SQUARE, ["linear(slope=1)"], heuristic="optimal", counts=(2,), dims=1
    )
    assert mcs.exact_variance(same, "random", 3) == pytest.approx(
        mcs.exact_variance(one, "random", 3), rel=1e-6
    )
    nothing = mcs.MultipleImportance("constant(value=0)", PAIR, heuristic="optimal", dims=1)
    assert not np.asarray(nothing.combination.control).any()
    aware = mcs.MultipleImportance("constant(value=0)", PAIR, heuristic="variance-aware", dims=1)
    assert aware.combination.shares == (1.0, 1.0)


def test_variance_aware_gives_a_perfect_technique_nearly_all():
    f = mcs.integrand("linear(gradient=[1.5], offset=0.25)", dims=1)
    e = mcs.MultipleImportance(f, PAIR, heuristic="variance-aware", dims=1)
    assert e.combination.weights(np.array([[0.3]]))[1, 0] > 1 - 1e-6


def test_each_channel_has_its_own_alpha():
    f = mcs.Integrand.from_function(lambda x: np.concatenate([x, x**3], axis=-1), dims=1)
    e = mcs.MultipleImportance(f, TRIPLE, heuristic="optimal(pilot='quadrature')")
    parts = ["linear", "polynomial(coefficients=[0, 0, 0, 1])"]
    for channel, text in enumerate(parts):
        own = mcs.MultipleImportance(text, TRIPLE, heuristic="optimal(pilot='quadrature')", dims=1)
        np.testing.assert_allclose(
            e.combination.control[:, channel], own.combination.control, atol=1e-6
        )
    mcs.MultipleImportance(f, TRIPLE, heuristic="variance-aware")


def test_both_views_of_optimal_weights_have_the_measured_variance():
    """For smooth periodic f and p, half width 12 contains both completely, so captured is 1."""
    f = mcs.Integrand.from_function(lambda x: np.exp(np.cos(2 * np.pi * (x[..., 0] - 0.2))), dims=1)

    def pdf(x):
        return 1 + 0.5 * np.sin(2 * np.pi * x[..., 0])

    def sample(u):
        x = u.copy()
        for _ in range(60):
            excess = x + (1 - np.cos(2 * np.pi * x)) / (4 * np.pi) - u
            x = np.clip(x - excess / (1 + 0.5 * np.sin(2 * np.pi * x)), 0, 1)
        return x

    p = mcs.Density.from_functions(pdf=pdf, sample=sample, dims=1)
    e = mcs.MultipleImportance(f, ["uniform", p], heuristic="optimal")
    d = mcs.variance_terms(e, "jittered", 4, half_width=24, realizations=60)
    assert float(d["captured"]) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize(
    ("sampler", "sets"),
    [("random", "joint"), ("jittered", "shared"), ("jittered", "joint"), ("sobol | owen", "joint")],
)
def test_sets_keep_estimates_unbiased_and_the_identity(sets, sampler):
    counts = (1, 1) if sets == "shared" else (3, 1)
    e = mcs.MultipleImportance(CUBIC, PAIR, counts=counts, sets=sets, dims=1)
    found = _estimates(e, sampler, 8, 3000)
    assert abs(found.mean() - CUBIC.integral) < 4.5 * found.std() / np.sqrt(3000)
    for space in ("domain", "primary"):
        t = mcs.variance_terms(
            e, sampler, 8, half_width=6, realizations=40, space=space, engine="direct"
        )
        total = float(t["dc_term"] + t["power_term"] + t["cross_term"])
        assert total == pytest.approx(float(t["truncated_variance"][-1]), rel=1e-10)


def test_shared_sets_are_the_same_points_and_joint_ones_split_one_set():
    def draw(sampler, **options):
        e = mcs.MultipleImportance(SQUARE, TRIPLE, dims=1, **options)
        return e.draw(mcs.sampler(sampler, dims=1), 4, Stream.from_rng(1), 5, 2)

    shared = draw("jittered", sets="shared")
    own = mcs.sampler("jittered", dims=1).draw(4, rng=1, first=5, realizations=2)
    assert all(np.array_equal(u, own) for u in shared)
    whole = mcs.sampler("jittered", dims=1).draw(16, rng=1, first=5, realizations=2)
    joint = draw("jittered", sets="joint", counts=(2, 1, 1))
    assert [u.shape for u in joint] == [(2, 8, 1), (2, 4, 1), (2, 4, 1)]
    together = np.sort(np.concatenate(joint, axis=1), axis=1)
    assert np.array_equal(together, np.sort(whole, axis=1))
    # One point of each technique in every four neighbors: each has its own jittered set
    assert np.array_equal(np.floor(np.sort(joint[1][..., 0], axis=1) * 4), [[0, 1, 2, 3]] * 2)
    sequence = mcs.sampler("sobol | owen", dims=1).draw(16, rng=1, first=5, realizations=2)
    runs = draw("sobol | owen", sets="joint", counts=(2, 1, 1))
    assert np.array_equal(np.concatenate(runs, axis=1), sequence)


def test_shared_points_of_opposite_techniques_cancel():
    """x and 1 − x have a constant sum with the same points, but not with independent sets."""
    g = ["linear", "linear(gradient=[-1], offset=1)"]
    shared = mcs.estimators.TechniqueSum(g, sets="shared", dims=1)
    d = mcs.convergence(shared, "random", [4], realizations=100)
    assert float(d["variance"][0]) < 1e-30
    own = mcs.convergence(mcs.estimators.TechniqueSum(g, dims=1), "random", [4], realizations=100)
    assert float(own["variance"][0]) > 0.01
    assert "shared" in shared.spec
    with pytest.raises(mcs.NoClosedForm, match="correlated"):
        mcs.exact_variance(shared, "random", 4)
    with pytest.raises(mcs.NoClosedForm, match="correlated"):
        mcs.predict(shared, "random", [4], method="pair-correlation")


def test_registry_knows_all_and_objects_are_taken():
    assert {name.partition("(")[0] for name in ALL} == set(HEURISTICS)
    e = mcs.MultipleImportance(SQUARE, PAIR, heuristic=PowerHeuristic(beta=3), dims=1)
    assert "power(beta=3.0)" in e.spec


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"heuristic": "blance"}, "Did you mean 'balance'"),
        ({"heuristic": "power(beta=-1)"}, "at least 0"),
        ({"heuristic": "cutoff(alpha=1.5)"}, "at most 1"),
        ({"heuristic": "cutoff(alpha=-0.1)"}, "at least 0"),
        ({"heuristic": "optimal(pilot='guess')"}, "quadrature"),
        ({"heuristic": "optimal(samples=1)"}, "from 2"),
        ({"heuristic": "optimal(samples=1000000000000)"}, "from 2"),
        ({"heuristic": "variance-aware(seed=-1)"}, "seed"),
        ({"heuristic": 2}, "spec string"),
        ({"sets": "share"}, "shared"),
        ({"sets": "shared", "counts": (1, 2)}, "equal counts"),
    ],
)
def test_bad_input(options, words):
    with pytest.raises(ParameterError, match=words):
        mcs.MultipleImportance(SQUARE, PAIR, dims=1, **options)


def test_bad_objects():
    with pytest.raises(ParameterError, match="finite"):
        PowerHeuristic(beta=-1.0)
    with pytest.raises(UnknownName):
        as_heuristic("no-such-thing")


def test_joint_sets_need_a_count_that_the_sampler_can_make():
    e = mcs.MultipleImportance("gaussian", ["uniform"] * 2, sets="joint", dims=2)
    with pytest.raises(ParameterError, match="The joint set has 2 · 16 points"):
        mcs.convergence(e, "jittered", [16], realizations=2)


@pytest.mark.parametrize(
    ("densities", "dims", "infinite"),
    [
        # 1/p_t diverges for each density, but at opposite ends: the balanced weights are exactly ½
        (["linear(slope=2)", "linear(slope=-2)"], 1, False),
        (["linear(slope=2)", "linear(slope=2)"], 1, True),
        (["linear(slope=2)", "power(exponent=1)"], 2, True),
        # Both densities are 0 only in the corners (0, 1) and (1, 0), where their sum grows like the
        # distance
        (["linear(slope=2)", "linear(slope=-2)"], 2, False),
        (["piecewise-constant(values=[1, 0])", "piecewise-constant(values=[0, 1])"], 1, False),
        (["linear(slope=2)", "uniform"], 1, False),
    ],
)
@pytest.mark.parametrize("make", [mcs.MultipleImportance, mcs.estimators.OneSampleMIS])
def test_weights_are_infinite_only_where_no_density_covers(densities, dims, infinite, make):
    assert make("gaussian(center=0.4)", densities, dims=dims).infinite_weights is infinite
