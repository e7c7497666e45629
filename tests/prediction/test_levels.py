"""Variances of nets and strata from cells and moved sets: exact values and measurements."""

import functools

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import NoClosedForm
from mcspectra.core.streams import Stream
from mcspectra.prediction.known import Known
from mcspectra.prediction.levels import of_levels
from mcspectra.prediction.torus import of_moves


def predicted(f, sampler, n):
    """Predict for a sampler or its spec."""
    f = f if isinstance(f, Known) else Known(f)
    source = mcs.sampler(sampler, f.g.dims)
    method = of_moves if "digital-shift" in source.spec else of_levels
    return method(source.law(n), f, Stream.from_rng(0))


@pytest.fixture(autouse=True)
def small(few_probes):
    """Search functions for details at few points; none of them has small details."""


@functools.cache
def function(name, dims):
    """Return functions without closed forms, some with jumps across curves.

    Each is made once, because it keeps what quadrature finds.
    """
    functions = {
        "product": lambda x: np.prod(1.0 / (1.0 + 4.0 * (x - 0.4) ** 2), axis=-1),
        "sum": lambda x: x.sum(axis=-1),
        "rotated step": lambda x: 1.0 * (x @ np.array([1.0, 0.53, 0.31])[:dims] < 0.7),
        "disk": lambda x: 1.0 * (((x - 0.5) ** 2).sum(axis=-1) < 0.0625),
    }
    return mcs.Integrand.from_function(functions[name], dims=dims)


@pytest.mark.parametrize(
    ("sampler", "dims", "n"),
    [
        ("sobol | owen", 1, 64),
        ("sobol | owen", 2, 32),
        ("niederreiter | lms", 2, 32),
        ("halton | owen", 2, 36),
        pytest.param("halton(scramble='owen')", 2, 36, marks=pytest.mark.slow),  # As halton | owen
        ("faure | owen", 3, 9),
        pytest.param("faure | owen", 3, 27, marks=pytest.mark.slow),
        pytest.param("jittered", 2, 25, marks=pytest.mark.slow),  # As moved strata
        ("jittered | strata-shift(offset=0.3)", 2, 25),
        ("antithetic-jittered", 2, 50),
        ("latin-hypercube", 1, 9),
    ],
)
def test_exact_values_of_smooth_functions(sampler, dims, n):
    f = function("product", dims)
    if "lms" in sampler:  # The pairs of points have the law of owen
        exact = mcs.exact_variance(mcs.Estimator(f), mcs.sampler("niederreiter | owen", dims), n)
    elif "scramble" in sampler:
        exact = mcs.exact_variance(mcs.Estimator(f), mcs.sampler("halton | owen", dims), n)
    else:
        exact = mcs.exact_variance(mcs.Estimator(f), mcs.sampler(sampler, dims), n)
    found = predicted(f, sampler, n)
    assert found.variance == pytest.approx(exact, rel=1e-5)
    # Tolerance of exact_variance
    assert abs(found.variance[0] - exact) <= found.error[0] + 1e-6 * exact


@pytest.mark.parametrize("n", [pytest.param(16, marks=pytest.mark.slow), 64])
def test_digital_shifts_of_smooth_functions(n):
    """Random shifts are applied one after another: the interval covers, and is narrow."""
    f = function("product", 2)
    exact = mcs.exact_variance(mcs.Estimator(f), mcs.sampler("sobol | digital-shift", 2), n)
    found = predicted(f, "sobol | digital-shift", n)
    assert abs(found.variance[0] - exact) <= found.error[0] < 0.05 * exact


@pytest.mark.parametrize("dims", [1, pytest.param(2, marks=pytest.mark.slow), 3])
@pytest.mark.parametrize("sampler", ["sobol | owen", "sobol | digital-shift"])
def test_additive_functions_at_large_counts(sampler, dims):
    """Each axis has one point in each n-th: jittered with owen, a grid with a shift."""
    n = 4096 if dims < 3 else 512
    found = predicted(function("sum", dims), sampler, n)
    exact = dims / 12.0 / (float(n) ** 3 if "owen" in sampler else float(n) ** 2)
    assert abs(found.variance[0] - exact) <= found.error[0] + 1e-6 * exact
    assert found.variance == pytest.approx(exact, rel=0.01)


@pytest.mark.parametrize("n", [2**13, pytest.param(2**16, marks=pytest.mark.slow)])
def test_thousands_of_points(n):
    found = predicted(mcs.integrand("linear", dims=2), "sobol | owen", n)
    at_four = predicted(mcs.integrand("linear", dims=2), "sobol | owen", 4)
    assert found.variance[0] * float(n) ** 3 == pytest.approx(at_four.variance[0] * 64.0, rel=1e-3)


