from .analytic import Constant as Constant
from .analytic import Cosine as Cosine
from .analytic import Gaussian as Gaussian
from .analytic import Linear as Linear
from .analytic import Polynomial as Polynomial
from .base import FunctionIntegrand as FunctionIntegrand
from .base import Integrand as Integrand
from .base import fourier_accuracy as fourier_accuracy
from .base import fourier_grid as fourier_grid
from .base import integral_accuracy as integral_accuracy
from .channel import Channel as Channel
from .christensen import ChristensenBilinear as ChristensenBilinear
from .christensen import ChristensenDisk as ChristensenDisk
from .christensen import ChristensenGaussian as ChristensenGaussian
from .christensen import ChristensenStep as ChristensenStep
from .christensen import ChristensenTriangle as ChristensenTriangle
from .environment import Environment as Environment
from .environment import synthetic_sky as synthetic_sky
from .formula import Formula as Formula
from .image import Image as Image
from .indicators import Disk as Disk
from .indicators import HalfSpace as HalfSpace
from .indicators import SmoothedStep as SmoothedStep
from .indicators import Step as Step
from .lights import RectangleLight as RectangleLight
from .registry import INTEGRANDS as INTEGRANDS
from .registry import as_integrand as as_integrand
from .registry import integrand as integrand
from .smoothing import BoxSmoothed as BoxSmoothed
from .smoothing import EdgeSmoothed as EdgeSmoothed
from .smoothing import smoothed as smoothed

__all__ = [
    "INTEGRANDS",
    "BoxSmoothed",
    "Channel",
    "ChristensenBilinear",
    "ChristensenDisk",
    "ChristensenGaussian",
    "ChristensenStep",
    "ChristensenTriangle",
    "Constant",
    "Cosine",
    "Disk",
    "EdgeSmoothed",
    "Environment",
    "Formula",
    "FunctionIntegrand",
    "Gaussian",
    "HalfSpace",
    "Image",
    "Integrand",
    "Linear",
    "Polynomial",
    "RectangleLight",
    "SmoothedStep",
    "Step",
    "as_integrand",
    "fourier_accuracy",
    "fourier_grid",
    "integral_accuracy",
    "integrand",
    "smoothed",
    "synthetic_sky",
]
