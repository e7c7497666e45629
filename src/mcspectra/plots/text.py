"""Format numbers and names for people: three digits, a true minus sign, powers of ten."""

from __future__ import annotations

import math
import re

from mcspectra.core.fits import is_resolved
from mcspectra.core.spec import short_spec

__all__ = [
    "LATEX_TEXT",
    "MISSING",
    "NEGLIGIBLE",
    "SUBSCRIPTS",
    "interval",
    "number",
    "number_beside",
    "percent",
    "power_of_ten",
    "rate",
    "shorten",
    "slug",
    "typeset",
    "with_error",
]

MISSING = "–"
"""Text for a missing number. Tables also give the reason."""

NEGLIGIBLE = 1e-9
"""Fraction of the largest term below which a term counts as a rounding error of the transform."""

LATEX_TEXT = str.maketrans({
    **{c: f"\\{c}" for c in "&%$#_{}"},
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
})  # fmt: skip
"""LaTeX's special characters, each with the command that prints it."""

SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LEVEL = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹₀₁₂₃₄₅₆₇₈₉ₗₘ", "-01234567890123456789lm")
_LATEX = {
    "|": "|", "<": "<", ">": ">",
    "−": "-", "±": r"\pm", "×": r"\times", "·": r"\cdot", "…": r"\dots", "∞": r"\infty",
    "≤": r"\leq", "≥": r"\geq", "≈": r"\approx", "→": r"\to", "√": r"\surd", "∫": r"\int",
    "σ": r"\sigma",
    "Σ": r"\Sigma", "⟨": r"\langle", "⟩": r"\rangle",
}  # fmt: skip
_MATHS = re.compile(f"(×10)?([⁻⁰¹²³⁴-⁹]+)|([₀-₉ₗₘ]+)|([{''.join(_LATEX)}])")
_PLAIN_POWER = re.compile(r"(?<![\w=,.])(-?)(\d(?:\.\d+)?)e([-+]\d{2,3})\b")
_FIXED_FROM, _FIXED_BELOW = -3, 5  # range of powers of ten that are written without an exponent


def number(value: float | None, digits: int = 3) -> str:
    """Format `value` with `digits` significant digits: ``0.0123``, ``−1.52``, ``4.56×10⁻⁶``, ``∞``.

    None and NaN give `MISSING`.
    """
    if value is None or math.isnan(value):
        return MISSING
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    # Round first, because rounding can change the power of ten, as for 9.996
    mantissa, exponent = f"{abs(value):.{digits - 1}e}".split("e")
    power = int(exponent)
    sign = "−" if value < 0 else ""
    if _FIXED_FROM <= power < _FIXED_BELOW:
        return f"{sign}{abs(value):.{max(digits - 1 - power, 0)}f}"
    return f"{sign}{mantissa}×{power_of_ten(power)}"


def number_beside(value: float | None, scale: float | None) -> str:
    """Return `number`, or ``≈ 0`` if the value is at rounding level compared with `scale`."""
    known = scale is not None and math.isfinite(scale)
    if value and known and abs(value) <= NEGLIGIBLE * abs(scale or 0.0):
        return "≈ 0"
    return number(value)


def with_error(value: float | None, half: float | None, beside: float | None = None) -> str:
    """Format a number ± half the width of its interval, with equal decimals: ``0.012 ± 0.034``.

    If the value is at rounding level compared with `beside`, the result is ``≈ 0``.
    """
    text = number_beside(value, beside)
    if value is None or half is None or text.startswith("≈"):
        return text
    if not (math.isfinite(value) and math.isfinite(half) and half > 0):
        return text
    first, last = (int(text.partition("e")[2]) for text in (f"{value:.9e}", f"{half:.1e}"))
    digits = min(max(first - last + 2, 1), 6)
    return f"{number(value, digits)} ± {number(half, 2)}"


