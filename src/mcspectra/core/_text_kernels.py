"""Numba kernel that reads the numbers of UTK text. They are rounded correctly, but not checked.

A decimal number w/10^k with at most 19 digits and k ≤ 22 is divided in twice float64 precision.
The integers w and 10^k are exact. Their float64 quotient has a remainder that is computed exactly.
The remainder divided by 10^k gives a correction, which is added to the quotient.
The corrected quotient is rounded correctly, except near a midpoint of two float64 numbers.
"Near" means within about 2^-40 of the distance between neighboring float64 numbers.
The caller must read decimal numbers near a midpoint, and decimal numbers of other forms, itself.
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["parse_lines"]

_NEWLINE, _RETURN, _TAB, _SPACE = 10, 13, 9, 32
_PLUS, _MINUS, _POINT, _HASH, _ZERO = 43, 45, 46, 35, 48
_LAST = 126  # last printable character of ASCII
_SPLIT = 2.0**27 + 1.0  # splits a float64 into two halves whose products are exact
_DOUBT = 1.0 + 2.0**-40
_DIGITS = 19  # largest number of digits for which every number fits into 64 bits
_POWERS = 10.0 ** np.arange(23)  # powers of ten that are exact


@kernel
def _quotient(w: np.uint64, power: float) -> float:
    # Return w / power rounded correctly, or NaN if the rounding is in doubt.
    high = float(w)
    low = float(np.int64(w - np.uint64(high)))
    first = high / power

    # Compute remainder = high − first · power, exactly
    c = _SPLIT * first
    a1 = c - (c - first)
    c = _SPLIT * power
    b1 = c - (c - power)
    a2, b2, product = first - a1, power - b1, first * power
    error = ((a1 * b1 - product) + a1 * b2 + a2 * b1) + a2 * b2
    remainder = (high - product) - error

    second = (remainder + low) / power
    total = first + second
    tail = second - (total - first)
    return total if total + tail * _DOUBT == total else np.nan


@kernel
def parse_lines(text: Array, values: Array, runs: Array, hard: Array) -> tuple[int, int, int, int]:
    """Read lines of numbers from the bytes `text` into the arrays `values`, `runs` and `hard`.

    Parameters
    ----------
    text
        Bytes of whole lines, as uint8.
    values
        The numbers in the order of the text, as float64.
    runs
        int64 (K, 4): consecutive lines of numbers, with no comment between them, share one row.
        A row has four entries. The first is the index of the first line with numbers, from 0.
        Entries two and three are the index of the first value and the index after the last value.
        The last entry is the number of values per line.
        Each comment also has a row, whose number of values per line is 0.
    hard
        int64 (N, 3): one row for each value that the caller has to read.
        A row holds the index of the value, its first byte, and the byte after its last one.

    Returns
    -------
    tuple of int
        Number of lines, and numbers of entries in the three outputs `values`, `runs` and `hard`.
        The number of lines is −1 if the text is not printable ASCII, or has words outside comments.
        The number of lines is also −1 if two lines have different numbers of values,
        and no comment is between these lines.
    """
    bad = (-1, 0, 0, 0)
    line = count = used = left = 0
    width = 0  # number of values per line in the current run, or 0 before a run starts
    on_line = 0  # number of values read from this line
    i, size = 0, text.size
    while i < size:
        byte = text[i]
        if byte == _NEWLINE or (byte == _RETURN and i + 1 < size and text[i + 1] == _NEWLINE):
            if on_line:
                if width == 0:
                    width = on_line
                    runs[used, 0], runs[used, 1] = line, count - on_line
                    runs[used, 3] = width
                    used += 1
                elif on_line != width:
                    return bad
                runs[used - 1, 2] = count
                on_line = 0
            line += 1
            i += 1 if byte == _NEWLINE else 2
            continue
        if byte in (_SPACE, _TAB):
            i += 1
            continue
        if byte == _HASH and on_line == 0:
            while i < size and text[i] != _NEWLINE and text[i] != _RETURN:
                if (text[i] < _SPACE and text[i] != _TAB) or text[i] > _LAST:
                    return bad
                i += 1
            runs[used, 0], runs[used, 1], runs[used, 2], runs[used, 3] = line, count, count, 0
            used += 1
            width = 0
            continue

        # Read the sign, the digits with a decimal point, and the exponent
        start, negative = i, byte == _MINUS
        if byte in (_MINUS, _PLUS):
            i += 1
        whole, digits, seen, places, point = np.uint64(0), 0, 0, 0, False
        while i < size:
            digit = np.int64(text[i]) - _ZERO
            if 0 <= digit <= 9:
                seen += 1
                if digits or digit:
                    digits += 1
                if digits <= _DIGITS:
                    whole = whole * np.uint64(10) + np.uint64(digit)
                places += point
            elif text[i] == _POINT and not point:
                point = True
            else:
                break
            i += 1
        if seen == 0:
            return bad
        if i < size and (text[i] | 32) == 101:  # e or E
            i += 1
            below = i < size and text[i] == _MINUS
            if i < size and (text[i] == _MINUS or text[i] == _PLUS):
                i += 1
            first, exponent = i, 0
            while i < size and _ZERO <= text[i] <= _ZERO + 9:
                exponent = min(10 * exponent + int(text[i]) - _ZERO, 10**6)
                i += 1
            if i == first:
                return bad
            places += exponent if below else -exponent
        if i < size and text[i] > _SPACE:
            return bad

        value = np.nan
        if digits <= _DIGITS:
            if digits == 0:
                value = 0.0
            elif 0 <= places < _POWERS.size:
                value = _quotient(whole, _POWERS[places])
        if np.isnan(value):
            hard[left, 0], hard[left, 1], hard[left, 2] = count, start, i
            left += 1
        values[count] = -value if negative else value
        count += 1
        on_line += 1
    if on_line:
        return bad
    return line, count, used, left
