"""Exact means and covariances of S_m for importance-sampled points, x = T(u), weights 1/(n p).

docs/theory.md, "Closed forms", has the derivation for densities that are products over the axes with
monotone warps: M_t(m) of the stratum that starts at t, *same* and *apart* of two points, their means
taken over the strata, or over all t where a random shift follows. A grid with one offset δ has

    C_ml = Π_i ∫ A_δ(m_i) conj A_δ(l_i) dδ − δ_m0 δ_l0

with A_δ(m) the S_m of the grid of offset δ on one axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import NoClosedForm
from mcspectra.densities import Density, Linear, TruncatedNormal
from mcspectra.integrands import Integrand
from mcspectra.integrands._quadrature import AxisRule
from mcspectra.samplers import Shift, StrataShift

__all__ = ["weighted_covariance"]

_BLOCK = 2**20  # numbers at once
_MAX_WORK = 2**31  # strata times pairs of frequencies: some minutes
_ORDER = 16
_CELLS = 64
_HIGHEST = 2**16
_PROBES = 4096


def weighted_covariance(
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
        if float(self.starts.size) * max(row.size, known.size * self.sides) > _MAX_WORK:
            raise NoClosedForm(
                f"The covariances of {row.size} pairs of frequencies over {self.sides} strata of "
                f"{self.density.spec} take more than {_MAX_WORK:.2g} terms; ask for fewer."
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
        first = _interval(m, self._warp(self.starts), self._warp(np.minimum(end, 1.0)))
        return np.asarray(self.sides * (first + _interval(m, np.zeros(1), self._warp(over))))

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


def _interval(m: Array, low: Array, high: Array) -> Array:
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
        factors = [Linear(dims=1, slope=s) for s in _each(density.slope, density.dims)]
    elif isinstance(density, TruncatedNormal):
        both = zip(
            _each(density.mean, density.dims), _each(density.sigma, density.dims), strict=True
        )
        factors = [TruncatedNormal(dims=1, mean=mean, sigma=sigma) for mean, sigma in both]
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


def _each(value: float | tuple[float, ...], dims: int) -> tuple[float, ...]:
    return value if isinstance(value, tuple) else (value,) * dims


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
    return np.asarray(
        np.prod([_reciprocal_1d(p, k[..., i]) for i, p in enumerate(factors)], axis=0)
    )


def _reciprocal_1d(density: Density, k: Array) -> Array:
    known, back = np.unique(k, return_inverse=True)
    count = 1 << (max(2**14, _ORDER * _highest(known, known)) - 1).bit_length()
    jumps = density.sample(np.array(density.breaks[0], float)[:, None])[:, 0]
    rule = AxisRule.make(count, _ORDER, tuple(jumps.tolist()))
    values = rule.transform(1.0 / density.pdf(rule.nodes[:, None]), known)
    return np.asarray(values[back].reshape(k.shape))
