"""Quality figures over realisations: mean and standard error of each, or the reason for a gap."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["FigureSummary", "summarize"]


@final
@dataclass(frozen=True, kw_only=True)
class FigureSummary:
    """One quality figure over realisations.

    Attributes
    ----------
    name, long_name
        Name of its variable, and its long name.
    mean, standard_error
        Over realisations; the standard error is NaN where there is one realisation only.
    missing
        Why there is no mean, else empty.
    """

    name: str
    long_name: str
    mean: float
    standard_error: float
    missing: str


def summarize(figures: xr.Dataset) -> list[FigureSummary]:
    """Return mean and standard error of each figure that `quality_figures` returned."""
    return [_summary(str(name), array) for name, array in figures.data_vars.items()]


def _summary(name: str, figure: xr.DataArray) -> FigureSummary:
    values = figure.values
    count = len(values)
    error = float(np.std(values, ddof=1)) / math.sqrt(count) if count > 1 else math.nan
    return FigureSummary(
        name=name,
        long_name=figure.attrs["long_name"],
        mean=float(np.mean(values)),
        standard_error=error,
        missing=figure.attrs.get("missing", ""),
    )
