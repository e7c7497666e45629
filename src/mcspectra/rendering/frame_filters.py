"""Linear filters of frames, and the variance that remains after them.

Let P_err(ν) be the power spectrum of the errors, and K(ν) the transform of a filter.
The filtered errors then have the variance ∫ |K(ν)|² P_err(ν) dν.
By Parseval's theorem this is Σ_d h(d) C(d), a sum over the lags d between two pixels.
Here C(d) is the covariance of the errors of two pixels at a lag d, averaged over the image.
The numbers h(d) are the autocorrelation of the filter's weights, with the transform |K(ν)|².
The covariances use pairs inside the image: every pair counts once, without wrap-around.
Near a border of the image, a filter repeats the border pixels, which changes its weights.
Therefore h(d) is the mean autocorrelation over all pixels, those near the border included.
If pixels near the border have another variance, `SpatialPower.uneven` corrects the sum.

Filters in space are separable, with the same weights along rows and columns.
Filters in time act on the frames of a sequence, such as ``ema``, the exponential moving average.
A chain such as ``gaussian(sigma=1.5) | ema(alpha=0.1)`` applies its filters one after another.
"""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z, deviations_t, student_t
from mcspectra.core.display import shown
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import real, whole
from mcspectra.core.registry import Registry, classes_of
from mcspectra.core.spec import Component, parse_chain

__all__ = [
    "FILTERS",
    "Chain",
    "Filter",
    "Filtered",
    "SpatialPower",
    "chains_of",
    "curve_filters",
    "filtered_of",
]

_REACH = 4.0  # number of standard deviations at which a Gaussian is cut, as in scipy.ndimage
_FORGOTTEN = 1e-6  # older frames are left out once their total weight is below this
_SIGMAS = (0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0)
_ALPHAS = (0.5, 0.3, 0.2, 0.1, 0.05)


class Filter(Component, ABC):
    """A linear filter of frames, in space or in time.

    Attributes
    ----------
    temporal
        Whether the filter acts along the frames of a sequence, not on the pixels of a frame.
    """

    temporal: ClassVar[bool] = False

    @abstractmethod
    def weights(self) -> Array:
        """Return the weights along one axis; their sum is 1."""

    def passes(self) -> list[Array]:
        """Return the weights of each pass over the image; the filter is their product."""
        return [self.weights()]

    def response(self, frequency: Array) -> Array:
        """Return K(ν) along one axis, for frequencies in cycles per pixel or per frame.

        Filters in space are centered at a pixel. Filters in time use this frame and older frames.
        """
        weights = self.weights()
        steps = np.arange(weights.size) - (0.0 if self.temporal else (weights.size - 1) / 2)
        return np.asarray(np.exp(-2j * np.pi * np.multiply.outer(frequency, steps)) @ weights)

    def transfer(self, frequency: Array) -> Array:
        """Return |K(ν)|² along one axis, for frequencies in cycles per pixel or per frame."""
        return np.asarray(np.abs(self.response(frequency)) ** 2)


@final
@dataclass(frozen=True, kw_only=True)
class Gaussian(Filter):
    """Gaussian of standard deviation `sigma` pixels, cut at 4σ as in scipy.ndimage."""

    sigma: float = real(least=0.1, most=100.0)

    def weights(self) -> Array:
        reach = int(_REACH * self.sigma + 0.5)
        weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / self.sigma) ** 2)
        return np.asarray(weights / weights.sum())


@final
@dataclass(frozen=True, kw_only=True)
class Box(Filter):
    """Mean over a square of `width` × `width` pixels."""

    width: int = whole(least=1, most=1000)

    def weights(self) -> Array:
        return np.full(self.width, 1.0 / self.width)


@final
@dataclass(frozen=True, kw_only=True)
class ATrous(Filter):
    """À-trous wavelet filter of `levels` levels of the B3 spline, without edge stops.

    Level k spaces the weights (1, 4, 6, 4, 1) / 16 by 2^k pixels [Dammertz2010]_.
    Denoisers of real-time renderers add edge stops to this filter, which only reduce its reach.
    """

    name = "a-trous"
    levels: int = whole(least=1, most=10)

    def weights(self) -> Array:
        return functools.reduce(np.convolve, self.passes())

    def passes(self) -> list[Array]:
        found = []
        for level in range(self.levels):
            spline = np.zeros(4 * 2**level + 1)
            spline[:: 2**level] = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
            found.append(spline)
        return found


