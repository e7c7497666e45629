"""Curves of measured variance against n: their variables, fits and labels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.results import dataset
from mcspectra.estimators import Moments
from mcspectra.estimators.moments import rounding_floor
from mcspectra.variance.fit import fit_rate

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["curve_from_moments", "fitted_counts", "labelled"]


def curve_from_moments(
    ns: list[int], moments: list[Moments], integral: Array, window: int | str
) -> dict[str, Array]:
    """Variances, intervals, bias and rate of one curve from the moments of its counts."""
    variance = np.stack([m.variance for m in moments])
    relative = np.stack([m.relative_se for m in moments])
    mean = np.stack([m.mean for m in moments])
    floor = rounding_floor(np.maximum(np.abs(mean), np.abs(integral)))
    fits = [
        fit_rate(np.array(ns), variance[:, c], relative[:, c], floor[:, c], window)
        for c in range(variance.shape[1])
    ]
    return {
        "variance": variance,
        "variance_ci": np.stack([m.variance_ci for m in moments]),
        "mean": mean,
        "mean_se": np.stack([m.mean_se for m in moments]),
        "bias": mean - integral,
        "mse": (mean - integral) ** 2
        + variance * np.array([(m.count - 1) / m.count for m in moments])[:, None],
        "realizations_used": np.array([m.count for m in moments]),
        "rate": np.array([fit.rate for fit in fits]),
        "rate_ci": np.array([fit.interval for fit in fits]),
        "fit_first_n": np.array([fit.first_n for fit in fits]),
        "fit_chi2": np.array([fit.chi2 for fit in fits]),
    }


def fitted_counts(ns: list[int], grid: list[list[dict[str, Array]]]) -> int | None:
    """How many counts the fits go over, the most of any; None where nothing was fitted."""
    first = np.array([curve["fit_first_n"] for row in grid for curve in row])
    fitted = first[np.isfinite(first)]
    return sum(n >= fitted.min() for n in ns) if fitted.size else None


_DIMS = {
    "variance": ("n", "channel"),
    "variance_ci": ("n", "channel", "bound"),
    "mean": ("n", "channel"),
    "mean_se": ("n", "channel"),
    "bias": ("n", "channel"),
    "bias_se": ("n", "channel"),
    "mse": ("n", "channel"),
    "realizations_used": ("n",),
    "reached": ("n",),
    "rate": ("channel",),
    "rate_ci": ("channel", "bound"),
    "fit_first_n": ("channel",),
    "fit_chi2": ("channel",),
}


def labelled(
    grid: list[list[dict[str, Array]]],
    ns: list[int],
    drop: list[str],
    coords: dict[str, Any],
    **provenance: Any,
) -> xr.Dataset:
    """Stack the curves of a grid estimator × sampler, dropping the dims that were not asked for."""
    variables = {}
    for name in grid[0][0]:
        own = _DIMS[name]
        dims = ("estimator", "sampler", *own)
        values = np.stack([np.stack([curve[name] for curve in row]) for row in grid])
        index = tuple(0 if dim in drop else slice(None) for dim in dims)
        variables[name] = (tuple(dim for dim in dims if dim not in drop), values[index])
    kept = {name: values for name, values in coords.items() if name not in drop}
    single = {name: values[0] for name, values in coords.items() if name in drop}
    count = ("n", ns, {"long_name": "number of points", "units": "1"})
    return dataset(
        variables, {"n": count, "bound": ["low", "high"], **kept}, **single, **provenance
    )
