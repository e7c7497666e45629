"""Axes for quantities over many orders of magnitude, signed or not, with few and readable ticks.

Ticks are fixed positions with plain-text labels: matplotlib's own logarithmic ticks typeset
mathematics, which takes most of the time of drawing a small figure.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.formatting import power_of_ten

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colorbar import Colorbar
    from matplotlib.colors import SymLogNorm

__all__ = [
    "count_axis",
    "far_apart",
    "linear_threshold",
    "log_axis",
    "log_ticks",
    "signed_axis",
    "signed_bar_ticks",
    "signed_norm",
    "signed_ticks",
    "threshold_note",
    "tick_label",
]

Which = Literal["x", "y"]
_LINEAR_SPAN = 30.0  # up to this ratio of largest to smallest, a linear axis shows both
_SHORT = 1.6  # decades; below, powers of ten alone are too few ticks
_DECADES = 6  # below 10^-6 of the largest value nothing is told apart


def log_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Return ticks in [low, high], at most about `most`: powers of ten, or finer in a short range."""
    first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
    if math.log10(high / low) >= _SHORT:
        stride = math.ceil((last - first + 1) / most)
        return [10.0**e for e in range(first, last + 1, stride)]
    ticks: list[float] = []
    for steps in ((1, 2, 5), range(1, 10), [c / 10 for c in range(10, 100)]):
        every = [c * 10.0**e for e in range(first - 1, last + 1) for c in steps]
        ticks = [t for t in every if low <= t <= high]
        if len(ticks) >= 2:
            break
    return ticks[:: max(1, math.ceil(len(ticks) / most))]


def log_axis(axes: Axes, which: Which, low: float, high: float, most: int = 6) -> None:
    """Make an axis logarithmic from low to high with a small margin."""
    margin = (high / low) ** 0.04 if high > low else 2.0
    low, high = low / margin, high * margin
    _set_scale(axes, which, "log")
    _set_ticks(axes, which, log_ticks(low, high, most))
    _set_limits(axes, which, low, high)


def count_axis(axes: Axes, which: Which, counts: Sequence[int], most: int = 6) -> None:
    """Make an axis logarithmic with ticks at (some of) the counts of points themselves."""
    distinct = sorted(set(counts))
    _set_scale(axes, which, "log")
    chosen = far_apart(distinct, most)
    _set_ticks(axes, which, chosen, [f"{n:,}".replace(",", "\u2009") for n in chosen])
    margin = (distinct[-1] / distinct[0]) ** 0.05 if len(distinct) > 1 else 2.0
    _set_limits(axes, which, distinct[0] / margin, distinct[-1] * margin)


def far_apart(counts: Sequence[int], most: int) -> list[int]:
    """Choose counts whose labels do not touch on a logarithmic axis, the last one included."""
    gap = math.log(counts[-1] / counts[0]) / most if len(counts) > 1 else 0.0
    chosen = [counts[-1]]
    for n in reversed(counts[:-1]):
        if math.log(chosen[-1] / n) >= 0.999 * gap:
            chosen.append(n)
    return chosen[::-1]


def linear_threshold(values: Iterable[float] | Array, decades: int = _DECADES) -> float:
    """Return the power of ten below which a signed axis is linear; 0 if there is nothing to show.

    It lies at the smallest nonzero magnitude, but not more than `decades` under the largest.
    """
    sizes = np.abs(np.asarray(list(values), dtype=float).ravel())
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    if not sizes.size:
        return 0.0
    least = max(float(sizes.min()), float(sizes.max()) * 10.0**-decades)
    return float(10.0 ** math.floor(math.log10(least)))


