"""Means and covariances of S_ν that are known exactly, one sampler after another.

Three kinds of sets are known. Notation: χ(ν) = sinc(πν) exp(−iπν), the transform of the unit
interval; A_s(ν) = (1/s) Σ_{j<s} exp(−2πi νj/s), that of a grid; products over the axes throughout.

* Independent motifs, one in each of N cells: with M(ν) the mean of exp(−2πi ν·ξ) over the points of
  one motif, in units of cells, ⟨S_ν⟩ = A(ν) ⟨M(ν/s)⟩ and
  C_ml = (1/N) A(m − l) [⟨M(m/s) conj M(l/s)⟩ − ⟨M(m/s)⟩ conj⟨M(l/s)⟩]. Random points are n motifs in one
  cell, jittered, box-jitter and gaussian-jitter one point in each cell, antithetic-jittered two.
* Sets the same every time, and grids with a common offset: S_ν itself is known.
* Sets with a known law of pairs (`mcspectra.spectra.closed_pairs`), determinantal sets among them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import NoClosedForm
from mcspectra.core.streams import Stream
from mcspectra.samplers import Sampler
from mcspectra.samplers._grid import root
from mcspectra.spectra import closed_pairs
from mcspectra.spectra.closed_terms import Moments, comb, interval, product

__all__ = ["known_moments"]

_MAX_WORK = 2**32  # points times frequencies summed directly: about half a minute


def known_moments(sampler: Sampler, n: int) -> Moments | None:
    """Return the moments of a sampler without randomisations, None where they are not known."""
    if sampler.fixed:
        return _fixed(sampler, n)
    build = _BUILDERS.get(sampler.name)
    return None if build is None else build(sampler, n)


def _motifs(
    sides: tuple[int, ...],
    count: int,
    mean: Callable[[Array], Array],
    second: Callable[[Array, Array], Array],
    integer: bool = False,
) -> Moments:
    """`count` independent motifs, spread evenly over the cells; their moments in units of cells."""
    s = np.asarray(sides, float)

    def covariance(m: Array, other: Array) -> Array:
        a, b = m / s, other / s
        within = second(a, b) - mean(a) * np.conj(mean(b))
        return np.asarray(product(comb(m - other, s)) * within / count)

    return Moments(lambda nu: product(comb(nu, s)) * mean(nu / s), covariance, integer)


def _single(sides: tuple[int, ...], count: int, axis: Any, integer: bool = False) -> Moments:
    """One point in each cell, its coordinates independent and of the transform `axis`."""
    return _motifs(
        sides, count, lambda a: product(axis(a)), lambda a, b: product(axis(a - b)), integer
    )


def _random(sampler: Any, n: int) -> Moments:
    return _single((1,) * sampler.dims, n, interval)


def _jittered(sampler: Any, n: int) -> Moments:
    return _single(sampler.sides(n), n, interval)


def _box_jitter(sampler: Any, n: int) -> Moments:
    width = sampler.width
    return _single(
        _cube(sampler, n), n, lambda a: _center(a) * np.sinc(width * a), integer=width > 1.0
    )


def _gaussian_jitter(sampler: Any, n: int) -> Moments:
    return _single(
        _cube(sampler, n), n, lambda a: _center(a) * _gauss(sampler.width, a), integer=True
    )


def _antithetic(sampler: Any, n: int) -> Moments:
    def second(a: Array, b: Array) -> Array:
        # a point and its reflection: exp(−iπν) cos(2πν·η), η uniform in the centered cell
        mean = 0.5 * (product(np.sinc(a - b)) + product(np.sinc(a + b)))
        return np.asarray(product(_center(a - b)) * mean)

    cells = n // 2
    return _motifs(_cube(sampler, cells), cells, lambda a: product(interval(a)), second)


def _perturbed_lattice(sampler: Any, n: int) -> Moments:
    """Gaussian displacements; the common translation leaves the diagonal alone."""
    s = np.asarray(_cube(sampler, n), float)

    def power(m: Array) -> Array:
        if sampler.correlation != 0.0:
            return _displaced(sampler, n, m)
        square = product(_gauss(sampler.width, m / s)) ** 2
        return np.asarray((1.0 - square) / n + square * np.abs(product(comb(m, s))) ** 2)

    return _stationary(power)


def _displaced(sampler: Any, n: int, m: Array) -> Array:
    """(1/n) Σ_r exp(−2πi m·r/s) exp(−4π² |m|² (width/s)² (1 − ρ(r))) over the places r of the grid.

    ρ is the correlation of displacements r apart ([Gabrielli2004]_, of Gaussian ones).
    """
    sides = _cube(sampler, n)
    _check_terms(n, m)
    correlation = sampler.displacement_correlation(n).reshape(-1)
    places = np.stack(np.unravel_index(np.arange(n), sides), axis=-1)
    rows = m.reshape(-1, m.shape[-1])
    spread = (2.0 * np.pi * sampler.width / sides[0]) ** 2 * (rows**2).sum(axis=-1)
    out = np.empty(len(rows))
    block = max(1, 2**22 // n)
    for i in range(0, len(rows), block):
        phases = np.cos(2.0 * np.pi * np.remainder(rows[i : i + block] @ places.T / sides[0], 1.0))
        out[i : i + block] = (
            phases * np.exp(-np.outer(spread[i : i + block], 1.0 - correlation))
        ).mean(axis=-1)
    return out.reshape(m.shape[:-1])


def _determinantal(sampler: Any, n: int) -> Moments:
    waves = sampler.frequencies(n)

    def power(m: Array) -> Array:
        known = {tuple(wave) for wave in waves.tolist()}
        flat = np.rint(m).reshape(-1, sampler.dims).astype(np.int64)
        rows, back = np.unique(flat, axis=0, return_inverse=True)
        pairs = [sum(tuple(w) in known for w in (waves + row).tolist()) for row in rows]
        share = np.asarray(pairs, float)[back.reshape(-1)].reshape(m.shape[:-1]) / n
        return np.asarray((1.0 - share) / n + _is_zero(m))

    return _stationary(power)


def _stationary(power: Callable[[Array], Array]) -> Moments:
    """Moments at integer frequencies of a set that is the same after any translation."""

    def covariance(m: Array, other: Array) -> Array:
        same = np.all(m == other, axis=-1)
        return np.asarray(np.where(same, power(m) - _is_zero(m), 0.0) + 0j)

    return Moments(lambda nu: _is_zero(nu) + 0j, covariance, integer=True)


def _uniform_jitter(sampler: Any, n: int) -> Moments:
    s = np.asarray(sampler.sides(n), float)

    def covariance(m: Array, other: Array) -> Array:
        offset = product(interval((m - other) / s))
        offset = offset - product(interval(m / s)) * np.conj(product(interval(other / s)))
        return np.asarray(product(comb(m, s)) * np.conj(product(comb(other, s))) * offset)

    return Moments(lambda nu: product(comb(nu, s) * interval(nu / s)), covariance)


def _fixed(sampler: Any, n: int) -> Moments:
    """A set that is the same every time: S_ν itself, by the dual lattice or by summing it."""

    def mean(nu: Array) -> Array:
        if sampler.name == "regular":
            s = np.asarray(sampler.sides(n), float)
            corner = _center(nu / s) if sampler.position == "center" else 1.0
            return product(comb(nu, s) * corner)
        if hasattr(sampler, "generating_vector") and np.array_equal(nu, np.rint(nu)):
            return _in_dual_lattice(nu, sampler.generating_vector(n), n) + 0j
        return _direct_sum(sampler, n, nu)

    return Moments(mean, lambda m, other: np.zeros(np.broadcast(m, other).shape[:-1], complex))


def _in_dual_lattice(m: Array, vector: Array, n: int) -> Array:
    """1.0 where m·z ≡ 0 modulo n; residues are multiplied, so that nothing overflows."""
    residues = np.rint(np.remainder(m, n)).astype(np.int64) * (vector % n) % n
    return np.asarray((residues.sum(axis=-1) % n == 0).astype(float))


def _direct_sum(sampler: Sampler, n: int, nu: Array) -> Array:
    _check_terms(n, nu)
    points = sampler.draw_stream(n, Stream.from_rng(0), 0, 1)[0]
    rows = nu.reshape(-1, nu.shape[-1])
    out = np.empty(len(rows), complex)
    block = max(1, 2**22 // n)
    for i in range(0, len(rows), block):
        phases = np.remainder(rows[i : i + block] @ points.T, 1.0)
        out[i : i + block] = np.exp(-2j * np.pi * phases).mean(axis=-1)
    return out.reshape(nu.shape[:-1])


def _check_terms(n: int, nu: Array) -> None:
    if float(n) * max(64, nu[..., 0].size) > _MAX_WORK:  # the points take memory, too
        raise NoClosedForm(
            f"The exact transform of {n} points at {nu[..., 0].size} frequencies would take more "
            f"than {_MAX_WORK:.2g} terms; use power_spectrum, or ask for fewer frequencies."
        )


def _latin(sampler: Any, n: int) -> Moments | None:
    strength = getattr(sampler, "strength", 1)
    if strength == 1:
        return closed_pairs.latin_hypercube(n)
    return closed_pairs.orthogonal_array(root(n, 2), sampler.dims, shared_out=True)


def _orthogonal_array(sampler: Any, n: int) -> Moments | None:
    if sampler.strength != 2 or sampler.jitter == "correlated-multi-jittered":
        return None
    shared_out = sampler.jitter == "multi-jittered"
    return closed_pairs.orthogonal_array(root(n, 2), sampler.dims, shared_out=shared_out)


def _multi_jittered(sampler: Any, n: int) -> Moments:  # noqa: ARG001
    from mcspectra.samplers.multijitter import _nearly_square

    columns = _nearly_square(n)
    return closed_pairs.multi_jittered((columns, n // columns))


def _cube(sampler: Sampler, cells: int) -> tuple[int, ...]:
    return (root(cells, sampler.dims),) * sampler.dims


def _center(a: Array) -> Array:
    """Phase of the center of a cell, of each coordinate."""
    return np.asarray(np.exp(-1j * np.pi * np.remainder(a, 2.0)))


def _gauss(width: float, a: Array) -> Array:
    return np.asarray(np.exp(-2.0 * (np.pi * width * a) ** 2))


def _is_zero(m: Array) -> Array:
    return np.asarray(np.all(m == 0, axis=-1).astype(float))


# By name, so that the modules of samplers that nobody uses are not loaded.
_BUILDERS: dict[str, Callable[[Any, int], Moments | None]] = {
    "antithetic-jittered": _antithetic,
    "box-jitter": _box_jitter,
    "determinantal": _determinantal,
    "gaussian-jitter": _gaussian_jitter,
    "jittered": _jittered,
    "latin-hypercube": _latin,
    "multi-jittered": _multi_jittered,
    "n-rooks": _latin,
    "orthogonal-array": _orthogonal_array,
    "perturbed-lattice": _perturbed_lattice,
    "random": _random,
    "uniform-jitter": _uniform_jitter,
}
