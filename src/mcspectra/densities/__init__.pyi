from .analytic import Linear as Linear
from .analytic import TruncatedNormal as TruncatedNormal
from .analytic import Uniform as Uniform
from .base import Density as Density
from .functions import FunctionDensity as FunctionDensity
from .numeric import check_density as check_density
from .numeric import reciprocal_integral as reciprocal_integral
from .registry import DENSITIES as DENSITIES
from .registry import as_density as as_density
from .registry import density as density
from .tabulated import ImageDensity as ImageDensity
from .tabulated import PiecewiseConstant as PiecewiseConstant

__all__ = [
    "DENSITIES",
    "Density",
    "FunctionDensity",
    "ImageDensity",
    "Linear",
    "PiecewiseConstant",
    "TruncatedNormal",
    "Uniform",
    "as_density",
    "check_density",
    "density",
    "reciprocal_integral",
]
