"""Densities made from other densities: products over groups of dims, mixtures, defensive mixtures.

Selection
---------
The densities p_t of a mixture p = Σ_t w_t p_t [OwenZhou2000]_ are called its parts.
A point can choose its part in two ways:

* ``"coordinate"``: one coordinate of u chooses the part, and is then stretched and used again.
  Dims and strata are kept, but the warp and g(u) = f/p jump where the chosen part changes.
  The jumps of g make the convergence of jittered and low-discrepancy points slower.
* ``"extra"``: an additional last coordinate chooses the part, which gets all other coordinates.
  The estimator needs a sampler of d+1 dims, and g still jumps along the last dim.
* A third way is a *deterministic split*, which draws n w_t points of each part.
  A deterministic split is not a warp. Its parts are techniques with the balance heuristic.
  See `mcspectra.estimators.split_mixture`.
"""

from __future__ import annotations

import inspect
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np

from mcspectra.core.checks import (
    BELOW_ONE,
    MAX_DIMS,
    Array,
    as_choice,
    as_integer,
    as_real,
    as_real_array,
)
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.core.fields import checked, settle
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.spec import parse
from mcspectra.densities.analytic import Uniform
from mcspectra.densities.base import Density, Wrapper, plain
from mcspectra.densities.registry import DENSITIES, as_density, density

__all__ = ["Defensive", "Mixture", "Product"]

_MAX_PARTS = 1024
# Points where a factor density is 0 get arbitrary coordinates on the axes of all other factors.
# From one point to the next, the arbitrary coordinates cycle through this number of values
_PLACES = 4
_SELECTIONS = ("coordinate", "extra")


def _as_parts(given: Any, dims: int) -> tuple[Density, ...]:
    """Convert a list of densities and spec strings. Specs without dims get `dims` dims."""
    if not isinstance(given, list | tuple) or not 0 < len(given) <= _MAX_PARTS:
        raise ParameterError(
            f"parts is {given!r:.80}; give a list of 1 to {_MAX_PARTS} densities or spec strings."
        )
    return tuple(_as_part(part, dims) for part in given)


def _as_part(part: Any, dims: int) -> Density:
    if isinstance(part, str):
        call = parse(part)
        takes = "dims" in inspect.signature(DENSITIES.load(call.name)).parameters
        return density(part, dims if takes and "dims" not in call.arguments else None)
    found = as_density(part)
    if found is None:
        raise ParameterError("parts hold None; write 'uniform' for a uniform density.")
    return found


@final
@dataclass(frozen=True, kw_only=True)
class Product(Density):
    """Product of densities, p(x) = Π_j p_j(x_j), where each part p_j takes the next dims x_j of x.

    Attributes
    ----------
    parts
        Densities or spec strings. A spec string without ``dims`` stands for one dim.
        For example, ``product(parts=["linear(slope=1)", "tent"])`` is in 2-D.
    """

    parts: Any = checked(lambda _, given: _as_parts(given, 1))

    def _check(self) -> None:
        if self.dims > MAX_DIMS:
            raise ParameterError(
                f"The parts of a product have more than {MAX_DIMS} dims in all; use fewer parts."
            )

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims: the sum of the parts' dims."""
        return sum(part.dims for part in self.parts)

    @property
    def primary_dims(self) -> int:
        return sum(part.primary_dims for part in self.parts)

    @property
    def spec(self) -> str:
        """Spec string, with the dims of each part."""
        return f"{self.name}(parts=[{', '.join(repr(_with_dims(part)) for part in self.parts)}])"

    @property
    def has_inverse(self) -> bool:
        return all(part.has_inverse for part in self.parts)

    @property
    def one_to_one(self) -> bool:
        return all(part.one_to_one for part in self.parts)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        return tuple(axis for part in self.parts for axis in part.breaks)

    def zero_points(self) -> Array:
        return self.lifted([part.zero_points() for part in self.parts])

    def lifted(self, points: Sequence[Array]) -> Array:
        """Convert points of the factors, k_j points in d_j dims for factor j, to points in d dims.

        A point of factor j gets arbitrary coordinates on the axes of all other factors.
        From one point to the next, the arbitrary coordinates cycle through `_PLACES` values.
        """
        found = []
        for own, given in zip(self._domain, points, strict=True):
            turn = np.arange(len(given))[:, None] % _PLACES
            lifted = (turn + 0.5 + 0.25 * np.sin(np.arange(self.dims))) / (_PLACES + 0.25)
            lifted[:, own] = given
            found.append(lifted)
        return np.concatenate(found)

    def reciprocal_integral(self) -> float:
        """Return ∫ 1/p, which is the product of the parts' integrals."""
        return float(math.prod(part.reciprocal_integral() for part in self.parts))

    @cached_property
    def _domain(self) -> tuple[slice, ...]:
        return _slices([part.dims for part in self.parts])

    @cached_property
    def _primary(self) -> tuple[slice, ...]:
        return _slices([part.primary_dims for part in self.parts])

    def _pdf(self, x: Array) -> Array:
        factors = (p._pdf(x[..., own]) for p, own in zip(self.parts, self._domain, strict=True))
        return math.prod(factors, start=np.ones(x.shape[:-1]))

    def _sample(self, u: Array) -> Array:
        pairs = zip(self.parts, self._primary, strict=True)
        return np.concatenate([part.sample(u[..., own]) for part, own in pairs], axis=-1)

    def _invert(self, x: Array) -> Array:
        pairs = zip(self.parts, self._domain, strict=True)
        return np.concatenate([part.invert(x[..., own]) for part, own in pairs], axis=-1)


