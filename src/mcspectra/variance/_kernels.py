"""Numba kernels of the variance terms: arrays only, no checks.

Legend: r realisations of a block, h coefficients (half spectra of all techniques, one after the
other), c channels, a bands. `double[h]` is 2 for a coefficient that also stands for −m, else 1.
All sums over h with conj(f_h) S_h are real because the full spectrum is Hermitian.
"""

from __future__ import annotations

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["accumulate", "band_estimates"]


@kernel
def band_estimates(s: Array, f: Array, double: Array, band: Array, out: Array) -> None:
    """Band-limited estimates out[r, c, a] += Σ_{h in a} double Re conj(f_ch) S_rh.

    s (R, H) complex, f (C, H) complex, double (H,), band (H,) int, out (R, C, A) zeros.
    """
    for r in range(s.shape[0]):
        for c in range(f.shape[0]):
            for h in range(s.shape[1]):
                product = f[c, h].real * s[r, h].real + f[c, h].imag * s[r, h].imag
                out[r, c, band[h]] += double[h] * product


@kernel
def accumulate(s: Array, mean: Array, estimate: Array, m2: Array, cov: Array) -> None:
    """Second moments of a block about its own means.

    s (R, H), mean (H,), estimate (R, C) with its mean removed;
    m2 (H,) += Σ_r |S − S̄|²;  cov (C, H) += Σ_r (S − S̄)(I − Ī).
    """
    for r in range(s.shape[0]):
        for h in range(s.shape[1]):
            delta = s[r, h] - mean[h]
            m2[h] += delta.real * delta.real + delta.imag * delta.imag
            for c in range(cov.shape[0]):
                cov[c, h] += delta * estimate[r, c]
