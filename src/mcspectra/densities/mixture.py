"""Mixtures of densities, p = Σ_t w_t p_t, and the two ways in which one point chooses its part.

Which selection
---------------
* ``"coordinate"``: one coordinate of u chooses the part and is stretched to be used again. Dims and
  strata are kept, but the warp jumps at the borders of the shares w_t: g(u) = f/p jumps there too,
  which costs jittered and low-discrepancy points their rate.
* ``"extra"``: a further coordinate, the last one, chooses: each part sees all of the other ones, but
  the estimator needs a sampler of d+1 dims, and g still jumps across it.
* A *deterministic split* draws n w_t points of each part. That is no warp of one point but several
  techniques with the balance heuristic: `mcspectra.estimators.split_mixture`.

Owen, Zhou (2000), "Safe and effective importance sampling", J. Amer. Statist. Assoc. 95, §3, for
mixtures, their stratification and *defensive* ones, which hold a share of a density that is large
enough everywhere (Hesterberg 1995).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer, as_real, as_real_array
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.densities.analytic import Uniform
from mcspectra.densities.base import LARGEST_BELOW_ONE, Density, plain, store_integer
from mcspectra.densities.parts import as_part, as_parts

__all__ = ["Defensive", "Mixture"]

_SELECTIONS = ("coordinate", "extra")


@final
@dataclass(frozen=True, kw_only=True)
class Mixture(Density):
    """Mixture of densities, p = Σ_t w_t p_t, the part chosen by one coordinate of u.

    Attributes
    ----------
    dims
        Number of dims; by default that of the parts, 2 where they are spec strings without ``dims``.
    parts
        Densities p_t or spec strings.
    weights
        Relative shares w_t, above 0, of any scale; equal by default.
    selection
        ``"coordinate"`` or ``"extra"``.
    axis
        The coordinate that chooses, with ``"coordinate"``; with ``"extra"`` it is the last one.

    Notes
    -----
    The warp is not one-to-one, as each x may come from any part: there is no inverse. The pdf does
    not depend on the selection.
    """

    name: ClassVar[str] = "mixture"
    dims: int = None  # type: ignore[assignment]  # the parts' own
    parts: Any
    weights: Any = None
    selection: str = "coordinate"
    axis: int = 0

    def __post_init__(self) -> None:
        if self.selection == "split":
            raise ParameterError(
                "A mixture by deterministic split is several techniques, not one density; use "
                "mcspectra.estimators.split_mixture(integrand, mixture)."
            )
        as_choice("selection", self.selection, _SELECTIONS)
        parts = as_parts(self.parts, _dims_of(self.parts, self.dims))
        dims = _common_dims(parts, self.dims)
        store_integer(self, "axis", least=0, most=dims - 1)
        weights = None if self.weights is None else _as_weights(self.weights, len(parts))
        for name, value in (("parts", parts), ("weights", weights), ("dims", dims)):
            object.__setattr__(self, name, value)

    @property
    def shares(self) -> Array:
        """w_t, with the sum 1."""
        weights = np.ones(len(self.parts)) if self.weights is None else np.array(self.weights)
        return np.asarray(weights / weights.max() / (weights / weights.max()).sum())

    @property
    def primary_dims(self) -> int:
        """d, or d + 1 with a coordinate that only chooses."""
        return self.dims + (self.selection == "extra")

    @property
    def has_inverse(self) -> bool:
        """False: x may come from any part."""
        return False

    @property
    def one_to_one(self) -> bool:
        """False: x may come from any part."""
        return False

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Borders of the shares on the axis that chooses; those of all parts on every axis."""
        found: list[set[float]] = [set() for _ in range(self.primary_dims)]
        found[self._chooser].update(self._borders[1:-1].tolist())
        for t, part in enumerate(self.parts):
            for axis, own in enumerate(part.breaks):
                stretched = axis == self._chooser
                found[axis].update(float(self._place(t, b)) if stretched else b for b in own)
        return tuple(tuple(sorted(b for b in axis if 0 < b < 1)) for axis in found)

    def preimages(self, x: object) -> Array:
        """Primary points of every part that has an inverse, with selection by a coordinate."""
        if self.selection == "extra":  # a line of u for each x and part
            return np.empty((0, self.primary_dims))
        found = [part.preimages(x) for part in self.parts]
        for t, u in enumerate(found):
            u[:, self.axis] = self._place(t, u[:, self.axis])
        return np.concatenate(found)

    def zero_points(self) -> Array:
        """Zeros of any part that are zeros of the mixture."""
        zeros = np.concatenate([part.zero_points() for part in self.parts])
        return np.asarray(zeros[self._pdf(zeros) == 0])

    def _pdf(self, x: Array) -> Array:
        total = np.zeros(x.shape[:-1])
        for share, part in zip(self.shares, self.parts, strict=True):
            total += share * part._pdf(x)
        return total

    def _sample(self, u: Array) -> Array:
        chosen = np.searchsorted(self._borders[1:-1], u[..., self._chooser], side="right")
        x = np.empty((*u.shape[:-1], self.dims))
        for t, part in enumerate(self.parts):
            own = chosen == t
            if own.any():
                x[own] = part.sample(self._own_points(t, u[own]))
        return x

    def _invert(self, x: Array) -> Array:  # noqa: ARG002
        raise DensityError(
            f"{self.spec} has no inverse: a point may come from any of its parts; invert the part "
            "that it came from."
        )

    @property
    def _chooser(self) -> int:
        return self.dims if self.selection == "extra" else self.axis

    @cached_property
    def _borders(self) -> Array:
        """Cumulative shares (T+1,), from 0 to exactly 1."""
        sums = np.concatenate([[0.0], np.cumsum(self.shares)])
        sums[-1] = 1.0
        return np.asarray(np.minimum(sums, 1.0))

    def _place(self, t: int, v: Any) -> Any:
        """Where v in [0,1) of part t lies on the axis that chooses."""
        low, high = self._borders[t : t + 2]
        return low + v * (high - low)

    def _own_points(self, t: int, u: Array) -> Array:
        """Points of part t in its own primary space; u is a copy that may be written."""
        if self.selection == "extra":
            return u[..., :-1]
        low, high = self._borders[t], self._borders[t + 1]
        u[..., self.axis] = np.clip((u[..., self.axis] - low) / (high - low), 0, LARGEST_BELOW_ONE)
        return u


