"""Terms of techniques: exact sums, closed forms for independent techniques, the bottleneck."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import InfiniteWeightVarianceWarning
from mcspectra.measure.techniques import UNDECIDED

TERMS = ("dc_term", "power_term", "cross_term")
CUBIC = mcs.integrand("polynomial(coefficients=[1, -3, 0, 3])", dims=1)
PAIR = ["uniform", "linear(slope=1.5)"]
# 4^k A has the fractional parts .2 and .8 only: the step has the variance 0.16/(4n²) at n = 4^k
A = 0.3


@dataclass(frozen=True)
class _HalfStep(mcs.Integrand):
    """½·1[x<a]."""

    name: ClassVar[str] = "half-step"
    dims: int = 1

    @property
    def breaks(self):
        return ((A,),)

    def _evaluate(self, x):
        return 0.5 * (x[..., 0] < A)


def _toy():
    """Return ½x + ½·1[x<a], where each term is a technique."""
    return mcs.estimators.TechniqueSum(
        [mcs.integrand("linear(gradient=[0.5])", dims=1), _HalfStep()]
    )


def _toy_variance(n):
    fraction = A * n - math.floor(A * n)
    return 1 / (48 * n**3) + fraction * (1 - fraction) / (4 * n**2)


def _cases():
    pairs = {"independent": "balance", "shared": "maximum", "joint": "optimal"}
    for sets, heuristic in pairs.items():
        yield mcs.MultipleImportance(CUBIC, PAIR, heuristic=heuristic, sets=sets, dims=1)
    yield mcs.MultipleImportance(CUBIC, [*PAIR, "uniform"], counts=(1, 3, 2), dims=1)
    yield mcs.estimators.TechniqueSum([CUBIC, "linear"], sets="shared", dims=1)
    yield mcs.MultipleImportance("gaussian", ["uniform", "linear(slope=1)"], dims=2)
    yield mcs.Estimator(CUBIC, "linear(slope=1)")


VIEWS = [
    pytest.param(e, space, id=f"{space} {e.spec}")
    for e in _cases()
    for space in ("domain", "primary")
    if space == "primary" or e.domain_integrand is not None
]


@pytest.mark.parametrize(("estimator", "space"), VIEWS)
def test_pairs_sum_to_the_terms_of_the_estimator(estimator, space):
    """Sums over pairs of techniques equal the terms and variances of `variance_terms`."""
    options = {"half_width": 5, "realizations": 50, "rng": 3, "space": space, "engine": "direct"}
    d = mcs.technique_terms(estimator, "jittered", 4, **options)
    whole = mcs.variance_terms(estimator, "jittered", 4, **options)
    scale = float(whole["predicted_variance"])
    pairs = ["technique", "technique_other"]
    for term in TERMS:
        assert float(d[term]) == pytest.approx(float(whole[term]), rel=1e-9, abs=1e-11 * scale)
    if space == "domain":
        for term in TERMS:
            total = float(d[f"technique_{term}"].sum(pairs))
            assert total == pytest.approx(float(d[term]), rel=1e-9, abs=1e-11 * scale)
    everything = sum(float(d[f"technique_{term}"].sum(pairs)) for term in TERMS)
    assert everything == pytest.approx(scale, rel=1e-10)
    measured = float(whole["measured_variance"])
    assert float(d["technique_covariance"].sum(pairs)) == pytest.approx(measured, rel=1e-10)
    assert float(d["captured"]) == pytest.approx(float(whole["captured"]), rel=1e-9)
    own = np.diagonal(d["technique_covariance"])
    np.testing.assert_allclose(d["technique_variance"], own, rtol=1e-10)
    for name in ("covariance", "dc_term", "power_term", "cross_term"):
        c = d[f"technique_{name}"].values
        np.testing.assert_allclose(c, c.T, atol=1e-12 * scale)


@pytest.mark.parametrize("basis", ["fourier", "cosine", "walsh"])
def test_terms_equal_brute_force_covariances(basis):
    """The expected terms come from S of both techniques and explicit sums over m and l."""
    e = mcs.MultipleImportance(CUBIC, PAIR, counts=(1, 2), dims=1)
    d = mcs.technique_terms(e, "jittered", 4, half_width=4, realizations=30, basis=basis, rng=1)
    from mcspectra.core.streams import Stream
    from mcspectra.spectra.bases import make_basis

    b = make_basis(basis, 1, 4)
    place, conjugate = b.whole()

    def full(half):
        found = half[..., place]
        return np.where(conjugate, found.conj(), found)

    f = full(b.integrand(CUBIC)[0])[0]
    s = []
    for t, u in enumerate(e.draw(mcs.sampler("jittered", dims=1), 4, Stream.from_rng(1), 0, 30)):
        x = e.warp(t, u)
        transform = b.transform(u.shape[1], "auto", 1e-9)[0]
        s.append(full(transform(x, e.weight(t, x) / u.shape[1])))
    zero = int(np.flatnonzero((place == b.dc) & ~conjugate)[0])
    for t in (0, 1):
        for o in (0, 1):
            c = (s[t] - s[t].mean(0)).T @ (s[o] - s[o].mean(0)).conj() / 29
            matrix = (f.conj()[:, None] * f[None, :] * c).real
            dc = matrix[zero, zero]
            power = np.trace(matrix) - dc
            at = {"technique": t, "technique_other": o}
            expected = {"dc_term": dc, "power_term": power, "cross_term": matrix.sum() - dc - power}
            for term, value in expected.items():
                found = float(d[f"technique_{term}"].sel(at))
                assert found == pytest.approx(value, rel=1e-7, abs=1e-10)


def test_independent_techniques_have_their_own_exact_variances():
    n, realizations = 16, 3000
    d = mcs.technique_terms(_toy(), "jittered", n, half_width=8, realizations=realizations, rng=5)
    exact = [1 / (48 * n**3), 0.16 / (4 * n**2)]
    low, high = d["technique_variance_ci"].values.T
    se = (high - low) / 3.92
    assert (np.abs(d["technique_variance"] - exact) < 4.5 * se).all()
    # The sample covariance of independent values has the variance σ₁²σ₂²/R
    off = float(d["technique_covariance"][0, 1])
    assert abs(off) < 4.5 * np.sqrt(exact[0] * exact[1] / realizations)


def test_shared_sets_give_covariances_between_techniques():
    """For x and −x with the same points, Cov = −Var, and the sum has no variance."""
    g = ["linear", "linear(gradient=[-1])"]
    d = mcs.technique_terms(
        mcs.estimators.TechniqueSum(g, sets="shared", dims=1),
        "random",
        4,
        half_width=4,
        realizations=50,
    )
    c = d["technique_covariance"].values
    assert c[0, 1] == pytest.approx(-c[0, 0], rel=1e-12)
    assert float(d["measured_variance"]) < 1e-30
    assert np.isnan(d["captured"])
    p = d["technique_power_term"].values
    assert p[0, 1] == pytest.approx(-p[0, 0], rel=1e-9)


def test_mis_has_the_rate_of_the_slowest_technique():
    """Variances and rates match the exact formulas, and the bottleneck is the step."""
    ns = [16, 64, 256]
    d = mcs.technique_terms(_toy(), "jittered", ns, half_width=4, realizations=1500, rng=2)
    for n, variance, (low, high) in zip(
        ns, d["measured_variance"].values, d["measured_variance_ci"].values, strict=True
    ):
        assert mcs.exact_variance(_toy(), "jittered", n) == pytest.approx(
            _toy_variance(n), rel=1e-6
        )
        assert abs(variance - _toy_variance(n)) < 4.5 * (high - low) / 3.92
    x, y = np.log(ns), np.log([_toy_variance(n) for n in ns])
    for rate, (low, high), truth in (
        (d["technique_rate"][0], d["technique_rate_ci"][0], -3.0),
        (d["technique_rate"][1], d["technique_rate_ci"][1], -2.0),
        (d["rate"], d["rate_ci"], np.polyfit(x, y, 1)[0]),
    ):
        assert abs(float(rate) - truth) < 4.5 * float(high - low) / 3.92
    assert d.attrs["bottleneck"] == "technique 1"
    assert int(d["bottleneck"]) == 1
    assert float(d["technique_rate_ci"][1, 0]) > float(d["technique_rate_ci"][0, 1])


def test_equal_rates_leave_the_bottleneck_undecided():
    """With a table, both weighted integrands jump and have equal rates: no bottleneck."""
    table = "piecewise-constant(values=[1, 3, 2])"
    e = mcs.MultipleImportance("linear", ["uniform", table], dims=1)
    d = mcs.technique_terms(e, "jittered", [16, 64, 256], half_width=4, realizations=300, rng=1)
    assert d.attrs["bottleneck"] == "undecided"
    assert int(d["bottleneck"]) == UNDECIDED


def test_techniques_without_variance_are_not_the_bottleneck():
    parts = mcs.estimators.TechniqueSum(["constant(value=3)", "linear"], dims=1)
    d = mcs.technique_terms(parts, "jittered", [8, 32, 128], half_width=2, realizations=100)
    assert d.attrs["bottleneck"] == "technique 1"
    assert np.isnan(d["technique_rate"][0])
    still = mcs.estimators.TechniqueSum(["constant(value=3)"] * 2, dims=1)
    quiet = mcs.technique_terms(still, "random", [8, 32], half_width=2, realizations=20)
    assert quiet.attrs["bottleneck"] == "undecided"
    one = mcs.technique_terms(parts, "jittered", [8], half_width=2, realizations=20)
    assert one.attrs["bottleneck"] == "undecided"  # a single count has no rate


def test_counts_and_channels_are_dims_of_the_result():
    f = mcs.Integrand.from_function(lambda x: np.concatenate([x, np.exp(x)], axis=-1), dims=1)
    e = mcs.MultipleImportance(f, PAIR)
    d = mcs.technique_terms(e, "jittered", [4, 16], half_width=4, realizations=3)
    assert np.isnan(d["technique_power_term_se"]).all()
    d = mcs.technique_terms(e, "jittered", [4, 16], half_width=4, realizations=40)
    assert d["technique_covariance"].dims == ("n", "channel", "technique", "technique_other")
    assert d["technique_rate"].dims == ("channel", "technique")
    assert len(d.attrs["bottleneck"].split("; ")) == 2
    same = mcs.convergence(e, "jittered", [4, 16], realizations=40)
    np.testing.assert_allclose(d["measured_variance"], same["variance"], rtol=1e-10)
    np.testing.assert_allclose(d["rate"], same["rate"], rtol=1e-8)


def test_errors_and_captured_intervals_equal_those_of_variance_terms():
    """A single technique has the same errors and the same interval as `variance_terms`."""
    options = {"half_width": 4, "realizations": 80, "rng": 3}
    e = mcs.Estimator(CUBIC, PAIR[0], dims=1)
    d = mcs.technique_terms(e, "jittered", 4, **options)
    whole = mcs.variance_terms(e, "jittered", 4, **options)
    assert float(d["captured_ci"][0]) < float(d["captured"]) < float(d["captured_ci"][1])
    np.testing.assert_allclose(d["captured_ci"], whole["captured_ci"], rtol=1e-6)
    np.testing.assert_allclose(d["technique_power_term_se"], whole["power_term_se"], rtol=1e-6)


def test_infinite_variance_of_weights_gives_a_warning():
    f = mcs.integrand("polynomial(coefficients=[0, 0, 1])", dims=1)
    e = mcs.MultipleImportance(f, ["linear(slope=2)"])
    with pytest.warns(InfiniteWeightVarianceWarning, match="space='primary'"):
        d = mcs.technique_terms(e, "random", 4, half_width=4, realizations=50)
    assert np.isnan(d["technique_dc_term"]).all()
    assert np.isfinite(d["technique_covariance"]).all()


def test_deterministic_sets_have_zero_variance_and_a_note():
    """Terms at rounding level, about 1e-30, are reported as zero."""
    found = mcs.technique_terms("disk", "sobol", [16, 64], realizations=8, half_width=4)
    for name in ("dc_term", "power_term", "cross_term", "predicted_variance", "measured_variance"):
        assert not found[name].values.any(), name
    assert np.isnan(found["captured_ci"].values).all()
    said = "sobol has no variance: add owen or shift, or compare |bias|"
    assert found.attrs["note"] == said
    assert mcs.predict("disk", "sobol", [16], method="all", realizations=8).attrs["note"] == said
