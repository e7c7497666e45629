"""Products of densities over groups of dims, each part on its own axes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import MAX_DIMS, Array
from mcspectra.core.errors import ParameterError
from mcspectra.densities.base import Density
from mcspectra.densities.parts import as_parts, with_dims

__all__ = ["Product"]

_PLACES = 4  # of the other coordinates, for each zero of a part


@final
@dataclass(frozen=True, kw_only=True)
class Product(Density):
    """Product of densities, p(x) = Π_j p_j(x of part j): the parts take the axes one after another.

    Attributes
    ----------
    parts
        Densities or spec strings. A spec string without ``dims`` stands for one dim:
        ``product(parts=["linear(slope=1)", "tent"])`` is in 2-D.
    """

    name: ClassVar[str] = "product"
    parts: Any

    def __post_init__(self) -> None:
        parts = as_parts(self.parts, 1)
        if sum(part.dims for part in parts) > MAX_DIMS:
            raise ParameterError(
                f"The parts of a product have more than {MAX_DIMS} dims in all; use fewer parts."
            )
        object.__setattr__(self, "parts", parts)

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Sum over the parts."""
        return sum(part.dims for part in self.parts)

    @property
    def primary_dims(self) -> int:
        """Sum over the parts."""
        return sum(part.primary_dims for part in self.parts)

    @property
    def spec(self) -> str:
        """Spec string, with the dims of parts that do not have one."""
        return f"{self.name}(parts=[{', '.join(repr(with_dims(part)) for part in self.parts)}])"

    @property
    def has_inverse(self) -> bool:
        """Whether all parts have one."""
        return all(part.has_inverse for part in self.parts)

    @property
    def one_to_one(self) -> bool:
        """Whether all parts are."""
        return all(part.one_to_one for part in self.parts)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Breaks of the parts, on their axes."""
        return tuple(axis for part in self.parts for axis in part.breaks)

    def zero_points(self) -> Array:
        """Zeros of each part, each at a few places along the other axes."""
        return self.lifted([part.zero_points() for part in self.parts])

    def lifted(self, points: Sequence[Array]) -> Array:
        """Points of each part, (k_j, d_j), each at a few places along the other axes: (Σk_j, d)."""
        pairs = zip(points, self._domain, strict=True)
        return np.concatenate([self._at_places(part, own) for part, own in pairs])

    def reciprocal_integral(self) -> float:
        """Product over the parts."""
        return float(math.prod(part.reciprocal_integral() for part in self.parts))

    @cached_property
    def _domain(self) -> tuple[slice, ...]:
        return _slices([part.dims for part in self.parts])

    @cached_property
    def _primary(self) -> tuple[slice, ...]:
        return _slices([part.primary_dims for part in self.parts])

    def _at_places(self, points: Array, own: slice) -> Array:
        places = (
            np.arange(len(points))[:, None] % _PLACES + 0.5 + 0.25 * np.sin(np.arange(self.dims))
        )
        lifted = np.asarray(places / (_PLACES + 0.25))
        lifted[:, own] = points
        return lifted

    def _pdf(self, x: Array) -> Array:
        factors = (p._pdf(x[..., own]) for p, own in zip(self.parts, self._domain, strict=True))
        return math.prod(factors, start=np.ones(x.shape[:-1]))

    def _sample(self, u: Array) -> Array:
        return self._joined(lambda part, v: part.sample(v), u, self._primary)

    def _invert(self, x: Array) -> Array:
        return self._joined(lambda part, v: part.invert(v), x, self._domain)

    def _joined(
        self, warp: Callable[[Density, Array], Array], v: Array, groups: tuple[slice, ...]
    ) -> Array:
        pieces = [warp(part, v[..., own]) for part, own in zip(self.parts, groups, strict=True)]
        return np.concatenate(pieces, axis=-1)


def _slices(sizes: list[int]) -> tuple[slice, ...]:
    ends = np.cumsum([0, *sizes]).tolist()
    return tuple(slice(a, b) for a, b in itertools.pairwise(ends))
