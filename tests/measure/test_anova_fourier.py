"""ANOVA parts from sampled frequencies: closed forms, pick-freeze, many dims."""

import itertools

import numpy as np
import pytest

import mcspectra as mcs

SIGMAS = 8.0  # of 16 batches: t with 15 degrees beyond 8 has 1e-6


def _pull(found, expected, expected_se=0.0):
    error = np.abs(found["anova_variance"].values - expected)
    return error / np.maximum(np.hypot(found["anova_variance_se"].values, expected_se), 1e-300)


def _by_axis(f, dims):
    """(∫g², ∫g)² of the factor g of a separable gaussian: by its 1-D integrand."""
    one = mcs.integrand(f, dims=1)
    x = (np.arange(200_000) + 0.5)[:, None] / 200_000
    values = one(x)
    return (values**2).mean(), values.mean() ** 2, dims


@pytest.mark.parametrize("dims", [1, 3, 20])
def test_random_points_give_the_parts_of_the_integrand(dims):
    """σ²_u/n = Π_{u} (∫g² − (∫g)²) Π_{not u} (∫g)² / n of a product of g."""
    square, mean, _ = _by_axis("gaussian(width=0.6)", dims)
    found = mcs.measure.anova_spectrum(
        mcs.integrand("gaussian(width=0.6)", dims=dims), "random", 10, frequencies=512, rng=3
    )
    sizes = found["subset_size"].values
    expected = (square - mean) ** sizes * mean ** (dims - sizes) / 10
    assert found.attrs["power"] == "closed form"
    assert _pull(found, expected).max() < SIGMAS
    assert (found["anova_variance_se"].values < 0.4 * expected).all()


def test_all_subsets_make_the_exact_variance():
    """Three dims, all subsets of up to three axes: the sum is that of stratum quadrature."""
    f = mcs.Estimator("gaussian(width=0.5)", dims=3)
    found = mcs.measure.anova_spectrum(f, "jittered | shift", 27, order=3, frequencies=8192, rng=1)
    total = float(found["anova_variance"].sum())
    error = float(np.sqrt((found["anova_variance_se"] ** 2).sum()))
    assert (
        abs(total - mcs.exact_variance(f, mcs.sampler("jittered | shift", dims=3), 27)) < 8 * error
    )
    assert error < 0.1 * total


@pytest.mark.parametrize("spec", ["latin-hypercube | shift", "sobol | owen | shift"])
def test_pick_freeze_finds_the_same_parts_of_a_sampler(spec):
    """Two estimates of c_u without anything in common: frequencies, and exchanged coordinates."""
    f = mcs.integrand("gaussian(width=0.5, center=[0.3, 0.5, 0.6])", dims=3)
    sampler = mcs.sampler(spec, dims=3)
    found = mcs.measure.anova_spectrum(f, sampler, 8, frequencies=2048, realizations=256, rng=5)
    other = mcs.anova_variances(mcs.Estimator(f), sampler, 8, realizations=8000, rng=6)
    labels = other["subset_label"].values.tolist()
    assert found["subset_label"].values.tolist() == labels
    pull = _pull(found, other["anova_variance"].values, other["anova_variance_se"].values)
    assert pull.max() < SIGMAS, pull
    assert found.attrs["power"] == "closed form"


def test_one_frequency_is_in_its_own_subset():
    f = mcs.integrand("cosine(frequency=[2, 0, 1])", dims=3)
    found = mcs.measure.anova_spectrum(f, "random", 4, frequencies=4096, rng=2)
    label = dict(zip(found["subset_label"].values, found["anova_variance"].values, strict=True))
    assert [u for u, value in label.items() if value > 1e-20] == ["x0x2"]
    assert _pull(found, np.where(found["subset_label"] == "x0x2", 1 / 8, 0.0)).max() < SIGMAS


def test_subsets_are_all_of_up_to_the_order():
    found = mcs.measure.anova_spectrum(
        mcs.integrand("gaussian", dims=4), "random", 4, order=3, frequencies=32
    )
    expected = [
        "".join(f"x{i}" for i in u) for s in (1, 2, 3) for u in itertools.combinations(range(4), s)
    ]
    assert found["subset_label"].values.tolist() == expected