@final
@dataclass(frozen=True, kw_only=True)
class Ema(Filter):
    """Exponential moving average over frames: the new frame has the weight `alpha`.

    After many frames, the filter multiplies the variance of the errors by a constant factor.
    If errors that are k frames apart have the correlation ρ^k, the factor is
    α/(2 − α) · (1 + q)/(1 − q), with q = ρ (1 − α).
    """

    temporal = True
    alpha: float = real(least=0.001, most=1.0)

    def weights(self) -> Array:
        old = 1.0 - self.alpha
        count = 1 if old == 0.0 else math.ceil(math.log(_FORGOTTEN) / math.log(old)) + 1
        weights = self.alpha * old ** np.arange(count)
        return np.asarray(weights / weights.sum())


FILTERS = Registry(
    "filter",
    "mcspectra.filters",
    classes_of({"rendering.frame_filters": "a-trous=ATrous Box Ema Gaussian"}),
    base=Filter,
)
"""Filters of frames that spec strings can name."""


@final
@dataclass(frozen=True)
class Chain:
    """A product of filters in space and in time.

    Attributes
    ----------
    filters
        Filters in any order; the order does not change their product.
    """

    filters: tuple[Filter, ...]

    @property
    def spec(self) -> str:
        """The spec string of the chain."""
        return " | ".join(each.spec for each in self.filters)

    @property
    def temporal(self) -> bool:
        """Whether the chain has a filter in time."""
        return any(each.temporal for each in self.filters)

    @functools.cached_property
    def space(self) -> Array:
        """Weights of the pixels along one axis, of all filters in space together."""
        return _product(each for each in self.filters if not each.temporal)

    @property
    def passes(self) -> list[Array]:
        """Weights of each pass over the image, of all filters in space."""
        return [w for each in self.filters if not each.temporal for w in each.passes()]

    @functools.cached_property
    def time(self) -> Array:
        """Weights of the frames, the newest first, of all filters in time together."""
        return _product(each for each in self.filters if each.temporal)

    def memory(self, count: int) -> tuple[Array, float]:
        """Return autocorrelations h(k) of the weights of frames, for lags k < count.

        Also return the sum of h(k) over all larger lags k, positive and negative.
        """
        lags = np.correlate(self.time, self.time, "full")[self.time.size - 1 :]
        whole = lags[:count]
        beyond = 2.0 * float(lags[count:].sum())
        return np.pad(whole, (0, count - whole.size)), beyond


def _product(filters: object) -> Array:
    weights = np.ones(1)
    for each in filters:  # type: ignore[attr-defined]
        weights = np.convolve(weights, each.weights())
    return weights


def chains_of(filters: object) -> list[Chain]:
    """Return filters from spec strings.

    Parameters
    ----------
    filters
        A spec such as ``"gaussian(sigma=1.5) | ema(alpha=0.1)"``, or a sequence of specs.

    Raises
    ------
    ParameterError
        If `filters` is not text or a sequence of texts, or a parameter is out of range.
    SpecError
        If a spec cannot be read.
    UnknownName
        If no filter has a given name.
    """
    given = [filters] if isinstance(filters, str) else filters
    if not isinstance(given, Sequence) or not all(isinstance(each, str) for each in given):
        raise ParameterError(
            f"filters is {shown(filters)}; give specs such as 'gaussian(sigma=1.5)'."
        )
    found = [Chain(tuple(FILTERS.build(call) for call in parse_chain(each))) for each in given]
    return list({each.spec: each for each in found}.values())


def curve_filters(height: int, width: int, times: int) -> dict[str, dict[float, Chain]]:
    """Return filters for plotted curves: Gaussians that fit in the image, and moving averages."""
    side = min(height, width)
    gaussians = (Gaussian(sigma=sigma) for sigma in _SIGMAS)
    found = {"sigma": {g.sigma: Chain((g,)) for g in gaussians if 2 * g.weights().size <= side}}
    if times > 1:
        # Leave out filters whose weights reach far beyond the length of the sequence.
        # Correlations of errors at lags beyond the end of the sequence are unknown
        known = (a for a in _ALPHAS if (1 - a) ** times < _LEFT_OUT)
        found["alpha"] = {alpha: Chain((Ema(alpha=alpha),)) for alpha in known}
    return {name: chains for name, chains in found.items() if len(chains) > 1}


_LEFT_OUT = 0.1  # largest total weight before a sequence's first frame, for plotted filters


