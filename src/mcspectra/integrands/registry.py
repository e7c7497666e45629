"""Integrands by name."""

from __future__ import annotations

from mcspectra.core.checks import MAX_DIMS, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.registry import Registry
from mcspectra.core.spec import parse
from mcspectra.integrands.base import Integrand

__all__ = ["INTEGRANDS", "as_integrand", "integrand"]

INTEGRANDS = Registry(
    "integrand",
    "mcspectra.integrands",
    {
        "asian-option": "mcspectra.integrands.finance:AsianOption",
        "barrier-option": "mcspectra.integrands.finance:BarrierOption",
        "christensen-bilinear": "mcspectra.integrands.christensen:ChristensenBilinear",
        "christensen-disk": "mcspectra.integrands.christensen:ChristensenDisk",
        "christensen-gaussian": "mcspectra.integrands.christensen:ChristensenGaussian",
        "christensen-step": "mcspectra.integrands.christensen:ChristensenStep",
        "christensen-triangle": "mcspectra.integrands.christensen:ChristensenTriangle",
        "constant": "mcspectra.integrands.analytic:Constant",
        "cosine": "mcspectra.integrands.analytic:Cosine",
        "digital-option": "mcspectra.integrands.finance:DigitalOption",
        "disk": "mcspectra.integrands.indicators:Disk",
        "environment": "mcspectra.integrands.image:Environment",
        "formula": "mcspectra.integrands.formula:Formula",
        "gaussian": "mcspectra.integrands.analytic:Gaussian",
        "gaussian-peaks": "mcspectra.integrands.physics:GaussianPeaks",
        "gaussian-ridge": "mcspectra.integrands.physics:GaussianRidge",
        "genz-continuous": "mcspectra.integrands.genz:GenzContinuous",
        "genz-corner-peak": "mcspectra.integrands.genz:GenzCornerPeak",
        "genz-discontinuous": "mcspectra.integrands.genz:GenzDiscontinuous",
        "genz-gaussian": "mcspectra.integrands.genz:GenzGaussian",
        "genz-oscillatory": "mcspectra.integrands.genz:GenzOscillatory",
        "genz-product-peak": "mcspectra.integrands.genz:GenzProductPeak",
        "half-space": "mcspectra.integrands.indicators:HalfSpace",
        "image": "mcspectra.integrands.image:Image",
        "ishigami": "mcspectra.integrands.sensitivity:Ishigami",
        "keister": "mcspectra.integrands.physics:Keister",
        "linear": "mcspectra.integrands.analytic:Linear",
        "path-pixel": "mcspectra.rendering.paths:PathPixel",
        "pixel": "mcspectra.rendering.pixel:Pixel",
        "polynomial": "mcspectra.integrands.analytic:Polynomial",
        "ratio-tracking": "mcspectra.integrands.physics:RatioTracking",
        "rectangle-light": "mcspectra.integrands.lights:RectangleLight",
        "smoothed-step": "mcspectra.integrands.indicators:SmoothedStep",
        "sobol-g": "mcspectra.integrands.sensitivity:SobolG",
        "step": "mcspectra.integrands.indicators:Step",
    },
    base=Integrand,
)
"""Integrands that spec strings can name."""


def integrand(spec: str, dims: int | None = None) -> Integrand:
    """Make an integrand of a spec string such as ``"gaussian(width=0.25)"``.

    Parameters
    ----------
    spec
        ``name`` or ``name(key=value, ...)``; see ``mcspectra list integrands``.
    dims
        Number of dims; by default those the spec says, or the integrand's own, or 2.

    Raises
    ------
    SpecError
        The spec cannot be read; `UnknownName` if the name is not registered.
    ParameterError
        A parameter is unknown, missing or out of range, or dims disagree.
    """
    asked = None if dims is None else as_integer("dims", dims, least=1, most=MAX_DIMS)
    found: Integrand = INTEGRANDS.build(parse(spec), asked)
    return found


def as_integrand(given: object, dims: int | None = None) -> Integrand:
    """Return an integrand from one or from a spec string; `dims`, if given, must agree.

    Raises
    ------
    ParameterError
        `given` has another type, or other dims.
    """
    if isinstance(given, str):
        return integrand(given, dims)
    if not isinstance(given, Integrand):
        offer = (
            "make one with Integrand.from_function" if callable(given) else "give one, or a spec"
        )
        raise ParameterError(f"{given!r} is not an integrand; {offer}.")
    if dims is not None and given.dims != dims:
        raise ParameterError(f"{given.spec} has {given.dims} dims, but {dims} are needed.")
    return given
