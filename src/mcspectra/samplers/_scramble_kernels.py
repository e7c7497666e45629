"""Numba kernels that scramble digits by XOR, permutations, nested permutations, hashes, matrices.

Notation: R realizations, n points, d dims; ``keys`` uint64 (R, 2) from `Stream.keys`.
The bases of the digits are int64 (d,), and the results float64 (R, n, d).
The given points are float64 (R, n, d), or (1, n, d) if all realizations share a set.

The first kernels are for base 2. A coordinate is a word of 32 or 53 bits; the highest bit means ½.

In any base b, a coordinate x is read as the whole number v = ⌊x b^m⌋.
The number of digits m is the smallest with b^m ≥ 2^32.
First, x is increased by 2^-52, because the float for k/b^p may have been rounded down.

Let v' be the scrambled number v, and let t be a random whole number of k bits.
Here k is the largest number with b^m 2^k ≤ 2^50. The result is (v' + (t + ½) 2^-k)/b^m.
The scrambled coordinate is uniform to 50 bits, and far from every multiple of b^-p.
Therefore neither rounding nor ⌊x b^p⌋ in floating point moves the result to another interval.

Random numbers with indices below 2^62 or at least 2^63 are used for binary digits.
Random numbers from index 2^62 to below 2^63 are used for the nodes of digit trees in other bases.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_bits, mix_uniform
from mcspectra.samplers._digital_kernels import double_words
from mcspectra.samplers._kernels import _mix_below

__all__ = [
    "fill_inverses",
    "fill_mixed",
    "fill_nested",
    "fill_permuted",
    "mix_matrices",
    "mix_triangles",
    "permute_digits",
    "scramble_hashed",
    "scramble_trees",
    "xor_digits",
]

_ONE, _TREE, _TAIL = np.uint64(1), np.uint64(1 << 62), np.uint64(1 << 63)
_S11, _S21, _S32, _S43 = np.uint64(11), np.uint64(21), np.uint64(32), np.uint64(43)
# Number of bits for the number of a node in a digit tree. Node numbers are below 2^33:
# a node on some level of the tree has the number b^level + v, with v < 2^32.
_S34 = np.uint64(34)
_LOW32 = np.uint64(0xFFFFFFFF)
_TO_53, _UNIT_53, _TO_32 = 2.0**53, 2.0**-53, 2.0**32
_WORDS = 512  # words in a block that is scrambled at once: 4 kB
_TABLE = 1024  # number of entries in a table of digit groups: 8 kB
_USED_UP = 2**32
_LEAST, _FINEST = 2.0**32, 2.0**50


@kernel
def xor_digits(keys: Array, points: Array, out: Array) -> None:
    """Digital shift: XOR the 53 leading bits with one random word per coordinate."""
    count, n, dims = out.shape
    words = np.empty(dims, np.uint64)
    for r in range(count):
        one = points[r % points.shape[0]]
        for j in range(dims):
            words[j] = mix_bits(keys[r, 0], keys[r, 1], j) >> _S11
        for i in range(n):
            for j in range(dims):
                digits = np.uint64(one[i, j] * _TO_53)
                out[r, i, j] = np.float64(digits ^ words[j]) * _UNIT_53


@kernel
def _with_tail(k0: np.uint64, k1: np.uint64, number: int, word: Any) -> Any:
    # Return a number in [0,1) with the given 32 leading bits; the lower bits are random.
    address: Any = _TAIL | np.uint64(number)
    tail = mix_bits(k0, k1, address) >> _S43
    return np.float64(np.int64((np.uint64(word) << _S21) | tail)) * _UNIT_53


@kernel
def _six_flips(bits: Any, piece: Any) -> Any:
    # Return for each of six bits whether scrambling flips it, the highest bit first.
    # The node that decides on the flip of a bit depends on all higher bits.
    # Nodes are numbered as in a heap: node v has the children 2v and 2v + 1.
    # Bit v of the random word `bits` decides whether node v flips its bit.
    # The decision bit of each node is shifted to the position of the bit that the node may flip.
    moved = bits << np.uint64(4)
    flips = (moved & np.uint64(32)) | (
        (moved >> (np.uint64(2) + (piece >> np.uint64(5)))) & np.uint64(16)
    )
    flips |= (bits >> (np.uint64(1) + (piece >> np.uint64(4)))) & np.uint64(8)
    flips |= (bits >> (np.uint64(6) + (piece >> np.uint64(3)))) & np.uint64(4)
    flips |= (bits >> (np.uint64(15) + (piece >> np.uint64(2)))) & np.uint64(2)
    return flips | ((bits >> (np.uint64(32) + (piece >> _ONE))) & _ONE)


@kernel
def _flip_two_levels(
    k0: np.uint64, k1: np.uint64, dim: int, level: int, w: Array, out: Array
) -> None:
    # Flip two groups of six levels in all words; the loop has no branches, so it is vectorized
    root, six = np.uint64(dim) << _S32, np.uint64(63)
    upper, lower = root | (_ONE << np.uint64(level)), root | (_ONE << np.uint64(level + 6))
    above, between, below = np.uint64(32 - level), np.uint64(26 - level), np.uint64(20 - level)
    for i in range(w.size):
        word = w[i]
        first: Any = upper | (word >> above)
        second: Any = lower | (word >> between)
        flips = _six_flips(mix_bits(k0, k1, first), (word >> between) & six) << between
        out[i] ^= flips | (_six_flips(mix_bits(k0, k1, second), (word >> below) & six) << below)


@kernel
def _nest(
    k0: np.uint64, k1: np.uint64, dim: int, dims: int, start: int, w: Array, out: Array
) -> None:
    # Apply nested scrambling to the 32-bit words w of points start, start + 1, …; result in out.
    # The flip of a bit depends on all higher bits. One 64-bit hash holds the flips of six levels.
    words = w.copy()
    root: Any = (np.uint64(dim) << _S32) | _ONE
    bits = mix_bits(k0, k1, root)
    for i in range(w.size):
        words[i] ^= _six_flips(bits, w[i] >> np.uint64(26)) << np.uint64(26)
    _flip_two_levels(k0, k1, dim, 6, w, words)
    _flip_two_levels(k0, k1, dim, 18, w, words)
    last = (np.uint64(dim) << _S32) | np.uint64(1 << 30)
    for i in range(w.size):
        word = w[i]
        node: Any = last | (word >> np.uint64(2))
        bits = mix_bits(k0, k1, node) >> _ONE
        second = (bits >> (_ONE + ((word >> _ONE) & _ONE))) & _ONE
        words[i] ^= ((bits & _ONE) << _ONE) | second
    for i in range(w.size):
        out[i] = _with_tail(k0, k1, (start + i) * dims + dim, words[i])


@kernel
def _reversed(word: Any) -> Any:
    # Reverse the bits of a 32-bit word by swaps of halves, which compilers recognize.
    x = np.uint32(word)
    x = np.uint32(np.uint32(x >> 16) | np.uint32(x << 16))
    x = np.uint32(np.uint32((x >> 8) & 0x00FF00FF) | np.uint32((x & 0x00FF00FF) << 8))
    x = np.uint32(np.uint32((x >> 4) & 0x0F0F0F0F) | np.uint32((x & 0x0F0F0F0F) << 4))
    x = np.uint32(np.uint32((x >> 2) & 0x33333333) | np.uint32((x & 0x33333333) << 2))
    return np.uint32(np.uint32((x >> 1) & 0x55555555) | np.uint32((x & 0x55555555) << 1))


@kernel
def _hashed(word: Any, add: Any, factor: Any, add_2: Any, factor_2: Any) -> Any:
    # Hash a reversed word so that every bit depends only on the bits below.
    # In the XOR of x and an even multiple of x, every bit depends only on the bits below.
    # In the product (x + summand) · (odd factor), every bit also depends only on lower bits.
    # All numbers are uint32.
    x = np.uint32(word)
    x = np.uint32(x ^ np.uint32(x * np.uint32(0x3D20ADEA)))
    x = np.uint32(np.uint32(x + add) * factor)
    x = np.uint32(x ^ np.uint32(x * np.uint32(0x05526C56)))
    x = np.uint32(np.uint32(x + add_2) * factor_2)
    return np.uint32(x ^ np.uint32(x * np.uint32(0x53A22864)))


@kernel
def _hash_keys(k0: np.uint64, k1: np.uint64, out: Array) -> None:
    # Fill out uint32 (d, 4) with two summands and two odd factors for each coordinate
    for j in range(out.shape[0]):
        for part in range(2):
            bits = mix_bits(k0, k1, 2 * j + part)
            out[j, 2 * part] = np.uint32(bits >> _S32)
            out[j, 2 * part + 1] = np.uint32(bits) | np.uint32(1)


@kernel
def scramble_hashed(keys: Array, points: Array, out: Array) -> None:
    """Hash-based Owen scrambling of the first 32 bits; all lower bits are random and uniform."""
    count, n, dims = out.shape
    hash_keys, block = np.empty((dims, 4), np.uint32), np.empty(_WORDS, np.uint32)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        one = points[r % points.shape[0]]
        _hash_keys(k0, k1, hash_keys)
        for start in range(0, n, _WORDS):
            words = block[: min(_WORDS, n - start)]
            for j in range(dims):
                # Three separate loops, so that the compiler vectorizes the loop that hashes words
                add, factor, add_2, factor_2 = hash_keys[j]
                for i in range(words.size):
                    words[i] = np.uint32(np.int64(one[start + i, j] * _TO_32))
                for i in range(words.size):
                    hashed = _hashed(_reversed(words[i]), add, factor, add_2, factor_2)
                    words[i] = _reversed(hashed)
                for i in range(words.size):
                    number = (start + i) * dims + j
                    out[r, start + i, j] = _with_tail(k0, k1, number, words[i])


@kernel
def _draw_matrices(k0: np.uint64, k1: np.uint64, shift: bool, columns: Array, words: Array) -> None:
    # Make lower triangular matrices with unit diagonal: columns uint64 (d, 53), shift words (d,)
    dims = words.size
    for j in range(dims):
        for c in range(53):
            below = mix_bits(k0, k1, dims + j * 53 + c) >> np.uint64(c + 12)
            columns[j, c] = (_ONE << np.uint64(52 - c)) | (below if c < 52 else np.uint64(0))
        words[j] = mix_bits(k0, k1, j) >> _S11 if shift else np.uint64(0)


@kernel
def _product(columns: Array, digits: Any) -> Any:
    # Multiply a matrix by the bits of a 64-bit word, whose highest bit is the first digit
    product, c = np.uint64(0), 0
    while digits:
        if digits & _TAIL:
            product ^= columns[c]
        digits, c = digits << _ONE, c + 1
    return product


@kernel
def mix_matrices(keys: Array, shift: bool, points: Array, out: Array) -> None:
    """Multiply the 53 bits of points by random lower triangular matrices with unit diagonal.

    With `shift`, one random word, the same for all points, is then added (XOR).
    """
    count, n, dims = out.shape
    columns, words = np.empty((dims, 53), np.uint64), np.empty(dims, np.uint64)
    for r in range(count):
        _draw_matrices(keys[r, 0], keys[r, 1], shift, columns, words)
        one = points[r % points.shape[0]]
        for i in range(n):
            for j in range(dims):
                digits = np.uint64(one[i, j] * _TO_53) << _S11
                mixed = _product(columns[j], digits) ^ words[j]
                out[r, i, j] = np.float64(np.int64(mixed)) * _UNIT_53


@kernel
def fill_mixed(keys: Array, shift: bool, directions: Array, out: Array) -> None:
    """Same as `mix_matrices` for points 0 … n − 1 of a sequence with columns uint32 (d, 32)."""
    count, n, dims = out.shape
    columns, words = np.empty((dims, 53), np.uint64), np.empty(dims, np.uint64)
    points, mixed = np.empty(n, np.uint64), np.empty(32, np.uint64)
    for r in range(count):
        _draw_matrices(keys[r, 0], keys[r, 1], shift, columns, words)
        for j in range(dims):
            k = 0
            while k < 32 and (1 << k) < n:
                mixed[k] = _product(columns[j], np.uint64(directions[j, k]) << _S32)
                k += 1
            points[0] = words[j]
            double_words(mixed, points)
            for i in range(n):
                out[r, i, j] = np.float64(np.int64(points[i])) * _UNIT_53


@kernel
def _format(base: int) -> tuple[int, float, float, float]:
    # Return the number of digits m, b^m, the rounding correction to add before ⌊·⌋, and 2^-k.
    places, scale, unit = 0, 1.0, 1.0
    while scale < _LEAST:
        places, scale = places + 1, scale * base
    while 2.0 * scale <= _FINEST * unit:
        unit *= 0.5
    nudge = 0.0 if base & (base - 1) == 0 else scale * 2.0**-52
    return places, scale, nudge, unit


@kernel
def _read(x: float, scale: float, nudge: float) -> Any:
    return np.int64(min(x * scale + nudge, scale - 1.0))


@kernel
def _middle(tail: float, unit: float) -> Any:
    # Return the middle of the interval of length `unit` = 2^-k that contains `tail`.
    return (np.floor(tail / unit) + 0.5) * unit


@kernel
def _write(v: int, tail: float, scale: float, unit: float) -> Any:
    return (np.float64(v) + _middle(tail, unit)) / scale


@kernel
def _quotient(v: int, inverse: float) -> Any:
    # Compute ⌊v/b⌋ as ⌊(v + ½)/b⌋ with the float 1/b.
    # The result is exact, because for v < 2^45 the rounding error is below 2^-7/b < ½/b.
    return np.int64((np.float64(v) + 0.5) * inverse)


@kernel
def _draw_permutation(k0: np.uint64, k1: np.uint64, number: int, order: Array) -> None:
    for t in range(order.size):
        order[t] = t
    for t in range(order.size - 1):
        chosen = t + _mix_below(k0, k1, number + t, order.size - t)
        order[t], order[chosen] = order[chosen], order[t]


@kernel
def _draw_images(k0: Any, k1: Any, number: int, places: int, base: int, shift: bool) -> Any:
    # Draw the random image of each digit in each place, the lowest place first: int64 (m, b).
    # Also draw one uniform number that replaces all lower digits of every point.
    out = np.empty((places, base), np.int64)
    for k in range(places):
        if shift:
            out[k] = (np.arange(base) + _mix_below(k0, k1, number, base)) % base
        else:
            _draw_permutation(k0, k1, number, out[k])
        number += base
    return out, mix_uniform(k0, k1, number)


@kernel
def _group_images(images: Array, most: int) -> Array:
    # Tabulate the images of groups of digits, at most `most` per group: (groups, b^digits)
    places, base = images.shape
    size, digits = base, 1
    while size * base <= most and digits < places:
        size, digits = size * base, digits + 1
    groups = (places + digits - 1) // digits
    table = np.zeros((groups, size), np.int64)
    for g in range(groups):
        for v in range(size):
            rest, weight = v, 1
            for k in range(g * digits, min((g + 1) * digits, places)):
                table[g, v] += images[k, rest % base] * weight
                rest, weight = rest // base, weight * base
    return table


@kernel
def permute_digits(keys: Array, bases: Array, shift: bool, points: Array, out: Array) -> None:
    """Permute each digit at random, equally for all points; with `shift`, add a random digit.

    The part below the last digit is one uniform number per coordinate, the same for all points.
    """
    n = out.shape[1]
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        number, one = 0, points[r % points.shape[0]]
        for j in range(out.shape[2]):
            places, scale, nudge, unit = _format(bases[j])
            images, tail = _draw_images(k0, k1, number, places, bases[j], shift)
            number += images.size + 1
            table = _group_images(images, min(n, _TABLE))
            groups, size = table.shape
            for i in range(n):
                v = _read(one[i, j], scale, nudge)
                permuted, weight = 0, 1
                for g in range(groups):  # lowest group first
                    above = _quotient(v, 1.0 / size)
                    permuted += table[g, v - above * size] * weight
                    v, weight = above, weight * size
                out[r, i, j] = _write(permuted, tail, scale, unit)


@kernel
def _invert_digits(images: Array, start: int, scale: float, tail: float, out: Array) -> None:
    # Write the radical inverses of start, start + 1, … to the array out (n,).
    # Each digit is replaced by its image; images (m, b) lists the images of b digits at m places.
    # The number `tail`, in units of b^-m = 1/scale, is added to every radical inverse.
    # All sums are exact.
    (places, base), n = images.shape, out.size

    # Tabulate the images of the lowest digits of the index, as long as the table saves time
    size, low = base, 1
    while low < places and size * base <= min(n, _TABLE):
        size, low = size * base, low + 1
    table = np.zeros(size)
    width, weight = 1, base ** (places - 1)
    for k in range(low):
        # table[v] is the sum of the images of the lower digits of v.
        # Digit 0 comes last, because it overwrites the sums, which all other digits need
        for digit in range(base - 1, -1, -1):
            image = np.float64(images[places - 1 - k, digit] * weight)
            for v in range(width):
                table[digit * width + v] = table[v] + image
        width, weight = width * base, weight // base

    # Add the images of the higher digits, which are equal for `size` successive indices
    i, v, block = 0, start % size, start // size
    while i < n:
        high, unit_above, rest = 0, weight, block
        for k in range(low, places):
            high += images[places - 1 - k, rest % base] * unit_above
            unit_above, rest = unit_above // base, rest // base
        stop, above = min(n, i + size - v), np.float64(high) + tail
        for t in range(i, stop):
            out[t] = (table[v + t - i] + above) / scale
        i, v, block = stop, 0, block + 1


@kernel
def fill_inverses(bases: Array, start: int, out: Array) -> None:
    """Fill out (n, d) with the radical inverses of start, start + 1, … in each base."""
    for j in range(bases.size):
        places, scale, _, _ = _format(bases[j])
        images = np.empty((places, bases[j]), np.int64)
        images[:] = np.arange(bases[j])
        _invert_digits(images, start, scale, 0.0, out[:, j])


@kernel
def fill_permuted(keys: Array, bases: Array, shift: bool, start: int, out: Array) -> None:
    """Same as `permute_digits` for the radical inverses of start, start + 1, …"""
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        number = 0
        for j in range(out.shape[2]):
            places, scale, _, unit = _format(bases[j])
            images, tail = _draw_images(k0, k1, number, places, bases[j], shift)
            number += images.size + 1
            _invert_digits(images, start, scale, _middle(tail, unit), out[r, :, j])


@kernel
def fill_nested(keys: Array, bases: Array, out: Array) -> None:
    """Fill `out` with radical inverses of 0, 1, … after Owen's nested uniform scrambling.

    Radical inverses of other consecutive whole numbers would give points of the same distribution.
    Point v + c b^l, with v < b^l and 0 < c < b, shares its first l digits with point v.
    Point v and the b − 1 points v + c b^l all differ in the next digit. Lower digits are uniform.
    Each point is derived from an earlier point only, so the first points do not depend on n.
    """
    n, dims = out.shape[1:]
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        for j in range(dims):
            base = bases[j]
            order, picks = np.arange(base), np.empty(base, np.int64)
            places, scale, _, _ = _format(base)
            row = out[r, :, j]
            row[0] = mix_uniform(k0, k1, 2 * j) * scale
            width, span = 1, base ** (places - 1)
            while width < n:
                for v in range(min(width, n - width)):
                    prefix = np.int64(row[v]) // span
                    digit = prefix % base
                    count = min(base - 1, (n - 1 - v) // width)
                    for c in range(1, count + 1):
                        i = v + c * width
                        number = 2 * (i * dims + j)
                        picks[c] = c + _mix_below(k0, k1, number + 1, base - c)
                        order[c], order[picks[c]] = order[picks[c]], order[c]
                        other = prefix - digit + (digit + order[c]) % base
                        row[i] = (other + mix_uniform(k0, k1, number)) * span
                    for c in range(count, 0, -1):  # undo the swaps, so that order[c] is c again
                        order[c], order[picks[c]] = order[picks[c]], order[c]
                width, span = width * base, span // base
            for i in range(n):
                row[i] = min(row[i] / scale, BELOW_ONE)


@kernel
def _image(k0: np.uint64, k1: np.uint64, node: Any, digit: int, base: int) -> int:
    # Return the image of a digit under the random permutation of a node.
    # The Fisher-Yates algorithm permutes all digits by swaps.
    # This function only follows the given digit through the swaps of the Fisher-Yates algorithm.
    # A random number below c is the upper word of the product of c and 64 random bits.
    # The lower word of the product serves as the random bits of the next number.
    # Each random number below a bound c uses up log2(c) of the 64 random bits.
    # New bits are drawn before the product of the bounds c since the last draw exceeds 2^32.
    position, used, drawn = digit, 1, 0
    bits = mix_bits(k0, k1, node)
    for t in range(base - 1):
        choices = np.uint64(base - t)
        used *= base - t
        if used > _USED_UP:
            drawn, used = drawn + 1, base - t
            bits = mix_bits(mix_bits(k0, k1, node), k1, drawn)
        upper = (bits >> _S32) * choices + (((bits & _LOW32) * choices) >> _S32)
        chosen: Any = t + np.int64(upper >> _S32)
        bits *= choices
        if position == chosen:
            return t
        if position == t:
            position = chosen
    return position


@kernel
def _climb(k0: np.uint64, k1: np.uint64, dim: int, base: int, places: int, v: int) -> int:
    # Apply the nested uniform scramble to the number v, from its last digit to its first.
    # All higher digits determine a node of the digit tree, and the node permutes the next digit.
    # The nodes of a level are numbered from b^level, so all nodes have different numbers.
    scrambled, weight, inverse = 0, 1, 1.0 / base
    width = base ** (places - 1)
    for _ in range(places):
        prefix = _quotient(v, inverse)
        node: Any = _TREE | (np.uint64(dim) << _S34) | np.uint64(width + prefix)
        scrambled += _image(k0, k1, node, v - prefix * base, base) * weight
        v, weight, width = prefix, weight * base, _quotient(width, inverse)
    return scrambled


@kernel
def scramble_trees(keys: Array, bases: Array, points: Array, out: Array) -> None:
    """Owen's nested uniform scrambling in the base of each coordinate; lower digits are uniform."""
    count, n, dims = out.shape
    block = np.empty(_WORDS, np.uint64)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        one = points[r % points.shape[0]]
        for j in range(dims):
            places, scale, nudge, unit = _format(bases[j])
            if bases[j] == 2:
                for start in range(0, n, _WORDS):
                    words = block[: min(_WORDS, n - start)]
                    for i in range(words.size):
                        words[i] = np.uint64(_read(one[start + i, j], scale, nudge))
                    _nest(k0, k1, j, dims, start, words, out[r, start : start + words.size, j])
                continue
            for i in range(n):
                v = _read(one[i, j], scale, nudge)
                address: Any = _TAIL | np.uint64(i * dims + j)
                tail = mix_uniform(k0, k1, address)
                scrambled = _climb(k0, k1, j, bases[j], places, v)
                out[r, i, j] = _write(scrambled, tail, scale, unit)


