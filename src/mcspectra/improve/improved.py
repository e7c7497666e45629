"""Changes of an estimator that are fitted to evaluations of its integrand g.

The changes are new densities, control variates, rotations and means along an axis.

All changes apply to the primary-space integrand g on the unit cube.
Therefore every change can be used with any estimator of one technique.
The changes of the following kinds keep the integral, whatever the evaluations of g are:

* *fitted*: g(T(u))/q(T(u)) with uniform u. The density q consists of splines (`learned`).
  Another choice of q is a normal density of z = Φ⁻¹(u) with the moments of |g|.
* *order*: g(T(u)), where T rotates z by an orthogonal matrix; there is no density q.
  After the rotation, g varies most along the first coordinates of z ([Liu2023]_).
  The rotation helps because nets sample their first coordinates best;
* *regression*: g minus fitted polynomials of mean 0;
* *preintegrated*: g is averaged along lines in the first direction.
  It is assumed that g jumps or becomes nonzero at one point of each line.
  A bracket, which is a short interval around this point, divides the line into three intervals.
  One or two samples are taken in each interval: before the bracket, in the bracket and after it.
  The position of the bracket depends only on coordinates that are constant along the line.
  Therefore the samples of a line, weighted by the lengths of their intervals, are unbiased.

`Cubic` needs no pilot: it subtracts polynomials from g.
These polynomials go through the values of g at the centers of cells.
`Periodized` substitutes the variables, so that g is constant at the border and periodic.
For the substitution, only a constant close to the integral has to be known.

The expected gain of a change is computed from evaluations that were not used in its fit.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import ClassVar, TypeAlias, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.densities import Density
from mcspectra.estimators import AbstractEstimator, Estimator
from mcspectra.improve.answers import Candidate
from mcspectra.improve.learned import LearnSettings, fit_splines, in_rounds
from mcspectra.integrands import integral_accuracy
from mcspectra.integrands.base import Breaks, Derived, Estimate, Integrand
from mcspectra.measure.setup import Setup

__all__ = [
    "CHANGES",
    "ChangeSettings",
    "Cubic",
    "Evaluations",
    "Periodized",
    "RegressionSettings",
    "evaluated",
    "improvements",
]


@final
@dataclass(frozen=True)
class ChangeSettings:
    """Settings of changed estimators, and of the densities that are fitted to g."""

    # Number of rounds of a pilot whose points follow g.
    # With two instead of four rounds, a narrow peak in 3-D has several times the variance.
    # Eight rounds of the pilot give no less variance than four (`benchmarks improvements`).
    rounds: int = 4
    # Triples of settings with which `fit_splines` fits joint densities and products of 1-D ones.
    # The first number of each triple is the number of cells along each axis.
    # The second number of each triple is the number of densities in a mixture; 0 means a flow.
    # The third number of each triple is the weight of the penalty on roughness.
    # After each round, the first joint density is fitted, to place the points of the next round.
    # Without the flow, the variance of a ridge across two axes is 17 times as large.
    # Without the product of densities with 24 cells per axis, the fit of a narrow peak is worse.
    # If the joint mixture of 4 densities is left out, results do not change.
    joint: tuple[tuple[int, int, float], ...] = ((16, 0, 1e-4), (12, 4, 1e-3))
    products: tuple[tuple[int, int, float], ...] = ((12, 1, 1e-3), (24, 1, 1e-4))
    # Maximum number of dims in which joint densities are tried.
    # A flow (a learned map) with 16 cells per axis has about 36 d² weights in d dims.
    # In 5-D the number of weights is a fifth of the number of evaluations in the largest pilot.
    most_joint_dims: int = 5
    # Share of the uniform density in a fitted density q. It limits |g|/q to 20 |g|.
    # A larger share of the uniform density adds variance:
    # With a uniform share of 0.025, a ridge function keeps 0.6 % of its variance.
    # With a uniform share of 0.05, the ridge function keeps 1.1 %, and with 0.1 it keeps 2.2 %.
    defensive: float = 0.05
    # Least variance of a fitted normal density along any direction.
    # The normal numbers z of uniform points u have variance 1.
    # With a variance below 1, the density q of u would be 0 at the border of the cube,
    # and g/q would grow without bound toward the border.
    least_spread: float = 1.0
    # Settings of the fits of spline densities to |g|
    splines: LearnSettings = field(default_factory=LearnSettings)
    # A change is yielded if less than this fraction of the variance remains after the change.
    # The variance after the change is estimated from a pilot. The cost of the change is ignored.
    # In the smallest pilot, the estimated fraction has a standard error of √(2/64) = 18 %.
    # If the estimated fraction is above 0.8, the true fraction may therefore be above 1.
    most_left: float = 0.8
    # Number of points that are evaluated at once. A table of 256 polynomials then takes 32 MB.
    # Results do not depend on this number.
    block: int = 2**14


@final
@dataclass(frozen=True)
class RegressionSettings:
    """Settings of regressions of g on polynomials."""

    # Least number of evaluations for each coefficient.
    # With k evaluations, a fit of p coefficients multiplies the remaining variance by 1 + p/k.
    # With 4 evaluations for each coefficient, the factor 1 + p/k is at most 1.25.
    # With 2 or 8 evaluations for each coefficient, results do not change.
    # The results are from four problems of `benchmarks improvements`.
    evaluations_per_term: int = 4
    # With k evaluations, regularization adds k times this number to diagonals of normal equations.
    # Without regularization, the diagonal is near k, because basis functions have mean square 1.
    # Results are the same to three digits for values from 1e-12 to 1e-4.
    ridge: float = 1e-9
    # Maximum number of polynomials in a regression, which limits the cost of an evaluation.
    # With 128 and 512 polynomials, results are the same.
    most_terms: int = 256
    # Pairs of largest degrees of the polynomials that are tried as a regression of g.
    # The first number of each pair is the largest degree of polynomials of one coordinate.
    # The second number of each pair is the largest total degree of products of two coordinates.
    # The best pair of degrees is chosen by evaluations that were not used in the fits.
    degrees: tuple[tuple[int, int], ...] = (
        (1, 0),
        (2, 2),
        (3, 0),
        (3, 3),
        (4, 4),
        (6, 0),
        (6, 6),
        (8, 8),
    )
    # Highest degree of Hermite polynomials. Higher degrees have most of their variance in tails.
    # For example, half of E z⁸ comes from |z| > 2.9, a region of probability 0.004.
    most_normal_degree: int = 3
    # Number of leading directions of z for which separate bases are tried.
    # A basis over fewer directions reaches higher degrees with the same number of terms.
    # With bases over one direction only, the remaining variance of a ridge is 1.6 times as large.
    # With four directions, the remaining variance of an Asian option in 16-D is 1.1 times as large.
    turned: int = 2


_SETTINGS = ChangeSettings()
_REGRESSION = RegressionSettings()


@final
@dataclass(frozen=True)
class Evaluations:
    """Evaluations of g at points of the unit cube.

    Attributes
    ----------
    points, values
        Points (k, d) in the unit cube, and values (k, channels or 1).
    pdf
        Density of the points, (k,); the density is 1 for uniform points and for scrambled nets.
    """

    points: Array
    values: Array
    pdf: Array

    @staticmethod
    def of(points: Array, values: Array) -> Evaluations:
        """Return evaluations with values (k,) or (k, channels) at uniform points."""
        return Evaluations(points, values.reshape(len(points), -1), np.ones(len(points)))

    def part(self, which: Array) -> Evaluations:
        """Return the evaluations that a mask selects."""
        return Evaluations(self.points[which], self.values[which], self.pdf[which])

    @cached_property
    def halves(self) -> tuple[Evaluations, Evaluations]:
        """Two halves of the evaluations: those with odd index, and those with even index."""
        odd = np.arange(len(self.points)) % 2 == 1
        return self.part(odd), self.part(~odd)

    @cached_property
    def normal(self) -> Array:
        """Points z = Φ⁻¹(u), the inverse normal cdf of each coordinate of the points u."""
        return _quantiles(self.points)

    def turned(self, matrix: Array) -> Evaluations:
        """Return evaluations of the rotated integrand g(T(u)), where `matrix` is the rotation of T.

        The inverse rotation is applied to the points, and the values stay the same.
        """
        return replace(self, points=_Normal(matrix.T).sample(self.points))

    @cached_property
    def directions(self) -> Array:
        """Return orthonormal directions of z (columns); g varies most along the first one."""
        d = self.points.shape[1]
        basis = _Basis.of(d, True, 2, 2).cut(len(self.points))
        slopes = np.zeros((d, d))
        for coefficients in basis.fit(self).T:
            (i, j), (a, b) = basis.axes.T, basis.degrees.T
            linear = np.zeros(d)
            linear[i[(a == 1) & (b == 0)]] = coefficients[(a == 1) & (b == 0)]
            bend = np.zeros((d, d))
            bend[i[a == 2], i[a == 2]] = np.sqrt(2.0) * coefficients[a == 2]
            bend[i[b == 1], j[b == 1]] = bend[j[b == 1], i[b == 1]] = coefficients[b == 1]
            slopes += np.outer(linear, linear) + bend @ bend
        return np.asarray(np.linalg.eigh(slopes)[1][:, ::-1])

    @cached_property
    def weights(self) -> Array:
        """|g| over the density, of sum 1; a lower power of |g| if few points dominate the sum."""
        size = np.abs(self.values).sum(axis=1)
        if not size.any():
            raise ParameterError("g is 0 at all tested points; give a larger budget.")
        size = size / size.max()
        least = min(0.1 * np.count_nonzero(size), 10.0 + 2.0 * self.points.shape[1])
        for power in 0.5 ** np.arange(8):
            found = np.where(size > 0.0, size**power, 0.0) / self.pdf
            found /= found.sum()
            if 1.0 / (found**2).sum() >= least:
                break
        return np.asarray(found)

    def variance(self, pdf: Array | None = None) -> float:
        """Estimate the variance of g/q at points with density q, which is uniform by default.

        The mean of g/q is estimated by a ratio of weighted sums.
        The variance is the mean square deviation from the estimated mean.
        Deviations from the mean avoid cancellation if g/q is almost constant.
        """
        q = np.ones(len(self.pdf)) if pdf is None else pdf
        weight, values = q / self.pdf, self.values / q[:, None]
        rest = values - np.average(values, axis=0, weights=weight)
        return float(np.average((rest**2).sum(axis=1), weights=weight))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Changed(Derived):
    """A changed integrand g with the same integral."""

    integrand: Integrand
    pilot_evaluations: int = 0

    @property
    def finite_below(self) -> float:
        """See `mcspectra.improve.answers.Candidate`."""
        return 0.5

    @property
    def breaks(self) -> Breaks:
        return ((),) * self.dims

    def _evaluate(self, x: Array) -> Array:
        flat, shape = x.reshape(-1, self.dims), x.shape[:-1]
        block = _SETTINGS.block
        blocks = [self._at(flat[i : i + block]) for i in range(0, len(flat), block)]
        found = np.concatenate(blocks) if blocks else self.integrand(flat)
        return found.reshape(*shape, *found.shape[1:])

    def _estimated_integral(self) -> Estimate:
        source, error = integral_accuracy(self.integrand)
        return Estimate(np.atleast_1d(self.integrand.integral), error, source)

    @abstractmethod
    def _at(self, u: Array) -> Array:
        """Return values at points (k, d)."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class _Warped(_Changed):
    """g(T(u))/q(T(u))."""

    name: ClassVar[str] = "warped"
    text = "{0.integrand.spec}, {0.label}"
    density: Density | _Normal
    label: str

    @property
    def finite_below(self) -> float:
        if not isinstance(self.density, _Normal):
            return 0.5
        # Along the direction of the largest standard deviation s, q grows as t^−(1 − 1/s²)
        return 1.0 - 0.5 / float(np.linalg.norm(self.density.matrix, 2) ** 2)

    def _at(self, u: Array) -> Array:
        x = self.density.sample(u)
        values = self.integrand(x)
        return np.asarray((values.T / self.density.pdf(x)).T)


