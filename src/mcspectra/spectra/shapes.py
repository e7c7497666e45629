"""Shape of a measured spectrum (rings, slices, wedges, exponent), and the variance it predicts.

All functions take the dataset that `power_spectrum` returns.
The standard errors of means over rings and wedges come from the scatter of realizations.

Exponents may depend on the direction. The exponent of the direction with the largest power is used.
A Latin hypercube has power ∝ m² along its axes, and the power of random points elsewhere.
If the power at one length depends on the direction, each class of directions is fitted separately.
A class contains the frequencies with the same nonzero axes and, in 2-D, in the same wedge.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real
from mcspectra.core.display import counted
from mcspectra.core.errors import (
    CorrelatedFrequenciesWarning,
    FileFormatError,
    Function,
    Parameter,
    ParameterError,
    warn,
)
from mcspectra.core.fits import line_fit
from mcspectra.core.results import dataset
from mcspectra.samplers import as_sampler
from mcspectra.spectra.power import MAX_WEDGES, wedge_angles, wedge_labels
from mcspectra.spectra.transforms import FrequencyGrid

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "low_frequency_exponent",
    "radial_statistics",
    "slices",
    "variance_from_spectrum",
    "wedge_means",
]

_MAX_SLICE_DIMS = 4
_LEVEL = 0.95
# Largest variance over directions, beyond noise, at which the power counts as isotropic.
# The unit is the squared mean power. For jittered points, the variance over directions is 0.001.
_ISOTROPIC = 0.1
_CLASS_WEDGES = 8
# Misfit of a single line that is fitted to all directions, as χ² per degree of freedom.
# If the misfit is larger than this, each class of directions is fitted separately.
_SUSPECT = 3.0
_SAME = 1e-7  # relative standard errors of power that come from rounding alone
_UNRESOLVED = 0.5  # half-width of the exponent's interval; wider intervals are unresolved
_MISFIT = 10.0  # χ² per degree of freedom above which there is no power law
# Rounding of small coefficients in single precision. At most 3e-8 was measured, on stratified sets
_SINGLE_ROUNDING = 1e-7


@final
@dataclass(frozen=True)
class _HalfSpectrum:
    """Half of a spectrum, without ν = 0: one frequency of each pair ν, −ν."""

    index: Array  # ν / step, int64 (H, d)
    power: Array  # (H,)
    se: Array
    grid: FrequencyGrid
    attrs: dict[str, Any]

    @staticmethod
    def of(spectrum: Any) -> _HalfSpectrum:
        """Check that a dataset comes from `power_spectrum`, and return half of the spectrum."""
        import xarray as xr

        if not isinstance(spectrum, xr.Dataset) or not {"power", "power_se"} <= set(spectrum):
            raise ParameterError(
                f"The spectrum is {type(spectrum).__name__} without power and power_se; give the "
                "dataset that ",
                Function("power_spectrum"),
                " returns.",
            )
        power = spectrum["power"]
        names = tuple(f"m{i}" for i in range(power.ndim))
        sides = set(power.shape)
        if power.dims != names or len(sides) > 1 or not power.shape[0] % 2 or power.shape[0] < 3:
            raise ParameterError(
                f"The power has dims {power.dims} of sizes {power.shape}; give the whole grid of ",
                Function("power_spectrum"),
                ", with m0, m1, … from −",
                Parameter("half_width"),
                " to ",
                Parameter("half_width"),
                ", at least 1.",
            )
        axis = power["m0"].to_numpy()
        half_width = len(axis) // 2
        grid = FrequencyGrid(power.ndim, half_width, float(axis[-1] / half_width))
        half, se = (grid.pick(spectrum[name].to_numpy())[:-1] for name in ("power", "power_se"))
        kept = ("sampler", "density", "n", "realizations", "seed", "convention")
        attrs = {key: spectrum.attrs[key] for key in kept if key in spectrum.attrs}
        return _HalfSpectrum(grid.indices()[:-1], half, se, grid, attrs)

    @property
    def length(self) -> Array:
        """|ν| / step."""
        return np.asarray(np.linalg.norm(self.index, axis=1))

    def mean_by(self, label: Array, size: int) -> tuple[Array, Array, Array]:
        """Return mean power, standard error and number of frequencies for each label except −1."""
        used = label >= 0
        count = np.bincount(label[used], minlength=size)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.bincount(label[used], self.power[used], minlength=size) / count
            se = np.sqrt(np.bincount(label[used], self.se[used] ** 2, minlength=size)) / count
        return mean, se, count


def radial_statistics(spectrum: xr.Dataset) -> xr.Dataset:
    """Return the mean over directions, its standard error, and the anisotropy, for each ring.

    Parameters
    ----------
    spectrum
        Result of `power_spectrum`. The anisotropy is meaningful in two or more dims.

    Returns
    -------
    xarray.Dataset
        All variables have the dim ``radius``. Each ring of frequencies is one frequency step wide.
        Anisotropies are NaN if a ring has only one direction, or has no power.
        ``radial_power`` is the mean, and ``radial_power_se`` is its standard error.
        The standard error is copied from the spectrum.
        Without errors in the spectrum, the standard error assumes uncorrelated frequencies.
        ``anisotropy`` is the variance over directions, divided by the mean² [Ulichney1988]_.
        ``anisotropy_db`` is 10 log10 of the anisotropy.
        ``anisotropy_noise_db`` is the anisotropy (dB) that noise causes in an isotropic spectrum.
        For Gaussian S, noise causes an anisotropy (dB) of −10 log10 of the number of realizations.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> spectrum = mcs.power_spectrum("jittered", 64, half_width=16, realizations=50)
    >>> rings = radial_statistics(spectrum)
    >>> bool(rings["anisotropy_db"][2] > rings["anisotropy_noise_db"][2] - 5)
    True
    """
    half = _HalfSpectrum.of(spectrum)
    size = half.grid.half_width
    ring = np.rint(half.length).astype(np.int64) - 1
    ring[ring >= size] = -1
    mean, se, count = half.mean_by(ring, size)
    used = ring >= 0
    radius = np.bincount(ring[used], half.length[used], minlength=size) / count
    spread = np.bincount(ring[used], (half.power[used] - mean[ring[used]]) ** 2, minlength=size)
    with np.errstate(invalid="ignore", divide="ignore"):
        anisotropy = np.where(count > 1, spread / (count - 1), np.nan) / mean**2
        noise = count * (se / mean) ** 2  # mean squared error divided by mean²
        decibels = [10 * np.log10(values) for values in (anisotropy, noise)]
    if "radial_power_se" in spectrum:
        se = spectrum["radial_power_se"].to_numpy()
    found = {
        "radial_power": mean,
        "radial_power_se": se,
        "anisotropy": anisotropy,
        "anisotropy_db": decibels[0],
        "anisotropy_noise_db": decibels[1],
    }
    labels = {"long_name": "|m|", "units": "cycles per unit"}
    return dataset(
        {name: (("radius",), values) for name, values in found.items()},
        {"radius": ("radius", radius * half.grid.step, labels)},
        **half.attrs,
    )


def slices(spectrum: xr.Dataset) -> xr.Dataset:
    """Cut the spectrum along the axes and all diagonals, in up to four dims.

    Diagonals are directions whose components are −1, 0 or 1, in a plane or in more dims.

    Returns
    -------
    xarray.Dataset
        ``slice_power`` and its standard error ``slice_power_se``, on the dims slice and multiple.
        The slice power is the power at ν = multiple · frequency step · direction.
        Each slice is labeled by its direction, such as (1, -1). The axes come first.
        The coordinate ``slice_radius`` is |ν|. There are 1, 4, 13 or 40 slices in 1 to 4 dims.
    """
    half = _HalfSpectrum.of(spectrum)
    grid = half.grid
    if grid.dims > _MAX_SLICE_DIMS:
        raise ParameterError(
            f"There are slices of up to {_MAX_SLICE_DIMS} dims, not {grid.dims}; use power_at "
            "with axis_frequencies."
        )
    every = itertools.product((1, 0, -1), repeat=grid.dims)
    half_space = [direction for direction in every if direction > (0,) * grid.dims]
    directions = np.array(sorted(half_space, key=lambda direction: sum(map(abs, direction))))
    multiple = np.arange(1, grid.half_width + 1)
    place = directions[:, None, :] * multiple[:, None] + grid.half_width
    where = tuple(np.moveaxis(place, -1, 0))
    radius = grid.step * np.outer(np.sqrt((directions**2).sum(axis=1)), multiple)
    dims = ("slice", "multiple")
    return dataset(
        {
            "slice_power": (dims, spectrum["power"].to_numpy()[where]),
            "slice_power_se": (dims, spectrum["power_se"].to_numpy()[where]),
        },
        {
            "slice": ("slice", [str(tuple(d.tolist())) for d in directions]),
            "multiple": ("multiple", multiple, {"long_name": "multiple", "units": "1"}),
            "slice_radius": (dims, radius, {"long_name": "|m|", "units": "cycles per unit"}),
        },
        **half.attrs,
    )


def wedge_means(spectrum: xr.Dataset, wedges: int = 12) -> xr.Dataset:
    """Return the mean power of a 2-D spectrum by direction, in wedges of frequencies.

    Only frequencies whose length is at most the half width of the spectrum are used.

    Parameters
    ----------
    spectrum
        Result of `power_spectrum` in two dims.
    wedges
        Number of wedges in half a turn. The first wedge is centered on the m0 axis.
        Standard errors require the number of wedges that `power_spectrum` used.

    Returns
    -------
    xarray.Dataset
        ``wedge_power`` and its standard error ``wedge_power_se``, on the dim angle.
        Angles are in degrees, at the centers of the wedges.
        Values are NaN for wedges without frequencies.
        The spectrum has standard errors only for the number of wedges that `power_spectrum` used.
        For other numbers of wedges, errors are computed as if frequencies were uncorrelated.
        For importance-sampled points, frequencies are correlated, so these errors are NaN.
    """
    half = _HalfSpectrum.of(spectrum)
    wedges = as_integer("wedges", wedges, least=1, most=MAX_WEDGES)
    if half.grid.dims != 2:
        raise ParameterError(
            f"The spectrum has {counted(half.grid.dims, 'dim')}; wedges need two: use "
            "radial_statistics or slices."
        )
    label = wedge_labels(half.index, wedges)
    label[half.length > half.grid.half_width] = -1
    mean, se, _ = half.mean_by(label, wedges)
    if spectrum.sizes.get("angle") == wedges:
        se = spectrum["wedge_power_se"].to_numpy()
    elif "density" in half.attrs:  # random changes of the weights affect all frequencies
        se = np.full(wedges, np.nan)
    return dataset(
        {"wedge_power": (("angle",), mean), "wedge_power_se": (("angle",), se)},
        {"angle": wedge_angles(wedges)},
        **half.attrs,
    )


def low_frequency_exponent(
    spectrum: xr.Dataset, *, up_to: float | None = None, axis: int | None = None
) -> xr.Dataset:
    """Fit power ∝ |ν|^b at low frequencies. The exponent b determines the rate [Pilleboue2015]_.

    Parameters
    ----------
    spectrum
        Result of `power_spectrum` with at least two realizations.
        Between the integers ⟨S_ν⟩ is not 0, so the variance ⟨|S_ν|²⟩ − |⟨S_ν⟩|² is fitted.
        Between the integers, the spectrum must contain the means of S (``mean=True``).
    up_to
        Largest |ν| that is fitted. The default is a quarter of the points' mean frequency n^(1/d).
        The fitted range has at least three lengths |ν|, and does not exceed the half width.
    axis
        Axis along which to fit. By default all directions are fitted together.
        If the power depends on the direction, each class of directions is fitted separately.
        The result is then the fit of the class with the largest power at the lowest frequency.

    Returns
    -------
    xarray.Dataset
        ``low_frequency_exponent``, and its 95 % interval, whose ends are on the dim ``bound``.
        ``exponent_fit_chi2`` measures how badly the line fits, as χ² per degree of freedom.
        If the χ² of the fit exceeds 1, the interval is widened by √χ².
        The attributes ``up_to``, ``lengths`` and ``directions`` describe the fit.
        The attribute ``reason`` explains why the exponent is NaN or unresolved.
        The exponent is NaN if some lengths |ν| have no power, as for a lattice.
        The exponent is also NaN if all realizations have the same power, or if χ² exceeds 10.
        The exponent is unresolved if its interval is wider than ±0.5.

    Raises
    ------
    ParameterError
        If the spectrum has no standard errors, or has fewer than three lengths |ν|.
        If frequencies lie between the integers, and the spectrum has no means of S.

    Notes
    -----
    The fit uses weighted least squares of log power on log |ν|.
    All frequencies of one length (and class of directions) are averaged.
    If k classes of directions are fitted, each interval has the confidence level 1 − 0.05/k.
    The fitted exponent b depends on the largest frequency |ν| that is fitted.
    For example, the power 1 − sinc² of jittered points has b = 2 at 0 and b = 1.8 at n^(1/d)/4.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> spectrum = mcs.power_spectrum("random", 256, half_width=8, realizations=400)
    >>> bool(abs(low_frequency_exponent(spectrum)["low_frequency_exponent"]) < 0.2)
    True
    """
    half = _HalfSpectrum.of(spectrum)
    grid = half.grid
    # Between the integers, subtract the power of the mean coefficient
    if grid.step != round(grid.step):
        if "mean_coefficient" not in spectrum:
            raise ParameterError(
                f"The spectrum has a frequency step of {grid.step:g}; between the integers its "
                "power is not that of fluctuations alone: use power_spectrum(…, mean=True)."
            )
        mean = grid.pick(spectrum["mean_coefficient"].to_numpy())[:-1]
        # Correct for the noise of the sample mean: the factor is R/(R − 1) for R realizations
        bessel = 1.0 / (1.0 - 1.0 / float(half.attrs.get("realizations", math.inf)))
        half = replace(half, power=np.maximum(half.power - np.abs(mean) ** 2, 0.0) * bessel)

    # Label the frequencies by length, in ascending order. Excluded frequencies have label −1
    square = (half.index**2).sum(axis=1)
    wanted = square <= grid.half_width**2
    if axis is not None:
        axis = as_integer("axis", axis, least=0, most=grid.dims - 1)
        wanted &= square == half.index[:, axis] ** 2
    squares, inverse = np.unique(square[wanted], return_inverse=True)
    label, lengths = np.full(len(square), -1), np.sqrt(squares)
    label[wanted] = inverse

    # Choose the range of frequencies for the fit, with at least three lengths |ν|
    if len(lengths) < 3:
        raise ParameterError(
            f"A fit needs three lengths of frequency, of which the spectrum has {len(lengths)}; "
            "use a larger ",
            Parameter("half_width"),
            ".",
        )
    if up_to is None:
        quarter = float(half.attrs.get("n", 1)) ** (1 / grid.dims) / 4 / grid.step
        window = float(min(max(quarter, lengths[2]), grid.half_width))
    else:
        least, most = float(lengths[2]) * grid.step * (1 - 1e-9), grid.half_width * grid.step
        window = as_real("up_to", up_to, least=least, most=most) / grid.step
    lengths = lengths[lengths <= window * (1 + 1e-9)]
    label[label >= len(lengths)] = -1

    # Fit the power at the lengths |ν|.
    # If the power at some length is only rounding, there is no power law
    power, se, _ = half.mean_by(label, len(lengths))
    if np.isnan(se).any():
        raise ParameterError(
            "The spectrum is from one set, whose power at single frequencies varies by 100 %, so "
            "there are no standard errors to weight the fit by; use two or more realizations, or "
            "files of several sets as in points(path='set_*.dat')."
        )
    approximate = spectrum.attrs.get("engine") == "nufft"
    least = 10 * spectrum.attrs.get("eps", 0.0) if approximate else 0.0
    if "transform_error" in spectrum.attrs:
        # In single precision, very small powers are only rounding errors
        least = _SINGLE_ROUNDING
    empty = int(np.count_nonzero(power <= max(least, 1e-14) ** 2))
    reason = None
    if empty:
        reason = f"{empty} of {len(power)} lengths have no power: there is no power law."
        fit = _LowFrequencyFit(math.nan, 0.0, (math.nan, math.nan), math.nan, len(lengths), "all")
    else:
        fit = _over_directions(half, label, lengths)
        low, high = fit.interval
        if se.max() <= _SAME * power.max():
            reason = (
                "The power is the same in all realizations, that of one set with its peaks: there "
                "is no power law; randomize the set further, as with owen."
            )
        elif fit.chi2 > _MISFIT:
            reason = f"χ² per degree of freedom is {fit.chi2:.3g}: there is no power law."
        if reason:
            fit = replace(fit, slope=math.nan, interval=(math.nan, math.nan))
        elif not high - low <= 2 * _UNRESOLVED:
            reason = (
                f"The 95 % interval of the exponent, {low:.3g} … {high:.3g}, is wider than ±0.5: "
                "it is not resolved; use more realizations or a larger half_width."
            )
    return dataset(
        {
            "low_frequency_exponent": ((), fit.slope),
            "low_frequency_exponent_ci": (("bound",), np.array(fit.interval)),
            "exponent_fit_chi2": ((), fit.chi2),
        },
        {"bound": ["low", "high"]},
        up_to=window * grid.step,
        lengths=fit.lengths,
        directions=fit.directions if axis is None else f"axis {axis}",
        reason=reason,
        **half.attrs,
    )


@final
@dataclass(frozen=True)
class _LowFrequencyFit:
    """Result of a fit: slope, log power at the lowest frequency, interval, misfit, directions."""

    slope: float
    level: float
    interval: tuple[float, float]
    chi2: float
    lengths: int
    directions: str


def _over_directions(half: _HalfSpectrum, label: Array, lengths: Array) -> _LowFrequencyFit:
    """Fit all directions together if they have the same power.

    If the power depends on the direction, fit each class of directions separately.
    Return the fit of the class with the largest power at the lowest frequency.
    """
    whole = _fit_class(half, label, lengths, "all", 1)
    assert whole is not None
    # Compute the variance of the power over directions, and subtract the variance from noise.
    # Divide by the squared mean power of each length, and average over frequencies
    mean, _, count = half.mean_by(label, len(lengths))
    several = (label >= 0) & (count[label] > 1)
    own, k = mean[label[several]], count[label[several]]
    spread = (half.power[several] - own) ** 2 * k / (k - 1)
    excess = float(np.mean((spread - half.se[several] ** 2) / own**2)) if several.any() else 0.0
    # Some lengths occur in several directions. For example, (3, 4) and (5, 0) have equal lengths.
    # If every length has only one direction, unequal powers appear as a misfit of the line.
    if half.grid.dims == 1 or (excess <= _ISOTROPIC and whole.chi2 <= _SUSPECT):
        return whole
    # Classify frequencies by their nonzero axes. In 2-D, if both are nonzero, classify by wedges
    involved, place = np.unique(half.index != 0, axis=0, return_inverse=True)
    texts = [" and ".join(f"m{i}" for i in np.flatnonzero(row)) for row in involved]
    names = np.array(texts, dtype=object)[place.ravel()]
    if half.grid.dims == 2:
        both = (half.index != 0).all(axis=1)
        angles = 180 / _CLASS_WEDGES * wedge_labels(half.index[both], _CLASS_WEDGES)
        names[both] = [
            f"{name}, about {angle:g}°" for name, angle in zip(names[both], angles, strict=True)
        ]
    classes = sorted(set(names[label >= 0]))
    fits = [
        _fit_class(half, np.where(names == name, label, -1), lengths, name, len(classes))
        for name in classes
    ]
    return max([f for f in fits if f is not None], key=lambda f: f.level, default=whole)


def _fit_class(
    half: _HalfSpectrum, label: Array, lengths: Array, name: str, classes: int
) -> _LowFrequencyFit | None:
    """Fit the power at the lengths |ν| of frequencies in one class of directions.

    The result is None if there are fewer than three lengths, or if the power is 0 at a length.
    """
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
    return _LowFrequencyFit(fit.slope, float(fit.at(0.0)), interval, fit.chi2, len(x), name)


def variance_from_spectrum(spectrum: xr.Dataset, coefficients: Any) -> float:
    """Predict a variance of homogenized points: Σ_{ν≠0} |f_ν|² ⟨|S_ν|²⟩ Δν^d.

    Parameters
    ----------
    spectrum
        Result of `power_spectrum` with uniform density.
    coefficients
        Coefficients f_ν on the whole grid of the spectrum.

    Returns
    -------
    float
        The variance of randomly shifted sets, at *integer* frequencies (``frequency_step=1``).
        At integer frequencies, the result is exact up to the truncation of the grid.
        Between the integers, where ⟨S_ν⟩ is not 0, the sum includes the bias of a finite window.
        Between the integers, the sum is at least as large as the bias of the window [Singh2019]_.

    Raises
    ------
    ParameterError
        If `spectrum` is not a spectrum of uniform points, or the coefficients do not fit its grid.

    Warns
    ------
    CorrelatedFrequenciesWarning
        If the points are not stationary, because the formula then omits a cross term.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> spectrum = mcs.power_spectrum(mcs.sampler("random", dims=1), 50, half_width=8)
    >>> f = mcs.integrand("cosine(frequency=3)", dims=1).fourier_grid(8)
    >>> bool(abs(50 * variance_from_spectrum(spectrum, f) - 0.5) < 0.2)
    True
    """
    grid = _HalfSpectrum.of(spectrum).grid
    density, spec = spectrum.attrs.get("density"), spectrum.attrs.get("sampler")
    if density is not None:
        raise ParameterError(
            f"The spectrum is of points with the density {density}, whose frequencies are "
            "correlated; use ",
            Function("variance_terms"),
            ", or closed_form_covariance.",
        )
    f = np.asarray(coefficients)
    if f.shape != grid.shape or f.dtype.kind not in "iufc" or not np.isfinite(f).all():
        raise ParameterError(
            f"coefficients have shape {f.shape} and type {f.dtype}; give finite numbers of shape "
            f"{grid.shape}, one for each frequency."
        )
    # Warn if the points are not stationary. Specs of given points do not show stationarity
    # Between the integers, the returned sum is not the variance (see Returns)
    try:
        source = None if spec is None else as_sampler(spec, grid.dims)
    except (ParameterError, FileFormatError):
        source = None
    correlated = (
        source is not None
        and grid.step == round(grid.step)
        and not source.law(source.nearest_count(spectrum.attrs["n"])).stationary
    )
    if correlated:
        warn(
            f"Frequencies of {spec} are correlated: the variance has a cross term that the sum "
            "over powers lacks; add shift, or use variance_terms.",
            CorrelatedFrequenciesWarning,
        )
    terms = np.abs(f) ** 2 * spectrum["power"].to_numpy()
    terms[(grid.half_width,) * grid.dims] = 0.0
    return float(terms.sum() * grid.step**grid.dims)
