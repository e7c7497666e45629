"""ANOVA parts from sampled frequencies against closed forms and pick-freeze, in up to 20 dims."""

import itertools

import numpy as np
import pytest

import mcspectra as mcs

# Limit of a pull from 16 batches: Student's t with 15 degrees of freedom exceeds 8 with
# probability 1e-6
SIGMAS = 8.0


def _pull(found, expected, expected_se=0.0):
    error = np.abs(found["anova_variance"].values - expected)
    return error / np.maximum(np.hypot(found["anova_variance_se"].values, expected_se), 1e-300)


def _by_axis(f, dims):
    """Return ∫g² and (∫g)² of the 1-D factor g of a separable gaussian, and the dims."""
    one = mcs.integrand(f, dims=1)
    x = (np.arange(200_000) + 0.5)[:, None] / 200_000
    values = one(x)
    return (values**2).mean(), values.mean() ** 2, dims


@pytest.mark.parametrize("dims", [1, 3, 20])
def test_random_points_give_the_parts_of_the_integrand(dims):
    """A product of factors g has σ²_u/n = Π_{i∈u} (∫g² − (∫g)²) Π_{i∉u} (∫g)² / n."""
    square, mean, _ = _by_axis("gaussian(width=0.6)", dims)
    found = mcs.measure.anova_spectrum(
        mcs.integrand("gaussian(width=0.6)", dims=dims), "random", 10, frequencies=512, rng=3
    )
    sizes = found["subset_size"].values
    expected = (square - mean) ** sizes * mean ** (dims - sizes) / 10
    assert found.attrs["power"] == "closed form"
    assert _pull(found, expected).max() < SIGMAS
    assert (found["anova_variance_se"].values < 0.4 * expected).all()


def test_all_parts_sum_to_the_exact_variance():
    """In 3-D, the parts of all subsets sum to the variance by quadrature over the strata."""
    f = mcs.Estimator("gaussian(width=0.5)", dims=3)
    found = mcs.measure.anova_spectrum(f, "jittered | shift", 27, order=3, frequencies=4096, rng=1)
    total = float(found["anova_variance"].sum())
    error = float(np.sqrt((found["anova_variance_se"] ** 2).sum()))
    assert (
        abs(total - mcs.exact_variance(f, mcs.sampler("jittered | shift", dims=3), 27)) < 8 * error
    )
    assert error < 0.1 * total


@pytest.mark.parametrize("spec", ["latin-hypercube | shift", "sobol | owen | shift"])
def test_parts_agree_with_pick_freeze(spec):
    """Sampled frequencies and pick-freeze are independent methods for the same parts."""
    f = mcs.integrand("gaussian(width=0.5, center=[0.3, 0.5, 0.6])", dims=3)
    sampler = mcs.sampler(spec, dims=3)
    found = mcs.measure.anova_spectrum(f, sampler, 8, frequencies=2048, realizations=256, rng=5)
    other = mcs.anova_variances(mcs.Estimator(f), sampler, 8, realizations=8000, rng=6)
    labels = other["subset_label"].values.tolist()
    assert found["subset_label"].values.tolist() == labels
    pull = _pull(found, other["anova_variance"].values, other["anova_variance_se"].values)
    assert pull.max() < SIGMAS, pull
    assert found.attrs["power"] == "closed form"


def test_a_single_frequency_contributes_to_its_subset_only():
    f = mcs.integrand("cosine(frequency=[2, 0, 1])", dims=3)
    found = mcs.measure.anova_spectrum(f, "random", 4, frequencies=4096, rng=2)
    label = dict(zip(found["subset_label"].values, found["anova_variance"].values, strict=True))
    assert [u for u, value in label.items() if value > 1e-20] == ["x0x2"]
    assert _pull(found, np.where(found["subset_label"] == "x0x2", 1 / 8, 0.0)).max() < SIGMAS


def test_all_subsets_up_to_the_order_are_listed():
    found = mcs.measure.anova_spectrum(
        mcs.integrand("gaussian", dims=4), "random", 4, order=3, frequencies=32
    )
    expected = [
        "".join(f"x{i}" for i in u) for s in (1, 2, 3) for u in itertools.combinations(range(4), s)
    ]
    assert found["subset_label"].values.tolist() == expected
