"""Mitsuba's own samplers as point sets, by name or as objects.

Samplers by name use the variant ``scalar_rgb``, but do not set it as the current variant.
The current variant stays the same, because pixels depend on it.
The module belongs to the package `rendering` because it needs the module `backend`.
Before Mitsuba is imported, `backend` chooses a libLLVM with which rendering works.
"""

from __future__ import annotations

import importlib
import sys
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.display import shown
from mcspectra.core.errors import ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.rendering.backend import LARGEST_SAMPLE, LOCK, import_mitsuba
from mcspectra.samplers._primes import is_prime
from mcspectra.samplers.base import Sampler

__all__ = ["MitsubaObject", "MitsubaSampler", "from_mitsuba"]

_SEEDS = 2**32


@final
@dataclass(frozen=True, kw_only=True)
class MitsubaSampler(Sampler):
    """One of the samplers of Mitsuba 3. Points are drawn dim by dim, as integrators do.

    The sampler has 1 to 1024 dims. Pairs of dims are drawn by ``next_2d``.
    If the number of dims is odd, the last dim is drawn by ``next_1d``.
    Counts are at most 2^20. Only counts that Mitsuba does not round are allowed:
    ``independent`` takes any count, and ``stratified`` takes s².
    ``multijitter`` takes s², s(s + 1) and s(s + 2).
    ``orthogonal`` takes squares of primes, and ``ldsampler`` takes powers of 4 from 4.

    Attributes
    ----------
    sampler
        Name of the sampler: ``"independent"``, ``"stratified"``, ``"multijitter"`` (Kensler 2013),
        ``"orthogonal"`` (Jarosz et al. 2019) or ``"ldsampler"`` (Kollig & Keller 2002).
    jitter
        Whether points are random in their strata, or at the centers of their strata.
        Only "stratified", "multijitter" and "orthogonal" have strata.

    Notes
    -----
    Points are float32 numbers.
    A coordinate that Mitsuba rounded up to 1 becomes the largest float32 below 1.
    Seeds have 32 bits, so realizations whose numbers differ by 2^32 are equal.
    Each point takes one call of Mitsuba. Some hundred thousand points are drawn per second.

    References
    ----------
    [Jakob2022]_,
    [Kensler2013]_,
    [Jarosz2019]_,
    [KolligKeller2002]_
    """

    name: ClassVar[str] = "mitsuba"
    costly: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 1024
    max_count: ClassVar[int] = 2**20
    sampler: str = "multijitter"
    jitter: bool = True
    dims: int = DEFAULT_DIMS

    def _check(self) -> None:
        as_choice("sampler", self.sampler, tuple(_COUNTS))
        given: object = self.jitter
        if not isinstance(given, bool) or not (given or self.sampler in _STRATA):
            raise ParameterError(
                f"jitter is {shown(given)}; give True or, with {', '.join(_STRATA)}, False."
            )

    @property
    def spec(self) -> str:
        """The spec, which always includes the name of Mitsuba's sampler."""
        jitter = "" if self.jitter else ", jitter=False"
        return f"{self.name}(sampler={self.sampler!r}{jitter})"

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether points are jittered or scrambled."""
        return self.jitter

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        return _drawn(self._source(n), (count, n, self.dims), stream, first)

    def _source(self, n: int) -> Any:
        """Return a sampler object of the scalar variant, created by Mitsuba's parser."""
        options = {} if self.jitter else {"jitter": False}
        with LOCK:
            parser = import_mitsuba().parser
            # Importing Mitsuba's module registers the Python classes of its objects
            importlib.import_module("mitsuba.scalar_rgb")
            config = parser.ParserConfig("scalar_rgb")
            state = parser.parse_dict(config, {"type": self.sampler, "sample_count": n, **options})
            return parser.instantiate(config, state)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        counts = _COUNTS[self.sampler]
        above = bisect_left(counts, n)
        below = above if counts[above] == n else above - 1
        return counts[below] if below >= 0 else None, counts[above]


