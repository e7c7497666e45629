"""Nets in base 2: against SciPy's points, theory and slow references; the table of directions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import qmc

from mcspectra.core.errors import CountError, NotPowerOfTwoWarning, ParameterError
from mcspectra.samplers import LarcherPillichshammer, Niederreiter, Sobol, sampler
from mcspectra.samplers.net_quality import net_t_value
from mcspectra.samplers.nets import _irreducible, _sobol_directions


def bit_reversed(n):
    bits = n.bit_length() - 1
    return np.array([int(f"{i:0{bits}b}"[::-1], 2) for i in range(n)])


@pytest.mark.parametrize("dims", [1, 2, 10, 37, 1111])
@pytest.mark.parametrize("bits", [0, 1, 5, 10])
def test_points_are_scipys_in_the_order_of_gray_codes(dims, bits):
    i = np.arange(2**bits)
    theirs = qmc.Sobol(d=dims, scramble=False, bits=32).random_base2(bits)
    np.testing.assert_array_equal(Sobol(dims=dims).draw(2**bits)[0, i ^ (i >> 1)], theirs)


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


def multiplied(a, b):
    """Product of polynomials over two elements, by their lists of coefficients."""
    product = np.convolve(*([int(c) for c in f"{p:b}"] for p in (a, b))) % 2
    return int("".join(map(str, product)), 2)


def test_irreducible_polynomials():
    """No product is among them, and there are as many of each degree as Gauss's formula says."""
    polynomials = _irreducible()
    assert polynomials[:9] == (
        0b10,
        0b11,
        0b111,
        0b1011,
        0b1101,
        0b10011,
        0b11001,
        0b11111,
        0b100101,
    )
    products = {multiplied(a, b) for a in range(2, 64) for b in range(2, 64)}
    assert not products.intersection(polynomials)
    degrees = np.bincount([p.bit_length() - 1 for p in polynomials])
    np.testing.assert_array_equal(degrees[1:], [2, 1, 2, 3, 6, 9, 18, 30, 56, 99, 186, 335, 630])


@pytest.mark.parametrize("dims", [2, 5, 20])
def test_niederreiter_matrices_are_laurent_series(dims):
    """Row q e + u times p^(q+1) is x^u: every coefficient of a negative power vanishes."""
    columns = Niederreiter(dims=dims).direction_numbers(1)[-1].astype(np.int64)
    p = _irreducible()[dims - 1]
    degree = p.bit_length() - 1
    for row in range(12):
        series = [int(columns[k] >> (31 - row)) & 1 for k in range(32)]  # of x^-1, x^-2, …
        q, u = divmod(row, degree)
        power = 1
        for _ in range(q + 1):
            power = multiplied(power, p)
        top = power.bit_length() - 1
        product = np.convolve([int(c) for c in f"{power:b}"], series) % 2  # from x^(top − 1) down
        expected = np.zeros(32, int)
        expected[top - 1 - u] = 1
        np.testing.assert_array_equal(product[:32], expected)


@pytest.mark.parametrize(
    ("dims", "t", "reached"), [(1, 0, 3), (2, 0, 3), (3, 1, 1), (4, 3, 6), (5, 5, 9)]
)
def test_quality_of_niederreiter_is_the_sum_of_degrees_less_one(dims, t, reached):
    found = [net_t_value(Niederreiter(dims=dims).draw(2**m)[0]) for m in range(1, 12)]
    assert max(found) == t == found[reached - 1]


def test_niederreiter_repeats_no_dim():
    points = Niederreiter(dims=1377).draw(4096)[0]
    assert len(np.unique(points.T, axis=0)) == 1377
    with pytest.raises(ParameterError, match="from 1 to 1377"):
        Niederreiter(dims=1378)
    with pytest.warns(
        NotPowerOfTwoWarning, match="6 Niederreiter points are not balanced; 4 and 8"
    ):
        Niederreiter(dims=3).draw(6)


@pytest.mark.parametrize("bits", [0, 1, 2, 6, 10])
def test_larcher_pillichshammer_by_hand(bits):
    """x = i/n; digit r of y is the parity of the digits of i from the r-th lowest on."""
    n = 2**bits
    points = LarcherPillichshammer().draw(n)[0]
    np.testing.assert_array_equal(points[:, 0], np.arange(n) / n)
    y = [sum(((i >> r).bit_count() % 2) / 2 ** (r + 1) for r in range(bits)) for i in range(n)]
    np.testing.assert_array_equal(points[:, 1], y)
    assert net_t_value(points) == 0


def test_larcher_pillichshammer_is_better_than_hammersley():
    """Star discrepancy at n = 256."""
    ours, other = (
        sampler(name, 2).draw(256)[0] for name in ("larcher-pillichshammer", "hammersley")
    )
    assert star_discrepancy(ours) < 0.8 * star_discrepancy(other)


def star_discrepancy(points):
    """By definition: closed and open boxes with corners on the grid of coordinates."""
    xs, ys = (np.append(np.unique(c), 1.0) for c in points.T)
    volume = np.outer(xs, ys)
    closed = (points[:, 0, None] <= xs).T.astype(float) @ (points[:, 1, None] <= ys)
    open_ = (points[:, 0, None] < xs).T.astype(float) @ (points[:, 1, None] < ys)
    return max((closed / len(points) - volume).max(), (volume - open_ / len(points)).max())


def test_counts_and_dims_of_larcher_pillichshammer():
    with pytest.raises(CountError, match="nearest counts are 64 and 128"):
        LarcherPillichshammer().draw(100)
    assert LarcherPillichshammer().nearest_count(2**31 - 1) == 2**31
    with pytest.raises(ParameterError, match="it must be 2, for other dims use sobol"):
        LarcherPillichshammer(dims=3)
