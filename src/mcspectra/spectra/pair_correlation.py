"""Isotropic pair correlation g(r) of point sets on the torus."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers, map_in_order
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.spectra._kernels import histogram_distances

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["pair_correlation"]


def pair_correlation(
    sampler: Sampler | str,
    n: int,
    *,
    bins: int = 100,
    realizations: int = 16,
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Estimate the pair correlation g(r): density of pairs at toroidal distance r, random = 1.

    Parameters
    ----------
    sampler, n
        Sampler (or spec string) and number of points, at least 2.
    bins
        Number of equal bins of r in [0, 1/2].
    realizations
        Number of realisations averaged; 2 or more for standard errors.
    rng
        Seed (SPEC 7).
    workers
        Threads; all processors by default.

    Returns
    -------
    xarray.Dataset
        ``pair_correlation``, ``pair_correlation_se`` on dim r (bin centres).

    Notes
    -----
    g = pairs in a shell / (n(n−1)/2 · volume of the shell). Cost O(n²) a realisation.
    """
    source = as_sampler(sampler)
    as_integer("dims of a pair correlation", source.dims, least=1, most=8)
    n = source.check_count(n)
    if n < 2:
        raise ParameterError("pair_correlation needs n of at least 2, not 1.")
    bins = as_integer("bins", bins, least=1, most=10**6)
    realizations = as_integer("realizations", realizations, least=1, most=MAX_REALIZATIONS)
    stream = Stream.from_rng(rng)
    width = 0.5 / bins
    edges = np.arange(bins + 1) * width
    ball = math.pi ** (source.dims / 2) / math.gamma(source.dims / 2 + 1)
    expected = 0.5 * n * (n - 1) * ball * np.diff(edges**source.dims)

    def one(realization: int) -> Array:
        counts = np.zeros(bins, np.int64)
        histogram_distances(source.draw_stream(n, stream, realization, 1)[0], width, counts)
        return np.asarray(counts / expected)

    total, squares = np.zeros(bins), np.zeros(bins)
    for g in map_in_order(one, range(realizations), available_workers(workers)):
        total += g
        squares += g * g
    mean = total / realizations
    spread = np.maximum(squares / realizations - mean * mean, 0.0)
    se = np.sqrt(spread / (realizations - 1)) if realizations > 1 else np.full(bins, np.nan)
    r = ("r", 0.5 * (edges[1:] + edges[:-1]), {"long_name": "toroidal distance", "units": "1"})
    return dataset(
        {"pair_correlation": (("r",), mean), "pair_correlation_se": (("r",), se)},
        {"r": r},
        sampler=source.spec,
        n=n,
        realizations=realizations,
        stream_key=f"{stream.key:#x}",
        seed=rng if isinstance(rng, int) else None,
    )
