"""Lattices shifted as a whole: dual lattices, offsets, closed forms, measurements."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.streams import Stream
from mcspectra.prediction.known import Known
from mcspectra.prediction.torus import of_moves, of_torus

DISK = "disk(center=(0.45, 0.52), radius=0.27)"
HALF = "half-space(normal=(0.8, 0.6), offset=0.63)"


def predicted(f, sampler, n):
    """Predict the variance of an integrand, or of what is known of it."""
    known = f if isinstance(f, Known) else Known(f)
    source = mcs.sampler(sampler, known.g.dims).as_chain(n)
    return of_torus(source.law(n), known, Stream.from_rng(0))


def moved(f, sampler, n):
    source = mcs.sampler(sampler, f.dims).as_chain(n)
    return of_moves(source.law(n), Known(f), Stream.from_rng(0))


def unknown(f):
    """The same function without known coefficients."""
    return mcs.Integrand.from_function(f, dims=f.dims, integral=f.integral)


@pytest.mark.parametrize(
    ("sampler", "dims", "n"),
    [
        ("rank1-lattice | shift", 2, 16),
        ("rank1-lattice | shift", 2, 4096),
        pytest.param("korobov(a=3) | shift", 3, 16, marks=pytest.mark.slow),
        ("korobov(a=3) | shift", 3, 4096),
    ],
)
def test_additive_functions_on_lattices(sampler, dims, n):
    """Each axis has one point in each n-th, so x has a rectangular error of width 1/n."""
    n = n + 1 if dims == 3 else n  # 3 divides neither of these
    found = predicted(mcs.integrand("linear", dims=dims), sampler, n)
    gradient = mcs.integrand("linear", dims=dims)
    slopes = gradient(np.eye(dims) * 0.5) - gradient(np.zeros((1, dims)))
    exact = float((2.0 * slopes) @ (2.0 * slopes)) / 12.0 / float(n) ** 2
    assert abs(found.variance[0] - exact) <= found.error[0]
    assert found.error[0] < 0.01 * exact


@pytest.mark.parametrize(
    ("spec", "sampler", "n"),
    [
        (DISK, "rank1-lattice | shift", 64),
        pytest.param(DISK, "rank1-lattice(vector=[4, 3]) | shift", 256, marks=pytest.mark.slow),
        (HALF, "fibonacci | shift", 610),
        (DISK, "hexagonal | shift", 270),
        (HALF, "uniform-jitter | strata-shift(offset=0.3)", 256),
    ],
)
def test_dual_lattices_and_offsets_agree(spec, sampler, n):
    f = mcs.integrand(spec, dims=2)
    dual, offsets = predicted(f, sampler, n), moved(unknown(f), sampler, n)
    assert "dual" in dual.how
    assert "offsets" in offsets.how
    both = np.hypot(dual.error[0], offsets.error[0])
    assert abs(dual.variance[0] - offsets.variance[0]) <= both
    assert both < 0.05 * dual.variance[0]  # The aim of predictions


def test_what_no_dual_vector_meets_has_no_variance():
    f = mcs.integrand("cosine(frequency=(2, 1))", dims=2)
    assert predicted(f, "rank1-lattice | shift", 64).variance[0] == 0.0
    found = mcs.predict(f, "rank1-lattice | shift", [64])
    assert np.isnan(found.predicted_variance.values[0])
    assert "vanishes" in found.attrs["note"]


def test_sets_that_are_no_lattices_go_another_way():
    f = Known(mcs.integrand("linear", dims=2))
    for sampler in ("kronecker | shift", "halton | shift", "sobol | shift"):
        assert predicted(f, sampler, 64).how == "one transform"