@final
class SpatialPower:
    """Variance that remains after filters in space, from the transform of an image of errors.

    Attributes
    ----------
    shape
        Size of the transform: the image with a margin of zeros, so that no lag wraps around.
    """

    def __init__(self, chains: Sequence[Chain], height: int, width: int) -> None:
        from scipy.fft import next_fast_len

        reach = max((each.space.size for each in chains), default=1)
        for each in chains:
            if each.space.size > min(height, width):
                raise ParameterError(
                    f"The filter {each.spec} covers {each.space.size} pixels, but the frames have "
                    f"{height} × {width}; give a narrower filter."
                )
        self.chains, self.size = tuple(chains), (height, width)
        self.shape = (next_fast_len(height + reach, True), next_fast_len(width + reach, True))
        self.down = np.array([_response(c, height, self.shape[0]) for c in chains])
        half = np.array([_response(c, width, self.shape[1]) for c in chains])
        across = self.shape[1] // 2 + 1
        # The transform has no negative column frequencies, so positive ones count twice
        both = np.full(across, 2.0)
        both[0] = 1.0
        if self.shape[1] % 2 == 0:
            both[-1] = 1.0
        self.across = half[:, :across] * both
        self.doubled = both
        self._scale = 1.0 / (math.prod(self.shape) * height * width)

    def transform(self, error: Array) -> Array:
        """Return the transform of errors (y, x), with the margin of zeros."""
        from scipy.fft import rfft2

        return np.asarray(rfft2(error, s=self.shape))

    def left(self, power: Array, rows: slice = slice(None)) -> Array:
        """Return the variance after each filter, from |transform|² (…, y, x) at some rows."""
        inner = power @ self.across.T  # (…, y, filter)
        return np.asarray(np.einsum("...yf,fy->...f", inner, self.down[:, rows]) * self._scale)

    def uneven(self, variance: Array) -> Array:
        """Return the factor of `left` that is due to uneven variances of the pixels, (filter,).

        A pixel near the border has other weights than a pixel inside the image.
        The factor is exact for white noise that has the given variances of pixels (y, x).
        """
        height, width = variance.shape
        factors = []
        for chain in self.chains:
            down, across = (_squares(chain, each) for each in (height, width))
            seen = down @ variance @ across / (down.sum() * across.sum())
            factors.append(float(seen / variance.mean()))
        return np.array(factors)

    @property
    def white(self) -> Array:
        """Variance that each filter in space leaves of white noise of variance 1, (filter,)."""
        height, width = self.size
        return np.array(
            [_squares(c, height).mean() * _squares(c, width).mean() for c in self.chains]
        )

    def noise(self, power: Array) -> Array:
        """Return the squared standard error of `left` for one image of normal errors."""
        inner = (power**2) @ (self.across**2 / self.doubled).T
        total = np.einsum("yf,fy->f", inner, self.down**2)
        # Power is exponentially distributed: its mean square is twice its squared mean.
        # A frequency and its opposite have equal power, which doubles the variance.
        # The margin of zeros samples the spectrum more densely, but adds no independent values
        dense = math.prod(self.shape) / math.prod(self.size)
        return np.asarray(total * self._scale**2 * dense)


@final
@dataclass(frozen=True, kw_only=True)
class Filtered:
    """Variance that remains after filters, as a mean over the pixels.

    Attributes
    ----------
    variance, variance_ci
        Variance after each filter (filter,), and its 95 % interval (filter, bound).
    ratio, ratio_ci
        Variance after each filter, divided by the value for white noise of the same strength.
    half
        Half width of the interval of ln(`variance`), (filter,).
    """

    specs: tuple[str, ...]
    variance: Array
    variance_ci: Array
    ratio: Array
    ratio_ci: Array
    half: Array


