"""A scale for signed quantities over many orders of magnitude, which bokeh's axes lack."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.axes import linear_threshold, signed_ticks, threshold_note, tick_label

__all__ = ["SignedScale", "signed_scale"]

_LINEAR_SPAN = 30.0  # up to this ratio of largest to smallest, a linear scale shows both
_NEAR_ZERO = 0.5  # decades that the linear part takes on either side
_LINEAR_TICKS = 5
_NOTHING = 1e-9  # of the largest value of all: an array below it shows nothing


@final
@dataclass(frozen=True, kw_only=True)
class SignedScale:
    """Places of values on an axis: by the logarithm of their size beyond ± `threshold`.

    A `threshold` of 0 means a linear scale.
    """

    low: float
    high: float
    threshold: float = 0.0

    def place(self, values: Array) -> Array:
        """Places of values, in decades beyond the threshold; NaN and ±∞ have none (NaN)."""
        given = np.where(np.isfinite(values), values, np.nan)
        if self.threshold == 0.0:
            return np.asarray(given)
        size = np.abs(given) / self.threshold
        decades = np.log10(np.maximum(size, 1.0))
        return np.asarray(
            np.sign(given) * np.where(size < 1, _NEAR_ZERO * size, _NEAR_ZERO + decades)
        )

    def ticks(self, most: int = 7) -> dict[float, str]:
        """Text of each tick by its place."""
        if self.threshold == 0.0:
            values = _round_steps(self.low, self.high)
        else:
            values = signed_ticks(self.low, self.high, self.threshold, most)
        places = self.place(np.array(values))
        return {float(p): tick_label(v) for p, v in zip(places, values, strict=True)}

    @property
    def note(self) -> str:
        """What to add to a label: where the scale turns logarithmic; nothing where it is linear."""
        return f"   ({threshold_note(self.threshold)})" if self.threshold else ""


def signed_scale(values: Sequence[Array], decades: int = 6) -> SignedScale:
    """Choose the scale of all values: linear where it shows the smallest, else logarithmic.

    Parameters
    ----------
    values
        Arrays of any shape; what is not finite does not count.
    decades
        How far below its largest size the values of each array are told apart; all arrays
        together over no more than six decades.
    """
    every = np.concatenate([np.ravel(v) for v in values]) if len(values) else np.zeros(0)
    finite = every[np.isfinite(every)]
    low, high = min(float(finite.min(initial=0.0)), 0.0), max(float(finite.max(initial=0.0)), 0.0)
    tops = [float(np.max(np.abs(v), where=np.isfinite(v), initial=0.0)) for v in values]
    told_apart = [top * 10.0**-decades for top in tops if top > _NOTHING * max(high, -low)]
    smallest = np.abs(finite[finite != 0])
    least = max(float(smallest.min(initial=np.inf)), min(told_apart, default=0.0))
    threshold = linear_threshold([high, low, least]) if smallest.size else 0.0
    if max(high, -low) <= _LINEAR_SPAN * threshold:
        threshold = 0.0
    return SignedScale(low=low, high=high, threshold=threshold)


def _round_steps(low: float, high: float) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten in [low, high], zero among them."""
    if high <= low:
        return [0.0]
    rough = (high - low) / _LINEAR_TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(s * power for s in (1, 2, 5, 10) if s * power >= 0.999 * rough)
    return [
        k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    ]
