"""Integrands that are sums or products of functions of one axis, stored as curves.

For g = c + Σ_i h_i(x_i) and g = c + Π_i h_i(x_i) only one-dimensional integrals remain.
These integrals are accurate at jumps of g, and at poles that no rule in several dims resolves.

A curve h is represented by Legendre polynomials on pieces of the axis.
Each piece is halved until the coefficients of its polynomial settle.
The smallest pieces have width 2^-50 next to a jump or pole, and 2^-64 next to 0.
Double precision does not resolve smaller pieces.

If a is close to ½, most of the integral of (t^-a)² at a pole comes from the smallest pieces.
Within a distance ε of the pole, a power law gives the integrals:

    ∫_0^ε h = ε h(ε) / (1 − a),    ∫_0^ε h² = ε h(ε)² / (1 − 2a).

The sum or product of the curves is compared with g at all points of the probe
(`mcspectra.integrands._quadrature.probe`).
The comparison finds every slab across an axis in which g differs, if it is 2^-17 wide or wider.
A region of another shape and volume v is found with probability 1 − exp(−2^17 v).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.errors import BudgetError, McspectraError, ParameterError
from mcspectra.core.tally import counting
from mcspectra.estimators.quadrature import DIVERGES, looked_at, values_at
from mcspectra.integrands import Integrand
from mcspectra.integrands._quadrature import gauss_rule, probe

__all__ = ["PiecewiseCurve", "PiecewiseSettings", "Separable", "separated", "separated_within"]


@final
@dataclass(frozen=True)
class PiecewiseSettings:
    """Settings for curves of functions of one axis, and for the test of sums and products.

    "The same results" means that no variance of the twelve test cases changes by more than 1e-10.
    The test cases are listed in `mcspectra.prediction.exact.ExactSettings`.
    """

    # Number of Legendre coefficients of a piece, and of initial pieces of an axis.
    # Half or twice as many Legendre coefficients or pieces give the same results.
    order: int = 16
    pieces: int = 32
    # Largest ratio of the last Legendre coefficients of a piece to its largest coefficient.
    # Below this ratio, the polynomial of the piece is accurate enough.
    # Halving or doubling `settled` gives the same results.
    settled: float = 1e-11
    # A piece that adds less than this fraction to ∫h² counts as settled.
    # Halving or doubling `negligible` gives the same results.
    negligible: float = 1e-15
    # A piece narrower than this contains a kink or a jump.
    # Halving or doubling `kink` gives the same results.
    kink: float = 2.0**-12
    # Next to a kink, the last Legendre coefficients may be as large as this fraction of √∫h².
    # Here h is the function of one axis that the polynomials represent.
    # Halving or doubling `small` gives the same results.
    small: float = 1e-9
    # Rounding error of a node as a fraction of its coordinate: four units in the last place.
    # Halving or doubling `rounded` gives the same results.
    rounded: float = 2.0**-51
    # Largest number of nodes of an axis, which limits the evaluations.
    most_nodes: int = 2**17
    # Pieces of this width are not halved again, because the nodes would differ by rounding only.
    # Halving or doubling `least` gives the same results.
    least: float = 2.0**-50
    least_at_0: float = 2.0**-64
    # Numbers k of the distances 2^-k from a pole, at which g is evaluated to fit its exponent.
    # The values in `near_0` are for a pole at 0, and the values in `inside` for all other poles.
    # At distances below the smallest 2^-k, the fitted power law replaces the polynomials.
    # If the distances from the pole are 32 times larger or smaller,
    # variances of functions with poles change by less than 1e-6.
    near_0: tuple[int, ...] = (40, 45, 50, 55, 60)
    inside: tuple[int, ...] = (20, 23, 26, 29, 32)
    # Smallest exponent of a pole. Polynomials resolve weaker poles.
    # Halving or doubling `pole` gives the same results.
    pole: float = 0.02
    # Relative error of the distances to a pole that is not at 0.
    # The error of the distances affects intervals of variances, but not the variances.
    place: float = 2.0**-16
    # Least growth of a function toward a pole, from one distance 2^-k to the next.
    # The growth is measured as a fraction of the value of the function.
    # Halving or doubling `step` gives the same results.
    step: float = 1e-6
    # On a side of a pole without a power law, the polynomial pieces end at this distance from it.
    # Halving or doubling `gap` gives the same results.
    gap: float = 2.0**-40
    # Number of probe points at which g is evaluated to find the largest value of a product.
    # Half or twice as many probe points give the same results.
    candidates: int = 2**10
    # A first test uses this number of probe points, and as many points with large values of g.
    # Half or twice as many probe points in the first test give the same results.
    lines: int = 16
    # Relative rounding error of g in the test of a sum or product.
    # Halving or doubling `same` gives the same results.
    same: float = 1e-7
    # If g − c is tested for being a product, the constant c is a value that g takes often.
    # The fraction of probe points at which g = c must exceed `common`.
    # For an indicator function, for example, g often takes the value c = 0.
    # Halving or doubling `common` gives the same results.
    common: float = 0.1


_SETTINGS = PiecewiseSettings()
_BLOCK = 2**11


@final
@dataclass(frozen=True)
class PiecewiseCurve:
    """A centered function on [0,1]: polynomials on pieces, and power laws next to poles.

    Attributes
    ----------
    mean
        Mean of the function. The coefficients do not include the mean.
    low, high
        Ends of the pieces, (P,).
    start, width
        The interval on which the polynomial of a piece is defined, (P,).
    coefficients
        Legendre coefficients, (P, 16).
    tails
        Both ends of the interval of each power law, and the integrals of h and h² on it, (T, 4).
    places
        Positions of jumps, kinks and poles between 0 and 1, (K,).
    doubt
        Absolute error of ∫h².
    exponent
        Largest exponent of a pole, or 0.
    """

    mean: float
    low: Array
    high: Array
    start: Array
    width: Array
    coefficients: Array
    tails: Array
    places: Array
    doubt: float
    exponent: float

    def __call__(self, x: Array) -> Array:
        """Return h at points. Power laws are replaced by the polynomial of the adjacent piece."""
        x = np.asarray(x, float)
        return self.mean + self._values(np.clip(self._piece(x), 0, None), x)

    def _piece(self, x: Array) -> Array:
        return np.searchsorted(self.low, x, side="right") - 1

    def _values(self, piece: Array, x: Array) -> Array:
        """Evaluate h − mean at points, on the given pieces, by Clenshaw's algorithm.

        The shapes of `piece` and `x` follow the broadcasting rules of NumPy.
        """
        y = np.clip(2.0 * (x - self.start[piece]) / self.width[piece] - 1.0, -1.0, 1.0)
        c = self.coefficients
        one, two, new = np.zeros(y.shape), np.zeros(y.shape), np.empty(y.shape)
        for k in range(c.shape[1] - 1, 0, -1):
            np.multiply((2 * k + 1) / (k + 1), y, out=new)
            new *= one
            new += c[piece, k]
            two *= (k + 1) / (k + 2)
            new -= two
            one, two, new = new, one, two
        return np.asarray(c[piece, 0] + y * one - 0.5 * two)

    @cached_property
    def square(self) -> float:
        """∫(h − mean)²."""
        return float(self.cells(1)[1][0])

    def cells(
        self, count: int, offset: float = 0.0, order: int = _SETTINGS.order
    ) -> tuple[Array, Array]:
        """Return means over cells minus `mean`, and variances within cells, (count,) each.

        The cells begin at (j + offset)/count on the torus.
        The offset is in units of the axis, from 0 to 1/count.
        """
        borders = np.sort((np.arange(count) / count + offset) % 1.0)
        begin = np.sort(np.concatenate([self.low, borders[borders > 0.0]]))
        piece = np.clip(self._piece(begin), 0, None)
        end = np.minimum(np.append(begin[1:], 1.0), self.high[piece])
        there = (end > begin) & (begin >= self.low[piece])
        begin, end, piece = begin[there], end[there], piece[there]
        node, weight = gauss_rule(order)
        size = end - begin
        x = begin[:, None] + size[:, None] * node
        # Blocks of cells stay in the cache
        blocks = [slice(k, k + _BLOCK) for k in range(0, max(len(x), 1), _BLOCK)]
        values = np.concatenate([self._values(piece[own, None], x[own]) for own in blocks])

        def cell_of(middle: Array) -> Array:
            found = np.floor(((middle - offset) % 1.0) * count).astype(np.int64)
            return np.minimum(found, count - 1)

        cell, tail_cell = cell_of(0.5 * (begin + end)), cell_of(self.tails[:, :2].mean(axis=1))
        sums = np.bincount(cell, size * (values @ weight), count)
        sums += np.bincount(tail_cell, self.tails[:, 2], count)
        mean = sums * count
        squares = np.bincount(cell, size * ((values - mean[cell, None]) ** 2 @ weight), count)
        tail_size, first, second = self.tails[:, 1] - self.tails[:, 0], *self.tails[:, 2:].T
        about = second - 2.0 * mean[tail_cell] * first + mean[tail_cell] ** 2 * tail_size
        squares += np.bincount(tail_cell, about, count)
        return mean, squares * count

    @staticmethod
    def along(
        function: Callable[[Array], Array], ends: Sequence[float] = (), rounding: float = 0.0
    ) -> PiecewiseCurve | None:
        """Compute the curve of a function of x (N,), with breaks at `ends`.

        Return None if halving the pieces does not make the polynomials accurate.
        A piece is accurate enough if its last Legendre coefficients are at most `rounding`.
        """
        node, _ = gauss_rule(_SETTINGS.order)
        y = 2.0 * node - 1.0
        transform = np.linalg.inv(np.polynomial.legendre.legvander(y, _SETTINGS.order - 1))
        edges = np.unique(
            [*np.linspace(0.0, 1.0, _SETTINGS.pieces + 1), *(e for e in ends if 0 < e < 1)]
        )
        low, high = edges[:-1], edges[1:]
        done: list[tuple[Array, Array, Array]] = []
        rough: list[tuple[float, float, float]] = []
        used, energy = 0, 0.0
        while len(low):
            used += low.size * _SETTINGS.order
            if used > _SETTINGS.most_nodes:
                return None
            width = high - low
            x = np.minimum(low[:, None] + width[:, None] * node, BELOW_ONE)
            with np.errstate(all="ignore"):
                values = np.asarray(function(x.ravel()), float).reshape(x.shape)
            finite = np.isfinite(values)
            values = np.where(finite, values, 0.0)
            with np.errstate(over="ignore"):
                energy = max(energy, float((width * (values**2).mean(axis=1)).sum()))
            coefficients = values @ transform.T
            largest = np.abs(coefficients).max(axis=1)
            last = np.abs(coefficients[:, -3:]).max(axis=1)
            with np.errstate(over="ignore"):
                small = width * largest * last <= _SETTINGS.negligible * energy
                small &= last <= _SETTINGS.small * math.sqrt(energy)
            # Doubles near x are spaced by 2^-53 x, and the nodes have errors of this size
            noise = _SETTINGS.settled + _SETTINGS.rounded * high / width
            settled = (last <= noise * largest + rounding) | small
            settled &= finite.all(axis=1)
            least = np.where(low == 0.0, _SETTINGS.least_at_0, _SETTINGS.least)
            end = ~settled & (width <= least)
            sizes = np.where(finite, np.abs(values), np.inf).max(axis=1)
            rough += zip(low[end].tolist(), high[end].tolist(), sizes[end].tolist(), strict=True)
            settled |= end
            done.append((low[settled], high[settled], coefficients[settled]))
            middle = 0.5 * (low + high)[~settled]
            low, high = (
                np.stack(both, axis=1).ravel()
                for both in ((low[~settled], middle), (middle, high[~settled]))
            )
        low, high, coefficients = (np.concatenate(each) for each in zip(*done, strict=True))
        order = np.argsort(low)
        low, high, coefficients = low[order], high[order], coefficients[order]
        start, width = low.copy(), high - low

        # Poles may lie at the ends, at given breaks, and where the polynomials do not settle.
        # Adjacent pieces without an accurate polynomial may belong to the same pole.
        rough += [(e, e, 0.0) for e in (0.0, *(e for e in ends if 0.0 < e < 1.0), 1.0)]
        clusters: list[list[tuple[float, float, float]]] = []
        for piece in sorted(rough):
            if clusters and piece[0] - clusters[-1][-1][1] <= _SETTINGS.gap:
                clusters[-1].append(piece)
            else:
                clusters.append([piece])
        places = []
        for cluster in clusters:
            # Of adjacent pieces, the pole lies in the piece with the largest values
            a, b, _ = max(cluster, key=lambda piece: piece[2])
            places.append(
                0.0 if cluster[0][0] == 0.0 else 1.0 if cluster[-1][1] == 1.0 else 0.5 * (a + b)
            )
        tails, doubt, exponent = [], 0.0, 0.0
        for place in places:
            for way in (1.0, -1.0):
                if (place == 0.0 and way < 0.0) or (place == 1.0 and way > 0.0):
                    continue
                logs = _SETTINGS.near_0 if place == 0.0 else _SETTINGS.inside
                at = place + way * 0.5 ** np.array(logs, float)
                distance = np.abs(at - place)
                # Near a pole the values are A t^-a + B, at distances t of constant ratio.
                # Successive differences of values also have a constant ratio, which gives a
                with np.errstate(all="ignore"):
                    value = np.asarray(function(at), float)
                    steps = np.diff(value)
                    ratios = np.diff(np.log(distance))[1:]
                    slopes = -np.log(steps[1:] / steps[:-1]) / ratios
                a, before = float(slopes[-1]), float(slopes[-2])
                if not a > _SETTINGS.pole or abs(steps[-1]) < _SETTINGS.step * abs(value[-1]):
                    continue
                exponent = max(exponent, a)
                if a >= DIVERGES:
                    continue
                size, last = float(distance[-1]), float(distance[-2])
                pole = float(steps[-1]) / (1.0 - (last / size) ** -a)  # A ε^-a
                rest = float(value[-1]) - pole
                power, square = size * pole / (1.0 - a), size * pole**2 / (1.0 - 2.0 * a)
                first, second = power + rest * size, square + 2.0 * power * rest + rest**2 * size
                off = 2.0 * abs(a - before) + (place != 0.0) * _SETTINGS.place
                doubt += square * off / (1.0 - 2.0 * a)
                begin, stop = (place, place + size) if way > 0.0 else (place - size, place)
                tails.append((begin, stop, first, second))
                # On the side of the power law, polynomial pieces end where the power law begins.
                # On the side without power law, polynomials end at the distance `gap` to the pole.
                wide = (begin, min(stop + (way < 0.0) * _SETTINGS.gap, 1.0))
                wide = (max(0.0, begin - (way > 0.0) * _SETTINGS.gap), stop) if way > 0.0 else wide
                cut_low = (low >= wide[0]) & (low < wide[1])
                cut_high = (high > wide[0]) & (high <= wide[1])
                low, high = np.where(cut_low, wide[1], low), np.where(cut_high, wide[0], high)
        # Halving leaves narrow pieces next to a kink; the narrowest of them contains the kink
        narrow = np.flatnonzero(width < _SETTINGS.kink)
        for some in np.split(narrow, np.flatnonzero(np.diff(start[narrow]) > _SETTINGS.kink) + 1):
            if some.size:
                kink = float((start + 0.5 * width)[some[width[some].argmin()]])
                if all(abs(kink - place) > _SETTINGS.kink for place in places):
                    places.append(kink)
        inside = np.array([p for p in places if 0.0 < p < 1.0])
        keep = high > low
        tail = np.array(tails, float).reshape(-1, 4)
        raw = PiecewiseCurve(
            0.0, low[keep], high[keep], start[keep], width[keep], coefficients[keep], tail,
            inside, doubt, exponent,
        )  # fmt: skip
        mean = float(raw.cells(1)[0][0])
        centered = raw.coefficients.copy()
        centered[:, 0] -= mean
        size = tail[:, 1] - tail[:, 0]
        tail = np.stack([
            tail[:, 0], tail[:, 1], tail[:, 2] - mean * size,
            tail[:, 3] - 2.0 * mean * tail[:, 2] + mean**2 * size,
        ], axis=1)  # fmt: skip
        return replace(raw, mean=mean, coefficients=centered, tails=tail)


@final
@dataclass(frozen=True)
class Separable:
    """The function c + Σ_i h_i(x_i) or c + Π_i h_i(x_i), with one channel.

    Attributes
    ----------
    curves
        The functions h_i, one curve for each axis.
    product
        Whether the functions are multiplied. Otherwise they are added.
    constant
        The constant c that is added to the product of the functions. For sums, c is 0.
    """

    curves: tuple[PiecewiseCurve, ...]
    product: bool
    constant: float = 0.0

    @property
    def diverges(self) -> bool:
        """Whether ∫g² is infinite."""
        return any(curve.exponent >= DIVERGES for curve in self.curves)

    @cached_property
    def mean(self) -> float:
        """∫g."""
        means = [curve.mean for curve in self.curves]
        return self.constant + float(np.prod(means) if self.product else np.sum(means))

    @cached_property
    def spread(self) -> tuple[float, float]:
        """∫(g − ∫g)² and its error."""
        if not self.product:
            return (
                float(sum(c.square for c in self.curves)),
                float(sum(c.doubt for c in self.curves)),
            )
        means = np.array([curve.mean for curve in self.curves])
        squares = np.array([curve.square for curve in self.curves])
        whole = math.prod((means**2 + squares).tolist())
        off = [
            c.doubt / max(m**2 + s, 1e-300)
            for c, m, s in zip(self.curves, means, squares, strict=True)
        ]
        value = 0.0  # The variance of a product, as a sum over axes without cancellation
        for done in range(len(means)):
            rest = math.prod((means[:done] ** 2).tolist())
            value += (
                rest
                * squares[done]
                * math.prod((means + 0.0)[done + 1 :] ** 2 + squares[done + 1 :])
            )
        return float(value), whole * float(sum(off))

    def __call__(self, x: Array) -> Array:
        """Return values at points (…, d)."""
        parts = [curve(x[..., i]) for i, curve in enumerate(self.curves)]
        return np.asarray(
            self.constant + (np.prod(parts, axis=0) if self.product else np.sum(parts, axis=0))
        )


def separated(g: Integrand) -> tuple[Separable, ...] | None:
    """Return g as a sum or product of functions of one axis for each channel, or None."""
    cache = g._cache
    if cache.separable is None:
        found = None
        if not g.costly:
            with contextlib.suppress(ParameterError):  # g is infinite on lines through a pole
                breaks, points = looked_at(g).breaks, probe(g.dims)
                found = [_separated(g, c, breaks, points) for c in range(max(1, g.channels))]
        whole = found is not None and all(each is not None for each in found)
        cache.separable = tuple(found) if whole and found is not None else ()
    return cache.separable or None


def separated_within(
    g: Integrand, most: int, compared: int
) -> tuple[tuple[Separable, ...] | None, int]:
    """Return `separated` with few evaluations of g, and the number of evaluations made.

    Breaks of g are not searched: the halved pieces of the curves also find them.

    Parameters
    ----------
    g
        The integrand. It is evaluated at distances down to 1e-19 from 0.
        If it fails there, None is returned.
    most
        Largest number of evaluations. If they do not suffice, None is returned.
    compared
        Number of points at which the sum or product of the curves is compared with g.
        A region of volume v is found with probability 1 − exp(−v `compared`).
    """
    points, channels = probe(g.dims)[:compared], range(max(1, g.channels))
    found: list[Separable | None] = []
    with counting("predict", most) as tally, contextlib.suppress(McspectraError):
        for channel in channels:
            found.append(_separated(g, channel, g.breaks, points))
            if found[-1] is None:
                break
    parts = tuple(each for each in found if each is not None)
    return (parts if len(parts) == len(channels) else None), tally.made


def _separated(
    g: Integrand, channel: int, breaks: Sequence[Sequence[float]], all_points: Array
) -> Separable | None:
    """Return a channel of g as a sum or product, which is compared with g at `all_points`."""
    d = g.dims

    def value(x: Array) -> Array:
        with np.errstate(all="ignore"):
            return values_at(g, x)[..., channel]

    def each(x: Array) -> Array:
        """Return values of g, or NaN where g is not defined."""
        try:
            return value(x)
        except BudgetError:
            raise
        except ParameterError:
            if len(x) == 1:
                return np.full(1, np.nan)
            half = len(x) // 2
            return np.concatenate([each(x[:half]), each(x[half:])])

    def line(
        z: Array, axis: int, constant: float, origin: float, product: bool
    ) -> Callable[[Array], Array]:
        """Return the curve of one axis along the line through z. The first curve includes g(z)."""

        def at(x: Array) -> Array:
            points = np.repeat(z[None], len(x), axis=0)
            points[:, axis] = np.minimum(x, BELOW_ONE)
            found = each(points) - constant
            if axis == 0:
                return found
            return found / origin if product else found - origin

        return at

    # Test sums and products at a few points before computing curves
    some = all_points[: _SETTINGS.candidates]
    values = value(some)
    if not np.isfinite(values).all():
        return None
    order = np.argsort(np.abs(values - np.median(values)))
    few = np.concatenate([np.arange(_SETTINGS.lines), order[-_SETTINGS.lines :]])
    tested, of_tested = some[few], values[few]
    common, counts = np.unique(values, return_counts=True)
    most = int(counts.argmax())
    constants = [
        0.0,
        *([float(common[most])] if counts[most] > _SETTINGS.common * len(values) else []),
    ]
    middle = some[order[0]]
    tries = [(False, 0.0, middle)]
    tries += [(True, c, some[int(np.abs(values - c).argmax())]) for c in constants if d > 1]
    for product, constant, z in tries:
        origin = float(value(z[None])[0]) - constant
        if product and origin == 0.0:
            continue
        moved = np.repeat(z[None], d * len(tested), axis=0).reshape(d, len(tested), d)
        for axis in range(d):
            moved[axis, :, axis] = tested[:, axis]
        parts = value(moved) - constant
        if product:
            made = origin * np.prod(parts / origin, axis=0)
            size = np.abs(of_tested) + np.abs(made)
        else:
            made = origin + np.sum(parts - origin, axis=0)
            size = np.abs(of_tested) + np.abs(parts).sum(axis=0) + d * abs(origin)
        if not (np.abs(of_tested - constant - made) <= _SETTINGS.same * size).all():
            continue

        # Compute the curve of each axis. The first curve includes the constant factor or sum of g
        curves = []
        for axis in range(d):
            curve = PiecewiseCurve.along(line(z, axis, constant, origin, product), breaks[axis])
            if curve is None:
                break
            curves.append(curve)
        if len(curves) < d:
            continue
        found = Separable(tuple(curves), product, constant)
        if found.diverges:
            return found
        given, said = each(all_points), found(all_points)
        scale = np.abs(given) + math.sqrt(found.spread[0] + found.mean**2)
        if (np.abs(given - said) <= _SETTINGS.same * scale).all():
            return found
    return None
