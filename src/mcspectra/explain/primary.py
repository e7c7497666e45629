"""The primary-space integrand as a picture with its jumps: why a rate is slow.

Jumps inside the square and jumps between opposite sides cost correlated samplers their rate in
different ways: those at the boundary are undone by mirroring, those inside are not.
"""

from __future__ import annotations

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
"""Where jumps are: within the square, or between opposite sides."""

_NEAR, _NEARER = 2.0**-26, 2.0**-40  # of the sides
_STAYS, _GROWS = 0.5, 2.0
_NEGLIGIBLE = 1e-7
_PROBES = 65
_ZERO = 1e-9  # of the largest p


def primary_picture(
    estimator: AbstractEstimator | Any,
    *,
    dims: int | None = None,
    technique: int = 0,
    resolution: int = 256,
) -> xr.Dataset:
    """Draw up g(u) of an estimator in one or two dims with its jumps.

    Parameters
    ----------
    estimator
        Estimator, integrand, an integrand's spec string, or a function.
    dims
        Number of dims of a function, and of a spec that leaves it open.
    technique
        Which technique's g.
    resolution
        Cells along each axis, 4 to 1024.

    Returns
    -------
    xarray.Dataset
        ``primary_value`` (u0, u1[, channel]): g at the centres of cells. ``primary_jump``
        (axis, u0, u1): size of the jump to the next cell along each axis, 0 where g is continuous.
        ``face_jump`` (axis[, along]): size of the jump from u_axis = 0 to u_axis = 1, which a
        sampler that wraps around sees, at centres along the other axis; infinite at poles.
        ``primary_jump_length`` and ``primary_jump_height`` (kind): length of the curves of jumps
        (their number in 1-D) and their mean height, of kind ``interior`` and ``boundary``; infinite
        where g is unbounded there, which ``primary_pole`` (kind) says. ``reciprocal_unbounded``:
        whether 1/p is unbounded, that is p reaches 0, as found by probing. Jumps of several channels
        are Euclidean lengths.

    Raises
    ------
    ParameterError
        More than two dims, no such technique, or a resolution out of range.
    DensityError
        p is 0 where f is not.
    """
    found = as_estimator(estimator, dims)
    if found.dims > 2:
        raise ParameterError(
            f"{found.spec} has {found.dims} dims; primary-space pictures are made in 1 and 2 dims."
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

    # Jumps (dims[, side]) between opposite faces, and which faces have a pole
    faces = np.zeros((found.dims, side ** (found.dims - 1)))
    face_poles = np.zeros(faces.shape, bool)
    along = grid_centers(side, found.dims - 1) if found.dims > 1 else np.empty((1, 0))
    for axis in range(found.dims):
        # Values (2, k, channels) next to both faces, and nearer to them
        near, nearer = (
            np.stack([g(np.insert(along, axis, end, axis=1)) for end in (gap, 1.0 - gap)])
            for gap in (_NEAR, _NEARER)
        )
        before, after = (norm(ends[1] - ends[0], axis=-1) for ends in (near, nearer))
        jump = (after > _STAYS * before) & (after > _NEGLIGIBLE * scale)
        sizes, growing = (norm(ends, axis=-1).max(axis=0) for ends in (near, nearer))
        face_poles[axis] = (growing > _GROWS * sizes) & (growing > _NEGLIGIBLE * scale)
        faces[axis] = np.where(face_poles[axis], np.inf, np.where(jump, after, 0.0))
    finite = faces[(faces > 0) & np.isfinite(faces)]
    poles = np.array([jumps.poles.any(), face_poles.any()])
    heights = [jumps.mean_height, float(finite.mean()) if finite.size else 0.0]

    # Whether the technique's density is 0 somewhere, by probing a grid that holds the sides
    reaches_zero = False
    density: Density | None = getattr(found.primary_integrand(number), "density", None)
    if density is not None:
        probes = grid(np.linspace(0.0, 1.0, _PROBES), density.dims)
        p = density.pdf(np.concatenate([probes, density.zero_points()]))
        reaches_zero = bool(p.min() <= _ZERO * p.max())

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
