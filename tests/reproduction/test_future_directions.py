"""Future directions: which strata an edge cuts, and parts of the variance by axes."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.reproduction import future_directions as future


@pytest.mark.parametrize("aligned", [False, True])
def test_only_strata_that_are_not_aligned_are_marked_as_cut(aligned):
    share = future.aligned_share(6) if aligned else future.SHARE
    marks = future._strata_panel(share, "", 1).marks
    found = [m for m in marks if getattr(m, "label", "").startswith("strata cut")]
    assert len(found) == (0 if aligned else 1)
    for mark in found:
        sides = mark.ends[:2, 0, 0]
        assert sides[0] < future.AT < sides[1]


@pytest.mark.parametrize("side", [1, 4, 5])
@pytest.mark.parametrize("aligned", [False, True])
def test_exact_variances_of_importance_samples_agree_with_quadrature(side, aligned):
    if side == 1 and aligned:
        return  # One stratum cannot have a border at the edge
    share = future.aligned_share(side) if aligned else future.SHARE
    # Midpoint sums of f/p over each stratum; the edge is at a border of cells
    cells = 200
    u = (np.arange(side * cells) + 0.5) / (side * cells)
    grid = np.stack(np.meshgrid(u, u, indexing="ij"), axis=-1)
    estimator = future.importance_sampling(share)
    x = estimator.density.sample(grid)
    g = future.edge(future.AT)(x) / estimator.density.pdf(x)
    strata = g.reshape(side, cells, side, cells)
    within = (strata**2).mean(axis=(1, 3)) - strata.mean(axis=(1, 3)) ** 2
    expected = within.sum() / side**4
    assert future.exact_variance(share, side) == pytest.approx(expected, rel=2e-3)


def test_parts_along_axes_of_a_sum_and_of_a_product():
    def share(f):
        data = mcs.variance_terms(
            mcs.Integrand.from_function(f, dims=2), "random", 16, half_width=4,
            realizations=200, rng=1, bands="anova",
        )  # fmt: skip
        return future.alone(data)

    a, b = (lambda x, k=k: np.cos(2 * np.pi * x[..., k]) for k in (0, 1))
    assert share(lambda x: a(x) + b(x)) == pytest.approx(1.0, abs=1e-9)
    assert share(lambda x: a(x) * b(x)) == pytest.approx(0.0, abs=1e-9)
