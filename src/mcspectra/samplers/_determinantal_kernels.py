"""Numba kernels of determinantal sets: exact sequential sampling by rejection.

Legend: R realisations, n points, d dims. Complex numbers are kept as two real arrays, so that the
inner loops run over neighbours in memory without a sum carried along: compilers vectorise those.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_uniform

__all__ = ["fill_determinantal"]

_BLOCK = 16  # basis vectors between two looks at which proposals are lost already
_BATCH = 8  # proposals that are tested together, so that the basis is read once for all


@kernel
def _fill_wave(x: Array, m: Array, re: Array, im: Array) -> None:
    # exp(2π i m·x) for every frequency: the feature vector of a point.
    for k in range(m.shape[0]):
        phase = 0.0
        for j in range(x.size):
            phase += m[k, j] * x[j]
        re[k] = cos(2.0 * pi * phase)
        im[k] = sin(2.0 * pi * phase)


@kernel
def _add_block(re: Array, im: Array, vr: Array, vi: Array, cr: Array, ci: Array) -> float:
    # Coefficients of a feature vector in one block of the basis, and the sum of their squares.
    cr[:] = 0.0
    ci[:] = 0.0
    for k in range(re.size):
        a, b = re[k], im[k]
        for j in range(_BLOCK):
            cr[j] += vr[k, j] * a + vi[k, j] * b
            ci[j] += vr[k, j] * b - vi[k, j] * a
    total = 0.0
    for j in range(_BLOCK):
        total += cr[j] * cr[j] + ci[j] * ci[j]
    return total


@kernel
def _project(
    re: Array,
    im: Array,
    basis: tuple[Array, Array],
    count: int,
    most: Array,
    within: Array,
    cr: Array,
    ci: Array,
) -> None:
    # What `count` vectors of the basis hold of each proposal; given up once it exceeds `most`.
    within[:] = 0.0
    for block in range((count + _BLOCK - 1) // _BLOCK):
        vr, vi = basis[0][block], basis[1][block]
        for p in range(_BATCH):
            if within[p] < most[p]:
                within[p] += _add_block(re[p], im[p], vr, vi, cr[p, block], ci[p, block])


@kernel
def _append(re: Array, im: Array, basis: tuple[Array, Array], i: int, cr: Array, ci: Array) -> None:
    # Make what i vectors of the basis leave of the feature vector the next: Gram and Schmidt.
    for block in range((i + _BLOCK - 1) // _BLOCK):
        vr, vi, sr, si = basis[0][block], basis[1][block], cr[block], ci[block]
        for k in range(re.size):
            a, b = 0.0, 0.0
            for j in range(_BLOCK):
                a += sr[j] * vr[k, j] - si[j] * vi[k, j]
                b += sr[j] * vi[k, j] + si[j] * vr[k, j]
            re[k] -= a
            im[k] -= b
    scale = 1.0 / sqrt((re * re + im * im).sum())
    for k in range(re.size):
        re[k] *= scale
        im[k] *= scale
        basis[0][i // _BLOCK, k, i % _BLOCK] = re[k]
        basis[1][i // _BLOCK, k, i % _BLOCK] = im[k]


@kernel
def _add_last(re: Array, im: Array, vr: Array, vi: Array, cr: Array, ci: Array, i: int) -> float:
    # Coefficient of a feature vector in the newest vector of the basis, number i; its square.
    a, b = 0.0, 0.0
    for k in range(re.size):
        a += vr[k] * re[k] + vi[k] * im[k]
        b += vr[k] * im[k] - vi[k] * re[k]
    cr[i // _BLOCK, i % _BLOCK], ci[i // _BLOCK, i % _BLOCK] = a, b
    return a * a + b * b


@kernel
def _draw(k0: np.uint64, k1: np.uint64, m: Array, basis: tuple[Array, Array], out: Array) -> None:
    # One realisation. Proposals that a point found before them leaves untested stay in line for
    # the points after it: what they were tested for is still true.
    n, dims = out.shape
    x, most, within = np.empty((_BATCH, dims)), np.empty(_BATCH), np.empty(_BATCH)
    re, im = np.empty((_BATCH, n)), np.empty((_BATCH, n))
    shape = (_BATCH, (n + _BLOCK - 1) // _BLOCK, _BLOCK)
    cr, ci = np.zeros(shape), np.zeros(shape)
    i, number = 0, 0
    while i < n:
        for p in range(_BATCH):
            for j in range(dims):
                x[p, j] = mix_uniform(k0, k1, number + j)
            most[p] = n * mix_uniform(k0, k1, number + dims)
            number += dims + 1
            _fill_wave(x[p], m, re[p], im[p])
        _project(re, im, basis, i, most, within, cr, ci)
        for p in range(_BATCH):
            if i == n or within[p] >= most[p]:
                continue
            out[i] = x[p]
            _append(re[p], im[p], basis, i, cr[p], ci[p])
            for q in range(p + 1, _BATCH):
                if within[q] < most[q]:
                    within[q] += _add_last(re[q], im[q], re[p], im[p], cr[q], ci[q], i)
            i += 1


@kernel
def fill_determinantal(keys: Array, m: Array, out: Array) -> None:
    """Draw from the projection process of the frequencies m (n, d); out (R, n, d).

    With i points drawn, the density of the next is ‖P φ(x)‖²/(n − i), φ(x) the feature vector and
    P the projection away from those of the points drawn; ‖φ‖² = n bounds it.
    """
    n = out.shape[1]
    shape = ((n + _BLOCK - 1) // _BLOCK, n, _BLOCK)
    basis = np.empty(shape), np.empty(shape)
    for r in range(out.shape[0]):
        basis[0][:] = 0.0
        basis[1][:] = 0.0
        _draw(keys[r, 0], keys[r, 1], m, basis, out[r])
