"""Rates of convergence of the variance in n: fitted slopes against theory."""

import pytest

import mcspectra as mcs

DISK = "disk(center=[0.463, 0.517], radius=0.27)"
SQUARE = "polynomial(coefficients=[0, 0, 1])"
SMOOTH = "christensen-gaussian"


@pytest.mark.parametrize(
    ("spec", "integrand", "counts", "rate", "bend"),
    [
        # Discontinuous functions: −1.5 in 2-D if strata, or the dual of a lattice, are even. `bend`
        # is the bend of the curve at small n
        ("fibonacci | shift", DISK, [21, 89, 377, 1597], -1.5, 0.05),
        # The constant oscillates: a factor 2 between the ends tilts the fit by log
        # 2/log(n_last/n_first)
        ("kronecker | shift", DISK, [16, 64, 256, 1024, 4096], -1.5, 0.125),
        ("orthogonal-array", DISK, [25, 121, 289, 961], -1.5, 0.05),
        (
            "orthogonal-array(jitter='correlated-multi-jittered')",
            DISK,
            [25, 121, 289, 961],
            -1.5,
            0.05,
        ),
        # 2^i 3^k: complete boxes of both bases
        ("halton | permute", DISK, [36, 144, 576, 2304], -1.5, 0.05),
        ("halton | owen", DISK, [36, 144, 576, 2304], -1.5, 0.05),
        # x² at a shifted lattice, and folded, which is continuous with kinks
        ("rank1-lattice(vector=[1]) | shift", SQUARE, [8, 32, 128], -2.0, 0.03),
        (
            "rank1-lattice(vector=[1]) | shift | mirror(mode='fold')",
            SQUARE,
            [8, 32, 128],
            -4.0,
            0.03,
        ),
        # Owen (1997): n^-3 up to logarithms for smooth integrands
        ("sobol | owen", SMOOTH, [16, 64, 256, 1024, 4096], -2.9, 0.1),
        ("sobol | owen(method='hash')", SMOOTH, [16, 64, 256, 1024, 4096], -2.9, 0.1),
        # Power at low frequencies gives −1, the edge of the disk −1.5
        ("projective-blue-noise", DISK, [16, 64, 256], -1.25, 0.25),
        (
            "sliced-optimal-transport(iterations=40, directions=16, sets=2) | shift",
            DISK,
            [16, 64, 256],
            -1.3,
            0.2,
        ),
    ],
)
def test_the_slope_agrees_with_theory(spec, integrand, counts, rate, bend):
    estimator = mcs.Estimator(integrand, dims=1 if integrand == SQUARE else 2)
    found = mcs.convergence(estimator, spec, counts, realizations=500, rng=2)
    low, high = found["rate_ci"].values
    # Four standard errors; the half-interval is 1.96 of them
    assert abs(float(found["rate"]) - rate) < 4 * (high - low) / 2 / 1.96 + bend
