"""Exact variances of random and stratified sampling and of scrambled nets, by quadrature.

The formulas for strata and for nested uniform scrambling are in docs/theory.md:
see the sections "Exact variances of strata" and "Gains of scrambled nets".
Strata may have a common offset. The formulas for other samplers are:

* Digital shift in base 2, for coordinates that are multiples of 2^-L. The shift has L random bits.
  The shift also adds an offset δ from 0 to 2^-L, which is uniform and the same for all points.
  For given δ, the values of g on the grid have the Walsh spectrum ĝ_m(δ).
  The points have the Walsh coefficients ŝ_m = (1/n) Σ_k wal_m(x_k).
  For digital nets |ŝ_m|² is 1 on the dual net and 0 elsewhere.
  The variance of an estimate is a mean over δ, plus the variance of ĝ_0 over δ:

      Var = E_δ [Σ_{m ≠ 0} ĝ_m² ŝ_m²] + Var_δ ĝ_0.
* Latin hypercubes: along each axis, two points lie in two different strata out of n.
  Let ω² be the mean variance within n^d cells.
  Let σ²_v be the ANOVA variances of the cell means, one for each subset v of the axes.
  The variance is a weighted sum of ω² and all σ²_v:

      Var = (1/n) [ω² + Σ_{v ≠ ∅} (1 + (n − 1) (−1/(n − 1))^|v|) σ²_v],

  Subsets v of a single axis have weight 0 [Stein1987]_.
* Antithetic jittered [Haber1967]_: each cell has one jittered point u and its mirror image u'.
  The image u' is u reflected through the center of the cell.
  The function h(u) = (g(u) + g(u'))/2 replaces g.
* Mirrored: folded points sample the folded integrand.
  A set with all mirror images of n/2^d points samples ḡ, the average of g over reflections.
  Points that are reflected at random sample ḡ on average.
  If each point is uniform, random reflections add E[Var(g | point)]/n = (Var g − Var ḡ)/n.

Quadratures of two orders must agree with each other and with ∫g and ∫g² (`blindness`).
If the quadratures disagree, the method raises NoClosedForm.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array, as_real
from mcspectra.core.errors import MEASURE_IT, NoClosedForm, ParameterError
from mcspectra.core.ordered import weighted_sum
from mcspectra.core.streams import Stream
from mcspectra.core.tally import counting
from mcspectra.estimators import AbstractEstimator, as_subject
from mcspectra.estimators.mirrored import FoldedIntegrand, SymmetrizedIntegrand
from mcspectra.estimators.quadrature import (
    MOST_EVALUATIONS,
    Pointwise,
    Rule,
    beyond_points,
    blindness,
    constant,
    grid_values,
    in_closed_form,
    looked_at,
    moments,
    offset_rule,
    orders_of,
    square_integral,
    strata,
    stratum_moments,
)
from mcspectra.integrands import Integrand, integral_accuracy
from mcspectra.integrands._quadrature import gauss_rule
from mcspectra.prediction.known import Known
from mcspectra.prediction.separable import PiecewiseCurve, Separable, separated
from mcspectra.prediction.subsets import TORUS, of_subsets, pair_sums, pairs_of
from mcspectra.samplers import Sampler
from mcspectra.samplers.law import (
    AntitheticPair,
    Fixed,
    Folded,
    Independent,
    Law,
    Mirrored,
    Moved,
    PairedAxes,
    Scrambled,
    Shifted,
    Strata,
    unmoved,
)
from mcspectra.spectra.bases import hadamard
from mcspectra.spectra.gain import gains_at

__all__ = [
    "EXACT_TOLERANCE",
    "ExactSettings",
    "estimated_variance",
    "exact_variance",
    "level_variances",
    "of_curves",
    "of_integrand",
    "paired",
]

EXACT_TOLERANCE = 1e-6
"""Default for the largest relative error of an exact variance."""


@final
@dataclass(frozen=True)
class ExactSettings:
    """Settings for comparisons of quadratures, and for means of functions of one axis over cells.

    In comments, "the same results" means that variances change by at most 1e-9 in twelve cases.
    The cases are sums and products with jumps, kinks and poles, a wave, a disk and a ridge.
    Every case was measured with n = 64 and 1024 points.
    """

    # An error below this fraction of ∫g²/n is always small enough, for any tolerance.
    # Halving or doubling the negligible error gives the same results.
    negligible: float = 1e-9
    # The error of a quadrature is at most its difference from a lower order, times this factor.
    # At a jump, quadratures of both orders have errors of about the same size.
    # With the factor 1.5 instead of 3, a ridge-shaped g gets no second, finer quadrature.
    safety: float = 3.0
    # An error message suggests a larger tolerance if the relative error is below this value.
    offered: float = 0.5
    # Factor by which the second attempt raises the orders of the quadrature.
    # A second attempt is made if the error is at most `hope` times the tolerance.
    # With doubled instead of quadrupled orders, the variance for a ridge changes by 1e-5.
    finer: int = 4
    hope: float = 10.0
    # Least number of dims, and least tolerance, for fits by sums of products.
    # Fits by sums of products give functions of single axes with relative errors of 2e-3.
    # Halving or doubling the number of dims or the tolerance gives the same results.
    many_dims: int = 4
    loose: float = 1e-3
    # Largest number of binary digits of a coordinate. It limits the cells of digital shifts.
    most_bits: int = 24
    # Factor for the reported error of ∫h² next to a pole.
    # The factor changes the intervals of variances, but not the variances.
    doubt: float = 3.0
    # `rounding` is the relative rounding error of ∫g².
    # `exact` is the relative rounding error of a sum along an axis.
    rounding: float = 4e-15
    exact: float = 1e-9
    # Largest number of cells of an axis. For halton | shift and n = 1024,
    # half as many cells change the variance by 2e-4, and twice as many by 5e-5.
    # `most_pairs` limits the time: the number of pairs of points times d is at most this number.
    most_cells: int = 2**18
    most_pairs: float = 2.0**32
    # Number of quadrature nodes per cell, and a smaller number for more than 2^14 cells.
    # For a sum with poles, 3 instead of 6 nodes change the variance by 3e-6.
    # For a sum with poles, 12 instead of 6 nodes change the variance by 8e-11.
    many_nodes: int = 16
    few_nodes: int = 6
    deep: int = 14
    # Above the measured frequencies, the power is assumed to be the mean of the last octave.
    # `white` is the relative error of the power that is assumed above the measured frequencies.
    # The error of the power changes the intervals of variances, but not the variances.
    white: float = 0.02
    # Rounding error of the mean of a curve h over a set, as a fraction of √∫h².
    # Rounding error of the variance of means over sets, as a fraction of ∫h²/n.
    # Halving or doubling the rounding errors gives the same results.
    rounded_mean: float = 1e-15
    rounded_variance: float = 1e-15
    # Number of points evaluated at a time. The number has no effect on the result.
    at_once: int = 2**20
    # A variance within cells is treated as rounding below this fraction of ∫h².
    # Halving or doubling `nothing` gives the same results.
    nothing: float = 1e-12
    # Number of ranges of offsets next to a cusp. Each range is 8 times as long as the next one.
    # Half or twice as many ranges of offsets give the same results.
    cusps: int = 10
    # A set counts as a grid if n times each coordinate is this close to an integer.
    # Halving or doubling `even` gives the same results.
    even: float = 1e-6
    # Relative error of a product's variance if points are rounded to cells of 2^-15.
    # If the requested tolerance is smaller than this relative error, NoClosedForm is raised.
    rounded_points: float = 0.02


_SETTINGS = ExactSettings()


def exact_variance(
    estimator: Any,
    sampler: Sampler | str,
    n: int,
    *,
    dims: int | None = None,
    tolerance: float = EXACT_TOLERANCE,
    max_evaluations: int | None = None,
) -> Any:
    """Return the exact variance of an estimator, without sampling.

    Parameters
    ----------
    estimator, sampler, n
        Any estimator with one of the following samplers.
        The samplers random, jittered, regular and uniform-jitter are allowed.
        Random points and strata may have one of the randomizations shift, strata-shift and mirror.
        The samplers antithetic-jittered and latin-hypercube are also allowed.
        The sampler latin-hypercube may also have shift.
        Nets and sequences, such as sobol or halton, are allowed with the randomization owen.
        In base 2, the randomization digital-shift is also allowed.
        Latin hypercubes and nets need about n cells per side.
        The number of cells limits n to some thousands in 2-D and some tens in 3-D.
        Sums and products of functions of one axis work in any dims.
        For sums or products of functions of one axis, orthogonal arrays and shifted sets also work.
    dims
        Number of dims of a function, and of a spec without ``dims``.
        The default is the number of dims of the sampler, unless the sampler is a spec.
    tolerance
        Largest relative error of the variance, 1e-12 to 1.
        If f has undeclared jumps that are not across an axis, small tolerances are impossible.
        For random points and oblique or curved jumps, the least tolerance is 1e-3.
        For strata and oblique or curved jumps, the least tolerance is about 0.1.
        The message of the error gives a tolerance that is possible.
        If d is at least 4 and the tolerance at least 1e-3, f may be fitted by a sum of products.
        The factors of each product in the sum are functions of one axis.
        The fit is used if the 95 % interval of the variance is within the tolerance.
        Fits are available for latin-hypercube, nets with owen and sets with shift.
    max_evaluations
        Maximum number of evaluations of a user's function. More evaluations raise BudgetError.

    Returns
    -------
    float or ndarray
        The variance. It is an array (channels,) if f has several channels.
        The relative error is less than `tolerance`. The variance is infinite if ∫g² diverges.
        For integrands with a known integral, a variance at rounding level is exactly 0.

    Raises
    ------
    NoClosedForm
        If the variance is not known for this sampler, or the quadrature does not converge.
        Quadratures may not converge at discontinuities that are not axis-aligned.
        Oblique discontinuities do not matter if f has an integral in closed form.
        If g has the same value at all probe points, but is not declared constant.
    ParameterError
        If `tolerance` is not a number from 1e-12 to 1.

    Notes
    -----
    Undeclared jumps and poles of g across an axis are found along lines, and cut the cells.

    If ∫g has no closed form, the quadrature is compared with ∫g and ∫g² by other rules.
    Values of g at 2^17 probe points show whether the nodes of the quadrature miss a part of g.
    The probe points find a slab across an axis in which g differs, if its width is 2^-17 or more.
    The probe points hit any other region of volume v with probability 1 − exp(−2^17 v).
    A region of volume 8e-5 is hit with probability 1 − 5e-5. Narrower peaks may be missed.
    If the nodes miss a region that probe points hit, g is evaluated at 2^18 other points.
    The error of the variance then includes an estimate of what the nodes miss.

    ∫g² is infinite if g grows across an axis like t^-½ or faster (exponent at least 0.4995).
    ∫g² is also infinite if the contribution of the poles does not shrink under refinement.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> variance = mcs.exact_variance(mcs.Estimator("linear", dims=1), "jittered", 4)
    >>> round(variance * 12 * 4**3, 9)
    1.0
    """
    tolerance = as_real("tolerance", tolerance, least=1e-12, most=1.0)
    subject = as_subject(estimator, sampler, dims=dims)
    with counting("exact_variance", max_evaluations) as tally:
        value, _ = estimated_variance(subject.estimator, subject.sampler, n, tolerance)
    tally.check()
    return value if subject.estimator.channels else float(np.squeeze(value))


def estimated_variance(
    estimator: AbstractEstimator | Integrand | str, sampler: Sampler | str, n: int, tolerance: float
) -> tuple[Array, Array]:
    """Return `exact_variance` and a bound of its absolute error, by channel."""
    subject = as_subject(estimator, sampler)
    given: AbstractEstimator = subject.estimator
    n = subject.sampler.check_count(n)
    given.check_sampler(subject.sampler, n)
    given.check_independent()
    source = given.randomized(subject.sampler)
    total: Any = 0.0
    for technique, count in enumerate(given.counts):
        g = given.primary_integrand(technique)
        law = source.law(n * count)
        try:
            found = of_integrand(law, g, tolerance)
        except NoClosedForm:
            if g.dims < _SETTINGS.many_dims or tolerance < _SETTINGS.loose:
                raise
            by_axes = None
            with contextlib.suppress(NoClosedForm):
                by_axes = of_subsets(law, Known(g), Stream.from_rng(0))
            if by_axes is None or (by_axes.error > tolerance * by_axes.variance).any():
                raise
            found = by_axes.variance, by_axes.error
        total = total + np.stack(found)
    if not total[0].any():  # an error only if g is constant for all techniques
        said = [constant(given.primary_integrand(t)) for t in range(len(given.counts))]
        if all(said):
            raise NoClosedForm(f"{said[0]}.")
    return total[0], total[1]


def of_integrand(
    law: Law, g: Integrand, tolerance: float, most: float = MOST_EVALUATIONS
) -> tuple[Array, Array]:
    """Return the variance and a bound of its error. A variance at rounding level is 0.

    The error is the difference between two orders of the quadrature.
    The error includes an estimate (`blindness`) for structures between the nodes.
    For random points, the error comes from ∫g² alone.
    If higher orders of the quadrature would suffice, the orders are raised once.
    If `most` is below the default, the orders are not raised: the caller tries other methods.

    Raises
    ------
    NoClosedForm
        If `exact_variance` raises this error, or the error exceeds `tolerance` times the variance.
        The same error is raised if a quadrature rule takes more than about `most` evaluations.
    """
    g, lines = looked_at(g), False
    if not (in_closed_form(g) or g.costly):
        # Integrals along lines cost little, and resolve poles and waves that cells do not resolve
        lines = bool(beyond_points(g).any()) or (most >= MOST_EVALUATIONS and g.dims > 1)
        if lines and separated(g):
            with contextlib.suppress(NoClosedForm):
                return _within(_by_axes(law, g), law, g, tolerance)
        square, _ = square_integral(g) if law.uniform else (np.zeros(1), 0)
        if np.isinf(square).all():  # Next to a pole, one point outweighs all others
            return square, np.zeros(len(square))
    try:
        return _by_cells(law, g, tolerance, most)
    except NoClosedForm as refusal:
        if most < MOST_EVALUATIONS or g.costly or lines or not separated(g):
            raise
        try:
            return _within(_by_axes(law, g), law, g, tolerance)
        except NoClosedForm:
            raise refusal from None


def _by_cells(law: Law, g: Integrand, tolerance: float, most: float) -> tuple[Array, Array]:
    """Compute `of_integrand` by quadrature over all axes together."""
    n = law.n
    square = square_error = np.full(max(1, g.channels), np.nan)
    if law.uniform and not (in_closed_form(g) or g.costly):
        square, square_error = square_integral(g)
    if isinstance(law, Independent):
        middle, first, second, error = moments(g)
        value = second - first**2
        # The function `moments` states the error of an integral as three standard errors.
        # Use 4.5 standard errors: the errors of 1,000 test functions were never larger
        error = 1.5 * error * (1.0 + 2.0 * np.abs(first)) + 4e-15 * (second + middle**2)
        if (error > tolerance * value).any() and np.isfinite(square).all():
            mean, off = np.atleast_1d(g.integral), integral_accuracy(g)[1]
            by_square = square_error + 2.0 * np.abs(mean) * off + 4e-15 * square
            value = np.where(by_square < error, square - mean**2, value)
            error = np.minimum(by_square, error)
        if (error <= tolerance * value).all() and (value > 0.0).all():
            return value / n, error / n

    bare = law.inner if isinstance(law, Moved) else law
    cells = (
        (isinstance(bare, Strata) and bare.jittered)
        or isinstance(bare, PairedAxes)
        or (isinstance(bare, Scrambled) and bare.nested_pairs)
    )
    coarse, fine = orders_of(n, g.dims)
    for times in (1, _SETTINGS.finer) if most >= MOST_EVALUATIONS else (1,):
        try:
            high, unseen = _variance(law, g, Rule(times * fine, most, times * coarse))
            low = high
            if not (cells and in_closed_form(g)):  # Closed-form moments have no quadrature error
                low, _ = _variance(law, g, Rule(times * coarse, most))
        except NoClosedForm:
            if times == 1:
                raise
            break
        error = _SETTINGS.safety * np.abs(high - low) + unseen
        agree = error <= tolerance * np.abs(high)
        if agree.all() or (error > _SETTINGS.hope * tolerance * np.abs(high)).any():
            break
    if agree.all() and error.all():
        return high, error
    square, _ = square_integral(g)
    agree |= error <= _SETTINGS.negligible * np.max(square) / n
    if law.uniform:  # Next to a pole, one point outweighs all others
        high = np.where(np.isinf(square), np.inf, high)
    # The rounding error of Σ (mean g² − (mean g)²)/n is about 1e-15 ∫g²/n.
    # Even a computed variance of 0 may be wrong by 1e-15 ∫g²/n
    rounding = 4e-15 * square / n
    known = agree | np.isinf(high) | (error <= _SETTINGS.safety * rounding)
    if not known.all():
        with np.errstate(divide="ignore"):
            enough = 1.1 * float(np.max(np.where(known, 0.0, error / np.abs(high))))
        larger = f", or tolerance={enough:.1e}" if enough < _SETTINGS.offered else ""
        raise NoClosedForm(
            f"The stratum quadrature of {g.spec} does not converge ({np.max(low):.6g} against "
            f"{np.max(high):.6g}, error {np.max(error):.2g}) to a tolerance of {tolerance:.1g}; "
            "use ",
            *MEASURE_IT,
            f"{larger}.",
        )
    vanishes = np.isfinite(high) & (np.maximum(low, high) <= rounding)
    return np.where(vanishes, 0.0, high), np.where(np.isinf(high), 0.0, error)


def _within(
    found: tuple[Array, Array], law: Law, g: Integrand, tolerance: float
) -> tuple[Array, Array]:
    """Return the result if its error is within the tolerance, or 0 at rounding level."""
    value, error = found
    if np.isinf(value).any():
        return value, np.where(np.isinf(value), 0.0, error)
    parts = separated(g) or ()
    size = np.array([each.spread[0] + each.mean**2 for each in parts])
    rounding = 4e-15 * size / law.n
    known = (error <= tolerance * value) | (error <= _SETTINGS.negligible * size / law.n)
    if not known.all():
        raise NoClosedForm(
            f"The quadrature of {g.spec} along its axes does not converge ({np.max(value):.6g}, "
            f"error {np.max(error):.2g}) to a tolerance of {tolerance:.1g}; use ",
            *MEASURE_IT,
            ".",
        )
    return np.where(value <= rounding, 0.0, value), error


def _by_axes(law: Law, g: Integrand) -> tuple[Array, Array]:
    """Return the variance of a sum or product of functions of one axis, and its error bound.

    Raises
    ------
    NoClosedForm
        If the joint distribution of two points of the sampler is not known.
    """
    law = Independent(n=1, dims=law.dims) if law.n == 1 and law.uniform else law
    image = isinstance(law, Folded) or (isinstance(law, Mirrored) and law.inner.uniform)
    if image:
        seen = FoldedIntegrand(g) if isinstance(law, Folded) else SymmetrizedIntegrand(g)
        value, error = _by_axes(law.inner, looked_at(seen))  # type: ignore[attr-defined]
        # Add the variance of the random reflections
        if isinstance(law, Mirrored) and law.mode == "random":
            one = Independent(n=law.n, dims=law.dims)
            whole, average = _by_axes(one, g), _by_axes(one, looked_at(seen))
            value = value + np.maximum(whole[0] - average[0], 0.0)
            error = error + whole[1] + average[1]
        return value, error
    parts = separated(g)
    if parts is None:
        raise NoClosedForm(f"{g.spec} is neither a sum nor a product of functions of one axis.")
    return of_curves(law, parts)


def of_curves(law: Law, parts: Sequence[Separable]) -> tuple[Array, Array]:
    """Return the variance of each channel, and its error bound, from functions of one axis.

    Raises
    ------
    NoClosedForm
        If the joint distribution of two points of the sampler is not known.
    """
    found = [
        (math.inf, 0.0) if each.diverges and law.uniform else _of_separable(law, each)
        for each in parts
    ]
    value, error = np.array(found).T
    return value, error


def _of_separable(law: Law, g: Separable) -> tuple[float, float]:
    n = law.n
    means = np.array([curve.mean**2 for curve in g.curves])
    squares = np.array([curve.square for curve in g.curves])
    spread, doubt = g.spread
    error = _SETTINGS.doubt * doubt / n + _SETTINGS.rounding * (spread + g.mean**2) / n

    def together(kappa: Array) -> float:
        """Return the covariance of g at two points from its covariances along axes, (dims,)."""
        if not g.product:
            return float(kappa.sum())
        total = 0.0  # Π (μ² + κ) − Π μ² without cancellation
        for axis, each in enumerate(kappa):
            rest = means[axis + 1 :] + kappa[axis + 1 :]
            total += means[:axis].prod() * each * rest.prod()
        return float(total)

    # For strata, use mean variances within cells, at one offset or averaged over all offsets
    set_, offset = unmoved(law)
    shifted = isinstance(law, Shifted)
    off: list[float] = []

    def within(sides: Sequence[int], curves: Sequence[PiecewiseCurve] = g.curves) -> Array:
        values = []
        for curve, side, moved in zip(curves, sides, offset, strict=True):
            if not shifted:
                values.append(float(curve.cells(side, float(moved) % (1.0 / side))[1].mean()))
                continue
            fine, coarse = (_over_offsets(curve, side, order) for order in (6, 4))
            size = curve.square + curve.mean**2
            off.append(abs(fine - coarse) / max(fine, _SETTINGS.nothing * size, 1e-300))
            values.append(fine)
        return np.array(values)

    value = math.nan
    match set_:
        case Independent():
            value = spread / n
        case Strata(sides=sides) if set_.jittered:
            inside = within(sides)
            value = (together(squares) - together(squares - inside)) / n
            if not g.product:
                value = float(inside.sum()) / n
        case Strata(sides=sides, motif=AntitheticPair()) if not shifted and not offset.any():
            pairs = [_paired(curve, side) for curve, side in zip(g.curves, sides, strict=True)]
            if not g.product:
                value = float(within(sides, pairs).sum()) / (n // 2)
            else:
                mates = np.array([2.0 * p.square for p in pairs]) - squares
                both = 0.5 * (together(squares) + together(mates))
                value = (both - together(squares - within(sides))) / (n // 2)
        case PairedAxes():
            strata = np.array(set_.strata)
            cells = squares - within(set_.strata)
            finer = cells
            if any("mates" in pattern.axes for pattern in set_.patterns):
                finer = squares - within([s * p for s, p in zip(strata, set_.parts, strict=True)])
            parts = np.array(set_.parts)
            kinds = {
                "apart": -cells / np.maximum(strata - 1.0, 1.0),
                "same": cells,
                "mates": (parts * cells - finer) / np.maximum(parts - 1.0, 1.0),
            }
            value = together(squares) / n
            for pattern in set_.patterns:
                kappa = np.array([kinds[way][axis] for axis, way in enumerate(pattern.axes)])
                value += pattern.share * together(kappa)
            if set_.latin and not g.product:
                value = float((squares - cells).sum()) / n
        case _:
            inner = law.inner if isinstance(law, Shifted | Scrambled) else law
            if not isinstance(inner, Fixed) or isinstance(law, Fixed):
                raise NoClosedForm(
                    f"No exact variance is known for {law.name} in {law.dims} dims; use ",
                    *MEASURE_IT,
                    ".",
                )
            value, more = _of_set(law, g) if g.product else _of_projections(law, inner, g)
            error += more
    return value, error + (_SETTINGS.exact + max(off, default=0.0)) * abs(value)


def _over_offsets(curve: PiecewiseCurve, side: int, order: int) -> float:
    """Average the variance within cells over all offsets of the cells.

    As a function of the offset, the variance has cusps where cell borders meet `curve.places`.
    """
    node, weight = gauss_rule(order)
    ends = {0.0, 1.0}
    for place in (0.0, *curve.places.tolist()):
        at = place * side % 1.0
        for k in range(_SETTINGS.cusps):
            ends |= {(at + 0.125**k) % 1.0, (at - 0.125**k) % 1.0, at}
    edges = np.unique(np.clip(list(ends), 0.0, 1.0))
    total = 0.0
    for a, b in itertools.pairwise(edges.tolist()):
        values = [float(curve.cells(side, (a + (b - a) * t) / side)[1].mean()) for t in node]
        total += (b - a) * float(weight @ values)
    return total


def _paired(curve: PiecewiseCurve, side: int) -> PiecewiseCurve:
    """Return the centered mean of a curve at a point and at the point's reflection in its cell."""

    def both(x: Array) -> Array:
        cell = np.minimum(np.floor(x * side), side - 1.0)
        return 0.5 * (curve(x) + curve(np.clip((2.0 * cell + 1.0) / side - x, 0.0, BELOW_ONE)))

    found = PiecewiseCurve.along(both, (np.arange(1, side) / side).tolist())
    if found is None:
        raise NoClosedForm("Polynomials do not resolve the reflections in cells along an axis.")
    return found


