"""Registry of integrands by name."""

from __future__ import annotations

from mcspectra.core.checks import MAX_DIMS, as_integer
from mcspectra.core.display import counted, needed, shown
from mcspectra.core.errors import McspectraError, Parameter, ParameterError, reason_of
from mcspectra.core.registry import Registry, classes_of
from mcspectra.core.spec import Call, parse
from mcspectra.core.trust import FUNCTION, loaded_function, process_trust
from mcspectra.integrands.base import Integrand

__all__ = ["INTEGRANDS", "as_integrand", "integrand"]

INTEGRANDS = Registry(
    "integrand",
    "mcspectra.integrands",
    classes_of(
        {
            "integrands.analytic": "Constant Cosine Gaussian Linear Polynomial",
            "integrands.christensen": "ChristensenBilinear ChristensenDisk ChristensenGaussian "
            "ChristensenStep ChristensenTriangle",
            "integrands.formula": "Formula",
            "integrands.genz": "GenzContinuous GenzCornerPeak GenzDiscontinuous GenzGaussian "
            "GenzOscillatory GenzProductPeak",
            "integrands.image": "Environment Image",
            "integrands.indicators": "Disk HalfSpace SmoothedStep Step",
            "integrands.lights": "RectangleLight",
            "rendering.paths": "PathPixel",
            "rendering.pixel": "Pixel",
        }
    ),
    base=Integrand,
)
"""Integrands that spec strings can name."""


def integrand(spec: str, dims: int | None = None) -> Integrand:
    """Make an integrand of a spec string such as ``"gaussian(width=0.25)"``.

    Parameters
    ----------
    spec
        ``name`` or ``name(key=value, ...)``; see ``mcspectra list integrands``.
        A function of points (..., d) in Python is named ``module:function``, or as in studies
        ``python(function='module:function')``. Modules are found on Python's path (PYTHONPATH).
    dims
        Number of dims. The default is the number in the spec, else the integrand's own, else 2.
        A function in Python has no default.

    Raises
    ------
    SpecError
        If the spec cannot be parsed. `UnknownName` is raised if the name is not registered.
    ParameterError
        If a parameter is unknown, missing or out of range, or the numbers of dims disagree.
        If a function cannot be imported, or has no dims.
    ConfigError
        If the spec names a function that is not allowed (`mcspectra.samplers.allow_code`).
    """
    asked = None if dims is None else as_integer("dims", dims, least=1, most=MAX_DIMS)
    given: object = spec
    named = isinstance(given, str) and FUNCTION.fullmatch(given)
    call = Call("python", {"function": spec}) if named else parse(spec)
    if call.name == "python" and set(call.arguments) == {"function"}:
        return _of_python(call, asked)
    found: Integrand = INTEGRANDS.build(call, asked)
    return found


def _of_python(call: Call, dims: int | None) -> Integrand:
    """Make an integrand of an allowed function in Python, by its name."""
    process_trust().check_code(call)
    name = call.arguments["function"]
    function = loaded_function(name)
    if dims is None:
        raise ParameterError(
            Parameter("dims"), f" is missing; give the number of inputs of {name}."
        )
    try:
        return Integrand.from_function(function, dims=dims)
    except McspectraError:
        raise
    except Exception as error:
        reason = f"{type(error).__name__}: {reason_of(error, 200)}"
        raise ParameterError(f"{name} failed at its first points: {reason}.") from error


def as_integrand(given: object, dims: int | None = None) -> Integrand:
    """Return an integrand, or make one from a spec string. If `dims` is given, it must agree.

    Raises
    ------
    ParameterError
        If `given` is not an integrand or spec, or has another number of dims.
    """
    if isinstance(given, str):
        return integrand(given, dims)
    if not isinstance(given, Integrand):
        offer = (
            "make one with Integrand.from_function" if callable(given) else "give one, or a spec"
        )
        raise ParameterError(f"{shown(given)} is not an integrand; {offer}.")
    if dims is not None and given.dims != dims:
        raise ParameterError(
            f"{given.spec} has {counted(given.dims, 'dim')}, but {needed(dims, 'dim')}."
        )
    return given
