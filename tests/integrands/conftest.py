"""Integrands of every class, and an oracle: quadrature that uses values only."""

from dataclasses import dataclass

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.integrands import Integrand
from mcspectra.integrands._quadrature import adaptive_integral, search_breaks

SPECS = [
    ("constant(value=-2.5)", 2),
    ("linear", 1),
    ("linear(gradient=[1, -2, 0.5], offset=0.3)", 3),
    ("polynomial(coefficients=[1, 2, -3])", 1),
    ("polynomial(coefficients=[0.5, 0, 0, 1])", 2),
    ("gaussian", 1),
    ("gaussian(center=[0.2, 1.4], width=0.3)", 2),
    ("gaussian(width=0.4)", 3),
    ("cosine(frequency=3, phase=0.4)", 2),
    ("cosine(frequency=[1, -2], phase=-1)", 2),
    ("cosine(frequency=0, phase=1)", 1),
    ("step(at=0.3)", 1),
    ("step(at=0.7, axis=1)", 2),
    ("smoothed-step(at=0.437, width=0.2)", 1),
    ("smoothed-step(at=0.05, width=0.3, axis=1)", 2),
    ("smoothed-step(at=0.5, width=4)", 1),
    ("disk(center=0.3, radius=0.5)", 1),
    ("disk(center=[0.463, 0.517], radius=0.27)", 2),
    ("disk(center=[0.1, 0.7], radius=0.4)", 2),
    ("disk(center=[1.2, 0.5], radius=0.4)", 2),
    ("disk(center=0.5, radius=3)", 2),
    ("disk(center=2, radius=0.1)", 2),
    ("disk(radius=0.4)", 3),
    ("disk(center=0.2, radius=0.4)", 3),
    ("half-space(normal=-2, offset=-0.4)", 1),
    ("half-space(normal=[1, 2], offset=0.9)", 2),
    ("half-space(normal=[0.2, -1], offset=-0.1)", 2),
    ("half-space(normal=[0, -2], offset=-0.4)", 2),
    ("half-space(normal=[1, 1], offset=3)", 2),
    ("half-space(normal=[1, -1, 0.5], offset=0.2)", 3),
    ("image(values=[[1, 2, 3], [4, 5, 6.5]])", 2),
    ("image(values=[[[1, -1], [2, 0]], [[4, 1], [5, 7]], [[0, 1], [2, 2]]])", 2),
    ("formula(expression='sin(pi*x2)/(1 + x0*y)')", 3),
]

# Next to x^-½ at 0, halving leaves √½ of the error (borders do better). The rest is then 1/(1 − √½)
# = 3.4 times the last difference.
REMAINDER = 3.5


@dataclass(frozen=True, eq=False)
class Hidden(Integrand):
    """Another integrand without its closed forms, with its breaks or other breaks."""

    inner: Integrand
    places: tuple | None = None

    name = "hidden"

    @property
    def dims(self):
        return self.inner.dims

    @property
    def channels(self):
        return self.inner.channels

    @property
    def spec(self):
        return "hidden"

    @property
    def breaks(self):
        return self.inner.breaks if self.places is None else self.places

    def _evaluate(self, x):
        return self.inner(x)


@pytest.fixture(params=SPECS, ids=lambda case: f"{case[0]}-{case[1]}d")
def f(request):
    spec, dims = request.param
    return mcs.integrand(spec, dims=dims)


@pytest.fixture
def hidden():
    return Hidden


@pytest.fixture
def oracle():
    """Integrate a callable of (..., C) values over the unit cube: value (C,) and its error.

    It uses a sixteenth of the evaluations of other quadratures.
    """
    budget = 2**17

    def integrate(function, breaks):
        g = Hidden(Integrand.from_function(function, dims=len(breaks)), breaks)
        found = adaptive_integral(g, *search_breaks(g, budget=budget), budget=budget)
        rounding = 1e-13 * (1 + np.abs(found.value).max())
        return found.value, REMAINDER * found.error + rounding

    return integrate
