"""Expected power spectra of point sets, uniform or importance-sampled, by simulation.

For each realization, power is summed by frequency, and over rings and wedges of frequencies.
Frequencies of one set are not independent:
with a density, random changes of the weights affect all frequencies.
Means over rings and wedges of frequencies are therefore computed for each realization.
The spread of such a mean over the realizations gives its standard error.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import Analysis, Need, Reduction, Subject, compute, whole
from mcspectra.core.checks import MAX_FREQUENCY, Array
from mcspectra.core.confidence import log_mean_interval, standard_error, student_t
from mcspectra.core.errors import ParameterError
from mcspectra.core.memory import memory_of
from mcspectra.core.options import COUNT, ENGINE, EPS, HALF_WIDTH, SETS
from mcspectra.core.parallel import Block, realization_blocks
from mcspectra.core.records import SUM, MeanSums
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.densities import Density
from mcspectra.densities.base import divide_by_density
from mcspectra.densities.registry import as_warp
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.samplers.law import independent_sets
from mcspectra.spectra._kernels import UNLABELLED, power_sums
from mcspectra.spectra.transforms import MAX_FREQUENCIES, FrequencyGrid, Transform

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "MAX_WEDGES",
    "Points",
    "PowerSums",
    "Spectrum",
    "power_spectrum",
    "spectrum_attributes",
    "wedge_angles",
    "wedge_labels",
    "weighted_points",
]

_BLOCKS = 8  # realizations are split into this many blocks or more, for several threads or machines
_MOST_COORDINATES = 2**26  # largest number of coordinates of a set: half a GiB
_EPS = 1e-9  # tolerance of transforms in double precision
_SINGLE_EPS = 1e-5, 1e-6  # tolerances of transforms in single precision, cheapest first
_MOST_ERROR = 0.02  # largest error of a ring mean in single precision, in standard errors
_TRIED_FROM = 16  # least number of realizations for which single precision is tried
# Number of cells along each axis of the pictures of f and p, by the number of dims.
# More cells are not visible in a small figure.
_PICTURE_CELLS = {1: 256, 2: 64}

MAX_WEDGES = 360
"""Largest number of directions into which a half turn is divided."""


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
    eps: float | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Estimate the expected power spectrum ⟨|S_m|²⟩ of a sampler's point sets.

    Parameters
    ----------
    sampler, n
        Sampler (or spec string) and number of points.
    density
        Importance density p (or spec string). Points are warped and get the weights 1/(n p).
    half_width
        Frequencies run over frequency_step · {−half_width … half_width} in every dim.
    frequency_step
        Spacing of the frequencies. Values below 1 add real frequencies between the integers.
    realizations
        Number of realizations for the average. Standard errors need at least 2.
    mean
        Whether to also return the complex mean ⟨S_m⟩. For unbiased sets, it is 0 at integer m ≠ 0.
    wedges
        In two dims, the number of directions for which mean power is returned, at most 360.
    rng
        Seed (SPEC 7).
    engine
        See `mcspectra.spectra.transforms`.
    eps
        Relative accuracy of the transforms.
        By default, single precision with an accuracy of 1e-5 or 1e-6 is used if this is enough:
        transform errors must be below 0.02 standard errors of the power, on all frequency rings.
        The first two realizations decide whether transform errors are below this limit.
        If errors of single precision are larger, the default is 1e-9, in double precision.
        The attribute ``transform_error`` is the largest transform error, in standard errors.
        The attribute ``eps`` is the accuracy that was used.
    workers
        Number of threads. The default is all processors. Results do not depend on it.

    Returns
    -------
    xarray.Dataset
        ``power`` and its standard error ``power_se``, on the dims m0, m1, …
        The power at m = 0 is ⟨S_0²⟩. For random points, power is 1/n, or ∫1/p / n with a density.
        The attribute ``random_level`` is the power of random points, multiplied by n.

        ``radial_power`` and its standard error ``radial_power_se``, on the dim radius.
        The radius is |m| in cycles per unit. Rings are one frequency step wide and exclude m = 0.
        Errors are computed from the realizations' means over a ring.
        Means of realizations are used because frequencies of one set are not independent.
        ``radial_power_ci`` is a 95 % interval from Student's t of the logarithm of power:
        power · exp(±t se/power), where t has realizations − 1 degrees of freedom.
        The attribute ``student_t`` is the factor t, which applies to ``power_se`` as well.
        If the sampler has fewer different sets than realizations, some realizations reuse a set.
        If sets are reused, errors and Student's t are computed with the number of sets.

        In two dims there are also ``wedge_power``, its standard error and interval (`wedge_means`).
        With `mean` there are also the complex ``mean_coefficient`` and its error, on m0, m1, …

    Raises
    ------
    ParameterError
        If a value is out of range, dims disagree, or the grid is too large.
        If a set has more than 2^26 coordinates.
    ConfigError
        If more memory is needed than is available.

    Notes
    -----
    Power is ⟨|S_m|²⟩, without a factor n.
    Multiply power by n for the convention of UTK, where the power of random points is 1.
    The cost is O(n log^d(1/eps) + M log M) for a pair of realizations with M frequencies.
    Memory does not depend on the number of realizations. A thread takes at most 100 M bytes.
    The points take up to 64 MB of additional memory.
    In the direct engine, these 64 MB include the complex phases exp(−2πi m·x).
    If two sets of points take more than 64 MB, the limit is 100 n d bytes instead.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> spectrum = mcs.power_spectrum("jittered", 64, half_width=16, realizations=50)
    >>> spectrum["power"].dims, bool(64 * spectrum["radial_power"][0] < 0.2)
    (('m0', 'm1'), True)
    """
    spectrum = Spectrum.of(locals())
    source = as_sampler(sampler, getattr(density, "primary_dims", None))
    return compute(spectrum, Subject(None, source, as_warp(density, source.dims)), rng, workers)


