"""Deterministic test that pdf, sample and invert of a density are consistent."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.errors import DensityError, point_in_words
from mcspectra.densities.adaptive import CELLS, SET_SIZE, SETS, integrate, recurrences

__all__ = ["check_density"]

_SPREADS = 7.0  # limit in standard errors; a false alarm has probability 7e-8 per cell
# Let the mean count of points in a cell be k + q, with an integer k and 0 ≤ q < 1.
# All 32 point sets have k points in the cell with probability (1 − q)^32: 7e-8 for q = 0.4.
# If all 32 counts are equal, the mean count may therefore be wrong by 0.4 points.
# If the 32 counts differ, their spread shows the likely error of the mean count.
_ALIKE = 0.4
_ROUND_TRIP = 1e-6
_INTEGRAL = 1e-4
_LARGEST_BOUND = 0.01
_SLABS = 8
_STEP = 1e-6
_JACOBIAN = 1e-3
_OUTLIERS = 0.02  # largest fraction of points that may lie next to a jump of the warp


class Checkable(Protocol):
    """The methods of `mcspectra.densities.Density` that are compared with each other."""

    @property
    def dims(self) -> int: ...
    @property
    def primary_dims(self) -> int: ...
    @property
    def spec(self) -> str: ...
    @property
    def has_inverse(self) -> bool: ...
    @property
    def one_to_one(self) -> bool: ...
    def _pdf(self, x: Array, /) -> Array: ...
    def _sample(self, u: Array, /) -> Array: ...
    def _invert(self, x: Array, /) -> Array: ...


def check_density(density: Checkable) -> None:
    """Test that pdf, sample and invert are consistent.

    Parameters
    ----------
    density
        Any density.

    Raises
    ------
    DensityError
        If the functions are inconsistent. The message names the error and, if possible, the cause.

    Notes
    -----
    * pdf is finite and not negative at 4096 points, and its integral is 1 to 1e-4.
    * sample stays in [0,1]. invert(sample(u)) equals u to 1e-6 + 1e-15 p(x).
      The term 1e-15 p(x) allows for the change of u that the rounding of x causes.
    * Samples follow the pdf, which is tested in one of three ways.

    In 1-D and 2-D, points of 32 shifted sets of 4096 points are counted in cells.
    There are 64 cells (16 × 16 in 2-D), and larger cells that join 2, 4, … cells along each axis.
    The share of points in each cell is compared with the integral of the pdf over it.
    Share and integral may differ by 7 standard errors, plus the error of the quadrature.
    If all sets have the same number of points in a cell, 0.4/4096 is added to the tolerance.
    In 1-D the test detects an error of 0.1 % in a mass of 1/2, or of 2 % in a mass of 1/64.
    Errors within a cell are not detected.

    In three or more dims, cells are too coarse. There the test is that |det ∂T/∂u| · p(T(u)) = 1.
    The determinant is found by central differences at 512 points.
    The product may differ from 1 at 2 % of the 512 points, because warps may jump there.

    If the warp is not one-to-one (`Density.one_to_one`), each axis is divided into 8 slabs.
    The share of the points in a slab is compared with the mean of the pdf over the slab.
    The share and the mean pdf come from the same points. This test detects only wrong marginals.

    A density passes if its errors are smaller than the tolerances above.
    Peaks narrower than 2^-20 of the domain (2^-12 in 2-D) are not resolved.
    """
    if not hasattr(density, "_pdf"):
        raise DensityError(f"{density!r:.80} is not a density; give what mcs.density makes.")
    with np.errstate(all="ignore"):  # values that are not finite are reported later
        x = recurrences(density.dims)[0]
        p = density._pdf(x)
        for bad, what in ((~np.isfinite(p), "not finite"), (p < 0, "negative")):
            if bad.any():
                raise DensityError(
                    f"The pdf of {density.spec} is {what} ({p[bad][0]:.6g}) at "
                    f"{point_in_words(x[bad][0])}; a density is finite and at least 0 almost "
                    "everywhere."
                )
        # Sample at 32 shifted point sets. The first set also includes both ends of [0,1)
        u = recurrences(density.primary_dims)
        u[0, 0], u[0, 1] = 0.0, BELOW_ONE
        x = density._sample(u)
        outside = ~((x >= 0.0) & (x <= 1.0)).all(axis=-1)
        if outside.any():
            raise DensityError(
                f"The samples of {density.spec} leave [0,1): {point_in_words(x[outside][0])} from "
                f"u = {point_in_words(u[outside][0])}."
            )
        x = np.minimum(x, BELOW_ONE)
        # Compare sample with invert and with the pdf. If two of the three agree, blame the third
        loop = _round_trip(density, u[0], x[0])
        if density.dims <= 2:
            problem = _mass_problem(density, x)
        elif density.one_to_one:
            problem = _jacobian_problem(density, u[0])
        else:
            problem = _slab_problem(density, x)
        if problem:
            blame = " (invert does not undo sample either)" if loop else ""
            if loop is None and density.has_inverse:
                blame = "; sample and invert agree, so the pdf is wrong"
            raise DensityError(f"{problem}{blame}.")
        if loop:
            raise DensityError(f"{loop}; sample and pdf agree, so invert is wrong.")


def _round_trip(density: Checkable, u: Array, x: Array) -> str | None:
    """Return an error message if invert(sample(u)) is not u, else None."""
    if not density.has_inverse:
        return None
    back = density._invert(x)
    # In 1-D du = p dx: x is accurate to 1e-16, but u is less accurate near a peak
    allowed = _ROUND_TRIP + 1e-15 * density._pdf(x)
    off = ~(np.abs(back - u).max(axis=-1) <= allowed)
    if np.count_nonzero(off) <= _OUTLIERS * len(u):
        return None
    k = int(np.flatnonzero(off)[0])
    return (
        f"invert does not undo sample in {density.spec}: invert(sample(u)) is "
        f"{point_in_words(back[k])} at u = {point_in_words(u[k])}"
    )


def _mass_problem(density: Checkable, x: Array) -> str | None:
    """Return an error message if pdf and samples differ in the mass of a cell, else None."""
    dims = density.dims
    side = CELLS[dims]
    pdf = integrate(density._pdf, dims, cells=side, points=x[0, :: 4 ** (dims - 1)])
    total = pdf.limit if pdf.isolated else pdf.totals[-1]
    if not abs(total - 1.0) <= _INTEGRAL + float(pdf.bounds.sum()):
        mean, error = _mean(density)  # quadrature may fail if p jumps at many places
        if not abs(mean - 1.0) <= min(error, _LARGEST_BOUND):
            return (
                f"The pdf of {density.spec} integrates to {total:.6g} over the unit domain, "
                "not to 1"
            )
    # Compute the share of the points of each set in each of side^d cells, row-major
    index = np.minimum((x * side).astype(np.int64), side - 1) @ side ** np.arange(dims)[::-1]
    counts = [np.bincount(cells, minlength=side**dims) for cells in index]
    shares = np.stack(counts) / x.shape[1]
    masses, errors = pdf.cells, pdf.bounds
    while side > 1:
        mean, spread = shares.mean(axis=0), shares.std(axis=0, ddof=1) / math.sqrt(SETS)
        allowed = _SPREADS * spread + _ALIKE / SET_SIZE + errors
        gap = np.abs(mean - masses)
        worst = int(np.argmax(gap / allowed))
        if gap[worst] > allowed[worst]:
            low = np.array(np.unravel_index(worst, (side,) * dims)) / side
            return (
                f"The samples of {density.spec} do not follow its pdf: {mean[worst]:.6g} of them "
                f"fall between {point_in_words(low)} and {point_in_words(low + 1 / side)}, where "
                f"the pdf has the mass {masses[worst]:.6g}"
            )
        shares, masses, errors = (_doubled(a, side, dims) for a in (shares, masses, errors))
        side //= 2
    return None


def _doubled(cells: Array, side: int, dims: int) -> Array:
    """Merge groups of 2^d cells by sums: (..., side^d) becomes (..., (side/2)^d)."""
    grid = cells.reshape(*cells.shape[:-1], *(side // 2, 2) * dims)
    sums = grid.sum(axis=tuple(range(-1, -2 * dims, -2)))
    return np.asarray(sums.reshape(*cells.shape[:-1], -1))


def _slab_problem(density: Checkable, x: Array) -> str | None:
    """Return an error message if pdf and samples differ in the share of a slab, else None."""
    y = recurrences(density.dims)
    p = density._pdf(y)
    for axis in range(density.dims):
        edge = np.arange(_SLABS)[:, None, None]
        by_samples = (np.floor(x[..., axis] * _SLABS) == edge).mean(axis=-1)
        by_pdf = (p * (np.floor(y[..., axis] * _SLABS) == edge)).mean(axis=-1)
        gap = by_samples - by_pdf
        spread = gap.std(axis=1, ddof=1) / math.sqrt(SETS)
        off = np.abs(gap.mean(axis=1)) > _SPREADS * spread + _ALIKE / SET_SIZE
        if off.any():
            k = int(np.flatnonzero(off)[0])
            return (
                f"The samples of {density.spec} do not follow its pdf: "
                f"{by_samples[k].mean():.6g} of them have x_{axis} from {k / _SLABS:g} to "
                f"{(k + 1) / _SLABS:g}, where the pdf has the mass {by_pdf[k].mean():.6g}"
            )
    return None


def _jacobian_problem(density: Checkable, u: Array) -> str | None:
    """Return an error message if |det ∂T/∂u| p(T(u)) is not 1 or mass is missed, else None."""
    u = np.clip(u[2:514], 2 * _STEP, 1.0 - 2 * _STEP)
    steps = _STEP * np.eye(density.dims)
    ahead, behind = (density._sample(u[:, None, :] + s * steps) for s in (1.0, -1.0))
    volume = np.abs(np.linalg.det((ahead - behind) / (2 * _STEP)))
    product = volume * density._pdf(density._sample(u))
    off = ~(np.abs(product - 1.0) <= _JACOBIAN)
    if np.count_nonzero(off) > _OUTLIERS * len(u):
        return (
            f"The samples of {density.spec} do not follow its pdf: pdf × |det ∂sample/∂u| is "
            f"{np.median(product[off]):.6g} at u = {point_in_words(u[off][0])}, not 1"
        )
    mean, error = _mean(density)
    if mean > 1.0 + _JACOBIAN + error:
        return f"The pdf of {density.spec} integrates to {mean:.6g}, where samples cover 1"
    return None


def _mean(density: Checkable) -> tuple[float, float]:
    """Return the mean of p over low-discrepancy points, and a bound of its error."""
    means = density._pdf(recurrences(density.dims)).mean(axis=1)
    return float(means.mean()), _SPREADS * float(means.std(ddof=1)) / math.sqrt(SETS)
