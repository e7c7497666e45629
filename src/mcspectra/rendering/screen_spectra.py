"""The error of an image sequence before rendering: spectra of masks over space and time.

Let f be an integrand with integral I, and u_i(x, y, t) the points of a pixel and frame.
The error of the pixel is e(x, y, t) = (1/n) Σ_i f(u_i(x, y, t)) − I.
The power of the error, P_err(ν_y, ν_x, ν_t), is its squared Fourier transform over a block.
A block is a rectangle of pixels in some frames.
A linear filter K, in space or in time, leaves the mean squared error ∫ |K(ν)|² P_err(ν) dν.
The slides that this package reproduces have the same integral for the variance of an estimate.
In the slides, the integrand f takes the place of the filter K.

The power is normalized: for white noise it equals the mean squared error of a pixel.

The transform treats a block as periodic, which is right for masks that repeat within the block.
If the points do not repeat, filtered errors count only where the filter stays inside the block.
Spectra of points that do not repeat are computed from blocks with a Hann taper.
Without a taper, 1 % of the power of blue noise would move to low frequencies,
because blocks of 64 × 64 pixels end abruptly at their border.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from mcspectra.core.checks import Array, as_instance, as_integer, as_real
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.images import Rings
from mcspectra.core.progress import report
from mcspectra.core.results import dataset
from mcspectra.core.spec import short_spec
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators.quadrature import square_integral
from mcspectra.integrands import Integrand, as_integrand
from mcspectra.rendering.frame_filters import Ema, Gaussian
from mcspectra.rendering.screen_samplers import ScreenBlock, ScreenSampler, as_screen_sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["FILTERS", "ScreenSpectrumSettings", "screen_spectrum"]


@final
@dataclass(frozen=True, kw_only=True)
class ScreenSpectrumSettings:
    """Limits that `screen_spectrum` uses for block sizes, low frequencies, tapers and filters.

    Attributes
    ----------
    most_values
        Largest number of pixels of a block in all frames (128 MiB of complex numbers).
    most_points
        Largest number of evaluations of the integrand, for all samplers and seeds.
        A million evaluations of a built-in integrand take about 20 ms.
    low
        Frequencies below this limit are low, in cycles per pixel and in cycles per frame.
        The eye does not blur noise with less than 1/8 cycle per pixel.
    least_tapered
        Axes with fewer pixels or frames are not tapered:
        a taper over 8 values would leave no low frequencies.
    reach, cut
        Only pixels at least 4 σ away from the border of the block are used.
        Beyond 4 σ, the Gaussian has the weight 6e-5 in one dim: errors change by less than 2.5e-4.
    remembered
        Largest weight that a moving average over frames may give to frames before the block.
        A moving average is not used if the weight of these earlier frames is larger.
        If the points repeat within the block, all moving averages are used.
        If errors are correlated in time, a weight of 0.5 % for frames before the block
        changes the variance of the average by about 0.5 %.
    """

    most_values: int = 2**23
    most_points: int = 2**31
    low: float = 0.125
    least_tapered: int = 8
    reach: float = 4.0
    cut: float = 2.5e-4
    remembered: float = 0.005


_SETTINGS = ScreenSpectrumSettings()

FILTERS = ("none", "gaussian", "ema", "both")
"""Filters in the results: no filter, in space, in time, and both together."""


def screen_spectrum(
    samplers: Any,
    integrand: Integrand | str,
    n: int,
    *,
    dims: int | None = None,
    block: Sequence[int] = (64, 64, 128),
    seeds: int = 8,
    sigma: float = 1.5,
    alpha: float = 0.1,
    rng: RngLike = 0,
) -> xr.Dataset:
    """Rank masks and screen-space samplers by the error after filters, before any rendering.

    Parameters
    ----------
    samplers
        One screen-space sampler, or a list of screen-space samplers.
        Accepted types are described in `mcspectra.rendering.as_screen_sampler`.
    integrand
        Integrand of every pixel, with one channel.
    n
        Number of points per pixel and frame.
    dims
        Number of dims, if the spec of the integrand does not fix it.
    block
        Width and height in pixels, and number of frames. One frame has no time axis.
    seeds
        Number of independent blocks of each sampler, at least 2.
    sigma
        Width of the Gaussian filter in pixels.
    alpha
        Weight of the newest frame in the exponential moving average (EMA) over frames.
    rng
        Seed of the random numbers, as defined by SPEC 7 of Scientific Python.

    Returns
    -------
    xarray.Dataset
        By sampler, frequency and radius: ``error_power``, the power P_err in units of f².
        Frequencies are in cycles per frame, and radii in cycles per pixel.
        ``relative_power`` is the power over the mean squared error of a pixel, 1 for white noise.
        By sampler: ``pixel_error``, the mean squared error of a pixel, with ``pixel_error_ci``.
        ``low_share`` is the mean relative power below 1/8 cycle per pixel, 1 for white noise.
        ``slow_share`` is the mean relative power below 1/8 cycle per frame, 1 for white noise.
        By sampler and filter: ``filtered_error``, the mean squared error after a filter.
        ``filtered_ratio`` is the filtered error divided by the filtered error of random points.
        The intervals ``filtered_ratio_ci`` have 95 % confidence for all samplers together.
        By filter: ``best``, the index of the best sampler, or −1 if intervals overlap.
        ``error_image(sampler, y, x)`` is frame 0 of the first block.
        ``error_slice(sampler, frame, x)`` is row 0 of all frames of the first block.
        ``blocks`` is the number of independent blocks. The attribute ``note`` has warnings.

    Raises
    ------
    ParameterError
        If an option is out of range, or the integrand is constant.
        If the integrand has several channels or an infinite variance.
        If the block is too large, or two samplers have the same name.
    McspectraError
        If a sampler cannot be created, or cannot make the points.

    Notes
    -----
    Confidence intervals are computed from blocks with independent seeds.
    A file with a mask has no seeds; different parts of the mask are different blocks.
    If a block contains the whole mask, its numbers are exact, and their intervals have width 0.
    If only one block exists and it is not the whole mask, intervals are unknown (NaN).
    The filters are ``gaussian`` and ``ema`` of `mcspectra.rendering.frames`.
    If the points do not repeat in space, pixels within 4 σ of the border of the block are not used.
    If the points do not repeat in time, the first frames of the block are not used:
    in these frames, the EMA gives more than 0.5 % weight to frames before the block.

    References
    ----------
    [Wolfe2022]_, [GeorgievFajardo2016]_

    Examples
    --------
    >>> import mcspectra as mcs
    >>> masks = ["random", "sobol | decorrelate(mask='spatiotemporal', width=32)"]
    >>> found = mcs.rendering.screen_spectrum(masks, "gaussian(width=0.3)", 1, block=(32, 32, 64))
    >>> [round(float(v), 2) for v in found["filtered_ratio"].sel(filter="both")]
    [0.95, 0.14]
    """
    n = as_integer("n", n, least=1)
    seeds = as_integer("seeds", seeds, least=2, most=4096)
    sigma = as_real("sigma", sigma, least=0.1, most=100.0)
    alpha = as_real("alpha", alpha, least=0.001, most=1.0)
    place = _as_block(block)
    f = as_integrand(integrand, dims)
    if f.channels:
        raise ParameterError(f"{f.spec} has {f.channels} channels; give an integrand of one.")
    many = isinstance(samplers, list | tuple) and not isinstance(samplers, str)
    sources = [as_screen_sampler(each, f.dims) for each in (samplers if many else [samplers])]
    names = _names(sources)
    points = len(sources) * seeds * place.size * n
    if points > _SETTINGS.most_points:
        raise ParameterError(
            f"{len(sources)} samplers × {seeds} seeds × {place.size:,} pixels × {n} points are "
            f"{points:,} evaluations, more than {_SETTINGS.most_points:,}; use a smaller ",
            Parameter("block"),
            ".",
        )
    for source in sources:
        source.check(n, place, seeds)
    white = (float(square_integral(f)[0][0]) - float(f.integral) ** 2) / n
    if not 1e-24 * float(f.integral) ** 2 < white < math.inf:
        kind = "an infinite variance" if white > 0 else "no variance"
        raise ParameterError(f"{f.spec} has {kind}; give another integrand.")

    # Measure the power of each block. Powers and errors of a sampler are means over its blocks
    stream, rings = Stream.from_rng(rng), Rings(place.height, place.width)
    gains = _gains(place, sigma, alpha)
    low, slow = _low_frequencies(place)
    found: dict[str, list[Any]] = {name: [] for name in _SHAPES}
    counts, exact, forgetful = [], [], list[str]()
    for k, source in enumerate(sources):
        blocks, whole = source.blocks(place, seeds)
        repeats = source.repeats(n, place)
        taper, (used, short) = _taper(place, repeats), _used(place, repeats, sigma, alpha)
        # Filtered errors may be wrong by this fraction, because filters are cut at the border
        cut = np.array([any(each != slice(None) for each in part[1:]) for part in used])
        late = np.array([part[0] != slice(None) for part in used])
        slack = np.concatenate([[0.0], _SETTINGS.cut * cut + _SETTINGS.remembered * late])
        if short:
            forgetful.append(names[k])
        powers, sums = [], []
        for seed in range(blocks):
            report("screen", (k + seed / blocks) / len(sources))
            values = np.empty((place.frames, place.height, place.width))
            own = stream.child(seed)
            for t, frame in enumerate(source.frames_of(n, place, seed, own)):
                values[t] = f(frame).mean(axis=-1)
            errors = values - float(f.integral)
            transform = np.fft.rfftn(errors)
            tapered = transform if taper is None else np.fft.rfftn(errors * taper)
            power = np.abs(tapered) ** 2 / place.size
            filtered = [float(np.mean(errors**2))]
            for gain, part in zip(gains, used, strict=True):
                left = np.fft.irfftn(transform * gain, s=errors.shape, axes=(0, 1, 2))
                filtered.append(float(np.mean(left[part] ** 2)))
            shares = [_share(power, place.width, part) for part in (low, slow)]
            powers.append(_over_rings(power, rings))
            sums.append([*filtered, *shares])
            if seed == 0:
                found["error_image"].append(errors[0])
                found["error_slice"].append(errors[:, 0])
        table, spectra = np.array(sums), np.array(powers)
        mean = table[:, : len(FILTERS)].mean(axis=0)
        ends = _interval(table[:, : len(FILTERS)], whole, len(sources), slack)
        found["filtered_error"].append(mean)
        # Random points give white noise: a filter multiplies it by the sum of its squared weights
        level = white * np.array([_white_gain(name, sigma, alpha) for name in FILTERS])
        found["filtered_ratio"].append(mean / level)
        found["filtered_ratio_ci"].append(ends / level[:, None])
        found["pixel_error"].append(mean[0])
        found["pixel_error_ci"].append(_interval(table[:, :1], whole, 1)[0])
        for j, share in enumerate(("low_share", "slow_share"), len(FILTERS)):
            found[share].append(table[:, j].mean())
            found[f"{share}_ci"].append(_interval(table[:, j : j + 1], whole, 1)[0])
        found["error_power"].append(spectra.mean(axis=0))
        found["relative_power"].append(spectra.mean(axis=0) / (mean[0] or math.nan))
        found["blocks"].append(blocks)
        counts.append(blocks)
        exact.append(whole)
    report("screen", 1.0)

    ends = np.array(found["filtered_ratio_ci"])
    best = [_best(ends[:, k]) for k in range(len(FILTERS))]
    variables = {name: (dims_of, np.array(found[name])) for name, dims_of in _SHAPES.items()}
    variables["best"] = (("filter",), np.array(best))
    return dataset(
        variables,
        {
            "sampler": names,
            "frequency": np.arange(place.frames // 2 + 1) / place.frames,
            "radius": rings.radius,
            "filter": list(FILTERS),
            "bound": ["low", "high"],
            "y": np.arange(place.height),
            "x": np.arange(place.width),
            "frame": np.arange(place.frames),
        },
        integrand=f.spec,
        n=n,
        block=list(place),
        seeds=seeds,
        sigma=sigma,
        alpha=alpha,
        white_variance=white,
        exact=[int(each) for each in exact],
        seed=stream.key,
        note=_note(names, counts, exact, forgetful, place, alpha),
    )


_OF_SAMPLER = ("sampler",)
_SHAPES: dict[str, tuple[str, ...]] = {
    "error_power": (*_OF_SAMPLER, "frequency", "radius"),
    "relative_power": (*_OF_SAMPLER, "frequency", "radius"),
    "pixel_error": _OF_SAMPLER,
    "pixel_error_ci": (*_OF_SAMPLER, "bound"),
    "low_share": _OF_SAMPLER,
    "low_share_ci": (*_OF_SAMPLER, "bound"),
    "slow_share": _OF_SAMPLER,
    "slow_share_ci": (*_OF_SAMPLER, "bound"),
    "filtered_error": (*_OF_SAMPLER, "filter"),
    "filtered_ratio": (*_OF_SAMPLER, "filter"),
    "filtered_ratio_ci": (*_OF_SAMPLER, "filter", "bound"),
    "error_image": (*_OF_SAMPLER, "y", "x"),
    "error_slice": (*_OF_SAMPLER, "frame", "x"),
    "blocks": _OF_SAMPLER,
}


def _as_block(given: Any) -> ScreenBlock:
    """Check the width, the height and the number of frames of a block, and return them."""
    as_instance("block", given, list | tuple, "width, height and number of frames")
    if len(given) != 3:
        raise ParameterError(
            Parameter("block"),
            f" has {len(given)} numbers; give width, height and number of frames.",
        )
    block = ScreenBlock(*(as_integer("block", each, least=1, most=2**16) for each in given))
    if block.size > _SETTINGS.most_values or min(block[:2]) < 4:
        raise ParameterError(
            f"A block of {block} is not allowed; use at least 4 × 4 pixels, and at most "
            f"{_SETTINGS.most_values:,} pixels in all frames, in ",
            Parameter("block"),
            ".",
        )
    return block


def _names(sources: Sequence[ScreenSampler]) -> list[str]:
    """Return a different name for each sampler."""
    if not sources:
        raise ParameterError("There are no samplers; give at least one.")
    names = [source.label for source in sources]
    short = list(map(short_spec, names))
    for name in names:
        if names.count(name) > 1:
            raise ParameterError(
                f"The sampler {short_spec(name)} is listed twice; list each sampler once, or give "
                "name= in its spec."
            )
    return names if len(set(short)) < len(short) else short


def _gains(block: ScreenBlock, sigma: float, alpha: float) -> list[Array]:
    """Return the transfer functions of the filters at the frequencies of `rfftn`."""
    blur, mean = Gaussian(sigma=sigma), Ema(alpha=alpha)
    down, across = np.fft.fftfreq(block.height)[:, None], np.fft.rfftfreq(block.width)
    space = (blur.response(down) * blur.response(across)).real[None]
    time = mean.response(np.fft.fftfreq(block.frames))[:, None, None]
    return [space, time, space * time]


def _used(
    block: ScreenBlock, repeats: tuple[bool, bool], sigma: float, alpha: float
) -> tuple[list[tuple[slice, ...]], bool]:
    """Return the part of a block in which filtered values depend only on values inside the block.

    The second value is True if the block is too short to omit its first frames.
    All frames of such a short block are used.
    """
    whole, steady = repeats
    edge = 0 if whole else math.ceil(_SETTINGS.reach * sigma)
    if min(block[:2]) < 2 * edge + 4:
        raise ParameterError(
            f"The block has {block.width} × {block.height} pixels, but the Gaussian reaches "
            f"{edge} pixels; use at least {2 * edge + 4}, or a smaller ",
            Parameter("sigma"),
            ".",
        )
    start, short = 0, False
    if not steady and alpha < 1.0 and block.frames > 1:
        start = math.ceil(math.log(_SETTINGS.remembered) / math.log1p(-alpha))
        short = start >= block.frames
    every = slice(None)
    inside = (slice(edge, -edge), slice(edge, -edge)) if edge else (every, every)
    later = slice(start, None) if start and not short else every
    return [(every, *inside), (later, every, every), (later, *inside)], short


def _white_gain(kind: str, sigma: float, alpha: float) -> float:
    """Return the sum of the squared weights of a filter.

    The filter multiplies the variance of white noise by this factor.
    """
    space = float((Gaussian(sigma=sigma).weights() ** 2).sum()) ** 2
    time = alpha / (2.0 - alpha)
    return {"none": 1.0, "gaussian": space, "ema": time, "both": space * time}[kind]


def _share(power: Array, width: int, part: Array) -> float:
    """Return the mean power over a part of the frequencies, divided by the mean over all."""
    across = np.arange(power.shape[-1])
    # Columns with positive frequencies count twice: also for the opposite frequencies
    both = np.broadcast_to(np.where((across > 0) & (2 * across < width), 2.0, 1.0), power.shape)
    weighted, whole = power * both, float(np.sum(power * both))
    if not whole:
        return math.nan
    return float(np.sum(weighted * part) / np.sum(both * part) * np.sum(both)) / whole


def _taper(block: ScreenBlock, repeats: tuple[bool, bool]) -> Array | None:
    """Return Hann windows with mean square 1, for the axes on which points do not repeat."""

    def window(size: int, steady: bool) -> Array:
        if steady or size < _SETTINGS.least_tapered:
            return np.ones(size)
        places = (np.arange(size) + 0.5) / size
        return np.asarray((1.0 - np.cos(2.0 * np.pi * places)) * math.sqrt(2.0 / 3.0))

    if all(repeats):
        return None
    whole, steady = repeats
    down, across = window(block.height, whole)[:, None], window(block.width, whole)
    return window(block.frames, steady)[:, None, None] * down * across


def _low_frequencies(block: ScreenBlock) -> tuple[Array, Array]:
    """Return masks of low frequencies in space and in time, in the order of `rfftn`."""
    down, across = np.fft.fftfreq(block.height)[:, None], np.fft.rfftfreq(block.width)
    low = np.hypot(down, across)[None] < _SETTINGS.low
    slow = np.abs(np.fft.fftfreq(block.frames))[:, None, None] < _SETTINGS.low
    return low, slow


def _over_rings(power: Array, rings: Rings) -> Array:
    """Return mean powers over rings in space, and over the two signs of each frequency in time."""
    flat = np.array([rings.mean(each) for each in power])
    return np.asarray((flat + flat[-np.arange(len(flat))])[: len(flat) // 2 + 1] / 2.0)


def _interval(values: Array, whole: bool, samplers: int, slack: Array | float = 0.0) -> Array:
    """Return 95 % intervals (k, 2) of means over blocks (blocks, k), for all samplers together.

    Student's t is applied to logarithms, as in `mcspectra.core.confidence.log_mean_interval`.
    Each interval is widened by the factor 1 + `slack`.
    """
    from scipy.special import stdtrit

    count, mean = len(values), values.mean(axis=0)
    if whole:
        return np.stack([mean, mean], axis=-1)
    if count < 2:
        return np.full((values.shape[1], 2), np.nan)
    # Šidák correction: the intervals of all samplers together have 95 % confidence
    level = 0.5 * (1.0 + 0.95 ** (1.0 / samplers))
    error = values.std(axis=0, ddof=1) / math.sqrt(count)
    relative = np.divide(error, mean, out=np.zeros_like(error), where=mean > 0)
    factor = np.exp(np.minimum(float(stdtrit(count - 1, level)) * relative, 700.0)) * (1.0 + slack)
    return np.stack([mean / factor, mean * factor], axis=-1)


def _best(ends: Array) -> int:
    """Return the sampler whose interval is below all other intervals (samplers, 2), or −1."""
    if len(ends) < 2 or not np.isfinite(ends).all():
        return -1
    first = int(np.argmin(ends[:, 1]))
    return first if ends[first, 1] < np.delete(ends[:, 0], first).min() else -1


def _note(
    names: Sequence[str],
    counts: Sequence[int],
    exact: Iterable[bool],
    forgetful: Sequence[str],
    block: ScreenBlock,
    alpha: float,
) -> str | None:
    """Return warnings about the results, or None."""
    notes = []
    alone = [
        name
        for name, count, whole in zip(names, counts, exact, strict=True)
        if count < 2 and not whole
    ]
    if alone:
        notes.append(
            f"{' and '.join(alone)}: only one block exists, so no interval is known; use seeds or "
            "smaller blocks"
        )
    if forgetful:
        left = (1.0 - alpha) ** block.frames
        notes.append(
            f"EMA {alpha:g} remembers {left:.0%} of the error {block.frames} frames earlier, so "
            f"errors after it hold for {' and '.join(forgetful)} only if the points repeat after "
            "the block; use more frames"
        )
    return "; ".join(notes) or None
