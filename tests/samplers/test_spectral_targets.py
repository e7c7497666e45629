"""Sets for given targets: closed-form transforms, gradients, power within its band, refusals."""

import numpy as np
import pytest
from scipy import special

import mcspectra as mcs
from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.samplers import StepBlueNoise, TargetPcf, TargetSpectrum
from mcspectra.samplers.spectral_targets import RingLoss, hankel, piecewise_linear

TARGETS = [
    (StepBlueNoise(), lambda nu: nu >= 0.55),
    (StepBlueNoise(cutoff=0.3), lambda nu: nu >= 0.3),
    (TargetSpectrum(), lambda nu: np.clip((nu - 0.2) / 0.6, 0, 1)),
    (
        TargetSpectrum(frequencies=[0.0, 0.5, 0.8, 1.2], power=[0.3, 0.3, 1.2, 1.0]),
        lambda nu: np.interp(nu, [0.5, 0.8, 1.2], [0.3, 1.2, 1.0]),
    ),
]


def ring_power(points, most):
    """Return radius and mean power of the rings |m| = 1 … most, by direct sums."""
    axis = np.arange(-most - 1, most + 2)
    x, y = (np.exp(2j * np.pi * np.outer(axis, points[:, j])) for j in (0, 1))
    power = np.abs(x @ y.T) ** 2 / len(points)
    norm = np.hypot(axis[:, None], axis)
    rings = [np.round(norm) == r for r in range(1, most + 1)]
    return norm, power, rings


@pytest.mark.parametrize(("sampler", "target"), TARGETS, ids=lambda v: getattr(v, "spec", ""))
@pytest.mark.parametrize("n", [50, 256])
def test_power_is_within_its_band(sampler, target, n):
    """Mean power of each ring within one standard error of independent exponential powers."""
    points = sampler.draw(n, rng=1)[0]
    norm, power, rings = ring_power(points, int(2 * n**0.5))
    wanted = target(norm / n**0.5).astype(float)
    for ring in rings:
        band = max(wanted[ring].mean(), 0.1) / np.sqrt(ring.sum() / 2)
        assert abs(power[ring].mean() - wanted[ring].mean()) < band
    assert sampler.misfit(points) < 0.01
    assert sampler.misfit(np.random.default_rng(1).random((n, 2))) > 0.1


def test_misfit_is_the_root_mean_square_over_frequencies():
    points = np.random.default_rng(2).random((30, 2))
    norm, power, rings = ring_power(points, 11)
    wanted = (norm / 30**0.5 >= 0.4).astype(float)
    squares = sum(r.sum() * (power[r].mean() - wanted[r].mean()) ** 2 for r in rings)
    expected = np.sqrt(squares / sum(r.sum() for r in rings))
    assert abs(StepBlueNoise(cutoff=0.4).misfit(points) - expected) < 1e-7


def test_pair_correlation_follows_the_target():
    """Pairs of four sets in seven bins, compared with n²/2 ∫ g 2πr dr within 5 Poisson errors."""
    n, sampler = 128, TargetPcf(iterations=80)
    points = sampler.draw(n, realizations=4, rng=1)
    delta = points[:, :, None] - points[:, None]
    r = np.linalg.norm(delta - np.round(delta), axis=-1)[:, *np.triu_indices(n, 1)] * n**0.5
    edges = np.array([0.0, 0.3, 0.5, 0.7, 0.9, 1.2, 1.6, 2.0])
    pairs = np.histogram(r, edges)[0]
    fine = np.linspace(0, 2, 20_001)
    integral = np.cumsum(np.interp(fine, [0.4, 0.6], [0, 1]) * 2 * np.pi * fine) * 1e-4
    expected = 4 * n / 2 * np.diff(np.interp(edges, fine, integral))
    # Details finer than 1/(2·4) are not matched: ends of a bin are uncertain by 1/16 of a unit
    smear = 4 * n / 2 * 2 * np.pi * edges[1:] / 16 * (np.abs(edges[1:] - 0.5) < 0.3)
    assert (np.abs(pairs - expected) < 5 * np.sqrt(expected) + smear).all()


def test_transform_of_a_step_is_a_bessel_function():
    s = np.array([0.0, 0.1, 0.5, 2.0, 6.0])
    found = hankel(lambda t: (t >= 0.5).astype(float), np.array([0.5]), s)
    expected = [1 - np.pi / 4, *(1 - 0.5 * special.j1(np.pi * s[1:]) / s[1:])]
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_transform_of_the_transform_is_the_profile():
    knots = np.array([0.2, 0.5, 0.9])
    profile = piecewise_linear(knots, np.array([0.3, 1.4, 1.0]))
    line = np.linspace(0, 40, 40_001)
    inner = hankel(profile, knots, line)
    at = np.array([0.1, 0.35, 0.7, 1.5])
    waves = special.j0(2 * np.pi * np.outer(at, line)) * (inner - 1) * line
    again = 1 + 2 * np.pi * np.sum(waves, axis=1) * 1e-3
    np.testing.assert_allclose(again, profile(at), atol=0.01)  # tail beyond 40: 40^(−3/2)


@pytest.mark.parametrize("n", [1, 2, 30])
def test_gradient_of_the_loss(n):
    rng = np.random.default_rng(n)
    points, direction, h = rng.random((n, 2)), rng.standard_normal((n, 2)), 1e-5
    loss = RingLoss(n, lambda nu: (nu > 0.5).astype(float), 2.0)
    value, gradient = loss(points)
    slope = (loss(points + h * direction)[0] - loss(points - h * direction)[0]) / (2 * h)
    assert abs(slope - np.sum(gradient * direction)) < 1e-5 * (value + 1)


def test_the_largest_step_is_where_the_pair_correlation_reaches_zero():
    largest = 1 / np.sqrt(np.pi)
    assert StepBlueNoise(cutoff=largest).cutoff == largest
    step = {"power": [0, 0]}
    TargetSpectrum(frequencies=[0, largest - 1e-4], **step)
    with pytest.raises(ParameterError, match=r"No point set has this power: .* would be -0.0"):
        TargetSpectrum(frequencies=[0, largest + 1e-3], **step)


def test_pair_correlations_that_cannot_be_made():
    TargetPcf(distances=[0, 0.56], pcf=[0, 0])
    with pytest.raises(ParameterError, match=r"its power would be -.* at the frequency 0 √n"):
        TargetPcf(distances=[0, 0.57], pcf=[0, 0])


def test_lists_become_tuples_and_specs():
    made = mcs.samplers.sampler("target-spectrum(frequencies=[0, 1], power=[0.5, 1])")
    assert made == TargetSpectrum(frequencies=(0.0, 1.0), power=np.array([0.5, 1.0]))
    assert hash(made) == hash(TargetSpectrum(frequencies=(0.0, 1.0), power=(0.5, 1.0)))


def test_misfit_requires_points():
    with pytest.raises(DomainError, match="2 are needed"):
        StepBlueNoise().misfit(np.zeros((4, 3)))
