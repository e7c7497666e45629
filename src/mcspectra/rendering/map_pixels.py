"""Maps from a part of the pixels: how these are chosen, and how all other pixels get values.

Method
------
Pixels are chosen at random in strata of the image, see `mcspectra.rendering.rendered`.
The value of another pixel is an average over its nearest measured pixels.
The weights are the inverse squares of their distances [Shepard1968]_.
Positive quantities, such as variances, are averaged as logarithms.
Pixels whose nearest measured pixel has no value, such as a background, have no value either.
Choices, such as the best sampler, are those of the nearest measured pixel.

The error of interpolation is measured by leaving pixels out.
Each measured pixel is interpolated from its neighbors alone, which gives a residual.
The scale s of errors at a pixel is the root mean square of the residuals near it.
The factor q is chosen so that 95 % of the residuals are smaller than q·s (conformal prediction).
A 95 % interval of an interpolated value is then ± q·s.
The intervals of interpolated values are valid on average over pixels, for any law of the residuals.
The intervals are a little too wide: a left-out pixel is farther from its neighbors than others.
The intervals include the noise of measured values, because noise makes residuals larger.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any, Final, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.core.display import counted, shown
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.rendering.rendered import Film, chosen_tiles

__all__ = ["FEWEST_PIXELS", "chosen_pixels", "nearest_pixels", "number_of_pixels", "spread"]

FEWEST_PIXELS = 64
"""Smallest number of measured pixels; with fewer, 95 % of the residuals is no useful quantile."""

_NEIGHBORS = 8  # number of measured pixels that are averaged; 6 to 12 are equally good
_NEARBY = 24  # number of nearby pixels that show how large interpolation errors at a pixel are
_SHARE = re.compile(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*%\s*")
_LOG, _PLAIN = True, False
_AVERAGED: Final[Mapping[str, bool]] = {
    # Quantities that are averaged over neighbors, and whether their logarithms are averaged
    "variance": _LOG,
    "mean": _PLAIN,
    "rate": _PLAIN,
    "path_variance": _LOG,
    "mis_gain": _LOG,
    "predicted_ratio": _LOG,
    "bounce_share": _PLAIN,
    "decision_share": _PLAIN,
}


def number_of_pixels(asked: int | str, total: int) -> int:
    """Return how many of `total` pixels are measured, from a number or a share such as ``"1%"``.

    Raises
    ------
    ParameterError
        If the text is not a share, or the pixels are fewer than `FEWEST_PIXELS`.
    """
    count = asked
    if not isinstance(count, str) and count > total:
        raise ParameterError(
            Parameter("pixels"),
            f" is {count}, more than the {counted(total, 'pixel')} of the image or crop; give at "
            f"most {total}, or leave it out to measure all.",
        )
    if isinstance(count, str):
        share = _SHARE.fullmatch(count)
        if share is None or not 0.0 < float(share[1]) <= 100.0:
            raise ParameterError(
                Parameter("pixels"),
                f" is {shown(asked)}; give a number of pixels, or a share such as '1%'.",
            )
        count = math.ceil(float(share[1]) / 100.0 * total)
    if count < min(FEWEST_PIXELS, total):
        raise ParameterError(
            Parameter("pixels"),
            f" is {shown(asked)}, which is {count} of {total} pixels; give at least "
            f"{min(FEWEST_PIXELS, total)} pixels for an interpolation.",
        )
    return count


def chosen_pixels(window: tuple[int, int, int, int], count: int, stream: Stream) -> Array:
    """Choose about `count` different pixels (P, 2) of a window, one per stratum, row by row."""
    x0, y0, width, height = window
    film = Film(x0 + width, y0 + height, margin=0)
    pixels, _ = chosen_tiles(film, count, stream, window)
    # Strata may share a pixel at their border
    rows = np.unique(pixels[:, ::-1], axis=0)
    return np.ascontiguousarray(rows[:, ::-1])


def nearest_pixels(measured: Array) -> tuple[Array, Array]:
    """Return row and column (y, x) of the measured pixel nearest to each pixel."""
    from scipy.ndimage import distance_transform_edt

    rows, columns = distance_transform_edt(~measured, return_distances=False, return_indices=True)
    return rows, columns


def spread(
    found: Mapping[str, Array], pixels: Array, window: tuple[int, int, int, int]
) -> dict[str, Array]:
    """Interpolate the variables of a map from its measured pixels to all pixels of a window.

    Parameters
    ----------
    found
        Variables at the measured pixels, (…, 1, P), or (…, 1, P, 2) for intervals.
        The variables have the names that `mcspectra.rendering.variance_map` gives them.
    pixels
        Measured pixels (P, 2), as x and y.
    window
        x0, y0, width and height of the result.

    Returns
    -------
    dict
        The given variables with the axes (…, y, x) or (…, y, x, 2), and two new variables:
        ``measured`` and ``interpolation_factor``.
        ``measured`` (y, x) is 1 at measured pixels.
        ``interpolation_factor`` (strategy, y, x) is a factor f, 1 at measured pixels:
        95 % of the variances are between 1/f and f times the interpolated ones.
        Standard errors and intervals include the error of interpolation.
    """
    x0, y0, width, height = window
    row, column = (pixels - (x0, y0)).T[::-1]
    measured = np.zeros((height, width), bool)
    measured[row, column] = True
    index = np.zeros((height, width), np.intp)
    index[row, column] = np.arange(len(pixels))
    nearest = index[nearest_pixels(measured)]
    field = _Field(pixels - (x0, y0), width, height, nearest)

    out = {}
    halves: dict[str, Array] = {}
    for name, values in found.items():
        pair = name.endswith("_ci")
        flat = values[..., 0, :, :] if pair else values[..., 0, :]
        if name in _AVERAGED:
            averaged = _on_planes(flat, field.logarithmic if _AVERAGED[name] else field.average)
            out[name], halves[name] = averaged[..., 0], averaged[..., 1]
            out[name][..., row, column] = flat  # at measured pixels, keep the exact measured values
        else:
            out[name] = flat[..., nearest, :] if pair else flat[..., nearest]

    # Add the error of interpolation to the errors at the nearest measured pixel
    for name, half in halves.items():
        se = half / CONFIDENCE_Z
        for own in (f"{name}_relative_se", f"{name}_se"):
            if own in out:
                # Errors of logarithms are relative errors
                absolute = _AVERAGED[name] and not own.endswith("_relative_se")
                scale = out[name] if absolute else 1.0
                out[own] = np.hypot(out[own], se * scale)
        if f"{name}_ci" in out:
            ends = out[f"{name}_ci"]
            with np.errstate(invalid="ignore", divide="ignore"):
                ends = np.log(ends) if _AVERAGED[name] else ends
                center = np.log(out[name]) if _AVERAGED[name] else out[name]
                wide = np.hypot(0.5 * (ends[..., 1] - ends[..., 0]), half)
                ends = np.stack([center - wide, center + wide], axis=-1)
                out[f"{name}_ci"] = np.exp(ends) if _AVERAGED[name] else ends
    out["measured"] = measured.astype(float)
    with np.errstate(over="ignore"):
        out["interpolation_factor"] = np.exp(halves["variance"][:, -1])
    out["interpolation_factor"][:, measured] = 1.0
    return out


def _on_planes(values: Array, function: Callable[[Array], Array]) -> Array:
    """Apply a function of values (P,) to every plane of values (…, P)."""
    planes = [function(plane) for plane in values.reshape(-1, values.shape[-1])]
    return np.stack(planes).reshape(*values.shape[:-1], *planes[0].shape)


@final
class _Field:
    """Averages of values at measured pixels over the pixels of a window."""

    def __init__(self, places: Array, width: int, height: int, nearest: Array) -> None:
        self._places, self._nearest = places.astype(float), nearest
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
        self._grid = grid.reshape(-1, 2).astype(np.float32)
        self._shape = height, width
        self._made: dict[bytes, Any] = {}

    def logarithmic(self, values: Array) -> Array:
        """Average the logarithms of values. Pixels nearest to a value of 0 get the value 0.

        The interval is computed for the logarithm.
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            found = self.average(np.where(values > 0.0, np.log(values), np.nan))
        zero = (values == 0.0)[self._nearest]
        found[..., 0] = np.where(zero, 0.0, np.exp(found[..., 0]))
        return found

    def average(self, values: Array) -> Array:
        """Return averages and half-widths of 95 % intervals, (y, x, 2), of values (P,)."""
        known = np.isfinite(values)
        out = np.full((*self._shape, 2), np.nan)
        if not known.any():
            return out
        weights, index, left_out = self._neighbors(known)
        own = values[known]
        center = np.einsum("pk,pk->p", weights, own[index], dtype=float)
        half = np.full(len(center), math.inf)
        if len(own) >= FEWEST_PIXELS:
            weight, place, nearby = left_out
            residuals = own - (weight * own[place]).sum(axis=1)
            squares = (residuals[nearby] ** 2).mean(axis=1)
            scale = np.sqrt((weight * squares[place]).sum(axis=1))
            rank = math.ceil(0.95 * (len(own) + 1)) - 1
            factor = 0.0
            if (scale > 0.0).any():
                ratios = np.abs(residuals) / np.where(scale > 0.0, scale, 1.0)
                factor = float(np.sort(ratios)[min(rank, len(own) - 1)])
            half = factor * np.sqrt(np.einsum("pk,pk->p", weights, squares[index], dtype=float))
        measured = weights[:, 0] == 1.0
        out[..., 0] = center.reshape(self._shape)
        out[..., 1] = np.where(measured, 0.0, half).reshape(self._shape)
        out[~known[self._nearest]] = np.nan
        return out

    def _neighbors(self, known: Array) -> tuple[Array, Array, tuple[Array, Array, Array]]:
        """Return weights and indices of the known pixels near each pixel of the grid.

        The third value has the weights and indices of other known pixels near each known pixel.
        """
        key = known.tobytes()
        if key not in self._made:
            from scipy.spatial import cKDTree

            places = self._places[known]
            tree: Any = cKDTree(places)
            count = min(_NEIGHBORS, len(places))
            distance, index = tree.query(self._grid, k=range(1, count + 1), workers=-1)
            weights = _weights(distance).astype(np.float32)
            nearby = np.zeros((len(places), 1), np.intp)
            if len(places) > _NEARBY:
                _, nearby = tree.query(places, k=range(1, _NEARBY + 1), workers=-1)
            away, place = tree.query(places, k=range(1, count + 2), workers=-1)
            # The first neighbor of a measured pixel is the pixel itself, because no two are equal
            left_out = _weights(away[:, 1:]), np.minimum(place[:, 1:], len(places) - 1), nearby
            self._made = {key: (weights, index.astype(np.int32), left_out)}
        found: tuple[Array, Array, tuple[Array, Array, Array]] = self._made[key]
        return found


def _weights(distance: Array) -> Array:
    """Inverse squares of distances (P, K), sorted, with sum 1; a distance 0 has all the weight."""
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = distance**-2.0
        weights /= weights.sum(axis=1, keepdims=True)
    own = distance[:, :1] == 0.0
    first = np.arange(distance.shape[1]) == 0
    return np.where(own, first, weights)
