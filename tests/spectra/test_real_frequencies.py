"""Only at integer frequencies do products of powers give the variance.

Between the integers, the mean of S_ν is χ(ν), the transform of the unit cube, and not 0. A sum with
steps of ½ counts |χ|² as variance. For f it adds ½ Σ_{m≠0} |F(m/2)|² |χ(m/2)|² =
∫ (f * box)² − ½ (∫f)², where F is the transform of f on the line. This does not fall with n (the
slides' backup pages).
"""

import numpy as np
import pytest

import mcspectra as mcs

COUNTS = (16, 64, 256, 1024)
WIDTH = 4096  # largest integer of 1-D sums


def _line_transform(f, nu):
    """Return F(ν) = ∫_0^1 f exp(−2πi ν x) dx of a ramp x, by parts; ν ≠ 0 real."""
    assert f == "ramp"
    a = -2j * np.pi * nu
    return np.exp(a) / a - (np.exp(a) - 1) / a**2


def _predicted(spec, n, step):
    """Return Σ_{ν≠0} |F(ν)|² ⟨|S_ν|²⟩ Δν on the line, in closed form, for both signs of ν."""
    nu = step * np.arange(1, int(WIDTH / step) + 1)
    power = mcs.closed_form_power(mcs.sampler(spec, dims=1), n, nu[:, None])
    return 2 * step * float((np.abs(_line_transform("ramp", nu)) ** 2 * power).sum())


# Beyond K, |F|² < 2/(2πν)² and n⟨P⟩ ≤ 2 for these sets, so the rest is below 2/(π² K n)
TAIL = 2 / (np.pi**2 * WIDTH)


@pytest.mark.parametrize("n", COUNTS)
def test_integer_frequencies_give_the_variance(n):
    """Variance for f = x: random 1/(12n); jittered with shift 1/(6n²) − 1/(12n³)."""
    assert _predicted("random", n, 1.0) == pytest.approx(1 / (12 * n), abs=TAIL / n)
    shifted = 1 / (6 * n**2) - 1 / (12 * n**3)
    assert _predicted("jittered | shift", n, 1.0) == pytest.approx(shifted, abs=TAIL / n)


@pytest.mark.parametrize("n", COUNTS)
def test_real_frequencies_add_the_bias_of_a_window(n):
    """For f = x, ∫ (f * box)² = 11/60 and ½ (∫f)² = 1/8, so 7/120 remains for n → ∞.

    Random: (1/n) (∫f² − ½ (∫f)²) + (1 − 1/n) 7/120.
    """
    expected = (1 / 3 - 1 / 8) / n + (1 - 1 / n) * 7 / 120
    assert _predicted("random", n, 0.5) == pytest.approx(expected, abs=TAIL)
    assert 7 / 120 < _predicted("jittered", n, 0.5) < 7 / 120 + 1 / n


@pytest.mark.parametrize("f", ["christensen-gaussian", "disk(center=[0.463, 0.517], radius=0.27)"])
def test_simulated_spectra_in_2d_diverge_too(f):
    """`variance_from_spectrum` of `power_spectrum` at integers and at half-integers.

    Coefficients at m/2 are those of f extended by 0, on a torus twice as wide.
    """
    integrand, half_width = mcs.integrand(f), 12

    def padded(x):
        inside = (x < 0.5).all(axis=-1)
        return 4 * np.where(inside, integrand(np.where(inside[..., None], 2 * x, 0.5)), 0.0)

    wide = mcs.Integrand.from_function(padded, dims=2).fourier_grid(2 * half_width)
    integers = integrand.fourier_grid(half_width)
    np.testing.assert_allclose(wide[::2, ::2], integers, atol=2e-3)
    share = (np.abs(integers) ** 2).sum() - abs(integers[half_width, half_width]) ** 2
    square = mcs.Integrand.from_function(lambda x: integrand(x) ** 2, dims=2).integral
    share /= square - integrand.integral**2
    ratios = {}
    for n in (16, 256):
        exact = mcs.convergence(integrand, "jittered | shift", [n], realizations=1500, rng=2)
        truth, ci = float(exact["variance"][0]), exact["variance_ci"].values[0]
        options = {"realizations": 200, "rng": 3}
        at_integers = mcs.power_spectrum("jittered | shift", n, half_width=half_width, **options)
        between = mcs.power_spectrum(
            "jittered", n, half_width=2 * half_width, frequency_step=0.5, **options
        )
        found = mcs.spectra.variance_from_spectrum(at_integers, integers)
        # Truncation: at most the power of random points, (1/n) of the rest of ∫f² − I²
        rest = (1 - share) * (square - integrand.integral**2) / n
        noise = 4 * (ci[1] - ci[0]) / 3.92
        assert -noise - rest < found - truth < noise
        real = mcs.spectra.variance_from_spectrum(between, wide)
        m = np.arange(-2 * half_width, 2 * half_width + 1) / 2
        nu = np.stack(np.meshgrid(m, m, indexing="ij"), axis=-1)
        power = mcs.closed_form_power("jittered", n, nu) * (nu != 0).any(axis=-1)
        # Realizations differ by a tenth of their common part, and there are 200
        assert real == pytest.approx((np.abs(wide) ** 2 * power).sum() / 4, rel=0.04)
        ratios[n] = real / truth
    assert ratios[16] > 3
    assert ratios[256] > 8 * ratios[16]
