"""Fits of straight lines and of rates. A rate is the slope of log variance against log n.

The fits are weighted least squares.
The weight of each variance is the inverse square of its relative standard error.
The standard errors are estimated from the realizations.
Therefore the 95 % interval of a straight line's slope is computed from a normal distribution.
Lack of fit is χ² per degree of freedom. If it exceeds 1, the interval is widened by √χ².
If the lack of fit is significant (`LACK_OF_FIT`), the standard errors do not explain the scatter.
In this case, the scatter is estimated from the data,
and the half width of the interval is √χ² times Student's t, in standard errors.
Student's t has the degrees of freedom of the fit, which is one if there are three counts.

Curves bend at small n because of lower-order terms.
A fit can be limited to the largest counts, which are called its *window*.
``"auto"`` takes the largest window of at least three counts that passes two tests:
no significant lack of fit (`LACK_OF_FIT`), and no significant curvature (`CURVATURE`).
The test of curvature has one degree of freedom, and χ² has several.
A small bend therefore changes χ² little, but the test of curvature detects it.
Noise may still hide a bend in a window that passes both tests.
Therefore the interval uses the scatter if this makes the interval wider, even for χ² below 1.
``"auto"`` is not the default, because it loses precision if the line is straight.

In simulations, counts were 4, 16, … 1024 and standard errors were 6 % (500 realizations).
For a straight line, 98 % of the intervals of ``"auto"`` contain the asymptotic rate.
For jittered points and a disk of radius 0.27 off the center, 97 % of intervals contain the rate.
For a Gaussian and jittered points with a random shift, 86 % of the intervals contain the rate.
For the Gaussian with a random shift, the exact slope is −1.42 … −1.50.
No test can detect such a small bend.
If a curve still bends at its last counts, its rate is not extrapolated.
An example is a disk centered on the strata, with slope −1.39 between the last two counts.
Exact variances at the same counts would show the rate better.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.core.errors import Parameter, ParameterError

__all__ = [
    "CURVATURE",
    "LACK_OF_FIT",
    "UNRESOLVED",
    "LineFit",
    "LineFits",
    "RateFit",
    "check_window",
    "fit_rate",
    "fit_rates",
    "is_resolved",
    "line_fit",
    "line_fits",
    "widening",
]

LACK_OF_FIT = 0.05
"""Significance level of χ². A window of counts with a smaller p-value is rejected as bent."""

CURVATURE = 0.1
"""Significance level of a quadratic term in log n. Windows with smaller p-values are rejected."""

UNRESOLVED = "not resolved: use five or more counts, more realizations or larger counts"
"""Text that replaces a rate whose interval is too wide. Results keep the number."""

# Largest half width of the 95 % interval of a rate that is reported.
# Intervals of ±0.5 around the rates −1 and −2 only touch each other
_WIDEST = 0.5
_LEAST = 3  # smallest number of counts that can show lack of fit


@dataclass(frozen=True)
class LineFit:
    """The line level + slope · (x − center), and how well it fits.

    Attributes
    ----------
    slope
        Slope of the line.
    centre, level
        Weighted means of x and y. The line passes through this point.
        The error of the level is independent of the error of the slope.
    spread
        Σ w (x − center)²: the inverse variance of the slope if weights are inverse variances.
    residuals
        Differences between y and the line, with shape (N,).
    chi2
        Lack of fit, Σ w residual² per degree of freedom.
        The value is about 1 if the points lie on a straight line within their errors.
        For two points, the value is NaN.
    """

    slope: float
    centre: float
    level: float
    spread: float
    residuals: Array
    chi2: float

    def at(self, x: Array | float, slope: float | None = None) -> Array:
        """Return values of the line at x. If given, `slope` replaces the fitted slope."""
        return np.asarray(self.level + (self.slope if slope is None else slope) * (x - self.centre))


def line_fit(x: Array, y: Array, weight: Array) -> LineFit:
    """Fit a straight line to at least two points.

    Parameters
    ----------
    x, y
        Coordinates (N,), with at least two different x.
    weight
        Inverse variance of each y, (N,).
    """
    centre, level = np.average(x, weights=weight), np.average(y, weights=weight)
    off = x - centre
    spread = float((weight * off**2).sum())
    slope = float((weight * off * y).sum()) / spread
    residuals = y - level - slope * off
    degrees = len(x) - 2
    chi2 = float((weight * residuals**2).sum() / degrees) if degrees else math.nan
    return LineFit(slope, float(centre), float(level), spread, residuals, chi2)


@final
@dataclass(frozen=True, kw_only=True)
class LineFits:
    """Many lines log V = level + rate · (log n − center), stored as arrays (S, …); see `line_fits`.

    The center is the weighted mean of log n, at which the errors of level and rate are independent.
    A rate is NaN if it was fitted to fewer than two values, or if the line is not `known`.
    The field chi2 is the lack of fit per degree of freedom. It is NaN for two values.
    """

    rate: Array
    rate_se: Array
    level: Array
    level_se: Array
    centre: Array
    chi2: Array

    def of(self, rows: list[int]) -> LineFits:
        """Return the lines with the indices `rows`."""
        return LineFits(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})

    def at(self, n: float) -> tuple[Array, Array]:
        """Return the log variance at `n`, and its standard error."""
        step = np.log(n) - self.centre
        return self.level + self.rate * step, np.hypot(self.level_se, self.rate_se * step)


def line_fits(x: Array, y: Array, weight: Array, known: Array) -> LineFits:
    """Fit many lines at once. Lack of fit widens the standard errors, as in `fit_rate`.

    Parameters
    ----------
    x, y, weight
        Coordinates, and the inverse variance of each y. They broadcast to (S, N, …).
        Values of weight 0 are ignored.
    known
        For each line, whether enough values remain to fit it, (S, …).
    """
    from scipy.special import chdtrc, stdtrit

    with np.errstate(invalid="ignore", divide="ignore"):
        total = _over_values(weight)
        centre, level = _over_values(weight * x) / total, _over_values(weight * y) / total
        step = x - centre[:, None]
        spread = _over_values(weight * step**2)
        count = (weight > 0).sum(axis=1)
        enough = (count >= 2) & known
        rate = np.where(enough, _over_values(weight * step * y) / spread, np.nan)
        residual = y - level[:, None] - rate[:, None] * step
        degrees = count - 2
        chi2 = np.where(degrees > 0, _over_values(weight * residual**2) / degrees, np.nan)
        some, lack = np.maximum(degrees, 1), np.where(degrees > 0, chi2, 0.0)
        student = stdtrit(some, 0.975) / CONFIDENCE_Z
        significant = chdtrc(some, lack * some) < LACK_OF_FIT
        widened = np.maximum(np.where(significant, student, 1.0) * np.sqrt(lack), 1.0)
        return LineFits(
            rate=rate,
            rate_se=np.where(enough, widened / np.sqrt(spread), np.nan),
            level=np.where(enough, level, np.nan),
            level_se=widened / np.sqrt(total),
            centre=centre,
            chi2=chi2,
        )


def _over_values(values: Array) -> Array:
    """Sum over the second axis term by term. The order is the same for any number of lines."""
    return np.asarray(functools.reduce(np.add, np.moveaxis(values, 1, 0)))


@dataclass(frozen=True)
class RateFit:
    """A fitted rate.

    Attributes
    ----------
    rate, interval
        Slope and its 95 % interval, widened if there is lack of fit.
        Rate and interval are NaN if fewer than two variances were fitted.
    first_n
        Smallest fitted count.
    chi2
        Lack of fit, χ² per degree of freedom. About 1 for a straight line, NaN for two counts.
    """

    rate: float = math.nan
    interval: tuple[float, float] = (math.nan, math.nan)
    first_n: float = math.nan
    chi2: float = math.nan


def is_resolved(low: float, high: float) -> bool:
    """Whether a rate with this 95 % interval is precise enough to report: ±0.5 or better."""
    return bool(high - low <= 2 * _WIDEST)


def check_window(fit_last: int | str | None, counts: int) -> None:
    """Raise ParameterError if a window has more counts than there are in the data."""
    if isinstance(fit_last, int) and fit_last > counts:
        raise ParameterError(
            Parameter("fit_last"), f" is {fit_last}; give at most {counts}, the number of counts."
        )


def fit_rate(
    ns: Array, variance: Array, relative_se: Array, floor: Array, window: int | str | None = None
) -> RateFit:
    """Fit log variance = a + rate · log n.

    Parameters
    ----------
    ns, variance, relative_se, floor
        Counts, variances and their relative standard errors, all of shape (N,).
        Variances below `floor` come from rounding, and are ignored.
    window
        Number of largest counts to fit. None fits all counts.
        ``"auto"`` takes the largest window of three or more counts that passes two tests:
        no significant χ² (`LACK_OF_FIT`), and no significant curvature (`CURVATURE`).
        If no window passes both tests, ``"auto"`` takes the last three counts.
    """
    start = -window if isinstance(window, int) else 0
    ns, variance, relative_se, floor = (a[start:] for a in (ns, variance, relative_se, floor))
    used = (variance > floor) & np.isfinite(relative_se) & (relative_se > 0)
    x, y, se = np.log(ns[used]), np.log(variance[used]), relative_se[used]
    if window != "auto":
        return _line(x, y, se)
    from scipy.special import chdtrc

    first = 0
    while len(x) - first > _LEAST:
        # Test whether a straight line fits: by all deviations, and by a quadratic term
        own, weight = x[first:], se[first:] ** -2.0
        residual = line_fit(own, y[first:], weight).residuals / se[first:]
        straight = line_fit(own, (own - own.mean()) ** 2, weight).residuals / se[first:]
        curvature = (straight * residual).sum() ** 2 / (straight**2).sum()
        lack = chdtrc(len(own) - 2, (residual**2).sum())
        if lack >= LACK_OF_FIT and chdtrc(1, curvature) >= CURVATURE:
            break
        first += 1
    return _line(x[first:], y[first:], se[first:], chosen=True)


def fit_rates(
    ns: Array, variance: Array, relative_se: Array, floor: Array, window: int | str | None = None
) -> dict[str, Array]:
    """Fit each column of arrays (N, …). Return the fields of `RateFit` as arrays.

    The fields have the shape (…), and the interval has the shape (…, 2).
    """
    columns = (a.reshape(len(ns), -1).T for a in (variance, relative_se, floor))
    fits = [fit_rate(ns, v, r, f, window) for v, r, f in zip(*columns, strict=True)]
    found = {
        name: np.array([getattr(fit, name) for fit in fits]) for name in RateFit.__annotations__
    }
    return {name: v.reshape(*variance.shape[1:], *v.shape[1:]) for name, v in found.items()}


def _line(x: Array, y: Array, se: Array, *, chosen: bool = False) -> RateFit:
    """Fit y against x by weighted least squares.

    If `chosen` is true, tests chose the window, and the interval uses the scatter of the data.
    """
    if len(x) < 2:
        return RateFit()
    fit = line_fit(x, y, se**-2.0)
    degrees = len(x) - 2
    chi2 = float(((fit.residuals / se) ** 2).sum() / degrees) if degrees else math.nan
    half = _quantile(degrees, chi2, chosen=chosen) / math.sqrt(fit.spread)
    interval = (fit.slope - half, fit.slope + half)
    return RateFit(fit.slope, interval, float(np.rint(np.exp(x[0]))), chi2)


def widening(degrees: int, chi2: float) -> float:
    """Return the factor by which lack of fit widens an interval with these degrees of freedom."""
    return _quantile(degrees, chi2, chosen=False) / CONFIDENCE_Z


def _quantile(degrees: int, chi2: float, *, chosen: bool) -> float:
    """Return the half width of a slope's 95 % interval, divided by the slope's standard error.

    The standard error is computed as if there were no lack of fit.
    """
    if not degrees:
        return CONFIDENCE_Z
    from scipy.special import chdtrc, stdtrit

    if chosen or chdtrc(degrees, chi2 * degrees) < LACK_OF_FIT:
        return max(CONFIDENCE_Z, float(stdtrit(degrees, 0.975)) * math.sqrt(chi2))
    return CONFIDENCE_Z * math.sqrt(max(1.0, chi2))
