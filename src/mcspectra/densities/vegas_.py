"""Products of piecewise constant densities with equal shares, and the map of VEGAS that adapts them."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real, as_real_array
from mcspectra.core.errors import MissingDependency, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.densities.base import Density

__all__ = ["GridDensity", "check_training", "vegas_density"]

_MAX_DIMS = 64
_MAX_INCREMENTS = 4096
_MAX_ITERATIONS = 1000
_MAX_EVALUATIONS = 2**22
_LEAST_WIDTH = 1e-15
_BELOW_ONE = np.nextafter(1.0, 0.0)


@final
@dataclass(frozen=True, kw_only=True)
class GridDensity(Density):
    """Product over the dims of histograms whose bins hold equal shares: the densities of VEGAS.

    Attributes
    ----------
    nodes
        For each dim the increasing borders of its N bins, from 0 to 1, N + 1 numbers; N may differ.
        In 1-D the list of borders itself.
        u in [i/N, (i+1)/N) goes linearly to bin i, where p_i = 1/(N width_i).

    References
    ----------
    G. P. Lepage (1978), "A new algorithm for adaptive multidimensional integration", Journal of
    Computational Physics 27.
    """

    name: ClassVar[str] = "grid"
    nodes: Any

    def __post_init__(self) -> None:
        if not isinstance(self.nodes, Sequence | np.ndarray) or not len(self.nodes):
            raise ParameterError(
                f"nodes is {self.nodes!r:.80}; give one list of borders for each dim."
            )
        given = [self.nodes] if np.ndim(self.nodes[0]) == 0 else self.nodes
        if len(given) > _MAX_DIMS:
            raise ParameterError(f"nodes has {len(given)} dims; give at most {_MAX_DIMS}.")
        lines = tuple(_as_nodes(f"nodes[{i}]", line) for i, line in enumerate(given))
        object.__setattr__(self, "nodes", lines)

    @property
    def dims(self) -> int:  # type: ignore[override]
        """As many as lists of nodes."""
        return len(self.nodes)

    @cached_property
    def _lines(self) -> list[Array]:
        return [np.array(line) for line in self.nodes]

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Shares i/N between bins of different width."""
        return tuple(
            tuple((1 + np.flatnonzero(np.diff(np.diff(line)))) / (len(line) - 1))
            for line in self._lines
        )

    def reciprocal_integral(self) -> float:
        """Π N Σ width²."""
        sums = [(len(line) - 1) * float((np.diff(line) ** 2).sum()) for line in self._lines]
        return float(np.prod(sums))

    def _pdf(self, x: Array) -> Array:
        p = np.ones(x.shape[:-1])
        for axis, line in enumerate(self._lines):
            p /= (line.size - 1) * np.diff(line)[_bin(line, x[..., axis])]
        return p

    def _sample(self, u: Array) -> Array:
        x = np.empty(u.shape)
        for axis, line in enumerate(self._lines):
            scaled = np.minimum(u[..., axis], _BELOW_ONE) * (line.size - 1)
            i = np.minimum(scaled.astype(np.int64), line.size - 2)
            value = line[i] + (scaled - i) * np.diff(line)[i]
            x[..., axis] = np.minimum(value, np.nextafter(line[i + 1], 0.0))
        return x

    def _invert(self, x: Array) -> Array:
        u = np.empty(x.shape)
        for axis, line in enumerate(self._lines):
            i = _bin(line, x[..., axis])
            u[..., axis] = (i + (x[..., axis] - line[i]) / np.diff(line)[i]) / (line.size - 1)
        return u


