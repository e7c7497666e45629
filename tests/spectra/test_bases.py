"""Bases: transforms against explicit functions, the identity of the terms, choice of a basis."""

import itertools
import math

import numpy as np
import pytest
from scipy import integrate

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.spectra.bases import BASES, fitting_basis, make_basis

REAL = ("cosine", "walsh", "haar")
HALF = 4  # half width of small cases


def one_function(basis, k, x):
    """Return φ_k of one variable by its definition, one number at a time."""
    if basis == "fourier":
        return np.exp(2j * np.pi * k * x)
    if basis == "cosine":
        return math.sqrt(2.0) * math.cos(math.pi * k * x) if k else 1.0
    if basis == "walsh":
        sign, rest = 1, x
        while k:
            digit, rest = divmod(2 * rest, 1.0)
            sign *= (-1) ** (k % 2 * int(digit))
            k //= 2
        return float(sign)
    if k == 0:
        return 1.0
    level = k.bit_length() - 1
    place = 2**level * x - (k - 2**level)
    inside = int(0 <= place < 0.5) - int(0.5 <= place < 1)
    return 2 ** (level / 2) * inside


def functions(basis, x):
    """Return all products at points x (n, d), conjugated: (M, n), in C order of the indices."""
    made = make_basis(basis, x.shape[1], HALF)
    columns = [
        np.array([[one_function(basis, int(k), xi) for xi in x[:, j]] for k in made.axis])
        for j in range(x.shape[1])
    ]
    chosen = itertools.product(range(len(made.axis)), repeat=x.shape[1])
    return np.array(
        [np.prod([c[i] for c, i in zip(columns, k, strict=True)], axis=0) for k in chosen]
    ).conj()


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("dims", [1, 2, 3])
@pytest.mark.parametrize("weighted", [False, True])
def test_points_are_transformed_by_the_definition(basis, dims, weighted):
    generator = np.random.default_rng(dims)
    points = generator.random((3, 10, dims))
    weights = generator.random((3, 10)) if weighted else None
    made = make_basis(basis, dims, HALF)
    transform, _ = made.transform(10, "auto", 1e-12)
    found = transform(points, weights)
    used = np.full((3, 10), 0.1) if weights is None else weights
    expected = np.array([functions(basis, x) @ w for x, w in zip(points, used, strict=True)])
    assert found.shape == (3, made.stored)
    np.testing.assert_allclose(found, expected[:, : made.stored], atol=1e-11)


@pytest.mark.parametrize("basis", BASES)
def test_functions_are_orthonormal(basis):
    """On the midpoints of 64 cells, all four bases are orthonormal as vectors, up to K = 4."""
    x = (np.arange(64)[:, None] + 0.5) / 64
    made = make_basis(basis, 1, HALF)
    phi = functions(basis, x)
    np.testing.assert_allclose(phi @ phi.conj().T / 64, np.eye(made.size), atol=1e-12)


@pytest.mark.parametrize("basis", REAL)
@pytest.mark.parametrize("spec", ["gaussian(center=0.3, width=0.2)", "step(at=0.3)", "linear"])
def test_coefficients_of_integrands_agree_with_quadrature(basis, spec):
    f = mcs.integrand(spec, dims=1)
    found, _ = make_basis(basis, 1, HALF).integrand(f)
    breaks = sorted({*np.arange(1, 8) / 8, 0.3})
    for k in range(8):
        expected = sum(
            integrate.quad(lambda x, k=k: f([[x]])[0] * one_function(basis, k, x), a, b)[0]
            for a, b in itertools.pairwise([0.0, *breaks, 1.0])
        )
        assert found[0, k] == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("basis", REAL)
def test_coefficients_of_products_and_channels(basis):
    """For f = a(x) b(y), and two channels of it, coefficients are products of 1-D coefficients."""
    a = mcs.Integrand.from_function(lambda x: np.exp(x[..., 0]), dims=1)
    b = mcs.Integrand.from_function(lambda x: 1 / (1 + x[..., 0]), dims=1)
    f = mcs.Integrand.from_function(
        lambda x: np.exp(x[..., :1]) / (1 + x[..., 1:]) * np.array([1.0, -2.0]), dims=2
    )
    one, two = make_basis(basis, 1, HALF), make_basis(basis, 2, HALF)
    product = np.outer(one.integrand(a)[0], one.integrand(b)[0]).ravel()
    found, _ = two.integrand(f)
    np.testing.assert_allclose(found, [product, -2 * product], atol=1e-9)


