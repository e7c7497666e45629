"""Quadrature of primary-space integrands: means over strata and shifted grids, and ∫g².

Strata are cut at the seam of the torus and at the integrand's declared `breaks`.
The pieces are smaller toward 0 and 1, where warps are singular.
Gauss-Legendre rules integrate each piece.
If the means of f and f² over boxes have a closed form, these exact means are used instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import MEASURE_IT, NoClosedForm
from mcspectra.densities import Learned
from mcspectra.densities.adaptive import positive_integral
from mcspectra.estimators import Estimator
from mcspectra.estimators.base import PrimaryIntegrand
from mcspectra.integrands import Integrand
from mcspectra.integrands._quadrature import PROBE, gauss_rule, probe
from mcspectra.integrands.base import Breaks, Derived, found_breaks, integral_estimate

__all__ = [
    "DIVERGES",
    "MOST_EVALUATIONS",
    "Pointwise",
    "Rule",
    "beyond_points",
    "blindness",
    "closed_moments",
    "constant",
    "grid",
    "grid_values",
    "growth",
    "in_closed_form",
    "looked_at",
    "mesh",
    "moments",
    "offset_rule",
    "orders_of",
    "square_integral",
    "strata",
    "stratum_moments",
    "unbounded",
    "unseen",
    "values_at",
]

MOST_EVALUATIONS = 2.0**26
"""Maximum number of evaluations of an integrand in a quadrature; above it an error is raised."""

DIVERGES = 0.4995
"""If g grows with an exponent above this limit, ∫g² counts as infinite.

