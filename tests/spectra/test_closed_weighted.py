"""Exact covariances of importance-sampled sets, against simulation and slow quadrature."""

import numpy as np
import pytest
from scipy import integrate, stats

import mcspectra as mcs
from mcspectra.core.errors import InfiniteWeightVarianceWarning

REALIZATIONS = 8000
FREQUENCIES = {
    1: np.array([[0], [1], [-1], [2], [3], [-4], [8]]),
    2: np.array([[0, 0], [1, 0], [0, -1], [1, 1], [-1, 1], [3, 0], [4, -2]]),
}
LINE, BELL = "linear(slope=1)", "truncated-normal(mean=0.3, sigma=0.4)"
STEPS = "piecewise-constant(values=[1, 3, 2])"
PLANE = "linear(slope=[1, -0.5])"
CASES = [
    ("jittered", LINE, 1, 4),
    ("jittered", BELL, 1, 5),
    ("jittered", STEPS, 1, 4),
    ("jittered | shift", LINE, 1, 4),
    ("jittered | shift", STEPS, 1, 4),
    ("jittered | strata-shift(offset=0.3)", LINE, 1, 4),
    ("jittered", PLANE, 2, 9),
    ("jittered(sides=[2, 3])", PLANE, 2, 6),
    ("jittered | shift", PLANE, 2, 4),
    ("jittered | strata-shift(offset=[0.3, 0.8])", BELL, 2, 9),
    ("latin-hypercube", BELL, 1, 4),
    ("latin-hypercube", PLANE, 2, 4),
    ("latin-hypercube | shift", PLANE, 2, 3),
    ("regular | shift", LINE, 1, 4),
    ("regular | shift", STEPS, 1, 4),
    ("uniform-jitter", PLANE, 2, 9),
    ("random", STEPS, 1, 3),
]


def _sums(sampler, density, n, m):
    """Return S_m of each realization minus its exact mean δ_m0: (R, M)."""
    x = density.sample(sampler.draw(n, realizations=REALIZATIONS, rng=3))
    weights = 1 / density.pdf(x)
    s = np.stack([(weights * np.exp(-2j * np.pi * (x @ one))).mean(axis=1) for one in m], axis=1)
    return s - (m == 0).all(axis=1)


@pytest.mark.parametrize(("spec", "p", "dims", "n"), CASES)
def test_simulation_agrees_for_all_pairs(spec, p, dims, n):
    """All C_ml, real and imaginary parts, within errors; all cases form one family of tests."""
    sampler, density = mcs.sampler(spec, dims=dims), mcs.density(p, dims=dims)
    m = FREQUENCIES[dims]
    exact = mcs.spectra.closed_form_covariance(sampler, n, m[:, None], m, density=density)
    s = _sums(sampler, density, n, m)
    products = s[:, :, None] * np.conj(s[:, None, :])
    difference = products.mean(axis=0) - exact
    count = 2 * len(CASES) * len(m) ** 2
    limit = stats.norm.isf(0.5 * (1 - (1 - 1e-3) ** (1 / count)))
    for part in (np.real, np.imag):
        se = part(products).std(axis=0) / np.sqrt(REALIZATIONS)
        assert (np.abs(part(difference)) <= limit * se + 1e-12).all()
    power = mcs.closed_form_power(sampler, n, m, density=density)
    np.testing.assert_allclose(power, np.diag(exact).real + (m == 0).all(axis=1), atol=1e-13)


@pytest.mark.parametrize(("m", "l"), [(0, 0), (2, 2), (3, -1), (5, 0)])
def test_strata_by_quadrature_in_primary_space(m, l):
    """Σ over strata of E[w² e_m−l] − E[w e_m] E[w e_l]*, by adaptive quadrature over u."""
    n, density = 5, mcs.density(LINE, dims=1)

    def mean(j, k, power):
        """Return the mean of w^power exp(−2πi k x) over stratum j."""

        def value(u):
            x = density.sample([[u]])
            w = 1 / float(density.pdf(x)[0])
            return w**power * np.exp(-2j * np.pi * k * float(x[0, 0]))

        ends = (j / n, (j + 1) / n)
        return n * integrate.quad(value, *ends, epsabs=1e-12, complex_func=True)[0]

    total = sum(mean(j, m - l, 2) - mean(j, m, 1) * np.conj(mean(j, l, 1)) for j in range(n))
    found = mcs.spectra.closed_form_covariance("jittered", n, [m], [l], density=density)
    assert abs(found - total / n**2) < 1e-10


def test_a_zero_slope_gives_the_unweighted_form():
    m = FREQUENCIES[2]
    for spec, n in (("jittered", 9), ("latin-hypercube", 4), ("uniform-jitter", 9)):
        flat = mcs.spectra.closed_form_covariance(
            mcs.sampler(spec, dims=2), n, m[:, None], m, density="linear(slope=0)"
        )
        known = mcs.spectra.closed_form_covariance(mcs.sampler(spec, dims=2), n, m[:, None], m)
        np.testing.assert_allclose(flat, known, atol=1e-12)
    shifted = mcs.closed_form_power(
        mcs.sampler("jittered | shift", dims=2), 9, [[40, 100]], density="linear(slope=0)"
    )
    known = mcs.closed_form_power(mcs.sampler("jittered | shift", dims=2), 9, [[40, 100]])
    np.testing.assert_allclose(shifted, known, atol=1e-12)


def test_power_spectra_of_importance_samples_agree():
    """`power_spectrum` with a density against the Toeplitz form, at all frequencies by χ²."""
    for spec in ("random", "jittered"):
        sampler, half_width = mcs.sampler(spec, dims=1), 24
        spectrum = mcs.power_spectrum(
            sampler, 16, density=BELL, half_width=half_width, realizations=4000, rng=5
        )
        m = np.arange(1, half_width + 1)
        exact = mcs.closed_form_power(sampler, 16, m[:, None], density=mcs.density(BELL, dims=1))
        pulls = (spectrum["power"].sel(m0=m) - exact) / spectrum["power_se"].sel(m0=m)
        limit = stats.norm.isf(0.5 * (1 - (1 - 1e-3) ** (1 / (2 * half_width))))
        assert float(np.abs(pulls).max()) < limit


def test_importance_samples_are_not_white():
    """Random points have power (1/n) ∫1/p at m, but C_ml of neighbors is not 0: Toeplitz."""
    density = mcs.density("linear(slope=1)", dims=1)
    c = mcs.spectra.closed_form_covariance(
        "random", 10, [[5], [5], [5]], [[5], [4], [0]], density=density
    )
    assert 10 * c[0] == pytest.approx(np.log(3), rel=1e-12)
    k = np.arange(2)
    by_quad = [
        integrate.quad(lambda x, k=k: np.cos(2 * np.pi * k * x) / (0.5 + x), 0, 1)[0] for k in k
    ]
    np.testing.assert_allclose(10 * c[:2].real, by_quad, rtol=1e-9)


@pytest.mark.parametrize("spec", ["random", "jittered"])
def test_infinite_weights_have_infinite_power(spec):
    with pytest.warns(InfiniteWeightVarianceWarning, match="diverges"):
        power = mcs.closed_form_power(spec, 4, [[1]], density="linear(slope=2)")
    assert np.isinf(power).all()
