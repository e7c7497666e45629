"""Results in words, for those who hear a figure instead of seeing it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mcspectra.report.figures.groups import frequency_dims
from mcspectra.report.formatting import number, number_beside, percent, rate

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "band_words",
    "captured_words",
    "first_channel",
    "for_each",
    "low_power_words",
    "peak_words",
    "rate_words",
    "term_words",
]

Datasets: TypeAlias = "Mapping[str, xr.Dataset]"


def rate_words(data: xr.Dataset) -> str:
    low, high = (float(end) for end in data["rate_ci"].values)
    counts = data["n"].values
    variance = data["variance"].values
    return (
        f"rate {rate(float(data['rate']), low, high)}, variance {number(float(variance[0]))} at "
        f"n = {counts[0]} and {number(float(variance[-1]))} at n = {counts[-1]}"
    )


def term_words(data: xr.Dataset) -> str:
    power = float(data["power_term"])
    values = (
        f"{t} {number_beside(float(data[f'{t}_term']), power)}" for t in ("dc", "power", "cross")
    )
    return f"{', '.join(values)}, measured {number(float(data['measured_variance']))}"


def captured_words(data: xr.Dataset) -> str:
    curve = data["captured_by_half_width"].values
    last = float(curve[-1])
    return f"{percent(last) if np.isfinite(last) else '–'} at half width {len(curve) - 1}"


def peak_words(data: xr.Dataset) -> str:
    """Where the contribution is largest; of ±m, which are equal, the later one."""
    values = data["contribution"]
    if not np.isfinite(values.values).any():
        return "infinite"
    flat = np.abs(np.nan_to_num(values.values)).ravel()
    place = np.unravel_index(len(flat) - 1 - int(np.argmax(flat[::-1])), values.shape)
    at = [
        f"{values[d].values[i]:g}"
        for d, i in zip(values.dims, place, strict=True)
        if str(d) in frequency_dims(data)
    ]
    peak = number(float(values.values[place]))
    return f"largest, {peak}, at m = ±({', '.join(at)})".replace("-", "−")


def band_words(data: xr.Dataset) -> str:
    matrix = data["band_covariance"].values
    total = float(matrix.sum())
    if not np.isfinite(total) or total == 0:
        return "no finite share"
    return f"{percent(float(np.trace(matrix)) / total)} of the predicted variance on the diagonal"


def low_power_words(data: xr.Dataset) -> str:
    low, high = (int(data.attrs["n"]) * float(data["radial_power"].values[i]) for i in (0, -1))
    return f"{number(low)} at the lowest and {number(high)} at the highest frequencies"


def for_each(data: Datasets, words: Callable[[xr.Dataset], str]) -> str:
    return "; ".join(f"{name}: {words(first_channel(each))}" for name, each in data.items()) + "."


def first_channel(data: xr.Dataset) -> xr.Dataset:
    return data.isel(channel=0) if "channel" in data.dims else data
