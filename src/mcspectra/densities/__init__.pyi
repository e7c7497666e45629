from .analytic import CosineWeighted as CosineWeighted
from .analytic import Exponential as Exponential
from .analytic import Linear as Linear
from .analytic import Power as Power
from .analytic import Tent as Tent
from .analytic import TruncatedNormal as TruncatedNormal
from .analytic import Uniform as Uniform
from .base import Density as Density
from .base import FunctionDensity as FunctionDensity
from .base import NumericalDensity as NumericalDensity
from .base import check_density as check_density
from .base import reciprocal_integral as reciprocal_integral
from .bilinear import Bilinear as Bilinear
from .composite import Defensive as Defensive
from .composite import Mixture as Mixture
from .composite import Product as Product
from .directions import DiskDensity as DiskDensity
from .directions import HemisphereDensity as HemisphereDensity
from .directions import SphereDensity as SphereDensity
from .environment import EnvironmentDensity as EnvironmentDensity
from .environment import ImageDensity as ImageDensity
from .environment import compensated as compensated
from .learned import Learned as Learned
from .lights import SphericalRectangle as SphericalRectangle
from .lights import SphericalTriangle as SphericalTriangle
from .pieces import AlignedStrata as AlignedStrata
from .pieces import GridDensity as GridDensity
from .pieces import PiecewiseLinear as PiecewiseLinear
from .registry import DENSITIES as DENSITIES
from .registry import as_density as as_density
from .registry import density as density
from .tabulated import PiecewiseConstant as PiecewiseConstant

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
    "Learned",
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
    "check_density",
    "compensated",
    "density",
    "reciprocal_integral",
]
