"""The variance of an estimate from the pair correlation of the points: a route without spectra.

With g the primary-space integrand, I its integral and G the density of pairs of different points,

    Var = (1/n) ∫g² + (1 − 1/n) ∬ g(u) g(v) G(u, v) du dv − I².

* Random points have G = 1: Var = (∫g² − I²)/n.
* Jittered points have G = n/(n−1) in different cells and 0 within one, so that
  Var = (1/n) ∫g² − Σ_j (∫_cell j g)².
* A stationary set has G(v − u), and ∬ g g G = ∫ A(h) G(h) dh with A(h) = ∫ g(u) g(u + h) du on the torus.
  Its pairs are counted in full, not by distance only: Var is the mean over realisations of
  (1/n) ∫g² + (1/n²) Σ_{i≠k} A(x_i − x_k) − I². A is tabulated, and linear between the entries.

Averaging A over directions, so that g(|h|) would do, is exact for isotropic sets only: measured at n = 16,
it gives 1.7 to 3.7 times the variance of smooth integrands for latin-hypercube with shift.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.analysis import MergeTree
from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import NoClosedForm, ParameterError
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers, map_in_order
from mcspectra.core.records import MeanSums
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, as_estimator
from mcspectra.integrands import Integrand
from mcspectra.samplers import Randomized, Sampler, as_sampler
from mcspectra.samplers.base import Structure
from mcspectra.variance._pair_kernels import pair_sum_1d, pair_sum_2d
from mcspectra.variance._squares import mean_square, square_integral
from mcspectra.variance._strata import stratum_moments

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["variance_from_pair_correlation"]

_GRID = {1: 2**15, 2: 2**10}  # points of an axis where the autocorrelation is sampled
_MOST_POINTS = 2**17
_MANY = 400  # cells in 2-D and up, of which rules of lower order are enough
_TOLERANCE = 1e-6
_ROUNDING = 4e-15
_MOVES = frozenset({"shift", "strata-shift", "shuffle"})  # keep the differences of points


def variance_from_pair_correlation(
    estimator: AbstractEstimator | Integrand | str,
    sampler: Sampler | str,
    n: int,
    *,
    realizations: int = 1000,
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Return the variance of an estimate, from the pairs of points only.

    Parameters
    ----------
    estimator, n
        Any estimator, and the number of points.
    sampler
        ``random`` and ``jittered``, whose pairs are known exactly; else a stationary set in 1-D or
        2-D, by shift or by itself, whose pairs are counted.
    realizations
        Number of sets of which the pairs are counted; 2 or more for a standard error.
    rng
        Seed (SPEC 7).
    workers
        Threads; all processors by default.

    Returns
    -------
    xarray.Dataset
        ``variance``, infinite where ∫g² diverges, and ``variance_se``, 0 where nothing was counted and
        the relative error is about 1e-6 or less; with a dim ``channel`` where f has several. The
        attribute ``method`` says which it was.

    Raises
    ------
    NoClosedForm
        The set is not stationary, has fixed differences (shifted grids and lattices), or has more
        dims; or a quadrature does not converge to 1e-6.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> d = variance_from_pair_correlation(mcs.Estimator("linear", dims=1), "jittered", 4)
    >>> round(float(d["variance"]) * 12 * 4**3, 6)
    1.0
    """
    estimator = as_estimator(estimator, getattr(sampler, "dims", None))
    source = as_sampler(sampler, estimator.dims)
    n = source.check_count(n)
    estimator.check_sampler(source, n)
    estimator.check_independent()
    source = estimator.randomized(source)
    realizations = as_integer("realizations", realizations, least=1, most=MAX_REALIZATIONS)
    stream, threads = Stream.from_rng(rng), available_workers(workers)
    exact = source.name in ("random", "jittered")
    if not exact:
        _check_stationary(source)
    variance: Any = 0.0
    square_se: Any = 0.0
    for technique, count in enumerate(estimator.counts):
        g = estimator.primary_integrand(technique)
        if exact:
            variance = variance + _of_known_pairs(source, n * count, g)
            continue
        first = technique * realizations
        value, se = _of_counted_pairs(source, n * count, g, stream, (first, realizations), threads)
        variance, square_se = variance + value, square_se + se**2
    dims = ("channel",) if estimator.channels else ()
    shape = (estimator.channels,) if estimator.channels else ()
    return dataset(
        {
            "variance": (dims, np.reshape(variance, shape)),
            "variance_se": (dims, np.resize(np.sqrt(square_se), shape)),
        },
        estimator=estimator.spec,
        sampler=source.spec,
        n=n,
        method="known pairs" if exact else "counted pairs",
        realizations=0 if exact else realizations,
        seed=rng if isinstance(rng, int) else None,
    )


