"""Check your own samplers, densities, integrands and analyses against the library's contracts.

The function `assert_same_image` compares renders with a reference, to test a renderer.

The module `mcspectra.testing.strategies` makes random components for property-based tests.
The random components need the package Hypothesis.
"""

from mcspectra.testing.contract import (
    BrokenContract,
    check_analysis,
    check_density,
    check_integrand,
    check_sampler,
)
from mcspectra.testing.images import ImagesDiffer, ImagesUndecided, assert_same_image

__all__ = [
    "BrokenContract",
    "ImagesDiffer",
    "ImagesUndecided",
    "assert_same_image",
    "check_analysis",
    "check_density",
    "check_integrand",
    "check_sampler",
]
