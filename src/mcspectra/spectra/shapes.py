"""Shapes of a measured spectrum: rings, slices, wedges, and the variance that it predicts.

All take the dataset of `power_spectrum`. Standard errors are those over realisations, of the means
over rings and wedges of each of them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import (
    CorrelatedFrequenciesWarning,
    FileFormatError,
    ParameterError,
    warn,
)
from mcspectra.core.results import dataset
from mcspectra.samplers import as_sampler
from mcspectra.spectra.bases import fitting_basis
from mcspectra.spectra.power import MAX_WEDGES, wedge_angles, wedge_labels
from mcspectra.spectra.transforms import FrequencyGrid

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "HalfSpectrum",
    "radial_statistics",
    "slices",
    "variance_from_spectrum",
    "wedge_means",
]

_MAX_SLICE_DIMS = 4


@dataclass(frozen=True)
class HalfSpectrum:
    """One of each pair ν, −ν of a spectrum, without ν = 0."""

    index: Array  # ν / step, int64 (H, d)
    power: Array  # (H,)
    se: Array
    grid: FrequencyGrid
    attrs: dict[str, Any]

    @staticmethod
    def of(spectrum: xr.Dataset) -> HalfSpectrum:
        """Halve the result of `power_spectrum`, after checking that it is one."""
        power, grid = _checked(spectrum)
        half = [grid.half(power.to_numpy()), grid.half(spectrum["power_se"].to_numpy())]
        kept = ("sampler", "density", "n", "realizations", "seed", "convention")
        attrs = {key: spectrum.attrs[key] for key in kept if key in spectrum.attrs}
        return HalfSpectrum(grid.half_indices()[:-1], half[0][:-1], half[1][:-1], grid, attrs)

    @property
    def length(self) -> Array:
        """|ν| / step."""
        return np.asarray(np.sqrt((self.index**2).sum(axis=1)))

    def mean_by(self, label: Array, size: int) -> tuple[Array, Array, Array]:
        """Mean power, its standard error and the number of frequencies of each label; −1 is left out."""
        used = label >= 0
        count = np.bincount(label[used], minlength=size)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.bincount(label[used], self.power[used], minlength=size) / count
            se = np.sqrt(np.bincount(label[used], self.se[used] ** 2, minlength=size)) / count
        return mean, se, count


def _checked(spectrum: Any) -> tuple[xr.DataArray, FrequencyGrid]:
    import xarray as xr

    if not isinstance(spectrum, xr.Dataset) or not {"power", "power_se"} <= set(spectrum):
        raise ParameterError(
            f"The spectrum is {type(spectrum).__name__} without power and power_se; give the "
            "dataset that power_spectrum returns."
        )
    power = spectrum["power"]
    names = tuple(f"m{i}" for i in range(power.ndim))
    sides = set(power.shape)
    if power.dims != names or len(sides) > 1 or not power.shape[0] % 2 or power.shape[0] < 3:
        raise ParameterError(
            f"The power has dims {power.dims} of sizes {power.shape}; give the whole grid of "
            "power_spectrum, with m0, m1, … from −half_width to half_width, at least 1."
        )
    axis = power["m0"].to_numpy()
    return power, FrequencyGrid(power.ndim, len(axis) // 2, float(axis[-1] / (len(axis) // 2)))


def radial_statistics(spectrum: xr.Dataset) -> xr.Dataset:
    """Mean over directions, its standard error over realisations, and anisotropy, by ring.

    Parameters
    ----------
    spectrum
        Result of `power_spectrum`; anisotropy says something in two dims or more.

    Returns
    -------
    xarray.Dataset
        On dim radius (rings of one frequency step): ``radial_power``, ``radial_power_se``, that of
        the spectrum, or of frequencies taken as uncorrelated in a spectrum without it;
        ``anisotropy``, the variance over direction divided by the mean² [Ulichney1988]_, and
        ``anisotropy_db``, 10 log10 of it; ``anisotropy_noise_db``, what noise alone makes of an
        isotropic spectrum (−10 log10 of the realisations for Gaussian S), to compare with. NaN
        where a ring has one direction or no power.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> spectrum = mcs.power_spectrum("jittered", 64, half_width=16, realizations=50)
    >>> rings = radial_statistics(spectrum)
    >>> bool(rings["anisotropy_db"][2] > rings["anisotropy_noise_db"][2] - 5)
    True
    """
    half = HalfSpectrum.of(spectrum)
    size = half.grid.half_width
    ring = np.rint(half.length).astype(np.int64) - 1
    ring[ring >= size] = -1
    mean, se, count = half.mean_by(ring, size)
    used = ring >= 0
    radius = np.bincount(ring[used], half.length[used], minlength=size) / count
    spread = np.bincount(ring[used], (half.power[used] - mean[ring[used]]) ** 2, minlength=size)
    with np.errstate(invalid="ignore", divide="ignore"):
        anisotropy = np.where(count > 1, spread / (count - 1), np.nan) / mean**2
        noise = count * (se / mean) ** 2  # the mean of the squared errors, over mean²
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
    """Cut along the axes and all diagonals, of planes and of space, up to four dims.

    Returns
    -------
    xarray.Dataset
        ``slice_power`` and ``slice_power_se`` on dims slice and multiple: the power at ν = multiple ·
        frequency step · direction. slice is labelled by its direction, such as (1, -1),
        axes first; the coordinate ``slice_radius`` is |ν|. There are 1, 4, 13 or 40 of them in one to four dims.
    """
    half = HalfSpectrum.of(spectrum)  # checks
    grid = half.grid
    if grid.dims > _MAX_SLICE_DIMS:
        raise ParameterError(
            f"There are slices of up to {_MAX_SLICE_DIMS} dims, not {grid.dims}; use power_at "
            "with axis_frequencies."
        )
    directions = np.array(
        sorted(
            (
                direction
                for direction in itertools.product((1, 0, -1), repeat=grid.dims)
                if next((c for c in direction if c), 0) > 0
            ),
            key=lambda direction: sum(map(abs, direction)),
        )
    )
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
    """Mean power by direction: wedges of a 2-D spectrum, within the circle of its half width.

    Parameters
    ----------
    spectrum
        Result of `power_spectrum` in two dims.
    wedges
        How many divide the half turn; the first is centred on the m0 axis. Standard errors need
        the number that `power_spectrum` was given.

    Returns
    -------
    xarray.Dataset
        ``wedge_power`` and ``wedge_power_se`` on dim angle (degrees, centres of the wedges); NaN
        where no frequency lies in a wedge. The errors of points with a density are NaN for other
        numbers of wedges than the spectrum's; those of uniform points then take frequencies as
        uncorrelated.
    """
    half = HalfSpectrum.of(spectrum)
    wedges = as_integer("wedges", wedges, least=1, most=MAX_WEDGES)
    if half.grid.dims != 2:
        raise ParameterError(
            f"The spectrum has {half.grid.dims} dims; wedges are of two: use radial_statistics "
            "or slices."
        )
    label = wedge_labels(half.index, wedges)
    label[half.length > half.grid.half_width] = -1
    mean, se, _ = half.mean_by(label, wedges)
    if spectrum.sizes.get("angle") == wedges:
        se = spectrum["wedge_power_se"].to_numpy()
    elif "density" in half.attrs:  # its frequencies share the fluctuation of the weights
        se = np.full(wedges, np.nan)
    return dataset(
        {"wedge_power": (("angle",), mean), "wedge_power_se": (("angle",), se)},
        {"angle": wedge_angles(wedges)},
        **half.attrs,
    )


def variance_from_spectrum(spectrum: xr.Dataset, coefficients: Any) -> float:
    """Predict a variance as Σ_{ν≠0} |f_ν|² ⟨|S_ν|²⟩ Δν^d, the homogenised formula.

    Parameters
    ----------
    spectrum
        Result of `power_spectrum` with uniform density.
    coefficients
        f_ν on its whole grid.

    Returns
    -------
    float
        Exact, as far as the grid reaches, for randomly shifted sets at *integer* frequencies
        (``frequency_step=1``). Between these ⟨S_ν⟩ is not 0: the sum takes the bias of a finite
        window for variance and does not fall with n beyond it, as the paper's slides show
        [Singh2019]_.

    Raises
    ------
    ParameterError
        Not a spectrum, one of points with a density, or other coefficients than one a frequency.

    Warns
    ------
    CorrelatedFrequenciesWarning
        The points are not the same after any translation, so that a cross term is missing.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> spectrum = mcs.power_spectrum(mcs.sampler("random", dims=1), 50, half_width=8)
    >>> f = mcs.integrand("cosine(frequency=3)", dims=1).fourier_grid(8)
    >>> bool(abs(50 * variance_from_spectrum(spectrum, f) - 0.5) < 0.2)
    True
    """
    power, grid = _checked(spectrum)
    _check_homogenized(spectrum)
    f = np.asarray(coefficients)
    if f.shape != grid.shape or f.dtype.kind not in "iufc" or not np.isfinite(f).all():
        raise ParameterError(
            f"coefficients have shape {f.shape} and type {f.dtype}; give finite numbers of shape "
            f"{grid.shape}, one for each frequency."
        )
    terms = np.abs(f) ** 2 * power.to_numpy()
    terms[(grid.half_width,) * grid.dims] = 0.0
    return float(terms.sum() * grid.step**grid.dims)


def _check_homogenized(spectrum: xr.Dataset) -> None:
    """Refuse spectra of weighted points, and warn of those that are not homogeneous."""
    density, spec = spectrum.attrs.get("density"), spectrum.attrs.get("sampler")
    if density is not None:
        raise ParameterError(
            f"The spectrum is of points with the density {density}, whose frequencies are correlated; "
            "use variance_terms, or closed_form_covariance."
        )
    try:
        source = None if spec is None else as_sampler(spec, spectrum["power"].ndim)
    except (ParameterError, FileFormatError):  # of given points the spec does not tell
        return
    step = float(spectrum["m0"][-1] - spectrum["m0"][-2])
    # Between the integers the sum is not the variance anyway, as the docstring says
    if source is None or source.name == "random" or step != round(step):
        return
    if fitting_basis(source, 1) == "fourier":
        return
    warn(
        f"Frequencies of {spec} are correlated: the variance has a cross term that the sum over powers "
        "lacks; add shift, or use variance_terms.",
        CorrelatedFrequenciesWarning,
    )
