"""Sums and products of functions of one axis: curves, and variances in closed form."""

import dataclasses
import functools
import math

import numpy as np
import pytest
from scipy.special import ndtri, stdtrit
from tests.prediction.unlimited import predict

import mcspectra as mcs
from mcspectra.prediction.separable import PiecewiseCurve, separated
from mcspectra.samplers import as_sampler


@pytest.fixture(autouse=True)
def small(few_probes):
    """Search functions for details at few points; none of them has small details."""


def means_of_power(a, place, cells):
    """Return means of |x − place|^-a and of its square over equal cells."""
    ends = np.arange(cells + 1) / cells - place
    return [cells * np.diff(np.sign(ends) * np.abs(ends) ** (1 - e) / (1 - e)) for e in (a, 2 * a)]


@pytest.mark.parametrize("place", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("a", [0.1, 0.4, 0.45, 0.49])
def test_curves_of_poles_have_the_energy_that_doubles_do_not_resolve(a, place):
    curve = PiecewiseCurve.along(lambda x: np.abs(x - place) ** -a)
    (mean,), (square,) = means_of_power(a, place, 1)
    assert curve.mean == pytest.approx(mean, rel=1e-9)
    off = abs(curve.square - (square - mean**2))
    assert off <= curve.doubt + 1e-10 * square
    assert curve.doubt < 1e-3 * square


@pytest.mark.parametrize(
    ("function", "mean", "square"),
    [
        (lambda x: np.abs(stdtrit(3, x)), 2 * math.sqrt(3) / math.pi, 3.0),
        (lambda x: np.exp(ndtri(x)), math.exp(0.5), math.exp(2.0)),
        (np.log, -1.0, 2.0),
        (lambda x: 1.0 * (x < 0.377), 0.377, 0.377),
        (lambda x: np.abs(x - 0.377), 0.265129, (0.377**3 + 0.623**3) / 3),
        (lambda x: np.sin(32 * np.pi * x) ** 2, 0.5, 0.375),
    ],
)
def test_curves_of_quantiles_logarithms_jumps_kinks_and_waves(function, mean, square):
    curve = PiecewiseCurve.along(function)
    assert curve.mean == pytest.approx(mean, rel=1e-7)
    assert curve.square + curve.mean**2 == pytest.approx(square, rel=1e-6)


def test_what_is_neither_a_sum_nor_a_product_is_not_taken_for_one():
    for f in (
        lambda x: 1.0 * (((x - 0.5) ** 2).sum(-1) < 0.1),
        lambda x: np.abs(x[..., 0] - x[..., 1]),
        lambda x: np.exp(x.prod(-1)),
        lambda x: x.sum(-1) + 3.0 * (np.abs(x - 0.5) < 0.01).all(-1),  # A box that few points hit
    ):
        assert separated(mcs.Integrand.from_function(f, dims=2)) is None


class TestUnbounded:
    @pytest.mark.slow  # The closed forms of powers below are a quicker test of the same kind
    def test_latin_hypercubes_of_quantiles(self):
        """The exact variance within n strata at n = 64 is 0.012925."""

        def quantiles(x):
            return np.abs(stdtrit(3, x)).sum(axis=-1)

        n = 64
        ends = stdtrit(3, np.arange(n // 2, n + 1) / n)
        # ∫x p(x) dx of the density p, which is proportional to (1 + x²/3)^-2
        parts = -math.sqrt(3) / math.pi / (1 + ends[:-1] ** 2 / 3)
        first, last = parts, np.append(parts[1:], 0.0)
        between = 2 * n * np.sum((last - first) ** 2)
        exact = 2 * (3.0 - between) / n
        assert exact == pytest.approx(0.012925, rel=1e-4)
        found = predict(quantiles, "latin-hypercube", [n], dims=2)
        low, high = found["predicted_variance_ci"].values[0]
        assert low <= exact <= high
        assert found["predicted_variance"].item() == pytest.approx(exact, rel=1e-5)

    @pytest.mark.parametrize(
        ("a", "place", "dims", "product"),
        [
            (0.4, 0.0, 2, True),
            pytest.param(0.45, 1.0, 2, False, marks=pytest.mark.slow),
            pytest.param(0.3, 0.3, 3, True, marks=pytest.mark.slow),
            (0.4, 0.3, 6, False),
        ],
    )
    def test_powers_in_closed_form(self, a, place, dims, product):
        """Cells of one axis have closed-form means and mean squares; nets are for sums only."""
        n, samplers = 64, ["random", "jittered", "latin-hypercube", "sobol | owen"]

        def powers(x):
            each = np.abs(x - place) ** -a
            return each.prod(axis=-1) if product else each.sum(axis=-1)

        (mean,), (square,) = means_of_power(a, place, 1)

        def of_cells(s):
            return (means_of_power(a, place, s)[0] ** 2).mean()

        found = predict(powers, samplers, [n], dims=dims).isel(n=0)
        values, ends = found["predicted_variance"].values, found["predicted_variance_ci"].values
        for sampler, value, (low, high) in zip(samplers, values, ends, strict=True):
            if sampler == "random":
                exact = square**dims - mean ** (2 * dims) if product else dims * (square - mean**2)
            elif sampler == "jittered":
                inside = [of_cells(s) for s in as_sampler(sampler, dims).law(n).sides]
                exact = square**dims - math.prod(inside) if product else dims * square - sum(inside)
            else:
                apart = (n * mean**2 - of_cells(n)) / (n - 1)
                exact = dims * (square - of_cells(n))
                if product:
                    exact = square**dims + (n - 1) * apart**dims - n * mean ** (2 * dims)
            assert low <= high, sampler
            if "owen" not in sampler or not product:
                assert low <= exact / n * (1 + 1e-9), sampler
                assert exact / n <= high * (1 + 1e-9), sampler
                assert value == pytest.approx(exact / n, rel=1e-3), sampler

    @pytest.mark.parametrize("method", ["exact", "levels", "subsets", "table", "moves"])
    def test_no_method_gives_a_number_where_the_square_has_no_integral(self, method):
        found = predict(
            lambda x: (x**-0.55).sum(-1), "latin-hypercube", [16], dims=2, method=method
        )
        assert not np.isfinite(found["predicted_variance"]).any()


ONE_AXIS = [lambda x: np.sin(32 * np.pi * x) ** 2, lambda x: np.abs(x - 0.377)]
SAMPLERS = [
    "random",
    "jittered",
    "jittered | shift",
    "latin-hypercube",
    "latin-hypercube | shift",
    "sobol | owen",
    "halton | owen",
    "sobol | digital-shift",
    "rank1-lattice | shift",
    "orthogonal-array",
]


SLOW = ("jittered | shift", "latin-hypercube | shift", "sobol | digital-shift", "halton | owen")
"""Laws that variances of drawn sets below test quicker."""


@functools.cache
def _terms_and_their_sum(dims):
    """Return integrands for all samplers, because they keep what quadrature finds."""
    functions = (
        lambda x: ONE_AXIS[0](x[..., 0]),
        lambda x: ONE_AXIS[1](x[..., 1]),
        lambda x: ONE_AXIS[0](x[..., 0]) + ONE_AXIS[1](x[..., 1]),
    )
    return [mcs.Integrand.from_function(f, dims=dims) for f in functions]


@pytest.mark.parametrize(
    "sampler", [pytest.param(s, marks=[pytest.mark.slow] * (s in SLOW)) for s in SAMPLERS]
)
@pytest.mark.parametrize("dims", [pytest.param(3, marks=pytest.mark.slow), 6])
def test_functions_of_one_axis_are_never_refused(sampler, dims):
    """Sums have the variances of their terms in any dims; n = 64 has the sides 8², 4³ and 2⁶."""
    source = as_sampler(sampler, dims)
    n = 49 if sampler == "orthogonal-array" else 64
    *alone, both = (
        mcs.exact_variance(f, source, n, tolerance=1e-4) for f in _terms_and_their_sum(dims)
    )
    assert both == pytest.approx(alone[0] + alone[1], rel=1e-3, abs=1e-15)


@pytest.mark.parametrize("sampler", ["random", "jittered", "latin-hypercube"])
def test_boxes_with_a_hundredth_of_the_volume(sampler):
    n, dims, low, high = 64, 3, 0.4, 0.4 + 0.01 ** (1 / 3)

    def box(x):
        return 0.5 + 2.0 * ((x > low) & (x < high)).all(axis=-1)

    def part(s):
        ends = np.arange(s + 1) / s
        return (np.clip(s * np.diff(np.clip(ends, low, high)), 0.0, 1.0) ** 2).mean()

    volume = (high - low) ** dims
    if sampler == "random":
        exact = volume - volume**2
    elif sampler == "jittered":
        exact = volume - part(4) ** dims
    else:
        apart = (n * (high - low) ** 2 - part(n)) / (n - 1)
        exact = volume + (n - 1) * apart**dims - n * volume**2
    found = mcs.exact_variance(box, sampler, n, dims=dims, tolerance=1e-4)
    assert found == pytest.approx(4.0 * exact / n, rel=1e-4)


LAWS = [
    ("jittered | shift", 27),
    ("latin-hypercube | shift", 16),
    ("sobol | owen", 16),
    ("halton | owen", 20),
    ("sobol | digital-shift", 16),
    ("rank1-lattice | shift", 32),
    ("halton | shift", 20),
    ("orthogonal-array", 25),
    ("antithetic-jittered", 16),
    ("jittered | mirror(mode='uniform')", 216),
]


def _sums_or_products():
    """Yield each law with a sum and a product, of which one is slow by turns.

    Only the digital shift compares digits of products, so both are quick there.
    """
    for place, (sampler, n) in enumerate(LAWS):
        for product in (False, True):
            turn = product == (place % 2 == 0) and "digital" not in sampler
            slow = [pytest.mark.slow] * turn
            yield pytest.param(sampler, n, product, marks=slow)


@functools.cache
def _of_three_axes(product):
    """Return the sum or the product of three functions of one axis each."""

    def function(x):
        parts = [1 + 0.5 * np.sin(7 * x[..., 0]), np.exp(x[..., 1]), 0.3 + (x[..., 2] < 0.377)]
        return math.prod(parts) if product else sum(parts)

    return mcs.Integrand.from_function(function, dims=3)


@pytest.mark.parametrize(("sampler", "n", "product"), list(_sums_or_products()))
def test_variances_of_sets_that_are_drawn(sampler, n, product, monkeypatch):
    """2,000 sets: 4.5 standard errors of a sample variance, for 20 tests.

    An eighth of the cells changes variances by less than 1e-3, of which the error is told.
    """
    from mcspectra.prediction import exact

    few = dataclasses.replace(exact._SETTINGS, most_cells=2**15)
    monkeypatch.setattr(exact, "_SETTINGS", few)

    source, f = as_sampler(sampler, 3), _of_three_axes(product)
    (value,), (error,) = exact._by_axes(source.law(n), f)
    means = f(source.draw(n, realizations=2000, rng=1)).mean(axis=-1)
    away = means - means.mean()
    measured = means.var(ddof=1)
    half = 4.5 * measured * math.sqrt((away**4).mean() / measured**2 - 1.0) / math.sqrt(2000)
    assert abs(value - measured) <= half + error
    assert error <= 0.03 * value
