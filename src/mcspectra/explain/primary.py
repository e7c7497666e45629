"""The primary-space integrand as an image, with jumps that explain slow rates.

Jumps of g inside the square or on its border make the rates of correlated samplers slower.
Mirroring removes the jumps between opposite sides, but not the jumps inside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.linalg import norm

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.results import dataset
from mcspectra.estimators import AbstractEstimator, as_estimator
from mcspectra.estimators.quadrature import grid
from mcspectra.quality.jumps import find_jumps, grid_centers

if TYPE_CHECKING:
    import xarray as xr

    from mcspectra.densities import Density

__all__ = ["KINDS", "primary_picture"]

KINDS = ("interior", "boundary")
"""Kinds of jumps: inside the square, or between its opposite sides."""


@dataclass(frozen=True)
class PictureSettings:
    """Settings for detecting jumps between opposite faces, and densities that reach zero."""

    # Distances from a face at which g is evaluated.
    # 2^−26 is the square root of float64's spacing below 1.
    # At the distance 2^−26, both the rounding of u and the change of a smooth g are small.
    # The distance 2^−40 is 2^14 times smaller than 2^−26. 1 − 2^−40 is exact in float64.
    near: float = 2.0**-26
    nearer: float = 2.0**-40
    # The difference of g between opposite faces is measured at both distances from the faces.
    # g jumps if the difference at 2^−40 exceeds this fraction of the difference at 2^−26.
    # The ratio of the two differences is 1 for a jump, 2^−14 for smooth g, 2^−7 for square roots.
    stays: float = 0.5
    # g has a pole at a face if it grows by this factor from the larger to the smaller distance.
    # The power t^−a grows by more than this factor if a > 1/14; bounded functions grow less.
    grows: float = 2.0
    # A difference between opposite faces below this fraction of the range of g counts as rounding.
    # Between the distances 2^−26 and 2^−40, a smooth g changes by about 1e-8 of its range.
    negligible: float = 1e-7
    # Number of grid points along each axis at which zeros of a density are searched for.
    # Zeros of textures and of piecewise densities are often at multiples of 1/64.
    # A grid of 65 points contains all multiples of 1/64.
    probes: int = 65
    # A density counts as zero below this fraction of its largest value on the grid.
    # At this limit, 1/p is 1e9 times its least value.
    zero: float = 1e-9


_SETTINGS = PictureSettings()


def primary_picture(
    estimator: AbstractEstimator | Any,
    *,
    dims: int | None = None,
    technique: int = 0,
    resolution: int = 256,
) -> xr.Dataset:
    """Evaluate g(u) of an estimator on a grid in one or two dims, and find its jumps.

    Parameters
    ----------
    estimator
        Estimator, integrand, spec string of an integrand, or function of points.
    dims
        Number of dims; needed if the estimator is a function or a spec without ``dims``.
    technique
        Index of the technique whose g is evaluated.
    resolution
        Number of cells along each axis, from 4 to 1024.

    Returns
    -------
    xarray.Dataset
        A dataset. ``primary_value`` (u0, u1[, channel]) is g at the centers of cells.
        ``primary_jump`` (axis, u0, u1) is the size of the jump to the next cell along each axis.
        The size of a jump is 0 where g is continuous.
        ``face_jump`` (axis[, along]) is the size of the jump from u_axis = 0 to u_axis = 1.
        Jumps between opposite faces are computed at the centers of the cells along a face.
        At poles the jump is infinite.
        Jumps between faces matter for samplers that wrap around.
        The following variables have the two kinds ``interior`` and ``boundary``:
        ``primary_jump_length`` is the length of the curves on which g jumps.
        In 1-D, the length is the number of jumps. ``primary_jump_height`` is their mean height.
        If g is unbounded, the height is infinite and ``primary_pole`` is 1.
        ``reciprocal_unbounded`` is 1 if 1/p is unbounded because p reaches 0 on a grid.
        With several channels, the size of a jump is its Euclidean length over channels.

    Raises
    ------
    ParameterError
        If there are more than two dims, or if the technique does not exist.
        If the number of cells is out of range.
    DensityError
        If p is 0 where f is not.
    """
    found = as_estimator(estimator, dims)
    if found.dims > 2:
        raise ParameterError(
            f"{found.spec} has {found.dims} dims; primary-space pictures need 1 or 2 dims."
        )
    number = as_integer("technique", technique, least=0, most=len(found.counts) - 1)
    side = as_integer("resolution", resolution, least=4, most=1024)

    def g(u: Array) -> Array:
        values = found.primary_values(number, u)
        return values if found.channels else values[..., None]

    values = g(grid_centers(side, found.dims))
    scale = float(np.ptp(values, axis=tuple(range(found.dims))).max())
    jumps = find_jumps(g, found.dims, side, scale=scale)
    line = (np.arange(side) + 0.5) / side

    # Jumps (dims[, side]) between opposite faces, and positions on the faces where g has a pole
    faces = np.zeros((found.dims, side ** (found.dims - 1)))
    face_poles = np.zeros(faces.shape, bool)
    along = grid_centers(side, found.dims - 1) if found.dims > 1 else np.empty((1, 0))
    for axis in range(found.dims):
        # Values (2, k, channels) on both faces at two distances, the larger distance first
        near, nearer = (
            np.stack([g(np.insert(along, axis, end, axis=1)) for end in (gap, 1.0 - gap)])
            for gap in (_SETTINGS.near, _SETTINGS.nearer)
        )
        before, after = (norm(ends[1] - ends[0], axis=-1) for ends in (near, nearer))
        least = _SETTINGS.negligible * scale
        jump = (after > _SETTINGS.stays * before) & (after > least)
        sizes, growing = (norm(ends, axis=-1).max(axis=0) for ends in (near, nearer))
        face_poles[axis] = (growing > _SETTINGS.grows * sizes) & (growing > least)
        faces[axis] = np.where(face_poles[axis], np.inf, np.where(jump, after, 0.0))
    finite = faces[(faces > 0) & np.isfinite(faces)]
    poles = np.array([jumps.poles.any(), face_poles.any()])
    heights = [jumps.mean_height, float(finite.mean()) if finite.size else 0.0]

    # Evaluate the density of the technique on a grid that includes the border
    reaches_zero = False
    density: Density | None = getattr(found.primary_integrand(number), "density", None)
    if density is not None:
        probes = grid(np.linspace(0.0, 1.0, _SETTINGS.probes), density.dims)
        p = density.pdf(np.concatenate([probes, density.zero_points()]))
        reaches_zero = bool(p.min() <= _SETTINGS.zero * p.max())

    cells = tuple(f"u{axis}" for axis in range(found.dims))
    return dataset(
        {
            "primary_value": ((*cells, "channel"), values),
            "primary_jump": (("axis", *cells), jumps.heights),
            "face_jump": (
                ("axis", "along")[: found.dims],
                faces.reshape((found.dims, side)[: found.dims]),
            ),
            "primary_jump_length": (
                ("kind",),
                [jumps.length, float(np.count_nonzero(faces) / faces.shape[1])],
            ),
            "primary_jump_height": (("kind",), np.where(poles, np.inf, heights)),
            "primary_pole": (("kind",), poles.astype(np.int64)),
            "reciprocal_unbounded": ((), int(reaches_zero)),
        },
        {**dict.fromkeys(cells, line), "axis": np.arange(found.dims), "kind": list(KINDS)},
        drop=() if found.channels else ("channel",),
        estimator=found.spec,
        technique=number,
        resolution=side,
    )
