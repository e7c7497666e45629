"""Terms of a Gaussian bell in one to four dims, and its bands by subsets of axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.integrands.registry import integrand

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "RUNS",
    "SMALL",
    "bell_terms",
    "components",
    "entries",
    "labelled_subsets",
    "main_share",
    "run_terms",
    "subsets",
    "with_matrix",
]

BELL = "gaussian(center=0.35, width=0.25)"
SMALL = {1: (64, 24), 2: (64, 7)}  # by dims: points, and a half width whose matrix can be had
RUNS = {1: (64, 256), 2: (64, 48), 3: (64, 8), 4: (81, 4)}  # by dims: points, half width


def entries(dims: int, half_width: int) -> int:
    """Number of entries of the matrix; that of a map is its square root."""
    return int((2 * half_width + 1) ** (2 * dims))


def bell_terms(
    name: str,
    dims: int,
    size: tuple[int, int],
    realizations: int,
    seed: int,
    *,
    matrix: bool = False,
) -> xr.Dataset:
    """Terms of the bell for (number of points, half width), with ANOVA bands."""
    from mcspectra.variance.terms import variance_terms

    n, half_width = size
    return variance_terms(
        integrand(BELL, dims), name, n, half_width=half_width, realizations=realizations,
        rng=seed, bands="anova", cross_matrix=matrix,
    )  # fmt: skip


def with_matrix(dims: int, realizations: int, seed: int) -> xr.Dataset:
    """Terms of jittered points with the matrix."""
    return bell_terms("jittered", dims, SMALL[dims], realizations, seed, matrix=True)


def run_terms(name: str, dims: int, realizations: int, seed: int) -> xr.Dataset:
    """Terms of a sampler, as large as `RUNS` says."""
    return bell_terms(name, dims, RUNS[dims], realizations, seed)


def subsets(dims: int, half_width: int) -> Array:
    """For each frequency, as a number in base 2, along which axes it is not 0."""
    side = np.arange(-half_width, half_width + 1)
    grids = np.meshgrid(*[side] * dims, indexing="ij")
    return np.asarray(sum(2**i * (m != 0) for i, m in enumerate(grids))).ravel()


def components(dims: int, half_width: int) -> dict[int, float]:
    """Σ |f_m|² over the frequencies of each subset of axes: the truncated ANOVA components."""
    power = np.abs(integrand(BELL, dims).fourier_grid(half_width)).ravel() ** 2
    of = subsets(dims, half_width)
    return {int(a): float(power[of == a].sum()) for a in set(of.tolist()) if a}


def labelled_subsets(data: xr.Dataset) -> list[int]:
    """The subset of axes of each band, of labels such as ``constant`` and ``x0x2``."""
    names = str(data["band"].attrs["labels"]).split(", ")
    return [sum(2 ** int(axis) for axis in name.split("x")[1:]) for name in names]


def main_share(data: xr.Dataset) -> float:
    """Share of the functions of one coordinate in the variance, with all they share with others."""
    order = labelled_subsets(data)
    alone = [k for k, subset in enumerate(order) if subset in (1, 2, 4)]
    matrix = data["band_covariance"].values
    return float(matrix[alone].sum() / matrix.sum())
