"""Exact means, powers and covariances of S_m, against simulation and against each other."""

import numpy as np
import pytest
from scipy import stats

import mcspectra as mcs
from mcspectra.core.errors import NoClosedForm
from mcspectra.spectra.closed_forms import moments_of

REALIZATIONS = 10_000
INTEGERS = {
    1: np.array([[0], [1], [-1], [2], [3], [-4], [5], [8], [12]]),
    2: np.array(
        [[0, 0], [1, 0], [0, -1], [1, 1], [-1, 1], [3, 0], [4, 0], [0, 4], [4, -4], [5, 4]]
    ),
    3: np.array([[0, 0, 0], [1, 0, 0], [1, -1, 0], [2, 1, 3], [2, 0, 0], [0, 3, 0], [3, -3, 6]]),
}
BETWEEN = {1: [[0.3], [-1.7]], 2: [[0.5, 0.25], [-2.3, 1.0]], 3: [[0.5, 0.2, -1.3]]}

ANYWHERE = [
    ("random", 1, 5),
    ("random", 2, 5),
    ("jittered", 1, 4),
    ("jittered", 2, 16),
    ("jittered", 3, 27),
    ("jittered(sides=[2, 4])", 2, 8),
    ("regular", 2, 16),
    ("regular(position='corner', sides=[2, 4])", 2, 8),
    ("uniform-jitter", 1, 4),
    ("uniform-jitter(sides=[4, 2])", 2, 8),
    ("box-jitter(width=0.5)", 2, 16),
    ("box-jitter(width=1)", 1, 4),
    ("antithetic-jittered", 1, 8),
    ("antithetic-jittered", 2, 8),
    ("n-rooks", 2, 4),
    ("latin-hypercube", 1, 4),
    ("latin-hypercube", 3, 3),
    ("latin-hypercube(strength=2)", 3, 9),
    ("orthogonal-array(jitter='jittered')", 2, 16 - 7),
    ("orthogonal-array(jitter='jittered')", 3, 4),
    ("orthogonal-array", 3, 9),
    ("multi-jittered", 2, 4),
    ("multi-jittered", 2, 2),
    ("multi-jittered", 2, 6),
    ("fibonacci", 2, 8),
    ("korobov", 3, 7),
    ("hexagonal", 2, 12),
    ("sobol", 2, 8),
    ("kronecker", 1, 5),
    ("jittered | shuffle", 1, 4),
    ("regular | shift", 2, 16),
    ("jittered | owen", 2, 16),
    ("antithetic-jittered | digital-shift", 2, 8),
    ("sobol | owen", 2, 8),
    ("sobol | lms", 3, 8),
    ("sobol | digital-shift", 2, 8),
    ("hammersley | permute", 2, 8),
    ("halton | digital-shift", 1, 6),
    ("halton | digital-shift", 3, 6),
    ("halton | permute", 3, 6),
    ("faure | digital-shift", 3, 9),
    ("faure | permute", 3, 9),
    ("halton | owen", 2, 6),
    ("faure | owen", 3, 9),
    ("regular | owen", 2, 16),
    ("pmj02", 2, 16),
]
AT_INTEGERS = [
    ("box-jitter(width=1.5)", 1, 4),
    ("gaussian-jitter", 1, 4),
    ("gaussian-jitter(width=0.1)", 2, 9),
    ("perturbed-lattice", 1, 4),
    ("perturbed-lattice(width=0.1)", 2, 16),
    ("perturbed-lattice(correlation=1)", 1, 5),
    ("perturbed-lattice(correlation=1.5, width=0.5)", 2, 16),
    ("perturbed-lattice(correlation=-1)", 2, 9),
    ("perturbed-lattice(correlation=2)", 2, 1),
    ("determinantal", 1, 4),
    ("determinantal", 2, 6),
    ("jittered | shift", 1, 4),
    ("jittered | shift", 2, 16),
    ("jittered | strata-shift(offset=0.3)", 2, 16),
    ("antithetic-jittered | strata-shift(offset=[0.3, 0.1])", 2, 8),
    ("fibonacci | shift", 2, 8),
    ("latin-hypercube | shift", 2, 4),
    ("jittered | shift | strata-shift", 1, 4),
    ("sobol | shift", 2, 8),
]


def threshold(count):
    """Šidák threshold: the largest of `count` normal pulls exceeds it with probability 1e-4."""
    return stats.norm.isf(0.5 * (1 - (1 - 1e-4) ** (1 / count)))


def transforms(sampler, n, nu):
    x = sampler.draw(n, realizations=REALIZATIONS, rng=11)
    return np.stack([np.exp(-2j * np.pi * (x @ one)).mean(axis=1) for one in nu], axis=1)


