"""Integrals over equal cells: closed forms, breaks, channels, and low memory."""

import tracemalloc

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.integrands._quadrature import cell_integrals


def _of_exponentials(rates, size):
    edges = np.arange(size + 1) / size
    axes = [np.diff(np.exp(rate * edges)) / rate for rate in rates]
    total = axes[0]
    for axis in axes[1:]:
        total = np.multiply.outer(total, axis)
    return total.ravel()


@pytest.mark.parametrize(("rates", "size"), [((-3.0,), 7), ((-3.0, 1.0), 8), ((1, 2, -1), 4)])
def test_cells_of_exponentials(rates, size):
    f = mcs.Integrand.from_function(lambda x: np.exp(x @ np.array(rates)), dims=len(rates))
    cells, source = cell_integrals(f, size)
    assert source != "exact"
    np.testing.assert_allclose(cells[0], _of_exponentials(rates, size), rtol=1e-6)


def test_cells_of_channels():
    f = mcs.Integrand.from_function(lambda x: np.stack([x[..., 0], x[..., 1] ** 2], -1), dims=2)
    cells, _ = cell_integrals(f, 3)
    edges = np.arange(4) / 3
    first = np.repeat(np.diff(edges**2) / 2, 3) / 3
    second = np.tile(np.diff(edges**3) / 3, 3) / 3
    np.testing.assert_allclose(cells, [first, second], rtol=1e-12)


def test_breaks_within_cells_are_cut():
    f = mcs.Estimator(
        mcs.integrand("linear", dims=1), mcs.density("piecewise-constant(values=[1, 3, 2])", dims=1)
    ).primary_integrand(0)
    cells, _ = cell_integrals(f, 5)
    p = np.array([1, 3, 2]) / 2
    ends = np.concatenate([[0], np.cumsum(p / 3)])

    def primitive(u):  # Primitive of x(u)/p: ½ x² in x
        return np.interp(u, ends, np.arange(4) / 3) ** 2 / 2

    np.testing.assert_allclose(cells[0], np.diff(primitive(np.arange(6) / 5)), rtol=1e-12)


def test_memory_does_not_grow_with_cells_times_nodes():
    f = mcs.Integrand.from_function(lambda x: np.exp(x[..., 0]), dims=1)
    tracemalloc.start()
    cells, _ = cell_integrals(f, 2**14)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**27
    np.testing.assert_allclose(cells[0], _of_exponentials((1.0,), 2**14), rtol=1e-10)


def test_too_many_cells_are_refused():
    f = mcs.integrand("gaussian", dims=4)
    with pytest.raises(ParameterError, match="cells in 4 dims"):
        cell_integrals(f, 100)
