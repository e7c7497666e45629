"""Axes and color scales made from the data, for many orders of magnitude and signed values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, Mark, Panel, Scale
from mcspectra.plots.text import power_of_ten

__all__ = [
    "count_axis",
    "linear_axis",
    "log_axis",
    "log_scale",
    "log_ticks",
    "name_axis",
    "scaled_axis",
    "signed_axis",
    "signed_place",
    "signed_scale",
    "tick_label",
    "unit_axis",
    "unit_panel",
    "whole_ticks",
]

_LINEAR_SPAN = 30.0  # largest ratio of the largest to the smallest value on a linear scale
_NEAR_ZERO = 0.5  # size in decades of each half of the linear part of a signed scale
_APART = 0.6  # least distance of ticks from 0 on a signed scale, in decades
_SEEN = 0.1  # values below this fraction of the threshold look like 0
_SHORT = 1.6  # in fewer decades, powers of ten would give too few ticks
_MOST_DECADES = 6  # largest number of decades between the largest value and the threshold
_NOTHING = 1e-9  # an array is ignored if all its values are below this fraction of the largest


def linear_axis(label: str, low: float, high: float, most: int = 6) -> Axis:
    """Return a linear axis from `low` to `high` with a small margin and round ticks."""
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        low, high = 0.0, 1.0
    pad = 0.04 * (high - low)
    low, high = low - pad if low else low, high + pad
    ticks = {tick: tick_label(tick) for tick in _round_steps(low, high, most)}
    return Axis(label=label, low=low, high=high, ticks=ticks)


def scaled_axis(label: str, low: float, high: float, most: int = 6) -> Axis:
    """Return a linear axis. If its ticks have a common power of ten, the label contains it."""
    axis = linear_axis(label, low, high, most)
    top = max(abs(tick) for tick in axis.ticks or {0.0: ""})
    power = math.floor(math.log10(top)) if top else 0
    if -2 <= power <= 3:
        return axis
    ticks = {tick: tick_label(tick / 10.0**power) for tick in axis.ticks or {}}
    return replace(axis, label=f"{label}   (× {power_of_ten(power)})", ticks=ticks)


def log_axis(label: str, low: float, high: float, most: int = 6) -> Axis:
    """Return a logarithmic axis from `low` to `high` with a small margin."""
    if not (math.isfinite(low) and math.isfinite(high) and 0.0 < low <= high):
        low, high = 0.5, 2.0
    margin = (high / low) ** 0.04 if high > low else 2.0
    low, high = low / margin, high * margin
    return Axis(label=label, kind="log", low=low, high=high, ticks=log_ticks(low, high, most))


def count_axis(label: str, counts: Iterable[int], most: int = 6) -> Axis:
    """Return a logarithmic axis with ticks at numbers of points. Tick labels do not touch."""
    distinct = sorted(set(counts))
    margin = (distinct[-1] / distinct[0]) ** 0.05 if len(distinct) > 1 else 2.0
    gap = math.log(distinct[-1] / distinct[0]) / most
    chosen = [distinct[-1]]
    for n in reversed(distinct[:-1]):
        if math.log(chosen[-1] / n) >= 0.999 * gap:
            chosen.append(n)
    ticks = {float(n): str(n) for n in reversed(chosen)}
    low, high = distinct[0] / margin, distinct[-1] * margin
    return Axis(label=label, kind="log", low=low, high=high, ticks=ticks)


def name_axis(names: Sequence[str], label: str = "", *, flipped: bool = True) -> Axis:
    """Return an axis with names at 0, 1, 2, …, from top to bottom by default."""
    ticks = {float(k): name for k, name in enumerate(names)}
    return Axis(label=label, low=-0.6, high=len(names) - 0.4, ticks=ticks, flipped=flipped)


def unit_axis(label: str) -> Axis:
    """Return an axis from 0 to 1 with a tick at each end."""
    return Axis(label=label, low=0.0, high=1.0, ticks={0.0: "0", 1.0: "1"})


def unit_panel(marks: Iterable[Mark], title: str, x: str = "x₀", y: str = "x₁") -> Panel:
    """Return a panel for marks in the unit square."""
    across, up = unit_axis(x), unit_axis(y)
    return Panel(marks=tuple(marks), x=across, y=up, title=title, square=True, framed=True)


def whole_ticks(low: float, high: float, most: int = 6) -> dict[float, str]:
    """Return ticks at integers in [low, high]."""
    steps = _round_steps(low, high, most)
    return {tick: tick_label(tick) for tick in steps if float(tick).is_integer()}


def signed_axis(
    label: str, values: Sequence[Array], most: int = 7, *, whiskers: Array | None = None
) -> Axis:
    """Return an axis for signed values: linear if the smallest value is visible, else logarithmic.

    The label gives the threshold at which the logarithmic part begins.
    The finite ends of error bars, `whiskers`, extend the axis on each side.
    On each side, the extension is at most as long as the range of the values.
    """
    low, high, threshold = _signed_range(values, _MOST_DECADES)
    if whiskers is not None:
        ends, room = whiskers[np.isfinite(whiskers)], high - low
        low = min(low, max(float(ends.min(initial=0.0)), low - room))
        high = max(high, min(float(ends.max(initial=0.0)), high + room))
    if not threshold:
        pad = 0.06 * (high - low) or 1.0
        ticks = {t: tick_label(t) for t in _round_steps(low, high, most - 2)}
        low = low - pad if low < 0 or low == high else low
        return Axis(label=label, low=low, high=high + pad, ticks=ticks)
    # If an end of the axis is closer to 0 than the threshold, but too large to look like 0,
    # move the end to the threshold, so that the values near the end can be seen
    low, high = (
        math.copysign(threshold, end) if _SEEN * threshold < abs(end) < threshold else end
        for end in (low, high)
    )
    return Axis(
        label=f"{label}   ({_threshold_note(threshold)})",
        kind="signed",
        low=2.0 * low,
        high=2.0 * high,
        ticks={t: tick_label(t) for t in _signed_ticks(low, high, threshold, most)},
        threshold=threshold,
    )


def log_scale(label: str, low: float, high: float) -> Scale:
    """Return a logarithmic color scale from `low` to `high`."""
    if not (math.isfinite(low) and math.isfinite(high) and 0.0 < low < high):
        low, high = 0.5, 2.0
    return Scale(label=label, kind="log", low=low, high=high, ticks=log_ticks(low, high))


def signed_scale(label: str, values: Sequence[Array], decades: int = 3) -> Scale:
    """Return a color scale for several arrays that is symmetric about 0.

    Parameters
    ----------
    label
        Label of the color bar, to which the threshold of the logarithmic part is added.
    values
        Arrays of any shape. Values that are not finite are ignored.
    decades
        Number of decades below the largest magnitude of each array that the scale resolves.
        The whole scale has at most six decades.
    """
    low, high, threshold = _signed_range(values, decades)
    top = max(high, -low) or 1.0
    if not threshold:
        ticks = {t: tick_label(t) for t in _round_steps(-top, top, 5)}
        return Scale(label=label, low=-top, high=top, ticks=ticks, palette="diverging")
    return Scale(
        label=f"{label}   ({_threshold_note(threshold)})",
        kind="signed",
        low=-top,
        high=top,
        ticks={t: tick_label(t) for t in _signed_ticks(-top, top, threshold, 5)},
        threshold=threshold,
        palette="diverging",
    )


def signed_place(values: Array, threshold: float) -> Array:
    """Return positions of values on a signed scale in decades; NaN if a value is not finite."""
    given = np.where(np.isfinite(values), values, np.nan)
    size = np.abs(given) / threshold
    decades = _NEAR_ZERO + np.log10(np.maximum(size, 1.0))
    return np.asarray(np.sign(given) * np.where(size < 1, _NEAR_ZERO * size, decades))


def log_ticks(low: float, high: float, most: int = 6) -> dict[float, str]:
    """Return about `most` ticks in [low, high]: powers of ten, or finer steps in a short range."""
    first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
    if math.log10(high / low) >= _SHORT:
        stride = math.ceil((last - first + 1) / most)
        return {t: tick_label(t) for t in (10.0**e for e in range(first, last + 1, stride))}
    ticks: list[float] = []
    for steps in ((1, 2, 5), range(1, 10), [c / 10 for c in range(10, 100)]):
        every = [c * 10.0**e for e in range(first - 1, last + 1) for c in steps]
        ticks = [t for t in every if low <= t <= high]
        if len(ticks) >= 2:
            break
    return {t: tick_label(t) for t in ticks[:: max(1, math.ceil(len(ticks) / most))]}


def tick_label(value: float) -> str:
    """Return the shortest text for a tick: ``−20``, ``0.5``, ``10⁻⁶``, ``2×10⁻⁴``."""
    sign = "−" if value < 0 else ""
    mantissa, exponent = f"{abs(value):.5e}".split("e")
    mantissa, power = mantissa.rstrip("0").rstrip("."), int(exponent)
    if value == 0 or -2 <= power <= 3:
        return f"{sign}{abs(value):.10g}"
    return sign + ("" if mantissa == "1" else f"{mantissa}×") + power_of_ten(power)


def _signed_range(values: Sequence[Array], decades: int) -> tuple[float, float, float]:
    """Return both ends of a range that includes 0, and the threshold (0 for a linear scale)."""
    every = np.concatenate([np.ravel(v) for v in values]) if len(values) else np.zeros(0)
    finite = every[np.isfinite(every)]
    low, high = float(finite.min(initial=0.0)), float(finite.max(initial=0.0))
    top = max(high, -low)
    if not top:
        return low, high, 0.0
    tops = [float(np.max(np.abs(v), where=np.isfinite(v), initial=0.0)) for v in values]
    told_apart = [each * 10.0**-decades for each in tops if each > _NOTHING * top]
    least = max(
        float(np.abs(finite[finite != 0]).min()), min(told_apart), top * 10.0**-_MOST_DECADES
    )
    threshold = 10.0 ** math.floor(math.log10(least))
    return low, high, 0.0 if top <= _LINEAR_SPAN * threshold else threshold


def _threshold_note(threshold: float) -> str:
    return f"log beyond ±{power_of_ten(round(math.log10(threshold)))}"


def _signed_ticks(low: float, high: float, threshold: float, most: int) -> list[float]:
    """Return about `most` ticks: 0 and ± powers of ten, with at least one tick on each side."""
    reach = [max(end, 0.0) for end in (-low, high)]
    spans = [max(math.log10(r / threshold), 0.0) if r >= threshold else -1.0 for r in reach]
    stride = max(1, math.ceil(sum(span + 1 for span in spans) / most))
    ticks = [0.0]
    for sign, end, span in zip((-1.0, 1.0), reach, spans, strict=True):
        # Start with the largest power, so that the end of the axis has a label
        sizes = [threshold * 10.0**e for e in range(math.floor(span + 1e-9), -1, -stride)]
        if len(sizes) == 1 and end < 10 * threshold:
            sizes = [next(s * threshold for s in (5, 2, 1) if s * threshold <= end * (1 + 1e-9))]
        clear = [s for s in sizes if signed_place(np.array(s), threshold) >= _APART]
        ticks += [sign * size for size in clear or sizes[:1]]
    return sorted(ticks)


def _round_steps(low: float, high: float, most: int) -> list[float]:
    """Return the multiples in [low, high] of 1, 2 or 5 times a power of ten."""
    if high <= low:
        return [0.0]
    rough = (high - low) / most
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(s * power for s in (1, 2, 5, 10) if s * power >= 0.999 * rough)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [k * step for k in range(first, last + 1)]
