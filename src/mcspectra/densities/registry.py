"""Names of densities, and conversion of descriptions to a `Density`."""

from __future__ import annotations

from mcspectra.core.checks import MAX_DIMS, as_integer
from mcspectra.core.display import counted, needed, shown
from mcspectra.core.errors import ParameterError
from mcspectra.core.registry import Registry, classes_of
from mcspectra.core.spec import parse
from mcspectra.densities.base import Density

__all__ = ["DENSITIES", "as_density", "as_warp", "density"]

DENSITIES = Registry(
    "density",
    "mcspectra.densities",
    classes_of(
        {
            "densities.analytic": "CosineWeighted Exponential Linear Power Tent TruncatedNormal "
            "Uniform",
            "densities.bilinear": "Bilinear",
            "densities.composite": "Defensive Mixture Product",
            "densities.directions": "disk=DiskDensity hemisphere=HemisphereDensity "
            "sphere=SphereDensity",
            "densities.environment": "environment=EnvironmentDensity image=ImageDensity",
            "densities.learned": "Learned",
            "densities.lights": "SphericalRectangle SphericalTriangle",
            "densities.pieces": "AlignedStrata grid=GridDensity PiecewiseLinear",
            "densities.tabulated": "PiecewiseConstant",
        }
    ),
    base=Density,
)
"""Densities that spec strings can name."""


def density(spec: str, dims: int | None = None) -> Density:
    """Make a density from a spec string such as ``"linear(slope=1)"``.

    Parameters
    ----------
    spec
        ``name`` or ``name(key=value, ...)``; see ``mcspectra list densities``.
    dims
        Number of dims. The default is the number in the spec, else the density's own, else 2.

    Raises
    ------
    SpecError
        If the spec cannot be read. The class is `UnknownName` if the name is not registered.
    ParameterError
        If a parameter is unknown, missing or out of range, or dims disagree.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> float(mcs.density("linear(slope=2)", dims=1).sample([0.25])[0])
    0.5
    """
    asked = None if dims is None else as_integer("dims", dims, least=1, most=MAX_DIMS)
    made: Density = DENSITIES.build(parse(spec), asked)
    return made


def as_density(given: object, dims: int | None = None) -> Density | None:
    """Convert a spec string to a density. Return a density or None unchanged. `dims` must agree.

    Raises
    ------
    ParameterError
        If `given` has another type or other dims.
    """
    if given is None:
        return None
    if isinstance(given, str):
        return density(given, dims)
    if not isinstance(given, Density):
        raise ParameterError(
            f"{shown(given)} is not a density; give one, a spec string, or "
            "Density.from_functions(...)."
        )
    if dims is not None and given.dims != dims:
        raise ParameterError(
            f"{given.spec} has {counted(given.dims, 'dim')}, but {needed(dims, 'dim')}."
        )
    return given


def as_warp(given: object, primary_dims: int) -> Density | None:
    """Return a density whose warp takes points of `primary_dims` dims. None stays None.

    The density has `primary_dims` dims, or one less if an extra coordinate chooses a part of it.

    Raises
    ------
    ParameterError
        If `given` has another type, or its warp takes points of other dims.
    """
    found = _fitting(given, primary_dims) if isinstance(given, str) else as_density(given)
    if found is not None and found.primary_dims != primary_dims:
        raise ParameterError(
            f"The warp of {found.spec} takes points of {counted(found.primary_dims, 'dim')}, but "
            f"the sampler's have {primary_dims}."
        )
    return found


def _fitting(spec: str, primary_dims: int) -> Density:
    """Make a density whose warp takes points of `primary_dims` dims."""
    try:
        made = density(spec, primary_dims)
    except ParameterError:
        if primary_dims == 1 or "selection" not in spec:
            raise
        made = density(spec, primary_dims - 1)
    fits = made.primary_dims == primary_dims or primary_dims == 1
    return made if fits else density(spec, primary_dims - 1)
