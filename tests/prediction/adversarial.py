"""Functions that quadrature may miss, with their integrals and variances in closed form.

Each is b + h on a set A, or a narrow bell. Parts of boxes in half-spaces are known exactly.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import erf

import mcspectra as mcs
from mcspectra.core.checks import Array

FAMILIES = ("slab", "box", "bell", "ridge", "oblique-step", "hidden-step", "product")
BASE = 0.5


@dataclass(frozen=True)
class Case:
    """A function, ∫f, ∫f², the volume of its deviation, and its means over boxes (…, d)."""

    family: str
    dims: int
    function: Callable[[Array], Array]
    integral: float
    square: float
    volume: float
    moments: Callable[[Array, Array], tuple[Array, Array]]

    def integrand(self):
        return mcs.Integrand.from_function(self.function, dims=self.dims)

    def variance(self, sides):
        """Variance of one point in each of the strata; () is for a random point."""
        s = sides or (1,) * self.dims
        low = np.stack(np.meshgrid(*(np.arange(k) / k for k in s), indexing="ij"), -1)
        means, squares = self.moments(
            low.reshape(-1, self.dims), low.reshape(-1, self.dims) + 1 / np.array(s)
        )
        return float(np.mean(squares - means**2) / len(means))


def half_space(a, t, low, high):
    """Return the part of boxes (..., d) where a·x <= t."""
    size = high - low
    rest = t - np.minimum(a * low, a * high).sum(-1)
    steps = np.abs(a) * size
    found: Any = 0.0
    for corner in itertools.product((0, 1), repeat=len(a)):
        found = found + (-1) ** sum(corner) * np.maximum(
            rest - steps @ np.array(corner), 0.0
        ) ** len(a)
    return np.asarray(np.clip(found / (math.factorial(len(a)) * steps.prod(-1)), 0.0, 1.0))


def overlap(lo, hi, low, high):
    """Return the part of boxes (..., d) in the box lo … hi."""
    part = np.clip(np.minimum(hi, high) - np.maximum(lo, low), 0.0, None) / (high - low)
    return np.asarray(part.prod(-1))


def indicator(family, dims, height, inside, part):
    """b + h in a set, whose `part` is known for boxes."""

    def function(x):
        return np.asarray(BASE + height * inside(x))

    def moments(low, high):
        p = part(low, high)
        mean_square = BASE**2 + (2 * BASE * height + height**2) * p
        return BASE + height * p, mean_square

    volume = float(part(np.zeros((1, dims)), np.ones((1, dims)))[0])
    mean, square = (float(m[0]) for m in moments(np.zeros((1, dims)), np.ones((1, dims))))
    return Case(family, dims, function, mean, square, min(volume, 1 - volume), moments)


def make(family, dims, seed):
    """Make one case, reproducible from its arguments."""
    rng = np.random.default_rng([FAMILIES.index(family), dims, seed])
    height = float(rng.choice([-1.0, 1.0]) * 10 ** rng.uniform(-0.5, 1.5))
    width = 10 ** -rng.uniform(1, 5)
    lo, hi = np.zeros(dims), np.ones(dims)
    if family in ("slab", "hidden-step"):
        axis = int(rng.integers(dims))
        if family == "hidden-step":  # Next to a border of cells
            cells = 2 ** int(rng.integers(0, 6))
            width = min(width, 0.2)
            lo[axis] = (rng.integers(cells) + rng.choice([0.0, 0.5])) / cells
            lo[axis] += 0.1 * width * rng.uniform()
        else:
            lo[axis] = rng.uniform(0, 1 - width)
        hi[axis] = min(1.0, lo[axis] + width)
        if family == "hidden-step" and rng.uniform() < 0.5:
            hi[axis] = 1.0
    elif family == "box":
        size = max(width, 1e-4) ** (1 / dims)
        lo = rng.uniform(0, 1 - size, dims)
        hi = lo + size
    if family in ("slab", "hidden-step", "box"):
        return indicator(
            family, dims, height,
            lambda x: ((x >= lo) & (x < hi)).all(-1),
            lambda low, high: overlap(lo, hi, low, high),
        )  # fmt: skip
    if family in ("ridge", "oblique-step"):
        a = rng.normal(size=dims)
        a = a / np.linalg.norm(a)
        if dims == 1:
            a = np.array([1.0])
        middle = float(a @ rng.uniform(0.1, 0.9, dims))
        if family == "oblique-step":
            return indicator(
                family, dims, height, lambda x: x @ a <= middle,
                lambda low, high: half_space(a, middle, low, high),
            )  # fmt: skip
        top = middle + width
        return indicator(
            family, dims, height, lambda x: (x @ a > middle) & (x @ a <= top),
            lambda low, high: half_space(a, top, low, high) - half_space(a, middle, low, high),
        )  # fmt: skip
    if family == "bell":
        s = max(10 ** -rng.uniform(1, 5), 1e-4) ** (1 / dims) / 3
        c = rng.uniform(0.1, 0.9, dims)

        def part(low, high, s):
            r = s * math.sqrt(2)
            mass = 0.5 * (erf((high - c) / r) - erf((low - c) / r)) * math.sqrt(2 * math.pi) * s
            return np.asarray((mass / (high - low)).prod(-1))

        def bell(x):
            return np.asarray(BASE + height * np.exp(-(((x - c) / s) ** 2).sum(-1) / 2))

        def of_bell(low, high):
            one, two = part(low, high, s), part(low, high, s / math.sqrt(2))
            return BASE + height * one, BASE**2 + 2 * BASE * height * one + height**2 * two

        m, q = (float(v[0]) for v in of_bell(np.zeros((1, dims)), np.ones((1, dims))))
        return Case(family, dims, bell, m, q, (2.5 * s) ** dims, of_bell)
    # A product of 1 + h in a slab of each axis
    widths = 10 ** -rng.uniform(0.5, 3, dims)
    lo = rng.uniform(0, 1 - widths)
    hi = lo + widths
    heights = rng.uniform(0.5, 3, dims)

    def product(x):
        return np.asarray((1 + heights * ((x >= lo) & (x < hi))).prod(-1))

    def of_product(low, high):
        p = np.clip(np.minimum(hi, high) - np.maximum(lo, low), 0.0, None) / (high - low)
        return (1 + heights * p).prod(-1), (1 + (2 * heights + heights**2) * p).prod(-1)

    m, q = (float(v[0]) for v in of_product(np.zeros((1, dims)), np.ones((1, dims))))
    return Case(family, dims, product, m, q, float(widths.min()), of_product)


def cases(count):
    """Return the first `count` cases, cycling over families and dims."""
    kinds = [(family, d) for family in FAMILIES for d in (1, 2, 3, 4)]
    return [make(*kinds[i % len(kinds)], i // len(kinds)) for i in range(count)]
