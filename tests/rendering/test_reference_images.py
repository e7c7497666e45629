"""Renders with our samplers have no bias against reference images; a biased sampler is found."""

import functools

import numpy as np
import pytest
from tests.rendering.reference_images import OURS, Pixels, Reference
from tests.rendering.small_scenes import SCENES

pytestmark = pytest.mark.render


@functools.cache
def pixels(name, width, height):
    return Pixels(SCENES[name], width, height)


@functools.cache
def reference(name, width, height, spp):
    return pixels(name, width, height).reference(spp)


def test_p_values_are_uniform_for_equal_means():
    rng = np.random.default_rng(1)
    sigma = np.exp(rng.standard_normal(2000))
    # The means of 400 and of 100 samples with these standard deviations
    known = Reference(1.0 + sigma * rng.standard_normal(2000) / 20.0, sigma**2, 400)
    image = 1.0 + sigma * rng.standard_normal(2000) / 10.0
    p = known.p_values(image, 100)
    # Kolmogorov-Smirnov: the largest deviation of 2000 uniform values is below 0.05 (p = 1e-4)
    assert np.abs(np.sort(p) - np.arange(2000) / 2000).max() < 0.05
    assert known.passes(image, 100)[0]
    assert not known.passes(image + 0.6 * sigma, 100)[0]


def test_our_sampler_has_no_bias_and_scaled_points_have_one():
    """A quick twin of the test of all scenes."""
    small, known = pixels("plate", 8, 6), reference("plate", 8, 6, 2**13)
    mean, own = small.image(OURS[0], 64, 16, seed=2)
    assert known.passes(mean, 1024, own)[0]
    assert not known.passes(small.scaled(0.97, 2**13, seed=3), 2**13)[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("plugin", OURS, ids=str)
def test_renders_pass_the_test_of_reference_images(name, plugin):
    known = reference(name, 16, 12, 2**14)
    mean, own = pixels(name, 16, 12).image(plugin, 64, 32, seed=2)
    passed, share = known.passes(mean, 2048, own)
    assert passed, f"{share:.2%} of the pixels agree"


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_scaled_points_fail(name):
    known, image = reference(name, 16, 12, 2**14), pixels(name, 16, 12).scaled
    clean = [known.passes(image(1.0, 2**14, seed=seed), 2**14)[0] for seed in range(3, 8)]
    # An image without bias fails with probability 0.01: two of five with probability 1e-3
    assert sum(clean) >= 4
    assert not known.passes(image(0.97, 2**14, seed=3), 2**14)[0]
