"""Expected power at listed frequencies, which may be real or integer, in any number of dims.

Grids of frequencies are limited to a few dims; lists are not.
A list can be a slice along an axis, or a plane of two axes (the spectrum of a projection).
A list can also contain all frequencies of one ANOVA subset of the axes.
`power_at` takes any list. Functions such as `axis_frequencies` return float64 lists (F, d).
On axes and diagonals, the list contains ν but not −ν, since S_{−ν} = conj S_ν.

Engines
-------
``direct``
    Sums of n · F phases, computed only from the nonzero components of each frequency.
    If frequencies share components, their phases are products of tabulated factors.
    The sums are exact up to rounding.
``nufft``
    FINUFFT's type 3 [Barnett2019]_ in one to three dims, with a relative l2 error of about `eps`.
    The cost is O(n + F) with a large constant.
    An FFT on a grid that covers all frequencies adds to the cost.
``auto``
    The engine that is expected to be faster. The expected times are based on measurements.
    In three or more dims ``direct`` is used, because type 3 is not faster there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import (
    MAX_DIMS,
    MAX_FREQUENCY,
    Array,
    as_choice,
    as_integer,
    as_real,
)
from mcspectra.core.display import shown
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.memory import check_memory, memory_of
from mcspectra.core.parallel import (
    MAX_REALIZATIONS,
    Block,
    available_workers,
    map_in_order,
    realization_blocks,
)
from mcspectra.core.records import merged
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.densities import Density
from mcspectra.samplers import Sampler
from mcspectra.samplers.law import independent_sets
from mcspectra.spectra._listed_kernels import phase_sum, product_sum
from mcspectra.spectra.closed_forms import points_at
from mcspectra.spectra.power import PowerSums, spectrum_attributes, weighted_points
from mcspectra.spectra.transforms import given_or_equal

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "MAX_LISTED",
    "axis_frequencies",
    "diagonal_frequencies",
    "listed_transform",
    "plane_frequencies",
    "power_at",
    "subset_frequencies",
]

Listed = Callable[[Array, Array], Array]
"""Function of points (n, d) and weights (n,) of one set. It returns S (F,)."""

_ENGINES = ("auto", "nufft", "direct")
_MAX_FACTORS = 4096
"""Largest number of factors in a table. The table takes 4 KiB per factor."""

MAX_LISTED = 2**27
"""Largest number of coordinates (F times d) in a list of frequencies, which take 1 GiB."""


def power_at(
    sampler: Sampler | str,
    n: int,
    frequencies: Any,
    *,
    density: Density | str | None = None,
    realizations: int = 100,
    rng: RngLike = 0,
    engine: str = "auto",
    eps: float = 1e-9,
    workers: int | None = None,
) -> xr.Dataset:
    """Estimate the expected power ⟨|S_ν|²⟩ and the mean ⟨S_ν⟩ at listed frequencies, in any dims.

    Parameters
    ----------
    sampler, n
        Sampler (or spec string, which gets the dims of `frequencies`) and number of points.
    frequencies
        Real frequencies ν, shape (F, d), in cycles per unit.
        Functions such as `axis_frequencies` make lists of slices, planes and subsets.
    density
        Importance density p (or spec string). Points are warped and get the weights 1/(n p).
    realizations
        Number of realizations for the average. Standard errors need at least 2.
    rng
        Seed (SPEC 7).
    engine, eps
        Engine (``auto``, ``direct`` or ``nufft``) and its accuracy; nufft works in 1 to 3 dims.
    workers
        Number of threads. The default is all processors. Results do not depend on it.

    Returns
    -------
    xarray.Dataset
        Power, the complex mean of S, and their standard errors, on the dim ``frequency``.
        The variables are ``power``, ``power_se``, ``mean_coefficient``, ``mean_coefficient_se``.
        The coordinates m_0, m_1, … are the components of each frequency.
        Standard errors are computed as in `power_spectrum`.

    Raises
    ------
    ParameterError
        If a value is out of range, or dims disagree.
    ConfigError
        If more memory is needed than is available.

    Notes
    -----
    Memory: 32 F bytes per thread, independent of the number of realizations.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> found = mcs.spectra.power_at("latin-hypercube", 64, [[1, 0], [1, 1]], realizations=200)
    >>> (64 * found["power"] > 0.5).values
    array([False,  True])
    """
    source, p, nu = points_at(sampler, frequencies, density)
    if nu.ndim != 2:
        raise ParameterError(
            f"frequencies have shape {nu.shape}; give a list of shape (F, {nu.shape[-1]}): "
            f"frequencies.reshape(-1, {nu.shape[-1]})."
        )
    n = source.check_count(n)
    realizations = as_integer("realizations", realizations, least=1, most=MAX_REALIZATIONS)
    check_memory(memory_of(n, max(source.dims, nu.shape[1]), 1, len(nu)), "power_at")
    transform, chosen = listed_transform(nu, n, engine=engine, eps=eps)
    stream = Stream.from_rng(rng)

    def block_sums(block: Block) -> PowerSums:
        points, weights = weighted_points(source, p, n, stream, block)
        sums = PowerSums.zeros(len(nu), True)
        for x, w in zip(points, given_or_equal(weights, points), strict=True):
            sums.take(transform(x, w))
        return sums

    sums = PowerSums.zeros(len(nu), True)
    blocks = realization_blocks(realizations, max(n * source.dims, len(nu)), least=4)
    for part in map_in_order(block_sums, blocks, available_workers(workers)):
        sums = merged(sums, part)
    names = ("power", "power_se", "mean_coefficient", "mean_coefficient_se")
    law = source.law(n)
    sets = independent_sets(law)
    mean = sums.coefficient(None if law.stationary else sets)
    found = zip(names, (*sums.power.mean_and_error(sets), *mean), strict=True)
    labels = {"long_name": "frequency", "units": "cycles per unit"}
    return dataset(
        {name: (("frequency",), values) for name, values in found},
        {f"m_{j}": ("frequency", axis, labels) for j, axis in enumerate(nu.T)},
        **spectrum_attributes(source, p, n, realizations, stream),
        seed=rng if isinstance(rng, int) else None,
        engine=chosen,
        eps=eps,
    )


def listed_transform(
    frequencies: Array, n: int, *, engine: str = "auto", eps: float = 1e-9
) -> tuple[Listed, str]:
    """Return the transform of sets of n points to S at frequencies (F, d), and the engine."""
    as_choice("engine", engine, _ENGINES)
    eps = as_real("eps", eps, least=1e-14, most=0.1)
    dims = frequencies.shape[1]
    if engine == "nufft" and dims > 3:
        raise ParameterError(
            f"The nufft engine works in 1 to 3 dims, not {dims}; use ",
            Parameter("engine", "direct"),
            ".",
        )
    if engine == "auto":
        engine = "direct"
        if dims <= 2:  # costs in nanoseconds, measured on one core of a server from 2024
            volume = np.prod(2.5 * np.ptp(frequencies, axis=0) + 30.0)
            nufft = (n + len(frequencies)) * 200.0 * 10.0 ** (dims - 1) + 100.0 * volume
            engine = "nufft" if nufft < 10.0 * n * len(frequencies) else "direct"
    return (_direct(frequencies) if engine == "direct" else _type_3(frequencies, eps)), engine


def _type_3(frequencies: Array, eps: float) -> Listed:
    dims = frequencies.shape[1]
    missing = [None] * (3 - dims)
    # Measured relative errors with oversampling 1.25: 2e-9 in one and two dims, 6e-8 in three
    upsampling = 1.25 if eps >= (1e-9 if dims < 3 else 1e-7) else 2.0
    targets = [*(np.ascontiguousarray(axis) for axis in frequencies.T), *missing]

    def transform(points: Array, weights: Array) -> Array:
        import finufft

        # One plan for each set costs little. No plan is shared by threads
        plan = finufft.Plan(
            3, dims, eps=eps, isign=-1, upsampfac=upsampling, nthreads=1, showwarn=0
        )
        plan.setpts(*(2.0 * np.pi * axis for axis in points.T), *missing, *targets)
        return np.asarray(plan.execute(weights.astype(np.complex128))).ravel()

    return transform


def _direct(frequencies: Array) -> Listed:
    """Return a transform that computes the sum over all points directly for each frequency.

    If there are few different components, frequencies share the factors of equal components.
    Otherwise the phase of each frequency is computed separately.
    """
    rows, axes = np.nonzero(frequencies)
    values = frequencies[rows, axes]
    start = np.searchsorted(rows, np.arange(len(frequencies) + 1))
    factors, entries = np.unique(axes + 1j * values, return_inverse=True)
    shared = 2 * len(factors) <= len(frequencies) and len(factors) <= _MAX_FACTORS
    factor_axes = factors.real.astype(np.int64)
    factor_values = np.ascontiguousarray(factors.imag)

    def transform(points: Array, weights: Array) -> Array:
        out = np.empty(len(frequencies), np.complex128)
        by_axis = np.ascontiguousarray(points.T)
        w = np.ascontiguousarray(weights)
        if shared:
            product_sum(by_axis, w, start, entries, factor_axes, factor_values, out)
        else:
            phase_sum(by_axis, w, start, axes, values, out)
        return out

    return transform


def axis_frequencies(dims: int, half_width: int, *, step: float = 1.0) -> Array:
    """Return frequencies step · {1 … half_width} along each axis, one axis after another.

    Examples
    --------
    >>> axis_frequencies(2, 2).tolist()
    [[1.0, 0.0], [2.0, 0.0], [0.0, 1.0], [0.0, 2.0]]
    """
    dims, half_width, step = _checked(dims, half_width, step)
    _check_size(dims * half_width, dims)
    scale = step * np.arange(1, half_width + 1)
    return np.asarray((np.eye(dims)[:, None, :] * scale[:, None]).reshape(-1, dims))


def diagonal_frequencies(
    dims: int, half_width: int, *, signs: Sequence[int] | None = None, step: float = 1.0
) -> Array:
    """Return the frequencies step · t · signs on a diagonal, for t = 1 … half_width.

    Parameters
    ----------
    dims, half_width, step
        Number of dims, largest multiple t, and spacing of the frequencies.
    signs
        Sign of each axis: −1, 0 or 1. By default all signs are 1.

    Examples
    --------
    >>> diagonal_frequencies(2, 2, signs=(1, -1)).tolist()
    [[1.0, -1.0], [2.0, -2.0]]
    """
    dims, half_width, step = _checked(dims, half_width, step)
    _check_size(half_width, dims)
    direction = np.ones(dims) if signs is None else np.asarray(signs)
    if direction.shape != (dims,) or not np.isin(direction, (-1, 0, 1)).all():
        raise ParameterError(
            f"signs is {shown(signs)}; give −1, 0 or 1 for each of the {dims} dims."
        )
    if not direction.any():
        raise ParameterError(f"signs is {shown(signs)}; at least one must not be 0.")
    return np.asarray(step * np.arange(1, half_width + 1)[:, None] * direction.astype(np.float64))


def plane_frequencies(
    dims: int, axes: Sequence[int], half_width: int, *, step: float = 1.0
) -> Array:
    """Return frequencies step · {−half_width … half_width} on some axes, 0 elsewhere, in C order.

    For two axes, the power at these frequencies is the spectrum of a projection of the set.

    Examples
    --------
    >>> plane_frequencies(5, (1, 3), 8).shape
    (289, 5)
    """
    return _product(dims, axes, half_width, step, keep_zero=True)


def subset_frequencies(
    dims: int, axes: Sequence[int], half_width: int, *, step: float = 1.0
) -> Array:
    """Return frequencies up to the half width that are nonzero on exactly the given axes.

    These (2 half_width)^|axes| frequencies belong to the ANOVA term of the axes.

    Examples
    --------
    >>> subset_frequencies(3, (0,), 2).tolist()
    [[-2.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    """
    return _product(dims, axes, half_width, step, keep_zero=False)


def _product(dims: int, axes: Any, half_width: int, step: float, *, keep_zero: bool) -> Array:
    dims, half_width, step = _checked(dims, half_width, step)
    if not isinstance(axes, Sequence | np.ndarray) or isinstance(axes, str) or not len(axes):
        raise ParameterError(f"axes is {shown(axes)}; give a list of axes from 0 to {dims - 1}.")
    chosen = [as_integer("axes", axis, least=0, most=dims - 1) for axis in axes]
    if len(set(chosen)) < len(chosen):
        raise ParameterError(f"axes is {list(axes)}; name each axis once.")
    index = np.arange(-half_width, half_width + 1)
    index = index if keep_zero else index[index != 0]
    _check_size(float(len(index)) ** len(chosen), dims)
    shape = (len(index),) * len(chosen)
    found = np.zeros((int(np.prod(shape)), dims))
    for axis, place in zip(chosen, np.unravel_index(np.arange(len(found)), shape), strict=True):
        found[:, axis] = step * index[place]
    return found


def _checked(dims: int, half_width: int, step: float) -> tuple[int, int, float]:
    return (
        as_integer("dims", dims, least=1, most=MAX_DIMS),
        as_integer("half_width", half_width, least=1, most=MAX_LISTED),
        as_real("step", step, above=0.0, most=MAX_FREQUENCY / MAX_LISTED),
    )


def _check_size(count: float, dims: int) -> None:
    if count * dims > MAX_LISTED:
        raise ParameterError(
            f"These are {count:.3g} frequencies in {dims} dims, "
            f"{8 * count * dims / 2**30:.3g} GiB; list at most {MAX_LISTED // dims}: use a "
            "smaller ",
            Parameter("half_width"),
            " or fewer axes.",
        )