@pytest.mark.parametrize(
    ("sampler", "n"),
    [
        pytest.param("sobol | owen", 16, marks=pytest.mark.slow),
        # Base 2 has a base of its own in halton, and its cells are measured below
        pytest.param("sobol | owen", 4096, marks=pytest.mark.slow),
        ("halton | owen", 16),
        pytest.param("halton | owen", 4096, marks=pytest.mark.slow),
        ("jittered", 16),
        ("jittered", 4096),
    ],
)
def test_sampled_cells_of_curves_agree_with_closed_forms(sampler, n):
    """Compare a disk without closed form with a disk whose shares of cells are exact."""
    exact = predicted(mcs.integrand("disk", dims=2), sampler, n)
    found = predicted(KNOWN_DISK, sampler, n)
    assert found.variance == pytest.approx(exact.variance, rel=0.005)
    assert abs(found.variance[0] - exact.variance[0]) <= 3.0 * found.error[0]


KNOWN_DISK = Known(function("disk", 2))


@pytest.mark.parametrize(
    ("name", "sampler", "dims", "n"),
    [
        ("rotated step", "sobol | owen", 2, 1024),
        ("rotated step", "sobol | digital-shift", 2, 256),
        ("rotated step", "jittered", 2, 1024),
        pytest.param("rotated step", "halton | owen", 3, 216, marks=pytest.mark.slow),
        # Exact values in 3-D are quick above, and so is a step in 2-D
        pytest.param("disk", "sobol | owen", 3, 512, marks=pytest.mark.slow),
        pytest.param("disk", "jittered", 3, 512, marks=pytest.mark.slow),
        pytest.param("disk", "antithetic-jittered", 2, 512, marks=pytest.mark.slow),
        ("product", "sobol | digital-shift", 2, 1024),
    ],
)
def test_measured_variances(name, sampler, dims, n):
    f = function(name, dims)
    found = predicted(f, sampler, n)
    measured(found, f, sampler, n)
    assert found.error[0] < 0.1 * found.variance[0]


def measured(found, f, sampler, n):
    """Check five standard errors of a measurement, plus the interval of the prediction."""
    means = f(mcs.sampler(sampler, f.dims).draw(n, realizations=500, rng=3)).mean(axis=1)
    error = ((means - means.mean()) ** 2).std() / np.sqrt(500)
    assert abs(found.variance[0] - means.var(ddof=1)) <= 5.0 * error + found.error[0]


def test_channels_are_predicted_each():
    f = mcs.Integrand.from_function(
        lambda x: np.stack([x.sum(axis=-1), np.prod(x, axis=-1)], axis=-1), dims=2
    )
    for sampler in ("sobol | owen", "sobol | digital-shift", "jittered"):
        both = predicted(f, sampler, 16).variance
        first = predicted(function("sum", 2), sampler, 16).variance
        assert both.shape == (2,)
        assert both[0] == pytest.approx(first[0], rel=1e-6)


def test_digital_shifts_of_a_jump_along_a_diagonal():
    f = mcs.integrand("christensen-triangle", dims=2)
    found = predicted(f, "sobol | digital-shift", 4096)
    assert found.error[0] < 0.1 * found.variance[0]
    measured(found, f, "sobol | digital-shift", 4096)
    with pytest.raises(NoClosedForm, match="too many"):
        predicted(f, "sobol | digital-shift", 2**18)


def test_poles_at_the_border_keep_their_energy():
    """(x y)^-0.3: cells of a table miss a part of ∫f² that is most of the variance."""
    f = mcs.Integrand.from_function(
        lambda x: np.prod(np.maximum(x, 1e-300) ** -0.3, axis=-1), dims=2, integral=1 / 0.49
    )
    found = predicted(f, "jittered", 4096)
    ends = np.arange(65) / 64
    mean, square = 64 * np.diff(ends**0.7) / 0.7, 64 * np.diff(ends**0.4) / 0.4
    exact = (square.mean() ** 2 - (mean**2).mean() ** 2) / 4096
    assert found.variance[0] == pytest.approx(exact, rel=0.02)
    assert abs(found.variance[0] - exact) <= found.error[0]


def test_strata_within_which_nothing_varies_have_no_variance():
    f = mcs.Integrand.from_function(
        lambda x: (np.floor(5 * x) % 2).sum(axis=-1) % 2, dims=2, integral=0.48
    )
    assert predicted(f, "jittered", 100).variance[0] == 0.0


@pytest.mark.parametrize(
    ("sampler", "dims", "words"),
    [
        ("sobol", 2, "no variance"),
        ("regular", 2, "no variance"),
        ("sobol | owen", 4, "at most 3 dims"),
        ("jittered | shift", 2, "No gains"),
        ("poisson-disk", 2, "No gains"),
    ],
)
def test_refusals(sampler, dims, words):
    with pytest.raises(NoClosedForm, match=words):
        predicted(mcs.integrand("linear", dims=dims), sampler, 16)
