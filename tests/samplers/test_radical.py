"""Radical inverses against SciPy, balance in base b, and the laws of the scrambled digits."""

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

import mcspectra as mcs
from mcspectra.core.errors import NoClosedForm
from mcspectra.samplers import Halton, Hammersley, VanDerCorput

LEVEL = 1 - (1 - 1e-6) ** (1 / 24)  # Šidák: 24 statistical tests in this file share 1e-6
SIGMAS = stats.norm.isf(LEVEL / 2)
EPS = np.finfo(float).eps


@pytest.mark.parametrize("dims", [1, 2, 10, 64])
def test_unscrambled_points_equal_scipys(dims):
    # SciPy sums digit by digit: at most 10 roundings of numbers below 1 for 1,000 points
    np.testing.assert_allclose(
        Halton(dims=dims).draw(1000)[0],
        qmc.Halton(d=dims, scramble=False).random(1000),
        rtol=0,
        atol=10 * EPS,
    )


def test_skip_leaves_out_the_first_points():
    whole = Halton(dims=5).draw(1000)[0]
    for skip in (1, 7, 500):
        part = Halton(dims=5, skip=skip).draw(500)[0]
        np.testing.assert_allclose(part, whole[skip : skip + 500], rtol=0, atol=EPS)


def test_a_thousand_dims_have_a_thousand_primes():
    second = Halton(dims=1000, skip=1).draw(1)[0, 0]  # radical inverse of 1 is 1/b
    primes = np.rint(1 / second).astype(int)
    assert primes[[0, 1, 2, 3, 999]].tolist() == [2, 3, 5, 7, 7919]
    assert all(p % q for p in primes for q in range(2, int(p**0.5) + 1))


@pytest.mark.parametrize("base", [2, 3, 10, 97, 7919])
def test_van_der_corput_is_the_radical_inverse(base):
    """A slow reference reverses the digits of each index in exact integers."""
    n = 300
    expected = []
    for i in range(n):
        value, scale, rest = 0, 1, i
        while rest:
            value, scale, rest = value * base + rest % base, scale * base, rest // base
        expected.append(value / scale)
    np.testing.assert_array_equal(VanDerCorput(base=base).draw(n)[0, :, 0], expected)


def test_blocks_of_indices_join_without_a_seam():
    """5,000 indices span several tables of low digits, and may start within one."""
    whole = Halton(dims=3).draw(5000)[0]
    for i in (0, 1, 1023, 1024, 2187, 4096, 4999):
        np.testing.assert_allclose(Halton(dims=3, skip=i).draw(1)[0, 0], whole[i], rtol=EPS)


@pytest.mark.parametrize("dims", [1, 2, 10])
def test_hammersley_is_i_over_n_followed_by_halton(dims):
    points = Hammersley(dims=dims).draw(100)[0]
    np.testing.assert_array_equal(points[:, 0], np.arange(100) / 100)
    if dims > 1:
        np.testing.assert_array_equal(points[:, 1:], Halton(dims=dims - 1).draw(100)[0])


@pytest.mark.parametrize("scramble", ["none", "permute", "owen"])
@pytest.mark.parametrize("n", [1, 64, 100, 101])
def test_hammersley_holds_one_point_in_each_nth(scramble, n):
    x = Hammersley(dims=3, scramble=scramble).draw(n, realizations=20, rng=1)[..., 0]
    strata = np.sort(np.floor(x * n + 2.0**-40), axis=1)
    np.testing.assert_array_equal(strata, np.tile(np.arange(n), (20, 1)))


@pytest.mark.parametrize("scramble", ["none", "permute", "owen"])
def test_hammersley_of_two_dims_is_a_net(scramble):
    """One point in each of the 64 elementary intervals of every shape: a (0, 6, 2)-net."""
    points = Hammersley(scramble=scramble).draw(64, realizations=20, rng=1)
    for k in range(7):
        cells = np.floor(points * [2**k, 2 ** (6 - k)]) @ [2 ** (6 - k), 1]
        np.testing.assert_array_equal(np.sort(cells, axis=1), np.tile(np.arange(64), (20, 1)))


@pytest.mark.parametrize("scramble", ["permute", "owen"])
def test_scrambled_hammersley_moves_its_first_coordinate(scramble):
    """For n = 2^m the first point is in any n-th; otherwise it stays in its n-th, uniformly."""
    for n, scale in ((16, 16), (18, 18 * 16)):
        x = Hammersley(scramble=scramble).draw(n, realizations=3200, rng=1)[:, 0, 0]
        counts = np.bincount(np.floor(x * scale).astype(int), minlength=16)
        assert len(counts) == 16
        assert stats.chisquare(counts).pvalue > LEVEL


