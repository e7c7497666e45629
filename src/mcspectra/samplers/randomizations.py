"""Randomizations that move all points of a set: shifts, rotations, mirror images, pixels.

A reflection is u → 1 − 2^-53 − u, because 1 − u would leave [0,1) for u = 0.
The reflection is one to one on multiples of 2^-53. The float64 points are multiples of 2^-53.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.cache import cached_array
from mcspectra.core.checks import BELOW_ONE, Array, as_real, as_reals
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import checked, choice, flag, settle, whole
from mcspectra.core.jit import kernel
from mcspectra.core.streams import Stream, mix_bits, mix_uniform
from mcspectra.samplers._kernels import translated
from mcspectra.samplers.base import MAX_COUNT, Randomization, Sampler, Structure, repeated
from mcspectra.samplers.law import (
    Folded,
    Independent,
    Law,
    Mirrored,
    Stationary,
    independent_sets,
    moved,
    shifted,
)

__all__ = ["Decorrelate", "Mirror", "RandomRotation", "Shift", "StrataShift", "folded"]

_MOST_IMAGED = 30  # largest number of dims of the uniform mode, which makes 2^d images
_MASK_KEY = 0x3A5C  # arbitrary seed of the dither mask; realizations shift the same mask at random
# Half the side of the first square window in which a rotated set is searched for n points.
# The window has the area 1.44, so it nearly always contains more than n of the repeated points.
_FIRST_REACH = 0.6
# Half the side of a window that always contains more than n points.
# A disk of radius √5/2 < 1.12 contains two copies of the domain, side by side.
_REACH = 1.12

# For each structure of a point set, the structure that is left after a randomization.
# A translation of the torus moves strata and elementary intervals away from the origin.
# A rotation preserves digits, but exchanges coordinates of different bases.
# Reflections map cells to cells, but images of points near a face lie close to each other.
_ALL: dict[Structure, Structure] = {s: s for s in Structure}
_TRANSLATED = _ALL | dict.fromkeys((Structure.STRATA, Structure.DIGITS), Structure.TORUS)
_TURNED = _ALL | {Structure.DIGITS: Structure.TORUS}
_IMAGES = _ALL | {Structure.TORUS: Structure.NONE}
_NOTHING = dict.fromkeys(Structure, Structure.NONE) | {Structure.UNKNOWN: Structure.UNKNOWN}


@final
@dataclass(frozen=True, kw_only=True)
class Shift(Randomization):
    """Cranley-Patterson shift: one uniform toroidal translation of all points.

    References
    ----------
    [CranleyPatterson1976]_
    """

    pointwise: ClassVar[bool] = True
    fits: ClassVar[Mapping[Structure, Structure]] = _TRANSLATED
    stationary: ClassVar[bool] = True
    debiases: ClassVar[bool] = True

    def law_of(self, law: Law, n: int) -> Law:  # noqa: ARG002
        """Return the joint distribution of the points after a uniform translation of the torus."""
        return shifted(law)

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Translate each realization by its own vector."""
        return translated(points, stream.uniforms(first, len(points), points.shape[2]))

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        """Translate each realization; a fixed set is drawn only once."""
        points = sampler.draw_stream(n, stream, first, 1 if sampler.fixed else count)
        return translated(points, own.uniforms(first, count, sampler.dims))


def _as_offset(name: str, given: Any) -> object:
    listed = isinstance(given, Sequence | np.ndarray) and not isinstance(given, str)
    return as_reals(name, given, len(given)) if listed else as_real(name, given)