def latex_maths(text: str) -> str:
    """Convert signs, exponents and indices that LaTeX fonts lack to LaTeX formulas."""

    def maths(found: re.Match[str]) -> str:
        power, raised, lowered, sign = found.groups()
        if sign:
            return f"${_LATEX[sign]}$"
        if lowered:
            return f"$_{{{lowered.translate(_LEVEL)}}}$"
        return (
            f"${power.replace('×', _LATEX['×']) if power else ''}^{{{raised.translate(_LEVEL)}}}$"
        )

    return _MATHS.sub(maths, text)


def power_of_ten(exponent: int) -> str:
    """Format a power of ten: ``10⁻⁶`` for −6."""
    return f"10{str(exponent).translate(_SUPERSCRIPTS)}"


def typeset(text: str) -> str:
    """Write the numbers in a sentence as `number` does: ``6.6e-05`` becomes ``6.6×10⁻⁵``.

    Numbers after an equals sign, as in ``width=1e-06``, are not changed: they belong to specs.
    """
    return _PLAIN_POWER.sub(
        lambda found: f"{'−' if found[1] else ''}{found[2]}×{power_of_ten(int(found[3]))}",
        text,
    )


def interval(low: float | None, high: float | None, digits: int = 3) -> str:
    """Format ``low … high``, or return `MISSING` if an end is unknown."""
    if low is None or high is None or math.isnan(low) or math.isnan(high):
        return MISSING
    return f"{number(low, digits)} … {number(high, digits)}"


def rate(value: float | None, low: float | None, high: float | None) -> str:
    """Format a rate ± half the width of its interval, ``−1.52 ± 0.03``, or return ``unresolved``.

    A rate is unresolved if half its interval exceeds 0.5.
    """
    if value is None or math.isnan(value):
        return MISSING
    if low is None or high is None or math.isnan(high - low):
        return f"{value:.2f}".replace("-", "−")
    if not is_resolved(low, high):
        return "unresolved"
    half = (high - low) / 2
    # Show two to four decimals, depending on the width of the interval
    decimals = 4 if half <= 0 else min(max(-math.floor(math.log10(half)), 2), 4)
    spread = f"± {half:.{decimals}f}" if half >= 0.5e-4 else "± <0.0001"
    return f"{round(value, decimals) + 0.0:.{decimals}f} {spread}".replace("-", "−")  # avoids −0.00


def percent(fraction: float) -> str:
    """Format a fraction as ``97 %``. Near 0 and 100, more digits avoid rounding to 0 or 100."""
    value = 100.0 * fraction
    distance = min(abs(value), abs(100.0 - value))
    if math.isnan(value):
        return MISSING
    if distance == 0 or abs(value) >= 1000:
        return f"{number(value)} %"
    decimals = 0 if distance >= 1 else min(-math.floor(math.log10(distance)), 9)
    return f"{value:.{decimals}f} %".replace("-", "−")


def shorten(text: str, length: int = 30) -> str:
    """Shorten a text to one line of at most `length` characters, by omitting its middle.

    If a part of a spec has the parameter ``name=``, the given name replaces this part.
    Words are kept whole, unless this would remove more than a third of the beginning or the end.
    """
    line = short_spec(" ".join(text.split()))
    if len(line) <= length:
        return line
    head = (length - 1) * 2 // 3
    rest = len(line) - (length - 1 - head)
    start, end = line[:head], line[rest:]
    if re.match(r"\w\w", line[head - 1 : head + 1]):
        whole = re.sub(r"\w+$", "", start)
        start = whole if 3 * len(whole) >= 2 * len(start) else start
    if re.match(r"\w\w", line[rest - 1 : rest + 1]):
        whole = re.sub(r"^\w+", "", end)
        end = whole if 3 * len(whole) >= 2 * len(end) else end
    return f"{start.rstrip()}…{end.lstrip()}"


def slug(text: str) -> str:
    """Return a name for files and anchors that has only small letters, digits, dots and hyphens."""
    return re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-.") or "x"
