"""The five test functions on the unit square of [Christensen2018]_.

Three functions are discontinuous (quarter disk, triangle, step).
The other two functions are smooth (Gaussian, bilinear).
Each function is an integrand of this package and has the same name as in the paper.
"""

from __future__ import annotations

import math
from typing import final

from mcspectra.integrands.analytic import Gaussian, Polynomial
from mcspectra.integrands.base import NamedFunction
from mcspectra.integrands.indicators import Disk, HalfSpace, Step

__all__ = [
    "ChristensenBilinear",
    "ChristensenDisk",
    "ChristensenGaussian",
    "ChristensenStep",
    "ChristensenTriangle",
]


@final
class ChristensenDisk(NamedFunction):
    """A quarter disk, 1 where x² + y² < 2/π; its integral is ½."""

    integrand = Disk(center=0.0, radius=math.sqrt(2.0 / math.pi), dims=2)


@final
class ChristensenTriangle(NamedFunction):
    """A triangle, 1 where y > x; its integral is ½."""

    integrand = HalfSpace(normal=(1.0, -1.0), offset=0.0, dims=2)


@final
class ChristensenStep(NamedFunction):
    """A step, 1 where x < 1/π; its integral is 1/π."""

    integrand = Step(at=1.0 / math.pi, dims=2)


@final
class ChristensenGaussian(NamedFunction):
    """A Gaussian, exp(−x² − y²); its integral is (π/4) erf(1)² = 0.5577462853510337."""

    integrand = Gaussian(center=0.0, width=math.sqrt(0.5), dims=2)


@final
class ChristensenBilinear(NamedFunction):
    """A bilinear function, x y; its integral is ¼."""

    integrand = Polynomial(coefficients=(0.0, 1.0), dims=2)
