"""Exact variances of functions that no node sees are refused, or within their errors."""

from __future__ import annotations

import numpy as np
import pytest
from tests.variance.adversarial import Case, make

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.variance.exact import estimated_variance, of_integrand
from mcspectra.variance.quadrature import square_integral


def _worst(case: Case, sampler: str, n: int, sides: tuple[int, ...]) -> float:
    """Largest error over the claimed one, of all tolerances; 0 where the variance is refused."""
    g, found = mcs.Estimator(case.integrand()).primary_integrand(0), [0.0]
    for tolerance in (1e-6, 1e-2, 1e-1):
        try:
            source = mcs.sampler(sampler, dims=case.dims)
            value, error = (float(v[0]) for v in of_integrand(source, n, g, tolerance))
        except mcs.NoClosedForm:
            continue
        assert error <= tolerance * value
        found.append(abs(value - case.variance(sides)) / (error + 1e-14 * case.square / n))
    return max(found)


@pytest.mark.parametrize(
    ("family", "dims"),
    [
        *(("slab", 1), ("bell", 1), ("box", 1), ("slab", 4), ("hidden-step", 2)),
        *(("ridge", 2), ("oblique-step", 3), ("product", 3)),
    ],
)
def test_random_points(family, dims):
    """Without the comparison with integrals these were 0, or wrong by 2e-5 with 1e-6 promised."""
    assert _worst(make(family, dims, 0), "random", 1, ()) <= 1.0


@pytest.mark.parametrize(
    ("family", "dims"), [("slab", 1), ("box", 1), ("slab", 2), ("ridge", 2), ("oblique-step", 3)]
)
def test_jittered_points(family, dims):
    side = {1: 16, 2: 4, 3: 2}[dims]
    assert _worst(make(family, dims, 0), "jittered", side**dims, (side,) * dims) <= 1.0


@pytest.mark.parametrize("sampler", ["regular | shift", "jittered | shift", "sobol | owen"])
def test_other_samplers_see_a_slab(sampler):
    """A point in it with probability 16 · 6e-5, of 16."""
    f = mcs.Integrand.from_function(lambda x: (np.abs(x[..., 0] - 0.30003) < 3e-5) * 1.0, dims=1)
    found = mcs.exact_variance(f, mcs.sampler(sampler, dims=1), 16)
    assert found == pytest.approx(6e-5 / 16 - 6e-5**2, rel=1e-6)


def test_a_tolerance_gives_variances_of_oblique_jumps():
    case = make("oblique-step", 2, 0)
    f, expected = case.integrand(), case.variance((2, 2))
    with pytest.raises(mcs.NoClosedForm, match="tolerance"):
        mcs.exact_variance(f, "jittered", 4)
    assert mcs.exact_variance(f, "jittered", 4, tolerance=0.1) == pytest.approx(expected, rel=0.1)
    found = mcs.Estimator(f), "jittered"
    value, error = estimated_variance(*found, 4, 0.1)
    assert abs(value[0] - expected) <= error[0]


def test_a_narrow_ridge_is_no_pole():
    case = make("ridge", 2, 10)
    assert case.volume == pytest.approx(4.367e-5, rel=1e-3)
    value, error = square_integral(case.integrand())
    assert abs(value[0] - case.square) <= error[0]


def test_jumps_that_are_not_declared_have_variances_to_a_tolerance():
    f = mcs.integrand("formula(expression='(x0+0.7*x1>0.83)*1.0')", dims=2)
    same = mcs.integrand("half-space(normal=(1, 0.7), offset=0.83)", dims=2)
    for sampler, n, tolerance in (
        ("random", 16, 1e-3),
        ("jittered", 64, 0.1),
        ("jittered", 1024, 0.1),
        ("latin-hypercube", 64, 1e-2),
        ("sobol | owen", 64, 0.1),
    ):
        with pytest.raises(mcs.NoClosedForm, match=r"or tolerance="):
            mcs.exact_variance(f, sampler, n)
        value, error = estimated_variance(f, sampler, n, tolerance)
        assert error[0] <= tolerance * value[0]
        assert abs(value[0] - mcs.exact_variance(same, sampler, n)) <= error[0]


@pytest.mark.parametrize("n", [64, 101])
def test_latin_hypercubes_by_slabs_hold_their_error(n):
    """Few evaluations: cells of 1/4 and slabs of 1/64 in place of 64² cells, or slabs alone."""
    g = mcs.Estimator("disk(center=(0.45, 0.52), radius=0.27)").primary_integrand(0)
    sampler = mcs.sampler("latin-hypercube", dims=2)
    expected, _ = of_integrand(sampler, n, g, 1e-6)
    value, error = of_integrand(sampler, n, g, 0.1, 500.0)
    assert 0.0 < abs(value - expected) <= error


def test_smooth_functions_are_given_as_before():
    f = mcs.Integrand.from_function(lambda x: x[..., 0] ** 2, dims=1)
    for n in (1, 16, 1024):
        edges = np.arange(n + 1) / n
        means, squares = (np.diff(edges**k) * n / k for k in (3, 5))
        expected = np.mean(squares - means**2) / n
        assert mcs.exact_variance(f, "jittered", n) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("tolerance", [0.0, 2.0, "much"])
def test_tolerances_out_of_range(tolerance):
    with pytest.raises(ParameterError, match="tolerance"):
        mcs.exact_variance("linear", "jittered", 4, tolerance=tolerance)
