"""Numbers about a density that its implementation does not know: ∫1/p, and whether it is one.

Everything here is deterministic: fixed points, fixed offsets, no seed.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import DensityError
from mcspectra.core.errors import point_in_words as _at
from mcspectra.core.streams import Stream
from mcspectra.densities.adaptive import MOST_CELLS, Quadrature, integrate
from mcspectra.densities.base import LARGEST_BELOW_ONE, Density

__all__ = ["check_density", "mean_or_infinity", "positive_integral", "reciprocal_integral"]

_CELLS = {1: 64, 2: 16}  # a side, of the cells in which masses are compared
_SETS, _SET_SIZE = 32, 4096  # shifted low-discrepancy sets; their spread is the error bar
_SPREADS = 7.0  # Student's t with 31 degrees: 7e-8 a cell, 2e-5 for 256 cells
# Counts of a cell may be k in all sets where their mean is k + q, with the probability (1 − q)^32:
# less than 7e-8 for q > 0.4. Where they are not alike the spread covers the rest.
_ALIKE = 0.4
_SLOWEST = 0.98  # a ratio of levels: p ~ r^a with a above 0.97 counts as divergent
_NEGLIGIBLE = 1e-6
_SHRINKING = 0.8  # a level; next to a line or a point the unresolved volume shrinks by ½ or ¼
_FIRST_LEVELS = 4  # these also split cells that are merely near a zero
_WINDOW = 8
_TAIL = 256
_LARGEST_TAIL_INDEX = 1.0 - 3.0 / math.sqrt(_TAIL)
_ROUND_TRIP = 1e-6
_INTEGRAL = 1e-4
_LARGEST_BOUND = 0.01
_SLABS = 8
_STEP = 1e-6
_JACOBIAN = 1e-3
_OUTLIERS = 0.02  # of the points may lie next to a jump of the warp


def reciprocal_integral(density: Density) -> float:
    """Return ∫1/p over [0,1)^d, infinite where it diverges.

    Parameters
    ----------
    density
        Any density; only its pdf is used.

    Notes
    -----
    In 1-D and 2-D adaptive quadrature (`mcspectra.densities.adaptive`) splits the cells around zeros
    of p. Where p ~ r^a next to a zero at distance r, what is left unresolved shrinks by 2^{a−1}
    a level next to a point in 1-D or a line in 2-D, and 2^{a-2} next to a point in 2-D: the integral
    diverges where that ratio reaches 1. Ratios above 0.98 are counted as divergent, so a > 0.97 is
    not told from 1. The rest of the geometric series is added (Aitken). Cells where p = 0 make it
    infinite. Relative errors are about 1e-7 in 1-D; 1e-4 in 2-D where p jumps along curves.

    In 3-D and more, and in 2-D where p jumps all over the domain, this is a heuristic: the mean of
    1/p over 131 072 low-discrepancy points, and Hill's estimate of the tail index from the largest
    256 values of 1/p. The mean of a variable whose tail falls like v^(-1/a) is infinite for a ≥ 1;
    a > 0.81 (three standard errors below) is counted as that. A zero of p that occupies less than
    about 1e-5 of the domain is not seen.
    """

    def reciprocal(x: Array) -> Array:
        with np.errstate(divide="ignore", over="ignore"):
            return np.asarray(1.0 / density._pdf(x))

    return mean_or_infinity(reciprocal, density.dims)


def mean_or_infinity(
    function: Callable[[Array], Array], dims: int, *, most_cells: int = MOST_CELLS
) -> float:
    """Return ∫ of a function ≥ 0 of points (..., d), any d: infinite where it seems to diverge.

    By the means of `reciprocal_integral`, whose notes say what to expect of the value; `most_cells` is as
    for `positive_integral`.
    """
    if dims <= 2:
        with np.errstate(over="ignore", invalid="ignore"):
            found = integrate(function, dims, cells=_CELLS[dims], most_cells=most_cells)
        if _isolated(found):
            return _limit(found)
    return _mean_with_tail(function(_points(dims).reshape(-1, dims)))


def positive_integral(
    function: Callable[[Array], Array], dims: int, *, most_cells: int = MOST_CELLS
) -> tuple[float, float]:
    """Return the integral of a non-negative function over [0,1)^d, and an estimate of its error.

    Parameters
    ----------
    function
        Points (..., d) to (...).
    dims
        d, 1 or 2.
    most_cells
        Cells of a level, beyond which no more are split.

    Returns
    -------
    tuple of float
        Infinite, with error 0, where the unresolved part does not shrink: poles r^-a with a > 0.97
        count as that, see `reciprocal_integral`. Else the error is that of the cells, or, where
        the rest was added as a geometric series, what this changed from the last level to the one before.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        found = integrate(function, dims, cells=_CELLS[dims], most_cells=most_cells)
    if not _isolated(found):
        return found.totals[-1], found.unresolved[-1]
    value = _limit(found)
    if math.isinf(value):
        return value, 0.0
    if value == found.totals[-1]:
        return value, float(found.errors.sum())
    return value, abs(value - _aitken(*found.totals[-4:-1]))


