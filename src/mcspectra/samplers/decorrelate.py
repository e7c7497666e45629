"""One point set for all pixels of an image, moved in each by white noise, a dither mask or R2."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import _kernels
from mcspectra.samplers._repeated import repeated
from mcspectra.samplers.base import Randomization, Sampler, Structure
from mcspectra.samplers.randomizations import Shift

__all__ = ["Decorrelate"]

_BELOW_ONE = 1.0 - 2.0**-53
_MASK_KEY = 0x3A5C  # any number: the mask is the same for everybody, its place is not
_MODES = ("shift", "digital-shift", "owen")


@final
@dataclass(frozen=True, kw_only=True)
class Decorrelate(Randomization):
    """Decorrelate pixels: all share one realisation of the sampler, each with its own shift.

    Realisation r is pixel (r mod width, r div width) of an image.

    Attributes
    ----------
    mode
        Randomisation of the shared set in a pixel: ``"shift"``, ``"digital-shift"`` or ``"owen"``.
    mask
        Source of its random numbers. ``"white"``: independent in all pixels.
        ``"blue-noise"``: a void-and-cluster dither mask, repeated, at a random place for each
        dim, so that neighbours get very different shifts and the error of the image is blue noise.
        ``"r2"``: the R-sequence of Roberts by the number of the pixel, from a random start.
    width
        Width of the image, and side of the blue-noise mask.

    Notes
    -----
    The realisations of one seed are the pixels of one image: they share a set, and with a mask their
    shifts too are those of one pattern. Variances over them are those within an image, and do not
    tend to those over seeds.

    Masks hold numbers, one for each dim: for shift, and for digital-shift in base 2. In one pixel
    every point is uniform whatever the mask. Over the width² pixels of a blue-noise mask, the
    shifts of each dim take each width²-th of [0,1) once.

    References
    ----------
    Georgiev, Fajardo (2016), "Blue-noise dithered sampling", doi 10.1145/2897839.2927430;
    Roberts (2018), "The unreasonable effectiveness of quasirandom sequences",
    extremelearning.com.au.
    """

    name: ClassVar[str] = "decorrelate"
    pointwise: ClassVar[bool] = True
    fits: ClassVar[Mapping[Structure, Structure]] = Shift.fits
    stationary: ClassVar[bool] = False
    debiases: ClassVar[bool] = True
    mode: str = "shift"
    mask: str = "white"
    width: int = 64

    def __post_init__(self) -> None:
        as_choice("mode", self.mode, _MODES)
        as_choice("mask", self.mask, ("white", "blue-noise", "r2"))
        width = as_integer("width", self.width, least=1, most=256)
        object.__setattr__(self, "width", width)
        object.__setattr__(self, "fits", self._step().fits)
        object.__setattr__(self, "stationary", self.mode == "shift")
        object.__setattr__(self, "independent", self.mask == "white")
        if self.mode == "owen" and self.mask != "white":
            raise ParameterError(
                f"mask is {self.mask!r}, but mode='owen' needs many random numbers for each dim and a "
                "mask gives one; use mask='white' or mode='shift'."
            )

    def fit(self, sampler: Sampler) -> Randomization:
        """Refuse samplers that the mode refuses, and masks for digits in other bases."""
        Randomization.fit(self, sampler)
        self._step().fit(sampler)
        others = set(sampler.digit_bases) - {2}
        if self.mode == "digital-shift" and self.mask != "white" and others:
            raise ParameterError(
                f"mask={self.mask!r} shifts binary digits, but {sampler.spec} has digits in base "
                f"{min(others)}; use mask='white' or mode='shift'."
            )
        return self

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Move each of `points`, given for each pixel, by the shift of its pixel."""
        return self._moved(self._step(), points, stream, first)

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        """Draw realisation 0 of `sampler` once and move it in each pixel."""
        shared = repeated(sampler.draw_stream(n, stream, 0, 1)[0], count)
        return self._moved(self._step().fit(sampler), shared, own, first)

    def counts_near(self, sampler: Sampler, n: int) -> tuple[int | None, int]:
        """Return the counts that the mode allows."""
        return self._step().fit(sampler).counts_near(sampler, n)

    def offsets(self, stream: Stream, first: int, count: int, dims: int) -> Array:
        """Return the masks' shifts of pixels first … first+count−1: float64 (count, dims)."""
        pixels = np.arange(first, first + count)
        places = stream.child(0).uniforms(0, 1, 2 * dims)[0]
        if self.mask == "r2":
            return _golden_offsets(pixels, places[:dims])
        inside = stream.uniforms(first, count, dims)
        return _blue_offsets(pixels, self.width, places.reshape(2, dims), inside)

    def _moved(self, step: Randomization, points: Array, stream: Stream, first: int) -> Array:
        if self.mask == "white":
            return step.apply(points, stream, first)
        count, _, dims = points.shape
        offsets = self.offsets(stream, first, count, dims)
        if self.mode == "digital-shift":
            words = (points * 2.0**53).astype(np.uint64)
            words ^= (offsets * 2.0**53).astype(np.uint64)[:, None]
            return np.asarray(words * 2.0**-53)
        out = np.empty(points.shape)
        _kernels.translate(points, offsets, out)
        return out

    def _step(self) -> Randomization:
        from mcspectra.samplers.registry import RANDOMIZATIONS

        step: Randomization = RANDOMIZATIONS.load(self.mode)()
        return step


def _golden_offsets(pixels: Array, starts: Array) -> Array:
    """Points `pixels` of the R-sequence from the `starts` (d,): (P, d)."""
    from mcspectra.samplers.kronecker import golden_steps

    steps = golden_steps(len(starts))
    units = (starts * 2.0**53).astype(np.uint64) << np.uint64(11)
    sums = units + pixels.astype(np.uint64)[:, None] * steps  # modulo 2^64
    return np.asarray((sums >> np.uint64(11)) * 2.0**-53)


def _blue_offsets(pixels: Array, width: int, places: Array, inside: Array) -> Array:
    """Ranks of the mask at `pixels` (P,), moved by `places` (2, d), `inside` (P, d) added: (P, d)."""
    columns = pixels[:, None] % width + (places[0] * width).astype(np.int64)
    rows = pixels[:, None] // width % width + (places[1] * width).astype(np.int64)
    ranks = _mask(width)[rows % width, columns % width]
    return np.asarray(np.minimum((ranks + inside) / width**2, _BELOW_ONE))


@lru_cache(maxsize=4)
def _mask(width: int) -> Array:
    from mcspectra.samplers.dither import dither_mask

    return dither_mask(width, Stream(_MASK_KEY).keys(0, 1)[0])
