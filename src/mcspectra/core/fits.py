"""Straight lines through points whose errors are known: weighted least squares."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["LineFit", "line_fit"]


@dataclass(frozen=True)
class LineFit:
    """The line level + slope · (x − centre), and how well it fits.

    Attributes
    ----------
    slope
        Slope of the line.
    centre, level
        Weighted means of x and y; the line goes through them, and their errors are independent of the
        slope's.
    spread
        Σ w (x − centre)²: 1 over the variance of the slope where the weights are those of the errors.
    residuals
        y less the line, (N,).
    chi2
        Lack of fit, Σ w residual² per degree of freedom: about 1 for a straight line; NaN for two points.
    """

    slope: float
    centre: float
    level: float
    spread: float
    residuals: Array
    chi2: float

    def at(self, x: Array | float, slope: float | None = None) -> Array:
        """Values of the line at x, or of one through the same centre with another slope."""
        return np.asarray(self.level + (self.slope if slope is None else slope) * (x - self.centre))


def line_fit(x: Array, y: Array, weight: Array) -> LineFit:
    """Fit a straight line to two points or more.

    Parameters
    ----------
    x, y
        Coordinates (N,), at least two different x.
    weight
        1 over the variance of each y, (N,).
    """
    centre, level = np.average(x, weights=weight), np.average(y, weights=weight)
    off = x - centre
    spread = float((weight * off**2).sum())
    slope = float((weight * off * y).sum()) / spread
    residuals = y - level - slope * off
    degrees = len(x) - 2
    chi2 = float((weight * residuals**2).sum() / degrees) if degrees else math.nan
    return LineFit(slope, float(centre), float(level), spread, residuals, chi2)
