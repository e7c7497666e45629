"""The error spectrum of an image whose pixels share a set: predicted from spectra, and measured.

With a sampler that ends in ``decorrelate``, pixel p moves the shared set by a shift δ_p.
The error of pixel p is Σ_{m≠0} conj(f^p_m) S_m e^{−2πi m·δ_p}.
The spectrum S_m is the same for all pixels, and each pixel has its own phase.
The covariance of two pixels is the cross term with their two integrands.
The Fourier transform of this covariance is the power of the error image.
The effect of a mask depends on f and on S_m, so masks are ranked for one integrand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import NoClosedForm, Parameter, ParameterError
from mcspectra.core.images import Rings
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.core.tally import counting
from mcspectra.estimators.quadrature import square_integral
from mcspectra.integrands import Integrand, as_integrand
from mcspectra.prediction.known import half_interval
from mcspectra.samplers import Decorrelate, Sampler, as_sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ImageErrorSettings", "image_error_spectrum"]

_LOW = 0.125
"""Spatial frequency in cycles per pixel. The eye does not blur noise of lower frequencies."""


@final
@dataclass(frozen=True, kw_only=True)
class ImageErrorSettings:
    """Limits for predictions of the spectra of error images.

    Attributes
    ----------
    most_dims
        Largest number of dims. In 4 dims, half width 31 gives nearly `most_values` coefficients.
        Fast transforms exist only in up to 3 dims.
    most_values
        Largest number of coefficients, or of points of one image: 256 MiB of complex numbers.
    half_width, lost, most_modes
        Initial half width. It is doubled until the frequencies capture the power of every band.
        A band is captured if higher frequencies hold less than the fraction `lost` of its power.
        Doubling stops at `most_modes` frequencies (half width 724 in 2-D, or 63 in 3-D).
        A loss of 1 % of the power is less than the standard error of 16 images.
    beyond
        A note reports a band if more than this fraction of its power lies beyond the half width.
        If this fraction of the power of a band is left out, the ranking of masks can change.
    precision
        Relative error of the transforms, far below the relative error of the images.
    """

    most_dims: int = 3
    most_values: int = 2**24
    half_width: int = 24
    lost: float = 0.01
    most_modes: int = 2**21
    beyond: float = 0.1
    precision: float = 1e-9


_SETTINGS = ImageErrorSettings()


def image_error_spectrum(
    integrand: Integrand | str | Sequence[Integrand | str],
    sampler: Sampler | str,
    n: int,
    *,
    dims: int | None = None,
    half_width: int | None = None,
    images: int = 16,
    rng: RngLike = 0,
    max_evaluations: int | None = None,
) -> xr.Dataset:
    """Predict the power of an error image over radial frequency, and measure it.

    Parameters
    ----------
    integrand
        One integrand for all pixels, or width² integrands, one per pixel, row by row; 1 to 3 dims.
    sampler
        A sampler that ends in ``decorrelate(mask=…, width=…)`` with mode shift.
    n
        Number of samples per pixel.
    half_width
        Frequencies m in {−half_width … half_width}^d are predicted term by term.
        For higher frequencies, points are assumed to be random and pixels independent.
        The default half width is 24. With closed-form coefficients, it is doubled as needed.
        Doubling ends when the rest of ∫f² adds under 1 % to every band, or at 2^21 frequencies.
    images
        Number of independent images, at least 2.
        Each image has its own shared set and its own position of the mask.
    max_evaluations
        Maximum number of evaluations of a user's function. More evaluations raise BudgetError.

    Returns
    -------
    xarray.Dataset
        The result has the dim radius, in cycles per pixel.
        ``predicted_power`` comes from coefficients of f and spectra of the sets.
        ``measured_power`` comes from f at the points of the sets.
        The interval of the measured power is ``measured_power_ci``. Both powers are in units of f².
        For white noise, the power at every frequency is the variance of a pixel.
        ``tail_term`` is the part of the prediction beyond the half width.
        If the part beyond the half width is large, the attribute ``note`` reports it.
        ``low_share`` ranks masks: it is the predicted power below 1/8 cycle per pixel.
        The unit of ``low_share`` is the mean power. White noise has a ``low_share`` of 1.

    Raises
    ------
    NoClosedForm
        If the spec of the sampler does not end in ``decorrelate`` with mode shift.
        Pixels share a spectrum only if the sampler ends in ``decorrelate``.
    ParameterError
        If the numbers of integrands and pixels differ, or there are over 3 dims.
        If there are too many frequencies or points.

    References
    ----------
    [GeorgievFajardo2016]_

    Examples
    --------
    >>> import mcspectra as mcs
    >>> for mask in ("white", "blue-noise"):
    ...     chain = f"jittered | decorrelate(mask={mask!r}, width=32)"
    ...     found = mcs.prediction.image_error_spectrum("gaussian(width=0.3)", chain, 4, dims=2)
    ...     print(mask, round(float(found["low_share"]), 1))
    white 0.9
    blue-noise 0.1
    """
    if half_width is not None:
        half_width = as_integer("half_width", half_width, least=1)
    images = as_integer("images", images, least=2)
    if max_evaluations is not None:
        max_evaluations = as_integer("max_evaluations", max_evaluations, least=1)
    several = isinstance(integrand, list | tuple) and len(integrand) > 0
    listed: Any = integrand if several else [integrand]
    functions = [as_integrand(each, dims) for each in listed]
    d = functions[0].dims
    source = as_sampler(sampler, d)
    last = (source.randomizations or (None,))[-1]
    if not isinstance(last, Decorrelate) or last.mode != "shift":
        raise NoClosedForm(
            f"The pixels of {source.spec} do not share a spectrum; end the sampler with "
            "decorrelate(mask=…), mode shift."
        )
    width, n = last.width, source.check_count(n)
    pixels = width * width
    if len(functions) not in (1, pixels) or any(f.dims != d or f.channels for f in functions):
        raise ParameterError(
            f"There are {len(functions)} integrands for {width} × {width} pixels; give one, or one "
            f"for each pixel, of one channel in {d} dims."
        )
    sizes = (len(functions) * (2 * (half_width or _SETTINGS.half_width) + 1) ** d, pixels * n)
    if d > _SETTINGS.most_dims or max(sizes) > _SETTINGS.most_values:
        raise ParameterError(
            f"{sizes[0]:,} coefficients in {d} dims and {sizes[1]:,} points are too many: the "
            f"limits are {_SETTINGS.most_dims} dims and {_SETTINGS.most_values:,} of each; lower ",
            Parameter("half_width"),
            ", n or the mask's width.",
        )

    stream = Stream.from_rng(rng)
    with counting("image_error_spectrum", max_evaluations) as tally:
        # Measure the error images. The prediction uses the same shared sets and shifts
        rings, integrals = Rings(width, width), np.array([f.integral for f in functions])
        sets, shifts = np.empty((images, n, d)), np.empty((images, pixels, d))
        measured = np.empty((images, rings.radius.size))
        for k in range(images):
            x = source.draw_stream(n, stream.child(k), 0, pixels)
            sets[k], shifts[k] = x[0], (x[:, 0] - x[0, 0]) % 1.0
            if len(functions) == 1:
                values = functions[0](x).mean(axis=1)
            else:
                values = np.array([f(own).mean() for f, own in zip(functions, x, strict=True)])
            measured[k] = rings.mean(_power(values - integrals, width))

        # Predict the images from coefficients without f_0.
        # Double the half width until the rest of ∫f² adds little to every band
        whole = np.array([float(square_integral(f)[0][0] - f.integral**2) for f in functions])
        exact = all(f.fourier_source == "exact" for f in functions)
        reach, grows = half_width or _SETTINGS.half_width, half_width is None and exact
        while True:
            known = np.stack([f.fourier_grid(reach) for f in functions])
            flat = known.reshape(len(functions), -1)
            flat[:, flat.shape[1] // 2] = 0.0
            energy = (np.abs(flat) ** 2).sum(axis=1)
            tail = float(np.maximum(whole - energy, 0.0).mean()) / n
            guessed = (_errors(known, *each) for each in zip(sets, shifts, strict=True))
            spectrum = np.mean([rings.mean(_power(each, width)) for each in guessed], axis=0) + tail
            beyond = tail / float(spectrum.min()) if tail else 0.0
            most = min(_SETTINGS.most_modes, _SETTINGS.most_values // len(functions))
            if not grows or beyond < _SETTINGS.lost or (4 * reach + 1) ** d > most:
                break
            reach *= 2
    tally.check()

    found = measured.mean(axis=0)
    half = half_interval(measured)
    weight = rings.sizes
    level = float(np.average(spectrum, weights=weight))
    note = (
        f"up to {beyond:.0%} of a band lies beyond half width {reach} and is treated as white "
        "between pixels, which is wrong for masks with an order (r2) and lattices; raise half_width"
    )
    low = rings.radius < _LOW
    share = float(np.average(spectrum[low], weights=weight[low])) / level if level else math.nan
    return dataset(
        {
            "predicted_power": (("radius",), spectrum),
            "measured_power": (("radius",), found),
            "measured_power_ci": (
                ("radius", "bound"),
                np.stack([np.maximum(found - half, 0.0), found + half], axis=-1),
            ),
            "tail_term": ((), tail),
            "low_share": ((), share),
        },
        {"radius": rings.radius, "bound": ["low", "high"]},
        sampler=source.spec,
        integrand=functions[0].spec if len(functions) == 1 else f"{pixels} integrands",
        n=n,
        half_width=reach,
        images=images,
        seed=stream.key,
        note=note if beyond > _SETTINGS.beyond else None,
    ).assign_attrs(evaluations=tally.made)


def _power(errors: Array, width: int) -> Array:
    """Return the power of an image over the frequencies of `numpy.fft.rfft2`."""
    return np.asarray(np.abs(np.fft.rfft2(errors.reshape(width, width))) ** 2 / width**2)


def _errors(known: Array, points: Array, shifts: Array) -> Array:
    """Return the errors Σ conj(f^p_m) S_m e^{−2πi m·δ_p} of all pixels."""
    import finufft

    d = points.shape[1]
    forward: Any = getattr(finufft, f"nufft{d}d1")
    back: Any = getattr(finufft, f"nufft{d}d2")
    # One thread: threads of transforms of this size wait for each other longer than they compute
    options: dict[str, Any] = {"eps": _SETTINGS.precision, "isign": -1, "nthreads": 1}
    ones = np.full(len(points), 1.0 / len(points), complex)
    shared = forward(*np.ascontiguousarray(2 * np.pi * points.T), ones, known.shape[1:], **options)
    places = np.ascontiguousarray(2 * np.pi * shifts.T)
    if len(known) == 1:
        found = back(*places, np.conj(known[0]) * shared, **options)
        return np.asarray(found.real)
    phases = np.exp(-1j * places[..., None] * (np.arange(known.shape[1]) - known.shape[1] // 2))
    terms = np.conj(known) * shared
    for phase in phases:  # Sum over the frequencies along one axis
        terms = np.einsum("pm,pm...->p...", phase, terms)
    return np.asarray(terms.real)