def vegas_density(
    integrand: Callable[[Array], Array],
    *,
    dims: int | None = None,
    increments: int = 64,
    iterations: int = 10,
    evaluations: int = 4096,
    alpha: float = 0.5,
    seed: int = 0,
) -> GridDensity:
    """Adapt a density to an integrand by VEGAS, the same for the same arguments.

    Parameters
    ----------
    integrand
        An integrand, or any function of points (k, d) to (k,) or (k, channels).
    dims
        Number of dims; may be left out for integrands.
    increments
        Bins along each dim, 1 to 4096.
    iterations
        Rounds of training, 0 to 1000. None gives the uniform density.
    evaluations
        Random points in a round, 1 to 2^22.
    alpha
        Speed of adaptation, 0 to 10: widths follow the power alpha of the training data.
    seed
        Of the random points.

    Returns
    -------
    GridDensity
        A product density, so good for integrands that are nearly products along the axes.

    Raises
    ------
    MissingDependency
        The package vegas is not installed.
    ParameterError
        A parameter is out of range, or the integrand gave NaN, infinity or another shape.

    Notes
    -----
    The training data are f²/p² at the points of the current map (Lepage 1978, §III), summed over
    channels, for vegas's ``AdaptiveMap``. Where f is 0 at all points the grid stays as it is.
    """
    check_training(increments, iterations, evaluations, alpha, seed)
    if not callable(integrand):
        raise ParameterError(
            f"{integrand!r:.80} is not an integrand; give mcs.integrand(spec) or a function, or "
            "name it in the density 'vegas(integrand=...)'."
        )
    given = getattr(integrand, "dims", None) if dims is None else dims
    axes = as_integer("dims", given, least=1, most=_MAX_DIMS)
    grid = _vegas().AdaptiveMap([[0.0, 1.0]] * axes, ninc=int(increments))
    for iteration in range(int(iterations)):
        _train(grid, integrand, Stream(int(seed)).generator(iteration), int(evaluations), alpha)
    return GridDensity(nodes=[np.array(line) for line in np.asarray(grid.grid)])


def check_training(
    increments: object, iterations: object, evaluations: object, alpha: object, seed: object
) -> None:
    """Raise ParameterError unless the parameters of `vegas_density` are within their ranges."""
    as_integer("increments", increments, least=1, most=_MAX_INCREMENTS)
    as_integer("iterations", iterations, least=0, most=_MAX_ITERATIONS)
    as_integer("evaluations", evaluations, least=1, most=_MAX_EVALUATIONS)
    as_real("alpha", alpha, least=0.0, most=10.0)
    as_integer("seed", seed, least=0, most=2**63 - 1)


def _train(
    grid: Any,
    integrand: Callable[[Array], Array],
    generator: np.random.Generator,
    evaluations: int,
    alpha: float,
) -> None:
    """One round: values at random points of the current map, then new nodes."""
    y = generator.random((evaluations, grid.dim))
    x, jacobian = np.empty_like(y), np.empty(evaluations)
    grid.map(y, x, jacobian)
    values = as_real_array("Values of the integrand", integrand(np.clip(x, 0.0, _BELOW_ONE)))
    if values.shape[:1] != (evaluations,) or values.ndim > 2:
        raise ParameterError(
            f"The integrand gave shape {values.shape} for points of shape {x.shape}; it must give "
            f"({evaluations},) or ({evaluations}, channels)."
        )
    if not np.isfinite(values).all():
        raise ParameterError(
            "The integrand is NaN or infinite at a point; VEGAS cannot adapt to it."
        )
    size = np.abs(values.reshape(evaluations, -1))
    if not size.any():
        return
    scaled = size / size.max()  # squares of 1e200 would overflow
    grid.add_training_data(y, (scaled**2).sum(axis=1) * (jacobian / jacobian.max()) ** 2)
    grid.adapt(alpha=float(alpha))


def _bin(line: Array, x: Array) -> Array:
    """i with line[i] <= x < line[i+1]; 1 belongs to the last bin."""
    return np.asarray(np.clip(np.searchsorted(line, x, side="right") - 1, 0, line.size - 2))


def _as_nodes(name: str, line: object) -> tuple[float, ...]:
    """Check borders of one dim."""
    nodes = as_real_array(name, line)
    if nodes.ndim != 1 or not 2 <= nodes.size <= _MAX_INCREMENTS + 1:
        raise ParameterError(
            f"{name} has shape {nodes.shape}; give 2 to {_MAX_INCREMENTS + 1} borders from 0 to 1."
        )
    widths = np.diff(nodes)
    if nodes[0] != 0.0 or nodes[-1] != 1.0 or not (widths >= _LEAST_WIDTH).all():
        raise ParameterError(
            f"{name} runs from {nodes[0]:g} to {nodes[-1]:g} with a smallest step of "
            f"{widths.min():g}; borders must increase from 0 to 1 in steps of {_LEAST_WIDTH:g} or "
            "more."
        )
    return tuple(nodes.tolist())


def _vegas() -> Any:
    if importlib.util.find_spec("vegas") is None:
        raise MissingDependency(
            "Densities by VEGAS need the package vegas; install it with: "
            "pip install 'mcspectra[vegas]'"
        )
    return importlib.import_module("vegas")
