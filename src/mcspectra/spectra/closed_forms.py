"""Expected power spectra and covariances of S_m that are known exactly, one sampler after another.

Random, jittered and lattice points are derived in docs/theory.md, "Closed forms". At *integer* m a
Cranley-Patterson shift multiplies S_m by a random phase: it leaves the power as it is and makes C_ml
diagonal.

Method
------
Three kinds of sets are known. Notation: χ(ν) = sinc(πν) exp(−iπν), the transform of the unit
interval; A_s(ν) = (1/s) Σ_{j<s} exp(−2πi νj/s), that of a grid; products over the axes throughout.

* Independent motifs, one in each of N cells: with M(ν) the mean of exp(−2πi ν·ξ) over the points of
  one motif, in units of cells, ⟨S_ν⟩ = A(ν) ⟨M(ν/s)⟩ and
  C_ml = (1/N) A(m − l) [⟨M(m/s) conj M(l/s)⟩ − ⟨M(m/s)⟩ conj⟨M(l/s)⟩]. Random points are n motifs in one
  cell, jittered, box-jitter and gaussian-jitter one point in each cell, antithetic-jittered two.
* Sets the same every time, and grids with a common offset: S_ν itself is known.
* Sets with a known law of pairs: C_ml + ⟨S_m⟩ conj⟨S_l⟩ = (1/n²) Σ over ordered pairs of points of
  ⟨exp(−2πi (m·x − l·y))⟩. A point with itself gives χ(m − l) on each axis. For two different points the
  axes are independent, given which strata they share, and each axis is one of three laws: *free*,
  independent uniform points, χ(m) conj χ(l); *same*, independent points of one of s strata,
  A_s(m − l) χ(m/s) conj χ(l/s); *apart*, points of two different ones of s strata,
  (s free − same) / (s − 1). Determinantal sets are known by their pairs, too.

Importance-sampled points, x = T(u) with weights 1/(n p), are known for densities that are products over
the axes with monotone warps: M_t(m) of the stratum that starts at t takes the place of its transform,
*same* and *apart* are means over the strata, or over all t where a random shift follows. A grid with one
offset δ has C_ml = Π_i ∫ A_δ(m_i) conj A_δ(l_i) dδ − δ_m0 δ_l0 with A_δ(m) the S_m of the grid of offset δ
on one axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array, as_frequencies
from mcspectra.core.errors import InfiniteWeightVarianceWarning, NoClosedForm, ParameterError, warn
from mcspectra.core.streams import Stream
from mcspectra.densities import Density, Linear, TruncatedNormal, Uniform
from mcspectra.densities.registry import as_warp
from mcspectra.integrands import Integrand
from mcspectra.integrands._quadrature import AxisRule
from mcspectra.samplers import Randomized, Sampler, Shift, StrataShift, as_sampler
from mcspectra.samplers.stratified import nearly_square, root

__all__ = ["Moments", "closed_form_covariance", "closed_form_power", "moments_of", "points_at"]

_MAX_WORK = 2**32  # points times frequencies summed directly: about half a minute

# With a density
_BLOCK = 2**20  # numbers at once
_MAX_STRATA_WORK = 2**31  # strata times pairs of frequencies: some minutes
_ORDER = 16
_CELLS = 64
_HIGHEST = 2**16
_PROBES = 4096


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
        and grids, alone or with shift or strata-shift, at integer frequencies.

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
    source, p, nu = points_at(sampler, frequencies, density)
    n = source.check_count(n)
    source = source.as_chain(n)
    if p is None or isinstance(p, Uniform):
        return moments_of(source, n, nu).power(nu)
    reciprocal = p.reciprocal_integral()
    if not np.isfinite(reciprocal):
        warn(
            f"∫1/p diverges for {p.spec}: the expected power is infinite.",
            InfiniteWeightVarianceWarning,
        )
        return np.full(nu.shape[:-1], np.inf)
    base, moves = _translations(source)
    if base.name == "random":
        return np.asarray(reciprocal / n + (n - 1) / n * np.abs(_product(_interval(nu))) ** 2)
    _check_integers(source, nu)
    return np.asarray(_weighted_covariance(base, moves, n, nu, nu, p).real + _is_zero(nu))


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
    source, p, m = points_at(sampler, frequencies, density)
    n = source.check_count(n)
    source = source.as_chain(n)
    other = as_frequencies(others, m.shape[-1])
    try:
        m, other = np.broadcast_arrays(m, other)
    except ValueError:
        raise ParameterError(
            f"frequencies and others have shapes {m.shape} and {other.shape}, which do not "
            "broadcast; give one l for each m, or insert axes of length 1."
        ) from None
    if p is None or isinstance(p, Uniform):
        return moments_of(source, n, m, other).covariance(m, other)
    base, moves = _translations(source)
    _check_integers(source, m, other)
    if not np.isfinite(p.reciprocal_integral()):
        raise NoClosedForm(
            f"∫1/p diverges for {p.spec}: the covariances of S_m are infinite; measure the "
            "variance of the estimate by convergence instead."
        )
    return _weighted_covariance(base, moves, n, m, other, p)


@final
@dataclass(frozen=True)
class Moments:
    """Exact moments of S_ν."""

    mean: Callable[[Array], Array]  # ⟨S_ν⟩ of frequencies (..., d): complex (...)
    # C_ml of two arrays of frequencies of the same shape (..., d): complex (...)
    covariance: Callable[[Array, Array], Array]
    # Whether they hold at integer frequencies only: points wrapped around the torus
    integer: bool = False

    def power(self, nu: Array) -> Array:
        """⟨|S_ν|²⟩."""
        return np.asarray(self.covariance(nu, nu).real + np.abs(self.mean(nu)) ** 2)


def moments_of(sampler: Sampler, n: int, *frequencies: Array) -> Moments:
    """Return the exact moments of a sampler, if they are known at the given frequencies."""
    base, steps = _translations(sampler)
    integer = all(np.array_equal(nu, np.rint(nu)) for nu in frequencies)
    moments = _known_moments(base, n)
    if moments is None:
        raise _unknown(sampler)
    if base.name == "random":
        return moments
    if not integer and (steps or moments.integer):
        raise _unknown(sampler, "at real frequencies")
    for step in steps:
        moments = (
            _stationary(moments.power) if isinstance(step, Shift) else _moved(moments, step, n)
        )
    return moments


def points_at(
    sampler: Sampler | str, frequencies: Any, density: Density | str | None = None
) -> tuple[Sampler, Density | None, Array]:
    """The sampler, with the dims of the frequencies where it is a spec, the density, and these."""
    # An empty list has no dims: it is refused as such, not for them.
    dims = np.shape(frequencies)[-1] or None if np.ndim(frequencies) else None
    drawn = getattr(density, "primary_dims", dims)
    source = as_sampler(sampler, None if isinstance(sampler, Sampler) else drawn)
    p = as_warp(density, source.dims)
    return source, p, as_frequencies(frequencies, source.dims if p is None else p.dims)


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


def _check_integers(sampler: Sampler, *frequencies: Array) -> None:
    if not all(np.array_equal(nu, np.rint(nu)) for nu in frequencies):
        raise _unknown(sampler, "with a density at real frequencies")


def _known_moments(sampler: Any, n: int) -> Moments | None:
    """Return the moments of a sampler without randomisations, None where they are not known."""
    if sampler.fixed:
        return _fixed(sampler, n)
    match sampler.name:  # and not by class: modules of samplers that nobody uses are not loaded
        case "random":
            return _single((1,) * sampler.dims, n, _interval)
        case "jittered":
            return _single(sampler.sides(n), n, _interval)
        case "box-jitter":
            width = sampler.width
            cells = _cube(sampler, n)
            return _single(cells, n, lambda a: _center(a) * np.sinc(width * a), width > 1.0)
        case "gaussian-jitter":
            cells = _cube(sampler, n)
            return _single(cells, n, lambda a: _center(a) * _gauss(sampler.width, a), True)
        case "antithetic-jittered":

            def second(a: Array, b: Array) -> Array:
                # a point and its reflection: exp(−iπν) cos(2πν·η), η uniform in the centered cell
                mean = 0.5 * (_product(np.sinc(a - b)) + _product(np.sinc(a + b)))
                return np.asarray(_product(_center(a - b)) * mean)

            return _motifs(_cube(sampler, n // 2), n // 2, lambda a: _product(_interval(a)), second)
        case "uniform-jitter":
            return _offset_grid(np.asarray(sampler.sides(n), float))
        case "perturbed-lattice":
            return _stationary(lambda m: _displaced(sampler, n, m))
        case "determinantal":
            return _stationary(lambda m: _determinantal(sampler, n, m))
        case "latin-hypercube" | "n-rooks" if getattr(sampler, "strength", 1) == 1:
            # One point in each n-th of every axis, at random
            return _of_pairs(n, lambda m, l: (1.0 - 1.0 / n) * _product(_apart(m, l, n)))
        case "latin-hypercube" | "n-rooks":
            return _orthogonal_array(root(n, 2), sampler.dims, shared_out=True)
        case "orthogonal-array":
            if sampler.strength != 2 or sampler.jitter == "correlated-multi-jittered":
                return None
            shared_out = sampler.jitter == "multi-jittered"
            return _orthogonal_array(root(n, 2), sampler.dims, shared_out=shared_out)
        case "multi-jittered":
            return _multi_jittered(nearly_square(n), n)
    return None


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
        return np.asarray(_product(_comb(m - other, s)) * within / count)

    return Moments(lambda nu: _product(_comb(nu, s)) * mean(nu / s), covariance, integer)


def _single(
    sides: tuple[int, ...], count: int, axis: Callable[[Array], Array], integer: bool = False
) -> Moments:
    """One point in each cell, its coordinates independent and of the transform `axis`."""
    return _motifs(
        sides, count, lambda a: _product(axis(a)), lambda a, b: _product(axis(a - b)), integer
    )


def _offset_grid(s: Array) -> Moments:
    """A grid of s points along each axis, with one uniform offset within a cell."""

    def covariance(m: Array, other: Array) -> Array:
        offset = _product(_interval((m - other) / s))
        offset = offset - _product(_interval(m / s)) * np.conj(_product(_interval(other / s)))
        return np.asarray(_product(_comb(m, s)) * np.conj(_product(_comb(other, s))) * offset)

    return Moments(lambda nu: _product(_comb(nu, s) * _interval(nu / s)), covariance)


def _stationary(power: Callable[[Array], Array]) -> Moments:
    """Moments at integers of a set that is the same after any translation: unbiased, and diagonal."""

    def covariance(m: Array, other: Array) -> Array:
        same = np.all(m == other, axis=-1)
        return np.asarray(np.where(same, power(m) - _is_zero(m), 0.0) + 0j)

    return Moments(lambda nu: _is_zero(nu) + 0j, covariance, integer=True)


def _displaced(sampler: Any, n: int, m: Array) -> Array:
    """Power of a grid with Gaussian displacements; the common translation leaves it alone.

    (1/n) Σ_r exp(−2πi m·r/s) exp(−4π² |m|² (width/s)² (1 − ρ(r))) over the places r of the grid, where
    ρ is the correlation of displacements r apart ([Gabrielli2004]_, of Gaussian ones).
    """
    sides = _cube(sampler, n)
    if sampler.correlation == 0.0:
        s = np.asarray(sides, float)
        square = _product(_gauss(sampler.width, m / s)) ** 2
        return np.asarray((1.0 - square) / n + square * np.abs(_product(_comb(m, s))) ** 2)
    _check_terms(n, m)
    places = np.stack(np.unravel_index(np.arange(n), sides), axis=-1)
    apart = 1.0 - sampler.displacement_correlation(n).reshape(-1)

    def terms(rows: Array) -> Array:
        spread = (2.0 * np.pi * sampler.width / sides[0]) ** 2 * (rows**2).sum(axis=-1)
        phases = 2.0 * np.pi * np.remainder(rows @ places.T / sides[0], 1.0)
        return np.asarray(np.cos(phases) * np.exp(-np.outer(spread, apart)))

    return _mean_of_terms(n, m, terms)


def _determinantal(sampler: Any, n: int, m: Array) -> Array:
    """Power by the share of waves that m moves to others."""
    waves = sampler.frequencies(n)
    flat = np.rint(m).reshape(-1, sampler.dims).astype(np.int64)
    rows, back = np.unique(flat, axis=0, return_inverse=True)

    # Each frequency has a number, the sum of those of its coordinates; no two have the same
    factors = np.random.default_rng(n).integers(2**63, size=sampler.dims)
    numbers = np.sort(waves @ factors)
    pairs = np.zeros(len(rows))
    near = np.flatnonzero((np.abs(rows) <= 2 * np.abs(waves).max(axis=0)).all(axis=1))
    for some in np.array_split(near, len(near) * n // _BLOCK + 1):
        moved = numbers + (rows[some] @ factors)[:, None]
        found = numbers[np.minimum(np.searchsorted(numbers, moved), n - 1)]
        pairs[some] = (found == moved).sum(axis=1)
    share = pairs[back.reshape(-1)].reshape(m.shape[:-1]) / n
    return np.asarray((1.0 - share) / n + _is_zero(m))


def _fixed(sampler: Any, n: int) -> Moments:
    """A set that is the same every time: S_ν itself, by the dual lattice or by summing it."""

    def mean(nu: Array) -> Array:
        if sampler.name == "regular":
            s = np.asarray(sampler.sides(n), float)
            corner = _center(nu / s) if sampler.position == "center" else 1.0
            return _product(_comb(nu, s) * corner)
        if hasattr(sampler, "generating_vector") and np.array_equal(nu, np.rint(nu)):
            # 1 where m·z ≡ 0 modulo n; residues are multiplied, so that nothing overflows
            vector = sampler.generating_vector(n)
            residues = np.rint(np.remainder(nu, n)).astype(np.int64) * (vector % n) % n
            return np.asarray((residues.sum(axis=-1) % n == 0) + 0j)
        _check_terms(n, nu)
        points = sampler.draw_stream(n, Stream.from_rng(0), 0, 1)[0]

        def terms(rows: Array) -> Array:
            return np.asarray(np.exp(-2j * np.pi * np.remainder(rows @ points.T, 1.0)))

        return _mean_of_terms(n, nu, terms)

    return Moments(mean, lambda m, other: np.zeros(np.broadcast(m, other).shape[:-1], complex))


def _check_terms(n: int, nu: Array) -> None:
    if float(n) * max(64, nu[..., 0].size) > _MAX_WORK:  # the points take memory, too
        raise NoClosedForm(
            f"The exact transform of {n} points at {nu[..., 0].size} frequencies would take more "
            f"than {_MAX_WORK:.2g} terms; use power_spectrum, or ask for fewer frequencies."
        )


def _mean_of_terms(n: int, nu: Array, terms: Callable[[Array], Array]) -> Array:
    """Mean of n terms for each frequency (..., d), a block of frequencies (F, d) at a time."""
    rows = nu.reshape(-1, nu.shape[-1])
    block = max(1, 2**22 // n)
    parts = [terms(rows[i : i + block]).mean(axis=-1) for i in range(0, len(rows), block)]
    return np.concatenate(parts).reshape(nu.shape[:-1])


def _orthogonal_array(s: int, dims: int, *, shared_out: bool) -> Moments:
    """Strength 2, s² points, levels renamed at random: two rows agree on one axis at most.

    Of the s²(s² − 1) ordered pairs, s²(s − 1) agree on each axis. Points of a level are
    independent in it, or share it out (`shared_out`): each in an s-th of it of its own.
    """
    n = s * s

    def pairs(m: Array, other: Array) -> Array:
        differ = _apart(m, other, s)
        agree = _level_mates(m, other, s) if shared_out else _same(m, other, s)
        on_one = sum(
            _product(np.where(np.arange(dims) == axis, agree, differ)) for axis in range(dims)
        )
        return np.asarray((s - 1) / n * (on_one + (s + 1 - dims) * _product(differ)))

    return _of_pairs(n, pairs)


def _multi_jittered(columns: int, n: int) -> Moments:
    """Columns × rows cells; the points of a column share it out, those of a row likewise.

    Two points are in one column, in one row, or in neither; what is not shared is independent.
    """
    rows = n // columns

    def pairs(m: Array, other: Array) -> Array:
        s = np.array([columns, rows])
        free, same = _free(m, other), _same(m, other, s)
        # Sums over pairs of strata of an axis, divided by s²: all different ones, and equal ones
        different = free - same / s
        mates = _level_mates(m, other, s, np.array([rows, columns])) / s
        return np.asarray(
            _product(different)
            + mates[..., 0] * different[..., 1]
            + different[..., 0] * mates[..., 1]
        )

    return _of_pairs(n, pairs)


def _of_pairs(n: int, pairs: Callable[[Array, Array], Array]) -> Moments:
    """Moments of n points each uniform, from (1/n²) Σ over pairs of different points."""

    def covariance(m: Array, other: Array) -> Array:
        second = _product(_interval(m - other)) / n + pairs(m, other)
        return np.asarray(second - _product(_free(m, other)))

    return Moments(lambda nu: _product(_interval(nu)), covariance)


def _free(m: Array, other: Array) -> Array:
    return np.asarray(_interval(m) * np.conj(_interval(other)))


def _same(m: Array, other: Array, s: int | Array) -> Array:
    return _comb(m - other, s) * _free(m / s, other / s)


def _apart(m: Array, other: Array, s: int | Array) -> Array:
    strata = np.asarray(s, float)
    difference = strata * _free(m, other) - _same(m, other, s)
    return np.asarray(difference / np.maximum(strata - 1.0, 1.0))  # one stratum has no such pair


def _level_mates(m: Array, other: Array, s: int | Array, parts: int | Array | None = None) -> Array:
    """Two points of one of s strata, in different ones of its `parts` (s if not given)."""
    return _comb(m - other, s) * _apart(m / s, other / s, s if parts is None else parts)


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


def _interval(nu: Array) -> Array:
    """Transform of the unit interval, χ(ν), of each coordinate."""
    return np.asarray(np.sinc(nu) * np.exp(-1j * np.pi * np.remainder(nu, 2.0)))


def _comb(nu: Array, sides: Any) -> Array:
    """Transform of the grid {j/s}, A_s(ν), of each coordinate; period s."""
    s = np.asarray(sides, float)
    rest = nu - s * np.rint(nu / s)  # within half a period the quotient is safe
    return np.asarray(_interval(rest) / _interval(rest / s))


def _product(values: Array) -> Array:
    """Π over the axes."""
    return np.asarray(np.prod(values, axis=-1))


def _cube(sampler: Sampler, cells: int) -> tuple[int, ...]:
    return (root(cells, sampler.dims),) * sampler.dims


def _center(a: Array) -> Array:
    """Phase of the center of a cell, of each coordinate."""
    return np.asarray(np.exp(-1j * np.pi * np.remainder(a, 2.0)))


def _gauss(width: float, a: Array) -> Array:
    return np.asarray(np.exp(-2.0 * (np.pi * width * a) ** 2))


def _is_zero(m: Array) -> Array:
    return np.asarray(np.all(m == 0, axis=-1).astype(float))


# ---- With a density


def _weighted_covariance(
    base: Any,
    moves: Sequence[Shift | StrataShift],
    n: int,
    m: Array,
    other: Array,
    density: Density,
) -> Array:
    """C_ml of importance-sampled points at integers m, l of one shape (..., d): complex (...)."""
    zero = np.all(m == 0, axis=-1) & np.all(other == 0, axis=-1)
    shifted = any(isinstance(step, Shift) for step in moves)
    if base.name in ("regular", "uniform-jitter"):
        if base.name == "regular" and not shifted:
            raise NoClosedForm(
                f"{base.spec} is the same every time, so that nothing varies; add shift, or use "
                "power_spectrum."
            )
        highest, power = _highest(m, other), np.ones(m.shape[:-1])
        for i, (p, s) in enumerate(zip(_factors(density), base.sides(n), strict=True)):
            axis = _Axis(p, s, *_all_offsets(p, s, 1.0 / s, highest))
            power = power * axis.mean_product(axis.of_grid, m[..., i], other[..., i])
        return np.asarray(power - zero)
    reciprocal = _reciprocal(density, m - other)
    if base.name == "random":
        return np.asarray((reciprocal - zero) / n)
    latin = base.name == "latin-hypercube" and getattr(base, "strength", 1) == 1
    if base.name != "jittered" and not latin:
        raise NoClosedForm(
            f"No covariances are known for {base.spec} with the density {density.spec}; give random, "
            "jittered, latin-hypercube, or a grid with shift, or use variance_terms."
        )
    # Strata of each axis: where they are, or everywhere if a random shift follows
    sides = (n,) * base.dims if latin else base.sides(n)
    offset = np.zeros(density.dims)
    for step in moves:
        if isinstance(step, StrataShift):
            offset = offset + np.asarray(step.offset, float) * n ** (-1.0 / density.dims)
    highest, pairs = _highest(m, other), np.ones(m.shape[:-1])
    for i, (p, s) in enumerate(zip(_factors(density), sides, strict=True)):
        rule = np.remainder(np.arange(s) / s + offset[i], 1.0), np.full(s, 1.0 / s)
        axis = _Axis(p, s, *(_all_offsets(p, s, 1.0, highest) if shifted else rule))
        same = axis.mean_product(axis.of_stratum, m[..., i], other[..., i])
        if latin:  # points of two different strata; one stratum has no such pair
            free = (m[..., i] == 0) & (other[..., i] == 0)
            same = (n * free - same) / max(n - 1, 1)
        pairs = pairs * same
    if latin:
        return np.asarray(reciprocal / n + (1.0 - 1.0 / n) * pairs - zero)
    return np.asarray((reciprocal - pairs) / n)


@final
@dataclass(frozen=True)
class _Axis:
    """One axis: s strata or points, the starts t of the strata with weights, and the 1-D density."""

    density: Density
    sides: int
    starts: Array
    weights: Array

    def mean_product(self, of: Callable[[Array], Array], m: Array, other: Array) -> Array:
        """Mean of of(m) conj of(l) over the starts; each frequency is transformed once."""
        known, back = np.unique(np.stack([m, other]), return_inverse=True)
        row, column = back.reshape(2, -1)
        if float(self.starts.size) * max(row.size, known.size * self.sides) > _MAX_STRATA_WORK:
            raise NoClosedForm(
                f"The covariances of {row.size} pairs of frequencies over {self.sides} strata of "
                f"{self.density.spec} take more than {_MAX_STRATA_WORK:.2g} terms; ask for fewer."
            )
        values = of(known)
        out = np.empty(row.size, complex)
        block = max(1, _BLOCK // self.starts.size)
        for i in range(0, row.size, block):
            left, right = values[row[i : i + block]], values[column[i : i + block]]
            out[i : i + block] = np.einsum("ij,ij,j->i", left, np.conj(right), self.weights)
        return out.reshape(m.shape)

    def of_stratum(self, m: Array) -> Array:
        """M_t(m): (frequencies, starts); strata beyond 1 go on at 0."""
        end = self.starts + 1.0 / self.sides
        over = np.maximum(end - 1.0, 0.0)
        first = _strips(m, self._warp(self.starts), self._warp(np.minimum(end, 1.0)))
        return np.asarray(self.sides * (first + _strips(m, np.zeros(1), self._warp(over))))

    def of_grid(self, m: Array) -> Array:
        """A_δ(m), the starts being the offsets: (frequencies, offsets)."""
        total = np.zeros((m.size, self.starts.size), complex)
        for j in range(self.sides):
            x = self._warp(self.starts + j / self.sides)
            total += np.exp(-2j * np.pi * np.outer(m, x)) / self.density.pdf(x[:, None])
        return total / self.sides

    def _warp(self, u: Array) -> Array:
        """T(u), 1 at 1; rounding may have left [0,1)."""
        x = self.density.sample(np.clip(u, 0.0, 1.0)[:, None])[:, 0]
        return np.where(u <= 0.0, 0.0, np.where(u >= 1.0, 1.0, x))


def _strips(m: Array, low: Array, high: Array) -> Array:
    """∫ exp(−2πi m x) dx from low to high: (frequencies, intervals)."""
    width, middle = high - low, 0.5 * (low + high)
    return np.asarray(
        width * np.sinc(np.outer(m, width)) * np.exp(-2j * np.pi * np.outer(m, middle))
    )


def _all_offsets(density: Density, sides: int, length: float, highest: int) -> tuple[Array, Array]:
    """Rule for the mean over t in [0, length): cut where a stratum's ends meet breaks or the seam."""
    breaks = np.array([0.0, *density.breaks[0]])
    ends = np.concatenate([breaks, breaks - 1.0 / sides]) % 1.0 % length
    cells = max(_CELLS, 2 * highest)
    rule = AxisRule.make(_ORDER * cells, _ORDER, tuple(np.unique(ends / length).tolist()))
    return rule.nodes * length, rule.weights