def check_density(density: Density) -> None:
    """Test that pdf, sample and invert belong together.

    Parameters
    ----------
    density
        Any density.

    Raises
    ------
    DensityError
        The message says what is wrong and, where it can be told, which function is at fault.

    Notes
    -----
    * pdf is finite and not negative on 4096 points, and its integral is 1 to 1e-4.
    * sample stays in [0,1]; invert(sample(u)) = u to 1e-6, plus what rounding of x can do to u.
    * Samples follow the pdf. In 1-D and 2-D: the share of 32 shifted sets of 4096 points that fall
      into each of 64 (16 × 16) cells, and of the cells of 2, 4, … times the edge, is compared with
      the integral of the pdf over the cell; the bound is 7 standard errors, 0.4/4096 for counts
      that are alike in all sets, and the quadrature's error. So in 1-D a mass of 1/2 that is
      0.1 % wrong is found, one of 1/64 that is 2 % wrong; what is wrong within a cell is not.
      In 3-D and more, where cells say little: |det ∂T/∂u| · p(T(u)) = 1, by central differences,
      at 98 % of 512 points (the others may lie next to a jump). Where the warp is not one-to-one
      (`Density.one_to_one`): the share of the sets in each of 8 slabs of every axis against the
      mean of the pdf over that slab, from the same points; that sees marginals only.

    A density with errors smaller than those bounds passes. Peaks narrower than 2^-20 (2^-12 in 2-D)
    of the domain are not resolved.
    """
    with np.errstate(all="ignore"):  # what is not finite is reported below, or allowed at one point
        _check(density)


def _check(density: Density) -> None:
    _check_values(density)
    u = _points(density.primary_dims)
    u[0, 0] = 0.0
    u[0, 1] = LARGEST_BELOW_ONE
    x = _samples(density, u)
    loop = _round_trip(density, u[0], x[0])
    problem = _sampling_problem(density, u, x)
    if problem:
        blame = "" if loop is None or not density.has_inverse else " (invert does not fit either)"
        if loop is None and density.has_inverse:
            blame = "; sample and invert agree, so it is the pdf that does not fit them"
        raise DensityError(f"{problem}{blame}.")
    if loop:
        raise DensityError(f"{loop}; sample and pdf agree, so it is invert that does not fit them.")


def _sampling_problem(density: Density, u: Array, x: Array) -> str | None:
    """A sentence where samples x of u do not follow the pdf, by the check that fits, else None."""
    if density.dims <= 2:
        return _mass_problem(density, x)
    return _jacobian_problem(density, u[0]) if density.one_to_one else _slab_problem(density, x)


def _points(dims: int) -> Array:
    """Shifted additive recurrences (32, 4096, d): steps are powers of the root of g^(d+1) = g + 1.

    M. Roberts (2018), "The unreasonable effectiveness of quasirandom sequences".
    """
    g = 1.5
    for _ in range(64):
        g = (1.0 + g) ** (1.0 / (dims + 1))
    steps = g ** -np.arange(1.0, dims + 1)
    shifts = Stream(0).uniforms(0, _SETS, dims)[:, None, :]
    return np.asarray((shifts + np.arange(_SET_SIZE)[:, None] * steps) % 1.0)


def _isolated(found: Quadrature) -> bool:
    """Whether the record tells: infinite, resolved, or unresolved on a volume that shrinks."""
    if not math.isfinite(found.totals[-1]) or found.unresolved[-1] == 0:
        return True
    volumes = found.volumes
    return len(volumes) > _FIRST_LEVELS + 1 and volumes[-1] < _SHRINKING**3 * volumes[-4]


