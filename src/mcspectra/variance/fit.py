"""Fit of rates: the slope of log variance against log n, and the counts that it is fitted to.

Weighted least squares: each variance is weighted by the inverse square of its relative standard
error. The 95 % interval is widened by the lack of fit, χ² per degree of freedom, where that exceeds
1. Curves bend at small n (lower-order terms); a *window* is the last so many counts, and
``"auto"`` takes the largest window of at least three counts whose lack of fit is not significant.
It is no default: of a straight line it costs precision (a third, at six counts), and of a bent one
it leaves a bend as large as the noise, which the interval does not know of. Exact variances at the
same counts, where there are any, say more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.estimators.moments import CONFIDENCE_Z

__all__ = ["LACK_OF_FIT", "RateFit", "check_window", "fit_rate"]

LACK_OF_FIT = 0.05
"""Significance of χ² below which a window of counts is taken to be bent."""

_LEAST = 3  # counts that can show lack of fit


@dataclass(frozen=True)
class RateFit:
    """A fitted rate.

    Attributes
    ----------
    rate, interval
        Slope and its 95 % interval; NaN where fewer than two variances could be fitted.
    first_n
        Smallest count of the fit.
    chi2
        Lack of fit, χ² per degree of freedom: about 1 for a straight line; NaN for two counts.
    """

    rate: float
    interval: tuple[float, float]
    first_n: float
    chi2: float


_NONE = RateFit(math.nan, (math.nan, math.nan), math.nan, math.nan)


def check_window(fit_last: object, counts: int) -> int | str:
    """Return a window as a number of counts, or ``"auto"``; None is all of them."""
    if fit_last is None or (isinstance(fit_last, str) and fit_last == "auto"):
        return "auto" if fit_last else counts
    if isinstance(fit_last, str):
        raise ParameterError(f"fit_last is {fit_last!r}; give a number of counts, 'auto' or None.")
    last = as_integer("fit_last", fit_last, least=2)
    if last > counts:
        raise ParameterError(f"fit_last is {last}, but there are {counts} counts.")
    return last


def fit_rate(
    ns: Array, variance: Array, relative_se: Array, floor: Array, window: int | str | None = None
) -> RateFit:
    """Fit log variance = a + rate · log n.

    Parameters
    ----------
    ns, variance, relative_se, floor
        Counts, variances, their relative standard errors, and the variances below which they are
        rounding noise, which are left out: all (N,).
    window
        Fit only the last so many counts; None: all; ``"auto"``: as many as lie on a line, which is
        the largest window of three or more whose χ² is not significant at `LACK_OF_FIT`, and
        the last three where there is none.
    """
    start = -window if isinstance(window, int) else 0
    ns, variance, relative_se, floor = (a[start:] for a in (ns, variance, relative_se, floor))
    used = (variance > floor) & np.isfinite(relative_se) & (relative_se > 0)
    x, y, se = np.log(ns[used]), np.log(variance[used]), relative_se[used]
    if window != "auto":
        return _line(x, y, se)
    for first in range(len(x) - _LEAST):
        found = _line(x[first:], y[first:], se[first:])
        if _significance(found.chi2, len(x) - first - 2) >= LACK_OF_FIT:
            return found
    return _line(x[-_LEAST:], y[-_LEAST:], se[-_LEAST:])


def _line(x: Array, y: Array, se: Array) -> RateFit:
    """Weighted least squares of y against x."""
    if len(x) < 2:
        return _NONE
    weight = se**-2.0
    centre = np.average(x, weights=weight)
    spread = (weight * (x - centre) ** 2).sum()
    rate = float((weight * (x - centre) * y).sum() / spread)
    residual = y - np.average(y, weights=weight) - rate * (x - centre)
    degrees = len(x) - 2
    chi2 = float((weight * residual**2).sum() / degrees) if degrees else math.nan
    widening = max(chi2, 1.0) if degrees else 1.0
    half = CONFIDENCE_Z * math.sqrt(widening / spread)
    return RateFit(rate, (rate - half, rate + half), float(np.rint(np.exp(x[0]))), chi2)


def _significance(chi2: float, degrees: int) -> float:
    """Probability of so much lack of fit, or more, of a straight line."""
    from scipy.special import chdtrc

    return float(chdtrc(degrees, chi2 * degrees))
