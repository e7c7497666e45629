"""Every density in 1-D and 2-D against the table of its own cell masses, a second implementation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from mcspectra.densities import PiecewiseConstant
from mcspectra.densities.adaptive import integrate

SIDE = {1: 1024, 2: 128}  # the environment has 32 × 64 pixels, one of them the sun
BINS = 8
SAMPLES = 10_000
FALSE_ALARM = 1e-6  # of the whole module
TESTS = 140  # two χ² tests for each of at most 70 densities
CLOSE = 1e-6


@pytest.fixture
def table(density):
    """Masses of cells by quadrature of the pdf; None in 3-D and more, where cells are too many."""
    if density.dims > 2:
        return None
    side = SIDE[density.dims]
    masses = (
        integrate(density.pdf, 1, cells=side).cells if density.dims == 1 else squares(density, side)
    )
    return PiecewiseConstant(values=masses.reshape((side,) * density.dims).T)  # rows are along x_1


def squares(density, side):
    """Masses (side²,) by 4 × 4 Gauss points a cell; jumps within cells cost what a cell holds."""
    node, weight = np.polynomial.legendre.leggauss(4)
    line = ((np.arange(side)[:, None] + 0.5 * (node + 1)) / side).ravel()
    values = density.pdf(np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1))
    weights = np.tile(weight, side)
    cells = (values * weights * weights[:, None]).reshape(side, 4, side, 4).sum(axis=(1, 3))
    return cells / cells.sum()


def increasing(density):
    """Whether the warp is the inverse of the cdf: in 1-D, but for alias tables and mixtures."""
    return density.dims == 1 and density.has_inverse and getattr(density, "warp", "") != "alias"


def test_the_pdf_is_that_of_the_table_but_for_its_variation_in_a_cell(density, table):
    """∫|p − mean of p in its cell| is at most the width of a cell times the variation of p."""
    if table is None:
        return
    side, dims = SIDE[density.dims], density.dims
    fine = 16 if dims == 1 else 4
    line = (np.arange(side * fine) + 0.5) / (side * fine)
    x = np.stack(np.meshgrid(*[line] * dims, indexing="ij"), axis=-1)
    p = density.pdf(x)
    gap = np.abs(p - table.pdf(x)).mean()
    variation = sum(np.abs(np.diff(p, axis=axis)).mean() * line.size for axis in range(dims))
    assert gap <= variation / side + 1e-6


def test_warps_of_one_dim_go_to_the_same_cell(density, table):
    if table is None or not increasing(density):
        return
    side = SIDE[1]
    borders = (np.arange(1, side) / side)[:, None]
    cdf = table.invert(borders)
    np.testing.assert_allclose(density.invert(borders), cdf, atol=CLOSE)
    u = np.random.default_rng(8).random((SAMPLES, 1))
    nearest = np.searchsorted(cdf[:, 0], u[:, 0] + [[-CLOSE], [CLOSE]])
    inner = nearest[0] == nearest[1]
    gap = np.abs(density.sample(u) - table.sample(u))[inner]
    assert gap.max() <= 1 / side
    gap = np.abs(density.invert(table.sample(u)) - u)
    assert gap.max() <= table.pdf(table.sample(u)).max() / side + CLOSE


def test_samples_through_the_inverse_of_the_other_are_uniform(density, table):
    """T of one, T⁻¹ of the other: uniform points again, within what cells resolve."""
    if table is None or increasing(density):
        return
    random = np.random.default_rng(9)
    u = random.random((SAMPLES, density.primary_dims))
    assert uniform(table.invert(density.sample(u)))
    if density.has_inverse:
        assert uniform(density.invert(table.sample(random.random((SAMPLES, density.dims)))))


def uniform(v):
    """Whether a χ² test of bins does not tell points (k, d) from uniform ones."""
    dims = v.shape[-1]
    counts, _ = np.histogramdd(v, bins=[BINS] * dims, range=[(0, 1)] * dims)
    expected = len(v) / BINS**dims
    statistic = ((counts - expected) ** 2 / expected).sum()
    return statistic <= chi2.isf(1 - (1 - FALSE_ALARM) ** (1 / TESTS), BINS**dims - 1)
