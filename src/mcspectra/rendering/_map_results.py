"""From the variances of an image's pixels to the labelled maps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.results import dataset
from mcspectra.rendering import _map_statistics as statistics
from mcspectra.rendering._map_kernel import RECEIVER
from mcspectra.rendering._map_prediction import Prediction
from mcspectra.rendering._map_tiles import Maps, Measurement
from mcspectra.rendering.scene_checks import camera_rays

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["DIMS", "labelled"]

_LARGEST_PREDICTED_SE = 0.5  # relative; beyond, a prediction is not reported
_SURE_LEVEL = 0.99865  # one-sided, three standard errors of a normal mean
_SHARES = ("mis-light", "mis-bsdf")
_SINGLE = ("light", "bsdf")
DIMS = {
    "variance": ("strategy", "n", "y", "x"),
    "variance_relative_se": ("strategy", "n", "y", "x"),
    "mean": ("strategy", "y", "x"),
    "mean_se": ("strategy", "y", "x"),
    "rate": ("strategy", "y", "x"),
    "rate_se": ("strategy", "y", "x"),
    "rate_ci": ("strategy", "y", "x", "bound"),
    "fit_chi2": ("strategy", "y", "x"),
    "bottleneck": ("y", "x"),
    "dominant_technique": ("y", "x"),
    "mis_gain": ("y", "x"),
    "mis_gain_ci": ("y", "x", "bound"),
    "predicted_ratio": ("strategy", "y", "x"),
    "predicted_ratio_ci": ("strategy", "y", "x", "bound"),
}


def labelled(
    measurement: Measurement,
    prediction: Prediction | None,
    window: tuple[int, int, int, int],
    maps: Maps,
    smoothing: int,
) -> xr.Dataset:
    """Make the dataset of a map from the arrays (…, y, x) of all tiles."""
    x0, y0, width, height = window
    lighting = measurement.lighting
    found = _variables(measurement, maps, smoothing)
    return dataset(
        {name: (DIMS[name], values) for name, values in found.items()},
        {
            "strategy": list(measurement.strategies),
            "n": ("n", list(measurement.counts), {"long_name": "number of points", "units": "1"}),
            "y": ("y", np.arange(y0, y0 + height), {"long_name": "row", "units": "pixels"}),
            "x": ("x", np.arange(x0, x0 + width), {"long_name": "column", "units": "pixels"}),
            "bound": ["low", "high"],
        },
        scene=str(lighting.scene),
        sampler=measurement.sampler.spec,
        realizations=measurement.realizations,
        light="all" if lighting.light is None else lighting.light,
        heuristic=lighting.heuristic,
        channel=lighting.channel,
        points="own" if measurement.own else "shared",
        smoothing=smoothing,
        camera=camera_rays(lighting.scene),
        size=list(lighting.size),
        crop=list(window),
        prediction=None if prediction is None else prediction.method,
        pixels_measured=int((maps.status == RECEIVER).sum()),
        stream_key=f"{measurement.stream.key:#x}",
    )


def _variables(measurement: Measurement, maps: Maps, smoothing: int) -> dict[str, Array]:
    variance, relative_se = maps.variance, maps.relative_se
    # Few realisations leave every variance uncertain, without anything rare.
    largest_se = max(0.5, 1.5 * (2.0 / (measurement.realizations - 1)) ** 0.5)
    fits = statistics.fit_lines(
        np.array(measurement.counts), variance, relative_se, maps.mean, largest_se
    )
    rate, rate_se = statistics.smooth(fits.rate, fits.rate_se, smoothing, measurement.own)
    found = {
        "variance": variance,
        "variance_relative_se": relative_se,
        "mean": maps.mean[:, -1],
        "mean_se": np.sqrt(variance[:, -1] / measurement.realizations),
        "rate": rate,
        "rate_se": rate_se,
        "rate_ci": statistics.interval(rate, rate_se),
        "fit_chi2": fits.chi2,
    }
    row = {name: i for i, name in enumerate(measurement.strategies)}
    if "mis" in row:
        shares = [row[name] for name in _SHARES]
        found["bottleneck"] = statistics.slowest(rate[shares], rate_se[shares])
        last = (variance[shares, -1], relative_se[shares, -1])
        found["dominant_technique"] = statistics.dominant(*last)
    if row.keys() >= {"mis", *_SINGLE}:
        single, mis = (fits.of(rows) for rows in ([row[s] for s in _SINGLE], [row["mis"]]))
        total = measurement.counts[-1]
        found["mis_gain"], found["mis_gain_ci"] = statistics.gain(single, mis, total)
    if np.isfinite(maps.predicted).any():
        missed = _missed(row, found["mean"], found["mean_se"], measurement.realizations)
        found |= _predicted(maps, largest_se, missed)
    return found


def _missed(row: dict[str, int], mean: Array, se: Array, realizations: int) -> Array:
    """Where a strategy (S, y, x) met surely less light than another, by Student's t of the means.

    Its variance lacks what it did not meet. Shares of MIS have means of their own: never.
    """
    from scipy.special import stdtrit

    reach = se * stdtrit(realizations - 1, _SURE_LEVEL)
    whole = [i for name, i in row.items() if name not in _SHARES]
    found = np.zeros(mean.shape, bool)
    with np.errstate(invalid="ignore"):
        found[whole] = (mean + reach)[whole] < (mean - reach)[whole].max(axis=0)
    return found


def _predicted(maps: Maps, largest_se: float, missed: Array) -> dict[str, Array]:
    """Predicted over measured variance at the largest count, both uncertain.

    NaN where either comes of very few samples that met what is rare, or of none: such values are
    most often far too small, and so are their errors.
    """
    predicted, measured = maps.predicted, maps.variance[:, -1]
    with np.errstate(invalid="ignore", divide="ignore"):
        own, other = maps.predicted_se / predicted, maps.relative_se[:, -1]
        error = np.hypot(own, other)
        log_ratio = np.log(predicted) - np.log(measured)
        known = np.isfinite(log_ratio) & (own <= _LARGEST_PREDICTED_SE) & (other <= largest_se)
        log_ratio[~known | missed] = np.nan
        value, ci = statistics.ratio(log_ratio, error)
    return {"predicted_ratio": value, "predicted_ratio_ci": ci}
