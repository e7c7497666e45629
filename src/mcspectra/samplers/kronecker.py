"""Kronecker points: the multiples of an irrational vector on the torus."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_reals
from mcspectra.core.errors import ParameterError
from mcspectra.core.jit import kernel
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers._repeated import repeated
from mcspectra.samplers.base import Sampler, Structure, check_dims

__all__ = ["Kronecker", "golden_steps"]

_BITS = 64
_S11, _UNIT = np.uint64(11), 2.0**-53


@final
@dataclass(frozen=True, kw_only=True)
class Kronecker(Sampler):
    """Kronecker points {k α}, k = 0, 1, …, deterministic; randomise with shift.

    Any dims, any count.

    Attributes
    ----------
    alpha
        The vector α, one number for each dim. By default that of the R-sequence: α_j = φ^(−j), where
        φ is the root greater than 1 of φ^(d+1) = φ + 1, in 1-D the golden ratio.

    Notes
    -----
    Multiples are added up in whole numbers of 2^-64, modulo 1: nothing is lost on the way, and
    differences of points depend on those of their indices alone. Numbers whose fractions are simple
    (0.5) put all points on few lines; whether α is irrational is up to the user.

    References
    ----------
    Roberts (2018), "The unreasonable effectiveness of quasirandom sequences",
    extremelearning.com.au; Niederreiter (1992), "Random number generation and quasi-Monte Carlo
    methods", doi 10.1137/1.9781611970081.
    """

    name: ClassVar[str] = "kronecker"
    structure: ClassVar[Structure] = Structure.TORUS
    sequence: ClassVar[bool] = True
    unbiased: ClassVar[bool] = False
    fixed: ClassVar[bool] = True
    dims: int = DEFAULT_DIMS
    alpha: Sequence[float] | None = None

    def __post_init__(self) -> None:
        check_dims(self)
        if self.alpha is not None:
            object.__setattr__(self, "alpha", _checked_alpha(self.alpha, self.dims))

    def steps(self) -> Array:
        """Return α modulo 1 in units of 2^-64: uint64 (dims,)."""
        if self.alpha is None:
            return golden_steps(self.dims)
        return np.array([_in_units(a) for a in self.alpha], dtype=np.uint64)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        points = np.empty((n, self.dims))
        _fill_multiples(self.steps(), points)
        return repeated(points, count)


@lru_cache(maxsize=64)
def golden_steps(dims: int) -> Array:
    """Return φ^(−1) … φ^(−d) in units of 2^-64, φ^(d+1) = φ + 1: uint64 (dims,), read-only."""
    bits = _BITS + 32  # the error grows with the power
    one = 1 << bits
    ratio = _inverse_root(dims, bits)
    power, steps = one, []
    for _ in range(dims):
        power = power * ratio >> bits
        steps.append(power >> (bits - _BITS))
    array = np.array(steps, dtype=np.uint64)
    array.setflags(write=False)
    return array


def _inverse_root(dims: int, bits: int) -> int:
    """1/φ in units of 2^-bits, by bisection: x = 1/φ solves x^(d+1) + x^d = 1."""
    low, high = 0, 1 << bits
    while high - low > 1:
        middle = (low + high) // 2
        power = 1 << bits
        for _ in range(dims):
            power = power * middle >> bits
        if power + (power * middle >> bits) <= 1 << bits:
            low = middle
        else:
            high = middle
    return low


@kernel
def _fill_multiples(steps: Array, out: Array) -> None:
    # 0, α, 2α, … modulo 1 = 2^64 units: steps uint64 (d,), out (n, d)
    n, dims = out.shape
    for j in range(dims):
        multiple = np.uint64(0)
        for k in range(n):
            out[k, j] = np.float64(multiple >> _S11) * _UNIT
            multiple += steps[j]


def _checked_alpha(alpha: object, dims: int) -> tuple[float, ...]:
    listed = isinstance(alpha, Sequence | np.ndarray) and not isinstance(alpha, str)
    if not listed and dims > 1:
        raise ParameterError(
            f"alpha is {alpha!r}; give a list of {dims} numbers, one for each dim."
        )
    values = as_reals("alpha", alpha, dims)
    for j, value in enumerate(values):
        if not _in_units(value):
            raise ParameterError(
                f"alpha[{j}] is {value!r}, a whole number: all points would have coordinate 0; "
                "give irrational numbers, e.g. 0.6180339887498949."
            )
    return values


def _in_units(value: float) -> int:
    """The fraction of a float in units of 2^-64."""
    one = 1 << _BITS
    return round(Fraction(value) % 1 * one) % one
