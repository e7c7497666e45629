"""Expected power spectra of point sets, uniform or importance-sampled, by simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers
from mcspectra.core.results import dataset
from mcspectra.core.staged import compute
from mcspectra.core.streams import RngLike, Stream
from mcspectra.densities import Density, as_warp
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.spectra._polar import PolarSums
from mcspectra.spectra.staged_spectrum import (
    PowerSums,
    SpectrumSums,
    StagedSpectrum,
    weighted_points,
)
from mcspectra.spectra.transforms import FrequencyGrid, Transform

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "MAX_WEDGES",
    "PowerSums",
    "power_spectrum",
    "staged_spectrum",
    "wedge_angles",
    "weighted_points",
]

_MOST_COORDINATES = 2**26  # of a set: half a GiB, and several times that in a transform

MAX_WEDGES = 360
"""Most directions into which a half turn is divided."""


def power_spectrum(
    sampler: Sampler | str,
    n: int,
    *,
    density: Density | str | None = None,
    half_width: int = 64,
    frequency_step: float = 1.0,
    realizations: int = 100,
    mean: bool = False,
    wedges: int = 12,
    rng: RngLike = 0,
    engine: str = "auto",
    eps: float = 1e-9,
    workers: int | None = None,
) -> xr.Dataset:
    """Estimate the expected power spectrum ⟨|S_m|²⟩ of a sampler's point sets.

    Parameters
    ----------
    sampler, n
        Sampler (or spec string) and number of points.
    density
        Importance density p (or spec string): points are warped and weighted 1/(n p).
    half_width
        Frequencies run over frequency_step · {−half_width … half_width} in every dim.
    frequency_step
        Below 1 for real frequencies between the integers.
    realizations
        Number of realisations averaged; 2 or more for standard errors.
    mean
        Whether to return the complex mean ⟨S_m⟩ too: bias, 0 at integer m ≠ 0 for unbiased sets.
    wedges
        In two dims, the number of directions of which mean power is returned, 360 at most.
    rng
        Seed (SPEC 7).
    engine, eps
        See `mcspectra.spectra.transforms`.
    workers
        Threads; all processors by default. Results do not depend on it.

    Returns
    -------
    xarray.Dataset
        ``power``, ``power_se`` on dims m0, m1, … (power 1/n is random sampling; m = 0 holds
        ⟨S_0²⟩; with a density random is ∫1/p / n, the attribute ``random_level`` over n);
        ``radial_power``, ``radial_power_se`` on dim radius (|m|, cycles per unit, rings of one
        frequency step, without m = 0), the error from the ring means of each realisation, since
        the frequencies of one set are not independent; in two dims ``wedge_power`` and
        ``wedge_power_se`` likewise, see `wedge_means`; with `mean`, ``mean_coefficient`` (complex)
        and ``mean_coefficient_se`` on dims m0, m1, …

    Raises
    ------
    ParameterError
        A value is out of range, the grid too large, or dims disagree; or a set has more than 2^26
        coordinates.

    Notes
    -----
    Power is as in the slides, ⟨|S_m|²⟩. Multiply by n for the convention of UTK, random = 1.
    Cost O(n log^d(1/eps) + M log M) for a pair of realisations of M frequencies. Memory does not grow
    with the realisations: 100 M bytes for each thread at most, and for its points (and phases, of
    the direct engine) up to 64 MB or, where two sets are larger than that, 100 n d bytes.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> spectrum = mcs.power_spectrum("jittered", 64, half_width=16, realizations=50)
    >>> spectrum["power"].dims, bool(64 * spectrum["radial_power"][0] < 0.2)
    (('m0', 'm1'), True)
    """
    threads = available_workers(workers)
    return compute(
        staged_spectrum(
            sampler,
            n,
            density=density,
            half_width=half_width,
            frequency_step=frequency_step,
            realizations=realizations,
            mean=mean,
            wedges=wedges,
            rng=rng,
            engine=engine,
            eps=eps,
        ),
        threads,
        "power_spectrum",
    )


def staged_spectrum(
    sampler: Sampler | str,
    n: int,
    *,
    density: Density | str | None = None,
    half_width: int = 64,
    frequency_step: float = 1.0,
    realizations: int = 100,
    mean: bool = False,
    wedges: int = 12,
    rng: RngLike = 0,
    engine: str = "auto",
    eps: float = 1e-9,
) -> StagedSpectrum:
    """Return `power_spectrum` as a staged analysis of one run, its arguments checked."""
    source = as_sampler(sampler, getattr(density, "primary_dims", None))
    p = as_warp(density, source.dims)
    dims = source.dims if p is None else p.dims
    n = source.check_count(n)
    realizations = as_integer("realizations", realizations, least=1, most=MAX_REALIZATIONS)
    _check_points(n, max(dims, source.dims))
    grid = FrequencyGrid(dims, half_width, frequency_step)
    wedges = as_integer("wedges", wedges, least=1, most=MAX_WEDGES)
    transform = Transform(grid, n, engine=engine, eps=eps)
    stream = Stream.from_rng(rng)

    def result(total: SpectrumSums) -> xr.Dataset:
        power, se = total.power.power(realizations)
        variables, coords = _polar_variables(grid, total.polar, realizations)
        return dataset(
            {
                "power": (grid.names, grid.full(power)),
                "power_se": (grid.names, grid.full(se)),
                **variables,
                **_mean_variables(grid, total.power, realizations),
            },
            {**grid.coords, **coords},
            sampler=source.spec,
            density=p.spec if p is not None else None,
            n=n,
            realizations=realizations,
            stream_key=f"{stream.key:#x}",
            seed=rng if isinstance(rng, int) else None,
            engine=transform.engine,
            eps=eps,
            random_level=1.0 if p is None else p.reciprocal_integral(),
            convention="power = <|S_m|^2>; random points: random_level/n, random_level = ∫1/p",
        )

    empty = PolarSums.of(grid, wedges)
    return StagedSpectrum(source, p, n, stream, realizations, transform, mean, empty, result)


def _check_points(n: int, dims: int) -> None:
    if n * dims > _MOST_COORDINATES:
        raise ParameterError(
            f"{n} points in {dims} dims are {100 * n * dims / 2**30:.3g} GiB a thread; a spectrum takes "
            f"at most {_MOST_COORDINATES // dims} of them."
        )


def _polar_variables(
    grid: FrequencyGrid, polar: PolarSums, count: int
) -> tuple[dict[str, tuple[tuple[str, ...], Array]], dict[str, Any]]:
    """Means over rings and, in two dims, over wedges, with their coordinates."""
    mean, se = polar.means(count)
    rings = grid.half_width
    variables: dict[str, tuple[tuple[str, ...], Array]] = {
        "radial_power": (("radius",), mean[:rings]),
        "radial_power_se": (("radius",), se[:rings]),
    }
    labels = {"long_name": "|m|", "units": "cycles per unit"}
    coords: dict[str, Any] = {"radius": ("radius", polar.radius * grid.step, labels)}
    if grid.dims == 2:
        variables |= {
            "wedge_power": (("angle",), mean[rings:]),
            "wedge_power_se": (("angle",), se[rings:]),
        }
        coords["angle"] = wedge_angles(len(mean) - rings)
    return variables, coords


def wedge_angles(wedges: int) -> tuple[str, Array, dict[str, str]]:
    """Centres of the wedges, as a coordinate."""
    angle = np.arange(wedges) * 180.0 / wedges
    return "angle", angle, {"long_name": "direction", "units": "degrees"}


def _mean_variables(
    grid: FrequencyGrid, sums: PowerSums, count: int
) -> dict[str, tuple[tuple[str, ...], Array]]:
    """⟨S_m⟩ on the whole grid, if it was summed."""
    if sums.mean is None:
        return {}
    mean, se = sums.coefficient(count)
    return {
        "mean_coefficient": (grid.names, grid.full(mean, conjugate=True)),
        "mean_coefficient_se": (grid.names, grid.full(se)),
    }