def _ratio(found: Quadrature) -> float:
    """By what the unresolved part shrinks a level; 0 where nothing is left.

    Sums over half of the last levels against the half before: where a zero lies within its cell
    changes from level to level, and single ratios with it.
    """
    parts = found.unresolved
    half = min(_WINDOW, (len(parts) - _FIRST_LEVELS) // 2)
    if half < 1 or parts[-1] == 0:
        return 0.0
    return float((sum(parts[-half:]) / sum(parts[-2 * half : -half])) ** (1 / half))


def _limit(found: Quadrature) -> float:
    """Infinite where the unresolved part does not shrink, else the limit of the totals."""
    last = found.totals[-1]
    if not math.isfinite(last):
        return math.inf
    if found.unresolved[-1] <= _NEGLIGIBLE * last:
        return last
    if _ratio(found) >= _SLOWEST:
        return math.inf
    return _aitken(*found.totals[-3:])


def _aitken(a: float, b: float, c: float) -> float:
    """Limit of a geometric series with these last sums; the last where it is none."""
    steady = 0 < abs(c - b) < abs(b - a)
    return c + (c - b) ** 2 / ((b - a) - (c - b)) if steady else c


def _mean_with_tail(values: Array) -> float:
    """Mean, infinite where Hill's estimate says that the tail is too heavy for one."""
    if not np.isfinite(values).all():
        return math.inf
    tail = np.sort(values)[-_TAIL - 1 :]
    index = float(np.log(tail[1:] / tail[0]).mean())
    return math.inf if index > _LARGEST_TAIL_INDEX else float(values.mean())


def _check_values(density: Density) -> None:
    x = _points(density.dims)[0]
    p = density._pdf(x)
    for bad, what in ((~np.isfinite(p), "not finite"), (p < 0, "negative")):
        if bad.any():
            raise DensityError(
                f"The pdf of {density.spec} is {what} ({p[bad][0]:.6g}) at {_at(x[bad][0])}; "
                "a density is finite and at least 0 almost everywhere."
            )


def _samples(density: Density, u: Array) -> Array:
    x = density._sample(u)
    outside = ~((x >= 0.0) & (x <= 1.0)).all(axis=-1)
    if outside.any():
        raise DensityError(
            f"The samples of {density.spec} leave [0,1): {_at(x[outside][0])} from u = "
            f"{_at(u[outside][0])}."
        )
    return np.minimum(x, LARGEST_BELOW_ONE)


def _round_trip(density: Density, u: Array, x: Array) -> str | None:
    """A sentence where invert(sample(u)) is not u, else None."""
    if not density.has_inverse:
        return None
    back = density._invert(x)
    # du = p dx in 1-D: x is known to 1e-16, near a peak u is not
    allowed = _ROUND_TRIP + 1e-15 * density._pdf(x)
    off = ~(np.abs(back - u).max(axis=-1) <= allowed)
    if np.count_nonzero(off) <= _OUTLIERS * len(u):
        return None
    k = int(np.flatnonzero(off)[0])
    return (
        f"invert does not undo sample in {density.spec}: invert(sample(u)) is {_at(back[k])} "
        f"at u = {_at(u[k])}"
    )


def _mass_problem(density: Density, x: Array) -> str | None:
    """A sentence where masses of cells by pdf and by samples differ, else None."""
    dims = density.dims
    side = _CELLS[dims]
    pdf = integrate(density._pdf, dims, cells=side, points=x[0, :: 4 ** (dims - 1)])
    # What the levels below the last would still add, as a geometric series
    errors = 2.0 * pdf.errors / (1.0 - min(_ratio(pdf), _SLOWEST))
    total = _limit(pdf) if _isolated(pdf) else pdf.totals[-1]
    if not abs(total - 1.0) <= _INTEGRAL + float(errors.sum()) and not _integrates(density):
        return f"The pdf of {density.spec} integrates to {total:.6g} over the unit domain, not to 1"
    shares = np.stack([_shares(points, side) for points in x])
    masses = pdf.cells
    while side > 1:
        mean, spread = shares.mean(axis=0), shares.std(axis=0, ddof=1) / math.sqrt(_SETS)
        allowed = _SPREADS * spread + _ALIKE / _SET_SIZE + errors
        gap = np.abs(mean - masses)
        worst = int(np.argmax(gap / allowed))
        if gap[worst] > allowed[worst]:
            low = np.array(np.unravel_index(worst, (side,) * dims)) / side
            return (
                f"The samples of {density.spec} do not follow its pdf: {mean[worst]:.6g} of them "
                f"fall between {_at(low)} and {_at(low + 1 / side)}, where the pdf has the mass "
                f"{masses[worst]:.6g}"
            )
        shares, masses, errors = (_doubled(a, side, dims) for a in (shares, masses, errors))
        side //= 2
    return None


def _doubled(cells: Array, side: int, dims: int) -> Array:
    """Sums over cells of twice the edge: (..., side^d) to (..., (side/2)^d)."""
    grid = cells.reshape(*cells.shape[:-1], *(side // 2, 2) * dims)
    sums = grid.sum(axis=tuple(range(-1, -2 * dims, -2)))
    return np.asarray(sums.reshape(*cells.shape[:-1], -1))


def _slab_problem(density: Density, x: Array) -> str | None:
    """A sentence where shares of samples and of the pdf in slabs of an axis differ, else None."""
    y = _points(density.dims)
    p = density._pdf(y)
    for axis in range(density.dims):
        edge = np.arange(_SLABS)[:, None, None]
        by_samples = (np.floor(x[..., axis] * _SLABS) == edge).mean(axis=-1)
        by_pdf = (p * (np.floor(y[..., axis] * _SLABS) == edge)).mean(axis=-1)
        gap = by_samples - by_pdf
        spread = gap.std(axis=1, ddof=1) / math.sqrt(_SETS)
        off = np.abs(gap.mean(axis=1)) > _SPREADS * spread + _ALIKE / _SET_SIZE
        if off.any():
            k = int(np.flatnonzero(off)[0])
            return (
                f"The samples of {density.spec} do not follow its pdf: "
                f"{by_samples[k].mean():.6g} of them have x_{axis} from {k / _SLABS:g} to "
                f"{(k + 1) / _SLABS:g}, where the pdf has the mass {by_pdf[k].mean():.6g}"
            )
    return None


def _integrates(density: Density) -> bool:
    """Whether the mean of p over low-discrepancy points is 1: for p with jumps at a thousand places."""
    means = density._pdf(_points(density.dims)).mean(axis=1)
    bound = _SPREADS * float(means.std(ddof=1)) / math.sqrt(_SETS)
    return abs(float(means.mean()) - 1.0) <= min(bound, _LARGEST_BOUND)


def _shares(points: Array, side: int) -> Array:
    """Share of points (n, d) in each of side^d cells, row-major."""
    cell = np.minimum((points * side).astype(np.int64), side - 1)
    index = cell @ side ** np.arange(points.shape[-1])[::-1]
    return np.bincount(index, minlength=side ** points.shape[-1]) / len(points)


def _jacobian_problem(density: Density, u: Array) -> str | None:
    """A sentence where |det ∂T/∂u| p(T(u)) is not 1, or the pdf holds more than 1, else None."""
    u = np.clip(u[2:514], 2 * _STEP, 1.0 - 2 * _STEP)
    steps = _STEP * np.eye(density.dims)
    ahead, behind = (density._sample(u[:, None, :] + s * steps) for s in (1.0, -1.0))
    volume = np.abs(np.linalg.det((ahead - behind) / (2 * _STEP)))
    product = volume * density._pdf(density._sample(u))
    off = ~(np.abs(product - 1.0) <= _JACOBIAN)
    if np.count_nonzero(off) > _OUTLIERS * len(u):
        return (
            f"The samples of {density.spec} do not follow its pdf: pdf × |det ∂sample/∂u| is "
            f"{np.median(product[off]):.6g} at u = {_at(u[off][0])}, not 1"
        )
    means = density._pdf(_points(density.dims)).mean(axis=1)
    bound = 1.0 + _JACOBIAN + _SPREADS * float(means.std(ddof=1)) / math.sqrt(_SETS)
    if means.mean() > bound:
        return f"The pdf of {density.spec} integrates to {means.mean():.6g}, where samples cover 1"
    return None