@final
@dataclass(frozen=True, kw_only=True)
class StrataShift(Randomization):
    """Deterministic toroidal translation by a fraction of the stratum side n^(-1/d).

    Attributes
    ----------
    offset
        Fraction of the side, one number or one per dim.

    References
    ----------
    [Ramamoorthi2012]_
    """

    fixed: ClassVar[bool] = True
    fits: ClassVar[Mapping[Structure, Structure]] = _TRANSLATED
    offset: float | Sequence[float] = checked(_as_offset, 0.5)

    def fit(self, sampler: Sampler) -> Randomization:
        """Check that a list of offsets has one number per dim."""
        as_reals("offset", self.offset, sampler.dims)
        return Randomization.fit(self, sampler)

    def law_of(self, law: Law, n: int) -> Law:
        """Return the law after one fixed translation of the torus."""
        return moved(
            law, np.array(as_reals("offset", self.offset, law.dims)) * n ** (-1.0 / law.dims)
        )

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Translate all realizations by the same vector."""
        del stream, first
        _, n, dims = points.shape
        offsets = np.array([as_reals("offset", self.offset, dims)]) * n ** (-1.0 / dims) % 1.0
        offsets[offsets >= 1.0] = 0.0  # the remainder of −1e-20 modulo 1 rounds to 1
        return translated(points, offsets)


@final
@dataclass(frozen=True, kw_only=True)
class RandomRotation(Randomization):
    """Random rotation by right angles, with reflections; or by any angle, cut to a window (2-D).

    Attributes
    ----------
    boundary
        ``"toroidal"``: one of the d!·2^d symmetries of the cube, which permute and reflect axes.
        The torus has no other rotations.
        The symmetries of the cube preserve distances on the torus, and strata with equal sides.
        Elementary intervals map to elementary intervals, whose shapes are permuted.
        ``"clipped"`` (2-D): the periodically repeated points are rotated by a uniform angle.
        Only the points in a square window at a random place are kept.
        The size of the window is the largest at which it has n points.
        The window is scaled to the unit square, and translated at random on the torus.

    Notes
    -----
    If a unit square is rotated by another angle and wrapped, it covers parts of the torus twice.
    Other parts of the torus stay empty.
    If points are taken from a window, no part is empty or covered twice.
    Inside the window, distances are preserved up to a scale of 1 + O(n^-1/2) for random points.
    Distances across the window's border are not preserved.
    The translation moves the window's border to a random place.
    The translation also makes every point exactly uniform.
    """

    fits: ClassVar[Mapping[Structure, Structure]] = _TURNED
    pointwise: ClassVar[bool] = True
    boundary: str = choice("toroidal", "clipped")

    def _check(self) -> None:
        if self.boundary == "clipped":
            settle(self, fits=_TRANSLATED, debiases=True, stationary=True, pointwise=False)

    def fit(self, sampler: Sampler) -> Randomization:
        """Check that `sampler` has 2 dims if the angle of rotation is arbitrary."""
        if self.boundary == "clipped" and sampler.dims != 2:
            raise ParameterError(
                f"random-rotation(boundary='clipped') needs 2 dims, but {sampler.spec} has "
                f"{sampler.dims}; use boundary='toroidal'."
            )
        return Randomization.fit(self, sampler)

    def left(self, sampler: Sampler) -> Structure:
        """Return the structure of the points that the rotation preserves.

        A toroidal rotation preserves digits if all axes have the same base.
        """
        same = self.boundary == "toroidal" and len(set(sampler.digit_bases)) == 1
        if sampler.structure is Structure.DIGITS and same:
            return Structure.DIGITS
        return Randomization.left(self, sampler)

    def law_of(self, law: Law, n: int) -> Law:
        """Return a stationary law if the inner law or this rotation is stationary."""
        if isinstance(law, Independent):
            return law
        if law.stationary or self.stationary:
            return Stationary(n=n, dims=law.dims, sets=independent_sets(law))
        return Randomization.law_of(self, law, n)

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Rotate each realization by its own symmetry or angle."""
        out = np.empty(points.shape)
        keys = stream.keys(first, len(points))
        if self.boundary == "toroidal":
            _turn(keys, points, out)
        else:
            _clip_all(keys, points, out)
        return out


@kernel
def _turn(keys: Array, points: Array, out: Array) -> None:
    # A random symmetry of the cube: coordinate j is axis order[j], reflected if its bit is set
    count, n, dims = points.shape
    order, flip = np.arange(dims), np.zeros(dims, np.bool_)
    for r in range(count):
        for j in range(dims):
            order[j] = j
        for j in range(dims):
            bits = mix_bits(keys[r, 0], keys[r, 1], j)
            flip[j] = bits & np.uint64(1)
            chosen = np.int64((bits >> np.uint64(1)) % np.uint64(j + 1))
            order[j], order[chosen] = order[chosen], order[j]
        for i in range(n):
            for j in range(dims):
                x = points[r, i, order[j]]
                out[r, i, j] = BELOW_ONE - x if flip[j] else x


