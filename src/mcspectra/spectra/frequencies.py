"""Lists of frequencies for `power_at`: slices, planes and ANOVA subsets, float64 (F, d).

Only one of ν and −ν is listed where a whole line would hold both: S_{−ν} = conj S_ν.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mcspectra.core.checks import MAX_DIMS, MAX_FREQUENCY, Array, as_integer, as_real
from mcspectra.core.errors import ParameterError

__all__ = [
    "MAX_LISTED",
    "axis_frequencies",
    "diagonal_frequencies",
    "plane_frequencies",
    "subset_frequencies",
]

MAX_LISTED = 2**27
"""Most numbers in a list of frequencies, F times d: 1 GiB."""


def axis_frequencies(dims: int, half_width: int, *, step: float = 1.0) -> Array:
    """Frequencies step · {1 … half_width} along each axis, one axis after the other.

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
    """Frequencies step · t · signs, t = 1 … half_width: the main diagonal, unless signs differ.

    Parameters
    ----------
    dims, half_width, step
        Number of dims and extent.
    signs
        −1, 0 or 1 for each axis.

    Examples
    --------
    >>> diagonal_frequencies(2, 2, signs=(1, -1)).tolist()
    [[1.0, -1.0], [2.0, -2.0]]
    """
    dims, half_width, step = _checked(dims, half_width, step)
    _check_size(half_width, dims)
    direction = np.ones(dims) if signs is None else np.asarray(signs)
    if direction.shape != (dims,) or not np.isin(direction, (-1, 0, 1)).all():
        raise ParameterError(f"signs is {signs!r}; give −1, 0 or 1 for each of the {dims} dims.")
    if not direction.any():
        raise ParameterError(f"signs is {signs!r}; at least one must not be 0.")
    return np.asarray(step * np.arange(1, half_width + 1)[:, None] * direction.astype(np.float64))


def plane_frequencies(
    dims: int, axes: Sequence[int], half_width: int, *, step: float = 1.0
) -> Array:
    """Frequencies step · {−half_width … half_width} of some axes, zero elsewhere, in C order.

    Those of two axes are the spectrum of the set's projection onto their plane.

    Examples
    --------
    >>> plane_frequencies(5, (1, 3), 8).shape
    (289, 5)
    """
    return _product(dims, axes, half_width, step, keep_zero=True)


def subset_frequencies(
    dims: int, axes: Sequence[int], half_width: int, *, step: float = 1.0
) -> Array:
    """Frequencies whose nonzero components are exactly those of `axes`, up to the half width.

    They carry the ANOVA term of these axes: (2 half_width)^|axes| frequencies.

    Examples
    --------
    >>> subset_frequencies(3, (0,), 2).tolist()
    [[-2.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    """
    return _product(dims, axes, half_width, step, keep_zero=False)


def _product(
    dims: int, axes: Sequence[int], half_width: int, step: float, *, keep_zero: bool
) -> Array:
    dims, half_width, step = _checked(dims, half_width, step)
    chosen = _as_axes(axes, dims)
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
            f"{8 * count * dims / 2**30:.3g} GiB; list at most {MAX_LISTED // dims}: use a smaller "
            "half_width or fewer axes."
        )


def _as_axes(axes: Any, dims: int) -> list[int]:
    if not isinstance(axes, Sequence | np.ndarray) or isinstance(axes, str) or not len(axes):
        raise ParameterError(f"axes is {axes!r}; give a list of axes from 0 to {dims - 1}.")
    chosen = [as_integer("axes", axis, least=0, most=dims - 1) for axis in axes]
    if len(set(chosen)) < len(chosen):
        raise ParameterError(f"axes is {list(axes)}; name each axis once.")
    return chosen
