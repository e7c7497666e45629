"""The five test functions on the unit square of Christensen, Kensler and Kilpatrick (2018).

Source: "Progressive multi-jittered sample sequences", Computer Graphics Forum 37 (4):
three discontinuous (quarter disk, triangle, step) and two smooth (Gaussian, bilinear). Each is one
of this package's own integrands under the name of the paper.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar, final

from mcspectra.core.checks import Array
from mcspectra.integrands.analytic import Gaussian, Polynomial
from mcspectra.integrands.base import Integrand
from mcspectra.integrands.indicators import Disk, HalfSpace, Step

__all__ = [
    "ChristensenBilinear",
    "ChristensenDisk",
    "ChristensenGaussian",
    "ChristensenStep",
    "ChristensenTriangle",
]


@dataclass(frozen=True, kw_only=True)
class _TestFunction(Integrand):
    """A test function, evaluated by `model`; abstract, named by its subclasses."""

    model: ClassVar[Integrand]
    dims: int = field(default=2, init=False)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """As for the model."""
        return self.model.breaks

    @property
    def fourier_source(self) -> str:
        """As for the model."""
        return self.model.fourier_source

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array] | None:
        """As for the model."""
        return self.model.box_moments(lo, hi)

    def _evaluate(self, x: Array) -> Array:
        return self.model._evaluate(x)

    def _integral(self) -> Any:
        return self.model._integral()

    def _fourier(self, m: Array) -> Array | None:
        return self.model._fourier(m)


@final
class ChristensenDisk(_TestFunction):
    """A quarter disk, 1 where x² + y² < 2/π; its integral is ½."""

    name: ClassVar[str] = "christensen-disk"
    model: ClassVar[Integrand] = Disk(center=0.0, radius=math.sqrt(2.0 / math.pi), dims=2)


@final
class ChristensenTriangle(_TestFunction):
    """A triangle, 1 where y > x; its integral is ½."""

    name: ClassVar[str] = "christensen-triangle"
    model: ClassVar[Integrand] = HalfSpace(normal=(1.0, -1.0), offset=0.0, dims=2)


@final
class ChristensenStep(_TestFunction):
    """A step, 1 where x < 1/π; its integral is 1/π."""

    name: ClassVar[str] = "christensen-step"
    model: ClassVar[Integrand] = Step(at=1.0 / math.pi, dims=2)


@final
class ChristensenGaussian(_TestFunction):
    """A Gaussian, exp(−x² − y²); its integral is (π/4) erf(1)² = 0.5577462853510337."""

    name: ClassVar[str] = "christensen-gaussian"
    model: ClassVar[Integrand] = Gaussian(center=0.0, width=math.sqrt(0.5), dims=2)


@final
class ChristensenBilinear(_TestFunction):
    """A bilinear function, x y; its integral is ¼."""

    name: ClassVar[str] = "christensen-bilinear"
    model: ClassVar[Integrand] = Polynomial(coefficients=(0.0, 1.0), dims=2)
