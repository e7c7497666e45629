"""Transforms of weighted point sets, S_m = Σ_k w_k exp(−2πi m·x_k), behind one interface.

Engines
-------
``nufft``
    Type-1 non-uniform FFT. FINUFFT [Barnett2019]_ spreads points onto a fine grid.
    SciPy transforms this grid. Each Python thread reuses one plan of FINUFFT.
    Along each axis, the grid is 1.25 times as fine as the frequencies.
    If there are many points per frequency, the grid is twice as fine as the frequencies.
    The relative l2 error is 1e-9. For ``eps=1e-12`` the grid is twice as fine.
    On a grid twice as fine, the transform of 512² frequencies takes 2.3 times as long.

    Single precision halves the time. Its error is at best 1e-6 of the peak.
    On a grid only 1.12 times as fine, the error is 1e-5 and the time a fifth less.
    Coordinates are rounded to 2^-25 in single precision.

    Real frequencies on a grid of step s are integer frequencies of the coordinates s·x.
    Two realizations with weights w_1 and w_2 share one transform, with the weights w_1 + i w_2.
    Hermitian symmetry then separates the transforms of the two realizations.
    The cost is O(n log^d(1/eps) + M log M) per pair, for n points and M frequencies.
    In four dims there is one 3-D transform for each frequency of the first axis.
    In four dims, realizations are transformed one at a time.
``direct``
    Direct summation by matrix products, axis by axis. It is exact to rounding, and costs O(n M).
    Direct summation is the reference for tests, and it is faster if there are few points.
``auto``
    The engine is ``nufft``, except in three cases in which the direct engine is used.
    If n M < 4000, the direct engine is about a microsecond faster than FINUFFT.
    In four dims, the direct engine is used for fewer than about 1000 points.
    In more than four dims, the direct engine is always used.

Real weights imply S_{−m} = conj S_m, so results cover only *half* of the grid:
m = 0, and all frequencies before m = 0 if the grid is flattened in C order.
"""

from __future__ import annotations

import functools
import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import MAX_FREQUENCY, Array, as_choice, as_integer, as_real
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.spectra._kernels import UNLABELLED, crop_scaled, pair_mean, power_sums, split_pair

__all__ = [
    "ENGINES",
    "MAX_FREQUENCIES",
    "FrequencyGrid",
    "IndexGrid",
    "Transform",
    "direct_sum",
    "given_or_equal",
]

ENGINES = ("auto", "nufft", "direct")
_DIRECT_BELOW = 4000
_DIRECT_NUMBERS = 2**22  # number of phases in memory at a time: 64 MiB
# Below 1/16 point per frequency, FINUFFT spreads the points to its grid in groups of 1024
_SPARSE = 1 / 16
_SPREAD_POINTS = 1024
# Time of the FFT per cell of the grid, divided by the time to add a point to one cell; measured.
_CELL_COST = 50.0
_LEAST_FINE = 32  # least number of cells of the fine grid per axis, more than the width of a kernel

MAX_FREQUENCIES = 2**27
"""Largest number of frequencies of one grid, which takes 2 GiB of complex128."""


