"""Scrambled nets: gains against a slow sum and the dual net, variances against simulation."""

import itertools

import numpy as np
import pytest
from scipy import stats

import mcspectra as mcs

NETS = [
    ("sobol", 2, 8),
    ("sobol", 3, 16),
    ("niederreiter", 3, 8),
    ("larcher-pillichshammer", 2, 16),
]


def slow_gain(points, bases, level):
    """Return gains by Owen's definition, pair by pair, from digit strings."""
    total = 0.0
    for a, b in itertools.product(points, points):
        factor = 1.0
        for x, y, base, many in zip(a, b, bases, level, strict=True):
            if many:
                same = [
                    int(x * base**k + 1e-9) == int(y * base**k + 1e-9) for k in (many - 1, many)
                ]
                factor *= (base * same[1] - same[0]) / (base - 1)
        total += factor
    return total / len(points)


def walsh(m, x):
    """Return the Walsh function in Paley order of one coordinate, digit by digit."""
    sign = np.ones(x.shape)
    for place in range(int(m).bit_length()):
        if m >> place & 1:
            sign *= 1 - 2 * (np.floor(x * 2 ** (place + 1)) % 2)
    return sign


@pytest.mark.parametrize(
    ("spec", "dims", "n"), [*NETS, ("faure", 3, 9), ("halton", 2, 7), ("sobol | owen", 2, 8)]
)
def test_gains_agree_with_the_definition(spec, dims, n):
    levels = 3
    sampler = mcs.sampler(spec, dims=dims)
    base = getattr(sampler, "base", sampler) if "|" in spec else sampler
    d = mcs.spectra.gain_coefficients(sampler, n, levels=levels)
    assert d["gain"].dims == tuple(f"level{i}" for i in range(dims))
    points = base.draw(n)[0]
    for level in itertools.product(range(levels + 1), repeat=dims):
        expected = slow_gain(points, base.digit_bases, level) if any(level) else 0.0
        assert d["gain"].values[level] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("spec", "dims", "n"), NETS)
def test_gains_follow_from_the_dual_net(spec, dims, n):
    """Γ_l = n · (fraction of the indices of level l that are in the dual net)."""
    levels = 4
    sampler = mcs.sampler(spec, dims=dims)
    axes = np.meshgrid(*[np.arange(2**levels)] * dims, indexing="ij")
    dual = mcs.spectra.closed_form_walsh_power(
        sampler.then(mcs.sampler("sobol | digital-shift", dims=dims).steps[0]),
        n,
        np.stack(axes, axis=-1),
    )
    starts = np.array([0, 1, 2, 4, 8])
    shares, sizes = dual * n, np.ones(dual.shape)
    for axis in range(dims):
        shares = np.add.reduceat(shares, starts, axis=axis)
        sizes = np.add.reduceat(sizes, starts, axis=axis)
    expected = shares / sizes
    expected[(0,) * dims] = 0.0
    found = mcs.spectra.gain_coefficients(sampler, n, levels=levels)["gain"].values
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("base", [2, 3])
def test_a_net_of_quality_0_has_no_coarse_part_and_bounded_gains(base):
    """(0, m, 2)-nets: Γ = 0 for l_1 + l_2 ≤ m, Γ = 1 on an axis above, and Γ ≤ b/(b − 1)."""
    m = 4
    spec = "sobol" if base == 2 else "faure(base=3)"
    gain = mcs.spectra.gain_coefficients(spec, base**m, dims=2, levels=m + 2)["gain"].values
    level = np.arange(m + 3)
    assert (gain[level[:, None] + level <= m] == 0).all()
    np.testing.assert_allclose(gain[0, m + 1 :], 1.0)
    np.testing.assert_allclose(gain[m + 1 :, m + 1 :], 1.0)
    assert gain.max() <= base / (base - 1) + 1e-12
    assert gain.min() >= -1e-12


@pytest.mark.parametrize(("spec", "dims", "n"), NETS)
@pytest.mark.parametrize("step", ["digital-shift", "owen"])
def test_walsh_power_against_simulation(spec, dims, n, step):
    sampler = mcs.sampler(f"{spec} | {step}", dims=dims)
    indices = np.array(list(itertools.product(range(1 if dims > 2 else 0, 5), repeat=dims)))
    x = sampler.draw(n, realizations=2000, rng=5)
    power = np.empty((len(x), len(indices)))
    for i, m in enumerate(indices):
        s = np.prod([walsh(int(k), x[..., j]) for j, k in enumerate(m)], axis=0).mean(axis=1)
        power[:, i] = s**2
    exact = mcs.spectra.closed_form_walsh_power(sampler, n, indices)
    if step == "digital-shift":
        np.testing.assert_allclose(power, np.broadcast_to(exact, power.shape), atol=1e-12)
        return
    limit = stats.norm.isf(0.5 * (1 - (1 - 1e-4) ** (1 / len(indices))))
    se = power.std(axis=0) / np.sqrt(len(power))
    assert (np.abs(power.mean(axis=0) - exact) <= limit * se + 1e-12).all()


def test_given_matrices_have_the_dual_net_of_their_sequence():
    """The matrices of Sobol' points are given as lists of rows."""
    columns = mcs.sampler("sobol", dims=2).direction_numbers(8)[:, :3].astype(np.int64)
    matrices = columns[:, None, :] >> np.arange(31, 28, -1)[None, :, None] & 1
    indices = np.stack(np.meshgrid(np.arange(16), np.arange(16)), axis=-1)
    net = mcs.samplers.DigitalNet(matrices=matrices.tolist())
    shift = mcs.sampler("sobol | digital-shift", dims=2).steps[0]
    np.testing.assert_array_equal(
        mcs.spectra.closed_form_walsh_power(net.then(shift), 8, indices % 8),
        mcs.spectra.closed_form_walsh_power("sobol | digital-shift", 8, indices % 8),
    )


@pytest.mark.parametrize("spec", ["linear", "disk", "gaussian(width=0.25)"])
def test_nested_variances_add_up_to_the_variance(spec):
    f = mcs.integrand(spec, dims=2)
    levels = 8
    parts = mcs.spectra.nested_variances(f, levels)
    assert parts.shape == (levels + 1, levels + 1)
    assert parts[0, 0] == 0.0
    whole = mcs.exact_variance(mcs.Estimator(f), "random", 1) if spec != "disk" else None
    if whole is None:
        whole = f.integral - f.integral**2
    # Beyond 2^-8 the disk has at most ¼ in 4 · 2^8 cells of its border, 0.004 of 0.16 in all
    assert 0.97 * whole <= parts.sum() <= whole * (1 + 1e-9)


def test_nested_variances_of_a_linear_function_are_powers_of_four():
    """x = ½ + Σ digits: level l of one axis has ∫ (2^-(l+1))² = 4^-(l+1)."""
    f = mcs.Integrand.from_function(lambda x: x[..., 0] + 2 * x[..., 1], dims=2)
    parts = mcs.spectra.nested_variances(f, 5)
    expected = np.zeros((6, 6))
    expected[1:, 0] = 0.25 ** (np.arange(1, 6) + 1)
    expected[0, 1:] = 4 * 0.25 ** (np.arange(1, 6) + 1)
    np.testing.assert_allclose(parts, expected, atol=1e-15)
