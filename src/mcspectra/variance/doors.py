"""What the public functions of analyses share: their body, and what their results say of themselves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mcspectra.core.analysis import Analysis, Subject, compute
from mcspectra.core.streams import Stream
from mcspectra.estimators import as_subject

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["answer", "counted", "provenance"]


def answer(
    analysis: type[Analysis], arguments: Mapping[str, Any], *, lists: bool = False
) -> xr.Dataset:
    """Compute an analysis for its public function, whose arguments (`locals()`) are named as its options.

    Parameters
    ----------
    analysis
        Its class.
    arguments
        ``estimator``, ``sampler``, ``rng``, ``workers`` if it has threads, and every option.
    lists
        Whether there may be lists of estimators and samplers.
    """
    asked = analysis(**{name: arguments[name] for name in analysis.__struct_fields__})
    subject = as_subject(arguments["estimator"], arguments["sampler"], lists=lists)
    return compute(asked, subject, arguments["rng"], arguments.get("workers"))


def provenance(asked: Analysis, subject: Subject, stream: Stream, *options: str) -> dict[str, Any]:
    """Attributes of a result: the specs of its subject, its random numbers, and some of its options."""
    return {
        "estimator": subject.estimator.spec,
        "sampler": subject.sampler.spec,
        **{name: getattr(asked, name) for name in options},
        "stream_key": f"{stream.key:#x}",
    }


def counted(dim: str, values: Any, meaning: str) -> tuple[str, Any, dict[str, str]]:
    """A coordinate of pure numbers along a dim."""
    return dim, values, {"long_name": meaning, "units": "1"}