@dataclass(frozen=True)
class IndexGrid:
    """Multi-indices m of coefficients, in C order. Each axis has the same indices.

    Attributes
    ----------
    dims, half_width
        Number of dims d and half width K.
    """

    dims: int
    half_width: int
    label: ClassVar[str] = "index of the basis function"
    units: ClassVar[str] = "1"
    hermitian: ClassVar[bool] = False
    """Whether indices run from −K to K, and coefficient −m is the conjugate of coefficient m.

    With this symmetry, only the coefficients up to and including m = 0 are stored."""

    @property
    def side(self) -> int:
        """Number N of indices along one axis."""
        return 2 * self.half_width + 1

    @property
    def axis(self) -> Array:
        """Indices along one axis, as coordinates: (N,)."""
        return np.arange(self.side) - self.half_width * self.hermitian

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole array of coefficients."""
        return (self.side,) * self.dims

    @property
    def size(self) -> int:
        """Number M of indices."""
        return int(self.side**self.dims)

    @property
    def stored(self) -> int:
        """Number of stored coefficients: all, or only half if symmetry determines the others."""
        return (self.size + 1) // 2 if self.hermitian else self.size

    @property
    def dc(self) -> int:
        """Position of m = 0 among the stored coefficients."""
        return self.stored - 1 if self.hermitian else 0

    @property
    def double(self) -> Array:
        """Number of indices that each stored coefficient represents, as float64 (stored,)."""
        twice = np.full(self.stored, 2.0 if self.hermitian else 1.0)
        twice[self.dc] = 1.0
        return twice

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the dims, m0, m1, …"""
        return tuple(f"m{i}" for i in range(self.dims))

    @property
    def coords(self) -> dict[str, Any]:
        """Coordinate arrays of the dims m0, m1, … with their labels and units."""
        attributes = {"long_name": self.label, "units": self.units}
        return {name: (name, self.axis, attributes) for name in self.names}

    def indices(self) -> Array:
        """Index m of each stored coefficient: int64 (stored, dims)."""
        places = np.unravel_index(np.arange(self.stored), self.shape)
        return np.asarray(np.stack(places, axis=-1) - self.half_width * self.hermitian)

    def full(self, stored: Array, *, conjugate: bool = False) -> Array:
        """Extend stored values (..., stored) by symmetry to the whole array (..., *shape)."""
        if self.hermitian:
            mirrored = stored[..., -2::-1]
            stored = np.concatenate([stored, mirrored.conj() if conjugate else mirrored], axis=-1)
        return stored.reshape(*stored.shape[:-1], *self.shape)

    def pick(self, full: Array) -> Array:
        """Return the stored values (stored, ...) of a whole array (*shape, ...). Inverts `full`."""
        return full.reshape(self.size, *full.shape[self.dims :])[: self.stored]

    def whole(self) -> tuple[Array, Array]:
        """Return the stored position of each index in C order, and whether it is a conjugate."""
        place = np.arange(self.size)
        return np.where(place < self.stored, place, self.size - 1 - place), place >= self.stored


@final
@dataclass(frozen=True)
class FrequencyGrid(IndexGrid):
    """Frequencies step · {−half_width … half_width}^dims.

    Raises
    ------
    ParameterError
        If a field is out of range, or the grid has more than `MAX_FREQUENCIES` frequencies.
    """

    step: float = 1.0
    label: ClassVar[str] = "frequency"
    units: ClassVar[str] = "cycles per unit"
    hermitian: ClassVar[bool] = True

    def __post_init__(self) -> None:
        as_integer("dims of a frequency grid", self.dims, least=1, most=16)
        as_integer("half_width", self.half_width, least=0, most=MAX_FREQUENCIES)
        as_real("frequency_step", self.step, above=0.0, most=MAX_FREQUENCY / MAX_FREQUENCIES)
        if self.size > MAX_FREQUENCIES:
            raise ParameterError(
                Parameter("half_width"),
                f" {self.half_width} in {self.dims} dims is {self.size:.3g} frequencies, "
                f"{16 * self.size / 2**30:.3g} GiB a spectrum; use at most {MAX_FREQUENCIES:.3g}: ",
                Parameter("half_width"),
                f" ≤ {int((MAX_FREQUENCIES ** (1 / self.dims) - 1) // 2)} here.",
            )

    @property
    def axis(self) -> Array:
        """Frequencies along one axis, as float64. They are integers if the step is 1."""
        index = np.arange(-self.half_width, self.half_width + 1)
        return index if self.step == 1.0 else index * self.step


