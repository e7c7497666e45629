"""Smoothed edges: ramps replace jumps, for faster convergence at the price of a bias.

There are two methods. The first needs the signed distance σ(x) to an edge; f = 1 where σ < 0.
The edge becomes the linear ramp ½ − σ/δ of width δ, clipped to [0, 1].
The ramp is the average over edges that are moved by τ, with τ uniform in [−δ/2, δ/2].
The integral of the ramp is therefore the average over τ of the integrals with moved edges.
The Fourier coefficients of the ramp are averages over τ in the same way.

The second method averages an integrand over a box of side δ about x.
The box is reflected at the faces of the domain, which keeps the integral.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_real
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import real, whole
from mcspectra.integrands._quadrature import gauss_rule
from mcspectra.integrands.base import Breaks, Derived, Integrand, NamedFunction
from mcspectra.integrands.indicators import Disk, HalfSpace, SmoothedStep, Step
from mcspectra.integrands.registry import as_integrand

__all__ = ["BoxSmoothed", "EdgeSmoothed", "smoothed"]

_METHODS = ("auto", "distance", "box")
# The mean over edges that are moved by τ is an integral over τ, computed in panels of Gauss nodes.
# A panel has 32 nodes and covers 8 cycles of a wave, so its error is at the level of rounding
_CYCLES, _ORDER = 8, 32
_MOST_NODES = 4096


def smoothed(
    integrand: Integrand | str,
    width: float,
    *,
    method: str = "auto",
    nodes: int = 16,
    dims: int | None = None,
) -> Integrand:
    """Return an integrand with smoothed edges.

    Parameters
    ----------
    integrand
        The integrand f, or its spec string.
    width
        δ > 0: the width of the ramp across the edge, or the side of the box.
    method
        ``"distance"`` is a linear ramp across the edge.
        Ramps apply to step, disk, half-space and the discontinuous functions of [Christensen2018]_.
        ``"box"`` is the mean over a box. It applies to any f if δ ≤ 1.
        ``"auto"`` uses the distance if it is known, otherwise the box.
    nodes
        Number of Gauss nodes along each axis for ``"box"``, at most 4096 in total.
        The nodes are used if the means of f over boxes have no closed form.
        A mean over these nodes has `nodes` smaller jumps for each jump of f.
    dims
        Number of dims for a spec string without ``dims``.

    Returns
    -------
    Integrand
        The smoothed f: `SmoothedStep` for a step, otherwise `EdgeSmoothed` or `BoxSmoothed`.

    Raises
    ------
    ParameterError
        If the width is not positive, is too large, or if no distance is known.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> mcs.smoothed("step(at=0.3)", 0.1, dims=1).spec
    'smoothed-step(at=0.3)'
    """
    f = as_integrand(integrand, dims)
    ramp = as_real("width", width, above=0.0)
    if as_choice("method", method, _METHODS) == "box":
        return BoxSmoothed(integrand=f, width=ramp, nodes=nodes)
    edge = f.integrand if isinstance(f, NamedFunction) else f
    if isinstance(edge, Step):
        return SmoothedStep(at=edge.at, axis=edge.axis, dims=edge.dims, width=ramp)
    if isinstance(edge, Disk | HalfSpace):
        return EdgeSmoothed(edge=edge, width=ramp)
    if method == "distance":
        raise ParameterError(
            f"No signed distance to the edges of {f.spec} is known; use method='box'."
        )
    return BoxSmoothed(integrand=f, width=ramp, nodes=nodes)


@final
@dataclass(frozen=True, kw_only=True)
class EdgeSmoothed(Integrand):
    """The indicator of a ball or a half-space, with a linear ramp across its border.

    Parameters
    ----------
    edge
        The indicator whose border is smoothed.
    width
        Width of the ramp normal to the border, > 0. For a ball, it must be less than the diameter.
    """

    edge: Disk | HalfSpace
    width: float = real(above=0.0)

    def _check(self) -> None:
        if isinstance(self.edge, Disk) and self.width >= 2.0 * self.edge.radius:
            raise ParameterError(
                f"width is {self.width:g}; the ramp of a disk of radius {self.edge.radius:g} must "
                f"be narrower than {2.0 * self.edge.radius:g}."
            )

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims of the edge."""
        return self.edge.dims

    @property
    def spec(self) -> str:
        """Text for messages."""
        return f"{self.edge.spec} with edges smoothed over {self.width:g}"

    @property
    def breaks(self) -> Breaks:
        """Positions on each axis where the ramp that replaces an edge begins or ends."""
        ends = [self._moved(t).breaks for t in (-0.5 * self.width, 0.5 * self.width)]
        return tuple(tuple(sorted({*a, *b})) for a, b in zip(*ends, strict=True))

    @property
    def fourier_source(self) -> str:
        """How Fourier coefficients are computed: the method for one edge, averaged over edges."""
        if self.edge._fourier(np.zeros((1, self.dims))) is None:
            return super().fourier_source
        return f"{self.edge.fourier_source}, averaged over edges by Gauss-Legendre quadrature"

    def _distance(self, x: Array) -> Array:
        """Signed distance to the border, which is negative inside."""
        if isinstance(self.edge, Disk):
            return np.asarray(np.linalg.norm(x - self.edge.center, axis=-1) - self.edge.radius)
        normal = self.edge._normal
        return np.asarray((x @ normal - self.edge.offset) / np.linalg.norm(normal))

    def _moved(self, by: float) -> Disk | HalfSpace:
        """Return the indicator with its border moved outward."""
        if isinstance(self.edge, Disk):
            return replace(self.edge, radius=self.edge.radius + by)
        length = float(np.linalg.norm(self.edge._normal))
        return replace(self.edge, offset=self.edge.offset + by * length)

    def _evaluate(self, x: Array) -> Array:
        return np.clip(0.5 - self._distance(x) / self.width, 0.0, 1.0)

    def _mean(self, known: Callable[[Disk | HalfSpace], Any], panels: int = 1) -> Any:
        """Average a quantity over positions of the border; None if the quantity is not known."""
        node, weight = gauss_rule(_ORDER)
        places = ((np.arange(panels)[:, None] + node) / panels).ravel()
        total: Any = 0.0
        for place, w in zip(places, np.tile(weight / panels, panels), strict=True):
            value = known(self._moved(float(place - 0.5) * self.width))
            if value is None:
                return None
            total = total + w * value
        return total

    def _integral(self) -> float | None:
        value = self._mean(lambda edge: edge._integral())
        return None if value is None else float(value)

    def _fourier(self, m: Array) -> Any:
        cycles = float(np.sqrt((m * m).sum(axis=-1).max())) * self.width
        return self._mean(lambda edge: edge._fourier(m), math.ceil(1 + cycles / _CYCLES))