@final
@dataclass(frozen=True, kw_only=True)
class Defensive(Density):
    """Mixture of a density with a share of the uniform one, so that 1/p is at most 1/share.

    Attributes
    ----------
    dims
        Number of dims; by default that of the density, 2 where its spec string has no ``dims``.
    density
        A density or spec string.
    share
        Share of the uniform density, above 0 and below 1.
    selection, axis
        As in `Mixture`; the uniform part is chosen by the upper end of the coordinate.
    """

    name: ClassVar[str] = "defensive"
    dims: int = None  # type: ignore[assignment]  # the density's own
    density: Any
    share: float = 0.1
    selection: str = "coordinate"
    axis: int = 0

    def __post_init__(self) -> None:
        share = as_real("share", self.share, above=0.0, below=1.0)
        own = as_part(self.density, _dims_of([self.density], self.dims))
        mixture = Mixture(
            dims=self.dims,
            parts=[own, Uniform(dims=own.dims)],
            weights=[1.0 - share, share],
            selection=self.selection,
            axis=self.axis,
        )
        settled = {"density": own, "dims": own.dims, "axis": mixture.axis, "_mixture": mixture}
        for name, value in settled.items():
            object.__setattr__(self, name, value)

    @property
    def mixture(self) -> Mixture:
        """The same as a `Mixture` of two parts."""
        return self._mixture  # type: ignore[attr-defined, no-any-return]

    @property
    def primary_dims(self) -> int:
        """As `Mixture.primary_dims`."""
        return self.mixture.primary_dims

    @property
    def has_inverse(self) -> bool:
        """False, as of every mixture."""
        return False

    @property
    def one_to_one(self) -> bool:
        """False, as of every mixture."""
        return False

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """As `Mixture.breaks`."""
        return self.mixture.breaks

    def preimages(self, x: object) -> Array:
        """As `Mixture.preimages`."""
        return self.mixture.preimages(x)

    def _pdf(self, x: Array) -> Array:
        return self.mixture._pdf(x)

    def _sample(self, u: Array) -> Array:
        return self.mixture._sample(u)

    def _invert(self, x: Array) -> Array:
        return self.mixture._invert(x)


def _dims_of(parts: Any, dims: int | None) -> int:
    """Dims for spec strings that do not say: those asked for, or those of a part that is given."""
    if dims is not None:
        return as_integer("dims", dims, least=1)
    given = parts if isinstance(parts, list | tuple) else []
    return next((part.dims for part in given if isinstance(part, Density)), DEFAULT_DIMS)


def _common_dims(parts: tuple[Density, ...], asked: int | None) -> int:
    """Dims of all parts, which must agree; none of them may need an extra coordinate."""
    dims = parts[0].dims if asked is None else int(asked)
    if any(part.dims != dims for part in parts):
        shown = ", ".join(f"{part.spec} has {part.dims}" for part in parts)
        raise ParameterError(f"All parts of a mixture need the same number of dims: {shown:.300}.")
    deeper = next((part for part in parts if part.primary_dims != part.dims), None)
    if deeper is not None:
        raise ParameterError(
            f"{deeper.spec} needs an extra coordinate; parts of a mixture must have "
            "selection='coordinate'."
        )
    return dims


def _as_weights(given: Any, length: int) -> tuple[float, ...]:
    weights = as_real_array("weights", given)
    if weights.shape != (length,):
        raise ParameterError(
            f"weights have shape {weights.shape}; give one number for each of the {length} parts."
        )
    if not np.isfinite(weights).all() or weights.min() <= 0 or not math.isfinite(weights.sum()):
        raise ParameterError(
            f"weights run from {weights.min():g} to {weights.max():g}; they must be finite and "
            "greater than 0: leave out parts of weight 0."
        )
    return tuple(plain(weights))