class _OfPointSets(Analysis, frozen=True, kw_only=True):
    """Options of a spectrum, and of the points that are shown next to it."""

    about = "sampler"

    n: Annotated[int, COUNT, Meta(description="Points in a set.")]
    half_width: Annotated[
        int, Meta(ge=1, le=2**31, description=HALF_WIDTH.description, extra=HALF_WIDTH.extra)
    ] = 64
    frequency_step: Annotated[
        float,
        Meta(
            gt=0.0,
            le=MAX_FREQUENCY / MAX_FREQUENCIES,
            description="Spacing of the frequencies; below 1 also between the integers.",
        ),
    ] = 1.0
    realizations: Annotated[int, SETS] = 100
    mean: Annotated[bool, Meta(description="Also give the complex mean of the coefficients.")] = (
        False
    )
    wedges: Annotated[
        int,
        Meta(
            ge=1,
            le=MAX_WEDGES,
            description="Number of directions in two dims, each with its mean power.",
        ),
    ] = 12
    engine: Annotated[str, ENGINE] = "auto"
    eps: Annotated[
        Annotated[float, EPS] | None,
        Meta(
            description="Relative accuracy of the transforms; by default it is chosen for the "
            "statistical error."
        ),
    ] = None


@final
class Spectrum(_OfPointSets, frozen=True, kw_only=True):
    """Expected power spectrum of the samples at one n, with or without an importance density."""

    function = "power_spectrum"
    verb = "spectrum"
    pictured = True
    companions = ("points",)
    variables = (
        "power", "power_se", "radial_power", "radial_power_se", "radial_power_ci",
        "wedge_power", "wedge_power_se", "wedge_power_ci",
        "mean_coefficient", "mean_coefficient_se",
    )  # fmt: skip

    def need(self, subject: Subject) -> Need:
        """Check that sets are not too large, and that the engine works in this number of dims."""
        source, p = _warped(subject)
        source.check_count(self.n)
        dims = max(source.dims, p.dims if p else 0)
        if self.n * dims > _MOST_COORDINATES:
            raise ParameterError(
                f"{self.n} points in {dims} dims are {100 * self.n * dims / 2**30:.3g} GiB per "
                f"thread; a spectrum takes at most {_MOST_COORDINATES // dims} of them."
            )
        grid = self._grid(source, p)
        Transform(grid, self.n, engine=self.engine, eps=self.eps or _EPS)
        return Need(cost=self._cost(grid), memory=memory_of(self.n, dims, 1, grid.size))

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[_SpectrumSums]:
        """Return the computation as a sum over blocks of realizations."""
        source, p = _warped(subject)
        grid = self._grid(source, p)
        polar = _PolarMeans.of(grid, self.wedges)
        double = Transform(grid, self.n, engine=self.engine, eps=self.eps or _EPS)

        @functools.cache
        def chosen() -> tuple[Transform, float | None]:
            """Return the cheapest transform that is accurate enough, and its largest error.

            The error is relative to the standard error of a ring mean; None in double precision.
            """
            if self.eps is not None or self.realizations < _TRIED_FROM:
                return double, None
            singles = [
                Transform(grid, self.n, engine=double.engine, eps=eps, single=True)
                for eps in _SINGLE_EPS
            ]
            if not singles[0].single:
                return double, None
            points, weights = weighted_points(source, p, self.n, stream, (0, 2))
            exact = _powers(double, points, weights)
            # Estimate the standard deviation of the power from two realizations.
            # Power is exponentially distributed: its standard deviation is the mean of |X − Y|,
            # where X and Y are the powers of two independent realizations
            spread = polar.rings(np.abs(exact[0] - exact[1])) / self.realizations**0.5
            for single in singles:
                error = polar.rings(np.abs(_powers(single, points, weights) - exact).mean(axis=0))
                with np.errstate(divide="ignore", invalid="ignore"):
                    worst = float(np.max(error / spread))
                if worst <= _MOST_ERROR:
                    return single, worst
            return double, None

        # A block takes memory for its points and for two half spectra
        numbers = max(self.n * source.dims, grid.size // 8)
        blocks = realization_blocks(self.realizations, numbers, multiple=2, least=_BLOCKS)

        def block(index: int) -> _SpectrumSums:
            points, weights = weighted_points(source, p, self.n, stream, blocks[index])
            sums = _SpectrumSums(
                PowerSums.zeros(grid.stored, self.mean), MeanSums.zeros(polar.size)
            )
            own, mean = sums.frequencies.power, sums.frequencies.mean
            groups = functools.partial(polar.add, sums.polar)
            transform, _ = chosen()
            transform.add_power(points, weights, own.total, own.squares, mean, polar.label, groups)
            own.count = sums.polar.count = len(points)
            return sums

        def result(total: _SpectrumSums) -> xr.Dataset:
            # Translations of a set have the same power as the set
            law = source.law(self.n)
            sets = independent_sets(law)
            count = self.realizations if sets is None else min(self.realizations, sets)
            power, power_se = total.frequencies.power.mean_and_error(sets)
            found: dict[str, tuple[tuple[str, ...], Array]] = {
                "power": (grid.names, grid.full(power)),
                "power_se": (grid.names, grid.full(power_se)),
            }
            # Collect means over rings, and then over wedges
            rings = grid.half_width
            labels = {"long_name": "|m|", "units": "cycles per unit"}
            coords: dict[str, Any] = {
                **grid.coords,
                "radius": ("radius", polar.radius * grid.step, labels),
                "bound": ["low", "high"],
            }
            parts = [("radial_power", "radius", slice(rings))]
            if grid.dims == 2:
                parts.append(("wedge_power", "angle", slice(rings, None)))
                coords["angle"] = wedge_angles(self.wedges)
            for name, dim, part in parts:
                mean, se = (values[part] for values in total.polar.mean_and_error(sets))
                found[name], found[f"{name}_se"] = ((dim,), mean), ((dim,), se)
                found[f"{name}_ci"] = (dim, "bound"), log_mean_interval(mean, se, count)
            if self.mean:
                # Translations change the coefficients, so reused sets also give new samples
                mean, mean_se = total.frequencies.coefficient(None if law.stationary else sets)
                found["mean_coefficient"] = grid.names, grid.full(mean, conjugate=True)
                found["mean_coefficient_se"] = grid.names, grid.full(mean_se)
            about = spectrum_attributes(source, p, self.n, self.realizations, stream)
            about["student_t"] = student_t(count) if count > 1 else math.nan
            transform, error = chosen()
            return dataset(
                found,
                coords,
                **about,
                engine=transform.engine,
                eps=transform.eps,
                transform_error=error,
            )

        return Reduction(
            kind=_SpectrumSums,
            block=block,
            blocks=len(blocks),
            cost=self._cost(grid),
            result=result,
        )

    def _grid(self, source: Sampler, p: Density | None) -> FrequencyGrid:
        dims = source.dims if p is None else p.dims
        return FrequencyGrid(dims, self.half_width, self.frequency_step)

    def _cost(self, grid: FrequencyGrid) -> float:
        return self.realizations * (self.n + 0.5 * grid.size)


@final
class Points(_OfPointSets, frozen=True, kw_only=True):
    """First realization of the points, warped by the density if there is one.

    With an estimator, the result also has values of f and p on a grid, for pictures.
    """

    pictured = True
    variables = ("points", "integrand_value", "density_value")
    provenance = ("sampler", "n")

    def need(self, subject: Subject) -> Need:
        """Return the cost of one set of points, and of a grid for pictures of f and p."""
        source, _ = _warped(subject)
        source.check_count(self.n)
        grid = 0 if subject.estimator is None else math.prod(_picture_shape(source.dims))
        return Need(cost=self.n + grid, memory=memory_of(self.n, source.dims))

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[xr.Dataset]:
        """Return a computation with a single block, which draws one set of points."""
        source, p = _warped(subject)

        def points() -> xr.Dataset:
            drawn = source.draw_stream(self.n, stream, 0, 1)[0]
            found: dict[str, tuple[tuple[str, ...], Array]] = {
                "points": (("point", "axis"), drawn if p is None else p.sample(drawn))
            }
            found |= {} if subject.estimator is None else _pictures(subject.estimator, p)
            coords: dict[str, Any] = {"axis": np.arange(source.dims)}
            if "integrand_value" in found:
                names, values = found["integrand_value"]
                for name, cells in zip(names, values.shape, strict=True):
                    if name != "channel":
                        coords[name] = (np.arange(cells) + 0.5) / cells
            return dataset(found, coords)

        return whole(points)


def _picture_shape(dims: int) -> tuple[int, ...]:
    """Return the shape of a picture's grid. Above two dims, the grid is a central cut."""
    shown = min(dims, 2)
    return (_PICTURE_CELLS[shown],) * shown


def _pictures(estimator: Any, density: Density | None) -> dict[str, tuple[tuple[str, ...], Array]]:
    """Return values of f and p on a grid of axes 0 and 1; all other coordinates are 1/2.

    If `density` is None, values of f/p are returned instead of f, with p of the first technique.
    There is no picture of integrands that are costly or fail on the grid.
    """
    f = estimator.primary_integrand() if density is None else estimator.domain_integrand
    if f is None or f.costly:
        return {}
    shape = _picture_shape(f.dims)
    x = np.full((*shape, f.dims), 0.5)
    x[..., : len(shape)] = (np.moveaxis(np.indices(shape), 0, -1) + 0.5) / shape[0]
    names = tuple(f"x{axis}" for axis in range(len(shape)))
    try:
        values = np.asarray(f(x), dtype=float)
    except Exception:  # noqa: BLE001 - a user's f may raise anything; points need no picture of f
        return {}
    if values.ndim > len(shape):
        found = {"integrand_value": (("channel", *names), np.moveaxis(values, -1, 0))}
    else:
        found = {"integrand_value": (names, values)}
    if density is not None:
        found["density_value"] = (names, np.asarray(density.pdf(x)))
    return found


def _warped(subject: Subject) -> tuple[Sampler, Density | None]:
    """Return the sampler and the density. The density is that of `subject` or of its estimator."""
    given = subject.density
    if given is None:
        given = getattr(subject.estimator, "density", None)
    return subject.sampler, as_warp(given, subject.sampler.dims)


def _powers(transform: Transform, points: Array, weights: Array | None) -> Array:
    """Return |S_m|² of each set, (R, H)."""
    s = transform.coefficients(points, weights)
    return np.asarray(s.real**2 + s.imag**2)


def weighted_points(
    sampler: Sampler, density: Density | None, n: int, stream: Stream, block: Block
) -> tuple[Array, Array | None]:
    """Draw a block of warped points (R, n, d) with weights 1/(n p). None means weights 1/n."""
    points = sampler.draw_stream(n, stream, *block)
    if density is None:
        return points, None
    x = density.sample(points)
    equal = np.full((len(x), n), 1.0 / n)
    return x, divide_by_density(equal, density.pdf(x), x, density.spec, constant=True)


def spectrum_attributes(
    sampler: Sampler, density: Density | None, n: int, realizations: int, stream: Stream
) -> dict[str, Any]:
    """Return attributes that describe the point sets of a spectrum."""
    return {
        "sampler": sampler.spec,
        "density": None if density is None else density.spec,
        "n": n,
        "realizations": realizations,
        "student_t": student_t(realizations),
        "stream_key": f"{stream.key:#x}",
        "random_level": 1.0 if density is None else density.reciprocal_integral(),
        "convention": "power = <|S_m|^2>; random points: random_level/n, random_level = ∫1/p",
    }


@final
@dataclass
class PowerSums:
    """Sums over realizations of |S|² and optionally of S, by frequency."""

    power: MeanSums
    mean: SUM | None

    @staticmethod
    def zeros(size: int, mean: bool) -> PowerSums:
        """Return the sums before the first realization is added: all sums are zero."""
        return PowerSums(MeanSums.zeros(size), np.zeros(size, np.complex128) if mean else None)

    def take(self, s: Array) -> None:
        """Add the coefficients S (F,) of one set."""
        power_sums(s, False, self.power.total, self.power.squares, UNLABELLED, np.empty((1, 0)))
        if self.mean is not None:
            self.mean += s
        self.power.count += 1

    def coefficient(self, sets: int | None = None) -> tuple[Array, Array]:
        """Return mean S and its standard error, the root of mean |error|², for `sets` sets."""
        assert self.mean is not None
        count = self.power.count
        mean = self.mean / count
        independent = count if sets is None else min(count, sets)
        return mean, standard_error(self.power.total / count - np.abs(mean) ** 2, independent)


@final
@dataclass
class _SpectrumSums:
    """Sums of power by frequency, and sums of mean power over rings and wedges."""

    frequencies: PowerSums
    polar: MeanSums


@final
@dataclass(frozen=True)
class _PolarMeans:
    """Rings (and in two dims wedges) of frequencies, over which power is averaged."""

    # Index of the ring and wedge of each frequency of the half grid, int64 (H,).
    # The index is ring · (wedges + 1) + wedge. Frequencies outside all rings have the last index.
    # The last wedge of a ring holds corner frequencies: |m|/step is larger than the half width.
    label: Array
    cells: Array  # number of frequencies in each ring and wedge: (rings, wedges + 1)
    radius: Array  # mean |m|/step of each ring

    @staticmethod
    @functools.lru_cache(maxsize=4)  # cached because several samplers use the same grid
    def of(grid: FrequencyGrid, wedges: int) -> _PolarMeans:
        """Make the rings, and the wedges in two dims."""
        index = grid.indices()
        length = np.sqrt((index**2).sum(axis=1))
        ring = np.rint(length).astype(np.int64) - 1
        parts = wedges if grid.dims == 2 else 0
        wedge = np.full(len(ring), parts)
        if parts:
            inside = length <= grid.half_width
            wedge[inside] = wedge_labels(index[inside], parts)
        shape = (grid.half_width, parts + 1)
        used = (ring >= 0) & (ring < grid.half_width)
        label = np.where(used, ring * (parts + 1) + wedge, shape[0] * shape[1])
        cells = np.bincount(label[used], minlength=shape[0] * shape[1]).reshape(shape)
        sums = np.bincount(ring[used], length[used], minlength=shape[0])
        return _PolarMeans(label, cells, sums / np.maximum(cells.sum(axis=1), 1))

    @property
    def size(self) -> int:
        """Number of rings and wedges."""
        rings, wedges = self.cells.shape
        return int(rings + wedges - 1)

    def rings(self, values: Array) -> Array:
        """Return the sum over each ring, (rings,), of values (H,) at the frequencies."""
        return np.asarray(
            np.bincount(self.label, values)[:-1].reshape(self.cells.shape).sum(axis=1)
        )

    def add(self, sums: MeanSums, power: Array) -> None:
        """Add mean powers of rings and wedges, from sums by label. Empty wedges are NaN."""
        for own in power[:, :-1].reshape(-1, *self.cells.shape):
            with np.errstate(invalid="ignore"):
                rings = own.sum(axis=1) / self.cells.sum(axis=1)
                wedges = own[:, :-1].sum(axis=0) / self.cells[:, :-1].sum(axis=0)
            means = np.concatenate([rings, wedges])
            sums.total += means
            sums.squares += means * means


def wedge_labels(index: Array, wedges: int) -> Array:
    """Return the number of the wedge (range of directions) of each index, (H, 2).

    The wedges divide half a turn. Wedge 0 is centered on the axis m0.
    """
    turn = np.arctan2(index[:, 1], index[:, 0]) / np.pi
    return np.asarray(np.floor(turn * wedges + 0.5).astype(np.int64) % wedges)


def wedge_angles(wedges: int) -> tuple[str, Array, dict[str, str]]:
    """Return the angles of the wedge centers as a coordinate."""
    angle = np.arange(wedges) * 180.0 / wedges
    return "angle", angle, {"long_name": "direction", "units": "degrees"}
