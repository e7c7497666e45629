"""Numba kernels of the variance terms and of pairs of points, without checks of arguments.

The indices are: r for realizations of a block; c for channels; a for bands; k for half widths.
Index h counts the Fourier coefficients of all techniques, one technique after another.
Only one of the frequencies m and −m has a coefficient, so each technique has half a spectrum.
Index j counts real and imaginary parts of coefficients; a real coefficient has only one part.
`double[h]` is 2 for a coefficient that also stands for −m, else 1.
All sums over h with conj(f_h) S_h are real because the full spectrum is Hermitian.

Coefficients are processed in tiles, which stay in the first-level cache for all realizations.
The results have the same bits as without tiles, because all sums keep their order.
Each tile is a slice of an array, because Numba vectorizes loops that begin at 0.
Numba does not vectorize loops with a variable start, whose sign it cannot infer.
"""

from __future__ import annotations

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = [
    "accumulate",
    "band_estimates",
    "pair_sum_1d",
    "pair_sum_2d",
    "term_sums",
]

# Number of coefficients of a tile, a constant of the compiled kernels.
# The size of a tile has no effect on the sums.
# The arrays of a tile take 512 · 56 bytes = 28 KiB. A first-level cache often has 32 KiB.
# Each coefficient takes 56 bytes: two complex numbers, a weight and two integers.
# The complex numbers are a spectrum of points and a coefficient of the integrand.
_TILE = 512


@kernel
def band_estimates(
    s: Array,
    f: Array,
    double: Array,
    band: Array,
    shell: Array,
    bands: Array,
    shells: Array,
    total: Array,
) -> None:
    """Compute Σ_{h in a} double[h] Re(conj(f_ch) S_rh) for two partitions of h, and Σ_r S_rh.

    The inputs are for R realizations, C channels and H frequencies.
    The inputs s (R, H) and f (C, H) are both complex or both real.
    The input double (H,) is 2 if a coefficient counts for both m and −m, otherwise 1.
    The inputs band and shell, int (H,), are the number of each frequency's band and shell.
    The outputs bands (R, C, A), shells (R, C, K+1) and total (H,) must be zero initially.
    """
    for low in range(0, s.shape[1], _TILE):
        tile = slice(low, low + _TILE)
        a, k, twice, part = band[tile], shell[tile], double[tile], total[tile]
        for r in range(s.shape[0]):
            row = s[r, tile]
            for h in range(row.size):
                part[h] += row[h]
            for c in range(f.shape[0]):
                g, by_band, by_shell = f[c, tile], bands[r, c], shells[r, c]
                for h in range(row.size):
                    product = g[h].real * row[h].real + g[h].imag * row[h].imag
                    product *= twice[h]
                    by_band[a[h]] += product
                    by_shell[k[h]] += product


@kernel
def accumulate(s: Array, mean: Array, estimate: Array, squares: Array, cov: Array) -> None:
    """Add second moments of a block about its means. Real and imaginary parts count separately.

    The inputs are s (R, J), mean (J,), and estimate (R, C) without its mean.
    The sum Σ_r (S − S̄)² over realizations r is added to `squares`, (J,).
    The sum Σ_r (S − S̄)(I − Ī) is added to `cov`, (C, J), where I is the estimate of a channel.
    """
    for low in range(0, s.shape[1], _TILE):
        tile = slice(low, low + _TILE)
        center, square = mean[tile], squares[tile]
        for r in range(s.shape[0]):
            row = s[r, tile]
            for j in range(row.size):
                delta = row[j] - center[j]
                square[j] += delta * delta
            for c in range(cov.shape[0]):
                deviation, part = estimate[r, c], cov[c, tile]
                for j in range(row.size):
                    part[j] += (row[j] - center[j]) * deviation


@kernel
def term_sums(f: Array, m2: Array, cov: Array, double: Array, dc: Array, out: Array) -> None:
    """Compute three sums for each channel: the dc term, the power term and all terms together.

    The three sums of each channel are added to the array out (C, 3).
    The inputs are f (C, H), m2 (H,), cov (C, H), double (H,) and the bool array dc (H,).
    The inputs m2 and cov are sums over realizations, not divided by the degrees of freedom.
    The caller must divide the output by the degrees of freedom.
    """
    for c in range(f.shape[0]):
        for h in range(f.shape[1]):
            a = f[c, h]
            square = (a.real * a.real + a.imag * a.imag) * (m2[h] * double[h])
            out[c, 0 if dc[h] else 1] += square
            out[c, 2] += (a.real * cov[c, h].real + a.imag * cov[c, h].imag) * double[h]


# ---- Pair correlation: sums over pairs of points of a tabulated function on the torus


@kernel
def pair_sum_1d(points: Array, table: Array) -> float:
    """Return Σ_{i<k} A(x_i − x_k) of points (n, 1).

    The table (N,) holds A(j/N), and A is interpolated linearly.
    """
    size = table.size
    total = 0.0
    for a in range(len(points)):
        for b in range(a):
            place = (points[a, 0] - points[b, 0]) % 1.0 * size
            i = int(place)
            t = place - i
            total += (1.0 - t) * table[i % size] + t * table[(i + 1) % size]
    return total


@kernel
def pair_sum_2d(points: Array, table: Array) -> float:
    """Return Σ_{i<k} A(x_i − x_k) of points (n, 2).

    The table (N, N) holds A on a grid, and A is interpolated bilinearly.
    """
    size = len(table)
    total = 0.0
    for a in range(len(points)):
        for b in range(a):
            x = (points[a, 0] - points[b, 0]) % 1.0 * size
            y = (points[a, 1] - points[b, 1]) % 1.0 * size
            i, j = int(x), int(y)
            t, u = x - i, y - j
            low, high = table[i % size], table[(i + 1) % size]
            left, right = j % size, (j + 1) % size
            total += (1.0 - t) * ((1.0 - u) * low[left] + u * low[right])
            total += t * ((1.0 - u) * high[left] + u * high[right])
    return total