@pytest.mark.parametrize("basis", REAL)
@pytest.mark.parametrize("space", ["domain", "primary"])
@pytest.mark.parametrize("dims", [1, 2])
def test_terms_sum_to_the_variance_of_the_truncated_estimate(basis, space, dims):
    f = mcs.Integrand.from_function(
        lambda x: np.exp(x[..., 0]) * (1 + 0.3 * x.sum(axis=-1) ** 2), dims=dims
    )
    estimator = mcs.Estimator(f, "linear(slope=1.2)")
    sampler = mcs.sampler("jittered", dims=dims)
    d = mcs.variance_terms(
        estimator, sampler, 4**dims, half_width=HALF, realizations=20, rng=4, space=space,
        basis=basis, eps=1e-12, cross_matrix=True,
    )  # fmt: skip
    points = sampler.draw(4**dims, realizations=20, rng=4)
    made = make_basis(basis, dims, HALF)
    if space == "domain":
        x, weights = estimator.weighted_points([points])
        coefficients = made.integrand(f)[0][0]
    else:
        x, weights = points, np.full((20, 4**dims), 0.25**dims)
        coefficients = made.integrand(estimator.primary_integrand(0))[0][0]
    s = np.array(
        [functions(basis, xi)[: made.stored] @ wi for xi, wi in zip(x, weights, strict=True)]
    )
    estimates = (s @ (coefficients.conj() * made.double)).real
    expected = np.var(estimates, ddof=1)
    total = float(d["dc_term"] + d["power_term"] + d["cross_term"])
    assert total == pytest.approx(expected, rel=1e-8)
    assert float(d["contribution"].sum()) == pytest.approx(expected, rel=1e-8)
    assert float(d["band_covariance"].sum()) == pytest.approx(expected, rel=1e-8)
    assert float(d["captured_by_half_width"][-1]) == pytest.approx(float(d["captured"]), rel=1e-8)
    matrix = d["cross_matrix"].values
    assert matrix.sum().real == pytest.approx(expected, rel=1e-8)
    assert abs(matrix.sum().imag) < 1e-12 * expected
    off = matrix.sum() - np.trace(matrix)
    assert off.real == pytest.approx(float(d["cross_term"]), rel=1e-6, abs=1e-10 * expected)
    assert d.attrs["basis"] == basis


FITS = [("jittered | shift", "fourier"), ("jittered | digital-shift", "walsh")]
FITS += [("jittered | shift | mirror(mode='fold')", "cosine")]
FITS += [("jittered | mirror(mode='uniform')", "walsh"), ("sobol | owen | mirror", "walsh")]
FITS += [("jittered", "haar")]
MISFITS = [("jittered", "fourier"), ("jittered | shift", "walsh"), ("jittered | shift", "haar")]


def cross_over_power(sampler, basis):
    """Return the mean and standard error of cross/power over 12 independent runs."""
    ratios = [
        float(d["cross_term"] / d["power_term"])
        for d in (
            mcs.variance_terms(
                mcs.Estimator("gaussian(center=0.3, width=0.3)"), sampler, 16, half_width=16,
                realizations=400, rng=seed, basis=basis,
            )
            for seed in range(12)
        )
    ]  # fmt: skip
    return np.mean(ratios), np.std(ratios, ddof=1) / math.sqrt(len(ratios))


@pytest.mark.parametrize(("sampler", "basis"), FITS)
def test_the_cross_term_vanishes_where_the_basis_fits(sampler, basis):
    mean, se = cross_over_power(sampler, basis)
    assert abs(mean) < 4 * se
    assert se < 0.05  # ensures that the line above is significant


def test_reflections_do_not_change_symmetric_functions():
    """For a centered disk, reflected jittered points equal jittered ones. Only Walsh fits."""
    for basis, zero in (("walsh", True), ("cosine", False)):
        d = mcs.variance_terms(
            "disk", "jittered | mirror", 64, half_width=16, realizations=400, rng=2, basis=basis
        )
        assert (abs(float(d["cross_term"])) < 4 * float(d["cross_term_se"])) is zero


