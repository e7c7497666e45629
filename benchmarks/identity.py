"""Sum of the three terms compared with the variance of the truncated estimate."""

from __future__ import annotations

import itertools

import numpy as np

import mcspectra as mcs
from mcspectra.core.streams import Stream
from mcspectra.spectra.transforms import FrequencyGrid, direct_sum

SIZES = {1: (8, 12), 2: (16, 5), 3: (8, 3)}  # number of points and half width, by number of dims


def _one_sided(dims: int) -> mcs.Sampler:
    return mcs.Sampler.from_function(lambda n, rng: rng.random((n, dims)) ** 2, dims=dims)


def _difference(dims: int, name: str, density: str | None, space: str) -> float:
    """Return the relative difference between the sum of the terms and the direct variance."""
    f = mcs.Integrand.from_function(lambda x: np.exp(x[..., 0]) * (1 + x.sum(-1) ** 2), dims=dims)
    estimator = mcs.Estimator(f, density)
    sampler = _one_sided(dims) if name == "one-sided" else mcs.sampler(name, dims=dims)
    n, half_width = SIZES[dims]
    d = mcs.variance_terms(
        estimator, sampler, n, half_width=half_width, realizations=64, space=space, engine="direct"
    )
    half = FrequencyGrid(dims, half_width).indices()
    m = np.concatenate([half, -half[-2::-1]])
    (u,) = estimator.draw(sampler, n, Stream.from_rng(0), 0, 64)
    if space == "domain":
        x, weights = estimator.weighted_points([u])
        estimates = direct_sum(x, m, weights) @ f.fourier(m).conj()
    else:
        estimates = direct_sum(u, m) @ estimator.primary_integrand(0).fourier(m).conj()
    total = float(d["dc_term"] + d["power_term"] + d["cross_term"])
    return abs(total / float(np.var(estimates.real, ddof=1)) - 1)


def _pairing() -> None:
    """Print variances predicted from the covariances C_ml, and from their complex conjugates."""
    f = mcs.Integrand.from_function(
        lambda x: np.exp(3 * np.cos(2 * np.pi * (x[..., 0] - 0.15))), dims=1
    )
    d = mcs.variance_terms(
        mcs.Estimator(f), _one_sided(1), 8, half_width=40, realizations=400, cross_matrix=True
    )
    fm, c = f.fourier(d["m"].values[:, None]), d["coefficient_covariance"].values
    literal = float((fm.conj()[:, None] * fm[None, :] * c.conj()).sum().real)
    x = _one_sided(1).draw(8, realizations=400, rng=0)
    reflected = float(np.var(f(1 - x).mean(axis=1), ddof=1))
    print(f"measured {float(d['measured_variance']):.8f}, "
          f"⟨S_m conj(S_l)⟩ predicts {float(d['predicted_variance']):.8f}")  # fmt: skip
    print(f"measured for f(1−x) {reflected:.8f}, the slides' ⟨S_m* S_l⟩ predicts {literal:.8f}")


def main() -> None:
    """Print how much the sum of the three terms differs from the variance, for 1, 2 and 3 dims.

    The last lines compare measured variances with our formula and with the formula of the slides.
    """
    names = ("random", "jittered", "jittered | shift", "one-sided")
    for dims in SIZES:
        cases = itertools.product(names, (None, "linear(slope=1.2)"), ("domain", "primary"))
        worst = max(_difference(dims, *case) for case in cases)
        print(f"{dims}-D, 16 cases: largest relative difference {worst:.1e}")
    _pairing()


if __name__ == "__main__":
    main()
