"""The map of VEGAS, which adapts a product of histograms to an integrand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real, as_real_array
from mcspectra.core.errors import ParameterError
from mcspectra.core.registry import optional_package
from mcspectra.core.streams import Stream
from mcspectra.densities.base import LARGEST_BELOW_ONE
from mcspectra.densities.pieces import MAX_BINS, MAX_GRID_DIMS, GridDensity

__all__ = ["check_training", "vegas_density"]

_MAX_ITERATIONS = 1000
_MAX_EVALUATIONS = 2**22


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
    The training data are f²/p² at the points of the current map ([Lepage1978]_, §III), summed over
    channels, for vegas's ``AdaptiveMap``. Where f is 0 at all points the grid stays as it is.
    """
    check_training(increments, iterations, evaluations, alpha, seed)
    if not callable(integrand):
        raise ParameterError(
            f"{integrand!r:.80} is not an integrand; give mcs.integrand(spec) or a function, or "
            "name it in the density 'vegas(integrand=...)'."
        )
    given = getattr(integrand, "dims", None) if dims is None else dims
    axes, count = as_integer("dims", given, least=1, most=MAX_GRID_DIMS), int(evaluations)
    vegas = optional_package("vegas", "vegas", "Densities by VEGAS need")
    grid = vegas.AdaptiveMap([[0.0, 1.0]] * axes, ninc=int(increments))
    for iteration in range(int(iterations)):
        # Evaluate at random points of the current map
        y = Stream(int(seed)).generator(iteration).random((count, axes))
        x, jacobian = np.empty_like(y), np.empty(count)
        grid.map(y, x, jacobian)
        clipped = np.clip(x, 0.0, LARGEST_BELOW_ONE)
        values = as_real_array("Values of the integrand", integrand(clipped))
        if values.shape[:1] != (count,) or values.ndim > 2:
            raise ParameterError(
                f"The integrand gave shape {values.shape} for points of shape {x.shape}; it must "
                f"give ({count},) or ({count}, channels)."
            )
        if not np.isfinite(values).all():
            raise ParameterError(
                "The integrand is NaN or infinite at a point; VEGAS cannot adapt to it."
            )
        # Move the nodes; squares of 1e200 would overflow
        size = np.abs(values.reshape(count, -1))
        if size.any():
            squares = ((size / size.max()) ** 2).sum(axis=1)
            grid.add_training_data(y, squares * (jacobian / jacobian.max()) ** 2)
            grid.adapt(alpha=float(alpha))
    return GridDensity(nodes=[np.array(line) for line in np.asarray(grid.grid)])


def check_training(
    increments: object, iterations: object, evaluations: object, alpha: object, seed: object
) -> None:
    """Raise ParameterError unless the parameters of `vegas_density` are within their ranges."""
    as_integer("increments", increments, least=1, most=MAX_BINS)
    as_integer("iterations", iterations, least=0, most=_MAX_ITERATIONS)
    as_integer("evaluations", evaluations, least=1, most=_MAX_EVALUATIONS)
    as_real("alpha", alpha, least=0.0, most=10.0)
    as_integer("seed", seed, least=0, most=2**63 - 1)