def _slices(sizes: list[int]) -> tuple[slice, ...]:
    ends = np.cumsum([0, *sizes]).tolist()
    return tuple(slice(a, b) for a, b in itertools.pairwise(ends))


def _with_dims(part: Density) -> str:
    """Return the spec of a part, with its dims if these are not 1 and the class allows any."""
    spec, takes = part.spec, "dims" in inspect.signature(type(part)).parameters
    if part.dims == 1 or not takes or part.name == "function":
        return spec
    name, bracket, rest = spec.partition("(")
    return f"{name}(dims={part.dims}{', ' + rest if bracket else ')'}"


@final
@dataclass(frozen=True, kw_only=True)
class Mixture(Density):
    """Mixture of densities, p = Σ_t w_t p_t. One coordinate of u chooses the part.

    Attributes
    ----------
    dims
        Number of dims. The default is that of the parts, or 2 for spec strings without ``dims``.
    parts
        Densities p_t or spec strings.
    weights
        Relative shares w_t, above 0. The scale is arbitrary. All are equal by default.
    selection
        How a point chooses its part, ``"coordinate"`` or ``"extra"``.
    axis
        The coordinate of u that chooses the part p_t, if `selection` is ``"coordinate"``.
        For ``"extra"``, the last coordinate of u chooses the part.

    Notes
    -----
    The warp is not one-to-one, because x may come from any of the parts. It has no inverse.
    The pdf is the same for both ways to choose a part.
    """

    dims: int = None  # type: ignore[assignment]  # the parts' own
    parts: Any
    weights: Any = None
    selection: str = "coordinate"
    axis: int = 0

    def _check(self) -> None:
        if self.selection == "split":
            raise ParameterError(
                "A mixture by deterministic split is several techniques, not one density; use "
                "mcspectra.estimators.split_mixture(integrand, mixture)."
            )
        as_choice("selection", self.selection, _SELECTIONS)
        # Determine the dims. All parts must have equal dims; no part may need an extra coordinate
        parts = _as_parts(self.parts, _dims_of(self.parts, self.dims))
        given: int | None = self.dims
        dims = parts[0].dims if given is None else int(given)
        if any(part.dims != dims for part in parts):
            shown = ", ".join(f"{part.spec} has {part.dims}" for part in parts)
            raise ParameterError(
                f"All parts of a mixture need the same number of dims: {shown:.300}."
            )
        deeper = next((part for part in parts if part.primary_dims != part.dims), None)
        if deeper is not None:
            raise ParameterError(
                f"{deeper.spec} needs an extra coordinate; parts of a mixture must have "
                "selection='coordinate'."
            )
        axis = as_integer("axis", self.axis, least=0, most=dims - 1)
        weights = None if self.weights is None else _as_weights(self.weights, len(parts))
        settle(self, parts=parts, weights=weights, dims=dims, axis=axis)

    @property
    def shares(self) -> Array:
        """The shares w_t, normalized to sum 1."""
        weights = np.ones(len(self.parts)) if self.weights is None else np.array(self.weights)
        return np.asarray(weights / weights.max() / (weights / weights.max()).sum())

    @property
    def primary_dims(self) -> int:
        """Number of coordinates of u: d, or d + 1 with an extra coordinate."""
        return self.dims + (self.selection == "extra")

    has_inverse = one_to_one = False

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Breaks of the parts, and the values of u at which the choice of the part changes."""
        found: list[set[float]] = [set() for _ in range(self.primary_dims)]
        found[self._chooser].update(self._borders[1:-1].tolist())
        for t, part in enumerate(self.parts):
            for axis, own in enumerate(part.breaks):
                stretched = axis == self._chooser
                found[axis].update(float(self._place(t, b)) if stretched else b for b in own)
        return tuple(tuple(sorted(b for b in axis if 0 < b < 1)) for axis in found)

    def preimages(self, x: object) -> Array:
        """Return all points u that map to x; empty with ``"extra"``, where infinitely many do."""
        if self.selection == "extra":  # the last coordinate of u may vary without a change of x
            return np.empty((0, self.primary_dims))
        found = [part.preimages(x) for part in self.parts]
        for t, u in enumerate(found):
            u[:, self.axis] = self._place(t, u[:, self.axis])
        return np.concatenate(found)

    def zero_points(self) -> Array:
        """Return those zeros of the parts at which all parts are 0, so the mixture is 0 as well."""
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
            if not own.any():
                continue
            v = u[own]  # indexing makes a copy, so u does not change below
            if self.selection == "extra":
                v = v[..., :-1]
            else:
                low, high = self._borders[t], self._borders[t + 1]
                stretched = (v[..., self.axis] - low) / (high - low)
                v[..., self.axis] = np.clip(stretched, 0, BELOW_ONE)
            x[own] = part.sample(v)
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
        """Cumulative sums of the shares (T+1,), from 0 to exactly 1."""
        sums = np.concatenate([[0.0], np.cumsum(self.shares)])
        sums[-1] = 1.0
        return np.asarray(np.minimum(sums, 1.0))

    def _place(self, t: int, v: Any) -> Any:
        """Return the coordinate of u that selects part t and is then stretched to v in [0,1)."""
        low, high = self._borders[t : t + 2]
        return low + v * (high - low)


@final
@dataclass(frozen=True, kw_only=True)
class Defensive(Wrapper):
    """Mixture of a density with a share of the uniform density, so that 1/p is at most 1/share.

    A mixture is *defensive* if it has a part that is large enough everywhere [Hesterberg1995]_.

    Attributes
    ----------
    dims
        Number of dims. The default is the density's own, or 2 for a spec string without ``dims``.
    density
        A density or spec string.
    share
        Share of the uniform density, above 0 and below 1.
    selection, axis
        Same as in `Mixture`.
        The uniform density is chosen if the coordinate that chooses a part is at least 1 − share.
    """

    dims: int = None  # type: ignore[assignment]  # the density's own
    density: Any
    share: float = 0.1
    selection: str = "coordinate"
    axis: int = 0

    def _check(self) -> None:
        as_real("share", self.share, above=0.0, below=1.0)
        own = _as_part(self.density, _dims_of([self.density], self.dims))
        settle(self, density=own)
        settle(self, dims=own.dims, axis=self.mixture.axis)

    @cached_property
    def mixture(self) -> Mixture:
        """The same density as a `Mixture` of two parts: the given and the uniform density."""
        return Mixture(
            dims=self.dims,
            parts=[self.density, Uniform(dims=self.density.dims)],
            weights=[1.0 - self.share, self.share],
            selection=self.selection,
            axis=self.axis,
        )

    @property
    def _inside(self) -> Mixture:
        return self.mixture


def _dims_of(parts: Any, dims: int | None) -> int:
    """Return the dims for spec strings without dims: `dims`, or the dims of a given part."""
    if dims is not None:
        return as_integer("dims", dims, least=1)
    given = parts if isinstance(parts, list | tuple) else []
    return next((part.dims for part in given if isinstance(part, Density)), DEFAULT_DIMS)


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