def _highest(m: Array, other: Array) -> int:
    highest = max(float(np.abs(m).max(initial=0)), float(np.abs(other).max(initial=0)))
    if highest > _HIGHEST:
        raise NoClosedForm(
            f"Frequencies up to {highest:.3g} take too fine a quadrature; give {_HIGHEST} at most."
        )
    return int(highest)


def _factors(density: Density) -> list[Density]:
    """The density of each axis, if it is known to be a product over them with monotone warps."""
    if density.dims == 1:
        factors = [density]
    elif isinstance(density, Linear):
        slopes = np.broadcast_to(density.slope, density.dims)
        factors = [Linear(dims=1, slope=float(slope)) for slope in slopes]
    elif isinstance(density, TruncatedNormal):
        both = (np.broadcast_to(each, density.dims) for each in (density.mean, density.sigma))
        factors = [
            TruncatedNormal(dims=1, mean=float(mean), sigma=float(sigma))
            for mean, sigma in zip(*both, strict=True)
        ]
    else:
        factors = list(getattr(density, "parts", ())) if density.name == "product" else []
    # Probe whether the warps are monotone
    u = (np.arange(_PROBES) / _PROBES)[:, None]
    monotone = all(
        p.dims == 1
        and getattr(p, "primary_dims", 1) == 1
        and (np.diff(p.sample(u)[:, 0]) >= 0).all()
        for p in factors
    )
    if not factors or not monotone:
        raise NoClosedForm(
            f"Covariances of stratified points are known for densities that are products over the "
            f"axes, of increasing warps, not for {density.spec}; use variance_terms."
        )
    return factors


def _reciprocal(density: Density, k: Array) -> Array:
    """(1/p)^_k at integers k (..., d)."""
    try:
        factors = _factors(density)
    except NoClosedForm:
        whole = Integrand.from_function(
            lambda x: 1.0 / density.pdf(x),
            dims=density.dims,
            integral=density.reciprocal_integral(),
        )
        return whole.fourier(k)
    found = np.ones(k.shape[:-1], complex)
    for i, p in enumerate(factors):
        known, back = np.unique(k[..., i], return_inverse=True)
        count = 1 << (max(2**14, _ORDER * _highest(known, known)) - 1).bit_length()
        jumps = p.sample(np.array(p.breaks[0], float)[:, None])[:, 0]
        rule = AxisRule.make(count, _ORDER, tuple(jumps.tolist()))
        values = rule.transform(1.0 / p.pdf(rule.nodes[:, None]), known)
        found *= values[back].reshape(k.shape[:-1])
    return found
