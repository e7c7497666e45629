from .aligned import AlignedStrata as AlignedStrata
from .analytic import Linear as Linear
from .analytic import TruncatedNormal as TruncatedNormal
from .analytic import Uniform as Uniform
from .base import Density as Density
from .base import FunctionDensity as FunctionDensity
from .base import NumericalDensity as NumericalDensity
from .base import check_density as check_density
from .base import reciprocal_integral as reciprocal_integral
from .bilinear import Bilinear as Bilinear
from .compensation import compensated as compensated
from .disk import DiskDensity as DiskDensity
from .environment import EnvironmentDensity as EnvironmentDensity
from .hemisphere import HemisphereDensity as HemisphereDensity
from .hemisphere import SphereDensity as SphereDensity
from .lights import SphericalRectangle as SphericalRectangle
from .lights import SphericalTriangle as SphericalTriangle
from .mixture import Defensive as Defensive
from .mixture import Mixture as Mixture
from .monotone import CosineWeighted as CosineWeighted
from .monotone import Exponential as Exponential
from .monotone import Power as Power
from .monotone import Tent as Tent
from .piecewise_linear import PiecewiseLinear as PiecewiseLinear
from .product import Product as Product
from .registry import DENSITIES as DENSITIES
from .registry import as_density as as_density
from .registry import as_warp as as_warp
from .registry import density as density
from .tabulated import ImageDensity as ImageDensity
from .tabulated import PiecewiseConstant as PiecewiseConstant
from .vegas_ import GridDensity as GridDensity
from .vegas_ import vegas_density as vegas_density

__all__ = [
    "DENSITIES",
    "AlignedStrata",
    "Bilinear",
    "CosineWeighted",
    "Defensive",
    "Density",
    "DiskDensity",
    "EnvironmentDensity",
    "Exponential",
    "FunctionDensity",
    "GridDensity",
    "HemisphereDensity",
    "ImageDensity",
    "Linear",
    "Mixture",
    "NumericalDensity",
    "PiecewiseConstant",
    "PiecewiseLinear",
    "Power",
    "Product",
    "SphereDensity",
    "SphericalRectangle",
    "SphericalTriangle",
    "Tent",
    "TruncatedNormal",
    "Uniform",
    "as_density",
    "as_warp",
    "check_density",
    "compensated",
    "density",
    "reciprocal_integral",
    "vegas_density",
]
