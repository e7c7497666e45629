"""Expected power spectra that are known exactly.

With sinc(x) = sin x / x, n points, s = n^(1/d) strata a side, real frequencies ν (DESIGN and the
paper's supplement):

* random, density p:   (1/n) ∫1/p + ((n−1)/n) Π_i sinc²(πν_i)
* jittered:            (1/n)(1 − Π_i sinc²(πν_i/s)) + Π_i sinc²(πν_i), s_i where sides differ
* regular and uniform-jitter: Π_i (sin(πν_i) / (s sin(πν_i/s)))², likewise
* Latin hypercube:     1/n + ((n−1)/n) Π_i (n sinc²(πν_i) − sinc²(πν_i/n))/(n−1)
* rank-1 lattice, integer m: 1 where m·z ≡ 0 (mod n), else 0

A Cranley-Patterson shift multiplies S_m by a phase at *integer* m and leaves the power as it is.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from mcspectra.core.checks import Array, as_frequencies
from mcspectra.core.errors import InfiniteWeightVarianceWarning, NoClosedForm
from mcspectra.densities import Density, Uniform, as_density
from mcspectra.samplers import (
    Jittered,
    LatinHypercube,
    NRooks,
    Random,
    Randomized,
    Rank1Lattice,
    Regular,
    Sampler,
    Shift,
    UniformJitter,
    as_sampler,
)

__all__ = ["closed_form_power"]


def closed_form_power(
    sampler: Sampler | str,
    n: int,
    frequencies: Any,
    density: Density | str | None = None,
) -> Array:
    """Return the exact expected power ⟨|S_ν|²⟩ at listed frequencies.

    Parameters
    ----------
    sampler, n
        Sampler (or spec string) and number of points.
    frequencies
        Real frequencies ν, shape (..., d), in cycles per unit; integers only after a shift.
    density
        Importance density, for random points.

    Returns
    -------
    ndarray
        float64 (...). Infinite, with a warning, where ∫1/p diverges.

    Raises
    ------
    NoClosedForm
        None is known for this combination.

    Examples
    --------
    >>> closed_form_power("random", 10, [[3, 0], [0, 0]])
    array([0.1, 1. ])
    """
    dims = np.shape(frequencies)[-1] if np.ndim(frequencies) else None
    source = as_sampler(sampler, None if isinstance(sampler, Sampler) else dims)
    n = source.check_count(n)
    nu = as_frequencies(frequencies, source.dims)
    p = as_density(density, source.dims)
    if isinstance(p, Uniform):
        p = None
    base = _strip_shift(source, nu)
    if isinstance(base, Random):
        return _random(n, nu, p)
    if p is not None:
        raise NoClosedForm(
            f"No closed-form power is known for {source.spec} with the density {p.spec}; "
            "use power_spectrum(..., density=...)."
        )
    return _uniform_power(base, n, nu)


def _strip_shift(sampler: Sampler, nu: Array) -> Sampler:
    """Return the sampler inside shifts; at other than integer frequencies a shift changes power."""
    if not isinstance(sampler, Randomized):
        return sampler
    integer = np.array_equal(nu, np.rint(nu))
    shifts = all(isinstance(step, Shift) for step in sampler.steps)
    if shifts and (integer or isinstance(sampler.base, Random)):
        return sampler.base
    reason = "at real frequencies" if shifts else "with these randomisations"
    raise NoClosedForm(
        f"No closed-form power is known for {sampler.spec} {reason}; use power_spectrum."
    )


def _random(n: int, nu: Array, density: Density | None) -> Array:
    reciprocal = 1.0 if density is None else density.reciprocal_integral()
    if not np.isfinite(reciprocal):
        warnings.warn(
            f"∫1/p diverges for {density.spec if density else ''}: the expected power is infinite.",
            InfiniteWeightVarianceWarning,
            stacklevel=3,
        )
    return np.asarray(reciprocal / n + (n - 1) / n * _sinc2(nu))


def _uniform_power(sampler: Any, n: int, nu: Array) -> Array:
    if isinstance(sampler, Jittered):
        s = np.asarray(sampler.sides(n))
        return np.asarray((1.0 - _sinc2(nu / s)) / n + _sinc2(nu))
    if isinstance(sampler, Regular | UniformJitter):
        s = np.asarray(sampler.sides(n))
        # sinc(πν)/sinc(πν/s) per axis; where both vanish (multiples of s) the limit is ±1.
        bottom = np.sinc(nu / s)
        ratio = np.divide(np.sinc(nu), bottom, out=np.ones_like(nu), where=np.abs(bottom) > 1e-12)
        return np.asarray(np.prod(ratio**2, axis=-1))
    if isinstance(sampler, NRooks) or _is_plain_latin(sampler):
        if n == 1:
            return np.ones(nu.shape[:-1])
        pair = (n * np.sinc(nu) ** 2 - np.sinc(nu / n) ** 2) / (n - 1)
        return np.asarray(1.0 / n + (n - 1) / n * np.prod(pair, axis=-1))
    if isinstance(sampler, Rank1Lattice) and np.array_equal(nu, np.rint(nu)):
        product = np.rint(nu).astype(np.int64) @ sampler.generating_vector(n)
        return np.asarray((product % n == 0).astype(np.float64))
    raise NoClosedForm(f"No closed-form power is known for {sampler.spec}; use power_spectrum.")


def _is_plain_latin(sampler: Sampler) -> bool:
    return isinstance(sampler, LatinHypercube) and sampler.strength == 1


def _sinc2(nu: Array) -> Array:
    """Π_i sinc²(πν_i)."""
    return np.asarray(np.prod(np.sinc(nu) ** 2, axis=-1))
