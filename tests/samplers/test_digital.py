"""Sobol' points: against SciPy's, elementary intervals one by one, the table of directions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import qmc

from mcspectra.core.errors import NotPowerOfTwoWarning, ParameterError
from mcspectra.samplers import Sobol, sampler
from mcspectra.samplers.digital import _sobol_directions


def bit_reversed(n):
    bits = n.bit_length() - 1
    return np.array([int(f"{i:0{bits}b}"[::-1], 2) for i in range(n)])


@pytest.mark.parametrize("dims", [1, 2, 10, 37])
@pytest.mark.parametrize("bits", [0, 1, 5, 10])
def test_points_are_scipys_in_another_order(dims, bits):
    ours = Sobol(dims=dims).draw(2**bits)[0]
    theirs = qmc.Sobol(d=dims, scramble=False, bits=32).random_base2(bits)
    np.testing.assert_array_equal(np.unique(ours, axis=0), np.unique(theirs, axis=0))
    assert len(np.unique(ours, axis=0)) == 2**bits


def test_order_is_natural():
    np.testing.assert_array_equal(Sobol(dims=1).draw(64)[0, :, 0] * 64, bit_reversed(64))
    np.testing.assert_array_equal(Sobol(dims=7).draw(512)[0, :32], Sobol(dims=7).draw(32)[0])


@pytest.mark.parametrize("spec", ["sobol", "sobol | digital-shift", "sobol | owen"])
@pytest.mark.parametrize("bits", [1, 2, 5, 8])
def test_every_elementary_interval_holds_one_point(spec, bits):
    n = 2**bits
    for seed in range(10):
        points = sampler(spec, 2).draw(n, realizations=20, rng=seed)
        for k in range(bits + 1):
            boxes = np.floor(points * [2**k, 2 ** (bits - k)]) @ [2 ** (bits - k), 1]
            boxes.sort(axis=1)
            np.testing.assert_array_equal(boxes, np.broadcast_to(np.arange(n), boxes.shape))


@pytest.mark.parametrize("spec", ["sobol", "sobol | digital-shift", "sobol | owen"])
def test_every_axis_of_every_dim_is_stratified(spec):
    n = 256
    strata = np.sort(np.floor(sampler(spec, 1111).draw(n, rng=3)[0] * n), axis=0)
    np.testing.assert_array_equal(strata, np.broadcast_to(np.arange(n)[:, None], strata.shape))


def test_dims_do_not_repeat():
    points = Sobol(dims=1111).draw(8192)[0]
    assert len(np.unique(points.T[:, 4096:], axis=0)) == 1111


def test_direction_numbers_are_odd_multiples_of_their_place():
    """v_i = m_i 2^(32−i) with m_i odd and below 2^i: what makes every axis stratified."""
    v = _sobol_directions().astype(np.int64)
    place = np.int64(1) << np.arange(31, -1, -1)
    assert v.shape == (1111, 32)
    assert (v % place == 0).all()
    assert (v // place % 2 == 1).all()
    assert (v < 2**32).all()


@pytest.mark.parametrize("n", [3, 6, 100])
def test_other_counts_are_made_with_a_warning(n):
    with pytest.warns(NotPowerOfTwoWarning, match=f"{n} Sobol' points are not balanced"):
        points = Sobol(dims=3).draw(n)
    np.testing.assert_array_equal(points[0], Sobol(dims=3).draw(128)[0, :n])
    with pytest.warns(NotPowerOfTwoWarning):
        sampler("sobol | owen", 3).draw(n)


def test_warning_names_the_balanced_counts_and_the_caller():
    with pytest.warns(NotPowerOfTwoWarning, match="64 and 128 would be") as caught:
        Sobol(dims=2).draw(100)
    assert caught[0].filename == __file__


def test_dims_end_with_the_table():
    with pytest.raises(ParameterError, match="from 1 to 1111"):
        Sobol(dims=1112)
