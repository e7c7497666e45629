"""The exponent of a measured spectrum at low frequencies."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real
from mcspectra.core.errors import ParameterError
from mcspectra.core.results import dataset
from mcspectra.spectra.shapes import HalfSpectrum

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["low_frequency_exponent"]

_LEVEL = 0.95


def low_frequency_exponent(
    spectrum: xr.Dataset, *, up_to: float | None = None, axis: int | None = None
) -> xr.Dataset:
    """Fit power ∝ |ν|^b at low frequencies: b decides the rate of the variance [Pilleboue2015]_.

    Parameters
    ----------
    spectrum
        Result of `power_spectrum`, of two realisations or more.
    up_to
        Largest |ν| of the fit; by default a quarter of n^(1/d), the mean frequency of the points,
        but at least three lengths and at most the half width.
    axis
        Fit along this axis alone; by default over all directions, where the largest power of a
        length counts.

    Returns
    -------
    xarray.Dataset
        ``low_frequency_exponent``, its 95 % interval on dim bound, and ``exponent_fit_chi2``, the
        lack of fit, χ² per degree of freedom: an interval is widened by its root where it is above 1.
        Attributes ``up_to`` and ``lengths``; all NaN, with the attribute ``reason``, where lengths
        have no power, as those of a lattice.

    Notes
    -----
    Weighted least squares of log power on log |ν|, all frequencies of one length taken together.
    b is that of the window: 1 − sinc² of jittered points, b = 2 at 0, bends to 1.8 at n^(1/d)/4.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> spectrum = mcs.power_spectrum("random", 256, half_width=8, realizations=400)
    >>> bool(abs(low_frequency_exponent(spectrum)["low_frequency_exponent"]) < 0.2)
    True
    """
    half = HalfSpectrum.of(spectrum)
    label, lengths = _lengths(half, axis)
    window = _window(half, up_to, lengths)
    lengths = lengths[lengths <= window * (1 + 1e-9)]
    label[label >= len(lengths)] = -1
    power, se, _ = half.mean_by(label, len(lengths))
    if np.isnan(se).any():
        raise ParameterError(
            "The spectrum has no standard errors to weight the fit by; use two or more realisations."
        )
    exact = spectrum.attrs.get("engine") not in ("nufft", "gpu")
    eps = 0.0 if exact else spectrum.attrs.get("eps", 0.0)
    empty = int(np.count_nonzero(power <= max(10 * eps, 1e-14) ** 2))
    reason = f"{empty} of {len(lengths)} lengths have no power: there is no power law."
    b, interval, chi2 = math.nan, (math.nan, math.nan), math.nan
    if not empty:
        b, interval, chi2 = _fit(np.log(lengths * half.grid.step), power, se)
    return dataset(
        {
            "low_frequency_exponent": ((), b),
            "low_frequency_exponent_ci": (("bound",), np.array(interval)),
            "exponent_fit_chi2": ((), chi2),
        },
        {"bound": ["low", "high"]},
        up_to=window * half.grid.step,
        lengths=len(lengths),
        reason=reason if empty else None,
        **half.attrs,
    )


def _lengths(half: HalfSpectrum, axis: int | None) -> tuple[Array, Array]:
    """Label of the length of each frequency, −1 for those not wanted, and the lengths, ascending."""
    square = (half.index**2).sum(axis=1)
    wanted = square <= half.grid.half_width**2
    if axis is not None:
        axis = as_integer("axis", axis, least=0, most=half.grid.dims - 1)
        wanted &= square == half.index[:, axis] ** 2
    found, inverse = np.unique(square[wanted], return_inverse=True)
    label = np.full(len(square), -1)
    label[wanted] = inverse
    return label, np.sqrt(found)


def _window(half: HalfSpectrum, up_to: float | None, lengths: Array) -> float:
    """Largest length of the fit, in steps: one that leaves three lengths at least."""
    if len(lengths) < 3:
        raise ParameterError(
            f"The spectrum has {len(lengths)} lengths of frequency; a fit needs three: use a larger "
            "half_width."
        )
    step = half.grid.step
    if up_to is None:
        count = float(half.attrs.get("n", 1))
        quarter = count ** (1 / half.grid.dims) / 4 / step
        return float(min(max(quarter, lengths[2]), half.grid.half_width))
    most = half.grid.half_width * step
    return as_real("up_to", up_to, least=float(lengths[2]) * step * (1 - 1e-9), most=most) / step


def _fit(x: Array, power: Array, se: Array) -> tuple[float, tuple[float, float], float]:
    """Slope of log power, its 95 % interval, and χ² per degree of freedom."""
    from scipy.special import stdtrit

    y, weight = np.log(power), np.maximum(se / power, 1e-9) ** -2.0
    centre, level = np.average(x, weights=weight), np.average(y, weights=weight)
    spread = (weight * (x - centre) ** 2).sum()
    slope = float((weight * (x - centre) * y).sum() / spread)
    degrees = len(x) - 2
    chi2 = float((weight * (y - level - slope * (x - centre)) ** 2).sum() / degrees)
    half = float(stdtrit(degrees, 0.5 + _LEVEL / 2)) * math.sqrt(max(chi2, 1.0) / spread)
    return slope, (slope - half, slope + half), chi2