In theory the limit is ½. The limit used is smaller by the error of measured exponents.
"""

_BLOCK = 2**18  # Number of evaluations in one call
_ORDERS = ((12, 20), (6, 10), (4, 6))
# If there are more strata than this, Gauss-Legendre rules of lower orders are used.
# Nets in 2-D have n² cells, and 10² nodes in each cell would be too many
_MANY = 400
# For means over offsets in 1-D, [0, 1] is divided into at least this number of panels
_LEAST_PANELS = 32
# Maximum number of cells in a level; 2^13 cells resolve jumps along curves.
# With the default number of cells, a quadrature takes eight times as long
_FEW_CELLS = 2**13
# If a mean has an error below this fraction of √∫g², the rule resolves g everywhere
_SAME = 1e-9
# If the relative error of ∫g² is larger, g has jumps that the boxes do not resolve
_RESOLVED = 1e-10
_CENTER = 2**10  # The mean of g over this number of points is subtracted from g
# Next to a pole, g² exceeds its largest value at the points of `probe` by this factor
_POLE = 2.0
# If the relative error is larger, there may be a pole, and all levels are computed
_SUSPECT = 0.01
_LOOKED_DIMS = 5
# Largest fraction of the error that may come from regions between the nodes
_HIDDEN = 0.1
# Number of lines, and the largest difference between two slopes that count as equal
_GROWTH_LINES, _STEADY = 4, 0.02
# The growth of g is measured at small distances from 0, from 1, and from a break.
# Each number k stands for the distance 2^-k
_FAR, _NEAR, _INSIDE = (30, 60, 90, 120), (20, 30, 40, 50), (8, 14, 20, 26)
# The 256 largest values at the points of `probe` are stored.
# In the integral of g², a power law through the 8th largest value replaces the largest values
_TOP, _RANK = 256, 8
# The largest values follow a power law t^-a if the exponent a is above 0.1,
# and if log(g_4/g_32) exceeds 0.6 log(g_32/g_256), where g_k has rank k.
# Power laws with an exponent a of at most 0.47 are used to integrate g²
_HEAVY, _AS_POWER, _LARGEST_POWER = 0.1, 0.6, 0.47
# Growth is unbounded if log2 |g| rises by at least this much at each step toward the plane
_RISES = 0.02

# Quadrature panels that shrink to 2^-20 at 0 integrate √u to 1e-6.
# In 2-D there are fewer panels, because each panel of an axis adds a row of panels
_GRADED = {
    dims: tuple(x for k in range(1, depth) for x in (0.5**k, 1.0 - 0.5**k))
    for dims, depth in ((1, 40), (2, 14))
}


@final
@dataclass(frozen=True, eq=False)
class Pointwise(Derived):
    """A pointwise function of an integrand.

    If `width` is given, it is the number of channels.
    By default, the function has as many channels as the integrand.
    """

    name: ClassVar[str] = "pointwise"
    text = "{0.label}"
    is_black_box = False
    integrand: Integrand
    values: Callable[[Array], Array]  # Computes values at points
    cuts: Breaks
    label: str
    width: int | None = None

    @property
    def channels(self) -> int:  # type: ignore[override]
        return self.integrand.channels if self.width is None else self.width

    @property
    def breaks(self) -> Breaks:
        return self.cuts

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(self.values(x))

    def _integral(self) -> None:
        return None


@final
@dataclass(frozen=True, eq=False)
class _Cut(Derived):
    """An integrand with its declared breaks and the breaks that line searches detected."""

    name: ClassVar[str] = "cut"
    text = "{0.integrand.spec}"
    integrand: Integrand

    @property
    def breaks(self) -> Breaks:
        return tuple(tuple(axis.tolist()) for axis in found_breaks(self.integrand))

    def _evaluate(self, x: Array) -> Array:
        return self.integrand(x)

    def _fourier(self, m: Array) -> Array | None:
        return self.integrand._fourier(m)


def looked_at(g: Integrand) -> Integrand:
    """Return g with additional breaks: the jumps that are detected by line searches along the axes.

    Only jumps normal to an axis are detected; see `found_breaks`.
    g is returned unchanged if it has more than 5 dims, or if its calls are costly.
    g is also returned unchanged if it has a closed form or its own rule.
    """
    cache = g._cache
    if cache.cut is None:
        as_it_is = isinstance(g, _Cut) or g.costly or g.dims > _LOOKED_DIMS or in_closed_form(g)
        more = 0
        if not as_it_is and g._estimated_integral() is None:
            more = sum(map(len, found_breaks(g))) - sum(map(len, g.breaks))
        cache.cut = _Cut(g) if more > 0 else g
    return cache.cut


def blindness(g: Integrand, means: Array, squares: Array) -> Array:
    """Return the error that a rule for ∫g and ∫g² causes in a variance, (channels,).

    Parameters
    ----------
    g
        The integrand.
    means, squares
        Means of g and g² over equal parts of the cube, computed by the rule, (parts, channels).

    Returns
    -------
    ndarray
        Difference between the means and the integrals that an adaptive rule computes.
        If the adaptive rule does not resolve g, the error of the adaptive rule is added.
        The adaptive rule is `mcspectra.integrands._quadrature.adaptive_integral`.
        It also finds regions where g differs from the values at the first rule's nodes.
        The result is 0 if the two rules agree and the adaptive rule resolves g.
        The result is also 0 if the mean over all strata agrees with a closed form of ∫g.
    """
    mean, square = means.mean(axis=0), squares.mean(axis=0)
    exact = g._integral()
    if in_closed_form(g):
        return np.zeros(mean.shape)
    if exact is not None and (np.abs(mean - exact) <= _SAME * np.sqrt(square)).all():
        return np.zeros(mean.shape)
    middle, first, second, error = moments(g)
    rounding = 1e-14 * (square + middle**2)
    off = np.abs(mean - middle - first) - error - rounding
    square_off = np.abs(square - 2.0 * middle * mean + middle**2 - second) - error - rounding
    largest = np.abs(means - middle).max(axis=0)
    missed = np.maximum(square_off, 0.0) + 2.0 * largest * np.maximum(off, 0.0)
    # If the adaptive rule does not resolve ∫g², the first rule may have an equally large error.
    # Add the error of the adaptive rule then, and if breaks of g were detected, where g jumps
    hides = (error > _RESOLVED * second) | isinstance(g, _Cut)
    return np.asarray(missed + np.where(hides, error, 0.0))


def moments(g: Integrand) -> tuple[Array, Array, Array, Array]:
    """Return a number a near ∫g, the integrals ∫(g − a) and ∫(g − a)², and their error.

    All four results are arrays of shape (channels or 1,).
    The integrals have a closed form, or come from an adaptive rule that also finds hidden peaks.
    The integrals are cached. With a learned density, f is integrated over the domain.
    In the domain, the knots of the density are on planes normal to the axes.
    In primary space, the knots of the density are on curves.
    """
    cache = g._cache
    if cache.moments is None:
        exact = closed_moments(g)
        if exact is None:
            middle = g(probe(g.dims)[:_CENTER]).reshape(_CENTER, -1).mean(axis=0)
            inside: Any = _inside(g)[0]
            density: Any = inside.density if _inside(g)[1] else None
            over_domain = isinstance(density, Learned)
            breaks = density.cuts(inside.integrand.breaks) if over_domain else g.breaks

            def centered(x: Array) -> Array:
                p = density.pdf(x)[..., None] if over_domain else 1.0
                values = values_at(inside.integrand if over_domain else g, x)
                first = values / p - middle
                with np.errstate(over="ignore"):  # Values may overflow next to a pole
                    return np.concatenate([first * p, first**2 * p], axis=-1)

            label, width = f"moments of {g.spec}", 2 * len(middle)
            both = Pointwise(g, centered, breaks, label, width)
            # In more than `_LOOKED_DIMS` dims, jumps of g are not searched for
            if g.dims <= _LOOKED_DIMS and not over_domain:
                both._cache.breaks = found_breaks(g)
            found = integral_estimate(both)
            first, second = np.split(found.value, 2)
            error = np.full(middle.shape, found.error)
            if found.unseen is not None:
                cache.unseen_square = found.unseen[len(middle) :]
        else:
            middle, square = exact
            first, second, error = 0.0 * middle, square - middle**2, 0.0 * middle
        cache.moments = middle, first, second, error
    return cache.moments


@final
@dataclass(frozen=True)
class Rule:
    """A Gauss-Legendre rule: its order, the largest number of evaluations, and a second order."""

    order: int
    most: float = MOST_EVALUATIONS
    against: int = 0

    def each(self, g: Integrand) -> int:
        """Return the evaluations for one box. Closed-form moments take one evaluation a corner."""
        return int((2 if in_closed_form(g) else self.order) ** g.dims)

    def check(self, what: str, evaluations: float) -> None:
        """Raise an error if the quadrature would take too long; `what` begins the message."""
        if evaluations > self.most:
            raise NoClosedForm(
                f"{what} would take {evaluations:.2g} evaluations, more than {self.most:.2g}; use ",
                *MEASURE_IT,
                ".",
            )


def orders_of(cells: int, dims: int) -> tuple[int, int]:
    """Return two orders of rules to compare; they are lower for d > 1 and for many cells."""
    return _ORDERS[0] if dims == 1 else _ORDERS[1] if cells < _MANY else _ORDERS[2]


def unseen(g: Integrand) -> Array:
    """Return the error of ∫g² that comes from regions between nodes, (channels or 1,)."""
    none = np.zeros(max(1, g.channels))
    if g.costly or g.dims > _LOOKED_DIMS or in_closed_form(g):
        return none
    moments(g)
    return none if g._cache.unseen_square is None else g._cache.unseen_square


def beyond_points(g: Integrand) -> Array:
    """Return the part of ∫g² next to poles that the points of the probe miss, (channels or 1,).

    The missed part is 0 if g has no poles. Poles are assumed in two cases:
    g grows without bound on lines, or the largest values of |g| follow a power law.
    Let g_k be the k-th largest value. By a power law, g_4/g_32 is about as large as g_32/g_256.
    For a smooth peak, log(g_4/g_32) is only log(g_32/g_256)/8.
    For N points with values t^-a, the k largest contribute k g_k² / (N (1 − 2a)) to ∫g².
    """
    none = np.zeros(max(1, g.channels))
    if g.costly or in_closed_form(g):
        return none
    cache = g._cache
    if cache.largest is None and unbounded(g):
        values = np.abs(g(probe(g.dims)).reshape(PROBE, -1))
        cache.largest = -np.sort(-values, axis=0)[:_TOP]
    if cache.largest is None:
        return none
    top = np.maximum(cache.largest, 1e-300)
    first, second = (np.log(top[a - 1] / top[b - 1]) for a, b in ((4, 32), (32, 256)))
    power = first / math.log(8.0)
    heavy = (power > _HEAVY) & (first > _AS_POWER * second)
    if not (unbounded(g) or heavy.any()):
        return none
    power = np.clip(np.maximum(power, growth(g)), 0.0, _LARGEST_POWER)
    rest = _RANK * top[_RANK - 1] ** 2 / (PROBE * (1.0 - 2.0 * power))
    return np.asarray(np.where(heavy | unbounded(g), rest, 0.0))


def constant(g: Integrand) -> str:
    """Return a sentence if an integrand has the same value at all points of the probe, else ''."""
    if g.costly or in_closed_form(g) or g._integral() is not None:
        return ""
    values = g(probe(g.dims)).reshape(PROBE, -1)
    largest = np.partition(np.abs(values), PROBE - _TOP, axis=0)[PROBE - _TOP :]
    g._cache.largest = np.sort(largest, axis=0)[::-1]
    if np.ptp(values, axis=0).any():
        return ""
    return (
        f"{g.spec} is the same at all {PROBE} points of a probe: its variance is 0 to rounding, or "
        f"comes from a region of less than about {10 / PROBE:.0e} of the volume; use convergence, "
        "or give its integral (integral=) if it is constant"
    )


def closed_moments(g: Integrand) -> tuple[Array, Array] | None:
    """Return ∫g and ∫g², each (channels or 1,), from closed-form moments over boxes, or None."""
    found = g.box_moments(np.zeros((1, g.dims)), np.ones((1, g.dims)))
    if found is None:
        return None
    mean, square = (np.asarray(moment, float).reshape(-1) for moment in found)
    return mean, square


def in_closed_form(g: Integrand) -> bool:
    """Return whether g has closed-form moments over boxes."""
    return closed_moments(g) is not None


def values_at(g: Integrand, x: Array) -> Array:
    """Return g at points (…, d), as (…, channels or 1)."""
    return np.asarray(g(x)).reshape(*x.shape[:-1], -1)


def mesh(*axes: Array) -> Array:
    """Return all points of the grid with the given coordinates along each axis, (…, d)."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def grid(axis: Array, dims: int) -> Array:
    """Return a grid with the same coordinates along each axis, in C order, (k^dims, dims)."""
    return mesh(*[axis] * dims).reshape(-1, dims)


