"""Discrepancies and diaphony against hand calculation, brute force, SciPy and Fourier series."""

import itertools
import math

import numpy as np
import pytest
from scipy.stats import qmc

from mcspectra import sampler
from mcspectra.core.errors import ParameterError
from mcspectra.quality import (
    diaphony,
    generalized_l2_discrepancy,
    l2_discrepancy,
    star_discrepancy,
)


def brute_force_star(x):
    """Try every box whose corner is on the grid of coordinates, closed and open."""
    worst = 0.0
    for corner in itertools.product(*[[*x[:, k], 1.0] for k in range(x.shape[1])]):
        volume = math.prod(corner)
        closed = np.mean((x <= corner).all(1))
        opened = np.mean((x < corner).all(1))
        worst = max(worst, closed - volume, volume - opened)
    return worst


@pytest.mark.parametrize("dims", [1, 2])
@pytest.mark.parametrize("n", [1, 2, 5, 12])
def test_star_discrepancy_is_that_of_the_worst_box(n, dims):
    rng = np.random.default_rng(10 * n + dims)
    for _ in range(10):
        x = rng.random((n, dims))
        assert star_discrepancy(x) == pytest.approx(brute_force_star(x), rel=1e-12)
        ties = np.floor(4 * x) / 4  # many equal coordinates, some equal points
        assert star_discrepancy(ties) == pytest.approx(brute_force_star(ties), rel=1e-12)


@pytest.mark.parametrize(
    ("points", "value"),
    [([[0.5]], 0.5), ([[0.0]], 1.0), ([[0.5, 0.5]], 0.75), ([[0.0, 0.0]], 1.0)],
)
def test_star_discrepancy_of_one_point(points, value):
    assert star_discrepancy(points) == value


def test_star_discrepancy_of_centred_and_van_der_corput_points():
    n = 64
    assert star_discrepancy((np.arange(n)[:, None] + 0.5) / n) == pytest.approx(0.5 / n)
    assert star_discrepancy(sampler("van-der-corput", 1).draw(n)[0]) == pytest.approx(1 / n)


def test_star_discrepancy_does_not_depend_on_the_order_of_points():
    x = np.random.default_rng(3).random((100, 2))
    assert star_discrepancy(x[::-1]) == star_discrepancy(x)
    assert star_discrepancy(x[:, ::-1]) == pytest.approx(star_discrepancy(x), rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "name", "power"),
    [("star", "L2-star", 1), ("centered", "CD", 2), ("wraparound", "WD", 2), ("mixture", "MD", 2)],
)
def test_l2_discrepancies_are_scipys_with_the_root_taken(kind, name, power):
    x = np.random.default_rng(5).random((40, 3))
    assert l2_discrepancy(x, kind) ** power == pytest.approx(qmc.discrepancy(x, method=name))


@pytest.mark.parametrize("x", [0.0, 0.3, 0.5, 0.9])
def test_l2_discrepancies_of_one_point_on_a_line(x):
    # star: ∫_0^x t² + ∫_x^1 (1 − t)²; centred: 13/12 − 2(1 + z/2 − z²/2) + 1 + z, z = |x − 1/2|
    z = abs(x - 0.5)
    assert l2_discrepancy([[x]]) == pytest.approx(math.sqrt((x**3 + (1 - x) ** 3) / 3))
    assert l2_discrepancy([[x]], "centered") == pytest.approx(math.sqrt(1 / 12 + z * z))


@pytest.mark.parametrize("dims", [1, 2, 4])
def test_generalised_l2_discrepancy_sums_those_of_all_projections(dims):
    x = np.random.default_rng(dims).random((30, dims))
    axes = [c for k in range(dims) for c in itertools.combinations(range(dims), k + 1)]
    squares = sum(l2_discrepancy(x[:, list(chosen)]) ** 2 for chosen in axes)
    assert generalized_l2_discrepancy(x) == pytest.approx(math.sqrt(squares), rel=1e-10)


@pytest.mark.parametrize(("side", "dims"), [(1, 1), (16, 1), (4, 2), (3, 3)])
def test_diaphony_of_a_grid(side, dims):
    # Only frequencies that are multiples of the grid's remain: (1 + π²/(3 s²))^d − 1.
    points = np.array(list(itertools.product(range(side), repeat=dims))) / side
    expected = math.sqrt((1 + math.pi**2 / (3 * side**2)) ** dims - 1)
    assert diaphony(points) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("dims", [1, 2])
def test_diaphony_is_its_fourier_series(dims):
    x = np.random.default_rng(dims).random((9, dims))
    limit = 500
    axis = np.arange(-limit, limit + 1)
    m = np.stack(np.meshgrid(*[axis] * dims, indexing="ij"), -1)
    phases = [np.exp(2j * np.pi * np.multiply.outer(x[:, k], axis)) for k in range(dims)]
    product = phases[0].T if dims == 1 else np.einsum("na,nb->abn", *phases)
    power = np.abs(product.mean(-1)) ** 2
    terms = power / np.prod(np.maximum(1.0, np.abs(m)) ** 2, axis=-1)
    series = float(terms.sum() - 1.0)
    # Frequencies with a component beyond the limit weigh less than d · 2/limit · (1 + π²/3)^(d−1).
    left_out = dims * 2 / limit * (1 + math.pi**2 / 3) ** (dims - 1)
    assert series <= diaphony(x) ** 2 <= series + left_out
    assert left_out < 0.1 * series


def test_diaphony_does_not_change_when_the_set_is_moved():
    x = np.random.default_rng(8).random((30, 3))
    assert diaphony((x + np.array([0.3, 0.8, 0.1])) % 1) == pytest.approx(diaphony(x), rel=1e-10)


def test_mean_square_of_the_diaphony_of_random_points():
    n, sets = 16, 400
    squares = [diaphony(x) ** 2 for x in sampler("random", 2).draw(n, realizations=sets, rng=4)]
    expected = ((1 + math.pi**2 / 3) ** 2 - 1) / n
    error = np.std(squares, ddof=1) / math.sqrt(sets)
    assert abs(np.mean(squares) - expected) < 5 * error


@pytest.mark.parametrize("figure", [diaphony, generalized_l2_discrepancy, l2_discrepancy])
def test_too_many_pairs_are_refused_with_the_limit(figure):
    with pytest.raises(ParameterError, match="give at most 8192"):
        figure(np.full((8193, 2), 0.5))


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (np.full((4, 3), 0.5), "1 and 2 dims only, not in 3"),
        (np.full((2**14 + 1, 2), 0.5), "give at most 16384"),
        (np.full((2, 4, 2), 0.5), "one set"),
        ([[1.0]], r"\[0,1\)"),
    ],
)
def test_star_discrepancies_that_cannot_be_had(points, words):
    with pytest.raises(ParameterError, match=words):
        star_discrepancy(points)


def test_unknown_kind():
    with pytest.raises(ParameterError, match="centered"):
        l2_discrepancy([[0.5]], "centred")