def _of_projections(law: Law, inner: Fixed, g: Separable) -> tuple[float, float]:
    """Predict the variance of a sum of functions of single axes, for scrambled or shifted sets.

    The variances of the projections of the set are added.
    """
    n, value, error = law.n, 0.0, 0.0
    for axis, (x, curve) in enumerate(zip(inner.points.T, g.curves, strict=True)):
        if curve.square == 0.0:
            continue
        if isinstance(law, Scrambled) and law.nested_pairs:
            # Compute the gain of each digit, until all coordinates differ in their leading digits
            base, level, agree, gains = law.bases[axis], 0, float(n), [0.0]
            while agree > 1.0 and base ** (level + 1) <= _SETTINGS.most_cells:
                level += 1
                nudge = 0.0 if base & (base - 1) == 0 else 2.0**-50
                digits = np.floor((x + nudge) * float(base**level)).astype(np.int64)
                now = float((np.bincount(digits).astype(float) ** 2).sum()) / n
                gains.append((base * now - agree) / (base - 1))
                agree = now
            means, spreads = curve.cells(
                base**level,
                0.0,
                _SETTINGS.few_nodes if level > _SETTINGS.deep else _SETTINGS.many_nodes,
            )
            parts = level_variances(means[:, None], (base,))[:, 0]
            rest = float(spreads.mean())
            value += (float(np.array(gains[1:]) @ parts[1:]) + rest * agree) / n
            error += rest * (agree - 1.0) / n
            continue
        if isinstance(law, Scrambled) and law.xor:
            whole = (
                m
                for m in range(_SETTINGS.most_bits)
                if np.array_equal(x * 2**m, np.floor(x * 2**m))
            )
            bits = next(whole, _SETTINGS.most_bits)
            if 2**bits > _SETTINGS.most_cells:
                raise NoClosedForm(f"Coordinates of {law.name} have too many digits.")
            sizes = [max(_SETTINGS.most_cells, 8 * 2**bits) // part for part in (1, 2, 4)]
            found = []
            for size in sizes:
                means, spreads = curve.cells(size, 0.0, _SETTINGS.few_nodes)
                counts = np.bincount(np.rint(x * size).astype(np.int64), minlength=size) / n
                both = (hadamard(means) / size * hadamard(counts)) ** 2
                found.append(float(both[1:].sum()) + float(spreads.mean()) / n)
        elif isinstance(law, Shifted):
            found = []
            x = np.mod(x - x[0], 1.0)
            even = np.abs(x * n - np.rint(x * n)).max() < _SETTINGS.even
            places = np.unique(np.rint(x * n).astype(np.int64) % n)
            period = len(places)
            if (
                even
                and curve.exponent == 0.0
                and n % period == 0
                and not (places % (n // period)).any()
            ):
                # The mean of the curve over a grid depends on the grid's offset within one cell
                steps = np.arange(period) / period

                def mean(t: Array, curve: PiecewiseCurve = curve, steps: Array = steps) -> Array:
                    parts = np.array_split(t, max(1, t.size * steps.size // _SETTINGS.at_once))
                    moved = ((part[:, None] / steps.size + steps) % 1.0 for part in parts)
                    return np.concatenate([curve(each).mean(axis=1) - curve.mean for each in moved])

                folded = np.unique(curve.places * period % 1.0).tolist()
                rounding = _SETTINGS.rounded_mean * math.sqrt(curve.square + curve.mean**2)
                of_offset = PiecewiseCurve.along(mean, folded, rounding)
                if of_offset is not None:
                    value += of_offset.square
                    error += _SETTINGS.rounded_variance * curve.square / n
                    continue
            finest = (
                n * max(8, 4 * (_SETTINGS.most_cells // (4 * n)))
                if even
                else 2 * _SETTINGS.most_cells
            )
            for size in (finest, finest // 2, finest // 4):
                means, spreads = curve.cells(size, 0.0, _SETTINGS.few_nodes)
                energy = 2.0 * np.abs(np.fft.rfft(means) / size) ** 2
                if even:
                    place = np.rint(x * n).astype(np.int64) % n * (size // n)
                    counts = np.bincount(place, minlength=size) / n
                    power = np.abs(np.fft.rfft(counts)) ** 2
                    energy[-1] *= 0.5
                    found.append(float(energy[1:] @ power[1:]) + float(spreads.mean()) / n)
                    continue
                # If points are not evenly spaced, measure their power at low frequencies only,
                # where the cells resolve the waves.
                # At higher frequencies, treat the power of the points as white noise
                most = size // 8
                m = np.arange(1, most + 1)
                import finufft

                waves = 2.0 * np.pi * np.ascontiguousarray(x)
                ones = np.full(n, 1.0 / n, complex)
                sums = finufft.nufft1d1(waves, ones, 2 * most + 1, eps=1e-12, isign=-1, nthreads=1)
                power = np.abs(sums[most + 1 :]) ** 2
                energy = energy[1 : most + 1] / np.sinc(m / size) ** 2
                tail = max(curve.square - float(energy.sum()), 0.0)
                # The mean power of the last octave is used for the tail
                last = slice(most // 2, most)
                weight = n * float(energy[last] @ power[last]) / max(energy[last].sum(), 1e-300)
                error += (abs(weight - 1.0) + _SETTINGS.white) * tail / n if size == finest else 0.0
                found.append(float(energy @ power) + weight * tail / n)
        else:
            raise NoClosedForm(f"No exact variance is known for {law.name}; use ", *MEASURE_IT, ".")
        refined, off = _refined(*found)
        value, error = value + refined, error + off
    return value, error


def _of_set(law: Law, g: Separable) -> tuple[float, float]:
    """Predict the variance of a product of functions of single axes.

    The set is scrambled or shifted. The variance is a mean over pairs of points.

    """
    n = law.n
    pairs, codes, rows = pairs_of(law, Stream.from_rng(0))
    if float(len(rows)) * n * law.dims > _SETTINGS.most_pairs:
        raise NoClosedForm(f"{law.name} has too many pairs of points; use ", *MEASURE_IT, ".")
    means = np.array([curve.mean**2 for curve in g.curves])
    modes = ("digits", "xor", "torus")

    def of_cells(part: int) -> float:
        tables = []
        for curve, base, levels in zip(g.curves, pairs.bases, pairs.levels, strict=True):
            if pairs.kind == "digits":
                cells, _ = curve.cells(base**levels, 0.0, _SETTINGS.many_nodes)
                added = level_variances(cells[:, None], (base,))[:, 0]
                added[0] = 0.0
                shared = np.cumsum(added)
                apart = shared[:-1] - added[1:] / (base - 1)
                tables.append(np.append(apart, curve.square))
                continue
            k = max(8, 4 * (_SETTINGS.most_cells // (4 * base))) // part
            cells, spreads = curve.cells(base * k, 0.0, _SETTINGS.few_nodes)
            if pairs.kind == "xor":
                kappa = hadamard((hadamard(cells) / (base * k)) ** 2)[::k]
            else:
                energy = np.abs(np.fft.rfft(cells)) ** 2
                kappa = np.fft.irfft(energy, base * k)[::k] / (base * k)
            kappa[0] += float(spreads.mean())
            tables.append(kappa)
        width = max(map(len, tables))
        rest = np.stack([np.pad(t, (0, width - len(t)), "edge") for t in tables])[..., None]
        others = np.array([np.delete(means, axis).prod() for axis in range(law.dims)])
        first = rest * others[:, None, None]
        sums = pair_sums(
            codes[0], rows, modes.index(pairs.kind), pairs.bases[0],
            np.ascontiguousarray(first), np.ascontiguousarray(rest), means[:, None], np.ones(1),
        )  # fmt: skip
        return float(sums.sum(axis=1).mean()) / n

    fine = of_cells(1)
    if pairs.kind == "digits":
        return fine, 0.0
    value, off = _refined(fine, of_cells(2), of_cells(4))
    rounded = (
        _SETTINGS.rounded_points * abs(fine) if pairs.bases[0] == TORUS and n != TORUS else 0.0
    )
    return value, off + rounded


def _refined(fine: float, middle: float, coarse: float) -> tuple[float, float]:
    """Extrapolate to cells of width 0 from the results for widths 1, 2 and 4 (Richardson).

    Return the extrapolated value and its error.
    """
    first, second = fine + (fine - middle) / 3.0, middle + (middle - coarse) / 3.0
    return first, abs(first - second)


def _variance(law: Law, g: Integrand, rule: Rule) -> tuple[Array, Array]:
    """Return the variance of a mean of g over a set, and a bound of its error, (channels or 1,)."""
    n, none = law.n, np.zeros(g.dims)
    match law:
        # For folded or mirrored sets, use the set before folding or mirroring, and change g:
        # a folded set needs the folded g, and a mirrored set needs averages of g over reflections
        case Folded(inner=inner):
            return _variance(inner, FoldedIntegrand(g), rule)
        case Mirrored(inner=inner, mode="uniform"):
            return _variance(inner, SymmetrizedIntegrand(g), rule)
        case Mirrored(inner=inner):
            if not inner.uniform:
                raise NoClosedForm(
                    f"No exact variance is known for random reflections of {inner.name}, whose "
                    "points are not uniform; use ",
                    *MEASURE_IT,
                    ".",
                )
            one, average = Independent(n=1, dims=g.dims), SymmetrizedIntegrand(g)
            whole, missed = _variance(one, g, rule)
            part, unseen = _variance(inner, average, rule)
            coins = np.maximum(whole - _variance(one, average, rule)[0], 0.0)
            return part + coins / n, unseen + missed / n
        case Strata(sides=sides, motif=AntitheticPair()):
            # Each of n/2 cells has one jittered point. Average g over the point and its reflection
            _, spread, unseen = strata(paired(g, sides[0]), sides, none, rule)
            return spread / (n // 2), unseen / (n // 2)
        case Scrambled(inner=Fixed() as net) if law.nested_pairs:
            return _nested(net, law.bases, g, rule)
        case Scrambled(inner=Fixed() as net) if law.xor:
            return _digitally_shifted(net, g, rule)
        case Independent():
            _, spread, unseen = strata(g, (1,) * g.dims, none, rule)
            return spread / n, unseen / n

    # The set has one point in each stratum, or is a grid, with fixed or random offsets
    set_, offset = unmoved(law)
    shifted = isinstance(law, Shifted)
    if isinstance(set_, PairedAxes) and set_.latin and g.dims > 1 and not offset.any():
        return _latin(law, g, rule, shifted=shifted)
    jittered = isinstance(set_, Strata) and set_.jittered
    latin = isinstance(set_, PairedAxes) and set_.latin and g.dims == 1
    grid = isinstance(set_, Fixed) and set_.sides is not None
    if not (jittered or latin or grid):
        raise NoClosedForm(
            f"No exact variance is known for {law.name} in {g.dims} dims; use ",
            *MEASURE_IT,
            ".",
        )
    sides = set_.strata if isinstance(set_, PairedAxes) else set_.sides  # type: ignore[attr-defined]
    if not (grid or shifted):
        _, spread, unseen = strata(g, sides, np.mod(offset, 1.0 / np.array(sides)), rule)
        return spread / n, unseen / n
    if grid and not shifted:
        # A deterministic set has no variance
        return np.zeros(max(1, g.channels)), np.zeros(max(1, g.channels))
    nodes, weights = offset_rule(g, sides, rule.order)
    rule.check(f"The exact variance of {law.name}", float(len(nodes) * n) * rule.each(g))
    if not grid:
        found = np.stack([strata(g, sides, d, rule)[1:] for d in nodes])
        spread, unseen = weighted_sum(weights, found)
        return spread / n, unseen / n

    # For a grid with one random offset, compute how the mean over the grid varies with the offset
    grids = (grid_values(g, sides, d).reshape(math.prod(sides), -1) for d in nodes)
    both = np.array([(v.mean(axis=0), (v**2).mean(axis=0)) for v in grids])
    one_mean, square = weighted_sum(weights, both)
    unseen = blindness(g, one_mean[None], square[None])
    return weighted_sum(weights, (both[:, 0] - one_mean) ** 2), unseen / n


def paired(g: Integrand, side: int) -> Integrand:
    """Average g at a point and at its reflection through the center of its cell of `side`^d."""

    def reflected(x: Array) -> Array:
        cell = np.minimum(np.floor(x * side), side - 1.0)
        return np.asarray(np.clip((2.0 * cell + 1.0) / side - x, 0.0, 1.0))

    borders = (np.arange(1, side) / side).tolist()  # The average of g jumps at cell borders
    breaks = tuple(
        tuple(sorted({*axis, *reflected(np.asarray(axis, float)).tolist(), *borders}))
        for axis in g.breaks
    )
    label = f"{g.spec}, symmetrized in cells"
    return Pointwise(g, lambda x: 0.5 * (g(x) + g(reflected(x))), breaks, label)


def _latin(law: Law, g: Integrand, rule: Rule, *, shifted: bool) -> tuple[Array, Array]:
    """Average the variance of a Latin hypercube over the offset of the cells.

    For each offset, the points are uniformly distributed.

    If n^d cells are too many, larger cells are used, which hold a whole number of small cells.
    Inside larger cells, slabs of width 1/n resolve the parts of g that depend on single axes.
    Inside larger cells, the variance of interactions has an unknown weight: 1 to 1 + 1/(n − 1).
    The weight 1 + ½/(n − 1) is used, and the error of the variance covers all possible weights.
    """
    n = law.n
    fine, nodes, weights = (n,) * g.dims, np.zeros((1, g.dims)), np.ones(1)
    if shifted:  # The mean over all cells is a smooth function of the offset
        nodes, weights = offset_rule(g, fine, rule.order // 2 + 2)
    one = float(len(nodes) * rule.each(g))
    # Shifted cells wrap around, and are cut at 0 and 1: this raises the cost in 1-D and 2-D
    most = rule.most / one / (1 if in_closed_form(g) or g.dims > 2 else 2)
    side = next((m for m in range(n, 1, -1) if n % m == 0 and m**g.dims <= most), 1)
    if side < n:
        rule.check(f"The exact variance of {law.name}", one * n)
    varying = np.indices((min(side, 2),) * g.dims).sum(axis=0)  # |v|, the number of axes in v
    gains = np.where(varying > 0, 1.0 + (n - 1.0) * (-1.0 / max(n - 1.0, 1.0)) ** varying, 0.0)
    found = []
    for offset in nodes:
        means, within, missed = strata(g, (side,) * g.dims, offset, rule)
        if side < n:
            for axis in range(g.dims):
                thin = tuple(n if i == axis else 1 for i in range(g.dims))
                slabs, _ = stratum_moments(g, thin, offset, rule.order, rule.most)
                within = within - slabs.reshape(side, n // side, -1).var(axis=1).mean(axis=0)
            within = np.maximum(within, 0.0)
            missed = missed + within / (n - 1)
            within = within * (1.0 + 0.5 / (n - 1))
        parts = level_variances(means.reshape(*(side,) * g.dims, -1), (side,) * g.dims)
        found.append(((within + weighted_sum(gains, parts)) / n, missed / n))
    total, unseen = weighted_sum(weights, np.array(found))
    return total, unseen


def _nested(net: Fixed, bases: tuple[int, ...], g: Integrand, rule: Rule) -> tuple[Array, Array]:
    """Return the variance of a net under nested uniform scrambling, with its error."""
    n, points = net.n, net.points
    # Find how many leading digits are needed on each axis to tell all coordinates apart
    digits = []
    for axis, base in enumerate(bases):
        level, limit = 0, math.floor(_SETTINGS.most_bits / math.log2(base))
        # Rounding may move coordinates just below a multiple of b^-level.
        # A coordinate just below a multiple counts as the multiple, as in spectra.gain
        x = points[:, axis] + (0.0 if base & (base - 1) == 0 else 2.0**-50)
        while len(np.unique(np.floor(x * base**level))) < n:
            level += 1
            if level > limit:
                raise NoClosedForm(
                    f"Axis {axis} of {net.name} has coordinates that coincide or nearly coincide; "
                    "the exact variance of nested scrambling is known for distinct ones only."
                )
        digits.append(level)
    sides = tuple(b**level for b, level in zip(bases, digits, strict=True))
    boxes = math.prod(map(float, sides))
    rule.check(f"The exact variance of {net.name}", boxes * rule.each(g))
    try:
        gains = gains_at(net, bases, max(1, *digits))
    except ParameterError as error:
        raise NoClosedForm(error, " Or use ", *MEASURE_IT, ".") from None
    gains = gains[tuple(slice(level + 1) for level in digits)]
    means, within, unseen = strata(g, sides, np.zeros(g.dims), rule)
    levels = level_variances(means.reshape(*sides, -1), bases)
    unseen = unseen * max(1.0, float(gains.max()))
    return (within + weighted_sum(gains, levels)) / n, unseen / n


def _digitally_shifted(net: Fixed, g: Integrand, rule: Rule) -> tuple[Array, Array]:
    """Return the variance of a net in base 2 under a digital shift, with its error."""
    points = net.points
    whole = (
        2**bits
        for bits in range(_SETTINGS.most_bits + 1)
        if np.array_equal(points * 2**bits, np.floor(points * 2**bits))
    )
    cells = next(whole, None)
    if cells is None:
        raise NoClosedForm(
            f"Coordinates of {net.name} have more than {_SETTINGS.most_bits} bits; use convergence "
            "or variance_terms."
        )
    sides = (cells,) * g.dims
    rule.check(f"The exact variance of {g.spec}", (float(cells) * rule.order) ** g.dims)
    nodes, weights = offset_rule(g, sides, rule.order)
    counts = np.zeros(sides)
    np.add.at(counts, tuple(np.rint(points * cells).astype(np.int64).T), 1.0 / len(points))
    spectrum = _hadamard(counts, g.dims) ** 2
    spectrum[(0,) * g.dims] = 0.0
    means, squares, within = [], [], []
    for offset in nodes:
        values = grid_values(g, sides, offset)
        squares.append((values**2).mean(axis=tuple(range(g.dims))))
        walsh = _hadamard(values, g.dims) / cells**g.dims
        means.append(walsh[(0,) * g.dims])
        within.append(weighted_sum(spectrum, walsh**2))
    of_offset = np.array(means)
    mean, square = weighted_sum(weights, of_offset), weighted_sum(weights, np.array(squares))
    found = weighted_sum(weights, np.array(within) + (of_offset - mean) ** 2)
    return found, blindness(g, mean[None], square[None])


def _hadamard(values: Array, dims: int) -> Array:
    """Apply the fast Walsh–Hadamard transform along each of the first `dims` axes of an array."""
    for axis in range(dims):
        values = np.moveaxis(hadamard(np.moveaxis(values, axis, -1)), -1, axis)
    return values


def level_variances(means: Array, bases: tuple[int, ...], axis: int = 0) -> Array:
    """Return σ²_l of all levels that the cells resolve, from the cell means of a function.

    Means have shape (b_0^L_0, b_1^L_1, …, channels), where b_i is the base of axis i.
    The result has shape (L_0 + 1, L_1 + 1, …, channels).
    The entry for level 0 of all axes is the squared mean of the function.
    The means are written as a sum of parts: one part for each digit of the coordinate on `axis`.
    The part of a digit is the difference between means over finer and over coarser cells.
    Each part is then written as a sum along the axes after `axis`, one axis at a time.
    """
    if axis == len(bases):
        return np.asarray((means**2).mean(axis=tuple(range(axis))))
    base, parts = bases[axis], []
    while means.shape[axis] > 1:
        shape = [*means.shape[:axis], -1, base, *means.shape[axis + 1 :]]
        coarse = means.reshape(shape).mean(axis=axis + 1)
        parts.append(means - np.repeat(coarse, base, axis=axis))
        means = coarse
    return np.stack([level_variances(p, bases, axis + 1) for p in [means, *reversed(parts)]])
