"""Rates predicted from the power at low frequencies and the integrand at high frequencies.

The theory is in docs/theory.md, "Rates".
The decay γ of |f_m|² is fitted to means of |f_m|² over shells half an octave wide.
The means over shells scatter about the fitted line for two reasons.
Firstly, |f_m|² has terms of higher order in 1/|m|. Secondly, the spectrum has ripples.
Two jumps at distance t cause ripples whose period in m is 1/t.
The interval of γ follows from the scatter about the line, with Student's t.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import final

import numpy as np

from mcspectra.core.checks import MAX_DIMS, Array, as_choice, as_integer
from mcspectra.core.errors import ParameterError, PreasymptoticWarning, warn
from mcspectra.core.fits import line_fit
from mcspectra.core.tally import counting
from mcspectra.estimators.quadrature import mesh, values_at
from mcspectra.integrands import Integrand
from mcspectra.integrands._quadrature import PROBE, probe
from mcspectra.integrands.registry import as_integrand
from mcspectra.samplers.law import (
    Choice,
    Fixed,
    Independent,
    Law,
    PairedAxes,
    Shifted,
    Stationary,
    Strata,
    Unknown,
    leaf_of,
)

__all__ = [
    "DECAYS",
    "DecayFit",
    "DecaySettings",
    "JumpSettings",
    "LimitSettings",
    "Slowest",
    "fitted_decay",
    "integrand_decay",
    "predicted_rate",
    "rates_of",
    "slowest_of_jumps",
]

DECAYS = {"jump": 1.0, "kink": 3.0, "smooth": math.inf}
"""Values of γ − d for three kinds of g: with a jump, with a kink, and without either.