@kernel
def _seen(points: Array, center: Array, turn: Array, reach: float, found: Array) -> int:
    # Find rotated points in a window, max(|x|, |y|) ≤ reach, and return their number.
    # Write x, y and max(|x|, |y|) of each point to a row of `found` (25n, 3).
    size = 0
    for i in range(points.shape[0]):
        x0, y0 = points[i, 0] - center[0], points[i, 1] - center[1]
        x0, y0 = x0 - np.floor(x0 + 0.5), y0 - np.floor(y0 + 0.5)
        for copy in range(25):
            x, y = x0 + copy // 5 - 2, y0 + copy % 5 - 2
            u, v = turn[0] * x - turn[1] * y, turn[1] * x + turn[0] * y
            norm = max(abs(u), abs(v))
            if norm <= reach:
                found[size, 0], found[size, 1], found[size, 2] = u, v, norm
                size += 1
    return size


@kernel
def _clip_all(keys: Array, points: Array, out: Array) -> None:
    # Fill out (R, n, 2) with the points in the window.
    # The window's edge passes through the point that is (n + 1)-th nearest to the window's center.
    count, n, _ = points.shape
    found = np.empty((25 * n, 3))
    numbers = np.empty(5)
    for r in range(count):
        for k in range(5):
            numbers[k] = mix_uniform(keys[r, 0], keys[r, 1], k)
        angle = 2.0 * math.pi * numbers[2]
        turn = np.array([math.cos(angle), math.sin(angle)])
        size = _seen(points[r], numbers[:2], turn, _FIRST_REACH, found)
        if size <= n:
            size = _seen(points[r], numbers[:2], turn, _REACH, found)
        edge = np.partition(found[:size, 2].copy(), n)[n]
        inside = np.count_nonzero(found[:size, 2] < edge)
        # If too many points lie on the edge of the window, take only the first of them
        taken, ties = 0, n - inside
        for i in range(size):
            on_edge = found[i, 2] == edge
            if found[i, 2] > edge or (on_edge and ties == 0):
                continue
            ties -= on_edge
            for j in range(2):
                x = found[i, j] / (2.0 * edge) + 0.5 + numbers[3 + j]
                out[r, taken, j] = min(x - np.floor(x), BELOW_ONE)
            taken += 1


