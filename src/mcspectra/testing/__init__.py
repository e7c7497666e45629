"""Checks of your own samplers, densities, integrands and analyses against the library's contracts.

`mcspectra.testing.strategies`, which needs hypothesis, makes random ones for tests by properties.
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
