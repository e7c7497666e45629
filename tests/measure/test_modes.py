"""Leading modes of the covariance against the eigenvectors of the full matrix."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.measure.modes import CovarianceProduct

ARGUMENTS = {"realizations": 200, "rng": 3}
F1 = mcs.Estimator("linear", dims=1)
F2 = mcs.Estimator("gaussian(center=[0.3, 0.6], width=0.2)", dims=2)
WARPED = mcs.Estimator("gaussian", "linear(slope=1)")
TWO = mcs.MultipleImportance("gaussian", ["uniform", "linear(slope=1)"])


@pytest.mark.parametrize(
    ("estimator", "sampler", "changes"),
    [
        (F1, "jittered", {"half_width": 12}),
        pytest.param(F1, "random", {"half_width": 12}, marks=pytest.mark.slow),
        (F1, "jittered", {"half_width": 8, "basis": "cosine"}),
        pytest.param(
            *(F1, "jittered", {"half_width": 16, "basis": "haar"}), marks=pytest.mark.slow
        ),
        pytest.param(F2, "jittered", {"half_width": 4}, marks=pytest.mark.slow),
        (F2, "latin-hypercube", {"half_width": 4, "basis": "walsh"}),
        (WARPED, "jittered", {"half_width": 3}),
        (TWO, "jittered", {"half_width": 3, "space": "primary"}),
    ],
)
def test_modes_are_the_eigenvectors_of_the_cross_matrix(estimator, sampler, changes):
    both = {"realizations": 40, "rng": 3, **changes}
    found = mcs.covariance_modes(estimator, sampler, 16, modes=3, passes=40, **both)
    terms = mcs.variance_terms(estimator, sampler, 16, cross_matrix=True, **both)
    matrix = terms["cross_matrix"].values
    # the entries are ⟨y_m conj(y_l)⟩
    assert np.allclose(matrix, matrix.conj().T, atol=1e-12 * np.abs(matrix).max())
    values, _ = np.linalg.eigh(matrix)
    scale = values[-1]
    assert np.allclose(found["eigenvalue"], values[::-1][:3], atol=1e-5 * scale)
    assert float(found["band_trace"]) == pytest.approx(np.trace(matrix).real, rel=1e-9)
    assert np.allclose(found["eigenvalue_share"], found["eigenvalue"] / found["band_trace"])
    vectors = found["mode_vector"].values.reshape(3, -1)
    assert np.allclose(vectors.conj() @ vectors.T, np.eye(3), atol=1e-9)
    residual = matrix @ vectors.T - vectors.T * found["eigenvalue"].values
    assert np.linalg.norm(residual, axis=0) == pytest.approx(
        found["eigenvalue_residual"].values, rel=1e-3, abs=1e-9 * scale
    )
    expected = found["eigenvalue"].values * np.abs(vectors.sum(axis=1)) ** 2
    assert scale > 0
    assert np.allclose(found["mode_contribution"], expected, atol=1e-9 * scale)


def test_errors_of_eigenvalues_equal_their_spread():
    """The errors of a dominant mode equal its standard deviation over 25 runs."""
    runs = [
        mcs.covariance_modes(
            F1, "random", 8, half_width=4, modes=1, realizations=200, rng=seed, basis="cosine"
        )
        for seed in range(25)
    ]
    values = np.array([float(d["eigenvalue"][0]) for d in runs])
    claimed = np.sqrt(np.mean([float(d["eigenvalue_se"][0]) ** 2 for d in runs]))
    # A standard deviation of 25 values has an error of 1/√48 = 14 %; batches of 10 realizations
    # overestimate by up to √(10/9)
    assert 1 - 4 * 0.144 < claimed / values.std(ddof=1) < np.sqrt(10 / 9) * (1 + 4 * 0.144)


@pytest.mark.parametrize("realizations", [20, pytest.param(400, marks=pytest.mark.slow)])
def test_sampling_noise_steepens_a_flat_spectrum(realizations):
    """Sampling noise alone gives a largest eigenvalue at the Marchenko-Pastur edge.

    For random points, n Cov(S_m, S_l) is the identity, with D = 80 coefficients. The relative
    fluctuation of the edge is D^-2/3, here 5 %, and the edge lies slightly above the largest.
    """
    found = mcs.covariance_modes(
        F2, "random", 256, half_width=4, modes=1, weighted=False, passes=30, rng=5,
        realizations=realizations,
    )  # fmt: skip
    largest, edge = 256 * float(found["eigenvalue"][0]), 256 * float(found["noise_edge"])
    assert edge == pytest.approx((1 + np.sqrt(80 / (realizations - 1))) ** 2, rel=0.1)
    assert 0.8 < largest / edge < 1.1
    assert "noise_edge" in found.attrs["note"]
    many = mcs.covariance_modes(F1, "random", 8, half_width=1, modes=1, realizations=30, rng=1)
    assert "note" not in many.attrs


def test_modes_are_at_most_as_many_as_coefficients():
    """The imaginary part of S_0 is not a coordinate."""
    assert (
        mcs.covariance_modes(F1, "random", 8, half_width=2, modes=5, **ARGUMENTS).sizes["mode"] == 5
    )
    with pytest.raises(ParameterError, match="modes is 6; give a whole number from 1 to 5"):
        mcs.covariance_modes(F1, "random", 8, half_width=2, modes=6, **ARGUMENTS)


def test_all_modes_sum_to_the_variance():
    found = mcs.covariance_modes(F1, "jittered", 8, half_width=3, modes=7, **ARGUMENTS)
    terms = mcs.variance_terms(F1, "jittered", 8, half_width=3, **ARGUMENTS)
    total = float(found["mode_contribution"].sum())
    assert total == pytest.approx(float(terms["predicted_variance"]), rel=1e-9)
    trace = float(terms["dc_term"] + terms["power_term"])
    assert float(found["eigenvalue"].sum()) == pytest.approx(trace, rel=1e-9)


def test_unweighted_modes_belong_to_the_covariance_of_coefficients():
    found = mcs.covariance_modes(
        F2, "jittered", 16, half_width=2, modes=25, weighted=False, **ARGUMENTS
    )
    terms = mcs.variance_terms(F2, "jittered", 16, half_width=2, cross_matrix=True, **ARGUMENTS)
    values = np.linalg.eigvalsh(terms["coefficient_covariance"].values)[::-1]
    assert np.allclose(found["eigenvalue"], values, atol=1e-12)
    total = float(found["mode_contribution"].sum())
    assert total == pytest.approx(float(terms["predicted_variance"]), rel=1e-9)


def test_a_shifted_grid_has_two_modes_for_each_dual_frequency():
    """For 4 shifted grid points, only S_±4 and S_±8 vary: modulus 1 and random phase."""
    found = mcs.covariance_modes(
        F1, "regular | shift", 4, half_width=11, modes=6, weighted=False, realizations=400, rng=1
    )
    support = np.abs(found["mode_vector"].values[:4]).sum(axis=0) > 1e-6
    assert set(found["m0"].values[support]) == {-8, -4, 4, 8}
    assert (found["eigenvalue"][4:] < 1e-12).all()
    assert float(found["band_trace"]) == pytest.approx(4.0, rel=0.05)


def test_modes_of_bands_are_those_of_the_submatrix():
    terms = mcs.variance_terms(
        F2, "jittered", 16, half_width=4, cross_matrix=True, bands="radial", **ARGUMENTS
    )
    found = mcs.covariance_modes(
        F2, "jittered", 16, half_width=4, modes=4, band=["1", "2"], passes=8, **ARGUMENTS
    )
    m = np.stack(np.meshgrid(*[np.arange(-4, 5)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    inside = np.isin(np.rint(np.linalg.norm(m, axis=1)), [1, 2])
    matrix = terms["cross_matrix"].values[np.ix_(inside, inside)]
    values = np.linalg.eigvalsh(matrix)[::-1][:4]
    assert np.allclose(found["eigenvalue"], values, atol=1e-6 * values[0])
    assert (np.abs(found["mode_vector"].values.reshape(4, -1)[:, ~inside]) == 0).all()


def test_residuals_bound_the_error_of_two_passes():
    exact = mcs.covariance_modes(F2, "jittered", 64, half_width=8, passes=12, **ARGUMENTS)
    quick = mcs.covariance_modes(F2, "jittered", 64, half_width=8, passes=2, **ARGUMENTS)
    value, bound = float(quick["eigenvalue"][0]), float(quick["eigenvalue_residual"][0])
    assert np.abs(exact["eigenvalue"].values - value).min() < bound * 1.001
    assert value <= float(exact["eigenvalue"][0]) * (
        1 + 1e-9
    )  # Rayleigh quotients are lower bounds


def test_modes_of_a_channel_equal_those_of_its_integrand():
    pair = mcs.Integrand.from_function(lambda x: np.stack([x[..., 0], x[..., 0] ** 2], -1), dims=1)
    both = {"half_width": 5, "modes": 2, **ARGUMENTS}
    found = mcs.covariance_modes(mcs.Estimator(pair), "jittered", 8, channel=1, **both)
    alone = mcs.Integrand.from_function(lambda x: x[..., 0] ** 2, dims=1)
    expected = mcs.covariance_modes(mcs.Estimator(alone), "jittered", 8, **both)
    assert np.allclose(found["eigenvalue"], expected["eigenvalue"], rtol=1e-9)


def test_merged_products_equal_the_product_of_all_rows():
    rng = np.random.default_rng(0)
    z = 100.0 + rng.standard_normal((50, 6)) * np.arange(1, 7)
    matrix = np.cov(z.T)
    vectors = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    first, second, third = (CovarianceProduct.of(part, vectors) for part in np.split(z, [7, 30]))
    whole = first.merge(second.merge(third))
    assert np.allclose(whole.product / 49, matrix @ vectors, rtol=1e-10)
    assert np.allclose(whole.along, z.mean(axis=0) @ vectors, rtol=1e-12)
    values, _, residuals, errors = whole.eigenpairs(vectors)
    assert np.allclose(values, np.linalg.eigvalsh(matrix)[::-1], rtol=1e-10)
    assert (residuals < 1e-10 * values[0]).all()
    assert whole.squares.sum() / 49 == pytest.approx(np.trace(matrix))
    assert np.isnan(errors).all()  # there are no batches