def _check_stationary(sampler: Sampler) -> None:
    steps = sampler.steps if isinstance(sampler, Randomized) else ()
    base = sampler.base if isinstance(sampler, Randomized) else sampler
    alone = sampler.structure is Structure.TORUS and sampler.unbiased and not steps
    stationary = alone or (bool(steps) and steps[-1].stationary)
    moved_only = all(step.name in _MOVES for step in steps)
    lattice = moved_only and (base.fixed or base.name == "uniform-jitter")
    if sampler.dims > 2 or not stationary or lattice:
        raise NoClosedForm(
            f"The variance of {sampler.spec} in {sampler.dims} dims is not found from pairs "
            "of points: give random or jittered, or in 1-D and 2-D a stationary set other than "
            "a lattice, such as one with shift; else use exact_variance or variance_terms."
        )


def _of_known_pairs(sampler: Any, n: int, g: Integrand) -> Array:
    """Random: all pairs; jittered: those in different cells; (channels or 1,).

    Raises
    ------
    NoClosedForm
        The quadratures of two orders differ by more than 1e-6 of the variance.
    """
    square, square_error = square_integral(g)
    jittered = sampler.name == "jittered"
    sides = sampler.sides(n) if jittered else (1,) * g.dims
    coarse, fine = (_cell_squares(g, sides, order) for order in _orders(sides))
    if not jittered:
        coarse, fine = coarse / n, fine / n
    diverges = np.isinf(square)
    square = np.where(diverges, 0.0, square)
    variance = np.where(diverges, np.inf, square / n - fine)
    error = np.where(diverges, 0.0, square_error / n + np.abs(fine - coarse))
    floor = _ROUNDING * square / n  # where the variance vanishes, rounding is all there is
    if not np.all(error <= np.maximum(_TOLERANCE * np.abs(variance), floor)):
        raise NoClosedForm(
            f"The quadrature over pairs of {g.spec} has an error of {np.max(error):.2g} in a variance "
            f"of {np.max(square / n - fine):.6g}; use convergence or variance_terms."
        )
    return np.asarray(np.maximum(variance, 0.0))


def _orders(sides: tuple[int, ...]) -> tuple[int, int]:
    """Nodes of an axis of two rules to compare: fewer in 2-D and up, and for many cells."""
    if len(sides) == 1:
        return 12, 20
    return (6, 10) if math.prod(sides) < _MANY else (4, 6)


def _cell_squares(g: Integrand, sides: tuple[int, ...], order: int) -> Array:
    """Σ_j (∫_cell j g)²: (channels or 1,)."""
    means, _ = stratum_moments(g, sides, np.zeros(g.dims), order)
    return np.asarray((means**2).mean(axis=0) / len(means))


def _of_counted_pairs(
    sampler: Sampler,
    n: int,
    g: Integrand,
    stream: Stream,
    numbers: tuple[int, int],
    workers: int,
) -> tuple[Array, Array]:
    """Variance and its standard error from realisations first … first + count − 1."""
    if n > _MOST_POINTS:
        raise ParameterError(
            f"{n} points have too many pairs to count; give {_MOST_POINTS} at most."
        )
    table = _autocorrelation(g)
    square = mean_square(g)
    if np.isinf(square).any():
        raise NoClosedForm(
            f"∫g² of {g.spec} diverges: with points that are each uniform the variance is infinite."
        )
    # The mean of the table instead of I²: what its sampling gets wrong cancels
    constant = square / n - table.reshape(len(table), -1).mean(axis=-1)
    first, count = numbers

    def one(realization: int) -> MeanSums:
        points = sampler.draw_stream(n, stream, realization, 1)[0]
        add = pair_sum_1d if g.dims == 1 else pair_sum_2d
        sums = np.array([add(points, channel) for channel in table])
        return MeanSums.of(constant + 2.0 / n**2 * sums)

    tree: MergeTree[MeanSums] = MergeTree()
    for state in map_in_order(one, range(first, first + count), workers):
        tree.add(state)
    return tree.total().mean_and_error()


def _autocorrelation(g: Integrand) -> Array:
    """A(h) at h = k/N on the torus, from values at cell centers: (channels or 1, N, …)."""
    axis = (np.arange(_GRID[g.dims]) + 0.5) / _GRID[g.dims]
    x = np.stack(np.meshgrid(*[axis] * g.dims, indexing="ij"), axis=-1)
    values = np.moveaxis(np.asarray(g(x)).reshape(*x.shape[:-1], -1), -1, 0)
    axes = tuple(range(1, g.dims + 1))
    power = np.abs(np.fft.rfftn(values, axes=axes)) ** 2
    return np.fft.irfftn(power, s=values.shape[1:], axes=axes) / x[..., 0].size
