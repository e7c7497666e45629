"""Variances of orthogonal arrays, from energies of an integrand within and between strata.

Along each axis, g is a sum of four components: its mean, the differences between strata (β),
the differences between the parts of a stratum (δ), and the remainder within these parts.
`PairedAxes` states whether two points share a stratum on an axis, or a part of a stratum.
For a component h of g and a pair of points x and x', consider the product h(x) h(x').
The mean of the product h(x) h(x') is the energy of h, multiplied by a factor.
Here are the factors of the four components, for s strata with m parts in each stratum:

    (1, −1/(s−1), 0, 0)     if the points are in different strata,
    (1, 1, 0, 0)            if the points are independent in the same stratum,
    (1, 1, −1/(m−1), 0)     if the points are in different parts of the same stratum.

Let E_u be the energy of the product of components of g: component u_i along each axis i. Then

    n Var = Σ_u (1 + λ_u) E_u,    λ_u = n Σ_p share_p Π_i factor_p,i(u_i),

Here p runs over groups of pairs of points whose strata agree on the same axes.
For arrays of strength 2, λ_u = −1 if u varies only between strata, along one or two axes.
If each part of a stratum has one point, differences between parts along one axis also have λ = −1.
Components of g with λ_u = −1 add no variance to the estimate [Owen1992]_.
If u varies along more axes, λ_u decreases with powers of 1/s.

The fit of `mcspectra.prediction.subsets` adds functions of single axes and their products.
The variance of this fit is computed without sampling.
The variance of g minus the fit is estimated from random pairs of points.
The two points of a pair share strata of two or three axes.
First, functions of single axes are subtracted from g and from the fit.
The estimate is the mean product of g at two points, minus the mean product of the fit.
Energies of g minus the fit along more than three axes are unknown, and widen the interval.
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
from mcspectra.prediction.subsets import SUBSET_SETTINGS, AnovaModel, all_parts, net, offsets_within
from mcspectra.samplers.law import Law, PairedAxes, Relation, Shifted, unmoved

__all__ = ["PairedSettings", "evaluations", "is_array", "of_arrays"]

_MEAN, _BETWEEN, _AMONG = "mean", "between strata", "between parts"
_MULTIPLES = {"two": (_BETWEEN,) * 2, "parts": (_BETWEEN, _AMONG), "three": (_BETWEEN,) * 3}
"""Components of g along 2 or 3 axes whose energies are estimated. All others are bounded."""


@final
@dataclass(frozen=True, kw_only=True)
class PairedSettings:
    """Number of pairs of points for the energies of several axes.

    Attributes
    ----------
    pairs
        Number of pairs of points in each replicate, for each of the three entries of `_MULTIPLES`.
        Halving or doubling the numbers of pairs changes variances by less than 0.5 %.
        The changes were measured with orthogonal-array | shift in 4-D at n = 289.
        The intervals are ±0.9 % for a Gaussian, ±2.1 % for a ball and ±0.5 % for a kink.
    replicates
        Number of independent scrambled nets that supply the pairs of points.
        The spread of the energies over the nets gives the interval, with 15 degrees of freedom.
    """

    pairs: tuple[int, int, int] = (1 << 16, 1 << 13, 1 << 13)
    replicates: int = 16


_SETTINGS = PairedSettings()


def of_arrays(law: Law, known: Known, stream: Stream) -> Predicted:  # noqa: ARG001
    """Predict the variance of an orthogonal array of strength 2, possibly moved or shifted.

    Raises
    ------
    NoClosedForm
        If the points are not an orthogonal array, or the array does not treat all axes alike.
    """
    array, by = unmoved(law)
    if not (is_array(law) and isinstance(array, PairedAxes)):
        raise NoClosedForm(f"{law.name} is not an orthogonal array that treats all axes alike.")
    n, s = law.n, array.strata[0]
    parts = array.parts[0] if any("mates" in p.axes for p in array.patterns) else 1
    offsets = offsets_within(1.0 / s, by, uniform=isinstance(law, Shifted))
    one, part, two, both, three = (
        _weight(array, along) for along in ((_BETWEEN,), (_AMONG,), *_MULTIPLES.values())
    )
    # Energies E_u of three or more axes are mostly not estimated. Find the largest of their |λ_u|
    rest = max(
        abs(_weight(array, (_BETWEEN,) * k + (_AMONG,) * (axes - k)))
        for axes in range(3, max(law.dims, 3) + 1)
        for k in range(axes + 1)
        if (axes, k) != (3, 3)
    )

    found = []
    for c, p in enumerate(known.once("subsets: parts", lambda: all_parts(known))):
        at = None if isinstance(law, Shifted) else offsets
        sums, more = known.once(
            ("arrays", c, s, parts, at),
            functools.partial(_energies, p, c, s, parts, offsets, known),
        )
        # Add three variances: of functions of single axes, of products, and of g minus the fit.
        # For functions of single axes, the variance is estimated from all profiles of g.
        # Estimates from separate groups of profiles give the error of the variance
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


def evaluations() -> float:
    """Return the number of evaluations of g for one prediction, except evaluations for the fit."""
    return float(2 * sum(_SETTINGS.pairs) * _SETTINGS.replicates)


def is_array(law: Law) -> bool:
    """Return whether points are an orthogonal array in several dims that treats all axes alike.

    All points of the orthogonal array may be shifted by the same fixed or random vector.
    """
    array, _ = unmoved(law)
    if not isinstance(array, PairedAxes) or array.latin or array.dims == 1:
        return False
    # If the axes are permuted, the share of pairs that agree on these axes must not change
    shares: dict[tuple[Relation, ...], list[float]] = {}
    for pattern in array.patterns:
        shares.setdefault(tuple(sorted(pattern.axes)), []).append(pattern.share)
    for relations, own in shares.items():
        several = math.factorial(array.dims) // math.prod(
            math.factorial(relations.count(each)) for each in set(relations)
        )
        if len(own) != several or max(own) - min(own) > 1e-12:
            return False
    return len(set(array.strata)) == 1 and len(set(array.parts)) == 1


def _factor(relation: Relation, part: str, strata: int, parts: int) -> float:
    """Return the mean product of a component of g at two points, divided by its energy.

    The table at the top of this module lists the result for each component and pair of points.
    """
    if part == _MEAN:
        return 1.0
    if relation == "apart":
        return -1.0 / (strata - 1) if part == _BETWEEN else 0.0
    if part == _BETWEEN:
        return 1.0
    return -1.0 / (parts - 1) if relation == "mates" and parts > 1 else 0.0


def _weight(law: PairedAxes, along: Sequence[str]) -> float:
    """Return λ_u for the given components of g along the first axes and means along the others.

    The result is 0 if more components are given than there are axes.
    """
    s, m, missing = law.strata[0], law.parts[0], law.dims - len(along)
    if missing < 0:
        return 0.0
    parts = (*along, *(_MEAN,) * missing)
    return law.n * sum(
        p.share * math.prod(_factor(r, a, s, m) for r, a in zip(p.axes, parts, strict=True))
        for p in law.patterns
    )


@final
@dataclass(frozen=True)
class _Sums:
    """Energies of functions of one axis, and moments of the functions h_ri of the products.

    Attributes
    ----------
    single
        Energies of g within the parts of strata, between parts, and between strata.
        The energies are summed over the axes. The shape is (1 + groups, 3).
        Row 0 uses all profiles of g together, and every other row uses the profiles of one group.
    means
        Means of the functions h_ri, as an array of shape (dims, products).
    covariances
        Covariances of the functions h_ri, of their means over parts, and of means over strata.
        These three covariances form an array of shape (dims, 3, products, products).
    """

    single: Array
    means: Array
    covariances: Array


def _of_products(law: PairedAxes, sums: _Sums) -> float:
    """Return n times the variance of a sum of products, minus its projection on single axes."""
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


def _of_fine_cells(p: AnovaModel) -> list[tuple[Array, Array, Array]]:
    """Return means of the curves, energies of g_i and covariances of the factors, of each axis.

    The cells are so fine that means over cells keep nearly all energy of the curves.
    Means over strata and over parts of strata are exact: both are larger than the fine cells.
    """
    found, own = list[tuple[Array, Array, Array]](), len(p.main[0])
    for curves, main, factors in zip(p.axes, p.main, p.factors, strict=True):
        jumps = len(curves.knots) > 2
        count = SUBSET_SETTINGS.finest if jumps else SUBSET_SETTINGS.fine
        values = curves.cells(np.concatenate([main, factors]), count)
        mean = values.mean(axis=-1)
        values = values - mean[:, None]
        inner = values[own:] @ values[own:].T / values.shape[-1]
        found.append((mean, (values[:own] ** 2).mean(axis=-1), inner))
    return found


def _energies(
    p: AnovaModel,
    channel: int,
    s: int,
    parts: int,
    offsets: Sequence[Sequence[float]],
    known: Known,
) -> tuple[_Sums, Array]:
    """Return the energies and moments of the fitted function, and the energies of g minus the fit.

    The energies of g minus the fit have shape (replicates, 4).
    Column 0 is the energy of all functions of several axes.
    Columns 1 to 3 are the energies of the three kinds of components that `_MULTIPLES` lists.
    """
    singles, means, covariances = np.zeros((len(p.main[0]), 3)), list[Array](), list[Array]()
    own, centers = len(p.main[0]), list[Array]()
    fine_cells = known.once(("arrays: fine cells", channel), lambda: _of_fine_cells(p))
    for curves, main, factors, places, (mean, whole, inner) in zip(
        p.axes, p.main, p.factors, offsets, fine_cells, strict=True
    ):
        both = np.concatenate([main, factors])
        products = np.zeros((3, len(factors), len(factors)))
        products[0] = inner
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
        """Return g and the sum of products, each minus its functions of single axes: (2, …)."""
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
        # For all kinds of strata, the first points of the pairs are the same
        one, two = (
            known.once(("arrays: first", channel, k), functools.partial(left, x)),
            left(other),
        )
        middle = 0.5 * (one + two).mean(axis=(1, 2), keepdims=True)
        one, two = one - middle, two - middle
        # Axes are chosen at random for each pair of points, so multiply by the number of choices.
        # If points share a stratum on one axis and a part of a stratum on another, order matters:
        # the axes (i, j) and (j, i) are different choices, so each pair of axes counts twice
        many = math.comb(d, len(along)) * (2 if name == "parts" else 1)
        product, square = one * two, 0.5 * (one**2 + two**2)
        more[:, 1 + k] = many * (product[0] - product[1]).mean(axis=-1)
        if k == 0:
            more[:, 0] = (square[0] - square[1]).mean(axis=-1)
    # Subtract pairs of points that were counted twice.
    # Points in the same part of a stratum are also in the same stratum.
    # Points that share three strata also share two strata
    more[:, 2] -= 2.0 * more[:, 1] if parts > 1 and d > 1 else 0.0
    more[:, 3] -= (d - 2) * more[:, 1] if d > 2 else 0.0
    return sums, more
