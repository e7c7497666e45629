"""Linear algebra in a fixed order: agrees with LAPACK and BLAS, independent of BLAS threads."""

import os
import subprocess
import sys

import numpy as np
import pytest

from mcspectra.core.ordered import eigenpairs, gram, orthonormal, product, weighted_sum

# BLAS splits sums of these sizes: modes, cross matrix and sums over frequencies depended on threads
RESULTS = """
import hashlib
import mcspectra as mcs
f = mcs.Estimator("gaussian(width=0.1)", dims=2)
smooth = mcs.Estimator("gaussian(width=0.3)", dims=2)  # exact in a tenth of the time
runs = {"engine": "nufft", "workers": 1}
for found in (
    mcs.covariance_modes(f, "random", 16, half_width=12, modes=50, realizations=700, **runs),
    mcs.variance_terms(
        f, "random", 4, half_width=12, cross_matrix=True, realizations=3000, **runs
    ),
    *(
        mcs.predict(
            smooth if m == "exact" else f,
            "jittered | shift", [16], method=m, half_width=100, realizations=10, workers=1,
        )
        for m in ("exact", "covariance", "homogenized", "terms")
    ),
):
    print(hashlib.sha256(b"".join(v.values.tobytes() for v in found.values())).hexdigest())
"""


def test_threads_of_blas_do_not_matter(capsys):
    """Compare this process, whose BLAS has one thread (see conftest.py), with one of five."""
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
    process = subprocess.Popen(
        [sys.executable, "-c", RESULTS],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "5"},
        stdout=subprocess.PIPE,
        text=True,
    )
    exec(compile(RESULTS, "results", "exec"), {})  # noqa: S102
    one = capsys.readouterr().out.split()
    many = process.communicate()[0].split()
    assert len(one) == 6
    assert one == many


@pytest.mark.parametrize("size", [1, 2, 3, 40])
def test_factorizations_agree_with_lapack(size):
    rng = np.random.default_rng(size)
    a = rng.standard_normal((50, size)) * 1e-200
    a[:, size // 2] = a[:, 0]  # make the matrix rank deficient
    q, expected = orthonormal(a), np.linalg.qr(a)[0]
    assert np.allclose(q.T @ q, np.eye(size), atol=1e-14)
    same = np.abs((q * expected).sum(axis=0))[: size // 2]  # columns agree up to signs
    assert np.allclose(same, 1.0, atol=1e-12)
    assert np.allclose(a, q @ (q.T @ a), atol=1e-212)
    matrix = a.T @ (a * 1e200)
    values, vectors = eigenpairs(matrix)
    scale = np.abs(matrix).max()
    assert np.allclose(values, np.linalg.eigvalsh(matrix)[::-1], atol=1e-13 * scale)
    assert np.allclose(matrix @ vectors, vectors * values, atol=1e-13 * scale)
    assert np.allclose(vectors.T @ vectors, np.eye(size), atol=1e-13)


@pytest.mark.parametrize("is_complex", [False, True])
def test_products_agree_with_blas(is_complex):
    rng = np.random.default_rng(0)
    x = rng.standard_normal((30, 7)) + 1j * is_complex * rng.standard_normal((30, 7))
    x = x if is_complex else x.real
    assert np.allclose(gram(x), np.concatenate([x.T @ x.conj(), x.T @ x], axis=1), atol=1e-13)
    assert np.allclose(product(x.T, x), x.T @ x, atol=1e-13)
    weights = rng.standard_normal((5, 6))
    values = x.reshape(5, 6, 7)
    assert np.allclose(weighted_sum(weights, values), np.tensordot(weights, values, 2), atol=1e-13)
    assert weighted_sum(weights[0], values[0, :, 0]).shape == ()
