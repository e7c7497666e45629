"""Transforms of weighted point sets, S_m = Σ_k w_k exp(−2πi m·x_k), behind one interface.

Engines
-------
``nufft``
    Type-1 non-uniform FFT (FINUFFT [Barnett2019]_), one thread and one reused plan for each Python
    thread, with ``upsampfac=1.25`` (its default of 2 costs 3.6 times more at 512², measured on one
    core). Relative l2 error 1e-9, at ``eps=1e-12`` with ``upsampfac=2``. Real frequencies on a
    grid of step s are integer ones of the coordinates s·x. Two realisations share a transform:
    weights w of the first plus i times w of the second, separated by Hermitian symmetry. Cost
    O(n log^d(1/eps) + M log M) for a pair. Four dims are 3-D transforms for each frequency of the first
    axis, of one realisation at a time.
``gpu``
    The same transforms by cuFINUFFT (`mcspectra.spectra.gpu`): one to three dims, results equal to
    rounding and not bit for bit. Only on request.
``direct``
    Separable direct summation by matrix products, exact to rounding: the oracle, and the faster
    one for a handful of points. Cost O(n M).
``auto``
    Direct where n M < 4000 (about a microsecond's worth of arithmetic below a plan call), in four dims
    below about a thousand points, and beyond four; else NUFFT.

Real weights make S_{−m} = conj S_m, so results cover *half* the grid: the flat C-order indices up
to and including that of m = 0, which comes last.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from mcspectra.core.checks import MAX_FREQUENCY, Array, as_choice, as_integer, as_real
from mcspectra.core.errors import ParameterError
from mcspectra.spectra._kernels import pair_mean, power_sums, split_pair
from mcspectra.spectra.gpu import GpuTransform

__all__ = ["ENGINES", "MAX_FREQUENCIES", "FrequencyGrid", "Transform", "direct_sum"]

ENGINES = ("auto", "nufft", "direct", "gpu")
_DIRECT_BELOW = 4000
_DIRECT_NUMBERS = 2**22  # 64 MiB of phases
_SPARSE = 1 / 16  # points for each frequency below which spreading in parts is faster
_SPREAD_POINTS = 1024
MAX_FREQUENCIES = 2**27
"""Most frequencies of one grid: 2 GiB of complex128."""


@dataclass(frozen=True)
class FrequencyGrid:
    """Frequencies step · {−half_width … half_width}^dims.

    Raises
    ------
    ParameterError
        A field is out of range, or the grid has more than `MAX_FREQUENCIES` frequencies.
    """

    dims: int
    half_width: int
    step: float = 1.0

    def __post_init__(self) -> None:
        as_integer("dims of a frequency grid", self.dims, least=1, most=16)
        as_integer("half_width", self.half_width, least=0, most=MAX_FREQUENCIES)
        as_real("frequency_step", self.step, above=0.0, most=MAX_FREQUENCY / MAX_FREQUENCIES)
        if self.size > MAX_FREQUENCIES:
            raise ParameterError(
                f"half_width {self.half_width} in {self.dims} dims is {self.size:.3g} frequencies, "
                f"{16 * self.size / 2**30:.3g} GiB a spectrum; use at most {MAX_FREQUENCIES:.3g}: "
                f"half_width ≤ {int((MAX_FREQUENCIES ** (1 / self.dims) - 1) // 2)} here."
            )

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the full grid."""
        return (2 * self.half_width + 1,) * self.dims

    @property
    def size(self) -> int:
        """M, number of frequencies of the full grid."""
        return int((2 * self.half_width + 1) ** self.dims)

    @property
    def half_size(self) -> int:
        """Number of frequencies of the half grid, m = 0 included (last)."""
        return (self.size + 1) // 2

    @property
    def axis(self) -> Array:
        """Frequencies along one axis, float64 (or integer where the step is 1)."""
        index = np.arange(-self.half_width, self.half_width + 1)
        return index if self.step == 1.0 else index * self.step

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the frequency dims, m0, m1, …"""
        return tuple(f"m{i}" for i in range(self.dims))

    @property
    def coords(self) -> dict[str, Any]:
        """Coordinates of the frequency dims, with units."""
        attributes = {"long_name": "frequency", "units": "cycles per unit"}
        return {name: (name, self.axis, attributes) for name in self.names}

    def half_indices(self) -> Array:
        """Integer indices m/step of the half grid: int64 (half_size, dims)."""
        flat = np.arange(self.half_size)
        index = np.stack(np.unravel_index(flat, self.shape), axis=-1)
        return np.asarray(index - self.half_width)

    def full(self, half: Array, *, conjugate: bool = False) -> Array:
        """Extend half-grid values (..., H) to the full grid (..., *shape): even or Hermitian."""
        mirrored = half[..., -2::-1]
        whole = np.concatenate([half, mirrored.conj() if conjugate else mirrored], axis=-1)
        return whole.reshape(*half.shape[:-1], *self.shape)

    def half(self, full: Array) -> Array:
        """Restrict full-grid values (*shape, ...) to the half grid: (H, ...)."""
        return full.reshape(self.size, *full.shape[self.dims :])[: self.half_size]


class Transform:
    """Transforms of blocks of realisations on one frequency grid.

    Parameters
    ----------
    grid
        The frequencies.
    n
        Points in a set: decides between the engines for ``engine="auto"``.
    engine
        One of `ENGINES`; ``"auto"`` never means ``"gpu"``.
    eps
        Relative l2 accuracy of the NUFFT, from 1e-14 to 1e-1.

    Raises
    ------
    ParameterError
        A value is out of range, or the engine does not work in these dims.
    MissingDependency
        The engine is ``"gpu"`` and its packages or a device are missing.

    Notes
    -----
    Thread-safe: each thread has a plan of its own.
    """

    def __init__(
        self, grid: FrequencyGrid, n: int, *, engine: str = "auto", eps: float = 1e-9
    ) -> None:
        as_choice("engine", engine, ENGINES)
        self.eps = as_real("eps", eps, least=1e-14, most=0.1)
        if engine == "nufft" and grid.dims > 4:
            raise ParameterError(
                f"The nufft engine works in 1 to 4 dims, not {grid.dims}; use engine='direct'."
            )
        if engine == "auto":
            engine = "direct" if _direct_pays(grid, n) else "nufft"
        self.engine = engine
        self.grid = grid
        self._sparse = (2 if grid.dims <= 3 else 1) * n < _SPARSE * np.prod(grid.shape[-3:])
        self._packs = engine == "gpu" or (engine == "nufft" and grid.dims <= 3)
        self._gpu = GpuTransform(grid.shape, grid.step, self.eps) if engine == "gpu" else None
        self._local = threading.local()

    def coefficients(self, points: Array, weights: Array | None = None) -> Array:
        """S_m on the half grid: complex128 (R, H).

        Parameters
        ----------
        points
            (R, n, d) in [0,1).
        weights
            Real weights (R, n); None means 1/n each.
        """
        sets, n, _ = points.shape
        if weights is None:
            weights = np.broadcast_to(1.0 / n, (sets, n))
        out = np.empty((sets, self.grid.half_size), np.complex128)
        paired = sets - sets % 2 if self._packs else 0
        for k, packed in enumerate(self._pairs(points[:paired], weights[:paired])):
            split_pair(packed, out[2 * k], out[2 * k + 1])
        for r in range(paired, sets):
            out[r] = self._single(points[r], weights[r])[: out.shape[1]]
        # S_0 is the sum of the weights: exactly, so that equal weights have no dc term.
        out[:, -1] = weights.sum(axis=1)
        return out

    def add_power(
        self,
        points: Array,
        weights: Array | None,
        total: Array,
        squares: Array,
        mean: Array | None = None,
        groups: Callable[[Array, bool], None] | None = None,
    ) -> None:
        """Add Σ_r |S_m|² and Σ_r |S_m|⁴ of a block to `total` and `squares`, Σ_r S_m to `mean`: (H,).

        `groups` takes every transform over the full grid, and whether it is of a pair: S1 + i S2.
        """
        sets, n, _ = points.shape
        if weights is None:
            weights = np.broadcast_to(1.0 / n, (sets, n))
        paired = sets - sets % 2 if self._packs else 0
        for packed in self._pairs(points[:paired], weights[:paired]):
            power_sums(packed, True, total, squares)
            if mean is not None:
                pair_mean(packed, mean)
            if groups is not None:
                groups(packed, True)
        for r in range(paired, sets):
            single = self._single(points[r], weights[r])
            power_sums(single, False, total, squares)
            if mean is not None:
                mean += single[: mean.size]
            if groups is not None:
                groups(single, False)

    def _single(self, points: Array, weights: Array) -> Array:
        """Transform of one set, of which at least the half grid is there."""
        if self.engine == "direct":
            return self._direct(points, weights)
        strengths = weights.astype(np.complex128)
        if not self._packs:
            return self._slabs(points, strengths)
        return next(self._transforms(points[None], strengths[None]))

    def _pairs(self, points: Array, weights: Array) -> Iterator[Array]:
        """Transforms of sets 2k plus i times sets 2k + 1, full grid, flat."""
        sets, n, dims = points.shape
        strengths = weights.reshape(sets // 2, 2 * n).astype(np.complex128)
        strengths[:, n:] *= 1j
        return self._transforms(points.reshape(sets // 2, 2 * n, dims), strengths)

    def _transforms(self, points: Array, strengths: Array) -> Iterator[Array]:
        """Transforms of sets (T, n, d), full grid, flat: each is valid until the next is asked for."""
        if self._gpu is not None:
            return self._gpu.transforms(points, strengths)
        return map(self._nufft, points, strengths)

    def _nufft(self, points: Array, strengths: Array) -> Array:
        plan = self._plan_at(points)
        out = getattr(self._local, "out", None)
        if out is None:
            out = self._local.out = np.empty(self.grid.shape, np.complex128)
        plan.execute(strengths, out=out)
        return np.asarray(out.ravel())

    def _slabs(self, points: Array, strengths: Array) -> Array:
        """Four dims: for each m0 ≤ 0 the phases of the first axis, then a transform of the others."""
        grid = self.grid
        plan = self._plan_at(points[:, 1:])
        out = np.empty((grid.half_width + 1, *grid.shape[1:]), np.complex128)
        for slab, index in enumerate(range(-grid.half_width, 1)):
            phase = np.exp((-2j * np.pi * grid.step * index) * points[:, 0])
            out[slab] = plan.execute(strengths * phase)
        return out.ravel()

    def _plan_at(self, points: Array) -> Any:
        """Return this thread's plan, with its points (n, up to 3) set."""
        plan = getattr(self._local, "plan", None)
        if plan is None:
            plan = self._local.plan = self._new_plan(self.grid.shape[-points.shape[1] :])
        plan.setpts(*(2.0 * np.pi * self.grid.step * axis for axis in points.T))
        return plan

    def _new_plan(self, shape: tuple[int, ...]) -> Any:
        import finufft

        # 1.25 cannot reach below 1e-9; spread_sort=2 lets FINUFFT decide by density of points. Few
        # points are spread by parts of the fine grid that fit into the cache (0: all at once).
        upsampling = 1.25 if self.eps >= 1e-9 else 2.0
        return finufft.Plan(
            1,
            shape,
            eps=self.eps,
            isign=-1,
            upsampfac=upsampling,
            nthreads=1,
            spread_sort=2,
            spread_max_sp_size=_SPREAD_POINTS if self._sparse else 0,
            showwarn=0,
        )

    def _direct(self, points: Array, weights: Array) -> Array:
        """Separable sum: a matrix product of the phases along the first axes with those of the rest.

        Axes are divided evenly, so that in four dims the factors have n (2K+1)² numbers; points are
        taken in blocks that keep them below `_DIRECT_NUMBERS`.
        """
        grid = self.grid
        split = max(1, grid.dims // 2)
        side = 2 * grid.half_width + 1
        used = (side**split + 1) // 2  # rows of the half grid
        total = np.zeros((used, side ** (grid.dims - split)), np.complex128)
        block = max(1, _DIRECT_NUMBERS // max(total.shape))
        for low in range(0, len(points), block):
            x = points[low : low + block]
            left = self._phases(x[:, :split])[:, :used]
            right = self._phases(x[:, split:]) * weights[low : low + block, None]
            total += left.T @ right
        return np.asarray(total.ravel()[: grid.half_size])

    def _phases(self, points: Array) -> Array:
        """exp(−2πi m·x) of points (n, any) on the grid of as many dims: (n, (2K+1)^any)."""
        grid = self.grid
        index = np.arange(-grid.half_width, grid.half_width + 1)
        found = np.ones((len(points), 1), np.complex128)
        for x in points.T:
            phase = np.exp((-2j * np.pi * grid.step) * np.outer(x, index))
            found = (found[:, :, None] * phase[:, None, :]).reshape(len(points), -1)
        return found


def _direct_pays(grid: FrequencyGrid, n: int) -> bool:
    """Whether direct summation of n points is faster, by times measured on one core."""
    if grid.dims <= 3:
        return n * grid.size < _DIRECT_BELOW
    slab = float(grid.size // grid.shape[0])
    return grid.dims > 4 or n * slab < 9000.0 * n + 800.0 * slab


def direct_sum(points: Array, frequencies: Array, weights: Array | None = None) -> Array:
    """S at listed frequencies by the definition, for any dims: the oracle of the tests.

    Parameters
    ----------
    points
        (..., n, d).
    frequencies
        (F, d), real.
    weights
        (..., n); None means 1/n each.

    Returns
    -------
    ndarray
        complex128 (..., F). Cost and memory O(n F) for each set.
    """
    phase = np.exp(-2j * np.pi * (points @ np.asarray(frequencies, np.float64).T))
    if weights is None:
        return np.asarray(phase.mean(axis=-2))
    return np.asarray((weights[..., None] * phase).sum(axis=-2))
