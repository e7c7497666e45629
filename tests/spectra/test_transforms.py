"""Engines against the direct sum, and the indexing of half spectra."""

import numpy as np
import pytest

from mcspectra.spectra.transforms import FrequencyGrid, Transform, direct_sum


def _points(sets, n, dims, seed=0):
    return np.random.default_rng(seed).random((sets, n, dims))


@pytest.mark.parametrize("dims", [1, 2, 3, 4])
@pytest.mark.parametrize("sets", [1, 2, 5])
@pytest.mark.parametrize("engine", ["nufft", "direct"])
def test_coefficients_agree_with_the_definition(dims, sets, engine):
    grid = FrequencyGrid(dims, {1: 20, 2: 9, 3: 4, 4: 2}[dims])
    x = _points(sets, 37, dims)
    w = np.random.default_rng(1).random((sets, 37)) - 0.3  # weights of both signs
    for weights in (None, w):
        got = Transform(grid, 37, engine=engine).coefficients(x, weights)
        expected = direct_sum(x, grid.indices(), weights)
        scale = 1.0 if weights is None else np.abs(w).sum(axis=1).max()
        # NUFFT: eps = 1e-9 in relative l2; 7.7e-11 of the peak measured; 1e-8 is guaranteed
        assert np.abs(got - expected).max() < (1e-8 if engine == "nufft" else 1e-12) * scale


@pytest.mark.parametrize("dims", [1, 2])
def test_real_frequencies_are_scaled_coordinates(dims):
    grid = FrequencyGrid(dims, 12, 0.3)
    x = _points(3, 50, dims)
    got = Transform(grid, 50, engine="nufft").coefficients(x)
    assert np.abs(got - direct_sum(x, grid.indices() * 0.3)).max() < 1e-8


def test_higher_accuracy_on_request():
    grid = FrequencyGrid(2, 16)
    x = _points(2, 100, 2)
    got = Transform(grid, 100, engine="nufft", eps=1e-12).coefficients(x)
    assert np.abs(got - direct_sum(x, grid.indices())).max() < 1e-11


@pytest.mark.parametrize("sets", [1, 4, 7])
@pytest.mark.parametrize("weighted", [False, True])
def test_packed_power_is_the_power_of_each_set(sets, weighted):
    grid = FrequencyGrid(2, 10)
    x = _points(sets, 64, 2)
    w = np.random.default_rng(2).random((sets, 64)) / 64 if weighted else None
    total, squares = np.zeros(grid.stored), np.zeros(grid.stored)
    Transform(grid, 64, engine="nufft").add_power(x, w, total, squares)
    power = np.abs(direct_sum(x, grid.indices(), w)) ** 2
    assert np.abs(total - power.sum(axis=0)).max() < 1e-8 * sets
    assert np.abs(squares - (power**2).sum(axis=0)).max() < 1e-8 * sets


def test_full_grid_is_hermitian_and_in_order():
    grid = FrequencyGrid(2, 3)
    x = _points(1, 11, 2)
    full = grid.full(direct_sum(x, grid.indices()), conjugate=True)[0]
    m = np.stack(np.meshgrid(grid.axis, grid.axis, indexing="ij"), axis=-1)
    expected = direct_sum(x[0], m.reshape(-1, 2)).reshape(7, 7)
    assert np.allclose(full, expected, atol=1e-13)
    assert np.array_equal(grid.pick(full), full.ravel()[:25])
    assert np.array_equal(grid.indices()[-1], [0, 0])


def test_512_squared_has_the_guaranteed_accuracy():
    """4096 points, 513² frequencies: error against the direct sum at most 1e-8 of the peak."""
    grid = FrequencyGrid(2, 256)
    x = _points(2, 4096, 2, seed=3)
    got = Transform(grid, 4096).coefficients(x)
    chosen = np.random.default_rng(4).choice(grid.stored, 400, replace=False)
    expected = direct_sum(x, grid.indices()[chosen])
    assert np.abs(got[:, chosen] - expected).max() < 1e-8


def test_engine_auto_uses_the_direct_sum_for_small_sets_only():
    assert Transform(FrequencyGrid(1, 8), 16).engine == "direct"
    assert Transform(FrequencyGrid(2, 64), 256).engine == "nufft"
    assert Transform(FrequencyGrid(4, 16), 500).engine == "direct"
    assert Transform(FrequencyGrid(4, 16), 4096).engine == "nufft"
    assert Transform(FrequencyGrid(4, 2), 10**6).engine == "direct"
    assert Transform(FrequencyGrid(5, 4), 10**6).engine == "direct"
