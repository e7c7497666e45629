"""Check your own samplers, densities, integrands and analyses against the library's contracts.

The module `mcspectra.testing.strategies` makes random components for property-based tests.
This module needs the package Hypothesis.
"""

from mcspectra.testing.contract import (
    BrokenContract,
    check_analysis,
    check_density,
    check_integrand,
    check_sampler,
)

__all__ = [
    "BrokenContract",
    "check_analysis",
    "check_density",
    "check_integrand",
    "check_sampler",
]
