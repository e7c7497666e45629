"""Parts that all analyses share: the body of their public functions, coordinates of results, sentences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mcspectra.core.analysis import Analysis, compute
from mcspectra.estimators import as_subject

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["NO_VARIANCE", "VANISHES", "answer", "counted"]

NO_VARIANCE = "has no variance: add owen or shift, or look at |bias|"
"""Words about a sampler whose set is the same every time, after its name."""

VANISHES = "the variance vanishes to rounding"
"""Words about estimates that all equal the integral."""


def answer(analysis: type[Analysis], arguments: Mapping[str, Any]) -> xr.Dataset:
    """Compute an analysis for its public function, whose arguments (`locals()`) are named as its options.

    Parameters
    ----------
    analysis
        Its class.
    arguments
        ``estimator``, ``sampler`` or ``samplers``, ``dims``, ``rng``, ``workers`` if it has threads, and
        every option.
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
    """A coordinate of pure numbers along a dim."""
    return dim, values, {"long_name": meaning, "units": "1"}