def assert_pulls(samples, expected):
    """Compare means of samples (R, …), real and imaginary parts, with exact values."""
    parts = np.stack([samples.real, samples.imag], axis=-1)
    exact = np.stack([np.real(expected), np.imag(expected)], axis=-1)
    error = np.abs(parts.mean(axis=0) - exact)
    se = parts.std(axis=0) / np.sqrt(len(samples))
    assert (error <= threshold(error.size) * se + 1e-12).all()


def check(sampler, n, nu):
    s = transforms(sampler, n, nu)
    mean = moments_of(sampler.law(n), sampler.spec, nu).mean(nu)
    assert_pulls(s, mean)
    centered = s - mean
    exact = mcs.spectra.closed_form_covariance(sampler, n, nu[:, None], nu)
    assert_pulls(centered[:, :, None] * np.conj(centered[:, None, :]), exact)
    assert_pulls(np.abs(s) ** 2 + 0j, mcs.closed_form_power(sampler, n, nu))


@pytest.mark.parametrize(("spec", "dims", "n"), ANYWHERE)
def test_moments_at_all_frequencies(spec, dims, n):
    nu = np.concatenate([INTEGERS[dims], BETWEEN[dims]])
    check(mcs.sampler(spec, dims=dims), n, nu)


@pytest.mark.parametrize(("spec", "dims", "n"), AT_INTEGERS)
def test_moments_at_integers_only(spec, dims, n):
    sampler = mcs.sampler(spec, dims=dims)
    check(sampler, n, INTEGERS[dims])
    with pytest.raises(NoClosedForm, match="at real frequencies"):
        mcs.closed_form_power(sampler, n, BETWEEN[dims])


@pytest.mark.parametrize("dims", [1, 2])
def test_random_points_of_a_density(dims):
    n, m = 4, INTEGERS[dims]
    density = mcs.density("linear(slope=1)", dims=dims)
    x = density.sample(mcs.sampler("random", dims=dims).draw(n, realizations=REALIZATIONS, rng=3))
    weights = 1 / density.pdf(x)
    s = np.stack([(weights * np.exp(-2j * np.pi * (x @ one))).mean(axis=1) for one in m], axis=1)
    s -= (m == 0).all(axis=1)
    exact = mcs.spectra.closed_form_covariance("random", n, m[:, None], m, density=density)
    assert_pulls(s[:, :, None] * np.conj(s[:, None, :]), exact)
    power = mcs.closed_form_power("random", n, m, density=density)
    np.testing.assert_allclose(np.diag(exact), power - (m == 0).all(axis=1), atol=1e-12)


@pytest.mark.parametrize("dims", [1, 2, 3])
def test_jittered_at_integers_follows_the_formula_of_the_design(dims):
    """(1/n) (δ_ml − Π (−1)^((m−l)/s) sinc sinc) where s divides m − l; corners are at 0."""
    s, m = 3, INTEGERS[dims]
    n = s**dims
    row, column = m[:, None], m[None, :]
    steps = (row - column) / s
    sign = np.where(np.rint(steps) % 2 == 0, 1.0, -1.0)
    product = np.prod(sign * np.sinc(row / s) * np.sinc(column / s), axis=-1)
    divides = (steps == np.rint(steps)).all(axis=-1)
    expected = np.where(divides, (row == column).all(axis=-1) - product, 0) / n
    found = mcs.spectra.closed_form_covariance(mcs.sampler("jittered", dims=dims), n, row, column)
    np.testing.assert_allclose(found, expected, atol=1e-15)


def test_dual_lattice_of_large_frequencies_is_exact():
    """Residues are multiplied instead of frequencies, which would overflow and lose digits."""
    z, n = np.array([1, 610]), 987
    m = np.array([[2**40 - 1, 2**40 - 3], [-(2**40), 5], [n, 2 * n], [610, -1], [609, -1]])
    exact = [(int(a) * int(z[0]) + int(b) * int(z[1])) % n == 0 for a, b in m]
    assert mcs.closed_form_power("fibonacci", n, m).tolist() == [float(e) for e in exact]
    assert any(exact)
    assert not all(exact)


def test_lattices_agree_with_sums_over_their_points():
    m = INTEGERS[2]
    points = mcs.sampler("fibonacci").draw(8)[0]
    summed = np.exp(-2j * np.pi * (m @ points.T)).mean(axis=1)
    np.testing.assert_allclose(
        mcs.closed_form_power("fibonacci", 8, m), np.abs(summed) ** 2, atol=1e-12
    )
