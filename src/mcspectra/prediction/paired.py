"""Variances of orthogonal arrays: energies of g by how many axes it varies with at once.

On each axis a function is a sum of four parts: its mean, means over strata (β), means over the parts of
a stratum (δ), and what is left within parts. The law of pairs of `PairedAxes` multiplies each part
by a number, in a pair of different points: (1, −1/(s−1), 0, 0) where they lie in different strata of
s, (1, 1, 0, 0) where they share one and are independent in it, and (1, 1, −1/(m−1), 0) in two different
parts of m. With E_u the energy of g whose parts along the axes are u,

    n Var = Σ_u (1 + λ_u) E_u,    λ_u = n Σ_p share_p Π_i factor_p,i(u_i),

the sum over the patterns p of pairs. λ is −1 for a β and for a δ alone, and for two β: such energies have
no variance. Beyond three β it is of the order of 1/s², which the interval covers.

Energies of single axes are those of the curves g_i of `mcspectra.prediction.subsets`, whose sums of
products Σ_r Π_i h_ri(x_i) have a known variance: each factor of it is the mean of a product over a pair on
one axis. What g has beside that is found from r = g − Σ g_i at pairs of points of our own that share
strata of two or three axes, chosen at random, less the same of the sums of products [Owen1992]_.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.errors import NoClosedForm
from mcspectra.core.streams import Stream
from mcspectra.estimators.quadrature import values_at
from mcspectra.prediction.known import Known, Predicted, half_interval
from mcspectra.prediction.subsets import SUBSET_SETTINGS, Parts, all_parts, net, offsets_within
from mcspectra.samplers.law import Law, PairedAxes, Relation, Shifted, unmoved

__all__ = ["PairedSettings", "is_array", "of_arrays"]

_MEAN, _BETWEEN, _AMONG = "mean", "between strata", "between parts"
_MULTIPLES = {"two": (_BETWEEN,) * 2, "parts": (_BETWEEN, _AMONG), "three": (_BETWEEN,) * 3}
"""Parts of g along the axes that they vary with, whose energies are found; others are bounded."""


@final
@dataclass(frozen=True, kw_only=True)
class PairedSettings:
    """How many pairs of points give energies of several axes.

    Changes are those of a ball, a Gaussian and a kink in 4-D with orthogonal-array | shift at n = 289.

    Attributes
    ----------
    pairs
        Pairs of each replicate that share strata of two axes, of which only one in a part of its own, and of
        three. The first weigh most.
    replicates
        Scrambled nets of pairs, whose spread is the error.
    fine, finest
        Cells of an axis for the energy of its curves, where g is smooth and where it jumps: what varies
        within them is lost, 2e-6 of the square of a jump.
    """

    pairs: tuple[int, int, int] = (1 << 16, 1 << 13, 1 << 13)
    replicates: int = 16
    fine: int = 1 << 14
    finest: int = 1 << 17


_SETTINGS = PairedSettings()


def of_arrays(law: Law, known: Known, stream: Stream) -> Predicted:  # noqa: ARG001
    """Predict the variance with an orthogonal array of strength 2, moved or shifted or not.

    Raises
    ------
    NoClosedForm
        The law is another, or its pairs prefer some axes.
    """
    array, by = unmoved(law)
    if not (is_array(law) and isinstance(array, PairedAxes)):
        raise NoClosedForm(f"{law.name} is no orthogonal array.")
    n, s = law.n, array.strata[0]
    parts = array.parts[0] if any("mates" in p.axes for p in array.patterns) else 1
    offsets = offsets_within(1.0 / s, by, uniform=isinstance(law, Shifted))
    weights = {
        name: _weights(array, tuple(along))
        for name, along in (("one", (_BETWEEN,)), ("part", (_AMONG,)), *_MULTIPLES.items())
    }
    if any(np.ptp(each) > 1e-9 * (1.0 + abs(each[0])) for each in weights.values()):
        raise NoClosedForm(f"Pairs of points of {law.name} prefer some axes to others.")
    one, part, two, both, three = (float(each[0]) for each in weights.values())

    # The largest weight of energies of three axes and more that are not found
    rest = 0.0
    for many_between, many_among in itertools.product(range(law.dims + 1), repeat=2):
        if 2 < many_between + many_among <= law.dims and (many_between, many_among) != (3, 0):
            along = (_BETWEEN,) * many_between + (_AMONG,) * many_among
            rest = max(rest, abs(float(_weight(array, along + (_MEAN,) * (law.dims - len(along))))))

    found = []
    for c, p in enumerate(known.once("subsets: parts", lambda: all_parts(known))):
        at = None if isinstance(law, Shifted) else offsets
        sums, more = known.once(
            ("arrays", c, s, parts, at),
            functools.partial(_energies, p, c, s, parts, offsets, known),
        )
        # Single axes, of all groups of profiles and of each; sums of products; what g has beside these
        alone = sums.single @ np.array([1.0, 1.0 + part, 1.0 + one])
        several = _of_products(array, sums)
        beside = more @ np.array([1.0, two, both, three])
        left = abs(float((more @ np.array([1.0, -1.0, -1.0, -1.0])).mean()))
        value = float(alone[0]) + several + float(beside.mean())
        rough = any(len(axis.knots) > 2 for axis in p.axes)
        between = SUBSET_SETTINGS.resolved[rough] * value
        error = math.hypot(float(half_interval(alone[1:])), float(half_interval(beside)), between)
        share = 1.0 - left / p.variance if p.variance > 0.0 else 0.0
        found.append((max(value, 0.0), error + rest * left, max(share, 0.0), left))
    value, error, share, tail = np.array(found).T
    return Predicted(value / n, error / n, "energies of shared strata", share, tail / n)


def is_array(law: Law) -> bool:
    """Whether points are an orthogonal array in several dims, moved or shifted or not."""
    array, _ = unmoved(law)
    if not isinstance(array, PairedAxes) or array.latin or array.dims == 1:
        return False
    return len(set(array.strata)) == 1 and len(set(array.parts)) == 1


def _factor(relation: Relation, part: str, strata: int, parts: int) -> float:
    """What a pair of points leaves of a part of g along one axis."""
    if part == _MEAN:
        return 1.0
    if relation == "apart":
        return -1.0 / (strata - 1) if part == _BETWEEN else 0.0
    if part == _BETWEEN:
        return 1.0
    return -1.0 / (parts - 1) if relation == "mates" and parts > 1 else 0.0


def _weight(law: PairedAxes, along: Sequence[str]) -> float:
    """λ of a part of g along each axis."""
    s, m = law.strata[0], law.parts[0]
    return law.n * sum(
        p.share * math.prod(_factor(r, a, s, m) for r, a in zip(p.axes, along, strict=True))
        for p in law.patterns
    )


def _weights(law: PairedAxes, parts: tuple[str, ...]) -> Array:
    """λ of parts of g along some axes, of all choices of axes."""
    found = []
    for axes in itertools.permutations(range(law.dims), len(parts)):
        along = [_MEAN] * law.dims
        for axis, part in zip(axes, parts, strict=True):
            along[axis] = part
        found.append(_weight(law, along))
    return np.array(found or [0.0])


@final
@dataclass(frozen=True)
class _Sums:
    """What is known of a sum of functions of single axes and of products of these.

    Attributes
    ----------
    single
        Energies of single axes: left in parts, between parts, between strata; (1 + groups, 3).
    means
        Those of the factors h_ri, (dims, products).
    covariances
        Of the factors: of their values, their means over parts, and over strata; (dims, 3, products, products).
    """

    single: Array
    means: Array
    covariances: Array


def _of_products(law: PairedAxes, sums: _Sums) -> float:
    """n times the variance of a sum of products, without single axes."""
    s, m = law.strata[0], law.parts[0]
    whole, parts, strata = np.moveaxis(sums.covariances, 1, 0)
    kept = {"self": whole, "apart": -strata / (s - 1), "same": strata}
    kept["mates"] = (m * strata - parts) / max(m - 1, 1)
    squares = sums.means[:, :, None] * sums.means[:, None, :]
    pairs = [(1.0, ("self",) * law.dims)] + [(law.n * p.share, p.axes) for p in law.patterns]
    total = 0.0
    for weight, along in pairs:
        left = np.stack([kept[r][axis] for axis, r in enumerate(along)])
        product = np.prod(squares + left, axis=0) - np.prod(squares, axis=0)
        for axis in range(law.dims):
            product = product - left[axis] * np.prod(np.delete(squares, axis, axis=0), axis=0)
        total += weight * float(product.sum())
    return total


def _energies(
    p: Parts, channel: int, s: int, parts: int, offsets: Sequence[Sequence[float]], known: Known
) -> tuple[_Sums, Array]:
    """Energies of single axes and of sums of products, and what g has beside the latter.

    That is (replicates, 4): the energy of several axes, and those in the order of `_MULTIPLES`.
    """
    singles, means, covariances = np.zeros((len(p.main[0]), 3)), list[Array](), list[Array]()
    own, centers = len(p.main[0]), list[Array]()
    for curves, main, factors, places in zip(p.axes, p.main, p.factors, offsets, strict=True):
        both = np.concatenate([main, factors])
        # All of the energy, in cells so fine that they lose none; means over parts and strata are exact
        values = curves.cells(both, _SETTINGS.finest if len(curves.knots) > 2 else _SETTINGS.fine)
        mean = values.mean(axis=-1)
        values = values - mean[:, None]
        whole = (values[:own] ** 2).mean(axis=-1)
        products = np.zeros((3, len(factors), len(factors)))
        products[0] = values[own:] @ values[own:].T / values.shape[-1]
        for place in places:
            fine = curves.cells(both, s * parts, place) - mean[:, None]
            coarse = fine.reshape(len(fine), s, -1).mean(axis=-1)
            among, between = ((v[:own] ** 2).mean(axis=-1) for v in (fine, coarse))
            singles += np.stack([whole - among, among - between, between], axis=-1) / len(places)
            for k, v in ((1, fine), (2, coarse)):
                products[k] += v[own:] @ v[own:].T / v.shape[-1] / len(places)
        means.append(mean[own:])
        centers.append(mean[:1])
        covariances.append(products)
    sums = _Sums(singles, np.array(means), np.array(covariances))

    g, d = known.g, known.g.dims
    others = np.stack([np.prod(np.delete(sums.means, i, axis=0), axis=0) for i in range(d)])

    def left(x: Array) -> Array:
        """g less its single axes, and the sum of products less its own: (2, …)."""
        flat = x.reshape(-1, d)
        alone, products, single = np.zeros(len(flat)), np.ones(1), np.zeros(1)
        for i, (axis, main, factors) in enumerate(zip(p.axes, p.main, p.factors, strict=True)):
            values = axis.at(np.concatenate([main[:1] - centers[i], factors]), flat[:, i])
            alone += values[0]
            products = products * values[1:]
            single = single + others[i] @ (values[1:] - sums.means[i][:, None])
        fit = np.sum(products, axis=0) - single
        mine = values_at(g, flat)[:, channel] - alone
        return np.stack([mine, fit]).reshape(2, *x.shape[:-1])

    more = np.zeros((_SETTINGS.replicates, 1 + len(_MULTIPLES)))
    for k, (name, along) in enumerate(_MULTIPLES.items()):
        if len(along) > d or (name == "parts" and parts == 1):
            continue
        u = net(2 * d + 2, _SETTINGS.pairs[k], _SETTINGS.replicates, 8 + k)
        x, other, choice = u[..., :d], u[..., d : 2 * d], u[..., 2 * d :]
        axes = list(itertools.permutations(range(d), len(along)))
        chosen = np.array(axes)[(choice[..., 0] * len(axes)).astype(int)]
        begins = (choice[..., 1] * len(offsets[0])).astype(int)
        for which, kind in zip(np.moveaxis(chosen, -1, 0), along, strict=True):
            cells = s * parts if kind == _AMONG else s
            corner = np.array([list(each) for each in offsets])[which, begins]
            there = np.take_along_axis(x, which[..., None], -1)[..., 0]
            mine = np.take_along_axis(other, which[..., None], -1)[..., 0]
            cell = np.minimum(np.floor(((there - corner) % 1.0) * cells), cells - 1)
            new = np.minimum(((cell + mine) / cells + corner) % 1.0, BELOW_ONE)
            np.put_along_axis(other, which[..., None], new[..., None], -1)
        one, two = left(x), left(other)
        middle = 0.5 * (one + two).mean(axis=(1, 2), keepdims=True)
        one, two = one - middle, two - middle
        # A mean over choices of axes in order; of two different parts their order counts
        many = math.comb(d, len(along)) * (2 if name == "parts" else 1)
        product, square = one * two, 0.5 * (one**2 + two**2)
        more[:, 1 + k] = many * (product[0] - product[1]).mean(axis=-1)
        if k == 0:
            more[:, 0] = (square[0] - square[1]).mean(axis=-1)
    # Less the energies of fewer axes, and of strata where parts are shared, which they contain
    more[:, 2] -= 2.0 * more[:, 1] if parts > 1 and d > 1 else 0.0
    more[:, 3] -= (d - 2) * more[:, 1] if d > 2 else 0.0
    return sums, more