@final
@dataclass(frozen=True, eq=False)
class _Normal:
    """The map of the cube that corresponds to z → A z + b with z = Φ⁻¹(u)."""

    matrix: Array
    shift: Array | float = 0.0

    def sample(self, u: Array) -> Array:
        from scipy.special import ndtr

        x = ndtr(_quantiles(u) @ self.matrix.T + self.shift)
        return np.clip(x, np.finfo(float).tiny, BELOW_ONE)

    def pdf(self, x: Array) -> Array:
        moved = _quantiles(x)
        z = (moved - self.shift) @ self._inverse.T
        log = 0.5 * ((moved**2).sum(axis=-1) - (z**2).sum(axis=-1))
        return np.asarray(np.exp(log) * abs(np.linalg.det(self._inverse)))

    @cached_property
    def _inverse(self) -> Array:
        return np.linalg.inv(self.matrix)


_Map: TypeAlias = Density | _Normal


@final
@dataclass(frozen=True)
class _Basis:
    """Products of one or two orthonormal polynomials of different coordinates, each with mean 0.

    Attributes
    ----------
    normal
        Whether polynomials are Hermite polynomials of z = Φ⁻¹(u).
        Otherwise, polynomials are Legendre polynomials of u, or of Φ applied to directions of z.
    axes, degrees
        The two coordinates and the two degrees of each product, (terms, 2).
    turn
        Directions of z that replace the coordinates, one direction per column, (d, ·).
    """

    normal: bool
    axes: Array
    degrees: Array
    turn: Array | None = None

    @staticmethod
    def of(dims: int, normal: bool, alone: int, together: int) -> _Basis:
        """Make polynomials of one coordinate, and products of polynomials of two coordinates.

        The degree is at most `alone` for one coordinate, and at most `together` for a product.
        """
        terms = [(i, i, a, 0) for i in range(dims) for a in range(1, alone + 1)]
        terms += [
            (i, j, a, b)
            for i in range(dims)
            for j in range(i + 1, dims)
            for a in range(1, together)
            for b in range(1, together + 1 - a)
        ]
        found = np.array(terms)
        return _Basis(normal, found[:, :2], found[:, 2:])

    def cut(self, count: int) -> _Basis:
        """Return the basis, or only its linear terms if `count` evaluations are too few for all."""
        if len(self.axes) * _REGRESSION.evaluations_per_term <= count:
            return self
        linear = self.degrees.sum(axis=1) == 1
        return _Basis(self.normal, self.axes[linear], self.degrees[linear])

    def __call__(self, u: Array) -> Array:
        """Return the values of all terms at points (k, d), as (k, terms)."""
        from scipy.special import ndtr

        if self.turn is not None:
            x = _quantiles(u) @ self.turn
            x = x if self.normal else 2.0 * ndtr(x) - 1.0
        else:
            x = _quantiles(u) if self.normal else 2.0 * u - 1.0
        most = int(self.degrees.max())
        found = [np.ones_like(x), x]
        for n in range(1, most):
            if self.normal:
                found.append(x * found[n] - n * found[n - 1])
            else:
                found.append(((2 * n + 1) * x * found[n] - n * found[n - 1]) / (n + 1))
        degree = np.arange(most + 1.0)
        if self.normal:
            norm = np.cumprod(np.maximum(degree, 1.0)) ** -0.5
        else:
            norm = np.sqrt(2.0 * degree + 1.0)
        table = np.stack(found[: most + 1]) * norm[:, None, None]
        (i, j), (a, b) = self.axes.T, self.degrees.T
        return np.asarray(table[a, :, i] * table[b, :, j]).T

    def fit(self, seen: Evaluations) -> Array:
        """Return coefficients by least squares, (terms, channels)."""
        columns = np.column_stack([np.ones(len(seen.points)), self(seen.points)])
        ridge = _REGRESSION.ridge * len(columns)
        square = columns.T @ columns + ridge * np.eye(columns.shape[1])
        return np.asarray(np.linalg.solve(square, columns.T @ seen.values)[1:])

    def left(self, fitted: Evaluations, other: Evaluations) -> float:
        """Return the fraction of the variance that a fit leaves, measured by other evaluations."""
        rest = other.values - self(other.points) @ self.fit(fitted)
        return float(rest.var(axis=0).sum() / max(other.values.var(axis=0).sum(), 1e-300))


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class _Controlled(_Changed):
    """Integrand g minus a control variate of integral 0."""

    name: ClassVar[str] = "controlled"
    text = "{0.integrand.spec} less its regression on {0.basis.axes.shape[0]} polynomials"
    basis: _Basis
    coefficients: Array

    def _at(self, u: Array) -> Array:
        values = self.integrand(u)
        return np.asarray(values - (self.basis(u) @ self.coefficients).reshape(values.shape))


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Cubic(_Changed):
    """Integrand g minus a polynomial in each of side^d cells ([Chopin2024]_).

    The polynomial has degree r − 1 along each axis, and equals g at the centers of r^d cells.
    Along each axis, the r cells nearest to the given cell are used, so there are r^d cells.
    The mean of the polynomial over each cell is added again, so the integral does not change.
    If r is even, each point is averaged with its mirror image about the center of the cell.
    If r = 2, no polynomial is needed, because averages with mirror images cancel linear terms.
    Jittered points in the same cells have a variance ∝ n^(−1 − 2r/d) if g has r derivatives.

    Attributes
    ----------
    order
        The order r of cubic stratification.
    side
        Number of cells along each axis; 0 until `in_cells` sets it.
    centers
        Values of g at the centers, (side^d, channels or 1).
    """

    name: ClassVar[str] = "cubic"
    text = "{0.integrand.spec}, stratified to order {0.order} in cells of 1/{0.side}"
    order: int
    side: int = 0
    centers: Array | None = None

    @staticmethod
    def of(estimator: AbstractEstimator, order: int) -> Cubic:
        """Return cubic stratification for the g of an estimator with a single technique."""
        return Cubic(integrand=_single(estimator), order=order)

    @property
    def evaluations_per_point(self) -> int:
        return self.integrand.evaluations_per_point * (1 + (self.order % 2 == 0) + (self.order > 2))

    def in_cells(self, side: int) -> Cubic:
        """Return a copy with `side` cells along each axis, with g evaluated at centers of cells."""
        if side < self.order:
            raise ParameterError(
                f"{side} cells along an axis are too few for order {self.order}; give as many."
            )
        if self.order <= 2:
            return replace(self, side=side)
        grid = (np.indices((side,) * self.dims).reshape(self.dims, -1).T + 0.5) / side
        return replace(self, side=side, centers=self.integrand(grid).reshape(len(grid), -1))

    def _at(self, u: Array) -> Array:
        cell, places = np.minimum((u * self.side).astype(np.int64), self.side - 1), [u]
        if self.order % 2 == 0:
            image = (2 * cell + 1) / self.side - u
            places.append(np.clip(image, 0.0, BELOW_ONE))
        values = np.mean([self.integrand(x) for x in places], axis=0)
        if self.centers is None:
            return np.asarray(values)

        # Evaluate Lagrange polynomials with the nodes 0 … r − 1 of each axis at the points: (…, r).
        # Also compute the means of the Lagrange polynomials over cells
        nodes = np.arange(self.order)
        first = np.clip(cell - (self.order - 1) // 2, 0, self.side - self.order)

        def lagrange(x: Array) -> Array:
            others = ((m, np.delete(nodes, m)) for m in nodes)
            return np.stack([((x[..., None] - o) / (m - o)).prod(axis=-1) for m, o in others], -1)

        at, weights = np.polynomial.legendre.leggauss(self.order)
        means = lagrange((cell - first)[..., None] + 0.5 * at).swapaxes(-1, -2) @ (0.5 * weights)

        # Compute the weight of the value of g at each node, (k, r^d):
        # the product of the polynomials of all axes minus the product of their means
        stencil = np.indices((self.order,) * self.dims).reshape(self.dims, -1)
        axes = np.arange(self.dims)
        found = [lagrange(x * self.side - 0.5 - first) for x in places]
        products = [f[:, axes, stencil.T].prod(axis=-1) for f in (*found, means)]
        shares = np.mean(products[:-1], axis=0) - products[-1]
        place = np.ravel_multi_index(
            tuple(first.T[:, :, None] + stencil[:, None, :]), (self.side,) * self.dims
        )
        taken = np.einsum("kj,kjc->kc", shares, self.centers[place])
        return np.asarray(values - taken.reshape(values.shape))


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Periodized(_Changed):
    """Integrand c + (g(φ(u)) − c) Π φ'(u_i), which is periodic ([Sidi2006]_).

    At the border of the cube, this integrand equals the constant c.
    The derivative φ' of the substitution is proportional to sin(πu)^(k − 1).
    If g is smooth, the first k − 2 derivatives of the new integrand agree on opposite faces.
    With shifted lattices the variance is then ∝ n^(−2k), up to powers of log n.
    If k is odd, φ(u) − u is periodic. A smooth periodic g then stays smooth and periodic.
    If g grows as t^−a toward the border, the new integrand is c plus a term ∝ t^(k(1 − a) − 1).

    Attributes
    ----------
    order
        The number k.
        Without c, a constant g = 1 in d dims would get the variance (∫φ'²)^d − 1 at random points.
        The integral ∫φ'² is 1.50 for k = 3, 1.73 for k = 4 and 2.13 for k = 6.
    about
        The constant c, (channels or 1,).
        If c is close to the integral of g, a constant added to g hardly changes the variance.
    """

    name: ClassVar[str] = "periodized"
    text = "{0.integrand.spec}, periodized to order {0.order}"
    order: int
    about: Array

    @staticmethod
    def of(estimator: AbstractEstimator, order: int, seen: Evaluations | None = None) -> Periodized:
        """Return the periodic integrand for the g of an estimator with a single technique.

        The constant c is the mean of evaluations at uniform points.
        If no evaluations are given, c is the value of g at the center of the cube.
        """
        g = _single(estimator)
        if seen is not None:
            return Periodized(integrand=g, order=order, about=seen.values.mean(axis=0))
        center = g(np.full((1, g.dims), 0.5)).reshape(-1)
        about = np.where(np.isfinite(center), center, 0.0)
        return Periodized(integrand=g, order=order, about=about, pilot_evaluations=1)

    @property
    def finite_below(self) -> float:
        return 1.0 - 0.5 / self.order

    def _at(self, u: Array) -> Array:
        from scipy.special import beta, betainc

        # The substitution follows from the incomplete beta function at sin²(πu). It is computed
        # for u ≤ ½, where rounding errors are relative to φ, and by symmetry for u > ½
        k, sines = self.order, np.sin(math.pi * np.minimum(u, 1.0 - u))
        half = 0.5 * betainc(0.5 * k, 0.5, sines**2)
        x = np.clip(np.where(u <= 0.5, half, 1.0 - half), np.finfo(float).tiny, BELOW_ONE)
        slopes = (sines ** (k - 1) * (math.pi / beta(0.5 * k, 0.5))).prod(axis=1)
        values = self.integrand(x)
        apart = values.reshape(len(u), -1) - self.about
        return np.asarray((self.about + apart * slopes[:, None]).reshape(values.shape))


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class _Preintegrated(_Changed):
    """Integrand that replaces g by its mean along one axis.

    On each line along the axis, g is assumed to jump or to become nonzero at one point.
    The mean along a line is computed from separate samples on both sides of the jump.

    Attributes
    ----------
    axis
        The index of the axis along which means are taken.
    halvings
        Number of times that the interval in which g jumps (the bracket) is halved.
        After 7 halvings the bracket is 2^-7 of the axis, and it is sampled by one point.
        The sample in the bracket adds at most 2^-16 times the squared jump to the variance.
    """

    name: ClassVar[str] = "preintegrated"
    text = "{0.integrand.spec}, preintegrated along axis {0.axis}"
    axis: int
    halvings: int = 7

    @property
    def evaluations_per_point(self) -> int:
        return self.integrand.evaluations_per_point * (2 + self.halvings + 5)

    def _at(self, u: Array) -> Array:
        def g(t: Array) -> Array:
            x = u.copy()
            x[:, self.axis] = np.clip(t, 0.0, BELOW_ONE)
            return self.integrand(x).reshape(len(u), -1)

        # Keep the half in which g becomes nonzero, or else the half with the larger difference of g
        low = np.full(len(u), 2.0**-12)
        high = 1.0 - low
        at_low, at_high = g(low), g(high)
        for _ in range(self.halvings):
            middle = 0.5 * (low + high)
            found = g(middle)
            zero = [~values.any(axis=1) for values in (at_low, found, at_high)]
            below, above = (np.abs(found - end).sum(axis=1) for end in (at_low, at_high))
            right = np.where(zero[0] != zero[2], zero[1] == zero[0], above > below)
            low, high = np.where(right, middle, low), np.where(right, high, middle)
            at_low = np.where(right[:, None], found, at_low)
            at_high = np.where(right[:, None], at_high, found)

        t = u[:, self.axis]
        total = (high - low)[:, None] * g(low + (high - low) * t)
        for start, width in ((0.0 * low, low), (high, 1.0 - high)):
            pair = g(start + width * t) + g(start + width * (1.0 - t))
            total = total + 0.5 * width[:, None] * pair
        return np.asarray(total.reshape(-1, self.channels) if self.channels else total[:, 0])


_Found: TypeAlias = Iterator[tuple[str, str, _Changed, float]]
"""Changes: for each one its name, description, new integrand and remaining variance."""


def _fitted(
    g: Integrand, seen: Evaluations, settings: ChangeSettings, *, roughly: bool = False
) -> _Found:
    """Fit densities of two families, splines and normal densities, and yield the best of each.

    If `roughly` is true, only one density of splines is fitted.
    """
    joint = settings.joint if 1 < g.dims <= settings.most_joint_dims else ()
    splines = (*joint, *settings.products)[: 1 if roughly else None]
    families: list[tuple[str, str, list[Callable[[Evaluations], _Map]]]] = [
        (
            "splines",
            "sample by a density of splines fitted to the integrand",
            [partial(_splines, setting=s, settings=settings) for s in splines],
        ),
        (
            "normal density",
            "move and stretch the normal quantiles Φ⁻¹(u) of the inputs to large values of g",
            [
                partial(_normal, stretch=s, least_spread=settings.least_spread)
                for s in ("move", "axes", "all")
            ],
        ),
    ]
    both = seen.halves
    for label, change, candidates in families:
        scores = [
            sum(b.variance(fit(a).pdf(b.points)) for a, b in (both, both[::-1]))
            for fit in candidates
        ]
        best = int(np.argmin(scores))
        label, density = f"fitted {label}", candidates[best](seen)
        left = scores[best] / max(sum(half.variance() for half in both), 1e-300)
        yield label, change, _Warped(integrand=g, density=density, label=label), left


def _splines(seen: Evaluations, setting: tuple[int, int, float], settings: ChangeSettings) -> _Map:
    """Fit a density of splines to |g|, or to a lower power of |g| if few points dominate it."""
    size = (seen.weights * seen.pdf)[:, None]
    return fit_splines(
        seen.points,
        size,
        seen.pdf,
        setting,
        settings.defensive,
        np.random.default_rng(0),
        settings=settings.splines,
    )


def _normal(seen: Evaluations, stretch: str, least_spread: float) -> _Map:
    """Fit a normal density of z to |g|: its mean, and its variances or covariance if wanted."""
    z, weights = seen.normal, seen.weights
    d, effective = z.shape[1], 1.0 / float((weights**2).sum())
    mean = weights @ z
    # If points are few, shrink the means toward 0 and the variances toward 1.
    # For uniform points, z has mean 0 and variance 1
    size = float(mean @ mean)
    mean = mean * max(0.0, 1.0 - d / (effective * size)) if size > 0.0 else mean
    covariance = np.eye(d)
    if stretch != "move":
        found = (weights[:, None] * (z - mean)).T @ (z - mean)
        found = found if stretch == "all" else np.diag(np.diag(found))
        share = effective / (effective + (d if stretch == "all" else 1.0))
        covariance = share * found + (1.0 - share) * covariance
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, least_spread)) @ vectors.T
    return _Normal(root, mean)