@final
@dataclass(frozen=True, kw_only=True)
class Mirror(Randomization):
    """Mirroring: put samples into one random mirror image of the integrand, into all, or fold them.

    Attributes
    ----------
    mode
        ``"random"``: every coordinate of every sample is reflected with probability ½.
        ``"uniform"``: each of n/2^d samples is replaced by its 2^d reflections, in order.
        ``"fold"``: u → 1 − |2u − 1| in every coordinate (the baker's transform), not random.

    Notes
    -----
    Reflections at its upper faces extend an integrand f on [0,1)^d to a function g on [0,2)^d:
    for k ∈ {0,1}^d, g(k + x) = f(x reflected in the coordinates with k_j = 1).
    The function g is continuous across all faces and has period 2.
    A sample x can be placed at k + x for one random vector k in {0,1}^d, or for all such vectors.
    Alternatively, the whole set can be stretched over [0,2)^d.
    The randomized points are the arguments at which f is evaluated.

    Uniform samples remain exactly uniform. Each half-open cell of a grid maps to the opposite cell.

    Random reflection and folding destroy strata, elementary intervals, and differences of points.
    The uniform mode preserves strata and intervals; each then has 2^d times as many points.

    References
    ----------
    See [Hickernell2002]_ for the baker's transform.
    The modes ``"random"`` and ``"uniform"`` are our interpretation of mirrored samples.
    The mode ``"uniform"`` uses antithetic variates in each coordinate [HammersleyMorton1956]_.
    """

    pointwise: ClassVar[bool] = True
    fits: ClassVar[Mapping[Structure, Structure]] = _NOTHING
    mode: str = choice("random", "uniform", "fold")

    def _check(self) -> None:
        if self.mode == "uniform":
            settle(self, fits=_IMAGES, pointwise=False)

    def fit(self, sampler: Sampler) -> Randomization:
        """Check that the uniform mode does not have too many dims."""
        if self.mode == "uniform" and sampler.dims > _MOST_IMAGED:
            raise ParameterError(
                f"mirror(mode='uniform') makes 2^d images of a point, but {sampler.spec} has "
                f"{sampler.dims} dims; use at most {_MOST_IMAGED}, or mode='random'."
            )
        return Randomization.fit(self, sampler)

    def law_of(self, law: Law, n: int) -> Law:
        """Return the law of the mirrored points.

        To predict variances, the integrand is mirrored instead of the points.
        """
        if self.mode == "fold":
            return Folded(n=n, dims=law.dims, inner=law)
        return Mirrored(n=n, dims=law.dims, inner=law, mode=self.mode)  # type: ignore[arg-type]

    def count_inside(self, sampler: Sampler, n: int) -> int:
        """Return the number of points before mirroring; in uniform mode, n counts all images."""
        return n // self._images(sampler)

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Mirror each realization; the uniform mode returns 2^d points per given point."""
        if self.mode == "uniform":
            count, n, dims = points.shape
            images = np.arange(1 << dims)[:, None] >> np.arange(dims)[::-1] & 1
            turned = np.where(images == 1, BELOW_ONE - points[:, :, None], points[:, :, None])
            return turned.reshape(count, n << dims, dims)
        if self.mode == "fold":
            return folded(points)
        out = np.empty(points.shape)
        _reflect_at_random(stream.keys(first, len(points)), points, out)
        return out

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        points = sampler.draw_stream(n // self._images(sampler), stream, first, count)
        return self.apply(points, own, first)

    def counts_near(self, sampler: Sampler, n: int) -> tuple[int | None, int]:
        images = self._images(sampler)
        below = sampler._counts_near(n // images)[0] if n >= images else None
        above = sampler._counts_near(-(-n // images))[1]
        return (below and below * images), above * images

    def max_count(self, sampler: Sampler) -> int:
        return min(sampler.max_count * self._images(sampler), MAX_COUNT)

    def count_warning(self, sampler: Sampler, n: int) -> str | None:
        return sampler._count_warning(n // self._images(sampler))

    def _images(self, sampler: Sampler) -> int:
        return 1 << sampler.dims if self.mode == "uniform" else 1


def folded(points: Array) -> Array:
    """Return u → 1 − |2u − 1| of coordinates in [0,1), within [0,1)."""
    doubled = 2.0 * points
    return np.where(doubled < 1.0, doubled, BELOW_ONE - (doubled - 1.0))


@kernel
def _reflect_at_random(keys: Array, points: Array, out: Array) -> None:
    # One random bit decides whether a coordinate is reflected; a random number has 64 bits.
    count, n, dims = points.shape
    words = (dims + 63) // 64
    for r in range(count):
        for i in range(n):
            for word in range(words):
                bits = mix_bits(keys[r, 0], keys[r, 1], i * words + word)
                for j in range(64 * word, min(64 * word + 64, dims)):
                    x = points[r, i, j]
                    out[r, i, j] = BELOW_ONE - x if bits & np.uint64(1) else x
                    bits >>= np.uint64(1)


@final
@dataclass(frozen=True, kw_only=True)
class Decorrelate(Randomization):
    """Decorrelate pixels: all share one realization of the sampler, each with its own shift.

    Realization r is pixel (r mod width, r div width mod width) of frame (r div width²).

    Attributes
    ----------
    mode
        Randomization of the shared set per pixel: ``"shift"``, ``"digital-shift"`` or ``"owen"``.
    mask
        Source of the random numbers. ``"white"``: independent in all pixels.
        ``"blue-noise"``: a repeated void-and-cluster dither mask, at a random place for each dim.
        Neighbors get very different shifts, and the error of the image is blue noise.
        ``"spatiotemporal"``: the same, with a mask that is also blue noise in time at each pixel.
        ``"r2"``: Roberts's R-sequence indexed by the number of the pixel, from a random start.
    width
        Width of the image, and side of the blue-noise mask, in pixels.
    frames
        Number of frames after which the spatio-temporal mask repeats.
    time
        Change of the blue-noise mask from frame to frame. ``"repeat"``: none.
        ``"golden"``: the shifts of frame t are larger by t times the steps of the R-sequence.
        In one dim, the step of the R-sequence is the golden ratio.
        ``"move"``: the whole mask moves to another place, given by the R-sequence in 2-D.
    advance
        Whether frame t uses the points t·n … (t + 1)·n − 1 of the shared sequence.
        By default all frames use the first n points.

    Notes
    -----
    The realizations of one seed are the pixels of one image.
    All pixels share one point set. With a mask, the shifts of all pixels come from one pattern.
    Variances over the pixels are variances within an image.
    With more pixels, the variance within an image does not converge to the variance over seeds.

    At each pixel, a mask gives one number per dim.
    One number per dim is enough for shift, and for digital-shift in base 2.
    For every mask, the points in a single pixel are uniformly distributed.
    In each dim, the shifts of the width² pixels of a blue-noise mask are stratified:
    if [0,1) is divided into width² equal intervals, each interval contains one shift.
    The shifts of a spatio-temporal mask are stratified in the same way over all its frames.

    References
    ----------
    [GeorgievFajardo2016]_, [Roberts2018]_, [Wolfe2022]_
    """

    pointwise: ClassVar[bool] = True
    fits: ClassVar[Mapping[Structure, Structure]] = _TRANSLATED
    debiases: ClassVar[bool] = True
    mode: str = choice("shift", "digital-shift", "owen")
    mask: str = choice("white", "blue-noise", "r2", "spatiotemporal")
    width: int = whole(64, least=1, most=256)
    frames: int = whole(16, least=1, most=64)
    time: str = choice("repeat", "golden", "move")
    advance: bool = flag(default=False)

    def _check(self) -> None:
        settle(
            self,
            fits=self._step().fits,
            stationary=self.mode == "shift",
            independent=self.mask == "white",
        )
        if self.mode == "owen" and self.mask != "white":
            raise ParameterError(
                f"mask is {self.mask!r}, but mode='owen' needs many random numbers for each dim "
                "and a mask gives one; use mask='white' or mode='shift'."
            )
        if self.time != "repeat" and self.mask != "blue-noise":
            raise ParameterError(
                f"time is {self.time!r}, but only mask='blue-noise' changes in this way; leave "
                "time out."
            )

    def fit(self, sampler: Sampler) -> Randomization:
        """Check that the mode accepts the sampler, and that a mask is used in base 2 only."""
        Randomization.fit(self, sampler)
        self._step().fit(sampler)
        if self.advance and not sampler.sequence:
            raise ParameterError(
                f"advance=True takes later points in later frames, but {sampler.spec} is not a "
                "sequence; use a sequence such as sobol, or leave advance out."
            )
        others = set(sampler.digit_bases) - {2}
        if self.mode == "digital-shift" and self.mask != "white" and others:
            raise ParameterError(
                f"mask={self.mask!r} shifts binary digits, but {sampler.spec} has digits in base "
                f"{min(others)}; use mask='white' or mode='shift'."
            )
        return self

    def law_of(self, law: Law, n: int) -> Law:
        """Return the joint distribution of the points in one pixel; all pixels share one set."""
        if self.advance:  # each frame uses other points of the sequence
            return Randomization.law_of(self, law, n)
        return self._step().law_of(law, n)

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Move the given sets, one per pixel, by the shift of their pixel."""
        return self._moved(self._step(), points, stream, first)

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        if self.advance:
            # Draw the points of all frames at once, n points for each frame.
            # Round the number of frames up to a power of two: some sequences need 2^m points
            frames = (first + count - 1) // self.width**2 + 1
            most = sampler.check_count(n << (frames - 1).bit_length())
            points = sampler.draw_stream(most, stream, 0, 1)[0].reshape(-1, n, sampler.dims)
            shared = points[np.arange(first, first + count) // self.width**2]
        else:
            shared = repeated(sampler.draw_stream(n, stream, 0, 1)[0], count)
        return self._moved(self._step().fit(sampler), shared, own, first)

    def counts_near(self, sampler: Sampler, n: int) -> tuple[int | None, int]:
        return self._step().fit(sampler).counts_near(sampler, n)

    def offsets(self, stream: Stream, first: int, count: int, dims: int) -> Array:
        """Return the mask's shifts (count, dims) for pixels first … first + count − 1."""
        pixels = np.arange(first, first + count)
        places = stream.child(0).uniforms(0, 1, dims)[0]
        if self.mask == "r2":
            from mcspectra.samplers.lattice import golden_steps

            units = (places * 2.0**53).astype(np.uint64) << np.uint64(11)
            sums = units + pixels.astype(np.uint64)[:, None] * golden_steps(dims)  # modulo 2^64
            return np.asarray((sums >> np.uint64(11)) * 2.0**-53)

        # A shift is (rank + random number)/number of ranks.
        # Each dim has its own position of the mask
        width, ranks, starts = self.width, *self._placed(stream, dims)
        frame = pixels // width**2
        steps = np.zeros((frame[-1] - frame[0] + 1 if count else 0, 2), np.int64)
        if self.time == "move":
            steps = (_steps_of(np.arange(frame[0], frame[-1] + 1), 2) * width).astype(np.int64)
        found = np.empty((count, dims))
        _fill_ranks(first, ranks, starts, steps, found)
        inside = stream.uniforms(first, count, dims)
        shifts = np.minimum((found + inside) / ranks.size, BELOW_ONE)
        if self.time == "golden":
            shifts += _steps_of(frame, dims)
            shifts -= shifts >= 1.0
        return np.asarray(shifts)

    def ranks(self, stream: Stream, dims: int) -> Array:
        """Return the ranks (dims, frames, width, width) of the mask, at its place in each dim."""
        ranks, starts = self._placed(stream, dims)
        return np.stack([np.roll(ranks, -start[::-1], axis=(0, 1, 2)) for start in starts.T])

    def _placed(self, stream: Stream, dims: int) -> tuple[Array, Array]:
        """Return the mask, and its first column, row and frame in each dim (3, dims)."""
        ranks = _mask(self.width, self.frames if self.mask == "spatiotemporal" else 1)
        places = stream.child(0).uniforms(0, 1, 3 * dims)[0].reshape(3, dims)
        sides = np.array([[self.width], [self.width], [len(ranks)]])
        return ranks, (places * sides).astype(np.int64)

    def _moved(self, step: Randomization, points: Array, stream: Stream, first: int) -> Array:
        if self.mask == "white":
            return step.apply(points, stream, first)
        count, _, dims = points.shape
        offsets = self.offsets(stream, first, count, dims)
        if self.mode == "digital-shift":
            words = (points * 2.0**53).astype(np.uint64)
            words ^= (offsets * 2.0**53).astype(np.uint64)[:, None]
            return np.asarray(words * 2.0**-53)
        return translated(points, offsets)

    def _step(self) -> Randomization:
        from mcspectra.samplers.registry import RANDOMIZATIONS

        step: Randomization = RANDOMIZATIONS.load(self.mode)()
        return step


def _steps_of(frame: Array, dims: int) -> Array:
    """Return the points (k, dims) of the R-sequence [Roberts2018]_ at the given indices (k,)."""
    from mcspectra.samplers.lattice import golden_steps

    steps = frame.astype(np.uint64)[:, None] * golden_steps(dims)  # modulo 2^64
    return np.asarray((steps >> np.uint64(11)) * 2.0**-53)


@kernel
def _fill_ranks(first: int, ranks: Array, starts: Array, steps: Array, out: Array) -> None:
    # Rank of each pixel in each dim. The mask `ranks` (T, w, w) of dim j starts at column
    # starts[0, j], row starts[1, j] and frame starts[2, j]; frame t moves it by steps[t − first]
    frames, width, _ = ranks.shape
    area = width * width
    for p in range(out.shape[0]):
        frame, place = (first + p) // area, (first + p) % area
        row, column = place // width, place % width
        step = steps[frame - first // area]
        for j in range(out.shape[1]):
            y, x = row + starts[1, j] + step[1], column + starts[0, j] + step[0]
            out[p, j] = ranks[(frame + starts[2, j]) % frames, y % width, x % width]


@lru_cache(maxsize=4)
def _mask(width: int, frames: int) -> Array:
    """Return the ranks (frames, width, width); masks with several frames are cached on disk."""
    from mcspectra.samplers.dither import spatiotemporal_mask

    def make() -> Array:
        return spatiotemporal_mask(width, frames, Stream(_MASK_KEY).keys(0, 1)[0])

    if frames == 1:
        return make()
    return cached_array(f"spatio-temporal mask 1, {frames} frames of {width}", make)