@pytest.mark.parametrize(("sampler", "basis"), MISFITS)
def test_the_cross_term_does_not_vanish_elsewhere(sampler, basis):
    mean, se = cross_over_power(sampler, basis)
    assert mean < -0.1 - 4 * se


@pytest.mark.parametrize(
    ("sampler", "half_width", "basis"),
    [
        ("jittered | shift", 16, "fourier"),
        ("jittered | strata-shift | shift", 16, "fourier"),
        ("sobol | owen", 16, "walsh"),
        ("sobol | owen", 17, "cosine"),
        ("sobol | digital-shift", 16, "walsh"),
        ("poisson-disk", 16, "fourier"),
        ("jittered", 16, "cosine"),
        ("random", 16, "cosine"),
        ("sobol", 16, "cosine"),
        ("jittered | mirror", 16, "walsh"),
        ("jittered | mirror(mode='fold')", 16, "walsh"),
        ("jittered | shift | mirror", 16, "cosine"),
        ("sobol | owen | mirror", 16, "walsh"),
        ("jittered | shift | mirror(mode='fold')", 16, "cosine"),
        ("jittered | mirror(mode='uniform')", 16, "walsh"),
        ("jittered | mirror(mode='uniform')", 17, "cosine"),
        ("jittered | shift | mirror(mode='uniform')", 16, "cosine"),
        ("poisson-disk | mirror(mode='uniform')", 16, "cosine"),
        ("jittered | digital-shift | mirror(mode='uniform')", 16, "walsh"),
    ],
)
def test_auto_chooses_the_basis_that_fits_the_randomization(sampler, half_width, basis):
    assert fitting_basis(mcs.sampler(sampler).law(16), half_width) == basis
    d = mcs.variance_terms(
        "gaussian", mcs.sampler(sampler), 16, half_width=half_width, realizations=4, basis="auto"
    )
    assert d.attrs["basis"] == basis


@pytest.mark.parametrize(
    ("mode", "sampler", "space", "basis"),
    [
        ("integrand", "jittered | shift", "domain", "cosine"),
        ("integrand", "jittered | shift", "primary", "fourier"),
        ("random", "jittered | shift", "domain", "cosine"),
        ("uniform", "jittered", "domain", "walsh"),
        ("uniform", "jittered | shift", "primary", "cosine"),
    ],
)
def test_auto_accounts_for_mirrored_estimators(mode, sampler, space, basis):
    estimator = mcs.Mirrored("gaussian(center=0.3, width=0.3)", mode, dims=2)
    d = mcs.variance_terms(
        estimator, sampler, 64, half_width=8, realizations=400, basis="auto", space=space, rng=3
    )
    assert d.attrs["basis"] == basis
    assert abs(float(d["cross_term"])) < 4 * float(d["cross_term_se"])


@pytest.mark.parametrize("basis", ["walsh", "haar"])
def test_dyadic_bases_require_a_power_of_two(basis):
    with pytest.raises(
        ParameterError, match=f"the {basis} basis needs a power of two, such as 8 or 16"
    ):
        mcs.variance_terms("gaussian", "random", 16, half_width=12, basis=basis)
    with pytest.raises(ParameterError, match="engine"):
        mcs.variance_terms("gaussian", "random", 16, half_width=8, basis=basis, engine="nufft")


def test_a_half_width_of_zero_is_the_constant_alone():
    for basis in BASES:
        d = mcs.variance_terms(
            mcs.Estimator("gaussian", "linear(slope=1)"), "jittered", 16, half_width=0,
            realizations=10, basis=basis,
        )  # fmt: skip
        assert float(d["power_term"]) == 0
        assert float(d["dc_term"]) == pytest.approx(float(d["predicted_variance"]))


def test_limits():
    with pytest.raises(ParameterError, match="basis is 'sine'; it must be one of"):
        make_basis("sine", 2, 8)
    with pytest.raises(ParameterError, match="use at most"):
        make_basis("haar", 3, 1024)
