"""The primary-space integrand as a picture with its jumps: why a rate is slow.

Jumps inside the square and jumps between opposite sides cost correlated samplers their rate in
different ways: those at the boundary are undone by mirroring, those inside are not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.results import dataset
from mcspectra.estimators import AbstractEstimator, as_estimator
from mcspectra.quality.jumps import Jumps, find_jumps, grid_centers

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
    estimator: AbstractEstimator | Any, *, technique: int = 0, resolution: int = 256
) -> xr.Dataset:
    """Draw up g(u) of an estimator in one or two dims with its jumps.

    Parameters
    ----------
    estimator
        Estimator, integrand, or an integrand's spec string.
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
    found = as_estimator(estimator)
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
    faces, face_poles = _faces(g, found.dims, side, scale)
    cells = tuple(f"u{axis}" for axis in range(found.dims))
    channel = ("channel",) if found.channels else ()
    line = (np.arange(side) + 0.5) / side
    return dataset(
        {
            "primary_value": ((*cells, *channel), values if found.channels else values[..., 0]),
            "primary_jump": (("axis", *cells), jumps.heights),
            "face_jump": (("axis", "along")[: found.dims], faces),
            **_by_kind(jumps, faces, face_poles),
            "reciprocal_unbounded": ((), int(_reaches_zero(found, number))),
        },
        {**dict.fromkeys(cells, line), "axis": np.arange(found.dims), "kind": list(KINDS)},
        estimator=found.spec,
        technique=number,
        resolution=side,
    )


def _by_kind(jumps: Jumps, faces: Array, face_poles: Array) -> dict[str, tuple[tuple[str], Any]]:
    """Lengths, mean heights and poles, interior and boundary."""
    poles = np.array([jumps.poles.any(), face_poles.any()])
    share = faces.shape[1] if faces.ndim == 2 else 1
    lengths = [jumps.length, float(np.count_nonzero(faces) / share)]
    heights = np.where(poles, np.inf, [jumps.mean_height, _mean_of_jumps(faces)])
    return {
        "primary_jump_length": (("kind",), lengths),
        "primary_jump_height": (("kind",), heights),
        "primary_pole": (("kind",), poles.astype(np.int64)),
    }


def _faces(g: Callable[[Array], Array], dims: int, side: int, scale: float) -> tuple[Array, Array]:
    """Jumps (dims[, side]) between opposite faces, and which faces have a pole."""
    heights = np.zeros((dims, side ** (dims - 1)))
    poles = np.zeros(heights.shape, bool)
    for axis in range(dims):
        near, nearer = (_ends(g, dims, axis, side, gap) for gap in (_NEAR, _NEARER))
        before, after = (_length(ends[1] - ends[0]) for ends in (near, nearer))
        jump = (after > _STAYS * before) & (after > _NEGLIGIBLE * scale)
        sizes, growing = (_length(ends).max(axis=0) for ends in (near, nearer))
        poles[axis] = (growing > _GROWS * sizes) & (growing > _NEGLIGIBLE * scale)
        heights[axis] = np.where(poles[axis], np.inf, np.where(jump, after, 0.0))
    shape = (dims, side)[:dims]
    return heights.reshape(shape), poles.reshape(shape)


def _ends(g: Callable[[Array], Array], dims: int, axis: int, side: int, gap: float) -> Array:
    """Values (2, k, channels) next to both faces of an axis."""
    along = grid_centers(side, dims - 1) if dims > 1 else np.empty((1, 0))
    return np.stack([g(np.insert(along, axis, end, axis=1)) for end in (gap, 1.0 - gap)])


def _length(values: Array) -> Array:
    return np.asarray(np.sqrt((values**2).sum(axis=-1)))


def _mean_of_jumps(faces: Array) -> float:
    jumps = faces[(faces > 0) & np.isfinite(faces)]
    return float(jumps.mean()) if jumps.size else 0.0


def _reaches_zero(estimator: AbstractEstimator, technique: int) -> bool:
    """Whether the technique's density is 0 somewhere, by probing a grid that holds the sides."""
    density: Density | None = getattr(estimator.primary_integrand(technique), "density", None)
    if density is None:
        return False
    line = np.linspace(0.0, 1.0, _PROBES)
    grid = np.stack(np.meshgrid(*[line] * density.dims), axis=-1).reshape(-1, density.dims)
    p = density.pdf(np.concatenate([grid, density.zero_points()]))
    return bool(p.min() <= _ZERO * p.max())
