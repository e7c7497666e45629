"""Rank-1 lattices: given generating vectors, or vectors built component by component."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers.base import Sampler, Structure, check_dims

__all__ = ["Rank1Lattice"]

_EVALUATIONS = 2**24  # kernel values per component: about 0.1 s
_LEAST_CANDIDATES = 16


@final
@dataclass(frozen=True, kw_only=True)
class Rank1Lattice(Sampler):
    """Rank-1 lattice {k z / n}, k = 0 … n−1, the same every time; randomise with shift.

    Attributes
    ----------
    vector
        Generating vector z, one whole number for each dim. By default it is built component by
        component for each n.

    Notes
    -----
    The construction minimises, one component after the other, the squared worst-case error of the
    shifted lattice in the Korobov space of smoothness α = 2 with product weights γ_j = 1/j²,

        P_2 = −1 + (1/n) Σ_k Π_j (1 + γ_j 2π² B_2({k z_j/n})),   B_2(x) = x² − x + 1/6,

    over the z_j ≤ n/2 coprime to n: all of them as long as that takes at most 2^24 values of B_2
    a component (n up to 5,792), else evenly spread ones, 16 at least. Kept in memory by (n, d).

    References
    ----------
    Sloan, Reztsov (2002), "Component-by-component construction of good lattice rules",
    doi 10.1090/S0025-5718-01-01342-4.
    """

    name: ClassVar[str] = "rank1-lattice"
    structure: ClassVar[Structure] = Structure.TORUS
    unbiased: ClassVar[bool] = False
    dims: int = DEFAULT_DIMS
    vector: Sequence[int] | None = None

    def __post_init__(self) -> None:
        check_dims(self)
        if self.vector is not None:
            object.__setattr__(self, "vector", _checked_vector(self.vector, self.dims))

    def generating_vector(self, n: int) -> Array:
        """Return z for `n` points: int64 (dims,), 0 ≤ z_j < max(n, 2)."""
        n = self.check_count(n)
        if self.vector is not None:
            return np.array([z % n for z in self.vector], dtype=np.int64)
        return np.array(_built_vector(n, self.dims), dtype=np.int64)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        multiples = np.arange(n)[:, None] * self.generating_vector(n) % n
        return np.tile(multiples / n, (count, 1, 1))


def _checked_vector(vector: object, dims: int) -> tuple[int, ...]:
    if not isinstance(vector, Sequence | np.ndarray) or isinstance(vector, str):
        raise ParameterError(
            f"vector is {vector!r}; give a list of whole numbers, one for each of the {dims} dims."
        )
    if len(vector) != dims:
        raise ParameterError(
            f"vector has {len(vector)} components, dims is {dims}; give one for each dim."
        )
    return tuple(as_integer(f"vector[{j}]", z, least=0) for j, z in enumerate(vector))


@lru_cache(maxsize=256)
def _built_vector(n: int, dims: int) -> tuple[int, ...]:
    """Generating vector by the component-by-component construction."""
    k = np.arange(n)
    x = k / n
    kernel = 2.0 * np.pi**2 * (x * x - x + 1.0 / 6.0)
    candidates = _candidates(n)
    product, vector = np.ones(n), []
    for j in range(1, dims + 1):
        # All first components give the same points: take 1
        options = candidates if j > 1 else candidates[:1]
        errors = [product @ kernel[k * z % n] for z in options]
        best = int(options[_first_least(errors)])
        product *= 1.0 + kernel[k * best % n] / j**2
        vector.append(best)
    return tuple(vector)


def _candidates(n: int) -> Array:
    """Numbers 1 … n/2 coprime to n (z and n − z give equal errors), evenly thinned for large n."""
    z = np.arange(1, max(2, n // 2 + 1))
    z = z[np.gcd(z, n) == 1]
    most = max(_LEAST_CANDIDATES, _EVALUATIONS // n)
    spread = np.linspace(0, z.size - 1, min(most, z.size))
    return np.asarray(z[spread.astype(np.int64)])


def _first_least(errors: Sequence[float]) -> int:
    """First index whose error is least but for rounding, so that sums in another order agree."""
    values = np.asarray(errors)
    tolerance = 1e-9 * float(np.abs(values).max())
    return int(np.flatnonzero(values <= values.min() + tolerance)[0])