def _drawn(source: Any, shape: tuple[int, int, int], stream: Stream, first: int) -> Array:
    """Return points (R, n, d) of a sampler object. Each realization has a separate seed."""
    (count, n, dims), out = shape, np.empty(shape)
    start = int(stream.keys(0, 1)[0, 0]) + first
    pairs, odd = divmod(dims, 2)
    scalar = "scalar" in source.variant_name()
    for r in range(count):
        if not scalar:  # in vectorized variants, one call returns all n points
            source.set_samples_per_wavefront(n)
            source.seed((start + r) % _SEEDS, n)
            columns = [source.next_2d().numpy() for _ in range(pairs)]
            columns += [source.next_1d().numpy()[np.newaxis] for _ in range(odd)]
            out[r] = np.concatenate(columns).T
            continue
        source.seed((start + r) % _SEEDS)
        for point in out[r]:
            for k in range(pairs):
                point[2 * k : 2 * k + 2] = source.next_2d()
            if odd:
                point[-1] = source.next_1d()
            source.advance()
    return np.minimum(out, LARGEST_SAMPLE, out=out)


@final
@dataclass(frozen=True, kw_only=True)
class MitsubaObject(Sampler):
    """A sampler object of Mitsuba, of any variant and class, from `from_mitsuba`."""

    costly: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 1024
    max_count: ClassVar[int] = 2**20
    source: Any
    dims: int = DEFAULT_DIMS

    def _check(self) -> None:
        needed = ("fork", "seed", "next_2d", "set_sample_count", "variant_name")
        if isinstance(self.source, type) or not all(hasattr(self.source, name) for name in needed):
            raise ParameterError(
                f"{shown(self.source)} is not a sampler of Mitsuba; give an object, such as "
                "scene.sensors()[0].sampler()."
            )

    @property
    def spec(self) -> str:
        """The class and count of the object. A spec string cannot recreate the object."""
        count = self.source.sample_count()
        return f"mitsuba-object({self.source.class_name()}, sample_count={count})"

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        with LOCK:
            return _drawn(self._fork(n), (count, n, self.dims), stream, first)

    def _fork(self, n: int) -> Any:
        source = self.source.fork()
        source.set_sample_count(n)
        return source

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        with LOCK:
            made = int(self._fork(n).sample_count())
        return (made if made <= n else None), (made if made >= n else sys.maxsize)


def from_mitsuba(source: Any, dims: int = DEFAULT_DIMS) -> MitsubaObject:
    """Return a sampler for a sampler object of Mitsuba, e.g. ``scene.sensors()[0].sampler()``.

    Parameters
    ----------
    source
        A sampler object of any variant and class, including plugins in Python.
        Points are drawn from a copy of this object (fork), so the object does not change.
    dims
        Number of dims. The object draws two coordinates at a time.

    Returns
    -------
    MitsubaObject
        A sampler of the object's points. It allows only the counts that Mitsuba does not round.
        For each count, the sampler asks Mitsuba's object whether it rounds the count.

    Raises
    ------
    ParameterError
        If the object is not a Mitsuba sampler.

    Notes
    -----
    Every realization has its own seed.
    A realization therefore does not depend on how many realizations a call draws.
    In vectorized variants, a realization is a wavefront of n lanes, which takes some milliseconds.
    """
    return MitsubaObject(source=source, dims=dims)


_STRATA = ("stratified", "multijitter", "orthogonal")
_ROOTS = range(1, 1032)  # square roots of possible counts, up to the first prime above 2^10
_COUNTS: dict[str, Sequence[int]] = {
    "independent": range(1, 2**20 + 1),
    "stratified": [s * s for s in _ROOTS],
    "multijitter": sorted({s * (s + k) for s in _ROOTS for k in range(3)}),
    "orthogonal": [s * s for s in _ROOTS if is_prime(s)],
    "ldsampler": [4**k for k in range(1, 12)],
}
