"""Distortion and jumps of a warp of the unit square: they limit the benefit of stratification."""

from __future__ import annotations

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.results import dataset
from mcspectra.densities import Density
from mcspectra.densities import density as make_density
from mcspectra.quality.jumps import find_jumps, grid_centers

__all__ = ["warp_quality"]

_STEP = 1e-3  # Step of the finite differences, as a fraction of a cell
# Offset of the probes from the cell centers, in cells. A kink of a warp may lie at the centers
_ASIDE = (0.31, 0.17)


def warp_quality(density: Density | str, *, resolution: int = 256) -> xr.Dataset:
    """Measure stretch, jumps and distortion of the warp T of a density in one or two dims.

    Parameters
    ----------
    density
        A density, or its spec string.
    resolution
        Number of cells along each axis of primary space, 4 to 1024.

    Returns
    -------
    xarray.Dataset
        Some variables are maps over the cells of primary space:
        ``stretch`` (u0, u1) is the largest singular value of ∂T/∂u, divided by the smallest.
        The stretch is 1 in 1-D, and infinite where T is flat.
        ``jump`` (axis, u0, u1) is the jump of T between a cell and its next neighbor on each axis.
        The jump is 0 where the warp T is continuous.
        ``warped`` (u0, u1, coordinate) is T at the cell centers.

        The following variables are single numbers for the whole warp.
        ``mean_stretch`` is the geometric mean over cells where T is not flat.
        ``max_stretch`` is the largest stretch of any cell.
        ``jump_length`` is the length of the jump curves, or the number of jumps in 1-D.
        ``mean_jump`` is the mean size of a jump.
        ``distortion`` compares the image of a small square with a square of the image's area.
        The diameter of the image is divided by the diameter of the square of equal area.
        The distortion is the geometric mean of this ratio of diameters.
        The distortion is 1 if squares stay squares.
        ``neighbor_expansion`` is the distance between the images of neighboring cells, in cells.
        The root mean square of the distance is taken over all neighbors, including those at jumps.

    Raises
    ------
    ParameterError
        If there are more than two primary dims, or the resolution is out of range.

    Notes
    -----
    Slopes are one-sided differences over a thousandth of a grid cell.
    The smaller one of the left and the right difference is used: it does not cross a jump.
    Jumps are found by refinement (`mcspectra.quality.jumps`).
    Opposite sides of the square are not compared.
    All figures refer to the unit square. For directions, it is the lat-long square, not the sphere.
    """
    p = make_density(density) if isinstance(density, str) else density
    if not isinstance(p, Density):
        raise ParameterError(f"{density!r:.80} is not a density; give one, or a spec string.")
    dims = p.primary_dims
    if dims > 2:
        raise ParameterError(
            f"The warp of {p.spec} has {dims} primary dims; give a density with 1 or 2 primary "
            "dims."
        )
    side = as_integer("resolution", resolution, least=4, most=1024)
    centers = grid_centers(side, dims)
    image = p.sample(centers)
    jumps = find_jumps(p.sample, dims, side, scale=1.0)
    # ∂T_i/∂u_j at points (..., d), (..., i, j)
    points, step = centers + np.array(_ASIDE[:dims]) / side, _STEP / side
    here, columns = p.sample(points), []
    for shift in step * np.eye(dims):
        sides = np.stack([p.sample(points + shift) - here, here - p.sample(points - shift)])
        ahead_less = (sides[0] ** 2).sum(axis=-1) <= (sides[1] ** 2).sum(axis=-1)
        columns.append(np.where(ahead_less[..., None], sides[0], sides[1]) / step)
    slopes = np.stack(columns, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        # The stretch is the ratio of the largest to the smallest singular value
        values = np.linalg.svd(slopes, compute_uv=False)
        ratio = values[..., 0] / values[..., -1]
        stretch = np.where(values[..., -1] > 0, ratio, np.inf)
        # Diameter of the image of a small square, divided by that of a square of the same area
        diameters = np.ones(slopes.shape[:-2])
        if slopes.shape[-2:] == (2, 2):
            diagonals = slopes @ np.array([[1.0, 1.0], [1.0, -1.0]])
            diameter = np.sqrt((diagonals**2).sum(axis=-2)).max(axis=-1)
            area = np.abs(np.linalg.det(slopes))
            diameters = np.where(area > 0, diameter / np.sqrt(2.0 * area), np.inf)
    # Root mean square distance between the images of neighboring cells, in units of a cell
    squares = [(np.diff(image, axis=axis) ** 2).sum(axis=-1).ravel() for axis in range(dims)]
    expansion = float(side * np.sqrt(np.concatenate(squares).mean()))
    cells = tuple(f"u{axis}" for axis in range(dims))
    line = (np.arange(side) + 0.5) / side
    return dataset(
        {
            "stretch": (cells, stretch),
            "jump": (("axis", *cells), jumps.heights),
            "warped": ((*cells, "coordinate"), image),
            "mean_stretch": ((), _geometric_mean(stretch)),
            "max_stretch": ((), float(stretch.max())),
            "jump_length": ((), jumps.length),
            "mean_jump": ((), jumps.mean_height),
            "distortion": ((), _geometric_mean(diameters)),
            "neighbor_expansion": ((), expansion),
        },
        {**dict.fromkeys(cells, line), "axis": np.arange(dims)},
        density=p.spec,
        dims=p.dims,
        resolution=side,
    )


def _geometric_mean(values: Array) -> float:
    """Return the geometric mean of the finite values, or NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(np.exp(np.log(finite).mean())) if finite.size else float("nan")
