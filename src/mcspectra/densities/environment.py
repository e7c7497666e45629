"""Densities of pictures and of environment maps, and compensation of tables for MIS.

Maps use latitude and longitude, with the conventions of `mcspectra.core.environments`.
There x_0 is φ/2π, x_1 is θ/π, and the first row of pixels is at θ = 0.
The density of *directions*, per steradian, is p(x)/(2π² sin(π x_1)).

Compensation reduces a density where other techniques already sample enough [Karlik2019]_.
Let f be proportional to a table p, and let the balance heuristic combine the techniques.
Then the points of all techniques together should have the density p.
Technique τ has a share β_τ = n_τ/Σ n of the points.
The density p'_τ of technique τ should be the part of p that the other techniques do not sample.
Therefore, β_τ p'_τ = max(0, λ p − Σ_{s≠τ} β_s p_s), with λ such that ∫ p'_τ = 1.
The density p'_τ minimizes ∫ f²/(β_τ p'_τ + Σ β_s p_s), hence the second moment.
If λ p − Σ_{s≠τ} β_s p_s is nowhere negative, λ = 1, and the estimate of f has no variance.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real
from mcspectra.core.environments import environment_pixels, row_solid_angles
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.core.fields import checked, choice, flag, settle
from mcspectra.core.images import luminance, read_image
from mcspectra.densities.base import Density, Wrapper
from mcspectra.densities.bilinear import Bilinear
from mcspectra.densities.registry import as_density
from mcspectra.densities.tabulated import WARPS, PiecewiseConstant, shown

__all__ = ["EnvironmentDensity", "ImageDensity", "compensated"]

_NODES = 4  # number of Gauss nodes along each axis of a cell
_BLOCK = 2**16  # number of cells processed at a time


def _select_channel(image: Array, channel: object) -> Array:
    """Return one channel (h, w) by number, or the luminance, of pixels (h, w, channels)."""
    if channel == "luminance":
        return luminance(image)
    if isinstance(channel, str):
        raise ParameterError(f'channel is {channel!r:.80}; give "luminance" or a number.')
    return np.asarray(image[..., as_integer("channel", channel, least=0, most=image.shape[2] - 1)])


def _as_floor(name: str, value: Any) -> Any:
    as_real(name, value, least=0.0)
    return value


@final
@dataclass(frozen=True, kw_only=True)
class ImageDensity(Wrapper):
    """Density proportional to the pixels of a picture. x_0 points right, and x_1 points down.

    Attributes
    ----------
    path
        A file in a format that `mcspectra.core.images.read_image` supports.
    channel
        ``"luminance"`` (Rec. 709), or the number of a channel. One channel is its own luminance.
    floor
        Smallest pixel value, as a multiple of the mean. Lower pixels are raised to this value.
        If the floor is above 0, the density is positive everywhere.
    linear
        Whether values of PNG and JPEG files are linear instead of sRGB.
    warp
        The warp of the table, as in `PiecewiseConstant`.
    """

    name: ClassVar[str] = "image"
    warps: ClassVar[tuple[str, ...]] = WARPS
    dims: int = field(default=2, init=False)
    path: str | os.PathLike[str]
    channel: str | int = "luminance"
    floor: float = checked(_as_floor, 0.0)
    linear: bool = flag(default=False)
    warp: str = "marginal"

    def _check(self) -> None:
        self._inside  # noqa: B018 - checks that the file is a picture
        settle(self, path=os.fspath(self.path))

    @cached_property
    def _inside(self) -> PiecewiseConstant:
        pixels = _select_channel(read_image(self.path, linear=self.linear), self.channel)
        low = int(np.count_nonzero(pixels < 0))
        if low:
            raise DensityError(
                f"{self.path} has {low} negative pixels; a density needs values of 0 or more."
            )
        if not pixels.any():
            raise DensityError(f"{self.path} is black; a density needs pixels above 0.")
        raised = np.maximum(pixels, self.floor * pixels.mean()) if self.floor else pixels
        return PiecewiseConstant(values=raised, warp=self.warp)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class EnvironmentDensity(Wrapper):
    """Density of directions, proportional to the radiance of a lat-long environment map.

    Attributes
    ----------
    path, values
        A file that `mcspectra.core.images.read_image` can read, or linear pixels of at least 0.
        Pixels have shape (h, w) or (h, w, channels). The default is `synthetic_sky`.
    channel
        ``"luminance"`` (Rec. 709), or the number of a channel. One channel is its own luminance.
    interpolation
        ``"constant"``: constant in each pixel. Its mass is exactly radiance times solid angle.
        ``"bilinear"``: interpolates L sin θ between the pixel centers, where L is the radiance.
    sin_theta
        Whether to weight rows by their solid angle.
        False makes the density proportional to L on the square, as for a flat picture.
    compensation
        The multiple of the mean radiance to subtract: p ∝ max(0, L − multiple · mean L).
        Subtracting the mean is the compensation of [Karlik2019]_ that ignores surface normals.
        False means no subtraction.
        True means the multiple 1, so that the mean radiance itself is subtracted.
        The multiple 1 suits equal numbers of light samples and BSDF samples.
        The density is then 0 at places where f is not 0, so combine it with another technique.
    warp
        The warp of the table, as in `PiecewiseConstant`, for ``interpolation="constant"``.

    Raises
    ------
    ParameterError
        If a parameter or the pixels do not have the form described above.
    FileFormatError
        If the file is missing or cannot be read.
    DensityError
        If the map is black, or if compensation leaves no pixel above 0.
    """

    name: ClassVar[str] = "environment"
    warps: ClassVar[tuple[str, ...]] = WARPS
    dims: int = field(default=2, init=False)
    path: str | os.PathLike[str] | None = None
    values: Any = None
    channel: str | int = "luminance"
    interpolation: str = choice("constant", "bilinear")
    sin_theta: bool = flag(default=True)
    compensation: bool | float = False
    warp: str = choice(*WARPS)

    def _check(self) -> None:
        if not isinstance(self.compensation, bool):
            as_real("compensation", self.compensation, least=0.0)
        if self.interpolation == "bilinear" and self.warp != "marginal":
            raise ParameterError(
                f"warp is {self.warp!r:.80}; bilinear interpolation has the marginal warp only."
            )
        self._inside  # noqa: B018 - checks that the pixels are a map
        if self.path is not None:
            settle(self, path=os.fspath(self.path))
        if self.values is not None:
            settle(self, values=shown(np.array(self.values, np.float64)))

    @cached_property
    def _inside(self) -> Density:
        source = "The environment map" if self.path is None else str(self.path)
        radiance = _select_channel(environment_pixels(self.path, self.values), self.channel)
        if not radiance.any():
            raise DensityError(f"{source} is black; a density needs pixels above 0.")
        height = len(radiance)
        angles = row_solid_angles(height) if self.sin_theta else np.full(height, 1.0 / height)
        scaled = radiance / radiance.max()
        mean = float(angles @ scaled.mean(axis=1))
        left = np.maximum(scaled - float(self.compensation) * mean, 0.0)
        # The mean of a constant map may be rounded to just below the pixel values
        if self.compensation and left.max() <= 1e-12:
            raise DensityError(
                f"Compensation leaves nothing of {source}: no pixel is above "
                f"{float(self.compensation):g} times the mean; give a smaller multiple or False."
            )
        # The solid angle of a row is proportional to sin θ at its center (see `row_solid_angles`)
        weighted = left * angles[:, None]
        if self.interpolation == "bilinear":
            return Bilinear(values=weighted, periodic=True)
        return PiecewiseConstant(values=weighted, warp=self.warp)


def compensated(
    density: Density | str,
    others: Sequence[Density | str],
    counts: Sequence[int] | None = None,
) -> PiecewiseConstant:
    """Compensate a table for multiple importance sampling with other techniques.

    Parameters
    ----------
    density
        The table p, which approximates f: `PiecewiseConstant`, `ImageDensity`, or a spec string.
    others
        Densities of the other techniques, or spec strings.
    counts
        Numbers of points from `density` and from each other density, as in `MultipleImportance`.
        By default, all techniques have the same number of points.

    Returns
    -------
    PiecewiseConstant
        p'_τ with the warp of `density`. It is 0 in cells where the other techniques sample enough.

    Raises
    ------
    ParameterError
        If `density` is not a table, dims disagree, or `counts` has another length.

    Notes
    -----
    Gauss rules of 4 nodes per axis compute the means of the other densities over the cells.
    If all other densities are 0 at a Gauss node, nothing is subtracted in the cell of the node.
    Therefore some technique samples f everywhere; `MultipleImportance` checks it again.
    Compensation is optimal only if f is proportional to p.
    If f also contains other factors, such as a BSDF, the estimate is still unbiased.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> table = mcs.density("piecewise-constant(values=[1, 1, 4, 2])")
    >>> compensated(table, ["uniform"]).values
    [0.0, 0.0, 3.0, 1.0]
    """
    table = as_density(density)
    if isinstance(table, ImageDensity):
        table = table._inside
    if not isinstance(table, PiecewiseConstant):
        raise ParameterError(
            f"{density!r:.80} is not a table; compensation takes piecewise-constant(values=…) or "
            "image(path=…)."
        )
    if not isinstance(others, list | tuple):
        raise ParameterError(f"others is {others!r:.80}; give a list of densities.")
    found = []
    for given in others:
        other = as_density(given, table.dims)
        if other is None:
            raise ParameterError("others holds None; write 'uniform' for a uniform density.")
        found.append(other)
    # Compute the share β of the points of each technique. The first technique samples the table
    techniques = 1 + len(found)
    points: Any = (1,) * techniques if counts is None else counts
    if not isinstance(points, list | tuple | np.ndarray) or len(points) != techniques:
        raise ParameterError(
            f"counts is {counts!r:.80}; give {techniques} numbers, that of the table first."
        )
    values = [as_integer(f"counts[{i}]", count, least=1) for i, count in enumerate(points)]
    shares = np.array(values) / sum(values)
    p = table._pdf_table.reshape(table._table.shape)
    taken = _taken(found, shares[1:], p.shape)
    left = np.maximum(_level(p, taken, shares[0]) * p - taken, 0.0) / shares[0]
    return PiecewiseConstant(values=left, warp=table.warp)


def _taken(others: list[Density], shares: Array, shape: tuple[int, ...]) -> Array:
    """Return means of the sum Σ β_s p_s over the cells of a table, as an array of shape `shape`.

    If the sum is 0 at a Gauss node of a cell, the mean of this cell is set to 0.
    """
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    grid = np.stack(np.meshgrid(*([0.5 * (node + 1)] * len(shape)), indexing="ij"), axis=-1)
    inside = grid.reshape(-1, len(shape))
    rule = weight / 2 if len(shape) == 1 else np.outer(weight / 2, weight / 2).ravel()
    sides = np.array(shape[::-1])
    out = np.zeros(int(np.prod(shape)))
    for start in range(0, out.size, _BLOCK):
        cells = np.arange(start, min(start + _BLOCK, out.size))
        # Rows of the table run along axis 1
        corner = np.stack(np.unravel_index(cells, shape)[::-1], axis=-1)
        x = (corner[:, None, :] + inside) / sides
        total = np.zeros(x.shape[:-1])
        for share, other in zip(shares, others, strict=True):
            total += share * other.pdf(x)
        out[cells] = np.where((total > 0).all(axis=1), total @ rule, 0.0)
    return out.reshape(shape)


def _level(p: Array, taken: Array, share: float) -> float:
    """Return the factor λ that gives the compensated density the mean `share`.

    The compensated density is max(0, λ p − taken).
    The array `taken` has the densities of the other techniques, weighted by their shares.
    """
    inside = p.ravel() > 0
    own, other = p.ravel()[inside], taken.ravel()[inside]
    ratio = other / own
    order = np.argsort(ratio)
    # Sort the cells by the other techniques' densities `taken`, divided by p.
    # For each k, compute λ as if only the first k cells had a compensated density above 0.
    # Choose the first k for which the compensated density of cell k + 1 is 0
    levels = (share * p.size + np.cumsum(other[order])) / np.cumsum(own[order])
    ends = np.append(ratio[order][1:], np.inf)
    return float(levels[np.flatnonzero(levels <= ends)[0]])