def strata(
    g: Integrand, sides: tuple[int, ...], offset: Array, rule: Rule
) -> tuple[Array, Array, Array]:
    """Return means over displaced strata, the mean variance within a stratum, and its error.

    Strata are displaced by `offset` on the torus.

    The three arrays have the shapes (strata, channels), (channels,) and (channels,).
    The error is computed by `blindness`.
    If jumps of g are unknown, rules of two orders may give the same variance by chance.
    Therefore the variance in each stratum is computed by both rules, and the results are compared.
    Twice the standard error of the mean difference between the rules is added to the error.
    """
    means, squares = stratum_moments(g, sides, offset, rule.order, rule.most)
    unseen = blindness(g, means, squares)
    # Rounding can make the variance negative. Clipping avoids a second pass of evaluations
    within = np.maximum(squares - means * means, 0.0)
    if rule.against and not in_closed_form(g):
        coarse, squares = stratum_moments(g, sides, offset, rule.against, rule.most)
        off = within - np.maximum(squares - coarse * coarse, 0.0)
        unseen = unseen + 2.0 * np.sqrt((off**2).sum(axis=0)) / len(off)
    return means, within.mean(axis=0), unseen


def stratum_moments(
    g: Integrand,
    sides: tuple[int, ...],
    offset: Array,
    order: int | Array,
    most: float = MOST_EVALUATIONS,
) -> tuple[Array, Array]:
    """Return means of g and g² over strata displaced on the torus, (strata, channels or 1).

    `order` is the order of the Gauss-Legendre rule, or a tuple with an order for each axis.
    """

    def cut(graded: tuple[float, ...]) -> list[tuple[Array, Array]]:
        """Return pieces of each axis, cut at strata borders (j + offset)/sides, breaks and 0."""
        axes = []
        for s, displaced, breaks in zip(sides, map(float, offset), g.breaks, strict=True):
            borders = (np.arange(s) / s + displaced) % 1.0
            inner = [b for b in (*breaks, *graded) if 0 < b < 1]
            ends = np.unique(np.concatenate([[0.0, 1.0], borders, inner]))
            wide = np.diff(ends) > 1e-15
            axes.append((ends[:-1][wide], ends[1:][wide]))
        return axes

    exact = in_closed_form(g)
    axes = cut(() if exact else _GRADED.get(g.dims, ()))
    boxes = math.prod(float(len(low)) for low, _ in axes)
    orders = [2] * g.dims if exact else np.broadcast_to(order, g.dims).tolist()
    Rule(max(orders), most).check(
        f"The quadrature of the strata of {g.spec}", boxes * math.prod(orders)
    )
    if exact:
        box = [mesh(*ends) for ends in zip(*axes, strict=True)]
        both = np.stack([np.asarray(m) for m in g.box_moments(*box) or ()])
        both = both.reshape(2, *(len(low) for low, _ in axes), -1)
    else:
        # Apply the Gauss-Legendre rule to each piece. Sum along all axes except the first
        rules = [gauss_rule(each) for each in orders]
        grids = [
            (low[:, None] + (high - low)[:, None] * node).ravel()
            for (low, high), (node, _) in zip(axes, rules, strict=True)
        ]
        step = max(1, _BLOCK // math.prod(len(grid) for grid in grids[1:]))
        parts = []
        for start in range(0, len(grids[0]), step):
            x = mesh(grids[0][start : start + step], *grids[1:])
            values = values_at(g, x)
            part = np.stack([values, values**2])
            for i in range(g.dims, 1, -1):
                part = _sums(part, i, rules[i - 1][1])
            parts.append(part)
        both = _sums(np.concatenate(parts, axis=1), 1, rules[0][1])

    # Average over each stratum, one axis after another. The weight of a piece is its size
    for i, (low, high) in enumerate(axes):
        middle = (0.5 * (low + high) - float(offset[i])) % 1.0
        stratum = np.minimum(np.floor(middle * sides[i]).astype(np.int64), sides[i] - 1)
        share = ((high - low) * sides[i]).reshape(-1, *(1,) * (g.dims - i))
        gathered = np.zeros((*both.shape[: i + 1], sides[i], *both.shape[i + 2 :]))
        where: Any = (slice(None),) * (i + 1) + (stratum,)
        np.add.at(gathered, where, both * share)
        both = gathered
    means, squares = both.reshape(2, math.prod(sides), -1)
    return means, squares


def _sums(values: Array, axis: int, weights: Array) -> Array:
    """Return weighted sums along an axis: one for each group of len(weights) successive values."""
    shape = (*values.shape[:axis], -1, len(weights), *values.shape[axis + 1 :])
    return np.asarray(np.moveaxis(values.reshape(shape), axis + 1, -1) @ weights)


def offset_rule(g: Integrand, sides: tuple[int, ...], order: int) -> tuple[Array, Array]:
    """Return Gauss nodes and weights over the offsets of a stratum, divided at all breaks."""
    node, weight = gauss_rule(order)
    per_axis = []
    for s, breaks in zip(sides, g.breaks, strict=True):
        side = 1.0 / s
        folded = [b % side for b in breaks]
        panels = max(1, _LEAST_PANELS // s) if g.dims == 1 else 1
        cuts = [*folded, *(np.arange(1, panels) / panels * side)]
        ends = np.unique([0.0, side, *(b for b in cuts if 1e-14 < b < side - 1e-14)])
        low, width = ends[:-1, None], np.diff(ends)[:, None]
        nodes = (low + width * node).ravel()
        per_axis.append((nodes, (width / side * weight).ravel()))
    nodes, weights = (mesh(*each).reshape(-1, g.dims) for each in zip(*per_axis, strict=True))
    return nodes, weights.prod(axis=1)


def grid_values(g: Integrand, sides: tuple[int, ...], offset: Array) -> Array:
    """Return g on the grid (j + offset·sides)/sides, as (*sides, channels or 1)."""
    x = mesh(*((np.arange(s) / s + o) % 1.0 for s, o in zip(sides, offset, strict=True)))
    return np.asarray(g(x)).reshape(*sides, -1)


def square_integral(g: Integrand) -> tuple[Array, Array]:
    """Return ∫g² and an estimate of its absolute error, each (channels or 1,).

    The result is infinite if g grows too fast toward a plane normal to an axis (`growth`).
    Otherwise ∫g² comes from `moments`. In 1-D and 2-D, quadrature by levels gives a second value.
    Quadrature by levels records the unresolved part of each level (`mcspectra.densities.adaptive`).
    If g = f/p, quadrature by levels integrates f²/p over the domain:
    in primary space, floating-point numbers are sparse next to 1.
    ∫g² is infinite if the unresolved part does not shrink.
    ∫g² is finite if g grows as t^-a with a < ½ at the distance t from a plane normal to an axis.
    If both values of ∫g² are finite, the value with the smaller error is used.
    In three or more dims, only poles on planes normal to an axis are recognized.
    Any other pole may be missed. At best, the pole makes the estimated error large.
    """
    cache = g._cache
    if cache.square is not None:
        return cache.square
    width = max(1, g.channels)
    by_levels, level_errors = np.full(width, np.nan), np.full(width, np.inf)
    inside, warped = _inside(g)
    grows = growth(g)
    by_levels[grows >= DIVERGES] = np.inf
    over_domain = warped and inside.density.dims == g.dims  # type: ignore[attr-defined]

    def square(x: Array) -> Array:
        """Return g² at points (..., d), with channels. Over the domain, return f²/p."""
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # g may be infinite
            if not over_domain:
                return values_at(g, x) ** 2
            f = values_at(inside.integrand, x)  # type: ignore[attr-defined]
            p = inside.density.pdf(x)[..., None]  # type: ignore[attr-defined]
            return np.where(f == 0.0, 0.0, f**2 / p)

    # Integrate by levels, and record the unresolved part of each level
    for c in np.flatnonzero(np.isnan(by_levels)) if not in_closed_form(g) and g.dims <= 2 else ():
        seen = [0.0]

        def of_channel(x: Array, c: int = int(c), seen: list[float] = seen) -> Array:
            found = square(x)[..., c]
            seen.append(float(found.max(initial=0.0)))
            return found

        level = positive_integral(of_channel, g.dims, most_cells=_FEW_CELLS)
        if level[1] > _SUSPECT * level[0]:
            level = positive_integral(of_channel, g.dims)
        # On a narrow ridge of g, the largest value also grows when cells are refined.
        # However, a ridge hardly exceeds the values at the points of `probe`, so it is not a pole.
        # Quadrature by levels is not used for poles whose exponent is known
        largest = max(seen)
        pole = largest > _POLE * float(of_channel(probe(g.dims)).max())
        if math.isfinite(level[0]) or (pole and not grows[c] > 0.0):
            by_levels[c], level_errors[c] = level
    if np.isinf(by_levels).all():
        cache.square = by_levels, np.zeros(width)
        return cache.square

    # Integrate by the adaptive rule, which finds details between nodes
    middle, first, second, error = moments(g)
    value = second + 2.0 * middle * first + middle**2
    error = error * (1.0 + 2.0 * np.abs(middle))
    with np.errstate(invalid="ignore"):
        # Quadrature by levels can miss thin slabs.
        # The adaptive rule divides the cube into boxes, and can miss the tips of poles
        more = by_levels - value - level_errors - error
        alike = np.abs(by_levels - value) <= level_errors + error
    hidden = unseen(g)  # Error from thin slabs that quadrature by levels misses
    better = alike & (level_errors + hidden < error) & (hidden < _HIDDEN * error)
    better |= np.isinf(by_levels) | over_domain & (more > 0.0)
    level_errors = np.where(np.isinf(by_levels), 0.0, level_errors + hidden)
    if not isinstance(g, _Cut):
        error = np.where((more > 0.0) & ~better, error + more, error)
    value, error = np.where(better, by_levels, value), np.where(better, level_errors, error)
    cache.square = value, error
    return cache.square


def _inside(g: Integrand) -> tuple[Integrand, bool]:
    """Return g without detected jumps, and whether g is f/p in primary space."""
    inside = g.integrand if isinstance(g, _Cut) else g
    return inside, isinstance(inside, PrimaryIntegrand) and isinstance(inside.estimator, Estimator)


def growth(g: Integrand) -> Array:
    """Return the largest exponent a of growth t^-a near an end of an axis or a break; 0 if bounded.

    Here t is the distance to the end or break. The exponents have the shape (channels or 1,).
    The exponents are slopes of log |g| over −log t, at the smallest distances t on some lines.
    A slope counts only if the two pairs of points with the smallest t give almost the same slope.
    ∫g² diverges for a ≥ ½, and ∫g⁴ for a ≥ ¼. Integrands in closed form do not have these poles.
    An integrand is not tested if it is costly or warped by a density.
    """
    return _growth(g)[0]


def unbounded(g: Integrand) -> bool:
    """Return whether g is unbounded near an end of an axis or a break, tested on some lines.

    Growth slower than any power also counts, for example that of logarithms and quantiles.
    """
    return bool(_growth(g)[1])


def _growth(g: Integrand) -> tuple[Array, bool]:
    if g._cache.growth is None:
        g._cache.growth = _seen_growth(g)
    return g._cache.growth


def _seen_growth(g: Integrand) -> tuple[Array, bool]:
    found, grows = np.zeros(max(1, g.channels)), False
    if _inside(g)[1] or in_closed_form(g) or g.costly:
        return found, grows
    lines = probe(g.dims)[:_GROWTH_LINES]
    for axis in range(g.dims):
        ends = [(0.0, 1.0, _FAR), (1.0, -1.0, _NEAR)]
        ends += [(b, way, _INSIDE) for b in looked_at(g).breaks[axis] for way in (1.0, -1.0)]
        for place, way, distances in ends:
            room = 1.0 - place if way > 0.0 else place
            x = np.repeat(lines[:, None], len(distances), axis=1)
            x[..., axis] = place + way * room * 0.5 ** np.array(distances)
            size = np.log2(np.maximum(np.abs(values_at(g, x)), 1e-300))
            rise = np.diff(size, axis=1)
            slope = rise / np.diff(distances)[:, None]
            steady = (np.ptp(slope[:, -2:], axis=1) < _STEADY) & (slope[:, -1] > _STEADY)
            found = np.maximum(found, np.where(steady, slope[:, -1], 0.0).max(axis=0))
            grows |= bool((rise > _RISES).all(axis=1).any())
    return found, grows
