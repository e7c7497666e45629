"""The contract of densities: shapes, range, mass, inverse, and samples that follow the pdf."""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import DensityError
from mcspectra.densities import Density
from mcspectra.densities.registry import as_density
from mcspectra.testing.contract import (
    BrokenContract,
    called,
    check_breaks,
    demand,
    mean_and_error,
    point_sets,
    values_at,
)

__all__ = ["check_density"]

_SAMPLES = 20_000
_CELLS = {1: 64, 2: 8}  # along an axis, of the cells whose samples are counted
_LEAST = 5.0  # samples expected in a cell: below, χ² is not that of its table
_FALSE_ALARM = 1e-6
_SPREADS = 7.0
_ROUNDING = 1e-9
_RECIPROCAL = 1e-3


def check_density(density: Density | str, *, dims: int | None = None) -> None:
    """Check a density against the contract of all densities.

    Parameters
    ----------
    density
        The density, or its spec string.
    dims
        Number of dims of a spec string without ``dims``.

    Raises
    ------
    BrokenContract
        pdf, sample or invert raise, give another shape or type, or change their input; pdf is
        negative, not finite or does not integrate to 1; samples leave [0,1), lie where the pdf is 0
        or do not follow it (false alarm: 1e-6); invert does not undo sample; breaks are not ascending
        numbers within (0, 1); or `reciprocal_integral` is not ∫1/p.

    Notes
    -----
    In 1-D and 2-D samples are counted in cells (Pearson's χ²), in addition to `Density.check`,
    which documents the errors it finds in more dims.

    Examples
    --------
    >>> check_density("linear(slope=1)", dims=1)
    """
    given = as_density(density, dims)
    if given is None:
        raise BrokenContract("None is not a density; give one, or its spec.")
    u = point_sets(given.primary_dims)
    u[0, 0] = 0.0
    u[0, 1] = np.nextafter(1.0, 0.0)
    _check_shapes(given, u[:3, :5])
    check_breaks(given.spec, given.breaks, given.primary_dims)
    _check_consistency(given)
    x = given.sample(u[0, 2:])  # the corners of the cube may lie on a zero of the pdf
    zero = ~(given.pdf(x) > 0.0)
    demand(not zero.any(), given.spec, f"gives the sample {x[zero][:1].tolist()} of density 0")
    if given.dims <= 2:
        _check_counts(given)
    _check_reciprocal(given)


def _check_shapes(density: Density, u: Array) -> None:
    """Types and shapes of all three functions for stacked points, and untouched input."""
    who = density.spec
    x = values_at(who, "sample", density.sample, u, (*u.shape[:-1], density.dims))
    low, high = float(x.min()), float(x.max())
    demand(low >= 0.0 and high < 1.0, who, f"gives samples from {low} to {high}, not in [0,1)")
    values_at(who, "pdf", density.pdf, x, x.shape[:-1])
    if density.has_inverse:
        values_at(who, "invert", density.invert, x, u.shape)


def _check_consistency(density: Density) -> None:
    """What `Density.check` finds, as a broken contract."""
    try:
        called(density.spec, "check", density.check)
    except BrokenContract as error:
        if isinstance(error.__cause__, DensityError):
            raise BrokenContract(str(error.__cause__)) from error.__cause__
        raise


def _check_counts(density: Density) -> None:
    """Pearson's χ² of samples of pseudo-random points in cells, and none in cells without mass."""
    from scipy.stats import chi2

    from mcspectra.densities.adaptive import integrate

    side = _CELLS[density.dims]
    x = density.sample(np.random.default_rng(7).random((_SAMPLES, density.primary_dims)))
    expected = _SAMPLES * integrate(density._pdf, density.dims, cells=side).cells
    place = np.minimum((x * side).astype(int), side - 1)
    index = place @ side ** np.arange(density.dims)[::-1]
    counts = np.bincount(index, minlength=side**density.dims)
    full = expected > _LEAST
    rest, few = counts[~full].sum(), expected[~full].sum()
    statistic = float((((counts - expected) ** 2)[full] / expected[full]).sum())
    p = float(chi2.sf(statistic, max(int(full.sum()) - (not few), 1)))
    demand(
        p > _FALSE_ALARM and bool(abs(rest - few) <= _SPREADS * np.sqrt(few) + _LEAST),
        density.spec,
        f"gives samples that do not follow its pdf (χ² = {statistic:.4g} in {full.sum()} cells)",
    )


def _check_reciprocal(density: Density) -> None:
    """∫1/p where the class knows it: at least 1 (Jensen), and that of points where both are finite."""
    if type(density).reciprocal_integral is Density.reciprocal_integral:
        return
    found = called(density.spec, "reciprocal_integral", density.reciprocal_integral)
    demand(found >= 1.0 - _ROUNDING, density.spec, f"gives {found} for ∫1/p, less than 1")
    with np.errstate(divide="ignore", over="ignore"):
        values = 1.0 / density.pdf(point_sets(density.dims))
    if np.isfinite(found) and np.isfinite(values).all():
        mean, error = mean_and_error(values)
        allowed = _SPREADS * error + _RECIPROCAL * mean
        # Close to a zero of p the mean of few points lies below: that alone proves nothing
        short = bool(mean < found and error > _RECIPROCAL * mean)
        demand(
            short or bool(abs(mean - found) <= allowed),
            density.spec,
            f"gives {found:.6g} for ∫1/p, but points give {mean:.6g} ± {error:.2g}",
        )