@final
@dataclass(frozen=True, kw_only=True)
class BoxSmoothed(Derived):
    """The mean of an integrand over a box about x. The box is reflected at the faces of the domain.

    Parameters
    ----------
    integrand
        f.
    width
        Side of the box, in (0, 1].
    nodes
        Number of Gauss nodes along each axis, if means over boxes have no closed form.

    Notes
    -----
    Reflection at the faces, with symmetric nodes and weights, does not change ∫ f.
    """

    text = "{0.integrand.spec} averaged over boxes of side {0.width:g}"
    integrand: Integrand
    width: float = real(above=0.0, most=1.0)
    nodes: int = whole(16, least=1, most=64)

    def _check(self) -> None:
        if not self._known and self.nodes**self.dims > _MOST_NODES:
            raise ParameterError(
                f"One smoothed value of {self.integrand.spec} takes {self.nodes}^{self.dims} of "
                f"its values; lower nodes= to need at most {_MOST_NODES}."
            )

    @property
    def integral(self) -> Any:
        """The integral of f."""
        return self.integrand.integral

    @property
    def evaluations_per_point(self) -> int:
        """Number of evaluations of f: ``nodes^d`` if means over boxes have no closed form."""
        inside = self.integrand.evaluations_per_point
        return inside if self._known else inside * self.nodes**self.dims

    @property
    def _known(self) -> bool:
        """Whether f has closed-form means over boxes."""
        few = self.dims <= 6  # reflections may divide a box into 3^d parts
        unit = np.zeros((1, self.dims)), np.ones((1, self.dims))
        return few and self.integrand.box_moments(*unit) is not None

    @property
    def breaks(self) -> Breaks:
        """Points at which the box begins or ceases to cover a break of f, or crosses a face."""
        half = 0.5 * self.width
        moved = [
            {half, 1 - half, *(b - half for b in axis), *(b + half for b in axis)}
            for axis in self.integrand.breaks
        ]
        return tuple(tuple(sorted(b for b in axis if 0.0 < b < 1.0)) for axis in moved)

    def _evaluate(self, x: Array) -> Array:
        total: Any = 0.0
        if not self._known:
            node, weight = gauss_rule(self.nodes)
            for place in itertools.product(range(self.nodes), repeat=self.dims):
                moved = np.abs(x + self.width * (node[list(place)] - 0.5))
                inside = np.where(moved > 1.0, 2.0 - moved, moved)
                total = total + weight[list(place)].prod() * self.integrand(inside)
            return np.asarray(total)

        # Split the box along each axis into parts below 0 (−1), inside (0) and above 1 (1).
        # Reflect the parts outside [0, 1] at the faces
        low, high = x - 0.5 * self.width, x + 0.5 * self.width
        for parts in itertools.product((-1, 0, 1), repeat=self.dims):
            part = np.array(parts)
            start = np.where(part == 0, np.maximum(low, 0.0), np.where(part < 0, 0.0, 2.0 - high))
            stop = np.where(part == 0, np.minimum(high, 1.0), np.where(part < 0, -low, 1.0))
            empty = ~(stop > start)
            share = (np.where(empty, 0.0, stop - start) / self.width).prod(axis=-1)
            if not share.any():
                continue
            found = self.integrand.box_moments(
                np.where(empty, 0.0, start), np.where(empty, 1.0, stop)
            )
            assert found is not None  # box means are known, because `_known` is true
            total = total + (share[..., None] if self.channels else share) * found[0]
        return np.asarray(total)