@kernel
def _draw_triangle(k0: np.uint64, k1: np.uint64, number: int, base: int, out: Array) -> None:
    # Draw a lower triangular matrix with diagonal entries 1 … b − 1; out int64 (m, m), by columns
    for c in range(out.shape[0]):
        for row in range(c, out.shape[0]):
            least = 1 if c == row else 0
            out[c, row] = least + _mix_below(k0, k1, number, base - least)
            number += 1


@kernel
def _multiply(matrix: Array, base: int, v: int, out: Array) -> None:
    # Add the matrix times the digits of v to out (m,), without reduction modulo the base.
    # Skip zero digits, which follow the last digits of a net's points.
    inverse = 1.0 / base
    for c in range(out.size - 1, -1, -1):
        above = _quotient(v, inverse)
        digit = v - above * base
        v = above
        if digit:
            for row in range(c, out.size):
                out[row] += matrix[c, row] * digit


@kernel
def mix_triangles(keys: Array, bases: Array, shift: bool, points: Array, out: Array) -> None:
    """Multiply the digits of points by random lower triangular matrices modulo prime bases.

    With `shift`, a random digit is added to each digit, and a uniform number below the last digit.
    All points get the same random digits and the same uniform number.
    """
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        number, one = 0, points[r % points.shape[0]]
        for j in range(out.shape[2]):
            base = bases[j]
            places, scale, nudge, unit = _format(base)
            matrix, added = np.zeros((places, places), np.int64), np.zeros(places, np.int64)
            _draw_triangle(k0, k1, number, base, matrix)
            number += places * places
            for k in range(places if shift else 0):
                added[k] = _mix_below(k0, k1, number + k, base)
            tail = mix_uniform(k0, k1, number + places) if shift else 0.0
            number += places + 1
            digits, inverse = np.empty(places, np.int64), 1.0 / base
            for i in range(out.shape[1]):
                digits[:] = added
                v = _read(one[i, j], scale, nudge)
                _multiply(matrix, base, v, digits)
                mixed = 0
                for k in range(places):
                    mixed = mixed * base + digits[k] - _quotient(digits[k], inverse) * base
                out[r, i, j] = _write(mixed, tail, scale, unit)
