"""Linear algebra whose sums have a fixed order.

BLAS divides large sums by the number of its threads, which changes the last digits of results.
Products here use the function `numpy.einsum` without optimization, which never calls BLAS.
The function `einsum` is four times slower than BLAS.
Analyses spend far more time on points and Fourier transforms than on products of matrices.
Factorizations use Householder reflections. docs/decisions/0015 compares them with NumPy's.
"""

from __future__ import annotations

import math

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["eigenpairs", "gram", "orthonormal", "product", "weighted_sum"]


def product(a: Array, b: Array) -> Array:
    """Return the product a b of matrices (I, J) and (J, K)."""
    return np.asarray(np.einsum("ij,jk->ik", a, b))


def weighted_sum(weights: Array, values: Array) -> Array:
    """Return Σ w v over all axes of the weights w, which are the first axes of the values v."""
    flat = values.reshape(weights.size, *values.shape[weights.ndim :])
    return np.asarray(np.einsum("i,i...->...", weights.ravel(), flat))


def gram(x: Array) -> Array:
    """Return Σ_r x_rm conj(x_rl) and Σ_r x_rm x_rl, next to each other, (H, 2H), for x (R, H)."""
    rows = np.ascontiguousarray(x.T)
    if not np.iscomplexobj(x):
        return np.tile(np.einsum("mr,lr->ml", rows, rows), 2)
    real, imaginary = rows.real.copy(), rows.imag.copy()
    cosines = np.einsum("mr,lr->ml", real, real)
    sines = np.einsum("mr,lr->ml", imaginary, imaginary)
    mixed = np.einsum("mr,lr->ml", imaginary, real)
    found = np.empty((len(rows), 2 * len(rows)), np.complex128)
    plain, pseudo = np.split(found, 2, axis=1)
    plain.real, plain.imag = cosines + sines, mixed - mixed.T
    pseudo.real, pseudo.imag = cosines - sines, mixed + mixed.T
    return found


def orthonormal(a: Array) -> Array:
    """Return the orthonormal Q (D, K) of a = Q R. Its first k columns span the first k of a."""
    columns: Array = a.T.copy()
    reflectors: list[Array] = []
    for j, x in enumerate(columns):
        for v in reflectors:
            _reflect(v, x)
        reflectors.append(_reflector(x[j:]))
    q = np.eye(*columns.shape)
    for x in q:
        for v in reversed(reflectors):
            _reflect(v, x)
    return np.ascontiguousarray(q.T)


def eigenpairs(a: Array) -> tuple[Array, Array]:
    """Return eigenvalues (K,), descending, and eigenvectors (K, K) of the symmetric part of a."""
    from scipy.linalg import eigh_tridiagonal

    # Reflect rows and columns until a is tridiagonal. LAPACK then finds the eigenpairs without BLAS
    a, reflectors = 0.5 * (a + a.T), []
    for j in range(len(a) - 2):
        v = _reflector(a[j + 1 :, j])
        _reflect(v, a[:, j:])
        _reflect(v, a[j:].T)
        reflectors.append(v)
    values, vectors = eigh_tridiagonal(np.diagonal(a), np.diagonal(a, 1))
    for v in reversed(reflectors):
        _reflect(v, vectors)
    return values[::-1], vectors[:, ::-1]


def _reflector(x: Array) -> Array:
    """Return v such that x − v vᵀ x is a multiple of the first unit vector.

    The product vᵀ v is 2, or 0 if x = 0.
    """
    v = x / (np.abs(x).max() or 1.0)
    v[0] += math.copysign(math.sqrt((v**2).sum()), v[0])
    return np.asarray(v * math.sqrt(2.0 / ((v**2).sum() or 1.0)))


def _reflect(v: Array, a: Array) -> None:
    """Subtract v vᵀ a from the last len(v) rows of a, in place."""
    a[len(a) - len(v) :] -= np.multiply.outer(v, np.einsum("i,i...->...", v, a[len(a) - len(v) :]))