class Transform:
    """Transforms of blocks of realizations on one frequency grid.

    Parameters
    ----------
    grid
        The frequencies.
    n
        Number of points in a set. With ``engine="auto"`` it determines the engine.
    engine
        One of `ENGINES`.
    eps
        Relative l2 accuracy of the NUFFT, from 1e-14 to 1e-1.
    single
        Whether the NUFFT uses single precision, in one to three dims. Other engines never do.

    Raises
    ------
    ParameterError
        If a value is out of range, or the engine does not support these dims.

    Notes
    -----
    Instances are thread-safe: each thread has its own plan.
    """

    def __init__(
        self,
        grid: FrequencyGrid,
        n: int,
        *,
        engine: str = "auto",
        eps: float = 1e-9,
        single: bool = False,
    ) -> None:
        as_choice("engine", engine, ENGINES)
        self.eps = as_real("eps", eps, least=1e-14, most=0.1)
        if engine == "nufft" and grid.dims > 4:
            raise ParameterError(
                f"The nufft engine works in 1 to 4 dims, not {grid.dims}; use ",
                Parameter("engine", "direct"),
                ".",
            )
        if engine == "auto":  # limits follow from times measured on one core
            slab = float(grid.size // grid.shape[0])
            pays = n * grid.size < _DIRECT_BELOW
            if grid.dims > 3:
                pays = grid.dims > 4 or n * slab < 9000.0 * n + 800.0 * slab
            engine = "direct" if pays else "nufft"
        self.engine = engine
        self.grid = grid
        dims = min(grid.dims, 3)
        density = (2 if grid.dims <= 3 else 1) * n / np.prod(grid.shape[-3:])
        self._sparse = density < _SPARSE
        self._packs = engine == "nufft" and grid.dims <= 3
        self.single = single and self._packs
        # A finer grid is more accurate. Its transform takes longer, but spreading takes less time.
        # In double precision, a point is spread to 11 cells per axis of a finer grid.
        # On a coarser grid, a point is spread to 15 cells per axis
        spreading = 0.0 if self.single else density * (15.0**dims - 11.0**dims)
        finer = self.eps < 1e-9 or spreading > _CELL_COST * (2.0**dims - 1.25**dims)
        coarse = 1.12 if self.single and self.eps >= 1e-5 else 1.25
        self._oversampling = 2.0 if finer else coarse
        self._number: Any = np.complex64 if self.single else np.complex128
        self._local = threading.local()

    def coefficients(self, points: Array, weights: Array | None = None) -> Array:
        """Return S_m on the half grid: complex128 (R, H).

        Parameters
        ----------
        points
            (R, n, d) in [0,1).
        weights
            Real weights (R, n). None means 1/n for each point.
        """
        weights = given_or_equal(weights, points)
        out = np.empty((len(points), self.grid.stored), np.complex128)
        r = 0
        for packed, pair in self._packed(points, weights):
            if pair:
                split_pair(packed, out[r], out[r + 1])
            else:
                out[r] = packed[: out.shape[1]]
            r += 1 + pair
        # Set S_0 to the exact sum of the weights, so that equal weights have no dc term
        out[:, -1] = weights.sum(axis=1)
        return out

    def add_power(
        self,
        points: Array,
        weights: Array | None,
        total: Array,
        squares: Array,
        mean: Array | None = None,
        label: Array = UNLABELLED,
        groups: Callable[[Array], None] | None = None,
    ) -> None:
        """Add the sums over a block of |S_m|², |S_m|⁴ and S_m to the given arrays (H,).

        The function `groups` gets the sums of |S_m|² over all frequencies with the same label.
        The sums have shape (sets, number of labels), for one or two sets.
        """
        # Use the exact sum of the weights for S_0
        sums = given_or_equal(weights, points).sum(axis=1)
        at_zero = total[-1] + (sums**2).sum(), squares[-1] + (sums**4).sum()
        mean_at_zero = 0.0 if mean is None else mean[-1] + sums.sum()
        labels = 1 + int(label.max(initial=-1))
        for packed, pair in self._packed(points, weights):
            grouped = np.zeros((1 + pair, labels))
            power_sums(packed, pair, total, squares, label, grouped)
            if mean is not None and pair:
                pair_mean(packed, mean)
            elif mean is not None:
                mean += packed[: mean.size]
            if groups is not None:
                groups(grouped)
        total[-1], squares[-1] = at_zero
        if mean is not None:
            mean[-1] = mean_at_zero

    def _packed(self, points: Array, weights: Array | None) -> Iterator[tuple[Array, bool]]:
        """Yield transforms of the sets on the full grid, and whether each one is of two sets.

        The transform of two sets is S1 + i S2, and the transform of a single set is S1.
        Each transform is a flat array, which is valid until the next one is requested.
        For a single set, only half of the grid needs to be filled.
        """
        sets, n, dims = points.shape
        weights = given_or_equal(weights, points)
        paired = sets - sets % 2 if self._packs else 0
        strengths = weights[:paired].reshape(paired // 2, 2 * n).astype(self._number)
        strengths[:, n:] *= 1j
        both = points[:paired].reshape(paired // 2, 2 * n, dims)
        yield from ((self._nufft(*pair), True) for pair in zip(both, strengths, strict=True))
        for x, w in zip(points[paired:], weights[paired:], strict=True):
            if self.engine == "direct":
                yield self._direct(x, w), False
            elif self._packs:
                yield self._nufft(x, w.astype(self._number)), False
            else:
                yield self._slabs(x, w.astype(np.complex128)), False

    def _nufft(self, points: Array, strengths: Array) -> Array:
        """Return the flat full-grid transform of a set (n, d). It is valid until the next call."""
        if getattr(self._local, "out", None) is None:
            self._local.out = np.empty(self.grid.shape, self._number)
        self._set_points(points)
        return self._execute(strengths, self._local.out)

    def _slabs(self, points: Array, strengths: Array) -> Array:
        """Transform a set in four dims. For each m0 ≤ 0, apply phases and transform three axes."""
        grid = self.grid
        self._set_points(points[:, 1:])
        out = np.empty((grid.half_width + 1, *grid.shape[1:]), np.complex128)
        for slab, index in enumerate(range(-grid.half_width, 1)):
            phase = np.exp((-2j * np.pi * grid.step * index) * points[:, 0])
            self._execute(strengths * phase, out[slab])
        return out.ravel()

    def _set_points(self, points: Array) -> None:
        """Set the points (n, up to 3) in the plan of this thread."""
        local = self._local
        if getattr(local, "plan", None) is None:
            local.plan = self._new_plan(self._fine)
            local.fine = np.empty(self._fine, self._number)
        real = local.fine.real.dtype
        local.plan.setpts(
            *((2.0 * np.pi * self.grid.step * axis).astype(real) for axis in points.T)
        )

    def _execute(self, strengths: Array, out: Array) -> Array:
        """Transform the current points to `out`, a grid of frequencies, and return it flat.

        FINUFFT only spreads the points. Its own FFT is FFTW, which would not be reproducible:
        FFTW chooses fast plans by measured times, which vary from run to run.
        SciPy's FFT computes only the frequencies that are needed.
        On a grid of 648², it takes half the time of reproducible FFTW plans.
        """
        from scipy.fft import fft

        local = self._local
        local.plan.execute(strengths, out=local.fine)
        rows, row_factors, factors = self._unspread
        width = self.grid.half_width
        found = fft(local.fine, overwrite_x=True, workers=1)
        halves: Any = found[..., found.shape[-1] - width :], found[..., : width + 1]
        for axis in range(found.ndim - 1):
            halves = [fft(each, axis=axis, overwrite_x=True, workers=1) for each in halves]
        negative, others = (each.reshape(-1, each.shape[-1]) for each in halves)
        crop_scaled(negative, others, rows, row_factors, factors, out.reshape(-1, len(factors)))
        return np.asarray(out.ravel())

    @functools.cached_property
    def _fine(self) -> tuple[int, ...]:
        """Shape of the fine grid for the FFT. In four dims, it has only the last three dims."""
        from scipy.fft import next_fast_len

        side = max(math.ceil(self._oversampling * self.grid.shape[0]), _LEAST_FINE)
        return (next_fast_len(side),) * min(self.grid.dims, 3)

    @functools.cached_property
    def _unspread(self) -> tuple[Array, Array, Array]:
        """Rows of the fine grid that hold the frequencies, and factors that undo spreading."""
        dims, side = len(self._fine), self._fine[0]
        # The spreading kernel along an axis also depends on the number of axes.
        # Measure the spreading kernel on a grid that has as many axes as the fine grid.
        # To save time, all axes but the last are as short as possible.
        # If the last axis has odd length, all other axes have odd length too.
        # To undo the spreading, transforms are divided by the Fourier coefficients of the kernel
        plan = self._new_plan((_LEAST_FINE + side % 2,) * (dims - 1) + (side,))
        origin = np.zeros((dims, 1), np.zeros(0, self._number).real.dtype)
        plan.setpts(*origin)
        spread = plan.execute(np.ones(1, self._number)).real.astype(np.float64)
        line = spread.reshape(-1, side).sum(axis=0) / spread.sum() ** (1 - 1 / dims)
        index = np.arange(-self.grid.half_width, self.grid.half_width + 1) % side
        factors = (1.0 / np.fft.fft(line).real[index]).astype(origin.dtype)
        rows, row_factors = np.zeros(1, np.int64), np.ones_like(factors[:1])
        for _ in range(dims - 1):
            rows = (rows[:, None] * side + index).ravel()
            row_factors = np.multiply.outer(row_factors, factors).ravel()
        return rows, row_factors, factors

    def _new_plan(self, shape: tuple[int, ...]) -> Any:
        """Return a FINUFFT plan that spreads points onto a fine grid."""
        import finufft

        # With spread_sort=2, FINUFFT sorts the points or not, depending on their density.
        # At low density, points are spread in groups, to parts of the grid that fit into the cache.
        # With spread_sort=0, FINUFFT spreads all points at once, without sorting
        return finufft.Plan(
            1,
            shape,
            eps=self.eps,
            isign=-1,
            upsampfac=self._oversampling,
            nthreads=1,
            spread_sort=2,
            spread_max_sp_size=_SPREAD_POINTS if self._sparse else 0,
            showwarn=0,
            dtype=self._number,
            spreadinterponly=1,
        )

    def _direct(self, points: Array, weights: Array) -> Array:
        """Sum directly: multiply the phases of the first axes by the phases of the other axes.

        Half of the axes go into each product. In four dims each product has n (2K+1)² numbers.
        Points are processed in blocks, so that each product has at most `_DIRECT_NUMBERS` numbers.
        """
        grid = self.grid
        split = max(1, grid.dims // 2)
        side = 2 * grid.half_width + 1
        used = (side**split + 1) // 2  # number of rows in half of the grid
        total = np.zeros((used, side ** (grid.dims - split)), np.complex128)
        block = max(1, _DIRECT_NUMBERS // max(total.shape))
        for low in range(0, len(points), block):
            x = points[low : low + block]
            left = self._phases(x[:, :split])[:, :used]
            right = self._phases(x[:, split:]) * weights[low : low + block, None]
            total += left.T @ right
        return np.asarray(total.ravel()[: grid.stored])

    def _phases(self, points: Array) -> Array:
        """Return exp(−2πi m·x) at points (n, k) for all m of the grid in k dims: (n, (2K+1)^k)."""
        grid = self.grid
        index = np.arange(-grid.half_width, grid.half_width + 1)
        found = np.ones((len(points), 1), np.complex128)
        for x in points.T:
            phase = np.exp((-2j * np.pi * grid.step) * np.outer(x, index))
            found = (found[:, :, None] * phase[:, None, :]).reshape(len(points), -1)
        return found


def given_or_equal(weights: Array | None, points: Array) -> Array:
    """Return the weights (R, n) of points (R, n, d). Without given weights, return 1/n."""
    return np.broadcast_to(1.0 / points.shape[1], points.shape[:2]) if weights is None else weights


def direct_sum(points: Array, frequencies: Array, weights: Array | None = None) -> Array:
    """Return S at listed frequencies by its definition, in any dims, as the reference for tests.

    Parameters
    ----------
    points
        Points of shape (..., n, d).
    frequencies
        Real frequencies of shape (F, d).
    weights
        Weights of shape (..., n); None means 1/n for each point.

    Returns
    -------
    ndarray
        complex128 (..., F). Cost and memory are O(n F) per set.
    """
    phase = np.exp(-2j * np.pi * (points @ np.asarray(frequencies, np.float64).T))
    if weights is None:
        return np.asarray(phase.mean(axis=-2))
    return np.asarray((weights[..., None] * phase).sum(axis=-2))