def _regression(g: Integrand, seen: Evaluations, settings: ChangeSettings) -> _Found:  # noqa: ARG001
    """Fit regressions on several bases, and yield the one that leaves the least variance."""
    first, second = seen.halves
    d, own = seen.points.shape[1], _REGRESSION
    few = min(d, own.turned)
    most = min(len(first.points) // own.evaluations_per_term, own.most_terms)
    fits: list[Callable[[Evaluations], _Basis]] = []
    for normal in (False, True):
        for degrees in own.degrees:
            if normal and max(degrees) > own.most_normal_degree:
                continue
            basis, turned = _Basis.of(d, normal, *degrees), _Basis.of(few, normal, *degrees)
            if len(basis.axes) <= most:
                fits.append(lambda _, b=basis: b)  # type: ignore[misc]
            fits.append(lambda e, b=turned: replace(b, turn=e.directions[:, :few]))  # type: ignore[misc]
    halves = ((first, second), (second, first))
    lefts = [0.5 * sum(fit(a).left(a, b) for a, b in halves) for fit in fits]
    left, basis = min(lefts), fits[int(np.argmin(lefts))](seen)
    what = "coordinates" if basis.turn is None and not basis.normal else "normal quantiles Φ⁻¹(u)"
    yield (
        "regression",
        f"subtract the regression on {len(basis.axes)} polynomials of the {what}",
        _Controlled(integrand=g, basis=basis, coefficients=basis.fit(seen)),
        left,
    )


def _order(g: Integrand, seen: Evaluations, settings: ChangeSettings) -> _Found:  # noqa: ARG001
    """Rotate the coordinates, so that g varies most along the first ones."""
    d = g.dims
    if d == 1:
        raise ParameterError("One dim has no order.")
    first, second = seen.halves
    turn = first.directions
    basis = _Basis.of(d, True, 3, 0).cut(len(first.points))
    before, after = basis.left(first, second), basis.left(first.turned(turn), second.turned(turn))
    yield (
        "order by variation",
        "rotate the normal quantiles Φ⁻¹(u) of the inputs, the most important ones first",
        _turned(g, seen.directions),
        after / max(before, 1e-300),
    )


def _preintegrated(g: Integrand, seen: Evaluations, settings: ChangeSettings) -> _Found:  # noqa: ARG001
    """Take means along the best axis, and along the direction in which g varies most.

    The variance that remains after taking means along an axis lies between two bounds.
    The lower bound is the variance of a regression's terms without the coordinate of the axis.
    The upper bound is the variance without the main effect of the axis.
    The expected variance is the geometric mean of the two bounds.
    Squared coefficients are estimated by products of coefficients from two halves of the pilot.
    """
    d = g.dims
    if d == 1:
        raise ParameterError("In one dim a mean along it is the integral.")
    first, second = seen.halves
    turn = first.directions
    for normal, name, where in (
        (False, "preintegrated along axis {0}", "along axis {0}"),
        (
            True,
            "preintegrated along the active direction",
            "along the direction that g depends on most",
        ),
    ):
        halves = (first.turned(turn), second.turned(turn)) if normal else (first, second)
        basis = _Basis.of(d, normal, 3, 2).cut(len(first.points))
        squares = np.prod([basis.fit(half) for half in halves], axis=0).sum(axis=1)
        squares /= max(seen.variance(), 1e-300)
        without = [squares[~(basis.axes == i).any(axis=1)].sum() for i in range(d)]
        axis = 0 if normal else int(np.argmin(without))
        alone = squares[(basis.axes == axis).all(axis=1)].sum()
        unsure = 2.0 * np.sqrt(len(squares)) / len(first.points)
        inner = _turned(g, seen.directions) if normal else g
        yield (
            name.format(axis),
            (
                f"take means {where.format(axis)}, on both sides of where the integrand jumps or "
                "leaves 0"
            ),
            _Preintegrated(integrand=inner, axis=axis),
            float(np.sqrt(max(without[axis], unsure) * max(1.0 - alone, unsure))),
        )


CHANGES: dict[str, Callable[[Integrand, Evaluations, ChangeSettings], _Found]] = {
    "fitted": _fitted,
    "regression": _regression,
    "order": _order,
    "preintegrated": _preintegrated,
}
"""Kinds of change by name, each with the function that makes changes of this kind."""


def improvements(
    given: Setup,
    seen: Evaluations,
    kinds: Sequence[str] = tuple(CHANGES),
    *,
    charged: int = 0,
    settings: ChangeSettings = _SETTINGS,
) -> Iterator[Candidate]:
    """Yield changed estimators with the same integral, without new evaluations of g.

    Each change is yielded with the ratio of variances that is expected with random points.
    For *order*, main effects are excluded from the compared variances, because nets remove them.
    All ratios are computed from evaluations that were not used in the fit.

    Parameters
    ----------
    given
        A set-up whose estimator has a single technique.
    seen
        Evaluations of the set-up's `primary_integrand`; only ``fitted`` accepts non-uniform points.
    kinds
        Kinds of change to make. The names of all kinds are the keys of `CHANGES`.
    charged
        Number of pilot evaluations that are added to the cost of each change.
        Give 0 if the evaluations of the pilot were made for another purpose anyway.
    settings
        Settings of the fits.

    Raises
    ------
    ParameterError
        If the estimator has several techniques, or if evaluations are too few.
    """
    g = _single(given.estimator)
    if len(seen.points) < 2 * _REGRESSION.evaluations_per_term:
        raise ParameterError(f"{len(seen.points)} evaluations are too few to fit anything.")
    for kind in kinds:
        for name, change, changed, left in CHANGES[kind](g, seen, settings):
            if left < settings.most_left:
                own = replace(changed, pilot_evaluations=charged)
                cost = own.evaluations_per_point / g.evaluations_per_point
                setup = replace(given, estimator=Estimator(own))
                yield Candidate(
                    kind,
                    name,
                    change,
                    setup,
                    ratio=left * cost,
                    finite_below=own.finite_below,
                )


def evaluated(
    estimator: AbstractEstimator,
    count: int,
    stream: Stream,
    *,
    adapt: bool = False,
    settings: ChangeSettings = _SETTINGS,
) -> Evaluations:
    """Evaluate g at uniform points, or at points that follow fitted densities in rounds."""
    g = _single(estimator)
    rounds = settings.rounds if adapt else 1
    sizes = [count // rounds] * (rounds - 1) + [count - (rounds - 1) * (count // rounds)]

    def follow(points: Array, values: Array, pdf: Array) -> _Map | None:
        """Fit a density, or return None if all values of one half of the evaluations are zero.

        If the result is None, the next points are uniform.
        """
        seen = Evaluations(points, values, pdf)
        if not all(half.values.any() for half in seen.halves):
            return None
        best = min(_fitted(g, seen, settings, roughly=True), key=lambda found: found[3])[2]
        return best.density if isinstance(best, _Warped) else None

    return Evaluations(*in_rounds(g, g.dims, sizes, follow, stream))


def _turned(g: Integrand, directions: Array) -> _Warped:
    return _Warped(integrand=g, density=_Normal(directions), label="inputs turned")


def _single(estimator: AbstractEstimator) -> Integrand:
    if estimator.counts != (1,):
        raise ParameterError(
            f"{estimator.spec} has several samples per point; only estimators of one technique are "
            "changed."
        )
    return estimator.primary_integrand(0)


def _quantiles(u: Array) -> Array:
    """Return Φ⁻¹ of the points, without infinite values."""
    from scipy.special import ndtri

    return np.asarray(ndtri(np.clip(u, np.finfo(float).tiny, BELOW_ONE)))
