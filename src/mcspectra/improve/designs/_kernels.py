"""Compiled inner loops of the searches for point sets with a small variance.

In shapes of arrays, r is the number of features, n of points, N of cells and W of point sets.

The code of a point or cell is an integer: the leading bits of all coordinates, one after another.
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_bits

__all__ = ["best_multiple", "flip_tree", "improve_code", "reflect", "span_mean", "swap_cells"]


@kernel
def best_multiple(m: Array, power: Array, vector: Array, axis: int, n: int, out: Array) -> None:
    # Let z be the generating vector of a lattice of n points.
    # For each z_axis = 0 … n−1, sum the power over frequencies m with m·z ≡ 0 modulo n.
    # `vector` is z, of which the component z_axis is ignored.
    # The n sums of the power are written to the array `out` (n,)
    out[:] = 0.0
    for i in range(len(m)):
        rest = 0
        for j in range(m.shape[1]):
            if j != axis:
                rest += m[i, j] * vector[j]
        step, at = m[i, axis] % n, rest % n
        for z in range(n):
            if at == 0:
                out[z] += power[i]
            at += step
            if at >= n:
                at -= n


@kernel
def span_mean(table: Array, columns: Array, span: Array) -> float:
    # Each subset of the columns, int64 (m,), has an exclusive or, which is an index of the table.
    # Return the mean of the table at the 2^m indices. Store the indices in `span`, int64 (2^m,)
    span[0] = 0
    total, size = 0.0, 1
    total += table[0]
    for c in range(len(columns)):
        for i in range(size):
            span[size + i] = span[i] ^ columns[c]
            total += table[span[size + i]]
        size *= 2
    mean: float = total / size
    return mean


@kernel
def improve_code(table: Array, columns: Array, bits: int, span: Array) -> float:
    # Flip single bits of the columns as long as this lowers the mean that `span_mean` returns
    best = span_mean(table, columns, span)
    floor = 1e-14 * np.abs(table).max()  # Changes of the mean below this size are rounding errors
    better = True
    while better:
        better = False
        for c in range(len(columns)):
            for bit in range(bits):
                columns[c] ^= 1 << bit
                value = span_mean(table, columns, span)
                if value < best - 1e-9 * abs(best) - floor:
                    best, better = value, True
                else:
                    columns[c] ^= 1 << bit
    return best


@kernel
def flip_tree(table: Array, codes: Array, axes: int, bits: int) -> bool:
    # The coordinates on an axis form a binary tree; a flip exchanges the two halves of a node.
    # Keep a flip if it lowers Σ_ij table[codes_i ^ codes_j], with codes (n,) of the points
    n, changed = len(codes), False
    inside = np.empty(n, np.bool_)
    for axis in range(axes):
        low = (axes - 1 - axis) * bits
        for level in range(bits):
            # All codes in a node of the tree start with the same bits.
            # Compute the position of the lowest bit that all codes in a node have in common
            node = low + bits - level
            flip = 1 << (node - 1)
            done = np.zeros(n, np.bool_)
            for first in range(n):
                if done[first]:
                    continue
                prefix = codes[first] >> node & ((1 << level) - 1)
                for i in range(n):
                    inside[i] = (codes[i] >> node & ((1 << level) - 1)) == prefix
                    done[i] |= inside[i]
                gain, size = 0.0, 0.0
                for i in range(n):
                    if inside[i]:
                        for k in range(n):
                            if not inside[k]:
                                old = table[codes[i] ^ codes[k]]
                                gain += table[codes[i] ^ codes[k] ^ flip] - old
                                size += abs(old)
                if gain < -1e-9 * size:
                    changed = True
                    for i in range(n):
                        if inside[i]:
                            codes[i] ^= flip
    return changed


@kernel
def swap_cells(
    features: Array,
    owner: Array,
    place: Array,
    sums: Array,
    sides: Array,
    free: bool,
    keys: Array,
    trials: int,
    temperature: float,
) -> int:
    # Let two sets exchange a pair of cells if this lowers Σ |sums|², the error of all sets.
    # An increase by 2x is accepted with probability exp(−x / temperature) [KirkpatrickEtAl1983].
    # If `free` is false, cells are exchanged only within a stratum: each set has one per stratum.
    # The features of the cells are float32 (N, r), and their sums over sets float32 (W, r).
    # The number r is a multiple of 16.
    # The array owner (N,) holds the number of each cell's set; place (N,) holds its stratum
    cells, r = features.shape
    taken = 0
    lanes = 16  # Number of partial sums that the compiler computes at once
    partial = np.empty(lanes, np.float32)
    for t in range(trials):
        bits = mix_bits(keys[0], keys[1], t)
        a, b = np.int64(bits % np.uint64(cells)), np.int64(0)
        bits //= np.uint64(cells)
        if t % 4 == 0:
            b = np.int64(bits % np.uint64(cells))
        else:  # Choose a cell nearby: at most 1, 2 or 4 cells away along each axis
            reach, stride, rest, inside = 1 << (t % 4 - 1), 1, a, True
            for j in range(len(sides) - 1, -1, -1):
                x = rest % sides[j] + np.int64(bits % np.uint64(2 * reach + 1)) - reach
                inside &= 0 <= x < sides[j]
                bits //= np.uint64(2 * reach + 1)
                rest //= sides[j]
                b += x * stride
                stride *= sides[j]
            if not inside:
                continue
        k, l = owner[a], owner[b]
        if k == l or not (free or place[a] == place[b]):
            continue
        partial[:] = 0.0
        for start in range(0, r, lanes):
            for i in range(lanes):
                d = features[b, start + i] - features[a, start + i]
                partial[i] += d * (sums[k, start + i] - sums[l, start + i] + d)
        change, limit = partial.sum(), 0.0
        if temperature > 0.0 and change > 0.0:
            u = (np.float64(mix_bits(keys[1], keys[0], t) >> np.uint64(11)) + 0.5) * 2.0**-53
            limit = -temperature * np.log(u)
        if change < limit:
            taken += 1
            for i in range(r):
                d = features[b, i] - features[a, i]
                sums[k, i] += d
                sums[l, i] -= d
            owner[a], owner[b] = l, k
    return taken


@kernel
def reflect(slopes: Array, sets: Array, signs: Array) -> None:
    # Reflecting a point in its cell changes the sign of the slopes of its cell's r features.
    # For each set, choose signs ±1 that make |Σ_i sign_i slopes[sets_i]|² small.
    # Shapes: signs int64 (W, n) for W sets of n points; slopes (N, r) for N cells
    n, r = sets.shape[1], slopes.shape[1]
    total = np.empty(r)
    for w in range(len(sets)):
        total[:] = 0.0
        for i in range(n):  # Choose the sign that keeps the sum small
            product = 0.0
            for j in range(r):
                product += total[j] * slopes[sets[w, i], j]
            signs[w, i] = -1 if product > 0.0 else 1
            for j in range(r):
                total[j] += signs[w, i] * slopes[sets[w, i], j]
        for _ in range(4):
            for i in range(n):
                change = 0.0
                for j in range(r):
                    s = signs[w, i] * slopes[sets[w, i], j]
                    change += s * (s - total[j])
                if change < 0.0:
                    signs[w, i] = -signs[w, i]
                    for j in range(r):
                        total[j] += 2.0 * signs[w, i] * slopes[sets[w, i], j]