def signed_axis(axes: Axes, which: Which, values: Array, most: int = 7) -> str:
    """Scale an axis to signed values, by the logarithm of their size where they span decades.

    Returns
    -------
    str
        What to add to the label: ``"log beyond ±10⁻⁶"``, or nothing for a linear axis.
    """
    finite = values[np.isfinite(values)]
    low, high = min(float(finite.min(initial=0.0)), 0.0), max(float(finite.max(initial=0.0)), 0.0)
    threshold = linear_threshold(finite)
    if threshold == 0.0:
        _set_limits(axes, which, -1.0, 1.0)
        _set_ticks(axes, which, [0.0])
        return ""
    if max(high, -low) <= _LINEAR_SPAN * threshold:
        pad = 0.06 * (high - low)
        _set_limits(axes, which, low - pad * (low < 0), high + pad * (high > 0))
        _set_ticks(axes, which, _linear_ticks(low, high, most - 2))
        return ""
    _set_scale(axes, which, "symlog", linthresh=threshold, linscale=0.5)
    _set_limits(axes, which, low * 2.0, high * 2.0)
    _set_ticks(axes, which, signed_ticks(low, high, threshold, most))
    return threshold_note(threshold)


def threshold_note(threshold: float) -> str:
    """Say where a signed scale turns from linear to logarithmic."""
    return f"log beyond ±{power_of_ten(round(math.log10(threshold)))}"


def signed_ticks(low: float, high: float, threshold: float, most: int = 7) -> list[float]:
    """Return 0 and ± powers of ten from the threshold to either end, at most about `most`."""
    reach = [max(end, 0.0) for end in (-low, high)]
    spans = [max(math.log10(r / threshold), 0.0) if r >= threshold else -1.0 for r in reach]
    total = sum(span + 1 for span in spans)
    stride = max(1, math.ceil(total / most))
    ticks = [0.0]
    for sign, span in zip((-1.0, 1.0), spans, strict=True):
        # Count down from the largest power, so that the end of the axis is labelled.
        exponents = range(math.floor(span + 1e-9), -1, -stride)
        ticks += [sign * threshold * 10.0**e for e in exponents if e > 0 or stride == 1]
    return sorted(ticks)


def signed_norm(values: Sequence[Array], decades: int = 3) -> SymLogNorm:
    """Return a colour scale symmetric about 0, logarithmic over `decades` of the smallest panel."""
    from matplotlib.colors import SymLogNorm

    tops = [float(np.abs(v[np.isfinite(v)]).max(initial=0.0)) for v in values]
    top = max(tops, default=0.0) or 1.0
    visible = min((t for t in tops if t > 1e-9 * top), default=top)
    threshold = linear_threshold([top, visible * 10.0**-decades])
    return SymLogNorm(linthresh=threshold, linscale=0.5, vmin=-top, vmax=top, base=10)


def signed_bar_ticks(bar: Colorbar, norm: SymLogNorm, most: int = 7) -> None:
    """Put the ticks of a signed scale on a colour bar."""
    top = float(norm.vmax or 1.0)
    ticks = signed_ticks(-top, top, float(norm.linthresh), most)
    bar.set_ticks(ticks, labels=[tick_label(t) for t in ticks])
    bar.minorticks_off()


def _linear_ticks(low: float, high: float, most: int) -> list[float]:
    from matplotlib.ticker import MaxNLocator

    ticks = MaxNLocator(nbins=most, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
    return [float(t) for t in ticks if low - 1e-12 <= t <= high + 1e-12]


def tick_label(value: float) -> str:
    """Shortest text of a tick: ``−20``, ``0.5``, ``10⁻⁶``, ``2×10⁻⁴``."""
    sign = "−" if value < 0 else ""
    mantissa, exponent = f"{abs(value):.5e}".split("e")
    mantissa, power = mantissa.rstrip("0").rstrip("."), int(exponent)
    if value == 0 or -2 <= power <= 3:
        return f"{sign}{abs(value):.10g}"
    return sign + ("" if mantissa == "1" else f"{mantissa}×") + power_of_ten(power)


def _set_scale(axes: Axes, which: Which, scale: str, **options: float) -> None:
    (axes.set_xscale if which == "x" else axes.set_yscale)(scale, **options)


def _set_limits(axes: Axes, which: Which, low: float, high: float) -> None:
    (axes.set_xlim if which == "x" else axes.set_ylim)(low, high)


def _set_ticks(
    axes: Axes, which: Which, ticks: Sequence[float], texts: Sequence[str] | None = None
) -> None:
    from matplotlib.ticker import NullLocator

    axis = axes.xaxis if which == "x" else axes.yaxis
    axis.set_ticks(list(ticks), labels=texts or [tick_label(t) for t in ticks])
    axis.set_minor_locator(NullLocator())
