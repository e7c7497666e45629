"""Integrals and Fourier coefficients of any integrand: exact where it knows them, else quadrature.

Results of quadrature are kept in the integrand itself (it must therefore always give the same
values), the last few sets of frequencies each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.integrands._quadrature import (
    Estimate,
    adaptive_integral,
    lattice_integral,
    refined_coefficients,
)
from mcspectra.integrands.base import Integrand

__all__ = [
    "Estimate",
    "fourier_accuracy",
    "fourier_at",
    "fourier_grid",
    "integral_accuracy",
    "numeric_integral",
]

_MOST_COEFFICIENTS = 2**26  # 1 GiB of complex numbers
_EXACT_BLOCK = 2**20
_KEPT = 4
_ADAPTIVE_DIMS = 5


def fourier_grid(integrand: Integrand, half_width: int) -> Array:
    """Coefficients at all m in {−half_width … half_width}^d.

    Returns
    -------
    ndarray
        complex128, (2 half_width + 1,) * d, then (channels,) where f has several.

    Raises
    ------
    ParameterError
        More than 2^26 coefficients, or a quadrature of more than 2^24 evaluations.
    """
    m = _all_frequencies(integrand, half_width)
    if integrand._fourier(np.zeros((1, integrand.dims))) is None:
        return _quadrature(integrand, m).value.copy()
    points = np.stack(np.meshgrid(*m, indexing="ij"), axis=-1).reshape(-1, integrand.dims)
    blocks = (points[i : i + _EXACT_BLOCK] for i in range(0, len(points), _EXACT_BLOCK))
    found = np.concatenate([_exact(integrand, block) for block in blocks])
    return found.reshape(*(axis.size for axis in m), *found.shape[1:])


def fourier_at(integrand: Integrand, m: Array) -> Array:
    """Coefficients by quadrature at the integer frequencies m of shape (..., d).

    One tensor grid serves all: its size is set by the highest |m_i| along each axis.

    Raises
    ------
    ParameterError
        The quadrature would take more than 2^24 evaluations.
    """
    axes, places = [], []
    for i in range(integrand.dims):
        distinct, where = np.unique(m[..., i], return_inverse=True)
        axes.append(distinct)
        places.append(where.reshape(m.shape[:-1]))
    _check_size(integrand, [axis.size for axis in axes])
    return np.asarray(_quadrature(integrand, axes).value[tuple(places)])


def fourier_accuracy(integrand: Integrand, half_width: int) -> tuple[str, float]:
    """Say how `fourier_grid` finds its coefficients, and how well.

    Returns
    -------
    tuple
        Description, and an estimate of the largest absolute error: 0 where they are exact, else the
        largest difference from a grid of half the nodes (for smooth f far above the true error).
    """
    if integrand._fourier(np.zeros((1, integrand.dims))) is not None:
        return integrand.fourier_source, 0.0
    found = _quadrature(integrand, _all_frequencies(integrand, half_width))
    return f"{integrand.fourier_source}, {found.method}", found.error


def numeric_integral(integrand: Integrand) -> Any:
    """∫ f by quadrature: a float, or an array (channels,).

    Up to 5 dims, Gauss-Legendre on boxes that are cut at the breaks and split adaptively to 1e-12 of
    ∫|f| or 2^21 evaluations; beyond, the mean over 2^20 points of a Kronecker sequence, to be
    trusted to three to six digits. An integrand that has a rule of its own, as pixels have, is
    integrated by that. `integral_accuracy` estimates the error.
    """
    value = _integral_estimate(integrand).value
    return value.copy() if integrand.channels else float(value[0])


def integral_accuracy(integrand: Integrand) -> tuple[str, float]:
    """Say how `integral` is found, and an estimate of its largest absolute error (0 if exact)."""
    if integrand._integral() is not None:
        return "exact", 0.0
    found = _integral_estimate(integrand)
    return found.method, found.error


def _all_frequencies(integrand: Integrand, half_width: int) -> list[Array]:
    width = as_integer("half_width", half_width, least=0)
    _check_size(integrand, [2 * width + 1] * integrand.dims)
    return [np.arange(-width, width + 1, dtype=np.float64)] * integrand.dims


def _check_size(integrand: Integrand, sizes: list[int]) -> None:
    count = math.prod(sizes) * max(1, integrand.channels)
    if count > _MOST_COEFFICIENTS:
        raise ParameterError(
            f"{count:.3g} Fourier coefficients of {integrand.spec} are more than "
            f"{_MOST_COEFFICIENTS:.3g}, 1 GiB; choose a smaller half_width or fewer frequencies."
        )


def _exact(integrand: Integrand, m: Array) -> Array:
    found = integrand._fourier(m)
    if found is None:
        raise ParameterError(f"{integrand.spec} knows its coefficients at some frequencies only.")
    return found


def _quadrature(integrand: Integrand, m: Sequence[Array]) -> Estimate:
    """Coefficients on a tensor product of frequencies, remembered by the integrand."""
    kept = _memory(integrand)
    key = tuple(axis.tobytes() for axis in m)
    if key not in kept:
        while len(kept) >= _KEPT:
            kept.pop(next(iter(kept)), None)
        kept[key] = _with_integral(integrand, m, refined_coefficients(integrand, m))
    return kept[key]


def _with_integral(integrand: Integrand, m: Sequence[Array], found: Estimate) -> Estimate:
    """Put the integral, exact or from the better rule, in the place of the coefficient at 0.

    Where two grids agree by chance (a border along their diagonals), it shows that they are off.
    """
    if not all((axis == 0).any() for axis in m):
        return found
    zero = tuple(int(np.flatnonzero(axis == 0)[0]) for axis in m)
    value, integral = found.value.copy(), integrand.integral
    error = max(found.error, float(np.abs(value[zero] - integral).max()))
    value[zero] = integral
    return replace(found, value=value, error=error)


def _integral_estimate(integrand: Integrand) -> Estimate:
    kept = _memory(integrand)
    if "integral" not in kept:
        rule = adaptive_integral if integrand.dims <= _ADAPTIVE_DIMS else lattice_integral
        kept["integral"] = integrand._estimated_integral() or rule(integrand)
    return kept["integral"]


def _memory(integrand: Integrand) -> dict[Any, Estimate]:
    """What was computed for an integrand: kept in it, so that it goes when the integrand goes."""
    kept: dict[Any, Estimate] = integrand.__dict__.setdefault("_computed", {})
    return kept