A kink is a jump of first derivatives.
Here γ is the decay of |f_m|², and d the number of dims. Jumps are across a hypersurface.
"""


@final
@dataclass(frozen=True, kw_only=True)
class DecaySettings:
    """Settings for the fit of the decay of |f_m|².

    Attributes
    ----------
    octaves
        The line is fitted to this number of octaves of |m|, at the end of the spectrum.
        With two octaves, the exponents of 12 test functions change by at most 0.15.
        The intervals of the exponents are twice as wide with two octaves as with three.
        With four octaves, a Gaussian of width 0.1 appears to decay like |m|^-12 instead of |m|^-5.
    least_shells
        Least number of shells of half an octave in a fit.
        With two shells, the line fits exactly, and no scatter is left to estimate its error.
        A spectrum has fewer shells only if rounding noise hides most of them.
    bend
        Largest accepted change of the slope in log |m|, from the first to the last fitted octave.
        If the slope changes by more than `bend`, the decay of |f_m|² is reported as not settled.
        For test functions with jumps and kinks, the exponent changes by at most 0.9.
        For a Gaussian of width 0.1, which hides its kink at the border, exponents change by 8.6.
    widths, width
        Default half widths by number of dims, and the default for all other numbers of dims.
        The half width is larger in 1-D, because 1-D spectra have few frequencies per shell.
        Means over few frequencies do not average out the ripples of the spectrum.
        With each default half width, the fit takes less than a second.
    noise
        Rounding noise of |f_m|² relative to the largest |f_m|².
        Coefficients are accurate to 1e-13. Fits are the same for thresholds from 1e-28 to 1e-24.
    """

    octaves: int = 3
    least_shells: int = 3
    bend: float = 1.0
    widths: Mapping[int, int] = field(default_factory=lambda: {1: 512})
    width: int = 64
    noise: float = 1e-26


@final
@dataclass(frozen=True, kw_only=True)
class JumpSettings:
    """Settings for the search for jumps along lines.

    "The same results" means that the rates of 10 integrands in 1 to 4 dims did not change.
    The 10 integrands have jumps along and across the axes, kinks, a pole, or a narrow Gaussian.

    Attributes
    ----------
    dims
        Largest number of dims in which jumps are searched.
        In more dims, no jumps are found, and boxes are not cut at jumps.
    lines, places
        Number of lines along each axis, and of points on each line.
        The search takes 16,384 evaluations per axis.
        If one line in ten crosses a curve of jumps, the curve is found with probability 0.97.
        Half or twice as many lines and points find the same jumps.
    largest
        On each line, this number of steps is bisected. The largest steps are chosen.
        A line crosses few jumps, and it suffices to find one of them on one line.
        The same jumps are found if 2 to 8 steps are bisected on each line.
    halvings
        Number of bisections of a large step. Its width is 1/512 before and 2e-12 after 30 halvings.
        Over a step of width 2e-12, a slope of 1e7 changes g by less than `least`.
        With only 15 bisections, a Gaussian of width 0.02 would count as a jump.
    beside
        Distance from a break at which g is evaluated on both sides.
        Detected breaks are accurate to 2^-46.
        If the slope of g is below 500 times the root mean square of g,
        then g changes by at most `least` over the distance `beside`.
        The breaks are the same for distances from 1e-9 to 1e-5.
    least
        Smallest step that counts as a jump, relative to the root mean square of g.
        A jump of 1e-4 adds a variance 1e-8 times as large as the variance of random points.
        No feasible number of points measures such a small variance.
        The rates are the same if the threshold for a jump is from 1e-6 to 1e-2.
    border
        A jump does not cut a stratum if it is closer than this distance to the stratum's border.
        The distance is given as a fraction of the width of a stratum.
        For n up to 2^30, rounding moves positions in strata by less than this distance.
        The rates are the same for distances from 1e-8 to 1e-4.
    """

    dims: int = 5
    lines: int = 32
    places: int = 512
    largest: int = 4
    halvings: int = 30
    beside: float = 1e-7
    least: float = 1e-4
    border: float = 1e-6


@final
@dataclass(frozen=True, kw_only=True)
class LimitSettings:
    """Settings to find the limit of the slope of a predicted curve, and the bend of the curve.

    "The same results" means that limits and bends of 64 test curves did not change.
    The test curves are predicted for 8 samplers and 8 integrands in 1 to 3 dims, at n = 16 to 1024.

    Attributes
    ----------
    late
        Number of octaves at the end of a curve whose slope estimates the limit.
        The limits are the same for slopes over the last 2 to 4 octaves.
        With slopes over 8 octaves, no limit is found for 4 of 64 test curves.
        The 4 curves without a limit are for scrambled nets, and bend only at large n.
    near
        The limit is a theoretical exponent that differs from the slope by less than this number.
        The difference is limited to 0.4/d, because theoretical exponents are 1/d apart.
        The limits of rates are the same for thresholds from 0.1 to 0.4.
    agree
        Largest difference between local slopes in the octaves at the end of a curve.
        Allowed differences of slopes from 0.2 to 0.4 give the same limits for 64 test curves.
        If slopes may differ by 0.1 only, no limit is found for one of 64 test curves.
    leaves
        Largest difference between the last slope and a theoretical exponent.
        If the last slopes move away from the exponent, and differ from it by more than this number,
        the exponent is not the limit of the slopes.
        If fewer than three slopes are known, all of them must be this close to the exponent.
        Allowed differences of slopes from 0.025 to 0.1 give the same limits for 64 test curves.
    still
        Three successive slopes count as constant if they differ by at most this number.
        A constant slope may be the limit of the rate even if theory does not list it.
        For example, the variance next to a pole t^-a has the rate −1 − (1 − 2a)/d.
        Allowed slope differences from 0.005 to 0.02 give the same limits for 64 test curves.
    change
        A curve may bend if its first slope differs from its limit by more than this number.
        The bends are the same for thresholds from 0.15 to 0.3.
    most_change
        Largest candidate change of the exponent at a bend. Exponents lie between −1 and −5.
        If changes up to 8 instead of 4 are tried, the bends of 64 test curves stay the same.
    tried
        Numbers of candidates for the position of a bend, and for the change of the exponent.
        Over 10 octaves, candidate bends are 0.1 octaves apart. This is the accuracy of a bend.
    better
        A curve has a bend if two power laws fit it much better than one power law.
        The scatter about two power laws must be below this fraction of the scatter about one.
        For values of `better` from 0.125 to 0.25, the same test curves have a bend.
        If half of the scatter may remain, one more of 64 test curves has a bend.
    """

    late: int = 4
    near: float = 0.2
    agree: float = 0.2
    leaves: float = 0.05
    still: float = 0.01
    change: float = 0.3
    most_change: float = 4.0
    tried: int = 101
    better: float = 0.25


_DECAY, _JUMPS, _LIMIT = DecaySettings(), JumpSettings(), LimitSettings()


def predicted_rate(b: float, decay: float | str, dims: int) -> float:
    """Predict the exponent of the variance in n.

    Parameters
    ----------
    b
        Exponent of the power of the points at low frequencies.
        The exponent is 0 for random and Poisson disk sets, 2 for jittered sets, ∞ for step noise.
        Sets that are optimized for smooth functions have larger exponents than jittered sets.
    decay
        The decay γ: averaged over directions, |f_m|² is proportional to |m|^-γ.
        The decay must exceed `dims` for a finite variance. `integrand_decay` measures γ.
        `fitted_decay` also gives the interval of γ.
        If γ − d < b, the interval of γ, divided by `dims`, gives the interval of the rate.
        Alternatively, name the worst discontinuity of the integrand on the torus:
        give ``"jump"``, ``"kink"`` or, without a discontinuity, ``"smooth"``. See `DECAYS`.
    dims
        Number of dims d.

    Returns
    -------
    float
        The rate −1 − min(b, γ − d)/d. For b = γ − d there is an additional factor log n.

    Raises
    ------
    ParameterError
        If the exponent b is −d or less, or the decay γ is d or less.

    Notes
    -----
    The formula holds for homogeneous (randomly shifted) sets.
    The power spectrum of homogeneous sets determines the variance.
    Without a shift, jittered sets do not wrap around the torus.
    A smooth function then has no jump at the border, so use ``"smooth"`` for jittered sets.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> mcs.prediction.predicted_rate(2, "smooth", 2), mcs.prediction.predicted_rate(2, "jump", 2)
    (-2.0, -1.5)
    """
    d = as_integer("dims", dims, least=1, most=MAX_DIMS)
    if isinstance(decay, str):
        excess = DECAYS[as_choice("decay", decay, tuple(DECAYS))]
    else:
        excess = _exponent("decay", decay, above=d) - d
    best = min(_exponent("b", b, above=-d), excess)
    return -1.0 - best / d


@final
@dataclass(frozen=True)
class Slowest:
    """Theoretical bound of the rate at large n.

    Attributes
    ----------
    exponent
        Lower bound of the limit. It is −∞ if nothing is known.
    sure
        If true, a curve that falls at least as fast as n^exponent has this exponent as its limit.
        If false, the last slopes of the curve must also agree with each other.
    """

    exponent: float = -math.inf
    sure: bool = True


def slowest_of_jumps(g: Integrand, laws: Sequence[Law], settings: JumpSettings = _JUMPS) -> Slowest:
    """Return the rate that jumps of g impose on stratified sets, lattices and nets.

    `laws` describe the point sets of one sampler at several numbers n of points.
    A jump along a curve cuts n^(1 − 1/d) strata, which contribute equally: rate −1 − 1/d.
    A jump across an axis cuts one of n strata. Sets with stratified projections have the rate −2.
    A jump cuts no stratum if it lies at a border of strata for all n.
    On the torus, g may also jump at the border of the cube.
    Lattices resolve jumps along straight lines as well as jumps across axes.
    For disks, the variance of a lattice oscillates, and only its mean over n has rate −1 − 1/d.
    """
    d, law = g.dims, laws[-1]
    curves = -1.0 - 1.0 / d
    if isinstance(law, Independent):
        return Slowest(-1.0)
    cells = [_cells_of_axes(each) for each in laws]
    if not cells[-1] or g.costly or d > settings.dims:
        return Slowest()
    across, along = _jumps(g, settings)
    cut = False
    for axis, place in across:
        for each in cells:
            off = abs(place * each[axis] - round(place * each[axis])) if each[axis] else 1.0
            cut |= isinstance(law, Shifted) or (0.0 < place < 1.0 and off > settings.border)
    set_ = leaf_of(law)
    regular = isinstance(set_, Fixed) and set_.sides is not None
    even = isinstance(set_, Stationary) or (isinstance(set_, Fixed) and set_.even)
    found = []
    if cut:
        of_axis = curves if isinstance(set_, Strata) else -2.0 / d if regular else -2.0
        found.append(Slowest(of_axis))
    if along and not regular:
        found.append(Slowest(curves, not even))
    return max(found, key=lambda each: each.exponent, default=Slowest())


def _cells_of_axes(law: Law) -> tuple[int, ...]:
    """Return the number of strata along each axis: 0 without strata, empty if unknown."""
    match leaf_of(law):
        case Strata(sides=sides):
            return sides
        case PairedAxes(strata=strata, parts=parts):
            return tuple(s * p for s, p in zip(strata, parts, strict=True))
        case Fixed(sides=tuple() as sides):
            return sides
        case Unknown(strata=tuple() as strata):
            return strata
        case Fixed(bases=tuple() as bases):
            return tuple(b ** int(math.log(law.n) / math.log(b) + 1e-9) for b in bases)
        case Choice(laws=laws):
            return _cells_of_axes(laws[0])
        case Fixed(even=True) | Stationary():
            return (0,) * law.dims
    return ()


@np.errstate(over="ignore", invalid="ignore")  # Values next to poles may overflow
def _jumps(g: Integrand, settings: JumpSettings) -> tuple[list[tuple[int, float]], bool]:
    """Return jumps of g across an axis as (axis, position), and whether g has other jumps.

    Jumps across an axis lie at breaks and at the border.
    The largest steps along lines are bisected.
    A step that keeps its size under bisection is a jump, and a step that grows is a pole.
    """
    x, beside, least = probe(g.dims)[:: PROBE // settings.lines], settings.beside, settings.least
    size = math.sqrt(float(np.nanmean(np.abs(g(x)) ** 2)))
    across, along = [], False
    for axis in range(g.dims):

        def at(t: Array, axis: int = axis) -> Array:
            """Return values (lines, positions, channels) at positions (lines or 1, positions)."""
            points = np.repeat(x[:, None], t.shape[1], axis=1)
            points[..., axis] = t
            return values_at(g, points)

        places = [0.0, *g.breaks[axis]]
        pairs = at(np.array([[b + e for b in places for e in (beside, -beside)]]) % 1.0)
        steps = np.sqrt(np.mean(np.abs(pairs[:, ::2] - pairs[:, 1::2]) ** 2, axis=0)).max(axis=-1)
        across += [(axis, b) for b, step in zip(places, steps, strict=True) if step > least * size]

        grid = np.tile((np.arange(settings.places) + 0.5) / settings.places, (len(x), 1))
        first = np.abs(np.diff(at(grid), axis=1)).max(axis=-1)
        chosen = np.argsort(first, axis=1)[:, -settings.largest :]
        low, high, first = (np.take_along_axis(a, chosen, 1) for a in (grid, grid[:, 1:], first))
        for _ in range(settings.halvings):
            middle = 0.5 * (low + high)
            values = [at(t) for t in (low, middle, high)]
            below, above = (np.abs(b - a).max(axis=-1) for a, b in pairwise(values))
            left = below >= above
            low, high = np.where(left, low, middle), np.where(left, middle, high)
        step = np.maximum(below, above)
        far = np.abs(low[..., None] - np.array(places)).min(axis=-1) > beside
        along |= bool((far & (step > least * size) & (step <= 2.0 * first)).any())
    return across, along


def rates_of(
    n: Array,
    variance: Array,
    asked: int,
    dims: int,
    slowest: Slowest,
    settings: LimitSettings = _LIMIT,
) -> tuple[float, float, float, str]:
    """Return exponents of a predicted curve, and the position of its bend; NaN if unknown.

    Parameters
    ----------
    n, variance
        Ascending counts and variances, (N,).
        Variances that are not finite and positive are skipped.
    asked
        Number of leading counts that the rate is fitted to. Later counts only show the limit.
    dims
        Number of dims d.
    slowest
        Theoretical bound of the rate.
    settings
        Conditions under which a rate has a limit, and a curve of variances bends.

    Returns
    -------
    tuple
        Rate: the slope of a straight line through the variances at the requested counts.

        Limit: the theoretical bound, if it is certain and the last slope is at least as steep.
        The last slope is the slope over the last four octaves of n.
        If theory gives no certain bound of the rate, the limit is the nearest theoretical exponent.
        The nearest exponent must be close to the last slope, and is used only in up to 3 dims.
        A limit requires that the slope hardly changes over the last four octaves.
        The theoretical exponents are −1 − k/d, −2 and −3.
        Here k is 0 for white power, 1 for a jump, 2 for strata and 3 for a kink.
        The exponent −3 may have a factor (log n)^(d − 1).

        Bend: the n at which the power law of smaller n meets the power law of the limit.
        A bend is reported if the two exponents differ by more than 0.3.

        The last value is a sentence that explains why no limit is given, or an empty text.
    """
    there = np.isfinite(variance) & (variance > 0.0)
    x, y, fitted = np.log(n[there]), np.log(variance[there]), int(there[:asked].sum())
    rate = limit = bend = math.nan
    if fitted >= 2:
        rate = line_fit(x[:fitted], y[:fitted], np.ones(fitted)).slope
    if fitted and slowest.exponent == -1.0 and slowest.sure:
        return rate, -1.0, bend, ""
    if len(x) < 2:
        return rate, limit, bend, ""

    # Compute the slope over the last octaves, and the slopes between successive counts
    late = min(len(x), max(3, int((x >= x[-1] - settings.late * math.log(2.0) - 1e-9).sum())))
    end = line_fit(x[-late:], y[-late:], np.ones(late)).slope
    steps = np.diff(y) / np.diff(x)
    near_enough, log = min(settings.near, 0.4 / dims), (dims - 1) / x[-late:].mean()
    corners = slowest.exponent == -2.0 and dims in (2, 3)  # Jumps across two axes meet at corners
    if end <= slowest.exponent + near_enough + corners * log and slowest.sure:
        limit = slowest.exponent
    elif len(x) > 2 and np.ptp(steps[1 - late :]) <= settings.agree:
        exponents = [(-1.0 - k / dims, 0.0) for k in range(4)]
        exponents += [(-2.0, 0.0), (-3.0, log), (-3.0, 0.0)]
        near = min(exponents, key=lambda each: abs(end - sum(each)))
        away = np.abs(steps[-3:] - sum(near))
        leaves = len(away) < 3 and away.max() > settings.leaves  # too few slopes to see a trend
        leaves |= len(away) == 3 and (np.diff(away) > 0.0).all() and away[-1] > settings.leaves
        leaves |= len(away) == 3 and bool(
            np.ptp(away) <= settings.still and away.min() > settings.leaves
        )
        if dims <= 3 and abs(end - sum(near)) <= near_enough and not leaves:
            limit = near[0]
        elif len(steps) >= 3 and np.ptp(steps[-max(3, late) :]) <= settings.leaves:
            limit = end
        if limit < slowest.exponent - 1e-9:
            limit = math.nan
    why = ""
    if math.isnan(limit):
        last = ", ".join(f"{step:.2f}".replace("-", "−") for step in steps[-3:])
        why = (
            "the rate is still changing, so limit_rate is not given; the last local rates are "
            f"{last}"
        )

    # Fit two powers of n, where the second has the exponent of the limit.
    # If the curve flattens, the model of the variance is a + b, with two powers a and b of n.
    # If the curve gets steeper, the model is 1/(1/a + 1/b), with two powers a and b of n
    if len(x) > 3 and abs(steps[0] - limit) > settings.change:
        at = np.linspace(x[0], x[-1], settings.tried)[:, None, None]
        change = np.linspace(-settings.most_change, settings.most_change, settings.tried)[:, None]
        curve = limit * x - np.sign(change) * np.logaddexp(0.0, np.abs(change) * (at - x))
        left = (y - curve).var(axis=-1)
        k, l = np.unravel_index(int(left.argmin()), left.shape)
        straight = line_fit(x, y, np.ones(len(x))).residuals.var()
        if 0 < k < settings.tried - 1 and left[k, l] < settings.better * straight:
            bend = math.exp(at[k, 0, 0])
    return rate, limit, bend, why


@final
@dataclass(frozen=True)
class DecayFit:
    """A fitted decay of |f_m|².

    Attributes
    ----------
    decay, interval
        The exponent γ and its 95 % interval.
        The exponent and its interval are infinite if the coefficients are rounding noise.
        The interval accounts for the scatter about a power law.
        The interval is wrong if frequencies beyond the half width follow another power law.
    bend
        Change of the local exponent from the first to the last shell of the fit.
        The local exponent is the slope of a fitted parabola.
    half_width
        Shells up to |m| = K are fitted, where K is this value.
    """

    decay: float
    interval: tuple[float, float]
    bend: float
    half_width: int

    @property
    def settled(self) -> bool:
        """Whether the exponent is nearly constant over the shells."""
        return math.isinf(self.decay) or abs(self.bend) <= _DECAY.bend


def integrand_decay(
    integrand: Integrand | str,
    *,
    half_width: int | None = None,
    max_evaluations: int | None = None,
) -> float:
    """Measure γ, the decay of |f_m|² averaged over directions, at the end of the spectrum.

    Parameters
    ----------
    integrand
        The integrand f, or its spec string.
    half_width
        The half width K of the spectrum, at least 8.
        The slope is fitted over the last three octaves up to |m| = K.
        The default is 512 in 1-D and 64 in more dims.
        In 1-D, the exponent of a jump at any position is accurate to ±0.06.
        In more dims, jumps along the axes can have larger errors; see `fitted_decay`.
    max_evaluations
        Maximum number of evaluations of a user's function. More evaluations raise BudgetError.

    Returns
    -------
    float
        The exponent γ. It is infinite if the coefficients at high frequencies are rounding noise.
        The least γ of several channels is returned. `fitted_decay` also returns its interval.

    Warns
    -----
    PreasymptoticWarning
        If the exponent changes by more than 1 over the fitted octaves.
        The half width K is then too small to show the decay at high frequencies.
        Smooth functions cause the warning if coefficients at the half width exceed rounding noise.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> round(mcs.prediction.integrand_decay("disk", half_width=64), 1)
    3.0
    """
    found = fitted_decay(integrand, half_width=half_width, max_evaluations=max_evaluations)
    if not found.settled:
        warn(
            f"The decay {found.decay:.3g} changes by {found.bend:.2g} over the octaves up to "
            f"|m| = {found.half_width}: it has not reached a limit; give a larger half_width, or "
            "'smooth' or 'jump' for predicted_rate.",
            PreasymptoticWarning,
        )
    return found.decay


def fitted_decay(
    integrand: Integrand | str,
    *,
    half_width: int | None = None,
    max_evaluations: int | None = None,
) -> DecayFit:
    """Measure γ as in `integrand_decay`, with its interval and its change over the fit.

    Parameters
    ----------
    integrand, half_width, max_evaluations
        Same as in `integrand_decay`.

    Returns
    -------
    DecayFit
        The fit of the channel whose exponent γ is the smallest.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> found = mcs.prediction.fitted_decay(mcs.integrand("step(at=0.3)", dims=1))
    >>> found.interval[0] < 2.0 < found.interval[1], found.settled
    (True, True)
    """
    f = as_integrand(integrand)
    given = _DECAY.widths.get(f.dims, _DECAY.width) if half_width is None else half_width
    width = as_integer("half_width", given, least=1 << _DECAY.octaves)
    with counting("integrand_decay", max_evaluations):
        power = np.abs(f.fourier_grid(width)) ** 2
    power = power.reshape(*power.shape[: f.dims], -1)
    squares = mesh(*[np.arange(-width, width + 1) ** 2] * f.dims)
    length = np.sqrt(squares.sum(axis=-1))
    fits = [_decay_fit(power[..., c], length, width) for c in range(power.shape[-1])]
    return min(fits, key=lambda fit: fit.decay)


def _decay_fit(
    power: Array, length: Array, width: int, settings: DecaySettings = _DECAY
) -> DecayFit:
    """Fit log mean power against log mean |m| over shells (K/√2, K], (K/2, K/√2], …"""
    from scipy.special import stdtrit

    edges = width * 0.5 ** (0.5 * np.arange(2 * settings.octaves, -1, -1))
    place = np.searchsorted(edges, length, side="left")
    shells = [place == k for k in range(1, 2 * settings.octaves + 1) if (place == k).any()]
    mean = np.array([power[shell].mean() for shell in shells])
    known = mean > settings.noise * power.max()
    if not known[-2:].any() or known.sum() < settings.least_shells:
        return DecayFit(math.inf, (math.inf, math.inf), 0.0, width)
    x, y = np.log2([length[shell].mean() for shell in shells])[known], -np.log2(mean[known])
    slope, level = (float(value) for value in np.polyfit(x, y, 1))
    degrees = len(x) - 2
    scatter = float(((y - level - slope * x) ** 2).sum()) / degrees
    half = float(stdtrit(degrees, 0.975)) * math.sqrt(scatter / ((x - x.mean()) ** 2).sum())
    bend = 2.0 * float(np.polyfit(x, y, 2)[0]) * float(x[-1] - x[0])
    return DecayFit(slope, (slope - half, slope + half), bend, width)


def _exponent(name: str, value: object, *, above: float) -> float:
    """Check that a value is a real number above a limit, possibly infinite."""
    number = isinstance(value, int | float | np.integer | np.floating)
    if not number or isinstance(value, bool) or not float(value) > above:  # type: ignore[arg-type]
        raise ParameterError(f"{name} is {value!r}; give a number greater than {above:g}.")
    return float(value)  # type: ignore[arg-type]
