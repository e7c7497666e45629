"""Future directions: which strata an edge cuts, and parts of the variance by axes."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.reproduction import future_directions as future


@pytest.mark.parametrize(("aligned", "cut"), [(False, 1 / 6), (True, 0.0)])
def test_only_strata_that_are_not_aligned_are_cut(aligned, cut):
    estimator = future._aligned(36) if aligned else mcs.Estimator(future.edge(future.AT))
    strata = future._strata_panel(estimator, "", 1).marks[0].values
    assert np.mean(strata == 2) == pytest.approx(cut, abs=1e-9)
    # Left of the edge, all strata that are not cut have the value 1
    assert np.mean(strata >= 1) == pytest.approx(2 / 6 if cut else future.AT, abs=0.01)


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
