"""Determinantal sets: the projection process of the lowest frequencies on the torus."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers._determinantal_kernels import fill_determinantal
from mcspectra.samplers._shells import nearest_frequencies
from mcspectra.samplers.base import Sampler, Structure, check_dims

__all__ = ["Determinantal"]


@final
@dataclass(frozen=True, kw_only=True)
class Determinantal(Sampler):
    """Points of the projection determinantal process of n Fourier waves on the torus; any dims.

    The kernel is K(x, y) = Σ exp(2πi m·(x − y)) over M, the n frequencies of least norm; of equal
    norms the lexicographically first. M need not be symmetric, so any count is possible (up to
    4096: an exact draw takes about n³ log n steps).

    Notes
    -----
    Drawn exactly, point after point (Hough et al., algorithm 18; Lavancier et al., algorithm 1),
    each by rejection from uniform proposals. The process is stationary, with pair density
    n² − |K(x, y)|² and n⟨|S_k|²⟩ = 1 − #{(m, m') in M × M: m − m' = k}/n, hence hyperuniform
    like |k|: variances of smooth integrands fall like n^(−1−1/d).

    References
    ----------
    Hough, Krishnapur, Peres, Virág (2006), "Determinantal processes and independence",
    doi 10.1214/154957806000000078. Lavancier, Møller, Rubak (2015), "Determinantal point process
    models and statistical inference", doi 10.1111/rssb.12096. Bardenet, Hardy (2020), "Monte Carlo
    with determinantal point processes", doi 10.1214/19-AAP1504.
    """

    name: ClassVar[str] = "determinantal"
    structure: ClassVar[Structure] = Structure.TORUS
    max_dims: ClassVar[int | None] = 64
    max_count: ClassVar[int] = 2**12  # work grows like n³ log n, memory like n²
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        check_dims(self)

    def frequencies(self, n: int) -> Array:
        """Return M, the frequencies of the kernel of `n` points: int64 (n, dims)."""
        return nearest_frequencies(self.check_count(n), self.dims)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        out = np.empty((count, n, self.dims))
        fill_determinantal(stream.keys(first, count), self.frequencies(n), out)
        return out
