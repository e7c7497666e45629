"""Checks of your own samplers, densities, integrands and analyses against the library's contracts.

`mcspectra.testing.strategies`, which needs hypothesis, makes random ones for tests by properties.
"""

from mcspectra.testing.analyses import check_analysis
from mcspectra.testing.contract import BrokenContract
from mcspectra.testing.densities import check_density
from mcspectra.testing.integrands import check_integrand
from mcspectra.testing.samplers import check_sampler

__all__ = [
    "BrokenContract",
    "check_analysis",
    "check_density",
    "check_integrand",
    "check_sampler",
]