def filtered_of(
    chains: Sequence[Chain],
    left: Array,
    noise: Array,
    uneven: Array,
    white: Array,
    scale: float,
    resolved: bool,
) -> Filtered:
    """Return the variance after each chain of filters, with intervals from the spread of sequences.

    Parameters
    ----------
    chains
        Chains of filters; the first leaves frames unchanged.
    left
        Covariance at each lag in frames after the filters in space, (sequence, filter, lag).
    noise
        Squared standard error of `left` at lag 0 for one image of normal errors, (filter,).
    uneven
        Factor due to uneven variances of pixels; see `SpatialPower.uneven`, (filter,).
    white
        Variance that the filters in space leave of white noise of variance 1, (filter,).
    scale
        Factor that corrects for subtracted means and for missing pixels.
    resolved
        Whether the variance has an upper bound; otherwise the intervals have no upper end.
    """
    count, _, times = left.shape
    values = np.empty((count, len(chains)))
    least, more = np.empty(len(chains)), np.zeros(len(chains))
    for k, chain in enumerate(chains):
        memory, rest = chain.memory(times)
        own = left[:, k]
        values[:, k] = scale * (2.0 * own @ memory - own[:, 0] * memory[0])
        mean = own.mean(axis=0)
        # Number of independent frames whose mean square is as accurate as that of the sequence
        filtered = np.convolve(_mirrored(memory), _mirrored(mean), "same")
        fade = 1.0 - np.abs(np.arange(1 - times, times)) / times
        relative = filtered / (filtered[times - 1] or 1.0)
        frames = float(np.clip(times / max((fade * relative**2).sum(), 1e-12), 1.0, times))
        least[k] = noise[k] / max(mean[0], 1e-300) ** 2 / ((count - 1) * frames)
        if rest > 0 and times > 1:
            # The correlations at lags longer than the sequence are unknown.
            # Assume that unknown correlations do not exceed those at the last quarter of known lags
            late = own[:, 3 * times // 4 :].mean(axis=1)
            most = float(late.mean()) + student_t(count) * float(late.std(ddof=1)) / count**0.5
            more[k] = scale * rest * max(most, 0.0)
    values, more = values * uneven, more * uneven
    variance = values.mean(axis=0)
    known = np.where(variance > 0, variance, np.nan)
    factor, floor = deviations_t(count) / math.sqrt(count), CONFIDENCE_Z * np.sqrt(least)
    half = np.fmax(factor * values.std(axis=0, ddof=1) / known, floor)
    apart = (values / known - values[:, :1] / known[0]).std(axis=0, ddof=1)
    ratio_half = np.fmax(factor * apart, floor)
    time = np.array([(chain.time**2).sum() for chain in chains])
    white = white * time * uneven * variance[0]
    beyond = 1.0 + more / known
    open_end = 1.0 if resolved else np.inf

    def ends(value: Array, width: Array) -> Array:
        high = value * np.exp(width) * beyond * open_end
        return np.stack([value * np.exp(-width), high], axis=-1)

    return Filtered(
        specs=tuple(chain.spec for chain in chains),
        variance=variance,
        variance_ci=ends(variance, half),
        ratio=variance / white,
        ratio_ci=ends(variance / white, ratio_half),
        half=np.asarray(half + np.log(beyond)),
    )


def _mirrored(lags: Array) -> Array:
    return np.concatenate([lags[:0:-1], lags])


def _response(chain: Chain, size: int, length: int) -> Array:
    """Return |K(ν)|² at the frequencies of a transform, corrected for the number of pixel pairs.

    An image of N pixels along an axis has N − |d| pairs at a lag d, of which the mean is taken.
    The sum Σ_x Σ_y K(x, y) K(x, y + d) is therefore divided by N − |d|.
    """
    sums = np.correlate(chain.space, chain.space, "full")[chain.space.size - 1 :][:size]
    ends = _ends(chain, size)
    products = ends.T @ ends
    known = np.array([np.trace(products, lag) for lag in range(min(len(ends), sums.size))])
    # Pixels inside the image add the autocorrelation of the weights
    sums = sums[: known.size] * (size - len(ends)) + known
    lags = np.arange(sums.size)
    row = np.zeros(length)
    row[lags] = row[-lags] = sums / (size - lags)
    return np.asarray(np.fft.fft(row).real)


def _squares(chain: Chain, size: int) -> Array:
    """Return Σ_x K(x, y)² for each pixel y along an axis of `size` pixels."""
    squares = (_ends(chain, size) ** 2).sum(axis=0)
    half = len(squares) // 2
    inside = np.full(size - len(squares), float((chain.space**2).sum()))
    return np.concatenate([squares[:half], inside, squares[half:]])


def _ends(chain: Chain, size: int) -> Array:
    """Return K(x, y), the weight of pixel y in the filtered pixel x, along an axis.

    Each pass repeats the first and the last pixel beyond the ends, as ``nearest`` in scipy.
    A long axis is shortened: pixels inside the image all have the same weights.
    """
    size = min(size, 4 * chain.space.size)
    matrix = np.eye(size)
    for weights in chain.passes:
        x, step = np.indices((size, weights.size))
        own = np.zeros((size, size))
        np.add.at(own, (x, np.clip(x + step - weights.size // 2, 0, size - 1)), weights[step])
        matrix = own @ matrix
    return matrix
