"""The exponent of a measured spectrum at low frequencies.

Directions may have different exponents: a Latin hypercube has m² along its axes and the power of random
points elsewhere, and the largest power decides. Where the power of a length depends on direction, each
class of directions is fitted by itself: frequencies by the axes that they involve and, in 2-D, by wedges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real
from mcspectra.core.errors import ParameterError
from mcspectra.core.fits import line_fit
from mcspectra.core.results import dataset
from mcspectra.spectra.power import wedge_labels
from mcspectra.spectra.shapes import HalfSpectrum

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["low_frequency_exponent"]

_LEVEL = 0.95
_ISOTROPIC = 0.1  # excess of (spread over direction / mean)² over noise; jittered points: 0.001
_WEDGES = 8
_SUSPECT = 3.0  # χ² per degree of freedom, beyond which directions are looked at
_MISFIT = 10.0  # χ² per degree of freedom, beyond which there is no power law


def low_frequency_exponent(
    spectrum: xr.Dataset, *, up_to: float | None = None, axis: int | None = None
) -> xr.Dataset:
    """Fit power ∝ |ν|^b at low frequencies: b decides the rate of the variance [Pilleboue2015]_.

    Parameters
    ----------
    spectrum
        Result of `power_spectrum`, of two realisations or more; between the integers with its
        ``mean=True``, because ⟨S_ν⟩ is not 0 there: what is fitted is then ⟨|S_ν|²⟩ − |⟨S_ν⟩|².
    up_to
        Largest |ν| of the fit; by default a quarter of n^(1/d), the mean frequency of the points,
        but at least three lengths and at most the half width.
    axis
        Fit along this axis alone; by default over all directions or, where they differ, over those
        with the largest power at the lowest frequency.

    Returns
    -------
    xarray.Dataset
        ``low_frequency_exponent``, its 95 % interval on dim bound, and ``exponent_fit_chi2``, the
        lack of fit, χ² per degree of freedom: an interval is widened by its root where it is above 1.
        Attributes ``up_to``, ``lengths`` and ``directions``, those of the fit. The attribute ``reason``
        says why all are NaN, where lengths have no power, as those of a lattice; or that there is
        no power law, where χ² per degree of freedom is above 10.

    Raises
    ------
    ParameterError
        Not a spectrum with errors and three lengths, or one between the integers without means.

    Notes
    -----
    Weighted least squares of log power on log |ν|, all frequencies of one length (and class of
    directions) taken together; the interval of one of k classes is that of 1 − 0.05/k.
    b is that of the window: 1 − sinc² of jittered points, b = 2 at 0, bends to 1.8 at n^(1/d)/4.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> spectrum = mcs.power_spectrum("random", 256, half_width=8, realizations=400)
    >>> bool(abs(low_frequency_exponent(spectrum)["low_frequency_exponent"]) < 0.2)
    True
    """
    half = _centred(HalfSpectrum.of(spectrum), spectrum)
    label, lengths = _lengths(half, axis)
    window = _window(half, up_to, lengths)
    lengths = lengths[lengths <= window * (1 + 1e-9)]
    label[label >= len(lengths)] = -1
    power, se, _ = half.mean_by(label, len(lengths))
    if np.isnan(se).any():
        raise ParameterError(
            "The spectrum has no standard errors to weight the fit by; use two or more realisations."
        )
    fit = _Fit(math.nan, 0.0, (math.nan, math.nan), math.nan, len(lengths), "all")
    reason = _without_power(spectrum, power)
    if reason is None:
        fit = _over_directions(half, label, lengths)
        if fit.chi2 > _MISFIT:
            reason = f"χ² per degree of freedom is {fit.chi2:.3g}: there is no power law."
    return dataset(
        {
            "low_frequency_exponent": ((), fit.slope),
            "low_frequency_exponent_ci": (("bound",), np.array(fit.interval)),
            "exponent_fit_chi2": ((), fit.chi2),
        },
        {"bound": ["low", "high"]},
        up_to=window * half.grid.step,
        lengths=fit.lengths,
        directions=fit.directions if axis is None else f"axis {axis}",
        reason=reason,
        **half.attrs,
    )


@dataclass(frozen=True)
class _Fit:
    """Slope, log power at the lowest frequency, interval, lack of fit, and what was fitted."""

    slope: float
    level: float
    interval: tuple[float, float]
    chi2: float
    lengths: int
    directions: str


def _centred(half: HalfSpectrum, spectrum: xr.Dataset) -> HalfSpectrum:
    """At integer frequencies as it is, else without the power of the mean."""
    if half.grid.step == round(half.grid.step):
        return half
    if "mean_coefficient" not in spectrum:
        raise ParameterError(
            f"The spectrum has a frequency step of {half.grid.step:g}; between the integers its "
            "power is not that of fluctuations alone: use power_spectrum(…, mean=True)."
        )
    mean = half.grid.half(spectrum["mean_coefficient"].to_numpy())[:-1]
    count = float(half.attrs.get("realizations", math.inf))
    # ddof = 1: the sample mean holds 1/R of the fluctuation itself
    bessel = 1.0 / (1.0 - 1.0 / count)
    return replace(half, power=np.maximum(half.power - np.abs(mean) ** 2, 0.0) * bessel)


def _without_power(spectrum: xr.Dataset, power: Array) -> str | None:
    """A sentence where lengths have no power."""
    exact = spectrum.attrs.get("engine") not in ("nufft", "gpu")
    eps = 0.0 if exact else spectrum.attrs.get("eps", 0.0)
    empty = int(np.count_nonzero(power <= max(10 * eps, 1e-14) ** 2))
    if not empty:
        return None
    return f"{empty} of {len(power)} lengths have no power: there is no power law."


def _over_directions(half: HalfSpectrum, label: Array, lengths: Array) -> _Fit:
    """Fit all directions where they agree, else the class with the largest power at the low end."""
    whole = _fit_class(half, label, lengths, "all", 1)
    assert whole is not None
    isotropic = _excess_anisotropy(half, label, len(lengths)) <= _ISOTROPIC
    # Few lengths have several directions: (3, 4) and (5, 0), but different ones fit no line either
    if half.grid.dims == 1 or (isotropic and whole.chi2 <= _SUSPECT):
        return whole
    names = _direction_names(half)
    classes = sorted(set(names[label >= 0]))
    fits = [
        _fit_class(half, np.where(names == name, label, -1), lengths, name, len(classes))
        for name in classes
    ]
    return max([f for f in fits if f is not None], key=lambda f: f.level, default=whole)


def _excess_anisotropy(half: HalfSpectrum, label: Array, size: int) -> float:
    """Mean over lengths of the relative variance over direction beyond that of noise."""
    mean, _, count = half.mean_by(label, size)
    used = label >= 0
    several = used & (count[label] > 1)
    if not several.any():
        return 0.0
    own, k = mean[label[several]], count[label[several]]
    spread = (half.power[several] - own) ** 2 * k / (k - 1)
    return float(np.mean((spread - half.se[several] ** 2) / own**2))


def _direction_names(half: HalfSpectrum) -> Array:
    """Class of each frequency: the axes it involves and, for both axes of two, a wedge."""
    names = [
        " and ".join(f"m{i}" for i in np.flatnonzero(row))
        for row in np.unique(half.index != 0, axis=0)
    ]
    _, place = np.unique(half.index != 0, axis=0, return_inverse=True)
    found = np.array(names, dtype=object)[place.ravel()]
    if half.grid.dims == 2:
        wedge = wedge_labels(half.index, _WEDGES)
        degrees = [f", about {180 * k / _WEDGES:g}°" for k in range(_WEDGES)]
        both = (half.index != 0).all(axis=1)
        found[both] = [name + degrees[k] for name, k in zip(found[both], wedge[both], strict=True)]
    return found


def _fit_class(
    half: HalfSpectrum, label: Array, lengths: Array, name: str, classes: int
) -> _Fit | None:
    """Fit the lengths of one class that have power; None where fewer than three have."""
    from scipy.special import stdtrit

    power, se, count = half.mean_by(label, len(lengths))
    used = count > 0
    if np.count_nonzero(used) < 3 or not (power[used] > 0).all():
        return None
    x = np.log(lengths[used] * half.grid.step) - math.log(lengths[0] * half.grid.step)
    error = np.maximum(se[used] / power[used], 1e-9)
    fit = line_fit(x, np.log(power[used]), error**-2.0)
    quantile = float(stdtrit(len(x) - 2, 1 - (1 - _LEVEL) / (2 * classes)))
    wide = quantile * math.sqrt(max(fit.chi2, 1.0) / fit.spread)
    interval = (fit.slope - wide, fit.slope + wide)
    return _Fit(fit.slope, float(fit.at(0.0)), interval, fit.chi2, len(x), name)


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
