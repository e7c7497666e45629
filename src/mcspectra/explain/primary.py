"""The primary-space integrand as an image, with jumps that explain slow rates.

Jumps inside the square and jumps between opposite sides reduce the rate of correlated samplers.
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
"""Kinds of jumps: within the square, or between opposite sides."""


@dataclass(frozen=True)
class PictureSettings:
    """Settings that detect jumps between opposite faces, and densities that reach zero."""

    # Distances from a face at which g is evaluated. The square root of float64's spacing,
    # 2^−26, balances the rounding of u against the change of a smooth g.
    # 2^−40 is 2^14 times closer and still exact next to 1.
    near: float = 2.0**-26
    nearer: float = 2.0**-40
    # Fraction of a difference between opposite faces that must remain at the smaller distance
    # from the faces for a jump. A jump remains in full. Without a jump,
    # 2^−14 of the difference of a smooth g remains, and 2^−7 of that of a square root.
    stays: float = 0.5
    # Factor by which g must grow from the larger to the smaller distance for a pole at a face.
    # The power t^−a grows by more for a > 1/14, and bounded functions grow less.
    grows: float = 2.0
    # Difference between opposite faces that counts as rounding, as a fraction of the range of g.
    # The smaller distance changes a smooth g by about 1e-8 of its range.
    negligible: float = 1e-7
    # Number of points along each axis of the grid on which a density is searched for zeros. 64
    # steps include all multiples of 1/64, where textures and piecewise densities have their zeros.
    probes: int = 65
    # Value of p, as a fraction of its largest value on the grid, that counts as zero:
    # 1/p is then 1e9 times its least value.
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
        Estimator, integrand, an integrand's spec string, or a function.
    dims
        Number of dims of a function, or of a spec without ``dims``.
    technique
        Index of the technique whose g is evaluated.
    resolution
        Number of cells along each axis, 4 to 1024.

    Returns
    -------
    xarray.Dataset
        ``primary_value`` (u0, u1[, channel]) is g at the centers of cells. ``primary_jump`` (axis,
        u0, u1) is the size of the jump to the next cell along each axis, 0 where g is continuous.
        ``face_jump`` (axis[, along]) is the size of the jump from u_axis = 0 to u_axis = 1,
        at centers along the other axis. This jump affects samplers that wrap around,
        and is infinite at poles. ``primary_jump_length`` and ``primary_jump_height`` (kind)
        are the length of the curves of jumps (their number in 1-D) and their mean height,
        for the kinds ``interior`` and ``boundary``. The height is infinite if g is unbounded there;
        ``primary_pole`` (kind) is then 1. ``reciprocal_unbounded`` is 1 if 1/p
        is unbounded because p reaches 0 on a grid. Jumps of several channels are Euclidean lengths.

    Raises
    ------
    ParameterError
        If there are more than two dims, if the technique does not exist,
        or if the resolution is out of range.
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

    # Jumps (dims[, side]) between opposite faces, and positions on faces with a pole
    faces = np.zeros((found.dims, side ** (found.dims - 1)))
    face_poles = np.zeros(faces.shape, bool)
    along = grid_centers(side, found.dims - 1) if found.dims > 1 else np.empty((1, 0))
    for axis in range(found.dims):
        # Values (2, k, channels) at the larger distance from both faces,
        # and at the smaller distance
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

    # Evaluate the density of the technique on a grid that includes the sides
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
