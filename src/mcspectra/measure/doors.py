"""Common code of the public analysis functions: their body, coordinates and sentences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mcspectra.core.analysis import Analysis, compute
from mcspectra.estimators import as_subject

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["NO_VARIANCE", "VANISHES", "answer", "counted"]

NO_VARIANCE = "has no variance: add owen or shift, or compare |bias|"
"""Message after the name of a sampler that always draws the same set."""

VANISHES = "the variance vanishes to rounding"
"""Message if all estimates are equal to the integral."""


def answer(analysis: type[Analysis], arguments: Mapping[str, Any]) -> xr.Dataset:
    """Run an analysis for its public function, whose `locals()` give the names of the options.

    Parameters
    ----------
    analysis
        The class of the analysis.
    arguments
        ``estimator``, ``sampler`` or ``samplers``, ``dims``, ``rng``, and all other options.
        Analyses with threads also have ``workers``.
    """
    sampler = arguments.get("sampler", arguments.get("samplers"))
    subject = as_subject(
        arguments["estimator"],
        sampler,
        dims=arguments.get("dims"),
        lists=bool(analysis.several),
    )
    return compute(analysis.of(arguments), subject, arguments["rng"], arguments.get("workers"))


def counted(dim: str, values: Any, meaning: str) -> tuple[str, Any, dict[str, str]]:
    """Return a coordinate of dimensionless numbers along a dim."""
    return dim, values, {"long_name": meaning, "units": "1"}