@pytest.mark.parametrize("step", ["permute", "owen"])
@pytest.mark.parametrize(
    ("name", "dims", "n"),
    [("halton", 3, 100), ("van-der-corput(base=6)", 1, 50), ("hammersley", 3, 64)],
)
def test_scramble_abbreviates_a_randomization(name, dims, n, step):
    """The points have the same bits, also if other randomizations follow."""
    inside = name.replace(")", ", ") if "(" in name else name + "("
    for after in ("", " | shift", " | owen | digital-shift"):
        short = mcs.sampler(f"{inside}scramble='{step}'){after}", dims)
        spelled = mcs.sampler(f"{name} | {step}{after}", dims)
        np.testing.assert_array_equal(
            short.draw(n, realizations=3, rng=1, first=2),
            spelled.draw(n, realizations=3, rng=1, first=2),
        )
        assert (short.unbiased, short.fixed) == (True, False)
        assert mcs.sampler(short.spec, dims) == short


SOURCES = [
    Halton(dims=3),
    Halton(dims=3, scramble="permute"),
    Halton(dims=3, scramble="owen"),
    Halton(dims=3, skip=12345, scramble="permute"),
    Halton(dims=3, skip=12345, scramble="owen"),
]


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: source.spec)
def test_one_point_in_each_interval_of_its_base(source):
    """The first b^k points have one in each [a/b^k, (a+1)/b^k), and in boxes (2^i, 3^j)."""
    for j, (base, power) in enumerate([(2, 6), (3, 4), (5, 3)]):
        n = base**power
        x = source.draw(n, realizations=20, rng=1)[..., j]
        # Half an interval's 2^-40 is added, since plain points lie on the ends of intervals up to
        # rounding
        strata = np.sort(np.floor(x * n + 2.0**-40), axis=1)
        np.testing.assert_array_equal(strata, np.tile(np.arange(n), (len(x), 1)))
    points = source.draw(72, realizations=20, rng=1)
    boxes = np.floor(points[..., :2] * [8, 9] + 2.0**-40) @ [9, 1]
    np.testing.assert_array_equal(np.sort(boxes, axis=1), np.tile(np.arange(72), (20, 1)))


@pytest.mark.parametrize("scramble", ["permute", "owen"])
def test_digits_are_permuted_uniformly_and_independently(scramble):
    """Base 3: the images of the digits 0, 1, 2 at two positions are 36 equally likely pairs."""
    points = Halton(dims=2, scramble=scramble).draw(9, realizations=18_000, rng=2)
    digits = np.floor(points[..., 1] * 9).astype(int)
    first = digits[:, :3] // 3 @ [9, 3, 1]  # indices 0, 1, 2 have the lowest digits 0, 1, 2
    second = digits[:, ::3] % 3 @ [9, 3, 1]  # indices 0, 3, 6 have the next digits 0, 1, 2
    codes = np.unique(first * 27 + second, return_counts=True)[1]
    assert len(codes) == 36
    assert stats.chisquare(codes).pvalue > LEVEL


def test_the_tail_is_uniform_and_shared():
    n = 27
    x = Halton(dims=2, scramble="permute").draw(n, realizations=4000, rng=3)[..., 1] * n % 1.0
    np.testing.assert_allclose(x, x[:, :1] + np.zeros(n), atol=n * EPS)
    assert stats.kstest(x[:, 0], "uniform").pvalue > LEVEL


def test_digit_bases():
    assert Halton(dims=4).digit_bases == (2, 3, 5, 7)
    assert Hammersley(dims=4).digit_bases == (2, 2, 3, 5)
    assert Hammersley(dims=1).digit_bases == (2,)
    assert VanDerCorput(base=10).digit_bases == (10,)


@pytest.mark.parametrize(
    ("alias", "chain", "dims"),
    [
        ("halton(scramble='owen')", "halton | owen", 2),
        ("hammersley(scramble='owen')", "hammersley | owen", 2),
        ("van-der-corput(scramble='permute')", "van-der-corput | permute", 1),
        ("halton(scramble='owen') | shift", "halton | owen | shift", 2),
    ],
)
def test_the_abbreviation_has_the_law_of_its_chain(alias, chain, dims):
    short, long = mcs.sampler(alias, dims), mcs.sampler(chain, dims)
    assert short.as_chain(16) == long == long.as_chain(16)
    assert np.array_equal(
        short.draw(16, realizations=2, rng=3), long.draw(16, realizations=2, rng=3)
    )
    estimator = mcs.Estimator("gaussian", dims=dims)
    for known in (
        lambda s: mcs.exact_variance(estimator, s, 16),
        lambda s: mcs.spectra.gain_coefficients(s, 16)["gain"].values.tolist(),
    ):
        try:
            expected = known(long)
        except NoClosedForm:
            with pytest.raises(NoClosedForm):
                known(short)
        else:
            assert known(short) == expected


def test_hammersley_points_of_other_counts_have_no_chain():
    sampler = mcs.sampler("hammersley(scramble='owen')", 2)
    assert sampler.as_chain(9) is sampler
