"""Convergence rates of the variance on a disk, whose edge dominates, and on smooth integrands."""

import numpy as np
import pytest

import mcspectra as mcs

DISK = "disk(center=[0.463, 0.517], radius=0.27)"
SMOOTH = "christensen-gaussian"
GRID = [16, 64, 256, 1024]
FEW = [16, 64, 256]


@pytest.mark.parametrize(
    ("spec", "integrand", "counts", "realizations", "steepest", "flattest"),
    [
        # Cells alone give −1.5 on the disk; lower orders bend the curve, which widens the range
        ("antithetic-jittered", SMOOTH, [32, 128, 512, 2048], 1000, -3.03, -2.97),  # −(1 + 4/d)
        ("antithetic-jittered", DISK, [32, 128, 512, 2048], 1000, -1.55, -1.45),
        ("gaussian-jitter | shift", DISK, GRID, 1000, -1.55, -1.45),
        ("box-jitter | shift", DISK, GRID, 1000, -1.55, -1.45),
        ("multi-jittered", DISK, GRID, 1000, -1.55, -1.45),
        ("correlated-multi-jittered", DISK, GRID, 1000, -1.55, -1.45),
        ("ldbn(sweeps=20)", DISK, FEW, 100, -1.5, -1.5),
        # Power at low frequencies remains, so the limit is −1; gaps at the edge give −1.5
        ("poisson-disk", DISK, FEW, 400, -1.5, -1.0),
        ("dart-throwing", DISK, FEW, 100, -1.5, -1.0),
        ("best-candidate", DISK, FEW, 100, -1.5, -1.0),
        # Without low frequencies −1.5 from the edge [Pilleboue2015]; finite sets may be steeper
        ("farthest-point(sets=8, sweeps=5)", DISK, FEW, 100, -1.75, -1.25),
        ("gaussian-blue-noise(iterations=60, sets=2)", "disk", FEW, 400, -9.0, -1.5),
        ("stealthy-hyperuniform(stealthiness=0.3, sets=2)", "disk", FEW, 500, -9.0, -1.4),
        ("step-blue-noise(cutoff=0.5, iterations=60, sets=2)", "disk", FEW, 500, -9.0, -1.4),
        ("bnot(sets=8)", DISK, [64, 128, 256], 500, -1.6, -1.4),
        # ∫ |k|^(−3) min(1, (|k|/√n)^(2−β)) k dk / n ~ n^(−3/2), with a logarithm for β = 1
        ("perturbed-lattice", "disk", [64, 256, 1024], 300, -1.55, -1.45),
        ("perturbed-lattice(correlation=1.0)", "disk", [64, 256, 1024], 300, -1.65, -1.35),
    ],
)
def test_rate(spec, integrand, counts, realizations, steepest, flattest):
    """The fitted rate is within four standard errors of its range."""
    estimator = mcs.Estimator(integrand, dims=2)
    found = mcs.convergence(estimator, spec, counts, realizations=realizations, rng=2)
    low, high = found["rate_ci"].values
    error, rate = (high - low) / 2 / 1.96, float(found["rate"])
    assert steepest - 4 * error < rate < flattest + 4 * error
    assert error < 0.15, "the interval says little"
    assert high < -1.0, "no better than random points"


@pytest.mark.parametrize(("source", "slope"), [("pmj", -1.8), ("pmj02", -2.8)])
def test_rates_of_progressive_sequences(source, slope):
    """Variances fall like n^-2 as for jittered sets, or nearly n^-3 as for scrambled nets."""
    estimator, counts = mcs.Estimator(SMOOTH, dims=2), [64, 256, 1024, 4096]
    fit = mcs.convergence(estimator, source, counts, realizations=1000, rng=2)
    # Logarithms bend the curve, which widens the fit's interval: use the noise of the slope alone
    x = np.log(counts)
    se = (2 / 1000) ** 0.5 / np.sqrt(((x - x.mean()) ** 2).sum())
    assert float(fit["rate"]) + 4 * se < slope
