"""Expected power spectra and covariances of S_m that are known exactly.

With sinc(x) = sin x / x, n points, s = n^(1/d) strata a side, real frequencies ν, for example:

* random, density p:   ⟨|S_ν|²⟩ = (1/n) ∫1/p + ((n−1)/n) Π_i sinc²(πν_i),
  and at integers C_ml = (1/n) ((1/p)^_{m−l} − δ_m0 δ_l0)
* jittered:            ⟨|S_ν|²⟩ = (1/n)(1 − Π_i sinc²(πν_i/s)) + Π_i sinc²(πν_i), and at integers
  C_ml = (1/n)(δ_ml − Π_i (−1)^((m_i−l_i)/s) sinc(πm_i/s) sinc(πl_i/s)) where s divides m − l, else 0
* regular and uniform-jitter: ⟨|S_ν|²⟩ = Π_i (sin(πν_i) / (s sin(πν_i/s)))²
* Latin hypercube:     ⟨|S_ν|²⟩ = 1/n + ((n−1)/n) Π_i (n sinc²(πν_i) − sinc²(πν_i/n))/(n−1)
* rank-1 lattice, integer m: 1 where m·z ≡ 0 (mod n), else 0

The general forms are in `closed_moments` and `closed_pairs`, those of importance-sampled sets in
`closed_weighted`. At *integer* m a Cranley-Patterson shift
multiplies S_m by a random phase: it leaves the power as it is and makes C_ml diagonal.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import Array, as_frequencies
from mcspectra.core.errors import InfiniteWeightVarianceWarning, NoClosedForm, ParameterError, warn
from mcspectra.densities import Density, Uniform, as_warp
from mcspectra.samplers import Randomized, Sampler, Shift, StrataShift, as_sampler
from mcspectra.spectra.closed_moments import known_moments
from mcspectra.spectra.closed_terms import Moments, interval, product
from mcspectra.spectra.closed_weighted import weighted_covariance, weighted_power

__all__ = ["closed_form_covariance", "closed_form_power", "moments_of"]


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
        Sampler (or spec string) and number of points. Known are random, jittered, regular grids,
        lattices, Latin hypercubes, orthogonal arrays of strength 2, multi-jittered, jitters around
        a grid, determinantal sets and nets; each also with shift.
    frequencies
        Real frequencies ν, shape (..., d), in cycles per unit; integers only after a shift, and
        for sets that are wrapped around the torus.
    density
        Importance density. For random points any; a product over the axes for jittered, latin-hypercube
        and grids, alone or with shift or strata-shift, at integer frequencies
        (`mcspectra.spectra.closed_weighted`).

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
    source, n, nu, p = _checked(sampler, n, frequencies, density)
    if p is not None:
        return _weighted_power(source, n, nu, p)
    moments = moments_of(source, n, nu)
    return np.asarray(moments.covariance(nu, nu).real + np.abs(moments.mean(nu)) ** 2)


def closed_form_covariance(
    sampler: Sampler | str,
    n: int,
    frequencies: Any,
    others: Any,
    density: Density | str | None = None,
) -> Array:
    """Return the exact covariance C_ml = ⟨S_m conj S_l⟩ − ⟨S_m⟩ conj⟨S_l⟩ of listed pairs m, l.

    Parameters
    ----------
    sampler, n, density
        As for `closed_form_power`.
    frequencies, others
        m and l, shapes (..., d) that broadcast; integers only with a density.

    Returns
    -------
    ndarray
        complex128 (...).

    Raises
    ------
    NoClosedForm
        None is known for this combination, or C_ml are infinite because ∫1/p diverges.

    Examples
    --------
    >>> closed_form_covariance("jittered", 4, [[1], [1]], [[1], [-3]]).real.round(3)
    array([0.047, 0.068])
    """
    source, n, m, p = _checked(sampler, n, frequencies, density)
    m, other = _broadcast(m, as_frequencies(others, m.shape[-1]))
    if p is None:
        return moments_of(source, n, m, other).covariance(m, other)
    return _weighted_covariance(source, n, m, other, p)


def moments_of(sampler: Sampler, n: int, *frequencies: Array) -> Moments:
    """Return the exact moments of a sampler, valid at the given frequencies.

    Raises
    ------
    NoClosedForm
        None are known.
    """
    base, steps = _translations(sampler)
    integer = all(np.array_equal(nu, np.rint(nu)) for nu in frequencies)
    moments = known_moments(base, n)
    if moments is None:
        raise _unknown(sampler)
    if base.name == "random":
        return moments
    if not integer and (steps or moments.integer):
        raise _unknown(sampler, "at real frequencies")
    for step in steps:
        moments = _shifted(moments) if isinstance(step, Shift) else _moved(moments, step, n)
    return moments


def _checked(
    sampler: Sampler | str, n: int, frequencies: Any, density: Density | str | None
) -> tuple[Sampler, int, Array, Density | None]:
    # An empty list has no dims: it is refused as such, not for them.
    dims = np.shape(frequencies)[-1] or None if np.ndim(frequencies) else None
    drawn = getattr(density, "primary_dims", dims)
    source = as_sampler(sampler, None if isinstance(sampler, Sampler) else drawn)
    n = source.check_count(n)
    p = as_warp(density, source.dims)
    nu = as_frequencies(frequencies, source.dims if p is None else p.dims)
    return source, n, nu, None if isinstance(p, Uniform) else p


def _broadcast(m: Array, other: Array) -> tuple[Array, Array]:
    try:
        shape = np.broadcast_shapes(m.shape, other.shape)
    except ValueError:
        raise ParameterError(
            f"frequencies and others have shapes {m.shape} and {other.shape}, which do not "
            "broadcast; give one l for each m, or insert axes of length 1."
        ) from None
    return np.broadcast_to(m, shape), np.broadcast_to(other, shape)


def _translations(sampler: Sampler) -> tuple[Sampler, tuple[Shift | StrataShift, ...]]:
    """Return the sampler inside its randomisations, and these, if they do no more than translate."""
    if not isinstance(sampler, Randomized):
        return sampler, ()
    steps = [step for step in sampler.steps if step.name != "shuffle"]  # sums have no order
    moves = tuple(step for step in steps if isinstance(step, Shift | StrataShift))
    if len(moves) < len(steps):
        raise _unknown(sampler, "with these randomisations")
    return sampler.base, moves


def _unknown(sampler: Sampler, reason: str = "") -> NoClosedForm:
    return NoClosedForm(
        f"No closed-form power is known for {sampler.spec}{' ' if reason else ''}{reason}; "
        "use power_spectrum, or variance_terms for covariances."
    )


def _shifted(moments: Moments) -> Moments:
    """After a uniform translation, at integer frequencies: unbiased, and diagonal."""

    def covariance(m: Array, other: Array) -> Array:
        power = moments.covariance(m, m).real + np.abs(moments.mean(m)) ** 2
        zero = np.all(m == 0, axis=-1)
        return np.asarray(np.where(np.all(m == other, axis=-1), power - zero, 0.0) + 0j)

    return Moments(lambda nu: np.all(nu == 0, axis=-1) + 0j, covariance, integer=True)


def _moved(moments: Moments, step: StrataShift, n: int) -> Moments:
    """After a fixed translation, at integer frequencies: phases."""

    def phase(nu: Array) -> Array:
        move = np.asarray(step.offset, float) * n ** (-1.0 / nu.shape[-1])
        return np.asarray(np.exp(-2j * np.pi * np.remainder((nu * move).sum(axis=-1), 1.0)))

    return Moments(
        lambda nu: moments.mean(nu) * phase(nu),
        lambda m, other: moments.covariance(m, other) * phase(m - other),
        integer=True,
    )


def _weighted_power(sampler: Sampler, n: int, nu: Array, density: Density) -> Array:
    """Random points of a density: (1/n) ∫1/p + (1 − 1/n) |χ|²; others at integers only."""
    reciprocal = density.reciprocal_integral()
    if not np.isfinite(reciprocal):
        warn(
            f"∫1/p diverges for {density.spec}: the expected power is infinite.",
            InfiniteWeightVarianceWarning,
        )
        return np.full(nu.shape[:-1], np.inf)
    base, moves = _translations(sampler)
    if base.name == "random":
        return np.asarray(reciprocal / n + (n - 1) / n * np.abs(product(interval(nu))) ** 2)
    _check_integers(sampler, nu)
    return weighted_power(base, moves, n, nu, density)


def _weighted_covariance(
    sampler: Sampler, n: int, m: Array, other: Array, density: Density
) -> Array:
    base, moves = _translations(sampler)
    _check_integers(sampler, m, other)
    if not np.isfinite(density.reciprocal_integral()):
        raise NoClosedForm(
            f"∫1/p diverges for {density.spec}: the covariances of S_m are infinite; measure the "
            "variance of the estimate by convergence instead."
        )
    return weighted_covariance(base, moves, n, m, other, density)


def _check_integers(sampler: Sampler, *frequencies: Array) -> None:
    if not all(np.array_equal(nu, np.rint(nu)) for nu in frequencies):
        raise _unknown(sampler, "with a density at real frequencies")
